"""`clacad stack`: several sheets in a row, the light through all of them, one assembly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.cli.command import Command, declared, dry_run_option, flag, option, required
from clacad.cli.console import Brief, Console, facts, table
from clacad.cli.option_values import (
    BadOption,
    command_line,
    load_sheets,
    one_of,
    own_overrides,
    parse_angle,
    parse_cells,
    parse_distance,
    read_length,
    words_of,
)
from clacad.exporting.formats.indexed_meshes import GLB
from clacad.exporting.formats.step import WORD as STEP

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.stack import Stack
    from clacad.stacking import StackRequest


@dataclass(frozen=True, kw_only=True)
class StackSheets:
    """Several sheets in a row: the share of light through all, how space behaves, one assembly."""

    designs: tuple[Path, ...] = required(
        "DESIGN...",
        "Design files, in the order light meets them; the same one may be given twice. Sheets are called "
        "a, b, c ... Or one scene file with [[sheet]]s.",
    )
    gap: str = option(
        "--gap L,M", "Clear distance between neighbours, e.g. '100 mm'; one for all, or one for each gap.", ""
    )
    wish: tuple[str, ...] = option(
        "--for WISH,...",
        "Solve sheets like DESIGN for a matrix: cloak, space=LENGTH, relay=M, or image=M with object=LENGTH"
        " and at=LENGTH; ring=LENGTH that no light crosses. --gap is then from array to array, --zone the"
        " width of the light.",
        (),
        read=words_of,
    )
    out: Path | None = option(
        "-o, --out DIR",
        "Write stack.step, stack.glb, stack.json and manifest.json here; with --for the scene FILE.toml of "
        "the sheets. Without it, only measure.",
    )
    files: Path | None = option(
        "--files DIR|FILE",
        "Judge what was written of this stack: each sheet as its own master, and light through all.",
    )
    formats: tuple[str, ...] = option("--format F,G", f"{STEP}, {GLB}.", (STEP, GLB), read=words_of)
    field: float | None = option(
        "--field E",
        "Slopes of the light, either way in x and y, e.g. '20 mrad'; default check.field of the first "
        "design.",
        read=parse_angle,
    )
    object_distance: str | None = option(
        "--object L",
        "Distance before the stack of the point that is imaged; default check.object of the first design,"
        " or ten separations.",
    )
    zone: str | None = option(
        "--zone W,H",
        "Part of the first sheet that is lit, about its middle, e.g. '20 mm'; default all of it.",
    )
    rays: int = option("--rays N", "Rays through the stack on each rung.", 65536, least=64, most=100_000_000)
    cells: tuple[int, int] | None = declared("cells", read=parse_cells)
    quads: int = option("--quads N", "Facets along a cell side of GLB, and of --mesh.", 8, least=1, most=1024)
    step: str = declared("step")
    mesh: bool = flag("--mesh", "Trace rung mesh, too.")
    dry_run: bool = dry_run_option()
    overwrite: bool = declared("overwrite")
    force: bool = declared("force")
    set: tuple[str, ...] = option(
        "--set [ID.]KEY=VALUE",
        'Override one value of a sheet, e.g. --set "b.law.eta=[5, 5]", or of all. Repeatable.',
        (),
    )


def run(request: StackSheets, console: Console) -> int:
    """Measure a stack and write it, or judge the files of one; with --dry-run forecast the cost.

    With --for solve sheets for a wanted matrix.
    """
    if request.wish:
        return _solve(request, console)
    if request.files is not None and (request.out is not None or request.dry_run):
        raise BadOption("--files judges what was written: give it without -o and --dry-run")
    designs, gaps, ids = _sheets_and_places(request)
    typed = _stack_request(designs[0], gaps, ids, request)
    from clacad.stacking.make_stack import prepared

    made, stack = prepared(designs, typed)
    if request.dry_run:
        return _forecast(stack, typed, request.out, console)
    if request.files is not None:
        return _judge(made, stack, typed, request.files, console)
    return _make(designs, stack, typed, request.out, console)


def _sheets_and_places(
    request: StackSheets,
) -> tuple[list[Design], tuple[float, ...], tuple[str, ...] | None]:
    """Designs, gaps in the first one's unit, names: of design files, or of the sheets of one scene file."""
    from clacad.cli.export_command import is_scene

    paths, overrides, gap = request.designs, request.set, request.gap
    if not any(is_scene(path) for path in paths):
        if len(paths) == 1:
            raise BadOption(
                f"{paths[0]}: a stack is of two sheets or more; name one twice to stack two alike"
            )
        designs = load_sheets(paths, overrides)
        texts = [text for text in gap.split(",") if text.strip()]
        gaps = tuple(parse_distance("--gap", text, designs[0].unit, zero=True) for text in texts)
        return designs, gaps, None
    if len(paths) > 1 or gap:
        raise BadOption("a scene file lists its sheets and their places: give it alone, without --gap")
    from clacad.exporting.limits import refuse_uncountable
    from clacad.rendering.sheet_passage import stack_of
    from clacad.scene import load_scene

    scene = load_scene(paths[0], overrides)
    still = scene if scene.animation is None else scene.at(0)
    designs = list(still.designs())
    for design in designs:
        refuse_uncountable(design)
    stack = stack_of(still)
    gaps = tuple(max(0.0, one) for one in stack.gaps)
    return designs, gaps, tuple(one.id or "a" for one in stack.sheets)


def _stack_request(
    first: Design, gaps: tuple[float, ...], ids: tuple[str, ...] | None, given: StackSheets
) -> StackRequest:
    """The request in numbers; lengths in the first design's unit."""
    from clacad.stacking import StackRequest

    distance = None
    if given.object_distance is not None:
        distance = parse_distance("--object", given.object_distance, first.unit, zero=True)
    step: Any = one_of("step", given.step)
    return StackRequest(
        gaps=gaps,
        ids=ids,
        formats=tuple(dict.fromkeys(given.formats)),
        field=given.field,
        object_distance=distance,
        rays=given.rays,
        cells=given.cells,
        quads=given.quads,
        step=step,
        overwrite=given.overwrite,
        force=given.force,
        mesh_light=given.mesh,
        zone=_zone(given.zone, first.unit),
    )


def _zone(text: str | None, unit: str) -> tuple[float, float] | None:
    """Width and height of the lit zone in the first design's unit; one length is both."""
    if text is None:
        return None
    sides = [parse_distance("--zone", part, unit) for part in text.split(",")]
    if len(sides) > 2:
        raise BadOption(f"--zone {text}: {len(sides)} lengths; give one, or width,height")
    return sides[0], sides[-1]


def _solve(request: StackSheets, console: Console) -> int:
    """Print two and three sheets with the wanted matrix; status 1 where neither can be built."""
    from clacad.advice.stack_wish import read_wish, report_of, rows_of, solved_text

    if len(request.designs) != 1 or request.files is not None:
        raise BadOption("--for takes one design, which all sheets are like, and no --files")
    bases = load_sheets(request.designs * 3, request.set)
    design, unit = bases[0], bases[0].unit
    wish = read_wish(request.wish, partial(_wished_length, unit))
    gaps = [parse_distance("--gap", part, unit) for part in request.gap.split(",") if part.strip()]
    if len(gaps) not in (1, 2):
        raise BadOption(
            "--for needs --gap: one length, or two, from array 2 of a sheet to array 1 of the next"
        )
    sides = _zone(request.zone, unit) or (max(design.lattice.pitch) * max(design.lattice.count),)
    from clacad.advice import stack_designs

    field = design.check.field if request.field is None else request.field
    wanted = stack_designs.wanted_of(design, wish, (gaps[0], gaps[-1]), max(sides), field)
    with console.progress() as progress:
        found, best = stack_designs.solve(bases, wanted, progress)
        written = "nothing" if best is None else "nothing: -o FILE.toml writes the scene of the sheets"
        if best is not None and (out := request.out) is not None:
            own, source = own_overrides(3, request.set), request.designs[0]
            best = stack_designs.write_solved(out, source, own, bases, wanted, best, request.overwrite)
            found[len(best.sheets)], written = best, str(out)
    able = "not possible with these sheets" if best is None else solved_text(best, wanted, unit)
    head = f"{wanted.name}: {able}"
    rows = [row for count, one in found.items() for row in rows_of(count, one, unit)]
    following = () if best is None or request.out is None else (command_line("clacad stack", request.out),)
    console.show(
        lambda: report_of(found, wanted, unit),
        lambda: f"{head}\n{table(rows)}\nwrote {written}",
        lambda: Brief(head, (facts([*rows, ("written", written)]),), following),
    )
    return 1 if best is None else 0


def _wished_length(unit: str, said: str, text: str, signed: bool = False) -> float:
    """Read a length of a wish, 0 or above unless `signed`. Raises BadOption."""
    from clacad.config.value_kinds import LENGTH, LENGTH_FROM_0

    return read_length(f"{said}{text}:", text, unit, LENGTH if signed else LENGTH_FROM_0)


def _forecast(stack: Stack, request: StackRequest, out: Path | None, console: Console) -> int:
    """Print the cost of a stack and the places of its sheets; refuse what an export would be refused."""
    from clacad.cli.tables import forecast_text
    from clacad.stacking.make_stack import cost_of, sheets_text

    cost, span = cost_of(stack, request, out)
    console.show(
        lambda: cost,
        lambda: (
            f"{sheets_text(cost['sheets'])}\n{forecast_text(cost['files'])}\nin all {span} of processor time;"
            " nothing is written"
        ),
    )
    return 0


def _judge(
    designs: Sequence[Design], stack: Stack, request: StackRequest, files: Path, console: Console
) -> int:
    """Judge the files of a stack; exit status 1 where a check failed or did not run."""
    from clacad.checks.check import passed
    from clacad.cli.tables import checks_text, counted, problems
    from clacad.stacking.judge_stack import judge_stack, verdict_text
    from clacad.stacking.make_stack import field_of

    with console.progress() as progress:
        checks = judge_stack(stack, designs, files, field_of(designs, request), progress)
    good = passed(checks)
    word = verdict_text(checks)
    console.show(
        lambda: {"passed": good, "checks": [check.to_dict() for check in checks]},
        lambda: f"{checks_text(checks)}\n{word}",
        lambda: Brief(word, (problems(checks),), (), word, counted(checks)),
    )
    return 0 if good else 1


def _make(
    designs: Sequence[Design], stack: Stack, request: StackRequest, out: Path | None, console: Console
) -> int:
    """Measure, write, print: the share of light first."""
    from clacad.stacking.make_stack import (
        TASK,
        facts_of,
        in_all,
        light_seconds,
        run_stack,
        share_text,
        stack_text,
    )

    with console.progress() as progress:
        if out is None:
            with console.forecast(TASK, light_seconds(len(designs), request)):
                made = run_stack(designs, request, None, progress)
        else:
            span = in_all(stack, request)
            progress.expect(span.middle)
            console.announce(span, span.low)
            made = run_stack(designs, request, out, progress)
    manifest = made.manifest
    files = [] if manifest is None else list(manifest.files)
    names = ", ".join(str(entry["name"]) for entry in files)
    written = "nothing: -o DIR writes the assembly" if manifest is None else f"{names} in {manifest.folder}"
    console.show(
        lambda: made.to_dict() | {"files": files, "folder": None if out is None else str(out)},
        lambda: f"{stack_text(made)}\nwrote {written}",
        lambda: Brief(share_text(made), (facts([*facts_of(made), ("written", written)]),)),
    )
    return 0


COMMANDS = (Command("stack", "make", StackSheets, run),)
