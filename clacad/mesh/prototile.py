"""The prototile: one cell's triangulated footprint with the levels of both faces at every corner.

Borders take their samples from the cell complex, so a cell and its neighbour meet in the same points
at the same levels; rims are cut into the triangles at exact points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clacad.cell_complex import CellComplex, Tiling
from clacad.cell_complex.roots import bisect
from clacad.mesh import planar as pl
from clacad.mesh.levels import FAR, NONE, cluster, to_levels
from clacad.sheet import Body, Window, lens_height, optical_tile

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

LENS, LAND, VOID = 0, 1, 2
_WARP = 0.2  # a cut nearer than this share of an edge to a free point moves the point instead


@dataclass(frozen=True, eq=False)
class Prototile:
    """One cell of a body's tiling.

    Attributes
    ----------
    plan : Planar
    lens : (n, 2) int64
        Level of front and back lens (or plane) at each point; ±FAR for a face that is meshed apart.
    land : (front, back) int
        Level of the land; ±NONE where there is none.
    part : (m, 2) uint8
        LENS, LAND or VOID: front and back of each triangle. A column is void in both or in neither.
    plane : (bool, bool)
        Whether front and back are plane faces that need only their border points.
    step : length
        Height of one level.
    side_t : m arrays
        Parameters of the points of each side of the tile.
    """

    plan: pl.Planar
    lens: Ints
    land: tuple[int, int]
    part: NDArray[np.uint8]
    plane: tuple[bool, bool]
    step: float
    side_t: tuple[Floats, ...]

    def corner_levels(self) -> Ints:
        """Front and back level at each triangle's corners, (m, 3, 2); NONE, −NONE where void."""
        lens = self.lens[self.plan.triangles]
        land = np.array(self.land)
        none = np.array([NONE, -NONE])
        part = self.part[:, None, :]
        return np.asarray(np.where(part == LENS, lens, np.where(part == LAND, land, none)))


@dataclass(frozen=True, eq=False)
class _Maker:
    """What every step of making a prototile needs."""

    window: Window
    body: Body
    cells: CellComplex
    tiling: Tiling
    step: float
    gap: int

    def names(self) -> tuple[bool, bool]:
        """Whether front and back belong to this tiling's mesh."""
        if self.cells.columnar:
            return True, True
        return self.body.front.array == self.tiling.array, self.body.back.array == self.tiling.array

    def heights(self, xy: Floats) -> Floats:
        """Front and back lens (or plane) heights (n, 2) over cell-frame points; ±inf for a face apart."""
        out = np.empty((len(xy), 2))
        for n, (face, here) in enumerate(zip((self.body.front, self.body.back), self.names())):
            if not here:
                out[:, n] = (-np.inf, np.inf)[n]
            elif face.array is None:
                out[:, n] = face.vertex[2]
            else:
                out[:, n] = lens_height(face, xy[:, 0], xy[:, 1])
        return out

    def levels(self, heights: Floats) -> Ints:
        """Round heights (..., 2)."""
        front = to_levels(heights[..., 0], self.step, NONE)
        back = to_levels(heights[..., 1], self.step, -NONE)
        return np.stack([front, back], axis=-1)

    @property
    def land(self) -> tuple[int, int]:
        """Levels of the land, ±NONE where there is none."""
        out = []
        for face, missing in ((self.body.front, NONE), (self.body.back, -NONE)):
            flat = face.vertex[2] if face.array is None else face.land
            out.append(missing if flat is None else int(to_levels(np.array([flat]), self.step, missing)[0]))
        front, back = self.names()
        return (out[0] if front else -FAR, out[1] if back else FAR)

    @property
    def held(self) -> tuple[bool, bool]:
        """Whether front and back are plane faces, whose level nothing moves."""
        return self.body.front.array is None, self.body.back.array is None


def make_prototile(
    window: Window, body: Body, cells: CellComplex, tiling: Tiling, quads: int, step: float, gap: int
) -> Prototile:
    """Mesh one cell of a body's tiling.

    Parameters
    ----------
    window, body, cells, tiling
    quads : int
        Grid steps along each side of the cell's optical zone.
    step : length
        Height of one level.
    gap : int
        Merge height in steps.

    Raises
    ------
    ValueError
        A lenslet's surface ends inside the cell (its equator), leaving a face with no defined edge.
    """
    make = _Maker(window, body, cells, tiling, step, gap)
    tile, zone = tiling.tile, optical_tile(window)
    plan = pl.grid(window.lattice, tile, zone, quads, _diagonal(make, zone, quads))
    plan, side_t, levels = _with_borders(make, plan, quads)
    lens = make.levels(make.heights(plan.xy))
    lens = _settle_inside(make, plan, lens)
    lens = _settle_sides(plan, lens, levels)
    material = plan.zone.copy()
    done: list[Curve] = []
    if make.cells.columnar:
        plan, lens, enclosed = _cut(make, plan, lens, plan.zone, _rim(), done)
        material = plan.zone & enclosed
    proud = []
    for side in (0, 1):
        if make.held[side] or make.land[side] in (NONE, -NONE) or not make.names()[side]:
            proud.append(material)
            continue
        plan, lens, positive = _cut(make, plan, lens, material, _land_curve(make, side), done)
        material, proud = _again(make, plan, lens, proud)
        proud.append(material & positive)
    part = _parts(make, material, proud)
    whole = not (part == VOID).any()
    plane = (make.held[0] and whole, make.held[1] and whole)
    return Prototile(plan, lens, make.land, part, plane, step, tuple(side_t))


def _again(make: _Maker, plan: pl.Planar, lens: Ints, proud: list[Bools]) -> tuple[Bools, list[Bools]]:
    """Tell material and proud triangles anew after triangles were cut further."""
    material = plan.zone.copy()
    if make.cells.columnar:
        material &= _sign(plan.triangles, _rim().value(lens)) > 0
    again = []
    for side in range(len(proud)):
        if make.held[side] or make.land[side] in (NONE, -NONE) or not make.names()[side]:
            again.append(material)
        else:
            again.append(material & (_sign(plan.triangles, _land_curve(make, side).value(lens)) > 0))
    return material, again


def _parts(make: _Maker, material: Bools, proud: list[Bools]) -> NDArray[np.uint8]:
    """What front and back of each triangle are."""
    part = np.full((len(material), 2), VOID, dtype=np.uint8)
    lands = [level not in (NONE, -NONE) for level in make.land]
    for side in (0, 1):
        flat = LENS if make.held[side] else LAND
        if not make.names()[side]:
            part[:, side] = LENS
            continue
        part[:, side] = np.where(proud[side], LENS, np.where(lands[side], flat, VOID))
        if not lands[side]:
            part[material, side] = LENS
    void = (part == VOID).any(axis=1)
    part[void] = VOID
    return part


def _diagonal(make: _Maker, zone: Floats, quads: int) -> int:
    """Split squares along the direction in which the surfaces bend less."""
    if make.window.lattice.hexagonal:
        return 1
    at = (2 * np.arange(5) - 4) / 4 * (1 - 1 / quads)
    x, y = (v.ravel() for v in np.meshgrid(zone[0, 0] * at, zone[1, 1] * at))
    ex, ey = zone[0, 0] / quads, zone[1, 1] / quads

    def bend(sx: float, sy: float) -> float:
        middle = make.heights(np.stack([x, y], axis=1))
        ends = [make.heights(np.stack([x + s * sx, y + s * sy], axis=1)) for s in (1.0, -1.0)]
        with np.errstate(invalid="ignore"):
            second = np.abs(ends[0] + ends[1] - 2.0 * middle)
        return float(np.nansum(second[np.isfinite(second)]))

    return 1 if bend(ex, ey) <= bend(ex, -ey) * (1.0 + 1e-9) else -1


# -- borders ---------------------------------------------------------------------------------------


def _with_borders(make: _Maker, plan: pl.Planar, quads: int) -> tuple[pl.Planar, list[Floats], list[Ints]]:
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
            groups = pl.space(border.roots, least)
            t, grid_at = pl.place(np.array([0.5 * (g[0] + g[-1]) for g in groups]), quads, least)
        rows = _border_levels(make, border.index, t, groups, nodes)
        t, rows = _parted(make, border.index, t, rows, groups, nodes)
        placed.append((t, grid_at))
        levels.append(rows)
    placed += [(1.0 - t[::-1], 1.0 - g[::-1]) for t, g in placed]
    if not seam:
        plan = pl.with_side_samples(plan, make.tiling.tile, placed)
    return plan, [t for t, _ in placed], levels


def _shortest(make: _Maker) -> float:
    """Least distance of two points: 8 float32 spacings at the sheet's rim (length)."""
    x0, x1, y0, y1 = make.window.lattice.extent()
    reach = max(abs(x0), abs(x1), abs(y0), abs(y1)) + max(abs(s) for s in make.tiling.shift)
    return 8.0 * 2.0**-23 * reach


def _least(make: _Maker, start: tuple[float, float], end: tuple[float, float], quads: int) -> float:
    """Least spacing of two border samples, as a parameter, within reason."""
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    return float(np.clip(_shortest(make) / length, 1e-6, 0.05 / quads))


def _settle_inside(make: _Maker, plan: pl.Planar, lens: Ints) -> Ints:
    """Merge levels closer than the gap at every point by itself."""
    held = np.array([make.held[0], make.held[1], True, True])
    both = np.concatenate([lens, np.broadcast_to(np.array(make.land), lens.shape)], axis=1)
    return cluster(both, held, make.gap)[:, :2]


def _settle_sides(plan: pl.Planar, lens: Ints, levels: list[Ints]) -> Ints:
    """Write the borders' levels into the points of the tile's sides."""
    lens = lens.copy()
    half = len(levels)
    for k, rows in enumerate(levels):
        lens[plan.sides[k]] = rows[:, :2]
        lens[plan.sides[k + half][::-1]] = rows[:, 2:]
    return lens


def _border_levels(make: _Maker, k: int, t: Floats, groups: list[Floats], nodes: Ints) -> Ints:
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
    make: _Maker, k: int, t: Floats, rows: Ints, groups: list[Floats], nodes: Ints
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


def _at(make: _Maker, k: int, t: float) -> Ints:
    """Levels of left front, back, right front, back and land at a parameter of border class k."""
    tile, m = make.tiling.tile, len(make.tiling.tile)
    half = m // 2
    left = pl.side_points(tile[k], tile[(k + 1) % m], np.array([t]))
    right = pl.side_points(tile[(k + half + 1) % m], tile[k + half], np.array([t]))
    levels = make.levels(make.heights(np.concatenate([left, right])))
    return np.concatenate([levels[0], levels[1], np.array(make.land)])


def _hold_equal(make: _Maker, here: Ints, root: Ints, held: Bools) -> None:
    """Make equal, in place, the levels that are equal at the root (a sample may stand a little beside it)."""
    order = np.argsort(root, kind="stable")
    runs = np.split(order, np.flatnonzero(np.diff(root[order]) > make.gap) + 1)
    for run in runs:
        if len(run) < 2 or (np.abs(root[run]) >= FAR).any() or (np.abs(here[run]) >= FAR).any():
            continue
        fixed = run[held[run]]
        here[run] = here[fixed[0]] if len(fixed) else int(here[run].min() + here[run].max()) // 2


def _node_levels(make: _Maker) -> Ints:
    """Merged front and back level at each corner of the tile, (m, 2)."""
    levels = make.levels(make.heights(make.tiling.tile))
    for node in make.tiling.nodes:
        corners = [c for _, c in node.cells]
        row = np.concatenate([levels[corners].ravel(), np.array(make.land)])
        held = np.array([*make.held * len(corners), True, True])
        levels[corners] = cluster(row[None], held, make.gap)[0][:-2].reshape(-1, 2)
    return levels


# -- rims ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve along which triangles are cut.

    value : levels (n, 2) → (n,)
        Positive on the side of the lens, zero on the curve; linear in the levels.
    meet : levels (n, 2), latest face (0 front, 1 back, −1 none) → levels (n, 2)
        Makes equal what meets on the curve; a face that was just placed is kept.
    """

    value: Callable[[Ints], Ints]
    meet: Callable[[Ints, int], Ints]
    face: int


def _rim() -> Curve:
    """Front and back enclose material on the positive side and meet on the curve."""

    def meet(levels: Ints, placed: int) -> Ints:
        kept = levels[:, placed] if placed >= 0 else (levels[:, 0] + levels[:, 1]) // 2
        return np.stack([kept, kept], axis=1)

    return Curve(lambda lens: np.asarray(lens[:, 1] - lens[:, 0]), meet, -1)


def _land_curve(make: _Maker, side: int) -> Curve:
    """The lens of one face stands proud of its land on the positive side."""
    land = make.land[side]
    sign = 1 if side else -1

    def meet(levels: Ints, placed: int) -> Ints:
        out = levels.copy()
        out[:, side] = land
        return out

    return Curve(lambda lens: np.asarray(sign * (lens[:, side] - land)), meet, side)


def _sign(triangles: Ints, value: Ints) -> Ints:
    """Sign of a cut function on triangles its zero curve no longer crosses, (m,)."""
    corners = value[triangles]
    largest = np.take_along_axis(corners, np.abs(corners).argmax(axis=1)[:, None], axis=1)[:, 0]
    return np.asarray(np.sign(largest))


def _cut(
    make: _Maker, plan: pl.Planar, lens: Ints, region: Bools, curve: Curve, done: list[Curve]
) -> tuple[pl.Planar, Ints, Bools]:
    """Cut triangles of a region along a curve; `done` lists earlier curves and takes this one.

    Returns
    -------
    plan, lens
    positive : (m,) bool
        Triangles on the positive side.
    """
    for stage in ("warp", "snap", "cut"):
        now = curve.value(lens)
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
        t = _roots(make, plan.xy, inside, outside, curve)
        if stage == "warp":
            plan, lens = _warp(make, plan, lens, inside, outside, t, curve)
            continue
        if stage == "snap":
            lens = _snap(make, plan, lens, inside, outside, t, [*done, curve])
            continue
        xy = plan.xy[inside] + t[:, None] * (plan.xy[outside] - plan.xy[inside])
        new = _forced(make, xy, curve)
        for earlier in done:  # an edge that lies on an earlier curve stays on it
            on = (earlier.value(lens)[inside] == 0) & (earlier.value(lens)[outside] == 0)
            new[on] = earlier.meet(new[on], curve.face)
        middle = np.full(len(edges), -1)
        middle[crossed] = len(plan.xy) + np.arange(len(t))
        every = np.concatenate([plan.xy, xy])
        triangles, zone = pl.split(plan.triangles, plan.zone, every, number, middle)
        fixed = np.concatenate([plan.fixed, np.ones(len(t), dtype=bool)])
        plan = replace(plan, xy=every, triangles=triangles, zone=zone, fixed=fixed)
        lens = np.concatenate([lens, new])
    done.append(curve)
    return plan, lens, _sign(plan.triangles, curve.value(lens)) > 0


def _refuse_cut_sides(plan: pl.Planar, crossed: Ints) -> None:
    """A tile's side may change sign only at its own samples; anything else is a root that was missed."""
    pairs = {tuple(sorted(p)) for side in plan.sides for p in zip(side[:-1].tolist(), side[1:].tolist())}
    missed = [edge for edge in crossed.tolist() if tuple(edge) in pairs]
    if missed:
        raise ValueError(
            f"a rim crosses a cell border between x, y = {plan.xy[missed[0][0]]} and {plan.xy[missed[0][1]]} "
            "at no isolated root: the lenslet's surface ends on the border (radius too short for the cell?)"
        )


def _roots(make: _Maker, xy: Floats, inside: Ints, outside: Ints, curve: Curve) -> Floats:
    """Parameter of the last point from the inside at which the function is not negative."""
    a, b = xy[inside], xy[outside]

    def signed(t: Floats) -> Floats:
        heights = make.heights(a + t[:, None] * (b - a))
        return np.where(_exact(make, heights, curve) > 0.0, 1.0, -1.0)

    t = bisect(signed, np.zeros(len(a)), np.ones(len(a)))
    heights = make.heights(a + (t - 1e-9)[:, None] * (b - a))
    jump = np.abs(_exact(make, heights, curve))
    if (jump > 1e-4 * make.window.lattice.circumradius).any():
        raise ValueError(
            f"a lenslet of body {make.body.name!r} ends inside its cell at its own equator, before it meets the "
            "other face or land; a longer radius, a smaller pitch, or a web would close the body"
        )
    least = _shortest(make) / np.maximum(np.hypot(*(b - a).T), 1e-300)
    return np.asarray(np.clip(t, np.minimum(least, 0.25), 1.0 - np.minimum(least, 0.25)))


def _exact(make: _Maker, heights: Floats, curve: Curve) -> Floats:
    """The cut function on unrounded heights (length): −inf where a surface is missing."""
    scaled = heights / make.step
    # value() is linear in the levels up to its constant: evaluate it on floats of level size
    with np.errstate(invalid="ignore"):
        out = np.asarray(curve.value(scaled), dtype=np.float64) * make.step  # type: ignore[arg-type]
    return np.where(np.isnan(out), -np.inf, out)


def _forced(make: _Maker, xy: Floats, curve: Curve) -> Ints:
    """Levels at points on a curve, where the meeting surfaces agree exactly."""
    heights = make.heights(xy)
    heights = np.where(np.isnan(heights), np.flip(heights, axis=1), heights)
    levels = curve.meet(make.levels(heights), -1)
    held = np.array([make.held[0], make.held[1], True, True])
    both = np.concatenate([levels, np.broadcast_to(np.array(make.land), levels.shape)], axis=1)
    return cluster(both, held, make.gap)[:, :2]


def _snap(
    make: _Maker, plan: pl.Planar, lens: Ints, inside: Ints, outside: Ints, t: Floats, curves: list[Curve]
) -> Ints:
    """Let points that lie on the last curve but for a hair lie on it, so that no hair's breadth is cut off."""
    length = np.hypot(*(plan.xy[outside] - plan.xy[inside]).T)
    point = np.concatenate([inside, outside])
    away = np.concatenate([t, 1.0 - t]) * np.concatenate([length, length])
    side = plan.xy[plan.sides[0]]
    hair = max(5e-4 * float(np.hypot(*(side[-1] - side[0]))) / (len(side) - 1), 2.0 * _shortest(make))
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


def _warp(
    make: _Maker, plan: pl.Planar, lens: Ints, inside: Ints, outside: Ints, t: Floats, curve: Curve
) -> tuple[pl.Planar, Ints]:
    """Move free points that lie close to the curve onto it, so that no sliver is cut there."""
    point = np.concatenate([inside, outside])
    share = np.concatenate([t, 1.0 - t])
    other = np.concatenate([outside, inside])
    near = (share < _WARP) & ~plan.fixed[point]
    point, share, other = point[near], share[near], other[near]
    order = np.argsort(share, kind="stable")[::-1]  # the nearest cut is written last
    target = plan.xy.copy()
    moved = np.zeros(len(plan.xy), dtype=bool)
    target[point[order]] = plan.xy[point[order]] + share[order, None] * (
        plan.xy[other[order]] - plan.xy[point[order]]
    )
    moved[point] = True
    before = pl.signed_areas(plan.xy, plan.triangles)
    while True:
        xy = np.where(moved[:, None], target, plan.xy)
        bad = pl.signed_areas(xy, plan.triangles) < 0.2 * before
        if not (bad.any() and moved[plan.triangles[bad]].any()):
            break
        moved[plan.triangles[bad]] = False
    lens = lens.copy()
    if moved.any():
        lens[moved] = _forced(make, xy[moved], curve)
    # a point that lies on a curve already must not leave it in a later cut
    return replace(plan, xy=xy, fixed=plan.fixed | moved), lens
