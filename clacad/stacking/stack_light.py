"""Light through a stack: the share that obeys every law, and the equivalent empty space.

Rays fill the first sheet or a zone of it, and a square of slopes; one cell where all cells of all sheets act
alike. They are also counted per meridian: where the cells are rectangles along x and y, a ray stays in its
telescopelets in x independently of y.

The image of a point through a stack: by chief rays, and by the point nearest to all rays.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import inf, isfinite
from typing import Any

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Bools, Floats, Pair2, Progress, Rung
from clacad.light.compare import rms_between
from clacad.optics.rays import Fate, TraceResult
from clacad.sheet.stack import Stack, StackedSheet
from clacad.stacking.chief_matrices import COUPLED, expected_share, length, meridian, no_meridian
from clacad.tracing.through_stack import (
    StackTrace,
    StackTracer,
    cells_of,
    cone,
    launch,
    lit_cells,
    middle_of_light,
    started,
)

FEWEST = 64
"""Number of rays below which a result is not given."""

SHARE_RAYS = 1 << 14
"""Number of directions over which closed-form shares are averaged; three digits are reliable."""


@dataclass(frozen=True, eq=False)
class StackMeridian:
    """Optical properties of a stack in one meridian.

    Attributes
    ----------
    matrix : ((A, B), (C, D))
        Of chief rays, from array 1 of the first sheet to array 2 of the last; lengths of the stack. None:
        see `no_matrix`.
    no_matrix : str or None
        Reason why there is no matrix in closed form.
    determinant : float
    length : float, length
        Distance from the first of these arrays to the last, along z.
    acts_as_space : float or None, length
        Length of the equivalent empty space, B, where slopes are unchanged.
    moves_image : float or None, length
        Distance by which it then brings objects nearer: length − B.
    beams : float, length
        B for the centre of the transmitted light, which for |η| > 1 is not a chief ray.
    share : float or None
        Share that stays in its telescopelets in this meridian, in every sheet, of the light that does in the
        other; None where cells or lenses are not aligned with x and y.
    measured_space : float or None, length
        B fitted to rays that stay in their telescopelets in this meridian.
    measured_slope : float or None
        D fitted to these rays.
    measured_scale, measured_focusing : float or None, number and 1/length
        A and C fitted to these rays; None where light fills one cell, which determines neither.
    scatter : float or None
        Rms distance of these rays from the fit, over the pitch of the first sheet.
    """

    matrix: tuple[tuple[float, float], tuple[float, float]] | None
    no_matrix: str | None
    determinant: float | None
    length: float
    acts_as_space: float | None
    moves_image: float | None
    beams: float | None
    share: float | None
    measured_space: float | None
    measured_slope: float | None
    measured_scale: float | None
    measured_focusing: float | None
    scatter: float | None


@dataclass(frozen=True, eq=False)
class StackLight:
    """Light through a stack.

    Attributes
    ----------
    rung : "law", "thin", "surfaces" or "mesh"
    rays : int
    field : float, radians
        Slopes within ± its tangent in x and in y, about the centre of the field of each cell of the first
        sheet.
    cells : int
        Cells of the first sheet that light fills.
    share : float
        Share of the rays that leave through corresponding lenslets of every sheet (ALIVE in all).
    expected_share : float
        Product of the shares that thin lenses of each sheet pass, in closed form. It assumes that the
        position at a sheet is independent of that at the sheet before. It is not: rung "thin" traces rays.
    fates : mapping
        Number of rays of each fate.
    sheets : tuple of float
        Share of the light arriving ALIVE at each sheet that it passes ALIVE.
    meridians : (x, y)
    error : float, radians
        Rms angle to the exact surfaces, over rays ALIVE on both rungs; NaN where there are none.
    strays : float
        Share of the rays whose fate differs from that through the exact surfaces.
    seconds : float
        Processor seconds of this trace; reported, but never written.
    """

    rung: Rung
    rays: int
    field: float
    cells: int
    share: float
    expected_share: float
    fates: dict[str, int]
    sheets: tuple[float, ...]
    meridians: tuple[StackMeridian, StackMeridian]
    error: float
    strays: float
    seconds: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Plain values, reproducible."""
        return {name: value for name, value in asdict(self).items() if name != "seconds"}


def measure_light(
    tracers: Sequence[StackTracer], rays: int, field: float, progress: Progress, zone: Pair2 | None = None
) -> tuple[StackLight, ...]:
    """Trace the same rays on several rungs and measure the light.

    tracers : Tracers of one stack; one has rung "surfaces", with which the others are compared.
    field : radians. Slopes reach to its tangent.
    zone : (width, height) or None, lengths. Part of the first sheet that is lit, as of `lit_cells`.
    Raises BadStack: No cell lies in the zone.
    """
    sent = _Sent.into(tracers[0].stack, rays, field, zone)
    found = {}
    for number, tracer in enumerate(sorted(tracers, key=lambda one: one.rung != "surfaces")):
        progress(f"light on rung {tracer.rung}", number / len(tracers))
        began = time.process_time()
        trace, light = _measured(tracer, sent)
        if tracer.rung == "surfaces":
            truth = trace
        both = (trace.fate == Fate.ALIVE) & (truth.fate == Fate.ALIVE)
        found[tracer.rung] = replace(
            light,
            error=rms_between(trace.direction, truth.direction, both),
            strays=float((trace.fate != truth.fate).mean()),
            seconds=time.process_time() - began,
        )
    return tuple(found[tracer.rung] for tracer in tracers)


@dataclass(frozen=True, eq=False)
class _Sent:
    """Light sent into a stack: places and slopes (n, 2) on the first lens plane, centres (n, 2) of the cells
    it enters, and number of lit cells.
    """

    place: Floats
    slope: Floats
    centre: Floats
    field: float
    cells: int

    @staticmethod
    def into(stack: Stack, rays: int, field: float, zone: Pair2 | None) -> _Sent:
        cells = lit_cells(stack, zone)
        points, first = sobol(rays, 5), stack.sheets[0]
        centre = first.scale * first.window.centres(0, cells_of(points, cells))
        return _Sent(*launch(stack, points, field, cells), centre, field, len(cells))

    def expected(self, stack: Stack) -> float:
        """Closed-form share of the first `SHARE_RAYS` of these rays."""
        place, slope = self.place[:SHARE_RAYS], self.slope[:SHARE_RAYS]
        return expected_share(stack, place, np.column_stack([slope, np.ones(len(slope))]))


def _measured(tracer: StackTracer, sent: _Sent) -> tuple[StackTrace, StackLight]:
    """Trace of the rays on one rung, and the measured light."""
    stack = tracer.stack
    found = tracer(started(stack, sent.place, sent.slope))
    alive = found.fate == Fate.ALIVE
    strayed = _strayed(stack, found)
    exit_place = _at_last_plane(stack, found)
    x, y = (_meridian(stack, axis, sent, exit_place[:, axis], found, strayed) for axis in (0, 1))
    return found, StackLight(
        tracer.rung,
        len(sent.place),
        sent.field,
        sent.cells,
        float(alive.mean()),
        sent.expected(stack),
        found.counts(),
        tuple(_passed_on(found)),
        (x, y),
        0.0,
        0.0,
    )


def _at_last_plane(stack: Stack, found: StackTrace) -> Floats:
    """Positions (n, 3) of rays on the last lens plane, extended along straight lines."""
    level = stack.sheets[-1].lens_planes[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = found.direction[:, :2] / found.direction[:, 2:]
    return np.asarray(found.position[:, :2] + slope * (level - found.position[:, 2:]))


def _strayed(stack: Stack, found: StackTrace) -> Bools | None:
    """Rays known to have left their telescopelet in some sheet, in x and y (n, 2); None where x and y mix."""
    if not all(_parted(one) for one in stack.sheets):
        return None
    strayed = np.zeros((len(found), 2), dtype=bool)
    for rows, result in found.passed:
        strayed[rows] |= _orders(result)
    return strayed


def _orders(result: TraceResult) -> Bools:
    """Rays (k, 2) that a sheet sent through another column of cells, and another row."""
    return np.asarray((result.fate == Fate.GHOST)[:, None] & (result.order != 0))


def _shares(found: StackTrace) -> tuple[float, float]:
    """Share that stays in its telescopelets in x, of the light that does in y, and vice versa.

    Product over the sheets, of the light arriving ALIVE: light that strayed before gives no information.
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
    """Whether cells and lenses are aligned with x and y, so that the meridians are independent."""
    turn = one.window.thin.rotation
    along = np.abs(turn[:2, :2]).max(axis=1).min() > 1.0 - COUPLED
    return bool(along) and not one.window.lattice.hexagonal


def _passed_on(found: StackTrace) -> list[float]:
    """Share of the rays arriving ALIVE at each sheet that it passes ALIVE."""
    so_far, shares = np.ones(len(found), dtype=bool), []
    for rows, result in found.passed:
        before = int(so_far.sum())
        here = np.zeros(len(found), dtype=bool)
        here[rows] = result.fate == Fate.ALIVE
        so_far &= here
        shares.append(float(so_far.sum() / before) if before else 0.0)
    return shares


def _meridian(
    stack: Stack, axis: int, sent: _Sent, left: Floats, found: StackTrace, strayed: Bools | None
) -> StackMeridian:
    """One meridian in closed form, and fitted to rays that stayed in it.

    Ghosts that strayed only across the meridian are included.

    left : place (n,) on the last lens plane
    """
    chief, middle = meridian(stack, axis), meridian(stack, axis, beams=True)
    long = length(stack, axis)
    straight = chief is not None and abs(chief.matrix[1, 1] - 1.0) < 1e-9 and abs(chief.matrix[1, 0]) < 1e-12
    acts = float(chief.matrix[0, 1]) if chief is not None and straight else None
    share, kept = None, found.fate == Fate.ALIVE
    if strayed is not None:
        share = _shares(found)[axis]
        kept = np.isin(found.fate, (Fate.ALIVE, Fate.GHOST)) & ~strayed[:, axis]
    fit = _fitted(sent, axis, left, found, kept)
    return StackMeridian(
        None if chief is None else _pairs(chief.matrix),
        no_meridian(stack),
        None if chief is None else chief.determinant,
        long,
        acts,
        None if acts is None else long - acts,
        None if middle is None else float(middle.matrix[0, 1]),
        share,
        *fit[:4],
        None if fit[4] is None else fit[4] / stack.sheets[0].window.lattice.pitch[axis],
    )


def _pairs(matrix: Floats) -> tuple[tuple[float, float], tuple[float, float]]:
    (a, b), (c, d) = matrix.tolist()
    return (a, b), (c, d)


def _fitted(
    sent: _Sent, axis: int, left: Floats, found: StackTrace, kept: Bools
) -> tuple[float | None, float | None, float | None, float | None, float | None]:
    """B, D, A and C that best map places and slopes of the kept rays, and the rms residual of their places
    (length).

    Light over one cell determines B and D only: A is set to 1, C to 0, and neither is given. Light over many
    cells is fitted so that the residuals depend neither on the slope nor on the centre of the entered cell
    (instrumental variables). Least squares would be biased where slopes grow across the sheet: the place
    inside a cell, which the cell does not image, is part of the place.
    """
    if kept.sum() < FEWEST:
        return (None,) * 5
    place, slope = sent.place[kept, axis], sent.slope[kept, axis]
    out = found.direction[kept, axis] / found.direction[kept, 2]
    many = sent.cells > 1
    values = np.column_stack([left[kept] - place, out])
    terms = np.column_stack([slope, place] if many else [slope])
    terms, values = terms - terms.mean(axis=0), values - values.mean(axis=0)
    if many:
        known = np.column_stack([slope, sent.centre[kept, axis]])
        known = known - known.mean(axis=0)
        fit = np.linalg.solve(known.T @ terms, known.T @ values)
    else:
        fit, *_ = np.linalg.lstsq(terms, values, rcond=None)
    rest = float(np.sqrt(np.mean((values - terms @ fit)[:, 0] ** 2)))
    scale, focusing = (1.0 + float(fit[1, 0]), float(fit[1, 1])) if many else (None, None)
    return float(fit[0, 0]), float(fit[0, 1]), scale, focusing, rest


@dataclass(frozen=True, eq=False)
class StackImage:
    """The image of a point before a stack.

    Attributes
    ----------
    object_distance : float, length
        Distance before array 1 of the first sheet, on the axis through the centre of the lit cell.
    predicted : (x, y)
        Distance of the image behind array 2 of the last sheet, < 0 before it; infinite where light leaves
        parallel; None where the meridians are coupled.
    magnification : (x, y)
    by_rays : (x, y)
        Distance at which the rays of a meridian are closest together, measured as `predicted`.
    point : (3,) or None
        Point nearest to all rays, least squares, from the centre of array 2 of the last sheet.
    spread : float, length
        Rms distance of the rays from it.
    rays : int
        Number of ALIVE rays used.
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


def measure_image(tracer: StackTracer, rays: int, field: float, distance: float) -> StackImage:
    """Trace light of a point through the stack and locate its image.

    field : radians. Light within slopes of its tangent, as far as the first sheet reaches.
    distance : length. Of the point before array 1 of the first sheet.
    """
    stack = tracer.stack
    last = stack.sheets[-1]
    place, slope = cone(stack, sobol(rays, 2), field, distance)
    found = tracer(started(stack, place, slope))
    alive = found.fate == Fate.ALIVE
    where = middle_of_light(stack)
    predicted = [meridian(stack, axis) for axis in (0, 1)]
    images = [(None, None) if one is None else one.image(distance)[::2] for one in predicted]
    shown = tuple(_finite(image[0]) for image in images)
    sized = tuple(_finite(image[1]) for image in images)
    point, spread = None, inf
    lines: tuple[float | None, float | None] = (None, None)
    if alive.sum() >= FEWEST:
        at = found.position[alive] - [*where, last.lens_planes[1]]
        way = found.direction[alive] / np.linalg.norm(found.direction[alive], axis=1)[:, None]
        point, spread = nearest_point(at, way)
        lines = (_waist(at, way, 0), _waist(at, way, 1))
    return StackImage(
        distance, (shown[0], shown[1]), (sized[0], sized[1]), lines, point, spread, int(alive.sum())
    )


def _finite(value: float | None) -> float | None:
    return value if value is not None and isfinite(value) else None


def nearest_point(position: Floats, direction: Floats) -> tuple[tuple[float, float, float] | None, float]:
    """Point nearest to straight lines, from a linear system of three equations, and its rms distance from
    them.

    position, direction : (n, 3). Unit directions.

    Returns
    -------
    point : (3,) or None
        None where the lines are parallel within rounding error.
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
    """Height z at which lines (n, 3) are closest together in a meridian; None where they are parallel."""
    slope = direction[:, axis] / direction[:, 2]
    place = position[:, axis] - slope * position[:, 2]
    away = slope - slope.mean()
    square = float(away @ away)
    if square <= 1e-24 * len(slope):
        return None
    return float(-(away @ (place - place.mean())) / square)
