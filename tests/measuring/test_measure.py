"""Height maps of made parts: read, fitted, lit and judged; against parts made by formulas of their own, and
samples.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measuring.made_parts import Made

from clacad.checks.file_kinds import CANNOT_SAY
from clacad.design import load
from clacad.light.measure import measure as measure_light
from clacad.measuring.find_lattice import NotMeasurable
from clacad.measuring.measure import measure
from clacad.measuring.read_map import MeasuredMap, cloud_map, read_map
from clacad.optics.surface.sag_and_normal import Quadric
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import RequestedLaw, bundle
from clacad.storage.errors import BadRequest, UnreadableFile
from clacad.tracing.trace import trace

SAMPLES = Path(__file__).parents[1] / "data" / "measured"
"""Maps and truths by an independent simulation, described in truths.json."""

WINDOW = load("window-100mm")
SPHERE = 2.468143364277402


def mapped(made: Made) -> MeasuredMap:
    """Map of a part without a file."""
    z = made.heights() * 1e-3
    row, column = np.nonzero(np.isfinite(z))
    at = (np.stack([column, row]) - made.size / 2.0) * made.pixel * 1e-3
    pixel = made.pixel * 1e-3
    return MeasuredMap("map", np.vstack([at, z[row, column]]), (pixel, pixel), z.shape)


def states(found) -> dict[str, str]:
    return {check.id: check.state for check in found.checks}


@pytest.mark.slow
def test_lenslets_are_found_within_their_stated_uncertainty():
    made = Made(
        turn=0.02,
        tilt=(4e-4, -6e-4),
        shift=(0.11, -0.07),
        spread_radius=1e-3,
        spread_middle=2e-4,
        z_scale=1.005,
        conic=0.1,
        astigmatism=2e-4,
    )
    found = measure(WINDOW, mapped(made), z_scale=1.005)
    rows = found.to_dict()["lenslets"]
    assert len(rows) == 9
    pulls = []
    for row in rows:
        x, y, r = made.cells[row["i"], row["j"]]
        pulls += [(row["radius"] - r) / row["u_radius"], (row["conic"] - 0.1) / row["u_conic"]]
        pulls.append((row["astigmatism"][0] - 4e-4) / row["u_astigmatism"][0])
    assert np.mean(np.abs(pulls) < 2.0) >= 0.93
    assert np.mean([row["radius"] for row in rows]) == pytest.approx(
        np.mean([made.cells[row["i"], row["j"]][2] for row in rows]), rel=2.5e-4
    )
    own = np.array([[row["x"], row["y"]] for row in rows])
    true = np.array([[row["i"] * 0.5, row["j"] * 0.5] for row in rows])
    true += [made.cells[row["i"], row["j"]][:2] for row in rows]
    turn = _best_turn(own, true)
    assert (
        np.sqrt(np.mean((own @ turn.T - own.mean(axis=0) @ turn.T - true + true.mean(axis=0)) ** 2)) < 12e-6
    )
    assert found.to_dict()["tilt"] == pytest.approx(made.tilt, abs=3e-6)


def _best_turn(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    u, _, v = np.linalg.svd((two - two.mean(axis=0)).T @ (one - one.mean(axis=0)))
    return u @ v


@pytest.mark.daily_cases("2.468143364277402-0.0")
@pytest.mark.parametrize(("radius", "conic"), [(SPHERE, 0.0), (0.985 * SPHERE, 0.3), (1.04 * SPHERE, 0.0)])
def test_light_through_a_measured_front_is_that_through_the_exact_surface(radius, conic):
    found = measure(
        WINDOW,
        mapped(Made(radius=radius, conic=conic, noise=1e-6, spikes=0, dirt=0, lost=0.0, rim=0.0)),
        z_scale=1.0,
    )
    window = prescribe(WINDOW)
    body = window.bodies[0]
    front = replace(body.front, surface=Quadric(1.0 / radius, 1.0 / radius, (1.0 + conic) / radius, 1))
    exact = replace(window, bodies=(replace(body, front=front),))
    lit = bundle(window, 4096, WINDOW.check.field)
    light = measure_light(lambda one: trace(exact, one.rays, path="size"), lit, RequestedLaw.of(window))
    assert found.light.rms == pytest.approx(light.rms, rel=0.02, abs=2e-6)
    assert found.light.formed + found.light.seam == pytest.approx(light.share, abs=0.02)
    assert found.light.low <= light.rms <= found.light.high or abs(found.light.rms - light.rms) < 4e-6


@pytest.mark.slow
def test_a_radius_near_the_limit_is_judged_only_where_the_scale_of_heights_is_known_well_enough():
    near = mapped(Made(radius=0.979 * SPHERE))
    open_ = measure(WINDOW, near)
    assert open_.verdict == "cannot say"
    [light] = [check for check in open_.checks if check.id == "scan_light"]
    assert light.state == "not run"
    assert "would be needed" in light.detail[CANNOT_SAY]
    assert measure(WINDOW, near, z_scale="1 +- 1e-4", lateral_scale="1 +- 1e-5").verdict == "pass"
    far = measure(WINDOW, mapped(Made(radius=0.93 * SPHERE)))
    assert (far.verdict, states(far)["scan_radius"]) == ("fail", "warn")


@pytest.mark.slow
def test_a_second_map_tilted_by_eight_degrees_gives_the_scale_of_heights(tmp_path):
    made = Made(z_scale=1.0071, spread_middle=2e-4, turn=0.02, noise=10e-6)
    tilted = replace(made, tilt=(0.14, 4e-4), seed=1, cells=dict(made.cells))
    tilted.cells = made.cells
    found = measure(WINDOW, mapped(made), tilted=tilted.write(tmp_path / "tilted.npy"))
    assert found.z_scale.origin == "found"
    assert found.z_scale.value == pytest.approx(1.0071, abs=max(4e-4, found.z_scale.half))
    assert found.z_scale.half < 2e-3
    with pytest.raises(NotMeasurable, match="hardly|tilted by"):
        measure(WINDOW, mapped(made), tilted=made.write(tmp_path / "level.npy"))


@pytest.mark.slow
def test_a_part_that_shrank_by_one_per_cent_is_named():
    made = Made(radius=0.99 * SPHERE, pitch=(0.495, 0.495))
    found = measure(WINDOW, mapped(made), z_scale=1.0)
    [pitch] = [check for check in found.checks if check.id == "scan_pitch"]
    assert pitch.state == "fail"
    assert "shrinkage of the part, or another lateral scale" in pitch.sentence


@pytest.mark.slow
def test_texture_is_separated_from_noise_and_taken_as_a_share_of_light():
    rms, period = 12e-6, 0.04
    found = measure(WINDOW, mapped(Made(scallop=(rms, period), noise=5e-6)), z_scale=1.0)
    phase = 2.0 * np.pi * (prescribe(WINDOW).bodies[0].index - 1.0) * rms * 1e-3 / 550e-9
    assert found.texture_share == pytest.approx(np.exp(-(phase**2)), abs=0.003)
    assert found.light.rms < 0.5e-3  # rays through scallops would be off by 0.9 mrad


REFUSED = {
    "bowls": (Made(bowls=True), "bowls for domes|domes where"),
    "period": (Made(pitch=(0.54, 0.54)), "lenslets every"),
    "coarse": (Made(pixel=0.05, size=60), "pixels across a cell"),
    "small": (Made(size=80), "too few lenslets"),
    "tiny": (Made(size=50), "no whole lenslet"),
    "high": (Made(z_scale=1000.0, noise=0.0, spikes=0, dirt=0), "1000 times too large"),
    "flat": (Made(z_scale=0.001, noise=0.0, spikes=0, dirt=0), "1000 times too small"),
    "turned": (Made(turn=np.pi / 4 + 0.003), "turned by 45 deg"),
    "plane": (Made(z_scale=1e-9, noise=20e-6), "range over"),
}


@pytest.mark.daily_cases("coarse", "small", "tiny")
@pytest.mark.parametrize("name", REFUSED)
def test_maps_that_do_not_hold_the_lenslets_are_refused_with_the_reason(name):
    made, words = REFUSED[name]
    with pytest.raises(NotMeasurable, match=words):
        measure(WINDOW, mapped(made))


def test_no_map_and_a_scale_that_is_none_are_refused():
    with pytest.raises(BadRequest, match="no map"):
        measure(WINDOW)
    with pytest.raises(BadRequest, match="z_scale"):
        measure(WINDOW, mapped(Made()), z_scale="much")


@pytest.mark.slow
def test_a_cloud_and_a_grid_of_the_same_part_give_the_same_radius():
    made = mapped(Made(noise=5e-6, spikes=0, dirt=0))
    shifted = made.points.copy()
    shifted[:2] += 3e-3
    order = np.random.default_rng(0).permutation(shifted.shape[1])
    cloud = cloud_map("cloud", shifted[:, order])
    assert cloud.shape == made.shape
    assert cloud.regular
    turned = np.array([[np.cos(0.3), -np.sin(0.3), 0.0], [np.sin(0.3), np.cos(0.3), 0.0], [0.0, 0.0, 1.0]])
    irregular = cloud_map("cloud", turned @ shifted)
    assert not irregular.regular
    radii = [
        measure(WINDOW, one, z_scale=1.0).to_dict()["sides"]["front"]["radius"] for one in (made, irregular)
    ]
    assert radii[1] == pytest.approx(radii[0], rel=2e-5)


WRONG_SCALES = [
    ({"pixel_um": "x", "z_step_nm": 1}, "pixel_um = x is not read"),
    ({"pixel_um": 4}, "z_step_um is not"),
    ([], "not a JSON object"),
    ({"pixel_um": 4, "z_step_nm": 1, "colour": 2}, "colour = 2"),
]


def test_pictures_without_scales_and_with_wrong_ones_are_refused(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.zeros((9, 9)))
    with pytest.raises(BadRequest, match="holds no scales"):
        read_map(path)
    beside = tmp_path / "a.npy.json"
    for told, words in WRONG_SCALES:
        beside.write_text(json.dumps(told))
        with pytest.raises(UnreadableFile, match=words):
            read_map(path)
    (tmp_path / "b.xyz").write_text("0 0 1\n1 0 1\n")
    with pytest.raises(BadRequest, match="its unit is not known"):
        read_map(tmp_path / "b.xyz")


@pytest.mark.slow
def test_every_reader_gives_the_same_heights(tmp_path):
    from PIL import Image

    levels = np.random.default_rng(1).integers(1, 60000, (20, 30)).astype(np.uint16)
    levels[3, 4] = 0
    scales = {"pixel_um": [2.0, 3.0], "z_step_nm": 0.5, "z_at_1_um": -3.0, "invalid": 0, "row_0": "top"}
    np.save(tmp_path / "a.npy", levels)
    Image.fromarray(levels).save(tmp_path / "a.tif")
    Image.fromarray(levels).save(tmp_path / "a.png")
    z = -3e-6 + (levels[::-1].astype(float) - 1.0) * 0.5e-9
    lines = [
        f"{2.0 * c} {3.0 * r} {1e6 * z[r, c]:.9f}"
        for r in range(20)
        for c in range(30)
        if (19 - r, c) != (3, 4)
    ]
    (tmp_path / "a.xyz").write_text("# unit um\n" + "\n".join(lines))
    maps = []
    for name in ("a.npy", "a.tif", "a.png", "a.xyz"):
        (tmp_path / f"{name}.json").write_text(json.dumps(scales))
        maps.append(read_map(tmp_path / name))
    for one in maps:
        assert one.shape == (20, 30)
        np.testing.assert_allclose(one.points, maps[0].points, atol=2e-15, rtol=1e-9)
    assert maps[0].missing == pytest.approx(1.0 / 600.0)
    assert maps[0].points[2].max() == pytest.approx(np.where(levels[::-1] > 0, z, -1.0).max())


# -- samples of an independent simulation --------------------------------------------------------------------

TRUTHS = json.loads((SAMPLES / "truths.json").read_text())
MAPS = {one["file"]: one for one in TRUTHS["maps"]}


def judged_sample(name: str, side: str = "front"):
    """A sample measured with its scale of heights known, and its truth."""
    if name.endswith(".x3p"):
        pytest.importorskip("x3pio")
    if name.endswith(".sdf"):
        pytest.importorskip("sdfio")
    truth = MAPS[name]
    return measure(WINDOW, **{side: SAMPLES / name}, z_scale=(truth["z_scale"], 1e-4)), truth


SLOW_SAMPLES = {
    "front-other-instrument.tif": "front",
    "front.x3p": "front",
    "back.x3p": "back",
    "wrong-insert.sdf": "front",
    "front-tilted.x3p": "front",
}


@pytest.mark.ci_cases("front-coarse.xyz-front", "back.x3p-back", "wrong-insert.sdf-front")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "side"),
    [
        ("front-coarse.xyz", "front"),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in SLOW_SAMPLES.items()),
    ],
)
def test_samples_are_measured_to_the_bars(name, side):
    found, truth = judged_sample(name, side)
    coarse, tilted = "coarse" in name, "tilted" in name
    rows = found.to_dict()
    cells = {tuple(cell["cell"]): cell for cell in truth["cells"]}
    both = [(row, cells[row["i"], row["j"]]) for row in rows["lenslets"] if (row["i"], row["j"]) in cells]
    assert len(both) >= (8 if coarse else 9)
    off = np.mean([row["radius"] - cell["radius_mm"] for row, cell in both]) / truth["radius_mm"]
    assert abs(off) < (5e-4 if coarse else 4e-4 if tilted else 2.5e-4)
    off = np.mean([row["conic"] - cell["conic"] for row, cell in both])
    assert abs(off) < (0.1 if coarse or tilted else 0.03)
    for key, name in (("radius", "radius_mm"), ("conic", "conic")):
        pulls = [(row[key] - cell[name]) / row[f"u_{key}"] for row, cell in both]
        assert np.sum(np.abs(pulls) > 2.0) <= 1  # of nine: 93 % of them all
        assert np.sqrt(np.mean(np.square(pulls))) > 0.2
    index = np.array([[1.0, row["i"], row["j"]] for row, _ in both])
    own = np.array([[row["x"], row["y"]] for row, _ in both])
    true = 1e-3 * np.array([[cell["x_um"], cell["y_um"]] for _, cell in both])
    fits = [np.linalg.lstsq(index, one, rcond=None)[0] for one in (own, true)]
    if not coarse:
        rest = [one - index @ fit for one, fit in zip((own, true), fits, strict=True)]
        assert np.sqrt(np.mean((rest[0] - rest[1]) ** 2)) < 8e-6
        pitches = [np.hypot(*fit[1:].T) for fit in fits]
        assert pitches[0] == pytest.approx(pitches[1], rel=1e-5)
        turns = [np.arctan2(fit[1, 1], fit[1, 0]) for fit in fits]
        assert rows["turn"] - np.radians(truth["turn_deg"]) == pytest.approx(turns[1], abs=1e-5)
        assert rows["tilt"] == pytest.approx(np.array(truth["tilt_mrad"]) * 1e-3, abs=5e-5)


@pytest.mark.slow
def test_light_through_the_samples_is_that_of_their_true_form():
    pytest.importorskip("x3pio")
    pytest.importorskip("sdfio")
    scale = (1.0063, 1e-4)
    pair = measure(WINDOW, SAMPLES / "front.x3p", SAMPLES / "back.x3p", z_scale=scale)
    front = measure(WINDOW, SAMPLES / "front.x3p", z_scale=scale)
    wrong = measure(WINDOW, SAMPLES / "wrong-insert.sdf", z_scale=(1.0, 1e-4))
    for found, name in (
        (pair, "pair"),
        (front, "front_with_ideal_back"),
        (wrong, "wrong_insert_with_ideal_back"),
    ):
        true = TRUTHS["light"][name]["law_rms_mrad"] * 1e-3
        assert abs(found.light.rms - true) < 0.05 * true + 14e-6
        assert found.light.low <= true <= found.light.high
    assert (pair.verdict, front.verdict, wrong.verdict) == ("pass", "pass", "fail")
    assert "astigmatic" in next(check.sentence for check in wrong.checks if check.id == "scan_radius")
    found = measure(WINDOW, SAMPLES / "front.x3p", tilted=SAMPLES / "front-tilted.x3p")
    assert found.z_scale.value == pytest.approx(1.0063, abs=4e-4)


@pytest.mark.slow
def test_an_sdf_file_has_the_heights_that_another_library_reads():
    peer = pytest.importorskip("SurfaceTopography")
    pytest.importorskip("sdfio")
    other = peer.open_topography(str(SAMPLES / "wrong-insert.sdf")).topography()
    heights = (
        np.ma.filled(other.heights(), np.nan).T * {"nm": 1e-9, "µm": 1e-6, "mm": 1e-3, "m": 1.0}[other.unit]
    )
    map_ = read_map(SAMPLES / "wrong-insert.sdf")
    column, row = (
        np.rint(map_.points[k] / map_.pixel[k] + 0.5 * map_.shape[1 - k]).astype(int) for k in (0, 1)
    )
    mine = np.full(map_.shape, np.nan)
    mine[row, column] = map_.points[2]
    np.testing.assert_allclose(mine, heights, atol=1e-15)
