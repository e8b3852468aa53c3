"""A stack in closed form: chief rays of a meridian, its length, the share of light that thin lenses would pass."""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats
from clacad.optics import chief_rays
from clacad.optics.chief_rays import ChiefRays
from clacad.optics.law.imaging import slope_map
from clacad.sheet.stack import Stack, StackedSheet, lens_planes
from clacad.sheet.vignetting import share, thin_cells

COUPLED = 1e-12
"""Slope in y by slope in x from which on the meridians of a sheet are not taken apart."""


def meridian(stack: Stack, axis: int, beams: bool = False) -> ChiefRays | None:
    """Chief rays of a stack along x (0) or y (1), from array 1 of the first sheet to array 2 of the last.

    None where a sheet mixes x and y, or is tilted: it has no such meridian. beams : the middle of the light instead
    """
    elements = []
    for one, ahead in zip(stack.sheets, (None, *_spaces(stack, axis))):
        offset, jacobian = slope_map(one.window.law)
        if one.window.law.theta != 0.0 or np.abs(jacobian[[0, 1], [1, 0]]).max() > COUPLED:
            return None
        eta = 1.0 / float(jacobian[axis, axis])
        s = one.scale * one.window.thin.separation
        made = (chief_rays.of_beams if beams else chief_rays.sheet)(eta, s, -eta * float(offset[axis]))
        elements += [made] if ahead is None else [chief_rays.space(ahead), made]
    return chief_rays.in_a_row(elements)


def _spaces(stack: Stack, axis: int) -> list[float]:
    """Air between the lens planes of neighbours in a meridian, lengths."""

    def planes(one: StackedSheet) -> tuple[float, float]:
        first, last = lens_planes(one.window)
        return one.z + one.scale * first[axis], one.z + one.scale * last[axis]

    return [planes(b)[0] - planes(a)[1] for a, b in zip(stack.sheets, stack.sheets[1:])]


def length(stack: Stack, axis: int) -> float:
    """Length of a stack from its first lens plane to its last in a meridian, what is solid reduced to air."""
    return sum(one.scale * one.window.thin.separation for one in stack.sheets) + sum(_spaces(stack, axis))


def expected_share(stack: Stack, direction: Floats) -> float:
    """Share of the light in directions (n, 3) that meets the partners in every sheet, cells of neighbours unrelated."""
    passed, way = np.ones(len(direction)), direction
    for one in stack.sheets:
        good = np.isfinite(way).all(axis=1)
        passed[good] *= share(thin_cells(one.window), way[good])
        passed[~good] = 0.0
        way = one.window.law.refract(way)
    return float(passed.mean())
