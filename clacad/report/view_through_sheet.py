"""A small picture through the sheet, and the same view without it: what the numbers look like."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.units import millimetres
from clacad.base.untrusted_files import BUDGETS, read_regular
from clacad.design.cell_table import table_path
from clacad.design.sections import AimedAt
from clacad.sheet.vignetting import aperture_slope, half_field, thin_cells
from clacad.sheet.window import Window
from clacad.storage.atomic import scratch_folder

if TYPE_CHECKING:
    from clacad.base.types import Progress
    from clacad.design import Design
    from clacad.scene import Scene

PIXELS = 260
VIEWER_PIXELS = 200
SAMPLES = 4
EFFECTS = ("ghosts",)
"""Effects shown here; the plan of the report lists what the others would change."""

INSIDE = 0.35
"""Part of the half field of view that the sheet fills as the eye sees it, if that can be had from 4 to 60
widths."""


@dataclass(frozen=True, slots=True)
class Look:
    """Two pictures as PNG, and how they were made.

    without, through : bytes
    how : str
        Rung and effects, as planned.
    scene : str
        What is seen.
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
    figure : (x, z)
        Its foot is on the floor, half its height below the axis.
    height : float
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
        f" the sheet; the eye is {-place.eye[2] * mm:.4g} mm before it"
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
    if viewer[2] >= window.z_range[0] - max(window.lattice.pitch):
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


def _in_field(design: Design, window: Window) -> tuple[_Viewpoint, float]:
    """The viewpoint of the page's large pictures, and the figure's distance behind the sheet.

    The eye is where the sheet is aimed at, else in the middle of the field of view.
    """
    wide, aperture = _width(window), design.lattice.aperture
    if isinstance(aperture, AimedAt) and aperture.point[2] < 0.0:
        x, y, z = aperture.point
        eye, slope = -z, (x / z, y / z)
    else:
        half = min(half_field(thin_cells(window)))
        eye, slope = float(np.clip(0.5 / (INSIDE * half), 4.0, 60.0)) * wide, aperture_slope(window)
    behind = 0.2 * eye
    return _placed(window, (-eye * slope[0], -eye * slope[1], -eye), slope, behind), behind


def _placed(
    window: Window, eye: tuple[float, float, float], slope: tuple[float, float], behind: float
) -> _Viewpoint:
    """The viewpoint of an eye, its figure `behind` the sheet where a line of that slope through the middle
    meets it.
    """
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
