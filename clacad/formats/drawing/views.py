"""Dimensioned drawings, true to scale, of the assembly, of one telescopelet and of its lenses.

Outlines come from the faces that are traced and written. Every number at a dimension line is measured on them
or is one of the derived numbers. Lengths are in millimetres; ± is printed where the design's [tolerances]
specify it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.digits import digits
from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.formats.drawing.allowances import NO_ALLOWANCES, Allowances
from clacad.formats.drawing.body_outlines import across_cell, heights, outlines
from clacad.formats.drawing.canvas import Canvas
from clacad.sheet.bundle import central_cell
from clacad.sheet.feasibility import FaceShape, body_range
from clacad.sheet.lattice import Circle
from clacad.sheet.plate import Plate
from clacad.sheet.volume_and_extent import body_extent, whole_extent
from clacad.sheet.window import Body, Window

if TYPE_CHECKING:
    from clacad.sheet.feasibility import Feasibility

WIDTH = 760.0
MOST_CELLS = 240
"""Cells across the sheet up to which the assembly is drawn lens by lens."""


@dataclass(frozen=True, eq=False)
class DrawnLight:
    """Light that is drawn through a telescopelet.

    Parameters
    ----------
    rays : list of (k, 3) arrays, lengths
        Traced paths through the cell in the middle.
    focus : float, length
        Height of the common focal plane over lens 1.
    """

    rays: list[Floats]
    focus: float


def mm_text(value: float, half: float = 0.0) -> str:
    """A length in millimetres as a drawing prints it, with its tolerance."""
    return f"{value:.5g} ±{half:.2g}" if half > 0.0 else f"{value:.5g}"


def assembly(window: Window) -> Canvas:
    """The whole sheet from the side, cut through a row of cells, with its outer sizes and those of its
    bodies.
    """
    mm = millimetres(window.unit)
    x0, x1, _, _ = whole_extent(window)
    low, high = window.z_range
    left, right = 40.0, 130.0
    scale = min((WIDTH - left - right) / ((x1 - x0) * mm), 260.0 / ((high - low) * mm))
    tall = (high - low) * mm * scale
    top = 34.0
    canvas = Canvas(WIDTH, top + tall + 74.0, "assembly in cross-section with dimensions, to scale", scale)
    left += 0.5 * ((WIDTH - left - right) - (x1 - x0) * mm * scale)

    def at(x: Floats | float, z: Floats | float) -> Floats:
        return _points(left + (np.asarray(x) - x0) * mm * scale, top + (high - np.asarray(z)) * mm * scale)

    _, y = across_cell(window, 0)
    for body in window.bodies:
        _draw_body(canvas, window, body, y, at)
    end = left + (x1 - x0) * mm * scale
    bottom = top + tall
    canvas.datum((left + 0.2 * (end - left), bottom), (0.0, 17.0), "A")
    canvas.across(left, end, bottom + 30, mm_text((x1 - x0) * mm), (bottom, bottom))
    canvas.upright(top, bottom, end + 62, mm_text((high - low) * mm), (end, end))
    if len(window.bodies) > 1:
        for body in window.bodies:
            a, b = body_range(window, body)
            ya, yb = float(at(x0, b)[1]), float(at(x0, a)[1])
            canvas.upright(ya, yb, end + 16, mm_text((b - a) * mm), (end, end))
    canvas.text((left, 14), f"{row_text(window)}, lens 1 below", "start", "note")
    canvas.scale_note((WIDTH - 6, 14))
    canvas.leader((left - 22, bottom - min(30.0, tall + 12)), (left - 22, bottom), "")
    canvas.text((left - 22, bottom + 14), "+z", "middle", "note")
    canvas.text((left, bottom + 60), "Light comes from below. Section along x through the row of cells nearest the middle.",
                "start", "note")  # fmt: skip
    return canvas


def row_text(window: Window) -> str:
    """Title of the section with its cells: those of the row that is drawn, not of the lattice."""
    n1, n2 = window.lattice.count
    row = window.lattice.row(central_cell(window)[1])
    cells = f"{len(row)} cells of {mm_text(window.lattice.pitch[0] * millimetres(window.unit))}"
    return (
        cells
        if len(row) == n1
        else f"{cells} in the row shown (of {n1} x {n2} of the lattice, cut to the outline)"
    )


def _points(across: Floats, down: Floats) -> Floats:
    """Points (…, 2) of a drawing, px."""
    return np.stack(np.broadcast_arrays(across, down), axis=-1)


def _draw_body(canvas: Canvas, window: Window, body: Body, y: float, at: Callable[..., Floats]) -> None:
    a0, a1, _, _ = body_extent(window, body)
    if window.lattice.count[0] <= MOST_CELLS:
        samples = min(4001, max(401, 12 * window.lattice.count[0] + 1))
        x = np.linspace(a0, a1, samples) * (1.0 - 1e-12)
        pieces = outlines(x, *heights(window, body, x, y))
        if 0 < len(pieces) <= 60:
            for piece in pieces:
                canvas.polygon(at(piece[:, 0], piece[:, 1]), "body")
            return
    low, high = body_range(window, body)
    corners = np.array([[a0, low], [a1, low], [a1, high], [a0, high]])
    canvas.polygon(at(corners[:, 0], corners[:, 1]), "cut")


def plan(window: Window) -> Canvas:
    """The sheet seen along the light, with its axes, which show its orientation."""
    mm = millimetres(window.unit)
    x0, x1, y0, y1 = whole_extent(window)
    scale = 190.0 / (max(x1 - x0, y1 - y0) * mm)
    wide, tall = (x1 - x0) * mm * scale, (y1 - y0) * mm * scale
    across, upright = _inner_distances(window)
    drop = (
        STEP_DOWN if isinstance(window.outline, Plate) else 0.0
    )  # the datum of a round side is above the words
    canvas = Canvas(
        380.0 + STEP_OUT * len(upright),
        tall + 92.0 + drop + STEP_DOWN * len(across),
        "the sheet seen along the light, with axes, sizes and places of holes, to scale",
        scale,
    )
    left, top = 105.0, 24.0
    if isinstance(window.outline, Plate):
        _plate_plan(canvas, window.outline, (x1, y1), (left, top), mm * scale)
        lowest, outermost = _extreme_places(window.outline)
        canvas.datum((left + (x1 - lowest) * mm * scale, top + tall), (0.0, 14.0), "B")
        canvas.datum((left + wide, top + (y1 - outermost) * mm * scale), (13.0, 0.0), "C")
    elif isinstance(window.outline, Circle):
        canvas.circle((left + 0.5 * wide, top + 0.5 * tall), 0.5 * wide, "body")
        canvas.datum((left + wide, top + 0.5 * tall), (13.0, 0.0), "B")
    else:
        canvas.polygon(
            np.array([[left, top], [left + wide, top], [left + wide, top + tall], [left, top + tall]]), "body"
        )
        canvas.polygon(np.array([[left, top], [left + 12.0, top], [left, top + 12.0]]), "mark")
        canvas.text((left - 6.0, top + 10.0), "mark", "end", "note")
        canvas.datum((left + 0.2 * wide, top + tall), (0.0, 14.0), "B")
        canvas.datum((left + wide, top + 0.2 * tall), (13.0, 0.0), "C")
    middle = np.array([left + 0.5 * wide, top + 0.5 * tall])
    for tip, words in (((-48.0, 0.0), "+x"), ((0.0, -48.0), "+y")):
        end = middle + np.array(tip)
        canvas.leader((float(end[0]), float(end[1])), (float(middle[0]), float(middle[1])), "")
        canvas.text((float(end[0]) - 10 if tip[0] else float(end[0]) + 12, float(end[1]) + 4), words)
    canvas.circle((float(middle[0]), float(middle[1])), 5.0, "dim")
    canvas.text((float(middle[0]) + 10, float(middle[1]) + 18), "+z away", "start", "note")
    bottom = top + tall
    canvas.across(left, left + wide, bottom + 26 + drop, mm_text((x1 - x0) * mm), (bottom, bottom))
    canvas.upright(top, bottom, left + wide + 22, mm_text((y1 - y0) * mm), (left + wide, left + wide))
    _inner_dimensions(canvas, window, (x1, y1), (left, top), (left + wide + 22, bottom + 26 + drop))
    foot = bottom + 54 + drop + STEP_DOWN * len(across)
    canvas.text((6, foot), "seen along the light, from the side of lens 1", "start", "note")
    canvas.scale_note((canvas.width - 6.0, foot))
    return canvas


def _inner_dimensions(
    canvas: Canvas,
    window: Window,
    corner: tuple[float, float],
    at: tuple[float, float],
    outer: tuple[float, float],
) -> None:
    """The clear aperture and the places of holes, dimensioned beyond the outer sizes.

    corner : (x, y), lengths, that lies at the point `at`, px; outer : place of the outer dimensions, px
    """
    mm = millimetres(window.unit)
    assert canvas.scale is not None
    scale, kept = mm * canvas.scale, window.lattice.outline
    origin = (at[0] + corner[0] * scale, at[1] + corner[1] * scale)
    if isinstance(kept, Circle) and window.outline != kept:
        canvas.circle(origin, 0.5 * kept.diameter * scale, "axis")
    across, upright = _inner_distances(window)
    for row, (low, high, words) in enumerate(across, 1):
        ends, said = (origin[0] - high * scale, origin[0] - low * scale), words + mm_text((high - low) * mm)
        canvas.across(*ends, outer[1] + STEP_DOWN * row, said, (origin[1], origin[1]))
    for row, (low, high, words) in enumerate(upright, 1):
        ends, said = (origin[1] - high * scale, origin[1] - low * scale), words + mm_text((high - low) * mm)
        canvas.upright(*ends, outer[0] + STEP_OUT * row, said, (origin[0], origin[0]))


STEP_DOWN, STEP_OUT = 20.0, 44.0
"""Distance of successive dimension lines, px."""

MOST_PLACES = 4
"""Largest number of distinct hole distances along an axis that a view dimensions; the table of holes has all.
"""

Distance = tuple[float, float, str]


def _inner_distances(window: Window) -> tuple[list[Distance], list[Distance]]:
    """Stretches (low, high, words) along x and along y, lengths, to be dimensioned: clear aperture, positions
    of holes.
    """
    clear: list[Distance] = []
    if isinstance(window.lattice.outline, Circle) and window.outline != window.lattice.outline:
        half = 0.5 * window.lattice.outline.diameter
        clear = [(-half, half, "clear ")]
    if not isinstance(window.outline, Plate):
        return clear, []
    plate = window.outline
    found: list[list[Distance]] = []
    for places in ([hole.x for hole in plate.holes], [hole.y for hole in plate.holes]):
        least = 1e-12 * max(plate.reach)
        apart = sorted({float(f"{value:.12g}") for value in places if abs(value) > least}, key=abs)
        stretches = [(min(0.0, value), max(0.0, value), "") for value in apart]
        found.append(stretches if len(stretches) <= MOST_PLACES else [])
    return clear + found[0], found[1]


def _extreme_places(plate: Plate) -> tuple[float, float]:
    """X of the lowest and y of the leftmost points of a plate (lengths), away from the middle of a straight
    side.
    """
    boundary = plate.polygons(360)[0]
    x, y = boundary.T
    near = 1e-6 * max(plate.reach)
    lowest, leftmost = x[y < y.min() + near], y[x < x.min() + near]
    share = 0.7  # away from the words of a dimension, which are in the middle
    places = [float(side.min() + share * (side.max() - side.min())) for side in (lowest, leftmost)]
    return places[0], places[1]


def _plate_plan(
    canvas: Canvas, plate: Plate, corner: tuple[float, float], at: tuple[float, float], scale: float
) -> None:
    """A plate seen along the light, +x to the left: its edge, its numbered holes, the mark at the corner +x, +y.

    corner : (x, y), lengths, that lies at the point `at`, px; scale : px per length
    """

    def place(points: Floats) -> Floats:
        return _points(at[0] + (corner[0] - points[:, 0]) * scale, at[1] + (corner[1] - points[:, 1]) * scale)

    boundary = place(plate.polygons(180)[0])
    canvas.polygon(boundary, "body")
    first = boundary[np.argmin(boundary.sum(axis=1))]
    canvas.polygon(np.array([first + (2.0, 2.0), first + (14.0, 2.0), first + (2.0, 14.0)]), "mark")
    canvas.text((at[0] - 6.0, at[1] + 10.0), "mark", "end", "note")
    for number, hole in enumerate(plate.holes, 1):
        x, y = place(np.array([[hole.x, hole.y]]))[0].tolist()
        radius = 0.5 * hole.diameter * scale
        canvas.circle((x, y), radius, "body")
        canvas.text((x + radius + 3.0, y - radius), str(number), "start", "note")


def telescopelet(
    window: Window, facts: Feasibility, light: DrawnLight | None = None, allowed: Allowances = NO_ALLOWANCES
) -> Canvas:
    """One telescopelet cut along x, light from the left, with separation, thicknesses, pitch and focal plane."""
    mm = millimetres(window.unit)
    pitch = window.lattice.pitch[0] * mm
    low, high = window.z_range
    shift = abs(window.shifts[1][0]) * mm
    scale = min(600.0 / ((high - low) * mm), 190.0 / (pitch + shift))
    left, top = 74.0, 40.0
    tall = (pitch + shift) * scale
    canvas = Canvas(
        WIDTH, top + tall + 96.0, "one telescopelet in cross-section with dimensions, to scale", scale
    )
    left += 0.5 * (600.0 - (high - low) * mm * scale)
    x, y = across_cell(window, 0)
    above = 0.5 * pitch + max(0.0, window.shifts[1][0] * mm)
    middle = 0.5 * (x[0] + x[-1])

    def at(x: Floats | float, z: Floats | float) -> Floats:
        down = top + (above - (np.asarray(x) - middle) * mm) * scale
        return _points(left + (np.asarray(z) - low) * mm * scale, down)

    spans = _spans(window, at, canvas)
    bottom = top + tall
    for number, body in enumerate(window.bodies):
        if body.name not in spans:
            continue
        name, (a, b), half = body.name, spans[body.name], allowed.of_body(number, len(window.bodies))
        za, zb = float(at(0.0, a)[0]), float(at(0.0, b)[0])
        canvas.across(za, zb, bottom + 26, f"{name} {mm_text((b - a) * mm, half)}", (bottom, bottom))
    centres = [0.0, _second(window)]
    za, zb = (float(at(0.0, c)[0]) for c in centres)
    apart = allowed.separation if window.form != "slab" else 0.0
    words = f"lens to lens {mm_text((centres[1] - centres[0]) * mm, apart)}"
    canvas.across(za, zb, bottom + 56, words, (bottom, bottom))
    ya, yb = float(at(x[-1], 0.0)[1]), float(at(x[0], 0.0)[1])
    edge = float(at(0.0, low)[0])
    canvas.upright(ya, yb, edge - 44, mm_text(pitch), (edge, edge))
    if light is not None:
        _focal_plane(canvas, window, light, at, middle)
    canvas.text((6, 14), f"f in air, lens 1: {_pair(facts.lenses[0].built_focal_length, mm)}; lens 2: "
                f"{_pair(facts.lenses[1].built_focal_length, mm)} (x, y)", "start", "note")  # fmt: skip
    canvas.scale_note((WIDTH - 6, 14))
    return canvas


def _pair(values: tuple[float, float], mm: float) -> str:
    return ", ".join(mm_text(v * mm) if isfinite(v) else "none" for v in values)


def _second(window: Window) -> float:
    """Height of the middle of lens 2."""
    if window.thin.field:
        return float(np.mean([f.vertex[2] for f in window.faces if f.array == 1]))
    if window.form != "biconvex":
        return float(next(f for f in window.faces if f.array == 1).vertex[2])
    return float(window.thin.offset[2])


def _spans(window: Window, at: Callable[..., Floats], canvas: Canvas) -> dict[str, tuple[float, float]]:
    """Draw the bodies over one cell; return the extent along z of each, at the middle of its cell.

    A body of two arrays is drawn, and its extent taken, over the cells of both its lenses, each face along
    the middle of its own lens: displaced lenses do not face each other.
    """
    found = {}
    for body in window.bodies:
        arrays = [face.array for face in (body.front, body.back) if face.array is not None]
        paired = len(set(arrays)) == 1
        x, y = across_cell(window, arrays[0])
        if not paired:
            other, other_y = across_cell(window, arrays[1])
            x = np.union1d(x, other)
            front, back = heights(window, body, x, y)[0], heights(window, body, x, other_y)[1]
        else:
            front, back = heights(window, body, x, y)
        for piece in outlines(x, front, back):
            canvas.polygon(at(piece[:, 0], piece[:, 1]), "body")
        low, high = (front[len(x) // 2], back[len(x) // 2]) if paired else (np.nanmin(front), np.nanmax(back))
        if isfinite(low) and isfinite(high):
            found[body.name] = (float(low), float(high))
    return found


def _focal_plane(canvas: Canvas, window: Window, light: DrawnLight, at: Callable[..., Floats], middle: float
                 ) -> None:  # fmt: skip
    """Common focal plane along x, where it lies between the lenses, and traced rays."""
    for ray in light.rays:
        path = at(ray[:, 0] + middle, ray[:, 2])
        for end, towards in ((0, 1), (-1, -2)):  # a little of the way outside is enough
            way = path[end] - path[towards]
            path[end] = path[towards] + way * min(1.0, 34.0 / max(abs(float(way[0])), 1e-9))
        canvas.line(path, "ray")
    place = light.focus
    if isfinite(place) and window.z_range[0] < place < window.z_range[1]:
        half = 0.5 * window.lattice.pitch[0]
        top, bottom = at(middle + half, place), at(middle - half, place)
        canvas.line([tuple(top), tuple(bottom)], "focus")
        canvas.text(
            (float(top[0]), float(top[1]) - 6),
            f"focal plane {mm_text(place * millimetres(window.unit))} from lens 1",
        )


def lens_detail(
    window: Window, facts: Feasibility, number: int, allowed: Allowances = NO_ALLOWANCES
) -> Canvas:
    """Lens `number` of the facts over its cell, enlarged, with pitch, sag, thickness and apex radii; light from below."""
    lens = facts.lenses[number]
    array = lens.array
    place = next(k for k, one in enumerate(window.bodies) if one.name == lens.body)
    body = window.bodies[place]
    mm = millimetres(window.unit)
    x, y = across_cell(window, array)
    front, back = heights(window, body, x, y)
    pitch = window.lattice_of(array).pitch[0] * mm
    left = 84.0
    curved = _curved_side(body, array)
    deep = front if curved is None else (front if curved == 0 else back)
    depth = (_depth(front, back) if curved is None else _depth(deep, deep)) * mm
    scale = min(200.0 / pitch, 120.0 / depth) if depth > 0 else 200.0 / pitch
    left += 0.5 * (200.0 - pitch * scale)
    bottom = _low(front)
    if curved == 1:  # the flat side of a thick body is far below: only its top is drawn
        bottom = max(bottom, _low(back) - 40.0 / scale / mm)
    drawn_top = np.where(np.isfinite(back), np.minimum(back, bottom + 130.0 / scale / mm), np.nan)
    if curved == 0:
        drawn_top = np.minimum(drawn_top, bottom + max(60.0 / scale / mm, 1.5 * depth / mm))
    tall = (float(np.nanmax(drawn_top)) - bottom) * mm * scale if np.isfinite(drawn_top).any() else 40.0
    base = 54.0 + max(tall, 30.0)
    label = f"{lens.name} over its cell with dimensions, to scale"
    canvas = Canvas(380.0, base + 80.0, label, scale)

    def at(x_: Floats | float, z: Floats | float) -> Floats:
        down = base - (np.asarray(z) - bottom) * mm * scale
        return _points(left + (np.asarray(x_) - x[0]) * mm * scale, down)

    for piece in outlines(x, np.maximum(front, bottom), drawn_top):
        canvas.polygon(at(piece[:, 0], piece[:, 1]), "body" if curved is None else "cut")
    half = allowed.of_body(place, len(window.bodies))
    _detail_dimensions(canvas, x, front, back, at, mm, curved, base, half)
    canvas.text((6, 14), f"{lens.name}, on {body.name}" if array < 2 else lens.name, "start", "title")
    canvas.scale_note((374, 14))
    shapes = lens.shapes or (FaceShape("", lens.radius, lens.conic, None),)
    radius = "; ".join(
        ", ".join(mm_text(r * mm) if isfinite(r) else "flat" for r in shape.radius) for shape in shapes
    )
    conic = "; ".join(
        ", ".join("–" if k is None else digits(k, count=4) for k in shape.conic) for shape in shapes
    )
    canvas.text((6, base + 56.0), f"apex radius x, y: {radius}", "start")
    canvas.text((6, base + 72.0), f"conic constant x, y: {conic}; sag {mm_text(lens.sag * mm)}", "start")
    return canvas


def _curved_side(body: Body, array: int) -> int | None:
    """Side of a body that carries this lens where the other side does not: 0 front, 1 back; None where both
    do.
    """
    sides = [k for k, face in enumerate((body.front, body.back)) if face.array == array]
    return sides[0] if len(sides) == 1 else None


def _depth(front: Floats, back: Floats) -> float:
    if not (np.isfinite(front) & np.isfinite(back)).any():
        return 0.0
    return float(np.nanmax(back) - np.nanmin(front))


def _detail_dimensions(
    canvas: Canvas, x: Floats, front: Floats, back: Floats, at: Callable[..., Floats], mm: float, curved: int | None,
    base: float, half: float,
) -> None:  # fmt: skip
    """Draw pitch, and sag of a lens on a plate, or thicknesses of a separate lens at the middle and the edge."""
    pitch = (x[-1] - x[0]) * mm
    (xa, ya), (xb, _) = at(x[0], _low(front)), at(x[-1], _low(front))
    canvas.across(
        float(xa), float(xb), base + 30.0, mm_text(pitch), (min(float(ya), base), min(float(ya), base))
    )
    solid = np.flatnonzero(np.isfinite(front) & np.isfinite(back) & (back >= front))
    if not len(solid):
        canvas.text((190, 110), "no material along this line")
        return
    first, mid = int(solid[0]), int(solid[len(solid) // 2])
    if curved is not None:
        face = front if curved == 0 else back
        ends = float(at(0.0, face[first])[1]), float(at(0.0, face[mid])[1])
        canvas.upright(*ends, float(xb) + 18, mm_text(abs(face[mid] - face[first]) * mm),
                       (float(at(x[-1], 0.0)[0]), float(at(x[mid], 0.0)[0])))  # fmt: skip
        return
    za, zb = float(at(0.0, front[mid])[1]), float(at(0.0, back[mid])[1])
    canvas.upright(za, zb, float(xb) + 18, mm_text((back[mid] - front[mid]) * mm, half),
                   (float(at(x[mid], 0.0)[0]), float(at(x[mid], 0.0)[0])))  # fmt: skip
    za, zb = float(at(0.0, front[first])[1]), float(at(0.0, back[first])[1])
    canvas.upright(za, zb, float(xa) - 18, mm_text((back[first] - front[first]) * mm),
                   (float(at(x[first], 0.0)[0]), float(at(x[first], 0.0)[0])))  # fmt: skip


def _low(values: Floats) -> float:
    return float(np.nanmin(values)) if np.isfinite(values).any() else 0.0
