"""Bodies of a window as build123d objects. Lengths in mm."""

from __future__ import annotations

from typing import Any

from clacad.sheet.window import Window
from clacad.solid.describe_body import describe_body
from clacad.solid.shells import MERGE

COLOURS = {"array1": (0.62, 0.78, 0.90), "array2": (0.90, 0.80, 0.62)}


def body_solids(window: Window, cells: tuple[int, int] | None = None, merge: float = MERGE) -> list[Any]:
    """Build the bodies of a window; see `clacad.solid.solids.solids`."""
    from build123d import Color, Compound, Solid
    from OCP.BRep import BRep_Builder
    from OCP.TopoDS import TopoDS_Compound

    from clacad.solid.occ_writer import KernelWriter, unhurried

    if cells is not None:
        window = window.with_cells(cells)
    made = []
    for body in window.bodies:
        with unhurried():
            writer = KernelWriter()
            shells = describe_body(window, body, writer, merge)
            pieces = [writer.solid(faces) for faces in shells.pieces()]
        if len(pieces) == 1:
            part: Any = Solid(pieces[0])
        else:
            builder, compound = BRep_Builder(), TopoDS_Compound()
            builder.MakeCompound(compound)
            for piece in pieces:
                builder.Add(compound, piece)
            part = Compound(compound)
        part.label = body.name
        part.color = Color(*COLOURS.get(body.name, COLOURS["array1"]))
        made.append(part)
    return made
