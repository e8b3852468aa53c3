"""Numbers of one body: necks, steps, pieces and holes, edge, height range."""

from __future__ import annotations

import numpy as np

from clacad.sheet.feasibility.convex_extremes import Heights, border, least
from clacad.sheet.feasibility.derived_numbers import BodyFacts, BorderFacts, two
from clacad.sheet.feasibility.lenses import thickness_over_cell
from clacad.sheet.like_cell import like_cell
from clacad.sheet.pieces_and_holes import BorderJoint, count_pieces_and_holes
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.window import Body, Window, column, face_height, lens_height


def _heights(window: Window, body: Body) -> tuple[Heights, Heights]:
    """Front and back height of a body as functions of the cell frame of each face's own array."""
    if body.columnar:
        return (lambda x, y: column(window, body, x, y)[0]), (lambda x, y: column(window, body, x, y)[1])
    return (lambda x, y: face_height(window, body.front, x, y)), (
        lambda x, y: face_height(window, body.back, x, y)
    )


def body_facts(window: Window, body: Body) -> BodyFacts:
    """Derive the numbers of one body."""
    borders = tuple(_border_facts(window, body, k) for k in range(len(window.lattice.steps) // 2))
    pieces, holes = connectedness(window, body, borders)
    low, high = body_range(window, body)
    inner = borders if window.lattice.cell_count > 1 else ()
    return BodyFacts(
        name=body.name,
        borders=borders,
        edge=_edge(window, body),
        neck=min((b.neck for b in inner), default=np.inf),
        step=max((max(b.rise) for b in inner), default=0.0),
        pieces=pieces,
        holes=holes,
        low=low,
        high=high,
    )


def body_range(window: Window, body: Body) -> tuple[float, float]:
    """Lowest and highest point (lengths) of a body, land included."""
    front, back = _heights(window, body)
    tile = window.lattice.tile()
    low, _ = least(lambda x, y: np.nan_to_num(front(x, y), nan=np.inf), tile)
    high, _ = least(lambda x, y: np.nan_to_num(-back(x, y), nan=np.inf), tile)
    lands = [f.land for f in (body.front, body.back) if f.land is not None]
    return min([low, *lands]), max([-high, *lands])


def whole_body_range(window: Window, body: Body) -> tuple[float, float]:
    """Lowest and highest point (lengths) of a body of the whole sheet, uniform or not."""
    if window.uniform:
        return body_range(window, body)
    number = window.bodies.index(body)
    sheets = [like_cell(window, cell) for cell in representative_cells(window, "displaced")]
    low, high = zip(*(body_range(sheet, sheet.bodies[number]) for sheet in sheets), strict=True)
    return min(low), max(high)


def _border_facts(window: Window, body: Body, number: int) -> BorderFacts:
    """Compare the two columns on either side of border `number`."""
    step = window.lattice.steps[number]
    here = border(window.lattice.tile(), number)
    there = here - np.asarray(window.lattice.offset(*step))
    front, back = _heights(window, body)
    f = np.stack([front(*p.T) for p in (here, there)])
    b = np.stack([back(*p.T) for p in (here, there)])
    rounding = 1e-12 * window.lattice.circumradius  # a smaller difference of two computed heights is no step
    rise = [np.nan_to_num(np.abs(z[0] - z[1]), nan=0.0) for z in (f, b)]
    rise = [np.where(r <= rounding, 0.0, r) for r in rise]
    if body.columnar:  # where a lens has ended: the gap to its neighbour
        f, b = (
            np.where(np.isnan(z), [lens_height(face, *p.T) for p in (here, there)], z)
            for z, face in ((f, body.front), (b, body.back))
        )
    if not body.columnar and body.front.array is not None and body.back.array is not None:
        # slab: the other face's cells are displaced; its extreme height is the safe bound
        tile = window.lattice.tile()
        b_low, _ = least(back, tile)
        f_high = -least(lambda x, y: -front(x, y), tile)[0]
        common = np.minimum(b_low - f.max(axis=0), b.min(axis=0) - f_high)
    else:
        common = b.min(axis=0) - f.max(axis=0)
    common = np.nan_to_num(common, nan=-np.inf)
    return BorderFacts(
        step=step,
        neck=float(common.min()),
        joint=float(common.max()),
        joints=int(common[0] > 0.0) + int(((common[1:] > 0.0) & (common[:-1] <= 0.0)).sum()),
        corners=(bool(common[0] > 0.0), bool(common[-1] > 0.0)),
        rise=two(r.max() for r in rise),
        mean_rise=two(r.mean() for r in rise),
    )


def _edge(window: Window, body: Body) -> float:
    """Least thickness along the body's outer side: the land's if there is an outline, else the cells'."""
    tile = window.lattice.tile()
    fronts, backs = _heights(window, body)
    flat = window.outline is not None
    if flat and body.front.land is not None and body.back.land is not None:
        return body.back.land - body.front.land
    if body.columnar or body.front.array is None or body.back.array is None:
        if flat:
            front = body.front.vertex[2] if body.front.land is None else body.front.land
            back = body.back.vertex[2] if body.back.land is None else body.back.land
            return back - front
        rim = np.concatenate([border(tile, k) for k in range(len(tile))])
        # where the lens ends before the border, the column is missing: use the negative thickness, not NaN
        lens = thickness_over_cell(
            window, next(a for a in (body.front.array, body.back.array) if a is not None)
        )
        thickness = backs(*rim.T) - fronts(*rim.T)
        thickness = np.where(np.isnan(thickness), np.fmin(lens(*rim.T), 0.0), thickness)
        return float(np.nan_to_num(thickness, nan=-np.inf).min())
    return least(backs, tile)[0] + least(lambda x, y: -fronts(x, y), tile)[0]


def connectedness(window: Window, body: Body, borders: tuple[BorderFacts, ...]) -> tuple[int, int]:
    """Count connected pieces of a body and the holes through it."""
    plate = all(face.land is not None or face.array is None for face in (body.front, body.back))
    if plate or not (body.columnar or None in (body.front.array, body.back.array)):
        return 1, 0  # one plate under all cells, and where cells are left out
    return count_pieces_and_holes(window.lattice, [BorderJoint(b.step, b.joints, b.corners) for b in borders])
