"""Every check by light of a window as built: the law, the transmitted share, confocality.

In a non-uniform sheet one cell represents all: the cell whose light leaves farthest from the law. It is
chosen from
a sample over the sheet and from the cells whose lenses lie farthest out. Light of that cell's own field is
traced
through the whole sheet, neighbours included.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.checks.check import Check, found_by
from clacad.checks.light_kinds import DELTA, ETA, TILT
from clacad.light.measure import Light
from clacad.optics.rays import Rays
from clacad.sheet.asked_focus import RequestedLaw
from clacad.sheet.window import Window
from clacad.tracing.worst_cell import SeenCell, through_all, tried_cells, worst_of
from clacad.verification.light.law_checks import (
    FIT_SCALE,
    POINT_RAYS,
    Lit,
    Optics,
    optics_of,
    turn_of,
)

if TYPE_CHECKING:
    from clacad.design import Design


def _named(seen: SeenCell, check: Check) -> Check:
    """The check with the cell named in its sentence."""
    if not seen.tried:
        return check
    i, j = seen.cell.tolist()
    words = f"in cell ({i}, {j}), the worst of {seen.tried} tried"
    if check.kind in (ETA, DELTA, TILT):
        words = f"over the light of {seen.tried} cells"
        laws = seen.window.cell_laws
        words += ", each taken by its own eta" if laws is not None and laws.ratios is not None else ""
    words += f": {check.sentence}"
    return replace(check, sentence=words, detail={**check.detail, "cell": [i, j], "tried": seen.tried})


def _fitted_over_all(optics: Optics, tried: list[SeenCell], field: float) -> Optics:
    """Optics with η, δ and turn fitted to light of the field centres of all cells, each lit in its own
    field.
    """
    rays, seen = through_all(tried, FIT_SCALE * field)
    into = Rays(rays.position, _as_in_the_middle(tried, rays.direction))
    narrow = Light(
        replace(optics.narrow.lit, rays=into, aperture=1.0), seen, RequestedLaw(tried[0].window.law), fewest=0
    )
    return replace(optics, narrow=narrow, turn=turn_of(narrow))


def _as_in_the_middle(tried: list[SeenCell], direction: Floats) -> Floats:
    """Directions (n, 3) of light of cells with their own laws, mapped to the equivalent input of the
    middle's law.

    With t' = (t − δ)/η, the effect of a cell on slope t equals that of the middle on (t − δ) η₀/η + δ₀.
    """
    law = tried[0].window.law
    if tried[0].window.cell_laws is None:
        return direction
    over = np.array(
        [[one.like.law.delta_x - law.delta_x, one.like.law.delta_y - law.delta_y] for one in tried]
    )
    lens, each = direction @ law.rotation, len(direction) // len(tried)
    if tried[0].window.cell_laws.ratios is None:
        lens[:, :2] -= np.repeat(over, each, axis=0) * lens[:, 2:]
    else:
        ratio = np.array([[law.eta_x / one.like.law.eta_x, law.eta_y / one.like.law.eta_y] for one in tried])
        shift = ratio * over + (ratio - 1.0) * (law.delta_x, law.delta_y)
        ratio, shift = (np.repeat(rows, each, axis=0) for rows in (ratio, shift))
        lens[:, :2] = ratio * lens[:, :2] - shift * lens[:, 2:]
    return np.asarray(lens @ law.rotation.T)


def judge_light(
    design: Design, window: Window, rays: int, point_rays: int = POINT_RAYS
) -> tuple[list[Check], Optics]:
    """Judge light through a window's exact surfaces by the limits of its design; rays as in `optics_of`."""
    tried = tried_cells(window, design.check.field)
    seen = worst_of(tried, design.check.field)
    optics = optics_of(design, seen.like, seen.send, rays, point_rays)
    if len(tried) > 1:
        optics = _fitted_over_all(optics, tried, design.check.field)
    lit = Lit(design, window, seen.like, optics)
    of_cell = [_named(seen, check) for judge in found_by("light") for check in judge(lit)]
    return [*of_cell, *(check for judge in found_by("sheet") for check in judge(lit))], optics
