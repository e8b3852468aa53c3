"""Light through triangles and through exact faces, by numpy alone: the independent judge of the bench.

A design gives numbers (radii, poses, pitch, index, limits) and nothing else. Lengths are millimetres, the frame is the
sheet's. A ray is ALIVE if it goes through every body of one telescopelet: in by a facet of cell 1, out by a facet of
its partner, and through no wall, land or neighbour on the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

STEEP = 0.05
"""|n_z| below which a facet is a wall."""
PAIRS = 400_000
"""Rays times triangles looked at in one go."""


# -- contents of a design --------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Optics:
    """Numbers of a design, millimetres.

    middle : (2,) slopes at the middle of the field; half : its half angle, radians
    centres : ((x, y), (x, y)) of the lit cell of either array
    normals, reach : cell as half planes: |x · normals[k]| <= reach[k] from its centre
    seam : width of land between cells
    index : of each body; split : heights between bodies
    faces : for each body (front, back): (kind, cx, cy, kappa or conics, side, vertex, rotation, array or None, land)
    slide : distance between the lenses, in which confocality is measured
    """

    eta: Floats
    delta: Floats
    rotation: Floats
    middle: Floats
    half: float
    centres: tuple[Floats, Floats]
    normals: Floats
    reach: Floats
    seam: float
    index: tuple[float, ...]
    split: tuple[float, ...]
    faces: tuple[Any, ...]
    slide: float
    limits: dict[str, float]
    pitch: Floats
    factor: tuple[float, float]


def turned(euler: Sequence[float], moving: bool = False) -> Floats:
    """R = Rz(psi) Rx(theta) Rz(phi), degrees; the other way round for moving axes."""
    phi, theta, psi = (radians(v) for v in euler)

    def about_z(a: float) -> Floats:
        return np.array([[cos(a), -sin(a), 0.0], [sin(a), cos(a), 0.0], [0.0, 0.0, 1.0]])

    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cos(theta), -sin(theta)], [0.0, sin(theta), cos(theta)]])
    return about_z(phi) @ about_x @ about_z(psi) if moving else about_z(psi) @ about_x @ about_z(phi)


def optics(design: Any, window: Any) -> Optics:
    """Read the numbers off a design and what it prescribes, all in millimetres."""
    scale = 1e3 * window.unit
    law, spec = design.law_spec, design.check
    lattice = window.lattice
    cells = lattice.centres(lattice.cells()) * scale
    near = cells[int(np.argmin((cells**2).sum(axis=1) + 1e-9 * cells[:, 0] + 1e-10 * cells[:, 1]))]
    shifts = [np.array(s) * scale for s in window.shifts]
    pitch = np.array(lattice.pitch) * scale
    if lattice.kind == "hexagonal":
        normals = np.array([[1.0, 0.0], [0.5, 0.75**0.5], [-0.5, 0.75**0.5]])
        reach = np.full(3, 0.5 * pitch[0])
    else:
        normals, reach = np.eye(2), 0.5 * pitch
    faces = tuple(tuple(_face(face, scale) for face in (body.front, body.back)) for body in window.bodies)
    heights = [float(np.mean([pair[k][5][2] for k in (0, 1)])) for pair in faces]
    if len(faces) == 2:
        edges = (faces[0][1][5][2], faces[1][0][5][2])
        heights = [0.5 * (edges[0] + edges[1])]
    s = window.thin.separation * scale
    offset = np.array(window.thin.offset) * scale
    slope = np.array(window.thin.shift) * scale / offset[2]
    if spec.field_centre == "normal":
        slope = np.zeros(2)
    f1, f2 = (np.array(f) for f in window.thin.focal_length)
    with np.errstate(invalid="ignore"):
        ratio = np.where(np.isinf(f1), 1.0, -f2 / f1)
    return Optics(
        np.array(law.eta), np.array(law.delta), turned(law.euler_degrees, law.euler_axes == "moving"), slope, spec.field,
        (near + shifts[0], near + shifts[1]), normals, reach, window.land.seam * scale,
        tuple(body.index for body in window.bodies), tuple(heights) if len(faces) == 2 else (), faces,
        s * (window.bodies[0].index if window.form == "slab" else 1.0),
        {"rms": spec.law_rms if spec.mesh_law_rms is None else spec.mesh_law_rms, "bias": spec.law_bias, "eta": spec.eta,
         "delta": spec.delta, "confocality": spec.confocality, "throughput": spec.throughput},
        pitch, (float(ratio[0]), float(ratio[1])),
    )  # fmt: skip


def _face(face: Any, scale: float) -> tuple[Any, ...]:
    surface = face.surface
    if hasattr(surface, "kappa"):
        shape = ("quadric", surface.curvature_x / scale, surface.curvature_y / scale, surface.kappa / scale)
    else:
        shape = (
            "biconic",
            surface.curvature_x / scale,
            surface.curvature_y / scale,
            (surface.conic_x, surface.conic_y),
        )
    vertex = np.array(face.vertex) * scale
    land = None if face.land is None else face.land * scale
    return (*shape, int(surface.side), vertex, np.array(face.rotation), face.array, land)


# -- the law and the rays -------------------------------------------------------------------------------


def asked(optic: Optics, into: Floats) -> Floats:
    """Unit directions (n, 3) by the law: t' = (t - delta)/eta in lens axes."""
    lens = into @ optic.rotation
    slope = (lens[:, :2] / lens[:, 2:] - optic.delta) / optic.eta
    out = np.column_stack([slope, np.ones(len(slope))]) @ optic.rotation.T
    return np.asarray(out / np.linalg.norm(out, axis=1)[:, None])


def spread(count: int, dimensions: int) -> Floats:
    """Points (count, dimensions) of the unit cube, evenly spread: multiples of powers of the generalised golden ratio."""
    root = 2.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    steps = root ** -np.arange(1.0, dimensions + 1)
    return np.asarray((0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0)


@dataclass(frozen=True, eq=False)
class Light:
    """Rays (n, 3) that cross z = 0 at `origin`, all over one cell."""

    origin: Floats
    direction: Floats


def over_the_cell(optic: Optics, count: int, direction: Floats | None = None) -> Light:
    """Rays all over cell 1, in the cone of the field or all along one direction."""
    unit = spread(2 * count, 4)
    box = np.max(np.abs(optic.pitch))
    local = (unit[:, :2] - 0.5) * (2.0 * box if len(optic.normals) == 3 else optic.pitch)
    inside = in_cell(optic, local, 0.0)
    if len(optic.normals) == 3:
        unit, local = unit[inside][:count], local[inside][:count]
    else:
        unit, local = unit[:count], local[:count]
    if direction is None:
        axis = np.array([*optic.middle, 1.0]) / np.sqrt(optic.middle @ optic.middle + 1.0)
        u = np.cross([0.0, 1.0, 0.0], axis)
        u /= np.linalg.norm(u)
        v = np.cross(axis, u)
        along = 1.0 - unit[:, 2] * (1.0 - cos(optic.half))
        across = np.sqrt(1.0 - along**2)
        turn = 2.0 * np.pi * unit[:, 3]
        rays = along[:, None] * axis + across[:, None] * (
            np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v
        )
    else:
        rays = np.broadcast_to(direction, (len(local), 3)).copy()
    origin = np.column_stack([local + optic.centres[0], np.zeros(len(local))])
    return Light(origin, rays)


def field_directions(optic: Optics) -> Floats:
    """The middle of the field and eight directions on its rim, (9, 3)."""
    axis = np.array([*optic.middle, 1.0]) / np.sqrt(optic.middle @ optic.middle + 1.0)
    u = np.cross([0.0, 1.0, 0.0], axis)
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    turn = np.arange(8) * np.pi / 4
    rim = cos(optic.half) * axis + sin(optic.half) * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v)
    return np.vstack([axis, rim])


def in_cell(optic: Optics, local: Floats, margin: float) -> Bools:
    """Which points (n, 2) from the centre of a cell lie in it, `margin` away from its border."""
    return np.asarray((np.abs(local @ optic.normals.T) <= optic.reach * (1.0 + 1e-9) - margin).all(axis=1))


def bent(direction: Floats, normal: Floats, ratio: float) -> Floats:
    """Snell in vectors: directions (n, 3) behind an interface, ratio n1/n2; NaN at total reflection."""
    normal = np.where((direction * normal).sum(axis=1)[:, None] > 0.0, normal, -normal)
    incidence = (direction * normal).sum(axis=1)
    with np.errstate(invalid="ignore"):
        exit_ = np.sqrt(1.0 - ratio**2 * (1.0 - incidence**2))
        return np.asarray(ratio * direction + (exit_ - ratio * incidence)[:, None] * normal)


# -- triangles ------------------------------------------------------------------------------------------


class Facets:
    """Facets of one body that look one way (down or up), in a grid of squares over x and y."""

    def __init__(self, corners: Floats) -> None:
        self.corner = corners[:, 0]
        self.edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        across = np.cross(*self.edges)
        self.normal = across / np.linalg.norm(across, axis=1)[:, None]
        low, high = corners.min(axis=1), corners.max(axis=1)
        self.empty = not len(corners)
        if self.empty:
            return
        self.low, self.high = low.min(axis=0), high.max(axis=0)
        area = float(np.prod(self.high[:2] - self.low[:2]))
        self.size = max(np.sqrt(2.0 * area / len(corners)), 1e-9)
        self.shape = np.ceil((self.high - self.low)[:2] / self.size).astype(np.int64) + 1
        first, last = self._square(low[:, :2]), self._square(high[:, :2])
        triangle, square = _boxes(first, last, self.shape[1])
        order = np.argsort(square, kind="stable")
        self.triangle = triangle[order]
        self.start = np.searchsorted(square[order], np.arange(int(np.prod(self.shape)) + 1))

    def _square(self, points: Floats) -> Ints:
        return np.clip(((points - self.low[:2]) / self.size).astype(np.int64), 0, self.shape - 1)

    def meet(self, origin: Floats, direction: Floats, beyond: float) -> tuple[Floats, Ints]:
        """Distance (n,) to the first facet met further than `beyond`, infinite where there is none, and its number."""
        distance, number = np.full(len(origin), np.inf), np.full(len(origin), -1)
        if self.empty or not len(origin):
            return distance, number
        step = 1e-9 + 1e-6 * (self.high[2] - self.low[2])
        near = np.maximum((self.low[2] - step - origin[:, 2]) / direction[:, 2], beyond)
        far = (self.high[2] + step - origin[:, 2]) / direction[:, 2]
        ends = [origin[:, :2] + t[:, None] * direction[:, :2] for t in (near, far)]
        low, high = np.minimum(*ends), np.maximum(*ends)
        lit = np.flatnonzero(
            (far > near) & (high >= self.low[:2]).all(axis=1) & (low <= self.high[:2]).all(axis=1)
        )
        ray, square = _boxes(self._square(low[lit]), self._square(high[lit]), self.shape[1])
        ray = lit[ray]
        held = self.start[square + 1] - self.start[square]
        total = np.cumsum(held)
        done = 0
        while done < len(ray):
            until = max(int(np.searchsorted(total, (total[done - 1] if done else 0) + PAIRS)), done + 1)
            some = slice(done, until)
            rays = np.repeat(ray[some], held[some])
            place = np.arange(len(rays)) - np.repeat(np.cumsum(held[some]) - held[some], held[some])
            facets = self.triangle[np.repeat(self.start[square[some]], held[some]) + place]
            self._nearest(rays, facets, origin, direction, beyond, distance, number)
            done = until
        return distance, number

    def _nearest(self, rays: Ints, facets: Ints, origin: Floats, direction: Floats, beyond: float, distance: Floats,
                 number: Ints) -> None:  # fmt: skip
        d, first, second = direction[rays], self.edges[0][facets], self.edges[1][facets]
        cross = np.cross(d, second)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / (first * cross).sum(axis=1)
            rest = origin[rays] - self.corner[facets]
            u = scale * (rest * cross).sum(axis=1)
            other = np.cross(rest, first)
            v = scale * (d * other).sum(axis=1)
            t = scale * (second * other).sum(axis=1)
            hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & (t > beyond)
        order = np.argsort(t[hit], kind="stable")[::-1]  # the nearest is written last
        rays, facets, t = rays[hit][order], facets[hit][order], t[hit][order]
        nearer = t < distance[rays]
        distance[rays[nearer]] = t[nearer]
        number[rays[nearer]] = facets[nearer]


def _boxes(first: Ints, last: Ints, width: int) -> tuple[Ints, Ints]:
    """Every square of boxes of squares: which box, and the number of the square."""
    side = last - first + 1
    many = side[:, 0] * side[:, 1]
    box = np.repeat(np.arange(len(many)), many)
    place = np.arange(len(box)) - np.repeat(np.cumsum(many) - many, many)
    row, column = place // side[box, 1], place % side[box, 1]
    return box, (first[box, 0] + row) * width + first[box, 1] + column


@dataclass(frozen=True, eq=False)
class Part:
    """Facets of a file near the lit telescopelet: for each body those that look down, and those that look up."""

    bodies: tuple[tuple[Facets, Facets], ...]


def part(optic: Optics, corners: Floats) -> Part:
    """Sort triangles (t, 3, 3), millimetres, sheet frame, into bodies and sides."""
    reach = 1.6 * float(np.max(optic.pitch))
    boxes = np.array([[c - reach, c + reach] for c in optic.centres])
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    near = (corners[:, :, :2].max(axis=1) >= low).all(axis=1) & (corners[:, :, :2].min(axis=1) <= high).all(
        axis=1
    )
    corners = corners[near]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(across, axis=1)
    slope = across[:, 2] / np.where(size > 0.0, size, 1.0)
    middle = corners[:, :, 2].mean(axis=1)
    body = np.searchsorted(np.array(optic.split), middle)
    return Part(tuple(
        (Facets(corners[(body == k) & (slope < -STEEP)]), Facets(corners[(body == k) & (slope > STEEP)]))
        for k in range(len(optic.index))
    ))  # fmt: skip


@dataclass(frozen=True, eq=False)
class Seen:
    """Directions (n, 3) behind the sheet, and which rays are ALIVE, (n,)."""

    direction: Floats
    alive: Bools


def through_triangles(optic: Optics, what: Part, light: Light) -> Seen:
    """Send light through the triangles of a file."""
    lowest = min(f.low[2] for pair in what.bodies for f in pair if not f.empty)
    back = (lowest - 0.5 - light.origin[:, 2]) / light.direction[:, 2]
    at, along = light.origin + back[:, None] * light.direction, light.direction.copy()
    alive = np.ones(len(at), dtype=bool)
    for number, (down, up) in enumerate(what.bodies):
        array = [face[7] for face in optic.faces[number]]
        land = [face[8] for face in optic.faces[number]]
        for side, (wanted, unwanted) in enumerate(((down, up), (up, down))):
            rows = np.flatnonzero(alive)
            least = 0.0 if not side else 1e-7
            t, which = wanted.meet(at[rows], along[rows], least)
            other, _ = unwanted.meet(at[rows], along[rows], least)
            good = np.isfinite(t) & (t < other)
            alive[rows[~good]] = False
            rows, t, which = rows[good], t[good], which[good]
            at[rows] += t[:, None] * along[rows]
            ratio = 1.0 / optic.index[number] if side == 0 else optic.index[number]
            along[rows] = bent(along[rows], wanted.normal[which], ratio)
            fine = np.isfinite(along[rows, 0])
            if array[side] is not None:
                local = at[rows, :2] - optic.centres[array[side]]
                fine &= in_cell(optic, local, 0.5 * optic.seam)
                if land[side] is not None:  # on the land's level, level: web, not lens
                    level = np.abs(wanted.normal[which, 2]) > 1.0 - 1e-12
                    fine &= ~(level & (np.abs(at[rows, 2] - land[side]) < 1e-6))
            alive[rows[~fine]] = False
        rows = np.flatnonzero(alive)
        again = np.minimum(down.meet(at[rows], along[rows], 1e-7)[0], up.meet(at[rows], along[rows], 1e-7)[0])
        alive[rows[np.isfinite(again)]] = False  # into a neighbour that protrudes farther
    return Seen(along, alive & (along[:, 2] > 0.0))


# -- exact faces ----------------------------------------------------------------------------------------


def through_faces(optic: Optics, light: Light, slide: float = 0.0) -> Seen:
    """Send light through the exact faces of the lit telescopelet; `slide` moves array 2 along the sheet's normal."""
    at, along = light.origin.copy(), light.direction.copy()
    alive = np.ones(len(at), dtype=bool)
    for number, pair in enumerate(optic.faces):
        for side, face in enumerate(pair):
            kind, cx, cy, rest, way, vertex, rotation, array, land = face
            centre = optic.centres[array or 0]
            moved = slide if array == 1 else 0.0
            apex = np.array([vertex[0] + centre[0], vertex[1] + centre[1], vertex[2] + moved])
            if array is None:
                apex = np.array([0.0, 0.0, vertex[2] + (slide if number == 1 else 0.0)])
            p, d = (at - apex) @ rotation, along @ rotation
            t, normal = (_quadric if kind == "quadric" else _biconic)(cx, cy, rest, way, p, d)
            hit = p + t[:, None] * d
            at, normal = hit @ rotation.T + apex, normal @ rotation.T
            ratio = 1.0 / optic.index[number] if side == 0 else optic.index[number]
            along = bent(along, normal / np.linalg.norm(normal, axis=1)[:, None], ratio)
            alive &= np.isfinite(along[:, 0]) & np.isfinite(at[:, 2])
            if array is not None:
                with np.errstate(invalid="ignore"):
                    alive &= in_cell(optic, at[:, :2] - centre, 0.5 * optic.seam)
                    if land is not None:  # the outermost of lens and land is the face
                        alive &= (at[:, 2] - moved < land) if side == 0 else (at[:, 2] - moved > land)
    return Seen(along, alive & (along[:, 2] > 0.0))


def _quadric(cx: float, cy: float, kappa: float, way: int, p: Floats, d: Floats) -> tuple[Floats, Floats]:
    """Distance to cx x² + cy y² + kappa z² = 2 way z at the apex, and its gradient."""
    curve, flat = np.array([cx, cy, kappa]), np.array([0.0, 0.0, float(way)])
    a = (curve * d * d).sum(axis=1)
    b = (curve * p * d).sum(axis=1) - way * d[:, 2]
    c = (curve * p * p).sum(axis=1) - 2.0 * way * p[:, 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(b * b - a * c)
        # both roots; the one on the apex's half
        one, two = c / (-b + np.sign(-b) * root), (-b + np.sign(-b) * root) / np.where(a == 0.0, np.nan, a)
        z = np.stack([p[:, 2] + t * d[:, 2] for t in (one, two)])
        apex = 1.0 - way * kappa * z > 0.0
        t = np.where(apex[0] & np.isfinite(z[0]), one, np.where(apex[1], two, np.nan))
    return t, curve * (p + t[:, None] * d) - flat


def _biconic(
    cx: float, cy: float, conic: tuple[float, float], way: int, p: Floats, d: Floats
) -> tuple[Floats, Floats]:
    """Distance to z = way (cx x² + cy y²)/(1 + sqrt(1 − (1+Kx) cx² x² − (1+Ky) cy² y²)) by Newton, and its gradient."""
    t = -p[:, 2] / d[:, 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        for _ in range(20):
            q = p + t[:, None] * d
            x, y = q[:, 0], q[:, 1]
            wx, wy = (1.0 + conic[0]) * cx * cx, (1.0 + conic[1]) * cy * cy
            w = np.sqrt(1.0 - wx * x * x - wy * y * y)
            top = cx * x * x + cy * y * y
            sag = way * top / (1.0 + w)
            gx = way * (2.0 * cx * x / (1.0 + w) + top * wx * x / (w * (1.0 + w) ** 2))
            gy = way * (2.0 * cy * y / (1.0 + w) + top * wy * y / (w * (1.0 + w) ** 2))
            slope = d[:, 2] - gx * d[:, 0] - gy * d[:, 1]
            t = t - (q[:, 2] - sag) / slope
    return t, np.column_stack([-gx, -gy, np.ones(len(gx))])


# -- what it means --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Found:
    """What light through a file does: what the checks of a master are about.

    Attributes
    ----------
    rms, bias : radians; eta, delta, confocality : file less exact; throughput : of the thin closed form
    eta_fitted : (2,) through the file
    """

    rms: float
    bias: float
    eta: float
    delta: float
    confocality: float
    throughput: float
    eta_fitted: tuple[float, float]
    limits: dict[str, float]

    def used(self) -> dict[str, float]:
        """Part of each limit that is used; above 1 it is exceeded."""
        over = {
            name: getattr(self, name) / self.limits[name]
            for name in ("rms", "bias", "eta", "delta", "confocality")
        }
        return over | {"throughput": self.limits["throughput"] / max(self.throughput, 1e-9)}

    @property
    def fit_for_making(self) -> bool:
        """Whether the light keeps every limit."""
        return all(value <= 1.0 for value in self.used().values())

    def near(self, band: float) -> bool:
        """Whether a quantity lies so near its limit that it cannot decide: the worst within `band` of 1."""
        return abs(max(self.used().values()) - 1.0) <= band


def angle(a: Floats, b: Floats) -> Floats:
    """Angles (n,) between rows, radians."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1)))


def measure(optic: Optics, corners: Floats, count: int = 8192, points: int = 2048) -> Found:
    """Send light through triangles (t, 3, 3) and through the exact faces, and compare both with the law."""
    what = part(optic, corners)
    return _measure(optic, lambda light: through_triangles(optic, what, light), count, points)


def measure_exact(optic: Optics, count: int = 8192, points: int = 2048) -> Found:
    """The same through the exact faces."""
    return _measure(optic, lambda light: through_faces(optic, light), count, points)


def _measure(optic: Optics, send: Any, count: int, points: int) -> Found:
    light = over_the_cell(optic, count)
    seen, truth = send(light), through_faces(optic, light)
    aim = asked(optic, light.direction)
    if seen.alive.sum() < 16:
        nothing = float("inf")
        return Found(nothing, nothing, nothing, nothing, nothing, 0.0, (np.nan, np.nan), optic.limits)
    rms = float(np.sqrt(np.mean(angle(seen.direction, aim)[seen.alive] ** 2)))
    bias, share = [], []
    for number, direction in enumerate(field_directions(optic)):
        lit = over_the_cell(optic, points if number else count, direction)
        found = send(lit)
        share.append(float(found.alive.mean()))
        if found.alive.sum() >= 16:
            bias.append(
                float(angle(found.direction[found.alive].mean(axis=0), asked(optic, direction[None])[0]))
            )
    both = seen.alive & truth.alive
    fits = [_fit(optic, light.direction[both], out.direction[both]) for out in (seen, truth)]
    eta = float(np.max(np.abs(fits[0][0] / fits[1][0] - 1.0)))
    delta = float(np.max(np.abs(fits[0][1] - fits[1][1])))
    exact = through_faces(optic, over_the_cell(optic, count, field_directions(optic)[0])).alive.mean()
    # the share that thin lenses leave is close to the exact one; the limit is a tenth away
    through = min(float(seen.alive.mean() / truth.alive.mean()), share[0] / float(exact))
    return Found(
        rms, max(bias), eta, delta, _shift(optic, light, seen, both), through, tuple(fits[0][0]), optic.limits
    )


def _fit(optic: Optics, into: Floats, out: Floats) -> tuple[Floats, Floats]:
    """η and δ (2,) by least squares on slopes in lens axes: t' = (t − δ)/η."""
    a, b = (d @ optic.rotation for d in (into, out))
    eta, delta = np.empty(2), np.empty(2)
    for k in (0, 1):
        t, to = a[:, k] / a[:, 2], b[:, k] / b[:, 2]
        slope, rest = np.polyfit(t, to, 1)
        eta[k], delta[k] = 1.0 / slope, -rest / slope
    return eta, delta


def _shift(optic: Optics, light: Light, seen: Seen, both: Bools) -> float:
    """Shift of array 2 along the normal, over the distance of the lenses, that the file seems to have; worse axis."""
    step = 1e-3
    moved = [through_faces(optic, light, slide * optic.slide) for slide in (-step, 0.0, step)]
    good = both & moved[0].alive & moved[2].alive
    if good.sum() < 16:
        return float("inf")
    across = optic.rotation[:, :2]
    change = (moved[2].direction - moved[0].direction)[good] @ across / (2.0 * step)
    less = (seen.direction - moved[1].direction)[good] @ across
    weight = (change**2).sum(axis=0)
    power = weight > 1e-12 * weight.max()
    return float(np.max(np.abs((less * change).sum(axis=0)[power] / weight[power])))
