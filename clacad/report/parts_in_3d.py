"""The parts in three dimensions: a few cells as triangles with exact normals, packed for the page, and a
picture of them.
"""

from __future__ import annotations

import base64
import io
import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.report.figures import ray_fan
from clacad.sheet.window import Window

COLOURS = ((0.36, 0.60, 0.80), (0.42, 0.70, 0.52), (0.7, 0.6, 0.4))
LONGEST = 3.0
"""Depth over width of the shown piece beyond which the gap between the bodies is drawn shorter, with a
note."""
MOST_CELLS = 7
PICTURE = (720, 400)


@dataclass(frozen=True, eq=False)
class BodyTriangles:
    """Triangles of one body: vertices (v, 3) lengths, outward normals (v, 3), triangles (t, 3)."""

    name: str
    vertices: Floats
    normals: Floats
    triangles: Ints


@dataclass(frozen=True, eq=False)
class Parts:
    """What is shown: the bodies of a window of a few cells, and rays through its middle.

    cells : int
        A side.
    gap_built, gap_shown : float, lengths
        Along z between the bodies; 0 for a slab.
    """

    pieces: tuple[BodyTriangles, ...]
    rays: tuple[Floats, ...]
    cells: int
    gap_built: float
    gap_shown: float

    @property
    def box(self) -> Floats:
        """Low and high corner (2, 3) as built."""
        low = np.min([p.vertices.min(axis=0) for p in self.pieces], axis=0)
        high = np.max([p.vertices.max(axis=0) for p in self.pieces], axis=0)
        return np.array([low, high])

    def facets(self) -> int:
        """Triangles of all bodies."""
        return sum(len(p.triangles) for p in self.pieces)


def parts(window: Window) -> Parts:
    """Mesh a window of a few cells for looking at."""
    from clacad.mesh import tessellate
    from clacad.mesh.vertex_normals import corner_normals
    from clacad.sheet.feasibility import body_range

    depth = window.z_range[1] - window.z_range[0]
    cells = int(np.clip(round(depth / max(window.lattice.pitch) / 2.0), 3, MOST_CELLS))
    cells = min(cells, max(window.lattice.count))
    few = window.with_cells((min(cells, window.lattice.count[0]), min(cells, window.lattice.count[1])))
    quads = 10 if cells <= 3 else 8 if cells <= 5 else 6
    pieces = []
    for body in tessellate(few, quads=quads).bodies:
        corners = np.concatenate([np.asarray(rows, dtype=np.float64) for rows in body.rows()])
        normals = np.concatenate(list(corner_normals(body)))
        pieces.append(_welded(body.body.name, corners, normals))
    gap = 0.0
    if len(few.bodies) > 1:
        gap = max(0.0, body_range(few, few.bodies[1])[0] - body_range(few, few.bodies[0])[1])
    width = cells * max(window.lattice.pitch)
    shown = gap if depth <= LONGEST * width else max(min(gap, LONGEST * width - (depth - gap)), 0.02 * gap)
    middle = ray_fan(window)
    return Parts(tuple(pieces), tuple(middle) if cells % 2 else (), cells, gap, shown)


def _welded(name: str, corners: Floats, normals: Floats) -> BodyTriangles:
    """Corners with equal place and normal made one vertex."""
    keys = np.concatenate([corners.reshape(-1, 3), normals.reshape(-1, 3)], axis=1)
    size = np.abs(corners).max() or 1.0
    whole = np.rint(keys * np.array([1e6 / size] * 3 + [120.0] * 3)).astype(np.int64)
    _, first, number = np.unique(whole, axis=0, return_index=True, return_inverse=True)
    return BodyTriangles(name, keys[first, :3], keys[first, 3:], number.reshape(-1, 3))


def packed(shown: Parts) -> tuple[str, str]:
    """Facts as JSON, and the triangles as base64 of 16-bit places, 8-bit normals and 16-bit numbers."""
    low, high = shown.box
    unit = float(np.abs(shown.box).max()) / 32000.0
    data, bodies = bytearray(), []
    for number, piece in enumerate(shown.pieces):
        entry: dict[str, Any] = {
            "name": piece.name,
            "number": number,
            "colour": COLOURS[number % len(COLOURS)],
            "vertices": len(piece.vertices),
            "triangles": len(piece.triangles),
        }
        place = np.zeros((len(piece.vertices), 4), dtype="<i2")
        place[:, :3] = np.rint(piece.vertices / unit)
        normal = np.zeros((len(piece.vertices), 4), dtype="i1")
        normal[:, :3] = np.rint(127.0 * piece.normals)
        for name, values in (
            ("place", place),
            ("normal", normal),
            ("index", piece.triangles.astype("<u2")),
        ):
            data += b"\0" * (-len(data) % 4)
            entry[name] = len(data)
            data += values.tobytes()
        bodies.append(entry)
    facts = {
        "bodies": bodies,
        "unit": unit,
        "size": (high - low).tolist(),
        "middle": (0.5 * (low + high)).tolist(),
        "cut": float(0.5 * (low[1] + high[1])),
        "gap": {
            "built": shown.gap_built or 1.0,
            "shown": shown.gap_shown or (0.0 if shown.gap_built else 1.0),
        },
        "view": [YAW, PITCH],
        "light": [*LIGHT, AMBIENT, DIRECT, GLOSS],
        "rays": [np.round(ray, 9).ravel().tolist() for ray in shown.rays],
    }
    return json.dumps(facts, sort_keys=True), base64.b64encode(bytes(data)).decode("ascii")


YAW, PITCH = -0.85, 0.42
"""First view, radians: the side of lens 2, from the right and above."""

LIGHT = (0.82, 0.52, 0.1)
AMBIENT, DIRECT, GLOSS = 0.42, 0.95, 0.05
"""Light of the viewer's shader; the picture uses the same."""


def picture(shown: Parts) -> bytes:
    """The viewer's first view as a PNG, for paper and where there is no WebGL."""
    from PIL import Image

    from clacad.report.compiled_fill import fill

    wide, tall = (2 * n for n in PICTURE)
    turn = _turn(YAW, PITCH)
    low, high = shown.box
    shift = np.array([0.0, 0.0, shown.gap_shown - shown.gap_built])
    middle = 0.5 * (low + high + shift)
    seen = [(p.vertices + (shift if k else 0.0) - middle) @ turn.T for k, p in enumerate(shown.pieces)]
    every = np.concatenate(seen)[:, :2]
    least, most = every.min(axis=0), every.max(axis=0)
    scale = 0.9 * float(min(wide / (most[0] - least[0]), tall / (most[1] - least[1])))
    off = 0.5 * (least + most)
    image = np.full((tall, wide, 3), 0.975)
    depth = np.full((tall, wide), -np.inf)
    light = np.array(LIGHT) / np.linalg.norm(LIGHT)
    for number, (piece, place) in enumerate(zip(shown.pieces, seen, strict=True)):
        flat = np.column_stack(
            [
                0.5 * wide + scale * (place[:, 0] - off[0]),
                0.5 * tall - scale * (place[:, 1] - off[1]),
                place[:, 2],
            ]
        )
        normal = piece.normals @ turn.T
        bright = (
            AMBIENT + DIRECT * np.maximum(normal @ light, 0.0) + GLOSS * np.maximum(normal[:, 2], 0.0) ** 8
        )
        shade = np.full((tall, wide), np.nan)
        fill(flat[piece.triangles], bright[piece.triangles], depth, shade)
        drawn = np.isfinite(shade)
        image[drawn] = shade[drawn][:, None] * np.array(COLOURS[number % len(COLOURS)])
    small = image.reshape(PICTURE[1], 2, PICTURE[0], 2, 3).mean(axis=(1, 3))
    out = io.BytesIO()
    Image.fromarray(np.rint(255 * np.clip(small, 0.0, 1.0)).astype(np.uint8)).save(out, "PNG", optimize=True)
    return out.getvalue()


def _turn(yaw: float, pitch: float) -> Floats:
    """Sheet to screen (right, up, towards the eye): the viewer's own first view."""
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    basis = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    return np.asarray(
        np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
        @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        @ basis
    )
