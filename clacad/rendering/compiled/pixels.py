"""From pixels to light in one compiled kernel: camera rays, the sheet, the scene, the sums of the pixels.

One block of rays is processed at a time, all of it in the first-level cache; only the sums have the size of
the picture. The kernel serves a pinhole, one wavelength, and a sheet that is its law or its exact surfaces
without effects beyond ghosts. Everything else goes through `view.radiance` and gives the same picture.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.base.compiled import exact, making, mixed, owning
from clacad.base.hashing import GOLDEN
from clacad.base.types import Floats, Ints, Words
from clacad.optics.rays import Fate
from clacad.rendering.compiled.scene_hits import Pad, look_block, new_pad
from clacad.rendering.scene_arrays import BLOCK, Tables
from clacad.tracing.compiled import block as ray_block
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.block import centres, lane, lanes
from clacad.tracing.compiled.launch import launch_block, launch_ray
from clacad.tracing.compiled.packing import Packed
from clacad.tracing.compiled.records import Outcome, Scratch, new_scratch
from clacad.tracing.compiled.straight_path import straight
from clacad.tracing.compiled.walk import walk_ray

BESIDE, BLACK, SHINES, BEFORE = range(4)
"""States of a ray: outside the sheet, without light, goes on behind the sheet, met an object before it."""

ALIVE, GHOST, MISSED = int(Fate.ALIVE), int(Fate.GHOST), int(Fate.MISSED)

NO_SHEET, LAW, SURFACES = range(3)

STEP = np.uint64(GOLDEN)


class Eye(NamedTuple):
    """A pinhole camera and its samples.

    frame : (4, 3) lengths. Position, ahead, right, down, as in `camera.View`.
    width, height : pixels
    digits : (count, 2) words
        Sample points as 52 binary digits; empty for one sample in the middle of each pixel.
    """

    frame: Floats
    width: int
    height: int
    digits: Words


class Pane(NamedTuple):
    """The sheet.

    kind : NO_SHEET, LAW or SURFACES.
    numbers : (21,). LAW: from MATRIX, AXIS and EDGES on matrix (9), axis (3), and edges in z = 0 (4) in scene
        lengths. SURFACES: low and high corner of the first body (6). At SCALE window lengths in a scene
        length; at FRONT the height below which objects count as before the sheet.
    opaque, before : Whether nothing is visible outside the sheet; whether an object may be before it.
    sheet : SURFACES: the sheet that is traced.
    shining : (256,) bytes. Fates of rays that bring light.
    """

    kind: int
    numbers: Floats
    opaque: bool
    before: bool
    sheet: Packed
    shining: NDArray[np.uint8]


MATRIX, AXIS, EDGES, SCALE, FRONT, PANE_NUMBERS = 0, 9, 12, 19, 20, 21


class Walk(NamedTuple):
    """Working memory of one thread for tracing.

    s : (SCRATCH, BLOCK), carried : (BLOCK,), chosen : (BLOCK,) ints. A block of rays on the straight path.
    start, way : (1, 3); out : Outcome of one row; scratch : Scratch. One ray that is walked.
    """

    s: Floats
    carried: Floats
    chosen: NDArray[np.intp]
    start: Floats
    way: Floats
    out: Outcome
    scratch: Scratch


@making
def new_walk() -> Walk:
    """Allocate the working memory of one thread."""
    out = Outcome(
        np.empty((1, 3)),
        np.empty((1, 3)),
        np.empty(1, np.uint8),
        np.empty(1),
        np.empty((1, 2), np.int32),
        np.empty((1, 2), np.int32),
        np.empty(1, np.int32),
        np.empty((0, 0, 3)),
        np.empty((0, 0, 3)),
    )
    return Walk(
        np.zeros((ray_block.SCRATCH, BLOCK)),
        np.empty(BLOCK),
        np.arange(BLOCK),
        np.empty((1, 3)),
        np.empty((1, 3)),
        out,
        new_scratch(),
    )


@owning
def sample_all(
    eye: Eye, pane: Pane, tables: Tables, pixels: Ints, slots: Ints, count: int, total: Floats, square: Floats
) -> None:
    """Add the light of `count` samples of each of `pixels`, and its square, to the sums in the rows `slots`.

    square : (n, 3), or no rows where squares are not needed
    """
    pad, walk = new_pad(), new_walk()
    state, front = np.empty(BLOCK, np.int64), np.empty((3, BLOCK))
    at_once, batch = max(1, BLOCK // count), min(count, BLOCK)
    for first in range(0, len(pixels), at_once):
        number = min(at_once, len(pixels) - first)
        for done in range(0, count, batch):
            step = min(batch, count - done)
            m = number * step
            _look_out(eye, pixels[first : first + number], done, step, pad.part, pad.ray)
            pass_sheet(pane, tables, m, pad, walk, state, front)
            for i in range(m):
                pad.best[i] = np.inf
            look_block(tables, m, pad)
            _blend(pane.opaque, pane.before, m, state, front, pad.colour)
            _add(pad.colour, slots[first : first + number], step, total, square)


@exact
def _hash(number: int, salt: int) -> Any:
    """Well-mixed 64 bits of a number; see `camera.offsets`."""
    return mixed((np.uint64(number) * np.uint64(4) + np.uint64(salt + 1)) * STEP) >> np.uint64(12)


@exact
def _look_out(eye: Eye, pixels: Ints, done: int, step: int, spare: Floats, ray: Floats) -> None:
    """Starts and directions of the samples of some pixels; see `camera.rays`."""
    n = len(pixels)
    across, down = spare[0], spare[1]
    width, per_width, per_height = float(eye.width), 1.0 / float(eye.width), 1.0 / float(eye.height)
    if len(eye.digits) == 0:
        for i in range(n):
            number = float(pixels[i])
            row = np.floor((number + 0.5) * per_width)
            across[i], down[i] = number - row * width + 0.5, row + 0.5
    else:
        unit = 2.0**-52
        for i in range(n):
            row = pixels[i] // eye.width
            column = pixels[i] - row * eye.width
            one, two = _hash(pixels[i], 0), _hash(pixels[i], 1)
            for j in range(step):
                k = i * step + j
                across[k] = float(column) + float(eye.digits[done + j, 0] ^ one) * unit
                down[k] = float(row) + float(eye.digits[done + j, 1] ^ two) * unit
    frame, x, y, z, u, v, w = eye.frame, ray[0], ray[1], ray[2], ray[3], ray[4], ray[5]
    px, py, pz, au, av, aw = frame[0, 0], frame[0, 1], frame[0, 2], frame[1, 0], frame[1, 1], frame[1, 2]
    ru, rv, rw, du, dv, dw = frame[2, 0], frame[2, 1], frame[2, 2], frame[3, 0], frame[3, 1], frame[3, 2]
    for i in range(n * step):
        a, b = across[i] * per_width - 0.5, down[i] * per_height - 0.5
        x[i], y[i], z[i] = px, py, pz
        u[i], v[i], w[i] = au + a * ru + b * du, av + a * rv + b * dv, aw + a * rw + b * dw


@exact
def pass_sheet(pane: Pane, tables: Tables, m: int, pad: Pad, walk: Walk, state: Ints, front: Floats) -> None:
    """Trace the pad's rays past or through the sheet; set `state`, and light of objects before it."""
    if pane.before or pane.opaque:
        level = pane.numbers[FRONT]
        for i in range(m):
            pad.best[i] = (level - pad.ray[2, i]) / pad.ray[5, i]
        look_block(tables, m, pad)
        for i in range(m):
            front[0, i], front[1, i], front[2, i] = pad.colour[0, i], pad.colour[1, i], pad.colour[2, i]
            pad.some[3, i] = pad.which[i]
    if pane.kind == LAW:
        _law(pane.numbers, m, pad.ray, state)
    elif pane.kind == SURFACES:
        _surfaces(pane, m, pad, walk, state)
    else:
        for i in range(m):
            state[i] = BESIDE
    if pane.before or pane.opaque:
        for i in range(m):
            if pad.some[3, i] >= 0 and (state[i] != BESIDE or pane.opaque):
                state[i] = BEFORE


@exact
def _law(numbers: Floats, m: int, ray: Floats, state: Ints) -> None:
    """Trace through a homogeneous sheet in z = 0: matrix · d, where d · axis > 0 and it goes on forwards."""
    x, y, z, u, v, w, out = ray[0, :m], ray[1, :m], ray[2, :m], ray[3, :m], ray[4, :m], ray[5, :m], state[:m]
    matrix, axis, edges = numbers[MATRIX:AXIS], numbers[AXIS:EDGES], numbers[EDGES:SCALE]
    a, b, c, d, e, f = matrix[0], matrix[1], matrix[2], matrix[3], matrix[4], matrix[5]
    g, h, k, ax, ay, az = matrix[6], matrix[7], matrix[8], axis[0], axis[1], axis[2]
    x0, x1, y0, y1 = edges[0], edges[1], edges[2], edges[3]
    for i in range(m):
        s = -z[i] / w[i]
        px, py = x[i] + s * u[i], y[i] + s * v[i]
        on = (w[i] > 0.0) & (s >= 0.0) & (px >= x0) & (px < x1) & (py >= y0) & (py < y1)
        eu = a * u[i] + b * v[i] + c * w[i]
        ev = d * u[i] + e * v[i] + f * w[i]
        ew = g * u[i] + h * v[i] + k * w[i]
        goes = (ax * u[i] + ay * v[i] + az * w[i] > 0.0) & (ew > 0.0)
        x[i], y[i], z[i] = px if on else x[i], py if on else y[i], 0.0 if on else z[i]
        u[i], v[i], w[i] = eu if on else u[i], ev if on else v[i], ew if on else w[i]
        out[i] = (SHINES if goes else BLACK) if on else BESIDE


@exact
def _crosses(numbers: Floats, m: int, ray: Floats, near: Floats) -> int:
    """Mark the rays that pass through a box by 1, others by −1; return how many do."""
    x, y, z, u, v, w, out = ray[0, :m], ray[1, :m], ray[2, :m], ray[3, :m], ray[4, :m], ray[5, :m], near[:m]
    x0, y0, z0, x1, y1, z1 = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5]
    mx, my, hx, hy, hz = 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (x1 - x0), 0.5 * (y1 - y0), 0.5 * (z1 - z0)
    level = 0.5 * (z0 + z1)
    for i in range(m):  # where the ray is in the middle plane, and how far it may be off that inside the box
        inverse = 1.0 / w[i]
        s, lean, rise = (level - z[i]) * inverse, abs(u[i] * inverse) * hz, abs(v[i] * inverse) * hz
        inside = (abs(x[i] + s * u[i] - mx) <= hx + lean) & (abs(y[i] + s * v[i] - my) <= hy + rise)
        out[i] = 1.0 if inside & (w[i] > 0.0) else -1.0
    number = 0
    for i in range(m):
        number += 1 if out[i] > 0.0 else 0
    return number


@exact
def _surfaces(pane: Pane, m: int, pad: Pad, walk: Walk, state: Ints) -> None:
    """Trace through the exact surfaces: straight where the conditions of block trace hold, else walked."""
    near, ray, s = pad.near, pad.ray, walk.s
    for i in range(m):
        state[i] = BESIDE
    if _crosses(pane.numbers, m, ray, near) == 0:
        return
    scale = pane.numbers[SCALE]
    for c in range(3):
        place, way, start, along = s[ray_block.X + c], s[ray_block.DX + c], ray[c], ray[3 + c]
        for i in range(m):
            place[i], way[i] = start[i] * scale, along[i]
    sheet, none = pane.sheet, walk.out.hits
    lattice, bodies, last = sheet.lattice, sheet.bodies, len(sheet.faces) - 1
    launch_block(lattice, bodies[0], s, m)
    for i in range(m):
        walk.carried[i] = s[ray_block.PATH, i]
    array = straight(None, sheet, s, walk.chosen[:m], none, none, walk.carried, -1)
    face = sheet.faces[last]
    centres(lattice, s, m, array, lane(s, ray_block.GX), lane(s, ray_block.GY), face[slot.VX], face[slot.VY])
    top = bodies[len(bodies) - 1, slot.LEVEL] + face[slot.VZ]
    _collect(pane.shining, scale, top, m, s, ray, near, state)
    for i in range(m):
        if near[i] == 1.0:
            state[i] = _walked(pane, scale, walk, ray, i)


@exact
def _collect(
    shining: NDArray[np.uint8],
    scale: float,
    top: float,
    m: int,
    s: Floats,
    ray: Floats,
    near: Floats,
    state: Ints,
) -> None:
    """Collect the rays behind the sheet whose straight trace holds; their mark `near` becomes 2."""
    direct, ghost = SHINES if shining[ALIVE] else BLACK, SHINES if shining[GHOST] else BLACK
    x, y, z, u, v, w = ray[0, :m], ray[1, :m], ray[2, :m], ray[3, :m], ray[4, :m], ray[5, :m]
    px, py, pz, dx, dy, dz, good = lanes(
        s, (ray_block.GX, ray_block.GY, ray_block.Z, ray_block.DX, ray_block.DY, ray_block.DZ, ray_block.GOOD)
    )
    ci, cj, ci0, cj0, mark, out = (
        lane(s, ray_block.CI),
        lane(s, ray_block.CJ),
        lane(s, ray_block.CI0),
        lane(s, ray_block.CJ0),
        near[:m],
        state[:m],
    )
    inverse = 1.0 / scale
    for i in range(m):
        through = (mark[i] > 0.0) & (good[i] > 0.0) & (dz[i] > 0.0)
        x[i], y[i] = px[i] * inverse if through else x[i], py[i] * inverse if through else y[i]
        z[i] = (pz[i] + top) * inverse if through else z[i]
        u[i], v[i], w[i] = (
            dx[i] if through else u[i],
            dy[i] if through else v[i],
            dz[i] if through else w[i],
        )
        mark[i] = 2.0 if through else mark[i]
    for i in range(m):
        own = (ci[i] == ci0[i]) & (cj[i] == cj0[i])
        out[i] = (direct if own else ghost) if mark[i] == 2.0 else BESIDE


@exact
def _walked(pane: Pane, scale: float, walk: Walk, ray: Floats, i: int) -> int:
    """Walk one ray; put it behind the sheet where it shines."""
    start, way, out = walk.start, walk.way, walk.out
    position, direction = out.position, out.direction
    for c in range(3):
        start[0, c], way[0, c] = ray[c, i] * scale, ray[3 + c, i]
        position[0, c], direction[0, c] = start[0, c], way[0, c]
    out.fate[0] = MISSED
    reaches, launched = launch_ray(pane.sheet, start, way, 0)
    if reaches:
        walk_ray(None, None, pane.sheet, launched, 0, out, walk.scratch)
    fate = out.fate[0]
    if fate == MISSED:
        return BESIDE
    if not pane.shining[fate]:
        return BLACK
    for c in range(3):
        ray[c, i], ray[3 + c, i] = position[0, c] / scale, direction[0, c]
    return SHINES


@exact
def _blend(opaque: bool, before: bool, m: int, state: Ints, front: Floats, colour: Floats) -> None:
    """Set black where nothing shines, and add the light of objects before the sheet."""
    dark = 0
    for i in range(m):
        dark += 1 if (state[i] == BLACK) | (state[i] == BEFORE) | (opaque & (state[i] == BESIDE)) else 0
    if dark == 0:
        return
    for c in range(3):
        out, ahead = colour[c, :m], front[c, :m]
        for i in range(m):
            shown = (state[i] == SHINES) | ((state[i] == BESIDE) & (not opaque))
            out[i] = out[i] if shown else 0.0
        if before or opaque:
            for i in range(m):
                out[i] = ahead[i] if state[i] == BEFORE else out[i]


@exact
def _add(colour: Floats, slots: Ints, step: int, total: Floats, square: Floats) -> None:
    """Add `step` samples a pixel, and their squares, to the sums of the pixels `slots`."""
    if step == 1 and len(square) == 0:
        red, green, blue = colour[0], colour[1], colour[2]
        for i in range(len(slots)):
            row = slots[i]
            total[row, 0], total[row, 1], total[row, 2] = (
                total[row, 0] + red[i],
                total[row, 1] + green[i],
                total[row, 2] + blue[i],
            )
        return
    for i in range(len(slots)):
        row = slots[i]
        for k in range(3):
            value, over = 0.0, 0.0
            for j in range(i * step, (i + 1) * step):
                light = colour[k, j]
                value, over = value + light, over + light * light
            total[row, k] += value
            if len(square) > 0:
                square[row, k] += over
