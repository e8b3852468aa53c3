"""Warnings that a design accepts by their code, and allowances that have no effect."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

from clacad.checks.check import Check, CheckKind, kinds

if TYPE_CHECKING:
    from clacad.design import Design


ALLOWANCE = CheckKind("allowance", "CL360", rule="check.allow of the design").explained(
    means="The design allows a warning that is not given (or one that cannot be allowed).",
    why="An allowance that does nothing hides the next real warning of that code.",
    do="Take it out of [check] allow.",
)


def accepted(checks: Iterable[Check], design: Design) -> tuple[Check, ...]:
    """Mark the warnings that the design accepts, with its reason; add notices of idle allowances and sources
    of limits.

    An allowance is idle if no check has its code, or if the checks of that code ran and none of them warned.
    Checks
    that were marked before are unchanged.
    """
    found = [check for check in _sourced(checks, design) if check.kind is not ALLOWANCE]
    reasons = {allowed.code: allowed.reason for allowed in design.check.allow}
    marked = [
        (
            replace(
                c,
                sentence=f"{c.sentence}. Accepted in the design: {reasons[c.code]}",
                detail={**c.detail, "accepted": reasons[c.code]},
            )
            if c.state == "warn" and c.code in reasons and "accepted" not in c.detail
            else c
        )
        for c in found
    ]
    return (*marked, *(notice for code in reasons if (notice := _idle(code, found)) is not None))


def _sourced(checks: Iterable[Check], design: Design) -> tuple[Check, ...]:
    """Checks whose limit sources record whether the design file gives the key of the limit."""
    return tuple(
        (
            replace(c, limit_source=c.limit_source.known_to(design, c.id))
            if c.limit is not None or c.state == "not run"
            else c
        )
        for c in checks
    )


def _idle(code: str, checks: Iterable[Check]) -> Check | None:
    """Notice that an allowance is idle; None if it has an effect, or its check has not run."""
    if code not in (kind.code for kind in kinds().values()):
        why = f"the design allows {code}, which is the code of no check"
    else:
        states = [check.state for check in checks if check.code == code]
        if not states or "warn" in states:
            return None
        if "fail" in states:
            why = f"the design allows {code}, but a check of that code failed: only warnings can be allowed"
        else:
            why = f"the design allows {code}, but no check of that code warns: the allowance can go"
    return ALLOWANCE.check("warn", why, code, required=False)
