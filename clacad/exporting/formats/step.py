"""STEP: exact solids, fused or as an assembly of one cell."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from math import ceil, log10
from typing import TYPE_CHECKING, Literal

from clacad.base.untrusted_files import BUDGETS
from clacad.exporting.formats.format import (
    ChosenMesh,
    FileKind,
    Forecast,
    Format,
    about_number,
    own_cells_note,
)
from clacad.exporting.roles import EXACT_FACES

if TYPE_CHECKING:
    from clacad.exporting.formats.format import RoughSheet
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.exporting.tessellations import Meshes
    from clacad.sheet.plate import Plate
    from clacad.sheet.window import Window

WORD = "step"

OWN_CELLS = 1.3
"""Text length of a non-uniform sheet over that of a uniform one: its cells share no parameter curves."""

OWN_CELL_SECONDS = 0.0003
"""Seconds per cell with a lens of its own, in addition to those of its text."""

FUSED_CELL = {"straight": 4700, "hexagonal": 7200, "tilted": 15_000}
"""Bytes per lenslet and body in a fused file; walls of tilted lenslets are wavy."""

BORDER_BYTES = 1600
"""Text of the border of an assembly for a cell along x and one along y: its edges follow the cells."""

PLACE_BYTES = 580
"""Text of one place of an assembly."""

EDGE_BYTES = 1900
"""Text of one side face of a plate, its edges and curves included, about."""


def _write(job: Job) -> list[FileRecord]:
    """Write, read back with OCC and compare in the worker."""
    from clacad.exporting.step_record import step_record

    return [step_record(job, WORD)]


# -- cost ------------------------------------------------------------------------------------------


def _seconds(size: int, mode: str) -> float:
    """Seconds to write STEP text and read it in a separate process, with OCC where it is not too large."""
    if size > BUDGETS["step"].bytes:
        return 0.6 + 6e-8 * size
    return 0.68 + 1.12e-6 * size if mode == "fused" else 0.6 + 3e-6 * size


def _rough_bytes(sheet: RoughSheet, fused: bool) -> int:
    """Bytes within 20 % for an assembly, within a factor of two for fused solids with their walls."""
    if not fused:
        return sheet.bodies * (20_000 + 500 * sum(sheet.count))
    kind = "tilted" if sheet.tilted else "hexagonal" if sheet.hexagonal else "straight"
    return sheet.lenses * FUSED_CELL[kind] * sheet.cells // 2


def _rough_seconds(sheet: RoughSheet, _quads: int, asked: Request) -> float:
    from clacad.formats.step.part21 import FUSED_CELLS

    fused = asked.step == "fused" or (asked.step == "auto" and sheet.cells <= FUSED_CELLS)
    return _seconds(_rough_bytes(sheet, fused), "fused" if fused else "instanced")


def _forecast(meshes: Meshes, _quads: int, asked: Request) -> Forecast:
    from clacad.formats.step.part21 import chosen_mode

    mode = chosen_mode(meshes.window, asked.step)
    return _row(meshes.window, mode, step_bytes(meshes.window, mode, asked.pcurves))


def _at_a_glance(window: Window, sheet: RoughSheet, _chosen: ChosenMesh | None) -> Forecast:
    from clacad.formats.step.part21 import chosen_mode

    mode = chosen_mode(window, "auto")
    size = _rough_bytes(sheet, mode == "fused" or not window.uniform)
    if not window.uniform:  # each cell is written out
        size = int(OWN_CELLS * size) // _copies(window, mode)
    elif mode == "instanced" and window.outline is not None:
        size += BORDER_BYTES * sum(sheet.count) * sheet.bodies
    return _row(window, mode, about_number(size))


def _row(window: Window, mode: Literal["fused", "instanced"], size: int) -> Forecast:
    copies = _copies(window, mode)
    columns = window.lattice.cell_count * len(window.bodies) // copies
    if mode == "fused":
        each = 250_000 if window.uniform else 50_000  # non-uniform: cells are described one by one
        memory = (400_000_000, 900_000_000 + each * columns)
    elif not window.uniform:
        memory = (300_000_000, 900_000_000 + 50_000 * columns)
    else:
        written_out = columns if window.lattice.outline is not None else 0  # else rows stay rows
        memory = (250_000_000, 700_000_000 + 100 * size + 1000 * written_out)
    modelled = _seconds(size, mode) + (0.0 if window.uniform else OWN_CELL_SECONDS * columns)
    return Forecast(WORD, size, False, None, None, modelled, memory, note=own_cells_note(window, copies))


def _copies(window: Window, mode: Literal["fused", "instanced"]) -> int:
    """Number of turned copies of the cells that the file of a non-uniform sheet holds; else 1."""
    from clacad.sheet.representative_cells import sectors_of

    return 1 if mode == "fused" or window.uniform else sectors_of(window)


def step_bytes(window: Window, mode: Literal["fused", "instanced"], pcurves: bool = True) -> int:
    """Size of the STEP file, from the text of small sheets: it grows as A + B (n1 + n2) + C n1 n2."""
    from clacad.formats.step.step_files import step_text_length
    from clacad.sheet.like_cell import like_cell
    from clacad.sheet.plate import Plate
    from clacad.sheet.representative_cells import representative_cells

    n1, n2 = window.lattice.count
    if max(n1, n2) <= 8:
        return step_text_length(window, mode, pcurves)
    if not window.uniform:  # the same number of cells like the outermost one, each written out
        like = like_cell(window, representative_cells(window, "displaced")[0])
        return int(OWN_CELLS * step_bytes(like, "fused", pcurves)) // _copies(window, mode)
    if isinstance(window.outline, Plate):
        return _plate_step_bytes(window, window.outline, mode, pcurves)
    if window.lattice.outline is not None:  # a disc: its border is written piece by piece in either mode
        small, large = _smaller_sheet(window, 8), _smaller_sheet(window, 16)
        one, two = step_text_length(small, mode, pcurves), step_text_length(large, mode, pcurves)
        power = 1.0 if mode == "fused" else 0.5
        first, second, whole = (sheet.lattice.cell_count**power for sheet in (small, large, window))
        return int(two + (two - one) / (second - first) * (whole - second)) if second > first else two
    if mode == "instanced":
        a, b = (step_text_length(_smaller_sheet(window, n), mode, pcurves) for n in (2, 6))
        return int(a + (b - a) / 8 * (n1 + n2 - 4))
    a, b, c = (step_text_length(_smaller_sheet(window, n), mode, pcurves) for n in (1, 4, 8))
    # Through n = 1, 4, 8 on the diagonal: f = A + B n + C n^2. Longer numbers add some per cent a decade.
    square = ((c - b) / 4 - (b - a) / 3) / 7
    linear = (b - a) / 3 - 5 * square
    digits = 1.0 + 0.07 * max(0.0, log10(n1 * n2 / 64))
    return int((a - linear - square + 0.5 * linear * (n1 + n2) + square * n1 * n2) * digits)


def _plate_step_bytes(
    window: Window, plate: Plate, mode: Literal["fused", "instanced"], pcurves: bool
) -> int:
    """Size of the STEP file of a plate: that of a plain sheet, and that of its edges.

    Fused, the plain sheet has as many cells; else it is as wide, and so has as many faces along its border.
    """
    n1, n2 = window.lattice.count
    edges = EDGE_BYTES * len(plate.edges) * len(window.bodies)
    if mode == "instanced":
        runs = (_places(window) - n1 - n2) * len(window.bodies) * PLACE_BYTES
        return step_bytes(window.with_cells((n1, n2)), mode, pcurves) + edges + max(0, runs)
    side = max(1, round(window.lattice.cell_count**0.5))
    plain = window.with_cells((side, max(1, round(window.lattice.cell_count / side))))
    return step_bytes(plain, mode, pcurves) + edges


def _places(window: Window) -> int:
    """Places of one body whose rows are made of runs of 2^k cells (see `step_files`), about."""
    lengths = Counter(window.lattice.cells()[:, 1].tolist()).values()
    return len(lengths) + 2 * max(lengths).bit_length() + sum(n.bit_count() for n in set(lengths))


def _smaller_sheet(window: Window, n: int) -> Window:
    """A sheet of about n × n of the same cells, with the same border."""
    from clacad.sheet.lattice import Circle, Rectangle

    lattice = window.lattice
    if isinstance(lattice.outline, Circle):
        share = min(1.0, n / max(lattice.count))
        disc = Circle(lattice.outline.diameter * share)
        count = (ceil(lattice.count[0] * share), ceil(lattice.count[1] * share))
        whole = window.outline.diameter if isinstance(window.outline, Circle) else lattice.outline.diameter
        # a border, and for a slab's displaced arrays the room that both take
        held = Circle(disc.diameter + whole - lattice.outline.diameter)
        return replace(window, lattice=replace(lattice, count=count, outline=disc), outline=held)
    small = window.with_cells((min(n, lattice.count[0]), min(n, lattice.count[1])))
    if not isinstance(window.outline, Rectangle):
        return small
    x0, x1, y0, y1 = lattice.extent()
    u0, u1, v0, v1 = small.lattice.extent()
    width, height = (
        window.outline.width - (x1 - x0) + (u1 - u0),
        window.outline.height - (y1 - y0) + (v1 - v0),
    )
    if isinstance(small.outline, Rectangle):  # a displaced cell of a slab needs more than its widest array
        width, height = max(width, small.outline.width), max(height, small.outline.height)
    return replace(small, outline=Rectangle(width, height))


FORMATS = (
    Format(
        WORD,
        "exact",
        "exact solids of all bodies, for CAD and machining",
        _write,
        _forecast,
        _rough_seconds,
        at_a_glance=_at_a_glance,
        fusable=True,
        kernel=True,
        smaller="--step instanced, or --cells 50x50",
        stored=(EXACT_FACES,),
    ),
)

FILES = (
    FileKind(
        WORD, "solid", (".step", ".stp"), states_unit=True, native=True, text_budget="step-text", older=True
    ),
)
