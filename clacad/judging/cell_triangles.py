"""Pick the triangles of a few cells out of a file of any size, in one pass and bounded memory.

Holes of a plate in a file: each lies where the design has it, as wide and through every body.

A volume, an extent and the light of cells do not notice a hole that lies elsewhere in the land.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import pi
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.base.vectors import doubled_normals, lengths, middles
from clacad.checks.check import Check
from clacad.formats.mesh.compare_instances import body_facing as body_facing
from clacad.formats.mesh.compare_instances import levels as levels
from clacad.formats.mesh.compare_instances import owner as owner
from clacad.mesh.border_samples import in_corners
from clacad.sheet.like_cell import like_cell
from clacad.sheet.plate import Hole, Plate
from clacad.sheet.volume_and_extent import distance_in_cell, height_above
from clacad.sheet.window import WALL, Body, Face, Window, lens_height
from clacad.solid.marks import pockets
from clacad.tracing.facets.telescopelet import AnyFace, ExactFace, FacetBody, FacetFace, facet_face, on_land

ROOM: Final = 1e-3
"""Distance by which the wall of a hole may lie off its circle, as part of the diameter."""

LEAST: Final = 0.9
"""Least part of a hole's wall that lies on its circle in a sound mesh."""


def holes_of(window: Window) -> tuple[Hole, ...]:
    """Holes through the plate of a window."""
    return window.outline.holes if isinstance(window.outline, Plate) else ()


def wall_areas(window: Window, walls: Floats) -> Floats:
    """Area (bodies, holes), length², of upright facets (k, 3, 3) that lie on the circle of each hole."""
    holes = holes_of(window)
    found = np.zeros((len(window.bodies), len(holes)))
    for n, hole in enumerate(holes):
        near = (np.abs(walls[:, 0, :2] - (hole.x, hole.y)) <= 0.6 * hole.diameter).all(axis=1)
        some = walls[near]
        off = np.hypot(some[..., 0] - hole.x, some[..., 1] - hole.y) - 0.5 * hole.diameter
        some = some[(np.abs(off) <= ROOM * hole.diameter).all(axis=1)]
        area, height = 0.5 * np.linalg.norm(doubled_normals(some), axis=1), some[..., 2].mean(axis=1)
        for number, body in enumerate(window.bodies):
            low, high = _land(body)
            found[number, n] = area[(height > low) & (height < high)].sum()
    return found


def _land(body: Body) -> tuple[float, float]:
    """Heights (lengths) of the land on both sides of a body."""
    front, back = (face.vertex[2] if face.land is None else face.land for face in (body.front, body.back))
    return front, back


def lost_in_mesh(window: Window, areas: Floats, present: Sequence[str] | None) -> list[Hole]:
    """Holes whose wall is not found in every body that a file holds; `areas` from `wall_areas`."""
    held = [present is None or body.name in present for body in window.bodies]
    thick = np.array([high - low for low, high in map(_land, window.bodies)])
    return [
        hole
        for hole, area in zip(holes_of(window), areas.T, strict=True)
        if (area < LEAST * pi * hole.diameter * thick)[held].any()
    ]


def lost_in_solid(
    window: Window, found: Iterable[Mapping[str, Any]], mm: float, alone: bool = True
) -> list[Hole]:
    """Holes that none of the upright cylinders `found` in a file is, or that another of them overlaps.

    found : of `clacad.formats.step.lens_placements.holes_in`
    mm : millimetres in a design unit
    alone : whether `found` holds holes only, so that none may have its axis in another
    """
    across = np.array(
        [[*one["at"][:2], one["diameter"]] for one in found if abs(one["axis"][2]) > 1.0 - ROOM]
    )
    across = across.reshape(-1, 3) / mm
    lost = []
    for hole in holes_of(window):
        off = np.hypot(across[:, 0] - hole.x, across[:, 1] - hole.y)
        room = ROOM * hole.diameter
        same = (off <= room) & (np.abs(across[:, 2] - hole.diameter) <= room)
        if not same.any() or (alone and (~same & (off < 0.5 * hole.diameter)).any()):
            lost.append(hole)
    return lost


def with_holes(check: Check, lost: Sequence[Hole], unit: str) -> Check:
    """Return the check of a shape, failed where holes are lost."""
    if not lost or check.state not in ("pass", "fail", "warn"):
        return check
    one = lost[0]
    words = (
        f"{check.sentence}; {len(lost)} of the holes through the plate are not where the design has them,"
        f" such as that of diameter {one.diameter:.6g} {unit} at ({one.x:.6g}, {one.y:.6g})"
    )
    return replace(check, state="fail", sentence=words)


if TYPE_CHECKING:
    pass

CHORD = 0.75
"""Mean height of a chord over a second-order surface across a facet, over that at the facet's middle."""

SLIVER = 1e-4
"""Twice a facet's area over its longest edge squared, below which its own normal is unreliable."""

UNIT_ROOM = 1e-3
"""Largest deviation from 1 of the length of a stored normal."""

Cell = tuple[int, int]
Key = tuple[int, int, int]
"""Body, side (0 front, 1 back), number of the chosen cell."""


@dataclass
class CellFacets:
    """Facets of the chosen cells, by body, side and cell, with counts over the whole file.

    cells : tuple of (i, j)
    facets : Key → list of (k, 3, 3) arrays, sheet frame, design units.
    optical, walls, degenerate : Facets of each kind in the whole file; degenerate ones have no area.
    farthest : float
        Largest distance of a facet's middle from the exact face under it, over the whole file, design units.
    farthest_cell : (i, j) or None. Cell of that facet.
    engraved : Volume of engraved letters where the design has room for them (length³): area of their floors
        times depth.
    normals : Key → list of (k, 3, 3) arrays: normals stored for the corners of `facets`; no key where the
        file has none.
    stored, odd, inward : Facets with stored normals; those with a normal that is no unit vector; those with
        one that points inward.
    repeats : Key → list of (number of a chosen cell, (3,) shift). The facets of this cell are its own and
        those of the other cell, shifted; so an instanced file needs the facets of one cell.
    chord : Volume (length³) that all facets of the file add to the exact body of a non-uniform sheet; see
        `chord_volume`.
    bored : (bodies, holes) or None. Area (length²) of the walls of a plate's holes; None without holes.
    """

    cells: tuple[Cell, ...]
    facets: dict[Key, list[Floats]] = field(default_factory=dict)
    optical: int = 0
    walls: int = 0
    degenerate: int = 0
    farthest: float = 0.0
    farthest_cell: Cell | None = None
    engraved: float = 0.0
    normals: dict[Key, list[Floats]] = field(default_factory=dict)
    stored: int = 0
    odd: int = 0
    inward: int = 0
    repeats: dict[Key, list[tuple[int, Floats]]] = field(default_factory=dict)
    chord: float = 0.0
    bored: Floats | None = None
    binned: dict[tuple[Key, bool], FacetFace] = field(default_factory=dict, repr=False)

    def corners(self, body: int, side: int, cell: int) -> Floats:
        """Facets (k, 3, 3) of one side of one body over one of the chosen cells."""
        found = list(self.facets.get((body, side, cell), []))
        for source, shift in self.repeats.get((body, side, cell), []):
            found += [corners + shift for corners in self.facets.get((body, side, source), [])]
        return np.concatenate(found) if found else np.empty((0, 3, 3))

    def corner_normals(self, body: int, side: int, cell: int) -> Floats | None:
        """Normals (k, 3, 3) stored for the corners of `corners`, in order; None if the file has none."""
        cells = [cell, *(source for source, _ in self.repeats.get((body, side, cell), []))]
        found = [normals for c in cells for normals in self.normals.get((body, side, c), [])]
        return np.concatenate(found) if found else None

    def source(self, cell: int) -> int:
        """The chosen cell of which `cell` is a copy displaced by whole pitches; itself if it is no copy."""
        keys = [key for key in (*self.facets, *self.repeats) if key[2] == cell]
        sources = {source for key in keys for source, _ in self.repeats.get(key, [])}
        alone = all(key not in self.facets and len(self.repeats[key]) == 1 for key in keys)
        return sources.pop() if alone and len(sources) == 1 else cell

    def alike(self, window: Window, cell: int) -> tuple[Window, Ints]:
        """Uniform equivalent of a chosen cell of a window, and its index (2,)."""
        index = np.array(self.cells[cell], dtype=np.int64)
        return like_cell(window, index, widest=False), index


@dataclass(frozen=True, eq=False)
class SideFacets:
    """Facets of one side of a body in a chunk of a file.

    corners : (k, 3, 3), normals : (k, 3, 3) or None. Of the whole chunk.
    rows : (n,). Rows of the chunk that belong to this side.
    cells : (n, 2). Cells they lie over, in the grid of the side's array.
    """

    corners: Floats
    normals: Floats | None
    rows: Ints
    cells: Ints


class Gatherer:
    """Collects the facets of the chosen cells from the chunks of a file.

    A facet belongs to the body whose height range contains its centroid. It belongs to the front if its
    outward normal points to −z and to the back if to +z. Its cell is the one its centroid lies over, in the
    grid of that face's own array. Facets on bevels at saddles that a file states belong to no face; nor do
    the floors of letters engraved in the border, at the depth and in the room that the design has for them.
    """

    def __init__(self, window: Window, cells: Iterable[Cell], bevel: float = 0.0) -> None:
        from clacad.formats.mesh.compare_triangles import rounding

        self.window, self._bevel = window, bevel
        self.result = CellFacets(tuple(cells))
        self._levels = levels(window)
        self._pockets, self._room = pockets(window), rounding(window, single=True)
        index = np.array(self.result.cells, dtype=np.int64)
        self._first = index.min(axis=0)
        self._table = np.full(tuple(np.ptp(index, axis=0) + 1), -1, dtype=np.int64)
        for number, (i, j) in enumerate(self.result.cells):
            self._table[i - self._first[0], j - self._first[1]] = number

    def look(self, corners: Floats, normals: Floats | None = None, times: int = 1) -> None:
        """Add a chunk (k, 3, 3) in design units, with the normals stored for its corners.

        times : number of places of these facets; each is counted that often and stored once.
        """
        normal = doubled_normals(corners)
        length = lengths(normal)
        optical = np.abs(normal[:, 2]) > WALL * length
        self.result.degenerate += times * int((length == 0.0).sum())
        self.result.optical += times * int(optical.sum())
        self.result.walls += times * int((~optical).sum())
        if holes_of(self.window):
            bored = times * wall_areas(self.window, corners[~optical])
            self.result.bored = bored if self.result.bored is None else self.result.bored + bored
        if normals is not None:
            self._weigh(corners, normal, normals, times)
        upright = np.abs(normal[:, 2]) / np.where(length > 0.0, length, 1.0)
        middle = middles(corners)
        if self._bevel > 0.0:  # bevels at saddles are not optical faces
            optical &= ~in_corners(self.window, middle, self._bevel)
        for pocket in self._pockets:
            floor = optical & (normal[:, 2] < 0.0) & pocket.on_floor(corners, self._room)
            self.result.engraved -= 0.5 * float(normal[floor, 2].sum()) * (pocket.floor - pocket.land)
            optical &= ~floor
        body = body_facing(self._levels, middle[:, 2], normal[:, 2])
        back = normal[:, 2] > 0.0
        for number, piece in enumerate(self.window.bodies):
            for side, face in enumerate((piece.front, piece.back)):
                rows = np.flatnonzero(optical & (body == number) & (back == bool(side)))
                if len(rows):
                    array = owner(piece, face)
                    cells = self._cells(array, middle[rows])
                    self._keep(number, side, array, SideFacets(corners, normals, rows, cells))
                    self._hold(face, middle[rows], cells, upright[rows])
                    if not self.window.uniform and face.array is not None:
                        above = height_above(self.window, face, middle[rows], cells)
                        area = 0.5 * normal[rows, 2]
                        self.result.chord += times * CHORD * float(np.nansum(above * area))

    def _weigh(self, corners: Floats, normal: Floats, normals: Floats, times: int) -> None:
        """Count facets whose stored normals are not unit vectors, or point inward."""
        longest = np.abs(np.roll(corners, 1, axis=1) - corners).max(axis=(1, 2))
        broad = np.linalg.norm(normal, axis=1) > SLIVER * longest**2  # the normal of a sliver is rounding
        with np.errstate(invalid="ignore", over="ignore"):
            unit = np.abs(np.linalg.norm(normals, axis=2) - 1.0) <= UNIT_ROOM
            inward = broad & (np.einsum("kcx,kx->k", normals, normal) < 0.0)
        self.result.stored += times * len(normals)
        self.result.odd += times * int((~unit).any(axis=1).sum())
        self.result.inward += times * int(inward.sum())

    def hold(self, corners: Floats) -> None:
        """Compare facets (k, 3, 3) at one more place with the design, without counting or storing them."""
        aside = Gatherer(self.window, self.result.cells[:1], self._bevel)
        aside.look(corners)
        if aside.result.farthest > self.result.farthest:
            self.result.farthest, self.result.farthest_cell = (
                aside.result.farthest,
                aside.result.farthest_cell,
            )

    def _hold(self, face: Face, middle: Floats, cells: Ints, upright: Floats) -> None:
        """Compare every facet with its face: a lenslet outside the chosen cells may be wrong too."""
        off = distance_in_cell(self.window, face, middle[:, None], cells)[:, 0] * upright
        worst = int(np.argmax(off))
        if off[worst] > self.result.farthest:
            self.result.farthest = float(off[worst])
            self.result.farthest_cell = (int(cells[worst, 0]), int(cells[worst, 1]))

    def _keep(self, body: int, side: int, array: int, some: SideFacets) -> None:
        """Store the facets that lie over chosen cells of an array."""
        number = self._chosen(some.cells)
        for cell in np.unique(number[number >= 0]):
            key, mine = (body, side, int(cell)), some.rows[number == cell]
            self.result.facets.setdefault(key, []).append(some.corners[mine])
            if some.normals is not None:
                self.result.normals.setdefault(key, []).append(some.normals[mine])

    def _cells(self, array: int, middle: Floats) -> Ints:
        """Cells (k, 2) of an array under points (k, 3)."""
        return self.window.locate(array, middle[:, 0], middle[:, 1])[0]

    def _chosen(self, cells: Ints) -> NDArray[np.int64]:
        """Number (k,) of the chosen cell for each cell (k, 2); −1 for other cells."""
        place = cells - self._first
        known = ((place >= 0) & (place < self._table.shape)).all(axis=1)
        number = np.full(len(place), -1, dtype=np.int64)
        number[known] = self._table[place[known, 0], place[known, 1]]
        return number


def own_facets(window: Window, quads: int) -> CellFacets:
    """Facets of a window of one cell as its own mesh has them."""
    from clacad.mesh import tessellate

    gatherer = Gatherer(window, [(0, 0)])
    for body in tessellate(window, quads=quads).bodies:
        for rows in body.rows():
            gatherer.look(np.asarray(rows, dtype=np.float64))
    return gatherer.result


def telescopelet(
    window: Window,
    found: CellFacets,
    cell: int,
    present: Sequence[str] | None = None,
    onto_design: bool = False,
) -> tuple[FacetBody, ...]:
    """Facets over one chosen telescopelet: cell i, j of each array, ready to be traced.

    present : names of the bodies the file holds, or None for all. Missing bodies are taken from the design.
    onto_design : bool
        Move every corner along z onto the design's own face; the result is the design with the file's facets.
    """
    window, index = found.alike(window, cell)
    bodies = []
    for number, body in enumerate(window.bodies):
        faces: list[AnyFace] = []
        for side, face in enumerate((body.front, body.back)):
            place = window.centres(owner(body, face), index)
            if present is None or body.name in present:
                faces.append(_faceted(window, found, (number, side, cell), place, onto_design))
            else:
                faces.append(ExactFace(face, np.array([*place, 0.0]), window))
        bodies.append(FacetBody(faces[0], faces[1], body))
    return tuple(bodies)


def _faceted(window: Window, found: CellFacets, key: Key, place: Floats, onto_design: bool) -> FacetFace:
    """Facets of one side of a body over the chosen cell at `place` (2,), with those shifted of its copies."""
    number, side, cell = key
    source = found.source(cell)
    if source != cell:
        steps = np.array([found.cells[source], found.cells[cell]], dtype=np.int64)
        whole = np.diff(window.lattice.centres(steps), axis=0)[0]
        one = _faceted(window, found, (number, side, source), place - whole, onto_design)
        shift = found.repeats[key][0][1] if key in found.repeats else np.array([*whole, 0.0])
        return replace(one, origin=one.origin + shift)
    if (key, onto_design) in found.binned:
        return found.binned[key, onto_design]
    body = window.bodies[number]
    face = (body.front, body.back)[side]
    corners = found.corners(number, side, cell)
    flat = on_land(window, face, corners)
    corners = onto_face(window, face, corners, place) if onto_design else corners
    made = facet_face(corners, np.array([*place, body.front.vertex[2]]), flat)
    if found.repeats:
        found.binned[key, onto_design] = made
    return made


def exact_height(face: Face, flat: NDArray[np.bool_], points: Floats) -> Floats:
    """Height (k, m) of the design under facet points (k, m, ≥ 2), cell frame.

    Land facets get the height of the land, others that of the lens, extended beyond its border; NaN where it
    has none.
    """
    if face.array is None:
        return np.full(points.shape[:2], face.vertex[2])
    z = lens_height(face, points[..., 0].ravel(), points[..., 1].ravel()).reshape(points.shape[:2])
    return z if face.land is None else np.where(flat[:, None], face.land, z)


def onto_face(window: Window, face: Face, corners: Floats, place: Floats) -> Floats:
    """Facets (k, 3, 3) with the heights of the design's face over the cell at `place`, where it has any."""
    moved = corners.copy()
    z = exact_height(face, on_land(window, face, corners), corners - [*place, 0.0])
    moved[..., 2] = np.where(np.isfinite(z), z, corners[..., 2])
    return moved
