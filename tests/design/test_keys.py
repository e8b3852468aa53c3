"""A key is declared once: its field is read, written, described and explained without a second place that names it."""

from __future__ import annotations

import ast
from collections import Counter, defaultdict
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest
from package_source import messages, nodes

from clacad.config.compound_kinds import KeyPaths, key, keys_of
from clacad.config.value_kinds import Quantity, Word
from clacad.design import Design, DesignError, json_schema
from clacad.design.sections import SECTIONS, SPECS, LightSpec
from clacad.explain.look_up import explain
from clacad.scene.sections import OBJECT, scene_schema
from clacad.scene.sections import SECTIONS as SCENE_SECTIONS

PACKAGE = Path(__file__).parents[2] / "clacad"
TINY = {
    "format": 1,
    "name": "tiny",
    "unit": "mm",
    "law": {"eta": [-0.5, -1.0]},
    "pair": {"form": "slab", "separation": 10.0, "index": 1.5},
    "lattice": {"pitch": 0.5, "count": 4},
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ToyLight(LightSpec):
    """Section [light] with two more keys."""

    glow: float | None = key(
        Quantity("length", "a length > 0", above=0.0, named=True), "how far the toy glows"
    )
    mood: str = key(Word(("calm", "wild")), "mood of the toy", "calm", later=True)


@pytest.fixture
def toy(monkeypatch):
    monkeypatch.setitem(SPECS, "light", ToyLight)
    monkeypatch.setitem(SECTIONS, "light", keys_of(ToyLight))


def with_light(**light):
    return Design.from_dict({**TINY, "light": light})


@pytest.mark.usefixtures("toy")
def test_a_new_key_is_read_and_written_from_its_field_alone():
    made = with_light(glow="1 cm", mood="wild")
    assert (made.light.glow, made.light.mood, made.light.coherent) == (10.0, "wild", False)
    assert made.to_dict()["light"] == {"coherent": False, "glow": "10.0 mm", "mood": "wild"}
    assert made.canonical_toml().endswith('\n[light]\ncoherent = false\nglow = "10.0 mm"\nmood = "wild"\n')
    assert Design.from_dict(made.to_dict()) == made
    assert with_light(glow=2).to_dict()["light"] == {
        "coherent": False,
        "glow": "2.0 mm",
    }  # a later key at its default


@pytest.mark.usefixtures("toy")
def test_a_new_key_leaves_the_text_of_designs_without_it_as_it_was():
    assert "light" not in Design.from_dict(TINY).to_dict()
    assert with_light(coherent=True).to_dict()["light"] == {"coherent": True}


@pytest.mark.usefixtures("toy")
def test_a_new_key_is_in_the_schema_and_explained():
    entry = json_schema()["$defs"]["Light"]["properties"]
    assert entry["glow"]["description"] == "how far the toy glows"
    assert entry["mood"] == {
        "default": "calm",
        "description": "mood of the toy",
        "enum": ["calm", "wild"],
        "title": "Mood",
    }
    assert explain("light.glow").means == explain("glow").means == "how far the toy glows"
    assert '"calm" | "wild"' in explain("mood").do


@pytest.mark.usefixtures("toy")
def test_a_new_key_is_suggested_and_refused_as_its_kind_says():
    with pytest.raises(DesignError) as caught:
        with_light(glwo=1, mood="wilt")
    messages = {mistake.key: mistake for mistake in caught.value.mistakes}
    assert messages["light.glwo"].hint == "light.glow"
    assert (
        messages["light.glwo"].allowed == "in [light]: coherent, spectrum, temperature, thermal, glow, mood"
    )
    assert messages["light.mood"].allowed == '"calm" | "wild"'
    assert '"wild"' in messages["light.mood"].hint


def test_the_distances_of_a_check_take_the_unit_of_the_design_like_every_length():
    bare = Design.from_dict({**TINY, "check": {"viewer": 400, "object": 2500.0}})
    named = Design.from_dict({**TINY, "check": {"viewer": "0.4 m", "object": "2.5 m"}})
    assert bare == named
    assert bare.viewing_places == (0.4, 2.5)
    assert bare.to_dict()["check"]["viewer"] == "400.0 mm"
    with pytest.raises(DesignError, match="out of range"):
        Design.from_dict({**TINY, "check": {"viewer": -400}})


def test_a_path_is_that_of_a_key():
    paths = KeyPaths("pair", SECTIONS["pair"])
    assert [getattr(paths, name) for name in SECTIONS["pair"]] == [
        f"pair.{name}" for name in SECTIONS["pair"]
    ]
    with pytest.raises(AttributeError, match="no key sepration; keys: form, separation"):
        paths.sepration  # noqa: B018


def test_every_key_has_a_meaning_and_a_field():
    for keys in (*SECTIONS.values(), *SCENE_SECTIONS.values(), OBJECT):
        for name, one in keys.items():
            assert one.about, name
            assert one.attribute, name


def test_the_schema_of_scenes_states_meanings_and_defaults_as_that_of_designs():
    camera = scene_schema()["$defs"]["camera"]["properties"]
    assert camera["pixels"]["default"] == [660, 660]
    assert scene_schema()["$defs"]["light"]["properties"]["spectrum"]["default"] == 550.0
    assert scene_schema()["$defs"]["effects"]["properties"]["angle"]["default"] == "auto"


# --- literals -----------------------------------------------------------------------------------------------


@cache
def literals() -> dict[str, Counter[str]]:
    """Module → the texts of its syntax tree, docstrings left out, with their number."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        found[path.relative_to(PACKAGE).as_posix()] = Counter(node.value for node in messages(path))
    return found


def paths_in_modules() -> dict[str, int]:
    """Module → number of its texts that are the path of a key."""
    paths = {f"{section}.{name}" for section, keys in SECTIONS.items() for name in keys}
    counts = {
        module: sum(n for text, n in texts.items() if text in paths) for module, texts in literals().items()
    }
    return {module: count for module, count in counts.items() if count}


def names_in_modules() -> dict[str, int]:
    """Name of a key of one section, of two words → number of modules that contain it."""
    sections = Counter(name for keys in SECTIONS.values() for name in keys)
    names = {name for name, count in sections.items() if count == 1 and "_" in name}
    found: defaultdict[str, int] = defaultdict(int)
    for texts in literals().values():
        for name in names & set(texts):
            found[name] += 1
    return {name: count for name, count in found.items() if count > 1}


LEFT_NAMES = {
    "law_rms": 24,
    "image_shift": 5,
    "part_height": 5,
    "law_bias": 11,
    "law_white": 7,
    "part_width": 4,
    "fresnel_number": 6,
    "field_lens": 3,
    "moire_period": 2,
    "residual_power": 4,
    "pitch_2": 2,
}
"""Names of keys that several modules contain, most as the id of a check or a field of a report; each number may only fall."""


@pytest.mark.slow
def test_paths_of_keys_are_taken_from_the_keys():
    """`PAIR.separation`, never its text: a key that is renamed is renamed in one place."""
    assert paths_in_modules() == {}


def test_a_name_of_a_key_occurs_in_one_module():
    for name, count in names_in_modules().items():
        assert count <= LEFT_NAMES.get(name, 1), f"{count} modules contain {name}"


def test_paths_named_in_the_package_are_keys():
    """`PAIR.sepration` would fail only where it is reached: here every such name is looked up."""
    for path in PACKAGE.rglob("*.py"):
        for node in nodes(path):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                section = node.value.id.lower()
                if node.value.id.isupper() and section in SECTIONS:
                    assert node.attr in SECTIONS[section], (
                        f"{path.name}:{node.lineno}: {node.value.id}.{node.attr}"
                    )
