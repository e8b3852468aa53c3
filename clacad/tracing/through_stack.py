"""Rays through sheets behind one another: each sheet's own trace, with empty space between.

Rays are passed on in the frame of the next sheet, moved along z alone, so a cell far from the axis is as
exact in the last sheet as in the first. The ideal rungs have no material: there a sheet acts between its lens
planes (`sheet.stack.lens_planes`), so the air between sheets is the real one on every rung. Rung "law" moves
light that enters at the first of these planes to the second, at equal x and y.

Rays for a stack: over cells of the first sheet and a square of slopes, or from a point before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import tan
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clacad.base.sobol import sobol
from clacad.base.types import Floats, Ints, Pair2, Rows, Rung
from clacad.optics.rays import Fate, Rays, TraceResult, fate_counts
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.stack import BadStack, Stack, StackedSheet
from clacad.sheet.vignetting import aperture_slopes
from clacad.tracing.which_path import Path

if TYPE_CHECKING:
    from clacad.tracing.facets.triangle_soup import AnyMesh
    from clacad.tracing.trace import SheetTracer

ON = (Fate.ALIVE, Fate.GHOST, Fate.LAND)
"""Fates of light that leaves a sheet forwards, from the best to the worst."""


@dataclass(frozen=True, eq=False)
class StackTrace:
    """One row for each launched ray, in the order of launch.

    position, direction : (n, 3) arrays. As of `TraceResult`, in the frame and unit of the stack.
    fate : (n,) uint8 array of `Fate`. ALIVE: alive through every sheet. GHOST or LAND: such in at least one
        sheet, and out of the last; LAND if both occurred. Any other fate is where the ray ended.
    ended : (n,) ints. Number of the sheet that decided the fate; the last sheet for rays that passed all.
    optical_path : (n,) array, lengths of the stack
    passed : tuple of (rows, TraceResult)
        For each sheet the launched rays (k,) that reached it, and their result in its own frame and unit.
    """

    position: Floats
    direction: Floats
    fate: NDArray[np.uint8]
    ended: NDArray[np.int32]
    optical_path: Floats
    passed: tuple[tuple[Rows, TraceResult], ...]

    def __len__(self) -> int:
        return len(self.fate)

    def __repr__(self) -> str:
        fates = ", ".join(f"{count} {name}" for name, count in self.counts().items() if count)
        return f"StackTrace({fates or 'no rays'})"

    def counts(self) -> dict[str, int]:
        """Number of rays of each fate, by name; every fate is listed and the numbers add up to n."""
        return fate_counts(self.fate)


@dataclass(frozen=True, eq=False)
class StackTracer:
    """A stack laid out once, called with rays as often as needed.

    rung : "law", "thin", "surfaces" or "mesh"
    mesh : sequence of meshes, int or None. Rung "mesh" only: for each sheet the `mesh` argument of
        `clacad.trace`, or one number of quads for all.
    threads, path : As in `clacad.trace`.
    Raises BadStack: An ideal rung is requested and lens planes of neighbouring sheets overlap.
    Raises ValueError: As in `clacad.trace`.
    """

    stack: Stack
    rung: Rung = "surfaces"
    mesh: Sequence[AnyMesh | int | None] | int | None = None
    threads: int | None = None
    path: Path | None = None
    tracers: tuple[SheetTracer, ...] = field(init=False, repr=False, default=())

    def __post_init__(self) -> None:
        """Lay out every sheet, identical sheets once."""
        from clacad.tracing.trace import SheetTracer

        sheets = self.stack.sheets
        if self.rung in ("law", "thin"):
            for before, after in zip(sheets, sheets[1:]):
                if after.lens_planes[0] < before.lens_planes[1]:
                    raise BadStack(
                        f"lens 1 of sheet {after.id} acts before lens 2 of sheet {before.id} does: rung"
                        f" {self.rung} cannot distinguish them; rung surfaces can, and so can a wider gap"
                    )
        meshes = [self.mesh] * len(sheets) if self.mesh is None or isinstance(self.mesh, int) else self.mesh
        made: dict[tuple[int, int], SheetTracer] = {}
        for one, mesh in zip(sheets, meshes, strict=True):
            key = (id(one.window), mesh if isinstance(mesh, int) else id(mesh))
            if key not in made:
                made[key] = SheetTracer(
                    one.window, self.rung, mesh=mesh, threads=self.threads, path=self.path
                )
            object.__setattr__(self, "tracers", (*self.tracers, made[key]))

    def __call__(self, rays: Rays) -> StackTrace:
        """Trace rays that start in front of the first sheet, in the frame and unit of the stack."""
        many = len(rays)
        found = StackTrace(
            rays.position.copy(),
            rays.direction.copy(),
            np.full(many, Fate.ALIVE, dtype=np.uint8),
            np.zeros(many, dtype=np.int32),
            np.zeros(many),
            (),
        )
        rows, passed = np.arange(many), []
        for number, (one, tracer) in enumerate(zip(self.stack.sheets, self.tracers, strict=True)):
            waves = None if rays.wavelength is None else rays.wavelength[rows]
            result = tracer(
                entering(one, self.rung, Rays(found.position[rows], found.direction[rows], waves))
            )
            passed.append((rows, result))
            rows = _taken_over(found, rows, result, number, one, self.rung)
        return replace(found, passed=tuple(passed))


def _taken_over(
    found: StackTrace, rows: Rows, result: TraceResult, number: int, one: StackedSheet, rung: Rung
) -> Rows:
    """Write the result of one sheet for rays (k,); return the rays that go on."""
    moved = result.fate != Fate.INVALID
    moved &= result.fate != Fate.MISSED  # as launched: they end where they left the previous sheet
    at = rows[moved]
    found.position[at] = leaving(one, rung, result.position[moved])
    found.direction[rows] = result.direction
    found.optical_path[at] += one.scale * result.optical_path[moved]
    found.ended[rows] = number
    before, here = found.fate[rows], result.fate
    on = np.isin(here, ON)
    found.fate[rows] = np.where(on, np.maximum(before, here), here)
    return rows[on]


def entering(one: StackedSheet, rung: Rung, rays: Rays) -> Rays:
    """Rays of the stack in the frame and unit of one of its sheets, before it."""
    level = one.lens_planes[0] if rung in ("law", "thin") else one.z
    position = (rays.position - [0.0, 0.0, level]) / one.scale
    return Rays(position, rays.direction, rays.wavelength)


def leaving(one: StackedSheet, rung: Rung, position: Floats) -> Floats:
    """Points (n, 3) of rays behind one of the sheets, in the frame and unit of the stack."""
    if rung not in ("law", "thin"):
        return np.asarray(position * one.scale + [0.0, 0.0, one.z])
    level = one.window.thin.offset[2] if rung == "thin" else 0.0
    return np.asarray((position - [0.0, 0.0, level]) * one.scale + [0.0, 0.0, one.lens_planes[1]])


def trace_stack(
    stack: Stack,
    rays: Rays,
    rung: Rung = "surfaces",
    mesh: Sequence[AnyMesh | int | None] | int | None = None,
    threads: int | None = None,
    path: Path | None = None,
) -> StackTrace:
    """Trace rays through all sheets of a stack, one after the other.

    Parameters
    ----------
    stack : Stack
    rays : Rays
        In front of the first sheet, frame and unit of the stack.
    rung, mesh, threads, path
        As in `StackTracer`.

    Raises
    ------
    BadStack, ValueError
        As in `StackTracer`.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> pair = clacad.stack([design, design], gaps=1.0, rays=256).stack
    >>> rays = clacad.Rays((0, 0, -1), [[0, 0, 1]])
    >>> clacad.trace_stack(pair, rays)
    StackTrace(1 ALIVE)
    """
    return StackTracer(stack, rung, mesh, threads, path)(rays)


def lit_cells(stack: Stack, zone: Pair2 | None = None) -> Ints:
    """Cells (n, 2) of the first sheet that are lit.

    zone : (width, height) or None, lengths of the stack. Cells whose centres lie in it, about the centre of
        the sheet. None: every cell, or only the central one where all sheets are uniform and have one
        lattice, since it then represents every cell away from the edges.
    Raises BadStack: No cell lies in the zone.
    """
    first = stack.sheets[0]
    if zone is None and _alike(stack):
        return np.array([central_cell(first.window)])
    cells = first.window.lattice.cells()
    if zone is None:
        return cells
    away = np.abs(first.scale * first.window.centres(0, cells))
    kept = cells[(away <= 0.5 * np.asarray(zone)).all(axis=1)]
    if not len(kept):
        low, high = first.scale * np.asarray(first.window.lattice.pitch)
        raise BadStack(
            f"zone {zone[0]:g} x {zone[1]:g}: no cell of the first sheet has its centre in it; "
            f"a zone of {2.0 * low:g} x {2.0 * high:g} holds some"
        )
    return kept


def _alike(stack: Stack) -> bool:
    """Whether one cell of the first sheet represents all: all sheets are uniform and have one lattice."""
    first = stack.sheets[0].window.lattice
    return all(
        one.window.uniform
        and one.window.lattice.kind == first.kind
        and np.allclose(one.scale * np.asarray(one.window.lattice.pitch), first.pitch, rtol=1e-9, atol=0.0)
        for one in stack.sheets
    )


def launch(stack: Stack, points: Floats, field: float, cells: Ints) -> tuple[Floats, Floats]:
    """Places (n, 2) on the first lens plane and slopes (n, 2), from points (n, 5) of the unit cube; lengths
    of the stack.

    Light fills each of the cells (m, 2), and a square of slopes about the centre of the field of each.
    """
    first = stack.sheets[0]
    window = first.window
    chosen = cells_of(points, cells)
    slope = aperture_slopes(window, chosen) + (2.0 * points[:, 2:4] - 1.0) * tan(field)
    return first.scale * (window.lattice.over_cell(points[:, :2]) + window.centres(0, chosen)), slope


def cells_of(points: Floats, cells: Ints) -> Ints:
    """Cell (n, 2) that each of the points (n, 5) of the unit cube enters."""
    return cells[(points[:, 4] * len(cells)).astype(np.int64)]


def launched(stack: Stack, rays: int, field: float) -> Rays:
    """Rays over the first sheet's central cell and a square of slopes, from before it; stack's lengths."""
    middle = np.array([central_cell(stack.sheets[0].window)])
    return started(stack, *launch(stack, sobol(rays, 5), field, middle))


def started(stack: Stack, place: Floats, slope: Floats) -> Rays:
    """Rays that cross the first lens plane at places (n, 2) with slopes (n, 2), from before the material."""
    first = stack.sheets[0]
    level = first.lens_planes[0]
    back = level - first.span[0] + first.scale * max(first.window.lattice.pitch)
    start = np.column_stack([place - back * slope, np.full(len(place), level - back)])
    return Rays(start, np.column_stack([slope, np.ones(len(place))]))


def middle_of_light(stack: Stack) -> Floats:
    """Centre (2,) of the central cell of the first sheet, lengths of the stack."""
    first = stack.sheets[0]
    return np.asarray(first.scale * first.window.centres(0, np.array(central_cell(first.window))))


def cone(stack: Stack, points: Floats, field: float, distance: float) -> tuple[Floats, Floats]:
    """Places and slopes (n, 2) on the first lens plane of axial light, within field and lattice."""
    window = stack.sheets[0].window
    where = middle_of_light(stack)
    x0, x1, y0, y1 = window.lattice.extent()
    room = np.array([min(x1 - where[0], where[0] - x0), min(y1 - where[1], where[1] - y0)])
    reach = np.minimum(distance * tan(field), np.maximum(room, 0.0))
    place = (2.0 * points - 1.0) * reach
    return place + where, place / distance
