"""The STEP rung: a spot check of rays against the faces the CAD kernel reads back."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.accuracy.measure import Ladder, statistics
from clacad.accuracy.table import Row
from clacad.rates import seconds_of
from clacad.rays import Fate

if TYPE_CHECKING:
    from clacad.export.worker import Worker

SPOT_RAYS = 1100
"""Rays of the spot check: at least 1000 of them through faces that are no walls."""
REACH = 2
"""Cells either side of the lit one that are written; a ray that leaves them is not compared."""


def step_row(ladder: Ladder) -> tuple[Row | None, str]:
    """Write a few cells as STEP, read them back with the kernel, trace through its faces.

    Returns
    -------
    (Row, "") or (None, why it could not be measured)
    """
    from clacad.export.errors import ExportError
    from clacad.export.step import write_step
    from clacad.export.worker import Worker

    size = 2 * REACH + 1
    small = ladder.window.with_cells((size, size))
    alive = np.flatnonzero(ladder.truth.fate == Fate.ALIVE)[:SPOT_RAYS]
    if len(alive) == 0:
        return None, "STEP was not measured: no ray is alive"
    offset = np.append(_moved(ladder, small, alive[0]), 0.0)
    scale = 1e3 * ladder.window.unit
    position = (ladder.rays.position[alive] - offset) * scale
    direction = ladder.rays.direction[alive]
    indices = [body.index for body in ladder.window.bodies]
    with tempfile.TemporaryDirectory(prefix="clacad-") as folder, Worker() as worker:
        path = Path(folder) / "spot.step"
        began = time.process_time()
        write_step(small, path, "fused")  # one solid a body: touching cells would add faces inside the glass
        prepare = time.process_time() - began
        try:
            found, reading, seconds = _cast(worker, str(path), position.tolist(), direction.tolist(), indices)
        except ExportError as error:
            return None, f"STEP was not measured: {error}"
        nbytes = path.stat().st_size
    met = np.array([row is not None for row in found])
    out = np.array([row if row is not None else [np.nan] * 3 for row in found])
    numbers = statistics(out[met], ladder.truth.direction[alive][met], ladder.asked[alive][met])
    row = Row(
        "step", f"{int(met.sum())} rays through the re-read faces of {size} x {size} cells", *numbers,
        float(1.0 - met.mean()), seconds, prepare + reading, len(alive), int(met.sum()), bytes=nbytes, file_bytes=nbytes,
    )  # fmt: skip
    return row, ""


def _cast(
    worker: Worker, path: str, position: list[Any], direction: list[Any], indices: list[float]
) -> tuple[list[Any], float, float]:
    """Directions, seconds of loading the kernel and the file, and seconds of the rays alone.

    Every call reads the file; one with a single ray tells how long that takes, the first how long loading takes.
    """
    taken, found = [], list[Any]()
    worker.start()
    for count in (1, 1, len(position)):
        began = seconds_of(worker.pid, time.monotonic())
        found = worker.run(
            "clacad.brep.raycast:cast_rays", path, position[:count], direction[:count], indices, timeout=120.0
        )
        taken.append(seconds_of(worker.pid, time.monotonic()) - began)
    return found, taken[0], max(1e-3, taken[2] - taken[1])


def _moved(ladder: Ladder, small: object, lit: int) -> np.ndarray:
    """Displacement that brings the lit cell of the whole sheet onto the middle cell of the small one."""
    from clacad.sheet import Window

    assert isinstance(small, Window)
    cell = ladder.truth.cell[lit].astype(np.int64)
    here = ladder.window.lattice.centres(cell[None])[0]
    middle = small.lattice.locate(np.zeros(1), np.zeros(1))[0]
    return np.asarray(here - small.lattice.centres(middle)[0])
