"""Classes of the planar cell complex: profiles, borders, nodes.

Where all cells of an array are identical pieces, the complex of a sheet of any size is one prototile:
m/2 *border classes* (a border and the opposite border of the neighbour are one class) and
one *node class* (square, rectangular: four cells meet) or two (hexagonal: three cells meet).

Conventions
-----------
* Side k of a tile runs from corner k to corner k + 1 counter-clockwise and is crossed by
  `lattice.steps[k]`. Border class k < m/2 is side k of its *left* cell (the cell whose frame is used)
  and side k + m/2 of its *right* cell, the neighbour at `steps[k]`.
* Along a border t runs from 0 at corner k to 1 at corner k + 1 of the left cell, so the left cell
  lies on the left hand of the direction of t.
* Heights are sheet-frame z. A step is d(t) = z_left(t) − z_right(t).

Walls are strips where exactly one of two columns is solid, and those that share a vertical edge at a node.

Mesh and B-Rep both use this module, with different heights: integer multiples of a step for triangles,
millimetres for faces.

`CannotBuild`: the error for a body that cannot be made, with a code, the reason and a remedy.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.sheet.window import Body, Face, Window, lens_height

if TYPE_CHECKING:
    from clacad.sheet.pattern import NodeCells

Side = Literal["front", "back"]
SIDES: tuple[Side, Side] = ("front", "back")


@dataclass(frozen=True, slots=True, eq=False)
class HeightProfile:
    """The exact height of one lenslet, land plane or plane face along a straight line of the cell frame.

    start, end : (2,) lengths
        The line in the frame of the cell the face belongs to; t = 0 at start, 1 at end.
    """

    face: Face
    start: tuple[float, float]
    end: tuple[float, float]

    def points(self, t: Floats) -> Floats:
        """Cell-frame points (n, 2) at parameters t (n,); both ends are met exactly."""
        t = np.asarray(t, dtype=np.float64)[..., None]
        a, b = np.asarray(self.start), np.asarray(self.end)
        return np.asarray(np.where(t < 0.5, a + t * (b - a), b - (1.0 - t) * (b - a)))

    def lens(self, t: Floats) -> Floats:
        """Height of the lenslet (of the plane, for a plane face) at t (n,); NaN where it has no point."""
        if self.face.array is None:
            return np.full(np.shape(t), self.face.vertex[2])
        xy = self.points(t)
        return lens_height(self.face, xy[..., 0], xy[..., 1])


@dataclass(frozen=True, slots=True, eq=False)
class Border:
    """One class of congruent borders.

    step : (di, dj). Index step from the left to the right cell.
    start, end : (2,) lengths. In the left cell's frame (t = 0, 1).
    breaks : (n,) parameters
        Every parameter at which anything on the border changes (crossings of fronts and of backs, rims of
        either cell, ends of shared material), ascending, ends excluded. Both cells need a vertex there.
    roots : (n,) parameters. Every sign change of every difference of lens and land heights on the border,
        visible or not (for example a crossing hidden under land), unspaced; `breaks` is chosen from them.
    """

    step: tuple[int, int]
    start: tuple[float, float]
    end: tuple[float, float]
    breaks: Floats
    roots: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """One class of congruent nodes, where the corners of k cells meet.

    cells : (((di, dj), corner), ...). The k cells counter-clockwise: index step from the first cell, and
        which of its tile's corners lies at the node. The first entry is ((0, 0), corner).
    saddle_front, saddle_back : bool
        Four walls share one vertical edge: one diagonal pair of cells is higher than the other.
    """

    cells: NodeCells
    saddle_front: bool
    saddle_back: bool


@dataclass(frozen=True, slots=True, eq=False)
class Tiling:
    """The complex of the faces that repeat on one array.

    array : 0 or 1
    shift : (2,) lengths. Displacement of the array's cells against the lattice.
    tile : (m, 2) lengths
    borders : m/2 of them
    nodes : 1 or 2
    """

    array: int
    shift: tuple[float, float]
    tile: Floats
    borders: tuple[Border, ...]
    nodes: tuple[Node, ...]


@dataclass(frozen=True, slots=True, eq=False)
class CellComplex:
    """ONE topology of a body, from which mesh and B-Rep are both derived.

    merge : length. Merge height h: heights at a node or border closer than h are merged.
    tilings : (Tiling,) or (front's Tiling, back's Tiling). One where the body is cut into columns (both faces
        on one tiling, or one face a plane); two for a slab whose arrays are displaced against one another.
    """

    window: Window
    body: Body
    merge: float
    tilings: tuple[Tiling, ...]

    @property
    def columnar(self) -> bool:
        """Whether one tiling cuts the whole body into columns."""
        return len(self.tilings) == 1


class BorderCurve(NamedTuple):
    """A column's face over a border. `column`: 0 left, 1 right.

    `opens`: material begins above it (a front).
    """

    column: int
    opens: bool


def solid_strips(
    curves: Iterable[Sequence[BorderCurve]], below: tuple[bool, bool] = (False, False)
) -> list[tuple[bool, bool]]:
    """Whether the left and the right column are solid in each strip between consecutive curves over a border.

    curves : Ascending; coincident curves of both columns are passed together.
    below : (left, right). Whether a column is solid below all curves.
    Returns list of (left, right): One fewer than there are curves. A wall fills a strip where the two differ.
    """
    depth = [int(solid) for solid in below]
    strips = []
    for together in curves:
        for curve in together:
            depth[curve.column] += 1 if curve.opens else -1
        strips.append((depth[0] > 0, depth[1] > 0))
    return strips[:-1]


def runs_round(solid: Sequence[bool]) -> list[int]:
    """Number the runs of adjacent solid sectors around a vertical line; −1 where a sector is not solid.

    Counter-clockwise; run 0 is the first that begins after sector −1. The two walls of a run share one
    vertical edge. Two runs are a saddle: columns that touch in a line.
    """
    starts = [s for s in range(len(solid)) if solid[s] and not solid[s - 1]]
    runs = [0 if one else -1 for one in solid]
    for number, s in enumerate(starts):
        while solid[s % len(solid)]:
            runs[s % len(solid)] = number
            s += 1
    return runs


def linked(heights: Floats | Ints, gap: float) -> Ints:
    """Single linkage: numbers, ascending, of clusters of heights (..., n) with steps of at most `gap`."""
    number = np.zeros(heights.shape, dtype=np.int64)
    number[..., 1:] = np.cumsum(np.diff(heights, axis=-1) > gap, axis=-1)
    return number


CODES: dict[str, str] = {
    "CL130": "a lens surface that ends inside its cell",
    "CL131": "a rim that sticks out of its web",
    "CL132": "a rim that turns too sharply for an edge",
    "CL133": "a lens undercut, or too steep for one patch",
    "CL134": "land that a border, seam or displaced array needs and the body lacks",
    "CL135": "a bevel that the sheet cannot hold",
    "CL136": "a cell beyond the outline",
    "CL137": "a body thinner than float32 heights can resolve",
    "CL138": "a lenslet that no point of the facets' grid meets",
    "CL139": "something made for uniform sheets, requested of a non-uniform sheet",
}
"""Meaning of each stable code of a body that cannot be made."""


class CannotBuild(ValueError):
    """A body of this design cannot be made. The message begins with the code and names a remedy.

    Exit status 2.

    code : A key of `CODES`.
    """

    exit_status = 2

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(f"{code}: {reason}")
        self.code = code

    def __reduce__(self) -> tuple[type[CannotBuild], tuple[str, str]]:
        return CannotBuild, (self.code, str(self).removeprefix(f"{self.code}: "))


def refuse_buried_land(front: Face, back: Face) -> None:
    """Refuse a plano lens whose land lies behind its plane face: no material is left between its lenslets.

    Raises CannotBuild: CL134, with the thickness at which the land fits.
    """
    lens, plane = (front, back) if back.array is None else (back, front)
    if lens.array is None or plane.array is not None or lens.land is None:
        return
    if lens.side * (plane.vertex[2] - lens.land) <= 0.0:
        depth = lens.side * (lens.land - lens.vertex[2])
        raise CannotBuild(
            "CL134",
            "the land of a plano lens lies behind its plane face, so that nothing joins the lenslets;"
            f" pair.thickness of more than {depth:.6g} design units holds it (or a smaller"
            " lattice.seam_depth; or leave out seam, border and outline)",
        )
