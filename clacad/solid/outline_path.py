"""The outline of a body as a closed path of exact arcs, and regions of a zone bounded by traced curves.

A zone has any number of rims from side to side, and nested closed ones. Lengths in mm, cell frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, pi, sqrt, tau

import numpy as np

from clacad.base.polygons import polygon_area
from clacad.base.types import Floats
from clacad.sheet.edge_columns import CX, CY, RADIUS, SENSE
from clacad.sheet.lattice import Circle, Outline
from clacad.sheet.plate import Plate
from clacad.solid.face_pattern import (
    SNAP,
    Chain,
    Kind,
    Pattern,
    Proud,
    Region,
    Run,
    encloses,
    side_runs,
    walk,
)
from clacad.solid.rational_conics import Arc, line

Round = tuple[Floats, float, float]


@dataclass(frozen=True, eq=False)
class Path:
    """An outline in the plane z = 0, counter-clockwise; a round one in four quarters.

    centre : (2,), mm
    radius : Of the round arcs.
    touched : Whether cells may touch it.
    rounds : tuple of (centre (2,), radius, sense) or None
        Circle of each arc, mm, and its sense: 1 counter-clockwise, −1 clockwise. None for a straight one.
    """

    arcs: tuple[Arc, ...]
    centre: Floats
    radius: float
    touched: bool = True
    rounds: tuple[Round | None, ...] = ()

    def position(self, point: Floats) -> tuple[int, float] | None:
        """Side and parameter (0 ≤ u < 1) of a point (2,) of the path; None if it is not on it."""
        for side, arc in enumerate(self.arcs if self.touched else ()):
            a, b = arc.poles[0, :2], arc.poles[-1, :2]
            width = SNAP / float(np.hypot(*(b - a)))
            if arc.straight:
                u = float((point - a) @ (b - a) / ((b - a) @ (b - a)))
                away = float(np.hypot(*(point - a - u * (b - a))))
            else:
                away = abs(float(np.hypot(*(point - self.centre))) - self.radius)
                u = self._on_quarter(side, point) if away < SNAP else 2.0
            if away < SNAP and -width <= u < 1.0 - width:
                return side, (0.0 if u < width else u)
        return None

    def _on_quarter(self, side: int, point: Floats) -> float:
        """Parameter of a point of a round path on one quarter; 2 if it lies on another."""
        way, begin = point - self.centre, self.arcs[side].poles[0, :2] - self.centre
        start = round(atan2(begin[1], begin[0]) / (0.5 * pi)) * 0.5 * pi
        angle = (atan2(way[1], way[0]) - start + 1e-9) % tau - 1e-9
        if angle > 0.5 * pi:
            return 2.0
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            x, y = self.arcs[side].at(np.array([middle]))[0, :2] - self.centre
            if (atan2(y, x) - start + 1e-9) % tau - 1e-9 < angle:
                low = middle
            else:
                high = middle
        return 0.5 * (low + high)

    def rays(self, side: int, u: float) -> tuple[float, float]:
        """Directions (angles, rad) in which the path leaves a point forwards and backwards."""
        arc = self.arcs[side]
        if u == 0.0:
            before = self.arcs[side - 1]
            out, back = arc.poles[1] - arc.poles[0], before.poles[-2] - before.poles[-1]
        elif arc.straight:
            out = arc.poles[1] - arc.poles[0]
            back = -out
        else:
            x, y = arc.at(np.array([u]))[0, :2] - self.centre
            out = np.array([-y, x, 0.0])
            back = -out
        return atan2(out[1], out[0]), atan2(back[1], back[0])

    def stretch(self, side: int, u0: float, u1: float) -> Arc:
        """The part of a side between two parameters, with the side's own parameter stretched linearly."""
        arc = self.arcs[side]
        if (u0, u1) == (0.0, 1.0):
            return arc
        if arc.straight:
            ends = arc.at(np.array([u0, u1]))
            return line(ends[0], ends[1])
        control = np.column_stack([arc.poles * arc.weights[:, None], arc.weights])
        blossom = np.array([_blossom(control, u0, u0), _blossom(control, u0, u1), _blossom(control, u1, u1)])
        return Arc(blossom[:, :3] / blossom[:, 3:], blossom[:, 3])


def _blossom(control: Floats, s: float, t: float) -> Floats:
    """Polar form of a quadratic in Bézier form (3, d)."""
    first = (1.0 - s) * control[:-1] + s * control[1:]
    return np.asarray((1.0 - t) * first[0] + t * first[1])


def outline_path(outline: Outline, scale: float, centre: Floats, copies: int = 1) -> Path:
    """Path about a centre (2,), mm, of an outline (`scale` mm per unit) or of a plate's boundary.

    copies : Above 1: of its first half (2, y > 0) or quarter (4, x, y > 0) about the centre.
    """
    if isinstance(outline, Plate):
        return plate_paths(outline, scale)[0]
    middle = np.append(centre, 0.0)
    if isinstance(outline, Circle):
        r = 0.5 * outline.diameter * scale
        starts, corners = [(0.0, -r), (r, 0.0), (0.0, r), (-r, 0.0)], [(r, -r), (r, r), (-r, r), (-r, -r)]
        weights = np.array([1.0, sqrt(0.5), 1.0])
        arcs = [
            Arc(np.array([[*a, 0.0], [*b, 0.0], [*c, 0.0]]) + middle, weights)
            for a, b, c in zip(starts, corners, starts[1:] + starts[:1])
        ]
        arcs = arcs if copies == 1 else arcs[1 : 1 + 4 // copies]
        rounds: list[Round | None] = [(centre, r, 1.0)] * len(arcs)
    else:
        r, w, h = 0.0, 0.5 * outline.width * scale, 0.5 * outline.height * scale
        low = {1: (-w, -h), 2: (-w, 0.0), 4: (0.0, 0.0)}[copies]
        points = np.array([(*low, 0.0), (w, low[1], 0.0), (w, h, 0.0), (low[0], h, 0.0)]) + middle
        arcs, rounds = [line(a, b) for a, b in zip(points, np.roll(points, -1, axis=0))], []
    if rounds and copies > 1:  # along the cuts from and to the middle
        stops = [arcs[-1].poles[-1], *([middle] if copies == 4 else []), arcs[0].poles[0]]
        cuts = [line(a, b) for a, b in zip(stops[:-1], stops[1:])]
        arcs, rounds = [*arcs, *cuts], [*rounds, *[None] * len(cuts)]
    return Path(tuple(arcs), centre, r, rounds=tuple(rounds))


def plate_paths(plate: Plate, scale: float) -> tuple[Path, ...]:
    """Paths of a plate's boundary and of its holes, the material on their left; no cell touches them (mm)."""
    return tuple(
        Path(
            tuple(_arc(edge * scale, edge[SENSE]) for edge in loop),
            np.zeros(2),
            0.0,
            touched=False,
            rounds=tuple(_round(edge * scale, edge[SENSE]) for edge in loop),
        )
        for loop in plate.loops
    )


def _round(edge: Floats, sense: float) -> Round | None:
    """Centre (2,), radius and sense of an edge of a plate, mm; None for a straight one."""
    return None if sense == 0.0 else (edge[CX : CY + 1], float(edge[RADIUS]), float(np.sign(sense)))


def _arc(edge: Floats, sense: float) -> Arc:
    """One edge of a plate, mm: a line, or an arc of at most 90° as one rational quadratic."""
    a, b = edge[:2], edge[2:4]
    if sense == 0.0:
        return line(np.append(a, 0.0), np.append(b, 0.0))
    centre = edge[CX : CY + 1]
    u, v = a - centre, b - centre
    # The end tangents intersect beyond the middle of the chord, at its distance from the centre over
    # cos² of the half angle.
    half_square = 0.5 * (1.0 + float(u @ v) / float(np.hypot(*u) * np.hypot(*v)))
    top = centre + 0.5 * (u + v) / half_square
    poles = np.array([[*a, 0.0], [*top, 0.0], [*b, 0.0]])
    return Arc(poles, np.array([1.0, sqrt(half_square), 1.0]))


NEAR = 1e-5
"""Distance, relative to the zone's size, within which a traced rim ends at the root of a side."""


def cut_pattern(
    zone: Floats,
    roots: list[list[float]],
    proud: Proud,
    rest: Kind,
    across: list[Floats],
    closed: list[Floats],
    grid: int,
) -> tuple[Pattern, list[Floats]] | None:
    """Divide a zone by traced curves into lens and rest.

    zone : (m, 2), mm. Corners, counter-clockwise, convex.
    roots : per side, ascending parameters at which the lens begins or ends
    proud : Whether the lens is there at (x, y), each (n,).
    rest : "land" or "none", where the lens is not
    across, closed : lists of (n, 2), mm
        Points of curves from side to side and of closed ones, the lens on their left.
    grid : Divisions of a side of the grid on which the curves were searched. A curve that dips in and out
        between two of them is joined by the roots alone.

    Returns the pattern and the points of its chains; None where curves and roots disagree.
    """
    ends: list[tuple[int, float]] = []
    runs = [side_runs(zone, k, roots[k], proud, rest, ends) for k in range(len(zone))]
    paths = _matched(zone, runs, ends, across, grid)
    if paths is None:
        return None
    chains = [Chain(path, ("rim", i), ("rim", j)) for i, j, path in paths]
    points = [path for _, _, path in paths]
    whole = Region(runs[0][0].kind, (tuple(("run", k, 0) for k in range(len(zone))),))
    regions = walk(runs, chains, "lens") + walk(runs, chains, rest) if ends else [whole]
    outlines = [(region, _outline(region, zone, runs, points)) for region in regions]
    kept = [one for one in _with_closed(outlines, closed, len(chains), rest) if one.kind != "none"]
    chains += [Chain(path, None, None) for path in closed]
    return Pattern(zone, tuple(runs), tuple(chains), tuple(kept), tuple(ends)), [*points, *closed]


def _matched(
    zone: Floats, runs: list[tuple[Run, ...]], ends: list[tuple[int, float]], across: list[Floats], grid: int
) -> list[tuple[int, int, Floats]] | None:
    """Every path with the indices of the roots at which it begins and ends."""
    place = np.array([zone[k] + t * (zone[(k + 1) % len(zone)] - zone[k]) for k, t in ends]).reshape(-1, 2)
    size = float(np.ptp(zone, axis=0).max())
    leaves = {run.last[1] for side in runs for run in side if run.kind == "lens" and run.last[0] == "rim"}
    free = set(range(len(ends)))
    matched = []
    for path in across:
        found = [_nearest(point, place, free, NEAR * size) for point in (path[0], path[-1])]
        if None in found:
            if found == [None, None] and float(np.ptp(path, axis=0).max()) < 10.0 * SNAP:
                continue  # the tip of a corner, which the sides ignore
            return None
        first, last = found
        assert first is not None
        assert last is not None
        if first not in leaves or last in leaves:
            return None
        free -= {first, last}
        path = path.copy()
        path[0], path[-1] = place[first], place[last]
        matched.append((first, last, path))
    for first in sorted(free & leaves):
        last = min(
            (e for e in free - leaves if ends[e][0] == ends[first][0]),
            key=lambda e: abs(ends[e][1] - ends[first][1]),
            default=None,
        )
        if last is None or abs(ends[last][1] - ends[first][1]) > 1.0 / grid:
            return None
        free -= {first, last}
        matched.append((first, last, place[[first, last]]))
    return None if free else matched


def _nearest(point: Floats, place: Floats, free: set[int], near: float) -> int | None:
    away = {e: float(np.hypot(*(place[e] - point))) for e in free}
    best = min(away, key=lambda e: away[e], default=None)
    return None if best is None or away[best] > near else best


def _outline(region: Region, zone: Floats, runs: list[tuple[Run, ...]], paths: list[Floats]) -> Floats:
    """Points along the outer loop of a region."""
    points: list[Floats] = []
    for what, number, detail in region.loops[0]:
        if what == "run":
            a, b = zone[number], zone[(number + 1) % len(zone)]
            run = runs[number][detail]
            points += [a + run.t0 * (b - a), a + run.t1 * (b - a)]
        else:
            points += list(paths[number][:: 1 if detail > 0 else -1])
    return np.array(points)


def _with_closed(
    outlines: list[tuple[Region, Floats]], closed: list[Floats], first: int, rest: Kind
) -> list[Region]:
    """Add the regions inside closed rims, and holes in the regions around them."""
    holes: list[tuple[Kind, tuple[tuple[str, int, int], ...], Floats]] = []
    for n, path in enumerate(closed):
        lens_inside = polygon_area(path) > 0.0
        sense = 1 if lens_inside else -1
        inside: Kind = "lens" if lens_inside else rest
        around: Kind = rest if lens_inside else "lens"
        outlines = [*outlines, (Region(inside, ((("rim", first + n, sense),),)), path)]
        holes.append((around, (("rim", first + n, -sense),), path))
    loops = [list(region.loops) for region, _ in outlines]
    for kind, loop, path in holes:
        round_it = [
            i
            for i, (region, outline) in enumerate(outlines)
            if region.kind == kind and encloses(outline, path[0])
        ]
        if round_it:
            smallest = min(round_it, key=lambda i: abs(polygon_area(outlines[i][1])))
            loops[smallest].append(loop)
    return [Region(region.kind, tuple(own)) for (region, _), own in zip(outlines, loops)]
