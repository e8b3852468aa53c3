"""The bodies of a window as build123d objects with exact OCCT solids. Lengths in mm."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from clacad.sheet.need_window import need_window
from clacad.solid.describe_body import describe_body
from clacad.solid.shells import MERGE

if TYPE_CHECKING:
    from clacad.sheet.window import Window

COLOURS = {"array1": (0.62, 0.78, 0.90), "array2": (0.90, 0.80, 0.62)}


def solids(window: Window, cells: tuple[int, int] | None = None, merge: float = MERGE) -> list[Any]:
    """Return the bodies of a window as build123d objects, one per body.

    Parameters
    ----------
    window : Window
    cells : (n1, n2) or None
        Use another cell count, centred on the origin, with the same design.
    merge : float, mm
        Heights that differ by less at a node, or along a whole border, are merged.

    Returns
    -------
    list of build123d.Solid
        In mm, in the sheet frame, labelled with the body's name; a body of several pieces is a
        build123d.Compound of solids. They cut, fuse, fillet and export like any part.

    Raises
    ------
    TypeError
        A design in place of the window.
    ValueError
        A body cannot be built as a solid.
    """
    from clacad.solid.occ_writer import OccWriter, without_garbage_collection

    need_window(window, "solids")
    if cells is not None:
        window = window.with_cells(cells)
    made = []
    for body in window.bodies:
        with without_garbage_collection():
            writer = OccWriter()
            shells = describe_body(window, body, writer, merge)
            pieces = [writer.solid(faces) for faces in shells.pieces()]
        made.append(_part(pieces, body.name))
    return made


def _part(pieces: list[Any], name: str) -> Any:
    """One build123d object of the solids of a body, labelled and coloured."""
    from build123d import Color, Compound, Solid
    from OCP.BRep import BRep_Builder
    from OCP.TopoDS import TopoDS_Compound

    if len(pieces) == 1:
        part: Any = Solid(pieces[0])
    else:
        builder, compound = BRep_Builder(), TopoDS_Compound()
        builder.MakeCompound(compound)
        for piece in pieces:
            builder.Add(compound, piece)
        part = Compound(compound)
    part.label = name
    part.color = Color(*COLOURS.get(name, COLOURS["array1"]))
    return part
