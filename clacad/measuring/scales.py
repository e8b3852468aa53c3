"""Scales of an instrument: stated with their uncertainty, or found from two maps of one field.

A map fixes only the radius over the scale of heights: both are one number. A second map of the same field,
tilted by some degrees, separates them: the steps of the lattice have one length in both maps, and only in
the
tilted one do heights belong to it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import degrees, isfinite

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.measuring.find_lattice import NotMeasurable
from clacad.measuring.fit_lenslets import Lenslets
from clacad.storage.errors import BadRequest

LEAST_TILT = 0.05
"""Least tilt (radians) of one map against the other by which the scale of heights is found."""


@dataclass(frozen=True)
class Scale:
    """A scale of an instrument: a length in its file over the true one.

    value : float
    half : Half width of its uncertainty at a coverage of 95 %; relative to 1.
    origin : Where it comes from: "stated", "assumed" or "found".
    """

    value: float = 1.0
    half: float = 0.0
    origin: str = "stated"

    def __str__(self) -> str:
        return f"{self.value:.6g} +- {self.half:.2g} ({self.origin})"


HEIGHTS = Scale(1.0, 0.01, "assumed")
"""Scale of heights of an instrument of which nothing is stated."""

LATERAL = Scale(1.0, 0.001, "assumed")

Stated = str | float | tuple[float, float] | Scale | None
"""A scale as it is stated: "1.0063 +- 1e-4", a number that is exact, or a number and its half width."""

_FORM = re.compile(r"\s*([0-9.eE+-]+?)\s*(?:(?:\+-|\+/-|±)\s*([0-9.eE+-]+)\s*)?")


def scale_of(stated: Stated, assumed: Scale, name: str) -> Scale:
    """Read a stated scale; the assumed one where none is stated. Raises BadRequest."""
    if stated is None:
        return assumed
    if isinstance(stated, Scale):
        return stated
    try:
        if isinstance(stated, str):
            match = _FORM.fullmatch(stated)
            numbers = (float(match[1]), float(match[2] or 0.0)) if match else (0.0, 0.0)
        else:
            numbers = stated if isinstance(stated, tuple) else (float(stated), 0.0)
        value, half = float(numbers[0]), float(numbers[1])
    except (TypeError, ValueError):
        value = half = 0.0
    if not (isfinite(value) and 0.5 <= value <= 2.0 and 0.0 <= half <= 0.2):
        raise BadRequest(
            f"{name} {str(stated)[:40]}: it is a number about 1 and its uncertainty, such as '1.0063 +- 1e-4'"
        )
    return Scale(value, half)


def scale_by_tilt(level: Lenslets, tilted: Lenslets, before: Scale) -> Scale:
    """Scale of heights from two maps of one field.

    level, tilted : Lenslets of both, heights divided by the value of `before`.
    Raises NotMeasurable: The maps are hardly tilted against each other, or hold too few lenslets in common.
    """
    between = np.arccos(np.clip(level.level[2] @ tilted.level[2], -1.0, 1.0))
    if between < LEAST_TILT:
        raise NotMeasurable(
            f"the second map is tilted by {degrees(between):.2g} deg against the first: for the scale of"
            f" heights about 8 deg are needed, {degrees(LEAST_TILT):.2g} deg at least"
        )
    pairs = _common(level, tilted)
    index = level.index[pairs[:, 0]]
    design = np.column_stack([np.ones(len(index)), index])
    if len(index) < 3 or np.linalg.matrix_rank(design) < 3:
        raise NotMeasurable("the second map has too few lenslets in common with the first")
    one, two = (
        np.asarray(np.linalg.lstsq(design, each.apexes[pairs[:, k]], rcond=None)[0][1:])
        for k, each in enumerate((level, tilted))
    )
    wanted, got = _products(one), _products(two)
    heights = got[1] - wanted[1]
    square = float(heights @ (wanted[0] - got[0]) / (heights @ heights))
    error = np.sqrt(np.diag(np.linalg.inv(design.T @ design))[1:].max())
    middles = np.sqrt(2.0 * np.mean(level.u[:, :2] ** 2))
    half = 2.0 * float(error * middles * np.linalg.norm(one[0]) / np.linalg.norm(heights))
    if not square > 0.0:
        raise NotMeasurable("the two maps are not of one field")
    return Scale(before.value / float(np.sqrt(square)), half, "found")


def _products(steps: Floats) -> tuple[Floats, Floats]:
    """Products of the steps (2, 3) with each other: of their parts along x and y, and of their heights."""
    pairs = ((0, 0), (1, 1), (0, 1))
    flat = np.array([steps[i, :2] @ steps[j, :2] for i, j in pairs])
    return flat, np.array([steps[i, 2] * steps[j, 2] for i, j in pairs])


def _common(level: Lenslets, tilted: Lenslets) -> Ints:
    """Rows (k, 2) of the lenslets that both maps hold, recognized by how they differ from their lattices."""
    first = {(int(i), int(j)): k for k, (i, j) in enumerate(level.index)}
    best: tuple[float, list[tuple[int, int]]] = (np.inf, [])
    for di in (0, -1, 1):
        for dj in (0, -1, 1):
            found = [
                (first[key], k)
                for k, (i, j) in enumerate(tilted.index)
                if (key := (int(i) + di, int(j) + dj)) in first
            ]
            if len(found) < 3:
                continue
            rows = np.array(found)
            apart = level.values[rows[:, 0], :2] - tilted.values[rows[:, 1], :2]
            size = float(np.sqrt(np.mean((apart - apart.mean(axis=0)) ** 2)))
            if size < best[0]:
                best = (size, found)
    return np.array(best[1], dtype=np.int64).reshape(-1, 2)
