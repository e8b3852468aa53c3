"""What light does in a stack: the share that obeys every law, how space behaves, where a point is imaged.

Rays fill one cell of the first sheet and a square of slopes. They are counted per meridian, too: where the cells are
rectangles along the sheet, a ray keeps to its telescopelets in x whatever it does in y.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import inf, isfinite, tan
from typing import Any

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Bools, Floats, Rung
from clacad.optics import chief_rays
from clacad.optics.chief_rays import ChiefRays
from clacad.optics.law import angle_between
from clacad.optics.law.imaging import slope_map
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.bundle import central_cell, middle_direction
from clacad.sheet.stack import Stack, StackedSheet, lens_planes
from clacad.sheet.vignetting import share, thin_cells
from clacad.tracing.through_stack import StackTrace, StackTracer

FEWEST = 64
"""Rays below which a number is not given."""

COUPLED = 1e-12
"""Slope in y by slope in x from which on the meridians of a sheet are not taken apart."""

SHARE_RAYS = 1024
"""Directions over which shares in closed form are averaged."""


@dataclass(frozen=True, eq=False)
class Meridian:
    """What a stack does in one meridian.

    Attributes
    ----------
    matrix : ((A, B), (C, D))
        Of chief rays, from array 1 of the first sheet to array 2 of the last; lengths of the stack.
    determinant : float
    length : float, length
        From the first of these arrays to the last, what is solid reduced to air.
    acts_as_space : float or None, length
        Where slopes leave as they came: the length of empty space the stack stands for, B.
    moves_image : float or None, length
        By how much it then brings the world nearer: length − B.
    beams : float, length
        B for the middle of the light that gets through, which for |η| > 1 is no chief ray.
    share : float or None
        Light that keeps to its telescopelets in this meridian, in every sheet, of what does in the other; None where cells or
        lenses do not lie along x and y.
    measured_space : float or None, length
        B fitted to rays that keep to their telescopelets in this meridian.
    measured_slope : float or None
        D fitted to these rays.
    scatter : float or None
        Rms distance of these rays from the fit, over the pitch of the first sheet.
    """

    matrix: tuple[tuple[float, float], tuple[float, float]] | None
    determinant: float | None
    length: float
    acts_as_space: float | None
    moves_image: float | None
    beams: float | None
    share: float | None
    measured_space: float | None
    measured_slope: float | None
    scatter: float | None


@dataclass(frozen=True, eq=False)
class StackLight:
    """Light through a stack.

    Attributes
    ----------
    rung : "law", "thin", "surfaces" or "mesh"
    rays : int
    field : float, radians
        Slopes up to its tangent, either way in x and in y, about the middle of the first sheet's field.
    share : float
        Rays that leave through corresponding lenslets of every sheet: ALIVE in all.
    expected_share : float
        The same in closed form for thin lenses, the cells of neighbours taken for unrelated.
    fates : mapping
        Number of rays of each fate.
    sheets : tuple of float
        Share that each sheet passes ALIVE of the light that came to it so.
    meridians : (x, y)
    """

    rung: Rung
    rays: int
    field: float
    share: float
    expected_share: float
    fates: dict[str, int]
    sheets: tuple[float, ...]
    meridians: tuple[Meridian, Meridian]

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class StackImage:
    """The image of a point before a stack.

    Attributes
    ----------
    object_distance : float, length
        Before array 1 of the first sheet, on the axis through the middle of the lit cell.
    predicted : (x, y)
        Distance of the image behind array 2 of the last sheet, < 0 before it; infinite where light leaves parallel; None
        where the meridians do not part.
    magnification : (x, y)
    by_rays : (x, y)
        The same distance for which the rays of a meridian come nearest to one another.
    point : (3,) or None
        The point nearest to all rays, least squares, from the middle of array 2 of the last sheet.
    spread : float, length
        Rms distance of the rays from it.
    rays : int
        ALIVE rays that tell it.
    """

    object_distance: float
    predicted: tuple[float | None, float | None]
    magnification: tuple[float | None, float | None]
    by_rays: tuple[float | None, float | None]
    point: tuple[float, float, float] | None
    spread: float
    rays: int

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


# -- in closed form ------------------------------------------------------------------------------


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


# -- by rays -------------------------------------------------------------------------------------


def measure_light(tracer: StackTracer, rays: int, field: float) -> StackLight:
    """Send rays over one cell of the first sheet and a square of slopes, and tell what they do.

    Parameters
    ----------
    tracer : StackTracer
    rays : int
    field : float, radians
        Slopes reach to its tangent.
    """
    stack = tracer.stack
    points = sobol(rays, 4)
    place, slope = _launch(stack, points, field)
    found = tracer(_started(stack, place, slope))
    direction = np.column_stack([slope, np.ones(rays)])
    alive = found.fate == Fate.ALIVE
    strayed = _strayed(stack, found)
    exit_place = _at_last_plane(stack, found)
    meridians = tuple(
        _meridian(stack, axis, (place[:, axis], slope[:, axis]), exit_place[:, axis], found, strayed)
        for axis in (0, 1)
    )
    return StackLight(
        tracer.rung, rays, field, float(alive.mean()), expected_share(stack, direction[:SHARE_RAYS]), found.counts(),
        tuple(_passed_on(found)), (meridians[0], meridians[1]),
    )  # fmt: skip


def _launch(stack: Stack, points: Floats, field: float) -> tuple[Floats, Floats]:
    """Places (n, 2) on the first lens plane and slopes (n, 2), from points (n, 4) of the unit cube; lengths of the stack."""
    first = stack.sheets[0]
    window = first.window
    centre = window.lattice.centres(np.array([central_cell(window)]))[0] + np.asarray(window.shifts[0])
    middle = middle_direction(window)
    slope = middle[:2] / middle[2] + (2.0 * points[:, 2:] - 1.0) * tan(field)
    return first.scale * (window.lattice.over_cell(points[:, :2]) + centre), slope


def launched(stack: Stack, rays: int, field: float) -> Rays:
    """Rays over one cell of the first sheet and a square of slopes, begun before it; lengths of the stack."""
    return _started(stack, *_launch(stack, sobol(rays, 4), field))


def _started(stack: Stack, place: Floats, slope: Floats) -> Rays:
    """Rays that cross the first lens plane at places (n, 2) with slopes (n, 2), begun before the material."""
    first = stack.sheets[0]
    level = first.lens_planes[0]
    back = level - first.span[0] + first.scale * max(first.window.lattice.pitch)
    start = np.column_stack([place - back * slope, np.full(len(place), level - back)])
    return Rays(start, np.column_stack([slope, np.ones(len(place))]))


def _at_last_plane(stack: Stack, found: StackTrace) -> Floats:
    """Where rays (n, 3) cross the last lens plane, carried straight on or back."""
    level = stack.sheets[-1].lens_planes[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = found.direction[:, :2] / found.direction[:, 2:]
    return np.asarray(found.position[:, :2] + slope * (level - found.position[:, 2:]))


def _strayed(stack: Stack, found: StackTrace) -> Bools | None:
    """Which rays are known to have left their telescopelet in some sheet, in x and in y (n, 2); None where x and y mix."""
    if not all(_parted(one) for one in stack.sheets):
        return None
    strayed = np.zeros((len(found), 2), dtype=bool)
    for rows, result in found.passed:
        strayed[rows] |= _orders(result)
    return strayed


def _orders(result: TraceResult) -> Bools:
    """Which rays (k,) a sheet sent through another column of cells, and another row (k, 2)."""
    return np.asarray((result.fate == Fate.GHOST)[:, None] & (result.order != 0))


def _shares(found: StackTrace) -> tuple[float, float]:
    """Light that keeps to its telescopelets in x, of what does in y, and the other way about.

    Sheet by sheet, of what came to it ALIVE: where light goes that strayed before says nothing of either meridian.
    """
    so_far, shares = np.ones(len(found), dtype=bool), np.ones(2)
    for rows, result in found.passed:
        here, lost = so_far[rows], _orders(result)
        alive = here & (result.fate == Fate.ALIVE)
        for axis in (0, 1):
            shares[axis] *= alive.sum() / max(1, int((here & ~lost[:, 1 - axis]).sum()))
        so_far[:] = False
        so_far[rows[alive]] = True
    return float(shares[0]), float(shares[1])


def _parted(one: StackedSheet) -> bool:
    """Whether cells and lenses lie along x and y, so that each meridian is a sheet of its own."""
    turn = one.window.thin.rotation
    along = np.abs(turn[:2, :2]).max(axis=1).min() > 1.0 - COUPLED
    return bool(along) and not one.window.lattice.hexagonal


def _passed_on(found: StackTrace) -> list[float]:
    """Share that each sheet passes ALIVE of the rays that came to it so."""
    so_far, shares = np.ones(len(found), dtype=bool), []
    for rows, result in found.passed:
        before = int(so_far.sum())
        here = np.zeros(len(found), dtype=bool)
        here[rows] = result.fate == Fate.ALIVE
        so_far &= here
        shares.append(float(so_far.sum() / before) if before else 0.0)
    return shares


def _meridian(
    stack: Stack, axis: int, entered: tuple[Floats, Floats], left: Floats, found: StackTrace, strayed: Bools | None
) -> Meridian:
    """One meridian: in closed form, and fitted to the rays that kept to it; ghosts that strayed across it alone are among them.

    entered : place and slope (n,) on the first lens plane; left : place (n,) on the last
    """
    chief, middle = meridian(stack, axis), meridian(stack, axis, beams=True)
    long = length(stack, axis)
    straight = chief is not None and abs(chief.matrix[1, 1] - 1.0) < 1e-9 and abs(chief.matrix[1, 0]) < 1e-12
    acts = float(chief.matrix[0, 1]) if chief is not None and straight else None
    space = slope = scatter = share = None
    kept = found.fate == Fate.ALIVE
    if strayed is not None:
        share = _shares(found)[axis]
        kept = np.isin(found.fate, (Fate.ALIVE, Fate.GHOST)) & ~strayed[:, axis]
    if kept.sum() >= FEWEST:
        place, way = (one[kept] for one in entered)
        out = found.direction[kept, axis] / found.direction[kept, 2]
        (space, slope), rest = _fitted(way, np.column_stack([left[kept] - place, out]))
        scatter = rest / stack.sheets[0].window.lattice.pitch[axis]
    return Meridian(
        None if chief is None else _pairs(chief.matrix), None if chief is None else chief.determinant, long, acts,
        None if acts is None else long - acts, None if middle is None else float(middle.matrix[0, 1]),
        share, space, slope, scatter,
    )  # fmt: skip


def _pairs(matrix: Floats) -> tuple[tuple[float, float], tuple[float, float]]:
    (a, b), (c, d) = matrix.tolist()
    return (a, b), (c, d)


def _fitted(slope: Floats, values: Floats) -> tuple[tuple[float, float], float]:
    """Slopes of straight lines through two columns of values (n, 2) over slopes (n,), and rms rest of the first."""
    away = slope - slope.mean()
    about = values - values.mean(axis=0)
    first, second = (away @ about) / (away @ away)
    return (float(first), float(second)), float(np.sqrt(np.mean((about[:, 0] - first * away) ** 2)))


def measure_image(tracer: StackTracer, rays: int, field: float, distance: float) -> StackImage:
    """Send light of a point through the stack and look where it comes together.

    Parameters
    ----------
    tracer : StackTracer
    rays : int
    field : float, radians
        Light within slopes of its tangent, as far as the first sheet reaches.
    distance : float, length
        Of the point before array 1 of the first sheet.
    """
    stack = tracer.stack
    first, last = stack.sheets[0], stack.sheets[-1]
    place, slope = _cone(stack, sobol(rays, 2), field, distance)
    found = tracer(_started(stack, place, slope))
    alive = found.fate == Fate.ALIVE
    where = _launch(stack, np.full((1, 4), 0.5), 0.0)[0][0]
    predicted = [meridian(stack, axis) for axis in (0, 1)]
    images = [(None, None) if one is None else one.image(distance)[::2] for one in predicted]
    shown = tuple(_finite(image[0]) for image in images)
    sized = tuple(_finite(image[1]) for image in images)
    point, spread, lines = None, inf, (None, None)
    if alive.sum() >= FEWEST:
        at = found.position[alive] - [*where, last.lens_planes[1]]
        way = found.direction[alive] / np.linalg.norm(found.direction[alive], axis=1)[:, None]
        point, spread = nearest_point(at, way)
        lines = (_waist(at, way, 0), _waist(at, way, 1))
    assert first.scale == 1.0  # the stack's unit is the first sheet's
    return StackImage(
        distance, (shown[0], shown[1]), (sized[0], sized[1]), lines, point, spread, int(alive.sum())
    )


def _finite(value: float | None) -> float | None:
    return value if value is not None and isfinite(value) else None


def _cone(stack: Stack, points: Floats, field: float, distance: float) -> tuple[Floats, Floats]:
    """Places and slopes (n, 2) on the first lens plane of light from a point over its middle, within field and lattice."""
    window = stack.sheets[0].window
    where = _launch(stack, np.full((1, 4), 0.5), 0.0)[0][0]
    x0, x1, y0, y1 = window.lattice.extent()
    room = np.array([min(x1 - where[0], where[0] - x0), min(y1 - where[1], where[1] - y0)])
    reach = np.minimum(distance * tan(field), np.maximum(room, 0.0))
    place = (2.0 * points - 1.0) * reach
    return place + where, place / distance


def nearest_point(position: Floats, direction: Floats) -> tuple[tuple[float, float, float] | None, float]:
    """The point nearest to straight lines, by one linear system of three equations, and its rms distance from them.

    Parameters
    ----------
    position, direction : (n, 3)
        Unit directions.

    Returns
    -------
    point : (3,) or None
        None where the lines are parallel as far as rounding tells.
    spread : float, length
    """
    middle = position.mean(axis=0)
    across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    whole = across.sum(axis=0)
    if np.linalg.cond(whole) > 1e12:
        return None, inf
    point = np.linalg.solve(whole, np.einsum("nij,nj->i", across, position - middle))
    away = np.einsum("nij,nj->ni", across, position - middle - point)
    x, y, z = (point + middle).tolist()
    return (x, y, z), float(np.sqrt((away**2).sum(axis=1).mean()))


def _waist(position: Floats, direction: Floats, axis: int) -> float | None:
    """Height z at which lines (n, 3) are nearest to one another in a meridian; None where they are parallel."""
    slope = direction[:, axis] / direction[:, 2]
    place = position[:, axis] - slope * position[:, 2]
    away = slope - slope.mean()
    square = float(away @ away)
    if square <= 1e-24 * len(slope):
        return None
    return float(-(away @ (place - place.mean())) / square)


def ladder(
    tracers: Sequence[StackTracer], rays: int, field: float
) -> tuple[tuple[str, float, float, float], ...]:
    """The same rays up several rungs, the last of `tracers` taken for the truth.

    Returns
    -------
    tuple of (rung, share ALIVE, rms angle to the truth in radians, share that ends in another fate)
    """
    stack = tracers[-1].stack
    sent = _started(stack, *_launch(stack, sobol(rays, 4), field))
    truth = tracers[-1](sent)
    rows = []
    for tracer in tracers:
        found = truth if tracer is tracers[-1] else tracer(sent)
        both = (found.fate == Fate.ALIVE) & (truth.fate == Fate.ALIVE)
        apart = angle_between(found.direction[both], truth.direction[both])
        error = float(np.sqrt(np.mean(apart**2))) if both.any() else np.nan
        rows.append(
            (tracer.rung, float((found.fate == Fate.ALIVE).mean()), error, float((found.fate != truth.fate).mean()))
        )
    return tuple(rows)
