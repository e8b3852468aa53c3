"""Name and arrow engraved into mesh files: the optics untouched, one closed solid, the letters of the STEP bodies."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from slicing import assert_nothing_repaired, slicer_for

import clacad
from clacad.base.polygons import polygon_area
from clacad.cli import main
from clacad.exporting.fixtures import NoFixture, engraved_mesh, engravings, mark_place, marked_solids
from clacad.exporting.fixtures.engraving import CHORD, Engraving, polygons
from clacad.exporting.roles import Role
from clacad.exporting.run import export
from clacad.formats.mesh.readers import read_mesh
from clacad.formats.mesh.stl import FACET, HEADER, write_stl
from clacad.judging.delivery import Inspection, list_files
from clacad.judging.judge_part import judge_placed
from clacad.judging.registration import place
from clacad.mesh import check_closed
from clacad.solid.marks import line_sketch, pockets
from clacad.storage.errors import NotPossible
from clacad.verification import verify

DESIGNS = Path(__file__).parents[2] / "designs"
BORDERED = ["body.border=2", "lattice.count=[4,4]"]


def window_of(name: str, overrides: list[str]):
    return clacad.prescribe(clacad.load(DESIGNS / f"{name}.toml", overrides=overrides))


def corners(mesh) -> np.ndarray:
    return np.concatenate(list(mesh.rows()))


def own_volume(facets: np.ndarray) -> float:
    """Divergence sum of triangles (n, 3, 3) about their middle, in long double."""
    a, b, c = np.moveaxis((facets - facets.mean(axis=(0, 1))).astype(np.longdouble), 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


# -- the mesh -----------------------------------------------------------------------------------------------


@pytest.mark.ci_cases("displaced slab", "disc", "unit of a metre")
@pytest.mark.daily_cases("hexagonal")
@pytest.mark.parametrize(
    "case",
    [
        ("tilted-biconvex", BORDERED),
        ("tilted", BORDERED),
        ("hexagonal", ["body.border=1", "lattice.count=[5,4]", "lattice.kind='hexagonal'"]),
        ("plano", ["lattice.outline={circle=6}", "lattice.count=[20,20]"]),
        ("plano", [*BORDERED, "pair.curved='inside'"]),
        ("paper-a-covered", ["body.border=0.02", "lattice.count=[4,4]"]),
        pytest.param(("window-100mm", ["body.border=5"]), marks=pytest.mark.long),
    ],
    ids=["biconvex", "displaced slab", "hexagonal", "disc", "curved inside", "unit of a metre", "200 x 200"],
)  # fmt: skip
def test_an_engraved_mesh_is_one_solid_that_lost_its_letters_and_nothing_of_its_lenses(case) -> None:
    manifold3d = pytest.importorskip("manifold3d")
    trimesh = pytest.importorskip("trimesh")
    name, overrides = case
    window = window_of(name, overrides)
    mm = window.unit * 1e3
    drawn = engravings(window, window.name)
    for plain in clacad.tessellate(window, quads=4).bodies:
        drawing = drawn[plain.name]
        made = engraved_mesh(plain, drawing)
        # every facet of the cells, to the bit and in its place; of the border, back and side wall are there too
        before, after = corners(plain), corners(made)
        cells = plain.facet_count - len(plain.ring().triangles)
        assert after[:cells].tobytes() == before[:cells].tobytes()
        kept = {facet.tobytes() for facet in after}
        level = plain.ring().vertices[plain.ring().triangles[0, 0], 2]
        lost = [facet for facet in before if facet.tobytes() not in kept]
        assert lost
        assert all((facet[:, 2] == level).all() for facet in lost)
        # closed, as written and in single precision, for three readers
        single = (after * mm).astype(np.float32)
        for facets in (after, single):
            health = check_closed(facets)
            assert health.closed
            assert health.pieces == 1
        part = trimesh.Trimesh(**trimesh.triangles.to_kwargs(single))
        assert part.is_watertight
        assert part.is_winding_consistent
        solid = manifold3d.Manifold(
            manifold3d.Mesh64(
                vert_properties=np.asarray(part.vertices, dtype=np.float64),
                tri_verts=part.faces.astype("uint64"),
            )
        )
        assert solid.status() == manifold3d.Error.NoError
        assert len(solid.decompose()) == 1
        assert solid.volume() == pytest.approx(own_volume(single.astype(np.float64)), rel=1e-12)
        # what is gone is area times depth: the depth is good to half a step of heights, corners to half of float32's
        gone = (own_volume(before) - own_volume(after)) * mm**3
        expected = sum(polygon_area(loop) for loop in drawing.loops) * drawing.depth
        reach = float(np.abs(before).max()) * mm
        rim = sum(np.hypot(*np.diff(loop, axis=0, append=loop[:1]).T).sum() for loop in drawing.loops)
        bound = drawing.area * 0.5 * plain.step * mm + drawing.depth * rim * 2.0**-23 * reach
        assert abs(gone - expected) <= 1.01 * bound + 1e-12 * own_volume(before) * mm**3
        assert bound < 1e-3 * expected


@pytest.mark.slow
def test_the_letters_are_those_of_the_step_body_as_deep_and_at_their_place() -> None:
    window = window_of("plano", BORDERED)
    drawn = engravings(window, "ab 1")
    for body, part in zip(window.bodies, marked_solids(window, "ab 1").values(), strict=True):
        drawing, place = drawn[body.name], mark_place(window, body)
        assert drawing.depth == place.depth
        level = place.centre[2] + place.depth
        floors = [f for f in part.faces() if abs(f.center().Z - level) < 1e-6 * place.depth]
        outer = [loop for loop in drawing.loops if polygon_area(loop) > 0.0]
        inner = [loop for loop in drawing.loops if polygon_area(loop) < 0.0]
        assert len(outer) == len(floors) == len("ab1array1VIEWERSIDE") + 1
        assert len(inner) == sum(len(f.inner_wires()) for f in floors) > 0
        boxes = sorted((b.min.X, b.max.X, b.min.Y, b.max.Y) for b in (f.bounding_box() for f in floors))
        mine = sorted((*np.sort([p[:, 0].min(), p[:, 0].max()]), p[:, 1].min(), p[:, 1].max()) for p in outer)
        np.testing.assert_allclose(mine, boxes, atol=2.0 * drawing.chord)
        assert drawing.area == pytest.approx(sum(f.area for f in floors), rel=0.02)


def test_chords_stay_within_their_stated_distance_of_the_curves() -> None:
    from build123d import Circle, Ellipse

    for shape, radii in ((Circle(3.0), (3.0, 3.0)), (Ellipse(4.0, 1.0), (4.0, 1.0))):
        for chord in (0.1, 1e-3):
            (loop,) = polygons(shape, chord)
            middles = 0.5 * (loop + np.roll(loop, -1, axis=0))
            # a point at u inside the ellipse lies within (1 − |u|) times the longer radius of it
            assert (1.0 - np.hypot(*(middles / radii).T)).max() * max(radii) < 1.3 * chord * max(radii) / min(
                radii
            )
            np.testing.assert_allclose(np.hypot(*(loop / radii).T), 1.0, atol=1e-9)
            assert polygon_area(loop) > 0.0
    line = line_sketch("S o 8", 20.0, 2.0)
    coarse, fine = (
        sum(map(polygon_area, polygons(line, chord))) for chord in (2.0 * CHORD, 2.0 * CHORD / 64)
    )
    length = sum(np.hypot(*np.diff(p, axis=0, append=p[:1]).T).sum() for p in polygons(line, 2.0 * CHORD))
    assert abs(coarse - fine) < 2.0 * CHORD * length


def test_the_viewer_reads_an_arrow_up_and_then_the_name() -> None:
    window = window_of("plano", BORDERED)
    loops = engravings(window, "L F")["array1"].loops
    # the viewer is at -z with +y up and sees +x on the left
    arrow, letter_l, letter_f = sorted(
        (p for p in loops if polygon_area(p) > 0.0), key=lambda p: -p[:, 0].mean()
    )[:3]
    tip = arrow[arrow[:, 1].argmax()]
    assert abs(tip[0] - 0.5 * (arrow[:, 0].min() + arrow[:, 0].max())) < 1e-9
    assert (arrow[:, 1] == arrow[:, 1].max()).sum() == 1
    for letter, end in ((letter_l, 1.0), (letter_f, -1.0)):  # the foot of an L, the top of an F are wide
        far = letter[end * letter[:, 1] > (end * letter[:, 1]).max() - 1e-9, 0]
        middle = 0.5 * (letter[:, 0].min() + letter[:, 0].max())
        assert far.min() > middle  # the narrow end is the upright's: on the viewer's left
    assert arrow[:, 1].mean() < window.lattice.extent()[2]  # below the cells


def test_drawings_come_back_from_the_worker_to_the_bit() -> None:
    loops = (np.array([[0.1, 0.2], [1 / 3, 0.2], [0.1, np.pi]]),)
    drawing = Engraving("x", loops, 0.1, 1e-3)
    told = Engraving.from_dict(json.loads(json.dumps(drawing.to_dict())))
    assert told.loops[0].tobytes() == loops[0].tobytes()
    assert (told.text, told.depth, told.chord) == ("x", 0.1, 1e-3)


def test_letters_that_touch_or_leave_the_border_are_refused() -> None:
    window = window_of("plano", BORDERED)
    mesh = clacad.tessellate(window, quads=2).bodies[0]
    place = mark_place(window, window.bodies[0])
    square = np.array([[0.0, 0.0], [0.2, 0.0], [0.2, 0.2], [0.0, 0.2]])
    here = square + place.centre[:2]
    with pytest.raises(NoFixture, match="touch"):
        engraved_mesh(mesh, Engraving("x", (here, here + 0.2), 0.1, 1e-3))
    with pytest.raises(NoFixture, match="cross"):
        engraved_mesh(mesh, Engraving("x", (here, here + 0.1), 0.1, 1e-3))
    for aside in ((0.0, 2.0), (0.0, -2.0), (20.0, 0.0)):
        with pytest.raises(RuntimeError, match="no room"):
            engraved_mesh(mesh, Engraving("x", (here + aside,), 0.1, 1e-3))
    assert check_closed(corners(engraved_mesh(mesh, Engraving("x", (here,), 0.1, 1e-3)))).closed


# -- the files ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    design = clacad.load(DESIGNS / "plano.toml", overrides=BORDERED)
    folder = tmp_path_factory.mktemp("marks") / "x"
    return design, export(design, folder, ("marked-stl", "marked-3mf", "stl-parts"), quads=8)


def entry_of(manifest, name: str):
    return next(entry for entry in manifest.files if entry["name"] == name)


def test_the_manifest_says_what_was_engraved_and_the_files_agree(exported) -> None:
    design, manifest = exported
    names = ["plano.array1.marked.stl", "plano.array2.marked.stl", "plano.marked.3mf"]
    assert [e["name"] for e in manifest.files if "marks" in e] == names
    for name in names:
        entry = entry_of(manifest, name)
        facets = np.concatenate(list(read_mesh(manifest.folder / name).chunks()))
        assert len(facets) == entry["triangles"]
        assert own_volume(facets) == pytest.approx(entry["volume"], rel=1e-9)
        plain = sum(entry_of(manifest, f"plano.{body}.stl")["volume"] for body in entry["bodies"])
        taken = sum(entry["marks"][body]["volume"] for body in entry["bodies"])
        assert plain - entry["volume"] == pytest.approx(taken, rel=1e-3)
        assert set(entry["checks"]) == {"closed", "volume", "shape"}
        assert entry["marks"]["array" + "12"["array2" in name]]["text"].endswith("  VIEWER SIDE")
    assert [row["format"] for row in manifest.run["forecast"]] == ["marked-stl", "marked-3mf", "stl-parts"]
    for row, written in zip(manifest.run["forecast"], (names[:2], names[2:]), strict=False):
        size = sum(entry_of(manifest, name)["bytes"] for name in written)
        assert row["bytes"] == pytest.approx(size, rel=0.2)


def test_the_lens_facets_of_the_file_are_those_of_the_plain_file_byte_for_byte(exported) -> None:
    _, manifest = exported
    for body in ("array1", "array2"):
        plain, marked = (
            np.frombuffer(
                (manifest.folder / f"plano.{body}{kind}.stl").read_bytes()[HEADER + 4 :], dtype=FACET
            )
            for kind in ("", ".marked")
        )
        over = (np.abs(plain["corners"][..., :2]) <= 1.0 + 1e-6).all(
            axis=(1, 2)
        )  # 4 x 4 cells of half a millimetre
        lens = plain[over & (np.ptp(plain["corners"][..., 2], axis=1) > 0.0)]
        assert len(lens) >= 2 * 16 * 64
        there = {record.tobytes() for record in marked}
        assert all(record.tobytes() in there for record in lens)
        count = int(np.argmin(plain[: len(marked)] == marked[: len(plain)]))
        assert count >= len(lens)  # and in the same order, from the first on


@pytest.mark.slow
def test_the_same_design_gives_the_same_bytes(exported, tmp_path: Path) -> None:
    design, manifest = exported
    again = export(design, tmp_path / "y", ("marked-3mf", "marked-stl", "stl-parts"), quads=8)
    assert {e["name"]: e["sha256"] for e in again.files} == {e["name"]: e["sha256"] for e in manifest.files}


def test_other_libraries_read_the_3mf_as_two_closed_parts(exported) -> None:
    lib3mf = pytest.importorskip("lib3mf")
    _, manifest = exported
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.ReadFromFile(str(manifest.folder / "plano.marked.3mf"))
    assert reader.GetWarningCount() == 0
    objects = model.GetMeshObjects()
    found = []
    while objects.MoveNext():
        mesh = objects.GetCurrentMeshObject()
        assert mesh.IsManifoldAndOriented()
        found.append((mesh.GetName(), mesh.GetTriangleCount()))
    assert found == [
        (body, entry_of(manifest, f"plano.{body}.marked.stl")["triangles"]) for body in ("array1", "array2")
    ]


def test_a_slicer_finds_nothing_to_repair(exported) -> None:
    slicer = slicer_for("the engraved bodies")
    _, manifest = exported
    for name in ("plano.array1.marked.stl", "plano.array2.marked.stl"):
        assert_nothing_repaired(slicer, manifest.folder / name, entry_of(manifest, name))


def test_sliced_through_their_letters_the_layers_show_every_letter(tmp_path: Path) -> None:
    slicer = shutil.which("slic3r")
    if slicer is None:
        pytest.skip("slic3r is not installed: no slicer cut through the letters")
    window = window_of("plano", ["body.border=6"])  # strokes wider than a slicer closes
    body = window.bodies[0]
    drawing = engravings(window, window.name)[body.name]
    path = tmp_path / "part.stl"
    write_stl([engraved_mesh(clacad.tessellate(window, quads=2).bodies[0], drawing)], path, 1.0, "part")
    layers = ["--layer-height", "0.05", "--first-layer-height", "0.05", "--nozzle-diameter", "0.1"]
    subprocess.run([slicer, *layers, "--export-svg", "-o", str(tmp_path / "x.svg"), str(path)], check=True,
                   capture_output=True, timeout=120)  # fmt: skip
    level = mark_place(window, body).centre[2]
    outer = sum(polygon_area(loop) > 0.0 for loop in drawing.loops)
    seen = 0
    for layer in re.split(r'<g id="layer', (tmp_path / "x.svg").read_text())[1:]:
        height = 1e6 * float(re.search(r'slic3r:z="([^"]+)"', layer)[1])
        if height < level:  # lenses alone reach down there
            continue
        inside = height < level + drawing.depth
        seen += inside
        assert len(re.findall('type="hole"', layer)) == (outer if inside else 0)
        assert len(re.findall('type="contour"', layer)) == 1 + (len(drawing.loops) - outer if inside else 0)
    assert seen == 2


@pytest.mark.slow
def test_without_room_both_formats_say_what_is_missing_and_write_nothing(tmp_path: Path) -> None:
    bare = clacad.load(DESIGNS / "plano.toml", overrides=["lattice.count=[3,3]"])
    narrow = clacad.load(DESIGNS / "plano.toml", overrides=["lattice.count=[3,3]", "body.border=0.1"])
    for word in ("marked-stl", "marked-3mf"):
        with pytest.raises(NotPossible, match=r"no border to engrave: give body\.border a width"):
            export(bare, tmp_path / "x", (word,), quads=2)
        with pytest.raises(NotPossible, match=r"body\.border >= '0\.4 mm'"):
            export(narrow, tmp_path / "x", (word,), quads=2)
    with pytest.raises(NoFixture, match="a wider border, a shorter name, or more cells"):
        engravings(window_of("plano", ["lattice.count=[1,1]", "body.border=0.42"]), "n" * 80)
    assert not list(tmp_path.rglob("*.stl")) + list(tmp_path.rglob("*.3mf")) + list(tmp_path.rglob("*.json"))
    words = ["export", str(DESIGNS / "plano.toml"), "-o", str(tmp_path / "x"), "--format", "marked-stl"]
    assert main([*words, "--cells", "3x3"]) == 2


# -- verification -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_verification_accepts_engraved_files_and_states_what_the_letters_take(exported) -> None:
    design, manifest = exported
    report = verify(design, manifest.folder / "plano.marked.3mf", rays=2048, role="preview")
    assert not [check.id for check in report.checks if check.state == "fail" and check.where == "file"]
    (check,) = (check for check in report.checks if check.id == "volume")
    taken = sum(mark["volume"] for mark in entry_of(manifest, "plano.marked.3mf")["marks"].values())
    assert check.detail["engraved"] == pytest.approx(taken, rel=1e-3)
    assert "letters engraved in the border take" in check.sentence


def judged_alone(design, path: Path):
    """A file without a manifest: the bodies it is taken to hold, and its checks by name."""
    subject = list_files(path).hashed().subjects[0]
    placed = place(design, subject, read_mesh(path), None)
    found, _ = judge_placed(Inspection(design, path.name, 1024, role=Role.PREVIEW), placed)
    return placed, {check.id: check for check in found}


@pytest.mark.slow
@pytest.mark.parametrize("body", ["array1", "array2"])
def test_an_engraved_file_that_came_alone_is_known_by_its_shape(exported, tmp_path: Path, body: str) -> None:
    design, manifest = exported
    name = f"plano.{body}.marked.stl"
    shutil.copy(manifest.folder / name, tmp_path / "returned.stl")
    placed, checks = judged_alone(design, tmp_path / "returned.stl")
    assert placed.present == (body,)
    assert placed.exact
    assert not [check for check in checks.values() if check.state == "fail"]
    taken = entry_of(manifest, name)["marks"][body]["volume"]
    assert checks["volume"].detail["engraved"] == pytest.approx(taken, rel=1e-3)
    shutil.copy(manifest.folder / f"plano.{body}.stl", tmp_path / "plain.stl")
    assert "engraved" not in judged_alone(design, tmp_path / "plain.stl")[1]["volume"].detail


@pytest.mark.slow
def test_an_engraved_step_part_that_came_alone_has_lost_its_letters_and_nothing_else(tmp_path: Path) -> None:
    design = clacad.load(DESIGNS / "plano.toml", overrides=[*BORDERED, "lattice.count=[3, 3]"])
    export(design, tmp_path / "x", ("marked",))
    one = shutil.copy(tmp_path / "x" / "plano.array2.marked.step", tmp_path / "returned.step")
    checks = {
        check.id: check
        for check in verify(design, files=one, rays=1024, role="preview").checks
        if check.where == "file"
    }
    assert not [check for check in checks.values() if check.state == "fail"]
    assert "array2" in checks["volume"].sentence
    letters = engravings(clacad.prescribe(design), design.name)["array2"]
    assert checks["volume"].detail["engraved"] == pytest.approx(letters.area * letters.depth, rel=5e-3)


@pytest.mark.slow
def test_a_wide_thin_plate_alone_in_its_file_is_as_good_as_its_heights_are(tmp_path: Path) -> None:
    """Heights share the float32 spacing of the whole pair, coarse for a plate that lies at the origin."""
    text = """format = 1
name = "thin"
unit = "mm"
[law]
eta = [-0.5, -1.0]
[pair]
form = "biconvex"
separation = 10
index = 1.5
[lattice]
pitch = 0.5
count = [4, 4]
[body]
border = 4
"""
    (tmp_path / "thin.toml").write_text(text)
    design = clacad.load(tmp_path / "thin.toml")
    export(design, tmp_path / "x", ("stl-parts",), quads=16)
    one = shutil.copy(tmp_path / "x" / "thin.array1.stl", tmp_path / "returned.stl")
    report = verify(design, files=one, rays=1024, role="preview")
    assert not [check.id for check in report.checks if check.state == "fail"]


@pytest.mark.slow
def test_an_engraved_part_that_was_moved_is_found_where_it_lies(exported, tmp_path: Path) -> None:
    design, manifest = exported
    data = bytearray((manifest.folder / "plano.array2.marked.stl").read_bytes())
    np.frombuffer(data, dtype=FACET, offset=HEADER + 4)["corners"][...] += np.float32([10.0, 5.0, 3.0])
    (tmp_path / "returned.stl").write_bytes(data)
    placed, checks = judged_alone(design, tmp_path / "returned.stl")
    assert placed.present == ("array2",)
    np.testing.assert_allclose(placed.pose.move, [-10.0, -5.0, -3.0], atol=1e-4)
    assert not [check for check in checks.values() if check.state == "fail"]


@pytest.mark.daily_cases("elsewhere")
@pytest.mark.parametrize("change", ["deeper", "elsewhere"])
def test_letters_at_another_depth_or_place_are_not_taken_for_marks(
    exported, tmp_path: Path, change: str
) -> None:
    design, manifest = exported
    data = bytearray((manifest.folder / "plano.array1.marked.stl").read_bytes())
    corner = np.frombuffer(data, dtype=FACET, offset=HEADER + 4)["corners"]
    pocket = pockets(clacad.prescribe(design))[0]
    floor = np.abs(corner[..., 2] - pocket.floor) < 1e-5
    assert floor.any()
    if change == "deeper":
        corner[floor, 2] += np.float32(0.02)
    else:  # the whole line half a millimetre higher, out of its room
        line = ((corner[..., :2] > pocket.low) & (corner[..., :2] < pocket.high)).all(axis=-1)
        corner[line, 1] += np.float32(0.5)
    (tmp_path / "returned.stl").write_bytes(data)
    _, checks = judged_alone(design, tmp_path / "returned.stl")
    assert checks["closed"].state == "pass"
    assert "fail" in {checks["shape"].state, checks["volume"].state}
