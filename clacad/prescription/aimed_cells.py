"""Cells of array 2 aimed at a viewer: placed where the viewer's light arrives.

Light of a viewer at P = (x_P, y_P, z_P) crosses the centre C of cell 1 with slope a(C) = (C − P_xy)/(−z_P).
Through lens 1's vertex it reaches array 2 at C + L(a), which becomes the centre of cell 2. L is linear in
air, and linear to third order in glass: L(a) = L(0) + k a, with k from the outermost cell. Then

    C2 = g C + k P_xy/z_P + L(0)      g = 1 − k/z_P      the lattice scaled and shifted: without gaps
    vertex 2 in its own cell = (1 − g) C + d − shift

with d the offset of lens 2 from lens 1 as in every sheet: borders move, vertices do not. The places of cells
depend on the viewer alone; `clacad.prescription.cells` adds what the law of each cell moves lens 2 by.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats, Ints, Pair2
from clacad.base.vectors import xy
from clacad.design.sections import LATTICE
from clacad.prescription.bodies import FieldCells, displacement
from clacad.prescription.radii import NoSuchLens
from clacad.prescription.sharp_pairs import placed_field
from clacad.prescription.traced_vertices import field_moves, traced_moves
from clacad.sheet.cell_places import CellPlacement, VertexChange, row_ends
from clacad.sheet.window import Face, Window, changed_faces

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


@dataclass(frozen=True)
class AimPoint:
    """The point that a sheet is aimed at, sheet frame, lengths."""

    point: tuple[float, float, float]

    def slopes(self, centres: Floats) -> Floats:
        """Slopes (..., 2) in air of the point's light through the centres (..., 2) of cells."""
        x, y, z = self.point
        return np.asarray((centres - (x, y)) / -z)


def aimed(window: Window, design: Design, field: FieldCells | None = None) -> Window:
    """Return the window with the cells of its array 2 aimed; lenses stay where they are.

    window : Uniform, with partners aligned (aperture "aligned").
    field : Cells of a field lens.
    Raises NoSuchLens: CL122: the viewer is too near; CL123: lens 2 would be too steep.
    """
    aim, built = refuse_aim(window, design, field)
    thin = _placed(aim, window.lattice, row_ends(window.lattice), _straight(window.thin.offset[2]))
    change = _vertex_change(built, window.lattice, field)
    kept = 1.0 if field is None else 1.0 - field.drift
    shift = xy(kept * np.subtract(built.shift, window.shifts[1]))

    def moved(face: Face) -> Face:  # relative to the centre of its own cell in place of that of cell 1
        x, y, z = face.vertex
        if face.array != 1:
            return face
        return replace(face, vertex=(x - shift[0], y - shift[1], z), change=change)

    return replace(
        window,
        placements=(CellPlacement(), built, *window.placements[2:]),
        bodies=changed_faces(window.bodies, moved),
        thin=replace(
            window.thin, shift=thin.shift, pitch=thin.pitch, change=_vertex_change(thin, window.lattice)
        ),
    )


def _landing(window: Window, field: FieldCells | None) -> Landing:
    """Landing function of a pair as built: straight if biconvex, else refracted at lens 1's vertex."""
    faces = [face for face in window.faces if face.array == 1]
    if window.form == "biconvex":
        x, y, z = (0.0, 0.0, 0.0) if field is None else field.added.tolist()  # the plate carries light aside
        height = 0.5 * (faces[0].vertex[2] + faces[1].vertex[2]) - z
        return lambda slope: (height * slope[0] + x, height * slope[1] + y)
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


def _vertex_change(place: CellPlacement, lattice: Lattice, field: FieldCells | None = None) -> VertexChange:
    """Displacement that keeps lenses aligned with their partners, or the law, while their cells move."""
    gx, gy = place.scale(lattice)
    kept = 1.0 if field is None else 1.0 - field.drift
    return VertexChange(((kept * (1.0 - gx), 0.0), (0.0, kept * (1.0 - gy))))


# -- what is refused ---------------------------------------------------------------------------


def refuse_aim(
    window: Window, design: Design, field: FieldCells | None = None
) -> tuple[AimPoint, CellPlacement]:
    """Point and placement of array 2's cells for it; parameters and refusals are those of `aimed`."""
    aim = AimPoint(design.lattice.aperture.point)  # type: ignore[union-attr]
    _refuse_near(aim, window)
    cells = row_ends(window.lattice)
    landing = _landing(window, field)
    built = _placed(aim, window.lattice, cells, landing)
    if design.law_spec.varying is None:  # else each cell's own lens decides, `cells`
        _refuse_steep(aim, window, design, built, field)
    _refuse_stray(aim, window, built, cells, landing)
    return aim, built


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


def _refuse_steep(
    aim: AimPoint, window: Window, design: Design, place: CellPlacement, field: FieldCells | None
) -> None:
    """Refuse use of lens 2 too far from its vertex; CL123, with the viewer's distance that works."""
    cells, landing = row_ends(window.lattice), _landing(window, field)
    cell, far = _farthest(aim, window, place, cells)
    if design.pair.offset != "paraxial":
        moves = None
        if field is not None:
            placed = replace(window, placements=(CellPlacement(), place, *window.placements[2:]))
            moves = field_moves(window, placed_field(placed, field, window.shifts[1]), cell[None])
        far = far + traced_moves(window, aim.slopes(window.lattice.centres(cell)[None]), moves)[0]
    half, radius = 0.5 * min(window.lattice.pitch), _least_radius(window)
    used = float(np.hypot(*far)) + half
    if used > STEEPEST * radius:
        raise NoSuchLens(
            f"in cell ({cell[0]}, {cell[1]}) lens 2 would be used {used:.4g} from its vertex,"
            f" {used / radius:.2f} of its radius {radius:.4g}, where at most {STEEPEST:g} sends light right",
            key=LATTICE.aperture,
            code="CL123",
            hint=_way_out(aim, window, cells, landing),
        )


def _refuse_stray(aim: AimPoint, window: Window, place: CellPlacement, cells: Ints, landing: Landing) -> None:
    """Refuse cells of array 2 farther than p/100 from their light; CL123."""
    off, (x, y) = _stray(aim, window, place, cells, landing)
    if off > OFF * min(window.lattice.pitch):
        raise NoSuchLens(
            f"at ({x:.4g}, {y:.4g}) the light of the viewer would land {off:.4g} from the middle of its cell"
            f" of array 2, more than {OFF:g} of the pitch: refraction bends it too much for a lattice that is"
            " only scaled",
            key=LATTICE.aperture,
            code="CL123",
            hint=_way_out(aim, window, cells, landing),
        )


def _farthest(aim: AimPoint, window: Window, place: CellPlacement, cells: Ints) -> tuple[Ints, Floats]:
    """Cell (2,) with lens 2 farthest from its centre, and its position (2,), paraxial, lengths."""
    vertex = next(face.vertex for face in window.faces if face.array == 1)
    places = _vertex_change(place, window.lattice).at(window.lattice, cells) + np.subtract(
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


def _stray(
    aim: AimPoint, window: Window, place: CellPlacement, cells: Ints, landing: Landing
) -> tuple[float, Floats]:
    """Greatest distance of light from its cell of array 2, length, and the point where it enters (2,)."""
    centres = window.lattice.centres(cells)
    foot = np.array(aim.point[:2])
    # the cubic term is greatest at 1/√3 of the distance from the point's foot to the outermost cell
    tried = np.concatenate([centres, foot + (centres - foot) / np.sqrt(3.0)])
    tried = tried[:: max(1, len(tried) // TRIED)]
    want = np.array([landing((float(a[0]), float(a[1]))) for a in aim.slopes(tried)])
    off = np.hypot(*(tried * place.scale(window.lattice) + place.shift - tried - want).T)
    return float(np.max(off)), tried[int(np.argmax(off))]


def _way_out(aim: AimPoint, window: Window, cells: Ints, landing: Landing) -> str:
    """Describe the nearest feasible viewer distance, at four digits, and alternatives."""
    half, radius = 0.5 * min(window.lattice.pitch), _least_radius(window)

    def works(z: float) -> bool:
        trial = AimPoint((aim.point[0], aim.point[1], z))
        place = _placed(trial, window.lattice, cells, landing)
        used = float(np.hypot(*_farthest(trial, window, place, cells)[1])) + half
        return (
            used <= STEEPEST * radius and _stray(trial, window, place, cells, landing)[0] <= OFF * 2.0 * half
        )

    z, grown = aim.point[2], 1.0
    while not works(z * grown):
        grown *= 1.02
        if grown > 64.0:
            return "a smaller sheet, or another separation or pitch"
    return f"a viewer at z = {z * grown:.4g}, a smaller sheet, or a smaller separation"
