"""PLY: indexed triangles with exact vertex normals, binary, double precision."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.formats.mesh.file_mesh import CHUNK, FileMesh, Part
from clacad.formats.mesh.repeated_pieces import Piece
from clacad.storage.errors import UnreadableFile
from clacad.storage.reading import Spending

_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_LONGEST_HEADER = 1 << 16
_LONGEST_WORD = 1000
_BLOCK = 1 << 20
FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def ply_bytes(vertices: int, facets: int, header: int = 0) -> int:
    """Size of a file with this many vertices and facets, without its header unless that is given."""
    return header + 48 * vertices + FACE.itemsize * facets


def write_ply(pieces: Sequence[Piece], path: Path, scale: float, name: str) -> None:
    """Write pieces into one binary little-endian PLY file, instances expanded.

    Parameters and errors: see `clacad.formats.mesh.glb.write_glb`; `scale` is in millimetres per design unit.
    """
    vertices = sum(len(piece.vertices) * piece.count for piece in pieces)
    facets = sum(len(piece.triangles) * piece.count for piece in pieces)
    with path.open("wb") as stream:
        stream.write(_header(name, vertices, facets))
        for piece in pieces:
            for centre in _centres(piece):
                _write_vertices(stream, piece, centre, scale)
        first = 0
        for piece in pieces:
            for _ in range(piece.count):
                _write_faces(stream, piece.triangles, first)
                first += len(piece.vertices)


def _header(name: str, vertices: int, facets: int) -> bytes:
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "comment clacad unit=mm",
        "comment name=" + re.sub(r"[^ -~]", "?", name)[:200],
        f"element vertex {vertices}",
        *(f"property double {p}" for p in ("x", "y", "z", "nx", "ny", "nz")),
        f"element face {facets}",
        "property list uchar int vertex_indices",
        "end_header",
        "",
    ]
    return "\n".join(lines).encode("ascii")


def _centres(piece: Piece) -> Floats:
    return np.zeros((1, 3)) if piece.places is None else piece.places.centres()


def _write_vertices(stream: IO[bytes], piece: Piece, centre: Floats, scale: float) -> None:
    block = np.concatenate(piece.sound(scale, centre), axis=1)
    stream.write(np.ascontiguousarray(block, dtype="<f8").tobytes())


def _write_faces(stream: IO[bytes], triangles: Ints, first: int) -> None:
    for start in range(0, len(triangles), CHUNK):
        corners = triangles[start : start + CHUNK]
        block = np.empty(len(corners), dtype=FACE)
        block["count"] = 3
        block["corners"] = corners + first
        stream.write(block.tobytes())


# -- reading -----------------------------------------------------------------------------------


@dataclass
class _Element:
    name: str
    count: int
    scalars: list[tuple[str, str]]
    lists: list[tuple[str, str, str]]
    before: int = 0  # plain numbers before the list in each row


def read_ply(path: Path) -> FileMesh:
    """Read a PLY file of triangles: ASCII or binary, with or without normals; other numbers of a face are
    skipped.

    Raises
    ------
    UnreadableFile
    OverBudget
        More bytes, numbers or seconds than are read.
    """
    data = np.memmap(path, dtype=np.uint8, mode="r") if path.stat().st_size else np.zeros(0, np.uint8)
    head = bytes(data[:_LONGEST_HEADER])
    end = re.search(rb"\nend_header\r?\n", head)
    if not re.match(rb"ply\r?\n", head) or end is None:
        raise UnreadableFile(f"{path.name}: not a PLY file (no header)")
    lines = head[: end.start()].decode("latin-1").splitlines()
    form, elements, comments = _parsed_header(path, lines)
    by_name = {element.name: element for element in elements}
    if [e.name for e in elements][:2] != ["vertex", "face"] or len(elements) != 2:
        raise UnreadableFile(f"{path.name}: its elements are {sorted(by_name)}; vertex and face are read")
    if elements[0].lists or len(elements[1].lists) != 1:
        raise UnreadableFile(f"{path.name}: faces must have one list and vertices plain numbers")
    vertex, face = elements
    columns = _columns(path, vertex)
    body = data[end.end() :]
    if form == "ascii":
        vertices, triangles = _ascii_body(Spending("ply-ascii", path), body, vertex, face)
        vertices = vertices[:, [[name for name, _ in vertex.scalars].index(name) for name in columns]]
    else:
        Spending("ply", path).count(vertex.count + face.count)
        rows, triangles = _binary_body(path, body, "<" if "little" in form else ">", vertex, face)
        vertices = np.stack([rows[name].astype(np.float64) for name in columns], axis=1)
    return _checked(path, vertices, triangles, comments)


def _columns(path: Path, vertex: _Element) -> list[str]:
    """Names of the kept numbers of a vertex: its position, and its normal if it has one."""
    names = {name for name, _ in vertex.scalars}
    if not {"x", "y", "z"} <= names:
        raise UnreadableFile(f"{path.name}: vertices have no x, y, z")
    return ["x", "y", "z", *(("nx", "ny", "nz") if {"nx", "ny", "nz"} <= names else ())]


def _parsed_header(path: Path, lines: list[str]) -> tuple[str, list[_Element], str]:
    """Format of the data, elements in order, and the comments."""
    form, comments = "", ""
    elements: list[_Element] = []
    for line in lines[1:]:
        words = line.split()
        try:
            if not words:
                continue
            if words[0] in ("comment", "obj_info"):
                comments += " " + line
            elif words[0] == "format":
                form = words[1]
            elif words[0] == "element":
                elements.append(_Element(words[1], int(words[2]), [], []))
            elif words[:2] == ["property", "list"]:
                elements[-1].lists.append((words[4], _TYPES[words[2]], _TYPES[words[3]]))
                elements[-1].before = len(elements[-1].scalars)
            elif words[0] == "property":
                elements[-1].scalars.append((words[2], _TYPES[words[1]]))
            else:
                raise KeyError(words[0])
        except (IndexError, KeyError, ValueError) as error:
            raise UnreadableFile(f"{path.name}: a header line that is not PLY: {line[:80]!r}") from error
    if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise UnreadableFile(f"{path.name}: unknown PLY format {form!r}")
    for e in elements:
        names = [name for name, *_ in (*e.scalars, *e.lists)]
        if len(set(names)) < len(names):
            raise UnreadableFile(f"{path.name}: its element {e.name!r} has a property twice")
    if any(e.count < 0 or e.count > 1 << 31 for e in elements):
        raise UnreadableFile(f"{path.name}: an element count out of range")
    return form, elements, comments


def _binary_body(
    path: Path, body: NDArray[np.uint8], order: str, vertex: _Element, face: _Element
) -> tuple[NDArray[np.void], Ints]:
    """Vertices (v,) as records and corners of facets (t, 3) of a binary file."""
    row = np.dtype([(name, order + kind) for name, kind in vertex.scalars])
    _, count_kind, index_kind = face.lists[0]
    fields: list[Any] = [(f"scalar {k}", order + kind) for k, (_, kind) in enumerate(face.scalars)]
    fields[face.before : face.before] = [("count", order + count_kind), ("corners", order + index_kind, 3)]
    triangle = np.dtype(fields)
    need = row.itemsize * vertex.count + triangle.itemsize * face.count
    if need != len(body):
        raise UnreadableFile(
            f"{path.name}: holds {len(body)} bytes of data; its header promises {need} for triangles"
        )
    rows = np.frombuffer(body, dtype=row, count=vertex.count)
    faces = np.frombuffer(body, dtype=triangle, count=face.count, offset=row.itemsize * vertex.count)
    if (faces["count"] != 3).any():
        raise UnreadableFile(f"{path.name}: a face that is not a triangle")
    return rows, np.asarray(faces["corners"], dtype=np.int64)


def _ascii_body(
    spent: Spending, body: NDArray[np.uint8], vertex: _Element, face: _Element
) -> tuple[Floats, Ints]:
    """All numbers of the vertices (v, k) and corners of facets (t, 3) of an ASCII file."""
    width, row = len(vertex.scalars), 4 + len(face.scalars)
    promised = width * vertex.count + row * face.count
    spent.count(promised)
    numbers = np.concatenate([np.zeros(0), *_words(spent, body, promised)])
    if len(numbers) != promised:
        raise UnreadableFile(
            f"{spent.name}: {len(numbers)} numbers are not what its header promises for triangles"
        )
    faces = numbers[width * vertex.count :].reshape(-1, row)[:, face.before : face.before + 4]
    if (faces[:, 0] != 3).any() or not (np.abs(faces) < 1 << 31).all():
        raise UnreadableFile(f"{spent.name}: a face that is not a triangle")
    return numbers[: width * vertex.count].reshape(-1, width), faces[:, 1:].astype(np.int64)


def _words(spent: Spending, body: NDArray[np.uint8], most: int) -> Iterator[Floats]:
    """Numbers of a text, a block at a time, until there are more than `most`; a block's end may cut a
    word.
    """
    found, rest = 0, b""
    for start in range(0, len(body), _BLOCK):
        spent.look(f"at byte {start:,} of its data")
        text = rest + bytes(body[start : start + _BLOCK])
        ended = start + _BLOCK >= len(body) or text[-1:].isspace()
        words = text.split()
        rest = b"" if ended or not words else words.pop()
        if len(rest) > _LONGEST_WORD:
            raise UnreadableFile(f"{spent.name}: a word in the data that is no number")
        try:
            numbers = np.array(words, dtype=np.float64)
        except ValueError as error:
            raise UnreadableFile(f"{spent.name}: a word in the data that is no number") from error
        yield numbers
        found += len(numbers)
        if found > most:
            return


def _checked(path: Path, values: Floats, triangles: Ints, comments: str) -> FileMesh:
    """The mesh of vertices (v, 3), or (v, 6) with their normals."""
    position = np.ascontiguousarray(values[:, :3])
    normals = np.ascontiguousarray(values[:, 3:]) if values.shape[1] == 6 else None
    if not np.isfinite(position).all() or (normals is not None and not np.isfinite(normals).all()):
        raise UnreadableFile(f"{path.name}: a vertex that is not a number")
    if len(triangles) == 0 or triangles.min() < 0 or triangles.max() >= len(position):
        raise UnreadableFile(f"{path.name}: no triangle, or one that uses a vertex that is not there")
    unit = 1e-3 if "unit=mm" in comments else None
    return FileMesh("ply", (Part("", position, triangles, normals=normals),), unit, _name_in(comments))


def _name_in(comments: str) -> str:
    match = re.search(r"comment name=(.*?)(?: comment |$)", comments)
    return match[1].strip() if match else ""
