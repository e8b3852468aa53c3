"""What is asked of a stack."""

from __future__ import annotations

from dataclasses import dataclass

from clacad.base.types import Pair2
from clacad.formats.step.step_mode import Mode

FORMATS = ("step", "glb")
"""What a stack is written as: formats that know assemblies."""

QUADS = 8
"""Facets along a cell side of a GLB file, which is for looking at."""


@dataclass(frozen=True, eq=False)
class StackRequest:
    """What is asked of a stack.

    Parameters
    ----------
    gaps : tuple of float
        Clear distances between neighbours, in the unit of the first design; one for all, or one for each.
    formats : tuple of "step" and "glb"
    field : float or None, radians
        Slopes of the light reach to its tangent; None: check.field of the first design.
    zone : (width, height) or None
        Part of the first sheet that light is sent over, about its middle, in the unit of the first design; None: all of
        it, or one cell where all cells of all sheets do alike.
    object_distance : float or None
        Of the point that is imaged, before array 1 of the first sheet, in the unit of the first design; None: its
        check.object, else ten times its separation.
    rays : int
    cells : (a, b) or None
        Write and measure so many cells of every sheet.
    quads : int
        Facets along a cell side, of GLB.
    step : "auto", "fused" or "instanced"
    overwrite, force : bool
        Replace files of another origin; pass the limits of size.
    mesh_light : bool
        Trace rung mesh, too, of so many `quads`.
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
