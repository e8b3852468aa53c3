"""Stacks in closed form: chief rays of a meridian, length, share of light that thin lenses pass.

The chief ray of a cell passes through the middle of its lens 1. As long as cells are small, the chief rays of
many cells represent the light. A sheet maps position and slope (x, t) to (x + s t, (t − δ − κ x)/η) from
array 1 to array 2. The determinant of this map is 1/η; a sheet is no lens, so the determinant need not be 1.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from math import inf

import numpy as np

from clacad.base.types import Floats, Ints, Pair2
from clacad.optics.law.imaging import slope_map
from clacad.sheet.cell_places import CellLaws
from clacad.sheet.stack import BadStack, Stack, StackedSheet, lens_planes
from clacad.sheet.vignetting import partner_share


@dataclass(frozen=True, eq=False)
class ChiefRays:
    """Affine map of position and slope in one meridian: (x, t) ↦ matrix (x, t) + shift.

    matrix : (2, 2). ((A, B), (C, D)): A and D are numbers, B a length, C one over a length.
    shift : (2,). A length and a slope.
    """

    matrix: Floats
    shift: Floats

    def then(self, after: ChiefRays) -> ChiefRays:
        """Return the map of this element followed by `after`."""
        return ChiefRays(after.matrix @ self.matrix, after.matrix @ self.shift + after.shift)

    @property
    def determinant(self) -> float:
        """A D − B C; a product of 1/η."""
        (a, b), (c, d) = self.matrix
        return float(a * d - b * c)

    def image(self, distance: float) -> tuple[float, float, float]:
        """Image of an axial point that lies `distance` before array 1.

        distance : length

        Returns
        -------
        beyond : float, length
            Distance of the image behind the last array, < 0 before it; infinite where light leaves parallel.
        across : float, length
            How far off the axis it lies.
        magnification : float
            Lateral.
        """
        seen = space(distance).then(self)
        (a, b), (c, d) = seen.matrix
        if d == 0.0:
            return inf, inf, inf
        beyond = float(-b / d) + 0.0  # no −0
        return beyond, float(seen.shift[0] + beyond * seen.shift[1]), float(a + beyond * c)


def sheet(eta: float, separation: float, delta: float = 0.0, kappa: float = 0.0) -> ChiefRays:
    """A sheet from array 1 to array 2.

    eta : Not 0. |η| ≤ 1; for |η| > 1 the light is not centred on chief rays: use `of_beams`.
    separation : length
    delta : Offset in the middle of the sheet.
    kappa : float, one over a length. Growth of the offset across the sheet, dδ/dx.
    """
    return ChiefRays(np.array([[1.0, separation], [-kappa / eta, 1.0 / eta]]), np.array([0.0, -delta / eta]))


def with_field_lens(
    eta: float, aside: float, delta: float = 0.0, kappa: float = 0.0, scale: float = 1.0
) -> ChiefRays:
    """A sheet whose field lens images lens 1 onto lens 2: all chief rays leave in the middle of cell 2.

    aside : length. Distance from the middle of cell 1 to that of its partner, in the middle of the sheet.
    scale : g, the pitch of array 2 over that of array 1.
    """
    return ChiefRays(np.array([[scale, 0.0], [-kappa / eta, 1.0 / eta]]), np.array([aside, -delta / eta]))


def of_beams(
    eta: float, separation: float, delta: float = 0.0, kappa: float = 0.0, scale: float = 1.0
) -> ChiefRays:
    """A sheet described by the middle of the transmitted light, which for |η| > 1 is not a chief ray.

    Lens 1 arrives at lens 2 as a copy η times as large, displaced by s t. If the copy is larger than lens 2,
    the transmitted part is centred on lens 2's cell, at g X, with X the middle of lens 1. It entered at (g X
    − X − s t)/η from X, and its slope is (t − δ − κ X)/η.

    scale : g, the pitch of array 2 over that of array 1.
    """
    if abs(eta) <= 1.0:
        return sheet(eta, separation, delta, kappa)
    part = eta / (eta + scale - 1.0)  # X = part (x + s t/η)
    x, t = part, part * separation / eta
    matrix = [[scale * x, scale * t], [-kappa * x / eta, (1.0 - kappa * t) / eta]]
    return ChiefRays(np.array(matrix), np.array([0.0, -delta / eta]))


def space(length: float) -> ChiefRays:
    """Empty space of a length, which may be negative."""
    return ChiefRays(np.array([[1.0, length], [0.0, 1.0]]), np.zeros(2))


def in_a_row(elements: Iterable[ChiefRays]) -> ChiefRays:
    """Elements in the order light passes them, combined into one."""
    whole = space(0.0)
    for element in elements:
        whole = whole.then(element)
    return whole


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
        elements += [made] if ahead is None else [space(ahead), made]
    return in_a_row(elements)


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
    """Growth of a sheet's offset δ over it (2, 2), sheet axes, 1/length; 0 if homogeneous."""
    return np.asarray(one.window.law.rotation[:2, :2] @ _growth_along_lenses(one))


def _growth_along_lenses(one: StackedSheet) -> Floats:
    """Growth of δ (2, 2), rows along the lens axes; 0 where a table gives each cell its own."""
    laws = one.window.cell_laws
    if laws is None or laws.smooth is None:
        return np.zeros((2, 2))
    return np.asarray(laws.gradient) / one.scale


def _of_sheet(one: StackedSheet, axis: int, beams: bool) -> ChiefRays:
    """Chief rays of one sheet along an axis."""
    pair = one.window.thin
    offset, jacobian = slope_map(one.window.law)
    eta, kappa = 1.0 / float(jacobian[axis, axis]), float(_growth(one)[axis, axis])
    delta, scale = -eta * float(offset[axis]), pair.second.scale(one.window.lattice)[axis]
    if pair.field:  # the beam fills lens 2, or is centred on it: both cases are identical
        return with_field_lens(eta, one.scale * pair.shift[axis], delta, kappa, scale)
    s = one.scale * pair.separation
    return of_beams(eta, s, delta, kappa, scale) if beams else sheet(eta, s, delta, kappa)


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


@dataclass(frozen=True, eq=False)
class ChiefRay:
    """The chief ray of a cell through a stack, and the rays next to it: any sheet, tilted or from a table.

    cells : (sheets, 2). Cells it passes.
    place, slope : (2,). On array 2 of the last sheet, where the ray crosses its plane.
    matrix : (4, 4). Their change per change of (x, y, t_x, t_y) on array 1 of the first sheet: of chief rays
        of neighbours under a smooth law, of light that keeps to these cells where a table gives each its own.
    """

    cells: Ints
    place: Floats
    slope: Floats
    matrix: Floats


def about_cell(stack: Stack, cell: tuple[int, int], slope: Pair2 = (0.0, 0.0)) -> ChiefRay:
    """Follow the chief ray of a cell of the first sheet, which has this slope there.

    Raises BadStack: It is no cell, the ray misses a sheet, or its law has no answer there.
    """
    first = stack.sheets[0]
    place = first.scale * first.window.centres(0, np.array(cell))
    way, matrix, cells = np.array(slope), np.eye(4), []
    for number, one in enumerate(stack.sheets):
        if number:
            gap = one.lens_planes[0] - stack.sheets[number - 1].lens_planes[1]
            place, ahead = place + gap * way, np.eye(4)
            ahead[:2, 2:] = gap * np.eye(2)
            matrix = ahead @ matrix
        window = one.window
        index = window.locate(0, *(place[:, None] / one.scale))[0]
        if not window.lattice.contains(index)[0]:
            raise BadStack(
                f"sheet {one.id}: the chief ray of cell {tuple(cell)} misses it, at {place.tolist()}"
            )
        place, way, own = _about(one, index[0], place, way)
        matrix = own @ matrix
        cells.append(index[0])
    return ChiefRay(np.array(cells), place, way, matrix)


def _about(one: StackedSheet, index: Ints, place: Floats, way: Floats) -> tuple[Floats, Floats, Floats]:
    """Place and slope behind a sheet of a chief ray, and their derivative (4, 4)."""
    window, pair = one.window, one.window.thin
    laws = CellLaws(window.law) if window.cell_laws is None else window.cell_laws
    law = laws.law_at(window.lattice, index)
    a, (nx, ny, nz) = law.matrix(), law.rotation[:, 2]
    out = a @ [*way, 1.0]
    if not (out[2] > 0.0 and nx * way[0] + ny * way[1] + nz > 0.0):
        raise BadStack(f"sheet {one.id}: its law has no answer at slope {way.tolist()}")
    after = out[:2] / out[2]
    per_slope = (a[:2, :2] - np.outer(after, a[2, :2])) / out[2]
    moved = (
        a @ law.rotation[:, :2] * (law.rotation[:, 2] @ [*way, 1.0])
    )  # of `out`, per −δ along each lens axis
    per_place = -(moved[:2] - np.outer(after, moved[2])) / out[2] @ _growth_along_lenses(one)
    derivative = np.zeros((4, 4))
    derivative[2:] = np.hstack([per_place, per_slope])
    if pair.field:
        scale = np.eye(2) + pair.second.aside(window.lattice)
        derivative[:2, :2] = scale
        middle = one.scale * window.centres(0, index)
        return place + (scale - np.eye(2)) @ middle + one.scale * np.asarray(pair.shift), after, derivative
    across = np.array([nx, ny])
    cosine = float(across @ way) + nz
    deep, level = one.scale * pair.separation / cosine, one.scale * pair.offset[2]
    changes = -deep * np.outer(way - after, across) / cosine  # the plane of a tilted lens is met elsewhere
    derivative[:2] = np.hstack(
        [np.eye(2) + (level - deep) * per_place, deep * np.eye(2) + changes + (level - deep) * per_slope]
    )
    return place + deep * way + (level - deep) * after, after, derivative


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
