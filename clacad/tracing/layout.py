"""A window in the numbers a tracer needs: faces relative to their body, bounds, borders, displacements.

Every number is relative to a cell's centre and to a level inside its own body, so nothing here grows
with the size of the sheet or its distance from the origin.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import cos, isfinite, nan, pi
from typing import Any, NamedTuple

import numpy as np

from clacad.base.types import Bools, Floats, Ints, Rows
from clacad.optics.rays import Rays
from clacad.optics.surface import sharpest_bend
from clacad.sheet.cell_places import DIRECTIONS, CellPlacement, LensPlaces, VertexChange
from clacad.sheet.face_order import media_of, outline_centre
from clacad.sheet.lattice import Circle, Lattice, Rectangle, half_sizes
from clacad.sheet.pattern import relocate, turned
from clacad.sheet.plate import Plate
from clacad.sheet.window import (
    Body,
    Face,
    Surface,
    Window,
    arrays_between,
    in_optical_tile,
    lens_height_and_normal,
    lenses_of,
)

SAMPLES = 49
"""Points a side at which a face's height is sampled for its bounds; slope times half a spacing is added."""

SLOPE_MARGIN = 1.25
"""Factor on the largest sampled slope: a lens is steepest at its corners, which are sampled."""


@dataclass(frozen=True, eq=False)
class FacePlan:
    """One face, relative to its body.

    surface : Quadric, Biconic or EvenPolynomial
    vertex : (3,) lengths. Apex: x, y from the cell's centre, z from the body's `level`.
    rotation : (3, 3) or None. Lens → sheet; None when the axes coincide and no rotation is needed.
    land : Height of the land over the body's level; NaN without land.
    low, high : lengths. Bounds of the face's height (lens and land) over the body's level.
    slope : Bound of the lens's slope against the sheet plane.
    whole : The lens is a graph over all of its optical zone and protrudes beyond the land there.
    change : Offset of the lens of each cell from `vertex`, and its size.
    blind : 0, 1 or 2. Index (1: i, 2: j) that does not affect which lens is met, because the face is
        invariant along it: see `Face.blind`.
    land_side : +1 or −1. Side of the lens on which the land lies: see `Face.land_side`.
    """

    surface: Surface
    vertex: tuple[float, float, float]
    rotation: Floats | None
    array: int | None
    land: float
    low: float
    high: float
    slope: float
    whole: bool
    change: VertexChange | None = None
    blind: int = 0
    land_side: int = 1


@dataclass(frozen=True, eq=False)
class BodyPlan:
    """One body: its two faces and its outline.

    level : sheet-frame z that heights are relative to (the front apex)
    low, high : Bounds of the material over `level`.
    covered : Front lies below back everywhere in a cell, so a hit on either lens is a hit on the body.
    separate : The front's highest point lies below the back's lowest.
    box : (x_min, x_max, y_min, y_max). Sheet-frame bounds of the footprint.
    inner : (half_x, half_y, radius)
        A convex region about `centre` that lies inside the footprint: a rectangle cut by a circle.
    outline : ("none" | "circle" | "rectangle" | "plate", half_x, half_y)
    centre : (x, y). Of the outline and of `inner`, sheet frame.
    plate : The outline where it is a plate, in the sheet frame.
    joined : Whether the front is the joint with the body before.
    """

    front: FacePlan
    back: FacePlan
    columnar: bool
    level: float
    low: float
    high: float
    covered: bool
    separate: bool
    box: tuple[float, float, float, float]
    inner: tuple[float, float, float]
    outline: tuple[str, float, float]
    centre: tuple[float, float]
    plate: Plate | None = None
    joined: bool = False

    @property
    def arrays(self) -> tuple[int, ...]:
        """Lens arrays that this body carries, each once, in the order of the light; array 0 for a layer of
        two planes.
        """
        return arrays_between(self.front.array, self.back.array)


@dataclass(frozen=True, eq=False)
class Layout:
    """The window as the tracer sees it.

    normals : (arrays, k, 2)
        Unit normals of the borders of a cell of every array, one of each opposite pair (2 or 3).
    halves : (k,) lengths. Of array 0.
    margin : Land on the inside of every border: seam / 2.
    lattices : tuple of Lattice, one an array
        Pattern of its cells about its own middle; `lattice` decides which cells exist.
    widths : (arrays, k) lengths. `halves` of every array.
    whole_steps : (arrays, arrays, 2) ints, residual : (arrays, arrays, 2) lengths. [a, b]: displacement of
        array b against array a, as lattice steps plus a residual. For arrays of one pitch.
    """

    window: Window
    bodies: tuple[BodyPlan, ...]
    normals: Floats
    halves: Floats
    margin: float
    lattices: tuple[Lattice, ...]
    widths: Floats
    whole_steps: Ints
    residual: Floats

    @property
    def lattice(self) -> Lattice:
        """The pattern of cells."""
        return self.window.lattice

    @property
    def tiny(self) -> float:
        """Length below which a stretch of a ray decides nothing: 1e-12 of a cell, far above rounding."""
        return 1e-12 * float(self.halves.max())


class Prepared(dict[str, Any]):
    """Data derived from an object, by name; it is neither pickled nor copied with the object."""

    def __reduce__(self) -> tuple[type[Prepared], tuple[()]]:
        return Prepared, ()


def prepared(thing: Window | Layout) -> Prepared:
    """Data derived from a window or a layout, ended with it; weak references would hold both forever."""
    found: Prepared = thing.__dict__.setdefault("_prepared", Prepared())
    return found


def lay_out(window: Window) -> Layout:
    """Prepare a window for tracing (a few thousand heights are sampled); kept with the window."""
    kept: Layout | None = prepared(window).get("layout")
    if kept is None:
        kept = prepared(window)["layout"] = _laid_out(window)
    return kept


def _laid_out(window: Window) -> Layout:
    lattice = window.lattice
    sampled = _sample_cell(window)
    return Layout(
        window=window,
        bodies=tuple(_plan_body(window, body.simplified, sampled) for body in window.bodies),
        halves=_half_widths(lattice),
        margin=0.5 * window.land.seam,
        **array_numbers(lattice, window.placements),
    )


def array_numbers(lattice: Lattice, placements: tuple[CellPlacement, ...]) -> dict[str, Any]:
    """Fields of a `Layout` that describe its arrays: the lattice of each, and displacements between them."""
    arrays = len(placements)
    steps, residual = np.zeros((arrays, arrays, 2), dtype=np.int64), np.zeros((arrays, arrays, 2))
    for a in range(arrays):
        for b in range(a + 1, arrays):
            shift = np.subtract(placements[b].shift, placements[a].shift)
            whole, rest = relocate(lattice, shift[None, :])
            steps[a, b], residual[a, b] = whole[0], rest[0]
            steps[b, a], residual[b, a] = -whole[0], -rest[0]
    lattices = tuple(place.lattice(lattice) for place in placements)
    widths = [_half_widths(one) for one in lattices]
    normals = np.array([_border_normals(one) for one in lattices])
    return {
        "lattices": lattices,
        "widths": np.array(widths),
        "normals": normals,
        "whole_steps": steps,
        "residual": residual,
    }


def _border_normals(lattice: Lattice) -> Floats:
    """Unit normals (k, 2) of one border of each opposite pair."""
    own = lattice.straight
    offsets = np.array([own.offset(*step) for step in own.steps[: len(own.steps) // 2]])
    normals = offsets / np.hypot(offsets[:, 0], offsets[:, 1])[:, None]
    return turned(normals, lattice.turn) if lattice.turn else np.asarray(normals)


def _half_widths(lattice: Lattice) -> Floats:
    """Distance (k,) of one border of each opposite pair from the middle of a cell, lengths."""
    own = lattice.straight
    offsets = np.array([own.offset(*step) for step in own.steps[: len(own.steps) // 2]])
    return np.asarray(0.5 * np.hypot(offsets[:, 0], offsets[:, 1]))


def lenses(layout: Layout, face: FacePlan, cell: Ints) -> LensPlaces:
    """Positions and sizes of the lenses of cells (m, 2), z over the body's level."""
    if face.change is None:
        return LensPlaces(face.vertex)
    return face.change.places(face.vertex, layout.lattice, cell)


def sheet_position(layout: Layout, array: int, cell: Ints, local: Floats, z: Floats) -> Floats:
    """Sheet-frame points (m, 3) from cell, local coordinates and sheet-frame z; for output only."""
    centre = layout.lattices[array].centres(cell) + np.asarray(layout.window.placements[array].shift)
    return np.column_stack([centre + local, z])


# -- bounds ------------------------------------------------------------------------------------


class SampledCell(NamedTuple):
    """Sample points of cells where faces are sampled.

    x, y (m,) as the face's lens sees them, and their spacing, lengths; which lie in the optical zone, (m,);
    places of the lenses over each of them, (cells, 1), None: all alike.
    """

    x: Floats
    y: Floats
    spacing: float
    zone: Bools
    places: LensPlaces | None = None

    @property
    def apart(self) -> float:
        """Largest offset of a lens, length."""
        if self.places is None or self.places.moved is None:
            return 0.0
        return float(np.hypot(*self.places.moved.T).max())

    def bend(self, surface: Surface, reach: float) -> float:
        """Bound, 1/length, on the curvature of all the lenses out to the distance `reach`, length."""
        if self.places is None or self.places.size is None:
            return sharpest_bend(surface, reach)
        least = float(self.places.size.min())
        return sharpest_bend(self.places.shape(surface), reach / least) / least


def _plan_body(window: Window, body: Body, sampled: SampledCell) -> BodyPlan:
    """Body as the tracer needs it: bounds from heights sampled over its cells, lengths over its own level."""
    level = body.front.vertex[2]
    cells = _farthest_cells(window, body)
    before, after = (_seen_by(window, face, sampled, cells) for face in (body.front, body.back))
    spacing = max(before.spacing, after.spacing)
    front_z, front_slope = _sampled(body.front, before)
    back_z, back_slope = _sampled(body.back, after)
    solids = [np.ones(seen.x.shape, dtype=bool) for seen in (before, after)]
    if body.columnar:
        with np.errstate(invalid="ignore"):
            solids = [front_z <= back_z] * 2
    front = _plan_face(body.front, level, front_z, front_slope, before, solids[0])
    back = _plan_face(body.back, level, back_z, back_slope, after, solids[1])
    apart = max(float(np.hypot(*face.vertex[:2])) for face in (body.front, body.back))
    apart += max(before.apart, after.apart)
    if body.columnar:
        reach = window.lattice.circumradius + apart
        bend = before.bend(body.front.surface, reach) + after.bend(body.back.surface, reach)
        covered = _covered((back_z - front_z)[before.zone], bend, spacing)
    else:
        covered = front.high < back.low and front.whole and back.whole
    box, inner, outline, centre = _footprint(window, body)
    pad = 1e-9 * window.lattice.circumradius
    return BodyPlan(
        front=front,
        back=back,
        columnar=body.columnar,
        level=level,
        low=front.low - pad,
        high=back.high + pad,
        covered=covered,
        separate=front.high < back.low,
        box=box,
        inner=inner,
        outline=outline,
        centre=centre,
        plate=window.outline if isinstance(window.outline, Plate) else None,
        joined=body.joined,
    )


def _covered(gap: Floats, bend: float, spacing: float) -> bool:
    """Whether the sampled thickness exceeds what faces of this bend (1/length) vary by between samples."""
    return bool(np.isfinite(gap).all() and gap.min() > bend * spacing * spacing)


def _farthest_cells(window: Window, body: Body) -> Ints | None:
    """Cells (m, 2) with the largest offsets of lenses from the faces' vertices; None where all are alike."""
    from clacad.sheet.representative_cells import outermost_cells

    found = [outermost_cells(window, face) for face in (body.front, body.back) if face.change is not None]
    return np.unique(np.concatenate(found), axis=0) if found else None


def _seen_by(window: Window, face: Face, sampled: SampledCell, cells: Ints | None) -> SampledCell:
    """Sample points of a face's cell from the lens at its vertex, or by the lenses of all `cells` (m, 2)."""
    if face.array is None:
        return sampled
    if window.placements[face.array].own:
        sampled = _sample_cell(window, face.array)
    if cells is None:
        return sampled
    places = window.lenses(face, np.broadcast_to(cells[:, None], (len(cells), 1, 2)))
    if places.moved is None:
        places = LensPlaces(face.vertex, np.zeros((len(cells), 1, 2)), np.zeros((len(cells), 1)))
    x, y = places.seen(sampled.x[None], sampled.y[None])
    seen = SampledCell(x.ravel(), y.ravel(), sampled.spacing, np.tile(sampled.zone, len(cells)), places)
    # between two of the sampled directions a lens may have a slightly larger offset
    return seen._replace(spacing=sampled.spacing + (1.0 - cos(pi / DIRECTIONS)) * seen.apart)


def _sample_cell(window: Window, array: int = 0) -> SampledCell:
    """Points over one cell, its borders and corners included."""
    lattice = window.lattice_of(array)
    tile = lattice.tile()
    low, high = tile.min(axis=0), tile.max(axis=0)
    grid = np.stack(
        np.meshgrid(*(np.linspace(a, b, SAMPLES) for a, b in zip(low, high, strict=True))), axis=-1
    ).reshape(-1, 2)
    along = np.linspace(0.0, 1.0, SAMPLES)[:, None, None]
    edges = (tile * (1.0 - along) + np.roll(tile, -1, axis=0) * along).reshape(-1, 2)
    if lattice.hexagonal:
        step = lattice.steps[:3]
        half = lattice.half_widths
        keep = np.ones(len(grid), dtype=bool)
        for s, h in zip(step, half):
            ox, oy = lattice.offset(*s)
            keep &= np.abs(grid @ np.array([ox, oy])) <= 2.0 * h * h
        grid = grid[keep]
    x, y = np.concatenate([grid, edges]).T
    return SampledCell(x, y, float(np.max(high - low)) / (SAMPLES - 1), in_optical_tile(window, x, y, array))


def _sampled(face: Face, seen: SampledCell) -> tuple[Floats, Floats]:
    """Height and slope of a face's lens at the sample points."""
    if face.array is None:
        return np.full(seen.x.shape, face.vertex[2]), np.zeros(seen.x.shape)
    whole = (1 if seen.places is None else np.shape(seen.places.rise)[0], -1)
    if seen.places is not None:
        face = lenses_of(face, seen.places, seen.x.reshape(whole).shape)
    z, normal = lens_height_and_normal(face, seen.x, seen.y)
    if seen.places is not None:
        z = seen.places.raised(z.reshape(whole)).ravel()
    with np.errstate(invalid="ignore", divide="ignore"):
        return z, np.hypot(normal[:, 0], normal[:, 1]) / normal[:, 2]


def _plan_face(
    face: Face, level: float, z: Floats, slope: Floats, seen_from: SampledCell, solid: Bools
) -> FacePlan:
    """A face over the body's level, with bounds from m sampled heights and slopes."""
    zone, spacing = seen_from.zone, seen_from.spacing
    land = nan if face.land is None else face.land - level
    seen = zone & solid & np.isfinite(z)
    steepest = SLOPE_MARGIN * float(slope[seen].max(initial=0.0))
    heights = z[seen] - level
    margin = steepest * spacing
    low = float(heights.min(initial=np.inf)) - margin
    high = float(heights.max(initial=-np.inf)) + margin
    if face.array is None:
        low = high = face.vertex[2] - level
    if (
        face.change is not None and seen_from.places is not None and seen.any()
    ):  # nearer lenses show their apex
        apex = face.vertex[2] - level + np.asarray(seen_from.places.rise)
        low, high = min(low, float(apex.min())), max(high, float(apex.max()))
    if isfinite(land):
        low, high = min(low, land), max(high, land)
    if not low <= high:  # no lens and no land anywhere: the body is empty
        low = high = 0.0
    proud = face.land is None or bool(
        ((z[zone] - level - land) * face.land_side <= 0.0).all() if seen[zone].all() else False
    )
    return FacePlan(
        surface=face.surface,
        vertex=(face.vertex[0], face.vertex[1], face.vertex[2] - level),
        rotation=None if face.untilted else face.rotation,
        array=face.array,
        land=land,
        low=low,
        high=high,
        slope=steepest,
        whole=bool(seen[zone].all()) and proud,
        change=face.change,
        blind=face.blind,
        land_side=face.land_side,
    )


Box = tuple[float, float, float, float]
Footprint = tuple[Box, tuple[float, float, float], tuple[str, float, float], tuple[float, float]]


def _footprint(window: Window, body: Body) -> Footprint:
    """Bounding box, inner region, outline and their centre."""
    if window.outline is None:
        place = window.placements[body.arrays[0]]
        box = place.extent(window.lattice)
        middle = (0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3]))
        inner = _inside_cells(window.lattice, place, box)
        return box, inner, ("none", 0.0, 0.0), middle
    if isinstance(window.outline, Plate):
        x0, x1, y0, y1 = window.outline.box
        middle = (0.5 * (x0 + x1), 0.5 * (y0 + y1))
        return (x0, x1, y0, y1), (*window.outline.free_box, np.inf), ("plate", 0.0, 0.0), middle
    cx, cy = outline_centre(window, body)
    hx, hy = half_sizes(window.outline)
    kind, room = ("circle", hx) if isinstance(window.outline, Circle) else ("rectangle", np.inf)
    return (cx - hx, cx + hx, cy - hy, cy + hy), (hx, hy, room), (kind, hx, hy), (cx, cy)


def _inside_cells(lattice: Lattice, place: CellPlacement, box: Box) -> tuple[float, float, float]:
    """A region about the middle of `box` that lies in the union of the kept cells of an array."""
    scale = max(place.scale(lattice))
    if place.turn:  # a circle inside stays inside under any rotation
        x0, x1, y0, y1 = lattice.extent()
        reach = 0.5 * min(place.scale(lattice)) * min(x1 - x0, y1 - y0)
        if isinstance(lattice.outline, Circle | Rectangle):
            reach = scale * min(half_sizes(lattice.outline))
        lost = (
            0.0 if not lattice.hexagonal and lattice.outline is None else 4.0 * scale * lattice.circumradius
        )
        return reach - lost, reach - lost, reach - lost
    half_x, half_y = 0.5 * (box[1] - box[0]), 0.5 * (box[3] - box[2])
    if not lattice.hexagonal and lattice.outline is None:
        return half_x, half_y, np.inf
    lost = 2.0 * scale * lattice.circumradius  # cells that are cut do not count
    if isinstance(lattice.outline, Circle):
        # the box of the kept cells need not be centred on the outline to better than a cell
        return half_x, half_y, 0.5 * scale * lattice.outline.diameter - 2.0 * lost
    if isinstance(lattice.outline, Rectangle):
        width, height = half_sizes(lattice.outline)
        return scale * width - 2.0 * lost, scale * height - 2.0 * lost, np.inf
    return half_x - lost, half_y - lost, np.inf


def colours(layout: Layout, rays: Rays, rows: Rows) -> Iterator[tuple[Rows, tuple[float, ...]]]:
    """Rows (k,) of rays of one wavelength at a time, with the media around the faces at it
    (`Window.media`).
    """
    window = layout.window
    if rays.wavelength is None:
        yield rows, media_of(window.bodies)
        return
    each = rays.wavelength[rows]
    if len(each) and bool((each == each[0]).all()):  # pictures are traced line by line: nothing to sort
        yield rows, media_of(window.bodies, float(each[0]))
        return
    waves, which = np.unique(each, return_inverse=True)
    order = np.argsort(which, kind="stable")
    bounds = np.searchsorted(which[order], np.arange(len(waves) + 1))
    for k, wave in enumerate(waves):
        chosen = rows[order[bounds[k] : bounds[k + 1]]]
        yield chosen, media_of(window.bodies, float(wave))
