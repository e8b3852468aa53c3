"""Any change of a good design gives a design or a DesignError, and every line named exists."""

from __future__ import annotations

import copy
import json
import re
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clacad.config.edit_text import to_toml
from clacad.design import CODES, Design, DesignError, load

DESIGNS = sorted((Path(__file__).parents[2] / "designs").glob("*.toml"))
GOOD = [
    load(path).to_dict()
    for path in DESIGNS
    if path.stem in ("paper-base", "tilted-seam", "hexagonal", "plano")
]
QUIET = settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)

scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.sampled_from([0, -0.0, 1, 1.0, -1, 10**18, 10**30, 1e308, -1e308, 5e-324, float("nan"), float("inf")]),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(
        ["auto", "1 mm", "1 deg", "3 mrad", "550 nm", "slab", "thin", "1e999 mm", "1e-999 mm", "2 %"]
    ),
)
values = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)
names = st.one_of(st.text(max_size=6), st.sampled_from(["eta", "pitch", "index", "law", "outline", "allow"]))


def paths(data, prefix=()):
    """Every key path of nested dictionaries and lists."""
    found = [prefix] if prefix else []
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        found += paths(value, (*prefix, key))
    return found


@st.composite
def mutated(draw):
    """A good design with one to three things done to it."""
    data = copy.deepcopy(draw(st.sampled_from(GOOD)))
    for _ in range(draw(st.integers(1, 3))):
        where = paths(data)
        if not where:
            break
        path = draw(st.sampled_from(where))
        parent = data
        for step in path[:-1]:
            parent = parent[step]
        deed = draw(st.sampled_from(["drop", "retype", "rename", "add", "repeat", "swap"]))
        if deed == "drop":
            del parent[path[-1]]
        elif deed == "rename" and isinstance(parent, dict):
            parent[draw(names)] = parent.pop(path[-1])
        elif deed == "add" and isinstance(parent, dict):
            parent[draw(names)] = draw(values)
        elif deed == "repeat":
            parent[path[-1]] = [parent[path[-1]]] * draw(st.sampled_from([1, 2, 3, 1000]))
        elif deed == "swap" and isinstance(parent, dict):
            other = draw(st.sampled_from(sorted(parent, key=str)))
            parent[path[-1]], parent[other] = parent[other], parent[path[-1]]
        else:
            parent[path[-1]] = draw(values)
    return data


def answer(read):
    """The design, or the DesignError."""
    try:
        return read()
    except DesignError as error:
        return error


def no_line_is_invented(error, text):
    lines = re.split("\r\n|\n", text)
    assert error.mistakes
    for mistake in error.mistakes:
        assert mistake.code in CODES
        if mistake.line is not None:
            assert 1 <= mistake.line <= len(lines)
            assert 1 <= mistake.column <= len(lines[mistake.line - 1]) + 1
    assert all(line.isprintable() for line in str(error).split("\n"))


@pytest.mark.slow
@QUIET
@given(mutated())
def test_a_mutated_dictionary_is_a_design_or_a_design_error(data):
    found = answer(lambda: Design.from_dict(data))
    if isinstance(found, Design):
        assert Design.from_dict(found.to_dict()) == found
        assert len(found.sha256) == 64


@pytest.mark.slow
@QUIET
@given(data=mutated())
def test_a_mutated_json_file_is_a_design_or_a_design_error(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "mutated.json"
    text = json.dumps(data, indent=1)
    path.write_text(text, encoding="utf-8", newline="")
    found = answer(lambda: load(path))
    if isinstance(found, DesignError):
        no_line_is_invented(found, text)


@QUIET
@given(data=st.data())
def test_a_toml_file_with_bytes_changed_is_a_design_or_a_design_error(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "mutated.toml"
    text = data.draw(st.sampled_from([to_toml(good) for good in GOOD]))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text)))
        end = min(len(text), at + data.draw(st.integers(0, 12)))
        new = data.draw(
            st.one_of(st.text(max_size=6), st.sampled_from(["\n", '"', "[", "]", "=", ".", "e9", "[[", "#"]))
        )
        text = text[:at] + new + text[end:]
    path.write_text(text, encoding="utf-8", newline="", errors="replace")
    found = answer(lambda: load(path))
    if isinstance(found, DesignError):
        no_line_is_invented(found, path.read_text(encoding="utf-8"))


@QUIET
@given(raw=st.binary(max_size=300))
def test_any_bytes_are_a_design_or_a_design_error(tmp_path_factory, raw):
    path = tmp_path_factory.getbasetemp() / "bytes.toml"
    path.write_bytes(raw)
    assert isinstance(answer(lambda: load(path)), DesignError)


@QUIET
@given(st.lists(st.text(max_size=30), max_size=3))
def test_any_override_is_taken_or_refused_in_words(texts):
    found = answer(lambda: Design.from_dict(GOOD[0], texts))
    if isinstance(found, DesignError):
        assert all(line.isprintable() for line in str(found).split("\n"))


@pytest.mark.parametrize("opening", ["[", '{"a":'])
def test_a_deep_json_file_is_refused_not_followed(tmp_path, opening):
    path = tmp_path / "deep.json"
    path.write_text(opening * 100_000)
    with pytest.raises(DesignError):
        load(path)


@pytest.mark.timeout(20)
@pytest.mark.parametrize(
    "text",
    [
        "a." * 2_000_000 + "b = 1",
        "x = " + "[" * 2_000_000,
        "[" * 2_000_000,
        "a.b.c = 1\n" * 50_000,
        'x = """' + "a" * 4_000_000,
    ],
)
def test_hostile_texts_are_refused_in_seconds(tmp_path, text):
    path = tmp_path / "hostile.toml"
    path.write_text(text)
    with pytest.raises(DesignError):
        load(path)
