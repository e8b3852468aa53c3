"""What every step of making a prototile needs: the body, its tiling, and heights as levels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.mesh.integer_heights import FAR, NONE, to_levels
from clacad.sheet.window import Body, Window, lens_height
from clacad.topology.complex_parts import CellComplex, Tiling


@dataclass(frozen=True, eq=False)
class Maker:
    """What every step of making a prototile needs."""

    window: Window
    body: Body
    cells: CellComplex
    tiling: Tiling
    step: float
    gap: int
    bevel: float = 0.0

    def names(self) -> tuple[bool, bool]:
        """Whether front and back belong to this tiling's mesh."""
        if self.cells.columnar:
            return True, True
        return self.body.front.array == self.tiling.array, self.body.back.array == self.tiling.array

    def heights(self, xy: Floats) -> Floats:
        """Front and back lens (or plane) heights (n, 2) over cell-frame points; ±inf for a face apart."""
        out = np.empty((len(xy), 2))
        for n, (face, here) in enumerate(zip((self.body.front, self.body.back), self.names())):
            if not here:
                out[:, n] = (-np.inf, np.inf)[n]
            elif face.array is None:
                out[:, n] = face.vertex[2]
            else:
                out[:, n] = lens_height(face, xy[:, 0], xy[:, 1])
        return out

    def levels(self, heights: Floats) -> Ints:
        """Round heights (..., 2)."""
        front = to_levels(heights[..., 0], self.step, NONE)
        back = to_levels(heights[..., 1], self.step, -NONE)
        return np.stack([front, back], axis=-1)

    @property
    def land(self) -> tuple[int, int]:
        """Levels of the land, ±NONE where there is none."""
        out = []
        for face, missing in ((self.body.front, NONE), (self.body.back, -NONE)):
            flat = face.vertex[2] if face.array is None else face.land
            out.append(missing if flat is None else int(to_levels(np.array([flat]), self.step, missing)[0]))
        front, back = self.names()
        return (out[0] if front else -FAR, out[1] if back else FAR)

    @property
    def held(self) -> tuple[bool, bool]:
        """Whether front and back are plane faces, whose level nothing moves."""
        return self.body.front.array is None, self.body.back.array is None


def shortest(make: Maker) -> float:
    """Least distance of two points: 8 float32 spacings at the sheet's rim (length)."""
    x0, x1, y0, y1 = make.window.lattice.extent()
    reach = max(abs(x0), abs(x1), abs(y0), abs(y1)) + max(abs(s) for s in make.tiling.shift)
    return 8.0 * 2.0**-23 * reach
