"""Diffraction at a lit zone: equivalent widths of a convex polygon and its Fraunhofer pattern.

Along an axis the pattern is the Fourier transform of the zone's projection on that axis (its chord lengths).
A rectangle along the axes is a slit: sinc²(π w ν), first zero at ν = 1/w. Two numbers describe any other
zone. Its core is that of a slit of the *equivalent width* w = √12 σ, with σ the standard deviation of the
projection. Both patterns begin as 1 − (2π σ ν)² . . ., so a rotated square keeps its own side. Its *first
zero* lies between those of a slit and of a triangle of the zone's extent W: 1/W ≤ ν ≤ 2/W.

Multiplied by the wavelength these are angles: λ/w, λν.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clacad.base.types import Floats

Complex = NDArray[np.complex128]

STEPS = 64
"""Number of steps from 1/W to 2/W at which the sign of a pattern is evaluated."""


def equivalent_widths(polygon: ArrayLike) -> Floats:
    """Widths (2,) in x and y of slits whose patterns have a polygon's (m, 2) core, lengths."""
    points = _about_middle(polygon)
    following = np.roll(points, -1, axis=0)
    cross = points[:, 0] * following[:, 1] - points[:, 1] * following[:, 0]
    squares = points**2 + points * following + following**2
    # ∬ x² dA = Σ cross (x₀² + x₀x₁ + x₁²)/12 over the edges, and the area Σ cross/2
    return np.asarray(np.sqrt(2.0 * (cross @ squares) / cross.sum()))


def pattern(polygon: ArrayLike, axis: int, frequency: ArrayLike) -> Complex:
    """Amplitude (n,) of the Fraunhofer pattern of a polygon along one axis, 1 in the middle.

    polygon : (m, 2) lengths
    axis : 0 or 1
    frequency : (n,) 1/length. Direction cosine off the middle over the wavelength.

    Notes
    -----
    Green's theorem turns ∬ exp(−2πiνx) dA into a sum over the edges, each dy sinc(ν dx) exp(−2πiν x_m)
    i/(2πν): the exact transform of a piecewise linear projection.
    """
    points = _about_middle(polygon)
    nu = np.atleast_1d(np.asarray(frequency, dtype=np.float64))
    step = np.roll(points, -1, axis=0) - points
    middle = points[:, axis] + 0.5 * step[:, axis]
    along, across = step[:, axis], step[:, 1 - axis] * (1.0 if axis == 0 else -1.0)
    waves = np.sinc(np.outer(nu, along)) * np.exp(-2j * np.pi * np.outer(nu, middle))
    area = float(middle @ across)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = 1j * (waves @ across) / (2.0 * np.pi * nu * area)
    return np.asarray(np.where(nu == 0.0, 1.0, found))


def first_zeros(polygon: ArrayLike) -> Floats:
    """Frequencies (2,), 1/length, of the first zero of the pattern along x and y.

    The polygon is symmetric about its middle, so that its pattern is real.
    """
    return np.array([_first_zero(polygon, axis) for axis in (0, 1)])


def _first_zero(polygon: ArrayLike, axis: int) -> float:
    """Frequency (1/length) of the first zero of the pattern along one axis."""
    extent = float(np.ptp(np.asarray(polygon)[:, axis]))

    def amplitude(frequency: ArrayLike) -> Floats:
        return np.asarray(pattern(polygon, axis, frequency).real)

    tried = np.linspace(1.0, 2.0, STEPS + 1) / extent
    dark = np.flatnonzero(amplitude(tried) <= 0.0)
    if len(dark) == 0:  # a triangle touches zero at 2/W without crossing it
        return float(tried[-1])
    if dark[0] == 0:
        return float(tried[0])
    low, high = tried[dark[0] - 1], tried[dark[0]]
    while (middle := 0.5 * (low + high)) not in (low, high):
        low, high = (middle, high) if amplitude(middle)[0] > 0.0 else (low, middle)
    return float(high)


def _about_middle(polygon: ArrayLike) -> Floats:
    """Corners (m, 2) about the polygon's centroid, counter-clockwise."""
    points = np.asarray(polygon, dtype=np.float64)
    points = points - points.mean(axis=0)
    following = np.roll(points, -1, axis=0)
    cross = points[:, 0] * following[:, 1] - points[:, 1] * following[:, 0]
    centroid = cross @ (points + following) / (3.0 * cross.sum())
    return np.asarray((points if cross.sum() > 0.0 else points[::-1]) - centroid)
