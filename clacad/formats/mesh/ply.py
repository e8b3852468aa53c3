"""PLY: indexed triangles with exact vertex normals; written binary in double precision, read by trimesh.

trimesh reads an untrusted file in a worker process, with a header rewritten from the checked one: it accepts
damaged headers, cut rows and words that are not numbers.
"""

from __future__ import annotations

import re
import shutil
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np

from clacad.base.types import Ints
from clacad.formats.mesh.file_mesh import CHUNK, NO_VERTEX, FileMesh, FileRows, Part, Table, fault_of, rows_of
from clacad.formats.placements import Piece
from clacad.storage.atomic import scratch_folder
from clacad.storage.errors import OverBudget, UnreadableFile, WorkerDied
from clacad.storage.reading import Spending
from clacad.storage.worker import limited_worker, longest_wait

_TYPES = frozenset(
    (
        "char uchar short ushort int uint float double int8 uint8 int16 uint16 int32 uint32 float32 float64"
    ).split()
)
_LONGEST_HEADER = 1 << 16
FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def ply_bytes(vertices: int, facets: int, header: int = 0) -> int:
    """Size of a file with this many vertices and facets, without its header unless that is given."""
    return header + 48 * vertices + FACE.itemsize * facets


def write_ply(pieces: Sequence[Piece], path: Path, scale: float, name: str) -> None:
    """Write pieces into one binary little-endian PLY file, instances expanded.

    Parameters and errors: see `clacad.formats.mesh.glb.write_glb`; `scale` is in millimetres per design unit.
    """
    vertices = facets = 0
    with TemporaryFile(dir=path.parent) as rows, TemporaryFile(dir=path.parent) as faces:
        for piece in pieces:
            for centre in np.zeros((1, 3)) if piece.places is None else piece.places.centres():
                first = vertices
                for block in piece.blocks():
                    row = np.concatenate(block.sound(piece.name, scale, centre), axis=1)
                    rows.write(np.ascontiguousarray(row, dtype="<f8").tobytes())
                    _write_faces(faces, block.triangles, first)
                    vertices, facets = vertices + len(row), facets + len(block.triangles)
        with path.open("wb") as stream:
            stream.write(_header(name, vertices, facets))
            for part in (rows, faces):
                part.seek(0)
                shutil.copyfileobj(part, stream)


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
    """Read a PLY file: ASCII or binary of either byte order, with or without normals.

    Polygons are divided into triangles; other numbers of a vertex or face are skipped.

    Raises UnreadableFile.
    Raises OverBudget: More bytes, numbers, seconds or memory than are read.
    """
    with path.open("rb") as stream:
        head = stream.read(_LONGEST_HEADER)
    end = re.search(rb"\nend_header\r?\n", head)
    if not re.match(rb"ply\r?\n", head) or end is None:
        raise UnreadableFile(f"{path.name}: not a PLY file (no header)")
    form, elements, comments = _parsed_header(path, head[: end.start()].decode("latin-1").splitlines())
    names = [element.name for element in elements]
    if names != ["vertex", "face"]:
        raise UnreadableFile(f"{path.name}: its elements are {sorted(set(names))}; vertex and face are read")
    if elements[0].lists or len(elements[1].lists) != 1:
        raise UnreadableFile(f"{path.name}: faces must have one list and vertices plain numbers")
    vertex, face = elements
    columns = _columns(path, vertex)
    if form == "ascii":
        spent = Spending("ply-ascii", path)
        spent.count(len(vertex.scalars) * vertex.count + (4 + len(face.scalars)) * face.count)
    else:
        spent = Spending("ply", path)
        spent.count(vertex.count + face.count)
    plain = _own_rows(path, end.end(), form, vertex, face)
    if plain is not None:
        with spent.working():
            return _checked(path, *plain, comments)
    header = _plain_header(form, vertex, face, columns)
    with scratch_folder(path) as folder, limited_worker(spent) as worker:
        try:
            worker.run(
                f"{__name__}:load", path, end.end(), header, spent, folder, timeout=longest_wait(spent)
            )
        except WorkerDied as error:
            raise (OverBudget if error.over_budget else UnreadableFile)(f"{path.name}: {error}") from error
        values, triangles = (np.load(folder / f"{name}.npy") for name in ("vertices", "triangles"))
    if len(values) != vertex.count:
        raise UnreadableFile(f"{path.name}: {len(values)} vertices; its header promises {vertex.count}")
    normals = np.ascontiguousarray(values[:, 3:]) if values.shape[1] == 6 else None
    return _checked(path, np.ascontiguousarray(values[:, :3]), triangles, normals, comments)


def _own_rows(
    path: Path, start: int, form: str, vertex: _Element, face: _Element
) -> tuple[Table, Table, Table | None] | None:
    """Vertices, triangles and normals of a file in the form that `write_ply` writes; None: another form.

    start : byte after the header
    """
    names = [("x", "y", "z"), ("x", "y", "z", "nx", "ny", "nz")]
    kinds = {kind for _, kind in vertex.scalars}
    doubles = tuple(name for name, _ in vertex.scalars) in names and kinds <= {"double", "float64"}
    listed = face.lists[0][1:] in (("uchar", "int"), ("uint8", "int32")) and not face.scalars
    if form != "binary_little_endian" or not doubles or not listed:
        return None
    columns = [("position", "<f8", (3,)), ("normal", "<f8", (3,))][: len(vertex.scalars) // 3]
    row = np.dtype(columns)
    faces = FileRows(path, start + vertex.count * row.itemsize, FACE, face.count)
    if path.stat().st_size != faces.start + face.count * FACE.itemsize:
        return None
    if any((faces[first : first + CHUNK]["count"] != 3).any() for first in range(0, face.count, CHUNK)):
        return None
    vertices = (rows_of(FileRows(path, start, row, vertex.count, name)) for name, *_ in columns)
    position, normals = (*vertices, None)[:2]
    assert position is not None
    return position, rows_of(replace(faces, column="corners")), normals


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
            elif words[:2] == ["property", "list"] and {*words[2:4]} <= _TYPES:
                elements[-1].lists.append((words[4], words[2], words[3]))
                elements[-1].before = len(elements[-1].scalars)
            elif words[0] == "property" and words[1] in _TYPES:
                elements[-1].scalars.append((words[2], words[1]))
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


def _plain_header(form: str, vertex: _Element, face: _Element, columns: Sequence[str]) -> bytes:
    """Header for trimesh: known names only, so that it finds neither colours, textures nor file names."""
    ascii = form == "ascii"
    rows = [
        (name if name in columns else f"unused{k}", kind) for k, (name, kind) in enumerate(vertex.scalars)
    ]
    listed = " ".join(("int64", "int64") if ascii else face.lists[0][1:])
    faces = [f"{'double' if ascii else kind} unused{k}" for k, (_, kind) in enumerate(face.scalars)]
    faces[face.before : face.before] = [f"list {listed} vertex_indices"]
    lines = [
        "ply",
        f"format {form} 1.0",
        f"element vertex {vertex.count}",
        *(f"property {'double' if ascii else kind} {name}" for name, kind in rows),
        f"element face {face.count}",
        *(f"property {one}" for one in faces),
        "end_header",
        "",
    ]
    return "\n".join(lines).encode("ascii")


def load(path: Path, start: int, header: bytes, spent: Spending, folder: Path) -> None:
    """Read, in the worker, the data from byte `start` on; save vertices and triangles in `folder`."""
    from trimesh.exchange.ply import load_ply
    from trimesh.geometry import triangulate_quads

    source = BytesIO()
    source.write(header)
    ascii = b"\nformat ascii" in header
    with path.open("rb") as stream, spent.working(), warnings.catch_warnings():
        stream.seek(start)
        shutil.copyfileobj(stream, source)
        source.seek(0)
        warnings.simplefilter("error", DeprecationWarning)  # numpy reports words that are not numbers
        warnings.simplefilter("error", RuntimeWarning)  # and numbers that do not fit their type
        try:
            found = load_ply(source, skip_materials=True)
            elements = found["metadata"]["_ply_raw"]
            _check_rows(spent.name, elements, source.getvalue()[len(header) :] if ascii else b"")
            triangles = np.asarray(triangulate_quads(found["faces"]), dtype=np.int64)
            kept = [found["vertices"], *([found["vertex_normals"]] if "vertex_normals" in found else [])]
            vertices = np.concatenate(kept, axis=1, dtype=np.float64)
        except (UnreadableFile, MemoryError):
            raise
        except Exception as error:  # the loader documents no type
            raise UnreadableFile(f"{spent.name}: its data are not those of its header ({error})") from error
    np.save(folder / "vertices.npy", vertices)
    np.save(folder / "triangles.npy", triangles)


def _check_rows(name: str, elements: Mapping[str, Any], text: bytes) -> None:
    """Check what trimesh skips: corner counts, and words of an ASCII text that belong to no row."""
    listed = elements["face"]["data"]["vertex_indices"]
    if not text:
        stated, read = listed["f0"], np.full(len(listed), listed["f1"].shape[1])
    else:
        read = np.array([len(one) for one in listed])
        before = [*elements["face"]["properties"]].index("vertex_indices")
        pattern = re.compile(rb"^[ \t]*(?:\S+[ \t]+){%d}(\S+)" % before, re.MULTILINE)
        ends = np.flatnonzero(np.frombuffer(text, dtype=np.uint8) == ord("\n"))
        faces = int(ends[elements["vertex"]["length"] - 1]) + 1
        stated = np.array([int(found[1]) for found in pattern.finditer(text, faces)])
        rows = [len(element["properties"]) * element["length"] for element in elements.values()]
        blank = np.frombuffer(text, dtype=np.uint8) <= ord(" ")
        words = int(np.count_nonzero(~blank[1:] & blank[:-1])) + int(not blank[0])
        if words != sum(rows) + read.sum():
            raise UnreadableFile(f"{name}: {words} numbers; its header promises {sum(rows) + read.sum()}")
    if not np.array_equal(stated, read) or read.min() < 3:
        raise UnreadableFile(f"{name}: a face has more or fewer corners than it states, or fewer than 3")


def _checked(path: Path, vertices: Table, triangles: Table, normals: Table | None, comments: str) -> FileMesh:
    """The mesh of vertices (v, 3), triangles (t, 3) and normals (v, 3)."""
    why = fault_of(vertices, triangles, normals)
    if why == NO_VERTEX or len(triangles) == 0:
        raise UnreadableFile(f"{path.name}: no triangle, or one that uses a vertex that is not there")
    if why is not None:
        raise UnreadableFile(f"{path.name}: {why}")
    unit = 1e-3 if "unit=mm" in comments else None
    return FileMesh("ply", (Part("", vertices, triangles, normals=normals),), unit, _name_in(comments))


def _name_in(comments: str) -> str:
    match = re.search(r"comment name=(.*?)(?: comment |$)", comments)
    return match[1].strip() if match else ""
