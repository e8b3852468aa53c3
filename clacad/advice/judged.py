"""Forecast of verify for a design: the same checks by the same functions, with fewer rays of the same
bundles.

With fewer rays, a number near its limit changes by a few per cent (figures over random designs:
`tests/benchmarks/predictions.md`). The verdict is therefore that of verify unless a check is that near its
limit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import TYPE_CHECKING, Any

from clacad.base.interactive import Tabular
from clacad.base.text import shown
from clacad.checks.check import (
    ALLOWANCE,
    Check,
    CheckKind,
    accepted,
    check_columns,
    passed,
    short_table,
    wrong,
)
from clacad.design import Design
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import Feasibility, describe, feasibility
from clacad.sheet.window import Window
from clacad.verification.design_rules import design_checks
from clacad.verification.light.law_checks import judge_light

if TYPE_CHECKING:
    from clacad.making.light_as_made import JudgedAsMade

RAYS, POINT_RAYS = 8192, 1024
"""Rays of the main bundle (65536 in verify), and of each field point (4096 in verify)."""

TIGHT = 0.03
"""Error of a number measured with so few rays, as a share of its limit."""


@dataclass(frozen=True, eq=False)
class Judged(Tabular):
    """A design as built, with its checks; numbers, rules and light are computed at the first access.

    Attributes
    ----------
    design : Design
    window : Window
        As built.
    remedies : bool
        Whether the check `viewed` tries which changes reach its limit, and names them.
    judged_only : bool
        Whether white light and temperature are measured only where the design limits them.
    as_made : bool
        Whether light is also sent through the sheet as its process makes it.
    """

    design: Design
    window: Window
    remedies: bool = False
    judged_only: bool = False
    as_made: bool = False

    def __repr__(self) -> str:
        """Short table: checks that do not pass, and the forecast of the verdict last."""
        return f"{self.design.name}\n{short_table(self.checks)}\n{self.verdict()}"

    def to_columns(self) -> dict[str, Any]:
        """One row for each check."""
        return check_columns(self.checks)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready content: derived numbers, checks and the forecast of the verdict."""
        return {
            "design": self.design.name,
            "derived": [list(row) for row in describe(self.window, self.facts)],
            "recipe": dict(self.window.recipe),
            "residual": dict(self.window.residual),
            "checks": [check.to_dict() for check in self.checks],
            "passed": self.passes,
            "verdict": self.verdict(),
            **({} if self.made is None else {"as_made": self.made.to_dict()}),
        }

    @cached_property
    def facts(self) -> Feasibility:
        """Derived numbers of the window."""
        return feasibility(self.window, *self.design.viewing_places)

    @cached_property
    def rules(self) -> tuple[Check, ...]:
        """The design rules; warnings that the design allows are marked."""
        return design_checks(self.design, self.window, self.facts, solved=False)

    @cached_property
    def light(self) -> tuple[Check, ...]:
        """Checks by light, through one cell of the exact surfaces."""
        from clacad.verification.light.viewed import name_remedies

        found, _ = judge_light(self.design, self.window, RAYS, POINT_RAYS, judged_only=self.judged_only)
        if self.remedies:
            found = name_remedies([*found, *self.rules], self.design, self.window)[: len(found)]
        return tuple(found)

    @cached_property
    def made(self) -> JudgedAsMade | None:
        """The sheet as its process makes it; None where it is not requested."""
        if not self.as_made:
            return None
        from clacad.making.light_as_made import judge_as_made

        return judge_as_made(self.design, self.window)

    @cached_property
    def checks(self) -> tuple[Check, ...]:
        """Light first, then the design rules, as verify lists them."""
        made = () if self.made is None else self.made.checks
        return accepted((*self.light, *made, *self.rules), self.design)

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

    def measured(self, kind: CheckKind) -> float:
        """Number that the check of a kind measured; infinite where it is missing or no number."""
        found = next((check.value for check in self.checks if check.kind is kind), None)
        return found if isinstance(found, float) else inf

    def verdict(self) -> str:
        """Forecast of the verdict of verify in one line."""
        if not self.passes:
            return f"verify will fail: {_ids(self.failing)}"
        notes = [f"warning of {_ids(self.warning)}"] if self.warning else []
        notes += [f"{_ids(self.tight)} at the very limit"] if self.tight else []
        return "verify will pass" + (f", {'; '.join(notes)}" if notes else "")


def _ids(checks: Iterable[Check]) -> str:
    return ", ".join(dict.fromkeys(check.id for check in checks))


def tight(check: Check) -> bool:
    """Whether a measured number is within TIGHT of its limit; counts of mistakes (limit 0) are excluded."""
    if check.kind.own_rays or not (
        isinstance(check.value, float) and isinstance(check.limit, float) and check.bundle and check.limit
    ):
        return False
    return abs(check.value - check.limit) <= TIGHT * abs(check.limit)


def fault(check: Check) -> str:
    """Sentence on a failing check: its value, limit and where the limit comes from."""
    value, limit, unit, _ = shown(check.value, check.limit, check.relation, check.unit, check.state)
    return (
        f"{check.id}: {value}, and the limit is {check.relation} {limit} {unit}".rstrip()
        + f" ({check.source.partition(': ')[0]}); {check.sentence}"
    )


def judge(
    design: Design, *, remedies: bool = False, judged_only: bool = False, as_made: bool = False
) -> Judged:
    """Build a design's window, to be judged as verify will judge it.

    Parameters
    ----------
    design : Design
    remedies : bool
        Whether the check `viewed` tries which changes reach its limit, and names them.
    judged_only : bool
        Whether white light and temperature are measured only where the design limits them: for trials.
    as_made : bool
        Whether light is also sent through the sheet as its process makes it.

    Raises
    ------
    DesignError
        The design cannot be built.
    """
    return Judged(design, prescribe(design), remedies, judged_only, as_made)


def check(design: Design, as_made: bool = False) -> Judged:
    """Forecast the verdict of `clacad.verify` on a design: its checks, with remedies where they fail or warn.

    The checks are those of verify, with fewer rays; a number within 3 % of its limit may be decided otherwise
    there (`Judged.tight`). `clacad.advise` and `clacad.fix` search for the keys that would make it pass.

    Parameters
    ----------
    design : Design
    as_made : bool
        Whether light is also sent through the sheet as its process makes it (section [process]).

    Returns
    -------
    Judged
        Its `repr` is a short table; `to_frame` has one row a check.

    Raises
    ------
    DesignError
        The design cannot be built.
    NotPossible
        It cannot be judged as made.

    Examples
    --------
    >>> import clacad
    >>> judged = clacad.check(clacad.load("slab", ["lattice.count = [3, 3]"]))
    >>> judged.passes
    True
    """
    judged = judge(design, remedies=True, as_made=as_made)
    assert judged.checks, "light is traced here, not when the result is first read"
    return judged
