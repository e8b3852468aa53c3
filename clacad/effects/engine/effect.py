"""An effect and its declaration: when it runs, its required data, its passes over a block of rays.

`Setting` holds the parameters of all effects, neutral unless a design or a scene sets them. A `Situation` is
the input of the planner: a scene's rays on the sheet, from which an effect derives its `Bound`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Rung
from clacad.effects.engine.block import FaceCrossing, RayBlock
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.window import Window

Coating = Literal["none", "quarter-wave"]
Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Setting:
    """Parameters of all effects; each reads its own.

    Parameters
    ----------
    coating : "none" or "quarter-wave"
        On every optical face (fresnel, reflections, polarisation).
    extinction : float or None
        Imaginary part k of the index where the material's is not known (absorption).
    wavelengths : tuple of float, metres
        Lines of the light (dispersion); empty: one line, the design wavelength.
    weights : tuple of float
        Their weights; empty: all equal.
    order : int
        Largest number of reflections in a split path (reflections).
    faces : int
        Largest number of further faces that a followed ray hits (walls, tir_paths).
    roughness : float, length in metres
        Rms height of the optical faces' roughness (scatter).
    slope_rms : float, radians
        Rms slope error of the optical faces (scatter).
    polariser, analyser : float or None, radians
        Angle from the sheet's x axis towards y of the polarisation transmitted for the scene's light, and by
        the camera.
    aperture, focus : float, design lengths
        Diameter of the camera's entrance, distance of the sharp plane along its axis (depth_of_field).
    axis : (3,)
        The camera's viewing direction, sheet frame (depth_of_field, polarisation).
    quads : int
        Facet grid a cell side (facets).
    seed : int
        Of the draws of diffraction, scatter and depth_of_field.
    active : tuple of str
        Names of the effects that are on: followed rays suffer the losses of fresnel and absorption too.
    """

    coating: Coating = "none"
    extinction: float | None = None
    wavelengths: tuple[float, ...] = ()
    weights: tuple[float, ...] = ()
    order: int = 2
    faces: int = 8
    roughness: float = 0.0
    slope_rms: float = 0.0
    polariser: float | None = None
    analyser: float | None = None
    aperture: float = 0.0
    focus: float = 1.0
    axis: Triple = (0.0, 0.0, 1.0)
    quads: int = 16
    seed: int = 0
    active: tuple[str, ...] = ()


PROBE = 4096
"""Number of rays of the probe trace."""

DOUBT = 3.0
"""Standard errors added to a share counted on the probe: one bound in a thousand is then too small."""


@dataclass(frozen=True, slots=True)
class Bound:
    """Bound of the error made without an effect.

    angle : radians. Largest change of direction; 0 for an effect that changes no direction.
    radiance : float
        Largest relative change of radiance, averaged over the rays; 0 for an effect without losses or gains.
    why : One sentence with numbers.
    cost : Predicted time of the trace with the effect, over the bare trace.
    known : False: a number needed for the bound is not known, and the effect stays off unless forced.
    """

    angle: float
    radiance: float
    why: str
    cost: float
    known: bool = True


@dataclass(frozen=True, eq=False)
class Situation:
    """A window and the light that a picture or a check sends through it.

    setting : Parameters of the effects in the scene.
    rays : Probe rays from the camera, at most `PROBE` used.
    angle, radiance : Smallest change that matters: radians, relative radiance.
    contrast : Brightest over mean radiance of the scene behind the sheet.
    front : Mean radiance on the camera's side of the sheet over that behind the sheet.
    near, far : lengths. Range of distances from the camera of visible objects (depth of field).
    sheet_distance : length. From the camera to the sheet; inf for parallel light.
    pixel : radians. Angle of a pixel; 0 without a camera.
    spread : float
        Tangent of the half angle of the cone of rays about the middle of the field; 0 for rays of a camera.
    stand_ins : tuple of ((i, j), Situation). For a non-uniform sheet: uniform equivalents of some cells, with
        the light that reaches them; see `stand_ins`.
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


class When(Enum):
    """When a pass runs."""

    LAUNCH = 0  # on the rays, before the trace
    HIT = 1  # once for every face the rays crossed
    EXIT = 2  # once after the trace


Losses = tuple[bool, tuple[float, ...]]
"""Light lost on the way: whether bare faces reflect, and the attenuation of each body (1/length; empty:
none)."""

Pass = Callable[[RayBlock, FaceCrossing | None], None]
Launch = Callable[[Window, Rays], Rays]


@dataclass(frozen=True, eq=False)
class Effect:
    """An effect ready to run.

    Attributes
    ----------
    name : str
    when : When
    needs : tuple of str
        Channels: "hits" (points and directions at every face).
    apply : callable
        `apply(block, crossing)` at HIT, `apply(block, None)` at EXIT: changes the block's columns in place.
    finish : callable or None
        `finish(block)` after the last face, for effects at HIT that gather over the faces.
    compiled : callable or None
        `compiled(block)`: `apply` over all faces at once, as compiled code.
    launch : callable or None
        `launch(window, rays)` → rays, at LAUNCH.
    rung : str or None
        The rung that implements the effect (facets: mesh).
    options : mapping
        Keyword arguments of `trace` on that rung.
    losses : callable or None
        `losses(wavelength)`: the losses of the pass, where the compiled tracer can include them.
    colours : bool
        Whether the pass depends on the wavelength, so that a block may hold only one.
    """

    name: str
    when: When
    needs: tuple[str, ...] = ()
    apply: Pass | None = None
    finish: Callable[[RayBlock], None] | None = None
    compiled: Callable[[RayBlock], None] | None = None
    launch: Launch | None = None
    rung: Rung | None = None
    options: dict[str, Any] = field(default_factory=dict)
    colours: bool = True
    losses: Callable[[float | None], Losses] | None = None


def _never(_: Situation) -> bool:
    return False


@dataclass(frozen=True, eq=False)
class Declaration:
    """Properties of an effect; its model, law and cost are in its module's docstring.

    name : Name in scenes and options; the name of its module.
    effect : `effect(window, setting)` → `Effect`, ready to run.
    bound : `bound(situation)` → `Bound` of the error made when the effect is off.
    measured : `measured(situation)` → change of direction (radians) and of radiance (relative), from traces
        with and without the effect. None: the direction is unchanged, and the radiance is that of the light
        reaching the camera.
    shows : Fate of the rays that carry light with the effect and none without it. Their share is the bound.
    follows : Whether rays of that fate are traced on, with every loss. Such effects run last and their result
        is final.
    splits : Whether one ray becomes several.
    includes : Effects whose losses on the straight path are included in this one.
    loses : Whether faces reflect a share of the light.
    attenuations : `attenuations(window, setting, wavelength)` → loss of each body (1/length).
    lines : Whether each wavelength of the light is traced by itself.
    waves : Whether it requires the light of one telescopelet as a wave.
    rung : Rung that replaces the exact surfaces; the effect is on exactly on that rung.
    stated : `stated(situation)`: whether the scene requests the effect, regardless of its bound.
    camera : Whether the camera implements it, and not the trace of its rays.
    """

    name: str
    effect: Callable[[Window, Setting], Effect]
    bound: Callable[[Situation], Bound]
    measured: Callable[[Situation], tuple[float, float]] | None = None
    shows: Fate | None = None
    follows: bool = False
    splits: bool = False
    includes: tuple[str, ...] = ()
    loses: bool = False
    attenuations: Callable[[Window, Setting, float | None], tuple[float, ...]] | None = None
    lines: bool = False
    waves: bool = False
    rung: Rung | None = None
    stated: Callable[[Situation], bool] = _never
    camera: bool = False
