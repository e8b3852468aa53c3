"""Rays against the faces of a file of solids as OCC reads them.

Nothing of the window's formulas is used: OCC finds the hits on its own trimmed faces and gives the tangents
there; only Snell's law is clacad's. Solids that touch are one piece to the light: rays that leave one and
enter the next at the same point are not refracted. Lengths in mm. Run it in a worker: OCC can crash.

Record of rays on their way through the faces of a file, for any search of the faces. Lengths in mm.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.optics.surface import refract

ENDS = ("through", "nothing met", "wall", "total reflection")
"""Endings of a ray."""


@dataclass(frozen=True, eq=False)
class RayPaths:
    """Positions of rays, and where they crossed faces; the arrays are filled in as the rays advance.

    position, direction : (n, 3)
        Of the last crossing; unit directions behind it.
    end : (n,) index into `ENDS`
    crossings : (n,)
        Faces crossed so far.
    hits : (n, steps, 3)
        Where each ray crossed, zero beyond its last crossing.
    """

    position: Floats
    direction: Floats
    end: Ints
    crossings: Ints
    hits: Floats

    @staticmethod
    def begun(position: Any, direction: Any, steps: int) -> RayPaths:
        """Rays (n, 3) before their first of `steps` crossings."""
        place, way = np.array(position, dtype=np.float64), np.array(direction, dtype=np.float64)
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        many = len(place)
        return RayPaths(
            place, way, np.zeros(many, dtype=int), np.zeros(many, dtype=int), np.zeros((many, steps, 3))
        )

    def to_lists(self, curved: Bools) -> dict[str, Any]:
        """As JSON lists, with whether each face crossed is curved both ways (n, steps)."""
        return {
            "position": self.position.tolist(),
            "direction": self.direction.tolist(),
            "end": self.end.tolist(),
            "crossings": self.crossings.tolist(),
            "hits": self.hits.tolist(),
            "curved": curved.tolist(),
        }


def media_of(indices: Sequence[float]) -> list[float]:
    """Refractive indices along the light, air first and last, from those of the bodies it meets."""
    return [1.0, *(one for index in indices for one in (index, 1.0))]


NEAREST = 1e-6
"""Hits nearer than this (mm) are on the face just left."""
TOUCH = 2e-6
"""Faces within this distance (mm) of one another are met at once."""
GRAZING = 1e-6
"""A face whose unit normal has no larger z is a wall."""


def cast_rays(
    path: str | os.PathLike[str],
    position: Sequence[Sequence[float]],
    direction: Sequence[Sequence[float]],
    indices: Sequence[float],
) -> list[list[float] | None]:
    """Trace rays through the solids of a STEP file.

    Parameters
    ----------
    path : path
    position : (n, 3) mm
    direction : (n, 3)
    indices : sequence of float
        Refractive index of the bodies in the order light meets them.

    Returns
    -------
    list of (3,) unit directions, or None for a ray that did not enter and leave every body through faces that
    are no walls.

    Raises
    ------
    UnreadableFile
        OCC finds no shape in the file.
    """
    found = follow_rays(path, position, direction, indices, (-np.inf, -np.inf), (np.inf, np.inf))
    return [way if end == 0 else None for way, end in zip(found["direction"], found["end"], strict=True)]


def follow_rays(
    path: str | os.PathLike[str],
    position: Any,
    direction: Any,
    indices: Sequence[float],
    low: Sequence[float],
    high: Sequence[float],
) -> dict[str, Any]:
    """Trace rays through the faces of a file that reach into a column, and report where they crossed.

    Parameters
    ----------
    path, position, direction, indices
        As for `cast_rays`.
    low, high : (2,) mm
        Column of x and y; faces that do not reach into it are left out.

    Returns
    -------
    dict of lists
        position, direction : (n, 3) of the last crossing; end : (n,) index into `ENDS`; crossings : (n,);
        hits : (n, 2 bodies, 3) where each ray crossed, zero beyond its last crossing; curved : (n, 2 bodies)
            whether the face crossed there is curved both ways.

    Raises
    ------
    UnreadableFile
        OCC cannot read the file.
    """
    intersector = _column(path, tuple(low), tuple(high))
    media, many = media_of(indices), len(position)
    paths = RayPaths.begun(position, direction, len(media) - 1)
    curved = np.zeros((many, len(media) - 1), dtype=bool)
    if intersector is None:
        paths.end[:] = 1
        return paths.to_lists(curved)
    for k in range(many):
        ray = _Ray(intersector, paths.position[k], paths.direction[k])
        paths.end[k] = ray.follow(media)
        found = len(ray.hits)
        paths.crossings[k] = found
        paths.hits[k, :found], curved[k, :found] = np.array(ray.hits).reshape(-1, 3), ray.curved
        paths.position[k], paths.direction[k] = ray.position, ray.direction
    return paths.to_lists(curved)


_COLUMNS: dict[tuple[Any, ...], Any] = {}


def _column(path: str | os.PathLike[str], low: tuple[float, ...], high: tuple[float, ...]) -> Any:
    """Intersector of the faces that reach into a column; kept for the next call.

    None where there is no face.
    """
    from OCP.BRep import BRep_Builder
    from OCP.IntCurvesFace import IntCurvesFace_ShapeIntersector
    from OCP.TopoDS import TopoDS_Compound

    from clacad.formats.step.read_back import loaded
    from clacad.formats.step.shape_parts import boxes_of, moved, reaching

    state = os.stat(path)
    key = (os.fspath(path), state.st_size, state.st_mtime_ns, low, high)
    if key not in _COLUMNS:
        builder, chosen, found = BRep_Builder(), TopoDS_Compound(), 0
        builder.MakeCompound(chosen)
        for piece in loaded(path).pieces:
            for placement, face in reaching(piece, boxes_of(piece.faces), np.array(low), np.array(high)):
                builder.Add(chosen, moved(face, placement))
                found += 1
        intersector = IntCurvesFace_ShapeIntersector() if found else None
        if intersector is not None:
            intersector.Load(chosen, 1e-10)
        _COLUMNS.clear()
        _COLUMNS[key] = intersector
    return _COLUMNS[key]


class _Ray:
    """One ray on its way through the faces."""

    def __init__(self, intersector: Any, position: Floats, direction: Floats) -> None:
        self._intersector = intersector
        self.position, self.direction = position, direction
        self.hits: list[Floats] = []
        self.curved: list[bool] = []
        self._inside = 0

    def follow(self, media: Sequence[float]) -> int:
        """Trace through all media; return the ending, an index into `ENDS`."""
        for before, after in zip(media[:-1], media[1:], strict=True):
            met = self._next_border()
            if met is None:
                return 1
            place, normal, curved = met
            if abs(normal[2]) < GRAZING:
                return 2
            normal = normal if normal @ self.direction > 0.0 else -normal
            bent, _ = refract(
                self.direction[None], normal[None], np.array([normal @ self.direction]), before, after
            )
            self.position = place
            self.hits.append(place)
            self.curved.append(curved)
            if not np.isfinite(bent).all():
                return 3
            self.direction = bent[0]
        return 0

    def _next_border(self) -> tuple[Floats, Floats, bool] | None:
        """Next point where light enters or leaves material, the unit normal there, and whether the face is
        curved.
        """
        for together in self._groups():
            distance, normal, curved, way = together[0]
            net = sum(one[3] for one in together)
            was, self._inside = self._inside, self._inside + net
            if (was > 0) != (self._inside > 0):
                for one in together:  # of faces met at once, the one that agrees with the light's direction
                    if one[3] * net > 0:
                        distance, normal, curved, way = one
                        break
                return self.position + distance * self.direction, normal, curved
        return None

    def _groups(self) -> Iterator[list[tuple[float, Floats, bool, int]]]:
        """Hits ahead, nearest first, grouped by position."""
        from OCP.gp import gp_Dir, gp_Lin, gp_Pnt

        found = self._intersector
        found.Perform(gp_Lin(gp_Pnt(*self.position), gp_Dir(*self.direction)), NEAREST, 1e6)
        if not found.IsDone():
            return
        order = sorted((found.WParameter(k), k) for k in range(1, found.NbPnt() + 1))
        group: list[tuple[float, Floats, bool, int]] = []
        for distance, number in order:
            if group and distance - group[-1][0] > TOUCH:
                yield group
                group = []
            group.append(self._met(distance, number))
        if group:
            yield group

    def _met(self, distance: float, number: int) -> tuple[float, Floats, bool, int]:
        """Distance, outward unit normal, whether the face is curved, and +1 on entry, −1 on exit."""
        from OCP.BRepAdaptor import BRepAdaptor_Surface
        from OCP.GeomAbs import GeomAbs_Cone, GeomAbs_Cylinder, GeomAbs_Plane, GeomAbs_SurfaceOfExtrusion
        from OCP.gp import gp_Pnt, gp_Vec
        from OCP.TopAbs import TopAbs_REVERSED

        face = self._intersector.Face(number)
        surface = BRepAdaptor_Surface(face, False)
        point, du, dv = gp_Pnt(), gp_Vec(), gp_Vec()
        surface.D1(self._intersector.UParameter(number), self._intersector.VParameter(number), point, du, dv)
        across = du.Crossed(dv)
        normal = np.array([across.X(), across.Y(), across.Z()])
        normal *= (-1.0 if face.Orientation() == TopAbs_REVERSED else 1.0) / np.linalg.norm(normal)
        flat = (GeomAbs_Plane, GeomAbs_Cylinder, GeomAbs_Cone, GeomAbs_SurfaceOfExtrusion)
        return distance, normal, surface.GetType() not in flat, -1 if normal @ self.direction > 0.0 else 1
