"""Programs that share no line with this one read what is written: a slicer, FreeCAD, gdstk. Skipped where absent."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections import Counter
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from brepwindows import biconvex, column_volume
from slicing import assert_nothing_repaired, slicer_for

import clacad
from clacad.exporting.run import export
from clacad.formats.step.step_files import write_step
from clacad.sheet.window import column, face_height
from clacad.storage.errors import NotPossible

DESIGNS = Path(__file__).parents[2] / "designs"
SADDLES = ["lattice.seam=0", "pair.web=0", "law.euler=[45,0,0]"]


def saddled():
    """A sheet with a saddle at every inner corner, some millimetres wide."""
    return clacad.load(DESIGNS / "tilted-biconvex.toml", overrides=SADDLES).with_cells((4, 4))


@pytest.mark.slow
@pytest.mark.parametrize("bevel", [0.0, 0.02], ids=["touch", "bevel"])
def test_a_slicer_calls_saddled_sheets_manifold_and_repairs_nothing(tmp_path, bevel):
    slicer = slicer_for("the saddles")
    manifest = export(saddled(), tmp_path / "x", ("stl-parts",), quads=8, saddle_bevel=bevel)
    for entry in manifest.files:
        assert_nothing_repaired(slicer, tmp_path / "x" / entry["name"], entry)


@pytest.mark.parametrize("mode", ["fused", "instanced"])
def test_freecad_finds_the_same_solids_faces_and_volume(tmp_path, mode):
    freecad = shutil.which("freecadcmd") or shutil.which("FreeCADCmd")
    if freecad is None:
        pytest.skip("FreeCAD is not installed: gmsh alone was asked what the STEP files hold")
    window = biconvex(euler=(45.0, 1.0, 0.0), count=(2, 2))
    facts = write_step(window, tmp_path / "x.step", mode=mode)
    script = tmp_path / "ask.py"
    script.write_text(
        "import json, Part\n"
        f"shape = Part.read({str(tmp_path / 'x.step')!r})\n"
        "told = [len(shape.Solids), len(shape.Faces), sum(s.Volume for s in shape.Solids), all(s.isValid() for s in shape.Solids)]\n"
        f"open({str(tmp_path / 'told.json')!r}, 'w').write(json.dumps(told))\n"
    )
    subprocess.run(
        [freecad, str(script)], check=True, capture_output=True, timeout=120, stdin=subprocess.DEVNULL
    )
    solids, faces, volume, valid = json.loads((tmp_path / "told.json").read_text())
    assert (solids, faces) == (facts["solids"], facts["faces"])
    assert valid
    assert volume == pytest.approx(sum(column_volume(window, body) for body in window.bodies), rel=1e-9)


@pytest.mark.daily_cases("hexagonal", "slab")
@pytest.mark.parametrize("name", ["tilted-biconvex", "hexagonal", "slab"])
def test_gdsii_levels_are_the_heights_of_the_lens(tmp_path, name):
    gdstk = pytest.importorskip("gdstk", reason="the extra gds is not installed")
    design = clacad.load(DESIGNS / f"{name}.toml").with_cells((4, 3))
    export(design, tmp_path / "x", ("gds",), grey_levels=32)
    window = clacad.prescribe(design)
    calibration = json.loads((tmp_path / "x" / f"{name}.gds.json").read_text())["faces"]
    body, face = window.bodies[0], window.bodies[0].back
    said = calibration[f"{body.name}-back"]
    library = gdstk.read_gds(str(tmp_path / "x" / f"{name}.{body.name}-back.gds"))
    sheet = library.top_level()[0]
    flat = sheet.get_polygons()
    area = sum(polygon.area() for polygon in flat)
    assert area == pytest.approx(window.lattice.cell_count * window.lattice.cell_area * 1e6, rel=2e-3)
    counted = Counter(polygon.layer for polygon in sheet.references[0].cell.polygons)
    assert set(counted) == {n for n, pixels in enumerate(said["pixels_of_layer"]) if pixels}
    scale = window.unit * 1e3
    rng = np.random.default_rng(1)
    for number in rng.integers(0, len(flat), 40):
        (x0, y0), (x1, y1) = flat[number].bounding_box()
        pixel = said["pixel_um"][0]
        x = (x0 + (rng.integers(0, max(1, round((x1 - x0) / pixel))) + 0.5) * pixel) * 1e-3 / scale
        y = 0.5 * (y0 + y1) * 1e-3 / scale
        dx, dy = window.shifts[face.array]
        _, u, v = window.lattice.locate(np.array([x - dx]), np.array([y - dy]))
        z = column(window, body, u, v)[1][0] if body.columnar else face_height(window, face, u, v)[0]
        told = said["low_mm"] + flat[number].layer * said["step_mm"]
        assert abs(told - (z - face.vertex[2]) * scale) <= 0.501 * said["step_mm"]


def test_without_gdstk_the_format_names_its_extra_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setattr(import_module("clacad.formats.maps.gds"), "find_spec", lambda name: None)
    with pytest.raises(NotPossible, match=r"pip install .clacad\[gds\]"):
        export(clacad.load(DESIGNS / "slab.toml"), tmp_path / "x", ("gds", "step"))
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("levels", [1, 1000])
def test_a_number_of_levels_no_reader_takes_is_refused(tmp_path, levels):
    pytest.importorskip("gdstk", reason="the extra gds is not installed")
    with pytest.raises(NotPossible, match="2 to 256 layers"):
        export(
            clacad.load(DESIGNS / "slab.toml").with_cells((2, 2)),
            tmp_path / "x",
            ("gds",),
            grey_levels=levels,
        )


def test_a_cut_gdsii_stream_is_unreadable(tmp_path):
    pytest.importorskip("gdstk", reason="the extra gds is not installed")
    from clacad.formats.maps.gds import layer_counts
    from clacad.storage.errors import UnreadableFile

    export(clacad.load(DESIGNS / "slab.toml").with_cells((2, 2)), tmp_path / "x", ("gds",))
    path = next((tmp_path / "x").glob("*back.gds"))
    whole = path.read_bytes()
    assert sum(layer_counts(path).values()) > 100
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(UnreadableFile, match="ends in the middle"):
        layer_counts(path)
