"""Sheets on the edge of being one: corners of zero thickness, steps from nothing to a pitch, thick pairs in 50 digits."""

from __future__ import annotations

from dataclasses import replace
from math import atan, degrees
from pathlib import Path

import numpy as np
import pytest
from hard.measure import ULP, assert_whole, relative
from hard.sheets import window_of
from mpmath import mp
from oracle import thick

from clacad import DesignError, Rays, load, prescribe, tessellate, trace
from clacad.formats.mesh.measure import measure
from clacad.optics.rays import Fate
from clacad.sheet.feasibility import feasibility
from clacad.sheet.volume_and_extent import body_volume
from clacad.sheet.window import lens_height
from clacad.tracing.reference import surfaces

DESIGNS = Path(__file__).parents[2] / "designs"
PITCH = 0.005
SMALL = {"lattice.count": [3, 3], "pair.confocal": "thin"}


def faces_of(window, meridian):
    """Curvature towards +z, vertex and indices of every face, for the oracle's matrices."""
    rows = []
    for body in window.bodies:
        for face, before, after in ((body.front, 1.0, body.index), (body.back, body.index, 1.0)):
            c = (face.surface.curvature_x, face.surface.curvature_y)[meridian] * face.side
            rows.append((c, face.vertex[2], before, after))
    return rows


PAIRS = {
    "paper": {},
    "thin as paper": {"pair.thickness": 1e-9},
    "as thick as it may be": {"pair.thickness": 0.01, "law.eta": [-1.0, -1.0]},
    "unequal": {"pair.thickness": [0.002, 0.0005], "law.eta": [-0.5, -2.0]},
    "eta 1e-2": {"law.eta": [-0.01, -1.0], "lattice.pitch": 1e-4, "pair.thickness": 1e-5},
    "eta 1e2": {"law.eta": [-100.0, -1.0], "lattice.pitch": 1e-4, "pair.thickness": 1e-5},
    "Galilean": {"law.eta": [0.25, 0.5], "pair.thickness": 0.001},
    "eta nearly 1": {"law.eta": [1 - 1e-6, -1.0], "pair.thickness": 0.001},
    "index 1.001": {"pair.index": 1.001, "lattice.pitch": 2e-5, "pair.thickness": 2e-5},
    "index 4": {"pair.index": 4.0},
}


@pytest.mark.parametrize("name", PAIRS)
def test_the_radii_of_an_exact_pair_keep_their_digits(name):
    """Radii against a root of the pair's matrix in 50 digits; the condition is the thin pair's, 1/|1 - η| and |η|."""
    window = window_of(PAIRS[name])
    thickness = [2 * abs(b.back.vertex[2] - b.front.vertex[2]) / 2 for b in window.bodies]
    for meridian, eta in enumerate((window.law.eta_x, window.law.eta_y)):
        radii = [
            (1.0 / (b.front.surface.curvature_x, b.front.surface.curvature_y)[meridian])
            for b in window.bodies
        ]
        exact = thick.confocal_radii(eta, 0.05, thickness, window.bodies[0].index)
        condition = 8.0 + 1.0 / abs(1.0 - eta) + abs(eta) + 1.0 / abs(eta)
        for got, right in zip(radii, exact):
            assert relative(got, right) <= 16 * condition, name


@pytest.mark.parametrize("name", PAIRS)
def test_an_exact_pair_is_afocal_as_its_matrix_says(name):
    window = window_of(PAIRS[name])
    for meridian, eta in enumerate((window.law.eta_x, window.law.eta_y)):
        m = thick.matrix(faces_of(window, meridian))
        condition = 8.0 + 1.0 / abs(1.0 - eta) + abs(eta) + 1.0 / abs(eta)
        with mp.workdps(50):
            assert abs(float(m[1, 0])) * 0.05 <= 64 * ULP * condition * max(1.0, 1.0 / abs(eta))
            assert abs(float(m[1, 1] * eta - 1)) <= 64 * ULP * condition
            assert abs(float(m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]) - 1) < 1e-40


@pytest.mark.daily_cases("eta0")
@pytest.mark.parametrize("eta", [(-1.0, -1.0), (-0.5, -2.0)])
def test_a_column_holds_the_volume_that_thirty_digits_say(eta):
    window = window_of({"law.eta": list(eta), "lattice.count": [1, 1]})
    for body in window.bodies:
        front, back = (
            (f.surface.curvature_x, f.surface.curvature_y, f.surface.kappa, f.surface.side, f.vertex[2])
            for f in (body.front, body.back)
        )
        exact = thick.column_volume(front, back, PITCH / 2, PITCH / 2)
        assert float(body_volume(window, body).value) == pytest.approx(float(exact), rel=1e-11)


# -- thickness at exactly corner-zero ------------------------------------------------------------------------------


def corner_window(eta, change):
    """A sheet whose thickness leaves exactly nothing at the corners of lens 2, but for a relative change."""
    start = window_of({**SMALL, "law.eta": list(eta), "pair.thickness": 0.001})
    surface = start.bodies[1].front.surface
    least = thick.least_thickness(
        1 / surface.curvature_x, 1 / surface.curvature_y, 1 / surface.kappa, PITCH / 2
    )
    return window_of({**SMALL, "law.eta": list(eta), "pair.thickness": float(least) * (1 + change)}), float(
        least
    )


@pytest.mark.daily_share(4)
@pytest.mark.parametrize("eta", [(-1.0, -1.0), (-0.25, -1.0), (-0.25, -0.25)])
@pytest.mark.parametrize("change", [0.0, 2.0**-52, -(2.0**-52), 1e-12, -1e-12, 1e-6, -1e-6])
def test_corners_of_no_thickness_break_nothing(eta, change):
    window, least = corner_window(eta, change)
    body = window.bodies[1]
    corner = np.array([PITCH / 2])
    gap = lens_height(body.back, corner, corner) - lens_height(body.front, corner, corner)
    assert gap[0] - least * change == pytest.approx(0.0, abs=8 * ULP * 0.06)  # heights are those of the sheet
    facts = feasibility(window)
    if abs(change) >= 1e-9:
        holes = next(b.holes for b in facts.bodies if b.name == body.name)
        assert holes == (4 if change < 0 else 0)  # the four inner corners of 3 by 3
    near = (
        np.array([[1.0, 1.0], [1 - 1e-9, 1.0], [1.0, 1 - 1e-6], [1 - 1e-4, 1 - 1e-4], [0.999, 1.0]])
        * PITCH
        / 2
    )
    start = np.column_stack([near, np.full(5, -0.01)])
    for path in ("numpy", "numba"):
        result = trace(window, Rays(start, np.tile([0.0, 0.0, 1.0], (5, 1))), path=path)
        assert_whole(result, 5)
    mesh = tessellate(window, quads=4)
    found = measure([mesh.vertices[mesh.triangles]])
    assert found.closed


# -- steps between neighbours --------------------------------------------------------------------------------------


@pytest.mark.daily_share(3)
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("step", [0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-2, 0.1, 0.3, 1.0])
def test_steps_from_nothing_to_a_pitch_are_traced_alike_and_stay_closed(kind, step):
    """A tilt by atan(step) leaves neighbours `step` pitches apart in height."""
    changes = {
        "lattice.count": [3, 3], "lattice.kind": kind, "pair.thickness": "auto", "pair.confocal": "thin",
        "law.euler": [0.0, degrees(atan(step)), 0.0], "law.eta": [-1.0, -1.0],
    }  # fmt: skip
    try:
        window = window_of(changes)
    except DesignError:
        assert step >= 0.1  # a neck that a step of a tenth of a pitch leaves needs lenses thicker than 2 R
        window = window_of({**changes, "pair.thickness": 0.003})
    rng = np.random.default_rng(11)
    n = 3000
    start = np.column_stack([rng.uniform(-1.6, 1.6, (n, 2)) * PITCH, np.full(n, -0.03)])
    start[:200, :2] = rng.integers(-3, 4, (200, 2)) * PITCH / 2  # onto borders and corners
    ray = np.column_stack([rng.normal(0, 0.05, (n, 2)), np.ones(n)])
    ray[:100, :2] = 0.0
    rays = Rays(start, ray)
    one, other = trace(window, rays, path="numpy"), trace(window, rays, path="numba")
    for result in (one, other):
        assert_whole(result, n)
    # on a border by construction the last bit may choose; elsewhere the paths agree
    free = slice(200, None)
    assert (one.fate[free] == other.fate[free]).mean() >= 0.999
    same = (
        (one.fate == other.fate)
        & (one.cell == other.cell).all(axis=1)
        & (one.order == other.order).all(axis=1)
    )
    on = same & np.isin(one.fate, (Fate.ALIVE, Fate.GHOST, Fate.LAND))
    np.testing.assert_allclose(one.direction[on], other.direction[on], rtol=0, atol=1e-12)
    mesh = tessellate(window, quads=4)
    assert measure([mesh.vertices[mesh.triangles]]).closed


# -- near a seam ------------------------------------------------------------------------------------------------------


def walked(window, rays, monkeypatch):
    """The rays by the complete walk alone, which the straight path may only abbreviate."""
    straight = surfaces.in_cell

    def never(*given):
        passage = straight(*given)
        return replace(passage, good=np.zeros_like(passage.good))

    with monkeypatch.context() as patch:
        patch.setattr(surfaces, "in_cell", never)
        return trace(window, rays, path="numpy")


@pytest.mark.daily_cases("clear-numpy", "opaque-numba", "clear-numba")
@pytest.mark.parametrize("path", ["numpy", "numba"])
@pytest.mark.parametrize("land", ["opaque", "clear"])
def test_the_straight_path_does_not_pass_over_a_seam_that_the_walk_meets(land, path, monkeypatch):
    """Islands above a sunk land: light that is over the seam at a face's lowest plane must not be taken for a lenslet's."""
    window = prescribe(load(DESIGNS / "tilted-seam.toml", overrides=[f'lattice.land="{land}"']))
    rng, pitch = np.random.default_rng(5), window.lattice.pitch[0]
    n, half = 4096, 0.5 * (pitch - window.land.seam)
    cells = window.lattice.centres(rng.integers(3, 17, (n, 2)))
    edge = np.column_stack(
        [half * rng.choice([-1, 1], n) * rng.normal(1, 0.02, n), rng.uniform(-half, half, n)]
    )
    edge = np.where(rng.random((n, 1)) < 0.5, edge, edge[:, ::-1])
    ray = np.column_stack([rng.normal(0, 0.3, (n, 2)), np.ones(n)])
    # through the edges of lens 1 and, going back through the glass, of lens 2
    behind = rng.random((n, 1)) < 0.5
    aim = np.column_stack([cells + edge, np.zeros(n)]) + behind * np.append(window.shifts[1], 0.0)
    aim[:, 2] += np.where(behind[:, 0], window.bodies[0].back.vertex[2], 0.0)
    rays = Rays(aim - 40 * pitch * ray, ray)
    whole, got = walked(window, rays, monkeypatch), trace(window, rays, path=path)
    assert (whole.fate == (Fate.VIGNETTED if land == "opaque" else Fate.LAND)).sum() > 100
    assert np.array_equal(got.fate, whole.fate)
    assert np.array_equal(got.order, whole.order)
    np.testing.assert_allclose(got.direction, whole.direction, rtol=0, atol=1e-13)
