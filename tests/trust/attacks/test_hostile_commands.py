"""Hostile options, keys and files before every command that was added last: a sentence, a status, whole sets, in seconds."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest
from trust.attacks import hostile_commands as hostile
from trust.attacks.forks import Forks
from trust.attacks.judge_commands import attack, files_of, of_files, prepare, write_given
from trust.attacks.odd_values import answered

ALL = 2000

LIGHT = (
    ("shape", "distance"), ("shape", "target"), ("image", "object"), ("image", "rung"), ("explore", "out"), ("wave", "field"),
    ("trace", "effects"), ("sweep", "vary"), ("new", "template"), ("explain", "code"), ("file", "rays"), ("file", "target points"),
    ("file", "outline"), ("file", "cells"),
)  # fmt: skip
"""Points of attack that are soon done and need no kernel."""


@pytest.mark.daily_cases(
    "shape distance",
    "shape target",
    "image object",
    "explore out",
    "wave field",
    "new template",
    "file outline",
    "file cells",
)
@pytest.mark.parametrize("point", LIGHT, ids=" ".join)
def test_a_few_hostile_inputs_are_answered_and_leave_whole_sets(
    point: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In this process, three of each; those of `sweep` that would begin another process are among the others."""
    write_given(tmp_path)
    monkeypatch.chdir(tmp_path)
    at = hostile.POINTS_OF_ATTACK.index(point)
    for number in range(at, at + 3 * len(hostile.POINTS_OF_ATTACK), len(hostile.POINTS_OF_ATTACK)):
        one = hostile.attack(number, tmp_path)
        for name, data in one.files.items():
            (tmp_path / name).write_bytes(data)
        before = files_of(tmp_path)
        words = [*one.words, *(["--overwrite"] if point[0] in ("shape", "image", "wave", "trace") else [])]
        status, wrong = answered(words)
        assert not wrong, (number, words, wrong)
        assert not of_files(one.words, status, before, files_of(tmp_path)), (number, words)


@pytest.mark.parametrize("numbers", [
    pytest.param(range(0, ALL, 120), marks=pytest.mark.slow, id="one in 120"),
    pytest.param(range(ALL), marks=[pytest.mark.long, pytest.mark.timeout(4 * 3600)], id="all"),
])  # fmt: skip
def test_no_hostile_input_ends_in_a_fault_or_is_worked_on_for_long(
    tmp_path: Path, numbers: Iterable[int]
) -> None:
    """No status 70, no warning or traceback, no half set, nothing left, no more than 20 s of processor time."""
    given = tmp_path / "given"
    given.mkdir()
    with Forks() as forks:
        prepare(given, forks, numbers)
        tally = attack(numbers, given, tmp_path / "work", forks)
    print(tally)  # noqa: T201
    assert not tally.faults


def test_inputs_depend_on_their_number_alone_and_every_point_of_attack_is_tried_ten_times(
    tmp_path: Path,
) -> None:
    write_given(tmp_path)
    points = [hostile.aimed_at(number) for number in range(ALL)]
    assert min(points.count(point) for point in hostile.POINTS_OF_ATTACK) >= 10
    light = [number for number in range(200) if hostile.aimed_at(number)[0] != "file"]
    assert [hostile.attack(number, tmp_path) for number in light] == [
        hostile.attack(number, tmp_path) for number in light
    ]
