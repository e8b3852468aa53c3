"""Samples along a cell's borders and their levels, the same for both cells of every border."""

from __future__ import annotations

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.mesh import cell_triangulation as pl
from clacad.mesh.integer_heights import FAR, CellLevels, cluster, shortest
from clacad.sheet.window import optical_tile


def with_borders(make: CellLevels, plan: pl.Planar, quads: int) -> tuple[pl.Planar, list[Floats], list[Ints]]:
    """Give the tile's sides the complex's breaks: the same samples on both sides of every border.

    Returns
    -------
    plan : Planar
    side_t : m arrays
        Parameters of the samples along each side.
    levels : m/2 arrays (n, 4)
        Left front, left back, right front, right back at the samples of each border class.
    """
    seam = not np.array_equal(make.tiling.tile, optical_tile(make.window))
    nodes = _node_levels(make)
    placed: list[tuple[Floats, Floats]] = []
    levels = []
    for border in make.tiling.borders:
        if seam:
            t = grid_at = np.array([0.0, 1.0])
            groups: list[Floats] = []
        else:
            least = _least(make, border.start, border.end, quads)
            stops = border.roots
            if make.bevel > 0.0:
                length = float(np.hypot(border.end[0] - border.start[0], border.end[1] - border.start[1]))
                stops = np.concatenate([stops, border_stops(make.bevel, length)])
            groups = pl.space(stops, least)
            t, grid_at = pl.place(np.array([0.5 * (g[0] + g[-1]) for g in groups]), quads, least)
        rows = _border_levels(make, border.index, t, groups, nodes)
        t, rows = _parted(make, border.index, t, rows, groups, nodes)
        placed.append((t, grid_at))
        levels.append(rows)
    placed += [(1.0 - t[::-1], 1.0 - g[::-1]) for t, g in placed]
    if not seam:
        plan = pl.with_side_samples(plan, make.tiling.tile, placed)
    return plan, [t for t, _ in placed], levels


def border_stops(width: float, length: float) -> Floats:
    """Parameters on a border of this length at which bevels end."""
    return np.array([width / length, 1.0 - width / length])


def _least(make: CellLevels, start: tuple[float, float], end: tuple[float, float], quads: int) -> float:
    """Least spacing of two border samples, as a parameter, within reason."""
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    return float(np.clip(shortest(make) / length, 1e-6, 0.05 / quads))


def settle_inside(make: CellLevels, lens: Ints) -> Ints:
    """Merge levels closer than the gap at every point by itself."""
    held = np.array([make.held[0], make.held[1], True, True])
    both = np.concatenate([lens, np.broadcast_to(np.array(make.land), lens.shape)], axis=1)
    return cluster(both, held, make.gap)[:, :2]


def settle_sides(plan: pl.Planar, lens: Ints, levels: list[Ints]) -> Ints:
    """Write the borders' levels into the points of the tile's sides."""
    lens = lens.copy()
    half = len(levels)
    for k, rows in enumerate(levels):
        lens[plan.sides[k]] = rows[:, :2]
        lens[plan.sides[k + half][::-1]] = rows[:, 2:]
    return lens


def _border_levels(make: CellLevels, k: int, t: Floats, groups: list[Floats], nodes: Ints) -> Ints:
    """Merged levels of both cells along border class k, (n, 4): equal where a break says they are."""
    m = len(make.tiling.tile)
    half = m // 2
    ends = nodes[[k, (k + 1) % m]], nodes[[(k + half + 1) % m, k + half]]
    inner = t[1:-1]
    held = np.array([*make.held, *make.held, True, True])
    both = np.array([_at(make, k, value) for value in inner.tolist()], dtype=np.int64).reshape(-1, 6)
    for group in groups:
        at = int(np.argmin(np.abs(inner - 0.5 * (group[0] + group[-1]))))
        for root in group.tolist():
            _hold_equal(make, both[at], _at(make, k, root), held)
    merged = cluster(both, held, make.gap)[:, :4]
    first, last = (np.concatenate([ends[0][n], ends[1][n]]) for n in (0, 1))
    return np.concatenate([first[None], merged, last[None]])


def _parted(
    make: CellLevels, k: int, t: Floats, rows: Ints, groups: list[Floats], nodes: Ints
) -> tuple[Floats, Ints]:
    """Part two columns that only touch along a stretch of the border, so that no edge has four faces.

    Between the ends of the stretch the upper column moves up by the merge height, a few z steps.
    """
    touch = _touching(rows)
    alone = touch[:-1] & touch[1:]
    alone[1:] &= ~touch[:-2]
    alone[:-1] &= ~touch[2:]
    if alone.any():  # two samples and nothing between them to move
        t = np.sort(np.concatenate([t, 0.5 * (t[:-1] + t[1:])[alone]]))
        rows = _border_levels(make, k, t, groups, nodes)
        touch = _touching(rows)
    inside = np.flatnonzero(touch[1:-1] & touch[:-2] & touch[2:]) + 1
    rows = rows.copy()
    for n in inside.tolist():
        upper = 0 if rows[n, :2].sum() > rows[n, 2:].sum() else 2
        if rows[n, upper] == rows[n, upper + 1]:
            rows[n, upper + 1] += make.gap
        rows[n, upper] += make.gap
    return t, rows


def _touching(rows: Ints) -> Bools:
    """Where both columns exist and share a level but no material."""
    there = (rows[:, 0] <= rows[:, 1]) & (rows[:, 2] <= rows[:, 3]) & (np.abs(rows) < FAR).all(axis=1)
    shared = np.minimum(rows[:, 1], rows[:, 3]) - np.maximum(rows[:, 0], rows[:, 2])
    return np.asarray(there & (shared == 0))


def _at(make: CellLevels, k: int, t: float) -> Ints:
    """Levels of left front, back, right front, back and land at a parameter of border class k."""
    tile, m = make.tiling.tile, len(make.tiling.tile)
    half = m // 2
    left = pl.side_points(tile[k], tile[(k + 1) % m], np.array([t]))
    right = pl.side_points(tile[(k + half + 1) % m], tile[k + half], np.array([t]))
    levels = make.levels(make.heights(np.concatenate([left, right])))
    return np.concatenate([levels[0], levels[1], np.array(make.land)])


def _hold_equal(make: CellLevels, here: Ints, root: Ints, held: Bools) -> None:
    """Make equal, in place, the levels that are equal at the root (a sample may stand a little beside it)."""
    order = np.argsort(root, kind="stable")
    runs = np.split(order, np.flatnonzero(np.diff(root[order]) > make.gap) + 1)
    for run in runs:
        if len(run) < 2 or (np.abs(root[run]) >= FAR).any() or (np.abs(here[run]) >= FAR).any():
            continue
        fixed = run[held[run]]
        here[run] = here[fixed[0]] if len(fixed) else int(here[run].min() + here[run].max()) // 2


def _node_levels(make: CellLevels) -> Ints:
    """Merged front and back level at each corner of the tile, (m, 2)."""
    levels = make.levels(make.heights(make.tiling.tile))
    for node in make.tiling.nodes:
        corners = [c for _, c in node.cells]
        row = np.concatenate([levels[corners].ravel(), np.array(make.land)])
        held = np.array([*make.held * len(corners), True, True])
        levels[corners] = cluster(row[None], held, make.gap)[0][:-2].reshape(-1, 2)
    return levels
