"""Tie heights on one vertical line to vertices, and walls to its vertical edges. Lengths in mm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clacad.base.types import Floats
from clacad.topology.wall_strips import linked, runs_round


@dataclass(frozen=True, eq=False, slots=True)
class Levels:
    """Vertices on one vertical line.

    Attributes
    ----------
    z : tuple of float, mm
        Ascending.
    shift : tuple of float, mm
        Largest distance of the heights that share a vertex from it.
    place : place[sector][face] = number of the vertex, or None (no height, or open)
    copies : for each gap between consecutive vertices: ray → copy
        Ray r lies between sector r and sector r + 1. Walls on rays with the same copy share one vertical edge; two
        copies are a saddle: columns that touch in a line.
    """

    z: tuple[float, ...]
    shift: tuple[float, ...]
    place: tuple[tuple[int | None, int | None], ...]
    copies: tuple[dict[int, int], ...]

    @property
    def saddles(self) -> int:
        """Number of vertical edges at which four walls meet."""
        double = [len(set(copies.values())) > 1 for copies in self.copies]
        return sum(now and not before for before, now in zip([False, *double], double))


def linked_levels(heights: Floats, merge: float) -> Levels:
    """Tie the heights at a node to vertices.

    Parameters
    ----------
    heights : (k, 2), mm
        Front and back height of the k sectors around the node, counter-clockwise; NaN: no column; ±inf: open.
    merge : float, mm
        Single linkage: heights whose gaps are below it share a vertex, in the middle of their cluster.
    """
    known = sorted((float(z), s, f) for (s, f), z in np.ndenumerate(heights) if np.isfinite(z))
    group = linked(np.array([item[0] for item in known]), merge).tolist()
    clusters = [
        [item for item, of in zip(known, group) if of == n] for n in range(max(group, default=-1) + 1)
    ]
    z = tuple(0.5 * (cluster[0][0] + cluster[-1][0]) for cluster in clusters)
    shift = tuple(0.5 * (cluster[-1][0] - cluster[0][0]) for cluster in clusters)
    number = {(s, f): n for n, cluster in enumerate(clusters) for _, s, f in cluster}
    place = tuple((number.get((s, 0)), number.get((s, 1))) for s in range(len(heights)))
    copies = tuple(_copies(heights, place, n, len(z)) for n in range(len(z) - 1))
    return Levels(z, shift, place, copies)


def _copies(
    heights: Floats, place: Sequence[tuple[int | None, int | None]], n: int, count: int
) -> dict[int, int]:
    """Pair the walls around a node in the gap above vertex n; walls of one solid stretch share an edge."""
    solid = []
    for sector, (front, back) in enumerate(place):
        low = -1 if front is None and heights[sector, 0] == -np.inf else front
        high = count if back is None and heights[sector, 1] == np.inf else back
        solid.append(low is not None and high is not None and low <= n < high)
    if all(solid):
        return {}
    runs = runs_round(solid)
    return {
        ray: max(runs[ray], runs[(ray + 1) % len(solid)])
        for ray in range(len(solid))
        if solid[ray] != solid[(ray + 1) % len(solid)]
    }
