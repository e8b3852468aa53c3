"""Sheets whose law varies, as built and traced: the law of each cell, images, tables, what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
import pytest
from mpmath import mp
from oracle import varying as oracle

import clacad
from clacad.base.sobol import sobol
from clacad.design.combinations import BUILT, FEATURES, REASONS, SHEETS, matrix
from clacad.imaging.image_by_rays import best_point
from clacad.optics.law.focusing import Glens
from clacad.optics.rays import Fate
from clacad.sheet.cell_heights import closed_volume, greatest_steps
from clacad.sheet.cell_places import CellLaws
from clacad.sheet.like_cell import like_cell
from clacad.sheet.vignetting import aperture_slopes

DATA = Path(__file__).parents[1] / "data"
BASE = {
    "format": 1, "name": "glens", "unit": "mm",
    "law": {"eta": [-1.0, -1.0], "varying": {"f_image": 200}},
    "pair": {"form": "slab", "separation": 10.0, "material": "PMMA", "surface": "biconic"},
    "lattice": {"pitch": 0.5, "count": [12, 9]},
}  # fmt: skip


def design(**changes):
    made = json.loads(json.dumps(BASE))
    for key, value in changes.items():
        place = made
        *path, last = key.split("__")
        for step in path:
            place = place.setdefault(step, {})
        if value is None:
            place.pop(last, None)
        else:
            place[last] = value
    return clacad.Design.from_dict(made)


def built(**changes):
    return clacad.prescribe(design(**changes))


CASES = json.loads((DATA / "varying_law.json").read_text())["cases"]


@pytest.mark.parametrize("case", CASES)
def test_rung_law_turns_light_by_the_law_of_the_cell_hit_and_by_the_smooth_one_where_asked(case):
    gradient = tuple(tuple(float(v) for v in row) for row in case["gradient"])
    eta, delta, pitch, place, d = (
        [float(v) for v in case[k]] for k in ("eta", "delta0", "pitch", "position", "direction")
    )
    window = built(law__eta=eta, law__delta=delta, law__varying=None, law__euler=case["euler_deg"], lattice__pitch=pitch,
                   lattice__kind="rectangular", lattice__count=case["count"])  # fmt: skip
    window = replace(
        window, cell_laws=CellLaws(window.law, gradient)
    )  # no lenses can be as steep as some of these laws require
    start = [place[0] - d[0] / d[2], place[1] - d[1] / d[2], -1.0]
    for continuous, exact in ((False, case["out_cell"]), (True, case["out_continuous"])):
        result = clacad.trace(window, (start, d), rung="law", continuous=continuous)
        assert result.cell[0].tolist() == case["cell"]
        assert np.abs(result.direction[0] - [float(v) for v in exact]).max() <= 1e-13
    law = window.law_at(case["cell"])
    assert [law.delta_x, law.delta_y] == pytest.approx([float(v) for v in case["delta_cell"]], rel=1e-15)


@pytest.mark.parametrize("changes", [{}, {"law__eta": [-0.25, -0.5]}, {"law__varying": {"f_image": [150, -300]}}, {"law__varying": {"gradient": [[0.0, 0.004], [-0.004, 0.0]]}}, {"lattice__kind": "hexagonal"}, {"law__euler": [30, 0, 0]}])  # fmt: skip
def test_ideal_lenses_of_every_cell_obey_the_law_of_that_cell(changes):
    window = built(**changes)
    lattice = window.lattice
    cells = lattice.cells()
    rng = np.random.default_rng(1)
    which = rng.integers(0, len(cells), 400)
    at = lattice.centres(cells[which]) + 0.2 * rng.uniform(-0.25, 0.25, (400, 2))
    d = np.column_stack([rng.uniform(-0.002, 0.002, (400, 2)), np.ones(400)])
    result = clacad.trace(window, clacad.Rays(np.column_stack([at, np.zeros(400)]) - 5 * d, d), rung="thin")
    alive = result.fate == Fate.ALIVE
    assert alive.mean() > 0.9
    for k in np.flatnonzero(alive):
        exact = window.law_at(result.cell[k]).refract(d[k])
        assert np.abs(result.direction[k] - exact).max() <= 1e-13


def test_thin_images_are_those_of_rays_lens_by_lens():
    window, source = built(lattice__count=[21, 21]), (1.0, 0.5, -4000.0)
    found = clacad.image(window, source, ("thin",), 4096).rungs[0]
    exact = [oracle.image((-1.0, -0.005, 10.0, 0.0), (x, source[2])) for x in source[:2]]
    assert found.predicted.point[2] - 10.0 == pytest.approx(float(exact[0][0]), rel=1e-12)
    assert found.predicted.point[:2] == pytest.approx([float(x) for _, x in exact], rel=1e-10)
    glens = Glens(-1.0, -0.005, 10.0)
    width = glens.width(source[2], 0.5)
    assert found.off <= 0.1 * width * glens.image_distance(source[2]) / 10.5
    assert found.found.spot == pytest.approx((width / np.sqrt(12), width / np.sqrt(12)), rel=0.05)


@pytest.mark.slow
def test_the_mean_light_of_every_cell_of_the_exact_lenses_leaves_as_its_law_asks():
    window = built(lattice__count=[40, 3], law__varying={"f_image": 80})
    lattice, rng = window.lattice, np.random.default_rng(2)
    for cell in ([0, 0], [39, 1], [20, 2], [5, 1]):
        local = rng.uniform(-0.25, 0.25, (20_000, 2))
        local = np.concatenate([local, -local])
        at = np.column_stack([lattice.centres(np.array(cell)) + local, np.full(len(local), -1.0)])
        result = clacad.trace(window, clacad.Rays(at, (0.0, 0.0, 1.0)))
        mean = result.direction[result.fate == Fate.ALIVE].mean(axis=0)
        exact = window.law_at(cell).refract([0.0, 0.0, 1.0])
        assert np.abs(mean / np.linalg.norm(mean) - exact).max() < 1e-4
        assert (
            np.abs(
                window.vertices(window.faces[1], np.array(cell))[:2]
                - 5.0 * np.array([-0.0125, -0.0125]) * lattice.centres(np.array(cell))
            ).max()
            < 0.15
        )


@pytest.mark.slow
def test_a_glens_focuses_where_it_shall_and_paraxial_vertices_do_not():
    small = {"lattice__count": [100, 1], "law__varying": {"f_image": 200}}
    for offset, low, high, spot in (("traced", 199.6, 200.2, 0.13), ("paraxial", 193.0, 196.0, 0.6)):
        window = built(**small, pair__offset=offset)
        seen = clacad.image(window, (0, 0, -inf), ("surfaces",), 20_000).rungs[0]
        x = seen.direction[:, 0] / seen.direction[:, 2]
        place = seen.position
        heights = np.linspace(190, 205, 1501) + window.faces[1].vertex[2]
        wide = [np.std(place[:, 0] + (z - place[:, 2]) * x) for z in heights]
        focus = heights[int(np.argmin(wide))] - window.faces[1].vertex[2]
        assert low < focus < high
        assert min(wide) < spot


def test_the_best_point_is_that_of_a_plain_least_squares_in_fifty_digits():
    rng = np.random.default_rng(5)
    for spread in (0.3, 1e-3, 1e-6):
        d = np.column_stack([spread * rng.normal(size=(40, 2)), np.ones(40)])
        d /= np.linalg.norm(d, axis=1)[:, None]
        p = rng.normal(size=(40, 3)) + [1e3, -2e3, 5e3]
        got = best_point(p, d).point
        with mp.workdps(50):
            matrix_, right = mp.zeros(3, 3), mp.zeros(3, 1)
            for place, way in zip(p, d):
                w = mp.matrix([mp.mpf(float(v)) for v in way])
                w /= mp.norm(w)
                across = mp.eye(3) - w * w.T
                matrix_ += across
                right += across * mp.matrix([mp.mpf(float(v)) for v in place])
            exact = np.array([float(v) for v in mp.lu_solve(matrix_, right)])
        assert np.abs(got - exact).max() <= 1e-12 * 6e3 / spread**1.0 + 1e-16 / spread**2
    assert np.isnan(best_point(p, np.tile(d[0], (40, 1))).point).all()


@pytest.mark.parametrize("delta", [[0.0, 0.0], [0.01, -0.02]])
@pytest.mark.parametrize("planes", [{"f_image": 200}, {"conjugates": {"object": -300, "image": 250}}])
def test_light_of_the_axis_meets_in_one_point_behind_a_sheet_inclined_to_its_lenses(planes, delta):
    window = built(law__euler=[20, 7, -5], law__delta=delta, law__varying=planes, lattice__count=[7, 6])
    axis, cells = window.law.rotation[:, 2], window.lattice.cells()
    middle = np.column_stack([window.lattice.centres(cells), np.zeros(len(cells))])
    way = middle + 300 * axis if "conjugates" in planes else np.tile(axis, (len(cells), 1))
    away = planes.get("f_image") or planes["conjugates"]["image"]
    image = [away * delta[0], away * delta[1], 10 + away]  # eta = -1: t' = -(t - delta)
    start = middle - 0.5 * way / np.linalg.norm(way, axis=1)[:, None]
    for rung, off, wide in (("thin", 1e-11, 1e-12), ("surfaces", 0.02, 0.02)):
        seen = clacad.trace(window, clacad.Rays(start, way), rung=rung, path="numpy")
        met = best_point(seen.position, seen.direction)
        point = np.array(met.point) @ window.law.rotation
        assert np.abs(point[:2] - image[:2]).max() < off
        assert max(met.spot) < wide
        if rung == "thin":
            assert point[2] == pytest.approx(image[2], rel=1e-12)


@pytest.mark.parametrize("form", ["slab", "biconvex"])
@pytest.mark.parametrize("sheet", [{"lattice__pitch_2": 0.4975}, {"lattice__rotation_2": "0.3 deg"}])
def test_tilted_lenses_of_another_pitch_rise_with_their_places_and_keep_their_separation(sheet, form):
    more = {} if form == "slab" else {"pair__surface": None, "pair__thickness": 1.5}
    window = built(law__varying=None, law__euler=[20, 5, 0], pair__form=form, **more, **sheet)
    cells, axis = window.lattice.cells(), window.law.rotation[:, 2]
    apart = window.vertices(window.faces[-1], cells) - window.vertices(window.faces[0], cells)
    apart[:, :2] += window.centres(1, cells) - window.centres(0, cells)
    assert np.ptp(apart[:, 2]) > 1e-4
    assert np.ptp(apart @ axis) < 1e-13
    ideal = window.thin.lenses(1, window.lattice, cells)
    assert np.ptp(ideal.raised(np.zeros(len(cells)))) == pytest.approx(np.ptp(apart[:, 2]), rel=0.02)


@pytest.mark.parametrize("sheet", ["lattice.pitch_2", "lattice.rotation_2", "pair.focus"])
def test_traced_lenses_of_another_pitch_send_the_mean_of_chief_light_where_the_law_asks(sheet):
    worst = {}
    for offset in ("paraxial", "traced"):
        window = built(**{**SHEET[sheet], "pair__offset": offset})
        cells = window.lattice.cells()[::13]
        quarter = window.lattice.over_cell(sobol(64, 2)) * 0.97
        points = np.concatenate([quarter * signs for signs in ((1, 1), (-1, 1), (1, -1), (-1, -1))])
        for cell, slope in zip(cells, aperture_slopes(window, cells), strict=True):
            ray = np.array([*slope, 1.0])
            start = np.column_stack([window.lattice.centres(cell) + points, np.zeros(256)]) - ray
            seen = clacad.trace(window, clacad.Rays(start, ray), path="numpy")
            assert (seen.fate == Fate.ALIVE).all()
            mean = seen.direction.mean(axis=0)
            off = np.abs(mean / np.linalg.norm(mean) - window.law_at(cell).refract(ray)).max()
            worst[offset] = max(off, worst.get(offset, 0.0))
    assert worst["paraxial"] > 1e-6
    assert worst["traced"] < 0.2 * worst["paraxial"]  # lenses are traced for all of the cell, not .97 of it


@pytest.mark.parametrize("sheet", ["lattice.aperture", "law.varying", "lattice.pitch_2"])
def test_best_radii_of_a_non_uniform_sheet_are_those_of_its_middle_cell(sheet):
    best = {"pair__confocal": "best", "pair__surface": None}
    window = built(**{**SHEET[sheet], **best})
    alike = built(law__varying=None, **best)
    assert window.recipe["scale"] == pytest.approx(alike.recipe["scale"], rel=1e-12)
    assert window.recipe["law_rms_end"] < window.recipe["law_rms_start"]
    assert not window.uniform
    for mine, other in zip(window.faces, alike.faces, strict=True):
        assert mine.surface.curvature_x == pytest.approx(other.surface.curvature_x, rel=1e-12)


def test_cells_like_one_of_a_sheet_are_that_cell():
    window = built(lattice__count=[12, 12])
    for cell in ([0, 0], [11, 3]):
        like = like_cell(window, np.array(cell))
        assert like.uniform
        assert like.law == window.law_at(cell)
        assert like.faces[1].vertex == tuple(window.vertices(window.faces[1], np.array(cell)))
        at = np.array([[0.01, -0.02, -1.0]])
        here = window.lattice.centres(np.array(cell))
        centre = like.lattice.centres(np.array([6, 6]))
        one = clacad.trace(window, clacad.Rays(at + [*here, 0], (0.001, 0.002, 1.0)), rung="thin")
        other = clacad.trace(
            like, clacad.Rays(at + [*centre, 0], (0.001, 0.002, 1.0)), rung="thin", path="numpy"
        )
        assert np.abs(one.direction - other.direction).max() < 1e-14


def test_fewer_cells_of_a_varying_sheet_are_the_middle_ones():
    window = built(lattice__count=[12, 10])
    small = window.with_cells((4, 2))
    face = window.faces[1]
    assert np.array_equal(
        small.vertices(small.faces[1], small.lattice.cells()),
        window.vertices(face, small.lattice.cells() + [4, 4]),
    )
    with pytest.raises(ValueError, match="has no 40 x 1"):
        window.with_cells((40, 1))


def test_a_table_gives_each_cell_its_own_law_and_the_design_its_hash(tmp_path):
    rows = "i,j,delta_x,delta_y\n" + "".join(
        f"{i},{j},{0.001 * i - 0.002 * j},{0.003 * j}\n" for i in range(12) for j in range(9)
    )
    (tmp_path / "cells.csv").write_text(rows)
    text = clacad.Design.from_dict({**BASE, "law": {"eta": [-1.0, -1.0]}}).canonical_toml()
    (tmp_path / "d.toml").write_text(text.replace("[law]\n", '[law]\nvarying = {table = "cells.csv"}\n'))
    made = clacad.load(tmp_path / "d.toml")
    window = clacad.prescribe(made)
    assert window.law_at((3, 2)).delta_x == made.law_at((3, 2)).delta_x == 0.001 * 3 - 0.002 * 2
    again = clacad.Design.from_dict(made.to_dict())
    assert again == made
    assert again.sha256 == made.sha256
    (tmp_path / "cells.csv").write_text(rows.replace("0,0,0.0,0.0", "0,0,0.0,1e-9"))
    assert clacad.load(tmp_path / "d.toml").sha256 != made.sha256
    with pytest.raises(clacad.DesignError, match="is not the table whose sha256"):
        clacad.prescribe(made)
    with pytest.raises(ValueError, match="no values between its cells"):
        clacad.trace(window, ((0, 0, -1), (0, 0, 1)), rung="law", continuous=True)


PRESENT = {
    "hexagonal cells": {"lattice__kind": "hexagonal"}, "seam": {"lattice__seam": 0.05}, "outline": {"lattice__outline": {"circle": 4}},
    "tilt": {"law__euler": [0, 3, 0]}, "offset": {"law__delta": [0.01, 0.0]},
    "biconvex": {"pair__form": "biconvex", "pair__surface": None}, "plano": {"pair__form": "plano"}, "slab": {},
    "given faces": {"pair__prescription": "given", "pair__face": [{"radius": 2.468}, {"radius": 2.468}], "pair__surface": None},
    "tolerances": {"tolerances__index": 0.001}, "aimed at a point": {"lattice__aperture": {"point": [0, 0, -400]}},
    "steered": {"lattice__aperture": [0.01, 0.0]}, "traced vertices": {"pair__offset": "traced"},
    "other pitch": {"lattice__pitch_2": 0.499}, "law that varies": {"law__varying": {"f_image": 200}},
    "turned array": {"lattice__rotation_2": "0.2 deg"},
    "sharp pairs": {"pair__focus": {"object": -300, "image": 400}}, "curved inside": {"pair__form": "plano", "pair__curved": "inside"},
    "thin recipe": {"pair__form": "plano", "pair__confocal": "thin"},
    "confocal best": {"pair__confocal": "best"}, "field lens": {"pair__field_lens": True, "pair__surface": None},
    "plate with holes, corners or pins": {"body__border": 1, "body__corners": {"round": 0.5}}, "plate with an outline of its own": {"body__outline": {"circle": 20}},
    "baffle": {"pair__form": "plano", "body__baffle": True, "body__baffle_wall": "50 um"},
    "eta_x and eta_y that differ": {"law__eta": [-1.0, -0.9]}, "depth of a lens": {"pair__surface": None, "pair__depth": ["2.4 mm", "2.4 mm"]},
    "biconvex of a thickness to be found": {"pair__form": "biconvex", "pair__surface": None, "pair__thickness": "auto"},
}  # fmt: skip


SHEET = {"lattice.aperture": {"law__varying": None, "lattice__aperture": {"point": [0, 0, -400]}},
         "law.varying": {"law__varying": {"gradient": [[-0.005, 0.0], [0.0, -0.005]]}}, "lattice.pitch_2": {"law__varying": None, "lattice__pitch_2": 0.4975},
         "lattice.rotation_2": {"law__varying": None, "lattice__rotation_2": "0.2 deg"},
         "pair.focus": {"law__varying": None, "pair__focus": {"object": -300, "image": 400}}}  # fmt: skip
ITS_OWN = {
    "lattice.aperture": ("aimed at a point", "steered"),
    "law.varying": ("law that varies",),
    "lattice.pitch_2": ("other pitch",),
    "lattice.rotation_2": ("turned array",),
    "pair.focus": ("sharp pairs",),
}


@pytest.mark.parametrize("feature", [f.name for f in FEATURES])
@pytest.mark.parametrize("sheet", SHEETS)
def test_each_combination_works_or_is_refused_by_one_code_as_the_matrix_says(sheet, feature):
    if feature in ITS_OWN[sheet]:
        return
    reason = REASONS.get((sheet, feature))
    changes = {**SHEET[sheet], **PRESENT[feature]}
    if reason is not None:
        with pytest.raises(clacad.DesignError) as caught:
            design(**changes)
        assert {mistake.code for mistake in caught.value.mistakes} == {"CL125"}
        assert any(reason in mistake.message for mistake in caught.value.mistakes)
        return
    window = built(**changes)
    cells = window.lattice.cells()
    start = np.column_stack([window.lattice.centres(cells), np.full(len(cells), -1.0)]) + [0.01, 0.01, 0.0]
    x, y = (
        np.divide(window.thin.shift, window.thin.offset[2]) if feature in ("steered", "tilt") else (0.0, 0.0)
    )
    seen = clacad.trace(window, clacad.Rays(start - [x, y, 0], (x, y, 1.0)))
    for k in np.flatnonzero(seen.fate == Fate.ALIVE):
        exact = window.law_at(seen.cell[k]).refract([x, y, 1.0])
        assert np.abs(seen.direction[k] - exact).max() < 5e-3
    assert (seen.fate == Fate.ALIVE).mean() > 0.9


def test_a_superlens_focuses_where_gabor_has_it_and_its_cells_share_one_law():
    from clacad.optics.law.focusing import Superlens

    window = built(law__varying=None, law__eta=[-1.0, -1.0], lattice__pitch_2=0.4975, lattice__count=[41, 41])
    lens = Superlens((0.5, 0.4975), tuple(f[0] for f in window.thin.focal_length))
    seen = clacad.image(window, (0, 0, -inf), ("thin", "surfaces"), 20_000)
    for one, level in zip(seen.rungs, (10.0, window.faces[1].vertex[2])):
        assert one.predicted.point[2] - level == pytest.approx(lens.f_image, rel=1e-12)
        assert one.found.point[2] - level == pytest.approx(lens.f_image, rel=0.01)
    law = window.law_at((0, 40))
    assert [law.delta_x, law.delta_y] == pytest.approx([-10.0 * lens.kappa, 10.0 * lens.kappa], rel=1e-12)


def test_the_matrix_is_what_refuses():
    head, *rows = matrix()
    assert head[1:] == [*SHEETS]
    for name, *cells in rows:
        for sheet, cell in zip(head[1:], cells):
            itself = name in ITS_OWN[sheet]
            assert cell == ("itself" if itself else REASONS.get((sheet, name), BUILT))
    assert {f.name for f in FEATURES} == set(PRESENT)


def test_a_lens_too_far_from_its_cell_is_refused_with_the_planes_that_work():
    with pytest.raises(clacad.DesignError) as caught:
        built(lattice__count=[100, 3], law__varying={"f_image": 60})
    (mistake,) = caught.value.mistakes
    assert mistake.code == "CL123"
    assert "cell (0, " in mistake.message
    farther = float(mistake.hint.split("farther off by ")[1].split(",")[0])
    built(lattice__count=[100, 3], law__varying={"f_image": 60 * farther * 1.01})


def test_sheets_of_one_law_have_the_text_and_hash_they_had():
    made = design(law__varying=None)
    assert "varying" not in made.canonical_toml()
    assert clacad.prescribe(made).cell_laws is None
    assert made.law_at((0, 0)) == made.law


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_closed_steps_miss_what_the_flux_of_open_faces_lacks_of_a_volume(kind):
    window = built(law__varying=None, pair__focus={"object": -300, "image": 400}, pair__offset="traced",
                   lattice__count=[4, 3], lattice__kind=kind)  # fmt: skip
    face, lattice, cells = window.faces[1], window.lattice_of(1), window.lattice.cells()
    tile, (nodes, weights) = lattice.tile(), np.polynomial.legendre.leggauss(20)
    missed = 0.0
    for cell, at in zip(cells, window.centres(1, cells), strict=True):
        for k, (one, two) in enumerate(zip(tile, np.roll(tile, -1, axis=0), strict=True)):
            if window.lattice.contains(cell + np.array(lattice.steps[k])):
                points = one + 0.5 * (1.0 + nodes)[:, None] * (two - one)
                moved = points - window.vertices(face, cell)[:2]
                height = -(moved**2).sum(axis=1) * face.surface.curvature_x / (
                    1.0 + np.sqrt(1.0 - (1.0 + face.surface.conic_x) * (face.surface.curvature_x**2) * (moved**2).sum(axis=1)))  # fmt: skip
                way = two - one
                apart = abs(way @ [at[1] + one[1], -(at[0] + one[0])])
                outward = np.sign(lattice.offset(*lattice.steps[k]) @ (at + one))
                missed += 0.5 * weights @ height * apart * outward / 3.0
    assert closed_volume(window, face, 1e-5) == pytest.approx(missed, rel=0.01)
    assert closed_volume(window, face, 1e-9) == 0.0


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_steps_between_cells_are_those_of_two_ellipsoids_apart(kind):
    window = built(lattice__kind=kind, lattice__count=[8, 7], law__varying={"f_image": 60})
    face, lattice = window.faces[1], window.lattice
    cells = lattice.cells()
    c, k = abs(face.surface.curvature_x), face.surface.conic_x

    def height(x, y):
        r2 = (x * x + y * y) * c * c
        return r2 / c / (1 + np.sqrt(1 - (1 + k) * r2))

    apex = lattice.centres(cells) + window.vertices(face, cells)[:, :2]
    place = {tuple(cell): n for n, cell in enumerate(cells.tolist())}
    expected = np.zeros(len(cells))
    tile = lattice.tile()
    for n, cell in enumerate(cells):
        for e, step in enumerate(lattice.steps):
            other = place.get(tuple((cell + step).tolist()))
            if other is None:
                continue
            line = lattice.centres(cell) + np.linspace(tile[e], tile[(e + 1) % len(tile)], 5)
            apart = height(*(line - apex[n]).T) - height(*(line - apex[other]).T)
            expected[n] = max(expected[n], np.abs(apart).max())
    assert greatest_steps(window, face, cells) == pytest.approx(expected, abs=1e-13)
    assert expected.max() > 0.01
    assert greatest_steps(window, window.faces[0], cells).max() < 1e-15


@pytest.mark.parametrize("form", ["slab", "plano", "biconvex"])
def test_tilted_lenses_move_in_their_own_plane_and_every_ideal_pair_obeys_its_own_law(form):
    """Lens 2 of every cell is as far along the lens axis as that of the middle, regardless of its δ."""
    window = built(pair__form=form, pair__surface="ellipsoid", law__euler=[30, 4, 10], pair__offset="paraxial",
                   law__varying={"gradient": [[-0.005, 0.002], [-0.002, -0.004]]})  # fmt: skip
    axis = window.law.rotation[:, 2]
    cells = window.lattice.cells()
    for face in window.faces:
        if face.change is None:
            continue
        along = (window.vertices(face, cells) - face.vertex) @ axis
        assert np.abs(along).max() < 1e-15
        assert np.ptp(window.vertices(face, cells)[:, 2]) > 1e-3
    x, y = np.divide(window.thin.shift, window.thin.offset[2])
    start = np.column_stack([window.lattice.centres(cells) + [0.02, -0.01], np.zeros(len(cells))])
    seen = clacad.trace(window, clacad.Rays(start - [x, y, 1.0], (x, y, 1.0)), rung="thin")
    alive = np.flatnonzero(seen.fate == Fate.ALIVE)
    assert len(alive) > 0.9 * len(cells)
    for k in alive:
        assert np.abs(seen.direction[k] - window.law_at(seen.cell[k]).refract([x, y, 1.0])).max() < 1e-14


@pytest.mark.long
def test_files_of_a_tilted_sheet_whose_law_varies_pass_and_level_lenses_are_found_out(tmp_path):
    from dataclasses import replace

    from clacad.formats.step.step_files import write_step

    made = design(lattice__count=[5, 5], law__euler=[30, 12, 10],
                  law__varying={"gradient": [[-0.02, 0.0], [0.0, -0.02]]})  # fmt: skip
    clacad.export(made, tmp_path / "out", formats=("step", "xyz", "table"))
    report = clacad.verify(made, files=tmp_path / "out", rays=2048)
    assert report.word.startswith("passed"), [c.sentence for c in report.checks if c.state == "fail"]
    window = clacad.prescribe(made)
    (body,) = window.bodies
    level = replace(body.back, change=replace(body.back.change, slope=(0.0, 0.0)))
    write_step(replace(window, bodies=(replace(body, back=level),)), tmp_path / "level.step")
    found = clacad.verify(made, files=tmp_path / "level.step", rays=2048)
    assert any(check.state == "fail" and check.subject.endswith(".step") for check in found.checks)
