"""Waves through a sheet's telescopelet in one direction, compared with its rays.

*Choice of method.* From Fresnel number 10 on, and with foci between the lenses, the pupil method: lens 1's
rim is then imaged sharply enough on lens 2. Below, or where a virtual focus leaves lens 1's rim without an
image, the angular spectrum of the ideal pair. Both are given where both can be computed; `far_field` is the
valid one.

*The telescopelet.* In a non-uniform sheet it is the worst cell, by which the whole sheet is judged
(`tracing/worst_cell.py`). It is lit along the middle of its own field. Its rays go through the whole sheet,
and its lens 2 has the rim of its own array.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot, tan
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.polygons import clip, polygon_area
from clacad.base.text import mrad_text
from clacad.base.types import Floats, Ints, Pair2
from clacad.base.vectors import xy
from clacad.optics.aperture import equivalent_widths
from clacad.sheet.bundle import asked_power
from clacad.sheet.vignetting import (
    ThinCells,
    aperture_slope,
    focal_ratio,
    fresnel_numbers,
    half_field,
    order_steps,
    partner_zone,
    thin_cells,
)
from clacad.sheet.window import Window
from clacad.storage.errors import BadRequest, LimitRefused
from clacad.tracing.worst_cell import SeenCell, worst_cell
from clacad.waves import exit_pupil
from clacad.waves.exit_pupil import FarField, brightest, flatness, marginal, section
from clacad.waves.lens_planes import LensPlane, grid_for, propagate, telescope
from clacad.waves.wave_report import WaveReport

if TYPE_CHECKING:
    from clacad.design import Design


HOLDS = 10.0
"""Least Fresnel number of the pupil method: rays to the partner are then accurate within 5 % per axis."""

ALONG = 1e-9
"""Tolerance, relative to a cell, within which its rim counts as parallel to the lens axes."""


@dataclass(frozen=True, eq=False)
class LitSheet:
    """A window lit from one direction; its numbers are computed on demand.

    seen : The cell, in its sheet.
    direction : (3,) unit, sheet frame
    wavelength : metres
    field_lens : Whether a lens at the common focus images lens 1 onto lens 2, built or imagined.
    """

    seen: SeenCell
    direction: Floats
    wavelength: float
    field_lens: bool = False

    @property
    def window(self) -> Window:
        """The uniform equivalent of this cell; the sheet itself if it is uniform."""
        return self.seen.like

    @property
    def own_cell(self) -> Ints | None:
        """Index (2,) of the cell in a non-uniform sheet, else None."""
        return self.seen.cell if self.seen.tried else None

    @cached_property
    def cells(self) -> ThinCells:
        """One telescopelet as thin lenses with cells."""
        return thin_cells(self.window)

    @cached_property
    def rim(self) -> Floats:
        """Optical zone of lens 2 (m, 2) about the middle of its own cell, lengths."""
        return partner_zone(thin_cells(self.seen.window))

    @property
    def built(self) -> bool:
        """Whether the window itself has lenses at the common focus."""
        return bool(self.window.thin.field)

    @property
    def wave(self) -> float:
        """Wavelength in the window's unit."""
        return self.wavelength / self.window.unit

    @property
    def slope(self) -> Pair2:
        """Slope of the light along lens x and y."""
        x, y = self.cells.slopes(self.direction[None, :])[0]
        return float(x), float(y)

    @cached_property
    def fresnel(self) -> Pair2:
        """Fresnel numbers along lens x and y."""
        return fresnel_numbers(self.cells, self.wave, clip(self.cells.image, self.rim))

    @property
    def pupil_suits(self) -> bool:
        """Whether the pupil method is valid: real foci, Fresnel numbers of at least `HOLDS`."""
        powered = [
            m
            for m, f in zip(focal_ratio(self.window.thin), self.window.thin.focal_length[1], strict=True)
            if np.isfinite(f)
        ]
        return (
            (not self.field_lens or self.built)
            and min(self.fresnel) >= HOLDS
            and all(m < 0.0 for m in powered)
        )

    @property
    def along_axes(self) -> bool:
        """Whether the sides of cells are parallel to the lens axes, so that the axes are independent."""
        zone = self.cells.zone  # array 2's has the same directions
        half = 0.5 * np.ptp(zone, axis=0)
        return len(zone) == 4 and bool((np.abs(np.abs(zone) - half) <= ALONG * half).all())

    def planes(self, axes: tuple[int, ...]) -> list[LensPlane]:
        """The thin pair along some of the lens axes."""
        cells, pair = self.cells, self.window.thin
        rows = list(axes)
        vertex = (np.asarray(pair.offset) @ pair.rotation)[rows].tolist()
        zone, rim = (
            one[:, rows] if len(rows) == 2 else _ends(one[:, rows]) for one in (cells.zone, self.rim)
        )
        first, second = (tuple(one[k] for k in rows) for one in pair.focal_length)
        return telescope(
            (first, second),
            cells.centre[rows].tolist(),
            vertex,
            cells.separation,
            zone,
            rim,
            field_lens=self.field_lens,
        )

    @property
    def unsuited(self) -> str:
        """Reason why the pupil method is not valid."""
        if self.field_lens and not self.built:
            return "the sheet as built has no field lens to trace"
        if min(self.fresnel) < HOLDS:
            return (
                f"Fresnel number {min(self.fresnel):.3g}: below {HOLDS:g} lens 1's rim blurs what lens 2 lets"
                " through"
            )
        return "a focus is virtual: lens 1's rim is not imaged near lens 2"

    @property
    def share(self) -> float:
        """Share of the light on lens 1's optical zone that reaches the partner, by rays and ideal lenses."""
        return abs(polygon_area(self.lit) / polygon_area(self.cells.image))

    @cached_property
    def lit(self) -> Floats:
        """Lit part of lens 2 (m, 2), lengths; empty where no light obeys the law."""
        moved = np.asarray(self.cells.separation * np.array(self.slope)) - self.cells.centre
        image = self.cells.image
        if self.field_lens:  # lens 1 is imaged onto the partner, for any direction of the light
            focus = np.array([f / self.cells.separation for f in self.window.thin.focal_length[0]])
            met = focus * moved
            return (
                clip(image, self.rim)
                if (np.abs(met) <= 0.5 * np.ptp(self.cells.zone, axis=0)).all()
                else image[:0]
            )
        return clip(image + moved, self.rim)


def _ends(points: Floats) -> Floats:
    return np.array([points.min(axis=0), points.max(axis=0)])


NOT_AFOCAL = (
    "pair.focus: light of such pairs meets at the image, not far away; clacad image says how sharply,"
    " and waves are computed of afocal pairs"
)


def situation(
    design: Design, field: Pair2 = (0.0, 0.0), wavelength: float | None = None, *, field_lens: bool = False
) -> LitSheet:
    """A cell of a design's window lit from one direction; invalid requests are refused.

    field : (x, y), radians. Angles off the middle of the cell's field along the sheet's x and y.
    wavelength : float or None, metres. None: the design's.
    field_lens : As if a lens were mounted at the common focus.
    Raises BadRequest: An invalid wavelength or angle, or a direction for which no light obeys the law.
    Raises LimitRefused, DesignError, NoSuchLens.
    """
    from clacad.exporting.limits import refuse_uncountable
    from clacad.prescription.prescribe import prescribe
    from clacad.sheet.feasibility.derived_numbers import DEFAULT_WAVELENGTH

    refuse_uncountable(design)
    sheet = prescribe(design)
    if asked_power(sheet).any():
        raise BadRequest(NOT_AFOCAL)
    seen = worst_cell(sheet, design.check.field)
    window = seen.like
    wave = wavelength or window.wavelength or DEFAULT_WAVELENGTH
    slope = [middle + tan(angle) for middle, angle in zip(aperture_slope(window), field, strict=True)]
    direction = np.array([*slope, 1.0]) / hypot(*slope, 1.0)
    found = LitSheet(seen, direction, wave, field_lens)
    if found.built:
        found = replace(found, field_lens=True)
    _refuse_dark(found)
    return found


def _refuse_dark(found: LitSheet) -> None:
    """Refuse a direction for which no light obeys the law."""
    if len(found.lit) == 0:
        x, y = (mrad_text(half, 3, unit="") for half in half_field(found.cells))
        raise BadRequest(
            f"no light of slope {found.slope[0]:.4g}, {found.slope[1]:.4g} obeys the law: the field ends {x}"
            f" and {y} mrad off its middle along lens x and y"
        )


SECONDS = 0.15
"""Processor seconds of all other work: prescription of the design, trial rays."""

SECONDS_TO_CHOOSE = 0.6
"""Processor seconds, in addition, to find the worst cell of a non-uniform sheet."""

SECONDS_A_COLUMN = 7e-8
"""Processor seconds per ray and cell that it passes over inside a body."""

MOST_COLUMNS = 1000
"""Largest number of cells that light may pass over inside a body; the rays then take about ten seconds."""

SECONDS_A_POINT = 0.25e-6
"""Processor seconds per grid point on the reference machine: both planes and the propagation between."""


def wave(
    design: Design, field: Pair2 = (0.0, 0.0), wavelength: float | None = None, *, field_lens: bool = False
) -> WaveReport:
    """Send light as a wave through one telescopelet of a design: far field, Strehl ratio and share, next
    to those of rays.

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

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> clacad.wave(design)
    WaveReport('slab', pupil, Fresnel number 22.7, share 0.933)
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

    Raises LimitRefused: More than `MOST_COLUMNS`.
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
        xy(slit),
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

    Raises LimitRefused: As `wave`.
    Raises BadRequest.
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
