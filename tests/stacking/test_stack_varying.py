"""Stacks of sheets whose law varies: chief rays of each sheet focus, and light fills the whole sheet or a stated zone."""

from __future__ import annotations

import json
from fractions import Fraction as F
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from mpmath import matrix, mp, mpf

import clacad
from clacad.cli import main
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.stack import BadStack, stacked
from clacad.stacking.chief_matrices import about_cell, expected_share, meridian, no_meridian
from clacad.stacking.stack_light import measure_light
from clacad.tracing.through_stack import StackTracer, lit_cells

ROOT = Path(__file__).parents[2]
FILE = ROOT / "designs" / "window-100mm.toml"
PLAIN = clacad.load(FILE).replace({"lattice.count": [16, 16], "check.process": "none"})
S = 10
"""Separation of the arrays of every sheet, mm."""


def silent(*_: object) -> None:
    """Print nothing."""


def sheet(**keys: object) -> clacad.Window:
    """A sheet of 16 x 16 cells of .5 mm with some keys, `__` for a dot."""
    return made_once(json.dumps({key.replace("__", "."): value for key, value in keys.items()}))


@cache
def made_once(keys: str) -> clacad.Window:
    """The sheet of these keys."""
    return clacad.prescribe(PLAIN.replace(json.loads(keys)))


def product(*factors: tuple[tuple[F, F], tuple[F, F]]) -> list[list[float]]:
    """The exact product of 2 x 2 matrices, the first factor on the left."""
    whole = ((F(1), F(0)), (F(0), F(1)))
    for right in factors:
        whole = tuple(tuple(sum(whole[i][k] * right[k][j] for k in (0, 1)) for j in (0, 1)) for i in (0, 1))
    return [[float(value) for value in row] for row in whole]


def act(eta: F, kappa: F = F(0), s: int = S) -> tuple[tuple[F, F], tuple[F, F]]:
    """A sheet: x' = x + s t, t' = (t - kappa x)/eta."""
    return ((F(1), F(s)), (-kappa / eta, 1 / eta))


def imaged(eta: F, kappa: F = F(0), scale: F = F(1)) -> tuple[tuple[F, F], tuple[F, F]]:
    """A sheet with a field lens: x' = g x, from the middle of cell 1 to that of cell 2, t' = (t - kappa x)/eta."""
    return ((scale, F(0)), (-kappa / eta, 1 / eta))


def air(length: int) -> tuple[tuple[F, F], tuple[F, F]]:
    """Empty space."""
    return ((F(1), F(length)), (F(0), F(1)))


M1, HALF = F(-1), F(-1, 2)
VIEWER = {"point": [0, 0, -400]}
# the sheets' keys, clear distance between lens planes, then the factors, last sheet first
CASES = {
    "a lens of 60 mm before a plain sheet": (
        [{"law__varying__f_image": 60}, {}],
        50,
        (act(M1), air(50), act(M1, F(-1, 60))),
    ),
    "a lens of 200 mm before a plain sheet": (
        [{"law__varying__f_image": 200}, {}],
        50,
        (act(M1), air(50), act(M1, F(-1, 200))),
    ),
    "a plain sheet before a lens of -200 mm": (
        [{}, {"law__varying__f_image": -200}],
        30,
        (act(M1, F(1, 200)), air(30), act(M1)),
    ),
    "two lenses, eta -1/2 and -1": (
        [{"law__eta": [-0.5, -0.5], "law__varying__f_image": 250}, {"law__varying__f_image": 400}],
        20,
        (act(M1, F(-1, 400)), air(20), act(HALF, HALF / 250)),
    ),
    "focal length of x alone": (
        [{"law__varying__f_image": [300, "inf"]}, {}],
        50,
        (act(M1), air(50), act(M1, F(-1, 300))),
    ),
    "a gradient of the offset": (
        [{"law__varying__gradient": [[0.004, 0.0], [0.0, -0.002]]}, {}],
        40,
        (act(M1), air(40), act(M1, F(4, 1000))),
    ),
    "a lens with a field lens": (
        [{"law__varying__f_image": 200, "pair__field_lens": True}, {}],
        50,
        (act(M1), air(50), imaged(M1, F(-1, 200))),
    ),
    "cells aimed at 400 mm, with a field lens and as a lens": (
        [{"law__varying__f_image": 200, "pair__field_lens": True, "lattice__aperture": VIEWER}, {}],
        50,
        (act(M1), air(50), imaged(M1, F(-1, 200), F(41, 40))),
    ),
    "cells aimed at 400 mm without a field lens": (
        [{"lattice__aperture": VIEWER}, {"law__varying__f_image": 90}],
        50,
        (act(M1, F(-1, 90)), air(50), act(M1)),
    ),
    "a Galilean lens before one of eta 2": (
        [{"law__eta": [0.5, 0.5], "law__varying__f_image": -100}, {"law__eta": [2, 2]}],
        60,
        (act(F(2)), air(60), act(F(1, 2), F(-1, 200))),
    ),
    "three sheets that focus": (
        [
            {"law__eta": [-2, -2], "law__varying__f_image": 500},
            {"law__varying__f_image": 300},
            {"law__eta": [0.5, 0.5]},
        ],
        40,
        (act(HALF * -1), air(40), act(M1, F(-1, 300)), air(40), act(F(-2), F(-2, 500))),
    ),
}


def standing(keys: list[dict[str, object]], air_mm: float):
    """A stack with so much air between the last lens plane of a sheet and the first of the next."""
    windows = [sheet(**one) for one in keys]
    touching = stacked(windows, [0.0] * (len(windows) - 1))
    sunk = [b.lens_planes[0] - a.lens_planes[1] for a, b in zip(touching.sheets, touching.sheets[1:])]
    return stacked(windows, [air_mm - one for one in sunk])


@pytest.mark.daily_cases("keys0-10")
@pytest.mark.parametrize(
    ("keys", "B"),
    [({"lattice__aperture": VIEWER}, 10), ({"lattice__aperture": VIEWER, "pair__field_lens": True}, 0)],
)
def test_the_fit_to_rays_is_not_misled_by_slopes_that_grow_across_the_sheet(keys, B):
    """Cells aimed at a point: slope and place of the rays go together, and places inside a cell are its blur."""
    made = stacked([sheet(**keys, lattice__count=[40, 40])], [])
    tracers = [StackTracer(made, rung) for rung in ("thin", "surfaces")]
    thin = measure_light(tracers, 1 << 14, 0.002, silent)[0].meridians[0]
    scale = 41 / 40 if B == 0 else 1.0
    for middle in (-5.0, 5.0):  # light of the viewer through the cell there
        left = thin.measured_scale * middle + thin.measured_space * middle / 400
        assert left == pytest.approx(scale * middle + B * middle / 400, abs=0.02)
    assert thin.measured_scale == pytest.approx(scale, abs=0.02)
    assert thin.measured_slope == pytest.approx(-1.0, abs=1e-9)
    assert thin.measured_focusing == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_the_chief_ray_matrix_of_sheets_that_focus_is_the_product_of_theirs(case):
    keys, gap, factors = case
    made = meridian(standing(keys, gap), 0)
    np.testing.assert_allclose(made.matrix, product(*factors), rtol=1e-12, atol=1e-14)
    assert no_meridian(standing(keys, gap)) is None


def test_each_axis_has_the_focal_length_of_its_own():
    made = standing([{"law__varying__f_image": [300, "inf"]}, {}], 50)
    np.testing.assert_allclose(meridian(made, 1).matrix, product(act(M1), air(50), act(M1)), rtol=1e-12)


def test_array_2_of_another_pitch_is_a_lens_in_a_stack():
    """f_image = f2 p1/(p1 - p2) of two lens arrays: .5 and .495 mm, f = 5 mm, is 500 mm."""
    found = meridian(standing([{"lattice__pitch_2": 0.495}], 0), 0).matrix
    np.testing.assert_allclose(found, product(act(M1, F(-1, 500))), rtol=1e-12)


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"law__varying__gradient": [[0.0, 0.002], [-0.002, 0.0]]}, "sheet b: the offset along x grows along y"),
        ({"law__euler": [0.0, 2.0, 0.0]}, "sheet b: tilted or turned lenses mix x and y"),
    ],
)  # fmt: skip
def test_a_sheet_that_mixes_x_and_y_has_no_matrix_and_says_which(keys, reason):
    made = standing([{}, keys], 50)
    assert meridian(made, 0) is None
    assert no_meridian(made).startswith(reason)


def test_a_table_of_cells_has_no_one_kappa_and_the_command_says_so(tmp_path, capsys):
    rows = "\n".join(f"{i},{j},{0.001 * (i % 2)},0" for i in range(6) for j in range(6))
    (tmp_path / "cells.csv").write_text(f"i,j,delta_x,delta_y\n{rows}\n")
    text = FILE.read_text().replace("[200, 200]", "[6, 6]")
    design = tmp_path / "own.toml"
    design.write_text(
        text.replace("[pair]", '[law.varying]\ntable = "cells.csv"\n\n[pair]').replace("#:schema", "#")
    )
    line = ["stack", str(design), str(design), "--gap", "1", "--rays", "512", "--json"]
    assert main(line) == 0
    light = json.loads(capsys.readouterr().out)["light"][0]
    assert light["meridians"][0]["matrix"] is None
    assert "a table gives each cell its own law" in light["meridians"][0]["no_matrix"]
    assert light["cells"] == 36


def test_rays_over_the_whole_sheet_go_as_its_chief_rays_do():
    """By ideal laws, sheets of no depth and with all their light: A, B, C and D fitted to rays are those of the matrix."""
    made = standing([{"law__varying__f_image": 200}, {}], 50)
    tracers = [StackTracer(made, rung) for rung in ("law", "surfaces")]
    law = measure_light(tracers, 4096, 0.002, silent)[0]
    expected = product(act(M1, s=0), air(50), act(M1, F(-1, 200), s=0))
    for one in law.meridians:
        found = [[one.measured_scale, one.measured_space], [one.measured_focusing, one.measured_slope]]
        np.testing.assert_allclose(found, expected, rtol=0.01, atol=1e-5)
    assert law.cells == 256


def test_the_share_of_a_sheet_that_focuses_is_that_of_all_its_cells():
    """Thin lenses written here: light along the normal, cell by cell, then through the plain sheet behind it.

    Cell at X sends light along -X/200; over 50 mm it lies at 3 X/4 of the next sheet, whose cell passes 1 - 2 s|t|/(2 p)
    of it in either axis.
    """
    made = standing([{"law__varying__f_image": 200}, {}], 50)
    tracers = [StackTracer(made, rung) for rung in ("thin", "surfaces")]
    thin, _ = measure_light(tracers, 1 << 14, 1e-6, silent)
    centres = (np.arange(16) - 7.5) * 0.5
    axis = np.mean(1.0 - S * np.abs(centres / 200.0) / 0.5)
    assert thin.expected_share == pytest.approx(axis**2, abs=0.02)
    assert thin.share == pytest.approx(axis**2, abs=0.05)
    middle = measure_light(tracers, 1 << 12, 1e-6, silent, zone=(1.0, 1.0))[0]
    assert middle.share > thin.share + 0.15
    assert middle.cells == 4


def test_light_that_misses_the_next_sheet_is_lost_in_closed_form_too():
    made = stacked([sheet(law__varying__f_image=200), sheet(lattice__count=[4, 4])], [1.0])
    cells = lit_cells(made)
    place = made.sheets[0].window.centres(0, cells)
    straight = np.broadcast_to([0.0, 0.0, 1.0], (len(cells), 3))
    assert expected_share(made, place, straight) < 25 / 256  # 4 x 4 cells see at most 5 x 5 that look inwards


def test_one_cell_is_lit_where_it_tells_of_all_and_the_whole_sheet_where_not():
    plain, coarse = sheet(), sheet(lattice__pitch=0.4)
    assert len(lit_cells(stacked([plain, plain], [50.0]))) == 1
    assert len(lit_cells(stacked([plain, coarse], [50.0]))) == 256
    assert len(lit_cells(stacked([plain, plain], [50.0]), (4.0, 2.0))) == 32
    with pytest.raises(BadStack, match=r"zone 0\.1 x 0\.1: no cell of the first sheet has its centre in it"):
        lit_cells(stacked([plain, plain], [50.0]), (0.1, 0.1))


def test_the_command_takes_a_zone_and_prints_the_focusing_matrix(capsys):
    line = ["stack", str(FILE), str(FILE), "--gap", "50", "--set", "a.law.varying.f_image=60", "--set", "lattice.count=[8,8]",
            "--zone", "2 mm", "--rays", "512", "--all"]  # fmt: skip
    assert main(line) == 0
    said = capsys.readouterr().out
    assert "chief rays (x, t) -> (0 x -50 t, 0.0166667 x +1 t)" in said
    assert "over 16 of its 64 cells" in said
    assert main([*line[:9], "--zone", "1,2,3"]) == 2
    assert "give one, or width,height" in capsys.readouterr().err
    assert main([*line[:9], "--zone", "-1"]) == 2


# --- sheets that mix x and y, and tables: the matrix about the chief ray of a cell ---------------------------


def exact_ray(made, cells, given):
    """Place and slope behind ideal pairs of 50 digits: straight to the plane of lens 2, then by the cell's law."""
    x, y, tx, ty = given
    for number, one in enumerate(made.sheets):
        if number:
            gap = mpf(one.lens_planes[0]) - mpf(made.sheets[number - 1].lens_planes[1])
            x, y = x + gap * tx, y + gap * ty
        window = one.window
        law = (
            window.law if window.cell_laws is None else window.cell_laws.law_at(window.lattice, cells[number])
        )
        turn = matrix(law.rotation.tolist())
        delta = matrix([mpf(law.delta_x), mpf(law.delta_y)])
        if window.cell_laws is not None and window.cell_laws.table is None:  # smooth: δ where the ray is
            grown = matrix(window.cell_laws.gradient) * matrix([x, y])
            delta = matrix([window.law.delta_x, window.law.delta_y]) + grown
        own = turn.T * matrix([tx, ty, 1])
        slopes = [(own[k] / own[2] - delta[k]) / mpf(eta) for k, eta in enumerate((law.eta_x, law.eta_y))]
        out = turn * matrix([*slopes, 1])
        s, level = mpf(window.thin.separation), mpf(window.thin.offset[2])
        deep = s / own[2]
        x, y = (a + deep * b + (level - deep) * c / out[2] for a, b, c in ((x, tx, out[0]), (y, ty, out[1])))
        tx, ty = out[0] / out[2], out[1] / out[2]
    return x, y, tx, ty


def own_table(tmp_path: Path, text: str, extra: str = "") -> clacad.Design:
    """A design of 8 x 8 cells whose table gives each its offset and η."""
    rows = "\n".join(
        f"{i},{j},{0.001 * (i - 2 * j)},{0.002 * j},{-1.0 + 0.01 * i + 0.02 * j}"
        for i in range(8)
        for j in range(8)
    )
    (tmp_path / "cells.csv").write_text(f"i,j,delta_x,delta_y,eta\n{rows}\n")
    name = tmp_path / "own.toml"
    text = (
        text.replace("[200, 200]", "[8, 8]")
        .replace("#:schema", "#")
        .replace("[check]\n", f"[check]\n{extra}")
    )
    name.write_text(text.replace("[pair]", '[law.varying]\ntable = "cells.csv"\n\n[pair]'))
    return clacad.load(name)


@pytest.mark.parametrize("kind", ["tilted", "turned lens", "table of eta", "hard"])
def test_the_matrix_about_a_cell_is_the_derivative_of_its_chief_ray_in_50_digits(kind, tmp_path):
    """Central differences of 1e-20 in 50 digits; 1e-11 of the largest entry of its block."""
    tilted = clacad.load(ROOT / "designs" / "tilted.toml")
    one = {
        "tilted": lambda: clacad.prescribe(tilted),
        "turned lens": lambda: sheet(law__euler=[30.0, 1.5, 20.0], law__eta=[-1.0, -0.8]),
        "table of eta": lambda: clacad.prescribe(own_table(tmp_path, FILE.read_text())),
        "hard": lambda: sheet(law__euler=[45.0, 5.0, 0.0], law__eta=[-0.2, -1.5], law__delta=[0.01, 0.0]),
    }[kind]()
    made = stacked([one, one], [0.0 if kind == "hard" else 3.0])
    cell = central_cell(one)
    found = about_cell(made, cell, (0.001, -0.002))
    with mp.workdps(50):
        start = [*(mpf(float(v)) for v in one.centres(0, np.array(cell))), mpf(0.001), mpf(-0.002)]
        exact = exact_ray(made, found.cells, start)
        step = mpf(10) ** -20
        for column in range(4):
            ends = []
            for sign in (1, -1):
                moved = list(start)
                moved[column] += sign * step
                ends.append(exact_ray(made, found.cells, moved))
            for row in range(4):
                slope = (ends[0][row] - ends[1][row]) / (2 * step)
                block = np.abs(found.matrix[row // 2 * 2 :, column // 2 * 2 :][:2, :2]).max()
                assert abs(mpf(float(found.matrix[row, column])) - slope) <= 1e-11 * max(block, 1e-9)
        got = [*found.place, *found.slope]
        assert all(abs(mpf(float(a)) - b) < 1e-12 * (1 + abs(b)) for a, b in zip(got, exact))


def test_about_a_cell_of_a_sheet_without_mixing_it_is_the_matrix_of_its_meridians():
    keys = [{"law__varying__f_image": 200}, {"law__varying__f_image": -300, "law__eta": [-0.5, -0.5]}]
    made = standing(keys, 50)
    found = about_cell(made, (0, 0)).matrix
    for axis in (0, 1):
        np.testing.assert_allclose(
            found[axis::2, axis::2], meridian(made, axis).matrix, rtol=1e-12, atol=1e-14
        )
        assert np.abs(found[axis::2, 1 - axis :: 2]).max() == 0.0
    lensed = standing([{"pair__field_lens": True, "lattice__aperture": VIEWER}, {}], 50)
    np.testing.assert_allclose(
        about_cell(lensed, (0, 0)).matrix[::2, ::2], meridian(lensed, 0).matrix, rtol=1e-12
    )


def test_a_chief_ray_that_misses_a_sheet_is_refused():
    made = standing([{}, {}], 200)
    with pytest.raises(BadStack, match=r"sheet b: the chief ray of cell \(0, 0\) misses it"):
        about_cell(made, (0, 0), (0.05, 0.0))
