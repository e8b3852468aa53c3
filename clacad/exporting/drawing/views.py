"""Dimensioned drawings, true to scale, of the assembly, of one telescopelet and of its lenses.

Outlines come from the faces that are traced and written. Every number at a dimension line is measured on them
or is one of the derived numbers. Lengths are in millimetres; ± is printed where the design's [tolerances]
specify it.

Outlines of the bodies in a plane y = const, from the same faces that are traced and written.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import floor, isfinite, log10
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clacad.base.text import digits
from clacad.base.types import Floats, Ints
from clacad.base.units import millimetres
from clacad.exporting.drawing.canvas import CHARACTER, NO_ALLOWANCES, Allowances, Canvas
from clacad.sheet.feasibility import FaceShape, body_range
from clacad.sheet.lattice import Circle, Rectangle
from clacad.sheet.plate import Plate
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.volume_and_extent import body_extent, whole_extent
from clacad.sheet.window import Body, Face, Window, column, face_height

if TYPE_CHECKING:
    from clacad.sheet.feasibility import Feasibility, LensFacts


def heights(window: Window, body: Body, x: Floats, y: float) -> tuple[Floats, Floats]:
    """Front and back height (n,) of a body over sheet points (x, y); NaN where it has no material."""
    found = []
    for k, face in enumerate((body.front, body.back)):
        index, local, inside = _place(window, body, face, x, y)
        if body.columnar:
            z = column(window, body, local[0], local[1], index)[k]
        else:
            z = face_height(window, face, local[0], local[1], index)
        beyond = np.nan if face.land is None else face.land
        found.append(np.where(inside, z, face.vertex[2] if face.array is None else beyond))
    front, back = found
    missing = ~(np.isfinite(front) & np.isfinite(back))
    if isinstance(window.outline, Plate):
        missing |= ~window.outline.inside(np.stack([x, np.full_like(x, y)], axis=-1))
    return np.where(missing, np.nan, front), np.where(missing, np.nan, back)


def _place(
    window: Window, body: Body, face: Face, x: Floats, y: float
) -> tuple[Ints, tuple[Floats, Floats], NDArray[np.bool_]]:
    """Cells of the face's own array, points in them, and which lie over kept cells."""
    other = body.back if face is body.front else body.front
    array = face.array if face.array is not None else other.array
    index, lx, ly = window.locate(0 if array is None else array, x, np.full_like(x, y))
    return index, (lx, ly), np.asarray(window.lattice.contains(index))


def outlines(x: Floats, front: Floats, back: Floats) -> list[Floats]:
    """Closed outlines (k, 2) of (x, z), one for each unbroken stretch of material."""
    solid = np.isfinite(front) & np.isfinite(back) & (back >= front)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], solid, [False]]).astype(np.int8)))
    found = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        rows = slice(first, last)
        found.append(
            np.concatenate(
                [np.column_stack([x[rows], front[rows]]), np.column_stack([x[rows], back[rows]])[::-1]]
            )
        )
    return found


def across_cell(window: Window, array: int) -> tuple[Floats, float]:
    """Points x (n,) over the cell of an array nearest the middle, along x, and its y; sheet frame."""
    from clacad.sheet.representative_cells import central_cell

    middle = window.centres(array, np.array(central_cell(window), dtype=np.int64))
    half = 0.5 * window.lattice_of(array).pitch[0] * (1.0 - 1e-9)
    return middle[0] + np.linspace(-half, half, 161), float(middle[1])


WIDTH = 760.0
MOST_CELLS = 240
"""Cells across the sheet up to which the assembly is drawn lens by lens."""


@dataclass(frozen=True, eq=False)
class DrawnLight:
    """Light that is drawn through a telescopelet.

    rays : list of (k, 3) arrays, lengths. Traced paths through the cell in the middle.
    focus : length. Height of the common focal plane over lens 1.
    """

    rays: list[Floats]
    focus: float


@dataclass(frozen=True, slots=True)
class OnPaper:
    """How much of a sheet of paper a view may take.

    unit : Millimetres on paper a pixel.
    share : Of the scale that a view has in a report.
    """

    unit: float
    share: float

    def scale(self, largest: float) -> float:
        """The largest scale of ISO 5455 (1, 2 or 5 times a power of ten) up to a share of `largest`, px per
        mm.
        """
        wanted = largest * self.share * self.unit * (1.0 + 1e-9)
        power = 10.0 ** floor(log10(wanted))
        return next(step for step in (5.0, 2.0, 1.0) if step * power <= wanted) * power / self.unit


def _scaled(largest: float, paper: OnPaper | None) -> float:
    return largest if paper is None else paper.scale(largest)


def _text_width(*words: str) -> float:
    """Width of a view that lines of words need, px."""
    return 12.0 + CHARACTER * max(len(line) for line in words)


def mm_text(value: float, half: float = 0.0) -> str:
    """A length in millimetres as a drawing prints it, with its tolerance."""
    return f"{value:.5g} ±{half:.2g}" if half > 0.0 else f"{value:.5g}"


Range = tuple[float, float]


def assembly(window: Window, paper: OnPaper | None = None, ranges: Sequence[Range] | None = None) -> Canvas:
    """The whole sheet from the side, cut through a row of cells, with its outer sizes and those of its
    bodies.

    ranges : lowest and highest point of every body (lengths), where they are known already
    """
    ranges = ranges or [body_range(window, body) for body in window.bodies]
    mm = millimetres(window.unit)
    x0, x1, _, _ = whole_extent(window)
    low, high = window.z_range
    left, right = 40.0, 130.0
    largest = min((WIDTH - left - right) / ((x1 - x0) * mm), 260.0 / ((high - low) * mm))
    scale = _scaled(largest, paper)
    wide, tall = (x1 - x0) * mm * scale, (high - low) * mm * scale
    top = 50.0
    title, foot = (
        f"{row_text(window)}, lens 1 below",
        "Section along x, row nearest the middle; light from below.",
    )
    full = max(left + wide + right, _text_width(title, foot)) if paper else WIDTH
    canvas = Canvas(full, top + tall + 74.0, "assembly in cross-section with dimensions, to scale", scale)
    left += 0.5 * (full - left - right - wide)

    def at(x: Floats | float, z: Floats | float) -> Floats:
        return _points(left + (np.asarray(x) - x0) * mm * scale, top + (high - np.asarray(z)) * mm * scale)

    _, y = across_cell(window, 0)
    for body in window.bodies:
        _draw_body(canvas, window, body, y, at)
    _assembly_dimensions(canvas, window, at, ranges, (left, left + wide), (top, top + tall))
    canvas.text((6.0, 14), title, "start", "note")
    canvas.scale_note((6.0, 29))
    canvas.text((6.0, top + tall + 62), foot, "start", "note")
    return canvas


def _assembly_dimensions(
    canvas: Canvas,
    window: Window,
    at: Callable[..., Floats],
    ranges: Sequence[Range],
    across: tuple[float, float],
    down: tuple[float, float],
) -> None:
    """Outer sizes, heights of the bodies, datum A, finish of the sides, and direction of the light."""
    mm = millimetres(window.unit)
    x0, x1, _, _ = whole_extent(window)
    low, high = window.z_range
    (left, end), (top, bottom) = across, down
    canvas.datum((left + 0.2 * (end - left), bottom), (0.0, 17.0), "A")
    canvas.across(left, end, bottom + 30, mm_text((x1 - x0) * mm), (bottom, bottom))
    canvas.upright(top, bottom, end + 62, mm_text((high - low) * mm), (end, end))
    edge = top + min(10.0, 0.5 * float(at(x0, ranges[-1][0])[1] - top))
    canvas.leader((left, edge), (left - 16.0, edge - 4.0))
    canvas.finish((left - 16.0, edge - 4.0), OTHER_FINISH)
    if len(ranges) > 1:
        for a, b in ranges:
            ya, yb = float(at(x0, b)[1]), float(at(x0, a)[1])
            canvas.upright(ya, yb, end + 16, mm_text((b - a) * mm), (end, end))
    canvas.leader((left - 22, bottom - min(30.0, bottom - top + 12)), (left - 22, bottom))
    canvas.text((left - 22, bottom + 14), "+z", "middle", "note")


LENS_FINISH, OTHER_FINISH = "z", "y"
"""Letters at the symbols of surface texture, on lens faces and on all others; the table of surfaces explains
them."""


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


def plan(window: Window, paper: OnPaper | None = None) -> Canvas:
    """The sheet seen along the light, with its axes, which show its orientation."""
    mm = millimetres(window.unit)
    x0, x1, y0, y1 = whole_extent(window)
    scale = _scaled(190.0 / (max(x1 - x0, y1 - y0) * mm), paper)
    wide, tall = (x1 - x0) * mm * scale, (y1 - y0) * mm * scale
    across, upright = _inner_distances(window)
    left, top, drop = 70.0, 24.0, STEP_DOWN
    foot = ["seen along the light (+z away), from the side of lens 1", *_left_out(window)]
    needed = left + wide + 74.0 + STEP_OUT * len(upright)
    full = max(needed, _text_width(*foot))
    left += 0.5 * (full - needed)
    canvas = Canvas(
        full,
        top + tall + drop + 50.0 + STEP_DOWN * len(across) + 15.0 * len(foot),
        "the sheet seen along the light, with axes, sizes and places of holes, to scale",
        scale,
    )
    _outline(canvas, window, (left, top), (wide, tall))
    _axes(canvas, (left + 0.5 * wide, top + 0.5 * tall), min(48.0, 0.3 * wide, 0.3 * tall))
    bottom = top + tall
    canvas.across(left, left + wide, bottom + 26 + drop, mm_text((x1 - x0) * mm), (bottom, bottom))
    canvas.upright(top, bottom, left + wide + 22, mm_text((y1 - y0) * mm), (left + wide, left + wide))
    _inner_dimensions(canvas, window, (x1, y1), (left, top), (left + wide + 22, bottom + 26 + drop))
    below = bottom + 44 + drop + STEP_DOWN * len(across)
    canvas.scale_note((6, below))
    for number, words in enumerate(foot, 1):
        canvas.text((6, below + 15.0 * number), words, "start", "note")
    return canvas


def _outline(canvas: Canvas, window: Window, at: tuple[float, float], size: tuple[float, float]) -> None:
    """Outline of the sheet, its mark and datums; `at`: upper left corner, `size`: width and height, px."""
    (left, top), (wide, tall) = at, size
    x0, x1, y0, y1 = whole_extent(window)
    scale = wide / (x1 - x0)
    place_b, place_c = left + 0.2 * wide, top + 0.2 * tall
    if isinstance(window.outline, Plate):
        _plate_plan(canvas, window.outline, (x1, y1), at, scale)
        lowest, outermost = _extreme_places(window.outline)
        place_b, place_c = left + (x1 - lowest) * scale, top + (y1 - outermost) * scale
    elif isinstance(window.outline, Circle):
        canvas.circle((left + 0.5 * wide, top + 0.5 * tall), 0.5 * wide, "body")
        canvas.datum((left + wide * (0.5 + 0.5**1.5), top + tall * (0.5 - 0.5**1.5)), (13.0, -13.0), "B")
        return
    else:
        canvas.polygon(
            np.array([at, [left + wide, top], [left + wide, top + tall], [left, top + tall]]), "body"
        )
        canvas.polygon(np.array([at, [left + 12.0, top], [left, top + 12.0]]), "mark")
        canvas.text((left - 6.0, top + 10.0), "mark", "end", "note")
    across, upright = _inner_distances(window)
    down = [left + (x1 - v) * scale for low, high, _ in across for v in (low, high)]
    right = [top + (y1 - v) * scale for low, high, _ in upright for v in (low, high)]
    canvas.datum((place_b, top + tall), (_free_way(place_b, [*down, left, left + wide]), 16.0), "B")
    canvas.datum((left + wide, place_c), (13.0, _free_way(place_c, [*right, top, top + tall])), "C")


def _free_way(place: float, taken: Sequence[float]) -> float:
    """Least offset (px) of a datum letter from its place that keeps extension lines (`taken`) off it."""
    ways = sorted((4.0 * k for k in range(-40, 41)), key=lambda way: (abs(way), way))
    return next((way for way in ways if all(abs(place + way - line) > 9.0 for line in taken)), 0.0)


def _axes(canvas: Canvas, middle: tuple[float, float], length: float) -> None:
    """The axes of the sheet at its middle, seen along the light."""
    for (dx, dy), words in (((-length, 0.0), "+x"), ((0.0, -length), "+y")):
        end = (middle[0] + dx, middle[1] + dy)
        canvas.leader(end, middle)
        canvas.text((end[0] - 10 if dx else end[0] + 12, end[1] + 4), words)
    canvas.circle(middle, 5.0, "dim")


def _left_out(window: Window) -> list[str]:
    """Reference to the table of holes for places that the view does not dimension."""
    many = [axis for axis, found in zip("xy", _hole_places(window), strict=True) if len(found) > MOST_PLACES]
    return [f"holes along {' and '.join(many)}: see table"] if many else []


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
    clear = _clear_aperture(window)
    if isinstance(kept, Circle) and clear[0]:
        canvas.circle(origin, 0.5 * kept.diameter * scale, "axis")
    elif clear[0]:
        (x0, x1, _), (y0, y1, _) = clear[0][0], clear[1][0]
        box = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
        canvas.line(np.asarray(origin) - box * scale, "axis")
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
"""Largest number of hole distances along an axis that a view dimensions; the table of holes has all."""

Distance = tuple[float, float, str]


def _inner_distances(window: Window) -> tuple[list[Distance], list[Distance]]:
    """Stretches (low, high, words) along x and y, lengths, to be dimensioned: clear aperture, holes."""
    clear = _clear_aperture(window)
    found = [places if len(places) <= MOST_PLACES else [] for places in _hole_places(window)]
    return clear[0] + found[0], clear[1] + found[1]


def _clear_aperture(window: Window) -> tuple[list[Distance], list[Distance]]:
    """Along x and along y, where the plate is larger than its cells; a round one has one diameter."""
    kept = window.lattice.outline
    if isinstance(kept, Circle):
        half = 0.5 * kept.diameter
        return ([(-half, half, "clear ")] if window.outline != kept else []), []
    if not isinstance(window.outline, Rectangle) or window.land.border == 0.0:
        return [], []
    x0, x1, y0, y1 = window.placements[0].extent(window.lattice)
    return [(x0, x1, "clear ")], [(y0, y1, "clear ")]


def _hole_places(window: Window) -> tuple[list[Distance], list[Distance]]:
    """Each different distance of holes from the middle, along x and along y."""
    if not isinstance(window.outline, Plate):
        return [], []
    plate = window.outline
    least = 1e-12 * max(plate.reach)

    def stretches(places: list[float]) -> list[Distance]:
        apart = sorted({float(f"{value:.12g}") for value in places if abs(value) > least}, key=abs)
        return [(min(0.0, value), max(0.0, value), "") for value in apart]

    return stretches([hole.x for hole in plate.holes]), stretches([hole.y for hole in plate.holes])


def _extreme_places(plate: Plate) -> tuple[float, float]:
    """X of the lowest and y of the leftmost points of a plate (lengths), off the middle of a side."""
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
    """A plate seen along the light, +x to the left: its edge, its numbered holes, the mark at the corner +x,
    +y.

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
    window: Window,
    facts: Feasibility,
    light: DrawnLight | None = None,
    allowed: Allowances = NO_ALLOWANCES,
    paper: OnPaper | None = None,
) -> Canvas:
    """One telescopelet cut along x, light from the left, with separation, thicknesses, pitch and focal
    plane.
    """
    mm = millimetres(window.unit)
    pitch = window.lattice.pitch[0] * mm
    low, high = window.z_range
    shift = abs(window.shifts[1][0]) * mm
    scale = _scaled(min(600.0 / ((high - low) * mm), 190.0 / (pitch + shift)), paper)
    left, top = 74.0, 60.0
    wide, tall = (high - low) * mm * scale, (pitch + shift) * scale
    title = (
        f"f in air, lens 1: {_pair(facts.lenses[0].built_focal_length, mm)}; lens 2: "
        f"{_pair(facts.lenses[1].built_focal_length, mm)} (x, y)"
    )
    full = max(left + wide + 86.0, _text_width(title)) if paper else WIDTH
    label = "one telescopelet in cross-section with dimensions, to scale"
    canvas = Canvas(full, top + tall + 70.0, label, scale)
    left += 0.5 * (full - 160.0 - wide)
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
    canvas.text((6, 14), title, "start", "note")
    canvas.scale_note((6, 29))
    return canvas


def _pair(values: tuple[float, float], mm: float) -> str:
    return ", ".join(mm_text(v * mm) if isfinite(v) else "none" for v in values)


def _second(window: Window) -> float:
    """Height of the middle of lens 2."""
    if window.form == "plates":
        return window.bodies[-1].back.vertex[2]
    if window.field_array:
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
        arrays, paired = body.arrays, len(body.arrays) == 1
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


def _focal_plane(
    canvas: Canvas, window: Window, light: DrawnLight, at: Callable[..., Floats], middle: float
) -> None:
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
    window: Window,
    facts: Feasibility,
    number: int,
    allowed: Allowances = NO_ALLOWANCES,
    paper: OnPaper | None = None,
) -> Canvas:
    """Lens `number` of the facts over its cell, enlarged, with pitch, sag, thickness and apex radii; light
    from below.
    """
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
    scale = _scaled(min(200.0 / pitch, 120.0 / depth) if depth > 0 else 200.0 / pitch, paper)
    radius, conic = _shape_words(lens, mm)
    full = max(left + pitch * scale + 96.0, _text_width(radius, conic)) if paper else 380.0
    left += 0.5 * (full - 180.0 - pitch * scale)
    bottom = _low(front)
    if curved == 1:  # the flat side of a thick body is far below: only its top is drawn
        bottom = max(bottom, _low(back) - 40.0 / scale / mm)
    drawn_top = np.where(np.isfinite(back), np.minimum(back, bottom + 130.0 / scale / mm), np.nan)
    if curved == 0:
        drawn_top = np.minimum(drawn_top, bottom + max(60.0 / scale / mm, 1.5 * depth / mm))
    tall = (float(np.nanmax(drawn_top)) - bottom) * mm * scale if np.isfinite(drawn_top).any() else 40.0
    base = 54.0 + max(tall, 30.0)
    label = f"{lens.name} over its cell with dimensions, to scale"
    canvas = Canvas(full, base + 80.0, label, scale)

    def at(x_: Floats | float, z: Floats | float) -> Floats:
        down = base - (np.asarray(z) - bottom) * mm * scale
        return _points(left + (np.asarray(x_) - x[0]) * mm * scale, down)

    for piece in outlines(x, np.maximum(front, bottom), drawn_top):
        canvas.polygon(at(piece[:, 0], piece[:, 1]), "body" if curved is None else "cut")
    _lens_finish(canvas, x, deep if curved == 0 else drawn_top, at, curved == 0)
    half = allowed.of_body(place, len(window.bodies))
    _detail_dimensions(canvas, x, (front, back), at, mm, curved, base, half)
    canvas.text((6, 14), f"{lens.name}, on {body.name}" if array < 2 else lens.name, "start", "title")
    canvas.scale_note((6, 29))
    canvas.text((6, base + 56.0), radius, "start")
    canvas.text((6, base + 72.0), conic, "start")
    return canvas


def _shape_words(lens: LensFacts, mm: float) -> tuple[str, str]:
    """The apex radii of a lens, and its conic constants with its sag."""
    shapes = lens.shapes or (FaceShape("", lens.radius, lens.conic, None),)
    radius = "; ".join(
        ", ".join(mm_text(r * mm) if isfinite(r) else "flat" for r in shape.radius) for shape in shapes
    )
    conic = "; ".join(
        ", ".join("–" if k is None else digits(k, count=4) for k in shape.conic) for shape in shapes
    )
    return f"apex radius x, y: {radius}", f"conic constant x, y: {conic}; sag {mm_text(lens.sag * mm)}"


def _lens_finish(canvas: Canvas, x: Floats, face: Floats, at: Callable[..., Floats], below: bool) -> None:
    """The symbol of surface texture on a lens face next to its apex; on a leader where seen from below."""
    known = np.flatnonzero(np.isfinite(face))
    if not len(known):
        return
    number = known[len(known) // 8]
    tip = (float(at(x[number], 0.0)[0]), float(at(0.0, face[number])[1]))
    if not below:
        canvas.finish(tip, LENS_FINISH)
        return
    elbow = (float(at(x[0], 0.0)[0]) - 34.0, tip[1] + 16.0)
    canvas.leader(tip, elbow)
    canvas.finish(elbow, LENS_FINISH)


def _curved_side(body: Body, array: int) -> int | None:
    """Side of a body that carries this lens where the other does not: 0 front, 1 back; None where both do."""
    sides = [k for k, face in enumerate((body.front, body.back)) if face.array == array]
    return sides[0] if len(sides) == 1 else None


def _depth(front: Floats, back: Floats) -> float:
    if not (np.isfinite(front) & np.isfinite(back)).any():
        return 0.0
    return float(np.nanmax(back) - np.nanmin(front))


def _detail_dimensions(
    canvas: Canvas,
    x: Floats,
    faces: tuple[Floats, Floats],
    at: Callable[..., Floats],
    mm: float,
    curved: int | None,
    base: float,
    half: float,
) -> None:
    """Draw pitch, and sag of a lens on a plate, or middle and edge thickness of a separate lens."""
    front, back = faces
    (xa, ya), (xb, _) = at(x[0], _low(front)), at(x[-1], _low(front))
    edge = min(float(ya), base)
    canvas.across(float(xa), float(xb), base + 30.0, mm_text((x[-1] - x[0]) * mm), (edge, edge))
    solid = np.flatnonzero(np.isfinite(front) & np.isfinite(back) & (back >= front))
    if not len(solid):
        canvas.text((190, 110), "no material along this line")
        return
    first, mid = int(solid[0]), int(solid[len(solid) // 2])
    if curved is not None:
        face = front if curved == 0 else back
        ends = float(at(0.0, face[first])[1]), float(at(0.0, face[mid])[1])
        feet = float(at(x[-1], 0.0)[0]), float(at(x[mid], 0.0)[0])
        canvas.upright(*ends, float(xb) + 18, mm_text(abs(face[mid] - face[first]) * mm), feet)
        return
    for k, place, allowed in ((mid, float(xb) + 18, half), (first, float(xa) - 18, 0.0)):
        ends = float(at(0.0, front[k])[1]), float(at(0.0, back[k])[1])
        foot = float(at(x[k], 0.0)[0])
        canvas.upright(*ends, place, mm_text((back[k] - front[k]) * mm, allowed), (foot, foot))


def _low(values: Floats) -> float:
    return float(np.nanmin(values)) if np.isfinite(values).any() else 0.0
