"""`clacad stack`: several sheets in a row, the light through all of them, one assembly."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import degrees, isfinite
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

from clacad.base.text import mrad_text, percent_text, short_size_text
from clacad.cli.brief import Brief, facts
from clacad.cli.command import Command, declared, dry_run_option, flag, option, required
from clacad.cli.console import Console, table
from clacad.cli.option_values import (
    BadOption,
    load_counted,
    one_of,
    parse_angle,
    parse_cells,
    parse_distance,
    read_length,
    words_of,
)
from clacad.exporting.formats.indexed_meshes import GLB
from clacad.exporting.formats.step import WORD as STEP

if TYPE_CHECKING:
    from clacad.advice.wanted_stack import Solved, Wanted
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


def load_sheets(paths: Sequence[Path], overrides: Sequence[str]) -> list[Design]:
    """Read the designs of a stack; an override with a sheet's letter is for that sheet, others for all.

    Raises DesignError, BadOption.
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


def _solve(request: StackSheets, console: Console) -> int:
    """Print two and three sheets with the wanted matrix; status 1 where neither can be built."""
    from clacad.advice.wanted_stack import NoSuchStack, rows_of, solve_three, solve_two

    if len(request.designs) != 1 or request.files is not None:
        raise BadOption("--for takes one design, which all sheets are like, and no --files")
    design = load_counted(request.designs[0], request.set)
    wanted = _wanted(request, design)
    found: dict[int, Solved | NoSuchStack] = {}
    for count, solve in ((2, solve_two), (3, solve_three)):
        try:
            found[count] = solve(wanted)
        except NoSuchStack as refusal:
            found[count] = refusal
    best = max(
        (one for one in found.values() if not isinstance(one, Exception)),
        key=lambda one: one.share,
        default=None,
    )
    written = "nothing: -o FILE.toml writes the scene of the sheets"
    if best is not None and request.out is not None:
        _write_scene(request, design, wanted, best)
        written = str(request.out)
    told = {
        count: {"impossible": str(one)} if isinstance(one, Exception) else one.to_dict()
        for count, one in found.items()
    }
    able = "not possible with these sheets" if best is None else _solved_text(best, wanted, design.unit)
    head = f"{wanted.name}: {able}"
    rows = [row for count, one in found.items() for row in rows_of(count, one, design.unit)]
    following = () if best is None or request.out is None else (f"clacad stack {request.out}",)
    console.show(
        lambda: {"matrix": wanted.matrix, "length": wanted.length, "unit": design.unit, "sheets": told},
        lambda: f"{head}\n{table(rows)}\nwrote {written}",
        lambda: Brief(head, (facts([*rows, ("written", written)]),), following),
    )
    return 1 if best is None else 0


def _wanted(request: StackSheets, design: Design) -> Wanted:
    """The wish in numbers; lengths in the design's unit. Raises BadOption."""
    from clacad.advice.wanted_stack import KINDS, Wanted, wanted_matrix
    from clacad.config.quantities import LENGTH
    from clacad.prescription.intent import intent_of, separation_of

    pair, unit = design.pair, design.unit
    if pair.form == "plates" or pair.field_lens:
        raise BadOption(
            "--for solves sheets of two lenses a cell: form slab, plano or biconvex, no field lens"
        )
    words = {key: value for key, _, value in (word.partition("=") for word in request.wish)}
    kinds = [key for key in words if key in KINDS]
    if len(kinds) != 1 or not words.keys() <= {*KINDS, "ring", "object", "at"}:
        raise BadOption(
            f"--for {','.join(request.wish)}: give one of {', '.join(KINDS)}; then ring, object, at"
        )
    kind, intent = kinds[0], intent_of(design)
    if kind == "cloak" and "ring" not in words:
        raise BadOption(
            "--for cloak needs ring=LENGTH, the width that is hidden: sheets that do nothing hide nothing"
        )
    gaps = [parse_distance("--gap", part, unit) for part in request.gap.split(",") if part.strip()]
    if len(gaps) not in (1, 2):
        raise BadOption(
            "--for needs --gap: one length, or two, from array 2 of a sheet to array 1 of the next"
        )
    sides = _zone(request.zone, unit) or (max(design.lattice.pitch) * max(design.lattice.count),)
    separation, pitch = separation_of(intent), max(intent.lattice.pitch)
    length = 3.0 * separation + gaps[0] + gaps[-1]
    if kind == "space":
        value = read_length(f"--for space={words[kind]}:", words[kind], unit, LENGTH)
    else:
        value = 1.0 if kind == "cloak" else _magnification(kind, words[kind])
    planes = tuple(
        parse_distance(f"--for {key}=", words.get(key, "0"), unit, zero=True) for key in ("object", "at")
    )
    bend = (intent.index - 1.0) * (2.0 if pair.form == "biconvex" else 1.0)
    return Wanted(
        f"{kind} of {words[kind] or f'{length:.6g} {unit}'}",
        wanted_matrix(kind, value, length, (planes[0], planes[1])),
        separation,
        pitch,
        (gaps[0], gaps[-1]),
        0.5 * max(sides),
        design.check.field if request.field is None else request.field,
        bend,
        parse_distance("--for ring=", words["ring"], unit) if "ring" in words else 0.0,
    )


def _magnification(kind: str, text: str) -> float:
    with suppress(ValueError):
        if isfinite(value := float(text)) and value:
            return value
    raise BadOption(f"--for {kind}={text}: is a magnification, a number that is not 0")


def _solved_text(solved: Solved, wanted: Wanted, unit: str) -> str:
    """Share, loss, field and waist of solved sheets."""
    return (
        f"{len(solved.sheets)} sheets pass {percent_text(solved.share)} of the light within "
        f"± {degrees(wanted.field):.3g} deg over {2.0 * wanted.radius:.4g} {unit} (thin lenses), none beyond "
        f"± {degrees(solved.field):.3g} deg; narrowest half width {solved.waist:.4g} {unit}"
    )


def _write_scene(request: StackSheets, design: Design, wanted: Wanted, solved: Solved) -> None:
    """Write the scene of solved sheets: a camera before them, stripes behind."""
    from os.path import relpath

    from clacad.advice.wanted_stack import placed, sheet_keys
    from clacad.config.edit_text import parse, value_text
    from clacad.config.mistakes import Mistake
    from clacad.storage.atomic import write_content

    out = request.out
    assert out is not None
    keys = [sheet_keys(wanted, one) for one in solved.sheets]
    stack = placed([design.replace(own) for own in keys], solved.gaps)
    source = relpath(request.designs[0], out.parent).replace("\\", "/")
    if source.startswith("../../"):
        raise BadOption(f"-o {out}: a scene lies in the folder of {request.designs[0]} or in a folder there")
    given = dict(pair for text in request.set if not isinstance(pair := parse(text), Mistake))
    lines = ["format = 1", f"name = {value_text(out.stem)}", f"unit = {value_text(design.unit)}"]
    for one, own in zip(stack.sheets, keys):
        values = [f"{value_text(key)} = {value_text(value)}" for key, value in (given | own).items()]
        lines += ["", "[[sheet]]", f'id = "{one.id}"', f"design = {value_text(source)}"]
        lines += [f"set = {{ {', '.join(values)} }}", f"z = {one.z!r}"]
    far = 4.0 * wanted.length
    lines += ["", "[camera]", f"position = [0, 0, {-far:.6g}]", f"frame = {2.6 * wanted.radius:.6g}"]
    lines += ["", "[[object]]", 'id = "wall"', 'kind = "screen"', f"at = [0, 0, {wanted.length + far:.6g}]"]
    lines += [f"size = [{far:.6g}, {far:.6g}]", 'pattern = "stripes"', f"period = {wanted.radius:.6g}"]
    write_content(out, "\n".join(lines) + "\n", overwrite=request.overwrite)


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
    from clacad.cli.tables import checks_text, counted, problems
    from clacad.stacking.judge_stack import judge_stack
    from clacad.stacking.make_stack import field_of

    with console.progress() as progress:
        checks = judge_stack(stack, designs, files, field_of(designs, request), progress)
    good = passed(checks)
    word = _verdict(good, checks)
    console.show(
        lambda: {"passed": good, "checks": [check.to_dict() for check in checks]},
        lambda: f"{checks_text(checks)}\n{word}",
        lambda: Brief(word, (problems(checks),), (), word, counted(checks)),
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
    names = ", ".join(str(entry["name"]) for entry in files)
    written = "nothing: -o DIR writes the assembly" if manifest is None else f"{names} in {manifest.folder}"
    console.show(
        lambda: made.to_dict() | {"files": files, "folder": None if out is None else str(out)},
        lambda: f"{stack_text(made)}\nwrote {written}",
        lambda: _brief(made, written),
    )
    return 0


def _brief(made: Stacked, written: str) -> Brief:
    """Share of the light, effect on space, image of a point, share through each sheet."""
    exact = made.exact
    spaces = (text.partition("; chief rays")[0] for text in _spaces(made))
    sheets = zip(made.stack.sheets, exact.sheets, strict=True)
    rows = [
        ("light", f"over {_lit(made)}, slopes of ± {degrees(exact.field):.3g} deg; {_thin(made)}"),
        *(("space", text) for text in spaces),
        ("point", _image_text(made, made.unit)),
        *((f"sheet {one.id}", f"passes {percent_text(share)} of what came so far") for one, share in sheets),
        ("written", written),
    ]
    return Brief(_share(made), (facts(rows),))


def _share(made: Stacked) -> str:
    x, y = made.exact.meridians
    share = f"{percent_text(made.exact.share, unit='')} %{_of_meridians(x.share, y.share)}"
    return f"share of the light that obeys all {len(made.designs)} laws: {share}"


def stack_text(made: Stacked) -> str:
    """A stack as text, the share of light first."""
    from clacad.base.units import millimetres
    from clacad.stacking.assembly import sheet_facts

    exact, unit = made.exact, made.unit
    parts = [
        f"{_share(made)}, over {_lit(made)} and slopes of ± {degrees(exact.field):.3g} deg ({_thin(made)}); "
        "the rest are ghosts, or lost",
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
