"""Rays through sheets behind one another: each sheet's own trace, with empty space between.

Rays are passed on in the frame of the next sheet, moved along z alone, so a cell far from the axis is as
exact in the last sheet as in the first. The ideal rungs have no material: there a sheet acts between its lens
planes (`sheet.stack.lens_planes`), so the air between sheets is the real one on every rung. Rung "law" moves
light that enters at the first of these planes to the second, at equal x and y.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Rows, Rung
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.stack import BadStack, Stack, StackedSheet
from clacad.tracing.which_path import Path

if TYPE_CHECKING:
    from clacad.tracing.facets.triangle_soup import AnyMesh
    from clacad.tracing.trace import SheetTracer

ON = (Fate.ALIVE, Fate.GHOST, Fate.LAND)
"""Fates of light that leaves a sheet forwards, from the best to the worst."""


@dataclass(frozen=True, eq=False)
class StackTrace:
    """One row for each launched ray, in the order of launch.

    Attributes
    ----------
    position, direction : (n, 3) arrays
        As of `TraceResult`, in the frame and unit of the stack.
    fate : (n,) uint8 array of `Fate`
        ALIVE: alive through every sheet. GHOST or LAND: such in at least one sheet, and out of the last; LAND
        if both occurred. Any other fate is where the ray ended.
    ended : (n,) ints
        Number of the sheet that decided the fate; the last sheet for rays that passed all.
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
        number = np.bincount(self.fate, minlength=len(Fate))
        return {fate.name: int(number[fate]) for fate in Fate}


@dataclass(frozen=True, eq=False)
class StackTracer:
    """A stack laid out once, called with rays as often as needed.

    Parameters
    ----------
    stack : Stack
    rung : "law", "thin", "surfaces" or "mesh"
    mesh : sequence of meshes, int or None
        Rung "mesh" only: for each sheet the `mesh` argument of `clacad.trace`, or one number of quads for
        all.
    threads, path
        As in `clacad.trace`.

    Raises
    ------
    BadStack
        An ideal rung is requested and lens planes of neighbouring sheets overlap.
    ValueError
        As in `clacad.trace`.
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
    """
    return StackTracer(stack, rung, mesh, threads, path)(rays)
