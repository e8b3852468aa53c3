"""Division of one face of a cell into lens and land, with the exact rim between them.

The optical zone is a convex polygon; the rim is the conic in which a plane (the land, or the plane in which
the two faces of a lens meet) cuts the lens. Polygon and conic are intersected exactly (a quadratic per side),
so the zone falls into regions bounded by stretches of its sides and arcs of the conic. Lengths in mm, cell
frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clacad.base.polygons import within
from clacad.base.types import Floats
from clacad.topology.complex_parts import CannotBuild

Kind = Literal["lens", "land", "none", "plane", "open"]
Proud = Callable[[Floats, Floats], NDArray[np.bool_]]

SNAP = 1e-6
"""Points closer than this (mm) to a corner are merged with it: a tenth of the resolution of CAD programs."""


@dataclass(frozen=True, slots=True)
class Run:
    """A stretch of a zone side on which the face keeps its kind; `first`, `last` name its end points."""

    t0: float
    t1: float
    kind: Kind
    first: tuple[str, int]
    last: tuple[str, int]


@dataclass(frozen=True, eq=False, slots=True)
class Chain:
    """A stretch of rim inside the zone, lens on its left hand.

    points : (n, 2), mm
        Ends and intermediate vertices, less than a quarter turn apart; closed chains repeat no point.
    first, last : names of the end points, or None for a closed chain
    """

    points: Floats
    first: tuple[str, int] | None
    last: tuple[str, int] | None


@dataclass(frozen=True, slots=True)
class Region:
    """A part of the zone of one kind: loops of ("run", side, number) and ("rim", chain, ±1),
    counter-clockwise.

    The first loop is the outer one.
    """

    kind: Kind
    loops: tuple[tuple[tuple[str, int, int], ...], ...]


@dataclass(frozen=True, eq=False, slots=True)
class Pattern:
    """Division of a zone (m, 2): runs per side, rims, regions; `ends[i]` = (side, t) of rim point i."""

    zone: Floats
    runs: tuple[tuple[Run, ...], ...]
    chains: tuple[Chain, ...]
    regions: tuple[Region, ...]
    ends: tuple[tuple[int, float], ...]


def plain_pattern(zone: Floats, kind: Kind) -> Pattern:
    """Pattern of a face of a single kind over its whole zone (m, 2)."""
    m = len(zone)
    runs = tuple((Run(0.0, 1.0, kind, ("corner", k), ("corner", (k + 1) % m)),) for k in range(m))
    loop = tuple(("run", k, 0) for k in range(m))
    return Pattern(zone, runs, (), (Region(kind, (loop,)),), ())


def divided_pattern(zone: Floats, conic: Floats, proud: Proud, rest: Kind) -> Pattern:
    """Divide a zone by a conic into lens and rest.

    zone : (m, 2), mm. Corners, counter-clockwise, convex.
    conic : (3, 3). Symmetric matrix of the rim, [x y 1] conic [x y 1]ᵀ = 0.
    proud : Whether the lens is there at (x, y), each (n,).
    rest : "land" or "none". Kind of the face where the lens is not.
    Raises ValueError: The regions do not close: the lens ends inside the zone other than at the conic.
    """
    m = len(zone)
    ends: list[tuple[int, float]] = []
    runs: list[tuple[Run, ...]] = []
    for k in range(m):
        runs.append(side_runs(zone, k, _conic_roots(zone, k, conic), proud, rest, ends))
    if not ends:
        return _undivided(zone, runs, conic, proud, rest)
    chains = _chains(zone, conic, proud, ends)
    regions = walk(runs, chains, "lens") + walk(runs, chains, rest)
    return Pattern(
        zone, tuple(runs), tuple(chains), tuple(r for r in regions if r.kind != "none"), tuple(ends)
    )


def _conic_roots(zone: Floats, k: int, conic: Floats) -> list[float]:
    """Parameters at which a conic intersects side k of the zone, ascending; any real ones."""
    a, b = zone[k], zone[(k + 1) % len(zone)]
    p, d = np.append(a, 1.0), np.append(b - a, 0.0)
    return _quadratic(float(d @ conic @ d), float(p @ conic @ d), float(p @ conic @ p))


def side_runs(
    zone: Floats, k: int, roots: list[float], proud: Proud, rest: Kind, ends: list[tuple[int, float]]
) -> tuple[Run, ...]:
    """Stretches of side k of a zone, cut at the roots (ascending parameters), between which nothing changes.

    `ends` receives the (side, parameter) of every root that separates two kinds.
    """
    m = len(zone)
    a, b = zone[k], zone[(k + 1) % m]
    length = float(np.hypot(*(b - a)))
    cuts = [t for t in roots if SNAP < t * length < length - SNAP]
    if len(cuts) == 2 and (cuts[1] - cuts[0]) * length < SNAP:
        cuts = []
    stops = [0.0, *cuts, 1.0]
    middle = a + (0.5 * (np.array(stops[:-1]) + np.array(stops[1:])))[:, None] * (b - a)
    kinds: list[Kind] = ["lens" if there else rest for there in proud(middle[:, 0], middle[:, 1])]
    keep = [i for i in range(1, len(kinds)) if kinds[i] != kinds[i - 1]]  # a tangent rim divides nothing
    names: list[tuple[str, int]] = [("corner", k)]
    for i in keep:
        names.append(("rim", len(ends)))
        ends.append((k, stops[i]))
    names.append(("corner", (k + 1) % m))
    bounds = [0, *keep, len(kinds)]
    return tuple(
        Run(stops[bounds[r]], stops[bounds[r + 1]], kinds[bounds[r]], names[r], names[r + 1])
        for r in range(len(bounds) - 1)
    )


def _quadratic(a: float, b: float, c: float) -> list[float]:
    """Real roots of a t² + 2 b t + c, ascending, without cancellation."""
    square = b * b - a * c
    if square < 0.0 or (a == 0.0 and b == 0.0):
        return []
    q = -(b + np.copysign(np.sqrt(square), b))
    roots = [q / a] if a != 0.0 and abs(q) < 1e30 * abs(a) else []
    if q != 0.0:
        roots.append(c / q)
    return sorted(float(root) for root in roots)


def _undivided(zone: Floats, runs: list[tuple[Run, ...]], conic: Floats, proud: Proud, rest: Kind) -> Pattern:
    """Pattern of a zone whose sides the rim does not cross: one kind, or an island inside the zone."""
    kind = runs[0][0].kind
    outer = tuple(("run", k, 0) for k in range(len(zone)))
    rim = _closed_rim(zone, conic)
    if rim is None:
        regions: tuple[Region, ...] = () if kind == "none" else (Region(kind, (outer,)),)
        return Pattern(zone, tuple(runs), (), regions, ())
    points, centre = rim
    inside: Kind = "lens" if bool(proud(centre[:1], centre[1:])[0]) else rest
    if inside == kind:  # a rim of the other half of the surface
        regions = () if kind == "none" else (Region(kind, (outer,)),)
        return Pattern(zone, tuple(runs), (), regions, ())
    if inside != "lens":
        points = points[::-1]
    sense = 1 if inside == "lens" else -1
    island, sea = Region(inside, ((("rim", 0, sense),),)), Region(kind, (outer, (("rim", 0, -sense),)))
    chain = Chain(points, None, None)
    return Pattern(
        zone, tuple(runs), (chain,), tuple(region for region in (island, sea) if region.kind != "none"), ()
    )


def _closed_rim(zone: Floats, conic: Floats) -> tuple[Floats, Floats] | None:
    """Four points on an ellipse that lies inside the zone, counter-clockwise, and its centre."""
    root, centre = _to_circle(conic)
    if root is None or centre is None:
        return None
    angle = 0.25 * np.pi + 0.5 * np.pi * np.arange(4)
    points = centre + np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ root.T
    dense = 2.0 * np.pi * np.arange(64) / 64
    around = centre + np.stack([np.cos(dense), np.sin(dense)], axis=-1) @ root.T
    return (points, centre) if within(zone, around[:, 0], around[:, 1], open_rim=True).all() else None


def _to_circle(conic: Floats) -> tuple[Floats, Floats] | tuple[None, None]:
    """Map L and centre with ellipse = centre + L (unit circle), det L > 0; None if it is no real ellipse."""
    form = conic[:2, :2]
    determinant = float(np.linalg.det(form))
    scale = float(np.abs(form).max())
    if determinant <= 1e-12 * scale * scale:
        return None, None
    centre = -np.linalg.solve(form, conic[:2, 2])
    level = -float(np.append(centre, 1.0) @ conic @ np.append(centre, 1.0))
    if level * np.trace(form) <= 0.0:
        return None, None
    lower = np.linalg.cholesky(form / level)
    return np.asarray(np.linalg.inv(lower).T), np.asarray(centre)


def _chains(zone: Floats, conic: Floats, proud: Proud, ends: list[tuple[int, float]]) -> list[Chain]:
    """Join the rim's points on the zone's sides by the arcs of the conic that run inside the zone."""
    m = len(zone)
    points = np.array([zone[k] + t * (zone[(k + 1) % m] - zone[k]) for k, t in ends])
    chains = []
    for i, j, middle in _arcs(zone, conic, points):
        path = np.vstack([points[i], middle, points[j]])
        first, last = i, j
        middle_one = len(path) // 2  # on the conic; its neighbours give the tangent there
        probe, way = path[middle_one], path[middle_one + 1] - path[middle_one - 1]
        left = np.array([-way[1], way[0]])
        near = probe + 1e-3 * left
        if not bool(proud(near[:1], near[1:])[0]):
            path, first, last = path[::-1], last, first
        chains.append(Chain(path, ("rim", first), ("rim", last)))
    return chains


def _arcs(zone: Floats, conic: Floats, points: Floats) -> list[tuple[int, int, Floats]]:
    """Pairs of rim points (n, 2) that the conic joins inside the zone: (i, j, intermediate points).

    Each line of the pencil through one point of a conic intersects it once more. The line's direction orders
    the conic's points, through infinity too, for any kind of conic.
    """
    scale = float(np.abs(points).max())
    unit = np.diag([scale, scale, 1.0])
    normalised = unit @ conic @ unit
    size = float(np.abs(normalised).max())
    if abs(float(np.linalg.det(normalised))) < 1e-10 * size**3:
        return _straight_arcs(zone, normalised / size, points / scale, scale)
    root, centre = _to_circle(conic)
    if root is None or centre is None:
        root, centre = np.eye(2) * scale, np.zeros(2)
    to_frame = np.linalg.inv(root)
    frame = np.vstack([np.column_stack([root, centre]), [0.0, 0.0, 1.0]])
    form = frame.T @ conic @ frame
    local = (points - centre) @ to_frame.T
    pole = np.append(local[0], 1.0)
    tangent = form @ pole
    base = float(np.arctan2(-tangent[0], tangent[1]))
    angle = np.mod(np.arctan2(local[1:, 1] - local[0, 1], local[1:, 0] - local[0, 0]) - base, np.pi)
    order = np.argsort(angle)
    stops = [(0.0, 0), *((float(angle[i]), int(i) + 1) for i in order), (np.pi, 0)]
    arcs = []
    for (low, i), (high, j) in zip(stops[:-1], stops[1:]):
        count = max(2, 2 * int(np.ceil((high - low) / (0.25 * np.pi))))
        inner = base + low + (high - low) * np.arange(1, count) / count
        direction = np.stack([np.cos(inner), np.sin(inner), np.zeros_like(inner)], axis=-1)
        reach = -2.0 * (direction @ tangent) / np.einsum("ki,ij,kj->k", direction, form, direction)
        path = (local[0] + reach[:, None] * direction[:, :2]) @ root.T + centre
        if within(zone, path[:, 0], path[:, 1], open_rim=True).all():
            arcs.append((i, j, path))
    return arcs


def _straight_arcs(
    zone: Floats, conic: Floats, points: Floats, scale: float
) -> list[tuple[int, int, Floats]]:
    """Rim made of straight lines (a cylinder lens cut parallel to its axis)."""
    arcs = []
    for i in range(len(points)):
        for j in range(i + 1, len(points)):
            middle = 0.5 * (points[i] + points[j])
            on_conic = abs(float(np.append(middle, 1.0) @ conic @ np.append(middle, 1.0))) < 1e-9
            if on_conic and within(zone, middle[0] * scale, middle[1] * scale, open_rim=True):
                arcs.append((i, j, middle[None] * scale))
    return arcs


def walk(runs: list[tuple[Run, ...]], chains: list[Chain], kind: Kind) -> list[Region]:
    """Close the loops of one kind: stretches of sides and rims, each starting at the end of the last one."""
    leaving: dict[tuple[str, int], tuple[tuple[str, int, int], tuple[str, int]]] = {}
    for k, side in enumerate(runs):
        for r, run in enumerate(side):
            if run.kind == kind:
                leaving[run.first] = (("run", k, r), run.last)
    for c, chain in enumerate(chains):
        assert chain.first is not None
        assert chain.last is not None
        if kind == "lens":
            leaving[chain.first] = (("rim", c, 1), chain.last)
        else:
            leaving[chain.last] = (("rim", c, -1), chain.first)
    regions = []
    while leaving:
        start = next(iter(leaving))
        here, loop = start, []
        while True:
            if here not in leaving:
                raise CannotBuild(
                    "CL130",
                    "the lens ends inside its optical zone other than at a plane rim; a longer radius or less"
                    " tilt",
                )
            item, here = leaving.pop(here)
            loop.append(item)
            if here == start:
                break
        regions.append(Region(kind, (tuple(loop),)))
    return regions


def encloses(points: Floats, place: Floats) -> bool:
    """Whether a polygon (n, 2) encloses a point (2,)."""
    x, y = points[:, 0] - place[0], points[:, 1] - place[1]
    x2, y2 = np.roll(x, -1), np.roll(y, -1)
    crosses = (y > 0.0) != (y2 > 0.0)
    run = np.where(crosses, y2 - y, 1.0)
    return bool(np.count_nonzero(crosses & (x - y * (x2 - x) / run > 0.0)) % 2)
