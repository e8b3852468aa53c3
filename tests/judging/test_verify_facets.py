"""Light through triangles: the compiled search against a plain one, and the gathering of facets from a file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracle.plain_mesh import facets, sheet_facets

from clacad.design import Design
from clacad.judging.cell_triangles import Gatherer, telescopelet
from clacad.judging.face_deviation import deviation, forecast_rms
from clacad.judging.mesh_light import lit_cells
from clacad.optics.rays import Fate, Rays
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import bundle
from clacad.tracing.facets.telescopelet import FacetBody, facet_face, first_crossing, trace_facets

PLAIN = Design.from_dict({
    "format": 1, "name": "plain", "unit": "mm", "law": {"eta": [-0.5, -1.0]},
    "pair": {"form": "biconvex", "separation": 10.0, "thickness": "auto", "index": 1.5},
    "lattice": {"pitch": 0.5, "count": [5, 4]},
})  # fmt: skip


def everything(corners, position, direction, entering):
    """Nearest facet of all, by solving three equations for each ray and facet (Möller and Trumbore)."""
    a, b, c = (corners[:, k] for k in range(3))
    e1, e2 = b - a, c - a
    best = np.full(len(position), np.inf)
    for r in range(len(position)):
        h = np.cross(direction[r], e2)
        det = np.einsum("ij,ij->i", e1, h)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = position[r] - a
            u = np.einsum("ij,ij->i", s, h) / det
            q = np.cross(s, e1)
            v = (q @ direction[r]) / det
            t = np.einsum("ij,ij->i", e2, q) / det
        good = (
            (det > 0 if entering else det < 0) & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t >= 0)
        )
        if good.any():
            best[r] = t[good].min()
    return np.where(np.isfinite(best), best, np.nan)


@pytest.mark.parametrize("entering", [True, False])
@pytest.mark.parametrize("quads", [1, 3, 8])
def test_the_facet_found_is_the_nearest_of_all(entering, quads):
    rng = np.random.default_rng(3)
    x = np.linspace(-1, 1, quads + 1)
    gx, gy = np.meshgrid(x, x, indexing="ij")
    z = 0.2 * rng.standard_normal(gx.shape)
    grid = np.stack([gx, gy, z], axis=-1)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    soup = np.concatenate([np.stack([a, b, c], -2), np.stack([a, c, d], -2)]).reshape(-1, 3, 3)
    soup = soup[:, ::-1] if entering else soup  # fronts face down
    position = np.column_stack([rng.uniform(-1.5, 1.5, (400, 2)), np.full(400, -2.0)])
    direction = np.column_stack([rng.uniform(-0.6, 0.6, (400, 2)), np.ones(400)])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    found, number = first_crossing(facet_face(soup, np.zeros(3)), position, direction, entering)
    expected = everything(soup, position, direction, entering)
    np.testing.assert_allclose(found, expected, rtol=1e-12, equal_nan=True)
    assert ((number >= 0) == np.isfinite(expected)).all()


def test_no_ray_slips_between_two_facets():
    """A flat plate cut into triangles: rays aimed at vertices and edges all pass, undeviated."""
    x = np.linspace(-1, 1, 9)
    gx, gy = np.meshgrid(x, x, indexing="ij")
    plate = []
    for z, flip in ((0.0, True), (0.3, False)):
        grid = np.stack([gx, gy, np.full_like(gx, z)], axis=-1)
        a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
        soup = np.concatenate([np.stack([a, b, c], -2), np.stack([a, c, d], -2)]).reshape(-1, 3, 3)
        plate.append(facet_face(soup[:, ::-1] if flip else soup, np.zeros(3)))
    aim = np.column_stack([gx[1:-1, 1:-1].ravel(), gy[1:-1, 1:-1].ravel(), np.zeros(49)])
    aim = np.concatenate([aim, aim + [0.125, 0, 0], aim + [0, 0.125, 0], aim + [0.125, 0.125, 0]])
    direction = np.tile(np.array([0.1, -0.05, 1.0]) / np.linalg.norm([0.1, -0.05, 1.0]), (len(aim), 1))
    glass = replace(prescribe(PLAIN).bodies[0], index=1.5)
    result = trace_facets((FacetBody(plate[0], plate[1], glass),), Rays(aim - direction, direction))
    assert (result.fate == Fate.ALIVE).all()
    np.testing.assert_allclose(result.direction, direction, atol=1e-15)


def test_gathering_in_chunks_gives_the_facets_of_a_cell_once_each():
    window = prescribe(PLAIN)
    soup = sheet_facets(window, 4)
    cells = lit_cells(window, 0.0)
    whole, pieces = Gatherer(window, cells), Gatherer(window, cells)
    whole.look(soup)
    for k in range(0, len(soup), 37):
        pieces.look(soup[k : k + 37])
    for number in range(len(cells)):
        for body in (0, 1):
            for side in (0, 1):
                mine = whole.result.corners(body, side, number)
                assert len(mine) == 2 * 4 * 4
                np.testing.assert_array_equal(pieces.result.corners(body, side, number), mine)
    assert pieces.result.walls == len(soup) - pieces.result.optical


def test_the_cells_looked_at_hold_the_middle_and_all_four_corners():
    window = prescribe(PLAIN)
    cells = lit_cells(window, 0.0)
    assert {(0, 0), (4, 0), (0, 3), (4, 3)} <= set(cells)
    assert len(set(cells)) == len(cells)
    assert cells[0] in {(2, 1), (2, 2)}


@pytest.mark.parametrize(
    ("kind", "count"), [("square", [9, 4]), ("hexagonal", [6, 7]), ("hexagonal", [3, 12])]
)
def test_the_cells_looked_at_are_the_outermost_of_all(kind, count):
    window = prescribe(PLAIN.replace({"lattice.kind": kind, "lattice.count": count}))
    chosen = lit_cells(window, 0.0)
    assert window.lattice.contains(np.array(chosen)).all()
    every, own = (window.lattice.centres(cells) for cells in (window.lattice.cells(), np.array(chosen)))
    for way in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        assert (own @ way).max() == pytest.approx((every @ way).max(), abs=1e-12)


def test_an_edge_cell_and_the_middle_one_send_light_the_same_way():
    window = prescribe(PLAIN)
    gatherer = Gatherer(window, [(2, 2), (0, 0)])
    gatherer.look(sheet_facets(window, 6))
    out = []
    for number, cell in enumerate(gatherer.result.cells):
        sent = bundle(window, 512, 0.02, cell=cell).rays
        aside = sent.position + [1e-6, 3e-6, 0.0]  # on an edge either facet may be met
        out.append(trace_facets(telescopelet(window, gatherer.result, number), Rays(aside, sent.direction)))
    assert (out[0].fate == out[1].fate).mean() > 0.995
    both = (out[0].fate == Fate.ALIVE) & (out[1].fate == Fate.ALIVE)
    np.testing.assert_allclose(out[0].direction[both], out[1].direction[both], atol=1e-9)


def test_facets_err_in_slope_as_their_size_over_the_radius():
    """Right-angled facets with legs L on curvature c: rms slope error L sqrt((cx² + cy²)/12) (derived)."""
    window = prescribe(PLAIN)
    gatherer = Gatherer(window, [(2, 2)])
    quads = 16
    for body in window.bodies:
        gatherer.look(facets(window, body, quads))
    found = deviation(window, telescopelet(window, gatherer.result, 0))
    for number, face in enumerate(window.faces):
        s = face.surface
        expected = 0.5 / quads * np.sqrt((s.curvature_x**2 + s.curvature_y**2) / 12.0)
        assert found.slope_rms[number] == pytest.approx(expected, rel=0.05)
    assert found.complete


def test_the_forecast_is_the_error_that_light_shows():
    from clacad.optics.law import angle_between
    from clacad.tracing.trace import trace

    window = prescribe(PLAIN)
    gatherer = Gatherer(window, [(2, 2)])
    gatherer.look(sheet_facets(window, 12))
    bodies = telescopelet(window, gatherer.result, 0)
    lit = bundle(window, 8192, 0.01, cell=(2, 2))
    truth, seen = trace(window, lit.rays), trace_facets(bodies, lit.rays)
    both = (truth.fate == Fate.ALIVE) & (seen.fate == Fate.ALIVE)
    measured = np.sqrt(np.mean(angle_between(truth.direction[both], seen.direction[both]) ** 2))
    assert measured == pytest.approx(forecast_rms(window, deviation(window, bodies)), rel=0.1)
