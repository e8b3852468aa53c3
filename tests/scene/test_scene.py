"""Scene files: their meaning, what is refused, and where each mistake is."""

from __future__ import annotations

import copy
import math
import tomllib
from pathlib import Path

import pytest
from viewscenes import ROOT, view_data

from clacad.scene import Scene, SceneError, load_scene
from clacad.scene import sections as scene_keys
from clacad.scene.model import value_at
from clacad.scene.sections import scene_schema

SCENES = sorted((ROOT / "designs" / "scenes").glob("*.toml"))

TEXT = """format = 1
name = "t"
unit = "m"

[sheet]
design = "designs/paper-base.toml"
set = { "law.eta" = [-0.5, -1.0] }

[camera]
position = [0, 0, -20]
frame = "110 cm"

[[object]]
id = "ball"
kind = "sphere"
at = [0, "20 mm", 10]
size = 0.4
colour = "#ff0000"

[animation]
frames = 5
[[animation.move]]
key = "object.ball.at.2"
from = -2
to = 38
"""


def read(text: str, folder: Path = ROOT) -> Scene:
    """A scene from text, as if it were a file in the project's folder."""
    import tomllib

    return Scene.from_dict(tomllib.loads(text), folder=str(folder))


def mistakes(text: str) -> list[str]:
    with pytest.raises(SceneError) as caught:
        read(text)
    return [f"{mistake.code} {mistake.message}" for mistake in caught.value.mistakes]


@pytest.mark.parametrize("path", SCENES, ids=lambda p: p.stem)
def test_every_scene_of_the_project_reads_and_its_sheet_can_be_designed(path):
    scene = load_scene(path)
    assert scene.name == path.stem
    still = scene if scene.animation is None else scene.at(scene.animation.frames - 1)
    assert still.design().law is not None


def test_units_are_converted_and_colours_are_linear_light():
    scene = read(TEXT)
    assert scene.camera.frame == 1.1
    ball = scene.objects[0]
    assert ball.at == (0.0, 0.02, 10.0)
    assert ball.size == (0.4,)
    assert ball.colour == (1.0, 0.0, 0.0)
    grey = read(TEXT.replace("#ff0000", "#808080")).objects[0].colour[0]
    assert grey == pytest.approx(0.21586, abs=1e-5)  # IEC 61966-2-1: half of the code is a fifth of the light


def test_the_sheet_is_the_design_with_the_scene_s_changes():
    assert read(TEXT).design().law_spec.eta == (-0.5, -1.0)
    nested = TEXT.replace('{ "law.eta" = [-0.5, -1.0] }', "{ law = { eta = [-0.5, -1.0] } }")
    assert read(nested).design().law_spec.eta == (-0.5, -1.0)


def test_every_key_of_every_section_is_read_by_a_kind_and_explained():
    for section in (scene_keys.ROOT, scene_keys.OBJECT, scene_keys.MOVE, *scene_keys.SECTIONS.values()):
        for name, key in section.items():
            assert key.about, name
            assert key.kind.schema() is not None, name


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        pytest.param(("frame =", "frmae ="), "CL102 unknown key camera.frmae; did you mean camera.frame?", id="misspelt"),
        pytest.param(("colour =", "color ="), "CL102 unknown key object.0.color; did you mean object.0.colour?", id="color"),
        pytest.param(('kind = "sphere"', 'kind = "spere"'), "CL107 object.0.kind", id="kind"),
        pytest.param(("size = 0.4", "size = [0.4, 1]"), "CL108 object.0.size has 2 values", id="size"),
        pytest.param(("size = 0.4\n", ""), "CL103 missing key object.0.size", id="no-size"),
        pytest.param(("[0, 0, -20]", "[0, 0, 20]"), "CL106 camera.position[2] = 20 is not before the sheet", id="behind"),
        pytest.param(('frame = "110 cm"', 'frame = 1\nfov = "3 deg"'), "CL112 camera needs exactly one of frame and fov, has both", id="both"),
        pytest.param(('frame = "110 cm"\n', ""), "CL112 camera needs exactly one of frame and fov, has neither", id="neither"),
        pytest.param(('frame = "110 cm"', 'frame = "110 deg"'), "CL105 camera.frame", id="unit"),
        pytest.param(("#ff0000", "red"), "CL107 object.0.colour", id="colour"),
        pytest.param(("frames = 5", "frames = 1"), "CL106 animation.frames", id="frames"),
        pytest.param(("object.ball.at.2", "object.bal.at.2"), "CL118 animation.move.0.key", id="no-such-object"),
        pytest.param(("to = 38\n", ""), "CL103 animation.move.0 needs from and to, or values and times", id="half-a-move"),
        pytest.param(("designs/paper-base.toml", "../../etc/passwd"), "CL106 sheet.design", id="outside"),
        pytest.param(("designs/paper-base.toml", "/etc/passwd"), "CL106 sheet.design", id="absolute"),
        pytest.param(("[camera]", "[cammera]"), "CL102 unknown key cammera; did you mean camera?", id="section"),
        pytest.param(("[sheet]", "[law]\neta = 1\n[sheet]"), "CL102 unknown key law: it belongs in a design file", id="design-key"),
        pytest.param(("format = 1", "format = 2"), "CL109 format = 2", id="format"),
    ],
)  # fmt: skip
def test_a_slip_is_named(change, expected):
    assert change[0] in TEXT
    found = mistakes(TEXT.replace(*change, 1))
    assert any(one.startswith(expected) for one in found), found


def test_a_mistake_of_a_file_has_its_line_and_column(tmp_path):
    path = tmp_path / "s.toml"
    (tmp_path / "designs").mkdir()
    path.write_text(TEXT.replace("size = 0.4", "size = -0.4"))
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    mistake = next(m for m in caught.value.mistakes if m.key.startswith("object.0.size"))
    line = TEXT.splitlines().index("size = 0.4") + 1
    assert (mistake.line, mistake.column) == (line, 8)
    assert str(path) in str(caught.value)
    assert "^" in str(caught.value)


def test_all_mistakes_are_told_at_once():
    bad = TEXT.replace("frame =", "frmae =").replace("size = 0.4", "size = 0").replace("#ff0000", "#12")
    assert len(mistakes(bad)) >= 3


def test_a_mistake_in_a_changed_design_key_is_told_at_the_scene():
    scene = read(TEXT.replace("[-0.5, -1.0]", "[0.0, -1.0]"))
    with pytest.raises(SceneError, match="eta"):
        scene.design()


@pytest.mark.parametrize("text", ["object.ball.size=0.7", "camera.frame=0.5", "sheet.set.law.eta=[-2,-2]"])
def test_an_override_changes_one_value(text, tmp_path):
    scene = Scene.from_dict(read(TEXT).given, (text,), folder=str(ROOT))
    assert scene != read(TEXT)


def test_frames_move_what_they_say_and_nothing_else():
    scene = read(TEXT)
    z = [scene.at(k).objects[0].at[2] for k in range(5)]
    assert z == [-2.0, 8.0, 18.0, 28.0, 38.0]
    assert scene.at(0).animation is None
    again = scene.at(3).replace({"object.ball.at.0": 1.0})
    assert scene.at(3).replace("object.ball.at.0", 1.0) == again
    assert again.animation is None
    assert again.objects[0].at == (1.0, 0.02, 28.0)
    with pytest.raises(ValueError, match="frame 5 of 5"):
        scene.at(5)


def test_values_between_times_lie_on_straight_lines_and_smooth_starts_at_rest():
    text = TEXT.replace("from = -2\nto = 38", "values = [0, 10, 0]\ntimes = [0, 0.25, 1]")
    scene = read(text)
    assert [scene.at(k).objects[0].at[2] for k in range(5)] == pytest.approx([0, 10, 20 / 3, 10 / 3, 0])
    smooth = read(TEXT.replace("to = 38", 'to = 38\nease = "smooth"')).animation.moves[0]
    step = 1e-4
    assert (value_at(smooth, step) - value_at(smooth, 0.0)) / step < 0.02
    assert value_at(smooth, 0.5) == 18.0


def test_an_angle_of_the_sheet_can_move():
    text = (
        TEXT.replace("object.ball.at.2", "sheet.set.law.euler.0").replace("-2\n", "0\n").replace("38", "180")
    )
    scene = read(text)
    assert [math.degrees(scene.at(k).design().law.phi) for k in range(5)] == [0.0, 45.0, 90.0, 135.0, 180.0]


def test_a_scene_is_plain_data_that_can_be_read_again():
    data = view_data("base")
    scene = Scene.from_dict(copy.deepcopy(data), folder=str(ROOT))
    assert Scene.from_dict(scene.given, folder=str(ROOT)) == scene


@pytest.mark.parametrize("junk", [{}, {"format": 1}, {"object": 3}, {"object": [1]}, {"sheet": 1, "camera": []},
                                  {"animation": {"move": [{}]}}, {"camera": {"pixels": [0, 10]}}])  # fmt: skip
def test_junk_is_refused_in_words_and_never_with_a_traceback(junk):
    with pytest.raises(SceneError) as caught:
        Scene.from_dict(
            {**view_data("base"), **junk} if junk and "format" not in junk else junk, folder=str(ROOT)
        )
    assert str(caught.value)


def fits(value, schema, whole):
    """A small reading of JSON Schema: tables, their keys, arrays, alternatives."""
    if "$ref" in schema:
        return fits(value, whole["$defs"][schema["$ref"].rsplit("/", 1)[1]], whole)
    if "oneOf" in schema and schema["oneOf"][0].get("type") == "object":
        return sum(fits(value, one, whole) for one in schema["oneOf"]) == 1
    if "const" in schema:
        return value == schema["const"]
    if "enum" in schema:
        return value in schema["enum"]
    if schema.get("type") == "object" and "properties" in schema:
        known = schema["properties"]
        return (
            isinstance(value, dict)
            and value.keys() <= known.keys()
            and set(schema.get("required", ())) <= value.keys()
            and all(fits(each, known[key], whole) for key, each in value.items())
        )
    if schema.get("type") == "array" and isinstance(schema.get("items"), dict):
        return isinstance(value, list) and all(fits(each, schema["items"], whole) for each in value)
    return True


@pytest.mark.parametrize("path", sorted((ROOT / "designs" / "scenes").glob("*.toml")), ids=lambda p: p.stem)
def test_the_schema_holds_every_scene_of_the_project_and_no_slip(path):
    whole = scene_schema()
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    assert fits(data, whole, whole)
    assert not fits(data | {"camra": {}}, whole, whole)
    assert not fits(data | {"camera": data["camera"] | {"framme": 1}}, whole, whole)
    assert not fits(data | {"object": [{"kind": "sphere", "tile": 1.0}]}, whole, whole)
    assert not fits({key: value for key, value in data.items() if key != "sheet"}, whole, whole)
