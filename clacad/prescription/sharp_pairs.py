"""Pairs that image one plane sharply to another (`[pair] focus`): not afocal, array 2 with its own pitch.

η is kept for chief rays, those through the centre of lens 1. Lens 2 is therefore the lens of the afocal pair,
t' = (t − δ)/η holds for chief rays in every cell, and only lens 1 changes. Every pair then images the object
plane to the image plane. The images of all pairs coincide where array 2 has the pitch
p1 (1 − f2/ζ)/(1 + f1/z): D. Gabor, UK patent 541 753 (1940).

Glass has an effect. Plane faces before lens 1 and behind lens 2 (plano, curved inside) bring the planes
nearer by T (1 − 1/n). A biconvex lens is a thin one whose two principal planes are its hiatus apart;
separation and planes are reduced by half of it. Lenses and pitch are solved for the reduced distances; the
thin pair is that of the requested planes.

Planes lie across the axis of the lenses. Of tilted lenses they are inclined to the sheet: each cell has its
own distances, its law has the δ that sends the chief ray of the axis's point to its image, and its lens 1 has
the size for these distances. Array 2 keeps the pitch of the middle cell, lenses 2 follow their laws.

A field lens keeps the image between the lenses at itself: 1/f1 = (1 − η)/s − 1/z and 1/f2 of the afocal pair
+ 1/ζ. Lens 2 then bends chief rays as well where its cell is not centred on it; its vertex allows for that.

Near f1 = −z the image by lens 1 goes to infinity and the pair is no telescopelet: it is refused, with planes
that work.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats, Ints, Pair2
from clacad.base.vectors import xy
from clacad.design.sections import PAIR
from clacad.design.varying import Planes
from clacad.optics.law.focusing import SharpPair
from clacad.prescription.bodies import FieldCells
from clacad.prescription.radii import (
    LensPair,
    NoSuchLens,
    back_focal_distance,
    refuse_too_thick,
    symmetric_radius,
    thin_focal_lengths,
    thin_pair,
)
from clacad.sheet.cell_places import CellLaws, CellPlacement, VertexChange, lens_plane_slope, linear_change
from clacad.sheet.volume_and_extent import FIELD
from clacad.sheet.window import Face, Window, changed_faces

if TYPE_CHECKING:
    from clacad.design import Design

KEY = PAIR.focus
ROUNDS = 60
"""Greatest number of iterations of the principal planes: each gains two or three digits."""
UNLIKE = 2.0
"""Greatest factor between f1, or array 2's pitch, and that of the afocal pair."""
LADDER = 1.25
"""Factor by which planes are moved away until they work."""


@dataclass(frozen=True, slots=True)
class SharpPlanes(Planes):
    """Planes as the lenses see them; `field`: whether a field lens images lens 1 onto lens 2."""

    field: bool = False


def planes_of(design: Design, thickness: Pair2, index: float) -> SharpPlanes:
    """Planes (lengths) that the lenses of a design see, through the plates before and behind them if any."""
    planes, lensed = design.pair.focus, bool(design.pair.field_lens)
    assert planes is not None  # callers check it
    outside = design.pair.form == "plano" and design.pair.curved == "inside"
    before, behind = (t * (1.0 - 1.0 / index) if outside else 0.0 for t in thickness)
    # equivalent air distances, paraxial
    return SharpPlanes(planes.object + before, planes.image - behind, lensed)


def sharp_pairs(eta: Pair2, separation: float, planes: SharpPlanes) -> tuple[SharpPair, SharpPair]:
    """Lenses of both meridians.

    Raises NoSuchLens: The pair would be no telescopelet; the message has planes that work.
    """
    found = _pairs(eta, separation, planes)
    for axis, value, pair in zip("xy", eta, found, strict=True):
        why = _no_telescopelet(value, separation, pair)
        if why:
            raise NoSuchLens(
                f"focus: {why} in {axis}: the planes lie too near to the foci of the lenses",
                key=KEY,
                hint=_farther(eta, separation, planes),
                code="CL120",
            )
    return found


def _pairs(eta: Pair2, separation: float, planes: SharpPlanes) -> tuple[SharpPair, SharpPair]:
    x, y = (SharpPair.of(value, separation, planes.object, planes.image, planes.field) for value in eta)
    return x, y


def _no_telescopelet(eta: float, separation: float, pair: SharpPair) -> str:
    """Reason why a meridian is no telescopelet, "" if it is one."""
    afocal_pair = thin_focal_lengths(eta, separation)
    for number, (f, afocal) in enumerate(zip(pair.focal_lengths, afocal_pair, strict=True), start=1):
        if not 1.0 / UNLIKE <= f / afocal <= UNLIKE:
            return (
                f"lens {number} would need the focal length {f:.4g}, where the afocal pair has {afocal:.4g},"
            )
    ratio = pair.pitch_ratio
    if not 1.0 / UNLIKE <= ratio <= UNLIKE:
        return f"array 2 would need {ratio:.4g} times the pitch of array 1"
    return ""


def _farther(eta: Pair2, separation: float, planes: SharpPlanes) -> str:
    """Describe planes that work: the requested two, multiplied by a common factor."""
    factor = 1.0
    while factor < 1e9:
        factor *= LADDER
        trial = SharpPlanes(
            _shortened(planes.object * factor), _shortened(planes.image * factor), planes.field
        )
        pairs = _pairs(eta, separation, trial)
        if not any(_no_telescopelet(value, separation, pair) for value, pair in zip(eta, pairs, strict=True)):
            return f"object = {trial.object:g}, image = {trial.image:g}"
    return "planes farther off"


def _shortened(length: float) -> float:
    return float(f"{length:.3g}") if isfinite(length) else length


def sharp_lenses(
    eta: Pair2, separation: float, planes: SharpPlanes, thickness: Pair2, index: float
) -> LensPair:
    """Lenses with one curved face each, R = (n − 1) f, exact in paraxial light for any thickness."""
    focal = _lens_by_lens(sharp_pairs(eta, separation, planes))
    (a, b), (c, d) = focal
    power = index - 1.0
    return LensPair(focal, ((power * a, power * b), (power * c, power * d)), thickness)


def sharp_thin_lenses(
    eta: Pair2, separation: float, planes: SharpPlanes, thickness: Pair2, index: float
) -> LensPair:
    """Biconvex lenses by the thin recipe, R = 2 (n − 1) f with the focal lengths of thin lenses."""
    return sharp_lenses(eta, separation, planes, thickness, 2.0 * index - 1.0)


def sharp_thick_lenses(
    eta: Pair2, separation: float, planes: SharpPlanes, thickness: Pair2, index: float
) -> LensPair:
    """Symmetric biconvex lenses, centres `separation` apart, exact in paraxial light for any thickness.

    Raises NoSuchLens: A lens thicker than n f, or no telescopelet; the message has planes that work.
    """
    sharp_pairs(eta, separation, planes)  # refuses planes that no thickness can correct
    focal = _lens_by_lens(thick_pairs(eta, separation, planes, thickness, index))
    (f1x, f1y), (f2x, f2y) = focal
    for axis, f1, f2 in (("x", f1x, f2x), ("y", f1y, f2y)):
        refuse_too_thick(f1, f2, thickness, index, axis, separation)
    first, second = (
        (symmetric_radius(fx, t, index), symmetric_radius(fy, t, index))
        for (fx, fy), t in zip(focal, thickness, strict=True)
    )
    return LensPair(focal, (first, second), thickness)


def thick_pairs(
    eta: Pair2, separation: float, planes: SharpPlanes, thickness: Pair2, index: float
) -> tuple[SharpPair, SharpPair]:
    """Thin equivalents of symmetric thick lenses, between principal planes, solved by iteration."""
    x, y = (_thick_meridian(value, separation, planes, thickness, index) for value in eta)
    return x, y


def _thick_meridian(
    eta: float, separation: float, planes: SharpPlanes, thickness: Pair2, index: float
) -> SharpPair:
    lost, pair = (0.0, 0.0), SharpPair.of(eta, separation, planes.object, planes.image, planes.field)
    for _ in range(ROUNDS):
        before = lost
        (f1, f2), (t1, t2) = pair.focal_lengths, thickness
        lost = (0.5 * hiatus(f1, t1, index), 0.5 * hiatus(f2, t2, index))
        pair = SharpPair.of(
            eta,
            separation - lost[0] - lost[1],
            planes.object + lost[0],
            planes.image - lost[1],
            planes.field,
        )
        if lost == before or not all(map(isfinite, lost)):
            break
    return pair


def hiatus(focal_length: float, thickness: float, index: float) -> float:
    """Distance of a symmetric lens's principal planes, front to back, length; NaN: no such lens."""
    return thickness - 2.0 * (focal_length - back_focal_distance(focal_length, thickness, index))


def chief_focal_lengths(design: Design, thickness: Pair2, index: float, separation: float) -> Pair2:
    """Focal lengths (f1x, f1y) of the afocal pair: they relate chief rays' δ to lens 2's offset."""
    eta = design.law_spec.eta
    if not thick_lenses(design):
        return thin_pair(eta, separation)[0]
    pairs = thick_pairs(eta, separation, planes_of(design, thickness, index), thickness, index)
    x, y = (thin_focal_lengths(value, one.separation)[0] for value, one in zip(eta, pairs, strict=True))
    return x, y


def _lens_by_lens(pairs: tuple[SharpPair, SharpPair]) -> tuple[Pair2, Pair2]:
    (f1x, f2x), (f1y, f2y) = (pair.focal_lengths for pair in pairs)
    return (f1x, f1y), (f2x, f2y)


def images_between(design: Design, separation: float, thickness: Pair2, index: float) -> LensPair:
    """Symmetric lenses with their foci where sharp thick lenses have the image between them.

    Their focal lengths are the distances to it from the principal planes of the sharp lenses; the radii are
    those of lenses with these focal lengths.
    """
    (f1x, f2x), (f1y, f2y) = (
        thin_focal_lengths(value, one.separation)
        for value, one in zip(
            design.law_spec.eta,
            thick_pairs(
                design.law_spec.eta, separation, planes_of(design, thickness, index), thickness, index
            ),
            strict=True,
        )
    )
    first, second = (
        (symmetric_radius(fx, t, index), symmetric_radius(fy, t, index))
        for (fx, fy), t in zip(((f1x, f1y), (f2x, f2y)), thickness, strict=True)
    )
    return LensPair(((f1x, f1y), (f2x, f2y)), (first, second), thickness)


def refocused(offset: Floats, cell: Floats, focal: Pair2, afocal: Pair2) -> Floats:
    """Offset (2,), lengths, of a lens 2 of focal lengths `focal` in place of `afocal`, chief rays unchanged.

    They reach it in the centre of its cell, `cell` (2,) from the axis of lens 1; its vertex bends them.
    """
    return np.asarray(cell + (offset - cell) * np.divide(focal, afocal))


def with_focus(window: Window, design: Design, focal: Pair2 | None) -> Window:
    """Uniform window with array 2 spread so that the images of all pairs coincide; `focal` as of
    `with_pitch_2`, None: that of the afocal pair.
    """
    planes = planes_of(design, (0.0, 0.0), 1.0)
    separation, (t1, t2), index = window.thin.separation, window.recipe["T"], window.recipe["n"]
    thin, pairs = sharp_pairs(design.law_spec.eta, separation, planes), _pairs_as_built(window, design)
    pitch, thin_pitch = _spread(window, pairs), _spread(window, thin)
    focal = chief_focal_lengths(design, (t1, t2), index, separation) if focal is None else focal
    made = spread_to(window, pitch, focal)
    if planes.field:  # nothing is tilted
        turn, (x, y, z) = made.thin.rotation[:2, :2], made.thin.offset
        afocal, bent = thin_pair(design.law_spec.eta, separation)[1], _lens_by_lens(thin)[1]
        moved = turn @ refocused(turn.T @ [x, y], turn.T @ made.thin.shift, bent, afocal)
        made = replace(made, thin=replace(made.thin, offset=(*xy(moved), z)))
    told = {
        "object": planes.object,
        "image": planes.image,
        "pitch_2": list(pitch),
        "magnification": [pair.magnification for pair in thin],
    }
    return replace(
        made,
        cell_laws=made.cell_laws if window.cell_laws is None else window.cell_laws,
        thin=replace(
            made.thin,
            focal_length=_lens_by_lens(thin),
            pitch=thin_pitch,
            change=made.thin.change
            and _climbing(CellPlacement(pitch=thin_pitch).aside(window.lattice), made.thin.rotation),
        ),
        recipe={
            **window.recipe,
            "focus": {name: None if value in (inf, -inf) else value for name, value in told.items()},
        },
    )


def _pairs_as_built(window: Window, design: Design) -> tuple[SharpPair, SharpPair]:
    """Thin equivalents of the pairs of a uniform window, at their reduced distances."""
    eta, separation, (t1, t2), index = (
        design.law_spec.eta,
        window.thin.separation,
        *(window.recipe[name] for name in "Tn"),
    )
    planes = planes_of(design, (t1, t2), index)
    if thick_lenses(design):
        return thick_pairs(eta, separation, planes, (t1, t2), index)
    gap = window.recipe.get("field", {}).get("gap", 0.0)  # of air between two plates with a field lens
    return sharp_pairs(eta, separation + gap, planes)


def inclined_sizes(window: Window, design: Design, cells: Ints) -> tuple[Floats, Floats]:
    """Lenses 1 of `cells` (n, 2) over that of the middle cell, as built and thin, (n,) each.

    Planes across the axis of tilted lenses lie at another distance from every cell of the sheet. f2 is that
    of the afocal pair; lens 1 images the object of its cell to where lens 2 needs it.
    """
    planes, centres = design.pair.focus, window.lattice.centres(cells)
    assert planes is not None  # callers check it
    apart = np.asarray(centres @ window.law.rotation[:2, 2])
    thin = _focal_lengths(
        SharpPair.of(window.law.eta_x, window.thin.separation, planes.object, planes.image), apart
    )
    built = _focal_lengths(_pairs_as_built(window, design)[0], apart)
    if thick_lenses(design):
        thickness, index = window.recipe["T"][0], window.recipe["n"]
        built = built * (1.0 + np.sqrt(1.0 - thickness / (index * built)))
    return built[1:] / built[0], thin[1:] / thin[0]


def _focal_lengths(pair: SharpPair, apart: Floats) -> Floats:
    """f1 (1 + n,), lengths, of a pair, and of one `apart` (n,) farther along its axis before both planes."""
    along = np.concatenate([[0.0], apart])
    near, far = 1.0 / (pair.object_z - along), 1.0 / (pair.image_distance - along)
    f2 = pair.focal_lengths[1]
    return np.asarray(1.0 / (1.0 / (pair.separation - f2 / (1.0 - f2 * far)) - near))


def thick_lenses(design: Design) -> bool:
    """Whether the principal planes of a biconvex pair count; the thin recipe leaves them out."""
    return design.pair.form == "biconvex" and design.pair.confocal == "exact"


def _spread(window: Window, pairs: tuple[SharpPair, SharpPair]) -> Pair2:
    """Pitch (x, y), lengths, of array 2 at which the images of all pairs coincide."""
    turned = abs(window.law.rotation[1, 0]) > 0.5  # the lenses' x lies along the cells' y
    along_cells = pairs[::-1] if turned else pairs
    x, y = (one.pitch_ratio * p for one, p in zip(along_cells, window.lattice.pitch, strict=True))
    return x, y


# -- array 2 with its own pitch or turn ----------------------------------------------------------------


def with_pitch_2(window: Window, design: Design, focal: Pair2 | None = None) -> Window:
    """Uniform window with array 2 spread to its own pitch and turned.

    `focal` (lengths) relates the displacement of lens 2 and its cell to δ; None: the focal length of lens 1.

    Raises NoSuchLens: Lens 1 has no power in a meridian: δ does not determine the position of its partners.
    """
    pitch, turn = design.lattice.pitch_2, design.lattice.rotation_2
    focal = window.recipe["f"][0] if focal is None else focal
    if not np.isfinite(focal).all():
        key = "rotation_2" if pitch is None else "pitch_2"
        raise NoSuchLens(
            f"eta = 1 with {key}: a lens without power has no axis to be decentred from",
            key=f"lattice.{key}",
            code="CL111",
            hint="eta other than 1 in both x and y",
        )
    return spread_to(window, pitch, focal, turn)


def spread_to(window: Window, pitch: Pair2 | None, focal: Pair2, turn: float = 0.0) -> Window:
    """Uniform window with array 2 spread to a pitch (lengths) and turned (radians).

    `focal` (lengths) relates lens 2's displacement to δ.
    """
    place = CellPlacement(window.placements[1].shift, pitch, turn)
    aside, tilted = place.aside(window.lattice), window.law.theta != 0.0
    axes = window.law.rotation[:2, :2]
    (a, b), (c, d) = (
        ((np.linalg.inv(axes) if tilted else axes.T) @ aside) / np.asarray(focal)[:, None]
    ).tolist()

    def raised(face: Face) -> Face:
        return replace(face, change=_climbing(aside, face.rotation)) if face.array == 1 and tilted else face

    return replace(
        window,
        bodies=changed_faces(window.bodies, raised),
        placements=(CellPlacement(), place),
        cell_laws=CellLaws(window.law, ((a, b), (c, d))),
        thin=replace(
            window.thin,
            pitch=pitch,
            turn=turn,
            change=_climbing(aside, window.thin.rotation) if tilted else None,
        ),
    )


def _climbing(aside: Floats, turn: Floats) -> VertexChange:
    """Lenses that rise with their cells, displaced in the sheet, to stay in their own lens plane."""
    x, y = (np.array(lens_plane_slope(turn)) @ aside).tolist()
    return VertexChange(climb=(x, y))


# -- field lens between the arrays ----------------------------------------------------------------------


def placed_field(window: Window, field: FieldCells, before: Pair2) -> Window:
    """Window with the field lens's cells and vertices on the lines between the centres of its other cells.

    before : displacement of array 2 for which `field` was built (lengths)
    """
    second, lattice = window.placements[1], window.lattice
    moved = np.subtract(second.shift, before)
    shift = np.asarray(field.shift) + field.share @ moved
    place, rest = second.between(lattice, field.share, (float(shift[0]), float(shift[1])))
    shares = iter(field.faces)

    def changed(face: Face) -> Face:
        if face.array != FIELD:
            return face
        share = next(shares, field.faces[-1])
        gradient = (share - field.share) @ second.aside(lattice) + rest
        rise = np.zeros(2) if face.untilted else np.array(lens_plane_slope(face.rotation))
        climb = rise @ (gradient + place.aside(lattice))
        x, y = face.vertex[:2] + (share - field.share) @ moved
        z = face.vertex[2] + float(rise @ share @ moved)
        return replace(face, vertex=(float(x), float(y), z), change=linear_change(gradient, climb))

    bodies = changed_faces(window.bodies, changed)
    return replace(window, bodies=bodies, placements=(*window.placements[:2], place))
