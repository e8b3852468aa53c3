"""A STEP file as triangles, from which the pose of the part is found; and rewriting of its shape in that
pose.
"""

from __future__ import annotations

from collections.abc import Sequence

from clacad.formats.step.read_back import occ_shape
from clacad.storage.errors import UnreadableFile


def facets(path: str, target: str, deflection: float) -> int:
    """Mesh the solids of a STEP file and write them as binary STL, in millimetres; runs in a worker.

    Parameters
    ----------
    path, target : str
        The STEP file, and the STL file to write.
    deflection : float, millimetres
        Largest distance of a facet from its face; corners lie on the faces.

    Returns
    -------
    int
        Bytes written.

    Raises
    ------
    UnreadableFile
        The file holds nothing that can be meshed.
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

    Parameters
    ----------
    path, target : str
        The STEP file, and the BREP file to write.
    turn : (3, 3)
        Proper rotation.
    move : (3,) millimetres
        x becomes turn · x + move.

    Returns
    -------
    int
        Bytes written.
    """
    from pathlib import Path

    from OCP.BRepTools import BRepTools
    from OCP.gp import gp_Trsf
    from OCP.TopLoc import TopLoc_Location

    pose = gp_Trsf()
    pose.SetValues(*(value for row, at in zip(turn, move, strict=True) for value in (*row, at)))
    BRepTools.Write_s(occ_shape(path).Moved(TopLoc_Location(pose)), target)
    return Path(target).stat().st_size
