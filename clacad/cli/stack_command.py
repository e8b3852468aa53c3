"""`clacad stack`: several sheets in a row, the light through all of them, one assembly."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import degrees
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

from clacad.base.text import mrad_text, percent_text, short_size_text
from clacad.cli.command import Command, declared, dry_run_option, flag, option, required
from clacad.cli.console import Console, table
from clacad.cli.option_values import (
    BadOption,
    load_counted,
    one_of,
    parse_angle,
    parse_cells,
    parse_distance,
    words_of,
)
from clacad.exporting.formats.indexed_meshes import GLB
from clacad.exporting.formats.step import WORD as STEP

if TYPE_CHECKING:
    from clacad.checks.check import Check
    from clacad.design import Design
    from clacad.sheet.stack import Stack
    from clacad.stacking import Stacked, StackRequest
    from clacad.stacking.stack_light import StackMeridian


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
    out: Path | None = option(
        "-o, --out DIR",
        "Write stack.step, stack.glb, stack.json and manifest.json here; without it, only measure.",
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
    """Measure a stack and write it, or judge the files of one; with --dry-run forecast the cost."""
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


def load_sheets(paths: Sequence[Path], overrides: Sequence[str]) -> list[Design]:
    """Read the designs of a stack; an override with a sheet's letter is for that sheet, others for all.

    Raises
    ------
    DesignError, BadOption
    """
    if len(paths) > len(ascii_lowercase):  # a letter names each
        raise BadOption(f"{len(paths)} sheets: a stack has at most {len(ascii_lowercase)}")
    own: list[list[str]] = [[] for _ in paths]
    for text in overrides:
        key = text.partition("=")[0].strip()
        letter, dot, _ = key.partition(".")
        if dot and len(letter) == 1 and letter.isalpha():
            number = ord(letter) - ord("a")
            if not 0 <= number < len(paths):
                last = chr(ord("a") + len(paths) - 1)
                raise BadOption(
                    f"--set {text}: there is no sheet {letter}; sheets are a to {last}, in the order they "
                    "are given"
                )
            own[number].append(text.strip()[2:])
        else:
            for one in own:
                one.append(text)
    return [load_counted(path, tuple(changes)) for path, changes in zip(paths, own, strict=True)]


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


def _forecast(stack: Stack, request: StackRequest, out: Path | None, console: Console) -> int:
    """Print the cost of a stack and the places of its sheets; refuse what an export would be refused."""
    from clacad.base.units import millimetres
    from clacad.cli.tables import forecast_text
    from clacad.stacking.assembly import sheet_facts
    from clacad.stacking.make_stack import in_all, refuse, rows, rows_by_sheet
    from clacad.storage.atomic import require_folder

    if out is not None:
        require_folder(out)
        refuse(stack, request, out)
    found = [row.to_dict() for row in rows(stack, request)]
    span = in_all(stack, request)
    mm = millimetres(stack.unit)
    own = rows_by_sheet(stack, request)
    sheets = [
        sheet_facts(one, mm) | {"bytes": {row.format: row.bytes for row in own[one.id]}}
        for one in stack.sheets
    ]
    console.show(
        lambda: {"files": found, "sheets": sheets, "seconds": [span.low, span.high]},
        lambda: (
            f"{_sheets_text(sheets)}\n{forecast_text(found)}\nin all {span} of processor time; nothing is "
            "written"
        ),
    )
    return 0


def _judge(
    designs: Sequence[Design], stack: Stack, request: StackRequest, files: Path, console: Console
) -> int:
    """Judge the files of a stack; exit status 1 where a check failed or did not run."""
    from clacad.checks.check import passed
    from clacad.cli.tables import checks_text
    from clacad.stacking.judge_stack import judge_stack
    from clacad.stacking.make_stack import field_of

    with console.progress() as progress:
        checks = judge_stack(stack, designs, files, field_of(designs, request), progress)
    good = passed(checks)
    console.show(
        lambda: {"passed": good, "checks": [check.to_dict() for check in checks]},
        lambda: f"{checks_text(checks)}\n{_verdict(good, checks)}",
    )
    return 0 if good else 1


def _verdict(good: bool, checks: Sequence[Check]) -> str:
    from clacad.checks.check import wrong

    return (
        "passed: every sheet as an optical master, and light through all of them"
        if good
        else (f"failed: {', '.join(sorted({f'{check.id} ({check.subject})' for check in wrong(checks)}))}")
    )


def _make(
    designs: Sequence[Design], stack: Stack, request: StackRequest, out: Path | None, console: Console
) -> int:
    """Measure, write, print: the share of light first."""
    from clacad.stacking.make_stack import TASK, in_all, light_seconds, run_stack

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
    written = "" if manifest is None else ", ".join(str(entry["name"]) for entry in files)
    console.show(
        lambda: made.to_dict() | {"files": files, "folder": None if out is None else str(out)},
        lambda: stack_text(made) + ("" if manifest is None else f"\nwrote {written} in {manifest.folder}"),
    )
    if manifest is None and not console.json:
        console.say("nothing is written: -o DIR writes the assembly")
    return 0


def stack_text(made: Stacked) -> str:
    """A stack as text, the share of light first."""
    from clacad.base.units import millimetres
    from clacad.stacking.assembly import sheet_facts

    exact, unit = made.exact, made.unit
    x, y = exact.meridians
    parts = [
        f"share of the light that obeys all {len(made.designs)} laws: {percent_text(exact.share, unit='')} "
        f"%{_of_meridians(x.share, y.share)}, over {_lit(made)} and slopes of ± {degrees(exact.field):.3g} "
        f"deg ({_thin(made)}); the rest are ghosts, or lost",
        *_spaces(made),
        _sheets_text(
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


def _spaces(made: Stacked) -> Iterable[str]:
    """Effect of the stack on space, one line a meridian."""
    lines = []
    for name, one in zip(("x", "y"), made.exact.meridians, strict=True):
        if one.matrix is None:
            lines.append(f"{name}: no matrix in closed form: {one.no_matrix}{_by_rays(one)}")
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


def _sheets_text(sheets: Iterable[dict[str, Any]]) -> str:
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


COMMANDS = (Command("stack", "make", StackSheets, run),)
