"""Verification: what was written is traced, and every number is held against what was asked.

`verify` gives a `Report`; its `passed`, its JSON and the page made from it are one object. Names resolve
when first used, so that judging a design's geometry does not load the tracer.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clacad.verify.checks import CODES, Check, passed
    from clacad.verify.files import CannotRegister
    from clacad.verify.geometry import design_checks
    from clacad.verify.run import Report, verify

__all__ = ["CODES", "CannotRegister", "Check", "Report", "design_checks", "passed", "verify"]

_HOME = {
    "CODES": "checks", "Check": "checks", "passed": "checks", "CannotRegister": "files",
    "design_checks": "geometry", "Report": "run", "verify": "run",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a public name from its module when it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module 'clacad.verify' has no attribute {name!r}")
    return getattr(import_module(f"clacad.verify.{_HOME[name]}"), name)
