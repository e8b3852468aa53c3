"""Window of placed bodies, common to all forms: thin pair, cells, outline, land and record of the recipe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.config.mistakes import DesignError, Mistake
from clacad.design.asked_cells import cut_across
from clacad.design.faces import faces_digest
from clacad.design.sections import LATTICE, AimedAt
from clacad.prescription.bodies import FieldCells, displacement
from clacad.prescription.field_lens import thin_field
from clacad.prescription.intent import Intent, separation_of
from clacad.prescription.plates import inside_both, with_land, with_plate
from clacad.prescription.radii import LensPair, thin_pair
from clacad.sheet.cell_places import CellPlacement
from clacad.sheet.face_order import refractions
from clacad.sheet.window import Baffle, Body, Land, ThinPair, Window, side_outline

if TYPE_CHECKING:
    from clacad.design import Design


def assemble_window(
    intent: Intent,
    bodies: tuple[Body, ...],
    moved: Pair2,
    lenses: LensPair,
    offset: Floats,
    field: FieldCells | None = None,
    told: Mapping[str, Any] | None = None,
) -> Window:
    """Window of placed bodies: thin pair, land, outline; lengths in design units.

    moved : displacement of array 2's cells; offset : (2,) of lens 2 off lens 1's axis; field : cells of
    the field lens; `told` : the recipe's entries for the field lens.
    """
    design = intent.design
    shifts = (0.0, 0.0), moved, *(() if field is None else (field.shift,))
    window = Window(
        # the form as built
        form="plano" if design.pair.form == "slab" and len(bodies) == 3 else design.pair.form,
        bodies=bodies,
        lattice=intent.lattice,
        placements=tuple(map(CellPlacement, shifts)),
        unit=design.unit_m,
        z_range=(0.0, 0.0),
        law=intent.law,
        thin=_thin_pair(intent, field is not None),
        land=Land(design.lattice.seam, design.lattice.land == "opaque", design.body.border),
        baffle=Baffle(design.body.baffle_wall or 0.0) if design.body.baffle else None,
        wavelength=design.pair.wavelength,
        recipe={**_recipe(intent, lenses, offset), **({} if told is None else {"field": told})},
        name=design.name,
    )
    if _non_uniform(design) or design.pair.offset == "traced":
        from clacad.prescription.cells import with_own_cells

        window = with_own_cells(window, intent, field)
    window = inside_both(replace(window, outline=side_outline(window)))
    return with_line(with_land(with_plate(window, design.body), design.lattice.seam_depth), design)


def with_line(window: Window, design: Design) -> Window:
    """The window with the opaque line of its design, if it has one.

    Raises DesignError: The sheet has no face of that number.
    """
    line = design.lattice.line
    if line is None:
        return window
    printable = {
        number: 2 * window.bodies.index(body) + (face is body.back)
        for number, (body, face, _, _) in enumerate(refractions(window.bodies), start=1)
    }
    if line.face not in printable:
        raise DesignError(
            [
                Mistake(
                    "CL114",
                    f"no line can be printed on face {line.face} of this sheet",
                    LATTICE.line,
                    found=str(line.face),
                    allowed="a face of the sheet, in the order of the light: "
                    + ", ".join(map(str, printable)),
                )
            ]
        )
    return replace(window, land=replace(window.land, line=line.width, lined=printable[line.face]))


def _thin_pair(intent: Intent, with_field: bool) -> ThinPair:
    """Ideal pair; it shares a focal plane exactly, independent of what thick lenses need for that."""
    separation = separation_of(intent)
    focal = thin_pair(intent.eta, separation)
    offset = intent.turn @ np.array([*intent.offset(focal[0]), separation])
    x, y, z = map(float, offset)
    shift = displacement(intent.design.lattice.aperture, offset[:2], z)
    field = thin_field(intent.eta, separation) if with_field else ()
    return ThinPair(focal, (x, y, z), intent.turn, shift, field=field)


def _non_uniform(design: Design) -> bool:
    """Whether a design requests a non-uniform sheet."""
    lattice = design.lattice
    return (
        isinstance(lattice.aperture, AimedAt)
        or (design.law_spec.varying, design.pair.focus, lattice.pitch_2) != (None, None, None)
        or bool(lattice.rotation_2)
        or cut_across(design)
    )


def _recipe(intent: Intent, lenses: LensPair, offset: Floats) -> Mapping[str, Any]:
    """Record of radii and poses, for reports and the manifest; of given faces found by a search also that
    search, and whether they are unchanged.
    """
    pair = intent.design.pair
    given, search = pair.given, {}
    if pair.search is not None:
        unchanged = pair.search.faces_sha256 == faces_digest(pair.face)
        search = {"search": pair.search.to_dict() | {"unchanged": unchanged}}
    return {
        "confocal": None if given else pair.confocal if pair.form == "biconvex" else "exact",
        "R": [list(face.radius) for face in pair.face] if given else [list(r) for r in lenses.radius],
        "f": [list(f) for f in lenses.focal_length],
        "d": [float(d) for d in offset],
        "T": list(lenses.thickness),
        "n": intent.index,
        "s": separation_of(intent),
        "surface": "given" if given else pair.surface,
        "wavelength_nm": pair.wavelength * 1e9,
        "material": pair.material,
        "curved": pair.curved if pair.form == "plano" else None,
    } | search
