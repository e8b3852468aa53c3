"""Triangles of the land ring and of the wall along the window's outline."""

from __future__ import annotations

import numpy as np

from clacad.mesh.body_mesh import Plain, no_plain
from clacad.mesh.cell_template import BACK_LAND, FRONT_LAND, WALL
from clacad.mesh.land_ring import Key, LandRing, make_land
from clacad.mesh.tiled import Tiled
from clacad.sheet.plate import Plate
from clacad.sheet.window import Window

Vertex = tuple[int, int, int, int]  # owner cell, point, level


class _Builder:
    """Collects triangles of keyed vertices."""

    def __init__(self, step: float) -> None:
        self.step = step
        self.number: dict[Vertex, int] = {}
        self.position: list[tuple[float, float, float]] = []
        self.triangles: list[tuple[int, int, int]] = []
        self.kind: list[int] = []

    def vertex(self, key: Key, level: int, xy: tuple[float, float]) -> int:
        """Number of the vertex of a footprint point at a level."""
        full = (*key, level)
        if full not in self.number:
            self.number[full] = len(self.position)
            self.position.append((*xy, level * self.step))
        return self.number[full]

    def done(self) -> Plain:
        """Return the arrays."""
        if not self.triangles:
            return no_plain()
        return Plain(
            np.array(self.position),
            np.array(list(self.number), dtype=np.int64),
            np.array(self.triangles, dtype=np.int64),
            np.array(self.kind, dtype=np.uint8),
        )


def make_plain(window: Window, tiled: tuple[Tiled, ...], step: float) -> Plain:
    """Build the land out to the window's outline, and the wall along it.

    Raises
    ------
    ValueError
        A cell reaches beyond the outline.
    """
    own = len(tiled) == 1 and window.form != "slab" and not isinstance(window.outline, Plate)
    centre = tiled[0].shift if own else (0.0, 0.0)
    lands = [make_land(window, t, centre) for t in tiled]
    build = _Builder(step)
    if len(tiled) == 1:
        front, back = tiled[0].maker.tile.land
        _sheet(build, lands[0], front, FRONT_LAND, 0)
        _sheet(build, lands[0], back, BACK_LAND, 0)
        for _, p, q, cell in lands[0].rim:
            if cell is None:
                _quad(build, lands[0], p, q, front, back)
    else:
        _sheet(build, lands[0], tiled[0].maker.tile.land[0], FRONT_LAND, 0)
        _sheet(build, lands[1], tiled[1].maker.tile.land[1], BACK_LAND, 1)
        for side in range(1 + max(segment[0] for segment in lands[0].rim)):
            chains = [_chain(build, lands[n], tiled[n], side, n) for n in (0, 1)]
            _zip(build, chains[0], chains[1])
    return build.done()


def _key(key: Key, tiling: int) -> Key:
    """Key with a distinct number for points of the second tiling.

    Outline corners are common to both tilings.
    """
    return key if tiling == 0 or key[2] == -1 else (key[0], key[1], key[2] + 2**40)


def _sheet(build: _Builder, land: LandRing, level: int, kind: int, tiling: int) -> None:
    """The flat ring of one face."""
    number = [build.vertex(_key(key, tiling), level, land.position[key]) for key in land.keys]
    for a, b, c in land.triangles.tolist():
        # material is above a front face, so it is seen from below
        triangle = (
            (number[c], number[b], number[a]) if kind == FRONT_LAND else (number[a], number[b], number[c])
        )
        build.triangles.append(triangle)
        build.kind.append(kind)


def _quad(build: _Builder, land: LandRing, p: Key, q: Key, front: int, back: int) -> None:
    """The wall over one segment of the outline."""
    xp, xq = land.position[p], land.position[q]
    a, b = build.vertex(p, front, xp), build.vertex(q, front, xq)
    c, d = build.vertex(q, back, xq), build.vertex(p, back, xp)
    build.triangles += [(a, b, c), (a, c, d)]
    build.kind += [WALL, WALL]


def _chain(build: _Builder, land: LandRing, tiled: Tiled, side: int, face: int) -> list[tuple[float, int]]:
    """The face's edge along one side of the outline: (distance, vertex), jumps between cells included."""
    chain: list[tuple[float, int]] = []
    segments = [s for s in land.rim if s[0] == side]
    origin = np.array(land.position[segments[0][1]])
    for _, p, q, cell in segments:
        levels = (tiled.maker.tile.land[face],) * 2
        if cell is not None:
            levels = tiled.maker_at(*cell[:2]).border_levels(cell[2], cell[3], face)
        for key, level in zip((p, q), levels):
            at = land.position[key]
            number = build.vertex(_key(key, face), level, at)
            if not chain or chain[-1][1] != number:
                chain.append((float(np.hypot(at[0] - origin[0], at[1] - origin[1])), number))
    return chain


def _zip(build: _Builder, low: list[tuple[float, int]], high: list[tuple[float, int]]) -> None:
    """Triangulate the wall between a lower and an upper chain that run in parallel.

    No triangle lies on one vertical line: a step of one chain waits until the other chain has moved on.
    """
    near = 3.9 * 2.0**-23 * max(low[-1][0], high[-1][0])  # less than any gap at the outline
    i = j = 0
    while i < len(low) - 1 or j < len(high) - 1:
        options = []
        for which, (chain, at, other) in enumerate(((low, i, high[j][0]), (high, j, low[i][0]))):
            if at == len(chain) - 1:
                continue
            here, there = chain[at][0], chain[at + 1][0]
            upright = there - here <= near
            if not (upright and abs(other - here) <= near):
                # advance first to a following step, and take it while the other chain is still elsewhere
                step_next = at + 2 < len(chain) and chain[at + 2][0] - there <= near
                options.append((not upright, there - near * step_next, which))
        if not options:
            raise ValueError("both faces step at one end of the outline: no wall can be drawn there")
        if min(options)[2] == 0:
            build.triangles.append((low[i][1], low[i + 1][1], high[j][1]))
            i += 1
        else:
            build.triangles.append((low[i][1], high[j + 1][1], high[j][1]))
            j += 1
        build.kind.append(WALL)
