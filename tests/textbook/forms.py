"""The formulas of textbooks, written as they are printed: what the stable forms are measured against.

Nothing here is wrong in exact arithmetic (the law in slopes apart, which does not know when it has no answer).
"""

from __future__ import annotations

import numpy as np
from oracle.trace import POWERS


def sag(face, x, y):
    """Height of a face: R - sqrt(R² - r²) and its relatives with the conic constant; NaN where they fail."""
    cx, cy, k, m, side = (np.float64(v) for v in face.shape)
    with np.errstate(all="ignore"):
        if face.kind == "quadric":  # semi-axis 1/κ: z = (1 - sqrt(1 - κ (cx x² + cy y²)))/κ
            return side * (1 / k - np.sqrt(1 / k**2 - (cx * x * x + cy * y * y) / k))
        q = cx * x * x + cy * y * y
        height = q / (1 + np.sqrt(1 - (1 + k) * cx**2 * x * x - (1 + m) * cy**2 * y * y))
        return side * (
            height + sum(a * np.float64(x) ** i * np.float64(y) ** j for a, (i, j) in zip(face.terms, POWERS))
        )


def cell(kind, pitch, count, x, y):
    """Index and place of a point: a quotient, its floor, and the product of both subtracted."""
    if kind == "hexagonal":
        row = 0.8660254037844386 * pitch[0]
        x = x + 0.5 * pitch[0] * (count[0] - 1 + (count[1] // 2) / count[1])
        y = y + 0.5 * row * (count[1] - 1)
        j = round(y / row)
        i = round(x / pitch[0] - 0.5 * j)
        return (i, j), (x - (i + 0.5 * j) * pitch[0], y - j * row)
    index, place = [], []
    for u, p, n in zip((x, y), pitch, count):
        k = int(np.floor((u + 0.5 * n * p) / p))
        index.append(k)
        place.append(u + 0.5 * n * p - (k + 0.5) * p)
    return tuple(index), tuple(place)


def angle(first, second):
    """Angle from the scalar product of unit vectors."""
    with np.errstate(all="ignore"):
        a, b = (
            np.asarray(v, float) / np.sqrt(np.sum(np.square(np.asarray(v, float)))) for v in (first, second)
        )
        return np.arccos(np.clip(a @ b, -1.0, 1.0))


def stretch(eta, z, camera):
    """(D + z)/(D + z/η)."""
    with np.errstate(all="ignore"):
        return np.float64(camera + z) / np.float64(camera + z / eta)


def index(formula, coefficients, metres):
    """N from λ in micrometres, the terms summed in the order in which they are listed."""
    um, c = 1e6 * np.float64(metres), coefficients
    if formula == "sellmeier":
        return np.sqrt(1.0 + sum(b / (1.0 - p / um**2) for b, p in zip(c[::2], c[1::2])))
    if formula == "gas":
        return 1.0 + c[0] + sum(b / (pole - um**-2) for b, pole in zip(c[1::2], c[2::2]))
    n = c[0] + sum(b * um**p for b, p in zip(c[1::2], c[2::2]))
    return np.sqrt(n) if formula == "schott" else n


def inner_share(outer, inner, lines, middle):
    """(1/V1 − Δ1/n1)/(Δ2/n2 − Δ1/n1) with V = (n − 1)/Δ."""
    (n1, d1), (n2, d2) = (
        (n[0], n[1] - n[2])
        for n in (
            [index("cauchy", (*glass, -2.0), wave) for wave in (middle, *lines)] for glass in (outer, inner)
        )
    )
    with np.errstate(all="ignore"):
        v = (n1 - 1.0) / d1
        return (1.0 / v - d1 / n1) / (d2 / n2 - d1 / n1)


def rotation(phi, theta, psi, axes="fixed"):
    """Rz(psi) Rx(theta) Rz(phi)."""
    if axes == "moving":
        phi, psi = psi, phi

    def about_z(a):
        return np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])

    about_x = np.array([[1, 0, 0], [0, np.cos(theta), -np.sin(theta)], [0, np.sin(theta), np.cos(theta)]])
    return about_z(psi) @ about_x @ about_z(phi)


def law(numbers, direction, axes="fixed"):
    """T' = (t - δ)/η with t = d_x/d_z in the lens frame; None where the arithmetic fails."""
    eta_x, eta_y, delta_x, delta_y, *angles = numbers
    turn = rotation(*angles, axes)
    with np.errstate(all="ignore"):
        d = turn.T @ np.asarray(direction, float)
        slopes = np.array([(d[0] / d[2] - delta_x) / eta_x, (d[1] / d[2] - delta_y) / eta_y, 1.0])
        out = turn @ slopes
        out = out / np.sqrt(np.sum(out * out))
    return out if np.isfinite(out).all() else None
