"""Reader of mesh files of any known format, identified by content and not by name."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

from clacad.formats.mesh.file_mesh import FileMesh
from clacad.storage.errors import OverBudget, UnreadableFile
from clacad.storage.overheard import Overheard


def read_mesh(path: str | os.PathLike[str], heard: Overheard | None = None) -> FileMesh:
    """Read STL (binary or ASCII), 3MF, PLY, GLB or OBJ.

    Parameters
    ----------
    path : path
    heard : `Overheard` or None
        Receives the bytes of a format that is read as a stream, where the caller also needs its hash.

    Returns
    -------
    FileMesh
        Coordinates in the file's unit; its `chunks` yield corners without holding them all. Those of a binary
        STL file are read, and may raise UnreadableFile, only then.

    Raises
    ------
    UnreadableFile
        Not one of these, damaged, or built to harm its reader. No other error is raised for any content.
    OverBudget
        A kind of UnreadableFile: more bytes, items or seconds than its reader accepts, or more memory than is
        free.
    FileNotFoundError
    """
    path = Path(path)
    with path.open("rb") as stream:
        head = stream.read(512)
    try:
        found = _reader(head, path.suffix.lower(), heard)(path)
    except (MemoryError, OverflowError) as error:
        raise OverBudget(f"{path.name}: too large to be read here") from error
    if found.facet_count == 0:
        raise UnreadableFile(f"{path.name} holds no triangles")
    return found


def _reader(head: bytes, suffix: str, heard: Overheard | None) -> Callable[[Path], FileMesh]:
    """Choose by the first bytes; STL has no signature, so its suffix or its arithmetic decides last."""
    if head.startswith(b"PK\x03\x04"):
        from clacad.formats.mesh.threemf import read_threemf

        return read_threemf
    if head.startswith(b"glTF"):
        from clacad.formats.mesh.glb import read_glb

        return read_glb
    if head.startswith((b"ply\n", b"ply\r\n")):
        from clacad.formats.mesh.ply import read_ply

        return read_ply
    if suffix == ".obj":
        from clacad.formats.mesh.obj import read_obj

        return read_obj
    from clacad.formats.mesh.stl import read_stl

    if suffix in (".3mf", ".glb", ".ply"):
        raise UnreadableFile(f"the file does not begin as a {suffix[1:].upper()} file does")
    return partial(read_stl, heard=heard)
