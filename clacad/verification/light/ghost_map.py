"""Shares of light through the partner lenslet and as ghosts, over a wide field, with the closed form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats
from clacad.optics.rays import Fate
from clacad.sheet.bundle import launched, middle_direction
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.vignetting import half_field, share, thin_cells
from clacad.sheet.window import Window
from clacad.tracing.trace import trace

DIRECTIONS = 31
PLACES = 64
REACH = 1.6
"""Half width of the map over the half field of view; it includes the first ghosts on all sides."""


@dataclass(frozen=True, eq=False)
class GhostMap:
    """Shares of the light over two incident slopes, lens frame, [slope y, slope x].

    slope : ((k,), (k,)) incident slopes along lens x and lens y
    alive, ghost, closed_form : (k, k) shares
        Traced through the partner; traced through other lenslets; closed form of thin lenses for the partner.
    """

    slope: tuple[Floats, Floats]
    alive: Floats
    ghost: Floats
    closed_form: Floats

    @property
    def worst(self) -> float:
        """Largest difference between traced share and closed form."""
        return float(np.abs(self.alive - self.closed_form).max())

    def to_dict(self) -> dict[str, Any]:
        """Numbers for the report, shares to four digits: counts of few rays have no more."""
        return {
            "slope": [np.round(s, 6) for s in self.slope], "rays_a_direction": PLACES, "worst_difference": self.worst,
            "alive": np.round(self.alive, 4), "ghost": np.round(self.ghost, 4),
            "closed_form": np.round(self.closed_form, 4),
        }  # fmt: skip


def ghost_map(window: Window) -> GhostMap:
    """Trace a grid of directions about the middle of the field, each over a whole cell."""
    cells, turn = thin_cells(window), window.thin.rotation
    middle = cells.slopes(middle_direction(window)[None])[0]
    reach = [min(REACH * half, 1.5) for half in half_field(cells)]
    sx, sy = (middle[k] + np.linspace(-reach[k], reach[k], DIRECTIONS) for k in (0, 1))
    y, x = np.meshgrid(sy, sx, indexing="ij")
    local = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]) @ turn.T
    direction = local / np.linalg.norm(local, axis=1, keepdims=True)
    forward = direction[:, 2] > 0.05
    direction[~forward] = middle_direction(window)
    places = window.lattice.over_cell(sobol(PLACES, 2))
    lit = launched(
        window, np.tile(places, (len(direction), 1)), np.repeat(direction, PLACES, axis=0), central_cell(window),
        middle_direction(window),
    )  # fmt: skip
    fate = trace(window, lit.rays, path="size").fate.reshape(len(direction), PLACES)
    alive, ghost = ((fate == f).mean(axis=1) for f in (Fate.ALIVE, Fate.GHOST))
    closed = share(cells, direction)
    for values in (alive, ghost, closed):
        values[~forward] = 0.0
    shape = x.shape
    return GhostMap((sx, sy), alive.reshape(shape), ghost.reshape(shape), closed.reshape(shape))
