"""Convergence of light through facets to the exact surfaces, compared with the order that physics predicts.

Curves of a report: exit slope against incident slope, along the two lens meridians.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats, Progress
from clacad.checks.check import Check, derived
from clacad.checks.file_kinds import CONVERGENCE
from clacad.exporting.formats.registry import formats
from clacad.exporting.light_forecast import Grader
from clacad.exporting.limits import size_text
from clacad.exporting.quads_and_roles import Needed, masters
from clacad.exporting.tessellations import Meshes
from clacad.judging.cell_triangles import Gatherer, telescopelet
from clacad.light.compare import Comparison, rms_between
from clacad.light.measure import Light, measure
from clacad.optics.law import difference_of_laws
from clacad.optics.rays import Fate, TraceResult
from clacad.sheet.bundle import Bundle, RequestedLaw, bundle, launched, middle_direction
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.vignetting import half_field, share, thin_cells
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
"""Allowed orders: the direction error is first order in the facet size; the mean slope, and so eta, is
second order."""


@dataclass(frozen=True, eq=False)
class Convergence:
    """Errors compared with the exact surfaces at several refinements, same rays.

    quads : (k,) ints
    direction : (k,) radians, rms
    fitted : (k,), relative error of the fitted eta
    order_direction, order_fitted : float
        Fitted exponents of the facet size.
    masters : mapping
        Format → the facets and bytes at which light through such a file meets the design's limits; empty if
        none.
    law_rms : float, radians
        The rms limit of that light.
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
    from clacad.mesh import tessellate

    one = window.with_cells((1, 1))
    angle = max(design.check.field, FIT_FIELD * min(half_field(thin_cells(window))))
    law = RequestedLaw(window.law)
    lit = bundle(one, RAYS, angle, design.check.field_centre)
    truth = Light(lit, trace(one, lit.rays, path="size"), law)
    errors, etas = [], []
    for k, number in enumerate(quads):
        progress("refining facets", k / len(quads))
        gatherer = Gatherer(one, [(0, 0)])
        for body in tessellate(one, quads=number).bodies:
            for rows in body.rows():
                gatherer.look(np.asarray(rows, dtype=np.float64))
        seen = Light(lit, trace_facets(telescopelet(one, gatherer.result, 0), lit.rays), law)
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
        f"{int(q)}: {1e3 * d:.3g} mrad, eta {100 * e:.2g} %"
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
    limit = f"{1e3 * found.law_rms:.3g} mrad rms"
    if not found.masters:
        return f"no mesh of up to 1024 quads is a master (light within {limit} of the law)"
    quads = next(iter(found.masters.values())).quads
    files = ", ".join(
        f"{name} {size_text(one.bytes)}{'' if one.fits else ' (beyond the limits of export)'}"
        for name, one in found.masters.items()
    )
    return f"a mesh is a master (light within {limit} of the law) from {quads} quads a side: {files}"


DIRECTIONS = 49
PLACES = 768
MAP = 61
"""Positions across the cell, and directions, of the residual map."""


@dataclass(frozen=True, eq=False)
class Meridian:
    """Curves of one lens meridian over the whole field of view.

    slope : (k,) incident slopes along the lens axis, the other slope at the middle of the field
    law, mean, spread : (k,) exit slopes: the law's, the mean of the ALIVE rays, and the rms of those about it
    alive, closed_form, ghost : (k,) shares of light
    place : (m,) lengths across the cell, map_slope : (m,) slopes, residual : (m, m) radians
        Error of single rays in the meridian's plane, [direction, position]; NaN where the ray is not ALIVE.
    """

    slope: Floats
    law: Floats
    mean: Floats
    spread: Floats
    alive: Floats
    closed_form: Floats
    ghost: Floats
    place: Floats
    map_slope: Floats
    residual: Floats


def meridians(window: Window, send: Callable[[Bundle], TraceResult]) -> tuple[Meridian, Meridian]:
    """Trace fans of directions along lens x and lens y, each over the whole cell."""
    return _meridian(window, send, 0), _meridian(window, send, 1)


def _directions(window: Window, axis: int, slopes: Floats) -> Floats:
    """Directions (k, 3) whose slope along a lens axis is `slopes` off the middle of the field."""
    turn = window.thin.rotation
    cells = thin_cells(window)
    middle = cells.slopes(middle_direction(window)[None])[0]
    local = np.column_stack([np.tile(middle, (len(slopes), 1)), np.ones(len(slopes))])
    local[:, axis] += slopes
    found = local @ turn.T
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def _meridian(window: Window, send: Callable[[Bundle], TraceResult], axis: int) -> Meridian:
    """The curves along lens x (axis 0) or lens y (1)."""
    cells, cell = thin_cells(window), central_cell(window)
    reach = min(half_field(cells)[axis], 1.0)
    offsets = np.linspace(-reach, reach, DIRECTIONS)
    direction = _directions(window, axis, offsets)
    places = window.lattice.over_cell(sobol(PLACES, 2))
    every, middle = np.repeat(direction, PLACES, axis=0), direction[DIRECTIONS // 2]
    result = send(launched(window, np.tile(places, (DIRECTIONS, 1)), every, cell, middle))
    fate = result.fate.reshape(DIRECTIONS, PLACES)
    alive = fate == Fate.ALIVE
    out = cells.slopes(np.where(alive.reshape(-1, 1), result.direction, [0.0, 0.0, 1.0]))[:, axis]
    out = np.where(alive, out.reshape(fate.shape), np.nan)
    enough = alive.sum(axis=1) >= 8
    with np.errstate(invalid="ignore", divide="ignore"):
        count = np.where(enough, alive.sum(axis=1), np.nan)
        mean = np.nansum(out, axis=1) / count
        spread = np.sqrt(np.nansum((out - mean[:, None]) ** 2, axis=1) / count)
    asked = window.law.refract(direction)
    law = np.full(DIRECTIONS, np.nan)
    known = np.isfinite(asked).all(axis=1)
    law[known] = cells.slopes(asked[known])[:, axis]
    place, map_slope, residual = _map(window, send, axis, reach)
    return Meridian(
        slope=cells.slopes(direction)[:, axis],
        law=law,
        mean=mean,
        spread=spread,
        alive=alive.mean(axis=1),
        closed_form=share(cells, direction),
        ghost=(fate == Fate.GHOST).mean(axis=1),
        place=place,
        map_slope=map_slope,
        residual=residual,
    )


def _map(
    window: Window, send: Callable[[Bundle], TraceResult], axis: int, reach: float
) -> tuple[Floats, Floats, Floats]:
    """Error of rays along a line across the cell in a lens meridian, for directions in the same plane."""
    along = window.thin.rotation[:2, axis]
    along = along / np.hypot(*along)
    half = min(window.lattice.half_widths) * 0.98  # a ray at the exact border may enter the neighbour
    place = np.linspace(-half, half, MAP)
    slopes = np.linspace(-reach, reach, MAP)
    direction = _directions(window, axis, slopes)
    lit = launched(
        window,
        np.tile(place[:, None] * along, (MAP, 1)),
        np.repeat(direction, MAP, axis=0),
        central_cell(window),
        direction[MAP // 2],
    )
    error = measure(send, lit, RequestedLaw.of(window)).error
    return place, thin_cells(window).slopes(direction)[:, axis], error.reshape(MAP, MAP)
