"""Uniform equivalents of cells, on which effects are bounded for a non-uniform sheet.

An effect's bound is computed for one cell with identical neighbours (`clacad.sheet.like_cell`) and the light
that reaches that cell. The cells tried, among those lit, are the ones with the outermost lenses, and a
sample. The error without the effect is then at most that of the worst of them. Effects that only count rays
also count them on the whole sheet.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats, Ints
from clacad.effects.engine.bounds import Bound, Situation
from clacad.effects.engine.effect import Declaration
from clacad.optics.rays import Fate, Rays
from clacad.sheet.like_cell import like_cell
from clacad.sheet.representative_cells import rows_through_outermost
from clacad.sheet.vignetting import aperture_slope
from clacad.sheet.window import Window

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
