"""Cells that represent a whole sheet, by purpose: the one home of every rule.

A rule is deterministic and fast: it computes no light. `tracing/worst_cell.py` chooses among the cells of
"light" by rays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Literal
from weakref import WeakKeyDictionary

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats, Ints
from clacad.sheet.cell_places import extreme_cells
from clacad.sheet.lattice import Rectangle
from clacad.sheet.plate import Plate
from clacad.sheet.window import (
    Face,
    Window,
    heights_and_normals_of_lenses,
    heights_of_lenses,
    lens_height,
    lens_height_and_normal,
    optical_tile,
)

if TYPE_CHECKING:
    from clacad.sheet.lattice import Lattice

Purpose = Literal["displaced", "drawing", "facets", "file", "light", "rounding", "sample"]
"""What cells are chosen for; see `representative_cells`."""

ALONG = 9
"""Number of points on a side of a cell at which lenses are compared."""
BLOCK = 1 << 14
"""Number of cells compared at a time."""

SAMPLED = 64
"""Number of cells sampled on a large sheet, in addition to the extreme cells."""

SIDES = 4
"""Number of directions in which the cell with the farthest lens is checked."""

RANDOM_CELLS = 4
"""Cells at random places of a sheet, of those that a file is compared in."""

LIT = 16
"""Number of lit cells tried in addition to those with the outermost lenses."""

DIRECTIONS = 8
"""Number of directions in which the outermost lenses among lit cells are searched."""


def representative_cells(window: Window, purpose: Purpose, count: int = SAMPLED) -> Ints:
    """Kept cells (m, 2) that represent a sheet for a purpose.

    purpose : str. displaced: of a non-uniform sheet, those whose lenses are displaced farthest, smallest,
        largest or steepest. drawing: the first, the middle, and the one whose lens lies farthest from its
        middle. facets, light: displaced and sample, each once, in order. file: of a uniform sheet, the
        middle, the corners, the middles of the sides, and a few at random. rounding: one far from the
        middle, where coordinates are rounded most. sample: spread evenly over the sheet.
    count : Most cells of a sample.
    """
    return _RULES[purpose](window, count)


def central_cell(window: Window) -> tuple[int, int]:
    """Kept cell nearest to the centre of the sheet, so that rays find neighbours on all sides."""
    lattice = window.lattice
    middle = np.array([[0.0], [0.0]])
    index, _, _ = lattice.locate(middle[0], middle[1])
    if lattice.contains(index)[0]:
        return int(index[0, 0]), int(index[0, 1])
    cells = lattice.cells()
    centres = lattice.centres(cells)
    near = cells[int(np.argmin((centres**2).sum(axis=1)))]
    return int(near[0]), int(near[1])


SAME = 1e-12
"""Difference of heights or positions of cells that are the same piece, in pitches: a file's last digit."""

_TURNED: WeakKeyDictionary[Window, int] = WeakKeyDictionary()


def turned_alike(window: Window) -> int:
    """Number of turns about the sheet's axis, 4, 2 or 1, after which every cell is again the same piece.

    Outlines of the bodies and marks may break the symmetry of a sheet, see `sectors_of`.
    """
    if window not in _TURNED:
        found = (copies for copies in (4, 2) if _alike_after(window, copies))
        _TURNED[window] = next(found, 1)
    return _TURNED[window]


def turned_cells(lattice: Lattice, cells: Ints, copies: int) -> Ints:
    """Cells (n, 2) that cells (n, 2) come to lie on after a turn by 360 degrees / `copies`, 2 or 4."""
    (i, j), (n1, n2) = cells.T, lattice.count
    if lattice.hexagonal:
        row = n2 - 1 - j
        return np.stack([n1 - 1 - (i + j // 2) - row // 2, row], axis=1)
    return np.stack([n1 - 1 - i, n2 - 1 - j] if copies == 2 else [n1 - 1 - j, i], axis=1)


def quarter_turned(points: Floats, copies: int) -> Floats:
    """Points (..., 2) after a turn about the origin by 360 degrees / `copies`, 2 or 4: exact."""
    return 0.0 - points if copies == 2 else np.stack([0.0 - points[..., 1], points[..., 0]], axis=-1)


def _alike_after(window: Window, copies: int) -> bool:
    lattice = window.lattice
    pitches = [window.lattice_of(array).pitch for array in range(len(window.placements))]
    square = lattice.count[0] == lattice.count[1] and all(x == y for x, y in pitches)
    placed = any(place.turn or place.shift != (0.0, 0.0) for place in window.placements)
    if placed or isinstance(lattice.outline, Plate) or (copies == 4 and (lattice.hexagonal or not square)):
        return False
    cells = lattice.cells()
    there, near = turned_cells(lattice, cells, copies), SAME * min(lattice.pitch)
    if not lattice.contains(there).all():
        return False
    apart = lattice.centres(there) - quarter_turned(lattice.centres(cells), copies)
    if np.abs(apart).max() > near:
        return False
    for face in window.faces:
        if face.array is None:
            continue
        if face.form is not None:
            return False
        points = 0.9 * np.concatenate([one := optical_tile(window, face.array), 0.5 * one, one[:1] * 0.0])
        here, after = (
            heights_of_lenses(face, window.lenses(face, index[:, None]), *at.T[:, None])
            for index, at in ((cells, points), (there, quarter_turned(points, copies)))
        )
        if not np.allclose(here, after, rtol=0.0, atol=near, equal_nan=True):
            return False
    return True


def sectors_of(window: Window) -> int:
    """Number of equal sectors, 4, 2 or 1, that a sheet can be cut into along borders of its cells.

    An outline is cut along x = 0 and y = 0, where borders of all arrays must lie: no cell may lie there.
    """
    lattice, outline, copies = window.lattice, window.outline, turned_alike(window)
    uncut = isinstance(outline, Plate) or (lattice.hexagonal and outline is not None)
    if uncut or lattice.count[1] % 2:
        return 1
    if isinstance(outline, Rectangle) and abs(outline.width - outline.height) > SAME * min(lattice.pitch):
        return min(copies, 2)
    return copies


def sector(window: Window) -> Window:
    """The window with the cells of its first sector alone; turned by `lattice.copies` it is the whole."""
    return replace(window, lattice=replace(window.lattice, copies=sectors_of(window)))


def _displaced(window: Window) -> Ints:
    """Cells (m, 2) with lenses displaced farthest, in four directions, or of extreme size or slope."""
    changes = [face.change for face in window.faces if face.change is not None]
    if not changes:  # the arrays differ in pitch only
        return _sampled(window, SIDES)
    lattice = window.lattice
    found = []
    for face in window.faces:
        if face.change is None:
            continue
        cells = extreme_cells(face.change, lattice)
        places = window.vertices(face, cells)[:, :2]
        angles = np.arange(SIDES) * (2.0 * np.pi / SIDES)
        found.append(cells[[int(np.argmax(places @ (np.cos(a), np.sin(a)))) for a in angles]])
        found.append(cells[[int(np.argmax(np.hypot(*places.T)))]])
        size = window.lenses(face, cells).size
        if size is not None:
            steep = (lattice.circumradius + np.hypot(*places.T)) / size
            found.append(cells[[int(np.argmin(size)), int(np.argmax(size)), int(np.argmax(steep))]])
    return np.unique(np.concatenate(found), axis=0)


def _sampled(window: Window, count: int) -> Ints:
    """At most `count` kept cells (n, 2), spread evenly over the sheet by Sobol points, deterministic."""
    lattice = window.lattice
    if lattice.cell_count <= count:
        return lattice.cells()
    n1, n2 = lattice.count
    found: Ints = np.empty((0, 2), dtype=np.int64)
    for chunk in range(64):
        i, j = np.floor(sobol(4 * count, 2, skip=1 + 4 * count * chunk) * (n1, n2)).astype(np.int64).T
        index = np.stack([i - j // 2 if lattice.hexagonal else i, j], axis=-1)
        found = np.concatenate([found, index[lattice.contains(index)]])
        _, first = np.unique(found, axis=0, return_index=True)
        found = found[np.sort(first)]
        if len(found) >= count:
            break
    return found[:count]


def _of_file(window: Window) -> Ints:
    """Cells of the sheet that are compared with the design, each once, the middle first.

    They are the middle, the four corners, the middles of the four sides, and a few at random (seed 0).
    """
    lattice = window.lattice
    middle = central_cell(window)
    cells = _rim_of_rows(lattice, middle[1])
    centres = lattice.centres(cells)
    towards = [(x, y) for x in (-1, 1) for y in (-1, 1)] + [(1, 0), (-1, 0), (0, 1), (0, -1)]
    picked = [middle]
    for x, y in towards:
        # corners: farthest along the diagonal; sides: farthest along the axis, nearest its middle
        reach = centres @ np.array([x, y], dtype=np.float64)
        aside = np.abs(centres @ np.array([-y, x], dtype=np.float64))
        best = cells[int(np.lexsort((aside, -np.round(reach / lattice.circumradius, 6)))[0])]
        picked.append((int(best[0]), int(best[1])))
    whole = lattice.outline is None
    for number in np.random.default_rng(0).integers(
        0, lattice.cell_count if whole else len(cells), RANDOM_CELLS
    ):
        j, i = divmod(int(number), lattice.count[0])
        one = lattice.row(j)[i] if whole else cells[number]
        picked.append((int(one[0]), int(one[1])))
    return np.array(list(dict.fromkeys(picked)), dtype=np.int64)


def _rim_of_rows(lattice: Lattice, middle: int) -> Ints:
    """Cells (n, 2), row by row, that include those farthest out along any axis or diagonal.

    They are the first and last row and the ends of the others. With an outline, all cells are returned, or
    the middle row of a sheet of more than 4,000,000 cells.
    """
    if lattice.outline is not None:
        return lattice.cells() if lattice.cell_count <= 4_000_000 else lattice.row(middle)
    last = lattice.count[1] - 1
    rows = [lattice.row(j) if j in (0, last) else lattice.row(j)[[0, -1]] for j in range(last + 1)]
    return np.concatenate(rows)


def _far_from_middle(window: Window) -> Ints:
    """Kept cell far from the middle of the sheet, where coordinates are rounded most."""
    lattice = window.lattice
    n1, n2 = lattice.count
    if lattice.outline is not None:
        ends = lattice.row(n2 // 2)[[0, -1]]
    else:
        ends = np.concatenate([lattice.row(0)[[0, -1]], lattice.row(n2 - 1)[[0, -1]]])
    far = ends[int(np.argmax((lattice.centres(ends) ** 2).sum(axis=1)))]
    return np.asarray(far[None], dtype=np.int64)


def _farthest_lens(window: Window) -> Ints:
    """The kept cell (2,) whose lens lies farthest from the middle of its cell.

    Where all lenses are aligned, it is the cell whose partner is displaced the most.
    """
    cells = window.lattice.cells()
    moved = [face for face in window.faces if face.change is not None]
    apart = [np.hypot(*window.vertices(face, cells)[:, :2].T) for face in moved]
    if not moved:
        apart = [np.hypot(*(window.centres(1, cells) - window.centres(0, cells)).T)]
    return np.asarray(cells[int(np.argmax(np.max(apart, axis=0)))])


def rows_through_outermost(window: Window, cells: Ints) -> list[int]:
    """Rows of rays through distinct kept cells (n, 2): the outermost lenses, then a sample."""
    rows = np.flatnonzero(window.lattice.contains(cells))
    if not len(rows):
        return []
    _, first = np.unique(cells[rows], axis=0, return_index=True)
    rows = rows[np.sort(first)]
    angle = np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS)
    ways = np.stack([np.cos(angle), np.sin(angle)])
    far = [window.centres(1, cells[rows]) - window.centres(0, cells[rows])]
    places = [window.lenses(face, cells[rows]) for face in window.faces]
    far += [one.moved for one in places if one.moved is not None]
    sizes = [sign * one.size for one in places if one.size is not None for sign in (1.0, -1.0)]
    extreme = [rows[np.argmax(moved @ ways, axis=0)] for moved in far] + [rows[[np.argmax(k)]] for k in sizes]
    outer = np.unique(np.concatenate(extreme))
    return [int(row) for row in dict.fromkeys([*outer, *rows[:LIT]])]


def places_of_errors(window: Window) -> Floats:
    """Centres of the sheet's middle and of its farthest cells along the four diagonals, (m, 2)."""
    lattice = window.lattice
    if lattice.cell_count == 1:
        return np.zeros((1, 2))
    x0, x1, y0, y1 = lattice.extent()
    if lattice.outline is None:
        half = 0.5 * np.array([x1 - x0, y1 - y0]) - 0.5 * np.array(lattice.pitch)
        signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
        return np.concatenate([np.zeros((1, 2)), np.unique(signs * np.maximum(half, 0.0), axis=0)])
    centres = lattice.centres(lattice.cells())
    far = [centres[int(np.argmax(centres @ np.array(way)))] for way in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
    return np.concatenate([np.zeros((1, 2)), np.array(far)])


_RULES: Mapping[Purpose, Callable[[Window, int], Ints]] = {
    "displaced": lambda window, _: _displaced(window),
    "drawing": lambda window, _: np.stack(
        [window.lattice.cells()[0], central_cell(window), _farthest_lens(window)]
    ),
    "facets": lambda window, count: _displaced_and_sampled(window, count),
    "file": lambda window, _: _of_file(window),
    "light": lambda window, count: _displaced_and_sampled(window, count),
    "rounding": lambda window, _: _far_from_middle(window),
    "sample": lambda window, count: _sampled(window, count),
}


def _displaced_and_sampled(window: Window, count: int) -> Ints:
    return np.unique(np.concatenate([_displaced(window), _sampled(window, count)]), axis=0)


def outermost_cells(window: Window, face: Face) -> Ints:
    """List kept cells (m, 2) whose lenses bound those of all cells of a non-uniform face."""
    assert face.change is not None
    cells = extreme_cells(face.change, window.lattice)
    if face.change.size is None:
        return cells
    kept = window.lattice.cells()
    ends = np.concatenate(
        [_range_in(window, face, kept[first : first + BLOCK]) for first in range(0, len(kept), BLOCK)]
    )
    low, high = np.nan_to_num(ends[:, 0], nan=np.inf), np.nan_to_num(ends[:, 1], nan=-np.inf)
    outer = [int(np.argmin(low)), int(np.argmax(high))]
    if face.change.rotation is not None:
        outer.append(int(np.argmax(_steepest(window, face, kept))))
    return np.unique(np.concatenate([cells, kept[outer]]), axis=0)


def _range_in(window: Window, face: Face, cells: Ints) -> Floats:
    """Lowest and highest height (n, 2) of a lens in cells (n, 2): on borders or at the level point."""
    assert face.array is not None
    tile = optical_tile(window, face.array)
    t = np.linspace(0.0, 1.0, ALONG)[:-1, None, None]
    sides = ((1.0 - t) * tile + t * np.roll(tile, -1, axis=0)).reshape(-1, 2)
    places = window.lenses(face, cells[:, None])
    heights = heights_of_lenses(face, places, *sides.T[:, None])
    level = level_point(window, face)
    if level is not None and places.size is not None:
        x, y, z = (
            apex + places.size * (at - vertex)
            for apex, at, vertex in zip(places.apex, level, face.vertex, strict=True)
        )
        low, high = tile.min(axis=0), tile.max(axis=0)
        inside = (low[0] <= x) & (x <= high[0]) & (low[1] <= y) & (y <= high[1])
        heights = np.concatenate([heights, np.where(inside, z, np.nan)], axis=1)
    return np.column_stack([np.fmin.reduce(heights, axis=1), np.fmax.reduce(heights, axis=1)])


def _steepest(window: Window, face: Face, cells: Ints) -> Floats:
    """Greatest slope (n,) of a lens at the corners of cells (n, 2)."""
    assert face.array is not None
    corners = optical_tile(window, face.array)
    places = window.lenses(face, cells[:, None])
    _, normal = heights_and_normals_of_lenses(face, places, *corners.T[:, None])
    with np.errstate(invalid="ignore"):
        slopes = np.hypot(normal[..., 0], normal[..., 1]) / normal[..., 2]
    return np.asarray(np.nan_to_num(slopes, nan=0.0).max(axis=1))


def level_point(window: Window, face: Face) -> tuple[float, float, float] | None:
    """Point where a lens is level, its highest or lowest point, cell frame; None where it has none.

    Newton iteration on the height's gradient, which is small and smooth on a lenslet.
    """
    if face.untilted:
        return face.vertex
    x, y = face.vertex[0], face.vertex[1]
    step = 1e-5 * window.lattice.circumradius
    for _ in range(8):
        px = x + np.array([0.0, step, -step, 0.0, 0.0])
        py = y + np.array([0.0, 0.0, 0.0, step, -step])
        _, normal = lens_height_and_normal(face, px, py)
        slope = -normal[:, :2] / normal[:, 2:]
        jacobian = np.stack([slope[1] - slope[2], slope[3] - slope[4]], axis=1) / (2.0 * step)
        if not np.isfinite(jacobian).all() or abs(np.linalg.det(jacobian)) < 1e-300:
            return None
        dx, dy = np.linalg.solve(jacobian, -slope[0])
        x, y = x + float(dx), y + float(dy)
    z = float(lens_height(face, np.array([x]), np.array([y]))[0])
    return (x, y, z) if np.isfinite([x, y, z]).all() else None
