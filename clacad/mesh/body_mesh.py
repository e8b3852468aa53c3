"""The mesh of a window's bodies: a few cell templates of each, their positions, and the land around them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import fsum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.mesh.cell_blocks import BLOCK, CellBlock, OwnBlock, number_rows, own_blocks
from clacad.mesh.health import facet_errors, flux
from clacad.mesh.land_ring import JUDGED, Tiled, ring_about, row_states
from clacad.sheet.representative_cells import representative_cells

if TYPE_CHECKING:
    from trimesh import Trimesh

    from clacad.mesh.cell_template import Template
    from clacad.sheet.lattice import Lattice
    from clacad.sheet.window import Body, Window

_CHUNK = 20_000  # largest number of triangles of an expanded block, about: they fit the second-level cache


@dataclass(frozen=True, eq=False)
class Plain:
    """Triangles of the land ring and of the outline's side wall, with separate vertices.

    key : (v, 4) int64
        Owner cell, canonical point and level of each vertex, for welding with the cells' vertices.
    """

    vertices: Floats
    key: Ints
    triangles: Ints
    kind: NDArray[np.uint8]

    @property
    def corners(self) -> Floats:
        """Corners (t, 3, 3) of its triangles."""
        return np.asarray(self.vertices[self.triangles])


@dataclass(frozen=True, eq=False)
class BodyMesh:
    """A watertight mesh of one body, expanded only on request.

    Attributes
    ----------
    name : str
    window : Window
    body : Body
    tiled : tuple of Tiled
    ringed : bool
        Whether land extends from the cells to the window's outline.
    ring : callable () → Plain
        Land ring and outline wall, made at the first call.
    step : length
        Height of one z level.
    saddles : int
        Number of vertical lines in which two columns touch and nothing else.
    bevel_volume : float
        Volume added by bevels at saddles (length³).
    cells : (n, 2) ints or None
        The kept cells included in the mesh; None: all of them. See `part`.
    counted : list of int
        The number of triangles, once a complete pass has found it.
    """

    name: str
    window: Window
    body: Body
    tiled: tuple[Tiled, ...]
    ringed: bool
    ring: Callable[[], Plain]
    step: float
    saddles: int = 0
    bevel_volume: float = 0.0
    cells: Ints | None = None
    counted: list[int] = field(default_factory=list, init=False, repr=False)

    @property
    def own(self) -> bool:
        """Whether triangles are counted one by one: in a non-uniform sheet, or in a part of a sheet."""
        return self.cells is not None or any(tiled.own is not None for tiled in self.tiled)

    def part(self, cells: Ints) -> BodyMesh:
        """The triangles of some kept cells (n, 2) and of the plain land, open towards missing cells.

        They suffice for light that reaches no other cells.
        """
        return replace(self, cells=cells)

    @cached_property
    def _errors(self) -> tuple[float, float]:
        """Slope and sag error of the worst of its prototiles; measured on first use."""
        found = [
            facet_errors(maker.tile, body)
            for tiled in self.tiled
            for maker, body in tiled.judged(self.window, self.body)
        ]
        return max(slope for slope, _ in found), max(sag for _, sag in found)

    @property
    def slope_error(self) -> float:
        """Rms angle between facet and exact normal over optical facets by area, worse face (radians)."""
        return self._errors[0]

    @property
    def sag_error(self) -> float:
        """Largest normal distance between facet and exact surface (length)."""
        return self._errors[1]

    def blocks(self, most: int = BLOCK) -> Iterator[CellBlock | OwnBlock]:
        """Cells grouped by row and template; in a non-uniform sheet in batches of about `most` triangles."""
        lattice = self.window.lattice
        for tiled in self.tiled:
            rows = (
                lattice.row(j) if self.cells is None else self.cells[self.cells[:, 1] == j]
                for j in range(lattice.count[1])
            )
            if tiled.own is not None:
                yield from own_blocks(tiled, rows, partial(_states, self, tiled), most)
                continue
            for row in rows:
                yield from _row_blocks(self, tiled, row)

    @cached_property
    def census(self) -> tuple[tuple[Template, Lattice, int], ...]:
        """Templates, their lattice and their number of occurrences, without expanding.

        Uniform sheets only.
        """
        cells, times = _distinct_cells(self.window.lattice)
        found: dict[int, tuple[Template, Lattice, int]] = {}
        for tiled in (one for one in self.tiled if one.own is None):
            states = _states(self, tiled, cells)
            code = states @ 3 ** np.arange(states.shape[1])  # one number a state: faster than rows
            _, first, which = np.unique(code, return_index=True, return_inverse=True)
            numbers = np.bincount(which, times)
            for kind, number in zip(states[first], numbers.astype(int).tolist(), strict=True):
                template = tiled.maker.template(kind)
                before = found.get(id(template), (template, tiled.lattice, 0))[2]
                found[id(template)] = template, tiled.lattice, before + number
        return tuple(found.values())

    @property
    def facet_count(self) -> int:
        """Exact number of triangles, without expanding.

        In a non-uniform sheet all of them are made once to count them.
        """
        if self.own:
            return _count(self)
        return sum(len(t.triangles) * number for t, _, number in self.census) + len(self.ring().triangles)

    @cached_property
    def facets_about(self) -> int:
        """Number of triangles; in a non-uniform sheet estimated from a sample of cells, without its land."""
        if self.cells is not None:
            return _count(self)
        total = sum(len(t.triangles) * number for t, _, number in self.census)
        rough = self.ringed and any(tiled.own is not None for tiled in self.tiled)
        known = ring_about(self.window, self.tiled) if rough else None
        total += len(self.ring().triangles) if known is None else known
        cells = representative_cells(self.window, "sample", JUDGED)
        own = (tiled for tiled in self.tiled if tiled.own is not None)
        blocks = (
            block for tiled in own for block in own_blocks(tiled, [cells], partial(_states, self, tiled))
        )
        return total + sum(len(block.facets) for block in blocks) * self.window.lattice.cell_count // len(
            cells
        )

    def rows(self) -> Iterator[Floats]:
        """Yield all triangles as (k, 3, 3) corner blocks of at most a row (lengths, sheet frame, outward).

        Memory is that of one block, for any number of cells; blocks come in a fixed order.
        """
        count = 0
        for corners in _corner_blocks(self):
            yield corners
            count += len(corners)
        self.counted[:] = [count]

    @cached_property
    def _expanded(self) -> tuple[Floats, Ints]:
        """Shared vertices and triangles of the whole body."""
        keys, positions, triangles, count = [], [], [], 0
        keyed = len(self.tiled) == 1  # points of two tilings have the same numbers but are never shared
        for block in self.blocks():
            positions.append(block.vertices(0, len(block.cells)).reshape(-1, 3))
            triangles.append(block.triangles(count))
            count += len(positions[-1])
            if keyed:
                keys.append(block.keys())
        positions.append(self.ring().vertices)
        triangles.append(self.ring().triangles + count)
        self.counted[:] = [sum(map(len, triangles))]
        place, corners = np.concatenate(positions), np.concatenate(triangles)
        positions.clear()
        triangles.clear()
        return (
            _weld(np.concatenate([*keys, self.ring().key]), place, corners)
            if keyed
            else _weld_positions(place, corners)
        )

    @property
    def vertices(self) -> Floats:
        """Shared vertices (n, 3), sheet frame (lengths). Expands the whole body."""
        return self._expanded[0]

    @property
    def triangles(self) -> Ints:
        """Vertex numbers (m, 3), outward, in the order of `rows`. Expands the whole body."""
        return self._expanded[1]

    def volume(self) -> float:
        """Volume by the divergence sum over the templates and the land (length³), compensated."""
        if self.own:
            return fsum(float(flux(corners).sum()) for corners in self.rows())
        parts = flux(self.ring().corners).tolist()
        for template, lattice, number in self.census:
            corners = template.local(lattice)[template.triangles]
            parts.append(number * fsum(flux(corners).tolist()))
        return fsum(parts)


def _row_blocks(mesh: BodyMesh, tiled: Tiled, row: Ints) -> Iterator[CellBlock]:
    if not len(row):
        return
    states = _states(mesh, tiled, row)
    kinds, which = np.unique(states, axis=0, return_inverse=True)
    for n, kind in enumerate(kinds):
        yield CellBlock(tiled.maker.template(kind), row[which.ravel() == n], tiled)


def _states(mesh: BodyMesh, tiled: Tiled, row: Ints) -> NDArray[np.uint8]:
    """States of the neighbours of some kept cells (n, 2) of a row; see `row_states`."""
    apart = tiled.shift if len(mesh.tiled) > 1 else (0.0, 0.0)
    return row_states(mesh.window, row, tiled.maker.offsets, mesh.ringed, tiled.lattice, apart)


def first_triangles(mesh: BodyMesh, most: int) -> Floats:
    """The first triangles (k, 3, 3) of `BodyMesh.rows`, at most `most`, without larger blocks than needed."""
    kept, count = [np.empty((0, 3, 3))], 0
    for corners in _corner_blocks(mesh, most):
        kept.append(corners[: most - count])
        count += len(kept[-1])
        if count >= most:
            break
    return np.concatenate(kept)


def _count(mesh: BodyMesh) -> int:
    """Number of triangles; counted by a complete pass over `rows`."""
    if not mesh.counted:
        for _ in mesh.rows():
            pass
    return mesh.counted[0]


def portions(mesh: BodyMesh, most: int = BLOCK) -> Iterator[tuple[CellBlock | OwnBlock, int, int]]:
    """Blocks of `rows`, cut to a bounded number of triangles: (block, first cell, last cell + 1)."""
    for block in mesh.blocks(most):
        if not isinstance(block, CellBlock):
            yield block, 0, len(block.cells)
            continue
        each = max(1, _CHUNK // len(block.template.triangles))
        for first in range(0, len(block.cells), each):
            yield block, first, min(first + each, len(block.cells))


def _corner_blocks(mesh: BodyMesh, most: int = BLOCK) -> Iterator[Floats]:
    """Yield the blocks of `BodyMesh.rows`."""
    for block, first, last in portions(mesh, most):
        yield block.corners(first, last)
    if len(mesh.ring().triangles):
        yield mesh.ring().corners


def facet_tags(mesh: BodyMesh) -> Iterator[tuple[NDArray[np.uint8], Ints]]:
    """Yield (kind (k,), cell (k, 2)) of the triangles of each block of `rows`; plain land has cell −2³¹.

    Kinds are FRONT, FRONT_LAND, BACK, BACK_LAND and WALL of `clacad.mesh.cell_template`; optical are FRONT
    and BACK, of the body's front and back face.
    """
    for block, first, last in portions(mesh):
        yield block.tags(first, last)
    if len(mesh.ring().triangles):
        yield mesh.ring().kind, np.full((len(mesh.ring().triangles), 2), -(2**31), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Watertight meshes of a window's bodies, expanded only on request.

    Attributes
    ----------
    window : Window
    bodies : tuple of BodyMesh
    quads : int
        Grid steps along each side of a cell.
    """

    window: Window
    bodies: tuple[BodyMesh, ...]
    quads: int

    def __repr__(self) -> str:
        return f"Mesh({self.window.name!r}, {self.quads} quads a cell side, {self.facet_count} facets)"

    def part(self, cells: Ints) -> Mesh:
        """The triangles of some kept cells (n, 2) and of the plain land; see `BodyMesh.part`."""
        return replace(self, bodies=tuple(body.part(cells) for body in self.bodies))

    @property
    def slope_error(self) -> float:
        """Rms angle between facet and exact normal over optical facets, worst face (radians)."""
        return max(body.slope_error for body in self.bodies)

    @property
    def sag_error(self) -> float:
        """Largest normal distance between facets and exact surfaces (length)."""
        return max(body.sag_error for body in self.bodies)

    @property
    def facet_count(self) -> int:
        """Number of triangles of all bodies, exactly, without expanding them."""
        return sum(body.facet_count for body in self.bodies)

    @cached_property
    def _expanded(self) -> tuple[Floats, Ints]:
        """Vertices and triangles of all bodies."""
        vertices = [body.vertices for body in self.bodies]
        starts = np.cumsum([0, *(len(v) for v in vertices)])[:-1]
        triangles = [body.triangles + start for body, start in zip(self.bodies, starts)]
        return np.concatenate(vertices), np.concatenate(triangles)

    @property
    def triangles(self) -> Ints:
        """Vertex numbers (m, 3) of all bodies, outward. Expands everything."""
        return self._expanded[1]

    @property
    def vertices(self) -> Floats:
        """Vertices (n, 3) of all bodies, sheet frame (lengths). Expands everything."""
        return self._expanded[0]


def to_trimesh(mesh: Mesh | BodyMesh) -> Trimesh:
    """Convert a mesh, or that of one body, to a `trimesh.Trimesh`, which expands it.

    Parameters
    ----------
    mesh : Mesh or BodyMesh
        For example from `clacad.tessellate`; a closed mesh becomes one that is `is_watertight`.

    Returns
    -------
    trimesh.Trimesh
        Copies of the vertices (n, 3) and triangles (m, 3), not merged and in their order, sheet frame.
        Coordinates are in the unit of the design, which `units` states: `convert_units("mm")` scales them.

    Raises
    ------
    MemoryError
        The expanded mesh does not fit the memory; `Mesh.part` selects some of its cells.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> window = clacad.prescribe(design)
    >>> clacad.to_trimesh(clacad.tessellate(window, quads=4)).is_watertight
    True
    """
    from trimesh import Trimesh

    metres = mesh.window.unit
    made = Trimesh(mesh.vertices.copy(), mesh.triangles.copy(), process=False)
    made.units = _NAMED_UNITS.get(metres) or f"{metres!r} * meters"
    return made


_NAMED_UNITS = {1e-6: "microns", 1e-3: "mm", 1e-2: "cm", 1.0: "m", 0.0254: "inches"}
"""Metres → word of trimesh for the unit."""


def _distinct_cells(lattice: Lattice) -> tuple[Ints, Ints]:
    """Kept cells (n, 2) and how often each counts, (n,): inner rows of a full lattice repeat in pairs."""
    (n1, n2), inner = lattice.count, max(0, lattice.count[1] - 4)
    if lattice.outline is not None or inner < 3:
        cells = lattice.cells()
        return cells, np.ones(len(cells), dtype=np.int64)
    rows = [(0, 1), (1, 1), (2, inner - inner // 2), (3, inner // 2), (n2 - 2, 1), (n2 - 1, 1)]
    return np.concatenate([lattice.row(j) for j, _ in rows]), np.repeat([times for _, times in rows], n1)


def _weld(key: Ints, position: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """Merge vertices with equal keys."""
    packed = number_rows(key)
    first = np.zeros(int(packed.max()) + 1, dtype=np.int64)
    first[packed[::-1]] = np.arange(len(packed))[::-1]
    return position[first], packed[triangles]


def _weld_positions(position: Floats, triangles: Ints) -> tuple[Floats, Ints]:
    """Merge vertices with equal positions."""
    order = np.lexsort(position.T)
    new = np.ones(len(order), dtype=bool)
    new[1:] = (np.diff(position[order], axis=0) != 0.0).any(axis=1)
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.cumsum(new) - 1
    return position[order[new]], number[triangles]


def no_plain() -> Plain:
    """No land ring."""
    return Plain(
        np.empty((0, 3)),
        np.empty((0, 4), dtype=np.int64),
        np.empty((0, 3), dtype=np.int64),
        np.empty(0, dtype=np.uint8),
    )
