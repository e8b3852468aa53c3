"""Rung "mesh" of a non-uniform sheet: light through all triangles, with the cells found afterwards.

The trees that find triangles know no cells, and the kernels above them assume cells of one pitch. Light is
therefore traced through the triangles as if they belonged to a uniform sheet without an end
(`triangle_soup.endless_layout`). The cells of every ray are then found from the points where it met the
arrays, in the order in which it met them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clacad.base.pairs import two_sum
from clacad.base.types import Bools, Floats, Ints
from clacad.optics.rays import NO_CELL, Fate, Rays, TraceResult
from clacad.sheet.window import Window
from clacad.tracing.layout import BodyPlan, FacePlan, Layout, colours, lay_out
from clacad.tracing.reference.face import in_footprint, on_line
from clacad.tracing.reference.launch import Beam
from clacad.tracing.reference.walk import Walkers, note_cell, order_of


def told(
    window: Window, bodies: tuple[BodyPlan, ...], rays: Rays, result: TraceResult, record: bool
) -> TraceResult:
    """Result with the cells of the sheet itself; `result` was recorded through the triangles of
    `endless_layout`.

    Rays that passed a body outside its cells have missed the sheet; the endless sheet calls them land.
    """
    way = _Way.of(bodies, rays, result)
    n, places = len(rays), np.zeros((len(rays), 3))
    beam = Beam(np.arange(n), 0, np.full((n, 2), NO_CELL), np.zeros((n, 2)), np.zeros(n), places)
    walkers, missed = Walkers.unmet(beam, places), np.zeros(n, dtype=bool)
    for b, plan in enumerate(lay_out(window).bodies):
        rows = np.flatnonzero(way.dry[b] & ~missed)
        top = way.tops[b][rows]
        over = in_footprint(plan, top[:, :2], window.lattice.contains(_cells(window, plan.arrays[0], top)))
        missed[rows[~over]] = True
        for side, face in enumerate((plan.front, plan.back)):
            if face.array is None:
                continue
            met = (way.met[2 * b + side] | way.dry[b]) & ~missed
            at = np.where(way.dry[b][:, None], way.tops[b], way.hits[2 * b + side])
            walkers = _noted(window, walkers, face, at, met, ~way.dry[b])
    found = _written(rays, result, walkers, missed)
    if window.land.lined >= 0:
        found = _ended_at_line(lay_out(window), rays, found)
    return found if record else replace(found, hits=None, directions=None)


@dataclass(frozen=True, eq=False)
class _Way:
    """Record of n rays, face by face.

    hits : (faces, n, 3) lengths
    met : (faces, n) bool. Whether they were refracted at that face.
    dry : (bodies, n) bool. Whether they have passed that body without meeting it.
    tops : (bodies, n, 3) lengths. Points where those rays rose past it.
    """

    hits: Floats
    met: Bools
    dry: Bools
    tops: Floats

    @classmethod
    def of(cls, bodies: tuple[BodyPlan, ...], rays: Rays, result: TraceResult) -> _Way:
        """Derive it from a recorded trace: a face that was not met repeats the last point, or the end."""
        hits, turns, surface = result.hits, result.directions, result.surface
        assert hits is not None
        assert turns is not None
        wall, last = result.fate == Fate.WALL, _last_body(bodies, result)
        end = np.where(wall[:, None], result.position, np.nan)
        met, dry = np.zeros(hits.shape[:2], dtype=bool), np.zeros((len(bodies), len(rays)), dtype=bool)
        tops = np.zeros((len(bodies), len(rays), 3))
        point, ray = rays.position, rays.direction
        for b, body in enumerate(bodies):
            for f in (2 * b, 2 * b + 1):
                met[f] = np.where(wall, (hits[f] != end).any(axis=1), f <= surface) & (b <= last)
            passed = met[2 * b + 1] & (hits[2 * b + 1] != point).any(axis=1)
            dry[b] = (b < last) & ~passed
            met[2 * b : 2 * b + 2] &= ~dry[b]
            with np.errstate(invalid="ignore", divide="ignore"):
                tops[b] = point + ((body.level + body.high - point[:, 2]) / ray[:, 2])[:, None] * ray
            point, ray = (
                np.where(dry[b][:, None], before, at[2 * b + 1])
                for before, at in ((point, hits), (ray, turns))
            )
        return cls(hits, met, dry, tops)


def _last_body(bodies: tuple[BodyPlan, ...], result: TraceResult) -> Ints:
    """Number (n,) of the body in which rays ended; beyond the last if all are passed, −1 if none is met."""
    lows = np.array([body.level + body.low for body in bodies])
    with np.errstate(invalid="ignore"):
        at_wall = np.searchsorted(lows, result.position[:, 2], side="right") - 1
    ended = np.where(result.fate == Fate.WALL, np.maximum(at_wall, 0), result.surface // 2)
    ended = np.where(result.fate <= Fate.LAND, len(bodies), ended)
    return np.asarray(np.where(result.fate >= Fate.MISSED, -1, ended), dtype=np.int64)


def _cells(window: Window, array: int, at: Floats) -> Ints:
    """Cells (m, 2) of an array that contain points (m, 3), kept or not, from differences rounded once."""
    dx, dy = window.placements[array].shift
    (x, x_low), (y, y_low) = two_sum(at[:, 0], -dx), two_sum(at[:, 1], -dy)
    return window.lattice_of(array).locate(x, y, x_low, y_low)[0]


def _noted(
    window: Window, walkers: Walkers, face: FacePlan, at: Floats, met: Bools, on_lens: Bools
) -> Walkers:
    """Enter the cells of those rays (n,) that met a face at points (n, 3) in their record."""
    assert face.array is not None
    rows = np.flatnonzero(met)
    cell = _cells(window, face.array, at[rows])
    some = walkers.take(rows)
    some = note_cell(lay_out(window), replace(some, beam=replace(some.beam, cell=cell)), face, on_lens[rows])
    noted = {name: getattr(walkers, name).copy() for name in ("first", "last", "odd", "second", "ghost")}
    for name, column in noted.items():
        column[rows] = getattr(some, name)
    return replace(walkers, **noted)


def _written(rays: Rays, result: TraceResult, walkers: Walkers, missed: Bools) -> TraceResult:
    """Rows with their cells; missed rays as launched."""
    order = np.where(missed[:, None], NO_CELL, order_of(walkers)).astype(np.int32)
    through = result.fate <= Fate.GHOST
    fate = np.where(through, np.where(walkers.ghost, Fate.GHOST, Fate.ALIVE), result.fate)
    back = missed[:, None]
    hits, turns = result.hits, result.directions
    assert hits is not None
    assert turns is not None
    return replace(
        result,
        cell=walkers.first.astype(np.int32),
        order=order,
        fate=np.where(missed, Fate.MISSED, fate).astype(np.uint8),
        position=np.where(back, rays.position, result.position),
        direction=np.where(back, rays.direction, result.direction),
        surface=np.where(missed, NO_CELL, result.surface).astype(np.int32),
        optical_path=np.where(missed, 0.0, result.optical_path),
        hits=np.where(back, rays.position, hits),
        directions=np.where(back, rays.direction, turns),
    )


def _ended_at_line(layout: Layout, rays: Rays, found: TraceResult) -> TraceResult:
    """A recorded trace in which the opaque line of a face ends the rays that hit it."""
    number = layout.window.land.lined
    assert found.hits is not None
    assert found.directions is not None  # both recorded
    rows = np.flatnonzero((found.surface >= number) & on_line(layout, found.hits[number, :, :2]))
    names = ("hits", "directions", "optical_path", "fate", "surface", "position", "direction")
    changed = {name: getattr(found, name).copy() for name in names}
    hits, ways = changed["hits"], changed["directions"]
    before = ways[number - 1] if number else rays.direction
    hits[number + 1 :, rows], ways[number:, rows] = hits[number, rows], before[rows]
    for same, media in colours(layout, rays, rows):
        ends = np.stack([rays.position[same], *hits[: number + 1, same]])
        changed["optical_path"][same] = np.array(media[: number + 1]) @ np.linalg.norm(
            np.diff(ends, axis=0), axis=2
        )
    changed["fate"][rows], changed["surface"][rows] = Fate.VIGNETTED, number
    changed["position"][rows], changed["direction"][rows] = hits[number, rows], before[rows]
    return replace(found, **changed)
