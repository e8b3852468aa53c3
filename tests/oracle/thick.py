"""Thick lenses in 50 digits: ray-transfer matrices, the confocal pair, least thickness, volumes."""

from __future__ import annotations

from mpmath import mp, mpf

DIGITS = 50


def matrix(faces):
    """Ray-transfer matrix (height, slope) of faces (curvature towards +z, vertex, index before, index after)."""
    with mp.workdps(DIGITS):
        total, z = mp.matrix([[1, 0], [0, 1]]), None
        for curvature, vertex, before, after in faces:
            vertex, before, after = mpf(vertex), mpf(before), mpf(after)
            if z is not None:
                total = mp.matrix([[1, vertex - z], [0, 1]]) * total
            power = (after - before) * mpf(curvature)
            total = mp.matrix([[1, 0], [-power / after, before / after]]) * total
            z = vertex
        return total


def confocal_radii(eta, separation, thickness, index):
    """Radii of two biconvex thick lenses, centres `separation` apart, that are afocal with slope gain 1/η.

    Written from the matrices alone: the pair's matrix must have C = 0 and D = 1/η; solved in R1, R2 at once.
    """
    with mp.workdps(DIGITS):
        eta, s, n = mpf(eta), mpf(separation), mpf(index)
        t1, t2 = (mpf(t) for t in thickness)

        def pair(r1, r2):
            m = matrix([(1 / r1, -t1 / 2, 1, n), (-1 / r1, t1 / 2, n, 1), (1 / r2, s - t2 / 2, 1, n), (-1 / r2, s + t2 / 2, n, 1)])  # fmt: skip
            return [m[1, 0] * s, m[1, 1] * eta - 1]

        thin = [2 * (n - 1) * s / (1 - eta), -2 * (n - 1) * eta * s / (1 - eta)]
        root = mp.findroot(pair, thin, tol=mpf(10) ** -40)
        return root[0], root[1]


def least_thickness(radius_x, radius_y, depth, half):
    """Centre thickness at which a biconvex ellipsoid's rim passes the corner of a square cell of half side `half`."""
    with mp.workdps(DIGITS):
        q = mpf(half) ** 2 * (1 / mpf(radius_x) + 1 / mpf(radius_y))
        sag = mpf(depth) * (1 - mp.sqrt(1 - q / mpf(depth)))
        return 2 * sag


def column_volume(front, back, half_x, half_y):
    """Volume over a rectangle between two quadrics given as (cx, cy, κ, side, vertex z), apex over the middle."""
    with mp.workdps(30):

        def height(face, x, y):
            cx, cy, kappa, side, z = (mpf(v) for v in face)
            q = cx * x * x + cy * y * y
            return z + side * q / (1 + mp.sqrt(1 - kappa * q))

        def thick(x, y):
            return height(back, x, y) - height(front, x, y)

        return 4 * mp.quad(thick, [0, mpf(half_x)], [0, mpf(half_y)], maxdegree=4)
