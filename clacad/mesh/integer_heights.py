"""Heights as integer multiples of a binary step: equal heights are equal to the last bit, everywhere.

The step is the float32 spacing at the sheet's largest |z|, so that every height survives a float32 file
unchanged. Single linkage merges levels closer than a few steps, which leaves room for a vertex between any
two different levels. Levels are independent of the cell complex: a mesh needs heights at many points between
its nodes and roots, and only integers are equal there for all cells.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import ceil, frexp, ldexp, sqrt
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from clacad.base.arrays import distinct
from clacad.base.types import Bools, Floats, Ints
from clacad.optics.surface.intersection import meet
from clacad.sheet.pattern import Step
from clacad.sheet.window import Body, Face, Window, lens_height, lenses_of, sag_by_itself
from clacad.topology.borders import roots_between
from clacad.topology.complex_parts import CellComplex, Tiling, linked

FAR = 2**60  # the other side of a body whose faces are meshed separately
NONE = 2**61  # a front without a surface; −NONE a back without one
LENS, LAND, VOID = 0, 1, 2  # kind of a face over a triangle of the footprint
LEAST_GAP = 4  # least number of steps between two distinct levels


def z_step(window: Window) -> float:
    """The binary step of heights (length): float32 spacing at the largest |z| of the sheet."""
    lands = [abs(face.land) for face in window.faces if face.land is not None]
    top = max(abs(window.z_range[0]), abs(window.z_range[1]), *lands, 1e-300) * (1.0 + 1e-6)
    return ldexp(1.0, frexp(top)[1] - 24)


def to_levels(z: Floats, step: float, missing: int) -> Ints:
    """Round heights to levels; NaN gives `missing`, infinite heights ±FAR."""
    z = np.asarray(z, dtype=np.float64)
    known = np.isfinite(z)
    level = np.rint(np.where(known, z, 0.0) / step).astype(np.int64)
    return np.asarray(np.where(known, level, np.where(np.isnan(z), missing, np.where(z > 0, FAR, -FAR))))


def merge_steps(merge: float | None, step: float) -> int:
    """Merge height in steps: at least LEAST_GAP."""
    return LEAST_GAP if merge is None else max(LEAST_GAP, ceil(merge / step))


def cluster(levels: Ints, fixed: Bools, gap: int) -> Ints:
    """Single linkage along each row: levels whose sorted gaps are at most `gap` become one.

    levels : (n, c) int64. Values of magnitude FAR and beyond are unchanged.
    fixed : (c,) bool. Columns whose level a cluster adopts (land, plane faces); else it adopts its middle.
    """
    order = np.argsort(levels, axis=1, kind="stable")
    z = np.take_along_axis(levels, order, axis=1)
    group = linked(
        z, gap
    )  # levels of magnitude FAR are never within `gap` of a real one; equal ones may share a group
    n, c = z.shape
    flat = group + c * np.arange(n)[:, None]
    first = np.full(n * c, np.iinfo(np.int64).max)
    last = np.full(n * c, np.iinfo(np.int64).min)
    np.minimum.at(first, flat, z)
    np.maximum.at(last, flat, z)
    chosen = first + (last - first) // 2 if n * c else first
    held = fixed[order]
    chosen[flat[held]] = z[held]
    out = np.empty_like(z)
    np.put_along_axis(out, order, chosen[flat], axis=1)
    return out


MOST_KEPT = 4096
"""Largest number of borders of cells with lenses of their own whose roots are kept."""

_ROOTS: WeakKeyDictionary[Window, dict[tuple[int, ...], Floats]] = WeakKeyDictionary()
"""Roots of borders by body, array, cell on the left, and class: no facet grid changes them."""


@dataclass(frozen=True, eq=False)
class CellLevels:
    """The heights of one cell of a body's tiling as levels, for every step of making a prototile.

    window, body, cells, tiling
    step : length
        Height of one level.
    gap : int
        Merge height in steps.
    bevel : length
        Width of the bevels at saddles; 0: none.
    index : (i, j)
        The cell, if each is a separate piece.
    others : callable or None
        Index → heights of that cell; None: all cells are identical pieces.
    sheet : CellLevels or None
        Heights of all cells, if this is one of them.
    joined : tuple of CellLevels
        The other bodies of the plate on the same cells, with which grid and samples of borders are shared.
    known, common : dict
        Cached results of this cell, and of all cells of the tiling.
    """

    window: Window
    body: Body
    cells: CellComplex
    tiling: Tiling
    step: float
    gap: int
    bevel: float = 0.0
    index: Step = (0, 0)
    others: Callable[[Step], CellLevels] | None = None
    joined: tuple[CellLevels, ...] = ()
    sheet: CellLevels | None = None
    known: dict[Any, Any] = field(default_factory=dict, repr=False)
    common: dict[Any, Any] = field(default_factory=dict, repr=False)

    def of_cell(self, index: Step, others: Callable[[Step], CellLevels]) -> CellLevels:
        """The levels of the cell at `index`, with its own lenses; `others` returns its neighbours' levels."""
        at = np.array(index)
        front, back = (self.window.in_cell(face, at).simplified for face in self.faces)
        body = replace(self.body, front=front, back=back)
        joined = tuple(
            one.of_cell(index, partial(_joined_at, others, number)) for number, one in enumerate(self.joined)
        )
        return replace(self, body=body, index=index, others=others, joined=joined, sheet=self, known={})

    def beside(self, step: Step) -> CellLevels:
        """The levels of the cell at an index step from this one, kept or not."""
        if self.others is None or step == (0, 0):
            return self
        return self.others((self.index[0] + step[0], self.index[1] + step[1]))

    def roots(self, k: int) -> Floats:
        """`Border.roots` of border class k between this cell, on the left, and the one on its right; with
        those of the joined bodies.
        """
        if not self.joined:
            return self._own_roots(k)
        return distinct(np.concatenate([one._own_roots(k) for one in (self, *self.joined)]))

    def _own_roots(self, k: int) -> Floats:
        border = self.tiling.borders[k]
        if self.others is None:
            return border.roots
        assert self.sheet is not None
        own = [n for n, body in enumerate(self.window.bodies) if body is self.sheet.body]
        known = _ROOTS.setdefault(self.window, {}) if own else {}
        key = (*own, self.tiling.array, *self.index, k)
        if key not in known:
            if len(known) >= MOST_KEPT:
                known.clear()
            bodies = self.body, self.beside(border.step).body
            known[key] = roots_between(self.window, bodies, self.tiling.array, self.cells.columnar, k)
        return known[key]

    @cached_property
    def at_corners(self) -> Ints:
        """Front and back level at each corner of the tile, (m, 2), before merging."""
        return self.levels(self.heights(self.tiling.tile))

    @property
    def faces(self) -> tuple[Face, Face]:
        """Front and back of the body."""
        return self.body.front, self.body.back

    def meshed(self) -> tuple[bool, bool]:
        """Whether front and back belong to this tiling's mesh."""
        if self.cells.columnar:
            return True, True
        return self.body.front.array == self.tiling.array, self.body.back.array == self.tiling.array

    def heights(self, xy: Floats) -> Floats:
        """Front and back lens (or plane) heights (n, 2) over cell-frame points.

        ±inf for a separately meshed face.
        """
        if self.sheet is not None and self.window.many_sizes:
            return np.asarray(self.sheet.heights_of(np.array([self.index]), xy)[0])
        out = np.empty((len(xy), 2))
        for n, (face, here) in enumerate(zip(self.faces, self.meshed())):
            if not here:
                out[:, n] = (-np.inf, np.inf)[n]
            elif face.array is None:
                out[:, n] = face.vertex[2]
            elif self.sheet is not None:
                x, y, z = face.vertex
                out[:, n] = z + _over_apex(face.simplified, xy[:, 0] - x, xy[:, 1] - y)
            else:
                out[:, n] = lens_height(face, xy[:, 0], xy[:, 1])
        return out

    def heights_of(self, cells: Ints, xy: Floats) -> Floats:
        """Heights (c, n, 2) as of `heights` in cells (c, 2) of a non-uniform sheet."""
        out = np.empty((len(cells), len(xy), 2))
        for n, (face, here) in enumerate(zip(self.faces, self.meshed())):
            if not here:
                out[..., n] = (-np.inf, np.inf)[n]
            elif face.array is None:
                out[..., n] = face.vertex[2]
            else:
                own = cells[:, None] if face.change is not None else np.zeros((1, 1, 2), dtype=np.int64)
                places = self.window.lenses(face, own)
                x, y, z = places.apex
                size = 1.0 if places.size is None else places.size
                p, q = np.broadcast_arrays((xy[:, 0] - x) / size, (xy[:, 1] - y) / size)
                lens = lenses_of(face.simplified, places, p.shape)
                out[..., n] = z + size * _over_apex(lens, p, q)
        return out

    def levels(self, heights: Floats) -> Ints:
        """Round heights (..., 2)."""
        front = to_levels(heights[..., 0], self.step, NONE)
        back = to_levels(heights[..., 1], self.step, -NONE)
        return np.stack([front, back], axis=-1)

    @cached_property
    def land(self) -> tuple[int, int]:
        """Levels of the land, ±NONE without land."""
        out = []
        for face, missing in ((self.body.front, NONE), (self.body.back, -NONE)):
            flat = face.vertex[2] if face.array is None else face.land
            out.append(missing if flat is None else int(to_levels(np.array([flat]), self.step, missing)[0]))
        front, back = self.meshed()
        return (out[0] if front else -FAR, out[1] if back else FAR)

    @property
    def outermost(self) -> tuple[Callable[..., Any], Callable[..., Any]]:
        """For front and back, which of lens and land protrudes: the lower or the higher one."""
        front, back = (np.minimum if face.land_side > 0 else np.maximum for face in self.faces)
        return front, back

    @property
    def held(self) -> tuple[bool, bool]:
        """Whether front and back are plane faces, whose level is never changed."""
        return self.body.front.array is None, self.body.back.array is None


def _over_apex(face: Face, x: Floats, y: Floats) -> Floats:
    """Height of a lens above its apex over points (...) relative to it; equal points give equal bits."""
    x_axis, y_axis, up = np.moveaxis(face.rotation, -2, 0)
    start = x.reshape(-1, 1) * x_axis + y.reshape(-1, 1) * y_axis
    if face.upright:
        sag = sag_by_itself(face.surface, start[:, 0], start[:, 1])
        if sag is not None:
            return sag.reshape(x.shape)
    met = meet(face.surface, start, np.broadcast_to(up, start.shape).copy())
    with np.errstate(invalid="ignore"):
        above = (met.gradient * up).sum(axis=-1) > 0.0
    return np.where(above & np.isfinite(met.distance), met.distance, np.nan).reshape(x.shape)


def _joined_at(others: Callable[[Step], CellLevels], number: int, step: Step) -> CellLevels:
    """Levels of joined body `number` in another cell."""
    return others(step).joined[number]


def shortest(make: CellLevels) -> float:
    """Least distance of two points: 8 float32 spacings at the sheet's rim (length)."""
    if "shortest" not in make.common:
        make.common["shortest"] = _shortest(make)
    return float(make.common["shortest"])


def _shortest(make: CellLevels) -> float:
    place = make.window.placements[make.tiling.array]
    x0, x1, y0, y1 = make.window.lattice.extent()
    scale = max(place.scale(make.window.lattice))
    if place.turn:  # a corner may come to lie on an axis
        scale *= sqrt(2.0)
    reach = max(abs(x0), abs(x1), abs(y0), abs(y1)) * scale + max(abs(s) for s in make.tiling.shift)
    return 8.0 * 2.0**-23 * reach
