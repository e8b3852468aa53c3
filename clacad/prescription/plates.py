"""From asked outlines, corners, holes and pins to the plate that bodies end at. Lengths in design units.

A plate stands where it is drawn, about the sheet's origin, and is common to both bodies: bolts and pins go straight
through. A plain border round displaced arrays is as wide as both need. Where the outline is said (`lattice.outline`)
cells that it or a hole cuts are left out; where the number of cells is (`body.border`), a hole that meets one is refused.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clacad.base.digits import rounded_up
from clacad.base.types import Pair2
from clacad.design.sections import BodySpec, Outline
from clacad.prescription.radii import NoSuchLens
from clacad.sheet.lattice import Circle, Rectangle
from clacad.sheet.plate import Hole, Plate, counter_clockwise, plate_of_circle, plate_of_rectangle
from clacad.sheet.plate_edges import Vertex, edge_gaps, inside
from clacad.sheet.window import Window

MOST_CELLS = 10_000_000
"""Cells that are asked one by one whether a plate holds them."""


def asked_outline(outline: Outline | None, body: BodySpec) -> Circle | Rectangle | Plate | None:
    """The outline that `lattice.outline` asks for, with the corners, holes and pins of the body.

    Raises
    ------
    NoSuchLens
        A corner, hole or pin that makes no plate.
    """
    if outline is None:
        return None
    if outline.shape == "polygon":
        return _with_holes(counter_clockwise(outline.points), outline.size, body)
    if not body.shaped:
        return Circle(outline.size[0]) if outline.shape == "circle" else Rectangle(*outline.size)
    if outline.shape == "circle":
        return _with_holes(plate_of_circle(outline.size[0]), outline.size, body)
    return _rectangular(outline.size, body)


def with_plate(window: Window, body: BodySpec) -> Window:
    """The window with the plate of its body: what `lattice.outline` gave, or its border with corners and holes.

    Raises
    ------
    NoSuchLens
        A hole meets a cell of a sheet whose number of cells is given; no cell is left.
    """
    kept = window.lattice.outline
    if isinstance(kept, Plate):
        many = window.lattice.count[0] * window.lattice.count[1]
        if many > MOST_CELLS:
            raise NoSuchLens(f"lattice.count asks {many:,} cells whether the plate holds them", "lattice.count",
                             f"at most {MOST_CELLS:,}", "CL106")  # fmt: skip
        plate = replace(kept, moved=window.shifts[1])
        window = replace(window, lattice=replace(window.lattice, outline=plate), outline=plate)
        _refuse_empty(window, plate)
        return window
    if not body.shaped or not isinstance(window.outline, Rectangle) or kept is not None:
        return window
    dx, dy = (0.0, 0.0) if window.form == "slab" else window.shifts[1]
    size = window.outline.width + 2.0 * abs(dx), window.outline.height + 2.0 * abs(dy)
    plate = replace(_rectangular(size, body), moved=window.shifts[1])
    _refuse_cut_cells(window, plate)
    return replace(window, outline=plate)


def _rectangular(size: Pair2, body: BodySpec) -> Plate:
    corners = None if body.corners is None else (body.corners.shape, body.corners.size)
    if corners is not None and not 2.0 * corners[1] < min(size):
        raise NoSuchLens(f"body.corners: {corners[0]} = {corners[1]:g} leaves no side of {size[0]:g} x {size[1]:g}", "body.corners",
                         f"{corners[0]} below {0.5 * min(size):g}", "CL141")  # fmt: skip
    return _with_holes(plate_of_rectangle(*size, corners), size, body)


def _with_holes(vertices: tuple[Vertex, ...], size: Pair2, body: BodySpec) -> Plate:
    """The boundary with its holes, each wholly in the material and off the others."""
    plate = Plate(vertices)
    asked = [
        (Hole(x, y, spec.diameter), f"body.holes.{n}")
        for n, spec in enumerate(body.holes)
        for x, y in spec.places(size)
    ]
    if body.pins is not None:
        diameter = body.pins.diameter + body.pins.play
        asked += [(Hole(x, y, diameter, "pin", body.pins.play), "body.pins") for x, y in body.pins.at]
    holes: list[Hole] = []
    for hole, key in asked:
        holes.append(_fitting(plate, holes, hole, key))
    return Plate(vertices, tuple(holes))


def _fitting(plate: Plate, others: list[Hole], hole: Hole, key: str) -> Hole:
    """The hole itself, where it keeps to the plate and off the others."""
    middle = np.array([[hole.x, hole.y]])
    gap = min(float(edge_gaps(edge, middle)[0][0]) for edge in plate.edges)
    gap = gap if inside(plate.edges, middle)[0] else -gap
    what = f"{key}: a hole of diameter {hole.diameter:.6g} at ({hole.x:.6g}, {hole.y:.6g})"
    if not gap > 0.5 * hole.diameter:
        inward = rounded_up(0.5 * hole.diameter - gap)
        less = f"a diameter below {2.0 * gap:.6g}, or the hole" if gap > 0.0 else "the hole"
        raise NoSuchLens(f"{what} {'cuts' if gap > -0.5 * hole.diameter else 'lies outside'} the edge of the plate", key,
                         f"{less} more than {inward} farther in", "CL141")  # fmt: skip
    for other in others:
        apart = float(np.hypot(hole.x - other.x, hole.y - other.y))
        if not apart > 0.5 * (hole.diameter + other.diameter):
            raise NoSuchLens(f"{what} meets that at ({other.x:.6g}, {other.y:.6g})", key,
                             f"their middles more than {0.5 * (hole.diameter + other.diameter):.6g} apart", "CL141")  # fmt: skip
    return hole


def _refuse_cut_cells(window: Window, plate: Plate) -> None:
    """Refuse a hole or corner that meets a cell of a sheet whose number of cells is given."""
    lattice = window.lattice
    cells = lattice.cells()
    if len(cells) > MOST_CELLS:
        raise NoSuchLens(f"{len(cells):,} cells are too many beside holes", "lattice.count", f"at most {MOST_CELLS:,}", "CL106")  # fmt: skip
    held = plate.holds(lattice.tile(), lattice.centres(cells), plate.room(lattice.pitch))
    if held.all():
        return
    key = next(name for name, asked in (("body.holes", plate.holes), ("body.corners", True)) if asked)
    size = ", ".join(rounded_up(v) for v in (plate.box[1] - plate.box[0], plate.box[3] - plate.box[2]))
    raise NoSuchLens(
        f"{key}: {int((~held).sum())} of {len(cells)} cells are cut, or come nearer than {plate.room(lattice.pitch):.3g} to an edge",
        key,
        f"a wider body.border, or holes farther out; lattice.outline = {{rectangle = [{size}]}} leaves cut cells out",
        "CL141",
    )


def _refuse_empty(window: Window, plate: Plate) -> None:
    """Refuse a plate that holds no cell."""
    if window.lattice.holds_a_cell:
        return
    x0, x1, y0, y1 = plate.box
    raise NoSuchLens(
        "lattice.outline holds no whole cell off its edge and holes",
        "lattice.outline",
        f"it reaches from ({x0:.6g}, {y0:.6g}) to ({x1:.6g}, {y1:.6g}); cells stand about the origin: a larger outline, a "
        "smaller lattice.pitch, or the outline moved there",
        "CL117",
    )
