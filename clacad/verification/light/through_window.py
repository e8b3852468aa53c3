"""Every check by light of a window as built: the law, what passes, confocality.

Where cells differ one of them is judged as a whole: that whose light leaves farthest from the law, of those whose lenses stand
farthest out and of a sample over the sheet. Its own field's light is sent through the whole sheet, neighbours and all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.optics.law import Law, angle_between
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.asked_focus import less_focus
from clacad.sheet.bundle import Bundle, bundle, central_cell
from clacad.sheet.like_cell import like_cell, outer_cells, sampled_cells
from clacad.sheet.window import Window
from clacad.tracing.trace import trace
from clacad.verification.checks import Check
from clacad.verification.light.field_lens_checks import field_lens_checks
from clacad.verification.light.image_checks import image_checks
from clacad.verification.light.law_checks import (
    FIT_SCALE,
    POINT_RAYS,
    Optics,
    confocality_check,
    law_checks,
    measure,
    throughput_check,
    turn_of,
)
from clacad.verification.light.viewed import viewed_check

if TYPE_CHECKING:
    from clacad.design import Design

TRIED_RAYS = 256
"""Rays through each cell from which the worst is chosen."""

FEWEST_TRIED = 8
"""Of them that must get through for a cell to be judged by where they go."""


@dataclass(frozen=True, eq=False)
class SeenCell:
    """One cell of a sheet: bundles are made for the sheet of equal cells like it, and sent through the sheet itself.

    Attributes
    ----------
    window : Window
        The sheet.
    like : Window
        Of equal cells; the sheet itself where its cells are alike.
    cell : (2,) ints
    tried : int
        Cells of which this is the worst; 0 where all are alike.
    """

    window: Window
    like: Window
    cell: Ints
    tried: int = 0

    def send(self, lit: Bundle) -> TraceResult:
        """Trace a bundle that was made for `like` through this cell of the sheet."""
        return trace(self.window, self.placed(lit).rays, path="size")

    def placed(self, lit: Bundle) -> Bundle:
        """A bundle that was made for `like`, before this cell of the sheet."""
        if self.like is self.window:
            return lit
        cell = (int(self.cell[0]), int(self.cell[1]))
        return replace(lit, cell=cell, rays=Rays(self.moved(lit), lit.rays.direction))

    def moved(self, lit: Bundle) -> Floats:
        """Starts (n, 3) of a bundle that was made for `like`, before this cell of the sheet."""
        apart = self.window.centres(0, self.cell) - self.like.centres(0, np.array(lit.cell))
        return np.asarray(lit.rays.position + [*apart, 0.0])

    def named(self, check: Check) -> Check:
        """The check, its sentence saying of which cell."""
        if not self.tried:
            return check
        i, j = self.cell.tolist()
        words = f"in cell ({i}, {j}), the worst of {self.tried} tried"
        if check.id in ("eta", "delta", "tilt"):
            words = f"over the light of {self.tried} cells"
        words += f": {check.sentence}"
        return replace(check, sentence=words, detail={**check.detail, "cell": [i, j], "tried": self.tried})


def worst_cell(window: Window, field: float) -> SeenCell:
    """The cell whose light of a cone (half angle `field`, radians) leaves farthest from the law, of those tried."""
    return worst_of(tried_cells(window), field)


def tried_cells(window: Window) -> list[SeenCell]:
    """The one cell of a sheet of equal cells; else those whose lenses stand farthest out, and a sample over the sheet."""
    if window.uniform:
        return [SeenCell(window, window, np.array(central_cell(window)))]
    cells = np.unique(np.concatenate([outer_cells(window), sampled_cells(window)]), axis=0)
    return [SeenCell(window, like_cell(window, cell, widest=False), cell, len(cells)) for cell in cells]


def worst_of(tried: list[SeenCell], field: float) -> SeenCell:
    """That through which next to no light gets, else whose light leaves farthest (rms) from the law."""
    if len(tried) == 1:
        return tried[0]
    rays, alive, direction = _through_all(tried, field)
    each = rays.direction.reshape(len(tried), -1, 3)
    asked = np.concatenate([one.like.law.refract(some) for one, some in zip(tried, each, strict=True)])
    error = np.where(alive, angle_between(direction, asked), np.nan).reshape(len(tried), -1)
    through = alive.reshape(len(tried), -1).sum(axis=1)
    dark = through < FEWEST_TRIED
    rms = np.sqrt(np.nansum(error**2, axis=1) / np.maximum(through, 1))
    return tried[int(np.argmax(np.where(dark, np.inf, rms)))]


def _through_all(tried: list[SeenCell], field: float) -> tuple[Rays, Bools, Floats]:
    """Rays through every cell of a sheet that is tried, as many through each; which are ALIVE, and where they go."""
    starts, rays, points = [], [], []
    for one in tried:
        lit = bundle(one.like, TRIED_RAYS, field)
        starts.append(one.moved(lit))
        rays.append(lit.rays.direction)
        points.append(lit.points)
    sent = Rays(np.concatenate(starts), np.concatenate(rays))
    result = trace(tried[0].window, sent, path="size")
    direction = less_focus(tried[0].window, np.concatenate(points), result.direction)
    return sent, result.fate == Fate.ALIVE, direction


def _fitted_over_all(optics: Optics, tried: list[SeenCell], field: float) -> Optics:
    """The same, η, δ and turn fitted to the light of the field centres of all cells: each cell is for its own light."""
    rays, alive, direction = _through_all(tried, FIT_SCALE * field)
    window = tried[0].window
    into, out = _as_in_the_middle(tried, rays.direction)[alive], direction[alive]
    lit = replace(optics.fit_bundle, rays=rays, aperture=1.0)
    try:
        fit = Law.fit(into, out, axes=window.law)
    except ValueError:  # too little light gets through, or it leaves without depending on how it came
        return replace(optics, fit=None, fit_bundle=lit, fit_rms=np.nan, fit_sigma={}, turn=None)
    turn = turn_of(into, out, window.law)
    return replace(optics, fit=fit.law, fit_bundle=lit, fit_rms=fit.rms, fit_sigma=fit.sigma, turn=turn)


def _as_in_the_middle(tried: list[SeenCell], direction: Floats) -> Floats:
    """Light (n, 3) of cells that each have a δ of their own, as it would have to come for the law of the sheet's middle.

    t' = (t − δ)/η, so what a cell does to slope t the middle does to t − δ + δ₀.
    """
    law = tried[0].window.law
    if tried[0].window.cell_laws is None:
        return direction
    over = np.array(
        [[one.like.law.delta_x - law.delta_x, one.like.law.delta_y - law.delta_y] for one in tried]
    )
    lens = direction @ law.rotation
    lens[:, :2] -= np.repeat(over, len(direction) // len(tried), axis=0) * lens[:, 2:]
    return np.asarray(lens @ law.rotation.T)


def judge_light(
    design: Design, window: Window, rays: int, point_rays: int = POINT_RAYS
) -> tuple[list[Check], Optics]:
    """Judge light through a window's exact surfaces by what its design asks; rays as `measure` has them."""
    tried = tried_cells(window)
    seen = worst_of(tried, design.check.field)
    optics = measure(design, seen.like, seen.send, rays, point_rays)
    if len(tried) > 1:
        optics = _fitted_over_all(optics, tried, design.check.field)
    found = [
        *law_checks(design, optics), throughput_check(design, seen.like, optics), confocality_check(design, seen.like)
    ]  # fmt: skip
    if window.thin.field:
        found += field_lens_checks(design, window, optics.main)
    return [
        *(seen.named(check) for check in found),
        viewed_check(design, window),
        *image_checks(design, window),
    ], optics
