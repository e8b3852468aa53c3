"""One sheet of several in a file: which parts of an assembly are its own, told in its own frame. Lengths in mm.

A file of sheets behind one another is cut at planes between them. A part belongs to the sheet between whose planes the
middle of its height lies, so that every part belongs to one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.formats.step.lens_placements import LensPoints
from clacad.formats.step.placements import applied
from clacad.formats.step.shape_parts import ShapePart, box, moved, turns


@dataclass(frozen=True, slots=True)
class SheetPlace:
    """Where in a file a sheet stands.

    Parameters
    ----------
    low, high : float, mm
        Planes between which it lies; infinite at the ends of the file.
    z : float, mm
        Height of the sheet's own z = 0.
    """

    low: float
    high: float
    z: float

    def holds(self, middle: Floats) -> Bools:
        """Which heights (n,) lie between the planes."""
        return np.asarray((middle >= self.low) & (middle < self.high))

    def own(self, placements: Floats) -> Floats:
        """Placements (k, 3, 4) of the file in the sheet's frame."""
        return np.asarray(placements - np.array([[0.0] * 4, [0.0] * 4, [0.0, 0.0, 0.0, self.z]]))

    def of_pieces(self, several: Sequence[ShapePart]) -> list[ShapePart]:
        """The pieces of a file that are the sheet's, each in those of its placements that are."""
        found = []
        for piece in several:
            kept = [np.empty((0, 3, 4))]
            for turn, moves in turns(piece.placements):
                corners = np.array(box(moved(piece.shape, turn)))
                inside = self.holds(corners[:, 2].mean() + moves[:, 2])
                placed = np.repeat(turn[None], int(inside.sum()), axis=0)
                placed[:, :, 3] = moves[inside]
                kept.append(placed)
            placements = np.concatenate(kept)
            if len(placements):
                found.append(replace(piece, placements=self.own(placements)))
        return found

    def of_parts(self, lenses: LensPoints, parts: Sequence[Floats]) -> list[Floats]:
        """Of the placements (k, 3, 4) of each part those that are the sheet's, told by the part's lenses."""
        found = []
        for number, placements in enumerate(parts):
            place = lenses.of_part(number).place
            if not len(place):
                found.append(np.empty((0, 3, 4)))
                continue
            middle = applied(placements, place.mean(axis=0)[None, None])[:, 0, 2]
            found.append(self.own(placements[self.holds(middle)]))
        return found
