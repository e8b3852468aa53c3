"""Pupil method: exit points and phases of a telescopelet's light by exact trace, and its far field.

A plane wave is incident on lens 1 of one cell on a regular grid. Every ray that leaves through the partner is
carried on to one plane across the law's direction. Its optical path from a wave front of the incident light
gives its phase, and the spread of the neighbouring rays its amplitude. Fraunhofer's integral over that plane
is the far field. Rays do not arrive on a grid: each is distributed over the four grid points around it, and
the transform is divided by that of the distribution (the type-1 transform of Dutt & Rokhlin, SIAM J. Sci.
Comput. 14, 1368 (1993), with a triangle as the kernel).

The far field of one telescopelet along each lens axis, and its widths.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, log2, pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Floats, Ints, Pair2
from clacad.optics.rays import Fate, Rays
from clacad.sheet.bundle import bundle, launched
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.window import Window, in_optical_tile
from clacad.storage.errors import LimitRefused
from clacad.tracing.layout import lay_out
from clacad.tracing.trace import trace

Complex = NDArray[np.complex128]

FINE = 16
"""Fewest points of a far field per λ/w: half-maximum points are then accurate to a thousandth of it."""


@dataclass(frozen=True, eq=False)
class Marginal:
    """Light against the angle off the law along a lens axis: summed over the other, or cut through the peak.

    off : (k,) radians. Direction cosine less that of the law, evenly spaced, ascending.
    density : (k,) 1/radian. Its integral is 1.
    """

    off: Floats
    density: Floats

    @property
    def half_maximum(self) -> Pair2:
        """Angles at which the density falls to half its peak on either side, radians."""
        peak = int(np.argmax(self.density))
        half = 0.5 * self.density[peak]
        left, right = self.density[: peak + 1], self.density[peak:]
        low, high = np.flatnonzero(left < half), np.flatnonzero(right < half)
        i = int(low[-1]) if len(low) else 0
        j = peak + (int(high[0]) if len(high) else len(right) - 1)
        return self._crossing(i, half), self._crossing(j - 1, half)

    def _crossing(self, k: int, level: float) -> float:
        """Angle at which the line from point k to the next one has a given density."""
        a, b = self.density[k], self.density[k + 1]
        part = (level - a) / (b - a) if b != a else 0.0
        return float(self.off[k] + part * (self.off[k + 1] - self.off[k]))

    @property
    def middle(self) -> float:
        """Middle between the half-maximum points, radians off the law."""
        low, high = self.half_maximum
        return 0.5 * (low + high)

    @property
    def width(self) -> float:
        """Full width at half maximum, radians."""
        low, high = self.half_maximum
        return high - low

    @property
    def half_energy(self) -> float:
        """Width from the first to the third quartile: .544 λ/w behind a slit of width w; radians."""
        step = self.off[1] - self.off[0]
        risen = np.cumsum(self.density) * step
        low, high = np.interp((0.25 * risen[-1], 0.75 * risen[-1]), risen, self.off + 0.5 * step)
        return float(high - low)


@dataclass(frozen=True, eq=False)
class FarField:
    """Far field of one telescopelet in one direction.

    way : "pupil" or "angular spectrum"
    marginals : (Marginal, Marginal). Along lens x and lens y, summed over the other axis.
    sections : (Marginal, Marginal). Along lens x and lens y through the brightest direction. Equal to
        `marginals` for a cell with sides along the lens axes.
    strehl : Peak over that of the light through the partner with a flat wave front: at most 1.
    points : Number of rays along a side, or of points along each axis.
    """

    way: str
    marginals: tuple[Marginal, Marginal]
    sections: tuple[Marginal, Marginal]
    strehl: float
    points: tuple[int, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON: numbers along lens x and y, radians."""
        return {
            "way": self.way,
            "strehl": self.strehl,
            "points": list(self.points),
            "middle_off_law": [one.middle for one in self.marginals],
            "fwhm": [one.width for one in self.marginals],
            "fwhm_through_peak": [one.width for one in self.sections],
            "half_energy": [one.half_energy for one in self.marginals],
        }


def marginal(field: Complex, axis: int, spacing: float, wavelength: float, width: float) -> Marginal:
    """Far field along one axis of an amplitude on a regular grid, summed over the other axis.

    field : (n,) or (n, n) complex. Relative to a flat wave front across the law's direction.
    spacing, wavelength, width : lengths
        Of the grid; of the light; of the lit area, which determines the resolution.

    Notes
    -----
    By Parseval's theorem only `axis` need be transformed: ∫ |E(ν_x, ν_y)|² dν_y = ∫ |E(ν_x, y)|² dy.
    """
    n = field.shape[axis]
    fine = 1 << int(np.ceil(np.log2(max(n, FINE * width / spacing))))
    light = np.abs(np.fft.fftshift(np.fft.fft(field, fine, axis=axis), axes=axis)) ** 2
    total = light if field.ndim == 1 else light.sum(axis=1 - axis)
    off = np.fft.fftshift(np.fft.fftfreq(fine, spacing)) * wavelength
    return Marginal(off, total / (total.sum() * (off[1] - off[0])))


def section(
    field: Complex, axis: int, turns: Sequence[float], spacing: float, wavelength: float, width: float
) -> Marginal:
    """Far field of an amplitude on a regular grid (n, n) along an axis, through the `brightest` direction."""
    other = 1 - axis
    wave = np.exp(-2j * np.pi * turns[other] * np.arange(field.shape[other]))
    return marginal(np.tensordot(field, wave, axes=(other, 0)), 0, spacing, wavelength, width)


def flatness(field: Complex) -> float:
    """Peak of a far field over that of an equal amplitude with a flat wave front; at most 1."""
    return min(brightest(field)[0] / float(np.abs(field).sum()) ** 2, 1.0)  # rounding


def brightest(field: Complex) -> tuple[float, tuple[float, ...]]:
    """Largest |Σ field|² over all directions of a pupil on a regular grid, and its direction.

    The largest point of the fast transform is refined on a finer grid. The direction is given in turns per
    grid point, one number for each axis.
    """
    dims = field.ndim
    size = [1 << int(np.ceil(np.log2(2 * n))) for n in field.shape]
    whole = np.abs(np.fft.fftn(field, size, axes=tuple(range(dims))))
    at = np.unravel_index(int(np.argmax(whole)), whole.shape)
    near, tried = field, []
    for axis in range(dims):
        # points a tenth of a bin apart, within one bin about the best one
        tried.append((at[axis] + np.linspace(-1.0, 1.0, 21)) / size[axis])
        wave = np.exp(-2j * np.pi * np.outer(tried[axis], np.arange(field.shape[axis])))
        near = np.moveaxis(np.tensordot(wave, near, axes=(1, axis)), 0, axis)
    best = np.unravel_index(int(np.argmax(np.abs(near))), near.shape)
    return float(np.abs(near[best])) ** 2, tuple(
        float(turns[k]) for turns, k in zip(tried, best, strict=True)
    )


MOST = 4096
"""Largest number of rays along each side of a cell."""

FEWEST = 256
"""Least number of rays along each side of a cell, enough to resolve the rim of the lit area."""

SHARE_RAYS = 1 << 14
"""Number of rays that measure the share to the partner."""

TRIAL = 64
"""Number of rays along each side that measure the phase steps."""

STEP = 0.5 * pi
"""Largest step of the phase between neighbouring rays."""

BLOCK = 1 << 18
"""Number of rays traced at a time."""

MARGIN = 4
"""Number of grid points around the lit ones."""

SECONDS = 4.2e-6
"""Processor seconds per ray on the reference machine: numpy's trace, and its share of the transforms."""


@dataclass(frozen=True, eq=False)
class Pupil:
    """A cell's light on the plane across the law's direction: one row per launched ray, side × side rays.

    place : (n, 2) lengths. Along lens x and y, from the mean point.
    phase : (n,) radians
    off : (n, 2). Direction cosines off the law.
    alive : (n,) bool. From the optical zone of lens 1 through the partner.
    step : (2,) lengths. Step of the grid on lens 1.
    """

    place: Floats
    phase: Floats
    off: Floats
    alive: Bools
    side: int
    step: Floats

    @property
    def largest_step(self) -> float:
        """Largest phase step between neighbouring rays, radians; 0 if no two neighbours get through."""
        phase = np.where(self.alive, self.phase, np.nan).reshape(self.side, self.side)
        steps = [np.abs(np.diff(phase, axis=axis)) for axis in (0, 1)]
        return float(max(np.nanmax(one, initial=0.0, where=np.isfinite(one)) for one in steps))


@dataclass(frozen=True, eq=False)
class RaySpread:
    """Directions of the light by exact trace, without waves.

    off : (n, 2)
            Direction cosines, less those of the law, of the rays that obey it, along lens x and y.
        share : float
            Transmitted share of the light on lens 1's optical zone.
    """

    off: Floats
    share: float

    @property
    def mean(self) -> Pair2:
        """Mean deviation from the law, radians."""
        x, y = self.off.mean(axis=0)
        return float(x), float(y)

    @property
    def rms(self) -> float:
        """Root mean square deviation from the law, both axes together, radians."""
        return float(np.sqrt((self.off**2).sum(axis=1).mean()))

    @property
    def half_energy(self) -> Pair2:
        """Widths that contain the middle half of the rays, radians."""
        low, high = np.quantile(self.off, (0.25, 0.75), axis=0)
        return float(high[0] - low[0]), float(high[1] - low[1])

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON, radians."""
        return {
            "share": self.share,
            "mean_off_law": self.mean,
            "rms": self.rms,
            "half_energy": self.half_energy,
        }


def pupil(window: Window, direction: Floats, wavelength: float, side: int, cell: Ints | None = None) -> Pupil:
    """Trace a plane wave through one telescopelet.

    direction : (3,) unit. Of the incident light.
    wavelength : metres
    side : Rays along each side of the box around the cell.
    cell : (2,) ints or None. The lit cell of a non-uniform sheet; None: all cells are identical.
    Raises ValueError: The law has no exit direction for this light, or a wavelength lies outside a material's
        data.
    """
    sheet, lit = _lit_cell(window, cell)
    asked = sheet.law_at(np.array(lit)).refract(direction[None, :])[0]
    if not np.isfinite(asked).all():
        raise ValueError("the law has no answer for light of this direction")
    across = _axes_across(sheet, asked)
    tile = sheet.lattice.tile()
    low, size = tile.min(axis=0), np.ptp(tile, axis=0)
    middle = np.array([(k + 0.5) / side for k in range(side)])
    grid = low + np.stack(np.meshgrid(middle, middle, indexing="ij"), axis=-1).reshape(-1, 2) * size
    parts = [
        _traced(sheet, lit, grid[k : k + BLOCK], direction, asked, across, wavelength)
        for k in range(0, len(grid), BLOCK)
    ]
    place, path, off, alive = (np.concatenate(one) for one in zip(*parts, strict=True))
    alive &= in_optical_tile(sheet, grid[:, 0], grid[:, 1])
    if alive.any():
        place, path = place - place[alive].mean(axis=0), path - path[alive].mean()
    phase = 2.0 * pi * sheet.unit / wavelength * path
    return Pupil(place, phase, off, alive, side, size / side)


def columns_crossed(window: Window, direction: Floats) -> float:
    """Largest number of cells that light of a direction (3,) passes over inside the thickest body.

    It is the body's height times the slope over the pitch.
    """
    heights = [plan.high - plan.low for plan in lay_out(window).bodies]
    return float(max(heights) * (np.abs(direction[:2]) / direction[2] / np.array(window.lattice.pitch)).sum())


def _lit_cell(window: Window, cell: Ints | None) -> tuple[Window, tuple[int, int]]:
    """The sheet to trace and the lit cell; for a uniform sheet a few cells suffice."""
    if cell is None:
        few = window.with_cells((3, 3))
        return few, central_cell(few)
    i, j = cell.tolist()
    return window, (i, j)


def _axes_across(window: Window, direction: Floats) -> Floats:
    """Two unit vectors (2, 3) perpendicular to a direction, as near to lens x and lens y as possible."""
    x = window.thin.rotation[:, 0]
    u = x - (x @ direction) * direction
    u = u / np.linalg.norm(u)
    return np.stack([u, np.cross(direction, u)])


def _traced(
    window: Window,
    cell: tuple[int, int],
    points: Floats,
    direction: Floats,
    asked: Floats,
    across: Floats,
    wavelength: float,
) -> tuple[Floats, Floats, Floats, Bools]:
    """Exit points (n, 2), optical paths (n,), direction cosines off the law (n, 2), obedient rays (n,)."""
    ways = np.broadcast_to(direction, (len(points), 3)).copy()
    lit = launched(window, points, ways, cell, direction).rays
    seen = trace(
        window, _at_wavelength(window, lit, wavelength), path="numpy"
    )  # the same bits everywhere; kernels would take longer to load
    alive = (seen.fate == Fate.ALIVE) & (seen.cell == cell).all(axis=1)
    height = seen.position @ asked
    on = (float(height[alive].mean()) if alive.any() else 0.0) - height
    with np.errstate(divide="ignore", invalid="ignore"):
        on = on / (seen.direction @ asked)
    at = seen.position + on[:, None] * seen.direction
    path = lit.position @ direction + seen.optical_path + on - (at @ asked)
    return at @ across.T, path, seen.direction @ across.T, alive


def rays_of(
    found: Pupil, window: Window, direction: Floats, wavelength: float, cell: Ints | None = None
) -> RaySpread:
    """Ray result for the light of a pupil; its share is measured at irregular points.

    A rim would cut whole rows of a regular grid.
    """
    sheet, chosen = _lit_cell(window, cell)
    lit = bundle(sheet, SHARE_RAYS, 0.0, middle=direction, cell=chosen)
    seen = trace(sheet, _at_wavelength(sheet, lit.rays, wavelength), path="numpy")
    zone = in_optical_tile(sheet, lit.points[:, 0], lit.points[:, 1])
    share = float((seen.fate[zone] == Fate.ALIVE).mean())
    return RaySpread(found.off[found.alive], share)


def _at_wavelength(window: Window, rays: Rays, wavelength: float) -> Rays:
    """Rays of a wavelength (metres), if the window has a wavelength at all."""
    return rays if window.wavelength is None else Rays(rays.position, rays.direction, wavelength)


def rays_needed(window: Window, direction: Floats, wavelength: float, cell: Ints | None = None) -> int:
    """Number of rays along a side for phase steps of at most a quarter turn, a power of two.

    Raises LimitRefused: More than `MOST`.
    Raises ValueError: As `pupil`.
    """
    step = pupil(window, direction, wavelength, TRIAL, cell).largest_step
    least = 1 << max(0, ceil(log2(max(1.0, TRIAL * step / STEP))))
    if least > MOST:
        raise LimitRefused(
            f"the pupil needs {least} x {least} rays (phase steps of a quarter turn), and {MOST} x {MOST} are"
            " computed: aberration spreads this light over more than a thousand times what diffraction does,"
            " so rays give the far field"
        )
    return max(FEWEST, least)


def far_field(found: Pupil, wavelength: float) -> FarField:
    """Far field of a pupil.

    found : With at least some light that obeys the law.
    wavelength : length
    """
    weight = np.sqrt(_spread(found))[found.alive]
    place = found.place[found.alive]
    wide = np.ptp(place, axis=0)
    count = max(MARGIN, int(np.sqrt(found.alive.sum())))
    spacing = wide / count
    field = _shared_out(place, weight * np.exp(1j * found.phase[found.alive]), spacing, count)
    flat = float(weight.sum()) ** 2
    light, turns = brightest(field)
    x, y = (marginal(field, k, float(spacing[k]), wavelength, float(wide[k])) for k in (0, 1))
    a, b = (section(field, k, turns, float(spacing[k]), wavelength, float(wide[k])) for k in (0, 1))
    return FarField("pupil", (x, y), (a, b), min(light / flat, 1.0), (found.side, found.side))  # rounding


def order_efficiency(
    found: Pupil, window: Window, direction: Floats, wavelength: float, order: Floats | None = None
) -> float:
    """Part of coherent light along the normal that identical cells send into one diffraction order.

    Light that leaves through other cells is lost to it.

    direction : (3,) unit. Of the law of `window`, to which the phases of the pupil are relative.
    wavelength : length
    order : (2,). Direction cosines of the order, sheet axes; None: an order at the peak of the far field.
    """
    weight = np.sqrt(_spread(found))[found.alive]
    whole = (window.lattice.cell_area / float(found.step.prod())) ** 2 * direction[2]
    if order is None:
        return float(far_field(found, wavelength).strehl * weight.sum() ** 2 / whole)
    out = np.array([*order, np.sqrt(max(0.0, 1.0 - float(order @ order)))])
    turns = found.place[found.alive] @ (_axes_across(window, direction) @ out) / wavelength
    there = (weight * np.exp(1j * (found.phase[found.alive] - 2.0 * pi * turns))).sum()
    return float(abs(there) ** 2 / whole)


def _spread(found: Pupil) -> Floats:
    """Area (n,) on the exit plane over that on lens 1, for each ray; the mean for one without neighbour."""
    shape = (found.side, found.side, 2)
    place = np.where(found.alive[:, None], found.place, np.nan).reshape(shape)
    slopes = []
    for axis in (0, 1):
        rise = np.diff(place, axis=axis) / found.step[axis]
        gap = np.full((1, found.side, 2) if axis == 0 else (found.side, 1, 2), np.nan)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # rays without neighbours: see below
            both = np.stack([np.concatenate([gap, rise], axis), np.concatenate([rise, gap], axis)])
            slopes.append(np.nanmean(both, axis=0))
    a, b = slopes
    area = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).ravel()
    known = np.isfinite(area)
    return np.asarray(np.where(known, area, area[known].mean() if known.any() else 1.0))


def _shared_out(place: Floats, light: Complex, spacing: Floats, count: int) -> Complex:
    """Amplitude on a regular grid whose transform equals that of the rays."""
    points = count + 2 * MARGIN
    at = (place - place.min(axis=0)) / spacing + MARGIN
    first = np.floor(at).astype(np.int64)
    part = at - first
    field = np.zeros(points * points, dtype=np.complex128)
    for dx in (0, 1):
        for dy in (0, 1):
            weight = np.abs(1 - dx - part[:, 0]) * np.abs(1 - dy - part[:, 1])
            rows = (first[:, 0] + dx) * points + first[:, 1] + dy
            field += np.bincount(rows, weight * light.real, len(field))
            field += 1j * np.bincount(rows, weight * light.imag, len(field))
    kernel = np.sinc(np.fft.fftfreq(points)) ** 2
    return np.asarray(np.fft.ifft2(np.fft.fft2(field.reshape(points, points)) / np.outer(kernel, kernel)))
