"""Read a STEP file back: what the CAD kernel finds in it, and how far its lens faces lie from the design.

Nothing here knows how the file was written. Lengths in mm.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.export.errors import UnreadableFile
from clacad.export.step_scan import Scan, patch_points, scan_step
from clacad.sheet import Window, lens_height_and_normal

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

KERNEL_BYTES = 24_000_000
"""Files larger than this are scanned only: a kernel would take minutes and gigabytes."""

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
    scan = scan_step(path)
    facts: dict[str, Any] = {
        "bytes": size, "schema": scan.schema, "name": scan.name, "names": scan.names, "colours": scan.colours,
        "millimetres": scan.millimetres, "solids": scan.solids, "faces": scan.faces, "dangling": scan.dangling,
        "open_edges": scan.open_edges, "entities": dict(sorted(scan.entities.items())),
    }  # fmt: skip
    if window is not None:
        facts |= _patch_facts(scan, window)
    facts["kernel"] = kernel if kernel is not None else size <= KERNEL_BYTES
    if facts["kernel"]:
        facts |= _kernel_facts(path, window, lens_faces, points)
    return facts


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
    return {"bytes": size, "schema": "BREP", "kernel": True} | counts | facts


def _patch_facts(scan: Scan, window: Window) -> dict[str, Any]:
    place, normal, front = patch_points(scan)
    # The text of an assembly holds the geometry of its one cell, whose centre is the origin.
    instanced = scan.entities["NEXT_ASSEMBLY_USAGE_OCCURRENCE"] > 0
    error, angle = lens_distance(window, place, normal, front, instanced)
    return {
        "patches": len(place) // 9,
        "patch_error": float(error.max()) if len(error) else None,
        "patch_slope_error": float(angle.max()) if len(angle) else None,
    }


def lens_distance(window: Window, place: Floats, normal: Floats, front: Bools, one_cell: bool = False
                  ) -> tuple[Floats, Floats]:  # fmt: skip
    """How far points lie from the lens faces of a window.

    Parameters
    ----------
    window : Window
    place : (n, 3), mm
        In the sheet frame, or in the frame of a cell.
    normal : (n, 3)
        Unit, towards +z.
    front : (n,) bool
        Whether the point belongs to a front face.
    one_cell : bool
        Points are given in the frame of a cell (the one cell of an assembly).

    Returns
    -------
    distance : (n,), mm
        Along the normal, to the nearest lens face of that side; infinite where there is none.
    angle : (n,), rad
        Between the normals.
    """
    scale = window.unit * 1e3
    best, angle = np.full(len(place), np.inf), np.full(len(place), np.inf)
    for face in window.faces:
        if face.array is None:
            continue
        chosen = np.flatnonzero(front == (face.side > 0))
        at = place[chosen] / scale
        x, y = at[:, 0], at[:, 1]
        if not one_cell:
            shift = window.shifts[face.array]
            _, x, y = window.lattice.locate(x - shift[0], y - shift[1])
        z, expected = lens_height_and_normal(face, x, y)
        away = np.abs((at[:, 2] - z) * expected[:, 2]) * scale
        turned = np.linalg.norm(np.cross(expected, normal[chosen]), axis=1)
        closer = away < best[chosen]
        best[chosen[closer]], angle[chosen[closer]] = away[closer], turned[closer]
    return best, angle


# -- the kernel -------------------------------------------------------------------------------------


def _kernel_facts(path: str | os.PathLike[str], window: Window | None, lens_faces: int, points: int
                  ) -> dict[str, Any]:  # fmt: skip
    from OCP.ShapeAnalysis import ShapeAnalysis_ShapeTolerance
    from OCP.TopAbs import TopAbs_FACE, TopAbs_SOLID

    from clacad.brep.kernel import engraved_volume, is_valid, surface_area, volume

    shape = kernel_shape(path)
    solids = _explored(shape, TopAbs_SOLID)
    faces = _explored(shape, TopAbs_FACE)
    if not faces:
        raise UnreadableFile(f"{os.fspath(path)}: the CAD kernel finds no face in it; the file is damaged")
    unique: dict[Any, tuple[Any, int]] = {}
    for solid in solids:
        key = solid.TShape()
        held = unique.get(key)
        unique[key] = (solid, 1 if held is None else held[1] + 1)
    engraved = 0.0 if window is None else _engraved(faces, window)
    measured = engraved_volume if engraved else volume
    facts: dict[str, Any] = {
        "valid": all(is_valid(solid) for solid, _ in unique.values()),
        "kernel_solids": len(solids),
        "kernel_faces": len(faces),
        "volume": sum(measured(solid) * many for solid, many in unique.values()),
        "area": sum(surface_area(solid) * many for solid, many in unique.values()),
        "box": _box(shape),
        "tolerance": ShapeAnalysis_ShapeTolerance().Tolerance(shape, 1),
    }
    if window is not None:
        facts |= _sampled(faces, window, lens_faces, points) | {"engraved": engraved}
    return facts


def _engraved(faces: list[Any], window: Window) -> float:
    """Volume (mm³) of letters engraved in the borders: area of their floors times depth."""
    from clacad.brep.kernel import surface_area
    from clacad.fixture.mark import pockets

    scale = window.unit * 1e3
    room = pockets(window)
    if not room:
        return 0.0
    corners = np.array([_box(face) for face in faces]) / scale
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


def _explored(shape: Any, kind: Any) -> list[Any]:
    from OCP.TopAbs import TopAbs_FACE
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    if shape.IsNull():
        return []
    explorer, found = TopExp_Explorer(shape, kind), []
    while explorer.More():
        found.append(TopoDS.Face(explorer.Current()) if kind == TopAbs_FACE else explorer.Current())
        explorer.Next()
    return found


def _box(shape: Any) -> list[list[float]]:
    from OCP.Bnd import Bnd_Box
    from OCP.BRepBndLib import BRepBndLib

    box = Bnd_Box()
    BRepBndLib.Add_s(shape, box, False)
    box.SetGap(0.0)
    low, high = box.CornerMin(), box.CornerMax()
    return [[low.X(), low.Y(), low.Z()], [high.X(), high.Y(), high.Z()]]


def _sampled(faces: list[Any], window: Window, lens_faces: int, points: int) -> dict[str, Any]:
    """Sample curved faces inside their trimmed borders and measure them against the window."""
    curved = [face for face in faces if _curved(face)]
    step = max(1, len(curved) // lens_faces)
    place, normal, front = [], [], []
    for face in curved[::step]:
        at, way, outward = _face_points(face, points)
        place.append(at)
        normal.append(way)
        front.append(np.full(len(at), outward < 0.0))
    if not place:
        return {"lens_error": None, "lens_slope_error": None, "lens_points": 0, "lens_faces": 0}
    error, angle = lens_distance(window, np.concatenate(place), np.concatenate(normal), np.concatenate(front))
    return {
        "lens_error": float(error.max()), "lens_slope_error": float(angle.max()), "lens_points": len(error),
        "lens_faces": len(curved),
    }  # fmt: skip


def _curved(face: Any) -> bool:
    """Whether a face lies on a surface curved both ways (a lens), not on a plane or a ruled wall."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.GeomAbs import GeomAbs_BSplineSurface

    surface = BRepAdaptor_Surface(face, False)
    return bool(
        surface.GetType() == GeomAbs_BSplineSurface and min(surface.UDegree(), surface.VDegree()) >= 2
    )


def _face_points(face: Any, count: int) -> tuple[Floats, Floats, float]:
    """Points (k, 3) inside a face, unit normals towards +z, and the sign of the outward normal's z."""
    from OCP.BRep import BRep_Tool
    from OCP.BRepClass import BRepClass_FaceClassifier
    from OCP.BRepTools import BRepTools
    from OCP.gp import gp_Pnt, gp_Pnt2d, gp_Vec
    from OCP.TopAbs import TopAbs_IN, TopAbs_REVERSED

    surface = BRep_Tool.Surface_s(face)
    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
    inside = BRepClass_FaceClassifier()
    place, normal = [], []
    outward = 1.0
    for n in range(count):
        u, v = u0 + (u1 - u0) * (n + 0.5) / count, v0 + (v1 - v0) * ((n * _GOLDEN) % 1.0)
        inside.Perform(face, gp_Pnt2d(u, v), 1e-9)
        if inside.State() != TopAbs_IN:
            continue
        point, along, across = gp_Pnt(), gp_Vec(), gp_Vec()
        surface.D1(u, v, point, along, across)
        way = along.Crossed(across)
        outward = way.Z() * (-1.0 if face.Orientation() == TopAbs_REVERSED else 1.0)
        up = np.array([way.X(), way.Y(), way.Z()]) * np.sign(way.Z())
        place.append([point.X(), point.Y(), point.Z()])
        normal.append(up / np.linalg.norm(up))
    return np.array(place).reshape(-1, 3), np.array(normal).reshape(-1, 3), outward
