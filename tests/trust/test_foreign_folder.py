"""Files in the folder a command is started in: they are data, nothing of them is ever run or obeyed."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from trust.running import ROOT, TESTS, TINY, environment

import clacad
from clacad.storage.worker import module_path, safe_children

TRAP = "open({marker!r}, 'a').write({name!r} + '\\n')\nraise ImportError('planted')\n"


@pytest.fixture
def trapped(tmp_path: Path) -> Path:
    """A folder with a design and a planted module for every name of Python's own and of every installed package."""
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "t.toml").write_text(TINY + '[tolerances]\ndecentre = "5 um"\n')
    ours = {"clacad", *(p.stem for p in (*TESTS.glob("*.py"), *(TESTS / "offline").glob("*.py")))}
    for name in {*sys.stdlib_module_names, *packages_distributions()} - ours:
        if name.isidentifier():
            (folder / f"{name}.py").write_text(TRAP.format(marker=str(tmp_path / "run"), name=name))
    (tmp_path / "clacad").write_text(
        "from clacad.__main__ import main\nif __name__ == '__main__':\n    main()\n"
    )
    return folder


def taken_before_any_program(folder: Path) -> set[str]:
    """Modules that Python itself loads from the current folder for `-m`, before a line of any program is run."""
    folder.mkdir()
    (folder / "probe.py").write_text("import sys; print(*sys.modules)")
    told = subprocess.run(
        [sys.executable, "-m", "probe"], cwd=folder, capture_output=True, text=True, check=True
    )
    return set(told.stdout.split())


def free_of_those(trapped: Path) -> None:
    """Take away the planted modules of these names: `python -P -m` and the script `clacad` do not run them."""
    for name in taken_before_any_program(trapped.parent / "elsewhere"):
        (trapped / f"{name}.py").unlink(missing_ok=True)


def ended(words: list[str], folder: Path) -> tuple[int, str, list[str]]:
    """Status and error stream of a program in the folder, and the planted modules that were run."""
    marker = folder.parent / "run"
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, capture_output=True, text=True, env=environment(), timeout=240
    )
    return done.returncode, done.stderr, marker.read_text().split() if marker.exists() else []


HEAVY = [
    pytest.param("export t.toml -o out --format step,stl -q", id="export"),
    pytest.param(
        "tolerance t.toml --samples 4 --rays 64 --workers 2 -q", id="tolerance", marks=pytest.mark.slow
    ),
    pytest.param("verify t.toml --rays 64 -o page -q", id="verify", marks=pytest.mark.slow),
]


@pytest.mark.ci_cases("export", "tolerance")
@pytest.mark.slow
@pytest.mark.parametrize("line", ["check t.toml -q", *HEAVY])
def test_the_command_runs_no_module_of_the_folder_and_neither_do_its_children(
    trapped: Path, line: str
) -> None:
    status, said, ran = ended([str(trapped.parent / "clacad"), *line.split()], trapped)
    assert (ran, "Traceback" in said) == ([], False)
    assert status in ((0, 1) if "verify" in line else (0,)), said


@pytest.mark.slow
@pytest.mark.parametrize("line", ["check t.toml -q", *HEAVY[:2]])
def test_started_as_a_module_it_runs_none_either_but_what_python_takes_itself(
    trapped: Path, line: str
) -> None:
    free_of_those(trapped)
    status, said, ran = ended(["-m", "clacad", *line.split()], trapped)
    assert (status, ran) == (0, []), said


@pytest.mark.slow
def test_who_works_on_a_cluster_runs_none_either(trapped: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="a cluster is an extra")
    free_of_those(trapped)
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        line = f"tolerance t.toml --samples 4 --rays 64 --scheduler {cluster.scheduler_address} -q"
        status, said, ran = ended(["-m", "clacad", *line.split()], trapped)
    assert (status, ran) == (0, []), said


@pytest.mark.slow
def test_the_package_is_found_where_it_lies_in_the_current_folder_itself(tmp_path: Path) -> None:
    """A checkout that nobody installed: the folder is searched last, not first."""
    (tmp_path / "clacad").symlink_to(ROOT / "clacad")
    watch = tmp_path / "watch"
    watch.mkdir()
    (watch / "sitecustomize.py").write_text(
        "import atexit, sys; atexit.register(lambda: print(sys.path.index(sys.argv[-1]), len(sys.path)))"
    )
    done = subprocess.run([sys.executable, "-m", "clacad", "doctor", "--json", str(tmp_path)], cwd=tmp_path, capture_output=True, text=True,
                          env=environment(PYTHONPATH=str(watch)))  # fmt: skip
    at, length = done.stdout.splitlines()[-1].split()
    assert int(at) == int(length) - 1, done.stderr


def test_children_look_for_modules_where_the_parent_does_but_in_the_current_folder(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    home = str(Path(clacad.__file__).parents[1])
    monkeypatch.setattr(sys, "path", ["", "/somewhere"])
    assert module_path() == ["/somewhere", home]
    monkeypatch.setattr(sys, "path", [home, "", "/somewhere"])
    assert module_path() == [home, "/somewhere"]


@pytest.mark.parametrize("before", [None, "", "yes"])
def test_the_environment_is_as_it_was_once_the_children_are_started(
    monkeypatch: pytest.MonkeyPatch, before: str | None
) -> None:
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    if before is not None:
        monkeypatch.setenv("PYTHONSAFEPATH", before)
    with safe_children():
        assert os.environ["PYTHONSAFEPATH"]
    assert os.environ.get("PYTHONSAFEPATH") == before


def told_in(folder: Path, code: str) -> str:
    """What code prints that runs in a folder."""
    line = [sys.executable, "-P", "-c", code]
    done = subprocess.run(
        line, cwd=folder, capture_output=True, text=True, env=environment(), check=True, timeout=240
    )
    return done.stdout


@pytest.mark.slow
def test_the_compiler_s_settings_in_the_folder_are_not_obeyed(tmp_path: Path) -> None:
    """They could name the folder that machine code is loaded from."""
    pytest.importorskip("yaml", reason="without it the compiler reads no settings")
    settings = tmp_path / ".numba_config.yaml"
    code = (
        "from clacad.base import compiled; import numba; numba.njit(lambda x: x)(1)\n"
        "print(numba.config.CACHE_DIR, numba.config.DISABLE_JIT)"
    )
    settings.write_text("cache_dir: evil\ndisable_jit: 1\n")
    assert told_in(tmp_path, code) == f"{os.environ.get('NUMBA_CACHE_DIR', '')} 0\n"
    settings.write_text("- no mapping")
    assert told_in(tmp_path, code) == f"{os.environ.get('NUMBA_CACHE_DIR', '')} 0\n"
    assert [p.name for p in tmp_path.iterdir()] == [".numba_config.yaml"]


@pytest.mark.slow
def test_a_figure_is_drawn_by_no_settings_of_the_folder_or_the_user(tmp_path: Path) -> None:
    code = (
        "from clacad.base.drawn_figure import drawn; import hashlib\n"
        "draw = lambda figure: figure.subplots().plot([1, 2], label='x')\n"
        "print(*(hashlib.sha256(drawn(kind, (3, 2), draw, {})).hexdigest() for kind in ('png', 'svg')))"
    )
    clean, home, foreign, spoiled = (tmp_path / name for name in ("clean", "home", "foreign", "spoiled"))
    for folder in (clean, home, foreign, spoiled):
        folder.mkdir()
    plain = told_in(clean, code.replace("{}", "{'svg.hashsalt': ''}"))
    rules = "axes.facecolor: red\nlines.linewidth: 9\nbackend: module://json\n"
    (foreign / "matplotlibrc").write_text(rules)
    os.mkfifo(spoiled / "matplotlibrc")
    (home / "matplotlibrc").write_text(rules)
    code = code.replace("{}", "{'svg.hashsalt': ''}")
    assert told_in(foreign, code) == plain
    assert told_in(spoiled, code) == plain
    user = f"import os; os.environ['MATPLOTLIBRC'] = {str(home)!r}\n"
    assert told_in(clean, user + code) == plain
