"""Rays through the faces of a file of solids: as OCC reads them, or as the text of a STEP file states them.

Nothing of the window's formulas is used: OCC finds the hits on its own trimmed faces and gives the tangents
there; only Snell's law is clacad's. Solids that touch are one piece to the light: rays that leave one and
enter the next at the same point are not refracted. Run it in a worker: OCC can crash.

Files too large for OCC are traced by the rational Bézier patches of their text with Newton's method. Trims
are not read, so callers must decide from the position of a hit. Lengths in mm.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Floats, Ints
from clacad.base.units import millimetres
from clacad.formats.placements import applied
from clacad.formats.step.text_health import StepScan, across_rows, casteljau
from clacad.optics.surface import refract
from clacad.sheet.face_order import refractions
from clacad.sheet.window import Body, Face, Window

ENDS = ("through", "nothing met", "wall", "total reflection")
"""Endings of a ray."""


@dataclass(frozen=True, eq=False)
class RayPaths:
    """Positions of rays, and where they crossed faces; the arrays are filled in as the rays advance.

    position, direction : (n, 3). Of the last crossing; unit directions behind it.
    end : (n,) index into `ENDS`
    crossings : (n,). Faces crossed so far.
    hits : (n, steps, 3). Where each ray crossed, zero beyond its last crossing.
    """

    position: Floats
    direction: Floats
    end: Ints
    crossings: Ints
    hits: Floats

    @staticmethod
    def begun(position: Any, direction: Any, steps: int) -> RayPaths:
        """Rays (n, 3) before their first of `steps` crossings."""
        place, way = np.array(position, dtype=np.float64), np.array(direction, dtype=np.float64)
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        many = len(place)
        return RayPaths(
            place, way, np.zeros(many, dtype=int), np.zeros(many, dtype=int), np.zeros((many, steps, 3))
        )

    def to_lists(self, curved: Bools) -> dict[str, Any]:
        """As JSON lists, with whether each face crossed is curved both ways (n, steps)."""
        return {
            "position": self.position.tolist(),
            "direction": self.direction.tolist(),
            "end": self.end.tolist(),
            "crossings": self.crossings.tolist(),
            "hits": self.hits.tolist(),
            "curved": curved.tolist(),
        }


class Crossing(NamedTuple):
    """A face that light goes through: refractive indices before and behind it; of a joint between two solids
    the heights (low, high), mm, between which both have it.
    """

    before: float
    after: float
    joint: tuple[float, float] | None


def crossings(window: Window, bodies: Sequence[Body], up: float = 0.0) -> list[Crossing]:
    """Faces of some plates of a window in the order in which light meets them, a joint once.

    up : mm. Height of the sheet's own z = 0.
    """
    from clacad.sheet.feasibility import body_range

    scale, found = millimetres(window.unit), []
    ahead = {first: second for first, second in pairwise(window.bodies) if second.joined}
    for body, face, before, after in refractions(window.bodies):
        if body not in bodies:
            continue
        joint = None
        if face is body.back and body in ahead:  # the front of the next body reaches lowest, the back highest
            room = JOINT_ROOM * min(window.lattice.pitch)
            low, high = body_range(window, ahead[body])[0] - room, body_range(window, body)[1] + room
            joint = (low * scale + up, high * scale + up)
        found.append(Crossing(before, after, joint))
    return found


JOINT_ROOM = 0.02
"""Pitches by which a joint may lie off its height in a file, to be taken for it."""
NEAREST = 1e-6
"""Hits nearer than this (mm) are on the face just left."""
TOUCH = 2e-6
"""Faces within this distance (mm) of one another are met at once."""
GRAZING = 1e-6
"""A face whose unit normal has no larger z is a wall."""


def cast_rays(
    path: str | os.PathLike[str],
    position: Sequence[Sequence[float]],
    direction: Sequence[Sequence[float]],
    faces: Sequence[Crossing],
) -> list[list[float] | None]:
    """Trace rays through the solids of a STEP file.

    position : (n, 3) mm
    direction : (n, 3)
    faces : In the order light meets them.

    Returns
    -------
    list of (3,) unit directions, or None for a ray that did not enter and leave every body through faces that
    are no walls.

    Raises UnreadableFile: OCC finds no shape in the file.
    """
    found = follow_rays(path, position, direction, faces, (-np.inf, -np.inf), (np.inf, np.inf))
    return [way if end == 0 else None for way, end in zip(found["direction"], found["end"], strict=True)]


def follow_rays(
    path: str | os.PathLike[str],
    position: Any,
    direction: Any,
    faces: Sequence[Crossing],
    low: Sequence[float],
    high: Sequence[float],
) -> dict[str, Any]:
    """Trace rays through the faces of a file that reach into a column, and report where they crossed.

    path, position, direction, faces : As for `cast_rays`.
    low, high : (2,) mm. Column of x and y; faces that do not reach into it are left out.

    Returns
    -------
    dict of lists
        position, direction : (n, 3) of the last crossing; end : (n,) index into `ENDS`; crossings : (n,);
        hits : (n, faces, 3) where each ray crossed, zero beyond its last crossing; curved : (n, faces)
            whether the face crossed there is curved both ways.

    Raises UnreadableFile: OCC cannot read the file.
    """
    layers = _column(path, tuple(low), tuple(high))
    many = len(position)
    paths = RayPaths.begun(position, direction, len(faces))
    curved = np.zeros((many, len(faces)), dtype=bool)
    for k in range(many):
        ray = _Ray(layers, paths.position[k], paths.direction[k])
        paths.end[k] = ray.follow(faces)
        found = len(ray.hits)
        paths.crossings[k] = found
        paths.hits[k, :found], curved[k, :found] = np.array(ray.hits).reshape(-1, 3), ray.curved
        paths.position[k], paths.direction[k] = ray.position, ray.direction
    return paths.to_lists(curved)


_COLUMNS: dict[tuple[Any, ...], Any] = {}


@dataclass(frozen=True, eq=False)
class _FaceLayer:
    """Faces between two heights (mm) that no face of another layer reaches, in OCC's intersector."""

    low: float
    high: float
    intersector: Any


def _column(
    path: str | os.PathLike[str], low: tuple[float, ...], high: tuple[float, ...]
) -> list[_FaceLayer]:
    """Layers of the faces that reach into a column, upwards, kept for the next call; none without a face.

    A ray is cut with the faces of one layer at a time: of a sheet of several plates, those of one plate.
    """
    from clacad.formats.step.read_back import kept, loaded, state_of
    from clacad.formats.step.shape_parts import boxes_of, moved, reaching

    def made() -> list[_FaceLayer]:
        faces = [
            moved(face, placement)
            for piece in loaded(path).pieces
            for placement, face in reaching(piece, boxes_of(piece.faces), np.array(low), np.array(high))
        ]
        if not faces:
            return []
        heights = boxes_of(faces)[..., 2].reshape(len(faces), -1)
        floors, tops = heights.min(axis=1), heights.max(axis=1)
        order = np.argsort(floors, kind="stable")
        reached = np.maximum.accumulate(tops[order])
        starts = np.flatnonzero(np.append(True, floors[order][1:] > reached[:-1] + TOUCH))
        return [
            _FaceLayer(floors[rows].min(), tops[rows].max(), _loaded([faces[row] for row in rows]))
            for rows in map(np.sort, np.split(order, starts[1:]))
        ]

    return kept(_COLUMNS, (*state_of(path), low, high), made)


def _loaded(faces: Sequence[Any]) -> Any:
    """OCC's intersector of faces."""
    from OCP.BRep import BRep_Builder
    from OCP.IntCurvesFace import IntCurvesFace_ShapeIntersector
    from OCP.TopoDS import TopoDS_Compound

    builder, together = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(together)
    for face in faces:
        builder.Add(together, face)
    intersector = IntCurvesFace_ShapeIntersector()
    intersector.Load(together, 1e-10)
    return intersector


class _Ray:
    """One ray on its way through the faces."""

    def __init__(self, layers: Sequence[_FaceLayer], position: Floats, direction: Floats) -> None:
        self._layers = layers
        self.position, self.direction = position, direction
        self.hits: list[Floats] = []
        self.curved: list[bool] = []
        self._inside = 0

    def follow(self, faces: Sequence[Crossing]) -> int:
        """Trace through all faces; return the ending, an index into `ENDS`."""
        for before, after, joint in faces:
            met = self._next_border() if joint is None else self._next_joint(*joint)
            if met is None:
                return 1
            place, normal, curved = met
            if abs(normal[2]) < GRAZING:
                return 2
            normal = normal if normal @ self.direction > 0.0 else -normal
            bent, _ = refract(
                self.direction[None], normal[None], np.array([normal @ self.direction]), before, after
            )
            self.position = place
            self.hits.append(place)
            self.curved.append(curved)
            if not np.isfinite(bent).all():
                return 3
            self.direction = bent[0]
        return 0

    def _next_border(self) -> tuple[Floats, Floats, bool] | None:
        """Next point where light enters or leaves material, unit normal there, whether the face is curved."""
        for together in self._groups():
            distance, normal, curved, way = together[0]
            net = sum(one[3] for one in together)
            was, self._inside = self._inside, self._inside + net
            if (was > 0) != (self._inside > 0):
                for one in together:  # of faces met at once, the one that agrees with the light's direction
                    if one[3] * net > 0:
                        distance, normal, curved, way = one
                        break
                return self.position + distance * self.direction, normal, curved
        return None

    def _next_joint(self, low: float, high: float) -> tuple[Floats, Floats, bool] | None:
        """Next point between two heights where light leaves one solid and enters another, as of
        `_next_border`; walls between the cells of a body are passed.
        """
        for together in self._groups():
            across = [one for one in together if abs(one[1][2]) >= GRAZING]
            self._inside += sum(one[3] for one in together)
            place = self.position + together[0][0] * self.direction
            if {one[3] for one in across} == {-1, 1} and low <= place[2] <= high:
                _, normal, curved, _ = next(one for one in across if one[3] < 0)
                return place, normal, curved
            if self._inside <= 0:
                return None
        return None

    def _groups(self) -> Iterator[list[tuple[float, Floats, bool, int]]]:
        """Hits ahead, nearest first, grouped by position."""
        from OCP.gp import gp_Dir, gp_Lin, gp_Pnt

        line = gp_Lin(gp_Pnt(*self.position), gp_Dir(*self.direction))
        height, upward = self.position[2], self.direction[2] >= 0.0
        for layer in self._layers if upward else reversed(self._layers):
            if (layer.high < height - TOUCH) if upward else (layer.low > height + TOUCH):
                continue
            found = layer.intersector
            found.Perform(line, NEAREST, 1e6)
            if not found.IsDone():
                continue
            order = sorted((found.WParameter(k), k) for k in range(1, found.NbPnt() + 1))
            group: list[tuple[float, Floats, bool, int]] = []
            for distance, number in order:
                if group and distance - group[-1][0] > TOUCH:
                    yield group
                    group = []
                group.append(self._met(found, distance, number))
            if group:
                yield group

    def _met(self, found: Any, distance: float, number: int) -> tuple[float, Floats, bool, int]:
        """Distance, outward unit normal, whether the face is curved, and +1 on entry, −1 on exit."""
        from OCP.BRepAdaptor import BRepAdaptor_Surface
        from OCP.GeomAbs import GeomAbs_Cone, GeomAbs_Cylinder, GeomAbs_Plane, GeomAbs_SurfaceOfExtrusion
        from OCP.gp import gp_Pnt, gp_Vec
        from OCP.TopAbs import TopAbs_REVERSED

        face = found.Face(number)
        surface = BRepAdaptor_Surface(face, False)
        point, du, dv = gp_Pnt(), gp_Vec(), gp_Vec()
        surface.D1(found.UParameter(number), found.VParameter(number), point, du, dv)
        across = du.Crossed(dv)
        normal = np.array([across.X(), across.Y(), across.Z()])
        normal *= (-1.0 if face.Orientation() == TopAbs_REVERSED else 1.0) / np.linalg.norm(normal)
        flat = (GeomAbs_Plane, GeomAbs_Cylinder, GeomAbs_Cone, GeomAbs_SurfaceOfExtrusion)
        return distance, normal, surface.GetType() not in flat, -1 if normal @ self.direction > 0.0 else 1


ROUNDS = 30
CLOSE = 1e-11
"""Step of Newton's method, in parameters, below which a hit is found."""
EDGE = 1e-9
"""Parameters by which a hit may lie outside the patch."""
BOX_ROOM = 1e-6
"""Part of its diagonal by which the box of a patch is widened."""


@dataclass(frozen=True, eq=False)
class PlacedPatch:
    """One lens patch at its placement.

    control : (m, n, 4) homogeneous, mm
    sense : −1 if it faces against du × dv
    middle : (2,) mm
        x and y in the middle of its parameters; the patch belongs to the cell that contains this point.
    box : (2, 3) mm. Least and greatest coordinates of its poles.
    """

    control: Floats
    sense: float
    middle: Floats
    box: Floats

    def near(self, position: Floats, direction: Floats) -> Ints:
        """Rows of the rays that cross the box of the patch's poles, which holds the patch."""
        low, high = self.box
        with np.errstate(all="ignore"):
            ends = (
                position[:, None, :2]
                + direction[:, None, :2] * ((self.box[:, 2] - position[:, 2:]) / direction[:, 2:])[..., None]
            )
            room = BOX_ROOM * np.linalg.norm(high - low)
            aside = (ends.max(axis=1) < low[:2] - room) | (ends.min(axis=1) > high[:2] + room)
        return np.flatnonzero(~aside.any(axis=1))


@dataclass(frozen=True, eq=False)
class Cells:
    """Cell of an array that a point lies over: a patch may extend beyond the cell of its lens.

    array : 0 or 1
    """

    window: Window
    array: int

    def of(self, place: Floats) -> NDArray[np.int64]:
        """Cells (n, 2) of points (n, 2), mm."""
        at = place / millimetres(self.window.unit)
        return self.window.locate(self.array, at[:, 0], at[:, 1])[0]


def column_patches(scan: StepScan, low: Floats, high: Floats) -> list[PlacedPatch]:
    """Patches of all instances whose poles reach into a column low … high (2,) of x and y."""
    found = []
    for group in scan.groups:
        middles, reaches, _ = group.span
        for row in group.near(low, high).tolist():
            poles, weights = group.poles[row], group.weights[row]
            flat, middle, reach = poles.reshape(-1, 3), middles[row], reaches[row]
            where = scan.parts[group.part[row]].placements
            near = where.at(where.near(low - reach - middle[:2], high + reach - middle[:2]))
            at = applied(near, middle[None])[:, 0, :2]
            for placement in near[((at > low - reach) & (at < high + reach)).all(axis=1)]:
                placed = applied(placement, flat).reshape(poles.shape)
                over = placed.reshape(-1, 3)
                box = np.array([over.min(axis=0), over.max(axis=0)])
                if (box[1, :2] < low).any() or (box[0, :2] > high).any():
                    continue
                control = np.concatenate([placed * weights[..., None], weights[..., None]], axis=-1)
                half = np.array([0.5])
                middle = _surface(control, half, half)[0][0, :2]
                found.append(PlacedPatch(control, float(group.sense[row]), middle, box))
    return found


def first_hits(
    patches: Sequence[PlacedPatch], cells: Cells, position: Floats, direction: Floats, entering: bool
) -> tuple[Floats, Floats]:
    """Distances (n,) to the first patch that faces against the light (entering) or along it, NaN for none.

    Returned with unit normals (n, 3) in the direction of the light. A patch counts only over its own cell.
    """
    best, normal = np.full(len(position), np.inf), np.zeros_like(position)
    for patch in patches:
        rows = patch.near(position, direction)
        if not len(rows):
            continue
        away, outward = _meet(patch, position[rows], direction[rows])
        facing = np.einsum("ij,ij->i", outward, direction[rows])
        with np.errstate(invalid="ignore"):
            closer = (away < best[rows]) & (facing < 0.0 if entering else facing > 0.0) & (away > NEAREST)
        rows, away, outward = rows[closer], away[closer], outward[closer]
        place = position[rows, :2] + away[:, None] * direction[rows, :2]
        own = (cells.of(place) == cells.of(patch.middle[None])).all(axis=1)
        best[rows[own]] = away[own]
        normal[rows[own]] = outward[own] * (-1.0 if entering else 1.0)
    return np.where(np.isfinite(best), best, np.nan), normal


def plane_hits(face: Face, scale: float, position: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Distances and normals as of `first_hits` for a plane face, which is no lens: it is taken from the
    design.
    """
    away = (face.vertex[2] * scale - position[:, 2]) / direction[:, 2]
    return np.where(away > 0.0, away, np.nan), np.broadcast_to([0.0, 0.0, 1.0], direction.shape)


def _meet(patch: PlacedPatch, position: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Distance (n,) along rays, NaN where the patch is not met, and outward unit normal (n, 3)."""
    helper = np.where(np.abs(direction[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    one = np.cross(direction, helper)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    two = np.cross(direction, one)
    u, v = np.full(len(position), 0.5), np.full(len(position), 0.5)
    step = np.full(len(position), np.inf)
    with np.errstate(all="ignore"):
        for _ in range(ROUNDS):
            place, du, dv = _surface(patch.control, u, v)
            away = place - position
            f, g = np.einsum("ij,ij->i", away, one), np.einsum("ij,ij->i", away, two)
            fu, fv = np.einsum("ij,ij->i", du, one), np.einsum("ij,ij->i", dv, one)
            gu, gv = np.einsum("ij,ij->i", du, two), np.einsum("ij,ij->i", dv, two)
            det = fu * gv - fv * gu
            su, sv = (f * gv - fv * g) / det, (fu * g - f * gu) / det
            u, v = np.clip(u - su, -0.5, 1.5), np.clip(v - sv, -0.5, 1.5)
            step = np.maximum(np.abs(su), np.abs(sv))
            if not (step > CLOSE).any():
                break
        place, du, dv = _surface(patch.control, u, v)
        normal = patch.sense * np.cross(du, dv)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        met = (step <= CLOSE) & (np.abs(u - 0.5) <= 0.5 + EDGE) & (np.abs(v - 0.5) <= 0.5 + EDGE)
        distance = np.einsum("ij,ij->i", place - position, direction)
    return np.where(met, distance, np.nan), normal


def _surface(control: Floats, u: Floats, v: Floats) -> tuple[Floats, Floats, Floats]:
    """Points and tangents (n, 3) at parameters (n,)."""
    u, v = u[:, None], v[:, None]
    rows = casteljau(np.broadcast_to(control[:, :, None], (*control.shape[:2], len(u), 4)), u)
    return across_rows(*rows, v)


def follow_patches(
    path: str | os.PathLike[str],
    position: Any,
    direction: Any,
    faces: Sequence[Crossing],
    low: Sequence[float],
    high: Sequence[float],
    window: Window,
    numbers: Sequence[int],
) -> dict[str, Any]:
    """Trace rays through the lens patches of a file's text.

    path, position, direction, faces, low, high : As in `clacad.formats.step.rays_through_faces.follow_rays`.
    window, numbers : The same faces as numbers of a window in the order in which light meets them.
    Returns dict of lists : as of `clacad.formats.step.rays_through_faces.follow_rays`; `curved` is true
        everywhere.
    """
    patches = _kept(path, tuple(low), tuple(high))
    paths = RayPaths.begun(position, direction, len(faces))
    place, way = paths.position, paths.direction
    live = np.arange(len(place))
    for step, (number, (before, after, _)) in enumerate(zip(numbers, faces, strict=True)):
        face = window.faces[number]
        if face.array is None:
            distance, normal = plane_hits(face, millimetres(window.unit), place[live], way[live])
        else:
            cells = Cells(window, face.array)
            distance, normal = first_hits(patches, cells, place[live], way[live], face.side > 0)
        met = np.isfinite(distance)
        paths.end[live[~met]] = 1
        live, distance, normal = live[met], distance[met], normal[met]
        place[live] += distance[:, None] * way[live]
        paths.hits[live, step], paths.crossings[live] = place[live], step + 1
        root = np.einsum("ij,ij->i", normal, way[live])
        bent, _ = refract(way[live], normal, root, before, after)
        out = np.isfinite(bent).all(axis=1)
        paths.end[live[~out]] = 3
        live = live[out]
        way[live] = bent[out]
    return paths.to_lists(np.ones((len(place), len(faces)), dtype=bool))


_PATCH_COLUMNS: dict[tuple[object, ...], list[PlacedPatch]] = {}


def _kept(path: str | os.PathLike[str], low: tuple[float, ...], high: tuple[float, ...]) -> list[PlacedPatch]:
    """The patches of a column; kept for the next call in this process."""
    from clacad.formats.step.read_back import kept, scanned, state_of

    key = (*state_of(path), low, high)
    return kept(_PATCH_COLUMNS, key, lambda: column_patches(scanned(path), np.array(low), np.array(high)))
