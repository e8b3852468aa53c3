"""Rays through a whole sheet in 60 digits: every face of every nearby cell is tried, at its exact place.

Shares nothing with the tracer but the numbers of the faces. Made for sheets whose lenses have no steps
between neighbours (untilted, principal axes along the cells), so that light never meets a wall.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import product

from mpmath import mp, mpf
from oracle import lattice as lattice_oracle
from oracle import trace as surfaces

DIGITS = 60


@dataclass
class Path:
    """What became of one ray; cells in the order they were met."""

    fate: str = "ALIVE"
    cells: list = field(default_factory=list)
    direction: list = field(default_factory=list)
    position: list = field(default_factory=list)
    optical_path: object = 0
    faces: list = field(default_factory=list)


def trace(window, start, direction):
    """Follow one ray through the window's faces."""
    with mp.workdps(DIGITS):
        position, ray = [mpf(float(v)) for v in start], surfaces.unit([mpf(float(v)) for v in direction])
        path, length = Path(), mpf(0)
        behind = [*(body.index if body.joined else 1.0 for body in window.bodies[1:]), 1.0]
        for body, beyond in zip(window.bodies, behind):
            front = [] if body.joined else [(body.front, 1.0, body.index)]  # a joint is met once
            for face, before, after in (*front, (body.back, body.index, beyond)):
                met = _first(window, face, position, ray, before, after)
                if met is None:
                    path.fate = "MISSED"
                    return path
                cell, distance, position, ray, placed = met
                path.faces.append(placed)
                length += mpf(before) * distance
                path.position, path.optical_path = position, length
                if cell is not None:
                    path.cells.append(cell)
                if ray is None:
                    path.fate = "TIR"
                    return path
                path.direction = ray
        if ray[2] <= 0:
            path.fate = "BACKWARD"
        elif len(set(path.cells)) > 1:
            path.fate = "GHOST"
        return path


def condition(window, start, direction):
    """How much roundings grow: of the ray and the faces it met, and of the direction as a vector of length 1.

    The last counts what `oracle.trace.condition` does not: inside the sheet directions have a component near 1,
    whose rounding is 2**-53 however small the others are, and a telescope multiplies it by 1/η.
    """
    faces = trace(window, start, direction).faces
    with mp.workdps(DIGITS):
        ray, step = surfaces.unit([mpf(float(v)) for v in direction]), surfaces.STEP
        # from a pitch before the first face: the distance of the source is the start's rounding, counted already
        hit = surfaces.trace(faces, start, ray).hits[0]
        near = [u - mpf(window.lattice.pitch[0]) * v for u, v in zip(hit, ray)]
        base = surfaces.trace(faces, near, ray).directions[-1]
        grown = mpf(0)
        for k in range(3):
            moved = [v + (step if i == k else 0) for i, v in enumerate(ray)]
            there = surfaces.trace(faces, near, moved).directions[-1]
            grown = max(grown, mp.sqrt(sum((u - v) ** 2 for u, v in zip(there, base))) / step)
        return surfaces.condition(faces, start, direction) + grown


def _first(window, face, position, ray, before, after):
    """Cell, distance, point and direction behind a face; None if no kept cell's part of it is met."""
    if face.array is None:
        return _through(face, (mpf(0), mpf(0), mpf(0)), position, ray, before, after, None)
    shift = [mpf(float(s)) for s in window.shifts[face.array]]
    level = (mpf(float(face.vertex[2])) - position[2]) / ray[2]
    near = [position[k] + level * ray[k] - shift[k] for k in (0, 1)]
    middle = _cell(window, near, face.array)
    found = []
    for step in product((-1, 0, 1), repeat=2):
        cell = (middle[0] + step[0], middle[1] + step[1])
        centre = [c + s for c, s in zip(_centre(window, cell, face.array), shift)]
        moved = _moved(window, face, cell)
        rise = sum(mpf(float(s)) * m for s, m in zip(face.change.slope, moved)) if face.change else mpf(0)
        if face.change:
            rise += sum(mpf(float(s)) * c for s, c in zip(face.change.climb, _centre(window, cell, 0)))
        apex = [*(c + m for c, m in zip(centre, moved)), rise]
        met = _through(face, apex, position, ray, before, after, cell, _size(window, face, cell))
        if met is None or not _kept(window, cell):
            continue
        place = [met[2][k] - shift[k] for k in (0, 1)]
        if _cell(window, place, face.array) == cell:
            found.append(met)
    return min(found, key=lambda one: one[1]) if found else None


def _through(face, centre, position, ray, before, after, cell, size=1):
    one = face.surface
    kind = "polynomial" if hasattr(one, "a4") else "biconic" if hasattr(one, "conic_x") else "quadric"
    cx, cy = (mpf(c) / size for c in (one.curvature_x, one.curvature_y))
    shape = (
        (cx, cy, one.conic_x, one.conic_y, one.side)
        if kind != "quadric"
        else (cx, cy, mpf(one.kappa) / size, 0.0, one.side)
    )
    vertex = [centre[k] + mpf(float(face.vertex[k])) for k in (0, 1, 2)]
    terms = () if kind != "polynomial" else (*one.a4, *one.a6, *one.a8)
    terms = tuple(mpf(a) / size ** (m + n - 1) for a, (m, n) in zip(terms, surfaces.POWERS))
    placed = surfaces.Face(kind, shape, (0.0, 0.0, 0.0), before, after, rotation=face.rotation, terms=terms)
    placed = replace(placed, vertex=vertex)
    path = surfaces.trace([placed], position, ray)
    if path.status == "missed":
        return None
    direction = path.directions[0] if path.directions else None
    return cell, path.optical_path[0] / mpf(before), path.hits[0], direction, placed


def _pitch(window, array):
    """Pitch of an array: its own, or the lattice's."""
    return window.placements[array].pitch or window.lattice.pitch


def _moved(window, face, cell):
    """Offset of the lens of a cell from its position on the face: affine in the cell's centre, and a table."""
    if face.change is None:
        return [mpf(0), mpf(0)]
    centre = _centre(window, cell, 0)
    moved = [sum(mpf(float(g)) * c for g, c in zip(row, centre)) for row in face.change.gradient]
    if face.change.table is None or not _kept(window, cell):
        return moved
    i, j = cell
    place = i + j // 2 if window.lattice.kind == "hexagonal" else i
    return [m + mpf(float(t)) for m, t in zip(moved, face.change.table[place, j])]


def _size(window, face, cell):
    """How many times as large as the face's the lens of a cell is."""
    if face.change is None or face.change.size is None or not _kept(window, cell):
        return 1
    i, j = cell
    place = i + j // 2 if window.lattice.kind == "hexagonal" else i
    return mpf(float(face.change.size[place, j]))


def _turned(place, angle):
    """A point turned about the middle of its array, in 60 digits."""
    c, s = mp.cos(mpf(angle)), mp.sin(mpf(angle))
    return [c * place[0] - s * place[1], s * place[0] + c * place[1]]


def _centre(window, cell, array):
    return _turned(_straight_centre(window, cell, array), window.placements[array].turn)


def _straight_centre(window, cell, array):
    lattice, pitch = window.lattice, _pitch(window, array)
    if lattice.kind == "hexagonal":
        return lattice_oracle.centre(mpf(pitch[0]), lattice.count, *cell)
    return [
        mpf(p) * mpf((Fraction(2 * k - (n - 1), 2)).numerator) / (Fraction(2 * k - (n - 1), 2)).denominator
        for k, p, n in zip(cell, pitch, lattice.count)
    ]


def _cell(window, place, array):
    """Cell of an array with a point of 60 digits, from its middle; a wall belongs to the cell above it."""
    lattice, pitch = window.lattice, _pitch(window, array)
    place = _turned(place, -window.placements[array].turn)
    if lattice.kind == "hexagonal":
        return lattice_oracle.locate("hexagonal", pitch, lattice.count, *place)[0]
    return tuple(int(mp.floor(u / mpf(p) + mpf(n) / 2)) for u, p, n in zip(place, pitch, lattice.count))


def _kept(window, cell):
    i, j = cell
    n1, n2 = window.lattice.count
    first = -(j // 2) if window.lattice.kind == "hexagonal" else 0
    return 0 <= j < n2 and first <= i < first + n1
