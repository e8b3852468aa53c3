"""Checks of the design rules: whether the part can exist, and whether the chosen process can make it.

No light is traced; the values are the derived numbers of `clacad.sheet.feasibility`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import ceil, floor, hypot, inf, isfinite, log10, tan
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.text import count_text, digits, mrad_text, percent_text
from clacad.checks.check import DEFAULT, NEAR, Check, CheckKind, State, accepted, found_by
from clacad.checks.design_kinds import (
    CLEARANCE,
    COVER,
    EDGE,
    GRAPH,
    NECK,
    ONE_PIECE,
    PITCH,
    RADIUS,
    SAG,
    WALL,
)
from clacad.checks.light_kinds import FIELD, FRESNEL_NUMBER, ORDERS, RESIDUAL
from clacad.design.sections import PAIR
from clacad.sheet.cell_heights import highest_step
from clacad.sheet.feasibility import BodyFacts, Feasibility, LensFacts, cell_feasibility, least_thickness
from clacad.sheet.like_cell import like_cell
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.vignetting import order_steps
from clacad.sheet.window import Window
from clacad.verification.process_rules import Built

if TYPE_CHECKING:
    from clacad.design import Design


def design_checks(
    design: Design, window: Window, facts: Feasibility, *, solved: bool = True
) -> tuple[Check, ...]:
    """Judge a window by the design rules.

    Parameters
    ----------
    design, window, facts, solved
        As in `Built`.
    """
    built = Built(design, window, facts, solved)
    found = [*_cell_checks(built), *(check for judge in found_by("part") for check in judge(built))]
    return accepted(found, design)


def _cell_checks(built: Built) -> tuple[Check, ...]:
    """Judge the cells of a window; in a uniform sheet one cell represents all."""
    if not built.window.uniform:
        return _in_outer_cells(built)
    return tuple(check for judge in found_by("cell") for check in judge(built))


def _in_outer_cells(built: Built) -> tuple[Check, ...]:
    """The checks of a non-uniform sheet: each in the worst of the cells whose lenses lie farthest out."""
    design, window, whole = built.design, built.window, built.facts
    worst: dict[tuple[str, str], Check] = {}
    highest = max((highest_step(window, body) for body in window.bodies), key=lambda step: step.height)
    fields = [min(whole.half_field)]
    for cell in representative_cells(window, "displaced"):
        like = like_cell(window, cell)
        facts = cell_feasibility(window, cell, *design.viewing_places).with_steps_of(whole)
        fields += facts.half_field if window.many_sizes else ()
        for check in _cell_checks(Built(design, like, facts, solved=False)):
            key, known = (check.id, check.subject), worst.get((check.id, check.subject))
            if known is None or _worse(check, known):
                at = cell.tolist() if check.kind is not WALL else list(highest.cell)
                named = f"in cell ({at[0]}, {at[1]}): {check.sentence}"
                worst[key] = replace(check, sentence=named, detail={**check.detail, "cell": at})
    found = [_priced(check) for check in worst.values() if check.kind is not FIELD]
    reach, half = tan(design.check.field), min(fields)
    sentence = "each cell is for the light of its own place; the cone of test rays about it"
    inside = reach <= half
    found.append(
        FIELD.check(
            "pass" if inside else "warn",
            f"{sentence} lies {'in' if inside else 'out'}side its field of view",
            reach,
            half,
            required=False,
        )
    )
    return tuple(found)


def _priced(check: Check) -> Check:
    """Fail the check of steps between neighbours of a non-uniform sheet that the process cannot make."""
    if check.kind is not WALL or check.state != "warn":
        return check
    sentence, _, _ = check.sentence.rpartition("; ")
    return replace(
        check,
        state="fail",
        sentence=(
            f"{sentence}: the price of cells that differ; a viewer or image farther away, a smaller p/s or"
            " another process"
        ),
    )


def _worse(one: Check, other: Check) -> bool:
    """Whether a check reports a worse part than another check of the same name."""
    order = ("fail", "not run", "warn", "pass")
    if one.state != other.state:
        return order.index(one.state) < order.index(other.state)
    if not (isinstance(one.value, float) and isinstance(other.value, float)):
        return False
    return one.value > other.value if one.relation == "<=" else one.value < other.value


def one_piece(built: Built) -> Iterator[Check]:
    """Judge whether each body is in one piece, without pinholes."""
    return map(_one_piece, built.facts.bodies)


def _one_piece(body: BodyFacts) -> Check:
    whole = body.pieces == 1 and body.holes == 0
    if whole:
        sentence = f"{body.name} is one piece without holes"
    elif body.pieces > 1:
        widest = max(body.borders, key=lambda b: -b.joint)
        sentence = (
            f"{body.name} falls into {body.pieces} pieces with {count_text(body.holes, 'hole')}: neighbours"
            f" do not touch across step {widest.step}, they miss each other by {-widest.joint:.4g}; a thicker"
            " lens, a web or a smaller pitch joins them"
        )
    else:
        sentence = (
            f"{body.name} is one piece with {count_text(body.holes, 'pinhole')} where the corners of the"
            f" lenses do not meet; they lack {-body.edge:.4g} of thickness there"
        )
    return ONE_PIECE.check(
        "pass" if whole else "fail",
        sentence,
        f"{count_text(body.pieces, 'piece')}, {count_text(body.holes, 'hole')}",
        "1 piece, 0 holes",
        subject=body.name,
        detail={"pieces": body.pieces, "holes": body.holes},
    )


def cover(built: Built) -> Iterator[Check]:
    """Judge the share of its cell that each lens covers."""
    return (_cover(built, lens) for lens in built.facts.lenses)


def _cover(built: Built, lens: LensFacts) -> Check:
    name, limit = lens.name, built.design.check.cover
    if lens.cover >= limit:
        sentence = f"{name} fills its cell"
    else:
        x, y = lens.rim_at
        sentence = (
            f"{name} fills {lens.cover:.3f} of its cell: its rim ends at {lens.rim[0]:.4g}, {lens.rim[1]:.4g}"
            f" along its axes, and at ({x:.4g}, {y:.4g}) it lacks {-lens.corner:.4g} of thickness"
        )
        if built.solved:
            sentence += f". {_way_to_cover(built.design, built.window, lens)}"
    return COVER.judge(
        lens.cover,
        limit,
        sentence,
        subject=name,
        detail={"rim": lens.rim, "least_thickness": lens.least_thickness, "corner": lens.corner},
    )


def _way_to_cover(design: Design, window: Window, lens: LensFacts) -> str:
    """Text of the values that cover the cell, by building windows: the radii follow the thickness."""
    if not (isfinite(lens.least_thickness) and lens.least_thickness > 0.0):
        return "No thickness covers it at these radii: a smaller pitch or a larger separation would"
    ways = [f"thickness >= {_rounded(lens.least_thickness, ceil)}"]
    if design.pair.form == "biconvex":
        solved = _covering_thickness(design, lens)
        if solved is not None:
            ways = [f"thickness >= {_rounded(solved, ceil)} for {('lens 1', 'lens 2')[lens.array]}"]
    index = _covering_index(design, lens)
    if index is not None:
        ways.append(f"index >= {index:.3f}")
    shrink = _covering_shrink(window, lens)
    if shrink is not None:
        ways.append(f"pitch <= {_rounded(max(design.lattice.pitch) * shrink, floor)}")
    return ", or ".join(ways) + ' would cover it (or thickness = "auto")'


def _rounded(value: float, whole: Callable[[float], int]) -> str:
    """Text of a value with three digits, rounded up (`ceil`) or down (`floor`)."""
    step = 10.0 ** (floor(log10(value)) - 2)
    return f"{whole(value / step) * step:.3g}"


def _covering_shrink(window: Window, lens: LensFacts) -> float | None:
    """Factor on the pitch at which the lens as built covers its cell; None if none is found."""
    factor, wanted = 1.0, lens.least_thickness
    for _ in range(12):
        factor *= float(np.sqrt(lens.thickness / wanted))
        pitch = (window.lattice.pitch[0] * factor, window.lattice.pitch[1] * factor)
        wanted = least_thickness(replace(window, lattice=replace(window.lattice, pitch=pitch)), lens.array)
        if not (isfinite(wanted) and wanted > 0.0):
            return None
        if abs(wanted - lens.thickness) <= 1e-4 * lens.thickness:
            return factor * (1.0 - 1e-4)
    return None


def _covering_thickness(design: Design, lens: LensFacts) -> float | None:
    """Centre thickness that covers the cell, with the radii solved again for it; None if none is found."""
    from clacad.design import DesignError
    from clacad.prescription.prescribe import prescribe

    given = design.pair.thicknesses
    if given is None:
        return None
    thickness, wanted = list(given), lens.least_thickness
    for _ in range(12):
        thickness[lens.array] = wanted
        try:
            window = prescribe(design.replace({PAIR.thickness: list(thickness)}))
        except DesignError:
            return None
        found = least_thickness(window, lens.array)
        if not isfinite(found):
            return None
        if abs(found - wanted) <= 1e-6 * wanted:
            return found
        wanted = found
    return None


def _covering_index(design: Design, lens: LensFacts) -> float | None:
    """Refractive index at which the given thickness covers the cell, rounded up; None if there is none below
    4.

    Radii grow as n − 1 and sags fall as its inverse, so the iteration n − 1 ← (n − 1) T_min/T converges fast.
    """
    from clacad.design import DesignError
    from clacad.prescription.prescribe import prescribe

    if design.pair.index is None or design.pair.thicknesses is None or design.pair.form != "biconvex":
        return None
    thickness, wanted, index = design.pair.thicknesses[lens.array], lens.least_thickness, design.pair.index
    for _ in range(12):
        index = 1.0 + (index - 1.0) * wanted / thickness
        if not 1.0 < index < 4.0:
            return None
        try:
            wanted = least_thickness(prescribe(design.replace({PAIR.index: index})), lens.array)
        except DesignError:
            return None
        if not isfinite(wanted):
            return None
        if abs(wanted - thickness) <= 1e-4 * thickness:
            return float(np.ceil(1e3 * index) / 1e3)
    return None


def graph(built: Built) -> Iterator[Check]:
    """Judge the steepest place of each lens."""
    return (_graph(lens, built.design.check.graph) for lens in built.facts.lenses)


def _graph(lens: LensFacts, limit: float) -> Check:
    value, name = lens.least_normal_z, lens.name
    if value >= limit:
        slope = np.degrees(np.arccos(min(1.0, value)))
        sentence = f"steepest slope of {name} against the sheet is {slope:.3g} deg"
    else:
        sentence = (
            f"{name} is too steep or undercut at its border: a larger radius, a smaller pitch or less tilt"
        )
    return GRAPH.judge(value, limit, sentence, subject=name)


def lengths(built: Built) -> Iterator[Check]:
    """Judge the lengths that every process limits: gaps, edges, necks, radii, heights, pitch."""
    facts, unit = built.facts, built.design.unit
    if isfinite(facts.clearance):
        yield _at_least(built, CLEARANCE, facts.clearance, "gap between the two bodies, steps included")
    for body in facts.bodies:
        text = f"least thickness along the outer side of {body.name}"
        yield _thicker(built.design, _at_least(built, EDGE, body.edge, text, body.name))
        if isfinite(body.neck):
            text = f"least thickness that joins neighbours in {body.name} after the step between them"
            yield _thicker(built.design, _at_least(built, NECK, body.neck, text, body.name))
    for lens in facts.lenses:
        smallest = min(abs(r) for r in lens.radii)
        yield _at_least(built, RADIUS, smallest, f"smallest apex radius of {lens.name}", lens.name)
        limit, source = built.limit(SAG)
        text = f"height of {lens.name} over its cell is {lens.sag:.4g} {unit}"
        yield SAG.judge(lens.sag, limit, text, near=NEAR, unit=unit, subject=lens.name, limit_source=source)
    yield _at_least(built, PITCH, min(built.design.lattice.pitch), "pitch of the lattice")


def _at_least(built: Built, kind: CheckKind, value: float, text: str, subject: str = "") -> Check:
    """Judge a length that must reach its limit; where the limit is 0 it must exceed it."""
    (limit, source), unit = built.limit(kind), built.design.unit
    sentence = f"{text}: {value:.4g} {unit}"
    if value <= 0.0:
        nothing = "the bodies run into one another" if kind is CLEARANCE else "the part has no material there"
        sentence += f"; {nothing}"
    check = kind.judge(value, limit, sentence, near=NEAR, unit=unit, subject=subject, limit_source=source)
    if limit == 0.0:  # a length of 0 fails
        return replace(check, relation=">", state="fail" if value <= 0.0 else check.state)
    return check


def _thicker(design: Design, check: Check) -> Check:
    """Name, in a failing check, the keys that make a body of this form thicker at that place."""
    if check.state != "fail":
        return check
    keys = {
        "biconvex": "pair.thickness, pair.web, or body.border with a web",
        "plano": "pair.thickness, body.neck, or body.border",
        "slab": PAIR.separation,
        "plates": "a larger place of a face of pair.face",
    }
    return replace(check, sentence=f"{check.sentence}; {keys[design.pair.form]} makes it thicker")


def field(built: Built) -> Iterator[Check]:
    """Judge whether the sheet's normal, with the cone of test rays about it, lies in the field of view."""
    facts = built.facts
    off = [abs(a) for a in facts.aperture]
    reach = tan(built.design.check.field)
    half = min(facts.half_field)
    value = hypot(*off) + reach
    if value <= half:
        sentence = "the sheet's normal and the cone of test rays about it lie inside the field of view"
    else:
        sentence = (
            f"light along the sheet's normal is {hypot(*off):.4g} in slope off the middle of the field of"
            f" view, whose half width is {half:.4g}; lattice.aperture steers the field"
        )
    state: State = "pass" if value <= half else "warn"
    yield FIELD.check(
        state,
        sentence,
        value,
        half,
        required=False,
        detail={"aperture": facts.aperture, "half_field": facts.half_field, "ghost_onset": facts.ghost_onset},
    )


def fresnel_number(built: Built) -> Iterator[Check]:
    """Judge whether rays describe the light of one lenslet."""
    facts = built.facts
    value, limit = facts.fresnel_number, built.design.check.fresnel_number
    sentence = f"Fresnel number {value:.4g}"
    if value < 1.0:
        sentence += ": below 1 the ray picture is void; a larger pitch or a shorter separation"
        yield FRESNEL_NUMBER.check("fail", sentence, value, 1.0, limit_source=DEFAULT)
        return
    if value < limit:
        sentence += (
            f": diffraction blurs as much as {mrad_text(max(facts.diffraction_blur), 3)}, and takes up to "
        )
        sentence += f"{percent_text(max(facts.viewing.lost), 2)} of the light to other cells, along that axis"
    state: State = "warn" if value < limit else "pass"
    yield FRESNEL_NUMBER.check(state, sentence, value, limit)


def orders(built: Built) -> Iterator[Check]:
    """Judge the deviation of coherent light from the law: half a step of the grating of identical cells."""
    design, window = built.design, built.window
    if not design.light.coherent:
        return
    steps = order_steps(window.lattice, built.facts.wavelength / window.unit)
    value, limit = 0.5 * max(steps), design.check.law_rms
    first, second = (digits(1e3 * step, count=3) for step in steps)
    cells = "equal" if window.uniform else "neighbouring"
    sentence = (
        f"in coherent light {cells} cells send orders {first} and {second} mrad apart, so the law is met to "
        f"±{digits(1e3 * value, count=3)} mrad only"
    )
    state: State = "pass" if value <= limit else "warn"
    yield ORDERS.check(state, sentence, value, limit, required=False, detail={"steps": steps})


def residual(built: Built) -> Iterator[Check]:
    """Judge the residual of the recipe along the axis ray: parabasal law error and decollimation."""
    design, window = built.design, built.window
    left = [float(v) for v in window.residual.values()]
    if not left:
        yield RESIDUAL.not_run("the window does not say what its recipe leaves", unit="rad", required=False)
        return
    value, limit = max(left, default=inf), design.check.law_rms
    sentence = f"along the axis ray the recipe leaves {digits(1e3 * value, count=3)} mrad"
    if value == inf:
        sentence = (
            "the ray along the lens axis does not get through: it misses a lens or is totally reflected"
        )
    elif value > limit:
        recipe = "" if design.pair.form in ("slab", "plates") else 'pair.confocal = "exact" or "best", '
        sentence += f"; another recipe ({recipe}pair.conic), less tilt or another form would leave less"
    yield RESIDUAL.judge(value, limit, sentence, detail=dict(window.residual))
