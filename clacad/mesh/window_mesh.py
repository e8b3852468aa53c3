"""The mesh of a window."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.mesh.body_mesh import BodyMesh
from clacad.sheet.window import Window


@dataclass(frozen=True, eq=False)
class Mesh:
    """Watertight meshes of a window's bodies, expanded only when asked.

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
        vertices = [body.vertices for body in self.bodies]
        starts = np.cumsum([0, *(len(v) for v in vertices)])[:-1]
        triangles = [body.triangles + start for body, start in zip(self.bodies, starts)]
        return np.concatenate(vertices), np.concatenate(triangles)

    @property
    def vertices(self) -> Floats:
        """Vertices (n, 3) of all bodies, sheet frame (lengths). Expands everything."""
        return self._expanded[0]

    @property
    def triangles(self) -> Ints:
        """Vertex numbers (m, 3) of all bodies, outward. Expands everything."""
        return self._expanded[1]
