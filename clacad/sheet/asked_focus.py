"""Effect of pairs that image sharply (`[pair] focus`) on parallel light: requested power in addition to the
law.

A ray that enters lens 1 at C1 + ξ leaves with t' = (t − δ)/η − D ξ along each lens axis. D = 1/f1 + 1/f2 −
s/(f1 f2) is the power of the pair, 0 for an afocal pair. Code that compares such light with the law subtracts
D ξ first; the rest is error.
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
    """D along both lens axes, (2,), 1/length; 0 for afocal pairs."""
    if "focus" not in window.recipe:
        return np.zeros(2)
    first, second = np.array(window.thin.focal_length)
    return np.asarray((first + second - window.thin.separation) / (first * second))


def less_focus(window: Window, points: Floats, direction: Floats) -> Floats:
    """Exit directions (n, 3), unit, without the effect of the requested focus.

    points : (n, 2) lengths
        Point where each ray crosses z = 0, relative to the centre of its cell.
    """
    return _with_slopes(window, direction, points)


def _with_slopes(window: Window, direction: Floats, points: Floats) -> Floats:
    """Directions (n, 3) with D times `points` (n, 2), lengths, added to their slopes."""
    power = asked_power(window)
    if not power.any():
        return direction
    turn = window.law.rotation
    lens = direction @ turn
    slopes = lens[:, :2] / lens[:, 2:] + (points @ turn[:2, :2]) * power
    made = np.column_stack([slopes, np.ones(len(slopes))]) @ turn.T
    return np.asarray(made / np.linalg.norm(made, axis=1)[:, None])


def asked_directions(window: Window, lit: Bundle) -> Floats:
    """Expected exit directions (n, 3), unit, of a bundle: the law and the requested focus."""
    out = window.law.refract(lit.rays.direction)
    return _with_slopes(window, out, -lit.points)


def held_to_law(window: Window, lit: Bundle, result: TraceResult) -> TraceResult:
    """Trace result of a bundle through one cell, its directions without the effect of the requested focus."""
    if not asked_power(window).any():
        return result
    from dataclasses import replace

    return replace(result, direction=less_focus(window, lit.points, result.direction))
