"""Pairs of lenses with one curved face each, with or without field plates.

Plano pairs: curved faces inside or outside. Slabs: one body with both arrays on its faces, or cut at the
focus where it has a field lens.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.design.sections import LAW, PAIR
from clacad.optics.surface import Quadric
from clacad.prescription.assemble import assemble_window
from clacad.prescription.best_recipe import best_scale
from clacad.prescription.bodies import (
    LensPose,
    Listed,
    Shape,
    best_gap,
    bodies_of,
    given_pair,
    lens_face,
    placed,
    plano_outside_axis,
    shallower,
)
from clacad.prescription.cell_heights import face_range
from clacad.prescription.field_lens import (
    Chief,
    air_gap,
    mean_focus,
    one_plate,
    plate_faces,
    split_plate,
    starts_aligned,
    straight_above,
    two_plates,
)
from clacad.prescription.intent import Intent, separation_of, untraced
from clacad.prescription.radii import LensPair, NoSuchLens, single_surface, thin_pair
from clacad.sheet.window import Face, Window


def plano(intent: Intent) -> Window:
    """Window of two plano lenses, curved faces inside or outside."""
    return best_scale(intent, _plano_scaled)


def _plano_scaled(intent: Intent, scale: float) -> Window:
    """Plano pair with its radii times `scale`."""
    pair = intent.design.pair
    separation = separation_of(intent)
    thickness = pair.thicknesses or _plano_auto(intent, separation)
    lenses = one_faced(intent, separation, thickness).scaled(scale)
    if pair.field_lens:
        return plano_with_field(intent, lenses)
    offset = intent.built_offset(lenses)
    if pair.curved == "inside":
        turn = shallower(intent.law, intent.index)  # the plane faces refract the axis
        return _plano_placed(intent, lenses, turn @ np.array([*offset, separation]), turn, offset)
    gap = separation - (thickness[0] + thickness[1]) / intent.index
    if gap <= 0.0:
        raise NoSuchLens(
            f"the plane faces would meet: the air gap separation - (T1 + T2)/n is {gap:.6g}",
            hint=(
                f"T1 + T2 < {intent.index * separation:.6g}, separation > "
                f"{(thickness[0] + thickness[1]) / intent.index:.6g}, or curved = 'inside'"
            ),
        )

    if intent.law.theta != 0.0:
        gap = _afocal_gap(intent, thickness, gap)
    lens_2 = plano_outside_axis(intent.turn, intent.index, thickness, gap)
    lens_2 = lens_2 + intent.turn @ np.array([*offset, 0.0])
    return _plano_placed(intent, lenses, lens_2, intent.turn, offset)


def one_faced(intent: Intent, separation: float, thickness: Pair2) -> LensPair:
    """Lenses with one curved face each: as given, else for η, afocal or with the requested focus."""
    pair = intent.design.pair
    if pair.given:
        return given_pair(pair, thickness, intent.index)
    if pair.focus is not None:
        from clacad.prescription.sharp_pairs import planes_of, sharp_lenses

        seen = planes_of(intent.design, thickness, intent.index)
        return sharp_lenses(intent.eta, separation, seen, thickness, intent.index)
    return single_surface(intent.eta, separation, thickness, intent.index)


def _afocal_gap(intent: Intent, thickness: Pair2, guess: float) -> float:
    """Air gap (length) of a tilted plano pair: that of the ellipsoids of law.eta, regardless of the built
    faces.

    A gap solved for the built faces makes any pair of faces afocal. A search over faces or their scale would
    then increase the separation, because the error falls as the cube of pitch over separation.
    """
    plain = replace(untraced(intent), shape=Shape(None, None), given=())
    lenses = single_surface(intent.eta, separation_of(intent), thickness, intent.index)

    def built(gap: float) -> Window:
        # without the offset: off its axis lens 2 adds aberration that is unrelated to the gap
        lens_2 = plano_outside_axis(intent.turn, intent.index, thickness, gap)
        return _plano_placed(plain, lenses, lens_2, intent.turn, np.zeros(2))

    return best_gap(built, intent.turn, guess)


def _plano_auto(intent: Intent, separation: float) -> Pair2:
    """Least vertex-to-plane thickness with the neck under the whole lens, and under land if any."""
    found = _plano_auto_of(intent, separation, one_faced(intent, separation, (0.0, 0.0)))
    if intent.design.pair.focus is None:
        return found
    for _ in range(SETTLING):  # sharp lenses behind their own plates depend slightly on the thickness
        found = _plano_auto_of(intent, separation, one_faced(intent, separation, found))
    return found


SETTLING = 4
"""Number of iterations of thickness and radii of sharp lenses: each gains three digits."""


def _plano_auto_of(intent: Intent, separation: float, trial: LensPair) -> Pair2:
    """Smallest vertex-to-plane thickness, as `_plano_auto`, for the lenses of `trial`."""
    trial = replace(trial, thickness=(0.0, 0.0))
    window = _plano_placed(
        untraced(intent),
        trial,
        np.array([0.0, 0.0, separation]),
        intent.turn if intent.design.pair.curved == "outside" else shallower(intent.law, intent.index),
        np.zeros(2),
    )
    found = []
    for body in window.bodies:
        curved = body.front if body.front.array is not None else body.back
        low, high = face_range(window, curved)
        deepest = (high if curved.side > 0 else -low) - curved.side * curved.vertex[2]
        if curved.land is not None:
            deepest = max(deepest, curved.side * (curved.land - curved.vertex[2]))
        found.append(max(deepest, 0.0) + intent.neck)
    return found[0], found[1]


def _plano_placed(intent: Intent, lenses: LensPair, lens_2: Floats, turn: Floats, offset: Floats) -> Window:
    """Window of plano lenses, apex 2 at `lens_2` (3,) from apex 1, rotated by `turn` (lens → sheet)."""
    faces = _plano_faces(intent, lenses, lens_2, turn, intent.design.pair.curved == "outside")
    bodies, moved = placed(intent.design.lattice.aperture, intent.listed(faces), lens_2)
    return assemble_window(intent, bodies, moved, lenses, offset)


def _plano_faces(
    intent: Intent, lenses: LensPair, lens_2: Floats, turn: Floats, outside: bool
) -> list[Listed]:
    """Curved and plane face of both lenses, in the order of the light."""
    found: list[Listed] = []
    for k, (point, thickness) in enumerate(zip((np.zeros(3), lens_2), lenses.thickness, strict=True)):
        side = +1 if outside == (k == 0) else -1
        surface = intent.shape.face(lenses.radius[k], side, k)
        curved = lens_face(surface, LensPose(point, turn), k)
        plane = Face(Quadric(0.0, 0.0, 0.0, -side), (0.0, 0.0, float(point[2]) + side * thickness))
        front, back = (curved, plane) if side > 0 else (plane, curved)
        found += [(front, intent.glass(f"array{k + 1}")), (back, None)]
    return found


def plano_with_field(intent: Intent, lenses: LensPair) -> Window:
    """Window of two plano lenses with the field plate between them; curved outside nothing is tilted."""
    n, (t1, t2), separation = intent.index, lenses.thickness, separation_of(intent)
    outside = intent.design.pair.form == "slab" or intent.design.pair.curved == "outside"
    if outside and intent.steepest:
        raise NoSuchLens(
            "a field lens of plano lenses that lean: their planes bend the axis towards it, and give it a"
            " focus along and one across the tilt",
            key=LAW.euler,
            hint='theta = 0 in all cells, pair.curved = "inside", or another form',
            code="CL127",
        )
    first, second = thin_pair(intent.eta, separation)
    glass = (t1, t2) if outside else (0.0, 0.0)
    before, behind = min(first) - glass[0] / n, min(second) - glass[1] / n
    if before <= 0.0:
        raise NoSuchLens(
            f"lens 1 would reach {-before:.4g} beyond its focus",
            key=PAIR.separation,
            hint="a larger separation, or a thinner lens 1",
            code="CL129",
        )
    foci = (glass[0] + first[0] - glass[0] / n, glass[0] + first[1] - glass[0] / n)
    if (own := intent.etas_along_axes) is None:
        plate = one_plate(intent, (first, second), foci, behind)
        behind -= 0.0 if plate.crossed else plate.thickness / n
    else:
        focus, taken = float(mean_focus(own[:1], separation)[0]), (glass[0] / n, glass[1] / n)
        plate = split_plate(intent, own, focus, taken, focus + glass[0] - taken[0])
        half = 0.5 * plate.thickness / n
        before, behind = focus - taken[0] - half, separation - focus - taken[1] - half
    offset = intent.built_offset(lenses)
    legs = ((glass[0], n), (before, 1.0), (plate.thickness, n), (behind, 1.0), (glass[1], n))
    turn, height = shallower(intent.law, n) if not outside else intent.turn, sum(length for length, _ in legs)
    aligned = starts_aligned(intent.design.lattice.aperture)
    chief = Chief.of(intent, straight_above(turn, height) if aligned else offset, separation, turn)
    if intent.design.pair.focus is not None:
        from clacad.prescription.sharp_pairs import refocused

        offset = refocused(offset, chief.slope * separation, lenses.focal_length[1], second)
    moved_x, moved_y, _ = turn @ [*chief.across(legs), height]
    moved = float(moved_x), float(moved_y)
    lens_2 = turn @ [*offset, height]
    faces = _plano_faces(intent, lenses, lens_2, turn, outside)
    field, cells = plate_faces(intent, plate, chief, legs, 2, turn)
    bodies = bodies_of(intent.listed([*faces[:2], *field, *faces[2:]]), moved)
    return assemble_window(intent, bodies, moved, lenses, offset, cells, plate.told)


def slab(intent: Intent) -> Window:
    """Window of one body with both arrays on its faces."""
    return best_scale(intent, _slab_scaled)


def _slab_scaled(intent: Intent, scale: float) -> Window:
    """Slab with its radii times `scale`."""
    separation = separation_of(intent)
    if intent.design.pair.field_lens:
        return _slab_with_field(intent, separation, scale)
    thickness = intent.index * separation
    lenses = one_faced(intent, separation, (thickness, thickness)).scaled(scale)
    offset = intent.built_offset(lenses)
    lens_2 = intent.turn @ np.array([*offset, thickness])  # the common glass makes it exact for any tilt

    faces: list[Listed] = [
        (lens_face(intent.shape.face(lenses.radius[k], side, k), LensPose(point, intent.turn), k), behind)
        for k, side, point, behind in ((0, +1, np.zeros(3), intent.glass("sheet")), (1, -1, lens_2, None))
    ]
    bodies, moved = placed(intent.design.lattice.aperture, intent.listed(faces), lens_2)
    return assemble_window(intent, bodies, moved, lenses, offset)


def _slab_with_field(intent: Intent, separation: float, scale: float) -> Window:
    """Slab cut at the focus: two plates, or array 1, field plate and array 2 if foci differ."""
    n = intent.index
    if intent.eta[0] == intent.eta[1] or intent.etas_along_axes is not None:
        placed = two_plates(intent, separation, scale)
        lenses = one_faced(intent, separation, (n * separation, n * separation)).scaled(scale)
        return assemble_window(
            intent, placed.bodies, placed.moved, lenses, placed.offset, placed.field, placed.told
        )
    first, second = thin_pair(intent.eta, separation)
    gap = air_gap(intent)
    thickness = n * (min(first) - gap), n * (min(second) - gap)
    if min(thickness) <= 0.0:
        raise NoSuchLens(
            f"air gaps of {gap:.6g} leave a plate no thickness",
            key=PAIR.field,
            hint=f"gap < {min(*first, *second):.6g}",
            code="CL129",
        )
    lenses = one_faced(intent, separation, thickness).scaled(scale)
    return plano_with_field(intent, lenses)
