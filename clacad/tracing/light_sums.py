"""Light in sums: rays by fate, angle to a law, mean direction, and the law that rays show; no row is kept.

Rays are traced PIECE at a time, and each piece is summed as it is finished, in numpy or compiled
(`reference/light_sums.py`, `compiled/light_sums.py`). Pieces do not depend on the number of threads, and
their sums are added exactly in one order: one thread and many give the same bits.

From half a million rays on, compiled sums take a fifth of the time of rows and their angles. In numpy sums
take a tenth longer, because they contain what a fit needs. Only callers with many rays use them.
The others do not: `verify` needs every number of each ray (accounting), draws spots from rows and prints the
uncertainty of its
fits; `accuracy` compares two results ray by ray, with 95 in 100; `tolerance` and `optimise` trace a few
hundred or thousand rays a sample, too few for a kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import fsum, nan, sqrt

import numpy as np

from clacad.base.types import Floats
from clacad.optics.law import Law, law_numbers, linear_numbers, with_linear_numbers
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.tracing.reference.law_rung import GRADIENT, KNOWN, NORMAL, NUMBERS, OUT, SQUARE, ordinary, sums_of

PIECE = 1 << 14
"""Rays summed together: the rows of their results stay in the second-level cache."""

STEPS = 20
"""Traces after which a fit that has not converged is given up; three or four are usual."""

SETTLED = 1e-13
"""Change of 1/η and δ/η, relative to the largest of them, below which a fit has converged."""

ALIKE = 1e-12
"""Least singular value, relative to the largest, that still determines a parameter of the law."""

Summed = tuple[Floats, float]
"""Sums (2, NUMBERS) of a piece with their rounding errors, and its largest angle to the law."""


@dataclass(frozen=True, slots=True, eq=False)
class LightSums:
    """Sums over many rays.

    Attributes
    ----------
    law : Law
        Law that angles are measured to.
    counts : dict
        Number of rays of each fate, by name.
    known : int
        ALIVE rays for which the law has an answer; angles are over these.
    worst : float, radians
        Largest angle.
    sums : (NUMBERS,) array
        See `clacad.tracing.reference.law_rung`.
    """

    law: Law
    counts: dict[str, int]
    known: int
    worst: float
    sums: Floats

    @property
    def rms(self) -> float:
        """Root mean square angle to the law (radians), NaN without light."""
        return sqrt(self.sums[SQUARE] / self.known) if self.known else nan

    @property
    def mean_direction(self) -> Floats:
        """Mean exit direction (3,) of the ALIVE rays, NaN without any; its length is below 1 where they
        spread.
        """
        alive = self.counts[Fate.ALIVE.name]
        return np.asarray(self.sums[OUT : OUT + 3] / alive if alive else np.full(3, nan))

    def step(self) -> Floats:
        """Change of (1/η_x, 1/η_y, δ_x/η_x, δ_y/η_y) that fits the law to these rays, to first order.

        Raises
        ------
        ValueError
            The rays do not determine the four numbers.
        """
        n, g = self.sums[NORMAL:GRADIENT], self.sums[GRADIENT:]
        matrix = np.array(
            [
                [n[0], n[6], -n[1], -n[7]],
                [n[6], n[3], -n[8], -n[4]],
                [-n[1], -n[8], n[2], n[9]],
                [-n[7], -n[4], n[9], n[5]],
            ]
        )
        scale = np.sqrt(np.diag(matrix))
        if not self.known:
            raise ValueError("no light gets through that could show a law")
        whole = np.where(scale > 0.0, scale, 1.0)
        left, values, right = np.linalg.svd(matrix / np.outer(whole, whole))
        if values[-1] < ALIKE * values[0]:
            raise ValueError(
                "the rays do not determine eta and delta separately: their directions are too much alike"
            )
        return np.asarray(right.T @ ((left.T @ (g * [1.0, 1.0, -1.0, -1.0] / whole)) / values) / whole)

    def nearer_law(self) -> Law:
        """Law after one `step`, with its orientation fixed.

        Raises
        ------
        ValueError
            As `step`; or an η would be infinite.
        """
        return with_linear_numbers(self.law, linear_numbers(self.law) + self.step())


def summed(
    traced: Callable[[Rays], TraceResult], rays: Rays, law: Law, compiled: bool, threads: int
) -> LightSums:
    """Trace rays piece by piece and sum them.

    Parameters
    ----------
    traced : callable
        Rays of a piece → their result.
    rays : Rays
    law : Law
    compiled : bool
        Whether the sums are made by a kernel.
    threads : int
    """

    def one(first: int) -> Summed:
        part = slice(first, first + PIECE)
        waves = None if rays.wavelength is None else rays.wavelength[part]
        piece = Rays(rays.position[part], rays.direction[part], waves)
        return _of_piece(law, piece.direction, traced(piece), compiled)

    starts = range(0, len(rays), PIECE)
    if threads == 1 or len(starts) < 2:
        return _together(law, [one(first) for first in starts])
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(threads) as pool:
        return _together(law, list(pool.map(one, starts)))


def fitted(sums: Callable[[Rays, Law | None], LightSums], rays: Rays, law: Law | None = None) -> LightSums:
    """Sums about the law that the ALIVE rays show, found by repeated tracing until it converges.

    Parameters
    ----------
    sums : callable
        `Tracer.sums`: rays and a law → their sums about it.
    rays : Rays
    law : Law or None
        Start of the fit, whose orientation is kept; None: the law of the window's design.

    Raises
    ------
    ValueError
        As `LightSums.nearer_law`; or the fit does not converge.
    """
    found = sums(rays, law)
    for _ in range(STEPS):
        nearer = found.nearer_law()
        there = linear_numbers(nearer)
        change = np.abs(there - linear_numbers(found.law)).max() / np.abs(there).max()
        found = sums(rays, nearer)
        if change < SETTLED:
            return found
    raise ValueError(f"the law that these rays show does not settle in {STEPS} steps")


def _of_piece(law: Law, ray: Floats, result: TraceResult, compiled: bool) -> Summed:
    sums, numbers = np.zeros((2, NUMBERS)), law_numbers(law)
    if not (compiled and ordinary(numbers)):
        sums[0], worst = sums_of(law, ray, result)
        return sums, worst
    from clacad.tracing.compiled.law_rung import add_rays

    return sums, add_rays(numbers, result.fate, np.ascontiguousarray(ray), result.direction, sums)


def _together(law: Law, pieces: Sequence[Summed]) -> LightSums:
    columns = np.array([sums for sums, _ in pieces]).reshape(-1, NUMBERS)
    sums = np.array([fsum(column) for column in columns.T.tolist()])
    counts = {fate.name: int(sums[fate]) for fate in Fate}
    worst = max((worst for _, worst in pieces), default=0.0)
    return LightSums(law, counts, int(sums[KNOWN]), worst, sums)
