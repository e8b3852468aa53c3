"""Untrusted drawings: any file under the name of an outline gives an error message with a code, or a plate that closes."""

from __future__ import annotations

import os
import random
import time
from dataclasses import replace
from pathlib import Path

import pytest
from trust.running import TINY

from clacad.base.untrusted_files import BUDGETS
from clacad.design import Design, DesignError, load
from clacad.sheet.plate import Plate

HEAD = "0\nSECTION\n2\nHEADER\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n"
TAIL = "0\nENDSEC\n0\nEOF\n"
SQUARE = (
    "0\nLWPOLYLINE\n8\n0\n90\n4\n70\n1\n10\n-3\n20\n-3\n10\n3\n20\n-3\n42\n0.2\n10\n3\n20\n3\n10\n-3\n20\n3\n"
)
RING = (
    "0\nLINE\n10\n-3\n20\n-3\n11\n3\n21\n-3\n0\nLINE\n10\n3\n20\n-3\n11\n3\n21\n3\n"
    "0\nARC\n10\n0\n20\n3\n40\n3\n50\n0\n51\n180\n0\nLINE\n10\n-3\n20\n3\n11\n-3\n21\n-3\n"
)


def asked(folder: Path, data: bytes | str | None, name: str = "p.dxf") -> Design:
    """The design that names a drawing."""
    if data is not None:
        (folder / "p.dxf").write_bytes(data.encode() if isinstance(data, str) else data)
    path = folder / "t.toml"
    path.write_text(TINY.replace("count = [2, 2]", f'outline = {{dxf = "{name}"}}'))
    return load(path)


def refused(folder: Path, data: bytes | str | None, name: str = "p.dxf") -> str:
    with pytest.raises(DesignError) as caught:
        asked(folder, data, name)
    assert len(caught.value.mistakes) == 1
    said = str(caught.value)
    assert said.isprintable() or all(line.isprintable() for line in said.split("\n"))
    return said


def _answer(folder: Path, data: bytes) -> Design | set[str]:
    """The design, or the codes of what is wrong with it."""
    try:
        return asked(folder, data)
    except DesignError as error:
        return {mistake.code for mistake in error.mistakes}


def test_the_drawings_that_are_spoilt_below_are_good(tmp_path: Path) -> None:
    for text in (SQUARE, RING):
        design = asked(tmp_path, HEAD + text + TAIL)
        assert design.lattice.outline is not None
        assert len(design.lattice.outline.points) == 4


@pytest.mark.parametrize("seed", range(20))
def test_a_spoilt_drawing_is_answered_by_a_sentence_or_is_an_outline(tmp_path: Path, seed: int) -> None:
    """Bytes changed, lines lost, doubled or exchanged, numbers made odd; 10 of each seed."""
    chance = random.Random(seed)
    odd = [
        "",
        "nan",
        "inf",
        "-inf",
        "1e400",
        "-1e30",
        "1e-320",
        "0x10",
        "9" * 400,
        "LINE",
        "\x1b[2J",
        "½",
        "-0",
        "70",
    ]
    for _ in range(10):
        lines = (HEAD + chance.choice((SQUARE, RING)) + TAIL).split("\n")
        for _ in range(chance.randint(1, 4)):
            at = chance.randrange(len(lines))
            way = chance.randrange(5)
            if way == 0:
                lines[at] = chance.choice(odd)
            elif way == 1:
                del lines[at]
            elif way == 2:
                lines.insert(at, lines[at])
            elif way == 3:
                other = chance.randrange(len(lines))
                lines[at], lines[other] = lines[other], lines[at]
            else:
                lines = lines[:at] + lines[at + chance.randint(1, 9) :]
        began = time.process_time()
        found = _answer(tmp_path, "\n".join(lines).encode("utf-8", "replace"))
        if isinstance(found, set):
            assert found <= {"CL100", "CL105", "CL106", "CL108", "CL117", "CL141"}
        else:
            assert found.lattice.outline is not None
            assert abs(Plate(found.lattice.outline.points).area) > 0.0
        assert time.process_time() - began < 2.0


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "cut short"),
        (b"AutoCAD Binary DXF\r\n\x1a\x00" + bytes(300), "binary DXF"),
        (random.Random(0).randbytes(5000), "is not a group code"),
        (HEAD + SQUARE, "cut short"),
        (HEAD + TAIL, "no entities"),
        (HEAD.replace("ENTITIES", "OBJECTS") + SQUARE + TAIL, "no entities"),
        (HEAD + SQUARE.replace("42\n0.2", "42\nnan") + TAIL, "is not a number"),
        (HEAD + SQUARE.replace("10\n3\n20\n-3", "10\n1e31\n20\n-3", 1) + TAIL, "is not a number"),
        (HEAD + SQUARE.replace("70\n1", "70\n0") + TAIL, "is open"),
        (HEAD + SQUARE.replace("10\n3\n20\n3\n", "10\n3\n") + TAIL, "without y"),
        (HEAD + SQUARE + "230\n-1\n" + TAIL, "another plane"),
        (HEAD + "0\nINSERT\n2\nevil\n" + TAIL, "is no outline"),
        (HEAD + "0\n\x1b[2Jevil\n" + TAIL, "is no outline"),
        (HEAD + RING.replace("51\n180", "51\n0") + TAIL, "without extent"),
        (HEAD + RING + "0\nLINE\n10\n3\n20\n3\n11\n9\n21\n9\n" + TAIL, "more than two pieces meet"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_drawing_is_said(tmp_path: Path, data: bytes | str, words: str) -> None:
    assert words in refused(tmp_path, data)


def test_a_drawing_lies_in_the_designs_folder_and_is_a_file(tmp_path: Path) -> None:
    home = tmp_path / "home"
    (home / "sub").mkdir(parents=True)
    (tmp_path / "p.dxf").write_text(HEAD + SQUARE + TAIL)
    (home / "sub" / "p.dxf").write_text(HEAD + SQUARE + TAIL)
    (home / "link.dxf").symlink_to("../p.dxf")
    (home / "inside.dxf").symlink_to("sub/p.dxf")
    os.mkfifo(home / "pipe.dxf")
    assert asked(home, None, "sub/p.dxf") == asked(home, None, "inside.dxf")
    for name in ("../p.dxf", "link.dxf", "sub/../../p.dxf"):
        assert "outside the design's folder" in refused(home, None, name)
    for name in (str(tmp_path / "p.dxf"), "C:p.dxf"):
        assert "is not a relative path" in refused(home, None, name)
    for name, words in (("none.dxf", "no such file"), ("sub", "a folder"), ("pipe.dxf", "a pipe")):
        assert words in refused(home, None, name)


@pytest.mark.parametrize("change", [{"bytes": 100}, {"items": 20}])
def test_a_drawing_beyond_its_budget_is_refused_by_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: dict[str, int]
) -> None:
    less = {**BUDGETS, "outline": replace(BUDGETS["outline"], **change)}
    monkeypatch.setattr("clacad.design.drawn_outline.BUDGETS", less)
    with pytest.raises(DesignError) as caught:
        asked(tmp_path, HEAD + SQUARE + TAIL)
    assert getattr(caught.value, "exit_status", 2) == 3


def test_many_loose_ends_take_no_time_to_speak_of(tmp_path: Path) -> None:
    rng = random.Random(1)
    lines = "".join(
        f"0\nLINE\n10\n{rng.random()}\n20\n{rng.random()}\n11\n{rng.random()}\n21\n{rng.random()}\n"
        for _ in range(20_000)
    )
    began = time.process_time()
    assert "does not close" in refused(tmp_path, HEAD + lines + TAIL)
    assert time.process_time() - began < 5.0
