"""From camera rays to light: past the sheet or through it, and on into the scene.

A ray that crosses the sheet meets, in this order: objects before the sheet, the sheet (rung and effects as
planned), objects behind it. A ray that misses the sheet goes straight on. Nothing is divided by an image
distance, so objects at, in or near the sheet and at poles of the stretch need no special treatment.

Where the single kernel `compiled.pixels.sample_all` supports a viewing, the viewing is laid out for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.optics.rays import Rays
from clacad.prescription.prescribe import prescribe
from clacad.rendering.camera import SpectralLine, View, Viewing, digits, lines
from clacad.rendering.scene_arrays import FLOOR, SceneArrays, set_stage
from clacad.rendering.scene_hits import background, look, may_cross
from clacad.rendering.sheet_passage import Between, Passage, plan_passage
from clacad.scene import Camera, Scene
from clacad.sheet.face_order import media_of
from clacad.sheet.lattice import half_sizes
from clacad.sheet.plate import Plate
from clacad.sheet.window import Window
from clacad.tracing.layout import lay_out

if TYPE_CHECKING:
    from clacad.effects.engine.homogeneous_light import LightRays
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
    from clacad.tracing.compiled.packing import pack

    numbers, law = np.zeros(kernel.PANE_NUMBERS), window.law
    kind = kernel.NO_SHEET if not present else kernel.LAW if plane else kernel.SURFACES
    if kind == kernel.LAW:
        edges = np.array(lattice.extent()) / scale
        numbers[kernel.MATRIX : kernel.EDGES + 4] = [*law.matrix().ravel(), *law.optical_axis, *edges]
    elif kind == kernel.SURFACES:
        numbers[:6] = first_box(window) / scale
    numbers[kernel.SCALE], numbers[kernel.FRONT] = scale, front
    shining = np.zeros(256, dtype=np.uint8)
    shining[list(passage.shining)] = 1
    sheet = pack(lay_out(window))._replace(media=np.array(media_of(window.bodies, lines[0].wavelength)))
    return kernel.Pane(kind, numbers, opaque, before, sheet, shining)


def first_box(window: Window) -> Floats:
    """Low and high corner of the first body, window units: a ray that misses it misses the sheet."""
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
    """Whether the main kernels of a compiled picture are on disk, to be loaded without compiling."""
    from clacad.base.kernel_cache import is_kept

    if viewing.pane is not None and view.aperture == 0.0:
        from clacad.rendering.compiled.pixels import sample_all

        none, rows = np.zeros(0, np.int64), np.zeros((0, 3))
        eye = _eye(view, SampleRange(0, 1, 1))
        return is_kept(sample_all, (eye, viewing.pane, viewing.tables, none, none, 1, rows, rows))
    from clacad.rendering.compiled.scene_hits import look_all
    from clacad.tracing.compiled.chunk import rung_is_kept

    rows, flat = np.zeros((0, 3)), np.zeros(0)
    looked = (viewing.tables, rows, rows, flat, rows, np.zeros(0, np.bool_), flat)
    several = [(one.sheet.window, one.passage) for one in viewing.passage.several]
    traced = several or [(viewing.window, viewing.passage)]
    return is_kept(look_all, looked) and all(
        rung_is_kept(passage.rung, lay_out(window))
        for window, passage in traced
        if window.uniform and not (passage.rung == "thin" and window.thin.field)  # these run in numpy
    )


UNTINTED = (1.0, 1.0, 1.0)
"""Tint of a sheet that absorbs no light of any colour."""


def set_up(
    scene: Scene, window: Window | None, compiled: bool, passage: Passage | None = None, sheet: bool = True
) -> Viewing:
    """Prepare a still scene for rendering.

    window : None: that of the passage, or prescribed from the scene's design.
    passage : None: planned from the scene.
    sheet : False: the view without the sheet.
    """
    stage = set_stage(scene)
    planned = plan_passage(scene, window) if passage is None else passage
    window = planned.window if window is None else window
    window = prescribe(scene.design()) if window is None else window
    scale = scene.unit_m / window.unit
    front = 0.0 if planned.rung in ("law", "thin") else window.z_range[0] / scale
    box = _box_of_all(planned, window) / scale
    colours = lines(scene.light, window, planned.by_lines)
    opaque = sheet and scene.sheet.surround == "opaque"
    before = may_stand_before(stage, front, scene.camera, box)
    made = pane = None
    between = bool(planned.several) and _lies_between(stage, planned, scale)
    if compiled:
        from clacad.rendering.scene_arrays import tables

        made = tables(stage)
        if not planned.several and scene.sheet.tint == UNTINTED:
            pane = pane_of(window, planned, colours, scale, front, opaque, sheet, sheet and before)
    tint = scene.sheet.tint
    return Viewing(
        stage,
        window,
        planned,
        colours,
        scale,
        box,
        front,
        opaque,
        sheet,
        before,
        compiled,
        made,
        tint,
        pane,
        between,
    )


def _box_of_all(passage: Passage, window: Window) -> Floats:
    """Box round every sheet, lengths of the first window."""
    boxes = [
        sheet_box(one.sheet.window) * one.sheet.scale + [0.0, 0.0, one.sheet.z] for one in passage.several
    ] or [sheet_box(window)]
    low, high = np.array(boxes).min(axis=0)[0], np.array(boxes).max(axis=0)[1]
    return np.array([low, high])


def _lies_between(stage: SceneArrays, passage: Passage, scale: float) -> bool:
    """Whether an object other than a floor reaches between the sheets."""
    low = passage.several[0].sheet.span[1] / scale
    high = passage.several[-1].sheet.span[0] / scale
    limited = stage.kind != FLOOR
    return bool((limited & (stage.box[:, 0, 2] < high) & (stage.box[:, 1, 2] > low)).any())


def sheet_box(window: Window) -> Floats:
    """Box (low, high) round all bodies, a cell wider on every side, window units."""
    boxes = [place.extent(window.lattice) for place in window.placements]
    shape = window.outline
    hx, hy = (0.0, 0.0) if shape is None or isinstance(shape, Plate) else half_sizes(shape)
    boxes += [(sx - hx, sx + hx, sy - hy, sy + hy) for sx, sy in window.shifts]
    edges = np.array(boxes)
    if isinstance(window.outline, Plate):
        edges = np.append(edges, [window.outline.box], axis=0)
    pad = 2.0 * window.lattice.circumradius + window.land.border
    z0, z1 = min(window.z_range[0], 0.0), max(window.z_range[1], 0.0)
    low = (edges[:, 0].min() - pad, edges[:, 2].min() - pad, z0)
    return np.array([low, (edges[:, 1].max() + pad, edges[:, 3].max() + pad, z1)])


def radiance(viewing: Viewing, position: Floats, direction: Floats) -> Floats:
    """Light (n, 3), linear sRGB primaries, of camera rays.

    position, direction : (n, 3) arrays, scene frame. Directions of any length.
    """
    if len(viewing.lines) == 1 and viewing.lines[0].whole:
        return _one_line(viewing, position, direction, viewing.lines[0].wavelength)
    light = np.zeros((len(position), 3))
    for line in viewing.lines:
        colour = _one_line(viewing, position, direction, line.wavelength)
        light += (colour @ line.basis)[:, None] * line.weight
    return light


def _one_line(viewing: Viewing, position: Floats, direction: Floats, wavelength: float | None) -> Floats:
    light = np.zeros((len(position), 3))
    rows = np.flatnonzero(may_cross(viewing.box, position, direction))
    beside = np.ones(len(position), dtype=bool)
    if len(rows) and viewing.present:
        start = position[rows] * viewing.scale
        waves = None if wavelength is None else np.full(len(rows), wavelength)
        beyond, met, lit = viewing.passage.light_of_all(
            viewing.window,
            Rays(start, direction[rows], waves),
            viewing.compiled,
            _between(viewing) if viewing.between else None,
        )
        beside[rows] = ~met
        light[rows] = _through(viewing, position[rows], direction[rows], beyond, met, lit)
    rows = np.flatnonzero(beside)
    if len(rows) and not viewing.opaque:
        light[rows], _ = seen(viewing, position[rows], direction[rows], np.inf)
    elif len(rows):
        light[rows] = _before(viewing, position[rows], direction[rows])[0]
    return light


def _between(viewing: Viewing) -> Between:
    """Light of objects between the sheets; lengths of the first window."""
    scale = viewing.scale
    return lambda position, direction, reach: seen(viewing, position / scale, direction, reach / scale)


def _through(
    viewing: Viewing, position: Floats, direction: Floats, beyond: LightRays, met: Bools, lit: Floats | None
) -> Floats:
    """Light of rays that met the sheet: of an object before it, else of what is seen through it, or black.

    lit : (n, 3) or None. Of objects between sheets.
    """
    light = np.zeros((len(position), 3))
    rows = np.flatnonzero(met)
    hidden = np.zeros(len(position), dtype=bool)
    light[rows], hidden[rows] = _before(viewing, position[rows], direction[rows])
    shines = np.flatnonzero((met & ~hidden)[beyond.parent])
    parent = beyond.parent[shines]
    found, _ = seen(viewing, beyond.position[shines] / viewing.scale, beyond.direction[shines], np.inf)
    if viewing.tint != UNTINTED:
        found = np.where(beyond.direction[shines, 2:] > 0.0, found * np.array(viewing.tint), found)
    if viewing.passage.plain:  # one ray beyond the sheet for each before it, its flux 1
        light[parent] = found
    else:
        found *= beyond.flux[shines, None]
        for colour in range(3):
            light[:, colour] += np.bincount(parent, found[:, colour], minlength=len(light))
    if lit is not None:
        light[met & ~hidden] += lit[met & ~hidden]
    return light


def _before(viewing: Viewing, position: Floats, direction: Floats) -> tuple[Floats, Bools]:
    """Light of objects before the sheet, black elsewhere, and where there are any."""
    if not (viewing.before or viewing.opaque):
        return np.zeros((len(position), 3)), np.zeros(len(position), dtype=bool)
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = (viewing.front - position[:, 2]) / direction[:, 2]
    light, hidden = seen(viewing, position, direction, limit)
    return np.where(hidden[:, None], light, 0.0), hidden


def may_stand_before(stage: SceneArrays, front: float, camera: Camera, box: Floats) -> bool:
    """Whether any object may be met between the camera and the sheet (box, scene lengths).

    A floor below both, or above both, is excluded: rays are straight.
    """
    reach = camera.position[1] - 0.5 * camera.aperture, camera.position[1] + 0.5 * camera.aperture
    low, high = min(box[0, 1], reach[0]), max(box[1, 1], reach[1])
    floor, y = stage.kind == FLOOR, stage.origin[:, 1]
    return bool(np.where(floor, (low <= y) & (y <= high), stage.box[:, 0, 2] < front).any())


def seen(
    viewing: Viewing, position: Floats, direction: Floats, limit: Floats | float
) -> tuple[Floats, Bools]:
    """Light and hits of rays in the scene, by the selected path; see `scene_hits.look`."""
    if not viewing.compiled:
        return look(viewing.stage, position, direction, limit)
    from clacad.rendering.compiled.scene_hits import look_all

    light, met = np.empty((len(position), 3)), np.empty(len(position), dtype=np.bool_)
    bound = np.full(len(position), limit) if np.isscalar(limit) else np.ascontiguousarray(limit)
    start, ray = np.ascontiguousarray(position), np.ascontiguousarray(direction)
    look_all(viewing.tables, start, ray, bound, light, met, np.empty(len(position)))
    return light, met


__all__ = ["Viewing", "background", "radiance", "set_up"]
