"""Notes of a drawing on a non-uniform sheet: the key that makes it non-uniform, and three of its cells, the
worst included.

The views show the cell in the middle; the STEP file and the table of faces contain every cell.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from clacad.base.units import millimetres
from clacad.design.sections import AimedAt
from clacad.formats.drawing.canvas import Canvas
from clacad.formats.drawing.drawing_tables import table
from clacad.formats.drawing.views import mm_text
from clacad.optics.surface import principal_radii
from clacad.sheet.own_steps import greatest_steps
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.window import Face, Window

if TYPE_CHECKING:
    from clacad.design import Design


def differing_key(design: Design) -> str:
    """The key of a design that makes its sheet non-uniform; "" for a uniform sheet."""
    asked = {
        "lattice.aperture.point": isinstance(design.lattice.aperture, AimedAt),
        "law.varying": design.law_spec.varying is not None,
        "lattice.pitch_2": design.lattice.pitch_2 is not None,
        "pair.focus": design.pair.focus is not None,
    }
    return next((key for key, present in asked.items() if present), "")


def differing_notes(design: Design, window: Window) -> tuple[str, ...]:
    """Notes that the sheet is non-uniform, by which key, and where all cells are listed; empty for a uniform
    sheet.
    """
    if window.uniform:
        return ()
    return (
        f"The cells differ ({differing_key(design)}): the views show the one nearest the middle, the table the first, that "
        f"one and the worst of {window.lattice.cell_count:,}. None can stand for another: cut by the STEP file, or by the table "
        "of faces (--format table), which hold every cell.",
    )


def cells_table(window: Window) -> Canvas:
    """The first, the middle and the worst cell: positions of cells and lenses, heights of steps; mm."""
    mm = millimetres(window.unit)
    faces = _one_face_an_array(window)
    head = ["cell", "i, j"]
    for face in faces:
        head += [f"centre {_lens(face)} x, y", f"apex {_lens(face)} from it x, y", f"step {_lens(face)}"]
        head += [f"radius {_lens(face)}"] if window.many_sizes else []
    rows = []
    for name, index in zip(
        ("first", "middle", "worst"), representative_cells(window, "drawing"), strict=True
    ):
        row = [name, f"{index[0]}, {index[1]}"]
        for face in faces:
            assert face.array is not None
            step = float(greatest_steps(window, face, index[None])[0])
            apex = window.vertices(face, index)[:2]
            row += [
                ", ".join(mm_text(v * mm + 0.0) for v in at)
                for at in (window.centres(face.array, index), apex)
            ]
            row.append(mm_text(step * mm))
            if window.many_sizes:
                own = window.in_cell(face, index)
                row.append(mm_text(own.side * principal_radii(own.surface)[0] * mm))
        rows.append(row)
    title = "cells that differ (mm; step: the highest to a neighbour; worst: the lens farthest from the middle of its cell)"
    return table(title, head, rows)


def _one_face_an_array(window: Window) -> list[Face]:
    """A face of each array, one whose lenses move where any does."""
    found: dict[int, Face] = {}
    for face in window.faces:
        if face.array is not None and (face.array not in found or found[face.array].change is None):
            found[face.array] = face
    return [found[array] for array in sorted(found)]


def _lens(face: Face) -> str:
    return f"lens {(face.array or 0) + 1}"
