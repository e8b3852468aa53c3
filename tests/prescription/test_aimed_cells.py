"""Sheets aimed at a point: positions of cells and vertices, refusals, and the view of an eye there."""

import json
from dataclasses import replace
from math import sqrt
from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.base.sobol import sobol
from clacad.design import DesignError
from clacad.optics.rays import Fate
from clacad.optics.surface import Biconic
from clacad.sheet.cell_places import VertexChange
from clacad.sheet.vignetting import partner_share, share, thin_cells
from clacad.verification.light.viewed import viewed

DATA = Path(__file__).parent.parent / "data"
WINDOW = clacad.load("designs/window-100mm.toml")
AIMED = {
    "lattice.outline": {"circle": 100}, "check.process": "none", "pair.surface": "biconic", "pair.conic": [-0.7, -0.7],
    "lattice.aperture": {"point": [0, 0, -400]},
}  # fmt: skip


def golden(name):
    return json.loads((DATA / f"{name}.json").read_text(encoding="utf-8"))


def pair(text):
    return np.array([float(v) for v in text])


def thin_places(window, index):
    """Centre of cell 2 and vertex 2 in it, thin, sheet frame."""
    thin = window.thin
    own = replace(window.lattice, pitch=thin.pitch, outline=None)
    centre = own.centres(index) + thin.shift
    return centre, np.array(thin.offset[:2]) - thin.shift + thin.change.at(window.lattice, index)


@pytest.mark.parametrize(
    "case", golden("aperture_point")["cases"], ids=lambda c: f"z={c['point'][2]} s={c['separation']}"
)
def test_partner_centres_vertices_and_shares_for_a_viewer(case):
    s, p, c1 = float(case["separation"]), float(case["pitch"]), pair(case["cell_centre_1"])
    half = int(max(abs(c1)) / p) + 1
    size = 2 * half + int(round((c1[0] / p) % 1.0 * 2) == 0)
    made = {
        "format": 1, "name": "golden", "unit": "mm", "law": {"eta": [float(e) for e in case["eta"]]},
        "pair": {"form": "biconvex", "separation": s, "thickness": 0.1 * s, "index": 1.5, "offset": "paraxial"},
        "lattice": {"pitch": p, "count": size, "aperture": {"point": [float(v) for v in case["point"]]}},
    }  # fmt: skip
    window = clacad.prescribe(clacad.Design.from_dict(made))
    index, _, _ = window.lattice.locate(c1[:1], c1[1:])
    assert np.abs(window.lattice.centres(index)[0] - c1).max() < 1e-12
    c2, vertex = thin_places(window, index)
    assert np.abs(c2[0] - pair(case["cell_centre_2"])).max() < 1e-12
    assert window.thin.pitch[0] == pytest.approx(float(case["pitch_2"]), abs=1e-15)
    assert np.abs(vertex[0] - pair(case["vertex_2_in_its_cell"])).max() < 1e-12
    slope = np.append(pair(case["slope"]), 1.0)[None]
    assert partner_share(window, index, slope)[0] == pytest.approx(float(case["share_point"]), abs=1e-12)
    still = clacad.prescribe(
        clacad.Design.from_dict({**made, "lattice": {"pitch": p, "count": 3, "aperture": "aligned"}})
    )
    assert share(thin_cells(still), slope)[0] == pytest.approx(float(case["share_aligned"]), abs=1e-12)


@pytest.mark.parametrize("wall", [0.0, 0.06])
def test_the_walls_of_a_baffle_narrow_both_cells_of_aimed_pairs(wall):
    """Light aside from the viewer, by ideal lenses with and without walls: what the walls stop is in no share."""
    baffle = ["body.baffle = true", f"body.baffle_wall = {wall}"] if wall else []
    aim = "lattice.aperture = {point = [0, 0, -100]}"
    window = clacad.prescribe(clacad.load("biconvex", ["lattice.count = [9, 9]", aim, *baffle]))
    assert window.thin.second.own
    cell, slope = np.array([[8, 4]]), np.array([0.02, 0.0, 1.0])
    slope[:2] += window.lattice.centres(cell)[0] / 100.0
    spots = (sobol(1 << 14, 2) - 0.5) * window.lattice.pitch[0] + window.lattice.centres(cell)
    start = np.column_stack([spots, np.zeros(len(spots))]) - slope
    light = clacad.Rays(start, np.broadcast_to(slope, start.shape))
    seen = clacad.trace(window, light, rung="thin")
    wanted = (seen.fate == Fate.ALIVE) & (seen.order == 0).all(axis=1)
    assert partner_share(window, cell, slope[None])[0] == pytest.approx(wanted.mean(), abs=5e-3)


@pytest.mark.parametrize("case", golden("snell_slab")["cases"], ids=lambda c: f"X={c['vertex_1'][0]}")
def test_hits_and_directions_through_decentred_slab_cells(case):
    """Cells of one pitch, vertices of array 2 at X (1 + κ f1): the affine part alone."""
    eta, s, n = float(case["eta"]), float(case["separation"]), float(case["index"])
    made = {
        "format": 1, "name": "golden", "unit": "mm", "law": {"eta": [eta, eta]},
        "pair": {"form": "slab", "separation": s, "index": n, "surface": "biconic", "conic": [float(case["conic"])] * 2},
        "lattice": {"pitch": 0.5, "count": 121},
    }  # fmt: skip
    window = clacad.prescribe(clacad.Design.from_dict(made))
    body = window.bodies[0]
    faces = []
    for face, radius in zip((body.front, body.back), pair(case["radius"]), strict=True):
        k, side = float(case["conic"]), face.side
        faces.append(replace(face, surface=Biconic(1 / radius, 1 / radius, k, k, side)))
    pull = float(case["kappa"]) * s / (1.0 - eta)
    faces[1] = replace(
        faces[1],
        vertex=(0.0, 0.0, float(case["vertex_2"][2])),
        change=VertexChange(((pull, 0.0), (0.0, pull))),
    )
    window = replace(window, bodies=(replace(body, front=faces[0], back=faces[1]),))
    direction = pair(case["direction_in"])
    start = pair(case["plane_point"]) - 3.0 * direction / direction[2]
    found = clacad.trace(window, clacad.Rays(start, direction), record=True)
    assert found.fate[0] == Fate.ALIVE
    for k in (0, 1):
        assert np.abs(found.hits[k, 0] - pair(case[f"hit_{k + 1}"])).max() < 2e-14 * 25
    assert np.abs(found.direction[0] - pair(case["direction_out"])).max() < 1e-14


def own_trace(window, cells, points, viewer):
    """Light of a viewer through a slab of conic lenses, plain numpy in sheet coordinates; directions and hits on array 2."""
    front, back = window.bodies[0].front, window.bodies[0].back
    c1 = window.centres(0, cells)
    v2 = np.column_stack([window.centres(1, cells), np.zeros(len(cells))]) + window.vertices(back, cells)
    c, k = front.surface.curvature_x, front.surface.conic_x
    n = window.bodies[0].index
    at = np.column_stack([c1 + points, np.zeros(len(cells))])
    ray = at - viewer
    ray /= np.linalg.norm(ray, axis=1)[:, None]

    def through(at, ray, vertex, side, before, after):
        p = at - vertex
        for _ in range(60):  # Newton on z = sag(x, y)
            r2 = p[:, 0] ** 2 + p[:, 1] ** 2
            root = np.sqrt(1 - (1 + k) * c * c * r2)
            gap = p[:, 2] - side * c * r2 / (1 + root)
            normal = np.column_stack(
                [-side * c * p[:, 0] / root, -side * c * p[:, 1] / root, np.ones(len(p))]
            )
            p = p - (gap / (ray * normal).sum(axis=1))[:, None] * ray
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        mu = before / after
        along = (ray * normal).sum(axis=1)
        out = mu * ray + (np.sqrt(1 - mu * mu * (1 - along**2)) - mu * along)[:, None] * normal
        return p + vertex, out

    v1 = np.column_stack([c1, np.zeros(len(c1))])
    at, ray = through(at, ray, v1, 1, 1.0, n)
    return through(at, ray, v2, -1, n, 1.0)


@pytest.mark.slow
def test_the_window_from_400_mm_before_and_after_aiming():
    viewer = (0.0, 0.0, -400.0)
    before = viewed(clacad.prescribe(WINDOW), viewer)
    assert before.thin == pytest.approx(0.04, abs=0.001)
    assert before.traced == pytest.approx(0.04, abs=0.005)
    design = WINDOW.replace(AIMED)
    window = clacad.prescribe(design)
    after = viewed(window, viewer)
    assert after.thin == pytest.approx(1.0, abs=1e-9)
    assert after.traced >= 0.95
    # the same by a tracer of the test's own, over the outermost cells
    cells = window.lattice.cells()
    centres = window.lattice.centres(cells)
    outer = cells[np.argsort(-np.hypot(*centres.T), kind="stable")[:8]]
    rng = np.random.default_rng(2)
    for cell in outer:
        many = np.repeat(cell[None], 2000, axis=0)
        at, out = own_trace(window, many, rng.uniform(-0.25, 0.25, (2000, 2)), np.array(viewer))
        inside = np.abs(at[:, :2] - window.centres(1, cell)).max(axis=1) < 0.5 * window.placements[1].pitch[0]
        assert inside.mean() >= 0.95
        slope = window.lattice.centres(cell) / 400.0
        asked = np.array([-slope[0], -slope[1], 1.0]) / sqrt(1.0 + slope @ slope)
        mean = out.mean(axis=0)
        assert np.linalg.norm(mean / np.linalg.norm(mean) - asked) < 5e-5  # 2000 random points replace 256
        spread = np.sqrt((np.linalg.norm(out[inside] - mean, axis=1) ** 2).mean())
        assert spread <= 0.75e-3


@pytest.mark.slow
def test_traced_vertices_send_the_mean_of_each_cells_light_where_the_law_asks():
    from clacad.prescription.traced_vertices import RAYS, _cell_points

    window = clacad.prescribe(WINDOW.replace(AIMED))
    points = _cell_points(window, copies=4)  # the sheet is aimed from its axis
    assert len(points) == 4 * RAYS
    turned = points @ [[0.0, 1.0], [-1.0, 0.0]]
    assert {tuple(p) for p in points.round(12) + 0.0} == {tuple(p) for p in turned.round(12) + 0.0}
    for cell in window.lattice.cells()[:: window.lattice.cell_count // 7]:
        slope = window.lattice.centres(cell) / 400.0
        # parallel light of the slope of the field centre: an eye infinitely far away in that direction
        far = np.append(window.lattice.centres(cell) - 1e9 * slope, -1e9)
        _, out = own_trace(window, np.repeat(cell[None], len(points), axis=0), points, far)
        asked = np.array([-slope[0], -slope[1], 1.0]) / sqrt(1.0 + slope @ slope)
        mean = out.mean(axis=0)
        assert np.linalg.norm(mean / np.linalg.norm(mean) - asked) < 2e-7


VARYING = {
    "a glens": ({"f_image": 150.0}, lambda c, s: -1.0 / 150.0 * c),
    "two planes": ({"conjugates": {"object": -300.0, "image": 200.0}}, lambda c, s: (-1.0 - (-300.0 - s) / 200.0) / -300.0 * c),
    "a gradient with a curl": ({"gradient": [[0.001, 0.004], [-0.003, 0.002]]}, lambda c, s: c @ [[0.001, -0.003], [0.004, 0.002]]),
}  # fmt: skip
"""law.varying, and delta of a cell with its centre at c (n, 2), by hand: eta c/f; (eta (z - s)/zeta - 1)/z c; K c."""
GLENS = {
    "format": 1, "name": "glens", "unit": "mm", "law": {"eta": [-1.0, -1.0]}, "check": {"process": "none"},
    "pair": {"form": "slab", "separation": 10, "index": 1.49, "surface": "biconic"},
    "lattice": {"pitch": 0.5, "count": [14, 13], "aperture": {"point": [4.0, -3.0, -250.0]}},
}  # fmt: skip
VIEWER = np.array([4.0, -3.0, -250.0])


def mean_directions(window, cells, viewer=VIEWER):
    """Mean exit directions of parallel light of the viewer's slope through the middle of each cell, own tracer; those slopes."""
    quarter = window.lattice.over_cell(sobol(64, 2))
    points = np.concatenate([quarter * signs for signs in ((1, 1), (-1, 1), (1, -1), (-1, -1))])
    slopes, means = (window.lattice.centres(cells) - viewer[:2]) / -viewer[2], []
    for cell, slope in zip(cells, slopes, strict=True):
        far = np.append(window.lattice.centres(cell) - 1e9 * slope, -1e9)
        _, out = own_trace(window, np.repeat(cell[None], len(points), axis=0), points, far)
        means.append(out.mean(axis=0) / np.linalg.norm(out.mean(axis=0)))
    return np.array(means), slopes


@pytest.mark.daily_cases("a gradient with a curl")
@pytest.mark.parametrize("name", VARYING)
def test_light_of_the_eye_leaves_every_cell_of_an_aimed_sheet_by_the_law_of_that_cell(name):
    varying, delta = VARYING[name]
    made = clacad.Design.from_dict({**GLENS, "law": {"eta": [-1.0, -1.0], "varying": varying}})
    window = clacad.prescribe(made)
    cells = window.lattice.cells()[::13]
    means, slopes = mean_directions(window, cells)
    out = (slopes - delta(window.lattice.centres(cells), 10.0)) / -1.0
    asked = np.column_stack([out, np.ones(len(out))]) / np.sqrt(1.0 + (out**2).sum(axis=1))[:, None]
    assert np.abs(means - asked).max() < 2e-7  # an eye at 1e9 mm, where parallel light is meant
    assert np.abs(asked[:, :2] + slopes).max() > 3e-3  # the law of the middle cell would be far off
    seen = viewed(window, tuple(VIEWER), 1024)
    assert seen.thin == pytest.approx(1.0, abs=1e-9)
    assert seen.traced > 0.97
    aligned = clacad.prescribe(made.replace("lattice.aperture", "aligned"))
    assert viewed(aligned, tuple(VIEWER), 1024).traced < seen.traced - 0.1


@pytest.mark.slow
def test_a_rough_table_is_aimed_cell_by_cell_with_every_size_of_lens(tmp_path, monkeypatch):
    from clacad.prescription import traced_vertices

    rng = np.random.default_rng(4)
    delta, eta = rng.uniform(-0.03, 0.03, (14, 13, 2)), rng.uniform(-1.1, -0.9, (14, 13))
    rows = [
        f"{i},{j},{delta[i, j, 0]!r},{delta[i, j, 1]!r},{eta[i, j]!r}" for i in range(14) for j in range(13)
    ]
    (tmp_path / "cells.csv").write_text(
        "i,j,delta_x,delta_y,eta\n" + "\n".join(rows).replace("np.float64(", "").replace(")", "")
    )
    text = clacad.Design.from_dict(GLENS).canonical_toml()
    (tmp_path / "d.toml").write_text(text.replace("[law]\n", '[law]\nvarying = {table = "cells.csv"}\n'))
    made = clacad.load(tmp_path / "d.toml")
    window = clacad.prescribe(made)
    assert window.many_sizes
    seen = viewed(window, tuple(VIEWER), 1024)
    assert seen.thin > 0.98  # eta < -1 spreads the light of a cell beyond its partner
    assert seen.traced > 0.95
    cells = window.lattice.cells()[::9]
    slopes = (window.lattice.centres(cells) - VIEWER[:2]) / 250.0
    at, ray = window.lattice.centres(cells), np.column_stack([slopes, np.ones(len(cells))])
    middle = clacad.trace(
        window, clacad.Rays(np.column_stack([at, 0.0 * at[:, 0]]) - 2 * ray, ray), path="numpy"
    )
    each = delta[cells[:, 0], cells[:, 1]]
    out = (slopes - each) / eta[cells[:, 0], cells[:, 1], None]
    assert np.abs(middle.direction[:, :2] / middle.direction[:, 2:] - out).max() < 2e-3
    monkeypatch.setattr(traced_vertices, "OWN_DIRECT", 10)
    monkeypatch.setattr(traced_vertices, "WIDE_LADDER", ((60, 2),))
    other = clacad.prescribe(made)
    a, b = (one.vertices(one.faces[1], one.lattice.cells()) for one in (window, other))
    assert np.abs(a - b).max() < 1e-11


REFUSED = {
    "a square sheet, whose corners are too far out": (
        {"lattice.aperture": {"point": [0, 0, -400]}, "check.process": "none", "pair.surface": "biconic", "pair.conic": [-0.7, -0.7]},
        ("CL123", "cell (0, 0)", "0.78", "viewer at z = -5"),
    ),
    "a viewer within ten separations": ({**AIMED, "lattice.aperture": {"point": [0, 0, -99]}}, ("CL122", "-100")),
    "a point in the sheet": ({**AIMED, "lattice.aperture": {"point": [0, 0, 0]}}, ("CL122",)),
    "a pitch of array 2 as well": ({**AIMED, "lattice.pitch_2": 0.501}, ("CL125", "where the cells of array 2 lie")),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_aimed_is_refused_by_one_code_and_a_way_out(name):
    changes, words = REFUSED[name]
    with pytest.raises(DesignError) as refused:
        clacad.prescribe(WINDOW.replace(changes))
    text = str(refused.value)
    assert len(refused.value.mistakes) == 1
    assert all(word in text for word in words), text
    assert "hint" in text


def test_the_distance_that_a_refusal_names_works():
    changes = {**AIMED, "lattice.outline": {"rectangle": [100, 100]}}
    with pytest.raises(DesignError) as refused:
        clacad.prescribe(WINDOW.replace(changes))
    z = float(str(refused.value).split("z = ")[1].split(",")[0])
    window = clacad.prescribe(
        WINDOW.replace({**changes, "lattice.aperture": {"point": [0, 0, z]}, "pair.offset": "paraxial"})
    )
    assert not window.uniform


@pytest.mark.parametrize("form", ["slab", "plano", "biconvex"])
@pytest.mark.parametrize("kind", ["square", "rectangular", "hexagonal"])
def test_every_form_and_lattice_can_be_aimed_and_an_eye_there_sees_the_law(form, kind):
    made = {
        "format": 1, "name": "aimed", "unit": "mm", "law": {"eta": [-1.0, -0.8], "delta": [0.01, -0.005]},
        "pair": {"form": form, "separation": 10, "material": "PMMA"} | ({} if form == "slab" else {"thickness": 1.5}),
        "lattice": {"kind": kind, "pitch": [0.5, 0.4] if kind == "rectangular" else 0.5, "count": 12,
                    "aperture": {"point": [-20, 10, -500]}},
    }  # fmt: skip
    design = clacad.Design.from_dict(made)
    window = clacad.prescribe(design)
    assert not window.uniform
    seen = viewed(window, (-20.0, 10.0, -500.0), 2048)
    assert seen.thin == pytest.approx(1.0, abs=1e-9)
    assert seen.traced > (
        0.9 if form == "biconvex" else 0.95
    )  # a thick lens sets its light off by part of its thickness
    assert (
        viewed(
            clacad.prescribe(design.replace("lattice.aperture", "aligned")), (-20.0, 10.0, -500.0), 2048
        ).traced
        < 0.6
    )
    assert clacad.Design.from_dict(design.to_dict()).sha256 == design.sha256


def test_the_light_of_the_outermost_cell_of_a_slab_lands_in_the_middle_of_its_partner():
    """Snell's law at lens 1's vertex, which is level there: straight on in air is a tenth of the pitch off."""
    window = clacad.prescribe(
        clacad.Design.from_dict(
            {
                "format": 1, "name": "aimed", "unit": "mm", "law": {"eta": [-1, -1]}, "check": {"process": "none"},
                "pair": {"form": "slab", "separation": 10, "index": 1.5, "offset": "paraxial"},
                "lattice": {"pitch": 0.5, "count": [101, 101], "aperture": {"point": [0, 0, -400]}},
            }
        )
    )  # fmt: skip
    thick = window.bodies[0].back.vertex[2] - window.bodies[0].front.vertex[2]
    cells = window.lattice.cells()
    one, two = window.centres(0, cells), window.centres(1, cells)
    slope = one / 400.0
    steep = np.hypot(*slope.T)
    inside = steep / np.sqrt(1.0 + steep**2) / 1.5
    landed = (
        one + slope * (thick * inside / np.sqrt(1.0 - inside**2) / np.where(steep > 0.0, steep, 1.0))[:, None]
    )
    off = np.hypot(*(landed - two).T)
    outer = np.flatnonzero(steep == steep.max())
    assert off[outer].max() < 1e-12
    assert 1e-5 < off.max() < 0.01 * 0.5


def test_keys_at_their_defaults_leave_no_trace_in_the_text():
    text = WINDOW.canonical_toml()
    assert "offset" not in text
    assert "point" not in text
    aimed = WINDOW.replace(AIMED)
    assert "point = [0" in aimed.canonical_toml()
    assert aimed.sha256 != WINDOW.sha256


def test_a_sheet_of_equal_cells_may_have_its_one_vertex_traced():
    design = WINDOW.replace({"lattice.aperture": [0.05, 0.0], "lattice.count": [5, 5]})
    plain, traced = (clacad.prescribe(design.replace("pair.offset", word)) for word in ("paraxial", "traced"))
    assert plain.uniform
    assert traced.uniform
    moved = np.subtract(traced.bodies[0].back.vertex, plain.bodies[0].back.vertex)
    assert abs(moved[0]) == pytest.approx(0.011, abs=0.001)  # measured by another tracer, K = 0
    assert abs(moved[1]) < 1e-9
