"""The prototile: one cell's triangulated footprint with the levels of both faces at every corner.

Borders take their samples from the cell complex, so a cell and its neighbour have common points
with common levels; rims are cut into the triangles at exact points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Floats, Ints
from clacad.mesh import cell_triangulation as pl
from clacad.mesh.border_samples import BorderSamples, settle_inside, settle_sides, with_borders
from clacad.mesh.integer_heights import FAR, LAND, LENS, NONE, VOID, CellLevels
from clacad.mesh.rim_cut import Curve, cut, land_curve, rim_curve, side_of
from clacad.mesh.saddle_bevel import added_volume, bevelled, check_width
from clacad.sheet.grid_steps import Steps, grid_steps, half_axes
from clacad.sheet.window import optical_tile
from clacad.topology.cannot_build import CannotBuild


@dataclass(frozen=True, eq=False)
class Prototile:
    """One cell of a body's tiling.

    Attributes
    ----------
    plan : Planar
    lens : (n, 2) int64
        Level of front and back lens (or plane) at each point; ±FAR for a separately meshed face.
    land : (front, back) int
        Level of the land; ±NONE without land.
    part : (m, 2) uint8
        LENS, LAND or VOID: front and back of each triangle. A column is void in both or in neither.
    plane : (bool, bool)
        Whether front and back are plane faces that need only their border points.
    step : length
        Height of one level.
    side_t : m arrays
        Parameters of the points of each side of the tile.
    lifted : (m, 2, 3) int64 or None
        Levels of front and back at the corners of triangles that a saddle's bevel raises, NONE elsewhere.
    on_left : m arrays (n, 2), lengths
        Points of each side without its ends, in the frame of the border's left cell, in the border's
        direction.
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

    def corner_levels(self) -> Ints:
        """Front and back level at each triangle's corners, (m, 3, 2); NONE, −NONE where void."""
        front, back = self.lens[:, 0], self.lens[:, 1]
        # a column is the outermost of lens and land; a negative thickness, on a coarse grid, becomes 0
        if abs(self.land[0]) < FAR:
            front = np.minimum(front, self.land[0])
        if abs(self.land[1]) < FAR:
            back = np.maximum(back, self.land[1])
        thin = (front > back) & (np.abs(front) < FAR) & (np.abs(back) < FAR)
        middle = np.where(thin, front + back, 0) // 2
        front, back = np.where(thin, middle, front), np.where(thin, middle, back)
        lens = np.stack([front, back], axis=-1)[self.plan.triangles]
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


def make_prototile(make: CellLevels, quads: int) -> Prototile:
    """Mesh one cell of a body's tiling, with `quads` grid steps along each side of its optical zone that bends.

    Raises
    ------
    CannotBuild, ValueError
        No point of the grid lies on the lenslet; a lenslet's surface ends inside the cell (its equator),
        leaving a face with no defined edge.
    """
    window = make.window
    steps = _steps(make, quads)
    plan, side_t, borders = with_borders(make, _grid(make, steps), steps)
    lens = settle_sides(plan, settle_inside(make, make.levels(make.heights(plan.xy))), borders)
    plan, lens, part = _with_rims(make, plan, lens)
    if (part == VOID).all():
        raise CannotBuild(
            "CL138",
            f"quads = {quads}: no point of the grid meets the lenslet of body {make.body.name!r}, whose rim lies well "
            "inside its cell; more quads would find it",
        )
    whole = not (part == VOID).any()
    lifted = None
    if make.bevel > 0.0 and window.land.seam == 0.0:  # separated lenslets have no saddles
        check_width(make, make.bevel)
        plan, lens, part, lifted = bevelled(make, plan, lens, part, side_t)
    plane = (make.held[0] and whole, make.held[1] and whole)
    return Prototile(
        plan, lens, make.land, part, plane, make.step, tuple(side_t), lifted, _on_left(make, borders)
    )


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
        faces = (make.body.front, make.body.back)
        mine = [face for face, here in zip(faces, make.meshed(), strict=True) if here]
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

    def bend(step: Floats) -> float:
        middle = make.heights(places)
        ends = [make.heights(places + s * step) for s in (1.0, -1.0)]
        with np.errstate(invalid="ignore"):
            second = np.abs(ends[0] + ends[1] - 2.0 * middle)
        return float(np.nansum(second[np.isfinite(second)]))

    return 1 if bend(a + b) <= bend(a - b) * (1.0 + 1e-9) else -1
