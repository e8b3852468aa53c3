"""Checks of the design rules: whether the part can exist, and whether the chosen process can make it.

No light is traced; the values are the derived numbers of `clacad.sheet.feasibility`.
"""

from __future__ import annotations

from dataclasses import replace
from math import hypot, inf, isfinite, tan
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.digits import digits
from clacad.base.text import count_text
from clacad.design.keys import PAIR
from clacad.design.process_profiles import profile
from clacad.sheet.coherent_orders import order_steps
from clacad.sheet.feasibility import BodyFacts, Feasibility, LensFacts, cell_feasibility, least_thickness
from clacad.sheet.like_cell import like_cell, outer_cells
from clacad.sheet.own_steps import highest_step
from clacad.sheet.window import Window
from clacad.verification.checks import NEAR, Check, State, accepted, judge, not_run
from clacad.verification.design.part_rules import part_checks
from clacad.verification.design.process_rules import making_checks, process_limit
from clacad.verification.limit_sources import DEFAULT, LimitSource, from_key, other

if TYPE_CHECKING:
    from clacad.design import Design


def design_checks(
    design: Design, window: Window, facts: Feasibility, *, solved: bool = True
) -> tuple[Check, ...]:
    """Judge a window by the design rules.

    Parameters
    ----------
    design : Design
        Gives the limits and the process.
    window : Window
    facts : Feasibility
        Derived numbers of this window.
    solved : bool
        Whether to compute a thickness, index or pitch that covers the cell of a lens that does not: about a second.
    """
    found = [*_cell_checks(design, window, facts, solved), *part_checks(design, window, facts)]
    return accepted(found, design)


def _cell_checks(
    design: Design, window: Window, facts: Feasibility, solved: bool = False
) -> tuple[Check, ...]:
    """Judge the cells of a window; in a uniform sheet one cell represents all."""
    if not window.uniform:
        return _in_outer_cells(design, window, facts)
    found: list[Check] = [_one_piece(body) for body in facts.bodies]
    found += [_cover(design, window, lens, solved=solved) for lens in facts.lenses]
    found += [_graph(design, lens) for lens in facts.lenses]
    found += _process_checks(design, facts)
    found += making_checks(design, window, facts)
    found += [_field(design, facts), _fresnel_number(design, facts), _residual(design, window)]
    if design.light.coherent:
        found.append(_orders(design, window, facts))
    return tuple(found)


def _in_outer_cells(design: Design, window: Window, whole: Feasibility) -> tuple[Check, ...]:
    """The checks of a non-uniform sheet: each in the worst of the cells whose lenses lie farthest out."""
    worst: dict[tuple[str, str], Check] = {}
    highest = max((highest_step(window, body) for body in window.bodies), key=lambda step: step.height)
    fields = [min(whole.half_field)]
    for cell in outer_cells(window):
        like = like_cell(window, cell)
        facts = cell_feasibility(window, cell, *design.viewing_places).with_steps_of(whole)
        fields += facts.half_field if window.many_sizes else ()
        for check in _cell_checks(design, like, facts):
            key, known = (check.id, check.subject), worst.get((check.id, check.subject))
            if known is None or _worse(check, known):
                at = cell.tolist() if check.id != "wall" else list(highest.cell)
                named = f"in cell ({at[0]}, {at[1]}): {check.sentence}"
                worst[key] = replace(check, sentence=named, detail={**check.detail, "cell": at})
    found = [_priced(check) for check in worst.values() if check.id != "field"]
    reach, half = tan(design.check.field), min(fields)
    sentence = "each cell is for the light of its own place; the cone of test rays about it"
    inside = reach <= half
    found.append(
        Check(
            "field", "pass" if inside else "warn", f"{sentence} lies {'in' if inside else 'out'}side its field of view", reach,
            half, "slope", where="thin", required=False, limit_source=other("derived from pitch, separation and law"),
        )
    )  # fmt: skip
    return tuple(found)


def _priced(check: Check) -> Check:
    """Fail the check of steps between neighbours of a non-uniform sheet where the process cannot make them."""
    if check.id != "wall" or check.state != "warn":
        return check
    sentence, _, _ = check.sentence.rpartition("; ")
    return replace(
        check, state="fail", sentence=f"{sentence}: the price of cells that differ; a viewer or image farther away, a smaller p/s or another process",
    )  # fmt: skip


def _worse(one: Check, other: Check) -> bool:
    """Whether a check reports a worse part than another check of the same name."""
    order = ("fail", "not run", "warn", "pass")
    if one.state != other.state:
        return order.index(one.state) < order.index(other.state)
    if not (isinstance(one.value, float) and isinstance(other.value, float)):
        return False
    return one.value > other.value if one.relation == "<=" else one.value < other.value


def _one_piece(body: BodyFacts) -> Check:
    """Judge whether a body is in one piece, without pinholes."""
    whole = body.pieces == 1 and body.holes == 0
    if whole:
        sentence = f"{body.name} is one piece without holes"
    elif body.pieces > 1:
        widest = max(body.borders, key=lambda b: -b.joint)
        sentence = (
            f"{body.name} falls into {body.pieces} pieces with {count_text(body.holes, 'hole')}: neighbours do not touch across "
            f"step {widest.step}, they miss each other by {-widest.joint:.4g}; a thicker lens, a web or a smaller "
            "pitch joins them"
        )
    else:
        sentence = (
            f"{body.name} is one piece with {count_text(body.holes, 'pinhole')} where the corners of the lenses do not meet; they "
            f"lack {-body.edge:.4g} of thickness there"
        )
    return Check(
        "one_piece", "pass" if whole else "fail", sentence, f"{count_text(body.pieces, 'piece')}, {count_text(body.holes, 'hole')}",
        "1 piece, 0 holes", relation="=", subject=body.name, where="geometry (closed form)",
        detail={"pieces": body.pieces, "holes": body.holes},
    )  # fmt: skip


def _cover(design: Design, window: Window, lens: LensFacts, *, solved: bool) -> Check:
    name = lens.name
    limit = design.check.cover
    if lens.cover >= limit:
        sentence = f"{name} fills its cell"
    else:
        x, y = lens.rim_at
        sentence = (
            f"{name} fills {lens.cover:.3f} of its cell: its rim ends at {lens.rim[0]:.4g}, {lens.rim[1]:.4g} along "
            f"its axes, and at ({x:.4g}, {y:.4g}) it lacks {-lens.corner:.4g} of thickness"
        )
        if solved:
            sentence += f". {_way_to_cover(design, window, lens)}"
    return judge(
        "cover", lens.cover, limit, sentence, relation=">=", subject=name,
        detail={"rim": lens.rim, "least_thickness": lens.least_thickness, "corner": lens.corner},
    )  # fmt: skip


def _way_to_cover(design: Design, window: Window, lens: LensFacts) -> str:
    """Text of the values that cover the cell, found by building windows, since the radii follow the thickness."""
    if not (isfinite(lens.least_thickness) and lens.least_thickness > 0.0):
        return "No thickness covers it at these radii: a smaller pitch or a larger separation would"
    ways = [f"thickness >= {_round_up(lens.least_thickness)}"]
    if design.pair.form == "biconvex":
        solved = _covering_thickness(design, lens)
        if solved is not None:
            ways = [f"thickness >= {_round_up(solved)} for {('lens 1', 'lens 2')[lens.array]}"]
    index = _covering_index(design, lens)
    if index is not None:
        ways.append(f"index >= {index:.3f}")
    shrink = _covering_shrink(window, lens)
    if shrink is not None:
        ways.append(f"pitch <= {_round_down(max(design.lattice.pitch) * shrink)}")
    return ", or ".join(ways) + ' would cover it (or thickness = "auto")'


def _round_up(value: float) -> str:
    """Text of a value with three digits, rounded up."""
    from math import ceil, floor, log10

    step = 10.0 ** (floor(log10(value)) - 2)
    return f"{ceil(value / step) * step:.3g}"


def _round_down(value: float) -> str:
    """Text of a value with three digits, rounded down."""
    from math import floor, log10

    step = 10.0 ** (floor(log10(value)) - 2)
    return f"{floor(value / step) * step:.3g}"


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
    """Refractive index at which the given thickness covers the cell, rounded up; None if there is none below 4.

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


def _graph(design: Design, lens: LensFacts) -> Check:
    value, limit = lens.least_normal_z, design.check.graph
    name = lens.name
    if value >= limit:
        slope = np.degrees(np.arccos(min(1.0, value)))
        sentence = f"steepest slope of {name} against the sheet is {slope:.3g} deg"
    else:
        sentence = (
            f"{name} is too steep or undercut at its border: a larger radius, a smaller pitch or less tilt"
        )
    return judge("graph", value, limit, sentence, relation=">=", subject=name)


def _process_checks(design: Design, facts: Feasibility) -> list[Check]:
    """Judge the lengths that every process limits: gaps, edges, necks, radii, heights, pitch."""
    rules, unit = profile(design.check.process), design.unit
    found: list[Check] = []
    if isfinite(facts.clearance):
        limit, source = process_limit(design, rules, "clearance")
        found.append(
            _at_least(
                "clearance",
                facts.clearance,
                limit,
                source,
                unit,
                "gap between the two bodies, steps included",
            )
        )
    for body in facts.bodies:
        limit, source = process_limit(design, rules, "edge")
        text = f"least thickness along the outer side of {body.name}"
        found.append(_thicker(design, _at_least("edge", body.edge, limit, source, unit, text, body.name)))
        limit, source = process_limit(design, rules, "neck")
        if isfinite(body.neck):
            text = f"least thickness that joins neighbours in {body.name} after the step between them"
            found.append(_thicker(design, _at_least("neck", body.neck, limit, source, unit, text, body.name)))
    for lens in facts.lenses:
        name = lens.name
        limit, source = process_limit(design, rules, "radius")
        smallest = min(abs(r) for r in lens.radii)
        found.append(
            _at_least("radius", smallest, limit, source, unit, f"smallest apex radius of {name}", name)
        )
        limit, source = process_limit(design, rules, "sag")
        text = f"height of {name} over its cell is {lens.sag:.4g} {unit}"
        found.append(
            judge("sag", lens.sag, limit, text, near=NEAR, unit=unit, subject=name, limit_source=source)
        )
    limit, source = process_limit(design, rules, "pitch")
    found.append(_at_least("pitch", min(design.lattice.pitch), limit, source, unit, "pitch of the lattice"))
    return found


def _at_least(
    id: str, value: float, limit: float, source: LimitSource, unit: str, text: str, subject: str = ""
) -> Check:
    """Judge a length that must reach its limit; where the limit is 0 it must exceed it."""
    sentence = f"{text}: {value:.4g} {unit}"
    if value <= 0.0:
        sentence += (
            "; the part has no material there" if id != "clearance" else "; the bodies run into one another"
        )
    check = judge(
        id, value, limit, sentence, relation=">=", near=NEAR, unit=unit, subject=subject, limit_source=source
    )
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
    }
    return replace(check, sentence=f"{check.sentence}; {keys[design.pair.form]} makes it thicker")


def _field(design: Design, facts: Feasibility) -> Check:
    """Judge whether the sheet's normal, with the cone of test rays about it, lies in the field of view."""
    off = [abs(a) for a in facts.aperture]
    reach = tan(design.check.field)
    half = min(facts.half_field)
    value = hypot(*off) + reach
    if value <= half:
        sentence = "the sheet's normal and the cone of test rays about it lie inside the field of view"
    else:
        sentence = (
            f"light along the sheet's normal is {hypot(*off):.4g} in slope off the middle of the field of view, whose "
            f"half width is {half:.4g}; lattice.aperture steers the field"
        )
    state: State = "pass" if value <= half else "warn"
    return Check(
        "field", state, sentence, value, half, "slope", where="thin", required=False,
        limit_source=other("derived from pitch, separation and law"),
        detail={"aperture": facts.aperture, "half_field": facts.half_field, "ghost_onset": facts.ghost_onset},
    )  # fmt: skip


def _fresnel_number(design: Design, facts: Feasibility) -> Check:
    value, limit = facts.fresnel_number, design.check.fresnel_number
    sentence = f"Fresnel number {value:.4g}"
    if value < 1.0:
        return Check(
            "fresnel_number", "fail", f"{sentence}: below 1 the ray picture is void; a larger pitch or a shorter "
            "separation", value, 1.0, relation=">=", where="thin", limit_source=DEFAULT,
        )  # fmt: skip
    if value < limit:
        sentence += (
            f": diffraction blurs as much as {1e3 * max(facts.diffraction_blur):.3g} mrad, and takes up to "
        )
        sentence += f"{100.0 * max(facts.viewing.lost):.2g} % of the light to other cells, along that axis"
    state: State = "warn" if value < limit else "pass"
    return Check("fresnel_number", state, sentence, value, limit, relation=">=", where="thin")


def _orders(design: Design, window: Window, facts: Feasibility) -> Check:
    """Judge the deviation of coherent light from the law: half a step of the grating that identical cells form."""
    steps = order_steps(window.lattice, facts.wavelength / window.unit)
    value, limit = 0.5 * max(steps), design.check.law_rms
    first, second = (digits(1e3 * step, count=3) for step in steps)
    cells = "equal" if window.uniform else "neighbouring"
    sentence = (
        f"in coherent light {cells} cells send orders {first} and {second} mrad apart, so the law is met to "
        f"±{digits(1e3 * value, count=3)} mrad only"
    )
    return Check(
        "orders", "pass" if value <= limit else "warn", sentence, value, limit, "rad", where="thin", required=False,
        limit_source=from_key("law_rms"), detail={"steps": steps},
    )  # fmt: skip


def _residual(design: Design, window: Window) -> Check:
    """Judge the residual of the recipe along the axis ray: parabasal law error and decollimation."""
    left = [float(v) for v in window.residual.values()]
    if not left:
        return not_run(
            "residual", "the window does not say what its recipe leaves", unit="rad", required=False
        )
    value, limit = max(left, default=inf), design.check.law_rms
    sentence = f"along the axis ray the recipe leaves {digits(1e3 * value, count=3)} mrad"
    if value == inf:
        sentence = (
            "the ray along the lens axis does not get through: it misses a lens or is totally reflected"
        )
    elif value > limit:
        recipe = "" if design.pair.form == "slab" else 'pair.confocal = "exact" or "best", '
        sentence += f"; another recipe ({recipe}pair.conic), less tilt or another form would leave less"
    return judge(
        "residual", value, limit, sentence, unit="rad", where="surfaces, parabasal", limit_source=from_key("law_rms"),
        detail=dict(window.residual),
    )  # fmt: skip
