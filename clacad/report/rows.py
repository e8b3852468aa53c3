"""Rows of text of a report: light (budget, separate errors, foci, rungs, effects) and fabrication.

Fabrication needs on the first page: sizes, radii, features, mass, files, what to check with a caliper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite, pi
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.polygons import polygon_area
from clacad.base.text import digits, mrad_text, nm_text, percent_text, plainly
from clacad.base.units import MONOMIALS, POWER, RAISED, millimetres
from clacad.checks.design_kinds import RADIUS
from clacad.checks.light_kinds import IMAGE_POINT, LAW_WHITE, SPOT, TEMPERATURE, VIEWED
from clacad.effects import declared
from clacad.exporting.drawing.canvas import orientation
from clacad.sheet.face_order import plates_of
from clacad.sheet.feasibility import FaceShape
from clacad.sheet.feasibility.as_rows import cells_text
from clacad.sheet.lattice import Circle
from clacad.sheet.plate import Plate
from clacad.sheet.volume_and_extent import body_volume, grams, whole_extent
from clacad.sheet.window import Body, Window, optical_tile

if TYPE_CHECKING:
    from clacad.checks.check import Check, CheckKind
    from clacad.sheet.feasibility import BodyFacts, LensFacts
    from clacad.verification import Report
    from clacad.verification.evidence import Evidence


STATES = {
    "on": "simulated",
    "forced": "simulated, as requested",
    "off": "left out",
    "without": "left out, as requested",
    "unknown": "left out, not bounded",
}


DAYLIGHT = ("light", "weight", "to the law (mrad)", "change (mrad)", "closed form (mrad)", "through (%)")
"""Head of the table of white light and temperature."""


def number(value: float | str | None, unit: str = "") -> str:
    """A value as the page shows it."""
    return plainly(value, unit)[0]


def _mrads(*angles: float) -> tuple[str, ...]:
    return tuple(mrad_text(angle, 3, unit="") for angle in angles)


@dataclass(frozen=True, eq=False)
class LightRows:
    """Rows of tables, made from a report and the measurements in addition to its checks.

    timings : Whether seconds of this run may be shown.
    """

    report: Report
    evidence: Evidence
    timings: bool

    @property
    def viewed(self) -> str:
        """What one eye gets of the whole sheet, in a sentence."""
        return next(check.sentence for check in self.report.checks if check.kind is VIEWED)

    @property
    def image(self) -> str:
        """Sentence on place and width of the image of the design's object point; "" for one without."""
        found = [check.sentence for check in self.report.checks if check.kind in (IMAGE_POINT, SPOT)]
        return "; ".join(found)

    @property
    def budget(self) -> list[tuple[str, str, str]]:
        """Contributions to the direction error, mrad."""
        from clacad.report.figures import budget_rows

        return [(name, mrad_text(value, unit=""), what) for name, value, what in budget_rows(self.report)]

    @property
    def attributions(self) -> list[dict[str, Any]]:
        """Separate errors, mrad."""
        return [
            {
                "about": found.about,
                "cell": f"{found.cell[0]}, {found.cell[1]}",
                "bundle": found.bundle,
                "used": f"{found.used} of {found.rays}",
                "rms": mrad_text(found.rms, unit=""),
                "parts": [
                    (p.name, *_mrads(p.rms, p.half, p.worst), f"{1e3 * p.share:+.3g}", p.meaning)
                    for p in found.parts
                ],
            }
            for found in self.evidence.attributions
        ]

    @property
    def foci(self) -> list[tuple[str, str, str, str, str, str]]:
        """Foci of both lenses in both meridians, mm."""
        if self.evidence.foci is None:
            return []
        mm = millimetres(self.report.window.unit)
        return [
            (
                (
                    name,
                    number(f.lens1.focus[0] * mm),
                    number(f.lens2.focus[0] * mm),
                    number(f.gap * mm),
                    f"{abs(f.gap) / f.distance:.2g}",
                    ", ".join(number(v * mm) for v in f.length),
                )
                if f.gap == f.gap
                else (name, "no power", "no power", "–", "–", "–")
            )
            for name, f in zip("xy", self.evidence.foci, strict=True)
        ]

    @property
    def ladder(self) -> list[tuple[str, str, str, str, str, str]]:
        """Rungs: name, setting, model error, law error, share in another fate, microseconds a ray."""
        found = self.evidence.ladder
        return [
            (
                r.rung,
                r.setting,
                mrad_text(r.model_rms, 3, unit=""),
                mrad_text(r.law_rms, unit=""),
                percent_text(r.disagree, 2, unit=""),
                f"{1e6 * r.seconds / r.rays:.3g}" if self.timings else f"{us:.2g}",
            )
            for r, us in zip(found.rows, found.forecast, strict=True)
        ]

    @property
    def effects(self) -> list[tuple[str, str, str, str, str, str]]:
        """Effects: name, state, why, angle, radiance, cost."""
        plan = self.evidence.plan
        if plan is None:
            return []
        return [
            (
                r.effect,
                STATES[r.state],
                r.why,
                mrad_text(r.angle, 3, unit="") if r.angle else "",
                percent_text(r.radiance, unit="") if r.radiance else "",
                f"×{r.cost:.3g}",
            )
            for r in plan.rows
        ]

    daylight_head = DAYLIGHT

    @property
    def daylight(self) -> list[tuple[str, ...]]:
        """Lines of white light, their mean, and both temperatures; numbers in mrad.

        Of each: name, weight, rms angle to the law, change against the design wavelength, its closed form,
        and share of the light in percent.
        """
        white, warm = self._check(LAW_WHITE), self._check(TEMPERATURE)
        rows: list[tuple[str, ...]] = []
        if white is not None and white.detail.get("lines"):
            lines = white.detail["lines"]
            rows += [
                (
                    nm_text(one["wavelength"]),
                    f"{one['weight']:g}",
                    *_mrads(one["law_rms"], one["change"], one["closed_form"]),
                    percent_text(one["share"], 3, unit=""),
                )
                for one in lines
            ]
            whole = sum(one["weight"] for one in lines)
            mean = [
                sum(one["weight"] * one[name] for one in lines) / whole
                for name in ("law_rms", "change", "closed_form", "share")
            ]
            rows.append(("mean", "", *_mrads(*mean[:3]), percent_text(mean[3], 3, unit="")))
        for one in warm.detail.get("rows", ()) if warm is not None else ():
            numbers = _mrads(one["law_rms"], one["change"], one["closed_form"])
            rows.append((f"{one['kelvin']:+g} K", "", *numbers, ""))
        return rows

    @property
    def daylight_sentence(self) -> str:
        """Floor of one material, sources of the indices, and what is not known of the temperature."""
        white, warm = self._check(LAW_WHITE), self._check(TEMPERATURE)
        found = []
        if white is not None and white.detail.get("lines"):
            floor = white.detail["floor"]
            found.append(
                f"no faces of one material leave less than {mrad_text(floor)} in the mean of the lines"
                if floor == floor
                else "a sheet of several materials or plates has no floor"
            )
            found.append(f"index by {'; '.join(white.detail['sources'].values())}")
        if warm is not None and warm.detail.get("rows"):
            found.append(f"dn/dT by {'; '.join(dict.fromkeys(warm.detail['sources'].values()))}")
        elif warm is not None:
            found.append(warm.sentence)
        return f"{'; '.join(found)}." if found else ""

    def _check(self, kind: CheckKind) -> Check | None:
        return next((check for check in self.report.checks if check.kind is kind), None)

    @property
    def waves(self) -> list[tuple[str, ...]]:
        """Waves and rays of one telescopelet: see `clacad.waves.wave_report.HEAD`."""
        from clacad.waves.wave_report import rows

        return [] if self.evidence.waves is None else list(rows(self.evidence.waves))

    @property
    def waves_sentence(self) -> str:
        """Description of the waves, and the effect of identical cells in coherent light."""
        from clacad.waves.wave_report import head, sentences

        found = self.evidence.waves
        return "" if found is None else f"{'; '.join([head(found), *sentences(found)])}."

    @property
    def effects_sentence(self) -> str:
        """What is simulated and what is left out, in one sentence."""
        plan = self.evidence.plan
        if plan is None:
            return "The effects could not be planned: a wavelength lies outside the material's data."
        left = [
            (
                f"{r.effect} ≤ {mrad_text(r.angle, 2)}"
                if r.angle
                else f"{r.effect} ≤ {percent_text(r.radiance, 2)} of the light"
            )
            for r in plan.rows
            if not r.on and r.known and (r.angle or r.radiance) and declared(r.effect).rung is None
        ]
        unknown = [r.effect for r in plan.rows if not r.on and not r.known]
        text = f"A picture would simulate: {', '.join(plan.names) or 'nothing beyond refraction'}; left out: "
        text += ", ".join(left) or "nothing that changes anything"
        return text + (f"; not bounded: {', '.join(unknown)}." if unknown else ".")


@dataclass(frozen=True, slots=True)
class FabricationLine:
    """One line of the table.

    value : tuple of float, or a word. In `unit`; two values are along x and y.
    """

    about: str
    name: str
    value: tuple[float, ...] | str
    unit: str = "mm"

    @property
    def text(self) -> str:
        """The value as it is printed."""
        if isinstance(self.value, str):
            return self.value
        shown = [digits(v, "flat") for v in self.value]
        return shown[0] if len(set(shown)) == 1 and self.name.endswith("x, y") else ", ".join(shown)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready; a flat face's radius and the like become null."""
        value = (
            self.value if isinstance(self.value, str) else [v if isfinite(v) else None for v in self.value]
        )
        return {"about": self.about, "name": self.name, "value": value, "unit": self.unit}


def fabrication(report: Report, sheet: Window | None = None) -> tuple[FabricationLine, ...]:
    """Lines of the fabrication table, lengths in millimetres.

    sheet : The whole sheet, where `report.window` is the uniform equivalent of one of its cells: its count
        and sizes are reported.
    """
    window, facts = report.window if sheet is None else sheet, report.facts
    mm = millimetres(window.unit)
    lines = [*_sheet(window, mm)]
    for lens in facts.lenses:
        lines += _lens(lens, mm)
    for body in facts.bodies:
        lines += _body(window, body, mm)
    if isfinite(facts.clearance):
        lines.append(FabricationLine("assembly", "gap between the bodies, least", (facts.clearance * mm,)))
    lines += _smallest(report, mm)
    lines += _calipers(window, mm)
    return tuple(lines)


def _sheet(window: Window, mm: float) -> list[FabricationLine]:
    """Lines about the array: lattice, pitch, cells, extent, fill, land, outline, displacement."""
    lattice, line = window.lattice, partial(FabricationLine, "array")
    zone = polygon_area(optical_tile(window)) / lattice.cell_area
    x0, x1, y0, y1 = lattice.extent()
    square = "square" if lattice.pitch[0] == lattice.pitch[1] else "rectangular"
    lines = [
        line("lattice", "hexagonal" if lattice.hexagonal else square, ""),
        line("pitch x, y", tuple(p * mm for p in lattice.pitch)),
        line("cells", cells_text(lattice).replace(" x ", " × "), ""),
        line("extent of the cells x, y", ((x1 - x0) * mm, (y1 - y0) * mm)),
        line("fill: optical zone over cell", (zone,), ""),
    ]
    if window.land.seam or window.land.border:
        lines.append(line("seam, border", (window.land.seam * mm, window.land.border * mm)))
    if isinstance(lattice.outline, Circle) and lattice.outline != window.outline:
        lines.append(line("round outline of the cells, diameter", (lattice.outline.diameter * mm,)))
    if isinstance(window.outline, Circle):
        lines.append(line("round outline, diameter", (window.outline.diameter * mm,)))
    if isinstance(window.outline, Plate):
        lines += _plate(window.outline, mm)
    shift = window.shifts[1]
    if shift != (0.0, 0.0):
        lines.append(line("array 2 against array 1: dx, dy", (shift[0] * mm, shift[1] * mm)))
    return lines


def _plate(plate: Plate, mm: float) -> list[FabricationLine]:
    """What the workshop mills: edge and holes, each with its place."""
    lines = [FabricationLine("array", "plate: straight and round edges", f"{len(plate.loops[0])}", "")]
    for n, hole in enumerate(plate.holes, start=1):
        what = "hole" if hole.purpose == "mount" else "pin hole"
        size = (hole.x * mm, hole.y * mm, hole.diameter * mm)
        lines.append(FabricationLine("array", f"{what} {n}: x, y, diameter", size))
    return lines


def _lens(lens: LensFacts, mm: float) -> list[FabricationLine]:
    line, steepest = partial(FabricationLine, lens.name), np.degrees(np.arccos(min(1.0, lens.least_normal_z)))
    return [
        *_shapes(lens, mm),
        line("sag over the cell", (lens.sag * mm,)),
        line("centre thickness", (lens.thickness * mm,)),
        line("steepest slope", (float(steepest),), "deg"),
        line("fill: lens over its zone", (lens.cover,), ""),
    ]


def _shapes(lens: LensFacts, mm: float) -> list[FabricationLine]:
    """Radii and conic constants, face by face where the faces differ."""
    about, lines = lens.name, []
    for shape in lens.shapes or (FaceShape("", lens.radius, lens.conic, None),):
        of = f"{shape.side}, " if shape.side else ""
        conic = ", ".join("–" if k is None else digits(k) for k in shape.conic)
        lines += [
            FabricationLine(about, f"{of}apex radius x, y", tuple(r * mm for r in shape.radius)),
            FabricationLine(about, f"{of}conic constant x, y", conic, ""),
        ]
        for order, of_terms in MONOMIALS.items():
            terms, power = getattr(shape, order), POWER[order]
            if terms is not None:
                text = ", ".join(digits(a / mm**power) for a in terms)
                said = f"{of}{order}: {', '.join(of_terms)}"
                lines.append(FabricationLine(about, said, text, f"1/mm{RAISED[power]}"))
    return lines


def _body(window: Window, body: BodyFacts, mm: float) -> list[FabricationLine]:
    """Lines about one body: material, thicknesses, edge, neck, volume."""
    built = next(b for b in window.bodies if b.name == body.name)
    material, line = built.material, partial(FabricationLine, body.name)
    named = f"{material.name}, n = {built.index:.6g}" if material is not None else f"n = {built.index:.6g}"
    lines = [
        line("material", named, ""),
        line("edge thickness, least", (body.edge * mm,)),
        line("steps between cells, greatest", (body.step * mm,)),
        line("pieces, holes", f"{body.pieces}, {body.holes}", ""),
    ]
    if isfinite(body.neck):
        lines.insert(2, line("neck between cells, least", (body.neck * mm,)))
    volume = body_volume(window, built)
    if volume is not None:
        cubic = volume.value * mm**3
        lines.append(line("volume", (cubic,), "mm³"))
        mass = grams(built, cubic)
        if mass is None:
            lines.append(line("mass, no density given", "not known", ""))
        else:
            lines.append(line("mass", (mass,), "g"))
    return lines


def _smallest(report: Report, mm: float) -> list[FabricationLine]:
    """Least radius and least feature of the whole part: what a tool, a voxel or a pixel must reach."""
    facts = report.facts
    # checks look at the extreme cells of a sheet whose lenses are of many sizes, facts are of the cell that
    # it is judged by
    told = [check.value for check in report.checks if check.kind is RADIUS and isinstance(check.value, float)]
    radii = [abs(r) for r in (*told, *(r for lens in facts.lenses for r in lens.radii)) if isfinite(r)]
    features = {
        "pitch": min(report.window.lattice.pitch),
        **{f"edge of {b.name}": b.edge for b in facts.bodies},
        **{f"neck of {b.name}": b.neck for b in facts.bodies if isfinite(b.neck)},
        **({"seam": report.window.land.seam} if report.window.land.seam else {}),
        **({"gap": facts.clearance} if isfinite(facts.clearance) else {}),
    }
    features = {k: v for k, v in features.items() if v > 0.0}  # what is not there is judged by a check
    name = min(features, key=lambda k: features[k])
    lines = [FabricationLine("smallest", f"feature: {name}", (features[name] * mm,))]
    if radii:
        lines.insert(0, FabricationLine("smallest", "apex radius", (min(radii) * mm,)))
    return lines


def _calipers(window: Window, mm: float) -> list[FabricationLine]:
    """Outer sizes that a caliper can check, as built."""
    from clacad.sheet.feasibility.lenses import outer_size

    lines = []
    x0, x1, y0, y1 = whole_extent(window)
    plates = plates_of(window.bodies)
    named: list[tuple[str, tuple[Body, ...]]] = [(body.name, (body,)) for body in window.bodies]
    if len(plates) > 1:  # of one plate the assembly is its size
        named += [(f"plate{n}", plate) for n, plate in enumerate(plates, 1) if len(plate) > 1]
    for name, bodies in named:
        size = tuple(length * mm for length in outer_size(window, bodies))
        lines.append(FabricationLine("caliper", f"{name}: width, height, thickness", size))
    if len(window.bodies) > 1:
        low, high = window.z_range
        size = ((x1 - x0) * mm, (y1 - y0) * mm, (high - low) * mm)
        lines.append(FabricationLine("caliper", "assembly: width, height, thickness", size))
    return lines


def fabrication_dict(lines: Sequence[FabricationLine], window: Window, sheet: Window) -> dict[str, Any]:
    """The table as JSON holds it; the window that the report is about, and the whole sheet."""
    return {
        "unit": "mm",
        "rows": [line.to_dict() for line in lines],
        "orientation": orientation(window),
        "footprint_mm2": _footprint(sheet),
    }


def _footprint(window: Window) -> float:
    mm = millimetres(window.unit)
    if isinstance(window.outline, Plate):
        return window.outline.area * mm * mm
    if isinstance(window.outline, Circle):
        return pi * (0.5 * window.outline.diameter * mm) ** 2
    x0, x1, y0, y1 = whole_extent(window)
    return (x1 - x0) * (y1 - y0) * mm * mm
