"""The honeycomb between the arrays: sheared prisms from each cell's border to its partner's."""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.sheet.lattice import less_steps
from clacad.tracing.layout import Layout


def reach(layout: Layout, left: Floats, met: Floats, order: Ints) -> Floats:
    """Fraction of the gap that rays cross before they meet the honeycomb.

    Parameters
    ----------
    left, met : (m, 2) lengths
        Where they leave array 1 and meet array 2, each relative to its cell.
    order : (m, 2) ints
        Cell met minus cell left; (0, 0) is the partner.

    Returns
    -------
    (m,) array
        0 … 1 of the way to array 2 where the wall is met; inf for rays that pass.

    Notes
    -----
    In the frame that is sheared with the prisms a ray is a straight line from `left` to `met` plus the
    order's displacement. The prism is the cell less half a wall on every border.
    """
    assert layout.window.baffle is not None
    margin = 0.5 * layout.window.baffle.wall
    target = less_steps(layout.lattice, met, -order)
    first = np.full(len(left), np.inf)
    for (ux, uy), half in zip(layout.normals[0], layout.halves, strict=True):
        here = ux * left[:, 0] + uy * left[:, 1]
        there = ux * target[:, 0] + uy * target[:, 1]
        free = half - margin
        with np.errstate(divide="ignore", invalid="ignore"):
            exits = (np.copysign(free, there - here) - here) / (there - here)
        hit = np.where(np.abs(here) > free, 0.0, np.where(np.abs(there) > free, exits, np.inf))
        first = np.minimum(first, hit)
    stray = (order != 0).any(axis=1) & ~np.isfinite(first)
    return np.where(stray, 1.0, first)
