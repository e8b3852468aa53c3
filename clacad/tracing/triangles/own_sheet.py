"""Rung "mesh" of a sheet whose cells differ: its triangles as they lie, whoever's they are, and cells told afterwards.

The trees that find triangles know no cells; the kernels above them count cells of one pitch. So light goes through the triangles as
through those of a sheet of equal cells without an end, and every ray's cells are read off the places where it met the arrays.
"""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clacad.optics.rays import NO_CELL, Fate, Rays, TraceResult
from clacad.sheet.cell_places import CellPlacement
from clacad.sheet.window import Window
from clacad.storage.errors import LimitRefused
from clacad.tracing.triangles.ready_facets import Facets, facets_of
from clacad.tracing.triangles.triangle_soup import TriangleSoup, read_soup

if TYPE_CHECKING:
    from clacad.mesh import Mesh
    from clacad.tracing.triangles.ready_facets import AnyMesh
    from clacad.tracing.triangles.tiles import Normals

MOST_FACETS = 4_000_000
"""Triangles of a sheet that are held for tracing, none of them a copy of another."""


def own_facets(window: Window, mesh: AnyMesh | int | Facets, normals: Normals) -> Facets:
    """Triangles of a sheet whose cells differ, ready for rays; those of its own mesh are kept with the window.

    Raises
    ------
    LimitRefused
        More triangles than are held.
    """
    if isinstance(mesh, Facets):
        return mesh
    if isinstance(mesh, (str, os.PathLike)):
        return facets_of(endless(window), read_soup(mesh, window), normals)
    if isinstance(mesh, TriangleSoup):
        return facets_of(endless(window), mesh, normals)
    key = (mesh if isinstance(mesh, int) else id(mesh), normals)
    kept: dict[object, Facets] = window.kept.setdefault("own facets", {})
    if key not in kept:
        from clacad.mesh import tessellate

        whole = tessellate(window, quads=mesh) if isinstance(mesh, int) else mesh
        kept.clear()
        kept[key] = facets_of(endless(window), _soup(whole, normals), normals)
    return kept[key]


def endless(window: Window) -> Window:
    """A sheet of equal cells without an end that stands for one whose cells differ wherever only triangles are asked."""
    n1, n2 = window.lattice.count
    bodies = tuple(
        replace(body, front=replace(body.front, change=None), back=replace(body.back, change=None))
        for body in window.bodies
    )
    return replace(
        window,
        bodies=bodies,
        placements=tuple(CellPlacement(place.shift) for place in window.placements),
        lattice=replace(window.lattice, count=(4 * n1 + 8, 4 * n2 + 8), outline=None),
        outline=None,
        thin=replace(window.thin, pitch=None, turn=0.0, change=None),
        cell_laws=None,
    )


def told(window: Window, rays: Rays, result: TraceResult, record: bool) -> TraceResult:
    """The same light with the cells of the sheet itself; `result` was recorded through the triangles of `endless`.

    What was never in glass missed the sheet: one without an end calls it land.
    """
    arrays = [face.array for face in window.faces]
    first, last = arrays.index(0), len(arrays) - 1 - arrays[::-1].index(1)
    assert result.hits is not None
    one = window.locate(0, *result.hits[first, :, :2].T)[0]
    two = window.locate(1, *result.hits[last, :, :2].T)[0]
    met_one, met_two = result.cell[:, :1] != NO_CELL, result.order[:, :1] != NO_CELL
    met_one &= window.lattice.contains(one)[:, None]
    way = result.position - rays.position
    dry = result.optical_path <= np.linalg.norm(way, axis=1) * (1.0 + 1e-12)
    missed = (result.fate == Fate.LAND) & dry
    met_one &= ~missed[:, None]
    cell = np.where(met_one, one, NO_CELL).astype(np.int32)
    order = np.where(met_one & met_two, two - one, NO_CELL).astype(np.int32)
    through = (result.fate == Fate.ALIVE) | (result.fate == Fate.GHOST)
    apart = (order != 0).any(axis=1)
    fate = np.where(through, np.where(apart, Fate.GHOST, Fate.ALIVE), result.fate).astype(np.uint8)
    fate[missed] = Fate.MISSED
    position = np.where(missed[:, None], rays.position, result.position)
    surface = np.where(missed, NO_CELL, result.surface).astype(np.int32)
    path = np.where(missed, 0.0, result.optical_path)
    return replace(
        result,
        cell=cell,
        order=order,
        fate=fate,
        position=position,
        surface=surface,
        optical_path=path,
        hits=result.hits if record else None,
        directions=result.directions if record else None,
    )


def _soup(mesh: Mesh, normals: Normals) -> TriangleSoup:
    count = sum(body.facets_about for body in mesh.bodies)
    if count > MOST_FACETS:
        raise LimitRefused(
            f'rung "mesh": about {count:,} triangles of cells that differ are more than the {MOST_FACETS:,} that are held; '
            "use fewer quads or fewer cells"
        )
    corners = np.concatenate([rows for body in mesh.bodies for rows in body.rows()])
    if normals != "vertex":
        return TriangleSoup(corners)
    from clacad.mesh import corner_normals

    return TriangleSoup(corners, np.concatenate([n for body in mesh.bodies for n in corner_normals(body)]))
