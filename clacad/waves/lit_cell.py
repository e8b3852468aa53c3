"""A sheet's telescopelet in light of one direction, prepared for waves.

In a non-uniform sheet it is the worst cell, by which the whole sheet is judged (`tracing/worst_cell.py`). It
is lit along the middle of its own field. Its rays go through the whole sheet, and its lens 2 has the rim of
its own array.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot, tan
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.polygons import clip, polygon_area
from clacad.base.types import Floats, Ints, Pair2
from clacad.sheet.asked_focus import asked_power
from clacad.sheet.vignetting import (
    ThinCells,
    aperture_slope,
    focal_ratio,
    fresnel_numbers,
    half_field,
    partner_zone,
    thin_cells,
)
from clacad.sheet.window import Window
from clacad.storage.errors import BadRequest
from clacad.tracing.worst_cell import SeenCell, worst_cell
from clacad.waves.lens_planes import LensPlane, telescope

if TYPE_CHECKING:
    from clacad.design import Design

HOLDS = 10.0
"""Least Fresnel number of the pupil method: rays to the partner are then accurate within 5 % per axis."""

ALONG = 1e-9
"""Tolerance, relative to a cell, within which its rim counts as parallel to the lens axes."""


@dataclass(frozen=True, eq=False)
class LitSheet:
    """A window lit from one direction; its numbers are computed on demand.

    seen : SeenCell
        The cell, in its sheet.
    direction : (3,) unit, sheet frame
    wavelength : float, metres
    field_lens : bool
        Whether a lens at the common focus images lens 1 onto lens 2, built or imagined.
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


def situation(
    design: Design, field: Pair2 = (0.0, 0.0), wavelength: float | None = None, *, field_lens: bool = False
) -> LitSheet:
    """A cell of a design's window lit from one direction; invalid requests are refused.

    Parameters
    ----------
    design : Design
    field : (x, y), radians
        Angles off the middle of the cell's field along the sheet's x and y.
    wavelength : float or None, metres
        None: the design's.
    field_lens : bool
        As if a lens were mounted at the common focus.

    Raises
    ------
    BadRequest
        An invalid wavelength or angle, or a direction for which no light obeys the law.
    LimitRefused, DesignError, NoSuchLens
    """
    from clacad.exporting.limits import refuse_uncountable
    from clacad.prescription.prescribe import prescribe
    from clacad.sheet.feasibility.derived_numbers import DEFAULT_WAVELENGTH

    refuse_uncountable(design)
    sheet = prescribe(design)
    if asked_power(sheet).any():
        raise BadRequest(
            "pair.focus: light of such pairs meets at the image, not far away; clacad image says how sharply,"
            " and waves are computed of afocal pairs"
        )
    seen = worst_cell(sheet, design.check.field)
    window = seen.like
    wave = wavelength or window.wavelength or DEFAULT_WAVELENGTH
    slope = [middle + tan(angle) for middle, angle in zip(aperture_slope(window), field, strict=True)]
    direction = np.array([*slope, 1.0]) / hypot(*slope, 1.0)
    found = LitSheet(seen, direction, wave, field_lens)
    if found.built:
        found = replace(found, field_lens=True)
    if len(found.lit) == 0:
        x, y = (f"{1e3 * half:.3g}" for half in half_field(found.cells))
        raise BadRequest(
            f"no light of slope {found.slope[0]:.4g}, {found.slope[1]:.4g} obeys the law: the field ends {x}"
            f" and {y} mrad off its middle along lens x and y"
        )
    return found
