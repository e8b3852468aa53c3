"""Lenses of a sheet whose law varies: lens 2 of each cell stands where its own δ has it.

Cells stay where they are, so that they tile; only vertices differ. Lens 1 stays centred: shared between both lenses the
decentre would cost more coma. Off its vertex lens 2 turns its light too far, by 6 mrad at a slope of .125 and R2/p = 5, so
each vertex is moved until the mean of the cell's light leaves as asked (`clacad.prescription.varying_vertices`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.design.asked_cells import cell_laws
from clacad.prescription.cell_heights import face_range, window_range
from clacad.prescription.radii import NoSuchLens
from clacad.prescription.varying_vertices import traced_offsets
from clacad.sheet.cell_places import VertexChange, extreme_cells
from clacad.sheet.one_cell import sheet_like
from clacad.sheet.window import Body, Face, Window

if TYPE_CHECKING:
    from clacad.design import Design

STEEPEST = 0.65
"""Farthest point of a cell from its lens's vertex over the radius there: at .69 light was found 55 mrad off, and no vertex cures it."""


def with_varying_law(window: Window, design: Design) -> Window:
    """The window of a design's middle cell, its lenses 2 moved so that each cell obeys its own law.

    Parameters
    ----------
    window : Window
        All cells alike, for the law of the design's middle.
    design : Design

    Raises
    ------
    NoSuchLens
        A lens would stand too far off its cell; the message names the cell.
    DesignError
        The table of cells cannot be read.
    """
    laws = cell_laws(design)
    window = replace(window, cell_laws=laws)
    cells = window.lattice.cells()
    deltas = laws.deltas(window.lattice, cells)
    _refuse_far(window, cells, _by_rule(window, deltas, np.array(window.recipe["f"][0])))
    focal = np.array(window.thin.focal_length[0])
    moved = traced_offsets(window, laws.law, deltas)
    window = replace(
        _with_change(window, _tabled(window, cells, moved)),
        thin=replace(window.thin, change=_tabled(window, cells, _by_rule(window, deltas, focal))),
    )
    _refuse_far(window, cells, moved)
    window = _with_land_below(window)
    return replace(window, z_range=_range(window))


def _by_rule(window: Window, deltas: Floats, focal: Floats) -> Floats:
    """Change of lens 2's place (n, 2), lengths, with δ (n, 2) by d = δ f1; `focal` (2,) is f1."""
    law = window.law
    over = deltas - (law.delta_x, law.delta_y)
    lens = np.where(over == 0.0, 0.0, over * np.where(np.isfinite(focal), focal, 0.0))
    return np.asarray(lens @ law.rotation[:2, :2].T)


def _tabled(window: Window, cells: Ints, moved: Floats) -> VertexChange:
    """Change of vertices by a table that has `moved` (n, 2), lengths, at the kept cells (n, 2)."""
    table = np.zeros((*window.lattice.count, 2))
    i, j = cells.T
    table[i + j // 2 if window.lattice.hexagonal else i, j] = moved
    return VertexChange(table=table)


def _with_change(window: Window, change: VertexChange) -> Window:
    """The window with array 2's lenses changed."""

    def moved(face: Face) -> Face:
        return replace(face, change=change) if face.array == 1 else face

    return replace(
        window, bodies=tuple(replace(b, front=moved(b.front), back=moved(b.back)) for b in window.bodies)
    )


def _refuse_far(window: Window, cells: Ints, moved: Floats) -> None:
    """Refuse a lens whose cell reaches too far from its vertex for its radius, naming the worst."""
    for face in window.faces:
        if face.array != 1:
            continue
        half = window.lattice.tile().max(axis=0)
        place = np.abs(np.asarray(face.vertex[:2]) + moved) + half
        curved = np.abs([face.surface.curvature_x, face.surface.curvature_y])
        steep = place * curved
        worst = np.unravel_index(int(np.argmax(steep)), steep.shape)
        if not steep[worst] <= STEEPEST:
            (i, j), axis = cells[worst[0]].tolist(), int(worst[1])
            over = (steep[worst] - half[axis] * curved[axis]) / (STEEPEST - half[axis] * curved[axis])
            most = abs(float(window.law_at(cells[worst[0]]).delta_y if axis else window.law_at(cells[worst[0]]).delta_x))
            way = (
                f"|delta_{'xy'[axis]}| up to {most / over:.4g} (here {most:.4g}): planes farther off by {over:.3g}, or a smaller sheet"
                if over > 0.0
                else "a smaller pitch, or a larger separation"
            )
            raise NoSuchLens(
                f"cell ({i}, {j}) would reach {place[worst]:.4g} from the vertex of its lens 2 in {'xy'[axis]}, which is "
                f"{steep[worst]:.3g} of the radius there; its light cannot be held beyond {STEEPEST:g}",
                key="law.varying",
                hint=way,
            )


def _extremes(window: Window) -> list[Window]:
    """Sheets like the cells whose lenses 2 stand farthest out."""
    change = next(face.change for face in window.faces if face.change is not None)
    return [sheet_like(window, cell) for cell in extreme_cells(change, window.lattice)]


def _with_land_below(window: Window) -> Window:
    """Lower the land of array 2 until no lens of any cell reaches it."""
    if all(face.land is None for face in window.faces):
        return window
    sheets = _extremes(window)

    def lowered(body: Body) -> Body:
        if window.form == "biconvex":  # its land is the plate between the lenses, and lenses end where they meet it
            return body
        faces = []
        for name in ("front", "back"):
            face = getattr(body, name)
            if face.array == 1 and face.land is not None:
                # what the middle cell has between its deepest point and the land, every cell keeps
                own = face_range(window, replace(face, change=None))
                alike = [face_range(s, f) for s in sheets for f in s.faces if f.array == 1]
                drop = max(0.0, own[0] - min(r[0] for r in alike)) if face.side < 0 else max(0.0, max(r[1] for r in alike) - own[1])
                face = replace(face, land=face.land + face.side * drop)
            faces.append(face)
        return replace(body, front=faces[0], back=faces[1])

    return replace(window, bodies=tuple(lowered(body) for body in window.bodies))


def _range(window: Window) -> tuple[float, float]:
    """Lowest and highest point of any body (lengths)."""
    ranges = [window_range(sheet) for sheet in _extremes(window)]
    return min(r[0] for r in ranges), max(r[1] for r in ranges)
