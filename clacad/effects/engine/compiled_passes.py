"""The passes over faces, compiled: one loop over the rays of a block, all faces of a ray at once.

Compiled versions of the numpy passes in `fresnel`, `absorption` and `polarisation` (bare faces), with the
same closed forms in D·D'. Loaded only together with the tracer's compiled kernels.
"""

from __future__ import annotations

from math import exp, sqrt
from typing import NamedTuple

from clacad.base.compiled import entry, exact
from clacad.base.types import Bytes, Cells, Floats
from clacad.optics.rays import Fate
from clacad.tracing.compiled.records import Vector

GHOST, TIR, MISSED = int(Fate.GHOST), int(Fate.TIR), int(Fate.MISSED)


class Traced(NamedTuple):
    """Record of a trace, and the refractive indices along it.

    start, ray : (n, 3). As launched, directions of any length.
    hits, turns : (f, n, 3). Point at which each face was hit and the direction behind it.
    fate : (n,) bytes, last : (n,) ints. Fate of the ray, and the last face that it hit.
    media : (f + 1,). Refractive index before the first face and behind each.
    """

    start: Floats
    ray: Floats
    hits: Floats
    turns: Floats
    fate: Bytes
    last: Cells
    media: Floats


@exact
def crosses(traced: Traced, k: int, row: int) -> bool:
    """Whether a ray crossed face k: its hit differs from the one before, and it did not end there."""
    fate, last = traced.fate[row], traced.last[row]
    if fate <= GHOST:
        return True
    if last < k or fate >= MISSED or (fate >= TIR and last == k):
        return False
    for c in range(3):
        before = traced.start[row, c] if k == 0 else traced.hits[k - 1, row, c]
        if traced.hits[k, row, c] != before:
            return True
    return False


@exact
def deviation(before: Vector, after: Vector) -> float:
    """1 − D·D' of unit directions, without its cancellation."""
    x, y, z = before
    u, v, w = after
    return 0.5 * ((u - x) * (u - x) + (v - y) * (v - y) + (w - z) * (w - z))


@exact
def reflected(turn: float, n1: float, n2: float) -> float:
    """Share of unpolarised light reflected at a bare face that deflects the ray by 1 − D·D' = turn.

    The only compiled version of `clacad.optics.surface.fresnel_coefficients.amplitudes`.
    """
    step = (n2 - n1) * (n2 + n1)
    if step == 0.0:
        return 0.0
    square = (n2 - n1) * (n2 - n1)
    cos, s = 1.0 - turn, square + 2.0 * n1 * n2 * turn
    p = (square - (n1 * n1 + n2 * n2) * turn) / cos
    return 0.5 * (s * s + p * p) / (step * step)


@exact
def fresnel_share(traced: Traced, row: int) -> float:
    """Share of unpolarised light that all bare faces crossed by one ray transmit; see `fresnel_pass`."""
    ray, turns, index = traced.ray, traced.turns, traced.media
    x, y, z = ray[row, 0], ray[row, 1], ray[row, 2]
    length = 1.0 / sqrt(x * x + y * y + z * z)
    x, y, z = x * length, y * length, z * length
    share = 1.0
    for k in range(len(index) - 1):
        u, v, w = turns[k, row, 0], turns[k, row, 1], turns[k, row, 2]
        if traced.fate[row] <= GHOST or crosses(traced, k, row):
            share *= 1.0 - reflected(deviation((x, y, z), (u, v, w)), index[k], index[k + 1])
        x, y, z = u, v, w
    return share


@entry
def fresnel_pass(traced: Traced, flux: Floats) -> None:
    """Multiply each ray's flux (n,) by the transmission of bare faces for unpolarised light."""
    for row in range(len(flux)):
        flux[row] *= fresnel_share(traced, row)


@exact
def absorbed(hits: Floats, rates: Floats, row: int) -> float:
    """Share of one ray that bodies of these attenuations (b,) transmit between its hits (2 b, n, 3)."""
    depth = 0.0
    for b in range(len(rates)):
        square = 0.0
        for c in range(3):
            step = hits[2 * b + 1, row, c] - hits[2 * b, row, c]
            square += step * step
        depth += rates[b] * sqrt(square)
    return exp(-depth)


@entry
def absorption_pass(hits: Floats, rates: Floats, flux: Floats) -> None:
    """Multiply each ray's flux by exp(−Σ rate · length) over the bodies (b,) between its hits (2 b, n, 3)."""
    for row in range(len(flux)):
        flux[row] *= absorbed(hits, rates, row)


@entry
def losses_pass(traced: Traced, rates: Floats, reflects: bool, flux: Floats) -> None:
    """Compute the flux of rays without one (NaN) from their hits; the straight trace failed for them."""
    for row in range(len(flux)):
        if flux[row] == flux[row]:
            continue
        flux[row] = absorbed(traced.hits, rates, row)
        if reflects:
            flux[row] *= fresnel_share(traced, row)


@exact
def across(wx: float, wy: float, x: float, y: float, z: float) -> Vector:
    """Unit vector across the ray (x, y, z) in the direction (wx, wy, 0)."""
    along = wx * x + wy * y
    a, b, c = wx - along * x, wy - along * y, -along * z
    scale = 1.0 / sqrt(a * a + b * b + c * c)
    return a * scale, b * scale, c * scale


@exact
def carried(field: Vector, before: Vector, after: Vector, n1: float, n2: float) -> Vector:
    """Carry the field E over a face that deflects the ray D into D'.

    Snell's law makes τ_s = τ_p D·D', so that τ_p (D·D' E − (E·D') D) is the field behind the face: its part
    across the plane of incidence times τ_s, the rest rotated and times τ_p. τ_p² = 4 n1 n2 (n2 c − n1)(n2 −
    n1 c)/(n2² − n1²)² c².
    """
    (a, b, c), (x, y, z), (u, v, w) = field, before, after
    turn = deviation(before, after)
    cos, less, step = 1.0 - turn, n2 - n1, (n2 - n1) * (n2 + n1)
    tau = 1.0
    if step != 0.0:
        tau = 2.0 * sqrt(n1 * n2 * (less - n2 * turn) * (less + n1 * turn)) / (abs(step) * cos)
    own, back = tau * cos, tau * (a * u + b * v + c * w)
    return own * a - back * x, own * b - back * y, own * c - back * z


@entry
def polarisation_pass(traced: Traced, analyser: Floats, polariser: Floats, flux: Floats) -> None:
    """Multiply each ray's flux by the transmission of polariser, faces and analyser.

    See `clacad.effects.polarisation`.

    analyser, polariser : (2,). Directions (cos, sin) of the sheet's x and y; NaN where there is none.
    """
    ray, turns, index = traced.ray, traced.turns, traced.media
    single = analyser[0] == analyser[0]
    filtered = polariser[0] == polariser[0]
    for row in range(len(flux)):
        x, y, z = ray[row, 0], ray[row, 1], ray[row, 2]
        scale = 1.0 / sqrt(x * x + y * y + z * z)
        ox, oy, oz = x * scale, y * scale, z * scale
        total = 0.0
        for field in range(1 if single else 2):
            x, y, z = ox, oy, oz
            a, b, c = across(analyser[0], analyser[1], x, y, z) if single else across(1.0, 0.0, x, y, z)
            if field == 1:
                a, b, c = y * c - z * b, z * a - x * c, x * b - y * a
            for k in range(len(turns)):
                u, v, w = turns[k, row, 0], turns[k, row, 1], turns[k, row, 2]
                if traced.fate[row] <= GHOST or crosses(traced, k, row):
                    a, b, c = carried((a, b, c), (x, y, z), (u, v, w), index[k], index[k + 1])
                x, y, z = u, v, w
            if filtered:
                p, q, r = across(polariser[0], polariser[1], x, y, z)
                total += (a * p + b * q + c * r) * (a * p + b * q + c * r)
            else:
                total += a * a + b * b + c * c
        flux[row] *= 0.5 * total
