"""Changes that give a viewer more light: each is built and judged before the check `viewed` names it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from math import ceil, floor, log10
from typing import Any, Final

from clacad.checks.allowances import accepted
from clacad.checks.check import Check, wrong
from clacad.checks.light_kinds import VIEWED
from clacad.config.design_error import DesignError
from clacad.config.edit_text import value_text
from clacad.design import Design
from clacad.design.keys import LATTICE, PAIR
from clacad.design.sections import AimedAt
from clacad.prescription.aimed_cells import refuse_aim
from clacad.prescription.prescribe import prescribe
from clacad.prescription.radii import NoSuchLens
from clacad.sheet.feasibility import feasibility
from clacad.sheet.window import Window
from clacad.verification.design.design_rules import design_checks
from clacad.verification.light.through_window import judge_light
from clacad.verification.light.viewed import thin_share, viewed
from clacad.verification.light.viewed_check import Point

TRIED_RAYS: Final = 4096
"""Sobol rays through each changed sheet: the mean is within .008."""

JUDGED_RAYS: Final = (8192, 1024)
"""Rays of the main bundle and of each field point when a changed design is judged."""

MOST_TRACED: Final = 5000
"""Largest number of aimed cells whose lenses 2 are positioned by traced light, at 1 ms a cell; more are
positioned by formula."""

MOST_AIMED: Final = 10_000_000
"""Largest number of cells that are tried as aimed at the viewer: every cell at the rim is examined."""

FARTHEST: Final = 1024.0
"""Largest factor on the viewer's distance that is tried."""

STEPS: Final = 6
"""Most steps of a tenth that rays need beyond the distance for ideal lenses."""

PARAXIAL: Final = {PAIR.offset: "paraxial"}


def name_remedies(checks: Iterable[Check], design: Design, window: Window) -> list[Check]:
    """Add to the sentence of `viewed`, where it does not pass, the changes that reach its limit.

    A key is named only if the changed design can be built and fails no check that the design passes.

    Parameters
    ----------
    checks : iterable of Check
        All checks of the design, those by light and the design rules.
    design : Design
    window : Window
    """
    checks = list(checks)
    return [
        (
            replace(c, sentence=f"{c.sentence}; {_remedy_text(checks, design, window, c.detail['viewer'])}")
            if c.kind is VIEWED and c.state in ("fail", "warn")
            else c
        )
        for c in checks
    ]


def _remedy_text(checks: list[Check], design: Design, window: Window, viewer: Point) -> str:
    found = [*_keys(_failing(checks, design), design, viewer), *_farther(design, window, viewer)]
    if not found:
        return "neither aimed cells nor a field lens nor a viewer farther away mends it alone"
    return f"{100.0 * design.check.viewed:.4g} % is reached by {', or by '.join(found)}"


def _keys(failing: frozenset[tuple[str, str]], design: Design, viewer: Point) -> Iterator[str]:
    """Keys whose change reaches the limit and makes no other check fail: aimed cells, or a field lens."""
    point = {LATTICE.aperture: {"point": [int(v) if v.is_integer() else v for v in map(float, viewer)]}}
    n1, n2 = design.lattice.count
    aimed = point if n1 * n2 <= MOST_TRACED else point | PARAXIAL
    tried = (aimed, {PAIR.field_lens: True}) if n1 * n2 <= MOST_AIMED else ({PAIR.field_lens: True},)
    for changes in tried:
        share = _share(design, changes, viewer)
        if share >= design.check.viewed and _fails_no_more(design, changes, failing):
            keys = " with ".join(f"{key} = {value_text(value)}" for key, value in changes.items())
            yield f"{keys} ({100.0 * share:.3g} %)"


def _share(design: Design, changes: dict[str, Any], viewer: Point) -> float:
    """Share of the viewer's light with some keys changed; aimed cells use paraxial lenses. 0: it cannot be
    built.
    """
    try:
        asked = design.replace(changes)
        if isinstance(asked.lattice.aperture, AimedAt):
            asked = asked.replace(PARAXIAL)
            refuse_aim(prescribe(asked.replace({LATTICE.aperture: "aligned"})), asked)
        return viewed(prescribe(asked), viewer, TRIED_RAYS).traced
    except (DesignError, NoSuchLens):
        return 0.0


def _fails_no_more(design: Design, changes: dict[str, Any], failing: frozenset[tuple[str, str]]) -> bool:
    """Whether a design with some keys changed can be built and fails no check but those that fail already.

    The rules come first: light is traced only where they hold.
    """
    try:
        changed = design.replace(changes)
        window = prescribe(changed)
        rules = design_checks(changed, window, feasibility(window, *changed.viewing_places), solved=False)
        if not _failing(rules, changed) <= failing:
            return False
        light, _ = judge_light(changed, window, *JUDGED_RAYS)
    except (DesignError, NoSuchLens):
        return False
    return _failing(light, changed) <= failing


def _failing(checks: Iterable[Check], design: Design) -> frozenset[tuple[str, str]]:
    return frozenset((c.id, c.subject) for c in wrong(accepted(checks, design)))


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
