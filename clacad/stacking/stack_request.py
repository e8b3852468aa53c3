"""Options of a stack: light, files and limits."""

from __future__ import annotations

from dataclasses import dataclass

from clacad.base.types import Pair2
from clacad.exporting.formats.indexed_meshes import GLB
from clacad.exporting.formats.step import WORD as STEP
from clacad.formats.step.step_mode import Mode

FORMATS = (STEP, GLB)
"""File formats of a stack; both support assemblies."""

QUADS = 8
"""Facets along a cell side of a GLB file, which is for viewing."""


@dataclass(frozen=True, eq=False)
class StackRequest:
    """Options of a stack.

    Parameters
    ----------
    gaps : tuple of float
        Clear distances between neighbours, in the unit of the first design; one for all, or one for each.
    formats : tuple of "step" and "glb"
    field : float or None, radians
        Slopes of the light reach to its tangent; None: check.field of the first design.
    zone : (width, height) or None
        Lit part of the first sheet, about its centre, in the unit of the first design; None: all of it, or
        one cell where all cells of all sheets act alike.
    object_distance : float or None
        Distance of the imaged point before array 1 of the first sheet, in the unit of the first design; None:
        its check.object, else ten times its separation.
    rays : int
    cells : (a, b) or None
        Number of cells of every sheet to write and measure.
    quads : int
        Facets along a cell side, of GLB.
    step : "auto", "fused" or "instanced"
    overwrite, force : bool
        Replace files of another origin; ignore the limits of size.
    mesh_light : bool
        Trace rung mesh too, with `quads` facets along a cell side.
    ids : tuple of str or None
        Names of the sheets; None: a, b, c, …
    """

    gaps: tuple[float, ...]
    formats: tuple[str, ...] = FORMATS
    field: float | None = None
    object_distance: float | None = None
    rays: int = 65536
    cells: tuple[int, int] | None = None
    quads: int = QUADS
    step: Mode = "auto"
    overwrite: bool = False
    force: bool = False
    mesh_light: bool = False
    ids: tuple[str, ...] | None = None
    zone: Pair2 | None = None
