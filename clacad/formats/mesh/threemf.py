"""3MF: a zip of XML that states its unit and can repeat one cell many times.

Written without a library, so that equal designs give equal bytes: fixed dates, no random identifiers, numbers
in the shortest form that reads back exactly. Read with clacad's own expander, because common readers lose
instances that are shared through two levels.
"""

from __future__ import annotations

import math
import zipfile
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from html import escape
from io import BytesIO
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bytes, Floats, Ints
from clacad.formats.mesh.file_mesh import ONE_PLACE, FileMesh, Part, put
from clacad.formats.placements import FLAT_LIMIT, Piece, Placements, Places, joined
from clacad.storage.archive import Attributes, open_archive, parse_xml
from clacad.storage.errors import FileDisagrees, OverBudget, UnreadableFile
from clacad.storage.reading import NUMBER, WHOLE, ElementRun, Spending

MOST_PLACES = 4_000_000
"""Largest number of placements of the parts of one file."""

_PLACED = 14
"""Memory of a component, item or object, in vertices."""

TOGETHER, BLOCK = 4096, 300_000
"""Lines that are made at a time, and characters that are packed at a time."""

MANY = 65_536
"""Lines from which they are joined by a compiled kernel, and that it joins at a time."""

LARGE, QUICK = 8_000_000, 4
"""Facets above which a file is packed at a lower level: 4 % longer, in a third of the time."""

MANY_BYTES = 4_000_000
"""Text of a model from which its elements are read by a compiled kernel."""

MOST_NUMBER = 2**31 - 1
"""Greatest number of a vertex that is read."""

NAMESPACE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
MODEL = "3D/3dmodel.model"
_TYPES = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>'
    "</Types>\n"
)
_RELATIONS = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    f'<Relationship Target="/{MODEL}" Id="rel0" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
    "</Relationships>\n"
)
UNITS = {"micron": 1e-6, "millimeter": 1e-3, "centimeter": 1e-2, "inch": 0.0254, "foot": 0.3048, "meter": 1.0}


# -- writing -----------------------------------------------------------------------------------


def write_threemf(pieces: Sequence[Piece], path: Path, scale: float, name: str) -> None:
    """Write pieces, each occurring once or on a lattice, as one 3MF file.

    scale : Millimetres per design unit.
    name : Title of the model.
    Raises OSError.
    Raises FileDisagrees: A coordinate is not a finite number.
    """
    with path.open("wb") as raw, zipfile.ZipFile(raw, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        archive.writestr(_entry("[Content_Types].xml"), _TYPES)
        archive.writestr(_entry("_rels/.rels"), _RELATIONS)
        model = _entry(MODEL)
        if sum(piece.facets for piece in pieces) > LARGE:
            model._compresslevel = QUICK  # type: ignore[attr-defined]
        with archive.open(model, "w", force_zip64=True) as stream:
            for block in joined_lines(_model(pieces, scale, name, path.parent)):
                stream.write(block)


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.create_system = 0  # the same bytes on every system
    entry.external_attr = 0
    return entry


def joined_lines(lines: Iterator[str | bytes]) -> Iterator[bytes]:
    """The same text in blocks of a few hundred kilobytes."""
    kept: list[bytes] = []
    size = 0
    for line in lines:
        kept.append(line if isinstance(line, bytes) else line.encode())
        size += len(kept[-1])
        if size > BLOCK:
            yield b"".join(kept)
            kept.clear()
            size = 0
    yield b"".join(kept)


def _model(pieces: Sequence[Piece], scale: float, name: str, folder: Path) -> Iterator[str | bytes]:
    """Lines of the model part: materials, meshes, components and build items."""
    yield '<?xml version="1.0" encoding="UTF-8"?>\n'
    yield f'<model unit="millimeter" xml:lang="en-US" xmlns="{NAMESPACE}">\n'
    yield (
        f'<metadata name="Title">{escape(name, quote=False)}</metadata>\n<metadata'
        ' name="Application">clacad</metadata>\n'
    )
    yield "<resources>\n"
    numbers = iter(range(1, 1 << 31))
    items: list[tuple[int, str]] = []
    for piece in pieces:
        mesh = next(numbers)
        yield from mesh_lines(piece, mesh, scale, folder)
        if piece.places is None:
            items.append((mesh, ""))
            continue
        if piece.count <= FLAT_LIMIT:
            whole = next(numbers)
            yield from _flat(piece.name, piece.places, mesh, whole, scale)
        else:
            kinds = [next(numbers) for _ in piece.places.rows()[0]]
            whole = next(numbers)
            yield from _hierarchical(piece.name, piece.places, mesh, kinds, whole, scale)
        items.append((whole, ""))
    yield "</resources>\n<build>\n"
    for number, transform in items:
        yield f'<item objectid="{number}"{transform}/>\n'
    yield "</build>\n</model>\n"


VERTEX = b'<vertex x="', b'" y="', b'" z="', b'"/>\n'
TRIANGLE = b'<triangle v1="', b'" v2="', b'" v3="', b'"/>\n'
Marks = tuple[bytes, bytes, bytes, bytes]
"""Text before, between and after the numbers of a line."""


def mesh_lines(piece: Piece, number: int, scale: float, folder: Path | None = None) -> Iterator[str | bytes]:
    """Lines of one mesh object, many in one text; triangles wait in a file of `folder`, else in memory."""
    label = piece.name if piece.places is None else piece.name + " cell"
    yield f'<object id="{number}" type="model" name="{escape(label)}">\n<mesh>\n<vertices>\n'
    with BytesIO() if folder is None else TemporaryFile(dir=folder) as held:

        def vertices() -> Iterator[Floats]:
            for block in piece.blocks():
                scaled = np.asarray(block.vertices, dtype=np.float64) * scale + 0.0
                if not np.isfinite(scaled).all():
                    raise FileDisagrees(f"{piece.name}: a vertex is not a finite number")
                held.write(np.ascontiguousarray(block.triangles, dtype=np.int64).tobytes())
                yield scaled

        yield from _lines(vertices(), VERTEX)
        yield "</vertices>\n<triangles>\n"
        held.seek(0)
        rows = (
            np.frombuffer(data, dtype=np.int64).reshape(-1, 3)
            for data in iter(lambda: held.read(MANY * 24), b"")
        )
        yield from _lines(rows, TRIANGLE)
    yield "</triangles>\n</mesh>\n</object>\n"


def _lines(rows: Iterable[NDArray[Any]], between: Marks) -> Iterator[str | bytes]:
    """Rows of three numbers as lines, many in one text."""
    marks, ends = _marks(between)
    known: _Texts | None = None
    for some in _by_many(rows):
        if len(some) < MANY:
            a, b, c, d = (mark.decode() for mark in between)
            for first in range(0, len(some), TOGETHER):
                columns = some[first : first + TOGETHER].T.tolist()  # because a list for each row is slow
                yield "".join([f"{a}{x!r}{b}{y!r}{c}{z!r}{d}" for x, y, z in zip(*columns, strict=True)])
            continue
        from clacad.formats.mesh.compiled_measure import join_whole, join_words

        if some.dtype.kind == "i":
            out = np.empty(len(some) * (len(marks) + 3 * len(str(some.max()))), dtype=np.uint8)
            yield out[: join_whole(some, marks, ends, out)].tobytes()
            continue
        known = _Texts() if known is None or len(known.starts) > MOST_TEXTS else known
        words = known.of(some)
        letters, starts = (
            np.frombuffer(known.letters, dtype=np.uint8),
            np.frombuffer(known.starts, dtype=np.int64),
        )
        out = np.empty(
            len(some) * len(marks) + int((starts[words + 1] - starts[words]).sum()), dtype=np.uint8
        )
        join_words(words, letters, starts, marks, ends, out)
        del letters, starts  # so that these may grow
        yield out.tobytes()


MOST_TEXTS = 1 << 19
"""Number of texts that are kept; from there on they are begun again."""


class _Texts:
    """Shortest texts of numbers, each made once.

    letters, starts : All texts, one after another; text k is letters[starts[k] : starts[k + 1]].
    """

    def __init__(self) -> None:
        from clacad.formats.mesh.measure import Welder

        self.letters, self.starts = bytearray(), array("q", [0])
        self._known = Welder(np.empty((0, 1)))

    def of(self, values: Floats) -> Ints:
        """Number of the text of each value."""
        number, fresh = self._known.numbers(values.reshape(-1, 1))
        texts = list(map(repr, values.ravel()[fresh].tolist()))
        ends = np.cumsum(list(map(len, texts)), dtype=np.int64) + len(self.letters)
        self.letters += "".join(texts).encode("ascii")
        self.starts.frombytes(ends.tobytes())
        return number.reshape(values.shape)


def _marks(between: Marks) -> tuple[Bytes, Ints]:
    """The letters of all marks, and where each begins and ends."""
    ends = np.cumsum([0, *map(len, between)], dtype=np.int64)
    return np.frombuffer(b"".join(between), dtype=np.uint8), ends


def _by_many(rows: Iterable[NDArray[Any]]) -> Iterator[NDArray[Any]]:
    """The same rows, `MANY` at a time."""
    waiting: list[NDArray[Any]] = []
    count = 0
    for some in rows:
        waiting.append(some)
        count += len(some)
        if count >= MANY:
            together = np.concatenate(waiting)
            last = count - count % MANY
            yield from (together[first : first + MANY] for first in range(0, last, MANY))
            waiting, count = [together[last:]], count - last
    if count:
        yield np.concatenate(waiting)


def _flat(name: str, places: Places, mesh: int, number: int, scale: float) -> Iterator[str]:
    placed = ((mesh, x * scale, y * scale) for x, y, _ in places.centres().tolist())
    yield from _components(name, number, placed)


def _hierarchical(
    name: str, places: Places, mesh: int, kinds: list[int], whole: int, scale: float
) -> Iterator[str]:
    offsets, standing = places.rows()
    for number, row in zip(kinds, offsets):
        yield from _components(name + " row", number, ((mesh, x * scale, 0.0) for x in row.tolist()))
    placed = ((kinds[kind], x * scale, y * scale) for kind, (x, y) in standing)
    yield from _components(name, whole, placed)


def _components(name: str, number: int, placed: Iterable[tuple[int, float, float]]) -> Iterator[str]:
    """Lines of an object of other objects, each at its place (x, y)."""
    yield f'<object id="{number}" type="model" name="{escape(name)}">\n<components>\n'
    yield from (component_text(*one) for one in placed)
    yield "</components>\n</object>\n"


def component_text(number: int, x: float, y: float) -> str:
    """Line that places object `number` at (x, y)."""
    return f'<component objectid="{number}" transform="1 0 0 0 1 0 0 0 1 {x + 0.0!r} {y + 0.0!r} 0"/>\n'


# -- reading -----------------------------------------------------------------------------------


@dataclass
class _Object:
    name: str
    vertices: array[float] = field(default_factory=lambda: array("d"))
    triangles: array[int] = field(default_factory=lambda: array("i"))
    components: list[tuple[str, Floats]] = field(default_factory=list)


@dataclass
class _Model:
    """Data that the parser has gathered so far."""

    spent: Spending
    unit: float = 1e-3
    objects: dict[str, _Object] = field(default_factory=dict)
    items: list[tuple[str, Floats]] = field(default_factory=list)
    current: _Object | None = None
    title: str = ""
    in_title: bool = False

    def fail(self, why: str) -> UnreadableFile:
        return UnreadableFile(f"{self.spent.name}: {why[:300]}")


def read_threemf(path: Path) -> FileMesh:
    """Read a 3MF file and expand its components through any number of levels.

    Raises UnreadableFile: Not 3MF, damaged, hostile, or needs an unsupported extension.
    Raises OverBudget: More bytes, parts or seconds than are read.
    """
    spent = Spending("3mf", path)
    with open_archive(path, spent) as archive:
        try:
            with archive.open(_model_name(spent, archive)) as stream:
                model = _parsed(spent, stream)
        except (KeyError, zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError) as error:
            raise UnreadableFile(f"{path.name}: damaged ({error})") from error
    places: dict[str, list[Placements]] = {}
    budget = [MOST_PLACES]
    for number, place in model.items:
        _expand(model, number, place, places, (), budget)
    parts = tuple(_part(model, number, joined(found)) for number, found in places.items())
    facets = sum(part.facet_count * len(part.places) for part in parts)
    if not facets:
        raise UnreadableFile(f"{path.name}: holds no triangle that is built")
    return FileMesh("3mf", parts, model.unit, model.title.strip())


def _model_name(spent: Spending, archive: zipfile.ZipFile) -> str:
    found: list[str] = []

    def start(tag: str, attributes: Attributes) -> None:
        if tag == "Relationship" and attributes.get("Type", "").endswith("/3dmodel"):
            found.append(attributes.get("Target", "").lstrip("/"))

    if "_rels/.rels" not in archive.namelist():
        raise UnreadableFile(f"{spent.name}: a zip file, but not 3MF (no _rels/.rels)")
    with archive.open("_rels/.rels") as stream:
        parse_xml(stream, spent, start, lambda _: None)
    if len(found) != 1 or found[0] not in archive.namelist():
        raise UnreadableFile(f"{spent.name}: it names {len(found)} models; one that exists is needed")
    return found[0]


def _parsed(spent: Spending, stream: IO[bytes]) -> _Model:
    """Objects and placements of one model part, as written in its XML."""
    model = _Model(spent)

    def start(tag: str, attributes: Attributes) -> None:
        handler = _HANDLERS.get(tag)
        if handler is not None:
            spent.count(1 if tag in ("vertex", "triangle") else 1 + _PLACED)
            try:
                handler(model, attributes)
            except (KeyError, ValueError, OverflowError) as error:
                if isinstance(error, UnreadableFile):
                    raise
                raise model.fail(f"a damaged <{tag}> element") from error

    def end(tag: str) -> None:
        if tag == "object":
            model.current = None
        model.in_title = False

    def text(data: str) -> None:
        if model.in_title and len(model.title) < 1000:
            model.title += data

    parse_xml(stream, spent, start, end, text, _runs(model))
    return model


_VERTEX = rb'<vertex x="%s" y="%s" z="%s" ?/>' % ((NUMBER,) * 3)
_TRIANGLE = rb'<triangle v1="%s" v2="%s" v3="%s" ?/>' % ((WHOLE,) * 3)
_COMPONENT = rb'<component objectid="[0-9]{1,9}" transform="%s(?: %s){11}" ?/>' % (NUMBER, NUMBER)
_BETWEEN = bytes.maketrans(b'<>/="xyz\r\n\t', b" " * 11)
_BETWEEN_WHOLE = bytes.maketrans(b'<>/="triangleve\r\n\t', b" " * 18)


def _runs(model: _Model) -> dict[str, ElementRun]:
    """Readers of elements that occur by the million in their most common form: `_on_vertex` and similar."""

    def vertices(text: bytes) -> None:
        numbers = text.replace(b"vertex", b"").translate(_BETWEEN)
        put_vertices(np.fromstring(numbers, sep=" "))

    def put_vertices(found: Floats) -> None:
        model.spent.count(found.size // 3)
        _current(model).vertices.frombytes(found.tobytes())

    def triangles(text: bytes) -> None:
        numbers = np.fromstring(text.translate(_BETWEEN_WHOLE), dtype=np.int64, sep=" ")
        put_triangles(numbers.reshape(-1, 6)[:, 1::2])  # v1 and its number, v2 …

    def put_triangles(found: NDArray[Any]) -> None:
        model.spent.count(len(found))
        if found.max(initial=0) > MOST_NUMBER:
            raise model.fail("a triangle that uses a vertex it does not have")
        _current(model).triangles.frombytes(found.astype(np.int32).tobytes())

    def components(text: bytes) -> None:
        words = text.split(b'"')
        places = np.fromstring(b" ".join(words[3::4]), sep=" ").reshape(-1, 4, 3)
        if not np.isfinite(places).all():
            raise model.fail("a transform that is not twelve numbers")
        model.spent.count(len(places) * (1 + _PLACED))
        numbers = [word.decode() for word in words[1::4]]
        _current(model).components.extend(zip(numbers, places, strict=True))

    def quick(marks: Marks, whole: bool, take: Callable[[Floats], None]) -> Callable[[bytes], int]:
        many = model.spent.size > MANY_BYTES
        return partial(_read_lines, marks, whole, take) if many else lambda _: 0

    return {
        "vertices": ElementRun(_VERTEX, vertices, quick(VERTEX, False, put_vertices)),
        "triangles": ElementRun(_TRIANGLE, triangles, quick(TRIANGLE, True, put_triangles)),
        "components": ElementRun(_COMPONENT, components),
    }


def _read_lines(between: Marks, whole: bool, take: Callable[[Floats], None], text: bytes) -> int:
    """Read the lines at the beginning of a text that have the form in which they are written; their bytes."""
    from clacad.formats.mesh.compiled_measure import read_lines

    marks, ends = _marks(between)
    found = np.empty((len(text) // (len(marks) + 3) + 1, 3))
    lines, behind = read_lines(np.frombuffer(text, dtype=np.uint8), marks, ends, whole, found)
    if lines:
        take(found[:lines])
    return int(behind)


def _on_model(model: _Model, attributes: Attributes) -> None:
    unit = attributes.get("unit", "millimeter")
    if unit not in UNITS:
        raise model.fail(f"unknown unit {unit[:40]!r}")
    model.unit = UNITS[unit]
    if attributes.get("requiredextensions", "").strip():
        raise model.fail(f"needs the extension {attributes['requiredextensions'][:200]!r}, which is not read")


def _on_metadata(model: _Model, attributes: Attributes) -> None:
    model.in_title = attributes.get("name") == "Title"


def _on_object(model: _Model, attributes: Attributes) -> None:
    number = attributes["id"]
    if number in model.objects:
        raise model.fail(f"object {number} comes twice")
    model.current = model.objects[number] = _Object(attributes.get("name", ""))


def _on_vertex(model: _Model, attributes: Attributes) -> None:
    _current(model).vertices.extend((float(attributes["x"]), float(attributes["y"]), float(attributes["z"])))


def _on_triangle(model: _Model, attributes: Attributes) -> None:
    _current(model).triangles.extend((int(attributes["v1"]), int(attributes["v2"]), int(attributes["v3"])))


def _on_component(model: _Model, attributes: Attributes) -> None:
    if any(key.endswith(":path") for key in attributes):
        raise model.fail("a component in another part of the archive, which is not read")
    _current(model).components.append((attributes["objectid"], _transform(model, attributes)))


def _on_item(model: _Model, attributes: Attributes) -> None:
    if any(key.endswith(":path") for key in attributes):
        raise model.fail("a build item in another part of the archive, which is not read")
    model.items.append((attributes["objectid"], _transform(model, attributes)))


def _current(model: _Model) -> _Object:
    if model.current is None:
        raise model.fail("a mesh element outside an object")
    return model.current


def _transform(model: _Model, attributes: Attributes) -> Floats:
    text = attributes.get("transform")
    if text is None:
        return np.asarray(ONE_PLACE[0], dtype=np.float64)
    numbers = [float(word) for word in text.split()]
    if len(numbers) != 12 or not all(math.isfinite(v) for v in numbers):
        raise model.fail("a transform that is not twelve numbers")
    return np.array(numbers, dtype=np.float64).reshape(4, 3)


_HANDLERS = {
    "model": _on_model,
    "metadata": _on_metadata,
    "object": _on_object,
    "vertex": _on_vertex,
    "triangle": _on_triangle,
    "component": _on_component,
    "item": _on_item,
}


def _expand(
    model: _Model,
    number: str,
    place: Floats,
    places: dict[str, list[Placements]],
    above: tuple[str, ...],
    budget: list[int],
) -> None:
    """Collect the placements of each mesh.

    Leaf components are placed as one array, rows of such in sequence as rows: a sheet costs as much as its
    rows and one of them.
    """
    if number in above or len(above) > 16:
        raise model.fail(f"object {number} contains itself, or components nest deeper than 16")
    found = model.objects.get(number)
    if found is None:
        raise model.fail(f"object {number} is used and not defined")
    if found.triangles:
        places.setdefault(number, []).append(put(place[None]))
    _spend(model, max(500, len(found.components)), budget)  # a level of its own costs more than a leaf
    leaves: dict[str, list[Floats]] = {}
    for child, run in groupby(found.components, key=itemgetter(0)):
        inside = model.objects.get(child)
        standing = [inner for _, inner in run]
        if inside is not None and not inside.components:
            leaves.setdefault(child, []).extend(standing)
        elif inside is not None and len(above) < 16 and not inside.triangles and _holds_leaves(model, inside):
            _spend(model, len(inside.components) * len(standing), budget)
            rows = put(_composed(np.stack(standing), place)).outer
            for leaf, cells in _by_object(inside).items():
                places.setdefault(leaf, []).append(Placements(rows).within(put(np.stack(cells)).outer))
        else:
            for inner in standing:
                _expand(model, child, _composed(inner[None], place)[0], places, (*above, number), budget)
    for child, inner_places in leaves.items():
        if model.objects[child].triangles:
            places.setdefault(child, []).append(put(_composed(np.stack(inner_places), place)))


def _spend(model: _Model, count: int, budget: list[int]) -> None:
    """Subtract a number of placements from the budget."""
    budget[0] -= count
    if budget[0] < 0:
        raise OverBudget(f"{model.spent.name}: more than {MOST_PLACES:,} places of its parts")


def _holds_leaves(model: _Model, found: _Object) -> bool:
    """Whether an object contains only meshes."""
    inside = (model.objects.get(child) for child in {child for child, _ in found.components})
    return all(one is not None and one.triangles and not one.components for one in inside)


def _by_object(found: _Object) -> dict[str, list[Floats]]:
    """Placements of the components of an object, by the number of the component's object."""
    places: dict[str, list[Floats]] = {}
    for child, place in found.components:
        places.setdefault(child, []).append(place)
    return places


def _composed(inner: Floats, outer: Floats) -> Floats:
    """Apply placements `inner` (m, 4, 3) inside the map `outer` (4, 3)."""
    result = np.matmul(inner, outer[:3])
    result[:, 3] += outer[3]
    return np.asarray(result, dtype=np.float64)


def _part(model: _Model, number: str, places: Placements) -> Part:
    found = model.objects[number]
    vertices = np.frombuffer(found.vertices, dtype=np.float64).reshape(-1, 3)
    triangles = np.frombuffer(found.triangles, dtype=np.int32).reshape(-1, 3)
    if not np.isfinite(vertices).all():
        raise model.fail(f"object {number} has a vertex that is not a number")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise model.fail(f"object {number} has a triangle that uses a vertex it does not have")
    return Part(found.name, vertices, triangles, places=places)
