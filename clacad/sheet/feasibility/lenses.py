"""Numbers of one lens (cover, rim, thickness, slope) and of one body (necks, steps, pieces and holes, edge,
range).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Pair2
from clacad.base.units import A4, A6, A8
from clacad.optics.surface import EvenPolynomial, Surface, conic_constants, principal_radii
from clacad.sheet.feasibility.convex_extremes import Heights, border, least, reach, share_covered
from clacad.sheet.feasibility.derived_numbers import BodyFacts, BorderFacts, FaceShape, LensFacts, two
from clacad.sheet.like_cell import like_cell
from clacad.sheet.pieces_and_holes import BorderJoint, count_pieces_and_holes
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.volume_and_extent import body_extent
from clacad.sheet.window import (
    Body,
    Face,
    Window,
    column,
    face_height,
    lens_height,
    lens_height_and_normal,
    optical_tile,
)


def body_of(window: Window, array: int) -> tuple[Body, Face]:
    """Body that carries the lenses of an array, and the first of their faces."""
    for body in window.bodies:
        for face in (body.front, body.back):
            if face.array == array:
                return body, face
    raise ValueError(f"the window has no array {array}")


def lens_margin(window: Window, array: int, body: Body | None = None) -> Heights:
    """Distance of an array's lens from its end: a function of cell-frame x, y (lengths).

    It is the least of the lens's thickness along z and the heights of its faces over their land; NaN where a
    face has no point. The lens is the face where it is positive. A slab's lens has no thickness of its own.

    body : Body or None
        Body that carries the lens; None: the first body of the array.
    """
    if body is None:
        body, _ = body_of(window, array)

    def margin(x: Floats, y: Floats) -> Floats:
        front, back = (_height(face, array, x, y) for face in (body.front, body.back))
        parts = [np.full(x.shape, np.inf)]
        if front is not None and back is not None:
            parts.append(back - front)
        for face, z in ((body.front, front), (body.back, back)):
            if face.array == array and z is not None:
                parts.append(np.where(np.isnan(z), np.nan, np.inf))
                if face.land is not None:
                    parts.append(face.land_side * (face.land - z))
        stack = np.stack(parts)
        return np.where(np.isnan(stack).any(axis=0), np.nan, stack.min(axis=0))

    return margin


def _height(face: Face, array: int, x: Floats, y: Floats) -> Floats | None:
    """Height of a face that belongs to an array's lens: its lens or a plane; None for another array's."""
    if face.array is None:
        return np.full(x.shape, face.vertex[2])
    return lens_height(face, x, y) if face.array == array else None


def lens_facts(window: Window, array: int, width: list[float]) -> LensFacts:
    """Derive the numbers of lens 1 or 2; `width` (x, y) of its zone in the lens frame, lengths."""
    body, face = body_of(window, array)
    return _facts(window, body, face, array, width, window.thin.focal_length[array], f"lens {array + 1}")


def field_facts(window: Window, width: list[float]) -> tuple[LensFacts, ...]:
    """Numbers of the field lens, body by body; empty without one. `width` as for `lens_facts`."""
    if not window.field_array:
        return ()
    focal = two(min(lens.focal_length[axis] for lens in window.thin.field) for axis in (0, 1))
    found = [
        (body, next(f for f in (body.front, body.back) if f.array == 2))
        for body in window.bodies
        if 2 in (body.front.array, body.back.array)
    ]
    names = ["field lens"] if len(found) == 1 else [f"field lens of {body.name}" for body, _ in found]
    return tuple(
        _facts(window, body, face, 2, width, focal, name)
        for (body, face), name in zip(found, names, strict=True)
    )


def _facts(
    window: Window, body: Body, face: Face, array: int, width: list[float], focal: Pair2, name: str
) -> LensFacts:
    """Numbers of the lens of an array on one body, `face` its first face there; lengths."""
    zone = optical_tile(window)
    margin = lens_margin(window, array, body)
    corner, at = least(thickness_over_cell(window, array, body), zone)
    kappa = getattr(face.surface, "kappa", None)
    shapes = _shapes(body, array)
    measured = [f for f in (body.front, body.back) if f.array == array] if shapes else [face]
    return LensFacts(
        array=array,
        radius=principal_radii(face.surface),
        conic=conic_constants(face.surface),
        kappa=kappa,
        focal_length=focal,
        built_focal_length=_built_focal_length(body, array),
        sag=max(_sag(f, zone) for f in measured),
        thickness=_centre_thickness(body, face),
        least_thickness=least_thickness(window, array) if array < 2 else 0.0,
        corner=corner,
        cover=_cover(margin, zone),
        rim=_rim(window, face, margin),
        rim_at=at,
        least_normal_z=min(_least_normal_z(f, margin, zone) for f in measured),
        f_number=two(abs(f) / w for f, w in zip(focal, width, strict=True)),
        shapes=shapes,
        name=name,
        body=body.name,
    )


def _shapes(body: Body, array: int) -> tuple[FaceShape, ...]:
    """All faces of a lens, unless they are one quadric or biconic."""
    faces = [
        (side, f.surface) for side, f in (("front", body.front), ("back", body.back)) if f.array == array
    ]
    shapes = tuple(FaceShape(side, principal_radii(s), conic_constants(s), *_terms(s)) for side, s in faces)
    plain = len({(s.radius, s.conic) for s in shapes}) == 1 and all(s.a4 is None for s in shapes)
    return () if plain else shapes


def _terms(surface: Surface) -> tuple[A4 | None, A6 | None, A8 | None]:
    """Coefficients of an even polynomial; None for orders that it does not have."""
    if not isinstance(surface, EvenPolynomial):
        return None, None, None
    a6, a8 = surface.a6, surface.a8
    return surface.a4, a6 if any(a6) else None, a8 if any(a8) else None


def thickness_over_cell(window: Window, array: int, body: Body | None = None) -> Heights:
    """Thickness of an array's lens along z, a function of cell-frame x, y; infinite for a slab's.
    `body`: see `lens_margin`.
    """
    if body is None:
        body, _ = body_of(window, array)

    def thickness(x: Floats, y: Floats) -> Floats:
        front, back = (_height(face, array, x, y) for face in (body.front, body.back))
        return np.full(x.shape, np.inf) if front is None or back is None else back - front

    return thickness


def _sag(face: Face, zone: Floats) -> float:
    def height(x: Floats, y: Floats) -> Floats:
        return lens_height(face, x, y)

    lowest, _ = least(height, zone)
    highest, _ = least(lambda x, y: -height(x, y), zone)
    return -highest - lowest


def _centre_thickness(body: Body, face: Face) -> float:
    """Apex to apex along the lens axis, or apex to plane face along z."""
    if body.front.array is None or body.back.array is None:
        return body.back.vertex[2] - body.front.vertex[2]
    if body.columnar:
        return float(np.linalg.norm(np.subtract(body.back.vertex, body.front.vertex)))
    return (body.back.vertex[2] - body.front.vertex[2]) / float(face.rotation[2, 2])


def _built_focal_length(body: Body, array: int) -> Pair2:
    """Thick lensmaker per meridian: φ = (n − 1)(c + c' − (n − 1) T c c'/n), convex positive."""
    n, found = body.index, []
    for meridian in ("curvature_x", "curvature_y"):
        front, back = (
            getattr(f.surface, meridian) if f.array == array else 0.0 for f in (body.front, body.back)
        )
        thickness = _centre_thickness(body, body.front)
        power = (n - 1.0) * (front + back - (n - 1.0) * thickness * front * back / n)
        found.append(1.0 / power if power else np.inf)
    return two(found)


def _cover(margin: Heights, zone: Floats) -> float:
    """Share of the zone where the lens is the face: star-shaped about the lens's thickest point."""

    def inside(x: Floats, y: Floats) -> NDArray[np.bool_]:
        return np.asarray(margin(x, y) >= 0.0)

    _, pole = least(lambda x, y: np.nan_to_num(-np.minimum(margin(x, y), 1e300), nan=1e300), zone)
    return share_covered(inside, zone, np.array(pole))


def _rim(window: Window, face: Face, margin: Heights) -> Pair2:
    """Half width of the whole lens along its own axes from its axis, not cut by the cell."""
    far = 8.0 * window.lattice.circumradius
    cx, cy = face.vertex[:2]

    def inside(x: Floats, y: Floats) -> NDArray[np.bool_]:
        return np.asarray(margin(x + cx, y + cy) > 0.0)

    lateral = face.rotation[:2, :2].T
    directions = lateral / np.linalg.norm(lateral, axis=1, keepdims=True)
    ends = reach(inside, np.concatenate([directions, -directions]), far)
    return two(np.minimum(ends[:2], ends[2:]))


def _least_normal_z(face: Face, margin: Heights, zone: Floats) -> float:
    def normal_z(x: Floats, y: Floats) -> Floats:
        _, normal = lens_height_and_normal(face, x, y)
        # beyond the lens's end the face is not built; a face without a graph is undercut
        return np.where(margin(x, y) < 0.0, 1.0, np.nan_to_num(normal[:, 2], nan=0.0))

    return least(normal_z, zone)[0]


def least_thickness(window: Window, array: int) -> float:
    """Smallest centre thickness (length) at the radii as built that covers the whole optical zone.

    For untilted biconvex ellipsoids this equals 2ρ/(1 + sqrt(1 − κρ)), ρ = c_x x² + c_y y² at the worst
    corner. Infinite where the radii are too small for any thickness; 0 for a slab.
    """
    body, face = body_of(window, array)
    if window.one_outline:
        return 0.0
    thickness = _centre_thickness(body, face)
    zone, change = optical_tile(window), 0.0
    for _ in range(40):  # Newton: per unit of T, thickness along z grows by about 1/n_z, except for tilt
        moved = replace(window, bodies=tuple(thicker(b, change) if b is body else b for b in window.bodies))
        missing, _ = least(lens_margin(moved, array), zone)
        if missing == -np.inf:
            return np.inf
        if missing == np.inf:
            return 0.0
        step = -missing
        change += step
        if abs(step) <= 1e-15 * thickness:
            break
    return thickness + change


def thicker(body: Body, change: float) -> Body:
    """Body with its lens faces `change` (length) farther apart along the axis (plano: its plane moves)."""

    def moved(face: Face, sign: float) -> Face:
        if face.array is None:
            x, y, z = face.vertex
            return replace(face, vertex=(x, y, z + sign * change))
        if not body.columnar:
            return face
        x, y, z = np.asarray(face.vertex) + sign * 0.5 * change * face.rotation[:, 2]
        return replace(face, vertex=(float(x), float(y), float(z)))

    return replace(body, front=moved(body.front, -1.0), back=moved(body.back, 1.0))


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


def inner_range(window: Window, body: Body) -> tuple[float, float]:
    """Highest point of a body's front and lowest of its back (lengths), land included."""
    front, back = _heights(window, body)
    tile = window.lattice.tile()
    high, _ = least(lambda x, y: np.nan_to_num(-front(x, y), nan=np.inf), tile)
    low, _ = least(lambda x, y: np.nan_to_num(back(x, y), nan=np.inf), tile)
    lands = [face.land for face in (body.front, body.back)]
    return (
        max(-high, *(z for z in lands[:1] if z is not None), -np.inf),
        min(low, *(z for z in lands[1:] if z is not None), np.inf),
    )


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
        lens = thickness_over_cell(window, body.arrays[0], body)
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


def outer_size(window: Window, bodies: Sequence[Body]) -> tuple[float, float, float]:
    """Width, height and thickness (lengths) of some bodies together, as a caliper finds them."""
    boxes = np.array([body_extent(window, body) for body in bodies])
    ranges = np.array([whole_body_range(window, body) for body in bodies])
    low, high = boxes.min(axis=0), boxes.max(axis=0)
    return float(high[1] - low[0]), float(high[3] - low[2]), float(ranges[:, 1].max() - ranges[:, 0].min())
