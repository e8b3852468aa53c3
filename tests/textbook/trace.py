"""A sequential tracer as textbooks print it: sheet coordinates, (-b ± sqrt(b² - 4ac))/2a, cosines by Pythagoras."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from hard.measure import turn_of
from oracle.trace import POWERS


@dataclass
class Path:
    """What became of one ray."""

    status: str = "ok"
    hits: list = field(default_factory=list)
    directions: list = field(default_factory=list)
    optical_path: float = 0.0


def trace(faces, start, direction):
    """Trace one ray through the oracle's faces."""
    path = Path()
    with np.errstate(all="ignore"):
        position, ray = np.array(start, float), np.array(direction, float)
        ray = ray / np.sqrt(ray @ ray)
        for face in faces:
            turn = np.eye(3) if turn_of(face) is None else turn_of(face)
            local, d = turn.T @ (position - np.array(face.vertex)), turn.T @ ray
            t = _distance(face, local, d)
            if not t >= 0:
                path.status = "missed"
                return path
            hit = local + t * d
            path.optical_path += face.before * t
            position = turn @ hit + np.array(face.vertex)
            path.hits.append(position)
            out = _snell(d, _normal(face, hit), face.before, face.after)
            if out is None:
                path.status = "tir"
                return path
            ray = turn @ out
            path.directions.append(ray)
    return path


def _distance(face, p, d):
    cx, cy, k, m, side = face.shape
    if face.kind != "quadric":
        return _newton(face, p, d)
    (x, y, z), (L, M, N) = p, d
    a = cx * L * L + cy * M * M + k * N * N
    b = 2 * (cx * x * L + cy * y * M + k * z * N - side * N)
    c = cx * x * x + cy * y * y + k * z * z - 2 * side * z
    if a == 0:
        return -c / b if b else np.nan
    root = np.sqrt(b * b - 4 * a * c)
    both = [(-b - root) / (2 * a), (-b + root) / (2 * a)]
    good = [t for t in both if 1 - side * k * (z + t * N) > 0]
    return min(good, key=lambda t: abs(z + t * N)) if good else np.nan


def _newton(face, p, d):
    t = -p[2] / d[2]
    for _ in range(30):
        x, y, z = p + t * d
        normal = _normal(face, (x, y, z))
        t -= (z - _height(face, x, y)) * normal[2] / (normal @ d)
    return t


def _height(face, x, y):
    cx, cy, k, m, side = face.shape
    w = np.sqrt(1 - (1 + k) * cx**2 * x * x - (1 + m) * cy**2 * y * y)
    return side * ((cx * x * x + cy * y * y) / (1 + w) + _terms(face, x, y)[0])


def _terms(face, x, y):
    """Terms of order 4 to 8, as sums of powers, and their slopes."""
    found = np.zeros(3)
    for a, (m, n) in zip(face.terms, POWERS):
        found += a * np.array([x**m * y**n, m * x ** max(m - 1, 0) * y**n, n * x**m * y ** max(n - 1, 0)])
    return found


def _normal(face, hit):
    cx, cy, k, m, side = face.shape
    x, y, z = hit
    if face.kind == "quadric":
        normal = np.array([-side * cx * x, -side * cy * y, 1 - side * k * z])
    else:
        a, b = (1 + k) * cx**2, (1 + m) * cy**2
        w = np.sqrt(1 - a * x * x - b * y * y)
        q = cx * x * x + cy * y * y
        _, in_x, in_y = _terms(face, x, y)
        normal = np.array(
            [
                -side * (2 * cx * x / (1 + w) + q * a * x / (w * (1 + w) ** 2) + in_x),
                -side * (2 * cy * y / (1 + w) + q * b * y / (w * (1 + w) ** 2) + in_y),
                1.0,
            ]
        )
    return normal / np.sqrt(normal @ normal)


def _snell(d, normal, n1, n2):
    mu = n1 / n2
    cosine = d @ normal
    if cosine < 0:
        normal, cosine = -normal, -cosine
    under = 1 - mu**2 * (1 - cosine**2)
    if under < 0:
        return None
    return mu * d + (np.sqrt(under) - mu * cosine) * normal
