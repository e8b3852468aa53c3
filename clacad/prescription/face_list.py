"""Plates listed face by face, with the medium behind each: `form = "plates"`.

Nothing is solved but the place of array 2: its vertex from delta, its cells from the aperture. Bodies are the
media other than air; a face between two of them is a joint.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.base.units import A4, A6, A8
from clacad.design.faces import AIR, FaceSpec, vertices_of
from clacad.design.sections import PAIR
from clacad.optics.material.catalogue import find
from clacad.optics.material.material import Material
from clacad.optics.surface import Surface
from clacad.prescription.assemble import assemble_window
from clacad.prescription.bodies import LensPose, displacement, given_surface
from clacad.prescription.face_matrices import equivalent, matrices
from clacad.prescription.intent import Intent
from clacad.prescription.radii import LensPair, NoSuchLens
from clacad.sheet.lattice import Lattice
from clacad.sheet.volume_and_extent import FIELD
from clacad.sheet.window import IDENTITY, PLANE, Body, Face, Window, lens_height

NUMBER: dict[Any, int] = {1: 0, 2: 1, "field": FIELD}
"""Array of a face's word."""


def plates(intent: Intent) -> Window:
    """Window of the listed faces; lengths in design units.

    Raises
    ------
    NoSuchLens
        The faces have no power that array 2 could be placed by.
    """
    pair = intent.design.pair
    faces = pair.face
    height = vertices_of(faces)[-1]
    offset = _offset(intent)
    second = _height_of(faces, 2)
    lens_2 = intent.turn @ np.array([*offset, second])
    still = _bodies(intent, {})
    moved = displacement(intent.design.lattice.aperture, lens_2[:2], second, still)
    places = {1: lens_2[:2] - np.asarray(moved)}
    field = None
    if any(face.array == "field" for face in faces):
        share = _height_of(faces, "field") / second  # on the line from cell 1 to cell 2
        field = (share * moved[0], share * moved[1])
    bodies = _bodies(intent, places)
    _refuse_steps(intent, bodies, moved)
    thin = equivalent(pair, intent.eta)
    lenses = LensPair(thin.focal_length, (faces[0].radius, faces[-1].radius), (height, height))
    window = assemble_window(intent, bodies, moved, lenses, offset, field, {} if thin.field else None)
    return replace(window, thin=replace(window.thin, field=thin.field))


def _bodies(intent: Intent, places: dict[int, Floats]) -> tuple[Body, ...]:
    """Bodies between neighbouring faces; places : vertices (2,) of an array's lenses from their cells."""
    faces, wavelength = intent.design.pair.face, intent.design.pair.wavelength
    found: list[Body] = []
    plate, z = 0, vertices_of(faces)
    for number, (front, back) in enumerate(zip(faces, faces[1:])):
        if front.behind == AIR:
            continue
        joined = number > 0 and faces[number - 1].behind != AIR
        plate += not joined
        material = find(str(front.behind))
        found.append(
            Body(
                _face(front, z[number], +1, intent, places),
                _face(back, z[number + 1], -1, intent, places),
                float(material.index(wavelength)),
                _name(plate, len(found), material),
                material,
                joined,
            )
        )
    return tuple(found)


def _name(plate: int, number: int, material: Material) -> str:
    """Name of a body: its plate, its place in the sheet and its material."""
    word = "".join(letter if letter.isalnum() else "-" for letter in material.name).lower()
    return f"plate{plate}-{number + 1}-{word}"


def _face(spec: FaceSpec, z: float, side: int, intent: Intent, places: dict[int, Floats]) -> Face:
    """Side `side` of a body: a plane, or the lenses of an array, in the lens axes."""
    if spec.array is None:
        return Face(replace(PLANE, side=side), (0.0, 0.0, z))
    array = NUMBER[spec.array]
    x, y = places.get(array, np.zeros(2))
    turn = IDENTITY if np.array_equal(intent.turn, IDENTITY) else intent.turn
    point = LensPose(np.array([x, y, z]), turn)
    return Face(surface_of(spec, side), point.vertex(0.0), turn, array)


def surface_of(spec: FaceSpec, side: int) -> Surface:
    """Surface of a listed face, with the signs of the side that its material is on."""
    if side > 0:
        return given_surface(spec, side)
    a, b, c = (tuple(0.0 - term for term in terms) for terms in (spec.a4, spec.a6, spec.a8))
    radius = -spec.radius[0], -spec.radius[1]
    return given_surface(FaceSpec(radius, spec.conic, cast("A4", a), cast("A6", b), cast("A8", c)), side)


STEP = 1e-9
"""Largest step of a joint at a border of cells, as a part of the pitch: rounding is far below it."""


def _refuse_steps(intent: Intent, bodies: tuple[Body, ...], moved: Pair2) -> None:
    """Refuse curved joints that have steps at the borders of cells, or would have land.

    moved : displacement of the cells of array 2, which makes an outline around both arrays

    Raises
    ------
    NoSuchLens
    """
    lattice, design = intent.lattice, intent.design
    outlined = lattice.outline is not None or design.body.outline is not None or moved != (0.0, 0.0)
    cut = outlined or design.lattice.seam or design.body.border
    number = -1
    for body, beyond in zip(bodies, (*bodies[1:], None), strict=True):
        number += 1 if body.joined else 2
        if body.back.array is None or beyond is None or not beyond.joined:
            continue
        key = f"{PAIR.face}.{number}.array"
        if cut:
            raise NoSuchLens(
                f"face {number + 1} is a curved joint, which has no land for a seam, border or outline",
                key=key,
                hint='a flat joint (radius = "inf", no array), or cells over one another, up to the edge',
                code="CL114",
            )
        step = _step(lattice, body.back)
        if step > STEP * min(lattice.pitch):
            raise NoSuchLens(
                f"face {number + 1} is a joint with steps of {step:.3g} at the borders of its cells",
                key=key,
                hint='delta = 0 and aperture = "centred", lenses along the cells, or a flat joint',
                code="CL114",
            )


def _step(lattice: Lattice, face: Face) -> float:
    """Largest step (length) of a face between two neighbouring cells, at samples of their border."""
    from clacad.sheet.feasibility.convex_extremes import border

    tile, found = lattice.tile(), 0.0
    for number, step in enumerate(lattice.steps):
        here = border(tile, number)
        there = here - np.asarray(lattice.offset(*step))
        found = max(found, float(np.abs(lens_height(face, *here.T) - lens_height(face, *there.T)).max()))
    return found


def _offset(intent: Intent) -> Floats:
    """Place (2,) of lens 2's vertex in the lens axes: as given, else d = δ/(η C_2); lengths."""
    given = intent.design.pair.vertex
    if given is not None:
        return np.array(given)
    found = np.zeros(2)
    for axis, matrix in enumerate(matrices(intent.design.pair, 2)):
        delta, eta = intent.delta[axis], intent.eta[axis]
        if delta == 0.0:
            continue
        if matrix[1, 0] == 0.0:
            raise NoSuchLens(
                "array 2 has no power in a meridian with an offset delta",
                key=f"{PAIR.face}.{len(intent.design.pair.face) - 1}.radius",
                hint="delta = 0 there, a curved face of array 2, or pair.vertex = [d_x, d_y]",
            )
        found[axis] = delta / (eta * matrix[1, 0])
    return found


def _height_of(faces: tuple[FaceSpec, ...], array: object) -> float:
    """Vertex (length) of the last face of array 2, or of the middle face of another array."""
    own = [k for k, face in enumerate(faces) if face.array == array]
    return vertices_of(faces)[own[-1] if array == 2 else own[len(own) // 2]]
