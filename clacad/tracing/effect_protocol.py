"""What the tracer knows of an effect: its name, and the rung it replaces."""

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
        """Rung that the effect replaces the requested one by (facets: mesh), or None."""
