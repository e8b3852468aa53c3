"""Optical surfaces: shape, intersection with rays, Snell's law.

Notation: `clacad.optics.surface.sag_and_normal`.
"""

from __future__ import annotations

from clacad.optics.surface.intersection import Meeting, meet, meet_at, refract
from clacad.optics.surface.roots import upright_sag
from clacad.optics.surface.sag_and_normal import (
    ULP,
    Biconic,
    EvenPolynomial,
    Quadric,
    Surface,
    as_quadric,
    conic_constants,
    gradient,
    normal,
    principal_radii,
    resized,
    sag,
    sharpest_bend,
    simplest,
)

__all__ = [
    "ULP",
    "Biconic",
    "EvenPolynomial",
    "Meeting",
    "Quadric",
    "Surface",
    "as_quadric",
    "conic_constants",
    "gradient",
    "meet",
    "meet_at",
    "normal",
    "principal_radii",
    "refract",
    "resized",
    "sag",
    "sharpest_bend",
    "simplest",
    "upright_sag",
]
