"""Target of light on a screen: points with weights, from a picture's light or from a file of points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats, Ints, Pair2
from clacad.design.cell_table_rows import NumberRows

LUMINANCE: Final = (0.2126, 0.7152, 0.0722)
"""Weights of linear red, green and blue in luminance (Rec. 709)."""

MOST_PIXELS: Final = 1 << 20
"""Largest number of pixels; larger pictures are reduced. Each spot covers more than one of them anyway."""


ROWS: Final = 4096
"""Number of points whose light is spread at a time."""


class NoTarget(ValueError):
    """A picture or points that cannot be a target of light; exit status 2."""

    exit_status = 2


@dataclass(frozen=True, eq=False)
class Target:
    """Target of light on the screen.

    points : (m, 2) lengths. Screen x and y, in the order in which they are assigned to cells.
    weights : (m,). Part of the light for each, sum 1.
    grain : (2,) lengths. Size of a pixel, over which the points of its cells are spread; 0 for points.
    pixels : (h, w) or None. Of a picture.
    """

    points: Floats
    weights: Floats
    grain: Pair2
    pixels: tuple[int, int] | None = None

    def light(self, edges: tuple[Floats, Floats], blur: Pair2) -> Floats:
        """Light (n_x, n_y) between edges (n + 1,), lengths, along x and y; the sum is at most 1.

        The result is exact: each point is a box of its grain, blurred by a box.
        """
        (x, column), (y, row) = (np.unique(self.points[:, k], return_inverse=True) for k in (0, 1))
        parts = [
            np.diff(_box_over_box(edge[None, :] - at[:, None], grain, width), axis=1)
            for edge, at, grain, width in zip(edges, (x, y), self.grain, blur, strict=True)
        ]
        if self.pixels is not None:
            each = np.zeros((len(x), len(y)))
            np.add.at(each, (column, row), self.weights)
            return np.asarray(parts[0].T @ each @ parts[1])
        made = np.zeros((len(edges[0]) - 1, len(edges[1]) - 1))
        for first in range(0, len(self.points), ROWS):
            some = slice(first, first + ROWS)
            made += (parts[0][column[some]] * self.weights[some, None]).T @ parts[1][row[some]]
        return made

    def places(self, count: int) -> Floats:
        """Points (count, 2), lengths; each target point gets a number proportional to its weight, within one.
        Systematic sampling along the order of the points; within a pixel the samples are spread evenly.

        Raises NoTarget: `count` is below the number of points of a pattern.
        """
        if self.pixels is None and count < len(self.points):
            raise NoTarget(f"{len(self.points)} points need as many cells, and the sheet has {count}")
        edges = np.cumsum(self.weights)
        which = np.searchsorted(edges, (np.arange(count) + 0.5) / count * edges[-1], side="left")
        which = np.minimum(which, len(edges) - 1)
        first = np.searchsorted(which, which, side="left")
        spread = sobol(int((np.arange(count) - first).max()) + 1, 2) - 0.5
        return np.asarray(self.points[which] + spread[np.arange(count) - first] * self.grain)


def _box_over_box(x: Floats, first: float, second: float) -> Floats:
    """Share below x (lengths) of a box of width `first` blurred by a box `second` > 0, both about 0."""
    if first == 0.0:
        return np.clip(x / second + 0.5, 0.0, 1.0)

    def twice(at: Floats) -> Floats:
        return 0.5 * np.maximum(at, 0.0) ** 2

    high, low = 0.5 * (first + second), 0.5 * (first - second)
    whole = twice(x + high) - twice(x + low) - twice(x - low) + twice(x - high)
    return np.clip(whole / (first * second), 0.0, 1.0)


def of_picture(light: Floats, width: float) -> Target:
    """Target of a picture.

    light : (h, w, 3) or (h, w) array. Linear light; row 0 is the top, +y, and column 0 the left, −x: as seen
        from behind the screen, towards the sheet.
    width : length. Of the picture on the screen, centred on the sheet's axis.
    Raises NoTarget: It is black.
    """
    grey = light @ np.array(LUMINANCE) if light.ndim == 3 else light
    grey = _reduced(np.asarray(grey, dtype=np.float64))
    total = float(grey.sum())
    if not total > 0.0:
        raise NoTarget("the picture is black: there is nowhere to send light to")
    height, across = grey.shape
    pixel = width / across
    order = _along_hilbert(height, across)
    row, column = order.T
    x, y = (column + 0.5 - 0.5 * across) * pixel, (0.5 * height - row - 0.5) * pixel
    lit = grey[row, column] > 0.0
    points = np.column_stack([x, y])[lit]
    return Target(points, grey[row, column][lit] / total, (pixel, pixel), (height, across))


def of_points(path: Path) -> Target:
    """Target of a CSV file with the header x,y or x,y,weight; lengths in the design's unit.

    Raises DesignError: With row and column: another header, or a value that is no number.
    Raises NoTarget: No point, or no weight above 0.
    """
    with path.open("rb") as stream:
        weighted = b"weight" in stream.readline(1000)
    rows = NumberRows(str(path), ("x", "y", "weight") if weighted else ("x", "y"))
    found = []
    for numbers, lines, first in rows.blocks():
        bad = ~(np.abs(numbers) <= 1e9) | (np.arange(numbers.shape[1]) == 2) & (numbers < 0.0)
        if bad.any():
            row, column = (int(v[0]) for v in np.nonzero(bad))
            rows.refuse(
                f"{rows.columns[column]} is out of range",
                first + row,
                lines[row],
                column,
                allowed="a number >= 0" if column == 2 else "a length",
            )
        found.append(numbers)
    every = np.concatenate(found) if found else np.empty((0, len(rows.columns)))
    weights = every[:, 2] if weighted else np.ones(len(every))
    if not weights.sum() > 0.0:
        raise NoTarget(f"{path}: no point has a weight: there is nowhere to send light to")
    lit = weights > 0.0
    return Target(every[lit, :2], weights[lit] / weights.sum(), (0.0, 0.0))


def _reduced(grey: Floats) -> Floats:
    """Block means of a picture (h, w) with too many pixels.

    Edge blocks are averaged over their own pixels.
    """
    side = int(np.ceil(np.sqrt(grey.size / MOST_PIXELS)))
    if side <= 1:
        return grey
    down, across = (np.arange(0, n, side) for n in grey.shape)
    sums = np.add.reduceat(np.add.reduceat(grey, down, axis=0), across, axis=1)
    return np.asarray(sums)


def _along_hilbert(height: int, width: int) -> Ints:
    """Pixels (h w, 2) as row and column along a Hilbert curve, so that consecutive pixels are neighbours."""
    side = 1
    while side < max(height, width):
        side *= 2
    row, column = (v.ravel().astype(np.int64) for v in np.mgrid[:height, :width])
    x, y, place = column.copy(), row.copy(), np.zeros(len(row), dtype=np.int64)
    step = side // 2
    while step > 0:
        right, low = (x & step) > 0, (y & step) > 0
        place += step * step * ((3 * right) ^ low)
        flip = ~low
        turn = flip & right
        x, y = np.where(turn, side - 1 - x, x), np.where(turn, side - 1 - y, y)
        x, y = np.where(flip, y, x), np.where(flip, x, y)
        step //= 2
    order = np.argsort(place, kind="stable")
    return np.column_stack([row, column])[order]
