"""The public trace: rays through a window on one of four rungs, with physical effects or bare.

Without effects the trace is that of `clacad.tracing`; with them it runs a block of rays at a time, under the
passes of the effects (`engine.passes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

from clacad.base.types import Rung
from clacad.effects import declared
from clacad.effects.engine.passes import trace_with
from clacad.optics.rays import OneRay, Rays, TraceResult, as_rays
from clacad.sheet.window import Window
from clacad.tracing.trace import ONLY_BARE, Precision, SheetTracer
from clacad.tracing.which_path import Path

if TYPE_CHECKING:
    from clacad.effects.engine.effect import Effect
    from clacad.light.sums import LightSums
    from clacad.optics.law import Law
    from clacad.tracing.facets.tiles import Normals
    from clacad.tracing.facets.triangle_soup import AnyMesh


class TraceOptions(TypedDict, total=False):
    """How rays are traced; the fields of the same names of `clacad.Tracer`."""

    mesh: AnyMesh | int | None
    normals: Normals
    threads: int | None
    path: Path | None
    precision: Precision
    continuous: bool


def trace(
    window: Window,
    rays: Rays | OneRay,
    rung: Rung = "surfaces",
    effects: Sequence[str | Effect] = (),
    record: bool = False,
    **options: Unpack[TraceOptions],
) -> TraceResult:
    """Follow rays through a sheet: where each leaves, in what direction, and what became of it.

    Prepared data (packed arrays, triangles of a file) is cached on the window. Use `clacad.Tracer` to control
    its lifetime.

    Parameters
    ----------
    window, rung, effects
        As in `clacad.Tracer`.
    rays : Rays, or one ray as (origin, direction)
        Sheet frame, window units, in front of the sheet; ``((0, 0, -1), (0.01, 0, 1))`` is one ray.
    record : bool
        Keep `hits` and `directions` at every face.
    mesh, normals, threads, path, precision, continuous
        As in `clacad.Tracer`; by keyword.

    Returns
    -------
    TraceResult
        Every ray has exactly one fate; only INVALID rows may contain NaN. The implementation changes no fate
        and no cell, and directions by at most 1.4e-15.

    Raises
    ------
    TypeError, ValueError
        As `clacad.Tracer`; rays that are none are a TypeError.

    Examples
    --------
    >>> import clacad
    >>> window = clacad.prescribe(clacad.load("slab", ["lattice.count = [3, 3]"]))
    >>> clacad.trace(window, ((0, 0, -1), (0.01, 0, 1)))
    TraceResult(1 ALIVE)
    """
    if effects:
        return Tracer(window, rung, effects, **options)(rays, record)
    return SheetTracer(window, rung, **options)(rays, record)


@dataclass(frozen=True, eq=False)
class Tracer:
    """One window and rung, laid out once, called with rays as often as needed, from any thread.

    Parameters
    ----------
    window : Window
    rung : "law", "thin", "surfaces" or "mesh"
        Homogeneous sheet; ideal lenslets; exact Snell at the surfaces; Snell at the facets.
    effects : sequence of names or `clacad.effects.Effect`
        Physics added to the geometry; an empty sequence costs nothing.
    mesh : Mesh, int, TriangleSoup, path or None
        For rung "mesh" only: the sheet's own mesh, its number of quads a cell side, triangles from any
        source, or a file of them (STL, 3MF, PLY, OBJ, GLB), which is read at once. None: the sheet's own mesh
        of 16 quads a cell side, as in scenes.
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

    Raises
    ------
    TypeError
        A design in place of the window, or an unknown option; the message names the function to call.
    ValueError
        An unknown word, a precision or a mesh that the rung does not have, a mesh of other bodies, a sheet
        that cannot be meshed, or a wavelength outside a material's data.

    Notes
    -----
    A tracer can be pickled, with its prepared data, and sent to other processes.

    >>> import clacad
    >>> window = clacad.prescribe(clacad.load("designs/paper-a-covered.toml"))
    >>> tracer = clacad.Tracer(window, rung="thin")
    >>> tracer(clacad.Rays((0.0015, 0.0025, -0.1), [[0.01, 0.0, 1.0]])).counts()["ALIVE"]
    1
    """

    window: Window
    rung: Rung = "surfaces"
    effects: Sequence[str | Effect] = ()
    mesh: AnyMesh | int | None = None
    normals: Normals = "facet"
    threads: int | None = None
    path: Path | None = None
    precision: Precision = "float64"
    continuous: bool = False
    bare: SheetTracer = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Reject what cannot be traced, and lay out."""
        normals = self.normals
        if self.rung != "mesh" and any(_rung_of(effect) == "mesh" for effect in self.effects):
            normals = "facet"  # they are those of the effect's facets
        options = {f.name: getattr(self, f.name) for f in fields(SheetTracer) if f.init}
        bare = SheetTracer(**options | {"normals": normals})
        if self.precision == "float32" and self.effects:
            raise ValueError(ONLY_BARE)
        object.__setattr__(self, "bare", bare)

    def __getstate__(self) -> dict[str, Any]:
        """State without the mesh: the data laid out from it is kept."""
        return {**self.__dict__, "mesh": None}

    def __call__(self, rays: Rays | OneRay, record: bool = False) -> TraceResult:
        """Trace rays; see `clacad.trace`."""
        if not self.effects:
            return self.bare(rays, record)
        return trace_with(
            self.window,
            as_rays(rays),
            self.rung,
            self.effects,
            record,
            mesh=self.mesh if self.bare.facets is None else self.bare.facets,
            normals=self.normals,
            threads=self.threads,
            path=self.path,
        )

    def sums(self, rays: Rays, law: Law | None = None) -> LightSums:
        """Trace rays and return sums without rows: a fifth of the time where only sums are needed.

        Parameters
        ----------
        rays : Rays
        law : Law or None
            Law that angles are measured to; None: the law of the window's design.

        Raises
        ------
        ValueError
            The tracer has effects: a share of each ray cannot be counted.
        """
        if self.effects:
            raise ValueError("sums count whole rays: a tracer with effects has none")
        return self.bare.sums(rays, law)


def _rung_of(effect: str | Effect) -> Rung | None:
    """Rung that an effect uses instead of the requested one."""
    return declared(effect).rung if isinstance(effect, str) else effect.rung
