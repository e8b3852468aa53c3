"""Every command's result fits 24 lines of 100 columns, begins and ends with the verdict; --all prints everything."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from measuring.test_calibrate import scanned
from trust.running import TINY

from clacad.checks.check import kinds
from clacad.cli import main
from clacad.cli.command import commands
from clacad.cli.console import COLUMNS, LINES, Brief, clipped, facts
from clacad.cli.option_values import command_line
from clacad.cli.tables import counted, problems

DESIGN = TINY.replace("count = [2, 2]", "count = [4, 4]").replace('"tiny"', '"small"')
DESIGN = DESIGN.replace("[-0.5, -1.0]", "[-1.0, -1.0]").replace("delta = [0.01, -0.02]\n", "")
DESIGN += '[tolerances]\ndecentre = "0.01 mm"\n'
SCENE = """format = 1
name = "view"
unit = "mm"
[sheet]
design = "slab.toml"
[camera]
position = [0, 0, -60]
frame = 2
pixels = [8, 6]
samples = 1
"""
DESIGNS = {
    "slab": DESIGN,
    "failing": DESIGN + '[check]\nlaw_rms = "0.01 mrad"\nlaw_bias = "1e-6 mrad"\nprocess = "moulding"\n',
    "round": DESIGN.replace("count = [4, 4]", "count = [8, 8]\noutline = {circle = 3.6}"),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, text in DESIGNS.items():
        (tmp_path / f"{name}.toml").write_text(text)
    (tmp_path / "pair.toml").write_text(DESIGN.replace('form = "slab"', 'form = "biconvex"'))
    (tmp_path / "points.csv").write_text("x,y\n0,0\n0.1,0.2\n")
    (tmp_path / "scene.toml").write_text(SCENE)
    down = np.array([[0.0, 0.0, 1.0]] * 3)
    np.savez(tmp_path / "rays.npz", position=-1e-3 * down, direction=down)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("COLUMNS", raising=False)
    return tmp_path


def fits(text: str, columns: int = COLUMNS) -> list[str]:
    """Lines of a result; a command that is to be copied keeps its words, however long."""
    lines = text.splitlines()
    assert 0 < len(lines) <= LINES, text
    long = [line for line in lines if len(line) > columns and len(line.split()) > 2]
    assert not long, long
    return lines


def result(capsys: pytest.CaptureFixture[str], *words: str, status: int = 0) -> str:
    """What a command prints; with its messages 24 lines, each message a line of the screen."""
    capsys.readouterr()
    assert main(list(words)) == status, capsys.readouterr()
    printed = capsys.readouterr()
    assert "--all" in words or len((printed.out + printed.err).splitlines()) <= 24
    assert [line for line in printed.err.splitlines() if len(line) > COLUMNS and len(line.split()) > 5] == []
    return printed.out


COMMANDS = [
    "explain", "explain law_rms", "explain diamond-turning", "explain combinations", "new --list",
    "new fresh --template slab", "effects slab.toml", "wave slab.toml", "wave slab.toml --dry-run", "image slab.toml",
    "stack slab.toml slab.toml --gap 5 --rays 1000", "stack slab.toml slab.toml --gap 5 --dry-run",
    "sweep slab.toml --vary pair.separation=6:12:3 --workers 1 --rays 64", "optimise slab.toml --dry-run",
    "export slab.toml -o out --dry-run", "export slab.toml -o out --format stl --quads 4", "explore slab.toml -o page.html",
    "trace slab.toml rays.npz -o out.npz", "shape points.csv --distance 100 --design slab.toml -o shaped.toml --rays 64",
    "render scene.toml -o view.png", "effects scene.toml", "image slab.toml --object 0,0,-100",
    "steer pair.toml --travel 0.05mm --positions 3 --rays 256 --no-waves", "verify slab.toml --rays 4096", "tolerance slab.toml --samples 8 --rays 64 --workers 1",
]  # fmt: skip
SLOW = [
    "doctor", "accuracy --hard", "accuracy slab.toml --rays 1000 --target 2mrad",
    "atlas --rows F1 --out atlas --size 32 --samples 1 --no-movies", "export slab.toml -o out --format step,3mf,glb", "optimise slab.toml -o better.toml --compare page.html --seconds 2",
    "new wished --for eta=-1,width=5mm,viewing=1m",
]  # fmt: skip
CHECKED = {"check", "schema", "calibrate", "correct"}
"""Commands of tests of their own, and the one whose result is a JSON document."""


def test_every_command_is_among_those_that_fit() -> None:
    assert {one.word for one in commands()} == {one.split()[0] for one in [*COMMANDS, *SLOW]} | CHECKED


@pytest.mark.ci_cases(
    "effects slab.toml-round",
    "wave slab.toml-failing",
    "image slab.toml-round",
    "export slab.toml -o out --dry-run-failing",
    "export slab.toml -o out --format stl --quads 4-round",
    "explore slab.toml -o page.html-failing",
    "verify slab.toml --rays 4096-failing",
    "tolerance slab.toml --samples 8 --rays 64 --workers 1-round",
)
@pytest.mark.slow
@pytest.mark.parametrize("design", ["failing", "round"])
@pytest.mark.parametrize("words", [one for one in COMMANDS if "slab.toml" in one])
def test_a_result_of_another_design_fits(words: str, design: str, folder: Path, capsys) -> None:
    failed = design == "failing" and words.startswith("verify")
    fits(result(capsys, *words.replace("slab.toml", f"{design}.toml").split(), status=int(failed)))


@pytest.mark.ci_cases(
    "effects slab.toml",
    "wave slab.toml",
    "sweep slab.toml --vary pair.separation=6:12:3 --workers 1 --rays 64",
    "export slab.toml -o out --format stl --quads 4",
    "render scene.toml -o view.png",
    "steer pair.toml --travel 0.05mm --positions 3 --rays 256 --no-waves",
    "tolerance slab.toml --samples 8 --rays 64 --workers 1",
    "accuracy slab.toml --rays 1000 --target 2mrad",
    "optimise slab.toml -o better.toml --compare page.html --seconds 2",
)
@pytest.mark.daily_cases(
    "explain",
    "explain law_rms",
    "explain diamond-turning",
    "explain combinations",
    "new --list",
    "wave slab.toml --dry-run",
    "optimise slab.toml --dry-run",
    "trace slab.toml rays.npz -o out.npz",
)
@pytest.mark.parametrize("words", [*COMMANDS, *(pytest.param(one, marks=pytest.mark.slow) for one in SLOW)])
def test_a_result_fits_and_all_has_the_rest(words: str, folder: Path, capsys) -> None:
    brief = result(capsys, *words.split())
    fits(brief)
    whole = result(
        capsys,
        *words.split(),
        "--all",
        *(["--overwrite"] if {"-o", "fresh", "wished"} & set(words.split()) else []),
    )
    assert len(whole.split()) + 30 >= len(brief.split())
    assert "--all" not in whole


@pytest.mark.slow
@pytest.mark.parametrize("design", ["slab", "failing", pytest.param("round", marks=pytest.mark.slow)])
def test_check_begins_and_ends_with_the_verdict(design: str, folder: Path, capsys, monkeypatch) -> None:
    monkeypatch.setattr("clacad.advice.hints.TRIALS", 2)
    status = int(design == "failing")
    lines = fits(result(capsys, "check", f"{design}.toml", "--set", "law.delta=[0, 0]", status=status))
    whole = result(capsys, "check", f"{design}.toml", "--all", status=status).splitlines()
    verdict = whole[-1]
    assert lines[0].startswith(f"small: {verdict}"[:90])
    assert lines[-1].startswith(verdict[:30])
    assert ": checks passed: " in lines[-1]
    assert lines[-1].endswith("(all numbers: --all)")
    assert len(whole) > 80
    following = next(line for line in lines if line.startswith("next: clacad "))
    assert f"{design}.toml --set 'law.delta=[0, 0]'" in following
    assert ("--fix" in following) == bool(status)


@pytest.mark.slow
def test_a_calibration_fits(folder: Path, capsys) -> None:
    np.save(folder / "wedge.npy", scanned(0.01))
    (folder / "wedge.npy.json").write_text('{"pixel_um": 4, "z_step_um": 1e6, "row_0": "bottom"}')
    lines = fits(result(capsys, "calibrate", "wedge.npy", "-o", "dose.csv"))
    assert any("17 levels" in line for line in lines)


@pytest.mark.slow
def test_verify_begins_and_ends_with_the_verdict(folder: Path, capsys) -> None:
    result(capsys, "export", "slab.toml", "-o", "out", "--format", "step")
    lines = fits(result(capsys, "verify", "slab.toml", "--files", "out", "--rays", "4096"))
    assert lines[0].startswith("small: passed as optical master: small.step")
    assert lines[-1].startswith("passed as optical master: small.step")
    assert any(line.startswith("  small.step") for line in lines)


@pytest.mark.slow
def test_tolerance_ends_with_the_yield_and_says_what_tightening_gives(folder: Path, capsys) -> None:
    words = (
        "tolerance",
        "slab.toml",
        "--samples",
        "100",
        "--workers",
        "1",
        "--set",
        'check.law_bias="0.6 mrad"',
    )
    lines = fits(result(capsys, *words))
    assert lines[0].startswith("small: yield ")
    assert lines[-1].startswith("yield ")
    assert any("tighten" in line and "from 0.01 mm to 0.006 mm: yield" in line for line in lines)


@pytest.mark.slow
def test_accuracy_concludes_in_one_sentence(folder: Path, capsys) -> None:
    lines = fits(result(capsys, "accuracy", "slab.toml", "--rays", "1000"))
    whole = result(capsys, "accuracy", "slab.toml", "--rays", "1000", "--all")
    assert "conclusion: " in whole
    assert " ".join(lines).replace(" ... ", " ").count(". ") == 0


def test_the_list_of_explanations_names_every_kind(capsys) -> None:
    brief = result(capsys, "explain")
    assert all(
        kind in brief for kind in ("codes", "checks", "words", "material", "command", "effect", "process")
    )


def test_quiet_counts_before_and_after_the_command(folder: Path, capsys) -> None:
    assert result(capsys, "-q", "explain", "law_rms") == result(capsys, "explain", "law_rms", "-q") == ""
    assert result(capsys, "--all", "explain") == result(capsys, "explain", "--all")


# -- hostile results -----------------------------------------------------------------------------------------


def many(name: str) -> Brief:
    """Twelve failures and ten warnings, with texts of hundreds of characters."""
    known = [kind for kind in kinds().values() if kind.do][:32]
    states = ["warn"] * 10 + ["pass"] * 10 + ["fail"] * 12
    checks = [
        kind.check(state, f"{kind.means} " * 4, 1.0 / 3.0, 0.25, subject="linse \u00e4\u4e2d" * 3)  # type: ignore[arg-type]
        for kind, state in zip(known, states, strict=True)
    ]
    files = facts(
        [(f"{name}-{n}.stl", "500 MB", "optical master", "light 2.74 of 3 mrad rms") for n in range(9)]
    )
    word = "verify will fail: " + ", ".join(check.id for check in checks if check.state == "fail")
    rows = facts([("sheet", "a slab of many cells"), ("law", "eta -1")])
    return Brief(
        f"{name}: {word}",
        (rows, problems(checks), files),
        ("clacad check x.toml --fix",),
        word,
        counted(checks),
    )


@pytest.mark.parametrize("columns", ["40", "100", "300", "3"])
@pytest.mark.parametrize("name", ["x", "n" * 150, "\u4e2d\u6587" * 30], ids=["short", "long", "wide"])
def test_many_problems_fit(columns: str, name: str, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    lines = fits(str(many(name)), min(COLUMNS, max(20, int(columns))))
    assert "verify will fail" in " ".join(lines[:2]) or len(name) > 40 or int(columns) < 40
    assert (lines[-1][:17], "--all" in lines[-1]) == ("verify will fail:", True) or int(columns) < 100
    assert any("FAIL" in line for line in lines)
    assert any(
        line.lstrip().startswith(("15", "16", "17", "18", "19", "20", "21")) and "more" in line
        for line in lines
    )


def test_the_first_problems_are_failures_with_remedies_and_no_remedy_is_cut_where_there_is_room() -> None:
    text = str(many("x"))
    assert text.index("FAIL") < text.index("remedy: ")
    assert "warning " not in text[: text.index("FAIL")]
    few = Brief("a: fails", (problems([kinds()["wall"].check("fail", "too high", 2.0, 1.0)]),), (), "fails")
    assert kinds()["wall"].do.split()[-1] in str(few)
    assert "..." not in str(few)


def test_a_command_to_run_next_is_never_cut(monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    changes = ("lattice.count=[8, 8]", "design.name='a b'")
    command = command_line(
        "clacad verify", f"{'/long' * 40}/d.toml", "--files", "/other" * 30, changes=changes
    )
    assert shlex.split(command)[3:7] == ["--set", changes[0], "--set", changes[1]]
    *broken, last = str(Brief("x", (), (command,), "")).splitlines()[1:-1]
    assert all(line.endswith(" \\") for line in broken), broken
    pasted = "\n".join([*broken, last]).replace("next: ", "printf '%s\\n' ", 1)
    ran = subprocess.run(["sh", "-c", pasted], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines() == shlex.split(command)


def test_any_text_is_clipped(monkeypatch) -> None:
    text = "\n".join(f"row {n}  {'word ' * 60}" for n in range(300))
    for columns in ("100", "40"):
        monkeypatch.setenv("COLUMNS", columns)
        lines = fits(clipped(text + "\nverdict"), int(columns))
        assert lines[-1] == "verdict"
        assert "281 more lines: --all" in lines[-2]
    assert clipped("short\ntext") == "short\ntext"
    assert clipped("") == ""


@pytest.mark.slow
def test_a_closed_pipe_and_no_colour(folder: Path) -> None:
    command = f"{sys.executable} -m clacad explain | true; echo ${{PIPESTATUS[0]}}"
    ended = subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, env=os.environ | {"NO_COLOR": "1"}
    )
    assert ended.stdout == "0\n"
    assert "Traceback" not in ended.stderr
    assert "\x1b" not in ended.stderr
