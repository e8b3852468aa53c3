"""A layout packed into plain arrays, the only data that compiled kernels can read."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.optics.surface.sag_and_normal import EvenPolynomial, Quadric, Surface
from clacad.sheet.cell_places import VertexChange, as_table
from clacad.sheet.edge_columns import EDGE_NUMBERS
from clacad.sheet.face_order import lined_array, media_of
from clacad.sheet.lattice import Lattice, runs
from clacad.tracing.compiled.records import MOST_ARRAYS

if TYPE_CHECKING:
    from clacad.sheet.cell_places import CellLaws
    from clacad.tracing.layout import BodyPlan, FacePlan, Layout

# Columns of a face's row.
BICONIC, CX, CY, KX, KY, SIDE, VX, VY, VZ, TURNED, R0 = range(11)
ARRAY, LAND, LOW, HIGH, CLIMB, WHOLE, A40, A22, A04 = range(20, 29)
A60, A42, A24, A06, A80, A62, A44, A26, A08, BLIND, LAND_SIDE, FACE_NUMBERS = range(29, 41)

# Values of BICONIC: 0 is a quadric.
POLYNOMIAL = 2.0

# Columns of a body's row.
LEVEL, BODY_LOW, BODY_HIGH, COLUMNAR, COVERED, BOX = range(6)
(
    MID_X,
    MID_Y,
    INNER_X,
    INNER_Y,
    INNER_R,
    OUTLINE,
    OUT_X,
    OUT_Y,
    ENTRY,
    JUMP_FROM,
    JUMP_TO,
    QUICK,
    JOINED,
    CELLS,
) = range(10, 24)
BODY_NUMBERS = 25

# Values of OUTLINE.
NO_OUTLINE, CIRCLE, RECTANGLE, PLATE = range(4)
OUTLINES = {"none": NO_OUTLINE, "circle": CIRCLE, "rectangle": RECTANGLE, "plate": PLATE}

# Columns of the lattice's row.
HEXAGONAL, PITCH, ROW, N1, N2, X0, Y0, MARGIN, TINY, REACH, BORDERS = range(11)
NORMAL, HALF = 11, 17
OPAQUE, BAFFLE, PLAIN, LINED, LINE, LINE_ARRAY, SHIFT = range(20, 27)

BETWEEN = SHIFT + 2 * MOST_ARRAYS
"""Displacement of the second array against the first: residual x and y, then whole lattice steps i and j."""

LATTICE_NUMBERS = BETWEEN + 4 * MOST_ARRAYS * MOST_ARRAYS

NO_BAFFLE = -1.0

# Columns of a face's row in `OwnCells.change`.
CHANGES, XX, XY, YX, YY, TABLE, RISE_X, RISE_Y, SIZES, FRAME = range(10)

# Columns of a cell's row in `OwnCells.frame`; CY and KX of a face, or η_x and η_y of a law, come first.
FIRST, SECOND, LIFT, AXES, FRAME_NUMBERS = 0, 1, 2, 3, 12


class OwnCells(NamedTuple):
    """Position and size of the lens in each cell of a non-uniform sheet; on rung law, the law of each cell.

    change : (faces, 10)
        Whether the lens varies from cell to cell, the gradient of its offset row by row, the index of the
        table of offsets (−1: none), the rise along z per offset, and the indices of the tables of sizes and
        of frames.
    table : (tables, n1, n2, 2) lengths
    size : (tables, n1, n2)
    frame : (tables, n1, n2, FRAME_NUMBERS)
        Numbers of each cell's lens in place of the face's, its rise besides, and its axes (lens → sheet).
        None without any: kernels are then compiled without the code that reads it.
    """

    change: Floats
    table: Floats
    size: Floats
    frame: Floats | None


def own_cells(changes: Sequence[VertexChange | None], frames: Sequence[Floats | None] = ()) -> OwnCells:
    """Pack the change of the lenses of each face, and their frames where they have their own."""
    rows: list[list[float]] = []
    tables: tuple[list[Floats], ...] = ([], [], [])
    for change, frame in zip(changes, frames or [None] * len(changes), strict=True):
        if change is None:
            rows.append([0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, -1.0, -1.0])
            continue
        places = [-1.0, -1.0, -1.0]
        for k, (one, kept) in enumerate(zip((change.table, change.size, frame), tables, strict=True)):
            if one is not None:
                places[k] = float(len(kept))
                kept.append(one)
        rows.append([1.0, *np.ravel(change.gradient).tolist(), places[0], *change.slope, *places[1:]])
    table, size, frame = (np.ascontiguousarray(kept) if kept else None for kept in tables)
    return OwnCells(
        np.array(rows),
        np.zeros((0, 1, 1, 2)) if table is None else table,
        np.zeros((0, 1, 1)) if size is None else size,
        frame,
    )


def own_laws(laws: CellLaws, lattice: Lattice) -> OwnCells:
    """Pack the laws of cells: δ in place of the lens's offset, η in place of its curvatures."""
    cells, frame = lattice.cells(), None
    if laws.own_lenses:
        turn = laws.rotations_of(lattice, cells)
        axes = (laws.law.rotation if turn is None else turn).reshape(-1, 9)
        frame = _framed(lattice, cells, *laws.ratios_of(lattice, cells).T, 0.0, axes)
    return own_cells([VertexChange(laws.gradient, laws.table)], [frame])


def _framed(lattice: Lattice, cells: Ints, *columns: Floats | float) -> Floats:
    """Table (n1, n2, FRAME_NUMBERS) of the frames of cells (n, 2); the first one's for cells left out."""
    *numbers, axes = columns
    rows = np.empty((len(cells), FRAME_NUMBERS))
    for k, each in enumerate(numbers):
        rows[:, k] = each
    rows[:, AXES:] = axes
    return as_table(lattice, cells, rows, rows[0])


def _frame(lattice: Lattice, face: FacePlan) -> Floats | None:
    """Frames of the lenses of a face; None where all are the face's."""
    change, cells = face.change, lattice.cells()
    if change is None or not change.framed:
        return None
    places = change.places(face.vertex, lattice, cells)
    surface, axes = places.shape(face.surface), places.axes(face.rotation)
    shape = surface.kappa if isinstance(surface, Quadric) else surface.conic_x
    rise = change.rise(lattice, cells, np.zeros((len(cells), 2)))
    axes = (np.eye(3) if axes is None else axes).reshape(-1, 9)
    return _framed(lattice, cells, surface.curvature_y, shape, rise, axes)


class Packed(NamedTuple):
    """A sheet as arrays, in double or single precision.

    faces : (f, FACE_NUMBERS), bodies : (b, BODY_NUMBERS), lattice : (LATTICE_NUMBERS,)
        Columns as named in this module; lengths in design units.
    rows : (n2, 2 k) ints. First kept cell of each row of the lattice and one past its last. In a convex
        outline a row is one run; a plate may cut it into k, the longest first. Empty for a plain lattice
        (PLAIN), whose rows are all alike.
    media : (2 b + 1,). Refractive index before the first face and behind each.
    losses : (0,) or (b + 1,)
        Where lost light is counted: whether faces reflect (0 or 1), and the attenuation of each body.
    edges : (e, EDGE_NUMBERS). Of the plate that bounds the bodies, columns as in `clacad.sheet.plate`; empty
        where the outline is no plate.
    lattices : (MOST_ARRAYS, LATTICE_NUMBERS)
        Row of each array; on a non-uniform sheet with its own pitch, origin and half widths.
    own : None on a uniform sheet: kernels are then compiled without the code that reads it. Else `lattice` is
        that of array 1.
    """

    faces: Floats
    bodies: Floats
    lattice: Floats
    rows: Ints
    media: Floats
    losses: Floats
    edges: Floats
    lattices: Floats
    own: OwnCells | None = None


def pack(layout: Layout) -> Packed:
    """Pack the layout of a uniform sheet, with the media of the design's wavelength; kept with the layout.

    Raises CellsDiffer.
    """
    from clacad.sheet.need_window import need_equal_cells

    need_equal_cells(layout.window, "the compiled kernel")
    return pack_array_1(layout)


def pack_array_1(layout: Layout) -> Packed:
    """Pack a layout as `pack`; non-uniform sheets get the lattice of array 1 and the lenses of its middle."""
    from clacad.tracing.layout import prepared

    kept: Packed | None = prepared(layout).get("packed")
    if kept is not None:
        return kept
    faces = [_face(face) for body in layout.bodies for face in (body.front, body.back)]
    lattice = lattice_row(layout)
    prepared(layout)["packed"] = made = Packed(
        faces=np.array(faces),
        bodies=np.array([_body(body, layout.margin) for body in layout.bodies]),
        lattice=lattice,
        rows=_rows(layout),
        media=np.array(media_of(layout.window.bodies)),
        losses=np.zeros(0),
        edges=np.zeros((0, EDGE_NUMBERS)) if (plate := layout.bodies[0].plate) is None else plate.edges,
        lattices=np.tile(lattice, (MOST_ARRAYS, 1)),
    )
    return made


def pack_own(layout: Layout, changes: Sequence[VertexChange | None] | None = None) -> Packed:
    """Pack the layout of a non-uniform sheet, with indices of the design's wavelength.

    changes : change of the lenses of each face; None: those of the layout, kept with it
    """
    from clacad.tracing.layout import prepared

    kept: Packed | None = prepared(layout).get("packed_own")
    if kept is not None and changes is None:
        return kept
    sheet = pack_array_1(layout)
    bodies = sheet.bodies.copy()
    bodies[:, QUICK] = 0.0  # the short cut of the walk assumes one lens for all cells
    plans = [face for body in layout.bodies for face in (body.front, body.back)]
    frames = [_frame(layout.lattice, face) for face in plans] if changes is None else ()
    faces = sheet.faces.copy()
    faces[[n for n, one in enumerate(frames) if one is not None], TURNED] = 1.0
    last = len(layout.lattices) - 1  # rows of missing arrays repeat the last array
    lattices = np.array([_array_row(layout, min(array, last)) for array in range(MOST_ARRAYS)])
    own = own_cells([face.change for face in plans] if changes is None else changes, frames)
    made = sheet._replace(faces=faces, bodies=bodies, lattices=lattices, own=own)
    if changes is None:
        prepared(layout)["packed_own"] = made
    return made


def _array_row(layout: Layout, array: int) -> Floats:
    """Numbers of one array's own cells, as `lattice_row`."""
    lattice, row = layout.lattices[array], lattice_row(layout)
    row[PITCH], row[ROW] = lattice.pitch[0], lattice.row_height
    row[X0], row[Y0] = lattice.first_centre
    row[HALF : HALF + len(layout.halves)] = layout.widths[array]
    row[REACH] = lattice.circumradius
    return row


def in_single(sheet: Packed) -> Packed:
    """The same numbers in single precision."""
    rounded: dict[str, Any] = {
        name: getattr(sheet, name).astype(np.float32)
        for name in ("faces", "bodies", "lattice", "media", "losses", "edges", "lattices")
    }
    return sheet._replace(**rounded)


def surface_row(surface: Surface, rotation: Floats | None) -> list[float]:
    """Row of a face with the numbers of its surface and its rotation alone."""
    row = [0.0] * FACE_NUMBERS
    row[CX], row[CY], row[SIDE] = surface.curvature_x, surface.curvature_y, float(surface.side)
    if isinstance(surface, Quadric):
        row[KX] = surface.kappa
    else:
        row[BICONIC], row[KX], row[KY] = 1.0, surface.conic_x, surface.conic_y
    if isinstance(surface, EvenPolynomial):
        row[BICONIC] = POLYNOMIAL
        row[A40 : A08 + 1] = (*surface.a4, *surface.a6, *surface.a8)
    row[TURNED] = float(rotation is not None)
    row[R0 : R0 + 9] = (np.eye(3) if rotation is None else rotation).ravel().tolist()
    return row


def _face(face: FacePlan) -> list[float]:
    row = surface_row(face.surface, face.rotation)
    row[VX : VZ + 1] = face.vertex
    row[ARRAY] = -1.0 if face.array is None else float(face.array)
    row[LAND], row[LOW], row[HIGH] = face.land, face.low, face.high
    row[CLIMB] = face.slope / sqrt(1.0 + face.slope * face.slope)  # least N of a ray steeper than the face
    row[WHOLE] = float(face.whole)
    row[BLIND], row[LAND_SIDE] = float(face.blind), float(face.land_side)
    return row


def _body(body: BodyPlan, margin: float) -> list[float]:
    row = [0.0] * BODY_NUMBERS
    row[LEVEL], row[BODY_LOW], row[BODY_HIGH] = body.level, body.low, body.high
    row[COLUMNAR], row[COVERED] = float(body.columnar), float(body.covered)
    row[BOX : BOX + 4] = body.box
    row[MID_X], row[MID_Y] = body.centre
    row[INNER_X : INNER_R + 1] = body.inner
    row[OUTLINE] = float(OUTLINES[body.outline[0]])
    row[OUT_X : OUT_Y + 1] = body.outline[1:]
    solid = body.separate and all(face.whole or face.land == face.land for face in (body.front, body.back))
    row[JUMP_FROM], row[JUMP_TO] = (body.front.high, body.back.low) if solid else (1.0, 0.0)
    row[ENTRY] = float(body.arrays[0])  # the array in whose cells rays arrive
    bare = all(face.whole and face.land != face.land for face in (body.front, body.back))
    row[QUICK] = float(
        body.columnar and body.covered and bare and margin == 0.0
    )  # see `solid_body_short_cut`
    row[JOINED] = float(body.joined)
    row[CELLS : CELLS + 2] = (*body.arrays, -1.0)[:2]  # arrays whose cells cut it into columns
    return row


def lattice_row(layout: Layout) -> Floats:
    """Give the lattice's numbers, columns as named in this module."""
    lattice, row = layout.lattice, np.zeros(LATTICE_NUMBERS)
    borders = len(layout.halves)
    row[HEXAGONAL], row[PITCH] = float(lattice.hexagonal), lattice.pitch[0]
    row[ROW] = lattice.a2[1]
    row[N1], row[N2] = lattice.count
    row[X0], row[Y0] = lattice.first_centre
    row[MARGIN], row[TINY], row[REACH] = layout.margin, layout.tiny, lattice.circumradius
    row[BORDERS] = borders
    row[NORMAL : NORMAL + 2 * borders] = layout.normals[0].ravel()
    row[HALF : HALF + borders] = layout.halves
    arrays = len(layout.lattices)
    row[SHIFT : SHIFT + 2 * arrays] = np.ravel(layout.window.shifts)
    for of in range(arrays):
        for array in range(arrays):
            at = BETWEEN + 4 * (MOST_ARRAYS * of + array)
            row[at : at + 4] = *layout.residual[of, array], *layout.whole_steps[of, array]
    land, row[LINE_ARRAY] = layout.window.land, lined_array(layout.window)
    row[OPAQUE], row[LINED], row[LINE] = float(land.opaque), land.lined, 0.5 * land.line
    row[PLAIN] = float(not lattice.hexagonal and lattice.outline is None)
    row[BAFFLE] = NO_BAFFLE if layout.window.baffle is None else layout.window.baffle.wall
    return row


def _rows(layout: Layout) -> Ints:
    """One run of cells for each row of the lattice; empty for a plain lattice, which may have 1e9 rows."""
    lattice = layout.lattice
    if lattice.outline is None:
        j = np.arange(lattice.count[1] if lattice.hexagonal else 0, dtype=np.int64)
        return np.stack([-(j // 2), lattice.count[0] - j // 2], axis=-1)

    found = [runs(lattice.row(k)[:, 0]) for k in range(lattice.count[1])]
    table: Ints = np.zeros((lattice.count[1], 2 * max(1, *map(len, found))), dtype=np.int64)
    for k, several in enumerate(found):
        table[k, : several.size] = several.ravel()
    return table
