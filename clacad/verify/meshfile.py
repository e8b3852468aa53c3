"""Judge one mesh file: is it whole, is it the design, and does light through its triangles do what it should?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.export.closed import Measure, crowded_edges, measure
from clacad.export.filemesh import FileMesh, Part
from clacad.export.truth import Integral, body_volume, whole_extent
from clacad.feasibility import body_facts, body_range, components
from clacad.law import Law, angle_between
from clacad.rays import Fate
from clacad.sheet import Body, Window
from clacad.trace import trace
from clacad.verify.bundle import Bundle, bundle, launched
from clacad.verify.checks import Check, State, judge, not_run
from clacad.verify.deviation import FEWER, POINTS, Deviation, corner_distance, deviation, forecast_rms
from clacad.verify.facets import Floats, trace_facets
from clacad.verify.gather import (
    Gathered,
    Gatherer,
    Progress,
    chosen_cells,
    exact_height,
    on_land,
    owner,
    telescopelet,
)
from clacad.vignetting import half_field, thin_cells

if TYPE_CHECKING:
    from clacad.design import Design

COUNTED_FACETS = 3_000_000
"""Facets up to which edges, pieces and holes are counted one by one; beyond it closedness alone is proven."""

CELL_RAYS = 4096
LOST = 0.2
"""Share of the design's ALIVE rays that may get lost in the file before that is a failure."""

FIT_FIELD = 0.35
"""Cone of the fit through facets over the half field of view: wide, so that facets average out."""


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


def judge_mesh(
    design: Design, window: Window, mesh: FileMesh, factor: float, name: str, stated: Mapping[str, Any], rays: int,
    progress: Progress, present: Sequence[str] | None = None,
) -> tuple[list[Check], MeshEvidence]:  # fmt: skip
    """Measure a mesh file in one pass and judge it.

    Parameters
    ----------
    design : Design
    window : Window
        With the cells that were written.
    mesh : FileMesh
    factor : float
        Design units per file unit.
    name : str
        File name, the subject of the checks.
    stated : mapping
        Entry of the manifest; empty without one.
    rays : int
    progress : callable
        (stage, done 0 … 1).
    present : names of the bodies in the file, or None for all
        Light meets the others as the design has them.
    """
    held = held_part(window, present)
    gatherer = Gatherer(window, chosen_cells(window))
    found = measure(_looked_at(mesh, factor, gatherer, progress), origin=np.zeros(3))
    gathered = gatherer.result
    checks = [_closed(found, gathered, mesh, name), scale_check(design, held, found, name)]
    checks += _pieces(held, found, mesh, name, stated)
    checks.append(_volume(held, chord_volume(window, gathered, 0), found, gathered, name, stated))
    off = [
        deviation(window, telescopelet(window, gathered, k, present), FEWER if k else POINTS)
        for k in range(len(gathered.cells))
    ]
    checks.append(_shape(design, window, gathered, off, name, stated, present))
    light, evidence = _light(design, window, gathered, off, found, name, rays, progress, present)
    return checks + light, evidence


def held_part(window: Window, present: Sequence[str] | None) -> Window:
    """The window reduced to the bodies a file holds, its height range too."""
    if present is None or set(present) == {body.name for body in window.bodies}:
        return window
    bodies = tuple(b for b in window.bodies if b.name in present)
    low, high = zip(*(body_range(window, body) for body in bodies), strict=True)
    return replace(window, bodies=bodies, z_range=(min(low), max(high)))


def _looked_at(mesh: FileMesh, factor: float, gatherer: Gatherer, progress: Progress) -> Iterator[Floats]:
    total, done = max(1, mesh.facet_count), 0
    for chunk in mesh.chunks():
        corners = chunk * factor
        gatherer.look(corners)
        done += len(corners)
        progress("reading triangles", done / total)
        yield corners


# -- whole --------------------------------------------------------------------------------------


def _closed(found: Measure, gathered: Gathered, mesh: FileMesh, name: str) -> Check:
    common: dict[str, Any] = {"where": "file", "subject": name, "limit": 0.0}
    if found.facets == 0:
        return Check("closed", "fail", "the file holds no triangles", **common)
    facts = {"facets": found.facets, "walls": gathered.walls, "degenerate": gathered.degenerate}
    if found.closed:
        sentence = f"every edge of {found.facets} facets is met once in each direction"
        if found.facets <= COUNTED_FACETS:
            crowded = sum(crowded_edges(part.corners(0, part.facet_count)) for part in mesh.parts)
            facts["crowded_edges"] = crowded
            if crowded:
                sentence += (
                    f"; {crowded} edges are shared by four facets, where steps of both signs meet in a corner"
                )
        return Check("closed", "pass", sentence, 0.0, detail=facts, **common)
    sentence = "the surface is not closed or not consistently wound"
    value = None
    if found.facets <= COUNTED_FACETS:
        value, place = _open_edges(np.concatenate(list(mesh.chunks())))
        at = ", ".join(f"{v:.6g}" for v in place)
        sentence += f": {value} edges have no partner, one at ({at}) in file units"
    return Check("closed", "fail", sentence, value, detail=facts, **common)


def _welded(corners: Floats) -> tuple[Floats, np.ndarray[Any, np.dtype[np.int64]]]:
    """Vertices that agree in all bits made one: (v, 3) and facets (t, 3)."""
    words = np.ascontiguousarray(corners.reshape(-1, 3) + 0.0).view([("", np.uint64, 3)]).ravel()
    unique, index = np.unique(words, return_inverse=True)
    return unique.view(np.float64).reshape(-1, 3), index.reshape(-1, 3).astype(np.int64)


def _open_edges(corners: Floats) -> tuple[int, Floats]:
    """Count directed edges without a partner, and give the middle of one."""
    vertices, facets = _welded(corners)
    start = facets.ravel()
    end = np.roll(facets, -1, axis=1).ravel()
    size = np.int64(len(vertices))
    forward, times = np.unique(start * size + end, return_counts=True)
    backward, answers = np.unique(end * size + start, return_counts=True)
    both = np.concatenate([forward, backward])
    sign = np.concatenate([times, -answers])
    keys, place = np.unique(both, return_inverse=True)
    balance = np.bincount(place, weights=sign)
    open_keys = keys[balance != 0]
    if not len(open_keys):
        return 0, np.zeros(3)
    a, b = divmod(int(open_keys[0]), int(size))
    # an unmatched edge shows once from each of its ends
    return int(np.abs(balance).sum() / 2), 0.5 * (vertices[a] + vertices[b])


def _pieces(
    window: Window, found: Measure, mesh: FileMesh, name: str, stated: Mapping[str, Any]
) -> list[Check]:
    """Count connected pieces and holes of the file itself."""
    common: dict[str, Any] = {"where": "file", "subject": name, "relation": "=", "required": False}
    if found.facets > COUNTED_FACETS or found.facets == 0:
        why = f"{found.facets} facets: pieces are counted up to {COUNTED_FACETS}; one_piece says what the design gives"
        return [not_run("pieces", why, **common)]
    bodies = [body_facts(window, body) for body in window.bodies]
    expected = {sum(b.pieces for b in bodies), len(bodies) * window.lattice.cell_count}
    if "solids" in stated:
        expected = {int(stated["solids"])}
    counts = [_counted(part) for part in mesh.parts]
    pieces, holes = (sum(count[k] for count in counts) for k in (0, 1))
    wanted = " or ".join(str(n) for n in sorted(expected))
    sentence = f"{pieces} connected pieces with {holes:g} holes; {wanted} pieces are expected"
    state: State = "pass" if pieces in expected else "fail"
    return [Check("pieces", state, sentence, float(pieces), wanted, detail={"holes": holes}, **common)]


def _counted(part: Part) -> tuple[int, float]:
    """Pieces and holes of a part; one that stands at several places is counted at each (its copies may touch)."""
    vertices, facets = _welded(part.corners(0, part.facet_count))
    pieces = components(len(vertices), facets[:, [0, 0]].T.ravel(), facets[:, [1, 2]].T.ravel())
    edges = np.sort(np.concatenate([facets[:, [0, 1]], facets[:, [1, 2]], facets[:, [2, 0]]]), axis=1)
    count = len(np.unique(edges[:, 0] * np.int64(len(vertices)) + edges[:, 1]))
    euler = len(vertices) - count + len(facets)
    times = len(part.placements)
    return pieces * times, (pieces - euler / 2) * times


def scale_check(design: Design, window: Window, found: Measure, name: str) -> Check:
    """Compare the file's extent with the design's, axis by axis."""
    x0, x1, y0, y1 = whole_extent(window)
    z0, z1 = window.z_range
    want = np.array([x1 - x0, y1 - y0, z1 - z0])
    got = np.subtract(found.high, found.low)
    ratio = got / want
    if not np.isfinite(ratio).all() or found.facets == 0:
        return not_run("scale", "the file has no extent", where="file", subject=name)
    # x and y alone tell a uniform shrink; facets cut a little off the top of a lens in z
    lateral = ratio[:2]
    value = float(np.abs(lateral - 1.0).max())
    sentence = "extent over the design's: " + ", ".join(
        f"{axis} {r:.6g}" for axis, r in zip("xyz", ratio, strict=True)
    )
    return judge(
        "scale", value, design.check.scale, sentence, unit="relative", where="file", subject=name,
        detail={"ratio": ratio},
    )  # fmt: skip


# -- the design's shape --------------------------------------------------------------------------


_NODES = np.array([
    [1 / 3, 1 / 3, 1 / 3],
    [0.797426985353087, 0.101286507323456, 0.101286507323456], [0.101286507323456, 0.797426985353087, 0.101286507323456],
    [0.101286507323456, 0.101286507323456, 0.797426985353087], [0.059715871789770, 0.470142064105115, 0.470142064105115],
    [0.470142064105115, 0.059715871789770, 0.470142064105115], [0.470142064105115, 0.470142064105115, 0.059715871789770],
])  # fmt: skip
_WEIGHTS = np.array([0.225] + [0.125939180544827] * 3 + [0.132394152788506] * 3)
"""Seven-point rule of degree 5 on a triangle (Radon 1948)."""


def chord_volume(window: Window, gathered: Gathered, cell: int) -> float:
    """Volume (length³) that the facets over one chosen cell add to the exact body; negative for convex lenses."""
    total = 0.0
    for number, body in enumerate(window.bodies):
        for side, face in enumerate((body.front, body.back)):
            facets = gathered.corners(number, side, cell)
            if face.array is None or not len(facets):
                continue
            shift = np.asarray(window.shifts[owner(body, face)])
            centre = window.lattice.centres(np.array([gathered.cells[cell]], dtype=np.int64))[0] + shift
            local = facets - [*centre, 0.0]
            points = np.einsum("pk,tkx->tpx", _NODES, local)
            exact = exact_height(face, on_land(window, face, facets), points)
            known = np.isfinite(exact).all(axis=1)
            (ax, ay), (bx, by) = ((local[known, k, :2] - local[known, 0, :2]).T for k in (1, 2))
            area = 0.5 * np.abs(ax * by - ay * bx)
            above = ((points[known, :, 2] - exact[known]) @ _WEIGHTS) * area
            total += float(above.sum()) * (-1.0 if side == 0 else 1.0)
    return total


@lru_cache(maxsize=8)
def volume_of(window: Window, body: Body) -> Integral | None:
    """Volume of a body by quadrature, once for all files of a window; None where an outline cuts lenslets."""
    return body_volume(window, body, depth=11)


def _volume(
    window: Window,
    cell_chord: float,
    found: Measure,
    gathered: Gathered,
    name: str,
    stated: Mapping[str, Any],
) -> Check:
    """Enclosed volume against quadrature of the design plus what facets cut off."""
    common: dict[str, Any] = {"where": "file", "subject": name, "unit": "design unit³"}
    integrals = [volume_of(window, body) for body in window.bodies]
    known = [i for i in integrals if i is not None]
    if len(known) < len(integrals):
        return not_run("volume", "the outline cuts through lenslets; no integral of the design is at hand", required=False, **common)  # fmt: skip
    if found.facets and found.volume <= 0.0:
        return Check("volume", "fail", f"it encloses {found.volume:.4g}: its facets face inwards", found.volume, 0.0,
                     relation=">=", **common)  # fmt: skip
    if not any(gathered.facets):
        return not_run("volume", "no triangles lie where the design has its cells", **common)
    exact, error = sum(i.value for i in known), sum(i.error for i in known)
    chord = cell_chord * window.lattice.cell_count
    difference = found.volume - exact
    # 2 % of what the facets cut off, and float32 corners: half a spacing on each side of the box
    room = 0.02 * abs(chord) + 4.0 * 2.0**-24 * exact + error
    sentence = (
        f"it encloses {found.volume:.9g}; the design {exact:.9g}, of which the facets cut off {-chord:.4g} "
        f"(difference {difference:.4g})"
    )
    return judge(
        "volume", abs(difference - chord), room, sentence, source="forecast ± 2 % of the chord error",
        detail={"volume": found.volume, "exact": exact, "chord": chord, "stated": stated.get("volume")}, **common,
    )  # fmt: skip


def _shape(
    design: Design, window: Window, gathered: Gathered, off: Sequence[Deviation], name: str,
    stated: Mapping[str, Any], present: Sequence[str] | None,
) -> Check:  # fmt: skip
    """Distance of the facets from the exact faces, over the chosen cells."""
    common: dict[str, Any] = {"where": "file", "subject": name, "unit": design.unit}
    if not all(d.complete for d in off):
        dark = [str(c) for c, d in zip(gathered.cells, off, strict=True) if not d.complete]
        if len(dark) == len(off):
            return not_run("shape", "no triangles lie where the design has its faces", **common)
        return Check("shape", "fail", f"faces of the cells {', '.join(dark)} lack triangles", None, **common)
    worst = float(max(d.distance.max() for d in off))
    at_corners = max(_corners(window, gathered, k, present) for k in range(len(off)))
    rms = float(np.max([d.slope_rms.max() for d in off]))
    detail: dict[str, Any] = {"distance": worst, "corners": at_corners, "slope_error": off[0].slope_rms}
    reach = max(abs(v) for v in (*whole_extent(window), *window.z_range))
    rounding = reach * 2.0**-24 * 12.0  # corners rounded to float32, on slopes
    if "sag_error_max" in stated:
        limit = (
            design.check.shape * float(stated["sag_error_max"]) * _millimetres(stated) / window.unit
            + rounding
        )
        source = "stated sag error of the file"
    else:
        limit = design.check.shape * own_sag_error(gathered) + rounding
        source = "what facets of this size and bend give"
    sentence = (
        f"facets lie up to {worst:.4g} {design.unit} off the exact faces, their corners up to {at_corners:.4g}; their "
        f"slopes are {1e3 * rms:.4g} mrad rms off on the worst face"
    )
    if "slope_error_rms" in stated:
        told = float(stated["slope_error_rms"])
        sentence += f" ({1e3 * told:.4g} stated)"
        if rms > design.check.file_rms * told:
            return Check("shape", "fail", f"{sentence}: steeper facets than stated", rms, told, detail=detail,
                         source="stated slope error of the file", **{**common, "unit": "rad"})  # fmt: skip
    return judge("shape", max(worst, at_corners), limit, sentence, source=source, detail=detail, **common)


def _corners(window: Window, gathered: Gathered, cell: int, present: Sequence[str] | None) -> float:
    """Largest distance of any corner of a chosen cell's facets from the design's faces."""
    centre = window.lattice.centres(np.array([gathered.cells[cell]], dtype=np.int64))[0]
    found = [0.0]
    for number, body in enumerate(window.bodies):
        if present is not None and body.name not in present:
            continue
        for side, face in enumerate((body.front, body.back)):
            corners = gathered.corners(number, side, cell)
            if len(corners):
                place = centre + np.asarray(window.shifts[owner(body, face)])
                found.append(corner_distance(window, face, corners, place))
    return float(np.nanmax(found))


def _millimetres(stated: Mapping[str, Any]) -> float:
    return {"mm": 1e-3, "m": 1.0, "um": 1e-6, "cm": 1e-2, "in": 0.0254}[str(stated.get("unit", "mm"))]


def own_sag_error(gathered: Gathered) -> float:
    """Sag error (length) that facets of this size and bend make, from the facets alone: the height of the
    middle of the longest edge over the chord, L² × bend/8, with the bend from neighbouring facets' slopes.
    """
    worst = 0.0
    for (_, _, cell), parts in gathered.facets.items():
        if cell:
            continue
        corners = np.concatenate(parts)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        slopes = normal[:, :2] / normal[:, 2:]
        middle = corners.mean(axis=1)[:, :2]
        if len(corners) < 8:
            continue
        design = np.column_stack([middle - middle.mean(axis=0), np.ones(len(middle))])
        bend, *_ = np.linalg.lstsq(design, slopes, rcond=None)
        edges = (corners - np.roll(corners, 1, axis=1))[..., :2].reshape(-1, 2)
        rise = np.abs(np.einsum("ei,ij,ej->e", edges, bend[:2], edges)) / 8.0
        worst = max(worst, float(rise.max()))
    return worst


# -- light ----------------------------------------------------------------------------------------


def _light(
    design: Design, window: Window, gathered: Gathered, off: Sequence[Deviation], found: Measure, name: str, rays: int,
    progress: Progress, present: Sequence[str] | None,
) -> tuple[list[Check], MeshEvidence]:  # fmt: skip
    """Trace the same rays through the file's triangles and through the exact surfaces."""
    common: dict[str, Any] = {"where": "file", "subject": name}
    field_angle = design.check.field
    main = bundle(window, rays, field_angle, design.check.field_centre)
    truth = trace(window, main.rays)
    rms, lost, law_rms = [], [], np.nan
    for number, cell in enumerate(gathered.cells):
        progress("tracing the triangles", number / len(gathered.cells))
        count = rays if number == 0 else min(rays, CELL_RAYS)
        lit = _moved(window, main, cell, count)
        seen = trace_facets(telescopelet(window, gathered, number, present), lit.rays)
        good = truth.fate[:count] == Fate.ALIVE
        both = good & (seen.fate == Fate.ALIVE)
        error = angle_between(seen.direction[both], truth.direction[:count][both])
        rms.append(float(np.sqrt(np.mean(error**2))) if both.any() else np.nan)
        lost.append(1.0 - both.sum() / max(1, good.sum()))
        if number == 0 and both.any():
            asked = window.law.refract(lit.rays.direction[both])
            law_rms = float(np.sqrt(np.mean(angle_between(seen.direction[both], asked) ** 2)))
    law, exact = _fits(design, window, gathered, rays, present)
    forecasts = np.array([forecast_rms(window, d) for d in off])
    evidence = MeshEvidence(
        found, gathered.cells, np.array(rms), law_rms, forecasts, off[0].slope_rms, law, exact, {"lost": lost}
    )
    checks = [_file_rms(design, evidence, lost, str(main), common)]
    checks += _file_fit(design, evidence, common)
    limit = design.check.mesh_law_rms
    if limit is not None:
        checks.append(
            judge("file_law_rms", law_rms, limit, f"through the triangles light is {1e3 * law_rms:.4g} mrad rms off the law",
                  unit="rad", bundle=str(main), source="design file", **common)
        )  # fmt: skip
    return checks, evidence


def _moved(window: Window, main: Bundle, cell: tuple[int, int], count: int) -> Bundle:
    """The first rays of a bundle, over another cell."""
    return launched(window, main.points[:count], main.rays.direction[:count], cell, main.middle, main.field)


def _file_rms(
    design: Design, evidence: MeshEvidence, lost: list[float], bundle_text: str, common: Mapping[str, Any]
) -> Check:
    rms = evidence.rms
    if np.isnan(rms).any() or not np.isfinite(evidence.forecast).all():
        dark = [str(c) for c, r in zip(evidence.cells, rms, strict=True) if np.isnan(r)]
        if np.isnan(rms).all():
            return not_run("file_rms", "no ray gets through the file's triangles", unit="rad", **common)
        return Check(
            "file_rms", "fail", f"no ray gets through the triangles over the cells {', '.join(dark)}", None,
            unit="rad", bundle=bundle_text, **common,
        )  # fmt: skip
    worst = int(np.argmax(rms / evidence.forecast))
    limit = design.check.file_rms * float(evidence.forecast[worst]) + 1e-9
    sentence = (
        f"through the triangles light leaves {1e3 * rms[worst]:.4g} mrad rms from where the exact surfaces send it "
        f"(cell {evidence.cells[worst]}, worst of {len(rms)}); its facets' slopes forecast {1e3 * evidence.forecast[worst]:.4g}"
    )
    check = judge(
        "file_rms", float(rms[worst]), limit, sentence, unit="rad", bundle=bundle_text,
        source=f"{design.check.file_rms:g} × forecast of its slope errors",
        detail={"by_cell": rms, "cells": evidence.cells, "lost": lost, "law_rms": evidence.law_rms}, **common,
    )  # fmt: skip
    if max(lost) > LOST:
        text = f"{100 * max(lost):.3g} % of the rays that the design lets through do not get through the triangles"
        return Check(
            **{
                **{n: getattr(check, n) for n in Check.__dataclass_fields__},
                "state": "fail",
                "sentence": text,
            }
        )
    return check


def _fits(
    design: Design, window: Window, gathered: Gathered, rays: int, present: Sequence[str] | None
) -> tuple[Law | None, Law | None]:
    """Fit the law through the triangles, and through the design cut into the same triangles, with the same rays.

    Facets alone bias a fit by about the inverse square of their number a side; both sides share that.
    """
    angle = max(design.check.field, FIT_FIELD * min(half_field(thin_cells(window))))
    lit = bundle(window, rays, angle, design.check.field_centre)
    seen = trace_facets(telescopelet(window, gathered, 0, present), lit.rays)
    ideal = trace_facets(telescopelet(window, gathered, 0, present, onto_design=True), lit.rays)
    both = (ideal.fate == Fate.ALIVE) & (seen.fate == Fate.ALIVE)
    if both.sum() < 1024:
        return None, None
    into = lit.rays.direction[both]
    try:
        laws = [Law.fit(into, result.direction[both], axes=window.law).law for result in (seen, ideal)]
    except ValueError:  # light that leaves without depending on how it came
        return None, None
    return laws[0], laws[1]


def _file_fit(design: Design, evidence: MeshEvidence, common: Mapping[str, Any]) -> list[Check]:
    law, exact = evidence.law, evidence.law_design
    if law is None or exact is None:
        why = "too few rays get through the file's triangles to fit a law"
        return [not_run(name, why, **common) for name in ("file_eta", "file_delta")]
    eta = max(abs(law.eta_x / exact.eta_x - 1.0), abs(law.eta_y / exact.eta_y - 1.0))
    delta = max(abs(law.delta_x - exact.delta_x), abs(law.delta_y - exact.delta_y))
    text = "through the file's triangles {0} = {1:.6g}, {2:.6g}; through the design cut into the same triangles {3:.6g}, {4:.6g}"
    return [
        judge("file_eta", eta, design.check.eta, text.format("eta", law.eta_x, law.eta_y, exact.eta_x, exact.eta_y),
              unit="relative", source="eta", detail={"measured": (law.eta_x, law.eta_y)}, **common),
        judge("file_delta", delta, design.check.delta,
              text.format("delta", law.delta_x, law.delta_y, exact.delta_x, exact.delta_y), unit="slope",
              source="delta", detail={"measured": (law.delta_x, law.delta_y)}, **common),
    ]  # fmt: skip
