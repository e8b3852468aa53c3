"""The far field of one telescopelet along each lens axis, and its widths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Pair2

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
