"""Follow rays that ended, for effects that let them continue."""

from __future__ import annotations

import numpy as np

from clacad.effects.engine.block import RayBlock
from clacad.effects.engine.nonsequential import Rules, trace_nonsequential
from clacad.effects.engine.parameters import Setting
from clacad.effects.registry import declared_all
from clacad.optics.rays import Fate
from clacad.sheet.window import Window


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
