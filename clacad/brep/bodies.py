"""Describe a whole body of a window: its tilings, the land round them, the outline. Lengths in mm."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from math import sqrt
from weakref import WeakKeyDictionary

import numpy as np

from clacad.brep.cell import UP, Cell, CellFace, make_cell, open_face, plane_face
from clacad.brep.columns import Columns
from clacad.brep.conics import Arc, line, ruled_wall
from clacad.brep.edges import Plane
from clacad.brep.pattern import SNAP, Floats, Kind
from clacad.brep.segments import TOLERANCE, Column
from clacad.brep.shell import MERGE, V_HIGH, V_LOW, Loop, LoopEdge, Shells, Writer, reverse
from clacad.cell_complex.build import cell_complex
from clacad.lattice import Circle, Lattice, Outline
from clacad.sheet import Body, Face, Window

ACROSS = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True, eq=False)
class Layer:
    """Cells of one tiling between two faces: a whole body, or half of a displaced slab.

    Attributes
    ----------
    cell : Cell
    shift : (2,), mm
    outside : Column or None
        The land between the cells and the outline.
    breaks : tuple of (n,) parameters, or None
        Per class of borders between two cells: where anything changes, from the cell complex.
    """

    cell: Cell
    shift: Floats
    outside: Column | None
    breaks: tuple[Floats, ...] | None = None


def millimetres(window: Window) -> float:
    """Millimetres per design unit."""
    return window.unit * 1e3


def displaced(window: Window, body: Body) -> bool:
    """Whether the two faces of a body repeat on grids that do not coincide."""
    arrays = body.front.array, body.back.array
    if None in arrays or arrays[0] == arrays[1]:
        return False
    return window.shifts[0] != window.shifts[1]


def layers(window: Window, body: Body, middle: float | None = None) -> tuple[Layer, ...]:
    """Cut a body into layers of columns: one, or two where its faces lie on displaced grids.

    Parameters
    ----------
    window : Window
    body : Body
    middle : float or None, mm
        Height of the plane at which the two layers of a displaced slab end; None leaves them open to one another.

    Raises
    ------
    ValueError
        The body cannot be built; see `make_cell`.
    """
    scale = millimetres(window)
    if not displaced(window, body):
        array = body.front.array if body.front.array is not None else body.back.array
        if array is None:
            raise ValueError(f"body {body.name!r} has no lenslets")
        cell = make_cell(window, body.front, body.back, scale)
        return (Layer(cell, np.array(window.shifts[array]) * scale, _outside(window, cell)),)
    made = []
    for face, front in ((body.front, True), (body.back, False)):
        assert face.array is not None
        if front:
            cell = make_cell(window, face, None, scale, back_level=middle)
        else:
            cell = make_cell(window, None, face, scale, front_level=middle)
        made.append(Layer(cell, np.array(window.shifts[face.array]) * scale, _outside(window, cell)))
    return tuple(made)


def _outside(window: Window, cell: Cell) -> Column | None:
    if window.outline is None:
        return None
    faces, runs = [], []
    for face in cell.faces:
        kind: Kind = "open" if face.open else "plane" if face.plane else "land"
        if kind == "land" and face.level is None:
            raise ValueError("a border round the cells needs land (its height is not known)")
        if kind == "land":
            face = CellFace(face.side, level=face.level)
        faces.append(face)
        runs.append(((0.0, 1.0, kind),))
    return Column((faces[0], faces[1]), (runs[0], runs[1]), np.zeros(2), outside=True)


def describe_body(window: Window, body: Body, writer: Writer, merge: float = MERGE) -> Shells:
    """Describe one body as closed shells.

    Parameters
    ----------
    window : Window
    body : Body
    writer : Writer
    merge : float, mm
        Heights closer than this at a node, or along a whole border, are one.

    Returns
    -------
    Shells
        Face numbers of every piece, counts.

    Raises
    ------
    ValueError
        The body cannot be built as a solid.
    """
    parts = layers(window, body)
    if len(parts) == 2 and window.outline is None:
        raise ValueError("a slab whose arrays are displaced needs an outline")
    parts = tuple(
        replace(part, breaks=breaks) for part, breaks in zip(parts, _breaks(window, body, merge), strict=True)
    )
    return describe_layers(parts, window.lattice, window.outline, millimetres(window), writer, merge)


_known: WeakKeyDictionary[Body, tuple[tuple[object, ...], tuple[tuple[Floats, ...], ...]]] = (
    WeakKeyDictionary()
)


def _breaks(window: Window, body: Body, merge: float) -> tuple[tuple[Floats, ...], ...]:
    """Where anything changes on the borders of each tiling; kept, for it is the same for any number of cells."""
    scale = millimetres(window)
    lattice = window.lattice
    key = (
        lattice.kind,
        lattice.pitch,
        window.shifts,
        window.land,
        window.unit,
        window.outline is None,
        merge,
    )
    if body not in _known or _known[body][0] != key:
        complex_ = cell_complex(window, body, merge / scale, SNAP / scale)
        found = tuple(tuple(border.breaks for border in tiling.borders) for tiling in complex_.tilings)
        _known[body] = (key, found)
    return _known[body][1]


def describe_layers(parts: tuple[Layer, ...], lattice: Lattice, outline: Outline | None, scale: float, writer: Writer,
                    merge: float = MERGE, hollow: bool = False) -> Shells:  # fmt: skip
    """Describe layers of columns within an outline; `hollow` leaves the cells out and keeps the land round them."""
    shells = Shells(writer, merge)
    rim = None if outline is None else shells.owner()
    for part in parts:
        Columns(
            shells,
            part.cell,
            lattice,
            scale,
            part.shift,
            part.outside,
            -1 if rim is None else rim,
            hollow,
            part.breaks,
        ).describe()
    if rim is None:
        for part in parts:
            for f, face in enumerate(part.cell.faces):
                if face.plane:
                    _plane_faces(shells, f, face)
    else:
        assert outline is not None
        outer = [next(part.cell.faces[f] for part in parts if not part.cell.faces[f].open) for f in (0, 1)]
        centre = parts[0].shift if len(parts) == 1 else np.zeros(2)
        _outline_faces(shells, outline, scale, centre, (outer[0], outer[1]), rim)
    return shells


def _flat_surface(shells: Shells, level: float) -> int:
    return shells.writer.surface(Plane(np.array([0.0, 0.0, level]), UP, ACROSS), np.zeros(3))


def _plane_faces(shells: Shells, f: int, face: CellFace) -> None:
    """Close the plane face of a body without outline: its border runs along the outermost cells."""
    assert face.level is not None
    pieces: dict[int, list[tuple[Loop, Floats, int]]] = defaultdict(list)
    for loop, points, owner in _chained(shells, ("plane", f)):
        pieces[shells.root(owner)].append((loop, points, owner))
    surface = _flat_surface(shells, face.level)
    for loops in pieces.values():
        outer = [item for item in loops if _area(item[1]) > 0.0]
        holes = [item for item in loops if _area(item[1]) <= 0.0]
        for loop, points, owner in outer:
            within = [hole for hole, place, _ in holes if _encloses(points, place[0])]
            _flat_face(shells, owner, surface, face.side, [loop, *within], "plane")


def _flat_face(shells: Shells, owner: int, surface: int, side: int, loops: list[Loop], role: str) -> None:
    turned = loops if side < 0 else [reverse(loop) for loop in loops]
    shells.face(owner, surface, side < 0, turned, "land" if role == "land" else "plane")


def _chained(shells: Shells, key: tuple[str, int]) -> list[tuple[Loop, Floats, int]]:
    """Closed loops of the recorded edges of a flat face, region on the left; with their points and an owner."""
    leaving: dict[int, list[tuple[LoopEdge, int, int]]] = defaultdict(list)
    for use, first, last, owner in shells.flat[key]:
        start, end = (first, last) if use.forward else (last, first)
        leaving[start].append((use, end, owner))
    loops = []
    while leaving:
        start = next(iter(leaving))
        here, owner = start, leaving[start][0][2]
        loop: Loop = []
        points: list[Floats] = []
        while True:
            ways = leaving[here]
            # Where two cells touch in a corner only, a loop goes on along the cell it came by.
            use, after, owner = ways.pop(next((n for n, way in enumerate(ways) if way[2] == owner), 0))
            if not ways:
                del leaving[here]
            loop.append(use)
            points.append(shells.places[here][:2])
            here = after
            if here == start:
                break
        loops.append((loop, np.array(points), owner))
    return loops


def _area(points: Floats) -> float:
    x, y = points[:, 0], points[:, 1]
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def _encloses(points: Floats, place: Floats) -> bool:
    x, y = points[:, 0] - place[0], points[:, 1] - place[1]
    x2, y2 = np.roll(x, -1), np.roll(y, -1)
    crosses = (y > 0.0) != (y2 > 0.0)
    right = np.where(y2 - y != 0.0, x - y * (x2 - x) / np.where(y2 - y == 0.0, 1.0, y2 - y), 0.0) > 0.0
    return bool(np.count_nonzero(crosses & right) % 2)


def outline_arcs(outline: Outline, scale: float, centre: Floats) -> list[Arc]:
    """Exact curves of an outline in the plane z = 0, counter-clockwise (mm)."""
    if isinstance(outline, Circle):
        r = 0.5 * outline.diameter * scale
        corners = [(r, -r), (r, r), (-r, r), (-r, -r)]
        starts = [(0.0, -r), (r, 0.0), (0.0, r), (-r, 0.0)]
        weights = np.array([1.0, sqrt(0.5), 1.0])
        return [
            Arc(np.array([[*a, 0.0], [*b, 0.0], [*c, 0.0]]) + np.append(centre, 0.0), weights)
            for a, b, c in zip(starts, corners, starts[1:] + starts[:1])
        ]
    w, h = 0.5 * outline.width * scale, 0.5 * outline.height * scale
    points = np.array([(-w, -h, 0.0), (w, -h, 0.0), (w, h, 0.0), (-w, h, 0.0)]) + np.append(centre, 0.0)
    return [line(a, b) for a, b in zip(points, np.roll(points, -1, axis=0))]


def _outline_faces(shells: Shells, outline: Outline, scale: float, centre: Floats, faces: tuple[CellFace, CellFace],
                   owner: int) -> None:  # fmt: skip
    """The side faces of an outline, and the flat faces that reach out to it."""
    assert faces[0].level is not None
    assert faces[1].level is not None
    levels = (faces[0].level, faces[1].level)
    arcs = outline_arcs(outline, scale, centre)
    rise = np.array([0.0, 0.0, levels[1] - levels[0]])
    bottom: list[int] = []
    top: list[int] = []
    posts: list[int] = []
    rims: tuple[list[int], list[int]] = ([], [])
    for arc in arcs:
        start = arc.poles[0] + np.array([0.0, 0.0, levels[0]])
        bottom.append(shells.point(start))
        top.append(shells.point(start + rise))
        posts.append(shells.edge(bottom[-1], top[-1], line(np.zeros(3), rise), start))
    for n, arc in enumerate(arcs):
        after = (n + 1) % len(arcs)
        for ring, level, ends in ((rims[0], levels[0], bottom), (rims[1], levels[1], top)):
            ring.append(shells.edge(ends[n], ends[after], arc, np.array([0.0, 0.0, level])))
        _side_face(
            shells, owner, arc, (levels[0], levels[1]), (rims[0][n], posts[after], rims[1][n], posts[n])
        )
    for f, face in enumerate(faces):
        key = ("plane" if face.plane else "outside", f)
        loops = [[LoopEdge(edge, True) for edge in rims[f]], *(loop for loop, _, _ in _chained(shells, key))]
        _flat_face(
            shells,
            owner,
            _flat_surface(shells, levels[f]),
            face.side,
            loops,
            "plane" if face.plane else "land",
        )


def _side_face(shells: Shells, owner: int, arc: Arc, levels: tuple[float, float], edges: tuple[int, int, int, int]
               ) -> None:  # fmt: skip
    """One side of the outline: plane, or an exact rational quarter of a cylinder."""
    lift = [np.array([0.0, 0.0, level]) for level in levels]
    curves: tuple[Arc | None, ...] = (None, None, None, None)
    if arc.straight:
        along = arc.poles[1] - arc.poles[0]
        along = along / np.linalg.norm(along)
        right = np.array([along[1], -along[0], 0.0])
        surface = shells.writer.surface(Plane(arc.poles[0] + lift[0], right, along), np.zeros(3))
    else:
        surface = shells.writer.surface(ruled_wall(arc.moved(lift[0]), arc.moved(lift[1])), np.zeros(3))
        sides = [line(np.array([u, 0.0]), np.array([u, 1.0])) for u in (0.0, 1.0)]
        curves = (V_LOW, sides[1], V_HIGH, sides[0])
    loop = [LoopEdge(edge, n < 2, curve) for n, (edge, curve) in enumerate(zip(edges, curves))]
    shells.face(owner, surface, True, [loop], "side")


def single(window: Window) -> Lattice:
    """A lattice of one cell, for the parts of an instanced assembly."""
    return replace(window.lattice, count=(1, 1), outline=None)


def middle_plane(body: Body, window: Window) -> float:
    """Height (mm) of the plane at which a displaced slab is cut into two layers of cells."""
    scale = millimetres(window)
    return 0.5 * scale * sum(_reference(face) for face in (body.front, body.back))


def _reference(face: Face) -> float:
    return face.vertex[2]


__all__ = [
    "Layer",
    "TOLERANCE",
    "describe_body",
    "describe_layers",
    "displaced",
    "layers",
    "middle_plane",
    "millimetres",
    "open_face",
    "outline_arcs",
    "plane_face",
    "single",
]
