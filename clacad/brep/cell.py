"""The piece that repeats: one cell of an array with its front and back faces, in the cell frame, lengths in mm."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

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
from clacad.brep.pattern import Floats, Kind, Pattern, divided_pattern, plain_pattern
from clacad.cell_complex.refusal import CannotBuild
from clacad.sheet import Face, Window, optical_tile

UP = np.array([0.0, 0.0, 1.0])

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
    """

    side: int
    level: float | None = None
    pattern: Pattern | None = None
    lens: Lens | None = None
    rims: tuple[tuple[Arc, ...], ...] = ()
    plane: bool = False
    open: bool = False

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
    tile, zone = window.lattice.tile() * scale, optical_tile(window) * scale
    faces = [None if face is None else scaled_face(face, scale) for face in (front, back)]
    built: list[CellFace | None] = [
        _flat_face(face, side, level) for face, side, level in zip(faces, (1, -1), (front_level, back_level))
    ]
    meeting = None
    if all(face is not None and face.array is not None for face in faces):
        meeting = _meeting(window, zone, faces)
        if meeting is not None and None not in [face.land for face in faces if face is not None]:
            _check_web(faces, meeting)
            meeting = None
    for n, face in enumerate(faces):
        if built[n] is None:
            assert face is not None
            built[n] = _lens_face(face, zone, window.lattice.pitch[0] * scale, meeting)
    assert built[0] is not None
    assert built[1] is not None
    return Cell(tile, zone, built[0], built[1])


def _flat_face(face: Face | None, side: int, level: float | None) -> CellFace | None:
    if face is None:
        return open_face(side) if level is None else plane_face(side, level)
    return plane_face(side, face.vertex[2]) if face.array is None else None


@dataclass(frozen=True, eq=False)
class _Meeting:
    """Where the two faces of a lens meet: the plane z = c0 + c1 x + c2 y, and the pattern it gives."""

    plane: Floats
    pattern: Pattern


def _meeting(window: Window, zone: Floats, faces: list[Face | None]) -> _Meeting | None:
    """Find whether the two faces of a lens cut one another above its zone, and the plane they do it in."""
    front, back = faces
    assert front is not None
    assert back is not None
    x, y = _samples(zone)
    first, second = posed_quadric(front), posed_quadric(back)
    if first is None or second is None:
        heights = [_lens_heights(face, x, y) for face in (front, back)]
        if not (heights[0] < heights[1]).all():
            raise CannotBuild(
                "CL132",
                "the biconic lens does not cover its cell, and the rim where its faces meet is no plane curve; "
                f"this lens lacks {float((heights[0] - heights[1]).max()):.4g} design units of thickness "
                '(pair.thickness = "auto" finds it; or pair.surface = "ellipsoid", whose rims are exact)',
            )
        return None
    with np.errstate(invalid="ignore"):
        thick = first.height(x, y) < second.height(x, y)
    if thick.all():
        return None
    if not np.allclose(first.matrix, second.matrix, rtol=0.0, atol=1e-12 * float(np.abs(first.matrix).max())):
        raise CannotBuild(
            "CL132",
            "front and back of the lens do not meet in a plane; give the lens more thickness or a web",
        )
    # F_front − F_back is linear when both are poses of one quadric: their common points lie in a plane.
    gradient = 2.0 * (
        (first.linear - first.matrix @ first.apex) - (second.linear - second.matrix @ second.apex)
    )
    constant = float(first.value(np.zeros(3)) - second.value(np.zeros(3)))
    plane = -np.array([constant, gradient[0], gradient[1]]) / gradient[2]

    def proud(px: Floats, py: Floats) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore"):
            return np.asarray(first.height(px, py) < second.height(px, py))

    return _Meeting(plane, divided_pattern(zone, _conic(first, plane), proud, "none"))


def _check_web(faces: list[Face | None], meeting: _Meeting) -> None:
    """Refuse a web out of which the rim of a tilted lens sticks: the overhang could not be a column.

    Raises
    ------
    ValueError
        With the thickness of web that holds the rim.
    """
    front, back = faces
    assert front is not None
    assert back is not None
    quadric = posed_quadric(front)
    assert quadric is not None
    assert front.land is not None
    assert back.land is not None
    plane = meeting.plane
    normal = np.array([-plane[1], -plane[2], 1.0])
    middle, reach = 0.5 * (front.land + back.land), 0.0
    for chain in meeting.pattern.chains:
        for arc in _rim_arcs(quadric, chain.points, chain.first is None, plane, normal):
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


def _lens_heights(face: Face, x: Floats, y: Floats) -> Floats:
    from clacad.sheet import lens_height

    return lens_height(face, x, y)


def _conic(quadric: PosedQuadric, plane: Floats) -> Floats:
    """Conic (3, 3) in x, y that the plane z = plane · (1, x, y) cuts from a quadric."""
    m, q, d = quadric.matrix, quadric.linear, quadric.apex
    linear = q - m @ d
    full = np.zeros((4, 4))
    full[:3, :3], full[:3, 3], full[3, :3] = m, linear, linear
    full[3, 3] = float(d @ m @ d - 2.0 * q @ d)
    lift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [plane[1], plane[2], plane[0]], [0.0, 0.0, 1.0]])
    return np.asarray(lift.T @ full @ lift)


def _lens_face(face: Face, zone: Floats, pitch: float, meeting: _Meeting | None) -> CellFace:
    quadric = posed_quadric(face)
    if quadric is None:
        return _fitted_face(face, zone, pitch)
    normal = UP
    if meeting is not None:
        pattern, plane = meeting.pattern, meeting.plane
        normal = np.array([-plane[1], -plane[2], 1.0])
    elif face.land is None:
        pattern, plane = plain_pattern(zone, "lens"), np.zeros(3)
    else:
        pattern, plane = _land_pattern(quadric, face, zone), np.array([face.land, 0.0, 0.0])
    _graph_or_raise(quadric, pattern, zone)
    rims = tuple(
        _rim_arcs(quadric, chain.points, chain.first is None, plane, normal) for chain in pattern.chains
    )
    lens = None
    if any(region.kind == "lens" for region in pattern.regions):
        lens = quadric_lens(quadric, _boundary(quadric, pattern, zone, rims))
    return CellFace(face.side, face.land, pattern, lens, rims)


def _fitted_face(face: Face, zone: Floats, pitch: float) -> CellFace:
    lens = fitted_lens(face, zone, FIT * pitch)
    if face.land is not None:
        x, y = _samples(zone)
        if (face.side * (lens.height(x, y) - face.land) >= 0.0).any():
            deepest = float((face.side * (lens.height(x, y) - face.land)).max())
            raise CannotBuild(
                "CL132",
                f"the biconic lens sinks {deepest:.4g} mm into its land, where no exact rim exists; a lens that much "
                'thicker stands clear of it (pair.thickness, or a thinner pair.web; or pair.surface = "ellipsoid")',
            )
    return CellFace(face.side, face.land, plain_pattern(zone, "lens"), lens)


def _land_pattern(quadric: PosedQuadric, face: Face, zone: Floats) -> Pattern:
    land = face.land
    assert land is not None

    def proud(x: Floats, y: Floats) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore"):
            return np.asarray(face.side * (quadric.height(x, y) - land) < 0.0)

    x, y = _samples(zone)
    if proud(x, y).all():
        return plain_pattern(zone, "lens")
    return divided_pattern(zone, _conic(quadric, np.array([land, 0.0, 0.0])), proud, "land")


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
