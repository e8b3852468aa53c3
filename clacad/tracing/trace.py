"""Tracing rays through windows, rung by rung, and through explicit sequences of surfaces.

`trace` is one signature over four rungs: the law itself, ideal lenslets with cells, the exact surfaces, the
facets of a mesh. `trace_sequence` is the primitive for surfaces given one by one.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from clacad.base.types import Rows, Rung
from clacad.optics.rays import Rays, TraceResult
from clacad.optics.sequence import Interface, trace_sequence
from clacad.sheet.window import Window
from clacad.tracing.layout import Layout, lay_out
from clacad.tracing.ledger import Ledger
from clacad.tracing.reference.law_rung import trace_law
from clacad.tracing.reference.surfaces import trace_surfaces
from clacad.tracing.reference.thin import trace_thin

if TYPE_CHECKING:
    from clacad.effects.engine.passes import Effect
    from clacad.mesh import Mesh
    from clacad.tracing.triangles.tiles import Normals, Tiles
    from clacad.tracing.triangles.triangle_soup import TriangleSoup

__all__ = ["Interface", "trace", "trace_sequence"]

SMALL_JOB = 3_000_000
"""Ray-surfaces below which numpy alone is faster than loading the compiled kernels."""


def worth_compiled(rays: int, faces: int) -> bool:
    """Whether so many rays through so many faces are traced by the compiled kernels if nothing else is asked for."""
    return rays * faces > SMALL_JOB


def trace(
    window: Window, rays: Rays, rung: Rung = "surfaces", effects: Sequence[str | Effect] = (), record: bool = False,
    mesh: Mesh | TriangleSoup | str | os.PathLike[str] | None = None, normals: Normals = "facet",
    threads: int | None = None, path: Literal["numpy", "numba"] | None = None,
    precision: Literal["float64", "float32"] = "float64",
) -> TraceResult:  # fmt: skip
    """Trace rays through a window.

    Parameters
    ----------
    window : Window
    rays : Rays
        Sheet frame, window units, in front of the sheet.
    rung : "law", "thin", "surfaces" or "mesh"
        Homogeneous sheet; ideal lenslets; exact Snell at the surfaces; Snell at the facets.
    effects : sequence of names or `clacad.effects.Effect`
        Physics added to the geometry; none costs nothing.
    record : bool
        Keep `hits` and `directions` at every face.
    mesh : Mesh, TriangleSoup or path
        For rung "mesh" only: the sheet's own, triangles from anywhere, or a file of them (STL, 3MF, PLY, OBJ, GLB).
    normals : "facet" or "vertex"
        Rung "mesh" only: the facets' own, or the exact ones at the vertices, interpolated.
    threads : int or None
        None: the environment variable CLACAD_THREADS, else every core.
    path : "numpy", "numba" or None
        Which implementation; None takes numpy for small jobs, where compiled kernels would cost more to load
        than they save.
    precision : "float64" or "float32"
        Rung "surfaces" without effects only: "float32" computes the straight path of the light in single
        precision, for pictures; directions are then good to about a microradian. Always compiled.

    Returns
    -------
    TraceResult
        Every ray in exactly one fate; only INVALID rows may hold NaN.

    Raises
    ------
    ValueError
        An unknown word, a precision or a mesh the rung does not have, a mesh missing or of other bodies, or a
        wavelength outside a material's data.
    """
    _refuse_words(rung, effects, mesh, normals, path, precision)
    if precision == "float32" and (rung != "surfaces" or effects or record or path == "numpy"):
        raise ValueError(
            'precision "float32" is for rung "surfaces", compiled, with no effects and no record'
        )
    if effects:
        from clacad.effects import trace_with  # passes over the blocks of a trace without them

        result: TraceResult = trace_with(
            window, rays, rung, effects, record, mesh=mesh, normals=normals, threads=threads, path=path
        )
        return result
    faces = {"law": 1, "thin": 2}.get(rung, 2 * len(window.bodies))
    recorded = faces if record else 0
    if rung == "mesh":
        return _through_mesh(window, rays, mesh, normals, recorded, threads)
    compiled = path == "numba" or (path is None and worth_compiled(len(rays), faces))
    if rung == "surfaces" and (compiled or precision == "float32"):
        return _compiled(lay_out(window), rays, recorded, threads, single=precision == "float32")
    return _by_numpy(lay_out(window), rays, rung, recorded)


def _by_numpy(layout: Layout, rays: Rays, rung: Rung, recorded: int) -> TraceResult:
    """Rungs law, thin and surfaces in numpy, hits kept at so many faces."""
    ledger = Ledger.opened(rays, recorded)
    rows = ledger.launchable()
    if rung == "law":
        trace_law(layout, ledger, rows)
    elif rung == "thin":
        trace_thin(layout, ledger, rows)
    else:
        for same, indices in colours(layout, rays, rows):
            trace_surfaces(layout, ledger, same, indices)
    return ledger.closed()


def _refuse_words(
    rung: object,
    effects: Sequence[str | Effect],
    mesh: object,
    normals: object,
    path: object,
    precision: object,
) -> None:
    """Refuse words that `trace` does not know, and a mesh or its normals where no facets are traced."""
    if rung not in ("law", "thin", "surfaces", "mesh"):
        raise ValueError(f'rung is {rung!r}, not "law", "thin", "surfaces" or "mesh"')
    if path not in (None, "numpy", "numba"):
        raise ValueError(f'path is {path!r}, not "numpy", "numba" or None')
    if precision not in ("float64", "float32"):
        raise ValueError(f'precision is {precision!r}, not "float64" or "float32"')
    if normals not in ("facet", "vertex"):
        raise ValueError(f'normals is {normals!r}, not "facet" or "vertex"')
    facets = any(effect == "facets" or getattr(effect, "rung", None) == "mesh" for effect in effects)
    if mesh is not None and rung != "mesh":
        raise ValueError(f'mesh= is for rung "mesh", not {rung!r}')
    if normals != "facet" and rung != "mesh" and not facets:
        raise ValueError(f'normals="vertex" is for rung "mesh", not {rung!r}')


def _through_mesh(
    window: Window,
    rays: Rays,
    mesh: Mesh | TriangleSoup | str | os.PathLike[str] | None,
    normals: Normals,
    recorded: int,
    threads: int | None,
) -> TraceResult:
    """Rung "mesh"."""
    from clacad.tracing.triangles.tiles import lay_out_mesh
    from clacad.tracing.triangles.triangle_soup import TriangleSoup, lay_out_soup, read_soup

    if mesh is None:
        raise ValueError('rung "mesh" needs mesh=')
    if isinstance(mesh, (str, os.PathLike)):
        mesh = read_soup(mesh, window)
    if isinstance(mesh, TriangleSoup):
        layout, tiles = lay_out_soup(window, mesh, normals)
        if mesh.search == "embree" and normals == "facet" and recorded == 0 and rays.wavelength is None:
            return _by_embree(layout, tiles, rays, threads)
    else:
        layout, tiles = lay_out_mesh(window, mesh, normals)
    return _compiled(layout, rays, recorded, threads, tiles)


def _by_embree(layout: Layout, tiles: Tiles, rays: Rays, threads: int | None) -> TraceResult:
    """Foreign triangles: what goes straight through by Embree, the rest by the own tree."""
    from clacad.tracing.triangles.embree import trace_straight

    result, decided = trace_straight(layout.window, layout, tiles, rays)
    rest = np.flatnonzero(~decided)
    if len(rest):
        own = _compiled(layout, Rays(rays.position[rest], rays.direction[rest]), 0, threads, tiles)
        for name in ("position", "direction", "fate", "optical_path", "cell", "order", "surface", "flux"):
            getattr(result, name)[rest] = getattr(own, name)
    return result


def _compiled(
    layout: Layout,
    rays: Rays,
    recorded: int,
    threads: int | None,
    tiles: Tiles | None = None,
    single: bool = False,
) -> TraceResult:
    """Exact surfaces, or the facets of `tiles`, by the compiled kernels."""
    from clacad.tracing.compiled.surfaces import thread_count, trace_compiled
    from clacad.tracing.triangles.tiles import NO_TILES

    count = thread_count(threads)
    facets = NO_TILES if tiles is None else tiles
    line = common_line(rays)
    if line is not False:  # the kernels write every row themselves
        ledger = Ledger.blank(len(rays), recorded)
        indices = tuple(body.index_at(line) for body in layout.window.bodies)
        trace_compiled(layout, rays, ledger, np.arange(len(rays)), indices, count, facets, single)
        return ledger.closed()
    ledger = Ledger.opened(rays, recorded)
    for rows, indices in colours(layout, rays, ledger.launchable()):
        trace_compiled(layout, rays, ledger, rows, indices, count, facets, single)
    return ledger.closed()


def common_line(rays: Rays) -> float | Literal[False] | None:
    """Wavelength of all the rays, None for the design's; False if they differ or if some are no wavelengths."""
    waves = rays.wavelength
    if waves is None:
        return None
    if len(waves) == 0 or not 0.0 < waves[0] < np.inf or bool((waves != waves[0]).any()):
        return False
    return float(waves[0])


def colours(layout: Layout, rays: Rays, rows: Rows) -> Iterator[tuple[Rows, tuple[float, ...]]]:
    """Rows (k,) of rays of one wavelength at a time, with the refractive index of each body there."""
    bodies = layout.window.bodies
    if rays.wavelength is None:
        yield rows, tuple(body.index for body in bodies)
        return
    each = rays.wavelength[rows]
    if len(each) and bool((each == each[0]).all()):  # pictures come line by line: nothing to sort
        yield rows, tuple(body.index_at(float(each[0])) for body in bodies)
        return
    waves, which = np.unique(each, return_inverse=True)
    order = np.argsort(which, kind="stable")
    bounds = np.searchsorted(which[order], np.arange(len(waves) + 1))
    for k, wave in enumerate(waves):
        chosen = rows[order[bounds[k] : bounds[k + 1]]]
        yield chosen, tuple(body.index_at(float(wave)) for body in bodies)
