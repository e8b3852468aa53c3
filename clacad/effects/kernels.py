"""The passes over faces, compiled: one loop over the rays of a block, all faces of a ray at once.

Twins of the numpy passes in `fresnel`, `absorption` and `polarisation` (bare faces); the same closed forms in
D·D' and nothing else. Loaded only where the tracer's compiled kernels are.
"""

from __future__ import annotations

from math import exp, sqrt

import numpy as np
from numpy.typing import NDArray

from clacad.trace.compiled import fused

Floats = NDArray[np.float64]
Fates = NDArray[np.uint8]
Cells = NDArray[np.int32]

GHOST, TIR, MISSED = 1, 4, 7  # of clacad.rays.Fate: compiled code reads plain numbers


@fused
def crosses(fate: int, last: int, k: int, hits: Floats, start: Floats, row: int) -> bool:
    """Whether a ray went through face k: it met it at another place than the one before, and did not end there."""
    if fate <= GHOST:
        return True
    if last < k or fate >= MISSED or (fate >= TIR and last == k):
        return False
    for c in range(3):
        before = start[row, c] if k == 0 else hits[k - 1, row, c]
        if hits[k, row, c] != before:
            return True
    return False


@fused
def fresnel_pass(
    start: Floats,
    ray: Floats,
    hits: Floats,
    turns: Floats,
    fate: Fates,
    last: Cells,
    index: Floats,
    flux: Floats,
) -> None:
    """Multiply each ray's flux by what bare faces let through of unpolarised light.

    Parameters
    ----------
    start, ray : (n, 3)
        As launched, any length.
    hits, turns : (f, n, 3)
    index : (f + 1,)
        Refractive index before the first face and behind each.
    """
    faces = len(turns)
    scale, base, slope_s, slope_p = np.empty(faces), np.empty(faces), np.empty(faces), np.empty(faces)
    for k in range(faces):
        n1, n2 = index[k], index[k + 1]
        step = (n2 - n1) * (n2 + n1)
        scale[k] = 0.0 if step == 0.0 else 1.0 / step
        base[k], slope_s[k], slope_p[k] = (n2 - n1) * (n2 - n1), 2.0 * n1 * n2, n1 * n1 + n2 * n2
    for row in range(len(flux)):
        x, y, z = ray[row, 0], ray[row, 1], ray[row, 2]
        length = 1.0 / sqrt(x * x + y * y + z * z)
        x, y, z = x * length, y * length, z * length
        share, plain = 1.0, fate[row] <= GHOST
        for k in range(faces):
            u, v, w = turns[k, row, 0], turns[k, row, 1], turns[k, row, 2]
            if plain or crosses(fate[row], last[row], k, hits, start, row):
                turn = 0.5 * ((u - x) * (u - x) + (v - y) * (v - y) + (w - z) * (w - z))
                s = (base[k] + slope_s[k] * turn) * scale[k]
                p = (base[k] - slope_p[k] * turn) * scale[k] / (1.0 - turn)
                share *= 1.0 - 0.5 * (s * s + p * p)
            x, y, z = u, v, w
        flux[row] *= share


@fused
def absorption_pass(hits: Floats, rates: Floats, flux: Floats) -> None:
    """Multiply each ray's flux by exp(−Σ rate · length) over the bodies (b,) that its hits (2 b, n, 3) bound."""
    for row in range(len(flux)):
        depth = 0.0
        for b in range(len(rates)):
            square = 0.0
            for c in range(3):
                step = hits[2 * b + 1, row, c] - hits[2 * b, row, c]
                square += step * step
            depth += rates[b] * sqrt(square)
        flux[row] *= exp(-depth)


Vector = tuple[float, float, float]


@fused
def across(wx: float, wy: float, x: float, y: float, z: float) -> Vector:
    """Unit vector across the ray (x, y, z) in the direction (wx, wy, 0)."""
    along = wx * x + wy * y
    a, b, c = wx - along * x, wy - along * y, -along * z
    scale = 1.0 / sqrt(a * a + b * b + c * c)
    return a * scale, b * scale, c * scale


@fused
def carried(
    a: float,
    b: float,
    c: float,
    x: float,
    y: float,
    z: float,
    u: float,
    v: float,
    w: float,
    n1: float,
    n2: float,
) -> Vector:
    """Carry the field (a, b, c) over a face that turns (x, y, z) into (u, v, w)."""
    turn = 0.5 * ((u - x) * (u - x) + (v - y) * (v - y) + (w - z) * (w - z))
    cos = 1.0 - turn
    tau, factor = 1.0, 0.0
    step = (n2 - n1) * (n2 + n1)
    if step != 0.0:
        square, per = (n2 - n1) * (n2 - n1), 1.0 / (step * cos)
        s = -(square + 2.0 * n1 * n2 * turn) * per * cos
        p = (square - (n1 * n1 + n2 * n2) * turn) * per
        tau = sqrt(1.0 - p * p)
        factor = -2.0 * n1 * n2 * (p - s) * per / (sqrt(1.0 - s * s) + tau)
    sx, sy, sz = y * w - z * v, z * u - x * w, x * v - y * u
    along = tau * (a * u + b * v + c * w) / (1.0 + cos)
    side = factor * (a * sx + b * sy + c * sz)
    return (
        tau * a - along * (x + u) + side * sx,
        tau * b - along * (y + v) + side * sy,
        tau * c - along * (z + w) + side * sz,
    )


@fused
def polarisation_pass(
    start: Floats, ray: Floats, hits: Floats, turns: Floats, fate: Fates, last: Cells, index: Floats,
    analyser: Floats, polariser: Floats, flux: Floats,
) -> None:  # fmt: skip
    """Multiply each ray's flux by what polariser, faces and analyser pass; see `clacad.effects.polarisation`.

    Parameters
    ----------
    analyser, polariser : (2,)
        Directions (cos, sin) of the sheet's x and y; NaN where there is none.
    """
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
                if fate[row] <= GHOST or crosses(fate[row], last[row], k, hits, start, row):
                    a, b, c = carried(a, b, c, x, y, z, u, v, w, index[k], index[k + 1])
                x, y, z = u, v, w
            if filtered:
                p, q, r = across(polariser[0], polariser[1], x, y, z)
                total += (a * p + b * q + c * r) * (a * p + b * q + c * r)
            else:
                total += a * a + b * b + c * c
        flux[row] *= 0.5 * total
