"""The sliders of the explorer: what can be moved, from where to where, and where a design starts."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan, degrees, hypot

from clacad.design import Design
from clacad.sheet.feasibility.pitch_for_eye import SEPARATIONS, VIEWING_DISTANCE
from clacad.sheet.vignetting import half_field, thin_cells
from clacad.sheet.window import Window

LAW, SHEET, VIEW = "Law", "Sheet", "View"

FILLS = 0.8
"""Part of the half field within which the whole sheet lies at the start, where the design names no place of the eye."""

MARGIN = 1.3
"""Angle of view at the start over the angle the sheet takes."""

SMALLEST_PITCH = 1e-7
"""Metres; finer cells are no matter of rays."""

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Slider:
    """One number that can be moved.

    Parameters
    ----------
    id : str
        Its name in the page's link.
    label, group, unit : str
    start, low, high : float
        Lengths in the design's unit, angles in degrees.
    log : bool
        Equal ratios along the slider instead of equal steps.
    about : str
        What it is, one line.
    """

    id: str
    label: str
    group: str
    unit: str
    start: float
    low: float
    high: float
    log: bool
    about: str

    @property
    def step(self) -> float:
        """Of the handle: of a thousand places where ratios are equal, else a four-hundredth of the range, rounded."""
        if self.log:
            return 1.0
        return float(f"{(self.high - self.low) / 400.0:.0e}")


def sheet_width(window: Window) -> Range:
    """Width and height (lengths) of all cells, including those that an outline cuts off."""
    x0, x1, y0, y1 = window.lattice.with_count(window.lattice.count).extent()
    return x1 - x0, y1 - y0


def places(design: Design, window: Window) -> tuple[float, float]:
    """Distances (lengths) of the eye and of what it looks at, where the page starts.

    Those of [check]; else ten separations, and the distance from which all of the sheet is seen within the field.
    """
    viewer, distance = design.check.viewer, design.check.object
    if viewer is None:
        reach = min(half_field(thin_cells(window)))
        whole = 0.5 * max(sheet_width(window)) / (FILLS * reach)
        viewer = float(f"{max(VIEWING_DISTANCE / window.unit, whole):.3g}")
    return viewer, SEPARATIONS * window.thin.separation if distance is None else distance


def sliders(design: Design, window: Window) -> tuple[Slider, ...]:
    """All sliders of a design, each with a range that holds the design's own value."""
    law, thin = design.to_dict()["law"], window.thin  # as the file has it: sliders move its keys
    pitch, separation = window.lattice.pitch[0], thin.separation
    eye, distance = places(design, window)
    fov = float(f"{2.0 * degrees(atan(MARGIN * 0.5 * max(sheet_width(window)) / eye)):.3g}")
    offset, (phi, theta, psi) = max(4.0 * pitch / separation, 2.0 * hypot(*law["delta"])), law["euler"]
    unit, eta, delta = design.unit, "−f2/f1: slopes leave as (t − δ)/η", "offset of lens 2 over f1"
    rows: tuple[tuple[str, str, str, str, float, Range, bool, str], ...] = (
        ("eta_x", "η x", LAW, "", law["eta"][0], (-3.0, 3.0), False, eta),
        ("eta_y", "η y", LAW, "", law["eta"][1], (-3.0, 3.0), False, eta),
        ("delta_x", "δ x", LAW, "", law["delta"][0], (-offset, offset), False, delta),
        ("delta_y", "δ y", LAW, "", law["delta"][1], (-offset, offset), False, delta),
        ("phi", "φ", LAW, "deg", phi, (-180.0, 180.0), False, "turn of the lenses about z"),
        ("theta", "θ", LAW, "deg", theta, (-60.0, 60.0), False, "turn of the lenses about x"),
        ("psi", "ψ", LAW, "deg", psi, (-180.0, 180.0), False, "turn of the lenses about z, once more"),
        ("pitch", "pitch", SHEET, unit, pitch, _pitches(window), True, "width of a cell; the sheet keeps its size"),
        ("separation", "separation", SHEET, unit, separation, (separation / 8.0, 8.0 * separation), True, "of the two lenses, in air"),
        ("object", "object behind", VIEW, unit, distance, (distance / 50.0, 50.0 * distance), True, "from array 2 to what is looked at"),
        ("eye", "eye before", VIEW, unit, eye, (eye / 20.0, 20.0 * eye), True, "from array 1 to the eye"),
        ("azimuth", "eye aside", VIEW, "deg", 0.0, (-60.0, 60.0), False, "angle of the eye off the sheet's normal, to x"),
        ("elevation", "eye above", VIEW, "deg", 0.0, (-60.0, 60.0), False, "angle of the eye off the sheet's normal, to y"),
        ("fov", "angle of view", VIEW, "deg", min(fov, 120.0), (min(0.05 * fov, 5.0), 120.0), True, "of the picture's shorter side"),
    )  # fmt: skip
    return tuple(
        Slider(id, label, group, unit, start, min(low, start), max(high, start), log, about)
        for id, label, group, unit, start, (low, high), log, about in rows
    )


def _pitches(window: Window) -> Range:
    """Pitches that leave room for seam and walls, and cells within the outline."""
    lattice, wall = window.lattice, 0.0 if window.baffle is None else window.baffle.wall
    aspect = min(1.0, lattice.pitch[1] / lattice.pitch[0])
    least = max(
        lattice.pitch[0] / 8.0,
        4.0 * max(window.land.seam, wall) / aspect,
        SMALLEST_PITCH / window.unit / aspect,
    )
    most = min(8.0 * lattice.pitch[0], 0.25 * min(sheet_width(window)))
    return min(least, lattice.pitch[0]), max(most, lattice.pitch[0])
