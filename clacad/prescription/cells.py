"""Lenses of a non-uniform sheet: each cell has a target, and its lens 2 is built for it.

    target of cell c    law_c, and the slope u_c of the chief ray that the cell is made for
    build of cell c     centre of cell 2: where that ray arrives (`aimed_cells`), or at the pitch of its array
                        (`sharp_pairs`), or as in every cell
                        vertex 2: the offset by law_c from lens 1, moved until the mean exit direction of the
                        light of slope u_c is that of law_c (`traced_vertices`)
                        size of both lenses: by the η of law_c

Lens 2 has one offset D_c from its place in the middle cell, relative to lens 1. Its cell has another, A C
with C the centre of cell 1. Within its cell it is therefore displaced by D_c − A C. Tilted lenses move in
their own lens plane, which is not the sheet's: the rise of a lens is that of D_c, and each pair stays
confocal. Lens 1 stays centred: shared between both lenses, the decentre would cause more coma. Off its vertex
lens 2 refracts its light too far, by 6 mrad at a slope of .125 and R2/p = 5, which is why it is moved.

Lenses of a sheet with an η per cell are those of the sheet's law, scaled in each cell. With an angle per cell
each lens, and its offset, is turned about z.

All pairs share one separation s and are afocal at it: f1 = s/(1 − η), f2 = −η f1 along each axis. A lens of
another focal length has the same shape (conic constants included), scaled by k, which is that of the axis x;
where k of the axis y differs, its curvature along y is first multiplied by k_x/k_y (`stretched`):

    slab, plano, thin recipe    k1 = (1 − η0)/(1 − η),  k2 = k1 η/η0           η0: of the sheet's law
    biconvex, thick             k = R/R0 of the pair that is confocal with exactly η at the common thicknesses
    given faces                 as lenses of their form; those of the sheet's η are as given

Biconvex cells on either side of a border share one height of its middle; lenses of different radii reach the
border at two heights. η may therefore change from cell to cell by `STEP` at most.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.types import Floats, Ints, Pair2
from clacad.base.vectors import xy
from clacad.design.asked_cells import cut_across
from clacad.design.sections import LATTICE, LAW, PAIR, AimedAt
from clacad.optics.law.focusing import ratios_of, refract_each
from clacad.optics.law.orientation import rotations
from clacad.optics.surface import Quadric
from clacad.prescription.aimed_cells import STEEPEST, AimPoint, aimed
from clacad.prescription.bodies import FieldCells, glass_of_tilts, plano_outside_axis
from clacad.prescription.field_lens import (
    FieldOfCells,
    least_gap,
    mean_focus,
    plate_of_cells,
    plates_of_cells,
    symmetric_foci,
    thin_cylinders,
    toric,
)
from clacad.prescription.intent import Intent
from clacad.prescription.radii import LensPair, NoSuchLens, biconvex_exact, thin_pair
from clacad.prescription.sharp_pairs import (
    chief_focal_lengths,
    inclined_sizes,
    placed_field,
    thick_lenses,
    with_focus,
    with_pitch_2,
)
from clacad.prescription.traced_vertices import (
    WAY_OUT,
    CellLight,
    OwnLenses,
    field_moves,
    moves_of,
    traced_moves,
)
from clacad.sheet.cell_places import CellLaws, CellPlacement, VertexChange, as_table, lens_plane_slope, tabled
from clacad.sheet.lattice import in_sector
from clacad.sheet.representative_cells import quarter_turned, turned_alike, turned_cells
from clacad.sheet.vignetting import aperture_slope, aperture_slopes
from clacad.sheet.volume_and_extent import FIELD
from clacad.sheet.window import Face, FieldLens, ThinPair, Window, changed_faces

if TYPE_CHECKING:
    from clacad.design import Design

MOST_TRACED = 1_000_000
"""Greatest number of cells for which a table of vertices is made."""

SIZES_KEY = "law.varying.table"
STEP = 0.05
"""Greatest change of η between neighbouring biconvex cells."""
ROUNDED = 1e-12
"""Rounding error of a difference of two η that is tolerated."""


@dataclass(frozen=True, slots=True, eq=False)
class CellSizes:
    """Scale factors of the lenses of cells, relative to those of the sheet's law.

    built : (2, n, 2). Of lens 1 and lens 2 as built, along the lens axes.
    thin : (2, n, 2). Of the equivalent thin lenses.
    focal : (n, 2). Displacement of lens 2 over δ, the focal length of an afocal lens 1, over the sheet's.

    field : Field lenses of the cells, with a column for the law's η before them; None without any.
    """

    built: Floats
    thin: Floats
    focal: Floats
    field: FieldOfCells | None = None


@dataclass(frozen=True, eq=False)
class Targets:
    """What each kept cell is made for.

    cells : (n, 2)
    deltas : (n, 2). δ of each law.
    slopes : (n, 2). Slopes in air of the chief rays, sheet frame.
    sizes : None: one η, and one size of lenses.
    turns : (n, 3, 3) or None. Lens → sheet of the law of each cell; None: the sheet's in all.
    frames : (n, 3, 3) or None. The same of its lenses, which planes before and behind them may bend.
    key : Key of the design that errors name.
    """

    cells: Ints
    deltas: Floats
    slopes: Floats
    sizes: CellSizes | None
    turns: Floats | None = None
    frames: Floats | None = None
    key: str = LAW.varying

    def axes(self, turn: Floats) -> Floats:
        """Axes (n or 1, 3) of the lenses; `turn` (3, 3), lens → sheet, is that of the law."""
        return turn[None, :, 2] if self.frames is None else self.frames[:, :, 2]

    @property
    def climb(self) -> Floats:
        """Rise (n, 2) of the planes of the lenses along sheet x and y; 0 where they have no own axes."""
        if self.frames is None:
            return np.zeros((len(self.cells), 2))
        return np.asarray(-self.frames[:, :2, 2] / self.frames[:, 2:, 2] + 0.0)


def with_own_cells(window: Window, intent: Intent, field: FieldCells | None = None) -> Window:
    """Return the window of an intent's middle cell with the cells and lenses 2 that each cell's target needs.

    window : Uniform, for the law of the design's centre.
    field : Cells of a field lens.
    Raises NoSuchLens: CL121, CL125: too many vertices to trace; CL122: the viewer is too near; CL123: a lens
        would be used too far from its vertex, its cell is named.
    """
    design = intent.design
    inclined = design.pair.focus is not None and window.law.theta != 0.0
    varying, offset = design.law_spec.varying is not None or inclined, design.pair.offset
    alike = cut_across(design)
    aims = isinstance(design.lattice.aperture, AimedAt)
    traced = offset == "traced" or (offset is None and (varying or aims))
    varying = varying or alike
    if varying or (traced and aims):
        _refuse_many(design.lattice.count, aims)
    if varying:
        window = replace(window, cell_laws=intent.laws)
    placed = _placed(window, intent, field)
    if field is not None:
        placed = placed_field(placed, field, window.shifts[1])
    if placed.uniform:
        return _moved_alike(window) if traced else window
    lens_turn = next(face.rotation for face in window.faces if face.array == 1)
    rises = aims and field is not None and bool(lens_turn[2, :2].any())  # lenses 2 that follow their cells
    if not (varying or traced or rises):
        return placed
    aim = AimPoint(design.lattice.aperture.point) if isinstance(design.lattice.aperture, AimedAt) else None
    targets = _targets(placed, intent, aim)
    if rises and targets.frames is None:
        targets = replace(targets, frames=np.broadcast_to(lens_turn, (len(targets.cells), 3, 3)))
    apart = placed.shifts[1] + _followed(placed.placements[1], placed, targets.cells)
    ways = None if field is None else _ways(window, targets, lens_turn, apart)
    follows = placed.placements[1].own and not aims  # lenses 2 follow their cells
    lean, ways = _leaned(window, design, targets, lens_turn), None
    if field is not None:
        apart = placed.shifts[1] + _followed(placed.placements[1], placed, targets.cells)
        ways = _ways(window, targets, lens_turn, apart)
        if lean is not None and field.drift:
            lean = lean + _drifted(window, targets, lens_turn, field.drift, ways)
    slope = (0.0, 0.0) if placed.cell_laws is None or lean is not None else lens_plane_slope(lens_turn)
    table = np.zeros(targets.slopes.shape)
    if varying:
        table = _asked(window, placed, intent, field, targets, follows)
        _refuse_far(placed, targets, table, aims, lean)
    if (
        targets.sizes is not None
        and targets.sizes.field is not None
        and field is not None
        and ways is not None
    ):
        table = table + _pulled(targets, targets.sizes.field.pull, field, lens_turn, ways)
        placed = _with_field(placed, targets, targets.sizes.field, field, lens_turn, ways)
    if traced:
        follow = _followed(placed.placements[1], placed, targets.cells)
        drift = 1.0 if not aims else 0.0 if field is None else field.drift
        first = table + drift * follow if drift and placed.placements[1].own else table
        light = _light(placed, targets, first, slope if lean is None else targets.climb, aims)
        slides = lean
        if field is not None:
            slides = field_moves(window, placed, targets.cells) + (0.0 if lean is None else lean)
        light = replace(light, slides=slides)
        table = table + _moves(window, placed, targets.cells, light)
        _refuse_far(placed, targets, table, aims, lean)
    made = _with_tables(placed, targets, table, slope, lean)
    return replace(made, thin=_thin(placed, targets, inclined, follows)) if varying else made


def _asked(
    window: Window,
    placed: Window,
    intent: Intent,
    field: FieldCells | None,
    targets: Targets,
    follows: bool,
) -> Floats:
    """Displacement (n, 2) of lenses 2 by the δ of their laws, lengths, besides that of cells that they
    follow.
    """
    ratio = None if targets.sizes is None else targets.sizes.focal
    focal = window.recipe["f"][0] if field is None or field.focal is None else field.focal
    inclined = intent.design.pair.focus is not None and window.law.theta != 0.0
    if inclined:
        focal = chief_focal_lengths(intent.design, *(window.recipe[name] for name in "Tns"))
    turn = next(face.rotation for face in window.faces if face.array == 1)
    table = _by_rule(window, targets, np.array(focal), turn, ratio)
    if follows:
        kept = 1.0 if field is None else 1.0 - field.drift
        table = table - kept * _followed(placed.placements[1], placed, targets.cells)
    return table


def _leaned(window: Window, design: Design, targets: Targets, turn: Floats) -> Floats | None:
    """Displacement (k, n, 3), lengths, of the faces of both lenses by axes of cells that lean otherwise than
    the law's; 0 of other faces, None: no cell has such axes.

    A pair turns about the middle of its lens 1 as one piece: `turn` (3, 3), lens → sheet of the law.
    """
    frames = targets.frames
    if frames is None or not (frames[:, :2, 2].any() or turn[:2, 2].any()):
        return None
    found = np.zeros((len(window.faces), len(targets.cells), 3))
    for lean, face in zip(found, window.faces, strict=True):
        if face.array in (0, 1):
            place = np.asarray(face.vertex) + [*window.shifts[face.array], 0.0]
            lean += frames @ (place @ turn) - place
    if window.form == "plano" and design.pair.curved == "outside" and not window.field_array:
        found[-1] = _leaned_behind_planes(window, targets, turn)
    return found


def _drifted(
    window: Window, targets: Targets, turn: Floats, drift: float, ways: tuple[Floats, Floats]
) -> Floats:
    """What `_leaned` lacks where lenses 2 follow their cells by `drift`: they do so along the sheet, in the
    planes of their lenses.
    """
    (start, _), (old, _) = _ways(window, targets, turn, np.array([window.shifts[1]])), ways
    found = np.zeros((len(window.faces), len(targets.cells), 3))
    for lean, face in zip(found, window.faces, strict=True):
        if face.array == 1 and targets.frames is not None:
            lean += drift * (start - targets.frames @ (start[0] @ turn))
            lean[:, 2] += drift * ((old[:, :2] * targets.climb).sum(axis=1) - start[0, 2])
    return found


def _leaned_behind_planes(window: Window, targets: Targets, turn: Floats) -> Floats:
    """As `_leaned`, (n, 3), of lenses 2 of plano pairs: planes under the whole sheet bend the axis of a cell,
    and its lens 2 has the glass that leaves it least power.
    """
    (first, second), index, separation = (window.recipe[name] for name in ("T", "n", "s"))
    gap = window.bodies[1].front.vertex[2] - window.bodies[0].back.vertex[2]
    frames, law = targets.frames, np.broadcast_to(turn, (len(targets.cells), 3, 3))
    assert frames is not None  # the caller has found that they lean
    etas = np.broadcast_to(ratios_of(window.law), (len(frames), 2))
    if window.cell_laws is not None:
        etas = window.cell_laws.ratios_of(window.lattice, targets.cells)
    more = np.subtract(*(glass_of_tilts(one, etas, index, separation, gap) for one in (frames, law)))
    start = plano_outside_axis(turn, index, (first, second), gap)
    place = np.asarray(window.bodies[1].back.vertex) + [*window.shifts[1], 0.0]
    aside = frames @ ((place - start) @ turn)
    return np.asarray(plano_outside_axis(frames, index, (first, second + more), gap) + aside - place)


def _moves(window: Window, placed: Window, cells: Ints, light: CellLight) -> Floats:
    """Moves (n, 2), lengths, of lenses 2, found once for cells that a turn about the axis makes the same."""
    copies = 1 if light.own is not None or light.slides is not None else turned_alike(placed)
    lattice = placed.lattice
    number = as_table(lattice, cells, np.arange(float(len(cells))))
    for copies in (k for k in (4, 2) if k <= copies):
        there = tabled(number, lattice, turned_cells(lattice, cells, copies), 0).astype(np.int64)
        if all(
            np.allclose(given[there, :2], quarter_turned(given[:, :2], copies), rtol=0.0, atol=TURNED)
            for given in (light.slopes, light.asked, light.first, light.variable)
        ):
            break
    else:
        return moves_of(window, light)
    first = np.flatnonzero(in_sector(lattice.centres(cells), copies))
    moves = np.zeros(light.first.shape)  # a lens on the axis is not moved
    moves[first] = moves_of(window, replace(light.of(first), copies=copies))
    for _ in range(copies - 1):
        moves[there[first]] = quarter_turned(moves[first], copies)
        first = there[first]
    return moves


TURNED = 1e-12
"""Rounding error of slopes, and of lengths in pitches of a millimetre, that a turn is taken to make."""


def _followed(place: CellPlacement, window: Window, cells: Ints) -> Floats:
    """Displacement (n, 2), lengths, of the cells of array 2 beyond that of the middle one."""
    lattice = window.lattice
    return np.asarray(place.lattice(lattice).centres(cells) - lattice.centres(cells))


def _placed(window: Window, intent: Intent, field: FieldCells | None) -> Window:
    """Window with the cells of array 2 where they belong; the offset of lens 2 from lens 1 is unchanged, or
    follows its cell where array 2 has a pitch of its own.
    """
    design, spread = intent.design, with_pitch_2 if intent.design.pair.focus is None else with_focus
    if design.pair.focus is not None or design.lattice.pitch_2 is not None or design.lattice.rotation_2:
        made = spread(window, design, None if field is None else _spread_focal(window, intent, field))
        if made.cell_laws is None or intent.laws.ratios is None:
            return made
        return replace(made, cell_laws=replace(made.cell_laws, ratios=intent.laws.ratios))
    if isinstance(design.lattice.aperture, AimedAt):
        return aimed(window, design, field)
    return window


def _spread_focal(window: Window, intent: Intent, field: FieldCells) -> Pair2 | None:
    """As `FieldCells.focal`, where the cell of lens 2 is displaced with it, and so the slope of its light."""
    focal, pull = field.focal, np.zeros(2)
    if intent.etas_along_axes is not None:
        cells, etas = window.lattice.cells()[:1], intent.etas_along_axes[[0, 0]]
        _, over, own = _with_toric(window, intent.design, cells, etas, thick_lenses(intent.design))
        pull, focal = own.pull[0], xy(over[0] * (window.recipe["f"][0] if focal is None else focal))
    return None if focal is None else xy(np.array(focal) / (1.0 - field.drift - pull))


def _refuse_many(count: tuple[int, int], aims: bool) -> None:
    """Refuse a table of more lenses than are traced."""
    if count[0] * count[1] > MOST_TRACED:
        raise NoSuchLens(
            f"a sheet {'aimed at a point' if aims else 'whose law varies'} has a table of vertices:"
            f" {count[0] * count[1]:,} cells are more than the {MOST_TRACED:,} that it may have",
            key=LATTICE.count,
            code="CL121" if aims else "CL125",
            hint='pair.offset = "paraxial", or fewer cells' if aims else "fewer cells",
        )


def _moved_alike(window: Window) -> Window:
    """Uniform window with lens 2 moved until light of the field centre leaves as the law requires."""
    move = traced_moves(window, np.array([aperture_slope(window)]))[0]

    def moved(face: Face) -> Face:
        x, y, z = face.vertex
        return replace(face, vertex=(x + float(move[0]), y + float(move[1]), z)) if face.array == 1 else face

    return replace(window, bodies=changed_faces(window.bodies, moved))


# -- targets -------------------------------------------------------------------------------------------


def _targets(placed: Window, intent: Intent, aim: AimPoint | None) -> Targets:
    """Targets of the kept cells of a window whose arrays are placed."""
    design = intent.design
    lattice, laws = placed.lattice, placed.cell_laws
    cells = lattice.cells()
    slopes = aperture_slopes(placed, cells) if aim is None else aim.slopes(lattice.centres(cells))
    deltas = (CellLaws(placed.law) if laws is None else laws).deltas(lattice, cells)
    sizes = None if laws is None or not laws.own_lenses else sizes_of(placed, intent, laws)
    turns = None if laws is None else laws.rotations_of(lattice, cells)
    frames = turns
    if laws is not None and turns is not None and design.pair.curved == "inside":
        bent = laws.angles_of(
            lattice, cells
        ).copy()  # the plane faces refract the axis, as `shallower` has it
        bent[:, 1] = np.arcsin(np.sin(bent[:, 1]) / placed.recipe["n"])
        frames = rotations(bent, laws.law.axes)
    if design.pair.focus is not None and placed.law.theta != 0.0:
        built, thin = (
            _both(np.stack([size, np.ones(len(size))])) for size in inclined_sizes(placed, design, cells)
        )
        sizes = CellSizes(built, thin, np.ones((len(cells), 2)))
        return Targets(cells, deltas, slopes, sizes, key=PAIR.focus)
    return Targets(cells, deltas, slopes, sizes, turns, frames)


def _light(window: Window, targets: Targets, first: Floats, slope: Pair2 | Floats, aims: bool) -> CellLight:
    """Light of the chief ray of each cell, its expected exit direction, and what both depend on.

    The moves are functions of slope and law. Where both are linear in the place of the cell, they are
    functions of either.
    """
    laws, light = window.cell_laws, np.column_stack([targets.slopes, np.ones(len(targets.slopes))])
    if laws is None:
        asked = window.law.refract(light)
        asked = asked / np.linalg.norm(asked, axis=-1, keepdims=True)
        return CellLight(targets.slopes, asked, first, targets.slopes)
    etas = None if laws.ratios is None else laws.ratios_of(window.lattice, targets.cells)
    asked = refract_each(window.law, targets.deltas, light, etas, targets.turns)
    oblique = aims or window.placements[1].own
    variables = [targets.slopes] if oblique else []
    placed_alone = (
        targets.sizes is not None and not laws.own_lenses
    )  # lenses and laws follow from the place alone
    if not placed_alone and (laws.smooth is None or not oblique):
        variables.append(targets.deltas)
    own = None
    if etas is not None:
        variables.append(etas if (etas[:, 0] != etas[:, 1]).any() else etas[:, :1])
    if targets.turns is not None:
        variables.append(targets.turns[:, :2, 0])
        if targets.turns[:, :2, 2].any():
            variables.append(targets.turns[:, :2, 2])
    if targets.sizes is not None:
        ratio = np.full((len(targets.cells), 2), ratios_of(window.law)) if etas is None else etas
        fill = np.minimum(1.0, 1.0 / np.abs(ratio).max(axis=1))
        own = OwnLenses(*_scales_of_all(targets.sizes), fill, targets.frames)
    return CellLight(targets.slopes, asked, first, np.column_stack(variables), targets.key, slope, own)


def _by_rule(window: Window, targets: Targets, focal: Floats, turn: Floats, size: Floats | None) -> Floats:
    """Displacement (n, 2) of lens 2, lengths, by d = δ f1 from δ (n, 2).

    `focal` (2,) is f1 of the law, turn (3, 3) lens → sheet, `size` (n, 2) the ratio of each cell's f1 to the
    law's; None: 1.
    """
    law, deltas = window.law, targets.deltas
    if size is not None:
        deltas = deltas * size
    over = deltas - (law.delta_x, law.delta_y)
    lens = np.where(over == 0.0, 0.0, over * np.where(np.isfinite(focal), focal, 0.0))
    if targets.frames is None:
        return np.asarray(lens @ turn[:2, :2].T)
    return np.asarray(np.einsum("nij,nj->ni", targets.frames[:, :2, :2], lens))  # a table's law has no offset


# -- lenses --------------------------------------------------------------------------------------------


def _with_tables(
    window: Window, targets: Targets, table: Floats, slope: Pair2, lean: Floats | None
) -> Window:
    """Window with lenses 2 displaced by `table` (n, 2), lengths, in addition, and lenses of many sizes;
    `lean` as `_leaned` has it.
    """
    sizes: list[dict[str, Any]] = [{}, {}]
    if targets.sizes is not None:
        sizes = _tables(window, targets, targets.sizes.built, targets.frames)
    leans = iter(() if lean is None else lean)

    def changed(face: Face) -> Face:
        place, own = table, next(leans, None)
        if face.array not in (0, 1):
            return face
        told = sizes[face.array]
        if own is not None:
            rise = own[:, 2] + (table * targets.climb).sum(axis=1) * face.array
            place = own[:, :2] + table * face.array
            told = told | {"lift": as_table(window.lattice, targets.cells, rise)}
        if face.array == 1:
            moved = as_table(window.lattice, targets.cells, place)
            return replace(face, change=_change(face.change, moved, slope, told))
        if own is not None:
            told = told | {"table": as_table(window.lattice, targets.cells, place)}
        return replace(face, change=VertexChange(**told)) if told else face

    return replace(window, bodies=changed_faces(window.bodies, changed))


def _ways(window: Window, targets: Targets, turn: Floats, apart: Floats) -> tuple[Floats, Floats]:
    """From the axis of lens 1 to cells 2, (n, 3) lengths, in the planes of lenses as the law leans (`turn`,
    lens → sheet) and as the cells do; `apart` (n, 2) from cell 1 to cell 2.
    """
    faces = [np.asarray(face.vertex) + [*window.shifts[1], 0.0] for face in window.faces if face.array == 1]
    length = float(np.mean(faces, axis=0) @ turn[:, 2])
    old, new = (
        _in_plane(axis, apart - length * axis[:, :2]) for axis in (turn[None, :, 2], targets.axes(turn))
    )
    return old, new


def _in_plane(axis: Floats, across: Floats) -> Floats:
    """Points (n, 3) over `across` (n, 2) in planes through the origin, normal to an axis (1 or n, 3)."""
    return np.column_stack([across, -(across * axis[:, :2]).sum(axis=1) / axis[:, 2]])


def _with_field(
    window: Window,
    targets: Targets,
    field: FieldOfCells,
    cells: FieldCells,
    turn: Floats,
    ways: tuple[Floats, Floats],
) -> Window:
    """Window with the field faces of each cell; `ways` of `_ways`, `turn` lens → sheet of the law."""
    rows, (old, new), leans = iter(range(len(field.size))), ways, bool(targets.axes(turn)[:, :2].any())
    tilt = targets.axes(turn) - turn[:, 2]

    def table(each: Floats | None, beyond: float | Floats = 0.0) -> Floats | None:
        return None if each is None else as_table(window.lattice, targets.cells, each, beyond)

    def changed(face: Face) -> Face:
        if face.array != FIELD:
            return face
        own, change = next(rows), face.change or VertexChange()
        share, height = cells.faces[own][0, 0], (np.asarray(face.vertex) + [*cells.shift, 0.0]) @ turn[:, 2]
        place = field.share[own][:, None] * new + share * (new - old) + height * tilt
        place = place + field.lift[own][:, None] * targets.axes(turn)
        aspect = None if field.aspect is None else field.aspect[own]
        return replace(
            face,
            change=replace(
                change,
                table=table(place[:, :2]),
                size=table(field.size[own], 1.0),
                lift=table(place[:, 2]),
                aspect=table(aspect, 1.0),
                rotation=None if aspect is None and not leans else table(targets.frames, 1.0),
            ),
        )

    return replace(window, bodies=changed_faces(window.bodies, changed))


def _pulled(
    targets: Targets, pull: Floats, cells: FieldCells, turn: Floats, ways: tuple[Floats, Floats]
) -> Floats:
    """Displacement (n, 2) of lenses 2 by `pull` of the `ways` of their cells, and by how these lean."""
    old, new = ways
    leaning = cells.drift * (new - old)[:, :2]
    if pull.ndim == 1:
        return np.asarray(pull[:, None] * new[:, :2] + leaning)
    axes = turn if targets.frames is None else targets.frames
    along = pull * np.einsum("...ji,...j->...i", axes[..., :2], new)
    return np.asarray(np.einsum("...ij,...j->...i", axes[..., :2, :2], along) + leaning)


def _thin_fields(window: Window, targets: Targets) -> tuple[FieldLens, ...]:
    """Ideal field lenses, at the focus of lens 1 of each cell where these differ."""
    pair = window.thin
    if targets.sizes is None or targets.sizes.field is None:
        return pair.field
    cells, apart = targets.cells, pair.shift + _followed(pair.second, window, targets.cells)
    crossed, turns = targets.sizes.field.aspect is not None, targets.turns
    axes, own = pair.rotation[None, :, 2], pair.rotation[None, :, 2] if turns is None else turns[:, :, 2]
    leans = bool(axes[:, :2].any() or own[:, :2].any())
    turned = None
    if turns is not None and (crossed or leans):
        turned = as_table(window.lattice, cells, turns, 1.0)
    old, new = (  # heights of the centres of cells 2 in the planes of lenses 2
        (pair.separation - (apart * axis[:, :2]).sum(axis=1)) / axis[:, 2] for axis in (axes, own)
    )
    made, lenses = [], pair.field
    if crossed:
        lenses = thin_cylinders(ratios_of(window.law), pair.separation)
    for axis, lens in enumerate(lenses):
        first, second = targets.sizes.thin[..., axis]
        rise = lens.depth * (first - 1.0)
        share, lift = rise / pair.separation, rise
        if leans:
            lift = share * new + lens.depth / pair.separation * (new - old)
        change = VertexChange(
            table=as_table(window.lattice, cells, share[:, None] * apart),
            size=as_table(window.lattice, cells, first * second, 1.0),
            lift=as_table(window.lattice, cells, lift),
            rotation=turned,
        )
        made.append(replace(lens, change=change))
    return tuple(made)


def _thin(window: Window, targets: Targets, inclined: bool, follows: bool) -> ThinPair:
    """Ideal pair of a window whose law varies, or with inclined planes that its pairs image."""
    pair, sizes = window.thin, targets.sizes
    ratio = None if sizes is None or inclined else sizes.thin[0]
    focal = thin_pair(ratios_of(window.law), pair.separation)[0] if inclined else pair.focal_length[0]
    ideal = _by_rule(window, replace(targets, frames=targets.turns), np.array(focal), pair.rotation, ratio)
    if follows:
        ideal = ideal - _followed(pair.second, window, targets.cells)
    size: list[dict[str, Any]] = [{}, {}]
    if sizes is not None:
        size = _tables(window, targets, sizes.thin, targets.turns)
    slope, turns = lens_plane_slope(pair.rotation), targets.turns
    if turns is not None and (turns[:, :2, 2].any() or any(slope)):
        axis = turns[:, :, 2]
        rise = -(ideal * axis[:, :2]).sum(axis=1) / axis[:, 2]
        lean = pair.separation * (axis - pair.rotation[:, 2])
        ideal, slope = ideal + lean[:, :2], (0.0, 0.0)
        size[1]["lift"] = as_table(window.lattice, targets.cells, rise + lean[:, 2])
    change = _change(pair.change, as_table(window.lattice, targets.cells, ideal), slope, size[1])
    first = VertexChange(**size[0]) if size[0] else None
    return replace(pair, change=change, change_1=first, field=_thin_fields(window, targets))


def _change(
    affine: VertexChange | None, table: Floats, slope: Pair2, size: Mapping[str, Any]
) -> VertexChange:
    """Displacements of `affine`, which keeps lens 2 in place while its cell moves, and a table (lengths)."""
    affine = affine or VertexChange()
    (xx, xy), (yx, yy) = affine.gradient
    along, across = affine.climb
    climb = along - (slope[0] * xx + slope[1] * yx), across - (slope[0] * xy + slope[1] * yy)
    return VertexChange(affine.gradient, table, slope, climb=climb, **size)


def _tables(window: Window, targets: Targets, sizes: Floats, frames: Floats | None) -> list[dict[str, Any]]:
    """Size, aspect where it differs from 1, and lens axes of both lenses as `VertexChange` has them."""
    size, aspect = _scales(sizes)
    each = {"size": size, "aspect": aspect, "rotation": frames}
    made = [
        {
            name: as_table(window.lattice, targets.cells, one if name == "rotation" else one[k], 1.0)
            for name, one in each.items()
            if one is not None
        }
        for k in (0, 1)
    ]
    return made


def _both(values: Floats) -> Floats:
    """Values (...) for both lens axes, (..., 2)."""
    return np.repeat(values[..., None], 2, axis=-1)


def _scales(sizes: Floats) -> tuple[Floats, Floats | None]:
    """Scale factors (2, n) of two lenses, and curvature along y over that of the scaled ones; None: 1."""
    x, y = np.moveaxis(sizes, -1, 0)
    return x, None if np.array_equal(x, y) else x / y


def _scales_of_all(sizes: CellSizes) -> tuple[Floats, Floats | None]:
    """As `_scales`, followed by those of the faces of the field lens."""
    size, aspect = _scales(sizes.built)
    field = sizes.field
    if field is None:
        return size, aspect
    if aspect is None and field.aspect is None:
        return np.concatenate([size, field.size]), None
    flat = [
        np.ones_like(one) if each is None else each
        for one, each in ((size, aspect), (field.size, field.aspect))
    ]
    return np.concatenate([size, field.size]), np.concatenate(flat)


def _refuse_far(
    window: Window, targets: Targets, table: Floats, aims: bool, lean: Floats | None = None
) -> None:
    """Refuse a lens whose cell reaches too far from its vertex for its radius, naming the worst."""
    if window.cell_laws is None:
        return  # the steepest cell is known without tables
    cells = targets.cells
    half = tile = window.lattice_of(1).tile().max(axis=0)
    for number, face in enumerate(window.faces):
        if face.array != 1:
            continue
        still = 0.0 if face.change is None else face.change.at(window.lattice, cells)
        at = np.asarray(face.vertex[:2]) + (still + table)
        if lean is not None:
            at = at + lean[number, :, :2]
        if targets.frames is not None:  # along the lens axes
            own = targets.frames[:, :2, :2]
            at, half = np.einsum("nij,ni->nj", own, at), np.einsum("nij,i->nj", np.abs(own), tile)
        place = np.abs(at) + half
        curved = np.broadcast_to(np.abs([face.surface.curvature_x, face.surface.curvature_y]), place.shape)
        if targets.sizes is not None:
            curved = curved / targets.sizes.built[1]
        steep = place * curved
        worst = np.unravel_index(int(np.argmax(steep)), steep.shape)
        if not steep[worst] <= STEEPEST:
            (i, j), axis = cells[worst[0]].tolist(), int(worst[1])
            own_steep = np.broadcast_to(half, place.shape)[worst] * curved[worst]
            over = (steep[worst] - own_steep) / (STEEPEST - own_steep)
            most = abs(float(targets.deltas[worst[0], axis]))
            way = (
                WAY_OUT
                if aims
                else f"|delta_{'xy'[axis]}| up to {most / over:.4g} (here {most:.4g}): planes farther off by"
                f" {over:.3g}, or a smaller sheet"
                if over > 0.0
                else "a smaller pitch, or a larger separation"
            )
            raise NoSuchLens(
                f"cell ({i}, {j}) would reach {place[worst]:.4g} from the vertex of its lens 2 in"
                f" {'xy'[axis]}, which is {steep[worst]:.3g} of the radius there; its light cannot be held"
                f" beyond {STEEPEST:g}",
                key=targets.key,
                code="CL123",
                hint=way,
            )


# -- sizes ---------------------------------------------------------------------------------------------
def sizes_of(window: Window, intent: Intent, laws: CellLaws) -> CellSizes:
    """Scale factors of the lenses of all kept cells of a sheet with an η per cell.

    Raises NoSuchLens: A lens ends inside its cell or is too thick; biconvex neighbours differ by more than
        `STEP`. The message names the cell.
    """
    cells, design = window.lattice.cells(), intent.design
    etas = laws.ratios_of(window.lattice, cells)
    thin, thick = thin_sizes(etas, np.array(ratios_of(window.law))), thick_lenses(design)
    if design.pair.form == "biconvex":
        _refuse_steps(window, cells, _along_sheet(etas, laws.rotations_of(window.lattice, cells)))
    if window.field_array:
        if (own := intent.etas_along_axes) is not None:
            built, focal, field = _with_toric(window, design, cells, own, thick)
        else:
            one, over, field = _with_plates(window, cells, etas[:, 0], thick)
            built, focal = _both(one), _both(over)
    elif thick:
        along = [_thick(window, cells, own, axis) for axis, own in enumerate(etas.T)]
        found, field = np.stack(along, axis=-1), None
        built, focal = found[:2], found[2]
    else:
        built, focal, field = thin, thin[0], None
    if not design.pair.given:  # given faces may reach farther: `cell_heights.refuse_no_faces`
        _refuse_small(window, cells, etas, built)
    return CellSizes(built, thin, focal, field)


def _with_plates(
    window: Window, cells: Ints, etas: Floats, thick: bool
) -> tuple[Floats, Floats, FieldOfCells]:
    """As `CellSizes` of cells with field lenses: scale factors of lenses, of δ, and the field lenses.

    Raises NoSuchLens: The plates of two neighbours would touch; a field lens ends inside its cell, or its
        plate has no thickness.
    """
    recipe, told, every = window.recipe, window.recipe["field"], np.concatenate([[window.law.eta_x], etas])
    index, separation = recipe["n"], recipe["s"]
    if "gap" in told:
        focal, field = plates_of_cells(every, separation, told["gap"], index)
        over = focal[1] / every
        _refuse_touching(window, cells, etas, field.lift[0, 1:], told["gap"])
    elif thick:
        found = _thick(window, np.concatenate([cells[:1], cells]), every, plated=True)
        focal, over = found[:2], found[2]
        field = plate_of_cells(np.stack([found[2], -every * found[2]]), found[3])
    else:  # the plate is thinner where its front rises, and lens 2 keeps its place
        first = separation / (1.0 - window.law.eta_x)
        over = (separation - (1.0 - 1.0 / index) * first) / (1.0 / index - every)
        focal = np.stack([over, -every * over])
        field = plate_of_cells(focal, over)
    _refuse_field(window, cells, etas, field)
    return focal[:, 1:] / focal[:, :1], over[1:] / over[0], field.of(slice(1, None))


def _with_toric(
    window: Window, design: Design, cells: Ints, every: Floats, thick: bool
) -> tuple[Floats, Floats, FieldOfCells]:
    """As `_with_plates`, with power of their own along both lens axes; `every` (1 + n, 2): of law, cells.

    Thick lenses lie at their principal planes, which follow from their radii and these from the planes.
    """
    recipe, told, index = window.recipe, window.recipe["field"], window.recipe["n"]
    if design.pair.given:
        raise NoSuchLens(
            "eta_x and eta_y of each cell with a field lens: both its faces have power along both axes, which"
            " pair.face of one eta does not state",
            SIZES_KEY,
            'one column eta, or prescription = "derived"',
            "CL127",
        )
    separation, reach, plates = recipe["s"], np.array(told["reach"]), "gap" in told
    gap = told["gap"] if plates else told["thickness"] / index
    rise = (mean := mean_focus(every, separation)) - mean[0]
    ends = np.stack([reach[0] + rise, reach[1] - rise])[..., None] + np.zeros((1, 1, 2))
    if plates:
        _refuse_hollow(window, cells, every, gap)
    lift = np.stack([rise * (index if plates else 1.0)] * 2)
    _refuse_touching(window, cells, every[1:], lift[0, 1:], gap if plates else told["thickness"], plates)
    last, still, shift = -reach[1] / reach[0], 1.0, np.array(recipe["f"][0])
    if thick:
        ends, focal, power, sizes = _thick_toric(recipe, every, ends, gap)
        base = np.array(recipe["R"])
    else:
        focal, power = toric(every, ends[0], gap, ends[1])
        base, sizes = np.array(thin_pair(ratios_of(window.law), separation)), focal
    if plates:
        base = _both(reach / (1.0 - 0.5 * gap / reach))
        still, shift = base[1, 0] * (1.0 - 1.0 / last) / (reach.sum() + gap), -base[1, 0] / last
    length = ends.sum(axis=0) + gap
    pull = still - focal[1] * (1.0 - 1.0 / every) / length
    size = (index - 1.0) / np.array(told["R"])[:, None, None] / power
    near = (ends[0] / length).mean(axis=1)
    share = np.stack([near, near + gap / length.mean(axis=1)])
    field = FieldOfCells(size[..., 0], lift, share - share[:, :1], pull, power[..., 1] / power[..., 0])
    _refuse_field(window, cells, every[1:], field)
    return (sizes / base[:, None])[:, 1:], (-focal[1] / every / shift)[1:], field.of(slice(1, None))


def _thick_toric(
    recipe: Mapping[str, Any], etas: Floats, ends: Floats, gap: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Air from the principal planes to the field plate, focal lengths, powers of the field faces, and radii
    of thick lenses, (2, n, 2) each.

    ends : (2, n, 2) lengths. Air from the centre of either lens to the field plate.
    """
    index, thick = recipe["n"], np.array(recipe["T"])[:, None, None]
    between, part = ends, (index - 1.0) * thick / index
    for _ in range(SETTLING):
        focal, power = toric(etas, between[0], gap, between[1])
        bent = 1.0 / ((index - 1.0) * focal)
        bent = bent / (1.0 + np.sqrt(1.0 - part * bent))
        back = 0.5 * thick + (1.0 - part * bent) * focal
        between = ends - (back - focal)
    return between, focal, power, 1.0 / bent


def _refuse_hollow(window: Window, cells: Ints, every: Floats, gap: float) -> None:
    """Refuse a gap of two plates at which a field face would be hollow; one plate is made thick enough."""
    least = least_gap(every, window.recipe["s"], True)
    if (most := float(least.max())) >= gap:
        k = int(np.argmax(least))
        where = f"cell {tuple(cells[k - 1].tolist())}" if k else LAW.eta
        raise NoSuchLens(
            f"{where}, eta_x and eta_y = {_said(every[k])}: foci so far apart need two field faces more than"
            f" {most:.4g} apart, not {gap:.4g}",
            PAIR.field,
            f"pair.field.gap > {most:.4g}, or an eta_x nearer to eta_y",
            "CL129",
        )


def thin_sizes(etas: Floats, eta: Floats) -> Floats:
    """Focal lengths (2, n, 2) of pairs with `etas` (n, 2), over those of a pair with `eta` (2,) at the same
    s.
    """
    first = (1.0 - eta) / (1.0 - etas)
    return np.stack([first, first * (etas / eta)])


def _along_sheet(etas: Floats, turns: Floats | None) -> Floats:
    """η (n, 2) along the lens axes as the entries xx, yy and xy (n, 3) of its matrix along the sheet's."""
    if turns is None:
        return etas
    (xx, xy), (_, yy) = np.moveaxis(
        (turns[:, :2, :2] * etas[:, None]) @ turns[:, :2, :2].swapaxes(1, 2), 0, 2
    )
    return np.stack([xx, yy, xy], axis=1)


def _thick(window: Window, cells: Ints, etas: Floats, axis: int = 0, plated: bool = False) -> Floats:
    """Radii of thick lenses 1 and 2, and focal length and focus of lens 1, of n cells, (4, n), in a meridian.

    All but the focus (height over the centre of lens 1, length) are over those for the sheet's law. Behind a
    field plate (`plated`), which is thinner where its front rises, they are lengths.
    """
    recipe = window.recipe
    base = _thick_pair(recipe, ratios_of(window.law)[axis])
    focus = symmetric_foci(base.radius[0], recipe["T"][0], recipe["n"])[0]
    values, first, which = np.unique(etas, return_index=True, return_inverse=True)
    found = np.empty((4, len(values)))
    for k, eta in enumerate(values.tolist()):
        try:
            pair = _thick_pair(recipe, eta, focus if plated else None)
        except NoSuchLens as error:
            i, j = cells[first[k]].tolist()
            message = f"cell ({i}, {j}), eta = {eta:g} along {'xy'[axis]}: {error.message}"
            raise NoSuchLens(message, SIZES_KEY, error.hint) from error
        numbers = pair.radius[0][0], pair.radius[1][0], pair.focal_length[0][0]
        bases = base.radius[0][0], base.radius[1][0], base.focal_length[0][0]
        found[:3, k] = numbers if plated else np.divide(numbers, bases)
        found[3, k] = symmetric_foci(pair.radius[0], recipe["T"][0], recipe["n"])[0]
    return found[:, which]


def _thick_pair(recipe: Mapping[str, Any], eta: float, focus: float | None = None) -> LensPair:
    """Thick lenses with an η; behind a plate with its front at the focus, which lies at `focus` (length) for
    the sheet's law.
    """
    (t1, t2), index, separation = recipe["T"], recipe["n"], recipe["s"]
    pair = biconvex_exact((eta, eta), separation, (t1, t2), index)
    if focus is None:
        return pair
    for _ in range(SETTLING):
        rise = symmetric_foci(pair.radius[0], t1, index)[0] - focus
        pair = biconvex_exact((eta, eta), separation + (1.0 - 1.0 / index) * rise, (t1, t2), index)
    return pair


SETTLING = 24
"""Number of iterations of a focus and of the thickness of its plate: each gains most of a digit."""


def _worst_step(window: Window, cells: Ints, each: Floats) -> tuple[float, Ints]:
    """Greatest difference of numbers `each` (n,) between neighbouring cells (n, 2), and the two, (2, 2)."""
    lattice = window.lattice
    table, worst, pair = as_table(lattice, cells, each), -1.0, cells[[0, 0]]
    for step in lattice.steps[: len(lattice.steps) // 2]:
        beside = cells + np.array(step)
        apart = np.where(lattice.contains(beside), np.abs(tabled(table, lattice, beside, 0.0) - each), -1.0)
        if apart.max() > worst:
            k = int(np.argmax(apart))
            worst, pair = float(apart[k]), np.stack([cells[k], beside[k]])
    return worst, pair


def _refuse_steps(window: Window, cells: Ints, each: Floats) -> None:
    """Refuse biconvex neighbours whose η (n, 2), or its matrix (n, 3), differ by more than `STEP`."""
    found = [_worst_step(window, cells, etas) for etas in each.T]
    axis = int(np.argmax([one[0] for one in found]))
    (apart, pair), etas = found[axis], each[:, axis]
    if apart > STEP * (1.0 + ROUNDED) + ROUNDED:
        (i, j), (k, m) = pair.tolist()
        here, there = (etas[np.all(cells == one, axis=1)][0] for one in pair)
        raise NoSuchLens(
            f"biconvex cells ({i}, {j}) and ({k}, {m}) with eta = {here:g} and {there:g}:"
            " columns of lenses so unlike do not meet in their border; neighbours may differ by"
            f" {STEP:g}",
            SIZES_KEY,
            'eta that changes more slowly, or pair.form = "slab" or "plano"',
            "CL125",
        )


def _said(eta: Floats) -> str:
    return " and ".join(f"{one:g}" for one in np.atleast_1d(eta))


def _refuse_touching(
    window: Window, cells: Ints, etas: Floats, lift: Floats, room: float, plates: bool = True
) -> None:
    """Refuse neighbours whose steps leave the gap of two plates, or the one plate, no `room`, naming both."""
    apart, pair = _worst_step(window, cells, lift)
    if apart > room:
        (i, j), (k, m) = pair.tolist()
        here, there = (_said(etas[np.all(cells == one, axis=1)][0]) for one in pair)
        touch = "the plates would touch across their gap" if plates else "they would not meet in their plate"
        raise NoSuchLens(
            f"cells ({i}, {j}) and ({k}, {m}) with eta = {here} and {there}: their foci lie {apart:.4g} apart"
            f" in height, so that {touch} of {room:.4g}",
            SIZES_KEY,
            f"pair.field.gap > {apart:.4g}, eta that changes more slowly, or one plate (plano, biconvex)"
            if plates
            else "eta that changes more slowly",
            "CL129",
        )


def _refuse_field(window: Window, cells: Ints, etas: Floats, field: FieldOfCells) -> None:
    """Refuse a field lens that ends inside its cell, or leaves its plate no thickness there."""
    faces, reach = [face for face in window.faces if face.array == FIELD], window.lattice.circumradius
    plate = 0.0 if len(faces) > 1 else float(window.recipe["field"]["thickness"])
    for face, size, lift in zip(faces, field.size / field.sharper, field.lift):
        shape = face.surface
        bend = shape.kappa if isinstance(shape, Quadric) else (1.0 + shape.conic_x) * shape.curvature_x
        curvature, kappa = shape.curvature_x / size[1:], max(bend, 0.0) / size[1:]
        thin = plate > 0.0 and plate - lift[1:] <= 0.5 * curvature * reach**2
        bad = np.flatnonzero((curvature * kappa * reach**2 > 1.0) | thin)
        if len(bad):
            i, j = cells[bad[0]].tolist()
            raise NoSuchLens(
                f"the field lens of cell ({i}, {j}), eta = {_said(etas[bad[0]])}, would end inside its cell"
                " or reach through its plate",
                SIZES_KEY,
                "an eta nearer to the others, a smaller pitch, or a larger separation",
                "CL128",
            )


def _refuse_small(window: Window, cells: Ints, etas: Floats, sizes: Floats) -> None:
    """Refuse a lens whose radius is below half the diagonal of its cell: its surface ends inside the cell."""
    reach = window.lattice.circumradius
    for array, size in enumerate(sizes):
        face = next(face for face in window.faces if face.array == array)
        radius = size / np.abs([face.surface.curvature_x, face.surface.curvature_y])
        worst = np.unravel_index(int(np.argmin(radius)), radius.shape)
        if radius[worst] < reach:
            i, j = cells[worst[0]].tolist()
            raise NoSuchLens(
                f"lens {array + 1} of cell ({i}, {j}), eta = {etas[worst]:g}, would have the radius"
                f" {radius[worst]:.6g}, less than half the diagonal of its cell ({reach:.6g}): the surface"
                " ends inside the cell",
                SIZES_KEY,
                f"pitch < {max(window.lattice.pitch) * radius[worst] / reach:.6g}, or an eta nearer to the"
                " others",
            )
