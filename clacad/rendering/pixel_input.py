"""A viewing laid out for the kernel that does everything, where that can be."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.rendering.camera import View, digits
from clacad.rendering.sheet_passage import Passage
from clacad.rendering.spectrum import SpectralLine
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.rendering.compiled.pixels import Pane
    from clacad.rendering.view import Viewing


ROOM = 1e-9
"""Part of a cell by which the box round the first body is widened against rounding."""


def pane_of(
    window: Window, passage: Passage, lines: tuple[SpectralLine, ...], scale: float, front: float, opaque: bool, present: bool,
    before: bool,
) -> Pane | None:  # fmt: skip
    """The sheet for `compiled.pixels.sample_all`; None where a picture needs more than that kernel does.

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
    """Samples first, first + 1, … first + more − 1 of the sequence, of which a pixel may get `most` in all."""

    first: int
    more: int
    most: int


class Sums(NamedTuple):
    """Sums of the samples of m pixels, and of their squares: (m, 3) each, changed in place.

    `square` has no rows where nothing asks for it.
    """

    total: Floats
    square: Floats


def sample(viewing: Viewing, view: View, pixels: Ints, slots: Ints, which: SampleRange, sums: Sums) -> None:
    """Add samples of some pixels (n,) to the sums in the rows `slots` (n,), by the one kernel."""
    (first, more, most), (total, square) = which, sums
    from clacad.rendering.compiled.pixels import Eye, sample_all

    frame = np.stack([view.position, view.ahead, view.right, view.down])
    words = np.zeros((0, 2), np.uint64) if most == 1 else digits(first, more)[:, :2].copy()
    eye: Any = Eye(np.ascontiguousarray(frame, dtype=np.float64), view.width, view.height, words)
    sample_all(eye, viewing.pane, viewing.tables, pixels, slots, more, total, square)
