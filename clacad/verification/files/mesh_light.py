"""Does light through a file's triangles go where the exact surfaces send it?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.types import Floats, Progress
from clacad.exporting.roles import Role
from clacad.formats.mesh.closed_stream import Measure
from clacad.optics.law import Law, angle_between, difference_of_laws
from clacad.optics.rays import Fate
from clacad.sheet.bundle import Bundle, bundle, launched
from clacad.sheet.light_against_law import fitted_laws
from clacad.sheet.vignetting import half_field, thin_cells
from clacad.sheet.window import Window
from clacad.tracing.triangles.telescopelet_facets import FacetBody, trace_facets
from clacad.verification.checks import Check, judge, not_run
from clacad.verification.files.cell_triangles import Gathered, telescopelet
from clacad.verification.files.facet_deviation import Deviation, forecast_rms
from clacad.verification.files.law_through_file import POINT_RAYS, measure_light
from clacad.verification.files.law_through_file import light_checks as judge_light

if TYPE_CHECKING:
    from clacad.design import Design

CELL_RAYS = 4096
RAYS_A_FACET, MOST_RAYS = 32, 65536
"""Rays of the bundle over the middle cell for each of its facets, and that many at most."""

LOST = 0.2
"""Share of the design's ALIVE rays that may get lost in the file before that is a failure."""

FIT_FIELD = 0.35
"""Cone of the fit through facets over the half field of view: wide, so that facets average out."""

FIT_RAYS = 1024
"""Rays through both below which nothing is fitted."""


@dataclass(frozen=True, eq=False)
class MeshEvidence:
    """What was measured on a mesh file, for the report.

    measure : Measure, design units
    cells : tuple of (i, j), rms : (cells,) radians
        Direction error of the file's triangles against the exact surfaces, cell by cell.
    forecast : (cells,) radians
        What the facets' slope errors make of it.
    slope_error : (faces,) radians
        Rms, over the middle cell.
    law, law_design : Law or None
        Fitted through the file's triangles, and through the design cut into the same triangles; same rays.
    gathered : Gathered or None
        Facets of the cells that were looked at, kept for what a report measures beyond the checks.
    """

    measure: Measure
    cells: tuple[tuple[int, int], ...]
    rms: Floats
    law_rms: float
    forecast: Floats
    slope_error: Floats
    law: Law | None
    law_design: Law | None
    facts: Mapping[str, Any] = field(default_factory=dict)
    gathered: Gathered | None = None


def light_checks(
    design: Design, window: Window, gathered: Gathered, off: Sequence[Deviation], found: Measure, name: str, rays: int,
    progress: Progress, present: Sequence[str] | None, role: Role = Role.MASTER, clean: float = np.inf,
) -> tuple[list[Check], MeshEvidence]:  # fmt: skip
    """Trace the same rays through the file's triangles and through the exact surfaces.

    clean : radians, what facets of this size make of the direction error if their corners lie on the design; noise in
    the file's own corners cannot widen the limit of faithfulness beyond it.

    Returns
    -------
    checks : list of Check
        Light through the file against the law (file_*), then against the design cut as the file is (faithful_*).
    evidence : MeshEvidence
    """
    common: dict[str, Any] = {"where": "file", "subject": name}
    progress("tracing the triangles", 0.0)
    held = telescopelet(window, gathered, 0, present)
    light = measure_light(
        design,
        window,
        lambda lit: trace_facets(held, lit.rays),
        max(rays, _enough(gathered)),
        min(rays, POINT_RAYS),
        gathered.cells[0],
    )
    main, truth = light.rays, light.truth
    rms, lost, to_law = [], [], []
    for number, cell in enumerate(gathered.cells):
        progress("tracing the triangles", number / len(gathered.cells))
        count = len(main.rays) if number == 0 else min(rays, CELL_RAYS)
        seen = light.seen
        if number:
            lit = _moved(window, main, cell, count)
            seen = trace_facets(telescopelet(window, gathered, number, present), lit.rays)
        good, alive = truth.fate[:count] == Fate.ALIVE, seen.fate == Fate.ALIVE
        both = good & alive
        rms.append(_rms_between(seen.direction[both], truth.direction[:count][both]))
        to_law.append(
            _rms_between(seen.direction[alive], window.law.refract(main.rays.direction[:count][alive]))
        )
        lost.append(1.0 - both.sum() / max(1, good.sum()))
    law, exact = _fits(design, window, gathered, held, rays, present)
    forecasts = np.array([forecast_rms(window, d) for d in off])
    evidence = MeshEvidence(
        found,
        gathered.cells,
        np.array(rms),
        light.rms,
        forecasts,
        off[0].slope_rms,
        law,
        exact,
        {"lost": lost},
        gathered,
    )
    noise = float(forecasts[0]) if np.isfinite(forecasts[0]) else 0.0
    checks = judge_light(design, light, role, name, rms=to_law, cells=gathered.cells, noise=noise)
    checks.append(_faithful_rms(design, evidence, lost, str(main), clean, common))
    return checks + _faithful_fit(design, evidence, common), evidence


def _enough(gathered: Gathered) -> int:
    """Rays that see every facet of a lens many times: only then do the errors of the facets' own slopes cancel in fits."""
    finest = max(
        (sum(map(len, parts)) for (_, _, cell), parts in gathered.facets.items() if cell == 0), default=0
    )
    return min(MOST_RAYS, RAYS_A_FACET * finest)


def _rms_between(one: Floats, other: Floats) -> float:
    """Rms angle between directions (n, 3), radians; NaN for none."""
    angle = angle_between(one, other)
    angle = angle[np.isfinite(angle)]
    return float(np.sqrt(np.mean(angle**2))) if len(angle) else np.nan


def _moved(window: Window, main: Bundle, cell: tuple[int, int], count: int) -> Bundle:
    """The first rays of a bundle, over another cell."""
    return launched(window, main.points[:count], main.rays.direction[:count], cell, main.middle, main.field)


def _faithful_rms(
    design: Design, evidence: MeshEvidence, lost: list[float], bundle_text: str, clean: float,
    common: Mapping[str, Any],
) -> Check:  # fmt: skip
    rms = evidence.rms
    if np.isnan(rms).any() or not np.isfinite(evidence.forecast).all():
        dark = [str(c) for c, r in zip(evidence.cells, rms, strict=True) if np.isnan(r)]
        if np.isnan(rms).all():
            return not_run("faithful_rms", "no ray gets through the file's triangles", unit="rad", **common)
        return Check(
            "faithful_rms", "fail", f"no ray gets through the triangles over the cells {', '.join(dark)}", None,
            unit="rad", bundle=bundle_text, **common,
        )  # fmt: skip
    worst = int(np.argmax(rms / evidence.forecast))
    limit = design.check.file_rms * min(float(evidence.forecast[worst]), clean) + 1e-9
    sentence = (
        f"through the triangles light leaves {1e3 * rms[worst]:.4g} mrad rms from where the exact surfaces send it "
        f"(cell {evidence.cells[worst]}, worst of {len(rms)}); its facets' slopes forecast {1e3 * evidence.forecast[worst]:.4g}"
    )
    check = judge(
        "faithful_rms", float(rms[worst]), limit, sentence, unit="rad", bundle=bundle_text,
        source=f"{design.check.file_rms:g} × forecast of its slope errors",
        detail={"by_cell": rms, "cells": evidence.cells, "lost": lost, "law_rms": evidence.law_rms}, **common,
    )  # fmt: skip
    if max(lost) > LOST:
        text = f"{100 * max(lost):.3g} % of the rays that the design lets through do not get through the triangles"
        return replace(check, state="fail", sentence=text, value=max(lost), limit=LOST, unit="of the rays, lost",
                       source=f"fixed: {LOST:g} lost at most")  # fmt: skip
    return check


def _fits(
    design: Design, window: Window, gathered: Gathered, held: tuple[FacetBody, ...], rays: int,
    present: Sequence[str] | None,
) -> tuple[Law | None, Law | None]:  # fmt: skip
    """Fit the law through the triangles, and through the design cut into the same triangles, with the same rays.

    Facets alone bias a fit by about the inverse square of their number a side; both sides share that.
    """
    angle = max(design.check.field, FIT_FIELD * min(half_field(thin_cells(window))))
    lit = bundle(window, rays, angle, design.check.field_centre)
    seen = trace_facets(held, lit.rays)
    ideal = trace_facets(telescopelet(window, gathered, 0, present, onto_design=True), lit.rays)
    both = (ideal.fate == Fate.ALIVE) & (seen.fate == Fate.ALIVE)
    return fitted_laws(window.law, lit.rays, seen, ideal, both, FIT_RAYS) or (None, None)


def _faithful_fit(design: Design, evidence: MeshEvidence, common: Mapping[str, Any]) -> list[Check]:
    law, exact = evidence.law, evidence.law_design
    if law is None or exact is None:
        why = "too few rays get through the file's triangles to fit a law"
        return [not_run(name, why, **common) for name in ("faithful_eta", "faithful_delta")]
    eta, delta = difference_of_laws(law, exact)
    text = "through the file's triangles {0} = {1:.6g}, {2:.6g}; through the design cut into the same triangles {3:.6g}, {4:.6g}"
    return [
        judge("faithful_eta", eta, design.check.eta, text.format("eta", law.eta_x, law.eta_y, exact.eta_x, exact.eta_y),
              unit="relative", source="eta", detail={"measured": (law.eta_x, law.eta_y)}, **common),
        judge("faithful_delta", delta, design.check.delta,
              text.format("delta", law.delta_x, law.delta_y, exact.delta_x, exact.delta_y), unit="slope",
              source="delta", detail={"measured": (law.delta_x, law.delta_y)}, **common),
    ]  # fmt: skip
