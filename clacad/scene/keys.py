"""Every key of a scene file: its kind, its default and its meaning. The list exists only here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from clacad.base.text import near
from clacad.base.units import Unit
from clacad.config.compound_kinds import ListOf, Several, WordOr
from clacad.config.quantities import Quantity
from clacad.config.value_kinds import Flag, JsonSchema, Refusal, Text, Whole, Word, not_this
from clacad.design.keys import REQUIRED, FormatVersion, Key, UnitWord
from clacad.scene.colour import ColourValue


@dataclass(frozen=True, slots=True)
class Anything:
    """A value that another reader checks (keys of a design, parts of a group)."""

    what: str

    def read(self, value: object, unit: Unit) -> Any:
        """Return the value unchanged."""
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return self.what

    def schema(self) -> JsonSchema:
        """Return a JSON Schema without restrictions."""
        return {"description": self.what}


@dataclass(frozen=True, slots=True)
class Numbers:
    """A list of 2 to 10000 numbers, or of lists of numbers of one length (values of an animated key)."""

    rows: bool = False

    def read(self, value: object, unit: Unit) -> tuple[Any, ...]:
        """Return a tuple of numbers, or of tuples."""
        if not isinstance(value, list):
            raise Refusal("CL104", not_this(value, "a list"), value, self.allowed(unit))
        if not 2 <= len(value) <= 10_000:
            raise Refusal("CL108", f"has {len(value)} values", value, self.allowed(unit))
        return tuple(_number_or_row(item, self.rows, self.allowed(unit)) for item in value)

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return "a list of 2 to 10000 numbers" + (", or of lists of numbers" if self.rows else "")

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of an array."""
        return {"type": "array", "minItems": 2, "maxItems": 10_000}


@dataclass(frozen=True, slots=True)
class NumberOrRow:
    """A number or a list of numbers."""

    def read(self, value: object, unit: Unit) -> Any:
        """Return a float or a tuple of floats."""
        return _number_or_row(value, True, self.allowed(unit))

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return "a number, or a list of numbers"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of either."""
        return {"anyOf": [{"type": "number"}, {"type": "array", "items": {"type": "number"}}]}


def _number_or_row(value: object, rows: bool, allowed: str) -> Any:
    if isinstance(value, list) and rows and value:
        return tuple(_number_or_row(item, False, allowed) for item in value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not -1e12 <= value <= 1e12:
        raise Refusal("CL104", not_this(value, "a number"), value, allowed)
    return float(value)


@dataclass(frozen=True, slots=True)
class Size:
    """The `size` of an object: one length > 0, or two or three."""

    def read(self, value: object, unit: Unit) -> tuple[float, ...]:
        """Return one to three lengths."""
        if not isinstance(value, list):
            return (LENGTH_ABOVE_0.read(value, unit),)
        if not 1 <= len(value) <= 3:
            raise Refusal("CL108", f"has {len(value)} values", value, self.allowed(unit))
        found = []
        for k, item in enumerate(value):
            try:
                found.append(_LENGTH_FROM_0.read(item, unit))
            except Refusal as refusal:
                refusal.within(k)
                raise
        return tuple(found)

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return "a length > 0, or a list of two or three lengths"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of either."""
        one = LENGTH_ABOVE_0.schema()
        return {"anyOf": [one, {"type": "array", "items": one, "minItems": 1, "maxItems": 3}]}


LENGTH: Final = Quantity("length", "a length")
LENGTH_ABOVE_0: Final = Quantity("length", "a length > 0", above=0.0)
_LENGTH_FROM_0 = Quantity("length", "a length >= 0", least=0.0)
_XYZ = ("x", "y", "z")
_VECTOR = Several(Quantity("ratio", "a number"), _XYZ)
_POINT = Several(LENGTH, _XYZ)
_ANGLE = Quantity("angle", "an angle from -36000 to 36000 deg", least=-36000.0, most=36000.0, degrees=True)
_SHARE = Quantity("ratio", "a number from 0 to 1000", least=0.0, most=1000.0)
_SMALL = Quantity("ratio", "a number from 0 to 1", least=0.0, most=1.0)
_PIXELS = Whole("a whole number from 1 to 32768", 1, 32768)
_COLOURS = Several(ColourValue(), ("first", "second"))
_EFFECT = Text("the name of an effect", 40, pattern="[a-z_]+")
_FILE = Text("a relative file name of 1 to 300 characters", 300)

ROOT: Final[dict[str, Key]] = {
    "format": Key(FormatVersion(), "version of this file's format", REQUIRED),
    "name": Key(
        Text("a text of 1 to 80 letters, digits, spaces and - _ . , + ( ) =", 80, plain=True),
        "name of the scene, used for files",
        REQUIRED,
    ),
    "unit": Key(UnitWord(), "unit of every bare length here; the design keeps its own", REQUIRED),
    "notes": Key(ListOf(Text("a text of 1 to 500 characters", 500), "texts"), "remarks", ()),
}
SHEET: Final[dict[str, Key]] = {
    "design": Key(_FILE, "design file", REQUIRED),
    "set": Key(Anything('a table of design keys: { "law.eta" = [-0.25, -1.0] }'), "changed design keys", None),
    "rung": Key(Word(("auto", "law", "thin", "surfaces", "mesh")), "how exactly rays pass the sheet", "auto"),
    "mesh": Key(_FILE, "rung mesh: triangles as written"),
    "quads": Key(Whole("a whole number from 1 to 256", 1, 256), "rung mesh without a file: quads a cell side", 16),
    "surround": Key(Word(("see-through", "opaque")), "what is seen beside the sheet", "see-through"),
    "tint": Key(Several(_SMALL, ("red", "green", "blue")), "linear transmission per colour of what is seen through the only sheet", (1.0, 1.0, 1.0)),
    "continuous": Key(Flag(), "rung law of a law that varies: by the law at the very point, not of the cell hit", False),
}  # fmt: skip
STACKED: Final[dict[str, Key]] = {
    "id": Key(Text("a name of letters, digits, - and _, beginning with a letter", 60, pattern="[A-Za-z][A-Za-z0-9_-]*"),
              "name of the sheet, for animation, --set, plan and forecast", REQUIRED),
    "z": Key(_LENGTH_FROM_0, "where the sheet's own z = 0 stands; 0 for the first", 0.0),
    **{name: key for name, key in SHEET.items() if name != "tint"},
}  # fmt: skip
"""Keys of a [[sheet]]; a scene may have several."""
CAMERA: Final[dict[str, Key]] = {
    "position": Key(_POINT, "where the camera stands, z < 0", REQUIRED),
    "target": Key(_POINT, "what it looks at", (0.0, 0.0, 0.0)),
    "up": Key(_VECTOR, "direction that is up in the picture", (0.0, 1.0, 0.0)),
    "frame": Key(LENGTH_ABOVE_0, "width of the picture at the target"),
    "fov": Key(Quantity("angle", "an angle > 0, below 180 deg", above=0.0, most=3.14), "full width as an angle"),
    "pixels": Key(Several(_PIXELS, ("width", "height"), single=True), "size of the picture", (660, 660)),
    "samples": Key(Whole("a whole number from 1 to 65536", 1, 65536), "rays a pixel", 9),
    "noise": Key(_SMALL, "standard error of a pixel at which sampling stops; 0: a fixed number of rays", 0.0),
    "most_samples": Key(Whole("a whole number from 1 to 65536", 1, 65536), "rays a pixel at most", 256),
    "aperture": Key(_LENGTH_FROM_0, "diameter of the lens's opening; 0 is a pinhole", 0.0),
    "focus": Key(LENGTH_ABOVE_0, "distance of the sharp plane; default: the target's"),
    "exposure": Key(_SHARE, "factor on the light when it is written to a file", 1.0),
    "mirror": Key(Flag(), "left-handed view, x to the right, as the paper's renderer draws it", False),
    "encoding": Key(Word(("srgb", "linear")), "encoding of picture files", "srgb"),
}  # fmt: skip
LIGHT: Final[dict[str, Key]] = {
    "ambient": Key(_SHARE, "light from everywhere", 0.35),
    "key": Key(_SHARE, "light from one direction", 0.65),
    "direction": Key(_VECTOR, "towards that light", (-0.4, 0.8, -0.45)),
    "spectrum": Key(WordOr(("rgb", "D65"), Quantity("wavelength", "a wavelength from 10 nm to 1 mm", least=1e-8,
                    most=1e-3)), "one wavelength, three lines, or daylight in nine samples", 550e-9),
    "polariser": Key(_ANGLE, "direction the scene's light is polarised in"),
    "analyser": Key(_ANGLE, "direction of an analyser before the camera"),
}  # fmt: skip
BACKGROUND: Final[dict[str, Key]] = {
    "sky": Key(Several(ColourValue(), ("zenith", "horizon")), "colours of the sky", ((0.275, 0.468, 0.745), (0.855, 0.896, 0.939))),
    "ground": Key(ColourValue(), "seen below the horizon where there is no floor", (0.1845, 0.1845, 0.1845)),
}  # fmt: skip
EFFECTS: Final[dict[str, Key]] = {
    "mode": Key(Word(("auto", "list", "none")), "how effects are chosen", "auto"),
    "list": Key(ListOf(_EFFECT, "texts"), "mode list: exactly these", ()),
    "force": Key(ListOf(_EFFECT, "texts"), "auto plus these", ()),
    "without": Key(ListOf(_EFFECT, "texts"), "auto minus these", ()),
    "angle": Key(WordOr(("auto",), Quantity("angle", "an angle > 0", above=0.0, most=1.6)),
                 "smallest angle that matters", "auto"),
    "radiance": Key(_SMALL, "smallest relative radiance that matters", 0.01),
    "coating": Key(Word(("none", "quarter-wave")), "fresnel: coating of the faces", "none"),
    "order": Key(Whole("a whole number from 1 to 4", 1, 4), "reflections: how many in a path", 2),
}  # fmt: skip
ANIMATION: Final[dict[str, Key]] = {
    "frames": Key(Whole("a whole number from 2 to 100000", 2, 100_000), "number of frames", REQUIRED),
    "fps": Key(
        Quantity("ratio", "a number > 0, at most 240", above=0.0, most=240.0), "frames a second", 25.0
    ),
    "move": Key(Anything("one table [[animation.move]] for each moved key"), "what moves", REQUIRED),
}
MOVE: Final[dict[str, Key]] = {
    "key": Key(Text("a key of the scene, such as object.knight.at.2", 200), "what moves", REQUIRED),
    "from": Key(NumberOrRow(), "value in the first frame"),
    "to": Key(NumberOrRow(), "value in the last frame"),
    "values": Key(Numbers(rows=True), "values it takes, straight lines between them"),
    "times": Key(Numbers(), "when, 0 to 1, rising"),
    "ease": Key(Word(("linear", "smooth")), "how the time runs", "linear"),
}
SECTIONS: Final[dict[str, dict[str, Key]]] = {
    "sheet": SHEET,
    "camera": CAMERA,
    "light": LIGHT,
    "background": BACKGROUND,
    "effects": EFFECTS,
    "animation": ANIMATION,
}
OPTIONAL: Final = ("light", "background", "effects", "animation")

OBJECT: Final[dict[str, Key]] = {
    "id": Key(Text("a name of letters, digits, - and _", 60, pattern="[A-Za-z0-9_-]+"), "name for animation"),
    "kind": Key(
        Word(("checker", "knight", "mesh", "screen", "sphere", "box", "cone", "group")), "what it is", REQUIRED
    ),
    "at": Key(_POINT, "where it is: centre of sphere, box and screen, middle of the foot of all else", (0.0, 0.0, 0.0)),
    "size": Key(Size(), "how large it is"),
    "turn": Key(Several(_ANGLE, _XYZ), "turns about the fixed x, y, z axes through `at`, in this order", (0.0, 0.0, 0.0)),
    "colour": Key(ColourValue(), "its colour", (0.5, 0.5, 0.5)),
    "height": Key(LENGTH, "checker: y of the floor", 0.0),
    "tile": Key(LENGTH_ABOVE_0, "checker: side of a tile", 1.0),
    "reach": Key(LENGTH_ABOVE_0, "checker: how far along a ray the floor is drawn"),
    "colours": Key(_COLOURS, "checker: odd and even tiles; stripes: the two stripes", ((0.687, 0.539, 0.323), (0.105, 0.05, 0.019))),
    "file": Key(_FILE, "mesh or picture"),
    "up": Key(Word(("y", "z")), "mesh: which axis of the file points up", "y"),
    "pattern": Key(Word(("colour", "coordinates", "image", "stripes")), "screen: what it shows", "colour"),
    "period": Key(LENGTH_ABOVE_0, "stripes: width of a pair of stripes"),
    "parts": Key(Anything("a list of tables, each an object"), "group: what it is made of"),
}  # fmt: skip

KEYS_OF: Final[dict[str, tuple[str, ...]]] = {
    "checker": ("height", "tile", "reach", "colours"),
    "knight": ("at", "size", "turn", "colour"),
    "mesh": ("at", "size", "turn", "colour", "file", "up"),
    "screen": ("at", "size", "turn", "pattern", "colour", "colours", "file", "period"),
    "sphere": ("at", "size", "turn", "colour"),
    "box": ("at", "size", "turn", "colour"),
    "cone": ("at", "size", "turn", "colour"),
    "group": ("at", "turn", "parts"),
}
"""Keys of each kind of object, in addition to `id` and `kind`."""

SIZES: Final[dict[str, tuple[int, str]]] = {
    "knight": (1, "its height"),
    "mesh": (1, "its height"),
    "screen": (2, "[width, height]"),
    "sphere": (1, "its diameter"),
    "box": (3, "[x, y, z]"),
    "cone": (3, "[bottom diameter, top diameter, height]"),
}
"""Number of lengths in the `size` of each kind, and their meaning."""

SYNONYMS: Final[dict[str, str]] = {
    "color": "colour", "colors": "colours", "position": "at", "centre": "at", "center": "at", "rotation": "turn",
    "rotate": "turn", "type": "kind", "name": "id", "texture": "file", "image": "file", "resolution": "pixels",
    "width": "frame", "look_at": "target", "eye": "position", "spp": "samples", "objects": "object",
    "aperture_diameter": "aperture", "wavelength": "spectrum", "axis": "up",
}  # fmt: skip


def nearest(name: str, known: tuple[str, ...]) -> str:
    """Return the key that was probably meant, "" if none is near."""
    folded = name.lower().replace("-", "_")
    if folded in known:
        return folded
    if SYNONYMS.get(folded) in known:
        return SYNONYMS[folded]
    return next(iter(near(folded, known, 0.65)), "")


def home_of(name: str) -> str:
    """Return "section.name" of a key that belongs in another section, "" if there is none."""
    for section, keys in (*SECTIONS.items(), ("object", OBJECT)):
        if name in keys:
            return f"{section}.{name}"
    return ""
