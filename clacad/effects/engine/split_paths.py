"""Split paths of many rays: compiled for rays through lenses only, the non-sequential trace for the rest.

Follow rays that ended, for effects that let them continue.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Bools
from clacad.effects.engine.block import RayBlock, around, unit_rows
from clacad.effects.engine.effect import Setting
from clacad.effects.engine.homogeneous_light import LightRays, join_light
from clacad.effects.engine.nonsequential import Rules, trace_nonsequential
from clacad.effects.engine.passes import blocks, take_rays
from clacad.effects.registry import declared_all
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.optics.surface import Quadric
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
        indices=tuple(body.index_at(wavelength) for body in window.bodies),
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

    Parameters
    ----------
    rays : Rays
        n as launched.
    result : TraceResult
        Their trace without splitting: n rows.
    setting : Setting
        With the effects that are on; `order` is the largest number of reflections in a path.
    compiled : bool
        Use compiled code for rays through lenses only; it ends paths at steps, seams and edges.
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
    return join_light(*parts) if parts else nothing


def known_to_compiled(window: Window, setting: Setting) -> bool:
    """Whether the compiled paths support everything in the window."""
    plain = window.uniform and all(isinstance(face.surface, Quadric) for face in window.faces)
    return plain and window.baffle is None and setting.order <= 2


def split_by_compiled(window: Window, rays: Rays, setting: Setting) -> tuple[LightRays, Bools]:
    """Split paths of the rays that passed lenses only, and which rays (n,) those are.

    Parameters
    ----------
    setting : Setting
        With the effects that are on.
    """
    from clacad.effects.engine.compiled_split_paths import Passing, SplitPaths, bounce_pass
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
        index = np.array(around(rules.indices))
        rates = np.array(rules.attenuation or (0.0,) * len(window.bodies))
        shape = len(rows), len(sheet.faces) * (len(sheet.faces) + 1) // 2
        paths = SplitPaths(np.empty((*shape, 3)), np.empty((*shape, 3)), np.zeros(shape))
        passing = Passing(index, rates, rules.ratio if setting.coating == "quarter-wave" else 0.0)
        onwards = unit_rows(part.direction)
        bounce_pass(sheet, passing, setting.order, rows, onwards, result.hits, result.directions, paths)
        lit = paths.flux > 0.0
        parent = np.broadcast_to(every[chosen][rows][:, None], lit.shape)[lit]
        parts.append(LightRays(parent, paths.position[lit], paths.direction[lit], paths.flux[lit]))
    return join_light(*parts), done
