"""Non-uniform sheets on their hard list: numpy and the compiled kernel compared with 60 digits, ray by ray."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hard.differing import CASES, FAR, window_of
from hard.measure import error, off
from mpmath import mp, mpf
from oracle import sheet as oracle
from oracle import trace as faces

from clacad import Rays, load, prescribe, trace
from clacad.optics.rays import Fate
from clacad.prescription.radii import NoSuchLens
from clacad.prescription.traced_vertices import BRACKET, _cell_points, traced_moves
from clacad.sheet.like_cell import like_cell
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.vignetting import aperture_slopes

ROOT = Path(__file__).parents[2]
WINDOWS = {}


def window_for(case):
    """One window a sheet, however many cases have it."""
    key = repr(case.changes)
    if key not in WINDOWS:
        WINDOWS[key] = window_of(case.changes)
    return WINDOWS[key]


def ray_of(case, window):
    """Start and direction: at a place of the cell of array 1, with a slope beyond the middle of its field."""
    if isinstance(case.off, str):
        return beside_border(case, window)
    return sent(case, window, case.off)


def sent(case, window, place):
    index = np.array(case.cell)
    slope = aperture_slopes(window, index[None])[0] + np.array(case.slope)
    below = window.z_range[0] - 0.25
    start = window.centres(0, index) + np.array(place) + below * slope
    return np.array([*start, below]), np.array([*slope, 1.0])


def beside_border(case, window):
    """A ray that hits lens 2 within a last bit of its start next to a border: sixty digits decide on which side."""
    low, high = -0.2, 0.2

    def met(x):
        return oracle.trace(window, *sent(case, window, (x, 0.03))).cells[-1]

    first = met(low)
    assert first != met(high), "no border is met"
    while (middle := 0.5 * (low + high)) not in (low, high):
        low, high = (middle, high) if met(middle) == first else (low, middle)
    return sent(case, window, (low - 4e-15 if case.off == "below" else high + 4e-15, 0.03))


EVERYDAY = (
    "above a border of the aimed array", "below a border of the wider array",
    "-2, a corner cell", "-2, a ghost", "(1 + 1e-12)", "-1/4 beside -1", "lens 2 concave", "plano, eta from -1/2 to -2", "biconvex, eta from -.8 to -1.2",
)  # fmt: skip


def marks(case):
    """Sheets of 4·10⁸ cells take seconds to make, borders of arrays fifty rays in sixty digits to find."""
    large = dict(case.changes).get("lattice.count", (0, 0))[0] >= FAR[0]
    border = "a few last bits" in case.name and not case.name.endswith(EVERYDAY)
    figures = "etas" in dict(case.changes) and not case.name.endswith(EVERYDAY)
    vast = case.name.endswith("planes, cell (999, 1) of 10^6")
    return [pytest.mark.slow] if large or border or figures or vast else []


@pytest.mark.ci_cases(
    "cell (10^4, 10^4) of an aimed sheet-numpy",
    "cell (10^4, 10^4) of an aimed sheet-numba",
    "corner cell (2e4, 2e4), g = 1 + 1/8000-numba",
    "hexagonal, aimed-numba",
    "a few last bits below a border of the aimed array-numba",
    "a few last bits above a border of a turned array-numpy",
    "a few last bits above a border of a turned array-numba",
    "plano, aimed-numba",
    "tilted, aimed-numba",
    "a traced vertex near its bracket-numba",
    "pitch_2 = pitch (1 + 1e-12), 10^4 cells out-numpy",
    "pitch_2 = pitch (1 + 1e-12), 10^4 cells out-numba",
    "array 2 turned by 1e-6, 10^4 cells out-numba",
    "kappa = 5e-3, vertices traced-numba",
    "kappa = 5e-3, tilted by 3 degrees-numba",
    "eta from -1/2 to -2, hexagonal-numba",
    "eta = -4 beside -1-numpy",
    "a polynomial, eta from -1/2 to -2-numba",
    "conics, eta from -1/2 to -2-numpy",
    "joints of planes, cell (999, 1) of 10^6-numba",
    "curved joints-numba",
    "a film of 1e-6 pitches between planes, aimed-numba",
    "a field plate in air, aimed-numba",
)
@pytest.mark.parametrize("path", ["numpy", pytest.param("numba", marks=pytest.mark.slow)])
@pytest.mark.parametrize("case", [pytest.param(case, id=case.name, marks=marks(case)) for case in CASES])
def test_a_ray_through_cells_that_differ_goes_where_sixty_digits_say(case, path):
    window = window_for(case)
    assert not window.uniform or "faces" in dict(case.changes)
    start, direction = ray_of(case, window)
    exact = oracle.trace(window, start, direction)
    result = trace(window, Rays([start], [direction]), path=path)
    assert Fate(result.fate[0]).name == exact.fate, case.why
    assert tuple(result.cell[0]) == exact.cells[0] == case.cell, case.why
    assert tuple(result.cell[0] + result.order[0]) == exact.cells[-1], case.why
    condition = max(1.0, float(oracle.condition(window, start, direction)))
    assert off(result.direction[0], exact.direction) <= 4 * condition, case.why
    with mp.workdps(60):
        far = max(1.0, float(np.abs(start).max()))
        assert error(result.position[0], exact.position) <= 8 * 2.0**-52 * far * condition, case.why
        assert abs(mpf(float(result.optical_path[0])) - exact.optical_path) <= 8 * 2.0**-52 * condition * 100


LIKE = {
    "aimed": {"lattice.aperture": {"point": [31.7, -12.9, -400]}},
    "aimed, hexagonal": {"lattice.aperture": {"point": [10, 3, -400]}, "lattice.kind": "hexagonal"},
    "other pitch": {"lattice.pitch_2": 0.497},
    "turned": {"lattice.rotation_2": "0.3 deg"},
    "varying": {"law.varying": {"gradient": [[-5e-3, 1e-3], [2e-3, 4e-3]]}},
}


@pytest.mark.parametrize("rung", ["law", "thin", "surfaces"])
@pytest.mark.parametrize("name", LIKE)
def test_a_sheet_of_equal_cells_like_one_sends_light_as_that_cell_does(name, rung):
    """Directions within rounding of places, for cells all over the sheet; what leaves the cell may meet other neighbours."""
    window = window_of(LIKE[name].items())
    rng = np.random.default_rng(4)
    for cell in window.lattice.cells()[:: window.lattice.cell_count // 5]:
        like = like_cell(window, cell, widest=False)
        assert like.uniform
        assert like.law == window.law_at(cell)
        slope = aperture_slopes(window, cell[None])[0] + rng.uniform(-0.004, 0.004, (200, 2))
        place = window.centres(0, cell) + rng.uniform(-0.2, 0.2, (200, 2))
        start = np.column_stack([place - slope, np.full(200, -1.0)])
        rays = Rays(start, np.column_stack([slope, np.ones(200)]))
        found, own = (trace(one, rays, rung=rung, path="numpy") for one in (like, window))
        same = (own.fate == Fate.ALIVE) & (own.cell == cell).all(axis=1)
        assert same.sum() > 150
        both = same & (found.fate == Fate.ALIVE)
        assert both.sum() > 0.95 * same.sum()  # where array 2 is wider, light at its border stays there
        assert np.abs(found.direction - own.direction)[both].max() < 1e-13


def test_the_cells_of_a_stand_in_are_as_wide_as_the_wider_array():
    wider, narrower = (window_of({"lattice.pitch_2": 0.5 * ratio}.items()) for ratio in (1.02, 0.98))
    for window, pitch in ((wider, 0.51), (narrower, 0.5)):
        assert like_cell(window, np.array([3, 4])).lattice.pitch[0] == pytest.approx(pitch, rel=1e-15)
        assert like_cell(window, np.array([3, 4]), widest=False).lattice.pitch == (0.5, 0.5)


def test_the_cells_that_stand_out_are_those_farthest_in_four_directions():
    window = window_of({"lattice.aperture": {"point": [0, 0, -400]}, "lattice.count": [41, 31]}.items())
    cells = {tuple(cell) for cell in representative_cells(window, "displaced").tolist()}
    assert {0, 40} <= {i for i, _ in cells}
    assert {0, 30} <= {j for _, j in cells}
    assert len(cells) <= 5
    assert {i in (0, 40) and j in (0, 30) for i, j in cells} >= {True}
    few = representative_cells(window, "sample", 20)
    assert len(np.unique(few, axis=0)) == 20
    assert np.ptp(few, axis=0).min() > 20


def test_a_vertex_traced_to_the_end_of_its_bracket_sends_the_mean_where_sixty_digits_ask():
    """The steepest light whose vertex is still found, and the next slope refused: at the root itself, not near it."""
    window = prescribe(load(ROOT / "designs" / "window-100mm.toml").replace({"lattice.count": [3, 3]}))
    low, high = 0.1, 0.2
    while high - low > 1e-4:
        middle = 0.5 * (low + high)
        try:
            traced_moves(window, np.array([[middle, 0.0]]))
            low = middle
        except NoSuchLens:
            high = middle
    (move,) = traced_moves(window, np.array([[low, 0.0]]))
    pitch = window.lattice.pitch[0]
    assert 0.29 * pitch < np.abs(move).max() <= BRACKET * pitch
    body = window.bodies[0]
    with mp.workdps(60):
        placed = []
        for face, before, after, aside in (
            (body.front, 1.0, body.index, (0, 0)), (body.back, body.index, 1.0, move),
        ):  # fmt: skip
            one = face.surface
            shape = (one.curvature_x, one.curvature_y, one.kappa, 0.0, one.side)
            at = [mpf(float(v)) + mpf(float(m)) for v, m in zip(face.vertex, (*aside, 0))]
            placed.append(replace(faces.Face("quadric", shape, (0.0, 0.0, 0.0), before, after), vertex=at))
        ray = faces.unit([mpf(low), mpf(0), mpf(1)])
        total = [mpf(0)] * 3
        for x, y in _cell_points(window):
            start = [mpf(float(x)) - mpf(low), mpf(float(y)), mpf(-1)]
            way = faces.trace(placed, start, ray).directions[-1]
            total = [a + b for a, b in zip(total, way)]
        mean, asked = faces.unit(total), faces.unit([-mpf(low), mpf(0), mpf(1)])
        assert max(float(abs(a - b)) for a, b in zip(mean, asked)) < 4e-13
