"""Whether a STEP file holds every lenslet, fused, or one and where it stands: known before anything that writes is loaded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from clacad.sheet.window import Window

Mode = Literal["auto", "fused", "instanced"]

FUSED_CELLS = 2500
"""Cells up to which mode "auto" writes fused solids."""


def chosen_mode(window: Window, mode: Mode) -> Literal["fused", "instanced"]:
    """Resolve mode "auto"."""
    if mode not in ("auto", "fused", "instanced"):
        raise ValueError(f"STEP mode must be auto, fused or instanced, not {mode!r}")
    if mode == "auto":
        return "fused" if window.lattice.cell_count <= FUSED_CELLS else "instanced"
    return mode
