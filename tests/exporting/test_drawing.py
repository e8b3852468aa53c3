"""Drawings opened again: by ezdxf, by the text of the PDF, against STEP's own box and the design's own numbers."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.exporting.drawing import views
from clacad.exporting.drawing.canvas import CHARACTER, CircleMark, DimensionMark, LineMark, Words
from clacad.exporting.drawing.sheet_layout import PAPERS, frame_box, sheets
from clacad.exporting.run import export
from clacad.sheet.feasibility import feasibility
from clacad.storage.errors import FileDisagrees, NotPossible

ezdxf = pytest.importorskip("ezdxf", reason="the extra dxf is not installed")
pytest.importorskip("typst", reason="the extra pdf is not installed")

DESIGNS = Path(__file__).parents[2] / "designs"
STATED = ["tolerances.radius=0.005", "tolerances.decentre='2 um'", "tolerances.roughness='5 nm'"]
OF_PAIRS = ["tolerances.thickness=['5 um','6 um']", "tolerances.separation='20 um'"]


def part(name, cells, *overrides):
    stated = STATED if name == "slab" else [*STATED, *OF_PAIRS]
    return clacad.load(DESIGNS / f"{name}.toml", overrides=[*stated, *overrides]).with_cells(cells)


def round_slab(cells=12, across=4.6):
    cut = [f"lattice.count=[{cells},{cells}]", f"lattice.outline={{circle={across}}}"]
    return clacad.load(DESIGNS / "slab.toml", overrides=cut)


def measured(path):
    """Words of each dimension and what lies between its points, mm of the part."""
    document = ezdxf.readfile(path)
    return [
        (one.dxf.text, float(np.asarray(one.get_measurement())) * one.override().get("dimlfac"))
        for one in document.modelspace().query("DIMENSION")
    ]


def texts(path):
    document = ezdxf.readfile(path)
    return [text.dxf.text for text in document.modelspace().query("TEXT")]


@pytest.mark.slow
@pytest.mark.parametrize(
    "design",
    [pytest.param(part("tilted-biconvex", (2, 2)), marks=pytest.mark.slow), round_slab(4, 1.6)],
    ids=["biconvex", "round slab"],
)
def test_dimensions_of_the_dxf_are_those_of_the_box_of_the_step_file(tmp_path, design):
    from build123d import Pos, Rectangle, import_step

    export(design, tmp_path / "x", ("drawing", "step"))
    shape = import_step(str(next((tmp_path / "x").glob("*.step"))))
    box = shape.bounding_box().size
    # the kernel's box misses an apex by half a micrometre: heights are distances to planes above and below
    plates = [Pos(0, 0, z) * Rectangle(9, 9) for z in (-30.0, 30.0)]
    height = 60.0 - sum(shape.distance_to(plate) for plate in plates)
    found = measured(next((tmp_path / "x").glob("*.dxf")))
    for size in (box.X, box.Y, height):
        assert any(value == pytest.approx(size, rel=1e-6) for _, value in found)
    for words, value in found:
        said = float(re.search(r"([\d.]+)( ±[\d.]+)?$", words)[1])
        assert said == pytest.approx(value, rel=1e-4, abs=1e-9)


@pytest.mark.slow
def test_a_drawn_plate_has_the_box_holes_corners_and_bends_of_its_step_file(tmp_path):
    from build123d import import_step
    from OCP.gp import gp_Cylinder
    from OCP.ShapeAnalysis import ShapeAnalysis_CanonicalRecognition

    polygon = [
        [-6, -5],
        [6, -5, 0.41421356237309503],
        [7, -4],
        [7, 4],
        [2, 4],
        [2, 5],
        [-6, 5],
        [-7, 4],
        [-7, -4],
    ]
    design = clacad.Design.from_dict({
        "format": 1, "name": "plate", "unit": "mm", "law": {"eta": [-1, -1]},
        "pair": {"form": "plano", "separation": 14, "thickness": 1.5, "material": "PMMA"},
        "lattice": {"pitch": 1.0, "outline": {"polygon": polygon}},
        "body": {"holes": [{"diameter": 0.8, "circle": 8, "count": 4}], "pins": {"diameter": 1, "at": [[-5.5, 2.5], [5.5, -2.5]], "play": "20 um"}},
    })  # fmt: skip
    export(design, tmp_path / "x", ("drawing", "step"))
    shape = import_step(str(next((tmp_path / "x").glob("*.step"))))
    drawn = next((tmp_path / "x").glob("*.dxf"))
    box = shape.bounding_box().size
    found = [value for _, value in measured(drawn)]
    for size in (box.X, box.Y):
        assert any(value == pytest.approx(size, rel=1e-6) for value in found)
    round_ones = set()
    for face in (face for solid in shape.solids() for face in solid.faces()):
        found_cylinder = (
            gp_Cylinder()
        )  # the file holds rational quarters; the kernel reports which cylinder they belong to
        if ShapeAnalysis_CanonicalRecognition(face.wrapped).IsCylinder(1e-7, found_cylinder):
            at = found_cylinder.Location()
            place = (float(f"{v:.5g}") if abs(v) > 1e-9 else 0.0 for v in (at.X(), at.Y()))
            round_ones.add((*place, f"{2 * found_cylinder.Radius():.5g}"))
    said = texts(drawn)
    first = said.index("hole") + 5
    rows = [said[first + 5 * k : first + 5 * k + 5] for k in range(6)]
    holes = {(float(x), float(y), diameter) for _, x, y, diameter, _ in rows}
    assert [use for *_, use in rows] == ["mounting"] * 4 + ["pin 1, play 0.02"] * 2
    assert holes == {(x, y, d) for x, y, d in round_ones if float(d) < 1.5}
    assert round_ones - holes == {(6.0, -4.0, "2")}  # the bend: R 1 about (6, -4)
    corners = said[said.index("corner") + 4 :]
    assert [[float(v) for v in corners[4 * k + 1 : 4 * k + 3]] for k in range(9)] == [p[:2] for p in polygon]
    assert corners[7] == "outwards, R 1"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="pdftotext is not installed")
def test_the_text_of_the_pdf_holds_sizes_tolerances_radii_conics_and_sags(tmp_path):
    design = part("tilted-biconvex", (3, 2))
    window = clacad.prescribe(design)
    export(design, tmp_path / "x", ("drawing",), paper="a2")
    (pdf,) = (tmp_path / "x").glob("*.pdf")
    done = subprocess.run(["pdftotext", "-layout", str(pdf), "-"], capture_output=True, text=True, check=True)
    text = done.stdout
    assert "tilted-biconvex" in text
    assert "Rq at most 5 nm" in text
    assert "PMMA" in text
    for words, _ in measured(next((tmp_path / "x").glob("*.dxf"))):
        assert words in text
    for body in window.bodies:
        for face in (body.front, body.back):
            surface = face.surface
            radius = face.side / surface.curvature_x
            assert f"{radius:.5g} ±{0.005 * abs(radius):.2g}" in text
            assert f"{surface.kappa / surface.curvature_y - 1:.5g}" in text
            y = window.lattice.circumradius  # the last row: the sag at the corner's distance
            q = surface.curvature_y * y * y
            assert f"{face.side * q / (1 + np.sqrt(1 - surface.kappa * q)):.6g}" in text
    assert "0.045529 ±0.005" in text
    assert re.search(r"0\.0563\d+ ±0\.006", text)


@pytest.mark.ci_cases("tilted-biconvex-a4", "plano-a2", "slab-a3")
@pytest.mark.daily_cases("plano-a3", "slab-a4")
@pytest.mark.parametrize("paper", PAPERS)
@pytest.mark.parametrize("name", ["tilted-biconvex", "plano", "slab"])
def test_nothing_on_a_sheet_overlaps_or_leaves_the_frame(paper, name):
    design = part(name, (6, 6))
    window = clacad.prescribe(design)
    for sheet in sheets(design, window, feasibility(window), paper, None):
        boxes = [
            (one.x, one.y, one.x + one.canvas.width * sheet.unit, one.y + one.canvas.height * sheet.unit)
            for one in sheet.placed
        ]
        left, top, right, bottom = frame_box(PAPERS[paper])
        for k, (x0, y0, x1, y1) in enumerate(boxes):
            assert x0 >= left - 1e-9
            assert y0 >= top - 1e-9
            assert x1 <= right + 1e-9
            assert y1 <= bottom + 1e-9
            for u0, v0, u1, v1 in boxes[:k]:
                assert x1 <= u0 or u1 <= x0 or y1 <= v0 or v1 <= y0


def test_the_title_of_the_section_counts_the_cells_of_the_row_that_is_drawn():
    window = clacad.prescribe(round_slab())
    title = views.row_text(window)
    drawn = window.lattice.centres(window.lattice.row(6))
    kept = int((np.hypot(np.abs(drawn[:, 0]) + 0.25, np.abs(drawn[:, 1]) + 0.25) <= 2.3 + 1e-9).sum())
    assert title.startswith(f"{kept} cells of 0.5 in the row shown (of 12 x 12")
    assert views.row_text(clacad.prescribe(part("slab", (5, 3)))) == "5 cells of 0.5"


@pytest.mark.slow
def test_what_an_error_costs_is_taken_from_the_study_of_this_very_design(tmp_path):
    design = part("slab", (4, 4))
    study = {
        "kind": "tolerances", "format": 1, "design": {"name": "slab", "sha256": design.sha256},
        "parameters": [{"name": "decentre.1.x", "key": "decentre", "tolerance": 0.002, "unit": "mm", "one_sided": False}],
        "ranking": {"law_rms": [{"parameter": "decentre.1.x", "change": 0.0123, "share": 1.0}]},
    }  # fmt: skip
    for sha, shown in ((design.sha256, True), ("0" * 64, False)):
        folder = tmp_path / sha[:4]
        folder.mkdir()
        study["design"]["sha256"] = sha
        (folder / "tolerances.json").write_text(json.dumps(study))
        manifest = export(design, folder, ("drawing",))
        said = texts(next(folder.glob("*.dxf")))
        assert ("12.3" in said) is shown
        assert ("not studied" in said) is not shown
        assert all(entry["tolerance_study"] is shown for entry in manifest.files)


@pytest.mark.slow
def test_the_same_design_gives_the_same_bytes_and_a_false_dimension_is_refused(tmp_path):
    from clacad.exporting.drawing.sheet_files import check_drawing_dxf

    design = part("slab", (4, 4))
    for folder in ("a", "b"):
        export(design, tmp_path / folder, ("drawing",))
    one, two = (sorted(p.read_bytes() for p in (tmp_path / f).glob("slab.*")) for f in ("a", "b"))
    assert one == two
    (path,) = (tmp_path / "a").glob("*.dxf")
    count = len(measured(path))
    check_drawing_dxf(path, count)
    text = path.read_text(encoding="utf-8")
    assert "\n14.936" in text
    path.write_text(text.replace("\n14.936", "\n15.936"), encoding="utf-8")
    with pytest.raises(FileDisagrees, match="a dimension says"):
        check_drawing_dxf(path, count)


@pytest.mark.slow
def test_neither_hash_seed_nor_home_changes_a_byte_of_the_dxf(tmp_path):
    script = (
        "import sys; from pathlib import Path; import clacad\n"
        "from clacad.exporting.drawing.sheet_files import write_drawing_dxf\n"
        "from clacad.exporting.drawing.sheet_layout import sheets\n"
        "from clacad.sheet.feasibility import feasibility\n"
        f"design = clacad.load({str(DESIGNS / 'slab.toml')!r}).with_cells((2, 2)); window = clacad.prescribe(design)\n"
        "write_drawing_dxf(sheets(design, window, feasibility(window), 'a3', None), Path(sys.argv[1]))\n"
    )
    found = []
    for seed in ("1", "4242"):
        home = tmp_path / seed
        home.mkdir()
        changed = {
            "PYTHONHASHSEED": seed,
            "HOME": str(home),
            "XDG_CACHE_HOME": str(home),
            "TZ": "Pacific/Auckland",
        }
        subprocess.run(
            [sys.executable, "-c", script, str(home / "x.dxf")],
            check=True,
            env=os.environ | changed,
            timeout=120,
        )
        found.append((home / "x.dxf").read_bytes())
    assert found[0] == found[1]


def test_without_its_packages_the_drawing_names_the_extras_before_any_work(tmp_path, monkeypatch):
    module = import_module("clacad.exporting.drawing.sheet_files")
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    with pytest.raises(NotPossible, match=r"clacad\[dxf,pdf\]"):
        export(part("slab", (2, 2)), tmp_path / "x", ("drawing",))
    assert not (tmp_path / "x").exists()


def test_a_drawing_dimensions_the_clear_aperture_and_the_places_of_the_holes(tmp_path):
    made = clacad.Design.from_dict({
        "format": 1, "name": "flange", "unit": "mm", "law": {"eta": [-0.5, -1.0]},
        "pair": {"form": "slab", "separation": 12, "index": 1.5}, "lattice": {"pitch": 1.0, "outline": {"circle": 6.5}},
        "body": {"border": 2, "holes": [{"diameter": 0.8, "at": [[4.4, 0.0], [-3.2, 3.1]]}]},
    })  # fmt: skip
    view = views.plan(clacad.prescribe(made))
    said = {
        (mark.words, mark.upright): abs(mark.ends[0][mark.upright] - mark.ends[1][mark.upright]) / view.scale
        for mark in view.marks
        if isinstance(mark, DimensionMark)
    }
    lengths = {
        ("10.5", False): 10.5, ("10.5", True): 10.5, ("clear 6.5", False): 6.5,
        ("4.4", False): 4.4, ("3.2", False): 3.2, ("3.1", True): 3.1,
    }  # fmt: skip
    assert said.keys() == lengths.keys()
    assert all(abs(said[key] - wanted) < 1e-9 for key, wanted in lengths.items())


FLANGE = {
    "format": 1, "name": "flange", "unit": "mm", "law": {"eta": [-0.5, -1.0]},
    "pair": {"form": "slab", "separation": 12, "index": 1.5}, "lattice": {"pitch": 2.0, "outline": {"circle": 60}},
    "body": {"border": 6, "holes": [{"diameter": 3.2, "circle": 66, "count": 4}]},
}  # fmt: skip
POLYGON = {
    "format": 1, "name": "plate", "unit": "mm", "law": {"eta": [-1, -1]},
    "pair": {"form": "plano", "separation": 14, "thickness": 1.5, "material": "PMMA"},
    "lattice": {"pitch": 1.0, "outline": {"polygon": [[-6, -5], [6, -5, 0.4142], [7, -4], [7, 4], [2, 4], [2, 5], [-6, 5], [-7, 4], [-7, -4]]}},
    "body": {"holes": [{"diameter": 0.8, "circle": 8, "count": 4}]},
}  # fmt: skip


def shown(name):
    if isinstance(name, dict):
        return clacad.Design.from_dict(name)
    return clacad.load(DESIGNS / f"{name}.toml")


def ink(marks):
    """Boxes of what is drawn, px: outlines and circles with what they enclose, lines, words."""
    for mark in marks:
        if isinstance(mark, LineMark):
            yield *mark.points.min(axis=0), *mark.points.max(axis=0)
        elif isinstance(mark, CircleMark):
            (x, y), r = mark.at, mark.radius
            yield x - r, y - r, x + r, y + r
        elif isinstance(mark, DimensionMark):
            yield from ink(mark.drawn)
        elif isinstance(mark, Words):
            wide = CHARACTER * len(mark.words)
            left = mark.at[0] - {"start": 0.0, "middle": 0.5 * wide, "end": wide}[mark.anchor]
            yield left, mark.at[1] - 9.0, left + wide, mark.at[1] + 2.0


def emptiest_share(sheet):
    """Largest empty upright rectangle as a part of the frame, counted on a millimetre grid, row by row."""
    left, top, right, bottom = frame_box(sheet.paper)
    taken = np.zeros((round(bottom - top), round(right - left)), dtype=bool)
    for block in sheet.placed:
        for box in ink(block.canvas.marks):
            x0, y0, x1, y1 = np.asarray(box) * sheet.unit + (block.x - left, block.y - top) * 2
            taken[max(0, int(y0)) : int(np.ceil(y1)) + 1, max(0, int(x0)) : int(np.ceil(x1)) + 1] = True
    free, largest = np.zeros(taken.shape[1], dtype=int), 0
    for row in taken:
        free = np.where(row, 0, free + 1)
        for height in np.unique(free[free > 0]):
            ends = np.flatnonzero(np.diff(np.concatenate([[0], free >= height, [0]]).astype(int)))
            largest = max(largest, int(height * (ends[1::2] - ends[::2]).max()))
    return largest / taken.size


@pytest.mark.ci_cases("slab-a4", "hexagonal-a3", "plate-a3")
@pytest.mark.daily_cases("flange-a4", "slab-a3")
@pytest.mark.parametrize("paper", ["a4", "a3"])
@pytest.mark.parametrize(
    "name", ["slab", FLANGE, "hexagonal", "tilted-biconvex", POLYGON], ids=lambda name: name if isinstance(name, str) else name["name"]
)  # fmt: skip
def test_no_quarter_of_a_sheet_is_empty_and_views_have_scales_of_iso_5455(paper, name):
    design = shown(name)
    window = clacad.prescribe(design)
    made = sheets(design, window, feasibility(window), paper, None)
    assert max(emptiest_share(sheet) for sheet in made) < 0.25
    for sheet in made:
        for block in sheet.placed:
            if block.canvas.scale is not None:
                on_paper = block.canvas.scale * sheet.unit
                steps = [step * 10.0**power for power in range(-4, 5) for step in (1, 2, 5)]
                assert min(abs(on_paper / step - 1.0) for step in steps) < 1e-9


@pytest.mark.slow
def test_the_frame_has_zones_centring_marks_and_a_title_block(tmp_path):
    design = part("slab", (4, 4))
    export(design, tmp_path / "x", ("drawing",), paper="a4")
    (path,) = (tmp_path / "x").glob("*.dxf")
    document = ezdxf.readfile(path)
    count = sum(words.startswith("1 of ") or words.startswith("2 of ") for words in texts(path))
    strip = {}
    for one in document.modelspace().query("TEXT"):
        x, y = (one.dxf.align_point.x) % (297.0 + 20.0), one.dxf.align_point.y
        if not (20.0 < x < 287.0 and 10.0 < y < 200.0):
            strip[one.dxf.text] = strip.get(one.dxf.text, 0) + 1
    assert strip == dict.fromkeys("ABCD123456", 2 * count)  # on both sides of every sheet
    lines = [np.array(line.get_points("xy")) for line in document.modelspace().query("LWPOLYLINE")]
    marks = [line for line in lines if len(line) == 2 and np.ptp(line, axis=0).max() == pytest.approx(7.0)]
    first = [line for line in marks if line[:, 0].max() < 297.0]
    assert len(first) == 4
    assert all(abs(line[0, 0] - 148.5) < 1e-6 or abs(line[0, 1] - 105.0) < 1e-6 for line in first)
    said = texts(path)
    for words in ("title", "part", "material", "unit", "paper", "sheet", design.sha256[:12]):
        assert words in said


@pytest.mark.slow
def test_the_drawing_says_the_finish_that_the_design_states_and_leaves_the_rest_to_be_agreed(tmp_path):
    for number, (overrides, lens) in enumerate(
        [(["tolerances.roughness='5 nm'"], "Rq 5 nm"), ([], "to be agreed")]
    ):
        design = clacad.load(DESIGNS / "slab.toml", overrides=overrides).with_cells((4, 4))
        export(design, tmp_path / str(number), ("drawing",))
        said = texts(next((tmp_path / str(number)).glob("*.dxf")))
        for name in ("lens 1", "lens 2"):
            row = said.index(name)
            assert said[row - 1 : row + 5] == [
                "z",
                name,
                lens,
                "3/ to be agreed",
                "4/ to be agreed",
                "5/ to be agreed",
            ]
        row = said.index("all others: sides, land, holes")
        assert said[row - 1 : row + 2] == ["y", "all others: sides, land, holes", "Ra to be agreed"]
        assert said.count("z") >= 4  # in the table, and at each lens
        assert said.count("y") >= 2


def boxes_of_datums(view):
    """Box of every datum letter of a view, px."""
    letters = [mark.at for mark in view.marks if isinstance(mark, Words) and mark.words in ("B", "C")]
    return [(x - 6.0, y - 10.0, x + 6.0, y + 2.0) for x, y in letters]


@pytest.mark.parametrize("made", [FLANGE, POLYGON], ids=["round", "polygon"])
@pytest.mark.parametrize("share", [1.0, 4.0])
def test_no_extension_line_runs_through_a_datum_letter(made, share):
    view = views.plan(clacad.prescribe(shown(made)), views.OnPaper(0.25, share))
    boxes = boxes_of_datums(view)
    assert len(boxes) == 2
    for mark in view.marks:
        for line in mark.drawn if isinstance(mark, DimensionMark) else ():
            if isinstance(line, LineMark) and line.kind == "ext":
                (x0, y0), (x1, y1) = line.points.min(axis=0), line.points.max(axis=0)
                assert not any(
                    x0 < right and left < x1 + 1e-9 and y0 < bottom and top < y1 + 1e-9
                    for left, top, right, bottom in boxes
                )


def test_a_rectangular_border_has_its_clear_aperture_dimensioned():
    design = clacad.load(DESIGNS / "slab.toml", overrides=["body.border=2"]).with_cells((6, 4))
    view = views.plan(clacad.prescribe(design))
    said = {(mark.words, mark.upright) for mark in view.marks if isinstance(mark, DimensionMark)}
    assert said == {("7", False), ("6", True), ("clear 3", False), ("clear 2", True)}


def test_a_view_refers_to_the_table_for_places_of_holes_that_it_does_not_dimension():
    def foot(count):
        holes = [{"diameter": 3.2, "circle": 66, "count": count}]
        view = views.plan(clacad.prescribe(shown(FLANGE | {"body": {"border": 6, "holes": holes}})))
        return [m.words for m in view.marks if isinstance(m, Words) and "see table" in m.words]

    assert foot(4) == []
    assert foot(12) == ["holes along x and y: see table"]
