"""Watertight meshes of a sheet: triangles of one repeated cell, or of each cell; expanded only on request."""

from __future__ import annotations

from clacad.mesh.body_mesh import BodyMesh, Mesh, mesh_volume, to_trimesh
from clacad.mesh.health import Health, check_closed
from clacad.mesh.tessellation import (
    CellSolid,
    cell_solid,
    corner_normals,
    count_facets,
    forecast_bytes,
    forecast_quads,
    mesh_body,
    slope_error_at,
    tessellate,
)

__all__ = [
    "BodyMesh",
    "CellSolid",
    "Health",
    "Mesh",
    "cell_solid",
    "check_closed",
    "corner_normals",
    "count_facets",
    "forecast_bytes",
    "forecast_quads",
    "mesh_body",
    "mesh_volume",
    "slope_error_at",
    "tessellate",
    "to_trimesh",
]
