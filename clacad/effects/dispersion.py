"""Dispersion: each line of the light has its own refractive index.

*Model.* One pass per wavelength of the scene's or the design's spectrum (`Setting.wavelengths` and `weights`,
read by `clacad.design.sections.lines_of`), n(λ) of each body's material; no index outside the material's
data. In a trace, one row per ray, rays without a wavelength take the lines in turn, each as often as its
weight.
*Law.* A constant index changes nothing, and light of the design wavelength is unchanged.
*On when* there is more than one line and the growth of the largest direction error exceeds the angle that
matters: per lens axis ε |1 − m|/|m| (x − u)/s, x and u where the light crosses lens 1 and 2, ε = max |n(λ) −
n0|/(n0 − 1) (derivative of the thin pair; m = −f2/f1). *Cost* the number of lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot

import numpy as np
from numpy.typing import NDArray

from clacad.effects.engine.camera_light import MOST, traced_with
from clacad.effects.engine.effect import Bound, Declaration, Effect, Setting, Situation, When
from clacad.light.compare import angles
from clacad.light.measure import measure
from clacad.optics.rays import Fate, Rays
from clacad.sheet.bundle import RequestedLaw, of_rays
from clacad.sheet.vignetting import aperture_slope, focal_ratio, thin_cells
from clacad.sheet.window import Window

NAME = "dispersion"


def effect(window: Window, setting: Setting) -> Effect:
    """Assign the lines of the light in turn to rays without a wavelength."""
    lines = setting.wavelengths

    def launch(_: Window, rays: Rays) -> Rays:
        if not lines or rays.wavelength is not None:
            return rays
        return Rays(rays.position, rays.direction, np.array(lines)[turns(setting.weights, lines, len(rays))])

    return Effect(NAME, When.LAUNCH, launch=launch)


def turns(weights: Sequence[float], lines: Sequence[float], count: int) -> NDArray[np.intp]:
    """Line (count,) of each of several rays: any first rays take the lines in the ratio of their weights.

    A line of the share w of the light has its turns at (k + 1/2)/w, k = 0, 1, …; weights () are all equal.
    """
    share = np.array(weights or [1.0] * len(lines)) / sum(weights or [1.0] * len(lines))
    many = np.minimum(count, np.ceil(share * count).astype(np.intp) + 1)
    which = np.repeat(np.arange(len(lines)), many)
    turn = np.concatenate([np.arange(k) + 0.5 for k in many]) / share[which]
    return which[np.argsort(turn, kind="stable")[:count]]


def spread(window: Window, wavelengths: Sequence[float]) -> float:
    """Largest relative change of power, ε = max |n(λ) − n0|/(n0 − 1) over lines and bodies."""
    changes = [
        abs(body.index_at(wave) - body.index) / (body.index - 1.0)
        for body in window.bodies
        for wave in wavelengths
    ]
    return max(changes, default=0.0)


def bound(situation: Situation) -> Bound:
    """First-order growth of the direction error over the rays of the scene."""
    window, lines = situation.window, situation.wavelengths
    if len(lines) < 2:
        return Bound(0.0, 0.0, "the light has one wavelength", 1.0)
    epsilon = spread(window, lines)
    if epsilon == 0.0:
        return Bound(0.0, 0.0, f"the index is the same at all {len(lines)} wavelengths", float(len(lines)))
    cells = thin_cells(window)
    centre = cells.slopes(np.array([[*aperture_slope(window), 1.0]]))[0]
    ghosts = situation.share(Fate.GHOST) > 0.0
    turns = []
    for axis, m in enumerate(focal_ratio(window.thin)):
        width = float(np.ptp(cells.zone[:, axis]))
        reach = float(np.abs(situation.slopes[:, axis] - centre[axis]).max(initial=0.0))
        aim = offset_slope(window, axis, m, centre[axis])
        turns.append(epsilon * largest_turn(width / cells.separation, m, reach, aim, ghosts))
    tilt = tilt_term(window, epsilon)
    angle = 1.05 * hypot(*turns) + tilt
    why = (
        f"n changes by {epsilon:.2%} of n − 1 over {len(lines)} lines, which turns light by up to"
        f" {angle:.2g} rad"
    )
    return Bound(angle, 0.0, why, float(len(lines)))


def largest_turn(ratio: float, m: float, reach: float, aim: float, ghosts: bool) -> float:
    """Largest |1 − m|/|m| |x − u|/s for light within `reach` of the field's middle.

    x − u = (1 − m) x − s τ, |x| ≤ p/2, τ the slope off the pair's own undeviated slope t0; for light that
    stays with its partner |u − u0| ≤ p/2 too.
    """
    half = 0.5 * ratio
    x = half if ghosts else min(half, (half + reach) / abs(m))
    most = abs(1.0 - m) * x + reach
    if not ghosts:
        most = min(most, ratio)
    return abs(1.0 - m) / abs(m) * (most + aim)


def offset_slope(window: Window, axis: int, m: float, centre: float) -> float:
    """Distance of the field's middle from the slope that both lens centres pass undeviated."""
    if m == 1.0:
        return 0.0
    offset = np.asarray(window.thin.offset) @ window.thin.rotation
    return abs(centre - float(offset[axis]) / window.thin.separation)


def tilt_term(window: Window, epsilon: float) -> float:
    """Rotation of a plano pair's tilted axis by its plane faces as the index changes: Δn θ s/(f1 |m|)."""
    if window.form == "biconvex":
        return 0.0
    theta = float(np.arccos(np.clip(window.thin.rotation[2, 2], -1.0, 1.0)))
    index = max(body.index for body in window.bodies)
    power = max(
        window.thin.separation / abs(f1 * m)
        for f1, m in zip(window.thin.focal_length[0], focal_ratio(window.thin), strict=True)
    )
    return epsilon * (index - 1.0) * theta * power


def measured(situation: Situation) -> tuple[float, float]:
    """Largest angle of 99 % of the light that keeps its order, over the wavelengths."""
    from clacad.tracing.trace import trace

    window = situation.window
    light = measure(
        lambda lit: trace(window, lit.rays, path="size"),
        of_rays(situation.rays),
        RequestedLaw(window.law),
        situation.wavelengths,
    )
    base = traced_with(situation)
    turned = [angles(base, line.seen, Fate.GHOST) for line in light.lines]
    worst = max((float(np.quantile(one, MOST)) for one in turned if len(one)), default=0.0)
    return worst, 0.0


DECLARED = Declaration(NAME, effect, bound, measured, lines=True)
