"""Bevels at saddles: columns that only touch get real contact, and nothing else changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from meshwindows import FORMS, window

import clacad
from clacad.exporting.run import export
from clacad.formats.mesh.readers import read_mesh
from clacad.mesh import tessellate
from clacad.mesh.body_mesh import facet_tags
from clacad.mesh.cell_template import WALL
from clacad.topology.build_complex import cell_complex, saddle_count

WIDTH = 1e-4
SADDLED = ("saddle at every corner", "tilted about both axes, offset", "plano", "slab", "pinholes")


def stranger(body):
    """The mesh as a float32 file that knows positions only, welded by another library's rules."""
    corners = body.vertices.astype(np.float32)[body.triangles].reshape(-1, 3)
    vertices, index = np.unique(corners, axis=0, return_inverse=True)
    return trimesh.Trimesh(vertices, index.reshape(-1, 3), process=False)


@pytest.mark.ci_cases("2e-05-3-saddle at every corner", "2e-05-3-plano", "0.0007-1-slab", "0.0007-1-pinholes")
@pytest.mark.daily_cases("2e-05-3-slab")
@pytest.mark.parametrize("name", SADDLED)
@pytest.mark.parametrize(("width", "quads"), [(2e-5, 3), (7e-4, 1)])
def test_bevelled_sheets_are_watertight_as_float32_files(name, width, quads):
    mesh = tessellate(window(**FORMS[name]), quads=quads, saddle_bevel=width)
    for body in mesh.bodies:
        found = stranger(body)
        assert found.is_watertight
        assert found.is_winding_consistent


def turn(a, b):
    """Z of the cross product of vectors in the plane."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def top(body, points):
    """Highest point of a mesh over each of some points (n, 2)."""
    corners = np.concatenate(list(body.rows()))
    a, b, c = (corners[:, k, :2] for k in range(3))
    area = turn(b - a, c - a)
    flat = np.abs(area) > 1e-16
    corners, a, b, c, area = corners[flat], a[flat], b[flat], c[flat], area[flat]
    found = np.full(len(points), -np.inf)
    for n, point in enumerate(points):
        weights = np.stack(
            [turn(b - point, c - point), turn(c - point, a - point), turn(a - point, b - point)]
        )
        weights /= area
        over = (weights > -1e-9).all(axis=0)
        found[n] = (weights[:, over] * corners[over, :, 2].T).sum(axis=0).max()
    return found


def test_two_high_cells_at_a_saddle_share_a_strip_as_wide_as_the_bevels():
    sheet = window(**FORMS["saddle at every corner"])
    pitch = sheet.lattice.pitch[0]
    node = np.array([0.5, 0.5]) * pitch
    bare, bevelled = (tessellate(sheet, quads=6, saddle_bevel=w).bodies[0] for w in (0.0, WIDTH))
    steps = np.linspace(2e-7, 2.0 * WIDTH, 200)
    across = [node + np.outer(steps, np.array([sx, sy]) / np.sqrt(2.0)) for sx in (1, -1) for sy in (1, -1)]
    tops = np.array([top(bare, points) for points in across])
    low = np.argsort(tops[:, 0])[:2]  # the two ways from the node that lead into low cells
    high = tops[:, 0].max()
    assert (tops[low, 0] < high - 1e-6).all()
    for way in low:
        raised = top(bevelled, across[way])
        filled = steps[raised > high - 2e-6]
        assert filled.max() == pytest.approx(WIDTH / np.sqrt(2.0), rel=0.03)


def test_the_added_volume_is_that_of_the_corner_prisms_and_is_said():
    sheet = window(**FORMS["saddle at every corner"], count=(2, 2))
    quads = 64  # samples on the borders move towards the bevels' ends, which matters less the finer they are
    bare, bevelled = (tessellate(sheet, quads=quads, saddle_bevel=WIDTH) for WIDTH in (0.0, 4e-4))
    for plain, filled in zip(bare.bodies, bevelled.bodies):
        assert filled.volume() - plain.volume() == pytest.approx(filled.bevel_volume, rel=2e-3)
        # prism over a right triangle; the step k p² / 4 · 2 between neighbours at a corner of an untilted pair
        step = np.ptp([_corner_height(sheet, face, s) for face in (filled.body.back,) for s in (1, -1)])
        prisms = 2 * 2 * 4 * 0.5 * (4e-4) ** 2 * step  # two faces, two low corners a cell
        assert filled.bevel_volume == pytest.approx(prisms, rel=0.12)


def _corner_height(sheet, face, sign):
    from clacad.sheet.window import lens_height

    half = 0.5 * sheet.lattice.pitch[0]
    return lens_height(face, np.array([half]), np.array([sign * half]))[0]


def test_no_optical_point_outside_the_corners_moves_and_bevels_are_no_optical_facets():
    sheet = window(**FORMS["saddle at every corner"])
    body = tessellate(sheet, quads=6, saddle_bevel=WIDTH).bodies[0]
    assert body.sag_error == pytest.approx(tessellate(sheet, quads=6).bodies[0].sag_error, rel=0.1)
    kinds = np.concatenate([kind for kind, _ in facet_tags(body)])
    corners = np.concatenate(list(body.rows()))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = np.abs(normal[:, 2]) > 0.1 * np.linalg.norm(normal, axis=1)
    lifted = corners[(kinds == WALL) & flat]
    assert len(lifted)
    middle = np.abs(lifted.mean(axis=1)[:, :2]) % sheet.lattice.pitch[0]
    nearest = np.abs(middle - 0.5 * sheet.lattice.pitch[0]).sum(axis=1)
    assert (nearest < WIDTH).all()


@pytest.mark.parametrize("width", [1e-9, 2e-3])
def test_a_bevel_no_mesh_can_hold_is_refused_with_the_range(width):
    with pytest.raises(ValueError, match="quarter of the pitch"):
        tessellate(window(**FORMS["saddle at every corner"]), quads=4, saddle_bevel=width)


def test_sheets_without_saddles_stay_as_they_are():
    for name in ("hexagonal", "biconvex, seam", "flat neighbours"):
        sheet = window(**FORMS[name])
        plain, asked = tessellate(sheet, quads=4), tessellate(sheet, quads=4, saddle_bevel=WIDTH)
        for a, b in zip(plain.bodies, asked.bodies):
            assert b.bevel_volume == 0.0
            assert b.volume() == pytest.approx(a.volume(), rel=1e-3)


@pytest.mark.slow
def test_the_manifest_counts_saddles_and_says_what_was_done(tmp_path: Path):
    design = clacad.load(
        Path(__file__).parents[2] / "designs" / "tilted-biconvex.toml",
        overrides=["lattice.seam=0", "pair.web=0"],
    ).with_cells((4, 3))
    touch, bevelled = (
        export(design, tmp_path / str(bevel), ("stl",), quads=4, saddle_bevel=bevel).files[0]
        for bevel in (0.0, 0.01)
    )
    sheet = clacad.prescribe(design)
    saddles = sum(saddle_count(cell_complex(sheet, body)) for body in sheet.bodies)
    assert touch["saddles"] == bevelled["saddles"] == saddles == 12  # 6 inner nodes of both bodies
    assert (touch["saddle_policy"], bevelled["saddle_policy"]) == ("touch", "bevel")
    assert bevelled["saddle_bevel"] == 0.01
    assert bevelled["volume"] > touch["volume"]


@pytest.mark.slow
@pytest.mark.parametrize("format", ["stl", "3mf", pytest.param("ply", marks=pytest.mark.long)])
def test_strict_readers_take_bevelled_and_touching_saddles(tmp_path: Path, format: str):
    import manifold3d

    design = clacad.load(
        Path(__file__).parents[2] / "designs" / "tilted-biconvex.toml",
        overrides=["lattice.seam=0", "pair.web=0", "law.euler=[45,0,0]"],
    ).with_cells((3, 3))
    for bevel in (0.0, 0.02):
        folder = tmp_path / f"{format}{bevel}"
        manifest = export(design, folder, (format,), quads=4, saddle_bevel=bevel)
        entry = manifest.files[0]
        file = read_mesh(folder / entry["name"])
        corners = np.concatenate(list(file.chunks()))
        vertices, index = np.unique(corners.reshape(-1, 3).astype(np.float32), axis=0, return_inverse=True)
        whole = trimesh.Trimesh(vertices, index.reshape(-1, 3), process=False)
        assert whole.is_winding_consistent
        own = float(np.einsum("ti,ti->t", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0)
        assert own == pytest.approx(entry["volume"], rel=1e-6)
        if format == "3mf":
            import lib3mf

            wrapper = lib3mf.get_wrapper()
            model = wrapper.CreateModel()
            reader = model.QueryReader("3mf")
            reader.SetStrictModeActive(True)
            reader.ReadFromFile(str(folder / entry["name"]))
            assert reader.GetWarningCount() == 0
            continue
        assert whole.is_watertight
        parts = whole.split(only_watertight=False)
        assert len(parts) == 2
        for part in parts:
            mesh = manifold3d.Mesh(
                vert_properties=np.asarray(part.vertices, dtype=np.float32),
                tri_verts=np.asarray(part.faces, dtype=np.uint32),
            )
            solid = manifold3d.Manifold(mesh)
            assert solid.status() == manifold3d.Error.NoError
            assert solid.genus() == 0
            assert len(solid.decompose()) == 1
            assert solid.volume() == pytest.approx(part.volume, rel=1e-5)
