"""Lenslets of a map, each fitted by a conic with astigmatism, and the lattice and plane on which they lie.

The radius, conic constant, middle and astigmatism of a lenslet are those of the least squares of vertical
distances over the measured aperture: its cell less a margin all round. They depend on that aperture.
Distances beyond
`CLIPPED` times the median absolute deviation are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import prod

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.measuring.find_lattice import Found, NDArrayComplex, NotMeasurable, find_lattice
from clacad.measuring.read_map import MeasuredMap
from clacad.optics.fit import legendre
from clacad.sheet.pattern import Pattern, Step

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

STEPS = 8
"""Steps by which the variance of form is found; more change numbers by less than .1 of their uncertainty."""

THIN = 2500
"""Points of a lenslet of the first fit."""

LARGE = 500_000
"""Points of a map from which a part of them places its cells."""


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
        """Which places (n,) lie in it."""
        inside = np.ones(len(u), dtype=bool)
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

    @property
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
        cell = np.rint(self.lattice.index(x, y)).astype(np.int64)
        off = np.stack([x, y]) - self.lattice.centres(cell.T).T
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
        points = measured.points
        points = _some(points, LARGE / points.shape[1])
        bare = self.level @ points[:, self.placed(points)[0] < 0]
        height = bare[2] - self.plane[0] - self.plane[1:] @ bare[:2]
        return np.vstack([_axes(self.lattice).T @ (bare[:2] - self.lattice.origin[:, None]), height])

    def heights(self, number: int, u: Floats, v: Floats, values: Floats | None = None) -> Floats:
        """Form (n,) of one lenslet over places of its cell: the conic, and what the fit leaves of it."""
        fitted, _ = conic(self.values[number] if values is None else values, u, v, slopes=False)
        at = np.stack([u, v]) / self.aperture.half[:, None]
        near = np.clip(at, -1.0, 1.0)
        form = self.form[number]
        rest = legendre(near[0], near[1], len(form)) @ form
        out = (near != at).any(axis=0)  # beyond the aperture form goes on with its slope at the border
        s, t = (2.0 * near - at)[:, out]
        rest[out] = 2.0 * rest[out] - legendre(s, t, len(form)) @ form
        return np.asarray(fitted + rest)


def conic(values: Floats, u: Floats, v: Floats, slopes: bool = True) -> tuple[Floats, Floats]:
    """Height (n,) of a lenslet over places of its cell, and its derivatives (n, 7) to its numbers."""
    x0, y0, z0, c, k, a, b = values
    x, y = u - x0, v - y0
    r2 = x * x + y * y
    w = np.sqrt(np.maximum(1.0 - (1.0 + k) * c * c * r2, 1e-6))
    z = z0 - c * r2 / (1.0 + w) - a * (x * x - y * y) - 2.0 * b * x * y
    if not slopes:
        return z, np.empty((0, 7))
    slope = np.empty((len(u), 7))
    slope[:, 0] = c * x / w + 2.0 * a * x + 2.0 * b * y
    slope[:, 1] = c * y / w - 2.0 * a * y + 2.0 * b * x
    slope[:, 2] = 1.0
    slope[:, 3] = -r2 / ((1.0 + w) * w)
    slope[:, 4] = -0.5 * c**3 * r2 * r2 / (w * (1.0 + w) ** 2)
    slope[:, 5] = y * y - x * x
    slope[:, 6] = -2.0 * x * y
    return z, slope


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
        """Block (n,) of each place."""
        i, j = parts_of(u, v, self.aperture.half, self.side)
        return np.asarray(i * self.side + j)

    def noise(self, weight: Floats, rest: Floats) -> float:
        """Variance of a single point, as far as it reaches the numbers of a lenslet.

        Of noise that is not white only long waves reach them. Those of the polynomials are gone from what the
        fit leaves; the next shorter ones are taken for them.

        weight, rest : (k,) Points of each block, and mean of what the fit leaves of them.
        """
        used = float((weight > 0.0).sum())
        found = np.abs(self.waves @ (np.sqrt(weight) * rest)) ** 2
        return float(found.sum()) / (self.power * used / len(weight))


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
    """Numbers (n,) along both sides of the part of a bounding box (half sizes `bounds`) of each place."""
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
    level = _levelling(plane_of(measured.points))
    start = targets(np.zeros((1, 2), dtype=np.int64))[0]
    found = find_lattice(
        replace(measured, points=level @ measured.points),
        design,
        lambda u, v: conic(start, u, v, slopes=False)[0],
    )
    grid = _grid(aperture, max(measured.pixel))
    few = _some(measured.points, THIN * prod(measured.pixel) / float(np.prod(2.0 * aperture.half)))
    alike = np.ptp(targets(np.array([[0, 0], [1, 0], [0, 1]])), axis=0).any() == 0
    for last in (False, True) if alike else (False, False, True):  # middles of cells follow from lenses
        cells, groups = _grouped(level @ (measured.points if last else few), found, aperture, grid)
        wanted = targets(np.array(cells, dtype=np.int64).reshape(-1, 2))
        first = [_fitted(group, one) for group, one in zip(groups, wanted, strict=True)]
        kept = [k for k, one in enumerate(first) if _is_lens(one, wanted[k], aperture, groups[k])]
        if not kept:
            raise NotMeasurable(
                f"{measured.name}: no whole lenslet: a cell is whole where its measured aperture"
                f" lies in the map and {100 * PRESENT:g} % of its parts hold points"
            )
        values = np.array([first[k] for k in kept])
        if last:
            fits = _refined([_sums(groups[k], one, grid) for k, one in zip(kept, values, strict=True)], grid)
            values = np.array([one.values for one in fits])
        index = np.array(cells)[kept]
        found, plane, values = _placed(found, index, values, wanted[kept])
        if not last:
            level = _levelling(plane[1:]) @ level
    covariance, form, u_form, texture = (
        np.array([getattr(one, name) for one in fits]) for name in ("covariance", "form", "u_form", "texture")
    )
    empty = _empty(measured, few, level, found, aperture, cells, index)
    return Lenslets(
        index,
        values,
        GUARD**2 * covariance,
        form,
        GUARD * u_form,
        texture,
        found,
        level,
        plane,
        aperture,
        empty,
    )


def _some(points: Floats, share: float) -> Floats:
    """A share of the points (3, n) of a large map, which places its cells; all of a small one."""
    if points.shape[1] <= LARGE:
        return points
    return points[:, np.random.default_rng(0).random(points.shape[1]) < share]


def _empty(
    measured: MeasuredMap,
    points: Floats,
    level: Floats,
    found: Found,
    aperture: Aperture,
    seen: Sequence[Step],
    index: Ints,
) -> Ints:
    """Cells (k, 2) whose apertures lie in a map, and which hold few points, or no lenslet but points enough.

    points : (3, n) of the map; seen : Cells with points enough for a fit; index : (m, 2) the lenslets.
    """
    size = 0.5 * np.array(measured.shape[::-1]) * measured.pixel
    reach = int(np.hypot(*size) / np.hypot(*found.basis).min()) + 1
    every = np.stack(np.meshgrid(*(np.arange(-reach, reach + 1),) * 2), axis=-1).reshape(-1, 2)
    corners = _axes(found) @ (aperture.half[:, None] * [[-1, -1, 1, 1], [-1, 1, -1, 1]])
    at = found.centres(every)[:, :, None] + corners
    flat = np.einsum("ik,mkc->mic", level.T[:2, :2], at)
    every = every[(np.abs(flat) <= size[:, None]).all(axis=(1, 2))]
    x, y = level[:2] @ points
    cell = np.rint(found.index(x, y)).astype(np.int64)
    held = np.zeros(2 * reach + np.array([3, 3]), dtype=np.int64)
    at = np.clip(cell + reach + 1, 0, 2 * reach + 2)
    held += np.bincount(at[0] * held.shape[1] + at[1], minlength=held.size).reshape(held.shape)
    points = held[tuple((every + reach + 1).T)]
    usual = np.median(held[tuple((index + reach + 1).T)])
    lenses, fitted = set(map(tuple, index.tolist())), set(seen)
    bare = np.array([tuple(one) in fitted - lenses for one in every.tolist()], dtype=bool)
    return np.asarray(every[bare | (points < HALF * usual)])


HALF = 0.5
"""Share of the usual number of points below which a cell holds no lenslet."""


def _is_lens(values: Floats, wanted: Floats, aperture: Aperture, table: Floats) -> bool:
    """Whether fitted numbers are those of a lenslet of the design: its sag, and its middle; and whether
    points (3, n) follow them, as those of letters do not.
    """
    square = float(aperture.half.max()) ** 2
    with np.errstate(over="ignore", invalid="ignore"):  # of no lenslet anything may come
        root = [1.0 - (1.0 + one[4]) * one[3] ** 2 * square for one in (values, wanted)]
        sag, like = (
            one[3] / (1.0 + np.sqrt(max(0.0, r))) for one, r in zip((values, wanted), root, strict=True)
        )
    if not LENS[0] <= sag / like <= LENS[1]:
        return False
    u, v, z = table[:, :: max(1, table.shape[1] // THIN)]
    off = float(np.median(np.abs(z - conic(values, u, v, slopes=False)[0])))
    aside = np.abs(values[:2] - wanted[:2]) / aperture.half
    return bool(aside.max() <= 0.5 and off <= UNLIKE * abs(wanted[3]) * square)


def plane_of(points: Floats) -> Floats:
    """Slopes (2,) of the plane of points (3, n), by a part of them."""
    x, y, z = points[:, :: max(1, points.shape[1] // 50_000)]
    design = np.column_stack([np.ones(len(x)), x, y])
    return np.asarray(np.linalg.lstsq(design, z, rcond=None)[0][1:])


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
    points: Floats, found: Found, aperture: Aperture, grid: _Grid
) -> tuple[list[tuple[int, int]], list[Floats]]:
    """Whole cells, and the points (3, n) of each in its own axes: those of the lattice, from its centre."""
    place = found.index(points[0], points[1])
    cell = np.rint(place).astype(np.int64)
    off = points[:2] - found.centres(cell.T).T
    u, v = _axes(found).T @ off
    kept = np.flatnonzero(aperture.holds(u, v))
    low, high = cell.min(axis=1), cell.max(axis=1)
    rows = int(high[1] - low[1]) + 1
    number = (cell[0, kept] - low[0]) * rows + cell[1, kept] - low[1]
    order = np.argsort(number.astype(np.min_scalar_type(int(number.max(initial=0)))), kind="stable")
    kept, number = kept[order], number[order]
    tiles = min(TILES, max(3, grid.side // 3))
    corners = np.array([[sx * aperture.half[0], sy * aperture.half[1]] for sx in (-1, 1) for sy in (-1, 1)])
    edges = [points[:2].min(axis=1), points[:2].max(axis=1)]
    room = 1e-3 * float(aperture.half.min())
    cells, groups = [], []
    for rows_of in np.split(kept, np.flatnonzero(np.diff(number)) + 1):
        if not len(rows_of):
            continue
        one = cell[:, rows_of[0]]
        at = found.centres(one[None])[0] + corners @ _axes(found).T
        table = np.stack([u[rows_of], v[rows_of], points[2, rows_of]])
        inside = (at >= edges[0] - room).all() and (at <= edges[1] + room).all()
        if inside and len(rows_of) >= 2 * grid.basis.shape[1] and _whole(table, aperture, tiles):
            cells.append((int(one[0]), int(one[1])))
            groups.append(table)
    return cells, groups


def _axes(found: Found) -> Floats:
    """Axes of the cells, columns, in those of the map: along the step i, less the turn of the design's."""
    x, y = found.basis[:, 0] / np.hypot(*found.basis[:, 0])
    c, s = np.cos(found.turn), np.sin(found.turn)
    x, y = c * x + s * y, c * y - s * x
    return np.array([[x, -y], [y, x]])


def _whole(table: Floats, aperture: Aperture, tiles: int) -> bool:
    """Whether the points of a cell cover its aperture."""
    line = (np.arange(tiles) + 0.5) / tiles * 2.0 - 1.0
    gx, gy = np.meshgrid(*(line * half for half in aperture.half), indexing="ij")
    wanted = aperture.holds(gx.ravel(), gy.ravel())
    i, j = parts_of(table[0], table[1], aperture.half, tiles)
    count = np.bincount(i * tiles + j, minlength=tiles * tiles)
    held = (count >= max(1.0, 0.2 * float(np.median(count[wanted])))) | ~wanted
    square = held.reshape(tiles, tiles)
    sides = (square[0], square[-1], square[:, 0], square[:, -1])
    return bool(held[wanted].mean() >= PRESENT and all(side.mean() >= ALONG for side in sides))


def _fitted(table: Floats, start: Floats) -> Floats:
    """Numbers (7,) of one lenslet by a part of its points (3, n)."""
    u, v, z = table[:, :: max(1, table.shape[1] // THIN)]
    values = start.copy()
    values[2] += np.median(z - conic(values, u, v, slopes=False)[0])
    values = _solved(values, u, v, z, 2)
    kept = _near(z - conic(values, u, v, slopes=False)[0])
    return _solved(values, u[kept], v[kept], z[kept], 3)


@dataclass(frozen=True, eq=False)
class _Sums:
    """Block means of what a first fit leaves of a lenslet.

    values : (7,) The first fit.
    weight, mean : (blocks,) Points of each block inside, and their mean.
    square, form : (c, c), (c,) Normal equations of Legendre polynomials over them, and their solution.
    own : (c, c). Takes from coefficients what the conic can follow.
    share : (7, c). Numbers of the conic that follow coefficients, by least squares over the whole aperture.
    spread : Variance of a point.
    texture : Rms of what the polynomials leave of single points.
    """

    values: Floats
    weight: Floats
    mean: Floats
    square: Floats
    form: Floats
    own: Floats
    share: Floats
    spread: float
    texture: float

    def inverse(self, weak: Floats) -> Floats:
        """Inverse (c, c) of the normal equations with the weights `weak` (c,) of form beyond the conic."""
        return np.asarray(np.linalg.inv(self.square + self.own.T @ (weak[:, None] * self.own)))

    def variances(self, inverse: Floats) -> Floats:
        """Variances (c,) of the coefficients of form beyond the conic."""
        return np.asarray(self.spread * np.einsum("ij,jk,ik->i", self.own, inverse, self.own))


def _sums(table: Floats, values: Floats, grid: _Grid) -> _Sums:
    """Block means of one lenslet by all its points (3, n), without spikes and dirt."""
    u, v, z = table
    off = z - conic(values, u, v, slopes=False)[0]
    block = grid.block(u, v)
    smooth = np.zeros(grid.side * grid.side)
    smooth[grid.inside] = grid.basis @ _form(off, block, _near(off), grid)[0]
    kept = _near(off - smooth[block])
    form, square, weight, mean = _form(off, block, kept, grid)
    smooth[grid.inside] = grid.basis @ form
    slopes = conic(values, *grid.places)[1]
    # the aperture as a whole counts, not the points that were not lost: of both the form is weighed alike
    share = _least_squares(slopes, np.ones(len(weight)), mean)[1] @ grid.basis
    own = np.eye(len(form)) - grid.inverse @ slopes @ share
    spread = max(grid.noise(weight, mean - grid.basis @ form), 1e-300)
    texture = float(np.sqrt(np.mean((off - smooth[block])[kept] ** 2)))
    return _Sums(values, weight, mean, square, form, own, share, spread, texture)


@dataclass(frozen=True, eq=False)
class _Fit:
    values: Floats
    covariance: Floats
    form: Floats
    u_form: Floats
    texture: float


def _refined(every: Sequence[_Sums], grid: _Grid) -> list[_Fit]:
    """Numbers and forms of all lenslets of a map, with their covariances.

    Form beyond the conic has, in each degree, the variance that the lenslets of the map show, and the mean 0.
    It decides where no points are: the numbers are those of the form over the whole aperture.
    """
    weak = _weakness(every, grid.basis.shape[1])
    fits = []
    for one in every:
        inverse = one.inverse(weak)
        form = one.own @ inverse @ (grid.basis.T @ (one.weight * one.mean))
        straight, best = _least_squares(conic(one.values, *grid.places)[1], one.weight, one.mean)
        u_form = np.sqrt(np.maximum(one.variances(inverse), 0.0))
        fits.append(
            _Fit(
                one.values + straight - best @ (grid.basis @ form),
                one.spread * (one.share @ inverse @ one.share.T),
                form,
                u_form,
                one.texture,
            )
        )
    return fits


def _weakness(every: Sequence[_Sums], count: int) -> Floats:
    """Weight (c,), in points, of the expectation that a coefficient is 0: noise over form (variances).

    Most likely variance of the coefficients of each degree, found by steps of expectation and maximization;
    degrees that the conic follows are free.
    """
    degree = np.array([d for d in range(count) for _ in range(d + 1)])[:count]
    noise = float(np.mean([one.spread for one in every]))
    weak = np.where(degree < 3, 0.0, PRIOR)
    for _ in range(STEPS):
        seen = np.zeros(count)
        for one in every:
            inverse = one.inverse(weak)
            form = one.own @ inverse @ one.square @ one.form
            seen += form**2 + one.variances(inverse)
        for d in range(3, int(degree[-1]) + 1):
            weak[degree == d] = noise * len(every) / max(float(seen[degree == d].mean()), 1e-300)
    return weak


def pooled_form(u: Floats, v: Floats, off: Floats, aperture: Aperture, pixel: float) -> tuple[Floats, Floats]:
    """Legendre coefficients (c,) of heights (n,) over places of a cell, and their standard deviations.

    Points of several cells at once give the form that their cells share. Spikes are left out.

    pixel : length. Distance of neighbouring points of one cell.
    """
    inside = aperture.holds(u, v)
    u, v, off = u[inside], v[inside], off[inside]
    grid = _grid(aperture, pixel)
    block = grid.block(u, v)
    smooth = np.zeros(grid.side * grid.side)
    form, square, weight, mean = _form(off, block, _near(off), grid)
    for _ in range(2):
        smooth[grid.inside] = grid.basis @ form
        form, square, weight, mean = _form(off, block, _near(off - smooth[block]), grid)
    covariance = np.linalg.inv(square + PRIOR * np.eye(len(form)))
    covariance *= GUARD**2 * grid.noise(weight, mean - grid.basis @ form)
    return form, np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def _least_squares(slopes: Floats, weight: Floats, mean: Floats) -> tuple[Floats, Floats]:
    """Weighted least squares: the solution (7,), and the matrix (7, k) that gives it of heights (k,)."""
    size = np.abs(slopes).max(axis=0)  # not their rms: squares of a hostile map's slopes may overflow
    size[size == 0.0] = 1.0
    scaled = slopes / size
    weighted = (scaled * weight[:, None]).T
    best = np.linalg.pinv(weighted @ scaled, rcond=1e-13, hermitian=True) @ weighted
    best = best / size[:, None]
    return best @ mean, best


def fit_heights(
    aperture: Aperture, heights: Callable[[Floats, Floats], Floats], start: Floats, rounds: int = 12
) -> Floats:
    """Numbers (7,) of a lenslet whose heights over places are known, by the same least squares.

    start : (7,) numbers near them.
    """
    u, v = aperture.grid(BLOCKS)
    return _solved(start, u, v, heights(u, v), rounds)


def _form(off: Floats, block: Ints, kept: Bools, grid: _Grid) -> tuple[Floats, Floats, Floats, Floats]:
    """Legendre coefficients of what a fit leaves, by weighted block means.

    Returns coefficients, matrix of the normal equations, weight and mean of each block inside.
    """
    size = grid.side * grid.side
    weight = np.bincount(block[kept], minlength=size)[grid.inside].astype(np.float64)
    total = np.bincount(block[kept], off[kept], minlength=size)[grid.inside]
    mean = total / np.maximum(weight, 1.0)
    weighted = grid.basis * weight[:, None]
    square = weighted.T @ grid.basis
    ridge = square + PRIOR * np.eye(len(square))
    return np.asarray(np.linalg.solve(ridge, weighted.T @ mean)), square, weight, mean


def _solved(values: Floats, u: Floats, v: Floats, z: Floats, rounds: int) -> Floats:
    """Numbers of a lenslet after some steps of Gauss and Newton."""
    for _ in range(rounds):
        fitted, slope = conic(values, u, v)
        square, right = slope.T @ slope, slope.T @ (z - fitted)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(square), 1e-300))
        step = np.linalg.lstsq(square * scale[:, None] * scale, right * scale, rcond=1e-12)[0]
        values = values + scale * step
    return values


def _near(off: Floats) -> Bools:
    """Which distances are no spikes and no dirt."""
    middle = float(np.median(off))
    spread = float(np.median(np.abs(off - middle)))
    return np.asarray(np.abs(off - middle) <= CLIPPED * max(1.4826 * spread, 1e-300))


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
