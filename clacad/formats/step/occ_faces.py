"""Classification of the faces of OCC's shapes: lenses and their positions, round holes, letters in a border.
mm.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.formats.placements import applied
from clacad.formats.step.lens_placements import LensPoints, on_lenses
from clacad.formats.step.shape_parts import ShapePart, boxes_of, moved
from clacad.sheet.window import WALL, Window

_GOLDEN = 0.6180339887498949


def engraved_in(several: list[ShapePart], window: Window) -> float:
    """Volume (mm³) of letters engraved in the borders: area of their floors times depth."""
    from clacad.solid.marks import pockets
    from clacad.solid.occ_writer import surface_area

    scale = millimetres(window.unit)
    room = pockets(window)
    if not room:
        return 0.0
    # letters are in borders, of which there is one; a repeated cell has none
    alone = [piece for piece in several if len(piece.placements) == 1]
    faces = [moved(face, piece.placements.one(0)) for piece in alone for face in piece.faces]
    corners = boxes_of(faces) / scale
    total = 0.0
    for pocket in room:
        for number in np.flatnonzero(pocket.on_floor(corners, 1e-6 / scale)):
            total += surface_area(faces[number]) * (pocket.floor - pocket.land) * scale
    return total


def sampled_lenses(several: list[ShapePart], window: Window, lens_faces: int, points: int) -> dict[str, Any]:
    """Sample curved faces inside their trimmed borders and measure them against the window."""
    curved = [(number, face) for number, piece in enumerate(several) for face in piece.faces if _curved(face)]
    where = [several[number].placements for number, _ in curved]
    ends = np.cumsum([len(placements) for placements in where], dtype=np.int64)
    if not len(ends):
        return {"lens_error": None, "lens_slope_error": None, "lens_points": 0, "lens_faces": 0}
    held: dict[int, tuple[Floats, Floats]] = {}
    place, outward = [], []
    for at in range(0, int(ends[-1]), max(1, int(ends[-1]) // lens_faces)):
        number = int(np.searchsorted(ends, at, side="right"))
        if number not in held:
            held[number] = _face_points(curved[number][1], points)
        here = where[number].one(at - int(ends[number]) + len(where[number]))
        place.append(applied(here, held[number][0]))
        outward.append(held[number][1] @ here[:, :3].T)
    lens = np.concatenate(outward)
    upright = np.abs(lens[:, 2]) > WALL
    error, angle, _ = on_lenses(window, np.concatenate(place)[upright], lens[upright])
    return {
        "lens_error": float(error.max()) if len(error) else None,
        "lens_slope_error": float(angle.max()) if len(error) else None,
        "lens_points": len(error),
        "lens_faces": int(ends[-1]),
    }


def holes_in(several: list[ShapePart]) -> list[dict[str, Any]]:
    """Round holes: cylinders whose outward normals point to their axis, mm.

    Returns
    -------
    list of dict
        diameter, length; at: (3,) middle of the hole's axis; axis: (3,) unit. Of parts that are not repeated.
    """
    from OCP.TopoDS import TopoDS

    found: list[dict[str, Any]] = []
    for piece in several:
        if len(piece.placements) > 1:
            continue
        for face in piece.faces:
            hole = _hole(TopoDS.Face(moved(face, piece.placements.one(0))))
            if hole is None:
                continue
            for known in found:  # halves of one hole, and a hole through several bodies
                across = np.cross(np.subtract(hole["at"], known["at"]), known["axis"])
                if np.linalg.norm(across) <= 1e-3 * known["diameter"]:
                    break
            else:
                found.append(hole)
    return found


def _hole(face: Any) -> dict[str, Any] | None:
    """Diameter, length, middle and axis (mm) of the round hole with this face as its wall, or None."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.GeomAbs import GeomAbs_Cylinder
    from OCP.gp import gp_Pnt, gp_Vec
    from OCP.TopAbs import TopAbs_REVERSED

    surface = BRepAdaptor_Surface(face, True)
    if surface.GetType() != GeomAbs_Cylinder:
        return None
    cylinder = surface.Cylinder()
    origin, way = cylinder.Axis().Location(), cylinder.Axis().Direction()
    start, axis = np.array([origin.X(), origin.Y(), origin.Z()]), np.array([way.X(), way.Y(), way.Z()])
    low, high = surface.FirstVParameter(), surface.LastVParameter()
    point, along, across = gp_Pnt(), gp_Vec(), gp_Vec()
    surface.D1(
        0.5 * (surface.FirstUParameter() + surface.LastUParameter()), 0.5 * (low + high), point, along, across
    )
    normal = along.Crossed(across)
    outward = np.array([normal.X(), normal.Y(), normal.Z()])
    outward *= -1.0 if face.Orientation() == TopAbs_REVERSED else 1.0
    middle = start + 0.5 * (low + high) * axis
    if outward @ (np.array([point.X(), point.Y(), point.Z()]) - middle) >= 0.0:
        return None  # an outline, or a peg
    return {
        "diameter": 2.0 * cylinder.Radius(),
        "length": high - low,
        "at": middle.tolist(),
        "axis": axis.tolist(),
    }


def occ_lenses(several: list[ShapePart], each: int = 3) -> LensPoints:
    """Points of every curved face of every piece, in its piece's frame, as OCC reads them."""
    place, outward, part = [np.empty((0, 3))], [np.empty((0, 3))], []
    counts = []
    for number, piece in enumerate(several):
        for face in piece.faces:
            if _curved(face):
                at, way = _face_points(face, each)
                if len(at):
                    place.append(at)
                    outward.append(way)
                    counts.append(len(at))
                    part.append(number)
    patch = np.repeat(np.arange(len(part)), counts)
    return LensPoints(
        np.concatenate(place), np.concatenate(outward), patch.astype(np.int64), np.array(part, dtype=np.int64)
    )


def _curved(face: Any) -> bool:
    """Whether a face lies on a surface curved both ways (a lens), not on a plane or a ruled wall."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.GeomAbs import (
        GeomAbs_BezierSurface,
        GeomAbs_BSplineSurface,
        GeomAbs_Sphere,
        GeomAbs_SurfaceOfRevolution,
        GeomAbs_Torus,
    )

    surface = BRepAdaptor_Surface(face, False)
    kind = surface.GetType()
    if kind in (GeomAbs_BSplineSurface, GeomAbs_BezierSurface):
        return bool(min(surface.UDegree(), surface.VDegree()) >= 2)
    return kind in (GeomAbs_Sphere, GeomAbs_Torus, GeomAbs_SurfaceOfRevolution)


def _face_points(face: Any, count: int) -> tuple[Floats, Floats]:
    """Points (k, 3) inside a face and outward unit normals (k, 3)."""
    from OCP.BRep import BRep_Tool
    from OCP.BRepClass import BRepClass_FaceClassifier
    from OCP.BRepTools import BRepTools
    from OCP.gp import gp_Pnt, gp_Pnt2d, gp_Vec
    from OCP.TopAbs import TopAbs_IN, TopAbs_REVERSED

    surface = BRep_Tool.Surface_s(face)
    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
    inside = BRepClass_FaceClassifier()
    sense = -1.0 if face.Orientation() == TopAbs_REVERSED else 1.0
    place, normal = [], []
    for n in range(count):
        u, v = u0 + (u1 - u0) * (n + 0.5) / count, v0 + (v1 - v0) * ((0.5 + (n - count // 2) * _GOLDEN) % 1.0)
        inside.Perform(face, gp_Pnt2d(u, v), 1e-9)
        if inside.State() != TopAbs_IN:
            continue
        point, along, across = gp_Pnt(), gp_Vec(), gp_Vec()
        surface.D1(u, v, point, along, across)
        way = sense * np.cross([along.X(), along.Y(), along.Z()], [across.X(), across.Y(), across.Z()])
        place.append([point.X(), point.Y(), point.Z()])
        normal.append(way / np.linalg.norm(way))
    return np.array(place).reshape(-1, 3), np.array(normal).reshape(-1, 3)
