"""Errors that differ from lenslet to lenslet, and tolerances of a process by published figures."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from verification.test_tolerance import PLANO, SLAB

from clacad.cli import main
from clacad.design import Design, DesignError, load
from clacad.design.process import Process
from clacad.design.process_profiles import TOLERANCE_CLASSES
from clacad.making.light_as_made import light_as_made
from clacad.optics.surface import Biconic, EvenPolynomial, Quadric
from clacad.prescription.prescribe import prescribe
from clacad.sheet.shrunk import grown_surface
from clacad.verification.tolerance import Farm, bench, draw, parameters, tolerance
from clacad.verification.tolerance.study import yield_if_tighter

SCATTER = {
    "scatter_pitch": ["1 um", "2 um"],
    "scatter_radius": [0.004, 0.002],
    "scatter_vertex": ["8 um", "5 um"],
}


def made(form=SLAB, **tolerances) -> Design:
    return Design.from_dict(form | {"tolerances": tolerances})


@pytest.mark.parametrize("array", [1, 2])
def test_lenslets_out_of_place_spread_the_light_by_their_scatter_over_the_focal_length(array):
    """Each lenslet turns its light by its displacement over f2, along x and along y alike."""
    halves = ["0 um", "0 um"]
    halves[array - 1] = "2 um"
    design = made(scatter_pitch=halves)
    window = prescribe(design)
    table = bench(design, window, 256)
    f2 = window.thin.focal_length[1][0]
    errors = draw(parameters(design, window), 0, 0)
    assert set(errors) == {f"scatter_pitch.{array}.x", f"scatter_pitch.{array}.y"}
    before, after = table.measured({}), table.measured(errors)
    spread = 2.0 * (2e-3 / f2) ** 2
    assert after["law_rms"] ** 2 - before["law_rms"] ** 2 == pytest.approx(spread, rel=0.03)
    assert after["blur"] ** 2 - before["blur"] ** 2 == pytest.approx(spread, rel=0.03)
    for measure in ("image_shift", "law_bias", "residual_power", "moire_rate"):
        assert after[measure] == before[measure]


@pytest.mark.parametrize(
    ("form", "lenslets"),
    [(SLAB, 150), *(pytest.param(one, 2000, marks=pytest.mark.slow) for one in (SLAB, PLANO))],
)
def test_the_scatter_of_a_sheet_is_that_of_many_lenslets_drawn_one_by_one(form, lenslets):
    """Every lenslet has all errors at once, traced and pooled; the program adds changes of one error each."""
    design = made(form, **SCATTER)
    window = prescribe(design)
    table = bench(design, window, 128)
    sigmas = draw(parameters(design, window), 0, 0)
    random = np.random.default_rng(3)
    squares, light = [], []
    for _ in range(lenslets):
        errors = {name: sigma * random.standard_normal() for name, sigma in sigmas.items()}
        one = table.in_middle(errors)["cone"]
        squares.append(one.rms[0] ** 2)
        light.append(one.share[0])
    found = table.measured(sigmas)
    doubt = np.std(squares) / np.sqrt(lenslets)
    nominal = table.measured({})
    assert np.mean(squares) > nominal["law_rms"] ** 2 + 4.0 * doubt
    middle = table.in_middle({})["cone"].rms[0] ** 2 + table.scattered(sigmas)["law_rms"]
    assert middle == pytest.approx(np.mean(squares), abs=3.0 * doubt + 0.02 * np.mean(squares))
    assert found["kept"] - nominal["kept"] == pytest.approx(
        (np.mean(light) - table.in_middle({})["cone"].share[0]) / table.closed_form, abs=0.004
    )


@pytest.mark.slow
def test_a_scatter_is_the_same_on_every_sheet_and_ranked_next_to_errors_of_arrays():
    design = made(decentre="1 um", samples=6, **SCATTER)
    study = tolerance(design, rays=64, farm=Farm(1))
    names = [one.name for one in study.parameters]
    columns = [k for k, one in enumerate(study.parameters) if one.scatter]
    assert [names[k] for k in columns] == [
        f"scatter_{name}" for part in "12"
        for name in (f"pitch.{part}.x", f"pitch.{part}.y", f"radius.{part}", f"vertex.{part}")
    ]  # fmt: skip
    assert (np.ptp(study.errors[:, columns], axis=0) == 0.0).all()
    assert (study.column("law_rms") > study.nominal["law_rms"]).all()
    changes = {name: change for name, change, _ in study.ranking("law_rms")}
    assert changes["scatter_pitch.2.x"] > 1.5 * changes["scatter_pitch.1.x"] > 0.0
    assert yield_if_tighter(study, "scatter_pitch", 0.5) is None


@pytest.mark.parametrize("surface", [
    Quadric(0.4, 0.3, 0.25, 1), Biconic(0.4, 0.3, -0.4, 0.2, 1),
    EvenPolynomial(0.4, 0.3, -0.4, 0.2, (1e-2, 2e-2, 3e-2), 1, (1e-3, 0.0, 0.0, 2e-3), (1e-3, 0.0, 0.0, 0.0, 0.0)),
])  # fmt: skip
def test_a_face_that_shrinks_in_height_has_its_heights_times_one_less_the_error(surface):
    at = np.linspace(-0.5, 0.5, 21)
    x, y = np.meshgrid(at, at)
    assert grown_surface(surface, (1.0, 1.0, 0.97)).sag(x, y) == pytest.approx(
        0.97 * surface.sag(x, y), rel=1e-12, abs=1e-15
    )


def test_an_error_of_the_shrinkage_is_a_contributor_with_the_power_of_longer_focal_lengths():
    """Both faces flatter by e: f longer by e to first order, the slab as thick as before."""
    design = made(shrinkage=0.002)
    window = prescribe(design)
    assert [(one.name, one.half) for one in parameters(design, window)] == [("shrinkage", 0.002)]
    table = bench(design, window, 64)
    f1 = window.thin.focal_length[0][0]
    assert table.measured({"shrinkage": 1e-4})["power_xx"] == pytest.approx(2e-4 * 1e3 / f1, rel=0.01)


@pytest.mark.parametrize(
    ("errors", "process"),
    [
        ({"gamma": 0.02}, Process(gamma=1.02)),
        ({"gamma": -0.02}, Process(gamma=0.98)),
        ({"shrinkage": 0.02}, Process(shrinkage=(0.0, 0.0, 0.02))),
        ({"shrinkage_lateral": 0.01}, Process(shrinkage=(0.01, 0.01, 0.0))),
        ({"nose": 0.2}, Process(nose=200e-6)),
        ({"nose.insert": 0.2}, Process("moulding", nose=200e-6)),
    ],
)
def test_an_error_of_the_process_leaves_the_light_of_the_sheet_as_made(errors, process):
    """Faces fitted by polynomials and traced as a sequence, against heights traced by Newton's method."""
    design = load("window-100mm", ["lattice.count = [4, 4]"])
    window = prescribe(design)
    table, made = bench(design, window, 1024), light_as_made(design, window, 8192, process)
    found = table.measured(errors)
    assert found["law_rms"] == pytest.approx(made.formed, rel=0.02)
    loss = table.measured({})["throughput"] - found["throughput"]
    assert loss == pytest.approx(made.share_designed - made.share_formed, abs=6e-3)


@pytest.mark.slow
def test_errors_of_the_process_are_contributors():
    written = {"shrinkage_lateral": 0.01, "gamma": 0.02, "nose": "25 um", "samples": 4}
    window = prescribe(made(**written))
    assert [(one.name, one.half) for one in parameters(made(**written), window)] == [
        ("shrinkage_lateral", 0.01),
        ("gamma", 0.02),
        ("nose", 0.025),
    ]
    study = tolerance(made(**written), rays=64, farm=Farm(1))
    assert study.ranking("law_rms")[0][0] in ("gamma", "shrinkage_lateral")
    assert study.ranking("throughput")[0][1] > 0.0
    moulded = made(SLAB | {"check": {"process": "moulding"}}, nose="25 um")
    assert [one.name for one in parameters(moulded, window)] == ["nose.insert"]


@pytest.mark.parametrize("name", TOLERANCE_CLASSES)
def test_a_class_gives_the_tolerances_that_are_not_stated(name):
    unit = {
        "unit": "in",
        "pair": SLAB["pair"] | {"separation": 0.4},
        "lattice": {"pitch": 0.02, "count": [3, 3]},
    }
    own = made(SLAB | unit, **{"class": name, "radius": 0.0123})
    assert own.tolerances.radius == (0.0123, 0.0123)
    published = TOLERANCE_CLASSES[name].values
    metres = float(published["decentre"][1].removesuffix(" um")) * 1e-6
    assert own.tolerances.decentre == pytest.approx((0.0, metres / 0.0254))
    assert {one.key for one in parameters(own, prescribe(own))} == set(published)
    again = Design.from_dict(tomllib.loads(own.canonical_toml()))
    assert (again, again.sha256) == (own, own.sha256)
    assert own.replace("tolerances.decentre", "0 um").tolerances.decentre == (0.0, 0.0)


def test_designs_without_class_and_scatter_keep_their_hashes():
    text = load("window-100mm").replace("tolerances.radius", 0.002).canonical_toml()
    assert "class" not in text
    assert "scatter" not in text


def test_an_unknown_class_names_the_nearest():
    with pytest.raises(DesignError, match="moulding-precision"):
        made(**{"class": "molding-precision"})


def test_the_source_of_every_class_is_printed(capsys):
    for name, one in TOLERANCE_CLASSES.items():
        assert main(["explain", f"class {name}"]) == 0
        printed = " ".join(capsys.readouterr().out.split())
        assert one.source[:60] in printed
