"""Files without a manifest: found however they lie, and what was done to them is named with place and size."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from filesonly import only_files
from oracle.plain_mesh import sheet_facets, write_stl

import clacad
from clacad.design import Design
from clacad.exporting.roles import Role
from clacad.exporting.run import export
from clacad.formats.mesh.file_mesh import FileMesh, Part
from clacad.formats.mesh.readers import read_mesh
from clacad.judging.damage import find_features
from clacad.judging.delivery import Inspection, list_files
from clacad.judging.deviation_map import plot_deviation, write_deviation
from clacad.judging.judge_part import judge_placed
from clacad.judging.mesh_wholeness import is_open_surface, rims
from clacad.judging.registration import place
from clacad.mesh import tessellate
from clacad.prescription.prescribe import prescribe
from clacad.verification import verify

DESIGNS = Path(__file__).resolve().parents[2] / "designs"
RAYS = 1024


@pytest.fixture(autouse=True)
def _only_files(monkeypatch):
    only_files(monkeypatch)


def design(name, *overrides):
    return clacad.load(DESIGNS / f"{name}.toml", overrides=list(overrides))


SLAB = ("slab", "lattice.count=[10,10]")
THIN = ("slab", "lattice.count=[20,20]", "pair.separation=3.0", "law.eta=[-0.5,-1.0]")
PLANO = ("plano", "lattice.count=[8,8]")
TILTED = ("tilted", "lattice.count=[8,8]")
HEXAGONAL = ("hexagonal", "lattice.count=[16,16]", "lattice.outline.circle=6.0")
THIN_DISC = (
    "slab", "lattice.count=[24,24]", "pair.separation=3.0", "law.eta=[-0.5,-1.0]", "lattice.outline.circle=11.0",
)  # fmt: skip
ROUND_SLAB = ("slab", "lattice.count=[20,20]", "lattice.outline.circle=9.0")
SYMMETRIC = ("window-100mm", "lattice.count=[8,8]")


def about(axis, degrees):
    """Rotation about any axis (Rodrigues)."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


OBLIQUE = about([1.0, 2.0, 3.0], 63.0)


def facets(made, quads=8):
    mesh = tessellate(prescribe(made), quads=quads)
    return np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]


def judged(tmp_path, made, triangles, role=Role.PREVIEW):
    path = tmp_path / "part.stl"
    write_stl(path, triangles)
    placed = place(made, list_files(path).hashed().subjects[0], read_mesh(path), None)
    found, evidence = judge_placed(Inspection(made, path.name, RAYS, role=role), placed)
    return placed, {check.id: check for check in found}, evidence


def failed(checks):
    return {name for name, check in checks.items() if check.state == "fail"}


# -- identity first -------------------------------------------------------------------------------------


@pytest.mark.ci_cases("slab", "tilted", "galilean")
@pytest.mark.slow
@pytest.mark.parametrize("which", [SLAB, PLANO, SYMMETRIC, HEXAGONAL, TILTED, ("galilean", "lattice.count=[8,8]")],
                         ids=lambda w: w[0])  # fmt: skip
def test_a_copy_of_an_exported_mesh_lies_as_it_was_written(tmp_path, which):
    made = design(*which)
    export(made, tmp_path / "made", ("stl", "ply", "3mf"), quads=8)
    for suffix in ("stl", "ply", "3mf"):
        source = next((tmp_path / "made").glob(f"*.{suffix}"))
        copy = tmp_path / f"copy.{suffix}"
        copy.write_bytes(source.read_bytes())
        placed = place(made, list_files(copy).hashed().subjects[0], read_mesh(copy), None)
        found, _ = judge_placed(Inspection(made, copy.name, RAYS, role=Role.PREVIEW), placed)
        assert placed.pose.untouched, suffix
        assert placed.exact
        coarse = [check.id for check in found if check.state == "warn" and check.id.startswith("file_")]
        assert not {check.id for check in found if check.state in ("fail", "warn")} - set(coarse), suffix


@pytest.mark.slow
def test_a_dent_in_a_symmetric_sheet_is_named_where_it_is(tmp_path):
    made = design(*SYMMETRIC)
    window = prescribe(made)
    triangles = facets(made)
    x, y = window.lattice.centres(np.array([[6, 1]]))[0]
    top = triangles[..., 2].max()
    near = (np.hypot(triangles[..., 0] - x, triangles[..., 1] - y) < 0.03) & (triangles[..., 2] > top - 0.5)
    triangles[near, 2] -= 0.005
    _, checks, evidence = judged(tmp_path, made, triangles)
    assert checks["pose"].state == "pass"
    assert checks["shape"].state == "fail"
    (dent,) = checks["shape"].detail["dents"]
    assert dent["cell"] == [6, 1]
    assert dent["face"].endswith("back")
    assert dent["depth_um"] == pytest.approx(5.0, rel=0.02)
    assert dent["x_mm"] == pytest.approx(x, abs=0.04)
    assert dent["y_mm"] == pytest.approx(y, abs=0.04)
    assert "(6, 1)" in checks["shape"].sentence
    assert "µm too low" in checks["shape"].sentence
    assert evidence.facts["deviation"].to_dict()["dents"] == [dent]


# -- however it lies ------------------------------------------------------------------------------------


@pytest.mark.ci_cases("block", "two plates", "thin disc")
@pytest.mark.slow
@pytest.mark.parametrize("which", [SLAB, THIN, PLANO, TILTED, HEXAGONAL, THIN_DISC, ROUND_SLAB],
                         ids=["block", "thin", "two plates", "tilted", "hexagonal disc", "thin disc", "round"])  # fmt: skip
def test_a_part_turned_about_an_oblique_axis_is_found_and_judged_right(tmp_path, which):
    made = design(*which)
    triangles = facets(made)
    placed, checks, _ = judged(tmp_path, made, triangles @ OBLIQUE.T + [3.0, 4.0, 5.0])
    assert placed.window.lattice.count == made.lattice.count
    assert not failed(checks)
    back = np.concatenate(list(placed.mesh.chunks())) * placed.factor
    flat = back.reshape(-1, 3)
    # the same part, or one the design cannot distinguish from it: its box and its middle are the design's
    assert np.allclose(np.ptp(flat, axis=0), np.ptp(triangles.reshape(-1, 3), axis=0), atol=2e-4)
    assert np.abs(flat.mean(axis=0) - triangles.reshape(-1, 3).mean(axis=0)).max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(("metres", "word"), [(1.0, "m"), (0.0254, "in"), (1e-6, "um")])
def test_a_turned_part_is_found_in_any_unit(tmp_path, metres, word):
    made = design(*THIN)
    placed, checks, _ = judged(tmp_path, made, (facets(made, 4) @ OBLIQUE.T) * (1e-3 / metres))
    assert placed.pose.unit == word
    assert not failed(checks)


@pytest.mark.slow
def test_a_turned_mirror_image_is_still_told(tmp_path):
    made = Design.from_dict({
        "format": 1, "name": "part", "unit": "mm", "law": {"eta": [-0.5, -1.0], "delta": [0.01, 0.005]},
        "pair": {"form": "biconvex", "separation": 10.0, "thickness": "auto", "index": 1.5},
        "lattice": {"pitch": 1.0, "count": [7, 5]},
    })  # fmt: skip
    soup = sheet_facets(prescribe(made), 8)
    wrong = (soup * [-1.0, 1.0, 1.0])[:, ::-1] @ OBLIQUE.T
    _, checks, _ = judged(tmp_path, made, wrong)
    assert checks["handedness"].state == "fail"
    _, checks, _ = judged(tmp_path, made, soup @ OBLIQUE.T)
    assert checks["handedness"].state == "pass"


@pytest.mark.slow
def test_a_disc_turned_about_its_normal_is_found_by_its_lenses(tmp_path):
    made = design(*THIN_DISC)
    placed, checks, _ = judged(tmp_path, made, facets(made) @ about([0.0, 0.0, 1.0], 37.0).T)
    assert placed.pose.residual < 1e-5
    assert checks["shape"].state == "pass"
    assert checks["pose"].state == "fail"  # its box is the design's: made so, its lenses are askew
    assert "turned" in checks["pose"].sentence


@pytest.mark.slow
def test_a_piece_sawn_askew_is_found_by_its_lenses(tmp_path):
    made = design(*THIN)
    turned = facets(made, 6) @ about([0.0, 0.0, 1.0], 27.0).T
    middle = turned.mean(axis=1)
    piece = turned[(np.abs(middle[:, 0]) < 2.7) & (np.abs(middle[:, 1] + 0.1) < 2.1)] @ OBLIQUE.T
    placed, checks, _ = judged(tmp_path, made, piece)
    assert placed.pose.residual < 1e-5
    assert not placed.whole
    assert not failed(checks)


# -- what is no fault -----------------------------------------------------------------------------------

HARMLESS = {
    "moved by 5 mm": lambda t: t + [5.0, 0.0, 0.0],
    "moved by 10 um": lambda t: t + [0.01, 0.0, 0.0],
    "turned a quarter": lambda t: t @ about([0.0, 0.0, 1.0], 90.0).T,
    "shrunk by .05 %": lambda t: t * 0.9995,
}


@pytest.mark.ci_cases(
    "slab-turned a quarter", "tilted-shrunk by .05 %", "plano-moved by 5 mm", "round-moved by 10 um"
)
@pytest.mark.daily_cases("plano-turned a quarter")
@pytest.mark.parametrize("how", HARMLESS)
@pytest.mark.parametrize("which", [SLAB, TILTED, PLANO, ROUND_SLAB], ids=["slab", "tilted", "plano", "round"])
def test_a_good_part_does_not_fail_shape_by_where_it_lies(tmp_path, which, how):
    made = design(*which)
    placed, checks, _ = judged(tmp_path, made, HARMLESS[how](facets(made)))
    assert failed(checks) <= {"pose"}
    if "turned" in how:
        assert checks["pose"].state in ("warn", "fail")  # the design is not the same turned by a quarter
        assert "turned" in checks["pose"].sentence
    else:
        assert checks["pose"].state == "pass"
    if "shrunk" in how:
        assert checks["scale"].detail["scale"] == pytest.approx(0.9995, abs=2e-6)
        assert "0.9995" in checks["scale"].sentence
    assert placed.window.lattice.count == made.lattice.count


@pytest.mark.slow
def test_a_shrink_beyond_the_limit_fails_scale_alone(tmp_path):
    made = design(*SLAB)
    _, checks, _ = judged(tmp_path, made, facets(made) * 0.998)
    assert failed(checks) == {"scale"}


# -- pieces, holes, engravings --------------------------------------------------------------------------


def drilled(triangles, x, y, diameter, low=-100.0, high=100.0):
    manifold3d = pytest.importorskip("manifold3d")
    vertices, index = np.unique(np.float32(triangles).reshape(-1, 3), axis=0, return_inverse=True)
    solid = manifold3d.Manifold(manifold3d.Mesh(vertices, index.reshape(-1, 3).astype(np.uint32)))
    assert solid.status() == manifold3d.Error.NoError
    drill = manifold3d.Manifold.cylinder(high - low, diameter / 2, diameter / 2, 64).translate([x, y, low])
    mesh = (solid - drill).to_mesh()
    return mesh.vert_properties[:, :3][mesh.tri_verts].astype(np.float64)


PIECE = ("slab", "lattice.count=[4,4]")


@pytest.mark.daily_cases("as it lay")
@pytest.mark.parametrize("motion", ["as it lay", "turned"])
def test_a_drilled_piece_is_recognised_and_its_hole_named(tmp_path, motion):
    whole = design(*SLAB)
    made = drilled(facets(design(*PIECE)), 0.25, -0.25, 0.4)
    moved = made + [0.5, 1.0, 0.0] if motion == "as it lay" else made @ OBLIQUE.T + [1.0, 2.0, 3.0]
    placed, checks, _ = judged(tmp_path, whole, moved)
    assert placed.window.lattice.count == (4, 4)
    if motion == "as it lay":
        assert "cells 4 … 7, 5 … 8 of the design" in placed.note
    assert checks["closed"].state == "pass"
    assert checks["shape"].state == "fail"
    (hole,) = checks["shape"].detail["features"]
    assert hole["kind"] == "hole"
    assert hole["diameter_mm"] == pytest.approx(0.4, rel=1e-3)
    assert np.abs([abs(hole["x_mm"]) - 0.25, abs(hole["y_mm"]) - 0.25]).max() < 1e-3
    assert len(hole["cells"]) == 1
    assert "a hole of diameter 0." in checks["shape"].sentence
    if motion == "as it lay":
        assert hole["cells"] == [[2, 1]]
        assert (hole["x_mm"], hole["y_mm"]) == pytest.approx((0.25, -0.25), abs=1e-4)


@pytest.mark.slow
def test_a_hole_over_a_corner_of_cells_takes_all_four(tmp_path):
    whole = design(*SLAB)
    _, checks, _ = judged(tmp_path, whole, drilled(facets(design(*PIECE)), 0.02, 0.01, 0.3))
    (hole,) = checks["shape"].detail["features"]
    assert hole["cells"] == [[1, 1], [1, 2], [2, 1], [2, 2]]


@pytest.mark.slow
def test_what_is_engraved_in_a_border_is_named_and_fails_nothing(tmp_path):
    made = design("plano", "lattice.count=[4,4]", "body.border=1.0")
    window = prescribe(made)
    triangles = facets(made)
    low = window.bodies[1].front.vertex[2]
    pocket = drilled(triangles, 1.5, 0.0, 0.4, low=low - 1.0, high=low + 0.1)
    _, checks, _ = judged(tmp_path, made, pocket + [20.0, 0.0, 0.0])
    found = checks["shape"].detail["features"]
    assert {(f["kind"], f["body"]) for f in found} >= {("blind hole", "array2")}
    blind = next(f for f in found if f["body"] == "array2")
    assert blind["depth_mm"] == pytest.approx(0.1, abs=1e-3)
    assert blind["cells"] == []
    assert checks["shape"].state == "fail" if any(f["cells"] for f in found) else "pass"


@pytest.mark.parametrize("which", [SLAB, PLANO, TILTED, HEXAGONAL, ROUND_SLAB, THIN_DISC,
                                   ("tilted-seam", "lattice.count=[6,6]"), ("baffled", "lattice.count=[5,5]"),
                                   ("plano", "lattice.count=[5,5]", "body.border=0.7")],
                         ids=lambda w: "-".join(w)[:30])  # fmt: skip
def test_walls_of_the_design_are_no_holes(which):
    made = design(*which)
    window = prescribe(made)
    mesh = FileMesh("stl-binary", (Part("", soup=np.float32(facets(made, 6))),))
    assert find_features(window, mesh) == []


# -- the dent map ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_dents_are_listed_with_depth_place_and_cell_face_by_face(tmp_path):
    made = design(*SLAB)
    window = prescribe(made)
    triangles = facets(made, 12)
    top, bottom = triangles[..., 2].max(), triangles[..., 2].min()
    dents = {(2, 7): (0.012, "back"), (8, 0): (0.004, "front")}
    want = {}
    for cell, (depth, side) in dents.items():
        x, y = window.lattice.centres(np.array([cell]))[0] + [0.06, -0.1]
        face = triangles[..., 2] > top - 1.0 if side == "back" else triangles[..., 2] < bottom + 1.0
        near = face & (np.hypot(triangles[..., 0] - x, triangles[..., 1] - y) < 0.05)
        triangles[near, 2] += -depth if side == "back" else depth
        want[cell] = (x, y, 1e3 * depth, f"sheet {side}")
    _, checks, evidence = judged(tmp_path, made, triangles + [0.0, 0.0, 30.0])
    told = checks["shape"].detail["dents"]
    assert [tuple(d["cell"]) for d in told] == [(2, 7), (8, 0)]  # the deepest first
    for dent in told:
        x, y, depth, face = want[tuple(dent["cell"])]
        assert dent["face"] == face
        assert dent["depth_um"] == pytest.approx(depth, rel=0.15)  # along the normal, which leans
        assert np.hypot(dent["x_mm"] - x, dent["y_mm"] - y) < 0.06
    assert "cell (2, 7)" in checks["shape"].sentence
    mapped = evidence.facts["deviation"]
    write_deviation(mapped, "part.stl", tmp_path / "out")
    written = json.loads((tmp_path / "out" / "deviation-part.json").read_text())
    assert [d["cell"] for d in written["dents"]] == [[2, 7], [8, 0]]
    assert plot_deviation(mapped, "part.stl").startswith(b"\x89PNG")


@pytest.mark.slow
def test_the_picture_of_deviations_has_units_on_every_axis(tmp_path, monkeypatch):
    from matplotlib.figure import Figure

    seen = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *a, **k: (seen.append(self), save(self, *a, **k))[1])
    made = design(*SLAB)
    _, _, evidence = judged(tmp_path, made, facets(made) + [5.0, 0.0, 0.0])
    plot_deviation(evidence.facts["deviation"], "part.stl")
    labels = [(axes.get_xlabel(), axes.get_ylabel()) for axes in seen[0].axes]
    assert labels.count(("x in the cell / mm", "y in the cell / mm")) == 2
    assert labels.count(("cell i (every 0.5 mm)", "cell j (rows every 0.5 mm)")) == 2
    assert len([y for x, y in labels if not x and y.endswith(" / µm")]) == 4  # colour bars


# -- scans ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_mesh_that_lacks_one_facet_is_broken_and_no_scan(tmp_path):
    made = design("slab", "lattice.count=[3,3]")
    triangles = facets(made, 16)
    gap = len(triangles) // 3
    _, checks, evidence = judged(tmp_path, made, np.delete(triangles, gap, axis=0) + [0.0, 0.0, 50.0])
    assert checks["closed"].state == "fail"
    assert checks["closed"].required
    assert "3 edges" in checks["closed"].sentence
    place_told = np.array(
        [float(v) for v in checks["closed"].sentence.split("one at (")[1].split(")")[0].split(",")]
    )
    edges = 0.5 * (triangles[gap] + np.roll(triangles[gap], -1, axis=0)) + [0.0, 0.0, 50.0]
    assert np.linalg.norm(edges - place_told, axis=1).min() < 1e-4
    assert evidence.facts["role"] is Role.PREVIEW
    report = verify(made, tmp_path / "part.stl", rays=RAYS)
    assert not report.passed


@pytest.mark.slow
def test_faces_alone_are_a_scan(tmp_path):
    made = design(*SLAB)
    triangles = facets(made)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    sheets = triangles[np.abs(normal[:, 2]) > 0.5 * np.linalg.norm(normal, axis=1)]
    _, checks, evidence = judged(tmp_path, made, sheets @ OBLIQUE.T)
    assert checks["closed"].state == "warn"
    assert evidence.facts["role"] is Role.SCAN
    assert checks["shape"].state == "pass"
    assert evidence.facts["noise"] == pytest.approx(evidence.forecast.max())


@pytest.mark.slow
def test_a_declared_scan_may_have_gaps_anywhere(tmp_path):
    made = design("slab", "lattice.count=[3,3]")
    triangles = np.delete(facets(made), 500, axis=0) + [0.0, 0.0, 50.0]
    _, checks, evidence = judged(tmp_path, made, triangles, Role.SCAN)
    assert checks["closed"].state == "warn"
    assert evidence.facts["role"] is Role.SCAN


def cube(centre=(0.0, 0.0, 0.0), size=1.0):
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * (size / 2)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return np.array([corners[[f[0], f[k], f[k + 1]]] for f in faces for k in (1, 2)]) + centre


def soup(triangles):
    return FileMesh("stl-binary", (Part("", soup=np.float32(triangles)),))


def test_what_is_an_open_surface_and_what_is_a_broken_solid():
    grid = np.linspace(-1.0, 1.0, 21)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    points = np.stack([x, y, 0.1 * x * y], axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    sheet = np.concatenate([np.stack([a, b, c], axis=-2), np.stack([a, c, d], axis=-2)]).reshape(-1, 3, 3)
    assert is_open_surface(rims(soup(sheet)))
    assert not is_open_surface(rims(soup(cube())))  # closed
    assert not is_open_surface(rims(soup(cube()[1:])))  # lacks half a side
    assert not is_open_surface(rims(soup(np.delete(cube(), [0, 1], axis=0))))  # lacks a whole side wall
    assert not is_open_surface(rims(soup(np.concatenate([sheet, cube((0, 0, 9.0), 0.1)]))))  # holds a shell
    torn = rims(soup(cube()[1:]))
    assert torn.count == 3
    assert torn.closed_pieces == 0
    assert rims(soup(np.concatenate([cube(), cube((3.0, 0, 0))]))).closed_pieces == 2
