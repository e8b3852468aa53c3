"""A `Writer` that makes OCCT (OCP) solids, and OCCT's own checks. Lengths in mm."""

from __future__ import annotations

import gc
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from math import fsum
from typing import Any

import numpy as np
from OCP.Bnd import Bnd_Box
from OCP.BRep import BRep_Builder
from OCP.BRepAdaptor import BRepAdaptor_Curve2d, BRepAdaptor_Surface
from OCP.BRepBndLib import BRepBndLib
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepGProp import BRepGProp
from OCP.collections import (
    Array1_double,
    Array1_gp_Pnt,
    Array1_gp_Pnt2d,
    Array1_int,
    Array2_double,
    Array2_gp_Pnt,
)
from OCP.Geom import Geom_BSplineCurve, Geom_BSplineSurface, Geom_Line, Geom_Plane
from OCP.Geom2d import Geom2d_BSplineCurve
from OCP.GeomAbs import GeomAbs_BSplineCurve, GeomAbs_BSplineSurface
from OCP.gp import gp_Ax3, gp_Dir, gp_Pln, gp_Pnt, gp_Pnt2d, gp_Trsf, gp_Vec
from OCP.GProp import GProp_GProps
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_FORWARD, TopAbs_REVERSED
from OCP.TopExp import TopExp_Explorer
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import (
    TopoDS,
    TopoDS_Edge,
    TopoDS_Face,
    TopoDS_Shell,
    TopoDS_Solid,
    TopoDS_Vertex,
    TopoDS_Wire,
)

from clacad.base.types import Floats
from clacad.solid.edge_classes import Plane, Surface
from clacad.solid.rational_conics import Arc, RationalPatch
from clacad.solid.shells import Loop, LoopEdge, Role

PARAMETRIC = 1e-7
"""Tolerance written with parameter curves (mm): they are exact, but OCCT requires a number."""


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Switch garbage collection off: millions of wrapped objects contain no cycles."""
    was = gc.isenabled()
    gc.disable()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        if was:
            gc.enable()


class OccWriter:
    """Make OCCT topology; see `clacad.solid.shells.Writer`."""

    def __init__(self) -> None:
        self._build = BRep_Builder()
        self.vertices: list[TopoDS_Vertex] = []
        self.edges: list[TopoDS_Edge] = []
        self.surfaces: list[Any] = []
        self.faces: list[Any] = []
        self.roles: list[Role] = []
        self._ends: list[float] = []
        self._prototypes: dict[tuple[int, float], tuple[object, Any]] = {}

    def vertex(self, point: Floats, tolerance: float) -> int:
        """Make a vertex."""
        made = TopoDS_Vertex()
        self._build.MakeVertex(made, gp_Pnt(*map(float, point)), tolerance)
        self.vertices.append(made)
        return len(self.vertices) - 1

    def edge(self, first: int, last: int, arc: Arc, offset: Floats, tolerance: float) -> int:
        """Make an edge: a Bézier curve on 0 … 1, or a line on 0 … its length, which selections can find."""
        made = TopoDS_Edge()
        end = float(np.linalg.norm(arc.poles[1] - arc.poles[0])) if arc.straight else 1.0
        curve = self._prototype(arc, _curve).Translated(gp_Vec(*map(float, offset)))
        self._build.MakeEdge(made, curve, tolerance)
        self._build.Add(made, self.vertices[first].Oriented(TopAbs_FORWARD))
        self._build.Add(made, self.vertices[last].Oriented(TopAbs_REVERSED))
        self._build.Range(made, 0.0, end)
        for vertex in (first, last):
            self._build.UpdateVertex(self.vertices[vertex], tolerance)
        self.edges.append(made)
        self._ends.append(end)
        return len(self.edges) - 1

    def surface(self, surface: Surface, offset: Floats) -> int:
        """Make a surface."""
        make = _plane if isinstance(surface, Plane) else _patch
        self.surfaces.append(self._prototype(surface, make).Translated(gp_Vec(*map(float, offset))))
        return len(self.surfaces) - 1

    def face(self, surface: int, same_sense: bool, loops: list[Loop], role: Role) -> int:
        """Make a face."""
        face = TopoDS_Face()
        self._build.MakeFace(face, self.surfaces[surface], PARAMETRIC)
        for loop in loops:
            wire = TopoDS_Wire()
            self._build.MakeWire(wire)
            for use in loop if same_sense else loop[::-1]:
                self._build.Add(wire, self._used(use, use.forward == same_sense, surface))
            wire.Closed(True)
            self._build.Add(face, wire)
        self.faces.append(face if same_sense else face.Reversed())
        self.roles.append(role)
        return len(self.faces) - 1

    def _used(self, use: LoopEdge, forward: bool, surface: int) -> Any:
        if use.edge < 0:
            return self._degenerate(use, forward, surface)
        edge = self.edges[use.edge]
        if use.parameters is not None:
            curve = self._prototype(use.parameters, _curve_2d, self._ends[use.edge])
            self._build.UpdateEdge(edge, curve, self.surfaces[surface], TopLoc_Location(), PARAMETRIC)
        return edge.Oriented(TopAbs_FORWARD if forward else TopAbs_REVERSED)

    def _degenerate(self, use: LoopEdge, forward: bool, surface: int) -> Any:
        assert use.parameters is not None
        edge = TopoDS_Edge()
        self._build.MakeEdge(edge)
        curve = self._prototype(use.parameters, _curve_2d)
        self._build.UpdateEdge(edge, curve, self.surfaces[surface], TopLoc_Location(), PARAMETRIC)
        vertex = self.vertices[use.vertex]
        self._build.Add(edge, vertex.Oriented(TopAbs_FORWARD))
        self._build.Add(edge, vertex.Oriented(TopAbs_REVERSED))
        self._build.Range(edge, 0.0, 1.0)
        self._build.Degenerated(edge, True)
        return edge.Oriented(TopAbs_FORWARD if forward else TopAbs_REVERSED)

    def _prototype(self, key: object, make: Any, end: float = 1.0) -> Any:
        """OCCT's object for a class of curves or surfaces, created once.

        `end`: last parameter of a 2-D curve.
        """
        found = self._prototypes.get((id(key), end))
        if found is None:
            made = make(key) if end == 1.0 else make(key, end)
            found = self._prototypes[id(key), end] = (
                key,
                made,
            )  # the key is kept alive: ids are not used again
        return found[1]

    def solid(self, faces: list[int]) -> TopoDS_Solid:
        """Close faces to a solid."""
        shell, solid = TopoDS_Shell(), TopoDS_Solid()
        self._build.MakeShell(shell)
        for face in faces:
            self._build.Add(shell, self.faces[face])
        shell.Closed(True)
        self._build.MakeSolid(solid)
        self._build.Add(solid, shell)
        return solid


def _knots(degree: int, end: float = 1.0) -> tuple[Any, Any]:
    knots, multiplicities = Array1_double(1, 2), Array1_int(1, 2)
    knots.SetValue(1, 0.0)
    knots.SetValue(2, end)
    multiplicities.SetValue(1, degree + 1)
    multiplicities.SetValue(2, degree + 1)
    return knots, multiplicities


def _curve(arc: Arc) -> Any:
    if arc.straight:
        way = arc.poles[1] - arc.poles[0]
        return Geom_Line(gp_Pnt(*map(float, arc.poles[0])), gp_Dir(*map(float, way)))
    n = len(arc.poles)
    poles, weights = Array1_gp_Pnt(1, n), Array1_double(1, n)
    for i in range(n):
        poles.SetValue(i + 1, gp_Pnt(*map(float, arc.poles[i])))
        weights.SetValue(i + 1, float(arc.weights[i]))
    knots, multiplicities = _knots(n - 1)
    if np.ptp(arc.weights) == 0.0:
        return Geom_BSplineCurve(poles, knots, multiplicities, n - 1)
    return Geom_BSplineCurve(poles, weights, knots, multiplicities, n - 1)


def _curve_2d(arc: Arc, end: float = 1.0) -> Any:
    n = len(arc.poles)
    poles, weights = Array1_gp_Pnt2d(1, n), Array1_double(1, n)
    for i in range(n):
        poles.SetValue(i + 1, gp_Pnt2d(*map(float, arc.poles[i])))
        weights.SetValue(i + 1, float(arc.weights[i]))
    knots, multiplicities = _knots(n - 1, end)
    return Geom2d_BSplineCurve(poles, weights, knots, multiplicities, n - 1)


def _patch(patch: RationalPatch) -> Any:
    m, n = patch.weights.shape
    poles, weights = Array2_gp_Pnt(1, m, 1, n), Array2_double(1, m, 1, n)
    for i in range(m):
        for j in range(n):
            poles.SetValue(i + 1, j + 1, gp_Pnt(*map(float, patch.poles[i, j])))
            weights.SetValue(i + 1, j + 1, float(patch.weights[i, j]))
    ku, mu = _knots(m - 1)
    kv, mv = _knots(n - 1)
    return Geom_BSplineSurface(poles, weights, ku, kv, mu, mv, m - 1, n - 1)


def _plane(plane: Plane) -> Any:
    origin = gp_Pnt(*map(float, plane.origin))
    return Geom_Plane(gp_Ax3(origin, gp_Dir(*map(float, plane.normal)), gp_Dir(*map(float, plane.across))))


def explored(shape: Any, kind: Any) -> list[Any]:
    """Every subshape of a kind, as often as it is used."""
    explorer, found = TopExp_Explorer(shape, kind), []
    while explorer.More():
        found.append(TopoDS.Face(explorer.Current()) if kind == TopAbs_FACE else explorer.Current())
        explorer.Next()
    return found


def is_valid(shape: Any) -> bool:
    """Whether a shape is consistent for OCCT (which cannot detect a wrong radius or a bow-tie wall)."""
    return bool(BRepCheck_Analyzer(shape).IsValid())


QUADRATURE = 1e-12
"""Relative error per face requested of OCCT's adaptive quadrature of an area."""

SUFFICIENT = 1e-9
"""Relative error per face requested of its Gauss-Kronrod quadrature of a volume; that of a sheet: 1e-10."""

ROUNDED = 2e4
"""Relative errors of rounded heights below which that quadrature, which then does not end, need not
err: far from the origin (1 km off, heights of .01 mm have lost 8 digits)."""


SPLIT = 4096.0
"""Spacings of doubles by which x and y may differ in faces that are alike: what rounding leaves of a move."""


def volume_and_area(shape: Any) -> tuple[float, float]:
    """Volume over a plane below by OCCT's Gauss-Kronrod quadrature, mm³, and area, mm².

    Faces that are alike are integrated once. Walls along z have no part in the volume: the quadrature of
    nothing but rounding errors does not end. The adaptive one errs, without reporting that, by 5e-9 over
    steep conics and walls that end in a point, and by 1e-5 where many splines bound a plane. The shape is
    moved down to the plane z = 0: the sign with which OCCT takes the height of another plane is wrong, which
    costs digits.
    """
    corners = np.array(box(shape))
    (low, high), reach = corners[:, 2], float(np.spacing(np.abs(corners).max()))
    ground, down = gp_Pln(gp_Pnt(0.0, 0.0, 0.0), gp_Dir(0.0, 0.0, 1.0)), gp_Trsf()
    down.SetTranslation(gp_Vec(0.0, 0.0, -float(low)))
    relative = max(SUFFICIENT, ROUNDED * float(np.spacing(max(-low, high))) / float(high - low))
    volumes, areas = [], []
    for face, many in _alike(shape, SPLIT * reach):
        areas.append(many * surface_area(face))
        if not _along_z(BRepAdaptor_Surface(face)):
            properties = GProp_GProps()
            moved = TopoDS.Face(face.Moved(TopLoc_Location(down)))
            BRepGProp.VolumePropertiesGK_s(moved, properties, ground, relative)
            volumes.append(many * properties.Mass())
    return fsum(volumes), fsum(areas)


def _alike(shape: Any, grain: float) -> list[tuple[Any, int]]:
    """Faces of a shape, each once with the number of those that differ from it by a move across z alone."""
    faces, first = explored(shape, TopAbs_FACE), dict[Any, int]()
    number = [first.setdefault(_form(face, grain) or n, n) for n, face in enumerate(faces)]
    return [(faces[n], many) for n, many in Counter(number).items()]


def _form(face: Any, grain: float) -> tuple[Any, ...] | None:
    """What faces that are alike have in common: poles, x and y from the first, in grains (mm), weights, and
    parameter curves. None for a face that is no Bézier patch trimmed by Bézier curves.
    """
    adapted = BRepAdaptor_Surface(face)
    if adapted.GetType() != GeomAbs_BSplineSurface:
        return None
    patch, curves = adapted.BSpline(), []
    if (patch.NbUKnots(), patch.NbVKnots()) != (2, 2):
        return None
    for edge in explored(face, TopAbs_EDGE):
        trim = BRepAdaptor_Curve2d(TopoDS.Edge(edge), face)
        if trim.GetType() != GeomAbs_BSplineCurve or (curve := trim.BSpline()).NbKnots() != 2:
            return None
        poles = [(curve.Pole(n), curve.Weight(n)) for n in range(1, curve.NbPoles() + 1)]
        ends = trim.FirstParameter(), trim.LastParameter(), curve.Knot(1), curve.Knot(2)
        curves.append((edge.Orientation(), ends, tuple((p.X(), p.Y(), weight) for p, weight in poles)))
    places = list(product(range(1, patch.NbUPoles() + 1), range(1, patch.NbVPoles() + 1)))
    points = [patch.Pole(*at) for at in places]
    x, y = points[0].X(), points[0].Y()
    across = tuple((round((p.X() - x) / grain), round((p.Y() - y) / grain), p.Z()) for p in points)
    knots = tuple(knot(n) for knot in (patch.UKnot, patch.VKnot) for n in (1, 2))
    return (
        face.Orientation(),
        places[-1],
        across,
        knots,
        tuple(patch.Weight(*at) for at in places),
        tuple(curves),
    )


def _along_z(surface: Any) -> bool:
    """Whether the normals of a face at 3 × 3 places are across z, up to rounding errors."""
    u, v = (
        np.linspace(first, last, 5)[1:4].tolist()
        for first, last in (
            (surface.FirstUParameter(), surface.LastUParameter()),
            (surface.FirstVParameter(), surface.LastVParameter()),
        )
    )
    point, along_u, along_v = gp_Pnt(), gp_Vec(), gp_Vec()
    for place in product(u, v):
        surface.D1(*place, point, along_u, along_v)
        normal = along_u.Crossed(along_v)
        if abs(normal.Z()) > 1e-9 * normal.Magnitude():
            return False
    return True


def box(shape: Any) -> list[list[float]]:
    """Lowest and highest corner of a shape."""
    found = Bnd_Box()
    BRepBndLib.Add_s(shape, found, False)
    if found.IsVoid():
        return [[np.inf] * 3, [-np.inf] * 3]
    found.SetGap(0.0)
    low, high = found.CornerMin(), found.CornerMax()
    return [[low.X(), low.Y(), low.Z()], [high.X(), high.Y(), high.Z()]]


def surface_area(shape: Any) -> float:
    """Surface area by OCCT's adaptive quadrature, mm²."""
    properties = GProp_GProps()
    BRepGProp.SurfaceProperties_s(shape, properties, QUADRATURE)
    return float(properties.Mass())
