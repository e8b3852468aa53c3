"""`clacad shape`: a design whose table sends parallel light into a picture or pattern."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.cli.announce_cost import forecast
from clacad.cli.console import say, show_json, show_text
from clacad.cli.option_values import BadOption, design_file, parse_angle, parse_cells, parse_distance

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.imaging.shape import Rendered, Shaped
    from clacad.imaging.target import Target

TASK = "shape"


@dataclass(frozen=True)
class ShapeRequest:
    """What the command line asked; distances as written, lengths of the design."""

    target: Path
    distance: str
    out: Path | None
    base: Path | None
    cells: str | None
    width: str | None
    source: str | None
    rays: int
    dry_run: bool
    overwrite: bool


def shape_light(request: ShapeRequest, overrides: list[str], *, json: bool, quiet: bool) -> int:
    """Write the design, its table and the picture of what it does; print the forecast and what rays found."""
    design_file(request.out)
    design = _base(request, overrides)
    distance = parse_distance("--distance", request.distance, design.unit)
    source = 0.0 if request.source is None else parse_angle("--source", request.source)
    if not 0.0 <= source < 1.5:
        raise BadOption(
            f"--source {request.source}: {source:.6g} rad is no half angle of light; allowed: 0 to 1.5 rad"
        )
    from clacad.design.asked_cells import lattice_of
    from clacad.imaging.shape import shaped
    from clacad.imaging.target import NoTarget

    lattice = lattice_of(design)
    _refuse_many(design)
    x0, x1, _, _ = lattice.extent()
    width = x1 - x0 if request.width is None else parse_distance("--width", request.width, design.unit)
    target = _target(request.target, width)
    seconds = 2.0 + 2e-5 * request.rays + 1e-3 * lattice.cell_count
    if request.dry_run:
        return _show_forecast(design, lattice.cell_count, (distance, source, seconds), json=json, quiet=quiet)
    if request.out is None:
        raise BadOption("the design needs a file: give it with -o design.toml")
    table, picture = _beside(request, request.out)
    from clacad.storage.atomic import require_writable

    for path in (request.out, table, picture):
        require_writable(path, overwrite=request.overwrite)
    with forecast(TASK, seconds, quiet=quiet):
        try:
            found = shaped(design, lattice, target, distance, source)
        except NoTarget as error:
            raise BadOption(
                f"{request.target}: {error}; more cells (lattice.count), or fewer points"
            ) from error
        seen = _published(design, found, (request.out, table, picture), distance, request)
    if json:
        show_json(_document(design, found, seen) | {"files": [str(p) for p in (request.out, table, picture)]})
    else:
        show_text(_text(design, found, seen, distance), quiet=quiet)
    say(f"wrote {request.out}, {table} and {picture}\nnext: clacad image {request.out}", quiet=quiet)
    return 0


def _base(request: ShapeRequest, overrides: list[str]) -> Design:
    """The design that is shaped: as given, or the slab of the templates, its law and cells as --set has them."""
    from clacad.design import Design, load, template
    from clacad.design.keys import LATTICE

    cells = parse_cells(request.cells)
    if request.base is not None:
        design = load(request.base, tuple(overrides))
    else:
        import tomllib

        name = "shaped" if request.out is None else _name(request.out.stem)
        design = Design.from_dict(
            tomllib.loads(template(name, "slab")), ["lattice.count=[100, 100]", *overrides]
        )
    changes: dict[str, Any] = {} if cells is None else {LATTICE.count: list(cells)}
    if design.law_spec.varying is not None:
        raise BadOption(
            f"{request.base or '--set'}: its law varies already; leave law.varying out, this command writes it"
        )
    if request.base is not None:
        load(request.base, (*overrides, PROBE))
    else:
        Design.from_dict(design.given, [PROBE])
    return design.replace(changes) if changes else design


PROBE = "law.varying={f_image=1e9}"
"""A law that varies and has a plane as a shaped sheet has, to ask of what cannot stand beside it, by the name of its own file."""


def _beside(request: ShapeRequest, out: Path) -> tuple[Path, Path]:
    """Where the table and the picture go; none of the files is one that is read."""
    if out.suffix.lower() != ".toml":
        raise BadOption(f"-o {out}: a design file is written, whose name ends in .toml")
    table, picture = out.with_suffix(".cells.csv"), out.with_suffix(".png")
    given = {path.resolve() for path in (request.target, request.base) if path is not None}
    for path in (out, table, picture):
        if path.resolve() in given:
            raise BadOption(f"-o {out}: {path} would be written, and is read; take another name")
    return table, picture


def _name(stem: str) -> str:
    """A name that a design can have."""
    plain = "".join(c if c.isalnum() or c in " -_.,+()=" else "-" for c in stem)[:80]
    return plain if plain[:1].isalnum() else f"shaped{plain}"[:80]


def _refuse_many(design: Design) -> None:
    from clacad.exporting.limits import refuse_uncountable

    refuse_uncountable(design)


def _target(path: Path, width: float) -> Target:
    """The picture or the points."""
    from clacad.imaging.target import NoTarget, of_picture, of_points

    if path.suffix.lower() == ".csv":
        from clacad.base.regular_file import require_regular

        try:
            require_regular(path)
            return of_points(path)
        except OSError as error:
            raise BadOption(f"{path}: {(error.strerror or 'cannot be read').lower()}") from None
    from clacad.rendering.photographs import read_picture

    try:
        return of_picture(read_picture(path), width)
    except NoTarget as error:
        raise BadOption(f"{path}: {error}") from None
    except OSError as error:
        raise BadOption(f"{path}: {(error.strerror or 'cannot be read').lower()}") from None


def _published(
    design: Design, found: Shaped, paths: tuple[Path, Path, Path], distance: float, request: ShapeRequest
) -> Rendered:
    """Write design, table and picture; nothing where the sheet cannot be built."""
    from clacad.config.design_error import DesignError
    from clacad.config.edit_text import to_toml
    from clacad.design import load
    from clacad.imaging.shape import rendered, table_text
    from clacad.imaging.shape_picture import plot_png
    from clacad.prescription.prescribe import prescribe
    from clacad.storage.atomic import scratch_folder, write_set

    out, table, picture = paths
    data = {key: value for key, value in design.given.items()}
    cells = table_text(found).encode("ascii")
    named = {"file": table.name, "sha256": sha256(cells).hexdigest()}
    data["law"] = {k: v for k, v in data["law"].items() if k != "delta"} | {"varying": {"table": named}}
    head = f"# Parallel light along the normal goes into {_name(request.target.name)}, {distance:g} {design.unit} behind array 2.\n"
    text = head + to_toml(data)
    with scratch_folder() as folder:  # a sheet that cannot be built leaves no file
        (folder / table.name).write_bytes(cells)
        (folder / "design.toml").write_text(text, encoding="utf-8", newline="\n")
        made = load(folder / "design.toml")
        try:
            window = prescribe(made)
        except DesignError as error:
            message = error.mistakes[0]
            raise BadOption(f"{message.message}; {message.hint}. A larger --distance than {distance:g} {design.unit}, or a smaller "
                            "--width, bends the light less") from error  # fmt: skip
        seen = rendered(window, found, distance, request.rays)
    drawing = plot_png(seen, design.name, design.unit)
    write_set(
        out.parent, {table.name: cells, picture.name: drawing, out.name: text}, overwrite=request.overwrite
    )
    return seen


def _show_forecast(
    design: Design, cells: int, numbers: tuple[float, float, float], *, json: bool, quiet: bool
) -> int:
    from clacad.imaging.shape import blur_of

    distance, source, seconds = numbers
    blur = blur_of(design, distance, source)
    if json:
        show_json({"forecast": {"cells": cells, "blur": list(blur.all), "seconds": seconds}})
    else:
        show_text(f"{cells:,} cells, each a spot {_pair(blur.all)} {design.unit} wide; about {seconds:.2g} s of processor time, "
                  f"about {40 * cells / 1000:.3g} kB in three files; nothing is written", quiet=quiet)  # fmt: skip
    return 0


def _document(design: Design, found: Shaped, seen: Rendered) -> dict[str, Any]:
    blur = found.blur
    return {
        "cells": len(found.cells), "unit": design.unit, "rms_way": found.way,
        "blur": {"all": blur.all, "cell": blur.cell, "source": blur.source, "diffraction": blur.diffraction},
        "through": seen.through, "within_one_blur": seen.within, "elsewhere": seen.difference,
        "elsewhere_by_lenses": seen.by_lenses,
    }  # fmt: skip


def _text(design: Design, found: Shaped, seen: Rendered, distance: float) -> str:
    blur, unit = found.blur, design.unit
    return "\n".join([
        f"{len(found.cells):,} cells send parallel light to a screen {distance:g} {unit} behind array 2, {found.way:.4g} {unit} aside (rms)",
        f"  blur              {_pair(blur.all)} {unit}: cell {_pair(blur.cell)}, source {_pair(blur.source)}, diffraction {_pair(blur.diffraction)}",
        f"  through           {100 * seen.through:.4g} % of the light, through lenses of one telescopelet",
        f"  within one blur   {100 * seen.within:.4g} % of all light",
        f"  elsewhere         {100 * seen.difference:.3g} % of what arrives, against the target as wide as a cell: light comes in "
        f"{len(found.cells):,} spots; by the lenses {100 * seen.by_lenses:.3g} %",
    ])  # fmt: skip


def _pair(two: tuple[float, float]) -> str:
    x, y = two
    return f"{x:.3g}" if x == y else f"{x:.3g} x {y:.3g}"
