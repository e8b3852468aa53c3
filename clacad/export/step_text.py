"""Write ISO 10303-21 (STEP) text directly: a `Writer` for fused shells, and instanced assemblies.

The text is a stream: an edge is written when its second face has used it, so memory grows only with the numbers
of vertices and faces. Parameter curves are the same for all instances of a class and are written once. No clock,
host or user enters the file: the same description gives the same bytes. Lengths in mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, log10
from typing import IO

import numpy as np

from clacad.brep.conics import Arc, Patch
from clacad.brep.edges import Plane, Surface
from clacad.brep.pattern import Floats
from clacad.brep.shell import Loop, Role

SCHEMAS = {
    "AP242": (
        "AP242_MANAGED_MODEL_BASED_3D_ENGINEERING_MIM_LF { 1 0 10303 442 1 1 4 }",
        "managed model based 3d engineering",
        "ap242_managed_model_based_3d_engineering",
        2013,
    ),
    "AP214": ("AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }", "automotive_design", "automotive_design", 2000),
}

EPOCH = "1970-01-01T00:00:00"
"""Time stamp of every file: the format demands one, equal designs shall give equal bytes."""

_FLUSH = 1 << 20
_POINTS_KEPT = 200_000


def quoted(text: str) -> str:
    """Encode a string of Part 21: quotes and backslashes doubled, other than ASCII in hexadecimal."""
    out = []
    for character in text:
        code = ord(character)
        if character in "'\\":
            out.append(character * 2)
        elif 32 <= code < 127:
            out.append(character)
        elif code < 0x10000:
            out.append(f"\\X2\\{code:04X}\\X0\\")
        else:
            out.append(f"\\X4\\{code:08X}\\X0\\")
    return "'" + "".join(out) + "'"


def real(value: float) -> str:
    """Write a number with all its digits."""
    text = repr(float(value))
    if "e" in text:
        mantissa, _, exponent = text.partition("e")
        return f"{mantissa if '.' in mantissa else mantissa + '.'}E{exponent}"
    return text[:-1] if text.endswith(".0") else text


@dataclass(frozen=True, slots=True)
class Colour:
    """An sRGB colour, 0 … 1."""

    red: float
    green: float
    blue: float


class Part21:
    """The stream of entities of one file, with the units and contexts every STEP file needs."""

    def __init__(self, stream: IO[str], schema: str, name: str, program: str, pitch: float) -> None:
        if schema not in SCHEMAS:
            raise ValueError(f"schema must be one of {', '.join(SCHEMAS)}, not {schema!r}")
        self._stream = stream
        self._lines: list[str] = []
        self._pending = 0
        self._next = 1
        # Twelve digits beyond the pitch: a hundred times finer than the 1e-9 pitch the faces are checked to.
        self._places = max(6, 12 + ceil(-log10(pitch)))
        self._styles: dict[Colour, int] = {}
        identifier, application, protocol, year = SCHEMAS[schema]
        self._raw(
            "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\n"
            f"FILE_NAME({quoted(name)},'{EPOCH}',(''),(''),{quoted(program)},{quoted(program)},'');\n"
            f"FILE_SCHEMA(('{identifier}'));\nENDSEC;\nDATA;\n"
        )
        context = self.add(f"APPLICATION_CONTEXT('{application}')")
        self.add(f"APPLICATION_PROTOCOL_DEFINITION('international standard','{protocol}',{year},#{context})")
        self._product_context = self.add(f"PRODUCT_CONTEXT('',#{context},'mechanical')")
        self._definition_context = self.add(
            f"PRODUCT_DEFINITION_CONTEXT('part definition',#{context},'design')"
        )
        length = self.add("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
        angle = self.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
        solid = self.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
        accuracy = self.add(
            f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-07),#{length},"
            "'distance_accuracy_value','confusion accuracy')"
        )
        self.space = self.add(
            f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#{accuracy}))"
            f"GLOBAL_UNIT_ASSIGNED_CONTEXT((#{length},#{angle},#{solid}))REPRESENTATION_CONTEXT('','3D'))"
        )
        self.parameter_space = self.add(
            "(GEOMETRIC_REPRESENTATION_CONTEXT(2)PARAMETRIC_REPRESENTATION_CONTEXT()REPRESENTATION_CONTEXT('','2D'))"
        )
        self.up = self.add("DIRECTION('',(0.,0.,1.))")
        self.across = self.add("DIRECTION('',(1.,0.,0.))")
        self.origin = self.placement(np.zeros(3))

    def add(self, entity: str) -> int:
        """Write an entity; its number."""
        number = self.reserve()
        self.put(number, entity)
        return number

    def reserve(self) -> int:
        """A number for an entity that is written later."""
        self._next += 1
        return self._next - 1

    def put(self, number: int, entity: str) -> None:
        """Write an entity under a reserved number."""
        self._raw(f"#{number}={entity};\n")

    def _raw(self, text: str) -> None:
        self._lines.append(text)
        self._pending += len(text)
        if self._pending > _FLUSH:
            self.flush()

    def flush(self) -> None:
        """Hand what is pending to the stream."""
        self._stream.write("".join(self._lines))
        self._lines.clear()
        self._pending = 0

    def close(self) -> None:
        """Write the end of the file."""
        self._raw("ENDSEC;\nEND-ISO-10303-21;\n")
        self.flush()

    def coordinate(self, value: float) -> str:
        """Write a length, rounded to 1e-12 of the pitch."""
        text = f"{value:.{self._places}f}".rstrip("0")
        return "0." if text == "-0." else text

    def coordinates(self, point: Sequence[float] | Floats) -> str:
        """Write (x, y, z)."""
        return f"({','.join([self.coordinate(value) for value in point])})"

    def placement(self, point: Floats) -> int:
        """An unturned placement at a point."""
        at = self.add(f"CARTESIAN_POINT('',{self.coordinates(point.tolist())})")
        return self.add(f"AXIS2_PLACEMENT_3D('',#{at},#{self.up},#{self.across})")

    # -- products ---------------------------------------------------------------------------------

    def product(self, name: str, items: Sequence[int], kind: str) -> tuple[int, int]:
        """A part with a shape representation of the given kind; (product definition, representation)."""
        product = self.add(f"PRODUCT({quoted(name)},{quoted(name)},'',(#{self._product_context}))")
        self.add(f"PRODUCT_RELATED_PRODUCT_CATEGORY('part',$,(#{product}))")
        formation = self.add(f"PRODUCT_DEFINITION_FORMATION('','',#{product})")
        definition = self.add(f"PRODUCT_DEFINITION('design','',#{formation},#{self._definition_context})")
        shape = self.add(f"PRODUCT_DEFINITION_SHAPE('','',#{definition})")
        listed = ",".join(f"#{item}" for item in items)
        representation = self.add(f"{kind}({quoted(name)},({listed}),#{self.space})")
        self.add(f"SHAPE_DEFINITION_REPRESENTATION(#{shape},#{representation})")
        return definition, representation

    def component(self, parent: tuple[int, int], child: tuple[int, int], name: str, placement: int) -> None:
        """Put an instance of `child` into the assembly `parent` at a placement listed in its representation."""
        use = self.add(
            f"NEXT_ASSEMBLY_USAGE_OCCURRENCE({quoted(name)},{quoted(name)},'',#{parent[0]},#{child[0]},$)"
        )
        shape = self.add(f"PRODUCT_DEFINITION_SHAPE('','',#{use})")
        move = self.add(f"ITEM_DEFINED_TRANSFORMATION('','',#{self.origin},#{placement})")
        relation = self.add(
            f"(REPRESENTATION_RELATIONSHIP('','',#{child[1]},#{parent[1]})"
            f"REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION(#{move})SHAPE_REPRESENTATION_RELATIONSHIP())"
        )
        self.add(f"CONTEXT_DEPENDENT_SHAPE_REPRESENTATION(#{relation},#{shape})")

    # -- colours ----------------------------------------------------------------------------------

    def style(self, colour: Colour) -> int:
        """The presentation style of a colour."""
        if colour not in self._styles:
            rgb = self.add(f"COLOUR_RGB('',{real(colour.red)},{real(colour.green)},{real(colour.blue)})")
            fill = self.add(f"FILL_AREA_STYLE_COLOUR('',#{rgb})")
            area = self.add(f"FILL_AREA_STYLE('',(#{fill}))")
            surface = self.add(f"SURFACE_STYLE_FILL_AREA(#{area})")
            side = self.add(f"SURFACE_SIDE_STYLE('',(#{surface}))")
            usage = self.add(f"SURFACE_STYLE_USAGE(.BOTH.,#{side})")
            self._styles[colour] = self.add(f"PRESENTATION_STYLE_ASSIGNMENT((#{usage}))")
        return self._styles[colour]

    def styled(self, item: int, colour: Colour, over: int | None = None) -> int:
        """Colour an item; `over`: the styled item whose colour this one overrides."""
        style = self.style(colour)
        if over is None:
            return self.add(f"STYLED_ITEM('',(#{style}),#{item})")
        return self.add(f"OVER_RIDING_STYLED_ITEM('',(#{style}),#{item},#{over})")

    def presentation(self, items: Sequence[int]) -> None:
        """List all styled items."""
        if items:
            listed = ",".join(f"#{item}" for item in items)
            self.add(f"MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',({listed}),#{self.space})")


class TextWriter:
    """Write shells as text; see `clacad.brep.shell.Writer`.

    Parameters
    ----------
    part : Part21
    curves : bool
        Write parameter curves.
    """

    def __init__(self, part: Part21, curves: bool) -> None:
        self.part, self._with_curves = part, curves
        self._vertices: list[int] = []
        self._points: list[int] = []
        self._edges: list[int] = []
        self._open: dict[int, tuple[int, int, Arc, Floats, list[str], list[bool]]] = {}
        self._surfaces: list[int] = []
        self.faces: list[int] = []
        self.roles: list[Role] = []
        self._recent: dict[str, int] = {}
        self._older: dict[str, int] = {}
        self._kept: dict[int, tuple[object, object]] = {}
        self._directions: dict[tuple[float, ...], int] = {}
        self._vectors: dict[tuple[float, ...], int] = {}

    @property
    def unfinished(self) -> int:
        """Number of edges that were not used by exactly two faces (0 for closed shells)."""
        return len(self._open)

    def vertex(self, point: Floats, tolerance: float) -> int:
        """Write a vertex (text carries no tolerance: readers find it from the geometry)."""
        at = self._point(self.part.coordinates(point.tolist()))
        self._points.append(at)
        self._vertices.append(self.part.add(f"VERTEX_POINT('',#{at})"))
        return len(self._vertices) - 1

    def edge(self, first: int, last: int, arc: Arc, offset: Floats, tolerance: float) -> int:
        """Reserve an edge; it is written when two faces have used it."""
        number = len(self._edges)
        self._edges.append(self.part.reserve())
        self._open[number] = (first, last, arc, offset, [], [])
        return number

    def surface(self, surface: Surface, offset: Floats) -> int:
        """Write a surface."""
        if isinstance(surface, Plane):
            number = self._plane(surface, offset)
        else:
            number = self._patch(surface, offset)
        self._surfaces.append(number)
        return len(self._surfaces) - 1

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
                uses.append(part.add(f"ORIENTED_EDGE('',*,*,#{self._edges[use.edge]},.{sense}.)"))
            ring = part.add(f"EDGE_LOOP('',({','.join(f'#{use}' for use in uses)}))")
            bounds.append(part.add(f"{'FACE_OUTER_BOUND' if n == 0 else 'FACE_BOUND'}('',#{ring},.T.)"))
            for use in loop:
                if use.edge >= 0:
                    self._use(use.edge, use.forward, use.parameters, surface)
        listed = ",".join(f"#{bound}" for bound in bounds)
        sense = "T" if same_sense else "F"
        self.faces.append(
            part.add(f"ADVANCED_FACE('{role}',({listed}),#{self._surfaces[surface]},.{sense}.)")
        )
        self.roles.append(role)
        return len(self.faces) - 1

    def solid(self, faces: Sequence[int], name: str) -> int:
        """Close faces to a solid; its entity number."""
        listed = ",".join([f"#{self.faces[face]}" for face in faces])
        shell = self.part.add(f"CLOSED_SHELL('',({listed}))")
        return self.part.add(f"MANIFOLD_SOLID_BREP({quoted(name)},#{shell})")

    # -- edges ------------------------------------------------------------------------------------

    def _use(self, edge: int, forward: bool, parameters: Arc | None, surface: int) -> None:
        if edge not in self._open:
            raise ValueError("an edge is used by more than two faces; please report the design")
        first, last, arc, offset, curves, senses = self._open[edge]
        senses.append(forward)
        if parameters is not None and self._with_curves:
            shared = self._shared(parameters)
            number = self.part.add(f"PCURVE('',#{self._surfaces[surface]},#{shared})")
            curves.append(f"#{number}")
        if len(senses) == 2:
            if senses[0] == senses[1]:
                raise ValueError("an edge runs the same way in both its faces; please report the design")
            del self._open[edge]
            self._finish(edge, first, last, arc, offset, curves)

    def _finish(self, edge: int, first: int, last: int, arc: Arc, offset: Floats, curves: list[str]) -> None:
        part = self.part
        curve = (
            self._straight(first, arc)
            if arc.straight and not curves
            else self._curve(first, last, arc, offset)
        )
        if curves:
            curve = part.add(f"SURFACE_CURVE('',#{curve},({','.join(curves)}),.PCURVE_S1.)")
        part.put(
            self._edges[edge], f"EDGE_CURVE('',#{self._vertices[first]},#{self._vertices[last]},#{curve},.T.)"
        )

    def _straight(self, first: int, arc: Arc) -> int:
        way = arc.poles[1] - arc.poles[0]
        unit = tuple((way / np.linalg.norm(way)).tolist())
        if unit not in self._vectors:
            self._vectors[unit] = self.part.add(f"VECTOR('',#{self._direction(unit)},1.)")
        return self.part.add(f"LINE('',#{self._points[first]},#{self._vectors[unit]})")

    def _curve(self, first: int, last: int, arc: Arc, offset: Floats) -> int:
        inner = (arc.poles[1:-1] + offset).tolist()
        coordinates = self.part.coordinates
        points = [self._points[first], *(self._point(coordinates(p)) for p in inner), self._points[last]]
        before, after = self._template(arc)
        return self.part.add(f"{before}{','.join([f'#{p}' for p in points])}{after}")

    def _template(self, arc: Arc) -> tuple[str, str]:
        """Everything but the poles of a curve, the same for all instances of its class."""
        found = self._kept.get(id(arc))
        if found is None:
            found = self._kept[id(arc)] = (arc, _curve_text(arc.weights))
        text = found[1]
        assert isinstance(text, tuple)
        return text

    def _shared(self, parameters: Arc) -> int:
        """The representation of a parameter curve, written once for all instances of its class."""
        found = self._kept.get(id(parameters))
        if found is None:
            part = self.part
            points = [
                part.add(f"CARTESIAN_POINT('',({real(u)},{real(v)}))") for u, v in parameters.poles.tolist()
            ]
            before, after = _curve_text(parameters.weights)
            curve = part.add(f"{before}{','.join(f'#{p}' for p in points)}{after}")
            number = part.add(f"DEFINITIONAL_REPRESENTATION('',(#{curve}),#{part.parameter_space})")
            found = self._kept[id(parameters)] = (parameters, number)
        number_found = found[1]
        assert isinstance(number_found, int)
        return number_found

    # -- surfaces and points ----------------------------------------------------------------------

    def _plane(self, plane: Plane, offset: Floats) -> int:
        part = self.part
        at = self._point(part.coordinates((plane.origin + offset).tolist()))
        normal, across = (self._direction(tuple(way.tolist())) for way in (plane.normal, plane.across))
        place = part.add(f"AXIS2_PLACEMENT_3D('',#{at},#{normal},#{across})")
        return part.add(f"PLANE('',#{place})")

    def _patch(self, patch: Patch, offset: Floats) -> int:
        part = self.part
        m, n = patch.weights.shape
        found = self._kept.get(id(patch))
        if found is None:
            found = self._kept[id(patch)] = (patch, _patch_text(patch.weights))
        text = found[1]
        assert isinstance(text, tuple)
        poles = (patch.poles.reshape(-1, 3) + offset).tolist()
        ids = [f"#{self._point(part.coordinates(pole))}" for pole in poles]
        rows = ",".join([f"({','.join(ids[i * n : (i + 1) * n])})" for i in range(m)])
        return part.add(f"{text[0]}{rows}{text[1]}")

    def _direction(self, way: tuple[float, ...]) -> int:
        if way not in self._directions:
            self._directions[way] = self.part.add(f"DIRECTION('',({','.join(real(value) for value in way)}))")
        return self._directions[way]

    def _point(self, text: str) -> int:
        """A point; equal points written not long ago are written once."""
        number = self._recent.get(text) or self._older.get(text)
        if number is None:
            number = self.part.add(f"CARTESIAN_POINT('',{text})")
            self._recent[text] = number
            if len(self._recent) > _POINTS_KEPT:
                self._older, self._recent = self._recent, {}
        return number


def _knots(degree: int) -> tuple[str, str]:
    return f"({degree + 1},{degree + 1})", "(0.,1.)"


def _curve_text(weights: Floats) -> tuple[str, str]:
    degree = len(weights) - 1
    many, knots = _knots(degree)
    if np.ptp(weights) == 0.0:
        return (
            f"B_SPLINE_CURVE_WITH_KNOTS('',{degree},(",
            f"),.UNSPECIFIED.,.F.,.F.,{many},{knots},.UNSPECIFIED.)",
        )
    listed = ",".join(real(weight) for weight in weights)
    return (
        f"(BOUNDED_CURVE()B_SPLINE_CURVE({degree},(",
        f"),.UNSPECIFIED.,.F.,.F.)B_SPLINE_CURVE_WITH_KNOTS({many},{knots},.UNSPECIFIED.)CURVE()"
        f"GEOMETRIC_REPRESENTATION_ITEM()RATIONAL_B_SPLINE_CURVE(({listed}))REPRESENTATION_ITEM(''))",
    )


def _patch_text(weights: Floats) -> tuple[str, str]:
    m, n = weights.shape
    many_u, knots = _knots(m - 1)
    many_v, _ = _knots(n - 1)
    if np.ptp(weights) == 0.0:
        return (
            f"B_SPLINE_SURFACE_WITH_KNOTS('',{m - 1},{n - 1},(",
            f"),.UNSPECIFIED.,.F.,.F.,.F.,{many_u},{many_v},{knots},{knots},.UNSPECIFIED.)",
        )
    listed = ",".join(f"({','.join(real(weight) for weight in row)})" for row in weights)
    return (
        f"(BOUNDED_SURFACE()B_SPLINE_SURFACE({m - 1},{n - 1},(",
        f"),.UNSPECIFIED.,.F.,.F.,.F.)B_SPLINE_SURFACE_WITH_KNOTS({many_u},{many_v},{knots},{knots},.UNSPECIFIED.)"
        f"GEOMETRIC_REPRESENTATION_ITEM()RATIONAL_B_SPLINE_SURFACE(({listed}))REPRESENTATION_ITEM('')SURFACE())",
    )
