"""`clacad export`: write the part, print the fabrication table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.whole_numbers import whole_number
from clacad.cli.console import Progress, say, show_json, show_text
from clacad.cli.design_commands import load_design
from clacad.cli.option_values import (
    BadOption,
    joined,
    one_of,
    parse_angle,
    parse_cells,
    parse_length,
    parse_slope_error,
    per_format,
)

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.exporting.request import Request


@dataclass(frozen=True, slots=True)
class ExportWords:
    """What the command line says of an export.

    out : Path
    options : mapping
        Those of `clacad.exporting.request.Request` by name, as typed.
    dry_run : bool
    target, normals : str
        Of the coarsest facets that are good enough, and what a file is read by.
    """

    out: Path
    options: Mapping[str, Any]
    dry_run: bool = False
    target: str | None = None
    normals: str = "facet"


def export_design(path: Path, overrides: list[str], words: ExportWords, *, json: bool, quiet: bool) -> int:
    """Export and print what was made; with --dry-run print the forecast only."""
    from clacad.exporting.formats.pov import WORD as POV

    formats = tuple(word.strip() for word in words.options["formats"].split(",") if word.strip())
    if formats == (POV,):
        from clacad.cli.export_scene import export_scene, is_scene

        if is_scene(path):
            overwrite = words.options["overwrite"]
            return export_scene(path, overrides, words.out, overwrite=overwrite, json=json, quiet=quiet)
    design = load_design(path, overrides)
    asked = _asked(design, formats, words.options)
    if not asked.force:
        _refuse_uncountable(design, asked)
    if words.target is not None:
        asked = _within_target(design, words, asked, quiet=quiet)
    if words.dry_run:
        return _forecast(design, words.out, asked, json=json, quiet=quiet)
    return _export(path, design, words.out, asked, json=json, quiet=quiet)


def _asked(design: Design, formats: tuple[str, ...], typed: Mapping[str, Any]) -> Request:
    """What the words of the command line ask for.

    Raises
    ------
    BadOption, BadRequest
    """
    from clacad.exporting.quads_and_roles import asked_quads, asked_roles
    from clacad.exporting.request import Request

    quads, role = (per_format(f"--{name}", joined(typed[name])) for name in ("quads", "role"))
    read = {
        "formats": formats, "slope_error": parse_slope_error(typed["slope_error"]),
        "quads": asked_quads(_numbers(quads), formats), "step": one_of("step", typed["step"]),
        "cells": parse_cells(typed["cells"]), "step_schema": one_of("step_schema", typed["step_schema"], str.lower),
        "saddle_bevel": parse_length(typed["saddle_bevel"], design), "role": asked_roles(role, formats), "paper": one_of("paper", typed["paper"], str.lower),
    }  # fmt: skip
    return Request(**{**typed, **read})


def _export(path: Path, design: Design, out: Path, asked: Request, *, json: bool, quiet: bool) -> int:
    """Write the files, print what they are and the derived numbers; return the exit status."""
    from clacad.cli.tables import derived_text, files_text
    from clacad.exporting.run import run_export
    from clacad.prescription.prescribe import prescribe
    from clacad.sheet.feasibility import describe, feasibility

    progress = Progress(quiet=quiet)
    _announce(_cut(design, asked), asked, progress, quiet=quiet)
    try:
        manifest = run_export(design, str(out), asked, progress)
    finally:
        progress.done()
    for entry in manifest.files:
        _warn_of(str(entry["name"]), entry, design.check.of_light[0])
    if json:
        show_json(dict(manifest.document))
        return 0
    window = prescribe(_cut(design, asked))
    text = derived_text(describe(window, feasibility(window, *design.viewing_places)))
    files = files_text(manifest.files, design.check.of_light[0])
    show_text(f"{design.name}\n{text}\nfiles in {manifest.folder}\n{files}", quiet=quiet)
    if not quiet:
        say(f"next: clacad verify {path} --files {out}")
    return 0


def _announce(design: Design, asked: Request, progress: Progress, *, quiet: bool) -> None:
    """Say at once about how long it will take; a closer forecast needs meshes, and takes its time."""
    from clacad.cli.announce_cost import WORTH_SAYING
    from clacad.exporting.forecast import rough_span

    span = rough_span(design, asked)
    progress.expect(span.middle)
    if span.low >= WORTH_SAYING:  # so wide a range says nothing of short ones
        say(f"this takes {span} of processor time", quiet=quiet)


def _warn_of(name: str, entry: Mapping[str, Any], limit: float) -> None:
    """Say on stderr, even when quiet, where a file was declared a master and its light is forecast beyond the limits."""
    if entry.get("role_overstated"):
        rms = entry.get("forecast_law_rms")
        light = "too little light gets through it" if rms is None else (
            f"light through it is forecast to miss the law by {1e3 * rms:.3g} mrad rms (limit {1e3 * limit:.3g})"
        )  # fmt: skip
        others = [key for key in entry.get("forecast_beyond", ()) if key != "law_rms"]
        light += f", beyond the limit of {', '.join(others)}" if others else ""
        say(f"warning: {name} was declared a master, and {light}", quiet=False)


def _cut(design: Design, asked: Request) -> Design:
    return design if asked.cells is None else design.with_cells(asked.cells)


def _refuse_uncountable(design: Design, asked: Request) -> None:
    """Refuse more lenslets than are ever gone through, before anything is loaded that could.

    Raises
    ------
    LimitRefused
    """
    from clacad.exporting.limits import refuse_uncountable

    refuse_uncountable(_cut(design, asked))


def _within_target(design: Design, words: ExportWords, asked: Request, *, quiet: bool) -> Request:
    """The request with the coarsest facets that meet its target in the files that are no declared previews.

    Raises
    ------
    TargetOutOfReach, LimitRefused, BadOption
    """
    from clacad.exporting.formats.registry import known
    from clacad.exporting.roles import Role
    from clacad.exporting.run import refuse_impossible
    from clacad.prescription.prescribe import prescribe
    from clacad.verification.accuracy.choose_setting import facets_for

    assert words.target is not None
    target = parse_angle("--target", words.target)
    masters = [name for name in known(asked.formats) if asked.role.get(name) is not Role.PREVIEW]
    if words.options["slope_error"] is not None or any(name in asked.quads for name in masters):
        raise BadOption(
            "--target chooses the facets of all files but declared previews: leave out --quads for them, and "
            "--slope-error"
        )
    if words.normals not in ("facet", "vertex"):
        raise BadOption(f"--normals {words.normals}: it is facet or vertex")
    refuse_impossible(design, asked)
    made = _cut(design, asked)
    chosen = facets_for(
        made, prescribe(made), target, masters, "facet" if words.normals == "facet" else "vertex"
    )
    if chosen is None:
        say(f"target {1e3 * target:g} mrad: none of {', '.join(masters)} has facets to choose", quiet=quiet)
        return asked
    say(f"target {1e3 * target:g} mrad: {chosen}", quiet=quiet)
    _name_cheapest(made, target, chosen.formats, quiet=quiet)
    return replace(asked, quads={**asked.quads, **dict.fromkeys(chosen.formats, chosen.quads)})


def _name_cheapest(design: Design, target: float, asked: Sequence[str], *, quiet: bool) -> None:
    """Say which file is within the target for the fewest bytes, where it is another than those asked for."""
    from clacad.prescription.prescribe import prescribe
    from clacad.verification.accuracy.cheapest_file import files_within, whole_meshes
    from clacad.verification.accuracy.choose_setting import mesh_floors

    window = prescribe(design)
    best = files_within(design, window, mesh_floors(design, window, whole_meshes()), target)[0]
    if best.format not in asked:
        say(f"cheapest file within it: {best}: {best.options}", quiet=quiet)


def _forecast(design: Design, out: Path, asked: Request, *, json: bool, quiet: bool) -> int:
    """Print what an export would cost and what its files would be; refused is what an export would be refused."""
    from clacad.cli.tables import forecast_text
    from clacad.exporting.run import forecast_rows, in_all

    found = forecast_rows(design, asked, out)
    rows: list[dict[str, Any]] = [row.to_dict() for row in found]
    for row in rows:
        _warn_of(row["format"], row, design.check.of_light[0])
    if json:
        show_json(rows)
    else:
        show_text(f"{forecast_text(rows)}\nin all {in_all(found)} of processor time", quiet=quiet)
    return 0


def _numbers(words: str | dict[str, str] | None) -> Any:
    """Words that are whole numbers as such; the others as they are, for `asked_quads` to judge."""
    if isinstance(words, dict):
        return {name: _numbers(word) for name, word in words.items()}
    number = None if words is None else whole_number(words)
    return words if number is None else number
