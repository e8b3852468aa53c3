"""The STEP rung: a spot check of rays against the faces that OCC reads back."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.machine_rates import seconds_of
from clacad.base.types import Bools, Floats, Rows
from clacad.base.units import millimetres
from clacad.optics.rays import Fate
from clacad.sheet.window import Window
from clacad.storage.atomic import scratch_folder
from clacad.verification.accuracy.accuracy_row import AccuracyRow
from clacad.verification.accuracy.measure_rungs import TracedRays, statistics

if TYPE_CHECKING:
    from clacad.storage.worker import Worker


SPOT_RAYS = 1100
"""Rays of the spot check in the first round."""
LEAST = 1000
"""Rays to compare: more are traced until this count passed every body through faces that are not walls."""
SENDINGS = 4
"""Most rounds of tracing; each reads the file again."""
MOST_SENT = 20_000
"""Most rays traced: OCC traces about one thousand per second."""
REACH = 2
"""Cells written on either side of the lit one; a ray that leaves them is not compared."""

More = Callable[[int], TracedRays]
"""Returns a ladder with the given number of rays; the first of them are those of a smaller one."""


def step_row(ladder: TracedRays, more: More | None = None) -> tuple[AccuracyRow | None, str]:
    """Write a few cells as STEP, read them back with OCC, and trace through the faces read.

    Parameters
    ----------
    ladder : TracedRays
    more : callable or None
        Returns a larger ladder, where a ladder has fewer rays than the check needs.

    Returns
    -------
    (AccuracyRow, "") or (None, reason why it could not be measured)
    """
    from clacad.formats.step.step_files import write_step
    from clacad.storage.errors import ExportError
    from clacad.storage.worker import Worker

    size = 2 * REACH + 1
    small = ladder.window.with_cells((size, size))
    with scratch_folder() as folder, Worker() as worker:
        path = folder / "spot.step"
        began = time.process_time()
        write_step(small, path, "fused")  # one solid a body: touching cells would add faces inside the glass
        prepare = time.process_time() - began
        try:
            spot = _compared(ladder, more, partial(_cast, worker, str(path)), small)
        except ExportError as error:
            return None, f"STEP was not measured: {error}"
        nbytes = path.stat().st_size
    if len(spot.found) == 0:
        return None, "STEP was not measured: no ray is alive"
    met: Bools = np.asarray(np.isfinite(spot.found).all(axis=1))
    number, sent = int(met.sum()), len(met)
    rays = f"{number} rays" if number == sent else f"{number} of {sent} rays"
    numbers = statistics(spot.found[met], spot.truth[met], spot.asked[met])
    row = AccuracyRow(
        "step",
        f"{rays} through the re-read faces of {size} x {size} cells",
        *numbers,
        float(1.0 - met.mean()),
        spot.seconds,
        prepare + spot.reading,
        sent,
        number,
        bytes=nbytes,
        file_bytes=nbytes,
    )
    return row, ""


@dataclass(frozen=True, eq=False)
class Spot:
    """Directions (n, 3) through the file (NaN where not compared), through the surfaces, and by the law.

    reading, seconds : float
        Processor seconds of loading OCC and the file, and of all the rays.
    """

    found: Floats
    truth: Floats
    asked: Floats
    reading: float
    seconds: float


def _compared(ladder: TracedRays, more: More | None, cast: Callable[..., Any], small: Window) -> Spot:
    """Trace ALIVE rays through the file until LEAST were transmitted, or none are left."""
    found, truth, asked = [np.empty((0, 3))], [np.empty((0, 3))], [np.empty((0, 3))]
    sent, want, reading, seconds = 0, SPOT_RAYS, 0.0, 0.0
    for _ in range(SENDINGS):
        ladder, alive = _living(ladder, sent + want, more)
        alive = alive[sent : sent + want]
        if len(alive) == 0:
            break
        if sent == 0:
            offset = np.append(_moved(ladder, small, alive[0]), 0.0)
        scale = millimetres(ladder.window.unit)
        position = (ladder.rays.position[alive] - offset) * scale
        rows, loading, took = cast(
            position.tolist(),
            ladder.rays.direction[alive].tolist(),
            [body.index for body in ladder.window.bodies],
        )
        reading, seconds, sent = reading or loading, seconds + took, sent + len(alive)
        found.append(np.array([row if row is not None else [np.nan] * 3 for row in rows]))
        truth.append(ladder.truth.direction[alive])
        asked.append(ladder.asked[alive])
        through = sum(int(np.isfinite(part).all(axis=1).sum()) for part in found)
        if through >= LEAST:
            break
        want = min(ceil(1.1 * (LEAST - through) * sent / max(1, through)), MOST_SENT - sent)
    return Spot(np.concatenate(found), np.concatenate(truth), np.concatenate(asked), reading, seconds)


def _living(ladder: TracedRays, count: int, more: More | None) -> tuple[TracedRays, Rows]:
    """Row numbers of the ALIVE rays of a ladder; of a larger one if these are fewer than `count`."""
    alive = np.flatnonzero(ladder.truth.fate == Fate.ALIVE)
    if more is None or len(alive) >= count or len(alive) == 0:
        return ladder, alive
    larger = more(ceil(1.1 * count * len(ladder.rays) / len(alive)))
    return larger, np.flatnonzero(larger.truth.fate == Fate.ALIVE)


def _cast(
    worker: Worker, path: str, position: list[Any], direction: list[Any], indices: list[float]
) -> tuple[list[Any], float, float]:
    """Directions, seconds of loading OCC and the file, and seconds of the rays alone.

    Every call reads the file. A call with a single ray measures the reading time; the first call measures
    the loading.
    """
    taken, found = [], list[Any]()
    worker.start()
    for count in (1, 1, len(position)):
        began = seconds_of(worker.pid, time.monotonic())
        found = worker.run(
            "clacad.formats.step.rays_through_faces:cast_rays",
            path,
            position[:count],
            direction[:count],
            indices,
            timeout=120.0,
        )
        taken.append(seconds_of(worker.pid, time.monotonic()) - began)
    return found, taken[0], max(1e-3, taken[2] - taken[1])


def _moved(ladder: TracedRays, small: Window, lit: int) -> Floats:
    """Displacement from the lit cell of the whole sheet to the middle cell of the small one."""
    cell = ladder.truth.cell[lit].astype(np.int64)
    here = ladder.window.lattice.centres(cell[None])[0]
    middle = small.lattice.locate(np.zeros(1), np.zeros(1))[0]
    return np.asarray(here - small.lattice.centres(middle)[0])
