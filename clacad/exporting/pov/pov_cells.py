"""Cells in the language of POV-Ray: the prism of one, and loops that put a solid into every cell of an array.

On a uniform sheet a solid is declared once and copied. On a non-uniform sheet it is a macro, evaluated in
every cell. The lens moves by the affine part of its position, computed in the loop from the cell's centre,
and by a table of all cells where there is one. POV-Ray copies every object of a union either way, so its
memory and its time for a ray do not change; only the file grows, and only for tables.

Lenses of a uniform sheet keep a small gap to the borders of their cells (`hair`), so that no two share a
wall. Lenses of a non-uniform sheet overlap their borders slightly, each with an interior of its own. Steps
make their cells deep, and light that crosses a border in the glass would be reflected by the air of a gap.

Numbers, vectors and placements in the language of POV-Ray.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clacad.base.types import Floats
from clacad.sheet.cell_places import VertexChange
from clacad.sheet.lattice import Lattice, runs
from clacad.sheet.plate import Plate
from clacad.sheet.window import Face, Window
from clacad.storage.errors import ExportError

GAP = 2e-4
"""Gap between a lens and each border of its cell, as part of a pitch."""


class NotForPov(ExportError):
    """A sheet that a POV-Ray scene cannot represent; exit status 3."""

    exit_status = 3


def number(value: Any) -> str:
    """A number with all of its digits."""
    return repr(float(value) + 0.0)


def vector(values: Floats) -> str:
    """A vector."""
    return "<" + ", ".join(number(v) for v in values) + ">"


def colour(values: Sequence[float]) -> str:
    """A colour of linear light."""
    return f"rgb <{', '.join(number(v) for v in values)}>"


def matrix(rotation: Floats, origin: Floats) -> str:
    """Placement by its nine elements and a move; POV-Ray multiplies rows from the left."""
    return "matrix <" + ", ".join(number(v) for v in [*rotation.T.ravel(), *origin]) + ">"


@dataclass(frozen=True, slots=True)
class HeightRange:
    """Lower and upper height of an object, window units."""

    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Substance:
    """Material of a solid: its surface, and its interior ("" where no light enters)."""

    texture: str
    interior: str = ""

    def __str__(self) -> str:
        return f"{self.texture} {self.interior}".rstrip()


def hair(window: Window) -> float:
    """Gap between a solid and the border of its cell (length)."""
    return GAP * min(window.lattice.pitch)


def keeps_off(window: Window, array: int) -> float:
    """Gap between the lenses of an array and their cells' borders (length); negative where they overlap."""
    own = any(face.change is not None for face in window.faces if face.array == array)
    return -2.0 * hair(window) if own else hair(window)


# -- one cell ----------------------------------------------------------------------------------
def prism(
    window: Window,
    array: int,
    units: float,
    span: HeightRange,
    zone: bool = False,
    spare: float | None = None,
) -> str:
    """A cell of an array, or its optical zone, between two heights, less `spare` (a gap) at each border."""
    lattice = window.lattice_of(array)
    loss, spare = (
        0.5 * window.land.seam if zone else 0.0,
        keeps_off(window, array) if spare is None else spare,
    )
    halves = [units * (half - loss - spare) for half in lattice.half_widths[: len(lattice.steps) // 2]]
    low, high = number(units * span.low), number(units * span.high)
    if not lattice.hexagonal:
        x, y = (number(half) for half in halves)
        return f"box {{ <-{x}, -{y}, {low}>, <{x}, {y}, {high}> }}"
    sides = []
    for step, half in zip(lattice.steps[:3], halves, strict=True):
        ox, oy = lattice.offset(*step)
        length = float(np.hypot(ox, oy))
        for sign in (1.0, -1.0):
            sides.append(
                f"plane {{ <{number(sign * ox / length)}, {number(sign * oy / length)}, 0>, {number(half)} }}"
            )
    return (
        f"intersection {{ {' '.join(sides)} plane {{ z, {high} }} plane {{ -z, {number(-units * span.low)} }}"
        f" {_bounded(lattice, units, span)} }}"
    )


def _bounded(lattice: Lattice, units: float, span: HeightRange, room: float = 0.0) -> str:
    reach = number(units * (lattice.circumradius + room))
    low, high = number(units * span.low), number(units * span.high)
    return f"bounded_by {{ box {{ <-{reach}, -{reach}, {low}>, <{reach}, {reach}, {high}> }} }}"


# -- how lenses move from cell to cell ---------------------------------------------------------
MOVE = "translate Move"
"""Placeholder of a part for the position of its cell's lens; the number of its kind of move follows."""


def changes(window: Window) -> list[VertexChange]:
    """The ways in which lenses vary from cell to cell, each once, in the order of the faces."""
    found: list[VertexChange] = []
    for face in window.faces:
        if face.change is not None and _number_of(face.change, found) is None:
            found.append(face.change)
    return found


def _number_of(change: VertexChange, known: Sequence[VertexChange]) -> int | None:
    """Index of a change among the known ones."""

    def same(other: VertexChange) -> bool:
        if change.table is None or other.table is None:
            return other.gradient == change.gradient and change.table is other.table
        return other.gradient == change.gradient and np.array_equal(change.table, other.table)

    return next((k for k, other in enumerate(known) if same(other)), None)


def moved(window: Window, face: Face) -> str:
    """Translation of the lens of a face to its position in the loop's present cell; "" on a uniform sheet."""
    if face.change is None:
        return ""
    return f" {MOVE}{_number_of(face.change, changes(window))}"


def tables(window: Window) -> Iterator[str]:
    """Moves of the lenses of kept cells, row by row, in the sheet's unit, where they follow no formula."""
    for k, change in enumerate(changes(window)):
        if change.table is None:
            continue
        yield f"#declare MOVED{k} = array[{window.lattice.cell_count}] {{"
        added = VertexChange(table=change.table)
        stretches = _stretches(window.lattice)
        for n, (j, first, end) in enumerate(stretches):
            i = np.arange(first, end)
            places = added.at(window.lattice, np.stack([i, np.full_like(i, j)], axis=-1)).tolist()
            words = ", ".join(f"<{number(x)}, {number(y)}, 0>" for x, y in places)
            yield f"  {words}{',' if n + 1 < len(stretches) else ''}"
        yield "}"


def _moves(window: Window, units: float) -> Iterator[str]:
    """Lines within a loop that compute the moves of the lenses of its cell from its lattice position."""
    for k, change in enumerate(changes(window)):
        (xx, xy), (yx, yy) = change.gradient
        yield f"      #declare C = <{_place(window.lattice, (0.0, 0.0), units)}>;"
        affine = f"<{number(xx)}*C.x + {number(xy)}*C.y, {number(yx)}*C.x + {number(yy)}*C.y, 0>"
        table = "" if change.table is None else f" + {number(units)}*MOVED{k}[N]"
        yield f"      #declare Move{k} = {affine}{table};"


# -- all cells ---------------------------------------------------------------------------------
def rows_of_cells(window: Window) -> Iterator[str]:
    """First kept cell of each row and one past its last; plain lattices need no table."""
    lattice = window.lattice
    if lattice.outline is None:
        return
    found = _stretches(lattice)
    if isinstance(lattice.outline, Plate):
        for name, column in zip(("ROW", "FIRST", "END"), zip(*found, strict=True), strict=True):
            yield f"#declare {name} = array[{len(column)}] {{ {', '.join(map(str, column))} }}"
        return
    of_row = {j: (first, end) for j, first, end in found}
    ends = [of_row.get(j, (0, 0)) for j in range(lattice.count[1])]
    for name, column in zip(("FIRST", "END"), zip(*ends, strict=True), strict=True):
        yield f"#declare {name} = array[{len(column)}] {{ {', '.join(map(str, column))} }}"


def _stretches(lattice: Lattice) -> list[tuple[int, int, int]]:
    """Row, first kept cell and one past the last of each stretch of cells, in the order of the loops."""
    rows = [(j, row[:, 0]) for j in range(lattice.count[1]) if len(row := lattice.row(j))]
    return [(j, int(first), int(end)) for j, row in rows for first, end in runs(row)]


def _place(lattice: Lattice, shift: tuple[float, float], units: float) -> str:
    """The middle of the cell in row J and column I of a lattice, as x, y, z."""
    (x0, y0), (px, py) = (
        (np.add(lattice.first_centre, shift) * units).tolist(),
        (lattice.pitch[0], lattice.a2[1]),
    )
    slant = " + 0.5*J" if lattice.hexagonal else ""
    return f"{number(x0)} + (I{slant})*{number(px * units)}, {number(y0)} + J*{number(py * units)}, 0"


CALLED = "()"
"""Suffix of the name of a macro where it is called."""


def in_every_cell(
    window: Window,
    array: int,
    name: str,
    parts: Sequence[str],
    units: float,
    span: HeightRange,
    look: Substance,
) -> Iterator[str]:
    """Declare a solid and put it into every cell; a macro where a part needs its cell (`moved`)."""
    kind = "merge" if len(parts) > 1 else "intersection"
    inside = "\n  ".join(parts)
    moving = any(MOVE in part for part in parts)
    room = 2.0 * hair(window) if moving else 0.0
    solid = f"{kind} {{\n  {inside}\n  {_bounded(window.lattice_of(array), units, span, room)}\n"
    if moving:
        yield f"#macro {name}{CALLED} {solid}  {look.interior}\n}} #end"
        yield from all_cells(window, name + CALLED, array, units, look.texture)
    else:
        yield f"#declare {name} = {solid}}}"
        yield from all_cells(window, name, array, units, str(look))


def all_rows(window: Window, array: int, units: float, span: HeightRange) -> Iterator[str]:
    """Footprint of the cells of rectangles that an outline keeps between two heights: a box for each stretch
    of a row.

    POV-Ray tests every piece of a subtracted solid for every ray, so boxes of single cells would be too slow.
    """
    lattice, shift = window.lattice_of(array), window.shifts[array]
    (x0, y0), (px, py) = (np.add(lattice.first_centre, shift) * units).tolist(), lattice.pitch
    low, high = number(units * span.low), number(units * span.high)
    left, below, wide, tall = (
        number(v) for v in (x0 - 0.5 * units * px, y0 - 0.5 * units * py, units * px, units * py)
    )
    outline = window.lattice.outline
    k, j, rows = (
        ("R", "ROW[R]", "dimension_size(ROW, 1)")
        if isinstance(outline, Plate)
        else ("J", "J", f"{lattice.count[1]}")
    )
    first, end = f"FIRST[{k}]", f"END[{k}]"
    yield "union {"
    yield f"  #declare {k} = 0; #while ({k} < {rows})"
    yield f"    #if ({first} < {end})"
    yield f"      box {{ <{left} + {first}*{wide}, {below} + {j}*{tall}, {low}>,"
    yield f"        <{left} + {end}*{wide}, {below} + ({j} + 1)*{tall}, {high}> }}"
    yield "    #end"
    yield f"  #declare {k} = {k} + 1; #end"
    yield "}"


def all_cells(
    window: Window, name: str, array: int, units: float, look: str, beyond: int = 0
) -> Iterator[str]:
    """One flat union of a declared solid in every cell of an array (nested unions trace far slower).

    name : of the solid; called as a macro, it is evaluated in every cell
    beyond : rows and columns of cells around the kept ones
    """
    lattice = window.lattice
    if beyond and not lattice.hexagonal:
        first, end = f"{-beyond}", f"{lattice.count[0] + beyond}"
    elif lattice.outline is not None:
        first, end = "FIRST[J]", "END[J]"
    elif lattice.hexagonal:
        first, end = "-int(J/2)", f"{lattice.count[0]} - int(J/2)"
    else:
        first, end = "0", f"{lattice.count[0]}"
    yield "union {"
    rows = beyond if not lattice.hexagonal else 0
    of_runs = isinstance(lattice.outline, Plate) and first == "FIRST[J]"
    counter, start, end_of_rows = "J", -rows, f"{lattice.count[1] + rows}"
    if of_runs:  # a row of a plate may consist of several runs of cells
        counter, start, end_of_rows, first, end = "R", 0, "dimension_size(ROW, 1)", "FIRST[R]", "END[R]"
    moving = name.endswith(CALLED)
    if moving:
        yield "  #declare N = 0;"
    yield f"  #declare {counter} = {start}; #while ({counter} < {end_of_rows})"
    if of_runs:
        yield "    #declare J = ROW[R];"
    yield f"    #declare I = {first}; #while (I < {end})"
    if moving:
        yield from _moves(window, units)
    yield (
        f"      object {{ {name} translate"
        f" <{_place(window.lattice_of(array), window.shifts[array], units)}> }}"
    )
    if moving:
        yield "    #declare N = N + 1;"
    yield "    #declare I = I + 1; #end"
    yield f"  #declare {counter} = {counter} + 1; #end"
    yield f"  {look}"
    yield "}"
