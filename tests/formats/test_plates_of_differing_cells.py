"""Plates whose two arrays have different patterns: a pair is kept where both cells are whole, holes pass straight through."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

import clacad
from clacad.base.vectors import doubled_normals
from clacad.formats.step.step_files import read_step, write_step
from clacad.judging.cell_triangles import lost_in_mesh, lost_in_solid, wall_areas
from clacad.mesh.tessellation import tessellate
from clacad.optics.rays import Fate, Rays
from clacad.sheet.volume_and_extent import body_volume
from clacad.tracing.trace import trace

HOLES = {"at": [[2.6, 0.2], [-2.55, -0.7]], "diameter": 1.3}
BASE = {
    "format": 1, "name": "plate", "unit": "mm", "law": {"eta": [-1, -1]}, "lattice": {"pitch": 1.0, "outline": {"circle": 8}},
    "pair": {"form": "slab", "separation": 6, "index": 1.5, "surface": "biconic"}, "body": {"holes": [HOLES]},
}  # fmt: skip
AIMED = {"aperture": {"point": [4, 0, -200]}}
PLANO = {"form": "plano", "separation": 10, "thickness": 1}
OCTAGON = {
    "polygon": [
        [4, -1.7, 0],
        [4, 1.7, 0],
        [1.7, 4, 0],
        [-1.7, 4, 0],
        [-4, 1.7, 0],
        [-4, -1.7, 0],
        [-1.7, -4, 0],
        [1.7, -4, 0],
    ]
}
SHEETS = {
    "aimed slab": {"lattice": AIMED},
    "aimed hexagons, plano": {"lattice": AIMED | {"kind": "hexagonal"}, "pair": PLANO},
    "aimed polygon": {"lattice": AIMED | {"outline": OCTAGON}},
    "varying": {"law": {"varying": {"gradient": [[-0.002, 0.0], [0.0, -0.003]]}}},
    "other pitch": {"lattice": {"pitch_2": 1.04, "outline": {"circle": 7.2}}},
    "turned array": {"lattice": {"rotation_2": "1.5 deg"}},
    "sharp pairs": {"pair": {"focus": {"object": -300, "image": 400}, "surface": "ellipsoid"}},
}  # fmt: skip


def design(**changes):
    asked = {
        name: value | changes.get(name, {}) if isinstance(value, dict) else value
        for name, value in BASE.items()
    }
    return clacad.Design.from_dict(asked)  # fmt: skip


def built(name, **more):
    changes = {key: SHEETS[name].get(key, {}) | more.get(key, {}) for key in {*SHEETS[name], *more}}
    return clacad.prescribe(design(**changes))


def footprints(window, cells):
    """Points (n, 2 m, 2) along the borders of cells in both arrays."""
    found = []
    share = np.linspace(0.0, 1.0, 40, endpoint=False)[:, None, None]
    for array in (0, 1):
        tile = window.lattice_of(array).tile()
        around = (tile + share * (np.roll(tile, -1, axis=0) - tile)).reshape(-1, 2)
        found.append(window.centres(array, cells)[:, None] + around)
    return np.concatenate(found, axis=1)


@pytest.mark.parametrize("name", SHEETS)
def test_a_pair_is_kept_where_both_of_its_cells_are_whole(name):
    window = built(name)
    assert not window.uniform
    lattice = window.lattice
    grid = lattice.with_count(lattice.count).cells()
    points = footprints(window, grid)
    corners = np.array([v[:2] for v in window.outline.vertices])
    if len(corners) == 4:
        gap = 0.5 * window.outline.diameter - np.hypot(points[..., 0], points[..., 1])
    else:  # sides of a convex polygon
        along = np.roll(corners, -1, axis=0) - corners
        along /= np.hypot(*along.T)[:, None]
        way = points[..., None, :] - corners
        gap = (along[:, 0] * way[..., 1] - along[:, 1] * way[..., 0]).min(axis=-1)
    for x, y in HOLES["at"]:
        gap = np.minimum(gap, np.hypot(points[..., 0] - x, points[..., 1] - y) - 0.65)
    kept = lattice.contains(grid)
    assert kept.any()
    least = gap.min(axis=1)
    assert (least[kept] >= 1e-3 - 1e-12).all()
    assert (least[~kept] < 0.01).all()
    if name == "other pitch":  # array 2 alone leaves some out
        assert (gap[~kept, : gap.shape[1] // 2].min(axis=1) > 0.01).any()


@pytest.mark.daily_cases("aimed hexagons, plano")
@pytest.mark.parametrize("name", ["aimed slab", "aimed hexagons, plano", pytest.param("turned array", marks=pytest.mark.slow)])  # fmt: skip
def test_holes_lie_at_one_place_in_every_body_and_in_light(name):
    window = built(name)
    rng = np.random.default_rng(5)
    points = rng.uniform(-4.2, 4.2, (1500, 2))
    out = np.hypot(*points.T) > 4.0
    for x, y in HOLES["at"]:
        out |= np.hypot(points[:, 0] - x, points[:, 1] - y) < 0.65
    first = window.lattice.contains(window.locate(0, *points.T)[0])
    seen = trace(window, Rays(np.column_stack([points, np.full(1500, -0.5)]), (0.0, 0.0, 1.0)), path="numpy")
    assert (seen.fate[out] == Fate.MISSED).all()
    assert (seen.fate[~out & ~first] == Fate.LAND).all() or name != "aimed slab"
    assert (seen.fate[~out & first] != Fate.MISSED).all()


@pytest.mark.parametrize("name", ["aimed slab", pytest.param("aimed hexagons, plano", marks=pytest.mark.slow), pytest.param("varying", marks=pytest.mark.slow), pytest.param("turned array", marks=pytest.mark.slow)])  # fmt: skip
def test_solid_mesh_and_closed_form_have_one_volume_and_the_section_of_the_plate(tmp_path, name):
    trimesh = pytest.importorskip("trimesh")
    window = built(
        name,
        lattice={"outline": {"circle": 5}},
        body={"holes": [HOLES | {"at": [[1.6, 0.1]], "diameter": 0.7}]},
    )
    write_step(window, tmp_path / "a.step", mode="fused")
    facts = read_step(tmp_path / "a.step")
    exact = sum(body_volume(window, body).value for body in window.bodies)
    assert facts["valid"]
    assert facts["volume"] == pytest.approx(exact, rel=1e-6)
    meshes = []
    for body, mesh in zip(window.bodies, tessellate(window, quads=6).bodies, strict=True):
        corners = np.concatenate(list(mesh.rows())).reshape(-1, 3)
        solid = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3))
        assert solid.is_watertight
        meshes.append(solid.volume)
        if body.front.array is not None and body.back.array is not None:
            cut = solid.section([0, 0, 1], [0, 0, 0.5 * (body.front.land + body.back.land)])
            loops = [
                0.5 * np.cross(loop[:-1], loop[1:])[:, 2].sum()
                for loop in (one - [0, 0, one[0, 2]] for one in cut.discrete)
            ]
            hole, plate = sorted(map(abs, loops))
            assert plate - hole == pytest.approx(pi / 4 * (5**2 - 0.7**2), rel=1e-5)
    assert sum(meshes) == pytest.approx(exact, rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("lattice", [AIMED, pytest.param({}, marks=pytest.mark.slow)])
def test_a_hole_elsewhere_in_the_land_is_found_in_solids_their_text_and_triangles(tmp_path, lattice):
    at = {"diameter": 0.7, "at": [[1.6, 0.1]]}
    mm = {"lattice": lattice | {"outline": {"circle": 5}}}
    asked = clacad.prescribe(design(**mm, body={"holes": [at]}))
    for moved, lost in (((1.6, 0.1), 0), ((1.65, 0.1), 1), ((1.6, 0.1, 0.8), 1)):
        hole = {"at": [moved[:2]], "diameter": moved[2] if moved[2:] else 0.7}
        window = clacad.prescribe(design(**mm, body={"holes": [hole]}))
        path = tmp_path / "a.step"
        write_step(window, path, mode="fused")
        assert len(lost_in_solid(asked, read_step(path)["holes"], 1.0)) == lost
        text = read_step(path, kernel=False)["cylinders"]
        assert len(lost_in_solid(asked, text, 1.0, alone=False)) == lost
        triangles = np.concatenate([t for body in tessellate(window, quads=4).bodies for t in body.rows()])
        walls = triangles[np.abs(doubled_normals(triangles)[:, 2]) < 1e-9]
        assert len(lost_in_mesh(asked, wall_areas(asked, walls), None)) == lost


@pytest.mark.slow
def test_verify_passes_the_plate_and_finds_a_moved_hole_and_a_missing_cell(tmp_path):
    from clacad.verification import verify

    small = {"lattice": AIMED | {"outline": {"circle": 5}}}
    at = {"diameter": 0.7, "at": [[1.6, 0.1]]}
    failed = []
    for n, hole in enumerate([at, at | {"at": [[1.65, 0.1]]}, at | {"at": [[1.4, 0.1]], "diameter": 1.1}]):
        write_step(
            clacad.prescribe(design(**small, body={"holes": [hole]})), tmp_path / f"{n}.step", mode="fused"
        )
        report = verify(design(**small, body={"holes": [at]}), tmp_path / f"{n}.step", rays=500)
        failed.append({one.id for one in report.checks if one.state == "fail"})
    assert not failed[0]
    assert failed[1] == {"shape"}
    assert {"shape", "volume", "placement"} <= failed[2]
