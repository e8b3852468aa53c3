"""The bodies of a window as build123d objects with exact OCCT solids. Lengths in mm.

Describe a whole body of a window: its tilings, the surrounding land, the outline. Lengths in mm.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.optics.surface import Quadric
from clacad.sheet.grid_steps import one_tiling
from clacad.sheet.lattice import Circle, Lattice, Outline, Rectangle
from clacad.sheet.need_window import need_window
from clacad.sheet.pattern import Step
from clacad.sheet.plate import Plate
from clacad.sheet.window import Body, Face, Window
from clacad.solid.face_pattern import SNAP, Kind
from clacad.solid.outline_faces import flat_faces, outline_faces
from clacad.solid.outline_path import outline_path, plate_paths
from clacad.solid.rational_conics import LensArray
from clacad.solid.repeated_cell import Cell, CellFace, make_cell
from clacad.solid.shells import MERGE, Shells, Writer
from clacad.solid.tilings import Columns, Layer, Surround
from clacad.solid.wall_segments import Column
from clacad.topology.build_complex import cell_complex
from clacad.topology.complex_parts import CannotBuild

KEPT_CELLS = 4096
"""Number of cells of a non-uniform sheet kept at a time: a row borders on the one above it, so three rows do.
"""


def layers(window: Window, body: Body, middle: float | None = None) -> tuple[Layer, ...]:
    """Cut a body into layers of columns: one, or two where its faces lie on displaced grids.

    middle : float or None, mm. Height of the plane at which the two layers of a displaced slab end; None
        leaves them open to one another.
    Raises ValueError: The body cannot be built; see `make_cell`.
    """
    body = body if window.uniform else body.simplified
    arrays = one_tiling(window, body)
    if len(arrays) == 1:
        return (_layer(window, arrays[0], (body.front, body.back), (None, None)),)
    made = []
    for face, front in ((body.front, True), (body.back, False)):
        assert face.array is not None
        faces = (face, None) if front else (None, face)
        made.append(_layer(window, face.array, faces, (None, middle) if front else (middle, None)))
    return tuple(made)


def _layer(
    window: Window,
    array: int,
    faces: tuple[Face | None, Face | None],
    levels: tuple[float | None, float | None],
) -> Layer:
    """The layer of an array's cells between two faces; cell by cell in a non-uniform sheet."""
    scale = millimetres(window.unit)

    def cell_at(index: Step) -> Cell:
        place = np.array(index)
        front, back = (None if face is None else window.in_cell(face, place) for face in faces)
        return make_cell(window, front, back, scale, *levels, array=array)

    alike = all(face is None or face.change is None for face in faces)
    first = (0, 0) if alike else tuple(window.lattice.cells()[0].tolist())
    cell = cell_at((first[0], first[1]))
    own = None if alike else lru_cache(maxsize=KEPT_CELLS)(cell_at)
    pattern = window.lattice_of(array) if window.placements[array].own else None
    shift, outside = np.array(window.shifts[array]) * scale, _outside(window, cell)
    lenses = () if window.uniform or cell.island else _lens_arrays(window, faces, scale)
    return Layer(cell, shift, outside, own=own, pattern=pattern, lenses=lenses)


def _lens_arrays(
    window: Window, faces: tuple[Face | None, Face | None], scale: float
) -> tuple[LensArray, ...]:
    """Lens faces of all cells of a non-uniform sheet in arrays; none where one is no quadric."""
    cells, found = window.lattice.cells(), []
    for number, face in enumerate(faces):
        if face is None or face.array is None:
            continue
        if not isinstance(face.surface, Quadric):
            return ()
        places, surface = window.lenses(face, cells), face.surface
        shape = places.shape(surface, (len(cells),))
        assert isinstance(shape, Quadric)
        own = np.broadcast_arrays(shape.curvature_x, shape.curvature_y, np.atleast_1d(shape.kappa))
        curvatures = np.stack(own, axis=1) / scale
        size = 1.0 if places.size is None else places.size[:, None]
        apex = np.stack(np.broadcast_arrays(*np.atleast_1d(*places.apex)), axis=1) * scale
        curvatures = np.broadcast_to(curvatures / size, apex.shape)
        land = None if face.land is None else face.land * scale
        turn = places.axes(face.rotation)
        assert turn is not None
        found.append(LensArray(number, face.side, land, turn, curvatures, apex))
    return tuple(found)


def _outside(window: Window, cell: Cell) -> Column | None:
    """The land between the cells and the outline as a column; None without an outline."""
    if window.outline is None:
        return None
    faces, runs = [], []
    for face in cell.faces:
        kind: Kind = "open" if face.open else "plane" if face.plane else "land"
        if kind == "land" and face.level is None:
            raise CannotBuild(
                "CL134",
                "a border round the cells needs land, whose height is not known here: give pair.web"
                " (biconvex)",
            )
        if kind == "land":
            face = CellFace(face.side, level=face.level)
        faces.append(face)
        runs.append(((0.0, 1.0, kind),))
    return Column((faces[0], faces[1]), (runs[0], runs[1]), np.zeros(2), outside=True)


def describe_body(window: Window, body: Body, writer: Writer, merge: float = MERGE) -> Shells:
    """Describe one body as closed shells.

    merge : mm. Heights that differ by less at a node, or along a whole border, are merged.
    Returns: Face numbers of every piece, counts.
    Raises ValueError: The body cannot be built as a solid.
    """
    parts = layers(window, body)
    if len(parts) == 2 and window.outline is None:
        raise CannotBuild(
            "CL134",
            "a slab whose arrays are displaced needs a border round both: give body.border a width, or"
            " lattice.outline",
        )
    if window.uniform:
        breaks = _breaks(window, body, merge)
        parts = tuple(replace(part, breaks=one) for part, one in zip(parts, breaks, strict=True))
    return describe_layers(parts, window.lattice, window.outline, millimetres(window.unit), writer, merge)


_known: WeakKeyDictionary[Body, tuple[tuple[object, ...], tuple[tuple[Floats, ...], ...]]] = (
    WeakKeyDictionary()
)


def _breaks(window: Window, body: Body, merge: float) -> tuple[tuple[Floats, ...], ...]:
    """Border parameters at which anything changes, for each tiling.

    They are independent of the cell count and cached.
    """
    scale = millimetres(window.unit)
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


def describe_layers(
    parts: tuple[Layer, ...],
    lattice: Lattice,
    outline: Outline | None,
    scale: float,
    writer: Writer,
    merge: float = MERGE,
    hollow: bool = False,
) -> Shells:
    """Describe layers of columns within an outline.

    `hollow` leaves the cells out and keeps the land around them.
    """
    shells = Shells(writer, merge, split=hollow)
    rim = -1 if outline is None else shells.owner()
    centre = parts[0].shift if len(parts) == 1 and not isinstance(outline, Plate) else np.zeros(2)
    path = None if outline is None else outline_path(outline, scale, centre, lattice.copies)
    tilings = []
    for part in parts:
        if path is not None and isinstance(outline, Circle | Rectangle):  # a plate keeps no cell that it cuts
            _refuse_beyond(part, lattice, outline, scale, centre)
        tiling = Columns(shells, part, lattice, scale, Surround(path, rim, hollow))
        tiling.describe()
        tilings.append(tiling)
    if path is not None:
        holes = plate_paths(outline, scale)[1:] if isinstance(outline, Plate) else ()
        outline_faces(shells, (path, *holes), tuple(tilings), rim, hollow)
        return shells
    for tiling in tilings:
        for f, face in enumerate(tiling.cell.faces):
            if face.plane:
                flat_faces(shells, f, face, "plane")
    return shells


def _refuse_beyond(
    part: Layer, lattice: Lattice, outline: Circle | Rectangle, scale: float, centre: Floats
) -> None:
    """Refuse a cell that lies partly beyond the outline: the outline would cut through a lenslet.

    Raises CannotBuild: CL136.
    """
    cells = part.places(lattice).centres(lattice.cells()) * scale + part.shift - centre
    x, y = np.moveaxis(cells[:, None] + part.cell.tile, -1, 0)
    if isinstance(outline, Circle):
        beyond = np.hypot(x, y) - 0.5 * outline.diameter * scale
    else:
        beyond = np.maximum(np.abs(x) - 0.5 * outline.width * scale, np.abs(y) - 0.5 * outline.height * scale)
    if len(cells) and float(beyond.max()) > SNAP:
        raise CannotBuild(
            "CL136",
            f"a cell reaches {float(beyond.max()) / scale:.3g} beyond the outline {outline}; a larger outline"
            " or fewer cells would hold it",
        )


def single(window: Window) -> Lattice:
    """A lattice of one cell, for the parts of an instanced assembly."""
    return replace(window.lattice, count=(1, 1), outline=None)


def middle_plane(body: Body, window: Window) -> float:
    """Height (mm) of the plane at which a displaced slab is cut into two layers of cells."""
    scale = millimetres(window.unit)
    return 0.5 * scale * sum(face.vertex[2] for face in (body.front, body.back))


COLOURS = {"array1": (0.62, 0.78, 0.90), "array2": (0.90, 0.80, 0.62)}


def solids(window: Window, cells: tuple[int, int] | None = None, merge: float = MERGE) -> list[Any]:
    """Return the bodies of a window as exact CAD solids of build123d, one per body.

    Parameters
    ----------
    window : Window
    cells : (n1, n2) or None
        Use another cell count, centred on the origin, with the same design.
    merge : float, mm
        Heights that differ by less at a node, or along a whole border, are merged.

    Returns
    -------
    list of build123d.Solid
        In mm, in the sheet frame, labelled with the body's name; a body of several pieces is a
        build123d.Compound of solids. They cut, fuse, fillet and export like any part.

    Raises
    ------
    TypeError
        A design in place of the window.
    ValueError
        A body cannot be built as a solid.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> window = clacad.prescribe(design)
    >>> [body] = clacad.solids(window)
    >>> body.is_valid
    True
    >>> round(body.volume, 3)
    33.569
    """
    from clacad.solid.occ_writer import OccWriter, without_garbage_collection

    need_window(window, "solids")
    if cells is not None:
        window = window.with_cells(cells)
    made = []
    for body in window.bodies:
        with without_garbage_collection():
            writer = OccWriter()
            shells = describe_body(window, body, writer, merge)
            pieces = [writer.solid(faces) for faces in shells.pieces()]
        made.append(_part(pieces, body.name))
    return made


def _part(pieces: list[Any], name: str) -> Any:
    """One build123d object of the solids of a body, labelled and coloured."""
    from build123d import Color, Compound, Solid
    from OCP.BRep import BRep_Builder
    from OCP.TopoDS import TopoDS_Compound

    if len(pieces) == 1:
        part: Any = Solid(pieces[0])
    else:
        builder, compound = BRep_Builder(), TopoDS_Compound()
        builder.MakeCompound(compound)
        for piece in pieces:
            builder.Add(compound, piece)
        part = Compound(compound)
    part.label = name
    part.color = Color(*COLOURS.get(name, COLOURS["array1"]))
    return part
