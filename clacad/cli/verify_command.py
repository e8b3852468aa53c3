"""`clacad verify`: trace what was written, write the report, print the verdict."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.command import Command, OfDesignAsMade, declared, flag, option
from clacad.cli.console import Brief, Console, Progress, facts, table
from clacad.cli.option_values import (
    BadOption,
    cell_option,
    load_counted,
    parse_angle,
    parse_cells,
    per_format,
    tilted_option,
)

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.judging.delivery import Delivery
    from clacad.measuring.measure import Maps
    from clacad.verification import Report


@dataclass(frozen=True, kw_only=True)
class Verify(OfDesignAsMade):
    """Trace what was written, write the report, print the verdict."""

    files: Path | None = option("--files DIR|FILE", "What was written, or a file of a measured part.")
    out: Path | None = option("-o, --out DIR", "Write report.html, report.json here.")
    cells: tuple[int, int] | None = declared("cells", read=parse_cells)
    pdf: bool = flag("--pdf", "Write report.pdf, too (extra: clacad[pdf]).")
    timings: bool = flag(
        "--timings", "Show seconds of this run in the report; its bytes then change from run to run."
    )
    rays: int = option("--rays N", "Rays of the main bundle.", 65536, least=64, most=100_000_000)
    target: float | None = option(
        "--target E",
        "Fewest rays that resolve errors of this size, and files must be within it, e.g. '0.5 mrad'.",
        read=parse_angle,
    )
    role: tuple[str, ...] = option(
        "--role WORD|FORMAT=WORD,...",
        "What files are for: master (parts are made from it), preview, tooling, or scan.",
        (),
    )
    overwrite: bool = declared("overwrite")
    also: tuple[Path, ...] = option(
        "[FILE]...", "More files, or a second map of the part, after --files.", ()
    )
    side: tuple[str, ...] = option("--side FILE=front|back", "Side that a map shows; else by its name.", ())
    z_scale: str | None = option("--z-scale TEXT", "Scale of a map's heights, e.g. '1.0063 +- 1e-4'.")
    lateral_scale: str | None = option("--lateral-scale TEXT", "Lateral scale of a map.")
    tilted: Path | None = tilted_option()
    cell: tuple[int, int] | None = cell_option("Cell of the sheet nearest to the middle of the map.")
    unit: str | None = option("--unit WORD", "Length unit of a cloud x y z that states none, e.g. um.")


def run(request: Verify, console: Console) -> int:
    """Judge a design and its files; the exit status is that of the report.

    With a target its error chooses the number of rays, and every file is judged by it.
    """
    if request.out is None and (request.pdf or request.timings):
        raise BadOption("--pdf and --timings are about the report: give its folder with -o")
    design = load_counted(request.design, request.overrides)
    from clacad.storage.atomic import require_folder

    written: list[Path] = []
    with console.progress() as progress:
        maps = _maps(request)
        delivery, rays = (None, request.rays) if maps is not None else _subjects(design, request)
        if request.out is not None:
            require_folder(request.out)
        with _announced(rays, delivery, request, progress, console):
            report = _judged(design, delivery, maps, rays, request, progress)
            if request.out is not None:
                report = report.with_evidence(progress)
                written = _write(report, request.out, request, progress)
    paths = ", ".join(map(str, written))
    console.show(
        report.to_dict,
        lambda: _text(report, design.name, paths),
        lambda: _brief(report, design.name, paths),
    )
    return report.exit_status


def _subjects(design: Design, request: Verify) -> tuple[Delivery | None, int]:
    """The files to judge, and the number of rays."""
    from clacad.judging.delivery import declared_roles, list_files

    roles = declared_roles(per_format("--role", request.role))
    delivery = None if request.files is None else list_files(request.files, roles, request.also)
    return delivery, request.rays if request.target is None else _rays(design, request, request.target)


@contextmanager
def _announced(
    rays: int, delivery: Delivery | None, request: Verify, progress: Progress, console: Console
) -> Iterator[None]:
    """Print the cost of the block before it, and record its actual cost."""
    from clacad.verification.run import seconds, task

    subjects, page = () if delivery is None else delivery.subjects, request.out is not None
    with console.forecast(task(subjects, page), seconds(rays, subjects, page)) as span:
        progress.expect(span.middle)
        yield


def _maps(request: Verify) -> Maps | None:
    """The height maps of a measured part among the files; None where they are files of another kind."""
    files = [] if request.files is None else [request.files, *request.also]
    stated = [
        request.z_scale,
        request.lateral_scale,
        request.tilted,
        request.unit,
        request.cell,
        *request.side,
    ]
    if request.also and not files:
        raise BadOption(f"{request.also[0]}: a word too many; files are given with --files")
    scan = per_format("--role", request.role) == "scan"
    only = any(one is not None for one in stated) or len(files) > 1 and not request.role
    if not files or not (scan or only):
        return None
    from clacad.measuring.measure import Maps, maps_of
    from clacad.measuring.read_map import ENDINGS, is_map

    if not only and not is_map(files[0]):
        return None
    if not scan or any(path.suffix.lower() not in ENDINGS for path in files):
        raise BadOption(
            "scales, sides and several files without a role are of height maps"
            f" ({', '.join(ENDINGS)}): --role scan"
        )
    if request.target is not None or request.cells is not None:
        raise BadOption("--target and --cells are not for height maps")
    sides = per_format("--side", request.side) or {}
    if isinstance(sides, str):
        raise BadOption(f"--side {sides}: it is FILE=front or FILE=back")
    given = Maps(
        None, None, request.tilted, request.z_scale, request.lateral_scale, request.unit, request.cell
    )
    return maps_of(files, sides, given)


def _judged(
    design: Design,
    delivery: Delivery | None,
    maps: Maps | None,
    rays: int,
    request: Verify,
    progress: Progress,
) -> Report:
    """The report, by the target if one is given; the verdict of the design alone is printed at once."""
    from clacad.verification.run import judged_by, verified

    steps = verified(design, delivery, request.cells, rays, progress, maps, request.as_made)
    report = next(steps)
    if delivery is not None or maps is not None:
        progress.say(f"the design itself {report.verdict()}; now its files")
    for whole in steps:
        report = whole
    return report if request.target is None else judged_by(report, request.target)


def _write(report: Report, out: Path, request: Verify, progress: Progress) -> list[Path]:
    """Write page, numbers and maps of measured parts; their paths."""
    from clacad.report import write_report
    from clacad.report.measured_section import made_section, measured_section

    more = [] if report.made is None else [made_section(report.made)]
    more += [] if report.measured is None else [measured_section(report.measured)]
    written = write_report(
        report,
        out,
        overwrite=request.overwrite,
        progress=progress,
        more=more,
        pdf=request.pdf,
        timings=request.timings,
    )
    return [
        *written,
        *_measured(report, out, request.overwrite),
        *_deviations(report, out, request.overwrite),
    ]


def _measured(report: Report, out: Path, overwrite: bool) -> list[Path]:
    """Numbers, table and deviation maps of a part measured by height maps."""
    if report.measured is None:
        return []
    from clacad.measuring.measured import write_measured

    return write_measured(report.measured, out, overwrite=overwrite)


def _text(report: Report, name: str, paths: str) -> str:
    """Checks, verdicts and the final verdict."""
    from clacad.cli.tables import checks_text
    from clacad.verification.light.viewed import headline

    first = headline(report.checks)
    lines = [name, *([f"  {first}"] if first else []), checks_text(report.checks)]
    lines += [table([one.row() for one in report.verdicts])] if report.verdicts else []
    if report.made is not None:
        lines += report.made.lines()
    lines += [_part(report)] if report.measured is not None else []
    lines += [f"report: {paths}"] if paths else []
    return "\n".join([*lines, report.verdict()])


def _part(report: Report) -> str:
    """Table of a measured part next to the design, and its scales."""
    from clacad.measuring.measured import iso_rows

    part = report.measured
    assert part is not None
    scales = f"  scale of heights {part.z_scale}; lateral scale {part.lateral_scale}"
    return "\n".join([table([("as measured", "unit", "design", "measured"), *iso_rows(part)]), scales])


def _brief(report: Report, name: str, paths: str) -> Brief:
    """The share of light for the viewer, one line a file, failures and warnings with remedies."""
    from clacad.cli.tables import counted, problems
    from clacad.verification.light.viewed import headline

    word = report.verdict()
    rows = [*facts([("light", headline(report.checks))]), *facts(one.row() for one in report.verdicts)]
    if report.made is not None:
        rows += facts([("as made", one) for one in report.made.advice])
    if report.measured is not None:
        from clacad.measuring.measured import facts_of

        rows += facts(facts_of(report.measured))
    lists = rows, problems(report.checks), facts([("report", paths)])
    return Brief(f"{name}: {word}", lists, (), word, counted(report.checks))


def _deviations(report: Report, out: Path, overwrite: bool) -> list[Path]:
    """Maps of the deviations of each measured part, next to the report."""
    from clacad.judging.deviation_map import write_deviation

    found: list[Path] = []
    for file in report.files:
        mapped = None if file.mesh is None else file.mesh.facts.get("deviation")
        if mapped is not None:
            found += write_deviation(mapped, file.subject.name, out, overwrite=overwrite)
    return found


def _rays(design: Design, request: Verify, target: float) -> int:
    """Rays for a target; refused at once where a file's format cannot hold it."""
    from clacad.exporting.formats.registry import kind_ending
    from clacad.prescription.prescribe import prescribe
    from clacad.verification.accuracy.choose_setting import floor_of, out_of_reach
    from clacad.verification.run import rays_for

    cells = request.cells
    window = prescribe(design if cells is None else design.with_cells(cells))
    for file in (request.files, *request.also):
        kind = None if file is None or not file.is_file() else kind_ending(file.suffix)
        if kind is not None and kind.family == "mesh":
            format = kind.like or kind.word
            floor = floor_of(design, window, format)
            if not floor.floor < target:
                raise out_of_reach(design, window, target, format, floor)
    return rays_for(target, design.check.law_rms)


COMMANDS = (Command("verify", "judge", Verify, run),)
