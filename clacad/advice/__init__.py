"""Advice: what verify will say of a design, which keys to change so that it passes, and the design with them changed.

Nothing is said that was not tried: every proposal is a design that was built and judged by the checks of verification.
Neither the judging nor a formula of optics lives here.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clacad.advice.judged import Judged, judge

__all__ = ["Judged", "judge"]

_HOME = {"Judged": "judged", "judge": "judged"}


def __getattr__(name: str) -> Any:
    """Import a public name from its module when it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module 'clacad.advice' has no attribute {name!r}")
    return getattr(import_module(f"clacad.advice.{_HOME[name]}"), name)
