"""Waves through a sheet's telescopelet in one direction, compared with its rays.

*Choice of method.* From Fresnel number 10 on, and with foci between the lenses, the pupil method: lens 1's
rim is then imaged sharply enough on lens 2. Below, or where a virtual focus leaves lens 1's rim without an
image, the angular spectrum of the ideal pair. Both are given where both can be computed; `far_field` is the
valid one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.optics.aperture import equivalent_widths
from clacad.sheet.vignetting import order_steps
from clacad.storage.errors import BadRequest, LimitRefused
from clacad.waves import exit_pupil
from clacad.waves.far_field import FarField, brightest, flatness, marginal, section
from clacad.waves.lens_planes import grid_for, propagate
from clacad.waves.lit_cell import LitSheet, situation
from clacad.waves.wave_report import WaveReport

if TYPE_CHECKING:
    from clacad.design import Design

SECONDS = 0.15
"""Processor seconds of all other work: prescription of the design, trial rays."""

SECONDS_TO_CHOOSE = 0.6
"""Processor seconds, in addition, to find the worst cell of a non-uniform sheet."""

SECONDS_A_COLUMN = 7e-8
"""Processor seconds per ray and cell that it passes over inside a body."""

MOST_COLUMNS = 1000
"""Largest number of cells that light may pass over inside a body; the rays then take about ten seconds."""

SECONDS_A_POINT = 0.25e-6
"""Processor seconds per grid point on the reference machine, for both planes and the propagation between
them.
"""


def wave(
    design: Design, field: Pair2 = (0.0, 0.0), wavelength: float | None = None, *, field_lens: bool = False
) -> WaveReport:
    """Wave through one telescopelet of a design: far field, Strehl ratio, share, compared with rays.

    Parameters
    ----------
    design : Design
    field : (x, y), radians
        Angles of the incident light off the middle of the field, along the sheet's x and y. In a non-uniform
        sheet the field is that of the worst cell.
    wavelength : float or None, metres
        None: the design's, 550 nm where it gives a bare index.
    field_lens : bool
        As if a lens at the common focus imaged lens 1 onto lens 2 (ideal lenses only).

    Returns
    -------
    WaveReport

    Raises
    ------
    BadRequest
        A direction for which no light obeys the law, a wavelength outside the material's data, or a field
        lens where the focus is virtual.
    LimitRefused
        The valid method needs a larger grid than is computed; the message names the method.
    DesignError, NoSuchLens
        The design cannot be built.
    """
    return look(situation(design, field, wavelength, field_lens=field_lens), design.name)


def look(lit: LitSheet, name: str) -> WaveReport:
    """As `wave`, for a window lit from one direction."""
    try:
        return _look(lit, name)
    except ValueError as why:
        raise why if isinstance(why, BadRequest) else BadRequest(str(why)) from why


def _columns(lit: LitSheet) -> float:
    """Number of cells that the light passes over inside a body.

    Raises
    ------
    LimitRefused
        More than `MOST_COLUMNS`.
    """
    crossed = exit_pupil.columns_crossed(lit.seen.window, lit.direction)
    if crossed > MOST_COLUMNS:
        raise LimitRefused(
            f"light of this direction passes over {crossed:.3g} cells inside the sheet, and it is followed"
            f" over {MOST_COLUMNS} at most: a larger lattice.pitch, a smaller pair.separation, or light"
            " nearer the sheet's normal"
        )
    return crossed


def _look(lit: LitSheet, name: str) -> WaveReport:
    _columns(lit)
    refused: dict[str, str] = {}
    exact, thin, thin_share, side = None, None, np.nan, exit_pupil.FEWEST
    sheet = lit.seen.window
    if lit.pupil_suits:
        side = exit_pupil.rays_needed(sheet, lit.direction, lit.wavelength, lit.own_cell)
    else:
        refused["pupil"] = lit.unsuited
    try:
        thin, thin_share = _thin(lit)
    except (LimitRefused, ValueError) as why:  # too large a grid, or crossed field lenses over rotated cells
        if not lit.pupil_suits:
            raise
        refused["angular spectrum"] = f"{why}; shares are those of rays"
    found = exit_pupil.pupil(sheet, lit.direction, lit.wavelength, side, lit.own_cell)
    if not found.alive.any():
        raise BadRequest("no light of this direction gets through the exact surfaces by the law")
    if lit.pupil_suits:
        exact = exit_pupil.far_field(found, lit.wave)
    slit = lit.wave / equivalent_widths(lit.lit)
    return WaveReport(
        name,
        lit.wavelength,
        lit.slope,
        lit.fresnel,
        _pair(slit),
        order_steps(lit.window.lattice, lit.wave),
        lit.field_lens,
        exact,
        thin,
        exit_pupil.rays_of(found, sheet, lit.direction, lit.wavelength, lit.own_cell),
        float(thin_share),
        lit.share,
        refused,
        None if lit.own_cell is None else (int(lit.seen.cell[0]), int(lit.seen.cell[1])),
        lit.seen.tried,
    )


def outlook(lit: LitSheet) -> dict[str, float]:
    """Forecast of `look`: rays and points along a side, processor seconds, bytes.

    Raises
    ------
    LimitRefused
        As `wave`.
    BadRequest
    """
    try:
        side = exit_pupil.FEWEST
        if lit.pupil_suits:
            side = exit_pupil.rays_needed(lit.seen.window, lit.direction, lit.wavelength, lit.own_cell)
        axes = [(0,), (1,)] if lit.along_axes else [(0, 1)]
        points = []
        try:
            for one in axes:
                slope = [lit.slope[k] for k in one]
                points += [grid_for(lit.planes(one), slope, lit.wave).points] * len(one)
        except (LimitRefused, ValueError):
            if not lit.pupil_suits:
                raise
    except ValueError as why:
        raise BadRequest(str(why)) from why
    columns = _columns(lit)
    held = 0.0 if not points else float(sum(points) if lit.along_axes else points[0] * points[1])
    return {
        "rays": float(side),
        "points": float(max(points, default=0)),
        "seconds": (
            SECONDS
            + (SECONDS_TO_CHOOSE if lit.seen.tried else 0.0)
            + SECONDS_A_POINT * held
            + (exit_pupil.SECONDS + SECONDS_A_COLUMN * columns) * side**2
        ),
        "bytes": 200.0 * side**2 + 80.0 * held,
    }


def _thin(lit: LitSheet) -> tuple[FarField, float]:
    """Far field and share of the ideal pair: axis by axis where cells allow it, else on a square grid."""
    widths = np.ptp(lit.lit, axis=0)
    if lit.along_axes:
        x, y = (propagate(lit.planes((k,)), (lit.slope[k],), lit.wave) for k in (0, 1))
        marginals = (
            marginal(x.field, 0, x.spacing, lit.wave, float(widths[0])),
            marginal(y.field, 0, y.spacing, lit.wave, float(widths[1])),
        )
        strehl = flatness(x.field) * flatness(y.field)
        points = (*x.points, *y.points)
        return FarField("angular spectrum", marginals, marginals, strehl, points), x.share * y.share
    both = propagate(lit.planes((0, 1)), lit.slope, lit.wave)
    step, turns = both.spacing, brightest(both.field)[1]
    a, b = (marginal(both.field, k, step, lit.wave, float(widths[k])) for k in (0, 1))
    c, d = (section(both.field, k, turns, step, lit.wave, float(widths[k])) for k in (0, 1))
    return FarField("angular spectrum", (a, b), (c, d), flatness(both.field), both.points), both.share


def _pair(values: Floats) -> Pair2:
    return float(values[0]), float(values[1])
