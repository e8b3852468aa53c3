"""A photograph behind a design's sheet, as an eye sees it with and without the sheet."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clacad.config import edit_text as override
from clacad.config.mistakes import Mistake
from clacad.design import load
from clacad.prescription.prescribe import prescribe
from clacad.rendering.photographs import picture_size
from clacad.rendering.picture import Picture, view_through
from clacad.rendering.sheet_passage import Passage
from clacad.scene import Scene
from clacad.sheet.window import Window


@dataclass(frozen=True, slots=True)
class EyeRequest:
    """Positions of the eye and the photograph.

    eye : Distance of the eye before the sheet, design units; None: four times the sheet's width.
    distance : Distance of the photograph behind the sheet; None: twice the sheet's width.
    height : Height of the photograph; None: it fills the view without the sheet.
    aside : (float, float). Displacement of the eye to the right and up from the sheet's middle.
    pixels : Across the picture.
    """

    design: Path
    photo: Path
    eye: float | None = None
    distance: float | None = None
    height: float | None = None
    aside: tuple[float, float] = (0.0, 0.0)
    pixels: int = 480
    samples: int = 16


MARGIN = 1.25
"""Width of the picture over the width of the sheet."""


def eye_scene(request: EyeRequest, overrides: tuple[str, ...] = ()) -> Scene:
    """The scene through the sheet.

    overrides : "key=value" each, of the design.
    Raises DesignError, SceneError, BadPicture, OverBudget, OSError.
    """
    design = load(request.design, overrides)
    folder = os.path.commonpath([request.design.resolve().parent, request.photo.resolve().parent])
    data: dict[str, Any] = {
        "format": 1,
        "name": f"{design.name} - {request.photo.stem}"[:80].replace("'", "").replace('"', ""),
        "unit": design.unit,
        "sheet": {
            "design": os.path.relpath(request.design.resolve(), folder),
            "set": dict(_read(text) for text in overrides),
        },
        "light": {"ambient": 1.0, "key": 0.0},
        "background": {"sky": [[0.02, 0.02, 0.02]] * 2, "ground": [0.02, 0.02, 0.02]},
        **_camera_and_screen(request, prescribe(design), os.path.relpath(request.photo.resolve(), folder)),
    }
    return Scene.from_dict(data, folder=folder)


def _camera_and_screen(request: EyeRequest, window: Window, photo: str) -> dict[str, Any]:
    """A scene's camera at the eye, and its only object, the photograph on a screen; design units."""
    x0, x1, y0, y1 = window.lattice.extent()
    side = max(x1 - x0, y1 - y0)
    eye = 4.0 * side if request.eye is None else request.eye
    distance = 2.0 * side if request.distance is None else request.distance
    width, tall = picture_size(request.photo)
    ratio = width / tall
    frame = MARGIN * side
    height = (
        frame * (eye + distance) / eye / min(1.0, ratio) * 1.02 if request.height is None else request.height
    )
    right, up = request.aside
    return {
        "camera": {
            "position": [-right, up, -eye],
            "frame": frame,
            "pixels": [request.pixels, request.pixels],
            "samples": request.samples,
        },
        "object": [
            {
                "id": "photo",
                "kind": "screen",
                "at": [0.0, 0.0, window.z_range[1] + distance],
                "size": [height * ratio, height],
                "pattern": "image",
                "file": photo,
            }
        ],
    }


def _read(text: str) -> tuple[str, Any]:
    found = override.parse(text)
    assert not isinstance(found, Mistake)  # the design was read with the same overrides
    return found


def without_sheet(scene: Scene, passage: Passage) -> Picture:
    """The picture without the sheet; only the words of the passage are used."""
    return view_through(scene, sheet=False, passage=passage)
