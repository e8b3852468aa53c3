"""What pairs that image sharply (`[pair] focus`) do to parallel light beyond the law, because they were asked to.

A ray that enters lens 1 at C1 + ξ leaves with t' = (t − δ)/η − D ξ along each lens axis, D = 1/f1 + 1/f2 − s/(f1 f2), the power of
the pair: 0 where it is afocal. Whoever holds such light against the law takes this off first; so what is left is error.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.optics.rays import TraceResult
    from clacad.sheet.bundle import Bundle


def asked_power(window: Window) -> Floats:
    """D along both lens axes, (2,), 1/length; 0 of afocal pairs."""
    if "focus" not in window.recipe:
        return np.zeros(2)
    first, second = np.array(window.thin.focal_length)
    return np.asarray((first + second - window.thin.separation) / (first * second))


def less_focus(window: Window, points: Floats, direction: Floats) -> Floats:
    """Exit directions (n, 3), unit, less what was asked of the focus.

    points : (n, 2) lengths
        Where each ray crosses z = 0 from the centre of its cell.
    """
    return _with_slopes(window, direction, points)


def _with_slopes(window: Window, direction: Floats, points: Floats) -> Floats:
    """Directions (n, 3) whose slopes grow by D times `points` (n, 2), lengths."""
    power = asked_power(window)
    if not power.any():
        return direction
    turn = window.law.rotation
    lens = direction @ turn
    slopes = lens[:, :2] / lens[:, 2:] + (points @ turn[:2, :2]) * power
    made = np.column_stack([slopes, np.ones(len(slopes))]) @ turn.T
    return np.asarray(made / np.linalg.norm(made, axis=1)[:, None])


def asked_directions(window: Window, lit: Bundle) -> Floats:
    """What each ray of a bundle shall leave as, (n, 3), unit: by the law, and by the focus that was asked for."""
    out = window.law.refract(lit.rays.direction)
    return _with_slopes(window, out, -lit.points)


def held_to_law(window: Window, lit: Bundle, result: TraceResult) -> TraceResult:
    """What became of a bundle through one cell, its directions less what was asked of the focus."""
    if not asked_power(window).any():
        return result
    from dataclasses import replace

    return replace(result, direction=less_focus(window, lit.points, result.direction))
