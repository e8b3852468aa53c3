"""Forecasts of seconds: from a model, narrowed by what the machine took before; a broken cache costs nothing."""

from __future__ import annotations

import json
import math
import os
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clacad.base import machine_rates as rates_module
from clacad.base.machine_rates import KEPT, Rates, Span, total
from clacad.base.text import span_text
from clacad.cli.console import Console


class Clock:
    """Clock that advances only when a test sets it."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("CLACAD_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def run(rates, task, modelled, seconds):
    clock = Clock()
    with rates.noting(task, modelled, clock):
        clock.now += seconds


@pytest.mark.parametrize("slower", [0.3, 1.0, 7.0])
def test_after_a_few_runs_the_forecast_is_within_30_per_cent_and_says_so(cache, slower):
    # a machine `slower` times the reference, its runs scattered by 10 % either way
    for k, size in enumerate([0.5, 2.0, 9.0, 3.0]):
        run(Rates.here(), "export stl", size, slower * size * (1.1 if k % 2 else 0.9))
    for size in (0.5, 1.0, 4.0, 9.0):
        span = Rates.here().span("export stl", size)
        assert span.middle == pytest.approx(slower * size, rel=0.15)
        assert span.low <= 0.9 * slower * size
        assert span.high >= 1.1 * slower * size
        assert span.high / span.low < 1.3 / 0.7 * 1.1  # no wider than 30 % either side, and a little
        assert span.seen == 4


def test_a_task_never_seen_is_forecast_widely_and_less_so_where_the_machine_is_known(cache):
    unknown = Rates.here().span("export step", 10.0)
    assert unknown.low < 5.0 < 20.0 < unknown.high
    run(Rates.here(), "export stl", 1.0, 3.0)
    known = Rates.here().span("export step", 10.0)
    assert known.middle == pytest.approx(30.0)
    assert known.high / known.low < unknown.high / unknown.low


def test_one_odd_run_does_not_spoil_the_forecast(cache):
    for seconds in (2.0, 2.0, 40.0, 2.0, 2.0):
        run(Rates.here(), "verify", 1.0, seconds)
    assert Rates.here().span("verify", 1.0).middle == pytest.approx(2.0)


def test_far_from_the_sizes_seen_the_forecast_is_wider(cache):
    run(Rates.here(), "verify", 1.0, 2.0)
    near, far = (Rates.here().span("verify", size) for size in (1.0, 100.0))
    assert far.high / far.low > near.high / near.low
    assert far.middle == pytest.approx(200.0)


@given(st.lists(st.tuples(st.floats(1e-3, 1e4), st.floats(0.03, 1e4)), max_size=20), st.floats(1e-4, 1e5))
def test_a_forecast_is_always_a_finite_range(runs, size):
    found = Rates(None, {"t": tuple(runs)} if runs else {}).span("t", size)
    assert 0.0 < found.low < found.high < math.inf
    assert str(found)


@pytest.mark.parametrize("text", [
    "", "{", "[]", "null", '{"format": 2, "tasks": {}}', '{"format": 1, "tasks": []}',
    '{"format": 1, "tasks": {"t": 5, "u": [[1]], "v": [["a", 1]], "w": [[0, 1], [1, -1], [NaN, 1], [1, Infinity]]}}',
    "[" * 5000, "x" * 300_000, "\udcff",
])  # fmt: skip
def test_a_broken_cache_is_as_good_as_none(cache, text):
    run(Rates.here(), "t", 1.0, 2.0)
    (file,) = cache.iterdir()
    file.write_bytes(text.encode("utf-8", "surrogateescape"))
    assert dict(Rates.here().tasks) == {}
    run(Rates.here(), "t", 1.0, 2.0)
    assert Rates.here().tasks["t"] == ((1.0, 2.0),)


def test_what_cannot_be_kept_is_not_kept_and_nothing_is_said(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("CLACAD_CACHE_DIR", str(tmp_path / "file"))
    run(Rates.here(), "t", 1.0, 2.0)
    assert Rates.here().tasks == {}
    monkeypatch.setenv("CLACAD_CACHE_DIR", "")
    run(Rates.here(), "t", 1.0, 2.0)
    assert Rates.here().path is None
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_run_that_fails_or_is_too_short_is_not_noted(cache):
    with pytest.raises(KeyError), Rates.here().noting("t", 1.0, Clock()):
        raise KeyError
    run(Rates.here(), "t", 1.0, 1e-4)
    run(Rates.here(), "t", float("nan"), 1.0)
    assert Rates.here().tasks == {}


def test_only_the_newest_runs_are_kept_and_drafts_are_not_left(cache):
    for k in range(2 * KEPT):
        run(Rates.here(), "t", 1.0, 1.0 + k)
    (file,) = cache.iterdir()
    kept = json.loads(file.read_text())["tasks"]["t"]
    assert [row[1] for row in kept] == pytest.approx([1.0 + k for k in range(KEPT, 2 * KEPT)])


def test_writers_at_once_leave_a_whole_file(cache):
    def many(name):
        for k in range(20):
            run(Rates.here(), name, 1.0, 1.0 + k)

    threads = [threading.Thread(target=many, args=(f"t{k}",)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    (file,) = cache.iterdir()
    assert json.loads(file.read_text())["format"] == 1
    assert Rates.here().tasks


def test_another_machine_version_or_number_of_threads_has_rates_of_its_own(cache, monkeypatch):
    run(Rates.here(), "t", 1.0, 2.0)
    here = rates_module.machine_key()
    with monkeypatch.context() as patch:
        patch.setenv("CLACAD_THREADS", "7")
        assert Rates.here().tasks == {}
    with monkeypatch.context() as patch:
        patch.setattr("clacad.__version__", "99")
        assert Rates.here().tasks == {}
    with monkeypatch.context() as patch:
        patch.setattr(rates_module, "_processor", lambda: "another")
        assert Rates.here().tasks == {}
    assert rates_module.machine_key() == here
    assert Rates.here().tasks["t"] == ((1.0, 2.0),)


def test_the_machine_is_timed_by_the_clock_it_is_given(cache, monkeypatch):
    clock = Clock()
    lasts = iter([3.0, 1.0, 2.0])

    def work():
        clock.now += next(lasts)

    monkeypatch.setattr(rates_module, "_reference_work", work)
    assert Rates.here().calibrate(clock) == 1.0
    assert Rates.here().tasks[rates_module.MACHINE] == ((rates_module.REFERENCE, 1.0),)


def test_a_long_command_says_its_range_and_learns_from_the_run(cache, capsys, monkeypatch):
    monkeypatch.setattr("clacad.cli.console._kernels", lambda: 5)
    clock = Clock()
    with Console().forecast("verify", 20.0, clock=clock):
        clock.now += 16.0
    assert "this takes 8–50 s of processor time" in capsys.readouterr().err
    with Console().forecast("verify", 20.0, clock=clock):
        clock.now += 16.0
    assert "this takes 12–20 s of processor time" in capsys.readouterr().err
    with Console(quiet=True).forecast("verify", 20.0, clock=clock):
        clock.now += 16.0
    with Console().forecast("check", 0.1, clock=clock):
        clock.now += 0.1
    told = capsys.readouterr()
    assert (told.out, told.err) == ("", "")


def test_a_run_that_compiled_kernels_is_not_noted(cache, monkeypatch):
    counts = iter([0, 3])
    monkeypatch.setattr("clacad.cli.console._kernels", lambda: next(counts))
    clock = Clock()
    with Console(quiet=True).forecast("verify", 1.0, clock=clock):
        clock.now += 60.0
    assert Rates.here().tasks == {}


def test_a_run_that_compiled_a_kernel_anew_is_not_noted(cache, tmp_path, monkeypatch):
    # a kernel older than its source is replaced by a new one: as many lie there as before
    kernel = tmp_path / "clacad-kernel.nbc"
    kernel.write_bytes(b"old")
    os.utime(kernel, (1.0, 1.0))
    monkeypatch.setattr("clacad.doctor.kernel_cache", lambda: (tmp_path, [kernel]))
    clock = Clock()
    with Console(quiet=True).forecast("trace", 1.0, clock=clock):
        clock.now += 60.0
        kernel.write_bytes(b"new")
    assert Rates.here().tasks == {}
    with Console(quiet=True).forecast("trace", 1.0, clock=clock):
        clock.now += 1.5
    assert Rates.here().tasks["trace"] == ((1.0, pytest.approx(1.5)),)


def test_ranges_are_said_as_a_person_says_them():
    assert span_text(12.3, 20.4) == "12–20 s"
    assert span_text(0.31, 0.62) == "0.31–0.62 s"
    assert span_text(0.01, 0.02) == "under 0.1 s"
    assert span_text(200.0, 310.0) == "3.3–5.2 min"
    assert span_text(7200.0, 14400.0) == "2–4 h"
    assert span_text(15.1, 15.2) == "about 15 s"
    assert str(total([Span(1.0, 2.0, 3), Span(2.0, 4.0, 5)])) == "3–6 s"


@pytest.mark.slow
def test_what_was_noted_changes_forecasts_and_no_byte_that_is_written(cache, tmp_path):
    import clacad

    design = clacad.load("designs/slab.toml").with_cells((2, 2))
    folders = [tmp_path / "a", tmp_path / "b"]
    formats = ("stl", "3mf", "ply", "glb", "table", "pov")
    clacad.export(design, folders[0], formats, quads=8)
    for task in KEPT * ("export stl", "export 3mf", "export ply", "export prepare"):
        run(Rates.here(), task, 0.02, 1e4)
    clacad.export(design, folders[1], formats, quads=8)
    names = sorted(p.name for p in folders[0].iterdir() if p.name != "run.json")
    assert len(names) > 6
    for name in names:
        assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes(), name
    first, second = (json.loads((f / "run.json").read_text())["forecast"][0]["seconds"] for f in folders)
    assert second[1] > 100.0 * first[1]


@pytest.mark.slow
def test_an_export_notes_what_its_formats_took(cache, tmp_path):
    import clacad

    clacad.export(clacad.load("designs/slab.toml").with_cells((6, 6)), tmp_path / "a", ("stl",), quads=16)
    ((modelled, took),) = Rates.here().tasks["export stl"]
    assert min(modelled, took) > 0.0  # how near they are is in tests/benchmarks/forecast.md


@pytest.mark.skipif(not hasattr(os, "sysconf"), reason="no process table")
def test_the_seconds_of_another_process_are_read_or_replaced():
    assert rates_module.seconds_of(None, 5.0) == 5.0
    # children are not counted: the seconds of each worker are read by its own process number
    assert rates_module.seconds_of(os.getpid(), -1.0) == pytest.approx(time.process_time(), abs=1.0)


def test_a_forecast_measured_on_a_part_is_corrected_by_what_such_work_took_before(cache, monkeypatch):
    """A picture that takes twice the forecast from its first pixels has a corrected forecast the next time."""
    monkeypatch.setattr("clacad.cli.console._kernels", lambda: 5)
    clock = Clock()
    with Console(quiet=True).forecast("render", Span(4.0 / 1.3, 4.0 * 1.3), clock=clock) as first:
        clock.now += 8.0
    assert (first.low, first.high) == pytest.approx((4.0 / 1.3, 4.0 * 1.3))
    with Console(quiet=True).forecast("render", Span(6.0 / 1.3, 6.0 * 1.3), clock=clock) as second:
        clock.now += 12.0
    assert second.low < 12.0 < second.high
    assert second.middle == pytest.approx(12.0)
