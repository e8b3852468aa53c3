"""Record of rays on their way through the faces of a file, for any search of the faces. Lengths in mm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clacad.base.types import Bools, Floats, Ints

ENDS = ("through", "nothing met", "wall", "total reflection")
"""Endings of a ray."""


@dataclass(frozen=True, eq=False)
class RayPaths:
    """Positions of rays, and where they crossed faces; the arrays are filled in as the rays advance.

    position, direction : (n, 3)
        Of the last crossing; unit directions behind it.
    end : (n,) index into `ENDS`
    crossings : (n,)
        Faces crossed so far.
    hits : (n, steps, 3)
        Where each ray crossed, zero beyond its last crossing.
    """

    position: Floats
    direction: Floats
    end: Ints
    crossings: Ints
    hits: Floats

    @staticmethod
    def begun(position: Any, direction: Any, steps: int) -> RayPaths:
        """Rays (n, 3) before their first of `steps` crossings."""
        place, way = np.array(position, dtype=np.float64), np.array(direction, dtype=np.float64)
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        many = len(place)
        return RayPaths(
            place, way, np.zeros(many, dtype=int), np.zeros(many, dtype=int), np.zeros((many, steps, 3))
        )

    def to_lists(self, curved: Bools) -> dict[str, Any]:
        """As JSON lists, with whether each face crossed is curved both ways (n, steps)."""
        return {
            "position": self.position.tolist(), "direction": self.direction.tolist(), "end": self.end.tolist(),
            "crossings": self.crossings.tolist(), "hits": self.hits.tolist(), "curved": curved.tolist(),
        }  # fmt: skip


def media_of(indices: Sequence[float]) -> list[float]:
    """Refractive indices along the light, air first and last, from those of the bodies it meets."""
    return [1.0, *(one for index in indices for one in (index, 1.0))]
