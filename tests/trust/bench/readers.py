"""Triangles of a file by numpy, zipfile, json and xml alone: its contents, expanded, in millimetres."""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
UNITS = {"micron": 1e-3, "millimeter": 1.0, "centimeter": 10.0, "inch": 25.4, "foot": 304.8, "meter": 1e3}
TYPES = {"float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8", "uchar": "u1", "uint8": "u1",
         "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4"}  # fmt: skip
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])


def triangles(name: str, data: bytes) -> Floats:
    """Corners (t, 3, 3) of every triangle of a file, millimetres, as the file poses them."""
    return {"stl": _stl, "ply": _ply, "glb": _glb, "3mf": _threemf}[name.rpartition(".")[2]](data)


def _stl(data: bytes) -> Floats:
    count = int.from_bytes(data[80:84], "little")
    return np.frombuffer(data, _FACET, count, offset=84)["corners"].astype(np.float64)


def _ply(data: bytes) -> Floats:
    head, _, body = data.partition(b"end_header\n")
    elements: dict[str, tuple[int, list[str]]] = {}
    for line in head.decode("ascii").splitlines():
        word = line.split()
        if word and word[0] == "element":
            elements[word[1]] = (int(word[2]), [])
            last = word[1]
        elif word and word[0] == "property":
            elements[last][1].append(" ".join(word[1:]))
    count, properties = elements["vertex"]
    row = np.dtype([(p.split()[1], TYPES[p.split()[0]]) for p in properties])
    vertex = np.frombuffer(body, row, count)
    faces, (listed,) = elements["face"]
    _, of_count, of_index, _ = listed.split()
    face = np.dtype([("n", TYPES[of_count]), ("v", TYPES[of_index], 3)])
    index = np.frombuffer(body, face, faces, offset=vertex.nbytes)["v"].astype(np.int64)
    return np.stack([vertex[c].astype(np.float64) for c in "xyz"], axis=-1)[index]


def _glb(data: bytes) -> Floats:
    size = int.from_bytes(data[12:16], "little")
    document, binary = json.loads(data[20 : 20 + size]), data[28 + size :]
    found: list[Floats] = []
    roots = document["scenes"][document.get("scene", 0)]["nodes"]
    for root in roots:
        _walk(document, binary, root, np.eye(4), found)
    return 1e3 * np.concatenate(found)


def _walk(
    document: Mapping[str, Any], binary: bytes, number: int, above: Floats, found: list[Floats]
) -> None:
    node = document["nodes"][number]
    pose = above @ _pose(node)
    if "mesh" in node:
        corners = _primitives(document, binary, node["mesh"])
        moves = node.get("extensions", {}).get("EXT_mesh_gpu_instancing")
        places = [np.eye(4)]
        if moves is not None:
            steps = _accessor(document, binary, moves["attributes"]["TRANSLATION"]).reshape(-1, 3)
            places = [_moved(step) for step in steps]
        for place in places:
            whole = pose @ place
            found.append(corners @ whole[:3, :3].T + whole[:3, 3])
    for child in node.get("children", ()):
        _walk(document, binary, child, pose, found)


def _pose(node: Mapping[str, Any]) -> Floats:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    pose = _moved(node.get("translation", (0.0, 0.0, 0.0)))
    pose[:3, :3] = turn * np.array(node.get("scale", (1.0, 1.0, 1.0)))
    return pose


def _moved(step: Any) -> Floats:
    pose = np.eye(4)
    pose[:3, 3] = step
    return pose


def _primitives(document: Mapping[str, Any], binary: bytes, mesh: int) -> Floats:
    every = []
    for part in document["meshes"][mesh]["primitives"]:
        points = _accessor(document, binary, part["attributes"]["POSITION"]).reshape(-1, 3)
        every.append(points[_accessor(document, binary, part["indices"]).astype(np.int64).reshape(-1, 3)])
    return np.concatenate(every)


def _accessor(document: Mapping[str, Any], binary: bytes, number: int) -> Floats:
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    kind = {5126: "<f4", 5125: "<u4", 5123: "<u2", 5121: "u1"}[accessor["componentType"]]
    many = accessor["count"] * {"SCALAR": 1, "VEC3": 3}[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    return np.frombuffer(binary, kind, many, start).astype(np.float64)


def _threemf(data: bytes) -> Floats:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        model = ElementTree.fromstring(archive.read("3D/3dmodel.model"))
    objects = {entry.get("id"): entry for entry in model.iter(f"{CORE}object")}
    kept: dict[str, Floats] = {}

    def corners(name: str) -> Floats:
        if name not in kept:
            kept[name] = _object(objects[name], corners)
        return kept[name]

    whole = [
        _placed(corners(str(item.get("objectid"))), item.get("transform"))
        for item in model.iter(f"{CORE}item")
    ]
    return np.concatenate(whole) * UNITS[model.get("unit", "millimeter")]


def _object(entry: ElementTree.Element, corners: Any) -> Floats:
    mesh = entry.find(f"{CORE}mesh")
    if mesh is None:
        parts = [
            _placed(corners(str(c.get("objectid"))), c.get("transform"))
            for c in entry.iter(f"{CORE}component")
        ]
        return np.concatenate(parts)
    points = np.array([[float(v.get(c, "")) for c in "xyz"] for v in mesh.iter(f"{CORE}vertex")])
    index = [[int(t.get(c, "")) for c in ("v1", "v2", "v3")] for t in mesh.iter(f"{CORE}triangle")]
    return np.asarray(points[np.array(index)])


def _placed(corners: Floats, transform: str | None) -> Floats:
    if transform is None:
        return corners
    rows = np.array([float(v) for v in re.split(r"\s+", transform.strip())]).reshape(4, 3)
    return np.asarray(corners @ rows[:3] + rows[3])
