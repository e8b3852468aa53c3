"""Exact normals at facet corners, and one closed cell for formats that repeat cells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.base.vectors import doubled_normals
from clacad.mesh.body_mesh import BodyMesh
from clacad.mesh.cell_template import BACK, FRONT, Template
from clacad.sheet.lattice import Lattice
from clacad.sheet.window import Body, Window, lens_height_and_normal


@dataclass(frozen=True, eq=False)
class CellSolid:
    """One closed column of a body, in the cell frame, for instanced formats.

    vertices : (v, 3) lengths
    triangles : (t, 3), outward
    kind : (t,) uint8
        FRONT, FRONT_LAND, BACK, BACK_LAND or WALL of `clacad.mesh.cell_template`.
    normals : (t, 3, 3)
        Outward unit normals at the corners: exact on optical facets, the facet's own elsewhere.
    """

    vertices: Floats
    triangles: Ints
    kind: NDArray[np.uint8]
    normals: Floats


def cell_solid(window: Window, body: Body, quads: int) -> CellSolid:
    """Mesh one telescopelet's column of a body as a separate closed solid, centred on its cell.

    Raises
    ------
    ValueError
        The body's faces repeat on displaced arrays: no cell of it is a column.
    """
    from clacad.mesh.tessellation import mesh_body

    alone = window.with_cells((1, 1))
    mesh = mesh_body(alone, body, quads)
    if len(mesh.tiled) > 1:
        raise ValueError(f"body {body.name!r} has displaced faces: none of its cells is a solid of its own")
    maker = mesh.tiled[0].maker
    template = maker.template(np.zeros(len(maker.offsets), dtype=np.uint8))
    vertices = np.concatenate([local_xy(window.lattice, template), template.z[:, None]], axis=1)
    normals = template_normals(window.lattice, body, template)
    return CellSolid(vertices, template.triangles, template.kind, normals)


def local_xy(lattice: Lattice, template: Template) -> Floats:
    """A template's vertices in its own cell's frame, (v, 2) lengths."""
    origin = lattice.centres(np.zeros(2, dtype=np.int64))
    return np.asarray(template.xy + (lattice.centres(template.owner) - origin))


def template_normals(lattice: Lattice, body: Body, template: Template) -> Floats:
    """Outward unit normals at the corners of a template's triangles, (t, 3, 3)."""
    corners = np.concatenate([local_xy(lattice, template), template.z[:, None]], axis=1)[template.triangles]
    normals = _facet_normals(corners)
    for kind, face, outward in ((FRONT, body.front, -1.0), (BACK, body.back, 1.0)):
        mine = np.flatnonzero(template.kind == kind)
        if face.array is None or not len(mine):
            continue
        at = corners[mine].reshape(-1, 3)
        _, exact = lens_height_and_normal(face, at[:, 0], at[:, 1])
        exact = outward * exact.reshape(-1, 3, 3)
        normals[mine] = np.where(np.isnan(exact), normals[mine], exact)
    return normals


def corner_normals(mesh: BodyMesh) -> Iterator[Floats]:
    """Yield the outward corner normals (k, 3, 3) of each block of `mesh.rows()`, in the same order."""
    known: dict[int, Floats] = {}
    for block, cells in mesh.parts():
        template, own = block.template, block.tiled.own
        if own is not None:
            i, j = block.cells[0].tolist()
            yield template_normals(block.tiled.lattice, own.body_at((i, j)), template)
            continue
        if id(template) not in known:
            known[id(template)] = template_normals(block.tiled.lattice, mesh.body, template)
        yield np.tile(known[id(template)], (cells, 1, 1))
    if len(mesh.plain.triangles):
        yield _facet_normals(mesh.plain.corners)


def _facet_normals(corners: Floats) -> Floats:
    """Unit normals (k, 3, 3) of facets, one for each corner; (0, 0, 1) for a facet without area."""
    normal = doubled_normals(corners)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 0.0, normal / np.where(length > 0.0, length, 1.0), [0.0, 0.0, 1.0])
    return np.repeat(normal[:, None, :], 3, axis=1)
