"""A measured part is found in any position and orientation in its file, and a wrong part is named."""

from __future__ import annotations

import numpy as np
import pytest
from filesonly import only_files
from oracle.plain_mesh import sheet_facets, write_stl

from clacad.design import Design
from clacad.formats.mesh.readers import read_mesh
from clacad.judging.delivery import list_files
from clacad.judging.deviation_map import _draw, deviation_map, plot_deviation
from clacad.judging.judge_part import cut_to
from clacad.judging.registration import place
from clacad.prescription.prescribe import prescribe
from clacad.verification import CannotRegister, verify

DESIGN = Design.from_dict({
    "format": 1, "name": "part", "unit": "mm", "law": {"eta": [-0.5, -1.0], "delta": [0.01, 0.005]},
    "pair": {"form": "biconvex", "separation": 10.0, "thickness": "auto", "index": 1.5},
    "lattice": {"pitch": 1.0, "count": [7, 5]},
    "check": {"law_rms": "10 mrad", "law_bias": "10 mrad", "field": "0.5 deg"},
})  # fmt: skip
RAYS = 4096
CYCLE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


def turn(degrees, axis):
    """Rotation about a coordinate axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = [k for k in range(3) if k != axis]
    made = np.eye(3)
    made[i, i] = made[j, j] = c
    made[i, j], made[j, i] = -s, s
    return made


@pytest.fixture(scope="module")
def soup():
    return sheet_facets(prescribe(DESIGN), 12)


@pytest.fixture(autouse=True)
def _only_files(monkeypatch):
    """What does not depend on files is tested by itself: here it is done once, and refinement left out."""
    only_files(monkeypatch)


def found(tmp_path, triangles, design=DESIGN):
    path = tmp_path / "part.stl"
    write_stl(path, triangles)
    return place(design, list_files(path).hashed().subjects[0], read_mesh(path), None)


def judged(tmp_path, triangles, design=DESIGN, **options):
    path = tmp_path / "part.stl"
    write_stl(path, triangles)
    return verify(design, path, rays=RAYS, **options)


def states(report):
    return {c.id: c.state for c in report.checks if c.subject == "part.stl"}


MOTIONS = {
    "as written": (np.eye(3), [0.0, 0.0, 0.0]),
    "set down elsewhere": (np.eye(3), [50.0, 20.0, 3.0]),
    "axes exchanged": (CYCLE, [1.0, 2.0, 3.0]),
    "upside down, moved": (np.diag([1.0, -1.0, -1.0]), [4.0, 0.0, 9.0]),
    "turned a little": (turn(0.7, 0) @ turn(-0.4, 2), [1.0, 2.0, 3.0]),
    "turned a lot": (CYCLE @ turn(4.0, 1), [10.0, -3.0, 0.0]),
}


@pytest.mark.daily_cases("as written")
@pytest.mark.parametrize("name", [
    "as written", "upside down, moved", "turned a lot",
    *(pytest.param(n, marks=pytest.mark.long) for n in ("set down elsewhere", "axes exchanged", "turned a little")),
])  # fmt: skip
def test_the_pose_is_found_and_undone(tmp_path, soup, name):
    rotation, move = MOTIONS[name]
    placed = found(tmp_path, soup @ rotation.T + move)
    back = np.concatenate(list(placed.mesh.chunks())) * placed.factor
    assert np.abs(back - soup).max() < 3e-4  # a fiftieth of the sag, over the whole part
    assert placed.window.lattice.count == (7, 5)
    assert {c.id: c.state for c in placed.checks}["handedness"] == "pass"
    assert placed.exact == (name == "as written")


@pytest.mark.long
@pytest.mark.parametrize(("metres", "word"), [(1e-3, "mm"), (1.0, "m"), (1e-6, "um"), (0.0254, "in")])
def test_the_unit_is_found_with_the_part_turned(tmp_path, soup, metres, word):
    placed = found(tmp_path, (soup @ CYCLE.T) * (1e-3 / metres))
    assert placed.pose.unit == word
    assert placed.pose.scale == pytest.approx(1.0, abs=1e-4)


@pytest.mark.slow
def test_shrinkage_is_found_as_a_scale_and_judged(tmp_path, soup):
    report = judged(tmp_path, soup * 0.995)
    assert states(report)["scale"] == "fail"
    assert states(report)["shape"] == "pass"
    scale = next(c for c in report.checks if c.id == "scale").detail["scale"]
    assert scale == pytest.approx(0.995, abs=2e-5)


@pytest.mark.long
def test_a_piece_cut_across_cells_is_judged_by_its_whole_cells(tmp_path, soup):
    window = prescribe(DESIGN.with_cells((12, 12)))
    middle = (whole := sheet_facets(window, 12)).mean(axis=1)
    keep = (np.abs(middle[:, 0] - 0.3) < 2.2) & (np.abs(middle[:, 1] + 0.9) < 1.7)
    placed = found(tmp_path, whole[keep] + [7.0, 8.0, 9.0])
    # −1.9 … 2.5 holds four columns at most, −2.6 … 0.8 three rows; the arrays' displacement may cost one each
    assert placed.window.lattice.count[0] in (3, 4)
    assert placed.window.lattice.count[1] in (2, 3)
    assert not placed.whole
    report = judged(tmp_path, whole[keep] + [7.0, 8.0, 9.0])
    assert states(report)["closed"] == "warn"
    assert {states(report)[name] for name in ("pose", "shape", "scale", "scan_light")} == {"pass"}


@pytest.mark.slow
def test_a_scan_goes_through(tmp_path, soup):
    """Jitter of 1e-4 pitch, corners not merged, facets of all shapes, holes, any pose."""
    generator = np.random.default_rng(3)
    split = irregular(sheet_facets(prescribe(DESIGN), 24), generator)
    split = split + generator.normal(0.0, 1e-4, split.shape)
    middle = split.mean(axis=1)
    for _ in range(6):
        hole = split[generator.integers(len(split))].mean(axis=0)
        keep = np.linalg.norm(middle - hole, axis=1) > 0.15
        split, middle = split[keep], middle[keep]
    report = judged(tmp_path, split @ CYCLE.T + [3.0, 1.0, 4.0])
    about = states(report)
    assert about["closed"] == "warn"
    assert {about[n] for n in ("handedness", "scale", "shape", "scan_light", "scan_seam")} == {"pass"}
    assert about["pose"] == "warn"  # it lies turned
    assert not any(name.startswith(("file_", "faithful_")) for name in about)  # light is that of its lenslets
    assert report.passed
    mapped = report.files[0].mesh.facts["deviation"]
    # jitter, and what lies between corner and face where a facet was split
    assert all(1e-4 < face.noise < 2e-4 for face in mapped.faces)


def irregular(triangles, generator):
    """Split half of the facets at random inner points: a triangulation nobody would choose."""
    weights = generator.dirichlet([2.0, 2.0, 2.0], len(triangles))
    inner = np.einsum("tk,tkx->tx", weights, triangles)
    chosen = generator.random(len(triangles)) < 0.5
    parts = [triangles[~chosen]]
    for k in range(3):
        piece = triangles[chosen].copy()
        piece[:, k] = inner[chosen]
        parts.append(piece)
    return np.concatenate(parts)


@pytest.mark.long
def test_a_slicers_repair_is_the_part_and_its_rounding_is_held_against_its_light(tmp_path):
    manifold3d = pytest.importorskip("manifold3d")
    fine = sheet_facets(prescribe(DESIGN), 24)
    vertices, index = np.unique(np.float32(fine).reshape(-1, 3), axis=0, return_inverse=True)
    mesh = manifold3d.Mesh(vertices, index.reshape(-1, 3).astype(np.uint32))
    repaired = manifold3d.Manifold(mesh).simplify(3e-4).to_mesh()
    corners = repaired.vert_properties[:, :3][repaired.tri_verts]
    assert len(corners) < 0.95 * len(fine)
    on_the_bed = corners.reshape(-1, 3) + [0.0, 0.0, 0.1]
    five = np.array([[float(f"{v:.5g}") for v in row] for row in on_the_bed]).reshape(-1, 3, 3)
    report = judged(tmp_path, five)
    about = states(report)
    assert about["pose"] == "pass"
    assert {about[n] for n in ("handedness", "scale", "shape", "faithful_eta", "faithful_delta")} == {"pass"}
    # five digits are noise of half a unit in the last: 15 mrad of light where facets of that size make 9
    assert about["faithful_rms"] == "fail"
    assert report.word == "failed"
    # as a scan its light is within the limits, but the texture of the rounding is beyond what its formula holds for
    scanned = judged(tmp_path, five, role="scan")
    assert states(scanned)["scan_light"] == "pass"
    (form,) = (check for check in scanned.checks if check.state == "fail")
    assert form.id == "scan_form"
    assert "above 1 rad" in form.sentence


@pytest.mark.slow
@pytest.mark.parametrize(("change", "culprits"), [
    pytest.param({"law.delta": [-0.01, 0.005]}, {"handedness"}, id="mirrored by its design", marks=pytest.mark.long),
    pytest.param({"law.delta": [-0.01, -0.005]}, {"pose"}, id="delta of the other sign"),
    pytest.param({"law.eta": [-0.51, -1.0]}, {"shape", "faithful_eta"}, id="eta off by 2 %", marks=pytest.mark.long),
    pytest.param({"pair.index": 1.515}, {"scale", "shape", "faithful_eta"}, id="another index", marks=pytest.mark.long),
])  # fmt: skip
def test_wrong_parts_are_named(tmp_path, change, culprits):
    report = judged(tmp_path, sheet_facets(prescribe(DESIGN.replace(change)), 24))
    assert not report.passed
    assert culprits & {c.id for c in report.checks if c.state == "fail"}


@pytest.mark.slow
def test_a_mirrored_part_fails_handedness(tmp_path, soup):
    report = judged(tmp_path, (soup * [-1.0, 1.0, 1.0])[:, ::-1] + [30.0, 0.0, 0.0])
    assert states(report)["handedness"] == "fail"


@pytest.mark.slow
def test_a_radius_one_percent_off_is_caught(tmp_path):
    """Lens 1's curvature alone: every height of the front face a hundredth too small."""
    window = prescribe(DESIGN)
    triangles = sheet_facets(window, 24)
    front = window.bodies[0].front
    apex = front.vertex[2]
    wrong = triangles.copy()
    near = np.abs(triangles[..., 2] - apex) < 0.2 * abs(window.z_range[1] - window.z_range[0])
    wrong[..., 2] = np.where(near, apex + (triangles[..., 2] - apex) / 1.01, triangles[..., 2])
    report = judged(tmp_path, wrong)
    assert {"shape", "faithful_eta"} & {c.id for c in report.checks if c.state == "fail"}


@pytest.mark.slow
def test_a_tilt_of_the_wrong_sign_is_named(tmp_path):
    tilted = DESIGN.replace({"law.euler": [0.0, 1.0, 0.0], "law.delta": [0.0, 0.0]})
    wrong = tilted.replace({"law.euler": [0.0, -1.0, 0.0]})
    from clacad.mesh import tessellate

    mesh = tessellate(prescribe(wrong), quads=12)
    report = judged(tmp_path, mesh.vertices[mesh.triangles], tilted)
    pose = next(c for c in report.checks if c.id == "pose")
    assert pose.state == "fail"
    assert "turned" in pose.sentence


@pytest.mark.long
def test_a_damaged_cell_is_found(tmp_path, soup):
    middle = soup.mean(axis=1)
    dent = (np.abs(middle[:, 0] - 2.0) < 0.5) & (np.abs(middle[:, 1] + 1.0) < 0.5)
    generator = np.random.default_rng(1)
    scan = soup + generator.normal(0.0, 1e-5, soup.shape)
    lower = scan.copy()
    lower[dent, :, 2] -= 2e-3
    good, bad = judged(tmp_path, scan), judged(tmp_path, lower)
    assert states(good)["shape"] == "pass"
    assert states(bad)["shape"] == "fail"


def test_the_cell_that_stands_out_most_is_told_by_its_depth_and_by_what_its_like_have(soup):
    middle = soup.mean(axis=1)
    dent = (np.abs(middle[:, 0] - 2.0) < 0.5) & (np.abs(middle[:, 1] + 1.0) < 0.5)
    scan = soup + np.random.default_rng(1).normal(0.0, 1e-4, soup.shape)
    window, bodies = prescribe(DESIGN), ("array1", "array2")
    value, most = deviation_map(window, "mm", [scan], bodies, len(scan)).worst_cell(1e-4)
    assert value <= most
    scan[dent, :, 2] -= 2e-2
    value, most = deviation_map(window, "mm", [scan], bodies, len(scan)).worst_cell(1e-4)
    assert value == pytest.approx(
        2e-2, rel=0.05
    )  # what was put in, less the slope of the lens and noise of 1e-4
    assert 0.0 < most < 2e-3


@pytest.mark.slow
def test_the_numbers_of_a_failed_scan_are_those_of_its_failure(tmp_path, soup):
    """A dent in one cell of a noisy scan: the faces are right on average, and only that cell is not."""
    middle = soup.mean(axis=1)
    dent = (np.abs(middle[:, 0] - 2.0) < 0.5) & (np.abs(middle[:, 1] + 1.0) < 0.5)
    scan = soup + np.random.default_rng(1).normal(0.0, 1e-4, soup.shape)
    scan[dent, :, 2] -= 2e-2
    report = judged(tmp_path, scan, role="scan")
    failed = [c for c in report.checks if c.state == "fail" and c.relation == "<="]
    shape = next(c for c in failed if c.id == "shape")
    assert shape.value == pytest.approx(2e-2, rel=0.05)  # the depth that was put in, noise of 1e-4 aside
    assert all(c.value > c.limit for c in failed if isinstance(c.value, float))
    (verdict,) = report.verdicts
    assert verdict.word == "failed"
    assert verdict.rms == report.measured.light.rms  # of the form: the dent met light, and is none
    assert verdict.rms < verdict.limit


def test_something_else_cannot_be_registered(tmp_path, soup):
    for wrong in (soup * [1.0, 1.0, 3.0], soup[:40]):
        with pytest.raises(CannotRegister, match=r"measures .* mm"):
            found(tmp_path, wrong)


def test_facets_cut_to_a_cell_keep_its_area_and_their_side():
    generator = np.random.default_rng(0)
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    grid = np.linspace(-0.9, 0.9, 8)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    points = np.stack([x, y, 0.3 * x - 0.2 * y], axis=-1)
    points[1:-1, 1:-1, :2] += generator.uniform(-0.1, 0.1, (6, 6, 2))
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    facets = np.concatenate([np.stack([a, b, c], axis=-2), np.stack([a, c, d], axis=-2)]).reshape(-1, 3, 3)
    cut = cut_to(facets, square)
    first, second = cut[:, 1, :2] - cut[:, 0, :2], cut[:, 2, :2] - cut[:, 0, :2]
    area = 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    assert (area >= -1e-15).all()
    assert area.sum() == pytest.approx(1.0, rel=1e-12)


def labels(mapped, found):
    """Texts next to the axes of the picture of a map."""
    from matplotlib.figure import Figure

    figure = Figure()
    _draw(figure, mapped, "part.stl")
    for axes in figure.axes:
        found += [axes.get_xlabel(), axes.get_ylabel()]


@pytest.mark.slow
def test_the_deviation_map_is_a_picture_and_a_table(soup):
    generator = np.random.default_rng(1)
    scan = soup + generator.normal(0.0, 1e-4, soup.shape)
    mapped = deviation_map(prescribe(DESIGN), "mm", [scan], ("array1", "array2"), len(scan))
    assert [face.name for face in mapped.faces] == [
        "array1 front",
        "array1 back",
        "array2 front",
        "array2 back",
    ]
    table = mapped.to_dict()
    assert np.array(table["faces"][0]["folded"], dtype=float).shape == (16, 16)
    assert np.array(table["faces"][0]["cells"], dtype=float).shape == (7, 5)
    assert table["unit_mm"] == 1.0
    lattice = prescribe(DESIGN).lattice
    np.testing.assert_allclose(
        mapped.steps, lattice.centres(np.array([[1, 1]]))[0] - lattice.centres(np.array([[0, 0]]))[0]
    )
    drawn_in_units = []
    labels(mapped, drawn_in_units)
    assert any("rms deviation / µm" in text for text in drawn_in_units)
    assert any("mm" in text and text.startswith("cell i") for text in drawn_in_units)
    first = plot_deviation(mapped, "part.stl")
    assert first.startswith(b"\x89PNG")
    assert first == plot_deviation(mapped, "part.stl")


@pytest.mark.long
def test_a_step_file_of_a_few_cells_is_found_turned_and_elsewhere(tmp_path):
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
    from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
    from OCP.STEPControl import STEPControl_AsIs, STEPControl_Writer

    from clacad.exporting.run import export
    from clacad.formats.step.read_back import occ_shape

    export(DESIGN.with_cells((4, 3)), tmp_path / "made", ("step",))
    made = next((tmp_path / "made").glob("*.step"))
    turned, moved = gp_Trsf(), gp_Trsf()
    turned.SetRotation(gp_Ax1(gp_Pnt(0, 0, 0), gp_Dir(1, 1, 1)), 2.0 * np.pi / 3.0)
    moved.SetTranslation(gp_Vec(5, 6, 7))
    moved.Multiply(turned)
    writer = STEPControl_Writer()
    writer.Transfer(BRepBuilderAPI_Transform(occ_shape(made), moved, True).Shape(), STEPControl_AsIs)
    writer.Write(str(tmp_path / "part.step"))
    report = verify(DESIGN, tmp_path / "part.step", rays=RAYS)
    about = {c.id: c for c in report.checks if c.subject == "part.step"}
    assert about["pose"].state == "warn"
    assert "x → z" in about["pose"].sentence
    assert "4 x 3 cells" in report.files[0].note
    assert {
        about[n].state
        for n in ("readable", "closed", "handedness", "scale", "shape", "faithful_rms", "file_law_eta")
    } == {"pass"}
    assert about["shape"].limit < 2e-5
    (tmp_path / "bare.step").write_bytes(made.read_bytes())
    exact = {
        c.id: c for c in verify(DESIGN, tmp_path / "bare.step", rays=RAYS).checks if c.subject == "bare.step"
    }
    assert exact["shape"].value < 1e-9  # where the design lies, STEP is judged exactly
    assert exact["volume"].state == exact["pose"].state == "pass"
