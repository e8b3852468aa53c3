"""The part of an effect that the tracer knows: its name, and the rung it replaces."""

from __future__ import annotations

from typing import Protocol

from clacad.base.types import Rung


class TracedEffect(Protocol):
    """An effect as the tracer sees it; `clacad.effects.Effect` is one."""

    @property
    def name(self) -> str:
        """Name, such as "fresnel"."""

    @property
    def rung(self) -> Rung | None:
        """Rung that the effect uses instead of the requested one (facets: mesh), or None."""
