"""Light of the same rays sent in two ways, for instance through a file and through the exact surfaces.

Aberration alone changes fits over a field of a degree (2 % for the paper's sheet). Fitted laws and the focus
are therefore differences: the light minus that of the exact surfaces, over the rays ALIVE in both.

White light is compared with that of the design's wavelength, by trace and in closed form. By paraxial
matrices a ray that enters at height x with slope t leaves with the slope C x + D t + e along each lens axis;
e comes from lenses off the axis and tilted plane faces.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.light.measure import FEWEST, Light, fitted_law, rms_angle
from clacad.optics.law import Law, angle_between
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.optics.sequence import trace_sequence
from clacad.sheet.bundle import Bundle
from clacad.sheet.like_cell import interfaces, lens_distance
from clacad.sheet.window import Window

SLIDE = 1e-3
"""Trial shift of array 2, relative to the distance between the lenses, for the derivative of directions."""

SHIFT_RAYS = 65536
"""Most rays from which the focus is measured: the slopes of facets must cancel in it."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Light of a bundle, and light of the same bundle through the exact surfaces.

    fewest : Least number of rays ALIVE in both for a fit.
    """

    light: Light
    exact: Light
    fewest: int = FEWEST

    @cached_property
    def both(self) -> Bools:
        """Rays (n,) that are ALIVE in both and for which the law has an answer."""
        return np.asarray(self.light.alive & self.exact.alive & np.isfinite(self.exact.expected).all(axis=1))

    @cached_property
    def laws(self) -> tuple[Law, Law] | None:
        """Laws fitted to the light and to that of the exact surfaces, in the axes of the requested law.

        None where the rays determine none.
        """
        both = self.both
        if both.sum() < self.fewest:
            return None
        into = self.light.lit.rays.direction[both]
        law, exact = (fitted_law(into, one.direction[both], one.law.law) for one in (self.light, self.exact))
        return None if law is None or exact is None else (law, exact)

    def focus(self, window: Window, change: Floats | None = None) -> Floats:
        """Shift of array 2 along the normal that minimises the rms error to the law, minus that of the exact
        surfaces.

        One Gauss–Newton step with the derivative of the exact surfaces. A small shift does not change the
        slopes of facets, but their mean over a lens is the lens's slope.

        change : (n, 2) array or None
            Result of `change_with_shift` for all rays; None: computed here, for at most `SHIFT_RAYS` of them.
        Returns (2,) array: Shift along each lens axis, relative to the distance between the lenses; NaN along
            an axis without power, and of too few rays.
        """
        rows = np.flatnonzero(self.both)[:SHIFT_RAYS]
        lit = self.light.lit
        if change is None:
            few = Rays(lit.rays.position[rows], lit.rays.direction[rows])
            change = change_with_shift(window, lit.cell, few)
        else:
            change = change[rows]
        known = np.isfinite(change[:, 0])
        if known.sum() < FEWEST:
            return np.full(2, np.nan)
        seen, truth = (one.seen.direction[rows] for one in (self.light, self.exact))
        less = (seen - truth)[known] @ window.thin.rotation[:, :2]
        change = change[known]
        weight = (change**2).sum(axis=0)
        powered = weight > 1e-12 * max(float(weight.max()), 1e-300)
        return np.asarray(
            np.where(powered, -(less * change).sum(axis=0) / np.where(powered, weight, 1.0), np.nan)
        )


def change_with_shift(window: Window, cell: tuple[int, int], rays: Rays) -> Floats:
    """Derivative of exit directions with respect to a shift of array 2 along the sheet's normal, through the
    exact surfaces.

    cell : (i, j). Cell of array 1 that the rays go through.
    rays : Sheet frame.
    Returns (n, 2) array: Components along the lens axes, per shift by the distance between the lenses; NaN
        where a ray is lost.
    """
    distance = lens_distance(window)
    centre = window.lattice.centres(np.array([cell], dtype=np.int64))[0]
    local = Rays(rays.position - [*centre, 0.0], rays.direction)
    through = [
        trace_sequence(interfaces(window, np.array([0.0, 0.0, slide * distance])), local)
        for slide in (-SLIDE, SLIDE)
    ]
    good = np.all([one.fate == Fate.ALIVE for one in through], axis=0)
    low, high = (one.direction[good] @ window.thin.rotation[:, :2] for one in through)
    change = np.full((len(rays), 2), np.nan)
    change[good] = (high - low) / (2.0 * SLIDE)
    return change


def angles(one: TraceResult, other: TraceResult, last: Fate = Fate.ALIVE) -> Floats:
    """Angles (k,), radians, between directions of rays with one order and one fate, up to `last`, in both."""
    same = (one.fate <= last) & (one.fate == other.fate) & (one.order == other.order).all(axis=1)
    return angle_between(one.direction[same], other.direction[same])


def rms_between(one: Floats, other: Floats, rays: Bools) -> float:
    """Rms angle (radians) between directions (n, 3) of some of the rays (n,); NaN for none."""
    angle = angle_between(one[rays], other[rays])
    return rms_angle(angle[np.isfinite(angle)])


class AngleSummary(NamedTuple):
    """Root mean square, 95 % quantile and largest of some angles, radians; NaN for none."""

    rms: float
    p95: float
    worst: float

    @staticmethod
    def of(angle: Floats) -> AngleSummary:
        """Summary of angles (k,)."""
        return AngleSummary(rms_angle(angle), *(_quantile(angle, percent) for percent in (95.0, 100.0)))

    @staticmethod
    def between(one: Floats, other: Floats) -> AngleSummary:
        """Summary of the angles between directions (n, 3), where both are finite."""
        angle = angle_between(one, other)
        return AngleSummary.of(angle[np.isfinite(angle)])


def _quantile(values: Floats, percent: float) -> float:
    return float(np.percentile(values, percent)) if len(values) else float("nan")


@dataclass(frozen=True, eq=False)
class WhiteLight:
    """Light of one bundle in several lines, compared with the light of the design's wavelength.

    base : At the design wavelength.
    light : Of all lines, from `measure`.
    lines : mapping of metres to weight
    """

    base: Light
    light: Light
    lines: Mapping[float, float]

    @cached_property
    def law_rms(self) -> Floats:
        """Rms error of the law (lines,), radians."""
        return np.array([line.rms for line in self.light.lines])

    @cached_property
    def change(self) -> Floats:
        """Rms change of the exit direction (lines,), radians, of rays ALIVE in the line and in the base."""
        return np.array([changed(self.base, line) for line in self.light.lines])

    def mean(self, values: Floats) -> float:
        """Mean over the lines with their weights."""
        return float(np.average(values, weights=list(self.lines.values())))


def changed(base: Light, light: Light) -> float:
    """Rms angle (radians) between exit directions of two lights of the same rays, ALIVE in both."""
    return rms_between(base.direction, light.direction, base.alive & light.alive)


def paraxial(window: Window) -> tuple[Floats, Floats]:
    """Matrix (3, 3) of each lens axis, of (height at the first vertex, slope, 1), lens frame."""
    turn, found = window.thin.rotation, []
    faces = interfaces(window)
    for axis in (0, 1):
        whole, z = np.eye(3), 0.0
        for number, face in enumerate(faces):
            place = np.asarray(face.vertex) @ turn
            if number:
                whole = _row(0, (1.0, place[2] - z, 0.0)) @ whole
            normal = turn.T[:, 2] if face.rotation is None else turn.T @ face.rotation[:, 2]
            curvature = (face.surface.curvature_x, face.surface.curvature_y)[axis] * face.surface.side
            lean = normal[axis] / normal[2] + curvature * place[axis]  # slope of the normal at height 0
            part = 1.0 - face.index_before / face.index_after
            whole = _row(1, (-part * curvature, 1.0 - part, part * lean)) @ whole
            z = place[2]
        found.append(whole)
    return found[0], found[1]


def _row(number: int, values: tuple[float, float, float]) -> Floats:
    """The identity with one row replaced."""
    matrix = np.eye(3)
    matrix[number] = values
    return matrix


def paraxial_slopes(window: Window, lit: Bundle) -> Floats:
    """Exit slopes (n, 2) of a bundle along the lens axes, by matrices; before power is subtracted."""
    turn = window.thin.rotation
    ray = lit.rays.direction @ turn
    slope = ray[:, :2] / ray[:, 2:]
    start = np.column_stack([lit.points, np.zeros(len(lit.points))]) @ turn
    first = np.asarray(interfaces(window)[0].vertex) @ turn
    height = start[:, :2] + slope * (first[2] - start[:, 2:])
    one = np.ones(len(height))
    rows = [m[1] @ np.stack([height[:, k], slope[:, k], one]) for k, m in enumerate(paraxial(window))]
    return np.stack(rows, axis=1)


def closed_change(window: Window, other: Window, base: Light) -> float:
    """Closed form (radians) of `changed` between two states of a window, for the rays ALIVE in the base."""
    moved = paraxial_slopes(other, base.lit)[base.alive] - paraxial_slopes(window, base.lit)[base.alive]
    return float(np.sqrt(np.mean((moved**2).sum(axis=1)))) if len(moved) else np.nan


def floor_of_one_material(window: Window, white: WhiteLight) -> float:
    """Least mean law error (radians) over the lines that faces of the window's one material can reach.

    Faces that are right in the line of the median index leave the others as far from it as they are traced
    to be; no other index makes the mean smaller. NaN for several materials or listed plates: they have no
    such floor.
    """
    if len({body.material for body in window.bodies}) != 1 or (window.form == "plates" and window.bodies[1:]):
        return np.nan
    weight = np.array(list(white.lines.values()))
    order = np.argsort([window.bodies[0].index_at(wave) for wave in white.lines])
    middle = order[int(np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum()))]
    lines = white.light.lines
    return white.mean(np.array([changed(lines[middle], line) for line in lines]))
