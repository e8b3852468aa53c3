"""The outline of a body as a closed path of exact arcs. Lengths in mm."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, pi, sqrt, tau

import numpy as np

from clacad.base.types import Floats
from clacad.sheet.edge_columns import CX, CY, RADIUS, SENSE
from clacad.sheet.lattice import Circle, Outline
from clacad.sheet.plate import Plate
from clacad.solid.face_pattern import SNAP
from clacad.solid.rational_conics import Arc, line

Round = tuple[Floats, float, float]


@dataclass(frozen=True, eq=False)
class Path:
    """An outline in the plane z = 0, counter-clockwise; a round one in four quarters.

    Attributes
    ----------
    arcs : tuple of Arc
    centre : (2,), mm
    radius : float or None
        Of a round outline.
    touched : bool
        Whether cells may touch it.
    rounds : tuple of (centre (2,), radius, sense) or None
        Circle of each arc, mm, and its sense: 1 counter-clockwise, −1 clockwise. None for a straight one.
    """

    arcs: tuple[Arc, ...]
    centre: Floats
    radius: float | None
    touched: bool = True
    rounds: tuple[Round | None, ...] = ()

    def position(self, point: Floats) -> tuple[int, float] | None:
        """Side and parameter (0 ≤ u < 1) of a point (2,) of the path; None if it is not on it."""
        for side, arc in enumerate(self.arcs if self.touched else ()):
            a, b = arc.poles[0, :2], arc.poles[-1, :2]
            width = SNAP / float(np.hypot(*(b - a)))
            if self.radius is None:
                u = float((point - a) @ (b - a) / ((b - a) @ (b - a)))
                away = float(np.hypot(*(point - a - u * (b - a))))
            else:
                u = self._on_quarter(side, point)
                away = abs(float(np.hypot(*(point - self.centre))) - self.radius)
            if away < SNAP and -width <= u < 1.0 - width:
                return side, (0.0 if u < width else u)
        return None

    def _on_quarter(self, side: int, point: Floats) -> float:
        """Parameter of a point of a round path on one quarter; 2 if it lies on another."""
        way = point - self.centre
        angle = (atan2(way[1], way[0]) - (side - 1) * 0.5 * pi + 1e-9) % tau - 1e-9
        if angle > 0.5 * pi:
            return 2.0
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            x, y = self.arcs[side].at(np.array([middle]))[0, :2] - self.centre
            if (atan2(y, x) - (side - 1) * 0.5 * pi + 1e-9) % tau - 1e-9 < angle:
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
        elif self.radius is None:
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


def outline_path(outline: Outline, scale: float, centre: Floats) -> Path:
    """Path of an outline (design units, `scale` mm per unit) about a centre (2,), mm; of a plate its outer
    boundary.
    """
    if isinstance(outline, Plate):
        return plate_paths(outline, scale)[0]
    if isinstance(outline, Circle):
        r = 0.5 * outline.diameter * scale
        starts, corners = [(0.0, -r), (r, 0.0), (0.0, r), (-r, 0.0)], [(r, -r), (r, r), (-r, r), (-r, -r)]
        weights = np.array([1.0, sqrt(0.5), 1.0])
        arcs = [
            Arc(np.array([[*a, 0.0], [*b, 0.0], [*c, 0.0]]) + np.append(centre, 0.0), weights)
            for a, b, c in zip(starts, corners, starts[1:] + starts[:1])
        ]
        return Path(tuple(arcs), centre, r, rounds=((centre, r, 1.0),) * 4)
    w, h = 0.5 * outline.width * scale, 0.5 * outline.height * scale
    points = np.array([(-w, -h, 0.0), (w, -h, 0.0), (w, h, 0.0), (-w, h, 0.0)]) + np.append(centre, 0.0)
    return Path(tuple(line(a, b) for a, b in zip(points, np.roll(points, -1, axis=0))), centre, None)


def plate_paths(plate: Plate, scale: float) -> tuple[Path, ...]:
    """Paths of a plate's boundary and of its holes, the material on their left; no cell touches them (mm)."""
    return tuple(
        Path(
            tuple(_arc(edge * scale, edge[SENSE]) for edge in loop),
            np.zeros(2),
            None,
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
