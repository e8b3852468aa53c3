"""Samples along a cell's borders and their levels, common to both cells of every border.

A bevel fills the corners of the lower neighbours where two columns only touch along a line. At such a saddle
the two high cells of a node meet only in a line. For a process that needs real contact, the
corner of each low cell is raised to the heights of the adjacent high cells. The raised triangle has legs of
the requested width along the two borders. The high cells then share a strip of material. Optical surfaces
lose only that triangle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clacad.base.polygons import doubled_areas
from clacad.base.types import Bools, Floats, Ints
from clacad.mesh import cell_triangulation as pl
from clacad.mesh.integer_heights import FAR, NONE, VOID, CellLevels, cluster, shortest
from clacad.sheet.grid_steps import Steps
from clacad.sheet.pattern import Step, turned
from clacad.topology.complex_parts import CannotBuild

if TYPE_CHECKING:
    from clacad.sheet.window import Window


@dataclass(frozen=True, slots=True, eq=False)
class BorderSamples:
    """Points of the two cells along a border, and their levels.

    t : (n,). Parameters of the samples, 0 and 1 included.
    grid_at : (quads + 1,). Indices of the samples that are points of the regular grid.
    levels : (n, 4). Left front, left back, right front, right back.
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


def regular_samples(make: CellLevels, steps: Steps) -> list[BorderSamples]:
    """Samples of the grid alone on each border class; without levels."""
    found = []
    for k in range(len(make.tiling.borders)):
        quads = 1 if _seamed(make) else steps[(k + 1) % 2]
        t, grid_at = pl.place(np.empty(0), quads, 0.0)
        found.append(BorderSamples(t, grid_at, np.zeros((len(t), 4), dtype=np.int64)))
    return found


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


def settle(make: CellLevels, levels: Ints) -> Ints:
    """Merge levels (..., c) closer than the gap, with those of the land, at every point separately.

    Front and back of one or more columns follow one another.
    """
    count = levels.shape[-1]
    held = np.array([*make.held * (count // 2), True, True])
    both = np.concatenate([levels, np.broadcast_to(np.array(make.land), (*levels.shape[:-1], 2))], axis=-1)
    both = both.reshape(-1, count + 2)
    apart = np.diff(np.sort(both, axis=1), axis=1)
    near = np.flatnonzero(((apart > 0) & (apart <= make.gap)).any(axis=1))
    both[near] = cluster(both[near], held, make.gap)
    return both[:, :count].reshape(levels.shape)


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
    touch = touching(rows)
    alone = touch[:-1] & touch[1:]
    alone[1:] &= ~touch[:-2]
    alone[:-1] &= ~touch[2:]
    if alone.any():  # two samples without one between them that could be moved
        t = np.sort(np.concatenate([t, 0.5 * (t[:-1] + t[1:])[alone]]))
        rows = _border_levels(make, k, t, groups, ends)
        touch = touching(rows)
    inside = np.flatnonzero(touch[1:-1] & touch[:-2] & touch[2:]) + 1
    rows = rows.copy()
    for n in inside.tolist():
        upper = 0 if rows[n, :2].sum() > rows[n, 2:].sum() else 2
        if rows[n, upper] == rows[n, upper + 1]:
            rows[n, upper + 1] += make.gap
        rows[n, upper] += make.gap
    return t, rows


def touching(rows: Ints) -> Bools:
    """Whether both columns (..., 4) exist and share a level but no material."""
    left_front, left_back, right_front, right_back = np.moveaxis(rows, -1, 0)
    there = (left_front <= left_back) & (right_front <= right_back) & (np.abs(rows) < FAR).all(axis=-1)
    shared = np.minimum(left_back, right_back) - np.maximum(left_front, right_front)
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


WIDEST = 0.25
"""Largest width of a bevel, in pitches: wider bevels of one cell would meet."""


@dataclass(frozen=True, eq=False)
class LowCorner:
    """A low cell's corner at a saddle of one face.

    points : (n,)
        Footprint points on its two legs: from the end of one, over the corner, to the end of the other.
    levels : (n,). Levels to which they are raised.
    ends : (first, corner, last). The three corners of the triangle.
    """

    side: int
    points: Ints
    levels: Ints
    ends: tuple[int, int, int]


def check_width(make: CellLevels, width: float) -> None:
    """Refuse a bevel width that no mesh of this sheet can have.

    Raises CannotBuild: With the least and the largest width, in design units.
    """
    least, most = 4.0 * shortest(make), WIDEST * min(make.window.lattice.pitch)
    if not least <= width <= most:
        raise CannotBuild(
            "CL135",
            f"a saddle bevel of {width:.6g} wide: this sheet takes {least:.3g} (float32 resolution at its"
            f" rim) to {most:.6g} (a quarter of the pitch)",
        )


def in_corners(window: Window, points: Floats, width: float) -> NDArray[np.bool_]:
    """Whether points (n, 2 or 3) of the sheet lie in areas where bevels of this width are possible, (n,)."""
    if window.lattice.hexagonal:
        return np.zeros(len(points), dtype=bool)
    inside = np.zeros(len(points), dtype=bool)
    for place in set(window.placements):
        own = place.lattice(window.lattice)
        at = points[:, :2] - np.array(place.shift)
        index, _, _ = own.locate(at[:, 0], at[:, 1])
        apart = 0.5 * np.array(own.pitch) - np.abs(turned(at - own.centres(index), -own.turn))
        inside |= apart.sum(axis=1) < 1.001 * width
    return inside


def bevelled(
    make: CellLevels, plan: pl.Planar, lens: Ints, part: NDArray[np.uint8], side_t: list[Floats]
) -> tuple[pl.Planar, Ints, NDArray[np.uint8], Ints]:
    """Cut the bevels' triangles out of a cell's footprint and raise them.

    Returns
    -------
    plan, lens, part
        Cut further.
    lifted : (m, 2, 3) int64
        Level of front and back at each triangle's corners where it is raised, NONE elsewhere.
    """
    found = [corner for side in (0, 1) for corner in _corners(make, plan, lens, part, side_t, side)]
    for corner in found:
        plan, lens, part = _cut(make, plan, lens, part, corner)
    lifted = np.full((len(plan.triangles), 2, 3), NONE, dtype=np.int64)
    for corner in found:
        _lift(make, plan, lens, part, corner, lifted)
    return plan, lens, part, lifted


def added_volume(plan: pl.Planar, before: Ints, after: Ints, step: float) -> float:
    """Volume (length³) between two sets of levels (m, 3, 2) of the same triangles."""
    area = 0.5 * doubled_areas(plan.xy, plan.triangles)
    grown = (before[..., 0] - after[..., 0]) + (after[..., 1] - before[..., 1])
    return float(np.sum(area * grown.mean(axis=1)) * step)


def _outer(make: CellLevels, lens: Ints, side: int, points: Ints) -> Ints:
    """Level of the outermost of lens and land at points."""
    land = make.land[side]
    if land in (NONE, -NONE):
        return np.asarray(lens[points, side])
    return np.asarray(make.outermost[side](lens[points, side], land))


def _corners(
    make: CellLevels, plan: pl.Planar, lens: Ints, part: NDArray[np.uint8], side_t: list[Floats], side: int
) -> list[LowCorner]:
    """Corners of the tile that are low at a saddle of one face."""
    if make.held[side] or not make.meshed()[side]:
        return []
    out = 1 if side else -1
    found = []
    for node in make.tiling.nodes:
        corners = [corner for _, corner in node.cells]
        points = np.array([plan.sides[c][0] for c in corners])
        if len(corners) != 4 or not all(_solid(plan, part, p) for p in points.tolist()):
            continue
        z = out * _outer(make, lens, side, points)
        if min(z[0], z[2]) > max(z[1], z[3]):
            low, top = (1, 3), min(z[0], z[2])
        elif min(z[1], z[3]) > max(z[0], z[2]):
            low, top = (0, 2), min(z[1], z[3])
        else:
            continue
        found += [_corner(make, plan, lens, side_t, side, corners[n], int(out * top)) for n in low]
    return found


def _solid(plan: pl.Planar, part: NDArray[np.uint8], point: int) -> bool:
    return bool((part[(plan.triangles == point).any(axis=1)] != VOID).all())


def _corner(
    make: CellLevels, plan: pl.Planar, lens: Ints, side_t: list[Floats], side: int, corner: int, top: int
) -> LowCorner:
    """Legs along the two sides that meet in a corner, raised to the neighbours' levels."""
    m = len(plan.sides)
    legs = []
    for k, towards in ((corner, 1), ((corner - 1) % m, -1)):
        own, other = plan.sides[k], plan.sides[(k + m // 2) % m][::-1]
        t = side_t[k] if towards > 0 else 1.0 - side_t[k][::-1]
        own, other = own[::towards], other[::towards]
        ends = make.tiling.tile[k], make.tiling.tile[(k + 1) % m]
        last = int(np.argmin(np.abs(t - make.bevel / float(np.hypot(*(ends[1] - ends[0]))))))
        here, there = (_outer(make, lens, side, points[: last + 1]) for points in (own, other))
        behind = np.flatnonzero((there <= here if side else there >= here)[1:]) + 1
        last = max(1, min([last, *behind.tolist()]))
        raised = np.maximum(here, there) if side else np.minimum(here, there)
        legs.append((own[1 : last + 1], raised[1 : last + 1]))
    (first, first_z), (second, second_z) = legs
    at = int(plan.sides[corner][0])
    return LowCorner(
        side,
        np.concatenate([first[::-1], [at], second]),
        np.concatenate([first_z[::-1], [top], second_z]),
        (int(first[-1]), at, int(second[-1])),
    )


def _beyond(plan: pl.Planar, corner: LowCorner) -> Floats:
    """Distance of every footprint point from the bevel's edge, positive on the corner's side."""
    a, c, b = (plan.xy[point] for point in corner.ends)
    along = (b - a) / np.hypot(*(b - a))
    f = along[0] * (plan.xy[:, 1] - a[1]) - along[1] * (plan.xy[:, 0] - a[0])
    f = f if f[corner.ends[1]] > 0.0 else -f
    step = float(np.min(np.hypot(*np.diff(plan.xy[plan.sides[0]], axis=0).T)))
    f[np.abs(f) < min(1e-3 * step, 0.1 * float(f[corner.ends[1]]))] = 0.0
    f[[corner.ends[0], corner.ends[2]]] = 0.0
    return np.asarray(f)


def _cut(
    make: CellLevels, plan: pl.Planar, lens: Ints, part: NDArray[np.uint8], corner: LowCorner
) -> tuple[pl.Planar, Ints, NDArray[np.uint8]]:
    """Split the triangles that the bevel's edge crosses."""
    f = _beyond(plan, corner)
    edges, number = pl.edges_of(plan.triangles)
    ends = f[edges]
    crossed = np.flatnonzero(ends[:, 0] * ends[:, 1] < 0.0)
    t = ends[crossed, 0] / (ends[crossed, 0] - ends[crossed, 1])
    a, b = plan.xy[edges[crossed, 0]], plan.xy[edges[crossed, 1]]
    xy = a + t[:, None] * (b - a)
    middle = np.full(len(edges), -1)
    middle[crossed] = len(plan.xy) + np.arange(len(crossed))
    every = np.concatenate([plan.xy, xy])
    tags = np.concatenate([plan.zone[:, None].astype(np.uint8), part], axis=1)
    triangles, tags = pl.split(plan.triangles, tags, every, number, middle)
    fixed = np.concatenate([plan.fixed, np.ones(len(xy), dtype=bool)])
    new = settle(make, make.levels(make.heights(xy)))
    plan = replace(plan, xy=every, triangles=triangles, zone=tags[:, 0].astype(bool), fixed=fixed)
    return plan, np.concatenate([lens, new]), np.ascontiguousarray(tags[:, 1:])


def _lift(
    make: CellLevels, plan: pl.Planar, lens: Ints, part: NDArray[np.uint8], corner: LowCorner, lifted: Ints
) -> None:
    """Write the raised levels of a bevel's triangles."""
    side = corner.side
    rows = np.flatnonzero(
        (_beyond(plan, corner)[plan.triangles] >= 0.0).all(axis=1) & (part[:, side] != VOID)
    )
    points = np.unique(plan.triangles[rows])
    place = dict(zip(corner.points.tolist(), corner.levels.tolist()))
    a, c, b = (np.append(plan.xy[point], place[point]) for point in corner.ends)
    normal = np.cross(a - c, b - c)
    flat: Floats = c[2] - ((plan.xy[points] - c[:2]) @ normal[:2]) / normal[2]
    own = _outer(make, lens, side, points)
    level = (np.maximum if side else np.minimum)(np.rint(flat).astype(np.int64), own)
    raised = dict(zip(points.tolist(), level.tolist())) | place
    lifted[rows, side] = [[raised[point] for point in corners] for corners in plan.triangles[rows].tolist()]
