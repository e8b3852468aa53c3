"""The law of each cell, where cells differ in their offset δ, and perhaps in η."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from clacad.base.types import Floats, Ints
from clacad.optics.law import Law
from clacad.optics.law.varying import Gradient, VaryingLaw, ratios_of, refract_each, with_ratios
from clacad.sheet.cell_places import VertexChange, of_middle, tabled
from clacad.sheet.lattice import Lattice


@dataclass(frozen=True, eq=False)
class CellLaws:
    """Laws that share the lens axes and differ in δ: δ₀ + K C at the cell's centre C, or as a table says; perhaps in η too.

    Parameters
    ----------
    law : Law
        Its δ is δ₀; with a table it is not used.
    gradient : ((K_xx, K_xy), (K_yx, K_yy)), 1/length
        Rows: lens axes; columns: sheet axes.
    table : (n1, n2, 2) array or None
        δ cell by cell, indexed as the table of `clacad.sheet.cell_places.VertexChange`.
    ratios : (n1, n2) array or None
        η, the ratio −f2/f1, cell by cell, of both lens axes, beside such a table; None: all have the law's.
    """

    law: Law
    gradient: Gradient = ((0.0, 0.0), (0.0, 0.0))
    table: Floats | None = None
    ratios: Floats | None = None

    @property
    def smooth(self) -> VaryingLaw | None:
        """The law without cells; a table has none."""
        return None if self.table is not None else VaryingLaw(self.law, self.gradient)

    def deltas(self, lattice: Lattice, index: Ints) -> Floats:
        """δ (..., 2) of the cells `index` (..., 2)."""
        smooth = self.smooth
        if smooth is None:
            return VertexChange(table=self.table).at(lattice, index)
        return smooth.deltas(lattice.centres(index))

    def ratios_of(self, lattice: Lattice, index: Ints) -> Floats:
        """η (..., 2) of the cells `index` (..., 2), along the lens axes; the law's of cells that are not kept."""
        if self.ratios is None:
            return np.broadcast_to(ratios_of(self.law), (*index.shape[:-1], 2))
        return np.repeat(tabled(self.ratios, lattice, index, ratios_of(self.law)[0])[..., None], 2, axis=-1)

    def law_at(self, lattice: Lattice, index: ArrayLike) -> Law:
        """Law of the cell `index` (2,).

        Raises
        ------
        IndexError
            No such cell is kept.
        """
        cell = np.asarray(index, dtype=np.int64)
        if cell.shape != (2,) or not lattice.contains(cell):
            raise IndexError(f"the sheet has no cell {np.asarray(index).tolist()}")
        delta_x, delta_y = self.deltas(lattice, cell).tolist()
        law = replace(self.law, delta_x=delta_x, delta_y=delta_y)
        if self.ratios is None:
            return law
        return with_ratios(law, self.ratios_of(lattice, cell))

    def refract(self, lattice: Lattice, index: Ints, d: Floats) -> Floats:
        """Directions (n, 3) behind the cells `index` (n, 2) that light (n, 3) meets."""
        own = None if self.ratios is None else self.ratios_of(lattice, index)
        return refract_each(self.law, self.deltas(lattice, index), d, own)

    def of_middle(self, lattice: Lattice, count: tuple[int, int]) -> CellLaws:
        """The same laws on `count` cells in the middle of the lattice they are for."""
        table, ratios = (
            None if whole is None else of_middle(whole, count, lattice) for whole in (self.table, self.ratios)
        )
        return replace(self, table=table, ratios=ratios)
