"""`clacad shape`: a design whose table sends parallel light into a picture or pattern."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.text import percent_text
from clacad.cli.command import (
    Command,
    Overridden,
    declared,
    dry_run_option,
    option,
    overwrite_option,
    required,
)
from clacad.cli.console import Brief, Console
from clacad.cli.option_values import (
    BadOption,
    command_line,
    parse_angle,
    parse_cells,
    parse_design_file,
    parse_distance,
)

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.imaging.shape import Rendered, Shaped
    from clacad.imaging.target import Target

TASK = "shape"


def _source(option: str, text: str) -> float:
    """Read a half angle of light as radians."""
    angle = parse_angle(option, text)
    if not angle < 1.5:
        raise BadOption(f"{option} {text}: {angle:.6g} rad is no half angle of light; allowed: 0 to 1.5 rad")
    return angle


@dataclass(frozen=True, kw_only=True)
class ShapeBeam(Overridden):
    """Write a sheet whose cells send parallel light into a picture or pattern on a screen."""

    target: Path = required(
        "TARGET", "Picture (PNG, JPEG, ...), or points as CSV with the header x,y or x,y,weight."
    )
    distance: str = required("--distance Z", "From array 2 to the screen.")
    out: Path | None = option(
        "-o, --out FILE",
        "Design file to write; FILE.cells.csv and FILE.png are written next to it.",
        read=parse_design_file,
    )
    base: Path | None = option(
        "--design DESIGN", "Sheet to shape; default a PMMA slab of 100 x 100 cells of 0.5 mm."
    )
    cells: tuple[int, int] | None = declared("cells", read=parse_cells)
    width: str | None = option("--width W", "Of the picture on the screen; default that of the sheet.")
    source: float = option(
        "--source E", "Half angle of the source, e.g. '0.25 deg'; default 0.", 0.0, read=_source
    )
    rays: int = option("--rays N", "Rays that judge it.", 100_000, least=64, most=10_000_000)
    dry_run: bool = dry_run_option()
    overwrite: bool = overwrite_option()


def run(request: ShapeBeam, console: Console) -> int:
    """Write the design, its table and the picture of its light; print the result of the rays."""
    design = _base(request)
    distance = parse_distance("--distance", request.distance, design.unit)
    from clacad.design.asked_cells import lattice_of
    from clacad.exporting.limits import refuse_uncountable
    from clacad.imaging.shape import shaped
    from clacad.imaging.target import NoTarget
    from clacad.storage.atomic import require_writable

    lattice = lattice_of(design)
    refuse_uncountable(design)
    x0, x1, _, _ = lattice.extent()
    width = x1 - x0 if request.width is None else parse_distance("--width", request.width, design.unit)
    target = _target(request.target, width)
    seconds = 2.0 + 2e-5 * request.rays + 1e-3 * lattice.cell_count
    if request.dry_run:
        return _show_forecast(design, lattice.cell_count, (distance, request.source, seconds), console)
    if request.out is None:
        raise BadOption("the design needs a file: give it with -o design.toml")
    paths = _written(request, request.out)
    for path in paths:
        require_writable(path, overwrite=request.overwrite)
    with console.forecast(TASK, seconds):
        try:
            found = shaped(design, lattice, target, distance, request.source)
        except NoTarget as error:
            raise BadOption(
                f"{request.target}: {error}; more cells (lattice.count), or fewer points"
            ) from error
        seen = _published(design, found, paths, distance, request)
    out, cells, picture = paths
    written = f"wrote {out}, {cells} and {picture}"
    head, *lines = _lines(design, found, seen, distance)
    following = command_line("clacad image", out)
    console.show(
        lambda: _document(design, found, seen) | {"files": [str(path) for path in paths]},
        lambda: "\n".join([head, *lines, written, f"next: {following}"]),
        lambda: Brief(head, ([*(("", line) for line in lines), ("files", written)],), (following,)),
    )
    return 0


def _base(request: ShapeBeam) -> Design:
    """The design to shape: as given, or the slab of the templates, its law and cells as --set has them."""
    from clacad.design import Design, load, template
    from clacad.design.sections import LATTICE

    cells, overrides = request.cells, request.set
    if request.base is not None:
        design = load(request.base, overrides)
    else:
        import tomllib

        name = "shaped" if request.out is None else _name(request.out.stem)
        design = Design.from_dict(
            tomllib.loads(template(name, "slab")), ["lattice.count=[100, 100]", *overrides]
        )
    changes: dict[str, Any] = {} if cells is None else {LATTICE.count: list(cells)}
    if design.law_spec.varying is not None:
        raise BadOption(
            f"{request.base or '--set'}: its law varies already; leave law.varying out, this command "
            "writes it"
        )
    if request.base is not None:
        load(request.base, (*overrides, PROBE))
    else:
        Design.from_dict(design.given, [PROBE])
    _refuse_oblique(design)
    return design.replace(changes) if changes else design


def _refuse_oblique(design: Design) -> None:
    """Refuse lenses that are tilted and cells that are aimed: δ is found for light along upright lenses.

    Raises DesignError: CL125
    """
    from clacad.design import DesignError
    from clacad.design.sections import LATTICE, LAW, AimedAt

    light = "this command finds delta for light along the normal"
    if design.law.theta != 0.0:
        message = f"law.euler tilts the lenses, and {light} through upright ones"
        raise DesignError.at(design, LAW.euler, message, code="CL125", hint="theta = 0")
    if isinstance(design.lattice.aperture, AimedAt):
        message = f"lattice.aperture aims the cells at a point, and {light}"
        raise DesignError.at(design, LATTICE.aperture, message, code="CL125", hint='aperture = "centred"')


PROBE = "law.varying={f_image=1e9}"
"""Varying law with a plane, as a shaped sheet has: it is refused where features cannot be combined."""


def _written(request: ShapeBeam, out: Path) -> tuple[Path, Path, Path]:
    """Paths of the design, its table and the picture; none of them is a file that is read."""
    paths = (out, out.with_suffix(".cells.csv"), out.with_suffix(".png"))
    given = {path.resolve() for path in (request.target, request.base) if path is not None}
    for path in paths:
        if path.resolve() in given:
            raise BadOption(f"-o {out}: {path} would be written, and is read; take another name")
    return paths


def _name(stem: str) -> str:
    """A name that a design can have."""
    plain = "".join(c if c.isalnum() or c in " -_.,+()=" else "-" for c in stem)[:80]
    return plain if plain[:1].isalnum() else f"shaped{plain}"[:80]


def _target(path: Path, width: float) -> Target:
    """The picture or the points."""
    from clacad.imaging.target import NoTarget, of_picture, of_points

    if path.suffix.lower() == ".csv":
        from clacad.base.untrusted_files import require_regular

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
    design: Design, found: Shaped, paths: tuple[Path, Path, Path], distance: float, request: ShapeBeam
) -> Rendered:
    """Write design, table and picture; nothing where the sheet cannot be built."""
    from hashlib import sha256

    from clacad.config.edit_text import to_toml
    from clacad.config.mistakes import DesignError
    from clacad.design import load
    from clacad.imaging.shape import plot_png, rendered, table_text
    from clacad.prescription.prescribe import prescribe
    from clacad.storage.atomic import scratch_folder, write_set

    out, table, picture = paths
    data = {key: value for key, value in design.given.items()}
    cells = table_text(found).encode("ascii")
    named = {"file": table.name, "sha256": sha256(cells).hexdigest()}
    data["law"] = {k: v for k, v in data["law"].items() if k != "delta"} | {"varying": {"table": named}}
    goal = f"{_name(request.target.name)}, {distance:g} {design.unit} behind array 2"
    head = f"# Parallel light along the normal goes into {goal}.\n"
    text = head + to_toml(data)
    with scratch_folder() as folder:  # a sheet that cannot be built leaves no file
        (folder / table.name).write_bytes(cells)
        (folder / "design.toml").write_text(text, encoding="utf-8", newline="\n")
        made = load(folder / "design.toml")
        try:
            window = prescribe(made)
        except DesignError as error:
            message = error.mistakes[0]
            raise BadOption(
                f"{message.message}; {message.hint}. A larger --distance than {distance:g} {design.unit}, "
                "or a smaller --width, bends the light less"
            ) from error
        seen = rendered(window, found, distance, request.rays)
    drawing = plot_png(seen, design.name, design.unit)
    write_set(
        out.parent, {table.name: cells, picture.name: drawing, out.name: text}, overwrite=request.overwrite
    )
    return seen


def _show_forecast(design: Design, cells: int, numbers: tuple[float, float, float], console: Console) -> int:
    from clacad.imaging.shape import blur_of

    distance, source, seconds = numbers
    blur = blur_of(design, distance, source)
    console.show(
        lambda: {"forecast": {"cells": cells, "blur": list(blur.all), "seconds": seconds}},
        lambda: (
            f"{cells:,} cells, each a spot {_pair(blur.all)} {design.unit} wide; about {seconds:.2g} s of "
            f"processor time, about {40 * cells / 1000:.3g} kB in three files; nothing is written"
        ),
    )
    return 0


def _document(design: Design, found: Shaped, seen: Rendered) -> dict[str, Any]:
    blur = found.blur
    return {
        "cells": len(found.cells),
        "unit": design.unit,
        "rms_way": found.way,
        "blur": {"all": blur.all, "cell": blur.cell, "source": blur.source, "diffraction": blur.diffraction},
        "through": seen.through,
        "within_one_blur": seen.within,
        "elsewhere": seen.difference,
        "elsewhere_by_lenses": seen.by_lenses,
    }


def _lines(design: Design, found: Shaped, seen: Rendered, distance: float) -> list[str]:
    blur, unit = found.blur, design.unit
    return [
        f"{len(found.cells):,} cells send parallel light to a screen {distance:g} {unit} behind array"
        f" 2, {found.way:.4g} {unit} aside (rms)",
        f"  blur              {_pair(blur.all)} {unit}: cell {_pair(blur.cell)}, source "
        f"{_pair(blur.source)}, diffraction {_pair(blur.diffraction)}",
        f"  through           {percent_text(seen.through, 4)} of the light, through lenses of one"
        " telescopelet",
        f"  within one blur   {percent_text(seen.within, 4)} of all light",
        f"  elsewhere         {percent_text(seen.difference)} of what arrives, against the target as"
        f" wide as a cell: light comes in {len(found.cells):,} spots; by the lenses"
        f" {percent_text(seen.by_lenses)}",
    ]


def _pair(two: tuple[float, float]) -> str:
    x, y = two
    return f"{x:.3g}" if x == y else f"{x:.3g} x {y:.3g}"


COMMANDS = (Command("shape", "make", ShapeBeam, run),)
