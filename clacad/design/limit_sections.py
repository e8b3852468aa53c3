"""Sections [check], [tolerances] and [process] of a design file: each field is a key of the file.

Angles in radians, lengths in design units.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

from clacad.config.compound_kinds import REQUIRED, ListOf, Record, Several, key
from clacad.config.value_kinds import Quantity, Text, Whole, Word
from clacad.design.process_profiles import TOLERANCE_CLASSES

if TYPE_CHECKING:  # a design is read without numpy
    from clacad.base.types import Pair2

_LIMIT_ANGLE: Final = Quantity(
    "angle", "an angle > 0, at most 90 deg", above=0.0, most=math.pi / 2, bare=False
)
_NO_ANGLE: Final = Quantity(
    "angle", "an angle >= 0 and below 90 deg", least=0.0, most=math.pi / 2, bare=False
)
_DIOPTRES: Final = Quantity("ratio", "a number > 0, in dioptres (1/m)", above=0.0)
_PART_FROM_0: Final = Quantity("ratio", "a number >= 0, at most 1", least=0.0, most=1.0)
_LIMIT_LENGTH: Final = Quantity("length", "a length >= 0", least=0.0, bare=False)
_NAMED: Final = Quantity("length", "a length > 0", above=0.0, named=True)
_PART: Final = Quantity("ratio", "a number > 0, at most 1", above=0.0, most=1.0)
_FACTOR: Final = Quantity("ratio", "a number > 0, at most 1000", above=0.0, most=1000.0)
_SHRINKS: Final = Quantity("ratio", "a number from -0.5 to 0.5, or percent", least=-0.5, most=0.5)
_GAMMA: Final = Quantity("ratio", "a number from 0.25 to 4", least=0.25, most=4.0)
_ARRAYS: Final = ("array 1", "array 2")


@dataclass(frozen=True, slots=True)
class Allowed:
    """A warning that the designer accepts, with a reason."""

    code: str = key(Text("a code such as CL311", 5, pattern="CL[0-9]{3}"), "code of the warning", REQUIRED)
    reason: str = key(Text("a text of 1 to 500 characters", 500), "why it is accepted", REQUIRED)


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckSpec:
    """Section [check]: limits for checks of the built design and its files. Radians, design units.

    None means that the process profile gives the limit (`clearance edge neck radius sag part_height
    part_width materials pitch tool wall draft slope voxel layer aspect`), or that `law_rms` applies
    (`mesh_law_rms`). `confocality` is by default .002 for exact recipes, .02 for thin, best and given faces.
    """

    field: float = key(_LIMIT_ANGLE, "half angle of the cone of test rays", math.radians(1.0))
    field_centre: Literal["axis", "normal"] = key(Word(("axis", "normal")), "middle of that cone", "axis")
    process: str = key(
        Word(("none", "diamond-turning", "two-photon", "greyscale", "moulding", "sla")),
        "process profile",
        "none",
    )
    law_rms: float = key(_LIMIT_ANGLE, "limit of the rms law error", 0.003)
    law_bias: float = key(_LIMIT_ANGLE, "limit of the mean law error at a field point", 0.0025)
    law_white: float | None = key(
        _LIMIT_ANGLE, "limit of the rms law error, mean of the lines of white light"
    )
    temperature: float | None = key(
        _LIMIT_ANGLE, "limit of the rms change of direction over light.temperature"
    )
    mesh_law_rms: float | None = key(_LIMIT_ANGLE, "limit of the rms law error through facets")
    eta: float = key(_PART, "limit of the relative error of eta", 0.01)
    delta: float = key(_PART, "limit of the error of delta", 0.005)
    confocality: float = key(_PART, "limit of the afocal defect over the separation")
    throughput: float = key(_PART, "least share of the closed form that must pass", 0.9)
    cover: float = key(_PART, "least share of each optical cell that is lens", 1.0 - 1e-9)
    clearance: float | None = key(_LIMIT_LENGTH, "least gap between the bodies")
    graph: float = key(_PART, "least z component of a face's normal", 0.1)
    edge: float | None = key(_LIMIT_LENGTH, "least edge thickness (instead of the profile's)")
    neck: float | None = key(_LIMIT_LENGTH, "least neck thickness (instead of the profile's)")
    radius: float | None = key(_LIMIT_LENGTH, "least radius of curvature (instead of the profile's)")
    sag: float | None = key(_LIMIT_LENGTH, "largest sag (instead of the profile's)")
    part_height: float | None = key(
        _LIMIT_LENGTH, "greatest height of a whole part (instead of the profile's)"
    )
    part_width: float | None = key(_LIMIT_LENGTH, "greatest width of a whole part (instead of the profile's)")
    materials: tuple[str, ...] | None = key(
        ListOf(Text("the name of a material", 60), "texts"),
        "materials that can be worked (instead of the profile's)",
    )
    pitch: float | None = key(_LIMIT_LENGTH, "least pitch (instead of the profile's)")
    tool: float | None = key(_LIMIT_LENGTH, "nose radius of the tool (instead of the profile's)")
    wall: float | None = key(_LIMIT_LENGTH, "highest step between neighbours (instead of the profile's)")
    draft: float | None = key(
        _NO_ANGLE, "least angle of walls and faces to the sheet's normal (instead of the profile's)"
    )
    slope: float | None = key(_LIMIT_ANGLE, "steepest slope of a face (instead of the profile's)")
    voxel: float | None = key(
        _LIMIT_LENGTH, "lateral size of a voxel, pixel or spot (instead of the profile's)"
    )
    layer: float | None = key(_LIMIT_LENGTH, "thickness of a layer (instead of the profile's)")
    aspect: float | None = key(_FACTOR, "greatest height over width of a feature (instead of the profile's)")
    volume: float = key(_PART, "limit of the relative error of a file's volume", 1e-9)
    shape: float = key(_FACTOR, "limit of a mesh's sag error over the stated one", 1.1)
    file_rms: float = key(_FACTOR, "limit of a mesh's direction error over its forecast", 1.25)
    pose: float = key(_PART, "limit of a returned file's pose residual over the pitch", 0.05)
    scale: float = key(_PART, "limit of a returned file's shrink", 0.001)
    fresnel_number: float = key(_FACTOR, "Fresnel number below which a warning is given", 10.0)
    viewed: float = key(
        _PART,
        "least share of the viewer's light that must obey the law over the whole sheet",
        0.9,
        later=True,
    )
    field_throughput: float = key(
        _PART,
        "least share of thin lenses that a pair with a field lens passes at 0.9 of its full field",
        0.95,
        later=True,
    )
    scan_seam: float = key(
        _PART,
        "largest share of the light through a made or measured part that may meet a seam, or a place without"
        " points",
        0.15,
        later=True,
    )
    viewer: float | None = key(
        _NAMED, "distance of the eye before array 1 (1 m); where written, the check viewed judges"
    )
    object: float | None = key(_NAMED, "distance behind the sheet of what is looked at (ten separations)")
    allow: tuple[Allowed, ...] = key(
        ListOf(Record(Allowed), "tables"), "warnings that are accepted, each with a reason", ()
    )

    @property
    def of_light(self) -> tuple[float, float, float, float, float]:
        """Limits of light through a file: rms and bias (radians), eta (relative), delta, confocality."""
        rms = self.law_rms if self.mesh_law_rms is None else self.mesh_law_rms
        return rms, self.law_bias, self.eta, self.delta, self.confocality


@dataclass(frozen=True, slots=True, kw_only=True)
class TolerancesSpec:
    """Section [tolerances]: fabrication errors, and limits of a good sheet in addition to those of [check].
    Lengths in design units, angles in radians, `residual_power` in 1/m.

    A field lens on its own plate, and every plate between the first and the last of a list, has the larger
    tolerance of the two arrays. Each tolerance t means ±t
    (roughness and nose: 0 … t); 0 means no error. A scatter is a standard deviation from lenslet to lenslet,
    the same on every sheet. `grade` is the key `class`, whose values replace absent ones.
    """

    grade: str | None = key(
        Word(tuple(TOLERANCE_CLASSES)),
        "process whose published tolerances apply where none are stated",
        name="class",
        later=True,
    )

    decentre: Pair2 = key(
        Several(_LIMIT_LENGTH, _ARRAYS, single=True), "an array's displacement in x and in y", (0.0, 0.0)
    )
    rotation: float = key(_NO_ANGLE, "turn of array 2 against array 1 about the sheet's normal", 0.0)
    separation: float = key(
        _LIMIT_LENGTH,
        "displacement of array 2 along the sheet's normal (not for a slab); of listed plates each gap",
        0.0,
    )
    radius: Pair2 = key(
        Several(_PART_FROM_0, _ARRAYS, single=True), "relative error of the radii of a face", (0.0, 0.0)
    )
    index: float = key(_PART_FROM_0, "error of the refractive index of a body", 0.0)
    thickness: Pair2 = key(
        Several(_LIMIT_LENGTH, _ARRAYS, single=True), "error of a centre thickness", (0.0, 0.0)
    )
    tilt: float = key(_NO_ANGLE, "tilt of array 2 against array 1 about x and about y", 0.0)
    roughness: float = key(_LIMIT_LENGTH, "rms roughness of the optical faces, from 0 up", 0.0)
    shrinkage: float = key(
        _PART_FROM_0, "error of the shrinkage of all lens faces in height, by the process", 0.0, later=True
    )
    shrinkage_lateral: float = key(
        _PART_FROM_0, "error of the shrinkage of all lens faces in x and y, by the process", 0.0, later=True
    )
    gamma: float = key(
        _PART_FROM_0,
        "error of the power by which the process changes the heights of all lens faces",
        0.0,
        later=True,
    )
    nose: float = key(
        _LIMIT_LENGTH,
        "radius from 0 up of a tool nose, which rounds the valleys between lenslets",
        0.0,
        later=True,
    )
    scatter_pitch: Pair2 = key(
        Several(_LIMIT_LENGTH, _ARRAYS, single=True),
        "rms displacement of the single lenslets of a face in x and in y",
        (0.0, 0.0),
        later=True,
    )
    scatter_radius: Pair2 = key(
        Several(_PART_FROM_0, _ARRAYS, single=True),
        "rms relative error of the radii of the single lenslets of a face",
        (0.0, 0.0),
        later=True,
    )
    scatter_vertex: Pair2 = key(
        Several(_LIMIT_LENGTH, _ARRAYS, single=True),
        "rms displacement of the single lenslets of a face along the sheet's normal",
        (0.0, 0.0),
        later=True,
    )
    distribution: Literal["normal", "uniform"] = key(
        Word(("normal", "uniform")),
        "normal: a tolerance is two standard deviations; uniform: it is the end",
        "normal",
    )
    samples: int = key(
        Whole("a whole number from 1 to 1e7", most=10_000_000), "sheets drawn by Monte Carlo", 1000
    )
    seed: int = key(
        Whole("a whole number from 0 to 1e9", least=0, most=1_000_000_000), "seed of the draws", 0
    )
    compensator: str | None = key(
        Text("the name of an error, as clacad tolerance prints it", 40),
        "error set on each sheet to the least law error, such as separation or gap.1: a spacer or focus",
        later=True,
    )
    image_shift: float | None = key(_LIMIT_ANGLE, "largest image shift of a good sheet")
    blur: float | None = key(_LIMIT_ANGLE, "largest rms blur of a good sheet")
    residual_power: float | None = key(_DIOPTRES, "largest residual power of a good sheet")
    moire_period: float | None = key(_LIMIT_LENGTH, "least moire period of a good sheet")

    @staticmethod
    def of_array(halves: Pair2, array: int) -> float:
        """Tolerance of array 0 or 1; for a field lens, which has none of its own, the larger of the two."""
        return halves[array] if array < 2 else max(halves)

    def of_body(self, number: int, bodies: int) -> float:
        """Tolerance (length) of the thickness of body 1, 2 …; of a plate between two, the larger one."""
        return max(self.thickness) if 1 < number < bodies else self.thickness[min(number, 2) - 1]


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessSpec:
    """Section [process]: what the process of `check.process` leaves; lengths in design units.

    None means that the profile of the process gives the value (`clacad explain diamond-turning`).
    """

    nose: float | None = key(_LIMIT_LENGTH, "radius of the tool nose")
    feed: float | None = key(_LIMIT_LENGTH, "distance of neighbouring passes of the tool")
    spot: float | None = key(_LIMIT_LENGTH, "standard deviation of a Gaussian writing spot")
    gamma: float | None = key(_GAMMA, "a height u of 0 to 1 becomes u^gamma; the top stays")
    curve: str | None = key(
        Text("the name of a CSV file", 500), "table of level and depth by which heights come out"
    )
    levels: int | None = key(
        Whole("a whole number from 0 to 65536", least=0, most=65536), "number of height levels; 0: continuous"
    )
    layer: float | None = key(_LIMIT_LENGTH, "thickness of a layer, or height of a level")
    shrinkage: tuple[float, float, float] | None = key(
        Several(_SHRINKS, ("x", "y", "z"), single=True),
        "the made length is the requested one times 1 - shrinkage",
    )
    thickness: float | None = key(
        _SHRINKS, "shrinkage of the thickness between two faces, where a base keeps it (else that along z)"
    )
    sink: float | None = key(_LIMIT_LENGTH, "depth by which the middle of a moulded lenslet sinks")
    command: str | None = key(
        Text("the name of a folder", 500), "folder of `clacad correct`: its forms are added in tooling"
    )
