"""Tracing rays through windows, rung by rung, and through explicit sequences of surfaces.

`trace` is one signature over four rungs: the law itself, ideal lenslets with cells, the exact surfaces, the
facets of a mesh. `trace_sequence` is the primitive for surfaces given one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from clacad.base.types import Rung
from clacad.optics.rays import OneRay, Rays, TraceResult
from clacad.optics.sequence import Interface, trace_sequence
from clacad.sheet.window import Window
from clacad.tracing.effect_protocol import TracedEffect
from clacad.tracing.tracer import Tracer
from clacad.tracing.which_path import Path

if TYPE_CHECKING:
    from clacad.tracing.triangles.ready_facets import AnyMesh
    from clacad.tracing.triangles.tiles import Normals

__all__ = ["Interface", "trace", "trace_sequence"]


def trace(
    window: Window, rays: Rays | OneRay, rung: Rung = "surfaces", effects: Sequence[str | TracedEffect] = (), record: bool = False,
    mesh: AnyMesh | int | None = None, normals: Normals = "facet", threads: int | None = None, path: Path | None = None,
    precision: Literal["float64", "float32"] = "float64", continuous: bool = False,
) -> TraceResult:  # fmt: skip
    """Trace rays through a window.

    What is laid out for it, a file's triangles among that, is kept as long as the window; `clacad.Tracer` holds it in
    its own hands.

    Parameters
    ----------
    window : Window
    rays : Rays, or one ray as (origin, direction)
        Sheet frame, window units, in front of the sheet; ``((0, 0, -1), (0.01, 0, 1))`` is one ray.
    rung : "law", "thin", "surfaces" or "mesh"
        Homogeneous sheet; ideal lenslets; exact Snell at the surfaces; Snell at the facets.
    effects : sequence of names or `clacad.effects.Effect`
        Physics added to the geometry; none costs nothing.
    record : bool
        Keep `hits` and `directions` at every face.
    mesh : Mesh, int, TriangleSoup, path or None
        For rung "mesh" only: the sheet's own, so many quads a cell side of it, triangles from anywhere, or a file of
        them (STL, 3MF, PLY, OBJ, GLB). None: the sheet's own of 16 quads a cell side, as scenes have it.
    normals : "facet" or "vertex"
        Rung "mesh" only: the facets' own, or the exact ones at the vertices, interpolated.
    threads : int or None
        None: the environment variable CLACAD_THREADS, else every core.
    path : "numpy", "numba", "size" or None
        Which implementation; None takes what is done first here and now, compiled kernels wherever they are loaded
        already; rung "mesh" is then always compiled. "size" goes by the number of rays alone: the same bits in every
        process. Arrays that are turned and lenses at heights of their own are known to numpy alone, which traces their
        exact surfaces whatever is asked; triangles that are not the sheet's own mesh, and those of cells that differ, to
        the kernels alone.
    precision : "float64" or "float32"
        Rung "surfaces" without effects only: "float32" computes the straight path of the light in single
        precision, for pictures; directions are then good to about a microradian. Always compiled.
    continuous : bool
        Rung "law" only, of a sheet whose law varies: by the law at the very point met instead of that of the cell hit.
        Their difference is what cells of a finite size cost.

    Returns
    -------
    TraceResult
        Every ray in exactly one fate; only INVALID rows may hold NaN. The implementation changes no fate and no cell,
        and directions by 1.4e-15 at most.

    Raises
    ------
    TypeError
        A design in place of the window, or rays that are none; the message says what to call.
    ValueError
        An unknown word, a precision or a mesh the rung does not have, a mesh of other bodies, a sheet that cannot be
        meshed, or a wavelength outside a material's data.
    """
    return Tracer(window, rung, effects, mesh, normals, threads, path, precision, continuous)(rays, record)
