"""Rays through a window on one of four rungs: the law, ideal lenslets, the exact surfaces, facets of a mesh.

A `SheetTracer` is a window prepared for rays: its data is laid out once for all calls. Effects are added in
`clacad.effects`, where the public `trace` and `Tracer` are. The implementation changes no fate and no cell,
and directions by at most 1.4e-15. A call with `path` "numpy", "numba" or "size" gives the same bits in every
process; files that the package writes are traced so. Without a `path`, `which_path` decides when kernels are
loaded. `trace_sequence` is the primitive for surfaces given one by one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clacad.base.types import Rows, Rung
from clacad.optics.ledger import Ledger
from clacad.optics.rays import OneRay, Rays, TraceResult, as_rays
from clacad.sheet.face_order import media_of
from clacad.sheet.need_window import need_equal_cells, need_window
from clacad.sheet.window import Window
from clacad.tracing.facets.tiles import Tiles
from clacad.tracing.layout import Layout, colours, lay_out
from clacad.tracing.reference.launch import trace_law
from clacad.tracing.which_path import (
    IDEAL_FACES,
    LOADED,
    Path,
    compiled_suits,
    has_kernel,
    kernels_of,
    measuring,
    worth_compiled,
)

if TYPE_CHECKING:
    from clacad.light.sums import LightSums
    from clacad.optics.law import Law
    from clacad.tracing.facets.squares import Triangles
    from clacad.tracing.facets.tiles import Normals
    from clacad.tracing.facets.triangle_soup import AnyMesh, Facets

Precision = Literal["float64", "float32"]

PIECE = 1 << 16
"""Rays that are traced in several lines at once: their rows are few enough to be used again."""

ONLY_BARE = 'precision "float32" is for rung "surfaces", compiled, with no effects and no record'
"""Message for single precision requested elsewhere."""


@dataclass(frozen=True, eq=False)
class SheetTracer:
    """One window and rung without effects, laid out once, called with rays as often as needed.

    Parameters and errors are those of `clacad.Tracer`, which adds effects.
    """

    window: Window
    rung: Rung = "surfaces"
    mesh: AnyMesh | int | Facets | None = None
    normals: Normals = "facet"
    threads: int | None = None
    path: Path | None = None
    precision: Precision = "float64"
    continuous: bool = False
    facets: Facets | None = field(init=False, repr=False, default=None)

    def __post_init__(self) -> None:
        """Reject what cannot be traced, and lay out."""
        need_window(self.window, "trace", ", rays")
        self._refuse_words()
        if self.precision == "float32" or (
            self.path == "numba" and self.rung == "thin" and not has_kernel(self.rung, self.window)
        ):
            need_equal_cells(self.window, "this compiled tracer", 'path "numpy" or "size" traces it')
        if self.rung == "mesh":
            from clacad.tracing.facets.triangle_soup import OWN_QUADS, facets_of

            mesh = OWN_QUADS if self.mesh is None else self.mesh
            object.__setattr__(self, "facets", facets_of(self.window, mesh, self.normals))
        else:
            lay_out(self.window)

    def __getstate__(self) -> dict[str, Any]:
        """State without the mesh: the data laid out from it is kept."""
        return {**self.__dict__, "mesh": None}

    def __call__(self, rays: Rays | OneRay, record: bool = False) -> TraceResult:
        """Trace rays; see `clacad.trace`."""
        rays = as_rays(rays)
        if self.precision == "float32" and record:
            raise ValueError('precision "float32" keeps no record')
        ideal = {"law": 1, "thin": 2}.get(self.rung)
        faces = 2 * len(self.window.bodies) if ideal is None else IDEAL_FACES
        recorded = (ideal or faces) if record else 0
        if self.facets is not None and not (self.window.uniform or isinstance(self.facets.found_in, Tiles)):
            from clacad.tracing.facets.own_sheet import told

            layout, found_in = self.facets.layout, self.facets.found_in
            found = _compiled(layout, rays, faces, self.threads, found_in)
            return told(self.window, layout.bodies, rays, found, record)
        if self.facets is not None:
            if self._tiles_in_numpy(len(rays), faces):
                return _by_numpy(self.facets.layout, rays, "surfaces", recorded)
            return _compiled(self.facets.layout, rays, recorded, self.threads, self.facets.found_in)
        layout, single = lay_out(self.window), self.precision == "float32"
        path: Path | None = "numpy" if self.continuous else self.path
        if single or compiled_suits(self.rung, path, len(rays), faces, layout):
            if self.rung == "surfaces":
                return _compiled(layout, rays, recorded, self.threads, single=single)
            if not record:
                return _ideal(layout, rays, self.rung, self.threads)
        with measuring(self.rung, layout, len(rays), faces):
            return _by_numpy(layout, rays, self.rung, recorded, self.continuous)

    def in_lines(self, rays: Rays, waves: Sequence[float]) -> Iterator[tuple[TraceResult, ...]]:
        """The same rays in several lines of light (metres), piece by piece: one result a line.

        Exact surfaces, compiled in double precision, compute what no colour changes once for all lines.
        """
        media = [media_of(self.window.bodies, wave) for wave in waves]
        alike = self.rung == "surfaces" and len({first for first, *_ in media}) == 1
        alike &= self.precision == "float64"
        compiled = alike and self._chosen(len(rays) * len(waves)) == "numba"
        piece = PIECE if compiled else max(1, len(rays))
        for first in range(0, len(rays), piece):
            part = slice(first, first + piece)
            one = Rays(rays.position[part], rays.direction[part])
            if compiled:
                yield self._lines_compiled(one, media)
            else:
                yield tuple(self(Rays(one.position, one.direction, wave)) for wave in waves)

    def _lines_compiled(self, rays: Rays, media: Sequence[Sequence[float]]) -> tuple[TraceResult, ...]:
        """Rays in several lines by one pass of the kernel, which writes the lines one after another."""
        from clacad.tracing.compiled.chunk import trace_compiled
        from clacad.tracing.compiled.threads import thread_count

        n, layout = len(rays), lay_out(self.window)
        ledger = Ledger.blank(n * len(media), 0)
        trace_compiled(layout, rays, ledger, np.arange(n), np.concatenate(media), thread_count(self.threads))
        found = ledger.closed()
        return tuple(found.rows(slice(k * n, (k + 1) * n)) for k in range(len(media)))

    def sums(self, rays: Rays, law: Law | None = None) -> LightSums:
        """Trace rays and return sums without rows; see `clacad.Tracer.sums`."""
        from clacad.light.sums import summed

        if self.window.cell_laws is not None and law is None:
            need_equal_cells(self.window, "a sum of angles to one law", "give the law")
        law = self.window.law if law is None else law
        path, piecewise = self._chosen(len(rays)), copy(self)
        for name, value in (("path", path), ("threads", 1)):
            object.__setattr__(piecewise, name, value)
        if path == "numpy":
            return summed(piecewise, rays, law, None, 1)
        from clacad.light.compiled_sums import add_rays
        from clacad.tracing.compiled.threads import thread_count

        return summed(piecewise, rays, law, add_rays, thread_count(self.threads))

    def _chosen(self, rays: int) -> Path:
        """Path for a number of rays, regardless of the pieces they are traced in."""
        if self.facets is not None or self.precision == "float32":
            few = self._tiles_in_numpy(rays, 2 * len(self.window.bodies))
            return "numpy" if few else "numba"
        if self.continuous:
            return "numpy"
        faces = 2 * len(self.window.bodies) if self.rung == "surfaces" else IDEAL_FACES
        return "numba" if compiled_suits(self.rung, self.path, rays, faces, lay_out(self.window)) else "numpy"

    def _tiles_in_numpy(self, rays: int, faces: int) -> bool:
        """Whether numpy traces a number of rays through a sheet's own mesh: if requested, or if few."""
        if self.facets is None or not isinstance(self.facets.found_in, Tiles) or not self.window.uniform:
            return False
        return self.path == "numpy" or (self.path == "size" and not worth_compiled(rays, faces))

    def _refuse_words(self) -> None:
        """Reject unknown words, and a mesh or its normals where no facets are traced."""
        known: dict[str, tuple[object, ...]] = {
            "rung": ("law", "thin", "surfaces", "mesh"),
            "path": ("numpy", "numba", "size", None),
            "precision": ("float64", "float32"),
            "normals": ("facet", "vertex"),
        }
        for name, words in known.items():
            value = getattr(self, name)
            if value not in words:
                *most, last = (f'"{word}"' if word else "None" for word in words)
                raise ValueError(f"{name} is {value!r}, not {', '.join(most)} or {last}")
        if self.continuous and self.rung != "law":
            raise ValueError(f'continuous=True is for rung "law", not {self.rung!r}')
        if self.continuous and self.window.cell_laws is not None and self.window.cell_laws.smooth is None:
            raise ValueError(
                "continuous=True: the law of this sheet is a table's, which has no values between its cells"
            )
        if self.mesh is not None and self.rung != "mesh":
            raise ValueError(f'mesh= is for rung "mesh", not {self.rung!r}')
        if self.normals != "facet" and self.rung != "mesh":
            raise ValueError(f'normals="vertex" is for rung "mesh", not {self.rung!r}')
        if self.precision == "float32" and (self.rung != "surfaces" or self.path == "numpy"):
            raise ValueError(ONLY_BARE)


def _by_numpy(layout: Layout, rays: Rays, rung: Rung, recorded: int, continuous: bool = False) -> TraceResult:
    """Rungs law, thin and surfaces in numpy, with hits kept at `recorded` faces."""
    ledger = Ledger.opened(rays, recorded)
    rows = ledger.launchable()
    if rung == "law":
        trace_law(layout, ledger, rows, continuous)
    elif rung == "thin":
        from clacad.tracing.reference.thin import trace_thin

        trace_thin(layout, ledger, rows)
    else:
        from clacad.tracing.reference.surfaces import trace_surfaces

        for same, media in colours(layout, rays, rows):
            trace_surfaces(layout, ledger, same, media)
    return ledger.closed()


def _enter(result: TraceResult, rows: Rows, own: TraceResult) -> None:
    """Write the rows (k,) of rays that were traced separately, with no effects."""
    for name in ("position", "direction", "fate", "optical_path", "cell", "order", "surface"):
        getattr(result, name)[rows] = getattr(own, name)


def _ideal(layout: Layout, rays: Rays, rung: Rung, threads: int | None) -> TraceResult:
    """Rungs law and thin: plain rays by the compiled kernels, the rest in numpy."""
    from clacad.tracing.compiled.law_rung import trace_law_plain
    from clacad.tracing.compiled.thin import trace_thin_plain
    from clacad.tracing.compiled.threads import thread_count

    ledger, waves = Ledger.blank(len(rays), 0), rays.wavelength
    trace_plain = trace_law_plain if rung == "law" else trace_thin_plain
    rest, result = trace_plain(layout, rays, ledger, thread_count(threads)), ledger.closed()
    LOADED.add(kernels_of(rung, layout))
    if waves is not None:  # a ray without a valid wavelength is INVALID regardless of the geometry
        rest = np.union1d(rest, np.flatnonzero(~(np.isfinite(waves) & (waves > 0.0))))
    if len(rest):
        own = Rays(rays.position[rest], rays.direction[rest], None if waves is None else waves[rest])
        _enter(result, rest, _by_numpy(layout, own, rung, 0))
    return result


def _compiled(
    layout: Layout,
    rays: Rays,
    recorded: int,
    threads: int | None,
    facets: Tiles | Triangles | None = None,
    single: bool = False,
) -> TraceResult:
    """Exact surfaces, or `facets`, by the compiled kernels."""
    from clacad.tracing.compiled.chunk import trace_compiled
    from clacad.tracing.compiled.threads import thread_count

    count = thread_count(threads)
    line = common_line(rays)
    if line is not False:  # the kernels write every row themselves
        ledger = Ledger.blank(len(rays), recorded)
        media = media_of(layout.window.bodies, line)
        rows = np.arange(len(rays)) if recorded else range(len(rays))
        trace_compiled(layout, rays, ledger, rows, media, count, facets, single)
    else:
        ledger = Ledger.opened(rays, recorded)
        for rows, media in colours(layout, rays, ledger.launchable()):
            trace_compiled(layout, rays, ledger, rows, media, count, facets, single)
    if facets is None and not single:
        LOADED.add(kernels_of("surfaces", layout))
    return ledger.closed()


def common_line(rays: Rays) -> float | Literal[False] | None:
    """Wavelength of all the rays, None for the design's; False if they differ or if some are invalid."""
    waves = rays.wavelength
    if waves is None:
        return None
    if len(waves) == 0 or not 0.0 < waves[0] < np.inf or bool((waves != waves[0]).any()):
        return False
    return float(waves[0])


def trace(
    window: Window,
    rays: Rays | OneRay,
    rung: Rung = "surfaces",
    record: bool = False,
    mesh: AnyMesh | int | Facets | None = None,
    normals: Normals = "facet",
    threads: int | None = None,
    path: Path | None = None,
) -> TraceResult:
    """Trace rays through a window without effects; parameters and errors are those of `clacad.trace`."""
    return SheetTracer(window, rung, mesh, normals, threads, path)(rays, record)
