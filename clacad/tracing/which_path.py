"""Which implementation traces: numpy, or the compiled kernels of a rung.

Without a `path`, kernels are loaded once numpy has traced for as many seconds, in this process and on this
rung, as loading takes, or compiling where none are cached. The time of a ray is that measured in this
process. Any sequence of calls then takes at most about twice the time that advance knowledge of all calls
would give. This is the ski rental rule: rent until the rent equals the price (Karlin, Manasse, Rudolph,
Sleator, Algorithmica 3, 79 (1988)).

Processor seconds of tracing a file of rays, by a model of one reference machine; see
`clacad.base.machine_rates`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from time import thread_time
from typing import Literal

from clacad.base.types import Rung
from clacad.optics.surface import Quadric
from clacad.sheet.window import Window
from clacad.tracing.layout import Layout

Path = Literal["numpy", "numba", "size"]

SMALL_JOB = 3_000_000
"""Ray-surfaces up to which `path` "size" uses numpy."""

LOADING = 0.8
"""Seconds to load kernels that are cached on disk."""

Kernel = Literal["surfaces", "mesh", "float32", "law", "thin"]

COMPILING: Mapping[Kernel, float] = {"surfaces": 35.0, "mesh": 41.0, "float32": 20.0, "law": 7.0, "thin": 9.0}
"""Processor seconds to compile each kernel where it is not cached (`tests/benchmarks/calls.md`)."""

IN_NUMPY: Mapping[str, float] = {"law": 2.2e-7, "thin": 5.5e-7, "surfaces": 7e-7, "iterated": 6e-6}
"""Seconds of a ray-surface in numpy, until some were measured in this process; rung surfaces: of quadrics.
Iterated: biconics and even polynomials, which are solved by Newton steps.
"""

LEAST_MEASURED = 4096
"""Rays of a call from which on its time is attributed to its rays."""

IDEAL_FACES = 4
"""Number of faces assumed on rungs law and thin, which have none: numpy takes about as long."""

LOADED: set[str] = set()
"""Kernels, see `kernels_of`, that have run in this process."""

MEASURED: dict[str, float] = {}
"""Seconds of a ray-surface in numpy as last measured in this process; keys are the kernels that were not
loaded."""

WAITED: dict[str, float] = {}
"""Seconds that numpy takes for the rays of this process; keys are the kernels that were not loaded."""


def worth_compiled(rays: int, faces: int) -> bool:
    """Whether compiled kernels trace these rays through these faces where the number alone decides."""
    return rays * faces > SMALL_JOB


def compiled_suits(rung: Rung, path: Path | None, rays: int, faces: int, layout: Layout) -> bool:
    """Whether compiled code traces a number of rays through a number of faces: as requested, or where it is
    faster.

    Without a path the rays are added to those that waited.
    """
    if not has_kernel(rung, layout.window):
        return False
    if path is not None:
        return path == "numba" or (path == "size" and worth_compiled(rays, faces))
    kernels = kernels_of(rung, layout)
    if kernels in LOADED:
        return True
    WAITED[kernels] = WAITED.get(kernels, 0.0) + rays * faces * MEASURED.get(kernels, _expected(rung, layout))
    return WAITED[kernels] > LOADING and WAITED[kernels] > _worth(rung, layout)


@contextmanager
def measuring(rung: Rung, layout: Layout, rays: int, faces: int) -> Iterator[None]:
    """Measure the processor seconds of numpy for rays: they depend on the surfaces and on the machine."""
    began = thread_time()
    yield
    if rays >= LEAST_MEASURED:
        MEASURED[kernels_of(rung, layout)] = (thread_time() - began) / (rays * faces)


def _expected(rung: Rung, layout: Layout) -> float:
    """Seconds of a ray-surface in numpy: the mean of the sheet's faces."""
    if rung != "surfaces":
        return IN_NUMPY[_rate(rung)]
    surfaces = [face.surface for body in layout.bodies for face in (body.front, body.back)]
    each = [IN_NUMPY["surfaces" if isinstance(one, Quadric) else "iterated"] for one in surfaces]
    return sum(each) / len(each)


def _rate(rung: Rung) -> Rung:
    """Rung whose rates apply to a rung."""
    return "surfaces" if rung == "mesh" else rung


def has_kernel(rung: Rung, window: Window) -> bool:
    """Whether a rung of a sheet has kernels: exact surfaces of arrays that are not turned, and rung thin
    without a field lens, an opaque line, or lenses with axes, two sizes or heights of their own.
    """
    if rung == "law":
        return True
    if rung == "thin":
        pair = window.thin
        own = any(change is not None and change.framed for change in (pair.change, pair.change_1))
        return not (own or pair.field or pair.turn or window.land.lined >= 0)
    return not any(place.turn for place in window.placements)


def kernels_of(rung: Rung, layout: Layout) -> str:
    """Name of the kernels that trace a rung: non-uniform sheets have their own; on rung law, varying laws."""
    window = layout.window
    alike = window.uniform if rung != "law" else window.cell_laws is None
    return rung if alike else f"{rung} of cells that differ"


def _worth(rung: Rung, layout: Layout) -> float:
    """Seconds until a rung's kernels are available."""
    from clacad.tracing.compiled.chunk import rung_is_kept

    return LOADING if rung_is_kept(rung, layout) else COMPILING[_rate(rung)]


FIXED = 0.03
"""Seconds for opening archives and assembling the result."""

COMPILED = 0.7
"""Seconds for loading the compiler and the kernels it cached."""

PER_RAY = {"law": 3.5e-7, "thin": 4.2e-7, "surfaces": 4.2e-7, "mesh": 5e-7}
"""Seconds for reading, tracing and writing a ray."""

PLAIN = {"law": 1.7e-6, "thin": 2.0e-6, "surfaces": 2.6e-6, "mesh": 3.0e-6}
"""Seconds for a ray where there are too few rays for compiled kernels."""

MICROSECONDS = {"law": 0.05, "thin": 0.25, "surfaces": 0.07, "mesh": 0.16, "mesh, a quad of the side": 0.003}
"""Processor time of one ray in compiled kernels alone, by rung, µs.

The values are geometric means over traces of 20 000 rays through four shipped designs (plano, window-100mm,
tilted-biconvex, hexagonal) on one core of an ordinary server. A design may differ from it by a factor of 8,
because tilted lenses and hexagons cost more; another machine scales all points alike.
"""

PER_EFFECT = 2e-6
PER_BYTE = 4e-7
"""Seconds for each byte of a file of triangles: read, sorted into a tree."""


def trace_seconds(
    rays: int, rung: str, effects: Sequence[str] = (), faces: int = 4, mesh_bytes: int = 0
) -> float:
    """Processor seconds of a trace.

    rung : "law", "thin", "surfaces" or "mesh"
    faces : Refracting surfaces of the sheet.
    mesh_bytes : Size of the file of triangles, if there is one.
    """
    plain = _in_numpy(rung, effects, rays, faces, mesh_bytes > 0)
    fixed = FIXED + (0.0 if plain else COMPILED)
    each = (PLAIN if plain else PER_RAY).get(rung, PER_RAY["surfaces"])
    return fixed + rays * (each + PER_EFFECT * len(effects)) + PER_BYTE * mesh_bytes


def task(
    rung: str, effects: Sequence[str] = (), rays: int = 0, faces: int = 4, from_file: bool = False
) -> str:
    """Name under which such a trace is recorded: everything that affects the time of a ray."""
    plain = _in_numpy(rung, effects, rays, faces, from_file)
    parts = ["trace", rung, "numpy" if plain else "", "file" if from_file else "", *sorted(effects)]
    return " ".join(part for part in parts if part)


def _in_numpy(rung: str, effects: Sequence[str], rays: int, faces: int, from_file: bool) -> bool:
    """Whether rays are too few for kernels; ideal rungs with effects have none, facets of a file no other."""
    if rung in ("law", "thin"):
        return bool(effects) or not worth_compiled(rays, IDEAL_FACES)
    return not (from_file or worth_compiled(rays, faces))
