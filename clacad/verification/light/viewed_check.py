"""The check `viewed`: it judges a stated viewer, and warns of an assumed one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from clacad.checks.check import Check
from clacad.checks.light_kinds import VIEWED
from clacad.design.sections import AimedAt
from clacad.verification.light.law_checks import Lit
from clacad.verification.light.viewed import viewed, viewer_of

if TYPE_CHECKING:
    from clacad.design import Design

Point = tuple[float, float, float]


def viewed_check(lit: Lit) -> Iterator[Check]:
    """Judge the share of the viewer's light that obeys the law.

    Below the limit a stated viewer fails and an assumed one warns.
    """
    design, window = lit.design, lit.window
    found = viewed(window, viewer_of(design))
    stated, limit = design.check.viewer is not None, design.check.viewed
    eye = _eye(design, found.viewer)
    sentence = _share_of(found.traced, eye)
    if not found.traced >= limit:
        sentence += f" (ideal lenses: {100.0 * found.thin:.3g} %); the rest meets other lenslets"
    check = VIEWED.judge(
        found.traced,
        limit,
        sentence,
        required=stated,
        bundle=f"{len(found.alive)} Sobol rays over all cells, seed 0",
        detail={"viewer": found.viewer, "thin": found.thin, "stated": stated, "eye": eye},
    )
    yield replace(check, state="warn") if check.state == "fail" and not stated else check


def headline(checks: Sequence[Check]) -> str:
    """One line with the share of light for the viewer and the limit; "" where that was not checked."""
    check = next((c for c in checks if c.kind is VIEWED and isinstance(c.value, float)), None)
    if check is None:
        return ""
    verdict = {"pass": "passes", "fail": "FAILS", "warn": "a warning"}[check.state]
    limit = f"limit {100.0 * float(check.limit or 0.0):.4g} %"
    return f"{_share_of(float(check.value or 0.0), check.detail['eye'])} ({limit}: {verdict})"


def _share_of(share: float, eye: str) -> str:
    """Text of the share, never rounded up to 100 %."""
    percent = 100.0 if share == 1.0 else min(100.0 * share, 99.9)
    return f"{percent:.3g} % of the light of {eye} obeys the law over the whole sheet"


def _eye(design: Design, viewer: Point) -> str:
    """Text of the eye's position and its source."""
    x, y, z = viewer
    where = f"at ({x:.4g}, {y:.4g}, {z:.4g}) {design.unit}"
    if design.check.viewer is not None:
        return f"the eye of check.viewer {where}"
    if isinstance(design.lattice.aperture, AimedAt):
        return f"the eye {where} that the cells are aimed at"
    return f"an assumed eye {where} (check.viewer states one)"
