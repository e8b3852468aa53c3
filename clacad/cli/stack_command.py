"""`clacad stack`: sheets behind one another, the light through all of them, one assembly."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import degrees
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

from clacad.cli.announce_cost import WORTH_SAYING, forecast
from clacad.cli.console import Progress, say, show_json, show_text, size, table
from clacad.cli.option_values import BadOption, one_of, parse_angle, parse_cells, parse_distance

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.stack import Stack
    from clacad.stacking import Stacked, StackRequest
    from clacad.stacking.stack_light import StackMeridian
    from clacad.verification.checks import Check


@dataclass(frozen=True, slots=True)
class StackWords:
    """What the command line says: where to write or what to judge, and lengths and angles as typed."""

    out: Path | None
    files: Path | None
    gap: str
    formats: str
    field: str | None
    object_distance: str | None
    zone: str | None
    rays: int
    cells: str | None
    quads: int
    step: str
    mesh: bool
    dry_run: bool
    overwrite: bool
    force: bool


def stack_designs(
    paths: Sequence[Path], overrides: Sequence[str], words: StackWords, *, json: bool, quiet: bool
) -> int:
    """Measure a stack and write it, or judge the files of one; with --dry-run say what that would cost."""
    if words.files is not None and (words.out is not None or words.dry_run):
        raise BadOption("--files judges what was written: give it without -o and --dry-run")
    designs, gaps, ids = _sheets_and_places(paths, overrides, words.gap)
    asked = _asked(designs[0], gaps, ids, words)
    from clacad.stacking.make_stack import prepared

    made, standing = prepared(designs, asked)
    if words.dry_run:
        return _dry(standing, asked, words, json=json, quiet=quiet)
    if words.files is not None:
        return _judge(made, standing, asked, words.files, json=json, quiet=quiet)
    return _make(designs, standing, asked, words.out, json=json, quiet=quiet)


def _sheets_and_places(
    paths: Sequence[Path], overrides: Sequence[str], gap: str
) -> tuple[list[Design], tuple[float, ...], tuple[str, ...] | None]:
    """Designs, gaps in the first one's unit, and names: of design files, or of the sheets of one scene file."""
    from clacad.cli.export_scene import is_scene

    if not any(is_scene(path) for path in paths):
        if len(paths) == 1:
            raise BadOption(
                f"{paths[0]}: a stack is of two sheets or more; name one twice to stack two alike"
            )
        designs = load_sheets(paths, overrides)
        texts = [text for text in gap.split(",") if text.strip()]
        return (
            designs,
            tuple(parse_distance("--gap", text, designs[0].unit, zero=True) for text in texts),
            None,
        )
    if len(paths) > 1 or gap:
        raise BadOption(
            "a scene file says which sheets there are and where they stand: give it alone, without --gap"
        )
    from clacad.exporting.limits import refuse_uncountable
    from clacad.rendering.sheet_passage import stack_of
    from clacad.scene import load_scene

    scene = load_scene(paths[0], tuple(overrides))
    still = scene if scene.animation is None else scene.at(0)
    designs = list(still.designs())
    for design in designs:
        refuse_uncountable(design)
    standing = stack_of(still)
    return (
        designs,
        tuple(max(0.0, one) for one in standing.gaps),
        tuple(one.id or "a" for one in standing.sheets),
    )


def load_sheets(paths: Sequence[Path], overrides: Sequence[str]) -> list[Design]:
    """Read the designs of a stack; an override that begins with a sheet's letter is that sheet's, others are of all.

    Raises
    ------
    DesignError, BadOption
    """
    from clacad.cli.design_commands import load_counted

    if len(paths) > len(ascii_lowercase):  # each goes by a letter
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
                    f"--set {text}: there is no sheet {letter}; sheets are a to {last}, in the order they are given"
                )
            own[number].append(text.strip()[2:])
        else:
            for one in own:
                one.append(text)
    return [load_counted(path, changes) for path, changes in zip(paths, own, strict=True)]


def _asked(
    first: Design, gaps: tuple[float, ...], ids: tuple[str, ...] | None, words: StackWords
) -> StackRequest:
    """The request in numbers; lengths in the first design's unit.

    Raises
    ------
    BadOption
    """
    from clacad.stacking import StackRequest

    distance = None
    if words.object_distance is not None:
        distance = parse_distance("--object", words.object_distance, first.unit, zero=True)
    step: Any = one_of("step", words.step)
    return StackRequest(
        gaps=gaps, ids=ids, formats=tuple(dict.fromkeys(f.strip() for f in words.formats.split(",") if f.strip())),
        field=None if words.field is None else parse_angle("--field", words.field), object_distance=distance,
        rays=words.rays, cells=parse_cells(words.cells), quads=words.quads, step=step, overwrite=words.overwrite,
        force=words.force, mesh_light=words.mesh, zone=_zone(words.zone, first.unit),
    )  # fmt: skip


def _zone(text: str | None, unit: str) -> tuple[float, float] | None:
    """Width and height of the lit zone in the first design's unit; one length is both."""
    if text is None:
        return None
    sides = [parse_distance("--zone", part, unit) for part in text.split(",")]
    if len(sides) > 2:
        raise BadOption(f"--zone {text}: {len(sides)} lengths; give one, or width,height")
    return sides[0], sides[-1]


def _dry(standing: Stack, asked: StackRequest, words: StackWords, *, json: bool, quiet: bool) -> int:
    """What a stack would cost and where its sheets would stand; what would be refused is."""
    from clacad.base.units import millimetres
    from clacad.cli.tables import forecast_text
    from clacad.stacking.assembly import sheet_facts
    from clacad.stacking.stack_cost import in_all, refuse, rows, rows_by_sheet
    from clacad.storage.atomic import require_folder

    if words.out is not None:
        require_folder(words.out)
        refuse(standing, asked, words.out)
    found = [row.to_dict() for row in rows(standing, asked)]
    span = in_all(standing, asked)
    mm = millimetres(standing.unit)
    own = rows_by_sheet(standing, asked)
    sheets = [
        sheet_facts(one, mm) | {"bytes": {row.format: row.bytes for row in own[one.id]}}
        for one in standing.sheets
    ]
    if json:
        show_json({"files": found, "sheets": sheets, "seconds": [span.low, span.high]})
    else:
        show_text(
            f"{_sheets_text(sheets)}\n{forecast_text(found)}\nin all {span} of processor time; nothing is written",
            quiet=quiet,
        )
    return 0


def _judge(
    designs: Sequence[Design], standing: Stack, asked: StackRequest, files: Path, *, json: bool, quiet: bool
) -> int:
    """Judge the files of a stack; exit status 1 where a check failed or did not run."""
    from clacad.cli.tables import checks_text
    from clacad.stacking.judge_stack import judge_stack
    from clacad.stacking.make_stack import field_of
    from clacad.verification.checks import passed

    progress = Progress(quiet=quiet)
    try:
        checks = judge_stack(standing, designs, files, field_of(designs, asked), progress)
    finally:
        progress.done()
    good = passed(checks)
    if json:
        show_json({"passed": good, "checks": [check.to_dict() for check in checks]})
    else:
        show_text(f"{checks_text(checks)}\n{_verdict(good, checks)}", quiet=quiet)
    return 0 if good else 1


def _verdict(good: bool, checks: Sequence[Check]) -> str:
    from clacad.verification.checks import wrong

    return "passed: every sheet as an optical master, and light through all of them" if good else (
        f"failed: {', '.join(sorted({f'{check.id} ({check.subject})' for check in wrong(checks)}))}"
    )  # fmt: skip


def _make(
    designs: Sequence[Design],
    standing: Stack,
    asked: StackRequest,
    out: Path | None,
    *,
    json: bool,
    quiet: bool,
) -> int:
    """Measure, write, print: the share of light first."""
    from clacad.stacking.make_stack import run_stack
    from clacad.stacking.stack_cost import TASK, in_all, light_seconds

    progress = Progress(quiet=quiet)
    try:
        if out is None:
            with forecast(TASK, light_seconds(len(designs), asked), quiet=quiet):
                made = run_stack(designs, asked, None, progress)
        else:
            span = in_all(standing, asked)
            progress.expect(span.middle)
            if span.low >= WORTH_SAYING:
                say(f"this takes {span} of processor time", quiet=quiet)
            made = run_stack(designs, asked, out, progress)
    finally:
        progress.done()
    if json:
        files = [] if made.manifest is None else list(made.manifest.files)
        show_json(made.to_dict() | {"files": files, "folder": None if out is None else str(out)})
        return 0
    show_text(told(made), quiet=quiet)
    if made.manifest is None:
        say("nothing is written: -o DIR writes the assembly", quiet=quiet)
    else:
        names = ", ".join(str(entry["name"]) for entry in made.manifest.files)
        show_text(f"wrote {names} in {made.manifest.folder}", quiet=quiet)
    return 0


def told(made: Stacked) -> str:
    """A stack as a person reads it, the share of light first."""
    from clacad.base.units import millimetres
    from clacad.stacking.assembly import sheet_facts

    exact, unit = made.exact, made.unit
    x, y = exact.meridians
    parts = [
        f"share of the light that obeys all {len(made.designs)} laws: {100.0 * exact.share:.3g} %"
        f"{_of_meridians(x.share, y.share)}, over {_lit(made)} and slopes of ± {degrees(exact.field):.3g} deg "
        f"({_thin(made)}); the rest are ghosts, or lost",
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
    by_rays = "" if thin is None else f"thin lenses {100.0 * thin.share:.3g} % by rays, "
    return f"{by_rays}{100.0 * made.exact.expected_share:.3g} % as the product of what each thin sheet passes"


def _of_meridians(x: float | None, y: float | None) -> str:
    return "" if x is None or y is None else f" ({100.0 * x:.3g} % in x, {100.0 * y:.3g} % in y)"


def _lit(made: Stacked) -> str:
    """Part of the first sheet that light fills."""
    cells, whole = made.exact.cells, made.stack.sheets[0].window.lattice.cell_count
    if cells == 1:
        return "one cell, for all do alike"
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
    """What the stack does to space, one line a meridian, one line if both are alike."""
    lines = []
    for name, one in zip(("x", "y"), made.exact.meridians, strict=True):
        if one.matrix is None:
            lines.append(f"{name}: no matrix in closed form: {one.no_matrix}{_by_rays(one)}")
            continue
        (a, b), (c, d) = (
            [0.0 if abs(v) < 1e-14 else v for v in row] for row in one.matrix
        )  # rounding of 1 - L/f at L = f
        matrix = f"chief rays (x, t) -> ({a:.6g} x {b:+.6g} t, {c:.6g} x {d:+.6g} t), determinant {one.determinant:.6g}"
        if one.acts_as_space is None:
            lines.append(f"{name}: {matrix}{_by_rays(one)}")
            continue
        assert one.moves_image is not None
        nearer = "nearer" if one.moves_image >= 0.0 else "farther"
        by_rays = "" if one.measured_space is None else f", {one.measured_space:.6g} by rays"
        if one.beams is not None and abs(one.beams - one.acts_as_space) > 1e-9 * abs(one.acts_as_space):
            by_rays = f", {one.beams:.6g} for the middle of the light that gets through{by_rays}"
        lines.append(
            f"{name}: acts as {one.acts_as_space:.6g} {made.unit} of space{by_rays}, over {one.length:.6g} {made.unit}: "
            f"what is seen stands {abs(one.moves_image):.6g} {made.unit} {nearer}; {matrix}"
        )
    return lines


def _sheets_text(sheets: Iterable[dict[str, Any]]) -> str:
    rows = [["sheet", "design", "from / mm", "to / mm", ""]]
    for one in sheets:
        said = f"passes {100.0 * one['share']:.3g} % of what came so far" if "share" in one else ""
        if "bytes" in one:
            parts = [f"{name} about {size(count)}" for name, count in one["bytes"].items()]
            said = ", ".join(parts) or "written already"
        rows.append([one["id"], one["design"], *(f"{z:.6g}" for z in one["span"]), said])
    return table(rows)


def _rungs_text(made: Stacked) -> str:
    """The same rays on every rung: what each says, how far it is from the exact surfaces, what it takes."""
    rows = [["rung", "share", "x", "y", f"space x / {made.unit}", "y", "scatter x / pitch", "y", "error / mrad", "other fate",
             "seconds"]]  # fmt: skip
    for one in made.light:
        x, y = one.meridians
        cells = [one.rung, f"{one.share:.4f}"]
        for name, form in (("share", ".4f"), ("measured_space", ".6g"), ("scatter", ".3g")):
            cells += ["" if (v := getattr(m, name)) is None else format(v, form) for m in (x, y)]
        error = "truth" if one.rung == "surfaces" else f"{1e3 * one.error:.3g}"
        rows.append([*cells, error, f"{100.0 * one.strays:.3g} %", f"{one.seconds:.2g}"])
    return table(rows)


def _image_text(made: Stacked, unit: str) -> str:
    image = made.image
    predicted = ", ".join("at infinity or mixed" if v is None else f"{v:.6g}" for v in image.predicted)
    text = f"image of a point {image.object_distance:.6g} {unit} before the stack: {predicted} {unit} behind it (x, y, chief rays)"
    if image.point is None:
        return f"{text}; too few rays meet to tell it by rays"
    x, y, z = image.point
    return f"{text}; by {image.rays} rays {z:.6g} {unit}, spread {image.spread:.3g} {unit} rms"
