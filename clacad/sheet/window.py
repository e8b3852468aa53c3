"""The sheet as built: faces, bodies, window. This module contains geometry only, no optical intent.

Export and trace read the same `Window`, so that a report describes the written part.

Frames
------
*Sheet frame*: right-handed, sheet plane z = 0, light reaches body 0 first and travels towards +z.
*Cell frame* of array k: axes of the sheet, x and y from the centre of the cell, z of the sheet.
*Lens frame* of a face: origin at the face's apex, axes rotated by `Face.rotation` (lens → sheet).

`Window.placements[k]` gives the positions of the cells of array k. On a uniform sheet (`Window.uniform`) all
cells of an array are identical and one cell describes all of them. On a non-uniform sheet `Window.vertices`
gives the position of each cell's lens.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clacad.base.types import Floats, Ints
from clacad.base.vectors import to_surface
from clacad.optics.surface.intersection import meet
from clacad.optics.surface.roots import upright_sag
from clacad.optics.surface.sag_and_normal import (
    Biconic,
    EvenPolynomial,
    Quadric,
    other_side,
    resized,
    simplest,
    stretched,
)
from clacad.sheet.cell_places import (
    CellLaws,
    CellPlacement,
    LensForm,
    LensPlaces,
    PlacedArrays,
    VertexChange,
    lens_plane_slope,
    linear_change,
)
from clacad.sheet.lattice import Lattice, Outline, Rectangle, grown
from clacad.sheet.pattern import turned

if TYPE_CHECKING:
    from clacad.optics.law import Law
    from clacad.optics.material.material import Material

Surface = Quadric | Biconic | EvenPolynomial
Form = Literal["biconvex", "plano", "slab", "plates"]
IDENTITY = np.eye(3)
PLANE = Quadric(0.0, 0.0, 0.0)

WALL = 0.05
"""A face or facet whose unit normal has |n_z| below this is a wall."""


TURNED_ROOM = 0.05
"""Clearance at the corners of a turned array, as part of a pitch."""


@dataclass(frozen=True, eq=False)
class Face:
    """One optical side of a body: a plane, or one lenslet repeated on the cells of an array.

    Parameters
    ----------
    surface : Quadric, Biconic or EvenPolynomial
        In the lens frame, apex at the origin. A plane face is Quadric(0, 0, 0).
    vertex : (3,) lengths
        The apex in the cell frame: x, y from the centre of the array's own cell, z in the sheet frame.
    rotation : (3, 3)
        Lens → sheet.
    array : int or None
        Index of the lens array on whose cells the face repeats; None is an unstructured plane.
    land : float or None
        Sheet-frame z of the flat land of this face (web, seam, border). None: there is no land, and
        the face has a hole where the lenslet does not reach.
    change : VertexChange or None
        Displacement of each cell's lens from `vertex`, and its scale factor; None: all lenses are alike.
    sunk : bool
        Whether the land protrudes from the lens, not the lens from it: the second face of a joint.
    form : LensForm or None
        What the lenses have besides the surface, in files of heights that command a machine.
    """

    surface: Surface
    vertex: tuple[float, float, float]
    rotation: Floats = field(default_factory=lambda: IDENTITY)
    array: int | None = None
    land: float | None = None
    change: VertexChange | None = None
    sunk: bool = False
    form: LensForm | None = None

    @property
    def untilted(self) -> bool:
        """Whether lens and sheet axes coincide exactly, so that no rotation is applied."""
        return bool(np.array_equal(self.rotation, IDENTITY))

    @property
    def upright(self) -> bool:
        """Whether the lens axis is exactly the sheet's normal; the lens may be turned about it."""
        turn = self.rotation
        level = not (turn[..., 2, :2].any() or turn[..., :2, 2].any())
        return level and bool((turn[..., 2, 2] == 1.0).all())

    @property
    def own_axes(self) -> bool:
        """Whether each cell's lens has axes of its own."""
        return self.change is not None and self.change.rotation is not None

    @property
    def simplified(self) -> Face:
        """The same points with a surface whose rays need no iteration, where there is one (`simplest`)."""
        if self.change is not None and self.change.aspect is not None:
            return self  # a quadric is stretched otherwise than the biconic
        surface = simplest(self.surface)
        return self if surface is self.surface else replace(self, surface=surface)

    @property
    def blind(self) -> int:
        """Index, 1 (i) or 2 (j), along which the cells of a field lens form one uncut cylinder; else 0."""
        curvatures = (self.surface.curvature_x, self.surface.curvature_y)
        if (
            self.array != 2
            or not isinstance(self.surface, Quadric)
            or (curvatures[0] == 0.0) == (curvatures[1] == 0.0)
        ):
            return 0
        flat = 0 if curvatures[0] == 0.0 else 1
        return 1 + int(abs(self.rotation[1, flat]) > abs(self.rotation[0, flat]))

    @property
    def seen_from_behind(self) -> Face:
        """The same points as a face of the body on the other side: a joint's second face."""
        return replace(self, surface=other_side(self.surface), sunk=not self.sunk)

    @property
    def side(self) -> int:
        """+1 for a face whose material lies on its +z side (front), −1 for a back face.

        A face keeps the side it was built with; the curvature carries the sign (concave < 0).
        """
        return int(self.surface.side)

    @property
    def land_side(self) -> int:
        """+1 where the land lies on the +z side of the lens, −1 on its −z side."""
        return -self.side if self.sunk else self.side


def arrays_between(front: int | None, back: int | None) -> tuple[int, ...]:
    """Arrays of a body's two faces, each once; array 0 where both are planes."""
    return tuple(dict.fromkeys(array for array in (front, back) if array is not None)) or (0,)


@dataclass(frozen=True, eq=False)
class Body:
    """Material between two faces, cut into cells by walls along z.

    Parameters
    ----------
    front : Face
        The face light reaches first; the material is behind it.
    back : Face
    index : float
        Refractive index at the design wavelength (air is 1).
    name : str
        "array1", "array2", "field" or "sheet"; used for files, labels and solids.
    material : Material or None
        Gives the index at other wavelengths; None is a constant index.
    joined : bool
        Whether `front` is a joint: the surface of the back face of the body before, without air between.
    """

    front: Face
    back: Face
    index: float
    name: str
    material: Material | None = None
    joined: bool = False

    @property
    def simplified(self) -> Body:
        """The same body with faces whose rays need no iteration, where there are any (`simplest`)."""
        return replace(self, front=self.front.simplified, back=self.back.simplified)

    @property
    def arrays(self) -> tuple[int, ...]:
        """Arrays on whose cells the faces repeat, each once, in the order of the light.

        Array 0 for a layer of two planes, which is cut along its cells.
        """
        return arrays_between(self.front.array, self.back.array)

    @property
    def columnar(self) -> bool:
        """Whether both faces repeat on one array, so that the body is a bundle of columns."""
        return self.front.array is not None and self.front.array == self.back.array

    @property
    def layer(self) -> bool:
        """Whether both faces are planes: the body lies between two flat joints."""
        return self.front.array is None and self.back.array is None

    def index_at(self, wavelength: float | None) -> float:
        """Refractive index at a wavelength in metres (None: the design wavelength).

        Raises
        ------
        ValueError
            The wavelength lies outside the material's data.
        """
        if wavelength is None or self.material is None:
            return self.index
        return float(self.material.index(wavelength))

    def heated(self, kelvin: float) -> Body:
        """The body at a temperature `kelvin` higher: another index; its expansion is a scale and bends no
        light.

        Raises
        ------
        ValueError
            No dn/dT of its material is known.
        """
        if self.material is None:
            raise ValueError(f"{self.name}: an index without a material has no known change with temperature")
        warm = self.material.heated(kelvin)
        change = warm.index_change - self.material.index_change
        return replace(self, index=self.index + change, material=warm)


@dataclass(frozen=True, slots=True)
class FieldLens:
    """An ideal lens at a common focus: it images lens 1 onto lens 2 in its meridians with power.

    focal_length : (f_x, f_y), lengths. Infinite in a meridian without power.
    depth : length. Distance from lens 1 along the lens axis.
    change : Displacement, rise and scale factor of the lens of each cell; None: all are alike.
    """

    focal_length: tuple[float, float]
    depth: float
    change: VertexChange | None = None

    def in_cells(self, lattice: Lattice, index: Ints) -> tuple[Floats, LensPlaces]:
        """Depths (...), and places relative to the central one, of the lenses of cells `index` (..., 2)."""
        middle = (0.0, 0.0, 0.0)
        places = LensPlaces(middle) if self.change is None else self.change.places(middle, lattice, index)
        return self.depth + np.broadcast_to(places.rise, index.shape[:-1]), places


@dataclass(frozen=True, eq=False)
class ThinPair:
    """The ideal counterpart of the real pair: two thin lenses; an afocal pair shares a focal plane.

    focal_length : ((f1x, f1y), (f2x, f2y)), lengths. Infinite in a meridian without power.
    offset : (3,) lengths. Centre of lens 2 minus centre of lens 1, sheet frame, in air: R (d_x, d_y, s).
    rotation : (3, 3). Lens → sheet, common to both lenses.
    shift : (2,) lengths. Displacement of the cells of array 2 from those of array 1 in the thin model.
    pitch : (p_x, p_y) or None, lengths. Pitch of array 2's cells; None: the lattice's.
    turn : radians. Rotation of array 2's cells about their centre.
    change : Displacement of lens 2 in its cell, relative to the central cell's, and its scale factor, for
        each cell.
    change_1 : Scale factor of lens 1 of each cell; None: all are alike.
    field : In the order light reaches them: none, one, or two where the meridians have different foci.
    """

    focal_length: tuple[tuple[float, float], tuple[float, float]]
    offset: tuple[float, float, float]
    rotation: Floats
    shift: tuple[float, float]
    pitch: tuple[float, float] | None = None
    change: VertexChange | None = None
    field: tuple[FieldLens, ...] = ()
    turn: float = 0.0
    change_1: VertexChange | None = None

    @property
    def second(self) -> CellPlacement:
        """Positions of the cells of array 2 in the thin model."""
        return CellPlacement(self.shift, self.pitch, self.turn)

    @property
    def separation(self) -> float:
        """Distance s between the lens planes along the lens axis (length), f1 + f2 for an afocal pair."""
        return float(self.rotation[:, 2] @ np.asarray(self.offset))

    def lenses(self, array: int, lattice: Lattice, index: Ints) -> LensPlaces:
        """Positions of lens `array` (0, 1) in the cells `index` (..., 2), relative to the central cell's,
        and scale factors.
        """
        change = (self.change_1, self.change)[array]
        middle = (0.0, 0.0, 0.0)
        return LensPlaces(middle) if change is None else change.places(middle, lattice, index)

    def field_centre(self, lens: FieldLens) -> Floats:
        """Vertex (3,) of a field lens, sheet frame, from lens 1's centre: on the line from the centre of cell
        1 to that of cell 2, so that light in the centre of the field passes undeviated.
        """
        axis, (x, y) = self.rotation[:, 2], self.shift
        across = np.asarray(self.offset) - np.array([x, y, 0.0])
        middle = np.array([x, y, float(across @ axis) / axis[2]])  # centre of cell 2, in the plane of lens 2
        return np.asarray(middle * (lens.depth / self.separation))

    def field_place(self, lens: FieldLens, lattice: Lattice) -> tuple[CellPlacement, VertexChange | None]:
        """Cells of a field lens on the lines from cells 1 to cells 2, and displacement of its lenses."""
        x, y, _ = self.field_centre(lens).tolist()
        place, rest = self.second.between(lattice, lens.depth / self.separation * np.eye(2), (x, y))
        climb = np.array(lens_plane_slope(self.rotation)) @ (rest + place.aside(lattice))
        change = linear_change(rest, climb)
        if lens.change is not None and change is not None:
            return place, replace(lens.change, gradient=change.gradient, climb=change.climb)
        return place, change or lens.change


@dataclass(frozen=True)
class Land:
    """The flat land between and around the lenslets.

    seam : Width of the land between two lenslets (length); each cell's lens ends seam/2 from its border.
    opaque : Whether land stops light (fate VIGNETTED) or transmits it (fate LAND).
    border : Width of plain land around the cells (length).
    line, lined : Width (length) of an opaque line along the borders of all cells, printed on one face, and
        the number of that face as a surface of a trace, 2 body + side; 0 and -1 without one.
    """

    seam: float = 0.0
    opaque: bool = False
    border: float = 0.0
    line: float = 0.0
    lined: int = -1


@dataclass(frozen=True)
class Baffle:
    """Opaque honeycomb of sheared prisms between the arrays, from cell 1's border to its partner's."""

    wall: float


@dataclass(frozen=True, eq=False)
class Window(PlacedArrays):
    """The whole sheet: bodies in the order light reaches them, and the lattice they repeat on.

    Attributes
    ----------
    form : "biconvex", "plano", "slab" or "plates"
    bodies : tuple of Body
    lattice : Lattice
    placements : tuple of CellPlacement, one per array
        Positions of the cells of each array; array 0's are the lattice's.
    unit : float
        One design unit in metres.
    wavelength : float or None
        Design wavelength, metres; None when a bare index was given.
    z_range : (low, high), lengths
        Lowest and highest point of any body.
    law : Law
        The requested law. On rung "law" the tracer calls its `refract` and reads nothing else of it.
    cell_laws : CellLaws or None
        Law of each cell of a sheet with a varying law; `law` is then that of the sheet's centre. None: all
        obey `law`.
    thin : ThinPair
    land : Land
    baffle : Baffle or None
    outline : Circle, Rectangle, Plate or None
        Side outline of every body where it is not simply the boundary of the cells (a border, a round
        window, a slab whose arrays are displaced). Centred on the origin for a slab, on its array's
        displacement for a body with one array. Land lies between cells and outline. `lattice.outline`
        alone decides which cells exist: a border or `body.outline` makes the plate larger.
    recipe : mapping
        Recipe of radii and poses (kept for reports and the manifest).
    residual : mapping
        Parabasal law error and decollimation left by the recipe.
    name : str
    """

    form: Form
    bodies: tuple[Body, ...]
    lattice: Lattice
    placements: tuple[CellPlacement, ...]
    unit: float
    z_range: tuple[float, float]
    law: Law
    thin: ThinPair
    land: Land = Land()
    baffle: Baffle | None = None
    outline: Outline | None = None
    wavelength: float | None = None
    recipe: Mapping[str, Any] = field(default_factory=dict)
    residual: Mapping[str, float] = field(default_factory=dict)
    name: str = "sheet"
    cell_laws: CellLaws | None = None

    def __repr__(self) -> str:
        lattice, count = self.lattice, len(self.bodies)
        pitch = 1e3 * self.unit * lattice.pitch[0]
        return (
            f"Window({self.name!r}, {self.form}, {lattice.count[0]} x {lattice.count[1]} {lattice.kind} cells"
            f" of {pitch:g} mm, {count} {'body' if count == 1 else 'bodies'})"
        )

    @property
    def faces(self) -> tuple[Face, ...]:
        """All faces in the order light reaches them."""
        return tuple(face for body in self.bodies for face in (body.front, body.back))

    def number_of(self, face: Face) -> int:
        """Number of one of `faces`, which may be equal. Raises StopIteration: It is none of them."""
        return next(k for k, one in enumerate(self.faces) if one is face)

    @property
    def field_array(self) -> bool:
        """Whether a field lens has cells of its own."""
        return len(self.placements) > 2

    @property
    def one_outline(self) -> bool:
        """Whether all bodies have the outline of the sheet; else each follows its own array."""
        return self.form in ("slab", "plates")

    @property
    def level_and_straight(self) -> bool:
        """Whether arrays lie along the sheet's axes and a face's lenses have one size and height."""
        return not any(place.turn for place in self.placements) and not any(
            face.change is not None and not (face.change.level and face.change.size is None)
            for face in self.faces
        )

    @property
    def many_sizes(self) -> bool:
        """Whether the lenses of one face have different sizes, each for its own η."""
        return any(face.change is not None and face.change.size is not None for face in self.faces)

    @property
    def many_aspects(self) -> bool:
        """Whether the lenses of one face differ in the ratio of their curvatures: by an η_x and an η_y."""
        return any(face.change is not None and face.change.aspect is not None for face in self.faces)

    @property
    def uniform(self) -> bool:
        """Whether all cells of each array, and the displacements of their partners, are identical."""
        own = any(place.own for place in self.placements)
        return not own and self.cell_laws is None and all(face.change is None for face in self.faces)

    def vertices(self, face: Face, index: Ints) -> Floats:
        """Apexes (..., 3) of a face's lenses in cells `index` (..., 2): x, y in the cell, z of the sheet."""
        found = np.empty((*index.shape[:-1], 3))
        for axis, apex in enumerate(self.lenses(face, index).apex):
            found[..., axis] = apex
        return found

    def lenses(self, face: Face, index: Ints | None) -> LensPlaces:
        """Positions and scale factors of a face's lenses in the cells `index` (..., 2), relative to the lens
        that the face describes; None: that lens.
        """
        if face.change is None or index is None:
            return LensPlaces(face.vertex)
        return face.change.places(face.vertex, self.lattice, index)

    def law_at(self, index: ArrayLike) -> Law:
        """The design law of the cell `index` (i, j); that of the sheet where all cells obey one.

        Raises
        ------
        IndexError
            No such cell is kept.
        """
        laws = CellLaws(self.law) if self.cell_laws is None else self.cell_laws
        return laws.law_at(self.lattice, index)

    def in_cell(self, face: Face, index: Ints) -> Face:
        """Face of the uniform equivalent of the cell at `index` (2,)."""
        if face.form is not None:
            face = replace(face, form=face.form.in_cell(self.lattice, index))
        if face.change is None:
            return face
        places = self.lenses(face, index)
        x, y, z = (float(v) for v in places.apex)
        turn = face.rotation if places.rotation is None else places.rotation
        return replace(face, surface=own_surface(face, places), vertex=(x, y, z), rotation=turn, change=None)

    def with_cells(self, count: tuple[int, int]) -> Window:
        """Return the design with another cell count, centred on the origin, without a cut outline.

        Tables are cut to their central cells.

        Raises
        ------
        ValueError
            A table has fewer cells.
        """

        def cut(change: VertexChange | None) -> VertexChange | None:
            return None if change is None else change.of_middle(self.lattice, count)

        small = replace(
            self,
            lattice=self.lattice.with_count(count),
            bodies=changed_faces(self.bodies, lambda face: replace(face, change=cut(face.change))),
        )
        first, second = cut(self.thin.change_1), cut(self.thin.change)
        if first is not None or second is not None:
            fields = tuple(replace(one, change=cut(one.change)) for one in self.thin.field)
            small = replace(small, thin=replace(self.thin, change_1=first, change=second, field=fields))
        if self.cell_laws is not None:
            small = replace(small, cell_laws=self.cell_laws.of_middle(self.lattice, count))
        return replace(small, outline=side_outline(small))


def changed_faces(bodies: tuple[Body, ...], change: Callable[[Face], Face]) -> tuple[Body, ...]:
    """Bodies with each face replaced by `change` of it."""
    return tuple(replace(body, front=change(body.front), back=change(body.back)) for body in bodies)


def lifted(window: Window, z: float) -> Window:
    """The window with its faces, lands and heights a length `z` higher."""

    def up(face: Face) -> Face:
        x, y, height = face.vertex
        return replace(face, vertex=(x, y, height + z), land=None if face.land is None else face.land + z)

    if z == 0.0:
        return window
    low, high = window.z_range
    return replace(window, bodies=changed_faces(window.bodies, up), z_range=(low + z, high + z))


def side_outline(window: Window) -> Outline | None:
    """Side outline of the bodies where it is not the boundary of their cells; see `Window.outline`.

    It is the lattice's own outline with the border around it. Otherwise it is a rectangle where there is a
    border, or a slab whose arrays are displaced relative to one another.
    """
    border, second = window.land.border, window.placements[1]
    if window.lattice.outline is not None:
        return grown(window.lattice.outline, border)
    shift, own = second.shift, second.own
    displaced = window.one_outline and (shift != (0.0, 0.0) or own)
    if border == 0.0 and not displaced:
        return None
    extents = np.array([place.extent(window.lattice) for place in window.placements])
    x0, x1, y0, y1 = window.lattice.extent()
    if own:  # the widest array, relative to its own centre
        off = np.array([[x, x, y, y] for x, y in window.shifts])
        x1, y1 = float(np.abs(extents - off)[:, :2].max()), float(np.abs(extents - off)[:, 2:].max())
    reach_x, reach_y = max(-x0, x1) + border, max(-y0, y1) + border
    if window.one_outline:
        reach_x, reach_y = reach_x + abs(shift[0]), reach_y + abs(shift[1])
    if second.turn:  # the corners of a turned array do not touch the sides
        reach_x, reach_y = (reach + TURNED_ROOM * min(window.lattice.pitch) for reach in (reach_x, reach_y))
    return Rectangle(2.0 * reach_x, 2.0 * reach_y)


def optical_tile(window: Window, array: int = 0) -> Floats:
    """Corners (m, 2), lengths, of an array's optical zone: the tile less seam/2 along every border."""
    lattice = window.lattice_of(array)
    tile, seam = lattice.tile(), window.land.seam
    if seam == 0.0:
        return tile
    half = lattice.half_widths
    if lattice.hexagonal:
        return np.asarray(tile * (1.0 - 0.5 * seam / half[0]))
    zone = lattice.straight.tile() * np.array([1.0 - 0.5 * seam / half[0], 1.0 - 0.5 * seam / half[1]])
    return turned(zone, lattice.turn) if lattice.turn else np.asarray(zone)


def in_optical_tile(window: Window, x: Floats, y: Floats, array: int = 0) -> NDArray[np.bool_]:
    """Which points (cell frame, (n,), lengths) lie in the optical zone of an array's cell, (n,) bool."""
    margin = 0.5 * window.land.seam
    lattice = window.lattice_of(array)
    inside = np.ones(np.shape(x), dtype=bool)
    for step, half in zip(lattice.steps, lattice.half_widths):
        ox, oy = lattice.offset(*step)
        inside &= (x * ox + y * oy) / (2.0 * half) <= half - margin
    return inside


def lens_height(face: Face, x: Floats, y: Floats) -> Floats:
    """Sheet-frame height of a lenslet over points of its cell frame.

    x, y : (n,) arrays, lengths. Cell frame.
    Returns (n,) array, lengths: NaN where the lenslet has no point above (x, y), or beyond the equator of the
        surface.

    Notes
    -----
    A vertical ray is intersected with the surface in the lens frame. The quadric's cancellation-free root
    keeps the relative accuracy of the height above the apex, even for very flat lenses.
    """
    face = face.simplified
    if face.upright:  # its sag needs no ray
        u, v = np.asarray(x) - face.vertex[0], np.asarray(y) - face.vertex[1]
        if not face.untilted:
            start = np.stack(np.broadcast_arrays(u, v, 0.0), axis=-1)
            u, v, _ = seen_along(start.reshape(-1, 3), face.rotation).T.reshape(3, *start.shape[:-1])
        sag = sag_by_itself(face.surface, u, v)
        if sag is not None:
            return np.asarray(face.vertex[2] + sag)
    z, _ = lens_height_and_normal(face, x, y)
    return z


def sag_by_itself(surface: Surface, x: Floats, y: Floats) -> Floats | None:
    """Heights (...) of a surface over points (...), as by rays along its axis; None where it needs these."""
    return upright_sag(surface, x, y) if isinstance(surface, Quadric) else surface.sag(x, y)


def lens_height_and_normal(face: Face, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Sheet-frame height (n,) and unit normal towards +z (n, 3) of a lenslet over cell-frame points.

    NaN where `lens_height` is NaN.
    """
    face = face.simplified
    x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
    vx, vy, vz = face.vertex
    start = np.stack([x - vx, y - vy, np.zeros(x.shape)], axis=-1).reshape(-1, 3)
    up = np.array([0.0, 0.0, 1.0])
    if not face.untilted:
        start = seen_along(start, face.rotation)
        up = face.rotation[..., 2, :].copy()
    direction = np.broadcast_to(up, start.shape)
    met = meet(face.surface, start, np.ascontiguousarray(direction))
    normal = met.gradient
    if not face.untilted:
        normal = seen_along(normal, face.rotation.swapaxes(-1, -2))
    with np.errstate(invalid="ignore", divide="ignore"):
        normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        graph = (normal[:, 2] > 0.0) & np.isfinite(met.distance)
    z = np.where(graph, vz + met.distance, np.nan)
    normal = np.where(graph[:, None], normal, np.nan)
    return z.reshape(x.shape), normal.reshape((*x.shape, 3))


def seen_along(rows: Floats, rotation: Floats) -> Floats:
    """Rows (n, 3) of sheet axes along the axes of one lens (3, 3), lens → sheet, or of one each (n, 3, 3)."""
    return np.asarray(rows @ rotation if rotation.ndim == 2 else to_surface(rotation, rows))


def own_surface(face: Face, places: LensPlaces) -> Surface:
    """Surface of the lens of one cell."""
    stretch = 1.0 if places.aspect is None else float(places.aspect)
    shape = face.surface if stretch == 1.0 else stretched(face.surface, stretch)
    return shape if places.size is None else resized(shape, float(places.size))


def heights_of_lenses(face: Face, places: LensPlaces, x: Floats, y: Floats) -> Floats:
    """Sheet-frame heights (...) of the lenses at `places` over points (...) of their cells, lengths."""
    own, x, y = _own_lens(face, places, x, y)
    return places.raised(lens_height(own, x.ravel(), y.ravel()).reshape(x.shape))


def heights_and_normals_of_lenses(
    face: Face, places: LensPlaces, x: Floats, y: Floats
) -> tuple[Floats, Floats]:
    """Heights (...) and unit normals (..., 3) of the lenses at `places` over points (...) of their cells."""
    own, x, y = _own_lens(face, places, x, y)
    z, normal = lens_height_and_normal(own, x.ravel(), y.ravel())
    return places.raised(z.reshape(x.shape)), normal.reshape((*x.shape, 3))


def _own_lens(face: Face, places: LensPlaces, x: Floats, y: Floats) -> tuple[Face, Floats, Floats]:
    """Face of the unscaled lenses over points (...), in one row, and the points as these see them."""
    x, y = np.broadcast_arrays(*places.seen(x, y))
    return lenses_of(face, places, x.shape), x, y


def lenses_of(face: Face, places: LensPlaces, like: tuple[int, ...]) -> Face:
    """Face of the unscaled lenses at `places` over points of a shape, in one row."""
    if places.aspect is None and places.rotation is None:
        return face
    turn = places.axes(face.rotation, like)
    assert turn is not None
    return replace(face, surface=places.shape(face.surface, like), rotation=turn)


def column(
    window: Window, body: Body, x: Floats, y: Floats, index: Ints | None = None
) -> tuple[Floats, Floats]:
    """Front and back height of a columnar body's column over cell-frame points, (n,) each, lengths.

    index : (n, 2) or None. The points' cells, for a non-uniform sheet.

    The height is the lens's where the lens protrudes from the land inside its optical zone, and the land's
    elsewhere. It is NaN in both where there is no material (outside the rim of a lens without a web).
    """
    front, back = (face_height(window, face, x, y, index) for face in (body.front, body.back))
    if not body.columnar:
        return front, back
    lens_front = _in_zone(window, body.front, x, y, index)
    lens_back = _in_zone(window, body.back, x, y, index)
    with np.errstate(invalid="ignore"):
        rimless = ~(lens_front <= lens_back)  # outside the rim, or no lens at all
    land_front = np.nan if body.front.land is None else body.front.land
    land_back = np.nan if body.back.land is None else body.back.land
    return np.where(rimless, land_front, front), np.where(rimless, land_back, back)


def face_height(window: Window, face: Face, x: Floats, y: Floats, index: Ints | None = None) -> Floats:
    """Height (length) of one face over cell-frame points (n,): the outermost of lens and land, NaN at a hole.

    index : (n, 2) or None
        The points' cells, for a non-uniform sheet; None: the cell whose lens is at `Face.vertex`.
    """
    if face.array is None:
        return np.full(np.shape(x), face.vertex[2])
    lens = _in_zone(window, face, x, y, index)
    if face.land is None:
        return lens
    proud = np.fmin(lens, face.land) if face.land_side > 0 else np.fmax(lens, face.land)
    return np.asarray(proud)


def _in_zone(window: Window, face: Face, x: Floats, y: Floats, index: Ints | None) -> Floats:
    places = window.lenses(face, index)
    lens = heights_of_lenses(face, places, x, y)
    if face.form is not None:
        lens = lens + face.form(window.lattice, index, x, y)
    if window.land.seam > 0.0:
        zone = in_optical_tile(window, np.asarray(x), np.asarray(y), face.array or 0)
        lens = np.where(zone, lens, np.nan)
    return lens
