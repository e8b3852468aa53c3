"""Design rules of a process: limits of the tool, the mould, the light or the printer, and of the part.

In one cell the limits give warnings, with numbers; a design file can accept a warning with a reason: `[check]
allow`. Of the whole part: whether the process can work its material, and whether it fits the machine.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import degrees, inf, pi
from typing import TYPE_CHECKING

from clacad.base.text import percent_text
from clacad.checks.check import DESIGN_FILE, NEAR, Check, CheckKind, LimitSource, from_profile
from clacad.checks.design_kinds import (
    ASPECT,
    DRAFT,
    LAYER,
    PART_HEIGHT,
    PART_WIDTH,
    SLOPE,
    TOOL,
    UNDERCUT,
    VOXEL,
    WALL,
    WORKABLE,
)
from clacad.design.process_profiles import ProcessProfile, profile, profiles
from clacad.optics.material.catalogue import find, names
from clacad.optics.material.material import Material
from clacad.sheet.feasibility import Feasibility, convex_extremes
from clacad.sheet.volume_and_extent import body_extent
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.design import Design


LOST = 0.1
"""Share of a cell's width that a tool may leave rounded without a warning."""

PURE = (DRAFT, SLOPE, ASPECT)
"""Limits that are not lengths."""

NEGLIGIBLE = 1e-7
"""Metres; walls lower than this are roughness."""


@dataclass(frozen=True, eq=False)
class Built:
    """A window under judgement by the design rules: what every function of them takes.

    design : Gives the limits and the process.
    facts : Derived numbers of this window.
    solved : Whether to compute a thickness, index or pitch that covers the cell of a lens that does not:
        about a second.
    """

    design: Design
    window: Window
    facts: Feasibility
    solved: bool = True

    @property
    def rules(self) -> ProcessProfile:
        """Profile of the design's process."""
        return profile(self.design.check.process)

    def limit(self, kind: CheckKind) -> tuple[float, LimitSource]:
        """Limit by the process; see `process_limit`."""
        return process_limit(self.design, self.rules, kind)


def process_limit(design: Design, rules: ProcessProfile, kind: CheckKind) -> tuple[float, LimitSource]:
    """Limit (lengths in design units) and its source: the design's own key, else the process profile."""
    own = getattr(design.check, kind.limit)
    if own is not None:
        return float(own), DESIGN_FILE
    value = float(getattr(rules, kind.limit))
    return (value if kind in PURE else value / design.unit_m), from_profile(rules)


def making(built: Built) -> Iterator[Check]:
    """Judge a window by the rules of the design's process; rules without a limit are omitted."""
    yield from _rules_of_shape(built)
    yield from _rules_of_fineness(built)
    if not built.rules.undercut:
        yield _undercut(built)


def _rules_of_shape(built: Built) -> Iterator[Check]:
    """Rounding that the tool leaves, and the height, draft and steepness of walls and faces."""
    window, facts, unit = built.window, built.facts, built.design.unit
    tool, source = built.limit(TOOL)
    if tool > 0.0:
        seen = convex_extremes.groove(window, tool)
        text = (
            f"a nose radius of {tool:.4g} {unit} leaves {percent_text(seen.value)} of a cell's width rounded"
            f" at {seen.what}"
        )
        way_out = "a smaller tool, larger radii, or a seam where the rounding may lie"
        yield _rule(TOOL, seen, (LOST, source), text, way_out)
    highest, source = built.limit(WALL)
    if highest < inf:
        seen = convex_extremes.wall(window, facts)
        text = f"{seen.what} is {seen.value:.4g} {unit} high"
        yield _rule(WALL, seen, (highest, source), text, "less tilt, aligned meridians, or a seam", unit)
    least, source = built.limit(DRAFT)
    if least > 0.0:
        seen = convex_extremes.draft(window, facts, NEGLIGIBLE / built.design.unit_m)
        text = (
            f"{seen.what} is at {degrees(seen.value):.3g} deg to the sheet's normal, {degrees(least):.3g}"
            " are needed"
        )
        yield _rule(DRAFT, seen, (least, source), text, "a seam with room for sloping walls, or less tilt")
    most, source = built.limit(SLOPE)
    if most < 0.5 * pi:
        seen = convex_extremes.steepest(facts)
        text = f"{seen.what} is up to {degrees(seen.value):.3g} deg steep, {degrees(most):.3g} can be made"
        yield _rule(SLOPE, seen, (most, source), text, "larger radii, a smaller pitch or less tilt")


def _rules_of_fineness(built: Built) -> Iterator[Check]:
    """Whether voxels and layers are fine enough, and how narrow and tall features are."""
    window, facts, unit = built.window, built.facts, built.design.unit
    voxel, source = built.limit(VOXEL)
    if voxel > 0.0:
        seen = convex_extremes.narrowest(window)
        text = f"{seen.what} is {seen.value:.4g} {unit}, a voxel {voxel:.4g}"
        yield _rule(VOXEL, seen, (voxel, source), text, "a larger pitch or wider seams and walls", unit)
    layer, source = built.limit(LAYER)
    if layer > 0.0:
        seen = convex_extremes.shallowest(facts)
        text = (
            f"{seen.what} is {seen.value:.4g} {unit}, a layer {layer:.4g}: it takes"
            f" {convex_extremes.FINE * seen.value / layer:.3g} layers, {convex_extremes.FINE} are the least"
        )
        way_out = "smaller radii or a larger pitch: steeper lenses have more layers"
        yield _rule(LAYER, seen, (layer, source), text, way_out, unit)
    ratio, source = built.limit(ASPECT)
    if ratio < inf:
        seen = convex_extremes.tallest(window, facts)
        text = f"{seen.what} is {seen.value:.4g}"
        yield _rule(ASPECT, seen, (ratio, source), text, "wider walls and seams, or shallower ones")


def _undercut(built: Built) -> Check:
    lens = min(built.facts.lenses, key=lambda lens: lens.least_normal_z)
    text = f"the normals of {lens.name} lean to a z component of {lens.least_normal_z:.3g}"
    seen, limit = convex_extremes.Named(lens.least_normal_z, lens.name), (0.0, from_profile(built.rules))
    return _rule(UNDERCUT, seen, limit, text, "less tilt or larger radii: what overhangs cannot be reached")


def _rule(
    kind: CheckKind,
    seen: convex_extremes.Named,
    limit: tuple[float, LimitSource],
    sentence: str,
    way_out: str,
    unit: str = "",
) -> Check:
    """Warn where a value violates its limit, with a remedy.

    unit : of a length; other units are declared with the kind
    """
    most, source = limit
    check = kind.judge(
        seen.value, most, sentence, unit=unit or kind.unit, limit_source=source, detail={"where": seen.what}
    )
    return check if check.state == "pass" else replace(check, state="warn", sentence=f"{sentence}; {way_out}")


_WAYS = {PART_HEIGHT: "high", PART_WIDTH: "wide"}
VISIBLE = 550e-9
"""Metres; wavelength at which two materials are compared, if both indices are known there."""


def sizes(built: Built) -> Iterator[Check]:
    """Judge the height and width of the parts by the design's process; no checks where it sets no limit."""
    design, window = built.design, built.window
    extents = {body.name: body_extent(window, body) for body in window.bodies}
    found = {
        PART_HEIGHT: {body.name: body.high - body.low for body in built.facts.bodies},
        PART_WIDTH: {name: max(x1 - x0, y1 - y0) for name, (x0, x1, y0, y1) in extents.items()},
    }
    for kind, size in found.items():
        limit, source = built.limit(kind)
        if limit < inf:
            name = max(size, key=lambda name: size[name])
            sentence = f"{name} is {size[name]:.4g} {design.unit} {_WAYS[kind]}"
            if size[name] > limit:
                sentence += f"; {_larger(kind, size[name], design, window)}"
            yield kind.judge(
                size[name], limit, sentence, near=NEAR, unit=design.unit, subject=name, limit_source=source
            )


def _larger(kind: CheckKind, value: float, design: Design, window: Window) -> str:
    """Name the process that makes parts of this size and these materials with the smallest margin."""
    most = {p.name: float(getattr(p, kind.limit)) for p in _other_processes(design, window)}
    larger = [name for name, size in most.items() if size >= value * design.unit_m]
    if not larger:
        return "no other process known here makes such parts of this material"
    nearest = min(larger, key=lambda name: most[name])
    return f"{nearest} makes parts up to {most[nearest] / design.unit_m:.4g} {design.unit} {_WAYS[kind]}"


def _other_processes(design: Design, window: Window) -> list[ProcessProfile]:
    """Processes that work all materials of the parts, without the design's own and "none"."""
    materials = [body.material for body in window.bodies if body.material is not None]
    return [
        p
        for p in profiles()
        if p.materials and p.name != design.check.process and all(p.works(one) for one in materials)
    ]


def workable(built: Built) -> Iterator[Check]:
    """Judge each material of the parts once, by the design's process; a bare index is no material."""
    design, window, rules = built.design, built.window, built.rules
    own = design.check.materials
    if not rules.materials and own is None:
        return
    source = from_profile(rules) if own is None else DESIGN_FILE
    worked = None if own is None else {find(name).name for name in own}
    for material in {body.material.name: body.material for body in window.bodies if body.material}.values():
        good = rules.works(material) if worked is None else material.name in worked
        if not good and not material.kind and worked is None:
            why = f"nothing is known of how {material.name} is worked"
            yield WORKABLE.not_run(why, required=False, subject=material.name)
            continue
        sentence = f"{rules.name} {'works' if good else 'does not work'} {material.name}"
        if not good:
            sentence += f" ({material.kind}); {_way_out(material, design, rules)}"
        yield WORKABLE.check(
            "pass" if good else "fail",
            sentence,
            material.name,
            " or ".join(worked or rules.materials),
            subject=material.name,
            limit_source=source,
        )


def _way_out(material: Material, design: Design, rules: ProcessProfile) -> str:
    """Name the processes that work a material, and the workable material nearest to it in index."""
    processes = [p.name for p in profiles() if p.materials and p.works(material)]
    ways = f"{' or '.join(processes)} works it" if processes else "no process known here works it"
    wave = design.pair.wavelength or VISIBLE
    worked = [one for name in names() if rules.works(one := find(name)) and one.knows(wave)]
    if not worked or not material.knows(wave):
        return ways
    index = material.index(wave)
    nearest = min(worked, key=lambda one: abs(one.index(wave) - index))
    return f"{ways}; {rules.name} works {nearest.name} (n = {nearest.index(wave):.4g}, here {index:.4g})"
