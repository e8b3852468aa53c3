"""An effect: when it runs, what it needs, and the passes it makes over a block of rays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from clacad.base.types import Rung
from clacad.effects.engine.block import FaceCrossing, RayBlock
from clacad.optics.rays import Rays
from clacad.sheet.window import Window


class When(Enum):
    """When a pass runs."""

    LAUNCH = 0  # on the rays, before the trace
    HIT = 1  # once for every face the rays crossed
    EXIT = 2  # once after the trace


Losses = tuple[bool, tuple[float, ...]]
"""Light lost on the way: whether bare faces reflect, and the attenuation of each body (1/length; empty: none)."""

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
        `compiled(block)`: the same as `apply` over all faces at once, by compiled code.
    launch : callable or None
        `launch(window, rays)` → rays, at LAUNCH.
    rung : str or None
        The rung the effect stands for (facets: mesh).
    options : mapping
        Keyword arguments of `trace` on that rung.
    losses : callable or None
        `losses(wavelength)`: the same as the pass where the compiled tracer can count it on the way.
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
