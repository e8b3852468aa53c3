"""The mesh: closed in every form, of the size of the design, and within the errors that it states."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import manifold3d
import numpy as np
import pytest
import trimesh
from meshwindows import FORMS, pieces_and_holes, window
from often import often
from polar_volume import exact_volume

import clacad
from clacad.mesh import (
    check_closed,
    forecast_quads,
    mesh_body,
    tessellate,
)
from clacad.mesh.body_mesh import facet_tags
from clacad.mesh.cell_template import BACK, FRONT, WALL
from clacad.mesh.tessellation import shaded_rows
from clacad.optics.surface import Quadric
from clacad.sheet.window import column, lens_height
from clacad.topology.build_complex import cell_complex, saddle_count


def as_file(body):
    """Corners (n, 3, 3) after a float32 file."""
    return np.concatenate(list(body.rows())).astype(np.float32)


def welded(corners):
    """A trimesh whose equal vertices are merged and nothing else is changed."""
    vertices, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return trimesh.Trimesh(vertices.astype(np.float64), number.reshape(-1, 3), process=False)


# -- closed, in every form ------------------------------------------------------------------------------


@pytest.mark.ci_cases(
    "loose cells that touch",
    "tilted about both axes, offset",
    "saddle at every corner",
    "plano, curved inside",
    "slab, displaced in x and y",
    "biconvex, seam",
    "hexagonal slab",
    "round outline, hexagons",
    "border and web",
)
@pytest.mark.daily_cases("slab, seam", "outline that fits two sides", "cylinders")
@pytest.mark.parametrize("name", FORMS)
def test_every_form_is_closed_also_after_a_float32_file(name):
    sheet = window(**FORMS[name])
    for body in tessellate(sheet, quads=5).bodies:
        corners = as_file(body)
        health = check_closed(corners)
        assert health.closed, health
        assert health.outward
        read = welded(corners)
        assert read.is_watertight
        assert read.is_winding_consistent
        assert (read.area_faces > 0.0).all()
        assert len(corners) == body.facet_count


@pytest.mark.parametrize("metres", [1.0, 1e-3, 0.1])
def test_a_mesh_becomes_one_of_trimesh_with_its_vertices_unit_and_volume(metres):
    sheet = replace(window(**FORMS["slab, seam"]), unit=metres)
    mesh = tessellate(sheet, quads=5)
    for given, bodies in ((mesh, mesh.bodies), (mesh.bodies[0], mesh.bodies[:1])):
        made = clacad.to_trimesh(given)
        assert made.is_watertight == check_closed((given.vertices, given.triangles)).closed
        np.testing.assert_array_equal(made.vertices, given.vertices)
        np.testing.assert_array_equal(made.faces, given.triangles)
        corners = np.concatenate([rows for body in bodies for rows in body.rows()])
        a, b, c = np.moveaxis(corners, 1, 0)  # signed tetrahedra over the streamed facets: another route
        assert made.volume == pytest.approx((a * np.cross(b, c)).sum() / 6.0, rel=1e-11)
        made.convert_units("m")
        np.testing.assert_allclose(made.vertices, given.vertices * metres, rtol=1e-14)
    made.vertices[:] = 0.0
    assert np.ptp(given.vertices) > 0.0


@pytest.mark.daily_cases("strips")
@pytest.mark.parametrize("name", often(FORMS, "strips", "pinholes", "loose cells that touch", "saddle at every corner",
                                      "tilted web, rims in the cell", "plano"))  # fmt: skip
def test_pieces_holes_and_volume_are_those_of_another_kernel(name):
    sheet = window(**FORMS[name])
    for body in tessellate(sheet, quads=5).bodies:
        cells = cell_complex(sheet, body.body, merge=4 * body.step)
        solid = manifold3d.Manifold(
            manifold3d.Mesh64(
                vert_properties=np.ascontiguousarray(body.vertices),
                tri_verts=body.triangles.astype(np.uint64),
            )
        )
        assert solid.status() == manifold3d.Error.NoError
        number = len(solid.decompose())
        assert number == check_closed((body.vertices, body.triangles)).pieces
        assert (number, solid.genus() + number - 1) == pieces_and_holes(cells)
        assert solid.volume() == pytest.approx(body.volume(), rel=1e-11)


@pytest.mark.daily_cases("strips")
@pytest.mark.parametrize(
    "name", often(FORMS, "strips", "tilted about both axes, offset", "turned web", "plano")
)
def test_the_volume_missing_from_the_facets_falls_fourfold_when_they_are_halved(name):
    sheet = window(**FORMS[name])
    for body in sheet.bodies:
        exact = exact_volume(sheet, body)
        lost = [exact - mesh_body(sheet, body, quads).volume() for quads in (10, 20)]
        assert abs(lost[0]) < 0.03 * exact
        assert lost[0] / lost[1] == pytest.approx(4.0, rel=0.12), lost


FAMILIES = [
    pytest.param({}, lambda a: (0.0, a, 0.0), id="tilt"),
    pytest.param({"eta": (-1.0, -0.5)}, lambda a: (45.0, a, 10.0), id="tilt of turned lenses"),
    pytest.param({}, lambda a: (a, 0.0, 0.0), id="turn without tilt"),
    pytest.param({"kind": "hexagonal"}, lambda a: (20.0, a, 0.0), id="hexagons"),
    pytest.param({"form": "slab"}, lambda a: (0.0, 0.9 * a, 0.0), id="slab"),
    pytest.param({"thickness": 0.0005, "eta": (-1.0, -1.0)}, lambda a: (0.0, a, 0.0), id="pinholes"),
    pytest.param({"thickness": 0.0006, "web": 0.0001}, lambda a: (0.0, 0.6 * a, 0.0), id="web"),
]


@pytest.mark.ci_cases("tilt of turned lenses", "hexagons", "web")
@pytest.mark.daily_cases("slab")
@pytest.mark.parametrize(("keys", "tilt"), FAMILIES)
def test_no_tilt_from_a_billionth_of_a_degree_to_20_degrees_leaves_an_open_edge(keys, tilt):
    assert _closed_at(np.geomspace(1e-9, 20.0, 8), keys, tilt) >= 6


@pytest.mark.long
@pytest.mark.parametrize(("keys", "tilt"), FAMILIES)
def test_no_tilt_of_60_leaves_an_open_edge(keys, tilt):
    assert _closed_at(np.geomspace(1e-9, 20.0, 60), keys, tilt) >= 52


@pytest.mark.long
def test_60_tilts_of_a_turned_sheet_leave_no_open_edge():
    keys, tilt = {"eta": (-1.0, -0.5), "thickness": 0.0012}, lambda a: (45.0, a, 10.0)
    assert _closed_at(np.geomspace(1e-9, 20.0, 60), keys, tilt) >= 52


def _closed_at(angles, keys, tilt):
    """Mesh a small sheet at every angle; how many could be built."""
    checked = 0
    for angle in angles:
        sheet = _built({**keys, "count": (2, 2), "euler": tilt(float(angle))})
        if sheet is None:
            continue  # refused as a design: the tilt is more than this pair can bear
        health = check_closed(as_file(mesh_body(sheet, sheet.bodies[-1], 3)), pieces=False)
        assert health.closed, (angle, health)
        checked += 1
    return checked


def _built(keys):
    try:
        return window(**keys)
    except ValueError:
        return None


def test_saddles_leave_no_edge_with_four_faces_by_index():
    sheet = window(**FORMS["saddle at every corner"])
    for body in tessellate(sheet, quads=4).bodies:
        assert saddle_count(cell_complex(sheet, body.body)) == 8
        edges = np.sort(body.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        _, uses = np.unique(edges, axis=0, return_counts=True)
        assert (uses == 2).all()


def test_columns_that_touch_along_a_line_stay_pieces_of_their_own():
    sheet = window(**FORMS["loose cells that touch"])
    body = tessellate(sheet, quads=4).bodies[0]
    assert check_closed(as_file(body)).pieces == 3


def test_lenses_whose_rims_lie_on_the_border_touch_without_sharing_an_edge():
    # cylinders as thick as their cell is wide: front and back meet exactly on two borders
    sheet = window(eta=(1.0, -1.0), count=(2, 2))
    body = sheet.bodies[0]
    half = sheet.lattice.pitch[1] / 2
    middle = 0.5 * (body.front.vertex[2] + body.back.vertex[2])
    rim = lens_height(body.front, np.zeros(1), np.array([half]))[0] - body.front.vertex[2]
    lower, upper = middle - rim, middle + rim
    thin = replace(
        body,
        front=replace(body.front, vertex=(0.0, 0.0, lower)),
        back=replace(body.back, vertex=(0.0, 0.0, upper)),
    )
    mesh = mesh_body(replace(sheet, bodies=(thin, sheet.bodies[1])), thin, 6)
    health = check_closed(as_file(mesh))
    assert health.closed, health
    assert health.pieces == 2


# -- the right surface ----------------------------------------------------------------------------------


@pytest.mark.daily_cases("strips")
@pytest.mark.parametrize(
    "name", ["tilted about both axes, offset", "plano", "concave", "hexagonal", "strips"]
)
def test_optical_vertices_lie_on_the_exact_surfaces(name):
    sheet = window(**FORMS[name])
    for body in tessellate(sheet, quads=6).bodies:
        corners = np.concatenate(list(body.rows()))
        kind = np.concatenate([k for k, _ in facet_tags(body)])
        cell = np.concatenate([c for _, c in facet_tags(body)])
        for which, face in ((FRONT, body.body.front), (BACK, body.body.back)):
            if face.array is None:
                continue
            mine = kind == which
            centre = sheet.lattice.centres(cell[mine]) + np.array(sheet.shifts[face.array])
            x, y = (corners[mine][..., k] - centre[:, None, k] for k in (0, 1))
            off = corners[mine][..., 2] - lens_height(face, x, y)
            assert np.nanmax(np.abs(off)) <= 4 * body.step


@pytest.mark.slow
def test_front_facets_look_down_back_facets_up_and_walls_stand():
    body = tessellate(window(**FORMS["turned web"]), quads=5).bodies[1]
    corners = np.concatenate(list(body.rows()))
    kind = np.concatenate([k for k, _ in facet_tags(body)])
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    assert (normal[kind < BACK, 2] < 0.0).all()
    assert (normal[(kind >= BACK) & (kind < WALL), 2] > 0.0).all()
    assert np.abs(normal[kind == WALL, 2]).max() < 1e-9


def one_cell(sheet, number, quads):
    """Corners (t, 3, 3) of a body's facets in the frame of its only cell, their kinds and their normals."""
    alone = sheet.with_cells((1, 1))
    body = tessellate(alone, quads=quads).bodies[number]
    assert check_closed((body.vertices, body.triangles)).closed
    corners = np.concatenate(list(body.rows())) - [*alone.shifts[body.body.arrays[0]], 0.0]
    return (
        corners,
        np.concatenate([k for k, _ in facet_tags(body)]),
        np.concatenate([n for _, n in shaded_rows(body)]),
    )


def test_corner_normals_are_the_gradient_of_the_heights():
    sheet = window(**FORMS["tilted"])
    body = sheet.bodies[0]
    corners, kind, normals = one_cell(sheet, 0, 6)
    at = corners[kind == BACK].reshape(-1, 3)
    normal = normals[kind == BACK].reshape(-1, 3)
    h = 1e-7
    slope_x = (
        lens_height(body.back, at[:, 0] + h, at[:, 1]) - lens_height(body.back, at[:, 0] - h, at[:, 1])
    ) / (2 * h)
    slope_y = (
        lens_height(body.back, at[:, 0], at[:, 1] + h) - lens_height(body.back, at[:, 0], at[:, 1] - h)
    ) / (2 * h)
    np.testing.assert_allclose(-normal[:, 0] / normal[:, 2], slope_x, atol=1e-7)
    np.testing.assert_allclose(-normal[:, 1] / normal[:, 2], slope_y, atol=1e-7)


def test_corner_normals_come_in_the_order_of_the_rows():
    mesh = tessellate(window(**FORMS["round outline"]), quads=4).bodies[0]
    for corners, (same, normals) in zip(mesh.rows(), shaded_rows(mesh), strict=True):
        assert np.array_equal(corners, same)
        facet = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert (np.einsum("tcd,td->tc", normals, facet) > 0.0).all()


# -- errors as stated -------------------------------------------------------------------------------------


def test_slope_error_is_the_textbook_value_and_falls_first_order_sag_second():
    sheet = window(eta=(-1, -1))  # round lenses
    radius = 1.0 / sheet.bodies[0].front.surface.curvature_x
    meshes = {quads: tessellate(sheet, quads=quads) for quads in (8, 16, 32)}
    for quads, mesh in meshes.items():
        leg = 0.005 / quads
        assert mesh.slope_error == pytest.approx(leg / (np.sqrt(6) * radius), rel=0.02)
        assert mesh.sag_error == pytest.approx(leg**2 / (4 * radius), rel=0.03)
    assert meshes[8].slope_error / meshes[32].slope_error == pytest.approx(4.0, rel=0.01)
    assert meshes[8].sag_error / meshes[32].sag_error == pytest.approx(16.0, rel=0.05)


def test_no_point_of_the_surface_is_further_from_the_facets_than_stated():
    sheet = window(**FORMS["tilted about both axes, offset"])
    mesh = tessellate(sheet, quads=7)
    rng = np.random.default_rng(1)
    for number, body in enumerate(mesh.bodies):
        every, kind, _ = one_cell(sheet, number, 7)
        for which, face in ((FRONT, body.body.front), (BACK, body.body.back)):
            corners = every[kind == which]
            weight = rng.dirichlet(np.ones(3), len(corners))
            at = np.einsum("tc,tcd->td", weight, corners)
            off = np.abs(lens_height(face, at[:, 0], at[:, 1]) - at[:, 2])
            assert off.max() <= 1.02 * body.sag_error


def test_an_asked_slope_error_is_met_with_the_fewest_quads():
    sheet = window()
    quads = forecast_quads(sheet, 5e-3)
    assert tessellate(sheet, slope_error=5e-3).quads == quads
    assert tessellate(sheet, quads=quads).slope_error <= 5e-3
    assert tessellate(sheet, quads=quads - 1).slope_error > 5e-3


def test_exactly_one_of_slope_error_and_quads_is_asked():
    with pytest.raises(ValueError, match="exactly one"):
        tessellate(window())
    with pytest.raises(ValueError, match="exactly one"):
        tessellate(window(), slope_error=1e-3, quads=4)
    with pytest.raises(ValueError, match="needs more than"):
        tessellate(window(), slope_error=1e-7)
    assert clacad.tessellate is tessellate


# -- the design's volume, by other routes --------------------------------------------------------------


@pytest.mark.slow
def test_the_quadrature_agrees_with_a_plain_midpoint_sum():
    for name in ("tilted about both axes, offset", "turned web", "strips"):
        sheet = window(**FORMS[name])
        n, half = 300, 0.0025
        u = ((2 * np.arange(n) + 1) / n - 1.0) * half
        x, y = (v.ravel() for v in np.meshgrid(u, u))
        for body in sheet.bodies:
            front, back = column(sheet, body, x, y)
            plain = np.nansum(back - front) * (2 * half / n) ** 2 * sheet.lattice.cell_count
            assert exact_volume(sheet, body) == pytest.approx(plain, rel=5e-5)


def test_a_lens_inside_its_cell_is_two_spherical_caps():
    sheet = window(eta=(-1, -1), thickness=0.0002)
    body = sheet.bodies[0]
    radius = 1.0 / body.front.surface.curvature_x
    height = 0.0001
    caps = 2 * np.pi * height**2 * (3 * radius - height) / 3
    assert exact_volume(sheet, body) == pytest.approx(9 * caps, rel=1e-11)
    mesh = mesh_body(sheet, body, 24)
    assert mesh.volume() == pytest.approx(9 * caps, rel=0.01)
    assert check_closed(as_file(mesh)).pieces == 9


# -- counts and streams ------------------------------------------------------------------------------------


@pytest.mark.parametrize("quads", [4, 9])
def test_facets_of_a_covered_flat_sheet_are_counted_by_hand(quads):
    n1, n2 = 7, 4
    sheet = window(count=(n1, n2))
    each = 4 * quads**2 * n1 * n2 + 2 * quads * 2 * (n1 + n2)
    assert tessellate(sheet, quads=quads).facet_count == 2 * each


@pytest.mark.daily_cases("slab, displaced in x and y")
@pytest.mark.parametrize("name", ["tilted", "hexagonal", "round outline", "slab, displaced in x and y"])
def test_counts_without_expanding_are_those_of_the_stream_and_of_the_index(name):
    sheet = window(**{**FORMS[name], "count": (9, 8)})
    for body in tessellate(sheet, quads=3).bodies:
        rows = np.concatenate(list(body.rows()))
        assert len(rows) == body.facet_count == len(body.triangles)
        assert np.array_equal(rows, body.vertices[body.triangles])


def test_memory_of_the_stream_does_not_grow_with_the_rows():
    peaks = []
    for rows in (6, 60):
        body = mesh_body(window(euler=(0, 1, 0), count=(40, rows)), window(euler=(0, 1, 0)).bodies[0], 8)
        tracemalloc.start()
        total = sum(len(block) for block in body.rows())
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert total == body.facet_count
    assert peaks[1] < 1.1 * peaks[0]


def test_heights_survive_a_float32_file_unchanged():
    for body in tessellate(window(**FORMS["tilted"]), quads=4).bodies:
        z = np.concatenate(list(body.rows()))[..., 2]
        assert np.array_equal(z.astype(np.float32).astype(np.float64), z)


# -- refusals ------------------------------------------------------------------------------------------------


def test_a_surface_that_ends_inside_its_cell_is_refused():
    sheet = window(form="plano")
    body = sheet.bodies[0]
    steep = replace(
        body,
        front=replace(body.front, surface=Quadric(500.0, 500.0, 500.0)),
        back=replace(body.back, vertex=(0.0, 0.0, 0.01)),
    )
    with pytest.raises(ValueError, match="ends"):
        mesh_body(replace(sheet, bodies=(steep, sheet.bodies[1])), steep, 8)


def test_cells_beyond_the_outline_are_refused():
    sheet = window(form="slab", outline={"circle": 0.03}, count=(6, 6), euler=(0, 2, 0))
    assert (
        tessellate(sheet, quads=4).facet_count > 0
    )  # the prescription keeps cells that fit with their partners
    sheet = replace(sheet, lattice=replace(sheet.lattice, outline=sheet.outline))  # as if it did not
    with pytest.raises(ValueError, match="beyond the outline"):
        tessellate(sheet, quads=4)


def test_a_grid_that_misses_the_lens_is_refused_and_a_finer_one_is_not():
    sheet = window(eta=(-1, -1), thickness=0.00002)
    with pytest.raises(ValueError, match="more quads"):
        mesh_body(sheet, sheet.bodies[0], 3)
    assert check_closed(as_file(mesh_body(sheet, sheet.bodies[0], 12))).closed


@pytest.mark.daily_cases("3")
@pytest.mark.parametrize("quads", [2, 3, 4, 5])
def test_grids_too_coarse_for_the_rims_are_still_closed(quads):
    for keys in (
        {"kind": "hexagonal", "euler": (90.0, 3.7, 0.0), "eta": (-0.25, -0.25), "thickness": 0.000205,
         "web": 3.09e-5, "seam": 0.000767},
        {"euler": (45.0, 1.02, 0.0), "eta": (-0.5, -2.0), "thickness": 0.0001286, "web": 0.000121},
    ):  # fmt: skip
        for body in tessellate(window(**keys), quads=quads).bodies:
            assert check_closed(as_file(body)).closed
