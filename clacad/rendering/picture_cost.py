"""Cost of a picture in processor seconds: some of its own pixels are rendered, because scenes differ a
hundredfold.

A requested direction error is met by the cheapest rung, or by the coarsest facets. A costly picture is
rendered in two steps: small with every effect, then fine without effects that cost much and change little.

The light of a pixel is E[all effects] = E[the cheap ones] + E[all − the cheap ones]. The second mean is
small, by the plan's own bound, and costs the most. It is taken over blocks of pixels, by the same rays with
and without those effects, so that common parts cancel ray by ray (two-level Monte Carlo: Heinrich, LNCS 2179,
58 (2001); Giles, Oper. Res. 56, 607 (2008)). The mean over a block is right; only the light that those
effects add loses detail finer than a block. The small picture is finished after a sixty-fourth of the rays,
and is shown at once.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from math import log
from typing import cast

import numpy as np

from clacad.base.machine_rates import Span
from clacad.base.text import mrad_text
from clacad.base.types import Bools, Floats, Ints, Progress, Rung
from clacad.design import Design
from clacad.effects.engine.probe_rays import compared, situation_of_scene
from clacad.exporting.formats.indexed_meshes import THREEMF
from clacad.prescription.prescribe import prescribe
from clacad.rendering.camera import View, Viewing, aim, rays
from clacad.rendering.picture import BLOCK, Picture, tile, tried, view_through, worth_compiling
from clacad.rendering.scene_hits import may_cross
from clacad.rendering.sheet_passage import Passage
from clacad.rendering.view import first_box, kernels_are_kept, set_up
from clacad.scene import Scene
from clacad.sheet.window import Window
from clacad.storage.errors import BadRequest
from clacad.tracing.worst_cell import worst_cell
from clacad.verification.accuracy.accuracy_row import MOST_DISAGREEMENT, TargetOutOfReach
from clacad.verification.accuracy.choose_setting import facets_for

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
"""Squares along a picture's side for the samples of a noise target, and pixels along a side of each."""

GRID = 24
"""Pixels along a side of the picture from which the share that looks at a sheet is found."""

PATCHES = ((0.31, 0.22), (0.44, 0.61), (0.57, 0.35), (0.7, 0.83))
"""Positions of the patches in the picture, down and across."""


def picture_seconds(scene: Scene, passage: Passage, frames: int = 1) -> Span:
    """Processor seconds of a still, or `frames` such; some pixels show how often noise repeats them.

    The range is narrow where the time of a pixel does not depend on how many are drawn together. It is wide
    where a block takes less than its pixels one by one, as with effects that split light.

    scene : A still.
    passage : As planned by `sheet_passage.plan_passage`.
    """
    view = aim(scene.camera)
    viewing = set_up(scene, passage.window, worth_compiling(scene, frames), passage)
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
    """Processor seconds of square patches of a picture, of `side` pixels a side, and their pixel count.

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


MOST_QUADS = 256
"""Finest facets that a scene file may request."""


def within_target(scene: Scene, target: float) -> Scene:
    """Choose how rays pass the sheet so that they leave within a target of the exact surfaces.

    Rung auto takes the cheapest rung within it on the scene's own rays, and only effects that turn light by
    more. Rung mesh takes the coarsest facets. Any other rung is measured and rejected if its error is larger.

    target : radians. Rms direction error.
    Raises BadRequest: The scene has several sheets.
    Raises TargetOutOfReach: The error of the scene's rung, or of its mesh file, is larger.
    """
    if len(scene.sheets) > 1:
        several = "the scene has several: give each its own rung, [[sheet]] rung"
        raise BadRequest(f"a target chooses how rays pass one sheet, and {several}")
    chosen = scene.replace({"effects.angle": f"{1e3 * target!r} mrad"})
    rung = chosen.sheet.rung
    if rung in ("auto", "surfaces"):
        return chosen
    still = chosen.at(0) if chosen.animation is not None else chosen
    design = still.design()
    window = prescribe(design)
    if rung == "mesh" and still.sheet.mesh is None:
        return chosen.replace({"sheet.quads": _quads_within(design, window, target)})
    mesh = still.file(still.sheet.mesh) if still.sheet.mesh else None
    error, disagree = compared(situation_of_scene(still, window), cast("Rung", rung), mesh)
    if error > target or disagree > MOST_DISAGREEMENT:
        raise TargetOutOfReach(
            f"rung {rung} is {mrad_text(error)} rms off the exact surfaces on this scene's rays and sends"
            f" {disagree:.2%} of them another way; {mrad_text(target)} and {MOST_DISAGREEMENT:.0%} are"
            " allowed: use rung surfaces, or auto"
        )
    return chosen


def _quads_within(design: Design, window: Window, target: float) -> int:
    """Coarsest quads a cell side whose facets keep the target (radians of direction) in the worst cell."""
    facets = facets_for(design, worst_cell(window, design.check.field).buildable, target, (THREEMF,))
    assert facets is not None
    if facets.quads > MOST_QUADS:
        raise TargetOutOfReach(
            f"{mrad_text(target)} takes {facets.quads} quads a cell side, more than {MOST_QUADS}; "
            "use rung surfaces"
        )
    return facets.quads


PIXELS_A_BLOCK = 8
"""Pixels of the fine picture along a side of one pixel of the small picture."""

BROAD = 5
"""Blocks along a side whose mean represents those effects: the noise of one block alone would be visible."""

WEAK = 0.1
"""Largest share of the light that an effect may change if it is added block by block."""

COSTLY = 5.0
"""Least ratio of the time of a trace with such an effect to the bare trace."""


@dataclass(frozen=True, eq=False)
class CoarseView:
    """A picture drawn small, and the data to draw it fine.

    scene : The requested still.
    passage : With every effect.
    small : With every effect; a pixel for each block.
    blockwise : Effects that are added to the fine picture block by block; none where all are cheap or strong.
    compiled : Whether the small picture was drawn by compiled code.
    """

    scene: Scene
    passage: Passage
    small: Picture
    blockwise: tuple[str, ...]
    compiled: bool

    @property
    def fine_passage(self) -> Passage:
        """Passage of the rays of the fine picture."""
        return without(self.passage, self.blockwise)

    def enlarged(self) -> Picture:
        """The small picture at the requested size."""
        small, (width, height) = self.small, self.scene.camera.pixels
        down, across = (
            np.arange(n) * m // n for n, m in zip((height, width), small.samples.shape, strict=True)
        )
        light, samples, error = (
            one[down[:, None], across] for one in (small.light, small.samples, small.error)
        )
        return Picture(
            light,
            samples,
            error,
            self.scene,
            self.passage,
            small.window,
            (("the whole view", PIXELS_A_BLOCK),),
        )

    def refined(self, *, threads: int | None = None, progress: Progress | None = None) -> Picture:
        """The fine picture: its own rays for most of the light, and the blocks' means of the rest."""
        fast, passage = worth_compiling(self.scene), self.fine_passage
        fine = view_through(self.scene, threads=threads, progress=progress, compiled=fast, passage=passage)
        if not self.blockwise:
            return fine
        small = self.small
        if (
            self.compiled != fast
        ):  # the last bits of the fine picture must not depend on what was compiled already
            small = view_through(small.scene, threads=threads, compiled=fast, passage=self.passage)
        cheap = view_through(small.scene, threads=threads, compiled=fast, passage=passage)
        added = _spread(small.light - cheap.light, _on_sheet(self.scene, fine.window))
        spread = np.hypot(small.error, cheap.error) / BROAD
        return replace(
            fine,
            light=np.maximum(0.0, fine.light + added),
            passage=self.passage,
            error=np.hypot(fine.error, enlarge(spread, fine.samples.shape)),
            blockwise=tuple((name, BROAD * PIXELS_A_BLOCK) for name in self.blockwise),
        )


def view_coarsely(
    scene: Scene,
    passage: Passage,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
    frames: int = 1,
) -> CoarseView:
    """Draw a still small, with every effect; in numpy where kernels would have to be compiled first.

    scene : A still.
    passage : As planned by `sheet_passage.plan_passage`.
    threads, progress : As in `picture.render`.
    frames : Number of frames of the movie whose first frame it is.
    """
    width, height = (-(-n // PIXELS_A_BLOCK) for n in scene.camera.pixels)
    small = scene.replace("camera.pixels", [width, height])
    fast = worth_compiling(scene, frames) and not must_compile(scene, passage, frames)
    drawn = view_through(small, threads=threads, progress=progress, compiled=fast, passage=passage)
    return CoarseView(scene, passage, drawn, costly_and_weak(passage), fast)


def must_compile(scene: Scene, passage: Passage, frames: int = 1) -> bool:
    """Whether a still, or `frames` similar ones, is drawn by kernels that must be compiled first.

    Compiling takes half a minute before the first pixel.
    """
    if not worth_compiling(scene, frames):
        return False
    viewing = set_up(scene, passage.window, True, passage)
    return not kernels_are_kept(viewing, aim(scene.camera))


def costly_and_weak(passage: Passage) -> tuple[str, ...]:
    """Effects that cost much, turn no light beyond a block and change little of it, by the plan's bounds."""
    if passage.plan is None:
        return ()
    weak = (row for row in passage.plan.rows if row.on and row.angle == 0.0 and row.radiance <= WEAK)
    return tuple(row.effect for row in weak if row.cost >= COSTLY)


def without(passage: Passage, effects: tuple[str, ...]) -> Passage:
    """The passage without some of its effects."""
    if passage.plan is None or not effects:
        return passage
    rows = tuple(replace(row, state="without") if row.effect in effects else row for row in passage.plan.rows)
    return replace(passage, plan=replace(passage.plan, rows=rows))


def enlarge(small: Floats, shape: tuple[int, int]) -> Floats:
    """Values of blocks (h, w, ...) at the middles of (rows, columns) finer pixels, interpolated linearly."""
    for axis, count in enumerate(shape):
        have = small.shape[axis]
        place = np.clip((np.arange(count) + 0.5) * (have / count) - 0.5, 0.0, have - 1.0)
        low = np.minimum(place.astype(np.intp), max(0, have - 2))
        part = (place - low).reshape(-1, *[1] * (small.ndim - 1 - axis))
        small = (
            np.take(small, low, axis) * (1.0 - part)
            + np.take(small, np.minimum(low + 1, have - 1), axis) * part
        )
    return small


def _spread(blocks: Floats, on: Bools) -> Floats:
    """Broad means of blocks (h, w, 3) over the pixels of the sheet alone: others have none of its light."""
    light, share = _broad(blocks), _broad(_shares(on, blocks.shape[:2]))
    with np.errstate(divide="ignore", invalid="ignore"):
        added = enlarge(light, on.shape) / enlarge(share, on.shape)[..., None]
    return np.where(on[..., None] & np.isfinite(added), added, 0.0)


def _broad(blocks: Floats) -> Floats:
    """Sums of the existing blocks among BROAD × BROAD about each."""
    half = BROAD // 2
    for axis in (0, 1):
        pad = [(half + 1, half) if k == axis else (0, 0) for k in range(blocks.ndim)]
        sums = np.cumsum(np.pad(blocks, pad), axis)
        count = blocks.shape[axis]
        blocks = np.take(sums, np.arange(count) + BROAD, axis) - np.take(sums, np.arange(count), axis)
    return blocks


def _shares(on: Bools, shape: tuple[int, int]) -> Floats:
    """Share (h, w) of the pixels of each block that see the sheet."""
    down, across = (np.arange(n) * m // n for n, m in zip(on.shape, shape, strict=True))
    block = (down[:, None] * shape[1] + across).ravel()
    many = np.bincount(block, minlength=shape[0] * shape[1])
    return (np.bincount(block, on.ravel(), minlength=shape[0] * shape[1]) / many).reshape(shape)


def _on_sheet(scene: Scene, window: Window) -> Bools:
    """Pixels (h, w) whose middle looks at the first body."""
    view, box = aim(scene.camera), first_box(window) * (window.unit / scene.unit_m)
    found = np.empty((view.height, view.width), dtype=np.bool_)
    middle = np.full((view.width, 1, 4), 0.5)
    for row in range(view.height):
        start, way = rays(view, np.arange(row * view.width, (row + 1) * view.width), middle)
        found[row] = may_cross(box.reshape(2, 3), start, way)
    return found
