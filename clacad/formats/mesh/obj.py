"""OBJ: read only, because machine shops return it. Triangles and polygons that fan from a corner."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.formats.mesh.file_mesh import FileMesh, Part
from clacad.storage.errors import UnreadableFile
from clacad.storage.spending import Spending

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

    Raises
    ------
    UnreadableFile
    OverBudget
        More bytes, vertices, triangles or seconds than are read.
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
    """Zero-based (vertex, normal) of one corner; normal −1 where there is none.

    Negative numbers count back.
    """
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
