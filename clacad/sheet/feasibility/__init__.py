"""Derived numbers of a window for makers and users: computed, never assumed.

All numbers are computed from the window's own faces and therefore describe the written part. Lengths are in
the window's unit unless a name ends in `_m` (metres); angles in radians; slopes are tangents.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Ints
from clacad.optics.aperture import equivalent_widths, first_zeros
from clacad.sheet.cell_heights import highest_step
from clacad.sheet.feasibility.as_rows import FactRow, describe
from clacad.sheet.feasibility.derived_numbers import (
    DEFAULT_WAVELENGTH,
    SEPARATIONS,
    VIEWING_DISTANCE,
    BodyFacts,
    BorderFacts,
    FaceShape,
    Feasibility,
    LensFacts,
    two,
    viewing,
)
from clacad.sheet.feasibility.lenses import (
    body_facts,
    body_of,
    body_range,
    connectedness,
    field_facts,
    inner_range,
    least_thickness,
    lens_facts,
    lens_margin,
    thicker,
    whole_body_range,
)
from clacad.sheet.like_cell import cell_of_array, like_cell
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.vignetting import (
    aperture_slope,
    focal_ratio,
    fresnel_numbers,
    ghost_onset,
    half_field,
    lit_zone,
    thin_cells,
)

if TYPE_CHECKING:
    from clacad.sheet.window import Body, Window

__all__ = [
    "BodyFacts",
    "BorderFacts",
    "FaceShape",
    "Feasibility",
    "LensFacts",
    "FactRow",
    "body_facts",
    "body_of",
    "body_range",
    "inner_range",
    "cell_feasibility",
    "connectedness",
    "describe",
    "feasibility",
    "least_thickness",
    "lens_margin",
    "thicker",
]


def feasibility(window: Window, viewer: float | None = None, distance: float | None = None) -> Feasibility:
    """Derive all numbers of a window; a non-uniform window: its central cell's, with steps and heights of the
    whole.

    Parameters
    ----------
    viewer, distance : float, metres, optional
        Distance from the sheet to the eye before it (1 m), and to the object behind it (ten separations).
    """
    found = cell_feasibility(window, np.array(central_cell(window)), viewer, distance)
    if window.uniform:
        return found
    bodies = (_of_the_whole(one, window, body) for one, body in zip(found.bodies, window.bodies, strict=True))
    return replace(found, bodies=tuple(bodies))


def cell_feasibility(
    whole: Window, cell: Ints, viewer: float | None = None, distance: float | None = None
) -> Feasibility:
    """Derive all numbers of the uniform equivalent of one cell (2,) of a window, each lens over a cell of its
    own array; all cells of a uniform window are alike.

    viewer, distance : float, metres, optional
        As for `feasibility`.
    """
    window = like_cell(whole, cell)
    cells = thin_cells(window)
    wave = (window.wavelength or DEFAULT_WAVELENGTH) / window.unit
    width = [float(np.ptp(cells.zone[:, k])) for k in (0, 1)]
    zone, offset = lit_zone(cells), window.thin.offset
    bodies = tuple(body_facts(window, body) for body in window.bodies)
    fresnel = fresnel_numbers(cells, wave)
    distance = distance or SEPARATIONS * window.thin.separation * window.unit
    eye = viewing(focal_ratio(window.thin), fresnel, viewer or VIEWING_DISTANCE, distance, wave * window.unit)
    return Feasibility(
        lenses=(*(_lens_facts(whole, cell, array) for array in (0, 1)), *field_facts(window, width)),
        bodies=bodies,
        clearance=min(
            (b.low - a.high for (a, b), body in zip(pairwise(bodies), window.bodies[1:]) if not body.joined),
            default=np.inf,
        ),
        separation=window.thin.separation,
        aperture=aperture_slope(window),
        undeviated=(offset[0] / offset[2], offset[1] / offset[2]),
        half_field=half_field(cells),
        ghost_onset=ghost_onset(cells),
        offset_blur=two(w * _offset(window, k) for k, w in enumerate(width)),
        diffraction_blur=two(wave / equivalent_widths(zone)),
        first_zero=two(wave * first_zeros(zone)),
        fresnel_number=float(min(fresnel)),
        viewing=eye,
        wavelength=wave * window.unit,
    )


def _lens_facts(whole: Window, cell: Ints, array: int) -> LensFacts:
    """Numbers of the lens of an array over a cell as wide as those of the array."""
    window = cell_of_array(whole, cell, array)
    zone = thin_cells(window).zone
    return lens_facts(window, array, [float(np.ptp(zone[:, k])) for k in (0, 1)])


def _of_the_whole(cell: BodyFacts, whole: Window, body: Body) -> BodyFacts:
    """Return the numbers of a body in one cell with step, lowest and highest point of the whole sheet."""
    low, high = whole_body_range(whole, body)
    return replace(cell, step=highest_step(whole, body).height, low=low, high=high)


def _offset(window: Window, axis: int) -> float:
    """Range of the ray offset on the sheet over the width of the zone: |1 − m| min(1, 1/|m|)."""
    m = focal_ratio(window.thin)[axis]
    return abs(1.0 - m) * min(1.0, 1.0 / abs(m))
