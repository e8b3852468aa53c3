"""Errors of a window at the centre of its field, by nine rays: fast enough for the choice of lens shapes."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, tan

import numpy as np

from clacad.base.types import Floats
from clacad.design import Design
from clacad.light.measure import measure
from clacad.optics.rays import Rays
from clacad.optics.sequence import trace_sequence
from clacad.sheet.asked_focus import RequestedLaw
from clacad.sheet.bundle import of_rays
from clacad.sheet.telescopelet import interfaces
from clacad.sheet.vignetting import aperture_slope
from clacad.sheet.window import Window
from clacad.verification.light.law_checks import FIT_SCALE


@dataclass(frozen=True, slots=True)
class CentreErrors:
    """Errors at the centre of the field, and along the axis ray.

    Parameters
    ----------
    law, decollimation : float, radians
        Residual of the recipe along the axis ray (`Window.residual`).
    eta : float
        Largest relative error of the change of exit slopes with entry slopes, over the directions of the fit
        of η.
    """

    law: float
    decollimation: float
    eta: float

    def lasting(self, design: Design) -> float:
        """Errors that do not depend on the separation, over the design's limits; below 1 the limits are
        kept.
        """
        return max(self.law / design.check.law_rms, self.eta / design.check.eta)

    def shrinking(self, design: Design) -> float:
        """Errors that fall as pitch over separation, over the design's limits."""
        return self.decollimation / design.check.law_rms


def centre_errors(window: Window, field: float) -> CentreErrors:
    """Trace the centre of lens 1 at the centre of the field and around it.

    Parameters
    ----------
    window : Window
    field : float, radians
        Half angle of the cone of test rays; the fit of η takes a tenth.
    """
    left = window.residual
    return CentreErrors(left.get("law", inf), left.get("decollimation", inf), _eta_error(window, field))


def _eta_error(window: Window, field: float) -> float:
    """Largest deviation of ∂(exit slope)/∂(required exit slope) from 1; infinite where light is lost."""
    step = tan(FIT_SCALE * field)
    slopes = np.array([(step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step)]) + aperture_slope(window)
    direction = np.column_stack([slopes, np.ones(4)])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    low, _ = window.z_range
    middle = np.array([*window.shifts[0], window.bodies[0].front.vertex[2]])
    start = middle - direction * ((middle[2] - low + 1.0) / direction[:, 2:])
    faces = interfaces(window)
    light = measure(
        lambda lit: trace_sequence(faces, lit.rays),
        of_rays(Rays(start, direction)),
        RequestedLaw(window.law),
        fewest=4,
    )
    if light.dark:
        return inf
    found, asked = _change(light.direction), _change(light.expected)
    if not (np.isfinite(found).all() and np.isfinite(asked).all()):
        return inf
    return float(np.linalg.svd(found @ np.linalg.inv(asked) - np.eye(2), compute_uv=False).max())


def _change(direction: Floats) -> Floats:
    """Differences (2, 2) of exit slopes (rows) between the rays of each pair (columns)."""
    slope = direction[:, :2] / direction[:, 2:]
    return np.stack([slope[0] - slope[1], slope[2] - slope[3]], axis=1)
