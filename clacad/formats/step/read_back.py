"""Read a STEP file back: what the CAD kernel finds in it, and how far its lens faces lie from the design.

Nothing here knows how the file was written. Lengths in mm.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.formats.step.lens_placements import WALL, LensPoints, lens_facts, on_lenses
from clacad.formats.step.placements import applied
from clacad.formats.step.shape_parts import Piece, boxes_of, moved, pieces, whole_box
from clacad.formats.step.text_health import Scan, patch_points, scan_step
from clacad.sheet.window import Window
from clacad.storage.errors import UnreadableFile

KERNEL_BYTES = 24_000_000
"""Files larger than this are scanned only: a kernel would take minutes and gigabytes."""

FEW_FACES = 2000
"""Faces up to which each is looked at in three places; in its middle, where there are more."""

_GOLDEN = 0.6180339887498949


def read_step(path: str | os.PathLike[str], window: Window | None = None, kernel: bool | None = None,
              lens_faces: int = 200, points: int = 24) -> dict[str, Any]:  # fmt: skip
    """Read a STEP file and say what is in it.

    Parameters
    ----------
    path : path
    window : Window or None
        Measure the lens faces against the closed form of this window.
    kernel : bool or None
        Whether the CAD kernel reads the file too; None: up to 24 MB.
    lens_faces, points : int
        The kernel's lens faces are sampled: at most so many of them, so many points on each.

    Returns
    -------
    dict
        Of the scan: schema, name, names, colours, millimetres, bytes, solids, faces, dangling, open_edges, entities.
        With a window: patch_error, patches (every lens patch, from the text). By the kernel: kernel = True, valid,
        kernel_solids, kernel_faces, volume, area, box (low, high), tolerance (largest distance at which it took a vertex or
        edge for lying on its face, mm), and with a window lens_error, lens_points, engraved (volume of letters in the
        border, mm³: the floors found where the design has room for them, times their depth).

    Raises
    ------
    UnreadableFile
        The file is no STEP file, is cut short, or holds no face.
    OSError
        The file cannot be read.
    """
    size = os.stat(path).st_size
    scan = scanned(path)
    facts: dict[str, Any] = {
        "bytes": size, "schema": scan.schema, "name": scan.name, "names": scan.names, "colours": scan.colours,
        "millimetres": scan.millimetres, "solids": scan.solids, "faces": scan.faces, "dangling": scan.dangling,
        "open_edges": scan.open_edges, "entities": dict(sorted(scan.entities.items())), "units": list(scan.units),
        "holds": _held(
            scan.solids, scan.shells, scan.faces,
            [
                (one.name, one.solid, sum(len(scan.shell_faces.get(s, ())) for s in one.shells), len(one.placements))
                for one in scan.parts
            ],
        ),
    }  # fmt: skip
    if window is not None:
        facts |= _text_facts(scan, window)
    facts["kernel"] = kernel if kernel is not None else size <= KERNEL_BYTES
    if facts["kernel"]:
        holds = facts["holds"]
        facts |= _kernel_facts(path, window, lens_faces, points)
        if holds["solids"] == facts["kernel_solids"]:  # the text knows the names as well
            facts["holds"] = holds
        if window is not None and (not facts["patches"] or scan.uneven):
            facts |= {"placement": _kernel_placement(path, window)}
    return facts


def _kernel_placement(path: str | os.PathLike[str], window: Window) -> dict[str, Any] | None:
    """Where the lenses stand, as the kernel finds them."""
    several = loaded(path).pieces
    many = sum(len(piece.faces) for piece in several)
    lenses = kernel_lenses(several, 3 if many < FEW_FACES else 1)
    found = lens_facts(window, lenses, [piece.placements for piece in several])
    placement: dict[str, Any] | None = found["placement"]
    return placement


def read_brep(path: str | os.PathLike[str], window: Window | None = None, lens_faces: int = 200, points: int = 24
              ) -> dict[str, Any]:  # fmt: skip
    """Read a BREP file of the CAD kernel, mm: what `read_step` says by the kernel; there is no text to scan.

    Raises
    ------
    UnreadableFile
        The kernel cannot read it, or finds no face in it.
    OSError
        The file cannot be read.
    """
    size = os.stat(path).st_size
    facts = _kernel_facts(path, window, lens_faces, points)
    counts = {
        "solids": facts["kernel_solids"],
        "faces": facts["kernel_faces"],
        "dangling": 0,
        "open_edges": 0,
    }
    placement = {} if window is None else {"placement": _kernel_placement(path, window)}
    return {"bytes": size, "schema": "BREP", "kernel": True} | counts | facts | placement


def _text_facts(scan: Scan, window: Window) -> dict[str, Any]:
    """Every lens patch of the text, in all its placements, against the window."""
    found = lens_facts(window, patch_points(scan), [part.placements for part in scan.parts])
    return found | {"uneven": scan.uneven}


def _held(
    solids: int, shells: int, faces: int, pieces: Sequence[tuple[str, bool, int, int]]
) -> dict[str, Any]:
    """What a workshop will find in a file; pieces: (name, whether it is a solid, faces, instances)."""
    rows = [
        {"name": name, "solid": solid, "faces": each, "instances": many} for name, solid, each, many in pieces
    ]
    return {"solids": solids, "shells": shells, "faces": faces, "prototypes": len(rows), "parts": rows[:64]}


# -- the kernel -------------------------------------------------------------------------------------


def _kernel_facts(
    path: str | os.PathLike[str], window: Window | None, lens_faces: int, points: int
) -> dict[str, Any]:
    from OCP.ShapeAnalysis import ShapeAnalysis_ShapeTolerance

    from clacad.solid.occ_writer import engraved_volume, is_valid, surface_area, volume

    found = loaded(path)
    several = found.pieces
    solids = [piece for piece in several if piece.solid]
    many = [len(piece.placements) for piece in several]
    faces = sum(len(piece.faces) * k for piece, k in zip(several, many, strict=True))
    if not faces:
        raise UnreadableFile(f"{os.fspath(path)}: the CAD kernel finds no face in it; the file is damaged")
    engraved = 0.0 if window is None else _engraved(several, window)
    measured = engraved_volume if engraved else volume
    tolerance = ShapeAnalysis_ShapeTolerance()
    count = sum(len(piece.placements) for piece in solids)
    facts: dict[str, Any] = {
        "valid": all(is_valid(piece.shape) for piece in solids),
        "kernel_solids": count,
        "kernel_faces": faces,
        "volume": sum(measured(piece.shape) * len(piece.placements) for piece in solids),
        "area": sum(surface_area(piece.shape) * len(piece.placements) for piece in solids),
        "box": whole_box(several),
        "tolerance": max(tolerance.Tolerance(piece.shape, 1) for piece in several),
        "holds": _held(
            count, sum(piece.shells * k for piece, k in zip(several, many, strict=True)), faces,
            [("", piece.solid, len(piece.faces), k) for piece, k in zip(several, many, strict=True)],
        ),
    }  # fmt: skip
    facts["holes"] = holes_in(several)
    if window is not None:
        facts |= _sampled(several, window, lens_faces, points) | {"engraved": engraved}
    return facts


@dataclass(frozen=True, eq=False)
class Loaded:
    """A file as the kernel read it: its shape, and the pieces of that."""

    shape: Any
    pieces: list[Piece]


def scanned(path: str | os.PathLike[str]) -> Scan:
    """What the text of a file says; the last one is kept for the next call in this process.

    Raises
    ------
    UnreadableFile
        The file is no STEP file.
    """
    key = _state(path)
    if key not in _SCANNED:
        _SCANNED.clear()
        _SCANNED[key] = scan_step(path)
    return _SCANNED[key]


def _state(path: str | os.PathLike[str]) -> tuple[str, int, int]:
    found = os.stat(path)
    return (os.fspath(path), found.st_size, found.st_mtime_ns)


_SCANNED: dict[tuple[str, int, int], Scan] = {}
_KEPT: dict[tuple[str, int, int], Loaded] = {}


def loaded(path: str | os.PathLike[str]) -> Loaded:
    """What the kernel reads from a file; kept for the next call in this process.

    Raises
    ------
    UnreadableFile
        The kernel cannot read it.
    """
    key = _state(path)
    if key not in _KEPT:
        _KEPT.clear()
        shape = kernel_shape(path)
        _KEPT[key] = Loaded(shape, pieces(shape))
    return _KEPT[key]


def _engraved(several: list[Piece], window: Window) -> float:
    """Volume (mm³) of letters engraved in the borders: area of their floors times depth."""
    from clacad.solid.marks import pockets
    from clacad.solid.occ_writer import surface_area

    scale = millimetres(window.unit)
    room = pockets(window)
    if not room:
        return 0.0
    # letters stand in borders, of which there is one; a cell that is repeated has none
    alone = [piece for piece in several if len(piece.placements) == 1]
    faces = [moved(face, piece.placements[0]) for piece in alone for face in piece.faces]
    corners = boxes_of(faces) / scale
    total = 0.0
    for pocket in room:
        for number in np.flatnonzero(pocket.on_floor(corners, 1e-6 / scale)):
            total += surface_area(faces[number]) * (pocket.floor - pocket.land) * scale
    return total


def kernel_shape(path: str | os.PathLike[str]) -> Any:
    """The shape the CAD kernel reads from a STEP file, or from a file of its own named .brep (mm).

    Raises
    ------
    UnreadableFile
        The kernel cannot read it.
    """
    if os.fspath(path).lower().endswith(".brep"):
        return _own_shape(os.fspath(path))
    from OCP.IFSelect import IFSelect_RetDone
    from OCP.Interface import Interface_Static
    from OCP.STEPControl import STEPControl_Reader

    reader = STEPControl_Reader()
    Interface_Static.SetCVal_s("xstep.cascade.unit", "MM")
    if reader.ReadFile(os.fspath(path)) != IFSelect_RetDone:
        raise UnreadableFile(f"{os.fspath(path)}: the CAD kernel cannot read it")
    reader.TransferRoots()
    return reader.OneShape()


def _own_shape(path: str) -> Any:
    from OCP.BRep import BRep_Builder
    from OCP.BRepTools import BRepTools
    from OCP.TopoDS import TopoDS_Shape

    shape = TopoDS_Shape()
    if not BRepTools.Read_s(shape, path, BRep_Builder()) or shape.IsNull():
        raise UnreadableFile(f"{path}: the CAD kernel cannot read it")
    return shape


def _sampled(several: list[Piece], window: Window, lens_faces: int, points: int) -> dict[str, Any]:
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
        here = where[number][at - int(ends[number])]
        place.append(applied(here, held[number][0]))
        outward.append(held[number][1] @ here[:, :3].T)
    lens = np.concatenate(outward)
    upright = np.abs(lens[:, 2]) > WALL
    error, angle, _ = on_lenses(window, np.concatenate(place)[upright], lens[upright])
    return {
        "lens_error": float(error.max()) if len(error) else None,
        "lens_slope_error": float(angle.max()) if len(error) else None,
        "lens_points": len(error), "lens_faces": int(ends[-1]),
    }  # fmt: skip


def holes_in(several: list[Piece]) -> list[dict[str, Any]]:
    """Round holes: cylinders whose faces look at their axis, mm.

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
            hole = _hole(TopoDS.Face(moved(face, piece.placements[0])))
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
        "diameter": 2.0 * cylinder.Radius(), "length": high - low, "at": middle.tolist(), "axis": axis.tolist(),
    }  # fmt: skip


def kernel_lenses(several: list[Piece], each: int = 3) -> LensPoints:
    """Points of every curved face of every piece, in its piece's frame, as the kernel reads them."""
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
