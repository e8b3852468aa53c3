"""Checks of field lenses, of imaging sheets, of white light and of temperature.

A field lens lies at the foci, images lens 1 onto lens 2, fills the field and preserves the law. Light along
the axis and through the middle of cell 1 is traced face by face through the window as built. The checks do
not use how the faces were computed.

An imaging sheet: where the image of the requested point lies, and how narrow it is there.

White light and temperature: the law in every line, and what a wavelength or a kelvin changes, traced and in
closed form. They are reported where each material has an index at the lines, and judged where the design
states a limit.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot, inf, isfinite, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import mrad_text, nm_text
from clacad.base.types import Floats, Pair2
from clacad.checks.check import Check, CheckKind
from clacad.checks.light_kinds import (
    COLOUR,
    FIELD_FOCUS,
    FIELD_LAW,
    FIELD_THROUGHPUT,
    IMAGE_POINT,
    LAW_WHITE,
    PUPIL,
    SPOT,
    TEMPERATURE,
)
from clacad.design.sections import KELVIN
from clacad.imaging.image_by_rays import image, lens_plane
from clacad.judging.file_light import WHITE_RAYS, lines_of
from clacad.light.compare import WhiteLight, changed, closed_change, floor_of_one_material
from clacad.light.confocality import axis_start, field_onto_axis
from clacad.light.measure import Light, first_rays, measure, rms_of
from clacad.optics.law.focusing import cell_width
from clacad.optics.law.imaging import spot_widths
from clacad.optics.material.material import EXPANSION
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import STEP, Interface, trace_sequence
from clacad.sheet.bundle import Bundle, RequestedLaw, bundle
from clacad.sheet.like_cell import heated, in_light, interfaces
from clacad.sheet.vignetting import aperture_slope, half_field, share, thin_cells
from clacad.sheet.window import Window
from clacad.tracing.trace import trace
from clacad.tracing.worst_cell import SeenCell
from clacad.verification.light.through_window import Lit

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.optics.material.material import Material


FOCUS, MOVED, LAW = 0.01, 0.02, 1.2
"""Limits: face from focus over f1; du/dt over s; rms error over that without a field lens."""

PART = 0.9
"""Part of the full field at which the share is measured."""

SLOPE = 1e-4
"""Change of slope for the finite difference du/dt."""

FIELD_LENS_RAYS = 4096


def field_lens_checks(lit: Lit) -> Iterator[Check]:
    """Judge the field lens of a window; no checks where it has none."""
    if not lit.window.thin.field or lit.window.form == "plates":  # listed faces may image as they like
        return
    for kind, check, limit in ((FIELD_FOCUS, _focus, FOCUS), (PUPIL, _pupil, MOVED)):
        try:
            yield check(lit.window)
        except ValueError as error:
            yield kind.not_run(str(error), limit=limit, where=kind.where)
    yield _throughput(lit.window, lit.design.check.field_throughput)
    yield _law(lit.design, lit.window, lit.optics.main.lit)


def _focus(window: Window) -> Check:
    """Distance of field faces from the foci of the optics before them; not of faces solved for two foci."""
    pair = window.thin
    f1 = pair.focal_length[0]
    bent = [face.surface for face in window.faces if face.array == 2]
    both = sum(face.curvature_x != 0.0 and face.curvature_y != 0.0 for face in bent) > 1
    if both and abs(f1[0] - f1[1]) > 2.0 * FOCUS * max(map(abs, f1)):
        why = (
            "lens 1 has two foci, and both field faces bend along both axes: confocality and pupil judge them"
        )
        return FIELD_FOCUS.not_run(why, limit=FOCUS, where=FIELD_FOCUS.where, required=False)
    start = axis_start(window, pair.rotation[:, 2])
    seq = interfaces(window, None, field_onto_axis(window, start))
    worst, where = 0.0, ""
    for number, face in enumerate(window.faces):
        if face.array != 2:
            continue
        for axis, curvature in enumerate((face.surface.curvature_x, face.surface.curvature_y)):
            if curvature == 0.0:
                continue
            off = _from_focus(window, seq[:number], np.asarray(seq[number].vertex), start, axis)
            part = abs(off) / seq[number].index_before / f1[axis]
            if part >= worst:
                worst, where = part, f"face {number + 1}, {'xy'[axis]}"
    sentence = f"the field faces are at most {worst:.3g} of f1 from the foci of lens 1 ({where})"
    return FIELD_FOCUS.judge(worst, FOCUS, sentence)


def _from_focus(window: Window, before: list[Interface], vertex: Floats, start: Floats, axis: int) -> float:
    """Distance (length) along the axis from where parabasal light crosses the axis ray to a vertex (3,)."""
    turn = window.thin.rotation
    aside = STEP * window.lattice.circumradius * turn[:, axis]
    rays = Rays(start + np.array([np.zeros(3), aside, -aside]), np.tile(turn[:, 2], (3, 1)))
    seen = trace_sequence(before, rays)
    if (seen.fate != Fate.ALIVE).any():
        raise ValueError("light near the axis ray does not reach the field lens")
    place, ray = (seen.position - vertex) @ turn, seen.direction @ turn
    slope = ray[:, axis] / ray[:, 2]
    at_vertex = place[:, axis] - place[:, 2] * slope  # in the plane through the vertex
    return float((at_vertex[1] - at_vertex[2]) / (slope[1] - slope[2]))


def _pupil(window: Window) -> Check:
    """Shift over lens 2 of the ray through the middle of cell 1, per change of its slope."""
    turn, s = window.thin.rotation, window.thin.separation
    ax, ay = aperture_slope(window)
    middle = np.array([ax, ay, 1.0]) @ turn
    slope = middle[:2] / middle[2]
    change = SLOPE * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    direction = np.column_stack([slope + change, np.ones(4)]) @ turn.T
    below = abs(window.z_range[0]) + max(window.lattice.pitch)
    start = -direction / direction[:, 2:] * below
    seen = trace_sequence(interfaces(window), Rays(start, direction), record=True)
    if seen.hits is None or (seen.fate != Fate.ALIVE).any():
        raise ValueError("the ray in the middle of the field does not get through")
    second = [face.array == 1 for face in window.faces]
    at = seen.hits[second].mean(axis=0) @ turn
    moved = [abs(at[2 * k, k] - at[2 * k + 1, k]) / (2.0 * SLOPE * s) for k in (0, 1)]
    sentence = (
        f"light through the middle of cell 1 moves over lens 2 by {moved[0]:.3g}, {moved[1]:.3g} of the"
        " separation a unit of slope (x, y); without a field lens it would be 1"
    )
    return PUPIL.judge(max(moved), MOVED, sentence)


def _throughput(window: Window, limit: float) -> Check:
    """Share of light at 0.9 of the full field, left, right, up and down, compared with thin lenses."""
    cells = thin_cells(window)
    turn = window.thin.rotation
    ax, ay = aperture_slope(window)
    middle = np.array([ax, ay, 1.0]) @ turn
    worst, at, ratio = np.inf, 0.0, np.nan
    for axis, half in enumerate(half_field(cells)):
        for sense in (PART, -PART):
            slope = middle[:2] / middle[2]
            slope[axis] += sense * half
            direction = turn @ np.array([*slope, 1.0])
            if not direction[2] > 0.0:
                continue
            lit = bundle(window, FIELD_LENS_RAYS, 0.0, middle=direction / sqrt(float(direction @ direction)))
            passed = float((trace(window, lit.rays, path="size").fate == Fate.ALIVE).mean())
            closed = float(share(cells, lit.middle[None])[0])
            ratio = passed / closed if closed > 0.0 else np.nan
            if ratio < worst:
                worst, at = ratio, passed
    sentence = (
        f"at {PART:g} of the full field {at:.3f} of the light passes at worst, {worst:.3f} of what thin"
        " lenses pass"
    )
    value = worst if worst < np.inf else np.nan
    text = f"4 directions, {FIELD_LENS_RAYS} Sobol rays each over the whole cell"
    return FIELD_THROUGHPUT.judge(value, limit, sentence, bundle=text)


def _law(design: Design, window: Window, main: Bundle) -> Check:
    """Error of the law with the field lens over that without, for the light that passes both windows."""
    from clacad.design import DesignError
    from clacad.prescription.prescribe import prescribe

    without = {
        key: value for key, value in design.given["pair"].items() if key not in ("field", "field_lens")
    }
    try:
        plain = prescribe(type(design).from_dict({**design.given, "pair": without}))
    except DesignError as error:
        why = f"the same pair without a field lens cannot be built: {str(error).splitlines()[0]}"
        return FIELD_LAW.not_run(why, limit=LAW, where=FIELD_LAW.where, required=False)
    lit = [
        bundle(one, min(len(main.rays), 2 * FIELD_LENS_RAYS), design.check.field, design.check.field_centre)
        for one in (window, plain)
    ]
    law = RequestedLaw(window.law)
    light = [
        Light(one, trace(sheet, one.rays, path="size"), law)
        for sheet, one in zip((window, plain), lit, strict=True)
    ]
    both = light[0].known & light[1].known
    rms = [rms_of(one, both) for one in light]
    ratio = rms[0] / rms[1] if rms[1] > 0.0 else np.nan
    sentence = (
        f"of the light that passes with and without the field lens the rms error is {mrad_text(rms[0])}"
        f" with it, {mrad_text(rms[1])} without"
    )
    return FIELD_LAW.judge(ratio, LAW, sentence, bundle=str(lit[0]))


IMAGE_RAYS = 16_384
NEAR = 0.01
"""Allowed error of the image point over the image distance, where the image of a cell is narrower."""
SPREAD = 1.5
"""Limit over the combined width that the cells, the limit of the law's error and diffraction cause."""


def asked_image(design: Design) -> tuple[tuple[float, float, float], float] | None:
    """Point that a design images, and its image's distance behind array 2 (lengths); None for other designs.

    A sheet of two focal lengths has no image point, and an image at infinity has no distance.
    """
    spec, planes = design.law_spec.varying, design.pair.focus
    if spec is None and planes is None:
        return None
    if spec is not None and spec.conjugates is not None:
        planes = spec.conjugates
    if planes is not None:
        return (_on_axis(design, planes.object), planes.image) if isfinite(planes.image) else None
    lengths = None if spec is None else spec.f_image
    if lengths is not None and lengths[0] == lengths[1] and isfinite(lengths[0]):
        return _on_axis(design, -inf), lengths[0]
    return None


def _on_axis(design: Design, along: float) -> tuple[float, float, float]:
    """Point of the axis of the lenses, lengths; at −inf: parallel light, by its slopes."""
    if design.law.theta == 0.0:
        return 0.0, 0.0, along
    x, y, z = design.law.rotation[:, 2].tolist()
    return (x / z, y / z, along) if along == -inf else (x * along, y * along, z * along)


def image_checks(lit: Lit) -> Iterator[Check]:
    """Judge the image of the point on the axis; no checks for a design that images no point."""
    design, window = lit.design, lit.window
    asked = asked_image(design)
    if asked is None:
        return
    source, distance = asked
    found = image(window, source, ("surfaces",), IMAGE_RAYS)
    (one,) = found.rungs
    if not np.isfinite(one.found.point).all():
        why = "no light of the requested point gets through"
        yield from (kind.not_run(why) for kind in (IMAGE_POINT, SPOT))
        return
    place = one.found.point - (0.0, 0.0, lens_plane(window, "surfaces"))
    across = one.found.point[:2] - one.predicted.point[:2]
    along = float(place[2])
    if design.law.theta != 0.0:  # along the axis of the lenses
        turn = design.law.rotation
        along = float(one.found.point @ turn[:, 2]) - lens_plane(window, "surfaces") / float(turn[2, 2])
        across = (one.found.point - one.predicted.point) @ turn[:, :2]
    off = hypot(*across.tolist(), along - distance)
    text = f"{IMAGE_RAYS} Sobol rays over all cells, of which {one.found.rays} get through"
    unit = design.unit
    width = found.width or _width_on_axis(design, window, source, distance)
    limit = max(*width, NEAR * abs(distance))
    yield IMAGE_POINT.judge(
        off,
        limit,
        f"light of the requested point meets {along:.6g} {unit} behind array 2 at ({place[0]:.3g},"
        f" {place[1]:.3g}), {off:.3g} {unit} from where the law has it ({distance:.6g})",
        unit=unit,
        bundle=text,
        detail={"found": place.tolist(), "share": one.share},
    )
    narrow = _allowed(design, window, width, distance)
    worst = max(range(2), key=lambda k: one.found.spot[k] / narrow[k])
    yield SPOT.judge(
        one.found.spot[worst],
        narrow[worst],
        f"there it is {one.found.spot[0]:.4g}, {one.found.spot[1]:.4g} {unit} wide (rms in x and y); cells"
        f" alone leave {width[worst] / sqrt(12.0):.4g}",
        unit=unit,
        bundle=text,
        detail={"spot": list(one.found.spot), "width": list(width)},
    )


def _width_on_axis(
    design: Design, window: Window, source: tuple[float, float, float], distance: float
) -> Pair2:
    """Full width along the lens axes of an image by tilted lenses, whose laws are a table."""
    planes = (source[2] / float(window.law.rotation[2, 2]), distance)
    first, second = window.thin.focal_length
    x, y = (
        cell_width((f1, f2), window.thin.separation, planes, p)
        for f1, f2, p in zip(first, second, window.lattice.pitch, strict=True)
    )
    return x, y


def _allowed(design: Design, window: Window, width: Pair2, distance: float) -> Pair2:
    """Largest rms width of the image along x and y (lengths) within the limits of the design."""
    waves = design.pair.wavelength / design.unit_m
    _, _, wave = spot_widths(window.law, window.lattice.pitch, abs(distance), 0.0, waves)
    x, y = (
        SPREAD * sqrt(w * w / 12.0 + (design.check.law_rms * distance) ** 2 + d * d)
        for w, d in zip(width, wave, strict=True)
    )
    return x, y


def white_checks(lit: Lit) -> Iterator[Check]:
    """Report or judge the law in white light, the change over its lines, and that over temperature."""
    limits, light = lit.design.check, lit.design.light
    base = first_rays(lit.optics.main, WHITE_RAYS)
    lines = {} if lit.judged_only and limits.law_white is None else lines_of(lit.design, lit.like)
    if lines:
        yield from _white(lit, lit.cell, base, lines)
    told = not lit.judged_only and (lines or light.temperature is not None)
    if told or limits.temperature is not None:
        yield _temperature(lit, lit.cell, base)


def _white(lit: Lit, cell: SeenCell, base: Light, lines: dict[float, float]) -> Iterator[Check]:
    white = WhiteLight(base, measure(cell, base.lit, base.law, lines), lines)
    closed = np.array([closed_change(lit.like, in_light(lit.like, wave), base) for wave in lines])
    floor = floor_of_one_material(lit.like, white)
    value, sources = white.mean(white.law_rms), sources_of(lit.like)
    each = ", ".join(f"{mrad_text(v, unit='')} at {nm_text(w)}" for w, v in zip(lines, white.law_rms))
    sentence = (
        f"white light leaves {mrad_text(value)} rms from the law, mean of {len(lines)} lines ({each} mrad)"
    )
    if floor == floor:
        sentence += f"; no faces of one material reach less than {mrad_text(floor)}"
    detail = {
        "lines": _by_line(white, closed),
        "rms": white.light.rms,
        "floor": floor,
        "sources": sources,
    }
    sentence += f"; index by {'; '.join(dict.fromkeys(sources.values()))}"
    yield _judged(LAW_WHITE, value, lit.design.check.law_white, sentence, base, detail)
    change = white.mean(white.change)
    own = nm_text(lit.like.wavelength or 0.0)
    sentence = (
        f"its direction changes by {mrad_text(change)} rms against {own}, mean of the lines (closed form"
        f" {mrad_text(white.mean(closed))}; index by {', '.join(sources)} as above)"
    )
    yield _judged(COLOUR, change, None, sentence, base, detail | {"closed_form": white.mean(closed)})


def _by_line(white: WhiteLight, closed: Floats) -> list[dict[str, float]]:
    return [
        {
            "wavelength": wave,
            "weight": weight,
            "law_rms": float(white.law_rms[k]),
            "change": float(white.change[k]),
            "closed_form": float(closed[k]),
            "share": white.light.lines[k].share,
        }
        for k, (wave, weight) in enumerate(white.lines.items())
    ]


def _temperature(lit: Lit, cell: SeenCell, base: Light) -> Check:
    kelvin, limit = lit.design.light.temperature or KELVIN, lit.design.check.temperature
    try:
        rows = [_at(lit, cell, base, way * kelvin) for way in (-1.0, 1.0)]
    except ValueError as error:
        return TEMPERATURE.not_run(
            f"not known: {error}", limit=limit, required=limit is not None, where=TEMPERATURE.where
        )
    worst = max(rows, key=lambda row: row["change"])
    each = ", ".join(f"{mrad_text(row['law_rms'], unit='')} at {row['kelvin']:+g} K" for row in rows)
    sentence = (
        f"{kelvin:g} K change the direction by {mrad_text(worst['change'])} rms (closed form"
        f" {mrad_text(worst['closed_form'])}); light then leaves {each} mrad rms from the law"
    )
    sources, grown = (thermal_sources_of(lit.like, of_expansion) for of_expansion in (False, True))
    sentence += f"; dn/dT by {'; '.join(dict.fromkeys(sources.values()))}; {_growth(grown)}"
    return _judged(TEMPERATURE, worst["change"], limit, sentence, base, {"rows": rows, "sources": sources})


def _growth(sources: dict[str, str]) -> str:
    """What is done about expansion, and what is left out of the row."""
    if len(sources) < 2:
        return "left out: expansion, a scale of a sheet of one material, and dn/dT over the wavelength"
    return f"expansion by {'; '.join(dict.fromkeys(sources.values()))}; left out: dn/dT over the wavelength"


def _at(lit: Lit, cell: SeenCell, base: Light, kelvin: float) -> dict[str, float]:
    """Law error, change and its closed form (radians) at another temperature."""
    light = measure(cell.heated(kelvin), base.lit, base.law, fewest=base.fewest)
    closed = closed_change(lit.like, heated(lit.like, kelvin), base)
    return {"kelvin": kelvin, "law_rms": light.rms, "change": changed(base, light), "closed_form": closed}


def _judged(
    kind: CheckKind, value: float, limit: float | None, sentence: str, base: Light, detail: dict[str, Any]
) -> Check:
    """The check against its limit; without one it is reported and passes."""
    given: dict[str, Any] = {"bundle": str(base.lit), "detail": detail, "required": limit is not None}
    if limit is not None or value != value:
        return kind.judge(value, limit or np.nan, sentence, **given)
    return kind.check("pass", sentence, value, **given)


def sources_of(window: Window) -> dict[str, str]:
    """Material → source of its index."""
    return {one.name: _short(one.source) for one in _materials(window)}


def thermal_sources_of(window: Window, of_expansion: bool = False) -> dict[str, str]:
    """Material → source of its dn/dT, or of its expansion."""
    parts = {one.name: one.thermal.source.split(f"; {EXPANSION}") for one in _materials(window)}
    return {name: parts[name][-of_expansion] or source for name, source in sources_of(window).items()}


def _materials(window: Window) -> list[Material]:
    return [body.material for body in window.bodies if body.material is not None]


def _short(source: str) -> str:
    """Authors or publisher of a source, and its year."""
    words = source.replace("(", " ").replace(")", " ").replace(";", " ").replace("-", " ").split()
    year = next((word for word in words if word.isdigit() and 1900 <= int(word) <= 2100), "")
    first = source.split(",")[0].split(";")[0]
    return first if year in first else f"{first} {year}"
