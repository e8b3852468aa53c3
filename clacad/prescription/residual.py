"""Residual of a recipe: law error and decollimation of a built window along its axis ray."""

from __future__ import annotations

from math import inf

import numpy as np

from clacad.base.types import Floats
from clacad.optics.law import angle_between
from clacad.optics.parabasal import STEP, parabasal
from clacad.sheet.asked_focus import asked_power
from clacad.sheet.telescopelet import interfaces
from clacad.sheet.window import Window


def residual(window: Window, rotation: Floats, origin: Floats, asked: Floats) -> dict[str, float]:
    """Parabasal law error (radians) and decollimation over half a cell (radians) of a window, minus requested
    power.

    Parameters
    ----------
    rotation : (3, 3)
        Lens → sheet of the requested law: its axis is the axis ray before the window.
    origin : (3,)
        A point of the axis ray, sheet frame, lengths.
    `asked` : (3,) unit
        Direction of the axis ray behind the window by the law.

    Returns
    -------
    dict
        Both are infinite where the axis ray is lost.
    """
    found = parabasal(interfaces(window), rotation, origin, STEP * window.lattice.circumradius)
    if not (np.isfinite(found.direction).all() and np.isfinite(found.cosines).all()):
        # the axis ray misses a lens or is totally reflected:
        # the window is built and fails its checks, no error here
        return {"law": inf, "decollimation": inf}
    half = 0.5 * max(window.lattice.pitch)
    return {
        "law": float(angle_between(found.direction, asked)),
        "decollimation": float(np.linalg.norm(found.cosines + np.diag(asked_power(window)), 2)) * half,
    }
