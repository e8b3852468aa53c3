"""Pairs that image two planes sharply: every ray of every pair meets at the image, the trap near the focus, how they are judged."""

from __future__ import annotations

import json
from math import inf

import numpy as np
import pytest
from mpmath import mp, mpf
from oracle import varying as oracle

import clacad
from clacad.imaging.image_by_rays import best_point
from clacad.optics.law.focusing import SharpPair, cell_width
from clacad.optics.rays import Fate
from clacad.prescription import traced_vertices
from clacad.sheet.bundle import RequestedLaw, bundle
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


LENSED = {
    "slab": {}, "wide gap": {"pair__field": {"gap": 0.5}}, "unequal": {"law__eta": [-0.6, -0.6]}, "cylinders": {"law__eta": [-1.0, -0.8]},
    "plano": {"pair__form": "plano", "pair__thickness": [2.0, 1.0]}, "hexagonal": {"lattice__kind": "hexagonal"},
    "curved inside": {"pair__form": "plano", "pair__thickness": [2.0, 1.0], "pair__curved": "inside"},
    "biconvex": {"pair__form": "biconvex", "pair__thickness": 1.0},
}  # fmt: skip


@pytest.mark.parametrize("aperture", ["centred", "aligned", [0.01, -0.005]])
@pytest.mark.parametrize("form", LENSED)
def test_every_ray_of_every_pair_with_a_field_lens_meets_at_one_image(form, aperture):
    """Of ideal lenses exactly; of small real ones the middles of the spots of three cells agree."""
    lensed = {"pair__field_lens": True, "pair__surface": "ellipsoid", "lattice__pitch": 0.05}
    window = clacad.prescribe(
        design(**lensed, **LENSED[form], law__delta=[0.004, -0.002], lattice__aperture=aperture)
    )
    cells, rng = window.lattice.cells()[[30, 40, 50]], np.random.default_rng(0)
    owner = np.repeat(np.arange(3), 40)
    at = window.lattice.centres(cells)[owner] + rng.uniform(-0.015, 0.015, (120, 2))
    way = np.column_stack(
        [at + 300.0 * np.divide(window.thin.shift, window.thin.offset[2]), np.full(120, 300.0)]
    )
    back = window.bodies[-1].back
    ends = {"thin": window.thin.offset[2], "surfaces": back.vertex[2] - (0.5 if form == "biconvex" else 0.0)}
    for rung, end in ends.items():
        seen = clacad.trace(
            window, clacad.Rays(np.column_stack([at, np.zeros(120)]) - 0.1 * way, way), rung=rung
        )
        alive = seen.fate == Fate.ALIVE
        assert alive.mean() > 0.95 or (form == "cylinders" and rung == "surfaces")
        far = (end + 400.0 - seen.position[:, 2]) / seen.direction[:, 2]
        hit = seen.position[:, :2] + far[:, None] * seen.direction[:, :2]
        slope, law = np.divide(window.thin.shift, window.thin.offset[2]), window.law
        out = (slope - [law.delta_x, law.delta_y]) / [law.eta_x, law.eta_y]
        off = np.abs(hit[alive].mean(axis=0) - (window.thin.shift + 400.0 * out))
        assert off.max() < (1e-12 if rung == "thin" else 0.03 if form == "curved inside" else 0.01)
        spots = [hit[alive & (owner == k)] for k in range(3)]
        middles = [spot.mean(axis=0) for spot in spots if len(spot)]
        if rung == "thin":
            assert np.ptp(hit, axis=0).max() < 1e-13
        else:
            assert np.ptp(middles, axis=0).max() < (5e-3 if form == "curved inside" else 2e-4)


@pytest.mark.parametrize("form", ["slab", "plano", "biconvex"])
def test_steered_pairs_image_an_object_beside_the_axis_to_one_point(form):
    """Cells 2 lie where the light of the slope arrives, and no lens moves for it."""
    more = (
        {} if form == "slab" else {"pair__form": form, "pair__surface": "ellipsoid", "pair__thickness": 1.0}
    )
    steered, plain = (
        clacad.prescribe(design(**more, **way)) for way in ({"lattice__aperture": [0.02, -0.01]}, {})
    )
    cells, rng = steered.lattice.cells(), np.random.default_rng(1)
    apart = [
        w.vertices(w.faces[-1], cells) + [1.0, 1.0, 0.0] * np.pad(w.centres(1, cells), ((0, 0), (0, 1)))
        for w in (plain, steered)
    ]
    assert np.abs(apart[0] - apart[1]).max() < 5e-3  # less the coma that offset = "traced" takes out
    at = np.repeat(steered.lattice.centres(cells), 20, axis=0) + rng.uniform(-0.1, 0.1, (20 * len(cells), 2))
    way = np.column_stack([at - [-6.0, 3.0], np.full(len(at), 300.0)])
    rays = clacad.Rays(np.column_stack([at, np.zeros(len(at))]) - 0.1 * way, way)
    for rung, off in (("thin", 1e-11), ("surfaces", 0.1)):
        seen = clacad.trace(steered, rays, rung=rung, path="numpy")
        assert (seen.fate == Fate.ALIVE).all()
        far = (
            steered.thin.offset[2] + 400.0 - seen.position[:, 2]
            if rung == "thin"
            else steered.faces[-1].vertex[2] + 400.0 - seen.position[:, 2]
        )
        hit = seen.position[:, :2] + (far / seen.direction[:, 2])[:, None] * seen.direction[:, :2]
        assert np.hypot(*hit.std(axis=0)) < off
        assert hit.mean(axis=0) == pytest.approx([-7.8, 3.9], rel=1e-10 if rung == "thin" else 0.02)
    alone = clacad.trace(clacad.prescribe(design(**more)), rays, rung="thin", path="numpy")
    assert (alone.fate == Fate.ALIVE).mean() < 0.8


INCLINED = [
    {}, {"lattice__kind": "hexagonal", "law__delta": [0.01, -0.02]}, {"pair__form": "plano"},
    {"pair__form": "plano", "pair__curved": "inside"}, {"pair__focus": {"object": "-inf", "image": 200}},
    {"pair__form": "biconvex", "pair__surface": "ellipsoid", "pair__thickness": 1.0, "law__eta": [-0.5, -0.5]},
]  # fmt: skip


@pytest.mark.daily_cases("changes4")
@pytest.mark.parametrize("changes", INCLINED)
def test_tilted_pairs_image_the_point_of_their_axis_sharply_each_from_its_own_distance(changes):
    """Every ray of every ideal pair meets at (-delta/eta, 1) times the image distance, lens frame."""
    window = clacad.prescribe(design(law__euler=[20, 7, -5], **changes))
    turn, planes, rng = window.law.rotation, window.recipe["focus"], np.random.default_rng(0)
    at = np.repeat(window.lattice.centres(window.lattice.cells()), 20, axis=0)
    at = np.column_stack([at + rng.uniform(-0.05, 0.05, at.shape), np.zeros(len(at))])
    way = 0.0 * at + turn[:, 2] if planes["object"] is None else at - planes["object"] * turn[:, 2]
    rays = clacad.Rays(at - 0.5 * way / np.linalg.norm(way, axis=1)[:, None], way)
    image = -planes["image"] / window.law.eta_x * np.array([window.law.delta_x, window.law.delta_y])
    for rung, off in (("thin", 1e-11), ("surfaces", 0.06)):
        seen = clacad.trace(window, rays, rung=rung, path="numpy")
        alive = seen.fate == Fate.ALIVE
        assert alive.mean() > 0.45
        place, out = seen.position[alive] @ turn, seen.direction[alive] @ turn
        if rung == "thin":
            hit = place[:, :2] + ((10.0 + planes["image"] - place[:, 2]) / out[:, 2])[:, None] * out[:, :2]
            assert np.abs(hit - image).max() < off
        else:  # of plano lenses the axis ray leaves aside; what counts is that it is narrow
            met = best_point(place, out)
            assert max(met.spot) < off
            behind = met.point[2] - window.faces[-1].vertex @ turn[:, 2]
            assert behind == pytest.approx(planes["image"], rel=0.05)


def test_tilted_sharp_pairs_have_lenses_1_of_the_focal_lengths_of_the_lens_equation():
    window = clacad.prescribe(design(law__euler=[0, 5, 0]))
    (body,) = window.bodies
    for cell in window.lattice.cells()[[0, 40, -1]]:
        along = float(np.array([*window.lattice.centres(cell), 0.0]) @ window.law.rotation[:, 2])
        v = 10.0 - 1.0 / (1.0 / 5.0 - 1.0 / (400.0 - along))
        radius = (body.index - 1.0) / (1.0 / v + 1.0 / (300.0 + along))
        own = window.in_cell(body.front, cell).surface
        assert own.curvature_x == pytest.approx(1.0 / radius, rel=1e-14)
        assert window.in_cell(body.back, cell).surface == body.back.surface
    assert np.ptp([window.in_cell(body.front, c).surface.curvature_x for c in window.lattice.cells()]) > 1e-7
    assert window.law_at((0, 0)) == design(law__euler=[0, 5, 0]).law_at((0, 0))


def test_lenses_2_of_many_tilted_pairs_are_moved_by_a_polynomial_as_by_each_trace(monkeypatch):
    one = clacad.prescribe(design(law__euler=[20, 7, -5]))
    monkeypatch.setattr(traced_vertices, "DIRECT", 10)
    monkeypatch.setattr(traced_vertices, "LADDER", ((40, 4),))
    monkeypatch.setattr(traced_vertices, "HELD_OUT", 20)
    other = clacad.prescribe(design(law__euler=[20, 7, -5]))
    a, b = (window.vertices(window.faces[1], window.lattice.cells()) for window in (one, other))
    assert 0.0 < np.abs(a - b).max() < 1e-9 * 0.5


@pytest.mark.daily_cases("planes1")
@pytest.mark.parametrize("planes", [{"pair__focus": {"object": -300, "image": 400}}, {"law__varying": {"f_image": 200}},
                                    {"law__varying": {"conjugates": {"object": -300, "image": 400}}}])  # fmt: skip
def test_the_image_of_the_axis_of_tilted_lenses_is_as_far_along_it_as_that_of_upright_ones_along_the_normal(
    planes,
):
    found = []
    for angle in (0, 3):
        wanted = design(
            **{"pair__focus": "afocal", **planes}, law__euler=[0, angle, 0], pair__offset="paraxial"
        )
        window = clacad.prescribe(wanted)
        found.append(list(image_checks(Lit(wanted, window, window, None, None))))
    (upright, wide), (point, spot) = found
    assert point.value == pytest.approx(upright.value, rel=0.02)
    assert (point.state, spot.state) == (upright.state, wide.state)
    assert spot.value == pytest.approx(wide.value, rel=0.01)
    assert spot.detail["width"] == pytest.approx(wide.detail["width"], rel=1e-12, abs=1e-12)


def test_thin_recipe_of_sharp_biconvex_pairs_has_the_radii_of_thin_lenses():
    """R = 2 (n - 1) f with f1 of the lens equation for the two planes."""
    window = clacad.prescribe(design(pair__form="biconvex", pair__surface="ellipsoid", pair__confocal="thin"))
    u = 1.0 / (1.0 / 5.0 - 1.0 / 400.0)
    f1 = 1.0 / (1.0 / 300.0 + 1.0 / (10.0 - u))
    for body, f in zip(window.bodies, (f1, 5.0), strict=True):
        for face in (body.front, body.back):
            assert abs(face.surface.curvature_x) * 2.0 * (body.index - 1.0) * f == pytest.approx(
                1.0, rel=1e-13
            )
    assert window.placements[1].pitch[0] / 0.5 == pytest.approx(
        (1.0 - 5.0 / 400.0) / (1.0 - f1 / 300.0), rel=1e-13
    )


@pytest.mark.parametrize("form", ["slab", "biconvex"])
def test_best_sharp_pairs_miss_the_image_less_than_exact_ones(form):
    more = {"pair__surface": "ellipsoid", "pair__form": form, "lattice__count": [3, 3]}
    wide = {}
    for recipe in ("exact", "best"):
        window = clacad.prescribe(design(**more, pair__confocal=recipe))
        lit = bundle(window, 4096, np.radians(0.5), "axis")
        seen = clacad.trace(window, lit.rays, rung="surfaces", path="numpy")
        alive = seen.fate == Fate.ALIVE
        off = seen.direction[alive] - RequestedLaw.of(window).expected(lit)[alive]
        wide[recipe] = float(np.sqrt((off**2).sum(axis=1).mean()))
    assert wide["best"] < 0.97 * wide["exact"]
    assert window.recipe["law_rms_end"] < window.recipe["law_rms_start"] < 0.1


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


@pytest.mark.parametrize("eta", [-1.0, -0.25, -3.0])
@pytest.mark.parametrize(
    "planes", [(-300.0, 400.0), (-inf, 400.0), (-300.0, inf), (-20.0, -17.0), (-1e12, 7.500000001)]
)
def test_lenses_around_a_field_lens_are_those_of_fifty_digits(eta, planes):
    """Lens 1 images the object to the field lens, which images lens 1 onto lens 2; lens 2 images that to the image."""
    pair = SharpPair.of(eta, 10.0, *planes, field=True)
    with mp.workdps(50):
        z, far = (mpf(0) if v in (inf, -inf) else 1 / mpf(v) for v in planes)
        v = mpf(10) / (1 - mpf(eta))
        f1, f2 = 1 / (1 / v - z), 1 / (1 / (10 - v) + far)
        ratio = (1 - v * z) / (1 + (10 - v) * far)
    assert pair.focal_lengths == pytest.approx((float(f1), float(f2)), rel=2.0**-52)
    assert pair.separation == pytest.approx(10.0, rel=1e-14)
    assert pair.pitch_ratio == pytest.approx(float(ratio), rel=1e-14)


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
    ({"law__eta": [-0.5, -1.0], "law__euler": [0, 3, 0]}, "CL125"),
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
            check for check in image_checks(Lit(asked, other, other, None, None)) if check.id == "image_point"
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
