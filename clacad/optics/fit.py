"""Faces that keep best to a law: how far fixed rays are from it, and the least-squares search over what may change.

The residual of a ray is what its direction lacks of the asked one, across the middle of the field; nothing of the law
is fitted, so a search cannot drift to another η. The rays are the same throughout, and one that gets lost counts as
`LOST`: a search that could lose rays would throw them away to look sharp.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from clacad.base.types import Floats
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import Interface, trace_sequence

LOST = 0.1
"""Residual of a ray that does not get through (radians): far above any lens worth having, far below a wall."""

STEP = 1e-6
"""Change of an unknown, of order 1, by which slopes are taken: rounding of the trace shows at 1e-10 of them."""

STRIDE = 0.02
"""First stride of an unknown: where the search begins, seen from its own origin, which is what scipy goes by."""

SETTLED = 1e-6
"""Relative change of the sum of squares at which a search ends."""

ROUNDS = 40
"""Evaluations of the slopes after which it ends all the same."""

Residuals = Callable[[Floats], Floats]


@dataclass(frozen=True, eq=False)
class AskedLight:
    """Rays and the directions they should leave in.

    rays : Rays
    asked : (n, 3) unit
    across : (2, 3)
        Unit vectors across the middle of what is asked.
    """

    rays: Rays
    asked: Floats
    across: Floats

    @staticmethod
    def of(rays: Rays, asked: Floats) -> AskedLight:
        """Rays with their asked directions (n, 3); both vectors across are fixed by the mean of these."""
        middle = asked.mean(axis=0)
        middle = middle / np.linalg.norm(middle)
        u = np.eye(3)[int(np.argmin(np.abs(middle)))]
        u = u - (u @ middle) * middle
        u = u / np.linalg.norm(u)
        return AskedLight(rays, asked, np.stack([u, np.cross(middle, u)]))


def law_residuals(sequence: Sequence[Interface], light: AskedLight) -> Floats:
    """Residuals (2 n,) of n rays through surfaces, radians over √n: their sum of squares is the mean square error."""
    seen = trace_sequence(sequence, light.rays)
    off = (seen.direction - light.asked) @ light.across.T
    off[seen.fate != Fate.ALIVE] = LOST
    return np.asarray(off.ravel() / np.sqrt(len(light.asked)))


def minimise(residuals: Residuals, start: Floats) -> Floats:
    """Unknowns (k,) of the least sum of squares near `start` (k,), each of order 1.

    Trust-region least squares with slopes by forward differences in a fixed order: the same numbers every time.

    Parameters
    ----------
    residuals : callable
        Unknowns (k,) → residuals (m,), always finite. What it raises ends the search.
    start : (k,)
    """
    from scipy.optimize import least_squares

    origin = np.full(len(start), STRIDE)

    def moved(place: Floats) -> Floats:
        return residuals(start + (place - origin))

    def slopes(place: Floats) -> Floats:
        here = moved(place)
        columns = [(moved(place + STEP * axis) - here) / STEP for axis in np.eye(len(start))]
        return np.stack(columns, axis=1)

    found = least_squares(
        moved, origin, slopes, x_scale="jac", ftol=SETTLED, xtol=1e-10, gtol=1e-15, max_nfev=ROUNDS
    )
    return np.asarray(start + (found.x - origin), dtype=np.float64)
