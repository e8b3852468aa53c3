"""Closed forms of a thin pair: δ that sends a cell's light to a given point, and the spot's width."""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.optics.law.law import Law


def deltas_to(law: Law, ways: Floats, distance: float) -> Floats:
    """δ (n, 2) that sends light along the normal to points `ways` (n, 2) of a screen at `distance`, lengths.

    t' = −δ/η, so δ = −η way/Z, along the lens axes of an upright sheet.
    """
    scale = np.array([law.eta_x, law.eta_y])
    return np.asarray(-(ways @ law.rotation[:2, :2]) * scale / distance)


def spot_widths(
    law: Law, pitch: Pair2, distance: float, source: float, wavelength: float
) -> tuple[Pair2, Pair2, Pair2]:
    """Full widths (lengths) of a cell's spot on a screen along the lens axes, by cell, source, diffraction.

    |η| p; 2 Z α/|η| for a source of half angle α (radians); λ Z/(|η| p).

    Parameters
    ----------
    law : Law
    pitch : (2,) lengths
    distance, wavelength : float, lengths
    source : float, radians
    """
    scale = np.abs([law.eta_x, law.eta_y])
    beam = scale * np.array(pitch)
    x, y, z = (
        tuple(v.tolist()) for v in (beam, 2.0 * distance * source / scale, wavelength * distance / beam)
    )
    return x, y, z
