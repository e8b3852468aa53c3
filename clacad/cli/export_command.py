"""`clacad export`: write the part, print the fabrication table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

from clacad.cli.console import Progress, say, show_json, show_text
from clacad.cli.design_commands import load_design

if TYPE_CHECKING:
    from clacad.design import Design


class BadOption(ValueError):
    """An option that cannot be understood; exit status 2."""

    exit_status = 2


@dataclass(frozen=True, slots=True)
class ExportRequest:
    """What to export, where to, and how finely."""

    out: Path
    formats: tuple[str, ...]
    slope_error: str | None
    quads: int | None
    step: str
    cells: str | None
    overwrite: bool
    force: bool
    dry_run: bool
    step_schema: str = "ap242"
    pcurves: bool = True
    saddle_bevel: str | None = None
    gpu_instancing: bool = False
    grey_levels: int = 64
    target: str | None = None
    normals: str = "facet"


def export_design(
    path: Path, overrides: list[str], request: ExportRequest, *, json: bool, quiet: bool
) -> int:
    """Export and print what was made; with --dry-run print the forecast only."""
    if request.formats == ("pov",):
        from clacad.cli.render_command import export_scene, is_scene

        if is_scene(path):
            return export_scene(
                path, overrides, request.out, overwrite=request.overwrite, json=json, quiet=quiet
            )
    design = load_design(path, overrides)
    cells = parse_cells(request.cells)
    if not request.force:
        _refuse_early(design, request, cells)
    from clacad.cli.tables import derived_text, files_text
    from clacad.export import export
    from clacad.feasibility import describe, feasibility
    from clacad.prescription import prescribe

    schema, bevel = parse_schema(request.step_schema), parse_length(request.saddle_bevel, design)
    if request.target is not None:
        request = _within_target(design, request, cells, quiet=quiet)
    if request.dry_run:
        return _forecast(design, request, cells, bevel, json=json, quiet=quiet)
    progress = Progress(quiet=quiet)
    try:
        manifest = export(
            design, request.out, request.formats,
            slope_error=parse_slope_error(request.slope_error), quads=request.quads,
            step=parse_step(request.step), cells=cells, overwrite=request.overwrite, force=request.force,
            progress=progress, step_schema=schema, pcurves=request.pcurves, saddle_bevel=bevel,
            gpu_instancing=request.gpu_instancing, grey_levels=request.grey_levels,
        )  # fmt: skip
    finally:
        progress.done()
    if json:
        show_json(dict(manifest.document))
        return 0
    window = prescribe(design if cells is None else design.with_cells(cells))
    text = derived_text(describe(window, feasibility(window)))
    show_text(f"{design.name}\n{text}\nfiles in {manifest.folder}\n{files_text(manifest.files)}", quiet=quiet)
    if not quiet:
        say(f"next: clacad verify {path} --files {request.out}")
    return 0


def _refuse_early(design: Design, request: ExportRequest, cells: tuple[int, int] | None) -> None:
    """Refuse what is too much by its mere count, before anything is loaded that could make it.

    Raises
    ------
    LimitRefused
    """
    from clacad.export.limits import refuse_early

    quads = None if request.target is not None else request.quads
    refuse_early(design if cells is None else design.with_cells(cells), request.formats, quads)


def _within_target(
    design: Design, request: ExportRequest, cells: tuple[int, int] | None, *, quiet: bool
) -> ExportRequest:
    """The request with the coarsest facets that meet its target.

    Raises
    ------
    TargetOutOfReach, LimitRefused, BadOption
    """
    from clacad.accuracy.choose import facets_for
    from clacad.export.formats import known_formats
    from clacad.prescription import prescribe

    assert request.target is not None
    target = parse_angle("--target", request.target)
    if request.quads is not None or request.slope_error is not None:
        raise BadOption("--target chooses the facets: leave out --quads and --slope-error")
    if request.normals not in ("facet", "vertex"):
        raise BadOption(f"--normals {request.normals}: it is facet or vertex")
    made = design if cells is None else design.with_cells(cells)
    formats = known_formats(request.formats)
    chosen = facets_for(
        made, prescribe(made), target, formats, "facet" if request.normals == "facet" else "vertex"
    )
    if chosen is None:
        say(f"target {1e3 * target:g} mrad: none of {', '.join(formats)} has facets to choose", quiet=quiet)
        return request
    say(f"target {1e3 * target:g} mrad: {chosen}", quiet=quiet)
    return replace(request, quads=chosen.quads)


def _forecast(
    design: Design,
    request: ExportRequest,
    cells: tuple[int, int] | None,
    bevel: float,
    *,
    json: bool,
    quiet: bool,
) -> int:
    from clacad.cli.tables import forecast_text
    from clacad.export.request import Request
    from clacad.export.run import forecast_rows, in_all

    step, slope_error = parse_step(request.step), parse_slope_error(request.slope_error)
    asked = Request(
        request.formats, slope_error, request.quads, step, cells, request.overwrite, request.force,
        pcurves=request.pcurves, saddle_bevel=bevel,
    )  # fmt: skip
    found = forecast_rows(design, asked)
    rows: list[dict[str, Any]] = [row.to_dict() for row in found]
    if json:
        show_json(rows)
    else:
        seconds = in_all(request.formats, found)
        show_text(f"{forecast_text(rows)}\nin all {seconds} of processor time", quiet=quiet)
    return 0


def parse_cells(text: str | None) -> tuple[int, int] | None:
    """Read "10x10" (or "10" for 10 by 10) as a pair; None stays None."""
    if text is None:
        return None
    parts = text.lower().replace("×", "x").split("x")
    if len(parts) not in (1, 2) or not all(part.strip().isdecimal() and int(part) > 0 for part in parts):
        raise BadOption(f"--cells {text}: it is two whole numbers above 0, such as 10x10")
    a, b = int(parts[0]), int(parts[-1])
    return a, b


def parse_slope_error(text: str | None) -> float | Literal["auto"]:
    """Read "auto", or an angle such as "5 mrad" as radians."""
    return "auto" if text is None or text == "auto" else parse_angle("--slope-error", text)


def parse_angle(option: str, text: str) -> float:
    """Read an angle above 0 such as "5 mrad" as radians; a bare number is degrees, as in a design file."""
    from clacad.design.units import family_of, in_radians, split

    parts = split(text)
    if parts is None or (parts[1] and family_of(parts[1]) != "angle"):
        raise BadOption(f"{option} {text}: it is an angle such as '5 mrad' or '0.3 deg'")
    value = in_radians(parts[0], parts[1] or "deg")
    if not value > 0.0:
        raise BadOption(f"{option} {text}: it is an angle above 0, such as '5 mrad'")
    return value


def parse_step(text: str) -> Literal["auto", "fused", "instanced"]:
    """One of the three STEP modes."""
    if text not in ("auto", "fused", "instanced"):
        raise BadOption(f"--step {text}: it is one of auto, fused, instanced")
    return cast("Literal['auto', 'fused', 'instanced']", text)


def parse_schema(text: str) -> Literal["ap242", "ap214"]:
    """One of the two application protocols of STEP."""
    if text.lower() not in ("ap242", "ap214"):
        raise BadOption(f"--step-schema {text}: it is one of ap242, ap214")
    return cast("Literal['ap242', 'ap214']", text.lower())


def parse_length(text: str | None, design: Design) -> float:
    """Read a length such as "5 um" in the design's unit; a bare number is in that unit, None is 0."""
    from clacad.design.units import family_of, in_metres, split

    if text is None:
        return 0.0
    parts = split(text)
    if parts is None or (parts[1] and family_of(parts[1]) != "length"):
        raise BadOption(f"--saddle-bevel {text}: it is a length such as '5 um'")
    value = in_metres(parts[0], parts[1]) / design.unit_m if parts[1] else float(parts[0])
    if not value > 0.0:
        raise BadOption(f"--saddle-bevel {text}: it is a length above 0, such as '5 um'")
    return value
