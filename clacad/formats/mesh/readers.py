"""Reader of mesh files of any known format, identified by content and not by name.

A mesh file as an object of a scene: y up, on the origin, scaled to the specified height.

OBJ: read only, because machine shops return it. Triangles and polygons that fan from a corner.
"""

from __future__ import annotations

import os
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.formats.mesh.file_mesh import FileMesh, Part
from clacad.storage.errors import OverBudget, UnreadableFile
from clacad.storage.reading import Overheard, Spending


def read_mesh(path: str | os.PathLike[str], heard: Overheard | None = None) -> FileMesh:
    """Read STL (binary or ASCII), 3MF, PLY, GLB or OBJ.

    heard : `Overheard` or None
        Receives the bytes of a format that is read as a stream, where the caller also needs its hash.
    Returns: Coordinates in the file's unit; its `chunks` yield corners without holding them all. Those of a
        binary STL file are read, and may raise UnreadableFile, only then.
    Raises UnreadableFile: Not one of these, damaged, or built to harm its reader. No other error is raised
        for any content.
    Raises OverBudget: A kind of UnreadableFile: more bytes, items or seconds than its reader accepts, or more
        memory than is free.
    Raises FileNotFoundError.
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
        return read_obj
    from clacad.formats.mesh.stl import read_stl

    if suffix in (".3mf", ".glb", ".ply"):
        raise UnreadableFile(f"the file does not begin as a {suffix[1:].upper()} file does")
    return partial(read_stl, heard=heard)


def standing_corners(path: str | os.PathLike[str], up: str, height: float) -> Floats:
    """Corners (t, 3, 3) of a mesh, foot at the origin, y up, as high as `height`.

    up : "y" or "z", the axis of the file that points up
    Raises UnreadableFile: It is no mesh, or damaged.
    """
    corners = np.concatenate([np.zeros((0, 3, 3)), *read_mesh(path).chunks()])
    if up == "z":  # x stays, the file's y points away from the viewer
        corners = np.stack([corners[..., 0], corners[..., 2], -corners[..., 1]], axis=-1)
    if not len(corners):
        return corners
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    foot = np.array([0.5 * (low[0] + high[0]), low[1], 0.5 * (low[2] + high[2])])
    tall = high[1] - low[1]
    return np.asarray((corners - foot) * (height / tall if tall > 0.0 else 1.0))


_GROUP = 10
"""Memory of a group, in vertices."""
_IGNORED = {b"vt", b"vp", b"g", b"s", b"usemtl", b"mtllib", b"l", b"p"}
Corner = tuple[int, int]


@dataclass
class _Found:
    """Data read so far: x, y, z of vertices and normals; names of groups and six numbers a triangle."""

    vertices: array[float] = field(default_factory=lambda: array("d"))
    normals: array[float] = field(default_factory=lambda: array("d"))
    groups: list[tuple[str, array[int]]] = field(default_factory=lambda: [("", array("q"))])


def read_obj(path: Path) -> FileMesh:
    """Read an OBJ file; each `o` statement begins a part.

    Raises UnreadableFile.
    Raises OverBudget: More bytes, vertices, triangles or seconds than are read.
    """
    spent, found = Spending("obj", path), _Found()
    with path.open("rb") as stream:
        for number, line in enumerate(spent.lines(stream), 1):
            words = line.split(b"#", 1)[0].split()
            if not words or words[0] in _IGNORED:
                continue
            try:
                _take(spent, found, words)
            except (ValueError, IndexError, OverflowError) as error:
                if isinstance(error, UnreadableFile):
                    raise
                raise UnreadableFile(f"{path.name}: line {number} is not OBJ that is read") from error
    return _checked(path, found)


def _take(spent: Spending, found: _Found, words: list[bytes]) -> None:
    """Store one statement; ValueError or IndexError where its content is malformed."""
    if words[0] in (b"v", b"vn"):
        spent.count(1)
        kept = found.vertices if words[0] == b"v" else found.normals
        if len(words) < 4:
            raise UnreadableFile(
                f"{spent.name}: vertex or normal {len(kept) // 3 + 1} has not three coordinates"
            )
        kept.extend((float(words[1]), float(words[2]), float(words[3])))
    elif words[0] == b"o":
        spent.count(_GROUP)
        found.groups.append((b" ".join(words[1:])[:200].decode("utf-8", "replace"), array("q")))
    elif words[0] == b"f":
        spent.count(max(1, len(words) - 3))
        many = len(found.vertices) // 3, len(found.normals) // 3
        corners = [_corner(w, *many) for w in words[1:]]
        for k in range(1, len(corners) - 1):
            found.groups[-1][1].extend((*corners[0], *corners[k], *corners[k + 1]))
    else:
        raise ValueError(words[0])


def _corner(word: bytes, vertices: int, normals: int) -> Corner:
    """Zero-based (vertex, normal) of one corner, −1 where it has no normal; negative numbers count back."""
    fields = word.split(b"/")
    v = int(fields[0])
    n = int(fields[2]) if len(fields) == 3 and fields[2] else 0
    vertex = v - 1 if v > 0 else vertices + v
    normal = n - 1 if n > 0 else (normals + n if n < 0 else -1)
    if v == 0 or not 0 <= vertex < vertices or not -1 <= normal < normals:
        raise ValueError(word)
    return vertex, normal


def _checked(path: Path, found: _Found) -> FileMesh:
    groups = [(name, np.frombuffer(faces, dtype=np.int64)) for name, faces in found.groups if faces]
    if not groups:
        raise UnreadableFile(f"{path.name}: no faces")
    position, direction = (np.array(of).reshape(-1, 3) for of in (found.vertices, found.normals))
    if not np.isfinite(position).all() or not np.isfinite(direction).all():
        raise UnreadableFile(f"{path.name}: a vertex that is not a number")
    return FileMesh("obj", tuple(_part(name, faces, position, direction) for name, faces in groups))


def _part(name: str, faces: Ints, position: Floats, direction: Floats) -> Part:
    """Give each pair (vertex, normal) a separate row, so that a sharp edge keeps two normals."""
    pairs, index = np.unique(faces.reshape(-1, 2), axis=0, return_inverse=True)
    kept = direction[pairs[:, 1]] if len(direction) and (pairs[:, 1] >= 0).all() else None
    return Part(name, position[pairs[:, 0]], index.reshape(-1, 3), normals=kept)
