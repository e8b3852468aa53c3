"""From rays as launched to rays in a cell: the exact plane step, and the step from array to array.

The honeycomb between the arrays: a channel from each cell's border to its partner's. Rung "law" needs
nothing else: the sheet is a plane z = 0 that obeys its law exactly, or in each cell the law of that cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clacad.base.pairs import pair, pair_product, pair_sum, two_product, two_sum
from clacad.base.types import Bools, Floats, Ints, Rows
from clacad.optics.ledger import Ledger, RayColumns
from clacad.optics.rays import Fate
from clacad.optics.sequence import unit_directions
from clacad.sheet.cell_places import centre_pairs
from clacad.sheet.pattern import less_steps, relocate, section
from clacad.tracing.layout import BodyPlan, Layout, sheet_position


class Extent(Protocol):
    """Space that an object occupies: a box from above, and heights `low` … `high` over a level."""

    @property
    def box(self) -> tuple[float, float, float, float]:
        """x_min, x_max, y_min, y_max in the sheet frame."""

    @property
    def level(self) -> float:
        """Sheet-frame z."""

    @property
    def low(self) -> float:
        """Lowest point over `level`."""

    @property
    def high(self) -> float:
        """Highest point over `level`."""


@dataclass(frozen=True, eq=False)
class Beam(RayColumns):
    """m rays on their way, each relative to its present cell.

    rows : (m,) ints. Number of the launched ray of each.
    array : The lens array whose cells `cell` and `local` refer to.
    cell : (m, 2) ints
    local : (m, 2) lengths. x, y from the centre of the cell.
    z : (m,) lengths. Height over the current body's level.
    direction : (m, 3) unit, sheet axes
    """

    rows: NDArray[np.intp]
    array: int
    cell: Ints
    local: Floats
    z: Floats
    direction: Floats

    def __len__(self) -> int:
        return len(self.rows)


def launch(
    layout: Layout, room: Extent, position: Floats, direction: Floats, rows: NDArray[np.intp]
) -> tuple[Beam, Floats]:
    """Carry rays to the reference plane of the first body, without rounding, and find their cells.

    room : Of the first body.
    position, direction : (n, 3) arrays, sheet frame
        As launched; finite, of any length. Rows with d_z ≤ 0 must not be among `rows`.
    rows : (m,) ints. The rays to launch.

    Returns
    -------
    beam : Beam
        In the cells of array 0, on the plane just below the body, or where the ray comes alongside the sheet
        above that plane. Rays that pass outside the sheet are left out: they are MISSED.
    carried : (len(beam),) lengths
        From the start to there; negative when the start lies above the plane.
    """
    start = position[rows]
    ray, scaled = unit_directions(direction[rows])
    plane = np.full(len(rows), room.level + room.low)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        plane, beside = _alongside(layout, room, start, ray, plane)
        kept = ~beside
        rows, start, ray, scaled, plane = rows[kept], start[kept], ray[kept], scaled[kept], plane[kept]
        step_high, step_low = _plane_step(start, scaled, plane)
        x, x_low = _stepped(start[:, 0], scaled[:, 0], step_high, step_low)
        y, y_low = _stepped(start[:, 1], scaled[:, 1], step_high, step_low)
        carried = step_high * _length_ratio(scaled, ray)
    cell, local_x, local_y = layout.lattices[0].locate(x, y, x_low, y_low)
    local = np.stack([local_x, local_y], axis=-1)
    return Beam(rows, 0, cell, local, plane - room.level, ray), carried


def _plane_step(start: Floats, scaled: Floats, plane: Floats) -> tuple[Floats, Floats]:
    """(plane − z)/N in double-double."""
    rise = two_sum(plane, -start[:, 2])
    quotient = rise[0] / scaled[:, 2]
    # remainder of the rounded quotient, divided once more
    high, low = two_product(quotient, scaled[:, 2])
    rest = pair_sum(rise, (-high, -low))
    return quotient, rest[0] / scaled[:, 2]


def _stepped(x: Floats, along: Floats, high: Floats, low: Floats) -> tuple[Floats, Floats]:
    return pair_sum(pair_product((high, low), pair(along)), pair(x))


def _length_ratio(scaled: Floats, ray: Floats) -> Floats:
    """Length of the scaled directions, the unit of steps."""
    largest = np.abs(scaled).argmax(axis=1)
    rows = np.arange(len(scaled))
    return np.asarray(scaled[rows, largest] / ray[rows, largest])


def _alongside(
    layout: Layout, body: Extent, start: Floats, ray: Floats, plane: Floats
) -> tuple[Floats, Bools]:
    """Raise the reference plane of rays that cross it outside the sheet to where they come alongside.

    Returns the plane of each ray and a mask of those that miss the sheet altogether.
    """
    run = (plane - start[:, 2]) / ray[:, 2]
    span = (body.high - body.low) / ray[:, 2]
    enter, leave = box_span(layout, body, start[:, :2] + run[:, None] * ray[:, :2], ray)
    beside = ~((enter <= leave) & (leave >= 0.0) & (enter <= span))
    late = enter > 0.0
    plane = np.where(late, plane + enter * ray[:, 2], plane)
    return plane, beside | ~np.isfinite(plane)


def box_span(layout: Layout, body: Extent, point: Floats, ray: Floats) -> tuple[Floats, Floats]:
    """Distances at which rays enter and leave the box round the footprint, a cell wider on every side.

    point : (m, 2) lengths, sheet frame
    """
    pad = 2.0 * layout.lattice.circumradius
    low = np.array([body.box[0] - pad, body.box[2] - pad])
    high = np.array([body.box[1] + pad, body.box[3] + pad])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        to_low, to_high = (low - point) / ray[:, :2], (high - point) / ray[:, :2]
        still = ray[:, :2] == 0.0
        inside = (point >= low) & (point <= high)
        to_low = np.where(still, np.where(inside, -np.inf, np.inf), to_low)
        to_high = np.where(still, np.where(inside, np.inf, -np.inf), to_high)
        near, far = np.minimum(to_low, to_high), np.maximum(to_low, to_high)
        near = np.where(still, to_low, near)
        far = np.where(still, to_high, far)
        # a ray whose plane crossing is not even finite misses the sheet
        enter = np.nan_to_num(near.max(axis=1), nan=np.inf, posinf=np.inf, neginf=-np.inf)
        leave = np.nan_to_num(far.min(axis=1), nan=-np.inf, posinf=np.inf, neginf=-np.inf)
    return enter, leave


def sheet_xy(layout: Layout, beam: Beam) -> Floats:
    """Sheet-frame x, y (m, 2) of the rays: accurate enough for footprints and output."""
    return sheet_position(layout, beam.array, beam.cell, beam.local, beam.z)[:, :2]


def to_array(layout: Layout, beam: Beam, array: int) -> Beam:
    """Express the same points in the cells of another array and give each ray the cell it is over."""
    steps, local, cell = cell_in(layout, beam.array, array, beam.cell, beam.local)
    return replace(beam, array=array, cell=cell, local=local)


def cell_in(layout: Layout, of: int, array: int, cell: Ints, local: Floats) -> tuple[Ints, Floats, Ints]:
    """Steps, local coordinates and cell, (m, 2), in `array` of points relative to cells of array `of`."""
    if layout.lattices[of] != layout.lattices[array]:
        return _in_other_pitch(layout, of, array, cell, local)
    away = np.zeros(2, dtype=np.int64)
    if array != of:
        local = local - layout.residual[of, array]
        away = layout.whole_steps[of, array]
    steps, local = relocate(layout.lattices[array], local)
    return steps, local, cell - away + steps


def _in_other_pitch(
    layout: Layout, of: int, array: int, cell: Ints, local: Floats
) -> tuple[Ints, Floats, Ints]:
    """`cell_in` between arrays of different pitch: the point about the sheet's middle is kept in pairs."""
    here, there = (layout.window.placements[one].shift for one in (of, array))
    along = [
        pair_sum(centre, pair(local[:, k]), two_sum(here[k], -there[k]))
        for k, centre in enumerate(centre_pairs(layout.lattices[of], cell))
    ]
    (x, x_low), (y, y_low) = along
    found, local_x, local_y = layout.lattices[array].locate(x, y, x_low, y_low)
    return found - cell, np.stack([local_x, local_y], axis=-1), found


def on_to(layout: Layout, beam: Beam, left: BodyPlan, entered: BodyPlan) -> tuple[Beam, Floats]:
    """Carry m rays from one body to the reference plane of the next; return also the distance (m,)."""
    z = beam.z - (entered.level - left.level)
    distance = (entered.low - z) / beam.direction[:, 2]
    local = beam.local + distance[:, None] * beam.direction[:, :2]
    moved = replace(beam, local=local, z=np.full(len(beam), entered.low))
    return to_array(layout, moved, entered.arrays[0] if entered.arrays else beam.array), distance


def reach(layout: Layout, arrays: tuple[int, int], left: Floats, met: Floats, order: Ints) -> Floats:
    """Fraction of the gap that rays cross before they meet the honeycomb.

    arrays : (of, to). Arrays before and behind the gap.
    left, met : (m, 2) lengths
        Where they leave the first array and meet the second, each relative to its cell.
    order : (m, 2) ints. Cell met minus cell left; (0, 0) is the partner.
    Returns (m,) array: 0 … 1 of the way to the second array where the wall is met; inf for rays that pass.

    Notes
    -----
    In the frame that is sheared with the channels a ray is a straight line from `left` to `met` plus the
    order's displacement. At both ends a channel is the cell less half a wall on every border; its sides grow
    evenly from one end to the other.
    """
    assert layout.window.baffle is not None
    wall = layout.window.baffle.wall
    before, behind = (layout.lattices[array] for array in arrays)
    target = less_steps(behind, met, -order)
    if before.turn or behind.turn:
        ends = [section(layout.lattice, one, wall) for one in (before, behind)]
        first = _through_twisted(layout, ends, left, target)
    else:
        first = np.full(len(left), np.inf)
        halves = layout.widths[list(arrays)] - 0.5 * wall
        for (ux, uy), free, last in zip(layout.normals[0], *halves, strict=True):
            here = ux * left[:, 0] + uy * left[:, 1]
            there = ux * target[:, 0] + uy * target[:, 1]
            grows = (last - free) * np.copysign(1.0, there)
            with np.errstate(divide="ignore", invalid="ignore"):
                exits = (np.copysign(free, there) - here) / (there - here - grows)
            hit = np.where(np.abs(here) > free, 0.0, np.where(np.abs(there) > last, exits, np.inf))
            first = np.minimum(first, hit)
    stray = (order != 0).any(axis=1) & ~np.isfinite(first)
    return np.where(stray, 1.0, first)


def _through_twisted(layout: Layout, ends: Sequence[Floats], left: Floats, target: Floats) -> Floats:
    """Fraction of the gap after which rays leave channels with sections `ends` (2, 2); inf if they do not.

    A point p is inside the section A where |n · adj(A) p| ≤ h det A for every border of a cell, a quadratic
    in the fraction of the gap.
    """
    room = []  # at the beginning, in the middle and at the end of the gap
    for share in (0.0, 0.5, 1.0):
        (a, b), (c, d) = ends[0] + share * (ends[1] - ends[0])
        x, y = (left + share * (target - left)).T
        across = layout.normals[0] @ np.stack([d * x - b * y, a * y - c * x])
        free = layout.halves[:, None] * (a * d - b * c)
        room.append(np.concatenate([free - across, free + across]))
    start, middle, end = room
    square = 2.0 * (start - 2.0 * middle + end)
    slope = end - start - square
    with np.errstate(divide="ignore", invalid="ignore"):
        root = -0.5 * (slope + np.copysign(np.sqrt(slope * slope - 4.0 * square * start), slope))
        exits = np.stack([root / square, start / root])
    exits = np.where((exits > 0.0) & (exits <= 1.0), exits, np.inf)
    return np.asarray(np.where(start < 0.0, 0.0, exits.min(axis=0)).min(axis=0))


@dataclass(frozen=True)
class SheetPlane:
    """The sheet plane as the space that the sheet occupies."""

    box: tuple[float, float, float, float]
    level: float = 0.0
    low: float = 0.0
    high: float = 0.0


def trace_law(layout: Layout, ledger: Ledger, rows: Rows, continuous: bool = False) -> None:
    """Write the rows (k,) of rays that cross a kept cell's footprint in z = 0.

    Rays are ALIVE where the law has an answer, BACKWARD where it has none; the rest stay MISSED.
    `continuous`: use the law at the very point met instead of the law at the centre of the cell hit.
    """
    window = layout.window
    plane = SheetPlane(window.lattice.extent())
    beam, carried = launch(layout, plane, ledger.position, ledger.direction, rows)
    met = layout.lattice.contains(beam.cell) & (carried >= 0.0)
    beam, carried = beam.take(met), carried[met]
    position = sheet_position(layout, 0, beam.cell, beam.local, np.zeros(len(beam)))
    smooth = None if window.cell_laws is None else window.cell_laws.smooth
    if window.cell_laws is None:
        out = window.law.refract(ledger.direction[beam.rows])
    elif continuous and smooth is not None:
        out = smooth.refract(ledger.direction[beam.rows], position[:, :2])
    else:
        out = window.cell_laws.refract(layout.lattice, beam.cell, ledger.direction[beam.rows])
    refused = np.isnan(out[:, 0])
    fate = np.where(refused, Fate.BACKWARD, Fate.ALIVE).astype(np.uint8)
    direction = np.where(refused[:, None], beam.direction, out)
    ledger.record(0, beam.rows, position, direction)
    ledger.end(beam.rows, fate, position, direction, carried, 0)
    ledger.cell[beam.rows] = beam.cell
    ledger.order[beam.rows[~refused]] = 0
