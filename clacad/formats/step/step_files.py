"""STEP files: exact solids as AP242 or AP214, fused or instanced, and their re-reading. Lengths in mm.

`write_step` needs no CAD kernel; `read_step` reports what OCC finds in a file, without knowing how it was
made. Both return plain facts (JSON-able).
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, cycle
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.formats.step.cell_text import SheetWriter
from clacad.formats.step.part21 import Mode, Part21, StepColour, chosen_mode
from clacad.formats.step.read_back import read_step
from clacad.formats.step.shell_text import TextWriter
from clacad.sheet.face_order import plates_of
from clacad.sheet.representative_cells import sector
from clacad.sheet.window import Body, Window
from clacad.solid.shells import MERGE, ShellCounts, Shells
from clacad.solid.solids import describe_body, describe_layers, layers, middle_plane, single
from clacad.solid.tilings import Layer

__all__ = ["read_step", "step_text_length", "write_step", "write_step_stack"]

Schema = Literal["AP242", "AP214"]
Part = tuple[int, int]

PROGRAM = "clacad"

BODY_COLOURS = (StepColour(0.62, 0.78, 0.90), StepColour(0.90, 0.80, 0.62))
_BREP = "ADVANCED_BREP_SHAPE_REPRESENTATION"
LAND_COLOUR = StepColour(0.25, 0.25, 0.28)
"""Colour of land, separate so that it can be found and painted black."""


def write_step(
    window: Window,
    path: str | os.PathLike[str],
    mode: Mode = "auto",
    schema: Schema = "AP242",
    pcurves: bool = True,
    merge: float = MERGE,
) -> dict[str, Any]:
    """Write a window as a STEP file.

    path : Written in place; publish it atomically from outside.
    mode : "auto", "fused" or "instanced". fused: one closed solid per connected piece; instanced: an assembly
        cell → row → body of touching solids, sector → body of a non-uniform sheet; auto: fused up to 2500
        cells.
    schema : "AP242" or "AP214"
    pcurves : Write the exact parameter curves (fused). Without them files shrink and readers recompute them.
    merge : mm. Heights closer than this are merged (see `describe_body`).
    Returns: mode, schema, pcurves, unit, bytes, solids, faces, bodies (per body: name, solids, faces by
        role), saddles, wedges, merged_steps, merge, largest_shift, fit_error and rim_error (largest distance
        of fitted lens faces and of fitted rims from the true ones, mm; 0 where all are exact), placed (solids
        counted with their instances).
    Raises ValueError: The window cannot be built as solids, or an argument is not one of its choices.
    Raises OSError: The file cannot be written.
    """
    chosen = chosen_mode(window, mode)
    with open(path, "w", encoding="ascii", newline="\n") as stream:
        facts = _write(window, stream, chosen, schema, pcurves, merge)
    size = Path(path).stat().st_size
    return {"mode": chosen, "schema": schema, "pcurves": pcurves, "unit": "mm", "bytes": size, **facts}


class _Counted(io.StringIO):
    """A stream that only counts what is written to it."""

    def __init__(self) -> None:
        super().__init__()
        self.length = 0

    def write(self, text: str) -> int:
        """Count characters."""
        self.length += len(text)
        return len(text)


def step_text_length(window: Window, mode: Literal["fused", "instanced"], pcurves: bool = True) -> int:
    """Bytes of the STEP file of a window, from its text, which is generated and discarded.

    Raises ValueError: The window cannot be built as solids.
    """
    stream = _Counted()
    _write(window, stream, mode, "AP242", pcurves, MERGE)
    return stream.length


def _write(
    window: Window, stream: IO[str], mode: str, schema: str, pcurves: bool, merge: float
) -> dict[str, Any]:
    pitch = min(window.lattice.pitch) * millimetres(window.unit)
    part = Part21(stream, schema, window.name, PROGRAM, pitch)
    sheet = _SHEET[mode](window, part, pcurves, merge)
    part.presentation(sheet.styles)
    part.close()
    return {"merge": merge, **_total(sheet.bodies)}


def write_step_stack(
    placed: Sequence[tuple[str, Window, float]],
    name: str,
    path: str | os.PathLike[str],
    mode: Mode = "auto",
    schema: Schema = "AP242",
    pcurves: bool = True,
    merge: float = MERGE,
) -> dict[str, Any]:
    """Write several windows as one assembly, each moved along z; a window that occurs twice is written once.

    placed : sequence of (name, window, z). z in mm, of the window's own z = 0.
    name : Of the assembly.
    path, mode, schema, pcurves, merge : As in `write_step`; "auto" decides for each window.
    Returns: schema, pcurves, unit, bytes, merge and the totals of `write_step`; sheets: for each the facts of
        `write_step`, with its name and z.
    Raises ValueError, OSError: As in `write_step`.
    """
    pitch = min(min(window.lattice.pitch) * millimetres(window.unit) for _, window, _ in placed)
    made: dict[int, tuple[_Sheet, str]] = {}
    with open(path, "w", encoding="ascii", newline="\n") as stream:
        part = Part21(stream, schema, name, PROGRAM, pitch)
        for _, window, _ in placed:
            if id(window) not in made:
                chosen = chosen_mode(window, mode)
                made[id(window)] = (_SHEET[chosen](window, part, pcurves, merge), chosen)
        spots = [part.placement(np.array([0.0, 0.0, z])) for *_, z in placed]
        whole = part.product(name, [part.origin, *spots], "SHAPE_REPRESENTATION")
        for (title, window, _), spot in zip(placed, spots, strict=True):
            part.component(whole, made[id(window)][0].product, title, spot)
        part.presentation([style for sheet, _ in made.values() for style in sheet.styles])
        part.close()
    sheets, bodies = [], []
    for title, window, z in placed:
        sheet, kind = made[id(window)]
        own = {"name": title, "z": z, "mode": kind, "pcurves": pcurves}
        sheets.append(own | _total(sheet.bodies))
        bodies += sheet.bodies
    size = Path(path).stat().st_size
    facts = {"schema": schema, "pcurves": pcurves, "unit": "mm", "bytes": size, "merge": merge}
    return {**facts, **_total(bodies), "sheets": sheets}


@dataclass(frozen=True, eq=False)
class _Sheet:
    """One window in a file: its part, the content of each of its bodies, and its colours."""

    product: Part
    bodies: list[dict[str, Any]]
    styles: list[int]


_SUMS, _WORST = ("saddles", "wedges", "merged_steps"), ("largest_shift", "fit_error", "rim_error")
"""Facts of a body of which a file states the sum, and those of which it states the largest."""


def _total(bodies: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Facts of a file from those of its bodies."""
    return {
        "solids": sum(body["solids"] for body in bodies),
        "faces": sum(sum(body["faces"].values()) for body in bodies),
        **{name: sum(body[name] for body in bodies) for name in _SUMS},
        **{name: max((body[name] for body in bodies), default=0.0) for name in _WORST},
        "bodies": bodies,
    }


def _facts(name: str, solids: int, counts: ShellCounts, parts: Sequence[Layer]) -> dict[str, Any]:
    """Facts written of one body; solids and faces counted as placed."""
    faces = [face for part in parts for face in part.cell.faces]
    return {
        "name": name,
        "solids": solids,
        "faces": dict(sorted(counts.faces.items())),
        **{fact: getattr(counts, fact) for fact in (*_SUMS, "largest_shift")},
        "fit_error": max((face.lens.error for face in faces if face.lens is not None), default=0.0),
        "rim_error": max((face.rim_error for face in faces), default=0.0),
    }


# -- fused ------------------------------------------------------------------------------------------
def _write_fused(window: Window, part: Part21, pcurves: bool, merge: float) -> _Sheet:
    facts, styles, made = [], [], dict[str, list[int]]()
    for body, colour in zip(window.bodies, cycle(BODY_COLOURS), strict=False):
        writer = SheetWriter(part, pcurves)
        shells = describe_body(window, body, writer, merge)
        made[body.name] = _solids(writer, shells, body.name)
        styles += _coloured(part, writer, shells, made[body.name], colour)
        facts.append(_facts(body.name, len(made[body.name]), shells.counts, layers(window, body)))
    if window.form != "plates":
        items = [part.origin, *chain.from_iterable(made.values())]
        return _Sheet(part.product(window.name, items, _BREP), facts, styles)
    bodies = {name: part.product(name, [part.origin, *numbers], _BREP) for name, numbers in made.items()}
    return _Sheet(_of_plates(window, part, bodies), facts, styles)


def _of_plates(window: Window, part: Part21, bodies: Mapping[str, Part]) -> Part:
    """An assembly of plates, each an assembly of its bodies."""
    plates = [
        (_assembled(part, f"plate{n}", [(bodies[one.name], np.zeros(2), one.name) for one in plate]), n)
        for n, plate in enumerate(plates_of(window.bodies), 1)
    ]
    return _assembled(part, window.name, [(plate, np.zeros(2), f"plate{n}") for plate, n in plates])


def _solids(writer: TextWriter, shells: Shells, name: str) -> list[int]:
    pieces = shells.pieces()
    if writer.unfinished:
        raise ValueError(
            f"{writer.unfinished} edges of body {name!r} have one face only; please report the design"
        )
    names = [name] if len(pieces) == 1 else [f"{name}.{n + 1}" for n in range(len(pieces))]
    return [writer.solid(faces, title) for faces, title in zip(pieces, names)]


def _coloured(
    part: Part21, writer: TextWriter, shells: Shells, solids: Sequence[int], colour: StepColour
) -> list[int]:
    styles = []
    for number, faces in zip(solids, shells.pieces()):
        whole = part.styled(number, colour)
        styles.append(whole)
        styles += [
            part.styled(writer.faces[face], LAND_COLOUR, whole)
            for face in faces
            if writer.roles[face] == "land"
        ]
    return styles


# -- instanced --------------------------------------------------------------------------------------
def _write_instanced(window: Window, part: Part21, pcurves: bool, merge: float) -> _Sheet:
    facts, styles, made = [], [], dict[str, Part]()
    for body, colour in zip(window.bodies, cycle(BODY_COLOURS), strict=False):
        fact, made[body.name], style = _instanced_body(window, body, part, pcurves, merge, colour)
        facts.append(fact)
        styles += style
    if window.form == "plates":
        return _Sheet(_of_plates(window, part, made), facts, styles)
    sheet = part.product(window.name, [part.origin], "SHAPE_REPRESENTATION")
    for name, child in made.items():
        part.component(sheet, child, name, part.origin)
    return _Sheet(sheet, facts, styles)


_SHEET: dict[str, Callable[[Window, Part21, bool, float], _Sheet]] = {
    "fused": _write_fused,
    "instanced": _write_instanced,
}


def _instanced_body(
    window: Window, body: Body, part: Part21, pcurves: bool, merge: float, colour: StepColour
) -> tuple[dict[str, Any], Part, list[int]]:
    """One body as an assembly: rows of cells, and the surrounding land as a separate part.

    A slab whose arrays are displaced has no common cell. It is cut at a plane half way into cells of the
    front array and cells of the back array, which touch there and together are exactly the slab.
    A non-uniform sheet has no common cell either: its sector is placed turned about the axis.
    """
    if not window.uniform:
        return _turned_body(window, body, part, pcurves, merge, colour)
    scale = millimetres(window.unit)
    parts = layers(window, body, middle_plane(body, window))
    placed: list[tuple[Part, Floats, str]] = []
    counts, solids, styles = ShellCounts(), 0, []
    for n, layer in enumerate(parts):
        name = body.name if len(parts) == 1 else f"{body.name} {'front' if n == 0 else 'back'}"
        bare = Layer(layer.cell, np.zeros(2), None)
        writer = TextWriter(part, pcurves)
        shells = describe_layers((bare,), single(window), None, scale, writer, merge)
        numbers = _solids(writer, shells, f"{name} cell")
        styles += _coloured(part, writer, shells, numbers, colour)
        cell = part.product(f"{name} cell", [part.origin, *numbers], _BREP)
        many = window.lattice.cell_count
        _add_counts(counts, shells.counts, many)
        solids += len(numbers) * many
        placed += _rows(window, layer, part, cell, name, scale)
        if layer.outside is not None:
            rim_writer = TextWriter(part, pcurves)
            rim = describe_layers(
                (layer,), window.lattice, window.outline, scale, rim_writer, merge, hollow=True
            )
            rims = _solids(rim_writer, rim, f"{name} border")
            styles += _coloured(part, rim_writer, rim, rims, colour)
            product = part.product(f"{name} border", [part.origin, *rims], _BREP)
            _add_counts(counts, rim.counts, 1)
            solids += len(rims)
            placed.append((product, np.zeros(2), f"{name} border"))
    return _facts(body.name, solids, counts, parts), _assembled(part, body.name, placed), styles


def _turned_body(
    window: Window, body: Body, part: Part21, pcurves: bool, merge: float, colour: StepColour
) -> tuple[dict[str, Any], Part, list[int]]:
    """One body as an assembly of turned copies of its first sector, which touch."""
    first = sector(window)
    copies, writer, counts = first.lattice.copies, SheetWriter(part, pcurves), ShellCounts()
    shells = describe_body(first, body, writer, merge)
    numbers = _solids(writer, shells, f"{body.name} sector")
    product = part.product(f"{body.name} sector", [part.origin, *numbers], _BREP)
    _add_counts(counts, shells.counts, copies)
    placed = [(product, np.zeros(2), f"{body.name} sector {n + 1}") for n in range(copies)]
    whole = _assembled(part, body.name, placed, WAYS[:: 4 // copies])
    facts = _facts(body.name, len(numbers) * copies, counts, layers(first, body))
    return facts, whole, _coloured(part, writer, shells, numbers, colour)


def _add_counts(total: ShellCounts, counts: ShellCounts, times: int) -> None:
    for role, number in counts.faces.items():
        total.faces[role] += number * times
    for fact in _SUMS:
        setattr(total, fact, getattr(total, fact) + getattr(counts, fact) * times)
    total.largest_shift = max(total.largest_shift, counts.largest_shift)


def _rows(
    window: Window, layer: Layer, part: Part21, cell: Part, name: str, scale: float
) -> list[tuple[Part, Floats, str]]:
    """Rows of cells; rows with the same pattern are one part.

    Where patterns differ, rows are made of runs of 1, 2, 4, 8 ... cells that they share: readers spend their
    time on places, and so a round sheet has some hundreds of them instead of one a cell.
    """
    rows = [row for row in map(window.lattice.row, range(window.lattice.count[1])) if len(row)]
    patterns = [tuple((row[:, 0] - row[0, 0]).tolist()) for row in rows]
    along = np.array(window.lattice.a1) * scale
    runs = [cell]  # the run of 2^k cells

    def run(power: int) -> Part:
        while len(runs) <= power:
            half = 2 ** (len(runs) - 1)
            halves = [(runs[-1], n * half * along, f"{name} half {n + 1}") for n in range(2)]
            runs.append(_assembled(part, f"{name} run of {2 * half}", halves))
        return runs[power]

    made: dict[tuple[float, ...], Part] = {}
    kinds = tuple(dict.fromkeys(patterns))
    for pattern in kinds:
        pieces = [(step, 0) for step in pattern] if len(kinds) == 1 else _runs(pattern)
        spots = [(run(power), step * along, f"{name} {n}") for n, (step, power) in enumerate(pieces, 1)]
        made[pattern] = _assembled(part, f"{name} row of {len(pattern)}", spots)
    return [
        (made[pattern], window.lattice.centres(row)[0] * scale + layer.shift, f"{name} row {row[0, 1] + 1}")
        for row, pattern in zip(rows, patterns, strict=True)
    ]


def _runs(pattern: Sequence[float]) -> list[tuple[float, int]]:
    """First steps of the runs of 2^k consecutive cells that make up a row, the longest first, and their k."""
    found, at, count = [], 0, len(pattern)
    while at < count:
        power, last = 0, at + 1
        while last < count and pattern[last] - pattern[at] == last - at:
            power, last = power + 1, at + 2 ** (power + 2) - 1
        found.append((pattern[at], power))
        at += 2**power
    return found


WAYS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
"""Directions of the x axis of a part in its places, turn by turn."""


def _assembled(
    part: Part21,
    name: str,
    placed: Sequence[tuple[Part, Floats, str]],
    ways: Sequence[tuple[float, float]] = WAYS[:1],
) -> Part:
    spots = [part.placement(np.append(at, 0.0), way) for (_, at, _), way in zip(placed, cycle(ways))]
    assembly = part.product(name, [part.origin, *spots], "SHAPE_REPRESENTATION")
    for (child, _, title), spot in zip(placed, spots):
        part.component(assembly, child, title, spot)
    return assembly
