"""First lines of a long command: about how long it takes, its current step, and the design's own verdict."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

import clacad
from clacad.base.types import silent
from clacad.cli import console
from clacad.cli.console import Progress
from clacad.design import Design
from clacad.exporting.forecast import rough_span
from clacad.exporting.request import Request
from clacad.exporting.roles import Role
from clacad.exporting.run import forecast_rows, in_all
from clacad.judging.delivery import Subject, list_files
from clacad.verification.run import seconds, task, verified

TEXT = {
    "format": 1, "name": "small", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "biconvex", "separation": 10.0, "index": 1.5}, "lattice": {"pitch": 0.5, "count": [3, 3]},
}  # fmt: skip


def test_the_stage_at_work_is_said_though_it_tells_nothing_more(capsys):
    progress = Progress(after=0.05)
    progress("thinking")
    time.sleep(0.5)
    assert capsys.readouterr().err == "thinking ...\n"
    progress("writing")  # elsewhere than on a terminal a wait gets one line, not one a stage
    progress.done()
    assert capsys.readouterr().err == ""


def test_nothing_is_said_of_what_is_over_before_the_silent_time(capsys):
    progress = Progress(after=30.0)
    progress("thinking")
    progress.done()
    assert progress._next is not None
    progress._next.join(20.0)
    assert not progress._next.is_alive()  # long before its time: no thread waits to print a line
    quiet = Progress(quiet=True, after=0.0)
    quiet("thinking")
    time.sleep(0.1)
    quiet.say("heard by nobody")
    quiet.done()
    assert capsys.readouterr().err == ""


def test_what_is_left_of_all_is_what_was_forecast_less_what_passed(capsys):
    progress = Progress(after=0.0)
    progress.expect(100.0)
    progress("thinking")
    progress.done()
    assert "thinking ... (of all, about 100 s left)" in capsys.readouterr().err


@pytest.mark.slow
def test_the_report_of_the_design_comes_before_a_file_is_read(tmp_path: Path):
    design = Design.from_dict(TEXT)
    clacad.export(design, tmp_path, formats=["stl"], quads=4)
    delivery = list_files(tmp_path)
    (tmp_path / "small.stl").unlink()  # listed, and gone before anybody looks into it
    steps = verified(design, delivery, None, 2048, silent)
    first = next(steps)
    assert not first.delivered
    assert first.checks
    assert not [check for check in first.checks if check.where == "file"]
    *_, last = steps
    assert last.delivered
    assert last.word == "failed"


@pytest.mark.slow
def test_files_are_listed_without_their_hashes_and_hashed_once(tmp_path: Path):
    clacad.export(Design.from_dict(TEXT), tmp_path, formats=["stl", "table"], quads=4)
    listed = list_files(tmp_path)
    assert {one.sha256 for one in listed.subjects} == {""}
    found = list_files(tmp_path).hashed()
    assert [one.sha256 for one in found.subjects] == [one.entry["sha256"] for one in found.subjects]
    assert [one.sha256 for one in listed.hashed().subjects] == [one.sha256 for one in found.subjects]


@pytest.mark.slow
@pytest.mark.parametrize("formats", [("stl",), ("3mf", "stl"), ("step", "ply")])
def test_the_rough_forecast_of_an_export_holds_the_close_one(formats, monkeypatch, tmp_path):
    monkeypatch.setenv("CLACAD_CACHE_DIR", str(tmp_path / "none"))
    for count in ([20, 20], [60, 40]):
        design = Design.from_dict(TEXT | {"lattice": {"pitch": 0.5, "count": count}})
        asked = Request(formats=formats, quads={name: 8 for name in formats if name != "step"})
        rough, close = rough_span(design, asked), in_all(forecast_rows(design, asked))
        assert rough.low <= close.middle <= rough.high


def test_the_rough_forecast_takes_a_preview_for_coarse():
    design = Design.from_dict(TEXT | {"lattice": {"pitch": 0.5, "count": [100, 100]}})
    fine, coarse = (
        rough_span(design, Request(formats=("stl",), role=role)) for role in ({}, {"stl": Role.PREVIEW})
    )
    assert coarse.middle < 0.5 * fine.middle


@pytest.mark.slow
def test_verifying_instances_is_forecast_by_the_facets_in_the_file(tmp_path: Path):
    design = Design.from_dict(TEXT | {"lattice": {"pitch": 0.5, "count": [50, 50]}})
    clacad.export(design, tmp_path, formats=["3mf"], quads=8)
    (subject,) = list_files(tmp_path).subjects
    assert subject.entry["triangles"] == 2500 * subject.entry["triangles_stored"]
    assert seconds(2048, [subject]) < 10.0


def test_a_returned_part_is_forecast_with_finding_how_it_lies():
    stated = {"quads": 48, "triangles": 334_080}
    listed, returned = (
        Subject(Path("x.stl"), "x.stl", "stl-binary", entry, 84 + 50 * 334_080) for entry in (stated, {})
    )
    lit = seconds(0, [listed]) - seconds(
        0, [Subject(Path("x.stl"), "x.stl", "stl-binary", {"triangles": 334_080})]
    )
    assert seconds(0, [returned]) - (seconds(0, [listed]) - lit) == pytest.approx(
        0.7, abs=0.05
    )  # as measured
    assert task([returned]) != task([listed])  # seconds of one are no measure of the other


def test_what_is_left_is_longer_on_a_busy_machine_and_a_forecast_that_was_short_is_said(monkeypatch):
    """Of 20 s of processor time 5 were had in 20 s of the clock: the other 15 take 60 s."""
    wall, used = [100.0], [7.0]
    monkeypatch.setattr(time, "monotonic", lambda: wall[0])
    monkeypatch.setattr(console, "processor_seconds_now", lambda: used[0])
    progress = Progress(quiet=True)
    progress.expect(20.0)
    wall[0], used[0] = 120.0, 12.0
    assert "about 60 s left" in progress._left(wall[0])
    wall[0], used[0] = 300.0, 32.0
    assert progress._left(wall[0]) == " (longer than forecast: 25 s of processor time for 20 s)"
    progress._expected = 24.5
    assert progress._left(wall[0]) == ""  # the same number of seconds twice is no news


@pytest.mark.slow
def test_a_stage_that_says_nothing_of_itself_is_said_again_until_the_end(monkeypatch, capsys):
    monkeypatch.setattr(console, "AGAIN_IN_LOG", 0.05)
    progress = Progress(after=0.0)
    progress("thinking")
    time.sleep(0.5)
    progress.done()
    assert capsys.readouterr().err.count("thinking") >= 3
    time.sleep(0.2)
    assert not capsys.readouterr().err
