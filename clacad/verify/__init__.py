"""Verification: what was written is traced, and every number is held against what was asked.

`verify` gives a `Report`; its `passed`, its JSON and the page made from it are one object.
"""

from __future__ import annotations

from clacad.verify.checks import CODES, Check, passed
from clacad.verify.files import CannotRegister
from clacad.verify.geometry import design_checks
from clacad.verify.run import Report, verify

__all__ = ["CODES", "CannotRegister", "Check", "Report", "design_checks", "passed", "verify"]
