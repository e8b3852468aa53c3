"""One tiling of a body: its cell templates and their positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from clacad.mesh.cell_template import TemplateMaker
from clacad.sheet.lattice import Lattice
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.window import Body, Window

if TYPE_CHECKING:
    from clacad.mesh.own_cells import OwnTemplates

JUDGED = 16
"""Number of sampled cells of a non-uniform sheet whose facet errors are measured, besides the outermost
lenses.
"""


@dataclass(frozen=True, eq=False)
class Tiled:
    """One tiling of a body: its templates and their positions.

    maker : TemplateMaker
        Of all cells; in a non-uniform sheet of the first cell.
    shift : (2,) lengths
    lattice : Lattice
        Pattern of the tiling's cells about their own middle.
    own : OwnTemplates or None
        Set if every cell is a separate piece.
    """

    maker: TemplateMaker
    shift: tuple[float, float]
    lattice: Lattice
    own: OwnTemplates | None = None

    def maker_at(self, i: int, j: int) -> TemplateMaker:
        """The maker of the kept cell (i, j)."""
        return self.maker if self.own is None else self.own.at((i, j))

    def judged(self, window: Window, body: Body) -> list[tuple[TemplateMaker, Body]]:
        """Makers of representative cells for facet errors, each with the body of its uniform equivalent."""
        if self.own is None:
            return [(self.maker, body)]
        cells = representative_cells(window, "facets", JUDGED)
        return [(self.own.at((i, j)), self.own.body_at((i, j))) for i, j in cells.tolist()]
