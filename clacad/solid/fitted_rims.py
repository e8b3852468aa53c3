"""Fitted rims: Bézier curves where two surfaces intersect in no plane, so that no closed form exists.

The rim is the zero curve of a gap between two graphs over the sheet: a lens and its land, a lens and the
plane behind it, the two lenses of a body. It is traced by bisection (`clacad.topology.build_complex`) and
divided into arcs. Each arc is a polynomial Bézier curve through exact points of the rim, of the least degree
within the tolerance. Its distance from the true rim is measured and stated. Lengths in mm, cell frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clacad.base.polygons import within
from clacad.base.sign_changes import sign_changes
from clacad.base.types import Floats
from clacad.sheet.window import Face, lens_height_and_normal
from clacad.solid.face_pattern import SNAP, Kind, Pattern, Proud
from clacad.solid.outline_path import cut_pattern
from clacad.solid.rational_conics import Arc, bernstein
from clacad.topology.build_complex import trace_zero
from clacad.topology.complex_parts import CannotBuild

Graph = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""Heights (n,) and slopes (n, 2) over points x, y (n,); NaN where there is no surface."""

FANS = (24, 48, 96, 192)
"""Grids on which the rim is searched; a finer one is used where a rim's ends disagree with the zone's sides.
"""

TURN = 1.1
"""Largest turn of one arc (rad) before any is halved."""

DEGREES = range(3, 15)
"""Degrees that are tried for an arc."""

DEPTH = 7
"""Largest number of halvings of an arc whose highest degree misses the tolerance."""

SLACK = 1e-7
"""Largest error (mm) of a fitted rim that is stated rather than refused: CAD programs merge closer points."""

_NEWTON = 12
_NODES = 0.5 - 0.5 * np.cos(np.pi * np.arange(41) / 40)
_BETWEEN = 0.5 - 0.5 * np.cos(np.pi * (np.arange(40) + 0.5) / 40)


@dataclass(frozen=True, eq=False)
class Gap:
    """Height of one graph above another (mm): positive on the side of the lens, zero on the rim.

    `within`: where the lens exists; elsewhere the gap counts as closed.
    """

    lower: Graph
    upper: Graph
    within: Proud | None = None

    def value(self, x: Floats, y: Floats) -> Floats:
        """Height of the gap (n,), NaN where a surface is missing."""
        gap = np.asarray(self.upper(x, y)[0] - self.lower(x, y)[0])
        return gap if self.within is None else np.where((gap > 0.0) & ~self.within(x, y), -gap, gap)

    def at(self, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        """Height (n,) and gradient (n, 2) of the gap, and the mean height (n,) of both graphs."""
        (low, low_slope), (high, high_slope) = self.lower(x, y), self.upper(x, y)
        return np.asarray(high - low), np.asarray(high_slope - low_slope), np.asarray(0.5 * (low + high))

    def proud(self, x: Floats, y: Floats) -> NDArray[np.bool_]:
        """Whether the lens is present (n,)."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.value(x, y) > 0.0)

    def rounding(self, points: Floats) -> float:
        """Rounding level of the gap near points (n, 2): a few ulps of the heights."""
        z = np.concatenate([graph(points[:, 0], points[:, 1])[0] for graph in (self.lower, self.upper)])
        return 8.0 * float(np.finfo(np.float64).eps) * float(np.nanmax(np.abs(z), initial=1e-300))


@dataclass(frozen=True, eq=False)
class Rim:
    """Rim of a lens: the division of its zone, the arcs (3-D, mm) of every chain, their largest error (mm).

    `error` is 0 where the arcs are exact plane sections.
    """

    pattern: Pattern
    arcs: tuple[tuple[Arc, ...], ...]
    error: float = 0.0


def lens_graph(face: Face) -> Graph:
    """The graph of a lens face with any surface."""

    def graph(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        z, normal = lens_height_and_normal(face, x, y)
        with np.errstate(invalid="ignore"):
            return z, -normal[..., :2] / normal[..., 2:]

    return graph


def level_graph(level: float) -> Graph:
    """The graph of a plane at a height (mm)."""

    def graph(x: Floats, y: Floats) -> tuple[Floats, Floats]:
        return np.full(np.shape(x), level), np.zeros((*np.shape(x), 2))

    return graph


def fitted_rim(gap: Gap, zone: Floats, rest: Kind, tolerance: float) -> Rim:
    """Divide a zone at the zero curve of a gap, and fit the rim.

    zone : (m, 2), mm. Corners, counter-clockwise, convex.
    rest : "land" or "none". Kind of the face where the lens is not.
    tolerance : mm. Distance of the fitted arcs from the true rim.
    Returns: The arcs lie at the mean height of the two graphs, which are equal on the rim.
    Raises CannotBuild: CL130: the lens ends at its own equator, before it intersects the other surface.
        CL132: no curve comes within `SLACK` of the rim: it turns too sharply, or the surfaces intersect at
        too small an angle.
    """
    noise = gap.rounding(zone)
    roots = [_side_roots(gap, zone, k, noise) for k in range(len(zone))]
    blunt: CannotBuild | None = None
    for fan in FANS:
        found = _traced(gap, zone, roots, rest, fan, noise)
        if found is None or (fan < FANS[-1] and _hidden(gap, zone, found[0])):
            continue
        try:
            return _with_arcs(gap, *found, tolerance, noise)
        except CannotBuild as error:  # too sharp for the points of this grid
            blunt = error
    raise blunt or CannotBuild(
        "CL130",
        "the lens ends inside its optical zone other than where it meets the other surface; a longer radius"
        " or less tilt",
    )


def _with_arcs(gap: Gap, pattern: Pattern, paths: list[Floats], tolerance: float, noise: float) -> Rim:
    """Fit the arcs of every chain of a pattern."""
    arcs, error = [], 0.0
    for chain, path in zip(pattern.chains, paths, strict=True):
        _on_the_rim(gap, path, noise)
        _along_the_rim(gap, path)
        made, off = _chain_arcs(gap, path, chain.first is None, tolerance, noise)
        arcs.append(made)
        error = max(error, off)
    return Rim(pattern, tuple(arcs), error)


def _hidden(gap: Gap, zone: Floats, pattern: Pattern) -> bool:
    """Whether a lens rises above its land between grid points at which it does not."""
    if any(region.kind == "lens" for region in pattern.regions):
        return False
    low, high = zone.min(axis=0), zone.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    largest = -np.inf
    for _ in range(8):
        step = np.linspace(-1.0, 1.0, 17)
        x, y = (grid.ravel() for grid in np.meshgrid(middle[0] + half[0] * step, middle[1] + half[1] * step))
        value = np.where(within(zone, x, y, open_rim=True), gap.value(x, y), np.nan)
        if np.isnan(value).all():
            break
        best = int(np.nanargmax(value))
        largest = max(largest, float(value[best]))
        middle, half = np.array([x[best], y[best]]), 0.25 * half
    return largest > SNAP


def _side_roots(gap: Gap, zone: Floats, k: int, noise: float) -> list[float]:
    a, b = zone[k], zone[(k + 1) % len(zone)]

    def along(t: Floats) -> Floats:
        p = a + np.asarray(t)[:, None] * (b - a)
        return gap.value(p[:, 0], p[:, 1])

    return [float(t) for t in sign_changes(along, noise)]


def _traced(
    gap: Gap, zone: Floats, roots: list[list[float]], rest: Kind, fan: int, noise: float
) -> tuple[Pattern, list[Floats]] | None:
    """The pattern found with a grid, with the points of every chain; None where chains and sides disagree."""
    found = trace_zero(lambda x, y: gap.value(x, y) + noise, zone, fan)
    open_paths = [curve.points for curve in found if not curve.closed]
    closed = [curve.points[:-1] for curve in found if curve.closed]
    return cut_pattern(zone, roots, gap.proud, rest, open_paths, closed, fan)


def _on_the_rim(gap: Gap, path: Floats, noise: float) -> None:
    """Refuse a chain on which the gap jumps instead of closing: the lens ended at its equator."""
    value, slope, _ = gap.at(path[1:-1, 0], path[1:-1, 1])
    span = float(np.ptp(path, axis=0).max())
    with np.errstate(invalid="ignore"):
        closes = np.abs(value) <= 100.0 * noise + 1e-9 * span * np.linalg.norm(slope, axis=-1)
        steep = np.linalg.norm(slope, axis=-1) > 1e3
    if not (closes & ~steep).all():
        raise CannotBuild(
            "CL130",
            "the lens ends inside its cell at its own equator, before it meets the other face or its land; a"
            " longer radius (pair.separation), a smaller lattice.pitch, less tilt, or a thicker pair.web",
        )


def _along_the_rim(gap: Gap, path: Floats) -> None:
    """Refuse a chain that jumps from one branch of the rim to another, with no grid point between them."""
    chord = np.diff(path, axis=0)
    length = np.hypot(*chord.T)
    _, slope, _ = gap.at(path[:, 0], path[:, 1])
    along = np.column_stack([slope[:, 1], -slope[:, 0]]) / np.linalg.norm(slope, axis=1)[:, None]
    least = np.minimum(np.sum(chord * along[:-1], axis=1), np.sum(chord * along[1:], axis=1))
    if ((length > 10.0 * SNAP) & (least < 0.3 * length)).any():
        raise CannotBuild("CL132", _SHARP)


_SHARP = (
    "the rim of the lens turns too sharply, or meets the other surface at too small an angle, for an edge of "
    f"degree {DEGREES[-1]}; a little more or less thickness (pair.thickness) or web (pair.web) moves it"
)


# -- arcs -------------------------------------------------------------------------------------------


def _chain_arcs(
    gap: Gap, path: Floats, closed: bool, tolerance: float, noise: float
) -> tuple[tuple[Arc, ...], float]:
    """Arcs along a chain of exact points (n, 2), and their largest error."""
    points = np.vstack([path, path[:1]]) if closed else path
    at = _divisions(gap, points, closed)
    arcs: list[Arc] = []
    worst = 0.0
    for i, j in zip(at[:-1], at[1:]):
        made, error = _fitted(gap, points[i : j + 1], tolerance, noise, 0)
        arcs += made
        worst = max(worst, error)
    return tuple(arcs), worst


def _divisions(gap: Gap, points: Floats, closed: bool) -> list[int]:
    """Indices of the points at which a chain is divided: about equal turns, at most `TURN` each."""
    if len(points) == 2:
        return [0, 1]
    _, slope, _ = gap.at(points[:, 0], points[:, 1])
    angle = np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(angle)))])
    measure = turned + 0.25 * length / length[-1]
    count = max(4 if closed else 1, int(np.ceil(float(measure[-1]) / TURN)))
    wanted = measure[-1] * np.arange(1, count) / count
    inner = [int(np.argmin(np.abs(measure - value))) for value in wanted]
    kept = [0]
    for i in inner:
        if (
            i > kept[-1]
            and length[i] - length[kept[-1]] > 10.0 * SNAP
            and length[-1] - length[i] > 10.0 * SNAP
        ):
            kept.append(i)
    return [*kept, len(points) - 1]


def _fitted(gap: Gap, path: Floats, tolerance: float, noise: float, depth: int) -> tuple[list[Arc], float]:
    """One arc between the ends of a path of exact points (n, 2), or several if one misses the tolerance."""
    start, end = path[0], path[-1]
    best: tuple[Arc, float] | None = None
    middle = path[len(path) // 2] if len(path) > 2 else None
    if float(np.hypot(*(end - start))) > SNAP:
        pencil = _Pencil(gap, start, end)
        true, closes = pencil.points(_NODES)
        if closes:
            reach = max(tolerance, 4.0 * noise / pencil.least_slope)
            arc, error = _least_degree(true, reach)
            best = arc, max(error, _distance(arc, pencil))
            if best[1] <= reach:
                return [arc], best[1]
            middle = true[len(_NODES) // 2, :2] if middle is None else middle
    if middle is not None and depth < DEPTH and float(np.hypot(*(end - start))) > 20.0 * SNAP:
        halves = (
            (path[: len(path) // 2 + 1], path[len(path) // 2 :])
            if len(path) > 2
            else (np.array([start, middle]), np.array([middle, end]))
        )
        first, low = _fitted(gap, halves[0], tolerance, noise, depth + 1)
        second, high = _fitted(gap, halves[1], tolerance, noise, depth + 1)
        return [*first, *second], max(low, high)
    if best is None or best[1] > SLACK:
        raise CannotBuild("CL132", _SHARP)
    return [best[0]], best[1]


def _least_degree(true: Floats, reach: float) -> tuple[Arc, float]:
    """The least-degree curve within `reach` of rim points (n, 3) at `_NODES`, ends exact.

    The second result is its largest distance from them.
    """
    for degree in DEGREES:
        basis = bernstein(degree, _NODES)
        bare = true - basis[:, :1] * true[0] - basis[:, -1:] * true[-1]
        # Chebyshev's points and these weights make least squares nearly the best uniform fit
        weight = 1.0 / np.sqrt(0.02 + _NODES * (1.0 - _NODES))[:, None]
        inner = np.linalg.lstsq(basis[:, 1:-1] * weight, bare * weight, rcond=None)[0]
        if np.ptp(true[:, 2]) == 0.0:
            inner[:, 2] = true[0, 2]
        arc = Arc(np.vstack([true[:1], inner, true[-1:]]), np.ones(degree + 1))
        error = float(np.linalg.norm(arc.at(_NODES) - true, axis=1).max())
        if error <= 0.7 * reach:
            break
    return arc, error


def _distance(arc: Arc, pencil: _Pencil) -> float:
    """Largest distance of a curve from the rim, at parameters not used in the fit."""
    true, closes = pencil.points(_BETWEEN)
    return np.inf if not closes else float(np.linalg.norm(arc.at(_BETWEEN) - true, axis=1).max())


class _Pencil:
    """Points of a rim between two of its points, found along rays that turn with the rim's normal.

    Equal steps of parameter t are equal shares of the turn, so that x(t), y(t) are smooth: cosines on a
    circle.
    """

    def __init__(self, gap: Gap, start: Floats, end: Floats) -> None:
        self._gap, self._ends = gap, np.array([start, end])
        chord = end - start
        self._half = 0.5 * float(np.hypot(*chord))
        self._along = chord / (2.0 * self._half)
        self._left = np.array([-self._along[1], self._along[0]])
        _, slope, _ = gap.at(*self._ends.T)
        (x0, y0), (x1, y1) = slope
        self._turn = float(np.arctan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1))
        self.least_slope = float(np.linalg.norm(slope, axis=1).min())

    def _base(self, t: Floats) -> tuple[Floats, Floats]:
        """Points (n, 2) of the circular arc through both ends with the rim's turn, and its left normals."""
        half = 0.5 * self._turn
        angle = (t - 0.5) * self._turn
        if abs(half) < 1e-6:
            along, across = self._half * 2.0 * t, np.zeros_like(t)
        else:
            along = self._half * (1.0 + np.sin(angle) / np.sin(half))
            across = self._half * (np.cos(half) - np.cos(angle)) / np.sin(half)
        normal = np.cos(angle)[:, None] * self._left - np.sin(angle)[:, None] * self._along
        return self._ends[0] + along[:, None] * self._along + across[:, None] * self._left, normal

    def points(self, t: Floats) -> tuple[Floats, bool]:
        """Rim points (n, 3) at parameters t, and whether every one was found."""
        base, normal = self._base(t)
        h = np.zeros(len(t))
        for _ in range(_NEWTON):
            p = base + h[:, None] * normal
            value, slope, z = self._gap.at(p[:, 0], p[:, 1])
            with np.errstate(invalid="ignore", divide="ignore"):
                step = value / np.sum(slope * normal, axis=1)
            if not np.isfinite(step).all():
                return np.empty((0, 3)), False
            step = np.clip(step, -0.25 * self._half, 0.25 * self._half)
            h = h - step
            if np.abs(step).max() <= 1e-12 * self._half:
                break
        self.least_slope = min(self.least_slope, float(np.linalg.norm(slope, axis=1).min()))
        settled = float(np.abs(step).max()) <= 1e-9 * self._half
        xy = base + h[:, None] * normal
        xy[t == 0.0], xy[t == 1.0] = self._ends
        return np.column_stack([xy, z]), settled
