"""Build a body's cell complex from its window.

Nodes, where the corners of three or four cells meet, and their saddles.

Rims: the curves inside a cell where a lens ends at the other lens, at a plane or at land.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.arrays import unique_rows
from clacad.base.sign_changes import bisect
from clacad.base.types import Bools, Floats, Ints
from clacad.sheet.grid_steps import one_tiling
from clacad.sheet.pattern import node_cells
from clacad.sheet.pieces_and_holes import count_together
from clacad.topology.borders import column_line, make_border
from clacad.topology.complex_parts import SIDES, CellComplex, Node, Side, Tiling, linked

if TYPE_CHECKING:
    from clacad.sheet.window import Body, Window


def make_nodes(
    window: Window, body: Body, array: int, faces: tuple[Side, ...], merge: float
) -> tuple[Node, ...]:
    """Build the node classes of a body's tiling on `array`; `faces`: those repeating on it.

    `merge`: a length.
    """
    tile = window.lattice_of(array).tile()
    zone = window.land.seam == 0.0
    nodes = []
    for cells in node_cells(window.lattice):
        heights = np.full((2, len(cells)), np.nan)
        for n, (_, corner) in enumerate(cells):
            x, y = tile[corner]
            line = column_line(body, (x, y), (x, y), zone)
            heights[:, n] = line.evaluate(np.zeros(1))[0][:, 0]
        raw = [heights[f] if name in faces else np.full(len(cells), np.nan) for f, name in enumerate(SIDES)]
        front, back = cluster(np.concatenate(raw), merge).reshape(2, -1)
        nodes.append(Node(cells, _saddle(front, proud=-1), _saddle(back, proud=1)))
    return tuple(nodes)


def cluster(heights: Floats, merge: float) -> Floats:
    """Single linkage: sorted heights whose gaps are at most `merge` all become the middle of their cluster.

    Two heights closer than `merge` therefore always agree afterwards, and the order never changes.
    NaN stays NaN.
    """
    out = np.array(heights, dtype=np.float64)
    known = np.flatnonzero(np.isfinite(out))
    if known.size == 0:
        return out
    order = known[np.argsort(out[known], kind="stable")]
    z = out[order]
    group = linked(z, merge)
    first = np.searchsorted(group, group, side="left")
    last = np.searchsorted(group, group, side="right") - 1
    # the middle, written so that a cluster of identical heights keeps its exact value
    out[order] = z[first] + 0.5 * (z[last] - z[first])
    return out


def _saddle(level: Floats, proud: int) -> bool:
    """Whether both cells of one diagonal are higher than both cells of the other."""
    if len(level) != 4 or np.isnan(level).any():
        return False
    z = proud * level
    return bool(min(z[0], z[2]) > max(z[1], z[3]) or min(z[1], z[3]) > max(z[0], z[2]))


@lru_cache(maxsize=16)  # windows and bodies are immutable: every grid of a sheet shares its complex
def cell_complex(
    window: Window, body: Body, merge: float | None = None, spacing: float | None = None
) -> CellComplex:
    """Build the one topology of a body that mesh and B-Rep share.

    body : One of `window.bodies`.
    merge : length, optional. Heights at a node or border that differ by less are merged. Default 1 nm (1e-6
        mm, ten times the uncertainty stated in a STEP file), at most 1e-3 of the pitch.
    spacing : length, optional
        Crossings closer than that to a node or to one another are dropped. Default: `merge`.
    Raises ValueError: The body's two faces repeat on displaced arrays but the window has no outline; or an
        outline is requested for a face without land.
    """
    if merge is None:
        merge = min(1e-9 / window.unit, 1e-3 * min(window.lattice.pitch))
    spacing = merge if spacing is None else spacing
    arrays = one_tiling(window, body)
    if len(arrays) == 2 and window.outline is None:
        raise ValueError(
            f"body {body.name!r} has its faces on arrays displaced by {window.shifts[1]}, so their cells have"
            " no common footprint; the window needs an outline (body.border or lattice.outline)"
        )
    columnar = len(arrays) == 1
    tilings = tuple(_make_tiling(window, body, array, columnar, merge, spacing) for array in arrays)
    return CellComplex(window, body, merge, tilings)


def _make_tiling(
    window: Window, body: Body, array: int, columnar: bool, merge: float, spacing: float
) -> Tiling:
    """The complex of the faces that repeat on one array; `columnar`: it cuts the whole body into columns."""
    names = tuple(
        name
        for name, face in zip(SIDES, (body.front, body.back))
        if (face.array is not None if columnar else face.array == array)
    )
    borders = tuple(
        make_border(window, body, array, columnar, k, merge, spacing)
        for k in range(len(window.lattice.steps) // 2)
    )
    nodes = make_nodes(window, body, array, names, merge)
    tile = window.lattice_of(array).tile()
    return Tiling(array, window.shifts[array], tile, borders, nodes)


def saddle_count(cells: CellComplex) -> int:
    """Count the inner nodes' saddles (front and back each count)."""
    total = 0
    for node in (node for tiling in cells.tilings for node in tiling.nodes):
        each = int(node.saddle_front) + int(node.saddle_back)
        total += each * count_together(cells.window.lattice, [step for step, _ in node.cells]) if each else 0
    return total


FAN = 24
"""Default number of rings of the grid on which a rim is searched."""

Gap = Callable[[Floats, Floats], Floats]
"""Height of one surface over another at x, y (n,): positive on the side of the lens, zero on the rim."""


@dataclass(frozen=True, slots=True, eq=False)
class TracedCurve:
    """A connected stretch of a rim inside one cell.

    points : (n, 2) lengths
        Points on the curve in the cell frame, in order, the lens on the left hand; exact to rounding.
    closed : A loop inside the cell (its last point is its first); otherwise it runs from side to side.
    """

    points: Floats
    closed: bool


def trace_zero(function: Gap, polygon: Floats, fan: int = FAN) -> tuple[TracedCurve, ...]:
    """Trace the zero curves of a function inside a convex polygon.

    The polygon is triangulated as `fan`² triangles about its centre per side. Curves that dip between two
    neighbouring inner grid points are missed. On the polygon's own sides none is missed if the caller
    passes their roots to the mesh.

    polygon : (m, 2) lengths. Corners, counter-clockwise.
    Returns: The region where the function is positive lies on the left hand.
    """
    points, triangles = _fan_grid(polygon, fan)
    positive = function(points[:, 0], points[:, 1]) > 0.0
    if positive.all() or not positive.any():
        return ()
    edges = np.sort(
        np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1
    )
    edges, inverse = unique_rows(edges)
    roots = _edge_roots(function, points, edges, positive)
    follows = _following_edges(triangles, inverse.reshape(3, -1).T, positive)
    return tuple(TracedCurve(roots[np.asarray(chain)], closed) for chain, closed in _chains(follows))


def _edge_roots(function: Gap, points: Floats, edges: Ints, positive: Bools) -> Floats:
    """Root of the function on every edge whose ends differ in sign, (edges, 2); NaN on the others."""
    cut = positive[edges[:, 0]] != positive[edges[:, 1]]
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    inside = np.where(positive[edges[:, 0]][:, None], a, b)[cut]
    outside = np.where(positive[edges[:, 0]][:, None], b, a)[cut]

    def along(t: Floats) -> Floats:
        p = inside + t[:, None] * (outside - inside)
        return np.where(function(p[:, 0], p[:, 1]) > 0.0, 1.0, -1.0)

    count = int(cut.sum())
    t = bisect(along, np.zeros(count), np.ones(count))
    root = np.full((len(edges), 2), np.nan)
    root[cut] = inside + t[:, None] * (outside - inside)
    return root


def _following_edges(triangles: Ints, number: Ints, positive: Bools) -> dict[int, int]:
    """Edge by which the curve enters a triangle → edge by which it leaves; `number` (t, 3): edge numbers."""
    follows: dict[int, int] = {}
    for corner, edge in zip(triangles, number):
        sign = positive[corner]
        if sign.all() or not sign.any():
            continue
        lone = int(np.flatnonzero(sign == (sign.sum() == 1))[0])
        leaving, entering = int(edge[lone]), int(edge[(lone + 2) % 3])
        # positive on the left hand: around a single positive corner the curve runs from the edge after it
        first, second = (leaving, entering) if sign[lone] else (entering, leaving)
        follows[first] = second
    return follows


def _fan_grid(polygon: Floats, n: int) -> tuple[Floats, Ints]:
    """Triangulate a convex polygon about its centre, n rings, (points, triangles)."""
    m = len(polygon)
    points = [np.zeros((1, 2))]
    start = [0]
    for ring in range(1, n + 1):
        start.append(1 + m * ring * (ring - 1) // 2)
        f = np.arange(ring)[:, None] / ring
        for k in range(m):
            a, b = polygon[k], polygon[(k + 1) % m]
            points.append((ring / n) * (a * (1 - f) + b * f))
    triangles = []
    for ring in range(1, n + 1):
        inner, outer = max(m * (ring - 1), 1), m * ring
        for k in range(m):
            for s in range(ring):
                o0, o1 = start[ring] + k * ring + s, start[ring] + (k * ring + s + 1) % outer
                i0 = start[ring - 1] + (k * (ring - 1) + s) % inner if ring > 1 else 0
                triangles.append((o0, o1, i0))
                if s:
                    before = start[ring - 1] + (k * (ring - 1) + s - 1) % inner
                    triangles.append((o0, i0, before))
    return np.concatenate(points), np.asarray(triangles)


def _chains(follows: dict[int, int]) -> list[tuple[list[int], bool]]:
    """Link directed segments to maximal chains: (edge numbers, closed)."""
    chains: list[tuple[list[int], bool]] = []
    starts = sorted(set(follows) - set(follows.values()))
    left = dict(follows)
    for first in starts + sorted(follows):
        if first not in left:
            continue
        chain = [first]
        while chain[-1] in left:
            chain.append(left.pop(chain[-1]))
            if chain[-1] == first:
                break
        chains.append((chain, chain[-1] == first))
    return chains
