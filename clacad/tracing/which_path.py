"""Which implementation traces: numpy, or the compiled kernels of a rung.

Without a `path` kernels are loaded once numpy has traced, in this process and on this rung, as much as it could have in the
time that loading takes, or compiling where none are kept: no sequence of calls then takes more than about twice what it would
have, had one known how many calls there are (the rule of who rents skis until the rent has paid for a pair: Karlin, Manasse,
Rudolph, Sleator, Algorithmica 3, 79 (1988)).
"""

from __future__ import annotations

from collections import Counter
from typing import Literal

from clacad.base.types import Rung
from clacad.tracing.layout import Layout

Path = Literal["numpy", "numba", "size"]

SMALL_JOB = 3_000_000
"""Ray-surfaces up to which `path` "size" is numpy's."""

LOADING, COMPILING = 1_500_000, 60_000_000
"""Ray-surfaces that numpy traces while kernels kept on disk are loaded (0.8 s), or compiled where none are kept (30 s)."""

IDEAL_FACES = 4
"""Faces that a ray counts for on rungs law and thin, which have none: numpy takes about as long."""

LOADED: set[str] = set()
"""Kernels, see `kernels_of`, that have run in this process."""

WAITED: Counter[str] = Counter()
"""Ray-surfaces that were asked for in this process while kernels were not loaded."""


def worth_compiled(rays: int, faces: int) -> bool:
    """Whether so many rays through so many faces are traced by the compiled kernels where their number alone decides."""
    return rays * faces > SMALL_JOB


def compiled_suits(rung: Rung, path: Path | None, rays: int, faces: int, layout: Layout) -> bool:
    """Whether compiled code traces so many rays through so many faces: as asked, or where it is done first.

    Without a path the rays are counted among those that waited.
    """
    if (rung == "thin" and layout.window.thin.field) or (rung != "surfaces" and not layout.window.uniform):
        return False
    if not layout.window.level_and_straight:  # no kernel knows such cells
        return False
    if path is not None:
        return path == "numba" or (path == "size" and worth_compiled(rays, faces))
    kernels = kernels_of(rung, layout)
    if kernels in LOADED:
        return True
    WAITED[kernels] += rays * faces
    return WAITED[kernels] > LOADING and WAITED[kernels] > _worth(rung, layout)


def kernels_of(rung: Rung, layout: Layout) -> str:
    """What the kernels that trace a rung are called here: sheets whose cells differ have their own."""
    return rung if layout.window.uniform else f"{rung} of cells that differ"


def _worth(rung: Rung, layout: Layout) -> int:
    """Ray-surfaces that numpy traces until a rung's kernels are there."""
    from clacad.tracing.compiled.kept_kernels import rung_is_kept

    return LOADING if rung_is_kept(rung, layout) else COMPILING
