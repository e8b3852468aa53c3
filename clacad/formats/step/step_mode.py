"""Whether a STEP file holds every lenslet (fused), or one and its placements; loads no writer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from clacad.sheet.window import Window

Mode = Literal["auto", "fused", "instanced"]

FUSED_CELLS = 2500
"""Cells up to which mode "auto" writes fused solids."""


def chosen_mode(window: Window, mode: Mode) -> Literal["fused", "instanced"]:
    """Resolve mode "auto"; a non-uniform sheet has no cell to repeat.

    Raises
    ------
    CellsDiffer
        An assembly is requested for such a sheet.
    """
    if mode not in ("auto", "fused", "instanced"):
        raise ValueError(f"STEP mode must be auto, fused or instanced, not {mode!r}")
    if not window.uniform:
        if mode == "instanced":
            from clacad.sheet.need_window import need_equal_cells

            need_equal_cells(
                window, "a STEP assembly of one cell and its places", "fused is one solid of all of them"
            )
        return "fused"
    if mode == "auto":
        return "fused" if window.lattice.cell_count <= FUSED_CELLS else "instanced"
    return mode
