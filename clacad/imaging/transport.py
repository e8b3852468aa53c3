"""Assignment of cells to points of a target that keeps the distances short.

Up to `EXACT` cells the sum of squared distances is minimal (scipy.optimize.linear_sum_assignment: D. F.
Crouse, IEEE Trans. Aerosp. Electron. Syst. 52, 1679 (2016)). Larger sets are halved together with their
points, across the longer side of the cells, until at most `EXACT` are left: a transport by bisection, which
keeps the order of cells along each cut. The assignment is deterministic.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats, Ints

EXACT = 512
"""Largest number of cells that are assigned optimally."""


def assigned(cells: Floats, places: Floats) -> Ints:
    """Index of the point assigned to each cell, (n,); each point is used once.

    Parameters
    ----------
    cells, places : (n, 2) lengths
    """
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    found = np.empty(len(cells), dtype=np.int64)
    waiting = [(np.arange(len(cells)), np.arange(len(places)))]
    while waiting:
        own, theirs = waiting.pop()
        if len(own) <= EXACT:
            _, chosen = linear_sum_assignment(cdist(cells[own], places[theirs], "sqeuclidean"))
            found[own] = theirs[chosen]
            continue
        axis = int(np.argmax(np.ptp(cells[own], axis=0)))
        half = len(own) // 2
        own, theirs = own[_sorted(cells[own], axis)], theirs[_sorted(places[theirs], axis)]
        waiting += [(own[:half], theirs[:half]), (own[half:], theirs[half:])]
    return found


def _sorted(points: Floats, axis: int) -> Ints:
    """Order (n,) of points (n, 2) along an axis, ties by the other axis."""
    return np.lexsort((points[:, 1 - axis], points[:, axis])).astype(np.int64)
