"""Optical surfaces: their shape, where a ray meets them, Snell's law. See `clacad.surface.shape` for notation."""

from __future__ import annotations

from clacad.surface.meeting import Meeting, fresnel, meet, meet_at, refract
from clacad.surface.quadric import upright_sag
from clacad.surface.shape import (
    ULP,
    Biconic,
    Quadric,
    Surface,
    as_quadric,
    conic_constants,
    gradient,
    normal,
    principal_radii,
    sag,
)

__all__ = [
    "ULP",
    "Biconic",
    "Meeting",
    "Quadric",
    "Surface",
    "as_quadric",
    "conic_constants",
    "fresnel",
    "gradient",
    "meet",
    "meet_at",
    "normal",
    "principal_radii",
    "refract",
    "sag",
    "upright_sag",
]
