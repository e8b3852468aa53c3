"""Regions of a zone bounded by traced curves: any number of rims from side to side, and nested closed ones.

Lengths in mm, cell frame.
"""

from __future__ import annotations

import numpy as np

from clacad.base.polygons import polygon_area
from clacad.base.types import Floats
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

    Parameters
    ----------
    zone : (m, 2), mm
        Corners, counter-clockwise, convex.
    roots : per side, ascending parameters at which the lens begins or ends
    proud : callable
        Whether the lens is there at (x, y), each (n,).
    rest : "land" or "none"
        Kind of the face where the lens is not.
    across, closed : lists of (n, 2), mm
        Points of curves from side to side and of closed ones, the lens on their left.
    grid : int
        Divisions of a side of the grid on which the curves were searched. A curve that dips in and out
        between two of them is joined by the roots alone.

    Returns
    -------
    Pattern, and the points of every one of its chains; None where curves and roots disagree.
    """
    ends: list[tuple[int, float]] = []
    runs = [side_runs(zone, k, roots[k], proud, rest, ends) for k in range(len(zone))]
    paths = _matched(zone, runs, ends, across, grid)
    if paths is None:
        return None
    chains = [Chain(path, ("rim", i), ("rim", j)) for i, j, path in paths]
    points = [path for _, _, path in paths]
    if ends:
        regions = walk(runs, chains, "lens") + walk(runs, chains, rest)
    else:
        whole = tuple(("run", k, 0) for k in range(len(zone)))
        regions = [Region(runs[0][0].kind, (whole,))]
    outlines = [(region, _outline(region, zone, runs, points)) for region in regions]
    regions = _with_closed(outlines, closed, len(chains), rest)
    chains += [Chain(path, None, None) for path in closed]
    kept = tuple(region for region in regions if region.kind != "none")
    return Pattern(zone, tuple(runs), tuple(chains), kept, tuple(ends)), [*points, *closed]


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
