"""Same design, options and versions: the same bytes, wherever, whenever and on however many threads they are made."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from trust.running import environment

from clacad.exporting.formats.registry import words

WRITTEN = tuple(
    name
    for name in words()
    if name not in ("pins", "tool") and (name != "optiland" or find_spec("optiland") is not None)
)
"""Formats that this installation writes of one design: optiland is an extra that the tests do not bring, and a frame holds no
plates with pins (those: tests/exporting/test_fixture.py); no tool reaches tilted lenses (upright ones: tests/exporting/test_workshop.py)."""

DESIGN = """
format = 1
unit = "mm"
name = "B8 i=0.98"  # letters of two pieces and of two holes

[law]
eta = [-0.5, -1.0]
delta = [0.01, -0.02]
euler = [30.0, 0.0, 20.0]

[pair]
form = "plano"
separation = 10.0
thickness = [1.5, 1.5]
material = "PMMA"

[lattice]
pitch = 0.5
count = [2, 2]

[body]
border = 6.0
baffle = true
baffle_wall = 0.05

[tolerances]
decentre = "2 um"
rotation = "0.05 mrad"
"""

DRIVER = """
import sys
from clacad.cli import main
design, out, threads, *formats = sys.argv[1:]
few = ("--rays", "1024", "-q")
status = main(["export", design, "-o", f"{out}/files", "--format", ",".join(formats), "--quads", "4", "-q"])
assert status == 0, status
status = main(["verify", design, "--files", f"{out}/files", "-o", f"{out}/report", *few, "--pdf"][:None if %(pdf)r else -1])
assert status in (0, 1), status
study = ("-q", "--rays", "64", "--workers", threads)
assert main(["tolerance", design, "-o", f"{out}/tolerances", "--samples", "5", *study]) == 0
assert main(["sweep", design, "-o", f"{out}/sweep", "--vary", "law.eta.0=-0.5:-1:3", *study]) == 0
sys.stdout.write("ACCURACY")
assert main(["accuracy", design, "--json", "-q", "--rays", "400"]) == 0
"""

MEASURED = {
    "seconds", "prepare_s", "write_s", "read_s", "one_line_s", "traced_s", "closed_s", "designed_s", "made_s",
    "rays_per_s", "memory", "pareto",
    "conclusion",
}  # fmt: skip
"""Keys that `accuracy` reports of this machine at this moment; all others depend on the design alone."""


def made(place: Path, **changes: str) -> dict[str, bytes]:
    """Every file of every kind of work, by its path; the report of `accuracy`, less its seconds."""
    place.mkdir()
    (place / "home").mkdir()
    design = place / "design.toml"
    design.write_text(DESIGN)
    threads = changes["CLACAD_THREADS"]
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            DRIVER % {"pdf": has_typst()},
            str(design),
            str(place / "out"),
            threads,
            *WRITTEN,
        ],
        capture_output=True,
        text=True,
        cwd=place,
        env=environment(HOME=str(place / "home"), XDG_CACHE_HOME=str(place / "home"), **changes),
        timeout=2400,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.partition("ACCURACY")[2])
    files = {
        str(path.relative_to(place / "out")): path.read_bytes()
        for path in sorted((place / "out").rglob("*"))
        if path.is_file() and path.name != "run.json"
    }
    return files | {"accuracy": json.dumps(untimed(told), sort_keys=True).encode()}


def untimed(told: Any) -> Any:
    if isinstance(told, dict):
        return {key: untimed(value) for key, value in told.items() if key not in MEASURED}
    return [untimed(one) for one in told] if isinstance(told, list) else told


def has_typst() -> bool:
    return find_spec("typst") is not None


def assert_same(one: dict[str, bytes], other: dict[str, bytes]) -> None:
    assert one.keys() == other.keys()
    assert [name for name in one if one[name] != other[name]] == []


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Made in one environment, on one thread, with kernels that were compiled before."""
    place = tmp_path_factory.mktemp("one") / "place"
    return made(
        place, PYTHONHASHSEED="1", LANG="C.UTF-8", LC_ALL="C.UTF-8", TZ="UTC", CLACAD_THREADS="1", OMP_NUM_THREADS="1",
        OPENBLAS_NUM_THREADS="1", NUMBA_NUM_THREADS="1",
    )  # fmt: skip


ELSEWHERE = {
    "PYTHONHASHSEED": "2", "LANG": "C", "LC_ALL": "C", "TZ": "Pacific/Auckland", "CLACAD_THREADS": "2",
    "OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2", "NUMBA_NUM_THREADS": "2", "MALLOC_PERTURB_": "165",
}  # fmt: skip


@pytest.mark.long
@pytest.mark.timeout(6000)
def test_another_seed_folder_home_language_zone_and_two_threads_give_the_same_bytes(here, tmp_path):
    entries = json.loads(here["files/manifest.json"])
    assert set(entries["options"]["formats"]) == set(WRITTEN)
    assert len(entries["files"]) >= len(WRITTEN)
    assert_same(here, made(tmp_path / "a longer name of the place", **ELSEWHERE))


@pytest.mark.long
@pytest.mark.timeout(6000)
def test_kernels_compiled_in_that_very_run_give_the_same_bytes(here, tmp_path):
    assert_same(here, made(tmp_path / "cold", **ELSEWHERE, NUMBA_CACHE_DIR=str(tmp_path / "kernels")))
    assert list((tmp_path / "kernels").rglob("*.nbc"))
