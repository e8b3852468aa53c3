"""Law of each cell in sheets where cells have their own offset δ, and possibly their own η."""

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
    """Laws with common lens axes and a δ per cell: δ₀ + K C at the cell's centre C, or from a table; η may
    vary too.

    Parameters
    ----------
    law : Law
        Its δ is δ₀; a table replaces it.
    gradient : ((K_xx, K_xy), (K_yx, K_yy)), 1/length
        Rows: lens axes; columns: sheet axes.
    table : (n1, n2, 2) array or None
        δ of each cell, indexed as the table of `clacad.sheet.cell_places.VertexChange`.
    ratios : (n1, n2) array or None
        η, the ratio −f2/f1 of both lens axes, of each cell, given with such a table; None: the law's η in all
        cells.
    """

    law: Law
    gradient: Gradient = ((0.0, 0.0), (0.0, 0.0))
    table: Floats | None = None
    ratios: Floats | None = None

    @property
    def smooth(self) -> VaryingLaw | None:
        """The law as a continuous function of position; None where a table gives δ."""
        return None if self.table is not None else VaryingLaw(self.law, self.gradient)

    def deltas(self, lattice: Lattice, index: Ints) -> Floats:
        """δ (..., 2) of the cells `index` (..., 2)."""
        smooth = self.smooth
        if smooth is None:
            return VertexChange(table=self.table).at(lattice, index)
        return smooth.deltas(lattice.centres(index))

    def ratios_of(self, lattice: Lattice, index: Ints) -> Floats:
        """η (..., 2) of the cells `index` (..., 2), along the lens axes;
        the law's η for cells that are not kept.
        """
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
        """Exit directions (n, 3) of light with directions `d` (n, 3) through the cells `index` (n, 2)."""
        own = None if self.ratios is None else self.ratios_of(lattice, index)
        return refract_each(self.law, self.deltas(lattice, index), d, own)

    def of_middle(self, lattice: Lattice, count: tuple[int, int]) -> CellLaws:
        """Laws of `count` cells in the centre of their lattice; tables are cut."""
        table, ratios = (
            None if whole is None else of_middle(whole, count, lattice) for whole in (self.table, self.ratios)
        )
        return replace(self, table=table, ratios=ratios)
