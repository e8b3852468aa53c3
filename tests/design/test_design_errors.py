"""Bad designs and the exact words of their error messages.

Each file of tests/golden_designs is one bad design; FILE.txt next to it is the message of `load`, to the letter.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from clacad.design import CODES, Design, DesignError, load

FOLDER = Path(__file__).parents[1] / "golden_designs"
BAD = sorted(path.name for path in FOLDER.iterdir() if path.suffix != ".txt")


@pytest.mark.parametrize("name", BAD)
def test_a_bad_design_is_explained_to_the_letter(name, monkeypatch):
    monkeypatch.chdir(FOLDER)
    with pytest.raises(DesignError) as caught:
        load(name)
    assert f"{caught.value}\n" == (FOLDER / f"{name}.txt").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", BAD)
def test_every_mistake_has_a_known_code_a_place_in_the_file_and_a_caret_under_it(name, monkeypatch):
    monkeypatch.chdir(FOLDER)
    with pytest.raises(DesignError) as caught:
        load(name)
    raw = (FOLDER / name).read_bytes().decode("utf-8", errors="replace")
    lines = re.split("\r\n|\n", raw)
    for mistake in caught.value.mistakes:
        assert mistake.code in CODES
        assert mistake.path == name
        if mistake.line is not None:
            assert 1 <= mistake.line <= len(lines)
            assert 1 <= mistake.column <= len(lines[mistake.line - 1]) + 1
        if mistake.source_line:
            assert mistake.source_line == lines[mistake.line - 1]


def test_every_code_of_a_design_mistake_has_an_example():
    said = "".join((FOLDER / f"{name}.txt").read_text(encoding="utf-8") for name in BAD)
    missing = {code for code in CODES if f"error {code}:" not in said}
    elsewhere = {"CL118", "CL120", "CL121", "CL122", "CL123", "CL128", "CL129"}
    assert missing == elsewhere, "overrides and pairs that cannot be built are tested elsewhere"


def test_nothing_that_steers_a_terminal_is_printed(tmp_path):
    path = tmp_path / "evil.toml"
    path.write_text(
        'format = 1\nname = "\\u001b[2J\u202e"\n"\\u0007" = 1\nunit = "\u009bmm"\n', encoding="utf-8"
    )
    with pytest.raises(DesignError) as caught:
        load(path)
    assert all(line.isprintable() for line in str(caught.value).split("\n"))


@pytest.mark.parametrize(
    ("change", "keys"),
    [
        (lambda d: d.pop("name"), {"name"}),
        (lambda d: d.pop("law"), {"law"}),
        (lambda d: d["law"].pop("eta"), {"law.eta"}),
        (lambda d: d["law"].update(psi=3), {"law.psi"}),
        (lambda d: d.update(pair=[1]), {"pair"}),
        (lambda d: d.update(colour="red"), {"colour"}),
        (lambda d: d["law"].update(eta="x"), {"law.eta"}),
        (lambda d: d.update(body={"spin": 1}, check=2), {"body.spin", "check"}),
        (lambda d: d["lattice"].update(pitch=True, kin="square"), {"lattice.pitch", "lattice.kin"}),
    ],
)
def test_keys_are_found_unknown_missing_or_of_the_wrong_kind(change, keys):
    data = tomllib.loads(
        (Path(__file__).parents[2] / "designs" / "paper-base.toml").read_text(encoding="utf-8")
    )
    change(data)
    with pytest.raises(DesignError) as caught:
        Design.from_dict(data)
    assert {mistake.key for mistake in caught.value.mistakes} == keys
