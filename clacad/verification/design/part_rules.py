"""Design rules of the whole part: whether the process can work its material, and whether the part fits the
machine.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from typing import TYPE_CHECKING

from clacad.checks.check import DESIGN_FILE, NEAR, Check, CheckKind, from_profile
from clacad.checks.design_kinds import PART_HEIGHT, PART_WIDTH, WORKABLE
from clacad.design.process_profiles import ProcessProfile, profiles
from clacad.optics.material.catalogue import find, names
from clacad.optics.material.material import Material
from clacad.sheet.volume_and_extent import body_extent
from clacad.sheet.window import Window
from clacad.verification.design.process_rules import Built

if TYPE_CHECKING:
    from clacad.design import Design

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
    """Judge each material of the parts once, by the design's process; a bare index does not identify a
    material.
    """
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
