"""Slabs: one body with both arrays on its faces, or cut at the focus where it has a field lens."""

from __future__ import annotations

import numpy as np

from clacad.base.types import Pair2
from clacad.design.sections import PAIR
from clacad.prescription.assemble import assemble_window
from clacad.prescription.best_recipe import best_scale
from clacad.prescription.bodies import LensPose, displacement, slab_body
from clacad.prescription.field_lens import air_gap, two_plates
from clacad.prescription.intent import Intent, separation_of
from clacad.prescription.plano import one_faced, plano_with_field
from clacad.prescription.radii import NoSuchLens, thin_pair
from clacad.sheet.window import Body, Window


def slab(intent: Intent) -> Window:
    """Window of one body with both arrays on its faces."""
    return best_scale(intent, lambda scale: _slab_scaled(intent, scale))


def _slab_scaled(intent: Intent, scale: float) -> Window:
    """Slab with its radii times `scale`."""
    separation = separation_of(intent)
    if intent.design.pair.field_lens:
        return _slab_with_field(intent, separation, scale)
    thickness = intent.index * separation
    lenses = one_faced(intent, separation, (thickness, thickness)).scaled(scale)
    offset = intent.built_offset(lenses)
    lens_2 = intent.turn @ np.array([*offset, thickness])  # the common glass makes it exact for any tilt

    def body(moved: Pair2) -> Body:
        points = (np.zeros(3), lens_2 - np.array([*moved, 0.0]))
        first, second = (LensPose(point, intent.turn) for point in points)
        return slab_body(lenses, (first, second), intent.shape, intent.index)

    aperture = intent.design.lattice.aperture
    moved = displacement(aperture, lens_2[:2], float(lens_2[2]), (body((0.0, 0.0)),))
    return assemble_window(intent, (body(moved),), moved, lenses, offset)


def _slab_with_field(intent: Intent, separation: float, scale: float) -> Window:
    """Slab cut at the focus: two plates, or array 1, field plate and array 2 if foci differ."""
    n = intent.index
    if intent.eta[0] == intent.eta[1]:
        placed = two_plates(intent, separation, scale)
        lenses = one_faced(intent, separation, (n * separation, n * separation)).scaled(scale)
        return assemble_window(
            intent, placed.bodies, placed.moved, lenses, placed.offset, placed.field, placed.told
        )
    first, second = thin_pair(intent.eta, separation)
    gap = air_gap(intent)
    thickness = n * (min(first) - gap), n * (min(second) - gap)
    if min(thickness) <= 0.0:
        raise NoSuchLens(
            f"air gaps of {gap:.6g} leave a plate no thickness",
            key=PAIR.field,
            hint=f"gap < {min(*first, *second):.6g}",
            code="CL129",
        )
    lenses = one_faced(intent, separation, thickness).scaled(scale)
    return plano_with_field(intent, lenses)
