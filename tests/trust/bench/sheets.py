"""Designs of all forms, three by three cells each or little more, whose exact surfaces keep their limits."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clacad.design import Design

DESIGNS = Path(__file__).parents[3] / "designs"
SHORT = {"pitch": 0.5, "count": [3, 3]}
LONG = {"separation": 10.0, "material": "PMMA"}


def _made(
    pair: Mapping[str, Any], eta: tuple[float, float], lattice: Mapping[str, Any] = {}, **more: Any
) -> dict[str, Any]:
    law = {"eta": list(eta)} | more.pop("law", {})
    return {
        "format": 1,
        "name": "part",
        "unit": "mm",
        "law": law,
        "pair": LONG | pair,
        "lattice": SHORT | lattice,
    } | more


MADE: dict[str, dict[str, Any]] = {
    "plano, curved inside": _made({"form": "plano", "curved": "inside", "thickness": [1.5, 1.5]}, (-0.5, -1.0)),
    "plano, tilted": _made({"form": "plano", "curved": "inside", "thickness": [1.5, 1.5]}, (-0.5, -0.5), {"seam": 0.04},
                           law={"euler": [20.0, 0.5, 0.0]}),
    "slab, biconic": _made({"form": "slab", "surface": "biconic"}, (-0.5, -1.0)),
    "slab, no power in one meridian": _made({"form": "slab"}, (1.0, -1.0)),
    "slab, rectangular cells": _made({"form": "slab"}, (-0.5, -1.0), {"kind": "rectangular", "pitch": [0.5, 0.4]}),
    "slab, border": _made({"form": "slab"}, (-1.0, -1.0), body={"border": 0.2}),
    "slab, round outline": _made({"form": "slab"}, (-0.5, -0.5), {"count": [5, 5], "outline": {"circle": 2.2}}),
    "slab, eta -2": _made({"form": "slab"}, (-2.0, -1.5)),
    "slab, offset and turned": _made({"form": "slab"}, (-0.5, -0.8), law={"delta": [0.02, 0.01], "euler": [30.0, 0.0, 0.0]}),
    "biconvex, thin recipe": _made({"form": "biconvex", "thickness": "auto", "confocal": "thin"}, (-1.0, -1.0)),
    "biconvex, offset": _made({"form": "biconvex", "thickness": "auto"}, (-0.5, -1.0), law={"delta": [0.02, 0.0]}),
    "biconvex, hexagonal": _made({"form": "biconvex", "thickness": "auto"}, (-0.5, -0.5), {"kind": "hexagonal"}),
    "galilean, steep": _made({"form": "biconvex", "thickness": "auto"}, (0.25, 0.25), body={"neck": 0.05}),
}  # fmt: skip
NAMED = (
    "paper-a-covered",
    "window-100mm",
    "slab",
    "tilted",
    "tilted-seam",
    "tilted-biconvex",
    "galilean",
    "plano",
)
"""Of the designs folder, with three by three cells."""

EVERY = (*NAMED, *MADE)


def sheet(name: str) -> Design:
    """A design by its name."""
    if name in MADE:
        return Design.from_dict(MADE[name])
    return Design.from_dict(tomllib.loads((DESIGNS / f"{name}.toml").read_text())).with_cells((3, 3))
