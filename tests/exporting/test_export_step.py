"""A STEP file is published only when kernel and text agree with the design; a changed one is caught."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import clacad
from clacad.exporting.run import FileDisagrees, UnreadableFile, WorkerDied, export
from clacad.exporting.step_record import compare_step, read, write
from clacad.sheet.volume_and_extent import body_volume
from clacad.sheet.window import Window
from clacad.storage.worker import Worker

DESIGNS = Path(__file__).parents[2] / "designs"
Made = tuple[Window, dict[str, Any], str]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    window = clacad.prescribe(clacad.load(DESIGNS / "tilted-seam.toml").with_cells((2, 2)))
    path = tmp_path_factory.mktemp("step") / "x.step"
    written = write(window, str(path), "fused")
    return window, written, path.read_text()


def held(made: Made, text: str, path: Path) -> tuple[str, ...]:
    window, written, _ = made
    path.write_text(text)
    return compare_step(
        written, read(str(path), window), window, body_volume(window, window.bodies[0]), path.name
    )


def test_the_good_file_passes_every_check(made: Made, tmp_path: Path) -> None:
    assert held(made, made[2], tmp_path / "x.step") == ("closed", "shape", "placement", "volume")


def scaled_points(text: str, factor: float) -> str:
    def longer(match: re.Match[str]) -> str:
        numbers = [repr(float(n) * factor) for n in match[2].split(",")]
        return f"{match[1]}({','.join(n if '.' in n else n + '.' for n in numbers)})"

    return re.sub(r"(CARTESIAN_POINT\('[^']*',)\(([^)]*)\)", longer, text)


def nth_point_moved(text: str, n: int, by: float) -> str:
    """Move the n-th point in space; parameter curves of two coordinates are recomputed by readers."""
    found = list(re.finditer(r"CARTESIAN_POINT\('[^']*',\(([^,]*),[^,]*,[^,]*\)\)", text))
    match = found[n % len(found)]
    return text[: match.start(1)] + repr(float(match[1]) + by) + text[match.end(1) :]


MUTATIONS: dict[str, Callable[[str], str]] = {
    "cut in half": lambda t: t[: len(t) // 2],
    "cut near the end": lambda t: t[: int(0.98 * len(t))],
    "inches": lambda t: scaled_points(t, 25.4),
    "metres": lambda t: scaled_points(t, 1e-3),
    "shrunk by 0.1 %": lambda t: scaled_points(t, 0.999),
    "nothing": lambda _: "hello",
    "empty": lambda _: "",
    "a weight changed": lambda t: re.sub(r"(RATIONAL_B_SPLINE_SURFACE\(\(\(1\.)0", r"\g<1>1", t, count=1),
    "a face left out": lambda t: re.sub(r"(CLOSED_SHELL\('[^']*',\()#\d+,", r"\1", t, count=1),
    "an edge turned": lambda t: re.sub(r"(ORIENTED_EDGE\('[^']*',\*,\*,#\d+,)\.T\.", r"\1.F.", t, count=1),
}


@pytest.mark.ci_cases("inches", "shrunk by 0.1 %", "a weight changed")
@pytest.mark.daily_cases("cut in half", "cut near the end", "nothing", "empty", "a face left out")
@pytest.mark.parametrize("what", MUTATIONS)
def test_a_changed_file_is_caught(made: Made, tmp_path: Path, what: str) -> None:
    changed = MUTATIONS[what](made[2])
    assert changed != made[2]
    with pytest.raises((FileDisagrees, UnreadableFile)):
        held(made, changed, tmp_path / "x.step")


@pytest.mark.parametrize("n", [5, 40, 150, 400, 900])
def test_one_coordinate_moved_by_a_micrometre_is_caught(made: Made, tmp_path: Path, n: int) -> None:
    with pytest.raises((FileDisagrees, UnreadableFile)):
        held(made, nth_point_moved(made[2], n, 1e-3), tmp_path / "x.step")


@pytest.mark.parametrize("override", ["law.eta=[-0.735,-0.735]", "law.delta=[0.02,0]"])
def test_the_file_of_another_design_is_caught(made: Made, tmp_path: Path, override: str) -> None:
    other = clacad.prescribe(
        clacad.load(DESIGNS / "tilted-seam.toml", overrides=[override]).with_cells((2, 2))
    )
    with pytest.raises(FileDisagrees):
        held((other, made[1], made[2]), made[2], tmp_path / "x.step")


@pytest.mark.slow
def test_a_kernel_that_dies_is_a_sentence_and_nothing_is_published(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Worker.run

    def killed(self: Worker, function: str, *arguments: Any, **options: Any) -> Any:
        name = "worker_tricks:segfault" if function.endswith(":read") else function
        given = () if function.endswith(":read") else arguments
        return real(self, name, *given, **options)

    monkeypatch.setattr(Worker, "run", killed)
    design = clacad.load(DESIGNS / "tilted-seam.toml")
    with pytest.raises(WorkerDied, match="segmentation fault") as caught:
        export(design, tmp_path, formats=("step",), cells=(2, 2))
    assert caught.value.exit_status == 70
    assert list(tmp_path.iterdir()) == []
