"""What a window is made of, in the numbers a maker and a user ask for: derived, never assumed.

Everything is measured on the window's own faces, so it is true of the part that is written. Lengths in
the window's unit unless a name ends in `_m` (metres); angles in radians; slopes are tangents.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clacad.extremes import Floats, Heights, border, least, reach, share_covered
from clacad.lattice import Lattice
from clacad.sheet import (
    Body,
    Face,
    Window,
    column,
    face_height,
    lens_height,
    lens_height_and_normal,
    optical_tile,
)
from clacad.surface import conic_constants, principal_radii
from clacad.vignetting import aperture_slope, focal_ratio, ghost_onset, half_field, thin_cells

DEFAULT_WAVELENGTH = 550e-9
"""Metres; for windows whose index was given bare."""

VIEWING_DISTANCE = 1.0
"""Metres; where pixel advice is given for."""

Two = tuple[float, float]


@dataclass(frozen=True)
class LensFacts:
    """One lens of a telescopelet.

    radius : (R_x, R_y), lengths
        Apex radii, negative where concave, infinite where flat.
    conic : (K_x, K_y) or None each
    kappa : float or None, 1/length
        Coefficient of z² of a quadric; None for a biconic.
    focal_length, built_focal_length : (f_x, f_y), lengths
        Of the thin lens it stands for; of the lens as built about its own axis (in air; slab: R/(n − 1)).
    sag : float, length
        Height range of the face over its optical zone.
    thickness : float, length
        Along the axis, apex to apex (plano: apex to plane face; slab: apex to apex of the two lenses).
    least_thickness : float, length
        Smallest thickness at these radii that covers the optical zone; infinite if none does, 0 where
        thickness does not matter (slab).
    corner : float, length
        Least thickness of the lens over its optical zone, along z; negative where it does not reach.
    cover : float
        Share of the optical zone where the lens exists and stands proud of its land.
    rim : (x, y), lengths
        Half width of the lens along its own axes, were it not cut by the cell; infinite if it has no rim.
    rim_at : (2,) lengths
        Point of the zone where the lens is thinnest, cell frame.
    least_normal_z : float
        Smallest z component of the unit normal over the zone; 0 or less is undercut.
    f_number : (x, y)
        Focal length over the width of the zone.
    """

    array: int
    radius: Two
    conic: tuple[float | None, float | None]
    kappa: float | None
    focal_length: Two
    built_focal_length: Two
    sag: float
    thickness: float
    least_thickness: float
    corner: float
    cover: float
    rim: Two
    rim_at: Two
    least_normal_z: float
    f_number: Two


@dataclass(frozen=True)
class BorderFacts:
    """One direction of inner borders of one body (all of that direction are congruent).

    step : (i, j)
        Index step across the border.
    neck : float, length
        Least common height of the two columns along the border; negative: they stand apart.
    joint : float, length
        Greatest common height; the two are joined if it is positive.
    joints : int
        Separate stretches of the border along which they are joined.
    corners : (bool, bool)
        Whether they are joined at the two ends of the border.
    rise : (front, back), lengths
        Greatest step between the two faces.
    mean_rise : (front, back), lengths
    """

    step: tuple[int, int]
    neck: float
    joint: float
    joints: int
    corners: tuple[bool, bool]
    rise: Two
    mean_rise: Two


@dataclass(frozen=True)
class BodyFacts:
    """One body.

    edge : float, length
        Least thickness along the true outer side of the body.
    neck : float, length
        Least common height over all inner borders; infinite for a single cell.
    step : float, length
        Highest step at any inner border.
    pieces, holes : int
        Connected pieces, and holes through them.
    low, high : float, lengths
        Height range.
    """

    name: str
    borders: tuple[BorderFacts, ...]
    edge: float
    neck: float
    step: float
    pieces: int
    holes: int
    low: float
    high: float


@dataclass(frozen=True)
class Feasibility:
    """All derived numbers of a window.

    clearance : float, length
        Lowest of body 2 less highest of body 1; infinite for a slab.
    aperture, undeviated : (x, y), slopes
        Middle of the field of view; direction through both lens centres. Sheet frame.
    half_field, ghost_onset : (x, y), slopes along lens x, y
    offset_blur : (x, y), lengths
        Full range of the ray offset on the sheet.
    diffraction_blur : (x, y), radians
        First zero of the slit of the width that is lit.
    fresnel_number : float
        Least over the axes, of the lit width at lens 2.
    pixel : float, length
        Pitch that balances diffraction and pixel size seen from `VIEWING_DISTANCE`.
    wavelength : float, metres
    """

    lenses: tuple[LensFacts, LensFacts]
    bodies: tuple[BodyFacts, ...]
    clearance: float
    separation: float
    aperture: Two
    undeviated: Two
    half_field: Two
    ghost_onset: Two
    offset_blur: Two
    diffraction_blur: Two
    fresnel_number: float
    pixel: float
    wavelength: float


def feasibility(window: Window) -> Feasibility:
    """Derive all numbers of a window (one cell of each array is enough: all cells are alike)."""
    cells = thin_cells(window)
    wave = (window.wavelength or DEFAULT_WAVELENGTH) / window.unit
    ratio = [abs(m) for m in focal_ratio(window.thin)]
    width = [float(np.ptp(cells.zone[:, k])) for k in (0, 1)]
    lit = [w * min(1.0, m) for w, m in zip(width, ratio, strict=True)]
    offset = window.thin.offset
    bodies = tuple(_body_facts(window, body) for body in window.bodies)
    second = window.thin.focal_length[1]
    fresnel = [(0.5 * w) ** 2 / (wave * abs(f)) for w, f in zip(lit, second, strict=True) if np.isfinite(f)]
    shrink = min(1.0, *ratio)
    return Feasibility(
        lenses=(_lens_facts(window, 0, width), _lens_facts(window, 1, width)),
        bodies=bodies,
        clearance=bodies[1].low - bodies[0].high if len(bodies) == 2 else np.inf,
        separation=window.thin.separation,
        aperture=aperture_slope(window),
        undeviated=(offset[0] / offset[2], offset[1] / offset[2]),
        half_field=half_field(cells),
        ghost_onset=ghost_onset(cells),
        offset_blur=_two(w * _offset(window, k) for k, w in enumerate(width)),
        diffraction_blur=_two(wave / w for w in lit),
        fresnel_number=min(fresnel),
        pixel=float(np.sqrt(wave * VIEWING_DISTANCE / window.unit / shrink)),
        wavelength=wave * window.unit,
    )


def _two(values: Iterable[float]) -> Two:
    x, y = values
    return float(x), float(y)


def _offset(window: Window, axis: int) -> float:
    """Range of the ray offset on the sheet over the width of the zone: |1 − m| min(1, 1/|m|)."""
    m = focal_ratio(window.thin)[axis]
    return abs(1.0 - m) * min(1.0, 1.0 / abs(m))


# -- lenses -------------------------------------------------------------------------------------


def body_of(window: Window, array: int) -> tuple[Body, Face]:
    """Body that carries the lenses of an array, and the first of their faces."""
    for body in window.bodies:
        for face in (body.front, body.back):
            if face.array == array:
                return body, face
    raise ValueError(f"the window has no array {array}")


def lens_margin(window: Window, array: int) -> Heights:
    """How far the lens of an array is from ending: a function of cell-frame x, y (lengths).

    The least of its thickness along z and the heights of its faces over their land; NaN where a face has no
    point. The lens is the face wherever it is positive. A slab's lens has no thickness of its own.
    """
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
                    parts.append(face.side * (face.land - z))
        stack = np.stack(parts)
        return np.where(np.isnan(stack).any(axis=0), np.nan, stack.min(axis=0))

    return margin


def _height(face: Face, array: int, x: Floats, y: Floats) -> Floats | None:
    """Height of a face that belongs to an array's lens: its lens or a plane; None for another array's."""
    if face.array is None:
        return np.full(x.shape, face.vertex[2])
    return lens_height(face, x, y) if face.array == array else None


def _lens_facts(window: Window, array: int, width: list[float]) -> LensFacts:
    body, face = body_of(window, array)
    zone = optical_tile(window)
    margin = lens_margin(window, array)
    corner, at = least(_thickness(window, array), zone)
    kappa = getattr(face.surface, "kappa", None)
    focal = window.thin.focal_length[array]
    return LensFacts(
        array=array,
        radius=principal_radii(face.surface),
        conic=conic_constants(face.surface),
        kappa=kappa,
        focal_length=focal,
        built_focal_length=_built_focal_length(body, array),
        sag=_sag(face, zone),
        thickness=_centre_thickness(body, face),
        least_thickness=least_thickness(window, array),
        corner=corner,
        cover=_cover(margin, zone),
        rim=_rim(window, array, face, margin),
        rim_at=at,
        least_normal_z=_least_normal_z(face, margin, zone),
        f_number=_two(abs(f) / w for f, w in zip(focal, width, strict=True)),
    )


def _thickness(window: Window, array: int) -> Heights:
    """Thickness of an array's lens along z, a function of cell-frame x, y; infinite for a slab's."""
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


def _built_focal_length(body: Body, array: int) -> Two:
    """Thick lensmaker per meridian: φ = (n − 1)(c + c' − (n − 1) T c c'/n), convex positive."""
    n, found = body.index, []
    for meridian in ("curvature_x", "curvature_y"):
        front, back = (
            getattr(f.surface, meridian) if f.array == array else 0.0 for f in (body.front, body.back)
        )
        thickness = _centre_thickness(body, body.front)
        power = (n - 1.0) * (front + back - (n - 1.0) * thickness * front * back / n)
        found.append(1.0 / power if power else np.inf)
    return _two(found)


def _cover(margin: Heights, zone: Floats) -> float:
    """Share of the zone where the lens is the face; the lens region is star-shaped about its thickest point."""

    def inside(x: Floats, y: Floats) -> NDArray[np.bool_]:
        return np.asarray(margin(x, y) >= 0.0)

    _, pole = least(lambda x, y: np.nan_to_num(-np.minimum(margin(x, y), 1e300), nan=1e300), zone)
    return share_covered(inside, zone, np.array(pole))


def _rim(window: Window, array: int, face: Face, margin: Heights) -> Two:
    """Half width of the whole lens along its own axes from its axis, not cut by the cell."""
    far = 8.0 * window.lattice.circumradius
    cx, cy = face.vertex[:2]

    def inside(x: Floats, y: Floats) -> NDArray[np.bool_]:
        return np.asarray(margin(x + cx, y + cy) > 0.0)

    lateral = face.rotation[:2, :2].T
    directions = lateral / np.linalg.norm(lateral, axis=1, keepdims=True)
    ends = reach(inside, np.concatenate([directions, -directions]), far)
    return _two(np.minimum(ends[:2], ends[2:]))


def _least_normal_z(face: Face, margin: Heights, zone: Floats) -> float:
    def normal_z(x: Floats, y: Floats) -> Floats:
        _, normal = lens_height_and_normal(face, x, y)
        # where the lens has ended the face is not built; where the face has no graph it is undercut
        return np.where(margin(x, y) < 0.0, 1.0, np.nan_to_num(normal[:, 2], nan=0.0))

    return least(normal_z, zone)[0]


def least_thickness(window: Window, array: int) -> float:
    """Smallest centre thickness (length) at the radii as built that covers the whole optical zone.

    Untilted biconvex ellipsoids: 2ρ/(1 + sqrt(1 − κρ)), ρ = c_x x² + c_y y² at the worst corner, to which
    the solve reduces. Infinite where the radii are too small for any thickness; 0 for a slab.
    """
    body, face = body_of(window, array)
    if window.form == "slab":
        return 0.0
    thickness = _centre_thickness(body, face)
    zone, change = optical_tile(window), 0.0
    for _ in range(40):  # Newton: thickness along z grows by 1/n_z or so, a tilt apart, per unit of T
        moved = replace(window, bodies=tuple(_thicker(b, change) if b is body else b for b in window.bodies))
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


def _thicker(body: Body, change: float) -> Body:
    """Body whose lens faces stand `change` farther apart along the lens axis (plano: its plane face moves)."""

    def moved(face: Face, sign: float) -> Face:
        if face.array is None:
            x, y, z = face.vertex
            return replace(face, vertex=(x, y, z + sign * change))
        if not body.columnar:
            return face
        x, y, z = np.asarray(face.vertex) + sign * 0.5 * change * face.rotation[:, 2]
        return replace(face, vertex=(float(x), float(y), float(z)))

    return replace(body, front=moved(body.front, -1.0), back=moved(body.back, 1.0))


# -- bodies -------------------------------------------------------------------------------------


def _heights(window: Window, body: Body) -> tuple[Heights, Heights]:
    """Front and back height of a body as functions of the cell frame of each face's own array."""
    if body.columnar:
        return (lambda x, y: column(window, body, x, y)[0]), (lambda x, y: column(window, body, x, y)[1])
    return (lambda x, y: face_height(window, body.front, x, y)), (
        lambda x, y: face_height(window, body.back, x, y)
    )


def _body_facts(window: Window, body: Body) -> BodyFacts:
    front, back = _heights(window, body)
    borders = tuple(_border_facts(window, body, k) for k in range(len(window.lattice.steps) // 2))
    pieces, holes = connectedness(window, body, borders)
    low, high = _extent(window, body, front, back)
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


def _extent(window: Window, body: Body, front: Heights, back: Heights) -> tuple[float, float]:
    tile = window.lattice.tile()
    low, _ = least(lambda x, y: np.nan_to_num(front(x, y), nan=np.inf), tile)
    high, _ = least(lambda x, y: np.nan_to_num(-back(x, y), nan=np.inf), tile)
    lands = [f.land for f in (body.front, body.back) if f.land is not None]
    return min([low, *lands]), max([-high, *lands])


def _border_facts(window: Window, body: Body, number: int) -> BorderFacts:
    """Compare the two columns that meet along border `number`."""
    step = window.lattice.steps[number]
    here = border(window.lattice.tile(), number)
    there = here - np.asarray(window.lattice.offset(*step))
    front, back = _heights(window, body)
    f = np.stack([front(*p.T) for p in (here, there)])
    b = np.stack([back(*p.T) for p in (here, there)])
    rise = [np.nan_to_num(np.abs(z[0] - z[1]), nan=0.0) for z in (f, b)]
    if body.columnar:  # a lens that has ended: by how much it misses its neighbour
        f, b = (
            np.where(np.isnan(z), [lens_height(face, *p.T) for p in (here, there)], z)
            for z, face in ((f, body.front), (b, body.back))
        )
    if not body.columnar and body.front.array is not None and body.back.array is not None:
        # slab: the other face's cells lie elsewhere; its extreme height is the safe bound
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
        rise=_two(r.max() for r in rise),
        mean_rise=_two(r.mean() for r in rise),
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
        # where the lens has ended before the border the column is missing: its shortfall, not its absence
        lens = _thickness(window, next(a for a in (body.front.array, body.back.array) if a is not None))
        thickness = backs(*rim.T) - fronts(*rim.T)
        thickness = np.where(np.isnan(thickness), np.fmin(lens(*rim.T), 0.0), thickness)
        return float(np.nan_to_num(thickness, nan=-np.inf).min())
    return least(backs, tile)[0] + least(lambda x, y: -fronts(x, y), tile)[0]


def connectedness(window: Window, body: Body, borders: tuple[BorderFacts, ...]) -> tuple[int, int]:
    """Count connected pieces of a body and the holes through it, in closed form.

    Every cell is one disc. Two neighbours that share height along part of their border are glued there; a
    node is filled if the borders that end in it are glued up to it. Then discs − glued borders + filled
    nodes = pieces − holes (Euler), and pieces follow from which directions are glued.
    """
    plate = body.front.land is not None and body.back.land is not None
    if plate or window.form == "slab":
        return 1, 0  # one plate under all cells
    kept = _kept(window.lattice)
    glued = [b for b in borders if b.joint > 0.0]
    edges = sum(b.joints * int(_together(kept, [(0, 0), b.step]).sum()) for b in glued)
    pieces = _pieces(kept, [b.step for b in glued], window.lattice)
    euler = int(kept.sum()) - edges + _filled_nodes(kept, borders)
    return pieces, pieces - euler


def _kept(lattice: Lattice) -> NDArray[np.bool_]:
    """Kept cells as a (rows i, columns j) mask with one empty line all round."""
    n1, n2 = lattice.count
    if not lattice.hexagonal and lattice.outline is None:
        return np.pad(np.ones((n1, n2), dtype=bool), 1)
    first = -(n2 // 2) if lattice.hexagonal else 0
    i, j = np.meshgrid(np.arange(first, n1), np.arange(n2), indexing="ij")
    return np.pad(lattice.contains(np.stack([i, j], axis=-1)), 1)


def _together(kept: NDArray[np.bool_], cells: list[tuple[int, int]]) -> NDArray[np.bool_]:
    """Where all of a cell's relatives (index steps, the cell itself being (0, 0)) are kept."""
    everywhere = np.ones_like(kept)
    for di, dj in cells:
        everywhere &= np.roll(kept, (-di, -dj), axis=(0, 1))
    return everywhere


def _filled_nodes(kept: NDArray[np.bool_], borders: tuple[BorderFacts, ...]) -> int:
    """Inner nodes at which all borders that end there are glued; START and END of a border as it runs."""
    if len(borders) == 2:
        whole = all(borders[0].corners) and all(borders[1].corners)
        return int(_together(kept, [(0, 0), (1, 0), (0, 1), (1, 1)]).sum()) if whole else 0
    (right_start, right_end), (up_start, up_end), (left_start, left_end) = (b.corners for b in borders)
    found = 0
    if right_end and up_start and left_end:  # corner 1 of the cell
        found += int(_together(kept, [(0, 0), (1, 0), (0, 1)]).sum())
    if up_end and left_start and right_start:  # corner 2
        found += int(_together(kept, [(0, 0), (0, 1), (-1, 1)]).sum())
    return found


def _pieces(kept: NDArray[np.bool_], steps: list[tuple[int, int]], lattice: Lattice) -> int:
    """Connected pieces of the kept cells when neighbours along `steps` are joined."""
    if not steps:
        return int(kept.sum())
    if lattice.outline is None and (1, 0) in steps and len(steps) > 1:
        return 1  # whole rows, joined to one another
    number = np.cumsum(kept.ravel()).reshape(kept.shape) - 1
    pairs = []
    for step in steps:
        both = _together(kept, [(0, 0), step])
        other = np.roll(number, (-step[0], -step[1]), axis=(0, 1))
        pairs.append(np.stack([number[both], other[both]]))
    first, second = np.concatenate(pairs, axis=1)
    return components(int(kept.sum()), first, second)


def components(count: int, first: NDArray[np.int64], second: NDArray[np.int64]) -> int:
    """Number of connected components of `count` things of which first[k] and second[k] are joined."""
    root = np.arange(count)
    while True:
        a, b = root[first], root[second]
        low, high = np.minimum(a, b), np.maximum(a, b)
        apart = low < high
        if not apart.any():
            return int((root == np.arange(count)).sum())
        np.minimum.at(root, high[apart], low[apart])
        while (root[root] != root).any():  # follow to the root: path lengths halve each time
            root = root[root]
