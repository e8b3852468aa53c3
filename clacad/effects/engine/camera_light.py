"""The light a picture needs: for every camera ray, the rays that carry radiance to it.

A trace gives one row per ray. A picture may need more than one (a ghost on the homogeneous sheet, a split
path) or none (a ghost that is not shown). `light_reaching_camera` returns them as one flat list.

Rung law has no cells: every ray carries the closed-form share of the light that stays with its partner, and
with `ghosts` one further ray per ghost order (`clacad.effects.engine.homogeneous_light`).

Split paths are compiled for rays through lenses only; the non-sequential trace finds the rest, and follows
rays that ended for effects that let them continue. The change that an effect makes is measured on the scene's
probe rays, traced with it and without.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clacad.base.types import Bools, Floats, Rung
from clacad.effects import declared_all
from clacad.effects.engine.effect import Declaration, Effect, RayBlock, Setting, Situation, unit_rows
from clacad.effects.engine.homogeneous_light import LightRays, law_light
from clacad.effects.engine.nonsequential import Rules, trace_nonsequential
from clacad.effects.engine.passes import blocks, take_rays, trace_with
from clacad.light.compare import angles
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.optics.surface import Quadric
from clacad.sheet.face_order import media_of
from clacad.sheet.window import Window
from clacad.tracing.layout import lay_out


def rules_for(window: Window, setting: Setting, wavelength: float | None, order: int = 0) -> Rules:
    """Rules of the interfaces with the effects that are on."""
    kinds = declared_all(setting.active)
    follows = {kind.shows for kind in kinds if kind.follows}
    attenuation: tuple[float, ...] = ()
    for kind in kinds:
        if kind.attenuations is not None:
            attenuation = kind.attenuations(window, setting, wavelength)
    ratio = 1.0
    if window.wavelength is not None and wavelength is not None:
        ratio = window.wavelength / wavelength
    return Rules(
        walls=Fate.WALL in follows,
        total=Fate.TIR in follows,
        losses=any(kind.loses for kind in kinds),
        order=order,
        faces=setting.faces,
        attenuation=attenuation,
        media=media_of(window.bodies, wavelength),
        coating=setting.coating,
        ratio=ratio,
    )


def trace_ended_rays(block: RayBlock, setting: Setting, fate: Fate) -> None:
    """Follow the block's rays of one fate until they leave; rays that do not leave get flux 0."""
    result = block.result
    rows = np.flatnonzero(result.fate == fate)
    if not len(rows) or block.rung in ("law", "thin"):
        return
    out = trace_nonsequential(
        block.window, block.rays, rows, rules_for(block.window, setting, block.wavelength)
    )
    result.flux[rows] = 0.0
    result.flux[out.parent] = out.flux
    result.position[out.parent] = out.position
    result.direction[out.parent] = out.direction
    result.optical_path[out.parent] = out.optical_path


def reflected_paths(
    window: Window, rays: Rays, result: TraceResult, setting: Setting, compiled: bool
) -> LightRays:
    """Paths with at least one partial reflection, of the rays that hit the sheet.

    rays : n as launched.
    result : Their trace without splitting: n rows.
    setting : With the effects that are on; `order` is the largest number of reflections in a path.
    compiled : Use compiled code for rays through lenses only; it ends paths at steps, seams and edges.
    """
    left = result.fate < Fate.MISSED
    parts = []
    if compiled and known_to_compiled(window, setting):
        light, done = split_by_compiled(window, rays, setting)
        parts.append(light)
        left &= ~done
    every = np.arange(len(rays))
    for chosen, wavelength in blocks(rays, by_colour=True):
        rows = every[chosen]
        met = np.flatnonzero(left[rows])
        if not len(met):
            continue
        rules = rules_for(window, setting, wavelength, setting.order)
        out = trace_nonsequential(window, take_rays(rays, rows), met, rules)
        kept = out.bounces > 0
        parts.append(
            LightRays(rows[out.parent[kept]], out.position[kept], out.direction[kept], out.flux[kept])
        )
    nothing = LightRays(np.zeros(0, dtype=np.intp), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    return LightRays.joined(parts) if parts else nothing


def known_to_compiled(window: Window, setting: Setting) -> bool:
    """Whether the compiled paths support everything in the window."""
    plain = window.uniform and all(isinstance(face.surface, Quadric) for face in window.faces)
    apart = window.baffle is None and not any(body.joined for body in window.bodies)
    return plain and apart and setting.order <= 2


def split_by_compiled(window: Window, rays: Rays, setting: Setting) -> tuple[LightRays, Bools]:
    """Split paths of the rays that passed lenses only, and which rays (n,) those are.

    setting : With the effects that are on.
    """
    from clacad.effects.engine.compiled_passes import Passing, SplitPaths, bounce_pass
    from clacad.tracing.compiled.packing import pack
    from clacad.tracing.trace import trace

    sheet = pack(lay_out(window))
    done = np.zeros(len(rays), dtype=bool)
    parts = []
    every = np.arange(len(rays))
    for chosen, wavelength in blocks(rays, by_colour=True):
        part = take_rays(rays, chosen)
        result = trace(window, part, "surfaces", record=True, threads=1, path="numba")
        assert result.hits is not None
        assert result.directions is not None
        rows = np.flatnonzero(result.fate <= Fate.GHOST)
        done[every[chosen][rows]] = True
        rules = rules_for(window, setting, wavelength, setting.order)
        index = np.array(rules.media)
        rates = np.array(rules.attenuation or (0.0,) * len(window.bodies))
        shape = len(rows), len(sheet.faces) * (len(sheet.faces) + 1) // 2
        paths = SplitPaths(np.empty((*shape, 3)), np.empty((*shape, 3)), np.zeros(shape))
        passing = Passing(index, rates, rules.ratio if setting.coating == "quarter-wave" else 0.0)
        onwards = unit_rows(part.direction)
        bounce_pass(sheet, passing, setting.order, rows, onwards, result.hits, result.directions, paths)
        lit = paths.flux > 0.0
        parent = np.broadcast_to(every[chosen][rows][:, None], lit.shape)[lit]
        parts.append(LightRays(parent, paths.position[lit], paths.direction[lit], paths.flux[lit]))
    return LightRays.joined(parts), done


MANY = 50_000
"""Number of rays above which split paths are compiled: loading costs as much as some thousand rays."""


def light_reaching_camera(
    window: Window,
    rays: Rays,
    rung: Rung,
    effects: Sequence[str | Effect] = (),
    setting: Setting | None = None,
    **options: Any,
) -> tuple[LightRays, TraceResult]:
    """Trace camera rays and return the light that they collect.

    Parameters
    ----------
    effects : names of the effects that are on, or `Effect`
    setting : Setting
        Their parameters.
    options
        Passed on to `clacad.tracing.trace.trace`.

    Returns
    -------
    light : LightRays
        ALIVE and LAND rays; GHOST with `ghosts`; WALL and TIR with `walls` and `tir_paths`; split paths with
        `reflections`. Rays that miss the sheet are not listed: the caller knows what surrounds it.
    result : TraceResult
        One row a ray.
    """
    setting = setting or Setting()
    names = tuple(effect if isinstance(effect, str) else effect.name for effect in effects)
    kinds = declared_all(names)
    ghosts = any(kind.shows is Fate.GHOST for kind in kinds)
    result = trace_with(window, rays, rung, effects, setting=setting, **options)
    if rung == "law":
        return law_light(window, rays, result, ghosts), result
    rows = np.flatnonzero(shining(result, names))
    light = LightRays(rows, result.position[rows], result.direction[rows], result.flux[rows])
    if any(kind.splits for kind in kinds) and rung in ("surfaces", "mesh"):
        compiled = options.get("path") == "numba" or (options.get("path") != "numpy" and len(rays) > MANY)
        extra = reflected_paths(window, rays, result, replace(setting, active=names), compiled)
        light = LightRays.joined([light, extra])
    return light, result


def shining(result: TraceResult, names: Sequence[str]) -> Bools:
    """Which rows of a trace carry light, given the effects that are on, (n,)."""
    fates = {Fate.ALIVE, Fate.LAND, *(kind.shows for kind in declared_all(names) if kind.shows is not None)}
    return np.isin(result.fate, list(fates)) & (result.flux > 0.0)


MOST = 0.99
"""Share of the light over which the largest change of direction is taken."""


def measure(situation: Situation, kind: Declaration) -> tuple[float, float]:
    """Change of direction (radians) and of radiance (relative) that an effect makes.

    Returns
    -------
    angle : float
        As defined by the effect's `measured`: the largest of 99 % of the light (a few rays at borders change
        lenslets without changing order), the largest, the rms, or the angle that contains half of the light.
    radiance : float
        Mean over the rays on the sheet of the light added or removed; light redirected by reflection
        counts with the contrast and brightness of the scene that it then comes from.
    """
    if kind.measured is not None:
        return kind.measured(situation)
    return 0.0, radiance_change(situation, kind.name)


def radiance_change(situation: Situation, name: str) -> float:
    """Mean change (relative) of the light that reaches the camera from the rays on the sheet."""
    n = len(situation.rays)
    before, after = (
        np.bincount(light.parent, weights=light.flux, minlength=n)
        for light in (light_with(situation), light_with(situation, name))
    )
    return float(np.abs(after - before)[situation.met].mean())


def traced_with(situation: Situation, *names: str) -> TraceResult:
    """The probe rays with these effects, by exact surfaces; reproducible to the bit."""
    window, rays = situation.window, situation.rays
    return trace_with(window, rays, "surfaces", names, setting=situation.setting, path="size")


def light_with(situation: Situation, *names: str) -> LightRays:
    """The light that reaches the camera with these effects, by exact surfaces."""
    window, rays = situation.window, situation.rays
    return light_reaching_camera(window, rays, "surfaces", names, situation.setting, path="size")[0]


def turned_angles(situation: Situation, name: str, last: Fate = Fate.GHOST) -> Floats:
    """Angles (k,), radians, by which an effect deflects rays that pass with fates up to `last`.

    Without such rays the result is (1,) zero.
    """
    turned = angles(traced_with(situation), traced_with(situation, name), last)
    return turned if len(turned) else np.zeros(1)
