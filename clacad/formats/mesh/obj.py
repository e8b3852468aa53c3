"""OBJ: read only, because machine shops send it back. Triangles and polygons that fan from a corner."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clacad.base.types import Floats
from clacad.formats.mesh.file_mesh import FileMesh, Part
from clacad.storage.errors import UnreadableFile

LONGEST = 1 << 30
_IGNORED = {b"vt", b"vp", b"g", b"s", b"usemtl", b"mtllib", b"l", b"p"}
Corner = tuple[int, int]


def read_obj(path: Path) -> FileMesh:
    """Read an OBJ file; each `o` statement begins a part.

    Raises
    ------
    UnreadableFile
    """
    if path.stat().st_size > LONGEST:
        raise UnreadableFile(f"{path.name}: more than {LONGEST} bytes of OBJ")
    vertices: list[tuple[float, ...]] = []
    normals: list[tuple[float, ...]] = []
    groups: list[tuple[str, list[tuple[Corner, Corner, Corner]]]] = [("", [])]
    with path.open("rb") as stream:
        for number, line in enumerate(iter(lambda: stream.readline(1 << 16), b""), 1):
            words = line.split(b"#", 1)[0].split()
            try:
                if not words or words[0] in _IGNORED:
                    continue
                if words[0] in (b"v", b"vn"):
                    (vertices if words[0] == b"v" else normals).append(tuple(float(w) for w in words[1:4]))
                elif words[0] == b"o":
                    groups.append((b" ".join(words[1:]).decode("utf-8", "replace"), []))
                elif words[0] == b"f":
                    corners = [_corner(w, len(vertices), len(normals)) for w in words[1:]]
                    groups[-1][1].extend(
                        (corners[0], corners[k], corners[k + 1]) for k in range(1, len(corners) - 1)
                    )
                else:
                    raise ValueError
            except (ValueError, IndexError) as error:
                raise UnreadableFile(f"{path.name}: line {number} is not OBJ that is read") from error
    return _checked(path, vertices, normals, [g for g in groups if g[1]])


def _corner(word: bytes, vertices: int, normals: int) -> Corner:
    """Zero-based (vertex, normal) of one corner; normal −1 where there is none. Negative numbers count back."""
    fields = word.split(b"/")
    v = int(fields[0])
    n = int(fields[2]) if len(fields) == 3 and fields[2] else 0
    vertex = v - 1 if v > 0 else vertices + v
    normal = n - 1 if n > 0 else (normals + n if n < 0 else -1)
    if v == 0 or not 0 <= vertex < vertices or not -1 <= normal < normals:
        raise ValueError(word)
    return vertex, normal


def _checked(path: Path, vertices: list[tuple[float, ...]], normals: list[tuple[float, ...]],
             groups: list[tuple[str, list[tuple[Corner, Corner, Corner]]]]) -> FileMesh:  # fmt: skip
    if not groups or any(len(v) != 3 for v in vertices) or any(len(n) != 3 for n in normals):
        raise UnreadableFile(f"{path.name}: no faces, or a vertex without three coordinates")
    position, direction = np.array(vertices), np.array(normals).reshape(-1, 3)
    if not np.isfinite(position).all() or not np.isfinite(direction).all():
        raise UnreadableFile(f"{path.name}: a vertex that is not a number")
    return FileMesh("obj", tuple(_part(name, faces, position, direction) for name, faces in groups))


def _part(name: str, faces: list[tuple[Corner, Corner, Corner]], position: Floats, direction: Floats) -> Part:
    """Give each pair (vertex, normal) a row of its own, so that a sharp edge keeps two normals."""
    pairs, index = np.unique(np.array(faces).reshape(-1, 2), axis=0, return_inverse=True)
    kept = direction[pairs[:, 1]] if len(direction) and (pairs[:, 1] >= 0).all() else None
    return Part(name, position[pairs[:, 0]], index.reshape(-1, 3), normals=kept)
