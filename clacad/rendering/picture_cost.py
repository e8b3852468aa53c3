"""What a picture costs in processor seconds, by a model of one reference machine; see `clacad.base.machine_rates`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from clacad.rendering.picture import SMALL_PICTURE
from clacad.scene import Scene

if TYPE_CHECKING:
    from clacad.rendering.atlas.make_atlas import AtlasJob

FIXED = 0.4
PER_RAY = {"numpy": 8e-6, "compiled": 1.2e-6}


def picture_seconds(scene: Scene, frames: int = 1) -> float:
    """Processor seconds of a still, or of so many frames."""
    return frames * (FIXED + PER_RAY[_path(scene)] * _rays(scene))


def task(scene: Scene) -> str:
    """Name under which such a picture is noted: rung, effects and path decide what a ray costs."""
    return f"render {scene.sheet.rung} {scene.effects.mode} {_path(scene)}"


ATLAS = "atlas"
"""Name under which an atlas is noted."""

LABELLED, PER_ATLAS_RAY, PER_FIGURE, PER_SOLID_RAY = 0.1, 1.7e-7, 2.0, 7e-6
"""Seconds of a picture apart from its rays, of a ray through lenses, of measuring a figure, of a ray of Fig. 1(b)."""


def atlas_seconds(job: AtlasJob) -> float:
    """Processor seconds of an atlas: its stills, the frames of its movies, and what is measured."""
    frames = [still for movie in job.movies for still in movie.frames]
    total = _drawn(list(job.stills.values())) + _drawn(frames)
    if job.first is not None:
        total += LABELLED + PER_SOLID_RAY * _rays(job.first[1])
    measured = len(job.figures) + (job.first is not None)
    return total + (PER_FIGURE * measured if job.request.measured else 0.0)


def _drawn(stills: Sequence[Scene]) -> float:
    return sum(LABELLED + PER_ATLAS_RAY * _rays(still) for still in stills)


def _rays(scene: Scene) -> int:
    width, height = scene.camera.pixels
    return int(width * height * scene.camera.samples)


def _path(scene: Scene) -> str:
    return "compiled" if _rays(scene) > SMALL_PICTURE else "numpy"
