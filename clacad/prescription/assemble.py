"""Assembly of a window, form by form."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import hypot, isfinite, isinf
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import rounded_up
from clacad.base.types import Floats, Pair2
from clacad.design.asked_cells import lattice_of
from clacad.design.faces import faces_digest
from clacad.design.keys import BODY, LATTICE, PAIR
from clacad.design.process_profiles import profile
from clacad.design.sections import AimedAt
from clacad.prescription import poses
from clacad.prescription.best_recipe import residual
from clacad.prescription.cell_heights import auto_thickness, face_range, window_range
from clacad.prescription.faces_and_bodies import (
    LensPose,
    Shape,
    biconvex_body,
    plano_body,
    slab_body,
)
from clacad.prescription.field_lens import (
    Chief,
    air_gap,
    one_plate,
    plate_body,
    symmetric_foci,
    thin_field,
    two_plates,
)
from clacad.prescription.given import GivenFaces, given_pair, refuse_crossed, refuse_no_faces
from clacad.prescription.intent import Intent, separation_of
from clacad.prescription.plates import cells_outline, with_plate
from clacad.prescription.radii import (
    LensPair,
    NoSuchLens,
    biconvex_exact,
    biconvex_thin,
    single_surface,
    thin_focal_lengths,
    thin_pair,
)
from clacad.sheet.cell_places import CellPlacement
from clacad.sheet.lattice import Circle, Lattice, Rectangle
from clacad.sheet.plate import Plate
from clacad.sheet.turn import held_when_turned
from clacad.sheet.window import Baffle, Body, Land, ThinPair, Window, side_outline

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.design.sections import PairSpec
    from clacad.optics.material.material import Material


def build_window(design: Design) -> Window:
    """Build the window of a design; see `clacad.prescription.prescribe.prescribe`."""
    intent = _intent(design)
    if design.pair.given:
        refuse_crossed(design.pair)
    else:
        _refuse_radius(intent)
    window = _FORMS[design.pair.form](intent)
    if design.pair.given:
        refuse_no_faces(window)
    window = replace(window, z_range=window_range(window))
    asked = intent.law.refract(intent.turn[:, 2][None])[0]
    left = residual(window, intent.turn, _entry(window, intent), asked)
    return replace(window, residual=left)


def placed(design: Design) -> Window:
    """Window of a design with given faces, without checks and residual: a trial of a search."""
    return _FORMS[design.pair.form](_intent(design))


def _intent(design: Design) -> Intent:
    pair = design.pair
    material = None if pair.material is None else _find(pair.material)
    index = pair.index if material is None else float(material.index(pair.wavelength))
    assert index is not None  # the design holds exactly one of index and material
    law = design.law
    neck = design.body.neck
    if neck is None:
        neck = max(profile(design.check.process).neck / design.unit_m, min(design.lattice.pitch) / 50.0)
    return Intent(
        design,
        law,
        law.rotation,
        design.law_spec.eta,
        design.law_spec.delta,
        index,
        material,
        _lattice(design),
        GivenFaces(pair.form, pair.face) if pair.given else Shape(_conic(design, index), pair.depth),
        neck,
    )


def _find(name: str) -> Material:
    from clacad.optics.material.catalogue import find

    return find(name)


def _conic(design: Design, index: float) -> Pair2 | None:
    """Conic constants of a biconic; the default makes the axial beam stigmatic (plano outside: a start
    value).
    """
    pair = design.pair
    if pair.surface != "biconic":
        return None
    if pair.conic is not None:
        return pair.conic
    inside = pair.form == "plano" and pair.curved == "inside"
    k = -(index**2) if inside else -1.0 / index**2
    return k, k


def _lattice(design: Design) -> Lattice:
    """Pattern of cells, ended at a plate where one is requested."""
    plain = lattice_of(design)
    outline = cells_outline(design.lattice.outline, design.body)
    return replace(plain, outline=outline) if isinstance(outline, Plate) else plain


LEAST_SAG = 1e-14
"""Least sag of a lens over its cell, as part of the separation:
a smaller sag is below the rounding of its position.
"""


def _lens_reach(intent: Intent) -> tuple[Pair2, tuple[str, str]]:
    """Least reach of a lens from the centre of its cell along lens x and y (lengths), and the dimension it is
    half of.

    A cylinder, which has no power along its other axis, must reach across its cell only; any other lens must
    reach the corners.
    """
    corner = intent.lattice.circumradius
    across = np.abs(intent.lattice.tile() @ intent.turn[:2, :2]).max(axis=0)
    cylinder = [other == 1.0 for other in reversed(intent.eta)]
    x, y = (float(half) if alone else corner for half, alone in zip(across, cylinder, strict=True))
    first, second = ("width" if alone else "diagonal" for alone in cylinder)
    return (x, y), (first, second)


def _smaller_pitch(intent: Intent, axis: str, where: str, part: float) -> str:
    """Describe a sufficient pitch as a hint: a cylinder on an upright rectangle constrains one side only."""
    pitch = intent.lattice.pitch
    upright = where == "width" and not intent.lattice.hexagonal and abs(intent.turn[0, 1]) < 1e-12
    if upright:
        k = "xy".index(axis)
        return f"pitch along {axis} < {pitch[k] * part:.6g}"
    return f"pitch < {max(pitch) * part:.6g}"


def _refuse_radius(intent: Intent) -> None:
    """Refuse a face whose radius is below its reach in the cell, or that has almost no sag."""
    factor = intent.index - 1.0
    if intent.design.pair.form == "biconvex":
        factor *= 2.0
    for axis, value, reach, where in zip("xy", intent.eta, *_lens_reach(intent), strict=True):
        for number, f in enumerate(thin_focal_lengths(value, separation_of(intent)), start=1):
            radius = abs(factor * f)
            sag = reach * reach / (2.0 * radius) if radius > reach else reach
            if isfinite(radius) and sag < LEAST_SAG * separation_of(intent):
                raise NoSuchLens(
                    f"lens {number} would rise by {sag:.3g} over its cell in {axis}, less than its place"
                    f" between lenses {separation_of(intent):.6g} apart is known to",
                    key=PAIR.separation,
                    hint=(
                        f"a smaller separation or a larger pitch: the height must be above {LEAST_SAG:g} of"
                        " the separation"
                    ),
                )
            if radius < reach:
                raise NoSuchLens(
                    f"lens {number} would have the radius {radius:.6g} in {axis}, less than half the {where}"
                    f" of its cell ({reach:.6g}): the surface ends inside the cell",
                    key=LATTICE.pitch,
                    hint=(
                        f"{_smaller_pitch(intent, axis, where, radius / reach)}, or separation > "
                        f"{separation_of(intent) * reach / radius:.6g}"
                    ),
                )


# -- biconvex ---------------------------------------------------------------------------------------


def _biconvex(intent: Intent) -> Window:
    thickness = _solved(intent)
    window = _scaled_best(intent, lambda scale: _biconvex_given(intent, thickness, scale))
    _refuse_land_without_plate(intent.design, window)
    return window


def _scaled_best(intent: Intent, build: Callable[[float], Window]) -> Window:
    """Window with radii scaled for the least error where "best" is requested, else with scale 1."""
    pair = intent.design.pair
    if pair.given or pair.confocal != "best":
        return build(1.0)
    from clacad.prescription.best_recipe import best_scale

    return best_scale(intent, build)


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
    trial = _untraced(intent)
    return auto_thickness(lambda t: _biconvex_given(trial, t), guess, intent.neck, limit)


def _biconvex_given(intent: Intent, thickness: Pair2, scale: float = 1.0) -> Window:
    """Window of a biconvex pair with given thicknesses, its radii times `scale`."""
    pair = intent.design.pair
    separation = separation_of(intent)
    if pair.given:
        lenses = given_pair(pair, thickness, intent.index)
    elif pair.focus is not None:
        from clacad.prescription.sharp_pairs import sharp_thick_lenses

        lenses = sharp_thick_lenses(intent.eta, separation, pair.focus, thickness, intent.index)
    else:
        recipe = biconvex_exact if pair.confocal == "exact" else biconvex_thin
        lenses = recipe(intent.eta, separation, thickness, intent.index)
    lenses = lenses.scaled(scale)
    offset = intent.built_offset(lenses)
    plate, ideal = None, lenses
    if pair.field_lens:
        # the plate's position follows from eta alone, so that given and derived faces have the same position
        if pair.given:
            ideal = biconvex_exact(intent.eta, separation, thickness, intent.index)
        rooms = [symmetric_foci(ideal.radius[k], thickness[k], intent.index) for k in (0, 1)]
        plate = one_plate(intent, ideal.focal_length, rooms[0], min(rooms[1]) - 0.5 * thickness[1])
    place = poses.biconvex_placement(intent.turn, offset, separation)
    moved = poses.displacement(
        (), intent.design.lattice.aperture, place.lens_2[:2], float(place.lens_2[2]), False
    )
    lens_2, added = place.lens_2, np.zeros(3)
    if plate is not None:
        added = plate.added(intent.index) * intent.turn[:, 2]
        lens_2 = lens_2 + added
        if intent.design.lattice.aperture != "aligned":  # the plate carries the ray to cell 2 along the axis
            moved = (moved[0] + float(added[0]), moved[1] + float(added[1]))
    relative = lens_2 - np.array([*moved, 0.0])
    bodies = tuple(
        biconvex_body(
            lenses,
            k,
            LensPose(point, intent.turn),
            intent.shape,
            intent.index,
            _web(intent, lenses, k, float(point[2])),
        )
        for k, point in enumerate((np.zeros(3), relative))
    )
    if plate is None:
        return _assemble_window(intent, bodies, moved, lenses, offset, separation)
    axis = intent.turn[:, 2]
    height = float((lens_2 - np.array([*moved, 0.0])) @ axis) / axis[2]
    reduced = ideal.focal_length[0][0] + ideal.focal_length[1][0]
    chief = Chief.of(intent, (np.array([*moved, height]) @ intent.turn)[:2], reduced)
    legs = ((min(ideal.focal_length[0]), 1.0), (plate.thickness, intent.index))
    field, shift = plate_body(intent, plate, (chief.across(legs[:1]), chief.across(legs)))
    bodies = (bodies[0], field, bodies[1])
    return _assemble_window(intent, bodies, moved, lenses, offset, separation, shift, plate.told)


def _web(intent: Intent, lenses: LensPair, number: int, centre: float) -> Pair2 | None:
    """Front and back z of the plate that joins the lenslets of one array;
    None without one or for a concave lens.
    """
    spec = intent.design
    bordered = spec.body.apart or spec.lattice.outline is not None
    web = spec.pair.web
    if web is None or (web == 0.0 and bordered):
        web = intent.neck  # the border is a plate; a web must join it to the lenslets
    radii: tuple[float, ...] = lenses.radius[number]
    if spec.pair.given:
        radii = tuple(r for face in spec.pair.face[spec.pair.lens_faces(number)] for r in face.radius)
    if web == 0.0 or any(r < 0.0 for r in radii):
        return None
    return centre - 0.5 * web, centre + 0.5 * web


# -- slab and plano ---------------------------------------------------------------------------------


def _one_faced(intent: Intent, separation: float, thickness: Pair2) -> LensPair:
    """Lenses with one curved face each: as given, else from the requested η,
    afocal or with the requested focus.
    """
    pair = intent.design.pair
    if pair.given:
        return given_pair(pair, thickness, intent.index)
    if pair.focus is not None:
        from clacad.prescription.sharp_pairs import behind_plates, seen_through, sharp_lenses

        seen = (
            seen_through(pair.focus, thickness, intent.index) if behind_plates(intent.design) else pair.focus
        )
        return sharp_lenses(intent.eta, separation, seen, thickness, intent.index)
    return single_surface(intent.eta, separation, thickness, intent.index)


def _slab(intent: Intent) -> Window:
    """Window of one body with both arrays on its faces."""
    return _scaled_best(intent, lambda scale: _slab_scaled(intent, scale))


def _slab_scaled(intent: Intent, scale: float) -> Window:
    """Slab with its radii times `scale`."""
    separation = separation_of(intent)
    if intent.design.pair.field_lens:
        return _slab_with_field(intent, separation, scale)
    thickness = intent.index * separation
    lenses = _one_faced(intent, separation, (thickness, thickness)).scaled(scale)
    offset = intent.built_offset(lenses)
    place = poses.slab_placement(intent.turn, offset, thickness)
    body = slab_body(
        lenses,
        (LensPose(np.zeros(3), intent.turn), LensPose(place.lens_2, intent.turn)),
        intent.shape,
        intent.index,
    )
    height = float(place.lens_2[2])
    moved = poses.displacement((body,), intent.design.lattice.aperture, place.lens_2[:2], height, True)
    body = slab_body(
        lenses,
        (LensPose(np.zeros(3), intent.turn), LensPose(place.lens_2 - np.array([*moved, 0.0]), intent.turn)),
        intent.shape,
        intent.index,
    )
    return _assemble_window(intent, (body,), moved, lenses, offset, separation)


def _slab_with_field(intent: Intent, separation: float, scale: float) -> Window:
    """Slab cut at the focus: two plates, or array 1, the field plate and array 2 where the meridians' foci
    differ.
    """
    n = intent.index
    if intent.eta[0] == intent.eta[1]:
        placed = two_plates(intent, separation, scale)
        lenses = _one_faced(intent, separation, (n * separation, n * separation)).scaled(scale)
        return _assemble_window(
            intent, placed.bodies, placed.moved, lenses, placed.offset, separation, placed.field, placed.told
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
    lenses = _one_faced(intent, separation, thickness).scaled(scale)
    return _plano_with_field(intent, lenses, separation)


def _plano_with_field(intent: Intent, lenses: LensPair, separation: float) -> Window:
    """Window of two plano lenses with the field plate between them; nothing is tilted."""
    n, (t1, t2) = intent.index, lenses.thickness
    outside = intent.design.pair.form == "slab" or intent.design.pair.curved == "outside"
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
    plate = one_plate(intent, (first, second), foci, behind)
    behind -= 0.0 if plate.crossed else plate.thickness / n
    offset = intent.built_offset(lenses)
    legs = ((glass[0], n), (before, 1.0), (plate.thickness, n), (behind, 1.0), (glass[1], n))
    turn = intent.turn[:2, :2]
    aligned = intent.design.lattice.aperture == "aligned"
    chief = Chief.of(intent, 0.0 * offset if aligned else offset, separation)
    moved_x, moved_y = turn @ chief.across(legs)
    moved = float(moved_x), float(moved_y)
    height = sum(length for length, _ in legs)
    lens_2 = np.array([*(turn @ offset), height])
    planes = (t1, height - t2) if outside else (-t1, height + t2)
    points = (np.zeros(3), lens_2 - np.array([*moved, 0.0]))
    arrays = [
        plano_body(
            lenses, k, LensPose(points[k], intent.turn), intent.shape, n, outside == (k == 0), planes[k]
        )
        for k in (0, 1)
    ]
    field, shift = plate_body(intent, plate, (chief.across(legs[:2]), chief.across(legs[:3])))
    bodies = (arrays[0], field, arrays[1])
    return _assemble_window(intent, bodies, moved, lenses, offset, separation, shift, plate.told)


def _plano(intent: Intent) -> Window:
    """Window of two plano lenses, curved faces inside or outside."""
    return _scaled_best(intent, lambda scale: _plano_scaled(intent, scale))


def _plano_scaled(intent: Intent, scale: float) -> Window:
    """Plano pair with its radii times `scale`."""
    pair = intent.design.pair
    separation = separation_of(intent)
    thickness = pair.thicknesses or _plano_auto(intent, separation)
    lenses = _one_faced(intent, separation, thickness).scaled(scale)
    if pair.field_lens:
        return _plano_with_field(intent, lenses, separation)
    offset = intent.built_offset(lenses)
    if pair.curved == "inside":
        place = poses.plano_inside_placement(intent.law, offset, separation, intent.index)
        return _plano_placed(intent, lenses, place.lens_2, place.rotation, offset)
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
    lens_2 = poses.plano_outside_axis(intent.turn, intent.index, thickness, gap)
    lens_2 = lens_2 + intent.turn @ np.array([*offset, 0.0])
    return _plano_placed(intent, lenses, lens_2, intent.turn, offset)


def _afocal_gap(intent: Intent, thickness: Pair2, guess: float) -> float:
    """Air gap (length) of a tilted plano pair: that of the ellipsoids of law.eta, regardless of the built
    faces.

    A gap solved for the built faces makes any pair of faces afocal. A search over faces or their scale would
    then increase the separation, because the error falls as the cube of pitch over separation.
    """
    plain = replace(_untraced(intent), shape=Shape(None, None))
    lenses = single_surface(intent.eta, separation_of(intent), thickness, intent.index)

    def built(gap: float) -> Window:
        # without the offset: off its axis lens 2 adds aberration that is unrelated to the gap
        lens_2 = poses.plano_outside_axis(intent.turn, intent.index, thickness, gap)
        return _plano_placed(plain, lenses, lens_2, intent.turn, np.zeros(2))

    return poses.best_gap(built, intent.turn, guess)


def _untraced(intent: Intent) -> Intent:
    """Intent with paraxially placed lenses: trials of a thickness trace no light."""
    design = intent.design
    return replace(intent, design=replace(design, pair=replace(design.pair, offset="paraxial")))


def _plano_auto(intent: Intent, separation: float) -> Pair2:
    """Smallest vertex-to-plane thickness that leaves the neck under the whole lens,
    and the land if there is one.
    """
    found = _plano_auto_of(intent, separation, _one_faced(intent, separation, (0.0, 0.0)))
    if intent.design.pair.focus is None:
        return found
    for _ in range(SETTLING):  # sharp lenses behind their own plates depend slightly on the thickness
        found = _plano_auto_of(intent, separation, _one_faced(intent, separation, found))
    return found


SETTLING = 4
"""Number of iterations of thickness and radii of sharp lenses: each gains three digits."""


def _plano_auto_of(intent: Intent, separation: float, trial: LensPair) -> Pair2:
    """Smallest vertex-to-plane thickness, as `_plano_auto`, for the lenses of `trial`."""
    trial = replace(trial, thickness=(0.0, 0.0))
    window = _plano_placed(
        _untraced(intent),
        trial,
        np.array([0.0, 0.0, separation]),
        intent.turn if intent.design.pair.curved == "outside" else poses.shallower(intent.law, intent.index),
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
    """Window of plano lenses, lens 2's apex at `lens_2` (3,) from lens 1's,
    both rotated by `turn` (lens → sheet).
    """
    outside = intent.design.pair.curved == "outside"
    t1, t2 = lenses.thickness
    planes = (t1, float(lens_2[2]) - t2) if outside else (-t1, float(lens_2[2]) + t2)

    def bodies(moved: Pair2) -> tuple[Body, ...]:
        points = (np.zeros(3), lens_2 - np.array([*moved, 0.0]))
        return tuple(
            plano_body(
                lenses,
                k,
                LensPose(points[k], turn),
                intent.shape,
                intent.index,
                outside == (k == 0),
                planes[k],
            )
            for k in (0, 1)
        )

    aperture = intent.design.lattice.aperture
    moved = poses.displacement(bodies((0.0, 0.0)), aperture, lens_2[:2], float(lens_2[2]), True)
    return _assemble_window(intent, bodies(moved), moved, lenses, offset, separation_of(intent))


def _entry(window: Window, intent: Intent) -> Floats:
    """Point of the axis ray before the window, sheet frame."""
    pair = intent.design.pair
    if pair.form == "plano" and pair.curved == "inside":
        glass = poses.shallower(intent.law, intent.index)[:, 2]
        plane = window.bodies[0].front.vertex[2]
        return np.asarray(glass * (plane / glass[2]))
    return np.zeros(3)


# -- what all forms share ---------------------------------------------------------------------------


def _assemble_window(
    intent: Intent,
    bodies: tuple[Body, ...],
    moved: Pair2,
    lenses: LensPair,
    offset: Floats,
    separation: float,
    field: Pair2 | None = None,
    told: Mapping[str, Any] | None = None,
) -> Window:
    """Window of placed bodies: thin pair, land, outline; lengths in design units.

    moved : displacement of array 2's cells; offset : (2,) of lens 2 off lens 1's axis; field : displacement
        of the
    field lens's cells; `told` : the recipe's entries for the field lens.
    """
    design = intent.design
    # the ideal pair shares a focal plane exactly, independent of what thick lenses need for that
    thin_focal = thin_pair(intent.eta, separation)
    thin_d = intent.offset(thin_focal[0])
    thin_offset = intent.turn @ np.array([thin_d[0], thin_d[1], separation])
    thin_shift = poses.displacement(
        (), design.lattice.aperture, thin_offset[:2], float(thin_offset[2]), False
    )
    land = Land(design.lattice.seam, design.lattice.land == "opaque", design.body.border)
    window = Window(
        form=(
            "plano" if design.pair.form == "slab" and len(bodies) == 3 else design.pair.form
        ),  # the form as built
        bodies=tuple(replace(body, material=intent.material) for body in bodies),
        lattice=intent.lattice,
        placements=tuple(
            CellPlacement(shift) for shift in ((0.0, 0.0), moved, *(() if field is None else (field,)))
        ),
        unit=design.unit_m,
        z_range=(0.0, 0.0),
        law=intent.law,
        thin=ThinPair(
            thin_focal,
            _triple(thin_offset),
            intent.turn,
            thin_shift,
            field=() if field is None else thin_field(intent.eta, separation),
        ),
        land=land,
        baffle=Baffle(design.body.baffle_wall or 0.0) if design.body.baffle else None,
        wavelength=design.pair.wavelength,
        recipe={**_recipe(intent, lenses, offset, separation), **({} if told is None else {"field": told})},
        name=design.name,
    )
    window = _own_places(window, design)
    window = replace(window, outline=side_outline(window))
    second, cut = window.placements[1], window.lattice.outline
    moved = second.shift if window.form == "slab" else (0.0, 0.0)
    wider = max(second.scale(window.lattice))
    if second.turn and isinstance(cut, Rectangle):
        wider = max(wider, 1.0) / held_when_turned((cut.width, cut.height), second.turn)
    if isinstance(cut, Circle | Rectangle) and (moved != (0.0, 0.0) or wider > 1.0):
        # whole cells of both arrays must lie inside: array 2's are displaced by `moved`, and may be larger
        window = replace(window, lattice=replace(window.lattice, outline=_within(cut, moved, wider)))
        _refuse_empty(window.lattice, moved, wider)
    return _with_land(with_plate(window, design.body), intent)


def _within(outline: Circle | Rectangle, moved: Pair2, wider: float) -> Circle | Rectangle:
    """Outline reduced so that its contents lie in `outline` with and without displacement by `moved` and
    scale `wider`.
    """
    if isinstance(outline, Circle):
        return Circle(max((outline.diameter - 2.0 * hypot(*moved)) / max(wider, 1.0), 0.0))
    width, height = outline.width - 2.0 * abs(moved[0]), outline.height - 2.0 * abs(moved[1])
    return Rectangle(max(width / max(wider, 1.0), 0.0), max(height / max(wider, 1.0), 0.0))


def _own_places(window: Window, design: Design) -> Window:
    """Window with lenses repositioned for a varying law, focus, pitch 2, viewer or traced offset,
    where requested.
    """
    aperture = design.lattice.aperture
    if design.law_spec.varying is not None:
        from clacad.prescription.varying_cells import with_varying_law

        return with_varying_law(window, design)
    if design.pair.focus is not None:
        from clacad.prescription.sharp_pairs import with_focus

        return with_focus(window, design)
    if design.lattice.pitch_2 is not None or design.lattice.rotation_2:
        from clacad.prescription.superlens import with_pitch_2

        return with_pitch_2(window, design)
    if isinstance(aperture, AimedAt):
        from clacad.prescription.aimed_cells import aimed

        return aimed(window, design)
    if design.pair.offset == "traced":
        from clacad.prescription.aimed_cells import traced

        return traced(window)
    return window


def _refuse_empty(lattice: Lattice, moved: Pair2, wider: float) -> None:
    """Refuse a displaced slab without a whole cell of both arrays inside the outline:
    a sheet without lenses.
    """
    if lattice.holds_a_cell:
        return
    least = lattice.least_outline()
    if isinstance(least, Circle):
        shape = f"circle = {rounded_up(max(wider, 1.0) * least.diameter + 2.0 * hypot(*moved))}"
    else:
        sides = tuple(
            max(wider, 1.0) * size + 2.0 * abs(m)
            for size, m in zip((least.width, least.height), moved, strict=True)
        )
        shape = f"rectangle = [{', '.join(map(rounded_up, sides))}]"
    raise NoSuchLens(
        f"lattice.outline holds no cell that is whole in both arrays: they stand {hypot(*moved):.4g} apart",
        key=LATTICE.outline,
        hint=(
            f"outline = {{{shape}}} or larger; or smaller angles, delta or separation, which bring the arrays"
            " together"
        ),
        code="CL117",
    )


def _triple(v: Floats) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])


def _with_land(window: Window, intent: Intent) -> Window:
    """Return the window with the land that faces of plano lenses, slabs and field lenses need (seam, border,
    outline).

    The land lies `seam_depth` below the deepest point of the array's optical zone, so that it is outside the
    range of the border heights.
    """
    if window.land.seam == 0.0 and window.outline is None:
        return window
    depth = intent.design.lattice.seam_depth
    depth = min(window.lattice.pitch) / 50.0 if depth is None else depth

    def landed(body: Body) -> Body:
        faces = []
        for face in (body.front, body.back):
            if face.array is not None:
                low, high = face_range(window, face)
                face = replace(face, land=high + depth if face.side > 0 else low - depth)
            faces.append(face)
        return replace(body, front=faces[0], back=faces[1])

    plates = [window.form != "biconvex" or body.name == "field" for body in window.bodies]
    return replace(
        window,
        bodies=tuple(
            landed(body) if plate else body for body, plate in zip(window.bodies, plates, strict=True)
        ),
    )


def _recipe(intent: Intent, lenses: LensPair, offset: Floats, separation: float) -> Mapping[str, Any]:
    """Record of radii and poses, for reports and the manifest."""
    pair = intent.design.pair
    given = pair.given
    return {
        "confocal": None if given else pair.confocal if pair.form == "biconvex" else "exact",
        "R": [list(face.radius) for face in pair.face] if given else [list(r) for r in lenses.radius],
        "f": [list(f) for f in lenses.focal_length],
        "d": [float(d) for d in offset],
        "T": list(lenses.thickness),
        "n": intent.index,
        "s": separation,
        "surface": "given" if given else pair.surface,
        "wavelength_nm": pair.wavelength * 1e9,
        "material": pair.material,
        "curved": pair.curved if pair.form == "plano" else None,
        "warnings": [],
    } | _search(pair)


def _search(pair: PairSpec) -> dict[str, Any]:
    """Record of the search that found the given faces, and whether they are unchanged;
    empty for other faces.
    """
    if pair.search is None:
        return {}
    unchanged = pair.search.faces_sha256 == faces_digest(pair.face)
    return {"search": pair.search.to_dict() | {"unchanged": unchanged}}


_FORMS = {"biconvex": _biconvex, "plano": _plano, "slab": _slab}
"""Form of a pair → function that builds its window."""
