"""Which implementation traces: numpy, or the compiled kernels of a rung.

Without a `path` kernels are loaded once numpy has traced, in this process and on this rung, for as many seconds as loading
takes, or compiling where none are kept; the seconds of a ray are those measured in this process. No sequence of calls then takes
more than about twice what it would have, had one known how many calls there are (the rule of who rents skis until the rent has
paid for a pair: Karlin, Manasse, Rudolph, Sleator, Algorithmica 3, 79 (1988)).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from time import thread_time
from typing import Literal

from clacad.base.types import Rung
from clacad.sheet.window import Window
from clacad.tracing.layout import Layout

Path = Literal["numpy", "numba", "size"]

SMALL_JOB = 3_000_000
"""Ray-surfaces up to which `path` "size" is numpy's."""

LOADING = 0.8
"""Seconds that loading kernels takes that are kept on disk."""

COMPILING: Mapping[Rung, float] = {"law": 7.0, "thin": 8.0, "surfaces": 30.0}
"""Seconds that compiling the kernels of a rung takes where none are kept."""

IN_NUMPY: Mapping[Rung, float] = {"law": 2.2e-7, "thin": 5.5e-7, "surfaces": 7e-7}
"""Seconds of a ray-surface in numpy, until some were measured in this process."""

LEAST_MEASURED = 4096
"""Rays of a call from which on its seconds are those of its rays."""

IDEAL_FACES = 4
"""Faces that a ray counts for on rungs law and thin, which have none: numpy takes about as long."""

LOADED: set[str] = set()
"""Kernels, see `kernels_of`, that have run in this process."""

MEASURED: dict[str, float] = {}
"""Seconds of a ray-surface in numpy as last measured in this process, by the kernels that were not loaded."""

WAITED: dict[str, float] = {}
"""Seconds that numpy takes for the rays of this process, by the kernels that were not loaded."""


def worth_compiled(rays: int, faces: int) -> bool:
    """Whether so many rays through so many faces are traced by the compiled kernels where their number alone decides."""
    return rays * faces > SMALL_JOB


def compiled_suits(rung: Rung, path: Path | None, rays: int, faces: int, layout: Layout) -> bool:
    """Whether compiled code traces so many rays through so many faces: as asked, or where it is done first.

    Without a path the rays are counted among those that waited.
    """
    if not has_kernel(rung, layout.window):
        return False
    if path is not None:
        return path == "numba" or (path == "size" and worth_compiled(rays, faces))
    kernels = kernels_of(rung, layout)
    if kernels in LOADED:
        return True
    WAITED[kernels] = WAITED.get(kernels, 0.0) + rays * faces * MEASURED.get(kernels, IN_NUMPY[_rate(rung)])
    return WAITED[kernels] > LOADING and WAITED[kernels] > _worth(rung, layout)


@contextmanager
def measuring(rung: Rung, layout: Layout, rays: int, faces: int) -> Iterator[None]:
    """Measure what numpy takes for rays, in processor seconds: cells that differ take longer than equal ones."""
    began = thread_time()
    yield
    if rays >= LEAST_MEASURED:
        MEASURED[kernels_of(rung, layout)] = (thread_time() - began) / (rays * faces)


def _rate(rung: Rung) -> Rung:
    """Rung whose rates hold for a rung."""
    return "surfaces" if rung == "mesh" else rung


def has_kernel(rung: Rung, window: Window) -> bool:
    """Whether compiled code knows a rung of a sheet: rung law needs one law, rung thin equal cells without a field lens."""
    if rung == "law":
        return window.cell_laws is None
    if rung == "thin":
        return window.uniform and not window.thin.field
    return window.level_and_straight


def kernels_of(rung: Rung, layout: Layout) -> str:
    """What the kernels that trace a rung are called here: sheets whose cells differ have their own."""
    return rung if layout.window.uniform or rung == "law" else f"{rung} of cells that differ"


def _worth(rung: Rung, layout: Layout) -> float:
    """Seconds until a rung's kernels are there."""
    from clacad.tracing.compiled.kept_kernels import rung_is_kept

    return LOADING if rung_is_kept(rung, layout) else COMPILING[_rate(rung)]
