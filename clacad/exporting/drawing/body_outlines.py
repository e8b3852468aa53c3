"""Outlines of the bodies in a plane y = const, from the same faces that are traced and written."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.sheet.plate import Plate
from clacad.sheet.window import Body, Face, Window, column, face_height


def heights(window: Window, body: Body, x: Floats, y: float) -> tuple[Floats, Floats]:
    """Front and back height (n,) of a body over sheet points (x, y); NaN where it has no material."""
    found = []
    for k, face in enumerate((body.front, body.back)):
        index, local, inside = _place(window, body, face, x, y)
        if body.columnar:
            z = column(window, body, local[0], local[1], index)[k]
        else:
            z = face_height(window, face, local[0], local[1], index)
        beyond = np.nan if face.land is None else face.land
        found.append(np.where(inside, z, face.vertex[2] if face.array is None else beyond))
    front, back = found
    missing = ~(np.isfinite(front) & np.isfinite(back))
    if isinstance(window.outline, Plate):
        missing |= ~window.outline.inside(np.stack([x, np.full_like(x, y)], axis=-1))
    return np.where(missing, np.nan, front), np.where(missing, np.nan, back)


def _place(
    window: Window, body: Body, face: Face, x: Floats, y: float
) -> tuple[Ints, tuple[Floats, Floats], NDArray[np.bool_]]:
    """Cells of the face's own array, points in them, and which lie over kept cells."""
    other = body.back if face is body.front else body.front
    array = face.array if face.array is not None else other.array
    index, lx, ly = window.locate(0 if array is None else array, x, np.full_like(x, y))
    return index, (lx, ly), np.asarray(window.lattice.contains(index))


def outlines(x: Floats, front: Floats, back: Floats) -> list[Floats]:
    """Closed outlines (k, 2) of (x, z), one for each unbroken stretch of material."""
    solid = np.isfinite(front) & np.isfinite(back) & (back >= front)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], solid, [False]]).astype(np.int8)))
    found = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        rows = slice(first, last)
        found.append(
            np.concatenate(
                [np.column_stack([x[rows], front[rows]]), np.column_stack([x[rows], back[rows]])[::-1]]
            )
        )
    return found


def across_cell(window: Window, array: int, samples: int = 161) -> tuple[Floats, float]:
    """Points x (n,) over the cell of an array nearest the middle, along x, and its y; sheet frame."""
    from clacad.sheet.representative_cells import central_cell

    middle = window.centres(array, np.array(central_cell(window), dtype=np.int64))
    half = 0.5 * window.lattice_of(array).pitch[0] * (1.0 - 1e-9)
    return middle[0] + np.linspace(-half, half, samples), float(middle[1])
