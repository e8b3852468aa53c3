"""Pictures that POV-Ray makes of a scene as it is written for it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from clacad.base.types import Floats
from clacad.formats.pov.pov_scene import write_pov
from clacad.prescription.prescribe import prescribe
from clacad.scene import Scene

needs_povray = pytest.mark.skipif(shutil.which("povray") is None, reason="POV-Ray is not installed")


def povray(scene: Scene, folder: Path, seconds: list[float] | None = None) -> Floats:
    """Linear light (h, w, 3) as POV-Ray renders a scene on one thread."""
    path = folder / "s.pov"
    write_pov(prescribe(scene.design()), path, scene)
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
