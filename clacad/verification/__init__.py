"""Verification: a design, and the files made from it, are judged by numbers and limits.

`verify` returns a `Report`; its `passed`, its JSON and its page come from one object. Names resolve
when first used, so that judging a design's geometry does not load the tracer.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    from clacad.checks.check import Check, passed
    from clacad.judging.unit_and_cells import CannotRegister
    from clacad.verification.design_rules import design_checks
    from clacad.verification.run import verify
    from clacad.verification.verification_report import Report

    CODES: Mapping[str, str]

__all__ = ["CODES", "CannotRegister", "Check", "Report", "design_checks", "passed", "verify"]

_HOME = {
    "Check": "checks.check",
    "passed": "checks.check",
    "CannotRegister": "judging.unit_and_cells",
    "design_checks": "verification.design_rules",
    "Report": "verification.verification_report",
    "verify": "verification.run",
}


def __getattr__(name: str) -> Any:
    """Import a public name from its module when it is first used."""
    if name == "CODES":
        kinds = import_module("clacad.checks.check").kinds()
        return {id: kind.code for id, kind in kinds.items()}
    if name not in _HOME:
        raise AttributeError(f"module 'clacad.verification' has no attribute {name!r}")
    return getattr(import_module(f"clacad.{_HOME[name]}"), name)
