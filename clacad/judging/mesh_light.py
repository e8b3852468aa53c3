"""Light through a file's triangles, compared with light through the exact surfaces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil, floor, log10
from typing import Any

import numpy as np

from clacad.base.text import mrad_text, percent_text
from clacad.base.types import Bools, Floats
from clacad.checks.check import OWN_KEY, RAYS_NEEDED, Check, derived, other
from clacad.checks.file_kinds import FAITHFUL_DELTA, FAITHFUL_ETA, FAITHFUL_RMS
from clacad.formats.mesh.measure import Measure
from clacad.judging.cell_triangles import CellFacets, telescopelet
from clacad.judging.delivery import Inspection
from clacad.judging.face_deviation import Deviation, forecast_rms
from clacad.judging.file_light import POINT_RAYS, FileLight, fit_checks, light_checks, measure_light
from clacad.light.compare import Comparison, rms_between
from clacad.light.measure import Light
from clacad.optics.law import Law
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.bundle import Bundle, RequestedLaw, bundle, launched
from clacad.sheet.like_cell import like_cell
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.vignetting import half_field, thin_cells
from clacad.sheet.window import Window
from clacad.tracing.facets.telescopelet import FacetBody, trace_facets
from clacad.tracing.trace import trace
from clacad.tracing.worst_cell import SeenCell, tried_cells

CELL_RAYS = 4096
RAYS_A_FACET, MOST_RAYS = 32, 65536
"""Rays over the middle cell per facet of it, and the most rays of that bundle."""

LOST = 0.2
"""Share of the design's ALIVE rays that the file may lose without a failure."""

LEAST_FITTED = 1024
"""Rays through triangles below which no law is fitted."""

FIT_FIELD = 0.35
"""Cone of the fit through facets, over the half field of view: wide, so that facet errors average out."""


@dataclass(frozen=True, eq=False)
class MeshEvidence:
    """Measurements of a mesh file, for the report.

    measure : design units
    cells : tuple of (i, j), rms : (cells,) radians
        Direction error of the file's triangles relative to the exact surfaces, cell by cell.
    forecast : (cells,) radians. Direction error that the facets' slope errors predict.
    slope_error : (faces,) radians. Rms over the middle cell.
    law, law_design : Law or None
        Fitted through the file's triangles, and through the design cut into the same triangles; same rays.
    gathered : Facets of the chosen cells, kept for measurements of a report beyond the checks.
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
    gathered: CellFacets | None = None

    def without_part(self) -> MeshEvidence:
        """The evidence without the registered mesh itself."""
        return replace(self, facts={name: one for name, one in self.facts.items() if name != "part"})


def checks_of_light(
    asked: Inspection,
    window: Window,
    gathered: CellFacets,
    off: Sequence[Deviation],
    found: Measure,
    present: Sequence[str] | None,
    clean: float = np.inf,
) -> tuple[list[Check], MeshEvidence]:
    """Trace the same rays through the file's triangles and through the exact surfaces.

    gathered : Facets of the cells that are lit, the middle one first.
    off : Of these cells.
    found : Of the whole file.
    present : names of its bodies, or None for all
    clean : radians. Direction error of facets of this size with corners on the design. It caps the limit of
        faithfulness, which noise in the file's own corners would otherwise widen.
    Returns checks, evidence: Checks of light against the law (file_*), then against the design with the
        file's facets (faithful_*).
    """
    asked.progress("tracing the triangles", 0.0)
    held, cells = telescopelet(window, gathered, 0, present), [seen_cell(window, c) for c in gathered.cells]
    one = cells[0]
    light = measure_light(
        asked.design,
        one.like,
        lambda lit: trace_facets(held, one.placed(lit).rays),
        max(asked.rays, _enough(gathered)),
        min(asked.rays, POINT_RAYS),
        gathered.cells[0] if window.uniform else None,
        one.send,
    )
    rms, to_law, lost = np.array(list(_by_cell(asked, cells, gathered, light, present))).T
    law, exact, passed = _fits(asked, window, gathered, held, present)
    forecasts = np.array([forecast_rms(cell.like, d) for cell, d in zip(cells, off, strict=True)])
    facts, slopes = {"lost": lost.tolist()}, off[0].slope_rms
    evidence = MeshEvidence(
        found, gathered.cells, rms, light.light.rms, forecasts, slopes, law, exact, facts, gathered
    )
    noise = float(forecasts[0]) if np.isfinite(forecasts[0]) else 0.0
    checks = light_checks(asked, light, rms=to_law.tolist(), cells=gathered.cells, noise=noise)
    checks.append(_faithful_rms(asked, evidence, str(light.light.lit), clean))
    return checks + _faithful_fit(asked, evidence, passed), evidence


def rays_for(passed: int, share: float) -> int:
    """Rays of which `passed` pass at a share `share`, plus a tenth, rounded to two figures."""
    least = 1.1 * passed / share
    step = int(10 ** max(0, floor(log10(least)) - 1))
    return ceil(least / step) * step


def _by_cell(
    asked: Inspection,
    cells: Sequence[SeenCell],
    gathered: CellFacets,
    light: FileLight,
    present: Sequence[str] | None,
) -> Iterator[tuple[float, float, float]]:
    """Of each cell: rms direction error (radians) to the exact surfaces and the law, share of lost rays."""
    window, main, count = cells[0].window, light.light.lit, min(asked.rays, CELL_RAYS)
    own = [] if window.uniform else _own_light(asked, cells[1:], count)
    for number, one in enumerate(cells):
        asked.progress("tracing the triangles", number / len(cells))
        lit, seen, truth = one.placed(main), light.light.seen, light.compared.exact.seen
        if number:
            index = gathered.cells[number]
            lit, truth = own[number - 1] if own else (_moved(window, main, index, count), truth)
            seen = trace_facets(telescopelet(window, gathered, number, present), lit.rays)
        truth = truth.rows(slice(len(seen)))
        good, alive = truth.fate == Fate.ALIVE, seen.fate == Fate.ALIVE
        both = good & alive
        lost = 1.0 - both.sum() / max(1, good.sum())
        if lost > LOST:
            ideal = trace_facets(telescopelet(window, gathered, number, present, onto_design=True), lit.rays)
            lost = _lost(good, ideal.fate == Fate.ALIVE, alive, field=bool(window.thin.field))
        law = RequestedLaw.of(one.like)
        yield rms_between(seen.direction, truth.direction, both), Light(lit, seen, law, fewest=1).rms, lost


def _own_light(asked: Inspection, cells: Sequence[SeenCell], count: int) -> list[tuple[Bundle, TraceResult]]:
    """Light of `count` rays in each cell's own field through the exact surfaces, all traced in one call."""
    spec = asked.design.check
    lit = [one.placed(bundle(one.like, count, spec.field, spec.field_centre)) for one in cells]
    if not lit:
        return []
    rays = Rays(*(np.concatenate([getattr(one.rays, k) for one in lit]) for k in ("position", "direction")))
    seen = trace(cells[0].window, rays, path="size")
    return [(one, seen.rows(slice(count * k, count * (k + 1)))) for k, one in enumerate(lit)]


def lit_cells(window: Window, field: float) -> tuple[tuple[int, int], ...]:
    """Cells that are lit: the chosen ones, the middle first.

    In a non-uniform sheet they are the tried cells, the worst by the exact surfaces first.
    """
    if window.uniform:
        return tuple((int(i), int(j)) for i, j in representative_cells(window, "file"))
    return tuple(one.index for one in tried_cells(window, field))


def seen_cell(window: Window, cell: tuple[int, int]) -> SeenCell:
    """One cell with its light."""
    index = np.array(cell, dtype=np.int64)
    return SeenCell(window, like_cell(window, index, widest=False), index)


def _enough(gathered: CellFacets) -> int:
    """Rays that sample every facet of a lens many times, so that errors of facets' slopes cancel in fits."""
    finest = max(
        (sum(map(len, parts)) for (_, _, cell), parts in gathered.facets.items() if cell == 0), default=0
    )
    return min(MOST_RAYS, RAYS_A_FACET * finest)


def _lost(good: Bools, ideal: Bools, alive: Bools, *, field: bool = False) -> float:
    """Share of rays that a file loses for other reasons than coarse facets.

    Coarse facets of a strongly magnifying pair send some rays past their partner and others into it, in equal
    numbers. The loss is therefore the larger of two: the loss in number, and the loss among the rays that
    pass both the exact surfaces and the design with the file's facets.

    good, ideal, alive : (n,)
        Rays that pass the exact surfaces, the design with the file's facets, and the file.
    field : bool
        Whether there is a field lens: its coarse facets send light past the partner, and no light into it.
    """
    known = good & ideal
    whole = min(good.sum(), ideal.sum()) if field else good.sum()
    kept = [alive.sum() / max(1, whole), (known & alive).sum() / max(1, known.sum())]
    return float(1.0 - min(kept))


def _moved(window: Window, main: Bundle, cell: tuple[int, int], count: int) -> Bundle:
    """The first rays of a bundle, over another cell."""
    return launched(window, main.points[:count], main.rays.direction[:count], cell, main.middle, main.field)


def _faithful_rms(asked: Inspection, evidence: MeshEvidence, bundle_text: str, clean: float) -> Check:
    """Direction error of the worst cell to the exact surfaces, and the forecast from its facets' slopes."""
    rms, lost, times = evidence.rms, evidence.facts["lost"], asked.design.check.file_rms
    common: dict[str, Any] = {"unit": "rad", **asked.common}
    if np.isnan(rms).any() or not np.isfinite(evidence.forecast).all():
        dark = [str(c) for c, r in zip(evidence.cells, rms, strict=True) if np.isnan(r)]
        if np.isnan(rms).all():
            return FAITHFUL_RMS.not_run("no ray gets through the file's triangles", **common)
        why = f"no ray gets through the triangles over the cells {', '.join(dark)}"
        return FAITHFUL_RMS.check("fail", why, bundle=bundle_text, limit_source=OWN_KEY, **common)
    worst = int(np.argmax(rms / evidence.forecast))
    limit = times * min(float(evidence.forecast[worst]), clean) + 1e-9
    sentence = (
        f"through the triangles light leaves {mrad_text(rms[worst])} rms from where the exact surfaces"
        f" send it (cell {evidence.cells[worst]}, worst of {len(rms)}); its facets' slopes forecast"
        f" {mrad_text(evidence.forecast[worst], unit='')}"
    )
    check = FAITHFUL_RMS.judge(
        float(rms[worst]),
        limit,
        sentence,
        bundle=bundle_text,
        limit_source=derived(f"{times:g} × forecast of its slope errors"),
        detail={"by_cell": rms, "cells": evidence.cells, "lost": lost, "law_rms": evidence.law_rms},
        **common,
    )
    if max(lost) > LOST:
        text = (
            f"{percent_text(max(lost))} of the rays that the design lets through do not get through the"
            " triangles"
        )
        return replace(
            check,
            state="fail",
            sentence=text,
            value=max(lost),
            limit=LOST,
            unit="of the rays, lost",
            limit_source=other(f"fixed: {LOST:g} lost at most"),
        )
    return check


def _fits(
    asked: Inspection,
    window: Window,
    gathered: CellFacets,
    held: tuple[FacetBody, ...],
    present: Sequence[str] | None,
) -> tuple[Law | None, Law | None, int]:
    """Laws fitted through the file's triangles and through the design with the same triangles, and the
    common ray count.

    Both fits use the same rays. Facets alone bias a fit by about the inverse square of their number per side;
    both fits share that bias.
    """
    spec = asked.design.check
    angle = max(spec.field, FIT_FIELD * min(half_field(thin_cells(window))))
    one = seen_cell(window, gathered.cells[0])
    lit = one.placed(bundle(one.like, asked.rays, angle, spec.field_centre))
    seen = trace_facets(held, lit.rays)
    ideal = trace_facets(telescopelet(window, gathered, 0, present, onto_design=True), lit.rays)
    law = RequestedLaw(one.like.law)
    found = Comparison(Light(lit, seen, law), Light(lit, ideal, law), LEAST_FITTED)
    return *(found.laws or (None, None)), int(found.both.sum())


def _faithful_fit(asked: Inspection, evidence: MeshEvidence, passed: int) -> list[Check]:
    """η and δ fitted through the file's triangles, against the design's own cut, by `passed` common rays."""
    law, exact, spec = evidence.law, evidence.law_design, asked.design.check
    kinds = (FAITHFUL_ETA, FAITHFUL_DELTA)
    if 0 < passed < LEAST_FITTED:
        needed = rays_for(LEAST_FITTED, passed / asked.rays)
        why = (
            f"not enough rays: of {asked.rays} {passed} get through the file's triangles, and a fit of the"
            f" law takes {LEAST_FITTED}; --rays {needed} would do"
        )
        return [kind.not_run(why, detail={RAYS_NEEDED: needed}, **asked.common) for kind in kinds]
    if law is None or exact is None:
        why = "no law can be fitted to the light that gets through the file's triangles"
        return [kind.not_run(why, **asked.common) for kind in kinds]
    text = (
        "through the file's triangles {0} = {1:.6g}, {2:.6g}; through the design cut into the same triangles"
        " {3:.6g}, {4:.6g}"
    )
    checks = fit_checks(kinds, (law, exact), (spec.eta, spec.delta), text, **asked.common)
    return [replace(check, detail={"measured": check.detail["measured"]}) for check in checks]
