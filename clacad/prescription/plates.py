"""Plates at which bodies end, from requested outlines, corners, holes and pins, and their land.

Lengths in design units.

A plate lies where it is drawn, relative to the sheet's origin, and is common to both bodies: bolts and pins
pass straight through. A plain border around displaced arrays is as wide as both need. Where `lattice.outline`
is the edge of the plate, cells that the edge or a hole cuts are left out. Where the plate has its own edge
(`body.border`, `body.outline`), all cells of the lattice are kept, and an edge or hole that cuts one of them
is refused.
"""

from __future__ import annotations

from dataclasses import replace
from math import hypot

import numpy as np

from clacad.base.text import rounded_up
from clacad.base.types import Pair2
from clacad.design.body import BodySpec, Outline
from clacad.design.sections import BODY, LATTICE
from clacad.prescription.cell_heights import face_range
from clacad.prescription.radii import NoSuchLens
from clacad.sheet.lattice import Circle, Lattice, Rectangle, whole_on_plate
from clacad.sheet.pattern import held_when_turned
from clacad.sheet.plate import Hole, Plate, counter_clockwise, plate_of_circle, plate_of_rectangle
from clacad.sheet.plate_edges import Vertex, edge_gaps, inside
from clacad.sheet.window import Body, Face, Window

MOST_CELLS = 10_000_000
"""Greatest number of cells that are tested one by one against a plate."""


def cells_outline(outline: Outline | None, body: BodySpec) -> Circle | Rectangle | Plate | None:
    """Outline that keeps the cells inside it, from `lattice.outline`.

    Where it is also the edge of the plate (no border, no `body.outline`), it includes the corners, holes and
    pins of the body, and cells cut by them are left out.

    Raises NoSuchLens: A corner, hole or pin does not fit the plate.
    """
    if outline is None:
        return None
    if body.apart:
        return Plate(counter_clockwise(outline.points)) if outline.shape == "polygon" else _plain(outline)
    return _plate(outline, body) if body.shaped or outline.shape == "polygon" else _plain(outline)


def with_plate(window: Window, body: BodySpec) -> Window:
    """Window with the plate of its body: `lattice.outline`, `body.outline`, or the cells with a border around
    them.

    Raises NoSuchLens: The edge, a corner or a hole of a plate cuts a cell of the lattice; no cell is left.
    """
    kept = window.lattice.outline
    if isinstance(kept, Plate):
        many = window.lattice.count[0] * window.lattice.count[1]
        if many > MOST_CELLS:
            raise NoSuchLens(
                f"lattice.count asks {many:,} cells whether the plate holds them",
                LATTICE.count,
                f"at most {MOST_CELLS:,}",
                "CL106",
            )
        kept = _for_array_2(kept, window)
        window = replace(window, lattice=replace(window.lattice, outline=kept), outline=kept)
        _refuse_empty(window, kept)
    if kept is not None and not body.apart:
        return window
    edge = body.outline or _bordered(window, body)
    if edge is None:
        return window
    plate = _for_array_2(_plate(edge, body), window)
    _refuse_cut_cells(window, plate, body)
    return replace(window, outline=plate)


def _for_array_2(plate: Plate, window: Window) -> Plate:
    """Plate that keeps cells which are whole in array 2 as well."""
    second = window.placements[1]
    return replace(plate, moved=second.shift, pitch=second.pitch, turn=second.turn)


def _bordered(window: Window, body: BodySpec) -> Outline | None:
    """Outline of the cells with the border, wide enough for both arrays; None if it needs no plate."""
    edge = window.outline
    if not body.shaped or edge is None or isinstance(edge, Plate):
        return None
    dx, dy = (0.0, 0.0) if window.one_outline else window.shifts[1]
    if isinstance(edge, Circle):
        across = edge.diameter + 2.0 * float(np.hypot(dx, dy))
        return Outline("circle", (across, across))
    return Outline("rectangle", (edge.width + 2.0 * abs(dx), edge.height + 2.0 * abs(dy)))


def _plain(outline: Outline) -> Circle | Rectangle:
    return Circle(outline.size[0]) if outline.shape == "circle" else Rectangle(*outline.size)


def _plate(outline: Outline, body: BodySpec) -> Plate:
    """Plate of an outline with the corners, holes and pins of the body."""
    if outline.shape == "polygon":
        return _with_holes(counter_clockwise(outline.points), outline.size, body)
    if outline.shape == "circle":
        return _with_holes(plate_of_circle(outline.size[0]), outline.size, body)
    return _rectangular(outline.size, body)


def _rectangular(size: Pair2, body: BodySpec) -> Plate:
    corners = None if body.corners is None else (body.corners.shape, body.corners.size)
    if corners is not None and not 2.0 * corners[1] < min(size):
        raise NoSuchLens(
            f"body.corners: {corners[0]} = {corners[1]:g} leaves no side of {size[0]:g} x {size[1]:g}",
            BODY.corners,
            f"{corners[0]} below {0.5 * min(size):g}",
            "CL141",
        )
    return _with_holes(plate_of_rectangle(*size, corners), size, body)


def _with_holes(vertices: tuple[Vertex, ...], size: Pair2, body: BodySpec) -> Plate:
    """Plate of a boundary with its holes, each wholly in the material and apart from the others."""
    plate = Plate(vertices)
    asked = [
        (Hole(x, y, spec.diameter), f"{BODY.holes}.{n}")
        for n, spec in enumerate(body.holes)
        for x, y in spec.places(size)
    ]
    if body.pins is not None:
        diameter = body.pins.diameter + body.pins.play
        asked += [(Hole(x, y, diameter, "pin", body.pins.play), BODY.pins) for x, y in body.pins.at]
    holes: list[Hole] = []
    for hole, key in asked:
        holes.append(_fitting(plate, holes, hole, key))
    return Plate(vertices, tuple(holes))


def _fitting(plate: Plate, others: list[Hole], hole: Hole, key: str) -> Hole:
    """Return the hole; refuse one that cuts the plate's edge or another hole."""
    middle = np.array([[hole.x, hole.y]])
    gap = min(float(edge_gaps(edge, middle)[0][0]) for edge in plate.edges)
    gap = gap if inside(plate.edges, middle)[0] else -gap
    what = f"{key}: a hole of diameter {hole.diameter:.6g} at ({hole.x:.6g}, {hole.y:.6g})"
    if not gap > 0.5 * hole.diameter:
        inward = rounded_up(0.5 * hole.diameter - gap)
        less = f"a diameter below {2.0 * gap:.6g}, or the hole" if gap > 0.0 else "the hole"
        raise NoSuchLens(
            f"{what} {'cuts' if gap > -0.5 * hole.diameter else 'lies outside'} the edge of the plate",
            key,
            f"{less} more than {inward} farther in",
            "CL141",
        )
    for other in others:
        apart = float(np.hypot(hole.x - other.x, hole.y - other.y))
        if not apart > 0.5 * (hole.diameter + other.diameter):
            raise NoSuchLens(
                f"{what} meets that at ({other.x:.6g}, {other.y:.6g})",
                key,
                f"their middles more than {0.5 * (hole.diameter + other.diameter):.6g} apart",
                "CL141",
            )
    return hole


def _refuse_cut_cells(window: Window, plate: Plate, body: BodySpec) -> None:
    """Refuse an edge, hole or corner that cuts a cell of the lattice."""
    lattice = window.lattice
    if lattice.count[0] * lattice.count[1] > MOST_CELLS:
        raise NoSuchLens(
            f"{lattice.count[0]:,} x {lattice.count[1]:,} cells are too many with holes",
            LATTICE.count,
            f"at most {MOST_CELLS:,}",
            "CL106",
        )
    cells = lattice.cells()
    held = whole_on_plate(lattice, plate, cells)
    if held.all():
        return
    cut_by_edge = not whole_on_plate(lattice, replace(plate, holes=()), cells).all()
    edge = BODY.outline if body.outline is not None else BODY.corners
    key = edge if cut_by_edge or not plate.holes else BODY.holes
    raise NoSuchLens(
        f"{key}: {int((~held).sum())} of {len(cells)} cells are cut, or come nearer than"
        f" {plate.room(lattice.pitch):.3g} to an edge",
        key,
        _room_for_cells(plate, body, lattice.outline is not None),
        "CL141",
    )


def _room_for_cells(plate: Plate, body: BodySpec, stated: bool) -> str:
    """Describe changes that would keep the cells of a plate whole."""
    size = ", ".join(rounded_up(v) for v in (plate.box[1] - plate.box[0], plate.box[3] - plate.box[2]))
    wider = "a wider body.border" if body.outline is None else "a larger body.outline"
    fewer = (
        "a smaller lattice.outline"
        if stated
        else f"lattice.outline = {{rectangle = [{size}]}} leaves cut cells out"
    )
    return f"{wider}, or holes farther out; {fewer}"


def _refuse_empty(window: Window, plate: Plate) -> None:
    """Refuse a plate that holds no cell."""
    if window.lattice.holds_a_cell:
        return
    x0, x1, y0, y1 = plate.box
    raise NoSuchLens(
        "lattice.outline holds no whole cell off its edge and holes",
        LATTICE.outline,
        f"it reaches from ({x0:.6g}, {y0:.6g}) to ({x1:.6g}, {y1:.6g}); cells lie about the origin: a"
        " larger outline, a smaller lattice.pitch, or the outline moved there",
        "CL117",
    )


# -- cells inside both arrays, and land ----------------------------------------------------------------


def _within(outline: Circle | Rectangle, moved: Pair2, wider: float) -> Circle | Rectangle:
    """Outline whose contents lie in `outline` with and without a shift `moved` and scale `wider`."""
    if isinstance(outline, Circle):
        return Circle(max((outline.diameter - 2.0 * hypot(*moved)) / max(wider, 1.0), 0.0))
    width, height = outline.width - 2.0 * abs(moved[0]), outline.height - 2.0 * abs(moved[1])
    return Rectangle(max(width / max(wider, 1.0), 0.0), max(height / max(wider, 1.0), 0.0))


def _refuse_apart(lattice: Lattice, moved: Pair2, wider: float) -> None:
    """Refuse a displaced slab, a sheet without lenses, if no cell of both arrays is in the outline."""
    if lattice.holds_a_cell:
        return
    least = lattice.least_outline()
    if isinstance(least, Circle):
        shape = f"circle = {rounded_up(max(wider, 1.0) * least.diameter + 2.0 * hypot(*moved))}"
    else:
        sides = tuple(
            max(wider, 1.0) * size + 2.0 * abs(m)
            for size, m in zip((least.width, least.height), moved, strict=True)
        )
        shape = f"rectangle = [{', '.join(map(rounded_up, sides))}]"
    raise NoSuchLens(
        f"lattice.outline holds no cell that is whole in both arrays: they are {hypot(*moved):.4g} apart",
        key=LATTICE.outline,
        hint=(
            f"outline = {{{shape}}} or larger; or smaller angles, delta or separation, which bring the arrays"
            " together"
        ),
        code="CL117",
    )


def inside_both(window: Window) -> Window:
    """Window whose circular or rectangular outline keeps only cells that are whole in both arrays: those of
    array 2 are displaced in a slab, and may be larger.

    Raises NoSuchLens: No cell is left.
    """
    second, cut = window.placements[1], window.lattice.outline
    if not isinstance(cut, Circle | Rectangle):
        return window
    moved = second.shift if window.one_outline else (0.0, 0.0)
    wider = max(second.scale(window.lattice))
    if second.turn and isinstance(cut, Rectangle):
        wider = max(wider, 1.0) / held_when_turned((cut.width, cut.height), second.turn)
    if moved == (0.0, 0.0) and wider <= 1.0:
        return window
    window = replace(window, lattice=replace(window.lattice, outline=_within(cut, moved, wider)))
    _refuse_apart(window.lattice, moved, wider)
    return window


def with_land(window: Window, seam_depth: float | None) -> Window:
    """Return the window with the land that faces of plano lenses, slabs and field lenses need (seam, border,
    outline).

    The land lies `seam_depth` below the deepest point of the array's optical zone, so that it is outside the
    range of the border heights.
    """
    if window.land.seam == 0.0 and window.outline is None:
        return window
    depth = min(window.lattice.pitch) / 50.0 if seam_depth is None else seam_depth

    def landed(face: Face) -> Face:
        if face.array is None:
            return face
        low, high = face_range(window, face)
        return replace(face, land=high + depth if face.side > 0 else low - depth)

    bodies: list[Body] = []
    for body in window.bodies:
        if window.form != "biconvex" or body.name == "field":
            front = bodies[-1].back.seen_from_behind if body.joined else landed(body.front)
            body = replace(body, front=front, back=landed(body.back))
        bodies.append(body)
    return replace(window, bodies=tuple(bodies))
