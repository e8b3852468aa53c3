"""Field lenses: faces at the common focus that image lens 1 onto lens 2, so that light of any slope reaches
its partner.

All light of one direction meets in one point at the common focus. A lens there changes where light hits lens
2 and leaves the law unchanged; 1/f_F = 1/f1 + 1/f2 per meridian. Its vertex and its cells lie on the straight
line (slopes in air) from the centre of cell 1 to that of cell 2.

Two plates (slab, η the same in both meridians)
    Both inner faces have power, 1/f_k on the plate that carries lens k, so that for η = −1 both plates are
    identical. Plates n f_k thick with an air gap g between them and lenses of 1/a_k = 1/f_k − g/(2 f_k²) are
    afocal together with exactly η, and image lens 1 exactly onto lens 2, for any g. Their radii are those of
    the slab to within a relative g/2f.
One plate (biconvex, plano; slab with different η in its meridians)
    A plano-convex field lens with its vertex at the focus, or two crossed arrays of cylinders, each at the
    focus of its own meridian. The plate is then n |f1x − f1y| thick, and lens 2 is moved away by (1 − 1/n)
    times that, so that nothing changes along the axis. A slab becomes array 1, plate and array 2, with air
    between.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt
from typing import Any

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.base.vectors import xy
from clacad.design.process_profiles import profile
from clacad.design.sections import LATTICE, LAW, PAIR, AimedAt
from clacad.design.varying import Planes
from clacad.optics.surface import Quadric
from clacad.prescription.bodies import FieldCells, Listed, bodies_of, shared
from clacad.prescription.intent import Intent, separation_of
from clacad.prescription.radii import NoSuchLens, field_focal_lengths, thin_pair
from clacad.sheet.volume_and_extent import FIELD as ARRAY
from clacad.sheet.window import IDENTITY, Body, Face, FieldLens

STEEPEST = 1.05
"""Least radius of a field face, over half the width of its cell."""

ROOM = 1.25
"""Factor on the process's least gap or edge for free dimensions: checks warn below this factor."""


def thin_field(eta: Pair2, separation: float) -> tuple[FieldLens, ...]:
    """Ideal field lens of a thin pair (lengths): one, or two cylinders in the order light reaches them."""
    first, _ = thin_pair(eta, separation)
    if first[0] == first[1]:
        return (FieldLens(field_focal_lengths(eta, separation), first[0]),)
    lenses = thin_cylinders(eta, separation)
    return lenses if first[0] < first[1] else lenses[::-1]


def thin_cylinders(eta: Pair2, separation: float) -> tuple[FieldLens, FieldLens]:
    """Ideal field lenses of x and of y, each at the focus of its own meridian (lengths)."""
    first, _ = thin_pair(eta, separation)
    power = field_focal_lengths(eta, separation)
    return FieldLens((power[0], np.inf), first[0]), FieldLens((np.inf, power[1]), first[1])


def refuse_too_steep(radius: float, intent: Intent, axis: int | None) -> None:
    """Refuse a field face (radius: length) that would end inside its cell along `axis`, or anywhere (None).

    Raises NoSuchLens.
    """
    tile = intent.lattice.tile() @ intent.turn[:2, :2]
    half = float(np.abs(tile).max(axis=0)[axis]) if axis is not None else 0.5 * max(intent.lattice.pitch)
    if axis is None and _conic(intent, 0.0) > -1.0:
        reach = intent.lattice.circumradius * sqrt(1.0 + _conic(intent, 0.0))
        half = max(half, reach / STEEPEST)
    if radius < STEEPEST * half:
        scale = radius / (STEEPEST * half)
        separation = intent.design.pair.separation
        further = "" if separation is None else f", or separation > {separation / scale:.6g}"
        raise NoSuchLens(
            f"the field lens would have the radius {radius:.6g}, less than {STEEPEST * half:.6g}: its surface"
            " ends inside the cell",
            key=LATTICE.pitch,
            hint=f"pitch < {max(intent.lattice.pitch) * scale:.6g}{further}",
            code="CL128",
        )


def _conic(intent: Intent, default: float) -> float:
    given = intent.design.pair.field.conic
    return default if given is None else given


def _sphere(radius: float, side: int, conic: float) -> Quadric:
    return Quadric(1.0 / radius, 1.0 / radius, (1.0 + conic) / radius, side)


def _cylinder(radius: float, axis: int, side: int, conic: float) -> Quadric:
    """Cylinder with power in one meridian."""
    curvature = [0.0, 0.0]
    curvature[axis] = 1.0 / radius
    return Quadric(curvature[0], curvature[1], (1.0 + conic) / radius, side)


def air_gap(intent: Intent) -> float:
    """Air gap (length) between a slab's plates, vertex to vertex."""
    design = intent.design
    if design.pair.field.gap is not None:
        return design.pair.field.gap
    limit = design.check.clearance
    if limit is None:
        limit = profile(design.check.process).clearance / design.unit_m
    step = 2.0 * intent.lattice.circumradius * intent.steepest
    least = max(min(design.lattice.pitch) / 25.0, ROOM * limit, ROOM * step)
    if (etas := intent.etas_along_axes) is not None:
        least = max(least, ROOM * float(least_gap(etas, separation_of(intent), True).max()))
    return least


# -- two plates -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Plates:
    """Two plates, each with a lens and part of the field lens.

    focal_length : (a1, a2), lengths. Focal length of the lens of each plate, alone, in air.
    field : (f1, f2), lengths. Focal length of the field face of each plate, alone, in air; equal to the
        plate's thickness over index.
    gap : length
    """

    focal_length: Pair2
    field: Pair2
    gap: float

    @property
    def length(self) -> float:
        """Distance from lens 1 to lens 2 in air equivalents."""
        return self.field[0] + self.gap + self.field[1]

    def focused(self, planes: Planes) -> Plates:
        """Plates that image one plane to another (lengths, in air): the field lens keeps its image plane."""
        first, last = self.focal_length
        focal = first / (1.0 - first / planes.object), last / (1.0 + last / planes.image)
        return replace(self, focal_length=focal)

    def offset(self, delta: Floats, eta: float, slope: Floats) -> Floats:
        """Vertex of lens 2 (2,), lengths off lens 1's axis, for δ (2,) and field centre `slope` (2,)."""
        last = self.focal_length[1]
        return np.asarray(last * (-delta / eta - slope * (1.0 - 1.0 / eta - self.length / last)))


def paired_plates(eta: float, separation: float, gap: float) -> Plates:
    """Plates that are together afocal with exactly η (see the module's notes); lengths.

    Raises NoSuchLens: The gap is twice a focal length or more.
    """
    f1, f2 = (f[0] for f in thin_pair((eta, eta), separation))
    if gap >= 2.0 * min(f1, f2):
        raise NoSuchLens(
            f"an air gap of {gap:.6g} is too wide for field faces of focal length {min(f1, f2):.6g}",
            key=PAIR.field,
            hint=f"gap < {2.0 * min(f1, f2):.6g}",
            code="CL129",
        )
    a1, a2 = (f / (1.0 - 0.5 * gap / f) for f in (f1, f2))
    return Plates((a1, a2), (f1, f2), gap)


@dataclass(frozen=True, eq=False)
class FieldBodies:
    """Bodies of a window with a field lens.

    moved : (x, y), lengths. Displacement of array 2's cells.
    offset : (2,) lengths. Displacement of lens 2 from lens 1's axis, lens frame.
    `told` : The recipe's entries for the field lens.
    """

    bodies: tuple[Body, ...]
    moved: Pair2
    field: FieldCells
    offset: Floats
    told: dict[str, object]


def two_plates(intent: Intent, separation: float, scale: float) -> FieldBodies:
    """Two plates with the field lens on both inner faces, lens radii times `scale`; separation: length."""
    eta, n, own = intent.eta[0], intent.index, intent.etas_along_axes
    if own is not None:
        eta = 1.0 - separation / float(mean_focus(own[:1], separation)[0])
    plates = paired_plates(eta, separation, air_gap(intent))
    if (planes := intent.design.pair.focus) is not None:
        plates = plates.focused(planes)
    radius = [(n - 1.0) * a for a in plates.focal_length]
    inner = [(n - 1.0) * f for f in plates.field]
    for r in inner:
        refuse_too_steep(r, intent, None)
    thickness = [n * f for f in plates.field]
    legs = ((thickness[0], n), (plates.gap, 1.0), (thickness[1], n))
    delta, turn, top = np.asarray(intent.delta), intent.turn, thickness[0] + plates.gap
    height = top + thickness[1]
    slope = delta / (1.0 - eta)
    if starts_aligned(intent.design.lattice.aperture):
        slope = straight_above(turn, height) / plates.length
    chief = Chief.of(intent, slope * plates.length, plates.length, turn)
    across = [chief.across(legs[:k]) for k in (1, 2, 3)]
    before, behind, moved = (
        turn @ [*point, z] for point, z in zip(across, (thickness[0], top, height), strict=True)
    )
    offset = plates.offset(delta, eta, across[2] / plates.length)
    if intent.design.pair.vertex is not None:
        offset = np.array(intent.design.pair.vertex)
    conic, middle = _conic(intent, 0.0), 0.5 * (before + behind)[:2]
    rotation = shared(turn)

    def lens(number: int, side: int, place: Floats) -> Face:
        r = scale * radius[number]
        return Face(intent.shape.face((r, r), side, number), _vertex(place[:2], place[2]), rotation, number)

    def field(number: int, side: int, place: Floats) -> Face:
        turned = IDENTITY if own is None and intent.law.theta == 0.0 else rotation
        vertex = _vertex(place[:2] - middle, place[2])
        return Face(_sphere(inner[number], side, conic), vertex, turned, ARRAY)

    first, second = bodies_of(
        intent.listed(
            [
                (lens(0, +1, np.zeros(3)), intent.glass("array1")),
                (field(0, -1, before), None),
                (field(1, +1, behind), intent.glass("array2")),
                (lens(1, -1, turn @ [*offset, height] - [*moved[:2], 0.0]), None),
            ]
        )
    )
    told = {"R": inner, "f": field_focal_lengths(intent.eta, separation)[0], "conic": conic}
    told |= {"gap": plates.gap, "thickness": thickness, "equal_plates": _equal(first, second)}
    if own is not None:
        told |= {"reach": list(plates.field), "equal_plates": False}
    ends = plates.field[0] / plates.length, (plates.field[0] + plates.gap) / plates.length
    last = plates.focal_length[1]
    cells = FieldCells(
        xy(middle),
        0.5 * sum(ends) * np.eye(2),
        tuple(end * np.eye(2) for end in ends),
        np.zeros(3),
        1.0 - last * (1.0 - 1.0 / eta) / plates.length,
        (-last / eta, -last / eta),
    )
    return FieldBodies((first, second), xy(moved[:2]), cells, offset, told)


def _equal(first: Body, second: Body) -> bool:
    """Whether the second plate is the first one turned over: one part, ordered twice."""

    def mirrored(face: Face) -> tuple[object, ...]:
        s = face.surface
        return (type(s), *(getattr(s, name) for name in s.__dataclass_fields__ if name != "side"))

    places = [
        tuple(abs(v) for v in face.vertex[:2])
        for face in (first.front, first.back, second.back, second.front)
    ]
    thick = [body.back.vertex[2] - body.front.vertex[2] for body in (first, second)]
    return (
        mirrored(first.front) == mirrored(second.back)
        and mirrored(first.back) == mirrored(second.front)
        and not any(v for place in places for v in place)
        and abs(thick[0] - thick[1]) <= 1e-12 * thick[0]
    )


# -- field lenses of cells with an η each ------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FieldOfCells:
    """Field lenses of n cells with an η each, each at the focus of its own lens 1, over those of the law's η.

    size : (k, n). Scale factors of the k faces of the field lens, in the order of the light.
    lift : (k, n) lengths. Rise of these faces.
    share : (k, n). What their places on the line from cell 1 to cell 2 differ by.
    pull : (n,) or (n, 2). Displacement of lens 2 per displacement of its cell, along the lens axes.
    aspect : (k, n) or None. Curvature along y over that of the scaled face; None: 1 for all.
    """

    size: Floats
    lift: Floats
    share: Floats
    pull: Floats
    aspect: Floats | None = None

    @property
    def sharper(self) -> Floats | float:
        """Greater curvature of each face, along x or y, over that along x."""
        return 1.0 if self.aspect is None else np.maximum(self.aspect, 1.0)

    def of(self, rows: slice) -> FieldOfCells:
        """Those of some cells."""
        size, lift, share = (one[:, rows] for one in (self.size, self.lift, self.share))
        return FieldOfCells(
            size, lift, share, self.pull[rows], None if self.aspect is None else self.aspect[:, rows]
        )


def mean_focus(etas: Floats, separation: float) -> Floats:
    """Mean of the foci (n,) of both meridians behind lens 1, in air, for η (n, 2); lengths."""
    return np.asarray(separation * (1.0 / (1.0 - etas)).mean(axis=-1))


def least_gap(etas: Floats, separation: float, plates: bool) -> Floats:
    """Distances (n,) of the two field faces in air beyond which none is hollow, for η (n, 2); lengths.

    plates : Whether the faces lie on two plates, with the gap in addition to the separation.
    """
    off = separation / (1.0 - etas) - mean_focus(etas, separation)[:, None]
    if not plates:
        return np.asarray(2.0 * np.abs(off).max(axis=-1))
    return np.asarray(np.where(off > 0.0, (1.0 - 1.0 / etas) * off, (etas - 1.0) * off).max(axis=-1))


def toric(etas: Floats, before: Floats, gap: Floats | float, behind: Floats) -> tuple[Floats, Floats]:
    """Focal lengths (2, n, 2) of both lenses and powers (2, n, 2) of both field faces, lens axes.

    etas : (n, 2); before, gap, behind : from lens 1 to the faces and on to lens 2, in air, lengths
    """
    ends = before, behind
    power = [
        1.0 / end + (1.0 + ratio) / gap
        for end, ratio in ((before, behind / (etas * before)), (behind, etas * before / behind))
    ]
    focal = [
        (end + 0.5 * gap * (1.0 - one * end)) / (1.0 - 0.5 * gap * one)
        for end, one in zip(ends, power, strict=True)
    ]
    return np.stack(focal), np.stack(power)


def plates_of_cells(eta: Floats, separation: float, gap: float, index: float) -> tuple[Floats, FieldOfCells]:
    """Focal lengths (2, n) of lenses of `two_plates`, and their field lenses; of the first η the law's."""
    first = separation / (1.0 - eta)
    inner = np.stack([first, -eta * first])
    outer = inner / (1.0 - 0.5 * gap / inner)
    length = separation + gap
    pull = outer[1] * (1.0 - 1.0 / eta) / length
    lift = np.stack([first - first[0]] * 2)
    return outer, FieldOfCells(inner / inner[:, :1], index * lift, lift / length, pull[0] - pull)


def plate_of_cells(focal: Floats, focus: Floats) -> FieldOfCells:
    """Field lenses on a plate with a plane back, behind lenses of focal lengths `focal` (2, n).

    focus : (n,) lengths. Height of the focus of lens 1 in each cell; of the first η the law's.
    """
    power, share = 1.0 / focal[0] + 1.0 / focal[1], focal[0] / focal.sum(axis=0)
    still = np.zeros_like(focus)
    return FieldOfCells(
        np.stack([power[0] / power, still + 1.0]),
        np.stack([focus - focus[0], still]),
        np.stack([share - share[0], still]),
        still,
    )


# -- one plate --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FieldPlate:
    """Plate with the field lens, and positions of its faces; lengths along the lens axis.

    foci : (x, y). Foci of lens 1 in air, from its reference point; the plate's front is at the nearer one.
    `told` : The recipe's entries for the plate.
    """

    foci: Pair2
    thickness: float
    told: dict[str, object]

    @property
    def crossed(self) -> bool:
        """Whether each face has power in one meridian."""
        return self.foci[0] != self.foci[1]

    def added(self, index: float) -> float:
        """Additional distance of lens 2 because of the plate (length)."""
        return self.thickness * (1.0 - 1.0 / index)


def symmetric_foci(radius: Pair2, thickness: float, index: float) -> Pair2:
    """Distance (x, y) from the centre of a lens with faces R, −R to its focus in air (lengths)."""
    x, y = (_behind_centre(r, thickness, index) for r in radius)
    return x, y


def _behind_centre(radius: float, thickness: float, index: float) -> float:
    shrunk = (index - 1.0) * thickness / (index * radius)  # relative reduction of the beam from face to face
    power = (index - 1.0) * (2.0 - shrunk) / radius
    return 0.5 * thickness + (1.0 - shrunk) / power


def one_plate(intent: Intent, focal_length: tuple[Pair2, Pair2], foci: Pair2, behind: float) -> FieldPlate:
    """Field plate for the given foci of lens 1, with `behind` of air between the far focus and the next body.

    focal_length : ((f1x, f1y), (f2x, f2y)), lengths. Focal lengths of lens 1 and lens 2 as built.
    Raises NoSuchLens: A face ends inside its cell, or there is no room for the plate.
    """
    n = intent.index
    power = [f1 * f2 / (f1 + f2) for f1, f2 in zip(*focal_length, strict=True)]
    radius = [(n - 1.0) * f for f in power]
    crossed = foci[0] != foci[1]
    for axis in (0, 1):
        refuse_too_steep(radius[axis], intent, axis if crossed else None)
    thickness = _plate_thickness(intent, radius, foci, behind)
    room = behind - (0.0 if crossed else thickness / n)
    if room <= 0.0 or behind <= 0.0:
        raise NoSuchLens(
            f"there is no room for the field plate: it would reach {-room:.4g} into the body behind it",
            key=PAIR.separation,
            hint="a larger separation, or thinner lenses",
            code="CL129",
        )
    told: dict[str, object] = {
        "R": radius if crossed else radius[0],
        "f": power if crossed else power[0],
        "conic": _conic(intent, -(n**2)),
        "thickness": thickness,
    }
    return FieldPlate(foci, thickness, told)


def split_plate(intent: Intent, etas: Floats, f1: float, glass: Pair2, place: float) -> FieldPlate:
    """Field plate with power on both faces, about the mean focus of lens 1, for η (m, 2) of law and cells.

    f1 : air from the reference point of lens 1 to the focus (length); glass : of it, and behind it, what the
        lenses take up; place : height of the focus over that point
    Raises NoSuchLens: There is no room for the plate.
    """
    n, separation = intent.index, separation_of(intent)
    mean, f2 = mean_focus(etas, separation), separation - f1
    room = f1 - glass[0], f2 - glass[1]
    radius = (n - 1.0) * f1 * f2 / separation
    thick = _plate_thickness(intent, [radius, radius], (f1, f1), min(room))
    thick = max(thick, n * ROOM * float(least_gap(etas, separation, False).max()))
    half, rise = 0.5 * thick / n, mean - mean[0]
    left = min(room[0] + float(rise.min()), room[1] - float(rise.max())) - half
    if left <= 0.0:
        raise NoSuchLens(
            f"there is no room for the field plate, {thick:.4g} thick for foci {2.0 * half / ROOM:.4g} apart:"
            f" it would reach {-left:.4g} into a lens",
            key=PAIR.separation,
            hint="a larger separation, thinner lenses, or an eta_x nearer to eta_y",
            code="CL129",
        )
    reach = np.array([[f1 - half]]), np.array([[f2 - half]])
    _, power = toric(np.array([[-f2 / f1]]), reach[0], 2.0 * half, reach[1])
    told: dict[str, object] = {
        "R": [(n - 1.0) / float(one) for one in power.ravel()],
        "f": f1 * f2 / separation,
        "conic": _conic(intent, 0.0),
        "thickness": thick,
        "reach": [f1 - half, f2 - half],
    }
    return FieldPlate((place - half, place - half), thick, told)


def _plate_thickness(intent: Intent, radius: list[float], foci: Pair2, behind: float) -> float:
    """Thickness (length) of a field plate: from focus to focus of cylinders, else sag and neck."""
    n, design = intent.index, intent.design
    tile = np.abs(intent.lattice.tile() @ intent.turn[:2, :2]).max(axis=0)
    sag = sum(float(tile[k]) ** 2 / (2.0 * radius[k]) for k in (0, 1))
    least = sag + intent.neck + 2.0 * intent.lattice.circumradius * intent.steepest
    if foci[0] == foci[1]:
        edge = design.check.edge
        edge = profile(design.check.process).edge / design.unit_m if edge is None else edge
        wanted = least + max(ROOM * edge, max(design.lattice.pitch))
        return max(least, min(wanted, 0.5 * n * behind))
    thickness = n * abs(foci[0] - foci[1])
    if thickness < least:
        raise NoSuchLens(
            f"the foci lie {abs(foci[0] - foci[1]):.4g} apart, so that the plate between the field faces"
            f" would be {thickness:.4g} thick: they need {least:.4g}",
            key=LAW.eta,
            hint=f"eta_x = eta_y (one field lens), or focal lengths f1 at least {least / n:.4g} apart",
            code="CL129",
        )
    return thickness


def plate_faces(
    intent: Intent, plate: FieldPlate, chief: Chief, legs: Legs, front: int, turn: Floats
) -> tuple[list[Listed], FieldCells]:
    """The plate's faces and its cells.

    legs : segments of the ray from lens 1 to lens 2, of which the first `front` lead to the plate
    turn : (3, 3). Lens → sheet.
    """
    reached = legs[:front], legs[: front + 1]
    points = [chief.across(some) for some in reached]
    near_end, far_end = (_reduced(some) / _reduced(legs) for some in reached)
    added = plate.added(intent.index) * turn[:, 2]
    power_of: Any = plate.told["R"]
    conic: Any = plate.told["conic"]
    near = min(plate.foci)
    first, last = (
        turn @ np.array([*point, z]) for point, z in zip(points, (near, near + plate.thickness), strict=True)
    )
    tilted = intent.steepest != 0.0
    rotation = shared(turn if tilted or plate.crossed else IDENTITY)
    if not plate.crossed:
        split = isinstance(power_of, list)
        radii: list[float] = power_of if isinstance(power_of, list) else [power_of]
        rotation = shared(turn) if split else rotation
        lens = Face(_sphere(radii[0], +1, conic), (0.0, 0.0, float(first[2])), rotation, ARRAY)
        back = _sphere(radii[1], -1, conic) if split else Quadric(0.0, 0.0, 0.0, -1)
        plane = Face(back, (0.0, 0.0, float(last[2])))
        if tilted or split:
            vertex = _vertex(last[:2] - first[:2], float(last[2]))
            plane = replace(plane, vertex=vertex, rotation=rotation, array=ARRAY)
        cells = FieldCells(
            xy(first[:2]), near_end * np.eye(2), (near_end * np.eye(2), far_end * np.eye(2)), added
        )
        return [(lens, intent.glass("field")), (plane, None)], cells
    axes = (0, 1) if plate.foci[0] < plate.foci[1] else (1, 0)
    # a cylinder is uniform along its axis: each face fixes the position of the cells across its own axis only
    middle = np.empty(2)
    for axis, point in zip(axes, points, strict=True):
        middle[axis] = point[axis]
    near_face, far_face = (
        Face(
            _cylinder(power_of[axis], axis, side, conic),
            (0.0, 0.0, float(at[2])),
            rotation,
            ARRAY,
        )
        for axis, side, at in zip(axes, (+1, -1), (first, last), strict=True)
    )
    own = np.zeros(2)
    own[list(axes)] = near_end, far_end
    share = turn[:2, :2] @ np.diag(own) @ turn[:2, :2].T
    cells = FieldCells(xy(turn[:2, :2] @ middle), share, (share,), added)
    return [(near_face, intent.glass("field")), (far_face, None)], cells


# -- the chief ray of the field centre --------------------------------------------------------------

Legs = tuple[tuple[float, float], ...]
"""Segments of a ray across parallel planes: length along the axis, refractive index."""


def starts_aligned(aperture: str | Pair2 | AimedAt) -> bool:
    """Whether cells 2 lie over cells 1, as they do before they are aimed at a point."""
    return aperture == "aligned" or isinstance(aperture, AimedAt)


def straight_above(turn: Floats, height: float) -> Floats:
    """Point (2,), lens frame, over the origin in the plane at a `height` along the lens axis (lengths)."""
    return np.asarray(height / turn[2, 2] * turn[2, :2])


def _reduced(legs: Legs) -> float:
    """Length of segments in air equivalents, to first order."""
    return sum(length / index for length, index in legs)


@dataclass(frozen=True, eq=False)
class Chief:
    """Ray from the centre of cell 1 to that of cell 2, lens frame.

    slope : (2,). Slope in air.
    exact : Whether the ray is refracted exactly, because the design gives its slope; else to first order, as
        lenses are placed.
    """

    slope: Floats
    exact: bool

    @staticmethod
    def of(intent: Intent, to_cell_2: Floats, reduced: float, turn: Floats) -> Chief:
        """Ray for the design's aperture; `to_cell_2` (2,), lens frame, at `reduced` in air, lengths."""
        aperture = intent.design.lattice.aperture
        if isinstance(aperture, str | AimedAt):
            return Chief(to_cell_2 / reduced, False)
        ray = np.array([*aperture, 1.0]) @ turn
        return Chief(ray[:2] / ray[2], True)

    def across(self, legs: Legs) -> Floats:
        """Lateral displacement (2,), lengths, of the ray over the segments."""
        square = float(self.slope @ self.slope)
        run = 0.0
        for length, index in legs:
            # n sin θ' = sin θ: in glass the tangent is smaller than tan θ / n
            run += length / (sqrt(index * index * (1.0 + square) - square) if self.exact else index)
        return self.slope * run


def _vertex(place: Floats, z: float) -> tuple[float, float, float]:
    return float(place[0]), float(place[1]), z
