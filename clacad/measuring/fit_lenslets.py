"""Lenslets of a map, each fitted by a conic with astigmatism, and the lattice and plane on which they lie.

The radius, conic constant, middle and astigmatism of a lenslet are those of the least squares of vertical
distances over the measured aperture: its cell less a margin all round. They depend on that aperture.
Distances beyond
`CLIPPED` times the median absolute deviation are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from typing import Any, NamedTuple

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.measuring.find_lattice import (
    SOME,
    Found,
    NDArrayComplex,
    NotMeasurable,
    find_lattice,
    plane_of,
    thinned,
)
from clacad.measuring.read_map import MeasuredMap
from clacad.optics.fit import legendre
from clacad.optics.surface.sag_and_normal import Quadric
from clacad.sheet.pattern import Pattern

MARGIN = 0.01
"""Width (mm) of the strip inside each border of a cell that is not fitted, at most a tenth of the pitch."""

CLIPPED = 4.5
PRESENT, ALONG = 0.8, 0.5
"""Share of the parts of an aperture that must hold points, and of those along each side of it."""

DEGREE, COARSE_DEGREE = 8, 4
"""Degree of the Legendre polynomials of the form that is left by the fit; that of coarse maps."""

PRIOR = 1.0
"""Weight, in points, of the expectation that a polynomial of the form beyond the conic has the coefficient 0:
such form is expected to be of the size of the noise of one point. It decides only where no points are."""

FINE = 24
"""Pixels across an aperture from which a map is not coarse."""

NAMES = ("x", "y", "z", "curvature", "conic", "astigmatism", "astigmatism_45")
PLACES = 6
"""Places along a cell where it is looked whether a map holds points."""

TILES = 10
"""Parts of an aperture along each side, at most, most of which must hold points."""

UNLIKE = 0.1
"""Median distance of points from a fitted conic, over twice its sag, from which it is no lenslet."""

BLOCKS = 48
"""Block means over an aperture along each side, at most: 10 µm of a pitch of .5 mm."""

LENS = (0.4, 2.5)
"""Range of the sag of a lenslet over that of the design's; others are land, dirt, or another thing."""

GUARD = 1.2
"""Factor by which standard deviations are stated larger than the noise of a lenslet gives them: they are
known to some per cent only, and twice them must hold 95 % of few lenslets, too."""

SMALL = 1e-13 * np.eye(7)
"""What is added to normal equations, of numbers of one size, for numbers that no point shows."""

STEPS = 8
"""Steps by which the variance of form is found; more change numbers by less than .1 of their uncertainty."""

THIN = 2500
"""Points of a lenslet of the first fit."""

FIRST = 300
"""Lenslets by which lattice, plane and the size of form are found, at most."""

BATCH = 1 << 16
"""Points that are fitted at once, those of one lenslet at least."""


@dataclass(frozen=True, eq=False)
class Aperture:
    """Measured aperture of the lenslets of a lattice: a cell, drawn in.

    normals : (k, 2). Outward unit normals of its borders.
    reach : (k,) lengths. Distance of each border from the middle.
    half : (2,) lengths. Half sizes of its bounding box.
    """

    normals: Floats
    reach: Floats
    half: Floats

    def holds(self, u: Floats, v: Floats) -> Bools:
        """Which places lie in it."""
        inside = np.ones(u.shape, dtype=bool)
        for (nx, ny), reach in zip(self.normals, self.reach, strict=True):
            inside &= nx * u + ny * v <= reach
        return inside

    def grid(self, count: int) -> Floats:
        """Middles (2, n) of those of count × count parts of the bounding box that lie in the aperture."""
        line = (np.arange(count) + 0.5) / count * 2.0 - 1.0
        places = np.stack(
            [one.ravel() for one in np.meshgrid(*(line * half for half in self.half), indexing="ij")]
        )
        return np.asarray(places[:, self.holds(*places)])


def aperture_of(design: Pattern, millimetre: float) -> Aperture:
    """Measured aperture of the cells of a design; `millimetre`: lengths of a design unit in a millimetre."""
    tile = design.tile()
    edge = np.roll(tile, -1, axis=0) - tile
    normals = np.column_stack([edge[:, 1], -edge[:, 0]]) / np.hypot(*edge.T)[:, None]
    reach = np.einsum("ij,ij->i", normals, tile)
    reach = reach - min(MARGIN * millimetre, 0.2 * float(reach.min()))
    half = np.abs(tile).max(axis=0) * (reach.min() / np.einsum("ij,ij->i", normals, tile).min())
    return Aperture(normals, reach, half)


@dataclass(frozen=True, eq=False)
class Lenslets:
    """Fitted lenslets of one side, in the axes of their lattice and the plane of their apexes.

    index : (m, 2) ints. Cells counted from the one nearest to the middle of the map.
    values : (m, 7). `NAMES`: middle and height about lattice and plane (lengths), curvature (1/length, > 0:
    dome),
        conic constant, and astigmatism at 0 and 45 degrees (1/length).
    covariance : (m, 7, 7)
    form : (m, k) lengths. Expected coefficients of Legendre polynomials over the aperture beyond the conic.
    u_form : (m, k) lengths. Standard deviations of the coefficients.
    texture : (m,) lengths. Rms of what form and fit leave.
    lattice : Found. Lattice of the middles, in the map's axes once its plane is level.
    level : (3, 3). Rotation of the map that makes the plane of the apexes level.
    plane : (3,) What is left of the plane once the map is turned: its height at the middle and slopes.
    aperture : Aperture
    empty : (k, 2) ints. Cells in the map that hold no lenslet: no points, or another surface.
    """

    index: Ints
    values: Floats
    covariance: Floats
    form: Floats
    u_form: Floats
    texture: Floats
    lattice: Found
    level: Floats
    plane: Floats
    aperture: Aperture
    empty: Ints

    @cached_property
    def u(self) -> Floats:
        """Standard deviations (m, 7) of `values`."""
        return np.asarray(np.sqrt(np.einsum("mii->mi", self.covariance)))

    @property
    def pitch(self) -> tuple[float, float]:
        """Lengths of the steps of the lattice along i and j."""
        x, y = np.hypot(*self.lattice.basis)
        return float(x), float(y)

    @property
    def pose(self) -> tuple[float, float, float]:
        """Angles T, a, b (radians): the map is Rz(T) Rx(a) Ry(b) of the part, whose x runs along the step
        i.
        """
        step = _axes(self.lattice)[:, 0]
        along = self.level.T @ np.append(step, self.plane[1:] @ step)
        along, normal = along / np.linalg.norm(along), (_levelling(self.plane[1:]) @ self.level)[2]
        across = np.cross(normal, along)
        return (
            float(np.arctan2(-across[0], across[1])),
            float(np.arcsin(across[2])),
            float(np.arctan2(-along[2], normal[2])),
        )

    @property
    def apexes(self) -> Floats:
        """Highest points (m, 3) of the lenslets above their plane, in the axes of the map."""
        x, y = (self.lattice.centres(self.index) + self.values[:, :2] @ _axes(self.lattice).T).T
        return np.column_stack([x, y, self.values[:, 2] + self.plane @ [np.ones(len(x)), x, y]]) @ self.level

    def placed(self, points: Floats) -> tuple[Ints, Floats]:
        """Number (n,) of the lenslet in whose cell points (3, n) of the map lie, −1 for none, and the points
        (3, n) in the axes of their cells, heights above the plane of the apexes.
        """
        x, y, z = self.level @ points
        cell, off = self.lattice.nearest(x, y)
        low = self.index.min(axis=0)
        table = np.full(np.ptp(self.index, axis=0) + 3, -1, dtype=np.int64)
        table[tuple((self.index - low + 1).T)] = np.arange(len(self.index))
        at = [np.clip(cell[k] - low[k] + 1, 0, table.shape[k] - 1) for k in (0, 1)]
        height = z - self.plane[0] - self.plane[1] * x - self.plane[2] * y
        return table[at[0], at[1]], np.vstack([_axes(self.lattice).T @ off, height])

    def seen(self, measured: MeasuredMap) -> Floats:
        """Places (m, 3) of a map in the axes of its cells, from the centre of cell (0, 0), and whether most
        points were measured there (1 or 0).
        """
        size = 2.0 * float(self.aperture.half.min()) / PLACES
        edges = []
        for count, pixel in zip(measured.shape[::-1], measured.pixel, strict=True):
            places = max(2, int(count * pixel / size))
            edges.append(0.5 * count * pixel * np.linspace(-1.0, 1.0, places + 1))
        held = np.histogram2d(measured.points[0], measured.points[1], (edges[0], edges[1]))[0]
        x, y = np.meshgrid(*(0.5 * (one[1:] + one[:-1]) for one in edges), indexing="ij")
        normal = self.level[2]
        flat = np.stack([x, y, -(normal[0] * x + normal[1] * y) / normal[2]]).reshape(3, -1)
        off = (self.level @ flat)[:2] - self.lattice.origin[:, None]
        found = held.ravel() > HALF * np.median(held[held > 0.0])
        return np.column_stack([(_axes(self.lattice).T @ off).T, found])

    def land(self, measured: MeasuredMap) -> Floats:
        """Points (3, n) of a map that lie in no cell with a lenslet, or some of them, from the centre of cell
        (0, 0) in its axes; heights above the plane of the apexes.
        """
        points = thinned(measured.points)
        bare = self.level @ points[:, self.placed(points)[0] < 0]
        height = bare[2] - self.plane[0] - self.plane[1:] @ bare[:2]
        return np.vstack([_axes(self.lattice).T @ (bare[:2] - self.lattice.origin[:, None]), height])

    def heights(self, number: int, u: Floats, v: Floats, values: Floats | None = None) -> Floats:
        """Form (n,) of one lenslet over places of its cell: the conic, and what the fit leaves of it."""
        fitted, _ = conic(self.values[number] if values is None else values, u, v, slopes=False)
        return np.asarray(fitted + self.forms(u, v) @ self.form[number])

    def forms(self, u: Floats, v: Floats) -> Floats:
        """Polynomials (n, k) of the form over places of a cell; beyond the aperture with their slopes at its
        border.
        """
        at = np.stack([u, v]) / self.aperture.half[:, None]
        near, count = np.clip(at, -1.0, 1.0), self.form.shape[1]
        found = legendre(near[0], near[1], count)
        out = (near != at).any(axis=0)
        s, t = (2.0 * near - at)[:, out]
        found[out] = 2.0 * found[out] - legendre(s, t, count)
        return found


def conic(values: Floats, u: Floats, v: Floats, slopes: bool = True) -> tuple[Floats, Floats]:
    """Heights (n,) of a lenslet over places of its cell, and its derivatives (7, n) to its numbers (7,).

    Of many lenslets at once: numbers (m, 7), places (m, n) or (n,), heights (m, n), derivatives (m, 7, n).
    """
    x0, y0, z0, c, k, a, b = np.moveaxis(values, -1, 0)[..., None]
    x, y = u - x0, v - y0
    xx, yy, xy = x * x, y * y, x * y
    r2 = xx + yy
    w = np.sqrt(np.maximum(1.0 - (1.0 + k) * c * c * r2, 1e-6))
    deep = r2 / (1.0 + w)
    z = z0 - c * deep - a * (xx - yy) - 2.0 * b * xy
    if not slopes:
        return z, np.empty((0, 7))
    slope = np.empty((*z.shape[:-1], 7, z.shape[-1]))
    bend = c / w
    slope[..., 0, :] = (bend + 2.0 * a) * x + 2.0 * b * y
    slope[..., 1, :] = (bend - 2.0 * a) * y + 2.0 * b * x
    slope[..., 2, :] = 1.0
    slope[..., 3, :] = -deep / w
    slope[..., 4, :] = -0.5 * c * c * bend * deep * deep
    slope[..., 5, :] = yy - xx
    slope[..., 6, :] = -2.0 * xy
    return z, slope


@dataclass(frozen=True, eq=False)
class OwnPoints:
    """Points of a map by their lenslets.

    order : (n,) Numbers of the points, those of one lenslet after those of another.
    first, count : (m,) Where those of each lenslet begin there, and how many there are.
    """

    order: Ints
    first: Ints
    count: Ints

    @staticmethod
    def of(number: Ints, most: int) -> OwnPoints:
        """Points by the number (n,) of their lenslet, less than `most`; −1: of none."""
        order = np.argsort(number.astype(np.min_scalar_type(-most - 1)), kind="stable")
        ends = np.cumsum(np.bincount(number + 1, minlength=most + 1))
        return OwnPoints(order, ends[:-1], np.diff(ends))

    def batches(self, thin: int | None = None) -> Iterator[tuple[slice, Ints, Bools]]:
        """Lenslets (k of them), numbers (k, w) of their points, and which are theirs: others fill the rows.

        thin : Points of a lenslet of which only a part is taken: every second, third … of more.
        """
        widest = int(self.count.max(initial=1))
        step = 1 if thin is None else max(1, widest // thin)
        many = max(1, BATCH * step // widest)
        for k in range(0, len(self.count), many):
            count, first = self.count[k : k + many, None], self.first[k : k + many, None]
            at = np.arange(0, max(1, int(count.max())), step)
            yield slice(k, k + many), self.order[np.minimum(first + at, len(self.order) - 1)], at < count


def medians(values: Floats, held: Bools) -> Floats:
    """Median (m,) of those values (m, n) that are held: the others count in turn as low and as high."""
    if not held.all():
        other = np.where(np.cumsum(~held, axis=-1) % 2, np.inf, -np.inf)
        values = np.where(held, values, other)
    return np.asarray(np.median(values, axis=-1))


@dataclass(frozen=True, eq=False)
class _Grid:
    """Block means over an aperture.

    side : Blocks along each side of its bounding box.
    inside : (blocks,) Those whose middle lies in the aperture.
    places : (2, k) lengths. Middles of those inside.
    basis : (k, c). Legendre polynomials there.
    inverse : (c, k). Coefficients of heights there, by least squares.
    waves : (w, k) complex. Waves shorter than the polynomials, down to half as long, by which noise is found.
    power : Sum of the squares of their coefficients of white noise of rms 1, less fitted polynomials.
    """

    aperture: Aperture
    side: int
    inside: Ints
    places: Floats
    basis: Floats
    inverse: Floats
    waves: NDArrayComplex
    power: float

    def block(self, u: Floats, v: Floats) -> Ints:
        """Block of each place."""
        i, j = parts_of(u, v, self.aperture.half, self.side)
        return np.asarray(i * self.side + j)

    def noise(self, weight: Floats, rest: Floats) -> Floats:
        """Variance (m,) of a single point of each lenslet, as far as it reaches the numbers of a lenslet.

        Of noise that is not white only long waves reach them. Those of the polynomials are gone from what the
        fit leaves; the next shorter ones are taken for them.

        weight, rest : (m, k) Points of each block, and mean of what the fit leaves of them.
        """
        used = (weight > 0.0).sum(axis=-1)
        found = np.abs((np.sqrt(weight) * rest) @ self.waves.T) ** 2
        return np.asarray(found.sum(axis=-1) / (self.power * used / weight.shape[-1]))


def _grid(aperture: Aperture, pixel: float) -> _Grid:
    """Blocks of at least two pixels a side."""
    across = 2.0 * float(aperture.half.min()) / pixel
    side = int(np.clip(across / 2.0, 5, BLOCKS))
    degree = DEGREE if across >= FINE else COARSE_DEGREE
    line = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    gx, gy = (one.ravel() for one in np.meshgrid(*(line * half for half in aperture.half), indexing="ij"))
    inside = np.flatnonzero(aperture.holds(gx, gy))
    places = np.stack([gx[inside], gy[inside]])
    scaled = places / aperture.half[:, None]
    basis = legendre(scaled[0], scaled[1], (degree + 1) * (degree + 2) // 2)
    waves = _waves(scaled, 0.5 * (degree + 1), 0.5 * (side - 1))
    fitted = np.linalg.qr(basis)[0]
    power = waves.shape[0] * waves.shape[1] - float((np.abs(waves @ fitted) ** 2).sum())
    inverse = np.asarray(np.linalg.pinv(basis), dtype=np.float64)
    return _Grid(aperture, side, inside, places, basis, inverse, waves, power)


def _waves(scaled: Floats, longest: float, shortest: float) -> NDArrayComplex:
    """Waves (w, k) at places (2, k) in [−1, 1], of `longest` cycles and at most twice as many."""
    most = int(min(2.0 * longest, shortest))
    cycles = np.array([(i, j) for i in range(most + 1) for j in range(-most, most + 1) if i > 0 or j > 0])
    length = np.hypot(*cycles.T)
    kept = cycles[(length > longest) & (length <= max(2.0 * longest, length.min()))]
    return np.asarray(np.exp(1j * np.pi * (kept if len(kept) else cycles) @ scaled))


def parts_of(u: Floats, v: Floats, bounds: Floats, bins: int) -> tuple[Ints, Ints]:
    """Numbers along both sides of the part of a bounding box (half sizes `bounds`) of each place."""
    i, j = (
        np.clip(((one / half + 1.0) * (0.5 * bins)).astype(np.int64), 0, bins - 1)
        for one, half in zip((u, v), bounds, strict=True)
    )
    return i, j


Targets = Callable[[Ints], Floats]
"""Steps (m, 2) of the map's lattice → numbers (m, 7) of the design's lenslets there, in the axes of their
cells."""


def fit_lenslets(measured: MeasuredMap, design: Pattern, aperture: Aperture, targets: Targets) -> Lenslets:
    """Find and fit every whole lenslet of a map.

    measured : lengths in design units
    design : Cells of the face, in the axes of a map.
    Raises NotMeasurable: As `find_lattice`; or no whole lenslet.
    """
    level = _levelling(plane_of(measured.points)[1:])
    start = targets(np.zeros((1, 2), dtype=np.int64))[0]
    found = find_lattice(
        replace(measured, points=level @ measured.points),
        design,
        lambda u, v: conic(start, u, v, slopes=False)[0],
    )
    grid = _grid(aperture, max(measured.pixel))
    lenslets = prod(measured.shape) * prod(measured.pixel) / float(np.prod(2.0 * aperture.half))
    few, first = thinned(measured.points, max(SOME, int(THIN * lenslets))), np.zeros(7)
    alike = np.ptp(targets(np.array([[0, 0], [1, 0], [0, 1]])), axis=0).any() == 0
    for last in (False, True) if alike else (False, False, True):  # middles of cells follow from lenses
        points = level @ (measured.points if last else few)
        cells, (u, v), groups = _grouped(points, found, aperture, grid, None if last else FIRST)
        wanted = targets(cells)
        fitted = _first_fits(groups, u, v, points[2], wanted + first)
        kept = np.flatnonzero(_are_lenses(fitted, wanted, aperture))
        if not len(kept):
            raise NotMeasurable(
                f"{measured.name}: no whole lenslet: a cell is whole where its measured aperture"
                f" lies in the map and {100 * PRESENT:g} % of its parts hold points"
            )
        index, wanted, values = cells[kept], wanted[kept], fitted[kept, :7]
        if last:
            groups = OwnPoints(groups.order, groups.first[kept], groups.count[kept])
            fits = _refined(_all_sums(groups, u, v, points[2], values, grid), grid)
            values = fits.values
        found, plane, values = _placed(found, index, values, wanted)
        if not last:
            level = _levelling(plane[1:]) @ level
            first = np.median(values - wanted, axis=0) * [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]
    return Lenslets(
        index,
        values,
        GUARD**2 * fits.covariance,
        fits.form,
        GUARD * fits.u_form,
        fits.texture,
        found,
        level,
        plane,
        aperture,
        _empty(measured, few, level, found, aperture, cells, index),
    )


def _empty(
    measured: MeasuredMap,
    points: Floats,
    level: Floats,
    found: Found,
    aperture: Aperture,
    seen: Ints,
    index: Ints,
) -> Ints:
    """Cells (k, 2) whose apertures lie in a map, and which hold few points, or no lenslet but points enough.

    points : (3, n) of the map; seen : (s, 2) Cells with points enough for a fit; index : (m, 2) the lenslets.
    """
    size = 0.5 * np.array(measured.shape[::-1]) * measured.pixel
    reach = int(np.hypot(*size) / np.hypot(*found.basis).min()) + 1
    every = np.stack(np.meshgrid(*(np.arange(-reach, reach + 1),) * 2), axis=-1).reshape(-1, 2)
    corners = _axes(found) @ (aperture.half[:, None] * [[-1, -1, 1, 1], [-1, 1, -1, 1]])
    at = found.centres(every)[:, :, None] + corners
    flat = np.einsum("ik,mkc->mic", level.T[:2, :2], at)
    every = every[(np.abs(flat) <= size[:, None]).all(axis=(1, 2))]

    def counted(cells: Ints) -> Ints:
        rows = 2 * reach + 3
        i, j = np.clip(cells + reach + 1, 0, rows - 1)
        return np.bincount(i * rows + j, minlength=rows * rows).reshape(rows, rows)

    held, fitted, lenses = (counted(one) for one in (found.nearest(*level[:2] @ points)[0], seen.T, index.T))
    usual = np.median(held[tuple((index + reach + 1).T)])
    bare = (fitted > lenses) | (held < HALF * usual)
    return np.asarray(every[bare[tuple((every + reach + 1).T)]])


HALF = 0.5
"""Share of the usual number of points below which a cell holds no lenslet."""


def _are_lenses(fitted: Floats, wanted: Floats, aperture: Aperture) -> Bools:
    """Which fits (m, 8) are those of lenslets of the design: by sag and middle; and whether points follow
    them, as those of letters do not.
    """
    reach = float(aperture.half.max())

    def sag(numbers: Any) -> Floats:
        """Sag (m,) of conics at the border of the aperture."""
        c = numbers[:, 3]
        return Quadric(c, c, (1.0 + numbers[:, 4]) * c).sag(np.full(len(c), reach), 0.0)

    with np.errstate(all="ignore"):  # of no lenslet anything may come
        known = np.asarray((np.abs(fitted) < 1e30).all(axis=1))
        ratio = sag(np.where(known[:, None], fitted, 0.0)) / sag(wanted)
        aside = np.abs(fitted[:, :2] - wanted[:, :2]) / aperture.half
        follow = fitted[:, 7] <= UNLIKE * np.abs(wanted[:, 3]) * reach**2
        return np.asarray(
            known & (ratio >= LENS[0]) & (ratio <= LENS[1]) & (aside <= 0.5).all(axis=1) & follow
        )


def _levelling(slopes: Floats) -> Floats:
    """Rotation (3, 3) that makes a plane of these slopes level, about a level axis."""
    normal = np.array([-slopes[0], -slopes[1], 1.0]) / np.sqrt(1.0 + slopes @ slopes)
    x, y, z = normal
    return np.array(
        [
            [1.0 - x * x / (1.0 + z), -x * y / (1.0 + z), -x],
            [-x * y / (1.0 + z), 1.0 - y * y / (1.0 + z), -y],
            normal,
        ]
    )


def _grouped(
    points: Floats, found: Found, aperture: Aperture, grid: _Grid, most: int | None
) -> tuple[Ints, Floats, OwnPoints]:
    """Whole cells (m, 2), or `most` of them, and their points: places (2, n) of all in the axes of their
    cells, from their centres, and which belong to which.
    """
    cell, off = found.nearest(points[0], points[1])
    u, v = off = _axes(found).T @ off
    low = cell.min(axis=1)
    rows = int(np.ptp(cell[1])) + 1
    number = (cell[0] - low[0]) * rows + cell[1] - low[1]
    number[~aperture.holds(u, v)] = -1
    count = np.bincount(number + 1, minlength=1)[1:]
    held = np.flatnonzero(count >= 2 * grid.basis.shape[1])
    cells = np.column_stack(np.divmod(held, rows)) + low
    corners = np.array([[sx * aperture.half[0], sy * aperture.half[1]] for sx in (-1, 1) for sy in (-1, 1)])
    at = found.centres(cells)[:, None] + corners @ _axes(found).T
    edges = [points[:2].min(axis=1), points[:2].max(axis=1)]
    room = 1e-3 * float(aperture.half.min())
    whole = ((at >= edges[0] - room) & (at <= edges[1] + room)).all(axis=(1, 2))

    number, cells = _renumbered(number, held[whole]), cells[whole]
    whole = _are_whole(number, u, v, len(cells), aperture, min(TILES, max(3, grid.side // 3)))
    kept = np.flatnonzero(whole)
    if most is not None and len(kept) > most:
        kept = np.sort(np.random.default_rng(0).permutation(kept)[:most])
    return cells[kept], off, OwnPoints.of(_renumbered(number, kept), len(kept))


def _renumbered(number: Ints, kept: Ints) -> Ints:
    """Numbers (n,) of points, those of the kept cells counted from 0; −1 for others."""
    table = np.full(int(number.max(initial=0)) + 2, -1, dtype=np.int64)
    table[kept] = np.arange(len(kept))
    return np.asarray(table[number])


def _axes(found: Found) -> Floats:
    """Axes of the cells, columns, in those of the map: along the step i, less the turn of the design's."""
    x, y = found.basis[:, 0] / np.hypot(*found.basis[:, 0])
    c, s = np.cos(found.turn), np.sin(found.turn)
    x, y = c * x + s * y, c * y - s * x
    return np.array([[x, -y], [y, x]])


def _are_whole(number: Ints, u: Floats, v: Floats, cells: int, aperture: Aperture, tiles: int) -> Bools:
    """Whether the points of each cell, by the number (n,) of theirs, cover its aperture."""
    line = (np.arange(tiles) + 0.5) / tiles * 2.0 - 1.0
    gx, gy = np.meshgrid(*(line * half for half in aperture.half), indexing="ij")
    wanted = aperture.holds(gx.ravel(), gy.ravel())
    i, j = parts_of(u, v, aperture.half, tiles)
    tile = np.where(number < 0, 0, number * tiles * tiles + i * tiles + j + 1)
    count = np.bincount(tile, minlength=cells * tiles * tiles + 1)[1:].reshape(cells, -1)
    usual = np.median(count[:, wanted], axis=1) if cells else np.zeros(0)
    held = (count >= np.maximum(1.0, 0.2 * usual)[:, None]) | ~wanted
    square = held.reshape(cells, tiles, tiles)
    sides = np.stack([square[:, 0], square[:, -1], square[:, :, 0], square[:, :, -1]]).mean(axis=2)
    return np.asarray((held[:, wanted].mean(axis=1) >= PRESENT) & (sides >= ALONG).all(axis=0))


def _first_fits(groups: OwnPoints, u: Floats, v: Floats, z: Floats, start: Floats) -> Floats:
    """Numbers of all lenslets by a part of their points, and the median distance (m, 8) of these."""
    found = np.empty((len(start), 8))
    with np.errstate(over="ignore", invalid="ignore"):  # of no lenslet anything may come
        for some, rows, held in groups.batches(THIN):
            own = u[rows], v[rows], z[rows]
            values = start[some].copy()
            values[:, 2] += medians(own[2] - conic(values, *own[:2], slopes=False)[0], held)
            values = _solved(values, *own, 2, held)
            kept = _near(own[2] - conic(values, *own[:2], slopes=False)[0], held)
            found[some, :7] = values = _solved(values, *own, 2, kept)
            off = np.abs(own[2] - conic(values, *own[:2], slopes=False)[0])
            found[some, 7] = medians(off, held)
    return found


class _Sums(NamedTuple):
    """Block means of what the first fits of lenslets leave.

    values : (m, 7) The first fits.
    weight, mean : (m, blocks) Points of each block inside, and their mean.
    square, form : (m, c, c), (m, c) Normal equations of Legendre polynomials over them, and their solution.
    own : (m, c, c). Takes from coefficients what the conic can follow.
    share : (m, 7, c). Numbers of the conic that follow coefficients, by least squares over all the aperture.
    spread : (m,) Variance of a point.
    texture : (m,) Rms of what the polynomials leave of single points.
    """

    values: Floats
    weight: Floats
    mean: Floats
    square: Floats
    form: Floats
    own: Floats
    share: Floats
    spread: Floats
    texture: Floats

    def inverse(self, weak: Floats) -> Floats:
        """Inverse (m, c, c) of the normal equations with the weights `weak` (c,) of form beyond the conic."""
        return np.asarray(np.linalg.inv(self.square + self.own.swapaxes(1, 2) @ (weak[:, None] * self.own)))

    def variances(self, inverse: Floats) -> Floats:
        """Variances (m, c) of the coefficients of form beyond the conic."""
        return np.asarray(self.spread[:, None] * ((self.own @ inverse) * self.own).sum(axis=2))

    def some(self, which: slice | Ints) -> _Sums:
        """Those of some lenslets."""
        return _Sums(*(one[which] for one in self))


def _all_sums(groups: OwnPoints, u: Floats, v: Floats, z: Floats, values: Floats, grid: _Grid) -> _Sums:
    """Block means of all lenslets."""
    parts = [
        _sums(u[rows], v[rows], z[rows], held, values[some], grid) for some, rows, held in groups.batches()
    ]
    return _Sums(*(np.concatenate(one) for one in zip(*parts, strict=True)))


def _sums(u: Floats, v: Floats, z: Floats, held: Bools, values: Floats, grid: _Grid) -> _Sums:
    """Block means of lenslets by all their points (m, n) that are held, without spikes and dirt."""
    off = z - conic(values, u, v, slopes=False)[0]
    block = grid.block(u, v)
    smooth = np.zeros((len(values), grid.side * grid.side))
    smooth[:, grid.inside] = _form(off, block, _near(off, held), grid)[0] @ grid.basis.T
    kept = _near(off - np.take_along_axis(smooth, block, 1), held)
    form, square, weight, mean = _form(off, block, kept, grid)
    smooth[:, grid.inside] = fitted = form @ grid.basis.T
    slopes = conic(values, *grid.places)[1]
    # the aperture as a whole counts, not the points that were not lost: of both the form is weighed alike
    share = _least_squares(slopes, np.ones_like(weight), mean)[1] @ grid.basis
    own = np.eye(form.shape[1]) - grid.inverse @ slopes.swapaxes(1, 2) @ share
    spread = np.maximum(grid.noise(weight, mean - fitted), 1e-300)
    rest = np.where(kept, off - np.take_along_axis(smooth, block, 1), 0.0)
    texture = np.sqrt((rest * rest).sum(axis=1) / np.maximum(kept.sum(axis=1), 1))
    return _Sums(values, weight, mean, square, form, own, share, spread, texture)


class _Fits(NamedTuple):
    values: Floats
    covariance: Floats
    form: Floats
    u_form: Floats
    texture: Floats


def _refined(every: _Sums, grid: _Grid) -> _Fits:
    """Numbers and forms of all lenslets of a map, with their covariances.

    Form beyond the conic has, in each degree, the variance that the lenslets of the map show, and the mean 0.
    It decides where no points are: the numbers are those of the form over the whole aperture.
    """
    lenslets, fits = len(every.values), []
    chosen = np.unique(np.linspace(0, lenslets - 1, min(FIRST, lenslets)).astype(np.int64))
    weak = _weakness(every.some(chosen), grid.basis.shape[1])
    for k in range(0, lenslets, FIRST):
        one = every.some(slice(k, k + FIRST))
        inverse = one.inverse(weak)
        right = (one.weight * one.mean) @ grid.basis
        form = (one.own @ (inverse @ right[..., None]))[..., 0]
        straight, best = _least_squares(conic(one.values, *grid.places)[1], one.weight, one.mean)
        values = one.values + straight - (best @ (form @ grid.basis.T)[..., None])[..., 0]
        covariance = one.spread[:, None, None] * (one.share @ inverse @ one.share.swapaxes(1, 2))
        u_form = np.sqrt(np.maximum(one.variances(inverse), 0.0))
        fits.append(_Fits(values, covariance, form, u_form, one.texture))
    return _Fits(*(np.concatenate(one) for one in zip(*fits, strict=True)))


def _weakness(every: _Sums, count: int) -> Floats:
    """Weight (c,), in points, of the expectation that a coefficient is 0: noise over form (variances).

    Most likely variance of the coefficients of each degree, found by steps of expectation and maximization;
    degrees that the conic follows are free.
    """
    degree = np.array([d for d in range(count) for _ in range(d + 1)])[:count]
    noise = float(np.mean(every.spread))
    weak = np.where(degree < 3, 0.0, PRIOR)
    right = every.square @ every.form[..., None]
    for _ in range(STEPS):
        inverse = every.inverse(weak)
        form = (every.own @ (inverse @ right))[..., 0]
        seen = (form**2 + every.variances(inverse)).mean(axis=0)
        for d in range(3, int(degree[-1]) + 1):
            weak[degree == d] = noise / max(float(seen[degree == d].mean()), 1e-300)
    return weak


def pooled_form(u: Floats, v: Floats, off: Floats, aperture: Aperture, pixel: float) -> tuple[Floats, Floats]:
    """Legendre coefficients (c,) of heights (n,) over places of a cell, and their standard deviations.

    Points of several cells at once give the form that their cells share. Spikes are left out.

    pixel : length. Distance of neighbouring points of one cell.
    """
    inside = aperture.holds(u, v)
    u, v, off = u[None, inside], v[None, inside], off[None, inside]
    grid = _grid(aperture, pixel)
    block, every = grid.block(u, v), np.ones(u.shape, dtype=bool)
    smooth = np.zeros(grid.side * grid.side)
    form, square, weight, mean = _form(off, block, _near(off, every), grid)
    for _ in range(2):
        smooth[grid.inside] = grid.basis @ form[0]
        form, square, weight, mean = _form(off, block, _near(off - smooth[block], every), grid)
    covariance = np.linalg.inv(square[0] + PRIOR * np.eye(form.shape[1]))
    covariance *= GUARD**2 * grid.noise(weight, mean - form @ grid.basis.T)
    return form[0], np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def _least_squares(slopes: Floats, weight: Floats, mean: Floats) -> tuple[Floats, Floats]:
    """Weighted least squares: solutions (m, 7), and the matrices (m, 7, k) that give them of heights (m, k).

    slopes : (m, 7, k)
    """
    size = np.abs(slopes).max(axis=2, keepdims=True)  # not their rms: squares of a hostile map's may overflow
    size[size == 0.0] = 1.0
    scaled = slopes / size
    weighted = scaled * weight[:, None]
    square = weighted @ scaled.swapaxes(1, 2)
    square += SMALL * np.trace(square, axis1=1, axis2=2)[:, None, None]
    best = np.linalg.solve(square, weighted) / size
    return (best @ mean[..., None])[..., 0], best


def fit_heights(
    aperture: Aperture, heights: Callable[[Floats, Floats], Floats], start: Floats, rounds: int = 12
) -> Floats:
    """Numbers (7,) of a lenslet whose heights over places are known, by the same least squares.

    start : (7,) numbers near them.
    """
    u, v = aperture.grid(BLOCKS)
    return _solved(start, u, v, heights(u, v), rounds)


def _form(off: Floats, block: Ints, kept: Bools, grid: _Grid) -> tuple[Floats, Floats, Floats, Floats]:
    """Legendre coefficients (m, c) of what fits leave (m, n), by weighted block means.

    Returns coefficients, matrices of the normal equations, weight and mean of each block inside.
    """
    lenslets, size = len(off), grid.side * grid.side
    flat = (block + size * np.arange(lenslets)[:, None])[kept]
    weight, total = (
        np.bincount(flat, one, lenslets * size).reshape(lenslets, size)[:, grid.inside]
        for one in (None, off[kept])
    )
    mean = total / np.maximum(weight, 1.0)
    weighted = grid.basis.T * weight[:, None]
    square = weighted @ grid.basis
    ridge = square + PRIOR * np.eye(square.shape[1])
    form = np.linalg.solve(ridge, weighted @ mean[..., None])[..., 0]
    return np.asarray(form), square, np.asarray(weight, dtype=np.float64), mean


def _solved(
    values: Floats, u: Floats, v: Floats, z: Floats, rounds: int, held: Bools | None = None
) -> Floats:
    """Numbers of lenslets after some steps of Gauss and Newton, by the points that are held, or all."""
    for _ in range(rounds):
        fitted, slope = conic(values, u, v)
        if held is not None:
            slope *= held[..., None, :]
        scale = 1.0 / np.sqrt(np.maximum(np.square(slope).sum(axis=-1), 1e-300))
        slope *= scale[..., None]
        square, right = slope @ slope.swapaxes(-1, -2), slope @ (z - fitted)[..., None]
        step = np.linalg.solve(np.nan_to_num(square) + SMALL, np.nan_to_num(right))
        values = values + scale * step[..., 0]
    return values


def _near(off: Floats, held: Bools) -> Bools:
    """Which distances (m, n) of those held are no spikes and no dirt."""
    off = off - medians(off, held)[:, None]
    spread = medians(np.abs(off), held)
    return np.asarray(held & (np.abs(off) <= CLIPPED * np.maximum(1.4826 * spread, 1e-300)[:, None]))


def _placed(found: Found, index: Ints, values: Floats, wanted: Floats) -> tuple[Found, Floats, Floats]:
    """Lattice of the cells and plane (3,) of their apexes, and the numbers of lenslets about both.

    The cells lie where the lenslets would be as far from their middles and planes as those of the design.
    """
    middles = found.centres(index) + values[:, :2] @ _axes(found).T
    centres = middles - wanted[:, :2] @ _axes(found).T
    design = np.column_stack([np.ones(len(index)), index])
    solved = np.linalg.lstsq(design, centres, rcond=None)[0]
    if np.linalg.matrix_rank(design) < 3:  # cells in one row: the steps across it are those of the maxima
        solved = np.vstack([(centres - index @ found.basis.T).mean(axis=0), found.basis.T])
    lattice = replace(found, origin=solved[0], basis=np.asarray(solved[1:].T))
    plane = np.column_stack([np.ones(len(index)), middles])
    if np.linalg.matrix_rank(plane) < 3:
        plane[:, 1:] = 0.0
    slopes = np.linalg.lstsq(plane, values[:, 2] - wanted[:, 2], rcond=None)[0]
    moved = values.copy()
    moved[:, :2] = (middles - lattice.centres(index)) @ _axes(lattice)
    moved[:, 2] = values[:, 2] - plane @ slopes
    return lattice, np.asarray(slopes), moved
