"""A picture in two steps: small with every effect, then fine without effects that cost much and change
little.

The light of a pixel is E[all effects] = E[the cheap ones] + E[all − the cheap ones]. The second mean is
small, by the plan's own bound, and costs the most. It is taken over blocks of pixels, by the same rays with
and without those effects, so that common parts cancel ray by ray (two-level Monte Carlo: Heinrich, LNCS 2179,
58 (2001); Giles, Oper. Res. 56, 607 (2008)). The mean over a block is right; only the light that those
effects add loses detail finer than a block. The small picture is finished after a sixty-fourth of the rays,
and is shown at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.prescription.prescribe import prescribe
from clacad.rendering.camera import aim, rays
from clacad.rendering.picture import Picture, Progress, view_through, worth_compiling
from clacad.rendering.pixel_input import first_box, kernels_are_kept
from clacad.rendering.sheet_passage import Passage
from clacad.rendering.view import may_cross, set_up
from clacad.scene import Scene
from clacad.sheet.window import Window

BLOCK = 8
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

    Attributes
    ----------
    scene : Scene
        The requested still.
    passage : Passage
        With every effect.
    small : Picture
        With every effect; a pixel for each block.
    blockwise : tuple of str
        Effects that are added to the fine picture block by block; none where all are cheap or strong.
    compiled : bool
        Whether the small picture was drawn by compiled code.
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
            light, samples, error, self.scene, self.passage, small.window, (("the whole view", BLOCK),)
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
            blockwise=tuple((name, BROAD * BLOCK) for name in self.blockwise),
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

    Parameters
    ----------
    scene : Scene
        A still.
    passage : Passage
        As planned by `sheet_passage.plan_passage`.
    threads, progress
        As in `picture.render`.
    frames : int
        Number of frames of the movie whose first frame it is.
    """
    width, height = (-(-n // BLOCK) for n in scene.camera.pixels)
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
    viewing = set_up(scene, prescribe(scene.design()), True, passage)
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
    """Broad means of blocks (h, w, 3) over the pixels of the sheet alone: pixels outside it have none of
    their light.
    """
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
