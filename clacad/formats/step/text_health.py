"""Scan of a STEP file's own text: whether it is complete, its shells are closed, and its lens patches lie on
the design.

No CAD kernel and none of the writer's code is used: an independent check that also reads files far too large
for OCC. Lengths in mm for a file in any unit; every part in all its placements.
"""

from __future__ import annotations

import os
import re
from array import array
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.formats.placements import UNPLACED, applied
from clacad.formats.step.assembly_text import NUMBER, SHELLS, Assembly, Lookup, PlacedPart, Vectors
from clacad.formats.step.lens_placements import LensPoints
from clacad.storage.errors import OverBudget, UnreadableFile
from clacad.storage.reading import Spending

# a doubled quote inside a string is read as the end of one and the start of the next; the pattern never
# backtracks
_STATEMENT = re.compile(r"((?:'[^']*+'|[^';]++)*+);")
_ENTITY = re.compile(r"\s*#(\d+)\s*=\s*\(?\s*([A-Z0-9_]+)")
_REFERENCE = re.compile(r"#(\d+)")
_STRING = re.compile(r"'((?:[^']|'')*)'")
PATCHES = ("BOUNDED_SURFACE", "B_SPLINE_SURFACE_WITH_KNOTS", "B_SPLINE_SURFACE", "RATIONAL_B_SPLINE_SURFACE")
BOUNDS = ("FACE_BOUND", "FACE_OUTER_BOUND")
FREQUENT = (
    "CARTESIAN_POINT",
    "ORIENTED_EDGE",
    "B_SPLINE_CURVE_WITH_KNOTS",
    "EDGE_CURVE",
    "PCURVE",
    "SURFACE_CURVE",
    "VERTEX_POINT",
    "EDGE_LOOP",
    "ADVANCED_FACE",
    *BOUNDS,
    "DEFINITIONAL_REPRESENTATION",
    "LINE",
    "VECTOR",
    "CIRCLE",
    "SEAM_CURVE",
    "STYLED_ITEM",
)
"""Types that a large file has many of, of which little is kept; points are the first."""
GEOMETRY = frozenset(
    (
        *FREQUENT,
        *SHELLS,
        "PLANE",
        "BOUNDED_CURVE",
        "AXIS2_PLACEMENT_2D",
        "BOUNDED_SURFACE",
        "B_SPLINE_SURFACE_WITH_KNOTS",
        "OVER_RIDING_STYLED_ITEM",
        "COLOUR_RGB",
    )
)
"""Frequent entities that no assembly consists of."""
LARGE = 8_000_000
"""Bytes from which a file's frequent entities are read by compiled code."""
_CHUNK = 1 << 22
BLOCK = 1 << 12
"""Patches that are evaluated at a time."""
LONGEST = 1 << 28
"""Longest statement, characters; a shell of ten million faces is shorter."""


@dataclass
class StepScan:
    """Content of the text of a STEP file.

    millimetres : Whether all lengths of the file are written in millimetres.
    units : Millimetres per unit of length, of every representation that states it.
    entities : number of entities of every type
    names : names of products and solids
    colours : (red, green, blue) of every colour, sRGB
    solids, faces, shells : counted once per instance in the assembly
    dangling : number of references to entities that do not exist
    open_edges : number of edges not used once in each direction
    parts : Every solid and bare shell, with its placements.
    points : All 3-D points, in the file's unit.
    patches : (pole numbers, (m, n), weights (m, n)) of every surface curved both ways that is one Bézier
        patch
    uneven : number of surfaces curved both ways that have more than one span; they are not evaluated here
    face_ids, face_surfaces : number of every face, and of its surface
    reversed_faces : faces oriented against their surface's own normal
    shell_faces : faces of every shell
    planes : number of every plane, and of its placement, one after the other
    frames : (n, 4). Number, location, axis and reference direction of every placement.
    """

    schema: str = ""
    name: str = ""
    millimetres: bool = False
    units: tuple[float, ...] = ()
    entities: Counter[str] = field(default_factory=Counter)
    names: list[str] = field(default_factory=list)
    colours: list[tuple[float, ...]] = field(default_factory=list)
    solids: int = 0
    faces: int = 0
    shells: int = 0
    dangling: int = 0
    open_edges: int = 0
    parts: list[PlacedPart] = field(default_factory=list)
    points: Vectors = field(default_factory=Vectors)
    patches: dict[int, tuple[array[int], tuple[int, int], list[float]]] = field(default_factory=dict)
    uneven: int = 0
    face_ids: array[int] = field(default_factory=lambda: array("q"))
    face_surfaces: array[int] = field(default_factory=lambda: array("q"))
    reversed_faces: set[int] = field(default_factory=set)
    shell_faces: dict[int, array[int]] = field(default_factory=dict)
    planes: array[int] = field(default_factory=lambda: array("q"))
    frames: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 4), dtype=np.int64))

    @cached_property
    def groups(self) -> list[Patches]:
        """Every lens patch of every part that has placements, grouped by degree."""
        return _patches_of(self)


def statements(path: str | os.PathLike[str]) -> Iterator[str]:
    """The statements of a Part 21 file, without their semicolons; memory is that of a few megabytes.

    Raises UnreadableFile: The file is no Part 21 file, or ends before its last statement.
    Raises OverBudget: More bytes, statements or seconds than are read.
    """

    def one_by_one(text: bytes) -> tuple[list[str], int, int]:
        words, found, end = text.decode("latin-1"), [], 0
        while match := _STATEMENT.match(words, end):
            found.append(match.group(1))
            end = match.end()
        return found, len(found), end

    return _cut_up(path, one_by_one)


def _cut_up(
    path: str | os.PathLike[str], cut: Callable[[bytes], tuple[list[str], int, int]]
) -> Iterator[str]:
    """Statements that `cut` returns of a text, with the count of all of them and where the last ends."""
    rest, first = b"", True
    spent = Spending("step-text", path)
    with open(path, "rb") as stream:
        # the block doubles with the remainder: a statement of many blocks is restarted a few times, not with
        # each block
        while block := stream.read(max(_CHUNK, len(rest))):
            spent.look(f"at statement {spent.items:,}")
            if first and not block.lstrip().startswith(b"ISO-10303-21;"):
                raise UnreadableFile(
                    f"{os.fspath(path)}: is no STEP file (it does not start with ISO-10303-21)"
                )
            first = False
            rest += block
            found, count, end = cut(rest)
            spent.count(count)
            yield from found
            rest = rest[end:]
            if len(rest) > LONGEST:
                raise UnreadableFile(f"{os.fspath(path)}: a statement of more than {LONGEST} characters")
    if first or rest.strip():
        raise UnreadableFile(f"{os.fspath(path)}: ends in the middle of a statement; the file is cut short")


@dataclass
class _Entities:
    """Entities and references of a text, and the uses of its edges.

    defined, referred : numbers of all entities, and all references
    edges, forward : number of every edge that is used, and whether in its own direction
    turned : loops that their face uses reversed
    """

    defined: array[int] = field(default_factory=lambda: array("q"))
    referred: array[int] = field(default_factory=lambda: array("q"))
    edges: array[int] = field(default_factory=lambda: array("q"))
    forward: array[int] = field(default_factory=lambda: array("b"))
    turned: set[int] = field(default_factory=set)

    def use(self, edge: int, forward: bool) -> None:
        """Record one use of an edge."""
        self.edges.append(edge)
        self.forward.append(forward)

    @property
    def open_edges(self) -> int:
        """Number of edges not used once in each direction."""
        _, edge, times = np.unique(
            np.frombuffer(self.edges, dtype=np.int64), return_inverse=True, return_counts=True
        )
        ahead = np.bincount(edge, np.frombuffer(self.forward, dtype=np.int8), len(times))
        return int(np.count_nonzero((times != 2) | (ahead != 1)))

    @property
    def dangling(self) -> int:
        """Number of references to entities that do not exist."""
        defined, referred = (np.frombuffer(one, dtype=np.int64) for one in (self.defined, self.referred))
        top = int(defined.max(initial=0))
        if top > 16 * len(defined):  # an untrusted file may name an entity of 10^18
            return int(np.count_nonzero(~np.isin(referred, np.unique(defined))))
        known = np.zeros(top + 2, dtype=np.bool_)
        known[defined] = True
        return int(np.count_nonzero(~known[np.minimum(referred, top + 1)]))


def scan_step(path: str | os.PathLike[str]) -> StepScan:
    """Scan a STEP file.

    Raises UnreadableFile: The file is no STEP file, is cut short, or holds no face.
    Raises OSError: The file cannot be read.
    """
    try:
        return _scanned(path)
    except UnreadableFile:
        raise
    except MemoryError as error:
        raise OverBudget(f"{os.fspath(path)}: its text is too large to be scanned here") from error
    except (RecursionError, ArithmeticError, ValueError, LookupError) as error:
        raise UnreadableFile(
            f"{os.fspath(path)}: its text makes no sense ({type(error).__name__})"
        ) from error


def _scanned(path: str | os.PathLike[str]) -> StepScan:
    """Scan the text of a file once."""
    scan, found, assembly = StepScan(), _Entities(), Assembly()
    last = ""
    for statement in _single(path, scan, found):
        last = statement.strip()
        match = _ENTITY.match(statement)
        if match is None:
            _header(scan, last)
            continue
        number, kind = int(match.group(1)), match.group(2)
        body = statement[match.end() :]
        bare = _STRING.sub("''", body) if "'" in body else body
        found.defined.append(number)
        scan.entities[kind] += 1
        references = [int(one) for one in _REFERENCE.findall(bare)]
        found.referred.extend(references)
        _collect(scan, found, number, kind, bare, references)
        if kind not in GEOMETRY:
            assembly.collect(number, kind, kind + bare, references, _title(scan, kind, body))
    if last != "END-ISO-10303-21":
        raise UnreadableFile(f"{os.fspath(path)}: has no end statement; the file is cut short")
    if scan.entities["ADVANCED_FACE"] == 0:
        raise UnreadableFile(f"{os.fspath(path)}: holds no face")
    if found.turned:
        _count_turned(path, found)
    scan.dangling, scan.open_edges = found.dangling, found.open_edges
    _place(scan, assembly)
    return scan


def _single(path: str | os.PathLike[str], scan: StepScan, found: _Entities) -> Iterator[str]:
    """Statements that are read one by one: all of a small file, the rare ones of a large one."""
    if os.stat(path).st_size < LARGE:
        return statements(path)
    from clacad.formats.step import compiled_text

    table = np.array([compiled_text.name_hash(name) for name in FREQUENT], dtype=np.uint64)
    edge, face, *bounds = map(FREQUENT.index, ("ORIENTED_EDGE", "ADVANCED_FACE", *BOUNDS))

    def many(text: bytes) -> tuple[list[str], int, int]:
        letters = np.frombuffer(text, dtype=np.uint8)
        most, numbers = (int(np.count_nonzero(letters == code)) for code in b";#")
        entities, references = np.empty((most, 6), dtype=np.int64), np.empty(numbers + 1, dtype=np.int64)
        points, values = np.empty(most, dtype=np.int64), np.empty(3 * most)
        count, last, triples, end = compiled_text.cut(letters, table, entities, references, points, values)
        kind, flags, first = entities[:count, 1:4].T
        behind = np.append(first[1:], last)
        for number, times in enumerate(np.bincount(kind[kind >= 0], minlength=len(FREQUENT)).tolist()):
            scan.entities[FREQUENT[number]] += times
        used, faces = kind == edge, kind == face
        for target, some in (
            (found.defined, entities[:count, 0][kind >= 0]),
            (found.referred, references[:last]),
            (found.edges, references[first[used]]),
            (found.forward, (flags[used] & compiled_text.FORWARD).astype(np.int8)),
            (scan.points.ids, points[:triples]),
            (scan.points.values, values[: 3 * triples]),
            (scan.face_ids, entities[:count, 0][faces]),
            (scan.face_surfaces, references[behind[faces] - 1]),
        ):
            target.frombytes(some.tobytes())
        back = (flags & compiled_text.BACKWARD) > 0
        scan.reversed_faces.update(entities[:count, 0][faces & back].tolist())
        found.turned.update(references[first[np.isin(kind, bounds) & back]].tolist())
        rest = entities[:count, 4:][kind == compiled_text.RARE].tolist()
        return [text[start:stop].decode("latin-1") for start, stop in rest], count, end

    return _cut_up(path, many)


def _title(scan: StepScan, kind: str, body: str) -> str:
    """Name of a product or solid."""
    if kind not in ("PRODUCT", "MANIFOLD_SOLID_BREP"):
        return ""
    scan.names.append(_STRING.findall(body)[0])
    return scan.names[-1]


def _place(scan: StepScan, assembly: Assembly) -> None:
    scan.units = tuple(sorted(assembly.units.every()))
    scan.millimetres = scan.units == (1.0,)
    scan.parts, scan.frames = assembly.standing(scan.points.lookup()), assembly.frames
    for part in scan.parts:
        many = len(part.placements)
        scan.solids += many * part.solid
        scan.shells += many * len(part.shells)
        scan.faces += many * sum(len(scan.shell_faces.get(shell, ())) for shell in part.shells)


def _header(scan: StepScan, statement: str) -> None:
    if statement.startswith("FILE_NAME"):
        scan.name = _STRING.findall(statement)[0]
    elif statement.startswith("FILE_SCHEMA"):
        scan.schema = _STRING.findall(statement)[0]


def _collect(
    scan: StepScan, found: _Entities, number: int, kind: str, body: str, references: list[int]
) -> None:
    """Process what one entity contains of points, edges, faces and shells."""
    if kind == "CARTESIAN_POINT":
        scan.points.add(number, body)
    elif kind == "ORIENTED_EDGE":
        found.use(references[0], ".T." in body)
    elif kind in BOUNDS and ".F." in body:
        found.turned.add(references[0])
    elif kind == "ADVANCED_FACE":
        scan.face_ids.append(number)
        scan.face_surfaces.append(references[-1])
        if ".F." in body:
            scan.reversed_faces.add(number)
    elif kind in PATCHES:
        _surface(scan, number, kind + body, references)
    elif kind == "PLANE":
        scan.planes.extend([number, references[0]])
    elif kind == "COLOUR_RGB":
        scan.colours.append(tuple(float(value) for value in NUMBER.findall(body)))
    elif kind in SHELLS:
        scan.shell_faces[number] = array("q", references)


def _count_turned(path: str | os.PathLike[str], found: _Entities) -> None:
    """Recount the uses of edges, reversing those of loops that their face uses reversed.

    Loops may precede or follow their edges and bounds, so the text is read twice more; few writers need it.
    """
    turned: set[int] = set()
    for number, kind, body in _entities(path):
        if kind == "EDGE_LOOP" and number in found.turned:
            turned.update(int(one) for one in _REFERENCE.findall(body))
    found.edges, found.forward = array("q"), array("b")
    for number, kind, body in _entities(path):
        if kind == "ORIENTED_EDGE":
            found.use(int(_REFERENCE.findall(body)[0]), (".T." in body) != (number in turned))


def _entities(path: str | os.PathLike[str]) -> Iterator[tuple[int, str, str]]:
    for statement in statements(path):
        match = _ENTITY.match(statement)
        if match is not None:
            yield int(match.group(1)), match.group(2), _STRING.sub("''", statement[match.end() :])


def _surface(scan: StepScan, number: int, body: str, references: list[int]) -> None:
    """Store a patch of second order or more, its poles and weights; others are walls."""
    body = "".join(body.split())
    degrees = re.search(r"B_SPLINE_SURFACE(?:_WITH_KNOTS)?\(\s*(?:''\s*,)?\s*(\d+)\s*,\s*(\d+)", body)
    if degrees is None:
        return
    m, n = int(degrees.group(1)) + 1, int(degrees.group(2)) + 1
    if min(m, n) < 3:
        return  # a wall
    if len(references) != m * n:
        scan.uneven += 1
        return
    rational = body.find("RATIONAL_B_SPLINE_SURFACE(")
    weights = (
        [float(value) for value in NUMBER.findall(body[rational:])][: m * n]
        if rational >= 0
        else [1.0] * (m * n)
    )
    scan.patches[number] = (array("q", references), (m, n), weights)


FEW = 4
"""Placements of a part, such as turned sectors of a sheet, up to which its patches are looked up in each."""


@dataclass(frozen=True, eq=False)
class Patches:
    """Bézier patches of one degree, of faces that have placements.

    poles : (k, m, n, 3), mm, in the frame of their part
    weights : (k, m, n)
    sense : (k,). −1 where the face is oriented against du × dv.
    part : (k,). Their part, an index into `StepScan.parts`.
    few : (k,). Whether the part has at most `FEW` placements.
    first : (s, k, 3, 4). First placements of the part, the last of them repeated.
    """

    poles: Floats
    weights: Floats
    sense: Floats
    part: NDArray[np.int64]
    few: NDArray[np.bool_]
    first: Floats

    @cached_property
    def span(self) -> tuple[Floats, Floats, Floats]:
        """Middles (k, 3) of the boxes of poles, half diagonals (k,), and middles in the first placements."""
        low, high = self.poles.min(axis=(1, 2)), self.poles.max(axis=(1, 2))
        middle = 0.5 * (low + high)
        placed = np.einsum("skij,kj->ski", self.first[..., :3], middle) + self.first[..., 3]
        return middle, 0.5 * np.linalg.norm(high - low, axis=1), placed

    def near(self, low: Floats, high: Floats) -> NDArray[np.int64]:
        """Rows of the patches that may reach into a column low … high (2,) of x and y."""
        _, reach, placed = self.span
        room = reach[:, None]
        inside = ((placed[..., :2] > low - room) & (placed[..., :2] < high + room)).all(axis=2).any(axis=0)
        return np.flatnonzero(inside | ~self.few)


def _patches_of(scan: StepScan) -> list[Patches]:
    ids = np.frombuffer(scan.face_ids, dtype=np.int64)
    surfaces = np.frombuffer(scan.face_surfaces, dtype=np.int64)
    order = np.argsort(ids, kind="stable")
    found: dict[tuple[int, int], list[tuple[int, float, int]]] = {}
    for number, part in enumerate(scan.parts):
        for shell in part.shells if len(part.placements) else ():
            faces = np.frombuffer(scan.shell_faces.get(shell, array("q")), dtype=np.int64)
            at = np.minimum(np.searchsorted(ids, faces, sorter=order), len(ids) - 1)
            for face, surface in zip(faces.tolist(), surfaces[order[at]].tolist(), strict=True):
                if surface in scan.patches:
                    sense = -1.0 if face in scan.reversed_faces else 1.0
                    found.setdefault(scan.patches[surface][1], []).append((surface, sense, number))
    points = scan.points.lookup() if found else None
    return [] if points is None else [_gathered(scan, points, shape, rows) for shape, rows in found.items()]


def _gathered(
    scan: StepScan, points: Lookup, shape: tuple[int, int], rows: list[tuple[int, float, int]]
) -> Patches:
    numbers = np.array([scan.patches[surface][0] for surface, _, _ in rows], dtype=np.int64)
    part = np.array([number for _, _, number in rows], dtype=np.int64)
    unit = np.array([one.unit for one in scan.parts])[part]
    poles = points.values[points.rows(numbers.ravel())].reshape(-1, *shape, 3) * unit[:, None, None, None]
    weights = np.array([scan.patches[surface][2] for surface, _, _ in rows]).reshape(-1, *shape)
    placements = [one.placements for one in scan.parts]
    few = np.array([len(some) <= FEW for some in placements])[part]
    most = max(1, min(FEW, max(map(len, placements))))
    first = np.array(
        [
            [some.one(min(n, len(some) - 1)) if len(some) else UNPLACED for some in placements]
            for n in range(most)
        ]
    )[:, part]
    return Patches(poles, weights, np.array([sense for _, sense, _ in rows]), part, few, first)


def patch_points(scan: StepScan, per_side: int = 3) -> LensPoints:
    """Points of the middle of every curved patch, evaluated from the text.

    per_side : Points along each parameter, from 0.3 to 0.7.
    """
    t = np.linspace(0.3, 0.7, per_side)
    found, each, done = [LensPoints.none()], per_side * per_side, 0
    for group in scan.groups:
        for start in range(0, len(group.part), BLOCK):
            some = slice(start, start + BLOCK)
            place, normal = _evaluate(group.poles[some], group.weights[some], t)
            part = group.part[some]
            patch = done + np.repeat(np.arange(len(part)), each)
            done += len(part)
            found.append(LensPoints(place, normal * np.repeat(group.sense[some], each)[:, None], patch, part))
    return LensPoints.joined(found)


def heights_of_planes(scan: StepScan) -> Iterator[tuple[str, Floats]]:
    """Name and heights (n,) of the planes' points, mm, of every part of planes alone or with walls."""
    surfaces = dict(zip(scan.face_ids, scan.face_surfaces))
    planes, points = dict(zip(scan.planes[::2], scan.planes[1::2])), scan.points.lookup()
    locations = dict(scan.frames[:, :2].tolist())
    for part in scan.parts if planes else ():
        faces = [face for shell in part.shells for face in scan.shell_faces.get(shell, ())]
        seen = {surfaces.get(face, 0) for face in faces}
        if not len(part.placements) or not seen.isdisjoint(scan.patches):
            continue
        place = part.placements.one(0)
        at = [points.one(locations.get(planes[one], 0)) * part.unit for one in sorted(seen & planes.keys())]
        if at:
            yield part.name, applied(place, np.array(at))[:, 2]


def _evaluate(poles: Floats, weights: Floats, t: Floats) -> tuple[Floats, Floats]:
    """Points and unit normals du × dv of rational Bézier patches (k, m, n) at the grid t × t."""
    homogeneous = np.concatenate([poles * weights[..., None], weights[..., None]], axis=-1)
    points, normals = [], []
    for u in t:
        rows, rows_u = (np.moveaxis(one, 1, 0) for one in casteljau(np.moveaxis(homogeneous, 1, 0), u))
        for v in t:
            point, along, across = across_rows(rows, rows_u, v)
            normal = np.cross(along, across)
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            points.append(point)
            normals.append(normal)
    return np.stack(points, axis=1).reshape(-1, 3), np.stack(normals, axis=1).reshape(-1, 3)


def across_rows(rows: Floats, rows_u: Floats, v: float | Floats) -> tuple[Floats, Floats, Floats]:
    """Points and tangents (n, 3) along u and v of patches, from their rows at u and the derivatives of these.

    rows, rows_u : (n2, n, 4). Homogeneous control points.
    """
    place, place_v = casteljau(rows, v)
    place_u, _ = casteljau(rows_u, v)
    w = place[:, 3:]
    point = place[:, :3] / w
    return point, (place_u[:, :3] - point * place_u[:, 3:]) / w, (place_v[:, :3] - point * place_v[:, 3:]) / w


def casteljau(control: Floats, t: float | Floats) -> tuple[Floats, Floats]:
    """Value and derivative of Bézier curves whose control points lie along axis 0, at one parameter or at
    parameters of the shape of the other axes.
    """
    degree = len(control) - 1
    while len(control) > 2:
        control = (1.0 - t) * control[:-1] + t * control[1:]
    return (1.0 - t) * control[0] + t * control[1], degree * (control[1] - control[0])
