"""Opaque line on one face: its share by area, the rays that it ends, its mask, and what it refuses."""

from __future__ import annotations

import re
import tomllib

import numpy as np
import pytest

from clacad import DesignError, export, prescribe
from clacad.base.types import silent
from clacad.design import Design, load, template
from clacad.optics.rays import Fate
from clacad.sheet.bundle import bundle
from clacad.sheet.vignetting import thin_cells
from clacad.tracing.trace import trace

WIDTH, PITCH = 0.012, 0.5


def design(face: int | None = 1, kind: str = "three-plates-10deg") -> Design:
    plain = Design.from_dict(tomllib.loads(template(kind, kind))).with_cells((9, 9))
    return plain if face is None else plain.replace({"lattice.line": {"face": face, "width": WIDTH}})


def lit(window, field=0.0, count=1 << 14):
    return bundle(window, count, field, middle=np.array([0.0, 0.0, 1.0])).rays


def test_light_along_the_normal_loses_the_area_of_the_line_on_the_first_face():
    window, plain = prescribe(design()), prescribe(design(None))
    share = (trace(window, lit(window), path="numpy").fate == Fate.VIGNETTED).mean()
    part = (1.0 - WIDTH / PITCH) ** 2
    assert share == pytest.approx(1.0 - part, abs=1e-3)
    assert thin_cells(window).part == pytest.approx(part * thin_cells(plain).part, rel=1e-12)


@pytest.mark.parametrize("face", [1, 6])
def test_a_ray_ends_where_it_hits_the_line_and_all_others_go_on_as_without_it(face):
    window, plain = prescribe(design(face)), prescribe(design(None))
    rays = lit(window, np.radians(10.0))
    found, free = (trace(one, rays, record=True, path="numpy") for one in (window, plain))
    ended = found.fate == Fate.VIGNETTED
    assert 0.03 < ended.mean() < 0.07
    surface = face - 1
    hit = np.abs(
        (free.hits[surface][:, :2] + 0.5 * PITCH) / PITCH
        - np.round((free.hits[surface][:, :2]) / PITCH)
        - 0.5
    )
    reached = free.surface >= surface
    assert (ended == (reached & (PITCH * (0.5 - hit.max(axis=1)) < 0.5 * WIDTH))).all()
    for name in ("position", "direction", "fate", "optical_path", "cell", "order"):
        assert np.array_equal(getattr(found, name)[~ended], getattr(free, name)[~ended])
    assert np.array_equal(found.position[ended], free.hits[surface, ended])
    assert (found.surface[ended] == surface).all()
    if face == 1:
        length = np.linalg.norm(free.hits[0, ended] - rays.position[ended], axis=1)
        assert found.optical_path[ended] == pytest.approx(length, rel=1e-12)
        assert found.direction[ended] == pytest.approx(rays.direction[ended], abs=1e-15)
    else:
        assert found.direction[ended] == pytest.approx(free.directions[surface - 1, ended], abs=1e-15)
        assert (found.optical_path[ended] <= free.optical_path[ended] + 1e-12).all()
    assert (found.fate == Fate.GHOST).sum() < 0.5 * (free.fate == Fate.GHOST).sum()


def test_the_mask_is_that_of_the_face_with_the_line_and_clears_the_rest(tmp_path):
    export(design(6).with_cells((3, 3)), tmp_path / "out", formats=("mask",), progress=silent)
    masks = sorted(one.name for one in (tmp_path / "out").glob("*.mask.*"))
    assert [re.search(r"plate3-3-pmma-back\.mask\.(dxf|svg)$", one)[1] for one in masks] == ["dxf", "svg"]
    text = next((tmp_path / "out").glob("*.svg")).read_text()
    points = np.array(re.search(r'points="([^"]+)"', text)[1].replace(",", " ").split(), dtype=float).reshape(
        -1, 2
    )
    assert np.ptp(points, axis=0) == pytest.approx(PITCH - WIDTH, rel=1e-12)


@pytest.mark.parametrize(
    ("kind", "line", "says"),
    [
        ("three-plates-10deg", {"face": 1, "width": 0.5}, "leaves no lens"),
        ("three-plates-10deg", {"face": 7, "width": 0.01}, "face 7 of 6"),
        ("achromat-plastic", {"face": 2, "width": 0.01}, "no line can be printed on face 2"),
        ("slab", {"face": 3, "width": 0.01}, "no line can be printed on face 3"),
    ],
)
def test_lines_that_cannot_be_are_refused_with_the_reason(kind, line, says):
    with pytest.raises(DesignError, match=says):
        prescribe(load(kind, ["lattice.count = [3, 3]"]).replace({"lattice.line": line}))
