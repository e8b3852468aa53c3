"""What a picture costs in processor seconds: a few of its own pixels are rendered, for scenes differ a hundredfold.

An atlas is forecast by a model of one reference machine; see `clacad.base.machine_rates`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from math import log
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.machine_rates import Span
from clacad.base.types import Ints
from clacad.prescription.prescribe import prescribe
from clacad.rendering.camera import View, aim, rays
from clacad.rendering.picture import BLOCK, tile, tried, worth_compiling
from clacad.rendering.view import may_cross, set_up
from clacad.rendering.viewing import Viewing
from clacad.scene import Scene

if TYPE_CHECKING:
    from clacad.rendering.atlas.make_atlas import AtlasJob
    from clacad.rendering.sheet_passage import Passage

COMPILING = 40.0
"""Seconds of compiling what draws a picture, of geometry alone; with effects up to half as much again."""

COMPILED = "compiling what draws pictures"
"""Name under which that is noted."""

MEASURED = 1.3
"""Factor by which a part of some work tells what the whole takes."""

FIXED = 0.05
"""Seconds of a picture apart from its rays."""

ENOUGH = 0.1
"""Seconds of the pixels that are tried, from which on they tell what the others take."""

MUCH = 3.0
"""Times what the first of them take that they must take."""

FIRST = 3
"""Pixels along each side of the patches that are tried first; twice as many until they are enough."""

SQUARES, NOISY = 5, 3
"""Squares along a side of the picture that tell how many samples a noise target takes, and pixels along a side of each."""

GRID = 24
"""Pixels along a side of the picture by which it is seen how much of it looks at a sheet."""

PATCHES = ((0.31, 0.22), (0.44, 0.61), (0.57, 0.35), (0.7, 0.83))
"""Where in the picture they are, down and across."""


def picture_seconds(scene: Scene, passage: Passage, frames: int = 1) -> Span:
    """Processor seconds of a still, or of so many frames like it; some pixels tell how often a noise target takes them again.

    The range is narrow where pixels take the same however many are drawn together, and wide where a block of them takes
    less than they do one by one, as with effects that split light.

    Parameters
    ----------
    scene : Scene
        A still.
    passage : Passage
        As `sheet_passage.plan_passage` plans it.
    frames : int
    """
    view = aim(scene.camera)
    viewing = set_up(scene, prescribe(scene.design()), worth_compiling(scene, frames), passage)
    least, most = _seconds_a_pixel(viewing, view, int(scene.camera.samples))
    many = _again(viewing, scene, view) * view.width * view.height
    least *= _emptier(viewing, view)
    return Span(frames * (FIXED + least * many) / MEASURED, frames * (FIXED + most * many) * MEASURED)


def _again(viewing: Viewing, scene: Scene, view: View) -> float:
    """Samples of a pixel over those it gets at first, by squares of pixels all over the picture."""
    if not scene.camera.noise > 0.0:
        return 1.0
    counts = []
    for y in (np.arange(SQUARES) + 0.5) * (view.height / SQUARES):
        for x in (np.arange(SQUARES) + 0.5) * (view.width / SQUARES):
            rows = slice(int(y), min(int(y) + NOISY, view.height))
            columns = slice(int(x), min(int(x) + NOISY, view.width))
            counts.append(tile(viewing, scene, view, rows, columns)[1].mean())
    return float(np.mean(counts)) / scene.camera.samples


def _emptier(viewing: Viewing, view: View) -> float:
    """Share of the whole picture that looks at a sheet over that of the places that are tried; 1 where it is no less."""
    rows, columns = (np.linspace(0, n - 1, min(n, GRID)).astype(np.int64) for n in (view.height, view.width))
    tried_at = np.concatenate([_patch(view, FIRST, at) for at in PATCHES])
    shares = [
        may_cross(viewing.box, *rays(view, pixels, np.full((len(pixels), 1, 4), 0.5))).mean()
        for pixels in ((rows[:, None] * view.width + columns).ravel(), tried_at)
    ]
    return min(1.0, float(shares[0] / shares[1])) if shares[0] > 0.0 < shares[1] else 1.0


def _seconds_a_pixel(viewing: Viewing, view: View, samples: int) -> tuple[float, float]:
    """Processor seconds of a pixel, of some spread over the picture, at least and at most.

    Both are what so many more of them take longer: by themselves, and as that grows with their number up to a block of rays.
    """
    side, whole = FIRST, view.width * view.height
    _spent(viewing, view, side, samples)  # loads what is compiled
    first, fewest = before, few = _spent(viewing, view, side, samples)
    while True:
        side *= 2
        took, many = _spent(viewing, view, side, samples)
        # a block of rays takes something however few they are: it must not be taken for theirs
        if (took >= ENOUGH and took >= MUCH * first) or 2 * many >= whole:
            alone = max(took - first, 0.25 * took) / max(1, many - fewest)
            block = max(many, min(whole, BLOCK // samples))
            power = (
                min(1.0, max(0.0, log(took / before) / log(many / few)))
                if many > few and before > 0.0
                else 1.0
            )
            together = took * (block / many) ** power / block
            return min(alone, together), max(alone, together)
        before, few = took, many


def _spent(viewing: Viewing, view: View, side: int, samples: int) -> tuple[float, int]:
    """Processor seconds of some square patches of a picture, of so many pixels a side, and how many pixels they are.

    Neighbours look through the same lenslets, and rays through one lenslet take less together: pixels far from one
    another would tell of another picture.
    """
    pixels = np.unique(np.concatenate([_patch(view, side, at) for at in PATCHES]))
    began = time.thread_time()
    tried(viewing, view, pixels, samples)
    return time.thread_time() - began, len(pixels)


def _patch(view: View, side: int, at: tuple[float, float]) -> Ints:
    """Pixels of a square patch about a place of the picture, (0 … 1, 0 … 1), as far as it lies in it."""
    y, x = (
        np.arange(side) + int(part * size) - side // 2
        for part, size in zip(at, (view.height, view.width), strict=True)
    )
    y, x = y[(y >= 0) & (y < view.height)], x[(x >= 0) & (x < view.width)]
    return (y[:, None] * view.width + x).ravel().astype(np.int64)


def task(scene: Scene, frames: int = 1) -> str:
    """Name under which such a picture, or so many frames like it, is noted: rung, effects and path decide what a ray costs."""
    rungs = "+".join(one.rung for one in scene.sheets)
    path = "compiled" if worth_compiling(scene, frames) else "numpy"
    return f"render {rungs} {scene.effects.mode} {path}"


ATLAS = "atlas"
"""Name under which an atlas is noted."""

LABELLED, PER_ATLAS_RAY, PER_FIGURE, PER_SOLID_RAY = 0.1, 1.7e-7, 2.0, 7e-6
"""Seconds of a picture apart from its rays, of a ray through lenses, of measuring a figure, of a ray of Fig. 1(b)."""


def atlas_seconds(job: AtlasJob) -> float:
    """Processor seconds of an atlas: its stills, the frames of its movies, and what is measured."""
    frames = [still for movie in job.movies for still in movie.frames]
    twice = [job.stills[stem] for figure in job.figures if figure.ghosts_marked for stem, _ in figure.scenes]
    total = _drawn([*job.stills.values(), *twice]) + _drawn(frames)
    if job.first is not None:
        total += LABELLED + PER_SOLID_RAY * _rays(job.first[1])
    measured = len(job.figures) + (job.first is not None)
    return total + (PER_FIGURE * measured if job.request.measured else 0.0)


def _drawn(stills: Sequence[Scene]) -> float:
    return sum(LABELLED + PER_ATLAS_RAY * _rays(still) for still in stills)


def _rays(scene: Scene) -> int:
    width, height = scene.camera.pixels
    return int(width * height * scene.camera.samples)
