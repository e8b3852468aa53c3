"""Lenses of a sheet with an η per cell: the lenses of the sheet's law, scaled in each cell.

All pairs share one separation s and are afocal at it: f1 = s/(1 − η), f2 = −η f1. With equal η along both
axes, a lens of another focal length has the same shape (conic constants included), scaled by k:

    slab, plano, thin recipe    k1 = (1 − η0)/(1 − η),  k2 = k1 η/η0           η0: of the sheet's law
    biconvex, thick             k = R/R0 of the pair that is confocal with exactly η at the common thicknesses

Biconvex cells on either side of a border share one height of its middle; lenses of different radii reach the
border at two heights. η may therefore change from cell to cell by `STEP` at most.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.prescription.radii import NoSuchLens, biconvex_exact
from clacad.sheet.cell_laws import CellLaws
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.design import Design

KEY = "law.varying.table"
STEP = 0.05
"""Greatest change of η between neighbouring biconvex cells."""
ROUNDED = 1e-12
"""Rounding error of a difference of two η that is tolerated."""


@dataclass(frozen=True, slots=True, eq=False)
class CellSizes:
    """Scale factors of the lenses of cells, relative to those of the sheet's law.

    Parameters
    ----------
    built : (2, n)
        Of lens 1 and lens 2 as built.
    thin : (2, n)
        Of the equivalent thin lenses.
    focal : (n,)
        Focal length of lens 1 as built, over that of the sheet's law.
    """

    built: Floats
    thin: Floats
    focal: Floats


def sizes_of(window: Window, design: Design, laws: CellLaws) -> CellSizes:
    """Scale factors of the lenses of all kept cells of a sheet with an η per cell.

    Raises
    ------
    NoSuchLens
        A lens ends inside its cell or is too thick; biconvex neighbours differ by more than `STEP`. The
        message names the cell.
    """
    cells = window.lattice.cells()
    etas = laws.ratios_of(window.lattice, cells)[:, 0]
    thin = thin_sizes(etas, window.law.eta_x)
    if design.pair.form == "biconvex":
        _refuse_steps(window, laws, cells, etas)
    if design.pair.form == "biconvex" and design.pair.confocal == "exact":
        built, focal = _thick(window, cells, etas)
    else:
        built, focal = thin, thin[0]
    _refuse_small(window, cells, etas, built)
    return CellSizes(built, thin, focal)


def thin_sizes(etas: Floats, eta: float) -> Floats:
    """Focal lengths of lens 1 and lens 2 (2, n) of pairs with `etas` (n,),
    over those of a pair with `eta` at the same s.
    """
    first = (1.0 - eta) / (1.0 - etas)
    return np.stack([first, first * (etas / eta)])


def _thick(window: Window, cells: Ints, etas: Floats) -> tuple[Floats, Floats]:
    """Radii (2, n) of thick biconvex lenses and focal lengths (n,) of lens 1,
    each over those of the sheet's law.
    """
    recipe = window.recipe
    (base_1, _), (base_2, _) = recipe["R"]
    values, first, which = np.unique(etas, return_index=True, return_inverse=True)
    found = np.empty((3, len(values)))
    for k, eta in enumerate(values.tolist()):
        try:
            pair = biconvex_exact((eta, eta), recipe["s"], tuple(recipe["T"]), recipe["n"])
        except NoSuchLens as error:
            i, j = cells[first[k]].tolist()
            message = f"cell ({i}, {j}), eta = {eta:g}: {error.message}"
            raise NoSuchLens(message, KEY, error.hint) from error
        found[:, k] = (
            pair.radius[0][0] / base_1,
            pair.radius[1][0] / base_2,
            pair.focal_length[0][0] / recipe["f"][0][0],
        )
    return found[:2, which], found[2, which]


def _refuse_steps(window: Window, laws: CellLaws, cells: Ints, etas: Floats) -> None:
    """Refuse biconvex neighbours whose η differ by more than `STEP`, naming the worst."""
    lattice = window.lattice
    for step in lattice.steps[: len(lattice.steps) // 2]:
        beside = cells + np.array(step)
        there = np.where(lattice.contains(beside), laws.ratios_of(lattice, beside)[:, 0], etas)
        apart = np.abs(there - etas)
        worst = int(np.argmax(apart))
        if apart[worst] > STEP * (1.0 + ROUNDED) + ROUNDED:
            (i, j), (k, m) = cells[worst].tolist(), beside[worst].tolist()
            raise NoSuchLens(
                f"biconvex cells ({i}, {j}) and ({k}, {m}) with eta = {etas[worst]:g} and {there[worst]:g}: columns of lenses so "
                f"unlike do not meet in their border; neighbours may differ by {STEP:g}",
                KEY, "eta that changes more slowly, or pair.form = \"slab\" or \"plano\"", "CL125",
            )  # fmt: skip


def _refuse_small(window: Window, cells: Ints, etas: Floats, sizes: Floats) -> None:
    """Refuse a lens whose radius is below half the diagonal of its cell: its surface ends inside the cell."""
    reach = window.lattice.circumradius
    for array, size in enumerate(sizes):
        face = next(face for face in window.faces if face.array == array)
        radius = size / abs(face.surface.curvature_x)
        worst = int(np.argmin(radius))
        if radius[worst] < reach:
            i, j = cells[worst].tolist()
            raise NoSuchLens(
                f"lens {array + 1} of cell ({i}, {j}), eta = {etas[worst]:g}, would have the radius {radius[worst]:.6g}, less than "
                f"half the diagonal of its cell ({reach:.6g}): the surface ends inside the cell",
                KEY, f"pitch < {max(window.lattice.pitch) * radius[worst] / reach:.6g}, or an eta nearer to the others",
            )  # fmt: skip
