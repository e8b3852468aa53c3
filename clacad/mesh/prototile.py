"""The prototile: one cell's triangulated footprint with the levels of both faces at every corner.

Borders take their samples from the cell complex, so a cell and its neighbour have common points
with common levels; rims are cut into the triangles at exact points.

Cut a triangulated cell along rims: curves where a lens intersects the other lens, a plane or land.

The curves differ from those of `topology.rims`: a cut is a point on an edge of the triangles at an integer
level. If rounding has already put a point on a curve, its level decides and not its exact height.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.polygons import doubled_areas
from clacad.base.sign_changes import bisect
from clacad.base.types import Bools, Floats, Ints
from clacad.mesh import cell_triangulation as pl
from clacad.mesh.border_samples import (
    BorderSamples,
    added_volume,
    bevelled,
    check_width,
    regular_samples,
    settle,
    settle_sides,
    with_borders,
)
from clacad.mesh.integer_heights import FAR, LAND, LENS, NONE, VOID, CellLevels, cluster, shortest
from clacad.sheet.grid_steps import Steps, grid_steps, half_axes
from clacad.sheet.window import optical_tile
from clacad.topology.complex_parts import CannotBuild

_WARP = 0.2  # a cut closer than this share of an edge to a free point moves that point instead


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve along which triangles are cut.

    value : levels (n, 2) → (n,). Positive on the side of the lens, zero on the curve; linear in the levels.
    meet : levels (n, 2), latest face (0 front, 1 back, −1 none) → levels (n, 2)
        Makes the levels equal that meet on the curve; a face that was just placed is unchanged.
    """

    value: Callable[[Ints], Ints]
    meet: Callable[[Ints, int], Ints]
    face: int


def rim_curve() -> Curve:
    """Curve along which front and back meet, with material between them on the positive side."""

    def meet(levels: Ints, placed: int) -> Ints:
        kept = levels[:, placed] if placed >= 0 else (levels[:, 0] + levels[:, 1]) // 2
        return np.stack([kept, kept], axis=1)

    return Curve(lambda lens: np.asarray(lens[:, 1] - lens[:, 0]), meet, -1)


def land_curve(make: CellLevels, side: int) -> Curve:
    """Curve along which the lens of one face meets its land; the lens is proud of it on the positive side."""
    land = make.land[side]
    sign = -make.faces[side].land_side

    def meet(levels: Ints, placed: int) -> Ints:
        out = levels.copy()
        out[:, side] = land
        return out

    return Curve(lambda lens: np.asarray(sign * (lens[:, side] - land)), meet, side)


def side_of(triangles: Ints, value: Ints) -> Ints:
    """Sign of a cut function on triangles its zero curve no longer crosses, (m,)."""
    corners = value[triangles]
    largest = np.take_along_axis(corners, np.abs(corners).argmax(axis=1)[:, None], axis=1)[:, 0]
    return np.asarray(np.sign(largest))


def cut(
    make: CellLevels, plan: pl.Planar, lens: Ints, region: Bools, curve: Curve, done: list[Curve]
) -> tuple[pl.Planar, Ints, Bools]:
    """Cut triangles of a region along a curve; `done` lists earlier curves, and this one is appended.

    Returns
    -------
    plan, lens
    positive : (m,) bool
        Triangles on the positive side.
    """
    for stage in ("warp", "snap", "cut"):
        now = curve.value(lens)
        mine = now[plan.triangles[region]]
        if not mine.size or mine.min() >= 0 or mine.max() <= 0:
            break  # no edge is crossed
        edges, number = pl.edges_of(plan.triangles)
        wanted = np.zeros(len(edges), dtype=bool)
        wanted[number[region]] = True
        ends = now[edges]
        crossed = wanted & (np.sign(ends[:, 0]) * np.sign(ends[:, 1]) < 0)
        if not crossed.any():
            break
        _refuse_cut_sides(plan, edges[crossed])
        inside = np.where(ends[crossed, 0] > 0, edges[crossed, 0], edges[crossed, 1])
        outside = np.where(ends[crossed, 0] > 0, edges[crossed, 1], edges[crossed, 0])
        t = _roots(make, plan.xy, lens, inside, outside, curve)
        if stage == "warp":
            plan, lens = _warp(make, plan, lens, inside, outside, t, curve)
            continue
        if stage == "snap":
            lens = _snap(make, plan, lens, inside, outside, t, [*done, curve])
            continue
        middle = np.full(len(edges), -1)
        middle[crossed] = len(plan.xy) + np.arange(len(t))
        plan, lens = _split(make, plan, lens, (inside, outside, t), (number, middle), [*done, curve])
    done.append(curve)
    return plan, lens, side_of(plan.triangles, curve.value(lens)) > 0


def _split(
    make: CellLevels,
    plan: pl.Planar,
    lens: Ints,
    roots: tuple[Ints, Ints, Floats],
    edges: tuple[Ints, Ints],
    curves: list[Curve],
) -> tuple[pl.Planar, Ints]:
    """Put a point on every crossed edge, at (inside, outside, share), and split its triangles there.

    `edges`: the triangles' edge numbers, and the new point on each edge or −1; the last curve is the one cut
    along.
    """
    inside, outside, t = roots
    curve = curves[-1]
    xy = plan.xy[inside] + t[:, None] * (plan.xy[outside] - plan.xy[inside])
    new = _forced(make, xy, curve)
    for earlier in curves[:-1]:  # an edge that lies on an earlier curve stays on it
        on = (earlier.value(lens)[inside] == 0) & (earlier.value(lens)[outside] == 0)
        new[on] = earlier.meet(new[on], curve.face)
    every = np.concatenate([plan.xy, xy])
    triangles, zone = pl.split(plan.triangles, plan.zone, every, *edges)
    fixed = np.concatenate([plan.fixed, np.ones(len(t), dtype=bool)])
    return replace(plan, xy=every, triangles=triangles, zone=zone, fixed=fixed), np.concatenate([lens, new])


def _refuse_cut_sides(plan: pl.Planar, crossed: Ints) -> None:
    """Refuse sign changes on a tile's side anywhere but at its own samples: such a root was missed."""
    pairs = {tuple(sorted(p)) for side in plan.sides for p in zip(side[:-1].tolist(), side[1:].tolist())}
    missed = [edge for edge in crossed.tolist() if tuple(edge) in pairs]
    if missed:
        raise CannotBuild(
            "CL130",
            f"a rim crosses a cell border between x, y = {plan.xy[missed[0][0]]} and {plan.xy[missed[0][1]]} "
            "at no isolated root: the lenslet's surface ends on the border (radius too short for the cell?)",
        )


def _roots(make: CellLevels, xy: Floats, lens: Ints, inside: Ints, outside: Ints, curve: Curve) -> Floats:
    """Parameter of the last point from the inside at which the function is not negative.

    If a point's levels were moved onto an earlier curve and its own heights no longer have its sign,
    the levels decide: the cut is at the root of their linear interpolation.
    """
    a, b = xy[inside], xy[outside]

    def value(t: Floats) -> Floats:
        return _exact(make, make.heights(a + t[:, None] * (b - a)), curve)

    true = (value(np.zeros(len(a))) > 0.0) & ~(value(np.ones(len(a))) > 0.0)
    t = bisect(lambda t: np.where(value(t) > 0.0, 1.0, -1.0), np.zeros(len(a)), np.ones(len(a)))
    jump = np.abs(value(t - 1e-9))
    if (jump[true] > 1e-4 * make.window.lattice.circumradius).any():
        raise CannotBuild(
            "CL130",
            f"a lenslet of body {make.body.name!r} ends inside its cell at its own equator, before it meets"
            " the other face or land; a longer radius, a smaller pitch, or a web would close the body",
        )
    here, there = curve.value(lens)[inside], curve.value(lens)[outside]
    t = np.where(true, t, here / (here - there))
    least = shortest(make) / np.maximum(np.hypot(*(b - a).T), 1e-300)
    return np.asarray(np.clip(t, np.minimum(least, 0.25), 1.0 - np.minimum(least, 0.25)))


def _exact(make: CellLevels, heights: Floats, curve: Curve) -> Floats:
    """The cut function on unrounded heights (length): −inf where a surface is missing."""
    scaled = heights / make.step
    # value() is linear in the levels up to its constant: evaluate it on floats of level size
    with np.errstate(invalid="ignore"):
        out = np.asarray(curve.value(scaled), dtype=np.float64) * make.step  # type: ignore[arg-type]
    return np.where(np.isnan(out), -np.inf, out)


def _forced(make: CellLevels, xy: Floats, curve: Curve) -> Ints:
    """Levels at points on a curve, where the intersecting surfaces agree exactly."""
    heights = make.heights(xy)
    heights = np.where(np.isnan(heights), np.flip(heights, axis=1), heights)
    levels = curve.meet(make.levels(heights), -1)
    held = np.array([make.held[0], make.held[1], True, True])
    both = np.concatenate([levels, np.broadcast_to(np.array(make.land), levels.shape)], axis=1)
    return cluster(both, held, make.gap)[:, :2]


def _snap(
    make: CellLevels, plan: pl.Planar, lens: Ints, inside: Ints, outside: Ints, t: Floats, curves: list[Curve]
) -> Ints:
    """Set the levels of points within a small tolerance of the last curve to lie on it, to avoid slivers."""
    length = np.hypot(*(plan.xy[outside] - plan.xy[inside]).T)
    point = np.concatenate([inside, outside])
    away = np.concatenate([t, 1.0 - t]) * np.concatenate([length, length])
    side = plan.xy[plan.sides[0]]
    hair = max(5e-4 * float(np.hypot(*(side[-1] - side[0]))) / (len(side) - 1), 2.0 * shortest(make))
    border = np.zeros(len(plan.xy), dtype=bool)
    for numbers in plan.sides:
        border[numbers] = True
    point = np.unique(point[(away < hair) & ~border[point]])
    lens = lens.copy()
    last = curves[-1]
    before = lens[point]
    lens[point] = last.meet(before, -1)
    for earlier in curves[:-1]:
        on = earlier.value(before) == 0
        lens[point[on]] = earlier.meet(lens[point[on]], last.face)
    return lens


def _lonely(plan: pl.Planar, lens: Ints, inside: Ints, t: Floats, curve: Curve) -> Ints:
    """Inner points near the curve with no inner neighbour that remains inside; these must not move."""
    stays = curve.value(lens) > 0
    near = np.unique(inside[t < _WARP])
    stays[near] = False
    edges, _ = pl.edges_of(plan.triangles)
    both = np.concatenate([edges, edges[:, ::-1]])
    kept = both[stays[both[:, 1]], 0]
    return np.setdiff1d(near, kept)


def _warp(
    make: CellLevels, plan: pl.Planar, lens: Ints, inside: Ints, outside: Ints, t: Floats, curve: Curve
) -> tuple[pl.Planar, Ints]:
    """Move free points that lie close to the curve onto it, so that no sliver is cut there."""
    point = np.concatenate([inside, outside])
    share = np.concatenate([t, 1.0 - t])
    other = np.concatenate([outside, inside])
    near = (share < _WARP) & ~plan.fixed[point] & ~np.isin(point, _lonely(plan, lens, inside, t, curve))
    point, share, other = point[near], share[near], other[near]
    order = np.argsort(share, kind="stable")[::-1]  # the nearest cut is written last
    target = plan.xy.copy()
    moved = np.zeros(len(plan.xy), dtype=bool)
    target[point[order]] = plan.xy[point[order]] + share[order, None] * (
        plan.xy[other[order]] - plan.xy[point[order]]
    )
    moved[point] = True
    before = doubled_areas(plan.xy, plan.triangles)
    while True:
        xy = np.where(moved[:, None], target, plan.xy)
        bad = doubled_areas(xy, plan.triangles) < 0.2 * before
        if not (bad.any() and moved[plan.triangles[bad]].any()):
            break
        moved[plan.triangles[bad]] = False
    lens = lens.copy()
    if moved.any():
        lens[moved] = _forced(make, xy[moved], curve)
    # a point on a curve must not leave it in a later cut
    return replace(plan, xy=xy, fixed=plan.fixed | moved), lens


@dataclass(frozen=True, eq=False)
class Prototile:
    """One cell of a body's tiling.

    lens : (n, 2) int64
        Level of front and back lens (or plane) at each point; ±FAR for a separately meshed face.
    land : (front, back) int. Level of the land; ±NONE without land.
    part : (m, 2) uint8
        LENS, LAND or VOID: front and back of each triangle. A column is void in both or in neither.
    plane : (bool, bool). Whether front and back are plane faces that need only their border points.
    step : length. Height of one level.
    side_t : m arrays. Parameters of the points of each side of the tile.
    lifted : (m, 2, 3) int64 or None
        Levels of front and back at the corners of triangles that a saddle's bevel raises, NONE elsewhere.
    on_left : m arrays (n, 2), lengths. Points of each side without its ends, in the frame of the border's
        left cell, in the border's direction.
    outermost : (front, back). Which of lens and land protrudes: `CellLevels.outermost`.
    """

    plan: pl.Planar
    lens: Ints
    land: tuple[int, int]
    part: NDArray[np.uint8]
    plane: tuple[bool, bool]
    step: float
    side_t: tuple[Floats, ...]
    lifted: Ints | None = None
    on_left: tuple[Floats, ...] = ()
    outermost: tuple[Callable[..., Any], Callable[..., Any]] = (np.minimum, np.maximum)

    def corner_levels(self) -> Ints:
        """Front and back level at each triangle's corners, (m, 3, 2); NONE, −NONE where void."""
        lens = outermost(self.lens, self.land, self.outermost)[self.plan.triangles]
        land = np.array(self.land)
        none = np.array([NONE, -NONE])
        part = self.part[:, None, :]
        flush = np.asarray(np.where(part == LENS, lens, np.where(part == LAND, land, none)))
        if self.lifted is None:
            return flush
        raised = np.moveaxis(self.lifted, 1, 2)
        return np.asarray(np.where(raised != NONE, raised, flush))

    def bevelled(self, side: int) -> Bools:
        """Triangles of one face that belong to a bevel instead of lens or land, (m,)."""
        if self.lifted is None:
            return np.zeros(len(self.plan.triangles), dtype=bool)
        return np.asarray(self.lifted[:, side, 0] != NONE)

    def bevel_volume(self) -> float:
        """Volume (length³) added by a cell's bevels."""
        if self.lifted is None:
            return 0.0
        return added_volume(
            self.plan, replace(self, lifted=None).corner_levels(), self.corner_levels(), self.step
        )


def outermost(
    lens: Ints, land: tuple[int, int], protruding: tuple[Callable[..., Any], Callable[..., Any]]
) -> Ints:
    """Levels (..., 2) of columns: the outermost of lens and land; `protruding` as `CellLevels.outermost`.

    A negative thickness, on a coarse grid, becomes 0.
    """
    front, back = lens[..., 0], lens[..., 1]
    if abs(land[0]) < FAR:
        front = protruding[0](front, land[0])
    if abs(land[1]) < FAR:
        back = protruding[1](back, land[1])
    thin = (front > back) & (np.abs(front) < FAR) & (np.abs(back) < FAR)
    middle = np.where(thin, front + back, 0) // 2
    return np.stack([np.where(thin, middle, front), np.where(thin, middle, back)], axis=-1)


def regular_prototile(make: CellLevels, quads: int, levels: tuple[int, int]) -> Prototile:
    """A cell whose borders have the samples of the grid and whose lenses, at two levels, cover its zone."""
    steps = _steps(make, quads)
    plan, borders = _grid(make, steps), regular_samples(make, steps)
    side_t = [border.t for border in borders]
    side_t += [1.0 - t[::-1] for t in side_t]
    if make.window.land.seam == 0.0:
        plan = pl.with_side_samples(plan, make.tiling.tile, [(t, t) for t in side_t])
    lens = np.empty((len(plan.xy), 2), dtype=np.int64)
    for side, face in enumerate(make.faces):
        flat = int(make.levels(np.full(2, face.vertex[2]))[side])
        lens[:, side] = (
            (FAR * (2 * side - 1)) if not make.meshed()[side] else flat if make.held[side] else levels[side]
        )
    part = _parts(make, plan.zone, [plan.zone, plan.zone])
    plane = (make.held[0] and bool(plan.zone.all()), make.held[1] and bool(plan.zone.all()))
    on_left = _on_left(make, [*borders, *borders])
    return Prototile(plan, lens, make.land, part, plane, make.step, tuple(side_t), None, on_left)


def make_prototile(make: CellLevels, quads: int) -> Prototile:
    """Mesh one cell of a body's tiling, with `quads` grid steps along each side of its optical zone that
    bends.

    Raises CannotBuild, ValueError: No point of the grid lies on the lenslet; a lenslet's surface ends inside
        the cell (its equator), leaving a face with no defined edge.
    """
    window = make.window
    steps = _steps(make, quads)
    plan, side_t, borders = with_borders(make, _grid(make, steps), steps)
    lens = settle_sides(plan, settle(make, make.levels(make.heights(plan.xy))), borders)
    plan, lens, part = _with_rims(make, plan, lens)
    if (part == VOID).all():
        raise CannotBuild(
            "CL138",
            f"quads = {quads}: no point of the grid meets the lenslet of body {make.body.name!r}, whose rim"
            " lies well inside its cell; more quads would find it",
        )
    whole = not (part == VOID).any()
    lifted = None
    if make.bevel > 0.0 and window.land.seam == 0.0:  # separated lenslets have no saddles
        check_width(make, make.bevel)
        plan, lens, part, lifted = bevelled(make, plan, lens, part, side_t)
    plane = (make.held[0] and whole, make.held[1] and whole)
    sides, on_left = tuple(side_t), _on_left(make, borders)
    return Prototile(plan, lens, make.land, part, plane, make.step, sides, lifted, on_left, make.outermost)


def _on_left(make: CellLevels, borders: list[BorderSamples]) -> tuple[Floats, ...]:
    """Points (n, 2) of each side without its ends, in the left cell's frame and the border's direction."""
    tile, m = make.tiling.tile, len(make.tiling.tile)
    half = m // 2
    return tuple(
        pl.side_points(tile[k % half], tile[(k % half + 1) % m], border.t)[1:-1]
        for k, border in enumerate(borders)
    )


def _steps(make: CellLevels, quads: int) -> Steps:
    """Grid steps along each half axis of a cell, common to all cells of a tiling."""
    if make.bevel > 0.0:  # bevels need a grid with their own steps on all sides
        return quads, quads
    if ("steps", quads) not in make.common:
        plate = (make, *make.joined)
        mine = [face for one in plate for face, here in zip(one.faces, one.meshed(), strict=True) if here]
        make.common["steps", quads] = grid_steps(make.window, make.tiling.array, mine, quads)
    found: Steps = make.common["steps", quads]
    return found


def _grid(make: CellLevels, steps: Steps) -> pl.Planar:
    """The regular grid over a cell, common to all cells of a tiling: that of the first cell requested."""
    if ("grid", steps) not in make.common:
        zone = optical_tile(make.window, make.tiling.array)
        diagonal = _diagonal(make, zone, steps)
        make.common["grid", steps] = pl.grid(make.window.lattice, make.tiling.tile, zone, steps, diagonal)
    found: pl.Planar = make.common["grid", steps]
    return found


def _with_rims(make: CellLevels, plan: pl.Planar, lens: Ints) -> tuple[pl.Planar, Ints, NDArray[np.uint8]]:
    """Cut a cell along its rims: (plan, lens, part) as in `Prototile`."""
    material = plan.zone.copy()
    done: list[Curve] = []
    if make.cells.columnar:
        plan, lens, enclosed = cut(make, plan, lens, plan.zone, rim_curve(), done)
        material = plan.zone & enclosed
    proud: list[Bools] = []
    for side in (0, 1):
        if _without_rim(make, side):
            proud.append(material)
            continue
        plan, lens, positive = cut(make, plan, lens, material, land_curve(make, side), done)
        material, proud = _again(make, plan, lens, proud)
        proud.append(material & positive)
    return plan, lens, _parts(make, material, proud)


def _without_rim(make: CellLevels, side: int) -> bool:
    """Whether a face does not end on its own land: it is a plane, has no land, or is meshed separately."""
    return make.held[side] or make.land[side] in (NONE, -NONE) or not make.meshed()[side]


def _again(make: CellLevels, plan: pl.Planar, lens: Ints, proud: list[Bools]) -> tuple[Bools, list[Bools]]:
    """Classify material and proud triangles again after further cuts."""
    material = plan.zone.copy()
    if make.cells.columnar:
        material &= side_of(plan.triangles, rim_curve().value(lens)) > 0
    again = []
    for side in range(len(proud)):
        if _without_rim(make, side):
            again.append(material)
        else:
            again.append(material & (side_of(plan.triangles, land_curve(make, side).value(lens)) > 0))
    return material, again


def _parts(make: CellLevels, material: Bools, proud: list[Bools]) -> NDArray[np.uint8]:
    """Kind of front and back of each triangle."""
    part = np.full((len(material), 2), VOID, dtype=np.uint8)
    lands = [level not in (NONE, -NONE) for level in make.land]
    for side in (0, 1):
        flat = LENS if make.held[side] else LAND
        if not make.meshed()[side]:
            part[:, side] = LENS
            continue
        part[:, side] = np.where(proud[side], LENS, np.where(lands[side], flat, VOID))
        if not lands[side]:
            part[material, side] = LENS
    void = (part == VOID).any(axis=1)
    part[void] = VOID
    return part


def _diagonal(make: CellLevels, zone: Floats, steps: Steps) -> int:
    """Split squares along the direction in which the surfaces bend less."""
    if make.window.lattice.hexagonal:
        return 1
    x, y = (
        v.ravel()[:, None] for v in np.meshgrid(*((2 * np.arange(5) - 4) / 4 * (1 - 1 / q) for q in steps))
    )
    a, b = half_axes(zone)
    places = x * a + y * b
    a, b = a / steps[0], b / steps[1]

    def heights(xy: Floats) -> Floats:
        return np.concatenate([one.heights(xy) for one in (make, *make.joined)], axis=1)

    def bend(step: Floats) -> float:
        middle = heights(places)
        ends = [heights(places + s * step) for s in (1.0, -1.0)]
        with np.errstate(invalid="ignore"):
            second = np.abs(ends[0] + ends[1] - 2.0 * middle)
        return float(np.nansum(second[np.isfinite(second)]))

    return 1 if bend(a + b) <= bend(a - b) * (1.0 + 1e-9) else -1
