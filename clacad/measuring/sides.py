"""The two measured sides of a design: curved faces seen from outside their material, and the lenslets of each
cell by the definitions of the fit.

A map of a face whose material lies behind it has the sheet's x along its x and the sheet's y against its y; a
map of one whose material lies before it has both against. So x of a back's map runs against x of a front's.
The front is the first curved face that light meets, the back the last one. Faces between them are as
designed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from clacad.base.polygons import polygon_area
from clacad.base.types import Bools, Floats, Ints
from clacad.measuring.fit_lenslets import Aperture, aperture_of, fit_heights
from clacad.sheet.lattice import Lattice, inside_outline
from clacad.sheet.pattern import Pattern
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.volume_and_extent import NoFixture
from clacad.sheet.window import Body, Face, Window, lens_height
from clacad.solid.marks import MarkPlace, mark_place
from clacad.storage.errors import BadRequest, NotPossible

Name = Literal["front", "back"]
AXES: dict[Name, tuple[float, float]] = {"front": (1.0, -1.0), "back": (-1.0, -1.0)}
"""Signs of the map's x and y along the sheet's."""


OTHER: dict[Name, Name] = {"front": "back", "back": "front"}


@dataclass(frozen=True, eq=False)
class Side:
    """One side of a sheet.

    name : "front": the side that light reaches first.
    window : The sheet.
    body : Body that the face bounds.
    face : Face
    aperture : Measured aperture.
    lenslet : (7,) Numbers of the lenslet that `face` describes in the axes of a map, by the fit of
        `fit_lenslets`.
    millimetre : Lengths of a design unit in a millimetre.
    """

    name: Name
    window: Window
    body: Body
    face: Face
    aperture: Aperture
    lenslet: Floats
    millimetre: float

    @property
    def array(self) -> int:
        """Array of the face."""
        assert self.face.array is not None
        return self.face.array

    @property
    def number(self) -> int:
        """Number of the face in the order of the light."""
        return next(k for k, face in enumerate(self.window.faces) if face is self.face)

    @property
    def signs(self) -> tuple[float, float]:
        """Signs of the map's x and y along the sheet's."""
        return _signs(self.face)

    @property
    def lattice(self) -> Pattern:
        """Cells of the face, in the axes of a map."""
        return _seen(self.window.lattice_of(self.array), self.signs)

    @property
    def alike(self) -> bool:
        """Whether all lenslets of the side are alike."""
        return self.face.change is None

    @property
    def sag(self) -> float:
        """Range of heights (length) of the design's lenslet."""
        inside = self.aperture.grid(ALONG)
        return float(np.ptp(_outward(self.face, *np.hstack([inside, self.lattice.tile().T]))))

    def outward(self, u: Floats, v: Floats) -> Floats:
        """Height (n,) of the design's lenslet above its apex, out of the material, over places of a map's
        cell.
        """
        return _outward(self.face, u, v)

    def cell(self, index: Ints) -> Ints:
        """Steps (m, 2) of the sheet's lattice for steps (m, 2) of the map's."""
        own, base = self.lattice, self.window.lattice_of(self.array)
        across = np.linalg.solve(_steps(base), np.diag(self.signs) @ _steps(own))
        return np.asarray(np.rint(index @ across.T).astype(np.int64))

    def in_sheet(self, u: Floats, v: Floats, height: Floats) -> Floats:
        """Places of a map's cell and heights above the plane of the apexes as points (n, 3) of the
        sheet's.
        """
        sx, sy = self.signs
        return np.column_stack([sx * u, sy * v, self.face.vertex[2] - self.face.side * height])

    def heights(self, cell: Ints | None, u: Floats, v: Floats) -> Floats:
        """Height (n,) of the design's lenslet of a sheet's cell (2,) over places of the map's.

        Above the plane of the apexes, out of the material; None: of the lenslet that the face describes.
        """
        own = self.face if cell is None or self.alike else self.window.in_cell(self.face, cell)
        return np.asarray(_outward(own, u, v) - own.side * (own.vertex[2] - self.face.vertex[2]))

    def numbers(self, cells: Ints) -> Floats:
        """Numbers (m, 7) of the design's lenslets of the sheet's cells (m, 2).

        Cells beyond its border are like that of the face.
        """
        if self.alike:
            return np.tile(self.lenslet, (len(cells), 1))
        known = {tuple(cell): self._fitted(cell) for cell in np.unique(cells, axis=0)}
        return np.array([known[tuple(cell)] for cell in cells]).reshape(-1, 7)

    def _fitted(self, cell: Ints) -> Floats:
        places = self.window.lenses(self.face, cell)
        start = self.lenslet.copy()
        sx, sy = self.signs
        x, y, z = (float(v) for v in places.apex)
        dx, dy, dz = (one - before for one, before in zip((x, y, z), self.face.vertex, strict=True))
        start[:3] += [sx * dx, sy * dy, -self.face.side * dz]
        start[[3, 5, 6]] /= 1.0 if places.size is None else float(places.size)
        return fit_heights(self.aperture, lambda u, v: self.heights(cell, u, v), start, 3)


@dataclass(frozen=True, eq=False)
class ShownCells:
    """Which cells of the sheet the lenslets of a map are.

    side : Side
    first : (2,) ints. Cell of the sheet at step (0, 0) of the map's lattice.
    known : (for i, for j). "stated", "placed" with the mesh of a part, "edge" of the array in the map,
        "mark": a hole or side of the plate or engraved letters in it, or "assumed": the middle of the sheet.
    """

    side: Side
    first: tuple[int, int]
    known: tuple[str, str] = ("assumed", "assumed")

    def of(self, index: Ints) -> Ints:
        """Cells (m, 2) of the sheet at steps (m, 2) of the map's lattice."""
        return np.asarray(self.side.cell(index) + np.array(self.first))

    def numbers(self, index: Ints) -> Floats:
        """Numbers (m, 7) of the design's lenslets at steps (m, 2) of the map's lattice."""
        return self.side.numbers(self.of(index))

    def __str__(self) -> str:
        words = [f"{name} {at} ({how})" for name, at, how in zip("ij", self.first, self.known, strict=True)]
        return ", ".join(words)


def first_cells(side: Side, stated: tuple[int, int] | None) -> ShownCells:
    """Cells of a map whose middle shows the stated cell, or that of the sheet.

    Raises BadRequest: The sheet has no such cell.
    """
    if stated is None:
        i, j = central_cell(side.window)
        return ShownCells(side, (int(i), int(j)))
    if not side.window.lattice.contains(np.array(stated)):
        raise BadRequest(f"cell {stated[0]},{stated[1]}: the sheet has no such cell")
    return ShownCells(side, stated, ("stated", "stated"))


def cells_in_map(
    side: Side, index: Ints, empty: Ints, seen: Callable[[], Floats], land: Callable[[], Floats]
) -> ShownCells:
    """Find which cells of a sheet a map shows, by edges of the array, the outline and engraved marks.

    index, empty : (m, 2), (k, 2) Steps of the map's lattice with a lenslet, and with none.
    seen : Gives places of the map and whether they hold points, as `Lenslets.seen`.
    land : Gives points next to the lenslets, as `Lenslets.land`.
    """
    lattice, middle = side.window.lattice, np.array(central_cell(side.window))
    held = side.cell(index)
    fitting = _fitting(lattice, held, side.cell(empty))
    fitting = fitting[np.argsort(np.abs(fitting - middle).sum(axis=1), kind="stable")]
    if not len(fitting):
        return first_cells(side, None)
    marked = fitting
    if len(fitting) > 1 and side.window.outline is not None:
        beside = np.unique((held[:, None] + BESIDE).reshape(-1, 2), axis=0)
        rim = np.any([~lattice.contains(fitting + cell) for cell in beside], axis=0)
        inner = fitting[~rim][:1]  # all of these show the same of the plate
        fits = _by_outline(side, np.concatenate([inner, fitting[rim]]), seen())
        if fits.any() and not fits[: len(inner)].any():
            marked = fitting[rim][fits[len(inner) :]]
    if len(marked) > 1:
        marked = marked[_by_letters(side, marked, land)]
    edge, mark = (np.ptp(some, axis=0) == 0 for some in (fitting, marked))
    known = ["edge" if edge[k] else "mark" if mark[k] else "assumed" for k in (0, 1)]
    return ShownCells(side, (int(marked[0, 0]), int(marked[0, 1])), (known[0], known[1]))


BESIDE = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
"""Steps to neighbouring cells."""


def _by_outline(side: Side, cells: Ints, seen: Floats) -> Bools:
    """Which cells (n, 2) at the middle of a map fit best what it shows of the plate: its sides and holes.

    None where they leave too much of what was not measured unexplained.

    seen : (m, 3) Places from the centre of that cell, and whether points were measured there.
    """
    window = side.window
    places, shift = seen[:, :2] * side.signs, np.zeros(2)
    if not window.one_outline:
        shift = np.asarray(window.placements[side.array].shift)
    assert window.outline is not None
    off = np.array(
        [
            np.sum(inside_outline(window.outline, places + centre - shift) != (seen[:, 2] > 0.0))
            for centre in window.centres(side.array, cells)
        ]
    )
    unknown = float(np.sum(seen[:, 2] == 0.0))
    return np.asarray((off <= off.min() + CLOSE) & (off <= CLOSE + DAMAGED * unknown))


def _by_letters(side: Side, cells: Ints, land: Callable[[], Floats]) -> Bools:
    """Which cells (n, 2) at the middle of a map fit best the letters that are engraved in its land; all
    where it shows none.
    """
    every, window = np.ones(len(cells), dtype=bool), side.window
    try:
        place = mark_place(window, side.body)
    except NoFixture:
        return every
    x, y, height = land()
    depth = place.depth * side.millimetre
    below = side.face.vertex[2] - place.centre[2] * side.millimetre - height  # of the land
    floor = np.abs(below - depth) < 0.5 * depth
    bare = floor | (np.abs(below) < 0.5 * depth)
    if side.face.side < 0 or floor.sum() < FEWEST_SUNK:
        return every
    letters = _Letters.drawn(window, side.body, place)
    points = np.stack([x, y], axis=1)[bare] * side.signs
    off = [
        np.sum(letters.holds((points + centre) / side.millimetre) != floor[bare])
        for centre in window.centres(side.array, cells)
    ]
    best = np.asarray(np.array(off) == min(off))
    return best if best.sum() == 1 and min(off) < LEGIBLE * floor.sum() else every


FEWEST_SUNK, LEGIBLE = 30, 0.5
"""Fewest points of a map on the floor of letters by which its cells are known; largest share of them, and of
points of the land in their place, that may be elsewhere.
"""

DOTS = 64
"""Dots over the height of a line of letters."""


@dataclass(frozen=True, eq=False)
class _Letters:
    """Picture of a line of engraved letters.

    low : (2,) mm. Its corner in the sheet; dot : mm; dots : (columns, rows) Whether there is a letter.
    """

    low: Floats
    dot: float
    dots: Bools

    @staticmethod
    def drawn(window: Window, body: Body, place: MarkPlace) -> _Letters:
        """The letters of a body as its marked file has them."""
        from PIL import Image, ImageDraw

        from clacad.exporting.fixtures.engraving import engravings

        dot = place.height / DOTS
        low = np.array(place.centre[:2]) - 0.5 * np.array([place.width, place.height]) - dot
        picture = Image.new("1", (int(place.width / dot) + 3, DOTS + 3))
        loops = engravings(window, window.name)[body.name].loops
        for loop in sorted(loops, key=polygon_area, reverse=True):  # the inside of an "o" after its outside
            ink = int(polygon_area(loop) > 0.0)
            ImageDraw.Draw(picture).polygon([*map(tuple, (loop - low) / dot - 0.5)], fill=ink)
        return _Letters(low, dot, np.array(picture).T)

    def holds(self, points: Floats) -> Bools:
        """Which points (n, 2), mm, lie in a letter."""
        at = np.floor((points - self.low) / self.dot).astype(np.int64)
        inside: Bools = np.asarray(((at >= 0) & (at < self.dots.shape)).all(axis=1))
        i, j = np.where(inside[:, None], at, 0).T
        return np.asarray(inside & self.dots[i, j])


CLOSE = 5
"""Places of a map by which one position on a plate must fit better than another to be the right one."""


def placed_cells(side: Side, middle: tuple[float, float] | None, origin: Floats) -> ShownCells | None:
    """Which cells a map shows whose middle (2,) in the sheet is known, along the map's x and y; else None.

    origin : (2,) lengths. Centre of step (0, 0) of the map's lattice, from the middle of the map.
    """
    if middle is None:
        return None
    x, y = (np.array(middle) + origin) * side.signs
    [cell], _, _ = side.window.locate(side.array, np.array([x]), np.array([y]))
    return ShownCells(side, (int(cell[0]), int(cell[1])), ("placed", "placed"))


FEWEST_EMPTY = 2
"""Fewest places without a lenslet that are an edge of an array; a single one may be damage."""

DAMAGED = 0.2
"""Largest share of the places without a lenslet that may be damage next to an edge, or next to a hole."""


def _fitting(lattice: Lattice, held: Ints, empty: Ints) -> Ints:
    """Displacements (n, 2) by which cells `held` are kept ones of a lattice, and fewest of `empty`.

    Edges, corners and holes of the array are where it keeps no cells. Where they leave too many of `empty`
    unexplained, only `held` decides.
    """
    kept = lattice.cells()
    low, high = kept.min(axis=0) - held.max(axis=0), kept.max(axis=0) - held.min(axis=0)
    moves = np.stack(
        [one.ravel() for one in np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)))],
        axis=1,
    )
    moves = moves[_landed(kept, held, moves) == len(held)]
    damaged = _landed(kept, empty, moves)
    best = damaged.min(initial=len(empty))
    enough = len(empty) - best >= FEWEST_EMPTY and best <= DAMAGED * len(empty)
    return np.asarray(moves[damaged == best] if enough else moves)


def _landed(kept: Ints, cells: Ints, moves: Ints) -> Ints:
    """How many of cells (m, 2) are kept ones of a lattice, for each displacement (n, 2) of them."""
    from scipy.signal import correlate

    if not len(cells):
        return np.zeros(len(moves), dtype=np.int64)
    masks = [np.zeros(np.ptp(one, axis=0) + 1) for one in (kept, cells)]
    for mask, one in zip(masks, (kept, cells), strict=True):
        mask[tuple((one - one.min(axis=0)).T)] = 1.0
    found = np.rint(correlate(*masks)).astype(np.int64)
    at = moves - kept.min(axis=0) + cells.min(axis=0) + masks[1].shape - 1
    inside = ((at >= 0) & (at < found.shape)).all(axis=1)
    return np.where(inside, found[tuple(np.where(inside[:, None], at, 0).T)], 0)


ALONG = 17
"""Places along a side of an aperture where heights are compared."""


def _signs(face: Face) -> tuple[float, float]:
    return AXES["front" if face.side > 0 else "back"]


def _steps(lattice: Pattern) -> Floats:
    """Columns: steps of a lattice."""
    return np.column_stack([lattice.a1, lattice.a2])


def _seen(lattice: Lattice, signs: tuple[float, float]) -> Lattice:
    """The lattice in the axes of a map: turned the other way where the map is a mirror image."""
    mirrored = signs[0] * signs[1] < 0.0
    return replace(lattice, turn=-lattice.turn, outline=None) if mirrored and lattice.turn else lattice


def _outward(face: Face, u: Floats, v: Floats) -> Floats:
    """Height (n,) of the design's lenslet above its vertex, out of the material, over places of a map's
    cell.
    """
    sx, sy = _signs(face)
    return np.asarray(-face.side * (lens_height(face, sx * u, sy * v) - face.vertex[2]))


def sides_of(window: Window, millimetre: float) -> dict[Name, Side]:
    """Sides of a sheet that a map can be compared with.

    millimetre : Lengths of a design unit in a millimetre.
    Raises NotPossible: The sheet has no curved faces, or lenslets of a side have power along one axis only.
    """
    curved = [
        (body, face) for body in window.bodies for face in (body.front, body.back) if face.array is not None
    ]
    if len(curved) < 2:
        raise NotPossible(f"{window.name}: it has no two arrays of lenslets that maps could show")
    names: tuple[Name, Name] = ("front", "back")
    return {
        name: _side(name, window, *one, millimetre)
        for name, one in zip(names, (curved[0], curved[-1]), strict=True)
    }


def _side(name: Name, window: Window, body: Body, face: Face, millimetre: float) -> Side:
    assert face.array is not None
    aperture = aperture_of(_seen(window.lattice_of(face.array), _signs(face)), millimetre)
    if 0.0 in (face.surface.curvature_x, face.surface.curvature_y):
        raise NotPossible(
            f"{window.name}: the {name} has cylinders: a lenslet of a map has power along both axes"
        )
    lenslet = fit_heights(
        aperture, lambda u, v: _outward(face, u, v), _parabola(aperture, lambda u, v: _outward(face, u, v))
    )
    return Side(name, window, body, face, aperture, lenslet, millimetre)


def _parabola(aperture: Aperture, heights: Callable[[Floats, Floats], Floats]) -> Floats:
    """Numbers (7,) near those of a lenslet: of the parabola through it, from which a fit starts."""
    u, v = aperture.grid(ALONG)
    known = np.column_stack([np.ones(len(u)), u, v, u * u, v * v, u * v])
    z0, gx, gy, xx, yy, xy = np.linalg.lstsq(known, heights(u, v), rcond=None)[0]
    x0, y0 = np.linalg.solve([[2.0 * xx, xy], [xy, 2.0 * yy]], [-gx, -gy])
    top = z0 + 0.5 * (gx * x0 + gy * y0)
    return np.array([x0, y0, top, -(xx + yy), 0.0, -0.5 * (xx - yy), -0.5 * xy])
