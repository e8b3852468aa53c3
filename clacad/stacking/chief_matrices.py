"""Stacks in closed form: chief rays of a meridian, length, share of light that thin lenses pass."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from clacad.base.types import Floats
from clacad.optics import chief_rays
from clacad.optics.chief_rays import ChiefRays
from clacad.optics.law.imaging import slope_map
from clacad.sheet.cell_places import CellLaws
from clacad.sheet.stack import Stack, StackedSheet, lens_planes
from clacad.sheet.vignetting import partner_share

COUPLED = 1e-12
"""Slope in y per slope in x above which the meridians of a sheet are not separated."""


def meridian(stack: Stack, axis: int, beams: bool = False) -> ChiefRays | None:
    """Chief rays of a stack along x (0) or y (1), from array 1 of the first sheet to array 2 of the last.

    None where `no_meridian` gives a reason. beams : centre of the transmitted light instead of chief rays
    """
    if no_meridian(stack) is not None:
        return None
    elements = []
    for one, ahead in zip(stack.sheets, (None, *_spaces(stack, axis))):
        made = _of_sheet(one, axis, beams)
        elements += [made] if ahead is None else [chief_rays.space(ahead), made]
    return chief_rays.in_a_row(elements)


def no_meridian(stack: Stack) -> str | None:
    """Reason why a stack has no chief-ray matrix along x and y; None where it has one."""
    for one in stack.sheets:
        reason = _no_meridian(one)
        if reason is not None:
            return f"sheet {one.id}: {reason}"
    return None


def _no_meridian(one: StackedSheet) -> str | None:
    law, laws = one.window.law, one.window.cell_laws
    if laws is not None and laws.smooth is None:
        return (
            "a table gives each cell its own law, so no one number gives how its offset grows over the sheet"
        )
    if law.theta != 0.0 or _couples(slope_map(law)[1]):
        return "tilted or turned lenses mix x and y"
    if _couples(_growth(one)):
        return "the offset along x grows along y, or the other way about"
    return None


def _couples(matrix: Floats) -> bool:
    """Whether a (2, 2) matrix mixes x and y."""
    return bool(np.abs(matrix[[0, 1], [1, 0]]).max() > COUPLED * max(1.0, np.abs(matrix).max()))


def _growth(one: StackedSheet) -> Floats:
    """Growth of a sheet's offset δ over it (2, 2), sheet axes, one over a length of the stack; 0 of a
    homogeneous law.
    """
    laws = one.window.cell_laws
    if laws is None:
        return np.zeros((2, 2))
    along_sheet = one.window.law.rotation[:2, :2] @ np.asarray(laws.gradient)
    return np.asarray(along_sheet / one.scale)


def _of_sheet(one: StackedSheet, axis: int, beams: bool) -> ChiefRays:
    """Chief rays of one sheet along an axis."""
    pair = one.window.thin
    offset, jacobian = slope_map(one.window.law)
    eta, kappa = 1.0 / float(jacobian[axis, axis]), float(_growth(one)[axis, axis])
    delta = -eta * float(offset[axis])
    if pair.field:  # the beam fills lens 2, or is centred on it: both cases are identical
        return chief_rays.with_field_lens(eta, one.scale * pair.shift[axis], delta)
    s = one.scale * pair.separation
    if not beams:
        return chief_rays.sheet(eta, s, delta, kappa)
    return chief_rays.of_beams(eta, s, delta, kappa, pair.second.scale(one.window.lattice)[axis])


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


def expected_share(stack: Stack, place: Floats, direction: Floats) -> float:
    """Share of the light that passes the partner lenses of every sheet, for thin lenses.

    Positions in one sheet are assumed independent of those in the sheets before.

    Light enters at places (n, 2) of the first lens plane in directions (n, 3); light that misses a sheet is
    lost.
    """
    passed, way, at = np.ones(len(direction)), direction, place
    for one, after in zip(stack.sheets, (*stack.sheets[1:], None)):
        window = one.window
        on = np.flatnonzero(np.isfinite(at).all(axis=1) & np.isfinite(way).all(axis=1))
        index, _, _ = window.locate(0, *(at[on] / one.scale).T)
        kept = window.lattice.contains(index)
        on, index = on[kept], index[kept]
        share, way_out = np.zeros(len(way)), np.full(way.shape, np.nan)
        share[on] = partner_share(window, index, way[on])
        passed *= share
        laws = CellLaws(window.law) if window.cell_laws is None else window.cell_laws
        way_out[on] = laws.refract(window.lattice, index, way[on])
        if after is not None:
            at = _arrivals(one, after, at, way, way_out)
        way = way_out
    return float(passed.mean())


def _arrivals(one: StackedSheet, after: StackedSheet, place: Floats, way: Floats, way_out: Floats) -> Floats:
    """Positions (n, 2) at which chief rays from a sheet's first lens plane cross that of the next sheet."""
    pair = one.window.thin
    across = (
        np.asarray(pair.shift) if pair.field else pair.separation * way[:, :2] / way[:, 2:]
    )  # a field lens images the centre of lens 1 on that of lens 2
    gap = after.lens_planes[0] - one.lens_planes[1]
    return np.asarray(place + one.scale * across + gap * way_out[:, :2] / way_out[:, 2:])
