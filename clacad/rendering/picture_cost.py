"""Cost of a picture in processor seconds: some of its own pixels are rendered, because scenes differ a
hundredfold.

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
"""Seconds to compile what draws a picture, of geometry alone; with effects up to half as much again."""

COMPILED = "compiling what draws pictures"
"""Name under which the compile time is recorded."""

MEASURED = 1.3
"""Factor by which an extrapolation from a part of some work may be wrong."""

FIXED = 0.05
"""Seconds of a picture apart from its rays."""

ENOUGH = 0.1
"""Seconds of the tried pixels from which on they are representative."""

MUCH = 3.0
"""Least ratio of the time of all tried pixels to that of the first ones."""

FIRST = 3
"""Pixels along each side of the patches that are tried first; doubled until they suffice."""

SQUARES, NOISY = 5, 3
"""Squares along a side of the picture used to estimate the samples of a noise target, and pixels along a side
of each.
"""

GRID = 24
"""Pixels along a side of the picture from which the share that looks at a sheet is found."""

PATCHES = ((0.31, 0.22), (0.44, 0.61), (0.57, 0.35), (0.7, 0.83))
"""Positions of the patches in the picture, down and across."""


def picture_seconds(scene: Scene, passage: Passage, frames: int = 1) -> Span:
    """Processor seconds of a still, or of `frames` similar ones; some pixels show how often a noise target
    repeats them.

    The range is narrow where the time of a pixel does not depend on how many are drawn together. It is wide
    where a block takes less than its pixels one by one, as with effects that split light.

    Parameters
    ----------
    scene : Scene
        A still.
    passage : Passage
        As planned by `sheet_passage.plan_passage`.
    frames : int
    """
    view = aim(scene.camera)
    viewing = set_up(scene, prescribe(scene.design()), worth_compiling(scene, frames), passage)
    least, most = _seconds_a_pixel(viewing, view, int(scene.camera.samples))
    many = _again(viewing, scene, view) * view.width * view.height
    least *= _emptier(viewing, view)
    return Span(frames * (FIXED + least * many) / MEASURED, frames * (FIXED + most * many) * MEASURED)


def _again(viewing: Viewing, scene: Scene, view: View) -> float:
    """Samples of a pixel relative to its first ones, from squares of pixels all over the picture."""
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
    """Share of the whole picture that looks at a sheet, relative to that of the tried patches; at most 1."""
    rows, columns = (np.linspace(0, n - 1, min(n, GRID)).astype(np.int64) for n in (view.height, view.width))
    tried_at = np.concatenate([_patch(view, FIRST, at) for at in PATCHES])
    shares = [
        may_cross(viewing.box, *rays(view, pixels, np.full((len(pixels), 1, 4), 0.5))).mean()
        for pixels in ((rows[:, None] * view.width + columns).ravel(), tried_at)
    ]
    return min(1.0, float(shares[0] / shares[1])) if shares[0] > 0.0 < shares[1] else 1.0


def _seconds_a_pixel(viewing: Viewing, view: View, samples: int) -> tuple[float, float]:
    """Least and largest processor seconds of a pixel, from some pixels spread over the picture.

    Both are the additional time of additional pixels: the measured one, and its extrapolation up to a block
    of rays.
    """
    side, whole = FIRST, view.width * view.height
    _spent(viewing, view, side, samples)  # loads what is compiled
    first, fewest = before, few = _spent(viewing, view, side, samples)
    while True:
        side *= 2
        took, many = _spent(viewing, view, side, samples)
        # a block has a fixed cost even with few rays: it must not be attributed to the rays
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
    """Processor seconds of some square patches of a picture, of `side` pixels a side, and their number of
    pixels.

    Neighbours look through the same lenslets, and rays through one lenslet take less time together. Widely
    spaced pixels would represent another picture.
    """
    pixels = np.unique(np.concatenate([_patch(view, side, at) for at in PATCHES]))
    began = time.thread_time()
    tried(viewing, view, pixels, samples)
    return time.thread_time() - began, len(pixels)


def _patch(view: View, side: int, at: tuple[float, float]) -> Ints:
    """Pixels of a square patch about a position in the picture, (0 … 1, 0 … 1), as far as it lies inside."""
    y, x = (
        np.arange(side) + int(part * size) - side // 2
        for part, size in zip(at, (view.height, view.width), strict=True)
    )
    y, x = y[(y >= 0) & (y < view.height)], x[(x >= 0) & (x < view.width)]
    return (y[:, None] * view.width + x).ravel().astype(np.int64)


def task(scene: Scene, frames: int = 1) -> str:
    """Name under which the time of such a picture, or of `frames` similar ones, is recorded.

    Rung, effects and path determine the time of a ray.
    """
    rungs = "+".join(one.rung for one in scene.sheets)
    path = "compiled" if worth_compiling(scene, frames) else "numpy"
    return f"render {rungs} {scene.effects.mode} {path}"


ATLAS = "atlas"
"""Name under which the time of an atlas is recorded."""

LABELLED, PER_ATLAS_RAY, PER_FIGURE, PER_SOLID_RAY = 0.1, 1.7e-7, 2.0, 7e-6
"""Seconds of a picture apart from its rays, a ray through lenses, measuring a figure, a ray of Fig. 1(b)."""


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
