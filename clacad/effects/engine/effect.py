"""An effect: when it runs, its required data, and its passes over a block of rays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from clacad.base.types import Rung
from clacad.effects.engine.block import FaceCrossing, RayBlock
from clacad.effects.engine.bounds import Bound, Situation
from clacad.effects.engine.parameters import Setting
from clacad.optics.rays import Fate, Rays
from clacad.sheet.window import Window


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

    Attributes
    ----------
    name : str
        Name in scenes and options; the name of its module.
    effect : callable
        `effect(window, setting)` → `Effect`, ready to run.
    bound : callable
        `bound(situation)` → `Bound` of the error made when the effect is off.
    measured : callable or None
        `measured(situation)` → change of direction (radians) and of radiance (relative), from traces with and
        without the effect. None: the direction is unchanged, and the radiance is that of the light reaching
        the camera.
    shows : Fate or None
        Fate of the rays that carry light with the effect and none without it. Their share is the bound.
    follows : bool
        Whether rays of that fate are traced on, with every loss. Such effects run last and their result is
        final.
    splits : bool
        Whether one ray becomes several.
    includes : tuple of str
        Effects whose losses on the straight path are included in this one.
    loses : bool
        Whether faces reflect a share of the light.
    attenuations : callable or None
        `attenuations(window, setting, wavelength)` → loss of each body (1/length).
    lines : bool
        Whether each wavelength of the light is traced by itself.
    waves : bool
        Whether it requires the light of one telescopelet as a wave.
    rung : Rung or None
        Rung that replaces the exact surfaces; the effect is on exactly on that rung.
    stated : callable
        `stated(situation)`: whether the scene requests the effect, regardless of its bound.
    camera : bool
        Whether the camera implements it, and not the trace of its rays.
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
