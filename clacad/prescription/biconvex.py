"""Biconvex pairs: two thick lenses with centres on the axis, with or without a field plate between them."""

from __future__ import annotations

from math import isinf
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Pair2
from clacad.design.sections import BODY, LATTICE
from clacad.prescription.assemble import assemble_window
from clacad.prescription.best_recipe import best_scale
from clacad.prescription.bodies import LensPose, Listed, bodies_of, displacement, given_pair, lens_face
from clacad.prescription.cell_heights import auto_thickness
from clacad.prescription.field_lens import (
    Chief,
    one_plate,
    plate_faces,
    split_plate,
    starts_aligned,
    symmetric_foci,
)
from clacad.prescription.intent import Intent, separation_of, untraced
from clacad.prescription.radii import LensPair, NoSuchLens, biconvex_exact, biconvex_thin, thin_focal_lengths
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.design import Design


def biconvex(intent: Intent) -> Window:
    """Window of two biconvex (or concave) lenses."""
    thickness = _solved(intent)
    window = best_scale(intent, lambda asked, scale: _with_thickness(asked, thickness, scale))
    _refuse_land_without_plate(intent.design, window)
    return window


def _refuse_land_without_plate(design: Design, window: Window) -> None:
    """Refuse seam, border or outline on a concave lens: its body has no plate of its own for them."""
    asked = {
        LATTICE.seam: design.lattice.seam > 0.0,
        BODY.border: design.body.border > 0.0,
        BODY.outline: design.body.outline is not None,
        LATTICE.outline: design.lattice.outline is not None,
    }
    keys = [key for key, given in asked.items() if given]
    for number, body in enumerate(window.bodies, start=1):
        if keys and body.front.land is None:
            raise NoSuchLens(
                f"lens {number} is concave: it has no plate for {' and '.join(keys)}",
                key=keys[0],
                hint=f"no {' and no '.join(keys)}, or pair.form = 'plano'",
            )


def _solved(intent: Intent) -> Pair2:
    """Requested thicknesses, or thicknesses solved for "auto" with the exact (or thin) radii."""
    given = intent.design.pair.thicknesses
    if given is not None:
        return given
    separation = separation_of(intent)
    focal = [thin_focal_lengths(value, separation) for value in intent.eta]
    reach = intent.lattice.circumradius
    curvature = [
        sum(0.0 if isinf(f[k]) else max(0.0, 1.0 / f[k]) for f in focal) / (2.0 * (intent.index - 1.0))
        for k in (0, 1)
    ]
    guess = (intent.neck + 0.5 * reach**2 * curvature[0], intent.neck + 0.5 * reach**2 * curvature[1])
    converging = [abs(f) for fs in focal for f in fs if f > 0.0 and not isinf(f)]
    limit = min([intent.index * f for f in converging] + [2.0 * separation])
    trial = untraced(intent)
    return auto_thickness(lambda t: _with_thickness(trial, t), guess, intent.neck, limit)


def _with_thickness(intent: Intent, thickness: Pair2, scale: float = 1.0) -> Window:
    """Window of a biconvex pair with given thicknesses, its radii times `scale`."""
    pair = intent.design.pair
    separation = separation_of(intent)
    lenses = _lenses(intent, separation, thickness).scaled(scale)
    offset = intent.built_offset(lenses)
    plate, ideal, near = None, lenses, 0.0
    if pair.field_lens:
        ideal = _around_field(intent, lenses, separation, thickness)
        rooms = [symmetric_foci(ideal.radius[k], thickness[k], intent.index) for k in (0, 1)]
        near, own = min(ideal.focal_length[0]), intent.etas_along_axes
        if own is None:
            plate = one_plate(intent, ideal.focal_length, rooms[0], min(rooms[1]) - 0.5 * thickness[1])
        else:
            focus = 0.5 * sum(rooms[0])
            plate = split_plate(intent, own, focus, (0.5 * thickness[0], 0.5 * thickness[1]), focus)
            near = 0.5 * (sum(ideal.focal_length[0]) - plate.thickness / intent.index)
    lens_2, added = intent.turn @ np.array([*offset, separation]), np.zeros(3)
    moved = displacement(intent.design.lattice.aperture, lens_2[:2], float(lens_2[2]))
    if plate is not None and pair.focus is not None:  # nothing is tilted
        from clacad.prescription.sharp_pairs import refocused

        offset = refocused(
            offset, intent.turn[:2, :2].T @ moved, lenses.focal_length[1], ideal.focal_length[1]
        )
        lens_2 = intent.turn @ np.array([*offset, separation])
    if plate is not None:
        added = plate.added(intent.index) * intent.turn[:, 2]
        lens_2 = lens_2 + added
        if not starts_aligned(
            intent.design.lattice.aperture
        ):  # the plate carries the ray to cell 2 along the axis
            moved = (moved[0] + float(added[0]), moved[1] + float(added[1]))
    relative = lens_2 - np.array([*moved, 0.0])
    webs = (_web(intent, lenses, k, z) for k, z in enumerate((0.0, float(relative[2]))))
    faces: list[Listed] = []
    for k, (point, web) in enumerate(zip((np.zeros(3), relative), webs, strict=True)):
        pose, half = LensPose(point, intent.turn), 0.5 * lenses.thickness[k]
        front, back = (
            lens_face(intent.shape.face(lenses.radius[k], side, k), pose, k, -side * half, land)
            for side, land in zip((+1, -1), web, strict=True)
        )
        faces += [(front, intent.glass(f"array{k + 1}")), (back, None)]
    if plate is None:
        return assemble_window(intent, bodies_of(intent.listed(faces)), moved, lenses, offset)
    axis = intent.turn[:, 2]
    height = float(relative @ axis) / axis[2]
    reduced = ideal.focal_length[0][0] + ideal.focal_length[1][0]
    chief = Chief.of(intent, (np.array([*moved, height]) @ intent.turn)[:2], reduced, intent.turn)
    through = plate.thickness / intent.index
    legs = ((near, 1.0), (plate.thickness, intent.index), (reduced - near - through, 1.0))
    field, cells = plate_faces(intent, plate, chief, legs, 1, intent.turn)
    bodies = bodies_of(intent.listed([*faces[:2], *field, *faces[2:]]))
    return assemble_window(intent, bodies, moved, lenses, offset, cells, plate.told)


def _lenses(intent: Intent, separation: float, thickness: Pair2) -> LensPair:
    """Lenses as given, with the requested focus, or confocal by the requested recipe."""
    pair, index = intent.design.pair, intent.index
    if pair.given:
        return given_pair(pair, thickness, index)
    if pair.focus is not None:
        from clacad.prescription.sharp_pairs import planes_of, sharp_thick_lenses, sharp_thin_lenses

        sharp = sharp_thick_lenses if pair.confocal == "exact" else sharp_thin_lenses
        return sharp(intent.eta, separation, planes_of(intent.design, thickness, index), thickness, index)
    return _afocal(intent, separation, thickness)


def _afocal(intent: Intent, separation: float, thickness: Pair2) -> LensPair:
    """Lenses confocal by the requested recipe; of given faces by the exact one."""
    pair = intent.design.pair
    recipe = biconvex_exact if pair.given or pair.confocal == "exact" else biconvex_thin
    return recipe(intent.eta, separation, thickness, intent.index)


def _around_field(intent: Intent, lenses: LensPair, separation: float, thickness: Pair2) -> LensPair:
    """Lenses whose common focus is the place of the field lens: `lenses` themselves where they are afocal.

    It follows from eta alone for given faces, so that given and derived faces have the same position.
    """
    pair = intent.design.pair
    if not pair.given and pair.focus is None:
        return lenses
    if pair.focus is None or pair.confocal != "exact":
        return _afocal(intent, separation, thickness)
    from clacad.prescription.sharp_pairs import images_between

    return images_between(intent.design, separation, thickness, intent.index)


def _web(intent: Intent, lenses: LensPair, number: int, centre: float) -> Pair2 | tuple[None, None]:
    """Front and back z of the plate that joins an array's lenslets; None: no plate, a concave lens."""
    spec = intent.design
    bordered = spec.body.apart or spec.lattice.outline is not None
    web = spec.pair.web
    if web is None or (web == 0.0 and bordered):
        web = intent.neck  # the border is a plate; a web must join it to the lenslets
    radii: tuple[float, ...] = lenses.radius[number]
    if spec.pair.given:
        radii = tuple(r for face in spec.pair.face[spec.pair.lens_faces(number)] for r in face.radius)
    if web == 0.0 or any(r < 0.0 for r in radii):
        return None, None
    return centre - 0.5 * web, centre + 0.5 * web
