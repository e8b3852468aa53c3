"""Cells of array 2 aimed at a viewer: placed where the viewer's light arrives.

Light of a viewer at P = (x_P, y_P, z_P) crosses the centre C of cell 1 with slope a(C) = (C − P_xy)/(−z_P).
Through lens 1's vertex it reaches array 2 at C + L(a), which becomes the centre of cell 2. L is linear in
air, and linear to third order in glass: L(a) = L(0) + k a, with k from the outermost cell. Then

    C2 = g C + k P_xy/z_P + L(0)      g = 1 − k/z_P      the lattice scaled and shifted: without gaps
    vertex 2 in its own cell = (1 − g) C + d − shift (+ the move of `traced_vertices`)

with d the offset of lens 2 from lens 1 as in every sheet: borders move, vertices do not. All cells obey one
law.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats, Ints, Pair2
from clacad.design.sections import LATTICE
from clacad.prescription.bodies import displacement
from clacad.prescription.radii import NoSuchLens
from clacad.prescription.traced_vertices import traced_moves
from clacad.sheet.cell_places import CellPlacement, VertexChange, row_ends
from clacad.sheet.vignetting import aperture_slope
from clacad.sheet.window import Body, Face, Window

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.lattice import Lattice

Landing = Callable[[Pair2], Pair2]
"""Slope in air → point where the light reaches array 2, relative to the centre of cell 1, lengths."""

NEAREST = 10.0
"""Least distance of a viewer in separations: for a nearer one,
light of one cell spreads beyond its partner.
"""

OFF = 0.01
"""Part of the pitch by which the centre of a cell may miss its light."""

STEEPEST = 0.65
"""Largest ratio of the distance from vertex to cell border of lens 2 to its radius;
beyond, no vertex gives the law.
"""

TRIED = 200
"""Number of cells whose light is traced to check where it arrives."""

MOST_TRACED = 1_000_000
"""Greatest number of cells for which a table of vertices is made."""


@dataclass(frozen=True)
class AimPoint:
    """The point that a sheet is aimed at, sheet frame, lengths."""

    point: tuple[float, float, float]

    def slopes(self, centres: Floats) -> Floats:
        """Slopes (..., 2) in air of the point's light through the centres (..., 2) of cells."""
        x, y, z = self.point
        return np.asarray((centres - (x, y)) / -z)


def aimed(window: Window, design: Design) -> Window:
    """Return the window with its array 2 aimed.

    Parameters
    ----------
    window : Window
        Uniform, with partners aligned (aperture "aligned").
    design : Design

    Raises
    ------
    NoSuchLens
        CL121: too many vertices to trace; CL122: the viewer is too near; CL123: lens 2 would be too steep.
    """
    aim, built = refuse_aim(window, design)
    thin = _placed(aim, window.lattice, row_ends(window.lattice), _straight(window.thin.offset[2]))
    table = _table(aim, window) if design.pair.offset != "paraxial" else None
    change = _vertex_change(built, window.lattice, table)
    return replace(
        window,
        placements=(CellPlacement(), built),
        bodies=tuple(_moved(body, built.shift, change) for body in window.bodies),
        thin=replace(
            window.thin, shift=thin.shift, pitch=thin.pitch, change=_vertex_change(thin, window.lattice, None)
        ),
    )


def traced(window: Window) -> Window:
    """Return the uniform window with lens 2 moved until light of the field centre leaves as the law requires.

    Raises
    ------
    NoSuchLens
        CL123: no position does it.
    """
    move = traced_moves(window, np.array([aperture_slope(window)]))[0]

    def moved(face: Face) -> Face:
        x, y, z = face.vertex
        return replace(face, vertex=(x + float(move[0]), y + float(move[1]), z)) if face.array == 1 else face

    bodies = tuple(replace(body, front=moved(body.front), back=moved(body.back)) for body in window.bodies)
    return replace(window, bodies=bodies)


def _landing(window: Window) -> Landing:
    """Landing function of a pair as built: straight if biconvex, else refracted at lens 1's vertex."""
    faces = [face for face in window.faces if face.array == 1]
    if window.form == "biconvex":
        return _straight(0.5 * (faces[0].vertex[2] + faces[1].vertex[2]))
    height = faces[-1].vertex[2]
    return lambda slope: displacement(slope, np.zeros(2), height, window.bodies)


def _straight(height: float) -> Landing:
    return lambda slope: (height * slope[0], height * slope[1])


def _placed(aim: AimPoint, lattice: Lattice, cells: Ints, landing: Landing) -> CellPlacement:
    """Positions of array 2's cells: L(a) = L(0) + k a with k of the cell with the steepest light."""
    slopes = aim.slopes(lattice.centres(cells))
    a = slopes[int(np.argmax((slopes**2).sum(axis=1)))]
    still = np.array(landing((0.0, 0.0)))
    if not a.any():  # one cell, on axis
        k = 0.0
    else:
        k = float((np.array(landing((float(a[0]), float(a[1])))) - still) @ a / (a @ a))
    x, y, z = aim.point
    scale = 1.0 - k / z
    shift = still + k * np.array([x, y]) / z
    return CellPlacement(
        (float(shift[0]), float(shift[1])), (lattice.pitch[0] * scale, lattice.pitch[1] * scale)
    )


def _vertex_change(place: CellPlacement, lattice: Lattice, table: Floats | None) -> VertexChange:
    """Displacement that keeps lenses aligned with their partners while their cells move."""
    gx, gy = place.scale(lattice)
    return VertexChange(((1.0 - gx, 0.0), (0.0, 1.0 - gy)), table)


def _moved(body: Body, shift: Pair2, change: VertexChange) -> Body:
    """Body with lenses of array 2 relative to their own cells' centres instead of cell 1's."""
    faces = []
    for face in (body.front, body.back):
        if face.array == 1:
            x, y, z = face.vertex
            face = replace(face, vertex=(x - shift[0], y - shift[1], z), change=change)
        faces.append(face)
    return replace(body, front=faces[0], back=faces[1])


def _table(aim: AimPoint, window: Window) -> Floats:
    """Moves (n1, n2, 2) of lens 2 in every cell, lengths; 0 in cells that are not kept."""
    lattice = window.lattice
    cells = lattice.cells()
    table = np.zeros((*lattice.count, 2))
    place = cells[:, 0] + cells[:, 1] // 2 if lattice.hexagonal else cells[:, 0]
    table[place, cells[:, 1]] = traced_moves(window, aim.slopes(lattice.centres(cells)))
    return table


# -- what is refused ---------------------------------------------------------------------------


def refuse_aim(window: Window, design: Design) -> tuple[AimPoint, CellPlacement]:
    """Point and placement of array 2's cells for it; parameters and refusals are those of `aimed`."""
    aim = AimPoint(design.lattice.aperture.point)  # type: ignore[union-attr]
    _refuse_table(design)
    _refuse_near(aim, window)
    cells = row_ends(window.lattice)
    built = _placed(aim, window.lattice, cells, _landing(window))
    _refuse_steep(aim, window, design, built, cells)
    _refuse_stray(aim, window, built, cells)
    return aim, built


def _refuse_table(design: Design) -> None:
    """Refuse more vertices than a table holds; CL121."""
    cells = design.lattice.count[0] * design.lattice.count[1]
    if design.pair.offset != "paraxial" and cells > MOST_TRACED:
        raise NoSuchLens(
            f"a sheet aimed at a point cannot have a table of more than {MOST_TRACED} vertices",
            key=LATTICE.count,
            code="CL121",
            hint='pair.offset = "paraxial", or fewer cells',
        )


def _refuse_near(aim: AimPoint, window: Window) -> None:
    """Refuse a viewer within ten separations of the sheet; CL122."""
    z, least = aim.point[2], NEAREST * window.thin.separation
    if abs(z) < least:
        raise NoSuchLens(
            f"the viewer of lattice.aperture is {abs(z):.6g} from the sheet, nearer than {NEAREST:g}"
            " separations",
            key="lattice.aperture.point.2",
            code="CL122",
            hint=f"z <= {-least:.6g} (before array 1) or z >= {least:.6g}; or a smaller separation",
        )


def _refuse_steep(aim: AimPoint, window: Window, design: Design, place: CellPlacement, cells: Ints) -> None:
    """Refuse use of lens 2 too far from its vertex; CL123, with the viewer's distance that works."""
    cell, far = _farthest(aim, window, place, cells)
    if design.pair.offset != "paraxial":
        far = far + traced_moves(window, aim.slopes(window.lattice.centres(cell)[None]))[0]
    half, radius = 0.5 * min(window.lattice.pitch), _least_radius(window)
    used = float(np.hypot(*far)) + half
    if used > STEEPEST * radius:
        raise NoSuchLens(
            f"in cell ({cell[0]}, {cell[1]}) lens 2 would be used {used:.4g} from its vertex,"
            f" {used / radius:.2f} of its radius {radius:.4g}, where at most {STEEPEST:g} sends light right",
            key=LATTICE.aperture,
            code="CL123",
            hint=_way_out(aim, window, cells),
        )


def _refuse_stray(aim: AimPoint, window: Window, place: CellPlacement, cells: Ints) -> None:
    """Refuse cells of array 2 farther than p/100 from their light; CL123."""
    off, (x, y) = _stray(aim, window, place, cells)
    if off > OFF * min(window.lattice.pitch):
        raise NoSuchLens(
            f"at ({x:.4g}, {y:.4g}) the light of the viewer would land {off:.4g} from the middle of its cell"
            f" of array 2, more than {OFF:g} of the pitch: refraction bends it too much for a lattice that is"
            " only scaled",
            key=LATTICE.aperture,
            code="CL123",
            hint=_way_out(aim, window, cells),
        )


def _farthest(aim: AimPoint, window: Window, place: CellPlacement, cells: Ints) -> tuple[Ints, Floats]:
    """Cell (2,) with lens 2 farthest from its centre, and its position (2,), paraxial, lengths."""
    vertex = next(face.vertex for face in window.faces if face.array == 1)
    places = _vertex_change(place, window.lattice, None).at(window.lattice, cells) + np.subtract(
        vertex[:2], place.shift
    )
    worst = int(np.argmax(np.hypot(*places.T)))
    return cells[worst], places[worst]


def _least_radius(window: Window) -> float:
    """Least radius of curvature of lens 2, in either meridian, length."""
    bent = [
        abs(c) for f in window.faces if f.array == 1 for c in (f.surface.curvature_x, f.surface.curvature_y)
    ]
    return 1.0 / max(bent)


def _stray(aim: AimPoint, window: Window, place: CellPlacement, cells: Ints) -> tuple[float, Floats]:
    """Greatest distance of light from its cell of array 2, length, and the point where it enters (2,)."""
    centres, landing = window.lattice.centres(cells), _landing(window)
    foot = np.array(aim.point[:2])
    # the cubic term is greatest at 1/√3 of the distance from the point's foot to the outermost cell
    tried = np.concatenate([centres, foot + (centres - foot) / np.sqrt(3.0)])
    tried = tried[:: max(1, len(tried) // TRIED)]
    want = np.array([landing((float(a[0]), float(a[1]))) for a in aim.slopes(tried)])
    off = np.hypot(*(tried * place.scale(window.lattice) + place.shift - tried - want).T)
    return float(np.max(off)), tried[int(np.argmax(off))]


def _way_out(aim: AimPoint, window: Window, cells: Ints) -> str:
    """Describe the nearest feasible viewer distance, at four digits, and alternatives."""
    half, radius = 0.5 * min(window.lattice.pitch), _least_radius(window)

    def works(z: float) -> bool:
        trial = AimPoint((aim.point[0], aim.point[1], z))
        place = _placed(trial, window.lattice, cells, _landing(window))
        used = float(np.hypot(*_farthest(trial, window, place, cells)[1])) + half
        return used <= STEEPEST * radius and _stray(trial, window, place, cells)[0] <= OFF * 2.0 * half

    z, grown = aim.point[2], 1.0
    while not works(z * grown):
        grown *= 1.02
        if grown > 64.0:
            return "a smaller sheet, or another separation or pitch"
    return f"a viewer at z = {z * grown:.4g}, a smaller sheet, or a smaller separation"
