"""Fabrication errors of a sheet: parameters, how a sample draws them, and a telescopelet that has them.

Errors of radius, index and thickness change the bodies of the window. Decentre, rotation, separation and
tilt are rigid motions of a whole array, so their effect on a telescopelet depends on its position in the
sheet. No effect is linearized: the faces are moved, and light is traced through them.

Sample k depends on the seed and on k only. Its numbers are those of a counter-based generator (Philox
4×64-10: Salmon, Moraes, Dror, Shaw, SC'11) whose counter holds k and a hash of the parameter's name.
Samples can therefore be drawn in any order, on any machine, and an additional parameter does not change the
numbers of others.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import dist
from statistics import NormalDist
from typing import TYPE_CHECKING
from zlib import crc32

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.base.vectors import rotated_by
from clacad.optics.ledger import Ledger
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.optics.sequence import Interface, unit_directions
from clacad.optics.surface import Surface, resized
from clacad.sheet.face_order import lined_face, plates_of, refractions
from clacad.sheet.feasibility import thicker
from clacad.sheet.plate import Plate
from clacad.sheet.shrunk import grown_surface
from clacad.sheet.window import Body, Face, Window, in_optical_tile

if TYPE_CHECKING:
    from clacad.design import Design


Errors = Mapping[str, float]

ON_BORDER = 1.0 - 1e-12
"""Factor on places in a cell: rounding takes no ray on its border out of it."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Rigid motion of an array: x → pivot + turn (x − pivot) + shift, sheet frame, lengths."""

    turn: Floats
    shift: Floats
    pivot: Floats

    def moves(self, point: Floats) -> Floats:
        """Displacement (…, 3) of points (…, 3)."""
        return np.asarray((point - self.pivot) @ (self.turn - np.eye(3)).T + self.shift)


@dataclass(frozen=True, eq=False)
class Telescopelet:
    """Faces of one telescopelet as made, or of several that differ by their places in the sheet alone.

    window : The window as made (radii, indices, thicknesses); gives the cells.
    faces : list of (Face, array, Motion)
        For each interface: the design's face, the array it moves with, and the motion of that array.
    seq : list of Interface. Of the first telescopelet, relative to the nominal centre of its cell 1.
    vertices : (f, m, 3) lengths. Vertices of all telescopelets, relative to those centres.
    centres : (m, 2) lengths. Nominal centres of their cells 1 in the sheet.
    noses : Errors `NOSES`: a tool nose rounds seams, and light through them is not of this telescopelet.
    """

    window: Window
    seq: list[Interface]
    faces: list[tuple[Face, int, Motion]]
    vertices: Floats
    centres: Floats
    noses: Errors = field(default_factory=dict)

    def send(self, rays: Rays) -> TraceResult:
        """Trace rays given about the cell's centre; ALIVE are those that stay in this telescopelet, else
        WALL.

        Of the result, fates and directions alone are computed; directions are NaN where a ray ended on the
        way. A ray counts if it hits every lens face in the optical zone of this cell, where the lens is not
        buried in land and has no opaque line, and leaves forwards.
        """
        ledger = Ledger.blank(len(rays), 0)
        ledger.direction[:], good = self.through(
            rays.position, unit_directions(rays.direction)[0], np.zeros(len(rays), dtype=np.int64)
        )
        ledger.fate[:] = np.where(good, Fate.ALIVE, Fate.WALL)
        return ledger.closed()

    def through(self, start: Floats, ray: Floats, which: Ints) -> tuple[Floats, Bools]:
        """Directions (n, 3) behind the sheet, NaN where a ray ended; which rays stay in their telescopelet.

        which : (n,). The telescopelet of each ray.
        """
        from clacad.tracing.compiled.face import FaceSequences, through_faces
        from clacad.tracing.compiled.packing import surface_row

        place, shifts = np.pad(self.centres, ((0, 0), (0, 1))), np.pad(self.window.shifts, ((0, 0), (0, 1)))
        cells = FaceSequences(
            np.array([surface_row(one.surface, one.rotation) for one in self.seq]),
            np.array([[one.index_before, one.index_after] for one in self.seq]),
            self.vertices,
            np.array([motion.turn for _, _, motion in self.faces]),
            np.array(
                [shifts[array] + motion.moves(place + shifts[array]) for _, array, motion in self.faces]
            ),
        )
        out, hits = np.array(ray), np.empty((len(self.seq), *ray.shape))
        through_faces(cells, which, start, out, hits)
        return out, np.isfinite(out[:, 0]) & self._inside(hits)

    def _inside(self, hits: Floats) -> Bools:
        """Which rays (n,) hit every lens face in the optical zone; hits (f, n, 3) in the frames of cells."""
        from clacad.design.process import Process
        from clacad.tracing.facets.made_surface import MadeSurface

        window, lined = self.window, lined_face(self.window)
        lenses = [k for k, (face, _, _) in enumerate(self.faces) if face.array is not None]
        across = ON_BORDER * hits[lenses, :, :2]
        good = in_optical_tile(window, across[..., 0], across[..., 1]).all(axis=0)
        processes = [Process(NOSES[name], radius * window.unit) for name, radius in self.noses.items()]
        for (x, y, z), (face, _, _) in zip(hits.transpose(0, 2, 1), self.faces, strict=True):
            if face is lined:
                lines = replace(window, land=replace(window.land, seam=window.land.line))
                good &= in_optical_tile(lines, x, y)
            if face.array is None:
                continue
            for process in processes:
                good &= ~MadeSurface(window, face, process).rounded(x, y)
            if face.land is not None:
                good &= face.land_side * (face.land - z) >= 0.0
        return np.asarray(good)


def telescopelet(window: Window, errors: Errors, centre: Floats | None = None) -> Telescopelet:
    """Build the faces of the telescopelet whose cell 1 is centred at `centre` (2,), default the sheet's
    middle; of several for centres (m, 2).

    Parameters
    ----------
    window : Window
        As designed.
    errors : mapping
        Parameter name (`clacad.verification.tolerance.misaligned`) to error, in design units, radians or as a
        ratio; parameters without an entry have no error.
    """
    at = np.zeros((1, 2)) if centre is None else np.array(centre, dtype=np.float64, ndmin=2)
    made = as_made(window, errors)
    seq, faces, vertices = [], [], []
    plates = plates_of(made.bodies)
    between = [_between(made, errors, number) for number in range(1, max(2, len(plates) - 1))]
    motions = (_first(errors), _second(made, errors), *between)
    plate_of = [number for number, plate in enumerate(plates) for _ in plate]
    for body, face, before, after in refractions(made.bodies):
        array = body.arrays[0] if face.array is None else face.array
        vertex = np.asarray(face.vertex) + [*made.shifts[array], 0.0]
        number = plate_of[made.bodies.index(body)]
        motion = motions[array if len(plates) == 1 else _moves_with(number, len(plates))]
        moved = vertex + motion.moves(vertex + np.pad(at, ((0, 0), (0, 1))))
        turn = motion.turn @ face.rotation
        plain = np.array_equal(turn, np.eye(3))
        seq.append(Interface(face.surface, moved[0], before, after, None if plain else turn))
        faces.append((face, array, motion))
        vertices.append(moved)
    noses = {name: errors[name] for name in NOSES if name in errors}
    return Telescopelet(_baffled(made), seq, faces, np.array(vertices), at, noses)


def _moves_with(number: int, plates: int) -> int:
    """Number of the motion of a plate: 0 of the first, 1 of the last, from 2 on of those between."""
    if number == 0:
        return 0
    return 1 if number == plates - 1 else number + 1


def _baffled(window: Window) -> Window:
    """Window in which baffle walls narrow the zone of a cell as a seam does."""
    if window.baffle is None:
        return window
    return replace(window, land=replace(window.land, seam=max(window.land.seam, window.baffle.wall)))


def as_made(window: Window, errors: Errors) -> Window:
    """The window with its radii, indices and thicknesses as made."""
    bodies: list[Body] = []
    parts = {id(face): part for _, part, face in _curved(window)}
    risen, gap = 0.0, 0  # of listed plates: all that lies behind a thicker body or gap moves away
    for number, body in enumerate(window.bodies, 1):
        front, back = (
            _face_as_made(window, face, parts.get(id(face)), errors) for face in (body.front, body.back)
        )
        if body.joined:
            front = bodies[-1].back.seen_from_behind
        made = replace(body, front=front, back=back, index=body.index + errors.get(f"index.{number}", 0.0))
        change = errors.get(f"thickness.{number}", 0.0)
        if window.form == "plates":
            if not body.joined:
                risen += errors.get(f"gap.{gap}", 0.0)
                gap += 1
                made = replace(made, front=_risen(front, risen))
            risen += change
            made = replace(made, back=_risen(back, risen))
        elif window.form == "slab" and len(window.bodies) == 2:
            made = _thicker_outside(made, change, number)
        elif window.form != "slab":
            made = thicker(made, change) if change else made
        bodies.append(made)
    return replace(window, bodies=tuple(bodies))


def _face_as_made(window: Window, face: Face, part: str | None, errors: Errors) -> Face:
    """The face with the errors of its radii, of the place of its lenslet, and of its process."""
    if part is None:
        return face
    alone = (
        errors.get(f"scatter_{name}", 0.0)
        for name in (f"pitch.{part}.x", f"pitch.{part}.y", f"vertex.{part}")
    )
    x, y, z = (place + step for place, step in zip(face.vertex, alone, strict=True))
    larger = errors.get(f"radius.{part}", 0.0) + errors.get(f"scatter_radius.{part}", 0.0)
    low, narrow = 1.0 - errors.get("shrinkage", 0.0), 1.0 - errors.get("shrinkage_lateral", 0.0)
    surface: Surface = grown_surface(grown(face.surface, larger), (narrow, narrow, low))
    bent = replace(face, surface=surface)
    if gamma := errors.get("gamma", 0.0):
        from clacad.design.process import Process
        from clacad.optics.fit import nearest_polynomial
        from clacad.tracing.facets.made_surface import MadeSurface

        made = MadeSurface(window, bent, Process(gamma=1.0 + gamma))
        u, v = made.lens.grid
        rise = face.side * (made.lens(u, v)[0] - made.wished(u, v)[0])
        u, v = u - face.vertex[0], v - face.vertex[1]
        surface, up, _ = nearest_polynomial(surface, u, v, surface.sag(u, v) + rise)
        z += up
    return replace(face, surface=surface, vertex=(x, y, z))


def _thicker_outside(body: Body, change: float, number: int) -> Body:
    """First or second plate of a slab with a field lens, `change` (length) thicker; the air gap is kept."""
    if number == 1:
        x, y, z = body.front.vertex
        return replace(body, front=replace(body.front, vertex=(x, y, z - change)))
    x, y, z = body.back.vertex
    return replace(body, back=replace(body.back, vertex=(x, y, z + change)))


def _risen(face: Face, rise: float) -> Face:
    """The face, `rise` (length) higher."""
    x, y, z = face.vertex
    return replace(face, vertex=(x, y, z + rise))


def grown(surface: Surface, part: float) -> Surface:
    """The surface with all radii larger by a relative `part`."""
    return surface if part == 0.0 else resized(surface, 1.0 + part)


def _first(errors: Errors) -> Motion:
    """Motion of array 1, the reference of the others; it may be decentred."""
    shift = np.array([errors.get("decentre.1.x", 0.0), errors.get("decentre.1.y", 0.0), 0.0])
    return Motion(np.eye(3), shift, np.zeros(3))


def _between(window: Window, errors: Errors, number: int) -> Motion:
    """Motion of a plate between the first and the last, number 1, 2 …: decentred, turned and tilted."""
    name = number + 2
    shift = np.array([errors.get(f"decentre.{name}.{axis}", 0.0) for axis in "xy"] + [0.0])
    turns = [errors.get(f"tilt.{name}.{axis}", 0.0) for axis in "xy"] + [errors.get(f"rotation.{name}", 0.0)]
    if not any(turns):
        return Motion(np.eye(3), shift, np.zeros(3))
    plate = plates_of(window.bodies)[number]
    height = 0.5 * (plate[0].front.vertex[2] + plate[-1].back.vertex[2])
    return Motion(rotated_by(*turns), shift, np.array([0.0, 0.0, height]))


def _second(window: Window, errors: Errors) -> Motion:
    """Motion of array 2: decentred, turned about the normal, tilted about x and y, its spacer too high."""
    heights = [face.vertex[2] for face in window.faces if face.array == 1]
    pivot = np.array([*window.shifts[1], sum(heights) / len(heights)])
    up = errors.get("separation", 0.0)
    if len(window.bodies) == 1:
        up += errors.get("thickness.1", 0.0)
    shift = np.array([errors.get("decentre.2.x", 0.0), errors.get("decentre.2.y", 0.0), up])
    loose = errors.get("pins.turn", 0.0)
    turn = rotated_by(
        errors.get("tilt.x", 0.0), errors.get("tilt.y", 0.0), errors.get("rotation", 0.0) + loose
    )
    about_pins = (rotated_by(0.0, 0.0, loose) - np.eye(3)) @ np.append(
        pivot[:2] - _middle_of_pins(window, pivot), 0.0
    )
    play = np.array([errors.get("pins.x", 0.0), errors.get("pins.y", 0.0), 0.0])
    return Motion(turn, shift + play + about_pins, pivot)


def _middle_of_pins(window: Window, pivot: Floats) -> Floats:
    """The point (2,) about which pins let a plate turn; `pivot` without pins."""
    holes = window.outline.holes if isinstance(window.outline, Plate) else ()
    pins = [(hole.x, hole.y) for hole in holes if hole.purpose == "pin"]
    return np.mean(pins, axis=0) if pins else pivot[:2]


OF_PROCESS = ("shrinkage", "shrinkage_lateral", "gamma")
"""Errors of the process that change the form of all lens faces."""

NOSES = {"nose": "diamond-turning", "nose.insert": "moulding"}
"""Error of a nose, and a process whose tool cuts the part, or the insert that it is moulded in."""

SIGMAS = 2.0
"""Standard deviations of a normal distribution in a stated tolerance."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One fabrication error.

    Parameters
    ----------
    name : str
        Such as "decentre.2.x": the key, the array, the direction or face. 1 is the first plate, 2 the last,
        3 and up those between in the order of the light; "gap.1" is the air behind the first plate.
    key : str
        Key of [tolerances] that sets it; "play" of body.pins.
    half : float
        Stated tolerance: ±half, in design units, radians or as a ratio; 0 … half where one-sided.
    unit : str
        Design unit, "rad" or "".
    one_sided : bool
        Whether only positive errors exist (roughness).
    uniform : bool
        Whether all errors up to the tolerance are equally likely, regardless of the design's distribution
        (pin play).
    scatter : bool
        Whether every lenslet has an error of its own, with the standard deviation `half`, the same on every
        sheet.
    """

    name: str
    key: str
    half: float
    unit: str
    one_sided: bool = False
    uniform: bool = False
    scatter: bool = False


def parameters(design: Design, window: Window) -> tuple[Parameter, ...]:
    """Parameters of the design's [tolerances], in a fixed order; tolerances of 0 are omitted."""
    spec, unit = design.tolerances, design.unit
    found: list[Parameter] = []
    for array, half in enumerate(spec.decentre, 1):
        found += [Parameter(f"decentre.{array}.{axis}", "decentre", half, unit) for axis in "xy"]
    found.append(Parameter("rotation", "rotation", spec.rotation, "rad"))
    plates, listed = len(plates_of(window.bodies)), window.form == "plates"
    gaps = [f"gap.{gap}" for gap in range(1, plates)] if listed else ["separation"][: plates - 1]
    found += [Parameter(name, "separation", spec.separation, unit) for name in gaps]
    for name in range(3, plates + 1):
        aside = spec.of_array(spec.decentre, 2)
        found += [Parameter(f"decentre.{name}.{axis}", "decentre", aside, unit) for axis in "xy"]
        if listed:
            found.append(Parameter(f"rotation.{name}", "rotation", spec.rotation, "rad"))
            found += [Parameter(f"tilt.{name}.{axis}", "tilt", spec.tilt, "rad") for axis in "xy"]
    for array, part, _ in _curved(window):
        half = spec.of_array(spec.radius, array - 1)
        found.append(Parameter(f"radius.{part}", "radius", half, ""))
    bodies = range(1, len(window.bodies) + 1)
    found += [Parameter(f"index.{body}", "index", spec.index, "") for body in bodies]
    found += [
        Parameter(f"thickness.{body}", "thickness", spec.of_body(body, len(window.bodies)), unit)
        for body in bodies
    ]
    found += [Parameter(f"tilt.{axis}", "tilt", spec.tilt, "rad") for axis in "xy"]
    found.append(Parameter("roughness", "roughness", spec.roughness, unit, one_sided=True))
    found += [Parameter(name, name, getattr(spec, name), "") for name in OF_PROCESS]
    cuts = "nose.insert" if design.check.process == NOSES["nose.insert"] else "nose"
    found.append(Parameter(cuts, "nose", spec.nose, unit, one_sided=True))
    found += _play(design)
    found += _scatter(design, window)
    return tuple(p for p in found if p.half > 0.0)


def _play(design: Design) -> list[Parameter]:
    """Parameters of the play that pins leave array 2 relative to array 1.

    A pin of diameter d in holes of d + p has p/2 of room all round in either plate. Plate 2 therefore moves
    up to p relative to plate 1 along x and along y. Where the pins farthest apart, at distance L, allow
    opposite motions, it turns by 2 p/L about the middle of the pins. Nothing centres a plate in its play: all
    positions are equally likely. The three are drawn independently; together they cover every pose that the
    pins allow, and some that they do not.
    """
    pins = design.body.pins
    if pins is None:
        return []
    apart = max(dist(a, b) for a in pins.at for b in pins.at)
    return [
        Parameter("pins.x", "play", pins.play, design.unit, uniform=True),
        Parameter("pins.y", "play", pins.play, design.unit, uniform=True),
        Parameter("pins.turn", "play", 2.0 * pins.play / apart, "rad", uniform=True),
    ]


def _scatter(design: Design, window: Window) -> Iterator[Parameter]:
    """Parameters of the errors that differ from lenslet to lenslet, face by face."""
    spec = design.tolerances
    for array, part, _ in _curved(window):
        pitch, radius, vertex = (
            spec.of_array(halves, array - 1)
            for halves in (spec.scatter_pitch, spec.scatter_radius, spec.scatter_vertex)
        )
        for name, key, half, unit in (
            (f"scatter_pitch.{part}.x", "scatter_pitch", pitch, design.unit),
            (f"scatter_pitch.{part}.y", "scatter_pitch", pitch, design.unit),
            (f"scatter_radius.{part}", "scatter_radius", radius, ""),
            (f"scatter_vertex.{part}", "scatter_vertex", vertex, design.unit),
        ):
            yield Parameter(name, key, half, unit, one_sided=True, scatter=True)


def _curved(window: Window) -> list[tuple[int, str, Face]]:
    """Lens faces in the order of the light, a joint once: array (1, 2; 3: field lens), name of the radius.

    The name is the array, then ".front" or ".back" where a lens has two, or its number in a list of faces.
    """
    found = []
    for number, (body, face, _, _) in enumerate(refractions(window.bodies), start=1):
        if face.array is None:
            continue
        part = ".front" if face is body.front else ".back"
        if window.form == "plates":
            part = f".face{number}"
        elif not body.columnar and face.array != 2:
            part = ""
        found.append((face.array + 1, f"{face.array + 1}{part}", face))
    return found


def draw(
    chosen: Sequence[Parameter], seed: int, sample: int, distribution: str = "normal"
) -> Mapping[str, float]:
    """Errors of sample number `sample`, by parameter name.

    Parameters
    ----------
    chosen : sequence of Parameter
    seed : int, 0 … 2^64 − 1
    sample : int ≥ 0
    distribution : "normal" or "uniform"
        Normal: the tolerance is 2 standard deviations. Uniform: the tolerance is the limit, as always for
        parameters with `uniform`. One-sided parameters take the absolute value. A scatter is that of the
        design.
    """
    found = {}
    for p in chosen:
        if p.scatter:
            found[p.name] = p.half
            continue
        # one number uses only the first word of the counter's output
        word = np.random.Philox(key=seed, counter=[0, 0, crc32(p.name.encode()), sample]).random_raw()
        uniform = ((int(word) >> 11) + 0.5) * 2.0**-53
        value = (
            2.0 * uniform - 1.0
            if p.uniform or distribution == "uniform"
            else NormalDist().inv_cdf(uniform) / SIGMAS
        ) * p.half
        found[p.name] = abs(value) if p.one_sided else value
    return found
