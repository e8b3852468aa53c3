"""Meshes as the formats write them: streams of facets, or welded pieces with exact normals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.arrays import same_rows
from clacad.base.types import Floats
from clacad.formats.mesh.compare_triangles import Promise
from clacad.formats.placements import Block, Piece, Places
from clacad.sheet.cell_places import CellPlacement
from clacad.sheet.need_window import need_equal_cells
from clacad.sheet.window import Body, Window

if TYPE_CHECKING:
    from clacad.mesh import Mesh
    from clacad.mesh.body_mesh import BodyMesh


MERGE_STEPS = 5.0
"""Largest distance of a vertex from its surface, in levels: 0.5 by rounding, the rest by merging at
borders."""


@dataclass(frozen=True, eq=False)
class Tessellation:
    """A window, its mesh, and the mesh of one cell, which is sufficient for a uniform sheet.

    quads : Facet grid a cell side.
    saddle_bevel : length. Width of the bevels at saddles; 0: columns that touch keep vertices of their own.
    """

    window: Window
    quads: int
    saddle_bevel: float = 0.0

    @cached_property
    def mesh(self) -> Mesh:
        """Mesh of the whole sheet (its facets come as a stream)."""
        return self._of(self.window)

    @cached_property
    def cell(self) -> Mesh:
        """Mesh of one cell alone, which instanced formats repeat."""
        return self._of(one_cell(self.window))

    @cached_property
    def single(self) -> Mesh:
        """Mesh of a sheet of one cell, border and outline included, where cells are not repeated."""
        need_equal_cells(self.window, "the mesh of one cell for all")
        return self._of(self.window.with_cells((1, 1)))

    def _of(self, window: Window) -> Mesh:
        from clacad.mesh import tessellate

        return tessellate(window, quads=self.quads, saddle_bevel=self.saddle_bevel)

    def promise(self, instanced: bool, single: bool, bodies: Sequence[str] | None = None) -> Promise:
        """Expected properties of a file of this mesh, or of some of its bodies."""
        mesh = self.cell if instanced else self.mesh
        times = self.window.lattice.cell_count if instanced else 1
        chosen = [
            part
            for body, part in zip(self.window.bodies, mesh.bodies, strict=True)
            if bodies is None or body.name in bodies
        ]
        facets = sum(part.facet_count for part in chosen)
        return Promise(
            facets=facets * times,
            sag_error=float(mesh.sag_error),
            merge=MERGE_STEPS * max(part.step for part in mesh.bodies),
            single=single,
            bevel=self.saddle_bevel if any(part.bevel_volume for part in chosen) else 0.0,
            added=times * sum(part.bevel_volume for part in chosen),
        )

    def pieces(self, instanced: bool, normals: bool) -> list[Piece]:
        """Meshes of shared vertices, one a body.

        With normals a vertex at a sharp edge is split, one for each normal; without, the vertices are the
        mesher's own, every edge has its two facets, and columns that only touch keep vertices of their own.
        """
        mesh = self.cell if instanced else self.mesh
        window = one_cell(self.window) if instanced else self.window
        return [
            Piece(
                body.name,
                partial(shared_blocks, part, normals) if normals or part.own else partial(_listed, part),
                part.facets_about,
                self._places(body) if instanced else None,
                body.index,
            )
            for body, part in zip(window.bodies, mesh.bodies, strict=True)
        ]

    def _places(self, body: Body) -> Places:
        return Places(self.window.lattice, self.window.shifts[body.arrays[0]])


class Meshes:
    """Tessellations of one window, each made once on request; `fused`: no format repeats a cell."""

    def __init__(self, window: Window, saddle_bevel: float = 0.0, fused: bool = False) -> None:
        self.window, self._bevel, self._fused = window, saddle_bevel, fused
        self._made: dict[int, Tessellation] = {}

    def at(self, quads: int) -> Tessellation:
        """Tessellation with `quads` quads per cell side."""
        return self._made.setdefault(quads, Tessellation(self.window, quads, self._bevel))

    def facets(self, quads: int) -> int:
        """Facets of the whole sheet: exact, or estimated from a sample of a non-uniform sheet."""
        return sum(body.facets_about for body in self.at(quads).mesh.bodies)

    @property
    def repeatable(self) -> bool:
        """Whether formats that repeat cells store one cell and its places."""
        return not self._fused and instanceable(self.window)


def instanceable(window: Window) -> bool:
    """Whether the sheet consists of copies of one cell and nothing else.

    False with land between the cells and an outline. False for a body whose two arrays are displaced relative
    to each other: there one cell of one face is opposite parts of several cells of the other.
    """
    in_columns = all(len({window.shifts[array] for array in body.arrays}) == 1 for body in window.bodies)
    return window.uniform and window.outline is None and in_columns


def one_cell(window: Window) -> Window:
    """Reduce a window to a single cell at the origin of its own array's frame."""
    return replace(
        window.with_cells((1, 1)),
        placements=(CellPlacement(),) * len(window.placements),
        outline=None,
        land=replace(window.land, border=0.0),
    )


def _listed(part: BodyMesh) -> Iterator[Block]:
    """The vertices of a mesh as it numbers them."""
    yield Block(part.vertices, None, part.triangles)


def weld(body: Body, corners: Floats, normals: Floats | None = None) -> Piece:
    """Weld facets (n, 3, 3) whose corners, and normals if given, agree bit by bit into a piece."""
    both = (corners if normals is None else np.concatenate([corners, normals], axis=2)) + 0.0
    both = both.reshape(-1, both.shape[2])
    first, number = same_rows(both.view(np.uint64))
    smooth = None if normals is None else both[first, 3:]
    return Piece.of(body.name, both[first, :3], number.reshape(-1, 3), smooth, index=body.index)


def shared_blocks(mesh: BodyMesh, shaded: bool) -> Iterator[Block]:
    """The triangles of a body with shared vertices, numbered in the order they come; `shaded`: with normals.

    A vertex is shared by cells of rows next to each other, or with the land and the wall around all cells:
    only the vertices of the last rows are kept, and those of the land.
    """
    from clacad.formats.mesh.measure import Welder
    from clacad.mesh.tessellation import plain_normals, shaded_portions

    ring = [mesh.ring().corners, *([plain_normals(mesh)] if shaded else [])]
    weld, begun = Welder(np.concatenate(ring, axis=2).reshape(-1, 3 * len(ring))), 0
    for row, corners, normals, places in shaded_portions(mesh, shaded):
        if row > begun + 1:
            weld.begin()
        begun = row if row > begun + 1 or row < begun else begun
        place, smooth = corners.reshape(-1, 3), None if normals is None else normals.reshape(-1, 3)
        number, first = weld.numbers(place, smooth, places())
        new = None if smooth is None else smooth[first] + 0.0
        yield Block(place[first] + 0.0, new, number.reshape(-1, 3))
