"""A trace in 50 decimal digits, with which the double-precision kernels are compared.

It is written from the textbook equations in the standard library's `decimal` and shares no formula and no
code with the tracer. It follows rays whose faces are already known (the cell and order from the kernel),
because the choice of the face is a question of geometry, not of rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal, localcontext
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.optics.surface import Biconic, EvenPolynomial, Quadric, Surface
from clacad.sheet.cell_places import VertexChange
from clacad.sheet.face_order import refractions
from clacad.sheet.pattern import cosine_and_sine
from clacad.sheet.window import Face, Window

Ints = NDArray[np.integer]
Vector = NDArray[np.object_]
"""Three numbers of DIGITS digits."""

DIGITS = 50
Compared = TypeVar("Compared")


@dataclass(frozen=True, slots=True)
class _Step:
    """One face of one telescopelet: the transform into its frame, and the indices on either side."""

    face: Face
    vertex: Vector
    turn: Vector | None
    before: Decimal
    after: Decimal


def direction_errors(
    window: Window, position: Floats, direction: Floats, found: Floats, cell: Ints, order: Ints
) -> Floats:
    """Angle between the exit directions of a kernel and those of the same rays in 50 digits.

    position, direction : (n, 3). Rays as launched, sheet frame.
    found : (n, 3). Exit directions of the kernel.
    cell, order : (n, 2). Lenslets the rays went through: lens 1, and lens 2 relative to it.
    Returns (n,) array, radians: NaN for a ray that misses a face in exact arithmetic though the kernel found
        a hit: undecidable within rounding.
    """
    errors = np.full(len(position), np.nan)
    for k, error in _compared(_angle, window, position, direction, found, cell, order):
        errors[k] = error
    return errors


def direction_differences(
    window: Window, position: Floats, direction: Floats, found: Floats, cell: Ints, order: Ints
) -> Floats:
    """Exit directions (n, 3) of a kernel minus those of the same rays in 50 digits; parameters as in
    `direction_errors`.

    The difference is computed in 50 digits and then rounded, so it has 16 significant digits. NaN as in
    `direction_errors`.
    """
    found_less = np.full((len(position), 3), np.nan)
    for k, less in _compared(np.subtract, window, position, direction, found, cell, order):
        found_less[k] = [float(v) for v in less]
    return found_less


def _compared(
    compare: Callable[[Vector, Vector], Compared],
    window: Window,
    position: Floats,
    direction: Floats,
    found: Floats,
    cell: Ints,
    order: Ints,
) -> list[tuple[int, Compared]]:
    """Rows that hit every face, each with `compare(direction found, exact direction)` in DIGITS digits."""
    rows = []
    with localcontext() as context:
        context.prec = DIGITS
        for k in range(len(position)):
            steps = _steps(window, cell[k], order[k])
            exact = _through(steps, _vector(position[k]), _unit(_vector(direction[k])))
            if exact is not None:
                rows.append((k, compare(_unit(_vector(found[k])), exact)))
    return rows


def _steps(window: Window, cell: Ints, order: Ints) -> list[_Step]:
    """Faces of the telescopelet of cell (2,) and order (2,), in the order of the light."""
    steps = []
    for _, face, before, after in refractions(window.bodies):
        vertex = _vector(face.vertex)
        if face.array is not None:
            # light that keeps to its pair passes its own field lens
            index = cell + order if face.array == 1 else cell
            i, j = int(index[0]), int(index[1])
            vertex = vertex + _centre(window, i, j, face.array)
            if face.change is not None:
                vertex = vertex + _moved(window, face.change, i, j)
                face = window.in_cell(face, np.array([i, j]))
        turn = None if face.untilted else np.array([_vector(column) for column in face.rotation.T])
        steps.append(_Step(face, vertex, turn, Decimal(before), Decimal(after)))
    return steps


def _centre(window: Window, i: int, j: int, array: int) -> Vector:
    """Centre of a cell of an array, exact in the lattice's own doubles."""
    lattice, (sx, sy) = window.lattice_of(array), window.shifts[array]
    px, py = (Decimal(p) for p in lattice.pitch)
    n1, n2 = lattice.count
    if lattice.hexagonal:
        x0, y0 = (Decimal(c) for c in lattice.first_centre)
        x, y = x0 + (2 * i + j) * px / 2, y0 + j * Decimal(lattice.row_height)
    else:
        x, y = (2 * i - n1 + 1) * px / 2, (2 * j - n2 + 1) * py / 2
    if lattice.turn:
        c, s = (Decimal(high) + Decimal(low) for high, low in cosine_and_sine(lattice.turn))
        x, y = c * x - s * y, s * x + c * y
    return np.array([x + Decimal(sx), y + Decimal(sy), Decimal(0)])


def _moved(window: Window, change: VertexChange, i: int, j: int) -> Vector:
    """Displacement of the lens of a cell from its face's nominal position; see `VertexChange.at`."""
    x, y, _ = _centre(window, i, j, 0)
    (xx, xy), (yx, yy) = ((Decimal(a), Decimal(b)) for a, b in change.gradient)
    moved = np.array([xx * x + xy * y, yx * x + yy * y, Decimal(0)])
    if change.table is not None:
        own = replace(change, gradient=((0.0, 0.0), (0.0, 0.0))).at(window.lattice, np.array([i, j]))
        moved[:2] += _vector(own[:2])
    along, across, climb_x, climb_y = (Decimal(s) for s in (*change.slope, *change.climb))
    lift = VertexChange(lift=change.lift).rise(window.lattice, np.array([i, j]), np.zeros(2))
    moved[2] = along * moved[0] + across * moved[1] + climb_x * x + climb_y * y + Decimal(float(lift))
    return moved


def _through(steps: Sequence[_Step], position: Vector, ray: Vector) -> Vector | None:
    """Exit direction of one ray; None where it misses a face or is totally reflected."""
    for step in steps:
        local = position - step.vertex
        if step.turn is not None:
            local, ray = step.turn @ local, step.turn @ ray
        met = _meet(step.face.surface, local, ray)
        if met is None:
            return None
        point, gradient = met
        refracted = _refracted(ray, gradient, step.before, step.after)
        if refracted is None:
            return None
        if step.turn is not None:
            point, refracted = point @ step.turn, refracted @ step.turn
        position, ray = point + step.vertex, refracted
    return ray


def _meet(surface: Surface, start: Vector, ray: Vector) -> tuple[Vector, Vector] | None:
    """Point and gradient where the ray crosses the surface near its apex plane."""
    s, cx, cy = surface.side, Decimal(surface.curvature_x), Decimal(surface.curvature_y)
    to_plane = -start[2] / ray[2]
    x, y, _ = foot = start + to_plane * ray
    kappa = Decimal(surface.kappa) if isinstance(surface, Quadric) else Decimal(0)
    # κ z² − 2 s z + cx x² + cy y² = 0 along (x, y, 0) + t ray
    a = cx * ray[0] ** 2 + cy * ray[1] ** 2 + kappa * ray[2] ** 2
    b = cx * x * ray[0] + cy * y * ray[1] - s * ray[2]
    c = cx * x * x + cy * y * y
    discriminant = b * b - a * c
    if discriminant < 0:
        return None
    t = c / (s * discriminant.sqrt().copy_sign(ray[2]) - b)
    if isinstance(surface, Quadric):
        point = foot + t * ray
        return point, np.array([0, 0, 1]) - s * np.array([cx, cy, kappa]) * point
    return _meet_height(surface, foot, ray, t)


def _meet_height(
    surface: Biconic | EvenPolynomial, start: Vector, ray: Vector, t: Decimal
) -> tuple[Vector, Vector] | None:
    for _ in range(60):
        x, y, z = point = start + t * ray
        height = _height(surface, x, y)
        if height is None:
            return None
        sag, slope_x, slope_y = height
        change = (z - sag) / (ray[2] - slope_x * ray[0] - slope_y * ray[1])
        t -= change
        if abs(change) <= abs(t) * Decimal(10) ** (4 - DIGITS):
            break
    return point, np.array([-slope_x, -slope_y, Decimal(1)])


def _height(
    surface: Biconic | EvenPolynomial, x: Decimal, y: Decimal
) -> tuple[Decimal, Decimal, Decimal] | None:
    """Sag and its two slopes: z = s (Q/(1 + w) + Σ a_ij x^2i y^2j)."""
    cx, cy = Decimal(surface.curvature_x), Decimal(surface.curvature_y)
    kx, ky = (1 + Decimal(surface.conic_x)) * cx * cx, (1 + Decimal(surface.conic_y)) * cy * cy
    inside = 1 - kx * x * x - ky * y * y
    if inside <= 0:
        return None
    w, q, s = inside.sqrt(), cx * x * x + cy * y * y, surface.side
    slopes = [
        s * (2 * c * u / (1 + w) + q * k * u / (w * (1 + w) ** 2)) for c, k, u in ((cx, kx, x), (cy, ky, y))
    ]
    if isinstance(surface, Biconic):
        return s * q / (1 + w), slopes[0], slopes[1]
    found = [s * q / (1 + w), *slopes]
    for terms in (surface.a4, surface.a6, surface.a8):
        for j, term in enumerate(terms):
            m, n, a = 2 * (len(terms) - 1 - j), 2 * j, s * Decimal(term)
            found[0] += a * _power(x, m) * _power(y, n)
            found[1] += a * m * _power(x, m - 1) * _power(y, n) if m else 0
            found[2] += a * n * _power(x, m) * _power(y, n - 1) if n else 0
    return found[0], found[1], found[2]


def _power(base: Decimal, exponent: int) -> Decimal:
    """A power, with 0⁰ = 1."""
    return base**exponent if exponent else Decimal(1)


def _refracted(ray: Vector, gradient: Vector, before: Decimal, after: Decimal) -> Vector | None:
    """Refract by Snell's law: the tangential part of n·direction is conserved."""
    normal = _unit(gradient)
    along = ray @ normal
    tangential = (ray - along * normal) * before / after
    left = 1 - tangential @ tangential
    return None if left < 0 else tangential + left.sqrt().copy_sign(along) * normal


def _angle(a: Vector, b: Vector) -> float:
    across = np.cross(a, b)
    return float(np.arctan2(float((across @ across).sqrt()), float(a @ b)))


def _vector(values: Sequence[float] | Floats) -> Vector:
    return np.array([Decimal(float(v)) for v in values])


def _unit(v: Vector) -> Vector:
    return np.asarray(v / (v @ v).sqrt())
