"""Design rules of a process: limits of the tool, the mould, the light or the printer. Warnings, with numbers.

A warning can be allowed in the design file, with a reason: `[check] allow`.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, inf, pi
from typing import TYPE_CHECKING

from clacad.design.process_profiles import ProcessProfile, profile
from clacad.sheet.feasibility import Feasibility
from clacad.sheet.feasibility.process_features import (
    FINE,
    Named,
    draft,
    groove,
    narrowest,
    shallowest,
    steepest,
    tallest,
    wall,
)
from clacad.sheet.window import Window
from clacad.verification.checks import Check, State
from clacad.verification.limit_sources import DESIGN_FILE, LimitSource, from_profile

if TYPE_CHECKING:
    from clacad.design import Design

LOST = 0.1
"""Share of a cell's width that a tool may leave rounded without a warning."""

PURE = ("draft", "slope", "aspect")
"""Limits that are not lengths."""

NEGLIGIBLE = 1e-7
"""Metres; walls lower than this are roughness."""


def making_checks(design: Design, window: Window, facts: Feasibility) -> list[Check]:
    """Judge a window by the rules of the design's process; rules without a limit are omitted."""
    rules = profile(design.check.process)
    found = [
        *_rules_of_shape(design, window, facts, rules),
        *_rules_of_fineness(design, window, facts, rules),
    ]
    return found if rules.undercut else [*found, _undercut(facts, rules)]


def _rules_of_shape(
    design: Design, window: Window, facts: Feasibility, rules: ProcessProfile
) -> Iterator[Check]:
    """Rounding that the tool leaves, and the height, draft and steepness of walls and faces."""
    unit = design.unit
    tool, source = process_limit(design, rules, "tool")
    if tool > 0.0:
        seen = groove(window, tool)
        yield _rule("tool", seen, LOST, "<=", "", source, (
            f"a nose radius of {tool:.4g} {unit} leaves {100 * seen.value:.3g} % of a cell's width rounded at "
            f"{seen.what}"), "a smaller tool, larger radii, or a seam where the rounding may lie")  # fmt: skip
    highest, source = process_limit(design, rules, "wall")
    if highest < inf:
        seen = wall(window, facts)
        yield _rule("wall", seen, highest, "<=", unit, source, f"{seen.what} is {seen.value:.4g} {unit} high",
                    "less tilt, aligned meridians, or a seam")  # fmt: skip
    least, source = process_limit(design, rules, "draft")
    if least > 0.0:
        seen = draft(window, facts, NEGLIGIBLE / design.unit_m)
        yield _rule("draft", seen, least, ">=", "rad", source,
                    f"{seen.what} stands at {degrees(seen.value):.3g} deg to the sheet's normal, "
                    f"{degrees(least):.3g} are needed", "a seam with room for sloping walls, or less tilt")  # fmt: skip
    most, source = process_limit(design, rules, "slope")
    if most < 0.5 * pi:
        seen = steepest(facts)
        yield _rule("slope", seen, most, "<=", "rad", source,
                    f"{seen.what} is up to {degrees(seen.value):.3g} deg steep, {degrees(most):.3g} can be made",
                    "larger radii, a smaller pitch or less tilt")  # fmt: skip


def _rules_of_fineness(
    design: Design, window: Window, facts: Feasibility, rules: ProcessProfile
) -> Iterator[Check]:
    """Whether voxels and layers are fine enough, and how narrow and tall features are."""
    unit = design.unit
    voxel, source = process_limit(design, rules, "voxel")
    if voxel > 0.0:
        seen = narrowest(window)
        yield _rule("voxel", seen, voxel, ">=", unit, source,
                    f"{seen.what} is {seen.value:.4g} {unit}, a voxel {voxel:.4g}",
                    "a larger pitch or wider seams and walls")  # fmt: skip
    layer, source = process_limit(design, rules, "layer")
    if layer > 0.0:
        seen = shallowest(facts)
        yield _rule("layer", seen, layer, ">=", unit, source,
                    f"{seen.what} is {seen.value:.4g} {unit}, a layer {layer:.4g}: it takes "
                    f"{FINE * seen.value / layer:.3g} layers, {FINE} are the least",
                    "smaller radii or a larger pitch: steeper lenses have more layers")  # fmt: skip
    ratio, source = process_limit(design, rules, "aspect")
    if ratio < inf:
        seen = tallest(window, facts)
        yield _rule("aspect", seen, ratio, "<=", "", source, f"{seen.what} is {seen.value:.4g}",
                    "wider walls and seams, or shallower ones")  # fmt: skip


def process_limit(design: Design, rules: ProcessProfile, name: str) -> tuple[float, LimitSource]:
    """Limit (lengths in design units) and its source: the design's own key, else the process profile."""
    own = getattr(design.check, name)
    if own is not None:
        return float(own), DESIGN_FILE
    value = float(getattr(rules, name))
    return (value if name in PURE else value / design.unit_m), from_profile(rules)


def _rule(
    id: str,
    seen: Named,
    limit: float,
    relation: str,
    unit: str,
    source: LimitSource,
    sentence: str,
    way_out: str,
) -> Check:
    """Warn where a value violates its limit, with a remedy."""
    good = seen.value <= limit if relation == "<=" else seen.value >= limit
    state: State = "pass" if good else "warn"
    return Check(
        id, state, sentence if good else f"{sentence}; {way_out}", seen.value, limit, unit, relation, limit_source=source,
        detail={"where": seen.what},
    )  # fmt: skip


def _undercut(facts: Feasibility, rules: ProcessProfile) -> Check:
    lens = min(facts.lenses, key=lambda lens: lens.least_normal_z)
    return _rule(
        "undercut", Named(lens.least_normal_z, lens.name), 0.0, ">=", "",
        from_profile(rules),
        f"the normals of {lens.name} lean to a z component of {lens.least_normal_z:.3g}",
        "less tilt or larger radii: what overhangs cannot be reached",
    )  # fmt: skip
