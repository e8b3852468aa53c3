"""Making, measuring and writing of stacks of sheets; options, limits and cost of a stack.

Text of a stack: share of the light, effect on space, sheets, rungs, image of a point.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import degrees, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

from clacad.base.interactive import Tabular, columns_of, shown_progress
from clacad.base.machine_rates import Rates, Span, total
from clacad.base.text import mrad_text, percent_text, short_size_text, table
from clacad.base.types import Pair2, Progress, Rung
from clacad.base.units import millimetres
from clacad.exporting.forecast import forecast
from clacad.exporting.formats.format import Forecast
from clacad.exporting.formats.indexed_meshes import GLB
from clacad.exporting.formats.step import WORD as STEP
from clacad.exporting.limits import refuse_over_limits, refuse_uncountable
from clacad.exporting.manifest import FORMAT, FileRecord, Manifest
from clacad.exporting.request import Request
from clacad.exporting.tessellations import Meshes
from clacad.formats.step.part21 import Mode
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.stack import BadStack, Stack, stacked
from clacad.stacking.assembly import NAME, StackAssembly, sheet_facts
from clacad.stacking.chief_matrices import about_cell
from clacad.stacking.stack_light import StackImage, StackLight, StackMeridian, measure_image, measure_light
from clacad.storage.atomic import MANIFEST, Stage, canonical_json, file_hash, require_folder
from clacad.storage.errors import UnknownFormat
from clacad.storage.staging import flush
from clacad.storage.worker import Worker, ended_by_signals, worker_memory
from clacad.tracing.through_stack import StackTracer

if TYPE_CHECKING:
    from clacad.design import Design


FORMATS = (STEP, GLB)
"""File formats of a stack; both support assemblies."""

QUADS = 8
"""Facets along a cell side of a GLB file, which is for viewing."""


@dataclass(frozen=True, eq=False)
class StackRequest:
    """Options of a stack.

    Parameters
    ----------
    gaps : tuple of float
        Clear distances between neighbours, in the unit of the first design; one for all, or one for each.
    formats : tuple of "step" and "glb"
    field : float or None, radians
        Slopes of the light reach to its tangent; None: check.field of the first design.
    zone : (width, height) or None
        Lit part of the first sheet, about its centre, in the unit of the first design; None: all of it, or
        one cell where all cells of all sheets act alike.
    object_distance : float or None
        Distance of the imaged point before array 1 of the first sheet, in the unit of the first design; None:
        its check.object, else ten times its separation.
    rays : int
    cells : (a, b) or None
        Number of cells of every sheet to write and measure.
    quads : int
        Facets along a cell side, of GLB.
    step : "auto", "fused" or "instanced"
    overwrite, force : bool
        Replace files of another origin; ignore the limits of size.
    mesh_light : bool
        Trace rung mesh too, with `quads` facets along a cell side.
    ids : sequence of str or None
        Names of the sheets; None: a, b, c, …
    """

    gaps: tuple[float, ...]
    formats: tuple[str, ...] = FORMATS
    field: float | None = None
    object_distance: float | None = None
    rays: int = 65536
    cells: tuple[int, int] | None = None
    quads: int = QUADS
    step: Mode = "auto"
    overwrite: bool = False
    force: bool = False
    mesh_light: bool = False
    ids: Sequence[str] | None = None
    zone: Pair2 | None = None


RAY_SECONDS, FIXED_SECONDS = 1.6e-6, 0.4
"""Processor seconds per ray and sheet on all rungs, and fixed seconds, on the reference machine."""

TASK = "stack light"
"""Name under which the time of the light is recorded."""


def rows_by_sheet(standing: Stack, asked: StackRequest) -> dict[str, list[Forecast]]:
    """Cost that each sheet adds to the files, by its id; a repeated sheet adds none."""
    wanted, seen = Request(formats=asked.formats, step=asked.step), set()
    found: dict[str, list[Forecast]] = {}
    for one in standing.sheets:
        found[one.id] = []
        if id(one.window) not in seen:
            seen.add(id(one.window))
            found[one.id] = forecast(Meshes(one.window), asked.formats, asked.quads, wanted)
    return found


def rows(standing: Stack, asked: StackRequest) -> list[Forecast]:
    """Cost of the files: one row per format, for all distinct sheets together."""
    several = [row for each in rows_by_sheet(standing, asked).values() for row in each]
    return [_together([row for row in several if row.format == name]) for name in asked.formats]


def _together(several: Sequence[Forecast]) -> Forecast:
    """Combined row for the parts of one file."""
    first = several[0]

    def added(name: str) -> int | None:
        values = [getattr(row, name) for row in several]
        return None if None in values else sum(values)

    return Forecast(
        first.format,
        sum(row.bytes for row in several),
        False,
        added("facets"),
        first.quads,
        sum(row.modelled for row in several),
        (sum(r.memory[0] for r in several), sum(r.memory[1] for r in several)),
        (sum(r.seconds[0] for r in several), sum(r.seconds[1] for r in several)),
        added("stored"),
        sum(row.places for row in several),
    )


def light_seconds(sheets: int, asked: StackRequest) -> float:
    """Processor seconds of the light on the reference machine."""
    return FIXED_SECONDS + RAY_SECONDS * asked.rays * sheets


def in_all(standing: Stack, asked: StackRequest) -> Span:
    """Processor seconds of light and files on this machine."""
    rates = Rates.here()
    files = [Span(*row.seconds) for row in rows(standing, asked)]
    return total([rates.span(TASK, light_seconds(len(standing.sheets), asked)), *files])


def refuse(standing: Stack, asked: StackRequest, folder: Path) -> None:
    """Refuse files beyond the limits of size. Raises LimitRefused."""
    if not asked.force:
        refuse_over_limits(standing.sheets[0].window, rows(standing, asked), folder)


def cost_of(standing: Stack, asked: StackRequest, out: Path | None) -> tuple[dict[str, Any], Span]:
    """Cost of files and sheets in plain values, processor seconds. Raises LimitRefused, CannotWrite."""
    if out is not None:
        require_folder(out)
        refuse(standing, asked, out)
    span, mm, own = in_all(standing, asked), millimetres(standing.unit), rows_by_sheet(standing, asked)
    sheets = [
        sheet_facts(one, mm) | {"bytes": {row.format: row.bytes for row in own[one.id]}}
        for one in standing.sheets
    ]
    files = [row.to_dict() for row in rows(standing, asked)]
    return {"files": files, "sheets": sheets, "seconds": [span.low, span.high]}, span


RUNGS: tuple[Rung, ...] = ("law", "thin", "surfaces")
"""Rungs on which the light of a stack is measured; facets, slower than all of them, are optional."""


@dataclass(frozen=True, eq=False)
class Stacked(Tabular):
    """A stack, the light through it, and its written files.

    Attributes
    ----------
    stack : Stack
    designs : tuple of Design
        Designs of the sheets, with the cells as written.
    light : tuple of StackLight
        One per rung; the exact surfaces are last, or last before the facets.
    image : StackImage
        By the exact surfaces.
    unit : str
        Of the stack's lengths, as the first design writes it.
    manifest : Manifest or None
        None where nothing was written.
    """

    stack: Stack
    designs: tuple[Design, ...]
    light: tuple[StackLight, ...]
    image: StackImage
    unit: str
    manifest: Manifest | None = None

    def __repr__(self) -> str:
        return f"Stacked({self.stack!r}, share {self.share:.3g})"

    def to_columns(self) -> dict[str, Any]:
        """One row for each rung: light through all sheets, shares and angles in radians."""
        names = ("rung", "rays", "field", "cells", "share", "expected_share", "error", "strays")
        return columns_of([{name: getattr(one, name) for name in names} for one in self.light])

    @property
    def exact(self) -> StackLight:
        """Light through the exact surfaces."""
        return next(one for one in self.light if one.rung == "surfaces")

    @property
    def share(self) -> float:
        """Share of the light that obeys the law of every sheet, through the exact surfaces."""
        return self.exact.share

    def to_dict(self) -> dict[str, Any]:
        """Plain values; lengths in the stack's unit, but for the sheets' places (mm)."""
        mm = millimetres(self.stack.unit)
        return {
            "format": FORMAT,
            "unit": self.unit,
            "share": self.share,
            "sheets": [
                sheet_facts(one, mm) | {"sha256": design.sha256}
                for one, design in zip(self.stack.sheets, self.designs, strict=True)
            ],
            "gaps": list(self.stack.gaps),
            "light": [one.to_dict() for one in self.light],
            "image": self.image.to_dict(),
        }


class StackOptions(TypedDict, total=False):
    """Options of a stack, by keyword; the fields of the same names of `StackRequest`."""

    field: float | None
    object_distance: float | None
    rays: int
    cells: tuple[int, int] | None
    quads: int
    step: Mode
    overwrite: bool
    force: bool
    mesh_light: bool
    ids: Sequence[str] | None
    zone: Pair2 | None


def stack(
    designs: Sequence[Design],
    gaps: float | Sequence[float] = (),
    out: str | os.PathLike[str] | None = None,
    formats: Sequence[str] = FORMATS,
    *,
    progress: Progress | None = None,
    **options: Unpack[StackOptions],
) -> Stacked:
    """Put sheets one behind the other: measure the light through all of them; write the assembly where a
    folder is given.

    Parameters
    ----------
    designs : sequence of Design
        In the order of the light; a design may be repeated.
    gaps : float or sequence of float
        Clear distances between the solids of neighbours, in the unit of the first design.
    out : path or None
        Folder for stack.step, stack.glb, stack.json and manifest.json; None: nothing is written.
    formats : sequence of "step" and "glb"
    progress : callable or None
        Called with a stage's name and the part done.
    field, object_distance, rays, cells, quads, step, overwrite, force, mesh_light, ids, zone
        The fields of `clacad.stacking.StackRequest`, by keyword.

    Raises
    ------
    BadStack
        No designs or too many, a gap that is negative or no number, or gaps of another number.
    DesignError, LimitRefused, UnknownFormat, ExportRefused, CannotWrite, FileDisagrees, WorkerDied
        Nothing was published; the message gives the reason.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> pair = clacad.stack([design, design], gaps=1.0, rays=256)
    >>> round(pair.share, 2)
    0.46
    """
    many = (gaps,) if isinstance(gaps, int | float) else gaps
    asked = StackRequest(tuple(float(gap) for gap in many), tuple(formats), **options)
    return run_stack(designs, asked, out, progress)


def run_stack(
    designs: Sequence[Design],
    asked: StackRequest,
    out: str | os.PathLike[str] | None,
    progress: Progress | None,
) -> Stacked:
    """Do what `stack` promises."""
    report = shown_progress(progress)
    made, standing = prepared(designs, asked)
    if out is not None:
        require_folder(out)
        refuse(standing, asked, Path(out))
    lights, image = measured(made, standing, asked, report)
    found = Stacked(standing, made, lights, image, made[0].unit)
    return found if out is None else _written(found, asked, Path(out), report)


def prepared(designs: Sequence[Design], asked: StackRequest) -> tuple[tuple[Design, ...], Stack]:
    """Designs with the requested cells, and the stack of their windows; equal designs share one window.

    Raises BadStack, DesignError, LimitRefused, UnknownFormat.
    """
    from clacad.prescription.prescribe import prescribe_all

    for name in asked.formats:
        if name not in FORMATS:
            raise UnknownFormat(f"a stack is not written as {name!r}; its formats are {', '.join(FORMATS)}")
    made = tuple(one if asked.cells is None else one.with_cells(asked.cells) for one in designs)
    for design in made:
        refuse_uncountable(design)
    _refuse_numbers(asked)
    gaps = asked.gaps * (len(made) - 1) if len(asked.gaps) == 1 else asked.gaps
    return made, stacked(prescribe_all(made), gaps, asked.ids)


def _refuse_numbers(asked: StackRequest) -> None:
    """Refuse a field, distance, zone, number of rays or of facets out of range."""
    if asked.field is not None and not 0.0 < asked.field < 1.5:
        raise BadStack(f"field is {asked.field:g} rad: it is an angle above 0, below 1.5 rad")
    distance = asked.object_distance
    if distance is not None and not (isfinite(distance) and distance > 0.0):
        raise BadStack(f"the object is {distance:g} before the stack: it is a length above 0")
    if asked.zone is not None and not all(isfinite(side) and side > 0.0 for side in asked.zone):
        raise BadStack(f"zone is {asked.zone[0]:g} x {asked.zone[1]:g}: width and height are lengths above 0")
    if asked.rays < 64 or not 1 <= asked.quads <= 1024:
        raise BadStack(f"{asked.rays} rays, {asked.quads} quads: at least 64 rays, and 1 to 1024 quads")


def field_of(designs: Sequence[Design], asked: StackRequest) -> float:
    """Half width of the field, radians."""
    return designs[0].check.field if asked.field is None else asked.field


def measured(
    designs: Sequence[Design], standing: Stack, asked: StackRequest, report: Progress
) -> tuple[tuple[StackLight, ...], StackImage]:
    """Light through a stack on every rung, and the image of a point by the exact surfaces."""
    field, first = field_of(designs, asked), designs[0]
    distance = asked.object_distance or first.check.object or 10.0 * standing.sheets[0].window.thin.separation
    tracers = [StackTracer(standing, rung, path="size") for rung in RUNGS]
    image = measure_image(tracers[-1], asked.rays, field, distance)
    if asked.mesh_light:
        tracers.append(StackTracer(standing, "mesh", asked.quads, path="size"))
    return measure_light(tracers, asked.rays, field, report, asked.zone), image


def _written(found: Stacked, asked: StackRequest, out: Path, report: Progress) -> Stacked:
    """Write the files, read them back, publish them."""
    with (
        ended_by_signals(),
        Worker(memory=worker_memory()) as worker,
        Stage(out, overwrite=asked.overwrite) as stage,
    ):
        stage.path(MANIFEST)  # a foreign manifest is refused before any work
        job = StackAssembly(found.stack, stage, worker, asked.quads, asked.step, report)
        records = [*job.records(asked.formats), _numbers(found, stage)]
        content = _content(found, records, asked)
        report("publish", 1.0)
        stage.publish(content)
        folder = stage.folder
    return Stacked(
        found.stack, found.designs, found.light, found.image, found.unit, Manifest(folder, content)
    )


def _numbers(found: Stacked, stage: Stage) -> FileRecord:
    """The numbers of a stack as a file."""
    from clacad.base.text import plain

    path = stage.path(f"{NAME}.json")
    path.write_text(canonical_json(plain(found.to_dict())), encoding="utf-8", newline="\n")
    flush(path)
    return FileRecord(path.name, file_hash(path), path.stat().st_size, "stack-light", found.unit, ())


def _content(found: Stacked, records: Sequence[FileRecord], asked: StackRequest) -> Mapping[str, Any]:
    """Content of manifest.json."""
    from clacad import __version__

    mm = millimetres(found.stack.unit)
    return {
        "format": FORMAT,
        "stack": {
            "unit": found.unit,
            "gaps_mm": [gap * mm for gap in found.stack.gaps],
            "sheets": [
                sheet_facts(one, mm) | {"sha256": design.sha256, "toml": design.toml}
                for one, design in zip(found.stack.sheets, found.designs, strict=True)
            ],
        },
        "files": sorted((record.to_dict() for record in records), key=lambda entry: str(entry["name"])),
        "versions": {"clacad": __version__},
        "options": {
            "gaps": list(asked.gaps),
            "formats": list(asked.formats),
            "field": field_of(found.designs, asked),
            "zone": None if asked.zone is None else list(asked.zone),
            "rays": asked.rays,
            "cells": None if asked.cells is None else list(asked.cells),
            "quads": asked.quads,
            "step": asked.step,
            "object_distance": found.image.object_distance,
        },
    }


def share_text(made: Stacked) -> str:
    x, y = made.exact.meridians
    share = f"{percent_text(made.exact.share, unit='')} %{_of_meridians(x.share, y.share)}"
    return f"share of the light that obeys all {len(made.designs)} laws: {share}"


def stack_text(made: Stacked) -> str:
    """A stack as text, the share of light first."""
    exact, unit = made.exact, made.unit
    parts = [
        f"{share_text(made)}, over {_lit(made)} and slopes of ± {degrees(exact.field):.3g} deg"
        f" ({_thin(made)}); the rest are ghosts, or lost",
        *_spaces(made),
        sheets_text(
            sheet_facts(one, millimetres(made.stack.unit)) | {"share": share}
            for one, share in zip(made.stack.sheets, exact.sheets, strict=True)
        ),
        _rungs_text(made),
        _image_text(made, unit),
    ]
    return "\n".join(parts)


def _thin(made: Stacked) -> str:
    """The share through thin lenses: by the same rays, and as the product over the sheets."""
    thin = next((one for one in made.light if one.rung == "thin"), None)
    by_rays = "" if thin is None else f"thin lenses {percent_text(thin.share)} by rays, "
    return f"{by_rays}{percent_text(made.exact.expected_share)} as the product of what each thin sheet passes"


def _of_meridians(x: float | None, y: float | None) -> str:
    return "" if x is None or y is None else f" ({percent_text(x)} in x, {percent_text(y)} in y)"


def _lit(made: Stacked) -> str:
    """Part of the first sheet that light fills."""
    cells, whole = made.exact.cells, made.stack.sheets[0].window.lattice.cell_count
    if cells == 1:
        return "one cell, which represents all"
    return (
        f"all {cells} cells of sheet {made.stack.sheets[0].id}"
        if cells == whole
        else f"{cells} of its {whole} cells"
    )


def _by_rays(one: StackMeridian) -> str:
    """The matrix fitted to rays, where they fill more than a cell."""
    if None in (one.measured_scale, one.measured_space, one.measured_focusing, one.measured_slope):
        return ""
    return (
        f"; by rays ({one.measured_scale:.4g} x {one.measured_space:+.4g} t, "
        f"{one.measured_focusing:.4g} x {one.measured_slope:+.4g} t)"
    )


def _about(made: Stacked, axis: int) -> str:
    """The matrix about the chief ray of the central cell, along one axis and across it."""
    cell = central_cell(made.stack.sheets[0].window)
    try:
        found = about_cell(made.stack, cell).matrix
    except BadStack as refusal:
        return f"; {refusal}"
    (a, b), (c, d) = found[axis::2, axis::2].tolist()
    mixed = abs(found[axis::2, 1 - axis :: 2]).max(axis=1).tolist()
    return (
        f"; next to the chief ray of cell {cell} ({a:.6g} x {b:+.6g} t, {c:.6g} x {d:+.6g} t), and of the"
        f" other axis up to ({mixed[0]:.3g}, {mixed[1]:.3g})"
    )


def _spaces(made: Stacked) -> Iterable[str]:
    """Effect of the stack on space, one line a meridian."""
    lines = []
    for axis, (name, one) in enumerate(zip(("x", "y"), made.exact.meridians, strict=True)):
        if one.matrix is None:
            lines.append(f"{name}: no one matrix: {one.no_matrix}{_about(made, axis)}{_by_rays(one)}")
            continue
        (a, b), (c, d) = (
            [0.0 if abs(v) < 1e-14 else v for v in row] for row in one.matrix
        )  # rounding of 1 - L/f at L = f
        matrix = (
            f"chief rays (x, t) -> ({a:.6g} x {b:+.6g} t, {c:.6g} x {d:+.6g} t), "
            f"determinant {one.determinant:.6g}"
        )
        if one.acts_as_space is None:
            lines.append(f"{name}: {matrix}{_by_rays(one)}")
            continue
        assert one.moves_image is not None
        nearer = "nearer" if one.moves_image >= 0.0 else "farther"
        by_rays = "" if one.measured_space is None else f", {one.measured_space:.6g} by rays"
        if one.beams is not None and abs(one.beams - one.acts_as_space) > 1e-9 * abs(one.acts_as_space):
            by_rays = f", {one.beams:.6g} for the middle of the light that gets through{by_rays}"
        lines.append(
            f"{name}: acts as {one.acts_as_space:.6g} {made.unit} of space{by_rays}, over {one.length:.6g} "
            f"{made.unit}: what is seen appears {abs(one.moves_image):.6g} {made.unit} {nearer}; {matrix}"
        )
    return lines


def sheets_text(sheets: Iterable[dict[str, Any]]) -> str:
    rows = [["sheet", "design", "from / mm", "to / mm", ""]]
    for one in sheets:
        note = f"passes {percent_text(one['share'])} of what came so far" if "share" in one else ""
        if "bytes" in one:
            parts = [f"{name} about {short_size_text(count)}" for name, count in one["bytes"].items()]
            note = ", ".join(parts) or "written already"
        rows.append([one["id"], one["design"], *(f"{z:.6g}" for z in one["span"]), note])
    return table(rows)


def _rungs_text(made: Stacked) -> str:
    """Table of one bundle of rays on every rung: result, distance from the exact surfaces, cost."""
    rows = [
        [
            "rung",
            "share",
            "x",
            "y",
            f"space x / {made.unit}",
            "y",
            "scatter x / pitch",
            "y",
            "error / mrad",
            "other fate",
            "seconds",
        ]
    ]
    for one in made.light:
        x, y = one.meridians
        cells = [one.rung, f"{one.share:.4f}"]
        for name, form in (("share", ".4f"), ("measured_space", ".6g"), ("scatter", ".3g")):
            cells += ["" if (v := getattr(m, name)) is None else format(v, form) for m in (x, y)]
        error = "truth" if one.rung == "surfaces" else mrad_text(one.error, 3, unit="")
        rows.append([*cells, error, percent_text(one.strays), f"{one.seconds:.2g}"])
    return table(rows)


def _image_text(made: Stacked, unit: str) -> str:
    image = made.image
    predicted = ", ".join("at infinity or mixed" if v is None else f"{v:.6g}" for v in image.predicted)
    text = (
        f"image of a point {image.object_distance:.6g} {unit} before the stack: {predicted} {unit} behind it "
        "(x, y, chief rays)"
    )
    if image.point is None:
        return f"{text}; too few rays meet to measure it by rays"
    x, y, z = image.point
    return f"{text}; by {image.rays} rays {z:.6g} {unit}, spread {image.spread:.3g} {unit} rms"


def facts_of(made: Stacked) -> list[tuple[str, str]]:
    """Rows about the light, effect on space, image of a point, share through each sheet."""
    exact = made.exact
    spaces = (text.partition("; chief rays")[0] for text in _spaces(made))
    sheets = zip(made.stack.sheets, exact.sheets, strict=True)
    return [
        ("light", f"over {_lit(made)}, slopes of ± {degrees(exact.field):.3g} deg; {_thin(made)}"),
        *(("space", text) for text in spaces),
        ("point", _image_text(made, made.unit)),
        *((f"sheet {one.id}", f"passes {percent_text(share)} of what came so far") for one, share in sheets),
    ]
