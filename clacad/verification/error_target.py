"""A requested direction error in a verification: the rays it needs, and whether the files are within it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil, log2
from typing import TYPE_CHECKING

from clacad.checks.check import Check
from clacad.checks.file_kinds import FAITHFUL_RMS, FILE_TARGET

if TYPE_CHECKING:
    from clacad.verification.verification_report import Report

FEWEST, MOST = 1 << 14, 1 << 20
"""Fewest and most rays; with fewer, too few rays pass a file's triangles for the fits."""
SURE = 10.0
"""Least ratio of the target to the standard error of the mean."""


def rays_for(target: float, spread: float) -> int:
    """Fewest rays, a power of two, whose mean has a standard error of a tenth of a target.

    Parameters
    ----------
    target : float, radians
        Rms direction error that matters.
    spread : float, radians
        Rms error of a single ray; the mean of n has a standard error of spread/√n (less with Sobol points).
    """
    needed = (SURE * spread / target) ** 2
    if needed >= MOST:
        return MOST
    return max(FEWEST, 1 << ceil(log2(max(1.0, needed))))


def judged_by(report: Report, target: float) -> Report:
    """Add checks to a report: whether light through each file is within a target of the exact surfaces
    (radians).
    """
    return replace(report, checks=(*report.checks, *target_checks(report.checks, target)))


def target_checks(checks: Sequence[Check], target: float) -> list[Check]:
    """One check for each file whose light was measured."""
    found = []
    for check in checks:
        if check.kind is not FAITHFUL_RMS:
            continue
        if not isinstance(check.value, float):
            found.append(replace(check, id=FILE_TARGET.id, limit=target, detail={}))
            continue
        within = "within" if check.value <= target else "not within"
        text = (
            f"light through it is {1e3 * check.value:.4g} mrad rms off the exact surfaces, {within} the "
            f"{1e3 * target:.4g} mrad requested"
        )
        found.append(
            FILE_TARGET.judge(
                check.value, target, text, bundle=check.bundle, where=check.where, subject=check.subject
            )
        )
    return found
