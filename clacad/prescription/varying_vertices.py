"""Where lens 2 must stand so that the mean of a cell's light leaves as asked, by the exact trace.

The offset that d = δ f1 gives is right to first order only: at slope .125 the light of a slab of R2/p = 5 leaves 6 to
40 mrad off. Light of the middle of the field is sent through lens 1 once; what lens 2 does to it is then traced for
every place of lens 2 at once. The place is a smooth function of δ alone, so beyond a few hundred cells it is traced on
Chebyshev points of their δ and interpolated (L. N. Trefethen, Approximation Theory and Approximation Practice, 2013),
which is held to a trace of some cells; where it is not good enough each cell is traced.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from clacad.base.sobol import sobol
from clacad.base.types import Floats
from clacad.optics.law import Law
from clacad.optics.law.varying import refract_each
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import Interface, trace_sequence
from clacad.sheet.bundle import middle_direction
from clacad.sheet.telescopelet import interfaces
from clacad.sheet.window import Window

RAYS = 256
STEPS = 8
CLOSE = 1e-12
"""Slope to which the mean direction is brought."""
NODES = (17, 33)
"""Chebyshev points along each δ."""
INTERPOLATED = 1e-9
"""Largest slope error that interpolation may leave."""
AT_ONCE = 4096
"""Places of lens 2 traced together: a million rays."""


@dataclass(frozen=True, eq=False)
class SecondHalf:
    """Light of one direction behind lens 1, and the surfaces of lens 2.

    Parameters
    ----------
    seq : list of Interface
    rays : Rays
        Where they left lens 1's surfaces.
    """

    seq: list[Interface]
    rays: Rays

    def slopes(self, moved: Floats) -> Floats:
        """Mean slopes (m, 2) behind lens 2 displaced by `moved` (m, 2), lengths; NaN where a ray gets lost."""
        found = [self._slopes(moved[k : k + AT_ONCE]) for k in range(0, len(moved), AT_ONCE)]
        return np.concatenate(found) if found else np.empty((0, 2))

    def _slopes(self, moved: Floats) -> Floats:
        count = len(self.rays)
        place = np.repeat(self.rays.position[None], len(moved), axis=0)
        place[..., :2] -= moved[:, None]
        way = np.broadcast_to(self.rays.direction, place.shape)
        seen = trace_sequence(self.seq, Rays(place.reshape(-1, 3), way.reshape(-1, 3)))
        out = np.where((seen.fate == Fate.ALIVE)[:, None], seen.direction, np.nan).reshape(len(moved), count, 3).mean(axis=1)
        return np.asarray(out[:, :2] / out[:, 2:])


def traced_offsets(window: Window, law: Law, deltas: Floats) -> Floats:
    """Displacement of lens 2 from where the window of equal cells has it, cell by cell.

    Parameters
    ----------
    window : Window
        Of equal cells.
    law : Law
        η and lens axes of all cells.
    deltas : (n, 2) array
        δ of each cell.

    Returns
    -------
    (n, 2) array, lengths
        NaN where no place of lens 2 does it.
    """
    middle = middle_direction(window)
    half = _second_half(window, middle)
    focal = np.array(window.recipe["f"][0])
    asked = Asked(law, middle, half, np.where(np.isfinite(focal), focal, 0.0))
    different, which = np.unique(deltas, axis=0, return_inverse=True)
    which = which.reshape(-1)
    for nodes in NODES:
        if len(different) <= nodes * nodes:
            break
        made = _interpolated(asked, different, nodes)
        some = np.unique(np.linspace(0, len(different) - 1, 33).astype(np.int64))
        left = asked.errors(different[some], made[some])
        if np.isfinite(left).all() and np.abs(left).max() <= INTERPOLATED:
            return np.asarray(made[which])
    return np.asarray(asked.solved(different)[which])


@dataclass(frozen=True, eq=False)
class Asked:
    """What the mean light of a cell shall do, and what it does.

    Parameters
    ----------
    law : Law
    middle : (3,) unit
        Direction of the light before the sheet.
    half : SecondHalf
    focal : (2,) lengths
        f1 along the lens axes, 0 where there is no power.
    """

    law: Law
    middle: Floats
    half: SecondHalf
    focal: Floats

    def errors(self, deltas: Floats, moved: Floats) -> Floats:
        """Slopes (m, 2) of the mean light over those asked by δ (m, 2), lens 2 displaced by `moved` (m, 2)."""
        out = refract_each(self.law, deltas, np.broadcast_to(self.middle, (len(deltas), 3)))
        return self.half.slopes(moved) - out[:, :2] / out[:, 2:]

    def first(self, deltas: Floats) -> Floats:
        """Displacements (m, 2), lengths, by d = δ f1."""
        over = (deltas - (self.law.delta_x, self.law.delta_y)) * self.focal
        return np.asarray(over @ self.law.rotation[:2, :2].T)

    def solved(self, deltas: Floats) -> Floats:
        """Displacements (m, 2), lengths, that leave no error: Newton's steps with differences."""
        moved = self.first(deltas)
        step = 1e-4 * float(np.max(np.abs(self.focal))) or 1.0
        for _ in range(STEPS):
            error = self.errors(deltas, moved)
            if not np.nanmax(np.abs(error), initial=0.0) > CLOSE:
                break
            sides = [(self.errors(deltas, moved + d) - self.errors(deltas, moved - d)) / (2.0 * step)
                     for d in (np.array([step, 0.0]), np.array([0.0, step]))]  # fmt: skip
            jacobian = np.stack(sides, axis=-1)
            lost = ~np.isfinite(jacobian).all(axis=(1, 2))
            jacobian[lost] = np.eye(2)
            moved = moved - np.linalg.solve(jacobian, np.where(lost[:, None], np.nan, error)[..., None])[..., 0]
        return np.asarray(moved)


def _second_half(window: Window, middle: Floats) -> SecondHalf:
    """Light over the part of lens 1 that its partner takes, traced to where lens 2's surfaces begin."""
    seq = interfaces(window)
    first = 1 if window.form == "slab" else 2
    law = window.law
    part = min(1.0, 1.0 / abs(law.eta_x), 1.0 / abs(law.eta_y))
    at = np.column_stack([part * window.lattice.over_cell(sobol(RAYS, 2)), np.zeros(RAYS)])
    below = window.z_range[0] - max(window.lattice.pitch)
    rays = Rays(at + middle * (below / middle[2]), np.broadcast_to(middle, at.shape))
    seen = trace_sequence(seq[:first], rays)
    through = seen.fate == Fate.ALIVE
    return SecondHalf(seq[first:], Rays(seen.position[through], seen.direction[through]))


def _interpolated(asked: Asked, deltas: Floats, nodes: int) -> Floats:
    """Displacements (n, 2), lengths, for δ (n, 2) by polynomials through those at nodes × nodes Chebyshev points."""
    low, high = deltas.min(axis=0), deltas.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    points = chebyshev.chebpts1(nodes)
    grid = np.stack(np.meshgrid(points, points, indexing="ij"), axis=-1).reshape(-1, 2)
    solved = asked.solved(low + 0.5 * (grid + 1.0) * span)
    if not np.isfinite(solved).all():
        return np.full(deltas.shape, np.nan)
    inverse = np.linalg.inv(chebyshev.chebvander(points, nodes - 1))
    x, y = (2.0 * (deltas - low) / span - 1.0).T
    found = []
    for k in range(2):
        found.append(chebyshev.chebval2d(x, y, inverse @ solved[:, k].reshape(nodes, nodes) @ inverse.T))
    return np.column_stack(found)
