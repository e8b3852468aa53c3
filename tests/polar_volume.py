"""Volume of a body as designed, by a route of its own: quadrature in polar coordinates between exact rims.

To 1e-12 where `clacad.sheet.volume_and_extent.body_volume`, which halves boxes, ends at its own 1e-8 near a rim.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import fsum

import numpy as np

from clacad.base.polygons import polygon_area
from clacad.base.sign_changes import bisect, sign_changes
from clacad.base.types import Floats
from clacad.sheet.lattice import Circle
from clacad.sheet.window import Body, Face, Window, lens_height, optical_tile

_ANGLES, _RADII = 40, 24  # Gauss nodes per smooth stretch
_SAMPLES = 129  # on a ray; rims that a ray crosses twice between two of them are not seen


def exact_volume(window: Window, body: Body) -> float:
    """Volume of a body as designed, by Gauss quadrature of its exact heights (length³).

    In polar coordinates about the cell's centre: along each ray, heights are integrated between the
    exact rims; in angle, between the directions of the tile's corners and of the rims' ends.
    """
    lattice = window.lattice
    count = lattice.cell_count
    outside = _outline_area(window) - count * lattice.cell_area if window.outline is not None else 0.0
    arrays = [face.array for face in (body.front, body.back) if face.array is not None]
    if len({window.shifts[array] for array in arrays}) == 1:
        total = count * _cell_volume(window, body)
        lands = [face.vertex[2] if face.array is None else face.land for face in (body.front, body.back)]
        if lands[0] is not None and lands[1] is not None:
            total += outside * (lands[1] - lands[0])
        return float(total)
    front, back = (
        count * _face_integral(window, face) + outside * _land(face) for face in (body.front, body.back)
    )
    return float(back - front)


def _outline_area(window: Window) -> float:
    outline = window.outline
    assert outline is not None
    return np.pi * outline.diameter**2 / 4 if isinstance(outline, Circle) else outline.width * outline.height


def _land(face: Face) -> float:
    if face.land is None:
        raise ValueError("a face that reaches to an outline needs land")
    return face.land


Along = Callable[[Floats, Floats], Floats]


def _cell_volume(window: Window, body: Body) -> float:
    """Volume of one column."""
    front, back = body.front, body.back

    def lens(face: Face, x: Floats, y: Floats) -> Floats:
        return np.full(np.shape(x), face.vertex[2]) if face.array is None else lens_height(face, x, y)

    def thickness(x: Floats, y: Floats) -> Floats:
        low, high = lens(front, x, y), lens(back, x, y)
        with np.errstate(invalid="ignore"):
            material = low <= high
        if front.array is not None and front.land is not None:
            low = np.fmin(low, front.land)
        if back.array is not None and back.land is not None:
            high = np.fmax(high, back.land)
        return np.where(material, high - low, _flat_thickness(body))

    borders: list[Along] = [lambda x, y: lens(back, x, y) - lens(front, x, y)]
    for face in (front, back):
        if face.array is not None and face.land is not None:
            borders.append(partial(_above_land, face))
    total = _polar(window, thickness, borders)
    return total + _flat_thickness(body) * _ring_area(window)


def _above_land(face: Face, x: Floats, y: Floats) -> Floats:
    """Height of a lens above its land, positive where the lens is proud of it."""
    return np.asarray(face.side * (_land(face) - lens_height(face, x, y)))


def _flat_thickness(body: Body) -> float:
    """Thickness where there is no lens: land to land, or nothing."""
    levels = [face.vertex[2] if face.array is None else face.land for face in (body.front, body.back)]
    return 0.0 if levels[0] is None or levels[1] is None else levels[1] - levels[0]


def _face_integral(window: Window, face: Face) -> float:
    """Integral of one face's height over a cell."""

    def height(x: Floats, y: Floats) -> Floats:
        return lens_height(face, x, y)

    return _polar(window, height, []) + (_land(face) * _ring_area(window) if window.land.seam else 0.0)


def _ring_area(window: Window) -> float:
    """Area of a cell outside its optical zone."""
    return window.lattice.cell_area - polygon_area(optical_tile(window)) if window.land.seam else 0.0


def _polar(window: Window, integrand: Along, rims: list[Along]) -> float:
    """Integrate over the optical zone; `rims` change sign where the integrand is not smooth."""
    zone = optical_tile(window)
    noise = 64.0 * np.finfo(float).eps * max(abs(window.z_range[0]), abs(window.z_range[1]))
    nodes, weights = np.polynomial.legendre.leggauss(_ANGLES)
    ends, areas = [], []
    for a, b in zip(zone, np.roll(zone, -1, axis=0)):
        # t along the side is as good as the angle: area element = |a × b| r dr dt
        twice = float(a[0] * b[1] - a[1] * b[0])
        cuts = [0.0, 1.0]
        for rim in rims:
            cuts += sign_changes(partial(_on_line, rim, a, b), noise).tolist()
        cuts.sort()
        for start, stop in zip(cuts[:-1], cuts[1:]):
            t = start + (stop - start) * 0.5 * (nodes + 1.0)
            ends.append(a + t[:, None] * (b - a))
            areas.append(twice * 0.5 * weights * (stop - start))
    return fsum((np.concatenate(areas) * _rays(integrand, rims, np.concatenate(ends))).tolist())


def _on_line(function: Along, p: Floats, q: Floats, t: Floats) -> Floats:
    return function(p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1]))


def _rays(integrand: Along, rims: list[Along], ends: Floats) -> Floats:
    """∫ f(r·end) r dr from 0 to 1 for each ray (n, 2), piece by piece between the rims it crosses, (n,)."""
    cuts = [np.zeros(len(ends)), np.ones(len(ends))]
    for rim in rims:
        cuts += _crossings(rim, ends)
    edges = np.sort(np.stack(cuts, axis=1), axis=1)
    nodes, weights = np.polynomial.legendre.leggauss(_RADII)
    r = edges[:, :-1, None] + np.diff(edges)[:, :, None] * 0.5 * (nodes + 1.0)
    f = integrand((r * ends[:, 0, None, None]).ravel(), (r * ends[:, 1, None, None]).ravel()).reshape(r.shape)
    return np.asarray((0.5 * np.diff(edges) * np.sum(weights * r * f, axis=2)).sum(axis=1))


def _crossings(rim: Along, ends: Floats) -> list[Floats]:
    """Where each ray crosses a rim, as lists of equal length: 1 means no (further) crossing."""
    samples = np.linspace(0.0, 1.0, _SAMPLES)
    grid = samples * np.ones((len(ends), 1))
    inside = rim((grid * ends[:, :1]).ravel(), (grid * ends[:, 1:]).ravel()).reshape(grid.shape) > 0.0
    change = inside[:, 1:] != inside[:, :-1]
    ray, at = np.nonzero(change)
    direction = ends[ray]
    begins = inside[ray, at]

    def signed(t: Floats) -> Floats:
        same = (rim(t * direction[:, 0], t * direction[:, 1]) > 0.0) == begins
        return np.where(same, -1.0, 1.0)

    root = bisect(signed, samples[at], samples[at + 1])
    number = np.cumsum(change, axis=1)[ray, at] - 1
    found = []
    for n in range(int(change.sum(axis=1).max(initial=0))):
        column = np.ones(len(ends))
        column[ray[number == n]] = root[number == n]
        found.append(column)
    return found
