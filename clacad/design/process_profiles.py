"""What a fabrication process can make: limits in metres, each with where the number comes from.

`none` means geometry only: a part must exist, nothing more. The numbers are typical of service shops
and are limits to check a design by, not promises of any machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, pi, radians


@dataclass(frozen=True, slots=True)
class ProcessProfile:
    """Limits of one process, lengths in metres.

    Parameters
    ----------
    name : str
    edge, neck : float
        Least thickness at the edge of the part, and between neighbouring lenslets.
    radius : float
        Least radius of curvature (tool nose, voxel or spot size allow no less).
    sag : float
        Greatest structure height.
    pitch : float
        Least lenslet pitch.
    clearance : float
        Least air gap between two bodies.
    tool : float
        Nose radius of the tool: no inner corner is sharper. 0: there is no tool.
    wall : float
        Highest vertical step between neighbours.
    draft : float, radians
        Least angle of walls and faces to the direction in which mould, tool or light comes.
    slope : float, radians
        Steepest slope of a face against the sheet.
    voxel : float
        Lateral size of a voxel, pixel or spot. 0: continuous.
    layer : float
        Thickness of a layer, or height of a level. 0: continuous.
    aspect : float
        Greatest height over width of a wall or groove.
    undercut : bool
        Whether faces may overhang.
    source : str
        Where the numbers come from.
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
    source: str


_PROFILES = (
    ProcessProfile("none", 0.0, 0.0, 0.0, inf, 0.0, 0.0, 0.0, inf, 0.0, 0.5 * pi, 0.0, 0.0, inf, True, "geometry only"),
    ProcessProfile(
        "diamond-turning", 0.5e-3, 50e-6, 50e-6, 2e-3, 100e-6, 50e-6, 25e-6, 1e-6, radians(5.0), radians(45.0), 0.0,
        0.0, 1.0, False,
        "single-crystal tool nose radii of 25 to 50 micrometres, clearance angles of 5 to 15 degrees and servo strokes "
        "of a few millimetres; no vertical walls (slow tool servo: Micromachines 13, 1564 (2022))",
    ),
    ProcessProfile(
        "two-photon", 2e-6, 1e-6, 2e-6, 0.5e-3, 5e-6, 5e-6, 0.0, inf, 0.0, 0.5 * pi, 0.5e-6, 1e-6, 10.0, True,
        "voxels of 0.2 to 0.5 micrometres laterally and about 1 micrometre along the axis; objective working "
        "distances of a few hundred micrometres",
    ),
    ProcessProfile(
        "greyscale", 100e-6, 1e-6, 5e-6, 100e-6, 5e-6, 10e-6, 0.0, 5e-6, radians(15.0), radians(60.0), 1e-6, 0.1e-6,
        1.0, False,
        "laser spots of about 1 micrometre, grey levels of about 0.1 micrometre, walls that come out at 75 degrees at "
        "best and resist films of up to about 100 micrometres",
    ),
    ProcessProfile(
        "moulding", 0.8e-3, 0.1e-3, 20e-6, 5e-3, 50e-6, 0.1e-3, 20e-6, 10e-6, radians(1.0), radians(60.0), 0.0, 0.0,
        2.0, False,
        "least wall of about 0.8 mm for filling acrylic; draft of 1 degree for release; the insert is diamond machined",
    ),
    ProcessProfile(
        "sla", 0.5e-3, 0.2e-3, 0.1e-3, 50e-3, 0.3e-3, 0.1e-3, 0.0, inf, 0.0, 0.5 * pi, 50e-6, 25e-6, 10.0, True,
        "pixels and layers of 25 to 50 micrometres; the thinnest self-supporting wall of about 0.2 mm",
    ),
)  # fmt: skip


def profiles() -> tuple[ProcessProfile, ...]:
    """All process profiles, "none" first."""
    return _PROFILES


def profile(name: str) -> ProcessProfile:
    """Profile of that name.

    Raises
    ------
    KeyError
        Unknown name; the design file's reader refuses those with a suggestion.
    """
    return {p.name: p for p in _PROFILES}[name]
