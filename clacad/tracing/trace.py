"""Tracing rays through windows, rung by rung, and through explicit sequences of surfaces.

`trace` has one signature for four rungs: the law itself, ideal lenslets with cells, the exact surfaces, the
facets of a mesh. `trace_sequence` is the primitive for surfaces given one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from clacad.base.types import Rung
from clacad.optics.rays import OneRay, Rays, TraceResult
from clacad.optics.sequence import Interface, trace_sequence
from clacad.sheet.window import Window
from clacad.tracing.tracer import TracedEffect, Tracer
from clacad.tracing.which_path import Path

if TYPE_CHECKING:
    from clacad.tracing.triangles.ready_facets import AnyMesh
    from clacad.tracing.triangles.tiles import Normals

__all__ = ["Interface", "trace", "trace_sequence"]


def trace(
    window: Window,
    rays: Rays | OneRay,
    rung: Rung = "surfaces",
    effects: Sequence[str | TracedEffect] = (),
    record: bool = False,
    mesh: AnyMesh | int | None = None,
    normals: Normals = "facet",
    threads: int | None = None,
    path: Path | None = None,
    precision: Literal["float64", "float32"] = "float64",
    continuous: bool = False,
) -> TraceResult:
    """Trace rays through a window.

    Prepared data (packed arrays, triangles of a file) is cached on the window. Use `clacad.Tracer` to control
    its lifetime.

    Parameters
    ----------
    window : Window
    rays : Rays, or one ray as (origin, direction)
        Sheet frame, window units, in front of the sheet; ``((0, 0, -1), (0.01, 0, 1))`` is one ray.
    rung : "law", "thin", "surfaces" or "mesh"
        Homogeneous sheet; ideal lenslets; exact Snell at the surfaces; Snell at the facets.
    effects : sequence of names or `clacad.effects.Effect`
        Physics added to the geometry; an empty sequence costs nothing.
    record : bool
        Keep `hits` and `directions` at every face.
    mesh : Mesh, int, TriangleSoup, path or None
        For rung "mesh" only: the sheet's own mesh, its number of quads a cell side, triangles from any
        source, or a file of them (STL, 3MF, PLY, OBJ, GLB). None: the sheet's own mesh of 16 quads a cell
        side, as in scenes.
    normals : "facet" or "vertex"
        Rung "mesh" only: normals of the facets, or the exact normals at the vertices, interpolated.
    threads : int or None
        None: the environment variable CLACAD_THREADS, else every core.
    path : "numpy", "numba", "size" or None
        Which implementation runs. None chooses the faster one at this moment, compiled kernels wherever they
        are already loaded; rung "mesh" is then always compiled. "size" depends on the number of rays alone:
        the same bits in every process.
        Only numpy can trace rotated arrays and lenses at individual heights; it traces their exact surfaces
        for any `path`. Only the kernels can trace triangles that are not the sheet's own mesh, and meshes of
        non-uniform sheets.
    precision : "float64" or "float32"
        Rung "surfaces" without effects only: "float32" computes the straight path of the light in single
        precision, for pictures. Directions are then accurate to about a microradian. Always compiled.
    continuous : bool
        Rung "law" only, for a sheet whose law varies: use the law at the very point met instead of the law of
        the cell hit. The difference is the error due to the finite cell size.

    Returns
    -------
    TraceResult
        Every ray has exactly one fate; only INVALID rows may contain NaN. The implementation changes no fate
        and no cell, and directions by at most 1.4e-15.

    Raises
    ------
    TypeError
        A design in place of the window, or an argument that is not rays; the message names the function to
        call.
    ValueError
        An unknown word, a precision or a mesh that the rung does not have, a mesh of other bodies, a sheet
        that cannot be meshed, or a wavelength outside a material's data.
    """
    return Tracer(window, rung, effects, mesh, normals, threads, path, precision, continuous)(rays, record)
