"""Checks of a measured part: pass, fail, or no answer where the scales of the instrument leave it open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isnan, nan, pi, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import mrad_text, percent_text
from clacad.checks.check import Check, CheckKind
from clacad.checks.file_kinds import CANNOT_SAY, SCAN_FORM, SCAN_LIGHT, SCAN_PITCH, SCAN_RADIUS, SCAN_SEAM
from clacad.measuring.form_and_seams import Surface
from clacad.measuring.light_through_form import PHASE, FormLight
from clacad.measuring.measured import form_rms, mean_radius
from clacad.measuring.scales import Scale
from clacad.measuring.sides import Name

if TYPE_CHECKING:
    from clacad.design import Design

PITCH = 0.005
"""Largest relative error of the pitch."""

SKEWED = 0.01
"""Angle (radians) by which a lattice is turned in its map from which that is reported."""


@dataclass(frozen=True, eq=False)
class Scanned:
    """What is judged.

    wavelength : metres, of the texture's phase.
    """

    design: Design
    sides: Mapping[Name, Surface]
    light: FormLight
    z_scale: Scale
    lateral_scale: Scale
    wavelength: float


def scan_checks(of: Scanned) -> tuple[Check, ...]:
    """Judge a measured part."""
    subject = ", ".join(dict.fromkeys(one.measured.name for one in of.sides.values()))
    found = [_light(of), _seam(of)]
    for name, one in of.sides.items():
        found += [_pitch(of, name, one), _radius(of, name, one), _form(of, name, one)]
    unsure = _unknown_cells(of)
    if unsure and any(check.state != "pass" for check in found):
        found = [check if check.state == "pass" else _undecided(check, unsure) for check in found]
    return tuple(replace(check, subject=subject) for check in found)


def _unknown_cells(of: Scanned) -> str:
    """Words where lenses are not alike, and which of them a map shows is only assumed; else ""."""
    for one in of.sides.values():
        if not one.lit.side.alike and "assumed" in one.lit.cells.known:
            return (
                f"which cells the map shows is not known, taken as {one.lit.cells} (--cell, or map an edge)"
            )
    return ""


def _undecided(check: Check, why: str) -> Check:
    """A check whose answer depends on the cells that the map shows."""
    detail = {**check.detail, CANNOT_SAY: why}
    return replace(check, state="not run", sentence=f"cannot say: {check.sentence}; {why}", detail=detail)


def _light(of: Scanned) -> Check:
    """Light against its limit, with the range that the uncertainties leave."""
    light, limit = of.light, of.design.check.law_rms
    if isnan(light.rms):
        return SCAN_LIGHT.not_run("too little light gets through the measured form", unit="rad", where="file")
    text = (
        f"through the measured form light leaves {mrad_text(light.rms, 3)} rms from the law in"
        f" {len(light.cells)} cells, between {mrad_text(light.low, 3, unit='')} and"
        f" {mrad_text(light.high, 3)} by the scales; bodies as designed"
    )
    both = [name for name in ("front", "back") if name not in of.sides]
    text += f", and the {both[0]}" if both else ""
    detail: dict[str, Any] = {"low": light.low, "high": light.high, "by_cell": light.by_cell}
    if light.high <= limit or light.low > limit:
        return SCAN_LIGHT.judge(light.rms, limit, text, detail=detail)
    return _open(SCAN_LIGHT, light.rms, limit, text, _needed(of, limit), detail)


def _needed(of: Scanned, limit: float) -> str:
    """What would have to be known for an answer: the scale of heights, and how well."""
    light = of.light
    room = abs(limit - light.rms)
    half = room / light.slope if light.slope == light.slope and light.slope > 0.0 else 0.0
    known = next(iter(of.sides.values())).lit.u_scale
    if known and 1e-5 < half < known:
        return (
            f"the scale of heights over the radius is known to {percent_text(known, 2)}, {half:.1g} would be"
            " needed (--z-scale, --tilted)"
        )
    return "the noise of the map leaves it open: measure more cells, or with less noise"


def _open(kind: CheckKind, value: float, limit: float, text: str, why: str, detail: dict[str, Any]) -> Check:
    """A check without an answer."""
    return kind.check(
        "not run", f"cannot say: {text}; {why}", value, limit, detail={CANNOT_SAY: why, **detail}
    )


def _seam(of: Scanned) -> Check:
    """Share of the light that met a seam or an unknown place."""
    light, limit = of.light, of.design.check.scan_seam
    whole = light.formed + light.seam
    value = light.seam / whole if whole > 0.0 else nan
    text = (
        f"{percent_text(value)} of the light met a seam or a place without points;"
        f" {percent_text(light.formed)} of all light passes clear of them"
    )
    return SCAN_SEAM.judge(value, limit, text)


def _pitch(of: Scanned, name: Name, one: Surface) -> Check:
    """Pitch of a side; another scale, or a part that shrank, is named."""
    side, lens = one.lit.side, one.lenslets
    wanted = np.array([np.hypot(*side.lattice.a1), np.hypot(*side.lattice.a2)])
    off = np.array(lens.pitch) / wanted - 1.0
    worst = float(off[np.argmax(np.abs(off))])
    text = f"{name}: pitch {lens.pitch[0]:.7g} and {lens.pitch[1]:.7g}, {worst:+.2g} of the design's"
    step, bond = _bond(one)
    if abs(worst) > PITCH and not step:
        same = np.ptp(off) < 0.1 * abs(worst)
        what = "shrinkage" if worst < 0.0 else "swelling"
        text += f": {what} of the part, or another lateral scale" if same else ": other along x than along y"
    turn = lens.pose[0]
    if abs(turn) > SKEWED:
        text += f"; the array is rotated by {np.degrees(turn):.3g} deg in its map"
    text += bond
    if step > PITCH * float(wanted.min()):
        return SCAN_PITCH.check("fail", text, step / float(wanted.min()), PITCH)
    limit, doubt = PITCH, of.lateral_scale.half
    if abs(worst) - doubt > limit or abs(worst) + doubt <= limit:
        return SCAN_PITCH.judge(abs(worst), limit, text)
    why = f"the lateral scale is known to {percent_text(doubt, 2)} (--lateral-scale)"
    return _open(SCAN_PITCH, abs(worst), limit, text, why, {})


CLEAR = 6.0
"""Step of a lattice over its standard deviation from which it is a bond of two pieces."""


def _bond(one: Surface) -> tuple[float, str]:
    """Largest step (length) between two pieces of an array, and words about it; 0 where there is none.

    Pieces bonded to one array have its lattice each, and a displacement against each other along a line.
    """
    lens, unit = one.lenslets, one.lit.side.millimetre * 1e-3
    off = lens.values[:, :2] - one.targets[:, :2]
    wanted = np.hypot(*np.array([one.lit.side.lattice.a1, one.lit.side.lattice.a2]).T)
    found: list[tuple[float, float, float, str]] = []
    for axis, name in ((0, "i"), (1, "j")):
        for edge in np.unique(lens.index[:, axis])[1:]:
            design = np.column_stack([np.ones(len(off)), lens.index, lens.index[:, axis] >= edge])
            square = design.T @ design
            if np.linalg.matrix_rank(square, 1e-9 * np.trace(square), hermitian=True) < 4 or len(off) < 8:
                continue
            solved = np.linalg.solve(square, design.T @ off)
            rest = float(np.sum((off - design @ solved) ** 2)) / (2 * (len(off) - 4))
            spread = np.sqrt(max(rest, float(np.mean(lens.u[:, :2] ** 2))))
            clear = float(np.hypot(*solved[3])) / (spread * np.sqrt(np.linalg.inv(square)[3, 3]))
            x, y = solved[3] / unit
            words = (
                f"; two pieces are bonded: from {name} = {edge} on lenslets are displaced by {x:.3g}, {y:.3g}"
            )
            pitch = float(np.hypot(*(np.array([solved[1, 0], solved[2, 1]]) + lens.pitch - wanted)))
            found.append((clear, pitch, float(np.hypot(*solved[3])), f"{words} µm"))
    most = max((every[0] for every in found), default=0.0)
    sure = [every for every in found if every[0] > max(CLEAR, 0.3 * most)]
    if not sure:
        return 0.0, ""
    _, _, step, words = min(sure, key=lambda every: every[1])  # pieces have the pitch of the design
    return step, words


def _insert(one: Surface, off: float, u: float) -> str:
    """Words where all lenslets alike have another radius."""
    spread = float(np.std(one.lenslets.values[:, 3]) / abs(one.lenslets.values[:, 3].mean()))
    alike = abs(off) > 5.0 * max(spread, 1e-4) and abs(off) > 4.0 * u
    return "; all its lenslets alike: another insert or tool, or another scale of heights" if alike else ""


def _radius(of: Scanned, name: Name, one: Surface) -> Check:
    """Radius of a side, with the names of usual mistakes."""
    side = one.lit.side
    relative = 0.5 * one.lit.u_scale
    radius, u, _ = mean_radius(one, relative)
    designed = one.radius
    off = radius / designed - 1.0
    body = side.body
    tile = side.lattice.tile()
    distance = sqrt(float(np.mean(np.sum(tile**2, axis=1))) / 3.0)  # rms over a square or hexagon, nearly
    limit = of.design.check.law_rms * abs(designed) / (abs(body.index - 1.0) * distance)
    text = f"{name}: radius {radius:.6g} ± {2.0 * u:.2g}, {100.0 * off:+.3g} % of the design's {designed:.6g}"
    text += _astigmatic(one) + (_other_side(name, one, radius, u) or _insert(one, off, u / abs(radius)))
    check = SCAN_RADIUS.judge(abs(off), limit, text, required=False)
    return replace(check, state="warn") if check.state == "fail" else check


def _astigmatic(one: Surface) -> str:
    """Words about astigmatism that is clearly there."""
    mean = 2.0 * (one.lenslets.values[:, 5:] - one.targets[:, 5:]).mean(axis=0)
    doubt = 2.0 * float(np.sqrt(np.mean(one.lenslets.u[:, 5:] ** 2) / len(one.lenslets.index)))
    size = float(np.hypot(*mean))
    if size < max(4.0 * doubt, 5e-4 * abs(one.targets[:, 3].mean())):
        return ""
    part = percent_text(size / abs(one.targets[:, 3].mean()), 2)
    return f"; astigmatic: curvature along its axes {part} more and less"


def _other_side(name: Name, one: Surface, radius: float, u: float) -> str:
    """Words where the radius is that of the other side."""
    from clacad.measuring.sides import OTHER, sides_of

    side = one.lit.side
    other = sides_of(side.window, side.millimetre)[OTHER[name]]
    theirs, own = 1.0 / other.lenslet[3], one.radius
    nearer = abs(radius - theirs) < 0.25 * abs(radius - own) and abs(theirs - own) > 4.0 * u
    return (
        f"; this is the radius of the {OTHER[name]} ({theirs:.6g}): sides or plates exchanged"
        if nearer
        else ""
    )


def _form(of: Scanned, name: Name, one: Surface) -> Check:
    """Form of a side in wavefront; fails where the texture is too rough."""
    body = one.lit.side.body
    unit = of.design.unit_m
    rms = (body.index - 1.0) * form_rms(one)
    limit = 0.25 * of.wavelength / unit
    phase = 2.0 * pi * (body.index - 1.0) * one.texture * unit / of.wavelength
    text = (
        f"{name}: the form leaves {1e9 * unit * rms:.3g} nm rms of wavefront; texture Sq"
        f" {1e9 * unit * one.texture:.3g} nm, phase {phase:.2g} rad"
    )
    if phase > PHASE:
        text += f": above {PHASE:g} rad the share of undisturbed light is not known"
        return SCAN_FORM.check("fail", text, rms, limit)
    check = SCAN_FORM.judge(rms, limit, text)
    return replace(check, state="warn", required=False) if check.state == "fail" else check
