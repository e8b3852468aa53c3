"""The derived numbers as rows for a person."""

from __future__ import annotations

from collections.abc import Callable
from math import degrees, isfinite
from typing import NamedTuple

import numpy as np

from clacad.feasibility.facts import VIEWING_DISTANCE, BodyFacts, Feasibility, LensFacts, Two
from clacad.sheet import Window

LENGTHS = ((1.0, "m"), (1e-3, "mm"), (1e-6, "um"), (1e-9, "nm"))
"""Metres and name of the units a length is shown in, largest first."""


class Row(NamedTuple):
    """One line of the table of derived numbers: what it is about, its name, value and unit as text."""

    about: str
    name: str
    value: str
    unit: str


def length_unit(metres: float) -> tuple[float, str]:
    """Unit (metres, name) in which the design's unit is shown: the largest one not above it."""
    return next((pair for pair in LENGTHS if pair[0] <= metres * (1.0 + 1e-9)), LENGTHS[-1])


def describe(window: Window, facts: Feasibility) -> tuple[Row, ...]:
    """Rows of all derived numbers, lengths in a common unit near the design's own."""
    size, name = length_unit(window.unit)
    scale = window.unit / size

    def of_length(value: float | Two) -> str:
        values = value if isinstance(value, tuple) else (value,)
        return ", ".join(digits(v * scale) for v in values)

    rows = [row for lens in facts.lenses for row in _lens_rows(lens, of_length, name)]
    rows += [row for body in facts.bodies for row in _body_rows(body, of_length, name)]
    if isfinite(facts.clearance):
        rows.append(Row("assembly", "clearance", of_length(facts.clearance), name))
    rows += [
        Row("assembly", "separation (in air)", of_length(facts.separation), name),
        Row("view", "middle of the field, x, y", _angles(facts.aperture), "deg"),
        Row("view", "half field, lens x, y", _angles(facts.half_field), "deg"),
        Row("view", "first ghosts off the middle, lens x, y", _angles(facts.ghost_onset), "deg"),
        Row("view", "undeviated direction, x, y", _angles(facts.undeviated), "deg"),
        Row("view", "ray offset on the sheet, lens x, y", of_length(facts.offset_blur), name),
        Row(
            "view",
            "diffraction, lens x, y",
            ", ".join(digits(1e3 * v) for v in facts.diffraction_blur),
            "mrad",
        ),
        Row("view", "Fresnel number", digits(facts.fresnel_number), ""),
        Row("view", f"best pitch seen from {VIEWING_DISTANCE:g} m", of_length(facts.pixel), name),
    ]
    return tuple(rows)


def _lens_rows(lens: LensFacts, of_length: Callable[[float | Two], str], name: str) -> list[Row]:
    about = f"lens {lens.array + 1}"
    rows = [
        Row(about, "focal length x, y", of_length(lens.focal_length), name),
        Row(about, "focal length as built x, y", of_length(lens.built_focal_length), name),
        Row(about, "apex radius x, y", of_length(lens.radius), name),
        Row(about, "conic constant x, y", ", ".join("-" if k is None else digits(k) for k in lens.conic), ""),
        Row(about, "centre thickness", of_length(lens.thickness), name),
        Row(about, "sag", of_length(lens.sag), name),
        Row(about, "rim half width x, y", of_length(lens.rim), name),
        Row(about, "cover", digits(lens.cover), ""),
        Row(about, "least normal z", digits(lens.least_normal_z), ""),
        Row(about, "F-number x, y", ", ".join(digits(v) for v in lens.f_number), ""),
    ]
    if isfinite(lens.corner):
        rows.append(Row(about, "least thickness over the cell", of_length(lens.corner), name))
    if lens.least_thickness > 0.0:
        rows.append(
            Row(about, "centre thickness that covers the cell", of_length(lens.least_thickness), name)
        )
    return rows


def _body_rows(body: BodyFacts, of_length: Callable[[float | Two], str], name: str) -> list[Row]:
    rows = [
        Row(body.name, "edge thickness", of_length(body.edge), name),
        Row(body.name, "greatest step", of_length(body.step), name),
        Row(body.name, "height range", of_length((body.low, body.high)), name),
        Row(body.name, "pieces, holes", f"{body.pieces}, {body.holes}", ""),
    ]
    if isfinite(body.neck):
        rows.insert(1, Row(body.name, "neck", of_length(body.neck), name))
    return rows


def digits(value: float) -> str:
    """Six significant digits, or a word where there is no number."""
    if not isfinite(value):
        return "none" if np.isnan(value) else ("unlimited" if value > 0 else "none")
    return f"{value:.6g}" if value else "0"


def _angles(slopes: Two) -> str:
    return ", ".join(digits(degrees(float(np.arctan(s)))) for s in slopes)
