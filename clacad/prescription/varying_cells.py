"""Lenses of a sheet with a varying law: lens 2 of each cell is placed by its own δ, both are scaled by its η.

Cells stay in place, so that they tile; only vertices differ. Lens 1 stays centred: shared between both
lenses, the decentre would cause more coma. Off its vertex lens 2 refracts its light too far, by 6 mrad at a
slope of .125 and R2/p = 5. Each vertex is therefore moved until the mean exit direction of the cell's light
is that of the law (`clacad.prescription.traced_vertices`). Tilted lenses move in their own lens plane, which
is not the sheet's. Each pair thus stays confocal, and lenses 2 have different heights.

Lenses of a sheet with an η per cell: the lenses of the sheet's law, scaled in each cell.

All pairs share one separation s and are afocal at it: f1 = s/(1 − η), f2 = −η f1. With equal η along both
axes, a lens of another focal length has the same shape (conic constants included), scaled by k:

    slab, plano, thin recipe    k1 = (1 − η0)/(1 − η),  k2 = k1 η/η0           η0: of the sheet's law
    biconvex, thick             k = R/R0 of the pair that is confocal with exactly η at the common thicknesses

Biconvex cells on either side of a border share one height of its middle; lenses of different radii reach the
border at two heights. η may therefore change from cell to cell by `STEP` at most.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats, Ints, Pair2
from clacad.design.asked_cells import cell_laws
from clacad.design.sections import LATTICE, LAW
from clacad.optics.law.focusing import refract_each
from clacad.prescription.aimed_cells import MOST_TRACED, STEEPEST
from clacad.prescription.radii import NoSuchLens, biconvex_exact
from clacad.prescription.traced_vertices import CellLight, OwnLenses, moves_of
from clacad.sheet.cell_places import CellLaws, VertexChange
from clacad.sheet.vignetting import aperture_slope
from clacad.sheet.window import Face, Window

if TYPE_CHECKING:
    from clacad.design import Design


SIZES_KEY = "law.varying.table"
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
    """Focal lengths (2, n) of pairs with `etas` (n,), over those of a pair with `eta` at the same s."""
    first = (1.0 - eta) / (1.0 - etas)
    return np.stack([first, first * (etas / eta)])


def _thick(window: Window, cells: Ints, etas: Floats) -> tuple[Floats, Floats]:
    """Radii (2, n) and focal lengths (n,) of thick lenses 1, each over those of the sheet's law."""
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
            raise NoSuchLens(message, SIZES_KEY, error.hint) from error
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
                f"biconvex cells ({i}, {j}) and ({k}, {m}) with eta = {etas[worst]:g} and {there[worst]:g}:"
                " columns of lenses so unlike do not meet in their border; neighbours may differ by"
                f" {STEP:g}",
                SIZES_KEY,
                'eta that changes more slowly, or pair.form = "slab" or "plano"',
                "CL125",
            )


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
                f"lens {array + 1} of cell ({i}, {j}), eta = {etas[worst]:g}, would have the radius"
                f" {radius[worst]:.6g}, less than half the diagonal of its cell ({reach:.6g}): the surface"
                " ends inside the cell",
                SIZES_KEY,
                f"pitch < {max(window.lattice.pitch) * radius[worst] / reach:.6g}, or an eta nearer to the"
                " others",
            )


KEY = LAW.varying


def _refuse_many(n1: int, n2: int) -> None:
    """Refuse a table of more lenses than are traced."""
    if n1 * n2 > MOST_TRACED:
        raise NoSuchLens(
            f"a sheet whose law varies has a table of vertices: {n1 * n2:,} cells are more than the "
            f"{MOST_TRACED:,} that it may have",
            key=LATTICE.count,
            code="CL125",
            hint="fewer cells",
        )


def with_varying_law(window: Window, design: Design) -> Window:
    """Window of a design's central cell with lenses 2 moved so that each cell obeys its own law.

    Parameters
    ----------
    window : Window
        Uniform, for the law of the design's centre.
    design : Design

    Raises
    ------
    NoSuchLens
        There are too many cells, or a lens would be too far from the centre of its cell, which is named.
    DesignError
        The table of cells cannot be read.
    """
    laws = cell_laws(design)
    _refuse_many(*design.lattice.count)
    cells = window.lattice.cells()
    deltas = laws.deltas(window.lattice, cells)
    sizes = None if laws.ratios is None else sizes_of(window, design, laws)
    own = (None, None) if sizes is None else (sizes.focal, sizes.thin[0])
    turn = next(face.rotation for face in window.faces if face.array == 1)
    first = _by_rule(window, deltas, np.array(window.recipe["f"][0]), turn, own[0])
    window = replace(window, cell_laws=laws)
    _refuse_far(window, cells, first, sizes)
    moved = first
    if design.pair.offset != "paraxial":
        moved = first + _traced(window, deltas, first, lens_plane_slope(turn), sizes)
    _refuse_far(window, cells, moved, sizes)
    thin_turn = window.thin.rotation
    ideal = _by_rule(window, deltas, np.array(window.thin.focal_length[0]), thin_turn, own[1])
    thin = VertexChange(table=_tabled(window, cells, ideal), slope=lens_plane_slope(thin_turn))
    change = VertexChange(table=_tabled(window, cells, moved), slope=lens_plane_slope(turn))
    if sizes is None:
        return replace(_with_change(window, None, change), thin=replace(window.thin, change=thin))
    return _sized(window, cells, sizes, (change, thin))


def _sized(
    window: Window, cells: Ints, sizes: CellSizes, second: tuple[VertexChange, VertexChange]
) -> Window:
    """Window with lenses of many sizes, lens 2 moved both as built and in the thin pair."""
    built, thin = ([_tabled(window, cells, size, 1.0) for size in both] for both in (sizes.built, sizes.thin))
    pair = replace(window.thin, change_1=VertexChange(size=thin[0]), change=replace(second[1], size=thin[1]))
    made = _with_change(window, VertexChange(size=built[0]), replace(second[0], size=built[1]))
    return replace(made, thin=pair)


def lens_plane_slope(turn: Floats) -> Pair2:
    """Rise along sheet x and y of a plane normal to the lens axis; turn (3, 3), lens → sheet."""
    x, y, z = turn[:, 2].tolist()
    return -x / z + 0.0, -y / z + 0.0


def _traced(window: Window, deltas: Floats, first: Floats, climb: Pair2, sizes: CellSizes | None) -> Floats:
    """Moves of lenses 2 from `first` (n, 2), lengths, so that light obeys each cell's δ (n, 2) and η."""
    slopes = np.broadcast_to(aperture_slope(window), deltas.shape)
    light = np.column_stack([slopes, np.ones(len(slopes))])
    if sizes is None:
        asked = refract_each(window.law, deltas, light)
        return moves_of(window, CellLight(slopes, asked, first, deltas, KEY, climb))
    assert window.cell_laws is not None
    etas = window.cell_laws.ratios_of(window.lattice, window.lattice.cells())
    asked = refract_each(window.law, deltas, light, etas)
    own = OwnLenses(sizes.built, np.minimum(1.0, 1.0 / np.abs(etas[:, 0])))
    return moves_of(
        window, CellLight(slopes, asked, first, np.column_stack([deltas, etas[:, 0]]), KEY, climb, own)
    )


def _by_rule(window: Window, deltas: Floats, focal: Floats, turn: Floats, size: Floats | None) -> Floats:
    """Displacement (n, 2) of lens 2, lengths, by d = δ f1 from δ (n, 2).

    `focal` (2,) is f1 of the law, turn (3, 3) lens → sheet, `size` (n,) the ratio of each cell's f1 to the
    law's; None: 1.
    """
    law = window.law
    if size is not None:
        deltas = deltas * size[:, None]
    over = deltas - (law.delta_x, law.delta_y)
    lens = np.where(over == 0.0, 0.0, over * np.where(np.isfinite(focal), focal, 0.0))
    return np.asarray(lens @ turn[:2, :2].T)


def _tabled(window: Window, cells: Ints, each: Floats, beyond: float = 0.0) -> Floats:
    """Table (n1, n2, ...) with `each` (n, ...) at the kept cells (n, 2) and `beyond` at others."""
    table = np.full((*window.lattice.count, *each.shape[1:]), beyond)
    i, j = cells.T
    table[i + j // 2 if window.lattice.hexagonal else i, j] = each
    return table


def _with_change(window: Window, first: VertexChange | None, second: VertexChange) -> Window:
    """Window with the lenses of both arrays changed."""

    def moved(face: Face) -> Face:
        return replace(face, change=first if face.array == 0 else second) if face.array is not None else face

    return replace(
        window, bodies=tuple(replace(b, front=moved(b.front), back=moved(b.back)) for b in window.bodies)
    )


def _refuse_far(window: Window, cells: Ints, moved: Floats, sizes: CellSizes | None) -> None:
    """Refuse a lens whose cell reaches too far from its vertex for its radius, naming the worst."""
    for face in window.faces:
        if face.array != 1:
            continue
        half = window.lattice.tile().max(axis=0)
        place = np.abs(np.asarray(face.vertex[:2]) + moved) + half
        curved = np.broadcast_to(np.abs([face.surface.curvature_x, face.surface.curvature_y]), place.shape)
        if sizes is not None:
            curved = curved / sizes.built[1][:, None]
        steep = place * curved
        worst = np.unravel_index(int(np.argmax(steep)), steep.shape)
        if not steep[worst] <= STEEPEST:
            (i, j), axis = cells[worst[0]].tolist(), int(worst[1])
            own = half[axis] * curved[worst]
            over = (steep[worst] - own) / (STEEPEST - own)
            most = abs(
                float(
                    window.law_at(cells[worst[0]]).delta_y if axis else window.law_at(cells[worst[0]]).delta_x
                )
            )
            way = (
                f"|delta_{'xy'[axis]}| up to {most / over:.4g} (here {most:.4g}): planes farther off by"
                f" {over:.3g}, or a smaller sheet"
                if over > 0.0
                else "a smaller pitch, or a larger separation"
            )
            raise NoSuchLens(
                f"cell ({i}, {j}) would reach {place[worst]:.4g} from the vertex of its lens 2 in"
                f" {'xy'[axis]}, which is {steep[worst]:.3g} of the radius there; its light cannot be held"
                f" beyond {STEEPEST:g}",
                key=KEY,
                code="CL123",
                hint=way,
            )
