"""Checks of a field lens: it lies at the foci, images lens 1 onto lens 2, fills the field and preserves the
law.

Light along the axis and through the middle of cell 1 is traced face by face through the window as built. The
checks do not use how the faces were computed.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.checks.check import Check
from clacad.checks.light_kinds import FIELD_FOCUS, FIELD_LAW, FIELD_THROUGHPUT, PUPIL
from clacad.light.measure import Light
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import STEP, Interface, trace_sequence
from clacad.sheet.asked_focus import RequestedLaw
from clacad.sheet.bundle import Bundle, bundle
from clacad.sheet.telescopelet import interfaces
from clacad.sheet.vignetting import aperture_slope, half_field, share, thin_cells
from clacad.sheet.window import Window
from clacad.tracing.trace import trace
from clacad.verification.light.confocality import axis_start, field_onto_axis
from clacad.verification.light.law_checks import Lit

if TYPE_CHECKING:
    from clacad.design import Design

FOCUS, MOVED, SHARE, LAW = 0.01, 0.02, 0.95, 1.2
"""Limits: face from focus over f1; du/dt over s; share over that of thin lenses; rms error over that without
a field lens."""

PART = 0.9
"""Part of the full field at which the share is measured."""

SLOPE = 1e-4
"""Change of slope for the finite difference du/dt."""

RAYS = 4096


def field_lens_checks(lit: Lit) -> Iterator[Check]:
    """Judge the field lens of a window; no checks where it has none."""
    if not lit.window.thin.field:
        return
    for kind, check, limit in ((FIELD_FOCUS, _focus, FOCUS), (PUPIL, _pupil, MOVED)):
        try:
            yield check(lit.window)
        except ValueError as error:
            yield kind.not_run(str(error), limit=limit, where=kind.where)
    yield _throughput(lit.window)
    yield _law(lit.design, lit.window, lit.optics.main.lit)


def _focus(window: Window) -> Check:
    """Distance of the field faces from the foci of the optics before them."""
    pair = window.thin
    start = axis_start(window, pair.rotation[:, 2])
    seq = interfaces(window, None, field_onto_axis(window, start))
    worst, where = 0.0, ""
    for number, face in enumerate(window.faces):
        if face.array != 2:
            continue
        for axis, curvature in enumerate((face.surface.curvature_x, face.surface.curvature_y)):
            if curvature == 0.0:
                continue
            off = _from_focus(window, seq[:number], np.asarray(seq[number].vertex), start, axis)
            part = abs(off) / seq[number].index_before / pair.focal_length[0][axis]
            if part >= worst:
                worst, where = part, f"face {number + 1}, {'xy'[axis]}"
    sentence = f"the field faces are at most {worst:.3g} of f1 from the foci of lens 1 ({where})"
    return FIELD_FOCUS.judge(worst, FOCUS, sentence)


def _from_focus(window: Window, before: list[Interface], vertex: Floats, start: Floats, axis: int) -> float:
    """Distance (length) along the axis from the crossing of parabasal light and the axis ray to a vertex
    (3,).
    """
    turn = window.thin.rotation
    aside = STEP * window.lattice.circumradius * turn[:, axis]
    rays = Rays(start + np.array([np.zeros(3), aside, -aside]), np.tile(turn[:, 2], (3, 1)))
    seen = trace_sequence(before, rays)
    if (seen.fate != Fate.ALIVE).any():
        raise ValueError("light near the axis ray does not reach the field lens")
    place, ray = (seen.position - vertex) @ turn, seen.direction @ turn
    slope = ray[:, axis] / ray[:, 2]
    at_vertex = place[:, axis] - place[:, 2] * slope  # in the plane through the vertex
    return float((at_vertex[1] - at_vertex[2]) / (slope[1] - slope[2]))


def _pupil(window: Window) -> Check:
    """Shift over lens 2 of the ray through the middle of cell 1, per change of its slope."""
    turn, s = window.thin.rotation, window.thin.separation
    ax, ay = aperture_slope(window)
    middle = np.array([ax, ay, 1.0]) @ turn
    slope = middle[:2] / middle[2]
    change = SLOPE * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    direction = np.column_stack([slope + change, np.ones(4)]) @ turn.T
    below = abs(window.z_range[0]) + max(window.lattice.pitch)
    start = -direction / direction[:, 2:] * below
    seen = trace_sequence(interfaces(window), Rays(start, direction), record=True)
    if seen.hits is None or (seen.fate != Fate.ALIVE).any():
        raise ValueError("the ray in the middle of the field does not get through")
    second = [face.array == 1 for face in window.faces]
    at = seen.hits[second].mean(axis=0) @ turn
    moved = [abs(at[2 * k, k] - at[2 * k + 1, k]) / (2.0 * SLOPE * s) for k in (0, 1)]
    sentence = (
        f"light through the middle of cell 1 moves over lens 2 by {moved[0]:.3g}, {moved[1]:.3g} of the"
        " separation a unit of slope (x, y); without a field lens it would be 1"
    )
    return PUPIL.judge(max(moved), MOVED, sentence)


def _throughput(window: Window) -> Check:
    """Share of light at 0.9 of the full field, left, right, up and down, compared with thin lenses."""
    cells = thin_cells(window)
    turn = window.thin.rotation
    ax, ay = aperture_slope(window)
    middle = np.array([ax, ay, 1.0]) @ turn
    worst, at, ratio = np.inf, 0.0, np.nan
    for axis, half in enumerate(half_field(cells)):
        for sense in (PART, -PART):
            slope = middle[:2] / middle[2]
            slope[axis] += sense * half
            direction = turn @ np.array([*slope, 1.0])
            if not direction[2] > 0.0:
                continue
            lit = bundle(window, RAYS, 0.0, middle=direction / sqrt(float(direction @ direction)))
            passed = float((trace(window, lit.rays, path="size").fate == Fate.ALIVE).mean())
            closed = float(share(cells, lit.middle[None])[0])
            ratio = passed / closed if closed > 0.0 else np.nan
            if ratio < worst:
                worst, at = ratio, passed
    sentence = (
        f"at {PART:g} of the full field {at:.3f} of the light passes at worst, {worst:.3f} of what thin"
        " lenses pass"
    )
    value = worst if worst < np.inf else np.nan
    text = f"4 directions, {RAYS} Sobol rays each over the whole cell"
    return FIELD_THROUGHPUT.judge(value, SHARE, sentence, bundle=text)


def _law(design: Design, window: Window, main: Bundle) -> Check:
    """Error of the law with the field lens over that without, for the light that passes both windows."""
    from clacad.design import DesignError
    from clacad.prescription.prescribe import prescribe

    without = {
        key: value for key, value in design.given["pair"].items() if key not in ("field", "field_lens")
    }
    try:
        plain = prescribe(type(design).from_dict({**design.given, "pair": without}))
    except DesignError as error:
        why = f"the same pair without a field lens cannot be built: {str(error).splitlines()[0]}"
        return FIELD_LAW.not_run(why, limit=LAW, where=FIELD_LAW.where, required=False)
    lit = [
        bundle(one, min(len(main.rays), 2 * RAYS), design.check.field, design.check.field_centre)
        for one in (window, plain)
    ]
    law = RequestedLaw(window.law)
    light = [
        Light(one, trace(sheet, one.rays, path="size"), law)
        for sheet, one in zip((window, plain), lit, strict=True)
    ]
    both = light[0].known & light[1].known
    rms = [one.rms_of(both) for one in light]
    ratio = rms[0] / rms[1] if rms[1] > 0.0 else np.nan
    sentence = (
        f"of the light that passes with and without the field lens the rms error is {1e3 * rms[0]:.4g} mrad"
        f" with it, {1e3 * rms[1]:.4g} mrad without"
    )
    return FIELD_LAW.judge(ratio, LAW, sentence, bundle=str(lit[0]))
