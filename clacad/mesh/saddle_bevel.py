"""Bevels at saddles: where two columns only touch along a line, their lower neighbours' corners are filled.

At a saddle the two high cells of a node meet only in a line. For a process that needs real contact, the
corner of each low cell is raised to the heights of the adjacent high cells. The raised triangle has legs of
the requested width along the two borders. The high cells then share a strip of material. Optical surfaces
lose only that triangle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clacad.base.polygons import doubled_areas
from clacad.base.types import Floats, Ints
from clacad.mesh import cell_triangulation as pl
from clacad.mesh.border_samples import settle_inside
from clacad.mesh.integer_heights import NONE, VOID, CellLevels, shortest
from clacad.sheet.pattern import turned
from clacad.sheet.window import Window
from clacad.topology.cannot_build import CannotBuild

WIDEST = 0.25
"""Largest width of a bevel, in pitches: wider bevels of one cell would meet."""


@dataclass(frozen=True, eq=False)
class LowCorner:
    """A low cell's corner at a saddle of one face.

    points : (n,)
        Footprint points on its two legs: from the end of one, over the corner, to the end of the other.
    levels : (n,)
        Levels to which they are raised.
    ends : (first, corner, last)
        The three corners of the triangle.
    """

    side: int
    points: Ints
    levels: Ints
    ends: tuple[int, int, int]


def check_width(make: CellLevels, width: float) -> None:
    """Refuse a bevel width that no mesh of this sheet can have.

    Raises
    ------
    CannotBuild
        With the least and the largest width, in design units.
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
    land = make.land
    found = [corner for side in (0, 1) for corner in _corners(make, plan, lens, part, side_t, side)]
    for corner in found:
        plan, lens, part = _cut(make, plan, lens, part, corner)
    lifted = np.full((len(plan.triangles), 2, 3), NONE, dtype=np.int64)
    for corner in found:
        _lift(plan, lens, land, part, corner, lifted)
    return plan, lens, part, lifted


def added_volume(plan: pl.Planar, before: Ints, after: Ints, step: float) -> float:
    """Volume (length³) between two sets of levels (m, 3, 2) of the same triangles."""
    area = 0.5 * doubled_areas(plan.xy, plan.triangles)
    grown = (before[..., 0] - after[..., 0]) + (after[..., 1] - before[..., 1])
    return float(np.sum(area * grown.mean(axis=1)) * step)


def _outer(lens: Ints, land: tuple[int, int], side: int, points: Ints) -> Ints:
    """Level of the outermost of lens and land at points."""
    if land[side] in (NONE, -NONE):
        return np.asarray(lens[points, side])
    outermost = np.maximum if side else np.minimum
    return np.asarray(outermost(lens[points, side], land[side]))


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
        z = out * _outer(lens, make.land, side, points)
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
        here, there = (_outer(lens, make.land, side, points[: last + 1]) for points in (own, other))
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
    new = settle_inside(make, make.levels(make.heights(xy)))
    plan = replace(plan, xy=every, triangles=triangles, zone=tags[:, 0].astype(bool), fixed=fixed)
    return plan, np.concatenate([lens, new]), np.ascontiguousarray(tags[:, 1:])


def _lift(
    plan: pl.Planar,
    lens: Ints,
    land: tuple[int, int],
    part: NDArray[np.uint8],
    corner: LowCorner,
    lifted: Ints,
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
    own = _outer(lens, land, side, points)
    level = (np.maximum if side else np.minimum)(np.rint(flat).astype(np.int64), own)
    raised = dict(zip(points.tolist(), level.tolist())) | place
    lifted[rows, side] = [[raised[point] for point in corners] for corners in plan.triangles[rows].tolist()]
