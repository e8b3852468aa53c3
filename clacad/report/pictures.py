"""Pictures of a report: its parts in three dimensions, and the view through the sheet.

The parts are a few cells as triangles with exact normals, packed for the page. The view is a small picture
through the sheet, next to the same view without it.
"""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.base.units import millimetres
from clacad.base.untrusted_files import BUDGETS, read_regular
from clacad.design.cell_table import table_path
from clacad.report.figures import ray_fan
from clacad.sheet.vignetting import aperture_slope, half_field, thin_cells
from clacad.sheet.window import Window
from clacad.storage.atomic import scratch_folder

if TYPE_CHECKING:
    from clacad.base.types import Progress
    from clacad.design import Design
    from clacad.scene import Scene


COLOURS = ((0.36, 0.60, 0.80), (0.42, 0.70, 0.52), (0.7, 0.6, 0.4))
LONGEST = 3.0
"""Depth over width of the shown piece beyond which the gap between bodies is drawn shorter, with a note."""
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

    cells : A side.
    gap_built, gap_shown : lengths. Along z between the bodies; 0 for a slab.
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
    from clacad.mesh.tessellation import shaded_rows
    from clacad.sheet.feasibility import body_range

    depth = window.z_range[1] - window.z_range[0]
    cells = int(np.clip(round(depth / max(window.lattice.pitch) / 2.0), 3, MOST_CELLS))
    cells = min(cells, max(window.lattice.count))
    few = window.with_cells((min(cells, window.lattice.count[0]), min(cells, window.lattice.count[1])))
    quads = 10 if cells <= 3 else 8 if cells <= 5 else 6
    pieces = []
    for body in tessellate(few, quads=quads).bodies:
        corners, normals = zip(*shaded_rows(body), strict=True)
        pieces.append(_welded(body.body.name, np.concatenate(corners), np.concatenate(normals)))
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
        index = piece.triangles.astype("<u2")
        for name, values in (("place", place), ("normal", normal), ("index", index)):
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


PIXELS = 260
VIEWER_PIXELS = 200
SAMPLES = 4
EFFECTS = ("ghosts",)
"""Effects shown here; the plan of the report lists what the others would change."""

INSIDE = 0.35
"""Part of the half field of view that the sheet fills for the eye, if possible from 4 to 60 widths."""


@dataclass(frozen=True, slots=True)
class Look:
    """Two pictures as PNG, and how they were made.

    without, through : bytes
    how : Rung and effects, as planned.
    scene : What is seen.
    """

    without: bytes
    through: bytes
    how: str
    scene: str
    pixels: int = PIXELS


@dataclass(frozen=True, slots=True)
class _Viewpoint:
    """Where the eye and the figure are, and how large the figure is: sheet frame, lengths.

    eye : (x, y, z)
    figure : (x, z). Its foot is on the floor, half its height below the axis.
    """

    eye: tuple[float, float, float]
    figure: tuple[float, float]
    height: float


def look(design: Design, window: Window, progress: Progress) -> Look:
    """Render a figure on a chequered floor, seen past and through the sheet.

    By numpy: so small a picture takes about as long as loading what is compiled, which a fresh machine first
    has to make in twenty seconds and more.
    """
    from clacad.rendering.picture import view_through
    from clacad.rendering.picture_files import pixels_of

    place, behind = _in_field(design, window)
    with _scene_of(design, window, place, "surfaces", PIXELS) as scene:
        progress("looking through the sheet", 0.0)
        without = view_through(scene, sheet=False, window=window, compiled=False)
        through = view_through(
            scene,
            window=window,
            compiled=False,
            progress=lambda _, part: progress("looking through the sheet", part or 0.0),
        )
    mm = millimetres(window.unit)
    said = (
        f"a chess knight {place.height * mm:.4g} mm high on a chequered floor, {behind * mm:.4g} mm behind"
        f" the sheet; the eye is {-place.eye[2] * mm:.4g} mm before it, "
        + ("in the middle of the field of view" if _stated_eye(design, window) is None else "as stated")
    )
    how = (
        f"rung {through.passage.rung}; shown beyond refraction:"
        f" {', '.join(through.passage.names) or 'nothing'}"
    )
    return Look(_png(pixels_of(without)), _png(pixels_of(through)), how, said)


def seen_by_viewer(design: Design, window: Window) -> bytes | None:
    """Render what the viewer of the check `viewed` sees through the whole sheet, by ideal lenses.

    None for a viewer behind the sheet or nearer than a pitch, and where the scene is larger than scenes may
    be.

    window : of the whole sheet, whose cells may differ.
    """
    from clacad.rendering.picture import view_through
    from clacad.rendering.picture_files import pixels_of
    from clacad.scene import SceneError
    from clacad.verification.light.viewed import viewer_of

    viewer = viewer_of(design)
    if not _before(window, viewer):
        return None
    behind = design.check.object
    place = _placed(window, viewer, (0.0, 0.0), 0.2 * -viewer[2] if behind is None else behind)
    try:
        with _scene_of(design, window, place, "thin", VIEWER_PIXELS) as scene:
            return _png(pixels_of(view_through(scene, window=window, compiled=False)))
    except SceneError:
        return None


@contextmanager
def _scene_of(design: Design, window: Window, place: _Viewpoint, rung: str, pixels: int) -> Iterator[Scene]:
    """The scene of a viewpoint, with a copy of the design as long as it is used."""
    with scratch_folder() as folder:
        (folder / "design.toml").write_text(design.canonical_toml(), encoding="utf-8")
        _copy_table(design, folder)
        yield _scene(design, window, str(folder), place, rung, pixels)


def _copy_table(design: Design, folder: Path) -> None:
    """Put the table of cells that a design names where the copy of the design names it."""
    spec = design.law_spec.varying
    if spec is not None and spec.table is not None:
        copy = folder / spec.table.file.replace("\\", "/")
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(read_regular(table_path(design.path, spec.table.file), BUDGETS["cell-table"].bytes))


def _before(window: Window, viewer: tuple[float, float, float]) -> bool:
    """Whether an eye is a pitch and more before the sheet."""
    return viewer[2] < window.z_range[0] - max(window.lattice.pitch)


def _stated_eye(design: Design, window: Window) -> tuple[float, float, float] | None:
    """Where the design states the eye, before the sheet; else None."""
    from clacad.verification.light.viewed import states_viewer, viewer_of

    eye = viewer_of(design)
    return eye if states_viewer(design) and _before(window, eye) else None


def _in_field(design: Design, window: Window) -> tuple[_Viewpoint, float]:
    """The viewpoint of the page's large pictures, and the figure's distance behind the sheet.

    The eye is where the design states it, else in the middle of the field of view.
    """
    stated = _stated_eye(design, window)
    if stated is not None:
        x, y, z = stated
        eye, slope = -z, (x / z, y / z)
    else:
        half = min(half_field(thin_cells(window)))
        eye = float(np.clip(0.5 / (INSIDE * half), 4.0, 60.0)) * _width(window)
        slope = aperture_slope(window)
    behind = 0.2 * eye
    return _placed(window, (-eye * slope[0], -eye * slope[1], -eye), slope, behind), behind


def _placed(
    window: Window, eye: tuple[float, float, float], slope: tuple[float, float], behind: float
) -> _Viewpoint:
    """Viewpoint of an eye, its figure `behind` the sheet where a line of that slope through it meets it."""
    height = 0.75 * _width(window) * (behind - eye[2]) / -eye[2]
    return _Viewpoint(eye, (behind * slope[0], window.z_range[1] + behind), height)


def _png(pixels: Any) -> bytes:
    from PIL import Image

    out = io.BytesIO()
    # 256 colours of one palette are enough for a picture of this size, and a third of the bytes
    Image.fromarray(pixels).quantize(256, method=Image.Quantize.MEDIANCUT).save(out, "PNG", optimize=True)
    return out.getvalue()


def _width(window: Window) -> float:
    x0, x1, y0, y1 = window.lattice.extent()
    return max(x1 - x0, y1 - y0)


def _scene(design: Design, window: Window, folder: str, place: _Viewpoint, rung: str, pixels: int) -> Scene:
    """The scene of a viewpoint: a chess knight on a floor behind the sheet."""
    from clacad.scene import Scene

    high, floor = place.height, -0.5 * place.height
    x, z = place.figure
    data: dict[str, Any] = {
        "format": 1,
        "name": "look",
        "unit": design.unit,
        "sheet": {"design": "design.toml", "rung": rung},
        "effects": {"mode": "list", "list": list(EFFECTS)},
        "camera": {
            "position": list(place.eye),
            "target": [0, 0, 0],
            "frame": 1.25 * _width(window),
            "pixels": [pixels, pixels],
            "samples": SAMPLES,
        },
        "object": [
            {
                "id": "floor",
                "kind": "checker",
                "height": floor,
                "tile": high,
                "colours": ["#d8c29a", "#5b3f26"],
            },
            {
                "id": "knight",
                "kind": "knight",
                "at": [x, floor, z],
                "size": high,
                "colour": "#3a3f52",
                "turn": [0, 35, 0],
            },
        ],
    }
    return Scene.from_dict(data, folder=folder)
