"""Inputs of the recipes, read once from a design; refused where a lens has no sag or ends inside its cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.design.asked_cells import cell_laws, cut_across, lattice_of
from clacad.design.faces import FaceSpec
from clacad.design.process_profiles import profile
from clacad.design.sections import LATTICE, PAIR
from clacad.optics.law import Law
from clacad.prescription.bodies import Listed, Medium, Shape, given_surface
from clacad.prescription.plates import cells_outline
from clacad.prescription.radii import LensPair, NoSuchLens, thin_focal_lengths
from clacad.sheet.cell_places import CellLaws
from clacad.sheet.lattice import Lattice
from clacad.sheet.plate import Plate
from clacad.sheet.volume_and_extent import FIELD

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.optics.material.material import Material
    from clacad.sheet.window import Face


@dataclass(frozen=True, eq=False)
class Intent:
    """Inputs of the recipes, read once from a design.

    laws : The law of each cell, of a table if there is one.
    """

    design: Design
    law: Law
    turn: Floats
    eta: Pair2
    delta: Pair2
    index: float
    material: Material | None
    lattice: Lattice
    shape: Shape
    laws: CellLaws
    given: tuple[FaceSpec, ...] = ()

    @cached_property
    def etas_along_axes(self) -> Floats | None:
        """η (m, 2) of the law and of the cells where field lenses have power of their own along both lens
        axes; None: they have one η, or cylinders that follow the law.
        """
        design, laws, (eta_x, eta_y) = self.design, self.laws, self.eta
        varying = design.law_spec.varying
        tabled = varying is not None and varying.table is not None
        if not design.pair.field_lens or not (tabled or cut_across(design)):
            return None
        etas = laws.ratios_of(self.lattice, self.lattice.cells())
        alike = bool((etas[:, 0] == etas[:, 1]).all())
        if (alike and eta_x == eta_y) or not laws.own_lenses:
            return None
        return np.concatenate([[(eta_x, eta_y)], etas])

    @cached_property
    def tilts(self) -> Floats:
        """Tilts θ (m,) of the lenses of the law and, where a table states angles, of all cells; radians."""
        if self.laws.angles is None:
            return np.array([self.law.theta])
        angles = self.laws.angles_of(self.lattice, self.lattice.cells())
        return np.append(self.law.theta, angles[..., 1])

    @property
    def steepest(self) -> float:
        """Greatest tangent of the tilt of a lens."""
        return float(np.abs(np.tan(self.tilts)).max())

    @property
    def neck(self) -> float:
        """Least thickness that joins neighbouring lenses (length): as given, else that of the process."""
        design = self.design
        if design.body.neck is not None:
            return design.body.neck
        return max(profile(design.check.process).neck / design.unit_m, min(design.lattice.pitch) / 50.0)

    def glass(self, name: str) -> Medium:
        """Material of the body with this name."""
        return Medium(self.index, name, self.material)

    def listed(self, faces: Sequence[Listed]) -> Sequence[Listed]:
        """The faces of a form in the order of the light, with given surfaces in place of derived ones."""
        if not self.given:
            return faces

        def as_given(face: Face, spec: FaceSpec) -> Face:
            plane = face.array == FIELD and face.surface.curvature_x == face.surface.curvature_y == 0.0
            if plane or face.array is None:
                return face
            return replace(face, surface=given_surface(spec, face.side))

        return [
            (as_given(face, spec), medium) for (face, medium), spec in zip(faces, self.given, strict=True)
        ]

    def offset(self, focal_length: Pair2) -> Floats:
        """(d_x, d_y) = (δ_x f1x, δ_y f1y), (2,) lengths, with f1 as built; 0 in a meridian without power."""
        return np.array([0.0 if d == 0.0 else d * f for d, f in zip(self.delta, focal_length, strict=True)])

    def built_offset(self, lenses: LensPair) -> Floats:
        """Offset (2,) of lens 2 as built, lengths: as given, else from δ."""
        given = self.design.pair.vertex
        focal = lenses.focal_length[0]
        if self.design.pair.focus is not None:  # δ is that of chief rays, independent of lens 1's focus
            from clacad.prescription.sharp_pairs import chief_focal_lengths

            focal = chief_focal_lengths(self.design, lenses.thickness, self.index, separation_of(self))
        offset = self.offset(focal) if given is None else np.array(given)
        if not np.isfinite(offset).all():
            raise NoSuchLens(
                "lens 1 has no power in a meridian with an offset delta",
                key="pair.face.0.radius",
                hint="a finite radius there, delta = 0, or pair.vertex = [d_x, d_y]",
            )
        return offset


def intent_of(design: Design) -> Intent:
    """Read the inputs of the recipes from a design."""
    pair = design.pair
    material = None
    name = pair.face[0].behind if pair.form == "plates" else pair.material
    if name is not None:
        from clacad.optics.material.catalogue import find

        material = find(name)
    index = pair.index if material is None else float(material.index(pair.wavelength))
    assert index is not None  # the design holds exactly one of index and material
    law = design.law
    return Intent(
        design,
        law,
        law.rotation,
        design.law_spec.eta,
        design.law_spec.delta,
        index,
        material,
        _lattice(design),
        Shape(_conic(design, index), pair.depth),
        cell_laws(design),
        pair.face if pair.given else (),
    )


def _conic(design: Design, index: float) -> Pair2 | None:
    """Conic constants of a biconic; default: a stigmatic axial beam (plano outside: a start value)."""
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


def untraced(intent: Intent) -> Intent:
    """Intent with paraxially placed lenses: trials of a thickness trace no light."""
    design = intent.design
    return replace(intent, design=replace(design, pair=replace(design.pair, offset="paraxial")))


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


def refuse_radius(intent: Intent) -> None:
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


def separation_of(intent: Intent) -> float:
    """Distance f1 + f2 (length) between the thin lenses equivalent to the pair."""
    pair = intent.design.pair
    if pair.form == "plates":
        from clacad.prescription.face_matrices import equivalent

        return equivalent(pair, intent.eta).separation
    if pair.separation is not None:
        return pair.separation
    thickness = pair.thicknesses
    assert thickness is not None  # the design holds exactly one of the two for a slab
    return thickness[0] / intent.index
