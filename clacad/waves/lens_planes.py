"""Waves through ideal thin lenses with rims, plane by plane: band-limited angular spectrum.

*Frame.* x is measured from the chief ray, the ray of the incident direction through the middle of the first
lens. Phases are relative to the wave that the chief ray carries along: a decentred lens deflects that ray,
and only the remainder bends the wave. So the grid is independent of the angle of incidence. The far field is
centred on the chief ray's exit, which is the law's, and slopes add as in thin lenses (t' = t − x/f).

*Law.* Fresnel's propagation, exp(−iπλ z ν²), without the waves that would leave the grid on the way
(Matsushima & Shimobaba, Opt. Express 17, 19662 (2009)). Axes are coupled by the rims alone: cells along the
lens axes are computed axis by axis, others on a square grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, hypot, inf, isfinite

import numpy as np

from clacad.base.polygons import polygon_area
from clacad.base.types import Floats
from clacad.storage.errors import LimitRefused
from clacad.waves.exit_pupil import Complex

MOST = 4096
"""Largest number of points along each side of a square grid; a single axis may have MOST² points."""

FEWEST = (256, 128)
"""Fewest points across the first rim, in one dimension and in two, to resolve it and its diffraction."""

ROOM = (16.0, 12.0)
"""Width of the grid over the half width of its content, in one dimension and in two.

Wider grids change the share by 1e-4 and the width of the far field by a thousandth.
"""


@dataclass(frozen=True, eq=False)
class LensPlane:
    """A thin lens with a rim.

    distance : length. From the plane before it.
    power : (dims,) 1/length
    vertex : (dims,) lengths. Lens centre relative to the axis through the centre of the first lens.
    stop : (m, dims) lengths. Corners of the convex rim relative to that axis; the two ends in one dimension.
    """

    distance: float
    power: tuple[float, ...]
    vertex: tuple[float, ...]
    stop: Floats


@dataclass(frozen=True, eq=False)
class Emerging:
    """The wave that leaves the last plane.

    field : complex array of `dims` dimensions
        Relative to the wave of the chief ray, at the points inside the last rim of a grid of `spacing`.
    spacing : length
    share : Share of the light through the first rim.
    points : (dims,) int. Number of points of the whole grid.
    """

    field: Complex
    spacing: float
    share: float
    points: tuple[int, ...]


def telescope(
    focal: tuple[Sequence[float], Sequence[float]],
    centre: Sequence[float],
    vertex: Sequence[float],
    separation: float,
    zone: Floats,
    rim: Floats | None = None,
    *,
    field_lens: bool = False,
) -> list[LensPlane]:
    """The planes of a confocal pair, along one axis or two.

    focal : (f1, f2), (dims,) lengths each
    centre, vertex : (dims,) lengths
        Middle of the partner cell, and centre of lens 2, from the axis of lens 1.
    separation : length
    zone : (m, dims) lengths. Rim of lens 1, and of a field lens, relative to the middle of its own cell.
    rim : (m, dims) lengths or None. Of lens 2; None: as `zone`.
    field_lens : Add one: 1/f = 1/f1 + 1/f2 at the common focus, its cells on the lines from cell to partner.
    Raises ValueError: A field lens where the focus is virtual or not common, or where an axis has no power.
    """
    power = [tuple(0.0 if not isfinite(f) else 1.0 / f for f in one) for one in focal]
    first = LensPlane(0.0, power[0], (0.0,) * len(centre), zone)
    middle, apex = tuple(map(float, centre)), tuple(map(float, vertex))
    last = LensPlane(separation, power[1], apex, (zone if rim is None else rim) + np.asarray(middle))
    if not field_lens:
        return [first, last]
    depth = _focus(focal)
    own = tuple(depth / separation * c for c in middle)
    between = LensPlane(depth, tuple(a + b for a, b in zip(*power, strict=True)), own, zone + np.asarray(own))
    return [first, between, replace(last, distance=separation - depth)]


def _focus(focal: tuple[Sequence[float], Sequence[float]]) -> float:
    """Distance of the common focus, where a field lens can be, from lens 1; see `telescope`."""
    depth = focal[0][0]
    if not all(isfinite(f) and f > 0.0 for one in focal for f in one):
        raise ValueError(
            "a field lens needs a real focus between the lenses: f1 and f2 above 0, so eta below 0 in each"
            " axis"
        )
    if any(abs(f - depth) > 1e-9 * depth for f in focal[0]):
        raise ValueError(
            "the foci of both axes lie at different depths: a field lens is a pair of crossed cylinders there"
        )
    return depth


def chief_ray(planes: Sequence[LensPlane], slope: Sequence[float]) -> tuple[list[Floats], Floats]:
    """Points (dims,), lengths, where the chief ray of an incident slope (dims,) crosses each plane.

    The second result is its exit slope (dims,).
    """
    place, ray, met = np.zeros(len(slope)), np.asarray(slope, dtype=np.float64), []
    for plane in planes:
        place = place + plane.distance * ray
        ray = ray - (place - np.asarray(plane.vertex)) * np.asarray(plane.power)
        met.append(place)
    return met, ray


@dataclass(frozen=True)
class Grid:
    """A regular grid: points along each axis, spacing (length)."""

    points: int
    spacing: float

    @property
    def places(self) -> Floats:
        """(points,) lengths, symmetric about 0."""
        return np.asarray((np.arange(self.points) + 0.5 - 0.5 * self.points) * self.spacing)


def grid_for(planes: Sequence[LensPlane], slope: Sequence[float], wavelength: float) -> Grid:
    """The coarsest grid on which the phase changes by at most a quarter turn between neighbours.

    slope : (dims,)
    wavelength : length
    Raises LimitRefused: More points than the limit `MOST` allows; the message gives the number needed.
    """
    dims, reach, finest = len(slope), 0.0, inf
    met, _ = chief_ray(planes, slope)
    beam = ray_box(planes)
    for plane, place, lit in zip(planes, met, beam, strict=True):
        rim = np.abs(plane.stop - place).max(axis=0)
        reach = max(reach, float(rim.max()), float(lit.max()))
        steep = float((rim * np.abs(plane.power)).max())
        finest = min(finest, wavelength / (4.0 * steep) if steep > 0.0 else inf)
    side = float(np.ptp(planes[0].stop, axis=0).max())
    across = max(FEWEST[dims - 1], ceil(side / finest))
    across += across % 2  # so that a rim along the axes falls between points
    points = _rounded(ceil(ROOM[dims - 1] * reach / side * across))
    spacing = side / across
    most = MOST**2 if dims == 1 else MOST
    if points > most:
        power = "" if dims == 1 else f" x {points}"
        allowed = f"{most}" if dims == 1 else f"{most} x {most}"
        raise LimitRefused(
            f"waves through this pair need a grid of {points}{power} points (phase steps of a quarter turn),"
            f" and {allowed} are computed: a smaller pitch, a longer wavelength or a larger separation needs"
            " fewer; at such Fresnel numbers rays give the same"
        )
    return Grid(points, spacing)


def _rounded(count: int) -> int:
    """The next number with a fast transform: three binary digits, then zeros."""
    step = 1 << max(0, count.bit_length() - 3)
    return -(-count // step) * step


def ray_box(planes: Sequence[LensPlane]) -> list[Floats]:
    """Half widths (dims,), lengths, of the beam of rays about its chief ray at each plane."""
    height = np.abs(planes[0].stop).max(axis=0)
    slope, found = np.zeros_like(height), []
    for plane in planes:
        height = height + plane.distance * slope
        slope = slope - height * np.asarray(plane.power)
        found.append(np.abs(height))
    return found


def propagate(
    planes: Sequence[LensPlane], slope: Sequence[float], wavelength: float, grid: Grid | None = None
) -> Emerging:
    """Send a plane wave through lenses with rims.

    planes : All in one dimension, or all in two.
    slope : (dims,). Of the incident wave.
    wavelength : length
    grid : None: the coarsest sufficient grid.
    Raises LimitRefused.
    """
    grid = grid_for(planes, slope, wavelength) if grid is None else grid
    met, _ = chief_ray(planes, slope)
    field: Complex = np.ones((grid.points,) * len(slope), dtype=np.complex128)
    begun = 0.0
    for k, (plane, place) in enumerate(zip(planes, met, strict=True)):
        if plane.distance:
            field = _travel(field, grid, plane.distance, wavelength)
        inside = coverage(plane.stop - place, grid)
        if k == 0:
            begun = float(
                inside.sum()
            )  # the rim's own area, independent of the light at its discretised edges
        if k == len(planes) - 1:
            share = float((inside * np.abs(field) ** 2).sum()) / begun
        field = field * inside
        for axis, power in enumerate(plane.power):
            bend = np.exp(-1j * np.pi * power / wavelength * grid.places**2)
            field = field * _along(bend, axis, field.ndim)
    lit = np.ix_(*(np.flatnonzero(_any_across(inside, axis)) for axis in range(inside.ndim)))
    return Emerging(field[lit], grid.spacing, share, field.shape)


def _any_across(values: Floats, axis: int) -> Floats:
    """Largest value (n,) at each point along one axis."""
    others = tuple(k for k in range(values.ndim) if k != axis)
    return np.asarray(values.max(axis=others)) if others else values


def _travel(field: Complex, grid: Grid, distance: float, wavelength: float) -> Complex:
    """The wave after a distance, without frequencies that would re-enter from the other side of the grid."""
    frequency = np.fft.fftfreq(grid.points, grid.spacing)
    stays = np.abs(wavelength * distance * frequency) <= 0.25 * grid.points * grid.spacing
    step = np.where(stays, np.exp(-1j * np.pi * wavelength * distance * frequency**2), 0.0)
    for axis in range(field.ndim):
        field = np.fft.ifft(np.fft.fft(field, axis=axis) * _along(step, axis, field.ndim), axis=axis)
    return field


def _along(values: Complex, axis: int, dims: int) -> Complex:
    """Values (n,) laid along one axis of an array of `dims` dimensions."""
    return values.reshape([-1 if k == axis else 1 for k in range(dims)])


def coverage(stop: Floats, grid: Grid) -> Floats:
    """Share of each grid point's square (or length) that lies inside a convex rim (m, dims)."""
    x, step = grid.places, grid.spacing
    if stop.shape[1] == 1:
        low, high = float(stop.min()), float(stop.max())
        within = np.minimum(x + 0.5 * step, high) - np.maximum(x - 0.5 * step, low)
        return np.asarray(np.clip(within / step, 0.0, 1.0))
    # depth inside each border, in points: exact but at corners, where up to half of the last point is
    # uncertain
    corners = stop if polygon_area(stop) > 0.0 else stop[::-1]
    found = np.ones((grid.points, grid.points))
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        inwards = ((x1 - x0) * (x - y0)[None, :] - (y1 - y0) * (x - x0)[:, None]) / hypot(x1 - x0, y1 - y0)
        np.minimum(found, np.clip(inwards / step + 0.5, 0.0, 1.0), out=found)
    return found
