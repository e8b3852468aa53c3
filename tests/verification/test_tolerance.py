"""Fabrication errors show in light as the optics of lens pairs predicts, and studies can be trusted."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from math import hypot, pi

import numpy as np
import pytest

from clacad.cli.tolerance_command import tolerance_text
from clacad.design import Design, DesignError
from clacad.optics.rays import Fate, Rays
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import bundle
from clacad.tracing.trace import trace
from clacad.verification.tolerance import (
    MEASURES,
    Checkpoint,
    Farm,
    NoTolerances,
    OtherStudy,
    bench,
    draw,
    parameters,
    read_study,
    telescopelet,
    tolerance,
    write_study,
)
from clacad.verification.tolerance.farm import NoCluster
from clacad.verification.tolerance.study import yield_if_tighter

SLAB = {
    "format": 1, "name": "slab", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10.0, "index": 1.5}, "lattice": {"pitch": 0.5, "count": [41, 41]},
    "check": {"law_rms": "0.4 mrad", "law_bias": "0.4 mrad"},
}  # fmt: skip
PLANO = SLAB | {
    "pair": {"form": "plano", "separation": 10.0, "thickness": 1.0, "index": 1.5},
    "law": {"eta": [-0.5, -2.0], "delta": [0.02, 0.0]},
}
BICONVEX = SLAB | {
    "pair": {"form": "biconvex", "separation": 10.0, "index": 1.5},
    "law": {"eta": [-0.5, -1.0], "euler": [0.0, 0.5, 0.0]},
}
FORMS = {"slab": SLAB, "plano": PLANO, "biconvex": BICONVEX}
TOLERANCES = {
    "decentre": "2 um", "rotation": "0.05 mrad", "radius": 0.002, "index": 2e-4, "thickness": "10 um",
    "tilt": "0.1 mrad", "roughness": "10 nm", "samples": 24,
}  # fmt: skip


def design(form="slab", **tolerances):
    return Design.from_dict(FORMS[form] | ({"tolerances": tolerances} if tolerances else {}))


@pytest.fixture(scope="module")
def benches():
    found = {}
    for form in FORMS:
        made = design(form)
        window = prescribe(made)
        found[form] = (window, bench(made, window, 64))
    return found


@pytest.mark.parametrize("form", list(FORMS))
def test_a_telescopelet_without_errors_is_the_one_the_tracer_knows(form):
    window = prescribe(design(form))
    lit = bundle(window, 512, 0.02)
    home = np.append(window.lattice.centres(np.array([lit.cell]))[0], 0.0)
    seen = telescopelet(window, {}).send(Rays(lit.rays.position - home, lit.rays.direction))
    out, alive = seen.direction, seen.fate == Fate.ALIVE
    known = trace(window, lit.rays)
    assert ((known.fate == Fate.ALIVE) == alive).all()
    assert alive.any()
    assert np.abs(out - known.direction)[alive].max() < 1e-14


@pytest.mark.parametrize("form", list(FORMS))
def test_nothing_wrong_is_nothing_measured(form, benches):
    found = benches[form][1].measured({})
    assert found["image_shift"] == 0.0
    assert found["moire_rate"] < 1e-9
    assert set(found) == set(MEASURES)


@pytest.mark.parametrize("form", list(FORMS))
@pytest.mark.parametrize("array", [1, 2])
def test_a_decentre_shifts_the_image_by_itself_over_f2(form, array, benches):
    window, table = benches[form]
    step = 1e-3
    found = table.measured({f"decentre.{array}.x": step})
    f2 = window.thin.focal_length[1][0]
    sign = 1.0 if array == 2 else -1.0
    assert found["shift_x"] == pytest.approx(sign * step / f2, rel=0.03)
    assert abs(found["shift_y"]) < 0.02 * abs(step / f2)
    # δ moves by d/f1, and that is what a fit finds
    assert found["delta_x"] - table.measured({})["delta_x"] == pytest.approx(
        sign * step / window.thin.focal_length[0][0], rel=0.03
    )


@pytest.mark.parametrize("form", list(FORMS))
def test_a_turn_makes_a_moire_of_period_pitch_over_twice_the_sine_of_half_the_angle(form, benches):
    window, table = benches[form]
    angle = 1e-4
    period = 0.5e-3 / (2.0 * np.sin(angle / 2.0))
    assert table.measured({"rotation": angle})["moire_period"] == pytest.approx(period, rel=2e-3)


def test_a_wrong_separation_leaves_the_power_of_two_lenses_too_far_apart(benches):
    window, table = benches["plano"]
    (f1, _), (f2, _) = window.thin.focal_length
    grown = table.measured({"separation": 0.01})["power_xx"] - table.measured({})["power_xx"]
    assert grown == pytest.approx(-0.01e-3 / (f1 * f2 * 1e-6), rel=0.01)


def test_wrong_radius_and_index_are_wrong_focal_lengths(benches):
    window, table = benches["slab"]
    f1 = window.thin.focal_length[0][0]  # in air; f1 = f2, Φ = (f1 + f2 − s)/(f1 f2)
    longer = 1e-3 * f1
    assert table.measured({"radius.1": 1e-3})["power_xx"] == pytest.approx(longer * 1e3 / f1**2, rel=0.01)
    # a slab: f ∝ R/(n − 1) and the way T/n; all three change with n
    n, dn = 1.5, 1e-4
    f, way = f1 * (n - 1.0) / (n + dn - 1.0), 2.0 * f1 * n / (n + dn)
    want = (2.0 * f - way) / f**2 * 1e3
    assert table.measured({"index.1": dn})["power_xx"] == pytest.approx(want, rel=0.01)


def test_a_wedge_is_a_wrong_thickness_that_grows_over_the_sheet(benches):
    window, table = benches["slab"]
    tilt, there = 1e-4, 10.0
    far = telescopelet(window, {"tilt.x": tilt}, np.array([0.0, there]))
    near = telescopelet(window, {"thickness.1": tilt * there, "tilt.x": tilt}, np.zeros(2))
    start = np.array([[0.0, 0.0, -1.0], [0.05, 0.02, -1.0], [-0.1, 0.1, -1.0]])
    rays = Rays(start, [0.0, 0.0, 1.0])
    # the rigid turn also draws the far cell in by tilt²/2 of its distance
    np.testing.assert_allclose(far.send(rays).direction, near.send(rays).direction, atol=5e-8)


def test_rough_faces_take_their_scatter_from_the_light(benches):
    _, table = benches["slab"]
    sigma = 20e-9
    lost = 1.0 - np.exp(-2.0 * (2.0 * pi * 0.5 * sigma / 550e-9) ** 2)
    kept = table.measured({"roughness": sigma * 1e3})["throughput"]
    assert kept == pytest.approx(table.measured({})["throughput"] * (1.0 - lost), rel=1e-12)


def test_moving_both_arrays_alike_changes_nothing(benches):
    _, table = benches["biconvex"]
    same = table.measured({"decentre.1.x": 0.02, "decentre.2.x": 0.02})
    assert hypot(same["shift_x"], same["shift_y"]) < 1e-13
    assert same["throughput"] == table.measured({})["throughput"]


def test_a_sample_depends_on_seed_and_number_only():
    made = design(**TOLERANCES)
    chosen = parameters(made, prescribe(made))
    first = draw(chosen, 7, 12)
    assert draw(chosen[::-1], 7, 12) == first
    assert draw(chosen[2:3], 7, 12) == {chosen[2].name: first[chosen[2].name]}
    assert draw(chosen, 8, 12) != first
    assert draw(chosen, 7, 13) != first


@pytest.mark.parametrize(("kind", "sigma"), [("normal", 0.5), ("uniform", 1.0 / np.sqrt(3.0))])
def test_draws_have_the_stated_width(kind, sigma):
    made = design(rotation="1 rad", roughness="1 um")
    chosen = parameters(made, prescribe(made))
    drawn = np.array([list(draw(chosen, 0, k, kind).values()) for k in range(4000)])
    assert drawn[:, 0].std() == pytest.approx(sigma, rel=0.04)
    assert abs(drawn[:, 0].mean()) < 4.0 * sigma / np.sqrt(4000)
    assert (drawn[:, 1] >= 0.0).all()
    assert abs(np.corrcoef(drawn.T)[0, 1]) < 0.06
    assert np.abs(drawn[:, 0]).max() <= (1.0 if kind == "uniform" else np.inf)


@pytest.fixture(scope="module")
def small_errors():
    """Tolerances so small that light answers them linearly."""
    made = design(
        "biconvex", decentre="0.05 um", rotation="1e-6 rad", separation="0.2 um", radius=2e-5, index=2e-6,
        thickness="0.2 um", tilt="1e-6 rad", samples=60,
    )  # fmt: skip
    return tolerance(made, rays=64, farm=Farm(1))


@pytest.mark.ci_cases("shift_x", "power_yy", "slip_yx")
@pytest.mark.slow
@pytest.mark.parametrize("measure", ["shift_x", "shift_y", "power_xx", "power_yy", "slip_yx"])
def test_monte_carlo_agrees_with_the_linear_sensitivities_sheet_by_sheet(measure, small_errors):
    study = small_errors
    at = list(MEASURES).index(measure)
    traced = study.column(measure) - study.nominal[measure]
    linear = study.errors @ study.slopes[:, at]
    assert np.abs(traced).max() > 0.0
    assert np.abs(traced - linear).max() < 5e-3 * np.abs(traced).max()


def test_the_ranking_is_by_change_and_its_shares_add_up(small_errors):
    for measure in ("image_shift", "moire_rate", "residual_power"):
        ranked = small_errors.ranking(measure)
        assert [c for _, c, _ in ranked] == sorted((c for _, c, _ in ranked), reverse=True)
        assert sum(s for _, _, s in ranked) == pytest.approx(1.0)
    assert small_errors.ranking("moire_rate")[0][0] == "rotation"
    assert small_errors.ranking("image_shift")[0][0].startswith("decentre")


@pytest.fixture(scope="module")
def study():
    return tolerance(design(**TOLERANCES), rays=64, farm=Farm(1))


def test_yield_counts_the_sheets_that_keep_every_limit(study):
    good = np.ones(24, dtype=bool)
    for measure, limit in (
        ("law_rms", 4e-4),
        ("law_bias", 4e-4),
        ("eta_error", 0.01),
        ("delta_error", 0.005),
    ):
        good &= study.column(measure) <= limit
    good &= study.column("kept") >= 0.9
    assert study.yields()[0] == good.mean()
    assert 0 < good.sum() < 24
    low, high = study.yields()[1:]
    assert 0.0 <= low < good.mean() < high <= 1.0


@pytest.mark.daily_cases("normal")
@pytest.mark.parametrize("distribution", ["normal", "uniform"])
def test_the_yield_at_a_tighter_tolerance_is_that_of_sheets_drawn_with_it(distribution):
    """The law error is a root mean square of all errors, in place of a trace of each sheet."""
    made = design(decentre="2 um", roughness="10 nm", distribution=distribution)
    empty = tolerance(made, 0, rays=64, farm=Farm(1))
    halves = np.array([p.half for p in empty.parameters])
    measures = np.zeros((3000, len(MEASURES)))
    measures[:, list(MEASURES).index("kept")] = 1.0

    def drawn(chosen, seed):
        errors = np.array([list(draw(chosen, seed, k, distribution).values()) for k in range(3000)])
        made = measures.copy()
        made[:, list(MEASURES).index("law_rms")] = 0.4e-3 * np.linalg.norm(errors / halves, axis=1) / 1.2
        return replace(empty, parameters=tuple(chosen), errors=errors, measures=made)

    loose = drawn(empty.parameters, 1)
    for factor in (0.8, 0.6):
        tight = [replace(p, half=factor * p.half) if p.key == "decentre" else p for p in empty.parameters]
        found, direct = yield_if_tighter(loose, "decentre", factor), drawn(tight, 2).yields()[0]
        assert direct > loose.yields()[0] + 0.05
        share = factor * np.sqrt(2.0 - factor**2) if distribution == "normal" else factor
        count = 3000 * share ** sum(p.key == "decentre" for p in tight)  # effective, of weighted sheets
        assert abs(found - direct) < 4.0 * np.sqrt(direct * (1.0 - direct) * (1.0 / count + 1.0 / 3000))
    assert yield_if_tighter(loose, "decentre", 1.0) == pytest.approx(loose.yields()[0])
    assert yield_if_tighter(loose, "decentre", 0.01) is None


@pytest.mark.slow
def test_own_limits_of_the_table_are_limits_too():
    made = design(**TOLERANCES, image_shift="0.001 mrad", moire_period="1000 m")
    found = tolerance(made, samples=4, rays=64, farm=Farm(1))
    assert found.misses()["image_shift"] == 4
    assert found.misses()["moire_period"] == 4
    assert found.yields()[0] == 0.0


@pytest.mark.slow
def test_two_processes_find_what_one_finds(study):
    other = tolerance(design(**TOLERANCES), samples=6, rays=64, farm=Farm(2))
    np.testing.assert_array_equal(other.measures, study.measures[:6])
    np.testing.assert_array_equal(other.slopes, study.slopes)


@pytest.mark.slow
def test_a_study_is_written_and_read_back_with_the_same_bytes_every_time(tmp_path, study):
    first = [p.read_bytes() for p in write_study(study, tmp_path / "a")]
    second = [p.read_bytes() for p in write_study(study, tmp_path / "b")]
    assert first == second
    found = read_study(tmp_path / "a")
    assert found["yield"]["share"] == study.yields()[0]
    assert found["ranking"]["image_shift"][0]["parameter"].startswith("decentre")
    assert found["samples"] == 24
    lines = (tmp_path / "a" / "tolerances.csv").read_text().splitlines()
    assert len(lines) == 25
    assert float(lines[1].split(",")[1]) == study.errors[0, 0]
    assert (tmp_path / "a" / "tolerances.png").read_bytes().startswith(b"\x89PNG")
    assert read_study(tmp_path / "nothing") is None


@pytest.mark.slow
def test_more_samples_go_on_from_a_checkpoint(tmp_path, study, monkeypatch):
    kept = tmp_path / "tolerances.checkpoint"
    tolerance(design(**TOLERANCES), samples=10, rays=64, farm=Farm(1), checkpoint=kept)
    calls = []

    def counted(self, work, text, pieces):
        calls.extend(k for piece in pieces for k in piece)
        return (work(text, piece) for piece in pieces)

    monkeypatch.setattr(Farm, "run", counted)
    more = tolerance(design(**TOLERANCES), samples=24, rays=64, checkpoint=kept)
    assert len(calls) == 14
    np.testing.assert_array_equal(more.measures, study.measures)


def test_a_checkpoint_of_another_study_is_refused(tmp_path):
    kept = tmp_path / "c"
    with Checkpoint(kept, {"seed": 1}) as first:
        first.append([1.0])
    with pytest.raises(OtherStudy, match="seed"), Checkpoint(kept, {"seed": 2}):
        pass
    (tmp_path / "d").write_text("something else\n")
    with pytest.raises(OtherStudy, match="not a checkpoint"), Checkpoint(tmp_path / "d", {"seed": 2}):
        pass
    with Checkpoint(kept, {"seed": 1}), pytest.raises(OtherStudy, match="another process"):
        Checkpoint(kept, {"seed": 1}).__enter__()


def test_a_checkpoint_keeps_the_good_prefix_of_whatever_a_kill_leaves(tmp_path):
    kept = tmp_path / "c"
    records = [[float(k), float("nan"), float("inf")] for k in range(6)]
    with Checkpoint(kept, {"seed": 1}) as file:
        file.append(records)
    whole = kept.read_bytes()
    header = whole.index(b"\n") + 1
    for cut in range(0, len(whole), 7):
        kept.write_bytes(whole[:cut])
        with Checkpoint(kept, {"seed": 1}) as file:
            have = len(file.records)
            assert cut < header or have == whole[:cut].count(b"\n") - 1
            file.append(records[have:])
        assert kept.read_bytes() == whole
    spoilt = bytearray(whole)
    spoilt[header + 40] ^= 1
    kept.write_bytes(bytes(spoilt))
    with Checkpoint(kept, {"seed": 1}) as file:
        assert len(file.records) < 6
        file.append(records[len(file.records) :])
    assert kept.read_bytes() == whole
    with Checkpoint(kept, {"seed": 1}) as file:
        assert file.records[3][0] == 3.0
        assert np.isnan(file.records[3][1])
        assert np.isinf(file.records[3][2])


def _command(folder, path, samples=40, workers=2):
    return [
        sys.executable, "-m", "clacad", "tolerance", str(path), "-o", str(folder), "--samples", str(samples), "--rays", "64",
        "--workers", str(workers), "-q",
    ]  # fmt: skip


@pytest.mark.long
def test_killed_twenty_times_and_resumed_gives_the_bytes_of_an_unbroken_run(tmp_path):
    path = tmp_path / "sheet.json"
    path.write_text(json.dumps(SLAB | {"tolerances": TOLERANCES}))
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    subprocess.run(_command(whole, path, 200), check=True, timeout=240)
    generator = np.random.default_rng(5)
    grown = []
    kept = broken / "tolerances.checkpoint"
    for k in range(20):
        process = subprocess.Popen(_command(broken, path, 200, 1 + k % 2), start_new_session=True)
        while process.poll() is None and (kept.stat().st_size if kept.exists() else 0) <= max(
            grown, default=0
        ):
            time.sleep(0.01)
        time.sleep(float(generator.uniform(0.0, 0.2)))
        process.send_signal(signal.SIGKILL)
        process.wait()
        grown.append(kept.stat().st_size)
    subprocess.run(_command(broken, path, 200), check=True, timeout=240)
    assert grown == sorted(grown)
    assert len(set(grown)) > 10  # the kills fell into the work, not behind it
    names = sorted(p.name for p in whole.iterdir())
    assert names == sorted(p.name for p in broken.iterdir())
    for name in names:
        assert (whole / name).read_bytes() == (broken / name).read_bytes(), name


@pytest.mark.long
def test_a_killed_run_leaves_no_worker_behind_and_is_resumed(tmp_path):
    path = tmp_path / "sheet.json"
    path.write_text(json.dumps(SLAB | {"tolerances": TOLERANCES}))
    process = subprocess.Popen(_command(tmp_path / "out", path), start_new_session=True)
    kept = tmp_path / "out" / "tolerances.checkpoint"
    for _ in range(600):
        if kept.exists() and kept.read_bytes().count(b"\n") > 2:
            break
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = kept.read_bytes()
    for _ in range(100):
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            break
        time.sleep(0.1)
    else:
        pytest.fail("a worker outlived its parent")
    with Checkpoint(kept, json.loads(before.split(b"\n")[0][17:])) as file:
        assert len(file.records) > 0


def test_a_design_without_tolerances_is_told_how_to_state_them():
    with pytest.raises(NoTolerances, match=r"\[tolerances\]"):
        tolerance(design())


@pytest.mark.long
def test_a_scheduler_that_is_not_there_is_said_in_a_sentence():
    with pytest.raises(NoCluster):
        tolerance(design(**TOLERANCES), samples=1, farm=Farm(scheduler="tcp://127.0.0.1:9"))


@pytest.mark.parametrize(("wrong", "words"), [
    ({"decentre": 5}, "unit"), ({"rotation": "1 mm"}, "length"), ({"radius": -0.1}, "out of range"),
    ({"separation": "1 um"}, "slab"), ({"samples": 0}, "out of range"), ({"distribution": "gaussian"}, "normal"),
    ({"decenter": "5 um"}, "decentre"),
])  # fmt: skip
def test_mistakes_in_the_table_are_named(wrong, words):
    with pytest.raises(DesignError, match=words):
        design(**wrong)


def test_the_table_reads_back_from_its_canonical_text():
    made = design(**TOLERANCES, blur="1 mrad", moire_period="1 m", residual_power=2)
    again = Design.from_dict(made.to_dict())
    assert again == made
    assert again.sha256 == made.sha256
    assert "tolerances" not in design().to_dict()


def test_rays_are_sent_over_cell_1_wherever_it_stands(benches):
    window, table = benches["slab"]
    moved = telescopelet(window, {"decentre.1.x": 0.1})
    start = np.array([[0.1, 0.0, -1.0]])
    seen = moved.send(Rays(start, [[0.0, 0.0, 1.0]]))
    assert (seen.fate == Fate.ALIVE).all()
    assert seen.direction[0, 0] != 0.0  # the axis of lens 1 misses that of lens 2


CORNERED = {
    "format": 1, "name": "cornered", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10.0, "material": "PMMA"}, "lattice": {"pitch": 0.5, "count": [20, 20]},
    "tolerances": {"decentre": "5 um", "rotation": "1 mrad", "radius": 0.005, "samples": 4},
}  # fmt: skip


@pytest.mark.slow
def test_a_study_says_which_cell_its_law_error_is_of_and_names_every_contributor():
    """A turn of array 2 by α moves lens 2 of a corner cell by α r, and its light by α r/f2; decentres move all cells alike."""
    study = tolerance(Design.from_dict(CORNERED), farm=Farm(1))
    corner, alpha, f2 = 4.75, 1e-3, 5.0
    x, y = study.place("rotation")
    assert (abs(x), abs(y)) == pytest.approx((corner * 1e-3, corner * 1e-3))
    assert study.place("decentre.1.x") == (0.0, 0.0)
    designed = study.nominal["law_rms"]
    want = np.hypot(designed, alpha * corner * np.sqrt(2.0) / f2) - designed
    assert dict((n, c) for n, c, _ in study.ranking("law_rms"))["rotation"] == pytest.approx(want, rel=0.01)
    small = tolerance(
        Design.from_dict(CORNERED | {"tolerances": CORNERED["tolerances"] | {"rotation": "20 urad"}}),
        farm=Farm(1),
    )
    for text in (tolerance_text(study), tolerance_text(small)):
        part = text.split("law error, rms / mrad")[1].split("a good sheet keeps")[0]
        assert all(p.name in part for p in study.parameters)
        assert "of the worst of the middle cell and the cells in the corners" in part
        assert "in the middle" in part
    assert "4.75" in tolerance_text(study)
