"""Thickness "auto": the smallest that covers every cell, joins neighbours and covers the land."""

from __future__ import annotations

from collections.abc import Callable

from clacad.base.types import Pair2
from clacad.prescription.cell_heights import border_overlap, least_thickness, proud_of_land
from clacad.prescription.radii import NoSuchLens
from clacad.sheet.window import Window


def auto_thickness(build: Callable[[Pair2], Window], guess: Pair2, neck: float, limit: float) -> Pair2:
    """Solve for the thicknesses of a biconvex pair together with its radii.

    Parameters
    ----------
    build : callable
        Thicknesses → window (radii solved for them).
    guess : (T1, T2), lengths
    neck : float
        Least common height of neighbouring columns (length).
    limit : float
        Thickness at which the search stops (length).

    Raises
    ------
    NoSuchLens
        No thickness below `limit` joins the lenslets.

    Notes
    -----
    Moving the two faces apart by dT increases every thickness by dT cos θ to first order, so that the fixed
    point T ← T + (needed − present) contracts fast; the radii depend only weakly on T.
    """
    thickness = list(guess)
    for _ in range(80):
        window = build((thickness[0], thickness[1]))
        missing = [_missing(window, k, neck) for k in (0, 1)]
        if max(abs(m) for m in missing) <= 2e-14 * limit:
            break
        thickness = [t + m for t, m in zip(thickness, missing, strict=True)]
        for number, t in enumerate(thickness, start=1):
            if not 0.0 < t < limit:
                raise NoSuchLens(
                    f"no centre thickness below {limit:.6g} covers the cell of lens {number} and joins it to its "
                    f"neighbours (tried {t:.6g})",
                    hint="a larger separation, a smaller pitch, less tilt, or a seam with a web",
                )
    return thickness[0], thickness[1]


def _missing(window: Window, number: int, neck: float) -> float:
    """Additional thickness that the lens needs (negative: it may be thinner), length."""
    body = window.bodies[-number]  # first or last: a field lens has its own thickness
    spare = least_thickness(window, body) - neck
    if window.land.seam == 0.0:
        spare = min(spare, border_overlap(window, body) - neck)
    proud = proud_of_land(window, body)  # both faces rise by half of the increase of T
    spare = min(spare, 2.0 * proud)
    if spare == -float("inf"):
        return window.lattice.circumradius  # a lens ends inside its cell: a thicker lens reaches farther
    return -spare / float(window.thin.rotation[2, 2])
