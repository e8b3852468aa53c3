"""Which cell of a sheet a whole sheet is judged by, and light through that cell of it.

Where cells are alike it is the middle one. Else it is that whose light leaves farthest from the law, of those whose lenses stand
farthest out and of a sample over the sheet. Bundles are made for the sheet of equal cells like it, and sent through the whole
sheet, neighbours and all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.optics.law import angle_between
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.asked_focus import less_focus
from clacad.sheet.bundle import Bundle, bundle, central_cell
from clacad.sheet.like_cell import like_cell, outer_cells, sampled_cells
from clacad.sheet.window import Window
from clacad.tracing.trace import trace

TRIED_RAYS = 256
"""Rays through each cell from which the worst is chosen."""

FEWEST_TRIED = 8
"""Of them that must get through for a cell to be judged by where they go."""


@dataclass(frozen=True, eq=False)
class SeenCell:
    """One cell of a sheet: bundles are made for the sheet of equal cells like it, and sent through the sheet itself.

    Attributes
    ----------
    window : Window
        The sheet.
    like : Window
        Of equal cells; the sheet itself where its cells are alike.
    cell : (2,) ints
    tried : int
        Cells of which this is the worst; 0 where all are alike.
    """

    window: Window
    like: Window
    cell: Ints
    tried: int = 0

    @property
    def buildable(self) -> Window:
        """`like` without a cut outline, with room for partners that stand aside: what meshes and solids are made of."""
        return self.like if self.like is self.window else self.like.with_cells(self.like.lattice.count)

    def send(self, lit: Bundle) -> TraceResult:
        """Trace a bundle that was made for `like` through this cell of the sheet."""
        return trace(self.window, self.placed(lit).rays, path="size")

    def placed(self, lit: Bundle) -> Bundle:
        """A bundle that was made for `like`, before this cell of the sheet."""
        if self.like is self.window:
            return lit
        cell = (int(self.cell[0]), int(self.cell[1]))
        return replace(lit, cell=cell, rays=Rays(self.moved(lit), lit.rays.direction))

    def moved(self, lit: Bundle) -> Floats:
        """Starts (n, 3) of a bundle that was made for `like`, before this cell of the sheet."""
        apart = self.window.centres(0, self.cell) - self.like.centres(0, np.array(lit.cell))
        return np.asarray(lit.rays.position + [*apart, 0.0])


def worst_cell(window: Window, field: float) -> SeenCell:
    """The cell whose light of a cone (half angle `field`, radians) leaves farthest from the law, of those tried."""
    return worst_of(tried_cells(window), field)


def tried_cells(window: Window) -> list[SeenCell]:
    """The one cell of a sheet of equal cells; else those whose lenses stand farthest out, and a sample over the sheet."""
    if window.uniform:
        return [SeenCell(window, window, np.array(central_cell(window)))]
    cells = np.unique(np.concatenate([outer_cells(window), sampled_cells(window)]), axis=0)
    return [SeenCell(window, like_cell(window, cell, widest=False), cell, len(cells)) for cell in cells]


def worst_of(tried: list[SeenCell], field: float) -> SeenCell:
    """That through which next to no light gets, else whose light leaves farthest (rms) from the law."""
    if len(tried) == 1:
        return tried[0]
    rays, alive, direction = through_all(tried, field)
    each = rays.direction.reshape(len(tried), -1, 3)
    asked = np.concatenate([one.like.law.refract(some) for one, some in zip(tried, each, strict=True)])
    error = np.where(alive, angle_between(direction, asked), np.nan).reshape(len(tried), -1)
    through = alive.reshape(len(tried), -1).sum(axis=1)
    dark = through < FEWEST_TRIED
    rms = np.sqrt(np.nansum(error**2, axis=1) / np.maximum(through, 1))
    return tried[int(np.argmax(np.where(dark, np.inf, rms)))]


def through_all(tried: list[SeenCell], field: float) -> tuple[Rays, Bools, Floats]:
    """Rays through every cell of a sheet that is tried, as many through each; which are ALIVE, and where they go."""
    starts, rays, points = [], [], []
    for one in tried:
        lit = bundle(one.like, TRIED_RAYS, field)
        starts.append(one.moved(lit))
        rays.append(lit.rays.direction)
        points.append(lit.points)
    sent = Rays(np.concatenate(starts), np.concatenate(rays))
    result = trace(tried[0].window, sent, path="size")
    direction = less_focus(tried[0].window, np.concatenate(points), result.direction)
    return sent, result.fate == Fate.ALIVE, direction
