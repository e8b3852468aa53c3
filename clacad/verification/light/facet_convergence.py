"""Convergence of light through facets to the exact surfaces, compared with the predicted order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import mrad_text, percent_text, size_text
from clacad.base.types import Floats, Progress
from clacad.checks.check import Check, derived
from clacad.checks.file_kinds import CONVERGENCE
from clacad.exporting.formats.registry import formats
from clacad.exporting.light_forecast import Grader
from clacad.exporting.quads_and_roles import Needed, masters
from clacad.exporting.tessellations import Meshes
from clacad.judging.cell_triangles import own_facets, telescopelet
from clacad.light.compare import Comparison, rms_between
from clacad.light.measure import Light
from clacad.optics.law import difference_of_laws
from clacad.sheet.bundle import RequestedLaw, bundle
from clacad.sheet.vignetting import half_field, thin_cells
from clacad.sheet.window import Window
from clacad.tracing.facets.telescopelet import trace_facets
from clacad.tracing.trace import trace

if TYPE_CHECKING:
    from clacad.design import Design


QUADS = (4, 8, 16, 32)
RAYS = 65536
FIT_FIELD = 0.35


def _mesh_formats() -> list[str]:
    """Mesh formats of the whole sheet: those that repeat cells, then streams, then the others."""
    whole = [one for one in formats() if one.chosen_by_error and one.whole_sheet]
    return [one.word for one in sorted(whole, key=lambda one: (not one.repeats, one.family != "stream"))]


"""Mesh formats for which the size of a master file is reported."""
ORDERS = {"direction": (0.8, 1.2), "eta": (1.5, 3.0)}
"""Allowed orders: first in the facet size for the direction error, second for the mean slope and eta."""


@dataclass(frozen=True, eq=False)
class Convergence:
    """Errors compared with the exact surfaces at several refinements, same rays.

    quads : (k,) ints
    direction : (k,) radians, rms
    fitted : (k,), relative error of the fitted eta
    order_direction, order_fitted : Fitted exponents of the facet size.
    masters : Format → the facets and bytes at which light through such a file meets the design's limits;
        empty if none.
    law_rms : radians. The rms limit of that light.
    """

    quads: Floats
    direction: Floats
    fitted: Floats
    order_direction: float
    order_fitted: float
    masters: Mapping[str, Needed] = field(default_factory=dict)
    law_rms: float = 0.0


def converge(
    design: Design, window: Window, progress: Progress, quads: tuple[int, ...] = QUADS
) -> Convergence:
    """Tessellate one telescopelet at several refinements and trace the same rays through each."""
    one = window.with_cells((1, 1))
    angle = max(design.check.field, FIT_FIELD * min(half_field(thin_cells(window))))
    law = RequestedLaw(window.law)
    lit = bundle(one, RAYS, angle, design.check.field_centre)
    truth = Light(lit, trace(one, lit.rays, path="size"), law)
    errors, etas = [], []
    for k, number in enumerate(quads):
        progress("refining facets", k / len(quads))
        held = telescopelet(one, own_facets(one, number), 0)
        seen = Light(lit, trace_facets(held, lit.rays), law)
        found = Comparison(seen, truth)
        if found.laws is None:
            raise ValueError("too little light gets through the facets to fit a law")
        errors.append(rms_between(seen.direction, truth.direction, found.both))
        etas.append(difference_of_laws(*found.laws)[0])
    size = np.log(1.0 / np.array(quads, dtype=np.float64))
    slopes = [float(np.polyfit(size, np.log(np.maximum(v, 1e-300)), 1)[0]) for v in (errors, etas)]
    grader = Grader.of(Meshes(window), design)
    return Convergence(
        np.array(quads),
        np.array(errors),
        np.array(etas),
        slopes[0],
        slopes[1],
        masters(grader, _mesh_formats()),
        grader.limits.rms,
    )


def judge_convergence(design: Design, window: Window, progress: Progress) -> tuple[Convergence | None, Check]:
    """Measure and judge the convergence; None where too little light passes one telescopelet to fit a law."""
    try:
        found = converge(design, window, progress)
    except ValueError as error:
        return None, convergence_check(None, str(error))
    return found, convergence_check(found)


def convergence_check(found: Convergence | None, why: str = "") -> Check:
    """Judge the fitted order of the direction error; the order of η is reported with it."""
    common: dict[str, Any] = {
        "required": False,
        "bundle": f"{RAYS} Sobol rays, seed 0, the same at every refinement",
        "limit_source": derived("facet slopes err as their size"),
    }
    if found is None:
        return CONVERGENCE.not_run(
            why, unit=CONVERGENCE.unit, relation=CONVERGENCE.relation, where=CONVERGENCE.where, **common
        )
    low, high = ORDERS["direction"]
    row = ", ".join(
        f"{int(q)}: {mrad_text(d, 3)}, eta {percent_text(e, 2)}"
        for q, d, e in zip(found.quads, found.direction, found.fitted, strict=True)
    )
    sentence = (
        f"quads a side: {row}; the direction error falls as the facet size to the power"
        f" {found.order_direction:.2f}, that of eta to the power {found.order_fitted:.2f}"
    )
    sentence += f"; {_masters_text(found)}"
    good = low <= found.order_direction <= high and found.fitted[-1] <= found.fitted[0]
    return CONVERGENCE.check(
        "pass" if good else "fail",
        sentence,
        found.order_direction,
        f"{low:g} … {high:g}",
        detail={
            "quads": found.quads,
            "direction": found.direction,
            "eta": found.fitted,
            "order_eta": found.order_fitted,
            "masters": {name: asdict(one) for name, one in found.masters.items()},
        },
        **common,
    )


def _masters_text(found: Convergence) -> str:
    """Number of quads at which a mesh of this design is a master, and the size of such a file."""
    limit = f"{mrad_text(found.law_rms, 3)} rms"
    if not found.masters:
        return f"no mesh of up to 1024 quads is a master (light within {limit} of the law)"
    quads = next(iter(found.masters.values())).quads
    files = ", ".join(
        f"{name} {size_text(one.bytes)}{'' if one.fits else ' (beyond the limits of export)'}"
        for name, one in found.masters.items()
    )
    return f"a mesh is a master (light within {limit} of the law) from {quads} quads a side: {files}"
