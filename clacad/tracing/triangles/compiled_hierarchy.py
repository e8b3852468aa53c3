"""Triangles from any source in the walk, compiled: where a ray enters or leaves a body of them."""

from __future__ import annotations

from math import inf, isnan

from clacad.base.compiled import exact
from clacad.base.types import Floats, Ints
from clacad.sheet.window import WALL as WALL_SLOPE
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.cells import sheet_xy, to_array
from clacad.tracing.compiled.column import box_span
from clacad.tracing.compiled.face import height
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import DISTANCE, FACET_NORMAL, KIND, PLACE, CellRay, Ray, Vector
from clacad.tracing.reference.column import ABOVE, ASIDE, BACK, BACK_LAND, FRONT, FRONT_LAND, WALL
from clacad.tracing.triangles.compiled_search import BOTH, hit, normal_of, search, ways_through
from clacad.tracing.triangles.hierarchy import Hierarchy

LEVEL = 1e-5
"""Slope below which a triangle may be land."""

CLEAR = 1e-9
"""Share of a cell that a ray must travel before it can meet a triangle again."""


@exact
def _is_wall(nx: float, ny: float, nz: float) -> bool:
    return nz * nz < WALL_SLOPE * WALL_SLOPE * (nx * nx + ny * ny + nz * nz)


@exact
def is_level(nx: float, ny: float, nz: float) -> bool:
    """Whether a triangle of this normal may be land."""
    return nx * nx + ny * ny <= LEVEL * LEVEL * nz * nz


@exact
def first_soup_change(
    trees: Hierarchy, sheet: Packed, b: int, ray: CellRay, inside: bool, event: Floats, stack: Ints
) -> None:
    """Find where a ray first enters or leaves the triangles of body b; see `reference.column.first_change`.

    Two cells that touch as separate solids have two coincident walls: light in the glass passes both.
    """
    bodies, lat = sheet.bodies, sheet.lattice
    array, i, j, x, y, z, L, M, N = ray
    sx, sy = sheet_xy(lat, array, i, j, x, y)
    origin, own = (sx - x, sy - y, bodies[b, slot.LEVEL]), Ray(x, y, z, L, M, N)
    aside = max(box_span(lat, bodies, b, sx, sy, L, M)[1], 0.0)
    above = inf if inside else (bodies[b, slot.BODY_HIGH] - z) / N
    clear = CLEAR * lat[slot.HALF]
    least, kind, t = clear, ASIDE, aside
    if event[DISTANCE] < 0.0:  # from the reference plane: nothing has been met yet
        least = -clear
    nx, ny, nz = 0.0, 0.0, 1.0
    which = -1
    for _ in range(64):
        t, which = search(trees, b, origin, own, least, inf, stack)
        if which < 0:
            break
        nx, ny, nz = normal_of(trees, which)
        if not (inside and _is_wall(nx, ny, nz)):
            break
        if ways_through(trees, b, origin, own, t - clear, t + clear, stack) != BOTH:
            break
        least = t + clear
    if which < 0 or t >= min(above, aside):
        kind = ABOVE if above <= aside else ASIDE
        t = min(above, aside)
    elif _is_wall(nx, ny, nz) or (nx * L + ny * M + nz * N > 0.0) != inside:
        kind = WALL
    else:
        kind = FRONT if nz < 0.0 else BACK
    event[KIND], event[DISTANCE] = kind, t
    for at in range(slot.MOST_ARRAYS):
        p, q, u, v = to_array(lat, array, at, i, j, x + t * L, y + t * M)
        place = PLACE + 4 * at
        event[place], event[place + 1], event[place + 2], event[place + 3] = p, q, u - t * L, v - t * M
    if kind == FRONT or kind == BACK:
        _tell_land(trees, sheet.faces, b, which, own, event)
        _note_normal(trees, which, origin, own, event)


@exact
def _tell_land(trees: Hierarchy, faces: Floats, b: int, which: int, ray: Ray, event: Floats) -> None:
    """Distinguish land from lens: land is level triangles nearer the design's land than its lens."""
    side, t = (0 if event[KIND] == FRONT else 1), event[DISTANCE]
    nx, ny, nz = normal_of(trees, which)
    face, level = faces[2 * b + side], ray.z + t * ray.N
    if face[slot.ARRAY] >= 0.0 and not isnan(face[slot.LAND]):
        place = PLACE + 4 * int(face[slot.ARRAY])
        lens = height(faces, 2 * b + side, event[place + 2] + t * ray.L, event[place + 3] + t * ray.M)
        if is_level(nx, ny, nz) and (isnan(lens) or abs(level - face[slot.LAND]) < abs(level - lens)):
            event[KIND] = FRONT_LAND if side == 0 else BACK_LAND


@exact
def _note_normal(trees: Hierarchy, which: int, origin: Vector, ray: Ray, event: Floats) -> None:
    """Record the normal towards +z: the triangle's, or that of its corners interpolated."""
    nx, ny, nz = normal_of(trees, which)
    if len(trees.corner_normal) > 0:
        _, u, v, w = hit(trees.corner[which], origin, ray)
        n = trees.corner_normal[which]
        nx, ny, nz = (
            u * n[0, 0] + v * n[1, 0] + w * n[2, 0],
            u * n[0, 1] + v * n[1, 1] + w * n[2, 1],
            u * n[0, 2] + v * n[1, 2] + w * n[2, 2],
        )
    sign = -1.0 if event[KIND] == FRONT or event[KIND] == FRONT_LAND else 1.0
    event[FACET_NORMAL], event[FACET_NORMAL + 1], event[FACET_NORMAL + 2] = sign * nx, sign * ny, sign * nz
