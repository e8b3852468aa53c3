"""Traces of the same rays on every rung, with their times; a STEP file is checked by a few rays.

The STEP rung compares some rays with the faces that OCC reads back.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import ceil
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from clacad.base.machine_rates import seconds_of
from clacad.base.types import Bools, Floats, Ints, Rows
from clacad.base.units import millimetres
from clacad.judging.file_light import lines_of
from clacad.light.compare import AngleSummary, WhiteLight, closed_change
from clacad.light.measure import first_rays, measure
from clacad.optics.rays import NO_CELL, Fate, Rays, TraceResult
from clacad.sheet.bundle import Bundle, RequestedLaw
from clacad.sheet.like_cell import in_light
from clacad.sheet.window import Window
from clacad.storage.atomic import scratch_folder
from clacad.verification.accuracy.accuracy_row import AccuracyRow, MadeCost, SpectrumCost
from clacad.verification.accuracy.extended_precision import direction_errors

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.formats.step.rays_through_faces import Crossing
    from clacad.mesh import Mesh
    from clacad.storage.worker import Worker
    from clacad.tracing.facets.tiles import Normals
    from clacad.tracing.worst_cell import SeenCell


Timed = TypeVar("Timed")
QUADS = (4, 8, 16, 32, 64, 128)
"""Tessellations of the ladder, quads per cell side."""
OWN_FINEST = 32
"""Finest of them for a non-uniform sheet, whose triangles are no copies and must all be sorted."""
ORACLE_RAYS = 1000
"""Rays traced in 50 digits."""
REPEATS = 3
SLOW = 1.0
"""Seconds above which one warm run is enough."""


@dataclass(frozen=True, eq=False)
class TracedRays:
    """The rays with their truth and the requested directions.

    truth : Rung surfaces, float64.
    `asked` : (n, 3). Exit directions of the law; NaN where it has no answer.
    """

    window: Window
    rays: Rays
    truth: TraceResult
    asked: Floats

    @classmethod
    def raised(cls, window: Window, rays: Rays, cell: tuple[int, int] | None = None) -> TracedRays:
        """Trace the truth with the compiled kernel of the table; `cell`: the cell whose law applies."""
        from clacad.tracing.trace import trace

        law = window.law if cell is None else window.law_at(cell)
        return cls(window, rays, trace(window, rays, path="numba"), law.refract(rays.direction))


def timed(run: Callable[[], Timed], repeats: int = REPEATS) -> tuple[Timed, float, float]:
    """Result, processor seconds (best of `repeats` warm runs), further seconds of the first (compiling)."""
    began = time.process_time()
    result = run()
    first = time.process_time() - began
    best = first
    for _ in range(repeats if first < SLOW else min(1, repeats)):
        began = time.process_time()
        result = run()
        best = min(best, time.process_time() - began)
    return result, best, max(0.0, first - best)


def peak_memory(run: Callable[[], Any]) -> int:
    """Peak of traced allocations during a call, bytes."""
    tracemalloc.start()
    try:
        run()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def row(
    ladder: TracedRays,
    rung: str,
    setting: str,
    run: Callable[[], TraceResult],
    prepare: float = 0.0,
    repeats: int = REPEATS,
    **facts: Any,
) -> AccuracyRow:
    """Measure one rung: time, memory, errors against truth and law; without repeats one run, no memory."""
    result, seconds, compiling = timed(run, repeats)
    memory = peak_memory(run) if repeats else 0
    disagree = result.fate != ladder.truth.fate
    if rung != "law":  # the homogeneous law has no cells: every ray is of order 0
        disagree |= (result.order != ladder.truth.order).any(axis=1)
        disagree |= (result.cell != ladder.truth.cell).any(axis=1)
    both = (result.fate == Fate.ALIVE) & (ladder.truth.fate == Fate.ALIVE)
    both &= ~disagree | (rung == "law")
    numbers = statistics(result.direction[both], ladder.truth.direction[both], ladder.asked[both])
    return AccuracyRow(
        rung,
        setting,
        *numbers,
        float(disagree.mean()),
        seconds,
        prepare + compiling,
        len(ladder.rays),
        int(both.sum()),
        memory=memory,
        **facts,
    )


def statistics(found: Floats, truth: Floats, asked: Floats) -> tuple[float, float, float, float, float]:
    """Angles (radians) of directions (n, 3) to the truth (rms, 95 %, max) and to the law (rms, max)."""
    model, law = AngleSummary.between(found, truth), AngleSummary.between(found, asked)
    return *model, law.rms, law.worst


def reference(ladder: TracedRays, count: int = ORACLE_RAYS) -> dict[str, float]:
    """Compare the truth with a 50-digit trace on its first `count` ALIVE rays."""
    alive = np.flatnonzero(ladder.truth.fate == Fate.ALIVE)[:count]
    truth = ladder.truth
    error = direction_errors(
        ladder.window,
        ladder.rays.position[alive],
        ladder.rays.direction[alive],
        truth.direction[alive],
        truth.cell[alive],
        truth.order[alive],
    )
    decided = error[np.isfinite(error)]
    summary = AngleSummary.of(decided)
    return {
        "rays": float(len(alive)),
        "rms": summary.rms,
        "p95": summary.p95,
        "max": summary.worst,
        "undecided": float(len(error) - len(decided)),
        "digits": 50.0,
    }


def spectrum_cost(design: Design, cell: SeenCell, lit: Bundle) -> SpectrumCost | None:
    """Time a bundle in one line and in all lines of a design; None where it has no colour."""
    from clacad.tracing.trace import SheetTracer

    lines, law = lines_of(design, cell.like), RequestedLaw.of(cell.like)
    if not lines:
        return None

    rays, tracer = cell.placed(lit).rays, SheetTracer(cell.window, path="numba")

    def send(*waves: float) -> None:
        for _ in tracer.in_lines(rays, waves):
            pass  # rows of a piece are freed before the next: pages of new memory cost a fifth of a line

    _, one_line, _ = timed(lambda: send(*[*lines][:1]))
    _, traced, _ = timed(lambda: send(*lines))
    base, light = measure(cell, lit, law), measure(cell, lit, law, lines)
    own = first_rays(base, ORACLE_RAYS)
    closed, closed_seconds, _ = timed(
        lambda: [closed_change(cell.like, in_light(cell.like, wave), own) for wave in lines]
    )
    white = WhiteLight(base, light, lines)
    return SpectrumCost(
        len(lines),
        one_line,
        traced,
        closed_seconds,
        white.mean(white.change),
        white.mean(np.array(closed)),
        white.mean(white.law_rms),
    )


def made_cost(design: Design, cell: SeenCell, lit: Bundle) -> MadeCost | None:
    """Time a bundle as designed and as made; None without a process, or where that cannot be judged."""
    from clacad.making.light_as_made import costs_alone, light_as_made, made_of
    from clacad.storage.errors import NotPossible
    from clacad.tracing.trace import trace

    try:
        made = made_of(design, cell.like)
        found = light_as_made(design, cell.like, len(lit.rays))
    except NotPossible:
        return None
    name = found.process.name
    if name == "none":
        return None
    _, designed_s, _ = timed(lambda: trace(cell.window, cell.placed(lit).rays, path="numba"))
    _, made_s, _ = timed(lambda: made(made.bundle(lit)))
    costs = tuple(costs_alone(design, cell.like, found))
    return MadeCost(name, found.designed, found.formed, found.everything, designed_s, made_s, costs)


def exact_rows(ladder: TracedRays, checked: dict[str, float]) -> list[AccuracyRow]:
    """Rungs law, thin, surfaces in float64 and float32, all compiled.

    Of a non-uniform sheet by the code that traces it: law and thin in numpy, none in float32.
    """
    from clacad.tracing.trace import SheetTracer, trace

    window, rays, own = ladder.window, ladder.rays, not ladder.window.uniform
    path: Literal["numpy", "numba"] = "numpy" if own else "numba"
    setting, size = ("cells that differ", _own_bytes(window)) if own else ("", _surface_bytes(window))
    surfaces = row(ladder, "surfaces", setting or "float64", lambda: trace(window, rays, path="numba"))
    rows = [
        row(ladder, "law", setting, lambda: trace(window, rays, rung="law", path=path)),
        row(ladder, "thin", setting, lambda: trace(window, rays, rung="thin", path=path)),
        _with_truth(surfaces, checked, size),
    ]
    if own:
        return [replace(one, own_cells=True) for one in rows]

    def single() -> TraceResult:
        return SheetTracer(window, precision="float32")(rays)

    return [*rows, row(ladder, "surfaces", "float32", single, bytes=size // 2, float="f32")]


def _with_truth(found: AccuracyRow, checked: dict[str, float], size: int) -> AccuracyRow:
    """Row of the exact surfaces with its errors against the reference, and the bytes of its numbers."""
    return replace(
        found,
        model_rms=checked["rms"],
        model_p95=checked["p95"],
        model_max=checked["max"],
        checked=int(checked["rays"]),
        bytes=size,
    )


def own_mesh_rows(ladder: TracedRays, quads: int) -> list[AccuracyRow]:
    """Facets of a non-uniform sheet: those of the cells that its light enters, and of their neighbours."""
    from clacad.formats.mesh.stl import stl_bytes
    from clacad.mesh import tessellate
    from clacad.tracing.facets.triangle_soup import facets_of
    from clacad.tracing.trace import trace

    window, rays, rows = ladder.window, ladder.rays, []
    normals: tuple[Normals, ...] = ("facet", "vertex")
    began = time.process_time()
    whole = tessellate(window, quads=quads)
    mesh = whole.part(_cells_about(window, ladder.truth))
    cut = time.process_time() - began
    triangles = sum(body.facets_about for body in mesh.bodies)
    file_bytes = stl_bytes(sum(body.facets_about for body in whole.bodies))
    for normal in normals:
        began = time.process_time()
        facets = facets_of(window, mesh, normal)
        prepare = cut + time.process_time() - began
        run = partial(trace, window, rays, rung="mesh", mesh=facets, normals=normal)
        rows.append(
            row(
                ladder,
                "mesh",
                f"cells that differ, {quads} quads, {normal} normals",
                run,
                prepare,
                quads=quads,
                normals=normal,
                triangles=triangles,
                own_cells=True,
                bytes=facets.nbytes,
                file_bytes=file_bytes if normal == "facet" else None,
            )
        )
    return rows


def _cells_about(window: Window, truth: TraceResult) -> Ints:
    """Kept cells (m, 2) that light entered, in array 1 or 2, and their neighbours."""
    through = (truth.cell != NO_CELL).all(axis=1)
    both = through & (truth.order != NO_CELL).all(axis=1)
    met = np.concatenate([truth.cell[through], truth.cell[both] + truth.order[both]]).astype(np.int64)
    steps = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 2)
    cells = np.unique((np.unique(met, axis=0)[:, None] + steps).reshape(-1, 2), axis=0)
    return np.asarray(cells[window.lattice.contains(cells)])


def _own_bytes(window: Window) -> int:
    """Bytes that describe a non-uniform sheet: one telescopelet, and the position of each lens."""
    changes = [face.change for face in window.faces if face.change is not None]
    tables = sum(one.table.nbytes for one in changes if one.table is not None)
    return _surface_bytes(window) + 8 * 4 * len(changes) + tables


def _surface_bytes(window: Window) -> int:
    """Bytes that describe one telescopelet: surface, vertex and rotation of each face."""
    return len(window.faces) * (4 + 3 + 9) * 8


def mesh_rows(ladder: TracedRays, quads: int) -> list[AccuracyRow]:
    """Facets of one tessellation: facet and exact vertex normals, vertices in float64 and float32."""
    from clacad.exporting.roles import Holding
    from clacad.formats.mesh.stl import stl_bytes
    from clacad.mesh import tessellate
    from clacad.sheet.representative_cells import representative_cells
    from clacad.tracing.trace import trace
    from clacad.verification.accuracy.file_floors import EXACT, rounded

    window, rays = ladder.window, ladder.rays
    began = time.process_time()
    mesh = tessellate(window, quads=quads)
    prepare = time.process_time() - began
    cell, rows = representative_cells(window, "rounding")[0], []
    for kind, holding in (("f64", EXACT), ("f32", Holding("sheet"))):
        facets = rounded(mesh, cell, holding)
        for normals in ("facet", "vertex"):
            run = partial(trace, window, rays, rung="mesh", mesh=facets, normals=normals)
            setting = f"{quads} quads, {normals} normals" + (", float32 vertices" if kind == "f32" else "")
            stored = kind == "f32" and normals == "facet"
            write_s, read_s = _stl_seconds(window, quads) if stored else (None, None)
            facts: dict[str, Any] = {"quads": quads, "normals": normals, "float": kind}
            facts["triangles"] = mesh.facet_count
            facts["bytes"] = _mesh_bytes(mesh) // (1 if kind == "f64" else 2)
            facts["file_bytes"] = stl_bytes(mesh.facet_count) if stored else None
            rows.append(row(ladder, "mesh", setting, run, prepare, write_s=write_s, read_s=read_s, **facts))
    return rows


def _stl_seconds(window: Window, quads: int) -> tuple[float, float]:
    """Processor seconds of writing the facets of the cells of a STEP spot as STL, and of reading them."""
    from clacad.formats.mesh.stl import read_stl, write_stl
    from clacad.mesh import tessellate

    mesh = tessellate(window.with_cells((SPOT_CELLS, SPOT_CELLS)), quads=quads)
    with scratch_folder() as folder:
        path = folder / "cells.stl"
        write = partial(write_stl, mesh.bodies, path, millimetres(window.unit), "cells")
        write_s = timed(write, 1)[1]
        return write_s, timed(lambda: sum(1 for _ in read_stl(path).chunks()), 0)[1]


def _mesh_bytes(mesh: Mesh) -> int:
    """Bytes of the prototiles that a trace reads: points, levels, triangles."""
    tiles = [one.maker.tile for body in mesh.bodies for one in body.tiled]
    return sum(t.plan.xy.nbytes + t.lens.nbytes + t.plan.triangles.nbytes for t in tiles)


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
SPOT_CELLS = 2 * REACH + 1

More = Callable[[int], TracedRays]
"""Returns a ladder with the given number of rays; the first of them are those of a smaller one."""


def step_row(ladder: TracedRays, more: More | None = None) -> tuple[AccuracyRow | None, str]:
    """Write a few cells as STEP, read them back with OCC, and trace through the faces read.

    more : Returns a larger ladder, where a ladder has fewer rays than the check needs.
    Returns (AccuracyRow, "") or (None, reason why it could not be measured).
    """
    from clacad.formats.step.step_files import write_step
    from clacad.storage.errors import ExportError
    from clacad.storage.worker import Worker

    small = ladder.window.with_cells((SPOT_CELLS, SPOT_CELLS))
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
        f"{rays} through the re-read faces of {SPOT_CELLS} x {SPOT_CELLS} cells",
        *numbers,
        float(1.0 - met.mean()),
        spot.seconds,
        prepare + spot.reading,
        sent,
        number,
        bytes=nbytes,
        file_bytes=nbytes,
        write_s=prepare,
        read_s=spot.reading,
    )
    return row, ""


@dataclass(frozen=True, eq=False)
class Spot:
    """Directions (n, 3) through the file (NaN where not compared), through the surfaces, and by the law.

    reading, seconds : Processor seconds of loading OCC and the file, and of all the rays.
    """

    found: Floats
    truth: Floats
    asked: Floats
    reading: float
    seconds: float


def _compared(ladder: TracedRays, more: More | None, cast: Callable[..., Any], small: Window) -> Spot:
    """Trace ALIVE rays through the file until LEAST were transmitted, or none are left."""
    from clacad.formats.step.rays_through_faces import crossings

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
            crossings(ladder.window, ladder.window.bodies),
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
    worker: Worker, path: str, position: list[Any], direction: list[Any], faces: list[Crossing]
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
            faces,
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
