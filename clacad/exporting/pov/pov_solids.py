"""The sheet as solids of POV-Ray: cells in flat unions, the glass between two arrays as one block.

A biconvex array is a union of its lenslets, each cut to its cell less a small gap, with its share of the web.
A slab or a plano sheet is cut in layers along z with small gaps: the cells of each structured face down to
below their deepest point, and a plain block between. Land around the cells is the outline less the cells.
Of two bodies with a joint the first reaches slightly into the second: POV-Ray bends light where it enters
the second, between their indices, and not where it leaves the first. Walls of a baffle are black.

Cells in the language of POV-Ray: the prism of one, and loops that put a solid into every cell of an array.

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
from dataclasses import dataclass, replace
from itertools import pairwise
from math import isnan
from typing import Any

import numpy as np

from clacad.base.types import Floats
from clacad.optics.surface import Quadric, simplest
from clacad.prescription.cell_heights import faces_that_differ
from clacad.sheet.cell_places import VertexChange
from clacad.sheet.face_order import outline_centre
from clacad.sheet.lattice import Circle, Lattice, runs
from clacad.sheet.plate import Plate
from clacad.sheet.window import Body, Face, Window, lens_height_and_normal
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


SAMPLES = 33
"""Points along a side of a cell, and from its middle to its border, on which heights are sampled."""

GLASS = (
    "texture { pigment { rgbt <1, 1, 1, 1> } finish { ambient 0 diffuse 0 emission 0 specular 0 reflection"
    " 0 } }"
)
BLACK = Substance("texture { pigment { rgb 0 } finish { ambient 0 diffuse 0 emission 0 } }")


def quadric_of(face: Face) -> Quadric | None:
    """Quadric that contains a face's points, None where there is none."""
    surface = simplest(face.surface)
    return surface if isinstance(surface, Quadric) else None


def refuse(window: Window) -> None:
    """Reject what exact solids cannot represent.

    Raises NotForPov: A face that is no quadric, as most biconic ones; opaque land of a web, which lies inside
        the glass; an array that is rotated, or lenses at individual heights or of many sizes.
    """
    why = ""
    if any(quadric_of(face) is None for face in window.faces):
        why = "biconic or polynomial faces, which are no quadrics"
    elif window.land.opaque and any(body.columnar for body in window.bodies):
        why = "opaque land on a web"
    elif not window.level_and_straight:
        why = "arrays that are turned, or lenses at individual heights or are of many sizes"
    if why:
        raise NotForPov(f"{window.name}: the POV-Ray scene cannot hold {why}; export its mesh instead")


def sheet_lines(window: Window, units: float) -> Iterator[str]:
    """Lines of all bodies and of the baffle; `units` of POV-Ray in a window length."""
    refuse(window)
    yield from rows_of_cells(window)
    yield from tables(window)
    for k, body in enumerate(_past_joints(window)):
        yield from _columns(window, body, k, units) if body.columnar else _layers(window, body, k, units)
    if window.baffle is not None:
        gaps = [(first, second) for first, second in pairwise(window.bodies) if not second.joined]
        for number, (first, second) in enumerate(gaps):
            if window.lattice_of(first.arrays[-1]) == window.lattice_of(second.arrays[0]):
                yield from _honeycomb(window, units, first, second)
            else:
                yield from _frusta(window, units, number)


# -- bodies ------------------------------------------------------------------------------------


def _past_joints(window: Window) -> Iterator[Body]:
    """Bodies in the order of the light; each that ends at a joint goes a little beyond it."""
    for body, behind in zip(window.bodies, [*window.bodies[1:], None], strict=True):
        if behind is None or not behind.joined:
            yield body
            continue
        back, room = body.back, hair(window)
        x, y, z = back.vertex
        land = None if back.land is None else back.land + room
        yield replace(body, back=replace(back, vertex=(x, y, z + room), land=land))


def _land_of_cell(
    window: Window, array: int, units: float, span: HeightRange, spare: float, faces: Sequence[Face]
) -> list[str]:
    """Land of a cell between two heights: under the lens too, but not where it protrudes from the lens."""
    plain = prism(window, array, units, span, spare=spare)
    if not any(face.sunk for face in faces):
        return [plain]
    if window.land.seam == 0.0:
        return []
    room = 0.5 * (span.high - span.low)
    wider = HeightRange(span.low - room, span.high + room)
    zone = prism(window, array, units, wider, zone=True, spare=keeps_off(window, array) + hair(window))
    return [f"difference {{ {plain} {zone} }}"]


def _columns(window: Window, body: Body, k: int, units: float) -> Iterator[str]:
    """A bundle of lenslets: lens, and its share of the web, cell by cell."""
    array = body.arrays[0]
    depth = _depth(window, body)
    lens = [_half_space(window, face, units, depth) for face in (body.front, body.back)]
    parts = [_meeting([*lens, prism(window, array, units, depth, zone=True)])]
    web = _web(body)
    if web is not None:
        spare = keeps_off(window, array) + hair(window)
        parts += _land_of_cell(window, array, units, web, spare, (body.front, body.back))
    yield from in_every_cell(window, array, f"Lens{k}", parts, units, depth, _glass(body))
    if web is not None:
        yield from _beside(window, array, units, web, _glass(body))


def _web(body: Body) -> HeightRange | None:
    low, high = body.front.land, body.back.land
    return None if low is None or high is None else HeightRange(low, high)


def _layers(window: Window, body: Body, k: int, units: float) -> Iterator[str]:
    """A slab or a plano sheet: its structured faces and the block between them."""
    gap = hair(window)
    ends = []
    for face, side in ((body.front, 1.0), (body.back, -1.0)):
        if face.array is None:
            ends.append(face.vertex[2])
            continue
        heights = _heights(window, face)
        inner, outer = (heights.high, heights.low) if side > 0.0 else (heights.low, heights.high)
        inner, outer = inner + side * 50.0 * gap, outer - side * 50.0 * gap
        ends.append(inner + side * gap)
        yield from _layer(window, body, face, f"Layer{k}{'a' if side > 0.0 else 'b'}", (outer, inner), units)
    if not ends[0] < ends[1]:
        raise NotForPov(
            f"{window.name}: the arrays of a sheet this thin reach into one another; export its mesh instead"
        )
    yield f"object {{ {_outline(window, body, units, HeightRange(ends[0], ends[1]))} {_glass(body)} }}"


def _layer(
    window: Window, body: Body, face: Face, name: str, ends: tuple[float, float], units: float
) -> Iterator[str]:
    """The cells of one structured face, from outside its highest point to below its deepest."""
    assert face.array is not None
    outer, inner = ends
    gap, side = hair(window), 1.0 if outer < inner else -1.0
    depth = HeightRange(min(outer, inner), max(outer, inner))
    parts = [
        _meeting(
            [_half_space(window, face, units, depth), prism(window, face.array, units, depth, zone=True)]
        )
    ]
    land = None if face.land is None or isnan(face.land) else HeightRange(*sorted((face.land, inner)))
    if land is not None:
        # slightly inside the lens's own prism: where two solids share a face a merge may lose both
        under = HeightRange(
            *sorted((land.low if face.land == land.low else land.high, inner - side * 25.0 * gap))
        )
        spare = keeps_off(window, face.array) + gap
        parts += _land_of_cell(window, face.array, units, under, spare, (face,))
    yield from in_every_cell(window, face.array, name, parts, units, depth, _glass(body))
    if land is None:
        return
    yield from _beside(window, face.array, units, land, _glass(body))
    if window.land.opaque:
        level = land.low if side > 0.0 else land.high
        paint = HeightRange(*sorted((level, level - side * gap)))
        wider = HeightRange(paint.low - gap, paint.high + gap)
        rim = (
            f"difference {{ {prism(window, face.array, units, paint, spare=0.0)}"
            f" {prism(window, face.array, units, wider, zone=True)} }}"
        )
        yield from in_every_cell(window, face.array, f"{name}Land", [rim], units, depth, BLACK)
        yield from _beside(window, face.array, units, paint, BLACK)


def _heights(window: Window, face: Face) -> HeightRange:
    """Lower and upper height of a face, lens and land, with room.

    Sampled over cells and their borders where lens offsets are largest and smallest.
    """
    if face.array is None:
        return HeightRange(face.vertex[2], face.vertex[2])
    tile = window.lattice_of(face.array).tile()
    along = np.linspace(0.0, 1.0, SAMPLES)[:, None, None]
    rim = (tile * (1.0 - along) + np.roll(tile, -1, axis=0) * along).reshape(-1, 2)
    points = (rim[None] * np.linspace(0.0, 1.0, SAMPLES)[:, None, None]).reshape(-1, 2)
    z = np.concatenate(
        [
            lens_height_and_normal(one, points[:, 0], points[:, 1])[0]
            for one in [*faces_that_differ(window, face), _nearest(window, face)]
        ]
    )
    z = np.append(z[np.isfinite(z)], [] if face.land is None or isnan(face.land) else [face.land])
    room = 0.01 * float(np.ptp(z))
    return HeightRange(float(z.min()) - room, float(z.max()) + room)


def _nearest(window: Window, face: Face) -> Face:
    """The face in the cell where its lens is nearest to the middle, where it rises highest."""
    cells = window.lattice.cells()
    apart = np.hypot(*window.vertices(face, cells)[:, :2].T)
    return window.in_cell(face, cells[int(np.argmin(apart))])


def _glass(body: Body) -> Substance:
    return Substance(GLASS, f"interior {{ ior {number(body.index)} }}")


def _depth(window: Window, body: Body) -> HeightRange:
    """Lower and upper height of a bundle, with room to spare, limited by the mid plane between the arrays."""
    z0, z1 = window.z_range
    room = 0.05 * (z1 - z0)
    faces = (body.front, body.back)
    vertices = [face.vertex[2] for face in faces]
    own = [_heights(window, face) for face in faces if face.change is not None]
    reach = max(2.0 * max(window.lattice.pitch), *(heights.high - heights.low for heights in own), 0.0)
    return HeightRange(max(z0 - room, min(vertices) - reach), min(z1 + room, max(vertices) + reach))


def _half_space(window: Window, face: Face, units: float, span: HeightRange) -> str:
    """The side of a lens on which its glass is, as a quadric rotated and moved into its cell.

    A quadric meets its axis again at 2/κ. Where that lies within `span`, the plane through its centre
    separates the lens from the other sheet, or from the far end.
    """
    s = quadric_of(face)
    assert s is not None  # `refuse` has checked this
    a, b, c = (number(v / units) for v in (s.curvature_x, s.curvature_y, s.kappa))
    quadric = f"quadric {{ <{a}, {b}, {c}>, <0, 0, 0>, <0, 0, {number(-2.0 * s.side)}>, 0"
    place = f"{matrix(face.rotation, np.array(face.vertex) * units)}{moved(window, face)}"
    other = 2.0 / abs(s.kappa) < span.high - span.low if s.kappa else False
    concave = min(s.curvature_x, s.curvature_y) < 0.0
    if not other or (s.kappa > 0.0 and not concave):
        return f"{quadric} {place} }}"
    kind = "intersection" if s.kappa < 0.0 else "merge"
    centre = f"plane {{ <0, 0, {number(-s.side)}>, {number(-units / s.kappa)} }}"
    return f"{kind} {{ {quadric} }} {centre} {place} }}"


def _meeting(parts: list[str]) -> str:
    return "intersection { " + "\n    ".join(parts) + " }"


# -- the rim -----------------------------------------------------------------------------------


def _outline(window: Window, body: Body, units: float, span: HeightRange) -> str:
    """The whole footprint of a body between two heights."""
    low, high = number(units * span.low), number(units * span.high)
    x, y = outline_centre(window, body)
    if isinstance(window.outline, Plate):
        return _plate(window.outline, units, low, high)
    if isinstance(window.outline, Circle):
        radius = number(0.5 * units * window.outline.diameter)
        ends = ", ".join(f"<{number(units * x)}, {number(units * y)}, {z}>" for z in (low, high))
        return f"cylinder {{ {ends}, {radius} }}"
    if window.outline is not None:
        hx, hy = 0.5 * window.outline.width, 0.5 * window.outline.height
        x0, x1, y0, y1 = x - hx, x + hx, y - hy, y + hy
    else:
        x0, x1, y0, y1 = window.placements[body.arrays[0]].extent(window.lattice)
    corners = [
        f"<{number(units * u)}, {number(units * v)}, {z}>" for u, v, z in ((x0, y0, low), (x1, y1, high))
    ]
    return f"box {{ {', '.join(corners)} }}"


ROUND = 720
"""Sides that approximate a full turn of a plate's round edges."""


def _plate(plate: Plate, units: float, low: str, high: str) -> str:
    """A plate between two heights: the prism of its boundary less a cylinder for each hole."""
    corners = plate.polygons(ROUND)[0]
    points = ", ".join(
        f"<{number(units * x)}, {number(units * y)}>" for x, y in [*corners.tolist(), corners[0].tolist()]
    )
    # a prism is swept along y over points of the plane x, z: y and z are exchanged
    body = (
        f"prism {{ linear_sweep linear_spline {low}, {high}, {len(corners) + 1}, {points} "
        "matrix <1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0> }"
    )
    room = f"({high} - {low})"
    holes = "".join(
        f" cylinder {{ <{number(units * hole.x)}, {number(units * hole.y)}, {low} - {room}>,"
        f" <{number(units * hole.x)}, {number(units * hole.y)}, {high} + {room}>,"
        f" {number(0.5 * units * hole.diameter)} }}"
        for hole in plate.holes
    )
    return f"difference {{ {body}{holes} }}" if holes else body


def _beside(window: Window, array: int, units: float, span: HeightRange, look: Substance) -> Iterator[str]:
    """Land between the cells and the outline: the outline less every cell."""
    if window.outline is None:
        return
    room = 0.5 * (span.high - span.low)
    wider = HeightRange(span.low - room, span.high + room)
    body = next(b for b in window.bodies if array in (b.front.array, b.back.array))
    yield "difference {"
    yield f"  {_outline(window, body, units, span)}"
    if window.lattice.hexagonal:
        yield f"  #declare Gone = {prism(window, array, units, wider, spare=0.0)}"
        yield from (f"  {line}" for line in all_cells(window, "Gone", array, units, ""))
    elif window.lattice.outline is not None:
        yield from (f"  {line}" for line in all_rows(window, array, units, wider))
    else:
        x0, x1, y0, y1 = window.placements[array].extent(window.lattice)
        low, high = (number(units * z) for z in (wider.low, wider.high))
        yield f"  box {{ <{number(units * x0)}, {number(units * y0)}, {low}>,"
        yield f"    <{number(units * x1)}, {number(units * y1)}, {high}> }}"
    yield f"  {look}"
    yield "}"


def _frusta(window: Window, units: float, gap: int) -> Iterator[str]:
    """Black walls in a gap between arrays of different pitch, as triangles."""
    from clacad.exporting.fixtures.baffle import baffle_meshes

    yield "mesh {"
    for corners in baffle_meshes(window)[gap].rows():
        for triangle in units * corners:
            yield f"  triangle {{ {', '.join(vector(point) for point in triangle)} }}"
    yield f"  {BLACK}"
    yield "}"


def _honeycomb(window: Window, units: float, first: Body, second: Body) -> Iterator[str]:
    """Black walls between two bodies: each cell's border, sheared to its partner's, less the channel."""
    assert window.baffle is not None
    span = HeightRange(_heights(window, first.back).high, _heights(window, second.front).low)
    rise = span.high - span.low
    run = np.subtract(window.shifts[second.arrays[0]], window.shifts[first.arrays[-1]]) / rise
    room = 0.01 * rise
    channel = HeightRange(-room, rise + room)
    array = first.arrays[-1]
    wall = prism(window, array, units, HeightRange(0.0, rise), spare=0.0)
    free = prism(window, array, units, channel, spare=0.5 * window.baffle.wall)
    shear = (
        f"matrix <1, 0, 0, 0, 1, 0, {number(run[0])}, {number(run[1])}, 1, 0, 0, {number(units * span.low)}>"
    )
    yield f"#declare Wall = difference {{ {wall} {free} {shear} }}"
    # walls between the cells of an outline end with its cells
    border = window.land.border if window.lattice.outline is None else 0.0
    beyond = int(np.ceil(border / min(window.lattice.pitch)))
    yield from all_cells(window, "Wall", array, units, str(BLACK), beyond)
