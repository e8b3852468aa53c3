"""Floors of file formats: the facet size below which rounding of a file's numbers dominates.

Facets with 1/m of the cell side have an error of a/m radians. Rounding their corners to a file's numbers
turns each by about b·m. The quadrature sum is least at m* = sqrt(a/b), where it is sqrt(2 a b): the floor of
the format. Interpolated exact normals at the corners have an error of a/m² and are almost unaffected by
rounding of the corners. Every constant is measured by traces, and the optimum (or the finest grid worth
tracing) is traced itself.

Effect of a file's number format on a mesh: rounding of its vertices.

The mesher computes heights as whole steps of the float32 spacing at the sheet's greatest height, so that all
formats hold one mesh; a file in double precision keeps exactly these. Float32 files round again, in the
file's unit: in the coordinates of the whole sheet, or of one repeated cell. Height maps have an exact grid
and store a height above the face's own plane, as float32 or in 16 bits.
"""

from __future__ import annotations

from copy import copy
from dataclasses import asdict, dataclass, field, replace
from math import hypot, isfinite, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.base.units import millimetres
from clacad.exporting.formats.registry import formats
from clacad.exporting.roles import WAYS, Holding, Storing
from clacad.light.compare import rms_between
from clacad.mesh.body_mesh import BodyMesh
from clacad.mesh.prototile import Prototile
from clacad.optics.law import angle_between
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.window import Body, Window, lens_height

if TYPE_CHECKING:
    from clacad.mesh import Mesh

FINER = 1 << 20
"""Subdivisions of the mesher's step in which stored heights are counted: far below any rounding of a file."""

KNOWN = 1 << 59
"""Levels of at least this magnitude represent a missing face."""


EXACT = Holding(kind="exact")


def rounded(mesh: Mesh, cell: tuple[int, int], holding: Holding) -> Mesh:
    """Round the vertices of a mesh as a file in millimetres does, for one cell.

    cell : (i, j). Rounding of sheet coordinates depends on the position of a cell in the sheet.
    """
    window = mesh.window
    bodies = [_held(window, *pair, cell, holding) for pair in zip(window.bodies, mesh.bodies, strict=True)]
    return replace(mesh, bodies=tuple(bodies))


def _held(window: Window, body: Body, part: BodyMesh, cell: tuple[int, int], holding: Holding) -> BodyMesh:
    """Mesh of one body as stored in a file."""
    tiled = []
    for one in part.tiled:
        tile = one.maker.tile
        scale = millimetres(window.unit)
        xy = tile.plan.xy
        if holding.kind == "f32" and holding.origin != "face":
            zero = window.lattice.centres(np.array(cell))[None] + np.asarray(one.shift)
            zero = zero if holding.origin == "sheet" else np.zeros((1, 2))
            xy = _single((xy + zero) * scale) / scale - zero
        made = _finer(tile)
        lens = np.column_stack([_levels(made, body, side, scale, holding) for side in (0, 1)])
        maker = copy(one.maker)  # a trace reads its tile only; the templates stay those of the mesh
        maker.tile = replace(made, plan=replace(tile.plan, xy=xy), lens=lens)
        tiled.append(replace(one, maker=maker))
    return replace(part, tiled=tuple(tiled))


def _finer(tile: Prototile) -> Prototile:
    """Copy of a tile with smaller steps."""
    front, back = (flat * FINER if abs(flat) < KNOWN else flat for flat in tile.land)
    lifted = None if tile.lifted is None else _times(tile.lifted)
    return replace(tile, step=tile.step / FINER, lens=_times(tile.lens), land=(front, back), lifted=lifted)


def _times(levels: Ints) -> Ints:
    known = np.abs(levels) < KNOWN
    return np.where(known, np.where(known, levels, 0) * FINER, levels)


def _levels(tile: Prototile, body: Body, side: int, scale: float, holding: Holding) -> Ints:
    """Levels (n,) of one face as stored in a file."""
    levels, face = tile.lens[:, side].copy(), (body.front, body.back)[side]
    known = np.abs(levels) < KNOWN
    height: Floats = np.asarray(levels[known] * tile.step, dtype=np.float64)
    if (
        holding.kind == "exact" or holding.origin == "face"
    ):  # a map is computed from the surface, not from a mesh
        height = _exact(height, FINER * tile.step, body, side, tile.plan.xy[known])
    if holding.kind in ("f32", "levels"):
        zero = face.vertex[2] if holding.origin == "face" else 0.0
        height = np.asarray(_rounded((height - zero) * scale, holding) / scale + zero)
    levels[known] = np.rint(height / tile.step).astype(np.int64)
    return levels


def _exact(height: Floats, step: float, body: Body, side: int, xy: Floats) -> Floats:
    """Heights of the surface where the mesher only rounded to its step."""
    face = (body.front, body.back)[side]
    if face.array is None:
        return height
    surface = lens_height(face, xy[:, 0], xy[:, 1])
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(surface - height) <= step, surface, height)


def _rounded(heights: Floats, holding: Holding) -> Floats:
    if holding.kind == "f32" or len(heights) == 0:
        return _single(heights)
    low, step = float(heights.min()), float(np.ptp(heights)) / holding.levels or 1.0
    return np.asarray(low + step * np.rint((heights - low) / step))


def _single(values: NDArray[np.floating]) -> Floats:
    return values.astype(np.float32).astype(np.float64)


RAYS = 4096
SMALL = 64
"""Grid on which rounding is measured: fine enough to measure it, and few rays change facets by it."""
CONFIRM = 128
"""Finest grid, in quads per cell side, traced to confirm a forecast; finer ones would take minutes."""
RAYLEIGH = 1.2011
"""Rms over median of the length of a vector with two normal components."""
NORMAL_F32 = 3e-8
"""Rms rounding of a unit normal's component in float32, radians."""


@dataclass(frozen=True, slots=True)
class Family:
    """Formats that store a part in one way.

    formats : Words for `--format`; those for which it is the first way come first.
    holding : None: the surfaces themselves, or nothing optical.
    normals : "facet", "vertex" or "". Normals at which a reader refracts.
    """

    formats: str
    holding: Holding | None
    normals: str = "facet"
    note: str = ""


def _family(way: Storing) -> Family:
    users = sorted((one for one in formats() if way in one.stored), key=lambda one: one.stored.index(way))
    return Family(", ".join(one.word for one in users), way.holding, way.normals, way.note)


FAMILIES = tuple(map(_family, dict.fromkeys([*WAYS, *(way for one in formats() for way in one.stored)])))


@dataclass(frozen=True, slots=True)
class Floor:
    """Least error of a family of formats.

    a, b : float, radians. Error of facets a/m (vertex normals: a/m²), and of rounding b·m (vertex normals:
        b), at m quads per cell side.
    best_quads : float or None. Grid of the least error; None: finer is always better.
    best_size : float or None, design lengths. Facet side on that grid.
    floor : float, radians
    facets : float or None. Optical facets of the whole sheet on that grid.
    confirmed : tuple of (quads, forecast, traced), radians
    """

    formats: str
    normals: str
    float: str
    note: str
    a: Any = None
    b: Any = None
    best_quads: Any = None
    best_size: Any = None
    floor: Any = None
    facets: Any = None
    confirmed: tuple[tuple[int, Any, Any], ...] = field(default=())

    def error(self, quads: Any) -> Any:
        """Forecast rms direction error (radians) at `quads` per cell side."""
        if self.normals == "vertex":
            return hypot(self.a / quads**2, self.b)
        return hypot(self.a / quads, self.b * quads)

    def quads_for(self, target: Any) -> int | None:
        """Fewest quads per cell side within `target` radians; None below the floor."""
        if self.floor is None or not target > self.floor:
            return None
        if self.normals == "vertex":
            return max(1, int(np.ceil(sqrt(self.a / sqrt(target**2 - self.b**2)))))
        ab = self.a * self.b
        inside = sqrt(max(0.0, (target**2 - 2.0 * ab) * (target**2 + 2.0 * ab)))
        return max(1, int(np.ceil(sqrt(2.0 / (target**2 + inside)) * self.a)))

    def to_dict(self) -> dict[str, Any]:
        """JSON-able form."""
        return asdict(self) | {
            "confirmed": [{"quads": q, "forecast": f, "traced": t} for q, f, t in self.confirmed]
        }


class Probe:
    """Traces of one bundle through meshes stored in several ways, each mesh built once.

    truth : The same rays through the exact surfaces.
    """

    def __init__(self, window: Window, rays: Rays, truth: TraceResult) -> None:
        self.window, self.rays = window, rays
        self.truth = truth
        self.cell = representative_cells(window, "rounding")[0]
        self._meshes: dict[int, Mesh] = {}

    def held(self, quads: int, holding: Holding, normals: str) -> TraceResult:
        """Trace the mesh with `quads` per cell side as a file stores it."""
        from clacad.mesh import tessellate
        from clacad.tracing.trace import trace

        if quads not in self._meshes:
            self._meshes[quads] = tessellate(self.window, quads=quads)
        mesh = rounded(self._meshes[quads], self.cell, holding)
        return trace(
            self.window,
            self.rays,
            rung="mesh",
            mesh=mesh,
            normals="vertex" if normals == "vertex" else "facet",
            path="size",
        )

    def error(self, found: TraceResult) -> float:
        """Rms angle (radians) to the exact trace, over the rays ALIVE in both through the same lenslets."""
        return rms_between(found.direction, self.truth.direction, self._shared(found, self.truth))

    def moved(self, found: TraceResult, exact: TraceResult) -> float:
        """Rms angle (radians) between two traces, by the median: rays that change facets do not matter."""
        both = self._shared(found, exact)
        if not both.any():
            return float("nan")
        return RAYLEIGH * float(np.median(angle_between(found.direction[both], exact.direction[both])))

    @staticmethod
    def _shared(one: TraceResult, other: TraceResult) -> NDArray[np.bool_]:
        same = (one.cell == other.cell).all(axis=1) & (one.order == other.order).all(axis=1)
        return np.asarray(same & (one.fate == Fate.ALIVE) & (other.fate == Fate.ALIVE))


def probe(window: Window, rays: Rays, truth: TraceResult) -> Probe:
    """Probe with the first `RAYS` rays of a traced bundle."""
    few = Rays(rays.position[:RAYS], rays.direction[:RAYS])
    return Probe(window, few, truth.rows(slice(RAYS)))


def floors(seen: Probe, confirm: bool = True) -> list[Floor]:
    """Floor of every family of formats.

    confirm : Whether the forecasts are traced too.
    """
    finest = CONFIRM if confirm else SMALL
    smooth = {
        "facet": seen.error(seen.held(finest, EXACT, "facet")) * finest,
        "vertex": seen.error(seen.held(SMALL, EXACT, "vertex")) * SMALL**2,
    }
    return [family_floor(seen, family, smooth, confirm) for family in FAMILIES]


def family_floor(seen: Probe, family: Family, smooth: dict[str, float], confirm: bool) -> Floor:
    """Floor of one family; `smooth` holds the error constants of facets and of vertex normals."""
    holding = family.holding
    if holding is None:
        return Floor(family.formats, "", "", family.note)
    a = smooth[family.normals]
    moved = seen.moved(seen.held(SMALL, holding, family.normals), seen.held(SMALL, EXACT, family.normals))
    plain = Floor(family.formats, family.normals, holding.kind, family.note, a, moved / SMALL)
    if family.normals == "vertex":
        coarse = 0.0 if holding.kind == "f64" else 2.0 * NORMAL_F32
        return _with_confirmation(seen, family, _vertex_floor(plain, hypot(moved, coarse)), confirm)
    if not (isfinite(a) and plain.b > 0.0):
        return plain
    best = sqrt(a / plain.b)
    size = min(seen.window.lattice.pitch) / best
    found = Floor(
        family.formats,
        family.normals,
        holding.kind,
        family.note,
        a,
        plain.b,
        best,
        size,
        sqrt(2.0 * a * plain.b),
        _facets(seen.window, best),
    )
    return _with_confirmation(seen, family, found, confirm)


def _vertex_floor(plain: Floor, b: float) -> Floor:
    return Floor(plain.formats, plain.normals, plain.float, plain.note, plain.a, b, None, None, b)


def _with_confirmation(seen: Probe, family: Family, found: Floor, confirm: bool) -> Floor:
    if not confirm or family.holding is None:
        return found
    if found.best_quads is None:  # vertex normals are exact in a trace: only for formats that store them so
        grids = [SMALL] if family.holding.kind == "f64" else []
    else:
        best = max(1, round(found.best_quads))
        grids = [q for q in (best, 2 * best) if q <= CONFIRM] or [CONFIRM]
    rows = tuple((q, found.error(q), seen.error(seen.held(q, family.holding, family.normals))) for q in grids)
    return replace(found, confirmed=rows)


def _facets(window: Window, quads: float) -> float:
    """Facets of the optical faces of the whole sheet."""
    from clacad.sheet.grid_steps import lens_squares

    return 2.0 * lens_squares(window, quads) * window.lattice.cell_count
