"""Positions of the cells of an array, and position of the lens within each cell.

Cell (i, j) of every array is the partner of cell (i, j) of the other arrays. A uniform sheet
(`Window.uniform`) has arrays of one pitch and lenses at one position in their cells. A sheet aimed at its
viewer, or with a varying law, has arrays of different pitches and lenses at a different position in every
cell:

    centre of cell (i, j)     = T (pitch of the array × index) + shift        T: rotation of the array
    vertex of its lens        = Face.vertex + gradient × C + table[i, j]      C: centre of the lattice's cell
    (i, j)

An array stores its own pitch, not a factor on the lattice's pitch. The multiples of the pitch in borders and
centres are therefore formed exactly (`Lattice.locate`), at any distance from the centre. A turned array has
its cells, and with them their lenses, rotated about its centre. Local coordinates in a cell and the axes of
lenses stay along the sheet's axes.

Law of each cell in sheets where cells have their own offset δ, and possibly their own η and lens axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from clacad.base.pairs import Pair, pair, pair_sum, two_product
from clacad.base.types import Floats, Ints, Pair2
from clacad.optics.law.focusing import Gradient, VaryingLaw, ratios_of, refract_each
from clacad.optics.law.orientation import rotations
from clacad.sheet.pattern import cosine_and_sine, turned, turned_pairs

if TYPE_CHECKING:
    from clacad.optics.law import Law
    from clacad.optics.surface import Surface
    from clacad.sheet.lattice import Lattice

DIRECTIONS = 64
"""Number of directions in which the farthest lenses are searched."""

_OVER_Z = np.array([[1.0, 1.0, -1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
_ABOUT_X = np.array([[1.0, -1.0, -1.0], [-1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])
"""Signs of a rotation whose two frames are mirrored in z, or turned by 180 degrees about x."""

NO_REST = 1e-15
"""Displacement per displacement that is rounding error."""


@dataclass(frozen=True)
class CellPlacement:
    """Position of the cells of one array.

    shift : (x, y), lengths. Displacement of the centre of the array from that of the lattice.
    pitch : (p_x, p_y) or None, lengths
        The array's own pitch; None: the lattice's. Hexagonal: p_y is ignored.
    turn : radians. Rotation of the array about its centre, from +x to +y.
    """

    shift: Pair2 = (0.0, 0.0)
    pitch: Pair2 | None = None
    turn: float = 0.0

    @property
    def own(self) -> bool:
        """Whether the array's pattern differs from the lattice's."""
        return self.pitch is not None or self.turn != 0.0

    def lattice(self, base: Lattice) -> Lattice:
        """The array's own pattern about its own centre; it has no outline,
        `base` decides which cells exist.
        """
        if not self.own:
            return base
        return replace(
            base,
            pitch=base.pitch if self.pitch is None else self.pitch,
            outline=None,
            turn=self.turn,
            copies=1,
        )

    def scale(self, base: Lattice) -> Pair2:
        """Ratio of the array's pitch to that of the lattice `base`, along x and y."""
        if self.pitch is None:
            return 1.0, 1.0
        across = self.pitch[0] / base.pitch[0]
        return across, across if base.hexagonal else self.pitch[1] / base.pitch[1]

    def aside(self, base: Lattice) -> Floats:
        """Displacement (2, 2) of the array's cells per displacement of the lattice's, sheet axes."""
        gx, gy = self.scale(base)
        found = np.diag([gx - 1.0, gy - 1.0])
        if self.turn:
            less, (s, _) = 2.0 * cosine_and_sine(0.5 * self.turn)[1][0] ** 2, cosine_and_sine(self.turn)[1]
            found += np.array([[-less, -s], [s, -less]]) * [gx, gy]
        return found

    def between(self, base: Lattice, share: Floats, shift: Pair2) -> tuple[CellPlacement, Floats]:
        """Cells on the lines from those of `base` to this array's, at a `share` (2, 2) of the way.

        They are displaced by `shift` (lengths). A lattice of rectangles that is turned and compressed is none
        at other shares: the second value (2, 2) is what the nearest lattice lacks per displacement of a cell.
        """
        if not self.own:
            return CellPlacement(shift), np.zeros((2, 2))
        wanted = np.eye(2) + share @ self.aside(base)
        turn = float(np.arctan2(wanted[1, 0] - wanted[0, 1], wanted[0, 0] + wanted[1, 1]))
        x, y = np.einsum("ki,ki->i", turned(np.eye(2), turn).T, wanted).tolist()
        place = CellPlacement(shift, (base.pitch[0] * x, base.pitch[1] * y), turn)
        rest = wanted - np.eye(2) - place.aside(base)
        return place, np.where(np.abs(rest) < NO_REST, 0.0, rest)

    def extent(self, base: Lattice) -> tuple[float, float, float, float]:
        """Bounding box (x_min, x_max, y_min, y_max) of the array's kept cells, sheet frame, lengths."""
        if self.turn:
            own = self.lattice(base)
            corners = own.centres(row_ends(base))[:, None] + own.tile() + np.asarray(self.shift)
            (x0, y0), (x1, y1) = corners.min(axis=(0, 1)).tolist(), corners.max(axis=(0, 1)).tolist()
            return x0, x1, y0, y1
        x0, x1, y0, y1 = base.extent()
        (gx, gy), (sx, sy) = self.scale(base), self.shift
        return x0 * gx + sx, x1 * gx + sx, y0 * gy + sy, y1 * gy + sy


class PlacedArrays:
    """Cells of several arrays; a `Window` is a sheet of them.

    placements : tuple of CellPlacement, one per array
    """

    lattice: Lattice
    placements: tuple[CellPlacement, ...]

    @property
    def shifts(self) -> tuple[Pair2, ...]:
        """Displacement (x, y) of the cells of each array relative to the lattice, lengths."""
        return tuple(place.shift for place in self.placements)

    def lattice_of(self, array: int) -> Lattice:
        """Pattern of the cells of an array about its own centre; `lattice` decides which cells exist."""
        return self.placements[array].lattice(self.lattice)

    def centres(self, array: int, index: Ints) -> Floats:
        """Centres (..., 2) of the cells `index` (..., 2) of an array, sheet frame, lengths."""
        return np.asarray(self.lattice_of(array).centres(index) + np.asarray(self.placements[array].shift))

    def locate(self, array: int, x: Floats, y: Floats) -> tuple[Ints, Floats, Floats]:
        """Cell (n, 2) of an array that contains each sheet point, and the point from its centre, (n,) each,
        lengths.
        """
        dx, dy = self.placements[array].shift
        return self.lattice_of(array).locate(x - dx, y - dy)


@dataclass(frozen=True, slots=True, eq=False)
class LensPlaces:
    """Positions and sizes of the lenses of given cells, relative to the one lens that a face describes.

    A lens of another size is the same shape scaled about its apex: h(r) becomes k h(r/k), and angles are
    unchanged. One of two η has another curvature along y before it is scaled (`stretched`).

    vertex : (3,) lengths. Apex of the face's lens.
    moved : (..., 2) or None, lengths
        Lateral displacement of the apexes from `vertex`; None: all lenses are the face's lens.
    rise : (...) lengths. Displacement of the apexes along z.
    size : (...) or None. Scale factor k; None: 1 for all.
    aspect : (...) or None. Curvature along y over that of the scaled lens; None: 1 for all.
    rotation : (..., 3, 3) or None. Lens → sheet of each; None: the face's.
    """

    vertex: tuple[float, float, float]
    moved: Floats | None = None
    rise: Floats | float = 0.0
    size: Floats | None = None
    aspect: Floats | None = None
    rotation: Floats | None = None

    def axes(self, rotation: Floats | None, like: tuple[int, ...] | None = None) -> Floats | None:
        """Lens → sheet of the lenses, `rotation` of the face where they have none; `like` as in `shape`."""
        if self.rotation is None:
            return rotation
        shape = self.rotation.shape[:-2] if like is None else like
        return np.broadcast_to(self.rotation, (*shape, 3, 3)).reshape(-1, 3, 3)

    def shape(self, surface: Surface, like: tuple[int, ...] | None = None) -> Surface:
        """Surface of the lenses before they are scaled; `like`: one for each point of arrays of this
        shape, in one row.
        """
        if self.aspect is None:
            return surface
        from clacad.optics.surface.sag_and_normal import stretched

        return stretched(surface, self.aspect if like is None else np.broadcast_to(self.aspect, like).ravel())

    def focal(self, lengths: Pair2) -> tuple[Any, Any]:
        """Focal lengths (...) along x and y of the lenses, from those of the one lens."""
        size = 1.0 if self.size is None else self.size
        return lengths[0] * size, lengths[1] * size / (1.0 if self.aspect is None else self.aspect)

    def seen(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Points (...), lengths, of the cells' frames mapped to the frame of the face's one lens."""
        if self.moved is None:
            return x, y
        x, y = x - self.moved[..., 0], y - self.moved[..., 1]
        if self.size is None:
            return x, y
        vx, vy, _ = self.vertex
        return vx + (x - vx) / self.size, vy + (y - vy) / self.size

    def raised(self, z: Floats) -> Floats:
        """Heights (...), lengths, of the lenses, from those of the face's one lens where `seen` maps to."""
        if self.moved is None:
            return z
        if self.size is not None:
            z = self.vertex[2] + (z - self.vertex[2]) * self.size
        return np.asarray(z + self.rise)

    @property
    def apex(self) -> tuple[Floats | float, Floats | float, Floats | float]:
        """Apexes of the lenses, x, y and z, (...) lengths; three numbers where all lenses are alike."""
        x, y, z = self.vertex
        if self.moved is None:
            return x, y, z
        return x + self.moved[..., 0], y + self.moved[..., 1], z + self.rise


@dataclass(frozen=True, eq=False)
class VertexChange:
    """Displacement of each cell's lens from `Face.vertex`, an affine part plus a table, and its scale factor.

    gradient : ((xx, xy), (yx, yy))
        Displacement per displacement of the cell's centre in the lattice (length per length).
    table : (n1, n2, 2) array or None, lengths. Displacement added per cell; the first index of a hexagonal
        lattice is i + j // 2, the position in the row.
    slope : (along x, along y). Rise in z per lateral displacement: tilted lenses that move in their own lens
        plane keep their distance from lens 1.
    size : (n1, n2) array or None
        Scale factor of each cell's lens relative to the face's lens; indexed as `table`. None: 1 for all.
    aspect : (n1, n2) array or None
        Curvature along y of each cell's lens over that of the scaled one; only with `size`.
    rotation : (n1, n2, 3, 3) array or None
        Lens → sheet of each cell's lens in place of the face's; only with `size`.
    climb : (along x, along y). Additional rise in z per displacement of the cell's centre in the lattice: of
        lenses that do not move as their cells do.
    lift : (n1, n2) array or None, lengths. Additional rise of each cell's lens; indexed as `table`.
    """

    gradient: tuple[Pair2, Pair2] = ((0.0, 0.0), (0.0, 0.0))
    table: Floats | None = None
    slope: Pair2 = (0.0, 0.0)
    size: Floats | None = None
    climb: Pair2 = (0.0, 0.0)
    lift: Floats | None = None
    aspect: Floats | None = None
    rotation: Floats | None = None

    def at(self, lattice: Lattice, index: Ints) -> Floats:
        """Displacement (..., 2), lengths, of cells `index` (..., 2); 0 for cells left out of a table."""
        x, y = np.moveaxis(lattice.centres(index), -1, 0)
        (xx, xy), (yx, yy) = self.gradient
        change = np.stack([xx * x + xy * y, yx * x + yy * y], axis=-1)
        return change if self.table is None else np.asarray(change + tabled(self.table, lattice, index, 0.0))

    @property
    def level(self) -> bool:
        """Whether all lenses have one height."""
        return self.lift is None and not any((*self.slope, *self.climb))

    @property
    def framed(self) -> bool:
        """Whether lenses have axes or curvatures of their own, or heights that `slope` does not give."""
        own = self.lift, self.aspect, self.rotation
        return any(self.climb) or any(one is not None for one in own)

    @property
    def mirrored(self) -> VertexChange:
        """Displacements of the lenses of a sheet turned over in z."""
        (a, b), (c, d) = self.slope, self.climb
        lift, turn = (
            None if one is None else one * signs
            for one, signs in ((self.lift, -1.0), (self.rotation, _OVER_Z))
        )
        return replace(self, slope=(-a, -b), climb=(-c, -d), lift=lift, rotation=turn)

    @property
    def turned(self) -> VertexChange:
        """Displacements of the lenses of a sheet turned by 180 degrees about x, whose rows change places."""
        (xx, xy), (yx, yy) = self.gradient
        (a, b), (c, d) = self.slope, self.climb
        return VertexChange(
            ((xx, 0.0 - xy), (0.0 - yx, yy)),
            None if self.table is None else self.table[:, ::-1] * np.array([1.0, -1.0]),
            (0.0 - a, b),
            None if self.size is None else self.size[:, ::-1],
            (0.0 - c, d),
            lift=None if self.lift is None else -self.lift[:, ::-1],
            aspect=None if self.aspect is None else self.aspect[:, ::-1],
            rotation=None if self.rotation is None else self.rotation[:, ::-1] * _ABOUT_X,
        )

    def rise(self, lattice: Lattice, index: Ints, moved: Floats) -> Floats:
        """Rise in z (...), lengths, of the lenses of cells `index` (..., 2), displaced by `moved` (..., 2),
        lengths.
        """
        rise = np.asarray(moved @ np.array(self.slope))
        if self.lift is not None:
            rise = rise + tabled(self.lift, lattice, index, 0.0)
        return rise + lattice.centres(index) @ np.array(self.climb) if any(self.climb) else rise

    def places(self, vertex: tuple[float, float, float], lattice: Lattice, index: Ints) -> LensPlaces:
        """Positions of the lenses of the cells `index` (..., 2), relative to the lens at `vertex`,
        lengths.
        """
        moved = self.at(lattice, index)
        size, aspect = (
            None if one is None else tabled(one, lattice, index, 1.0) for one in (self.size, self.aspect)
        )
        turn = None if self.rotation is None else tabled(self.rotation, lattice, index, np.eye(3))
        return LensPlaces(vertex, moved, self.rise(lattice, index, moved), size, aspect, turn)

    def of_middle(self, lattice: Lattice, count: tuple[int, int]) -> VertexChange:
        """Displacements of `count` cells in the centre of the lattice; a table is cut to them.

        Raises ValueError: The table has fewer cells.
        """
        return replace(self, **_cut_tables(self, lattice, count))


ALONG = 9
"""Legendre polynomials along each axis of a form."""

SLOPES = np.pad(np.polynomial.legendre.legder(np.eye(ALONG)), ((0, 1), (0, 0)))
"""Coefficients (9, 9) of the slopes of the polynomials, a column each."""


@dataclass(frozen=True, eq=False)
class LensForm:
    """Heights of the lenses of a face besides its surface: products of Legendre polynomials over a cell.

    half : (2,) lengths. Half the cell along x and y; negative where the polynomials run the other way.
    shared : (81,) lengths. Coefficients along z of every lens, degrees 0 to 8 along x times 0 to 8 along y.
    own : (n1, n2, 81) array or None. Coefficients that a cell's lens has besides; indexed as tables of
        `VertexChange`.
    """

    half: Floats
    shared: Floats
    own: Floats | None = None

    def __call__(self, lattice: Lattice, index: Ints | None, x: Floats, y: Floats) -> Floats:
        """Heights (...) over points (...) of the cells `index` (..., 2); None: of the shared form."""
        x, y = np.broadcast_arrays(x, y)
        index = None if index is None else np.broadcast_to(index, (*x.shape, 2)).reshape(-1, 2)
        return np.asarray(self.with_slopes(lattice, index, x.ravel(), y.ravel())[0].reshape(x.shape))

    def with_slopes(
        self, lattice: Lattice, index: Ints | None, x: Floats, y: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Heights (n,) over points (n,) of the cells `index` (n, 2), and slopes along x and y."""
        legvander = np.polynomial.legendre.legvander
        of_x, of_y = legvander(x / self.half[0], ALONG - 1), legvander(y / self.half[1], ALONG - 1)
        weights = self.shared[None]
        if self.own is not None and index is not None:
            weights = weights + tabled(self.own, lattice, index, 0.0)
        weights = weights.reshape(-1, ALONG, ALONG)
        z = (of_x[:, None] @ weights)[:, 0]
        dx = (of_x[:, None] @ (SLOPES @ weights))[:, 0] / self.half[0]
        dy = z @ SLOPES.T / self.half[1]
        return (z * of_y).sum(axis=1), (dx * of_y).sum(axis=1), (dy * of_y).sum(axis=1)

    def in_cell(self, lattice: Lattice, index: Ints) -> LensForm:
        """Form of the lens of one cell."""
        if self.own is None:
            return self
        return LensForm(self.half, self.shared + tabled(self.own, lattice, index, 0.0))

    def grown(self, x: float, y: float, z: float) -> LensForm:
        """Form of a sheet larger along x, y and z; −1 along y and z: turned by 180 degrees about x."""
        own = None if self.own is None else z * (self.own if y > 0.0 else self.own[:, ::-1])
        return LensForm(self.half * np.array([x, y]), self.shared * z, own)

    def of_middle(self, lattice: Lattice, count: tuple[int, int]) -> LensForm:
        """Form of `count` cells in the centre of the lattice."""
        return self if self.own is None else replace(self, own=of_middle(self.own, count, lattice))


def _cut_tables(of: VertexChange | CellLaws, lattice: Lattice, count: tuple[int, int]) -> dict[str, Any]:
    """The tables of cells by their names, cut to `count` cells in the centre of the lattice."""
    tables = {name: one for name, one in vars(of).items() if isinstance(one, np.ndarray)}
    return {name: of_middle(table, count, lattice) for name, table in tables.items()}


def linear_change(gradient: Floats, climb: Floats) -> VertexChange | None:
    """Lenses displaced by `gradient` (2, 2), raised by `climb` (2,), times their cell's; None for 0 and 0."""
    if not gradient.any() and not climb.any():
        return None
    (a, b), (c, d) = gradient.tolist()
    along, across = climb.tolist()
    return VertexChange(((a, b), (c, d)), climb=(along, across))


def lens_plane_slope(turn: Floats) -> Pair2:
    """Rise along sheet x and y of a plane normal to the lens axis; turn (3, 3), lens → sheet."""
    x, y, z = turn[:, 2].tolist()
    return -x / z + 0.0, -y / z + 0.0


def of_middle(table: Floats, count: tuple[int, int], lattice: Lattice) -> Floats:
    """Part of a table (n1, n2, ...) for `count` cells in the centre of its lattice.

    Raises ValueError: The table has fewer cells.
    """
    over = [have - want for have, want in zip(table.shape[:2], count, strict=True)]
    if min(over) < 0:
        have, want = table.shape[:2], tuple(count)
        raise ValueError(f"a table of {have[0]} x {have[1]} cells has no {want[0]} x {want[1]}")
    i, j = over[0] // 2, over[1] // 2
    j -= j % 2 if lattice.hexagonal else 0  # odd rows are displaced by half a pitch
    return table[i : i + count[0], j : j + count[1]]


def places_in_rows(lattice: Lattice, index: Ints) -> Ints:
    """First index (...) in tables of the cells `index` (..., 2): i, or i + j // 2 of a hexagonal lattice."""
    return index[..., 0] + index[..., 1] // 2 if lattice.hexagonal else index[..., 0]


def as_table(lattice: Lattice, cells: Ints, each: Floats, beyond: float | Floats = 0.0) -> Floats:
    """Table (n1, n2, ...) with `each` (n, ...) at the cells (n, 2), and `beyond` at others."""
    table = np.full((*lattice.count, *each.shape[1:]), beyond)
    table[places_in_rows(lattice, cells), cells[:, 1]] = each
    return table


def tabled(table: Floats, lattice: Lattice, index: Ints, beyond: float | Floats) -> Floats:
    """Entries of a table (n1, n2, ...) for the cells `index` (..., 2), and `beyond` for cells that are not
    kept.

    The first index is that of `places_in_rows`.
    """
    kept = lattice.contains(index)
    found = table[np.where(kept, places_in_rows(lattice, index), 0), np.where(kept, index[..., 1], 0)]
    return np.where(kept.reshape(kept.shape + (1,) * (table.ndim - 2)), found, beyond)


def extreme_cells(change: VertexChange, lattice: Lattice) -> Ints:
    """List kept cells whose lenses are displaced farthest, in each of 64 directions, (m, 2).

    For lenses of many sizes, add the largest, the smallest, and the steepest and highest at their rims in
    each direction; of many heights, the lowest and the highest.
    """
    alike = change.table is None and change.size is None and change.lift is None
    cells = row_ends(lattice) if alike else lattice.cells()
    moved = change.at(lattice, cells)
    angle = np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS)
    out = [moved @ (np.cos(a), np.sin(a)) for a in angle]
    if change.size is not None:
        rims, places = [lattice.circumradius + one for one in out], change.places((0.0,) * 3, lattice, cells)
        sizes = places.focal((1.0, 1.0))
        for size in sizes[: 1 if change.aspect is None else 2]:
            out += [size, -size, *(rim / size for rim in rims), *(rim**2 / size for rim in rims)]
    if change.lift is not None:
        lift = tabled(change.lift, lattice, cells, 0.0)
        out += [lift, -lift]
    return np.unique(cells[[int(np.argmax(one)) for one in out]], axis=0)


def row_ends(lattice: Lattice) -> Ints:
    """List the first and last kept cell of every row, (m, 2): extremes of affine functions are there."""
    cells = lattice.cells()
    last = np.flatnonzero(np.diff(cells[:, 1], append=-1))
    return np.unique(cells[[0, *(last[:-1] + 1), *last]], axis=0)


def centre_pairs(lattice: Lattice, cell: Ints) -> tuple[Pair, Pair]:
    """Centres of cells (m, 2) along x and y, unrounded: each a double-double pair of (m,) lengths."""
    if lattice.turn:
        return turned_pairs(*centre_pairs(lattice.straight, cell), lattice.turn)
    i, j = cell[:, 0].astype(np.float64), cell[:, 1].astype(np.float64)
    if lattice.hexagonal:
        (x0, y0), row = lattice.first_centre, lattice.row_height
        x, y = two_product(i + 0.5 * j, lattice.pitch[0]), two_product(j, row)
        return pair_sum(x, pair(np.full(len(i), x0))), pair_sum(y, pair(np.full(len(i), y0)))
    n1, n2 = lattice.count
    return (
        two_product(2.0 * i - (n1 - 1), 0.5 * lattice.pitch[0]),
        two_product(2.0 * j - (n2 - 1), 0.5 * lattice.pitch[1]),
    )


@dataclass(frozen=True, eq=False)
class CellLaws:
    """Laws with a δ per cell: δ₀ + K C at the cell's centre C, or from a table; η and lens axes may vary too.

    law : Its δ is δ₀; a table replaces it.
    gradient : ((K_xx, K_xy), (K_yx, K_yy)), 1/length. Rows: lens axes; columns: sheet axes.
    table : (n1, n2, 2) array or None
        δ of each cell, indexed as the table of `clacad.sheet.cell_places.VertexChange`.
    ratios : (n1, n2) or (n1, n2, 2) array or None
        η, the ratio −f2/f1 of both lens axes or of either, of each cell; None: the law's η in all cells.
    angles : (n1, n2, 3) array or None
        φ, θ, ψ of each cell, radians, given with such a table; None: the law's in all cells.
    """

    law: Law
    gradient: Gradient = ((0.0, 0.0), (0.0, 0.0))
    table: Floats | None = None
    ratios: Floats | None = None
    angles: Floats | None = None

    @property
    def own_lenses(self) -> bool:
        """Whether cells have lenses of their own: by a table's η or angles."""
        return self.ratios is not None or self.angles is not None

    @property
    def smooth(self) -> VaryingLaw | None:
        """The law as a continuous function of position; None where a table gives δ."""
        return None if self.table is not None else VaryingLaw(self.law, self.gradient)

    def deltas(self, lattice: Lattice, index: Ints) -> Floats:
        """δ (..., 2) of the cells `index` (..., 2)."""
        smooth = self.smooth
        if smooth is None:
            return VertexChange(table=self.table).at(lattice, index)
        return smooth.deltas(lattice.centres(index))

    def ratios_of(self, lattice: Lattice, index: Ints) -> Floats:
        """η (..., 2) of cells `index` (..., 2) along the lens axes; the law's for cells left out."""
        if self.ratios is None:
            return np.broadcast_to(ratios_of(self.law), (*index.shape[:-1], 2))
        each = self.ratios if self.ratios.ndim == 3 else np.repeat(self.ratios[..., None], 2, axis=-1)
        kept = lattice.contains(index)[..., None]
        return np.where(kept, tabled(each, lattice, index, 0.0), ratios_of(self.law))

    def angles_of(self, lattice: Lattice, index: Ints) -> Floats:
        """φ, θ, ψ (..., 3) of cells `index` (..., 2), radians; the law's for cells left out."""
        law = np.array([self.law.phi, self.law.theta, self.law.psi])
        if self.angles is None:
            return np.broadcast_to(law, (*index.shape[:-1], 3))
        return tabled(self.angles, lattice, index, law)

    def rotations_of(self, lattice: Lattice, index: Ints) -> Floats | None:
        """Lens → sheet (..., 3, 3) of cells `index` (..., 2); None: the law's in all."""
        return None if self.angles is None else rotations(self.angles_of(lattice, index), self.law.axes)

    def law_at(self, lattice: Lattice, index: ArrayLike) -> Law:
        """Law of the cell `index` (2,). Raises IndexError: No such cell is kept."""
        cell = np.asarray(index, dtype=np.int64)
        if cell.shape != (2,) or not lattice.contains(cell):
            raise IndexError(f"the sheet has no cell {np.asarray(index).tolist()}")
        delta_x, delta_y = self.deltas(lattice, cell).tolist()
        eta_x, eta_y = self.ratios_of(lattice, cell).tolist()
        law = replace(self.law, delta_x=delta_x, delta_y=delta_y, eta_x=eta_x, eta_y=eta_y)
        phi, theta, psi = self.angles_of(lattice, cell).tolist()
        return replace(law, phi=phi, theta=theta, psi=psi)

    def refract(self, lattice: Lattice, index: Ints, d: Floats) -> Floats:
        """Exit directions (n, 3) of light with directions `d` (n, 3) through the cells `index` (n, 2)."""
        own = None if self.ratios is None else self.ratios_of(lattice, index)
        return refract_each(self.law, self.deltas(lattice, index), d, own, self.rotations_of(lattice, index))

    def of_middle(self, lattice: Lattice, count: tuple[int, int]) -> CellLaws:
        """Laws of `count` cells in the centre of their lattice; tables are cut."""
        return replace(self, **_cut_tables(self, lattice, count))
