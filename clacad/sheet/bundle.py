"""Ray bundles for checks (Sobol points over one cell, a cone of directions) and the directions they must
leave in.

Pairs that image sharply (`[pair] focus`) have a requested power in addition to the law.

A ray that enters lens 1 at C1 + ξ leaves with t' = (t − δ)/η − D ξ along each lens axis. D = 1/f1 + 1/f2 −
s/(f1 f2) is the power of the pair, 0 for an afocal pair. Code that compares such light with the law subtracts
D ξ first (`RequestedLaw`); the rest is error.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, degrees, pi, sin, sqrt
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats, Ints
from clacad.base.vectors import axes_near
from clacad.optics.rays import Rays
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.vignetting import aperture_slope, aperture_slopes

if TYPE_CHECKING:
    from clacad.optics.law import Law
    from clacad.sheet.window import Window


@dataclass(frozen=True, eq=False)
class Bundle:
    """Rays over one cell of array 0.

    middle : (3,) unit direction at the centre of the field
    field : radians. Half angle of the cone about `middle`; 0 is one direction.
    aperture : Linear part of the cell that is lit (1: the whole cell).
    cell : (i, j)
    points : (n, 2) lengths. Point where each ray crosses z = 0, relative to the centre of the cell.
    """

    middle: Floats
    field: float
    aperture: float
    cell: tuple[int, int]
    rays: Rays
    points: Floats

    def __str__(self) -> str:
        return (
            f"{len(self.rays)} Sobol rays, seed 0, cone of {degrees(self.field):.4g} deg, "
            f"{self.aperture:g} of the cell"
        )


def middle_direction(window: Window, centre: str = "axis") -> Floats:
    """Direction (3,) at the centre of the field: the aperture slope, or the sheet's normal."""
    ax, ay = (0.0, 0.0) if centre == "normal" else aperture_slope(window)
    return np.array([ax, ay, 1.0]) / sqrt(ax * ax + ay * ay + 1.0)


def cone(middle: Floats, half_angle: float, unit_square: Floats) -> Floats:
    """Unit directions (n, 3) of points (n, 2) of the unit square, uniform over a cone about `middle`."""
    u, v = axes_near(middle)
    # 1 − cos without cancellation, so that a cone of a microradian is resolved
    lift = 2.0 * sin(0.5 * half_angle) ** 2 * unit_square[:, 0]
    radius = np.sqrt(lift * (2.0 - lift))
    azimuth = 2.0 * pi * unit_square[:, 1]
    side = (radius * np.cos(azimuth))[:, None] * u + (radius * np.sin(azimuth))[:, None] * v
    return np.asarray(side + (1.0 - lift)[:, None] * middle)


def bundle(
    window: Window,
    count: int,
    field: float,
    centre: str = "axis",
    aperture: float = 1.0,
    middle: Floats | None = None,
    cell: tuple[int, int] | None = None,
) -> Bundle:
    """Launch rays over a cell of array 0 and a cone of directions.

    field : radians. Half angle of the cone; 0 for parallel light.
    centre : "axis" or "normal"
    aperture : Linear part of the cell that is lit, about its centre.
    middle : (3,) or None. Axis of the cone in place of `centre`.
    cell : (i, j) or None. Default: the central cell.
    """
    chosen = central_cell(window) if cell is None else cell
    axis = middle_direction(window, centre) if middle is None else middle / np.linalg.norm(middle)
    points = sobol(count, 4)
    local = aperture * window.lattice.over_cell(points[:, :2])
    direction = cone(axis, field, points[:, 2:]) if field > 0.0 else np.broadcast_to(axis, (count, 3)).copy()
    return launched(window, local, direction, chosen, axis, field, aperture)


def bundles(window: Window, cells: Ints, count: int, field: float) -> tuple[Rays, Floats]:
    """`count` rays of a bundle over each of some cells (n, 2), each lit in its own field, cell by cell.

    Returns the rays, and the points (n count, 2), lengths, where they cross z = 0, from their cells' centres.
    """
    height, points = window.thin.offset[2], sobol(count, 4)
    local = np.tile(window.lattice.over_cell(points[:, :2]), (len(cells), 1))
    rise = np.reshape(window.thin.lenses(1, window.lattice, cells).apex[2], (-1, 1))
    slopes = aperture_slopes(window, cells) * (height / (height + rise))
    middles = np.column_stack([slopes, np.ones(len(cells))])
    middles /= np.linalg.norm(middles, axis=1)[:, None]
    direction = np.concatenate([cone(one, field, points[:, 2:]) for one in middles])
    return rays_across(window, np.repeat(window.centres(0, cells), count, axis=0) + local, direction), local


def launched(
    window: Window,
    local: Floats,
    direction: Floats,
    cell: tuple[int, int],
    middle: Floats,
    field: float = 0.0,
    aperture: float = 1.0,
) -> Bundle:
    """Bundle that starts below the window and crosses z = 0 at `local` (n, 2), lengths from the centre of
    `cell`.

    direction : (n, 3) unit; middle : (3,) unit; field : radians; aperture : part of the cell, as in `Bundle`.
    """
    place = window.lattice.centres(np.array([cell], dtype=np.int64))[0] + np.asarray(window.shifts[0])
    return Bundle(middle, field, aperture, cell, rays_across(window, local + place, direction), local)


def rays_across(window: Window, place: Floats, direction: Floats) -> Rays:
    """Rays that start below the window and cross z = 0 at `place` (n, 2), lengths."""
    at = np.column_stack([place, np.zeros(len(place))])
    below = window.z_range[0] - 0.5 * max(window.lattice.pitch)
    return Rays(at + direction * (below / direction[:, 2:]), direction)


def of_rays(rays: Rays) -> Bundle:
    """Bundle of rays over no one cell, those of a scene for instance; their points are not known."""
    return Bundle(np.full(3, np.nan), np.nan, np.nan, (0, 0), rays, np.full((len(rays), 2), np.nan))


def field_points(window: Window, field: float, centre: str = "axis") -> Floats:
    """Nine directions (9, 3): the field's centre, and every 45 degrees of its rim from +x on."""
    return field_about(middle_direction(window, centre), field)


def field_about(middle: Floats, field: float) -> Floats:
    """Nine unit directions (9, 3): `middle` (3,), and every 45 degrees at `field` (radians) from it."""
    u, v = axes_near(middle)
    rim = [cos(field) * middle + sin(field) * (cos(k * pi / 4) * u + sin(k * pi / 4) * v) for k in range(8)]
    return np.array([middle, *rim])


def asked_power(window: Window) -> Floats:
    """D along both lens axes, (2,), 1/length; 0 for afocal pairs."""
    if "focus" not in window.recipe:
        return np.zeros(2)
    first, second = np.array(window.thin.focal_length)
    return np.asarray((first + second - window.thin.separation) / (first * second))


@dataclass(frozen=True, eq=False)
class RequestedLaw:
    """Law and power of the pair that light through one cell is compared with.

    power : (2,) 1/length or None. D along both lens axes; None for an afocal pair.
    """

    law: Law
    power: Floats | None = None

    @staticmethod
    def of(window: Window) -> RequestedLaw:
        """Requested law of a window."""
        power = asked_power(window)
        return RequestedLaw(window.law, power if power.any() else None)

    def refract(self, direction: Floats) -> Floats:
        """Exit directions (n, 3) of the law; NaN where it has no answer."""
        return self.law.refract(direction)

    def without_focus(self, points: Floats, direction: Floats) -> Floats:
        """Exit directions (n, 3), unit, without the effect of the requested focus.

        points : (n, 2) lengths. Point where each ray crosses z = 0, relative to the centre of its cell.
        """
        if self.power is None:
            return direction
        turn = self.law.rotation
        lens = direction @ turn
        slopes = lens[:, :2] / lens[:, 2:] + (points @ turn[:2, :2]) * self.power
        made = np.column_stack([slopes, np.ones(len(slopes))]) @ turn.T
        return np.asarray(made / np.linalg.norm(made, axis=1)[:, None])

    def expected(self, lit: Bundle) -> Floats:
        """Exit directions (n, 3), unit, of a bundle: the law and the requested focus."""
        return self.without_focus(-lit.points, self.refract(lit.rays.direction))
