"""Plates listed face by face, with the medium behind each: `form = "plates"`.

Nothing is solved but the place of array 2: its vertex from delta, its cells from the aperture. Bodies are the
media other than air; a face between two of them is a joint.

`pair.layers` of a slab are solved into such a list, with flat joints. Both lenses are of the outer material,
of index n and V = (n − 1)/Δn, Δn the change of an index between the outermost lines of [light]. With
thicknesses T_i and indices n_i of the layers,

    Σ T_i/n_i = s,    Σ (T_i/n_i)(Δn_i/n_i) = s/V.

The first keeps the pair afocal at the design wavelength, f1 = s/(1 − η), f2 = −η f1 and R = (n − 1) f. The
second keeps it afocal in both lines. It holds at every η, for both meridians have the same sum. Conic
constants are −1/n² at η = −1, where they make each face perfect on its axis; else they and the radii are
those of least law error over the lines, next to these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from math import asin, tan
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats, Pair2
from clacad.design.faces import AIR, FaceSpec, face_table, vertices_of
from clacad.design.sections import LAW, PAIR
from clacad.optics.fit import AskedLight, law_residuals, minimise
from clacad.optics.law import rotation
from clacad.optics.material.catalogue import find
from clacad.optics.material.material import Material
from clacad.optics.rays import Rays
from clacad.optics.sequence import Interface
from clacad.optics.surface import Surface
from clacad.optics.surface.sag_and_normal import other_side
from clacad.prescription.assemble import assemble_window
from clacad.prescription.bodies import (
    FieldCells,
    LensPose,
    Listed,
    Medium,
    given_surface,
    lens_face,
    placed,
    shared,
)
from clacad.prescription.face_matrices import equivalent, matrices
from clacad.prescription.intent import Intent
from clacad.prescription.radii import LensPair, NoSuchLens, thin_focal_lengths
from clacad.sheet.cell_places import extreme_cells
from clacad.sheet.face_order import refractions
from clacad.sheet.volume_and_extent import FIELD
from clacad.sheet.window import PLANE, Face, Window, heights_of_lenses

if TYPE_CHECKING:
    from clacad.design import Design

NUMBER: dict[Any, int] = {1: 0, 2: 1, "field": FIELD}
"""Array of a face's word."""


def plates(intent: Intent) -> Window:
    """Window of the listed faces; lengths in design units.

    Raises NoSuchLens: The faces have no power that array 2 could be placed by.
    """
    pair = intent.design.pair
    faces = pair.face
    height = vertices_of(faces)[-1]
    offset, poses = _offset(intent), _poses(intent)
    aside = intent.turn @ np.array([*offset, 0.0])
    lens_2 = poses[_number_of(faces, 2)].point + aside
    bodies, moved = placed(intent.design.lattice.aperture, _faces(intent, poses, aside), lens_2)
    field = None
    if any(face.array == "field" for face in faces):
        share = float(poses[_number_of(faces, "field")].point[2] / poses[_number_of(faces, 2)].point[2])
        # on the line from cell 1 to cell 2
        part = share * np.eye(2)
        field = FieldCells((share * moved[0], share * moved[1]), part, (part,), np.zeros(3))
    thin = equivalent(pair, intent.eta)
    lenses = LensPair(thin.focal_length, (faces[0].radius, faces[-1].radius), (height, height))
    window = assemble_window(intent, bodies, moved, lenses, offset, field, {} if thin.field else None)
    _refuse_steps(window, faces)
    return replace(window, thin=replace(window.thin, field=thin.field))


def _poses(intent: Intent) -> list[LensPose]:
    """Pose of each face on the lens axis, which planes bend as they bend a ray; places count along it.

    Raises NoSuchLens: The axis is totally reflected, or leaves the plates along another direction.
    """
    faces, law, pair = intent.design.pair.face, intent.law, intent.design.pair
    z = vertices_of(faces)
    if (intent.tilts != law.theta).any() and any(face.array is None for face in faces):
        raise NoSuchLens(
            "cells lean by different angles over planes under the whole sheet, which bend each axis"
            " otherwise",
            key=LAW.varying,
            hint="a table without the column theta, or a list of faces without planes",
            code="CL114",
        )
    if law.theta == 0.0:
        return [LensPose(np.array([0.0, 0.0, height]), shared(intent.turn)) for height in z]
    sine, before, point, turn = np.sin(law.theta), 1.0, np.zeros(3), intent.turn
    found = []
    for face, step in zip(faces, np.diff([0.0, *z]), strict=True):
        point = point + step * turn[:, 2]
        found.append(LensPose(point, turn))
        after = 1.0 if face.behind == AIR else float(find(str(face.behind)).index(pair.wavelength))
        if face.array is None:
            sine *= before / after
            if abs(sine) >= 1.0:
                break
            turn = rotation(law.phi, asin(sine), law.psi, law.axes)
        before = after
    if len(found) < len(faces) or abs(sine - np.sin(law.theta)) > SAME * abs(sine):
        raise NoSuchLens(
            f"planes bend the axis of lenses tilted by {np.degrees(law.theta):.4g} deg, which does not leave"
            " as it came",
            key=LAW.euler,
            hint="theta = 0, or planes that undo one another: as much of a medium before as behind each lens",
            code="CL114",
        )
    return found


SAME = 1e-9
"""Relative difference of sines up to which the axis leaves as it came."""


def _faces(intent: Intent, poses: list[LensPose], aside: Floats) -> list[Listed]:
    """The faces at their poses, those of array 2 `aside` (3,) of the axis, and the media behind them."""
    faces, wavelength = intent.design.pair.face, intent.design.pair.wavelength
    found: list[Listed] = []
    plate, number, before = 0, 0, AIR
    for spec, pose in zip(faces, poses, strict=True):
        plate += before == AIR
        side = +1 if before == AIR else -1  # both bodies of a joint have the points of the first
        medium = None
        if spec.behind != AIR:
            number += 1
            material = find(str(spec.behind))
            medium = Medium(float(material.index(wavelength)), _name(plate, number, material), material)
        face = Face(replace(PLANE, side=side), (0.0, 0.0, float(pose.point[2])))
        if spec.array is not None:
            point = pose.point + aside if spec.array == 2 else pose.point
            face = lens_face(surface_of(spec, side), LensPose(point, pose.rotation), NUMBER[spec.array])
        found.append((face, medium))
        before = str(spec.behind)
    return found


def _name(plate: int, number: int, material: Material) -> str:
    """Name of a body: its plate, its place in the sheet and its material."""
    word = "".join(letter if letter.isalnum() else "-" for letter in material.name).lower()
    return f"plate{plate}-{number}-{word}"


def surface_of(spec: FaceSpec, side: int) -> Surface:
    """Surface of a listed face, with the signs of the side that its material is on."""
    surface = given_surface(spec, +1)
    return surface if side > 0 else other_side(surface)


STEP = 1e-9
"""Largest step of a joint at a border of cells, as a part of the pitch: rounding is far below it."""


def _refuse_steps(window: Window, specs: tuple[FaceSpec, ...]) -> None:
    """Refuse curved joints that have steps at the borders of cells without land between them.

    Raises NoSuchLens.
    """
    if window.land.seam > 0.0:
        return
    for number, (before, spec) in enumerate(pairwise(specs), start=1):
        if AIR in (before.behind, spec.behind) or spec.array is None:
            continue
        step = _step(window, refractions(window.bodies)[number].face)
        if step > STEP * min(window.lattice.pitch):
            raise NoSuchLens(
                f"face {number + 1} is a joint with steps of {step:.3g} at the borders of its cells",
                key=f"{PAIR.face}.{number}.array",
                hint='delta = 0 and aperture = "centred", lenses along the cells, a flat joint, or a seam',
                code="CL114",
            )


def _step(window: Window, face: Face) -> float:
    """Largest step (length) of a face between two neighbouring cells, at samples of their border."""
    from clacad.sheet.feasibility.convex_extremes import border

    assert face.array is not None
    lattice, found = window.lattice_of(face.array), 0.0
    cells = np.zeros((1, 2), dtype=np.int64)
    if face.change is not None:
        cells = extreme_cells(face.change, window.lattice)
    for number, step in enumerate(lattice.steps):
        index = np.stack([cells, cells + step])[:, :, None]
        if face.change is not None:
            index = index[:, window.lattice.contains(cells + step)]
        here = border(lattice.tile(), number)
        heights = []
        for one, points in zip(index, (here, here - np.asarray(lattice.offset(*step))), strict=True):
            places = window.lenses(face, one)
            heights.append(heights_of_lenses(face, places, *points.T))
        found = max(found, float(np.abs(heights[0] - heights[1]).max(initial=0.0)))
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


def _number_of(faces: tuple[FaceSpec, ...], array: object) -> int:
    """Number of the last face of array 2, or of the middle face of another array."""
    own = [k for k, face in enumerate(faces) if face.array == array]
    return own[-1] if array == 2 else own[len(own) // 2]


KEPT = ("wavelength", "vertex", "offset")
"""Keys of a slab of layers that its list of faces has, too."""

LEAST_RAYS = 16
"""Rays that reach the partner's cell from which faces are found; of 32 times as many."""

PLASTIC = "achromat-plastic"
"""Starter with curved joints."""


def as_listed(design: Design) -> Design:
    """The design with its layers solved into a list of faces; a design without layers itself.

    Raises NoSuchLens: The inner layer cannot undo the colour of the lenses.
    """
    if not design.pair.layers:
        return design
    pair = {key: value for key, value in design.given["pair"].items() if key in KEPT}
    pair |= {"form": "plates", "face": [face_table(face) for face in layered_faces(design)]}
    return type(design).from_dict({**design.given, "pair": pair})


def layered_faces(design: Design) -> tuple[FaceSpec, ...]:
    """Curved, flat, flat and curved face of a design with layers; errors as `as_listed`."""
    pair = design.pair
    outer, inner = (find(name) for name in pair.layers[:2])
    assert pair.separation is not None  # layers need it
    index = [float(one.index(pair.wavelength)) for one in (outer, inner)]
    share = inner_share(design, outer, inner)
    first, middle = 0.5 * (1.0 - share) * pair.separation * index[0], share * pair.separation * index[1]
    focal = [thin_focal_lengths(eta, pair.separation) for eta in design.law_spec.eta]
    front, back = (
        (sign * (index[0] - 1.0) * focal[0][lens], sign * (index[0] - 1.0) * focal[1][lens])
        for lens, sign in ((0, 1.0), (1, -1.0))
    )
    flat: Pair2 = (float("inf"), float("inf"))
    conic = pair.conic or (-1.0 / index[0] ** 2, -1.0 / index[0] ** 2)
    faces = (
        FaceSpec(front, conic, array=1, behind=pair.layers[0]),
        FaceSpec(flat, z=first, behind=pair.layers[1]),
        FaceSpec(flat, z=first + middle, behind=pair.layers[2]),
        FaceSpec(back, conic, z=2.0 * first + middle, array=2, behind=AIR),
    )
    eta = design.law_spec.eta
    if pair.conic is not None or eta == (-1.0, -1.0):
        return faces
    lines = design.light.lines
    media = tuple((1.0, *(float(find(name).index(wave)) for name in pair.layers), 1.0) for wave in lines)
    asked = eta, pair.separation, design.lattice.pitch, design.check.field
    return _best_faces(faces, media, tuple(lines.values()), asked)


def _own_light(eta: Pair2, separation: float, pitch: Pair2, field: float) -> AskedLight | None:
    """Rays of a cone over a cell (lens axes) that reach the partner, and their directions by t/η."""
    u = sobol(LEAST_RAYS * 32, 4)
    place = (u[:, :2] - 0.5) * pitch
    turn = 2.0 * np.pi * u[:, 3]
    slope = tan(field) * np.sqrt(u[:, 2:3]) * np.column_stack([np.cos(turn), np.sin(turn)])
    kept = (np.abs(place * eta + separation * slope) <= 0.5 * np.asarray(pitch)).all(axis=1)
    if kept.sum() < LEAST_RAYS:
        return None
    place, slope, one = place[kept], slope[kept], np.ones((int(kept.sum()), 1))
    back = max(pitch)
    start = np.column_stack([place - back * slope, np.full(len(one), -back)])
    asked = np.hstack([slope / np.asarray(eta), one])
    return AskedLight.of(Rays(start, np.hstack([slope, one])), asked / np.linalg.norm(asked, axis=1)[:, None])


@lru_cache(maxsize=64)
def _best_faces(
    faces: tuple[FaceSpec, ...],
    media: tuple[tuple[float, ...], ...],
    weights: tuple[float, ...],
    asked: tuple[Pair2, float, Pair2, float],
) -> tuple[FaceSpec, ...]:
    """The faces with the radii and conic constants of the outer ones, to 6 digits, that follow the law best.

    Least mean square error over the lines. Both meridians have the same numbers where they have the same law.

    media : Indices before, between and behind the faces in each line.
    weights : of each line; `asked` : η, separation, pitch and field, as of `_own_light`
    """
    light, (eta, _, pitch, _) = _own_light(*asked), asked
    if light is None:
        return faces
    radius = np.array([*faces[0].radius, *faces[-1].radius])
    meridians = [0, 0, 1, 1] if eta[0] == eta[1] and pitch[0] == pitch[1] else [0, 1, 2, 3]
    share = np.sqrt(np.array(weights) / sum(weights))

    def changed(unknowns: Floats) -> list[list[float]]:
        conics, scales = unknowns.reshape(2, -1)[:, meridians]
        return [(radius * scales).tolist(), conics.tolist()]

    def residuals(unknowns: Floats) -> Floats:
        trial = _with_outer(faces, *changed(unknowns))
        each = [law_residuals(_sequence(trial, indices), light) for indices in media]
        return (share[:, None] * each).ravel()

    first = np.array([*faces[0].conic, *faces[-1].conic])[np.unique(meridians, return_index=True)[1]]
    found = changed(minimise(residuals, np.concatenate([first, np.ones(len(first))])))
    return _with_outer(faces, *([float(f"{value:.6g}") for value in row] for row in found))


def _with_outer(
    faces: tuple[FaceSpec, ...], radius: Sequence[float], conic: Sequence[float]
) -> tuple[FaceSpec, ...]:
    """The faces with radii and conic constants (4,) of the first and the last: x and y of each."""
    (r1, r2, r3, r4), (k1, k2, k3, k4) = radius, conic
    first = replace(faces[0], radius=(r1, r2), conic=(k1, k2))
    return (first, *faces[1:-1], replace(faces[-1], radius=(r3, r4), conic=(k3, k4)))


def _sequence(faces: tuple[FaceSpec, ...], media: tuple[float, ...]) -> list[Interface]:
    """Faces on one axis, with the indices of the media before, between and behind them."""
    return [
        Interface(surface_of(face, 1 if number == 0 else -1), (0.0, 0.0, z), before, after)
        for number, (face, z, before, after) in enumerate(
            zip(faces, vertices_of(faces), media[:-1], media[1:], strict=True)
        )
    ]


def inner_share(design: Design, outer: Material, inner: Material) -> float:
    """Share of the air-equivalent length s in the inner layer.

    Raises NoSuchLens: It is not between 0 and 1.
    """
    lines, wavelength = design.light.lines, design.pair.wavelength
    ends = min(lines), max(lines)
    share = achromatic_share(outer, inner, wavelength, ends)
    if not 0.0 < share < 1.0:
        (n, dn), (m, dm) = (_colour(one, wavelength, ends) for one in (outer, inner))
        raise NoSuchLens(
            f"a flat joint of {outer.name} and {inner.name} needs {share:.3g} of the length in {inner.name}"
            f" to undo the colour of the lenses: {inner.name} must change its index over n by more than"
            f" {dn / (n - 1.0):.3g} between the lines, and changes it by {dm / m:.3g}",
            key=f"{PAIR.layers}.1",
            hint=f"an inner layer of smaller V; curved joints need less: clacad new --template {PLASTIC}",
            code="CL114",
        )
    return share


def achromatic_share(outer: Material, inner: Material, wavelength: float, lines: Pair2) -> float:
    """Share (1/V − Δn₁/n₁)/(Δn₂/n₂ − Δn₁/n₁) of the inner material, of any size; infinite if there is none.

    wavelength, lines : metres. Design wavelength, and the outermost lines.
    """
    (n, dn), (m, dm) = (_colour(one, wavelength, lines) for one in (outer, inner))
    gain = dm / m - dn / n
    return dn / (n * (n - 1.0)) / gain if gain else float("inf")


def _colour(material: Material, wavelength: float, lines: Pair2) -> tuple[float, float]:
    """Index at the design wavelength, and its fall between two lines (metres)."""
    first, last = (float(material.index(wave)) for wave in lines)
    return float(material.index(wavelength)), first - last
