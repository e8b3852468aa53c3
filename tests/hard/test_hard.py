"""The named hard cases: each against the oracle, with an error allowed in ulp times the case's own condition."""

from __future__ import annotations

import numpy as np
import pytest
from hard.cells import CELLS
from hard.laws import LAWS
from hard.measure import ULP, assert_whole, error, fate_of, interfaces, off, relative, surface_of
from hard.rays import HARD
from hard.sags import SAGS
from hard.views import ANGLES, VIEWS
from mpmath import mp, mpf
from oracle import lattice as lattice_oracle
from oracle import law as law_oracle
from oracle import trace as trace_oracle
from oracle import view as view_oracle

from clacad.optics.law import Law, angle_between, rotation, stretch, stretch_on_sheet
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import trace_sequence
from clacad.sheet.lattice import Lattice

DIGITS = 450  # a sag of 1e-200 together with a start at distance 1

every = pytest.mark.parametrize


def named(cases):
    """Parametrise by name."""
    return every("case", cases, ids=[case.name for case in cases])


SEARCHED = {
    "polynomial, met on the real rim", "polynomial, search from the real rim", "polynomial, met far from the vertex plane",
    "polynomial, start over no real height", "saddle biconic near its equator",
}  # fmt: skip
"""Of single faces: where fifty digits take seconds to find the hit."""


def named_but_slow(cases):
    """Parametrise by name, what takes seconds slow."""
    return every("case", [
        pytest.param(case, id=case.name, marks=(pytest.mark.slow,) if case.name in SEARCHED else ()) for case in cases
    ])  # fmt: skip


def test_every_case_has_a_name_of_its_own_and_a_sentence():
    for group in (HARD, LAWS, SAGS, CELLS, ANGLES, VIEWS):
        names = [case.name for case in group]
        assert len(set(names)) == len(names)
        assert all(len(case.why) > 8 for case in group)


# -- rays through surfaces ---------------------------------------------------------------------------------------


def traced(case):
    """The one ray of a case through its surfaces."""
    result = trace_sequence(interfaces(case.faces), Rays([case.start], [case.direction]), record=True)
    assert_whole(result, 1)
    return result


@pytest.mark.daily_share(3)
@named(HARD)
def test_a_hard_ray_keeps_the_accuracy_its_condition_allows(case):
    exact = trace_oracle.trace(case.faces, case.start, case.direction)
    result = traced(case)
    if case.undecidable:
        return
    assert result.fate[0] == fate_of(exact), case.why
    if exact.status != "ok":
        return
    condition = max(1.0, float(trace_oracle.condition(case.faces, case.start, case.direction)))
    assert off(result.direction[0], exact.directions[-1]) <= 4 * condition, case.why
    gone = float(abs(exact.optical_path[-1]))
    assert error(result.optical_path, exact.optical_path[-1:]) <= 4 * ULP * condition * gone, case.why


@pytest.mark.daily_share(3)
@named_but_slow([case for case in HARD if len(case.faces) == 1 and not case.faces[0].euler])
def test_the_sag_of_a_hit_keeps_sixteen_ulp_of_itself(case):
    exact = trace_oracle.trace(case.faces, case.start, case.direction, DIGITS)
    if exact.status != "ok":
        return
    height = traced(case).position[0, 2]
    if exact.hits[0][2] == 0 or not any((*case.faces[0].shape[:2], *case.faces[0].terms)):
        assert height == 0
        return
    condition = trace_oracle.sag_condition(case.faces, case.start, case.direction, DIGITS)
    assert relative(height, exact.hits[0][2]) <= 16 * max(1.0, float(condition)), case.why


def test_the_whole_list_traced_at_once_is_traced_as_one_by_one():
    """Cases with the same surfaces go as one bundle: a hard ray must not disturb its neighbour."""
    groups = {}
    for case in HARD:
        groups.setdefault(repr(case.faces), []).append(case)
    for cases in groups.values():
        rays = Rays([c.start for c in cases], [c.direction for c in cases])
        together = trace_sequence(interfaces(cases[0].faces), rays)
        for row, case in enumerate(cases):
            alone = traced(case)
            assert alone.fate[0] == together.fate[row]
            assert np.array_equal(alone.direction[0], together.direction[row])


# -- laws --------------------------------------------------------------------------------------------------------


@named(LAWS)
def test_every_hard_case_is_as_good_as_its_condition_allows(case):
    exact = law_oracle.refract(case.law, case.direction, case.axes)
    got = Law(*case.law, axes=case.axes).refract([case.direction])[0]
    if case.undecidable:
        assert np.isnan(got).all() or np.isfinite(got).all()
        return
    if isinstance(exact, law_oracle.Refused):
        assert np.isnan(got).all(), exact.reason
        return
    assert off(got, exact) <= 4 * (1 + law_oracle.condition(case.law, case.direction, case.axes)), case.why


@named([case for case in LAWS if case.upright])
def test_without_a_turn_every_component_keeps_its_relative_accuracy(case):
    exact = law_oracle.refract(case.law, case.direction)
    if isinstance(exact, law_oracle.Refused):
        return
    for got, right in zip(Law(*case.law).refract([case.direction])[0], exact):
        assert abs(mpf(float(got)) - right) <= 4 * ULP * abs(right) + mpf(2) ** -1074, case.why


def test_turns_that_cancel_leave_the_sheet_exactly_upright():
    """θ = 0: R is one turn by φ + ψ, not two whose cosines and sines are rounded."""
    for phi in np.random.default_rng(0).uniform(-3, 3, 200):
        assert np.array_equal(rotation(phi, 0.0, -phi), np.eye(3))


# -- cells -------------------------------------------------------------------------------------------------------


@named(CELLS)
def test_the_cell_of_a_hard_point_is_the_exact_one(case):
    lattice = Lattice(case.kind, case.pitch, case.count)
    index, x, y = lattice.locate(np.array([case.x]), np.array([case.y]))
    exact_index, exact_place = lattice_oracle.locate(case.kind, case.pitch, case.count, case.x, case.y)
    if case.undecidable:
        assert np.abs(index[0] - exact_index).max() <= 1
        assert np.hypot(x[0], y[0]) <= lattice.circumradius * (1 + 1e-12)
        return
    assert tuple(index[0]) == tuple(exact_index), case.why
    rows = 1.0 if case.kind != "hexagonal" else max(1.0, abs(case.y) / case.pitch[1])
    assert error([x[0], y[0]], exact_place) <= 4 * ULP * rows * case.pitch[0], case.why
    if case.kind != "hexagonal":  # rounded once
        for got, right in zip((x[0], y[0]), exact_place):
            assert relative(got, right) <= 1, case.why


@every("kind", ["square", "hexagonal"])
@every("count", [3, 200, 2_000_001])
def test_points_near_borders_and_corners_are_where_exact_arithmetic_puts_them(kind, count):
    rng = np.random.default_rng(3)
    lattice = Lattice(kind, (0.1, 0.1), (count, count))
    index = rng.integers(0, count, (40, 2))
    corners = lattice.tile()[rng.integers(0, len(lattice.tile()), 40)]
    along = rng.choice([0.0, 0.5, 1.0], (40, 1))
    point = lattice.centres(index) + corners * along
    point = np.nextafter(point, point + rng.choice([-1, 0, 1], point.shape))
    found, x, y = lattice.locate(point[:, 0], point[:, 1])
    for k in range(40):
        exact, place = lattice_oracle.locate(kind, lattice.pitch, lattice.count, *point[k])
        if kind == "square":
            assert tuple(found[k]) == tuple(exact)
        else:  # the middle of a wall may fall to either side within the rounding of sqrt(3)
            assert np.abs(found[k] - exact).max() <= 1
            assert np.hypot(x[k], y[k]) <= float(mp.sqrt(place[0] ** 2 + place[1] ** 2)) + 1e-15 * count


# -- angles and views --------------------------------------------------------------------------------------------


@named(ANGLES)
def test_a_hard_angle_keeps_its_relative_accuracy(case):
    assert (
        relative(angle_between([case.first], [case.second])[0], view_oracle.angle(case.first, case.second))
        <= 4
    )


@named(VIEWS)
def test_a_stretch_near_its_pole_keeps_its_relative_accuracy(case):
    """Not four ulp of the condition, which is infinite at the pole, but of the stretch itself."""
    law = Law(*case.eta)
    for axis, eta in enumerate(case.eta):
        exact = view_oracle.stretch(eta, case.z, case.camera)
        assert relative(stretch(law, case.z, case.camera)[axis], exact) <= 4, case.why
        with mp.workdps(DIGITS):
            on_sheet = exact * mpf(case.camera) / (mpf(case.camera) + mpf(case.z))
        assert relative(stretch_on_sheet(law, case.z, case.camera)[axis], on_sheet) <= 4, case.why


# -- nothing is ever nothing -------------------------------------------------------------------------------------


@every("seed", range(4))
def test_no_live_ray_holds_a_nan_however_wild_the_surfaces(seed):
    rng = np.random.default_rng(seed)
    n = 2000
    for _ in range(12):
        sizes = 10.0 ** rng.uniform(-6, 6, 3) * rng.choice([-1, 0, 1], 3, p=[0.3, 0.1, 0.6])
        kind = rng.choice(["quadric", "biconic"])
        shape = (
            *sizes[:2],
            *((sizes[2], 0.0) if kind == "quadric" else rng.uniform(-3, 3, 2)),
            int(rng.choice([-1, 1])),
        )
        face = trace_oracle.Face(kind, shape, after=float(rng.uniform(0.5, 4)))
        start = rng.normal(0, 1, (n, 3)) * 10.0 ** rng.uniform(-8, 4, (n, 1))
        ray = rng.normal(0, 1, (n, 3)) * 10.0 ** rng.uniform(-3, 1, (n, 3))
        result = trace_sequence(interfaces([face]), Rays(start, ray), record=True)
        assert_whole(result, n)
        alive = result.fate == Fate.ALIVE
        np.testing.assert_allclose(np.linalg.norm(result.direction[alive], axis=1), 1, rtol=0, atol=1e-6)
        x, y, z = result.position[alive].T
        surface = surface_of(face)
        apart = np.abs(z - surface.sag(x, y)) * surface.normal(x, y)[:, 2]  # across the surface, not along z
        size = np.abs(start).max(axis=1)[alive] + np.abs(result.position[alive]).max(axis=1)
        assert (apart[np.isfinite(apart)] <= 1e-9 * size[np.isfinite(apart)]).all()
