"""Report on an image where next to no light goes through partners: where it went, and which light goes through."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.cli.entry_point import main

TILTED = Path(__file__).parents[2] / "designs" / "tilted-biconvex.toml"


@pytest.mark.parametrize("tilt", [3.0, 6.0])
def test_light_along_z_that_all_strays_is_told_of_light_along_the_tilted_axes(tilt):
    window = clacad.prescribe(clacad.load(TILTED).replace({"law.euler": [45, tilt, 0]}))
    found = clacad.image(window, (0, 0, -math.inf), ("thin", "surfaces"), 4096)
    for one in found.rungs:
        assert one.share == 0.0
        assert one.found.missing == "no light"
        assert one.fates["GHOST"] > 0.5
        assert sum(one.fates.values()) == pytest.approx(1.0)
    # the axes of lenses that are tilted about x lean by as much
    assert found.instead.source[:2] == pytest.approx([0.0, -math.tan(math.radians(tilt))], abs=1e-12)
    rng = np.random.default_rng(2)
    cells = window.lattice.cells()
    middle = window.lattice.centres(cells[len(cells) // 2 + window.lattice.count[0] // 2][None])
    at = middle + rng.uniform(-0.45, 0.45, (4000, 2)) * window.lattice.pitch
    way = np.array([*found.instead.source[:2], 1.0])
    start = np.column_stack([at, np.zeros(4000)]) - 5.0 * way
    lit = clacad.trace(window, clacad.Rays(start, np.broadcast_to(way, start.shape)), path="numpy")
    assert float(np.mean(lit.fate == clacad.Fate.ALIVE)) > 0.8
    assert found.instead.share > 0.8


@pytest.mark.slow
def test_an_answer_without_an_image_holds_no_nan_and_a_way_to_go_on(capsys):
    sheet = [str(TILTED), "--set", "law.euler=[45,6,0]", "--rays", "2000"]
    assert main(["image", *sheet, "--object", "0,0,-inf", "--json"]) == 0

    def refused(word):
        raise AssertionError(word)

    told = json.loads(capsys.readouterr().out, parse_constant=refused)
    law, _, exact = told["rungs"]
    assert (law["missing"], exact["missing"]) == ("parallel", "no light")
    assert exact["found"] == [None, None, None]
    assert exact["astray"] == [0, 2]
    assert main(["image", *sheet, "--object", "0,0,-300"]) == 0
    text = capsys.readouterr().out
    assert not re.search(r"\bnan\b", text)
    (again,) = re.findall(r'--object="(\S+)"', text)
    assert main(["image", *sheet, f"--object={again}", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["instead"] is None
    assert told["rungs"][-1]["share"] > 0.5
    assert told["rungs"][-1]["missing"] is None
