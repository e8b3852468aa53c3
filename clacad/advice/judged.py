"""What verify will say of a design: the same checks by the same functions, with fewer rays of the same bundles.

Fewer rays move a measured number by less than a hundredth of itself (`tests/benchmarks/predictions.md` has the figures over
random designs), so the verdict is verify's unless a check stands that near to its limit.
"""

from __future__ import annotations

from dataclasses import dataclass

from clacad.design import Design
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import Feasibility, feasibility
from clacad.sheet.window import Window
from clacad.verification.checks import Check, accepted, passed
from clacad.verification.run import judge_window
from clacad.verification.verdict import wrong

RAYS, POINT_RAYS = 8192, 1024
"""Of the main bundle, where verify sends 65536, and of each field point, where it sends 4096."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A design and what its checks say.

    Attributes
    ----------
    design : Design
    window : Window
        As built.
    facts : Feasibility
        Of the window.
    checks : tuple of Check
        Light first, then the design rules, as verify lists them; warnings that the design allows are marked.
    """

    design: Design
    window: Window
    facts: Feasibility
    checks: tuple[Check, ...]

    @property
    def passes(self) -> bool:
        """Whether verify of the design will pass."""
        return passed(self.checks)

    @property
    def failing(self) -> tuple[Check, ...]:
        """Checks that fail, or are required and do not run."""
        return tuple(wrong(self.checks))

    @property
    def warning(self) -> tuple[Check, ...]:
        """Warnings that the design does not allow, allowances that do nothing among them."""
        return tuple(c for c in self.checks if c.state == "warn" and "accepted" not in c.detail)


def judge(design: Design) -> Judged:
    """Build a design's window and judge it as verify will, by light through one cell and by the design rules.

    Parameters
    ----------
    design : Design

    Raises
    ------
    DesignError
        The design cannot be built.
    """
    window = prescribe(design)
    facts = feasibility(window)
    checks, _ = judge_window(design, window, facts, RAYS, POINT_RAYS)
    return Judged(design, window, facts, accepted(checks, design))
