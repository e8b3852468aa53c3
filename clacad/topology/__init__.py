"""Cells, borders, crossings, corners: ONE topology for mesh and B-Rep.

`cell_complex(window, body)` gives the prototile's borders, nodes and rims; `node_masks` and the
`*_count` functions say where and how often in the finite sheet they occur; `pieces` and `holes` count what the body falls into.
"""

from __future__ import annotations

from clacad.topology.build_complex import cell_complex, holes, one_tiling, pieces
from clacad.topology.complex_parts import (
    Border,
    CellComplex,
    Joint,
    Node,
    Piece,
    Profile,
    Rim,
    RimArc,
    Step,
    Tiling,
)
from clacad.topology.nodes import node_cells, node_masks
from clacad.topology.pieces_and_holes import (
    count_holes,
    count_pieces,
    inner_node_count,
    interior_border_count,
    saddle_count,
)

__all__ = [
    "Border",
    "CellComplex",
    "Joint",
    "Node",
    "Piece",
    "Profile",
    "Rim",
    "RimArc",
    "Step",
    "Tiling",
    "cell_complex",
    "count_holes",
    "count_pieces",
    "holes",
    "inner_node_count",
    "interior_border_count",
    "node_cells",
    "node_masks",
    "one_tiling",
    "pieces",
    "saddle_count",
]
