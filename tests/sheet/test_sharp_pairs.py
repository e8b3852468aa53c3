"""Pairs that image two planes sharply: every ray of every pair meets at the image, the trap near the focus, how they are judged."""

from __future__ import annotations

import json
from math import inf

import numpy as np
import pytest
from mpmath import mp, mpf
from oracle import varying as oracle

import clacad
from clacad.optics.law.focusing import SharpPair, cell_width
from clacad.optics.rays import Fate
from clacad.sheet.bundle import RequestedLaw
from clacad.verification.light.law_checks import judge_light
from clacad.verification.light.special_checks import image_checks
from clacad.verification.light.through_window import Lit
from clacad.verification.tolerance import bench

BASE = {
    "format": 1, "name": "sharp", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10.0, "material": "PMMA", "surface": "biconic",
             "focus": {"object": -300, "image": 400}},
    "lattice": {"pitch": 0.5, "count": [9, 9]},
}  # fmt: skip


def design(**changes):
    made = json.loads(json.dumps(BASE))
    for key, value in changes.items():
        section, _, name = key.partition("__")
        made[section][name] = value
    return clacad.Design.from_dict(made)


CASES = [
    {},
    {"law__eta": [-0.25, -0.5]},
    {"law__eta": [-0.25, -0.5], "law__euler": [90, 0, 0]},
    {"law__eta": [0.5, -2.0], "law__delta": [0.01, -0.02]},
    {"pair__form": "plano", "pair__thickness": [2.0, 1.0]},
    {"lattice__kind": "hexagonal", "law__euler": [17, 0, 0]},
    {"pair__focus": {"object": -300, "image": -60}},
]


@pytest.mark.parametrize("changes", CASES)
def test_every_ray_of_every_ideal_pair_meets_at_one_image(changes):
    window = clacad.prescribe(design(**changes))
    rng = np.random.default_rng(0)
    cells = window.lattice.cells()
    at = np.repeat(window.lattice.centres(cells), 20, axis=0)
    at = at + rng.uniform(-0.1, 0.1, at.shape)
    told = window.recipe["focus"]
    for source in ([0.0, 0.0], [0.7, -0.4]):
        way = np.column_stack([at - source, np.full(len(at), -told["object"])])
        seen = clacad.trace(
            window, clacad.Rays(np.column_stack([at, np.zeros(len(at))]) - 0.1 * way, way), rung="thin"
        )
        alive = seen.fate == Fate.ALIVE
        assert alive.mean() > 0.4
        place, out = seen.position[alive], seen.direction[alive]
        level = window.thin.offset[2] + told["image"]
        hit = place[:, :2] + ((level - place[:, 2]) / out[:, 2])[:, None] * out[:, :2]
        assert np.ptp(hit, axis=0).max() < 1e-11
    law = window.law
    moved = -np.array([law.delta_x, law.delta_y]) / (law.eta_x, law.eta_y) * told["image"]
    image = (
        np.array(told["magnification"]) * (np.array(source) @ law.rotation[:2, :2]) + moved
    ) @ law.rotation[:2, :2].T
    assert hit.mean(axis=0) == pytest.approx(image, rel=1e-10)


@pytest.mark.parametrize("eta", [-1.0, -0.25, 0.5])
@pytest.mark.parametrize("planes", [(-300.0, 400.0), (-inf, 400.0), (-300.0, inf), (-20.0, -7.0), (-1e12, 5.000000001), (-4.9, 5.0 * (1 + 1e-12))])  # fmt: skip
def test_the_lenses_are_those_of_fifty_digits_also_where_they_run_away(eta, planes):
    pair = SharpPair.of(eta, 10.0, *planes)
    with mp.workdps(50):
        z, far = (mpf(0) if v in (inf, -inf) else 1 / mpf(v) for v in planes)
        f2 = -mpf(eta) * 10 / (1 - mpf(eta))
        f1 = 1 / (1 / (10 - 1 / (1 / f2 - far)) - z)
        ratio = (1 - f2 * far) / (1 + f1 * z)
    assert pair.focal_lengths[0] == pytest.approx(float(f1), rel=2.0**-52)
    assert pair.focal_lengths[1] == pytest.approx(float(f2), rel=2.0**-52)
    if abs(float(f1)) < 100 and abs(planes[1]) > 6:
        assert pair.pitch_ratio == pytest.approx(float(ratio), rel=1e-14)
        assert pair.separation == pytest.approx(10.0, rel=1e-13)
    if inf not in (-planes[0], planes[1]):
        gap, exact = oracle.sharp(pair.focal_lengths, *planes)
        assert pair.separation == pytest.approx(float(gap), rel=2.0**-51)
        assert pair.pitch_ratio == pytest.approx(float(exact), rel=2.0**-51)


@pytest.mark.parametrize("kappa", [-0.005, 0.01])
def test_the_width_of_an_afocal_cells_image_is_that_of_the_glens(kappa):
    sheet, z = (-1.0, kappa, 10.0, 0.0), -300.0
    along, _ = oracle.image(sheet, (0.0, z))
    assert cell_width((5.0, 5.0), 10.0, (z, float(along)), 0.5) == pytest.approx(
        float(oracle.width(sheet, (0.0, z), 0.5)), rel=1e-12
    )


@pytest.mark.parametrize("planes", [{"object": -5, "image": 400}, {"object": -300, "image": 5.0001}, {"object": -4.2, "image": 900}])  # fmt: skip
def test_planes_near_the_foci_are_refused_with_planes_that_work(planes):
    with pytest.raises(clacad.DesignError) as caught:
        clacad.prescribe(design(pair__focus=planes))
    (mistake,) = caught.value.mistakes
    assert mistake.code == "CL120"
    assert mistake.key == "pair.focus"
    words = dict(part.split(" = ") for part in mistake.hint.split(", "))
    clacad.prescribe(design(pair__focus={name: float(value) for name, value in words.items()}))


@pytest.mark.parametrize(("changes", "code"), [
    ({"pair__focus": {"object": "-inf", "image": "inf"}}, "CL113"),
    ({"pair__focus": {"object": 300, "image": 400}}, "CL106"),
    ({"pair__focus": {"object": -300}}, "CL103"),
    ({"pair__focus": "sharp"}, "CL107"),
    ({"law__eta": [1.0, -1.0]}, "CL111"),
    ({"law__eta": [-0.5, -1.0], "lattice__kind": "hexagonal"}, "CL116"),
    ({"law__eta": [-0.5, -1.0], "law__euler": [20, 0, 0]}, "CL125"),
])  # fmt: skip
def test_what_cannot_be_focused_is_refused_by_its_code(changes, code):
    with pytest.raises(clacad.DesignError) as caught:
        design(**changes)
    assert [mistake.code for mistake in caught.value.mistakes] == [code]


def test_an_afocal_design_has_the_text_it_had_and_a_focused_one_reads_back():
    plain, same = design(pair__focus="afocal"), design(pair__focus={"object": "-inf", "image": 400})
    assert "focus" not in plain.canonical_toml()
    assert clacad.Design.from_dict(same.to_dict()) == same


def test_light_is_held_to_the_law_less_what_the_focus_was_asked_to_do():
    window = clacad.prescribe(design())
    centre = window.lattice.centres(np.array([4, 4]))
    points = np.random.default_rng(1).uniform(-0.25, 0.25, (200, 2))
    d = np.array([0.003, -0.002, 1.0])
    start = np.column_stack([centre + points, np.zeros(200)]) - d
    seen = clacad.trace(window, clacad.Rays(start, d), rung="thin")
    alive = seen.fate == Fate.ALIVE
    assert alive.mean() > 0.8
    out, points = seen.direction[alive], points[alive]
    asked = window.law_at((4, 4)).refract(d)
    assert np.abs(out - asked).max() > 1e-3
    assert np.abs(RequestedLaw.of(window).without_focus(points, out) - asked).max() < 1e-14


@pytest.mark.slow
def test_a_sharp_sheet_passes_its_checks_and_another_focus_fails():
    asked = design()
    found, _ = judge_light(asked, clacad.prescribe(asked), 2048, 512)
    states = {check.id: check.state for check in found}
    assert set(states.values()) <= {"pass", "warn"}
    assert states["image_point"] == states["confocality"] == states["law_rms"] == "pass"
    other = clacad.prescribe(design(pair__focus={"object": -300, "image": 380}))
    assert (
        next(
            check for check in image_checks(Lit(asked, other, other, None)) if check.id == "image_point"
        ).state
        == "fail"
    )


@pytest.mark.slow
def test_a_written_step_of_sharp_pairs_is_judged_less_what_the_focus_was_asked_to_do(tmp_path):
    asked = design(lattice__count=[3, 3])
    clacad.export(asked, tmp_path, ["step"])
    report = clacad.verify(asked, tmp_path, rays=2000)
    found = {check.id: check for check in report.checks}
    assert found["file_law_rms"].state == "pass"
    assert found["file_law_rms"].value < 1e-4  # parallel light alone would be 0.85 mrad off
    assert found["file_law_bias"].value < 1e-4
    assert not [check.id for check in report.checks if check.state == "fail"]


THICK = [
    {},
    {"pair__form": "plano", "pair__curved": "inside", "pair__thickness": [3.0, 2.0]},
    {"pair__form": "plano", "pair__curved": "inside", "pair__thickness": "auto", "law__eta": [-0.5, -0.25]},
    {"pair__form": "biconvex", "pair__thickness": [1.5, 1.0], "pair__surface": "ellipsoid"},
    {"pair__form": "biconvex", "pair__thickness": [0.5, 1.0], "pair__surface": "ellipsoid", "law__eta": [-2.0, -0.5]},
    {"pair__form": "biconvex", "pair__thickness": 1.0, "pair__surface": "ellipsoid", "law__eta": [2.0, 2.0],
     "pair__focus": {"object": -300, "image": -200}, "law__delta": [0.01, 0.0]},
    {"pair__form": "biconvex", "pair__thickness": "auto", "pair__surface": "ellipsoid", "pair__focus": {"object": "-inf", "image": 150}},
]  # fmt: skip


def paraxial(window, cell, axis, height, slope):
    """Height and slope behind the last face of a ray that leaves z = 0 at `height`: refraction by refraction, in 40 digits."""
    z, index = mpf(0), mpf(1)
    for body in window.bodies:
        for face, after in ((body.front, mpf(body.index)), (body.back, mpf(1))):
            place = 0.0 if face.array is None else window.centres(face.array, np.array(cell))[axis]
            vertex = mpf(float(place)) + mpf(face.vertex[axis])
            bend = face.side * (face.surface.curvature_x, face.surface.curvature_y)[axis]
            height += (mpf(face.vertex[2]) - z) * slope
            slope = (index * slope - (after - index) * mpf(bend) * (height - vertex)) / after
            z, index = mpf(face.vertex[2]), after
    return height - z * slope, slope


@pytest.mark.parametrize("changes", THICK)
def test_paraxial_light_of_every_cell_of_thick_lenses_meets_where_it_was_asked_to(changes):
    """Array 2 is where the lens's middle is, of a plano lens its apex."""
    window = clacad.prescribe(design(**changes))
    told = window.recipe["focus"]
    lens_2 = [face for face in window.faces if face.array == 1]
    level = sum(mpf(face.vertex[2]) for face in lens_2) / len(lens_2)
    with mp.workdps(40):
        image = level + told["image"]
        for axis in (0, 1):
            met = []
            for cell in ((4, 4), (7, 2), (0, 8)):
                for off in (0.0, 0.2):
                    x = mpf(float(window.centres(0, np.array(cell))[axis])) + off
                    if told["object"] is None:
                        height, slope = paraxial(window, cell, axis, x, mpf("0.003"))
                    else:
                        slope = (x - mpf("0.7")) / -mpf(told["object"])
                        height, slope = paraxial(window, cell, axis, x, slope)
                    met.append(height + image * slope)
            assert max(met) - min(met) < 1e-11


@pytest.mark.slow
def test_tolerances_of_a_sharp_pair_are_those_of_its_checks():
    """The requested focus spreads parallel light over a cell by far more than the error; it is no error."""
    made = design()
    window = clacad.prescribe(made)
    checks, optics = judge_light(made, window, 8192, 1024)
    found = bench(made, window).measured({})
    assert found["law_rms"] == pytest.approx(optics.main.rms, rel=0.1)
    assert found["blur"] == pytest.approx(optics.points[0].spread, rel=0.1)
    focus = np.abs(RequestedLaw.of(window).power).max() * 0.5 * window.lattice.pitch[0]
    assert found["law_rms"] < 0.3 * focus
