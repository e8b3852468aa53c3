"""The commands and their options. Bodies live in the module of the command, imported when it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from clacad.cli.option_values import joined
from clacad.cli.options import (
    EPILOG,
    HELP,
    Again,
    Cells,
    Design,
    Grouped,
    Json,
    Out,
    Overwrite,
    Quiet,
    Replace,
    Scheduler,
    Set,
    Verbose,
    Workers,
    declared,
    print_version,
)  # fmt: skip
from clacad.exporting.request import DEFAULTS

app = typer.Typer(
    cls=Grouped,
    help=HELP,
    epilog=EPILOG,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)


@app.callback()
def _main(
    version: Annotated[bool, typer.Option("--version", callback=print_version, is_eager=True, help="Print the version.")]
    = False,
) -> None:  # fmt: skip
    pass


@app.command()
def new(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="Name of the design; writes NAME.toml. Without it, and at "
                                               "a terminal, you are asked.", show_default=False)] = None,
    template: Annotated[str | None, typer.Option("--template", metavar="T", help="paper, biconvex, galilean, slab, plano, "
                                "hexagonal, tilted, window; or a design of the paper: fig3, fig6-theta-1, paper-b …; default "
                                "paper.")] = None,
    wish: Annotated[list[str] | None, typer.Option("--for", metavar="KEY=VALUE,...", help="Find a design that does this and "
                                "passes verify: eta, width or circle, viewing, object, process, material, form, kind, delta, "
                                "euler, field; e.g. 'eta=-1, circle=60 mm, process=moulding'. Repeatable.")] = None,
    list_: Annotated[bool, typer.Option("--list", help="Print the templates with a line about each.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the file, write nothing.")] = False,
    overwrite: Replace = False,
    set: Set = None,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:  # fmt: skip
    """Write a commented design file: from a template, or for a wish, tried until it passes."""
    from clacad.cli.new_command import NewRequest, list_templates, new_design

    if list_:
        return list_templates(json=json, quiet=quiet)
    request = NewRequest(name, template, tuple(wish or ()), tuple(set or ()), dry_run, overwrite)
    return new_design(request, json=json, quiet=quiet)


@app.command()
def schema(
    scene: Annotated[bool, typer.Option("--scene", help="Of scene files instead of design files.")] = False,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Print the JSON Schema of design files, or of scene files, so that editors complete keys."""
    from clacad.cli.design_commands import print_schema

    return print_schema(scene=scene)


@app.command()
def check(
    design: Design,
    fix: Annotated[bool, typer.Option("--fix", help="Find the fewest keys that make it pass; the law, the material and all "
                                      "limits stay.")] = False,
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE", help="With --fix, write the design that passes "
                                             "here, comments kept.")] = None,
    overwrite: Replace = False,
    set: Set = None,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:  # fmt: skip
    """Derive what would be made, say whether verify will pass, and which keys would make it."""
    from clacad.cli.check_command import check_design, fix_design

    if fix:
        return fix_design(design, set or [], out, overwrite=overwrite, json=json, quiet=quiet)
    if out is not None:
        raise typer.BadParameter("-o is where --fix writes the design that passes: give --fix, too")
    return check_design(design, set or [], json=json, quiet=quiet)


@app.command()
def optimise(
    design: Design,
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE", help="Better design file to write.")] = None,
    free: Annotated[str, typer.Option("--free", metavar="A,B", help="What may change: radii, conic, bending (own radii a "
                                      "face), a4, a6, a8, offset, field (the field lens).")] = "radii,conic",
    field: Annotated[str | None, typer.Option("--field", metavar="E", help="Half angle of the cone of rays, e.g. '1 deg'; "
                                              "default the design's check.field.")] = None,
    weights: Annotated[str | None, typer.Option("--weights", metavar="P:W,P:W", help="Parts of the field and how much each "
                                                "counts, e.g. .5:1,1:1; default the whole field.")] = None,
    tolerances: Annotated[bool, typer.Option("--tolerances", help="Seek the least expected error of parts made with the design's "
                                             "[tolerances], not of the perfect part.")] = False,
    seconds: Annotated[float | None, typer.Option("--seconds", metavar="S", help="End the search after so long with the best so "
                                                  "far; one that ends before gives the same with any number.")] = None,
    compare: Annotated[Path | None, typer.Option("--compare", metavar="PAGE", help="Write a page with before and after: spots, "
                                                 "error maps, sections, thicknesses, and whether the gain survives 1 µm and "
                                                 "0.1 mrad.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the forecast, write nothing.")] = False,
    overwrite: Replace = False,
    set: Set = None, json: Json = False, quiet: Quiet = False, verbose: Verbose = False,
) -> int:  # fmt: skip
    """Search for faces that keep closer to the law; write them as a design with given faces."""
    from clacad.cli.optimise_command import (
        OptimiseRequest,
        field_of,
        optimise_design,
        seconds_of,
        weights_of,
        words_of,
    )

    request = OptimiseRequest(
        out, compare, words_of(free), field_of(field), weights_of(weights), tolerances, seconds_of(seconds), dry_run,
        overwrite,
    )  # fmt: skip
    return optimise_design(design, set or [], request, json=json, quiet=quiet)


@app.command()
def export(
    design: Design,
    out: Out,
    formats: Annotated[str, declared("formats")] = ",".join(DEFAULTS.formats),
    slope_error: Annotated[str | None, declared("slope_error")] = None,
    quads: Annotated[list[str] | None, declared("quads")] = None,
    role: Annotated[list[str] | None, declared("role")] = None,
    step: Annotated[str, declared("step")] = DEFAULTS.step,
    fused: Annotated[bool, declared("fused")] = DEFAULTS.fused,
    cells: Cells = None,
    overwrite: Overwrite = DEFAULTS.overwrite,
    force: Annotated[bool, declared("force")] = DEFAULTS.force,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the forecast, write nothing.")] = False,
    step_schema: Annotated[str, declared("step_schema")] = DEFAULTS.step_schema,
    pcurves: Annotated[bool, declared("pcurves")] = DEFAULTS.pcurves,
    saddle_bevel: Annotated[str | None, declared("saddle_bevel")] = None,
    gpu_instancing: Annotated[bool, declared("gpu_instancing")] = DEFAULTS.gpu_instancing,
    grey_levels: Annotated[int, declared("grey_levels")] = DEFAULTS.grey_levels,
    paper: Annotated[str, declared("paper")] = DEFAULTS.paper,
    target: Annotated[str | None, typer.Option("--target", metavar="E", help="Coarsest facets whose light is within this "
                                               "rms direction error of the exact surfaces, e.g. '0.5 mrad'.")] = None,
    normals: Annotated[str, typer.Option("--normals", help="With --target, what the file is read by: facet or vertex.")]
    = "facet",
    set: Set = None, json: Json = False, quiet: Quiet = False, verbose: Verbose = False,
) -> int:  # fmt: skip
    """Write the part: files and manifest.json; prints the fabrication table."""
    from clacad.cli.export_command import ExportWords, export_design

    options = {
        "formats": formats, "slope_error": slope_error, "quads": quads, "role": role, "step": step, "cells": cells,
        "overwrite": overwrite, "force": force, "step_schema": step_schema, "pcurves": pcurves,
        "saddle_bevel": saddle_bevel, "gpu_instancing": gpu_instancing, "grey_levels": grey_levels,
        "paper": paper, "fused": fused,
    }  # fmt: skip
    words = ExportWords(out, options, dry_run, target, normals)
    return export_design(design, set or [], words, json=json, quiet=quiet)


@app.command()
def stack(
    designs: Annotated[list[Path], typer.Argument(metavar="DESIGN...", help="Design files, in the order light meets them; the "
                                                  "same one may be given twice. Sheets are called a, b, c ... Or one "
                                                  "scene file with [[sheet]]s.",
                                                  show_default=False)],
    gap: Annotated[str, typer.Option("--gap", metavar="L,M", help="Clear distance between neighbours, e.g. '100 mm'; one for "
                                     "all, or one for each gap.")] = "",
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="DIR", help="Write stack.step, stack.glb, stack.json and "
                                             "manifest.json here; without it, only measure.")] = None,
    files: Annotated[Path | None, typer.Option("--files", metavar="DIR|FILE", help="Judge what was written of this stack: each "
                                               "sheet as its own master, and light through all.")] = None,
    formats: Annotated[str, typer.Option("--format", metavar="F,G", help="step, glb.")] = "step,glb",
    field: Annotated[str | None, typer.Option("--field", metavar="E", help="Slopes of the light, either way in x and y, e.g. "
                                              "'20 mrad'; default check.field of the first design.")] = None,
    object_distance: Annotated[str | None, typer.Option("--object", metavar="L", help="Distance before the stack of the point "
                                                        "that is imaged; default check.object of the first design, or ten "
                                                        "separations.")] = None,
    zone: Annotated[str | None, typer.Option("--zone", metavar="W,H", help="Part of the first sheet that is lit, about its middle, "
                                             "e.g. '20 mm'; default all of it.")] = None,
    rays: Annotated[int, typer.Option("--rays", min=64, max=100_000_000, help="Rays through the stack on each rung.")] = 65536,
    cells: Cells = None,
    quads: Annotated[int, typer.Option("--quads", min=1, max=1024, help="Facets along a cell side of GLB, and of --mesh.")] = 8,
    step: Annotated[str, declared("step")] = DEFAULTS.step,
    mesh: Annotated[bool, typer.Option("--mesh", help="Trace rung mesh, too.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the forecast, write nothing.")] = False,
    overwrite: Overwrite = DEFAULTS.overwrite,
    force: Annotated[bool, declared("force")] = DEFAULTS.force,
    set: Annotated[list[str] | None, typer.Option("--set", metavar="[ID.]KEY=VALUE", help='Override one value of a sheet, e.g. '
                                                  '--set "b.law.eta=[5, 5]", or of all. Repeatable.')] = None,
    json: Json = False, quiet: Quiet = False, verbose: Verbose = False,
) -> int:  # fmt: skip
    """Sheets behind one another: the share of light through all, how space behaves, one assembly."""
    from clacad.cli.stack_command import StackWords, stack_designs

    words = StackWords(
        out,
        files,
        gap,
        formats,
        field,
        object_distance,
        zone,
        rays,
        cells,
        quads,
        step,
        mesh,
        dry_run,
        overwrite,
        force,
    )
    return stack_designs(designs, set or [], words, json=json, quiet=quiet)


@app.command()
def verify(
    design: Design,
    files: Annotated[Path | None, typer.Option("--files", metavar="DIR|FILE", help="What was written, or a file that "
                                               "came back.")] = None,
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="DIR", help="Write report.html, report.json here.")]
    = None,
    cells: Cells = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Write report.pdf, too (extra: clacad[pdf]).")] = False,
    timings: Annotated[bool, typer.Option("--timings", help="Show seconds of this run in the report; its bytes then "
                                          "change from run to run.")] = False,
    rays: Annotated[int, typer.Option("--rays", min=64, max=100_000_000, help="Rays of the main bundle.")] = 65536,
    target: Annotated[str | None, typer.Option("--target", metavar="E", help="Fewest rays that tell errors of this size, "
                                               "and files must be within it, e.g. '0.5 mrad'.")] = None,
    role: Annotated[list[str] | None, typer.Option("--role", metavar="WORD|FORMAT=WORD,...", help="What files are for: master "
                                                   "(parts are made from it), preview, or scan.")] = None,
    overwrite: Overwrite = False,
    set: Set = None,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:  # fmt: skip
    """Trace what was written, write the report, print the verdict."""
    from clacad.cli.verify_command import VerifyRequest, verify_design

    if out is None and (pdf or timings):
        raise typer.BadParameter("--pdf and --timings say what the report holds: give its folder with -o")
    request = VerifyRequest(files, out, cells, rays, overwrite, pdf, timings, target, joined(role))
    return verify_design(design, set or [], request, json=json, quiet=quiet)


@app.command()
def trace(
    design: Design,
    rays: Annotated[Path, typer.Argument(metavar="RAYS.npz", help="Arrays position (n, 3), direction (n, 3) and "
                                         "optionally wavelength (n,), metres.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="OUT.npz", help="File for the results.")],
    rung: Annotated[str, typer.Option("--rung", help="law, thin, surfaces or mesh.")] = "surfaces",
    effects: Annotated[str, typer.Option("--effects", metavar="A,B", help="Effects to add; default none.")] = "",
    mesh: Annotated[Path | None, typer.Option("--mesh", metavar="FILE", help="Rung mesh: triangles as written.")] = None,
    quads: Annotated[int, typer.Option("--quads", min=1, max=2048, help="Rung mesh without a file: quads per cell side.")] = 16,
    normals: Annotated[str, typer.Option("--normals", help="Rung mesh: facet or vertex.")] = "facet",
    overwrite: Replace = False,
    set: Set = None,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:  # fmt: skip
    """Trace a bundle of rays from a file, for other programs."""
    from clacad.cli.trace_command import TraceRequest, trace_file

    request = TraceRequest(
        rays, out, rung, tuple(e for e in effects.split(",") if e), mesh, quads, normals, overwrite
    )
    return trace_file(design, set or [], request, json=json, quiet=quiet)


@app.command()
def image(
    design: Design,
    source: Annotated[str, typer.Option("--object", metavar="X,Y,Z", help="Point that light comes from, z < 0 before the "
                                        "sheet; with z = -inf, parallel light of the slopes X and Y.")] = "0,0,-inf",
    rungs: Annotated[str, typer.Option("--rung", metavar="A,B", help="law, thin, surfaces.")] = "law,thin,surfaces",
    rays: Annotated[int, typer.Option("--rays", min=64, max=10_000_000, help="Rays sent on every rung.")] = 20_000,
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE", help="Write the through-focus picture here, "
                                             ".png or .svg.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the forecast, write nothing.")] = False,
    overwrite: Replace = False,
    set: Set = None, json: Json = False, quiet: Quiet = False, verbose: Verbose = False,
) -> int:  # fmt: skip
    """Where the sheet images a point: predicted and by rays, spot and share of the light on each rung."""
    from clacad.cli.image_command import ImageRequest, image_design

    request = ImageRequest(source, rungs, rays, out, dry_run, overwrite)
    return image_design(design, set or [], request, json=json, quiet=quiet)


@app.command()
def shape(
    target: Annotated[Path, typer.Argument(metavar="TARGET", help="Picture (PNG, JPEG, ...), or points as CSV with the "
                                           "header x,y or x,y,weight.", show_default=False)],
    distance: Annotated[str, typer.Option("--distance", metavar="Z", help="From array 2 to the screen.", show_default=False)],
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE", help="Design file to write; FILE.cells.csv and "
                                             "FILE.png are written beside it.")] = None,
    design: Annotated[Path | None, typer.Option("--design", metavar="DESIGN", help="Sheet to shape; default a PMMA slab of "
                                                "100 x 100 cells of 0.5 mm.")] = None,
    cells: Cells = None,
    width: Annotated[str | None, typer.Option("--width", metavar="W", help="Of the picture on the screen; default that of "
                                              "the sheet.")] = None,
    source: Annotated[str | None, typer.Option("--source", metavar="E", help="Half angle of the source, e.g. '0.25 deg'.")]
    = None,
    rays: Annotated[int, typer.Option("--rays", min=64, max=10_000_000, help="Rays that judge it.")] = 100_000,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print the forecast, write nothing.")] = False,
    overwrite: Replace = False,
    set: Set = None, json: Json = False, quiet: Quiet = False, verbose: Verbose = False,
) -> int:  # fmt: skip
    """Write a sheet whose cells send parallel light into a picture or pattern on a screen."""
    from clacad.cli.shape_command import ShapeRequest, shape_light

    request = ShapeRequest(target, distance, out, design, cells, width, source, rays, dry_run, overwrite)
    return shape_light(request, set or [], json=json, quiet=quiet)


@app.command()
def accuracy(
    design: Annotated[Path | None, typer.Argument(metavar="DESIGN", help="Design file (TOML or JSON); not needed with "
                                                  "--hard.", show_default=False)] = None,
    rays: Annotated[int, typer.Option("--rays", min=100, max=100_000_000, help="Rays sent up every rung.")] = 100_000,
    target: Annotated[str | None, typer.Option("--target", metavar="E", help="Name the cheapest file within this rms "
                                               "direction error, e.g. '0.5 mrad'.")] = None,
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE", help="Write the plot here, .svg or .png.")]
    = None,
    hard: Annotated[bool, typer.Option("--hard", help="Print the stability table instead: named hard cases, error of "
                                       "textbook formulas and of clacad in ulp.")] = False,
    overwrite: Replace = False,
    set: Set = None,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:  # fmt: skip
    """Error against seconds over the rungs: table, plot, the cheapest file for a target."""
    if hard:
        from clacad.cli.stability_command import show_hard

        return show_hard(json=json, quiet=quiet)
    if design is None:
        raise typer.BadParameter("a DESIGN file is needed, unless --hard is given", param_hint="DESIGN")
    from clacad.cli.accuracy_command import measure_accuracy

    return measure_accuracy(design, set or [], rays, target, out, overwrite=overwrite, json=json, quiet=quiet)


@app.command()
def tolerance(
    design: Design,
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="DIR", help="Write tolerances.json, .csv and .png "
                                             "here; a run that was stopped goes on from here.")] = None,
    samples: Annotated[int | None, typer.Option("--samples", min=0, max=10_000_000, help="Sheets drawn; default the "
                                                "design's tolerances.samples.")] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, max=1_000_000_000, help="Default the design's.")] = None,
    rays: Annotated[int, typer.Option("--rays", min=64, max=1_000_000, help="Rays of each bundle.")] = 256,
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Again = False,
    set: Set = None,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:  # fmt: skip
    """What fabrication errors do to light: ranked contributors, Monte Carlo, yield."""
    from clacad.cli.tolerance_command import Where, run_tolerance

    where = Where(out, workers, scheduler, overwrite)
    return run_tolerance(design, set or [], samples, seed, rays, where, json=json, quiet=quiet)


@app.command()
def sweep(
    design: Design,
    vary: Annotated[list[str], typer.Option("--vary", metavar="KEY=FROM:TO:COUNT", help="Values of one key, or KEY=A,B,C; "
                                            "FROM:TO:COUNT:log for equal ratios. Several: every combination.")],
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="DIR", help="Write sweep.csv and sweep.png here; a "
                                             "run that was stopped goes on from here.")] = None,
    format: Annotated[str, typer.Option("--format", metavar="F,G", help="csv, parquet.")] = "csv",
    rays: Annotated[int, typer.Option("--rays", min=64, max=1_000_000, help="Rays of each bundle.")] = 256,
    incident: Annotated[str | None, typer.Option("--incident", metavar="SX,SY", help="Judge light about these slopes along the "
                                                 "sheet's x and y; default: about the middle of the field of each point.")] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Again = False,
    set: Set = None,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:  # fmt: skip
    """Build, judge and trace a design at every point of a grid of values: table and plots."""
    from clacad.cli.tolerance_command import Where, run_sweep

    where = Where(out, workers, scheduler, overwrite)
    return run_sweep(design, set or [], vary, rays, incident, format, where, json=json, quiet=quiet)


@app.command()
def effects(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file; or a design file.", show_default=False)],
    exact: Annotated[bool, typer.Option("--exact-bounds", help="Measure every bound by a trace with and without the "
                                        "effect.")] = False,
    force: Annotated[str, typer.Option("--force", metavar="A,B", help="Effects to switch on anyway.")] = "",
    without: Annotated[str, typer.Option("--without", metavar="A,B", help="Effects to leave out anyway.")] = "",
    set: Set = None,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:  # fmt: skip
    """Which physical effects the scene calls for, why, and what is left out."""
    from clacad.cli.effects_command import show_effects

    forced, left = ([name for name in names.split(",") if name] for names in (force, without))
    return show_effects(scene, set or [], exact=exact, force=forced, without=left, json=json, quiet=quiet)


@app.command()
def explain(
    code: Annotated[str | None, typer.Argument(metavar="CODE", help="A code (CL337), a check (wall) or a word (eta); "
                                               "default: list all.", show_default=False)] = None,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:  # fmt: skip
    """What a code, a check or a word means, why it matters, what to do."""
    from clacad.cli.explain_command import show_explanation

    return show_explanation(code, json=json, quiet=quiet)


@app.command()
def doctor(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder whose disk is tried.")] = Path("."),
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:
    """What this installation can do: packages, kernel, memory, disk, caches."""
    from clacad.cli.doctor_command import show_findings

    return show_findings(folder, json=json, quiet=quiet)


@app.command()
def render(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file; with --preset eye the design file.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE", help="Picture (.png .webp .tiff) or movie (.webp "
                                      ".apng .gif .mp4).")],
    photo: Annotated[Path | None, typer.Argument(metavar="PHOTO", help="With --preset eye: the picture behind the "
                                                 "sheet.", show_default=False)] = None,
    preset: Annotated[str | None, typer.Option("--preset", help="eye: a photograph behind a design's sheet, seen by an "
                                               "eye; also writes the view without the sheet.")] = None,
    eye: Annotated[str | None, typer.Option("--eye", metavar="L", help="Preset eye: distance of the eye before the "
                                            "sheet, e.g. '400 mm'; default four widths.")] = None,
    distance: Annotated[str | None, typer.Option("--distance", metavar="L", help="Preset eye: distance of the picture "
                                                 "behind the sheet; default two widths.")] = None,
    pixels: Annotated[int | None, typer.Option("--pixels", min=1, max=32768, help="Pixels across.")] = None,
    samples: Annotated[int | None, typer.Option("--samples", min=1, max=65536, help="Rays a pixel.")] = None,
    noise: Annotated[float | None, typer.Option("--noise", help="Sample until a pixel's standard error is below this.")]
    = None,
    rung: Annotated[str | None, typer.Option("--rung", help="auto, law, thin, surfaces or mesh.")] = None,
    target: Annotated[str | None, typer.Option("--target", metavar="E", help="Cheapest rung (of rung mesh: coarsest "
                                               "facets) within this rms direction error, e.g. '0.5 mrad'.")] = None,
    frame: Annotated[int | None, typer.Option("--frame", min=0, help="One frame of an animation, as a still.")] = None,
    overwrite: Replace = False,
    set: Set = None,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:  # fmt: skip
    """View through the sheet: picture or movie."""
    from clacad.cli.render_command import RenderRequest, render_eye, render_scene

    request = RenderRequest(out, pixels, samples, noise, rung, frame, overwrite, target)
    if preset is None:
        if photo is not None or eye is not None or distance is not None:
            raise typer.BadParameter("PHOTO, --eye and --distance belong to --preset eye")
        return render_scene(scene, set or [], request, json=json, quiet=quiet)
    if preset != "eye":
        raise typer.BadParameter(f"there is no preset {preset!r}; there is: eye", param_hint="--preset")
    if photo is None:
        raise typer.BadParameter("--preset eye needs a DESIGN and a PHOTO", param_hint="PHOTO")
    return render_eye(scene, photo, set or [], request, eye, distance, json=json, quiet=quiet)


@app.command()
def explore(
    design: Design,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE", help="The page: one .html file.")],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print what the page would be and cost; write nothing.")]
    = False,
    overwrite: Replace = False,
    set: Set = None,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:  # fmt: skip
    """One page with sliders: the view through the sheet, live, its verdict, and the design file they make."""
    from clacad.cli.explore_command import explore_design

    return explore_design(
        design, set or [], out, dry_run=dry_run, overwrite=overwrite, json=json, quiet=quiet
    )


@app.command()
def wave(
    design: Design,
    out: Annotated[Path | None, typer.Option("-o", "--out", metavar="FILE", help="Write the picture here, .png or .svg.")]
    = None,
    field: Annotated[str | None, typer.Option("--field", metavar="A[,B]", help="Angles of the light off the middle of the "
                                              "field along x and y, e.g. '0.5 deg,0'; default the middle.")] = None,
    wavelength: Annotated[str | None, typer.Option("--wavelength", metavar="L", help="Default the design's, e.g. "
                                                   "'633 nm'.")] = None,
    field_lens: Annotated[bool, typer.Option("--field-lens", help="As if a lens at the common focus imaged lens 1 onto lens "
                                             "2: ideal lenses only.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Print grid and cost; write nothing.")] = False,
    overwrite: Replace = False,
    set: Set = None, json: Json = False, quiet: Quiet = False, verbose: Verbose = False,
) -> int:  # fmt: skip
    """Light as a wave through one telescopelet: far field, Strehl ratio, share to the partner, beside its rays."""
    from clacad.cli.wave_command import WaveRequest, wave_design

    request = WaveRequest(out, field, wavelength, field_lens, dry_run, overwrite)
    return wave_design(design, set or [], request, json=json, quiet=quiet)


@app.command()
def atlas(
    out: Out,
    scenes: Annotated[Path | None, typer.Option("--scenes", metavar="DIR", help="Folder of the scene files; default those "
                                                "that come with clacad.")] = None,
    rows: Annotated[str | None, typer.Option("--rows", metavar="F1,F2", help="Only these; default all.")] = None,
    size: Annotated[int, typer.Option("--size", min=16, max=8192, help="Pixels across a figure.")] = 440,
    samples: Annotated[int, typer.Option("--samples", min=1, max=4096, help="Rays a pixel.")] = 16,
    movie_size: Annotated[int, typer.Option("--movie-size", min=16, max=4096, help="Pixels across a movie.")] = 220,
    movies: Annotated[bool, typer.Option("--movies/--no-movies", help="Make the movies.")] = True,
    measure: Annotated[bool, typer.Option("--measure/--no-measure", help="Measure the rows in rendered pictures.")]
    = True,
    overwrite: Overwrite = False,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:  # fmt: skip
    """Every figure and movie of the paper, each with its numbers measured in the picture."""
    from clacad.cli.atlas_command import make_atlas
    from clacad.design.shipped_folder import shipped_designs
    from clacad.rendering.atlas.make_atlas import AtlasRequest

    folder = shipped_designs() / "scenes" if scenes is None else scenes
    chosen = tuple(row.strip().upper() for row in (rows or "").split(",") if row.strip())
    if rows is not None and not chosen:
        raise typer.BadParameter(
            "names no row: give one, such as F3, or leave it out for all", param_hint="--rows"
        )
    request = AtlasRequest(folder, out, size, samples, movies, movie_size, chosen, measure, overwrite)
    return make_atlas(request, json=json, quiet=quiet)
