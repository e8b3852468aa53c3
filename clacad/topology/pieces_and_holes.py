"""How many pieces a body falls into and how many holes go through it, counted from the complex.

The open body is a union of open columns, glued along border joints (open patches of border planes)
and along the vertical lines at nodes where all columns meet. It retracts to the dual complex, so
its Euler characteristic is columns − joints + node joints; b₂ = 0 (no column hides a cavity), hence
holes = b₁ = pieces − characteristic.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Ints
from clacad.sheet.lattice import Lattice
from clacad.topology.complex_parts import CellComplex, Tiling
from clacad.topology.nodes import node_masks


def count_pieces(cells: CellComplex) -> int:
    """Count the connected pieces of a body."""
    if _one_by_land(cells):
        return 1
    lattice, tiling = cells.window.lattice, cells.tilings[0]
    joined = [b.step for b in tiling.borders if b.joint is not None and b.joint.intervals]
    if lattice.outline is None and len(joined) == len(tiling.borders):
        return 1
    if lattice.outline is None and not lattice.hexagonal:
        n1, n2 = lattice.count
        return (1 if (1, 0) in joined else n1) * (1 if (0, 1) in joined else n2)
    return _components(lattice, joined)


def count_holes(cells: CellComplex) -> int:
    """Count the holes that go through a body (its pieces' handles)."""
    if _one_by_land(cells):
        return 0
    lattice, tiling = cells.window.lattice, cells.tilings[0]
    joints = 0
    for border in tiling.borders:
        assert border.joint is not None
        if border.joint.intervals:
            joints += len(border.joint.intervals) * interior_border_count(lattice, border.step)
    joints_at_nodes = sum(
        inner_node_count(lattice, tiling, n) for n, node in enumerate(tiling.nodes) if node.joint
    )
    return count_pieces(cells) - (lattice.cell_count - joints + joints_at_nodes)


def interior_border_count(lattice: Lattice, step: tuple[int, int]) -> int:
    """Count the borders of one class with a kept cell on both sides."""
    n1, n2 = lattice.count
    if lattice.outline is None and not lattice.hexagonal:
        return max(0, n1 - abs(step[0])) * max(0, n2 - abs(step[1]))
    return sum(int(lattice.contains(lattice.row(j) + np.array(step)).sum()) for j in range(n2))


def inner_node_count(lattice: Lattice, tiling: Tiling, index: int) -> int:
    """Count the nodes of one class around which every cell is kept."""
    cells = tiling.nodes[index].cells
    if lattice.outline is None and not lattice.hexagonal:
        n1, n2 = lattice.count
        return (n1 - 1) * (n2 - 1)
    _, mask = node_masks(lattice, cells)
    return int((mask == 2 ** len(cells) - 1).sum())


def saddle_count(cells: CellComplex) -> int:
    """Count the inner nodes' saddles (front and back each count)."""
    total = 0
    for tiling in cells.tilings:
        for n, node in enumerate(tiling.nodes):
            each = int(node.saddle_front) + int(node.saddle_back)
            total += each * inner_node_count(cells.window.lattice, tiling, n) if each else 0
    return total


def _one_by_land(cells: CellComplex) -> bool:
    """Whether land of both faces, or a pair of displaced tilings, makes the body one piece without holes."""
    front, back = cells.body.front, cells.body.back
    if not cells.columnar:
        return True
    solid = [face.vertex[2] if face.array is None else face.land for face in (front, back)]
    return solid[0] is not None and solid[1] is not None and solid[0] < solid[1]


def _components(lattice: Lattice, joined: list[tuple[int, int]]) -> int:
    """Count the components of the graph of kept cells joined along the given index steps."""
    index = lattice.cells()
    if len(index) == 0:
        return 0
    low = index.min(axis=0) - 1
    width = index.max(axis=0) - low + 2
    number = np.full(int(width[0] * width[1]), -1, dtype=np.int64)
    flat = (index[:, 0] - low[0]) * width[1] + index[:, 1] - low[1]
    number[flat] = np.arange(len(index))
    edges = [np.empty((0, 2), dtype=np.int64)]
    for di, dj in joined:
        other = number[flat + di * width[1] + dj]
        edges.append(np.stack([np.flatnonzero(other >= 0), other[other >= 0]], axis=1))
    return len(np.unique(connect(len(index), np.concatenate(edges))))


def connect(count: int, edges: Ints) -> Ints:
    """Label the components of a graph of `count` nodes and edges (n, 2): each node's least companion."""
    label = np.arange(count, dtype=np.int64)
    a, b = edges[:, 0], edges[:, 1]
    while True:
        la, lb = label[a], label[b]
        differ = la != lb
        if not differ.any():
            return label
        a, b, la, lb = a[differ], b[differ], la[differ], lb[differ]
        np.minimum.at(label, np.maximum(la, lb), np.minimum(la, lb))
        while True:  # pointer jumping: every node to its root
            jumped = label[label]
            if np.array_equal(jumped, label):
                break
            label = jumped
