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
from clacad.exporting.export_design import export
from clacad.formats.drawing import views
from clacad.formats.drawing.canvas import DimensionMark
from clacad.formats.drawing.sheet_layout import MARGIN, PAPERS, sheets
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
        )  # the file holds rational quarters; the kernel says which cylinder they are of
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
        wide, tall = PAPERS[paper]
        for k, (x0, y0, x1, y1) in enumerate(boxes):
            assert min(x0, y0) >= MARGIN - 1e-9
            assert x1 <= wide - MARGIN + 1e-9
            assert y1 <= tall - MARGIN + 1e-9
            for u0, v0, u1, v1 in boxes[:k]:
                assert x1 <= u0 or u1 <= x0 or y1 <= v0 or v1 <= y0


def test_the_title_of_the_section_counts_the_cells_of_the_row_that_is_drawn():
    window = clacad.prescribe(round_slab())
    title = views.row_text(window)
    drawn = window.lattice.centres(window.lattice.row(6))
    kept = int((np.hypot(np.abs(drawn[:, 0]) + 0.25, np.abs(drawn[:, 1]) + 0.25) <= 2.3 + 1e-9).sum())
    assert title.startswith(f"{kept} cells of 0.5 in the row shown (of 12 x 12")
    assert views.row_text(clacad.prescribe(part("slab", (5, 3)))) == "5 cells of 0.5"


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


def test_the_same_design_gives_the_same_bytes_and_a_false_dimension_is_refused(tmp_path):
    from clacad.formats.drawing.dxf import check_drawing_dxf

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


def test_neither_hash_seed_nor_home_changes_a_byte_of_the_dxf(tmp_path):
    script = (
        "import sys; from pathlib import Path; import clacad\n"
        "from clacad.formats.drawing.dxf import write_drawing_dxf\n"
        "from clacad.formats.drawing.sheet_layout import sheets\n"
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
    module = import_module("clacad.formats.drawing.dxf")
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
