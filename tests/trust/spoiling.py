"""Mesh files taken apart and put together again with changed triangles, by nothing of the package's own."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Change = Callable[[Floats, Ints], tuple[Floats, Ints]]
"""Vertices (v, 3) and triangles (t, 3) of a file in, their replacements out."""


def changed(name: str, data: bytes, change: Change) -> bytes:
    """The file with its vertices and triangles changed; everything else as it was."""
    return {"stl": _stl, "ply": _ply, "glb": _glb, "3mf": _threemf, "obj": _obj}[name.rpartition(".")[2]](
        data, change
    )


_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])


def _stl(data: bytes, change: Change) -> bytes:
    rows = np.frombuffer(data[84:], _FACET)
    corners = rows["corners"].reshape(-1, 3).astype(float)
    vertices, triangles = change(corners, np.arange(len(corners)).reshape(-1, 3))
    made = np.zeros(len(triangles), _FACET)
    made["corners"] = vertices[triangles]
    across = np.cross(*(made["corners"][:, k] - made["corners"][:, 0] for k in (1, 2)))
    made["normal"] = across / np.maximum(np.linalg.norm(across, axis=1), 1e-30)[:, None]
    return data[:80] + len(made).to_bytes(4, "little") + made.tobytes()


def _ply(data: bytes, change: Change) -> bytes:
    head, mark, body = data.partition(b"end_header\n")
    count, faces = (int(re.search(rb"element %s (\d+)" % word, head)[1]) for word in (b"vertex", b"face"))
    table = np.frombuffer(body, "<f8", 6 * count).reshape(-1, 6).copy()
    face = np.dtype([("n", "u1"), ("v", "<i4", 3)])
    rows = np.frombuffer(body, face, faces, offset=table.nbytes)
    table[:, :3], triangles = change(table[:, :3].copy(), rows["v"].astype(np.int64))
    made = np.zeros(len(triangles), face)
    made["n"], made["v"] = 3, triangles
    head = head.replace(b"element face %d" % faces, b"element face %d" % len(triangles))
    return head + mark + table.tobytes() + made.tobytes()


def _glb(data: bytes, change: Change) -> bytes:
    size = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + size])
    binary = bytearray(data[28 + size :])
    primitive = document["meshes"][0]["primitives"][0]
    place, index = (
        document["accessors"][k] for k in (primitive["attributes"]["POSITION"], primitive["indices"])
    )
    starts = [document["bufferViews"][a["bufferView"]]["byteOffset"] for a in (place, index)]
    vertices = np.frombuffer(binary, "<f4", 3 * place["count"], starts[0]).reshape(-1, 3).astype(float)
    triangles = np.frombuffer(binary, "<u4", index["count"], starts[1]).reshape(-1, 3).astype(np.int64)
    vertices, triangles = change(vertices, triangles)
    single = vertices.astype("<f4")
    binary[starts[0] : starts[0] + single.nbytes] = single.tobytes()
    words = triangles.astype("<u4").tobytes()
    binary[starts[1] : starts[1] + len(words)] = words
    place |= {"min": single.min(axis=0).tolist(), "max": single.max(axis=0).tolist()}
    index["count"] = triangles.size
    return glb(document, bytes(binary))


def glb(document: dict[str, Any], binary: bytes) -> bytes:
    """A GLB file of a document and its buffer."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = (
        struct.pack("<II", len(text), 0x4E4F534A)
        + text
        + struct.pack("<II", len(binary), 0x004E4942)
        + binary
    )
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def document_of(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Document and buffer of a GLB file."""
    size = int.from_bytes(data[12:16], "little")
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def _threemf(data: bytes, change: Change) -> bytes:
    return model_changed(data, lambda text: _model(text, change))


def model_changed(data: bytes, change: Callable[[str], str]) -> bytes:
    """A 3MF file with the text of its model changed."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    entries["3D/3dmodel.model"] = change(entries["3D/3dmodel.model"].decode()).encode()
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return stream.getvalue()


def _model(text: str, change: Change) -> str:
    """The first mesh of the model changed."""
    head, opened, rest = text.partition("<vertices>\n")
    points, between, rest = rest.partition("</vertices>\n<triangles>\n")
    facets, closed, tail = rest.partition("</triangles>")
    vertices = np.array(re.findall(r'x="(.*?)" y="(.*?)" z="(.*?)"', points), dtype=float)
    triangles = np.array(re.findall(r'v1="(\d+)" v2="(\d+)" v3="(\d+)"', facets), dtype=np.int64)
    vertices, triangles = change(vertices, triangles)
    points = "".join(f'<vertex x="{x!r}" y="{y!r}" z="{z!r}"/>\n' for x, y, z in vertices.tolist())
    facets = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>\n' for a, b, c in triangles.tolist())
    return head + opened + points + between + facets + closed + tail


def _obj(data: bytes, change: Change) -> bytes:
    vertices = np.array(re.findall(rb"^v (\S+) (\S+) (\S+)$", data, re.M), dtype=float)
    triangles = np.array(re.findall(rb"^f (\d+) (\d+) (\d+)$", data, re.M), dtype=np.int64) - 1
    return obj(*change(vertices, triangles))


def obj(vertices: Floats, triangles: Ints) -> bytes:
    """An OBJ file."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += ["f {} {} {}".format(*(row + 1)) for row in triangles]
    return ("\n".join(lines) + "\n").encode()
