"""Reading back of a STEP file: what OCC finds in it, and the distances of its lens faces from the design.

The module does not know how the file was written. Lengths in mm.

A STEP file as triangles, from which the pose of the part is found; and rewriting of its shape in that
pose.
"""

from __future__ import annotations

import mmap
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from clacad.base.units import millimetres
from clacad.base.untrusted_files import BUDGETS
from clacad.formats.step.lens_placements import (
    SheetPlace,
    engraved_in,
    holes_in,
    layer_volumes,
    occ_lenses,
    sampled_lenses,
)
from clacad.formats.step.lenses_on_cells import lens_facts
from clacad.formats.step.shape_parts import ShapePart, pieces, whole_box
from clacad.formats.step.text_health import StepScan, heights_of_planes, patch_points, scan_step
from clacad.sheet.window import Window
from clacad.storage.errors import UnreadableFile

OCC_BYTES = BUDGETS["step"].bytes
"""Files larger than this are only scanned: OCC would take minutes and gigabytes."""

Key = TypeVar("Key")
T = TypeVar("T")

FEW_FACES = 2000
"""Faces up to which each is examined at three points; at its middle, where there are more."""


def read_step(
    path: str | os.PathLike[str],
    window: Window | None = None,
    kernel: bool | None = None,
    lens_faces: int = 200,
    points: int = 24,
    place: SheetPlace | None = None,
) -> dict[str, Any]:
    """Read a STEP file and report its content.

    path, window : The lens faces are measured against the closed form of this window.
    kernel : Whether OCC reads the file too; None: up to 24 MB.
    lens_faces, points : int
        OCC's lens faces are sampled: the largest number of faces, and the number of points on each.
    place : The window is one sheet of several in the file; what OCC finds, and lens faces, are of that sheet
        alone.
    Returns: Of the scan: schema, name, names, colours, millimetres, bytes, solids, faces, dangling,
        open_edges, entities. With a window: patch_error, patches (every lens patch, from the text), named
        (name of a solid, and the body whose lenses it has). By OCC: kernel = True, valid, kernel_solids,
        kernel_faces, volume, area, box (low, high), tolerance (largest distance within which it accepted a
        vertex or edge as on its face, mm), and with a window lens_error, lens_points, engraved (volume of
        letters, mm³); of plates of several layers: volumes (mm³ of each body that is there).
    Raises UnreadableFile: The file is no STEP file, is truncated, or contains no face.
    Raises OSError: The file cannot be read.
    """
    size = os.stat(path).st_size
    scan = scanned(path)
    facts = {"bytes": size} | _text_facts(scan, window, place)
    facts["kernel"] = kernel if kernel is not None else size <= OCC_BYTES
    if facts["kernel"]:
        holds = facts["holds"]
        facts |= _occ_facts(path, window, lens_faces, points, place)
        if holds["solids"] == facts["kernel_solids"]:  # the text has the names as well
            facts["holds"] = holds
        if window is not None and (not facts["patches"] or scan.uneven):
            facts |= {"placement": _occ_placement(path, window, place)}
    elif place is None:
        facts["cylinders"] = cylinders_in_text(path)
    return facts


def cylinders_in_text(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """Cylinders along z of the text of a file, each in the frame of its part: diameter, at, axis; mm."""
    found = []
    number = rb"([-+.0-9Ee]+)"
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as text:

        def entity(name: bytes, pattern: bytes) -> re.Match[bytes] | None:
            start = text.find(b"\n#%s=" % name) + 1
            return re.compile(rb"#\d+=" + pattern).match(text, start) if start else None

        for one in re.finditer(rb"CYLINDRICAL_SURFACE\('[^']*',#(\d+)," + number + rb"\)", text):
            frame = entity(one[1], rb"AXIS2_PLACEMENT_3D\('[^']*',#(\d+)")
            at = frame and entity(
                frame[1], rb"CARTESIAN_POINT\('[^']*',\(" + b",".join([number] * 3) + rb"\)\)"
            )
            if at:
                middle = [float(v) for v in at.groups()]
                found.append({"diameter": 2.0 * float(one[2]), "at": middle, "axis": (0.0, 0.0, 1.0)})
    return found


def _occ_placement(
    path: str | os.PathLike[str], window: Window, place: SheetPlace | None = None
) -> dict[str, Any] | None:
    """Placement of the lenses, as OCC finds it."""
    several = loaded(path).pieces if place is None else place.of_pieces(loaded(path).pieces)
    many = sum(len(piece.faces) for piece in several)
    lenses = occ_lenses(several, 3 if many < FEW_FACES else 1)
    found = lens_facts(window, lenses, [piece.placements for piece in several])
    placement: dict[str, Any] | None = found["placement"]
    return placement


def read_brep(
    path: str | os.PathLike[str], window: Window | None = None, lens_faces: int = 200, points: int = 24
) -> dict[str, Any]:
    """Read a BREP file of OCC, mm: the OCC results of `read_step`; there is no text to scan.

    Raises UnreadableFile: OCC cannot read it, or finds no face in it.
    Raises OSError: The file cannot be read.
    """
    size = os.stat(path).st_size
    facts = _occ_facts(path, window, lens_faces, points)
    counts = {
        "solids": facts["kernel_solids"],
        "faces": facts["kernel_faces"],
        "dangling": 0,
        "open_edges": 0,
    }
    placement = {} if window is None else {"placement": _occ_placement(path, window)}
    return {"bytes": size, "schema": "BREP", "kernel": True} | counts | facts | placement


def _text_facts(scan: StepScan, window: Window | None, place: SheetPlace | None = None) -> dict[str, Any]:
    """Facts of the text; with a window every lens patch in all its placements is compared with it too."""
    facts: dict[str, Any] = {
        "schema": scan.schema,
        "name": scan.name,
        "names": scan.names,
        "colours": scan.colours,
        "millimetres": scan.millimetres,
        "solids": scan.solids,
        "faces": scan.faces,
        "dangling": scan.dangling,
        "open_edges": scan.open_edges,
        "entities": dict(sorted(scan.entities.items())),
        "units": list(scan.units),
        "holds": _held(
            scan.solids,
            scan.shells,
            scan.faces,
            [
                (
                    one.name,
                    one.solid,
                    sum(len(scan.shell_faces.get(s, ())) for s in one.shells),
                    len(one.placements),
                )
                for one in scan.parts
            ],
        ),
    }
    if window is None:
        return facts
    lenses, parts = patch_points(scan), [part.placements for part in scan.parts]
    found = lens_facts(window, lenses, parts if place is None else place.of_parts(lenses, parts))
    named = [(scan.parts[number].name, body) for number, body in found.pop("owners").items()]
    layers = [body for body in window.bodies if body.layer]
    for name, z in heights_of_planes(scan) if layers and place is None else ():
        middle = 0.5 * float(z.min() + z.max()) / millimetres(window.unit)
        named += [(name, one.name) for one in layers if one.front.vertex[2] < middle < one.back.vertex[2]]
    return facts | found | {"uneven": scan.uneven, "named": named}


def _held(
    solids: int, shells: int, faces: int, pieces: Sequence[tuple[str, bool, int, int]]
) -> dict[str, Any]:
    """What a workshop finds in a file; pieces: (name, whether it is a solid, faces, instances)."""
    rows = [
        {"name": name, "solid": solid, "faces": each, "instances": many} for name, solid, each, many in pieces
    ]
    return {"solids": solids, "shells": shells, "faces": faces, "prototypes": len(rows), "parts": rows[:64]}


# -- OCC -------------------------------------------------------------------------------------
def _occ_facts(
    path: str | os.PathLike[str],
    window: Window | None,
    lens_faces: int,
    points: int,
    place: SheetPlace | None = None,
) -> dict[str, Any]:
    """Facts that OCC finds in a file (mm); with a window its sampled lens faces are compared with that."""
    from OCP.ShapeAnalysis import ShapeAnalysis_ShapeTolerance

    from clacad.solid.occ_writer import is_valid, volume_and_area

    several = loaded(path).pieces if place is None else place.of_pieces(loaded(path).pieces)
    solids = [piece for piece in several if piece.solid]
    sizes = [volume_and_area(piece.shape) for piece in solids]
    many = [len(piece.placements) for piece in several]
    faces = sum(len(piece.faces) * k for piece, k in zip(several, many, strict=True))
    if not faces:
        raise UnreadableFile(
            f"{os.fspath(path)}: the CAD kernel finds no face in"
            f" it{'' if place is None else ' where the sheet should be'}; the file is damaged"
        )
    engraved = 0.0 if window is None else engraved_in(several, window)
    tolerance = ShapeAnalysis_ShapeTolerance()
    count = sum(len(piece.placements) for piece in solids)
    facts: dict[str, Any] = {
        "valid": all(is_valid(piece.shape) for piece in solids),
        "kernel_solids": count,
        "kernel_faces": faces,
        "volume": sum(each * len(piece.placements) for (each, _), piece in zip(sizes, solids, strict=True)),
        "area": sum(each * len(piece.placements) for (_, each), piece in zip(sizes, solids, strict=True)),
        "box": whole_box(several),
        "tolerance": max(tolerance.Tolerance(piece.shape, 1) for piece in several),
        "holds": _held(
            count,
            sum(piece.shells * k for piece, k in zip(several, many, strict=True)),
            faces,
            [("", piece.solid, len(piece.faces), k) for piece, k in zip(several, many, strict=True)],
        ),
    }
    facts["holes"] = holes_in(several)
    if window is not None:
        facts |= sampled_lenses(several, window, lens_faces, points) | {"engraved": engraved}
        if any(body.joined for body in window.bodies):
            facts["volumes"] = layer_volumes(solids, [each for each, _ in sizes], window)
    return facts


@dataclass(frozen=True, eq=False)
class Loaded:
    """A file as OCC read it: its shape, and the pieces of that."""

    shape: Any
    pieces: list[ShapePart]


def scanned(path: str | os.PathLike[str]) -> StepScan:
    """Scan of the text of a file; the last one is kept for the next call in this process.

    Raises UnreadableFile: The file is no STEP file.
    """
    return kept(_SCANNED, state_of(path), lambda: scan_step(path))


def kept(last: dict[Key, T], key: Key, make: Callable[[], T]) -> T:
    """What is made for a key; `last` keeps it for the next call, and is emptied before another is made."""
    if key not in last:
        last.clear()
        last[key] = make()
    return last[key]


def state_of(path: str | os.PathLike[str]) -> tuple[str, int, int]:
    """Name, size (bytes) and time of change (ns) of a file: another state, another content."""
    found = os.stat(path)
    return (os.fspath(path), found.st_size, found.st_mtime_ns)


_SCANNED: dict[tuple[str, int, int], StepScan] = {}
_KEPT: dict[tuple[str, int, int], Loaded] = {}


def loaded(path: str | os.PathLike[str]) -> Loaded:
    """Shape of a file as OCC reads it; kept for the next call in this process.

    Raises UnreadableFile: OCC cannot read it.
    """
    return kept(_KEPT, state_of(path), lambda: Loaded(shape := occ_shape(path), pieces(shape)))


def occ_shape(path: str | os.PathLike[str]) -> Any:
    """The shape OCC reads from a STEP file, or from a file of its own named .brep (mm).

    Raises UnreadableFile: OCC cannot read it.
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


def facets(path: str, target: str, deflection: float) -> int:
    """Mesh the solids of a STEP file and write them as binary STL, in millimetres; runs in a worker.

    path, target : The STEP file, and the STL file to write.
    deflection : millimetres. Largest distance of a facet from its face; corners lie on the faces.
    Returns: Bytes written.
    Raises UnreadableFile: The file holds nothing that can be meshed.
    """
    from pathlib import Path

    from OCP.BRepMesh import BRepMesh_IncrementalMesh
    from OCP.StlAPI import StlAPI_Writer

    shape = occ_shape(path)
    BRepMesh_IncrementalMesh(shape, deflection, False, 0.2, True)
    writer = StlAPI_Writer()
    writer.ASCIIMode = False
    writer.Write(shape, target)
    written = Path(target)
    if not written.is_file() or written.stat().st_size <= 84:
        raise UnreadableFile("the file holds no solid that could be meshed")
    return written.stat().st_size


def set_down(path: str, target: str, turn: Sequence[Sequence[float]], move: Sequence[float]) -> int:
    """Write the shape of a STEP file rotated and moved, as BREP in millimetres; runs in a worker.

    path, target : The STEP file, and the BREP file to write.
    turn : (3, 3). Proper rotation.
    move : (3,) millimetres. x becomes turn · x + move.
    Returns: Bytes written.
    """
    from pathlib import Path

    from OCP.BRepTools import BRepTools
    from OCP.gp import gp_Trsf
    from OCP.TopLoc import TopLoc_Location

    pose = gp_Trsf()
    pose.SetValues(*(value for row, at in zip(turn, move, strict=True) for value in (*row, at)))
    BRepTools.Write_s(occ_shape(path).Moved(TopLoc_Location(pose)), target)
    return Path(target).stat().st_size
