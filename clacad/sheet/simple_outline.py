"""Validity of a closed polygon of straight and round sides as a plate's boundary:
no zero-length side, no intersection.
"""

from __future__ import annotations

from math import atan, ceil, pi

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.sheet.edge_columns import CX, CY, SENSE, X0, Y0
from clacad.sheet.plate import Plate
from clacad.sheet.plate_edges import Vertex

CHORDS = 8
"""Number of chords that replace an arc of 90° in intersection tests.

They deviate from it by 1/50 of its radius, a thousandth of what a mill needs.
"""


def fault(vertices: tuple[Vertex, ...]) -> str:
    """Describe the fault of a closed polygon, "" for a valid one;
    sides count from 0, as their first corners.
    """
    if len(vertices) < 3 and not any(bulge for _, _, bulge in vertices):
        return f"{len(vertices)} corners with straight sides enclose nothing"
    points = np.array(vertices)[:, :2]
    size = float(np.ptp(points, axis=0).max())
    short = np.flatnonzero(np.hypot(*(np.roll(points, -1, axis=0) - points).T) <= 1e-9 * size)
    if len(short):
        return f"side {short[0]} has no length: {_shown(points[short[0]])} occurs twice in a row"
    chords, side = _chords(vertices)
    met = _first_meeting(chords, 1e-9 * size)
    if met is None:
        return ""
    one, two = sorted((int(side[met[0]]), int(side[met[1]])))
    from_one, from_two = (_shown(points[n]) for n in (one, two))
    return (
        f"the sides from {from_one} and from {from_two}, {one} and {two}, meet or run back over one another"
    )


def _shown(point: Floats) -> str:
    return f"({point[0]:.6g}, {point[1]:.6g})"


def _chords(vertices: tuple[Vertex, ...]) -> tuple[Floats, Ints]:
    """Straight pieces (m, 4) of all sides, in order, and the index of the side of each piece."""
    points, side = [], []
    for n in range(len(vertices)):
        for edge in _edges_of(vertices, n):
            pieces = CHORDS if edge[SENSE] != 0.0 else 1
            turn = np.arange(pieces) * (_swept(edge) / pieces)
            u, v = edge[X0] - edge[CX], edge[Y0] - edge[CY]
            if edge[SENSE] == 0.0:
                points.append(edge[None, :2])
            else:
                turned = np.stack(
                    [u * np.cos(turn) - v * np.sin(turn), u * np.sin(turn) + v * np.cos(turn)], axis=1
                )
                points.append(edge[CX : CY + 1] + turned)
            side += [n] * pieces
    start = np.concatenate(points)
    return np.concatenate([start, np.roll(start, -1, axis=0)], axis=1), np.array(side)


def _edges_of(vertices: tuple[Vertex, ...], n: int) -> Floats:
    """Edges of one side: one edge, or the parts of an arc of more than 90°."""
    bulge = vertices[n][2]
    parts = 1 if bulge == 0.0 else ceil(4.0 * atan(abs(bulge)) / (0.5 * pi) - 1e-9)
    (x, y, _), (u, v, _) = vertices[n], vertices[(n + 1) % len(vertices)]
    return Plate(((x, y, bulge), (u, v, 0.0))).edges[:parts]


def _swept(edge: Floats) -> float:
    """Signed angle (radians) of an arc."""
    a, b = edge[:2] - edge[CX : CY + 1], edge[2:4] - edge[CX : CY + 1]
    return float(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))


def _first_meeting(chords: Floats, near: float) -> tuple[int, int] | None:
    """First two pieces (4,) of a closed chain that intersect without being neighbours, or fold back;
    None if none do.
    """
    low, high = (
        np.minimum(chords[:, :2], chords[:, 2:]) - near,
        np.maximum(chords[:, :2], chords[:, 2:]) + near,
    )
    order = np.argsort(low[:, 0], kind="stable")
    starts = low[order, 0]
    m = len(chords)
    for place, k in enumerate(order):
        last = int(np.searchsorted(starts, high[k, 0], side="right"))
        rest = order[place + 1 : last]
        rest = rest[(low[rest, 1] <= high[k, 1]) & (high[rest, 1] >= low[k, 1])]
        if not len(rest):
            continue
        apart = (rest - k) % m
        beside = (apart == 1) | (apart == m - 1)
        if m > 2 and beside.any():
            folded = [int(j) for j in rest[beside] if _folds(chords, int(k), int(j), near)]
            if folded:
                return int(k), folded[0]
        met = rest[~beside][_meets(chords[k], chords[rest[~beside]], near)]
        if len(met):
            return int(k), int(met[0])
    return None


def _folds(chords: Floats, k: int, j: int, near: float) -> bool:
    """Whether two neighbouring pieces fold back over one another."""
    first, second = (k, j) if (j - k) % len(chords) == 1 else (j, k)
    u, v = chords[first, 2:] - chords[first, :2], chords[second, 2:] - chords[second, :2]
    return bool(u @ v < 0.0 and abs(u[0] * v[1] - u[1] * v[0]) <= near * max(np.hypot(*u), np.hypot(*v)))


def _meets(one: Floats, others: Floats, near: float) -> Bools:
    """Which of the pieces `others` (k, 4) intersect the piece `one`, within `near` (length)."""
    a, b, c, d = one[:2], one[2:], others[:, :2], others[:, 2:]

    def beside(p: Floats, q: Floats, r: Floats) -> Floats:
        way = q - p
        length = np.hypot(way[..., 0], way[..., 1])
        return np.asarray(
            (way[..., 0] * (r - p)[..., 1] - way[..., 1] * (r - p)[..., 0]) / np.maximum(length, 1e-300)
        )

    def within(x: Floats, y: Floats) -> Bools:
        """Whether two signed distances do not lie on the same side beyond `near`."""
        return np.asarray(~(((x > near) & (y > near)) | ((x < -near) & (y < -near))))

    return np.asarray(within(beside(a, b, c), beside(a, b, d)) & within(beside(c, d, a), beside(c, d, b)))
