"""Nodes, where the corners of three or four cells meet, and their saddles."""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats
from clacad.sheet.lattice import node_cells
from clacad.sheet.window import Body, Window
from clacad.topology.borders import column_line
from clacad.topology.complex_parts import SIDES, Node, Side
from clacad.topology.wall_strips import linked


def make_nodes(
    window: Window, body: Body, array: int, faces: tuple[Side, ...], merge: float
) -> tuple[Node, ...]:
    """Build the node classes of a body's tiling on `array`; `faces`: those repeating on it.

    `merge`: a length.
    """
    tile = window.lattice_of(array).tile()
    zone = window.land.seam == 0.0
    nodes = []
    for cells in node_cells(window.lattice):
        heights = np.full((2, len(cells)), np.nan)
        for n, (_, corner) in enumerate(cells):
            x, y = tile[corner]
            line = column_line(body, (x, y), (x, y), zone)
            front, back = line.heights(np.zeros(1))
            heights[:, n] = front[0], back[0]
        joined = bool(np.isfinite(heights).all() and heights[1].min() > heights[0].max())
        raw = [heights[f] if name in faces else np.full(len(cells), np.nan) for f, name in enumerate(SIDES)]
        front, back = cluster(np.concatenate(raw), merge).reshape(2, -1)
        nodes.append(Node(cells, _saddle(front, proud=-1), _saddle(back, proud=1), joined))
    return tuple(nodes)


def cluster(heights: Floats, merge: float) -> Floats:
    """Single linkage: sorted heights whose gaps are at most `merge` all become the middle of their cluster.

    Two heights closer than `merge` therefore always agree afterwards, and the order never changes.
    NaN stays NaN.
    """
    out = np.array(heights, dtype=np.float64)
    known = np.flatnonzero(np.isfinite(out))
    if known.size == 0:
        return out
    order = known[np.argsort(out[known], kind="stable")]
    z = out[order]
    group = linked(z, merge)
    first = np.searchsorted(group, group, side="left")
    last = np.searchsorted(group, group, side="right") - 1
    # the middle, written so that a cluster of identical heights keeps its exact value
    out[order] = z[first] + 0.5 * (z[last] - z[first])
    return out


def _saddle(level: Floats, proud: int) -> bool:
    """Whether both cells of one diagonal are higher than both cells of the other."""
    if len(level) != 4 or np.isnan(level).any():
        return False
    z = proud * level
    return bool(min(z[0], z[2]) > max(z[1], z[3]) or min(z[1], z[3]) > max(z[0], z[2]))
