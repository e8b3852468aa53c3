"""One telescopelet as explicit surfaces, without cell borders."""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats
from clacad.optics.sequence import Interface
from clacad.sheet.window import Window


def interfaces(window: Window, slide: Floats | None = None, aside: Floats | None = None) -> list[Interface]:
    """Faces of one telescopelet as explicit surfaces, the centre of cell 1 at x = y = 0.

    slide : (3,) lengths or None
        Displacement of lens 2: its faces, and the plane face of its body.
    aside : (3,) lengths or None
        Displacement of the field lens.
    """
    moved = {1: slide, 2: aside}
    found = []
    for body in window.bodies:
        for face, other, before, after in (
            (body.front, body.back, 1.0, body.index),
            (body.back, body.front, body.index, 1.0),
        ):
            shift = (0.0, 0.0) if face.array is None else window.shifts[face.array]
            vertex = np.asarray(face.vertex) + [*shift, 0.0]
            owner = other.array if face.array is None else face.array
            change = None if owner is None else moved.get(owner)
            if change is not None:
                vertex = vertex + change
            found.append(
                Interface(face.surface, vertex, before, after, None if face.untilted else face.rotation)
            )
    return found


def lens_distance(window: Window) -> float:
    """Distance between the lenses along the axis, design units: in glass for a slab."""
    return window.thin.separation * (window.bodies[0].index if window.form == "slab" else 1.0)
