"""Uniform equivalent of one cell of a non-uniform sheet: checks of that cell run on the uniform sheet.

Its partner and its lenses have the same relative positions as in that cell. All its cells are identical, so
of two neighbours the equivalent has the outer one twice, and the step at their border is an upper bound.
Where array 2 has another pitch, the equivalent's cells are as wide as those of the wider array, or as those
of the array under test.

`interfaces` gives one telescopelet as explicit surfaces, without cell borders.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats, Ints, Pair2
from clacad.sheet.cell_places import CellPlacement
from clacad.sheet.face_order import refractions
from clacad.sheet.lattice import Circle, Lattice, Outline
from clacad.sheet.plate import Plate

if TYPE_CHECKING:
    from clacad.optics.sequence import Interface
    from clacad.sheet.window import ThinPair, Window


def like_cell(window: Window, index: Ints, widest: bool = True) -> Window:
    """Return the uniform equivalent of the cell at `index` (2,); a uniform window itself.

    widest : bool
        Whether its cells are as wide as those of the wider array; else as those of array 1.
    """
    scales = [max(place.scale(window.lattice)) for place in window.placements]
    wider = max(scales) if widest else 1.0
    return _of_width(window, index, (wider, wider))


def cell_of_array(window: Window, index: Ints, array: int) -> Window:
    """Uniform equivalent of the cell at `index` (2,), with cells as wide and high as an array's."""
    return _of_width(window, index, window.placements[array].scale(window.lattice))


def _of_width(window: Window, index: Ints, wider: Pair2) -> Window:
    """Uniform equivalent of the cell at `index` (2,), its cells `wider` times as wide as array 1's."""
    if window.uniform:
        return window
    first = window.centres(0, index)
    bodies = tuple(
        replace(body, front=window.in_cell(body.front, index), back=window.in_cell(body.back, index))
        for body in window.bodies
    )
    places = tuple(
        CellPlacement(_pair(window.centres(k, index) - first)) for k in range(len(window.placements))
    )
    return replace(
        window,
        bodies=bodies,
        placements=places,
        law=window.law_at(index),
        cell_laws=None,
        lattice=_scaled(window.lattice, wider),
        outline=None if window.outline is None else _larger(window.outline, max(wider)),
        thin=_thin_pair(window, index, first),
    )


def _thin_pair(window: Window, index: Ints, first: Floats) -> ThinPair:
    """Ideal pair of the cell at `index` (2,), whose centre is `first` (2,), alike in all cells."""
    pair, second = window.thin, window.thin.second
    apart = second.lattice(window.lattice).centres(index) + np.asarray(second.shift) - first
    lens_2 = np.array(pair.offset)
    lens_2[:2] += apart - np.asarray(pair.shift)
    lenses = [pair.lenses(array, window.lattice, index) for array in (0, 1)]
    lens_2 += [float(v) for v in lenses[1].apex]
    x, y, z = (float(v) for v in lens_2)
    focal_1, focal_2 = (
        focal if one.size is None else (focal[0] * float(one.size), focal[1] * float(one.size))
        for focal, one in zip(pair.focal_length, lenses, strict=True)
    )
    alike = replace(pair, pitch=None, turn=0.0, change=None, change_1=None)
    return replace(alike, focal_length=(focal_1, focal_2), offset=(x, y, z), shift=_pair(apart))


def _scaled(lattice: Lattice, factor: Pair2) -> Lattice:
    """Lattice with the same cells, kept or not, `factor` times as wide and high."""
    if factor == (1.0, 1.0):
        return lattice
    pitch = (lattice.pitch[0] * factor[0], lattice.pitch[1] * factor[1])
    outline = None if lattice.outline is None else _larger(lattice.outline, max(factor))
    return replace(lattice, pitch=pitch, outline=outline)


def _larger(outline: Outline, factor: float) -> Outline:
    factor = max(factor, 1.0)
    if isinstance(outline, Circle):
        return Circle(outline.diameter * factor)
    assert not isinstance(outline, Plate)  # plates are refused on non-uniform sheets
    return replace(outline, width=outline.width * factor, height=outline.height * factor)


def _pair(v: Floats) -> Pair2:
    return float(v[0]), float(v[1])


def interfaces(window: Window, slide: Floats | None = None, aside: Floats | None = None) -> list[Interface]:
    """Faces of one telescopelet as explicit surfaces, the centre of cell 1 at x = y = 0.

    slide : (3,) lengths or None
        Displacement of lens 2: its faces, and the plane face of its body.
    aside : (3,) lengths or None
        Displacement of the field lens.
    """
    from clacad.optics.sequence import Interface

    moved = {1: slide, 2: aside}
    found = []
    for body, face, before, after in refractions(window.bodies):
        shift = (0.0, 0.0) if face.array is None else window.shifts[face.array]
        vertex = np.asarray(face.vertex) + [*shift, 0.0]
        change = moved.get(body.arrays[0] if face.array is None else face.array)
        if change is not None:
            vertex = vertex + change
        found.append(Interface(face.surface, vertex, before, after, None if face.untilted else face.rotation))
    return found


def lens_distance(window: Window) -> float:
    """Distance between the lenses along the axis, design units: in glass for a slab, and of listed faces."""
    if window.form == "plates":
        return window.bodies[-1].back.vertex[2] - window.bodies[0].front.vertex[2]
    return window.thin.separation * (window.bodies[0].index if window.form == "slab" else 1.0)
