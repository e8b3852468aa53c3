"""Straight segments along which two columns meet: stations, edges, walls. Lengths in mm.

A segment runs from a to b; the *left* column lies on the left hand. Each column is solid between its front
and its back, so along the segment there are up to four border curves. *Stations* cut the segment wherever
something changes (rims, crossings). Between two stations the curves keep their order, and there is a wall
wherever exactly one of the two columns is solid. Curves closer than the merge height along a whole piece
share one edge.

The cell complex (`topology.borders`) defines where the faces of two cells cross, `topology.wall_strips` where
walls are. Heights are those of the written curves, in mm, so that every edge ends at its vertices. Crossings
are searched here only on segments unknown to the complex: land around the cells, sides of a seam's islands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.sign_changes import sign_changes
from clacad.base.types import Floats
from clacad.solid.face_pattern import SNAP, Kind
from clacad.topology.complex_parts import BorderCurve, solid_strips

if TYPE_CHECKING:
    from clacad.solid.rational_conics import Arc
    from clacad.solid.repeated_cell import Cell, CellFace

TOLERANCE = 1e-7
"""Length below which CAD programs merge two points (mm)."""

NOISE = 1e-13
"""Rounding error of heights of some tens of millimetres (mm)."""

RULED_BELOW = 0.032
"""A wall narrower than this share of its arcs' sagitta is ruled, not plane: 8/250, κL²/250 with κL² = 8
sagittas."""

FLATTEST = 2e-3
"""Slope at which an arc must leave a straight edge for the wall between them to be plane, even with a narrow
end.

CAD programs intersect a line and an arc by roots, not by polygons, so their closeness does no harm. Only the
stretch in which the two are closer than 1e-10 must be shorter than a vertex's tolerance of 1e-7, which takes
a slope of 1e-3.
"""

_T = 0.5 - 0.5 * np.cos(np.pi * np.arange(35) / 34)


@dataclass(frozen=True, eq=False, slots=True)
class Column:
    """One side of a segment.

    faces : (front, back)
    runs : (front's, back's) stretches ((t0, t1, kind), ...) along the segment
    offset : (2,), mm. Centre of the column's cell in the frame of the segment.
    outside : Whether the column is the land around the cells, not a cell.
    """

    faces: tuple[CellFace, CellFace]
    runs: tuple[tuple[tuple[float, float, Kind], ...], tuple[tuple[float, float, Kind], ...]]
    offset: Floats
    outside: bool = False

    def kind(self, face: int, t: float) -> Kind:
        """Kind of the face at parameter t."""
        return next((kind for t0, t1, kind in self.runs[face] if t0 <= t <= t1), self.runs[face][-1][2])


@dataclass(frozen=True, eq=False, slots=True)
class Strand:
    """A border curve on one piece: its column (0 left, 1 right), face (0 front, 1 back) and kind."""

    column: int
    face: int
    kind: Kind
    z: Floats


@dataclass(frozen=True, eq=False, slots=True)
class CurveShape:
    """One edge of a piece: the strands that share it, its arc, the distance of the strands from it (mm)."""

    strands: tuple[Strand, ...]
    arcs: tuple[Arc, ...]
    apart: float


@dataclass(frozen=True, slots=True)
class WallShape:
    """A wall between curves `low` and `high` of its piece; `solid`: column behind it (0 left, 1 right)."""

    low: int
    high: int
    solid: int
    ruled: bool


@dataclass(frozen=True, eq=False, slots=True)
class PieceShape:
    """Edges and walls between two stations."""

    curves: tuple[CurveShape, ...]
    walls: tuple[WallShape, ...]
    joined: bool


@dataclass(frozen=True, eq=False, slots=True)
class SegmentShape:
    """A class of congruent segments, before its ends are tied to vertices.

    stations : (n,) parameters, 0 and 1 included
    points : (n, 2), mm
    heights : tuple of (2, 2) arrays
        Heights [column, face] at every station (mm); NaN where there is no face.
    pieces : n − 1
    runs : runs[column][face] = numbers of the pieces in each stretch, in the direction of the segment
    crossings : Number of stations that are crossings of two faces.
    """

    stations: Floats
    points: Floats
    heights: tuple[Floats, ...]
    pieces: tuple[PieceShape, ...]
    runs: tuple[tuple[tuple[tuple[int, ...], ...], ...], ...]
    crossings: int


def column_of_side(cell: Cell, k: int, offset: Floats, reverse: bool) -> Column:
    """The column of a cell along side k of its tile; `reverse`: the segment runs against the side."""
    runs = tuple(_face_runs(cell, face, k, reverse) for face in cell.faces)
    return Column(cell.faces, (runs[0], runs[1]), offset)


def _face_runs(cell: Cell, face: CellFace, k: int, reverse: bool) -> tuple[tuple[float, float, Kind], ...]:
    if face.open or face.plane:
        return ((0.0, 1.0, "open" if face.open else "plane"),)
    if cell.island:
        return ((0.0, 1.0, "land"),)
    assert face.pattern is not None
    side = [(run.t0, run.t1, run.kind) for run in face.pattern.runs[k]]
    return tuple((1.0 - t1, 1.0 - t0, kind) for t0, t1, kind in reversed(side)) if reverse else tuple(side)


def zone_columns(cell: Cell, k: int) -> tuple[Column, Column]:
    """Columns inside and outside side k of an island's zone: the lens, and the seam's land."""
    inner: list[tuple[tuple[float, float, Kind], ...]] = []
    outer: list[tuple[tuple[float, float, Kind], ...]] = []
    for face in cell.faces:
        if face.pattern is None:
            flat: Kind = "open" if face.open else "plane"
            inner.append(((0.0, 1.0, flat),))
            outer.append(((0.0, 1.0, flat),))
        else:
            inner.append(tuple((run.t0, run.t1, run.kind) for run in face.pattern.runs[k]))
            outer.append(((0.0, 1.0, "land"),))
    zero = np.zeros(2)
    return Column(cell.faces, (inner[0], inner[1]), zero), Column(cell.faces, (outer[0], outer[1]), zero)


def segment_shape(
    a: Floats, b: Floats, columns: Sequence[Column | None], merge: float, breaks: Floats | None = None
) -> SegmentShape:
    """Analyse one class of segments.

    a, b : (2,), mm
    columns : (left, right). None where there is no column.
    merge : mm. Merge height h.
    breaks : (n,) parameters or None
        Crossings of faces, from the cell complex; None: find them (borders of land, sides of islands).
    Raises ValueError: A wall would cross itself: a crossing was missed. This has never occurred; the check
        proves it.
    """
    length = float(np.hypot(*(b - a)))
    stops = [0.0, 1.0]
    for column in columns:
        if column is not None:
            stops += [t for runs in column.runs for t0, t1, _ in runs for t in (t0, t1)]
    stops = _distinct(stops, SNAP / length)
    before = len(stops)
    if breaks is None:
        spans = zip(stops[:-1], stops[1:])
        crossings = [t for low, high in spans for t in _crossings(a, b, columns, low, high, merge)]
    else:
        crossings = breaks.tolist()
    stops = _distinct([*stops, *crossings], SNAP / length)
    pieces = tuple(_piece(a, b, columns, low, high, merge) for low, high in zip(stops[:-1], stops[1:]))
    t = np.array(stops)
    points = a + t[:, None] * (b - a)
    points[-1] = b
    heights = tuple(_heights_at(columns, points[i], stops, i) for i in range(len(stops)))
    runs = tuple(_runs(column, 0.5 * (t[:-1] + t[1:])) for column in columns)
    return SegmentShape(t, points, heights, pieces, runs, len(stops) - before)


def _distinct(stops: list[float], width: float) -> list[float]:
    """Sorted stops; 0 and 1 are kept, others dropped if closer than `width` to the previous one or an end."""
    kept = [0.0]
    for t in sorted(stops):
        if t - kept[-1] > width and 1.0 - t > width:
            kept.append(t)
    return [*kept, 1.0]


def _strand(column: Column, face: int, kind: Kind, xy: Floats) -> Floats:
    own = xy - column.offset
    return column.faces[face].height(kind, own[:, 0], own[:, 1])


def _crossings(
    a: Floats, b: Floats, columns: Sequence[Column | None], low: float, high: float, merge: float
) -> list[float]:
    """Parameters in (low, high) at which a face of the left column crosses one of the right."""
    left, right = columns
    if left is None or right is None:
        return []
    found: list[float] = []
    middle = 0.5 * (low + high)
    for f in (0, 1):
        for g in (0, 1):
            kinds = left.kind(f, middle), right.kind(g, middle)
            if "lens" not in kinds or "none" in kinds or "open" in kinds:
                continue  # two planes never cross

            def step(
                t: Floats, f: int = f, g: int = g, kinds: tuple[Kind, Kind] = kinds, low: float = low
            ) -> Floats:
                xy = a + (low + np.asarray(t)[:, None] * (high - low)) * (b - a)
                return _strand(left, f, kinds[0], xy) - _strand(right, g, kinds[1], xy)

            samples = step(_T)
            if f != g and (np.nanmin(samples) > merge or np.nanmax(samples) < -merge):
                continue
            if np.nanmax(np.abs(samples)) > merge:
                found += [low + float(t) * (high - low) for t in sign_changes(step, NOISE)]
    return found


def _piece(
    a: Floats, b: Floats, columns: Sequence[Column | None], low: float, high: float, merge: float
) -> PieceShape:
    """Edges and walls between the stations at parameters low and high."""
    start, end = a + low * (b - a), (b if high == 1.0 else a + high * (b - a))
    xy = start + _T[:, None] * (end - start)
    middle = 0.5 * (low + high)
    strands = []
    for c, column in enumerate(columns):
        for f in (0, 1):
            kind = "none" if column is None else column.kind(f, middle)
            if column is not None and kind not in ("none", "open"):
                strands.append(Strand(c, f, kind, _strand(column, f, kind, xy)))
    strands = [s for s in strands if not _plane_within(s, strands)]
    strands.sort(key=lambda s: (float(s.z[17]), s.column, s.face))
    groups: list[list[Strand]] = []
    for strand in strands:
        if groups and all(_one(strand, other, merge) for other in groups[-1]):
            groups[-1].append(strand)
        else:
            groups.append([strand])
    curves = tuple(_curve(group, columns, start, end) for group in groups)
    solid = _solid_strips(groups, columns, middle)
    walls = tuple(
        _wall(curves, i, 0 if left else 1, merge) for i, (left, right) in enumerate(solid) if left != right
    )
    return PieceShape(curves, walls, (True, True) in solid or _open_join(columns, middle))


def _plane_within(strand: Strand, strands: list[Strand]) -> bool:
    """Whether a strand lies inside one plane face that continues across the segment: no edge there."""
    return strand.kind == "plane" and any(
        s.kind == "plane" and s.face == strand.face and s.column != strand.column for s in strands
    )


def _one(strand: Strand, other: Strand, merge: float) -> bool:
    return strand.column != other.column and float(np.max(np.abs(strand.z - other.z))) <= merge


def _solid_strips(
    groups: list[list[Strand]], columns: Sequence[Column | None], t: float
) -> list[tuple[bool, bool]]:
    """For each strip between consecutive curves: whether the left and the right column are solid in it.

    A column without an edge at its front (a continuing plane, an open side) is solid from below all curves.
    """
    there = [c is not None and "none" not in (c.kind(0, t), c.kind(1, t)) for c in columns]
    fronts = {s.column for group in groups for s in group if s.face == 0}
    curves = [[BorderCurve(s.column, s.face == 0) for s in group if there[s.column]] for group in groups]
    return solid_strips(curves, (there[0] and 0 not in fronts, there[1] and 1 not in fronts))


def _open_join(columns: Sequence[Column | None], t: float) -> bool:
    """Whether two columns surely share material: both are bounded by the same plane or open side."""
    left, right = columns
    if left is None or right is None:
        return False
    return any(left.kind(f, t) == right.kind(f, t) and left.kind(f, t) in ("plane", "open") for f in (0, 1))


def _curve(group: list[Strand], columns: Sequence[Column | None], start: Floats, end: Floats) -> CurveShape:
    arcs = []
    for strand in group:
        column = columns[strand.column]
        assert column is not None
        arc = column.faces[strand.face].arc(strand.kind, start - column.offset, end - column.offset)
        arcs.append(arc.moved(np.append(column.offset, 0.0)))
    order = sorted(range(len(group)), key=lambda i: -arcs[i].degree)
    strands, arcs = [group[i] for i in order], [arcs[i] for i in order]
    apart = 0.0
    for strand, arc in zip(strands[1:], arcs[1:]):
        apart = max(apart, float(np.max(np.abs(strand.z - strands[0].z))))
        if arc.degree == arcs[0].degree:
            apart = max(apart, float(np.max(np.linalg.norm(arc.poles - arcs[0].poles, axis=1))))
    return CurveShape(tuple(strands), tuple(arcs), apart)


def _wall(curves: tuple[CurveShape, ...], low: int, solid: int, merge: float) -> WallShape:
    under, over = curves[low].strands[0].z, curves[low + 1].strands[0].z
    gap = over - under
    if float(gap.min()) < -merge:
        raise ValueError("a wall between two lenslets crosses itself; please report the design")
    arcs = curves[low].arcs[0], curves[low + 1].arcs[0]
    sagitta = max(abs(_sagitta(arc)) for arc in arcs)
    narrow = float(gap.min()) < max(RULED_BELOW * sagitta, 2.0 * merge)
    return WallShape(low, low + 1, solid, narrow and not _opens(arcs, gap, merge))


def _opens(arcs: tuple[Arc, Arc], gap: Floats, merge: float) -> bool:
    """Whether a wall has one straight edge and the other leaves it steeply enough at both ends."""
    if not any(arc.straight for arc in arcs):
        return False
    if any(merge < end < 2.0 * merge for end in (gap[0], gap[-1])):
        return False
    length = float(np.linalg.norm(arcs[0].poles[-1] - arcs[0].poles[0]))
    steep = max(FLATTEST * length, 20.0 * merge)  # ends may be shifted by the merge height: a tenth of it
    return bool((gap >= steep * _T * (1.0 - _T))[1:-1].all())


def _sagitta(arc: Arc) -> float:
    middle = arc.at(np.array([0.5]))[0]
    return float(np.linalg.norm(middle - 0.5 * (arc.poles[0] + arc.poles[-1])))


def _heights_at(columns: Sequence[Column | None], point: Floats, stops: list[float], i: int) -> Floats:
    """Heights [column, face] at station i; a face that ends there is included with its height at the end."""
    heights = np.full((2, 2), np.nan)
    sides = [0.5 * (stops[j] + stops[j + 1]) for j in (i - 1, i) if 0 <= j < len(stops) - 1]
    for c, column in enumerate(columns):
        if column is None:
            continue
        for f in (0, 1):
            kinds = [kind for t in sides if (kind := column.kind(f, t)) != "none"]
            if kinds:
                best: Kind = next((kind for kind in kinds if kind != "lens"), kinds[0])
                heights[c, f] = _strand(column, f, best, point[None])[0]
    return heights


def _runs(column: Column | None, middles: Floats) -> tuple[tuple[tuple[int, ...], ...], ...]:
    if column is None:
        return ((), ())
    return tuple(
        tuple(tuple(int(i) for i in np.flatnonzero((middles > t0) & (middles < t1))) for t0, t1, _ in runs)
        for runs in column.runs
    )
