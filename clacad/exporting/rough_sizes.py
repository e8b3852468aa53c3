"""Numbers of a sheet from which formats derive rough sizes, without meshing or generating text.

Facets are within 40 %, for grids above 32 within 10 %.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from clacad.design.faces import listed_lenses
from clacad.sheet.grid_steps import lens_squares

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.window import Window

IDENTITY = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


@dataclass(frozen=True, slots=True)
class RoughSheet:
    """Numbers that determine the sizes of a sheet's files.

    Attributes
    ----------
    lenses : int
        Faces with lenslets.
    bodies : int
    cells : int
        At least 1: an outline may leave none whole.
    count : (n1, n2)
    hexagonal : bool
    tilted : bool
        Lenslets are tilted, so that neighbours do not join at their borders.
    repeats : bool
        Whether the sheet is uniform, without an outline or land between cells and outline.
    cylinders : bool
        Every lenslet is a cylinder along its cell, which takes one step of the grid that way.
    """

    lenses: int
    bodies: int
    cells: int
    count: tuple[int, int]
    hexagonal: bool
    tilted: bool
    repeats: bool
    cylinders: bool = False

    @staticmethod
    def of_design(design: Design) -> RoughSheet:
        """Numbers of a design before it is prescribed."""
        form, lattice = design.pair.form, design.lattice
        n1, n2 = (int(n) for n in lattice.count)
        lenses, bodies = (4 if form == "biconvex" else 2), (1 if form == "slab" else 2)
        if form == "plates":
            lenses, bodies = listed_lenses(design.pair.face)
        return RoughSheet(
            lenses,
            bodies,
            n1 * n2,
            (n1, n2),
            lattice.kind == "hexagonal",
            design.law.rotation.tolist() != IDENTITY,
            lattice.outline is None,
            design.law_spec.cylinders and design.law.rotation.tolist() == IDENTITY and not design.pair.given,
        )

    @staticmethod
    def of_window(window: Window) -> RoughSheet:
        """Numbers of the sheet as built."""
        lattice = window.lattice
        n1, n2 = (int(n) for n in lattice.count)
        lenses = [face for face in window.faces if face.array is not None]
        tilted = not all(face.untilted for face in lenses)
        return RoughSheet(
            len(lenses),
            len(window.bodies),
            max(1, lattice.cell_count),
            (n1, n2),
            lattice.hexagonal,
            tilted,
            window.uniform and window.outline is None,
            lens_squares(window, 2) == 2 * len(lenses),
        )

    def facets(self, quads: int) -> int:
        """Facets of one cell of all bodies: two per square of each lens grid, and some for walls of tilted
        lenses.
        """
        return self.lenses * (self._lens(quads) + (4 * quads if self.tilted else 0))

    def piece(self, quads: int) -> int:
        """Facets of one cell with its sides, as formats repeat it; a flat back is divided into a fan."""
        flat = 4 if self.lenses == self.bodies > 1 else 0
        return self.lenses * self._lens(quads) + (8 + flat) * quads * self.bodies

    def _lens(self, quads: int) -> int:
        """Facets of one lens."""
        return 2 * quads * (1 if self.cylinders else quads) * (3 if self.hexagonal else 1)
