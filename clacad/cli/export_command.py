"""`clacad export`: write the part, print the fabrication table; of a scene file the scene for POV-Ray."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from clacad.base.text import count_text, mrad_text, short_size_text, whole_number
from clacad.cli.command import Command, OfDesignAsMade, declared, dry_run_option, option, required
from clacad.cli.console import Brief, Console, Progress, facts, say
from clacad.cli.option_values import (
    BadOption,
    command_line,
    load_design,
    one_of,
    parse_angle,
    parse_bevel,
    parse_cell,
    parse_cells,
    parse_distance,
    parse_slope_error,
    per_format,
    words_of,
)

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.exporting.manifest import Manifest
    from clacad.exporting.request import Request
    from clacad.sheet.window import Window


@dataclass(frozen=True, kw_only=True)
class Export(OfDesignAsMade):
    """Write the part: files and manifest.json; prints the fabrication table."""

    out: Path = required("-o, --out DIR", "Folder to write to.")
    formats: tuple[str, ...] = declared("formats", read=words_of)
    slope_error: float | Literal["auto"] | None = declared("slope_error", None, read=parse_slope_error)
    quads: tuple[str, ...] = declared("quads", ())
    role: tuple[str, ...] = declared("role", ())
    step: str = declared("step")
    fused: bool = declared("fused")
    cells: tuple[int, int] | None = declared("cells", read=parse_cells)
    cell: tuple[int, int] | None = declared("cell", read=parse_cell)
    overwrite: bool = declared("overwrite")
    force: bool = declared("force")
    dry_run: bool = dry_run_option()
    step_schema: str = declared("step_schema")
    pcurves: bool = declared("pcurves")
    saddle_bevel: str | None = declared("saddle_bevel", None)
    gpu_instancing: bool = declared("gpu_instancing")
    grey_levels: int = declared("grey_levels")
    paper: str = declared("paper")
    nose: str | None = declared("nose", None)
    tool_step: str | None = declared("tool_step", None)
    tool_order: str = declared("tool_order")
    calibration: str | None = declared("calibration", None)
    compensate: bool = declared("compensate")
    target: float | None = option(
        "--target E",
        "Coarsest facets whose light is within this rms direction error of the exact surfaces, e.g. '0.5 "
        "mrad'.",
        read=parse_angle,
    )
    normals: str = option(
        "--normals WORD", "With --target, what the file is read by: facet or vertex.", "facet"
    )


def run(given: Export, console: Console) -> int:
    """Export and print what was made; with --dry-run print the forecast only."""
    from clacad.exporting.formats.pov import WORD as POV

    if given.formats == (POV,) and is_scene(given.design):
        return _export_scene(given, console)
    design = load_design(given.design, given.overrides)
    if not given.force:
        _refuse_uncountable(design if given.cells is None else design.with_cells(given.cells))
    request = _request(design, given)
    if given.target is not None:
        request = _within_target(design, given, given.target, request, console)
    window = None
    if given.as_made:
        from clacad.prescription.prescribe import prescribe

        window = prescribe(_cut(design, request))
        request = _as_made(design, window, request, console)
    if given.dry_run:
        return _forecast(design, given.out, request, console, window)
    return _export(given, design, request, console, window)


def _request(design: Design, given: Export) -> Request:
    """The request of an export in numbers."""
    from clacad.exporting.quads_and_roles import asked_quads, asked_roles
    from clacad.exporting.request import OPTIONS, Request

    quads, role = per_format("--quads", given.quads), per_format("--role", given.role)
    typed = {one.name: getattr(given, one.name) for one in fields(given) if one.name in OPTIONS}
    read = {
        "slope_error": given.slope_error or "auto",
        "quads": asked_quads(_numbers(quads), given.formats),
        "step": one_of("step", given.step),
        "step_schema": one_of("step_schema", given.step_schema, str.lower),
        "saddle_bevel": parse_bevel(given.saddle_bevel, design),
        "role": asked_roles(role, given.formats),
        "paper": one_of("paper", given.paper, str.lower),
        "tool_order": one_of("tool_order", given.tool_order, str.lower),
        **{name: _length(name, getattr(given, name), design) for name in ("nose", "tool_step")},
    }
    return Request(**{**typed, **read})


def _as_made(design: Design, window: Window, request: Request, console: Console) -> Request:
    """The request with the light of the sheet as its process makes it, which is printed."""
    from clacad.making.light_as_made import judge_as_made

    found = judge_as_made(design, window)
    for check in found.checks:
        console.say(f"{check.id} {check.state}: {check.sentence}")
    return replace(request, as_made=found.to_dict())


def _length(name: str, text: str | None, design: Design) -> float | None:
    """Length of an option in design units; None where it is not given."""
    from clacad.exporting.request import OPTIONS

    return None if text is None else parse_distance(OPTIONS[name].flag, text, design.unit)


def _export(given: Export, design: Design, request: Request, console: Console, window: Window | None) -> int:
    """Write the files, print them and the derived numbers; return the exit status."""
    from clacad.exporting.run import run_export

    with console.progress() as progress:
        _announce(_cut(design, request), request, progress, console)
        manifest = run_export(design, str(given.out), request, progress, window)
    for entry in manifest.files:
        _warn_of(str(entry["name"]), entry, design.check.of_light[0])

    def text() -> str:
        from clacad.cli.tables import derived_text, files_text
        from clacad.prescription.prescribe import prescribe
        from clacad.sheet.feasibility import describe, feasibility

        built = prescribe(_cut(design, request)) if window is None else window
        derived = derived_text(describe(built, feasibility(built, *design.viewing_places)))
        files = files_text(manifest.files, design.check.of_light[0])
        return f"{design.name}\n{derived}\nfiles in {manifest.folder}\n{files}\nnext: {following}"

    cells = () if given.cells is None else ("--cells", "x".join(map(str, given.cells)))
    where = "--files", given.out, "-o", given.out / "report"
    following = command_line("clacad verify", given.design, *cells, *where, changes=given.overrides)
    console.show(lambda: dict(manifest.document), text, lambda: _brief(design, manifest, following))
    return 0


def _brief(design: Design, manifest: Manifest, following: str) -> Brief:
    """One line a file: size, role, light of its limit."""
    limit, files = design.check.of_light[0], list(manifest.files)
    rows = []
    for entry in files:
        role = str(entry.get("role", "")).replace("-", " ") + " (declared)" * bool(entry.get("role_declared"))
        rms = entry.get("forecast_law_rms")
        light = "" if rms is None else f"light {mrad_text(rms, 3, unit='')} of {mrad_text(limit, 3)} rms"
        made = entry.get("forecast_law_rms_as_made")
        light += "" if made is None else f", all light as made {mrad_text(made, 3)}"
        missing = len(entry.get("left_out", ()))
        left_out = f"does not hold {count_text(missing, 'thing')} of the design" if missing else ""
        rows.append(
            (entry["name"], short_size_text(entry["bytes"]), role, "; ".join(filter(None, (light, left_out))))
        )
    size = short_size_text(sum(entry["bytes"] for entry in files))
    head = f"{design.name}: wrote {count_text(len(files), 'file')} ({size}) in {manifest.folder}"
    return Brief(head, (facts(rows),), (following,))


def _announce(design: Design, request: Request, progress: Progress, console: Console) -> None:
    """Print a rough cost at once; a closer forecast needs meshes, and takes its time."""
    from clacad.exporting.forecast import rough_span

    span = rough_span(design, request)
    progress.expect(span.middle)
    console.announce(span, span.low)  # its range is too wide to be of use for short ones


def _warn_of(name: str, entry: Mapping[str, Any], limit: float) -> None:
    """Print, even when quiet, that the light of a declared master is forecast beyond the limits."""
    if entry.get("role_overstated"):
        rms = entry.get("forecast_law_rms")
        light = (
            "too little light gets through it"
            if rms is None
            else (
                f"light through it is forecast to miss the law by {mrad_text(rms, 3)} rms (limit "
                f"{mrad_text(limit, 3, unit='')})"
            )
        )
        others = [key for key in entry.get("forecast_beyond", ()) if key != "law_rms"]
        light += f", beyond the limit of {', '.join(others)}" if others else ""
        say(f"warning: {name} was declared a master, and {light}")


def _cut(design: Design, request: Request) -> Design:
    return design if request.cells is None else design.with_cells(request.cells)


def _refuse_uncountable(design: Design) -> None:
    """Refuse more lenslets than are ever counted through, before a module is loaded that could."""
    from clacad.exporting.limits import refuse_uncountable

    refuse_uncountable(design)


def _within_target(
    design: Design, given: Export, target: float, request: Request, console: Console
) -> Request:
    """The request with the coarsest facets that meet its target in files that are no declared previews."""
    from clacad.exporting.formats.registry import known
    from clacad.exporting.roles import Role
    from clacad.exporting.run import refuse_impossible
    from clacad.prescription.prescribe import prescribe
    from clacad.verification.accuracy.choose_setting import facets_for

    masters = [name for name in known(request.formats) if request.role.get(name) is not Role.PREVIEW]
    if given.slope_error is not None or any(name in request.quads for name in masters):
        raise BadOption(
            "--target chooses the facets of all files but declared previews: leave out --quads for them, and "
            "--slope-error"
        )
    if given.normals not in ("facet", "vertex"):
        raise BadOption(f"--normals {given.normals}: it is facet or vertex")
    refuse_impossible(design, request)
    made = _cut(design, request)
    normals: Literal["facet", "vertex"] = "facet" if given.normals == "facet" else "vertex"
    chosen = facets_for(made, prescribe(made), target, masters, normals)
    if chosen is None:
        console.say(f"target {mrad_text(target, 6)}: none of {', '.join(masters)} has facets to choose")
        return request
    console.say(f"target {mrad_text(target, 6)}: {chosen}")
    _name_cheapest(made, target, chosen.formats, console)
    return replace(request, quads={**request.quads, **dict.fromkeys(chosen.formats, chosen.quads)})


def _name_cheapest(design: Design, target: float, chosen: Sequence[str], console: Console) -> None:
    """Print which file is within the target for the fewest bytes if it is none of those chosen."""
    from clacad.prescription.prescribe import prescribe
    from clacad.verification.accuracy.choose_setting import files_within, mesh_floors, whole_meshes

    window = prescribe(design)
    best = files_within(design, window, mesh_floors(design, window, whole_meshes()), target)[0]
    if best.format not in chosen:
        console.say(f"cheapest file within it: {best}: {best.options}")


def _forecast(design: Design, out: Path, request: Request, console: Console, window: Window | None) -> int:
    """Print the cost of an export and the roles of its files; refuse what an export would be refused."""
    from clacad.cli.tables import forecast_text
    from clacad.exporting.run import forecast_rows, in_all

    found = forecast_rows(design, request, out, window)
    rows: list[dict[str, Any]] = [row.to_dict() for row in found]
    for row in rows:
        _warn_of(row["format"], row, design.check.of_light[0])
    console.show(lambda: rows, lambda: f"{forecast_text(rows)}\nin all {in_all(found)} of processor time")
    return 0


def _numbers(words: str | dict[str, str] | None) -> Any:
    """Words that are whole numbers as numbers; the others unchanged, for `asked_quads` to judge."""
    if isinstance(words, dict):
        return {name: _numbers(word) for name, word in words.items()}
    number = None if words is None else whole_number(words)
    return words if number is None else number


# -- scenes --------------------------------------------------------------------------------------------------


def is_scene(path: Path) -> bool:
    """Whether a file is a scene: it has a sheet, which no design has."""
    from clacad.config.toml_text import top_keys

    return "sheet" in top_keys(str(path))


def _export_scene(given: Export, console: Console) -> int:
    """Write a scene, sheet and all, for POV-Ray; of an animated scene the first frame."""
    from clacad.exporting.pov.pov_scene import write_pov
    from clacad.paper.make_atlas import manifest_of
    from clacad.prescription.prescribe import prescribe
    from clacad.rendering.sheet_passage import stack_of
    from clacad.scene import load_scene
    from clacad.storage.atomic import Stage, safe_name

    scene, out = load_scene(given.design, given.set), given.out
    still = scene.at(0) if scene.animation is not None else scene
    with Stage(out, overwrite=given.overwrite) as stage:
        name = f"{safe_name(still.name)}.pov"
        sheets = stack_of(still) if len(still.sheets) > 1 else prescribe(still.design())
        write_pov(sheets, stage.path(name), still)
        stage.publish(manifest_of(stage, "scene"))
    width, height = still.camera.pixels
    console.show(
        lambda: {"folder": str(out), "files": [name]},
        lambda: f"wrote {out / name}: povray +I{name} +W{width} +H{height} -A File_Gamma=1.0",
    )
    return 0


COMMANDS = (Command("export", "make", Export, run),)
