"""One sheet of several in a file: which parts of an assembly belong to it, in its own frame. Lengths in mm.

A file of sheets behind one another is cut at planes between them. A part belongs to the sheet between whose
planes the middle of its height lies, so every part belongs to exactly one sheet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.formats.placements import Placements, applied, turns
from clacad.formats.step.lens_placements import LensPoints
from clacad.formats.step.shape_parts import ShapePart, box, moved


@dataclass(frozen=True, slots=True)
class SheetPlace:
    """Position of a sheet in a file.

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
        """The pieces of a file that belong to the sheet, each with the placements that do."""
        found = []
        for piece in several:
            own = self._of_piece(piece)
            if len(own):
                found.append(replace(piece, placements=own))
        return found

    def _of_piece(self, piece: ShapePart) -> Placements:
        """Placements of a piece that belong to the sheet, in its frame."""
        placements = piece.placements
        if _rows_level(placements):
            return self._of_rows(placements, float(np.array(box(piece.shape))[:, 2].mean()))
        kept = [np.empty((0, 3, 4))]
        for turn, moves in turns(placements.all()):
            corners = np.array(box(moved(piece.shape, turn)))
            inside = self.holds(corners[:, 2].mean() + moves[:, 2])
            placed = np.repeat(turn[None], int(inside.sum()), axis=0)
            placed[:, :, 3] = moves[inside]
            kept.append(placed)
        return Placements(self.own(np.concatenate(kept)))

    def of_parts(self, lenses: LensPoints, parts: Sequence[Placements]) -> list[Placements]:
        """Placements of each part that belong to the sheet, decided by the part's lenses."""
        found = []
        for number, placements in enumerate(parts):
            place = lenses.of_part(number).place
            if not len(place):
                found.append(Placements(np.empty((0, 3, 4))))
            elif _rows_level(placements):
                found.append(self._of_rows(placements, float(place.mean(axis=0)[2])))
            else:
                every = placements.all()
                middle = applied(every, place.mean(axis=0)[None, None])[:, 0, 2]
                found.append(Placements(self.own(every[self.holds(middle)])))
        return found

    def _of_rows(self, placements: Placements, middle: float) -> Placements:
        """Placements of a part in rows that belong to the sheet, its middle at that height (mm) in its own
        frame.
        """
        inside = self.holds(middle + placements.outer[:, 2, 3])
        return replace(placements, outer=self.own(placements.outer[inside]))


def _rows_level(placements: Placements) -> bool:
    """Whether parts only move, those of one row not in height."""
    return placements.unturned and not placements.inner[:, 2, 3].any()
