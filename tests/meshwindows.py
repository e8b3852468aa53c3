"""Small windows of every form, for tests of cell complex and mesh."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

import clacad
from clacad.sheet.pieces_and_holes import BorderJoint, count_pieces_and_holes, count_together
from clacad.sheet.window import Window, column
from clacad.topology.complex_parts import Border, CellComplex

PAIR = ("thickness", "web", "confocal", "curved", "surface", "conic")
LATTICE = ("seam", "outline", "aperture")


def window(
    eta: tuple[float, float] = (-0.25, -1.0),
    euler: tuple[float, float, float] = (0.0, 0.0, 0.0),
    form: str = "biconvex",
    count: tuple[int, int] = (3, 3),
    kind: str = "square",
    pitch: float | list[float] = 0.005,
    delta: tuple[float, float] = (0.0, 0.0),
    **more: Any,
) -> Window:
    """The paper's base sheet with a few cells and some keys changed."""
    design: dict[str, Any] = {
        "format": 1,
        "name": "small",
        "unit": "m",
        "law": {"eta": list(eta), "delta": list(delta), "euler": list(euler)},
        "pair": {"form": form, "separation": 0.05, "index": 1.5, **_chosen(more, PAIR)},
        "lattice": {"kind": kind, "pitch": pitch, "count": list(count), **_chosen(more, LATTICE)},
    }
    if "border" in more:
        design["body"] = {"border": more["border"]}
    return clacad.prescribe(clacad.Design.from_dict(design))


def joints_of(cells: CellComplex, border: Border) -> list[tuple[float, float]]:
    """Stretches of a border on which both columns share material, by their heights between its breaks."""
    a, b = np.array(border.start), np.array(border.end)
    found: list[tuple[float, float]] = []
    for start, stop in pairwise([0.0, *border.breaks.tolist(), 1.0]):
        at = a + 0.5 * (start + stop) * (b - a)
        beside = at - np.array(cells.window.lattice.offset(*border.step))
        (front_l, back_l), (front_r, back_r) = (
            column(cells.window, cells.body, *p[:, None]) for p in (at, beside)
        )
        if np.minimum(back_l, back_r) - np.maximum(front_l, front_r) > 0.0:
            found.append((found.pop()[0] if found and found[-1][1] == start else start, stop))
    return found


def pieces_and_holes(cells: CellComplex) -> tuple[int, int]:
    """What a body falls into where columns that only touch in a line are apart, by Euler's formula on its complex."""
    lattice, flats = cells.window.lattice, [
        f.vertex[2] if f.array is None else f.land for f in (cells.body.front, cells.body.back)
    ]  # fmt: skip
    if len(cells.tilings) == 2 or (None not in flats and flats[0] < flats[1]):
        return 1, 0
    (tiling,) = cells.tilings
    joints = [(border.step, joints_of(cells, border)) for border in tiling.borders]
    glued = sum(len(on) * count_together(lattice, [(0, 0), step]) for step, on in joints)
    around = [
        column(cells.window, cells.body, *tiling.tile[[c for _, c in node.cells]].T) for node in tiling.nodes
    ]
    filled = [
        [step for step, _ in node.cells]
        for node, (front, back) in zip(tiling.nodes, around)
        if back.min() > front.max()
    ]
    euler = lattice.cell_count - glued + sum(count_together(lattice, around) for around in filled)
    ends = [bool(on) and (on[0][0] == 0.0, on[-1][1] == 1.0) for _, on in joints]
    found = [BorderJoint(step, len(on), end or (False, False)) for (step, on), end in zip(joints, ends)]
    pieces, _ = count_pieces_and_holes(lattice, found)
    return pieces, pieces - euler


def _chosen(more: Mapping[str, Any], keys: tuple[str, ...]) -> dict[str, Any]:
    return {key: more[key] for key in keys if key in more}


FORMS: dict[str, dict[str, Any]] = {
    "flat neighbours": {},
    "rectangular cells": {"kind": "rectangular", "pitch": [0.005, 0.004]},
    "strips": {"thickness": 0.0005},
    "pinholes": {"thickness": 0.0005, "eta": (-1.0, -1.0)},
    "loose cells that touch": {"thickness": 0.0006, "euler": (10.0, 5.0, 20.0)},
    "tilted": {"euler": (0.0, 1.0, 0.0)},
    "tilted about both axes, offset": {"euler": (20.0, 1.0, 30.0), "delta": (0.01, -0.02)},
    "saddle at every corner": {"euler": (45.0, 0.0, 0.0)},
    "tilted web, rims in the cell": {"euler": (0.0, 10.0, 0.0), "thickness": 0.0006, "web": 0.0001},
    "turned web": {"euler": (5.0, 3.0, 0.0), "thickness": 0.0006, "web": 0.0001},
    "plano": {"form": "plano", "euler": (20.0, 1.0, 0.0)},
    "plano, curved inside": {"form": "plano", "euler": (20.0, 0.5, 0.0), "curved": "inside"},
    "plano, Galilean": {"form": "plano", "eta": (0.5, 0.5), "euler": (20.0, 1.0, 0.0)},
    "concave": {"eta": (0.5, 0.5), "euler": (20.0, 1.0, 0.0)},
    "cylinders": {"eta": (1.0, -1.0)},
    "slab": {"form": "slab", "euler": (10.0, 0.0, 0.0)},
    "slab, displaced in y": {"form": "slab", "euler": (10.0, 0.3, 0.0)},
    "slab, displaced in x and y": {"form": "slab", "euler": (10.0, 0.3, 40.0)},
    "slab, seam": {"form": "slab", "seam": 0.0004},
    "biconvex, seam": {"seam": 0.0004, "euler": (30.0, 1.0, 0.0)},
    "plano, seam": {"form": "plano", "seam": 0.0004, "euler": (30.0, 1.0, 0.0)},
    "hexagonal": {"kind": "hexagonal", "euler": (30.0, 1.0, 0.0)},
    "hexagonal, seam": {"kind": "hexagonal", "seam": 0.0004, "euler": (30.0, 1.0, 0.0)},
    "hexagonal slab": {"kind": "hexagonal", "form": "slab", "euler": (10.0, 0.3, 0.0)},
    "hexagonal, strips": {"kind": "hexagonal", "thickness": 0.0003},
    "biconic": {"form": "slab", "surface": "biconic"},
    "round outline": {"outline": {"circle": 0.03}, "form": "plano", "count": (6, 6), "euler": (20.0, 1.0, 0.0)},
    "round outline, hexagons": {
        "outline": {"circle": 0.03}, "kind": "hexagonal", "web": 0.0003, "count": (6, 6), "euler": (20.0, 1.0, 0.0),
    },
    "outline that fits two sides": {"outline": {"rectangle": [0.02, 0.021]}, "form": "plano", "count": (6, 6)},
    "border and web": {"border": 0.001, "web": 0.0003},
    "border, hexagons": {"border": 0.001, "form": "plano", "kind": "hexagonal"},
}  # fmt: skip
