"""Inserts, tool points, dose levels and the coupon against numbers of an independent program (25 digits)."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.formats.maps.dose import BYTE, WORD, Calibration, Coupon
from clacad.formats.maps.tool_path import ToolFace, tool_face
from clacad.optics.surface import Quadric, conic_constants
from clacad.sheet.shrunk import TURN, CannotShrink, growth, insert_window
from clacad.sheet.window import face_height
from clacad.storage.errors import BadRequest, NotPossible

DATA = Path(__file__).parents[1] / "data" / "workshop"
ROOM = 1e-12
"""Millimetres."""


def made_points(points, shrinkage, front):
    """Points (..., 3) of the part that an insert's points mould: apex plane at z = 0, axes of the sheet."""
    made = np.asarray(points) * (1.0 - np.asarray(shrinkage))
    return made if front else made * [1.0, -1.0, -1.0]


def cavity_point(point, shrinkage):
    """Point (3,) of the cavity for one of the part, seen from outside, and of the insert's file."""
    cavity = np.asarray(point) / (1.0 - np.asarray(shrinkage))
    return cavity, cavity @ TURN


def golden(name: str) -> dict:
    return json.loads((DATA / f"{name}.json").read_text())


@pytest.fixture(scope="module")
def sheet():
    return clacad.prescribe(clacad.load("window-100mm", ["lattice.count = [4, 3]"]))


def with_lens(window, face, radius: float, conic: float = 0.0):
    """The sheet with another lens on one face, and that face."""
    surface = Quadric(1.0 / radius, 1.0 / radius, (1.0 + conic) / radius, face.surface.side)
    changed = replace(face, surface=surface)
    bodies = [
        replace(one, **{side: changed for side in ("front", "back") if getattr(one, side) is face})
        for one in window.bodies
    ]
    return replace(window, bodies=tuple(bodies)), changed


@pytest.mark.parametrize("case", golden("insert")["cases"], ids=lambda case: case["name"])
@pytest.mark.parametrize("side", ["front", "back"])
def test_inserts_are_those_of_the_reference(sheet, case, side) -> None:
    window, face = with_lens(
        sheet, getattr(sheet.bodies[0], side), float(case["radius"]), float(case["conic"])
    )
    shrinkage = [float(one) for one in case["shrinkage"]]
    steel = insert_window(window, face, "face", shrinkage)
    cut = steel.bodies[0].back
    assert cut.side == -1  # steel below
    assert [1.0 / cut.surface.curvature_x, 1.0 / cut.surface.curvature_y] == pytest.approx(
        [float(one) for one in case["apex_radius_insert"]], abs=ROOM
    )
    assert np.add(conic_constants(cut.surface), 1.0) == pytest.approx(
        [float(one) for one in case["one_plus_conic"]], abs=ROOM
    )
    assert steel.lattice.pitch == pytest.approx([float(one) for one in case["pitch_insert"]], abs=ROOM)
    for one in case["points"]:
        part, cavity, insert = (np.array(one[key], dtype=float) for key in ("part", "cavity", "insert"))
        found = cavity_point(part, shrinkage)
        assert np.abs(found[0] - cavity).max() < ROOM
        assert np.abs(found[1] - insert).max() < ROOM
        height = cut.surface.sag(insert[0], insert[1])  # the file's own face goes through the point
        assert abs(float(height) - insert[2]) < ROOM
        back = made_points(insert, shrinkage, front=False)  # and the process makes the part of it
        assert np.abs(back - part).max() < ROOM


NOT_UNIFORM = {
    "aimed": ["lattice.aperture = {point = [30, 70, -600]}"],
    "of their own law": ['law.varying = {f_image = "200 mm"}'],
    "drawn": ["lattice.outline = {polygon = [[-1.6, -1.1], [1.9, -1.4], [1.6, 1.3], [-0.3, 1.6]]}"],
}


@pytest.mark.parametrize("keys", NOT_UNIFORM.values(), ids=NOT_UNIFORM)
@pytest.mark.parametrize("shrinkage", [(0.0, 0.0, 0.0), (0.006, 0.006, 0.004)])
def test_every_lenslet_of_a_back_lies_where_the_insert_moulds_it(keys, shrinkage) -> None:
    """Points of the sheet, over 1 - s and turned about x, against the heights of the steel in its own cells."""
    part = clacad.prescribe(clacad.load("window-100mm", ["lattice.count = [8, 8]", *keys]))
    face = part.bodies[0].back
    steel = insert_window(part, face, "back", shrinkage)
    x, y = np.random.default_rng(3).uniform(-1.8, 1.8, (2, 4000))
    index, u, v = part.locate(face.array, x, y)
    held = part.lattice.contains(index)
    z = face_height(part, face, u, v, index) - face.vertex[2]
    _, insert = cavity_point(np.stack([x, y, z], axis=1), shrinkage)
    there, a, b = steel.locate(face.array, *insert[:, :2].T)
    assert (steel.lattice.contains(there) == held).all()
    assert 500 < held.sum()
    found = face_height(steel, steel.bodies[0].back, a, b, there)
    assert np.abs(found - insert[:, 2])[held].max() < ROOM


@pytest.mark.daily_cases("front-0.025")
@pytest.mark.parametrize("case", golden("tool")["cases"], ids=lambda case: case["nose"])
@pytest.mark.parametrize("side", ["front", "back"])
def test_tool_points_are_those_of_the_reference(sheet, case, side) -> None:
    radius = float(golden("tool")["radius"])
    window, face = with_lens(sheet, getattr(sheet.bodies[0], side), radius)
    tool = ToolFace(window, face, float(case["nose"]), 0.05)
    middle = window.centres(face.array, np.array([[1, 1]]))[0]
    for one in case["points"]:
        x, y, z = (float(word) for word in one["surface"])
        height, _ = tool.surface(np.array([x]), np.array([tool.way * y]))
        assert abs(height[0] - z) < ROOM
        on_border = max(abs(x), abs(y)) >= 0.25  # on the border a point of the sheet belongs to either cell
        rows = tool.rows(np.array([middle[0] + x - 1e-9 * on_border]), np.array([middle[1] + tool.way * y]))
        [(*point, reached)] = rows - np.array([*([middle[0], tool.way * middle[1], 0.0]), 0, 0, 0,
                                               middle[0], tool.way * middle[1], 0.0, 0.0])  # fmt: skip
        room = 1e-8 if on_border else ROOM
        wanted = [float(word) for key in ("surface", "normal", "centre") for word in one[key]]
        assert np.abs(np.subtract(point, wanted)).max() < room
        assert abs(point[8] - tool.nose - float(one["tip"][2])) < room
        assert bool(reached) is one["reachable"]
        cx, cy = float(one["centre"][0]), tool.way * float(one["centre"][1])
        path = tool.path_height(np.array([cx]), np.array([cy]))
        assert abs(path[0] - float(one["height_of_path_at_centre_xy"])) < ROOM
    path = tool.path_height(np.array([0.25, 0.25]), np.array([0.0, 0.25]))
    assert path == pytest.approx(
        [float(case["path_centre_at_seam_middle"]), float(case["path_centre_at_corner"])], abs=ROOM
    )
    left = tool.left()
    assert left == pytest.approx(
        {
            "seam": float(case["left_at_seam_middle"]),
            "corner": float(case["left_at_corner"]),
            "share": float(case["rounded_share"]),
        },
        abs=ROOM,
    )


@pytest.mark.daily_cases("-0.02")
@pytest.mark.parametrize("case", golden("tool")["concave"], ids=lambda case: case["radius"])
def test_a_nose_larger_than_a_concave_face_is_refused(sheet, case) -> None:
    window, face = with_lens(sheet, sheet.bodies[0].front, float(case["radius"]))
    nose = float(case["nose"])
    if not case["ok"]:
        with pytest.raises(NotPossible, match=case["reason"]):
            tool_face(
                replace(window, lattice=replace(window.lattice, pitch=(0.03, 0.03))),
                face,
                "f",
                nose,
                None,
                99,
            )
        return
    tool = tool_face(
        replace(window, lattice=replace(window.lattice, pitch=(0.2, 0.2))), face, "f", nose, None, 99
    )
    rows = tool.rows(*np.random.default_rng(1).uniform(-0.09, 0.09, (2, 50)))
    centre = rows[:, 6:9] - [0.0, 0.0, -float(case["radius"])]
    index, u, v = tool.window.locate(0, rows[:, 6], -rows[:, 7])
    spheres = np.hypot(np.hypot(u, v), centre[:, 2])
    assert np.abs(spheres + float(case["centre_sphere_radius"])).max() < ROOM
    assert rows[:, 9].all()
    assert tool.left() == {"seam": 0.0, "corner": 0.0, "share": 0.0}


STEPS = {
    "own law": ["lattice.count = [6, 5]", 'law.varying = {f_image = "200 mm"}'],
    "land": ["lattice.count = [6, 5]", "lattice.seam = 0.05"],
    "displaced": ["lattice.count = [6, 5]", "law.delta = [0.1, 0.05]"],
    "turned": ["lattice.count = [6, 5]", 'lattice.rotation_2 = "5 deg"'],
}


@pytest.mark.ci_cases("own law-0.2", "displaced-0.025", "turned-0.2")
@pytest.mark.slow
@pytest.mark.parametrize("nose", [0.025, 0.2])
@pytest.mark.parametrize("keys", STEPS.values(), ids=STEPS)
def test_a_nose_passes_over_steps_as_a_ball_over_the_heights_that_are_written(keys, nose) -> None:
    """Against the highest of many points of the face under the ball, each in its own cell or on land."""
    window = clacad.prescribe(clacad.load("window-100mm", keys))
    face = window.bodies[0].back
    tool = tool_face(window, face, "back", nose, None, 1000)
    share = (np.arange(160) + 0.5) / 160
    reach, angle = (one.ravel() for one in np.meshgrid(nose * np.sqrt(share), 2.0 * np.pi * share))
    aside = np.stack([reach * np.cos(angle), reach * np.sin(angle)])

    def highest(x: float, y: float) -> float:
        index, u, v = window.locate(face.array, x + aside[0], y + aside[1])
        z = face_height(window, face, u, v, index) - face.vertex[2]
        return float((z + np.sqrt(nose**2 - reach**2))[window.lattice.contains(index)].max())

    rng = np.random.default_rng(1)
    x, y = rng.uniform(-0.8, 0.8, (2, 40))
    index, u, v = window.locate(face.array, x, y)
    path = tool.path_height(u, v, None if window.uniform else index)
    over = path - [highest(*at) for at in zip(x, y, strict=True)]
    assert over.min() > -1e-12  # no point of the face is inside the ball
    assert over.max() < 0.01 * nose  # and it touches: the points under it lie about a hundredth apart
    rows = tool.rows(*rng.uniform(-0.8, 0.8, (2, 120)))
    cut = np.array([highest(*at) for at in rows[:, 6:8]]) - rows[:, 8]
    reached = rows[:, 9] > 0.0
    assert 10 < reached.sum() < 120
    assert cut[reached].max() < 1e-12
    assert cut[~reached].min() > -0.001 * nose
    assert (cut[~reached] > 0.0).mean() > 0.9


@pytest.mark.slow
def test_a_nose_is_refused_only_where_it_enters_nowhere() -> None:
    """The lenses of a sheet for a point far aside are up to .4 mm higher in one cell than in the next."""
    keys = ["lattice.count = [4, 4]", "lattice.aperture = {point = [30, 70, -600]}"]
    window = clacad.prescribe(clacad.load("window-100mm", keys))
    face = window.bodies[0].back
    assert tool_face(window, face, "back", 0.02, None, 1000).left()["share"] < 0.2
    with pytest.raises(NotPossible, match="of 1 does not enter cell .* cuts .* smaller nose"):
        tool_face(window, face, "back", 1.0, None, 1000)


def test_levels_of_a_dose_are_those_of_the_reference() -> None:
    told = golden("dose")
    table = Calibration("table", np.array(told["levels"]), 1e-6 * np.array(told["depths_um"]))
    _, _, depth, level, residual = zip(*told["pixels"], strict=True)
    found, off = table.level_of(1e-6 * np.array(depth, dtype=float))
    assert found.tolist() == list(level)
    assert np.abs(1e3 * off - 1e-3 * np.array(residual, dtype=float)).max() < ROOM
    assert abs(1e6 * np.abs(off).max() - float(told["largest_residual_um"])) < 1e-9
    fine, small = table.level_of(1e-6 * np.array(depth, dtype=float), WORD)
    assert np.abs(small).max() < np.abs(off).max() / 100.0
    assert np.abs(fine / 257.0 - found).max() <= 0.5 + 1.0 / 257.0
    assert abs(float(told["face"]["depth_max_um"]) * 1e-6 - face_depth(told)) < 1e-15
    with pytest.raises(BadRequest, match="calibration covers 0 to 30 um"):
        table.level_of(np.array([1e-6, 30.1e-6]))


def face_depth(told: dict) -> float:
    """Depth (metres) of a square cell's corners, by the sphere's own equation."""
    from mpmath import mp, mpf, sqrt

    mp.dps = 40
    radius, half = mpf(told["face"]["radius"]), mpf(told["face"]["pitch"]) / 2
    return float((radius - sqrt(radius**2 - 2 * half**2)) / 1000)


def test_of_two_equally_near_levels_the_lower_is_written_and_without_a_table_levels_are_in_proportion() -> (
    None
):
    table = Calibration("t", np.array([0, 4]), np.array([0.0, 4.0]) * 2.0**-20)
    level, off = table.level_of(np.array([0.5, 1.5, 2.5, 2.5 + 2.0**-30]) * 2.0**-20)
    assert level.tolist() == [0, 1, 2, 3]
    assert off.tolist()[:3] == [-(2.0**-21)] * 3
    straight = Calibration.straight(25e-6)
    assert straight.level_of(np.array([0.0, 10e-6, 25e-6]))[0].tolist() == [0, 102, BYTE]
    assert straight.level_of(np.array([0.0, 25e-6]), WORD)[0].tolist() == [0, WORD]


def test_the_coupon_is_that_of_the_reference() -> None:
    told, coupon = golden("wedge"), Coupon()
    found = coupon.to_dict(1e-6)
    assert abs(found["side"] - float(told["side"])) < ROOM
    for mine, wanted in zip(found["fields"], told["fields"], strict=True):
        assert mine["level"] == wanted["level"]
        assert abs(mine["x"] - float(wanted["x"])) < ROOM
        assert abs(mine["y"] - float(wanted["y"])) < ROOM
    picture = coupon.picture(1e-6)
    levels, area = np.unique(picture, return_counts=True)
    assert dict(zip(levels.tolist(), area.tolist(), strict=True))[255] == 100 * 100
    assert len(levels) == 17
    column, row = (
        (np.array([0.3, -0.15]) - [found["left"], found["top"]]) * [1.0, -1.0] / found["pixel"]
    ).astype(int)
    assert picture[row, column] == 128


@pytest.mark.parametrize("shrinkage", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.5), (float("nan"), 0.0, 0.0)])
def test_a_shrinkage_that_leaves_no_part_is_refused(shrinkage) -> None:
    with pytest.raises(CannotShrink, match="below 1"):
        growth(shrinkage)
