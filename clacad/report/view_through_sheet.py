"""A small picture through the sheet, and the same view without it: what the numbers look like."""

from __future__ import annotations

import io
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.reading_budgets import BUDGETS
from clacad.base.regular_file import read_regular
from clacad.base.units import millimetres
from clacad.design.cell_table import table_path
from clacad.design.sections import AimedAt
from clacad.sheet.vignetting import aperture_slope, half_field, thin_cells
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.base.types import Progress
    from clacad.design import Design
    from clacad.scene import Scene

PIXELS = 260
SAMPLES = 4
EFFECTS = ("ghosts",)
"""Shown here; what the others would change is said by the plan of the report."""

INSIDE = 0.35
"""Part of the half field of view that the sheet fills as the eye sees it, if that can be had from 4 to 60 widths."""


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


def look(design: Design, window: Window, progress: Progress) -> Look:
    """Render a figure on a chequered floor, seen past and through the sheet.

    By numpy: so small a picture takes about as long as loading what is compiled, which on a fresh machine takes half a minute to make.
    """
    from clacad.rendering.picture import view_through
    from clacad.rendering.picture_files import pixels_of

    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "design.toml").write_text(design.canonical_toml(), encoding="utf-8")
        _copy_table(design, Path(folder))
        scene = _scene(design, window, folder)
        progress("looking through the sheet", 0.0)
        without = view_through(scene, sheet=False, window=window, compiled=False)
        through = view_through(
            scene, window=window, compiled=False,
            progress=lambda _, part: progress("looking through the sheet", part or 0.0),
        )  # fmt: skip
    eye, behind, high, _ = _distances(design, window)
    mm = millimetres(window.unit)
    said = (
        f"a chess knight {high * mm:.4g} mm high on a chequered floor, {behind * mm:.4g} mm behind the sheet; the eye is "
        f"{eye * mm:.4g} mm before it"
    )
    how = f"rung {through.passage.rung}; shown beyond refraction: {', '.join(through.passage.names) or 'nothing'}"
    return Look(_png(pixels_of(without)), _png(pixels_of(through)), how, said)


def _copy_table(design: Design, folder: Path) -> None:
    """Put the table of cells that a design names where the copy of the design names it."""
    spec = design.law_spec.varying
    if spec is not None and spec.table is not None:
        copy = folder / spec.table.file.replace("\\", "/")
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(read_regular(table_path(design.path, spec.table.file), BUDGETS["cell-table"].bytes))


def _distances(design: Design, window: Window) -> tuple[float, float, float, tuple[float, float]]:
    """Eye before the sheet, figure behind it, height of the figure, lengths; and the slope from the eye to the sheet's middle.

    The eye is where the sheet is aimed at, else in the middle of the field of view, wherever that is.
    """
    wide, aperture = _width(window), design.lattice.aperture
    if isinstance(aperture, AimedAt) and aperture.point[2] < 0.0:
        x, y, z = aperture.point
        eye, slope = -z, (x / z, y / z)
    else:
        half = min(half_field(thin_cells(window)))
        eye, slope = float(np.clip(0.5 / (INSIDE * half), 4.0, 60.0)) * wide, aperture_slope(window)
    behind = 0.2 * eye
    return eye, behind, 0.75 * wide * (eye + behind) / eye, slope


def _png(pixels: Any) -> bytes:
    from PIL import Image

    out = io.BytesIO()
    # 256 colours of one palette are enough for a picture of this size, and a third of the bytes
    Image.fromarray(pixels).quantize(256, method=Image.Quantize.MEDIANCUT).save(out, "PNG", optimize=True)
    return out.getvalue()


def _width(window: Window) -> float:
    x0, x1, y0, y1 = window.lattice.extent()
    return max(x1 - x0, y1 - y0)


def _scene(design: Design, window: Window, folder: str) -> Scene:
    """The scene that is looked at: a chess knight on a floor behind the sheet, in the middle of the field of view."""
    from clacad.scene import Scene

    wide = _width(window)
    eye, behind, high, (ax, ay) = _distances(design, window)
    floor = -0.5 * high
    data: dict[str, Any] = {
        "format": 1,
        "name": "look",
        "unit": design.unit,
        "sheet": {"design": "design.toml", "rung": "surfaces"},
        "effects": {"mode": "list", "list": list(EFFECTS)},
        "camera": {
            "position": [-eye * ax, -eye * ay, -eye], "target": [0, 0, 0], "frame": 1.25 * wide,
            "pixels": [PIXELS, PIXELS], "samples": SAMPLES,
        },
        "object": [
            {"id": "floor", "kind": "checker", "height": floor, "tile": high, "colours": ["#d8c29a", "#5b3f26"]},
            {"id": "knight", "kind": "knight", "at": [behind * ax, floor, window.z_range[1] + behind], "size": high,
             "colour": "#3a3f52", "turn": [0, 35, 0]},
        ],
    }  # fmt: skip
    return Scene.from_dict(data, folder=folder)
