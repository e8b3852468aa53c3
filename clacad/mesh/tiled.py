"""One tiling of a body: its cell templates and where they are placed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clacad.mesh.cell_template import TemplateMaker
from clacad.sheet.lattice import Lattice
from clacad.sheet.like_cell import outer_cells, sampled_cells
from clacad.sheet.window import Body, Window

if TYPE_CHECKING:
    from clacad.mesh.own_cells import OwnTemplates

JUDGED = 16
"""Cells of a sheet whose cells differ whose facets' errors are measured, besides those whose lenses stand farthest out."""


@dataclass(frozen=True, eq=False)
class Tiled:
    """One tiling of a body: its templates and where they stand.

    maker : TemplateMaker
        Of all cells; where they differ of the first.
    shift : (2,) lengths
    lattice : Lattice
        Pattern of the tiling's cells about their own middle.
    own : OwnTemplates or None
        Where every cell is a piece of its own.
    """

    maker: TemplateMaker
    shift: tuple[float, float]
    lattice: Lattice
    own: OwnTemplates | None = None

    def maker_at(self, i: int, j: int) -> TemplateMaker:
        """The maker of the kept cell (i, j)."""
        return self.maker if self.own is None else self.own.at((i, j))

    def judged(self, window: Window, body: Body) -> list[tuple[TemplateMaker, Body]]:
        """Makers of the cells whose facets' errors stand for all, each with the body as it is there."""
        if self.own is None:
            return [(self.maker, body)]
        cells = np.unique(np.concatenate([outer_cells(window), sampled_cells(window, JUDGED)]), axis=0)
        return [(self.own.at((i, j)), self.own.body_at((i, j))) for i, j in cells.tolist()]
