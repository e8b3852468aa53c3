"""STL: binary triangles, written and read as a stream.

80 bytes of header, a count, then 50 bytes a facet: normal, three corners (float32), two zero bytes. The
format has no unit; the header contains "unit=mm" and every coordinate is in millimetres.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Protocol

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.formats.mesh.file_mesh import CHUNK, FileMesh, Part
from clacad.storage.errors import FileDisagrees, UnreadableFile
from clacad.storage.reading import Overheard, Spending

FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
HEADER = 80
_BITS = np.dtype([("bits", "<i4", 12), ("attribute", "<i2")])


class FacetStream(Protocol):
    """Properties of a body that can be written: its name, its facet count and its facets."""

    @property
    def name(self) -> str:
        """Name of the body."""

    @property
    def facet_count(self) -> int:
        """Total number of facets that `rows` yields, known beforehand."""

    def rows(self) -> Iterator[Floats]:
        """Corners of facets, (k, 3, 3) at a time, design units."""


def stl_bytes(facet_count: int) -> int:
    """Exact size of a binary STL file."""
    return HEADER + 4 + FACET.itemsize * facet_count


def write_stl(bodies: Iterable[FacetStream], path: Path, scale: float, name: str) -> None:
    """Write bodies into one binary STL file; memory is that of one chunk.

    scale : Millimetres per design unit.
    name : Written to the header with the unit; no time, so equal designs give equal bytes.
    Raises OSError: The disk is full, or a similar error.
    Raises FileDisagrees: A body yielded another number of facets than `facet_count`, or a corner that is no
        number.
    """
    bodies = list(bodies)
    counted = all(
        not getattr(body, "own", False) for body in bodies
    )  # cells that vary are counted as they are made
    count = sum(body.facet_count for body in bodies) if counted else 0
    _refuse_many(count)
    with path.open("wb") as stream:
        stream.write(header(name) + count.to_bytes(4, "little"))
        written = sum(_write_rows(stream, rows, scale) for body in bodies for rows in body.rows())
        if not counted:
            count = sum(body.facet_count for body in bodies)
            _refuse_many(count)
            stream.seek(HEADER)
            stream.write(count.to_bytes(4, "little"))
    if written != count:
        raise FileDisagrees(f"the mesh yielded {written} facets and had promised {count}")


def _refuse_many(count: int) -> None:
    if count >= 1 << 32:
        raise FileDisagrees(f"{count} facets do not fit the 32-bit count of an STL file")


def header(name: str) -> bytes:
    """First 80 bytes of a file: program, unit, name; never begins with "solid", which would mean ASCII."""
    text = re.sub(r"[^ -~]", "?", name)
    return f"clacad unit=mm name={text}".encode("ascii")[:HEADER].ljust(HEADER)


def _write_rows(stream: IO[bytes], rows: Floats, scale: float) -> int:
    for start in range(0, len(rows), CHUNK):
        stream.write(_records(rows[start : start + CHUNK], scale).data.cast("B"))
    return len(rows)


def _records(corners: Floats, scale: float) -> NDArray[np.void]:
    """Records of FACET of facets (k, 3, 3) as written; −0 and 0 are one position and one bit pattern."""
    from clacad.formats.mesh.compiled_measure import facet_numbers

    found = np.zeros(len(corners), dtype=FACET)
    whole = np.ascontiguousarray(corners, dtype=np.float64)
    if not facet_numbers(whole, scale, found["normal"], found["corners"]):
        raise FileDisagrees("the mesh holds a corner that is not a finite float32 number")
    return found


def read_stl(path: Path, heard: Overheard | None = None, checked: bool = False) -> FileMesh:
    """Read an STL file, binary (streamed) or ASCII.

    heard : `Overheard` or None. Receives the bytes as the triangles of a binary file are read.
    checked : Each facet that is read must be as this package writes it, see `check_facets`.
    Raises UnreadableFile: Truncated, too long, contains a corner that is no number, or is not STL. Corners of
        a binary file are checked when they are read, as a slice of its triangles.
    Raises OverBudget: More bytes, facets or seconds than are read.
    Raises FileDisagrees: On reading facets, if `checked`.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(HEADER + 4)
    count = int.from_bytes(head[HEADER:], "little") if len(head) == HEADER + 4 else -1
    if count >= 0 and size == stl_bytes(count):
        return _read_binary(path, head, count, heard, checked)
    if head.lstrip().lower().startswith(b"solid"):
        return _read_ascii(path)
    if count < 0:
        raise UnreadableFile(f"{path.name}: {size} bytes are too few for an STL file")
    raise UnreadableFile(
        f"{path.name}: the file has {size} bytes, but its count of {count} facets needs {stl_bytes(count)}"
    )


def _read_binary(path: Path, head: bytes, count: int, heard: Overheard | None, checked: bool) -> FileMesh:
    name = re.sub(r"[^ -~]", "?", head[:HEADER].decode("latin-1")).strip("? ")
    unit = 1e-3 if "unit=mm" in name else None
    if count == 0:
        return FileMesh("stl-binary", (Part("", soup=np.zeros((0, 3, 3), np.float32)),), unit, name)
    spent = Spending("stl", path)
    spent.count(count)
    if heard is not None:
        heard.hear(0, head)
    return FileMesh("stl-binary", (Part("", soup=BinaryStl(path, count, spent, heard, checked)),), unit, name)


@dataclass(frozen=True, slots=True)
class BinaryStl:
    """The triangles of a binary STL file, read from it on each access; memory is one chunk.

    A mapped file would count in full as memory of this process.
    """

    path: Path
    count: int
    spent: Spending = field(repr=False, compare=False)
    heard: Overheard | None = field(default=None, repr=False, compare=False)
    checked: bool = False

    def __len__(self) -> int:
        """Number of facets."""
        return self.count

    def __getitem__(self, which: slice, /) -> NDArray[np.float32]:
        """Corners (k, 3, 3) of a run of facets.

        Raises UnreadableFile: One of them is not a number, or the file was truncated since.
        Raises OverBudget: Reading the file has so far taken more seconds than allowed.
        Raises FileDisagrees: One is not as this package writes it, and `checked` is set.
        """
        start, stop, step = which.indices(self.count)
        with self.spent.working(f"at facet {start:,}"):
            return self._read(start, stop, step)

    def _read(self, start: int, stop: int, step: int) -> NDArray[np.float32]:
        records = read_facets(self.path, start, stop, self.heard)
        if len(records) != max(0, stop - start):
            raise UnreadableFile(
                f"{self.path.name}: it ends at facet {start + len(records)}, of {self.count}"
            )
        if self.checked:
            check_facets(records, f"{self.path.name}: a facet near number {start}")
            return np.asarray(records["corners"][::step])
        corners = np.asarray(records["corners"][::step])
        with np.errstate(invalid="ignore"):
            total = corners.sum(dtype=np.float64)  # such a sum of float32 is infinite only if one of them is
        if not np.isfinite(total):
            raise UnreadableFile(f"{self.path.name}: a corner near facet {start} is not a number")
        return corners


def read_facets(path: Path, start: int, stop: int, heard: Overheard | None = None) -> NDArray[np.void]:
    """Facets start … stop − 1 of a binary STL file as records of FACET; `heard` receives their bytes."""
    first = HEADER + 4 + start * FACET.itemsize
    with path.open("rb") as stream:
        stream.seek(first)
        block = stream.read(max(0, stop - start) * FACET.itemsize)
    if heard is not None:
        heard.hear(first, block)
    return np.frombuffer(block[: len(block) - len(block) % FACET.itemsize], dtype=FACET)


_NUMBER = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_VERTEX = re.compile(rb"\s*vertex\s+(%s)\s+(%s)\s+(%s)\s*\Z" % ((_NUMBER,) * 3), re.IGNORECASE)


def _read_ascii(path: Path) -> FileMesh:
    """Read an ASCII STL file into memory; its corners are double precision."""
    spent = Spending("stl-ascii", path)
    corners: array[float] = array("d")
    facets = 0
    with path.open("rb") as stream:
        for line in spent.lines(stream):
            word = line.split(None, 1)[0].lower() if line.strip() else b""
            if word == b"vertex":
                match = _VERTEX.match(line)
                if match is None:
                    raise UnreadableFile(f"{path.name}: vertex {len(corners) // 3 + 1} is not three numbers")
                corners.extend((float(match[1]), float(match[2]), float(match[3])))
            elif word == b"endfacet":
                facets += 1
                spent.count(1)
                if len(corners) != 9 * facets:
                    raise UnreadableFile(f"{path.name}: facet {facets} has not three corners")
            elif word not in (b"solid", b"facet", b"outer", b"endloop", b"endsolid", b""):
                raise UnreadableFile(f"{path.name}: an ASCII STL file with a line that is none")
    if len(corners) != 9 * facets or not facets:
        raise UnreadableFile(f"{path.name}: the ASCII STL ends within a facet or holds none")
    with np.errstate(over="ignore"):
        soup = np.frombuffer(corners, dtype=np.float64).astype(np.float32).reshape(-1, 3, 3)
    if not np.isfinite(soup).all():
        raise UnreadableFile(f"{path.name}: a corner of the ASCII STL does not fit a float32 number")
    return FileMesh("stl-ascii", (Part("", soup=soup),), None, "")


def check_facets(records: NDArray[np.void], which: str) -> None:
    """Compare stored normals and attributes of records of FACET with those of their corners; detects a
    flipped bit.

    Raises FileDisagrees: The facets disagree; `which` begins the message.
    """
    from clacad.formats.mesh.compiled_measure import as_written

    bits = records.view(_BITS)
    if not as_written(records["normal"], records["corners"], bits["bits"], bits["attribute"]):
        raise FileDisagrees(f"{which} disagrees with its own normal")
