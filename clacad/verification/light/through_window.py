"""Every check by light of a window as built: the law, what passes, confocality."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clacad.sheet.window import Window
from clacad.tracing.trace import trace
from clacad.verification.checks import Check
from clacad.verification.light.field_lens_checks import field_lens_checks
from clacad.verification.light.law_checks import (
    POINT_RAYS,
    Optics,
    confocality_check,
    law_checks,
    measure,
    throughput_check,
)

if TYPE_CHECKING:
    from clacad.design import Design


def judge_light(
    design: Design, window: Window, rays: int, point_rays: int = POINT_RAYS
) -> tuple[list[Check], Optics]:
    """Judge light through a window's exact surfaces by what its design asks; rays as `measure` has them."""
    optics = measure(design, window, lambda lit: trace(window, lit.rays, path="size"), rays, point_rays)
    found = law_checks(design, optics)
    found += [throughput_check(design, window, optics), confocality_check(design, window)]
    if window.thin.field:
        found += field_lens_checks(design, window, optics.main)
    return found, optics
