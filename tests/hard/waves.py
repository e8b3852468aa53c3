"""Pairs of lenses at the sampling limit of their waves: the last grid that is computed, and the first that is not."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, inf, pi, sin

import numpy as np


@dataclass(frozen=True, eq=False)
class HardWave:
    """A pair, a direction, and why its grid is hard; lengths in mm, η and slope one number an axis.

    turned : degrees by which square cells are turned against the lenses, so that both axes share a grid; None: axis by axis.
    """

    name: str
    why: str
    pitch: float
    separation: float
    eta: tuple[float, ...]
    slope: tuple[float, ...] = (0.0,)
    field_lens: bool = False
    turned: float | None = None

    @property
    def focal(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """f1 and f2 along each axis."""
        first = tuple(inf if eta == 1.0 else self.separation / (1.0 - eta) for eta in self.eta)
        return first, tuple(-eta * f for eta, f in zip(self.eta, first))

    @property
    def zone(self) -> np.ndarray:
        """Rim of either lens about its own middle."""
        if self.turned is None:
            return 0.5 * self.pitch * np.array([[-1.0], [1.0]])
        angle = np.array([(k + 0.5) * pi / 2.0 for k in range(4)]) + self.turned * pi / 180.0
        return self.pitch / 2.0**0.5 * np.array([[cos(a), sin(a)] for a in angle])


WAVES = [
    HardWave("wide cells", "the lens's phase steps by π x/(λ f) a length", 20.0, 40.0, (-1.0,)),
    HardWave("strong lens 2", "its phase steps faster than lens 1's, the beam is small there", 3.0, 10.0, (-0.05,)),
    HardWave("strong lens 1", "the beam at lens 2 is twenty cells wide, all of it needs room", 1.0, 10.0, (-20.0,)),
    HardWave("steep light", "the chief ray meets lens 2 aside: the grid is about it, not about the lens", 5.0, 40.0, (-1.0,), (0.1,)),
    HardWave("virtual focus", "lens 2 is hollow", 8.0, 20.0, (0.5,)),
    HardWave("field lens", "twice as strong as either lens", 20.0, 40.0, (-1.0,), field_lens=True),
    HardWave("turned cells", "both axes on one grid: 4096 points a side are less than 16777216 in a row", 1.0, 40.0, (-1.0, -1.0), (0.0, 0.0), turned=45.0),
    HardWave("turned cells, one axis flat", "no phase along x, steps along y", 1.0, 40.0, (1.0, -1.0), (0.0, 0.0), turned=30.0),
]  # fmt: skip
