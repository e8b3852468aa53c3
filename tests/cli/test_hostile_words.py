"""What a user may get wrong in the newer commands: one sentence, the exit status, nothing written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clacad.cli import main

DESIGN = str(Path(__file__).parents[2] / "designs/window-100mm.toml")


@pytest.mark.parametrize(("words", "status", "says"), [
    (["image", "DESIGN", "--object", "0,0,-300", "-o", "OUT/x.doc"], 2, ".png or .svg"),
    (["accuracy", "DESIGN", "-o", "OUT/x.doc"], 2, ".png or .svg"),
    (["shape", "PICTURE", "--distance", "500", "-o", "OUT/d.json"], 2, "ends in .toml"),
    (["optimise", "DESIGN", "--free", "radii", "-o", "OUT/d.json"], 2, "ends in .toml"),
    (["stack", "DESIGN", "--gap", "5 mm", "-o", "OUT/s"], 2, "two sheets or more"),
    (["export", "DESIGN", "--format", "3mf", "--fused", "--quads", "100000", "-o", "OUT/e"], 3, "8192 at most"),
    (["export", "DESIGN", "--format", "tiff,stl", "--fused", "-o", "OUT/e"], 2, "it applies to step, 3mf, glb"),
    (["export", "DESIGN", "--format", "stl", "--role", "stl=preview", "--role", "stl=master", "-o", "OUT/e"], 2, "stl is named twice"),
    (["export", "DESIGN", "--format", "stl", "--role", "preview", "--role", "master", "-o", "OUT/e"], 2, "it is one value, or FORMAT"),
    (["export", "DESIGN", "--format", "stl", "--quads", "stl=4", "--quads", "stl=8", "-o", "OUT/e"], 2, "stl is named twice"),
    (["verify", "DESIGN", "--files", "OUT", "--role", "stl=scan", "--role", "stl=preview"], 2, "stl is named twice"),
    (["optimise", "DESIGN", "--free", "nonsense", "-o", "OUT/d.toml"], 2, '--free: error CL107: "nonsense" is nothing'),
    (["check", "DESIGN", "--set", "body.border=6", "--set", "body.pins={diameter=2,at=[[0,0]],play=0.01}"], 2, "has 1 point\n"),
])  # fmt: skip
def test_what_cannot_be_is_said_in_one_sentence_and_nothing_is_written(tmp_path, capsys, words, status, says):
    picture = tmp_path / "eye.png"
    Image.fromarray((255 * np.eye(16)).astype(np.uint8)).save(picture)
    out = tmp_path / "out"
    out.mkdir()
    meant = {"DESIGN": DESIGN, "PICTURE": str(picture)}
    assert main([meant.get(word, word.replace("OUT", str(out))) for word in words]) == status
    told = capsys.readouterr()
    assert says in told.err
    assert told.out == ""
    assert list(out.iterdir()) == []
