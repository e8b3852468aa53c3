"""Exact boundary representation of a window's bodies: rational lens faces, conic edges, no Booleans.

`describe_body` walks a body and tells a writer its vertices, edges and faces (`clacad.solid.occ_writer` makes
solids of the CAD kernel of them, `clacad.formats.step.shell_text` STEP text); `solids` gives build123d objects.
Importing this package loads no CAD kernel.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from clacad.solid.describe_body import describe_body
from clacad.solid.shells import MERGE

if TYPE_CHECKING:
    from clacad.sheet.window import Window

__all__ = ["MERGE", "describe_body", "solids"]


def solids(window: Window, cells: tuple[int, int] | None = None, merge: float = MERGE) -> list[Any]:
    """Give the bodies of a window as build123d objects, one per body.

    Parameters
    ----------
    window : Window
    cells : (n1, n2) or None
        The same design with another cell count, centred on the origin.
    merge : float, mm
        Heights closer than this at a node, or along a whole border, are one.

    Returns
    -------
    list of build123d.Solid
        In mm, in the sheet frame, labelled with the body's name; a body that is several pieces is a
        build123d.Compound of solids. They cut, fuse, fillet and export like any part.

    Raises
    ------
    ValueError
        A body cannot be built as a solid.
    """
    from clacad.solid.build123d_parts import body_solids

    return body_solids(window, cells, merge)
