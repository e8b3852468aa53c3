"""Five makers and an instrument, by formulas of their own: nothing here is imported from the package.

A maker is given the commanded heights of one cell (millimetres, out of the material, seen from outside) and returns
those of a field of cells as it comes out. The instrument adds noise, loses points, and writes heights times its scale.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter, grey_dilation, grey_erosion

Heights = np.ndarray
Function = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Lattice:
    """Square or hexagonal cells of a pitch in millimetres."""

    pitch: float
    hexagonal: bool = False

    def local(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places relative to the middle of the nearest cell."""
        p = self.pitch
        if not self.hexagonal:
            return x - p * np.rint(x / p), y - p * np.rint(y / p)
        row = 0.75**0.5 * p
        best = np.full(x.shape, np.inf)
        u, v = x.copy(), y.copy()
        for j in (-1, 0, 1):
            k = np.rint(y / row) + j
            shift = 0.5 * p * (k % 2)
            cx, cy = p * np.rint((x - shift) / p) + shift, row * k
            near = np.hypot(x - cx, y - cy) < best
            best = np.where(near, np.hypot(x - cx, y - cy), best)
            u, v = np.where(near, x - cx, u), np.where(near, y - cy, v)
        return u, v


def interpolated(heights: Heights, width: float, height: float) -> Function:
    """Command as a function of places: row i, column k belong to ((k − n/2) width/n, (i − n/2) height/n)."""
    n = len(heights)
    steps = (np.arange(n) - n // 2) / n
    known = np.isfinite(heights)
    if not known.all():  # corners of the box outside a hexagon: continued by the nearest polynomial
        v, u = np.meshgrid(steps, steps, indexing="ij")
        terms = np.stack([u**i * v**j for i in range(11) for j in range(11 - i)], axis=-1)
        fit = np.linalg.lstsq(terms[known], heights[known], rcond=None)[0]
        heights = np.where(known, heights, terms @ fit)
    spline = RectBivariateSpline(steps * height, steps * width, heights)
    return lambda u, v: spline(v, u, grid=False)


@dataclass(frozen=True)
class Maker:
    """What a machine leaves; lengths in millimetres."""

    name: str
    lateral: float = 0.0  # shrinkage along x and y
    height: float = 0.0  # shrinkage along z
    bend: float = 0.0  # middle of a lenslet too low by this, to the fourth power of the distance
    gamma: float = 1.0
    levels: int = 0
    layer: float = 0.0
    spot: float = 0.0
    nose: float = 0.0
    feed: float = 0.0
    astigmatism: float = 0.0  # 1/mm

    def field(self, command: Function, lattice: Lattice, size: int, pixel: float) -> Heights:
        """Made heights of size × size points."""
        at = (np.arange(size) - size / 2.0) * pixel
        x, y = (one / (1.0 - self.lateral) for one in np.meshgrid(at, at))
        u, v = lattice.local(x, y)
        z = command(u, v)
        if self.gamma != 1.0 or self.levels:
            low, high = z.min(), z.max()
            part = (z - low) / (high - low)
            if self.levels:
                part = np.rint(part * (self.levels - 1)) / (self.levels - 1)
            z = low + (high - low) * part**self.gamma
        if self.layer:
            z = self.layer * np.rint(z / self.layer)
        if self.spot:
            z = gaussian_filter(z, self.spot / pixel, mode="nearest")
        if self.nose:
            z = self._turned(z, x, pixel)
        z = (
            z
            + self.bend * ((u * u + v * v) / (0.5 * lattice.pitch) ** 2) ** 2
            - self.astigmatism * (u * u - v * v)
        )
        return (1.0 - self.height) * z

    def _turned(self, z: Heights, x: np.ndarray, pixel: float) -> Heights:
        """A round nose does not reach into seams, and leaves ridges between its passes."""
        reach = int(0.6 * self.nose / pixel)
        v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1] * pixel
        ball = -(self.nose - np.sqrt(self.nose**2 - np.minimum(u * u + v * v, 0.99 * self.nose**2)))
        flat = np.ones_like(ball, dtype=bool)
        closed = grey_erosion(
            grey_dilation(z, footprint=flat, structure=ball), footprint=flat, structure=ball
        )
        ridge = ((x + 0.5 * self.feed) % self.feed - 0.5 * self.feed) ** 2 / (2.0 * self.nose)
        return closed + ridge


MAKERS = {
    "moulding": Maker("moulding", lateral=0.003, height=0.008, bend=-3e-4),
    "UV resin": Maker("UV resin", height=0.05, bend=4e-4),
    "turning": Maker("turning", nose=0.025, feed=0.003, bend=2e-4, astigmatism=2e-3),
    "layers": Maker("layers", layer=1e-4, spot=0.002, height=0.02),
    "greyscale": Maker("greyscale", gamma=1.05, levels=256, spot=0.001),
}  # fmt: skip


@dataclass(frozen=True)
class Instrument:
    """A microscope that measures heights."""

    z_scale: float = 1.0
    noise: float = 20e-6
    lost: float = 0.01

    def measured(self, z: Heights, seed: int) -> Heights:
        """Heights of its file, NaN where a point was lost."""
        random = np.random.default_rng(seed)
        z = self.z_scale * (z + random.normal(0.0, self.noise, z.shape) if self.noise else z)
        return np.where(random.random(z.shape) < self.lost, np.nan, z)
