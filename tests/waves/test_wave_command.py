"""`clacad wave`: what it prints, writes and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import clacad
from clacad.cli import main

DESIGN = Path(__file__).parents[2] / "designs/window-100mm.toml"


@pytest.mark.slow
def test_the_numbers_are_those_of_python_and_the_picture_is_the_same_bytes(tmp_path, capsys):
    picture = tmp_path / "made" / "wave.png"
    line = ["wave", str(DESIGN), "--field", "0.2 deg,-3 mrad", "--wavelength", "633 nm", "-o", str(picture)]
    assert main([*line, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    found = clacad.wave(clacad.load(DESIGN), (0.0034906585039886592, -0.003), 633e-9)
    assert told["exact"] == json.loads(json.dumps(found.to_dict()["exact"]))
    assert told["share"] == found.share
    assert found.picture() == picture.read_bytes()
    assert main(line) == 4
    assert "exists" in capsys.readouterr().err
    assert main([*line, "--overwrite", "-q"]) == 0
    assert capsys.readouterr() == ("", "")
    assert found.picture() == picture.read_bytes()


def test_the_table_says_which_way_holds_and_what_coherent_light_does(capsys):
    assert main(["wave", str(DESIGN), "--set", "pair.separation=20", "--all"]) == 0
    told = capsys.readouterr().out
    assert "Fresnel number 11.36" in told
    assert "holds here: pupil" in told
    assert "orders λ/p = 1.1, 1.1 mrad apart: the law is met to ± half of that" in told


@pytest.mark.slow
def test_a_dry_run_says_grid_and_seconds_and_writes_nothing(tmp_path, capsys):
    picture = tmp_path / "wave.svg"
    assert main(["wave", str(DESIGN), "-o", str(picture), "--dry-run", "--json"]) == 0
    ahead = json.loads(capsys.readouterr().out)["forecast"]
    assert list(tmp_path.iterdir()) == []
    assert main(["wave", str(DESIGN), "-o", str(picture), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [ahead["rays"]] * 2 == told["exact"]["points"]
    assert [ahead["points"]] * 2 == told["thin"]["points"]
    assert picture.read_bytes().startswith(b"<?xml")


@pytest.mark.parametrize(("words", "status", "says"), [
    (["--field", "4 deg"], 2, "the field ends 50 and 50 mrad"), (["--field", "1,2,3"], 2, "one angle or two"),
    (["--field", "1 mm"], 2, "one angle or two"), (["--field", "89"], 2, "between -80 deg and 80 deg"),
    (["--wavelength", "2 mm"], 2, "between 10 nm and 1 mm"), (["--wavelength", "green"], 2, "such as '633 nm'"),
    (["--wavelength", "20 um"], 2, "wavelength"), (["-o", "OUT/x.jpg"], 2, ".png or .svg"),
    (["--field-lens", "--set", "law.eta=[0.5,0.5]"], 2, "eta below 0"),
    (["-o", "/proc/none/x.png"], 4, "cannot write"),
    (["--set", "lattice.count=[1000000000,1000000000]"], 3, "lenslets"),
])  # fmt: skip
def test_what_cannot_be_is_refused_in_one_sentence_and_nothing_is_written(
    tmp_path, capsys, words, status, says
):
    assert main(["wave", str(DESIGN), *(word.replace("OUT", str(tmp_path)) for word in words)]) == status
    told = capsys.readouterr()
    assert says in told.err
    assert told.out == ""
    assert list(tmp_path.iterdir()) == []
