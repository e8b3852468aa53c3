"""An effect and its declaration: when it runs, its required data, its passes over a block of rays.

`Setting` holds the parameters of all effects, neutral unless a design or a scene sets them. A `Situation` is
the input of the planner: a scene's rays on the sheet, from which an effect derives its `Bound`.

A block of rays for the effects' passes, and its crossings of each face; random draws for its rays.

Draws are deterministic: a ray with given bits and row number always gets the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from clacad.base.hashing import GOLDEN, mixed
from clacad.base.types import Bools, Floats, Rung
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.face_order import media_of
from clacad.sheet.window import Body, Window

if TYPE_CHECKING:
    from clacad.effects.engine.compiled_passes import Traced


@dataclass(frozen=True, eq=False)
class FaceCrossing:
    """One face and the rays of a block that went through it.

    before, after : (m, 3) unit directions
    through : (m,) bool or None. Rays that crossed it; None: all of them.
    """

    before: Floats
    after: Floats
    n1: float
    n2: float
    through: Bools | None


@dataclass(eq=False)
class RayBlock:
    """A block of traced rays for the passes, which change its columns in place.

    rays : As launched.
    result : Its direction, position, optical_path and flux may be written; fate, cell, order and surface are
        geometry and must not change.
    rung : str
    wavelength : float or None, metres. Of all rays of the block; None: the design wavelength.
    compiled : Whether the tracer uses compiled kernels, so that compiled passes may run.
    """

    window: Window
    rays: Rays
    result: TraceResult
    rung: Rung
    wavelength: float | None
    compiled: bool = False
    state: dict[str, Any] = field(default_factory=dict)
    """Data that passes of one effect keep from face to face."""

    def index(self, body: Body) -> float:
        """Refractive index of a body for this block."""
        return body.index_at(self.wavelength)

    def emerging(self) -> Bools:
        """Which rays (n,) go on behind the sheet."""
        return np.asarray(self.result.fate <= Fate.LAND)

    @property
    def media(self) -> Floats:
        """Refractive index before the first face and behind each, (faces + 1,)."""
        return np.array(media_of(self.window.bodies, self.wavelength))

    @property
    def air_wavelength(self) -> float:
        """Wavelength in metres, the window's where the block has none. Raises ValueError: Neither has one."""
        wavelength = self.wavelength if self.wavelength is not None else self.window.wavelength
        if wavelength is None:
            raise ValueError("this effect needs a wavelength, and neither the rays nor the design have one")
        return wavelength


def crossings(block: RayBlock) -> Iterator[FaceCrossing]:
    """Every face that the block's rays crossed, in the order of the light.

    On rungs surfaces and mesh these are the faces. Law and thin have no faces: each lens is represented by a
    plane plate across the lens axis, crossed as the ray arrives at lens 1 and as it leaves lens 2. That is
    exact for light through the lens centres.
    """
    if block.rung in ("law", "thin"):
        yield from plate_crossings(block)
        return
    result, media = block.result, media_of(block.window.bodies, block.wavelength)
    assert result.hits is not None
    assert result.directions is not None
    everywhere = bool((result.fate <= Fate.GHOST).all())
    before, point = unit_rows(block.rays.direction), block.rays.position
    for face, after in enumerate(result.directions):
        through = None if everywhere else crossed(result, face, point)
        yield FaceCrossing(before, after, media[face], media[face + 1], through)
        before, point = after, result.hits[face]


def crossed(result: TraceResult, face: int, point: Floats) -> Bools:
    """Rays (n,) that crossed a face at `point` (n, 3): it differs from their last point.

    They did not end there.
    """
    assert result.hits is not None
    ended = (result.fate >= Fate.TIR) & (result.surface == face)
    met = (result.surface >= face) & (result.fate < Fate.MISSED)
    moved = np.any(result.hits[face] != point, axis=1)
    return np.asarray(met & moved & ~ended)


def plate_crossings(block: RayBlock) -> Iterator[FaceCrossing]:
    """Crossings of the plates that represent the lenses on rungs law and thin."""
    result = block.result
    through = None if bool((result.fate <= Fate.GHOST).all()) else block.emerging()
    start, end = unit_rows(block.rays.direction), result.direction
    axis = block.window.thin.rotation[:, 2]
    first, last = block.window.bodies[0], block.window.bodies[-1]
    if first is last:
        index = block.index(first)
        inside, outside = inside_plate(start, axis, index), inside_plate(end, axis, index)
        yield FaceCrossing(start, inside, 1.0, index, through)
        yield FaceCrossing(inside, outside, index, index, through)
        yield FaceCrossing(outside, end, index, 1.0, through)
        return
    for body, ray in ((first, start), (last, end)):
        index = block.index(body)
        inside = inside_plate(ray, axis, index)
        if body is last:
            yield FaceCrossing(start, end, 1.0, 1.0, through)  # the deflection by the lenses loses no light
        yield FaceCrossing(ray, inside, 1.0, index, through)
        yield FaceCrossing(inside, ray, index, 1.0, through)


def inside_plate(direction: Floats, axis: Floats, index: float) -> Floats:
    """Unit directions (m, 3) inside a plane plate of normal (3,) and index, light coming from air."""
    from clacad.optics.surface import refract

    return refract(direction, np.broadcast_to(axis, direction.shape), direction @ axis, 1.0, index)[0]


def unit_rows(direction: Floats) -> Floats:
    """Unit directions (m, 3) of rows of any length."""
    from clacad.optics.sequence import unit_directions

    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        return unit_directions(direction)[0]


def lens_slopes(block: RayBlock) -> tuple[Floats, Floats]:
    """Exit slopes (m, 2) in the lens frame, and the lens-frame directions (m, 3) themselves."""
    turned = block.result.direction @ block.window.thin.rotation
    with np.errstate(invalid="ignore", divide="ignore"):
        return turned[:, :2] / turned[:, 2:], turned


def bend(block: RayBlock, slopes: Floats, rows: Bools) -> None:
    """Set the exit direction of some rays (n,) from lens-frame slopes (n, 2).

    Rays turned back are unchanged.
    """
    out = np.column_stack([slopes[rows], np.ones(int(rows.sum()))]) @ block.window.thin.rotation.T
    out /= np.sqrt((out * out).sum(axis=1))[:, None]
    chosen = np.flatnonzero(rows)
    forwards = out[:, 2] > 0.0
    block.result.direction[chosen[forwards]] = out[forwards]


def traced_of(block: RayBlock) -> Traced:
    """Record for compiled passes of a block whose trace kept hits and directions."""
    from clacad.effects.engine.compiled_passes import Traced

    rays, result = block.rays, block.result
    assert result.hits is not None
    assert result.directions is not None
    kept = result.hits, result.directions, result.fate, result.surface
    return Traced(rays.position, rays.direction, *kept, block.media)


def uniform(rays: Rays, count: int, seed: int, salt: int) -> Floats:
    """Numbers in (0, 1), `count` columns per ray.

    rays : Their bits and their row numbers are the key, so blocks and tiles have different draws.
    salt : One for each effect, so that effects draw independently.
    Returns (n, count) array.

    Notes
    -----
    SplitMix64 (Steele, Lea and Flood, OOPSLA 2014) as a hash; 53 bits and half a step, never 0 or 1.
    """
    columns = (*rays.position.T, *rays.direction.T)
    word = mixed(np.arange(len(rays), dtype=np.uint64) * np.uint64(GOLDEN) + np.uint64(seed))
    for column in columns:
        word = mixed(word ^ np.ascontiguousarray(column).view(np.uint64))
    out = np.empty((len(rays), count))
    for k in range(count):
        step = np.uint64((97 * salt + k + 1) * GOLDEN % 2**64)
        bits = mixed(word + step) >> np.uint64(11)
        out[:, k] = (bits.astype(np.float64) + 0.5) * 2.0**-53
    return out


def normal(rays: Rays, pairs: int, seed: int, salt: int) -> Floats:
    """Standard normal numbers (n, 2 pairs), by Box and Muller."""
    u = uniform(rays, 2 * pairs, seed, salt)
    radius = np.sqrt(-2.0 * np.log(u[:, :pairs]))
    angle = 2.0 * np.pi * u[:, pairs:]
    return np.concatenate([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def disc(rays: Rays, seed: int, salt: int) -> Floats:
    """Points (n, 2) spread evenly over the unit disc."""
    u = uniform(rays, 2, seed, salt)
    radius, angle = np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


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
