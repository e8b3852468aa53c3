"""Write shells as ISO 10303-21 (STEP) text: a `Writer` that needs no CAD kernel.

The text is a stream: an edge is written when its second face has used it, so memory grows only with the
numbers of vertices and faces. Parameter curves are the same for all instances of a class and are written
once. Edges on one line and walls in one plane share its entity. Lengths in mm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np

from clacad.base.types import Floats
from clacad.formats.step.part21 import Part21, quoted, real, weight
from clacad.solid.edge_classes import Cylinder, Plane, Surface
from clacad.solid.rational_conics import Arc, RationalPatch
from clacad.solid.shells import Loop, Role

_KEPT = 200_000

S = TypeVar("S")
T = TypeVar("T")


class Recent:
    """Numbers of recently written entities by their text: bounded memory, recent duplicates written once."""

    __slots__ = ("_now", "_before")

    def __init__(self) -> None:
        self._now: dict[str, int] = {}
        self._before: dict[str, int] = {}

    def find(self, text: str) -> int | None:
        """The number under which the text was kept, None if it was not kept or is too old."""
        return self._now.get(text) or self._before.get(text)

    def keep(self, text: str, number: int) -> int:
        """Store a number; return it."""
        self._now[text] = number
        if len(self._now) > _KEPT:
            self._before, self._now = self._now, {}
        return number


class SharedGeometry:
    """Points, directions, curves and surfaces of a file; equal ones are written once.

    part : Part21
    """

    def __init__(self, part: Part21) -> None:
        self.part = part
        self._places, self._lines, self._planes = Recent(), Recent(), Recent()
        self._kept: dict[int, tuple[object, Any]] = {}
        self._directions: dict[tuple[float, ...], int] = {}
        self._vectors: dict[tuple[float, ...], int] = {}

    def line(self, first: int, arc: Arc, offset: Floats) -> int:
        """A line through the point `first`; collinear edges share it, because a line has no ends in STEP."""
        start = arc.poles[0] + offset
        way = arc.poles[-1] - arc.poles[0]
        way = way / np.linalg.norm(way)
        unit = tuple(way.tolist())
        vector = self.vector(unit)
        foot = start - float(start @ way) * way
        text = f"{vector}{self.part.coordinates(foot.tolist())}"
        return self._lines.find(text) or self._lines.keep(text, self.part.add(f"LINE('',#{first},#{vector})"))

    def curve(self, first: int, last: int, arc: Arc, offset: Floats) -> int:
        """A curve between the points `first` and `last`, displaced by `offset` (3,), mm."""
        inner = (arc.poles[1:-1] + offset).tolist()
        coordinates = self.part.coordinates
        points = [first, *(self.point(coordinates(p)) for p in inner), last]
        self._bound()
        before, after = self._once(arc, _plain_curve_text)
        return self.part.add(f"{before}{','.join([f'#{p}' for p in points])}{after}")

    def _bound(self) -> None:
        """Discard shared data of instances where each has a class of its own: it is then written again."""
        if len(self._kept) > _KEPT // 4:
            self._kept.clear()

    def _once(self, shared: S, make: Callable[[S], T]) -> T:
        """What is made of the data of a class, once for all its instances; the data are kept alive."""
        found = self._kept.get(id(shared))
        if found is None:
            found = self._kept[id(shared)] = (shared, make(shared))
        made: T = found[1]
        return made

    def parameter_curve(self, parameters: Arc) -> int:
        """The representation of a parameter curve, written once for all instances of its class."""
        return self._once(parameters, self._representation)

    def _representation(self, parameters: Arc) -> int:
        part = self.part
        points = [
            part.add(f"CARTESIAN_POINT('',({real(u)},{real(v)}))") for u, v in parameters.poles.tolist()
        ]
        before, after = _curve_text(parameters.weights, real)
        curve = part.add(f"{before}{','.join(f'#{p}' for p in points)}{after}")
        return part.add(f"DEFINITIONAL_REPRESENTATION('',(#{curve}),#{part.parameter_space})")

    def plane(self, plane: Plane, offset: Floats) -> int:
        """A plane; faces in one plane share it, because a plane has no ends in STEP."""
        part = self.part
        origin = plane.origin + offset
        normal, across = (self._direction(tuple(way.tolist())) for way in (plane.normal, plane.across))
        text = f"{normal},{across},{part.coordinate(float(origin @ plane.normal))}"
        found = self._planes.find(text)
        if found is not None:
            return found
        at = self.point(part.coordinates(origin.tolist()))
        place = part.add(f"AXIS2_PLACEMENT_3D('',#{at},#{normal},#{across})")
        return self._planes.keep(text, part.add(f"PLANE('',#{place})"))

    def cylinder(self, cylinder: Cylinder, offset: Floats) -> int:
        """An upright cylinder, by which programs recognise a round hole."""
        part = self.part
        at = self.point(part.coordinates((np.append(cylinder.centre, 0.0) + offset).tolist()))
        up, across = (self._direction(way) for way in ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)))
        place = part.add(f"AXIS2_PLACEMENT_3D('',#{at},#{up},#{across})")
        return part.add(f"CYLINDRICAL_SURFACE('',#{place},{part.coordinate(cylinder.radius)})")

    def patch(self, patch: RationalPatch, offset: Floats) -> int:
        """A patch displaced by `offset` (3,), mm."""
        part = self.part
        m, n = patch.weights.shape
        before, after = self._once(patch, _patch_text)
        poles = (patch.poles.reshape(-1, 3) + offset).tolist()
        ids = [f"#{self.point(part.coordinates(pole))}" for pole in poles]
        rows = ",".join([f"({','.join(ids[i * n : (i + 1) * n])})" for i in range(m)])
        return part.add(f"{before}{rows}{after}")

    def vector(self, unit: tuple[float, ...]) -> int:
        """A unit vector, written once."""
        if unit not in self._vectors:
            self._vectors[unit] = self.part.add(f"VECTOR('',#{self._direction(unit)},1.)")
        return self._vectors[unit]

    def _direction(self, way: tuple[float, ...]) -> int:
        if way not in self._directions:
            self._directions[way] = self.part.add(f"DIRECTION('',({','.join(real(value) for value in way)}))")
        return self._directions[way]

    def point(self, text: str) -> int:
        """A point; recent equal points are written once."""
        return self._places.find(text) or self._places.keep(
            text, self.part.add(f"CARTESIAN_POINT('',{text})")
        )


class TextWriter:
    """Write shells as text; see `clacad.solid.shells.Writer`.

    part : Part21
    curves : Write parameter curves.
    points, vertices, edges, surfaces, faces : lists
        Entities: point and vertex of every vertex; edges; surfaces; faces.
    round : Of every surface: None, or whether it is a cylinder whose normal points to the axis.
    roles : Of every face.
    """

    def __init__(self, part: Part21, curves: bool) -> None:
        self.part, self.with_curves = part, curves
        self.vertices: list[int] = []
        self.points: list[int] = []
        self.edges: list[int] = []
        self._open: dict[int, tuple[int, int, Arc, Floats, list[str], list[bool]]] = {}
        self.surfaces: list[int] = []
        self.round: list[bool | None] = []
        self.faces: list[int] = []
        self.roles: list[Role] = []
        self.geometry = SharedGeometry(part)

    @property
    def unfinished(self) -> int:
        """Number of edges that were not used by exactly two faces (0 for closed shells)."""
        return len(self._open)

    def vertex(self, point: Floats, tolerance: float) -> int:
        """Write a vertex (text has no tolerance: readers find it from the geometry)."""
        at = self.geometry.point(self.part.coordinates(point.tolist()))
        self.points.append(at)
        self.vertices.append(self.part.add(f"VERTEX_POINT('',#{at})"))
        return len(self.vertices) - 1

    def edge(self, first: int, last: int, arc: Arc, offset: Floats, tolerance: float) -> int:
        """Reserve an edge; it is written when two faces have used it."""
        number = len(self.edges)
        self.edges.append(self.part.reserve())
        self._open[number] = (first, last, arc, offset, [], [])
        return number

    def surface(self, surface: Surface, offset: Floats) -> int:
        """Write a surface."""
        self.round.append(surface.inward if isinstance(surface, Cylinder) else None)
        if isinstance(surface, Plane):
            number = self.geometry.plane(surface, offset)
        elif isinstance(surface, Cylinder):
            number = self.geometry.cylinder(surface, offset)
        else:
            number = self.geometry.patch(surface, offset)
        self.surfaces.append(number)
        return len(self.surfaces) - 1

    def face(self, surface: int, same_sense: bool, loops: list[Loop], role: Role) -> int:
        """Write a face and its loops."""
        part = self.part
        bounds = []
        for n, loop in enumerate(loops):
            uses = []
            for use in loop:
                if use.edge < 0:
                    continue  # a side closed in a point is no edge in STEP
                sense = "T" if use.forward else "F"
                uses.append(part.add(f"ORIENTED_EDGE('',*,*,#{self.edges[use.edge]},.{sense}.)"))
            ring = part.add(f"EDGE_LOOP('',({','.join(f'#{use}' for use in uses)}))")
            bounds.append(part.add(f"{'FACE_OUTER_BOUND' if n == 0 else 'FACE_BOUND'}('',#{ring},.T.)"))
            for use in loop:
                if use.edge >= 0:
                    self.use(use.edge, use.forward, use.parameters, surface)
        listed = ",".join(f"#{bound}" for bound in bounds)
        sense = "T" if same_sense and not self.round[surface] else "F"
        self.faces.append(part.add(f"ADVANCED_FACE('{role}',({listed}),#{self.surfaces[surface]},.{sense}.)"))
        self.roles.append(role)
        return len(self.faces) - 1

    def solid(self, faces: Sequence[int], name: str) -> int:
        """Close faces to a solid; return its entity number."""
        listed = ",".join([f"#{self.faces[face]}" for face in faces])
        shell = self.part.add(f"CLOSED_SHELL('',({listed}))")
        return self.part.add(f"MANIFOLD_SOLID_BREP({quoted(name)},#{shell})")

    def use(self, edge: int, forward: bool, parameters: Arc | None, surface: int) -> None:
        """Count a use of an edge by a face, with its parameter curve; the second one writes the edge."""
        if edge not in self._open:
            raise ValueError("an edge is used by more than two faces; please report the design")
        first, last, arc, offset, curves, senses = self._open[edge]
        senses.append(forward)
        # a cylinder's own parameter is the angle, that of its edges is not: readers project them
        if parameters is not None and self.with_curves and self.round[surface] is None:
            shared = self.geometry.parameter_curve(parameters)
            number = self.part.add(f"PCURVE('',#{self.surfaces[surface]},#{shared})")
            curves.append(f"#{number}")
        if len(senses) == 2:
            if senses[0] == senses[1]:
                raise ValueError("an edge runs the same way in both its faces; please report the design")
            del self._open[edge]
            self._finish(edge, first, last, arc, offset, curves)

    def _finish(self, edge: int, first: int, last: int, arc: Arc, offset: Floats, curves: list[str]) -> None:
        part = self.part
        ends = self.points[first], self.points[last]
        if arc.straight and not curves:
            curve = self.geometry.line(ends[0], arc, offset)
        else:
            curve = self.geometry.curve(*ends, arc, offset)
        if curves:
            curve = part.add(f"SURFACE_CURVE('',#{curve},({','.join(curves)}),.PCURVE_S1.)")
        part.put(
            self.edges[edge], f"EDGE_CURVE('',#{self.vertices[first]},#{self.vertices[last]},#{curve},.T.)"
        )


def _knots(degree: int) -> tuple[str, str]:
    return f"({degree + 1},{degree + 1})", "(0.,1.)"


def _curve_text(weights: Floats, written: Callable[[float], str]) -> tuple[str, str]:
    degree = len(weights) - 1
    many, knots = _knots(degree)
    if np.ptp(weights) == 0.0:
        return (
            f"B_SPLINE_CURVE_WITH_KNOTS('',{degree},(",
            f"),.UNSPECIFIED.,.F.,.F.,{many},{knots},.UNSPECIFIED.)",
        )
    listed = ",".join([written(value) for value in weights])
    return (
        f"(BOUNDED_CURVE()B_SPLINE_CURVE({degree},(",
        (
            f"),.UNSPECIFIED.,.F.,.F.)B_SPLINE_CURVE_WITH_KNOTS({many},{knots},.UNSPECIFIED.)CURVE()"
            f"GEOMETRIC_REPRESENTATION_ITEM()"
            f"RATIONAL_B_SPLINE_CURVE(({listed}))REPRESENTATION_ITEM(''))"
        ),
    )


def _plain_curve_text(arc: Arc) -> tuple[str, str]:
    """All of a curve but its poles, the same for all instances of its class."""
    return _curve_text(arc.weights, weight)


def _patch_text(patch: RationalPatch) -> tuple[str, str]:
    weights = patch.weights
    m, n = weights.shape
    many_u, knots = _knots(m - 1)
    many_v, _ = _knots(n - 1)
    if np.ptp(weights) == 0.0:
        return (
            f"B_SPLINE_SURFACE_WITH_KNOTS('',{m - 1},{n - 1},(",
            f"),.UNSPECIFIED.,.F.,.F.,.F.,{many_u},{many_v},{knots},{knots},.UNSPECIFIED.)",
        )
    listed = ",".join([f"({','.join([weight(value) for value in row])})" for row in weights])
    return (
        f"(BOUNDED_SURFACE()B_SPLINE_SURFACE({m - 1},{n - 1},(",
        (
            f"),.UNSPECIFIED.,.F.,.F.,.F.)"
            f"B_SPLINE_SURFACE_WITH_KNOTS({many_u},{many_v},{knots},{knots},.UNSPECIFIED.)"
            f"GEOMETRIC_REPRESENTATION_ITEM()"
            f"RATIONAL_B_SPLINE_SURFACE(({listed}))REPRESENTATION_ITEM('')SURFACE())"
        ),
    )
