"""Reference values for written files: heights, volumes and extents computed from the design's own surfaces.

This module uses no mesh and no solid: only heights of `clacad.sheet.window` and quadrature.

Gaps between bodies, and the exception that every fixture may raise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import inf, pi

import numpy as np
from numpy.typing import NDArray

from clacad.base.polygons import polygon_area
from clacad.base.types import Floats, Ints
from clacad.sheet.cell_places import CellPlacement
from clacad.sheet.face_order import plates_of
from clacad.sheet.lattice import Circle, Rectangle, half_sizes
from clacad.sheet.plate import Plate
from clacad.sheet.window import Body, Face, Window, column, face_height, heights_of_lenses, optical_tile

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
DEPTH = 9
"""Levels of subdivision at a rim: relative error 1e-8 or less in half a second;
11 levels give 1e-9 in four seconds.
"""

EDGE_DEPTH = 5

Height = Callable[[Floats, Floats], Floats]


# -- volume --------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class Integral:
    """A volume and the error estimate of its quadrature, design units cubed."""

    value: float
    error: float


def body_volume(window: Window, body: Body, depth: int = DEPTH) -> Integral | None:
    """Volume of a body by quadrature of its columns; None where its outline cuts through lenslets.

    Gauss–Legendre 8 × 8 on parallelograms that tile the optical zone of one cell, subdivided where two levels
    differ (rims, webs). Land and border are prisms. On a uniform sheet one cell represents all.
    """
    if not window.uniform:
        return _volume_cell_by_cell(window, body)
    cells = window.lattice.cell_count
    whole = _footprint_area(window, body)
    if whole is None:
        return None
    land_area = whole - cells * window.lattice.cell_area
    if _in_columns(body):
        one = _cell_integral(window, partial(_thickness, window, body), depth)
        land = _land_thickness(body) * max(0.0, land_area)
        return Integral(cells * one.value + land, cells * one.error)
    value = error = 0.0
    for face, sign in ((body.back, 1.0), (body.front, -1.0)):
        one = _cell_integral(window, partial(_filled, window, face), depth)
        value += sign * (cells * one.value + (face.land or 0.0) * max(0.0, land_area))
        error += cells * one.error
    return Integral(value, error)


def _volume_cell_by_cell(window: Window, body: Body) -> Integral | None:
    """Volume of a body of a non-uniform sheet without rims: the columns of its back minus those of its front.

    None where a lens ends inside its cell, at its rim or where front and back intersect.
    """
    from clacad.sheet.cell_heights import lens_integrals

    outline, cells = window.outline, window.lattice.cells()
    if body.columnar and _meets_itself(window, body, cells):
        return None
    array = body.arrays[0]
    whole = len(cells) * window.lattice_of(array).cell_area if outline is None else _area(outline)
    value = error = 0.0
    for face, sign in ((body.back, 1.0), (body.front, -1.0)):
        if face.array is None:
            value += sign * face.vertex[2] * whole
            continue
        zone = optical_tile(window, face.array)
        lenses = len(cells) * abs(polygon_area(zone))
        found = lens_integrals(window, face, _parallelograms(zone), cells)
        if found is None:
            return None
        value += sign * (found[0] + (face.land or 0.0) * max(0.0, whole - lenses))
        error += found[1] + 1e-15 * abs(value)
    return Integral(value, error)


def _meets_itself(window: Window, body: Body, cells: Ints) -> bool:
    """Whether a column's back lies below its front in a cell (n, 2): convex faces do at a corner first."""
    low, high = (_at_corners(window, face, cells) for face in (body.front, body.back))
    return bool((high < low).any())


def _at_corners(window: Window, face: Face, cells: Ints) -> Floats:
    """Heights (n, m) of a face at the m corners of its optical zone in cells (n, 2)."""
    assert face.array is not None
    places = window.lenses(face, cells[:, None])
    return heights_of_lenses(face, places, *optical_tile(window, face.array).T[:, None])


def grams(body: Body, cubic: float) -> float | None:
    """Mass (g) of a body of a volume in mm³; None where the density of its material is not known."""
    density = None if body.material is None else body.material.density_kg_m3
    return None if density is None else cubic * density * 1e-6


def volume_sum(integrals: Mapping[str, Integral | None], names: Sequence[str]) -> Integral | None:
    """Total volume of several bodies; None if one of the volumes is not known."""
    value = error = 0.0
    for name in names:
        part = integrals[name]
        if part is None:
            return None
        value, error = value + part.value, error + part.error
    return Integral(value, error)


def _in_columns(body: Body) -> bool:
    """Whether one tiling cuts the body into columns: both faces on one array, or one face a plane."""
    return body.columnar or None in (body.front.array, body.back.array)


def _footprint_area(window: Window, body: Body) -> float | None:
    """Area of a body seen along z; None if its outline does not contain all of its cells."""
    outline = window.outline
    if outline is None:
        return window.lattice.cell_count * window.lattice.cell_area
    shifts = {
        face.array: window.shifts[face.array] for face in (body.front, body.back) if face.array is not None
    }
    if len(shifts) == 2 and len(set(shifts.values())) == 2 and not isinstance(outline, Plate):
        x0, x1, y0, y1 = window.lattice.extent()
        corner = (
            max(abs(x + dx) for x in (x0, x1) for dx, _ in shifts.values()),
            max(abs(y + dy) for y in (y0, y1) for _, dy in shifts.values()),
        )
        if not _holds(outline, *corner):
            return None
    return _area(outline)


def _area(outline: Circle | Rectangle | Plate) -> float:
    if isinstance(outline, Plate):
        return outline.area
    if isinstance(outline, Circle):
        return 0.25 * pi * outline.diameter**2
    return outline.width * outline.height


def _holds(outline: Circle | Rectangle, x: float, y: float) -> bool:
    if isinstance(outline, Circle):
        return bool(np.hypot(x, y) <= 0.5 * outline.diameter)
    return x <= 0.5 * outline.width * (1 + 1e-9) and y <= 0.5 * outline.height * (1 + 1e-9)


def _thickness(window: Window, body: Body, x: Floats, y: Floats) -> Floats:
    front, back = column(window, body, x, y)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(back > front, back - front, 0.0))


def _land_thickness(body: Body) -> float:
    front, back = (face.vertex[2] if face.array is None else face.land for face in (body.front, body.back))
    return 0.0 if front is None or back is None else max(0.0, back - front)


def _filled(window: Window, face: Face, x: Floats, y: Floats) -> Floats:
    z = face_height(window, face, x, y)
    return np.asarray(np.where(np.isfinite(z), z, 0.0))


def _cell_integral(window: Window, height: Height, depth: int) -> Integral:
    """Integrate height(x, y) over one cell, including the seam around the optical zone."""
    value = error = 0.0
    tile, zone = window.lattice.tile(), optical_tile(window)
    regions = _parallelograms(zone)
    if window.land.seam > 0.0:
        m = len(tile)
        for k in range(m):  # trapezoids of flat land: any rule is exact; two triangles each
            a, b, c, d = zone[k], zone[(k + 1) % m], tile[(k + 1) % m], tile[k]
            area = sum(abs(polygon_area(np.stack(three))) for three in ((a, d, c), (a, c, b)))
            middle = 0.25 * (a + b + c + d)
            value += area * float(height(middle[:1], middle[1:])[0])
    for region in regions:
        part = _adaptive(height, *region, depth)
        value, error = value + part.value, error + part.error
    return Integral(value, error)


def _parallelograms(polygon: Floats) -> list[tuple[Floats, Floats, Floats]]:
    """Cut a rectangle (1) or a regular hexagon (3 rhombi) into parallelograms: origin and two sides."""
    if len(polygon) == 4:
        return [(polygon[3], polygon[0] - polygon[3], polygon[2] - polygon[3])]
    centre = np.zeros(2)
    return [(centre, polygon[k] - centre, polygon[(k + 2) % 6] - centre) for k in (0, 2, 4)]


def _adaptive(height: Height, origin: Floats, u: Floats, v: Floats, depth: int) -> Integral:
    """Integrate over a parallelogram; a box unlike the sum of its quarters is quartered again."""
    scale = abs(float(u[0] * v[1] - u[1] * v[0]))
    boxes = np.array([[0.0, 0.0]])
    coarse = _rule(height, origin, u, v, boxes, 1.0)
    total, error = 0.0, 0.0
    size = 1.0
    reference = float(np.abs(coarse).sum()) or 1.0
    for level in range(depth):
        size *= 0.5
        quarters = (boxes[:, None] + size * np.array([[0, 0], [1, 0], [0, 1], [1, 1]])).reshape(-1, 2)
        fine = _rule(height, origin, u, v, quarters, size).reshape(-1, 4)
        gap = np.abs(fine.sum(axis=1) - coarse)
        # A smooth box agrees to rounding error; each settled box adds an error of at most 1e-13 of the whole.
        settled = (gap <= 1e-13 * reference) & ~_suspect(boxes, 2.0 * size, level)
        if level == depth - 1:
            total += float(fine.sum())
            error += float(gap[~settled].sum())
            break
        total += float(fine[settled].sum())
        error += float(gap[settled].sum())
        if settled.all():
            break
        boxes, coarse = quarters.reshape(-1, 4, 2)[~settled].reshape(-1, 2), fine[~settled].reshape(-1)
    return Integral(total * scale, error * scale)


def _suspect(boxes: Floats, size: float, level: int) -> NDArray[np.bool_]:
    """Boxes that are always quartered: a lens may miss a sliver of a border, or the tip of a corner."""
    touches = (boxes <= 0.0) | (boxes + size >= 1.0 - 1e-12)
    return np.asarray(touches.all(axis=1) | (touches.any(axis=1) & (level < EDGE_DEPTH)))


def _rule(height: Height, origin: Floats, u: Floats, v: Floats, boxes: Floats, size: float) -> Floats:
    """8 × 8 Gauss integrals over boxes (k, 2) of the given size in the unit square, (k,)."""
    t = 0.5 * size * (1.0 + _NODES)
    s, r = np.meshgrid(t, t, indexing="ij")
    a = boxes[:, 0, None] + s.ravel()
    b = boxes[:, 1, None] + r.ravel()
    x = origin[0] + a * u[0] + b * v[0]
    y = origin[1] + a * u[1] + b * v[1]
    values = height(x.ravel(), y.ravel()).reshape(a.shape)
    weight = 0.25 * size * size * np.outer(_WEIGHTS, _WEIGHTS).ravel()
    return np.asarray(values @ weight)


# -- extent and heights --------------------------------------------------------------------------
def body_extent(window: Window, body: Body) -> tuple[float, float, float, float]:
    """Bounding box (x_min, x_max, y_min, y_max) of a body seen along z, design units."""
    own = len(body.arrays) == 1 and not window.one_outline
    place = window.placements[body.arrays[0]] if own else CellPlacement()
    dx, dy = place.shift
    if isinstance(window.outline, Plate):
        return window.outline.box
    if window.outline is None:
        return place.extent(window.lattice)
    w, h = half_sizes(window.outline)
    return dx - w, dx + w, dy - h, dy + h


def whole_extent(window: Window) -> tuple[float, float, float, float]:
    """Bounding box of all bodies seen along z, design units."""
    boxes = np.array([body_extent(window, body) for body in window.bodies])
    return (
        float(boxes[:, 0].min()),
        float(boxes[:, 1].max()),
        float(boxes[:, 2].min()),
        float(boxes[:, 3].max()),
    )


def least_extent(window: Window) -> tuple[float, float, float, float]:
    """Bounding box (x_min, x_max, y_min, y_max) that the material reaches, seen along z, design units.

    It is smaller than `whole_extent` where lenses without land end inside their cells.
    """
    whole = whole_extent(window)
    if window.outline is not None:
        return whole
    tile = window.lattice.tile()
    low, high = tile.min(axis=0), tile.max(axis=0)
    x, y = (g.ravel() for g in np.meshgrid(*(np.linspace(low[k], high[k], 129) for k in (0, 1))))
    ends = np.array([np.inf, -np.inf, np.inf, -np.inf])
    for body in window.bodies:
        if not _in_columns(body):
            return whole
        front, back = column(window, body, x, y)
        solid = np.isfinite(front) & (front <= back)
        if not solid.any():
            continue
        cut = np.array(
            [
                x[solid].min() - low[0],
                x[solid].max() - high[0],
                y[solid].min() - low[1],
                y[solid].max() - high[1],
            ]
        )
        box = np.array(body_extent(window, body)) + cut
        ends = np.where([True, False, True, False], np.minimum(ends, box), np.maximum(ends, box))
    return float(ends[0]), float(ends[1]), float(ends[2]), float(ends[3])


def distance_to_face(window: Window, face: Face, points: Floats, inside: Floats) -> Floats:
    """Vertical distance of points to the surfaces of a face: its lens and its land.

    points : (n, k, 3) array, design units. Sheet frame.
    inside : (n, 2) array. A point of each group's own cell; all k points are compared with that cell's lens,
        so that points on a border are compared with the right neighbour.
    Returns (n, k) array: Infinite where the face has neither lens nor land.
    """
    if face.array is None:
        return distance_in_cell(window, face, points, np.zeros((len(points), 2), dtype=np.int64))
    shift = window.shifts[face.array]
    index, _, _ = window.lattice_of(face.array).locate(inside[:, 0] - shift[0], inside[:, 1] - shift[1])
    return distance_in_cell(window, face, points, index)


def distance_in_cell(window: Window, face: Face, points: Floats, index: Ints) -> Floats:
    """Vertical distance (n, k) of points (n, k, 3) to a face in known cells (n, 2) of its array."""
    if face.array is None:
        return np.asarray(np.abs(points[..., 2] - face.vertex[2]))
    above = height_above(window, face, points, index[:, None])
    return np.where(np.isnan(above), inf, np.abs(above))


def height_above(window: Window, face: Face, points: Floats, cells: Ints) -> Floats:
    """Height (...) of points (..., 3) above the design's lens or land in their cells (..., 2), whichever is
    nearer.

    NaN where the design has neither.
    """
    assert face.array is not None
    local = points[..., :2] - window.centres(face.array, cells)
    lens = heights_of_lenses(face, window.lenses(face, cells), local[..., 0], local[..., 1])
    above = np.where(window.lattice.contains(cells), points[..., 2] - lens, np.nan)
    if face.land is None:
        return above
    land = points[..., 2] - face.land
    return np.where(~(np.abs(above) <= np.abs(land)), land, above)


FIELD = 2
"""Index of the array of a field lens; lens 1 and lens 2 have 0 and 1."""


class NoFixture(ValueError):
    """The window leaves no room for the fixture; exit status 2."""

    exit_status = 2


def plates_apart(window: Window, what: str) -> tuple[tuple[Body, ...], ...]:
    """Bodies of each plate, in the order light reaches them.

    Raises NoFixture: The window is one plate.
    """
    plates = plates_of(window.bodies)
    if len(plates) < 2:
        kind = "plate of several glasses" if len(window.bodies) > 1 else "slab"
        raise NoFixture(f"a {what} lies between two arrays; {window.name} is one {kind}")
    return plates


def plane_of(body: Body, side: int) -> float:
    """Height (length) of the flat that a fixture touches: land or plane of a body's back (+1) or front (−1).

    Raises NoFixture: The body has no flat there.
    """
    face = body.back if side > 0 else body.front
    if face.array is None:
        return face.vertex[2]
    if face.land is None:
        raise NoFixture(
            f"{body.name} has no flat border to be held by: give body.border a width, so that a plate runs"
            " round the lenslets"
        )
    return face.land
