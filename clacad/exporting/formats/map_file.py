"""A file of one face, and the samples in it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.sheet.window import Body, Face, Window

if TYPE_CHECKING:
    from clacad.formats.maps.sag import HeightMap

Misfit = tuple[float, float, str]
"""Greatest deviation in millimetres (or relative, for tables), its allowance for writing, and the compared quantity."""


@dataclass(frozen=True, eq=False)
class FaceFile:
    """A file of one face: the face, its body, its name in files ("array1.front"), and the path."""

    window: Window
    body: Body
    face: Face
    label: str
    path: Path

    @property
    def scale(self) -> float:
        """Millimetres per design unit."""
        return millimetres(self.window.unit)

    def map(self) -> HeightMap:
        """Map of the face as an export writes it."""
        from clacad.formats.maps.sag import height_map, samples_per_cell

        per_cell = samples_per_cell(self.window, None)
        return height_map(self.window, self.body, self.face, self.label, per_cell)


@dataclass(frozen=True, eq=False)
class Samples:
    """Heights of one cell.

    points : (m, 3) lengths
        x and y in the cell frame, z in the sheet frame.
    step : (2,) lengths
    """

    points: Floats
    step: Floats
