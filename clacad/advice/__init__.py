"""Advice: what verify will say of a design, which keys to change so that it passes, and the design with them changed; and from a wish to a design that passes.

Nothing is said that was not tried: every proposal is a design that was built and judged by the checks of verification.
Neither the judging nor a formula of optics lives here.
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
    "Advice", "Fixed", "Hint", "Judged", "NoSuchSheet", "Proposal", "Wish", "advise", "design_for", "fix", "judge",
]  # fmt: skip

_HOME = {
    "Advice": "hints", "Fixed": "fewest_keys", "Hint": "hints", "Judged": "judged", "advise": "hints",
    "fix": "fewest_keys",
    "judge": "judged", "NoSuchSheet": "proposal", "Proposal": "proposal", "design_for": "proposal", "Wish": "wish",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a public name from its module when it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module 'clacad.advice' has no attribute {name!r}")
    return getattr(import_module(f"clacad.advice.{_HOME[name]}"), name)
