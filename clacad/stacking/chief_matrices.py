"""A stack in closed form: chief rays of a meridian, its length, the share of light that thin lenses would pass."""

from __future__ import annotations

from itertools import pairwise

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
        made = _of_sheet(one, axis, beams, 1.0 / float(jacobian[axis, axis]), float(offset[axis]))
        elements += [made] if ahead is None else [chief_rays.space(ahead), made]
    return chief_rays.in_a_row(elements)


def _of_sheet(one: StackedSheet, axis: int, beams: bool, eta: float, offset: float) -> ChiefRays:
    """Chief rays of one sheet of this η along an axis, which sends light along the normal out with slope `offset`."""
    pair = one.window.thin
    if (
        pair.field
    ):  # the beam fills lens 2, or lens 2's middle is that of what gets through: one is as the other
        return chief_rays.with_field_lens(eta, one.scale * pair.shift[axis], -eta * offset)
    s = one.scale * pair.separation
    return (chief_rays.of_beams if beams else chief_rays.sheet)(eta, s, -eta * offset)


def _spaces(stack: Stack, axis: int) -> list[float]:
    """Air between the lens planes of neighbours in a meridian, lengths."""
    return [_planes(b, axis)[0] - _planes(a, axis)[1] for a, b in pairwise(stack.sheets)]


def _planes(one: StackedSheet, axis: int) -> tuple[float, float]:
    """First and last lens plane of a sheet in a meridian, z in the stack."""
    first, last = lens_planes(one.window)
    return one.z + one.scale * first[axis], one.z + one.scale * last[axis]


def length(stack: Stack, axis: int) -> float:
    """Length of a stack along z from its first lens plane to its last in a meridian."""
    return _planes(stack.sheets[-1], axis)[1] - _planes(stack.sheets[0], axis)[0]


def expected_share(stack: Stack, direction: Floats) -> float:
    """Share of the light in directions (n, 3) that meets the partners in every sheet, cells of neighbours unrelated."""
    passed, way = np.ones(len(direction)), direction
    for one in stack.sheets:
        good = np.isfinite(way).all(axis=1)
        passed[good] *= share(thin_cells(one.window), way[good])
        passed[~good] = 0.0
        way = one.window.law.refract(way)
    return float(passed.mean())
