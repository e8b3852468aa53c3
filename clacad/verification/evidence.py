"""Contents of a report beyond its checks: error attribution, foci, cost of accuracy, omitted effects.

Foci: light along the axis is traced through lens 1 forwards and through lens 2 backwards, in each meridian.
Each fan has a real or virtual focus between the lenses; in a confocal pair both fans share one focus. The
envelope of a fan is its caustic; the caustic of a lens without aberration is a point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import plain
from clacad.base.types import Floats, Progress
from clacad.effects import declared_all
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import Interface, trace_sequence
from clacad.sheet.like_cell import interfaces
from clacad.sheet.window import Window
from clacad.tracing.worst_cell import worst_cell
from clacad.verification.accuracy.accuracy_table import Ladder, climb
from clacad.verification.light.error_attribution import (
    Attribution,
    GhostMap,
    as_it_would_be_written,
    as_written,
    attribute,
    ghost_map,
)

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.effects.engine.plan import Plan
    from clacad.judging.judge_files import FileReport
    from clacad.waves import WaveReport


HEIGHTS = 41
PART = 0.9
"""Lit part of the half cell."""
NEAR_AXIS = 1e-3
"""Height, over the half cell, of the ray that marks the parabasal focus."""


@dataclass(frozen=True, eq=False)
class Fan:
    """Rays of one lens in one meridian, between the lenses.

    Coordinates: along the lens axis from the middle of lens 1, and across it; lengths.

    height : (k,) where the rays hit their lens
    place, slope : (k,)
        Position across at `along` = 0, and its derivative with respect to `along`; NaN where a ray is lost.
    focus : (2,) along, across. Where parabasal rays cross; NaN without power.
    caustic : (m, 2) along, across. Where neighbouring rays cross.
    """

    height: Floats
    place: Floats
    slope: Floats
    focus: Floats
    caustic: Floats


@dataclass(frozen=True, eq=False)
class MeridianFocus:
    """Both fans of one meridian, and the distance between the middles of the lenses along the axis."""

    lens1: Fan
    lens2: Fan
    distance: float

    @property
    def gap(self) -> float:
        """Focus of lens 2 less focus of lens 1, along the axis (length); NaN without power."""
        return float(self.lens2.focus[0] - self.lens1.focus[0])

    @property
    def length(self) -> tuple[float, float]:
        """Longitudinal aberration of each fan: length of its caustic along the axis; NaN without power."""
        return _spread(self.lens1.caustic), _spread(self.lens2.caustic)

    def to_dict(self) -> dict[str, Any]:
        """Numbers for the report, lengths in design units."""
        return {
            "distance": self.distance,
            "gap": self.gap,
            "relative_gap": self.gap / self.distance,
            "focus": [self.lens1.focus, self.lens2.focus],
            "caustic_length": self.length,
        }


def _spread(caustic: Floats) -> float:
    return float(np.ptp(caustic[:, 0])) if len(caustic) else float("nan")


def foci(window: Window) -> tuple[MeridianFocus, MeridianFocus]:
    """Trace both fans in both meridians of the lenses, surfaces as built."""
    turn = window.thin.rotation
    middle = np.array([[0.0, 0.0, 0.0], np.asarray(window.thin.offset)])
    # the offset in air represents a longer one where glass lies between the vertices
    if window.form != "biconvex":
        middle[1] = _apex(window, 1)
    elif window.thin.field:  # the plate between the lenses moves lens 2 farther away
        ends = [np.asarray(f.vertex) + [*window.shifts[1], 0.0] for f in window.faces if f.array == 1]
        middle[1] = 0.5 * (ends[0] + ends[1])
    distance = float((middle[1] - middle[0]) @ turn[:, 2])
    found = []
    for axis in (0, 1):
        first, second = _either_side(window, axis)
        forth = _fan(window, first, middle[0], axis, +1.0)
        back = _fan(window, second[::-1], middle[1], axis, -1.0)
        found.append(MeridianFocus(forth, back, distance))
    return found[0], found[1]


def _apex(window: Window, array: int) -> Floats:
    face = next(f for f in window.faces if f.array == array)
    return np.asarray(face.vertex) + [*window.shifts[array], 0.0]


def _either_side(window: Window, axis: int) -> tuple[list[Interface], list[Interface]]:
    """Interfaces that light of a meridian crosses from either side up to the common focus.

    They are those of the lens and, with a field lens, those between the lens and the field lens's powered
    face.
    """
    every = interfaces(window)
    if window.form == "plates":
        first = _before_focus(every, axis)
        return every[:first], every[first:]
    if not window.thin.field:
        return _of_lens(window, 0), _of_lens(window, 1)
    powered = [
        k
        for k, face in enumerate(window.faces)
        if face.array == 2 and (face.surface.curvature_x, face.surface.curvature_y)[axis] != 0.0
    ]
    if len(powered) == 2:  # half of the power before the focus, half behind it
        return every[: powered[1]], every[powered[1] :]
    return every[: powered[0]], every[powered[0] + 1 :]


def _before_focus(every: list[Interface], axis: int) -> int:
    """Number of interfaces that paraxial light of a meridian crosses before its first focus."""
    height, slope = 1.0, 0.0  # slope times refractive index
    for number, (here, beyond) in enumerate(pairwise(every), start=1):
        curvature = (here.surface.curvature_x, here.surface.curvature_y)[axis] * here.surface.side
        slope -= (here.index_after - here.index_before) * curvature * height
        height += slope * (beyond.vertex[2] - here.vertex[2]) / here.index_after
        if not height > 0.0:
            return number
    return len(every) // 2


def _of_lens(window: Window, number: int) -> list[Interface]:
    """Interfaces of one lens: the faces of its body; for a slab its one face, with the material behind it."""
    every = interfaces(window)
    if window.form == "slab":
        return [every[number]]
    return every[2 * number : 2 * number + 2]


def _fan(window: Window, faces: Sequence[Interface], middle: Floats, axis: int, way: float) -> Fan:
    """Trace rays along the lens axis in one meridian through one lens; way +1: forwards, −1: backwards."""
    turn = window.thin.rotation
    across, along = turn[:, axis], turn[:, 2]
    half = PART * min(window.lattice.half_widths)
    height = np.append(np.linspace(-half, half, HEIGHTS), NEAR_AXIS * half * np.array([-1.0, 1.0]))
    away = np.ptp(window.z_range) + max(window.lattice.pitch)
    start = middle + height[:, None] * across - way * away * along
    direction = np.broadcast_to(way * along, start.shape)
    if way < 0.0:
        faces = [replace(f, index_before=f.index_after, index_after=f.index_before) for f in faces]
    out = trace_sequence(faces, Rays(start, np.ascontiguousarray(direction)))
    alive = (out.fate == Fate.ALIVE) | (out.fate == Fate.BACKWARD)
    with np.errstate(invalid="ignore", divide="ignore"):
        slope = np.where(alive, (out.direction @ across) / (out.direction @ along), np.nan)
        place = out.position @ across - slope * (out.position @ along)
    focus = _crossing(place[-2:], slope[-2:])
    rows = np.arange(HEIGHTS)
    caustic = _crossing(
        np.stack([place[rows[:-1]], place[rows[1:]]], axis=1),
        np.stack([slope[rows[:-1]], slope[rows[1:]]], axis=1),
    )
    caustic = caustic[np.isfinite(caustic).all(axis=1)] if np.isfinite(focus).all() else caustic[:0]
    return Fan(height[:-2], place[:-2], slope[:-2], focus, caustic)


def _crossing(place: Floats, slope: Floats) -> Floats:
    """Point (..., 2) where two lines across = place + slope·along cross; NaN where they are parallel."""
    turn = slope[..., 1] - slope[..., 0]
    parallel = ~(np.abs(turn) > 1e-9 * np.abs(place[..., 1] - place[..., 0]))
    size = np.maximum(np.abs(slope).max(axis=-1), 1e-300)
    parallel |= ~(np.abs(turn) > 1e-12 * size) | ~(np.abs(turn) > 1e-13)
    along = -(place[..., 1] - place[..., 0]) / np.where(parallel, np.nan, turn)
    return np.stack([along, place[..., 0] + slope[..., 0] * along], axis=-1)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Measurements that are not judged.

    attributions : One for each mesh file; without one, for the triangles of an STL.
    foci : (MeridianFocus, MeridianFocus) or None. None where the axis ray is lost.
    plan : None where the effects cannot be planned (a wavelength outside a material's data).
    waves : Light along the middle of the field as a wave, where the effect `diffraction` or coherent light
        requires it and a grid that can be computed suffices.
    """

    attributions: tuple[Attribution, ...]
    foci: tuple[MeridianFocus, MeridianFocus] | None
    ghosts: GhostMap
    ladder: Ladder
    plan: Plan | None
    waves: WaveReport | None = None

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        found = {
            "attribution": [a.to_dict() for a in self.attributions],
            "foci": None if self.foci is None else [f.to_dict() for f in self.foci],
            "ghosts": self.ghosts.to_dict(),
            "accuracy": {"reference_rms": self.ladder.reference, "rows": self.ladder.to_dict()},
            "effects": None if self.plan is None else self.plan.to_dict(),
        }
        if self.waves is not None:
            found["waves"] = self.waves.to_dict()
        return dict(plain(found))


def gather_evidence(
    design: Design, window: Window, files: Sequence[FileReport], progress: Progress
) -> Evidence:
    """Measure what a page shows next to its checks; of the worst cell's equivalent if non-uniform."""
    if not window.uniform:
        window = worst_cell(window, design.check.field).buildable
    progress("telling the errors apart", 0.0)
    attributions = _attributions(design, window, files)
    progress("tracing the foci", 0.0)
    try:
        focus = foci(window)
    except ValueError:
        focus = None
    progress("mapping the ghosts", 0.0)
    ghosts = ghost_map(window)
    ladder = climb(design, window, progress)
    progress("planning the effects", 0.0)
    try:
        from clacad.effects.engine.plan import plan_effects

        plan = plan_effects(design)
    except ValueError:
        plan = None
    called = design.light.coherent or (
        plan is not None and any(kind.waves for kind in declared_all(plan.names))
    )
    return Evidence(attributions, focus, ghosts, ladder, plan, _waves(design, progress) if called else None)


def _waves(design: Design, progress: Progress) -> WaveReport | None:
    from clacad.storage.errors import BadRequest, LimitRefused
    from clacad.waves import wave

    progress("sending waves through a telescopelet", 0.0)
    try:
        return wave(design)
    except (BadRequest, LimitRefused):
        return None


def _attributions(design: Design, window: Window, files: Sequence[FileReport]) -> tuple[Attribution, ...]:
    found = []
    for one in files:
        if one.mesh is not None and one.mesh.gathered is not None:
            own = window if one.window is None else one.window
            held = as_written(own, one.mesh.gathered, one.subject.name, one.present)
            found.append(attribute(design, own, held))
    if not found:
        found.append(attribute(design, window, as_it_would_be_written(window)))
    return tuple(a for a in found if a is not None)
