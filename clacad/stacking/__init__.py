"""Stacks: sheets behind one another, with one part list, one trace and one assembly.

`sheet.stack` holds the positions, `tracing.through_stack` traces rays, `stacking.chief_matrices` gives chief
rays. The modules here measure, write, read back and verify a stack. A stack has no law of its own. Only where
sheets touch does light obey their laws in sequence (`Law.then`); otherwise the air between them matters.
"""

from __future__ import annotations

from clacad.stacking.make_stack import Stacked, StackRequest, stack
from clacad.stacking.stack_light import StackImage, StackLight, StackMeridian

__all__ = ["StackMeridian", "StackImage", "StackLight", "StackRequest", "Stacked", "stack"]
