"""Name and orientation marks engraved into the border: the part's name, viewer side and up direction.

The viewer is on the −z side. The marks are engraved in the face towards the viewer and are readable from
there; the arrow points to the sheet's +y. Lengths in mm.

Text as plane faces, in an order that depends on the text alone.

OCC orders the pieces of a glyph ("i", "=") and the holes of one ("8", "B") by their memory addresses. A text
drawn twice would have two orders, and so would every mesh and file made of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.units import millimetres
from clacad.sheet.grid_steps import one_tiling
from clacad.sheet.lattice import Circle, Outline
from clacad.sheet.plate import Plate, free_width
from clacad.sheet.volume_and_extent import NoFixture, plane_of

if TYPE_CHECKING:
    from clacad.sheet.window import Body, Window


def lettering(text: str, size: float) -> Any:
    """A line of bold text in the plane z = 0, about the origin: a build123d sketch, faces and holes from
    left to right.

    size : Height of the font (mm).
    """
    from build123d import Compound, FontStyle, Sketch, Text

    drawn: Any = Text(text, size, font_style=FontStyle.BOLD)
    faces = sorted(drawn.faces(), key=lambda face: _place(face.outer_wire()))
    return Sketch(Compound([_with_ordered_holes(face) for face in faces]).wrapped)


def _with_ordered_holes(face: Any) -> Any:
    """The face with the same wires, its holes from left to right."""
    from build123d import Face
    from OCP.BRep import BRep_Builder
    from OCP.TopAbs import TopAbs_Orientation

    forward = Face(face.wrapped.Oriented(TopAbs_Orientation.TopAbs_FORWARD))
    made = forward.wrapped.EmptyCopied()
    build = BRep_Builder()
    for wire in (forward.outer_wire(), *sorted(forward.inner_wires(), key=_place)):
        build.Add(made, wire.wrapped)
    return Face(made.Oriented(face.wrapped.Orientation()))


def _place(wire: Any) -> tuple[float, float, float, float]:
    """Corners of a wire's box: left, bottom, right, top."""
    box = wire.bounding_box()
    return (box.min.X, box.min.Y, box.max.X, box.max.Y)


SMALLEST = 0.1
"""Least height of a letter (mm): the limit of a fine engraving laser."""
TALLEST = 3.0
DEEPEST = 0.1
"""Largest depth of the letters (mm)."""
DEPTH_SHARE = 0.2
"""Largest depth of the letters over the border's thickness."""
FONT = 0.7
"""Size of the font over the height of the line."""
WIDEST = 1.2
"""Upper bound of the widest letter's width over the size of its font."""
TALL = 1.1
"""Upper bound of the height of a line with its deepest letters over its nominal height."""
VIEWER = "VIEWER SIDE"


@dataclass(frozen=True, slots=True)
class MarkPlace:
    """Position of marks, sheet frame, mm.

    centre : (x, y, z). Middle of the line of text, on the face.
    width, height : Space for the line.
    """

    centre: tuple[float, float, float]
    width: float
    height: float
    depth: float


def _border_below(outline: Outline, lowest: float) -> tuple[float, float]:
    """Height of the border below cells that end at y = `lowest`, and width of a line in it; lengths."""
    if isinstance(outline, Circle):
        radius = 0.5 * outline.diameter
        room = radius + lowest
        return room, 2.0 * float(np.sqrt(max(0.0, radius**2 - (0.25 * room - lowest + 0.5 * room) ** 2)))
    if isinstance(outline, Plate):
        room = lowest - outline.box[2]
        return room, float(free_width(outline, lowest - 0.8 * room, lowest - 0.2 * room))
    room = 0.5 * outline.height + lowest
    return room, float(outline.width - room)


def mark_place(window: Window, body: Body) -> MarkPlace:
    """Find the space for marks: the land below the cells, on the face towards the viewer.

    Raises
    ------
    NoFixture
        The body has no border, or one too narrow for letters.
    """
    scale = millimetres(window.unit)
    if window.outline is None:
        raise NoFixture(
            f"{body.name} has no border to engrave: give body.border a width, such as '2 mm' (or mark the"
            " frame)"
        )
    arrays = one_tiling(window, body)
    centre = np.array(window.shifts[arrays[0]]) if len(arrays) == 1 else np.zeros(2)
    lowest = window.lattice.extent()[2]
    for face in (body.front, body.back):
        if face.array is not None:
            lowest = min(lowest, window.placements[face.array].extent(window.lattice)[2] - centre[1])
    if isinstance(window.outline, Plate):
        centre = np.zeros(2)
        lowest = min(window.lattice.extent()[2] + dy for dy in (0.0, window.shifts[1][1]))
    room, width = _border_below(window.outline, lowest)
    height = 0.5 * room
    y = centre[1] + lowest - 0.25 * room - 0.5 * height
    thickness = (plane_of(body, +1) - plane_of(body, -1)) * scale
    height = min(float(height) * scale, TALLEST)
    if height < SMALLEST or width <= 0.0:
        raise NoFixture(
            f"{body.name}: {room * scale:.3g} mm of border below the cells leave letters of {height:.2g} mm; "
            f"at least {SMALLEST} mm are needed: body.border >= '{4.0 * SMALLEST:.1f} mm'"
        )
    place = (float(centre[0]) * scale, float(y) * scale, plane_of(body, -1) * scale)
    return MarkPlace(place, width * scale, height, min(DEEPEST, DEPTH_SHARE * thickness))


@dataclass(frozen=True, slots=True)
class Pocket:
    """Area of a body in which letters may be engraved, from the window alone; design lengths.

    low, high : (x, y). Corners of the space for the line.
    land, floor : Heights of the face and of the letters' floors.
    """

    body: str
    low: tuple[float, float]
    high: tuple[float, float]
    land: float
    floor: float

    def on_floor(self, corners: NDArray[np.float64], room: float) -> NDArray[np.bool_]:
        """Which facets (k, 3, 3) are a floor of letters, with a height tolerance `room` (length)."""
        level = np.abs(corners[..., 2] - self.floor) <= room
        inside = (corners[..., :2] >= np.subtract(self.low, room)) & (
            corners[..., :2] <= np.add(self.high, room)
        )
        return np.asarray((level & inside.all(axis=-1)).all(axis=-1))


def pockets(window: Window) -> tuple[Pocket, ...]:
    """The areas for marks of all bodies that have one, as computed by `mark_place`."""
    scale = millimetres(window.unit)
    found = []
    for body in window.bodies:
        try:
            place = mark_place(window, body)
        except NoFixture:
            continue
        (x, y, z), half = place.centre, (0.5 * place.width, 0.5 * place.height)
        low, high = (
            ((x - half[0]) / scale, (y - half[1]) / scale),
            ((x + half[0]) / scale, (y + half[1]) / scale),
        )
        found.append(Pocket(body.name, low, high, z / scale, (z + place.depth) / scale))
    return tuple(found)


def marks(place: MarkPlace, name: str) -> Any:
    """The letters and the arrow as build123d solids that extend from the face into the material.

    Raises NoFixture: The line is too long for letters of the least height.
    """
    from build123d import Plane

    plane = Plane(origin=place.centre, x_dir=(-1, 0, 0), z_dir=(0, 0, -1))
    return line_of_marks(plane, mark_text(name), place.width, place.height, place.depth)


def mark_text(name: str) -> str:
    """The line of text next to the arrow."""
    return f"{name}  {VIEWER}"


def line_of_marks(plane: Any, text: str, width: float, height: float, depth: float) -> Any:
    """An arrow (pointing to the plane's +y) and a line of text, sunk `depth` below the plane.

    Raises NoFixture: The line is too long for letters of the least height.
    """
    from build123d import extrude

    return extrude(plane * line_sketch(text, width, height), -depth)


def line_sketch(text: str, width: float, height: float) -> Any:
    """An arrow pointing to +y and a line of text that reads along +x, about the origin: a build123d sketch,
    mm.

    Raises NoFixture: The line is too long for letters of the least height.
    """
    from build123d import Polygon, Pos, scale

    letters, shrink = _drawn(text, width, height)
    box = letters.bounding_box()
    arrow_width, half = FONT * height, 0.5 * height
    arrow: Any = Polygon(
        (0.0, half),
        (-0.5 * arrow_width, 0.0),
        (-0.2 * arrow_width, 0.0),
        (-0.2 * arrow_width, -half),
        (0.2 * arrow_width, -half),
        (0.2 * arrow_width, 0.0),
        (0.5 * arrow_width, 0.0),
        align=None,
    )
    whole = 2.0 * arrow_width + box.size.X
    line = Pos(-0.5 * whole + 0.5 * arrow_width, 0) * arrow
    middle = box.center()
    line += Pos(0.5 * whole - 0.5 * box.size.X - middle.X, -middle.Y) * letters
    return scale(line, shrink)


def _drawn(text: str, width: float, height: float) -> tuple[Any, float]:
    """Letters as a build123d sketch, and the factor by which they and their arrow are reduced to fit."""
    letters = lettering(text, FONT * height)
    box = letters.bounding_box()
    shrink = min(1.0, width / (box.size.X + 2.0 * FONT * height), height / max(box.size.Y, height))
    if shrink * FONT * height < 0.5 * SMALLEST:
        raise NoFixture(
            f"{text!r} is {box.size.X:.3g} mm long in letters of {height:.2g} mm; {width:.3g} mm are there: "
            "a wider border, a shorter name, or more cells"
        )
    return letters, shrink


def require_room(text: str, width: float, height: float) -> None:
    """Draw a line of text to see whether it fits (mm).

    Raises NoFixture: The line is too long for letters of the least height.
    """
    _drawn(text, width, height)


def surely_fits(text: str, width: float, height: float) -> bool:
    """Whether a line of text fits even if all its letters have the largest width (mm); nothing is drawn."""
    longest = (WIDEST * len(text) + 2.0) * FONT * height
    return min(1.0, width / longest, 1.0 / TALL) * FONT * height >= 0.5 * SMALLEST


def marked_solids(window: Window, name: str) -> dict[str, Any]:
    """Every body with the design's name and the arrow engraved: body name → build123d part, mm.

    Raises
    ------
    NoFixture
        A body has no border, or one too narrow.
    RuntimeError
        The engraved body is no valid solid, or its lost volume is not that of the letters.
    """
    from clacad.solid.solids import solids

    places = [mark_place(window, body) for body in window.bodies]  # refused before anything is built
    made = {}
    for body, place, part in zip(window.bodies, places, solids(window), strict=True):
        letters = marks(place, f"{name} {body.name}")
        made[body.name] = engraved(part, letters, place.centre[2])
        made[body.name].label = body.name
    return made


def engraved(part: Any, letters: Any, level: float) -> Any:
    """Sink letters into the plane face of a part that looks towards −z at this height, without a Boolean.

    The outline of every letter becomes a hole of the face. Its sides and bottom, reversed, close the pocket;
    the inside of an "o" remains as a separate face. No other face of the part changes.

    part : build123d.Solid or Compound
    letters : build123d object. Solids whose upper faces lie on the face, at `level` (mm).
    Raises RuntimeError: As `marked_solids`.
    """
    import build123d as b

    pockets = letters.solids()
    corners = [(box.min.X, box.max.X, box.min.Y, box.max.Y) for box in (p.bounding_box() for p in pockets)]
    spots = [b.Vector(x, y, level) for x0, x1, y0, y1 in corners for x in (x0, x1) for y in (y0, y1)]
    solids = part.solids()
    for number, solid in enumerate(solids):
        for face in solid.faces():
            if _looks_down(face, level) and all(face.is_inside(spot) for spot in spots):
                solids[number] = b.Solid(_sunk(solid, face, pockets, level))
                made = solids[0] if len(solids) == 1 else b.Compound(children=solids)
                _check(part, letters, made)
                return made
    raise RuntimeError("no plane face has room for the letters; please report the design")


def _looks_down(face: Any, level: float) -> bool:
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.GeomAbs import GeomAbs_SurfaceType
    from OCP.TopAbs import TopAbs_Orientation

    surface = BRepAdaptor_Surface(face.wrapped)
    if surface.GetType() != GeomAbs_SurfaceType.GeomAbs_Plane:
        return False
    plane = surface.Plane()
    up = plane.Axis().Direction().Z() * (1.0 if plane.Direct() else -1.0)
    if face.wrapped.Orientation() == TopAbs_Orientation.TopAbs_REVERSED:
        up = -up
    return bool(up < -0.5 and abs(plane.Location().Z() - level) < 1e-6)


def _check(part: Any, letters: Any, made: Any) -> None:
    # OCCT integrates plane faces bounded by letters to some per cent of the letters.
    apart = abs(part.volume - letters.volume - made.volume) / letters.volume
    if not made.is_valid or apart > 0.1:
        raise RuntimeError(f"the engraved body is not valid, or {apart:.2g} of the letters off in volume")


def _sunk(solid: Any, land: Any, pockets: list[Any], level: float) -> Any:
    """The solid with one face replaced by itself with holes, and the pockets' faces added."""
    from OCP.BRep import BRep_Builder
    from OCP.TopoDS import TopoDS_Shell, TopoDS_Solid

    build = BRep_Builder()
    shell, whole = TopoDS_Shell(), TopoDS_Solid()
    build.MakeShell(shell)
    holes, islands = [], []
    for face in solid.faces():
        if not face.wrapped.IsSame(land.wrapped):
            build.Add(shell, face.wrapped)
    for pocket in pockets:
        for face in pocket.faces():
            if _looks_down(face, level):
                holes.append(face.outer_wire().wrapped)
                islands += [wire.wrapped for wire in face.inner_wires()]
            else:
                build.Add(shell, face.wrapped.Reversed())
    build.Add(shell, _refaced(land, [wire.wrapped for wire in land.wires()], holes))
    for island in islands:
        build.Add(shell, _refaced(land, [], [island]))
    shell.Closed(True)
    build.MakeSolid(whole)
    build.Add(whole, shell)
    return whole


def _refaced(face: Any, kept: list[Any], turned: list[Any]) -> Any:
    """A face on the same plane, bounded by `kept` wires as they are and by `turned` wires reversed."""
    from OCP.BRep import BRep_Builder
    from OCP.TopAbs import TopAbs_Orientation

    build = BRep_Builder()
    forward = face.wrapped.Orientation() == TopAbs_Orientation.TopAbs_FORWARD
    made = face.wrapped.EmptyCopied()
    made.Orientation(TopAbs_Orientation.TopAbs_FORWARD)
    for wire, reverse in [(wire, False) for wire in kept] + [(wire, True) for wire in turned]:
        build.Add(made, wire.Reversed() if reverse == forward else wire)
    made.Orientation(face.wrapped.Orientation())
    return made
