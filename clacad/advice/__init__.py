"""Advice: forecast of verify for a design, the keys to change so that it passes, and a design from a wish.

Every proposal was tried: its design was built and judged by the checks of verification. The package contains
neither checks nor formulas of optics.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clacad.advice.fewest_keys import Fixed, fix
    from clacad.advice.hints import Advice, Hint, advise
    from clacad.advice.judged import Judged, judge
    from clacad.advice.proposal import NoSuchSheet, Proposal, design_for
    from clacad.advice.wish import Wish

__all__ = [
    "Advice",
    "Fixed",
    "Hint",
    "Judged",
    "NoSuchSheet",
    "Proposal",
    "Wish",
    "advise",
    "design_for",
    "fix",
    "judge",
]

_HOME = {
    "Advice": "hints",
    "Fixed": "fewest_keys",
    "Hint": "hints",
    "Judged": "judged",
    "advise": "hints",
    "fix": "fewest_keys",
    "judge": "judged",
    "NoSuchSheet": "proposal",
    "Proposal": "proposal",
    "design_for": "proposal",
    "Wish": "wish",
}


def __getattr__(name: str) -> Any:
    """Import a public name from its module when it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module 'clacad.advice' has no attribute {name!r}")
    return getattr(import_module(f"clacad.advice.{_HOME[name]}"), name)
