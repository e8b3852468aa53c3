"""Agreement of a mesh file with the design: its volume, the distance of its facets from exact faces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import mrad_text
from clacad.base.types import Floats
from clacad.base.vectors import doubled_normals
from clacad.checks.check import Check, LimitSource, derived, other
from clacad.checks.file_kinds import SHAPE, VOLUME
from clacad.formats.mesh.measure import Measure
from clacad.judging.cell_triangles import CellFacets, exact_height, owner, telescopelet
from clacad.judging.delivery import Inspection
from clacad.judging.face_deviation import FEWER, POINTS, Deviation, corner_distance, deviation, forecast_rms
from clacad.judging.unit_and_cells import UNITS
from clacad.sheet.volume_and_extent import Integral, body_volume, whole_extent
from clacad.sheet.window import Body, Window
from clacad.tracing.facets.telescopelet import on_land

if TYPE_CHECKING:
    from clacad.design import Design


_NODES = np.array(
    [
        [1 / 3, 1 / 3, 1 / 3],
        [0.797426985353087, 0.101286507323456, 0.101286507323456],
        [0.101286507323456, 0.797426985353087, 0.101286507323456],
        [0.101286507323456, 0.101286507323456, 0.797426985353087],
        [0.059715871789770, 0.470142064105115, 0.470142064105115],
        [0.470142064105115, 0.059715871789770, 0.470142064105115],
        [0.470142064105115, 0.470142064105115, 0.059715871789770],
    ]
)
_WEIGHTS = np.array([0.225] + [0.125939180544827] * 3 + [0.132394152788506] * 3)
"""Seven-point rule of degree 5 on a triangle (Radon 1948)."""


def chord_volume(window: Window, gathered: CellFacets, cell: int) -> float:
    """Volume (length³) that the facets of a file add to the exact body, with all cells like the chosen one.

    Negative for convex lenses.
    """
    if not window.uniform:  # no cell represents all: gathered over all of them
        return gathered.chord
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
    return total * window.lattice.cell_count


@lru_cache(maxsize=8)
def volume_of(window: Window, body: Body) -> Integral | None:
    """Volume of a body by quadrature, cached for all files of a window; None if an outline cuts lenslets."""
    return body_volume(window, body, depth=11)


NO_INTEGRAL = "the outline cuts through lenslets; no integral of the design is at hand"


def volume_check(
    asked: Inspection, window: Window, reach: float, chord: float, found: Measure, gathered: CellFacets
) -> Check:
    """Judge the enclosed volume against quadrature of the design plus the chord volume of the facets.

    window : reduced to the bodies of the file
    reach : largest |z| (length) of the whole window, whose float32 spacing the heights of all its bodies
        share
    chord : from `chord_volume` (length³)
    """
    common: dict[str, Any] = {"unit": "design unit³", **asked.common}
    integrals = [volume_of(window, body) for body in window.bodies]
    known = [i for i in integrals if i is not None]
    if len(known) < len(integrals):
        return VOLUME.not_run(NO_INTEGRAL, required=False, **common)
    if found.facets and found.volume <= 0.0:
        why = f"it encloses {found.volume:.4g}: its facets face inwards"
        return VOLUME.check("fail", why, found.volume, 0.0, relation=">=", **common)
    if not any(gathered.facets):
        return VOLUME.not_run("no triangles lie where the design has its cells", **common)
    exact, error = sum(i.value for i in known), sum(i.error for i in known)
    difference = found.volume - exact
    sentence = (
        f"it encloses {found.volume:.9g}; the design {exact:.9g}, of which the facets cut off {-chord:.4g} "
        f"(difference {difference:.4g})"
    )
    detail = {"volume": found.volume, "exact": exact, "chord": chord, "stated": asked.stated.get("volume")}
    if gathered.engraved:
        sentence += f"; letters engraved in the border take {gathered.engraved:.4g}"
        detail["engraved"] = gathered.engraved
    return VOLUME.judge(
        abs(difference + gathered.engraved - chord),
        _volume_room(window, reach, chord, exact) + error,
        sentence,
        limit_source=derived("forecast ± 2 % of the chord error"),
        detail=detail,
        **common,
    )


def _volume_room(window: Window, reach: float, chord: float, exact: float) -> float:
    """Allowed error of a volume (length³): 2 % of the chord volume, and rounding of corners to float32.

    Rounding moves each side of the box by half a spacing. It moves a plane far from the origin as a whole by
    half a spacing, which is a large part of a thin body, also where that body is alone in its file.
    """
    x0, x1, y0, y1 = whole_extent(window)
    planes = 2 * len(window.bodies) * (x1 - x0) * (y1 - y0) * reach
    return 0.02 * abs(chord) + 2.0**-24 * (4.0 * exact + planes)


def shape_check(
    asked: Inspection,
    window: Window,
    gathered: CellFacets,
    off: Sequence[Deviation],
    present: Sequence[str] | None,
) -> Check:
    """Judge the distance of facets from the exact faces: densely over chosen cells, at middles over all."""
    design, stated = asked.design, asked.stated
    common: dict[str, Any] = {"unit": design.unit, **asked.common}
    if not all(d.complete for d in off):
        dark = [str(c) for c, d in zip(gathered.cells, off, strict=True) if not d.complete]
        if len(dark) == len(off):
            return SHAPE.not_run("no triangles lie where the design has its faces", **common)
        return SHAPE.check("fail", f"faces of the cells {', '.join(dark)} lack triangles", None, **common)
    # a copy of another cell has the deviation of that cell
    own = [k for k in range(len(off)) if gathered.source(k) == k]
    clean = [clean_cut(window, gathered, k, present) for k in own]
    at_corners = max(_corners(window, gathered, k, present) for k in own)
    detail, sentence = _shape_words(asked, gathered, off, clean[0], at_corners)
    common |= {"detail": detail}
    slopes = _slope_faults(asked, window, gathered, off, dict(zip(own, clean, strict=True)))
    if "slope_error_rms" in stated:
        sentence += f" ({mrad_text(float(stated['slope_error_rms']), unit='')} stated)"
    if slopes is not None:
        words, value, limit, source = slopes
        common["unit"] = "rad"
        return SHAPE.check("fail", sentence + words, value, limit, limit_source=source, **common)
    sag = float(max(d.distance.max() for d in clean))
    limit, source = _shape_limit(asked, window, sag)
    worst = max(detail["distance"], at_corners, gathered.farthest)
    return SHAPE.judge(worst, limit, sentence, limit_source=source, **common)


def _shape_words(
    asked: Inspection, gathered: CellFacets, off: Sequence[Deviation], clean: Deviation, at_corners: float
) -> tuple[dict[str, Any], str]:
    """Numbers of the shape, and a sentence that names them."""
    worst = float(max(d.distance.max() for d in off))
    rms = float(np.max([d.slope_rms.max() for d in off]))
    detail: dict[str, Any] = {
        "distance": worst,
        "corners": at_corners,
        "everywhere": gathered.farthest,
        "slope_error": off[0].slope_rms,
        "slope_error_clean": clean.slope_rms,
    }
    sentence = (
        f"facets lie up to {worst:.4g} {asked.design.unit} off the exact faces, their corners up to"
        f" {at_corners:.4g}; their slopes are {mrad_text(rms)} rms off on the worst face"
    )
    if gathered.farthest > max(worst, at_corners):
        where = gathered.farthest_cell
        sentence += f"; over all cells up to {gathered.farthest:.4g}, in cell {where}"
    return detail, sentence


def _shape_limit(asked: Inspection, window: Window, sag: float) -> tuple[float, LimitSource]:
    """Allowed distance of facets that would be off by `sag` (length) with corners on the design."""
    spec, stated = asked.design.check, asked.stated
    reach = max(abs(v) for v in (*whole_extent(window), *window.z_range))
    rounding = reach * 2.0**-24 * 12.0  # corners rounded to float32, on slopes
    if "sag_error_max" in stated:
        told = float(stated["sag_error_max"]) * UNITS.get(str(stated.get("unit", "mm")), 1e-3) / window.unit
        if told <= spec.file_rms * sag:  # a larger stated error promises nothing
            return spec.shape * told + rounding, derived("stated sag error of the file")
    return spec.shape * sag + rounding, other("the design cut into the same facets")


def _slope_faults(
    asked: Inspection,
    window: Window,
    gathered: CellFacets,
    off: Sequence[Deviation],
    clean: Mapping[int, Deviation],
) -> tuple[str, float, float, LimitSource] | None:
    """Text of a fault in the facets' slopes, with value and limit (radians); None without a fault.

    clean : the design with the facets of a cell, by the cell's number
    """
    rms = float(np.max([d.slope_rms.max() for d in off]))
    if "slope_error_rms" in asked.stated:
        told = float(asked.stated["slope_error_rms"])
        if rms > asked.design.check.file_rms * told:
            return ": steeper facets than stated", rms, told, derived("stated slope error of the file")
    rough, room = _roughness(asked.design, window, gathered, off, clean)
    if rough <= room:
        return None
    least = float(np.max([d.slope_rms.max() for d in clean.values()]))
    words = (
        f": {mrad_text(rough)} rms from those of the design cut into the same facets, which are "
        f"{mrad_text(least, unit='')} off"
    )
    return words, rough, room, other("slope error of the design cut into the same facets")


def clean_cut(
    window: Window, gathered: CellFacets, cell: int, present: Sequence[str] | None = None
) -> Deviation:
    """Unavoidable deviation of a file's facets: that of the design with the same facets.

    Every corner over a chosen cell is moved along z onto the design's face; the points are those of
    `deviation`.
    """
    bodies = telescopelet(window, gathered, cell, present, onto_design=True)
    return deviation(gathered.alike(window, cell)[0], bodies, FEWER if cell else POINTS)


def clean_forecast(
    window: Window, gathered: CellFacets, cell: int, present: Sequence[str] | None = None
) -> float:
    """Direction error (radians) of a file's facets over a chosen cell with corners on the design's faces.

    It is the `forecast_rms` of the clean cut, which noise in the file's heights cannot widen.
    """
    return forecast_rms(window, clean_cut(window, gathered, cell, present))


def _roughness(
    design: Design,
    window: Window,
    gathered: CellFacets,
    off: Sequence[Deviation],
    clean: Mapping[int, Deviation],
) -> tuple[float, float]:
    """Rms (radians) of the slope differences between a file's facets and the clean cut, and its limit.

    Both are of the face and cell that come nearest to their limit. The slope error of the clean cut is e.
    The limit
    is e (check.file_rms − 1) plus rounding to float32, so that in the worst case the sum is check.file_rms e.
    """
    found = (0.0, np.inf)
    for number, ideal in clean.items():
        apart = off[number].slope - ideal.slope
        for face, (body, side) in enumerate((b, s) for b in range(len(window.bodies)) for s in (0, 1)):
            known = np.isfinite(apart[face]).all(axis=1)
            if not known.any():
                continue
            rms = float(np.sqrt((apart[face][known] ** 2).sum(axis=1).mean()))
            room = (design.check.file_rms - 1.0) * float(ideal.slope_rms[face])
            room += _rounding_slope(window, gathered.corners(body, side, number))
            if rms * found[1] > found[0] * room or found[1] == np.inf:
                found = rms, room
    return found


def _rounding_slope(window: Window, corners: Floats) -> float:
    """Rms slope error (radians) of facets (k, 3, 3) whose coordinates are rounded to float32."""
    (ax, ay), (bx, by) = ((corners[:, k, :2] - corners[:, 0, :2]).T for k in (1, 2))
    twice = np.abs(ax * by - ay * bx)
    edges = np.linalg.norm((np.roll(corners, -1, axis=1) - corners)[..., :2], axis=2).max(axis=1, initial=0.0)
    good = twice > 1e-12 * edges**2
    if not good.any():
        return 0.0
    normal = doubled_normals(corners[good])
    steep = np.linalg.norm(normal[:, :2], axis=1) / np.maximum(np.abs(normal[:, 2]), 1e-300)
    off = 2.0**-24 * (np.abs(window.z_range).max() + steep * max(abs(v) for v in whole_extent(window)))
    slope = (
        2.0 * off * edges[good] / twice[good]
    )  # two corners off in opposite senses, over the facet's least height
    return float(np.sqrt((slope**2 * twice[good]).sum() / twice[good].sum()))


def _corners(window: Window, gathered: CellFacets, cell: int, present: Sequence[str] | None) -> float:
    """Largest distance of any corner of a chosen cell's facets from the design's faces."""
    window, index = gathered.alike(window, cell)
    found = [0.0]
    for number, body in enumerate(window.bodies):
        if present is not None and body.name not in present:
            continue
        for side, face in enumerate((body.front, body.back)):
            corners = gathered.corners(number, side, cell)
            if len(corners):
                found.append(corner_distance(window, face, corners, window.centres(owner(body, face), index)))
    return float(np.nanmax(found))


def own_sag_error(gathered: CellFacets) -> float:
    """Sag error (length) that facets of this size and bend cause, computed from the facets alone.

    It is the height over the chord at the middle of an edge, L² × bend/8, or over a facet's middle. The
    latter is
    higher where the facet has no blunt corner. The bend is computed from the slopes of neighbouring facets.
    """
    worst = 0.0
    for (_, _, cell), parts in gathered.facets.items():
        if cell:
            continue
        corners = np.concatenate(parts)
        normal = doubled_normals(corners)
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
"""Facets of a cell from which the bend is computed point by point: steep lenses bend more at the rim."""


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
