"""Split of a direction error into five parts, ray by ray, which add up to the whole.

The same rays are traced through a chain of models. Each model includes one more source of error:

====  ====================================================================================  =================
      direction of a ray                                                                    what is new in it
====  ====================================================================================  =================
0     the requested law
1     the exact surfaces, hit by the ray of the same direction through the middle of lens 1  design
2     the exact surfaces, hit where the ray hits them, in 50 digits                         aberration
3     the same in double precision: the kernel                                               kernel rounding
4     triangles with their corners on the exact surfaces                                     tessellation
5     the triangles as the file holds them                                                   file precision
====  ====================================================================================  =================

A part is the vector difference of two neighbouring models; the five vectors of a ray add up to its whole
error. The lengths of the vectors do not add up. Each part therefore also carries its share of the rms error,
mean(part · whole)/rms(whole); these shares add up to the rms error.

Shares of light through the partner lenslet and as ghosts, over a wide field, with the closed form.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.sobol import sobol
from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.judging.cell_triangles import Cell, CellFacets, own_facets, telescopelet
from clacad.optics.rays import NO_CELL, Fate, Rays, TraceResult
from clacad.optics.sequence import trace_sequence
from clacad.sheet.bundle import Bundle, RequestedLaw, bundle, launched, middle_direction, rays_across
from clacad.sheet.like_cell import interfaces
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.vignetting import half_field, share, thin_cells
from clacad.sheet.window import Window
from clacad.tracing.facets.telescopelet import trace_facets
from clacad.tracing.trace import trace

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clacad.design import Design


RAYS = 1024
QUADS = 16
"""Grid of the triangles where no file is given, in quads."""

ASIDE = (0.618e-3, 0.414e-3)
"""Offset of all points, over the cell: Sobol points are dyadic and would lie exactly on triangle edges."""

NAMES = ("design", "aberration", "kernel rounding", "tessellation", "file precision")
MEANING: Mapping[str, str] = {
    "design": (
        "what the ray through the middle of lens 1 misses the law by: thick lenses of this form at a finite"
        " angle"
    ),
    "aberration": "what the place within the lens adds, on exact surfaces in 50 digits",
    "kernel rounding": "double precision instead of 50 digits",
    "tessellation": "flat triangles instead of curved surfaces, their corners exact",
    "file precision": "corners as the file holds them",
}


@dataclass(frozen=True, eq=False)
class ErrorPart:
    """One part of the error.

    name : str, one of `NAMES`
    vector : (n, 3). Difference of the directions of two neighbouring models, ray by ray.
    rms, half, worst : radians. Of this part alone: rms, median, largest. A ray next to a triangle edge
        changes facets when the edge moves a little, which gives a few large errors among many small ones.
    share : radians. Contribution to the rms of the whole; negative where the part cancels some of the others.
    """

    name: str
    vector: Floats
    rms: float
    half: float
    worst: float
    share: float

    @property
    def meaning(self) -> str:
        """Description of the part in words."""
        return MEANING[self.name]


@dataclass(frozen=True, eq=False)
class Attribution:
    """The error of some triangles, split into its parts.

    about : The file, or the triangles that represent it.
    parts : tuple of five ErrorPart
    whole : (n, 3). Direction through the triangles minus the law's.
    rms : radians
    cell : (i, j)
    rays, used : Rays launched, and rays compared: those ALIVE in every model.
    """

    about: str
    parts: tuple[ErrorPart, ...]
    whole: Floats
    rms: float
    cell: Cell
    rays: int
    used: int
    bundle: str

    def part(self, name: str) -> ErrorPart:
        """Part with a given name. Raises KeyError."""
        return {part.name: part for part in self.parts}[name]

    def to_dict(self) -> dict[str, Any]:
        """Numbers for the report, radians."""
        return {
            "about": self.about,
            "rms": self.rms,
            "cell": list(self.cell),
            "rays": self.rays,
            "used": self.used,
            "bundle": self.bundle,
            "parts": [
                {
                    "name": p.name,
                    "rms": p.rms,
                    "half": p.half,
                    "worst": p.worst,
                    "share": p.share,
                    "meaning": p.meaning,
                }
                for p in self.parts
            ],
        }


@dataclass(frozen=True, eq=False)
class FacetTraces:
    """Two ways to trace a bundle through triangles: with exact corners, with the corners a file stores."""

    about: str
    cell: Cell
    exact: Callable[[Rays], TraceResult]
    held: Callable[[Rays], TraceResult]


def attribute(
    design: Design,
    window: Window,
    facets: FacetTraces,
    rays: int = RAYS,
    aperture: float = 1.0,
    angle: float | None = None,
) -> Attribution | None:
    """Split the error of every ray of a bundle.

    design : Gives the field and its middle.
    facets : From `as_written` or `as_it_would_be_written`.
    aperture : Lit part of the cell, linear.
    angle : float or None, radians. Half angle of the cone; default the design's field.
    Returns Attribution, or None where no ray gets through every model.
    """
    spec = design.check
    cone = spec.field if angle is None else angle
    lit = _off_the_edges(window, bundle(window, rays, cone, spec.field_centre, aperture, cell=facets.cell))
    steps = _differences(window, facets, lit)
    if steps is None:
        return None
    whole, rms = steps[-1], _rms(steps[-1])
    parts = tuple(_part(name, vector, whole, rms) for name, vector in zip(NAMES, steps[:-1], strict=True))
    return Attribution(facets.about, parts, whole, rms, facets.cell, len(lit.rays), len(whole), str(lit))


def _differences(window: Window, facets: FacetTraces, lit: Bundle) -> tuple[Floats, ...] | None:
    """Direction that each model adds to a ray, (n, 3) each, then the whole; None if none gets through all."""
    truth = trace(window, lit.rays, path="size")
    chief, chief_known = _through_middle(window, lit)
    exact, held = facets.exact(lit.rays), facets.held(lit.rays)
    law = RequestedLaw.of(window).expected(lit)
    good = chief_known & np.isfinite(law).all(axis=1)
    for result in (truth, exact, held):
        good &= result.fate == Fate.ALIVE
        if result.order[0, 0] != NO_CELL:  # triangles of one telescopelet have no other order
            good &= (result.order == 0).all(axis=1)
    rounding = _rounding(window, lit, truth, np.flatnonzero(good))
    rows = np.flatnonzero(good)[np.isfinite(rounding).all(axis=1)]
    rounding = rounding[np.isfinite(rounding).all(axis=1)]
    if not len(rows):
        return None
    return (
        chief[rows] - law[rows],
        (truth.direction[rows] - chief[rows]) - rounding,
        rounding,
        exact.direction[rows] - truth.direction[rows],
        held.direction[rows] - exact.direction[rows],
        held.direction[rows] - law[rows],
    )


def _off_the_edges(window: Window, lit: Bundle) -> Bundle:
    aside = lit.aperture * np.array(ASIDE) * np.array(window.lattice.pitch)
    local = (1.0 - 2.0 * max(ASIDE)) * lit.points + aside
    return launched(window, local, lit.rays.direction, lit.cell, lit.middle, lit.field, lit.aperture)


def _part(name: str, vector: Floats, whole: Floats, rms: float) -> ErrorPart:
    share = float(np.mean((vector * whole).sum(axis=1))) / rms if rms > 0.0 else 0.0
    length = np.linalg.norm(vector, axis=1)
    return ErrorPart(name, vector, _rms(vector), float(np.median(length)), float(length.max()), share)


def _rms(vector: Floats) -> float:
    return float(np.sqrt(np.mean((vector**2).sum(axis=1))))


def _through_middle(window: Window, lit: Bundle) -> tuple[Floats, NDArray[np.bool_]]:
    """Exit directions (n, 3) of the bundle's directions through the middle of lens 1, and which of them
    exist.

    Traced through the faces without cell borders: a ray through the middle belongs to its telescopelet.
    """
    direction = lit.rays.direction / np.linalg.norm(lit.rays.direction, axis=1, keepdims=True)
    middle = np.broadcast_to(window.shifts[0], (len(direction), 2))
    result = trace_sequence(interfaces(window), rays_across(window, middle, direction))
    return result.direction, result.fate == Fate.ALIVE


def _rounding(window: Window, lit: Bundle, truth: TraceResult, rows: NDArray[np.intp]) -> Floats:
    from clacad.verification.accuracy.extended_precision import direction_differences

    return direction_differences(
        window,
        lit.rays.position[rows],
        lit.rays.direction[rows],
        truth.direction[rows],
        truth.cell[rows],
        truth.order[rows],
    )


def farthest_cell(window: Window) -> Cell:
    """Kept cell farthest from the middle of the sheet, where the coordinates in a file are largest."""
    lattice = window.lattice
    rows = sorted({0, lattice.count[1] - 1}) if lattice.outline is None else range(lattice.count[1])
    cells = np.concatenate([lattice.row(j) for j in rows])
    best = cells[int(np.argmax((lattice.centres(cells) ** 2).sum(axis=1)))]
    return int(best[0]), int(best[1])


def as_it_would_be_written(window: Window, quads: int = QUADS) -> FacetTraces:
    """Triangles as an STL in millimetres stores them, over the cell where rounding to 32 bits is coarsest."""
    cell = farthest_cell(window)
    place = np.array([*window.lattice.centres(np.array([cell], dtype=np.int64))[0], 0.0])
    held = CellFacets((cell,))
    for key, found in own_facets(window.with_cells((1, 1)), quads).facets.items():
        held.facets[key] = [single(corners + place, millimetres(window.unit)) for corners in found]
    return as_written(
        window, held, f"triangles as an STL would hold them: {quads} quads a cell side, 32-bit numbers"
    )


def single(corners: Floats, scale: float) -> Floats:
    """Corners rounded to 32 bits in a file's unit; `scale` is in file units per design unit."""
    return np.asarray((corners * scale).astype(np.float32).astype(np.float64) / scale)


def as_written(
    window: Window, gathered: CellFacets, name: str, present: Sequence[str] | None = None
) -> FacetTraces:
    """Triangles of a file over the farthest of the cells that were read.

    The "exact corners" are the corners of the file moved along z onto the design's own faces.
    """
    centres = window.lattice.centres(np.array(gathered.cells, dtype=np.int64))
    number = int(np.argmax((centres**2).sum(axis=1)))
    ideal = telescopelet(window, gathered, number, present, onto_design=True)
    held = telescopelet(window, gathered, number, present)
    return FacetTraces(
        name,
        gathered.cells[number],
        lambda rays: trace_facets(ideal, rays),
        lambda rays: trace_facets(held, rays),
    )


DIRECTIONS = 31
PLACES = 64
REACH = 1.6
"""Half width of the map over the half field of view; it includes the first ghosts on all sides."""


@dataclass(frozen=True, eq=False)
class GhostMap:
    """Shares of the light over two incident slopes, lens frame, [slope y, slope x].

    slope : ((k,), (k,)) incident slopes along lens x and lens y
    alive, ghost, closed_form : (k, k) shares
        Traced through the partner; traced through other lenslets; closed form of thin lenses for the partner.
    """

    slope: tuple[Floats, Floats]
    alive: Floats
    ghost: Floats
    closed_form: Floats

    @property
    def worst(self) -> float:
        """Largest difference between traced share and closed form."""
        return float(np.abs(self.alive - self.closed_form).max())

    def to_dict(self) -> dict[str, Any]:
        """Numbers for the report, shares to four digits: counts of few rays have no more."""
        return {
            "slope": [np.round(s, 6) for s in self.slope],
            "rays_a_direction": PLACES,
            "worst_difference": self.worst,
            "alive": np.round(self.alive, 4),
            "ghost": np.round(self.ghost, 4),
            "closed_form": np.round(self.closed_form, 4),
        }


def ghost_map(window: Window) -> GhostMap:
    """Trace a grid of directions about the middle of the field, each over a whole cell."""
    cells, turn = thin_cells(window), window.thin.rotation
    middle = cells.slopes(middle_direction(window)[None])[0]
    reach = [min(REACH * half, 1.5) for half in half_field(cells)]
    sx, sy = (middle[k] + np.linspace(-reach[k], reach[k], DIRECTIONS) for k in (0, 1))
    y, x = np.meshgrid(sy, sx, indexing="ij")
    local = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]) @ turn.T
    direction = local / np.linalg.norm(local, axis=1, keepdims=True)
    forward = direction[:, 2] > 0.05
    direction[~forward] = middle_direction(window)
    places = window.lattice.over_cell(sobol(PLACES, 2))
    lit = launched(
        window,
        np.tile(places, (len(direction), 1)),
        np.repeat(direction, PLACES, axis=0),
        central_cell(window),
        middle_direction(window),
    )
    fate = trace(window, lit.rays, path="size").fate.reshape(len(direction), PLACES)
    alive, ghost = ((fate == f).mean(axis=1) for f in (Fate.ALIVE, Fate.GHOST))
    closed = share(cells, direction)
    for values in (alive, ghost, closed):
        values[~forward] = 0.0
    shape = x.shape
    return GhostMap((sx, sy), alive.reshape(shape), ghost.reshape(shape), closed.reshape(shape))
