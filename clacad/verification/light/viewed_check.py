"""The check `viewed`: it judges a stated viewer, warns of an assumed one, and finds changes that keep more light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import ceil, floor, log10
from typing import TYPE_CHECKING, Any

from clacad.config.edit_text import value_text
from clacad.design.sections import AimedAt
from clacad.sheet.window import Window
from clacad.verification.check_kinds.light import VIEWED
from clacad.verification.checks import Check
from clacad.verification.light.law_checks import Lit
from clacad.verification.light.viewed import thin_share, viewed, viewer_of

if TYPE_CHECKING:
    from clacad.design import Design

Point = tuple[float, float, float]

TRIED_RAYS = 4096
"""Sobol rays through each changed sheet: the mean is within .008."""

FARTHEST = 1024.0
"""Largest factor on the viewer's distance that is tried."""

STEPS = 6
"""Most steps of a tenth that rays need beyond the distance for ideal lenses."""


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
        sentence += f"; {_remedy_text(design, window, found.viewer)}" if lit.remedies else ""
    check = VIEWED.judge(
        found.traced, limit, sentence, required=stated,
        bundle=f"{len(found.alive)} Sobol rays over all cells, seed 0",
        detail={"viewer": found.viewer, "thin": found.thin, "stated": stated, "eye": eye},
    )  # fmt: skip
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


# -- changes that keep more of the light, each tried ----------------------------------------------


def _remedy_text(design: Design, window: Window, viewer: Point) -> str:
    """Name the changes that reach the limit."""
    limit = f"{100.0 * design.check.viewed:.4g} %"
    found = [*_keys(design, viewer), *_farther(design, window, viewer)]
    if not found:
        return f"neither aimed cells nor a field lens nor a viewer farther away reaches {limit}"
    return f"{limit} is reached by {', or by '.join(found)}"


def _keys(design: Design, viewer: Point) -> Iterator[str]:
    """Keys whose change reaches the limit: cells aimed at the viewer, or a field lens."""
    point = {"lattice.aperture": {"point": [int(v) if v.is_integer() else v for v in map(float, viewer)]}}
    for changes in (point, {"pair.field_lens": True}):
        changed = _built(design, changes)
        share = 0.0 if changed is None else viewed(changed, viewer, TRIED_RAYS).traced
        if share >= design.check.viewed:
            ((key, value),) = changes.items()
            yield f"{key} = {value_text(value)} ({100.0 * share:.3g} %)"


def _built(design: Design, changes: dict[str, Any]) -> Window | None:
    """The sheet with some keys changed, or None where it cannot be built; aimed cells use paraxial lenses."""
    from clacad.design import DesignError
    from clacad.prescription.aimed_cells import refuse_aim
    from clacad.prescription.prescribe import prescribe
    from clacad.prescription.radii import NoSuchLens

    try:
        asked = design.replace(changes)
        if not isinstance(asked.lattice.aperture, AimedAt):
            return prescribe(asked)
        plain = asked.replace({"pair.offset": "paraxial"})
        refuse_aim(prescribe(plain.replace({"lattice.aperture": "aligned"})), asked)
        return prescribe(plain)
    except (DesignError, NoSuchLens):
        return None


def _farther(design: Design, window: Window, viewer: Point) -> Iterator[str]:
    """Nearest viewer distance that reaches the limit, first by thin lenses and then by rays."""
    limit = design.check.viewed

    def at(factor: float) -> Point:
        x, y, z = (factor * v for v in viewer)
        return x, y, z

    if isinstance(design.lattice.aperture, AimedAt) or thin_share(window, at(FARTHEST)) < limit:
        return
    low, high = 1.0, FARTHEST
    while high > 1.02 * low:
        middle = (low * high) ** 0.5
        low, high = (low, middle) if thin_share(window, at(middle)) >= limit else (middle, high)
    for step in range(STEPS):
        distance = _two_digits_up(1.1**step * high * abs(viewer[2]))
        factor = distance / abs(viewer[2])
        if viewed(window, at(factor), TRIED_RAYS).traced >= limit:
            yield f"a viewer at {distance:g} {design.unit} or farther"
            if window.uniform:
                yield f"a sheet {1.0 / factor:.2g} times as wide"
            return


def _two_digits_up(length: float) -> float:
    step = 10.0 ** (floor(log10(length)) - 1)
    return ceil(length / step - 1e-9) * step
