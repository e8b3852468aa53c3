"""Rays against the faces of a STEP file as the CAD kernel reads them: slow, independent, a spot check.

Nothing of the window's formulas is used: the kernel finds the hit on its own B-spline faces and gives the
tangents there; only Snell's law is ours.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.surface import refract

Floats = NDArray[np.float64]
NEAREST = 1e-6
"""Hits nearer than this (mm) are the face just left."""
WALL = 1e-6
"""A face whose unit normal has no larger z is a wall."""


def cast_rays(
    path: str | os.PathLike[str], position: Sequence[Sequence[float]], direction: Sequence[Sequence[float]],
    indices: Sequence[float],
) -> list[list[float] | None]:  # fmt: skip
    """Trace rays through the solids of a STEP file. Run it in a worker: the kernel can crash.

    Parameters
    ----------
    path : path
    position : (n, 3) mm
    direction : (n, 3)
    indices : sequence of float
        Refractive index of the bodies in the order light meets them.

    Returns
    -------
    list of (3,) unit directions, or None for a ray that did not go in and out of every body through faces
    that are no walls.

    Raises
    ------
    UnreadableFile
        The kernel finds no shape in the file.
    """
    from OCP.IntCurvesFace import IntCurvesFace_ShapeIntersector

    intersector = IntCurvesFace_ShapeIntersector()
    intersector.Load(_shape(path), 1e-10)
    media = [1.0]
    for index in indices:
        media += [index, 1.0]
    out: list[list[float] | None] = []
    for start, ray in zip(position, direction, strict=True):
        left = _through(intersector, np.array(start), np.array(ray) / np.linalg.norm(ray), media)
        out.append(None if left is None else [float(v) for v in left])
    return out


def _shape(path: str | os.PathLike[str]) -> Any:
    from OCP.STEPControl import STEPControl_Reader

    reader = STEPControl_Reader()
    reader.ReadFile(os.fspath(path))
    reader.TransferRoots()
    return reader.OneShape()


def _through(intersector: Any, position: Floats, ray: Floats, media: Sequence[float]) -> Floats | None:
    for before, after in zip(media[:-1], media[1:], strict=True):
        met = _next_face(intersector, position, ray)
        if met is None:
            return None
        position, normal = met
        if abs(normal[2]) < WALL:
            return None
        normal = normal if normal @ ray > 0.0 else -normal
        bent, _ = refract(ray[None], normal[None], np.array([normal @ ray]), before, after)
        ray = bent[0]
        if not np.isfinite(ray).all():
            return None
    return ray


def _next_face(intersector: Any, position: Floats, ray: Floats) -> tuple[Floats, Floats] | None:
    """Nearest hit ahead and the unit normal there."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.gp import gp_Dir, gp_Lin, gp_Pnt, gp_Vec

    intersector.Perform(gp_Lin(gp_Pnt(*position), gp_Dir(*ray)), NEAREST, 1e6)
    if not intersector.IsDone() or intersector.NbPnt() == 0:
        return None
    nearest = min(range(1, intersector.NbPnt() + 1), key=intersector.WParameter)
    surface = BRepAdaptor_Surface(intersector.Face(nearest))
    point, du, dv = gp_Pnt(), gp_Vec(), gp_Vec()
    surface.D1(intersector.UParameter(nearest), intersector.VParameter(nearest), point, du, dv)
    across = np.cross([du.X(), du.Y(), du.Z()], [dv.X(), dv.Y(), dv.Z()])
    return position + intersector.WParameter(nearest) * ray, across / np.linalg.norm(across)
