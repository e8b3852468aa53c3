"""Scan a STEP file's own text: is it whole, are its shells closed, do its lens patches lie on the design?

No CAD kernel and none of the writer's code: a second opinion that also reads files far too large for a kernel.
Lengths in mm.
"""

from __future__ import annotations

import os
import re
from array import array
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from clacad.export.errors import UnreadableFile

Floats = NDArray[np.float64]

# a doubled quote inside a string reads as the end of one and the beginning of the next; nothing is tried twice
_STATEMENT = re.compile(r"((?:'[^']*+'|[^';]++)*+);")
_ENTITY = re.compile(r"\s*#(\d+)\s*=\s*\(?\s*([A-Z0-9_]+)")
_REFERENCE = re.compile(r"#(\d+)")
_STRING = re.compile(r"'((?:[^']|'')*)'")
_NUMBER = re.compile(r"[-+]?\d+\.\d*(?:E[-+]?\d+)?")
_CHUNK = 1 << 22
LONGEST = 1 << 28
"""Characters of one statement; a shell of ten million faces has fewer."""


@dataclass
class Scan:
    """What the text of a STEP file says.

    Attributes
    ----------
    schema, name : str
    millimetres : bool
        Whether the file's lengths are millimetres.
    entities : number of entities of every type
    names : names of products and solids
    colours : (red, green, blue) of every colour, sRGB
    solids, faces : counted once per instance in the assembly
    dangling : number of references to entities that are not there
    open_edges : number of edges not used once in each direction
    points : dict-like arrays of all 3-D points
    patches : (pole numbers (m, n), weights (m, n), front) of the surface of every face named as a curved one
    """

    schema: str = ""
    name: str = ""
    millimetres: bool = False
    entities: Counter[str] = field(default_factory=Counter)
    names: list[str] = field(default_factory=list)
    colours: list[tuple[float, ...]] = field(default_factory=list)
    solids: int = 0
    faces: int = 0
    dangling: int = 0
    open_edges: int = 0
    point_ids: array[int] = field(default_factory=lambda: array("q"))
    point_values: array[float] = field(default_factory=lambda: array("d"))
    patches: dict[int, tuple[list[int], tuple[int, int], list[float]]] = field(default_factory=dict)
    fronts: dict[int, bool] = field(default_factory=dict)


def statements(path: str | os.PathLike[str]) -> Iterator[str]:
    """The statements of a Part 21 file, without their semicolons; memory is that of a few megabytes.

    Raises
    ------
    UnreadableFile
        The file is no Part 21 file, or ends before its last statement.
    """
    rest, first = "", True
    with open(path, encoding="latin-1") as stream:
        while block := stream.read(_CHUNK):
            if first and not block.lstrip().startswith("ISO-10303-21;"):
                raise UnreadableFile(
                    f"{os.fspath(path)}: is no STEP file (it does not start with ISO-10303-21)"
                )
            first = False
            rest += block
            end = 0
            while match := _STATEMENT.match(rest, end):
                yield match.group(1)
                end = match.end()
            rest = rest[end:]
            if len(rest) > LONGEST:
                raise UnreadableFile(f"{os.fspath(path)}: a statement of more than {LONGEST} characters")
    if first or rest.strip():
        raise UnreadableFile(f"{os.fspath(path)}: ends in the middle of a statement; the file is cut short")


class _Graph:
    """What the assembly structure and the shells need, collected while scanning."""

    def __init__(self) -> None:
        self.components: dict[int, list[int]] = {}
        self.shape_of: dict[int, int] = {}
        self.items: dict[int, list[int]] = {}
        self.represented: dict[int, list[int]] = {}
        self.shells: dict[int, int] = {}
        self.shell_faces: dict[int, int] = {}
        self.defined: set[int] = set()
        self.highest = 0
        self.used: Counter[int] = Counter()
        self.uses: dict[int, int] = {}
        self.turned: set[int] = set()


def scan_step(path: str | os.PathLike[str]) -> Scan:
    """Scan a STEP file.

    Raises
    ------
    UnreadableFile
        The file is no STEP file, is cut short, or holds no face.
    OSError
        The file cannot be read.
    """
    try:
        return _scanned(path)
    except UnreadableFile:
        raise
    except (RecursionError, ArithmeticError, ValueError, LookupError, MemoryError) as error:
        raise UnreadableFile(
            f"{os.fspath(path)}: its text makes no sense ({type(error).__name__})"
        ) from error


def _scanned(path: str | os.PathLike[str]) -> Scan:
    scan, graph = Scan(), _Graph()
    defined, referred = array("q"), array("q")
    last = ""
    for statement in statements(path):
        last = statement.strip()
        match = _ENTITY.match(statement)
        if match is None:
            _header(scan, last)
            continue
        number, kind = int(match.group(1)), match.group(2)
        body = statement[match.end() :]
        defined.append(number)
        scan.entities[kind] += 1
        references = [int(found) for found in _REFERENCE.findall(_STRING.sub("''", body))]
        referred.extend(references)
        _collect(scan, graph, number, kind, body, references)
    if last != "END-ISO-10303-21":
        raise UnreadableFile(f"{os.fspath(path)}: has no end statement; the file is cut short")
    if scan.entities["ADVANCED_FACE"] == 0:
        raise UnreadableFile(f"{os.fspath(path)}: holds no face")
    if graph.turned:
        _count_turned(path, graph)
    _finish(scan, graph, np.frombuffer(defined, dtype=np.int64), np.frombuffer(referred, dtype=np.int64))
    return scan


def _header(scan: Scan, statement: str) -> None:
    if statement.startswith("FILE_NAME"):
        scan.name = _STRING.findall(statement)[0]
    elif statement.startswith("FILE_SCHEMA"):
        scan.schema = _STRING.findall(statement)[0]


def _collect(scan: Scan, graph: _Graph, number: int, kind: str, body: str, references: list[int]) -> None:
    if kind == "CARTESIAN_POINT":
        values = [float(value) for value in _NUMBER.findall(body)]
        if len(values) == 3:
            scan.point_ids.append(number)
            scan.point_values.extend(values)
    elif kind == "ORIENTED_EDGE":
        _use(graph, references[0], ".T." in body)
    elif kind in ("FACE_BOUND", "FACE_OUTER_BOUND") and ".F." in body:
        graph.turned.add(references[0])
    elif kind == "ADVANCED_FACE":
        scan.fronts[references[-1]] = ".F." in body
    elif kind in ("BOUNDED_SURFACE", "B_SPLINE_SURFACE_WITH_KNOTS"):
        _surface(scan, number, body, references)
    elif kind == "LENGTH_UNIT":
        scan.millimetres = "SI_UNIT(.MILLI.,.METRE.)" in body.replace(" ", "")
    elif kind == "COLOUR_RGB":
        scan.colours.append(tuple(float(value) for value in _NUMBER.findall(body)))
    elif kind in ("PRODUCT", "MANIFOLD_SOLID_BREP"):
        scan.names.append(_STRING.findall(body)[0])
    _structure(graph, number, kind, references)


def _use(graph: _Graph, edge: int, forward: bool) -> None:
    """Count one use of an edge: 1 forward, 2 backward, 4 and more a second one the same way."""
    sense, uses = 1 if forward else 2, graph.uses.get(edge, 0)
    graph.uses[edge] = uses + (sense if not uses & sense else 4)


def _count_turned(path: str | os.PathLike[str], graph: _Graph) -> None:
    """Count the uses of edges again, those of loops that their face takes the other way round the other way.

    Loops may stand before or after their edges and bounds, so the text is read twice more; few writers need it.
    """
    turned: set[int] = set()
    for number, kind, body in _entities(path):
        if kind == "EDGE_LOOP" and number in graph.turned:
            turned.update(int(found) for found in _REFERENCE.findall(body))
    graph.uses.clear()
    for number, kind, body in _entities(path):
        if kind == "ORIENTED_EDGE":
            _use(graph, int(_REFERENCE.findall(body)[0]), (".T." in body) != (number in turned))


def _entities(path: str | os.PathLike[str]) -> Iterator[tuple[int, str, str]]:
    for statement in statements(path):
        match = _ENTITY.match(statement)
        if match is not None:
            yield int(match.group(1)), match.group(2), _STRING.sub("''", statement[match.end() :])


def _structure(graph: _Graph, number: int, kind: str, references: list[int]) -> None:
    if kind == "NEXT_ASSEMBLY_USAGE_OCCURRENCE":
        graph.components.setdefault(references[0], []).append(references[1])
    elif kind == "PRODUCT_DEFINITION_SHAPE":
        graph.shape_of[number] = references[0]
    elif kind == "SHAPE_DEFINITION_REPRESENTATION":
        graph.represented.setdefault(references[0], []).append(references[1])
    elif kind in ("ADVANCED_BREP_SHAPE_REPRESENTATION", "SHAPE_REPRESENTATION"):
        graph.items[number] = references
    elif kind == "MANIFOLD_SOLID_BREP":
        graph.shells[number] = references[0]
    elif kind == "CLOSED_SHELL":
        graph.shell_faces[number] = len(references)


def _surface(scan: Scan, number: int, body: str, references: list[int]) -> None:
    degrees = re.search(r"B_SPLINE_SURFACE\(\s*(\d+)\s*,\s*(\d+)", body) or re.search(
        r"\(\s*''\s*,(\d+),(\d+)", body
    )
    if degrees is None:
        return
    m, n = int(degrees.group(1)) + 1, int(degrees.group(2)) + 1
    if min(m, n) < 3 or len(references) != m * n:
        return  # a wall, or a surface of more than one span that this scan does not evaluate
    rational = body.find("RATIONAL_B_SPLINE_SURFACE")
    weights = (
        [float(value) for value in _NUMBER.findall(body[rational:])] if rational >= 0 else [1.0] * (m * n)
    )
    scan.patches[number] = (references, (m, n), weights)


def _finish(scan: Scan, graph: _Graph, defined: NDArray[np.int64], referred: NDArray[np.int64]) -> None:
    # not a table of all numbers: a stranger's file may name one of 10^18
    scan.dangling = int(np.count_nonzero(~np.isin(referred, np.unique(defined))))
    scan.open_edges = sum(uses != 3 for uses in graph.uses.values())
    roots = set(graph.shape_of.values()) - {
        child for children in graph.components.values() for child in children
    }
    held: dict[int, tuple[int, int]] = {}
    for shape, representations in graph.represented.items():
        solids = [s for r in representations for s in graph.items.get(r, []) if s in graph.shells]
        faces = sum(graph.shell_faces.get(graph.shells[s], 0) for s in solids)
        held[graph.shape_of.get(shape, -1)] = (len(solids), faces)
    counted: dict[int, tuple[int, int]] = {}

    def count(definition: int) -> tuple[int, int]:
        if definition not in counted:
            counted[definition] = held.get(definition, (0, 0))
            inside = [count(child) for child in graph.components.get(definition, [])]
            own = held.get(definition, (0, 0))
            counted[definition] = (own[0] + sum(c[0] for c in inside), own[1] + sum(c[1] for c in inside))
        return counted[definition]

    definitions = {graph.shape_of[shape] for shape in graph.represented if shape in graph.shape_of}
    totals = [count(definition) for definition in roots & definitions]
    scan.solids, scan.faces = sum(t[0] for t in totals), sum(t[1] for t in totals)


def patch_points(scan: Scan, per_side: int = 3) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Points of the middle of every curved patch, evaluated from the text.

    Parameters
    ----------
    scan : Scan
    per_side : int
        Points along each parameter, from 0.3 to 0.7.

    Returns
    -------
    points : (k, 3), mm
    normals : (k, 3)
        Unit, towards +z.
    front : (k,) bool
        Whether the patch's face looks towards −z.
    """
    ids = np.frombuffer(scan.point_ids, dtype=np.int64)
    values = np.frombuffer(scan.point_values, dtype=np.float64).reshape(-1, 3)
    row = np.full(int(ids.max()) + 1, -1)
    row[ids] = np.arange(len(ids))
    shapes: dict[tuple[int, int], list[int]] = {}
    for number, (_, shape, _) in scan.patches.items():
        if number in scan.fronts:
            shapes.setdefault(shape, []).append(number)
    points, normals, fronts = [np.empty((0, 3))], [np.empty((0, 3))], [np.empty(0, dtype=bool)]
    t = np.linspace(0.3, 0.7, per_side)
    for (m, n), numbers in shapes.items():
        poles = values[row[np.array([scan.patches[number][0] for number in numbers])]].reshape(-1, m, n, 3)
        weights = np.array([scan.patches[number][2] for number in numbers]).reshape(-1, m, n)
        place, normal = _evaluate(poles, weights, t)
        points.append(place)
        normals.append(normal)
        fronts.append(np.repeat([scan.fronts[number] for number in numbers], per_side * per_side))
    return np.concatenate(points), np.concatenate(normals), np.concatenate(fronts)


def _evaluate(poles: Floats, weights: Floats, t: Floats) -> tuple[Floats, Floats]:
    """Points and normals of rational Bézier patches (k, m, n) at the grid t × t, by de Casteljau."""
    homogeneous = np.concatenate([poles * weights[..., None], weights[..., None]], axis=-1)
    points, normals = [], []
    for u in t:
        rows, rows_u = _casteljau(np.moveaxis(homogeneous, 1, 0), u)
        for v in t:
            place, place_v = _casteljau(np.moveaxis(rows, 1, 0), v)
            place_u, _ = _casteljau(np.moveaxis(rows_u, 1, 0), v)
            w = place[:, 3:]
            point = place[:, :3] / w
            along = (place_u[:, :3] - point * place_u[:, 3:]) / w
            across = (place_v[:, :3] - point * place_v[:, 3:]) / w
            normal = np.cross(along, across)
            normal *= np.sign(normal[:, 2:]) / np.linalg.norm(normal, axis=1, keepdims=True)
            points.append(point)
            normals.append(normal)
    return np.stack(points, axis=1).reshape(-1, 3), np.stack(normals, axis=1).reshape(-1, 3)


def _casteljau(control: Floats, t: float) -> tuple[Floats, Floats]:
    """Value and derivative of Bézier curves whose control points lie along axis 0."""
    degree = len(control) - 1
    while len(control) > 2:
        control = (1.0 - t) * control[:-1] + t * control[1:]
    return (1.0 - t) * control[0] + t * control[1], degree * (control[1] - control[0])
