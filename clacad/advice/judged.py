"""Forecast of verify for a design: the same checks by the same functions, with fewer rays of the same
bundles.

With fewer rays, a number near its limit changes by a few per cent (figures over random designs:
`tests/benchmarks/predictions.md`). The verdict is therefore that of verify unless a check is that near its
limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from clacad.checks.check import ALLOWANCE, Check, accepted, passed, wrong
from clacad.design import Design
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import Feasibility, feasibility
from clacad.sheet.window import Window
from clacad.verification.design_rules import design_checks
from clacad.verification.light.law_checks import judge_light

if TYPE_CHECKING:
    pass

RAYS, POINT_RAYS = 8192, 1024
"""Rays of the main bundle (65536 in verify), and of each field point (4096 in verify)."""

TIGHT = 0.03
"""Error of a number measured with so few rays, as a share of its limit."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A design as built, with its checks; light is traced at the first access.

    Attributes
    ----------
    design : Design
    window : Window
        As built.
    facts : Feasibility
        Of the window.
    rules : tuple of Check
        The design rules; warnings that the design allows are marked.
    remedies : bool
        Whether the check `viewed` tries which changes reach its limit, and names them.
    """

    design: Design
    window: Window
    facts: Feasibility
    rules: tuple[Check, ...]
    remedies: bool = False

    @cached_property
    def light(self) -> tuple[Check, ...]:
        """Checks by light, through one cell of the exact surfaces."""
        from clacad.verification.light.viewed import name_remedies

        found, _ = judge_light(self.design, self.window, RAYS, POINT_RAYS)
        if self.remedies:
            found = name_remedies([*found, *self.rules], self.design, self.window)[: len(found)]
        return tuple(found)

    @cached_property
    def checks(self) -> tuple[Check, ...]:
        """Light first, then the design rules, as verify lists them."""
        return accepted((*self.light, *self.rules), self.design)

    @property
    def passes(self) -> bool:
        """Whether verify of the design will pass."""
        return passed(self.checks)

    @property
    def failing(self) -> tuple[Check, ...]:
        """Checks that fail, or are required and do not run."""
        return tuple(wrong(self.checks))

    @property
    def tight(self) -> tuple[Check, ...]:
        """Checks by light that pass so near their limit that the rays of verify may decide otherwise."""
        return tuple(c for c in self.light if c.state == "pass" and tight(c))

    @property
    def warning(self) -> tuple[Check, ...]:
        """Warnings that the design does not allow; unused allowances are not reported."""
        return tuple(
            c
            for c in self.checks
            if c.state == "warn" and "accepted" not in c.detail and c.kind is not ALLOWANCE
        )


def tight(check: Check) -> bool:
    """Whether a measured number is within TIGHT of its limit; counts of mistakes (limit 0) are excluded."""
    if check.kind.own_rays or not (
        isinstance(check.value, float) and isinstance(check.limit, float) and check.bundle and check.limit
    ):
        return False
    return abs(check.value - check.limit) <= TIGHT * abs(check.limit)


def judge(design: Design, *, remedies: bool = False) -> Judged:
    """Build a design's window, to be judged as verify will judge it.

    Parameters
    ----------
    design : Design
    remedies : bool
        Whether the check `viewed` tries which changes reach its limit, and names them.

    Raises
    ------
    DesignError
        The design cannot be built.
    """
    window = prescribe(design)
    facts = feasibility(window, *design.viewing_places)
    rules = design_checks(design, window, facts, solved=False)
    return Judged(design, window, facts, rules, remedies)
