"""Heights of the lenses of many cells at once: integrals over each cell, steps between neighbours.

A lens's integral over its optical zone is a smooth function of its displacement and size, so that a few
hundred quadratures give those of any number of cells.

The height difference of two spheres of one radius is linear along their border, so five points on it find the
highest step. With two radii the difference is curved and is evaluated at seventeen points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.sheet.cell_places import LensPlaces
from clacad.sheet.window import Body, Face, Window, face_height, heights_of_lenses

Region = tuple[Floats, Floats, Floats]
"""A parallelogram: origin and two sides, (2,) lengths each."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
DEGREES = (8, 16)
"""Degrees, along each displacement, of the polynomials that are tried between integrals."""
TRIED = 16
"""Cells over the sheet with whose own integrals the polynomial is compared."""
AGREED = 1e-12
"""Relative difference above which every cell is integrated."""
PLACES = 64
"""Lenses whose heights are held at once."""
EVEN = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Relative positions along a border where two cells are compared."""
CLOSER = tuple(k / 16.0 for k in range(17))
"""Relative positions along a border for lenses of many sizes."""


# -- integrals -----------------------------------------------------------------------------------
def lens_integrals(
    window: Window, face: Face, zone: Sequence[Region], cells: Ints
) -> tuple[float, float] | None:
    """Sum over cells (n, 2) of the integrals of a face's height over its optical zone, and the sum's error.

    zone : parallelograms that tile it

    None where a lens has a hole there.

    The integral is a smooth function of the lens's place: for many cells it is interpolated between the
    places of a grid and compared with the integrals of some cells. Where these differ each cell is
    integrated.
    """
    places = window.lenses(face, cells)
    if places.moved is None:
        places = LensPlaces(face.vertex, np.zeros((1, 2)))
    for degree in DEGREES:
        found = _smooth_sum(face, places, zone, degree)
        if found is not None:
            return found
    made = _over_zone(face, places, zone)
    if made is None:
        return None
    each = len(cells) // len(made[0])
    return (each * float(made[0].sum()), each * float(made[1].sum()))


def _smooth_sum(
    face: Face, places: LensPlaces, zone: Sequence[Region], degree: int
) -> tuple[float, float] | None:
    """As `lens_integrals`, interpolated between lenses of a grid of places; None where that does not pay."""
    assert places.moved is not None
    if places.rotation is not None:
        return None
    changes = [one for one in (places.size, places.aspect) if one is not None]
    at = np.column_stack([places.moved, *changes])
    knots, grid = _grid_of_places(at, degree)
    if len(grid) >= len(at):
        return None
    tried = np.linspace(0, len(at) - 1, TRIED).astype(np.int64)
    tried = np.concatenate([tried, at.argmin(axis=0), at.argmax(axis=0)])
    own = np.concatenate([grid, at[tried]])
    made = _over_zone(face, LensPlaces(face.vertex, own[:, :2], 0.0, *own.T[2:]), zone)
    if made is None:
        return None
    values, errors = made
    each = _interpolated(knots, values[: len(grid)], at)
    off = float(np.abs(each[tried] - values[len(grid) :]).max())
    if off > AGREED * float(np.abs(values).max()):
        return None
    rise = sum(map(_area, zone)) * float(np.sum(places.rise))
    return (float(each.sum()) + rise, len(at) * (float(errors.max()) + off))


def _grid_of_places(at: Floats, degree: int) -> tuple[list[Floats], Floats]:
    """Knots along each column of places (n, k), and the grid (m, k) of them: its corners enclose the places.

    A column that does not vary has one knot; others have the extremes of a Chebyshev polynomial.
    """
    low, high = at.min(axis=0), at.max(axis=0)
    around = 0.5 * (1.0 - np.cos(np.arange(degree + 1) * (pi / degree)))
    knots = [a + (b - a) * around if b > a else np.array([a]) for a, b in zip(low, high, strict=True)]
    return knots, np.stack(np.meshgrid(*knots, indexing="ij"), axis=-1).reshape(-1, at.shape[1])


def _interpolated(knots: Sequence[Floats], values: Floats, at: Floats) -> Floats:
    """Values (n,) at places `at` (n, k) of the polynomial through those (m,) of the grid of `knots`."""
    found = values.reshape([len(one) for one in knots])[None]
    for one, along in zip(knots, at.T, strict=True):
        shares = np.ones((len(along), len(one)))
        for k, knot in enumerate(one):
            others = np.delete(one, k)
            shares[:, k] = np.prod((along[:, None] - others) / (knot - others), axis=1)
        found = np.einsum("nk,nk...->n...", shares, np.broadcast_to(found, (len(along), *found.shape[1:])))
    return np.asarray(found)


def _over_zone(face: Face, places: LensPlaces, zone: Sequence[Region]) -> tuple[Floats, Floats] | None:
    """Integrals of heights over an optical zone, one a place (n,), and their errors; None at a hole.

    Gauss–Legendre 8 × 8 on 4 × 4 boxes of each parallelogram; the error is the difference from 2 × 2 boxes.
    """
    assert places.moved is not None
    points, weights = _quadrature(zone)
    made = np.empty((2, len(places.moved)))
    for low in range(0, len(places.moved), PLACES):
        some = slice(low, low + PLACES)
        part = LensPlaces(
            places.vertex,
            places.moved[some, None],
            np.broadcast_to(places.rise, made[0].shape)[some, None],
            *(
                None if one is None else one[some, None]
                for one in (places.size, places.aspect, places.rotation)
            ),
        )
        heights = heights_of_lenses(face, part, *points.T[:, None])
        made[:, some] = weights @ heights.T
    if not np.isfinite(made).all():
        return None
    return made[0], np.abs(made[0] - made[1])


def _area(region: Region) -> float:
    _, u, v = region
    return abs(float(u[0] * v[1] - u[1] * v[0]))


def _quadrature(zone: Sequence[Region]) -> tuple[Floats, Floats]:
    """Points (m, 2) over a zone, and weights (2, m) of its finer and its coarser rule."""
    points, weights = [], []
    for parts in (4, 2):
        across = ((np.arange(parts)[:, None] + 0.5 * (1.0 + _NODES)) / parts).ravel()
        a, b = (one.ravel()[:, None] for one in np.meshgrid(across, across, indexing="ij"))
        weight = np.tile(0.5 * _WEIGHTS / parts, parts)
        for o, u, v in zone:
            points.append(o + a * u + b * v)
            weights.append(_area((o, u, v)) * np.outer(weight, weight).ravel())
    whole = np.concatenate(weights)
    half = sum(map(len, weights[: len(weights) // 2]))
    first = np.arange(len(whole)) < half
    return np.concatenate(points), np.stack([np.where(first, whole, 0.0), np.where(first, 0.0, whole)])


# -- steps between neighbours ----------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class OwnStep:
    """Highest step of a body (length), and the cell on the left of its border."""

    height: float
    cell: tuple[int, int]


def highest_step(window: Window, body: Body) -> OwnStep:
    """Find the highest step between neighbouring lenses of a body; 0 where land lies between them."""
    found = [_of_face(window, face) for face in (body.front, body.back) if face.array is not None]
    return max(found, key=lambda step: step.height, default=OwnStep(0.0, (0, 0)))


def _of_face(window: Window, face: Face) -> OwnStep:
    assert face.array is not None
    cells = window.lattice.cells()
    best = OwnStep(0.0, (int(cells[0, 0]), int(cells[0, 1])))
    if window.land.seam > 0.0:
        return best
    for k in range(len(window.lattice.steps) // 2):
        left = cells[window.lattice.contains(cells + np.array(window.lattice.steps[k]))]
        if not len(left):
            continue
        apart = _across(window, face, left, k)
        worst = int(np.nanargmax(np.where(np.isnan(apart), -1.0, apart)))
        if apart[worst] > best.height:
            best = OwnStep(float(apart[worst]), (int(left[worst, 0]), int(left[worst, 1])))
    return best


def greatest_steps(window: Window, face: Face, index: Ints) -> Floats:
    """Greatest step (n,), lengths, of a face from cells `index` (n, 2) to kept neighbours; 0 across land."""
    made = np.zeros(len(index))
    if face.array is None or window.land.seam > 0.0:
        return made
    for k, step in enumerate(window.lattice.steps):
        inner = np.flatnonzero(window.lattice.contains(index + np.array(step)))
        if len(inner):
            made[inner] = np.fmax(made[inner], _across(window, face, index[inner], k))
    return made


def closed_volume(window: Window, face: Face, most: float) -> float:
    """Volume (length³) that a flux integral over a face loses with the walls of steps up to `most` (length).

    A kernel integrates x·n/3 over the faces of a solid. A wall of height h at the distance x·n from the
    origin adds its area times that distance; where the step is closed instead, that part is missing.
    """
    lost, cells = 0.0, window.lattice.cells()
    if face.array is None or window.land.seam > 0.0:
        return lost
    lattice = window.lattice_of(face.array)
    tile, m = lattice.tile(), len(lattice.steps)
    for k in range(m // 2):
        left = cells[window.lattice.contains(cells + np.array(lattice.steps[k]))]
        rise = _differences(window, face, left, k)
        along = tile[(k + 1) % m] - tile[k]
        normal = np.array([along[1], -along[0]])  # as long as the border
        towards = np.copysign(1.0, float(normal @ np.asarray(lattice.offset(*lattice.steps[k]))))
        apart = (window.centres(face.array, left) + tile[k]) @ normal * towards
        flux = np.where(np.abs(rise).max(axis=1) <= most, rise.mean(axis=1) * apart / 3.0, 0.0)
        lost -= face.side * float(np.nansum(flux))
    return lost


def _across(window: Window, face: Face, left: Ints, k: int) -> Floats:
    """Step (n,), lengths, from cells `left` (n, 2) to neighbours across border k; NaN at a hole."""
    return np.asarray(np.abs(_differences(window, face, left, k)).max(axis=1))


def _differences(window: Window, face: Face, left: Ints, k: int) -> Floats:
    """Heights (n, p), lengths, of cells `left` (n, 2) over those of their neighbours along border k."""
    assert face.array is not None
    lattice = window.lattice_of(face.array)
    tile, m = lattice.tile(), len(lattice.steps)
    right = left + np.array(lattice.steps[k])
    at = CLOSER if window.many_sizes else EVEN
    one = _along(tile[k], tile[(k + 1) % m], at)
    other = _along(tile[(k + m // 2 + 1) % m], tile[(k + m // 2) % m], at)
    return np.asarray(_heights(window, face, left, one) - _heights(window, face, right, other))


def _along(start: Floats, end: Floats, at: tuple[float, ...]) -> Floats:
    """Points (n, 2) on a border at the relative positions `at` (n), cell frame."""
    t = np.array(at)[:, None]
    return np.asarray((1.0 - t) * start + t * end)


def _heights(window: Window, face: Face, cells: Ints, places: Floats) -> Floats:
    """Heights (cells, places) of a face over points (p, 2) of cells (c, 2)."""
    found = face_height(window, face.simplified, places[None, :, 0], places[None, :, 1], cells[:, None])
    return np.broadcast_to(found, (len(cells), len(places)))
