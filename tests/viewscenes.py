"""The reference scenes of tests/data/views, as scene dictionaries."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from clacad.scene import Scene

ROOT = Path(__file__).parent.parent
VIEWS = Path(__file__).parent / "data" / "views"
CASES: dict[str, Any] = json.loads((VIEWS / "views.json").read_text())["views"]

CREAM, RED = [0.95, 0.88, 0.66], [0.7, 0.1, 0.1]


def cone(
    y0: float, y1: float, below: float, above: float, colour: list[float], x: float = 0.0
) -> dict[str, Any]:
    return {"kind": "cone", "at": [x, y0, 0], "size": [2 * below, 2 * above, y1 - y0], "colour": colour}


PIECE: list[dict[str, Any]] = [
    {"kind": "box", "at": [0, -0.4, 0], "size": [0.28, 0.4, 0.1], "colour": [0.45, 0.45, 0.5]},
    cone(-0.2, -0.16, 0.12, 0.12, [0.8, 0.72, 0.5]),
    cone(-0.16, 0.02, 0.09, 0.05, CREAM),
    {"kind": "sphere", "at": [0.01, 0.07, 0], "size": 0.15, "colour": CREAM},
    {"kind": "box", "at": [-0.095, 0.06, 0], "size": [0.13, 0.06, 0.06], "colour": [0.86, 0.6, 0.4]},
    cone(0.13, 0.2, 0.03, 0.0, [0.1, 0.55, 0.2], 0.045),
    *[
        {"kind": "sphere", "at": [x, y, 0], "size": 0.064, "colour": RED}
        for x, y in ((0.085, 0.1), (0.095, 0.045), (0.085, -0.01))
    ],
    {"kind": "sphere", "at": [-0.02, 0.09, -0.07], "size": 0.04, "colour": [0.05, 0.05, 0.35]},
]


def view_data(name: str, pixels: int = 660, rung: str = "surfaces") -> dict[str, Any]:
    """The scene of a reference view, one ray through the middle of each pixel."""
    view = CASES[name]
    return {
        "format": 1,
        "name": name,
        "unit": "m",
        "sheet": {
            "design": "designs/paper-base.toml",
            "rung": rung,
            "set": {
                "pair.confocal": "thin",
                "law.eta": view["eta"],
                "law.delta": view["delta"],
                "law.euler": view["euler_degrees"],
            },
        },
        "camera": {
            "position": [0, 0, -20], "frame": 1.1, "pixels": [pixels, pixels], "samples": 1, "mirror": True,
        },
        "light": {"ambient": 1.0, "key": 0.0},
        "background": {"sky": [[0.62, 0.8, 1.0], [0.62, 0.8, 1.0]], "ground": [0.62, 0.8, 1.0]},
        "effects": {"mode": "list", "list": ["ghosts"]},
        "object": [
            {
                "kind": "checker", "id": "floor", "height": -0.6, "reach": 1e4,
                "colours": [[0.86, 0.74, 0.55], [0.42, 0.28, 0.16]],
            },
            {"kind": "group", "id": "piece", "at": [0, 0, view["z_k"]], "parts": PIECE},
        ],
    }  # fmt: skip


def view_scene(name: str, pixels: int = 660, rung: str = "surfaces") -> Scene:
    return Scene.from_dict(view_data(name, pixels, rung), folder=str(ROOT))
