"""What a search changed in the glass, drawn: heights of each face after it less those before."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.report.figures import ACCENT, INK, SECOND, Margins, panels, svg
from clacad.sheet.window import Face, lens_height

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from clacad.verification import Report

POINTS = 161
"""Across the cell."""


def change_of_faces(before: Report, after: Report) -> str:
    """Change of height of every lens face along x and y through the middle of its cell, towards +z (µm)."""
    pairs = [
        (f"lens {one.array + 1}, {'front' if one.side > 0 else 'back'}", one, two)
        for one, two in zip(before.window.faces, after.window.faces, strict=True)
        if one.array is not None
    ]
    half = 0.5 * np.array(before.window.lattice.pitch)
    um = 1e3 * millimetres(before.window.unit)

    def draw(figure: Figure) -> None:
        room = Margins(left=0.72, bottom=0.5, top=0.34, across=0.62, down=0.5)
        axes = np.atleast_2d(panels(figure, (len(pairs) + 1) // 2, 2, room))
        for panel, (name, one, two) in zip(axes.ravel(), pairs, strict=False):
            for axis, colour in ((0, ACCENT), (1, SECOND)):
                along = np.linspace(-1.0, 1.0, POINTS) * half[axis] * (1 - 1e-9)
                panel.plot(
                    along / (2.0 * half[axis]),
                    um * (_heights(two, along, axis) - _heights(one, along, axis)),
                    color=colour,
                    label=f"along {'xy'[axis]}",
                )
            panel.set_title(name, fontsize=9, color=INK)
            panel.set_ylabel("change (µm)")
            panel.locator_params(nbins=5)
        for panel in axes[-1]:
            panel.set_xlabel("place across the cell (pitches)")
        axes[0][0].legend(loc="best", fontsize=8)

    return svg(7.6, 2.4 * ((len(pairs) + 1) // 2), "change of the faces", draw)


def _heights(face: Face, along: Floats, axis: int) -> Floats:
    """Heights along one axis of the cell, over the vertex."""
    zero = np.zeros_like(along)
    x, y = (along, zero) if axis == 0 else (zero, along)
    return np.asarray(lens_height(face, x, y) - face.vertex[2])
