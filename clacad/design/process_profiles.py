"""Capabilities of fabrication processes and their materials: limits in metres, each with the source of the
number; and tolerance classes.

`none` means geometry only: a part must exist, nothing more. The numbers are typical of service shops. They
are limits for checking a design, not promises of any machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import radians
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from clacad.optics.material.material import Material


@dataclass(frozen=True, slots=True)
class ProcessProfile:
    """Limits of one process, lengths in metres.

    edge, neck : Least thickness at the edge of the part, and between neighbouring lenslets.
    radius : Least radius of curvature (given by tool nose, voxel or spot size).
    sag : Greatest structure height.
    pitch : Least lenslet pitch.
    clearance : Least air gap between two bodies.
    tool : Nose radius of the tool: the least radius of an inner corner. 0: there is no tool.
    wall : Highest vertical step between neighbours.
    draft : radians. Least angle of walls and faces to the direction of mould, tool or light.
    slope : radians. Steepest slope of a face against the sheet.
    voxel : Lateral size of a voxel, pixel or spot. 0: continuous.
    layer : Thickness of a layer, or height of a level. 0: continuous.
    aspect : Greatest height over width of a wall or groove.
    undercut : Whether faces may overhang.
    part_height, part_width : float
        Greatest height of a whole part, and greatest side of its bounding rectangle, seen along z.
    materials : Kinds and names of materials that can be worked; empty: any.
    source : Source of the numbers.
    made : What the process leaves, see `clacad.design.process`: nose, feed, spot, gamma, levels, layer,
        shrinkage in the sheet (`lateral`) and in height, sink; metres and ratios. substrate: 1 where the
        lenslets alone shrink, on a base that keeps its thickness.
    made_source : Source of those.
    """

    name: str
    edge: float
    neck: float
    radius: float
    sag: float
    pitch: float
    clearance: float
    tool: float
    wall: float
    draft: float
    slope: float
    voxel: float
    layer: float
    aspect: float
    undercut: bool
    part_height: float
    part_width: float
    materials: tuple[str, ...]
    source: str
    made: Mapping[str, float]
    made_source: str

    def works(self, material: Material) -> bool:
        """Whether a material can be worked."""
        return not self.materials or material.kind in self.materials or material.name in self.materials


_LIMITS = """
part         none  diamond-turning  two-photon  greyscale  moulding  sla
edge         0     0.5e-3           2e-6        100e-6     0.8e-3    0.5e-3
neck         0     50e-6            1e-6        1e-6       0.1e-3    0.2e-3
radius       0     50e-6            2e-6        5e-6       20e-6     0.1e-3
sag          inf   2e-3             0.5e-3      100e-6     5e-3      50e-3
pitch        0     100e-6           5e-6        5e-6       50e-6     0.3e-3
clearance    0     50e-6            5e-6        10e-6      0.1e-3    0.1e-3
tool         0     25e-6            0           0          20e-6     0
wall         inf   1e-6             inf         5e-6       10e-6     inf
draft        0     5                0           15         1         0
slope        90    45               90          60         60        90
voxel        0     0                0.5e-6      1e-6       0         50e-6
layer        0     0                1e-6        0.1e-6     0         25e-6
aspect       inf   1                10          1          2         10
undercut     1     0                1           0          0         1
part_height  inf   0.1              8e-3        12e-3      25e-3     0.185
part_width   inf   0.2              0.1         0.2        0.3       0.145
"""
"""Fields of `ProcessProfile` by process; draft and slope in degrees."""

_MADE = """
part       none  diamond-turning  two-photon  greyscale  moulding  sla
nose       0     25e-6            0           0          20e-6     0
feed       0     2e-6             0           0          2e-6      0
spot       0     0                0.1e-6      0.4e-6     0         0
gamma      1     1                1           1          1         1
levels     0     0                0           256        0         0
layer      0     0                0.1e-6      0          0         25e-6
lateral    0     0                0           0          0.4e-2    1e-2
height     0     0                2e-2        0          0.4e-2    1e-2
sink       0     0                0           0          0         0
substrate  0     0                1           1          0         0
"""
"""Parameters of section [process] that a design leaves out, by process: metres and plain ratios."""

_MADE_SOURCES = (
    "an ideal process leaves nothing",
    "nose radius as in the limits; judged default: a feed of 2 micrometres, whose scallops of 20 "
    "nanometres peak to valley, 6 rms, follow from f^2/8r; Rhorer and Evans, Fabrication of optics by "
    "diamond turning (Handbook of Optics) is the reference work, its figures were not checked",
    "judged defaults: spots of 0.1 micrometres sigma for voxels of 0.2 to 0.5, slices 0.1 micrometres "
    "apart, 2 % of shrinkage in height on a base that is fixed; Ovsianikov et al., Optics Express 17, "
    "2143 (2009) measure a zirconium hybrid whose shrinkage follows the dose and is remarkably low well "
    "above threshold; figures of other resists were not looked up",
    "8-bit dose, 256 levels (EPFL Center of MicroNanoTechnology, Grayscale lithography); judged "
    "default: a laser spot of 1 micrometre is 0.4 sigma; depth over dose is not linear and is "
    "calibrated (Micromachines 8, 314 (2017))",
    "the insert is diamond turned; PMMA shrinks by 0.2 to 0.6 percent in the mould (International "
    "Journal of Polymer Science 2013, 610132, table 2); judged default: 0.4 percent, their middle",
    "layers of 25 micrometres, as in the limits; judged default: 1 percent of each length after "
    "printing; no figure of a maker of resins was found, users report parts within about 1 percent "
    "(forum.formlabs.com) and cubes of 35 millimetres that come out 34.8 long (J. Mrazek, "
    "blog.honzamrazek.cz, 2022)",
)

_WORKS: dict[str, tuple[str, ...]] = {
    "none": (),
    "diamond-turning": ("plastic", "crystal", "chalcogenide"),
    "two-photon": ("resin",),
    "greyscale": ("resin", "plastic", "elastomer", "Fused silica", "LITHOSIL-Q", "Silicon", "Germanium"),
    "moulding": ("plastic", "elastomer", "chalcogenide", "P-BK7", "P-SK57", "P-LASF47", "P-SF68"),
    "sla": ("Acrylate resin",),
}
"""Kinds and names of materials that each process works."""

_SOURCES = (
    "geometry only",
    "single-crystal tool nose radii of 25 to 50 micrometres, clearance angles of 5 to 15 degrees and"
    " servo strokes of a few millimetres; no vertical walls (slow tool servo: Micromachines 13, 1564"
    " (2022)); spindles that swing 300 millimetres, which is a square of 200; plastics, infrared"
    " crystals, chalcogenides and non-ferrous metals are cut, ordinary glass breaks and wears the tool",
    "voxels of 0.2 to 0.5 micrometres laterally and about 1 micrometre along the axis; objective working"
    " distances of a few hundred micrometres; parts up to 8 millimetres high on a stage of 100"
    " (commercial printers); photoresists and resins only",
    "laser spots of about 1 micrometre, grey levels of about 0.1 micrometre, walls that come out at 75"
    " degrees at best and resist films of up to about 100 micrometres; substrates up to 200 millimetres"
    " wide and 12 thick; the part is the resist, a cast or embossed copy of it, or etched from it into"
    " silica, silicon or germanium",
    "least wall of about 0.8 mm for filling acrylic; draft of 1 degree for release; the insert is diamond"
    " machined; thicker parts sink as they cool; thermoplastics, silicone, and glasses made for moulding",
    "pixels and layers of 25 to 50 micrometres; the thinnest self-supporting wall of about 0.2 mm; "
    "build volume 145 x 145 x 185 mm (Formlabs Form 3); acrylate resins only",
)


def _profiles() -> Iterator[ProcessProfile]:
    made = _columns(_MADE)
    sources = zip(_SOURCES, _MADE_SOURCES, strict=True)
    for (name, numbers), (source, made_source) in zip(_columns(_LIMITS).items(), sources, strict=True):
        limits: dict[str, Any] = dict(numbers)
        angles = {key: radians(limits[key]) for key in ("draft", "slope")}
        undercut = bool(limits["undercut"])
        yield ProcessProfile(
            **{**limits, **angles, "undercut": undercut},
            name=name,
            materials=_WORKS[name],
            source=source,
            made=made[name],
            made_source=made_source,
        )


def _columns(text: str) -> dict[str, dict[str, float]]:
    """Numbers of a table by the names of its columns, then of its rows."""
    (_, *names), *rows = (line.split() for line in text.split("\n")[1:-1])
    return {name: {row[0]: float(row[k + 1]) for row in rows} for k, name in enumerate(names)}


_PROFILES = tuple(_profiles())


def profiles() -> tuple[ProcessProfile, ...]:
    """All process profiles, "none" first."""
    return _PROFILES


def profile(name: str) -> ProcessProfile:
    """Return the profile with a name.

    Raises KeyError: Unknown name; the design file's reader refuses those with a suggestion.
    """
    return {p.name: p for p in _PROFILES}[name]


@dataclass(frozen=True, slots=True)
class ToleranceClass:
    """Tolerances that a process keeps by published figures.

    values : Keys of [tolerances] with their values as written in a design file.
    source : Document of each figure.
    """

    name: str
    values: Mapping[str, Any]
    source: str


_APOLLO: Final = (
    "Apollo Optical Systems, Manufacturing Tolerances (on its site, undated), column {}; decentre is its"
    " concentricity of one surface to the other"
)
_MOULDED: Final = "injection moulding, {}"

TOLERANCE_CLASSES: Final[Mapping[str, ToleranceClass]] = {
    name: ToleranceClass(name, values, source)
    for name, values, source in (
        (
            "moulding-precision",
            {"decentre": ["0 um", "15 um"], "radius": 0.005, "thickness": "15 um", "roughness": "5 nm"},
            _APOLLO.format(_MOULDED.format("precision")),
        ),
        (
            "moulding-commercial",
            {"decentre": ["0 um", "25 um"], "radius": 0.01, "thickness": "25 um", "roughness": "7.5 nm"},
            _APOLLO.format(_MOULDED.format("commercial")),
        ),
        (
            "turning",
            {"decentre": ["0 um", "5 um"], "radius": 0.005, "thickness": "20 um", "roughness": "10 nm"},
            _APOLLO.format("single point diamond turning, commercial"),
        ),
        (
            "grinding",
            {
                "decentre": ["0 um", "10 um"],
                "radius": 0.001,
                "thickness": "20 um",
                "index": 5e-4,
                "roughness": "1 nm",
            },
            "Optimax, Tolerancing Limits for aspheric surfaces (vertex radius 0.1 %, roughness 10 Å), for"
            " spherical surfaces (thickness) and for cylinder surfaces (axis decentration); index: Optimax,"
            " Manufacturing Tolerance Chart, column precision (pages of its site, undated)",
        ),
        (
            "two-photon",
            {"decentre": ["0 um", "1 um"], "radius": 0.01, "roughness": "15 nm"},
            "roughness: rms below 15 nm, cited from Gissibl et al., Nature Photonics 10, 554 (2016), whose"
            " text was not checked; judged defaults: radius and decentre, no document states them",
        ),
        (
            "resin",
            {"decentre": ["0 um", "50 um"], "radius": 0.0025, "thickness": "200 um"},
            "radius: Forge Labs, Stereolithography Design Guide (undated), 0.25 % of a dimension; thickness:"
            " Additive3D Asia, What Tolerance Can SLA 3D Printing Achieve (undated), 0.2 mm of 100 mm;"
            " judged default: decentre, a pixel of the profile sla",
        ),
    )
}
"""Tolerance classes by name. None states a scatter from lenslet to lenslet: no published figure was found."""
