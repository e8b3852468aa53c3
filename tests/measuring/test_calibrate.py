"""Depths of a coupon from simulated maps, anywhere in the map and turned; maps that cannot be used."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from clacad.cli import main
from clacad.formats.maps.dose import Coupon, read_calibration
from clacad.measuring.find_lattice import NotMeasurable
from clacad.measuring.read_map import cloud_map
from clacad.measuring.wedge_fields import calibrate

WINDOW = str(Path(__file__).parents[2] / "designs" / "window-100mm.toml")
COUPON = Coupon()
DEEPEST = 30e-6
NOISE = 20e-9


def depth_of(level: float) -> float:
    """Depth of a level by an exposure curve of its own."""
    return DEEPEST * (level / 255.0) ** 1.3


def scanned(turn: float = 0.0, noise: float = NOISE, depths=depth_of, without=(), mirror: bool = False):
    """Grid of heights (metres) of a coupon that lies somewhere in a leaning map, pixels of 4 um."""
    chance = np.random.default_rng(5)
    pixel = 4e-6
    x, y = np.meshgrid(np.arange(360) * pixel, np.arange(360) * pixel)
    at = np.array([0.72e-3, 0.7e-3])
    c, s = np.cos(turn), np.sin(turn)
    middle = COUPON.middles().mean(axis=0)
    u = c * (x - at[0]) + s * (y - at[1]) + middle[0]
    v = c * (y - at[1]) - s * (x - at[0]) + middle[1]
    u = 2.0 * middle[0] - u if mirror else u
    z = chance.normal(0.0, noise, x.shape) + 3e-3 * x - 2e-3 * y
    for level, (mx, my) in zip(COUPON.levels, COUPON.middles().tolist(), strict=True):
        here = (np.abs(u - mx) < 0.5 * COUPON.side) & (np.abs(v - my) < 0.5 * COUPON.side)
        z[here] -= depths(level)
        z[here & (level in without)] = np.nan
    z[chance.random(z.shape) < 0.02] = np.nan
    return z


def map_of(z):
    rows, columns = np.nonzero(np.isfinite(z))
    return cloud_map("wedge", np.stack([columns * 4e-6, rows * 4e-6, z[rows, columns]]))


@pytest.mark.ci_cases("1.3", "179.0")
@pytest.mark.daily_cases("-2.1", "268.9")
@pytest.mark.parametrize("degrees", [0.0, 1.3, -2.1, 90.8, 179.0, 268.9])
def test_depths_are_found_wherever_the_coupon_lies(degrees) -> None:
    found = calibrate(map_of(scanned(np.radians(degrees))))
    truth = np.array([depth_of(level) for level in COUPON.levels])
    assert found.levels.tolist() == list(COUPON.levels)
    assert np.abs(found.depths - truth).max() < 60e-9
    inside = np.abs(found.depths - truth) <= 3.0 * np.fmax(found.halves, 1e-9)
    assert inside.sum() >= 15
    assert found.depths[0] == 0.0
    assert abs(found.level_0) < 20e-9
    assert found.explained > 0.98


@pytest.mark.slow
def test_the_uncertainty_is_that_of_the_noise() -> None:
    found = calibrate(map_of(scanned(noise=1e-7)))
    pixels = (0.06e-3 / 4e-6) ** 2  # of the inner field; the land around has more
    assert np.median(found.halves) == pytest.approx(1e-7 / np.sqrt(pixels), rel=0.5)


@pytest.mark.slow
def test_the_command_writes_what_exports_read(tmp_path, capsys) -> None:
    np.save(tmp_path / "wedge.npy", scanned(0.01))
    scales = {"pixel_um": 4, "z_step_um": 1e6, "row_0": "bottom"}
    (tmp_path / "wedge.npy.json").write_text(json.dumps(scales))
    table = tmp_path / "dose.csv"
    assert main(["calibrate", str(tmp_path / "wedge.npy"), "-o", str(table)]) == 0
    assert "17 levels" in capsys.readouterr().out
    rows = list(csv.DictReader(table.open()))
    assert [int(row["level"]) for row in rows] == list(COUPON.levels)
    read = read_calibration(table)
    assert read.depths[-1] == pytest.approx(DEEPEST, abs=20e-9)
    export = ["export", WINDOW, "-o", str(tmp_path / "out"), "--format", "dose", "--cells", "2x2"]
    assert main([*export, "--calibration", str(table), "--set", 'check.process="none"']) == 0
    files = json.loads((tmp_path / "out" / "manifest.json").read_text())["files"]
    eight = next(one for one in files if one["format"] == "dose-8")
    assert eight["residual_max"] < 0.5 * 30e-3 * 1.3 / 255.0 * 1.05  # half the largest step of the curve, mm


@pytest.mark.daily_cases("a level missing", "mirrored")
@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"without": (48,)}, "field of level 48 is missing"),
        ({"depths": lambda level: depth_of(min(level, 200))}, "rise from level to level"),
        ({"depths": lambda level: -depth_of(level)}, "no coupon|rise from"),
        ({"depths": lambda level: 0.0}, "no coupon|mirror"),
        ({"mirror": True}, "mirror image"),
    ],
    ids=["a level missing", "flat at its end", "inverted", "without depth", "mirrored"],
)
def test_maps_of_no_use_are_refused_with_the_reason(changed, words) -> None:
    with pytest.raises(NotMeasurable, match=words):
        calibrate(map_of(scanned(**changed)))
