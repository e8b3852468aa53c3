"""Comparison of lens faces found in a file of solids with the design, each in some of its placements. Lengths
in mm.

Readers of the file, of its text or with OCC, provide points of its lens faces in the frame of their part, and
the placements of the parts.

One sheet of several in a file: which parts of an assembly belong to it, in its own frame. Lengths in mm.

A file of sheets behind one another is cut at planes between them. A part belongs to the sheet between whose
planes the middle of its height lies, so every part belongs to exactly one sheet.

Faces of OCC's shapes are classified here: lenses, round holes, letters in a border.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.base.units import millimetres
from clacad.formats.placements import Placements, applied, turns
from clacad.formats.step.shape_parts import ShapePart, boxes_of, moved
from clacad.sheet.window import WALL, Window, heights_and_normals_of_lenses


@dataclass(frozen=True, eq=False)
class LensPoints:
    """Points of curved faces.

    place : (n, 3), mm, in the frame of the part
    outward : (n, 3), unit
    patch : (n,). The face each point belongs to, ascending.
    part : (patches,). The part each face belongs to.
    """

    place: Floats
    outward: Floats
    patch: Ints
    part: Ints

    @classmethod
    def none(cls) -> LensPoints:
        """No points."""
        nobody = np.empty(0, dtype=np.int64)
        return cls(np.empty((0, 3)), np.empty((0, 3)), nobody, nobody)

    @classmethod
    def joined(cls, several: Sequence[LensPoints]) -> LensPoints:
        """Points of groups, with patches numbered consecutively."""
        return cls(
            *(
                np.concatenate([getattr(one, name) for one in several])
                for name in ("place", "outward", "patch", "part")
            )
        )

    def of_part(self, part: int) -> LensPoints:
        """Points of one part, patches numbered from 0."""
        chosen = np.zeros(max(part, int(self.part.max(initial=-1))) + 1, dtype=np.bool_)
        chosen[part] = True
        return self.of_parts(chosen)

    def of_parts(self, chosen: Bools) -> LensPoints:
        """Points of the parts for which `chosen` (parts,) holds, patches numbered from 0."""
        kept = chosen[self.part]
        rows = kept[self.patch]
        number = np.cumsum(kept) - 1
        return LensPoints(self.place[rows], self.outward[rows], number[self.patch[rows]], self.part[kept])

    def placed(self, placements: Floats) -> LensPoints:
        """The points in a placement (parts, 3, 4) of each part."""
        own = placements[self.part[self.patch]]
        return replace(
            self,
            place=np.einsum("nij,nj->ni", own[:, :, :3], self.place) + own[:, :, 3],
            outward=np.einsum("nij,nj->ni", own[:, :, :3], self.outward),
        )


@dataclass(frozen=True, eq=False)
class LensErrors:
    """Patches compared with the design, each in s placements.

    error, slope : (s, p)
        Largest distance (mm) and angle (rad) of a patch's points to the lens face it is nearest to.
    face : (s, p). Number of that face in `Window.faces`; −1 for a wall.
    cell : (s, p, 2). The cell it lies over, in the grid of that face's array.
    """

    error: Floats
    slope: Floats
    face: Ints
    cell: Ints


def on_lenses(window: Window, place: Floats, outward: Floats) -> tuple[Floats, Floats, Ints]:
    """Distances of points from the lens faces of a window.

    place : (n, 3), mm, sheet frame
    outward : (n, 3), unit

    Returns
    -------
    distance : (n,), mm
        Along the normal, to the nearest lens face of that side; infinite where there is none.
    angle : (n,), rad
        Between the normals.
    face : (n,)
        Number of that lens face in `Window.faces`, −1 where there is none.
    """
    scale = millimetres(window.unit)
    best, angle = np.full(len(place), np.inf), np.full(len(place), np.inf)
    which = np.full(len(place), -1, dtype=np.int64)
    for number, face in enumerate(window.faces):
        if face.array is None:
            continue
        chosen = np.flatnonzero((outward[:, 2] < 0.0) == (face.side > 0))
        at = place[chosen] / scale
        index, x, y = window.locate(face.array, at[:, 0], at[:, 1])
        places = window.lenses(face, index)
        z, expected = heights_and_normals_of_lenses(face, places, x, y)
        away = np.abs((at[:, 2] - z) * expected[:, 2]) * scale
        turned = np.linalg.norm(np.cross(expected, outward[chosen]), axis=1)
        with np.errstate(invalid="ignore"):
            closer = away < best[chosen]
        rows = chosen[closer]
        best[rows], angle[rows], which[rows] = away[closer], turned[closer], number
    return best, angle, which


def measured(window: Window, lenses: LensPoints, placements: Floats) -> LensErrors:
    """Compare the patches of one part with the design, in the placements (s, 3, 4)."""
    many, patches = len(placements), len(lenses.part)
    place = applied(placements, lenses.place[None])
    outward = lenses.outward[None] @ np.swapaxes(placements[:, :, :3], 1, 2)
    outward = outward / np.linalg.norm(outward, axis=2, keepdims=True)
    away, angle, face = on_lenses(window, place.reshape(-1, 3), outward.reshape(-1, 3))
    first = np.searchsorted(lenses.patch, np.arange(patches))
    upright = _worst(np.abs(outward[..., 2]), lenses.patch, patches)
    face = np.where(upright > WALL, face.reshape(many, -1)[:, first], -1)
    counts = np.bincount(lenses.patch, minlength=patches)
    middle = np.stack([np.add.reduceat(place[..., k], first, axis=1) for k in (0, 1)], axis=-1)
    middle /= counts[:, None] * millimetres(window.unit)
    cell = np.zeros((many, patches, 2), dtype=np.int64)
    for number, one in enumerate(window.faces):
        if one.array is not None:
            chosen = face == number
            cell[chosen] = window.locate(one.array, *middle[chosen].T)[0]
    error, slope = (_worst(one.reshape(many, -1), lenses.patch, patches) for one in (away, angle))
    return LensErrors(error, slope, face, cell)


def _worst(values: Floats, patch: Ints, patches: int) -> Floats:
    """Largest value (s, patches) of the points (s, n) of every patch."""
    return np.asarray(np.maximum.reduceat(values, np.searchsorted(patch, np.arange(patches)), axis=1))


@dataclass(frozen=True, slots=True)
class SheetPlace:
    """Position of a sheet in a file.

    low, high : mm. Planes between which it lies; infinite at the ends of the file.
    z : mm. Height of the sheet's own z = 0.
    """

    low: float
    high: float
    z: float

    def holds(self, middle: Floats) -> Bools:
        """Which heights (n,) lie between the planes."""
        return np.asarray((middle >= self.low) & (middle < self.high))

    def own(self, placements: Floats) -> Floats:
        """Placements (k, 3, 4) of the file in the sheet's frame."""
        return np.asarray(placements - np.array([[0.0] * 4, [0.0] * 4, [0.0, 0.0, 0.0, self.z]]))

    def of_pieces(self, several: Sequence[ShapePart]) -> list[ShapePart]:
        """The pieces of a file that belong to the sheet, each with the placements that do."""
        found = []
        for piece in several:
            own = self._of_piece(piece)
            if len(own):
                found.append(replace(piece, placements=own))
        return found

    def _of_piece(self, piece: ShapePart) -> Placements:
        """Placements of a piece that belong to the sheet, in its frame."""
        from clacad.solid.occ_writer import box

        placements = piece.placements
        if _rows_level(placements):
            return self._of_rows(placements, float(np.array(box(piece.shape))[:, 2].mean()))
        kept = [np.empty((0, 3, 4))]
        for turn, moves in turns(placements.all()):
            corners = np.array(box(moved(piece.shape, turn)))
            inside = self.holds(corners[:, 2].mean() + moves[:, 2])
            placed = np.repeat(turn[None], int(inside.sum()), axis=0)
            placed[:, :, 3] = moves[inside]
            kept.append(placed)
        return Placements(self.own(np.concatenate(kept)))

    def of_parts(self, lenses: LensPoints, parts: Sequence[Placements]) -> list[Placements]:
        """Placements of each part that belong to the sheet, decided by the part's lenses."""
        found = []
        for number, placements in enumerate(parts):
            place = lenses.of_part(number).place
            if not len(place):
                found.append(Placements(np.empty((0, 3, 4))))
            elif _rows_level(placements):
                found.append(self._of_rows(placements, float(place.mean(axis=0)[2])))
            else:
                every = placements.all()
                middle = applied(every, place.mean(axis=0)[None, None])[:, 0, 2]
                found.append(Placements(self.own(every[self.holds(middle)])))
        return found

    def _of_rows(self, placements: Placements, middle: float) -> Placements:
        """Placements of a part in rows of the sheet, its middle at that height (mm) in its own frame."""
        inside = self.holds(middle + placements.outer[:, 2, 3])
        return replace(placements, outer=self.own(placements.outer[inside]))


def _rows_level(placements: Placements) -> bool:
    """Whether parts only move, those of one row not in height."""
    return placements.unturned and not placements.inner[:, 2, 3].any()


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


def layer_volumes(solids: Sequence[ShapePart], volumes: Sequence[float], window: Window) -> dict[str, float]:
    """Volume (mm³) of each body of a window of which solids are there: those whose middle lies between its
    neighbours; `volumes`: of each solid, mm³.
    """
    from clacad.sheet.feasibility.lenses import whole_body_range
    from clacad.solid.occ_writer import box

    ranges = [whole_body_range(window, body) for body in window.bodies]
    levels = [0.5 * (below[1] + above[0]) * millimetres(window.unit) for below, above in pairwise(ranges)]
    found: dict[str, float] = {}
    for piece, each in zip(solids, volumes, strict=True):
        for turn, moves in turns(piece.placements.all()):
            middle = np.array(box(moved(piece.shape, turn)))[:, 2].mean() + moves[:, 2]
            for number, many in zip(*np.unique(np.searchsorted(levels, middle), return_counts=True)):
                name = window.bodies[number].name
                found[name] = found.get(name, 0.0) + each * int(many)
    return found


def holes_in(several: list[ShapePart]) -> list[dict[str, Any]]:
    """Round holes: cylinders whose outward normals point to their axis, mm.

    Returns: diameter, length; at: (3,) middle of the hole's axis; axis: (3,) unit. Of parts that are not
        repeated.
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
    from OCP.gp import gp_Pnt, gp_Vec
    from OCP.TopAbs import TopAbs_REVERSED

    surface = BRepAdaptor_Surface(face, True)
    found = _cylinder(surface)
    if found is None:
        return None
    start, axis, radius = found
    (u0, u1), (v0, v1) = _spans(surface)
    point, along, across = gp_Pnt(), gp_Vec(), gp_Vec()
    surface.D1(0.5 * (u0 + u1), 0.5 * (v0 + v1), point, along, across)
    outward = _numbers(along.Crossed(across)) * (-1.0 if face.Orientation() == TopAbs_REVERSED else 1.0)
    at = _numbers(point)
    middle = start + ((at - start) @ axis) * axis
    if outward @ (at - middle) >= 0.0:
        return None  # an outline, or a peg
    ends = _numbers(surface.Value(u1, v1)) - _numbers(surface.Value(u0, v0))
    return {
        "diameter": 2.0 * radius,
        "length": abs(float(ends @ axis)),
        "at": middle.tolist(),
        "axis": axis.tolist(),
    }


def _numbers(of: Any) -> Floats:
    """Coordinates (3,) of a point or a vector of OCC."""
    return np.array([of.X(), of.Y(), of.Z()])


def _spans(surface: Any) -> tuple[tuple[float, float], tuple[float, float]]:
    """First and last value of both parameters of a surface of OCC."""
    return (
        (surface.FirstUParameter(), surface.LastUParameter()),
        (surface.FirstVParameter(), surface.LastVParameter()),
    )


def _cylinder(surface: Any) -> tuple[Floats, Floats, float] | None:
    """Point and direction (3,) of the axis of a round wall, and its radius, mm; None for another surface.

    Programs that cut a solid keep an upright round wall as a spline.
    """
    from OCP.GeomAbs import GeomAbs_Cylinder, GeomAbs_Plane
    from OCP.gp import gp_Pnt, gp_Vec

    if surface.GetType() == GeomAbs_Cylinder:
        cylinder = surface.Cylinder()
        axis = cylinder.Axis()
        return _numbers(axis.Location()), _numbers(axis.Direction()), float(cylinder.Radius())
    if surface.GetType() == GeomAbs_Plane:
        return None
    places = []
    for share in (0.5, 0.1, 0.3, 0.7, 0.9):  # along a diagonal of the wall
        point, along, across = gp_Pnt(), gp_Vec(), gp_Vec()
        u, v = (low + share * (high - low) for low, high in _spans(surface))
        surface.D1(u, v, point, along, across)
        normal = along.Crossed(across)
        if not abs(normal.Z()) <= 1e-6 * normal.Magnitude():
            return None
        places.append(_numbers(point))
    start = places[0]
    flat = np.array(places)[:, :2] - start[:2]
    a, b = flat[1], flat[4]
    twice = 2.0 * float(a[0] * b[1] - a[1] * b[0])
    if abs(twice) <= 1e-6 * float(np.hypot(*a) * np.hypot(*b)):  # a straight wall
        return None
    centre = np.array([b[1] * (a @ a) - a[1] * (b @ b), a[0] * (b @ b) - b[0] * (a @ a)]) / twice
    radius = float(np.hypot(*centre))
    if np.abs(np.hypot(*(flat - centre).T) - radius).max() > 1e-6 * radius:
        return None
    return start + np.append(centre, 0.0), np.array([0.0, 0.0, 1.0]), radius


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
