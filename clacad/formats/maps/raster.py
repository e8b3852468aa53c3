"""Numeric images: TIFF with 16-bit or float pixels and PNG with 16-bit pixels, row by row.

Only the features that height maps need are written: one plane, uncompressed TIFF in one strip, PNG without
filters. Rows come from an iterator, so a map of any size needs the memory of a few rows.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from clacad.storage.errors import FileDisagrees, UnreadableFile
from clacad.storage.reading import Spending

Pixels = NDArray[np.uint16] | NDArray[np.float32]
Rows = TypeVar("Rows", NDArray[np.uint16], NDArray[np.float32], Pixels)
LARGEST_TIFF = (1 << 32) - (1 << 12)
_SHORT, _LONG, _RATIONAL, _ASCII = 3, 4, 5, 2


def write_tiff(
    rows: Iterable[Pixels],
    path: Path,
    width: int,
    height: int,
    bits: int,
    pixels_per_cm: float,
    description: str,
) -> None:
    """Write blocks of rows (k, width), uint16 or float32, as a TIFF file; row 0 is the top.

    rows : iterable of (k, width) arrays
    bits : 16 or 32. 32 are IEEE floats.
    pixels_per_cm : Resolution tag.
    description : ASCII; contains the calibration.
    Raises OSError.
    Raises FileDisagrees: More than 4 GiB, or another number of rows than `height`.
    """
    head = _tiff_head(width, height, bits, pixels_per_cm, description)
    if len(head) + width * height * bits // 8 > LARGEST_TIFF:
        raise FileDisagrees(f"{width} × {height} pixels do not fit a TIFF file of 4 GiB")
    with path.open("wb") as stream:
        stream.write(head)
        for block in _promised(rows, height):
            stream.write(np.ascontiguousarray(block, dtype="<u2" if bits == 16 else "<f4").tobytes())


def _promised(rows: Iterable[Rows], height: int) -> Iterator[Rows]:
    """The blocks of rows, which must be `height` rows together. Raises FileDisagrees."""
    written = 0
    for block in rows:
        yield block
        written += len(block)
    if written != height:
        raise FileDisagrees(f"{written} rows were drawn, {height} were promised")


def _tiff_head(width: int, height: int, bits: int, pixels_per_cm: float, description: str) -> bytes:
    """Byte order, one directory, and the values that do not fit its twelve-byte entries."""
    text = description.encode("ascii", "replace") + b"\0"
    text += b"\0" * (len(text) % 2)
    entries = 14
    after = 8 + 2 + 12 * entries + 4
    resolution = after
    words = resolution + 16
    data = words + len(text)
    ratio = (min(round(pixels_per_cm * 1000.0), (1 << 32) - 1) or 1, 1000)
    fields = [
        (256, _LONG, 1, width),
        (257, _LONG, 1, height),
        (258, _SHORT, 1, bits),
        (259, _SHORT, 1, 1),
        (262, _SHORT, 1, 1),
        (270, _ASCII, len(text), words),
        (273, _LONG, 1, data),
        (277, _SHORT, 1, 1),
        (278, _LONG, 1, height),
        (279, _LONG, 1, width * height * bits // 8),
        (282, _RATIONAL, 1, resolution),
        (283, _RATIONAL, 1, resolution + 8),
        (296, _SHORT, 1, 3),
        (339, _SHORT, 1, 1 if bits == 16 else 3),
    ]
    directory = b"".join(struct.pack("<HHII", *field) for field in fields)
    head = b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", entries) + directory + struct.pack("<I", 0)
    return head + struct.pack("<IIII", *ratio, *ratio) + text


def read_tiff(path: Path) -> Pixels:
    """Map a TIFF of the kind that `write_tiff` writes: (height, width), uint16 or float32.

    Raises UnreadableFile.
    Raises OverBudget: More bytes or pixels than are read.
    """
    spent = Spending("tiff", path)
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(4096)
    try:
        if head[:4] != b"II*\0":
            raise ValueError
        start, count = struct.unpack_from("<I", head, 4)[0], 0
        count = struct.unpack_from("<H", head, start)[0]
        tags = {}
        for k in range(count):
            tag, kind, _, value = struct.unpack_from("<HHII", head, start + 2 + 12 * k)
            tags[tag] = value & 0xFFFF if kind == _SHORT else value
        shape, bits, data, layout = (
            (tags[257], tags[256]),
            tags[258],
            tags[273],
            (tags[259], tags[277], tags[339]),
        )
    except (ValueError, KeyError, struct.error) as error:
        raise UnreadableFile(f"{path.name}: not a TIFF height map") from error
    if (bits, *layout) not in ((16, 1, 1, 1), (32, 1, 1, 3)):
        raise UnreadableFile(f"{path.name}: {bits}-bit pixels of layout {layout} are not read")
    if min(shape) < 1 or data + shape[0] * shape[1] * bits // 8 != size:
        raise UnreadableFile(f"{path.name}: {size} bytes do not hold {shape[1]} × {shape[0]} pixels")
    spent.count(shape[0] * shape[1])
    dtype = np.dtype("<u2" if bits == 16 else "<f4")
    return np.memmap(path, dtype=dtype, mode="r", offset=data, shape=shape)


def write_png(
    rows: Iterable[NDArray[np.uint16]],
    path: Path,
    width: int,
    height: int,
    pixels_per_metre: float,
    bits: int = 16,
) -> None:
    """Write blocks of rows (k, width) as a grey PNG file of 16 or 8 bits; row 0 is the top.

    Raises OSError.
    Raises FileDisagrees: Another number of rows than `height`.
    """
    packer = zlib.compressobj(6)
    dots = min(round(pixels_per_metre), (1 << 31) - 1)
    with path.open("wb") as stream:
        stream.write(b"\x89PNG\r\n\x1a\n")
        stream.write(_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0)))
        stream.write(_chunk(b"pHYs", struct.pack(">IIB", dots, dots, 1)))
        for block in _promised(rows, height):
            lines = np.zeros((len(block), 1 + bits // 8 * width), dtype=np.uint8)  # the first byte: no filter
            plain = np.ascontiguousarray(block, dtype=">u2" if bits == 16 else "u1")
            lines[:, 1:] = plain.view(np.uint8).reshape(len(block), -1)
            if packed := packer.compress(lines.tobytes()):
                stream.write(_chunk(b"IDAT", packed))
        stream.write(_chunk(b"IDAT", packer.flush()))
        stream.write(_chunk(b"IEND", b""))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _chunks(data: bytes, spent: Spending) -> Iterator[tuple[bytes, bytes]]:
    """Kind and content of every chunk of a PNG file, the last one, IEND, included."""
    at, kind = 8, b""
    while kind != b"IEND":
        if at + 12 > len(data):
            raise UnreadableFile(f"{spent.name}: cut short")
        spent.look(f"at byte {at:,}")
        size = struct.unpack_from(">I", data, at)[0]
        kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + size]
        if data[at + 8 + size : at + 12 + size] != struct.pack(">I", zlib.crc32(kind + body)):
            raise UnreadableFile(f"{spent.name}: a damaged {kind!r} chunk")
        yield kind, body
        at += 12 + size


def read_png(path: Path) -> NDArray[np.uint16]:
    """Read a PNG of the kind that `write_png` writes, of 16 or 8 bits: (height, width) uint16.

    Raises UnreadableFile: Damaged or of another kind.
    Raises OverBudget: More bytes, pixels or seconds than are read.
    """
    spent = Spending("png", path)
    data = path.read_bytes()
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        raise UnreadableFile(f"{path.name}: not a PNG file")
    head, packed = b"", []
    for kind, body in _chunks(data, spent):
        if kind == b"IHDR":
            head = body
        elif kind == b"IDAT":
            packed.append(body)
    width, height, *rest = struct.unpack(">IIBBBBB", head) if len(head) == 13 else (0, 0, 0)
    each = rest[0] // 8 if rest else 0
    need = height * (1 + each * width)
    if rest not in ([16, 0, 0, 0, 0], [8, 0, 0, 0, 0]) or not need > 0 or width < 1:
        raise UnreadableFile(f"{path.name}: not a grey picture of 16 or 8 bits")
    spent.count(width * height)
    unpacker = zlib.decompressobj()
    try:
        lines = unpacker.decompress(b"".join(packed), need)
    except zlib.error as error:
        raise UnreadableFile(f"{path.name}: damaged ({error})") from error
    table = np.frombuffer(lines, dtype=np.uint8)
    if (
        len(lines) != need
        or not unpacker.eof
        and unpacker.unconsumed_tail
        or table[:: 1 + each * width].any()
    ):
        raise UnreadableFile(f"{path.name}: its pixels are not {width} × {height} unfiltered ones")
    pixels = np.ascontiguousarray(table.reshape(height, -1)[:, 1:]).view(">u2" if each == 2 else "u1")
    return pixels.astype(np.uint16)


# -- BMP of 8 bits -------------------------------------------------------------------------------

_BMP_HEAD = struct.Struct("<2sIHHIIiiHHIIiiII")
_GREYS = b"".join(bytes((k, k, k, 0)) for k in range(256))


def write_bmp(
    rows: Iterable[NDArray[np.uint16]], path: Path, width: int, height: int, pixels_per_metre: float
) -> None:
    """Write blocks of rows (k, width) of 8 bits as a grey BMP file, stored from the top row down.

    Raises OSError.
    Raises FileDisagrees: Another number of rows than `height`, or more than 4 GiB.
    """
    line = (width + 3) // 4 * 4
    first = _BMP_HEAD.size + len(_GREYS)
    size = first + line * height
    if size > LARGEST_TIFF:
        raise FileDisagrees(f"{width} × {height} pixels do not fit a BMP file of 4 GiB")
    dots = min(round(pixels_per_metre), (1 << 31) - 1)
    head = (b"BM", size, 0, 0, first, 40, width, -height, 1, 8, 0, line * height, dots, dots, 256, 0)
    with path.open("wb") as stream:
        stream.write(_BMP_HEAD.pack(*head) + _GREYS)
        for block in _promised(rows, height):
            padded = np.zeros((len(block), line), dtype=np.uint8)
            padded[:, :width] = block
            stream.write(padded.tobytes())


def read_bmp(path: Path) -> NDArray[np.uint16]:
    """Read a BMP of the kind that `write_bmp` writes: (height, width) uint16.

    Raises UnreadableFile: Damaged or of another kind.
    Raises OverBudget: More bytes or pixels than are read.
    """
    spent = Spending("png", path)
    data = path.read_bytes()
    first = _BMP_HEAD.size + len(_GREYS)
    if len(data) < first or data[_BMP_HEAD.size : first] != _GREYS:
        raise UnreadableFile(f"{path.name}: not a grey BMP file of 8 bits")
    mark, _, _, _, at, _, width, down, _, bits, packed, *_ = _BMP_HEAD.unpack(data[: _BMP_HEAD.size])
    height, line = -down, (width + 3) // 4 * 4
    if (mark, at, bits, packed) != (b"BM", first, 8, 0) or min(width, height) < 1:
        raise UnreadableFile(f"{path.name}: not a grey BMP file of 8 bits from the top row down")
    spent.count(width * height)
    if len(data) != first + line * height:
        raise UnreadableFile(f"{path.name}: {len(data)} bytes do not hold {width} × {height} pixels")
    pixels = np.frombuffer(data, dtype=np.uint8, offset=first).reshape(height, line)
    return pixels[:, :width].astype(np.uint16)
