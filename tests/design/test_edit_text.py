"""Keys changed in a file's text: the reader finds the change, and every comment stays."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from clacad.config.edit_text import put, with_values
from clacad.config.mistakes import split_key
from clacad.design import Design, template, templates
from clacad.design.sections import SECTIONS

CHANGES = {
    "pair.separation": 16, "lattice.count": [88, 101], "body.border": 0.5, "check.law_rms": "2 mrad", "law.eta.1": -2.5,
    "lattice.outline": {"circle": 50}, "pair.confocal": "best", "name": 'a "b" \\ c',
}  # fmt: skip


def comments(text):
    return [line.partition("#")[2] for line in text.splitlines() if "#" in line]


@pytest.mark.parametrize("kind", sorted(templates()))
def test_a_template_with_keys_changed_reads_as_asked_and_keeps_its_comments(kind):
    text = template("x", kind)
    wanted = tomllib.loads(text)
    for key, value in CHANGES.items():
        wanted = put(wanted, split_key(key), value)
    made = with_values(text, CHANGES)
    assert tomllib.loads(made) == wanted
    assert comments(made) == comments(text)


@pytest.mark.parametrize("text", [
    "pair.a = 1 # c\npair.b=2\n[x]\ny = {a = 1}\n", "[pair]\na = [\n 1, # one\n 2\n]\n", "a=1\r\n[pair]\r\n", "", "[pair]", "[x.y]\nz = 1\n",
    "pair = {a = 1}\n",
])  # fmt: skip
@pytest.mark.parametrize("key", ["pair.a", "pair.c", "x.y.b", "q.r.s", "title", "x.y"])
def test_any_text_with_a_key_changed_reads_as_asked(text, key):
    if (text, key) == ("[x.y]\nz = 1\n", "x.y"):
        with pytest.raises(LookupError, match="lines of its own"):
            with_values(text, {key: 7})
    else:
        assert tomllib.loads(with_values(text, {key: 7})) == put(tomllib.loads(text), split_key(key), 7)


def test_json_keeps_its_order_and_indent():
    text = '{\n   "b": 1,\n   "a": {"c": [1, 2]}\n}'
    made = with_values(text, {"a.c.1": 5}, is_json=True)
    assert json.loads(made) == {"b": 1, "a": {"c": [1, 5]}}
    assert list(json.loads(made)) == ["b", "a"]
    assert '\n   "b"' in made


BASE = tomllib.loads((Path(__file__).parents[2] / "designs" / "slab.toml").read_text())


@pytest.mark.parametrize("key", [
    f"{section}.{name}" for section, keys in SECTIONS.items() for name, one in keys.items() if hasattr(one.kind, "names")
])  # fmt: skip
@pytest.mark.parametrize("value", [0, 1, -1, 0.5, 3, 0.0, 1.0])
def test_a_list_that_is_hinted_instead_of_a_number_is_not_itself_refused(key, value):
    section, name = key.split(".")
    beside = {"surface": "biconic"} if name == "conic" else {}
    beside |= {"prescription": "given"} if name == "vertex" else {}
    data = {**BASE, section: {**BASE.get(section, {}), **beside, name: value}}
    for mistake in mistakes(data):
        if mistake.key == key and mistake.hint.startswith("write ["):
            written = tomllib.loads(f"value = {mistake.hint.removeprefix('write ')}")["value"]
            again = mistakes({**data, section: {**data[section], name: written}})
            assert not [m for m in again if m.key.startswith(key)], mistake.hint


def mistakes(data):
    from clacad.design import DesignError

    try:
        Design.from_dict(data)
    except DesignError as refusal:
        return refusal.mistakes
    return []
