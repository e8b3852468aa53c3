"""Options of single formats: schema and parameter curves of STEP, instances of GLB, names engraved."""

from __future__ import annotations

import json
import re
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.cli import main
from clacad.cli.command import find, parameters
from clacad.exporting.fixtures import NoFixture, mark_place, marked_solids
from clacad.exporting.run import export
from clacad.formats.mesh.readers import read_mesh
from clacad.solid.marks import engraved, line_of_marks
from clacad.storage.errors import NotPossible, UnreadableFile

DESIGNS = Path(__file__).parents[2] / "designs"


def ran(*arguments: str) -> tuple[int, str, str]:
    """Exit status, standard output and error stream of a command."""
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        status = main([*arguments])
    return status, out.getvalue(), err.getvalue()


def small(name: str, *overrides: str, count: tuple[int, int] = (3, 3)):
    return clacad.load(DESIGNS / f"{name}.toml", overrides=list(overrides)).with_cells(count)


# -- STEP ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_schema_and_parameter_curves_are_switches_of_the_command_line(tmp_path: Path) -> None:
    out = tmp_path / "x"
    path = str(DESIGNS / "tilted-seam.toml")
    status, _, err = ran("export", path, "-o", str(out), "--format", "step", "--cells", "2x2", "--step-schema", "ap214",
                 "--no-pcurves", "--json")  # fmt: skip
    assert status == 0, err
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["files"][0]["schema"] == "AP214"
    assert manifest["options"]["pcurves"] is False
    text = (out / manifest["files"][0]["name"]).read_text()
    assert "AUTOMOTIVE_DESIGN" in text[:1000]
    assert "PCURVE" not in text
    from OCP.STEPControl import STEPControl_Reader

    reader = STEPControl_Reader()
    assert reader.ReadFile(str(out / manifest["files"][0]["name"])).name == "IFSelect_RetDone"
    assert reader.TransferRoots() == 1
    from build123d import Solid

    assert Solid(reader.OneShape()).is_valid


def test_an_unknown_schema_is_named(tmp_path: Path) -> None:
    status, _, err = ran(
        "export",
        str(DESIGNS / "slab.toml"),
        "-o",
        str(tmp_path / "x"),
        "--format",
        "step",
        "--step-schema",
        "ap203",
    )
    assert status != 0
    assert "ap242, ap214" in err


def test_land_has_its_own_colour_in_a_stranger_reader(tmp_path: Path) -> None:
    from build123d import Solid
    from OCP.collections import Sequence_TDF_Label
    from OCP.Quantity import Quantity_Color
    from OCP.STEPCAFControl import STEPCAFControl_Reader
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFDoc import XCAFDoc_ColorType, XCAFDoc_DocumentTool, XCAFDoc_ShapeTool

    from clacad.formats.step.step_files import LAND_COLOUR, write_step

    facts = write_step(clacad.prescribe(small("tilted-seam", count=(2, 2))), tmp_path / "x.step")
    document = TDocStd_Document(TCollection_ExtendedString("x"))
    reader = STEPCAFControl_Reader()
    reader.SetColorMode(True)
    reader.ReadFile(str(tmp_path / "x.step"))
    reader.Transfer(document)
    labels = Sequence_TDF_Label()
    XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetFreeShapes(labels)
    colours = XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    painted = []
    for face in Solid(XCAFDoc_ShapeTool.GetShape_s(labels.Value(1))).faces():
        colour = Quantity_Color()
        if colours.GetColor(face.wrapped, XCAFDoc_ColorType.XCAFDoc_ColorSurf, colour):
            linear = np.array([colour.Red(), colour.Green(), colour.Blue()])  # the kernel keeps linear light
            painted.append(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055))
            assert face.geom_type.name == "PLANE"
    assert len(painted) == facts["bodies"][0]["faces"]["land"]
    wanted = [LAND_COLOUR.red, LAND_COLOUR.green, LAND_COLOUR.blue]
    assert np.abs(np.array(painted) - wanted).max() < 1e-3
    text = (tmp_path / "x.step").read_text()
    assert len(re.findall("OVER_RIDING_STYLED_ITEM", text)) == len(painted)


# -- GLB ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_instances_of_a_glb_stand_where_its_nodes_do_and_take_less_room(tmp_path: Path) -> None:
    design = small("tilted-biconvex", count=(9, 7))
    names = {}
    for option in (False, True):
        manifest = export(design, tmp_path / str(option), ("glb",), quads=4, gpu_instancing=option)
        names[option] = tmp_path / str(option) / manifest.files[0]["name"]
    nodes, instances = (read_mesh(names[option]) for option in (False, True))
    for one, other in zip(nodes.parts, instances.parts, strict=True):
        assert len(one.placements) == len(other.placements) == 63
        assert np.abs(one.placements - other.placements).max() < 1e-8  # metres, float32
    assert names[True].stat().st_size < names[False].stat().st_size
    data = names[True].read_bytes()
    document = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    assert document["extensionsRequired"] == ["EXT_mesh_gpu_instancing"]
    assert len(document["nodes"]) == 3
    use = document["nodes"][1]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]
    assert document["accessors"][use["TRANSLATION"]]["count"] == 63


@pytest.mark.slow
def test_instances_that_are_turned_are_not_read(tmp_path: Path) -> None:
    manifest = export(
        small("slab", "lattice.seam=0.02"), tmp_path / "x", ("glb",), quads=4, gpu_instancing=True
    )
    path = tmp_path / "x" / manifest.files[0]["name"]
    data = path.read_bytes()
    path.write_bytes(data.replace(b'"TRANSLATION"', b'"ROTATIONXXX"'))
    with pytest.raises(UnreadableFile):
        read_mesh(path)


# -- name and arrow -----------------------------------------------------------------------------------------


@pytest.mark.daily_cases("displaced slab")
@pytest.mark.parametrize(
    "case",
    [
        ("tilted-biconvex", ["body.border=2"]),
        pytest.param(("plano", ["body.border=1.5"]), marks=pytest.mark.long),
        ("tilted", ["body.border=2"]),
        pytest.param(("hexagonal", ["body.border=2"]), marks=pytest.mark.long),
        ("tilted-biconvex", ["lattice.outline={circle=3.5}", "lattice.count=[3,3]"]),
    ],
    ids=["biconvex", "plano", "displaced slab", "hexagonal", "disc"],
)
def test_an_engraved_body_is_valid_and_has_lost_its_letters_only(case):
    name, overrides = case
    design = clacad.load(DESIGNS / f"{name}.toml", overrides=overrides)
    design = design if "outline" in overrides[0] else design.with_cells((2, 2))
    window = clacad.prescribe(design)
    from clacad.solid.solids import solids

    for body, part, plain in zip(window.bodies, marked_solids(window, "ab 1").values(), solids(window)):
        place = mark_place(window, body)
        assert part.is_valid
        assert len(part.solids()) == len(plain.solids())
        before, after = plain.bounding_box(), part.bounding_box()
        assert (after.min - before.min).length < 1e-6
        assert (after.max - before.max).length < 1e-6
        floors = [
            f for f in part.faces() if abs(f.center().Z - place.centre[2] - place.depth) < 1e-6 * place.depth
        ]
        assert len(floors) >= 15  # one a letter and the arrow
        for floor in floors:
            centre = floor.center()
            assert abs(centre.X - place.centre[0]) < 0.5 * place.width
            assert abs(centre.Y - place.centre[1]) < 0.5 * place.height
        from OCP.BRep import BRep_Tool

        assert all(BRep_Tool.IsClosed_s(shell.wrapped) for shell in part.shells())


def test_the_letters_read_rightly_from_the_viewers_side_and_the_arrow_points_up():
    from build123d import Box, Plane, Pos

    plate = Pos(0, 0, 0.5) * Box(20, 4, 1)
    plane = Plane(origin=(0, 0, 0), x_dir=(-1, 0, 0), z_dir=(0, 0, -1))
    letters = line_of_marks(plane, "L", 10.0, 2.0, 0.2)
    made = engraved(plate, letters, 0.0)
    floors = sorted((f for f in made.faces() if abs(f.center().Z - 0.2) < 1e-9), key=lambda f: f.center().X)
    assert len(floors) == 2
    letter, arrow = floors  # the viewer at -z, y up, sees +x on the left: the arrow is first, at greater x
    assert arrow.area > 0
    top, bottom = (max((v for v in arrow.vertices()), key=lambda v: s * v.Y) for s in (1, -1))
    assert abs(top.X - arrow.bounding_box().center().X) < 1e-6  # the tip is in the middle, above
    assert abs(bottom.X - arrow.bounding_box().center().X) > 0.1
    # the upright of an L is on its left for the viewer: at the greater x
    box = letter.bounding_box()
    high = [v.X for v in letter.vertices() if v.Y > box.max.Y - 1e-6]
    assert min(high) > box.center().X


@pytest.mark.slow
def test_a_body_without_border_is_not_engraved_and_says_why(tmp_path: Path) -> None:
    with pytest.raises(NoFixture, match=r"no border to engrave: give body\.border a width"):
        marked_solids(clacad.prescribe(small("tilted-biconvex")), "x")
    with pytest.raises(NoFixture, match=r"body\.border >= '0\.4 mm'"):
        marked_solids(clacad.prescribe(small("tilted-biconvex", "body.border=0.1")), "x")
    with pytest.raises(NotPossible, match="no border to engrave"):
        export(small("tilted-biconvex"), tmp_path / "x", ("marked",))


@pytest.mark.long
def test_marked_bodies_are_files_that_read_back(tmp_path: Path) -> None:
    manifest = export(small("plano", "body.border=2", count=(2, 2)), tmp_path / "x", ("marked",))
    assert [entry["name"] for entry in manifest.files] == [
        "plano.array1.marked.step",
        "plano.array2.marked.step",
    ]
    assert all(entry["solids"] == 1 for entry in manifest.files)


def test_the_forecast_of_gdsii_counts_the_levels_that_are_asked_for(tmp_path: Path) -> None:
    """The forecast was 64 levels regardless of the requested number."""
    pytest.importorskip("gdstk", reason="the extra gds is not installed")
    path = str(DESIGNS / "slab.toml")
    for levels in (2, 64, 256):
        out = tmp_path / str(levels)
        asked = ("export", path, "-o", str(out), "--format", "gds", "--cells", "2x2", "--grey-levels", str(levels),
                 "--json")  # fmt: skip
        said = json.loads(ran(*asked, "--dry-run")[1])[0]["bytes"]
        assert ran(*asked)[0] == 0
        written = sum(file.stat().st_size for file in out.iterdir() if ".gds" in file.name)
        assert said == pytest.approx(written, rel=0.2)


# -- one declaration ------------------------------------------------------------------------------


def test_the_command_line_and_the_function_ask_for_what_is_declared() -> None:
    from inspect import signature

    from clacad.exporting.formats.registry import words
    from clacad.exporting.request import DEFAULTS, OPTIONS

    function = signature(export).parameters
    assert [name for name in function if name not in ("design", "out", "progress")] == list(OPTIONS)
    command = find("export")
    assert command is not None
    typed = {one.name: one for one in parameters(command.request)}
    for name, option in OPTIONS.items():
        default = getattr(DEFAULTS, name)
        assert function[name].default == (default or None if name in ("quads", "role") else default), name
        shown = typed[name]
        assert "/".join([shown.flags[0], *shown.opposites]) == option.flag
        assert (shown.help, shown.least, shown.most) == (
            option.help.replace("{formats}", ", ".join(words())),
            option.least,
            option.most,
        )
        if shown.default not in (None, ()):
            assert shown.default == default
    own = {"design", "out", "dry_run", "target", "normals", "set", "as_made", "process"}
    assert set(typed) - set(OPTIONS) == own


@pytest.mark.slow
def test_light_of_a_file_as_made_is_forecast_of_the_made_sheet_which_is_prescribed_once(
    tmp_path, monkeypatch
) -> None:
    import clacad.prescription.prescribe as room

    built, calls = room.prescribe, []
    monkeypatch.setattr(room, "prescribe", lambda design, *more: calls.append(1) or built(design, *more))
    design = str(Path(__file__).parents[2] / "designs" / "window-100mm.toml")
    made = ["--as-made", "--process", "moulding", "--set", "process.shrinkage=[0, 0, 0.02]"]
    asked = ["export", design, "-o", str(tmp_path), "--cells", "3x3", "--format", "stl"]
    assert main([*asked, *made, "--quads", "64"]) == 0
    assert len(calls) == 1
    told = json.loads((tmp_path / "manifest.json").read_text())
    everything = told["options"]["as_made"]["everything"]
    [fine] = told["files"]
    assert everything > 2.0 * fine["forecast_law_rms"]
    assert everything < fine["forecast_law_rms_as_made"] < 1.1 * everything
    assert main([*asked, *made, "--quads", "4", "--overwrite"]) == 0
    [coarse] = json.loads((tmp_path / "manifest.json").read_text())["files"]
    assert coarse["forecast_law_rms_as_made"] > max(coarse["forecast_law_rms"], everything)
