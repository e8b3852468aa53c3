"""Imaging and beam shaping by a sheet: image points, and tables of cells that send light into a pattern.

Contents: image points predicted and by rays, targets, the assignment of cells to them. The closed forms are
in `clacad.optics.law.focusing`, pictures of scenes in `clacad.rendering`.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOME = {"image": "clacad.imaging.image_by_rays", "Image": "clacad.imaging.image_by_rays"}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Import a name from its module when it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
