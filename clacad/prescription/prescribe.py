"""Bridge from intent to geometry: turns a design's request into radii, poses and bodies.

Only `prescribe` turns η, δ and the Euler angles into surfaces. All later code reads the `Window`.

Recipes
-------
biconvex "exact": centres s apart, both meridians afocal with exactly η (thick lenses).
biconvex "thin": the paper's R = 2(n − 1)f. slab, plano: one curved face per lens, exact for any thickness.
"best": radii scaled for the least rms law error (biconvex: the thin ones), `clacad.prescription.best_recipe`.
given: nothing is solved, the faces are those of the design, `clacad.prescription.bodies`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.design.sections import PAIR, AimedAt
from clacad.prescription.radii import NoSuchLens
from clacad.sheet.face_order import refractions

if TYPE_CHECKING:
    from collections.abc import Iterable

    from clacad.base.types import Ints
    from clacad.design import Design
    from clacad.design.sections import ThermalSpec
    from clacad.optics.material.material import Material
    from clacad.prescription.intent import Intent
    from clacad.sheet.window import Window

__all__ = ["NoSuchLens", "prescribe"]


def prescribe(design: Design) -> Window:
    """Build the sheet that realises a design: radii, thicknesses, faces and places of all lenslets,
    solved from its law.

    `clacad.trace`, `clacad.tessellate` and `clacad.solids` take the window that is returned.

    Parameters
    ----------
    design : Design

    Returns
    -------
    Window
        Lengths in the design's unit.

    Raises
    ------
    DesignError
        The pair cannot exist; the message gives the number that would make it work. A design that is merely
        unwise (for example a lens that does not cover its cell) is built and left to the checks.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> clacad.prescribe(design)
    Window('slab', slab, 3 x 3 square cells of 0.5 mm, 1 body)
    """
    from clacad.design import DesignError

    try:
        return _checked(design)
    except NoSuchLens as error:
        raise DesignError.at(design, error.key, error.message, code=error.code, hint=error.hint) from error
    except ArithmeticError as error:  # lengths too far apart in size
        message = f"the lengths of this design are too far apart in size to be computed with ({error})"
        raise DesignError.at(design, PAIR.separation, message) from error


def prescribe_all(designs: Iterable[Design]) -> list[Window]:
    """Sheets of several designs, equal ones prescribed once."""
    made: dict[str, Window] = {}
    windows = []
    for design in designs:
        if design.sha256 not in made:
            made[design.sha256] = prescribe(design)
        windows.append(made[design.sha256])
    return windows


def design_of_cell(design: Design, window: Window, cell: tuple[int, int]) -> Design:
    """Design of a uniform sheet whose cells are like one cell (i, j) of a non-uniform sheet; `window` is the
    design's. The faces of sharp pairs are given, for no uniform sheet has a common image.
    """
    from clacad.design import Design
    from clacad.design.read import read_changed
    from clacad.sheet.vignetting import aperture_slopes

    if window.uniform:
        return design
    lattice, law, pair = (dict(design.given[name]) for name in ("lattice", "law", "pair"))
    own, aimed = window.law_at(cell), design.lattice.aperture
    placed = [lattice.pop(key) for key in tuple(lattice) if key.endswith("_2")]
    sharp = design.pair.focus is not None
    varying = law.pop("varying", None) is not None
    if varying or sharp or placed:
        law |= {"eta": [own.eta_x, own.eta_y], "delta": [own.delta_x, own.delta_y]}
    if window.cell_laws is not None and window.cell_laws.angles is not None:
        law["euler"] = np.degrees([own.phi, own.theta, own.psi]).tolist()
    if isinstance(aimed, AimedAt):
        x, y, z = aimed.point
        at_x, at_y = window.centres(0, np.array(cell)).tolist()
        lattice["aperture"] = [(x - at_x) / z, (y - at_y) / z]
    elif sharp or placed or (varying and aimed == "centred"):
        # the cells of array 2 are centred for the sheet's centre
        slope = aperture_slopes(window, np.array([cell]))[0].tolist()
        moved = window.placements[1].own or window.shifts[1] != (0.0, 0.0)
        lattice["aperture"] = slope if moved else "aligned"
    if sharp:
        pair = _with_given_faces(pair, window, np.array(cell))
    elif (varying or isinstance(aimed, AimedAt)) and design.pair.offset is None and not design.pair.given:
        pair["offset"] = "traced"  # the default of lenses 2 of such a sheet
    changed = {**design.given, "lattice": lattice, "law": law, "pair": pair}
    return Design(**read_changed(changed, design.path, {}))


def _with_given_faces(pair: dict[str, Any], window: Window, cell: Ints) -> dict[str, Any]:
    """Keys of [pair] that give the faces of one cell (2,), and the place of its lens 2."""
    from clacad.prescription.bodies import given_conics

    found = {key: value for key, value in pair.items() if key not in RECIPE_KEYS}
    if window.form != "slab":
        found["thickness"] = list(window.recipe["T"])
    faces, ends = [], {}
    for _, face, _, _ in refractions(window.bodies):
        own = window.in_cell(face, cell)
        bent = (own.surface.curvature_x, own.surface.curvature_y)
        radius = ["inf" if c == 0.0 else 1.0 / c for c in bent]
        faces.append({"radius": radius, "conic": list(given_conics(own.surface)) if any(bent) else 0.0})
        if face.array in (0, 1) and any(bent):
            ends[face.array] = own.vertex + np.array([*window.centres(face.array, cell), 0.0])
    apart = (ends[1] - ends[0]) @ window.law.rotation
    return {**found, "prescription": "given", "face": faces, "vertex": apart[:2].tolist()}


RECIPE_KEYS = ("focus", "surface", "conic", "depth", "confocal", "offset")
"""Keys of [pair] that given faces exclude, or do without."""


def placed(design: Design) -> Window:
    """Window of a design with given faces, without checks and residual: a trial of a search."""
    from clacad.prescription.intent import intent_of

    return _of_form(intent_of(design))


def _of_form(intent: Intent) -> Window:
    """Window of a pair of the requested form."""
    from clacad.prescription.biconvex import biconvex
    from clacad.prescription.face_list import plates
    from clacad.prescription.plano_and_slab import plano, slab

    build = {"biconvex": biconvex, "plano": plano, "slab": slab, "plates": plates}[intent.design.pair.form]
    return _with_stated_numbers(build(intent), intent.design)


def _with_stated_numbers(window: Window, design: Design) -> Window:
    """The window with the thermal numbers that `light.thermal` states in place of the table's."""
    if not design.light.thermal:
        return window
    from clacad.optics.material.catalogue import find

    stated = {find(one.material).name: one for one in design.light.thermal}
    bodies = (replace(body, material=_stated(body.material, stated)) for body in window.bodies)
    return replace(window, bodies=tuple(bodies))


def _stated(material: Material | None, stated: dict[str, ThermalSpec]) -> Material | None:
    """The material with its stated thermal numbers; those left out are the table's."""
    from clacad.optics.material.material import D_LINE, EXPANSION, ThermalNumbers

    if material is None or material.name not in stated:
        return material
    own = stated[material.name]
    known, dn_dt, expansion = material.thermal, own.dn_dt, own.expansion
    index_by = own.source if dn_dt is not None else known.source.split(f"; {EXPANSION}")[0] or material.source
    growth_by = own.source if expansion is not None else known.source.split(EXPANSION)[-1] or material.source
    changed = ThermalNumbers(
        known.dn_dt if dn_dt is None else (dn_dt, D_LINE),
        known.expansion if expansion is None else expansion,
        f"{index_by}; {EXPANSION}{growth_by}",
    )
    return replace(material, thermal=changed)


def _checked(design: Design) -> Window:
    """Window of a design whose lenses have sag, heights and radii over their cells, with its residual."""
    from clacad.prescription.best_recipe import Residual
    from clacad.prescription.bodies import refuse_crossed
    from clacad.prescription.cell_heights import refuse_no_faces, window_range
    from clacad.prescription.face_list import as_listed
    from clacad.prescription.intent import intent_of, refuse_radius

    design = as_listed(design)
    intent = intent_of(design)
    if design.pair.form == "plates":
        pass
    elif design.pair.given:
        refuse_crossed(design.pair)
    else:
        refuse_radius(intent)
    window = _of_form(intent)
    if design.pair.given:
        refuse_no_faces(window)
    window = replace(window, z_range=window_range(window))
    return replace(window, residual=Residual(window))
