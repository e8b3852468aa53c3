"""Cells, borders, crossings, corners: ONE topology for mesh and B-Rep.

`cell_complex(window, body)` gives the prototile's borders, nodes and rims; `incidence` says which
cells of the finite sheet they occur at; `pieces` and `holes` count what the body falls into.
"""

from __future__ import annotations

from clacad.cell_complex.nouns import (
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
]
