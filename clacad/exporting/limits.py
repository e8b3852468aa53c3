"""Limits on cells, facets, bytes, memory and disk, and refusals of an export before its first byte.

Cells and facets are counted in integers, so a design of 10^18 lenslets is refused as fast as one of 10^8.
Every refusal of a size gives the number, the limit and two ways to stay below it. Each format checks its own
requirements (an installed extra, a gap, a border, room for a line of text); the reasons are given together.

Limits of size, and bodies that cannot be built, are found by the forecast and collected here too.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from decimal import Decimal
from math import isqrt
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.base.text import number_text, size_text
from clacad.exporting.formats.format import STREAM_FACET, stream_bytes
from clacad.exporting.formats.registry import format_of, formats
from clacad.storage.errors import BadRequest, ExportError, LimitRefused, NotPossible
from clacad.storage.worker import MEMORY_SHARE, free_memory

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.exporting.formats.format import Forecast
    from clacad.exporting.request import Quads, Request
    from clacad.sheet.window import Window
    from clacad.storage.worker import Worker


MOST_FACETS = 50_000_000
MOST_BYTES = 2_000_000_000
MOST_CELLS = 10_000_000
"""Largest number of lenslets of one array; formats that list cells then finish within minutes."""
QUADS = (64, 32, 16, 8, 4)
"""Facet grids per cell side from which "auto" chooses, finest first."""


def refuse_uncountable(design: Design) -> None:
    """Refuse a design of more than `MOST_CELLS` lenslets; integer arithmetic only. Raises LimitRefused."""
    n1, n2 = (int(n) for n in design.lattice.count)
    refuse_cells(n1, n2)


def refuse_early(design: Design, words: Sequence[str], quads: Mapping[str, Quads]) -> None:
    """Refuse a design whose count of lenslets alone exceeds the limits; integer arithmetic only.

    words : Formats.
    quads : Format → requested facet grid; the coarsest is used if none or "auto" was requested.
    Raises LimitRefused.
    """
    refuse_uncountable(design)
    n1, n2 = design.lattice.count
    cells = n1 * n2
    if design.lattice.outline is not None:
        return
    faces = 4 if design.pair.form == "biconvex" else 2
    if design.pair.form == "plates":
        from clacad.design.faces import listed_lenses

        faces, _ = listed_lenses(design.pair.face)
    for name in words:
        if format_of(name).family == "stream":
            asked = quads.get(name, "auto")
            grid = QUADS[-1] if asked == "auto" else asked
            across = (
                1 if design.law_spec.cylinders or design.pair.given else grid
            )  # cylinders take one along them
            _refuse_facets(name, grid * across * cells * faces, grid, (n1, n2))


def refuse_cells(n1: int, n2: int) -> None:
    """Refuse more than `MOST_CELLS` lenslets. Raises LimitRefused."""
    if n1 * n2 > MOST_CELLS:
        side = isqrt(MOST_CELLS)
        raise LimitRefused(
            f"{number_text(n1 * n2)} lenslets ({n1} x {n2}) are more than the {number_text(MOST_CELLS)} that"
            f" are written; use lattice.count up to [{side}, {side}], or export a part with"
            f" cells=({min(n1, 100)}, {min(n2, 100)})"
        )


def _refuse_facets(
    format: str, facets: int, quads: int, count: tuple[int, int], at_least: bool = True
) -> None:
    """Refuse an STL of more facets or bytes than the limits; `count`: cells each way, for the remedy."""
    size = stream_bytes(facets)
    if facets <= MOST_FACETS and size <= MOST_BYTES:
        return
    most = min(MOST_FACETS, MOST_BYTES // STREAM_FACET)
    coarser = isqrt(max(0, quads * quads * most // facets))
    part = max(1, isqrt(count[0] * count[1] * most // facets))
    ways = [f"cells=({part}, {part})"]
    if coarser >= 2:
        ways.insert(0, f"quads={coarser}")
    else:
        ways.append("format 3mf or step, which repeat one cell")
    raise LimitRefused(
        f"{format}: {'at least ' if at_least else ''}{number_text(facets)} facets, {size_text(size)} at"
        f" {quads} quads a cell side, are more than {number_text(MOST_FACETS)} facets or"
        f" {size_text(MOST_BYTES)}; use {' or '.join(ways)} (or force it)"
    )


def quads_for_slope(window: Window, slope_error: float, force: bool = False) -> int:
    """Least number of quads per cell side whose rms slope error is at most the requested one (radians).

    Raises LimitRefused: The files would exceed the limits; the message gives the slope error that they allow.
    """
    from clacad.exporting.tessellations import one_cell
    from clacad.mesh import forecast_quads

    try:
        quads = forecast_quads(one_cell(window) if window.uniform else window, slope_error)
    except ValueError as error:
        short = re.sub(r"\d{16,}", lambda long: f"{Decimal(long[0]):.3g}", str(error))
        raise LimitRefused(f"a slope error of {slope_error:g} rad is out of reach: {short}") from error
    if not force and facets_at_least(window, quads) * STREAM_FACET > MOST_BYTES:
        stream = next(one.word for one in formats() if one.family == "stream")
        _refuse_facets(stream, facets_at_least(window, quads), quads, window.lattice.count)
    return quads


def facets_at_least(window: Window, quads: int) -> int:
    """Lower bound on the facets before any mesh is made: half the grid, as a lens may not fill its cell."""
    from clacad.sheet.grid_steps import lens_squares

    return lens_squares(window, quads) * window.lattice.cell_count


def refuse_over_limits(window: Window, rows: Sequence[Forecast], folder: Path) -> None:
    """Compare a forecast with the limits: facets, bytes per file, free memory, free disk.

    Raises LimitRefused: The message gives the number, the limit, and two ways to stay below it.
    """
    memory, disk = free_memory(), free_disk(folder)
    for row in rows:
        family = format_of(row.format).family
        if row.facets is not None and row.quads is not None and family == "stream":
            _refuse_facets(row.format, row.facets, row.quads, window.lattice.count, at_least=False)
        if row.bytes > MOST_BYTES:
            raise LimitRefused(
                f"{row.format}: about {size_text(row.bytes)} are more than {size_text(MOST_BYTES)} a file; "
                f"{_smaller(row, window)} (or force it)"
            )
        if row.memory[0] > MEMORY_SHARE * memory:
            raise LimitRefused(
                f"{row.format}: at least {size_text(row.memory[0])} of memory, more than 80 % of the"
                f" {size_text(memory)} that are free; {_smaller(row, window)} (or force it)"
            )
    total = sum(row.bytes for row in rows)
    if total > 0.95 * disk:
        raise LimitRefused(
            f"about {size_text(total)} are to be written and {size_text(disk)} are free in {folder}; "
            "use another folder, or fewer cells"
        )


def refuse_many_places(window: Window, word: str, listed: int, what: str, most: int, way: str) -> None:
    """Refuse a file that lists more repeated cells than its reader takes; forcing it does not help.

    word : Format.
    listed, most : Number of listed items, and the limit of the reader.
    what : Kind of the items, in the plural.
    way : Options that avoid them.
    Raises LimitRefused.
    """
    if listed > most:
        bodies = len(window.bodies)
        side = isqrt((most - 1000 * bodies) // bodies)
        raise LimitRefused(
            f"{word}: {number_text(listed)} {what} are more than the {number_text(most)} that are read back;"
            f" use {way} or --cells {side}x{side}"
        )


def _smaller(row: Forecast, window: Window) -> str:
    smaller = format_of(row.format).smaller
    if smaller:
        return f"use {smaller}"
    if row.quads is not None:
        return (
            f"use fewer quads than {row.quads}, or fewer cells than {window.lattice.count[0]} x"
            f" {window.lattice.count[1]}"
        )
    return f"use fewer cells than {window.lattice.count[0]} x {window.lattice.count[1]}, or format table"


def free_disk(folder: Path) -> int:
    """Bytes free where `folder` is or will be."""
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    try:
        return shutil.disk_usage(place).free
    except OSError:
        return 1 << 62


class Refusals:
    """Refusals of formats, collected until all formats have been checked."""

    def __init__(self) -> None:
        self._found: dict[str, Exception] = {}

    def __contains__(self, format: object) -> bool:
        return format in self._found

    def __bool__(self) -> bool:
        return bool(self._found)

    @contextmanager
    def of(self, *formats: str) -> Iterator[None]:
        """Keep a refusal raised in the block as that of some formats; program errors propagate."""
        try:
            yield
        except (ExportError, ValueError) as error:
            if getattr(error, "exit_status", None) is None:
                raise
            from clacad.sheet.volume_and_extent import NoFixture  # cells are counted without the sheet

            refusal = NotPossible(str(error)) if isinstance(error, NoFixture) else error
            self._found |= dict.fromkeys(formats, refusal)

    def complete(self) -> None:
        """Refuse the export if any format was.

        Raises ExportError, ValueError: The refusal, if there is only one; else their common type, or
            `NotPossible`, with all of them.
        """
        by_text: dict[str, list[str]] = {}
        for name, error in self._found.items():
            by_text.setdefault(str(error), []).append(name)
        if not by_text:
            return
        errors = list(self._found.values())
        if len(by_text) == 1:
            raise errors[0]
        kinds = {type(error) for error in errors}
        kind = kinds.pop() if len(kinds) == 1 and issubclass(type(errors[0]), ExportError) else NotPossible
        raise kind("\n".join(_line(names, text) for text, names in by_text.items()))


def _line(formats: list[str], text: str) -> str:
    """Text of a refusal, prefixed with its formats unless it already begins with them."""
    named = ", ".join(formats)
    return text if text.startswith((f"{named}:", f"format {named}")) else f"{named}: {text}"


def refuse_other_cells(window: Window, word: str) -> None:
    """Refuse a format that cannot hold the cells of a non-uniform sheet. Raises CellsDiffer."""
    one = format_of(word)
    if any(face.form for face in window.faces) and not one.commands:
        words = ", ".join(other.word for other in formats() if other.commands)
        raise NotPossible(f"format {word}: forms of a correction (process.command) are held by: {words}")
    if not one.holds(window):
        from clacad.sheet.need_window import need_equal_cells
        from clacad.sheet.representative_cells import central_cell

        held = sorted((one for one in formats() if one.holds(window)), key=lambda one: one.family != "exact")
        way = "--cell {},{} takes one cell of it; ".format(*central_cell(window)) if one.of_cell else ""
        listed = ", ".join(one.word for one in held)
        need_equal_cells(window, f"format {word}", f"{way}such sheets are held by: {listed}")


def refuse_no_cell(window: Window, cell: tuple[int, int]) -> None:
    """Refuse a cell that the sheet does not have. Raises BadRequest with the range of the indices."""
    (i, j), lattice = cell, window.lattice
    own: list[int] = lattice.row(j)[:, 0].tolist() if 0 <= j < lattice.count[1] else []
    if i in own:
        return
    if own:
        raise BadRequest(f"cell {i},{j}: row {j} of the sheet has the cells {own[0]},{j} to {own[-1]},{j}")
    rows = [k for k in range(lattice.count[1]) if len(lattice.row(k))]
    raise BadRequest(f"cell {i},{j}: the sheet has cells in rows j = {rows[0]} to {rows[-1]}")


def require_possible(window: Window, word: str, asked: Request, worker: Worker) -> None:
    """Refuse a format that is impossible for a design; only long text in a small space needs the worker.

    Raises NotPossible, NoFixture, LimitRefused, CannotBuild.
    Raises CellsDiffer: The format holds uniform sheets only.
    Raises WorkerDied: The letters could not be drawn.
    """
    one = format_of(word)
    sheet = one.sheet_of(window, asked)
    refuse_other_cells(sheet, word)
    one.require(sheet, asked, worker)


def refuse_idle(asked: Request) -> None:
    """Refuse the options `fused` and `cell` where no requested format has them. Raises BadRequest."""
    fusable = {one.word: one.fusable for one in formats()}
    of_cell = {one.word: one.of_cell for one in formats()}
    for name, given, has in (("fused", asked.fused, fusable), ("cell", asked.cell is not None, of_cell)):
        if given and not any(has.get(word, True) for word in asked.formats):
            raise BadRequest(
                f"{name}: it applies to {', '.join(word for word in has if has[word])}, and the requested"
                f" formats are {', '.join(asked.formats)}; leave it out"
            )
