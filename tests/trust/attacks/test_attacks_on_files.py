"""Hundreds of mutants of every format that is read, handed to `verify`: an answer each, and no broken part passes.

A fixed tenth runs with the slow tests, all of them with `-m long`; counts and processor seconds are printed (`-s`).
"""

from __future__ import annotations

import os
import random
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from filesonly import only_files
from trust.attacks import mutants, solids
from trust.judging import tiny
from trust.spoiling import Floats, obj

from clacad.cli.entry_point import status_of
from clacad.exporting.run import export
from clacad.prescription.prescribe import prescribe
from clacad.verification import verify

KINDS = ("stl", "ascii.stl", "3mf", "ply", "obj", "glb")
SAME = 2e-5
"""Millimetres; a corner moved by less turns no light by more than a thousandth of what the design allows."""
CRASH = "crash:"
SAME_PART = "passes and is the same part"
PARTS = 0.3
"""Share of the mutants of a mesh that are another part; of the others bytes are changed."""


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The tiny design in every format, small."""
    folder = tmp_path_factory.mktemp("good")
    export(tiny(), folder, formats=("step", "brep", "stl", "3mf", "ply", "glb"), quads=4)
    files = {
        kind: (folder / f"tiny.{kind}").read_bytes() for kind in ("step", "brep", "stl", "3mf", "ply", "glb")
    }
    corners = mutants.corners_of("stl", files["stl"])
    files["ascii.stl"] = mutants.ascii_stl(corners)
    kept: list[bytes] = []
    mutants.changed("x.ply", files["ply"], lambda v, t: (kept.append(obj(v, t)), (v, t))[1])
    files["obj"] = kept[0]
    return files


@pytest.fixture(autouse=True)
def _only_files(monkeypatch: pytest.MonkeyPatch) -> None:
    only_files(monkeypatch)


def answer(folder: Path, name: str, data: bytes) -> str:
    """What `verify` makes of a file: its word, or the status of the error; anything else is an error of its own."""
    path = folder / name
    path.write_bytes(data)
    try:
        report = verify(tiny(), path, rays=2048, role="preview")
    except Exception as error:
        if status_of(error) not in (1, 2, 3) or not 0 < len(str(error)) < 1000:
            return f"{CRASH} {type(error).__name__}: {error}"
        return f"refused with status {status_of(error)}"
    assert report.exit_status in (0, 1, 3)
    [readable] = [check for check in report.checks if check.id == "readable"]
    assert len(readable.sentence) < 1000
    return "unreadable" if readable.state == "fail" else report.word


def attack(
    folder: Path, name: str, good: bytes, numbers: range, mutant: Callable[[int], bytes],
    excuse: Callable[[bytes], str],
) -> Counter[str]:  # fmt: skip
    """Hand in mutants by their numbers; a mutant with the same report as the good file needs an excuse."""
    praise = answer(folder, name, good)
    assert praise == "shape only", "four quads are a preview"
    tally: Counter[str] = Counter()
    broken = []
    began = sum(os.times()[:4])
    for number in numbers:
        data = mutant(number)
        word = answer(folder, name, data)
        if word.startswith(CRASH):
            broken.append((number, word))
        if word == praise and data != good:
            word = excuse(data)
            if not word:
                broken.append((number, "another part, and passes"))
        tally[word if data != good else "the same bytes"] += 1
    print(f"{name}: {len(numbers)} mutants, {sum(os.times()[:4]) - began:.0f} s of processors: {dict(tally)}")  # noqa: T201
    assert not broken, f"of the mutants of {name}"
    return tally


def lens_blocks() -> tuple[Floats, Floats]:
    """Lowest and highest x, y of the lenses of both arrays, mm."""
    window = prescribe(tiny())
    half = 0.5 * np.array(window.lattice.count) * np.array(window.lattice.pitch)
    first, second = (
        np.array([np.asarray(shift) - half, np.asarray(shift) + half]) for shift in window.shifts
    )
    return first, second


def many(long: int) -> list[object]:
    """How many mutants: a tenth among the slow tests, all among the long ones."""
    return [pytest.param(range(0, long, 10), marks=pytest.mark.slow, id="tenth"),
            pytest.param(range(long), marks=[pytest.mark.long, pytest.mark.timeout(1800)], id="all")]  # fmt: skip


@pytest.mark.ci_cases("stl-tenth", "3mf-tenth", "glb-tenth")
@pytest.mark.parametrize("numbers", many(300))
@pytest.mark.parametrize("kind", KINDS)
def test_no_mutant_of_a_mesh_is_more_than_answered(
    good: dict[str, bytes], tmp_path: Path, kind: str, numbers: range
) -> None:
    def mutant(number: int) -> bytes:
        make = mutants.part_mutant if random.Random(~number).random() < PARTS else mutants.bytes_mutant
        return make(kind, good[kind], number)

    def excuse(data: bytes) -> str:
        if mutants.same_part(kind, good[kind], data, SAME):
            return SAME_PART
        beside = mutants.only_beside_lenses(kind, good[kind], data, SAME, lens_blocks())
        return "a preview, other at the outline of its lenses" if beside else ""

    tally = attack(tmp_path, f"x.{kind}", good[kind], numbers, mutant, excuse)
    assert tally.total() == len(numbers)
    assert tally["failed"] >= len(numbers) // 8


@pytest.mark.parametrize("numbers", many(83))
def test_no_mutant_of_a_step_file_is_more_than_answered(
    good: dict[str, bytes], tmp_path: Path, numbers: range
) -> None:
    (tmp_path / "good.step").write_bytes(good["step"])

    def excuse(data: bytes) -> str:
        if solids.same_step(good["step"], data, SAME):
            return SAME_PART
        mended = solids.same_solid(tmp_path / "good.step", tmp_path / "x.step", SAME)
        return "passes, and the kernel mends it to the same solid" if mended else ""

    tally = attack(
        tmp_path,
        "x.step",
        good["step"],
        numbers,
        lambda number: solids.step_mutant(good["step"], number),
        excuse,
    )
    assert tally["failed"] + tally["unreadable"] >= len(numbers) // 4


@pytest.mark.parametrize("numbers", many(20))
def test_no_mutant_of_a_brep_file_is_more_than_answered(
    good: dict[str, bytes], tmp_path: Path, numbers: range
) -> None:
    tally = attack(tmp_path, "x.brep", good["brep"], numbers, lambda number: solids.brep_mutant(good["brep"], number),
                   lambda data: SAME_PART * solids.same_numbers(good["brep"], data, SAME))  # fmt: skip
    assert tally["failed"] + tally["unreadable"] >= len(numbers) // 4


MAPS = (
    "f32.tiff",
    "u16.tiff",
    "u16.png",
    "xyz",
    "cell.dat",
    "poses.csv",
    "surfaces.json",
    "tiff.json",
    "mask.svg",
    "mask.dxf",
    "gds",
)


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[str, bytes]]:
    """A file of every format of maps, tables and masks, by the end of its name."""
    pytest.importorskip("gdstk")
    folder = tmp_path_factory.mktemp("maps")
    export(
        tiny(),
        folder,
        formats=("sag", "tiff", "png", "xyz", "table", "mask", "gds"),
        grey_levels=8,
    )
    names = sorted(path.name for path in folder.iterdir())
    chosen = {end: next(name for name in names if name.endswith(f".{end}")) for end in MAPS}
    return {end: (name, (folder / name).read_bytes()) for end, name in chosen.items()}


@pytest.mark.ci_cases(
    "u16.tiff-tenth", "xyz-tenth", "cell.dat-tenth", "surfaces.json-tenth", "mask.dxf-tenth"
)
@pytest.mark.parametrize("numbers", many(40))
@pytest.mark.parametrize("end", MAPS)
def test_every_mutant_of_a_map_table_or_mask_is_answered(
    maps: dict[str, tuple[str, bytes]], tmp_path: Path, end: str, numbers: range
) -> None:
    """What numbers in them may be changed without notice is held by the tests of mutations of maps."""
    name, good = maps[end]
    began = sum(os.times()[:4])
    words = [answer(tmp_path, name, mutants.bytes_mutant(end, good, number)) for number in numbers]
    seconds = sum(os.times()[:4]) - began
    print(f"{end}: {len(numbers)} mutants, {seconds:.0f} s of processors: {dict(Counter(words))}")  # noqa: T201
    assert not [word for word in words if word.startswith(CRASH)]
