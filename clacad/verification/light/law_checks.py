"""Checks by light: the law, its bias, η, δ and tilt by fit, spread, transmitted share, accounting.

Rays are refracted exactly (Snell) at the surfaces. `clacad.light` measures them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import degrees, hypot
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import digits, mrad_text, percent_text
from clacad.base.types import Floats
from clacad.checks.check import Check, CheckKind, found_by, other
from clacad.checks.light_kinds import (
    ACCOUNTING,
    CONFOCALITY,
    DELTA,
    ETA,
    LAW_BIAS,
    LAW_RMS,
    SPREAD,
    THROUGHPUT,
    TILT,
)
from clacad.light.confocality import confocality
from clacad.light.measure import Light
from clacad.optics.rays import Fate
from clacad.sheet.feasibility.derived_numbers import DEFAULT_WAVELENGTH, diffraction_loss
from clacad.sheet.vignetting import fresnel_numbers, mean_share, thin_cells
from clacad.sheet.window import Window
from clacad.tracing.worst_cell import SeenCell, tried_cells
from clacad.verification.light.through_window import POINT_RAYS, Lit, Optics, Turn, fitted_over_all, optics_of

if TYPE_CHECKING:
    from clacad.design import Design

MERIDIANS = 0.002
"""Largest allowed difference of the meridians' defects of confocality, over the separation, any design."""

WORTH_SAYING = 0.005
"""Smallest on-axis share of light lost to diffraction that is reported with the traced share."""


def judge_light(
    design: Design,
    window: Window,
    rays: int,
    point_rays: int = POINT_RAYS,
    *,
    judged_only: bool = False,
) -> tuple[list[Check], Optics]:
    """Judge light through a window's exact surfaces by the limits of its design; rays as in `optics_of`.

    judged_only : Whether numbers of other light are measured only where the design limits them: for trials.
    """
    lit = light_through(design, window, rays, point_rays, judged_only=judged_only)
    of_cell = [_named(lit.cell, check) for judge in found_by("light") for check in judge(lit)]
    return [*of_cell, *(check for judge in found_by("sheet") for check in judge(lit))], lit.optics


def light_through(
    design: Design, window: Window, rays: int, point_rays: int, *, judged_only: bool = False
) -> Lit:
    """Light through the cell by which a window is judged, measured; parameters as in `judge_light`."""
    seen, *others = tried_cells(window, design.check.field)
    optics = optics_of(design, seen.like, seen.send, rays, point_rays)
    if others:
        optics = fitted_over_all(optics, [seen, *others], design.check.field)
    return Lit(design, window, seen.like, optics, seen, judged_only)


def _named(seen: SeenCell, check: Check) -> Check:
    """The check with the cell named in its sentence."""
    if not seen.tried:
        return check
    i, j = seen.cell.tolist()
    words = f"in cell ({i}, {j}), the worst of {seen.tried} tried"
    if check.kind in (ETA, DELTA, TILT):
        words = f"over the light of {seen.tried} cells"
        laws = seen.window.cell_laws
        words += ", each taken by its own law" if laws is not None and laws.own_lenses else ""
    words += f": {check.sentence}"
    if check.kind is LAW_RMS and seen.others is not None:
        words += f"; in the others {mrad_text(seen.others[0], unit='')} to {mrad_text(seen.others[1])}"
    return replace(check, sentence=words, detail={**check.detail, "cell": [i, j], "tried": seen.tried})


def law_checks(lit: Lit) -> Iterator[Check]:
    """Judge the law with the checks law_rms, law_bias, spread, eta, delta, tilt and accounting."""
    spec, main = lit.design.check, lit.optics.main
    rms = main.rms
    sentence = f"light leaves {mrad_text(rms)} rms from the law, at worst {mrad_text(main.worst)}"
    if rms != rms:
        sentence = "too few rays reach their partner to say; lattice.aperture or a smaller field would help"
    yield LAW_RMS.judge(rms, spec.law_rms, sentence, bundle=str(main.lit), detail={"worst": main.worst})
    yield _bias(spec.law_bias, lit.optics)
    yield _spread(spec.law_rms, lit.optics)
    yield from _fit_checks(lit.design, lit.optics)
    yield accounting(main)


def _over_points(values: Floats, seen: Optics) -> dict[str, Any]:
    """Fields of a check of parallel light from the points of the field."""
    text = f"9 directions, {len(seen.points[0].seen)} Sobol rays each over the whole cell"
    return {"bundle": text, "detail": {"by_field_point": values}}


def _too_dark(kind: CheckKind, limit: float) -> Check:
    why = "no field point passes enough light to say"
    return kind.not_run(why, limit=limit, unit=kind.unit, where=kind.where)


def _bias(limit: float, seen: Optics) -> Check:
    """Judge the bias: the angle of the mean exit direction to the law, at the middle and rim of the field."""
    values = np.array([p.bias for p in seen.points])
    if np.isnan(values).all():
        return _too_dark(LAW_BIAS, limit)
    worst = int(np.nanargmax(values))
    sentence = f"the mean direction is at most {mrad_text(values[worst])} from the law, " + (
        "in the middle of the field"
        if worst == 0
        else f"at the rim of the field, {45 * (worst - 1)} deg from +x"
    )
    if np.isnan(values).any():
        sentence += f"; {int(np.isnan(values).sum())} of 9 field points are too dark to say"
    return LAW_BIAS.judge(float(values[worst]), limit, sentence, **_over_points(values, seen))


def _spread(limit: float, seen: Optics) -> Check:
    """Judge position independence: parallel rays leave parallel, regardless of where they hit."""
    values = np.array([p.spread for p in seen.points])
    if np.isnan(values).all():
        return _too_dark(SPREAD, limit)
    middle, worst = float(values[0]), float(np.nanmax(values))
    sentence = (
        f"parallel light in the middle of the field leaves within {mrad_text(middle)} rms of its mean,"
        f" for any part of the lens; {mrad_text(worst)} at the rim of the field"
    )
    return SPREAD.judge(middle, limit, sentence, **_over_points(values, seen))


def _fit_checks(design: Design, seen: Optics) -> Iterator[Check]:
    """Judge η, δ and the orientation by a fit with the requested axes fixed."""
    spec, asked, fit = design.check, design.law, seen.narrow.fit
    text = str(seen.narrow.lit)
    if fit is None:
        why = "too few rays reach their partner to fit a law"
        yield from (kind.not_run(why, where=kind.where, bundle=text) for kind in (ETA, DELTA, TILT))
        return
    law = fit.law
    eta = np.array([law.eta_x / asked.eta_x - 1.0, law.eta_y / asked.eta_y - 1.0])
    delta = np.array([law.delta_x - asked.delta_x, law.delta_y - asked.delta_y])
    yield ETA.judge(
        float(np.abs(eta).max()),
        spec.eta,
        f"measured eta = {law.eta_x:.6g}, {law.eta_y:.6g}; specified {asked.eta_x:.6g}, {asked.eta_y:.6g}",
        bundle=text,
        detail={"measured": (law.eta_x, law.eta_y), "asked": (asked.eta_x, asked.eta_y), "sigma": fit.sigma},
    )
    yield DELTA.judge(
        float(np.abs(delta).max()),
        spec.delta,
        f"measured delta = {digits(law.delta_x)}, {digits(law.delta_y)}; specified {asked.delta_x:.6g},"
        f" {asked.delta_y:.6g}",
        bundle=text,
        detail={"measured": (law.delta_x, law.delta_y), "asked": (asked.delta_x, asked.delta_y)},
    )
    yield _tilt(design, delta, seen.turn, text)


def _tilt(design: Design, delta: Floats, turn: Turn | None, lit: str) -> Check:
    """Judge the orientation of the lenses: the turn about their axis by light, the lean by the error of δ.

    A lean τ of the axis and δ act as one offset, δ + (1 − η)τ to first order. The limit of δ is therefore
    also a
    limit of the lean, and of the turn. A turn is visible where the two η differ; there the check is required.
    """
    asked = design.law
    weight = np.abs([1.0 - asked.eta_x, 1.0 - asked.eta_y])
    acts = weight > 1e-6
    if not acts.any():
        why = "with eta = 1 a tilt does nothing to light"
        return TILT.not_run(why, required=False, where=TILT.where, bundle=lit)
    lean, limits = np.abs(delta[acts]) / weight[acts], design.check.delta / weight[acts]
    value, limit = float(lean[np.argmax(lean / limits)]), float(limits[np.argmax(lean / limits)])
    text = (
        "theta and delta act alike: the error of delta is that of lenses which lean by"
        f" {degrees(hypot(*lean)):.3g} deg"
    )
    allowed = float(limits.min())
    measured = turn is not None and (turn.doubt <= allowed or abs(turn.angle) > allowed + turn.doubt)
    if turn is not None and measured:
        text = (
            f"the lenses' meridians are turned by {degrees(turn.angle):.3g} deg about their axis; for its"
            f" lean, {text}"
        )
        if abs(turn.angle) / allowed >= value / limit:
            value, limit = abs(turn.angle), allowed
    else:
        alike = (
            "the same" if asked.eta_x == asked.eta_y else "too alike for light to show a turn of the lenses"
        )
        text = f"eta_x and eta_y are {alike}, so this is delta as an angle; {text}"
    return TILT.judge(
        degrees(value),
        degrees(limit),
        text,
        required=measured,
        bundle=lit,
        detail={
            "lean": lean.tolist(),
            "turn": None if turn is None else turn.angle,
            "doubt": None if turn is None else turn.doubt,
            "measured": measured,
        },
    )


def accounting(light: Light) -> Check:
    """Judge that every ray has exactly one fate and that only INVALID rays hold a NaN."""
    result = light.seen
    valid = result.fate != Fate.INVALID
    nan = int((~np.isfinite(result.direction[valid])).any() + (~np.isfinite(result.position[valid])).any())
    counts = result.counts()
    missing = len(light.lit.rays) - sum(counts.values())
    good = missing == 0 and nan == 0
    listed = ", ".join(f"{name} {number}" for name, number in counts.items() if number)
    return ACCOUNTING.check(
        "pass" if good else "fail",
        f"every ray has one fate: {listed}",
        float(missing + nan),
        0.0,
        bundle=str(light.lit),
        detail={"counts": counts},
    )


def throughput(lit: Lit) -> Iterator[Check]:
    """Judge the share of light through corresponding lenslets against the closed form of thin lenses."""
    window, seen = lit.like, lit.optics
    cells = thin_cells(window)
    alive = seen.main.share
    mean = mean_share(cells, seen.main.lit.rays.direction)
    middle, closed_form = seen.points[0].share, float(seen.closed_form[0])
    ratios = [a / b if b > 0.0 else np.nan for a, b in ((middle, closed_form), (alive, mean))]
    value = float(np.nanmin(ratios)) if not np.isnan(ratios).all() else np.nan
    sentence = (
        f"{middle:.3f} of the light passes in the middle of the field (closed form {closed_form:.3f}), "
        f"{alive:.3f} over the field ({mean:.3f})"
    )
    wave = (window.wavelength or DEFAULT_WAVELENGTH) / window.unit
    lost = diffraction_loss(fresnel_numbers(cells, wave))
    kept = (1.0 - lost[0]) * (1.0 - lost[1])
    if max(lost) >= WORTH_SAYING:
        sentence += (
            f"; rays: waves may leave {kept:.3f} of that, for diffraction takes up to"
            f" {percent_text(lost[0], 2)}"
            " along lens x and "
        )
        sentence += f"{percent_text(lost[1], 2)} along y to neighbours (clacad wave)"
    yield THROUGHPUT.judge(
        value,
        lit.design.check.throughput,
        sentence,
        bundle=str(seen.main.lit),
        detail={
            "middle": middle,
            "middle_closed_form": closed_form,
            "mean": alive,
            "mean_closed_form": mean,
            "diffraction_keeps": kept,
        },
    )


def confocality_check(lit: Lit) -> Iterator[Check]:
    """Judge the axial slide of lens 2 that makes the pair afocal, over the distance between the lenses."""
    design, limit = lit.design, lit.design.check.confocality
    try:
        found = confocality(lit.like)
    except ValueError as error:
        yield CONFOCALITY.not_run(str(error), limit=limit, where=CONFOCALITY.where)
        return
    value, between = found.defect, found.astigmatism
    goal = "share a focal plane with lens 1" if design.pair.focus is None else "image as pair.focus requires"
    sentence = (
        f"lens 2 would have to move by {digits(value, count=4)} of the distance between the lenses to {goal}"
        f" (x {digits(found.shift[0] / found.distance, count=4)}, y"
        f" {digits(found.shift[1] / found.distance, count=4)})"
    )
    if value > limit and design.pair.confocal != "exact":
        sentence += '; pair.confocal = "exact" would make it 0'
    check = CONFOCALITY.judge(
        value,
        limit,
        sentence,
        bundle="four differential rays about the axis ray",
        detail={
            "shift": found.shift,
            "distance": found.distance,
            "between_meridians": between,
            "power": found.power,
        },
    )
    if between > MERIDIANS and check.state != "fail":
        text = (
            f"{sentence}; the two meridians differ by {between:.4g} of that distance, more than {MERIDIANS:g}"
        )
        check = replace(
            check,
            state="fail",
            value=between,
            limit=MERIDIANS,
            unit="of separation, between meridians",
            sentence=text,
            limit_source=other("fixed: no design may differ more between its meridians"),
        )
    yield check
