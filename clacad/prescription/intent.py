"""Inputs of the recipes, read once from a design."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.optics.law import Law
from clacad.prescription.faces_and_bodies import Shaping
from clacad.prescription.radii import LensPair, NoSuchLens
from clacad.sheet.lattice import Lattice

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.optics.material.material import Material


@dataclass(frozen=True, eq=False)
class Intent:
    """Inputs of the recipes, read once from a design."""

    design: Design
    law: Law
    turn: Floats
    eta: Pair2
    delta: Pair2
    index: float
    material: Material | None
    lattice: Lattice
    shape: Shaping
    neck: float

    def offset(self, focal_length: Pair2) -> Floats:
        """(d_x, d_y) = (δ_x f1x, δ_y f1y), (2,) lengths, with f1 as built; 0 in a meridian without power."""
        return np.array([0.0 if d == 0.0 else d * f for d, f in zip(self.delta, focal_length, strict=True)])

    def built_offset(self, lenses: LensPair) -> Floats:
        """Offset (2,) of lens 2 as built, lengths: as given, else from δ."""
        given = self.design.pair.vertex
        focal = lenses.focal_length[0]
        if self.design.pair.focus is not None:  # δ is that of chief rays, independent of lens 1's focus
            from clacad.prescription.sharp_pairs import chief_focal_lengths

            focal = chief_focal_lengths(self.design, lenses.thickness, self.index, separation_of(self))
        offset = self.offset(focal) if given is None else np.array(given)
        if not np.isfinite(offset).all():
            raise NoSuchLens(
                "lens 1 has no power in a meridian with an offset delta",
                key="pair.face.0.radius",
                hint="a finite radius there, delta = 0, or pair.vertex = [d_x, d_y]",
            )
        return offset


def separation_of(intent: Intent) -> float:
    """Distance f1 + f2 (length) between the thin lenses equivalent to the pair."""
    pair = intent.design.pair
    if pair.separation is not None:
        return pair.separation
    thickness = pair.thicknesses
    assert thickness is not None  # the design holds exactly one of the two for a slab
    return thickness[0] / intent.index
