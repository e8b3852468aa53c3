"""Input of the planner: a scene's rays on the sheet, and the bound that an effect derives from them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.effects.engine.parameters import Setting
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.window import Window

PROBE = 4096
"""Number of rays of the probe trace."""

DOUBT = 3.0
"""Standard errors added to a share counted on the probe: one bound in a thousand is then too small."""


@dataclass(frozen=True, slots=True)
class Bound:
    """Bound of the error made without an effect.

    Attributes
    ----------
    angle : float, radians
        Largest change of direction; 0 for an effect that changes no direction.
    radiance : float
        Largest relative change of radiance, averaged over the rays; 0 for an effect without losses or gains.
    why : str
        One sentence with numbers.
    cost : float
        Predicted time of the trace with the effect, over the bare trace.
    known : bool
        False: a number needed for the bound is not known, and the effect stays off unless forced.
    """

    angle: float
    radiance: float
    why: str
    cost: float
    known: bool = True


@dataclass(frozen=True, eq=False)
class Situation:
    """A window and the light that a picture or a check sends through it.

    Attributes
    ----------
    window : Window
    setting : Setting
        Parameters of the effects in the scene.
    rays : Rays
        Probe rays from the camera, at most `PROBE` used.
    angle, radiance : float
        Smallest change that matters: radians, relative radiance.
    contrast : float
        Brightest over mean radiance of the scene behind the sheet.
    front : float
        Mean radiance on the camera's side of the sheet over that behind the sheet.
    near, far : float, lengths
        Range of distances from the camera of visible objects (depth of field).
    sheet_distance : float, length
        From the camera to the sheet; inf for parallel light.
    pixel : float, radians
        Angle of a pixel; 0 without a camera.
    spread : float
        Tangent of the half angle of the cone of rays about the middle of the field; 0 for rays of a camera.
    stand_ins : tuple of ((i, j), Situation)
        For a non-uniform sheet: uniform equivalents of some cells, with the light that reaches them; see
        `stand_ins`.
    """

    window: Window
    setting: Setting
    rays: Rays
    angle: float
    radiance: float
    contrast: float = 1.0
    front: float = 1.0
    near: float = np.inf
    far: float = np.inf
    sheet_distance: float = np.inf
    pixel: float = 0.0
    spread: float = 0.0
    stand_ins: tuple[tuple[tuple[int, int], Situation], ...] = ()
    notes: tuple[str, ...] = ()

    @cached_property
    def probe(self) -> TraceResult:
        """The probe rays through the exact surfaces, with hits."""
        from clacad.tracing.trace import trace

        return trace(self.window, self.rays, "surfaces", record=True, path="size")

    @cached_property
    def met(self) -> NDArray[np.intp]:
        """Rows (m,) of the probe rays that hit the sheet."""
        return np.flatnonzero(self.probe.fate < Fate.MISSED)

    @cached_property
    def kept(self) -> dict[str, float]:
        """Cache of effects' results for this situation; a changed situation starts with an empty one."""
        return {}

    def share(self, *fates: Fate) -> float:
        """Share of the rays on the sheet that end in one of the fates, as counted."""
        if len(self.met) == 0:
            return 0.0
        return float(np.isin(self.probe.fate[self.met], fates).mean())

    def most(self, share: float) -> float:
        """Upper bound of a share counted on the probe (Wilson's interval, `DOUBT` standard errors)."""
        n, z = max(len(self.met), 1), DOUBT
        middle = share + z * z / (2 * n)
        spread = z * np.sqrt(share * (1.0 - share) / n + z * z / (4 * n * n))
        return float(min(1.0, (middle + spread) / (1.0 + z * z / n)))

    @cached_property
    def directions(self) -> Floats:
        """Unit directions (m, 3) of the probe rays that hit the sheet."""
        ray = self.rays.direction[self.met]
        return np.asarray(ray / np.linalg.norm(ray, axis=1)[:, None])

    @cached_property
    def slopes(self) -> Floats:
        """Slopes (m, 2) of the probe rays that hit the sheet, lens frame."""
        turned = self.directions @ self.window.thin.rotation
        return np.asarray(turned[:, :2] / turned[:, 2:])

    @property
    def faces(self) -> int:
        """Number of optical faces that light crosses."""
        return 2 * len(self.window.bodies)

    @property
    def wavelengths(self) -> tuple[float, ...]:
        """Lines of the light, metres; the design wavelength if the scene has none."""
        if self.setting.wavelengths:
            return self.setting.wavelengths
        return () if self.window.wavelength is None else (self.window.wavelength,)
