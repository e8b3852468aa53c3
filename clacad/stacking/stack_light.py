"""Light through a stack: the share that obeys every law, and the equivalent empty space.

Rays fill the first sheet or a zone of it, and a square of slopes; one cell where all cells of all sheets act
alike. They are also counted per meridian: where the cells are rectangles along x and y, a ray stays in its
telescopelets in x independently of y.

Rays for a stack: over cells of the first sheet and a square of slopes, or from a point before it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import tan
from typing import Any

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Bools, Floats, Ints, Pair2, Progress, Rung
from clacad.light.compare import rms_between
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.stack import BadStack, Stack, StackedSheet
from clacad.sheet.vignetting import aperture_slopes
from clacad.stacking.chief_matrices import COUPLED, expected_share, length, meridian, no_meridian
from clacad.tracing.through_stack import StackTrace, StackTracer


def lit_cells(stack: Stack, zone: Pair2 | None = None) -> Ints:
    """Cells (n, 2) of the first sheet that are lit.

    zone : (width, height) or None, lengths of the stack
        Cells whose centres lie in it, about the centre of the sheet. None: every cell, or only the central
        one where all sheets are uniform and have one lattice, since it then represents every cell away from
        the edges.

    Raises
    ------
    BadStack
        No cell lies in the zone.
    """
    first = stack.sheets[0]
    if zone is None and _alike(stack):
        return np.array([central_cell(first.window)])
    cells = first.window.lattice.cells()
    if zone is None:
        return cells
    away = np.abs(first.scale * first.window.centres(0, cells))
    kept = cells[(away <= 0.5 * np.asarray(zone)).all(axis=1)]
    if not len(kept):
        low, high = first.scale * np.asarray(first.window.lattice.pitch)
        raise BadStack(
            f"zone {zone[0]:g} x {zone[1]:g}: no cell of the first sheet has its centre in it; "
            f"a zone of {2.0 * low:g} x {2.0 * high:g} holds some"
        )
    return kept


def _alike(stack: Stack) -> bool:
    """Whether one cell of the first sheet represents all: all sheets are uniform and have one lattice."""
    first = stack.sheets[0].window.lattice
    return all(
        one.window.uniform
        and one.window.lattice.kind == first.kind
        and np.allclose(one.scale * np.asarray(one.window.lattice.pitch), first.pitch, rtol=1e-9, atol=0.0)
        for one in stack.sheets
    )


def launch(stack: Stack, points: Floats, field: float, cells: Ints) -> tuple[Floats, Floats]:
    """Places (n, 2) on the first lens plane and slopes (n, 2), from points (n, 5) of the unit cube; lengths
    of the stack.

    Light fills each of the cells (m, 2), and a square of slopes about the centre of the field of each.
    """
    first = stack.sheets[0]
    window = first.window
    chosen = cells[(points[:, 4] * len(cells)).astype(np.int64)]
    slope = aperture_slopes(window, chosen) + (2.0 * points[:, 2:4] - 1.0) * tan(field)
    return first.scale * (window.lattice.over_cell(points[:, :2]) + window.centres(0, chosen)), slope


def launched(stack: Stack, rays: int, field: float) -> Rays:
    """Rays over the first sheet's central cell and a square of slopes, from before it; stack's lengths."""
    middle = np.array([central_cell(stack.sheets[0].window)])
    return started(stack, *launch(stack, sobol(rays, 5), field, middle))


def started(stack: Stack, place: Floats, slope: Floats) -> Rays:
    """Rays that cross the first lens plane at places (n, 2) with slopes (n, 2), from before the material."""
    first = stack.sheets[0]
    level = first.lens_planes[0]
    back = level - first.span[0] + first.scale * max(first.window.lattice.pitch)
    start = np.column_stack([place - back * slope, np.full(len(place), level - back)])
    return Rays(start, np.column_stack([slope, np.ones(len(place))]))


def middle_of_light(stack: Stack) -> Floats:
    """Centre (2,) of the central cell of the first sheet, lengths of the stack."""
    first = stack.sheets[0]
    return np.asarray(first.scale * first.window.centres(0, np.array(central_cell(first.window))))


def cone(stack: Stack, points: Floats, field: float, distance: float) -> tuple[Floats, Floats]:
    """Places and slopes (n, 2) on the first lens plane of axial light, within field and lattice."""
    window = stack.sheets[0].window
    where = middle_of_light(stack)
    x0, x1, y0, y1 = window.lattice.extent()
    room = np.array([min(x1 - where[0], where[0] - x0), min(y1 - where[1], where[1] - y0)])
    reach = np.minimum(distance * tan(field), np.maximum(room, 0.0))
    place = (2.0 * points - 1.0) * reach
    return place + where, place / distance


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

    Parameters
    ----------
    tracers : sequence of StackTracer
        Tracers of one stack; one has rung "surfaces", with which the others are compared.
    rays : int
    field : float, radians
        Slopes reach to its tangent.
    progress : callable
    zone : (width, height) or None, lengths
        Part of the first sheet that is lit, as of `lit_cells`.

    Raises
    ------
    BadStack
        No cell lies in the zone.
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
    """Light sent into a stack: places and slopes (n, 2) on the first lens plane, and number of lit cells."""

    place: Floats
    slope: Floats
    field: float
    cells: int

    @staticmethod
    def into(stack: Stack, rays: int, field: float, zone: Pair2 | None) -> _Sent:
        cells = lit_cells(stack, zone)
        return _Sent(*launch(stack, sobol(rays, 5), field, cells), field, len(cells))

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

    Light over one cell determines B and D only: A is set to 1, C to 0, and neither is given.
    """
    if kept.sum() < FEWEST:
        return (None,) * 5
    place, slope = sent.place[kept, axis], sent.slope[kept, axis]
    out = found.direction[kept, axis] / found.direction[kept, 2]
    many = sent.cells > 1
    values = np.column_stack([left[kept] - place, out])
    terms = np.column_stack([slope, place] if many else [slope])
    terms, values = terms - terms.mean(axis=0), values - values.mean(axis=0)
    fit, *_ = np.linalg.lstsq(terms, values, rcond=None)
    rest = float(np.sqrt(np.mean((values - terms @ fit)[:, 0] ** 2)))
    scale, focusing = (1.0 + float(fit[1, 0]), float(fit[1, 1])) if many else (None, None)
    return float(fit[0, 0]), float(fit[0, 1]), scale, focusing, rest
