"""A viewing laid out for the single kernel `compiled.pixels.sample_all`, where that supports it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.rendering.camera import View, Viewing, digits
from clacad.rendering.sheet_passage import Passage
from clacad.rendering.spectrum import SpectralLine
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.rendering.compiled.pixels import Pane


ROOM = 1e-9
"""Part of a cell by which the box round the first body is widened against rounding."""


def pane_of(
    window: Window,
    passage: Passage,
    lines: tuple[SpectralLine, ...],
    scale: float,
    front: float,
    opaque: bool,
    present: bool,
    before: bool,
) -> Pane | None:
    """The sheet for `compiled.pixels.sample_all`; None where a picture needs more than that kernel supports.

    Parameters as the attributes of `view.Viewing`.
    """
    lattice = window.lattice
    plane = passage.homogeneous and not lattice.hexagonal and lattice.outline is None
    exact = passage.rung == "surfaces" and passage.plain
    if len(lines) != 1 or not lines[0].whole or (present and not (plane or exact)):
        return None
    if not window.uniform:  # traced a block at a time, by `Passage.light`
        return None
    from clacad.rendering.compiled import pixels as kernel
    from clacad.rendering.compiled.hole_beside_lens import suits
    from clacad.tracing.compiled.packing import pack
    from clacad.tracing.layout import lay_out

    numbers = np.zeros(kernel.PANE_NUMBERS)
    if not present:
        kind = kernel.NO_SHEET
    elif plane:
        kind = kernel.LAW
        edges = np.array(lattice.extent()) / scale
        numbers[kernel.MATRIX : kernel.EDGES + 4] = np.concatenate(
            [window.law.matrix().ravel(), window.law.optical_axis, edges]
        )
    else:
        kind = kernel.SURFACES
        numbers[:6] = first_box(window) / scale
    numbers[kernel.SCALE], numbers[kernel.FRONT] = scale, front
    shining = np.zeros(256, dtype=np.uint8)
    shining[list(passage.shining)] = 1
    wave = lines[0].wavelength
    indices = np.array([body.index if wave is None else body.index_at(wave) for body in window.bodies])
    sheet = pack(lay_out(window))._replace(indices=indices)
    return kernel.Pane(kind, numbers, opaque, before, sheet, shining, suits(sheet))


def first_box(window: Window) -> Floats:
    """Low and high corner of the first body, window units: a ray that misses it misses the sheet."""
    from clacad.tracing.layout import lay_out

    body = lay_out(window).bodies[0]
    x0, x1, y0, y1 = body.box
    low, high = np.array([x0, y0, body.level + body.low]), np.array([x1, y1, body.level + body.high])
    room = ROOM * window.lattice.circumradius + 4.0 * np.spacing(np.maximum(np.abs(low), np.abs(high)))
    return np.concatenate([low - room, high + room])


class SampleRange(NamedTuple):
    """Samples first, first + 1, … first + more − 1 of the sequence, out of at most `most` for a pixel."""

    first: int
    more: int
    most: int


class Sums(NamedTuple):
    """Sums of the samples of m pixels, and of their squares: (m, 3) each, changed in place.

    `square` has no rows where squares are not needed.
    """

    total: Floats
    square: Floats


def sample(viewing: Viewing, view: View, pixels: Ints, slots: Ints, which: SampleRange, sums: Sums) -> None:
    """Add samples of some pixels (n,) to the sums in the rows `slots` (n,), by the one kernel."""
    from clacad.rendering.compiled.pixels import sample_all

    total, square = sums
    eye = _eye(view, which)
    sample_all(eye, viewing.pane, viewing.tables, pixels, slots, which.more, total, square)


def _eye(view: View, which: SampleRange) -> Any:
    """The camera for the kernel, with its sample points."""
    from clacad.rendering.compiled.pixels import Eye

    frame = np.stack([view.position, view.ahead, view.right, view.down])
    words = np.zeros((0, 2), np.uint64)
    if which.most > 1:
        words = digits(which.first, which.more)[:, :2].copy()
    return Eye(np.ascontiguousarray(frame, dtype=np.float64), view.width, view.height, words)


def kernels_are_kept(viewing: Viewing, view: View) -> bool:
    """Whether the main kernels of a compiled picture are on disk, so that they are loaded and not compiled
    first.
    """
    from clacad.base.kernel_cache import is_kept

    if viewing.pane is not None and view.aperture == 0.0:
        from clacad.rendering.compiled.pixels import sample_all

        none, rows = np.zeros(0, np.int64), np.zeros((0, 3))
        eye = _eye(view, SampleRange(0, 1, 1))
        return is_kept(sample_all, (eye, viewing.pane, viewing.tables, none, none, 1, rows, rows))
    from clacad.rendering.compiled.scene_hits import look_all
    from clacad.tracing.compiled.surfaces import rung_is_kept
    from clacad.tracing.layout import lay_out

    rows, flat = np.zeros((0, 3)), np.zeros(0)
    looked = (viewing.tables, rows, rows, flat, rows, np.zeros(0, np.bool_), flat)
    several = [(one.sheet.window, one.passage) for one in viewing.passage.several]
    traced = several or [(viewing.window, viewing.passage)]
    return is_kept(look_all, looked) and all(
        rung_is_kept(passage.rung, lay_out(window))
        for window, passage in traced
        if window.uniform and not (passage.rung == "thin" and window.thin.field)  # these run in numpy
    )
