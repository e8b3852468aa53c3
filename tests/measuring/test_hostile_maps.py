"""A hundred hostile height maps: each is measured or refused with words of its own, and none is an internal error."""

from __future__ import annotations

import io
import json
import os
import random
import struct
import zipfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fuzz.bytes_of import mutated
from fuzz.grow import recipe
from measuring.made_parts import Made

from clacad.cli import main
from clacad.design import load
from clacad.measuring.measure import Maps, fitted_sides
from clacad.prescription.prescribe import prescribe
from clacad.storage.errors import BadRequest, NotPossible, UnreadableFile

SAMPLES = Path(__file__).parents[1] / "data" / "measured"
DESIGN = Path(__file__).parents[2] / "designs" / "window-100mm.toml"
SCALES = {"pixel_um": 8, "z_step_nm": 1, "row_0": "bottom"}
MILLIMETRES = '{"pixel_um": 8, "z_step_mm": 1}'
ANSWERS = (UnreadableFile, BadRequest, NotPossible, OSError)
"""What a hostile file may raise; the commands give each its words and its status (OverBudget is an UnreadableFile)."""


def npy(values: np.ndarray, **pickle: bool) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values, **pickle)
    return stream.getvalue()


def npy_head(text: str) -> bytes:
    """The first bytes of an NPY file that state anything, and few data."""
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode() + b"\0" * 64


def picture(mode: str, kind: str, **more: object) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.new(mode, (40, 40)).save(stream, kind, **more)
    return stream.getvalue()


def archive(**files: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, data in files.items():
            packed.writestr(name.replace("_xml", ".xml").replace("_md5", ".md5"), data)
    return stream.getvalue()


def triangles(corners: object) -> bytes:
    data = np.zeros(0, dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")])
    corners = np.asarray(corners, dtype=np.float32).reshape(-1, 3, 3)
    data = np.zeros(len(corners), data.dtype)
    data["corners"] = corners
    return b" " * 80 + struct.pack("<I", len(corners)) + data.tobytes()


FLAT, LINE = np.zeros((40, 40)), "\n".join(f"{k} 0 1" for k in range(50))
GRID = np.mgrid[0:20, 0:20].reshape(2, -1).T * 0.01
ARRAYS = {
    "flat": FLAT,
    "unknown": np.full((40, 40), np.nan),
    "infinite": np.full((40, 40), np.inf),
    "huge": np.full((40, 40), 1e308) * np.sign(np.arange(40) - 20),
    "tiny": np.full((40, 40), 5e-324),
    "row": np.zeros((1, 4000)),
    "column": np.zeros((4000, 1)),
    "none": np.zeros((0, 0)),
    "cube": np.zeros((9, 9, 9)),
    "number": np.array(3.0),
    "complex": np.zeros((40, 40), complex),
    "words": np.full((40, 40), "x"),
    "bool": np.zeros((40, 40), bool),
    "dates": np.zeros((40, 40), "M8[s]"),
    "records": np.zeros((40, 40), [("a", float)]),
    "random": np.random.default_rng(0).normal(0.0, 1e-5, (200, 200)),
    "half": np.zeros((40, 40), np.float16),
    "signs": np.arange(1600, dtype=np.int64).reshape(40, 40) * 2**52,
}
HEADS = {
    "endless": "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 1000000000), }\n",
    "negative": "{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 40), }\n",
    "code": "__import__('os').abort()\n",
    "objects": "{'descr': '|O', 'fortran_order': False, 'shape': (3, 3), }\n",
    "empty": "",
}
SIDECARS = [
    "", "{", "null", "[]", "3", "[" * 100_000, '{"pixel_um": NaN, "z_step_nm": 1}', '{"pixel_um": 1e999, "z_step_nm": 1}',
    '{"pixel_um": 0, "z_step_nm": 1}', '{"pixel_um": -8, "z_step_nm": 1}', '{"pixel_um": true, "z_step_nm": 1}',
    '{"pixel_um": [8, 8, 8], "z_step_nm": 1}', '{"pixel_um": [], "z_step_nm": 1}', '{"pixel_um": 8, "z_step_nm": 0}',
    '{"pixel_um": 8, "z_step_nm": 1e300}', '{"pixel_um": 8, "z_step_nm": 1, "invalid": "x"}',
    '{"pixel_um": 8, "z_step_nm": 1, "z_at_0_um": 0, "z_at_1_um": 0}', '{"pixel_um": 8, "z_step_nm": 1, "row_0": 1}',
    '{"pixel_lightyear": 8, "z_step_nm": 1}', '{"pixel_um": 1' + "0" * 400 + ', "z_step_nm": 1}', "\0\xff",
]  # fmt: skip
CLOUDS = {
    "empty": "", "words": "# unit um\nhello world again\n", "two columns": "# unit um\n1 2\n3 4\n", "one": "# unit um\n0 0 0\n",
    "line": f"# unit um\n{LINE}\n", "nan": "# unit um\n" + "nan nan nan\n" * 40, "inf": "# unit um\n" + "inf 1 -inf\n" * 40,
    "same": "# unit um\n" + "1 1 1\n" * 400, "far": "# unit um\n" + "".join(f"1e{k} {k} 0\n" for k in range(300)),
    "unit": "# unit parsec\n0 0 0\n", "binary": "# unit um\n\0\1\2" * 99, "long": "# unit um\n" + "7" * 200_000 + " 1 1\n",
    "diagonal": "# unit um\n" + "".join(f"{k} {k} 0\n" for k in range(400)),
}  # fmt: skip
MESHES = {
    "empty": triangles([]), "nan": triangles(np.full((30, 3, 3), np.nan)), "points": triangles(np.ones((30, 3, 3))),
    "wall": triangles([[[0, 0, k], [1, 0, k], [0, 0, k + 1]] for k in range(30)]), "cut": triangles(np.ones((30, 3, 3)))[:900],
    "box": triangles([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 1], [0, 1, 1], [1, 0, 1]]] * 20),
    "count": b" " * 80 + struct.pack("<I", 2**32 - 1), "far": triangles(np.random.default_rng(1).normal(0, 1e30, (30, 3, 3))),
}  # fmt: skip
ARCHIVES = {
    "no zip": b"PK\3\4" + b"x" * 99, "empty": b"", "no main": archive(other=b"x"), "words": archive(main_xml=b"hello"),
    "bomb": archive(main_xml=b"<a>" + b" " * 40_000_000 + b"</a>"), "entity": archive(
        main_xml=b'<!DOCTYPE a [<!ENTITY b "bb"><!ENTITY c "&b;&b;&b;">]><a>&c;</a>', md5checksum_hex=b"0"
    ),
    "outside": archive(**{"../../main_xml": b"<a/>"}), "sheet": archive(main_xml=b"<p:ISO5436_2 xmlns:p='x'></p:ISO5436_2>"),
}  # fmt: skip
SDF = {
    "empty": b"", "words": b"aBCR-1.0\nhello\n", "no data": b"aBCR-1.0\nNumPoints = 40\nNumProfiles = 40\n*\n*\n",
    "negative": b"aBCR-1.0\nNumPoints = -4\nNumProfiles = 4\nXscale = 1e-6\nYscale = 1e-6\nZscale = 1e-9\n*\n",
    "endless": b"aBCR-1.0\nNumPoints = 999999999\nNumProfiles = 999999999\nXscale = 1e-6\nYscale = 1e-6\n*\n1\n*\n",
    "binary": b"bBCR-1.0" + bytes(range(256)) * 4,
}  # fmt: skip


def handmade() -> list[tuple[str, bytes, str]]:
    """(file name, bytes, text of the JSON next to it) of every hostile map made by hand."""
    scales = json.dumps(SCALES)
    found = [(f"{name}.npy", npy(values), scales) for name, values in ARRAYS.items()]
    found.append(("pickle.npy", npy(np.array([[print, print], [print, print]]), allow_pickle=True), scales))
    found += [(f"{name}-head.npy", npy_head(text), scales) for name, text in HEADS.items()]
    found += [(f"json-{k}.npy", npy(FLAT), text) for k, text in enumerate(SIDECARS)]
    found += [(f"{name}.xyz", text.encode("latin-1"), "") for name, text in CLOUDS.items()]
    found += [(f"{name}.stl", data, "") for name, data in MESHES.items()]
    found += [(f"{name}.x3p", data, "") for name, data in ARCHIVES.items()]
    found += [(f"{name}.sdf", data, "") for name, data in SDF.items()]
    for mode, kind in (
        ("RGB", "TIFF"),
        ("L", "PNG"),
        ("1", "PNG"),
        ("P", "PNG"),
        ("I;16", "TIFF"),
        ("F", "TIFF"),
    ):
        found.append((f"{mode.replace(';', '')}.{kind.lower()}", picture(mode, kind), scales))
    found.append(("cut.tiff", picture("I;16", "TIFF")[:200], scales))
    found.append(("line\nbreak.npy", npy(FLAT), scales))
    return found


@cache
def good() -> dict[str, bytes]:
    """Good maps that are mutated, by their endings."""
    data = {
        path.suffix: path.read_bytes()
        for path in sorted(SAMPLES.iterdir())
        if path.suffix in (".xyz", ".tif")
    }
    data[".npy"] = npy(Made(size=150).heights())
    return {ending: one for ending, one in data.items() if len(one) < 3_000_000}


@cache
def window():
    return prescribe(load(DESIGN))


def answered(path: Path) -> str:
    """What a map led to: "measured", or the words of its refusal."""
    try:
        fitted_sides(load(DESIGN), window(), Maps(front=path, unit="mm"))
    except ANSWERS as error:
        return str(error)
    return "measured"


CASES = handmade()


def written(folder: Path, number: int) -> Path:
    """Hostile map of a number in a folder: first those made by hand, then mutants of good ones."""
    if number < len(CASES):
        name, data, beside = CASES[number]
    else:
        chance = random.Random(number)
        ending = sorted(good())[number % len(good())]
        name = f"mutant-{number}{ending}"
        beside = (
            (SAMPLES / "front-other-instrument.tif.json").read_text() if ending == ".tif" else MILLIMETRES
        )
        data = mutated(good()[ending], recipe(chance), good()[ending], 1 << 23)
    (folder / name).write_bytes(data)
    if beside or "json-" in name:
        (folder / f"{name}.json").write_bytes(beside.encode("latin-1"))
    return folder / name


@pytest.mark.ci_cases("0", "5", "9")
@pytest.mark.slow
@pytest.mark.parametrize("tenth", range(12))
def test_hostile_maps_are_measured_or_refused(tmp_path, tenth):
    for number in range(10 * tenth, 10 * tenth + 10):
        words = answered(written(tmp_path, number))
        assert words, number
        assert len(words) < 600, words
        assert words == "measured" or "\0" not in words


@pytest.mark.slow
@pytest.mark.parametrize("number", [12, 43, len(CASES) - 20])
def test_a_hostile_map_is_refused_by_the_command_in_words(tmp_path, capsys, number):
    path = written(tmp_path, number)
    status = main(
        ["verify", str(DESIGN), "--rays", "1024", "--role", "scan", "--unit", "mm", "--files", str(path)]
    )
    assert status in (1, 2, 3, 4)
    told = capsys.readouterr().err
    assert "Traceback" not in told
    assert "internal" not in told


def test_what_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.npy")
    (tmp_path / "folder.x3p").mkdir()
    (tmp_path / "gone.npy").symlink_to(tmp_path / "nothing.npy")
    for name in ("pipe.npy", "folder.x3p", "gone.npy", "none.sdf"):
        assert answered(tmp_path / name) != "measured"
