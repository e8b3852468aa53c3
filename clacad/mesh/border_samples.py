"""Samples along a cell's borders and their levels, common to both cells of every border."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.mesh import cell_triangulation as pl
from clacad.mesh.integer_heights import FAR, CellLevels, cluster, shortest
from clacad.sheet.grid_steps import Steps
from clacad.sheet.pattern import Step


@dataclass(frozen=True, slots=True, eq=False)
class BorderSamples:
    """Points of the two cells along a border, and their levels.

    t : (n,)
        Parameters of the samples, 0 and 1 included.
    grid_at : (quads + 1,)
        Indices of the samples that are points of the regular grid.
    levels : (n, 4)
        Left front, left back, right front, right back.
    """

    t: Floats
    grid_at: Floats
    levels: Ints


def with_borders(
    make: CellLevels, plan: pl.Planar, steps: Steps
) -> tuple[pl.Planar, list[Floats], list[BorderSamples]]:
    """Insert the complex's breaks into the tile's sides: both sides of every border have common samples.

    Returns
    -------
    plan : Planar
    side_t : m arrays
        Parameters of the samples along each side.
    borders : m BorderSamples
        Of each side. On the first half of the sides the cell is the left one, on the others the right one.
    """
    quads = [
        steps[(k + 1) % 2] for k in range(len(make.tiling.borders))
    ]  # side 0 runs along the second half axis
    own = [border_samples(make, k, quads[k]) for k in range(len(quads))]
    there = [make.beside(_back(border.step)) for border in make.tiling.borders]
    theirs = [border_samples(other, k, quads[k]) for k, other in enumerate(there)]
    placed = [(b.t, b.grid_at) for b in own] + [(1.0 - b.t[::-1], 1.0 - b.grid_at[::-1]) for b in theirs]
    if not _seamed(make):
        plan = pl.with_side_samples(plan, make.tiling.tile, placed)
    return plan, [t for t, _ in placed], [*own, *theirs]


def border_samples(make: CellLevels, k: int, quads: int) -> BorderSamples:
    """Samples of border class k between a cell, on the left, and the cell on its right.

    Cached with the cell.
    """
    if (k, quads) not in make.known:
        make.known[k, quads] = _border_samples(make, k, quads)
    found: BorderSamples = make.known[k, quads]
    return found


def _border_samples(make: CellLevels, k: int, quads: int) -> BorderSamples:
    border = make.tiling.borders[k]
    ends = _end_levels(make, k)
    if _seamed(make):
        t = grid_at = np.array([0.0, 1.0])
        groups: list[Floats] = []
    else:
        least = _least(make, border.start, border.end, quads)
        stops = make.roots(k)
        if make.bevel > 0.0:
            length = float(np.hypot(border.end[0] - border.start[0], border.end[1] - border.start[1]))
            stops = np.concatenate([stops, border_stops(make.bevel, length)])
        groups = pl.space(stops, least)
        t, grid_at = pl.place(np.array([0.5 * (g[0] + g[-1]) for g in groups]), quads, least)
    rows = _border_levels(make, k, t, groups, ends)
    t, rows = _parted(make, k, t, rows, groups, ends)
    return BorderSamples(t, grid_at, rows)


def _seamed(make: CellLevels) -> bool:
    """Whether land lies between the cells: their borders then need no points but corners."""
    return make.window.land.seam > 0.0


def _back(step: Step) -> Step:
    return -step[0], -step[1]


def border_stops(width: float, length: float) -> Floats:
    """Parameters, on a border of a given length, at which bevels end."""
    return np.array([width / length, 1.0 - width / length])


def _least(make: CellLevels, start: tuple[float, float], end: tuple[float, float], quads: int) -> float:
    """Least spacing of two border samples, as a parameter, within limits."""
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    return float(np.clip(shortest(make) / length, 1e-6, 0.05 / quads))


def settle_inside(make: CellLevels, lens: Ints) -> Ints:
    """Merge levels closer than the gap at every point separately."""
    held = np.array([make.held[0], make.held[1], True, True])
    both = np.concatenate([lens, np.broadcast_to(np.array(make.land), lens.shape)], axis=1)
    return cluster(both, held, make.gap)[:, :2]


def settle_sides(plan: pl.Planar, lens: Ints, borders: list[BorderSamples]) -> Ints:
    """Write the borders' levels into the points of the tile's sides."""
    lens = lens.copy()
    half = len(borders) // 2
    for k in range(half):
        lens[plan.sides[k]] = borders[k].levels[:, :2]
        lens[plan.sides[k + half][::-1]] = borders[k + half].levels[:, 2:]
    return lens


def _border_levels(
    make: CellLevels, k: int, t: Floats, groups: list[Floats], ends: tuple[Ints, Ints]
) -> Ints:
    """Merged levels of both cells along border class k, (n, 4): equal where a break requires it."""
    inner = t[1:-1]
    held = np.array([*make.held, *make.held, True, True])
    both = _at(make, k, inner)
    for group in groups:
        at = int(np.argmin(np.abs(inner - 0.5 * (group[0] + group[-1]))))
        for root in _at(make, k, group):
            _hold_equal(make, both[at], root, held)
    merged = cluster(both, held, make.gap)[:, :4]
    return np.concatenate([ends[0][None], merged, ends[1][None]])


def _parted(
    make: CellLevels, k: int, t: Floats, rows: Ints, groups: list[Floats], ends: tuple[Ints, Ints]
) -> tuple[Floats, Ints]:
    """Separate two columns that only touch along a stretch of the border, so that no edge has four faces.

    Between the ends of the stretch the upper column moves up by the merge height, a few z steps.
    """
    touch = _touching(rows)
    alone = touch[:-1] & touch[1:]
    alone[1:] &= ~touch[:-2]
    alone[:-1] &= ~touch[2:]
    if alone.any():  # two samples without one between them that could be moved
        t = np.sort(np.concatenate([t, 0.5 * (t[:-1] + t[1:])[alone]]))
        rows = _border_levels(make, k, t, groups, ends)
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
    """Whether both columns exist and share a level but no material."""
    there = (rows[:, 0] <= rows[:, 1]) & (rows[:, 2] <= rows[:, 3]) & (np.abs(rows) < FAR).all(axis=1)
    shared = np.minimum(rows[:, 1], rows[:, 3]) - np.maximum(rows[:, 0], rows[:, 2])
    return np.asarray(there & (shared == 0))


def _at(make: CellLevels, k: int, t: Floats) -> Ints:
    """Levels (n, 6) of left front, back, right front, back and land at parameters (n,) of border class k."""
    tile, m = make.tiling.tile, len(make.tiling.tile)
    half = m // 2
    left = make.heights(pl.side_points(tile[k], tile[(k + 1) % m], t))
    there = make.beside(make.tiling.borders[k].step)
    right = there.heights(pl.side_points(tile[(k + half + 1) % m], tile[k + half], t))
    levels = make.levels(np.concatenate([left, right], axis=1).reshape(len(t), 2, 2)).reshape(len(t), 4)
    return np.concatenate([levels, np.broadcast_to(np.array(make.land), (len(t), 2))], axis=1)


def _hold_equal(make: CellLevels, here: Ints, root: Ints, held: Bools) -> None:
    """Equalise, in place, the levels that are equal at the root (a sample may lie slightly off the root)."""
    order = np.argsort(root, kind="stable")
    runs = np.split(order, np.flatnonzero(np.diff(root[order]) > make.gap) + 1)
    for run in runs:
        if len(run) < 2 or (np.abs(root[run]) >= FAR).any() or (np.abs(here[run]) >= FAR).any():
            continue
        fixed = run[held[run]]
        here[run] = here[fixed[0]] if len(fixed) else int(here[run].min() + here[run].max()) // 2


def _end_levels(make: CellLevels, k: int) -> tuple[Ints, Ints]:
    """Merged left front, left back, right front, right back at both ends of border class k, (4,) each."""
    m = len(make.tiling.tile)
    half = m // 2
    start, end = _node_levels(make, k), _node_levels(make, (k + 1) % m)
    return (
        np.concatenate([start[k], start[(k + half + 1) % m]]),
        np.concatenate([end[(k + 1) % m], end[k + half]]),
    )


def _node_levels(make: CellLevels, corner: int) -> dict[int, Ints]:
    """Merged front and back level (2,) of every cell around the node at a corner of a cell.

    The keys are the cells' own corners at the node.
    """
    node, here = next((n, s) for n in make.tiling.nodes for s, c in n.cells if c == corner)
    first = make.beside(_back(here))
    key = "node", node.cells[0][1]
    if key not in first.known:
        rows = [first.beside(step).at_corners[c] for step, c in node.cells]
        held = np.array([*make.held * len(rows), True, True])
        row = np.concatenate([*rows, np.array(make.land)])
        settled = cluster(row[None], held, make.gap)[0][:-2].reshape(-1, 2)
        first.known[key] = {c: levels for (_, c), levels in zip(node.cells, settled)}
    found: dict[int, Ints] = first.known[key]
    return found
