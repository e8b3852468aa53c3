"""Stacks: sheets behind one another as one part list, one light and one assembly.

What stands where is `sheet.stack`, rays through all of it `tracing.through_stack`, chief rays `optics.chief_rays`; here it is
measured, written, read back and judged. A stack has no law of its own: only where sheets touch does light obey the laws
one after the other (`Law.then`), else the air between them is what makes it a stack.
"""

from __future__ import annotations

from clacad.stacking.make_stack import Stacked, stack
from clacad.stacking.stack_image import StackImage
from clacad.stacking.stack_light import StackLight, StackMeridian
from clacad.stacking.stack_request import StackRequest

__all__ = ["StackMeridian", "StackImage", "StackLight", "StackRequest", "Stacked", "stack"]
