"""Results as tables: columns, numpy records, DataFrames, HTML; progress as bars; designs by name."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from multiprocessing.spawn import get_preparation_data
from pathlib import Path
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest

import clacad
from clacad.base import interactive
from clacad.base.interactive import Bar, Tabular, shown_progress
from clacad.base.types import silent
from clacad.verification.accuracy.accuracy_row import AccuracyRow, AccuracyTable
from clacad.verification.tolerance.farm import Farm, _no_script

ROOT = Path(__file__).parents[1]
SMALL = ["lattice.count = [3, 3]"]


@pytest.fixture(scope="module")
def design() -> clacad.Design:
    return clacad.load("slab", SMALL)


@pytest.fixture(scope="module")
def results(design: clacad.Design) -> dict[str, Tabular]:
    """One result of each kind that takes little time."""
    window = clacad.prescribe(design)
    rays = clacad.Rays((0.0, 0.0, -1.0), [[0.01, 0.0, 1.0]] * 12)
    row = AccuracyRow("thin", "exact", 1e-3, 2e-3, float("nan"), 1e-3, 2e-3, 0.0, 0.5, 0.0, 10, 10)
    stacked = clacad.stack([design, design], 1.0, rays=64)
    toleranced = design.replace("tolerances.decentre", "5 um")
    return {
        "trace": clacad.trace(window, rays, path="numpy"),
        "image": clacad.image(window, (0.0, 0.0, -100.0), ("law", "thin"), 256),
        "stacked": stacked,
        "stack": stacked.stack,
        "accuracy": AccuracyTable("slab", (row,), {}, rays=10),
        "check": clacad.check(design),
        "sweep": clacad.sweep(design, {"law.eta.0": [-1, -2]}, 64, Farm(1)),
        "tolerance": clacad.tolerance(toleranced, 4, 0, 64, Farm(1)),
    }


def test_every_result_converts_and_shows_itself(results):
    rows = {"trace": 12, "image": 2, "stacked": 3, "stack": 2, "accuracy": 1, "sweep": 2, "tolerance": 4}
    for name, result in results.items():
        columns = result.to_columns()
        assert {len(values) for values in columns.values()} == {
            rows.get(name, len(columns["id"]) if "id" in columns else 0)
        }
        assert np.asarray(result).dtype.names == tuple(columns)
        html = result._repr_html_()
        ElementTree.fromstring(html)
        assert html == result._repr_html_()
        assert "<table>" in html


def test_columns_hold_the_numbers_of_the_result(results):
    trace = results["trace"]
    assert (trace.to_columns()["direction_x"] == trace.direction[:, 0]).all()
    assert set(trace.to_columns()["fate"]) == {"ALIVE"}
    assert "2 more rows" in trace._repr_html_()
    assert results["image"].to_columns()["share"] == [one.share for one in results["image"].rungs]
    assert results["accuracy"].to_dict()["rows"][0]["model_max"] is None
    study = results["tolerance"]
    assert (study.to_columns()["law_rms"] == study.column("law_rms")).all()
    assert results["sweep"].to_columns()["law.eta.0"] == [-1, -2]


@pytest.mark.slow
def test_a_check_is_a_short_table_with_its_verdict_last(design, results, monkeypatch):
    monkeypatch.setattr("clacad.advice.hints.TRIALS", 2)
    first, *_, last = repr(results["check"]).splitlines()
    assert (first, last) == ("slab", results["check"].verdict())
    bad = repr(clacad.check(design.replace("check.law_rms", "1 urad")))
    assert "\n  fail  law_rms  " in bad
    assert "verify will fail: law_rms" in bad.splitlines()[-1]


@pytest.mark.slow
def test_axes_of_a_sweep_may_be_texts(design, results):
    again = clacad.sweep(design, ["law.eta.0=-1,-2"], 64, Farm(1))
    assert again.to_columns()["law_rms"] == results["sweep"].to_columns()["law_rms"]


@dataclass
class Library(ModuleType):
    """A library of DataFrames that keeps what it is given."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.DataFrame = lambda columns, **options: (name, columns)


def test_frames_are_those_of_the_library_installed(results, monkeypatch):
    trace = results["trace"]
    monkeypatch.setattr(interactive, "find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match="pandas and polars not installed"):
        trace.to_frame()
    monkeypatch.setitem(sys.modules, "polars", Library("polars"))
    monkeypatch.setattr(interactive, "find_spec", lambda name: name == "polars" or None)
    name, columns = trace.to_frame()
    assert name == "polars"
    assert list(columns) == list(trace.to_columns())
    with pytest.raises(ModuleNotFoundError, match="pandas not installed"):
        trace.to_frame("pandas")


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_a_frame_has_the_columns_and_the_rows(library, results):
    pytest.importorskip(library)
    for result in results.values():
        frame = result.to_frame(library)
        assert list(frame.columns) == list(result.to_columns())
        assert frame.shape[0] == len(next(iter(result.to_columns().values())))


def test_progress_is_a_bar_at_a_prompt_and_silent_in_a_program(monkeypatch):
    own = lambda stage, done: None  # noqa: E731
    assert shown_progress(own) is own
    monkeypatch.delattr(sys, "ps1", raising=False)
    assert shown_progress(None) is silent
    monkeypatch.setattr(sys, "ps1", ">>> ", raising=False)
    monkeypatch.setattr(interactive, "find_spec", lambda name: None)
    assert shown_progress(None) is silent
    calls: list[tuple[str, float]] = []
    bar = SimpleNamespace(n=0.0, set_description_str=lambda text, refresh: calls.append((text, bar.n)),
                          refresh=lambda: calls.append(("", bar.n)), close=lambda: calls.append(("closed", bar.n)))  # fmt: skip
    tqdm = ModuleType("tqdm.auto")
    tqdm.tqdm = lambda **options: bar  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "tqdm.auto", tqdm)
    monkeypatch.setattr(interactive, "find_spec", lambda name: name == "tqdm" or None)
    shown = shown_progress(None)
    shown("tracing", 0.25)
    shown("publish", float("nan"))
    del shown
    assert calls == [("tracing", 0.0), ("", 0.25), ("publish", 0.25), ("", 0.0), ("closed", 0.0)]


def test_a_bar_of_rich_is_removed_when_closed(monkeypatch, capsys):
    pytest.importorskip("rich")
    monkeypatch.setattr(interactive, "find_spec", lambda name: name == "rich" or None)
    bar = Bar()
    live = bar._rich
    bar("tracing", 0.5)
    assert live.tasks[0].completed == 0.5
    assert live.tasks[0].description == "tracing"
    bar.close()
    bar("tracing", 0.6)
    assert not live.live.is_started


def test_shipped_designs_and_templates_load_by_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert clacad.load("fig3") == clacad.load(ROOT / "designs" / "fig3.toml")
    window = clacad.load("window", ["lattice.count = [2, 2]"])
    assert (window.name, window.lattice.count) == ("window", (2, 2))
    (tmp_path / "fig3").write_text("format = 1\n", encoding="utf-8")
    with pytest.raises(clacad.DesignError):  # a file of the name comes first
        clacad.load("fig3")
    with pytest.raises(clacad.DesignError, match="nosuch"):
        clacad.load("nosuch")


def test_new_processes_are_not_told_of_the_script(monkeypatch):
    script = ModuleType("__main__")
    script.__file__ = "/somewhere/program.py"
    monkeypatch.setitem(sys.modules, "__main__", script)
    assert "init_main_from_path" in get_preparation_data("worker")
    with _no_script():
        assert "init_main_from_path" not in get_preparation_data("worker")
    assert sys.modules["__main__"] is script


@pytest.mark.slow
def test_workers_do_not_run_the_script_again(tmp_path):
    """A program without ``if __name__ == "__main__"`` that sweeps with two processes."""
    import subprocess

    program = tmp_path / "program.py"
    program.write_text(
        "import clacad\nfrom clacad.verification.tolerance import Farm\nprint('once')\n"
        f"design = clacad.load('slab', {SMALL!r})\n"
        "print(len(clacad.sweep(design, {'law.eta.0': [-1, -2]}, 64, Farm(2)).rows))\n",
        encoding="utf-8",
    )
    done = subprocess.run([sys.executable, program], capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == ["once", "2"], done.stderr


def test_pictures_and_searches_report_to_a_bar_where_none_is_given(monkeypatch):
    from clacad.optimising import search
    from clacad.rendering import picture

    told: list[tuple[str, float]] = []
    monkeypatch.setattr(interactive, "shown_progress", lambda given: given or (lambda *one: told.append(one)))
    monkeypatch.setattr(
        picture, "view_through", lambda made, **given: SimpleNamespace(light=given["progress"])
    )
    movie = ROOT / "designs" / "scenes" / "fig3-movie.toml"
    clacad.render(movie)("rendering", 0.5)
    next(clacad.render_movie(movie)).light("rendering", 0.5)
    search._shown()(7, 1e-3)
    assert told[0] == ("rendering", 0.5)
    assert told[1][0] == "rendering frames"
    assert 0.0 < told[1][1] < 0.5
    assert told[2][0] == "7 designs tried, best 1 mrad"
