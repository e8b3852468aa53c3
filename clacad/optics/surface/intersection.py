"""Intersection of rays with a surface, and Snell's law there.

Notation as in `clacad.optics.surface.sag_and_normal`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from clacad.base.types import Floats
from clacad.optics.surface.roots import (
    Columns,
    biconic_root,
    carry,
    polynomial_root,
    quadric_root,
    slope_root_of_hit,
)
from clacad.optics.surface.sag_and_normal import (
    EvenPolynomial,
    Quadric,
    Surface,
    lateral_gradient,
    slope_root,
)


class Meeting(NamedTuple):
    """Intersections of n rays with a surface; rows are NaN where there is none.

    Attributes
    ----------
    distance : (n,) array
        Along the direction as given (length for a unit direction); negative if the surface lies behind.
    gradient : (n, 3) array
        Unnormalised normal G, on the side that the ray goes to.
    root : (n,) array
        r = D·G >= 0, which is |D| |G| cos(incidence).
    """

    distance: Floats
    gradient: Floats
    root: Floats


def meet(surface: Surface, position: Floats, direction: Floats) -> Meeting:
    """Intersect rays, (n, 3) points (lengths) and unit directions, with a surface's apex half.

    See `meet_at`.
    """
    return meet_at(surface, position, direction)[0]


def meet_at(surface: Surface, position: Floats, direction: Floats) -> tuple[Meeting, Floats]:
    """Intersect rays with the apex half of a surface, in the surface's own frame.

    Parameters
    ----------
    position : (n, 3) array, length
        Apex at the origin.
    direction : (n, 3) array
        Unit direction cosines; another length scales `distance` and `root`.

    Returns
    -------
    meeting : Meeting
    point : (n, 3) array
        The point hit, NaN on a miss; its z keeps relative accuracy however small the sag.

    Notes
    -----
    Of the two crossings of a quadric the one from the −z side of the surface to its +z side is taken
    (for N < 0 from the +z side). The distance may be negative; the caller interprets that.
    The ray is carried to the vertex plane first and the root written C/(side r − B), whose terms add for
    lens-like hits; where they would cancel, the other form of the root is taken.
    """
    ray = _columns(direction)
    start = _columns(position)
    with np.errstate(all="ignore"):  # a miss is NaN, on purpose
        carried, base = carry(start, ray)
        if isinstance(surface, Quadric):
            t, root = quadric_root(surface, surface.kappa, start, base, ray)
        elif isinstance(surface, EvenPolynomial):
            t = polynomial_root(surface, base, ray)
            root = np.zeros_like(t)  # finite; the hit's own normal gives it
        else:
            t, root = biconic_root(surface, start, base, ray)
        x, y, z = (p + t * d for p, d in zip(base, ray))
        return _judge(surface, carried + t, root, (x, y, z), ray)


def refract(
    direction: Floats, gradient: Floats, root: Floats, n1: ArrayLike, n2: ArrayLike
) -> tuple[Floats, Floats]:
    """Snell's law in vector form, D' = µ D + g G.

    Parameters
    ----------
    direction : (n, 3) array
        Unit directions.
    gradient : (n, 3) array, root : (n,) array
        From `meet`: G oriented along the ray, r = D·G.
    n1, n2 : float or (n,) array
        Index before and after.

    Returns
    -------
    direction : (n, 3) array, unit
        NaN at total internal reflection.
    q : (n,) array
        D'·G = |G| cos(refraction).

    Notes
    -----
    g = (1 − µ²)/(q + µ r) is (q − µ r)/G² without its cancellation, and 1 − µ² = (n2 − n1)(n2 + n1)/n2²:
    equal
    indices give back the direction exactly, and n2/n1 = 1 + 1e-10 loses nothing. No angle is ever formed.
    """
    n1, n2 = np.asarray(n1, dtype=np.float64), np.asarray(n2, dtype=np.float64)
    mu = n1 / n2
    w = (n2 - n1) / n2 * ((n2 + n1) / n2)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        gx, gy, gz = gradient[:, 0], gradient[:, 1], gradient[:, 2]
        incident = mu * root
        q = np.sqrt((gx * gx + gy * gy + gz * gz) * w + incident * incident)
        total = q + incident
        # 0/0 is a ray tangent to a surface between equal indices: it goes straight on
        g = np.where((w == 0) & (total == 0), 0.0, w / total)
        mu = np.broadcast_to(mu, root.shape)
        out = mu[:, None] * direction + g[:, None] * gradient
    return out, q


def _judge(
    surface: Surface, distance: Floats, root: Floats, point: Columns, ray: Columns
) -> tuple[Meeting, Floats]:
    """Keep the crossings of the apex half and give their normals."""
    x, y, z = point
    quadric = isinstance(surface, Quadric)
    gz = 1.0 - surface.side * surface.kappa * z if isinstance(surface, Quadric) else slope_root(surface, x, y)
    if isinstance(surface, EvenPolynomial):
        gz = slope_root_of_hit(surface, x, y, z, gz)
    gx, gy = lateral_gradient(surface, x, y, gz)
    if not quadric:
        root = np.abs(gx * ray[0] + gy * ray[1] + gz * ray[2])
    misses = ~((gz > 0) & np.isfinite(distance) & np.isfinite(root))
    along = np.where(ray[2] < 0, -1.0, 1.0)
    gradient_rows = np.stack([along * gx, along * gy, along * gz], axis=-1)
    point_rows = np.stack(point, axis=-1)
    for rows in (distance, root, gradient_rows, point_rows):
        rows[misses] = np.nan
    return Meeting(distance, gradient_rows, root), point_rows


def _columns(rows: Floats) -> Columns:
    """x, y and z of (n, 3) rows, each contiguous."""
    x, y, z = (np.ascontiguousarray(rows[:, i], dtype=np.float64) for i in range(3))
    return x, y, z
