"""GLB: glTF 2.0 in one binary file, for viewers. One mesh a body, one node a cell or a body, exact normals.

Coordinates are millimetres about each cell's own centre; a root node scales them to the metres of glTF. Glass
is described by KHR_materials_transmission and KHR_materials_ior.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np

from clacad.base.types import Floats
from clacad.base.units import MILLIMETRE
from clacad.formats.mesh.file_mesh import NO_VERTEX, FileMesh, FileRows, Part, Table, fault_of, put, rows_of
from clacad.formats.placements import Piece, Placements
from clacad.storage.errors import FileDisagrees, OverBudget, UnreadableFile
from clacad.storage.reading import Spending

_MAGIC = b"glTF"
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_LONGEST_JSON = 1 << 27
MOST_NODES = 2_000_000
_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_PLACED = 5
"""Memory of a placement, in vertices."""
INSTANCING = "EXT_mesh_gpu_instancing"


def write_glb(
    pieces: Sequence[Piece], path: Path, scale: float, name: str, gpu_instancing: bool = False
) -> None:
    """Write pieces as one GLB file.

    pieces : Each with `normals`.
    scale : Millimetres per design unit.
    gpu_instancing : One node for all cells of a body, their positions in an array (EXT_mesh_gpu_instancing,
        float32). Such files are far smaller; viewers without the extension reject them.
    Raises OSError.
    Raises FileDisagrees: A value is not finite, or a piece has no normals.
    """
    document = _begun(name)
    with TemporaryFile(dir=path.parent) as binary:
        for piece in pieces:
            _add_mesh(document, binary, piece, scale, path.parent)
            mesh = len(document["meshes"]) - 1
            if gpu_instancing and piece.places is not None:
                _add_instances(document, binary, piece, mesh, scale)
            else:
                _add_nodes(document, piece, mesh, scale)
        _write_chunks(path, document, binary)


def write_glb_stack(placed: Sequence[PlacedPieces], path: Path, name: str) -> None:
    """Write several sheets as one GLB file, each a separate node at its position.

    placed : The meshes of a sheet that occurs twice are written once.
    Raises OSError, FileDisagrees: As in `write_glb`.
    """
    document = _begun(name)
    made: dict[int, list[int]] = {}
    with TemporaryFile(dir=path.parent) as binary:
        for one in placed:
            if id(one.pieces) not in made:
                made[id(one.pieces)] = []
                for piece in one.pieces:
                    _add_mesh(document, binary, piece, one.scale, path.parent)
                    made[id(one.pieces)].append(len(document["meshes"]) - 1)
            nodes = document["nodes"]
            document["nodes"][0]["children"].append(len(nodes))
            sheet = {"name": one.name, "translation": [0.0, 0.0, one.z + 0.0], "children": []}
            nodes.append(sheet)
            for piece, mesh in zip(one.pieces, made[id(one.pieces)], strict=True):
                _add_nodes(document, piece, mesh, one.scale, sheet)
        _write_chunks(path, document, binary)


@dataclass(frozen=True, eq=False)
class PlacedPieces:
    """The meshes of one sheet of several in a file.

    pieces : Each with `normals`.
    scale : Millimetres per unit of the sheet.
    z : mm. Position of the sheet's own z = 0.
    """

    name: str
    pieces: Sequence[Piece]
    scale: float
    z: float


def _begun(name: str) -> dict[str, Any]:
    """A document whose one root scales millimetres to the metres of glTF."""
    return {
        "asset": {"version": "2.0", "generator": "clacad"},
        "extensionsUsed": ["KHR_materials_ior", "KHR_materials_transmission"],
        "scene": 0,
        "scenes": [{"name": name, "nodes": [0]}],
        "nodes": [{"name": name, "scale": [MILLIMETRE] * 3, "children": []}],
        "meshes": [],
        "materials": [],
        "accessors": [],
        "bufferViews": [],
    }


def _write_chunks(path: Path, document: dict[str, Any], binary: IO[bytes]) -> None:
    """Write the JSON and the binary chunk of a GLB file."""
    size = binary.tell()
    document["buffers"] = [{"byteLength": size}]
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + size
    if length >= 1 << 32:
        raise FileDisagrees(f"{length} bytes do not fit the 32-bit length of a GLB file")
    with path.open("wb") as stream:
        stream.write(_MAGIC + _words(2, length) + _words(len(text), _JSON))
        stream.write(text)
        stream.write(_words(size, _BIN))
        _append(stream, binary)


def _append(stream: IO[bytes], part: IO[bytes]) -> None:
    part.seek(0)
    shutil.copyfileobj(part, stream)


def _words(*values: int) -> bytes:
    return b"".join(value.to_bytes(4, "little") for value in values)


def _add_mesh(document: dict[str, Any], binary: IO[bytes], piece: Piece, scale: float, folder: Path) -> None:
    """Append the triangles of a piece, and its glass as a material, to the document.

    folder : Where normals and triangles wait until all positions are written.
    """
    begin, vertices, facets, ends = binary.tell(), 0, 0, np.empty((0, 3), dtype="<f4")
    with TemporaryFile(dir=folder) as normals, TemporaryFile(dir=folder) as corners:
        for block in piece.blocks():
            position, normal = (
                values.astype("<f4") + np.float32(0.0) for values in block.sound(piece.name, scale)
            )
            if len(position):
                ends = np.concatenate([ends, position])
                ends = np.stack([ends.min(axis=0), ends.max(axis=0)])
            vertices, facets = vertices + len(position), facets + len(block.triangles)
            for stream, rows in ((binary, position), (normals, normal)):
                stream.write(np.ascontiguousarray(rows).tobytes())
            corners.write(np.ascontiguousarray(block.triangles, dtype="<u4").tobytes())
        _append(binary, normals)
        _append(binary, corners)
    material = {
        "name": f"{piece.name} material",
        "pbrMetallicRoughness": {
            "baseColorFactor": [1.0, 1.0, 1.0, 1.0],
            "metallicFactor": 0.0,
            "roughnessFactor": 0.0,
        },
        "extensions": {
            "KHR_materials_ior": {"ior": float(piece.index)},
            "KHR_materials_transmission": {"transmissionFactor": 1.0},
        },
    }
    document["materials"].append(material)
    number = len(document["accessors"])
    for size, count, component, kind, target in (
        (12 * vertices, vertices, 5126, "VEC3", 34962),
        (12 * vertices, vertices, 5126, "VEC3", 34962),
        (12 * facets, 3 * facets, 5125, "SCALAR", 34963),
    ):
        _add_accessor(document, (begin, size), count, component, kind, target)
        begin += size
    lowest, highest = ends.tolist()
    document["accessors"][number] |= {"min": lowest, "max": highest}
    primitive = {
        "attributes": {"POSITION": number, "NORMAL": number + 1},
        "mode": 4,
        "material": len(document["materials"]) - 1,
        "indices": number + 2,
    }
    document["meshes"].append({"name": piece.name, "primitives": [primitive]})


def _add_accessor(
    document: dict[str, Any],
    span: tuple[int, int],
    count: int,
    component: int,
    kind: str,
    target: int | None = None,
) -> None:
    """Describe numbers of the binary chunk; `span`: their first byte and their bytes."""
    view = {"buffer": 0, "byteOffset": span[0], "byteLength": span[1]}
    document["bufferViews"].append(view if target is None else view | {"target": target})
    document["accessors"].append(
        {
            "bufferView": len(document["bufferViews"]) - 1,
            "componentType": component,
            "count": count,
            "type": kind,
        }
    )


def _add_instances(
    document: dict[str, Any], binary: IO[bytes], piece: Piece, mesh: int, scale: float
) -> None:
    """Append one node whose mesh is placed at every position of the piece (EXT_mesh_gpu_instancing)."""
    assert piece.places is not None
    place = np.asarray(piece.places.centres() * scale, dtype="<f4") + np.float32(0.0)
    _add_accessor(document, (binary.tell(), place.nbytes), len(place), 5126, "VEC3")
    binary.write(np.ascontiguousarray(place).tobytes())
    document["nodes"][0]["children"].append(len(document["nodes"]))
    where = {INSTANCING: {"attributes": {"TRANSLATION": len(document["accessors"]) - 1}}}
    document["nodes"].append({"name": piece.name, "mesh": mesh, "extensions": where})
    document["extensionsUsed"] = sorted({*document["extensionsUsed"], INSTANCING})
    document["extensionsRequired"] = [INSTANCING]


def _add_nodes(
    document: dict[str, Any], piece: Piece, mesh: int, scale: float, parent: dict[str, Any] | None = None
) -> None:
    """Append the nodes of a piece below a parent; None: the root."""
    nodes = document["nodes"]
    children = nodes[0]["children"] if parent is None else parent["children"]
    if piece.places is None:
        children.append(len(nodes))
        nodes.append({"name": piece.name, "mesh": mesh})
        return
    body = {"name": piece.name, "children": list(range(len(nodes) + 1, len(nodes) + 1 + piece.count))}
    children.append(len(nodes))
    nodes.append(body)
    nodes.extend(
        {"mesh": mesh, "translation": [x * scale, y * scale, 0.0]}
        for x, y, _ in piece.places.centres().tolist()
    )


# -- reading -----------------------------------------------------------------------------------


def read_glb(path: Path) -> FileMesh:
    """Read a GLB file whose data are inside it; instances stay instances.

    Raises UnreadableFile: Truncated, inconsistent, needs another file or an extension that changes the
        geometry.
    Raises OverBudget: More bytes, vertices, places or seconds than are read.
    """
    spent = Spending("glb", path)
    data = np.memmap(path, dtype=np.uint8, mode="r") if path.stat().st_size else np.zeros(0, np.uint8)
    try:
        return _scene(_Buffers(path, *_chunks(data), spent))
    except OverBudget:
        raise
    except UnreadableFile as error:
        raise UnreadableFile(f"{path.name}: {str(error)[:300]}") from error
    except (
        KeyError,
        IndexError,
        TypeError,
        ValueError,
        AttributeError,
        OverflowError,
        RecursionError,
    ) as error:
        raise UnreadableFile(f"{path.name}: damaged ({type(error).__name__}: {str(error)[:200]})") from error


@dataclass(frozen=True, eq=False)
class _Buffers:
    """A GLB file: its JSON, first byte and bytes of its binary chunk, and the resources spent on reading."""

    path: Path
    document: dict[str, Any]
    start: int
    size: int
    spent: Spending


def _chunks(data: np.ndarray[Any, Any]) -> tuple[dict[str, Any], int, int]:
    """The JSON text of a GLB file as a mapping; first byte and bytes of its binary chunk."""
    if len(data) < 20 or bytes(data[:4]) != _MAGIC:
        raise UnreadableFile("not a GLB file")
    version, length, size, kind = (int(v) for v in np.frombuffer(bytes(data[4:20]), "<u4"))
    if version != 2 or length != len(data):
        raise UnreadableFile(f"version {version}, {length} bytes promised and {len(data)} found")
    if kind != _JSON or size > _LONGEST_JSON or 20 + size > length:
        raise UnreadableFile("its first chunk is not a JSON text of allowed length")
    document = json.loads(bytes(data[20 : 20 + size]))
    rest = data[20 + size :]
    if len(rest) < 8:
        raise UnreadableFile("no binary chunk")
    size, kind = (int(v) for v in np.frombuffer(bytes(rest[:8]), "<u4"))
    if kind != _BIN or size != len(rest) - 8:
        raise UnreadableFile("its binary chunk has another length than it says")
    if not isinstance(document, dict):
        raise UnreadableFile("its JSON is not an object")
    return document, length - size, size


def _scene(file: _Buffers) -> FileMesh:
    """Meshes of the shown scene, each with all of its placements."""
    document = file.document
    if set(document.get("extensionsRequired", ())) - {INSTANCING}:
        raise UnreadableFile(f"needs the extensions {document['extensionsRequired']}, which are not read")
    if any("uri" in buffer for buffer in document["buffers"]) or len(document["buffers"]) != 1:
        raise UnreadableFile("its data lie in another file")
    if len(document["nodes"]) > MOST_NODES:
        raise UnreadableFile(f"{len(document['nodes'])} nodes are more than the {MOST_NODES} allowed")
    scene = document["scenes"][document.get("scene", 0)]
    places = _places(file, [int(n) for n in scene["nodes"]])
    parts = [
        part
        for mesh in sorted(places)
        for part in _parts(file, mesh, put(np.concatenate(places[mesh])[::-1]))
    ]
    if not parts:
        raise UnreadableFile("its scene shows no triangle")
    return FileMesh("glb", tuple(parts), 1.0, str(scene.get("name", "")))


def _places(file: _Buffers, roots: list[int]) -> dict[int, list[Floats]]:
    """Number of a mesh → blocks of its placements (k, 4, 3), the last first; row-vector matrices."""
    nodes = file.document["nodes"]
    places: dict[int, list[Floats]] = {}
    seen: set[int] = set()
    stack = [(n, np.eye(4)) for n in roots]
    while stack:
        number, above = stack.pop()
        file.spent.look("among its nodes")
        if number in seen or number < 0:
            raise UnreadableFile(f"node {number} occurs twice: a scene is a tree")
        seen.add(number)
        node = nodes[number]
        if set(node.get("extensions", ())) - {INSTANCING} or "skin" in node:
            raise UnreadableFile(f"node {number} uses an extension or skin, which is not read")
        place = _together(_local(node), above)
        if "mesh" in node:
            found = _instances(file, node) if "extensions" in node else np.eye(4)[None]
            places.setdefault(int(node["mesh"]), []).append(_together(found, place)[:, :, :3])
        children = [int(child) for child in node.get("children", ())]
        leaves = [n for n in children if 0 <= n < len(nodes) and n not in seen and set(nodes[n]) <= _LEAF]
        chosen = set(leaves)
        if len(chosen) == len(leaves) > 1:  # a sheet of cells in one go, not one matrix after the other
            seen.update(chosen)
            for mesh, found in _leaves([nodes[n] for n in leaves]):
                places.setdefault(mesh, []).append(_together(found, place)[::-1, :, :3])
            children = [n for n in children if n not in chosen]
        stack.extend((child, place) for child in children)
    return places


_LEAF = {"mesh", "name", "translation"}
"""Keys of a node that only places a mesh."""


def _leaves(nodes: list[dict[str, Any]]) -> list[tuple[int, Floats]]:
    """Meshes that plain nodes place, and their row-vector matrices (k, 4, 4)."""
    found: dict[int, list[Any]] = {}
    for node in nodes:
        if "mesh" in node:
            found.setdefault(int(node["mesh"]), []).append(node.get("translation", (0.0, 0.0, 0.0)))
    return [(mesh, _translations(np.array(moves, dtype=np.float64))) for mesh, moves in found.items()]


def _translations(moves: Floats) -> Floats:
    """Row-vector matrices (k, 4, 4) of displacements (k, 3)."""
    if moves.shape[1:] != (3,) or not np.isfinite(moves).all():
        raise UnreadableFile("a node's place is not a number")
    matrices = np.tile(np.eye(4), (len(moves), 1, 1))
    matrices[:, 3, :3] = moves
    return matrices


def _instances(file: _Buffers, node: dict[str, Any]) -> Floats:
    """Row-vector matrices of a node's instances, (k, 4, 4), last first like the nodes of a tree."""
    attributes = node["extensions"][INSTANCING]["attributes"]
    if set(attributes) != {"TRANSLATION"}:
        raise UnreadableFile("instances that are turned or scaled are not read")
    offsets = _accessed(file, attributes["TRANSLATION"], 3)[:].astype(np.float64)
    if len(offsets) > MOST_NODES or not np.isfinite(offsets).all():
        raise UnreadableFile("its instances are too many, or have no place")
    file.spent.count(_PLACED * len(offsets))
    return _translations(offsets)[::-1]


def _together(places: Floats, above: Floats) -> Floats:
    """Placements (…, 4, 4) below another one, as row-vector matrices.

    Raises UnreadableFile: The product of nested scales is not a number.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        found = np.asarray(places @ above)
    if not np.isfinite(found).all():
        raise UnreadableFile("the scales of nodes below one another multiply to more than a number holds")
    return found


def _local(node: dict[str, Any]) -> Floats:
    """Row-vector matrix of a node, (4, 4)."""
    place = np.eye(4)
    if "matrix" in node:
        place = np.array(node["matrix"], dtype=np.float64).reshape(4, 4)  # column-major is row-vector order
    else:
        x, y, z, w = (float(v) for v in node.get("rotation", (0, 0, 0, 1)))
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
                [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
                [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        size = np.array([float(v) for v in node.get("scale", (1, 1, 1))])
        place[:3, :3] = size[:, None] * turn
        place[3, :3] = [float(v) for v in node.get("translation", (0, 0, 0))]
    if not np.isfinite(place).all():
        raise UnreadableFile("a node's place is not a number")
    return place


def _parts(file: _Buffers, number: int, places: Placements) -> list[Part]:
    """Parts of one mesh, one a primitive, all with the same placements."""
    mesh = file.document["meshes"][number]
    found = []
    for primitive in mesh["primitives"]:
        if primitive.get("mode", 4) != 4 or "extensions" in primitive:
            raise UnreadableFile(f"mesh {number} is not plain triangles")
        vertices = _accessed(file, primitive["attributes"]["POSITION"], 3)
        normals = None
        if "NORMAL" in primitive["attributes"]:
            normals = _accessed(file, primitive["attributes"]["NORMAL"], 3)
        if "indices" in primitive:
            triangles = _accessed(file, primitive["indices"], 1, 3)
        else:
            triangles = np.arange(len(vertices), dtype=np.int64)[: len(vertices) // 3 * 3].reshape(-1, 3)
        why = fault_of(vertices, triangles)
        if len(triangles) == 0 or why == NO_VERTEX:
            raise UnreadableFile(f"mesh {number} uses vertices that are not there")
        if why is not None or (normals is not None and len(normals) != len(vertices)):
            raise UnreadableFile(f"mesh {number} has a vertex that is not a number, or too few normals")
        found.append(Part(str(mesh.get("name", "")), vertices, triangles, normals=normals, places=places))
    return found


def _accessed(file: _Buffers, number: int, width: int, together: int = 1) -> Table:
    """The rows of an accessor, `width` numbers each; each use of an accessor counts.

    together : Numbers of an accessor of single ones that make a row.
    """
    document = file.document
    accessor = document["accessors"][int(number)]
    view = document["bufferViews"][int(accessor["bufferView"])]
    kind = np.dtype(_COMPONENTS[accessor["componentType"]])
    count = int(accessor["count"])
    if (
        _WIDTHS[accessor["type"]] != width
        or "sparse" in accessor
        or "byteStride" in view
        or accessor.get("normalized")
    ):
        raise UnreadableFile(f"accessor {number} has a form that is not read")
    if width == 3 and kind != np.dtype("<f4"):
        raise UnreadableFile(f"accessor {number} is not float32")
    inside = int(accessor.get("byteOffset", 0))
    start, size = int(view.get("byteOffset", 0)) + inside, count * width * kind.itemsize
    if min(count, inside, start) < 0 or inside + size > int(view["byteLength"]) or start + size > file.size:
        raise UnreadableFile(f"accessor {number} reaches outside its data")
    if count % together:
        raise UnreadableFile(f"accessor {number} ends within a triangle")
    file.spent.count(count)
    file.spent.look("among its meshes")
    rows = np.dtype((kind, (width * together,)))
    return rows_of(FileRows(file.path, file.start + start, rows, count // together))
