"""The sheet as solids of POV-Ray: cells in flat unions, the glass between two arrays as one block.

A biconvex array is a union of its lenslets, each cut to its cell less a hair, with its share of the web. A
slab or a plano sheet is cut in layers along z, a hair apart: the cells of each structured face down to below
their deepest point, and a plain block between. Land beside the cells is the outline less the cells. Walls of
a baffle are black.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import isnan

import numpy as np

from clacad.formats.pov.pov_text import GAP, NotForPov, matrix, number
from clacad.optics.surface import Quadric
from clacad.sheet.gap import array_of
from clacad.sheet.lattice import Circle, runs
from clacad.sheet.plate import Plate
from clacad.sheet.window import Body, Face, Window, lens_height_and_normal

SAMPLES = 33
"""Points along a side of a cell, and from its middle to its border, on which heights are sampled."""

GLASS = "texture { pigment { rgbt <1, 1, 1, 1> } finish { ambient 0 diffuse 0 emission 0 specular 0 reflection 0 } }"
BLACK = "texture { pigment { rgb 0 } finish { ambient 0 diffuse 0 emission 0 } }"


@dataclass(frozen=True, slots=True)
class HeightRange:
    """Heights between which something stands, window units."""

    low: float
    high: float


def refuse(window: Window) -> None:
    """Refuse what exact solids cannot hold.

    Raises
    ------
    NotForPov
        A biconic face (it is no quadric); opaque land of a web, which lies inside the glass.
    """
    why = ""
    if not all(isinstance(face.surface, Quadric) for face in window.faces):
        why = "biconic or polynomial faces, which are no quadrics"
    elif window.land.opaque and any(body.columnar for body in window.bodies):
        why = "opaque land on a web"
    if why:
        raise NotForPov(f"{window.name}: the POV-Ray scene cannot hold {why}; export its mesh instead")


def sheet_lines(window: Window, units: float) -> Iterator[str]:
    """Lines of all bodies and of the baffle; `units` of POV-Ray in a window length."""
    refuse(window)
    yield from _rows(window)
    for k, body in enumerate(window.bodies):
        yield from _columns(window, body, k, units) if body.columnar else _layers(window, body, k, units)
    if window.baffle is not None:
        for first, second in pairwise(window.bodies):
            yield from _honeycomb(window, units, first, second)


# -- bodies ------------------------------------------------------------------------------------


def _columns(window: Window, body: Body, k: int, units: float) -> Iterator[str]:
    """A bundle of lenslets: lens, and its share of the web, cell by cell."""
    array = next(face.array for face in (body.front, body.back) if face.array is not None)
    depth = _depth(window, body)
    lens = [_half_space(face, units) for face in (body.front, body.back)]
    parts = [_meeting([*lens, _prism(window, units, depth, zone=True)])]
    web = _web(body)
    if web is not None:
        parts.append(_prism(window, units, web, spare=2.0 * GAP * min(window.lattice.pitch)))
    yield from _declared(window, f"Lens{k}", parts, units, depth)
    yield from _all_cells(window, f"Lens{k}", array, units, _glass(body))
    if web is not None:
        yield from _beside(window, array, units, web, _glass(body))


def _web(body: Body) -> HeightRange | None:
    low, high = body.front.land, body.back.land
    return None if low is None or high is None else HeightRange(low, high)


def _layers(window: Window, body: Body, k: int, units: float) -> Iterator[str]:
    """A slab or a plano sheet: its structured faces and the block between them."""
    hair = GAP * min(window.lattice.pitch)
    ends = []
    for face, side in ((body.front, 1.0), (body.back, -1.0)):
        if face.array is None:
            ends.append(face.vertex[2])
            continue
        heights = _heights(window, face)
        inner, outer = (heights.high, heights.low) if side > 0.0 else (heights.low, heights.high)
        inner, outer = inner + side * 50.0 * hair, outer - side * 50.0 * hair
        ends.append(inner + side * hair)
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
    hair, side = GAP * min(window.lattice.pitch), 1.0 if outer < inner else -1.0
    depth = HeightRange(min(outer, inner), max(outer, inner))
    parts = [_meeting([_half_space(face, units), _prism(window, units, depth, zone=True)])]
    land = None if face.land is None or isnan(face.land) else HeightRange(*sorted((face.land, inner)))
    if land is not None:
        # a hair inside the lens's own prism: where two solids share a face a merge may lose both
        under = HeightRange(
            *sorted((land.low if face.land == land.low else land.high, inner - side * 25.0 * hair))
        )
        parts.append(_prism(window, units, under, spare=2.0 * hair))
    yield from _declared(window, name, parts, units, depth)
    yield from _all_cells(window, name, face.array, units, _glass(body))
    if land is None:
        return
    yield from _beside(window, face.array, units, land, _glass(body))
    if window.land.opaque:
        level = land.low if side > 0.0 else land.high
        paint = HeightRange(*sorted((level, level - side * hair)))
        wider = HeightRange(paint.low - hair, paint.high + hair)
        rim = f"difference {{ {_prism(window, units, paint, spare=0.0)} {_prism(window, units, wider, zone=True)} }}"
        yield from _declared(window, f"{name}Land", [rim], units, depth)
        yield from _all_cells(window, f"{name}Land", face.array, units, BLACK)
        yield from _beside(window, face.array, units, paint, BLACK)


def _heights(window: Window, face: Face) -> HeightRange:
    """Heights between which a face lies, lens and land; sampled over the cell and its border, with room."""
    tile = window.lattice.tile()
    if face.array is None:
        return HeightRange(face.vertex[2], face.vertex[2])
    along = np.linspace(0.0, 1.0, SAMPLES)[:, None, None]
    rim = (tile * (1.0 - along) + np.roll(tile, -1, axis=0) * along).reshape(-1, 2)
    points = (rim[None] * np.linspace(0.0, 1.0, SAMPLES)[:, None, None]).reshape(-1, 2)
    z, _ = lens_height_and_normal(face, points[:, 0], points[:, 1])
    z = np.append(z[np.isfinite(z)], [] if face.land is None or isnan(face.land) else [face.land])
    room = 0.01 * float(np.ptp(z))
    return HeightRange(float(z.min()) - room, float(z.max()) + room)


def _glass(body: Body) -> str:
    return f"{GLASS} interior {{ ior {number(body.index)} }}"


def _depth(window: Window, body: Body) -> HeightRange:
    """Heights between which a bundle lies, with room to spare: the mid plane between the arrays is never passed."""
    z0, z1 = window.z_range
    room = 0.05 * (z1 - z0)
    vertices = [face.vertex[2] for face in (body.front, body.back)]
    reach = 2.0 * max(window.lattice.pitch)
    return HeightRange(max(z0 - room, min(vertices) - reach), min(z1 + room, max(vertices) + reach))


def _half_space(face: Face, units: float) -> str:
    """The side of a lens on which its glass is, as a quadric turned and moved into its cell."""
    s = face.surface
    assert isinstance(s, Quadric)  # `refuse` has seen to it
    a, b, c = (number(v / units) for v in (s.curvature_x, s.curvature_y, s.kappa))
    quadric = f"quadric {{ <{a}, {b}, {c}>, <0, 0, 0>, <0, 0, {number(-2.0 * s.side)}>, 0"
    return f"{quadric} {matrix(face.rotation, np.array(face.vertex) * units)} }}"


def _meeting(parts: list[str]) -> str:
    return "intersection { " + "\n    ".join(parts) + " }"


# -- cells -------------------------------------------------------------------------------------


def _halves(window: Window, zone: bool, spare: float) -> list[float]:
    """Half widths of a cell, or of its optical zone, less a hair at each border."""
    loss = 0.5 * window.land.seam if zone else 0.0
    half_widths = window.lattice.half_widths
    return [half - loss - spare for half in half_widths[: len(half_widths) // 2]]


def _prism(
    window: Window, units: float, span: HeightRange, zone: bool = False, spare: float | None = None
) -> str:
    """A cell, or its optical zone, between two heights."""
    hair = GAP * min(window.lattice.pitch) if spare is None else spare
    halves = [units * half for half in _halves(window, zone, hair)]
    low, high = number(units * span.low), number(units * span.high)
    if not window.lattice.hexagonal:
        x, y = (number(half) for half in halves)
        return f"box {{ <-{x}, -{y}, {low}>, <{x}, {y}, {high}> }}"
    sides = []
    for step, half in zip(window.lattice.steps[:3], halves, strict=True):
        ox, oy = window.lattice.offset(*step)
        length = float(np.hypot(ox, oy))
        for sign in (1.0, -1.0):
            sides.append(
                f"plane {{ <{number(sign * ox / length)}, {number(sign * oy / length)}, 0>, {number(half)} }}"
            )
    return f"intersection {{ {' '.join(sides)} plane {{ z, {high} }} plane {{ -z, {number(-units * span.low)} }} {_bounded(window, units, span)} }}"


def _bounded(window: Window, units: float, span: HeightRange) -> str:
    reach = number(units * window.lattice.circumradius)
    low, high = number(units * span.low), number(units * span.high)
    return f"bounded_by {{ box {{ <-{reach}, -{reach}, {low}>, <{reach}, {reach}, {high}> }} }}"


def _declared(window: Window, name: str, parts: list[str], units: float, span: HeightRange) -> Iterator[str]:
    kind = "merge" if len(parts) > 1 else "intersection"
    inside = "\n  ".join(parts)
    yield f"#declare {name} = {kind} {{\n  {inside}\n  {_bounded(window, units, span)}\n}}"


def _rows(window: Window) -> Iterator[str]:
    """First kept cell of each row and one past its last; plain lattices need no table."""
    lattice = window.lattice
    if lattice.outline is None:
        return
    if isinstance(lattice.outline, Plate):
        found = [(j, *run) for j in range(lattice.count[1]) for run in runs(lattice.row(j)[:, 0]).tolist()]
        for name, column in zip(("ROW", "FIRST", "END"), zip(*found, strict=True), strict=True):
            yield f"#declare {name} = array[{len(column)}] {{ {', '.join(map(str, column))} }}"
        return
    whole = [lattice.row(j) for j in range(lattice.count[1])]
    for name, ends in (
        ("FIRST", [int(run[0, 0]) if len(run) else 0 for run in whole]),
        ("END", [int(run[-1, 0]) + 1 if len(run) else 0 for run in whole]),
    ):
        yield f"#declare {name} = array[{len(ends)}] {{ {', '.join(map(str, ends))} }}"


def _all_cells(
    window: Window, name: str, array: int, units: float, look: str, beyond: int = 0
) -> Iterator[str]:
    """One flat union of a declared cell at every place of an array (nested unions trace far slower).

    beyond : rows and columns of cells beside the kept ones
    """
    lattice = window.lattice
    x0, y0 = (a + b for a, b in zip(lattice.first_centre, window.shifts[array], strict=True))
    px, py = lattice.pitch[0], lattice.a2[1]
    if beyond and not lattice.hexagonal:
        first, end = f"{-beyond}", f"{lattice.count[0] + beyond}"
    elif lattice.outline is not None:
        first, end = "FIRST[J]", "END[J]"
    elif lattice.hexagonal:
        first, end = "-int(J/2)", f"{lattice.count[0]} - int(J/2)"
    else:
        first, end = "0", f"{lattice.count[0]}"
    slant = " + 0.5*J" if lattice.hexagonal else ""
    yield "union {"
    rows = beyond if not lattice.hexagonal else 0
    of_runs = isinstance(lattice.outline, Plate) and first == "FIRST[J]"
    counter, start, end_of_rows = "J", -rows, f"{lattice.count[1] + rows}"
    if of_runs:  # a row of a plate may fall into several runs of cells
        counter, start, end_of_rows, first, end = "R", 0, "dimension_size(ROW, 1)", "FIRST[R]", "END[R]"
    yield f"  #declare {counter} = {start}; #while ({counter} < {end_of_rows})"
    if of_runs:
        yield "    #declare J = ROW[R];"
    yield f"    #declare I = {first}; #while (I < {end})"
    place = f"{number(x0 * units)} + (I{slant})*{number(px * units)}, {number(y0 * units)} + J*{number(py * units)}, 0"
    yield f"      object {{ {name} translate <{place}> }}"
    yield "    #declare I = I + 1; #end"
    yield f"  #declare {counter} = {counter} + 1; #end"
    yield f"  {look}"
    yield "}"


# -- the rim -----------------------------------------------------------------------------------


def _outline(window: Window, body: Body, units: float, span: HeightRange) -> str:
    """The whole footprint of a body between two heights."""
    low, high = number(units * span.low), number(units * span.high)
    arrays = {face.array for face in (body.front, body.back) if face.array is not None}
    x, y = window.shifts[arrays.pop()] if len(arrays) == 1 else (0.0, 0.0)
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
        array = body.front.array if body.front.array is not None else body.back.array
        assert array is not None
        sx, sy = window.shifts[array]
        a, b, c, d = window.lattice.extent()
        x0, x1, y0, y1 = a + sx, b + sx, c + sy, d + sy
    corners = [
        f"<{number(units * u)}, {number(units * v)}, {z}>" for u, v, z in ((x0, y0, low), (x1, y1, high))
    ]
    return f"box {{ {', '.join(corners)} }}"


ROUND = 720
"""Sides that a whole turn of a plate's round edges becomes."""


def _plate(plate: Plate, units: float, low: str, high: str) -> str:
    """A plate between two heights: the prism of its boundary less a cylinder for each hole."""
    corners = plate.polygons(ROUND)[0]
    points = ", ".join(
        f"<{number(units * x)}, {number(units * y)}>" for x, y in [*corners.tolist(), corners[0].tolist()]
    )
    # a prism is swept along y over points of the plane x, z: y and z change places
    body = (
        f"prism {{ linear_sweep linear_spline {low}, {high}, {len(corners) + 1}, {points} "
        "matrix <1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0> }"
    )
    room = f"({high} - {low})"
    holes = "".join(
        f" cylinder {{ <{number(units * hole.x)}, {number(units * hole.y)}, {low} - {room}>, "
        f"<{number(units * hole.x)}, {number(units * hole.y)}, {high} + {room}>, {number(0.5 * units * hole.diameter)} }}"
        for hole in plate.holes
    )
    return f"difference {{ {body}{holes} }}" if holes else body


def _beside(window: Window, array: int, units: float, span: HeightRange, look: str) -> Iterator[str]:
    """Land between the cells and the outline: the outline less every cell."""
    if window.outline is None:
        return
    room = 0.5 * (span.high - span.low)
    wider = HeightRange(span.low - room, span.high + room)
    body = next(b for b in window.bodies if array in (b.front.array, b.back.array))
    yield "difference {"
    yield f"  {_outline(window, body, units, span)}"
    if window.lattice.hexagonal or window.lattice.outline is not None:
        yield f"  #declare Gone = {_prism(window, units, wider, spare=0.0)}"
        yield from (f"  {line}" for line in _all_cells(window, "Gone", array, units, ""))
    else:
        x0, x1, y0, y1 = window.lattice.extent()
        sx, sy = window.shifts[array]
        low, high = (number(units * z) for z in (wider.low, wider.high))
        yield f"  box {{ <{number(units * (x0 + sx))}, {number(units * (y0 + sy))}, {low}>,"
        yield f"    <{number(units * (x1 + sx))}, {number(units * (y1 + sy))}, {high}> }}"
    yield f"  {look}"
    yield "}"


def _honeycomb(window: Window, units: float, first: Body, second: Body) -> Iterator[str]:
    """Black walls between two bodies: each cell's border, sheared to its partner's, less the channel."""
    assert window.baffle is not None
    span = HeightRange(_heights(window, first.back).high, _heights(window, second.front).low)
    rise = span.high - span.low
    run = np.subtract(window.shifts[array_of(second)], window.shifts[array_of(first)]) / rise
    room = 0.01 * rise
    channel = HeightRange(-room, rise + room)
    wall = _prism(window, units, HeightRange(0.0, rise), spare=0.0)
    free = _prism(window, units, channel, spare=0.5 * window.baffle.wall)
    shear = (
        f"matrix <1, 0, 0, 0, 1, 0, {number(run[0])}, {number(run[1])}, 1, 0, 0, {number(units * span.low)}>"
    )
    yield f"#declare Wall = difference {{ {wall} {free} {shear} }}"
    beyond = int(np.ceil(window.land.border / min(window.lattice.pitch)))
    yield from _all_cells(window, "Wall", array_of(first), units, BLACK, beyond)
