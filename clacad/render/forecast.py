"""What a picture costs in processor seconds, by a model of one reference machine; see `clacad.rates`."""

from __future__ import annotations

from clacad.render.picture import SMALL_PICTURE
from clacad.scene import Scene

FIXED = 0.4
PER_RAY = {"numpy": 8e-6, "compiled": 1.2e-6}


def seconds(scene: Scene, frames: int = 1) -> float:
    """Processor seconds of a still, or of so many frames."""
    return frames * (FIXED + PER_RAY[_path(scene)] * _rays(scene))


def task(scene: Scene) -> str:
    """Name under which such a picture is noted: rung, effects and path decide what a ray costs."""
    return f"render {scene.sheet.rung} {scene.effects.mode} {_path(scene)}"


def _rays(scene: Scene) -> int:
    width, height = scene.camera.pixels
    return int(width * height * scene.camera.samples)


def _path(scene: Scene) -> str:
    return "compiled" if _rays(scene) > SMALL_PICTURE else "numpy"
