"""Types that compiled functions exchange: rays, the rows of the result, scratch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clacad.base.compiled import making
from clacad.base.types import Bytes, Cells, Floats, Ints

MOST_ARRAYS = 3
"""Arrays that a packed sheet has room for: two numbers an array from SHIFT, four a pair from BETWEEN."""

Vector = tuple[float, float, float]

# Slots of an event, the next thing a ray meets: kind, distance, then for each array its cell i, j and the
# ray's start seen from there, then the normal of a facet.
KIND, DISTANCE, PLACE = range(3)
FACET_NORMAL = PLACE + 4 * MOST_ARRAYS
EVENT_NUMBERS = FACET_NORMAL + 3

# Slots of the search's floats; the first are distances that divide the ray. Two numbers for each array
# follow: start as given, start seen from the present cell, cell as given, present cell, steps in between.
DIVISIONS = 24
BASE, START, HOME, CELL, STEP, WORK_NUMBERS = range(DIVISIONS, DIVISIONS + 12 * MOST_ARRAYS, 2 * MOST_ARRAYS)

DEPTH = 64
"""Largest number of boxes waiting on the stack of a tree."""

FACET = 20
"""Slot in the search's integers of the facets that the arrays are in; causes of divisions come first."""

# Slots of a ray on its walk: cell, point and direction; optical length; point of the sheet; cells met first,
# last, and first that differs; the array the cell belongs to; marks; the last face met.
CI, CJ, X, Y, Z, DX, DY, DZ, PATH, PX, PY, PZ, FIRST = range(13)
LAST, ODD, AT_ARRAY, SECOND, GHOSTLY, LANDED, SURFACE, WALKER_NUMBERS = 14, 16, 18, 19, 20, 21, 22, 23


class Ray(NamedTuple):
    """A point (lengths) and a direction; each use specifies the frame."""

    x: float
    y: float
    z: float
    L: float
    M: float
    N: float


class CellRay(NamedTuple):
    """A ray in a cell (i, j) of an array: x, y from its centre, z over the level of the current body."""

    array: int
    i: float
    j: float
    x: float
    y: float
    z: float
    L: float
    M: float
    N: float


class Launched(NamedTuple):
    """A ray carried to the first body's reference plane: in cells of array 0, with the distance so far."""

    i: float
    j: float
    x: float
    y: float
    z: float
    L: float
    M: float
    N: float
    carried: float


class Outcome(NamedTuple):
    """Columns of the result; see `clacad.optics.rays.TraceResult`.

    position, direction : (n, 3); fate : (n,) bytes; path : (n,) lengths
    cell, order : (n, 2) ints; surface : (n,) ints
    hits, turns : (faces, n, 3) or (0, n, 3). Point where each face was met, and the direction behind it.
    """

    position: Floats
    direction: Floats
    fate: Bytes
    path: Floats
    cell: Cells
    order: Cells
    surface: Cells
    hits: Floats
    turns: Floats


class Scratch(NamedTuple):
    """Working memory for the walk of one ray.

    walker, left : (WALKER_NUMBERS,). The ray, and its state as it left the last body.
    event : (EVENT_NUMBERS,). The next thing it meets.
    work : (WORK_NUMBERS,), causes : (DIVISIONS,) ints, stack : (DEPTH,) ints
        Search for that event on faces and in a tree of boxes.
    """

    walker: Floats
    left: Floats
    event: Floats
    work: Floats
    causes: Ints
    stack: Ints


@making
def new_scratch() -> Scratch:
    """Allocate the working memory for the walks of one thread."""
    return Scratch(
        np.empty(WALKER_NUMBERS),
        np.empty(WALKER_NUMBERS),
        np.empty(EVENT_NUMBERS),
        np.empty(WORK_NUMBERS),
        np.empty(DIVISIONS, dtype=np.int64),
        np.empty(DEPTH, dtype=np.int64),
    )
