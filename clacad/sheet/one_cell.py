"""One cell of a sheet whose cells differ, as a sheet of cells that are all like it.

What is said of equal cells can so be said of any cell: heights, rules, field, law.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.sheet.cell_places import CellPlacement
from clacad.sheet.window import Face, Window


def sheet_like(window: Window, index: Ints) -> Window:
    """Sheet of as many cells, all like the cell `index` (2,); a sheet of equal cells comes back as it is.

    Its arrays have the lattice's pitch and are displaced as that cell's lenses are.
    """
    if window.uniform and window.cell_laws is None:
        return window
    cell = np.asarray(index, dtype=np.int64)
    centre = window.centres(0, cell)
    moved = [window.centres(array, cell) - centre for array in range(len(window.placements))]

    def alike(face: Face) -> Face:
        return replace(face, vertex=_triple(window.vertices(face, cell)), change=None)

    bodies = tuple(replace(body, front=alike(body.front), back=alike(body.back)) for body in window.bodies)
    thin = window.thin
    own = window.lattice if thin.pitch is None else replace(window.lattice, pitch=thin.pitch, outline=None)
    shift = own.centres(cell) + np.asarray(thin.shift) - centre
    lens_2 = np.array(thin.offset)
    lens_2[:2] += shift - np.asarray(thin.shift)
    if thin.change is not None:
        lens_2[:2] += thin.change.at(window.lattice, cell)
    return replace(
        window,
        bodies=bodies,
        placements=tuple(CellPlacement((float(x), float(y))) for x, y in moved),
        law=window.law_at(cell),
        cell_laws=None,
        thin=replace(
            thin, offset=_triple(lens_2), shift=(float(shift[0]), float(shift[1])), pitch=None, change=None
        ),
    )


def _triple(v: Floats) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])
