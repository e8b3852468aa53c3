"""Wishes: the law of a sheet, its size, the viewing distance, the process and the material.

A wish is read with the value kinds of a design file, so that units, ranges and messages are the same.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import degrees, radians
from typing import Any, Final, Literal

from clacad.base.text import did_you_mean, near, nm_text
from clacad.base.types import Pair2
from clacad.base.units import LENGTHS, Unit
from clacad.checks.light_kinds import LAW_RMS
from clacad.config.compound_kinds import REQUIRED, Key, Several
from clacad.config.mistakes import DesignError, Mistake, design_error
from clacad.config.toml_text import toml_value
from clacad.config.value_kinds import LENGTH_ABOVE_0, Refusal, Whole, Word, shown
from clacad.design.body import Outline
from clacad.design.process_profiles import profile
from clacad.design.rules import Asked, law_is_a_pair, lens_faces_forward, material_is_known
from clacad.design.sections import LAW, PAIR, SECTIONS
from clacad.optics.material.catalogue import find, names

UNIT: Final = Unit("mm", LENGTHS["mm"])
"""Unit of bare lengths in a wish, and of the resulting design."""

ASSUMED_VIEWING: Final = 1000.0
"""Assumed viewing distance (millimetres) where the wish states no viewer."""

_LAW, _PAIR, _CHECK = (SECTIONS[name] for name in ("law", "pair", "check"))

KEYS: Final[dict[str, Key]] = {
    "eta": Key(
        Several(_LAW["eta"].kind.kind, ("x", "y"), single=True),  # type: ignore[attr-defined]
        "light leaves at slopes (t - delta)/eta; -1 turns it over, 0 < eta < 1 shrinks without turning",
        REQUIRED,
    ),
    "delta": Key(_LAW["delta"].kind, "offset of the image, delta_i = d_i/f1_i", (0.0, 0.0)),
    "euler": Key(
        _LAW["euler"].kind, "phi, theta, psi: turn and tilt of the lens axes, degrees", (0.0, 0.0, 0.0)
    ),
    "width": Key(
        Several(LENGTH_ABOVE_0, ("width", "height"), single=True),
        "a rectangular sheet of this width (and height)",
    ),
    "circle": Key(LENGTH_ABOVE_0, "a round sheet of this diameter"),
    "viewing": Key(
        LENGTH_ABOVE_0,
        "distance of the eye before the sheet; the eye's light is then judged over the whole sheet",
    ),
    "object": Key(LENGTH_ABOVE_0, "distance behind the sheet of what must be seen sharply"),
    "process": Key(_CHECK["process"].kind, "who makes it: its limits", "diamond-turning"),
    "material": Key(
        _PAIR["material"].kind,
        "what it is made of; PMMA if the process works it, else the first it works",
        "PMMA",
    ),
    "index": Key(_PAIR["index"].kind, "refractive index, instead of a material"),
    "wavelength": Key(_PAIR["wavelength"].kind, "design wavelength", _PAIR["wavelength"].default),
    "pitch": Key(LENGTH_ABOVE_0, "size of a cell, instead of the one that looks best"),
    "flange": Key(LENGTH_ABOVE_0, "width of the land round the cells, body.border"),
    "holes": Key(
        Whole("a whole number from 1 to 360", most=360),
        "mounting holes in the flange, half its width wide: 4 in the "
        "corners of a rectangular sheet, any number on a circle of a round one",
    ),
    "form": Key(Word(("any", "slab", "plano", "biconvex")), "how a lenslet pair is built", "any"),
    "kind": Key(Word(("square", "hexagonal")), "pattern of the cells", "square"),
    "white": Key(
        _CHECK["law_white"].kind,
        "largest error in white light, the mean over the lines F, e, d and C: white < 0.06 mrad",
    ),
    "error": Key(_CHECK[LAW_RMS.id].kind, "largest rms error of the law over the field: error < 1 mrad"),
    "field": Key(
        _CHECK["field"].kind, "half angle of the cone of light in which the law must hold", radians(1.0)
    ),
}
"""Words of a wish, with reader, meaning and default of each."""

LIMITS: Final = ("white", "error")
"""Words whose value is a limit, and may be written with "<"."""

SYNONYMS: Final = {
    "offset": "delta",
    "tilt": "euler",
    "turn": "euler",
    "size": "width",
    "diameter": "circle",
    "outline": "circle",
    "round": "circle",
    "distance": "viewing",
    "viewer": "viewing",
    "eye": "viewing",
    "from": "viewing",
    "lattice": "kind",
    "made": "process",
    "border": "flange",
    "n": "index",
    "colour": "white",
    "daylight": "white",
    "law_white": "white",
    "glass": "material",
    "lambda": "wavelength",
    "period": "pitch",
}
"""Other names of the words of a wish."""


@dataclass(frozen=True, slots=True)
class Wish:
    """Requirements on a sheet. Lengths in millimetres.

    Parameters
    ----------
    eta, delta : (2,) tuple of float
    euler : (3,) tuple of float, degrees
    size : Outline
    viewing : float or None, length
        Distance of the eye before the sheet; None: no eye is stated, and none is judged.
    object : float or None, length
        Distance behind the sheet of the object that must be sharp; None: no particular distance.
    process, material : str
    form : {"any", "slab", "plano", "biconvex"}
    kind : {"square", "hexagonal"}
        Pattern of the cells.
    field : float, radians
        Half angle of the cone of light in which the law must hold.
    index : float or None
        Instead of the material.
    wavelength : float, metres
    pitch : float or None, length
        Size of a cell; None: the one that looks best.
    flange : float or None, length
        Width of the land around the cells.
    holes : int or None
        Number of mounting holes in the flange.
    white : float or None, radians
        Largest mean error over the lines of white light; None: it is not judged.
    error : float or None, radians
        Largest rms error of the law over the field; None: the limit of verify.
    """

    eta: Pair2
    size: Outline
    delta: Pair2 = (0.0, 0.0)
    euler: tuple[float, float, float] = (0.0, 0.0, 0.0)
    viewing: float | None = None
    object: float | None = None
    process: str = "diamond-turning"
    material: str = "PMMA"
    form: Literal["any", "slab", "plano", "biconvex"] = "any"
    kind: Literal["square", "hexagonal"] = "square"
    field: float = radians(1.0)
    index: float | None = None
    wavelength: float = 550e-9
    pitch: float | None = None
    flange: float | None = None
    holes: int | None = None
    white: float | None = None
    error: float | None = None

    @property
    def distance(self) -> float:
        """Stated or else assumed distance of the eye, millimetres."""
        return ASSUMED_VIEWING if self.viewing is None else self.viewing

    @property
    def straight(self) -> bool:
        """Whether lens axes are the sheet's normal, no lens offset: light along it stays on the axis."""
        return self.delta == (0.0, 0.0) and self.euler[1] == 0.0

    @property
    def steps(self) -> bool:
        """Whether there are steps between neighbouring lens faces for any lens shape."""
        turned = (self.euler[0] + self.euler[2]) % 90.0 != 0.0
        return self.euler[1] != 0.0 or (self.eta[0] != self.eta[1] and (turned or self.kind == "hexagonal"))

    def words(self) -> dict[str, Any]:
        """The wish as written: values that differ from the defaults, lengths as bare millimetres."""
        shape = "circle" if self.size.shape == "circle" else "width"
        size = self.size.size[0] if self.size.size[0] == self.size.size[1] else list(self.size.size)
        eta = self.eta[0] if self.eta[0] == self.eta[1] else list(self.eta)
        found: dict[str, Any] = {"eta": eta, shape: size}
        for name, key in KEYS.items():
            if name not in ("eta", "width", "circle") and getattr(self, name) != key.default:
                found[name] = _word_of(name, getattr(self, name))
        return found


def _word_of(name: str, value: Any) -> Any:
    """A value of a wish as `read_word` reads it back."""
    if name in _TEXTS:
        return _TEXTS[name](value)
    return list(value) if isinstance(value, tuple) else value


def angle_text(radians_: float) -> str:
    """An angle as written: in degrees where that is exact."""
    text = f"{degrees(radians_):g}"
    return f"{text} deg" if radians(float(text)) == radians_ else f"{radians_!r} rad"


def wavelength_text(metres: float) -> str:
    """A wavelength as written: in nanometres where that is exact."""
    text = nm_text(metres, 6)
    return text if _PAIR["wavelength"].kind.read(text, UNIT) == metres else f"{metres!r} m"


def mrad_value(radians_: float) -> str:
    """A small angle as written: in mrad where that is exact."""
    text = f"{1e3 * radians_:.12g} mrad"
    return text if _CHECK["law_white"].kind.read(text, UNIT) == radians_ else f"{radians_!r} rad"


_TEXTS: Final = {"field": angle_text, "wavelength": wavelength_text, "white": mrad_value, "error": mrad_value}
"""Writers of values with a unit."""


def parse_wish(texts: Sequence[str]) -> dict[str, Any]:
    """Words of a wish from texts "KEY=VALUE, KEY=VALUE, …" as with --for; later ones replace earlier ones.

    Values are numbers, [lists] or plain text: ``eta=[-.5, -2], circle=60 mm, process=moulding``. A limit
    may be written with "<": ``white < 0.06 mrad``.

    Raises DesignError: A part that is not KEY=VALUE.
    """
    found: dict[str, Any] = {}
    for text in texts:
        for part in re.split(r",(?![^\[]*\])", text):
            key, equals, value = part.partition("=")
            if key.strip().strip("<").strip() in LIMITS or not equals:
                key, equals, value = part.replace("<=", "<").replace("=", "<").partition("<")
                equals = equals if key.strip() in LIMITS else ""
            if not part.strip():
                continue
            if not equals or not key.strip() or not value.strip():
                raise design_error(
                    "CL118",
                    f"{part.strip()!r} is not KEY=VALUE",
                    path="--for",
                    allowed="such as 'eta=-1, circle=60 mm, process=moulding'",
                )
            found[key.strip()] = written(value.strip())
    return found


def written(text: str) -> Any:
    """A typed value: a number or [list] where it reads as one, else the text."""
    text = text.strip()
    if text.startswith("[") and text.endswith("]"):
        return [written(part) for part in text[1:-1].split(",")]
    try:
        return toml_value(text)
    except ValueError:
        return text.strip("\"'")


def read_word(name: str, value: object) -> Any:
    """Value of one word of a wish, checked. Raises DesignError."""
    try:
        return KEYS[name].kind.read(value, UNIT)
    except Refusal as refusal:
        raise DesignError([_refused(name, one) for one in (refusal, *refusal.others)]) from None


def read_wish(words: Mapping[str, Any]) -> Wish:
    """Read a wish; lengths bare in millimetres or with a unit.

    words : Some of `KEYS` to what a design file would hold.
    Raises DesignError: With every mistake.
    """
    found, mistakes = _converted(words)
    sizes = [name for name in ("width", "circle") if name in words]
    if "eta" not in words:
        mistakes.append(
            Mistake("CL103", "a wish needs eta", "eta", "--for", allowed=KEYS["eta"].kind.allowed(UNIT))
        )
    if len(sizes) != 1:
        what = "a wish needs the sheet's size" if not sizes else "width and circle exclude each other"
        mistakes.append(
            Mistake(
                "CL103" if not sizes else "CL112",
                what,
                "width",
                "--for",
                allowed="exactly one of width = a length or [width, height] and circle = a diameter",
            )
        )
    if "material" not in found:
        found["material"] = workable_material(
            *(found.get(key, KEYS[key].default) for key in ("process", "material", "wavelength"))
        )
    mistakes += [*_broken_rules(found), *_exclusions(words, found)]
    if mistakes:
        raise DesignError(mistakes)
    width, circle = found.pop("width", None), found.pop("circle", None)
    size = Outline("rectangle", width) if circle is None else Outline("circle", (circle, circle))
    return Wish(size=size, **found)


def workable_material(process: str, wanted: str, wavelength: float) -> str:
    """The wanted material if the process works it, else the table's first for process and wavelength (m)."""
    rules = profile(process)
    if rules.works(find(wanted)):
        return wanted
    return next(name for name in names() if rules.works(find(name)) and find(name).knows(wavelength))


def _converted(words: Mapping[str, Any]) -> tuple[dict[str, Any], list[Mistake]]:
    """Values that could be read, and the mistakes of the others."""
    found: dict[str, Any] = {}
    mistakes: list[Mistake] = []
    for name, value in words.items():
        if name not in KEYS:
            mistakes.append(_unknown(name))
            continue
        try:
            found[name] = read_word(name, list(value) if isinstance(value, tuple) else value)
        except DesignError as problem:
            mistakes += problem.mistakes
    return found, mistakes


def _broken_rules(found: Mapping[str, Any]) -> list[Mistake]:
    """Mistakes of the law and the material by the rules of designs."""
    homes = {"eta": LAW.eta, "delta": LAW.delta, "euler": LAW.euler, "wavelength": PAIR.wavelength}
    homes |= {} if "index" in found else {"material": PAIR.material}
    values = {
        home: found.get(name, KEYS[name].default)
        for name, home in homes.items()
        if name in found or name != "eta"
    }
    asked = Asked(values, {PAIR.wavelength: ""} if "wavelength" in found else {}, UNIT)
    return [
        Mistake(m.code, m.message, m.key.split(".", 1)[1], "--for", allowed=m.allowed, hint=m.hint)
        for rule in (law_is_a_pair, lens_faces_forward, material_is_known)
        for m in rule(asked)
    ]


def _exclusions(words: Mapping[str, Any], found: Mapping[str, Any]) -> Iterator[Mistake]:
    """Mistakes of words that exclude or require each other."""
    if "index" in words and "white" in words:
        yield Mistake(
            "CL112",
            "white needs a material: an index alone is known at one wavelength",
            "white",
            "--for",
            allowed="material = a name of the table",
        )
    if "index" in words and "material" in words:
        yield Mistake(
            "CL112", "index and material exclude each other", "index", "--for", allowed="one of the two"
        )
    if "holes" not in found:
        return
    if "flange" not in words:
        yield Mistake(
            "CL113",
            "holes need a flange to lie in",
            "holes",
            "--for",
            allowed="flange = a length > 0, about four times the radius of the holes",
        )
    if "circle" not in words and found["holes"] != 4:
        yield Mistake(
            "CL106",
            f"holes = {found['holes']} do not fit the corners of a rectangular sheet",
            "holes",
            "--for",
            found=str(found["holes"]),
            allowed="4, one in each corner; a round sheet (circle) takes any number",
        )


def _refused(name: str, refusal: Refusal) -> Mistake:
    place = "".join(f"[{step}]" for step in refusal.where)
    return Mistake(
        refusal.code,
        f"{name}{place} = {shown(refusal.value)} {refusal.complaint}",
        name,
        "--for",
        found=shown(refusal.value),
        allowed=refusal.allowed,
        hint=refusal.hint,
    )


def _unknown(name: str) -> Mistake:
    meant = [SYNONYMS[name]] if name in SYNONYMS else near(name.lower(), KEYS, 0.6)
    return Mistake(
        "CL102",
        f"unknown word {name}{did_you_mean(meant, before='; ')}",
        name,
        "--for",
        allowed=f"a wish says {', '.join(KEYS)}",
        hint=meant[0] if meant else "",
    )
