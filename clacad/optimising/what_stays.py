"""Properties that a search must preserve: the plates, the cells, and the light that reaches its partner cell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clacad.base.types import Floats
from clacad.config.design_error import DesignError
from clacad.config.mistakes import Mistake
from clacad.design.keys import PAIR
from clacad.optimising.light_in_cells import MOST_LOST
from clacad.optimising.measured_light import Seen
from clacad.sheet.window import Window

SAME = 1e-12
"""Tolerance of positions as a share of the separation: rounding error of the recipes."""


def refuse_lost_light(before: Sequence[Seen], after: Sequence[Seen]) -> None:
    """Refuse faces that lose more than `MOST_LOST` of the light of a cone, compared with the start.

    Raises
    ------
    DesignError
    """
    if not after:
        return
    worst = max(zip(before, after, strict=True), key=lambda pair: pair[0].throughput - pair[1].throughput)
    was, now = (seen.throughput for seen in worst)
    if not was - now <= MOST_LOST:
        raise DesignError([
            Mistake("CL120", f"the faces that were found take {now:.3f} of the light of a cone of {np.degrees(worst[0].field):.3g} deg "
                    f"to its partner cell, the start {was:.3f}; nothing is written", "free", allowed=f"a loss of at most {MOST_LOST:g}",
                    hint="fewer words of --free, or a smaller field")
        ])  # fmt: skip


def refuse_moved(start: Window, found: Window, *, traced: bool) -> None:
    """Refuse a design whose plates, vertices or cells have moved from those of the start.

    Parameters
    ----------
    start, found : Window
    traced : bool
        Whether tracing places the vertices of lens 2 in their cells; then only their heights are compared.

    Raises
    ------
    DesignError
    """
    apart = np.abs(_places(found, traced=traced) - _places(start, traced=traced)).max()
    if not apart <= SAME * start.thin.separation:
        raise DesignError([
            Mistake("CL120", f"the plates or cells would move by {apart:.3g}; nothing is written", PAIR.separation,
                    allowed="plates and cells that stay where the start has them", hint='pair.confocal = "exact" in the design to start from')
        ])  # fmt: skip


def _places(window: Window, *, traced: bool) -> Floats:
    """Lengths that fix the plates and cells: vertices of all faces, or only their heights, and displacements of arrays."""
    vertices = np.array([face.vertex for face in window.faces])
    return np.concatenate([(vertices[:, 2:] if traced else vertices).ravel(), np.ravel(window.shifts)])
