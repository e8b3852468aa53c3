"""Pictures: tiles over the cores, samples until the noise target is met, one array of linear light.

One thread computes a whole tile, which depends on nothing else, so the picture is the same on any number of
cores. Memory is that of a tile a thread, and of the picture.

A photograph behind a design's sheet, as an eye sees it with and without the sheet.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints, Progress
from clacad.config import edit_text as override
from clacad.config.mistakes import Mistake
from clacad.design import load
from clacad.prescription.prescribe import prescribe
from clacad.rendering.camera import View, Viewing, aim, offsets, rays
from clacad.rendering.photographs import picture_size
from clacad.rendering.sheet_passage import Passage
from clacad.rendering.view import SampleRange, Sums, radiance, sample, set_up
from clacad.scene import Scene, SceneError, load_scene
from clacad.sheet.window import Window

TILES = (64, 256)
"""Side of a tile, pixels: enough for a block of rays, but within these limits."""

BLOCK = 1 << 16
"""Rays traced at a time: about 20 MB of columns."""

SMALL_PICTURE = 250_000
"""Camera rays below which numpy alone is faster than loading compiled code."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A rendered still.

    Attributes
    ----------
    light : (h, w, 3)
        Linear light, sRGB primaries; row 0 is the top.
    samples : (h, w) ints
        Number of rays of each pixel.
    error : (h, w)
        Standard error of the pixel's mean, the largest of three colours; 0 with one sample.
    scene : Scene
    passage : Passage
        Rung, effects and their reasons.
    window : Window
    blockwise : tuple of (effect, pixels)
        Effects that were added by their means over blocks, with pixels a side of a block; see `picture_cost`.
    """

    light: Floats
    samples: Ints
    error: Floats
    scene: Scene
    passage: Passage
    window: Window
    blockwise: tuple[tuple[str, int], ...] = ()

    def __repr__(self) -> str:
        height, width = self.samples.shape
        return f"Picture({self.scene.name!r}, {width} x {height} pixels)"


def render(
    scene: Scene | str | os.PathLike[str],
    *,
    threads: int | None = None,
    progress: Progress | None = None,
    compiled: bool | None = None,
) -> Floats:
    """Render a picture: what a camera sees through the sheet and past it.

    Parameters
    ----------
    scene : Scene or path of a scene file
        Of an animated scene, the first frame.
    threads : int or None
        None: the environment variable CLACAD_THREADS, else every core. The picture does not depend on it.
    progress : callable(stage, fraction) or None
    compiled : bool or None
        Compiled code or numpy; None takes numpy for small pictures.

    Returns
    -------
    (h, w, 3) array
        Linear light, sRGB primaries, before exposure.

    Raises
    ------
    SceneError, DesignError

    Examples
    --------
    >>> import clacad
    >>> from clacad.scene import load_scene
    >>> scene = load_scene("designs/scenes/fig3-z-8.toml", ["camera.pixels = [16, 16]", "camera.samples = 1"])
    >>> clacad.render(scene).shape
    (16, 16, 3)
    """
    from clacad.base.interactive import shown_progress

    made = scene if isinstance(scene, Scene) else load_scene(scene)
    report = shown_progress(progress)
    return view_through(made, threads=threads, progress=report, compiled=compiled).light


def render_movie(
    scene: Scene | str | os.PathLike[str], *, threads: int | None = None, progress: Progress | None = None
) -> Iterator[Picture]:
    """Render the frames of an animated scene, one at a time.

    Raises
    ------
    SceneError
        Raised before the first frame is drawn, with every mistake of every frame.
    ValueError
        The scene has no animation.

    Examples
    --------
    >>> import clacad
    >>> from clacad.scene import load_scene
    >>> scene = load_scene("designs/scenes/fig3-movie.toml",
    ...     ["camera.pixels = [16, 16]", "camera.samples = 1"])
    >>> first = next(clacad.render_movie(scene))
    >>> first.light.shape
    (16, 16, 3)
    """
    from clacad.base.interactive import shown_progress

    made = scene if isinstance(scene, Scene) else load_scene(scene)
    if made.animation is None:
        raise ValueError(f"the scene {made.name} has no animation")
    stills = checked_frames(made)
    fast, report = worth_compiling(made, len(stills)), shown_progress(progress)
    for k, still in enumerate(stills):

        def tell(stage: str, share: float, k: int = k) -> None:
            report("rendering frames", (k + share) / len(stills))

        yield view_through(still, threads=threads, progress=tell, compiled=fast)


def checked_frames(scene: Scene) -> list[Scene]:
    """The still of every frame, each with a sheet that can be built.

    Raises SceneError: With the mistakes of all frames.
    """
    from clacad.design import DesignError

    assert scene.animation is not None
    stills, mistakes = [], []
    for frame in range(scene.animation.frames):
        try:
            still = scene.at(frame)
            for design in still.designs():
                prescribe(design)
            stills.append(still)
        except DesignError as error:
            mistakes += [mistake for mistake in error.mistakes if mistake not in mistakes]
    if mistakes:
        raise SceneError(mistakes)
    return stills


def view_through(
    scene: Scene,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
    compiled: bool | None = None,
    passage: Passage | None = None,
    sheet: bool = True,
    window: Window | None = None,
) -> Picture:
    """Render a still and return the `Picture` with its data; parameters as in `render`.

    `passage` replaces the plan. With ``sheet=False`` the view is that without the sheet. `window` replaces
    the sheet of the scene's design.
    """
    from clacad.tracing.compiled.threads import thread_count

    still = scene.at(0) if scene.animation is not None else scene
    view = aim(still.camera)
    fast = worth_compiling(still) if compiled is None else compiled
    viewing = set_up(still, window, fast, passage, sheet)
    measured = _rendered(still, view, viewing, thread_count(threads), progress)
    return Picture(*measured, still, viewing.passage, viewing.window)


def _rendered(
    still: Scene, view: View, viewing: Viewing, threads: int, progress: Progress | None
) -> tuple[Floats, Ints, Floats]:
    """Light, samples and standard error of every pixel, tile by tile."""
    shape = view.height, view.width
    single = still.camera.samples == 1 and not still.camera.noise > 0.0
    light, error = np.zeros((*shape, 3)), np.zeros(shape)
    samples = np.broadcast_to(np.int64(1), shape) if single else np.empty(shape, dtype=np.int64)
    height, width = _tile_shape(view, still.camera.samples, single)
    corners = [(y, x) for y in range(0, view.height, height) for x in range(0, view.width, width)]

    def one(corner: tuple[int, int]) -> None:
        rows = slice(corner[0], min(corner[0] + height, view.height))
        columns = slice(corner[1], min(corner[1] + width, view.width))
        if single:
            pixels = np.arange(rows.start * view.width, rows.stop * view.width)
            total = light[rows].reshape(-1, 3)  # whole rows: no copy
            sums = Sums(total, np.zeros((0, 3)))
            _sample(viewing, view, pixels, np.arange(len(pixels)), SampleRange(0, 1, 1), sums)
            return
        light[rows, columns], samples[rows, columns], error[rows, columns] = tile(
            viewing, still, view, rows, columns
        )

    _each(one, corners, threads, progress)
    return light, samples, error


def worth_compiling(scene: Scene, frames: int = 1) -> bool:
    """Whether a still, or `frames` similar ones, has enough rays to load compiled code for them."""
    width, height = scene.camera.pixels
    return int(frames * width * height * scene.camera.samples) > SMALL_PICTURE


def _tile_shape(view: View, samples: int, single: bool) -> tuple[int, int]:
    """Height and width of a tile: whole rows of single samples, else a square of about a block of rays."""
    if single:
        return max(1, BLOCK // view.width), view.width
    side = min(TILES[1], max(TILES[0], math.isqrt(BLOCK // samples)))
    return side, side


def _each(
    work: Callable[[tuple[int, int]], None],
    corners: Sequence[tuple[int, int]],
    threads: int,
    progress: Progress | None,
) -> None:
    """Render all tiles, and report the progress."""

    def tell(done: int) -> None:
        if progress is not None:
            progress("rendering", done / len(corners))

    if threads == 1:
        for k, corner in enumerate(corners):
            work(corner)
            tell(k + 1)
        return
    pool = ThreadPoolExecutor(threads)
    try:
        for k, _ in enumerate(pool.map(work, corners)):
            tell(k + 1)
    finally:  # an interrupted picture does not finish its other tiles first
        pool.shutdown(cancel_futures=True)


def tile(
    viewing: Viewing, scene: Scene, view: View, rows: slice, columns: slice
) -> tuple[Floats, Ints, Floats]:
    """Mean light, samples and standard error of the pixels of a tile, each (h, w, ...).

    With a noise target, pixels that miss it (or whose neighbours do) get as many samples again as they have.
    This repeats until they meet it or have `most_samples`.
    """
    y, x = np.mgrid[rows, columns]
    pixels = (y * view.width + x).ravel().astype(np.int64)
    camera = scene.camera
    total, active = np.zeros((len(pixels), 3)), np.arange(len(pixels))
    square = np.zeros((len(pixels), 3))
    count = np.zeros(len(pixels), dtype=np.int64)
    most = max(camera.samples, camera.most_samples) if camera.noise > 0.0 else camera.samples
    first, more = 0, camera.samples
    while len(active):
        _sample(viewing, view, pixels, active, SampleRange(first, more, most), Sums(total, square))
        count[active] += more
        first += more
        noisy = (
            _noisy(total, square, count, camera.noise, y.shape)
            if camera.noise > 0.0
            else np.zeros(0, dtype=bool)
        )
        active = active[noisy[active]] if len(noisy) and first < most else active[:0]
        more = min(first, most - first)
    mean = total / count[:, None]
    error = np.zeros(len(pixels)) if most == 1 else _standard_error(total, square, count)
    return mean.reshape(*y.shape, 3), count.reshape(y.shape), error.reshape(y.shape)


def _sample(viewing: Viewing, view: View, pixels: Ints, active: Ints, which: SampleRange, sums: Sums) -> None:
    """Add samples, counted from 0, to the sums of the active pixels."""
    (first, more, most), (total, square) = which, sums
    if viewing.pane is not None and view.aperture == 0.0:
        sample(viewing, view, pixels[active], active, SampleRange(1 + first, more, most), sums)
        return
    batch = max(1, min(more, BLOCK))
    at_once = max(1, BLOCK // batch)
    for start in range(0, len(active), at_once):
        some = active[start : start + at_once]
        for done in range(0, more, batch):
            step = min(batch, more - done)
            points = offsets(pixels[some], 1 + first + done, step, most)
            position, direction = rays(view, pixels[some], points)
            light = radiance(viewing, position, direction).reshape(len(some), step, 3)
            total[some] += light.sum(axis=1)
            if len(square):
                square[some] += (light * light).sum(axis=1)


def tried(viewing: Viewing, view: View, pixels: Ints, samples: int) -> None:
    """Render some pixels (n,) of a picture and discard them, to measure their time."""
    sums = Sums(np.zeros((len(pixels), 3)), np.zeros((0, 3)))
    _sample(viewing, view, pixels, np.arange(len(pixels)), SampleRange(0, samples, samples), sums)


def _standard_error(total: Floats, square: Floats, count: Ints) -> Floats:
    """Standard error of the mean of independent samples, the largest of three colours, (n,)."""
    n = count[:, None]
    variance = np.maximum(0.0, square - total * total / n) / np.maximum(1, n - 1)
    return np.asarray(np.sqrt(variance / n).max(axis=1))


def _noisy(
    total: Floats, square: Floats, count: Ints, target: float, shape: tuple[int, ...]
) -> NDArray[np.bool_]:
    """Pixels that miss the target or touch one that does: a few samples may agree by chance."""
    from scipy.ndimage import binary_dilation

    bad = (_standard_error(total, square, count) > target).reshape(shape)
    return np.asarray(binary_dilation(bad, np.ones((3, 3))).ravel())


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
