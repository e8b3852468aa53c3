"""Is a mesh file the design: its volume, and the distance of its facets from the exact faces?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.export.closed import Measure
from clacad.export.truth import Integral, body_volume, whole_extent
from clacad.sheet import Body, Window
from clacad.trace.facets import Floats, on_land
from clacad.verify.checks import Check, judge, not_run
from clacad.verify.deviation import Deviation, corner_distance
from clacad.verify.gather import Gathered, exact_height, owner

if TYPE_CHECKING:
    from clacad.design import Design

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


def volume_check(
    window: Window,
    reach: float,
    cell_chord: float,
    found: Measure,
    gathered: Gathered,
    name: str,
    stated: Mapping[str, Any],
) -> Check:
    """Enclosed volume against quadrature of the design plus what facets cut off.

    `window` is reduced to the bodies of the file; `reach` is the largest |z| of the whole one, whose float32
    spacing the heights of all its bodies share.
    """
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
    # 2 % of what the facets cut off, and float32 corners: half a spacing on each side of the box, and a plane far
    # from the origin moved by half a spacing as a whole, which is much of a thin body, also where it is alone in its file
    x0, x1, y0, y1 = whole_extent(window)
    planes = 2 * len(window.bodies) * (x1 - x0) * (y1 - y0) * reach
    room = 0.02 * abs(chord) + 2.0**-24 * (4.0 * exact + planes) + error
    sentence = (
        f"it encloses {found.volume:.9g}; the design {exact:.9g}, of which the facets cut off {-chord:.4g} "
        f"(difference {difference:.4g})"
    )
    detail = {"volume": found.volume, "exact": exact, "chord": chord, "stated": stated.get("volume")}
    if gathered.engraved:
        sentence += f"; letters engraved in the border take {gathered.engraved:.4g}"
        detail["engraved"] = gathered.engraved
    return judge(
        "volume", abs(difference + gathered.engraved - chord), room, sentence,
        source="forecast ± 2 % of the chord error", detail=detail, **common,
    )  # fmt: skip


def shape_check(
    design: Design, window: Window, gathered: Gathered, off: Sequence[Deviation], name: str,
    stated: Mapping[str, Any], present: Sequence[str] | None,
) -> Check:  # fmt: skip
    """Distance of the facets from the exact faces: closely over the chosen cells, by their middles over all."""
    common: dict[str, Any] = {"where": "file", "subject": name, "unit": design.unit}
    if not all(d.complete for d in off):
        dark = [str(c) for c, d in zip(gathered.cells, off, strict=True) if not d.complete]
        if len(dark) == len(off):
            return not_run("shape", "no triangles lie where the design has its faces", **common)
        return Check("shape", "fail", f"faces of the cells {', '.join(dark)} lack triangles", None, **common)
    worst = float(max(d.distance.max() for d in off))
    at_corners = max(_corners(window, gathered, k, present) for k in range(len(off)))
    rms = float(np.max([d.slope_rms.max() for d in off]))
    detail: dict[str, Any] = {
        "distance": worst,
        "corners": at_corners,
        "everywhere": gathered.farthest,
        "slope_error": off[0].slope_rms,
    }
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
    if gathered.farthest > max(worst, at_corners):
        where = gathered.farthest_cell
        sentence += f"; over all cells up to {gathered.farthest:.4g}, in cell {where}"
    if "slope_error_rms" in stated:
        told = float(stated["slope_error_rms"])
        sentence += f" ({1e3 * told:.4g} stated)"
        if rms > design.check.file_rms * told:
            return Check("shape", "fail", f"{sentence}: steeper facets than stated", rms, told, detail=detail,
                         source="stated slope error of the file", **{**common, "unit": "rad"})  # fmt: skip
    return judge(
        "shape",
        max(worst, at_corners, gathered.farthest),
        limit,
        sentence,
        source=source,
        detail=detail,
        **common,
    )


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
    """Sag error (length) that facets of this size and bend make, from the facets alone: the height over the chord at
    the middle of an edge, L² × bend/8, or over a facet's middle, which is higher where the facet has no blunt corner;
    with the bend from neighbouring facets' slopes.
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
        bend = _bend(middle, slopes)
        edges = (corners - np.roll(corners, 1, axis=1))[..., :2]
        square = np.einsum("tei,tij,tej->te", edges, bend, edges)
        rise = np.maximum(np.abs(square).max(axis=1) / 8.0, np.abs(square.sum(axis=1)) / 18.0)
        worst = max(worst, float(rise.max()))
    return worst


CUBIC = 48
"""Facets of a cell from which on the bend is told place by place: steep lenses bend more towards their rim."""


def _bend(middle: Floats, slopes: Floats) -> Floats:
    """Second derivatives (t, 2, 2) of the height at facets, from a smooth fit to their slopes (t, 2)."""
    size = float(np.abs(middle - middle.mean(axis=0)).max())
    x, y = ((middle - middle.mean(axis=0)) / size).T
    one, nil = np.ones_like(x), np.zeros_like(x)
    terms = np.stack([one, x, y], axis=1)
    along_x, along_y = np.stack([nil, one, nil], axis=1), np.stack([nil, nil, one], axis=1)
    if len(x) >= CUBIC:
        terms = np.column_stack([terms, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3])
        along_x = np.column_stack([along_x, 2 * x, y, nil, 3 * x * x, 2 * x * y, y * y, nil])
        along_y = np.column_stack([along_y, nil, x, 2 * y, nil, x * x, 2 * x * y, 3 * y * y])
    found, *_ = np.linalg.lstsq(terms, slopes, rcond=None)
    return np.stack([along_x @ found, along_y @ found], axis=1) / size
