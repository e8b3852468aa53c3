"""Laws that whole sheets obey regardless of their numbers: instead of examples, anything hypothesis can think of."""

from __future__ import annotations

from dataclasses import replace
from math import degrees, radians

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from clacad import Design, DesignError, Law, Rays, prescribe, trace
from clacad.effects.engine.nonsequential import Rules, trace_nonsequential
from clacad.optics.rays import Fate
from clacad.sheet.face_order import media_of

FINITE = settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow]
)
GOES_ON = (Fate.ALIVE, Fate.GHOST, Fate.LAND)

etas = st.one_of(st.floats(-4.0, -0.2), st.floats(0.2, 0.8), st.sampled_from([-1.0, -0.25, 0.5]))
tilts = st.sampled_from([0.0, 0.0, 0.5, -2.0, 5.0])
turns = st.sampled_from([0.0, 0.0, 45.0, 90.0, 123.4])
small = st.floats(-0.02, 0.02)


@st.composite
def designs(draw, form=None, tilted=True, count=None):
    """A valid design of a few cells, as a dictionary; pitch 1/256 so that lattice points are doubles."""
    form = form or draw(st.sampled_from(["biconvex", "biconvex", "plano", "slab"]))
    data = {
        "format": 1,
        "name": "any",
        "unit": "m",
        "law": {
            "eta": [draw(etas), draw(etas)],
            "delta": [draw(small), draw(small)],
            "euler": [draw(turns), draw(tilts) if tilted else 0.0, draw(turns)],
        },
        "pair": {"form": form, "separation": 2.0**-4, "index": draw(st.floats(1.3, 2.0))},
        "lattice": {
            "kind": draw(st.sampled_from(["square", "square", "hexagonal"])),
            "pitch": 2.0**-8,
            "count": count or [draw(st.integers(1, 5)), draw(st.integers(1, 5))],
        },
    }  # fmt: skip
    return data


def window_of(data):
    """The window, or no example: some pairs cannot exist, and the design raises an error."""
    try:
        return prescribe(Design.from_dict(data))
    except DesignError:
        assume(False)


def bundle(seed, count=60, spread=0.05, over=0.01):
    """Rays from a plane before the sheet, on binary grids so that shifts are exact."""
    rng = np.random.default_rng(seed)
    start = np.round(rng.uniform(-over, over, (count, 3)) * 2.0**30) / 2.0**30
    start[:, 2] = -(2.0**-5)
    ray = np.column_stack([rng.uniform(-spread, spread, (count, 2)), np.ones(count)])
    return Rays(start, ray)


def turned_about_z(rays, turn):
    """The same rays in a turned or mirrored frame."""
    return Rays(rays.position @ turn.T, rays.direction @ turn.T)


def same(one, other, map_back=None, tolerance=1e-10):  # the gap of a tilted plano pair is solved to 1e-11
    """Fates agree but for rays within rounding of an edge; directions of those that go on agree."""
    assert (one.fate == other.fate).mean() >= 0.95
    both = (one.fate == other.fate) & np.isin(one.fate, GOES_ON)
    both &= (one.order == other.order).all(axis=1) if map_back is None else both
    direction = other.direction if map_back is None else other.direction @ map_back.T
    if both.sum():
        apart = np.abs(one.direction - direction)[both].max(axis=1)
        assert (apart <= tolerance).mean() >= 0.95


@pytest.mark.slow
@given(designs(), st.integers(0, 10**6), st.sampled_from(["law", "thin", "surfaces"]))
@FINITE
def test_every_ray_has_one_fate_and_only_invalid_rows_hold_nan(data, seed, rung):
    rays = bundle(seed, spread=0.6)
    rays.position[0], rays.position[1] = np.nan, np.inf
    rays.direction[2:6] = [[0, 0, 0], [1, 0, 0], [0, 0, -1], [np.nan, 0, 1]]
    result = trace(window_of(data), rays, rung=rung)
    assert sum(result.counts().values()) == len(rays)
    good = result.fate != Fate.INVALID
    assert good.sum() == len(rays) - 4
    for column in (result.position, result.direction, result.optical_path, result.flux):
        assert np.isfinite(column[good]).all()
    lengths = np.linalg.norm(result.direction[np.isin(result.fate, GOES_ON)], axis=1)
    np.testing.assert_allclose(lengths, 1, rtol=0, atol=1e-13)


@pytest.mark.slow
@given(designs(tilted=False, form="biconvex"), st.integers(0, 10**6), st.sampled_from(["numpy", "numba"]))
@FINITE
def test_one_cell_does_what_any_of_forty_thousand_does(data, seed, path):
    """To the last bit of the direction: nothing is ever relative to the sheet."""
    data["lattice"]["kind"] = "square"
    rng = np.random.default_rng(seed)
    one = window_of({**data, "lattice": {**data["lattice"], "count": [1, 1]}})
    many = one.with_cells((200, 200))
    half = 2.0**-9
    start = np.round(rng.uniform(-half, half, (40, 3)) * 2.0**30) / 2.0**30
    start[:, 2] = -(2.0**-6)
    ray = np.column_stack([rng.uniform(-0.02, 0.02, (40, 2)), np.ones(40)])
    alone = trace(one, Rays(start, ray), path=path)
    # in a sheet light may come from a neighbouring cell, or go on into one: compare what stays in its cell
    inside = alone.fate == Fate.ALIVE
    cell = rng.integers(0, 200, (40, 2))
    centre = many.lattice.centres(cell)
    among = trace(many, Rays(start + np.column_stack([centre, np.zeros(40)]), ray), path=path)
    assert (among.fate[inside] == Fate.ALIVE).all()
    assert np.array_equal(among.cell[inside], cell[inside])
    assert np.array_equal(alone.direction[inside], among.direction[inside])
    assert np.array_equal(alone.optical_path[inside], among.optical_path[inside])


@pytest.mark.slow
@given(
    designs(),
    st.integers(0, 10**6),
    st.integers(-2, 2),
    st.integers(-2, 2),
    st.sampled_from(["thin", "surfaces"]),
)
@FINITE
def test_moving_the_light_by_cells_moves_the_answer_by_cells(data, seed, i, j, rung):
    data["lattice"]["kind"], data["lattice"]["count"] = "square", [64, 64]
    window, rays = window_of(data), bundle(seed)
    shift = np.array([i, j, 0.0]) * 2.0**-8
    one = trace(window, rays, rung=rung)
    other = trace(window, Rays(rays.position + shift, rays.direction), rung=rung)
    met = np.isin(one.fate, GOES_ON)
    assert np.array_equal(one.fate, other.fate)
    assert np.array_equal(one.cell[met] + [i, j], other.cell[met])
    assert np.array_equal(one.order[met], other.order[met])
    assert np.array_equal(one.direction, other.direction)


@pytest.mark.slow
@given(
    designs(),
    st.integers(0, 10**6),
    st.sampled_from([("mm", 1e-3), ("um", 1e-6), ("m", 2.0**20), ("m", 2.0**-10), ("m", 1e6)]),
)
@FINITE
def test_a_change_of_unit_or_scale_changes_nothing(data, seed, unit):
    name, size = unit
    factor = 1.0 / size if name != "m" else size
    window, rays = window_of(data), bundle(seed)
    scaled = {**data, "unit": name, "pair": {**data["pair"], "separation": 2.0**-4 * factor}}
    scaled["lattice"] = {**data["lattice"], "pitch": 2.0**-8 * factor}
    try:
        other = prescribe(Design.from_dict(scaled))
    except DesignError as error:
        assert "CL115" in str(error)  # a pitch that no light would see, or kilometres  # noqa: PT017
        return
    for rung in ("thin", "surfaces"):
        one = trace(window, rays, rung=rung)
        same(one, trace(other, Rays(rays.position * factor, rays.direction), rung=rung))


@pytest.mark.slow
@given(designs(), st.integers(0, 10**6))
@FINITE
def test_a_quarter_turn_of_everything_turns_the_answer(data, seed):
    data["lattice"]["kind"], data["lattice"]["count"] = "square", [4, 4]
    phi, theta, psi = data["law"]["euler"]
    turned = {**data, "law": {**data["law"], "euler": [phi, theta, psi + 90.0]}}
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rays = bundle(seed)
    for rung in ("law", "thin", "surfaces"):
        one = trace(window_of(data), rays, rung=rung)
        other = trace(window_of(turned), turned_about_z(rays, quarter), rung=rung)
        same(one, other, map_back=quarter.T)


@pytest.mark.slow
@given(designs(), st.integers(0, 10**6), st.sampled_from([0, 1]))
@FINITE
def test_the_mirrored_sheet_shows_the_mirrored_answer(data, seed, axis):
    data["lattice"]["kind"], data["lattice"]["count"] = "square", [4, 4]
    (dx, dy), (phi, theta, psi) = data["law"]["delta"], data["law"]["euler"]
    flipped = (
        {"delta": [-dx, dy], "euler": [-phi, theta, -psi]}
        if axis == 0
        else {"delta": [dx, -dy], "euler": [-phi, -theta, -psi]}
    )
    mirrored = {**data, "law": {**data["law"], **flipped}}
    mirror = np.diag([-1.0, 1.0, 1.0]) if axis == 0 else np.diag([1.0, -1.0, 1.0])
    rays = bundle(seed)
    for rung in ("law", "thin", "surfaces"):
        one = trace(window_of(data), rays, rung=rung)
        other = trace(window_of(mirrored), turned_about_z(rays, mirror), rung=rung)
        same(one, other, map_back=mirror)


@pytest.mark.slow
@given(st.floats(1.3, 2.0), st.integers(0, 10**6), st.sampled_from(["square", "hexagonal"]))
@FINITE
def test_light_sent_back_through_a_symmetric_sheet_comes_back(index, seed, kind):
    """η = -1 without offset or tilt is its own mirror image in z: the way back is the way there, mirrored."""
    data = {
        "format": 1, "name": "there and back", "unit": "m", "law": {"eta": [-1.0, -1.0]},
        "pair": {"form": "biconvex", "separation": 2.0**-4, "index": index},
        "lattice": {"kind": kind, "pitch": 2.0**-8, "count": [4, 4]},
    }  # fmt: skip
    window, rays = window_of(data), bundle(seed)
    there = trace(window, rays)
    going = np.isin(there.fate, (Fate.ALIVE, Fate.GHOST))
    assume(going.any())
    flip = np.diag([1.0, 1.0, -1.0])
    middle = np.array([0.0, 0.0, 2.0**-4])
    end = there.position[going] + 2.0**-5 * there.direction[going]
    back = trace(window, Rays(end @ flip + middle, -there.direction[going] @ flip))
    home = -back.direction @ flip
    arrived = back.fate == there.fate[going]
    assert arrived.mean() >= 0.95
    sent = rays.direction[going] / np.linalg.norm(rays.direction[going], axis=1)[:, None]
    np.testing.assert_allclose(home[arrived], sent[arrived], rtol=0, atol=1e-12)


@given(
    st.lists(etas, min_size=4, max_size=4),
    st.lists(small, min_size=4, max_size=4),
    st.floats(-10, 10),
    st.integers(0, 10**6),
)
@FINITE
def test_two_sheets_one_after_the_other_are_the_composed_sheet(eta, delta, theta, seed):
    turn = (0.3, radians(theta), -0.4)
    first, second = (
        Law(eta[0], eta[1], delta[0], delta[1], *turn),
        Law(eta[2], eta[3], delta[2], delta[3], *turn),
    )
    rays = bundle(seed)
    base = window_of({**ANY, "law": {"eta": [-1.0, -1.0]}})
    one, two = replace(base, law=first), replace(base, law=second)
    between = trace(one, rays, rung="law")
    on = between.fate == Fate.ALIVE
    start = between.position - 0.01 * between.direction
    after = trace(two, Rays(start[on], between.direction[on]), rung="law")
    both = first.then(second).refract(rays.direction[on])
    alive = after.fate == Fate.ALIVE
    np.testing.assert_allclose(after.direction[alive], both[alive], rtol=0, atol=1e-12)


ANY = {
    "format": 1, "name": "any", "unit": "m",
    "pair": {"form": "biconvex", "separation": 2.0**-4, "index": 1.5},
    "lattice": {"kind": "square", "pitch": 2.0**-8, "count": [8, 8]},
}  # fmt: skip


@pytest.mark.slow
@given(designs(), st.integers(0, 10**6), st.integers(0, 2), st.floats(0.0, 0.1))
@FINITE
def test_a_sheet_conserves_energy(data, seed, order, dark):
    """Light behind, before, inside walls and in the glass: the shares of every ray's paths sum to 1."""
    window, rays = window_of(data), bundle(seed, count=30)
    met = np.flatnonzero(trace(window, rays).fate < Fate.MISSED)
    assume(len(met))
    media = media_of(window.bodies)
    rules = Rules(walls=True, total=True, losses=True, order=order, media=media,
                  attenuation=tuple(dark / 2.0**-8 for _ in window.bodies))  # fmt: skip
    shares = trace_nonsequential(window, rays, met, rules).share
    assert np.abs(sum(shares.values())[met] - 1.0).max() <= 1e-12
    assert all((share[met] >= -1e-15).all() for share in shares.values())


@pytest.mark.slow
@given(designs(), st.integers(0, 10**6), st.sampled_from(["thin", "surfaces"]))
@FINITE
def test_a_sheet_conserves_etendue(data, seed, rung):
    """The map (x, y, L, M) before -> behind has determinant ±1 wherever the light goes on through one cell.

    Exact surfaces only: an ideal thin lens that images slopes t -> t - x/f conserves it in slopes, not in cosines.
    """
    data["lattice"]["count"] = [8, 8]
    window, rng, step = window_of(data), np.random.default_rng(seed), 1e-5
    x, y = rng.uniform(-0.01, 0.01, 2)
    p, q = rng.uniform(-0.03, 0.03, 2)
    upright = data["law"]["euler"][1] == 0.0
    assume(rung == "surfaces" or upright)
    sizes = np.array([1e-2, 1e-2, 1.0, 1.0])
    rows = np.concatenate([[x, y, p, q] + step * np.diag(sizes), [x, y, p, q] - step * np.diag(sizes)])

    def third(u, v):
        return np.sqrt(1 - u * u - v * v) if rung == "surfaces" else np.ones_like(u)

    rays = Rays(
        np.column_stack([rows[:, :2], np.full(8, -0.01)]),
        np.column_stack([rows[:, 2:], third(rows[:, 2], rows[:, 3])]),
    )
    out = trace(window, rays, rung=rung)
    assume(np.isin(out.fate, (Fate.ALIVE, Fate.GHOST)).all() and (out.order == out.order[0]).all())
    assume((out.cell == out.cell[0]).all())
    plane = out.position + ((0.1 - out.position[:, 2]) / out.direction[:, 2])[:, None] * out.direction
    momentum = out.direction[:, :2] if rung == "surfaces" else out.direction[:, :2] / out.direction[:, 2:]
    image = np.column_stack([plane[:, :2], momentum]) / sizes
    jacobian = (image[:4] - image[4:]) / (2 * step)
    size = np.prod(np.linalg.norm(jacobian, axis=0))
    assert abs(np.linalg.det(jacobian)) == pytest.approx(1, abs=1e-6 * max(1.0, size))


@pytest.mark.slow
@given(designs(form="biconvex", tilted=False))
@settings(FINITE, max_examples=3)
def test_facets_tend_to_the_surfaces_as_they_get_smaller(data):
    """Light through the very triangles, crossing found by trying them all, against the exact surfaces."""
    from clacad import tessellate

    data["lattice"] = {"kind": "square", "pitch": 2.0**-8, "count": [1, 1]}
    window = window_of(data)
    rng = np.random.default_rng(5)
    half = 2.0**-10
    start = np.column_stack([rng.uniform(-half, half, (30, 2)), np.full(30, -0.02)])
    ray = np.column_stack([rng.uniform(-0.01, 0.01, (30, 2)), np.ones(30)])
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    exact = trace(window, Rays(start, ray))
    on = exact.fate == Fate.ALIVE
    assume(on.sum() > 10)
    errors = []
    for quads in (8, 16, 32):
        mesh = tessellate(window, quads=quads)
        out = through_triangles(mesh.vertices[mesh.triangles], window, start[on], ray[on])
        assume(np.isfinite(out).all())
        errors.append(np.sqrt(((out - exact.direction[on]) ** 2).sum(axis=1).mean()))
    assert errors[2] < 0.7 * errors[1] < 0.7 * 0.7 * errors[0] or errors[2] < 1e-9


def through_triangles(corners, window, start, ray):
    """Directions behind all bodies, by trying every triangle at every step and textbook Snell at its plane."""
    position, direction = start.copy(), ray.copy()
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(edge1, edge2)
    keep = np.linalg.norm(normal, axis=1) > 0
    corners, edge1, edge2, normal = corners[keep], edge1[keep], edge2[keep], normal[keep]
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    for body in window.bodies:
        for n1, n2 in ((1.0, body.index), (body.index, 1.0)):
            for k in range(len(position)):
                p = np.cross(direction[k], edge2)
                det = (edge1 * p).sum(axis=1)
                with np.errstate(all="ignore"):
                    s = position[k] - corners[:, 0]
                    u = (s * p).sum(axis=1) / det
                    q = np.cross(s, edge1)
                    v = (q * direction[k]).sum(axis=1) / det
                    t = (edge2 * q).sum(axis=1) / det
                    hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > 1e-9)
                if not hit.any():
                    direction[k] = np.nan
                    continue
                first = np.flatnonzero(hit)[np.argmin(t[hit])]
                n = normal[first] * np.sign(normal[first] @ direction[k])
                cosine = n @ direction[k]
                under = 1 - (n1 / n2) ** 2 * (1 - cosine**2)
                position[k] = position[k] + t[first] * direction[k]
                direction[k] = n1 / n2 * direction[k] + (np.sqrt(max(under, 0.0)) - n1 / n2 * cosine) * n
    return direction


@pytest.mark.long
@pytest.mark.parametrize("seed", range(6))
def test_what_is_exported_passes_its_verification(tmp_path, seed):
    """Any valid small design: the written files are the part, regardless of its optical verdict."""
    from clacad import export, verify

    rng = np.random.default_rng(seed)
    for _ in range(20):
        eta = rng.choice([-1, 1], 2, p=[0.8, 0.2]) * rng.uniform(0.3, 0.9, 2)
        form = ["biconvex", "slab", "plano"][seed % 3]
        data = {
            "format": 1, "name": f"any-{seed}", "unit": "mm",
            "law": {"eta": eta.tolist(), "euler": [0.0, degrees(rng.uniform(0, 0.02)), 0.0]},
            "pair": {"form": form, "separation": 10.0, "index": float(rng.uniform(1.4, 1.7))},
            "lattice": {"kind": ["square", "hexagonal"][seed % 2], "pitch": 0.5, "count": [3, 2]},
        }  # fmt: skip
        try:
            design = Design.from_dict(data)
            prescribe(design)
            break
        except DesignError:
            continue
    export(design, tmp_path / "part", formats=("stl", "3mf", "ply"), quads=8)
    report = verify(design, tmp_path / "part")
    of_files = [c for c in report.checks if c.id.split(" ")[0] in FILE_CHECKS]
    assert of_files
    assert [(c.id, c.sentence) for c in of_files if c.state not in ("pass", "warn")] == []


FILE_CHECKS = {
    "closed",
    "volume",
    "shape",
    "integrity",
    "scale",
    "pose",
    "handedness",
    "faithful_rms",
    "accounting",
}
