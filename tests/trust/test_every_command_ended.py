"""Commands killed or ended by a signal at any instant: their output is whole or not there, and the next run is as if alone."""

from __future__ import annotations

import io
import shutil
import signal
import subprocess
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from trust.running import ROOT, TINY, command, environment
from trust.test_interruptions import HANG, until

from clacad import Design
from clacad.cli.entry_point import SENTENCE


@dataclass(frozen=True)
class Line:
    """A command: its words, `{}` the folder of what is given, and the files it writes under `out`.

    resumes : names of files that a run which was ended may leave there to go on from
    best : names of files in which such a run may leave the best design it had found
    coarse : names of pictures that are written coarse, and marked so, until they are drawn fine
    """

    words: tuple[str, ...]
    writes: tuple[str, ...] = ()
    resumes: tuple[str, ...] = ()
    best: tuple[str, ...] = ()
    coarse: tuple[str, ...] = ()


LINES = {
    "trace": Line(("trace", "{}/t.toml", "{}/rays.npz", "-o", "out/traced.npz"), ("traced.npz",)),
    "check": Line(("check", "{}/t.toml", "--set", "check.law_rms=1 mrad", "--fix", "-o", "out/better.toml"), ("better.toml",)),
    "verify": Line(("verify", "{}/t.toml", "--rays", "256", "-o", "out"), ("report.html", "report.json")),
    "accuracy": Line(("accuracy", "{}/t.toml", "--rays", "400", "-o", "out/plot.svg"), ("plot.svg",)),
    "tolerance": Line(("tolerance", "{}/t.toml", "--samples", "6", "--rays", "64", "-o", "out"),
                      ("tolerances.json", "tolerances.csv", "tolerances.png"), ("tolerances.checkpoint",)),
    "sweep": Line(("sweep", "{}/t.toml", "--vary", "lattice.pitch=0.4:0.6:4", "--rays", "64", "-o", "out"),
                  ("sweep.csv", "sweep.png"), ("sweep.checkpoint",)),
    "render": Line(("render", "{}/t.toml", "{}/photo.png", "--preset", "eye", "--pixels", "48", "--samples", "4", "-o", "out/x.png"),
                   ("x.png",), coarse=("x.png",)),
    "atlas": Line(("atlas", "-o", "out", "--scenes", f"{ROOT}/designs/scenes", "--rows", "F2", "--size", "32", "--samples", "1",
                   "--no-movies", "--no-measure")),
    "new": Line(("new", "out/fresh"), ("fresh.toml", "clacad.schema.json")),
    "new for": Line(("new", "out/wished", "--for", "eta=-1, width=5, process=moulding"), ("wished.toml", "clacad.schema.json")),
    "effects": Line(("effects", "{}/t.toml", "--exact-bounds")),
    "optimise": Line(("optimise", "{}/t.toml", "--free", "radii,conic", "-o", "out/better.toml", "--compare", "out/page.html"),
                     ("better.toml", "page.html"), (), ("better.toml",)),
    "stack": Line(("stack", "{}/t.toml", "{}/t.toml", "--gap", "3", "--rays", "256", "--quads", "2", "-o", "out"),
                  ("stack.step", "stack.glb", "stack.json", "manifest.json")),
    "image": Line(("image", "{}/t.toml", "--rays", "4096", "-o", "out/focus.png"), ("focus.png",)),
    "shape": Line(("shape", "{}/photo.png", "--distance", "300", "--cells", "20x20", "--rays", "4096", "-o", "out/shaped.toml"),
                  ("shaped.toml", "shaped.cells.csv", "shaped.png")),
    "explore": Line(("explore", "{}/t.toml", "-o", "out/page.html"), ("page.html",)),
    "wave": Line(("wave", "{}/t.toml", "-o", "out/wave.png"), ("wave.png",)),
    "export": Line(("export", "{}/t.toml", "--format", "stl,table", "--quads", "4", "-o", "out"), ("tiny.stl",)),
}  # fmt: skip


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What commands are given: a design, rays, a picture."""
    folder = tmp_path_factory.mktemp("given")
    (folder / "t.toml").write_text(f'{TINY}\n[tolerances]\ndecentre = "5 um"\nradius = 0.005\n')
    rays = np.random.default_rng(0).uniform(-0.4, 0.4, (20_000, 3)) * [1, 1, 0] - [0, 0, 1]
    np.savez(folder / "rays.npz", position=rays, direction=np.tile([0.0, 0.0, 1.0], (len(rays), 1)))
    Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3)).save(folder / "photo.png")
    return folder


def run(line: Line, given: Path, place: Path, *more: str) -> subprocess.Popen[str]:
    (place / "out").mkdir(exist_ok=True)
    (place / "scratch").mkdir(exist_ok=True)
    words = [*(word.format(given) for word in line.words), *more]
    return subprocess.Popen(
        command([*words, *(["--overwrite"] if line.writes and line.words[0] not in ("tolerance", "sweep") else [])]),
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=place, env=environment(TMPDIR=str(place / "scratch")),
    )  # fmt: skip


def files(place: Path) -> dict[str, bytes]:
    """Files under the final names."""
    found = (path for path in (place / "out").rglob("*") if path.is_file())
    return {
        path.relative_to(place / "out").as_posix(): path.read_bytes()
        for path in found
        if not any(part.startswith(".clacad-") for part in path.relative_to(place / "out").parts)
    }


CHANGING = ("run.json",)
"""Names of files that describe the run itself, and are others every time."""


def held(made: dict[str, bytes], whole: dict[str, bytes], line: Line) -> None:
    """Every file is, byte for byte, one of an undisturbed run; but for those that a run goes on from."""
    for name, data in made.items():
        if name in line.resumes or name.endswith(CHANGING):
            continue
        assert name in whole, f"{name} is no file of an undisturbed run"
        if name in line.best and b"stopped on the way" in data:
            assert Design.from_dict(tomllib.loads(data.decode())).pair.given
            continue
        if name in line.coarse and b"the whole view in blocks of 8" in data:
            with Image.open(io.BytesIO(data)) as coarse, Image.open(io.BytesIO(whole[name])) as fine:
                assert coarse.size == fine.size
            continue
        assert data == whole[name], f"{name} is not what an undisturbed run writes"


PATIENCE = 1200.0
"""Seconds that an undisturbed command may take on a machine that is busy with much else."""

DEAR = ("verify", "accuracy")
"""Half a minute each: only by hand."""

TIMES = 13
"""Kills, and as many interrupts, of each command by hand: over the eight commands that were added last 104 of each."""

BY_HAND = ("atlas", "effects", "new for", "optimise", "stack", "tolerance", "sweep")
"""A third of a minute and more; kills of `tolerance` and `sweep` are tested elsewhere, too."""

CASES = [
    *(
        pytest.param(
            name, 2, marks=pytest.mark.long if name in BY_HAND else pytest.mark.slow, id=f"{name}, a few"
        )
        for name in LINES
        if name not in DEAR
    ),
    *(
        pytest.param(name, TIMES, marks=[pytest.mark.long, pytest.mark.timeout(3600)], id=name)
        for name in LINES
    ),
]


@pytest.mark.ci_cases("trace, a few", "image, a few", "shape, a few", "export, a few")
@pytest.mark.parametrize(("name", "times"), CASES)
def test_a_command_ended_at_any_instant_leaves_whole_files_and_the_next_run_no_trace(
    given: Path, tmp_path: Path, name: str, times: int
) -> None:
    """Kills and signals in turn; the files of a command that record no time are the same bytes every time."""
    line = LINES[name]
    span = 0.0
    for _ in range(2):  # the first may have kernels to compile: instants are drawn from what the second takes
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        began = time.monotonic()
        undisturbed = run(line, given, tmp_path)
        _, said = undisturbed.communicate(timeout=PATIENCE)
        span = time.monotonic() - began
        assert undisturbed.returncode in (0, 1), said
    whole = files(tmp_path)
    assert set(line.writes) <= set(whole)
    timed = name in ("accuracy",)
    chance, kills, signals, early = np.random.default_rng(len(name)), 0, 0, 0
    for turn, number in enumerate([signal.SIGKILL, signal.SIGINT] * times + [signal.SIGTERM] * (times // 4)):
        if turn % 3 == 0:
            shutil.rmtree(tmp_path / "out")
        if number == signal.SIGKILL:
            running, wait = run(line, given, tmp_path), 1.05 * span
        else:  # before it has begun the interpreter itself answers
            running, wait = run(line, given, tmp_path, "-v"), 0.8 * span
            until(running, '"start"')
        instant = time.monotonic() + float(chance.uniform(0.0, wait))
        while running.poll() is None and time.monotonic() < instant:
            time.sleep(0.002)
        early += running.poll() is None
        running.send_signal(number)
        _, said = running.communicate(timeout=HANG)
        assert "Traceback" not in said
        if number == signal.SIGKILL:
            kills += 1
        else:
            signals += 1
            ended = (running.returncode, said.count(SENTENCE))
            late = '"event": "end"' in said  # nobody listens any more: the system ends what is left
            assert ended in ((130, 1), (undisturbed.returncode, 0), *([(-number, 0)] if late else [])), said
        if not timed:
            held(files(tmp_path), whole, line)
    print(f"{name}: {kills} kills, {signals} signals, {early} of them before it had ended")  # noqa: T201
    last = run(line, given, tmp_path)
    last.communicate(timeout=PATIENCE)
    assert last.returncode == undisturbed.returncode
    assert set(files(tmp_path)) - set(line.resumes) == set(whole) - set(line.resumes)
    assert not [path.name for path in (tmp_path / "out").rglob(".clacad-*")]
    assert not list((tmp_path / "scratch").iterdir())
