"""Stacks for a wanted matrix: by hand, in 50 digits, against thin rays written here, and what is refused."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from fractions import Fraction as F
from math import degrees, inf, radians, tan
from pathlib import Path

import numpy as np
import pytest
from mpmath import matrix, mp, mpf

import clacad
from clacad.advice.stack_designs import wanted_matrix
from clacad.advice.wanted_stack import (
    NoSuchStack,
    Solved,
    Wanted,
    passed,
    solve_three,
    solve_two,
    stack_of_three,
)
from clacad.cli import main
from clacad.prescription.bodies import face_spec, given_design
from clacad.rendering.sheet_passage import stack_of
from clacad.scene import load_scene
from clacad.stacking import chief_matrices
from clacad.stacking.stack_light import measure_light
from clacad.tracing.through_stack import StackTracer

FILE = Path(__file__).parents[2] / "designs" / "window-100mm.toml"
SPLIT = (485 / 3, 970 / 3)
"""Two gaps, one twice the other: with three sheets of 5 mm they make 500 mm."""


def wanted(
    kind: str = "cloak", value: float = 1.0, gaps=SPLIT, planes=(0.0, 0.0), **changes: float
) -> Wanted:
    """Sheets of PMMA, .5 mm cells, 5 mm between arrays; light 50 mm wide within one degree."""
    shape = {"separation": 5.0, "pitch": 0.5, "radius": 25.0, "field": radians(1), "bend": 0.4936, **changes}
    length = 3 * shape["separation"] + sum(gaps)
    return Wanted(kind, wanted_matrix(kind, value, length, planes), gaps=gaps, **shape)


def matrix_of(solved: Solved, separation: float) -> chief_matrices.ChiefRays:
    """The matrix of solved sheets by the mechanism that measures stacks."""
    kappas = [one.eta / one.f_image for one in solved.sheets]
    row = [chief_matrices.sheet(solved.sheets[0].eta, separation, kappa=kappas[0])]
    for gap, one, kappa in zip(solved.gaps, solved.sheets[1:], kappas[1:], strict=True):
        row += [chief_matrices.space(gap), chief_matrices.sheet(one.eta, separation, kappa=kappa)]
    return chief_matrices.in_a_row(row)


@pytest.mark.parametrize(
    ("eta_1", "eta_2"), [(F(-2), F(1, 3)), (F(-3, 2), F(1, 2)), (F(-4, 5), F(5, 3)), (F(-6, 5), F(-9, 10))]
)
def test_thin_sheets_at_equal_gaps_are_the_family_in_closed_form(eta_1, eta_2):
    """eta_3 = 1/(eta_1 eta_2), k2 = (2 eta_1 - 1 - 1/eta_2)/G, k1 = -k2/(2 eta_1), f_image = -1/k, in fractions."""
    gap = 100
    k2 = (2 * eta_1 - 1 - 1 / eta_2) / gap
    k1 = -k2 / (2 * eta_1)
    eta_3 = 1 / (eta_1 * eta_2)
    k3 = -(k2 * (1 + gap * k1) + k1 / eta_2) / eta_3
    solved = stack_of_three(wanted(gaps=(gap, gap), separation=0.0), float(eta_1), float(eta_2))
    assert [one.eta for one in solved.sheets] == pytest.approx(
        [float(v) for v in (eta_1, eta_2, eta_3)], rel=1e-13
    )
    assert [one.f_image for one in solved.sheets] == pytest.approx(
        [float(-1 / k) for k in (k1, k2, k3)], rel=1e-12
    )
    if eta_1 == -2:
        assert [one.f_image for one in solved.sheets] == pytest.approx([50.0, 12.5, -75.0], rel=1e-12)
    np.testing.assert_allclose(matrix_of(solved, 0.0).matrix, [[1, 200], [0, 1]], atol=1e-10)


WISHES = {
    "cloak with a narrow ring": (wanted(ring=5.0), solve_three),
    "cloak with a ring": (wanted(ring=15.0), solve_three),
    "negative space, 2": (wanted("space", -300.0, radius=8.0, field=0.004), solve_two),
    "negative space, 3": (wanted("space", -100.0), solve_three),
    "compressed, 2": (wanted("space", 1500.0), solve_two),
    "compressed, 3": (wanted("space", 250.0), solve_three),
    "relay": (wanted("relay", -1.0), solve_three),
    "image": (wanted("image", -0.8, planes=(100.0, 50.0), radius=10.0), solve_three),
}


@pytest.mark.parametrize(("wish", "solve"), WISHES.values(), ids=WISHES)
def test_solved_sheets_have_the_wanted_matrix_and_keep_every_limit(wish, solve):
    solved = solve(wish)
    found = matrix_of(solved, wish.separation).matrix
    size = np.array([[1.0, wish.length], [1.0 / wish.length, 1.0]])
    np.testing.assert_allclose(found / size, np.array(wish.matrix) / size, atol=1e-9)
    assert max(one.height for one in solved.sheets) <= 0.65
    assert min(abs(one.viewer) for one in solved.sheets) >= 10 * wish.separation
    assert solved.ring >= wish.ring or not wish.ring
    assert 0.0 < solved.share <= 1.0 / solved.loss**2 + 1e-12


def test_an_imaging_pair_images_its_plane_at_the_wanted_size():
    wish, solve = WISHES["image"]
    beyond, _, size = matrix_of(solve(wish), wish.separation).image(100.0)
    assert (beyond, size) == pytest.approx((50.0, -0.8), rel=1e-9)


HARD = {
    "eta_2 next to 1": (-1.1, 1.0 + 1e-6, 5.0, SPLIT),
    "light meets next to sheet b": (-1.0, -1.0 - 1e-5, 1e-7, (100.0, 100.0)),
    "thick sheets, short gaps": (-1.3, 0.7, 100.0, (10.0, 0.5)),
    "gaps a million to one": (-1.2, -0.9, 5.0, (1e-3, 1e3)),
    "eta of 5 decades": (-200.0, 0.003, 5.0, (50.0, 50.0)),
    "micrometres": (-1.17, -0.93, 5e-3, (0.16, 0.32)),
    "least product of eta that is searched": (-0.2, 0.2, 1e-3, (100.0, 100.0)),
    "gaps of almost 0": (-1.2, -0.9, 5.0, (1e-12, 3e-12)),
    "sheet b almost without focus": (-1.0, -1 / 3 + 1e-9, 0.0, (100.0, 100.0)),
}


@pytest.mark.parametrize(("eta_1", "eta_2", "s", "gaps"), HARD.values(), ids=HARD)
def test_hard_stacks_are_those_of_50_digits(eta_1, eta_2, s, gaps):
    """Powers and eta from the four equations, solved in 50 digits; each within 16 ulp times its own condition."""
    length = 3 * s + sum(gaps)
    with mp.workdps(50):

        def solve(inputs):
            e1, e2, s, g1, g2 = inputs
            total = 3 * mpf(5 * 0) + length
            ahead = g2 + s
            place = (total - (s + ahead / e2) / e1) / (s + g1 / e1)
            k2, k1 = (place - 1) / ahead, (1 - place) / (place * g1 + s + ahead / e2)
            first = matrix([[1, s], [k1, 1 / e1]])
            rest = (
                matrix([[1, g2], [0, 1]]) * matrix([[1, s], [k2, 1 / e2]]) * matrix([[1, g1], [0, 1]]) * first
            )
            k3, inverse = mp.lu_solve(rest.T, matrix([0, 1]))
            return [1 / inverse, -1 / k1, -1 / k2, -1 / k3]

        inputs = [mpf(v) for v in (eta_1, eta_2, s, *gaps)]
        exact = solve(inputs)
        condition = [mpf(0)] * 4
        for number in range(5):
            moved = list(inputs)
            moved[number] *= 1 + mpf(10) ** -25
            for k, (a, b) in enumerate(zip(solve(moved), exact)):
                condition[k] += abs(a - b) / abs(b) * mpf(10) ** 25
        solved = stack_of_three(wanted(gaps=gaps, separation=s), eta_1, eta_2)
        found = [solved.sheets[2].eta, *(one.f_image for one in solved.sheets)]
        for value, truth, own in zip(found, exact, condition):
            assert abs(mpf(value) - truth) <= 16 * mpf(2) ** -52 * (1 + own) * abs(truth)


def thin_share(solved: Solved, wish: Wanted, field: float, count: int = 40000) -> float:
    """Share along one axis of rays through thin lenses in aimed cells, written from t' = t - x/f."""
    rng = np.random.default_rng(5)
    x = rng.uniform(-wish.radius, wish.radius, count)
    t = rng.uniform(-1, 1, count) * tan(field)
    s, p, good = wish.separation, wish.pitch, np.ones(count, dtype=bool)
    for number, one in enumerate(solved.sheets):
        f1, f2 = s / (1 - one.eta), -one.eta * s / (1 - one.eta)
        cell = np.floor(x / p) + 0.5  # an even number of cells
        centre = cell * p
        vertex = centre + one.eta / one.f_image * centre * f1
        scale = 1.0 if one.viewer == inf else 1.0 - s / one.viewer
        t = t - (x - centre) / f1
        x = x + s * t
        good &= np.abs(x - centre * scale) < 0.5 * p * scale
        t = t - (x - vertex) / f2
        x = x + t * (solved.gaps[number] if number < len(solved.gaps) else 0.0)
    return float(good.mean())


@pytest.mark.parametrize("field", [0.05, 0.5, 1.0])
@pytest.mark.parametrize("eta", [(-1.1694, -0.9282), (-2.0, 0.5), (-1.5, -0.8)])
def test_the_share_falls_with_eta_and_field_as_thin_rays_do(eta, field):
    """The closed form takes places in a sheet as independent of those in the sheet before: within .07 an axis."""
    wish = replace(wanted(), field=radians(field), radius=15.0)
    solved = stack_of_three(wish, *eta)
    rays = thin_share(solved, wish, radians(field))
    assert solved.share**0.5 == pytest.approx(rays, abs=0.07)
    if field == 0.05:
        assert solved.share**0.5 == pytest.approx(1.0 / solved.loss, rel=0.07)


def test_the_share_of_one_pair_is_that_of_the_cells_overlap():
    c = np.linspace(0.0, 2.0, 41)
    for eta in (-1.0, 0.5, -0.25, 2.0):
        x = (np.arange(4000) + 0.5) / 4000 - 0.5
        rays = (np.abs(eta * x[:, None] + c) < 0.5).mean(axis=0)
        np.testing.assert_allclose(passed(c, np.array(eta)), rays, atol=2e-3)


def test_the_best_of_the_family_is_where_the_ring_and_the_middle_sheet_bind():
    """More light needs |eta| nearer to 1 in all sheets: then the light leaves less of a ring, or bends too steeply."""
    wish = wanted(ring=15.0)
    best = solve_three(wish)
    assert best.ring == pytest.approx(15.0, abs=0.1)
    assert best.sheets[1].height == pytest.approx(0.65, abs=0.03)
    grid = [
        stack_of_three(wish, a, b) for a in np.linspace(-1.3, -1.0, 13) for b in np.linspace(-1.1, -0.8, 13)
    ]
    assert max(one.share for one in grid if not one.binding) <= best.share + 1e-9
    brighter = [one for one in grid if one.share > best.share + 1e-9]
    assert len(brighter) > 10
    assert all(one.binding for one in brighter)


@pytest.mark.parametrize(
    ("wish", "solve", "said"),
    [
        (wanted(), solve_two, r"eta = 1, and a pair has no power"),
        (
            wanted(radius=60.0, ring=36.0),
            solve_three,
            r"the first could be \d+\.?\d* wide at most, not 120: sheet b binds",
        ),
        (wanted("relay", 1.0), solve_two, "of the radius of lens 2 from its vertex, beyond 0.65"),
        (wanted("space", 5.0), solve_two, "infinite eta"),
    ],
)
def test_what_cannot_be_is_said_with_the_limit_that_binds(wish, solve, said):
    with pytest.raises(NoSuchStack, match=said):
        solve(wish)


# --- the command ------------------------------------------------------------------------------------------

LINE = ("stack", str(FILE), "--gap", "161.6667,323.3333", "--zone", "50 mm", "--set", "pair.separation=5",
        "--set", "pair.form=plano", "--set", 'pair.surface="biconic"')  # fmt: skip


@pytest.mark.slow
def test_the_command_says_what_two_and_three_sheets_can_and_writes_the_scene(tmp_path, capsys, monkeypatch):
    """The scene's chief rays are off by what its exact faces add: light through those acts as 500 mm of space."""
    (tmp_path / FILE.name).write_text(FILE.read_text(encoding="utf-8"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    out = Path("scenes/cloak.toml")
    line = [LINE[0], FILE.name, *LINE[2:], "--zone", "16 mm", "--for", "cloak,ring=4 mm", "-o"]
    out.parent.mkdir()
    assert main([*line, str(out)]) == 0
    said = capsys.readouterr().out
    assert re.match(r"cloak of 500 mm: 3 sheets pass \d\d\.\d % of the light within ± 1 deg", said)
    assert "not possible: two sheets: sheet a would be of eta = 1" in said
    assert f"next: clacad stack {out}" in said
    assert len(said.splitlines()) <= 24
    stack = stack_of(load_scene(out))
    chief = chief_matrices.meridian(stack, 0).matrix
    np.testing.assert_allclose(chief, [[1, 500], [0, 1]], rtol=0.2, atol=2e-3)
    np.testing.assert_allclose(chief_matrices.meridian(stack, 1).matrix, chief)
    light = measure_light(
        [StackTracer(stack, "surfaces")], 1 << 14, radians(1), lambda *_: None, (16.0, 16.0)
    )[0].meridians[0]
    assert light.measured_space == pytest.approx(500.0, abs=10.0)
    assert light.measured_slope == pytest.approx(1.0, abs=0.01)
    assert main([*line, str(out)]) == 4  # the file is there
    assert main([*line, "elsewhere/far/cloak.toml"]) == 2


@pytest.mark.slow
def test_the_command_gives_the_numbers_as_json(capsys):
    assert main([*LINE, "--for", "space=-100 mm", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["matrix"] == [[1.0, -100.0], [0.0, 1.0]]
    assert degrees(found["sheets"]["3"]["field"]) > 1.0
    assert 0.0 < found["sheets"]["3"]["by_rays"] < 1.0
    assert {"impossible"} <= found["sheets"]["2"].keys() or found["sheets"]["2"]["share"] > 0


def test_listed_plates_are_refused_with_the_forms_that_can_be_solved(tmp_path, capsys):
    """Faces that a file lists do not follow from eta; no scene is written."""
    source = clacad.load(FILE, ["lattice.count = [8, 8]"])
    window = clacad.prescribe(source)
    plates = given_design(source, window, tuple(face_spec(face.surface) for face in window.faces), None)
    given = tmp_path / "listed.toml"
    given.write_text(plates.toml, encoding="utf-8")
    out = tmp_path / "scene.toml"
    asked = [
        "stack",
        str(given),
        "--gap",
        "161.6667,323.3333",
        "--zone",
        "50 mm",
        "--for",
        "cloak,ring=15 mm",
    ]
    assert main([*asked, "-o", str(out)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "form slab, plano or biconvex, no listed faces" in said
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--for", "space"), "--for space="), (("--for", "magic"), "give one of cloak, space, relay, image"),
        (("--for", "relay=0"), "is a magnification, a number that is not 0"),
        (("--for", "cloak,ring=-1"), "--for ring=-1:"),
        (("--for", "relay=1", "--gap", ""), "--for needs --gap"), (("--for", "cloak"), "needs ring=LENGTH"),
    ],
)  # fmt: skip
def test_a_wish_that_is_none_is_one_sentence(words, said, capsys):
    assert main([*LINE, *words]) == 2
    assert said in capsys.readouterr().err
