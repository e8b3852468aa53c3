"""The sections of a scene file as frozen values in the scene's unit; each field is a key of the file.

Lengths are multiples of `Scene.unit_m` metres, wavelengths metres, angles radians (rotations in degrees, as
written, so that 90 degrees stays exact). Axes are the sheet's: right-handed, camera rays towards +z.

The module also lists all keys of a scene file, and makes the JSON Schema from them.

Kinds of value of scene files: colours, sizes, numbers that change with time, tables read elsewhere.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import tan
from typing import Any, Final, Literal

from clacad.base.units import Unit
from clacad.config import compound_kinds as keys
from clacad.config import key_reader as schema
from clacad.config.compound_kinds import REQUIRED, Key, ListOf, ListOr, Several, WordOr, keys_of
from clacad.config.key_reader import FileForm, head_keys
from clacad.config.value_kinds import (
    LENGTH,
    LENGTH_ABOVE_0,
    LENGTH_FROM_0,
    Flag,
    JsonSchema,
    Quantity,
    Refusal,
    Text,
    Whole,
    Word,
    WrittenAsRead,
    not_this,
)
from clacad.design.sections import LINES, LineSpec, lines_of
from clacad.design.sections import SECTIONS as DESIGN_SECTIONS

Rgb = tuple[float, float, float]


def linear(encoded: float) -> float:
    """Linear light of an sRGB-encoded value 0 … 1 (IEC 61966-2-1)."""
    return encoded / 12.92 if encoded <= 0.04045 else ((encoded + 0.055) / 1.055) ** 2.4


@dataclass(frozen=True, slots=True)
class ColourValue(WrittenAsRead):
    """A colour of a file: "#rrggbb" (sRGB-encoded) or [r, g, b] in linear light, 0 to 1000."""

    def read(self, value: object, unit: Unit) -> Rgb:
        """Return linear red, green, blue."""
        if isinstance(value, str):
            if not re.fullmatch("#[0-9a-fA-F]{6}", value):
                hint = "write #rrggbb" if re.fullmatch("#[0-9a-fA-F]{3}", value) else ""
                raise Refusal("CL107", "is not a colour", value, self.allowed(unit), hint)
            red, green, blue = (linear(int(value[k : k + 2], 16) / 255.0) for k in (1, 3, 5))
            return red, green, blue
        if not isinstance(value, list):
            raise Refusal("CL104", not_this(value, "a colour"), value, self.allowed(unit))
        if len(value) != 3:
            raise Refusal("CL108", f"has {len(value)} values", value, self.allowed(unit))
        for k, part in enumerate(value):
            good = isinstance(part, int | float) and not isinstance(part, bool)
            if not good or not (math.isfinite(part) and 0.0 <= part <= 1000.0):
                refusal = Refusal("CL106", "is no amount of light", part, self.allowed(unit))
                refusal.within(k)
                raise refusal
        return float(value[0]), float(value[1]), float(value[2])

    def allowed(self, unit: Unit) -> str:
        """Return the two ways to write a colour."""
        return '"#rrggbb", or [r, g, b] in linear light from 0 to 1000'

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of text or three numbers."""
        number = {"type": "number", "minimum": 0, "maximum": 1000}
        return {
            "anyOf": [
                {"type": "string", "pattern": "^#[0-9a-fA-F]{6}$"},
                {"type": "array", "items": number, "minItems": 3, "maxItems": 3},
            ]
        }


@dataclass(frozen=True, slots=True)
class Anything(WrittenAsRead):
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

    def write(self, value: tuple[Any, ...], unit: Unit) -> list[Any]:
        """Return the numbers as lists."""
        return [list(item) if isinstance(item, tuple) else item for item in value]

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return "a list of 2 to 10000 numbers" + (", or of lists of numbers" if self.rows else "")

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of an array."""
        return {"type": "array", "minItems": 2, "maxItems": 10_000}


@dataclass(frozen=True, slots=True)
class NumberOrRow(WrittenAsRead):
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
class Size(WrittenAsRead):
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
                found.append(LENGTH_FROM_0.read(item, unit))
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


Vector = tuple[float, float, float]

_XYZ = ("x", "y", "z")
_VECTOR = Several(Quantity("ratio", "a number"), _XYZ)
_POINT = Several(LENGTH, _XYZ)
_ANGLE = Quantity("angle", "an angle from -36000 to 36000 deg", least=-36000.0, most=36000.0, degrees=True)
_SHARE = Quantity("ratio", "a number from 0 to 1000", least=0.0, most=1000.0)
_SMALL = Quantity("ratio", "a number from 0 to 1", least=0.0, most=1.0)
_PIXELS = Whole("a whole number from 1 to 32768", 1, 32768)
_COLOURS = Several(ColourValue(), ("first", "second"))
_NAME = Text(
    "a name of letters, digits, - and _, beginning with a letter", 60, pattern="[A-Za-z][A-Za-z0-9_-]*"
)
_EFFECT = Text("the name of an effect", 40, pattern="[a-z_]+")
_FILE = Text("a relative file name of 1 to 300 characters", 300)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetSpec:
    """Section [sheet]: a sheet of the scene, and how exactly rays pass it.

    `design` and `mesh` (triangles as written) are files, relative to the scene's folder; `set` is laid over
    the design. A scene of several sheets lists them as [[sheet]], each with an `id` and a height `z`.
    """

    id: str = keys.key(_NAME, "name of the sheet, for animation, --set, plan and forecast", "")
    z: float = keys.key(LENGTH_FROM_0, "position of the sheet's own z = 0; 0 for the first", 0.0)
    design: str = keys.key(_FILE, "design file", keys.REQUIRED)
    set: Mapping[str, Any] = keys.key(
        Anything('a table of design keys: { "law.eta" = [-0.25, -1.0] }'), "changed design keys", None
    )
    rung: Literal["auto", "law", "thin", "surfaces", "mesh"] = keys.key(
        Word(("auto", "law", "thin", "surfaces", "mesh")), "how exactly rays pass the sheet", "auto"
    )
    mesh: str | None = keys.key(_FILE, "rung mesh: triangles as written")
    quads: int = keys.key(
        Whole("a whole number from 1 to 256", 1, 256), "rung mesh without a file: quads a cell side", 16
    )
    surround: Literal["see-through", "opaque"] = keys.key(
        Word(("see-through", "opaque")), "what is seen next to the sheet", "see-through"
    )
    tint: tuple[float, float, float] = keys.key(
        Several(_SMALL, ("red", "green", "blue")),
        "linear transmission per colour of what is seen through the only sheet",
        (1.0, 1.0, 1.0),
    )
    continuous: bool = keys.key(
        Flag(), "rung law of a law that varies: by the law at the very point, not of the cell hit", False
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """Section [camera]: pinhole, or an opening of finite diameter, before the sheet; scene units.

    `frame` None: given by `fov`, in radians; `focus` None: the target's distance. `samples` are rays per
    pixel; where `noise` > 0 requires more, up to `most_samples`.
    """

    position: Vector = keys.key(_POINT, "position of the camera, z < 0", keys.REQUIRED)
    target: Vector = keys.key(_POINT, "what it looks at", (0.0, 0.0, 0.0))
    up: Vector = keys.key(_VECTOR, "direction that is up in the picture", (0.0, 1.0, 0.0))
    frame: float | None = keys.key(LENGTH_ABOVE_0, "width of the picture at the target")
    fov: float | None = keys.key(
        Quantity("angle", "an angle > 0, below 180 deg", above=0.0, most=3.14), "full width as an angle"
    )
    pixels: tuple[int, int] = keys.key(
        Several(_PIXELS, ("width", "height"), single=True), "size of the picture", (660, 660)
    )
    samples: int = keys.key(Whole("a whole number from 1 to 65536", 1, 65536), "rays a pixel", 9)
    noise: float = keys.key(
        _SMALL, "standard error of a pixel at which sampling stops; 0: a fixed number of rays", 0.0
    )
    most_samples: int = keys.key(
        Whole("a whole number from 1 to 65536", 1, 65536), "rays a pixel at most", 256
    )
    aperture: float = keys.key(LENGTH_FROM_0, "diameter of the lens's opening; 0 is a pinhole", 0.0)
    focus: float | None = keys.key(LENGTH_ABOVE_0, "distance of the sharp plane; default: the target's")
    exposure: float = keys.key(_SHARE, "factor on the light when it is written to a file", 1.0)
    mirror: bool = keys.key(
        Flag(), "left-handed view, x to the right, as the paper's renderer draws it", False
    )
    encoding: Literal["srgb", "linear"] = keys.key(
        Word(("srgb", "linear")), "encoding of picture files", "srgb"
    )

    def width_at(self, distance: float) -> float:
        """Width of the picture at the target, `distance` from the camera; scene lengths."""
        if self.frame is not None:
            return self.frame
        assert self.fov is not None  # the scene's rules require one of the two
        return 2.0 * distance * tan(0.5 * self.fov)


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """Section [light]: light on the objects, radiance = colour · (ambient + key · max(0, n · l)).

    `spectrum` is a wavelength in metres, a word of `clacad.design.sections.SPECTRA`, or a list of lines with
    weights: the list, "visible" and "photopic" are those of a design's [light]. Directions of polarisation in
    degrees from the x axis, before and behind the sheet.
    """

    ambient: float = keys.key(_SHARE, "light from everywhere", 0.35)
    key: float = keys.key(_SHARE, "light from one direction", 0.65)
    direction: Vector = keys.key(_VECTOR, "towards that light", (-0.4, 0.8, -0.45))
    spectrum: Literal["rgb", "D65", "visible", "photopic"] | float | tuple[LineSpec, ...] = keys.key(
        WordOr(
            ("rgb", "D65", "visible", "photopic"),
            ListOr(LINES, Quantity("wavelength", "a wavelength from 10 nm to 1 mm", least=1e-8, most=1e-3)),
        ),
        "one wavelength, three lines, daylight in nine samples, or lines as in a design's [light]",
        550e-9,
    )
    polariser: float | None = keys.key(_ANGLE, "direction the scene's light is polarised in")
    analyser: float | None = keys.key(_ANGLE, "direction of an analyser before the camera")

    @property
    def lines(self) -> dict[float, float]:
        """Lines of the light: wavelength in metres → weight."""
        return lines_of(self.spectrum)


@dataclass(frozen=True, slots=True, kw_only=True)
class Background:
    """Section [background]: sky, linear in elevation from horizon (second) to zenith, and ground."""

    sky: tuple[Rgb, Rgb] = keys.key(
        Several(ColourValue(), ("zenith", "horizon")),
        "colours of the sky",
        ((0.275, 0.468, 0.745), (0.855, 0.896, 0.939)),
    )
    ground: Rgb = keys.key(
        ColourValue(), "seen below the horizon where there is no floor", (0.1845, 0.1845, 0.1845)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectsSpec:
    """Section [effects]: effects to simulate.

    Mode list: exactly `list`; mode auto: plus `force`, minus `without`. `angle` in radians; None: half a
    pixel, never under 0.15 mrad.
    """

    mode: Literal["auto", "list", "none"] = keys.key(
        Word(("auto", "list", "none")), "how effects are chosen", "auto"
    )
    list: tuple[str, ...] = keys.key(ListOf(_EFFECT, "texts"), "mode list: exactly these", ())
    force: tuple[str, ...] = keys.key(ListOf(_EFFECT, "texts"), "auto plus these", ())
    without: tuple[str, ...] = keys.key(ListOf(_EFFECT, "texts"), "auto minus these", ())
    angle: float | None = keys.key(
        WordOr(("auto",), Quantity("angle", "an angle > 0", above=0.0, most=1.6), absent="auto"),
        "smallest angle that matters",
    )
    radiance: float = keys.key(_SMALL, "smallest relative radiance that matters", 0.01)
    coating: Literal["none", "quarter-wave"] = keys.key(
        Word(("none", "quarter-wave")), "fresnel: coating of the faces", "none"
    )
    order: int = keys.key(Whole("a whole number from 1 to 4", 1, 4), "reflections: how many in a path", 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneObject:
    """[[object]]: one visible object; its `kind` determines which keys apply, see `KEYS_OF`, and its size,
    see
    `SIZES`. Lengths in scene units, angles in degrees, colours in linear light.

    Parameters
    ----------
    parts : tuple of SceneObject
        Of a group, relative to its `at`.
    """

    id: str = keys.key(
        Text("a name of letters, digits, - and _", 60, pattern="[A-Za-z0-9_-]+"), "name for animation"
    )
    kind: str = keys.key(Word(tuple(KEYS_OF)), "what it is", keys.REQUIRED)
    at: Vector = keys.key(
        _POINT,
        "where it is: centre of sphere, box and screen, middle of the foot of all else",
        (0.0, 0.0, 0.0),
    )
    size: tuple[float, ...] = keys.key(Size(), "how large it is")
    turn: Vector = keys.key(
        Several(_ANGLE, _XYZ),
        "turns about the fixed x, y, z axes through `at`, in this order",
        (0.0, 0.0, 0.0),
    )
    colour: Rgb = keys.key(ColourValue(), "its colour", (0.5, 0.5, 0.5))
    height: float = keys.key(LENGTH, "checker: y of the floor", 0.0)
    tile: float = keys.key(LENGTH_ABOVE_0, "checker: side of a tile", 1.0)
    reach: float | None = keys.key(LENGTH_ABOVE_0, "checker: how far along a ray the floor is drawn")
    colours: tuple[Rgb, Rgb] = keys.key(
        _COLOURS,
        "checker: odd and even tiles; stripes: the two stripes",
        ((0.687, 0.539, 0.323), (0.105, 0.05, 0.019)),
    )
    file: str | None = keys.key(_FILE, "mesh or picture")
    up: str = keys.key(Word(("y", "z")), "mesh: which axis of the file points up", "y")
    pattern: str = keys.key(
        Word(("colour", "coordinates", "image", "stripes")), "screen: what it shows", "colour"
    )
    period: float | None = keys.key(LENGTH_ABOVE_0, "stripes: width of a pair of stripes")
    parts: tuple[SceneObject, ...] = keys.key(
        Anything("a list of tables, each an object"), "group: what it is made of"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class WrittenMove:
    """[[animation.move]]: one key of the scene that changes with time, as a file has it."""

    key: Any = keys.key(
        Text("a key of the scene, such as object.knight.at.2", 200), "what moves", keys.REQUIRED
    )
    first: Any = keys.key(NumberOrRow(), "value in the first frame", name="from")
    last: Any = keys.key(NumberOrRow(), "value in the last frame", name="to")
    values: Any = keys.key(Numbers(rows=True), "values it takes, straight lines between them")
    times: Any = keys.key(Numbers(), "when, 0 to 1, rising")
    ease: Any = keys.key(Word(("linear", "smooth")), "how the time runs", "linear")


@dataclass(frozen=True, slots=True)
class Move:
    """One key of the scene that changes with time.

    Parameters
    ----------
    key : str
        "object.<id>.<key>[.index]", "sheet.set.<design key>[.index]", of several sheets
        "sheet.<id>.set.<design key>[.index]"
        or "sheet.<id>.<key>", or "camera.<key>[.index]".
    times : tuple of float
        0 … 1, ascending.
    values : tuple
        A number, or a tuple of numbers, for each time; linear interpolation in between.
    ease : {"linear", "smooth"}
        Time profile: smooth starts and ends at rest (3t² − 2t³).
    """

    key: str
    times: tuple[float, ...]
    values: tuple[Any, ...]
    ease: Literal["linear", "smooth"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Animation:
    """Section [animation]: number of frames, and the keys that change."""

    frames: int = keys.key(
        Whole("a whole number from 2 to 100000", 2, 100_000), "number of frames", keys.REQUIRED
    )
    fps: float = keys.key(
        Quantity("ratio", "a number > 0, at most 240", above=0.0, most=240.0), "frames a second", 25.0
    )
    moves: tuple[Move, ...] = keys.key(
        Anything("one table [[animation.move]] for each moved key"), "what moves", keys.REQUIRED, name="move"
    )


MOST_SHEETS: Final = 26
"""Largest number of sheets in a scene, as in a stack."""

ROOT: Final = head_keys(
    "name of the scene, used for files", "unit of every bare length here; the design keeps its own", "remarks"
)
_EVERY = keys_of(SheetSpec)
SHEET: Final = {name: key for name, key in _EVERY.items() if name not in ("id", "z")}
"""Keys of [sheet], the only one."""
STACKED: Final = {
    name: replace(key, default=REQUIRED) if name == "id" else key
    for name, key in _EVERY.items()
    if name != "tint"
}
"""Keys of a [[sheet]]; a scene may have several."""

SECTIONS: Final[dict[str, dict[str, Key]]] = {
    "sheet": SHEET,
    "camera": keys_of(Camera),
    "light": keys_of(Light),
    "background": keys_of(Background),
    "effects": keys_of(EffectsSpec),
    "animation": keys_of(Animation),
}
OBJECT: Final = keys_of(SceneObject)
MOVE: Final = keys_of(WrittenMove)

SCENE: Final = FileForm(
    ROOT,
    SECTIONS,
    optional=("light", "background", "effects", "animation"),
    synonyms={
        "color": "colour",
        "colors": "colours",
        "position": "at",
        "centre": "at",
        "center": "at",
        "rotation": "turn",
        "rotate": "turn",
        "type": "kind",
        "name": "id",
        "texture": "file",
        "image": "file",
        "resolution": "pixels",
        "width": "frame",
        "look_at": "target",
        "eye": "position",
        "spp": "samples",
        "objects": "object",
        "aperture_diameter": "aperture",
        "wavelength": "spectrum",
        "axis": "up",
    },
    elsewhere=dict.fromkeys(set(DESIGN_SECTIONS) - set(SECTIONS), ("design", "sheet.set")),
    lists={"object": OBJECT},
)
"""Keys of a scene file, their other names, and the sections of a design file."""


def keys_of_object(kind: object) -> dict[str, Key]:
    """Keys that an object of a kind has; all keys of objects for an unknown kind."""
    own = KEYS_OF.get(kind) if isinstance(kind, str) else None
    return OBJECT if own is None else {name: OBJECT[name] for name in ("id", "kind", *own)}


def scene_schema() -> JsonSchema:
    """Return the JSON Schema (2020-12) of a scene file, for editors that complete keys.

    Returns: With `$schema`, `title` and one property for each key; unknown keys are refused, and each kind of
        object accepts only its own keys.
    """
    defined = {name: schema.table(keys) for name, keys in SECTIONS.items()}
    defined["animation"]["properties"]["move"] |= _list_of("move", minItems=1)
    defined["move"], defined["stacked_sheet"] = schema.table(MOVE), schema.table(STACKED)
    defined["object"] = {"oneOf": [_object_schema(kind) for kind in KEYS_OF]}
    properties = schema.properties_of(ROOT) | {name: _reference(name) for name in SECTIONS}
    several = _list_of("stacked_sheet", minItems=1, maxItems=MOST_SHEETS)
    properties["sheet"] = {"anyOf": [properties["sheet"], several]}
    properties["object"] = _list_of("object")
    needed = schema.required_of(ROOT) + [name for name in SECTIONS if name not in SCENE.optional]
    return schema.document("clacad scene", properties, needed, defined)


def _reference(name: str) -> JsonSchema:
    return {"$ref": f"#/$defs/{name}"}


def _list_of(name: str, **limits: int) -> JsonSchema:
    return {"type": "array", "items": _reference(name), **limits}


def _object_schema(kind: str) -> JsonSchema:
    """Schema of one kind of object."""
    made = schema.table(keys_of_object(kind))
    made["properties"]["kind"] = {"const": kind, "description": OBJECT["kind"].about}
    if "parts" in made["properties"]:
        made["properties"]["parts"] |= _list_of("object")
    return made
