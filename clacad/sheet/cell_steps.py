"""How high one lens stands above the next along their border, cell by cell, where lenses stand elsewhere in every cell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.sheet.window import Face, Window, lens_height

PLACES = 9
"""Places of a border at which two lenses are compared: its ends are among them, where the step is greatest as a rule."""


def greatest_steps(window: Window, face: Face, index: Ints) -> Floats:
    """Greatest step (n,), lengths, between a face's lens in each cell `index` (n, 2) and the lenses of kept neighbours.

    Lenses alone are compared; 0 where no neighbour is kept, or all lenses stand alike.
    """
    made = np.zeros(len(index))
    if face.change is None or face.array is None:
        return made
    lattice = window.lattice_of(face.array)
    corners = lattice.tile()
    for k, (di, dj) in enumerate(lattice.steps):
        beside = index + (di, dj)
        kept = np.flatnonzero(window.lattice.contains(beside))
        if not len(kept):
            continue
        t = np.linspace(0.0, 1.0, PLACES)[:, None]
        line = (1.0 - t) * corners[k] + t * corners[(k + 1) % len(corners)]
        own = _heights(window, face, index[kept], line)
        theirs = _heights(window, face, beside[kept], line - np.asarray(lattice.offset(di, dj)))
        made[kept] = np.fmax(made[kept], np.nanmax(np.abs(own - theirs), axis=1, initial=0.0))
    return made


def _heights(window: Window, face: Face, index: Ints, line: Floats) -> Floats:
    """Heights (n, k) of the lenses of cells (n, 2) over points (k, 2) from their centres."""
    assert face.change is not None  # who calls this has looked
    local = line[None] - face.change.at(window.lattice, index)[:, None]
    height = lens_height(replace(face, change=None), local[..., 0].ravel(), local[..., 1].ravel())
    return np.asarray(height).reshape(len(index), len(line))
