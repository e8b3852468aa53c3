"""Diffraction at the lenslets, incoherent between cells.

*Model.* The light of one telescopelet leaves through a slit in each lens axis, as wide as the lit area: the
overlap of lens 1's image with the lens 2 that it reaches (for a cell rotated against the axes: the slit with
the same core). Each ray's exit direction cosines are changed by a draw from Fraunhofer's sinc²(π w Δ/λ).
Draws are deterministic.
*Law.* Draws follow the slit's pattern; the change vanishes as λ → 0. `clacad.waves`, which uses no draws,
checks it.
*On when* λ/w (first zero), axes in quadrature, exceeds the angle that matters. Below Fresnel number 1 the ray
picture itself is void (design error CL311).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import hypot

import numpy as np
from numpy.typing import NDArray

from clacad.base.text import nm_text
from clacad.base.types import Floats, Ints
from clacad.base.units import millimetres
from clacad.effects.engine.camera_light import turned_angles
from clacad.effects.engine.effect import (
    Bound,
    Declaration,
    Effect,
    FaceCrossing,
    RayBlock,
    Setting,
    Situation,
    When,
    uniform,
)
from clacad.optics.aperture import equivalent_widths
from clacad.optics.rays import NO_CELL, Fate
from clacad.sheet.vignetting import (
    ThinCells,
    arrivals,
    lit_zone,
    off_partner,
    partner_step,
    partner_zone,
    scale_of_image,
    thin_cells,
)
from clacad.sheet.window import Window

NAME = "diffraction"
SALT = 2
LOBES = 64
"""Number of tabulated lobes of sinc²; the tail beyond holds 0.3 % and follows 1/x."""


COST = 7.0
"""Time of the compiled trace with diffraction over without: slit and angle are drawn per ray, in numpy."""


def effect(window: Window, setting: Setting) -> Effect:
    """Change the directions of emerging rays."""
    cells = thin_cells(window)

    def apply(block: RayBlock, _: FaceCrossing | None) -> None:
        wave = block.air_wavelength / window.unit
        rows = np.flatnonzero(block.emerging())
        result = block.result
        widths = lit_widths(cells, block.rays.direction[rows], result.order[rows], result.cell[rows])
        u = uniform(block.rays, 2, setting.seed, SALT)[rows]
        turned = block.result.direction[rows] @ window.thin.rotation
        lateral = turned[:, :2] + wave / (np.pi * np.maximum(widths, wave)) * sinc_squared(u)
        beyond = (lateral * lateral).sum(axis=1)
        real = beyond < 1.0  # evanescent orders carry nothing; such rays keep their direction
        turned[real, :2] = lateral[real]
        turned[real, 2] = np.sqrt(1.0 - beyond[real])
        out = turned @ window.thin.rotation.T
        forwards = real & (out[:, 2] > 0.0)
        block.result.direction[rows[forwards]] = out[forwards]

    return Effect(NAME, When.EXIT, apply=apply)


def lit_widths(
    cells: ThinCells, direction: Floats, order: NDArray[np.int32], cell: NDArray[np.int32] | None = None
) -> Floats:
    """Lit width (m, 2) of lens 2 along the lens axes, lengths.

    `cell` (m, 2): the cells that the light passes.

    In the middle of the field it is the equivalent width of the lit area (`clacad.optics.aperture`). Off it,
    and for ghosts, it is reduced by as much as the overlap of the boxes around lens 1's image and the lenslet
    hit is narrower. Exact for cells along the axes.
    """
    image, zone = cells.image, partner_zone(cells)
    known = (order != NO_CELL).all(axis=1)
    if cell is not None and cells.window.many_sizes:
        return _lit_by_cell(cells, direction, order, np.where(known[:, None], cell, 0).astype(np.int64))
    steps = np.array([partner_step(cells, (1, 0)), partner_step(cells, (0, 1))])
    beside = np.where(known[:, None], order, 0).astype(np.float64) @ steps
    slopes = cells.slopes(direction)
    if cell is None or not cells.pair.second.own:
        shift = arrivals(cells, slopes) - (cells.centre + beside)
    else:
        index = np.where(known[:, None], cell, 0).astype(np.int64)
        shift = off_partner(cells, index, slopes) - beside
    near = np.maximum(zone.min(axis=0), image.min(axis=0) + shift)
    far = np.minimum(zone.max(axis=0), image.max(axis=0) + shift)
    whole = np.minimum(np.ptp(zone, axis=0), np.ptp(image, axis=0))
    overlap = np.where(known[:, None], np.clip(far - near, 0.0, None), whole)
    return np.asarray(overlap * (equivalent_widths(lit_zone(cells)) / whole))


def _lit_by_cell(cells: ThinCells, direction: Floats, order: NDArray[np.int32], index: Ints) -> Floats:
    """`lit_widths` of light through the cells `index` (m, 2) of a sheet whose cells have own η and images."""
    ratio = scale_of_image(cells, index)
    assert ratio is not None  # the caller has checked it
    widths = np.empty((len(index), 2))
    for scale in np.unique(ratio, axis=0):
        here = (ratio == scale).all(axis=(1, 2))
        widths[here] = lit_widths(replace(cells, image=cells.image @ scale.T), direction[here], order[here])
    return widths


def sinc_squared(u: Floats) -> Floats:
    """Map uniform numbers in (0, 1) to numbers distributed as sinc²(x)/π, (sin x/x)²; any shape."""
    known, share = _table()
    p = np.abs(u - 0.5)
    inner = np.interp(p, share, known)
    with np.errstate(divide="ignore"):
        tail = 1.0 / (2.0 * np.pi * np.maximum(0.5 - p, 1e-300))  # ∫ sin²/x² from X on → 1/(2X)
    return np.asarray(np.copysign(np.where(p > share[-1], tail, inner), u - 0.5))


@cache
def _table() -> tuple[Floats, Floats]:
    """Return x ≥ 0 and the share of sinc²/π between 0 and x."""
    x = np.linspace(0.0, LOBES * np.pi, 64 * LOBES + 1)
    middle = 0.5 * (x[1:] + x[:-1])
    values = [np.sinc(points / np.pi) ** 2 for points in (x[:-1], middle, x[1:])]
    area = (values[0] + 4.0 * values[1] + values[2]) / 6.0 * (x[1] - x[0])  # Simpson's rule
    share = np.concatenate([[0.0], np.cumsum(area)]) / np.pi
    # the tail beyond the table holds 1/(2πX): match it exactly
    return x, np.asarray(share * ((0.5 - 1.0 / (2.0 * np.pi * x[-1])) / share[-1]))


def bound(situation: Situation) -> Bound:
    """λ over the lit width (first zero of that slit), for the mean lit width of the rays that pass."""
    lines = situation.wavelengths
    if not lines:
        return Bound(0.0, 0.0, "neither design nor scene has a wavelength: not bounded", COST, known=False)
    window = situation.window
    passing = situation.probe.fate <= Fate.GHOST
    if not passing.any():
        return Bound(0.0, 0.0, "no light passes the sheet", COST)
    cells = thin_cells(window)
    probe = situation.probe
    widths = lit_widths(cells, situation.rays.direction[passing], probe.order[passing], probe.cell[passing])
    mean = widths.mean(axis=0)
    wave = max(lines)
    angle = hypot(*(wave / (mean * window.unit)))
    why = (
        f"lit slits of {mean[0] * millimetres(window.unit):.3g} by {mean[1] * millimetres(window.unit):.3g}"
        f" mm spread {nm_text(wave, 0, fixed=True)} light by {angle:.2g} rad"
    )
    return Bound(angle, 0.0, why, COST)


def measured(situation: Situation) -> tuple[float, float]:
    """Angle that contains half of the light."""
    return float(np.median(turned_angles(situation, NAME))), 0.0


DECLARED = Declaration(NAME, effect, bound, measured, waves=True)
