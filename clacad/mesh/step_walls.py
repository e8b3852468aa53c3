"""Walls: height ranges that one column covers and its neighbour does not, over each edge of the footprint.

At a point of the footprint, the wedges around it are columns (front level, back level). Walls meet
there in vertical edges between consecutive levels. Where more than one column touches along such an
edge (a saddle), every column but the first gets its own vertices in between: no edge is used by
four faces and no point of the surface moves.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

from clacad.topology.complex_parts import BorderCurve, runs_round, solid_strips

Column = tuple[int, int] | None  # front and back level; None: no material
Vertex = tuple[int, int]  # point of the footprint, level


class Ring:
    """The columns around one point of the footprint, counter-clockwise.

    Parameters
    ----------
    wedges : sequence of (tag, column)
        Tags name the wedges; two walls of different cells agree on them.
    """

    __slots__ = ("columns", "levels", "place")

    def __init__(self, wedges: Sequence[tuple[Hashable, Column]]) -> None:
        self.place = {tag: n for n, (tag, _) in enumerate(wedges)}
        self.columns = [column for _, column in wedges]
        self.levels = sorted({level for column in self.columns if column is not None for level in column})

    def chain(self, low: int, high: int, wedge: Hashable) -> list[int]:
        """Levels from `low` to `high` where the vertical edge of a wall has vertices, ends included.

        `wedge` is the tag of the wedge whose column the wall bounds.
        """
        stops = [low, *(level for level in self.levels if low < level < high), high]
        out = [low]
        for a, b in zip(stops[:-1], stops[1:]):
            run = self._run(a, b, self.place[wedge])
            if run > 0:  # own vertices: a different inner level for each further column
                out.append(a + (b - a) // 2 if run == 1 else a + (b - a) // (run + 1))
            out.append(b)
        return out

    def _run(self, a: int, b: int, at: int) -> int:
        """Number of the run of neighbouring wedges that cover [a, b] and contain wedge `at`; first run is
        0.
        """
        return runs_round([c is not None and c[0] <= a and c[1] >= b for c in self.columns])[at]


def strip(
    p: int,
    q: int,
    left: tuple[Column, Column],
    right: tuple[Column, Column],
    tags: tuple[Hashable, Hashable],
    rings: tuple[Ring, Ring],
) -> list[tuple[Vertex, Vertex, Vertex]]:
    """Wall triangles over the footprint edge p → q.

    Parameters
    ----------
    p, q : int
        Points of the footprint; the left column lies on the left of p → q.
    left, right : (column at p, column at q)
    tags : (left, right)
        The wedges' tags in both rings.
    rings : (ring at p, ring at q)

    Returns
    -------
    list of triangles of vertices (point, level), outward.
    """
    lines = _lines(left, right)
    triangles: list[tuple[Vertex, Vertex, Vertex]] = []
    for below, above, solid in zip(lines[:-1], lines[1:], solid_strips([line[2]] for line in lines)):
        if solid[0] == solid[1] or below[:2] == above[:2]:
            continue
        if below[0] > above[0] or below[1] > above[1]:
            raise ValueError(
                f"two heights cross inside the edge {p}–{q} of the footprint: a crossing was missed"
            )
        tag = tags[0] if solid[0] else tags[1]
        first, second = (
            [(point, z) for z in (ring.chain(low, high, tag) if low < high else [low])]
            for point, ring, low, high in zip((p, q), rings, below[:2], above[:2])
        )
        faces = zipper(
            first, second
        )  # seen from the right hand of p → q, p on the left: outward of the left column
        triangles += faces if solid[0] else [(a, c, b) for a, b, c in faces]
    return triangles


def _lines(left: tuple[Column, Column], right: tuple[Column, Column]) -> list[tuple[int, int, BorderCurve]]:
    """Fronts and backs of both columns, ascending: level at p, level at q, column and face of each."""
    lines = []
    for which, (at_p, at_q) in enumerate((left, right)):
        # a column without thickness (two faces meeting along the edge) does not divide the other's wall
        if at_p is not None and at_q is not None and (at_p[0] != at_p[1] or at_q[0] != at_q[1]):
            lines += [(at_p[face], at_q[face], BorderCurve(which, face == 0)) for face in (0, 1)]
    return sorted(lines, key=lambda line: (line[0] + line[1], not line[2].opens))


def zipper(first: list[Vertex], second: list[Vertex]) -> list[tuple[Vertex, Vertex, Vertex]]:
    """Triangulate the strip between two upward chains; counter-clockwise with `first` on the left."""
    triangles = []
    i = j = 0
    while i < len(first) - 1 or j < len(second) - 1:
        if j == len(second) - 1 or (i < len(first) - 1 and first[i + 1][1] <= second[j + 1][1]):
            triangles.append((first[i], second[j], first[i + 1]))
            i += 1
        else:
            triangles.append((first[i], second[j], second[j + 1]))
            j += 1
    return triangles
