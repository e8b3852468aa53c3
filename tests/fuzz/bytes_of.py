"""Bytes to frighten readers with: mutations of a kept corpus, and what a reader may and may not do with them."""

from __future__ import annotations

import io
import re
import zipfile
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

CORPUS = Path(__file__).parent / "corpus"
SUFFIX = {"design": ".toml", "stl": ".stl", "3mf": ".3mf", "ply": ".ply", "glb": ".glb", "obj": ".obj"}
LARGEST = 20_000
"""Inputs are kept small: a reader's mistakes are in its branches, not in its loops."""

NUMBERS = [b"nan", b"inf", b"-inf", b"1e309", b"1e-320", b"-0.0", b"0", b"-1", b"99999999999999999999", b"2147483648", b"4294967295",
           b"0x10", b"1_000", b"1,5", b"+.e1", b"", b"1e5", b"true", b'"1 um"', b"[1, 2]"]  # fmt: skip
WORDS = [b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"\n", b"[[", b"]]", b'"""', b"'", b"#", b"=", b"{}", b"..", b"\\u0000", b"&amp;", b"<!--",
         b"<!DOCTYPE a [<!ENTITY b 'c'>]>", b"&b;", b"solid", b"facet", b"end_header", b"element face", b"property list", b"unit=mm"]  # fmt: skip

place, byte = st.floats(0, 1, exclude_max=True), st.integers(0, 255)
steps = st.one_of(
    st.tuples(st.just("flip"), place, st.integers(0, 7)),
    st.tuples(st.just("set"), place, byte),
    st.tuples(st.just("insert"), place, st.binary(max_size=6)),
    st.tuples(st.just("word"), place, st.sampled_from(WORDS)),
    st.tuples(st.just("number"), place, st.sampled_from(NUMBERS)),
    st.tuples(st.just("delete"), place, st.integers(1, 60)),
    st.tuples(st.just("repeat"), place, st.integers(1, 60)),
    st.tuples(st.just("cut"), place, st.just(0)),
    st.tuples(st.just("int32"), place, st.sampled_from([0, 1, -1, 2**31 - 1, -(2**31), 2**16, 2**28])),
    st.tuples(st.just("line"), place, place),
    st.tuples(st.just("splice"), place, place),
)
mutations = st.lists(steps, min_size=1, max_size=8)


def corpus(kind):
    """The kept inputs of one kind, by name."""
    return sorted((CORPUS / kind).iterdir())


def mutated(data, recipe, other=b"", largest=LARGEST):
    """Apply mutation steps to bytes, of which there are never more than `largest`."""
    for name, where, what in recipe:
        at = int(where * (len(data) + 1))
        data = STEPS[name](data, at, what, other)[:largest]
    return data


def _flip(data, at, bit, _):
    return data if at >= len(data) else data[:at] + bytes([data[at] ^ (1 << bit)]) + data[at + 1 :]


def _set(data, at, value, _):
    return data[:at] + bytes([value]) + data[at + 1 :]


def _insert(data, at, what, _):
    return data[:at] + what + data[at:]


def _number(data, at, what, _):
    found = [m.span() for m in re.finditer(rb"[-+]?\d[\d.eE+-]*", data)]
    if not found:
        return data
    start, stop = found[at % len(found)]
    return data[:start] + what + data[stop:]


def _delete(data, at, length, _):
    return data[:at] + data[at + length :]


def _repeat(data, at, length, _):
    return data[:at] + 3 * data[at : at + length] + data[at + length :]


def _cut(data, at, _what, _other):
    return data[:at]


def _int32(data, at, value, _):
    return data[:at] + int(value).to_bytes(4, "little", signed=True) + data[at + 4 :]


def _line(data, at, where, _):
    lines = data.split(b"\n")
    one = lines[at % len(lines)]
    other = int(where * len(lines))
    return b"\n".join([*lines[:other], one, *lines[other:]])


def _splice(data, at, where, other):
    return data[:at] + other[int(where * len(other)) :]


STEPS = {"flip": _flip, "set": _set, "insert": _insert, "word": _insert, "number": _number, "delete": _delete, "repeat": _repeat,
         "cut": _cut, "int32": _int32, "line": _line, "splice": _splice}  # fmt: skip


def repacked(data, recipe):
    """A 3MF file with its model mutated inside an intact archive; None if it is no archive."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError, RuntimeError, EOFError):
        return None
    model = next((name for name in members if name.endswith(".model")), None)
    if model is None:
        return None
    members[model] = mutated(members[model], recipe)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return stream.getvalue()


# -- what readers may do ---------------------------------------------------------------------------------------------


def read(kind, data, folder):
    """Read bytes as one kind of file; return "read" or the kind of refusal. Anything else is a bug and raises."""
    path = Path(folder) / f"input{SUFFIX[kind]}"
    path.write_bytes(data)
    return _read_design(path) if kind == "design" else _read_mesh(path)


def _read_design(path):
    from clacad.design import DesignError, load

    try:
        design = load(path)
    except DesignError as error:
        refusal = error
    else:
        again = type(design).from_dict(design.to_dict())
        assert again.to_dict() == design.to_dict()
        return "read"
    assert str(refusal).strip()
    assert refusal.mistakes
    for mistake in refusal.mistakes:
        assert re.fullmatch(r"CL\d\d\d", mistake.code)
        assert "\x1b" not in mistake.message, "control characters of the file on a terminal"
    return ",".join(sorted({m.code for m in refusal.mistakes}))


def _read_mesh(path):
    from clacad.formats.mesh.readers import read_mesh
    from clacad.storage.errors import UnreadableFile

    try:
        mesh = read_mesh(path)
        return _consumed(mesh)
    except UnreadableFile as error:
        refusal = str(error)
    assert refusal.strip()
    return re.sub(r"[\d'\"].*|^.*?:", "", refusal)[:40]


def _consumed(mesh):
    facets = 0
    for chunk in mesh.chunks():
        assert chunk.shape[1:] == (3, 3)
        assert np.isfinite(chunk).all()
        facets += len(chunk)
        if facets > 200_000:
            return "many"
    assert facets == mesh.facet_count
    return "read"
