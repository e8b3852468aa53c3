"""What an export will cost, told before any work, and refused when it cannot end well.

Cells and facets are counted in integers, so a design of 10^18 lenslets is refused as fast as one of 10^8.
Facets and the bytes of STL and TIFF are exact, other bytes are good to 20 %, seconds and memory are ranges.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from math import isqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.export import seconds as cost
from clacad.export.errors import LimitRefused
from clacad.rates import Rates

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.export.step import Mode
    from clacad.export.tessellation import Meshes
    from clacad.sheet import Window

MOST_FACETS = 50_000_000
MOST_BYTES = 2_000_000_000
MOST_CELLS = 10_000_000
"""Lenslets of one array; every format that lists cells one by one ends within minutes below this."""
MEMORY_SHARE = 0.8
QUADS = (64, 32, 16, 8, 4)
"""Facet grids a cell side that "auto" chooses from, finest first."""

MESH_FORMATS = ("stl", "stl-parts", "3mf", "ply", "glb")
WELDED_FORMATS = ("3mf", "ply", "glb")
FIXTURES = ("baffle", "frame", "coupon", "brep", "marked")
MOST_WELDED = 8_000_000
"""Facets up to which a mesh is welded into shared vertices in memory."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """The price of one format.

    Parameters
    ----------
    format : str
    bytes : int
    exact : bool
        Whether `bytes` is exact; otherwise within 20 %.
    facets : int or None
    quads : int or None
    modelled : float
        Processor seconds on the machine whose constants the models hold.
    memory : (low, high) bytes
    seconds : (low, high)
        Processor seconds on this machine.
    """

    format: str
    bytes: int
    exact: bool
    facets: int | None
    quads: int | None
    modelled: float
    memory: tuple[int, int]
    seconds: tuple[float, float] = (0.0, 0.0)

    @property
    def task(self) -> str:
        """Name under which the seconds of this format are noted."""
        return f"export {self.format}"

    def to_dict(self) -> dict[str, Any]:
        """JSON-able form."""
        return {
            "format": self.format, "bytes": self.bytes, "exact": self.exact, "facets": self.facets,
            "quads": self.quads, "seconds": list(self.seconds), "memory": list(self.memory),
        }  # fmt: skip


# -- before anything is prescribed -------------------------------------------------------------


def refuse_uncountable(design: Design) -> None:
    """Refuse a design of more lenslets than anything here goes through one by one; integer arithmetic only.

    Raises
    ------
    LimitRefused
    """
    n1, n2 = (int(n) for n in design.lattice.count)
    _refuse_cells(n1, n2)


def refuse_early(design: Design, formats: Sequence[str], quads: int | None) -> None:
    """Refuse a design whose mere count of lenslets is beyond every limit; integer arithmetic only.

    Raises
    ------
    LimitRefused
    """
    refuse_uncountable(design)
    n1, n2 = design.lattice.count
    cells = n1 * n2
    grid = quads if quads is not None else QUADS[-1]
    if any(f in MESH_FORMATS for f in formats) and design.lattice.outline is None:
        faces = 4 if design.pair.form == "biconvex" else 2
        if "stl" in formats or "stl-parts" in formats:
            _refuse_facets("stl", grid * grid * cells * faces, grid, (n1, n2))


def _refuse_cells(n1: int, n2: int) -> None:
    if n1 * n2 > MOST_CELLS:
        side = isqrt(MOST_CELLS)
        raise LimitRefused(
            f"{count_text(n1 * n2)} lenslets ({n1} x {n2}) are more than the {count_text(MOST_CELLS)} that are written; "
            f"use lattice.count up to [{side}, {side}], or export a part with cells=({min(n1, 100)}, {min(n2, 100)})"
        )


def _refuse_facets(
    format: str, facets: int, quads: int, count: tuple[int, int], at_least: bool = True
) -> None:
    size = 84 + 50 * facets
    if facets <= MOST_FACETS and size <= MOST_BYTES:
        return
    most = min(MOST_FACETS, MOST_BYTES // 50)
    coarser = isqrt(max(0, quads * quads * most // facets))
    part = max(1, isqrt(count[0] * count[1] * most // facets))
    ways = [f"cells=({part}, {part})"]
    if coarser >= 2:
        ways.insert(0, f"quads={coarser}")
    else:
        ways.append("format 3mf or step, which repeat one cell")
    raise LimitRefused(
        f"{format}: {'at least ' if at_least else ''}{count_text(facets)} facets, {size_text(size)} at {quads} quads a cell "
        f"side, are more than {count_text(MOST_FACETS)} facets or {size_text(MOST_BYTES)}; use {' or '.join(ways)} "
        "(or force it)"
    )


# -- with the window known ---------------------------------------------------------------------


def choose_quads(meshes: Meshes, formats: Sequence[str], force: bool = False) -> int:
    """Finest facet grid whose files stay within the limits: what slope_error="auto" means.

    Raises
    ------
    LimitRefused
        Not even the coarsest fits.
    """
    window = meshes.window
    for quads in QUADS[:-1]:
        if facets_at_least(window, quads) * 50 > MOST_BYTES:
            continue
        facets = meshes.facets(quads)
        if facets <= MOST_FACETS and 84 + 50 * facets <= MOST_BYTES and _weldable(meshes, formats, quads):
            return quads
    if not force:
        facets = meshes.facets(QUADS[-1])
        _refuse_facets("stl", facets, QUADS[-1], window.lattice.count, at_least=False)
    return QUADS[-1]


def quads_for_slope(window: Window, slope_error: float, force: bool = False) -> int:
    """Least number of quads a cell side whose rms slope error is at most the one asked for (radians).

    Raises
    ------
    LimitRefused
        The files would pass the limits; the message says what they allow.
    """
    from clacad.export.tessellation import one_cell
    from clacad.mesh import forecast_quads

    try:
        quads = forecast_quads(one_cell(window), slope_error)
    except ValueError as error:
        short = re.sub(r"\d{16,}", lambda long: f"{Decimal(long[0]):.3g}", str(error))
        raise LimitRefused(f"a slope error of {slope_error:g} rad is out of reach: {short}") from error
    if not force and facets_at_least(window, quads) * 50 > MOST_BYTES:
        _refuse_facets("stl", facets_at_least(window, quads), quads, window.lattice.count)
    return quads


def _weldable(meshes: Meshes, formats: Sequence[str], quads: int) -> bool:
    return all(meshes.welded(quads, f) <= MOST_WELDED for f in formats if f in WELDED_FORMATS)


def facets_at_least(window: Window, quads: int) -> int:
    """Bound from below on the facets, before any mesh is made: half the grid, should a lens not fill its cell."""
    structured = sum(face.array is not None for face in window.faces)
    return quads * quads * structured * window.lattice.cell_count


def forecast(
    meshes: Meshes, formats: Sequence[str], quads: int, step: Mode = "auto", pcurves: bool = True
) -> list[Forecast]:
    """Forecast each format.

    Parameters
    ----------
    meshes : Meshes
    formats : sequence of str
    quads : int
        Facet grid a cell side for the mesh formats.
    step : "auto", "fused" or "instanced"
    pcurves : bool
        Whether STEP files hold parameter curves.
    """
    return timed([_forecast_one(meshes, name, quads, step, pcurves) for name in formats])


def timed(rows: Sequence[Forecast]) -> list[Forecast]:
    """Rows with the seconds they will take on this machine, by what it took before."""
    rates = Rates.here()
    spans = [rates.span(row.task, row.modelled) for row in rows]
    return [replace(row, seconds=(span.low, span.high)) for row, span in zip(rows, spans, strict=True)]


def _forecast_one(meshes: Meshes, name: str, quads: int, step: Mode, pcurves: bool = True) -> Forecast:
    window = meshes.window
    if name in ("stl", "stl-parts"):
        files = 1 if name == "stl" else len(window.bodies)
        return _forecast_stl(name, meshes.facets(quads), files, quads, exact=True)
    if name in WELDED_FORMATS:
        return _forecast_welded(meshes, name, quads)
    if name == "step":
        return _forecast_step(window, step, pcurves)
    if name in FIXTURES:
        return _forecast_fixture(window, name)
    return _forecast_map(window, name)


def _forecast_fixture(window: Window, name: str) -> Forecast:
    """Price of baffle, frame, coupon and BREP: the first exactly, the modelled ones by size classes."""
    cells = window.lattice.cell_count
    if name == "baffle":
        sides = len(window.lattice.steps)
        row = Forecast(name, 84 + 50 * 6 * sides * cells, False, 6 * sides * cells, None,
                       cost.stl(6 * sides * cells), (80_000_000, 400_000_000))  # fmt: skip
        return row
    size = {"frame": 400_000, "coupon": 2_000_000}.get(name, 15_000 + 8_000 * cells * len(window.bodies))
    return Forecast(name, size, False, None, None, cost.kernel(size), (500_000_000, 2_500_000_000))


def _forecast_stl(name: str, facets: int, files: int, quads: int, exact: bool) -> Forecast:
    size = 84 * files + 50 * facets
    return Forecast(name, size, exact, facets, quads, cost.stl(facets), (80_000_000, 400_000_000))


def _forecast_welded(meshes: Meshes, name: str, quads: int) -> Forecast:
    from clacad.export.sizes import glb_place_bytes, threemf_bytes
    from clacad.export.tessellation import instanceable

    window = meshes.window
    held = meshes.welded(quads, name)
    instanced = name != "ply" and instanceable(window)
    places = window.lattice.cell_count * len(window.bodies) if instanced else 0
    facets = held * window.lattice.cell_count if instanced else held
    # Half a vertex a facet, and more where walls and rims give corners normals of their own.
    vertices = held * (0.5 + 1.9 / max(quads, 2))
    if name == "ply":
        size = int(48 * vertices + 13 * held) + 300
    elif name == "glb":
        nodes = glb_place_bytes(window) * places if places else 0.0
        size = int(24 * vertices + 12 * held + nodes + 2500)
    else:
        size = threemf_bytes(meshes, quads)
    memory = int(700 * held + 400 * places)
    seconds = cost.welded(name, held, places)
    return Forecast(
        name, size, False, facets, quads, seconds, (memory // 2 + 100_000_000, 2 * memory + 200_000_000)
    )


def _forecast_step(window: Window, step: Mode, pcurves: bool = True) -> Forecast:
    from clacad.export.sizes import step_bytes
    from clacad.export.step import chosen_mode

    mode = chosen_mode(window, step)
    columns = window.lattice.cell_count * len(window.bodies)
    if mode == "fused":
        memory = (400_000_000, 900_000_000 + 250_000 * columns)
    else:
        memory = (300_000_000, 700_000_000 + 20_000 * columns)
    size = step_bytes(window, mode, pcurves)
    return Forecast("step", size, False, None, None, cost.step(size, mode), memory)


def _forecast_map(window: Window, name: str, levels: int = 64) -> Forecast:
    from clacad.export import sizes
    from clacad.export.sag import samples_per_cell, structured_faces

    faces, cells = len(structured_faces(window)), window.lattice.cell_count
    per_cell = samples_per_cell(window, None) if name != "xyz" else min(16, samples_per_cell(window, None))
    pixels = per_cell * per_cell * cells * faces
    if name == "png":
        size = sizes.png_bytes(window, per_cell)
    elif name == "table":
        size = sizes.table_bytes(window)
    elif name == "mask":
        size = sizes.mask_bytes(window)
    elif name == "gds":
        from clacad.export.gds import gds_bytes

        size = gds_bytes(window, levels, sizes.mm(window))
    elif name == "pov":
        size = sizes.pov_bytes(window)
    elif name == "xyz":
        size = sizes.xyz_bytes(window, per_cell)
    else:  # six bytes a pixel of two TIFFs, one cell of 65 x 65 lines of 70
        size = {"tiff": 6 * pixels, "sag": faces * 70 * 65 * 65}[name]
    drawn = {"tiff": pixels, "png": pixels, "xyz": pixels, "pov": 1, "gds": faces * 64 * 64}.get(
        name, 100 * cells * faces
    )
    return Forecast(name, size, False, None, None, cost.map(name, drawn, faces), (100_000_000, 400_000_000))


# -- limits --------------------------------------------------------------------------------------


def refuse_over_limits(meshes: Meshes, rows: Sequence[Forecast], folder: Path) -> None:
    """Hold a forecast against the limits: facets, bytes a file, free memory, free disk.

    Raises
    ------
    LimitRefused
        With the number, the limit, and two ways to get under it.
    """
    window = meshes.window
    memory, disk = free_memory(), free_disk(folder)
    for row in rows:
        if row.facets is not None and row.quads is not None and row.format in ("stl", "stl-parts"):
            _refuse_facets(row.format, row.facets, row.quads, window.lattice.count, at_least=False)
        held = meshes.welded(row.quads or 4, row.format) if row.format in WELDED_FORMATS else 0
        if held > MOST_WELDED:
            raise LimitRefused(
                f"{row.format}: {count_text(held)} facets with shared vertices are more than "
                f"{count_text(MOST_WELDED)}; use fewer quads or fewer cells, or stl, which is a stream (or force it)"
            )
        if row.bytes > MOST_BYTES:
            raise LimitRefused(
                f"{row.format}: about {size_text(row.bytes)} are more than {size_text(MOST_BYTES)} a file; "
                f"{_smaller(row, window)} (or force it)"
            )
        if row.memory[0] > MEMORY_SHARE * memory:
            raise LimitRefused(
                f"{row.format}: at least {size_text(row.memory[0])} of memory, more than 80 % of the {size_text(memory)} that "
                f"are free; {_smaller(row, window)} (or force it)"
            )
    total = sum(row.bytes for row in rows)
    if total > 0.95 * disk:
        raise LimitRefused(
            f"about {size_text(total)} are to be written and {size_text(disk)} are free in {folder}; "
            "use another folder, or fewer cells"
        )


def _smaller(row: Forecast, window: Window) -> str:
    if row.format == "step":
        return "use --step instanced, or --cells 50x50"
    if row.quads is not None:
        return f"use fewer quads than {row.quads}, or fewer cells than {window.lattice.count[0]} x {window.lattice.count[1]}"
    return f"use fewer cells than {window.lattice.count[0]} x {window.lattice.count[1]}, or format table"


def free_memory() -> int:
    """Bytes of memory that could be had now; a container's limit counts."""
    available = 1 << 62
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                available = int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
            available = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    try:
        limit = int(Path("/sys/fs/cgroup/memory.max").read_text())
        used = int(Path("/sys/fs/cgroup/memory.current").read_text())
        available = min(available, max(0, limit - used))
    except (OSError, ValueError):
        pass
    return available


def free_disk(folder: Path) -> int:
    """Bytes free where `folder` is or will be."""
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    try:
        return shutil.disk_usage(place).free
    except OSError:
        return 1 << 62


def outlook(window: Window) -> list[dict[str, Any]]:
    """Forecast the common formats for `check`: roughly what an export with default settings would cost.

    Meant to be quick: only meshes of 4 and 8 quads are counted, finer ones follow from them. Each row is
    `Forecast.to_dict()` with "refused": None or the sentence an export would be refused with.
    """
    from clacad.export.tessellation import Meshes

    try:
        n1, n2 = window.lattice.count
        _refuse_cells(int(n1), int(n2))
    except LimitRefused as refusal:  # said, not counted: counting facets walks along the outline
        return [{"format": name, "refused": str(refusal)} for name in ("step", "stl", "3mf")]
    meshes = Meshes(window)
    square = (meshes.facets(8) - 2 * meshes.facets(4)) / 32
    linear = meshes.facets(4) / 4 - 4 * square
    facets = {quads: int(linear * quads + square * quads * quads) for quads in QUADS}
    quads = next(
        (q for q in QUADS if 84 + 50 * facets[q] <= MOST_BYTES and facets[q] <= MOST_FACETS), QUADS[-1]
    )
    plain = _forecast_stl("stl", facets[quads], 1, quads, exact=quads <= 8)
    rows = [_forecast_step(window, "auto"), plain, _forecast_one(meshes, "3mf", 8, "auto")]
    return [row.to_dict() | {"refused": _refusal(meshes, row)} for row in timed(rows)]


def _refusal(meshes: Meshes, row: Forecast) -> str | None:
    try:
        refuse_over_limits(meshes, [row], Path())
    except LimitRefused as refusal:
        return str(refusal)
    return None


def count_text(n: int) -> str:
    """Number for a person: 12,345 or 1.2e18."""
    return f"{n:,}" if n < 10**10 else f"{Decimal(n):.3g}"  # an int may be too large for a float


def size_text(n: int | float | Decimal) -> str:
    """Bytes for a person: 1.5 GB."""
    n = Decimal(n)
    for unit in ("bytes", "kB", "MB", "GB", "TB", "PB"):
        if n < 1000 or unit == "PB":
            return f"{n:.0f} {unit}" if unit == "bytes" else f"{n:.3g} {unit}"
        n /= 1000
    raise AssertionError("unreachable: the loop ends with PB")
