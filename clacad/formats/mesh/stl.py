"""STL: binary triangles, written and read as a stream.

80 bytes of header, a count, then 50 bytes a facet: normal, three corners (float32), two zero bytes.
The format knows no unit; the header says "unit=mm" and every coordinate is in millimetres.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Protocol

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.formats.mesh.file_mesh import CHUNK, FileMesh, Part
from clacad.storage.errors import FileDisagrees, UnreadableFile

FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
HEADER = 80
LONGEST_ASCII = 1 << 30


class FacetStream(Protocol):
    """What a body must offer to be written: its name, its facet count and its facets."""

    @property
    def name(self) -> str:
        """Name of the body."""

    @property
    def facet_count(self) -> int:
        """Number of facets `rows` yields in all, known beforehand."""

    def rows(self) -> Iterator[Floats]:
        """Corners of facets, (k, 3, 3) at a time, design units."""


def stl_bytes(facet_count: int) -> int:
    """Size of a binary STL file, exactly."""
    return HEADER + 4 + FACET.itemsize * facet_count


def write_stl(bodies: Iterable[FacetStream], path: Path, scale: float, name: str) -> None:
    """Write bodies into one binary STL file; memory is that of one chunk.

    Parameters
    ----------
    bodies : iterable of FacetStream
    path : Path
    scale : float
        Millimetres per design unit.
    name : str
        Goes into the header with the unit; no time, so equal designs give equal bytes.

    Raises
    ------
    OSError
        The disk is full, or the like.
    FileDisagrees
        A body yielded another number of facets than it had promised, or a corner that is no number.
    """
    bodies = list(bodies)
    count = sum(body.facet_count for body in bodies)
    if count >= 1 << 32:
        raise FileDisagrees(f"{count} facets do not fit the 32-bit count of an STL file")
    with path.open("wb") as stream:
        stream.write(header(name) + count.to_bytes(4, "little"))
        written = sum(_write_rows(stream, rows, scale) for body in bodies for rows in body.rows())
    if written != count:
        raise FileDisagrees(f"the mesh yielded {written} facets and had promised {count}")


def header(name: str) -> bytes:
    """First 80 bytes of a file: program, unit, name; never begins with "solid", which would mean ASCII."""
    text = re.sub(r"[^ -~]", "?", name)
    return f"clacad unit=mm name={text}".encode("ascii")[:HEADER].ljust(HEADER)


def _write_rows(stream: IO[bytes], rows: Floats, scale: float) -> int:
    for start in range(0, len(rows), CHUNK):
        corners = rows[start : start + CHUNK]
        block = np.zeros(len(corners), dtype=FACET)
        block["corners"] = corners * scale
        block["corners"] += np.float32(0.0)  # −0 and 0 are one place and must be one bit pattern
        if not np.isfinite(block["corners"]).all():
            raise FileDisagrees("the mesh holds a corner that is not a finite float32 number")
        block["normal"] = facet_normals(block["corners"])
        stream.write(block.tobytes())
    return len(rows)


def facet_normals(corners: NDArray[np.floating]) -> NDArray[np.float32]:
    """Unit normals (k, 3) of the float32 triangles (k, 3, 3) as written; zero where one has no area."""
    corners = corners.astype(np.float64)
    a = corners[:, 1] - corners[:, 0]
    b = corners[:, 2] - corners[:, 0]
    normal = np.empty_like(a)
    normal[:, 0] = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    normal[:, 1] = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    normal[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    length = np.sqrt(normal[:, 0] ** 2 + normal[:, 1] ** 2 + normal[:, 2] ** 2)
    normal /= np.where(length > 0.0, length, 1.0)[:, None]
    return normal.astype(np.float32) + np.float32(0.0)


def read_stl(path: Path) -> FileMesh:
    """Read an STL file, binary (streamed) or ASCII.

    Raises
    ------
    UnreadableFile
        Cut short, too long, holds a corner that is no number, or is not STL.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(HEADER + 4)
    count = int.from_bytes(head[HEADER:], "little") if len(head) == HEADER + 4 else -1
    if count >= 0 and size == stl_bytes(count):
        return _read_binary(path, head, count)
    if head.lstrip().lower().startswith(b"solid"):
        return _read_ascii(path, size)
    if count < 0:
        raise UnreadableFile(f"{path.name}: {size} bytes are too few for an STL file")
    raise UnreadableFile(
        f"{path.name}: the file has {size} bytes, but its count of {count} facets needs {stl_bytes(count)}"
    )


def _read_binary(path: Path, head: bytes, count: int) -> FileMesh:
    name = re.sub(r"[^ -~]", "?", head[:HEADER].decode("latin-1")).strip("? ")
    unit = 1e-3 if "unit=mm" in name else None
    if count == 0:
        return FileMesh("stl-binary", (Part("", soup=np.zeros((0, 3, 3), np.float32)),), unit, name)
    for start in range(0, count, CHUNK):
        if not np.isfinite(read_facets(path, start, start + CHUNK)["corners"]).all():
            raise UnreadableFile(f"{path.name}: a corner near facet {start} is not a number")
    return FileMesh("stl-binary", (Part("", soup=BinaryStl(path, count)),), unit, name)


@dataclass(frozen=True, slots=True)
class BinaryStl:
    """The triangles of a binary STL file, read from it each time they are asked for; memory is one chunk.

    A mapped file would count as memory of this process, all gigabytes of it.
    """

    path: Path
    count: int

    def __len__(self) -> int:
        """Number of facets."""
        return self.count

    def __getitem__(self, which: slice, /) -> NDArray[np.float32]:
        """Corners (k, 3, 3) of a run of facets."""
        start, stop, step = which.indices(self.count)
        return np.asarray(read_facets(self.path, start, stop)["corners"][::step])


def read_facets(path: Path, start: int, stop: int) -> NDArray[np.void]:
    """Facets start … stop − 1 of a binary STL file as records of FACET."""
    with path.open("rb") as stream:
        stream.seek(HEADER + 4 + start * FACET.itemsize)
        return np.frombuffer(stream.read(max(0, stop - start) * FACET.itemsize), dtype=FACET)


_NUMBER = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_VERTEX = re.compile(rb"\s*vertex\s+(%s)\s+(%s)\s+(%s)\s*\Z" % ((_NUMBER,) * 3), re.IGNORECASE)


def _read_ascii(path: Path, size: int) -> FileMesh:
    """Read an ASCII STL file into memory; its corners are double precision."""
    if size > LONGEST_ASCII:
        raise UnreadableFile(
            f"{path.name}: {size} bytes of ASCII STL are more than the {LONGEST_ASCII} allowed"
        )
    corners: list[tuple[float, float, float]] = []
    facets = 0
    with path.open("rb") as stream:
        for line in iter(lambda: stream.readline(1024), b""):
            word = line.split(None, 1)[0].lower() if line.strip() else b""
            if word == b"vertex":
                match = _VERTEX.match(line)
                if match is None:
                    raise UnreadableFile(f"{path.name}: vertex {len(corners) + 1} is not three numbers")
                corners.append((float(match[1]), float(match[2]), float(match[3])))
            elif word == b"endfacet":
                facets += 1
                if len(corners) != 3 * facets:
                    raise UnreadableFile(f"{path.name}: facet {facets} has not three corners")
            elif word not in (b"solid", b"facet", b"outer", b"endloop", b"endsolid", b""):
                raise UnreadableFile(f"{path.name}: an ASCII STL file with a line that is none")
    if len(corners) != 3 * facets or not facets:
        raise UnreadableFile(f"{path.name}: the ASCII STL ends within a facet or holds none")
    with np.errstate(over="ignore"):
        soup = np.array(corners, dtype=np.float32).reshape(-1, 3, 3)
    if not np.isfinite(soup).all():
        raise UnreadableFile(f"{path.name}: a corner of the ASCII STL does not fit a float32 number")
    return FileMesh("stl-ascii", (Part("", soup=soup),), None, "")


def check_stl_facets(path: Path) -> None:
    """Compare each stored normal and attribute with what the corners say; a flipped bit shows here.

    Raises
    ------
    FileDisagrees
    """
    count = (path.stat().st_size - HEADER - 4) // FACET.itemsize
    if count == 0:
        return
    for start in range(0, count, CHUNK):
        block = read_facets(path, start, start + CHUNK)
        told = np.zeros(len(block), dtype=FACET)
        with np.errstate(invalid="ignore"):  # a NaN that a flipped bit made is about to be told
            told["corners"] = block["corners"] + np.float32(0.0)
            told["normal"] = facet_normals(told["corners"])
        if block.tobytes() != told.tobytes():
            raise FileDisagrees(f"{path.name}: a facet near number {start} disagrees with its own normal")
