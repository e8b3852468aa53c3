"""Share of the light that stays in its telescopelet, and directions of ghosts: exact for thin lenses.

Notation, lens frame, relative to lens 1's centre: a ray of slope t that enters lens 1 at x reaches the
plane of lens 2 at m x + s t with m = −f2/f1 per meridian (because 1 − s/f1 = m). The optical zone of
lens 1 arrives as a copy of itself, scaled by m and moved by s t. The share that hits a lenslet of
array 2 is the part of that copy which covers the lenslet's zone. Zones are convex polygons: the zone of a
lens in its own plane is the cell's column cut by that plane.

With a field lens the copy does not move with t: all light of one slope hits the field lens in one point. If
that point lies in the cell k steps from the partner's, the copy is at the centre of cell 2, moved by (1 − m)
of these steps.

A uniform sheet in coherent light: a grating, sin θ' = sin θ + mλ/p, under the far field of one cell.

Light that is coherent over many cells leaves only in the directions of that grating. One order lies within
half a step of the law's direction. The light goes to the few orders that the far field of one cell covers;
the law's own direction receives light only where an order coincides with it. Sunlight through a window pane
does not show these orders: it is coherent over 50 µm, less than a cell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from clacad.base.polygons import clip, common_areas, polygon_area
from clacad.base.types import Bools, Floats, Ints, Pair2
from clacad.optics.aperture import equivalent_widths
from clacad.sheet.cell_places import CellPlacement
from clacad.sheet.face_order import lined_array
from clacad.sheet.pattern import relocate
from clacad.sheet.window import ThinPair, Window, optical_tile

if TYPE_CHECKING:
    from clacad.sheet.lattice import Lattice

LEAST_SHARE = 1e-3
"""Least share of the light for which a ghost order is listed."""

SHARE_DIRECTIONS = 1024
"""Most directions of a bundle over which its mean share is computed."""

MOST_ORDERS = 30_000
"""Number of cells of array 2 under a copy of lens 1 beyond which no order has the share `LEAST_SHARE`."""


@dataclass(frozen=True, eq=False)
class ThinCells:
    """One telescopelet as thin lenses with cells, in the lens frame about lens 1's centre.

    zone : (m, 2) lengths
        Outline of the optical zone of either lens, relative to its own cell's centre, counter-clockwise.
    image : (m, 2) lengths. Copy of the zone of lens 1 in the plane of lens 2 for light along the axis.
    centre : (2,) lengths. Position of the centre of cell 2 in the plane of lens 2.
    separation : length
    part : Area of the optical zone over area of the cell (1 without a seam).
    """

    zone: Floats
    image: Floats
    centre: Floats
    separation: float
    part: float
    pair: ThinPair
    window: Window

    def slopes(self, directions: ArrayLike) -> Floats:
        """Slopes (n, 2) in the lens frame of sheet-frame directions (n, 3)."""
        turned = np.asarray(directions, dtype=np.float64) @ self.pair.rotation
        return np.asarray(turned[:, :2] / turned[:, 2:])

    def neighbour(self, order: tuple[int, int]) -> Floats:
        """Centre (2,) of the cell of array 2 that lies `order` index steps from the partner (lengths)."""
        step = self.window.lattice.offset(*order)
        return np.asarray(self.centre + _in_lens_plane(self.pair.rotation, np.array([step]))[0])


def focal_ratio(pair: ThinPair) -> tuple[float, float]:
    """Signed scale m = −f2/f1 of the copy of lens 1 at lens 2, per meridian; 1 without power."""
    first, second = pair.focal_length
    x, y = (1.0 if np.isinf(f1) else -f2 / f1 for f1, f2 in zip(first, second, strict=True))
    return x, y


def thin_cells(window: Window) -> ThinCells:
    """Describe the window's telescopelet as two thin lenses with cells."""
    pair = window.thin
    lit = _lit_tile(window)
    zone = _in_lens_plane(pair.rotation, lit)
    image = zone * np.array(focal_ratio(pair))
    if polygon_area(image) < 0.0:
        image = image[::-1]
    # centre of cell 2: above `shift`, in the plane through lens 2's centre perpendicular to the axis
    rest = np.array([[pair.shift[0] - pair.offset[0], pair.shift[1] - pair.offset[1]]])
    centre = np.asarray(pair.offset) @ pair.rotation[:, :2] + _in_lens_plane(pair.rotation, rest)[0]
    part = abs(polygon_area(lit)) / window.lattice.cell_area
    return ThinCells(zone, image, centre, pair.separation, part, pair, window)


def _lit_tile(window: Window, array: int = 0) -> Floats:
    """Part of a cell of an array that light may use: the optical zone, less walls and lines on its border."""
    wall = 0.0 if window.baffle is None else window.baffle.wall
    line = window.land.line if lined_array(window) == array else 0.0
    widest = max(window.land.seam, line, wall)
    return optical_tile(replace(window, land=replace(window.land, seam=widest)), array)


def _in_lens_plane(rotation: Floats, points: Floats) -> Floats:
    """Lens-frame coordinates (n, 2) of points over (x, y) in the plane perpendicular to the axis."""
    axis = rotation[:, 2]
    height = -(points @ axis[:2]) / axis[2]
    return np.asarray(np.column_stack([points, height]) @ rotation[:, :2])


def share(cells: ThinCells, directions: ArrayLike, order: tuple[int, int] = (0, 0)) -> Floats:
    """Share of the light on a cell of array 1 that hits the cell of array 2 `order` steps from its partner.

    directions : (n, 3) array. Incident directions, sheet frame, any length.
    order : (i, j). (0, 0) is the partner: light that obeys the law. Others are ghosts.
    Returns (n,) array, 0 … 1: The sum over all orders is the optical zone's share of the cell (1 without a
        seam). A baffle stops every ghost, and light that hits its walls.
    """
    if cells.window.baffle is not None and order != (0, 0):
        return np.zeros(len(np.asarray(directions)))
    slopes = cells.slopes(directions)
    target = partner_zone(cells) + cells.neighbour(order)
    whole = polygon_area(cells.image)
    common = common_areas(cells.image, arrivals(cells, slopes), target)
    return np.asarray(cells.part * common * _in_channels(cells, slopes) / whole)


def mean_share(cells: ThinCells, directions: Floats) -> float:
    """Mean share over the first `SHARE_DIRECTIONS` of the directions (n, 3) of a bundle."""
    return float(share(cells, directions[:SHARE_DIRECTIONS]).mean())


def order_shares(cells: ThinCells, direction: Floats) -> dict[tuple[int, int], float]:
    """Shares of the light of one direction (3,), sheet frame, on each cell of array 2: order to share,
    largest first.

    The partner, order (0, 0), is always listed; other orders only with a share of at least `LEAST_SHARE`.
    """
    around = np.column_stack([cells.neighbour(step) - cells.centre for step in ((1, 0), (0, 1))])
    arrival = arrivals(cells, cells.slopes(direction[None]))[0] - cells.centre
    steps = np.linalg.solve(around, (cells.image + arrival).T)
    reach = np.abs(np.linalg.solve(around, partner_zone(cells).T)).max(axis=1)
    low, high = np.floor(steps.min(axis=1) - reach), np.ceil(steps.max(axis=1) + reach)
    orders = {(0, 0)}
    if np.prod(high - low + 1.0) <= MOST_ORDERS:
        i, j = (range(int(a), int(b) + 1) for a, b in zip(low, high, strict=True))
        orders |= set(product(i, j))
    shares = {order: float(share(cells, direction[None], order)[0]) for order in orders}
    kept = [order for order, part in shares.items() if order == (0, 0) or part >= LEAST_SHARE]
    return {order: shares[order] for order in sorted(kept, key=lambda order: (-shares[order], order))}


def partner_share(window: Window, index: Ints, directions: ArrayLike) -> Floats:
    """Share (n,) of the light of one direction per cell that hits the partner of that cell, thin lenses.

    window : Uniform or not.
    index : (n, 2) ints. Cells of array 0.
    directions : (n, 3) array. Incident directions, sheet frame, any length.
    """
    cells = thin_cells(window)
    ratio = scale_of_image(cells, index)
    if not window.thin.second.own and ratio is None:
        return share(cells, directions)
    slopes = cells.slopes(directions)
    through = _in_channels(cells, slopes, _partner_apart(cells, index))
    return share_of_zone(cells, off_partner(cells, index, slopes), ratio) * through


def share_of_zone(cells: ThinCells, shift: Floats, ratio: Floats | None) -> Floats:
    """Share (n,) of light from a copy of lens 1's zone, `ratio` (n, 2, 2) times the image,
    `shift` (n, 2) from lens 2's zone.
    """
    image, whole = cells.image, np.asarray(polygon_area(cells.image))
    if ratio is not None:
        image, whole = image @ ratio.swapaxes(1, 2), whole * np.linalg.det(ratio)
    return np.asarray(cells.part * common_areas(image, shift, partner_zone(cells)) / whole)


def scale_of_image(cells: ThinCells, index: Ints) -> Floats | None:
    """Matrices (n, 2, 2), sheet's lens axes, of the copy of lens 1's zone that the cells `index` (n, 2) make,
    relative to `ThinCells.image`: diagonal unless cells are turned; None where all cells are alike.
    """
    first, second = (cells.pair.lenses(array, cells.window.lattice, index) for array in (0, 1))
    if first.size is None or second.size is None:
        return None
    one, other = (np.stack(lens.focal((1.0, 1.0)), axis=-1) for lens in (first, second))
    scale = np.asarray(other / one)
    if first.rotation is None:
        return np.asarray(scale[:, None] * np.eye(2))
    own, middle = cells.pair.rotation.T[:2] @ first.rotation[..., :2], np.array(focal_ratio(cells.pair))
    return np.asarray((own * (scale * middle)[:, None]) @ own.swapaxes(1, 2) / middle)


def off_partner(cells: ThinCells, index: Ints, slopes: Floats) -> Floats:
    """Displacement (n, 2) of the centre of the copy of lens 1's zone from its partner's centre, in the plane
    of lens 2.

    cells : Of a uniform or non-uniform window.
    index : (n, 2) ints. Cells of array 0 through which the light comes.
    slopes : (n, 2). Incident slopes, lens frame.
    """
    apart = _partner_apart(cells, index)
    arrival = arrivals(cells, slopes, apart, index) - cells.centre
    return np.asarray(arrival if apart is None else arrival - _in_lens_plane(cells.pair.rotation, apart))


def _partner_apart(cells: ThinCells, index: Ints) -> Floats | None:
    """Displacement (n, 2) of the partners of cells `index` (n, 2) beyond that of the middle (lengths);
    None where all are displaced alike.
    """
    if not cells.pair.second.own:
        return None
    return np.asarray(_second_array(cells.window).centres(index) - cells.window.lattice.centres(index))


def partner_zone(cells: ThinCells) -> Floats:
    """Outline (m, 2) of the optical zone of lens 2 relative to its own cell's centre, lens frame, lengths."""
    window, pair = cells.window, cells.pair
    if not pair.second.own and lined_array(window) < 0:
        return cells.zone
    like = replace(window, placements=(CellPlacement(), pair.second))
    return _in_lens_plane(pair.rotation, _lit_tile(like, 1))


def partner_step(cells: ThinCells, order: tuple[int, int]) -> Floats:
    """Displacement (2,), lens frame, lengths, from the partner to the cell `order` index steps away."""
    if not cells.pair.second.own:
        return np.asarray(cells.neighbour(order) - cells.centre)
    step = _second_array(cells.window).offset(*order)
    return np.asarray(_in_lens_plane(cells.pair.rotation, np.array([step]))[0])


def _second_array(window: Window) -> Lattice:
    """Pattern of the cells of array 2 of the thin pair about its own centre."""
    return window.thin.second.lattice(window.lattice)


def arrivals(
    cells: ThinCells, slopes: Floats, apart: Floats | None = None, of_cells: Ints | None = None
) -> Floats:
    """Position (n, 2) of the centre of the copy of lens 1's zone in the plane of lens 2, for light of
    lens-frame slopes (n, 2); lengths.

    apart : (n, 2) lengths or None
        Displacement of the partner of each cell, which field lenses follow; sheet frame.
    of_cells : (n, 2) or None. Cells whose own field lenses the light meets; None: the central one's.
    """
    pair = cells.pair
    if not pair.field:
        return np.asarray(cells.separation * slopes)
    ratio = np.broadcast_to(focal_ratio(pair), slopes.shape)
    if of_cells is not None and (scale := scale_of_image(cells, of_cells)) is not None:
        ratio = ratio * np.diagonal(scale, axis1=1, axis2=2)
    arrival = np.empty_like(slopes)
    for lens in pair.field:
        depth = np.full((len(slopes), 1), lens.depth)
        if of_cells is not None:
            depth = lens.in_cells(cells.window.lattice, of_cells)[0][:, None]
        powered = [axis for axis in (0, 1) if np.isfinite(lens.focal_length[axis])]
        vertex = depth / lens.depth * (pair.field_centre(lens) @ pair.rotation)
        centre, lattice = cells.centre, cells.window.lattice
        if apart is not None:
            across = _in_lens_plane(pair.rotation, apart)
            vertex[:, :2] += depth / pair.separation * across
            centre, lattice = centre + across, pair.field_place(lens, lattice)[0].lattice(lattice)
        met = vertex.copy()
        met[:, powered] = depth * slopes[:, powered]
        aside = (met - vertex) @ pair.rotation.T
        index, _ = relocate(lattice, aside[:, :2])
        steps = index @ np.array([lattice.offset(1, 0), lattice.offset(0, 1)])
        moved = centre + (1.0 - ratio) * _in_lens_plane(pair.rotation, steps)
        arrival[:, powered] = moved[:, powered]
    return arrival


def _in_channels(cells: ThinCells, slopes: Floats, apart: Floats | None = None) -> Bools:
    """Whether light of lens-frame slopes (n, 2) passes a baffle that ends at the field lens, (n,).

    apart : as in `arrivals`
    """
    open_to = np.ones(len(slopes), dtype=bool)
    window, pair = cells.window, cells.pair
    if window.baffle is None:
        return open_to
    for lens in pair.field:
        aside = lens.depth * slopes - (pair.field_centre(lens) @ pair.rotation)[:2]
        if apart is not None:
            aside = aside - lens.depth / pair.separation * _in_lens_plane(pair.rotation, apart)
        met = aside @ pair.rotation[:, :2].T
        for step, half in zip(window.lattice.steps, window.lattice.half_widths, strict=True):
            along = met[:, :2] @ np.asarray(window.lattice.offset(*step)) / (2.0 * half)
            open_to &= along <= half - 0.5 * window.baffle.wall
    return open_to


def lit_zone(cells: ThinCells) -> Floats:
    """Lit part of lens 2 (m, 2), relative to its centre, for light along the centre of the field, lens frame,
    lengths.

    It is the intersection of the image of lens 1's zone and lens 2's zone; for cells along the lens axes
    p·min(1, |m|) wide.
    """
    return clip(cells.image, partner_zone(cells))


def fresnel_numbers(cells: ThinCells, wavelength: float, lit: Floats | None = None) -> tuple[float, float]:
    """Fresnel numbers (w/2)²/(λ|f2|) along lens x and y, w the lit width of lens 2; infinite along an axis
    without power.

    wavelength : float, length
    lit : (m, 2) lengths or None
        Lit part of lens 2 for light along the centre of the field; None: that of a uniform sheet.
    """
    widths = equivalent_widths(lit_zone(cells) if lit is None else lit)
    x, y = (
        (0.5 * float(w)) ** 2 / (wavelength * abs(f)) if np.isfinite(f) else np.inf
        for w, f in zip(widths, cells.pair.focal_length[1], strict=True)
    )
    return x, y


def ghost_step(cells: ThinCells, order: tuple[int, int], index: Ints | None = None) -> Floats:
    """Change (2,) of the exit slope, lens frame, between the image and the ghost order `order`.

    On a non-uniform sheet it is (n, 2), for light through the cells `index` (n, 2): it includes the different
    position of the lens that is hit.
    """
    moved = partner_step(cells, order)
    change = cells.pair.change
    if change is not None and index is not None:
        lattice = cells.window.lattice
        beside = change.at(lattice, index + np.array(order)) - change.at(lattice, index)
        moved = moved + _in_lens_plane(cells.pair.rotation, beside)
    second = np.array(cells.pair.focal_length[1])
    return np.asarray(np.where(np.isinf(second), 0.0, moved / second))


def aperture_slope(window: Window) -> tuple[float, float]:
    """Sheet-frame slope at the centre of the field of view: from cell 1's centre to cell 2's."""
    height = window.thin.offset[2]
    return window.thin.shift[0] / height, window.thin.shift[1] / height


def aperture_slopes(window: Window, index: Ints) -> Floats:
    """Sheet-frame slopes (n, 2) from cell 1's centre to cell 2's, for the cells `index` (n, 2)."""
    height, pair = window.thin.offset[2], window.thin
    apart = _second_array(window).centres(index) - window.lattice.centres(index) + np.asarray(pair.shift)
    return np.asarray(apart / height)


def half_field(cells: ThinCells) -> tuple[float, float]:
    """Half width in slope of the field of view along lens x and y: beyond it no light arrives.

    (p/s)(1 + |m|)/2 on a square lattice along the lens axes.
    """
    x, y = (_half_width(cells.zone, k) + _half_width(cells.image, k) for k in (0, 1))
    return x / cells.separation, y / cells.separation


def ghost_onset(cells: ThinCells) -> tuple[float, float]:
    """Slope relative to the centre of the field at which the first light hits a wrong lenslet, lens x and y.

    (p/s)(1 − |m|)/2; 0 where the copy is larger than the cell, so that ghosts never vanish. With a field
    lens, the whole field of view is free of ghosts, unless the copy is larger than the cell.
    """
    if cells.pair.field:
        field = half_field(cells)
        x, y = (f if abs(m) <= 1.0 else 0.0 for f, m in zip(field, focal_ratio(cells.pair), strict=True))
        return x, y
    x, y = (max(0.0, _half_width(cells.zone, k) - _half_width(cells.image, k)) for k in (0, 1))
    return x / cells.separation, y / cells.separation


def _half_width(polygon: Floats, axis: int) -> float:
    return 0.5 * float(np.ptp(polygon[:, axis]))


def order_steps(lattice: Lattice, wavelength: float) -> Pair2:
    """Steps of the direction cosine between orders along both reciprocal lattice vectors: λ/p on a square
    lattice.

    wavelength : float, length
    """
    vectors = np.array([lattice.offset(1, 0), lattice.offset(0, 1)], dtype=np.float64)
    first, second = np.linalg.norm(np.linalg.inv(vectors), axis=0)
    return wavelength * float(first), wavelength * float(second)
