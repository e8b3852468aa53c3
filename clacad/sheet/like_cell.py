"""Uniform equivalent of one cell of a non-uniform sheet: checks of that cell run on the uniform sheet.

Its partner and its lenses have the same relative positions as in that cell. All its cells are identical, so
of two neighbours the equivalent has the outer one twice, and the step at their border is an upper bound.
Where array 2 has another pitch, the equivalent's cells are as wide as those of the wider array, or as those
of the array under test.

`interfaces` gives one telescopelet as explicit surfaces, without cell borders. `in_light` and `heated` give
the window with other indices.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats, Ints, Pair2
from clacad.base.vectors import xy
from clacad.optics.material.material import NOT_PUBLISHED, state_it
from clacad.optics.surface.sag_and_normal import resized
from clacad.sheet.cell_places import CellPlacement
from clacad.sheet.face_order import refractions
from clacad.sheet.lattice import Circle, Lattice, Outline
from clacad.sheet.plate import Plate

if TYPE_CHECKING:
    from clacad.optics.rays import Rays
    from clacad.optics.sequence import Interface
    from clacad.sheet.window import Body, Face, ThinPair, Window


def like_cell(window: Window, index: Ints, widest: bool = True) -> Window:
    """Return the uniform equivalent of the cell at `index` (2,); a uniform window itself.

    widest : Whether its cells are as wide as those of the wider array; else as those of array 1.
    """
    scales = [max(place.scale(window.lattice)) for place in window.placements]
    wider = max(scales) if widest else 1.0
    return _of_width(window, index, (wider, wider))


def named_cell(window: Window, cell: tuple[int, int], widest: bool = False) -> Window:
    """Uniform equivalent of a cell, its name followed by that of the cell; a uniform window itself."""
    if window.uniform:
        return window
    like = like_cell(window, np.array(cell, dtype=np.int64), widest)
    return replace(like, name=f"{window.name} cell {cell[0]},{cell[1]}")


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
    bodies = tuple(body.simplified for body in bodies)
    places = tuple(CellPlacement(xy(window.centres(k, index) - first)) for k in range(len(window.placements)))
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
        xy(np.array(one.focal(focal))) for focal, one in zip(pair.focal_length, lenses, strict=True)
    )
    field = []
    for lens in pair.field:
        depth, places = lens.in_cells(window.lattice, index)
        focal = xy(np.array(places.focal(lens.focal_length)))
        field.append(replace(lens, focal_length=focal, depth=float(depth), change=None))
    axes = lenses[0].axes(pair.rotation)
    assert axes is not None
    alike = replace(pair, pitch=None, turn=0.0, change=None, change_1=None, field=tuple(field))
    alike = replace(alike, rotation=axes.reshape(3, 3))
    return replace(alike, focal_length=(focal_1, focal_2), offset=(x, y, z), shift=xy(apart))


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
    if isinstance(outline, Plate):
        return outline.scaled(factor)
    return replace(outline, width=outline.width * factor, height=outline.height * factor)


def interfaces(window: Window, slide: Floats | None = None, aside: Floats | None = None) -> list[Interface]:
    """Faces of one telescopelet as explicit surfaces, the centre of cell 1 at x = y = 0.

    slide : (3,) lengths or None. Displacement of lens 2: its faces, and the plane face of its body.
    aside : (3,) lengths or None. Displacement of the field lens.
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


def in_light(window: Window, wavelength: float) -> Window:
    """The window with the indices of a wavelength (metres); ValueError outside a material's data."""
    bodies = tuple(replace(body, index=body.index_at(wavelength)) for body in window.bodies)
    return replace(window, bodies=bodies)


def lit_by(window: Window, rays: Rays) -> Window:
    """The window with the indices of the rays' one wavelength; itself at the design wavelength."""
    return window if rays.wavelength is None else in_light(window, float(rays.wavelength[0]))


def heated(window: Window, kelvin: float) -> Window:
    """The window at a temperature `kelvin` higher, all lengths over the expansion of its first body.

    Sheets of one material change their index only. Of several, each thickness grows by its own material,
    and the radii of a joint by the mean of both; gaps of air keep their length. ValueError where no dn/dT, or
    of several materials no expansion, is known.
    """
    bodies = tuple(body.heated(kelvin) for body in window.bodies)
    if len({body.material for body in window.bodies}) == 1:
        return replace(window, bodies=bodies)
    grown = [kelvin * (_expansion(body) - _expansion(bodies[0])) for body in bodies]
    found: list[Body] = []
    z = bodies[0].front.vertex[2]
    for number, body in enumerate(bodies):
        front, back = body.front, body.back
        if number and not body.joined:
            z += front.vertex[2] - bodies[number - 1].back.vertex[2]
        before = grown[number - 1] if number and body.joined else grown[number]
        beyond = number + 1 < len(bodies) and bodies[number + 1].joined
        behind = grown[number + 1] if beyond else grown[number]
        front = _moved(front, z, 0.5 * (before + grown[number]))
        z += (body.back.vertex[2] - body.front.vertex[2]) * (1.0 + grown[number])
        found.append(replace(body, front=front, back=_moved(back, z, 0.5 * (grown[number] + behind))))
    return replace(window, bodies=tuple(found))


def _expansion(body: Body) -> float:
    material = body.material
    if material is None:
        raise ValueError(f"{body.name}: the expansion of an index without a material is not known")
    if material.thermal.expansion is None:
        raise ValueError(
            f"expansion of {material.name}: {NOT_PUBLISHED}; {state_it(material.name, 'expansion')}"
        )
    return material.thermal.expansion


def _moved(face: Face, z: float, growth: float) -> Face:
    """The face at another height (length), its radii times 1 + growth."""
    land = None if face.land is None else face.land + z - face.vertex[2]
    vertex = (*face.vertex[:2], z)
    return replace(face, surface=resized(face.surface, 1.0 + growth), vertex=vertex, land=land)
