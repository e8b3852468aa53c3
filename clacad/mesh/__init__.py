"""Watertight meshes of a sheet: triangles of one repeated cell, or of each cell; expanded only on request."""

from __future__ import annotations

from clacad.mesh.body_mesh import BodyMesh, Mesh, to_trimesh
from clacad.mesh.health import Health, check_closed
from clacad.mesh.tessellation import (
    forecast_quads,
    mesh_body,
    slope_error_at,
    tessellate,
)

__all__ = [
    "BodyMesh",
    "Health",
    "Mesh",
    "check_closed",
    "forecast_quads",
    "mesh_body",
    "slope_error_at",
    "tessellate",
    "to_trimesh",
]
