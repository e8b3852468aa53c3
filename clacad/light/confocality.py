"""Confocality measured with light: parabasal rays next to the axis ray, through the faces as built.

The measurement does not use how the radii were computed. The window's faces are traced as explicit surfaces
and the exit direction is differentiated by the entrance height. Lens 2 is then slid along its axis until the
pair is afocal, or has the requested focus. The defect is that slide over the distance between the lenses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clacad.base.types import Floats
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import STEP, Interface, parabasal, trace_sequence
from clacad.sheet.bundle import asked_power
from clacad.sheet.like_cell import interfaces, lens_distance
from clacad.sheet.window import PLANE, Window

__all__ = ["Confocality", "confocality"]


@dataclass(frozen=True, eq=False)
class Confocality:
    """Slide of lens 2 that makes the pair afocal.

    shift : (2,) lengths
        How far lens 2 must move along the axis, per lens meridian; NaN in a meridian without power.
    distance : length. Distance between the lenses along the axis; for a slab, in glass.
    power : (2, 2) radians/length
        Change of exit direction with entrance height, lens frame, as built, minus the requested change.
    """

    shift: Floats
    distance: float
    power: Floats

    @property
    def defect(self) -> float:
        """Largest |shift| over the distance."""
        return float(np.nanmax(np.abs(self.shift))) / self.distance

    @property
    def astigmatism(self) -> float:
        """Difference of the two meridians over the distance; 0 if only one has power."""
        return (
            0.0 if np.isnan(self.shift).any() else float(abs(self.shift[0] - self.shift[1])) / self.distance
        )


def confocality(window: Window) -> Confocality:
    """Measure how far the pair as built is from confocal, with each lens centred on the axis ray.

    Notes
    -----
    Lens 2, and a field lens before it, are first moved sideways so that the axis ray hits their apexes: the
    offset δ does not enter this check.
    The power is nearly linear in the slide, so the secant through two slides finds its zero in a few rounds.
    """
    turn = window.thin.rotation
    arrays = [face.array for face in window.faces]
    along = window.faces[arrays.index(1)].rotation[:, 2]
    distance = lens_distance(window)
    size = STEP * window.lattice.circumradius
    start = axis_start(window, turn[:, 2])
    field = field_onto_axis(window, start)
    aside = _onto_axis(window, 1, turn[:, 2], start, along, field)

    asked = np.diag(asked_power(window))

    def power(slide: float) -> Floats:
        slopes = parabasal(interfaces(window, aside + slide * along, field), turn, start, size).slopes
        return slopes + asked if asked.any() else slopes

    as_built = power(0.0)
    if not np.isfinite(as_built).all():
        raise ValueError("light near the axis ray does not get through")
    step = 1e-3 * distance
    shift, powered = np.zeros(2), np.ones(2, dtype=bool)
    for _ in range(8):
        here = np.array([power(float(s))[k, k] for k, s in enumerate(shift)])
        slope = (np.array([power(float(s) + step)[k, k] for k, s in enumerate(shift)]) - here) / step
        powered = np.abs(slope) > 1e-6 * np.max(np.abs(slope))
        change = np.where(powered, -here / np.where(powered, slope, 1.0), 0.0)
        shift = shift + change
        if np.max(np.abs(change)) <= 1e-10 * distance:
            break
    return Confocality(np.where(powered, shift, np.nan), distance, as_built)


def field_onto_axis(window: Window, start: Floats) -> Floats | None:
    """Slide (3,) of the field lens that puts its first apex on the axis ray from `start` (3,), lengths, or
    None.

    Raises ValueError: The axis ray does not reach the field lens.
    """
    if not window.field_array:
        return None
    axis = window.thin.rotation[:, 2]
    return _onto_axis(window, 2, axis, start, axis, None)


def axis_start(window: Window, axis: Floats) -> Floats:
    """Point (3,) before the window from which light along the law's axis hits the first apex of lens 1."""
    seq = interfaces(window)
    first = [face.array for face in window.faces].index(0)
    apex = np.asarray(seq[first].vertex)
    start = apex - axis * (abs(apex[2] - window.z_range[0]) + max(window.lattice.pitch)) / axis[2]
    for _ in range(4):  # a plane face before the lens displaces the ray: aim again
        miss = _hit(seq[: first + 1], start, axis) - apex
        start = start - (miss - axis * (miss @ axis))
    return np.asarray(start)


def _onto_axis(
    window: Window, array: int, axis: Floats, start: Floats, along: Floats, field: Floats | None
) -> Floats:
    """Slide (3,), across its axis `along`, that puts the first apex of lens 2 or the field lens on the axis
    ray.

    field : slide (3,) of the field lens where the slide of lens 2 is requested
    """
    target = [face.array for face in window.faces].index(array)
    aside = np.zeros(3)
    for _ in range(6):  # sliding a tilted lens moves the hit point a little
        seq = interfaces(window, aside, field) if array == 1 else interfaces(window, None, aside)
        seq = seq[: target + 1]
        gap = _hit(seq, start, axis, to_plane=True) - np.asarray(seq[-1].vertex)
        aside = aside + gap - along * (gap @ along)
    return aside


def _hit(seq: Sequence[Interface], start: Floats, direction: Floats, to_plane: bool = False) -> Floats:
    """Point (3,) where one ray hits the last of the interfaces, or its apex plane."""
    if to_plane:  # the lens may end before the ray reaches it; its apex plane does not
        last = seq[-1]
        seq = [*seq[:-1], replace(last, surface=PLANE)]
    traced = trace_sequence(seq, Rays(start[None], direction[None]), record=True)
    if traced.hits is None or traced.fate[0] in (Fate.MISSED, Fate.TIR):
        raise ValueError("the axis ray does not reach lens 2")
    return np.asarray(traced.hits[-1, 0])
