"""The numbers of the page's verdict line for the design itself, by the closed forms of the sheet."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from clacad.base.types import Pair2
from clacad.sheet.feasibility.derived_numbers import DEFAULT_WAVELENGTH
from clacad.sheet.feasibility.pitch_for_eye import viewing
from clacad.sheet.lattice import inside_outline
from clacad.sheet.vignetting import aperture_slope, focal_ratio, ghost_onset, half_field, share, thin_cells
from clacad.sheet.window import Window

GRID = 9
"""Points a side of the sheet over which the share that the eye sees is averaged."""


@dataclass(frozen=True, slots=True)
class FirstVerdict:
    """What an eye may expect of a thin pair.

    share, share_from_eye : float, 0 … 1
        Of the light on a cell, what meets the partner: along the middle of the field, and of the light that
        reaches the eye
        as a mean over the sheet.
    half_field, ghost_onset : (x, y), slopes in the lens frame
    sharpest_pitch : (x, y), lengths
    advised_pitch : float, length
        The sharpest pitch of the axis that is blurred more.
    """

    share: float
    share_from_eye: float
    half_field: Pair2
    ghost_onset: Pair2
    sharpest_pitch: Pair2
    advised_pitch: float

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        return asdict(self)


def first_verdict(window: Window, eye: float, distance: float) -> FirstVerdict:
    """Judge a window as the page does.

    Parameters
    ----------
    window : Window
    eye, distance : float, lengths
        From the sheet to the eye on its axis, and to what it looks at.
    """
    cells = thin_cells(window)
    middle = np.array([[*aperture_slope(window), 1.0]])
    sharp = viewing(
        focal_ratio(window.thin),
        (np.inf, np.inf),
        eye * window.unit,
        distance * window.unit,
        window.wavelength or DEFAULT_WAVELENGTH,
    )
    x, y = (pitch / window.unit for pitch in sharp.sharpest)
    return FirstVerdict(
        share=float(share(cells, middle)[0]),
        share_from_eye=share_from_eye(window, (0.0, 0.0, -eye)),
        half_field=half_field(cells),
        ghost_onset=ghost_onset(cells),
        sharpest_pitch=(x, y),
        advised_pitch=sharp.advised / window.unit,
    )


def share_from_eye(window: Window, eye: tuple[float, float, float]) -> float:
    """Mean over the sheet of the share of the light that meets its partner, of the light that reaches an eye
    (x, y, z), lengths.
    """
    lattice = window.lattice
    wide, tall = lattice.count[0] * lattice.a1[0], lattice.count[1] * lattice.a2[1]
    at = (np.arange(GRID) + 0.5) / GRID - 0.5
    points = np.stack(np.meshgrid(at * wide, at * tall, indexing="ij"), axis=-1).reshape(-1, 2)
    if lattice.outline is not None:
        points = points[inside_outline(lattice.outline, points)]
    if len(points) == 0:
        return 0.0
    directions = np.column_stack([points, np.zeros(len(points))]) - np.array(eye)
    return float(share(thin_cells(window), directions).mean())
