"""Meshes of a non-uniform sheet's tiling: each cell has its own prototile with borders common to neighbours.

A lens surface is cut at a different place in every cell. Samples of a border, their levels and those of its
nodes are computed once, from the lenses of the cells that meet there, and both cells use them. Cells are made
on demand and dropped some rows later, so that a sheet of any size needs the memory of a few rows.
"""

from __future__ import annotations

from functools import lru_cache, partial

from clacad.mesh.cell_template import Offset, TemplateMaker
from clacad.mesh.integer_heights import CellLevels
from clacad.mesh.prototile import make_prototile
from clacad.sheet.window import Body

ROWS = 4
"""Number of rows of cells kept: a row borders on the ones below and above it, and these on theirs."""


class OwnTemplates:
    """Makers of the cells of one tiling, one per cell.

    Parameters
    ----------
    base : CellLevels
        Heights of the tiling, for no specific cell.
    quads : int
        Grid steps per cell side.
    """

    def __init__(self, base: CellLevels, quads: int) -> None:
        self._base, self.quads = base, quads
        room = ROWS * (base.window.lattice.count[0] + 2)
        self._levels = lru_cache(maxsize=room)(self._make_levels)
        self._makers = lru_cache(maxsize=room)(self._make)

    def at(self, index: Offset) -> TemplateMaker:
        """The maker of the kept cell at `index`."""
        return self._makers(index)

    def body_at(self, index: Offset) -> Body:
        """The body of the uniform equivalent of the cell at `index`."""
        return self._levels(index).body

    def _make_levels(self, index: Offset) -> CellLevels:
        return self._base.of_cell(index, self._levels)

    def _make(self, index: Offset) -> TemplateMaker:
        tile = make_prototile(self._levels(index), self.quads)
        return TemplateMaker(tile, self._base.window.lattice, partial(self._beside, index))

    def _beside(self, index: Offset, step: Offset) -> TemplateMaker:
        return self._makers((index[0] + step[0], index[1] + step[1]))
