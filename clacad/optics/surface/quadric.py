"""Intersection of a ray with a quadric: the cancellation-free root.

Notation as in `clacad.optics.surface.sag_and_normal`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clacad.base.pairs import negated, pair, pair_product, pair_sum, two_product
from clacad.base.types import Floats
from clacad.optics.surface.sag_and_normal import Quadric, Surface

Columns = tuple[Floats, Floats, Floats]


CANCELS = 1e3
"""B²/|B² − AC| above which the discriminant is formed in pairs: plain arithmetic loses about that factor."""


STEEPEST = 0.25
"""|N| below which rays are not carried to the vertex plane, which may lie far off, but to the apex's
level.
"""


def carry(start: Columns, ray: Columns) -> tuple[Floats, Columns]:
    """Distance (n,) to a base point near the apex, and that point, three columns (n,); lengths.

    It lies in the vertex plane; for steep rays it is the point nearest to the apex.
    """
    (x, y, z), (L, M, N) = start, ray
    square = L * L + M * M + N * N
    flat = N * N >= STEEPEST * STEEPEST * square
    t = np.where(flat, -z / N, -(x * L + y * M + z * N) / square)
    return t, (x + t * L, y + t * M, np.where(flat, 0.0, z + t * N))


def quadric_root(
    surface: Surface, kappa: Floats | float, start: Columns, base: Columns, ray: Columns
) -> tuple[Floats, Floats]:
    """Distance from the base point (length) and r = sqrt(B² − AC), (n,) each, of a quadric of the surface's
    curvatures.

    kappa : 1/length, (n,) or one for all; start, base, ray : three columns (n,): point, base point,
        direction.
    """
    cx, cy, side = surface.curvature_x, surface.curvature_y, surface.side
    (x, y, z), (L, M, N) = base, ray
    a = cx * L * L + cy * M * M + kappa * N * N
    b = cx * x * L + cy * y * M + (kappa * z - side) * N
    c = cx * x * x + cy * y * y + (kappa * z - 2 * side) * z
    discriminant = b * b - a * c
    nearly_double = b * b > CANCELS * np.abs(discriminant)
    if nearly_double.any():
        rows = np.flatnonzero(nearly_double)
        chosen = np.broadcast_to(kappa, b.shape)[rows]
        discriminant[rows] = _discriminant((cx, cy, side), chosen, pick(start, rows), pick(ray, rows))
    root = np.sqrt(discriminant)
    sign_root = np.where(N < 0, -side, side) * root
    adds = sign_root * b <= 0
    numerator = np.where(adds, c, -(b + sign_root))
    return numerator / np.where(adds, sign_root - b, a), root


def upright_sag(surface: Quadric, x: Floats, y: Floats) -> Floats | None:
    """Sag (n,) over points x, y (n,), lengths; bit for bit the hit of a ray along +z. NaN past the equator.

    None where a point is so near the equator that the root needs the ray's compensated discriminant.
    """
    kappa, side = surface.kappa, surface.side
    with np.errstate(all="ignore"):  # beyond the equator there is no height, on purpose
        c = surface.curvature_x * x * x + surface.curvature_y * y * y
        discriminant = 1.0 - kappa * c
        if (CANCELS * np.abs(discriminant) < 1.0).any():
            return None
        sag = c / (side * np.sqrt(discriminant) + side)
        kept = (1.0 - side * kappa * sag > 0.0) & np.isfinite(sag)
    return np.where(kept, sag, np.nan)


def _discriminant(
    shape: tuple[float, float, int],
    kappa: Floats,
    start: tuple[Floats, ...],
    ray: tuple[Floats, ...],
) -> Floats:
    """B² − AC in pairs. It is constant along the ray, so the unrounded start is used."""
    cx, cy = pair(shape[0]), pair(shape[1])
    side, k = float(shape[2]), pair(kappa)
    (x, y, z), (L, M, N) = start, ray
    level = pair_sum(two_product(kappa, z), pair(np.full_like(z, -side)))
    above = pair_sum(two_product(kappa, z), pair(np.full_like(z, -2 * side)))
    a = pair_sum(
        pair_product(cx, two_product(L, L)),
        pair_product(cy, two_product(M, M)),
        pair_product(k, two_product(N, N)),
    )
    b = pair_sum(
        pair_product(cx, two_product(x, L)), pair_product(cy, two_product(y, M)), pair_product(level, pair(N))
    )
    c = pair_sum(
        pair_product(cx, two_product(x, x)), pair_product(cy, two_product(y, y)), pair_product(above, pair(z))
    )
    return pair_sum(pair_product(b, b), negated(pair_product(a, c)))[0]


def pick(columns: Columns, rows: NDArray[np.intp]) -> Columns:
    """Select rows of three columns."""
    return columns[0][rows], columns[1][rows], columns[2][rows]
