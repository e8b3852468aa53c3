"""Judge one STEP or BREP file: read by OCC in a separate process, compared with the closed form, and lit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import count_text
from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.checks.check import Check, LimitSource, default, other
from clacad.checks.file_kinds import (
    CLOSED,
    FAITHFUL_RMS,
    PLACEMENT,
    READABLE,
    SHAPE,
    SOLIDS,
    THROUGH_FILE,
    VOLUME,
    unreadable,
)
from clacad.exporting.formats.registry import longest_wait, reading_worker
from clacad.judging.cell_triangles import lost_in_solid, with_holes
from clacad.judging.delivery import Inspection
from clacad.judging.file_light import light_checks
from clacad.judging.mesh_shape import NO_INTEGRAL, volume_of
from clacad.judging.mesh_wholeness import misnamed
from clacad.judging.step_light import FACE_RAYS, FaceTracer, light_of_cells
from clacad.optics.surface import Quadric
from clacad.sheet.cell_heights import closed_volume
from clacad.sheet.face_order import plates_of, refractions
from clacad.sheet.feasibility import body_range
from clacad.sheet.vignetting import focal_ratio
from clacad.sheet.volume_and_extent import whole_extent
from clacad.sheet.window import Body, Window
from clacad.solid.shells import MERGE
from clacad.storage.errors import ExportError

if TYPE_CHECKING:
    from pathlib import Path

    from clacad.design import Design
    from clacad.formats.step.lens_placements import SheetPlace
    from clacad.storage.worker import Worker


SHAPE_LIMIT = 1e-7
"""Largest distance of a lens face from the closed form, in pitches."""

DIRECTION_LIMIT = 1e-6
"""Largest direction error, radians."""

VOLUME_LIMIT = 1e-9
"""Largest relative difference of volumes."""

FITTED = 1e-8
"""Relative difference of parameter curves that another CAD program fitted itself."""

MERGED = 1e-10
"""Mean height change (mm) over all faces that closed steps cause in the kernel (measured: 3.5e-11)."""

PART = 0.1
"""Part of the limit of the law's rms error that faces of a file without a manifest may use."""


@dataclass(frozen=True, eq=False)
class Room:
    """Allowed deviations of a file from the design.

    direction : radians. Direction error that slope errors of lens faces may make.
    shape : mm
    source : Where the limits come from.
    fitted : No manifest states that the faces are exact: another program may have fitted them again.
    """

    direction: float
    shape: float
    source: LimitSource
    fitted: bool


def room_for(design: Design, window: Window, stated: Mapping[str, Any]) -> Room:
    """Allowed deviations of a file: those of exact faces where a manifest states them, else those that light
    allows.

    Light allows a tenth of `law_rms`. A face with a slope error below that lies, over a pitch, within
    slope × pitch / 2π of the exact one.
    """
    pitch = min(window.lattice.pitch) * millimetres(window.unit)
    # a surface other than a quadric has no exact rational patch: its fit is stated to 1e-6 of the pitch
    fitted = any(not isinstance(face.surface, Quadric) for face in window.faces)
    exact = SHAPE_LIMIT * pitch * (10.0 if fitted else 1.0)
    if stated:
        return Room(DIRECTION_LIMIT, exact, default("1e-7 of the pitch"), False)
    direction = max(DIRECTION_LIMIT, PART * design.check.law_rms)
    shape = max(exact, direction / gain(window) * pitch / (2.0 * pi))
    source = other("a tenth of law_rms: no manifest says its faces are exact")
    return Room(direction, shape, source, True)


def gain(window: Window) -> float:
    """Direction error (rad) per slope error (rad) of the lens faces, equal errors added in quadrature."""
    total = 0.0
    smallest = min(abs(m) for m in focal_ratio(window.thin))
    laws = window.cell_laws
    if laws is not None and laws.ratios is not None:
        smallest = float(np.abs(laws.ratios_of(window.lattice, window.lattice.cells())).min())
    for _, face, before, after in refractions(window.bodies):
        if face.array in (
            0,
            1,
        ):  # at a field lens light is at a focus: a deflection there changes no direction
            total += ((after - before) * (1.0 / smallest if face.array == 0 else 1.0)) ** 2
    return float(total**0.5)


def judge_solid(
    asked: Inspection, window: Window, path: Path, place: SheetPlace | None = None
) -> tuple[list[Check], Mapping[str, Any]]:
    """Read a STEP or BREP file in a worker and judge its shape and the light through its faces.

    `asked` : At most `FACE_RAYS` of its rays are traced.
    place : The window is one sheet of several in the file.

    Returns
    -------
    checks : list of Check
    found : mapping
        Result of the reader; empty if reading failed. `holds`: solids, shells, faces, prototypes, parts
        (name, solid, faces, instances); `holds_words`: the same as text.
    """
    asked.progress(f"reading {path.name}", 0.0)
    try:
        worker = reading_worker(path)
    except (ExportError, OSError) as error:
        return _refused(asked, error), {}
    with worker:
        try:
            found = worker.run(
                "clacad.exporting.step_record:read",
                str(path),
                window,
                place,
                timeout=longest_wait(path),
                progress=asked.progress,
            )
        except (ExportError, OSError) as error:
            return _refused(asked, error), {}
        found["holds_words"] = holds_words(found["holds"])
        checks = _checks_of_shape(asked, window, found)
        asked.progress("tracing through the faces", 0.0)
        checks += _light(asked, window, worker, path, found, 0.0 if place is None else place.z)
    return checks, found


def _refused(asked: Inspection, error: Exception) -> list[Check]:
    """Checks of a file that could not be read."""
    later = (CLOSED, PLACEMENT, SHAPE, FAITHFUL_RMS, VOLUME, *THROUGH_FILE)
    unread = [kind.not_run("the file cannot be read", **asked.common) for kind in later]
    return [unreadable(error, **asked.common), *unread]


def _checks_of_shape(asked: Inspection, window: Window, found: Mapping[str, Any]) -> list[Check]:
    """Checks of the reader's result: whole, in its place, with faces where the design has them."""
    common, stated, room = asked.common, asked.stated, room_for(asked.design, window, asked.stated)
    shape = _shape(found, stated, room, common)
    exact = "cylinders" in found and not room.fitted
    if "holes" in found or exact:
        round_ones = found["cylinders" if exact else "holes"]
        lost = lost_in_solid(window, round_ones, millimetres(window.unit), alone=not exact)
        shape = with_holes(shape, lost, asked.design.unit)
    return [
        READABLE.check("pass", found["holds_words"] + _unit_words(found), **common),
        _closed(found, common),
        _solids(window, found, stated, common),
        _placement(found, room, common),
        shape,
        _file_rms(window, found, room, common),
        _volume(window, found, stated, room, common),
    ]


def lies_elsewhere(checks: Sequence[Check]) -> bool:
    """Whether a readable file has its faces elsewhere than the design.

    True if it holds fewer than half of the lenses, or if its shape fails and fewer than half of them lie on
    their cells.
    """
    one = {check.kind: check for check in checks}
    if READABLE not in one or one[READABLE].state != "pass":
        return False
    at = one[PLACEMENT].detail
    if at and at["missing"] > 0.5 * at["lenses"]:  # a piece of the sheet
        return True
    return one[SHAPE].state != "pass" and not float(at.get("standing", 0.0)) >= 0.5


def hole_words(
    window: Window, holes: Sequence[Mapping[str, Any]], onto: Callable[[Floats], Floats] | None = None
) -> str:
    """Text of the round holes of a part, with the cells of array 1 they pass through; "" for none.

    onto : from the file's mm to the design's sheet frame and units; None where the file lies as the design
        does.
    """
    words = []
    for hole in holes[:4]:
        at = (
            np.array([hole["at"]]) / millimetres(window.unit)
            if onto is None
            else onto(np.array([hole["at"]]))
        )
        cell = window.lattice.locate(at[:, 0], at[:, 1])[0][0]
        where = f"cell ({cell[0]}, {cell[1]})" if window.lattice.contains(cell) else "no cell"
        words.append(f"{hole['diameter']:.4g} mm across in {where} at x {at[0, 0]:.4g}, y {at[0, 1]:.4g}")
    return "" if not words else f"{count_text(len(holes), 'hole', 'd')} drilled in it: " + "; ".join(words)


def holds_words(holds: Mapping[str, Any]) -> str:
    """Text of a file's contents for a workshop: solids, shells, faces, and repeated parts."""
    solids, faces = int(holds["solids"]), int(holds["faces"])
    words = f"{count_text(solids, 'solid', ',')} with {faces:,} faces"
    if int(holds["shells"]) != solids:
        words += f" in {int(holds['shells']):,} shells"
    repeated = [part for part in holds["parts"] if int(part["instances"]) > 1]
    if not repeated:
        return words
    many = int(holds["prototypes"])
    listed = ", ".join(
        f"{int(part['instances']):,} of {part['name'] or 'a part of ' + str(part['faces']) + ' faces'}"
        for part in repeated[:4]
    )
    return words + f", placed from {count_text(many, 'prototype', ',')} ({listed})"


def _unit_words(found: Mapping[str, Any]) -> str:
    units = [unit for unit in found.get("units", ()) if unit != 1.0]
    if not units:
        return ""
    names = {25.4: "inches", 1000.0: "metres", 10.0: "centimetres", 1e-3: "micrometres", 304.8: "feet"}
    known = [
        next((n for u, n in names.items() if abs(unit / u - 1.0) < 1e-9), f"units of {unit:g} mm")
        for unit in units
    ]
    return "; its lengths are in " + " and ".join(known)


def _light(
    asked: Inspection, window: Window, worker: Worker, path: Path, found: Mapping[str, Any], z: float
) -> list[Check]:
    """Checks of light through the faces against the law; `z` is the height of the sheet in the file (mm)."""
    if not found["kernel"] and (found.get("uneven") or not found.get("patches")):
        why = (
            "too large for the kernel, and its lens faces are of several spans; the slope error of the text"
            " is all there is"
        )
        return [kind.not_run(why, required=False, **asked.common) for kind in THROUGH_FILE]
    held = [body.name for body in _held(window, found)]
    send = FaceTracer(worker, str(path), window, held, bool(found["kernel"]), z)
    try:
        light, rms, cells = light_of_cells(asked.design, window, send, min(asked.rays, FACE_RAYS))
    except (ExportError, OSError) as error:
        why = f"no light could be sent through its faces: {error}"
        return [kind.not_run(why, **asked.common) for kind in THROUGH_FILE]
    return light_checks(asked, light, "faces" if found["kernel"] else "lens patches", rms=rms, cells=cells)


def _closed(found: Mapping[str, Any], common: Mapping[str, Any]) -> Check:
    loose = int(found["open_edges"]) + int(found["dangling"])
    bad = found.get("valid") is False
    sentence = (
        "every edge belongs to two faces"
        if not loose
        else f"{found['open_edges']} edges have one face, {found['dangling']} references lead nowhere"
    )
    if found["kernel"]:
        sentence += (
            "; the kernel finds every solid valid" if not bad else "; the kernel finds an invalid solid"
        )
    else:
        sentence += "; too large for the kernel, its text was read"
    return CLOSED.check("fail" if loose or bad else "pass", sentence, float(loose), 0.0, **common)


def _solids(
    window: Window, found: Mapping[str, Any], stated: Mapping[str, Any], common: Mapping[str, Any]
) -> Check:
    count = found.get("kernel_solids", found["solids"])
    want = stated.get("solids")
    wrong = [*_lacking(window, found), *misnamed(window, found.get("named", ()), "solid")]
    if want is None and not wrong:
        return SOLIDS.not_run(
            f"{count} solids; nothing says how many there should be",
            value=float(count),
            required=False,
            **common,
        )
    same = want is None or int(count) == int(want)
    numbers = f"{count} solids" if want is None else f"{count} solids, {want} stated"
    return SOLIDS.check(
        "pass" if same and not wrong else "fail",
        "; ".join([numbers, *wrong]),
        float(count),
        float(count if want is None else want),
        **common,
    )


def _lacking(window: Window, found: Mapping[str, Any]) -> list[str]:
    """Layers that a plate lacks of which others are there."""
    lacking = []
    for plate in plates_of(window.bodies):
        there = [body.name in found.get("volumes", ()) for body in plate]
        if any(there) and not all(there):
            names = [body.name for body, held in zip(plate, there, strict=True) if not held]
            lacking.append(f"layer {' and '.join(names)} of a plate is missing")
    return lacking


def _placement(found: Mapping[str, Any], room: Room, common: Mapping[str, Any]) -> Check:
    """Judge whether each lens of a repeated part lies on a cell of its array, and each cell has it once."""
    at = found.get("placement")
    if at is None:
        why = "no lens face was found whose cell could be determined"
        return PLACEMENT.not_run(why, required=False, unit="mm", **common)
    worst, repeated = float(at["lattice_error"]), int(at["instances"])
    body, cell = at["lattice_body"], tuple(at["lattice_cell"])
    wrong = []
    if not worst <= room.shape:
        wrong.append(
            f"{at['moved']} of {repeated} instances lie off the lattice, {body} in cell {cell} by"
            f" {worst:.3g} mm"
        )
    for name, word in (("missing", "is missing"), ("doubled", "lies there more than once")):
        if at[name]:
            body, *cells = at[f"{name}_cell"]
            wrong.append(
                f"in {at[name]} of {at['lenses']} places a lens {word}, such as {body} in cell {tuple(cells)}"
            )
    sentence = (
        f"{repeated} instances of repeated parts lie on their cells to {worst:.3g} mm, every cell holds its"
        " lenses once"
        if repeated
        else f"no part is repeated; each of {at['lenses']} lenses lies over its own cell"
    )
    check = PLACEMENT.judge(
        worst,
        room.shape,
        "; ".join(wrong) or sentence,
        unit="mm",
        limit_source=room.source,
        detail=dict(at),
        **common,
    )
    return replace(check, state="fail") if wrong else check


def _shape(
    found: Mapping[str, Any], stated: Mapping[str, Any], room: Room, common: Mapping[str, Any]
) -> Check:
    errors = [float(found[k]) for k in ("patch_error", "lens_error") if found.get(k) is not None]
    if not errors:
        return SHAPE.not_run("no lens face was found to measure", unit="mm", **common)
    worst = max(errors)
    sentence = (
        f"lens faces lie up to {worst:.3g} mm off the closed form ({found.get('patches', 0)} patches from the"
        f" text, {found.get('lens_points', 0)} points by the kernel)"
    )
    if room.fitted:
        sentence += "; what light allows is the limit, for no manifest says that they are exact"
    return SHAPE.judge(
        worst,
        room.shape,
        sentence,
        unit="mm",
        limit_source=room.source,
        detail={"stated_merge": stated.get("merged_steps")},
        **common,
    )


def _file_rms(window: Window, found: Mapping[str, Any], room: Room, common: Mapping[str, Any]) -> Check:
    """Judge the direction error that the largest slope error of any patch can cause."""
    slopes = [float(found[k]) for k in ("patch_slope_error", "lens_slope_error") if found.get(k) is not None]
    if not slopes:
        return FAITHFUL_RMS.not_run("no lens face was found to measure", unit="rad", **common)
    value = max(slopes) * gain(window)
    sentence = (
        f"the largest slope error of a lens face, {max(slopes):.3g} rad, turns light by at most"
        f" {value:.3g} rad"
    )
    if room.fitted:
        sentence += (
            "; its faces are exact, as far as light can show"
            if max(slopes) <= DIRECTION_LIMIT
            else "; its faces were fitted again"
        )
    source = other("a tenth of law_rms") if room.fitted else default("1e-6 rad")
    return FAITHFUL_RMS.judge(value, room.direction, sentence, limit_source=source, **common)


def _volume(
    window: Window, found: Mapping[str, Any], stated: Mapping[str, Any], room: Room, common: Mapping[str, Any]
) -> Check:
    """Judge the volume of the solids against quadrature of their bodies plus engraved letters."""
    if not found["kernel"]:
        return VOLUME.not_run("too large for the kernel", required=False, unit="mm³", **common)
    bodies = _held(window, found)
    parts = [volume_of(window, body) for body in bodies]
    if any(p is None for p in parts):
        return VOLUME.not_run(NO_INTEGRAL, required=False, unit="mm³", **common)
    cube = millimetres(window.unit) ** 3
    want = sum(p.value for p in parts if p is not None) * cube
    error = sum(p.error for p in parts if p is not None) * cube
    got = float(found["volume"])
    allowed = VOLUME_LIMIT * want + error
    source = default("1e-9 relative")
    x0, x1, y0, y1 = whole_extent(window)
    area = (x1 - x0) * (y1 - y0) * millimetres(window.unit) ** 2 * 2.0 * len(bodies)
    if room.fitted:  # every lens face at its limit, and borders that another program fitted
        allowed += room.shape * area + FITTED * want
        source = room.source
    merged = int(stated.get("merged_steps", 0) or 0)
    if merged:
        # steps closed on purpose move vertices by less than the merge height of about a nanometre, which is a
        # noticeable part of the volume of thin bodies; where all steps lead outwards the kernel misses their
        # walls, and at most as much again at their ends on the sides of the sheet
        height = MERGE / millimetres(window.unit)
        lost = (closed_volume(window, face, height) for body in bodies for face in (body.front, body.back))
        allowed += max(1e-8 * want, MERGED * area) + 2.0 * abs(sum(lost)) * cube
    detail: dict[str, Any] = {"volume": got, "exact": want}
    whose = "the design" if len(bodies) == len(window.bodies) else " and ".join(body.name for body in bodies)
    sentence = f"the kernel finds {got:.12g} mm³, quadrature of {whose} {want:.12g} mm³"
    if engraved := float(found.get("engraved", 0.0)):
        sentence += f"; letters engraved in the border take {engraved:.6g} mm³"
        detail["engraved"] = engraved
    if drilled := hole_words(window, found.get("holes", ())):
        sentence += f"; {drilled}"
    off = abs(got + engraved - want)
    if "volumes" in found and not engraved:
        exact = {body.name: p.value * cube for body, p in zip(bodies, parts, strict=True) if p is not None}
        name, layer = _worst_layer(found["volumes"], exact)
        off = max(off, layer)
        if layer > allowed:
            sentence += f"; {name} has {found['volumes'].get(name, 0.0):.12g} mm³, not {exact[name]:.12g}"
    return VOLUME.judge(off, allowed, sentence, unit="mm³", limit_source=source, detail=detail, **common)


def _worst_layer(volumes: Mapping[str, float], exact: Mapping[str, float]) -> tuple[str, float]:
    """The body whose volume is farthest from that of the design, and the difference, mm³."""
    off = {name: abs(volumes.get(name, 0.0) - value) for name, value in exact.items()}
    name = max(off, key=lambda one: off[one])
    return name, off[name]


def _held(window: Window, found: Mapping[str, Any]) -> tuple[Body, ...]:
    """Bodies whose lenses the file holds or whose heights it spans; all if it spans none (lies elsewhere)."""
    at = found.get("placement")
    if at is not None and at["standing_held"] >= 0.5:
        held = {*at["bodies"], *found.get("volumes", () if found["kernel"] else _plain(window))}
        return tuple(body for body in window.bodies if body.name in held)
    if "box" not in found:
        return window.bodies
    low, high = (corner[2] / millimetres(window.unit) for corner in found["box"])
    middles = [0.5 * sum(body_range(window, body)) for body in window.bodies]
    spanned = tuple(body for body, z in zip(window.bodies, middles, strict=True) if low < z < high)
    return spanned or window.bodies


def _plain(window: Window) -> list[str]:
    """Names of the layers between two planes; the text of a file does not show where they lie."""
    return [body.name for body in window.bodies if body.front.array is body.back.array is None]
