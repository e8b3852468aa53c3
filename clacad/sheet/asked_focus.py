"""Effect of pairs that image sharply (`[pair] focus`) on parallel light: requested power in addition to the
law.

A ray that enters lens 1 at C1 + ξ leaves with t' = (t − δ)/η − D ξ along each lens axis. D = 1/f1 + 1/f2 −
s/(f1 f2) is the power of the pair, 0 for an afocal pair. Code that compares such light with the law subtracts
D ξ first (`RequestedLaw`); the rest is error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.optics.law import Law
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.sheet.bundle import Bundle


def asked_power(window: Window) -> Floats:
    """D along both lens axes, (2,), 1/length; 0 for afocal pairs."""
    if "focus" not in window.recipe:
        return np.zeros(2)
    first, second = np.array(window.thin.focal_length)
    return np.asarray((first + second - window.thin.separation) / (first * second))


@dataclass(frozen=True, eq=False)
class RequestedLaw:
    """Law and power of the pair that light through one cell is compared with.

    Parameters
    ----------
    law : Law
    power : (2,) 1/length or None
        D along both lens axes; None for an afocal pair.
    """

    law: Law
    power: Floats | None = None

    @staticmethod
    def of(window: Window) -> RequestedLaw:
        """Requested law of a window."""
        power = asked_power(window)
        return RequestedLaw(window.law, power if power.any() else None)

    def refract(self, direction: Floats) -> Floats:
        """Exit directions (n, 3) of the law; NaN where it has no answer."""
        return self.law.refract(direction)

    def without_focus(self, points: Floats, direction: Floats) -> Floats:
        """Exit directions (n, 3), unit, without the effect of the requested focus.

        points : (n, 2) lengths
            Point where each ray crosses z = 0, relative to the centre of its cell.
        """
        if self.power is None:
            return direction
        turn = self.law.rotation
        lens = direction @ turn
        slopes = lens[:, :2] / lens[:, 2:] + (points @ turn[:2, :2]) * self.power
        made = np.column_stack([slopes, np.ones(len(slopes))]) @ turn.T
        return np.asarray(made / np.linalg.norm(made, axis=1)[:, None])

    def expected(self, lit: Bundle) -> Floats:
        """Exit directions (n, 3), unit, of a bundle: the law and the requested focus."""
        return self.without_focus(-lit.points, self.refract(lit.rays.direction))
