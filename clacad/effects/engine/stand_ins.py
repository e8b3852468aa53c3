"""Uniform equivalents of cells, on which effects are bounded for a non-uniform sheet.

An effect's bound is computed for one cell with identical neighbours (`clacad.sheet.like_cell`) and the light
that reaches that cell. The cells tried, among those lit, are the ones with the outermost lenses, and a
sample. The error without the effect is then at most that of the worst of them. Effects that only count rays
also count them on the whole sheet.

Averages over a cell for some effects: thickness of a body, height of its steps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats, Ints
from clacad.effects.engine.effect import Bound, Declaration, Situation
from clacad.optics.rays import Fate, Rays
from clacad.sheet.like_cell import like_cell
from clacad.sheet.representative_cells import representative_cells, rows_through_outermost
from clacad.sheet.vignetting import aperture_slope, focal_ratio
from clacad.sheet.window import Body, Face, Window, column, face_height, optical_tile
from clacad.tracing.layout import prepared

RAYS = 512
"""Number of rays through each cell that is tried."""

TINY = 1e-300
"""Replaces an angle or a radiance tolerance of 0."""


def worst_bound(situation: Situation, kind: Declaration) -> Bound:
    """Bound of an effect: that of a uniform sheet itself, else that of the worst cell tried."""
    if not situation.stand_ins:
        return kind.bound(situation)
    every = [kind.bound(one) for _, one in situation.stand_ins]
    unknown = [one for one in every if not one.known]
    if unknown:
        return unknown[0]
    parts = [
        max(one.angle / max(situation.angle, TINY), one.radiance / max(situation.radiance, TINY))
        for one in every
    ]
    worst = int(np.argmax(parts))
    i, j = situation.stand_ins[worst][0]
    counted = 0.0 if kind.shows is None else situation.share(kind.shows)
    radiance = max(one.radiance for one in every)
    if (
        kind.shows is Fate.WALL and situation.window.many_sizes
    ):  # steps between lenses of different sizes: a uniform sheet has none
        radiance = max(radiance, situation.most(counted))
    return Bound(
        max(one.angle for one in every),
        max(radiance, situation.most(counted)) if counted > 0.0 else radiance,
        f"in cell ({i}, {j}), the worst of {len(every)} tried: {every[worst].why}"
        if parts[worst] > min(parts)
        else every[worst].why,
        max(one.cost for one in every),
    )


def with_stand_ins(situation: Situation) -> Situation:
    """The situation, for a non-uniform sheet with the uniform equivalents that bound its effects."""
    window = situation.window
    if window.uniform:
        return situation
    return replace(situation, stand_ins=tuple(_stand_ins(situation)))


def _stand_ins(situation: Situation) -> Iterator[tuple[tuple[int, int], Situation]]:
    """Lit cells, each with its light on its uniform equivalent."""
    rays = situation.rays
    cells, x, y = situation.window.lattice.locate(*_in_sheet(rays).T)
    # the slope at the middle of the cell that a ray hits
    way = rays.direction[:, :2] / rays.direction[:, 2:] - np.column_stack([x, y]) / situation.sheet_distance
    for row in rows_through_outermost(situation.window, cells):
        like = like_cell(situation.window, cells[row], widest=False)
        slope = np.array(aperture_slope(like)) if situation.spread > 0.0 else way[row]
        light = _over_cell(like, cells[row], slope, situation)
        i, j = cells[row].tolist()
        yield (i, j), replace(situation, window=like, rays=light, stand_ins=())


def _in_sheet(rays: Rays) -> Floats:
    """Points (n, 2) where rays cross z = 0."""
    step = rays.position[:, 2:] / rays.direction[:, 2:]
    return np.asarray(rays.position[:, :2] - step * rays.direction[:, :2])


def _over_cell(like: Window, cell: Ints, slope: Floats, situation: Situation) -> Rays:
    """Light of a slope over a whole cell: as the camera sees it, or in a cone about it."""
    within = like.lattice.over_cell(sobol(RAYS, 2))
    point = like.centres(0, cell) + within
    slopes = slope + within / situation.sheet_distance
    if situation.spread > 0.0:
        slopes = slopes + situation.spread * _disc(sobol(RAYS, 4)[:, 2:])
    below = like.z_range[0] - 0.25 * min(like.lattice.pitch)
    start = np.column_stack([point + below * slopes, np.full(len(point), below)])
    return Rays(start, np.column_stack([slopes, np.ones(len(point))]))


def _disc(u: Floats) -> Floats:
    """Points (n, 2) of the unit disc, evenly, from points (n, 2) of the unit square."""
    radius, turn = np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
    return np.asarray(radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]))


GRID = 33


def cell_points(window: Window) -> Floats:
    """Points (m, 2) spread evenly over the optical zone of a cell, cell frame."""
    tile = optical_tile(window)
    low, high = tile.min(axis=0), tile.max(axis=0)
    steps = (np.arange(GRID) + 0.5) / GRID
    grid = np.stack(np.meshgrid(*(a + (b - a) * steps for a, b in zip(low, high, strict=True))), -1)
    points = grid.reshape(-1, 2)
    following = np.roll(tile, -1, axis=0)
    inside = np.ones(len(points), dtype=bool)
    for (ax, ay), (bx, by) in zip(tile, following, strict=True):
        inside &= (bx - ax) * (points[:, 1] - ay) - (by - ay) * (points[:, 0] - ax) >= 0.0
    return points[inside]


def mean_thickness(window: Window, body: Body) -> float:
    """Mean extent of a body along z for light near the axis, length.

    In a non-uniform sheet of a sample of cells.

    Lens 1's light arrives at lens 2 as a copy scaled by m = −f2/f1 per meridian. Only |m| of lens 2 is lit
    where |m| < 1; only 1/|m| of lens 1 is transmitted where |m| > 1.
    """
    if not window.uniform:
        return _over_cells(window, window.bodies.index(body))
    m = np.abs(focal_ratio(window.thin))
    scale = np.ones(2)
    arrays = {face.array for face in (body.front, body.back)}
    if 0 in arrays and 1 not in arrays:
        scale = np.minimum(1.0, 1.0 / m)
    elif 1 in arrays and 0 not in arrays:
        scale = np.minimum(1.0, m)
    elif 2 in arrays:  # light of one direction is a point there
        scale = np.zeros(2)
    turn = window.thin.rotation[:2, :2]
    points = (cell_points(window) @ turn * scale) @ np.linalg.inv(turn)
    front, back = _heights(window, body, *points.T)
    return float(np.nanmean(np.maximum(back - front, 0.0)))


def _over_cells(window: Window, number: int) -> float:
    """Mean thickness of a body over cells spread over the sheet; kept with the window."""
    kept: dict[int, float] = prepared(window).setdefault("mean_thickness", {})
    if number not in kept:
        likes = [like_cell(window, cell, widest=False) for cell in representative_cells(window, "sample")]
        kept[number] = float(np.mean([mean_thickness(like, like.bodies[number]) for like in likes]))
    return kept[number]


def _heights(window: Window, body: Body, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    if body.columnar:
        return column(window, body, x, y)
    return face_height(window, body.front, x, y), face_height(window, body.back, x, y)


def mean_steps(window: Window) -> float:
    """Σ over faces and cell directions of mean step height over the cell's width.

    Where two cells meet, both have their own height of the face along the common border. Light of slope t
    loses at most about t times the mean step over the pitch there.
    """
    lattice = window.lattice
    total = 0.0
    for face in window.faces:
        if face.array is None:
            continue
        for step, half in zip(lattice.steps[: len(lattice.steps) // 2], lattice.half_widths):
            total += _mean_step(window, face, np.array(lattice.offset(*step))) / (2.0 * half)
    return total


def _mean_step(window: Window, face: Face, offset: Floats) -> float:
    """Mean |height here − height there| along the border towards the neighbour at `offset`."""
    length = float(np.hypot(*offset))
    normal = offset / length
    along = np.array([-normal[1], normal[0]])
    width = float(np.ptp(window.lattice.tile() @ along))
    if window.lattice.hexagonal:
        width = length / np.sqrt(3.0)
    places = (np.arange(GRID) + 0.5) / GRID - 0.5
    here = 0.5 * offset * (1.0 - 1e-9) + np.outer(places * width, along)
    there = here - offset * (1.0 - 1e-9)
    step = face_height(window, face, *here.T) - face_height(window, face, *there.T)
    return float(np.nanmean(np.abs(step))) if np.isfinite(step).any() else 0.0
