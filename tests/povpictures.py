"""Pictures that POV-Ray makes of a scene as it is written for it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from viewscenes import ROOT

from clacad.base.types import Floats
from clacad.exporting.pov.pov_scene import write_pov
from clacad.prescription.prescribe import prescribe
from clacad.rendering.sheet_passage import stack_of
from clacad.scene import Scene

needs_povray = pytest.mark.skipif(shutil.which("povray") is None, reason="POV-Ray is not installed")


def povray(scene: Scene, folder: Path, seconds: list[float] | None = None) -> Floats:
    """Linear light (h, w, 3) as POV-Ray renders a scene on one thread."""
    path = folder / "s.pov"
    write_pov(stack_of(scene) if len(scene.sheets) > 1 else prescribe(scene.design()), path, scene)
    width, height = scene.camera.pixels
    before = os.times().children_user
    subprocess.run(
        ["povray", f"+I{path}", f"+O{folder / 's.ppm'}", f"+W{width}", f"+H{height}", "-A", "+FP16", "-D", "+WT1",
         "-GA", "File_Gamma=1.0"],
        check=True, capture_output=True, cwd=folder,
    )  # fmt: skip
    if seconds is not None:
        seconds.append(os.times().children_user - before)
    data = (folder / "s.ppm").read_bytes()
    head = re.match(rb"P6\s+(?:#[^\n]*\s+)*(\d+)\s+(\d+)\s+(\d+)\s", data)
    assert head is not None
    return np.frombuffer(data[head.end() :], dtype=">u2").reshape(height, width, 3) / float(head[3])


def before_stripes(name: str, sheet: dict[str, Any], camera: dict[str, Any]) -> Scene:
    """A sheet before a striped screen, ghosts shown and every other effect left out: single rays show where they went."""
    return Scene.from_dict(
        {
            "format": 1, "name": name, "unit": "mm", "sheet": {"rung": "surfaces", **sheet}, "camera": {"samples": 1, **camera},
            "light": {"ambient": 1.0, "key": 0.0},
            "background": {"sky": ["#99ffcc", "#99ffcc"], "ground": "#333333"},
            "effects": {"mode": "list", "list": ["ghosts"]},
            "object": [{"kind": "screen", "id": "s", "at": [0, 0, 120], "size": [400, 400], "pattern": "stripes",
                        "period": 7.0, "colours": ["#cc4422", "#2244cc"]}],
        },
        folder=str(ROOT),
    )  # fmt: skip
