"""`clacad image`: where a sheet images a point, by its law and by rays."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.machine_rates import processor_seconds
from clacad.base.text import mrad_text, percent_text
from clacad.cli.command import Command, OfDesign, dry_run_option, option, overwrite_option
from clacad.cli.console import Brief, Console, facts, table
from clacad.cli.option_values import BadOption, load_counted, picture_kind, read_length, words_of

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.imaging import Image
    from clacad.imaging.image_by_rays import BestPoint, Middle

TASK = "image"

PICTURE_SECONDS = 1.2
"""Processor seconds of drawing the light through focus, including the import of the drawing library."""


@dataclass(frozen=True, kw_only=True)
class ImagePoint(OfDesign):
    """Where the sheet images a point: predicted and by rays, spot and share of the light on each rung."""

    source: str = option(
        "--object X,Y,Z",
        "Point that light comes from, z < 0 before the sheet; with z = -inf, parallel light of the slopes"
        " X and Y.",
        "0,0,-inf",
    )
    rungs: Any = option("--rung A,B", "law, thin, surfaces.", ("law", "thin", "surfaces"), read=words_of)
    rays: int = option("--rays N", "Rays sent on every rung.", 20_000, least=64, most=10_000_000)
    out: Path | None = option("-o, --out FILE", "Write the through-focus picture here, .png or .svg.")
    dry_run: bool = dry_run_option()
    overwrite: bool = overwrite_option()


def run(request: ImagePoint, console: Console) -> int:
    """Print where the point is imaged (or JSON), write the through-focus picture."""
    kind = picture_kind(request.out)
    design = load_counted(request.design, request.set)
    source = parse_place(request.source, design.unit)
    from clacad.imaging import image
    from clacad.imaging.image_by_rays import image_seconds
    from clacad.prescription.prescribe import prescribe
    from clacad.storage.atomic import require_writable, write_content

    began = processor_seconds()
    window = prescribe(design)
    building = processor_seconds() - began
    known = [word for word in request.rungs if word in ("law", "thin", "surfaces")]
    seconds = image_seconds(window, known, request.rays)
    if request.dry_run:
        return _show_forecast(request, seconds, building, console)
    if request.out is not None:
        require_writable(request.out, overwrite=request.overwrite)
    try:
        with console.forecast(TASK, seconds):
            found = image(window, source, request.rungs, request.rays)
    except ValueError as error:
        raise BadOption(str(error)) from error
    if request.out is not None:
        from clacad.imaging.image_by_rays import plot_png, plot_svg

        plot = plot_svg if kind == "svg" else plot_png
        write_content(request.out, plot(found, design.name, design.unit), overwrite=request.overwrite)
    console.show(
        lambda: found.to_dict() | {"unit": design.unit},
        lambda: image_text(found, design.unit),
        lambda: _brief(found, design),
    )
    if request.out is not None:
        console.say(f"wrote {request.out}")
    return 0


def parse_place(text: str, unit: str) -> tuple[float, float, float]:
    """Read "x,y,z", lengths bare or with a unit, as a point in design units; z may be -inf.

    Raises BadOption.
    """
    from clacad.config.value_kinds import LENGTH

    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 3:
        raise BadOption(
            f'--object {text}: it is a point x,y,z such as "0,0,-300", or slopes and -inf for parallel light'
        )
    x, y, z = (
        -inf
        if axis == "z" and part == "-inf"
        else read_length(f"--object {text}: {axis} = {part}", part, unit, LENGTH)
        for axis, part in zip("xyz", parts, strict=True)
    )
    return x, y, z


def _show_forecast(request: ImagePoint, seconds: float, building: float, console: Console) -> int:
    """Print the cost of images, including that of building the sheet, which the forecast needs."""
    seconds += building + (PICTURE_SECONDS if request.out is not None else 0.0)
    files = "one picture of about 100 kB" if request.out is not None else "no file"
    console.show(
        lambda: {"forecast": {"rays": request.rays, "seconds": seconds, "building": building}},
        lambda: (
            f"{request.rays:,} rays on each rung, about {seconds:.2g} s of processor time, {building:.2g} "
            f"s of it to build the sheet, {files}; nothing is written"
        ),
    )
    return 0


def image_text(found: Image, unit: str) -> str:
    """Table of the image, rung by rung."""
    lines = [["rung", "predicted x, y, z", "found x, y, z", "apart", "spot rms x, y", "share", unit]]
    for one in found.rungs:
        lines.append(
            [
                one.rung,
                _point(one.predicted),
                _point(one.found),
                "" if one.predicted.missing or one.found.missing else f"{one.off:.3g}",
                "" if one.found.missing else ", ".join(f"{v:.4g}" for v in one.found.spot),
                percent_text(one.share),
                "",
            ]
        )
    return "\n".join([table(lines), *_notes(found, unit)])


def _brief(found: Image, design: Design) -> Brief:
    """Place and share on the last rung; place, spot and share on each; notes."""
    rows = [["rung", "predicted x, y, z", "found x, y, z", "spot rms x, y", "share"]]
    for one in found.rungs:
        spot = "" if one.found.missing else ", ".join(f"{v:.3g}" for v in one.found.spot)
        rows.append([one.rung, _point(one.predicted), _point(one.found), spot, percent_text(one.share)])
    unit, last = design.unit, found.rungs[-1]
    head = f"{design.name}: image at {_point(last.found)} {unit}, share {percent_text(last.share)}"
    return Brief(head, (facts(rows), [("note", f"  {text}") for text in _notes(found, unit)]))


NO_WIDTH = 1e-9
"""Part of the image's distance below which pairs image sharply."""


def _notes(found: Image, unit: str) -> list[str]:
    """Notes below the table."""
    notes = [
        "share: of the light on the sheet, what goes through lenses of one telescopelet; rung law: a "
        "sheet of no thickness at z = 0"
    ]
    if any(best.missing == "parallel" for one in found.rungs for best in (one.predicted, one.found)):
        notes.append("parallel: this light leaves the sheet parallel, and meets in no point")
    if found.instead is not None:
        notes.append(_instead(found, found.instead, unit))
    if found.width is None:
        notes.append(
            "a table of cells: predicted is the point nearest to the light through the middles of its lenses"
        )
    elif max(found.width) <= NO_WIDTH * max(1.0, *(abs(float(v)) for v in found.rungs[-1].predicted.point)):
        notes.append("every pair images this plane sharply: ideal lenses leave a point")
    else:
        width = ", ".join(f"{w:.4g}" for w in found.width)
        notes.append(f"cells do not focus: the image of a point is {width} {unit} wide at least (x, y)")
    if found.sampling is not None:
        spot = ", ".join(f"{v:.3g}" for v in found.sampling.smooth.spot)
        notes.append(
            f"sampling: the law of the cell hit turns light {mrad_text(found.sampling.slope, 3)} rms from "
            f"the smooth law, whose spot at {_place(found.sampling.smooth.point)} would be {spot} {unit}"
        )
    if found.zone is not None:
        zone, number, moire = (
            ", ".join(f"{v:.4g}" for v in pair)
            for pair in (found.zone.width, found.zone.f_number, found.zone.moire)
        )
        notes.append(
            "array 2 has a pitch of its own or is turned: light along the normal stays with its partner "
            f"over {zone} {unit} (x, y), one lens of F-number {number} of a lattice of them, and no field "
            f"of a cell survives beyond the moire period {moire} {unit}; one large lens: [law.varying] "
            "f_image"
        )
    return notes


def _instead(found: Image, instead: Middle, unit: str) -> str:
    """Fates of the light, and the light that gets through."""
    one = next(one for one in found.rungs if one.rung == instead.rung)
    went = ", ".join(f"{percent_text(part)} {name}" for name, part in sorted(one.fates.items()))
    if one.astray is not None:
        went += f", most of the ghosts {one.astray} cells from the partner"
    x, y, z = (instead.source + 0.0).tolist()
    place = ",".join("-inf" if v == -inf else f"{v:.4g}" for v in (x, y, z))
    what = (
        f"parallel light of slopes {x:.4g}, {y:.4g}"
        if z == -inf
        else f"light from {_place(instead.source)} {unit}"
    )
    return (
        f"rung {one.rung}: {went}; {what}, through the middles of both lenses, has a share of "
        f"{percent_text(instead.share)}: "
        f'--object="{place}"'
    )


def _point(best: BestPoint) -> str:
    return best.missing or _place(best.point)


def _place(point: Any) -> str:
    return ", ".join(f"{v + 0.0:.6g}" for v in point.round(9))


COMMANDS = (Command("image", "look", ImagePoint, run),)
