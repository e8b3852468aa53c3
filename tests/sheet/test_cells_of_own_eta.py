"""Cells with an η or lens axes of their own: lenses against paraxial matrices and closed forms, light, what is refused."""

from __future__ import annotations

import json
from dataclasses import replace

import mpmath
import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.optimize import brentq

import clacad
from clacad.base.sobol import sobol
from clacad.design import asked_cells
from clacad.design.combinations import REASONS
from clacad.design.faces import face_table
from clacad.mesh import check_closed, tessellate
from clacad.mesh.body_mesh import facet_tags
from clacad.mesh.cell_template import BACK, FRONT
from clacad.optics.rays import Fate
from clacad.optics.sequence import parabasal
from clacad.prescription.bodies import face_spec
from clacad.prescription.field_lens import toric
from clacad.sheet.cell_heights import highest_step
from clacad.sheet.feasibility import feasibility
from clacad.sheet.like_cell import interfaces, like_cell
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.shrunk import CannotShrink, bent_window, grown_window
from clacad.sheet.vignetting import aperture_slopes, partner_share
from clacad.sheet.volume_and_extent import body_volume
from clacad.sheet.window import face_height, lens_height, lens_height_and_normal
from clacad.tracing.layout import lay_out

BASE = {
    "format": 1, "name": "own-eta", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10.0, "material": "PMMA", "surface": "biconic"}, "lattice": {"pitch": 0.5, "count": [7, 6]},
}  # fmt: skip


def spread(low, high):
    return lambda i, j: low + (high - low) * (i + j) / 11.0


WIDELY = spread(-0.5, -2.0)


def across(along, beside):
    """η of two axes from two functions of the cell."""
    return lambda i, j: (along(i, j), beside(i, j))


BOTH = across(spread(-0.6, -1.8), spread(-1.9, -0.7))


def still(i, j):
    return 0.0, 0.0


def sloping(i, j):
    return 0.003 * i - 0.008, 0.004 - 0.002 * j


def turned(i, j):
    return 17.0 * i - 23.0 * j + 5.0


def slightly(i, j):
    return 2.0 * i - 1.5 * j


def design(folder, eta=WIDELY, delta=sloping, turn=None, **changes):
    """A design with a table; η None: none in it; η of two numbers: columns eta_x and eta_y; psi, or phi, theta and psi by `turn` (degrees)."""
    made = json.loads(json.dumps(BASE))
    for key, value in changes.items():
        section, _, name = key.partition("__")
        if value is None:
            made[section].pop(name, None)
        else:
            made.setdefault(section, {})[name] = value
    plain = clacad.Design.from_dict(made)
    lattice = clacad.prescribe(plain).lattice
    own, angles = (
        (lambda i, j: []) if one is None else lambda i, j, one=one: np.atleast_1d(one(i, j)).tolist()
        for one in (eta, turn)
    )
    rows = [
        "i,j,delta_x,delta_y"
        + ("", ",eta", ",eta_x,eta_y")[len(own(0, 0))]
        + ("", ",psi", "", ",phi,theta,psi")[len(angles(0, 0))]
    ]
    for i, j in lattice.cells().tolist():
        numbers = [*delta(i, j), *own(i, j), *angles(i, j)]
        rows.append(",".join([str(i), str(j), *map(repr, map(float, numbers))]))
    (folder / "cells.csv").write_text("\n".join(rows) + "\n")
    made["law"]["varying"] = {"table": "cells.csv"}
    text = plain.canonical_toml().replace("[law]\n", '[law]\nvarying = {table = "cells.csv"}\n')
    (folder / "design.toml").write_text(text)
    return clacad.load(folder / "design.toml")


def built(folder, *args, **changes):
    return clacad.prescribe(design(folder, *args, **changes))


FORMS = {
    "slab": {}, "plano": {"pair__form": "plano", "pair__thickness": 1.0},
    "plano, curved inside": {"pair__form": "plano", "pair__thickness": 1.0, "pair__curved": "inside"},
    "biconvex": {"pair__form": "biconvex", "pair__thickness": 0.3, "pair__surface": None},
    "hexagonal": {"lattice__kind": "hexagonal"}, "seam": {"lattice__seam": 0.05},
}  # fmt: skip
"""Kinds of sheet; of biconvex ones η changes little from cell to cell."""
OF_TWO = {
    "two axes": {}, "two axes, law of two": {"law__eta": [-0.8, -1.3]}, "two axes, ellipsoids": {"pair__surface": None},
    "two axes, plano": FORMS["plano"], "two axes, biconvex": FORMS["biconvex"],
    "two axes, hexagonal": FORMS["hexagonal"], "two axes, turned": {"turn": turned},
    "two axes, turned ellipsoids": {"turn": turned, "pair__surface": None},
    "two axes, slightly turned biconvex": {**FORMS["biconvex"], "turn": slightly},
}  # fmt: skip
"""As `FORMS`, with an η along each lens axis."""
FORMS |= OF_TWO


def of_form(folder, form, **more):
    narrow, wide = spread(-0.9, -1.3), WIDELY
    if form in OF_TWO:
        narrow, wide = across(narrow, spread(-1.25, -1.0)), BOTH
    return built(folder, narrow if "biconvex" in form else wide, **FORMS[form], **more)


def matrix(window, cell, axis="x"):
    """Ray-transfer matrix of one telescopelet from vertex to vertex along its axis, in the meridian of a lens axis."""
    total, before, z = np.eye(2), 1.0, None
    lenses = [face for face in window.faces if face.array is not None]
    frame = window.in_cell(lenses[0], np.array(cell)).rotation
    for body in window.bodies:
        for face, after in ((body.front, body.index), (body.back, 1.0)):
            own = window.in_cell(face, np.array(cell))
            aside = np.zeros(2) if face.array is None else window.centres(face.array, np.array(cell))
            along = float((np.array(own.vertex) + [*aside, 0.0]) @ frame[:, 2])
            if face.array is not None:
                assert np.abs(own.rotation[:, 2] - frame[:, 2]).max() < 1e-15
            if z is not None:
                total = np.array([[1.0, along - z], [0.0, 1.0]]) @ total
            z = along
            power = (after - before) * own.side * getattr(own.surface, f"curvature_{axis}")
            total = np.array([[1.0, 0.0], [-power / after, before / after]]) @ total
            before = after
    return total


@pytest.mark.parametrize("form", FORMS)
def test_each_pair_is_afocal_with_exactly_its_own_eta(tmp_path, form):
    window = of_form(tmp_path, form)
    for cell in window.lattice.cells():
        for axis in "xy":
            eta = getattr(window.law_at(cell), f"eta_{axis}")
            (_, _), (bends, magnifies) = matrix(window, cell, axis)
            assert abs(bends) * 0.25 < 3e-14
            assert magnifies == pytest.approx(1.0 / eta, rel=1e-12)


LENSED = {
    "two plates": {"pair__field": {"gap": 0.5}}, "hexagonal": {"pair__field": {"gap": 0.5}, "lattice__kind": "hexagonal"},
    "plano": FORMS["plano"], "curved inside": FORMS["plano, curved inside"], "biconvex": FORMS["biconvex"],
    "aimed": {"pair__field": {"gap": 0.5}, "lattice__aperture": {"point": [3, 2, -300]}},
    "steered plano": {**FORMS["plano"], "lattice__aperture": [0.02, -0.01]},
}  # fmt: skip


@pytest.mark.parametrize("form", ["two plates", "plano", "biconvex"])
def test_given_faces_behind_field_lenses_are_scaled_as_those_that_are_derived(tmp_path, form):
    """Given as they were derived for the law's eta, with tables of the same cells."""
    derived = clacad.prescribe(field_design(tmp_path, form, still, pair__offset="paraxial"))
    faces = [face_table(face_spec(face.surface)) for face in derived.faces]
    keys = {"pair__prescription": "given", "pair__face": faces, "pair__offset": "paraxial"}
    if form != "two plates":
        keys["pair__thickness"] = list(derived.recipe["T"])
    given = clacad.prescribe(field_design(tmp_path, form, still, **keys))
    x, y = np.array([0.1, 0.2]), np.array([-0.2, 0.05])
    for cell in derived.lattice.cells()[::4]:
        for one, other in zip(derived.faces, given.faces, strict=True):
            here, there = (lens_height(w.in_cell(f, cell), x, y) for w, f in ((derived, one), (given, other)))
            assert np.abs(here - there).max() < 1e-16
    both = field_design(tmp_path, form, still, **keys, eta=MILD)
    with pytest.raises(clacad.DesignError, match="CL127"):
        clacad.prescribe(both)


MILD = across(spread(-0.95, -1.1), spread(-1.15, -1.0))
"""η along both axes of a cell; where both are near -1 one focus may lie before or behind the other."""
LENSED_OF_TWO = {
    "two axes": {}, "two axes, law of two": {"law__eta": [-1.0, -1.1], "pair__field": {"gap": 0.7}},
    "two axes, hexagonal": {"lattice__kind": "hexagonal"}, "two axes, aimed": {"lattice__aperture": {"point": [3, 2, -300]}},
    "two axes, plano": FORMS["plano"], "two axes, curved inside": FORMS["plano, curved inside"],
    "two axes, biconvex": FORMS["biconvex"], "two axes, biconvex, law of two": {**FORMS["biconvex"], "law__eta": [-1.0, -1.1]},
    "two axes, steered plano": {**FORMS["plano"], "lattice__aperture": [0.02, -0.01]},
    "two axes, turned": {"turn": turned}, "two axes, turned plano": {**FORMS["plano"], "turn": turned},
    "turned": {"eta": None, "law__eta": [-1.0, -1.1], "turn": turned}, "two axes, phi": {"law__euler": [25, 0, 0]},
}  # fmt: skip
"""As `LENSED`, with an η along each lens axis."""


def field_design(folder, form, delta=sloping, **more):
    own = (LENSED | LENSED_OF_TWO)[form]
    keys = {"eta": MILD if form in LENSED_OF_TWO else spread(-0.9, -1.2), "pair__field_lens": True, **own}
    return design(folder, delta=delta, **{**keys, "pair__surface": None, **more})


@pytest.mark.parametrize("form", [*LENSED, *LENSED_OF_TWO])
def test_the_field_lens_of_each_cell_images_its_lens_1_onto_its_lens_2_and_leaves_its_law(tmp_path, form):
    """By the product of the matrices of its faces, from the plane of lens 1 to that of lens 2."""
    window = clacad.prescribe(field_design(tmp_path, form))
    for cell in window.lattice.cells():
        for axis in "xy":
            eta = getattr(window.law_at(cell), f"eta_{axis}")
            (_, images), (bends, magnifies) = matrix(window, cell, axis)
            assert abs(bends) < (1e-15 if form in LENSED else 1e-14)
            assert magnifies == pytest.approx(1.0 / eta, rel=1e-14 if form in LENSED else 4e-14)
            if "inside" not in form and "biconvex" not in form:  # whose end faces are not in the lens plane
                assert abs(images) < 1e-13
    faces = [face for face in window.faces if face.array == 2]
    for face in faces[: None if form in LENSED else 0]:
        assert np.ptp(window.vertices(face, window.lattice.cells())[:, 2]) > 0.5


CUT_ACROSS = {
    "hexagonal": {"lattice__kind": "hexagonal"}, "turned": {"law__euler": [30, 0, 0]}, "aimed": {"lattice__kind": "hexagonal", "lattice__aperture": {"point": [3, 2, -300]}},
    "hexagonal plano": {**FORMS["plano"], "lattice__kind": "hexagonal"}, "turned biconvex": {**FORMS["biconvex"], "law__euler": [0, 0, 50]},
    "baffle": {**FORMS["plano"], "body__baffle": True, "body__baffle_wall": 0.02}, "best": {"lattice__kind": "hexagonal", "pair__confocal": "best"},
}  # fmt: skip
"""Sheets of one law of two η whose cells would cut across cylinders, or whose baffle would interrupt them."""


@pytest.mark.parametrize("form", CUT_ACROSS)
def test_one_law_of_two_eta_whose_cells_would_cut_cylinders_has_field_faces_curved_along_both(tmp_path, form):
    """By matrices along both axes, and as the sheet of a table with these numbers in every cell."""
    keys = {
        "law__eta": [-1.0, -1.1],
        "pair__field_lens": True,
        "pair__surface": None,
        "pair__offset": "paraxial",
    }
    keys |= CUT_ACROSS[form] | {"lattice__count": [4, 3]}
    made = design(tmp_path, across(lambda i, j: -1.0, lambda i, j: -1.1), still, **keys)
    raw = made.to_dict()
    del raw["law"]["varying"]
    own, one = clacad.prescribe(clacad.Design.from_dict(raw)), clacad.prescribe(made)
    for cell in own.lattice.cells()[::3]:
        for axis, eta in zip("xy", (-1.0, -1.1), strict=True):
            (_, _), (bends, magnifies) = matrix(own, cell, axis)
            if form != "best":
                assert abs(bends) < 1e-14
                assert magnifies == pytest.approx(1.0 / eta, rel=1e-13)
        for face, other in zip(own.faces, one.faces, strict=True):
            assert own.in_cell(face, cell).surface == one.in_cell(other, cell).surface
    cells, ray = own.lattice.cells(), np.array([*aperture_slopes(own, own.lattice.cells()[:1])[0], 1.0])
    start = np.column_stack([own.lattice.centres(cells) + [0.02, 0.01], np.zeros(len(cells))]) - ray
    seen = clacad.trace(own, clacad.Rays(start, ray))
    exact = np.array([own.law.refract(ray)] * len(cells))
    assert np.abs(seen.direction - exact).max() < 4e-4


FOLLOWING = {
    "another pitch": {"lattice__kind": "hexagonal", "lattice__pitch_2": 0.5013, "pair__field": {"gap": 0.8}},
    "turned array": {**FORMS["plano"], "law__euler": [30, 0, 0], "lattice__rotation_2": "1.5 mrad"},
    "another pitch, tilted": {"law__euler": [20, 3, 0], "lattice__pitch_2": 0.5013, "pair__field": {"gap": 0.8}},
    "varying": {**FORMS["biconvex"], "law__euler": [30, 0, 0], "gradient": [[1e-3, 4e-4], [-3e-4, 1.2e-3]]},
}  # fmt: skip
"""As `CUT_ACROSS`, with offsets that grow over the sheet."""


@pytest.mark.parametrize("form", FOLLOWING)
def test_two_eta_cut_across_go_with_offsets_that_grow_over_the_sheet(tmp_path, form):
    """Each cell afocal by matrices; light of its own slope leaves by its own law, thin and traced."""
    raw, keys = json.loads(json.dumps(BASE)), dict(FOLLOWING[form])
    raw["law"] = {"eta": [-1.0, -1.1], "euler": keys.pop("law__euler", [0, 0, 0])}
    if (gradient := keys.pop("gradient", None)) is not None:
        raw["law"]["varying"] = {"gradient": gradient}
    keys |= {"pair__field_lens": True, "pair__offset": "paraxial", "lattice__count": [4, 3]}
    keys.pop("pair__surface", None)
    for key, value in keys.items():
        section, _, name = key.partition("__")
        raw[section][name] = value
    del raw["pair"]["surface"]
    window = clacad.prescribe(clacad.Design.from_dict(raw))
    cells = window.lattice.cells()
    for cell in cells:
        for axis, eta in zip("xy", (-1.0, -1.1), strict=True):
            (_, _), (bends, magnifies) = matrix(window, cell, axis)
            assert abs(bends) < 1e-12
            assert magnifies == pytest.approx(1.0 / eta, rel=1e-12)
    ray = np.column_stack([aperture_slopes(window, cells), np.ones(len(cells))])
    start = np.column_stack([window.lattice.centres(cells) + [0.02, 0.01], np.zeros(len(cells))]) - ray
    exact = np.array([window.law_at(cell).refract(one) for cell, one in zip(cells, ray, strict=True)])
    assert np.ptp(exact, axis=0)[:2].min() > 1e-4
    if gradient is None:  # lenses 2 lie in their cells as the middle one does
        lens = next(face for face in window.faces if face.array == 1)
        assert np.ptp(window.vertices(lens, cells)[:, :2], axis=0).max() < 1e-12
    for rung, off in (("thin", 1e-14), ("surfaces", 2e-6)):
        seen = clacad.trace(window, clacad.Rays(start, ray), rung=rung)
        assert (seen.fate == Fate.ALIVE).all()
        assert np.abs(seen.direction - exact).max() < off


def test_a_law_read_once_serves_all_that_ask_for_it(tmp_path, monkeypatch):
    """A table of a field lens, whose thickness is found by trials, is read from its file once."""
    made = field_design(tmp_path, "two axes, biconvex", pair__thickness="auto", lattice__count=[3, 3])
    calls, read = [], asked_cells.read_table
    monkeypatch.setattr(asked_cells, "read_table", lambda *given: calls.append(given) or read(*given))
    clacad.prescribe(made)
    assert len(calls) == 1


def test_two_field_faces_are_the_crossed_cylinders_at_the_distance_of_their_foci(tmp_path):
    """In 50 digits, for every η: afocal with η, lens 1 imaged onto lens 2; at that distance one power of each is 0."""
    etas = np.array([[-0.5, -1.0], [-1.0 - 1e-12, -1.0], [-2.0, -0.7], [-0.3, -0.9]])
    first = 10.0 / (1.0 - etas)
    near, far = first.min(axis=1, keepdims=True), 10.0 - first.max(axis=1, keepdims=True)
    for wider in (1.0, 1.3):
        gap = wider * (10.0 - near - far)
        ends = near - 0.5 * (gap - gap / wider), far - 0.5 * (gap - gap / wider)
        focal, power = toric(etas, ends[0], gap, ends[1])
        with mpmath.workdps(50):
            for k, axis in np.ndindex(4, 2):
                legs = [mpmath.mpf(float(one[k, 0])) for one in (ends[0], gap, ends[1])]
                total = mpmath.matrix([[1, 0], [-1 / mpmath.mpf(focal[0, k, axis]), 1]])
                for leg, bends in zip(
                    legs, (*power[:, k, axis], 1 / mpmath.mpf(focal[1, k, axis])), strict=True
                ):
                    total = mpmath.matrix([[1, 0], [-bends, 1]]) * mpmath.matrix([[1, leg], [0, 1]]) * total
                rounding = 1e-14 * (1 + 10 / legs[1])
                assert abs(total[1, 0]) < rounding
                assert abs(total[0, 1]) < 100 * rounding
                assert abs(total[1, 1] * etas[k, axis] - 1) < 10 * rounding
        if wider == 1.0:
            assert np.sort(np.abs(power), axis=0)[0][[0, 2, 3]].max() < 1e-14
            whole = 1.0 / first - 1.0 / (etas * first)
            assert power.sum(axis=0)[[0, 2, 3]] == pytest.approx(whole[[0, 2, 3]], rel=1e-12)


@pytest.mark.parametrize("offset", ["traced", "paraxial"])
@pytest.mark.parametrize("form", [*LENSED, *LENSED_OF_TWO])
def test_light_through_a_field_lens_of_each_cell_leaves_by_the_law_of_that_cell(tmp_path, form, offset):
    window = clacad.prescribe(field_design(tmp_path, form, pair__offset=offset))
    cells = window.lattice.cells()
    ray = np.column_stack([aperture_slopes(window, cells), np.ones(len(cells))])
    start = np.column_stack([window.lattice.centres(cells) + [0.02, 0.01], np.zeros(len(cells))]) - ray
    for rung, off in (("thin", 1e-14), ("surfaces", 4e-4)):
        seen = clacad.trace(window, clacad.Rays(start, ray), rung=rung, path="numpy")
        assert (seen.fate == Fate.ALIVE).all()
        exact = np.array([window.law_at(cell).refract(one) for cell, one in zip(cells, ray, strict=True)])
        assert np.abs(seen.direction - exact).max() < off
    like = like_cell(window, cells[0])
    aside = start[:1] - [*window.lattice.centres(cells[0]), 0.0] + [*like.lattice.centres(cells[0]), 0.0]
    own = clacad.trace(like, clacad.Rays(aside, ray[:1]), path="numpy").direction
    assert np.abs(own - seen.direction[:1]).max() < 1e-13


def test_chief_rays_of_steered_cells_leave_by_the_law_of_their_cell_to_first_order(tmp_path):
    wide = {"pair__field": {"gap": 2.0}, "pair__offset": "paraxial", "lattice__aperture": [0.004, -0.002]}
    window = clacad.prescribe(field_design(tmp_path, "two plates", still, **wide))
    cells, ray = window.lattice.cells(), np.array([0.004, -0.002, 1.0])
    start = np.column_stack([window.lattice.centres(cells), np.zeros(len(cells))]) - ray
    seen = clacad.trace(window, clacad.Rays(start, ray), path="numpy")
    exact = np.array([window.law_at(cell).refract(ray) for cell in cells])
    assert np.abs(seen.direction - exact).max() < 5e-6  # cubic in the slope


def test_shares_of_light_that_field_lenses_keep_are_those_of_rays(tmp_path):
    window = clacad.prescribe(field_design(tmp_path, "plano"))
    rng = np.random.default_rng(5)
    for slope in ((0.0, 0.0), (0.049, -0.02)):  # the second meets the next field lens in some cells only
        for cell in ((0, 0), (6, 5)):
            place = window.lattice.centres(np.array(cell)) + rng.uniform(-0.25, 0.25, (20_000, 2))
            ray = (*(aperture_slopes(window, np.array([cell]))[0] + slope), 1.0)
            rays = clacad.Rays(np.column_stack([place, np.zeros(20_000)]) - ray, ray)
            counted = (clacad.trace(window, rays, rung="thin").fate == Fate.ALIVE).mean()
            found = partner_share(window, np.array([cell]), np.array([ray]))[0]
            assert found == pytest.approx(counted, abs=0.015)


def test_plates_of_neighbours_that_would_touch_across_their_gap_are_refused_with_the_gap_that_works(tmp_path):
    """Steps of n (f1 - f1') between foci: nothing else lies between the plates."""
    with pytest.raises(clacad.DesignError) as caught:
        clacad.prescribe(field_design(tmp_path, "two plates", pair__field={"gap": 0.1}))
    (mistake,) = caught.value.mistakes
    assert mistake.code == "CL129"
    assert "cells (0, 0) and (1, 0)" in mistake.message
    gap = float(mistake.hint.split("gap > ")[1].split(",")[0])
    window = clacad.prescribe(field_design(tmp_path, "two plates", pair__field={"gap": 1.001 * gap}))
    step = window.bodies[0].index * 10.0 * (1.0 / 1.9 - 1.0 / (1.9 + 0.3 / 11.0))
    assert gap == pytest.approx(step, rel=1e-3)


def test_given_faces_of_a_cell_are_those_of_the_design_scaled_with_its_eta(tmp_path):
    """A polynomial h(r) becomes k h(r/k); the pair of the law's eta is left as it is given."""
    given = [
        {"radius": 2.468, "conic": -0.5, "a4": [1e-3, 0, 2e-3], "a6": [-2e-4] * 4},
        {"radius": 2.468, "a4": [2e-3] * 3},
    ]
    window = built(tmp_path, pair__prescription="given", pair__face=given, pair__surface=None)
    x, y = np.array([0.1, -0.2, 0.05]), np.array([0.15, 0.0, -0.22])
    for cell in window.lattice.cells()[[0, 20, -1]]:
        eta = window.law_at(cell).eta_x
        (_, _), (bends, magnifies) = matrix(window, cell)
        assert abs(bends) < 1e-4
        assert magnifies == pytest.approx(1.0 / eta, rel=1e-3)
        for face, size in zip(window.faces, (2.0 / (1.0 - eta), -2.0 * eta / (1.0 - eta)), strict=True):
            own = window.in_cell(face, cell)
            vx, vy, vz = own.vertex
            here = face_height(window, face, x, y, np.broadcast_to(cell, (3, 2)))
            there = vz + size * face.surface.sag((x - vx) / size, (y - vy) / size)
            assert np.abs(here - there).max() < 1e-14


def test_the_depth_of_lenses_scales_with_them(tmp_path):
    window = built(tmp_path, pair__surface=None, pair__depth=[2.4, 3.0])
    for cell in window.lattice.cells()[[0, -1]]:
        eta = window.law_at(cell).eta_x
        sizes = 2.0 / (1.0 - eta), -2.0 * eta / (1.0 - eta)
        for face, depth, size in zip(window.faces, (2.4, 3.0), sizes, strict=True):
            kappa = window.in_cell(face, cell).surface.kappa
            assert abs(kappa) * depth * size == pytest.approx(1.0, rel=1e-14)


@pytest.mark.parametrize("delta", [still, sloping])
def test_the_thickness_that_is_found_is_that_of_the_lens_with_the_least_radius(tmp_path, delta):
    """Two equal spheres of radius R meet the web at the farthest corner: T = web + 2 (R - sqrt(R^2 - rho^2))."""
    web = 0.1
    window = built(
        tmp_path, spread(-0.9, -1.3), delta, pair__form="biconvex", pair__surface=None, pair__web=web
    )
    for array, thickness in enumerate(window.recipe["T"]):
        needed = []
        for cell in window.lattice.cells():
            face = window.in_cell(window.bodies[array].front, cell)
            radius = 1.0 / face.surface.curvature_x
            rho = np.hypot(0.25 + abs(face.vertex[0]), 0.25 + abs(face.vertex[1]))
            needed.append(web + 2.0 * (radius - np.sqrt(radius**2 - rho**2)))
        if delta is still or array == 0:
            assert thickness == pytest.approx(max(needed), rel=1e-9)
        else:  # traced vertices move after the thickness is found
            assert thickness == pytest.approx(max(needed), rel=1e-3)


@pytest.mark.parametrize("form", FORMS)
def test_ideal_lenses_obey_the_law_of_their_cell_and_real_ones_nearly(tmp_path, form):
    window = of_form(tmp_path, form)
    cells, rng = window.lattice.cells(), np.random.default_rng(2)
    place = window.lattice.centres(cells) + rng.uniform(-0.06, 0.06, (len(cells), 2))
    slope = (0.004, -0.003)
    start = np.column_stack([place - np.array(slope), np.full(len(cells), -1.0)])
    for rung, off in (("law", 1e-15), ("thin", 2e-14), ("surfaces", 4e-4)):
        seen = clacad.trace(window, clacad.Rays(start, (*slope, 1.0)), rung=rung, path="numpy")
        alive = np.flatnonzero(seen.fate == Fate.ALIVE)
        assert len(alive) == len(cells)
        for k in alive:
            exact = window.law_at(seen.cell[k]).refract([*slope, 1.0])
            assert np.abs(seen.direction[k] - exact).max() < off


def test_radii_of_a_slab_are_as_its_formula_has_them(tmp_path):
    window = built(tmp_path)
    (body,) = window.bodies
    for cell in window.lattice.cells():
        eta = window.law_at(cell).eta_x
        first, second = (window.in_cell(face, cell).surface for face in (body.front, body.back))
        radius = (body.index - 1.0) * 10.0 / (1.0 - eta)
        assert 1.0 / first.curvature_x == pytest.approx(radius, rel=4e-15)
        assert 1.0 / second.curvature_y == pytest.approx(-eta * radius, rel=4e-15)
        assert first.conic_x == second.conic_y == -1.0 / body.index**2


@pytest.mark.parametrize(
    "keys", [{}, {"pair__surface": None}, {"pair__surface": None, "lattice__kind": "hexagonal"}]
)
def test_cells_of_an_eta_along_each_axis_are_those_of_the_sheet_of_that_law(tmp_path, keys):
    """Of a uniform sheet, whose faces no table scales."""
    window = built(tmp_path, BOTH, still, pair__offset="paraxial", **keys)
    for cell in window.lattice.cells()[::5]:
        law = window.law_at(cell)
        assert (law.eta_x, law.eta_y) == BOTH(*cell)
        raw = json.loads(json.dumps(BASE))
        raw["law"]["eta"], raw["pair"]["offset"] = [law.eta_x, law.eta_y], "paraxial"
        for key, value in keys.items():
            section, _, name = key.partition("__")
            raw[section].update({name: value} if value is not None else {})
            raw[section] = {k: v for k, v in raw[section].items() if value is not None or k != name}
        alike = clacad.prescribe(clacad.Design.from_dict(raw))
        for face, one in zip(window.faces, alike.faces, strict=True):
            own = window.in_cell(face, cell).surface
            assert type(own) is type(one.surface)
            for name in own.__dataclass_fields__:
                assert getattr(own, name) == pytest.approx(getattr(one.surface, name), rel=2e-15)


@pytest.mark.parametrize("law", [[-1.0, -1.0], [-0.8, -1.3]])
def test_a_column_of_one_axis_leaves_the_other_that_of_the_law(tmp_path, law):
    made = design(tmp_path, WIDELY, law__eta=law)
    table = (tmp_path / "cells.csv").read_text()
    for name, axis in (("eta_x", 0), ("eta_y", 1), ("eta", None)):
        (tmp_path / "cells.csv").write_text(table.replace(",eta\n", f",{name}\n"))
        window = clacad.prescribe(clacad.load(tmp_path / "design.toml"))
        for cell in window.lattice.cells()[::4]:
            told = window.law_at(cell).eta_x, window.law_at(cell).eta_y
            want = [WIDELY(*cell)] * 2 if axis is None else [*law]
            if axis is not None:
                want[axis] = WIDELY(*cell)
            assert told == tuple(want)
    assert made.law.eta_x == law[0]


def test_neighbours_whose_eta_differ_by_rounding_have_lenses_that_do(tmp_path):
    """One part in 10¹² along one axis, against the same cells in numbers of 50 digits."""
    eta = across(lambda i, j: -1.0 - 1e-12 * ((i + j) % 2), lambda i, j: -1.2 + 1e-12 * (i % 2))
    window = built(tmp_path, eta, still, law__eta=[-1.0, -1.2], pair__offset="paraxial")
    (body,) = window.bodies
    with mpmath.workdps(50):
        for cell in window.lattice.cells()[:9]:
            for face, lens in ((body.front, 0), (body.back, 1)):
                own = window.in_cell(face, cell).surface
                for c, one in zip((own.curvature_x, own.curvature_y), eta(*cell), strict=True):
                    radius = (mpmath.mpf(body.index) - 1) * 10 / (1 - mpmath.mpf(one))
                    exact = 1 / (radius * (1 if lens == 0 else -mpmath.mpf(one)))
                    assert abs(c / exact - 1) < 8e-16
    step = highest_step(window, body).height
    assert 0.0 < step < 1e-12
    cells = window.lattice.cells()
    start = np.column_stack([window.lattice.centres(cells) + [0.05, 0.08], np.full(len(cells), -1.0)])
    seen = clacad.trace(window, clacad.Rays(start, (0.0, 0.0, 1.0)))
    spread_ = np.ptp(seen.direction, axis=0)
    assert (seen.fate == Fate.ALIVE).all()
    assert spread_[:2].max() < 1e-12


TURNED = {
    "slab": {"law__eta": [-0.8, -1.3]}, "ellipsoids": {"law__eta": [-0.8, -1.3], "pair__surface": None},
    "plano": {**FORMS["plano"], "law__eta": [-0.8, -1.3]}, "hexagonal": {**FORMS["hexagonal"], "law__eta": [-0.8, -1.3]},
    "biconvex": {**FORMS["biconvex"], "law__eta": [-1.0, -1.2]}, "round": {}, "turned law": {"law__eta": [-0.8, -1.3], "law__euler": [10, 0, 20]}, "seam": {"law__eta": [-0.8, -1.3], "lattice__seam": 0.05},
    "field lens": LENSED["two plates"] | {"pair__field_lens": True, "pair__surface": None},
}  # fmt: skip


@pytest.mark.parametrize("form", TURNED)
def test_a_cell_turned_by_its_psi_is_that_of_the_uniform_sheet_turned_as_much(tmp_path, form):
    """Its faces, the places of its lenses in it, its thin lenses and its law."""
    keys = {
        "lattice__count": [4, 3],
        "lattice__aperture": "aligned",
        "pair__offset": "paraxial",
        **TURNED[form],
    }
    made = design(tmp_path, None, sloping, slightly if form == "biconvex" else turned, **keys)
    window = clacad.prescribe(made)
    plain = made.to_dict()
    del plain["law"]["varying"]
    phi = made.law_spec.euler_degrees[0]
    for cell in window.lattice.cells()[::3]:
        psi = (slightly if form == "biconvex" else turned)(*cell)
        plain["law"] |= {"euler": [phi, 0, psi], "delta": list(sloping(*cell))}
        alike = clacad.prescribe(clacad.Design.from_dict(plain))
        like = like_cell(window, cell)
        assert np.abs(like.law.matrix() - alike.law.matrix()).max() < 1e-15
        assert like.thin.offset == pytest.approx(alike.thin.offset, abs=3e-15)
        assert np.abs(like.thin.rotation - alike.thin.rotation).max() < 1e-15
        for own, one in zip(like.faces, alike.faces, strict=True):
            x, y = np.random.default_rng(1).uniform(-0.2, 0.2, (2, 50))
            here, there = (
                face_height(w, f, x, y) + w.bodies[0].front.vertex[2] for w, f in ((like, own), (alike, one))
            )
            assert np.abs(here - there).max() < 1e-13  # a thickness may be found again


def test_neighbours_whose_turns_differ_by_rounding_have_lenses_that_do(tmp_path):
    """By one part in 10¹² of a degree, against the same cells in numbers of 50 digits."""
    turn = lambda i, j: 0.5 + 1e-12 * ((i + j) % 2)  # noqa: E731
    keys = {"law__eta": [-0.8, -1.3], "pair__offset": "paraxial", "pair__surface": None}
    window = built(tmp_path, None, still, turn, lattice__count=[3, 3], **keys)
    (body,) = window.bodies
    x, y = np.array([0.25, -0.2, 0.05]), np.array([0.1, 0.25, -0.25])
    with mpmath.workdps(50):
        for cell in window.lattice.cells():
            angle = mpmath.mpf(turn(*cell)) * mpmath.pi / 180
            c, s = mpmath.cos(angle), mpmath.sin(angle)
            for face in (body.front, body.back):
                q = face.surface
                found = face_height(window, face, x, y, np.broadcast_to(cell, (3, 2))) - face.vertex[2]
                for px, py, z in zip(x, y, found, strict=True):
                    u, v = c * mpmath.mpf(px) + s * mpmath.mpf(py), c * mpmath.mpf(py) - s * mpmath.mpf(px)
                    bent = mpmath.mpf(q.curvature_x) * u**2 + mpmath.mpf(q.curvature_y) * v**2
                    exact = q.side * bent / (1 + mpmath.sqrt(1 - mpmath.mpf(q.kappa) * bent))
                    assert abs(z - exact) < (4e-17 if face is body.front else 4e-15)
    step = highest_step(window, body).height
    one = built(tmp_path, None, still, lambda i, j: 0.5, lattice__count=[3, 3], **keys)
    assert abs(step - highest_step(one, one.bodies[0]).height) < 1e-14


def leaning(i, j):
    """φ, θ, ψ of a cell in degrees."""
    return 17.0 * i - 23.0 * j + 5.0, 0.4 * i - 0.3 * j + 0.2, 11.0 * j


LEANING = {
    "slab": {}, "ellipsoids": {"pair__surface": None}, "curved inside": FORMS["plano, curved inside"], "biconvex": FORMS["biconvex"],
    "hexagonal": FORMS["hexagonal"], "law that leans": {"law__euler": [20, 1, 5]}, "two eta": {"law__eta": [-1.0, -1.2]},
    "two eta of each": {"eta": MILD}, "aimed": {"lattice__aperture": {"point": [3, 2, -300]}},
}  # fmt: skip
LEANING |= {
    f"field lens, {name}": {"pair__field_lens": True, "pair__surface": None, **keys}
    for name, keys in {
        "slab": {"pair__field": {"gap": 0.8}}, "slab of two eta": {"law__eta": [-1.0, -1.1], "eta": MILD},
        "inside": FORMS["plano, curved inside"], "inside of two eta": {**FORMS["plano, curved inside"], "law__eta": [-1.0, -1.1]},
        "biconvex": FORMS["biconvex"], "biconvex of two eta": {**FORMS["biconvex"], "eta": MILD, "law__euler": [20, 1, 5]},
        "aimed slab": {"lattice__aperture": {"point": [3, 2, -300]}, "eta": spread(-0.95, -1.1), "pair__field": {"gap": 0.8}},
    }.items()
}  # fmt: skip
"""Sheets each of whose cells leans by a θ of its own."""


def tilted_design(folder, form, **more):
    keys = {
        "eta": None,
        "delta": still,
        "turn": leaning,
        "pair__offset": "paraxial",
        "lattice__count": [4, 3],
    }
    return design(folder, **{**keys, **LEANING[form], **more})


@pytest.mark.parametrize("form", LEANING)
def test_a_pair_that_leans_by_its_own_theta_is_afocal_along_its_axis_with_its_own_eta(tmp_path, form):
    """By matrices of its faces: each lies across the axis of its cell, wherever that leans."""
    window = clacad.prescribe(tilted_design(tmp_path, form))
    tilts = set()
    for cell in window.lattice.cells():
        tilts.add(window.law_at(cell).theta)
        for axis in "xy":
            (_, _), (bends, magnifies) = matrix(window, cell, axis)
            assert abs(bends) < 1e-12
            assert magnifies == pytest.approx(1.0 / getattr(window.law_at(cell), f"eta_{axis}"), rel=1e-12)
    assert len(tilts) == len(window.lattice.cells())


ONE_LAW = {
    "slab": {"pair__field": {"gap": 0.8}}, "slab of two eta": {"law__eta": [-1.0, -1.1], "pair__field": {"gap": 0.8}},
    "curved inside": FORMS["plano, curved inside"], "curved inside, two eta": {**FORMS["plano, curved inside"], "law__eta": [-1.0, -1.1]},
    "biconvex, two eta": {**FORMS["biconvex"], "law__eta": [-1.0, -1.1]},
    "hexagonal biconvex, two eta": {**FORMS["biconvex"], "law__eta": [-1.0, -1.1], "lattice__kind": "hexagonal"},
    "aimed slab": {"lattice__aperture": {"point": [3, 2, -300]}, "pair__field": {"gap": 0.8}},
    "steered slab of two eta": {"law__eta": [-1.0, -1.1], "lattice__aperture": [0.02, -0.01]},
}  # fmt: skip
"""Field lenses of sheets that lean as one."""


@pytest.mark.parametrize("form", ONE_LAW)
def test_a_sheet_of_one_tilted_law_has_field_lenses_across_its_axis(tmp_path, form):
    """Afocal with η by matrices; as the sheet of a table with the angles of the law in every cell."""
    keys = {
        "law__euler": [20, 3, 10],
        "pair__field_lens": True,
        "pair__surface": None,
        "lattice__count": [4, 3],
    }
    keys |= {"pair__offset": "paraxial", **ONE_LAW[form]}
    made = design(tmp_path, None, still, lambda i, j: (20, 3, 10), **keys)
    raw = made.to_dict()
    del raw["law"]["varying"]
    one, each = clacad.prescribe(clacad.Design.from_dict(raw)), clacad.prescribe(made)
    x, y = np.random.default_rng(3).uniform(-0.2, 0.2, (2, 40))
    for cell in one.lattice.cells()[::3]:
        for axis in "xy":
            (_, _), (bends, magnifies) = matrix(one, cell, axis)
            assert abs(bends) < 1e-12
            assert magnifies == pytest.approx(1.0 / getattr(one.law, f"eta_{axis}"), rel=1e-12)
        for face, other in zip(one.faces, each.faces, strict=True):
            here, there = (
                face_height(w, f, x, y, np.broadcast_to(cell, (40, 2)))
                for w, f in ((one, face), (each, other))
            )
            assert np.abs(here - there).max() < 1e-13


@pytest.mark.parametrize("form", LEANING)
def test_light_of_cells_that_lean_leaves_by_the_law_of_its_cell(tmp_path, form):
    """By kernels, and by a trace through the faces of one cell after the other that is written out here."""
    window = clacad.prescribe(tilted_design(tmp_path, form, pair__offset=None))
    cells = window.lattice.cells()
    ray = np.column_stack([aperture_slopes(window, cells), np.ones(len(cells))])
    start = np.column_stack([window.lattice.centres(cells) + [0.02, 0.01], np.zeros(len(cells))]) - ray
    exact = np.array([window.law_at(cell).refract(one) for cell, one in zip(cells, ray, strict=True)])
    for rung, off in (("law", 1e-15), ("thin", 1e-14), ("surfaces", 8e-4)):
        seen = clacad.trace(window, clacad.Rays(start, ray), rung=rung)
        assert (seen.fate == Fate.ALIVE).all()
        assert np.abs(seen.direction - exact).max() < off
    for cell, begun, along, found in zip(cells[::5], start[::5], ray[::5], seen.direction[::5], strict=True):
        assert np.abs(one_by_one(window, cell, begun, along) - found).max() < 1e-12


def one_by_one(window, cell, start, ray):
    """Direction behind the faces of one cell, each met by bisection of its height and refracted by Snell's law."""
    at, d, before = start, ray / np.linalg.norm(ray), 1.0
    for body in window.bodies:
        for face, after in ((body.front, body.index), (body.back, 1.0)):
            own = window.in_cell(face, cell)
            centre = np.array(
                [*(np.zeros(2) if face.array is None else window.centres(face.array, cell)), 0.0]
            )

            def over(t, own=own, at=at, d=d, centre=centre):
                u, v, w = (at + t * d - centre - own.vertex) @ own.rotation
                return w - float(own.surface.sag(np.array([u]), np.array([v]))[0])

            there = ((centre + own.vertex - at) @ own.rotation[:, 2]) / (d @ own.rotation[:, 2])
            t = brentq(over, there - 0.2, there + 0.2, xtol=1e-15, rtol=1e-15)
            at = at + t * d
            u, v, _ = (at - centre - own.vertex) @ own.rotation
            normal = own.rotation @ own.surface.normal(np.array([u]), np.array([v]))[0]
            normal = normal / np.linalg.norm(normal)
            ratio, cosine = before / after, float(d @ normal)
            d = ratio * d + (np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2)) - ratio * cosine) * normal
            before = after
    return d


def test_planes_leave_a_pair_that_leans_the_least_power_by_the_glass_of_its_lens_2(tmp_path):
    """The power of the traced pair, at the glass it has, is least: a little more or less leaves more."""
    steep = lambda i, j: (17.0 * i - 23.0 * j, 2.0 + 0.4 * i - 0.3 * j, 11.0 * j)  # noqa: E731
    keys = {**FORMS["plano"], "pair__offset": "paraxial", "lattice__count": [3, 3], "law__euler": [0, 2, 0]}
    window = clacad.prescribe(design(tmp_path, None, still, steep, **keys))
    for cell in window.lattice.cells()[1::2]:
        like = like_cell(window, cell)
        turn = like.law.rotation
        left = []
        for more in (-0.004, 0.0, 0.004):
            seq = interfaces(like)
            axis = turn[:, 2] / turn[2, 2]
            seq[-1] = replace(seq[-1], vertex=seq[-1].vertex + more * axis)
            left.append(np.sqrt((parabasal(seq, turn, np.zeros(3), 1e-3).cosines ** 2).sum()))
        assert left[1] < min(left[0], left[2])


def test_a_field_lens_behind_planes_that_lean_cell_by_cell_is_refused(tmp_path):
    keys = {**FORMS["plano"], "pair__field_lens": True, "pair__surface": None, "lattice__count": [3, 3]}
    with pytest.raises(clacad.DesignError, match="CL127") as caught:
        built(tmp_path, None, still, leaning, **keys)
    assert "along and one across the tilt" in caught.value.mistakes[0].message


def test_foci_too_far_apart_for_two_plates_are_refused_with_the_gap_that_works(tmp_path):
    """A face of a field lens is plane where it has the place of the focus of the other axis."""
    keys = {"pair__field_lens": True, "pair__surface": None, "lattice__count": [3, 3]}
    with pytest.raises(clacad.DesignError, match="CL129") as caught:
        built(tmp_path, MILD, still, pair__field={"gap": 0.3}, **keys)
    (mistake,) = caught.value.mistakes
    assert "cell (" in mistake.message
    gap = float(mistake.hint.split("gap > ")[1].split(",")[0])
    window = built(tmp_path, MILD, still, pair__field={"gap": 1.001 * gap}, **keys)
    curved = [
        getattr(window.in_cell(face, cell).surface, f"curvature_{axis}")
        for face in window.faces for cell in window.lattice.cells() for axis in "xy" if face.array == 2
    ]  # fmt: skip
    assert 0.0 < min(curved) < 3e-3 * max(curved)


def test_turned_lenses_that_a_shrinkage_would_deform_are_refused(tmp_path):
    window = built(tmp_path, BOTH, still, turned, lattice__count=[2, 2])
    assert grown_window(window, (1.01, 1.01, 1.01)).faces[0].own_axes
    with pytest.raises(CannotShrink, match="turned lenses take one shrinkage"):
        grown_window(window, (1.01, 1.01, 1.0))
    with pytest.raises(CannotShrink, match="upright"):
        bent_window(window, 1e-4)


EVEN = [
    {"radius": 2.468, "conic": -0.5, "a4": [1e-2, 3e-2, 2e-2], "a6": [1e-2, 2e-2, 0, 3e-2]},
    {"radius": 2.468, "a4": [2e-2] * 3, "a8": [1e-2, 0, 3e-2, 0, 2e-2]},
]
"""Faces with terms of all orders, of lens 1 and of lens 2."""
GIVEN_EVEN = {"pair__prescription": "given", "pair__face": EVEN, "pair__surface": None}


def test_given_terms_of_two_eta_are_along_each_axis_those_of_the_lens_scaled_for_that_axis(tmp_path):
    """In 50 digits: k h(x/k) along x and along y, and lenses of one k as one of one eta has them."""
    window = built(tmp_path, BOTH, still, pair__offset="paraxial", **GIVEN_EVEN)
    (body,) = window.bodies
    with mpmath.workdps(50):
        for cell in window.lattice.cells()[::5]:
            eta = [mpmath.mpf(one) for one in BOTH(*cell)]
            for lens, (face, given) in enumerate(zip((body.front, body.back), EVEN, strict=True)):
                conic = mpmath.mpf(given.get("conic", 0))
                for axis in (0, 1):
                    k = 2 / (1 - eta[axis]) * (1 if lens == 0 else -eta[axis])
                    at = mpmath.mpf("0.21") / k
                    bent = at**2 / mpmath.mpf(given["radius"])
                    root = mpmath.sqrt(1 - (1 + conic) * (at / mpmath.mpf(given["radius"])) ** 2)
                    terms = [given.get(name, [0])[-axis] for name in ("a4", "a6", "a8")]
                    rise = bent / (1 + root) + sum(
                        mpmath.mpf(t) * at ** (4 + 2 * j) for j, t in enumerate(terms)
                    )
                    x, y = np.array([[0.21], [0.0]])[:: 1 - 2 * axis]
                    found = face_height(window, face, x, y, cell[None]) - face.vertex[2]
                    assert abs(found[0] - face.side * k * rise) < 4e-15
    alike = built(tmp_path, across(WIDELY, WIDELY), still, pair__offset="paraxial", **GIVEN_EVEN)
    one = built(tmp_path, WIDELY, still, pair__offset="paraxial", **GIVEN_EVEN)
    for cell in one.lattice.cells()[::5]:
        for a, b in zip(alike.faces, one.faces, strict=True):
            assert alike.in_cell(a, cell).surface == one.in_cell(b, cell).surface


def test_a_table_that_has_the_eta_of_the_law_in_every_cell_makes_the_sheet_of_that_law(tmp_path):
    own, one = built(tmp_path, lambda i, j: -1.0), built(tmp_path, None)
    assert own.many_sizes
    assert not one.many_sizes
    rng = np.random.default_rng(3)
    rays = clacad.Rays(
        np.column_stack([rng.uniform(-1.7, 1.7, (3000, 2)), np.full(3000, -1.0)]),
        np.column_stack([rng.uniform(-0.06, 0.06, (3000, 2)), np.ones(3000)]),
    )
    for rung in ("law", "thin", "surfaces"):
        a, b = (clacad.trace(window, rays, rung=rung, path="numpy") for window in (own, one))
        assert (a.fate == b.fate).mean() > 0.999  # within rounding of a border
        assert np.abs(a.direction - b.direction)[a.fate == b.fate].max() < 2e-15


def test_the_law_of_a_cell_is_that_of_its_row_in_design_and_window(tmp_path):
    made = design(tmp_path)
    window = clacad.prescribe(made)
    for cell in ((0, 0), (6, 5), (2, 4)):
        law = made.law_at(cell)
        assert law == window.law_at(cell)
        assert (law.eta_x, law.eta_y) == (WIDELY(*cell),) * 2
        assert (law.delta_x, law.delta_y) == sloping(*cell)
    assert made.law.eta_x == window.law.eta_x == -1.0
    small = window.with_cells((3, 2))
    assert small.law_at((0, 0)) == window.law_at((2, 2))
    assert (
        small.in_cell(small.faces[0], np.array([0, 0])).surface
        == window.in_cell(window.faces[0], np.array([2, 2])).surface
    )
    start = np.column_stack([small.lattice.centres(small.lattice.cells()) + [0.03, -0.02], np.full(6, -1.0)])
    for rung in ("law", "thin"):
        seen = clacad.trace(small, clacad.Rays(start, (0.0, 0.0, 1.0)), rung=rung)
        exact = [small.law_at(cell).refract([0.0, 0.0, 1.0]) for cell in seen.cell]
        assert np.abs(seen.direction - exact).max() < 1e-14
    again = clacad.Design.from_dict(made.to_dict())
    assert again == made


def test_a_sheet_of_equal_cells_like_one_is_that_cell(tmp_path):
    window = built(tmp_path)
    cells = representative_cells(window, "displaced")
    assert {(0, 0), (6, 5)} <= {tuple(cell) for cell in cells.tolist()}  # the extremes of η
    for cell in cells:
        like = like_cell(window, cell)
        eta = window.law_at(cell).eta_x
        assert like.uniform
        assert not like.many_sizes
        assert like.thin.focal_length[0][0] == pytest.approx(10.0 / (1.0 - eta), rel=1e-15)
        assert like.thin.focal_length[1][1] == pytest.approx(-eta * 10.0 / (1.0 - eta), rel=1e-15)


@pytest.mark.daily_cases("3", "4", "6")
@pytest.mark.parametrize("seed", range(8))
def test_bounds_of_a_face_hold_every_lens_of_a_sheet_drawn_at_random(tmp_path, seed):
    rng = np.random.default_rng(seed)
    etas, deltas = -np.exp(rng.uniform(-0.7, 0.7, (7, 6))), rng.uniform(-0.02, 0.02, (7, 6, 2))
    kind = (
        {}, {"lattice__kind": "hexagonal"}, {"law__euler": [20, 4, 10]}, {"pair__surface": None},
        {"pair__surface": None}, {"law__euler": [20, 4, 10]}, {"pair__surface": None}, {},
    )[seed]  # fmt: skip
    beside, turns = -np.exp(rng.uniform(-0.7, 0.7, (7, 6))), rng.uniform(-180.0, 180.0, (7, 6))
    row = (lambda i, j: i + j // 2) if seed == 1 else (lambda i, j: i)
    window = built(
        tmp_path,
        lambda i, j: etas[row(i, j), j] if seed < 4 else (etas[i, j], beside[i, j]),
        lambda i, j: deltas[row(i, j), j],
        None if seed < 6 else lambda i, j: float(turns[i, j]),
        pair__offset="paraxial",
        **kind,
    )
    (plan,) = lay_out(window).bodies
    corners = window.lattice.tile()
    t = np.linspace(0.0, 1.0, 41)[:, None, None]
    sides = ((1.0 - t) * corners + t * np.roll(corners, -1, axis=0)).reshape(-1, 2)
    points = np.concatenate([sides * k for k in np.linspace(0.0, 1.0, 21)])
    for face, known in ((window.bodies[0].front, plan.front), (window.bodies[0].back, plan.back)):
        for cell in window.lattice.cells():
            z, normal = lens_height_and_normal(window.in_cell(face, cell), *points.T)
            assert known.low - 1e-12 <= z.min() - plan.level
            assert z.max() - plan.level <= known.high + 1e-12
            assert (np.hypot(*normal.T[:2]) / normal.T[2]).max() <= known.slope
            assert window.z_range[0] - 1e-9 <= z.min()
            assert z.max() <= window.z_range[1] + 1e-9


@pytest.mark.daily_cases("one", "turned")
@pytest.mark.parametrize(
    ("eta", "turn"), [(WIDELY, None), (BOTH, None), (BOTH, turned)], ids=["one", "two", "turned"]
)
def test_closed_form_shares_are_those_of_rays_through_ideal_lenses(tmp_path, eta, turn):
    window = built(tmp_path, eta, still, turn)
    rng = np.random.default_rng(5)
    for slope in ((0.0, 0.0), (0.012, -0.004)):
        for cell in ((0, 0), (3, 2), (6, 5)):
            place = window.lattice.centres(np.array(cell)) + rng.uniform(-0.25, 0.25, (20_000, 2))
            rays = clacad.Rays(
                np.column_stack([place, np.zeros(20_000)]) - np.array([*slope, 1.0]), (*slope, 1.0)
            )
            counted = (clacad.trace(window, rays, rung="thin").fate == Fate.ALIVE).mean()
            found = partner_share(window, np.array([cell]), np.array([[*slope, 1.0]]))[0]
            assert found == pytest.approx(counted, abs=0.015)


@pytest.mark.daily_cases("one", "turned")
@pytest.mark.parametrize(
    ("eta", "turn"), [(WIDELY, None), (BOTH, None), (BOTH, turned)], ids=["one", "two", "turned"]
)
def test_the_volume_is_that_of_its_columns_summed_cell_by_cell(tmp_path, eta, turn):
    window = built(tmp_path, eta, turn=turn, lattice__count=[3, 2])
    (body,) = window.bodies
    total = 0.0
    for cell in window.lattice.cells():
        front, back = (window.in_cell(face, cell) for face in (body.front, body.back))

        def thick(y, x, front=front, back=back):
            one, two = (float(lens_height(f, np.array([x]), np.array([y]))[0]) for f in (front, back))
            return two - one

        total += dblquad(thick, -0.25, 0.25, -0.25, 0.25, epsabs=1e-12)[0]
    found = body_volume(window, body)
    assert found.value == pytest.approx(total, abs=1e-9)


def test_the_highest_step_is_found_where_radii_differ(tmp_path):
    window = built(tmp_path, lambda i, j: -0.4 if (i, j) == (3, 2) else -1.0, still)
    (body,) = window.bodies
    step = highest_step(window, body)
    along, worst = np.linspace(-0.25, 0.25, 4001), 0.0
    for face in (body.front, body.back):
        here, there = (
            face_height(window, face, np.full(4001, x), along, np.broadcast_to(cell, (4001, 2)))
            for x, cell in ((0.25, (2, 2)), (-0.25, (3, 2)))
        )
        worst = max(worst, float(np.abs(here - there).max()))
    assert worst > 0.003
    assert step.height == pytest.approx(worst, rel=1e-12)
    assert (
        feasibility(window).bodies[0].step == step.height
    )  # tables give values for the body, not for its middle cell


@pytest.mark.ci_cases("plano, curved inside", "seam", "two axes, biconvex", "two axes, hexagonal")
@pytest.mark.daily_cases("slab")
@pytest.mark.parametrize(
    "form",
    [form if form in ("slab", "biconvex") else pytest.param(form, marks=pytest.mark.slow) for form in FORMS],
)
def test_meshes_of_cells_of_many_sizes_are_closed_and_enclose_what_their_faces_do(tmp_path, form):
    window = of_form(tmp_path, form, lattice__count=[4, 3])
    some, many = (tessellate(window, quads=n) for n in (4, 8))
    for body, one, other in zip(window.bodies, some.bodies, many.bodies, strict=True):
        health = check_closed(lambda one=one: (rows.astype(np.float32) for rows in one.rows()), pieces=True)
        assert health.closed
        assert health.four_face_edges == health.degenerate == 0
        exact = body_volume(window, body)
        if exact is None:  # lenses that end inside their cells
            continue
        apart = [abs(mesh.volume() - exact.value) for mesh in (one, other)]
        assert apart[0] < 0.03 * exact.value
        assert apart[1] < 0.36 * apart[0] + 3.0 * exact.error


def test_facets_of_every_cell_lie_on_the_sphere_of_its_own_radius(tmp_path):
    """Sheet coordinates, and the radius of the formula alone."""
    window = built(tmp_path, WIDELY, still, lattice__count=[4, 3], pair__surface=None)
    (body,) = window.bodies
    (mesh,) = tessellate(window, quads=6).bodies
    for corners, (kinds, cells) in zip(mesh.rows(), facet_tags(mesh), strict=True):
        for kind, face in ((FRONT, body.front), (BACK, body.back)):
            at, cell = corners[kinds == kind], cells[kinds == kind]
            eta = WIDELY(*cell.T)[:, None]
            radius = (body.index - 1.0) * 10.0 / (1.0 - eta) * (1.0 if kind == FRONT else -eta)
            x, y = (at[..., k] - (cell[:, k, None] - (n - 1) / 2) * 0.5 for k, n in ((0, 4), (1, 3)))
            z = face.vertex[2] + face.side * (radius - np.sqrt(radius**2 - x**2 - y**2))
            assert np.abs(at[..., 2] - z).max() < 6.0 * mesh.step


# -- what is refused -----------------------------------------------------------------------------------

PRESENT = {
    "hexagonal cells": {"lattice__kind": "hexagonal"}, "seam": {"lattice__seam": 0.05}, "outline": {"lattice__outline": {"circle": 3}, "lattice__count": None},
    "tilt": {"law__euler": [20, 3, 0]}, "plano": FORMS["plano"], "biconvex": FORMS["biconvex"], "slab": {}, "curved inside": FORMS["plano, curved inside"],
    "thin recipe": {**FORMS["plano"], "pair__confocal": "thin"}, "tolerances": {"tolerances__index": 0.001}, "steered": {"lattice__aperture": [0.01, 0.0]},
    "traced vertices": {"pair__offset": "traced"},
    "given faces": {"pair__prescription": "given", "pair__face": [{"radius": 2.468}, {"radius": 2.468}], "pair__surface": None},
    "eta_x and eta_y that differ": {"law__eta": [-1.0, -0.9]}, "depth of a lens": {"pair__surface": None, "pair__depth": [2.4, 2.4]},
    "biconvex of a thickness to be found": {"pair__form": "biconvex", "pair__surface": None},
    "field lens": {"pair__field_lens": True, "pair__surface": None, "pair__field": {"gap": 0.5}},
}  # fmt: skip


ONE_OR_TWO = {"one": spread(-0.9, -1.3), "two": across(spread(-0.95, -1.2), spread(-1.15, -1.0))}


@pytest.mark.parametrize(
    ("feature", "turn", "etas"),
    [
        (feature, turn, etas)
        for feature in PRESENT
        for turn in (None, slightly)
        for etas in ONE_OR_TWO
        if turn is None or feature != "tilt"
    ],
)
def test_each_feature_works_with_a_table_of_eta_and_one_of_turns(tmp_path, feature, turn, etas):
    assert ("law.varying", feature) not in REASONS
    keys = {} if feature != "field lens" or etas == "one" else {"pair__field": {"gap": 0.8}}
    made = design(tmp_path, ONE_OR_TWO[etas], turn=turn, **PRESENT[feature] | keys)
    window = clacad.prescribe(made)
    assert window.many_sizes
    slope = np.divide(window.thin.shift, window.thin.offset[2])
    cells = window.lattice.cells()
    start = np.column_stack([window.lattice.centres(cells) + [0.02, 0.01] - slope, np.full(len(cells), -1.0)])
    seen = clacad.trace(window, clacad.Rays(start, (*slope, 1.0)), path="numpy")
    assert (seen.fate == Fate.ALIVE).all()
    for k in range(len(cells)):
        exact = window.law_at(seen.cell[k]).refract([*slope, 1.0])
        assert np.abs(seen.direction[k] - exact).max() < 1e-3


def test_biconvex_neighbours_too_unlike_are_refused_by_their_names(tmp_path):
    made = design(tmp_path, lambda i, j: -1.2 if (i, j) == (3, 2) else -1.0, **FORMS["biconvex"])
    with pytest.raises(clacad.DesignError) as caught:
        clacad.prescribe(made)
    (mistake,) = caught.value.mistakes
    assert mistake.code == "CL125"
    assert "(3, 2)" in mistake.message
    assert "0.05" in mistake.message
    clacad.prescribe(design(tmp_path, lambda i, j: -1.05 if (i, j) == (3, 2) else -1.0, **FORMS["biconvex"]))


def test_a_lens_that_would_end_inside_its_cell_is_refused_with_the_pitch_that_works(tmp_path):
    eta = lambda i, j: -0.05 if (i, j) == (2, 1) else -1.0  # noqa: E731
    with pytest.raises(clacad.DesignError) as caught:
        built(tmp_path, eta, still)
    (mistake,) = caught.value.mistakes
    assert mistake.code == "CL120"
    assert "lens 2 of cell (2, 1)" in mistake.message
    pitch = float(mistake.hint.split("pitch < ")[1].split(",")[0])
    built(tmp_path, eta, still, lattice__pitch=0.9 * pitch, pair__offset="paraxial")


def test_lenses_of_many_cells_are_moved_by_a_polynomial_as_by_each_trace(tmp_path, monkeypatch):
    from clacad.prescription import traced_vertices

    one = built(tmp_path, lattice__count=[7, 6])
    monkeypatch.setattr(traced_vertices, "OWN_DIRECT", 10)
    monkeypatch.setattr(traced_vertices, "OWN_LADDER", ((30, 2),))
    monkeypatch.setattr(traced_vertices, "HELD_OUT", 6)
    monkeypatch.setattr(traced_vertices, "FIT", 1e-3)
    other = built(tmp_path, lattice__count=[7, 6])
    a, b = (window.vertices(window.faces[1], window.lattice.cells()) for window in (one, other))
    assert 0.0 < np.abs(a - b).max() < 1e-3 * 0.5


def test_the_mean_of_the_light_that_lens_2_of_a_cell_can_take_leaves_by_its_law(tmp_path):
    window = built(tmp_path)
    quarter = window.lattice.over_cell(sobol(64, 2))
    points = np.concatenate([quarter * signs for signs in ((1, 1), (-1, 1), (1, -1), (-1, -1))])
    for cell in window.lattice.cells()[::7]:
        law = window.law_at(cell)
        place = window.lattice.centres(cell) + min(1.0, -1.0 / law.eta_x) * points
        rays = clacad.Rays(np.column_stack([place, np.full(256, -1.0)]), (0.0, 0.0, 1.0))
        mean = clacad.trace(window.with_cells(window.lattice.count), rays, path="numpy").direction.mean(
            axis=0
        )
        assert np.abs(mean / np.linalg.norm(mean) - law.refract([0.0, 0.0, 1.0])).max() < 1e-12


@pytest.mark.slow
def test_lenses_of_many_cells_stand_within_what_the_polynomial_owns_up_to_on_both_sides_of_eta_minus_one(
    tmp_path, monkeypatch
):
    from clacad.prescription import traced_vertices

    eta, delta = (lambda i, j: -0.5 - 0.01 * (i + j)), (lambda i, j: (5e-4 * (i - 25), 3e-4 * (25 - j)))
    made = design(tmp_path, eta, delta, lattice__count=[51, 51])
    monkeypatch.setattr(traced_vertices, "OWN_DIRECT", 1000)
    one = clacad.prescribe(made)
    monkeypatch.setattr(traced_vertices, "OWN_DIRECT", 10_000)
    other = clacad.prescribe(made)
    a, b = (window.vertices(window.faces[1], window.lattice.cells()) for window in (one, other))
    assert 0.0 < np.abs(a - b).max() < 2e-9 * 0.5


def test_what_takes_lenses_of_one_size_says_so(tmp_path):
    from clacad.effects.engine.camera_light import light_reaching_camera
    from clacad.exporting.pov.pov_solids import NotForPov, refuse

    window = built(tmp_path)
    rays = clacad.Rays(((0.0, 0.0, -1.0),), (0.0, 0.0, 1.0))
    with pytest.raises(ValueError, match="CL139: ghosts on rung law"):
        light_reaching_camera(window, rays, "law", ("ghosts",))
    round_ones = built(tmp_path, lattice__count=[3, 3], pair__surface=None)
    with pytest.raises(NotForPov, match="are of many sizes"):
        refuse(round_ones)
    made = design(tmp_path, lattice__count=[3, 3], pair__surface=None)
    with pytest.raises(ValueError, match=r"CL139: format pov.*held by: step") as refused:
        clacad.export(made, tmp_path / "out", formats=("pov",))
    assert ", pov" not in str(refused.value)
    assert not (tmp_path / "out").exists()
