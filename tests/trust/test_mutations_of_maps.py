"""Maps, point clouds, grids, tables, masks, layers and the kernel's own files: one number changed, reported by verify."""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from filesonly import only_files
from trust.judging import alone, failed, tiny, vouched

from clacad.exporting.run import export

FORMATS = ("sag", "tiff", "png", "xyz", "table", "mask", "brep")
Change = Callable[[bytes], bytes]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("made")
    export(tiny(), folder, formats=FORMATS)
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.name != "run.json"}


@pytest.fixture(autouse=True)
def _only_files(monkeypatch: pytest.MonkeyPatch) -> None:
    only_files(monkeypatch)


def _float_pixel(data: bytes) -> bytes:
    """One pixel of a float TIFF, whose pixels come last, a ten-thousandth of its height up."""
    at = len(data) - 4 * 7777
    (value,) = struct.unpack_from("<f", data, at)
    return data[:at] + struct.pack("<f", 1.0001 * value) + data[at + 4 :]


def _level(data: bytes) -> bytes:
    """One pixel of a 16-bit TIFF one grey level up."""
    at = len(data) - 2 * 7777
    (value,) = struct.unpack_from("<H", data, at)
    return data[:at] + struct.pack("<H", value + 1) + data[at + 2 :]


def _png_level(data: bytes) -> bytes:
    """One pixel of a 16-bit PNG one grey level up, packed again with right checksums."""
    width = int.from_bytes(data[16:20], "big")
    packed, at = b"", 8
    while at < len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        packed += data[at + 8 : at + 8 + size] if data[at + 4 : at + 8] == b"IDAT" else b""
        at += 12 + size
    rows = bytearray(zlib.decompress(packed))
    place = 40 * (1 + 2 * width) + 1 + 2 * 33
    rows[place : place + 2] = (int.from_bytes(rows[place : place + 2], "big") + 1).to_bytes(2, "big")
    body = zlib.compress(bytes(rows))
    head = data[: data.index(b"IDAT") - 4]
    chunk = len(body).to_bytes(4, "big") + b"IDAT" + body + zlib.crc32(b"IDAT" + body).to_bytes(4, "big")
    return head + chunk + b"\0\0\0\0IEND" + zlib.crc32(b"IEND").to_bytes(4, "big")


def _word(line: int, word: int, change: Callable[[float], float], between: str = " ") -> Change:
    """One number of one line of a text."""

    def changed(data: bytes) -> bytes:
        lines = data.decode().splitlines()
        words = lines[line].split(between)
        words[word] = repr(change(float(words[word])))
        lines[line] = between.join(words)
        return ("\n".join(lines) + "\n").encode()

    return changed


def _exchanged(data: bytes) -> bytes:
    """The places of two lenslets exchanged."""
    lines = data.decode().splitlines()
    one, two = (lines[k].split(",") for k in (1, 3))
    one[3:5], two[3:5] = two[3:5], one[3:5]
    lines[1], lines[3] = ",".join(one), ",".join(two)
    return ("\n".join(lines) + "\n").encode()


def _dropped(data: bytes) -> bytes:
    return b"\n".join(data.splitlines()[:-1]) + b"\n"


def _curvature(data: bytes) -> bytes:
    table = json.loads(data)
    table["faces"][0]["curvature_x_per_mm"] *= 1.0 + 1e-6
    return json.dumps(table).encode()


def _step_of_levels(data: bytes) -> bytes:
    table = json.loads(data)
    table["faces"]["sheet-back"]["step_mm"] *= 1.01
    return json.dumps(table).encode()


def _number_after(mark: str, change: Callable[[float], float]) -> Change:
    """The first number after a mark."""

    def changed(data: bytes) -> bytes:
        head, found, tail = data.decode().partition(mark)
        assert found
        number = re.match(r"\s*([-+.\de]+)", tail)
        assert number is not None
        return (head + mark + tail.replace(number[1], repr(change(float(number[1]))), 1)).encode()

    return changed


def _inches(data: bytes) -> bytes:
    """All places and heights as if millimetres were inches."""
    rows = [[float(w) for w in line.split()] for line in data.decode().splitlines()[1:]]
    text = [" ".join(repr(v * 25.4 if k < 3 else v) for k, v in enumerate(row)) for row in rows]
    return (data.decode().splitlines()[0] + "\n" + "\n".join(text) + "\n").encode()


def _pole(data: bytes) -> bytes:
    """A number in the middle of the first rational patch of the kernel's file, a thousandth of a pitch off."""
    lines = data.decode().splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("Surfaces "))
    at = next(k for k in range(start, len(lines)) if re.match(r"9 1 1 ", lines[k]))
    words = lines[at].split(" ")
    poles = [k for k, word in enumerate(words) if k > 8 and re.fullmatch(r"-?\d+\.\d{6,}(e-?\d+)?", word)]
    words[poles[len(poles) // 2]] = repr(float(words[poles[len(poles) // 2]]) + 5e-4)
    lines[at] = " ".join(words)
    return ("\n".join(lines) + "\n").encode()


CHANGES: dict[str, tuple[str, Change]] = {
    "float map: a pixel": ("tiny.sheet-front.f32.tiff", _float_pixel),
    "16-bit map: a level": ("tiny.sheet-back.u16.tiff", _level),
    "png: a level": ("tiny.sheet-back.u16.png", _png_level),
    "points: a height": ("tiny.sheet-front.xyz", _word(500, 2, lambda z: z + 1e-6)),
    "points: a normal": ("tiny.sheet-front.xyz", _word(500, 5, lambda n: -n)),
    "points: x 25.4": ("tiny.sheet-front.xyz", _inches),
    "grid: a sag": ("tiny.sheet-back.cell.dat", _word(2000, 0, lambda z: z * (1.0 + 1e-8))),
    "table: an apex": ("tiny.poses.csv", _word(5, 4, lambda y: y + 1e-6, ",")),
    "table: lenslets exchanged": ("tiny.poses.csv", _exchanged),
    "table: lenslet dropped": ("tiny.poses.csv", _dropped),
    "table: a curvature": ("tiny.surfaces.json", _curvature),
    "calibration: its step": ("tiny.tiff.json", _step_of_levels),
    "svg: a lenslet": ("tiny.sheet-back.mask.svg", _number_after('href="#lens" x="', lambda x: x + 1e-6)),
    "dxf: the outline": ("tiny.sheet-front.mask.dxf", _number_after("VERTEX\n8\nAPERTURE\n10\n", lambda x: x + 1e-6)),
    "brep: a pole": ("tiny.brep", _pole),
}  # fmt: skip


@pytest.mark.ci_cases(
    "tiny.brep", "tiny.sheet-back.cell.dat", "tiny.sheet-front.f32.tiff", "tiny.sheet-front.mask.dxf"
)
@pytest.mark.daily_cases("tiny.sheet-back.mask.svg")
@pytest.mark.parametrize("name", sorted({name for name, _ in CHANGES.values()}))
def test_unchanged_ones_pass_with_a_manifest_and_without(
    made: dict[str, bytes], tmp_path: Path, name: str
) -> None:
    (tmp_path / "alone").mkdir()
    assert not failed(vouched(tmp_path, made, name, made[name]))
    assert not failed(alone(tmp_path / "alone", name, made[name]))


@pytest.mark.ci_cases(
    "float map: a pixel",
    "png: a level",
    "points: a normal",
    "grid: a sag",
    "table: lenslets exchanged",
    "dxf: the outline",
    "brep: a pole",
)
@pytest.mark.daily_cases("calibration: its step")
@pytest.mark.parametrize("what", CHANGES)
def test_a_changed_number_is_caught_with_a_manifest_that_vouches_for_it_and_without_any(
    made: dict[str, bytes], tmp_path: Path, what: str
) -> None:
    name, change = CHANGES[what]
    data = change(made[name])
    assert data != made[name]
    (tmp_path / "alone").mkdir()
    expected = {"shape", "readable", "volume", "closed"}
    assert failed(vouched(tmp_path, made, name, data)) & expected
    assert failed(alone(tmp_path / "alone", name, data)) & expected


@pytest.mark.slow
@pytest.mark.parametrize("what", ["a layer", "a place"])
def test_changed_layers_are_caught(tmp_path: Path, what: str) -> None:
    gdstk = pytest.importorskip("gdstk")
    export(tiny(), tmp_path / "made", formats=("gds",))
    name = "tiny.sheet-back.gds"
    made = {p.name: p.read_bytes() for p in (tmp_path / "made").iterdir()}
    library = gdstk.read_gds(str(tmp_path / "made" / name))
    lenslet, sheet = (
        next(c for c in library.cells if (c.name == "lenslet") == first) for first in (True, False)
    )
    if what == "a layer":
        polygon = lenslet.polygons[99]
        lenslet.remove(polygon)
        lenslet.add(gdstk.Polygon(polygon.points, layer=(polygon.layer + 1) % 64))
    else:
        sheet.references[0].origin = np.asarray(sheet.references[0].origin) + 0.01
    library.write_gds(str(tmp_path / "changed.gds"))
    (tmp_path / "alone").mkdir()
    assert not failed(alone(tmp_path / "alone", name, made[name]))
    data = (tmp_path / "changed.gds").read_bytes()
    assert failed(alone(tmp_path / "alone", name, data)) & {"shape", "readable"}
    assert failed(vouched(tmp_path, made, name, data)) & {"shape", "readable"}
