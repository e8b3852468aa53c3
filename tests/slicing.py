"""An STL file as read by a slicer that shares no line with this project."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

SLICERS = ("prusa-slicer", "slic3r")
REPAIRS = (
    "degenerate_facets", "edges_fixed", "facets_removed", "facets_added", "facets_reversed", "backwards_edges",
)  # fmt: skip


def slicer_for(what: str) -> str:
    """A slicer; skips the test where none is installed, and names what was not looked at."""
    found = next((path for name in SLICERS if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip(f"neither prusa-slicer nor slic3r is installed: no slicer looked at {what}")
    return found


def assert_nothing_repaired(slicer: str, path: Path, entry: Mapping[str, Any]) -> None:
    """The slicer finds the file manifold, repairs nothing, and agrees with its entry of the manifest."""
    said = subprocess.run(
        [slicer, "--info", str(path)], check=True, capture_output=True, text=True, timeout=120
    ).stdout
    told = dict(re.findall(r"^\s*([a-z_]+)\s*[:=]\s*(\S+)", said, re.MULTILINE))
    assert int(told.get("number_of_facets") or told["facets"]) == entry["triangles"]
    assert told.get("manifold", "yes") == "yes"
    assert all(int(told.get(name, 0)) == 0 for name in REPAIRS), said
    assert float(told["volume"]) == pytest.approx(entry["volume"], rel=1e-4)
