"""The repeated piece: one cell of an array with its front and back faces, in its own frame, lengths in mm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from clacad.base.types import Floats
from clacad.sheet.window import Face, Window, optical_tile
from clacad.solid.face_pattern import Kind, Pattern
from clacad.solid.fitted_rims import Rim
from clacad.solid.lens_faces import (
    Lens,
    QuadricLens,
    common_rim,
    fitted_lens,
    land_rim,
    posed_quadric,
    quadric_lens,
    scaled_face,
    zone_samples,
)
from clacad.solid.rational_conics import Arc, PosedQuadric, line
from clacad.topology.complex_parts import CannotBuild, refuse_buried_land

FIT = 1e-10
"""Allowed error of a fitted (biconic) patch relative to the pitch."""


@dataclass(frozen=True, eq=False)
class CellFace:
    """One face of a cell.

    side : +1 front, −1 back
    level : Height of the land, or of the plane for a plane face (mm).
    pattern : None for a plane face and for an open one.
    rims : The 3-D arcs of every chain of the pattern.
    plane, open : Whether the face is one plane over all cells; whether the body has no face of this tiling.
    optical : bool
        Whether the level is that of an optical plane that ends with its lens, in pieces, instead of land.
    rim_error : mm. Distance of fitted rims from the true ones; 0 where they are exact.
    misfit : mm. Distance of the rims' edges from the patch that they bound.
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
        """Heights (n,) of the face: lens or level; ±inf where it is open, NaN where there is none (mm)."""
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
        """Distance of the rims' edges from the patches that they bound (mm)."""
        return max(self.front.misfit, self.back.misfit)

    @cached_property
    def island(self) -> bool:
        """Whether the zone does not reach the borders (a seam)."""
        return not np.array_equal(self.tile, self.zone)


def make_cell(
    window: Window,
    front: Face | None,
    back: Face | None,
    scale: float,
    front_level: float | None = None,
    back_level: float | None = None,
    array: int = 0,
) -> Cell:
    """Build the prototile of a tiling.

    front, back : None: a plane at the given level (mm), or open where there is no level either.
    scale : mm per design unit.
    array : Array of the cells, where arrays have different pitches.
    Raises ValueError: A lens surface does not cover its zone and no land or opposite face bounds it; a graph
        has passed the equator (undercut).
    """
    if front is not None and back is not None:
        refuse_buried_land(front, back)
    lattice = window.lattice_of(array)
    tile, zone = lattice.tile() * scale, optical_tile(window, array) * scale
    corners = tuple(tuple(map(tuple, polygon.tolist())) for polygon in (tile, zone))
    pitch = lattice.pitch[0] * scale
    return _made_cell(front, back, corners, pitch, scale, (front_level, back_level))


Corners = tuple[tuple[float, float], ...]


@lru_cache(maxsize=16)  # faces are immutable: forecast, drawing and every grid of a sheet share their cell
def _made_cell(
    front: Face | None,
    back: Face | None,
    corners: tuple[Corners, Corners],
    pitch: float,
    scale: float,
    levels: tuple[float | None, float | None],
) -> Cell:
    """The prototile over (tile, zone), from faces in design units and levels in mm; see `make_cell`."""
    tile, zone = (np.array(polygon) for polygon in corners)
    tolerance = FIT * pitch
    faces = [None if face is None else scaled_face(face, scale) for face in (front, back)]
    built = [_flat_face(face, side, level) for face, side, level in zip(faces, (1, -1), levels)]
    rim, thick = None, None
    if faces[0] is not None and faces[1] is not None:
        rim, thick = common_rim((faces[0], faces[1]), zone, tolerance)
    for n, face in enumerate(faces):
        flat = built[n]
        if flat is None:
            assert face is not None
            own = rim if rim is not None else land_rim(face, thick, zone, tolerance)
            built[n] = _lens_face(face, zone, tolerance, own)
        elif rim is not None:
            built[n] = _footprint(flat, rim)
    assert built[0] is not None
    assert built[1] is not None
    return Cell(tile, zone, built[0], built[1])


def _flat_face(face: Face | None, side: int, level: float | None) -> CellFace | None:
    """A plane over all cells, or the open side of a displaced slab, without a face there; None for a lens."""
    if face is not None and face.array is not None:
        return None
    level = level if face is None else face.vertex[2]
    return CellFace(side, level=level, plane=level is not None, open=level is None)


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
    """Largest distance (mm) of the rim's edges from the patch that they bound."""
    if face.lens is None:
        return 0.0
    t = np.linspace(0.0, 1.0, 17)
    patch, worst = face.lens.patch, 0.0
    for arc in (arc for chain in face.rims for arc in chain):
        u, v = face.lens.parameters(arc).at(t).T
        worst = max(worst, float(np.linalg.norm(patch.at(u, v) - arc.at(t), axis=1).max()))
    return worst


def _lens_box(pattern: Pattern, zone: Floats, rims: tuple[tuple[Arc, ...], ...]) -> Floats:
    """Corners (2, 2) of the least rectangle that contains the lens, with a margin of 1 % at its rims."""
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
        x, y = zone_samples(zone)
        if not np.isfinite(quadric.height(x, y)).all():
            raise CannotBuild(
                "CL130",
                "the lens surface ends inside its cell (its radius is below the cell's half diagonal, or the "
                "tilt passes its equator) and there is no land to fall back on; a longer "
                "radius (pair.separation), a smaller lattice.pitch or less tilt",
            )


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
