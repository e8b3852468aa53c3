"""Scenes of several sheets: the meaning of their files, what is refused, and the view through the sheets."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from clacad.cli import main
from clacad.effects import plan_effects, plan_sheets
from clacad.rendering.picture import view_through
from clacad.rendering.sheet_passage import plan_passage, stack_of
from clacad.scene import Scene, SceneError
from clacad.scene.sections import scene_schema
from clacad.sheet.stack import BadStack

ROOT = Path(__file__).parents[2]
FILE = ROOT / "designs" / "scenes" / "negative-space.toml"
TEXT = FILE.read_text(encoding="utf-8")


def read(text: str = TEXT, **changes: object) -> Scene:
    """The shipped scene of two sheets, small, with some keys changed."""
    scene = Scene.from_dict(tomllib.loads(text), folder=str(FILE.parent))
    return scene.replace({"camera.pixels": [60, 60], "camera.samples": 1, **changes})


def mistakes(text: str) -> list[str]:
    with pytest.raises(SceneError) as caught:
        read(text)
    return [f"{one.code} {one.message}" for one in caught.value.mistakes]


def test_sheets_are_told_apart_by_their_ids_and_stand_in_the_order_light_meets_them():
    scene = read(TEXT.replace('id = "a"', 'id = "front"'))
    assert [(one.id, one.z) for one in scene.sheets] == [("front", 0.0), ("b", 114.9362867285548)]
    assert scene.sheet is scene.sheets[0]
    swapped = TEXT.replace("z = 114.9362867285548", "").replace(
        'design = "../window-100mm.toml"', 'design = "../window-100mm.toml"\nz = 120', 1
    )
    assert [one.id for one in read(swapped).sheets] == ["b", "a"]
    assert len({one.sha256 for one in scene.designs()}) == 1


def test_one_sheet_of_several_is_changed_and_moved_by_its_id():
    scene = read(**{"sheet.b.set.law.eta": [-0.5, -0.5], "sheet.b.z": "20 cm", "sheet.a.rung": "law"})
    assert scene.designs()[0].law.eta_x == -1.0
    assert scene.designs()[1].law.eta_x == -0.5
    assert scene.sheets[1].z == 200.0
    assert [one.rung for one in scene.sheets] == ["law", "auto"]


def test_a_sheet_moves_in_an_animation():
    move = '\n[animation]\nframes = 3\n[[animation.move]]\nkey = "sheet.b.z"\nfrom = 115\nto = 215\n'
    scene = read(TEXT + move)
    assert [scene.at(k).sheets[1].z for k in range(3)] == [115.0, 165.0, 215.0]
    turn = move.replace("sheet.b.z", "sheet.b.set.law.euler.0").replace("115", "0").replace("215", "90")
    assert read(TEXT + turn).at(2).designs()[1].law.phi == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ('id = "b"\n', "", "CL103 missing key sheet.1.id"),
        ('id = "b"', 'id = "a"', "CL112 2 sheets have the id a"),
        ('id = "b"', 'id = "2"', "CL10"),
        ('id = "a"\n', 'id = "a"\nz = 3\n', "CL106 no sheet lies at z = 0: the first, a, is at 3"),
        ("z = 114.9362867285548", "z = -5", "CL106 sheet.1.z"),
        ("z = 114.9362867285548", "height = 5", "CL102 unknown key sheet.1.height"),
        ("z = 114.9362867285548", 'z = 115\nmesh = "x.stl"', "CL113 sheet.1.mesh needs rung"),
        ("[camera]", "[light]\npolariser = 0\n[camera]", "CL112 a polariser or analyser is given, and several sheets"),
    ],
)  # fmt: skip
def test_what_several_sheets_may_not_say(before, after, said):
    assert before in TEXT
    assert any(one.startswith(said) for one in mistakes(TEXT.replace(before, after, 1))), mistakes(
        TEXT.replace(before, after, 1)
    )


def test_a_key_of_no_sheet_says_which_there_are():
    with pytest.raises(SceneError, match=r"the scene has several sheets: say whose, sheet\.<id>\.set"):
        read(**{"sheet.set.law.eta": [1, 2]})
    with pytest.raises(SceneError, match="there is no sheet c; sheets: a, b"):
        read(**{"sheet.c.z": 5})


def test_sheets_that_overlap_are_one_sentence_with_what_would_do():
    with pytest.raises(
        BadStack, match=r"sheet b \(z from 14 to .*\) overlaps sheet a .*: sheet\.b\.z >= 14\.936"
    ):
        plan_passage(read(**{"sheet.b.z": 14.0}), None)  # type: ignore[arg-type]


def test_every_sheet_has_a_plan_of_its_own():
    scene = read(**{"sheet.b.rung": "thin", "effects.without": ["reflections"]})
    first, second = plan_sheets(scene, stack_of(scene))
    assert (first.rung_why, second.rung) != (second.rung_why, first.rung)
    assert second.rung == "thin"
    assert first.row("reflections").state == second.row("reflections").state == "without"
    with pytest.raises(ValueError, match="plan_sheets"):
        plan_effects(scene)


def test_effects_count_the_faces_of_every_sheet_with_its_field_lens():
    """Two faces of a slab, four of two plates, six of three: straight down each passes 1 − r² of PMMA, r = (n − 1)/(n + 1)."""
    with_plate = {"sheet.b.set": {"pair.field_lens": True}}
    whole = {"sheet.b.set": {"pair.field_lens": True, "law.eta": [-0.5, -1.0], "check.process": "none"}}
    asked = {"effects.mode": "auto", "effects.list": [], "effects.force": ["fresnel"]}
    n = 1.4936286728554803
    for changes, faces in ((with_plate, 4), (whole, 6)):
        scene = read(**asked, **changes)
        rows = [plan.row("fresnel") for plan in plan_sheets(scene, stack_of(scene))]
        for row, count in zip(rows, (2, faces), strict=True):
            assert f"{count} bare faces" in row.why
            assert row.radiance == pytest.approx(
                1.0 - (1.0 - ((n - 1.0) / (n + 1.0)) ** 2) ** count, abs=0.004
            )


def test_the_command_lists_plans_by_id(capsys):
    assert main(["effects", str(FILE), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [one["id"] for one in found["sheets"]] == ["a", "b"]
    assert all(one["rung"] for one in found["sheets"])
    assert main(["effects", str(FILE)]) == 0
    assert capsys.readouterr().out.startswith("2 sheets\n  a  rung ")
    assert main(["effects", str(FILE), "--all"]) == 0
    told = capsys.readouterr().out
    assert told.startswith("sheet a\nrung ")
    assert "\n\nsheet b\nrung " in told


def test_the_schema_takes_one_sheet_or_several():
    schema = scene_schema()
    one, several = schema["properties"]["sheet"]["anyOf"]
    assert one == {"$ref": "#/$defs/sheet"}
    assert several["type"] == "array"
    table = schema["$defs"]["stacked_sheet"]
    assert table["required"] == ["id", "design"]
    assert set(table["properties"]) == {*schema["$defs"]["sheet"]["properties"], "id", "z"} - {"tint"}


def test_negative_space_shows_the_world_as_if_it_stood_nearer():
    """Homogeneous sheets of eta = -1: behind them light goes on as if from B = -100, so all appears 229.9 mm nearer than it is."""
    plain = {"effects.mode": "none", "sheet.a.rung": "law", "sheet.b.rung": "law"}
    through = view_through(read(**plain))
    nearer = 129.8725734571096 + 100.0
    moved = {f"object.{name}.at.2": z - nearer for name, z in (("ball", 430.0), ("wall", 900.0))}
    bare = view_through(read(**moved), sheet=False)
    inside = slice(10, 50)
    same = np.abs(through.light - bare.light)[inside, inside].max(axis=-1) < 1e-9
    assert same.mean() > 0.98  # but for pixels that an edge goes through
    beside = view_through(read(), sheet=False)
    assert (np.abs(through.light - beside.light)[:5] < 1e-12).all()  # past both sheets nothing is changed
    assert np.abs(through.light - beside.light)[inside, inside].max() > 0.1


def test_light_that_passes_two_sheets_counts_the_share_of_both():
    """ALIVE alone shines: the mean over the sheet of a white world is the share through both."""
    white = {
        "effects.mode": "list", "effects.list": [], "sheet.a.rung": "thin", "sheet.b.rung": "thin", "object.wall.pattern": "colour",
        "object.wall.colour": [1.0, 1.0, 1.0], "object.ball.at": [0, 0, 2000], "light.ambient": 1.0, "light.key": 0.0,
        "camera.samples": 4,
    }  # fmt: skip
    picture = view_through(read(**white))
    lit = picture.light[20:40, 20:40, 0]
    stack = stack_of(read(**white))
    from clacad.stacking.chief_matrices import expected_share

    rows, columns = np.mgrid[20:40, 20:40]
    x, y = (130.0 * ((columns + 0.5) / 60 - 0.5)).ravel(), (130.0 * (0.5 - (rows + 0.5) / 60)).ravel()
    share = expected_share(
        stack, np.column_stack([x, y]), np.column_stack([x / 2000.0, y / 2000.0, np.ones(len(x))])
    )
    assert lit.mean() == pytest.approx(share, abs=0.04)


@pytest.mark.daily_cases("False")
@pytest.mark.parametrize("compiled", [True, False])
def test_an_object_between_sheets_hides_what_light_reaches_it_after_the_first(compiled):
    """A wide red screen 60 mm behind the first of two sheets is all that is seen through both; one that the light
    does not reach changes nothing.
    """
    light = {
        "light.ambient": 1.0,
        "light.key": 0.0,
        "effects.mode": "none",
        "sheet.a.rung": "law",
        "sheet.b.rung": "law",
    }
    plain = view_through(read(**light), compiled=compiled).light
    between = {
        "kind": "box",
        "id": "between",
        "size": [90.0, 90.0, 2.0],
        "at": [0.0, 0.0, 60.0],
        "colour": [1.0, 0.0, 0.0],
    }
    scene = tomllib.loads(TEXT)
    scene["object"].append(between)
    seen = Scene.from_dict(scene, folder=str(FILE.parent)).replace(
        {"camera.pixels": [60, 60], "camera.samples": 1, **light}
    )
    light = view_through(seen, compiled=compiled).light
    np.testing.assert_allclose(light[20:40, 20:40], np.broadcast_to([1.0, 0.0, 0.0], (20, 20, 3)), atol=1e-6)
    np.testing.assert_array_equal(light[:, :3], plain[:, :3])  # next to the sheets
    aside = seen.replace({"object.between.at.0": 160.0})
    light = view_through(aside, compiled=compiled).light
    np.testing.assert_array_equal(light[20:40, 20:40], plain[20:40, 20:40])


def test_a_pov_scene_holds_every_sheet_at_its_height(tmp_path, capsys):
    small = [word for one in "ab" for word in ("--set", f"sheet.{one}.set.lattice.count=[2,2]")]
    assert main(["export", str(FILE), "-o", str(tmp_path / "p"), "--format", "pov", *small]) == 0
    text = (tmp_path / "p" / "negative-space.pov").read_text(encoding="utf-8")
    assert text.count("#declare I = ") >= 4  # two faces of two sheets
    heights = [float(v) for v in re.findall(r"<-?[\d.]+, -?[\d.]+, (\d+\.?\d*)>", text)]
    assert any(abs(z - 114.936e3) < 1e3 for z in heights)
    assert (
        main(["render", str(FILE), "-o", str(tmp_path / "x.png"), "--target", "1 mrad", "--pixels", "20"])
        == 2
    )
    assert "the scene has several" in capsys.readouterr().err


def test_a_picture_says_of_every_sheet_how_light_passed_it(tmp_path, capsys):
    line = [
        "render",
        str(FILE),
        "-o",
        str(tmp_path / "x.png"),
        "--pixels",
        "24",
        "--samples",
        "1",
        "--rung",
        "thin",
        "--json",
    ]
    assert main([*line, "--set", "effects.mode=none"]) == 0
    (shown,) = json.loads(capsys.readouterr().out)["pictures"]
    assert shown["metadata"]["clacad:rung"] == "a: thin (as requested); b: thin (as requested)"
    assert set(shown["plans"]) == {"a", "b"}


@pytest.mark.slow
@pytest.mark.parametrize("rung", ["thin", "surfaces"])
def test_compiled_and_numpy_pictures_of_two_sheets_agree(rung):
    scene = read(
        **{"sheet.a.rung": rung, "sheet.b.rung": rung, "effects.mode": "list", "effects.list": ["ghosts"]}
    )
    one, other = (view_through(scene, compiled=fast).light for fast in (True, False))
    assert (np.abs(one - other).max(axis=-1) < 1e-9).mean() > 0.995
