"""The light a picture needs: for every camera ray, the rays that carry radiance to it.

A trace gives one row a ray. A picture may need more than one (a ghost on the homogeneous sheet, a split path) or
none (a ghost that is not shown). `lit` gives them as one flat list.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Rung
from clacad.effects.engine.parameters import Setting
from clacad.effects.engine.passes import Effect, blocks, take_rays, trace_with
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.window import Window

MANY = 50_000
"""Rays above which split paths are compiled: loading the code costs as much as following some thousand rays."""


@dataclass(frozen=True, eq=False)
class Light:
    """Rays that carry radiance from the scene to the camera.

    Attributes
    ----------
    parent : (m,) ints
        The launched ray whose picture point gains by it.
    position, direction : (m, 3), sheet frame
        Where the ray leaves the sheet and its unit direction; one with d_z < 0 goes back to the camera's side.
    flux : (m,)
        Factor on the radiance that the ray meets.
    """

    parent: NDArray[np.intp]
    position: Floats
    direction: Floats
    flux: Floats

    def __len__(self) -> int:
        return len(self.flux)


def lit(
    window: Window,
    rays: Rays,
    rung: Rung,
    effects: Sequence[str | Effect] = (),
    setting: Setting | None = None,
    **options: Any,
) -> tuple[Light, TraceResult]:
    """Trace camera rays and give the light that they see.

    Parameters
    ----------
    effects : names of the effects that are on, or `Effect`
    setting : Setting
        Their parameters.
    options
        Passed on to `clacad.tracing.trace.trace`.

    Returns
    -------
    light : Light
        ALIVE and LAND rays; GHOST with `ghosts`; WALL and TIR with `walls` and `tir_paths`; split paths with
        `reflections`. Rays that miss the sheet are not listed: the caller knows what surrounds it.
    result : TraceResult
        One row a ray.

    Notes
    -----
    Rung law has no cells: there every ray carries the closed-form share of the light that stays with its
    partner, and with `ghosts` one further ray a ghost order (`clacad.effects.engine.homogeneous_light`).
    """
    setting = setting or Setting()
    names = tuple(effect if isinstance(effect, str) else effect.name for effect in effects)
    result = trace_with(window, rays, rung, effects, setting=setting, **options)
    if rung == "law":
        from clacad.effects.engine.homogeneous_light import law_light

        return law_light(window, rays, result, "ghosts" in names), result
    shown = seen(result, names)
    rows = np.flatnonzero(shown)
    light = Light(rows, result.position[rows], result.direction[rows], result.flux[rows])
    if "reflections" in names and rung in ("surfaces", "mesh"):
        compiled = options.get("path") == "numba" or (options.get("path") is None and len(rays) > MANY)
        light = joined(light, split(window, rays, result, names, setting, compiled))
    return light, result


def seen(result: TraceResult, names: Sequence[str]) -> NDArray[np.bool_]:
    """Which rows of a trace shine, given the effects that are on, (n,)."""
    fates = [Fate.ALIVE, Fate.LAND]
    fates += [
        fate
        for name, fate in (("ghosts", Fate.GHOST), ("walls", Fate.WALL), ("tir_paths", Fate.TIR))
        if name in names
    ]
    return np.isin(result.fate, fates) & (result.flux > 0.0)


def split(
    window: Window, rays: Rays, result: TraceResult, names: Sequence[str], setting: Setting, compiled: bool
) -> Light:
    """Paths with at least one partial reflection, of the rays that meet the sheet.

    `compiled`: where lenses alone were met, by compiled code that ends paths at steps, seams and edges.
    """
    from clacad.effects.engine.nonsequential import follow
    from clacad.effects.engine.nonsequential_rows import rules_for

    active = replace(setting, active=tuple(names))
    left = result.fate < Fate.MISSED
    parts = []
    if compiled:
        from clacad.effects.engine.split_paths import quick, split_quickly

        if quick(window, active):
            light, done = split_quickly(window, rays, active)
            parts.append(light)
            left &= ~done
    every = np.arange(len(rays))
    for chosen, wavelength in blocks(rays, by_colour=True):
        rows = every[chosen]
        met = np.flatnonzero(left[rows])
        if not len(met):
            continue
        rules = rules_for(window, active, wavelength, setting.order)
        out = follow(window, take_rays(rays, rows), met, rules)
        kept = out.bounces > 0
        parts.append(Light(rows[out.parent[kept]], out.position[kept], out.direction[kept], out.flux[kept]))
    nothing = Light(np.zeros(0, dtype=np.intp), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    return joined(*parts) if parts else nothing


def joined(*lights: Light) -> Light:
    """Several lists of light in one."""
    return Light(
        np.concatenate([light.parent for light in lights]),
        np.concatenate([light.position for light in lights]),
        np.concatenate([light.direction for light in lights]),
        np.concatenate([light.flux for light in lights]),
    )
