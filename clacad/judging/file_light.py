"""Light through a file, compared with the law: the checks by which a file is called an optical master.

The same rays are traced through the file's own triangles or faces and through the exact surfaces. The file
must meet the requirements on the design (section E of the contract: rms, bias, η, δ, confocality, throughput)
within the design's limits. `clacad.light` describes each measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import mrad_text, percent_text
from clacad.base.types import Bools, Floats
from clacad.checks.check import DESIGN_FILE, Check, CheckKind
from clacad.checks.file_kinds import (
    FILE_CONFOCALITY,
    FILE_LAW_BIAS,
    FILE_LAW_DELTA,
    FILE_LAW_ETA,
    FILE_LAW_RMS,
    FILE_LAW_WHITE,
    FILE_THROUGHPUT,
)
from clacad.exporting.roles import Role
from clacad.judging.delivery import Inspection
from clacad.light.compare import Comparison, WhiteLight
from clacad.light.measure import Light, Send, first_rays, measure, measure_each, rms_of
from clacad.optics.law import Law, difference_of_laws
from clacad.sheet.bundle import RequestedLaw, bundle, field_points
from clacad.sheet.vignetting import mean_share, share, thin_cells
from clacad.sheet.window import Window
from clacad.tracing.trace import trace

if TYPE_CHECKING:
    from clacad.design import Design


POINT_RAYS = 4096
"""Rays of each of the nine field points through triangles."""


@dataclass(frozen=True, eq=False)
class FileLight:
    """Results of light through a file.

    compared : Light of the main bundle through the file and through the exact surfaces, in the most densely
        lit cell.
    points : Parallel light through the file, of nine directions of the field.
    shift : (2,). Shift of array 2 along the sheet's normal that minimizes the rms error to the law, file
        minus exact, per lens axis, over the distance between the lenses; NaN in an axis without power.
    middle, field : (float, float)
        ALIVE share in the middle of the field, and over the field, each as (through the file, closed form).
    half_order : radians. Half the angle between light through lens 2 of a cell and of its neighbour.
    white : Light in the lines of white light, where they are judged.
    """

    compared: Comparison
    points: tuple[Light, ...]
    shift: Floats
    middle: tuple[float, float]
    field: tuple[float, float]
    half_order: float
    white: WhiteLight | None = None

    @property
    def light(self) -> Light:
        """Of the main bundle, through the file."""
        return self.compared.light

    @cached_property
    def bias(self) -> Floats:
        """Angle (9,) of the mean exit direction to the law, radians, of nine directions; NaN if too dark."""
        return np.array([point.bias for point in self.points])

    @property
    def near(self) -> Bools:
        """Rays (n,) whose exit direction is nearer to the law than to that of a neighbouring lens."""
        return np.asarray(self.light.error < self.half_order)

    @property
    def partner(self) -> float:
        """Rms error (radians) of the rays that are `near`."""
        return rms_of(self.light, self.near)

    @property
    def strayed(self) -> float:
        """Share of the other rays among those ALIVE through the file.

        For instance through a strip of a neighbour's lens that lies in the cell.
        """
        known = self.light.known
        return 1.0 - float(self.near[known].mean()) if known.any() else np.nan


WHITE_RAYS = 8192
"""Most rays of each line: the mean is within 1 % of that of more."""


def lines_of(design: Design, window: Window) -> dict[float, float]:
    """Lines of white light (metres → weight) that a design is measured in; empty where it has no colour."""
    asked = design.light.spectrum is not None or design.check.law_white is not None
    materials = [body.material for body in window.bodies]
    lines = design.light.lines
    if not asked and (design.light.coherent or window.wavelength is None):
        return {}
    known = all(one is not None and one.range_m and all(map(one.knows, lines)) for one in materials)
    return dict(lines) if known else {}


def measure_light(
    design: Design,
    window: Window,
    send: Send,
    rays: int,
    point_rays: int = POINT_RAYS,
    cell: tuple[int, int] | None = None,
    exact: Send | None = None,
) -> FileLight:
    """Send the bundles of the checks through a file.

    design, window
    send : Bundle → TraceResult through the file, sheet frame, window units; ALIVE where a ray crossed every
        body of one telescopelet. Rays of one wavelength meet the indices of that wavelength.
    rays, point_rays : Of the main bundle, and of each of the nine field points.
    cell : (i, j) or None. Cell that is lit; default the central one.
    exact : Bundle → TraceResult through the exact surfaces; None: through those of `window`.
    """
    spec, law, cells = design.check, RequestedLaw.of(window), thin_cells(window)
    main = bundle(window, rays, spec.field, spec.field_centre, cell=cell)
    truth = trace(window, main.rays, path="size") if exact is None else exact(main)
    directions = field_points(window, spec.field, spec.field_centre)
    beams = [bundle(window, point_rays, 0.0, middle=direction, cell=main.cell) for direction in directions]
    found, *points = measure_each(send, [main, *beams], law)
    compared = Comparison(found, Light(main, truth, law))
    closed = mean_share(cells, main.rays.direction)
    middle = points[0].share, float(share(cells, directions[:1])[0])
    shift = compared.focus(window)
    lines = lines_of(design, window) if spec.law_white is not None else {}
    white = None
    if lines:
        base = first_rays(found, WHITE_RAYS)
        white = WhiteLight(base, measure(send, base.lit, law, lines), lines)
    return FileLight(
        compared, tuple(points), shift, middle, (compared.light.share, closed), half_order(window), white
    )


def half_order(window: Window) -> float:
    """Half the angle p/f2 (radians) between light through lens 2 of neighbouring cells; inf without power."""
    focal = [abs(f) for f in window.thin.focal_length[1] if np.isfinite(f)]
    return 0.5 * min(window.lattice.pitch) / max(focal) if focal else np.inf


# -- judging ------------------------------------------------------------------------------------
def light_checks(
    asked: Inspection,
    found: FileLight,
    what: str = "triangles",
    *,
    rms: Sequence[float] = (),
    cells: Sequence[tuple[int, int]] = (),
    noise: float = 0.0,
) -> list[Check]:
    """Judge light through a file by the limits of the design.

    `asked` : A master fails beyond a limit; a preview gets a warning. A scan fails by the part of its rms
        that its facets and their noise do not explain; for the rest it gets a warning.
    found : Of the most densely lit cell.
    what : The geometry that light crossed: triangles, or faces.
    rms : radians for every measured cell, the middle one first; cells : their numbers. The worst is judged.
        A number without rms: the only cell, where another than the middle one.
    noise : radians. For scans: direction error that the facets' own slopes, noise included, cause.
    """
    checks = [
        _law_rms(asked, found, what, rms, cells, noise),
        *([] if found.white is None else [white_check(asked, found.white, what)]),
        _law_bias(asked, found, what),
        *_law_fitted(asked, found, what),
        _confocality(asked, found),
        _throughput(asked, found, what),
    ]
    if asked.role is Role.SCAN:
        # a coarse measurement is not a fault of the part: faithful_* allow for its facets
        return [checks[0], *(softened(check) for check in checks[1:])]
    return [softened(check) if asked.role is Role.PREVIEW else check for check in checks]


def softened(check: Check) -> Check:
    """The check with a failure reduced to a warning, for files that are not masters."""
    return replace(check, state="warn" if check.state == "fail" else check.state, required=False)


def _law_rms(
    asked: Inspection,
    found: FileLight,
    what: str,
    rms: Sequence[float],
    cells: Sequence[tuple[int, int]],
    noise: float,
) -> Check:
    """Rms direction error to the law of the worst measured cell; for a scan, without its facets' part."""
    spec = asked.design.check
    limit = spec.law_rms if spec.mesh_law_rms is None else spec.mesh_law_rms
    source = FILE_LAW_RMS.limit_source if spec.mesh_law_rms is None else DESIGN_FILE
    if found.light.rms != found.light.rms:
        why = f"too little light gets through the file's {what}"
        return FILE_LAW_RMS.not_run(why, limit=limit, unit="rad", **asked.common)
    every = np.array([found.light.rms, *rms[1:]])
    worst = int(np.nanargmax(every))
    value = float(every[worst])
    where = f"in cell {cells[worst]}" if cells and (len(every) > 1 or not rms) else "in the middle cell"
    where += f", worst of {len(every)}" if cells and len(every) > 1 else ""
    sentence = f"through the file's {what} light leaves {mrad_text(value)} rms from the law ({where})"
    sentence += _other_rms(found, every)
    common: dict[str, Any] = {"bundle": str(found.light.lit), "limit_source": source, **asked.common}
    told = {
        "by_cell": every,
        "cells": cells,
        "all_cells": _together(every),
        "partner": found.partner,
        "strayed": found.strayed,
    }
    if not (asked.role is Role.SCAN and value > limit and noise > 0.0):
        return FILE_LAW_RMS.judge(
            value, limit, sentence, detail={"worst": found.light.worst, **told}, **common
        )
    rest = float(np.sqrt(max(0.0, value**2 - noise**2)))
    sentence += (
        f"; the facets' own slopes, noise among them, make {mrad_text(noise, unit='')} of it (finer facets"
        f" of the same noise are worse), {mrad_text(rest, unit='')} is left"
    )
    detail = {"with_noise": value, "noise": noise, **told}
    check = FILE_LAW_RMS.judge(rest, limit, sentence, detail=detail, **common)
    return replace(check, state="warn") if check.state == "pass" else check


def _together(every: Floats) -> float:
    """Rms over the light of all measured cells, radians."""
    return float(np.sqrt(np.nanmean(every**2)))


def _other_rms(found: FileLight, every: Floats) -> str:
    """Text of the rms over all cells and over partner light, where they differ from the worst cell's."""
    words = ""
    if len(every) > 1 and np.isfinite(_together(every)):
        words += f"; over all {len(every)} cells {mrad_text(_together(every))}"
        others = np.delete(every, np.nanargmax(every))
        others = others[np.isfinite(others)]
        if len(others):
            words += f", the others {mrad_text(others.min(), unit='')} to {mrad_text(others.max())}"
    if found.strayed > 0.0 and found.partner == found.partner:
        words += (
            f"; {percent_text(found.strayed, 2)} of the light of the cell lit most leaves nearer to the"
            f" direction of a neighbouring lens than to the law, the rest {mrad_text(found.partner)} rms"
            " from the law"
        )
    return words


def white_check(asked: Inspection, white: WhiteLight, what: str) -> Check:
    """Law error of the lines of white light, for a design that judges it."""
    value = white.mean(white.law_rms)
    sentence = f"through the file's {what} white light leaves {mrad_text(value)} rms from the law"
    return FILE_LAW_WHITE.judge(
        value,
        asked.design.check.law_white or np.nan,
        f"{sentence}, mean of {len(white.lines)} lines",
        bundle=str(white.base.lit),
        detail={"lines": dict(zip((f"{1e9 * w:g} nm" for w in white.lines), white.law_rms, strict=True))},
        **asked.common,
    )


def _law_bias(asked: Inspection, found: FileLight, what: str) -> Check:
    limit = asked.design.check.law_bias
    if np.isnan(found.bias).all():
        why = f"no field point passes enough light through the {what}"
        return FILE_LAW_BIAS.not_run(why, limit=limit, unit="rad", **asked.common)
    worst = int(np.nanargmax(found.bias))
    value = float(found.bias[worst])
    place = "in the middle" if worst == 0 else f"at the rim, {45 * (worst - 1)} deg from +x,"
    return FILE_LAW_BIAS.judge(
        value,
        limit,
        f"{place} of the field the mean direction through the file's {what} is {mrad_text(value)} from"
        " the law",
        bundle="9 directions over the whole cell",
        detail={"by_field_point": found.bias},
        **asked.common,
    )


def _law_fitted(asked: Inspection, found: FileLight, what: str) -> list[Check]:
    """η and δ through the file, compared with those through the exact surfaces."""
    laws, spec = found.compared.laws, asked.design.check
    kinds = (FILE_LAW_ETA, FILE_LAW_DELTA)
    if laws is None:
        why = f"too little light gets through the file's {what} to fit a law"
        return [kind.not_run(why, **asked.common) for kind in kinds]
    text = "fitted over the same rays, {0} = {1:.6g}, {2:.6g} through the file's " + what
    text += " and {3:.6g}, {4:.6g} through the exact surfaces"
    return fit_checks(kinds, laws, (spec.eta, spec.delta), text, bundle=str(found.light.lit), **asked.common)


def fit_checks(
    kinds: tuple[CheckKind, CheckKind],
    laws: tuple[Law, Law],
    limits: tuple[float, float],
    text: str,
    **common: Any,
) -> list[Check]:
    """Compare η (relative) and δ (slope) of one fitted law with another.

    kinds : of the check of η and of that of δ
    laws : the judged law and the reference
    limits : of η and of δ
    text : with fields for the name and the four numbers
    """
    eta, delta = difference_of_laws(*laws)
    found, wanted = ((one.eta_x, one.eta_y) for one in laws)
    shift, wanted_shift = ((one.delta_x, one.delta_y) for one in laws)
    return [
        kind.judge(
            value, limit, text.format(name, *one, *other), detail={"measured": one, "exact": other}, **common
        )
        for kind, limit, name, value, one, other in (
            (kinds[0], limits[0], "eta", eta, found, wanted),
            (kinds[1], limits[1], "delta", delta, shift, wanted_shift),
        )
    ]


def _confocality(asked: Inspection, found: FileLight) -> Check:
    limit = asked.design.check.confocality
    if np.isnan(found.shift).all():
        why = "too little light gets through the file to say"
        return FILE_CONFOCALITY.not_run(why, limit=limit, **asked.common)
    value = float(np.nanmax(np.abs(found.shift)))
    sentence = (
        f"array 2 would have to move by {value:.4g} of the distance between the lenses for light through the"
        f" file to keep to the law as well as through the exact surfaces (x {found.shift[0]:+.4g}, y"
        f" {found.shift[1]:+.4g})"
    )
    return FILE_CONFOCALITY.judge(
        value, limit, sentence, bundle=str(found.light.lit), detail={"shift": found.shift}, **asked.common
    )


def _throughput(asked: Inspection, found: FileLight, what: str) -> Check:
    ratios = [a / b if b > 0.0 else np.nan for a, b in (found.middle, found.field)]
    value = float(np.nanmin(ratios)) if not np.isnan(ratios).all() else np.nan
    sentence = (
        f"{found.middle[0]:.3f} of the light passes the file's {what} in the middle of the field (closed form"
        f" {found.middle[1]:.3f}), {found.field[0]:.3f} over the field ({found.field[1]:.3f})"
    )
    return FILE_THROUGHPUT.judge(
        value, asked.design.check.throughput, sentence, bundle=str(found.light.lit), **asked.common
    )
