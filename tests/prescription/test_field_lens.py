"""Field lenses: formulas by their golden cases, faces by rays traced one by one, law and share against the sheet without one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from oracle import trace as oracle

import clacad
from clacad import Design, DesignError, Fate, Rays, load, prescribe, trace
from clacad.advice import judge
from clacad.effects.diffraction import lit_widths
from clacad.effects.engine.homogeneous_light import orders, shares
from clacad.exporting.drawing.canvas import orientation
from clacad.light.confocality import confocality
from clacad.optics.law import angle_between
from clacad.optics.sequence import trace_sequence
from clacad.sheet.bundle import bundle
from clacad.sheet.like_cell import interfaces, like_cell
from clacad.sheet.vignetting import aperture_slope, ghost_onset, half_field, share, thin_cells
from clacad.verification.evidence import foci

DESIGNS = Path(__file__).parents[2] / "designs"
GOLDEN = json.loads((Path(__file__).parents[1] / "data" / "field_lens.json").read_text())["cases"]
PAIRS = [case for case in GOLDEN if not case.get("plate")]
FIELD = {"pair.field_lens": True}


def sheet(name="window-100mm", **keys):
    """A shipped design with a field lens and keys changed, a.b written a__b."""
    return load(DESIGNS / f"{name}.toml").replace(
        FIELD | {key.replace("__", "."): v for key, v in keys.items()}
    )


FORMS = {
    "two plates": sheet(),
    "two plates, offset": sheet(law__eta=[-0.5, -0.5], law__delta=[0.03, 0.1]),
    "slab, foci apart": sheet(law__eta=[-0.5, -1.0]),
    "biconvex": sheet("paper-a-covered"),
    "biconvex, offset": sheet("paper-a-covered", law__delta=[0.03, 0.05]),
    "biconvex, tilted": sheet("paper-a-covered", law__eta=[-1.0, -1.0], law__euler=[20.0, 6.0, 0.0]),
    "plano": sheet("plano", law__euler=[0.0, 0.0, 0.0]),
    "plano, inside": sheet(
        "plano", law__euler=[0.0, 0.0, 0.0], pair__curved="inside", law__delta=[0.02, 0.0]
    ),
    "hexagonal": sheet("hexagonal"),
}


HARD = {
    "both faces at the focus to 1e-9": sheet(pair__field={"gap": 1e-9}, pair__surface="biconic"),
    "foci nearly in one": sheet(law__eta=[-0.97, -1.0]),
    "radius at its limit": sheet("paper-a-covered", lattice__pitch=0.0075),
    "cell 1e6": sheet(lattice__count=[2_000_001, 2_000_001]),
}
"""Light that meets at a vertex, a plate as thin as its lenses, faces that all but end in the cell, and far cells."""


def lit(window, slope, count=4000):
    """Parallel light of a slope (2,), lens frame, over one cell."""
    ray = window.thin.rotation @ np.array([*slope, 1.0])
    return bundle(window, count, 0.0, middle=ray / np.linalg.norm(ray))


@pytest.mark.parametrize("case", PAIRS, ids=lambda c: f"{c['eta']} at {c['slope']}")
def test_shares_by_order_are_the_golden_ones(case):
    eta, s, p, slope = (float(case[key]) for key in ("eta", "separation", "pitch", "slope"))
    design = sheet(
        law__eta=[eta, eta],
        pair__separation=s,
        lattice__pitch=p,
        lattice__count=[5, 5],
        check__process="none",
    )
    window = prescribe(design)
    cells, own = thin_cells(window), min(1.0, 1.0 / abs(eta))  # the other axis
    light = np.array([[slope, 0.0, 1.0]])
    for order, want in case["shares_by_order_with"].items():
        assert share(cells, light, (int(order), 0))[0] / own == pytest.approx(float(want), abs=1e-12)
    assert half_field(cells)[0] == pytest.approx(float(case["full_field_slope"]), rel=1e-12)
    assert window.thin.field[0].focal_length[0] == pytest.approx(float(case["field_focal_length"]), rel=1e-12)
    assert window.thin.field[0].depth == pytest.approx(float(case["f1"]), rel=1e-12)
    plain = thin_cells(prescribe(design.replace("pair.field_lens", False)))
    assert share(plain, light)[0] / own == pytest.approx(float(case["share_without"]), abs=1e-12)
    seen = trace(window, lit(window, (slope, 0.0)).rays, rung="thin")
    alive = seen.fate == Fate.ALIVE
    assert alive.mean() / own == pytest.approx(float(case["shares_by_order_with"]["0"]), abs=0.02)
    out = seen.direction[alive]
    np.testing.assert_allclose(out[:, 0] / out[:, 2], float(case["slope_after_partner"]), atol=1e-15)


def test_the_crossed_plate_is_the_golden_one():
    case = next(case for case in GOLDEN if case.get("plate"))
    eta, s, n = [float(v) for v in case["eta"]], float(case["separation"]), float(case["index"])
    design = sheet("paper-a-covered", law__eta=eta, pair__separation=s, pair__index=n, pair__form="plano")
    design = Design.from_dict(
        {**design.given, "pair": {k: v for k, v in design.given["pair"].items() if k != "web"}}
    )
    array1, plate, array2 = prescribe(design).bodies
    assert [b.name for b in (array1, plate, array2)] == ["array1", "field", "array2"]
    assert plate.back.vertex[2] - plate.front.vertex[2] == pytest.approx(
        float(case["plate_thickness"]), rel=1e-12
    )
    radii = 1.0 / plate.back.surface.curvature_x, 1.0 / plate.front.surface.curvature_y
    assert radii == pytest.approx([float(r) for r in case["cylinder_radius"]], rel=1e-12)
    air = plate.front.vertex[2] - array1.back.vertex[2] + (array1.back.vertex[2] - array1.front.vertex[2]) / n
    assert air == pytest.approx(float(case["focus_z"][1]), rel=1e-12)
    without = prescribe(design.replace("pair.field_lens", False)).bodies[1]
    added = array2.back.vertex[2] - without.back.vertex[2]
    assert added == pytest.approx(float(case["extra_separation"]), rel=1e-12)


@pytest.mark.parametrize("name", FORMS)
def test_compiled_and_numpy_trace_alike_on_and_off_the_field(name):
    window = prescribe(FORMS[name])
    for half in (0.02, 0.15):
        rays = bundle(window, 1500, half).rays
        one, two = (trace(window, rays, path=path, record=True) for path in ("numba", "numpy"))
        for column in ("fate", "cell", "order", "surface"):
            np.testing.assert_array_equal(getattr(one, column), getattr(two, column))
        np.testing.assert_allclose(one.direction, two.direction, atol=4e-15)
        np.testing.assert_allclose(one.optical_path, two.optical_path, rtol=1e-13)
        assert (two.order[two.fate == Fate.ALIVE] == 0).all()
        assert (two.order[two.fate == Fate.GHOST] != 0).any(axis=1).all()


@pytest.mark.parametrize("name", FORMS)
def test_light_is_alive_where_every_face_is_met_in_the_telescopelet(name):
    """By the faces one by one, without cells; of a cylinder only the side across its axis counts."""
    window = prescribe(FORMS[name])
    rays = bundle(window, 3000, 0.04).rays
    found = trace(window, rays, path="numpy")
    seen = trace_sequence(interfaces(window), _from_cell(window, rays), record=True)
    own = (found.cell == _central(window)).all(axis=1)
    inside, clear = seen.fate == Fate.ALIVE, np.ones(len(rays), dtype=bool)
    for face, hits in zip(window.faces, seen.hits, strict=True):
        if face.array is None:
            continue
        local = hits[:, :2] - np.asarray(window.shifts[face.array])
        flat = [
            k
            for k in (0, 1)
            if face.array == 2 and (face.surface.curvature_x, face.surface.curvature_y)[k] == 0.0
        ]
        if len(flat) == 2:
            continue  # the flat side of a tilted field lens
        if flat:
            local = local * np.abs(
                np.array([0.0, 1.0] if flat[0] == 0 else [1.0, 0.0]) @ face.rotation[:2, :2].T
            )
        for step, half in zip(window.lattice.steps, window.lattice.half_widths, strict=True):
            past = local @ np.asarray(window.lattice.offset(*step)) / (2.0 * half) - half
            inside &= past <= 0.0
            clear &= np.abs(past) > 1e-3 * half
    walls = np.isin(found.fate, (Fate.WALL, Fate.LAND))
    judged = own & clear & ~walls
    assert judged.sum() > 2000
    np.testing.assert_array_equal((found.fate == Fate.ALIVE)[judged], inside[judged])


def _central(window):
    from clacad.sheet.representative_cells import central_cell

    return np.array(central_cell(window))


def _from_cell(window, rays):
    """The same rays about the centre of the central cell."""
    centre = window.lattice.centres(_central(window)[None])[0]
    return Rays(rays.position - np.array([*centre, 0.0]), rays.direction)


@pytest.mark.parametrize("name", FORMS)
def test_the_pair_stays_confocal_and_light_of_any_slope_finds_its_partner(name):
    """Parabasal light along the axis leaves parallel; light of the middle of cell 1 meets lens 2 in the middle of cell 2."""
    window = prescribe(FORMS[name])
    assert confocality(window).defect < 1e-3
    decentred = any(v for shift in window.shifts for v in shift) and window.thin.rotation[2, 2] == 1.0
    for focus in foci(window):  # of light from either side, each through the faces before it
        assert abs(focus.gap) < (2e-3 if decentred else 1e-6) * focus.distance
    law_limit = 1e-12 if window.shifts[1] == (0.0, 0.0) else 0.02
    assert window.residual["law"] < law_limit
    cells, s = thin_cells(window), window.thin.separation
    middle = np.array([*aperture_slope(window), 1.0]) @ window.thin.rotation
    slope = middle[:2] / middle[2] + 0.05 * np.array(half_field(cells))
    ray = window.thin.rotation @ np.array([*slope, 1.0])
    start = -ray / ray[2] * (abs(window.z_range[0]) + window.lattice.pitch[0])
    seen = trace_sequence(interfaces(window), Rays(start, ray[None]), record=True)
    second = [face.array == 1 for face in window.faces]
    met = seen.hits[second, 0].mean(axis=0)[:2] - np.asarray(window.shifts[1])
    assert np.abs(met).max() < 0.02 * s * np.abs(slope).max() + 0.02 * window.lattice.pitch[0]


@pytest.mark.parametrize("name", ["two plates, offset", "biconvex", *HARD])
def test_directions_hold_against_sixty_digits_through_every_face(name):
    window = prescribe((FORMS | HARD)[name])
    cell = np.array([1_999_990, 10]) if name == "cell 1e6" else _central(window)
    rays = bundle(window, 64, 0.01, cell=tuple(cell)).rays
    found, same = (trace(window, rays, path=path) for path in ("numba", "numpy"))
    np.testing.assert_array_equal(found.fate, same.fate)
    local = rays.position - np.array([*window.lattice.centres(cell[None])[0], 0.0])
    faces = [_in_words(interface) for interface in interfaces(window)]
    alive = np.flatnonzero(found.fate == Fate.ALIVE)
    assert len(alive) > 30
    for k in alive[:8]:
        path = oracle.trace(faces, local[k].tolist(), rays.direction[k].tolist())
        want = np.array([float(v) for v in path.directions[-1]])
        np.testing.assert_allclose(found.direction[k], want, atol=4e-15)


def _in_words(interface):
    """An interface as the oracle has it."""
    s = interface.surface
    place = {"vertex": tuple(interface.vertex), "before": interface.index_before, "after": interface.index_after,
             "rotation": interface.rotation}  # fmt: skip
    if isinstance(s, clacad.Quadric):
        return oracle.quadric(s.curvature_x, s.curvature_y, s.kappa, s.side, **place)
    assert (s.curvature_x, s.conic_x) == (s.curvature_y, s.conic_y)  # a conic of revolution
    return oracle.quadric(s.curvature_x, s.curvature_y, (1.0 + s.conic_x) * s.curvature_x, s.side, **place)


def measured(design, degrees, count=8192):
    window = prescribe(design)
    rays = bundle(window, count, np.radians(degrees)).rays
    seen = trace(window, rays, path="numba")
    alive = seen.fate == Fate.ALIVE
    error = angle_between(seen.direction[alive], window.law.refract(rays.direction[alive]))
    return alive.mean(), (seen.fate == Fate.GHOST).mean(), 1e3 * np.sqrt(np.mean(error**2))


def test_the_window_keeps_its_light_over_all_of_its_field():
    """Measured for the design: two plates, .998 of a cone of 2.8 degrees, .0169 and .130 mrad of conics −1/n²; .322 without."""
    design = sheet(pair__surface="biconic")
    share_1, _, rms_1 = measured(design, 1.0)
    share_28, ghosts, rms_28 = measured(design, 2.8, 32768)
    assert share_1 > 0.999
    assert share_28 >= 0.99
    assert ghosts <= 0.002
    assert rms_1 == pytest.approx(0.0169, rel=0.02)
    assert rms_28 == pytest.approx(0.130, rel=0.02)
    assert measured(design.replace("pair.field_lens", False), 2.8, 32768)[0] == pytest.approx(
        0.322, abs=0.004
    )


def test_the_papers_sheet_keeps_its_light_at_the_rim_of_its_field():
    """Measured for the design with K = −n²: .996 at slopes (.045, .045), 9.1 mrad; .385 without."""
    window = prescribe(sheet("paper-a-covered"))
    seen = trace(window, lit(window, (0.045, 0.045), 8192).rays, path="numba")
    assert (seen.fate == Fate.ALIVE).mean() >= 0.98
    plain = prescribe(load(DESIGNS / "paper-a-covered.toml"))
    without = trace(plain, lit(plain, (0.045, 0.045), 8192).rays, path="numba")
    assert (without.fate == Fate.ALIVE).mean() == pytest.approx(0.385, abs=0.01)
    assert measured(sheet("paper-a-covered"), 2.0)[2] == pytest.approx(3.16, rel=0.02)


def test_light_of_the_law_is_weighed_with_the_field_lens():
    """Effects share light out between the orders in closed form: with a field lens all of the field goes to the partner."""
    cells = thin_cells(prescribe(sheet()))
    slopes = np.array([[0.0, 0.0], [0.03, -0.02], [0.049, 0.049], [0.06, 0.0]])
    np.testing.assert_allclose(shares(cells, slopes, (0, 0)), [1.0, 1.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(shares(cells, slopes, (2, 0)), [0.0, 0.0, 0.0, 1.0], atol=1e-12)
    assert (2, 0) in orders(cells, slopes)
    directions = np.column_stack([slopes[:3], np.ones(3)])
    np.testing.assert_allclose(
        lit_widths(cells, directions, np.zeros((3, 2), dtype=np.int32)), 0.5, rtol=1e-12
    )


CELLS = {"lattice__count": [20, 20], "check__process": "none"}
LAWS = {
    "law__eta": [-1.2, -1.2],
    "law__delta": [0.01, 0.02],
    "law__varying": {"gradient": [[-4e-3, 1e-3], [0.0, -5e-3]]},
}


@pytest.mark.parametrize(
    "keys", [LAWS, LAWS | {"lattice__aperture": {"point": [1, 2, -300]}}], ids=["varying", "and aimed"]
)
@pytest.mark.parametrize("cell", [(0, 0), (15, 3), (10, 11)])
def test_the_thin_pair_of_one_cell_keeps_its_own_law_and_images_lens_1_onto_its_partner(keys, cell):
    """Three thin lenses by hand: x += d t, t -= (x - c)/f; t leaves as (t - delta)/eta, x arrives at C2 + eta x."""
    window = prescribe(sheet(**CELLS, **keys))
    pair, law = like_cell(window, np.array(cell)).thin, window.law_at(np.array(cell))
    (lens,), s = pair.field, pair.separation
    for axis, eta, delta in ((0, law.eta_x, law.delta_x), (1, law.eta_y, law.delta_y)):
        first, second = s / (1.0 - eta), -eta * s / (1.0 - eta)
        assert (lens.depth, pair.focal_length[1][axis]) == pytest.approx((first, second), rel=1e-12)
        for start, slope in ((0.0, 0.0), (0.2, 0.03), (-0.1, -0.05)):
            x, t = start, slope - start / pair.focal_length[0][axis]
            x += lens.depth * t
            t -= (x - pair.shift[axis] * lens.depth / s) / lens.focal_length[axis]
            x += (s - lens.depth) * t
            t -= (x - pair.offset[axis]) / pair.focal_length[1][axis]
            assert t == pytest.approx((slope - delta) / eta, abs=1e-12)
            assert x == pytest.approx(pair.shift[axis] + eta * start, abs=1e-12)


@pytest.mark.slow
def test_check_judges_the_field_lens_and_passes():
    judged = judge(sheet())
    found = {
        check.id: check
        for check in judged.checks
        if check.id in ("field_focus", "pupil", "field_throughput", "field_law")
    }
    assert len(found) == 4
    assert {check.state for check in found.values()} == {"pass"}
    assert judged.passes
    assert judged.facts.clearance == pytest.approx(0.0625)
    assert [lens.name for lens in judged.facts.lenses] == [
        "lens 1", "lens 2", "field lens of array1", "field lens of array2",
    ]  # fmt: skip
    assert min(ghost_onset(thin_cells(judged.window))) == pytest.approx(0.05)


@pytest.mark.slow
def test_a_gap_that_leaves_the_focus_fails_the_check():
    judged = judge(sheet(pair__field={"gap": 0.3}, lattice__count=[5, 5]))
    assert "field_focus" in {check.id for check in judged.failing}


@pytest.mark.slow
def test_faces_bent_for_two_foci_are_judged_by_the_pair_that_they_make():
    two = {"law__eta": [-1.0, -1.1], "lattice__kind": "hexagonal", "lattice__count": [4, 4]}
    judged = judge(sheet(**two))
    states = {check.id: check.state for check in judged.checks}
    assert states["field_focus"] == "not run"
    assert {states[name] for name in ("confocality", "pupil", "field_throughput")} == {"pass"}


def test_eta_minus_one_is_one_part_twice():
    window = prescribe(sheet())
    assert window.recipe["field"]["equal_plates"]
    assert any("same part" in sentence for sentence in orientation(window))
    first, second = window.bodies
    assert first.front.surface.curvature_x == second.back.surface.curvature_x
    assert first.back.surface.curvature_x == second.front.surface.curvature_x
    other = prescribe(sheet(law__eta=[-0.5, -0.5]))
    assert not other.recipe["field"]["equal_plates"]
    assert not any("same part" in sentence for sentence in orientation(other))


@pytest.mark.parametrize(
    ("name", "changes", "code", "says"),
    [
        ("window-100mm", {"law.eta": [0.5, 0.5]}, "CL126", "virtual"),
        ("window-100mm", {"law.eta": [1.0, -1.0]}, "CL126", "there is none"),
        ("window-100mm", {"law.euler": [0.0, 2.0, 0.0], "pair.form": "plano", "pair.thickness": 1.0}, "CL127", "tilted plano"),
        ("paper-a-covered", {"law.eta": [-0.5, -1.0], "body.baffle": True, "body.baffle_wall": 1e-4, "pair.focus": {"object": -1000, "image": 1000}}, "CL127", "a baffle in the plate and pair.focus"),
        ("paper-a-covered", {"lattice.pitch": 0.008}, "CL128", "the radius 0.0039"),
        ("window-100mm", {"pair.field.gap": 10.0}, "CL129", "too wide"),
        ("window-100mm", {"law.eta": [-0.999, -1.0]}, "CL129", "they need"),
        ("paper-a-covered", {"pair.field.gap": 0.1}, "CL114", "does not belong"),
    ],
)  # fmt: skip
def test_a_field_lens_that_cannot_be_is_refused_by_one_code(name, changes, code, says):
    with pytest.raises(DesignError, match=code) as caught:
        prescribe(load(DESIGNS / f"{name}.toml").replace(FIELD | changes))
    assert says in str(caught.value)
    assert {mistake.code for mistake in caught.value.mistakes} == {code}
