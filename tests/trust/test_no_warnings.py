"""Extreme numbers are refused in one sentence, or do no harm; Python warns of none of them."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

DESIGN = str(Path(__file__).parents[2] / "designs" / "slab.toml")


def points(folder: Path) -> list[str]:
    (folder / "points.csv").write_text("x,y\n1,2\n,3\n4,5\n")
    return ["shape", "points.csv", "--distance", "300", "--dry-run"]


def source(folder: Path) -> list[str]:
    (folder / "points.csv").write_text("x,y\n1,2\n2,3\n")
    return ["shape", "points.csv", "--distance", "300", "--source", "1e300", "--dry-run"]


def scales(folder: Path) -> list[str]:
    """Two nodes below one another, each scaled by 1e308."""
    content = np.eye(3, dtype="<f4").tobytes() + np.arange(3, dtype="<u4").tobytes()
    views = [{"buffer": 0, "byteOffset": at, "byteLength": size} for at, size in ((0, 36), (36, 12))]
    accessors = [{"bufferView": k, "componentType": kind, "count": 3, "type": word}
                 for k, kind, word in ((0, 5126, "VEC3"), (1, 5125, "SCALAR"))]  # fmt: skip
    nodes = [{"mesh": 0, "scale": [1e308] * 3, "children": [1]}, {"mesh": 0, "scale": [1e308] * 3}]
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}], "bufferViews": views,
        "buffers": [{"byteLength": len(content)}], "accessors": accessors,
    }  # fmt: skip
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = b"glTF" + struct.pack("<II", 2, 28 + len(text) + len(content))
    chunks = [struct.pack("<II", len(part), kind) + part
              for part, kind in ((text, 0x4E4F534A), (content, 0x004E4942))]  # fmt: skip
    (folder / "part.glb").write_bytes(head + b"".join(chunks))
    return ["verify", DESIGN, "--files", "part.glb", "--all"]


def bulge(folder: Path) -> list[str]:
    """A square of 15 mm, one side of which bulges by 1e-300 of itself."""
    corners = "".join(
        f"10\n{x}\n20\n{y}\n42\n{b}\n" for x, y, b in ((0, 0, 1e-300), (15, 0, 0), (15, 15, 0), (0, 15, 0))
    )
    (folder / "outline.dxf").write_text(
        "0\nSECTION\n2\nHEADER\n9\n$INSUNITS\n70\n4\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n0\nLWPOLYLINE\n8\n0\n90\n4\n70\n1\n"
        f"{corners}0\nENDSEC\n0\nEOF\n"
    )
    (folder / "made.toml").write_text(Path(DESIGN).read_text())
    return ["check", "made.toml", "--set", 'lattice.outline={dxf="outline.dxf"}']


@pytest.mark.slow
@pytest.mark.parametrize(("make", "status", "said"), [
    (points, 2, "x is empty"), (source, 2, "--source 1e300"), (scales, (1, 2), "multiply to more"), (bulge, (0, 1), ""),
], ids=["empty cell of a table", "half angle of 1e300", "scales of a GLB file", "bulge of 1e-300"])  # fmt: skip
def test_extreme_numbers_are_refused_or_do_no_harm_and_python_warns_of_none(tmp_path, make, status, said):
    command = [sys.executable, "-W", "error", "-m", "clacad", *make(tmp_path)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode in (status if isinstance(status, tuple) else (status,)), done.stderr
    assert "Warning" not in done.stderr
    assert said in done.stderr + done.stdout
