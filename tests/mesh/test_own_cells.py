"""Meshes of non-uniform sheets: closed, cell by cell the lens of that cell, the same every time, a few rows at a time."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest

import clacad
from clacad.mesh import check_closed, tessellate
from clacad.mesh.body_mesh import facet_tags, first_triangles
from clacad.mesh.cell_template import BACK, FRONT
from clacad.mesh.land_ring import ring_about
from clacad.optics.surface import sag
from clacad.sheet.volume_and_extent import body_volume

AIMED = {
    "format": 1, "name": "aimed", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10, "material": "PMMA", "surface": "biconic", "conic": [-0.7, -0.7]},
    "lattice": {"pitch": 0.5, "count": [4, 3], "aperture": {"point": [-40, 10, -400]}},
}  # fmt: skip
THICK = {"form": "biconvex", "separation": 10, "index": 1.5, "thickness": 0.6}
THIN = {"form": "biconvex", "separation": 10, "index": 1.5, "thickness": 0.05, "web": 0.03}
TILTED = {"eta": [-1.0, -1.0], "euler": [30, 3, 10], "varying": {"gradient": [[-0.005, 0.0], [0.0, -0.005]]}}
VARYING = {"eta": [-1.0, -1.0], "varying": {"f_image": 200}}


def built(**changes):
    made = json.loads(json.dumps(AIMED))
    for key, value in changes.items():
        section, name = key.split("__") if "__" in key else (key, None)
        if name is None:
            made[section] = value
        elif value is None:
            made[section].pop(name)
        else:
            made.setdefault(section, {})[name] = value
    return clacad.prescribe(clacad.Design.from_dict(made))


SHEETS = {
    "slab": {},
    "paraxial": {"pair__offset": "paraxial"},
    "seen along the middle of an even sheet": {"lattice__aperture": {"point": [0, 0, -400]}, "lattice__count": [4, 4]},
    "seam": {"lattice__seam": 0.05},
    "border": {"body__border": 1.0},
    "disc": {"lattice__aperture": {"point": [0, 0, -400]}, "lattice__count": [8, 8], "lattice__outline": {"circle": 4.2}},
    "hexagonal": {"lattice__kind": "hexagonal"},
    "hexagonal disc": {"lattice__kind": "hexagonal", "lattice__count": [9, 9], "lattice__outline": {"circle": 4.5}},
    "columns": {"pair": THICK},
    "columns in a border": {"pair": {**THICK, "web": 0.2}, "body__border": 0.7},
    "plano": {"pair": {"form": "plano", "separation": 10, "index": 1.5}},
    "law that varies": {"law": VARYING, "lattice__aperture": None},
    "law that varies, hexagonal": {"law": VARYING, "lattice__aperture": None, "lattice__kind": "hexagonal"},
    "law that varies, toroids": {
        "law": {"eta": [-0.25, -0.5], "varying": {"f_image": [150, -300]}}, "lattice__aperture": None,
    },
    "law that varies, rims": {"law": VARYING, "lattice__aperture": None, "pair": THIN, "lattice__seam": 0.04},
    "law that varies, tilted": {"law": TILTED, "lattice__aperture": None, "body__border": 0.7},
    "law that varies, tilted, plano": {"law": TILTED, "lattice__aperture": None, "pair": {"form": "plano", "separation": 10, "index": 1.5}},
    "law that varies, disc": {
        "law": VARYING, "lattice__aperture": None, "lattice__count": [8, 8], "lattice__outline": {"circle": 3.0},
    },
    "other pitch": {"lattice__aperture": None, "lattice__pitch_2": 0.51},
    "other pitch, hexagonal": {"lattice__aperture": None, "lattice__pitch_2": 0.505, "lattice__kind": "hexagonal", "body__border": 1.0},
    "other pitch, columns": {"lattice__aperture": None, "lattice__pitch_2": 0.51, "pair": THICK},
    "turned": {"lattice__aperture": None, "lattice__rotation_2": "4 deg"},
    "turned, of other pitch, hexagonal": {"lattice__aperture": None, "lattice__pitch_2": 0.505, "lattice__kind": "hexagonal", "lattice__rotation_2": "-20 deg"},
    "turned, in a border with a seam": {"lattice__aperture": None, "lattice__rotation_2": "30 deg", "lattice__seam": 0.05, "body__border": 0.5},
    "turned, disc": {"lattice__aperture": None, "lattice__rotation_2": "11 deg", "lattice__count": [8, 8], "lattice__outline": {"circle": 4.2}},
    "turned, rectangle": {"lattice__aperture": None, "lattice__rotation_2": "7 deg", "lattice__count": [9, 9], "lattice__outline": {"rectangle": [4, 3]}},
    "turned, columns": {"lattice__aperture": None, "lattice__rotation_2": "40 deg", "pair": THICK},
    "turned, plano": {"lattice__aperture": None, "lattice__rotation_2": "9 deg", "pair": {"form": "plano", "separation": 10, "index": 1.5}},
}  # fmt: skip
EVERY_TIME = ("slab", "law that varies, rims", "law that varies, hexagonal")


def cases():
    return [
        pytest.param(changes, id=name, marks=() if name in EVERY_TIME else pytest.mark.slow)
        for name, changes in SHEETS.items()
    ]


@pytest.mark.ci_cases(
    "hexagonal disc",
    "columns in a border",
    "law that varies, toroids",
    "law that varies, tilted, plano",
    "turned, of other pitch, hexagonal",
    "turned, in a border with a seam",
)
@pytest.mark.daily_cases("slab")
@pytest.mark.parametrize("changes", cases())
def test_bodies_of_cells_that_differ_are_closed_and_enclose_what_the_faces_do(changes):
    window = built(**changes)
    coarse, fine = (tessellate(window, quads=q) for q in (5, 10))
    for some, many, body in zip(coarse.bodies, fine.bodies, window.bodies, strict=True):
        health = check_closed(
            lambda some=some: (rows.astype(np.float32) for rows in some.rows()), pieces=True
        )
        assert health.closed
        assert health.four_face_edges == health.degenerate == 0
        assert len(some.triangles) == some.facet_count == sum(len(rows) for rows in some.rows())
        exact = body_volume(window, body)
        chords = [abs(mesh.volume() - exact.value) for mesh in (some, many)]
        assert chords[0] < 0.03 * exact.value
        assert (
            chords[1] < 0.36 * chords[0] + 3.0 * exact.error
        )  # the error of chords falls as the square of their length


def test_the_volume_of_many_cells_is_that_of_their_paraboloids():
    """Over a square of side p about its centre, c ((x − m)² + (y − n)²) / 2 has the mean c (p²/6 + m² + n²) / 2."""
    window = built(pair={**AIMED["pair"], "conic": [-1.0, -1.0]}, lattice__count=[31, 20])
    (body,) = window.bodies
    cells = window.lattice.cells()
    exact = 0.0
    for face, sign in ((body.front, -1.0), (body.back, 1.0)):
        at = window.vertices(face, cells)
        c, (p, q) = face.side * face.surface.curvature_x, window.lattice_of(face.array).pitch
        mean = (p * p + q * q) / 12.0 + (at[:, :2] ** 2).sum(axis=1)
        exact += sign * p * q * float((at[:, 2] + 0.5 * c * mean).sum())
        exact += sign * face.land * (window.outline.width * window.outline.height - len(cells) * p * q)
    found = body_volume(window, body)
    assert found.value == pytest.approx(exact, rel=1e-13)
    assert found.error < 1e-12 * exact


def test_the_volume_of_many_cells_is_the_sum_of_each(monkeypatch):
    window = built(lattice__count=[31, 20])
    (body,) = window.bodies
    found = body_volume(window, body)
    monkeypatch.setattr("clacad.sheet.cell_heights.DEGREES", ())
    each = body_volume(window, body)
    assert found.value == pytest.approx(each.value, abs=found.error + each.error)


def test_columns_whose_faces_meet_inside_a_cell_have_no_volume_in_closed_form():
    window = built(pair={**THIN, "offset": "paraxial"}, lattice__seam=0.04)
    assert [body_volume(window, body) is None for body in window.bodies] == [False, True]


def test_every_corner_of_a_lens_lies_on_the_quadric_of_its_own_cell_where_that_stands():
    """Sheet coordinates and the closed form of the sag alone."""
    window = built()
    (body,) = window.bodies
    (mesh,) = tessellate(window, quads=6).bodies
    g = window.placements[1].pitch[0] / 0.5
    shift = np.array(window.placements[1].shift)
    seen = {FRONT: 0, BACK: 0}
    for corners, (kinds, cells) in zip(mesh.rows(), facet_tags(mesh), strict=True):
        for kind, face in ((FRONT, body.front), (BACK, body.back)):
            mine = kinds == kind
            if not mine.any():
                continue
            c1 = (cells[mine] - (np.array([4, 3]) - 1) / 2) * 0.5
            if kind == FRONT:
                apex = c1
            else:
                table = face.change.table[cells[mine][:, 0], cells[mine][:, 1]]
                apex = g * c1 + shift + np.array(face.vertex[:2]) + (1.0 - g) * c1 + table
            at = corners[mine]
            x, y = at[..., 0] - apex[:, None, 0], at[..., 1] - apex[:, None, 1]
            z = face.vertex[2] + sag(face.surface, x, y)
            z = np.minimum(z, face.land) if kind == FRONT else np.maximum(z, face.land)
            assert np.abs(at[..., 2] - z).max() < 6.0 * mesh.step  # merged levels move by half a gap of four
            seen[kind] += len(at)
    assert seen[FRONT] == 12 * 2 * 36
    assert seen[BACK] >= 12 * 2 * 36


def test_the_mesh_of_cells_that_differ_is_the_same_every_time_and_in_any_order():
    def digest(mesh):
        return [
            hashlib.sha256(b"".join(rows.tobytes() for rows in body.rows())).hexdigest()
            for body in mesh.bodies
        ]

    window = built(lattice__kind="hexagonal")
    first, second = tessellate(window, quads=4), tessellate(built(lattice__kind="hexagonal"), quads=4)
    second.bodies[0].tiled[-1].own.rare.at(
        tuple(window.lattice.cells()[-1].tolist())
    )  # another cell is made first
    assert digest(first) == digest(second) == digest(first)
    assert abs(first.bodies[0].facets_about / first.bodies[0].facet_count - 1.0) < 0.1


@pytest.mark.parametrize("name", ["disc", "hexagonal disc", "border", "columns in a border"])
def test_the_triangles_of_a_sheet_are_forecast_without_its_land(name):
    body = next(one for one in tessellate(built(**SHEETS[name]), quads=4).bodies if one.own)
    made = []
    lazy = replace(body, ring=lambda: made.append(1) or body.ring())
    about = lazy.facets_about
    assert not made
    assert ring_about(body.window, body.tiled) == len(body.ring().triangles) > 0
    assert abs(about / body.facet_count - 1.0) < 0.1
    first = first_triangles(body, 500)
    assert first.shape == (500, 3, 3)
    assert np.array_equal(first, np.concatenate(list(body.rows()))[:500])


@pytest.mark.slow
def test_the_mesh_of_equal_cells_made_cell_by_cell_is_that_of_one_cell_repeated():
    """A change that changes nothing: every cell is made by itself, and all come out alike."""
    from dataclasses import replace

    from clacad.sheet.cell_places import VertexChange

    plain = built(lattice__aperture="aligned", law={"eta": [-1.0, -0.7], "delta": [0.01, 0.0]})
    (body,) = plain.bodies
    still = replace(body, back=replace(body.back, change=VertexChange()))
    own = replace(plain, bodies=(still,))
    one, each = (tessellate(window, quads=5).bodies[0] for window in (plain, own))
    assert each.own
    assert not one.own

    def sorted_corners(mesh):
        rows = np.concatenate(list(mesh.rows())).reshape(-1, 9)
        return rows[np.lexsort(rows.T)]

    assert np.abs(sorted_corners(one) - sorted_corners(each)).max() <= 2.0 * one.step
    assert each.volume() == pytest.approx(one.volume(), rel=1e-12)


def test_bevels_at_saddles_are_refused_where_cells_differ():
    from clacad.sheet.need_window import CellsDiffer

    with pytest.raises(CellsDiffer, match="CL139.*bevel"):
        tessellate(built(), quads=4, saddle_bevel=0.01)


@pytest.mark.daily_cases("columns in a border")
@pytest.mark.parametrize(
    "name", ["slab", "law that varies, hexagonal", "law that varies, tilted", "columns in a border"]
)
def test_cells_made_in_a_batch_are_those_cut_one_by_one(name, monkeypatch):
    from clacad.mesh.cell_batch import OwnMeshCells

    many = [np.concatenate(list(body.rows())) for body in tessellate(built(**SHEETS[name]), quads=4).bodies]
    batch = OwnMeshCells.batch
    kept = []

    def without_regular(self, cells):
        made = batch(self, cells)
        kept.append(made.regular.copy())
        made.regular[:] = False
        return made

    monkeypatch.setattr(OwnMeshCells, "batch", without_regular)
    single = [np.concatenate(list(body.rows())) for body in tessellate(built(**SHEETS[name]), quads=4).bodies]
    assert np.concatenate(kept).mean() > 0.4
    assert all(np.array_equal(a, b) for a, b in zip(many, single, strict=True))
