"""The cheapest rung whose picture of a scene agrees with the exact surfaces within the tolerance."""

from __future__ import annotations

from typing import cast

import numpy as np

from clacad.base.types import Floats, Ints, Rung
from clacad.effects.engine.bounds import Situation
from clacad.optics.rays import Fate, Rays
from clacad.sheet.vignetting import focal_ratio, thin_cells
from clacad.sheet.window import Window

COVERED = 2.0
"""Number of lenslets across a pixel from which on a picture does not resolve them."""


def choose_rung(situation: Situation, asked: str) -> tuple[Rung, str]:
    """The requested rung, or for "auto" the cheapest whose error does not matter, and the reason.

    Notes
    -----
    Law, the homogeneous sheet with the closed-form share of the light, requires: unresolved lenslets,
    direction and share correct on the scene's own rays, and a negligible lateral displacement of light at the
    sheet. Thin requires correct directions and fates on those rays. Otherwise the exact surfaces are used.
    """
    if asked != "auto":
        return cast("Rung", asked), "as asked"
    if not len(situation.met):
        return "law", "the camera does not see the sheet"
    refused, why = homogeneous(situation)
    if not refused:
        return "law", why
    rms, disagree = compared(situation, "thin")
    if rms <= situation.angle and disagree <= situation.radiance:
        return (
            "thin",
            f"{refused}; ideal lenslets are off by {1e3 * rms:.2g} mrad and {disagree:.2%} of fates",
        )
    return "surfaces", (
        f"{refused}; ideal lenslets are off by {1e3 * rms:.2g} mrad and {disagree:.2%} of fates, "
        f"{1e3 * situation.angle:.2g} mrad and {situation.radiance:.2%} are allowed"
    )


def homogeneous(situation: Situation) -> tuple[str, str]:
    """Reason against the homogeneous sheet ("" if none), and reason for it."""
    window = situation.window
    if window.many_sizes:
        return "light of a cell that meets a neighbour's lens 2, of another size, obeys no law", ""
    pitch = max(window.lattice.pitch)
    covered = situation.pixel * situation.sheet_distance / pitch if situation.pixel > 0.0 else 0.0
    if covered < COVERED:
        return f"a pixel covers {covered:.2g} lenslets, which can be seen", ""
    step = max(abs(1.0 - m) * min(1.0, 1.0 / abs(m)) for m in focal_ratio(window.thin)) * pitch
    seen = step / situation.sheet_distance
    if seen > situation.angle:
        return f"light steps aside by {seen:.2g} rad as seen from the camera", ""
    rms, _ = compared(situation, "law")
    if rms > situation.angle:
        return f"lenslets miss the law by {1e3 * rms:.2g} mrad", ""
    gap = share_gap(situation)
    if gap > situation.radiance:
        return f"the closed-form share of the light is off by {gap:.2%}", ""
    return "", (
        f"a pixel covers {covered:.2g} lenslets and nothing shows them singly: the law ({1e3 * rms:.2g} mrad off) "
        f"with the closed-form share of the light ({gap:.2%} off)"
    )


def share_gap(situation: Situation) -> float:
    """Difference of the partner's share, closed form minus counted, mean over the scene's rays."""
    from clacad.effects.engine.homogeneous_light import shares

    cells = thin_cells(situation.window)
    index = None if situation.window.uniform else cells_met(situation.window, situation.rays)[situation.met]
    closed = float(shares(cells, situation.slopes, (0, 0), index).mean())
    return abs(closed - situation.share(Fate.ALIVE))


def cells_met(window: Window, rays: Rays) -> Ints:
    """Cells (n, 2) of array 0 in which rays cross z = 0."""
    step = rays.position[:, 2:] / rays.direction[:, 2:]
    return window.lattice.locate(*(rays.position[:, :2] - step * rays.direction[:, :2]).T)[0]


def compared(situation: Situation, rung: Rung) -> tuple[float, float]:
    """Rms angle of a rung against the surfaces where both are ALIVE, and the share of rays whose fate differs."""
    from clacad.tracing.trace import trace

    truth = situation.probe
    result = trace(situation.window, situation.rays, rung, path="size")
    both = (truth.fate == Fate.ALIVE) & (result.fate == Fate.ALIVE)
    disagree = float(np.mean(truth.fate != result.fate))
    return rms_angle(truth.direction[both], result.direction[both]), disagree


def rms_angle(a: Floats, b: Floats) -> float:
    """Root mean square angle between unit directions (n, 3), small angles; 0 for none."""
    if not len(a):
        return 0.0
    across = np.cross(a, b)
    return float(np.sqrt(np.mean((across * across).sum(axis=1))))
