"""The piece that repeats: one cell of an array with its front and back faces, in the cell frame, lengths in mm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from clacad.brep.conics import Arc, PosedQuadric, line, section_arc
from clacad.brep.lenses import (
    Lens,
    QuadricLens,
    fitted_lens,
    posed_quadric,
    quadric_lens,
    scaled_face,
)
from clacad.brep.pattern import Floats, Kind, Pattern, Proud, divided_pattern, plain_pattern
from clacad.brep.rims import Gap, Graph, Rim, fitted_rim, lens_graph, level_graph
from clacad.cell_complex.refusal import CannotBuild, refuse_buried_land
from clacad.sheet import Face, Window, optical_tile

UNDERCUT = 1e-6
"""A rim point further (mm) from the graph of its lens belongs to the other half of the surface."""

FIT = 1e-10
"""Allowed error of a fitted (biconic) patch relative to the pitch."""


@dataclass(frozen=True, eq=False)
class CellFace:
    """One face of a cell.

    Attributes
    ----------
    side : +1 front, −1 back
    level : float or None
        Height of the land, or of the plane for a plane face (mm).
    pattern : Pattern or None
        None for a plane face and for an open one.
    lens : Lens or None
    rims : tuple of tuple of Arc
        The 3-D arcs of every chain of the pattern.
    plane, open : bool
        Whether the face is one plane over all cells; whether the body has no face of this tiling here.
    optical : bool
        Whether the level is that of an optical plane that ends with its lens, in pieces, and not of land.
    rim_error : float, mm
        Distance of fitted rims from the true ones; 0 where they are exact.
    misfit : float, mm
        Distance of the rims' edges from the patch they bound.
    """

    side: int
    level: float | None = None
    pattern: Pattern | None = None
    lens: Lens | None = None
    rims: tuple[tuple[Arc, ...], ...] = ()
    plane: bool = False
    open: bool = False
    optical: bool = False
    rim_error: float = 0.0
    misfit: float = 0.0

    def height(self, kind: Kind, x: Floats, y: Floats) -> Floats:
        """Heights (n,) of what the face is: lens or level; ±inf where it is open, NaN where it is none (mm)."""
        if kind == "open":
            return np.full(np.shape(x), -np.inf if self.side > 0 else np.inf)
        if kind == "none":
            return np.full(np.shape(x), np.nan)
        if kind == "lens":
            assert self.lens is not None
            return self.lens.height(x, y)
        assert self.level is not None
        return np.full(np.shape(x), self.level)

    def arc(self, kind: Kind, start: Floats, end: Floats) -> Arc:
        """Border curve of the face over the straight segment start → end, (2,) each (mm)."""
        if kind == "lens":
            assert self.lens is not None
            return self.lens.arc(start, end)
        assert self.level is not None
        return line(np.append(start, self.level), np.append(end, self.level))


@dataclass(frozen=True, eq=False)
class Cell:
    """The prototile of a tiling: tile and zone (m, 2) in mm, and the two faces over it."""

    tile: Floats
    zone: Floats
    front: CellFace
    back: CellFace

    @property
    def faces(self) -> tuple[CellFace, CellFace]:
        """Front and back."""
        return self.front, self.back

    @property
    def one_rim(self) -> bool:
        """Whether front and back end in one common rim (a lens without land)."""
        return bool(self.front.rims) and self.front.rims is self.back.rims

    @property
    def misfit(self) -> float:
        """Distance of the rims' edges from the patches they bound (mm)."""
        return max(self.front.misfit, self.back.misfit)

    @cached_property
    def island(self) -> bool:
        """Whether the zone keeps away from the borders (a seam)."""
        return not np.array_equal(self.tile, self.zone)


def open_face(side: int) -> CellFace:
    """The side of a tiling on which the body has no face (the other array of a displaced slab)."""
    return CellFace(side, open=True)


def plane_face(side: int, level: float) -> CellFace:
    """A face that is one plane over all cells, at `level` (mm)."""
    return CellFace(side, level=level, plane=True)


def make_cell(window: Window, front: Face | None, back: Face | None, scale: float, front_level: float | None = None,
              back_level: float | None = None) -> Cell:  # fmt: skip
    """Build the prototile of a tiling.

    Parameters
    ----------
    window : Window
    front, back : Face or None
        None: a plane at the given level (mm), or open where there is no level either.
    scale : float
        mm per design unit.

    Raises
    ------
    ValueError
        A lens surface does not reach over its zone and no land or opposite face bounds it; a graph has passed
        the equator (undercut).
    """
    if front is not None and back is not None:
        refuse_buried_land(front, back)
    tile, zone = window.lattice.tile() * scale, optical_tile(window) * scale
    corners = tuple(tuple(map(tuple, polygon.tolist())) for polygon in (tile, zone))
    pitch = window.lattice.pitch[0] * scale
    return _made_cell(front, back, corners, pitch, scale, (front_level, back_level))


Corners = tuple[tuple[float, float], ...]


@lru_cache(maxsize=16)  # faces are immutable: forecast, drawing up and every grid of a sheet share their cell
def _made_cell(front: Face | None, back: Face | None, corners: tuple[Corners, Corners], pitch: float, scale: float,
               levels: tuple[float | None, float | None]) -> Cell:  # fmt: skip
    tile, zone = (np.array(polygon) for polygon in corners)
    tolerance = FIT * pitch
    faces = [None if face is None else scaled_face(face, scale) for face in (front, back)]
    built = [_flat_face(face, side, level) for face, side, level in zip(faces, (1, -1), levels)]
    rim = None
    if faces[0] is not None and faces[1] is not None:
        rim = _common_rim((faces[0], faces[1]), zone, tolerance)
    for n, face in enumerate(faces):
        flat = built[n]
        if flat is None:
            assert face is not None
            own = rim if rim is not None else _land_rim(face, zone, tolerance)
            built[n] = _lens_face(face, zone, tolerance, own)
        elif rim is not None:
            built[n] = _footprint(flat, rim)
    assert built[0] is not None
    assert built[1] is not None
    return Cell(tile, zone, built[0], built[1])


def _flat_face(face: Face | None, side: int, level: float | None) -> CellFace | None:
    if face is None:
        return open_face(side) if level is None else plane_face(side, level)
    return plane_face(side, face.vertex[2]) if face.array is None else None


def _footprint(flat: CellFace, rim: Rim) -> CellFace:
    """A plane face that ends where its lens does: one piece in every cell."""
    pattern = rim.pattern
    runs = tuple(
        tuple(replace(run, kind="land") if run.kind == "lens" else run for run in side)
        for side in pattern.runs
    )
    regions = tuple(replace(region, kind="land") for region in pattern.regions if region.kind == "lens")
    own = replace(pattern, runs=runs, regions=regions)
    return CellFace(flat.side, flat.level, own, rims=rim.arcs, optical=True)


def _common_rim(faces: tuple[Face, Face], zone: Floats, tolerance: float) -> Rim | None:
    """The rim in which both faces of a body end; None where they cover the zone, or land bounds them.

    Raises
    ------
    CannotBuild
        CL131: see `_check_web`. CL130, CL132, CL133: no such rim can be made.
    """
    lenses = [face for face in faces if face.array is not None]
    rim = _meeting(faces, zone, tolerance) if lenses else None
    if rim is not None and not any(region.kind == "lens" for region in rim.pattern.regions):
        raise CannotBuild(
            "CL130",
            "the faces of the lens enclose nothing over its cell: the surface ends inside its cell at its own equator, "
            "or lies beyond the other face; a longer radius (pair.separation), a smaller lattice.pitch, or more "
            "pair.thickness",
        )
    if rim is None or None in [face.land for face in lenses]:
        return rim
    if len(lenses) == 2:
        _check_web(faces, rim)
    return None


def _meeting(faces: tuple[Face, Face], zone: Floats, tolerance: float) -> Rim | None:
    """Where the two faces of a body cut one another above its zone; None where the lens covers its zone.

    Two poses of one quadric meet in a plane, and so do a quadric and a plane: their rim is exact. Any other is fitted.
    """
    first, second = (posed_quadric(face) for face in faces)
    if first is not None and second is not None:
        x, y = _samples(zone)
        with np.errstate(invalid="ignore"):
            if (first.height(x, y) < second.height(x, y)).all():
                return None
        plane = _meeting_plane(faces, first, second)
        if plane is not None:

            def proud(px: Floats, py: Floats) -> NDArray[np.bool_]:
                with np.errstate(invalid="ignore"):
                    return np.asarray(first.height(px, py) < second.height(px, py))

            return _exact_rim(first if faces[0].array is not None else second, zone, plane, proud, "none")
    rim = fitted_rim(Gap(_graph(faces[0]), _graph(faces[1])), zone, "none", tolerance)
    return None if _covers(rim.pattern) else rim


def _graph(face: Face) -> Graph:
    return level_graph(face.vertex[2]) if face.array is None else lens_graph(face)


def _covers(pattern: Pattern) -> bool:
    return not pattern.chains and [region.kind for region in pattern.regions] == ["lens"]


def _meeting_plane(faces: tuple[Face, Face], first: PosedQuadric, second: PosedQuadric) -> Floats | None:
    """The plane z = c0 + c1 x + c2 y in which two faces meet; None where they meet in no plane."""
    for face in faces:
        if face.array is None:
            return np.array([face.vertex[2], 0.0, 0.0])
    if not np.allclose(first.matrix, second.matrix, rtol=0.0, atol=1e-12 * float(np.abs(first.matrix).max())):
        return None
    # F_front − F_back is linear when both are poses of one quadric: their common points lie in a plane.
    gradient = 2.0 * (
        (first.linear - first.matrix @ first.apex) - (second.linear - second.matrix @ second.apex)
    )
    constant = float(first.value(np.zeros(3)) - second.value(np.zeros(3)))
    if abs(gradient[2]) < 1e-6 * float(np.linalg.norm(gradient)):
        return None
    return np.asarray(-np.array([constant, gradient[0], gradient[1]]) / gradient[2])


def _check_web(faces: tuple[Face, Face], rim: Rim) -> None:
    """Refuse a web out of which the rim of a tilted lens sticks: the union of lens and plate is no column there.

    At a rim point outside the plate, front and back of the lens meet at a height h above the plate's upper face (or
    below its lower one). Just inside the rim both faces are near h, so between plate and lens there is air on the same
    vertical line: the lens overhangs the plate, which neither a height field nor a mould or an etch can make. If the
    whole rim lies in the plate nothing overhangs: over the region the rim encloses the front of a convex lens is a
    convex function of (x, y), which takes its largest value on the rim, so the front nowhere stands above the plate's
    upper face, and the back nowhere below its lower one.

    Raises
    ------
    CannotBuild
        CL131, with the thickness of web that holds the rim.
    """
    front, back = faces
    assert front.land is not None
    assert back.land is not None
    middle, reach = 0.5 * (front.land + back.land), 0.0
    for chain in rim.arcs:
        for arc in chain:
            reach = max(reach, float(np.abs(arc.at(np.linspace(0.0, 1.0, 17))[:, 2] - middle).max()))
    if 2.0 * reach > (back.land - front.land) * (1.0 + 1e-9):
        raise CannotBuild(
            "CL131",
            f"the rim of the tilted lens sticks out of its web; a web of at least {2.0 * reach:.6g} mm holds it "
            "(or give the lens more thickness, so that its rim leaves the cell)",
        )


def _samples(zone: Floats) -> tuple[Floats, Floats]:
    """Points over a convex zone, its corners and sides included: (n,) each."""
    share = np.linspace(0.0, 1.0, 17)
    sides = [a + share[:, None] * (b - a) for a, b in zip(zone, np.roll(zone, -1, axis=0))]
    border = np.concatenate(sides)
    points = np.concatenate([border * r for r in np.linspace(0.0, 1.0, 9)])
    return points[:, 0], points[:, 1]


def _conic(quadric: PosedQuadric, plane: Floats) -> Floats:
    """Conic (3, 3) in x, y that the plane z = plane · (1, x, y) cuts from a quadric."""
    m, q, d = quadric.matrix, quadric.linear, quadric.apex
    linear = q - m @ d
    full = np.zeros((4, 4))
    full[:3, :3], full[:3, 3], full[3, :3] = m, linear, linear
    full[3, 3] = float(d @ m @ d - 2.0 * q @ d)
    lift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [plane[1], plane[2], plane[0]], [0.0, 0.0, 1.0]])
    return np.asarray(lift.T @ full @ lift)


def _land_rim(face: Face, zone: Floats, tolerance: float) -> Rim:
    """Where a lens ends on its land, if it has any."""
    quadric, land = posed_quadric(face), face.land
    if land is None:
        return Rim(plain_pattern(zone, "lens"), ())
    if quadric is None:
        lens, level = lens_graph(face), level_graph(land)
        gap = Gap(lens, level) if face.side > 0 else Gap(level, lens)
        return fitted_rim(gap, zone, "land", tolerance)

    def proud(x: Floats, y: Floats) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore"):
            return np.asarray(face.side * (quadric.height(x, y) - land) < 0.0)

    x, y = _samples(zone)
    if proud(x, y).all():
        return Rim(plain_pattern(zone, "lens"), ())
    return _exact_rim(quadric, zone, np.array([land, 0.0, 0.0]), proud, "land")


def _exact_rim(quadric: PosedQuadric, zone: Floats, plane: Floats, proud: Proud, rest: Kind) -> Rim:
    """The rim in which a plane z = plane · (1, x, y) cuts a quadric."""
    pattern = divided_pattern(zone, _conic(quadric, plane), proud, rest)
    normal = np.array([-plane[1], -plane[2], 1.0])
    arcs = tuple(
        _rim_arcs(quadric, chain.points, chain.first is None, plane, normal) for chain in pattern.chains
    )
    return Rim(pattern, arcs)


def _lens_face(face: Face, zone: Floats, tolerance: float, rim: Rim) -> CellFace:
    quadric, pattern = posed_quadric(face), rim.pattern
    lens: Lens | None = None
    if quadric is not None:
        _graph_or_raise(quadric, pattern, zone)
    if any(region.kind == "lens" for region in pattern.regions):
        if quadric is not None:
            lens = quadric_lens(quadric, _boundary(quadric, pattern, zone, rim.arcs))
        else:
            lens = fitted_lens(face, _lens_box(pattern, zone, rim.arcs), tolerance)
    made = CellFace(face.side, face.land, pattern, lens, rim.arcs, rim_error=rim.error)
    return replace(made, misfit=_misfit(made))


def _misfit(face: CellFace) -> float:
    """Largest distance (mm) of the rim's edges from the patch they bound."""
    if face.lens is None:
        return 0.0
    t = np.linspace(0.0, 1.0, 17)
    patch, worst = face.lens.patch, 0.0
    for arc in (arc for chain in face.rims for arc in chain):
        u, v = face.lens.parameters(arc).at(t).T
        worst = max(worst, float(np.linalg.norm(patch.at(u, v) - arc.at(t), axis=1).max()))
    return worst


def _lens_box(pattern: Pattern, zone: Floats, rims: tuple[tuple[Arc, ...], ...]) -> Floats:
    """Corners (2, 2) of the least rectangle that holds the lens, with 1 % to spare at its rims."""
    if not rims:
        return zone
    points = [arc.at(np.linspace(0.0, 1.0, 17))[:, :2] for chain in rims for arc in chain]
    for k, side in enumerate(pattern.runs):
        a, b = zone[k], zone[(k + 1) % len(zone)]
        points += [
            np.array([a + t * (b - a) for t in (run.t0, run.t1)]) for run in side if run.kind == "lens"
        ]
    every = np.concatenate(points)
    low, high = every.min(axis=0), every.max(axis=0)
    spare = 0.01 * (high - low)
    return np.array([low - spare, high + spare])


def _graph_or_raise(quadric: PosedQuadric, pattern: Pattern, zone: Floats) -> None:
    """Check that the lens is a graph over its whole region: no missing point, no undercut."""
    if len(pattern.regions) == 1 and pattern.regions[0].kind == "lens" and not pattern.chains:
        x, y = _samples(zone)
        if not np.isfinite(quadric.height(x, y)).all():
            raise CannotBuild(
                "CL130",
                "the lens surface ends inside its cell (its radius is below the cell's half diagonal, or the "
                "tilt passes its equator) and there is no land to fall back on; a longer "
                "radius (pair.separation), a smaller lattice.pitch or less tilt",
            )


def _rim_arcs(
    quadric: PosedQuadric, points: Floats, closed: bool, plane: Floats, normal: Floats
) -> tuple[Arc, ...]:
    z = plane[0] + points @ plane[1:]
    lifted = np.column_stack([points, z])
    away = np.abs(quadric.height(points[:, 0], points[:, 1]) - z)
    if not (away <= UNDERCUT).all():
        raise CannotBuild(
            "CL133", "the lens is undercut at its rim (the tilt passes its equator); tilt it less"
        )
    following = np.roll(lifted, -1, axis=0) if closed else lifted[1:]
    return tuple(section_arc(quadric, a, b, normal) for a, b in zip(lifted, following))


def _boundary(
    quadric: PosedQuadric, pattern: Pattern, zone: Floats, rims: tuple[tuple[Arc, ...], ...]
) -> Floats:
    """Poles (k, 3) of all arcs that bound the lens; the patch must cover them."""
    lens = QuadricLens(quadric, (0.0, 1.0), (0.0, 1.0))
    poles = [arc.poles for chain in rims for arc in chain]
    for k, side in enumerate(pattern.runs):
        a, b = zone[k], zone[(k + 1) % len(zone)]
        for run in side:
            if run.kind == "lens":
                poles.append(lens.arc(a + run.t0 * (b - a), a + run.t1 * (b - a)).poles)
    return np.concatenate(poles)
