"""Light in sums: rays by fate, angle to a law, mean direction, and the law that rays show; no row is kept.

Rays are sent PIECE at a time, and each piece is summed as it is finished, in numpy (`sums_of`) or by a kernel
(`compiled_sums`). Pieces do not depend on the number of threads, and their sums are added exactly in one
order: one thread and many give the same bits.

From half a million rays on, compiled sums take a fifth of the time of rows and their angles. In numpy sums
take a tenth longer, because they contain what a fit needs. Only callers with many rays use them. The others
do not: `verify` needs every number of each ray, draws spots from rows and prints the uncertainty of its fits;
`accuracy` compares two results ray by ray, with 95 in 100; `tolerance` and `optimise` trace a few hundred or
thousand rays a sample, too few for a kernel.

In the frame of the lenses a ray m is incident and the law sends it along w = (m_x/η_x − m_z δ_x/η_x, …, m_z).
With u = w/|w| and r the ray's own exit direction minus u, one step of Gauss and Newton in (1/η_x, 1/η_y,
δ_x/η_x, δ_y/η_y) solves N s = g with N = Σ Jᵀ J, g = Σ Jᵀ r and J = (1 − u uᵀ) ∂w/|w|, which needs only the
products below.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import fsum, nan, sqrt

import numpy as np

from clacad.base.types import Bools, Bytes, Floats
from clacad.optics.law import Law, angle_between, law_numbers, linear_numbers, with_linear_numbers
from clacad.optics.rays import Fate, Rays, TraceResult

PIECE = 1 << 14
"""Rays summed together: the rows of their results stay in the second-level cache."""

STEPS = 20
"""Traces after which a fit that has not converged is given up; three or four are usual."""

SETTLED = 1e-13
"""Change of 1/η and δ/η, relative to the largest of them, below which a fit has converged."""

ALIKE = 1e-12
"""Least singular value, relative to the largest, that still determines a parameter of the law."""

KNOWN = len(Fate)
"""Index of the ALIVE rays for which the law has an answer; counts by fate come first."""

SQUARE, OUT = KNOWN + 1, KNOWN + 2
"""Indices of the squared angles to the law and of the exit directions of the ALIVE rays (3)."""

NORMAL, GRADIENT, NUMBERS = KNOWN + 5, KNOWN + 15, KNOWN + 19
"""Indices of the ten products that make up N, and of g (4)."""

LARGE = 2.0**100
"""Laws with a number above this, or an η below its inverse, are left to numpy."""

AddRays = Callable[[Floats, Bytes, Floats, Floats, Floats], float]
"""See `compiled_sums.add_rays`."""

Summed = tuple[Floats, float]
"""Sums (2, NUMBERS) of a piece with their rounding errors, and its largest angle to the law."""


@dataclass(frozen=True, slots=True, eq=False)
class LightSums:
    """Sums over many rays.

    law : Law that angles are measured to.
    counts : Number of rays of each fate, by name.
    known : ALIVE rays for which the law has an answer; angles are over these.
    worst : radians. Largest angle.
    sums : (NUMBERS,) array. See `KNOWN` and the constants after it.
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
        """Mean exit direction (3,) of the ALIVE rays, NaN without any; shorter than 1 where they spread."""
        alive = self.counts[Fate.ALIVE.name]
        return np.asarray(self.sums[OUT : OUT + 3] / alive if alive else np.full(3, nan))

    def step(self) -> Floats:
        """Change of (1/η_x, 1/η_y, δ_x/η_x, δ_y/η_y) that fits the law to these rays, to first order.

        Raises ValueError: The rays do not determine the four numbers.
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

        Raises ValueError: As `step`; or an η would be infinite.
        """
        return with_linear_numbers(self.law, linear_numbers(self.law) + self.step())


def summed(
    traced: Callable[[Rays], TraceResult], rays: Rays, law: Law, add: AddRays | None, threads: int
) -> LightSums:
    """Trace rays piece by piece and sum them.

    traced : Rays of a piece → their result.
    add : Kernel that makes the sums (`compiled_sums.add_rays`); None: numpy makes them.
    """

    def one(first: int) -> Summed:
        part = slice(first, first + PIECE)
        waves = None if rays.wavelength is None else rays.wavelength[part]
        piece = Rays(rays.position[part], rays.direction[part], waves)
        return _of_piece(law, piece.direction, traced(piece), add)

    starts = range(0, len(rays), PIECE)
    if threads == 1 or len(starts) < 2:
        return _together(law, [one(first) for first in starts])
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(threads) as pool:
        return _together(law, list(pool.map(one, starts)))


def fitted(sums: Callable[[Rays, Law | None], LightSums], rays: Rays, law: Law | None = None) -> LightSums:
    """Sums about the law that the ALIVE rays show, found by repeated tracing until it converges.

    sums : `Tracer.sums`: rays and a law → their sums about it.
    law : Start of the fit, whose orientation is kept; None: the law of the window's design.
    Raises ValueError: As `LightSums.nearer_law`; or the fit does not converge.
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


def ordinary(law: Floats) -> bool:
    """Whether compiled code, without separate powers of two, can hold a law's numbers; see `law_numbers`."""
    return bool(np.abs(law[:2]).min() > 1.0 / LARGE and np.abs(law).max() < LARGE)


def _of_piece(law: Law, ray: Floats, result: TraceResult, add: AddRays | None) -> Summed:
    sums, numbers = np.zeros((2, NUMBERS)), law_numbers(law)
    if add is None or not ordinary(numbers):
        sums[0], worst = sums_of(law, ray, result)
        return sums, worst
    return sums, add(numbers, result.fate, np.ascontiguousarray(ray), result.direction, sums)


def _together(law: Law, pieces: Sequence[Summed]) -> LightSums:
    columns = np.array([sums for sums, _ in pieces]).reshape(-1, NUMBERS)
    sums = np.array([fsum(column) for column in columns.T.tolist()])
    counts = {fate.name: int(sums[fate]) for fate in Fate}
    worst = max((worst for _, worst in pieces), default=0.0)
    return LightSums(law, counts, int(sums[KNOWN]), worst, sums)


def sums_of(law: Law, ray: Floats, result: TraceResult) -> tuple[Floats, float]:
    """Sums (NUMBERS,) over the rays of a result and the largest angle to the law (radians).

    ray : (m, 3). Directions before the sheet.
    """
    sums = np.zeros(NUMBERS)
    sums[:KNOWN] = np.bincount(result.fate, minlength=KNOWN)
    alive = result.fate == Fate.ALIVE
    sums[OUT : OUT + 3] = [np.ascontiguousarray(c).sum() for c in result.direction[alive].T]
    asked = law.refract(ray[alive])
    known = np.isfinite(asked[:, 0])
    angle = angle_between(result.direction[alive][known], asked[known])
    sums[KNOWN], sums[SQUARE] = known.sum(), (angle * angle).sum()
    sums[NORMAL:] = _step_sums(law, ray[alive], result.direction[alive], known)
    return sums, float(angle.max(initial=0.0))


def _step_sums(law: Law, ray: Floats, out: Floats, known: Bools) -> Floats:
    """N and g: (14,)."""
    m = (ray[known] / np.linalg.norm(ray[known], axis=1)[:, None]) @ law.rotation
    power_x, power_y, offset_x, offset_y = linear_numbers(law)
    w = np.stack([m[:, 0] * power_x - m[:, 2] * offset_x, m[:, 1] * power_y - m[:, 2] * offset_y, m[:, 2]])
    length = np.sqrt((w * w).sum(axis=0))
    x, y, z = w / length
    a, b, c = m.T / length
    more = (out[known] @ law.rotation).T - [x, y, z]
    gx, gy = more[:2] - (more * [x, y, z]).sum(axis=0) * [x, y]
    xx, yy, xy = 1.0 - x * x, 1.0 - y * y, -x * y
    terms = (
        xx * a * a,
        xx * a * c,
        xx * c * c,
        yy * b * b,
        yy * b * c,
        yy * c * c,
        xy * a * b,
        xy * a * c,
        xy * b * c,
        xy * c * c,
        a * gx,
        b * gy,
        c * gx,
        c * gy,
    )
    return np.array([term.sum() for term in terms])
