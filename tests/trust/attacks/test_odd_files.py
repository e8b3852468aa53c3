"""Files and circumstances that were once answered by an internal error or a library's warning: one sentence each."""

from __future__ import annotations

import copy
import json
import random
import struct
import zipfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filesonly import only_files
from trust.attacks.odd_values import NUMBERS, TEXTS, answered
from trust.running import TINY, clacad, talk

from clacad.design import load
from clacad.exporting.run import export

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float64)
SIDES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))


@pytest.fixture
def design(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    only_files(monkeypatch)
    path = tmp_path / "t.toml"
    path.write_text(TINY)
    return path


def verified(design: Path, files: Path) -> tuple[int, str]:
    return answered(["verify", str(design), "--files", str(files), "--rays", "64"])


# -- coordinates --------------------------------------------------------------------------------------


def stl(path: Path, scale: float) -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        corners = (TETRAHEDRON[list(SIDES)] * scale).astype("<f4")
    facets = b"".join(struct.pack("<3f", 0, 0, 1) + facet.tobytes() + b"\0\0" for facet in corners)
    path.write_bytes(bytes(80) + struct.pack("<I", len(SIDES)) + facets)


def ascii_stl(path: Path, exponent: str) -> None:
    vertex = ["vertex " + " ".join(f"{c:g}{exponent}" for c in corner) for corner in TETRAHEDRON]
    sides = (
        "facet normal 0 0 1\nouter loop\n" + "\n".join(vertex[k] for k in side) + "\nendloop\nendfacet" for side in SIDES
    )  # fmt: skip
    path.write_text("\n".join(["solid a", *sides, "endsolid a", ""]))


MODEL = """<?xml version="1.0"?><model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>
<object id="1" type="model"><mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh></object></resources>
<build><item objectid="1"{placed}/></build></model>"""
RELATIONS = """<?xml version="1.0"?><Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Target="/3D/3dmodel.model" Id="r" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>"""


def threemf(path: Path, exponent: str, placed: str = "") -> None:
    vertices = "".join(
        f'<vertex x="{x:g}{exponent}" y="{y:g}{exponent}" z="{z:g}{exponent}"/>' for x, y, z in TETRAHEDRON
    )
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in SIDES)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("_rels/.rels", RELATIONS)
        archive.writestr(
            "3D/3dmodel.model", MODEL.format(vertices=vertices, triangles=triangles, placed=placed)
        )


@pytest.mark.daily_cases("1e+30", "inf", "nan")
@pytest.mark.parametrize("scale", [3e38, 1e30, 1e19, 1e-38, 1e-45, float("inf"), float("nan")])
def test_an_stl_of_any_size_is_judged_without_a_warning(design: Path, scale: float) -> None:
    path = design.with_name("part.stl")
    stl(path, scale)
    status, wrong = verified(design, path)
    assert (status in (1, 2), wrong) == (True, "")


@pytest.mark.parametrize("exponent", ["e300", "e308", "e400", "e-320"])
@pytest.mark.parametrize("write", [ascii_stl, threemf])
def test_a_text_with_coordinates_of_any_size_is_judged_without_a_warning(
    design: Path, write: Any, exponent: str
) -> None:
    path = design.with_name("part.3mf" if write is threemf else "part.stl")
    write(path, exponent)
    status, wrong = verified(design, path)
    assert (status in (1, 2), wrong) == (True, "")


@pytest.mark.parametrize(
    "matrix",
    [
        "1e300 0 0 0 1e300 0 0 0 1e300 1e308 1e308 0",
        "0 0 0 0 0 0 0 0 0 0 0 0",
        "1e-300 0 0 0 1 0 0 0 1 0 0 0",
    ],
)
def test_a_placement_of_any_size_is_judged_without_a_warning(design: Path, matrix: str) -> None:
    path = design.with_name("part.3mf")
    threemf(path, "", f' transform="{matrix}"')
    status, wrong = verified(design, path)
    assert (status in (1, 2), wrong) == (True, "")


# -- manifests ----------------------------------------------------------------------------------------

LISTS: list[list[Any]] = [
    [1, 2], ["a"], [None], [[]], [{}], [], [{"name": 1}], [{"name": ["x"], "role": []}], [{"name": "a\0b"}], [{"name": "x" * 5000}],
    [{"name": "t.stl", "bodies": 5, "format": {}, "bytes": "x", "volume": "nan"}], [{"name": ".."}], [{"name": "."}],
]  # fmt: skip


@pytest.mark.parametrize("listed", LISTS, ids=[f"{one!r:.40}" for one in LISTS])
def test_a_manifest_that_lists_no_files_is_judged_and_written_over(design: Path, listed: list[Any]) -> None:
    folder = design.with_name("out")
    folder.mkdir()
    (folder / "manifest.json").write_text(json.dumps({"format": 1, "files": listed}))
    assert verified(design, folder) == (1, "")
    assert answered(["export", str(design), "-o", str(folder), "--format", "table", "-q"]) == (0, "")


def spoiled(document: Any, chance: random.Random) -> Any:
    """A document with one value, somewhere in it, replaced by an odd one."""
    places: list[tuple[Any, Any]] = []

    def walk(part: Any) -> None:
        for key, value in part.items() if isinstance(part, dict) else enumerate(part):
            places.append((part, key))
            if isinstance(value, (dict, list)):
                walk(value)

    made = copy.deepcopy(document)
    walk(made)
    part, key = chance.choice(places)
    part[key] = chance.choice([*NUMBERS, *TEXTS, [], {}, [[]], [{}], {"a": 1}, None])
    return made


def attacked(design: Path, rounds: int, seed: int) -> None:
    folder = design.with_name("out")
    export(load(design), folder, formats=("table", "stl"), quads=4)
    good = json.loads((folder / "manifest.json").read_text())
    chance = random.Random(seed)
    for n in range(rounds):
        document = spoiled(good, chance)
        (folder / "manifest.json").write_text(json.dumps(document))
        status, wrong = verified(design, folder)
        assert wrong == "", f"round {n} of seed {seed}: {json.dumps(document)[:3000]}"
        assert status in (0, 1, 2)


@pytest.mark.slow
def test_a_few_odd_values_in_a_manifest_are_answered(design: Path) -> None:
    attacked(design, 8, 0)


@pytest.mark.long
def test_many_odd_values_in_a_manifest_are_answered(design: Path) -> None:
    attacked(design, 200, 1)


# -- rays ---------------------------------------------------------------------------------------------

HEADERS = {
    "nested": '{"descr":' + "[" * 9000 + "}", "deep": '{"shape": ' + "(" * 4000 + ")" * 4000 + "}", "long": "(" * 60000,
    "minus": '{"descr": "<f8", "fortran_order": False, "shape": (' + "-" * 8000 + "1,3)}",
    "vast": '{"descr": "<f8", "fortran_order": False, "shape": (1' + "0" * 5000 + ",3)}",
    "record": '{"descr": [("a","<f8")], "fortran_order": False, "shape": (1,3)}',
    "kind": '{"descr": "<f99999999", "fortran_order": False, "shape": (1,3)}', "nul": '{"descr": "<f8\\0"}', "none": "",
    "control": '{"descr": "\x1b[31m"}', "call": "__import__('os').abort()",
}  # fmt: skip


@pytest.mark.parametrize("name", HEADERS)
def test_whatever_the_header_of_an_array_says_is_refused_in_one_line(
    design: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = HEADERS[name].encode()
    header = BytesIO(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text)
    path = design.with_name("rays.npz")
    with zipfile.ZipFile(path, "w") as archive:
        for member in ("position.npy", "direction.npy"):
            archive.writestr(member, header.getvalue())
    words = ["trace", str(design), str(path), "-o", str(design.with_name("out.npz"))]
    assert answered(words) == (2, "")
    from clacad.cli import main

    main(words)
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


# -- handles ------------------------------------------------------------------------------------------


@pytest.mark.daily_cases("check t.toml-5", "export t.toml -o out --format step -q-9")
@pytest.mark.parametrize(("line", "handles"), [
    ("check t.toml", 5), ("export t.toml -o out --format stl -q", 6), ("export t.toml -o out --format stl -q", 7),
    ("export t.toml -o out --format step -q", 9),
])  # fmt: skip
def test_out_of_handles_is_a_limit_said_in_one_sentence(design: Path, line: str, handles: int) -> None:
    few = f"import numpy; resource.setrlimit(resource.RLIMIT_NOFILE, ({handles}, {handles}))"
    ended = clacad(*line.split(), before=few, cwd=design.parent)
    assert ended.status == 3
    (sentence,) = talk(ended)
    assert "open" in sentence
    assert "ulimit -n" in sentence
