"""Ten wishes for a stated eye, three commands each: the eye gets what was wished, or the wish is refused with one near it that passes."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from advice.test_ten_wishes import processor_seconds
from trust.running import command, environment

from clacad.design import Design, load
from clacad.prescription.prescribe import prescribe
from clacad.sheet.window import Window

LIMIT = 0.9
"""Share of the eye's light that must obey the law."""

CELLS, POINTS = 41, 12
"""Cells and points of a cell along each axis of the plain ray geometry."""


@dataclass(frozen=True)
class View:
    """A wish, and whether it comes true."""

    name: str
    wish: str
    comes_true: bool = True


VIEWS = (
    View("anamorphic-resin-300", "eta=[-0.25,-1], width=40 mm, viewing=300 mm, process=sla"),
    View("anamorphic-resin-400", "eta=[-0.25,-1], width=60 mm, viewing=400 mm, process=sla"),
    View("window-200", "eta=-1, width=200 mm, viewing=1 m"),
    View("window-near", "eta=-1, width=40 mm, viewing=300 mm"),
    View(
        "round-moulded", "eta=-1, circle=30 mm, viewing=500 mm, kind=hexagonal, process=moulding, material=PC"
    ),
    View("galilean", "eta=.5, width=20 mm, viewing=600 mm, process=moulding"),
    View("half", "eta=-.5, width=[60, 40], viewing=50 cm"),
    View("magnifying", "eta=-2, width=40 mm, viewing=400 mm", comes_true=False),
    View("too-near", "eta=-1, width=100 mm, viewing=60 mm", comes_true=False),
    View("galilean-near", "eta=.8, width=100 mm, viewing=100 mm, process=moulding", comes_true=False),
)

FEW = ("galilean",)
"""Run among the slow tests; all ten by hand."""


def seen_through_thin_lenses(window: Window, distance: float) -> float:
    """Share of the light of an eye on the axis that meets the partner of its cell, by rays through ideal thin lenses.

    Straight lines and t' = t - x/f only: pitch, focal lengths and cells are read off the window, its formulas are not used.
    Only for lens axes along the normal and no offset.
    """
    pair, lattice = window.thin, window.lattice
    cells = lattice.cells()
    cells = cells[:: max(1, len(cells) // CELLS**2)]
    u = (np.arange(POINTS) + 0.5) / POINTS - 0.5
    shares = []
    for step in range(
        2
    ):  # both axes of square cells are independent; hexagonal ones are bounded by their inner width
        width, f1, s = min(lattice.pitch), pair.focal_length[0][step], pair.separation
        centre = lattice.centres(cells)[:, step, None]
        start = centre + width * u
        slope = start / distance
        xi = start - centre
        if pair.field:  # at the common focus: bent so that lens 1 is imaged onto lens 2
            f2 = pair.focal_length[1][step]
            at_focus = xi + f1 * (slope - xi / f1)
            bent = slope - xi / f1 - at_focus * (1.0 / f1 + 1.0 / f2)
            landing = at_focus + f2 * bent
            inside = (abs(at_focus) <= 0.5 * width) & (abs(landing) <= 0.5 * width)
        else:
            scale = 1.0 if np.isinf(f1) else 1.0 - s / f1
            inside = abs(scale * xi + s * slope) <= 0.5 * width
        shares.append(inside.mean(axis=1))
    return float((shares[0] * shares[1]).mean())


@pytest.mark.parametrize(
    "view",
    [
        pytest.param(view, id=view.name, marks=[pytest.mark.slow if view.name in FEW else pytest.mark.long, pytest.mark.timeout(900)])
        for view in VIEWS
    ],
)  # fmt: skip
def test_the_eye_gets_what_was_wished_or_the_wish_is_refused_with_one_near_it(
    tmp_path: Path, view: View, capsys: pytest.CaptureFixture[str]
) -> None:
    path, before = tmp_path / "w.toml", processor_seconds()
    ended = _run("new", path, "--for", view.wish)
    if not view.comes_true:
        assert ended.returncode == 1
        assert not path.exists()
        assert re.search(r"^  .* comes true: ", ended.stderr, re.MULTILINE), ended.stderr
        with capsys.disabled():
            sys.stdout.write(
                f"\n{view.name}: refused, {processor_seconds() - before:.1f} CPU s\n{ended.stderr}"
            )
        return
    assert ended.returncode == 0, ended.stderr
    design = load(path)
    assert design.check.viewer is not None
    assert design.check.viewed == LIMIT
    assert _run("export", path, "-o", tmp_path / "out", "--format", "step").returncode == 0
    ended = _run("verify", path, "--files", tmp_path / "out", "--json")
    assert ended.returncode == 0, ended.stdout[-2000:]
    judged = next(check for check in json.loads(ended.stdout)["checks"] if check["id"] == "viewed")
    assert judged["state"] == "pass"
    assert judged["limit"] == LIMIT
    own = _own_share(design)
    with capsys.disabled():
        sys.stdout.write(
            f"\n{view.name}: {judged['value']:.3f} judged, {own:.3f} by thin rays, {processor_seconds() - before:.1f} CPU s\n"
        )
    assert own >= LIMIT
    assert judged["value"] >= LIMIT


def _own_share(design: Design) -> float:
    assert design.check.viewer is not None
    return seen_through_thin_lenses(prescribe(design), design.check.viewer)


def _run(*words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(words), capture_output=True, text=True, env=environment(), timeout=900)
