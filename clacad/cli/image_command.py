"""`clacad image`: where a sheet images a point, as its law says and as rays go."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.machine_rates import processor_seconds
from clacad.cli.announce_cost import forecast
from clacad.cli.console import say, show_json, show_text, table
from clacad.cli.design_commands import load_counted
from clacad.cli.option_values import BadOption, picture_kind

if TYPE_CHECKING:
    from clacad.imaging import Image
    from clacad.imaging.best_point import BestPoint
    from clacad.imaging.image_by_rays import Middle

TASK = "image"

PICTURE_SECONDS = 1.2
"""Processor seconds of drawing the light through focus, with loading what draws."""


@dataclass(frozen=True)
class ImageRequest:
    """What the command line asked: the object, rungs, rays, where to draw, whether only to forecast."""

    source: str
    rungs: str
    rays: int
    out: Path | None
    dry_run: bool
    overwrite: bool


def parse_place(text: str, unit: str) -> tuple[float, float, float]:
    """Read "x,y,z", lengths bare or with a unit, as a point in design units; z may be -inf.

    Raises
    ------
    BadOption
    """
    from clacad.base.units import design_unit
    from clacad.config.quantities import Quantity
    from clacad.config.value_kinds import Refusal

    own = design_unit(unit)
    assert own is not None  # the design was read with it
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 3:
        raise BadOption(
            f'--object {text}: it is a point x,y,z such as "0,0,-300", or slopes and -inf for parallel light'
        )
    kind = Quantity("length", "a length")
    made = []
    for k, part in enumerate(parts):
        if k == 2 and part == "-inf":
            made.append(float("-inf"))
            continue
        try:
            made.append(kind.read(float(part) if _is_number(part) else part, own))
        except Refusal as refusal:
            raise BadOption(
                f"--object {text}: {'xyz'[k]} = {part} {refusal.complaint}; {refusal.allowed}"
            ) from None
    return made[0], made[1], made[2]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def image_design(path: Path, overrides: list[str], request: ImageRequest, *, json: bool, quiet: bool) -> int:
    """Print where the point is imaged (or JSON), write the through-focus picture."""
    kind = picture_kind(request.out)
    design = load_counted(path, overrides)
    source = parse_place(request.source, design.unit)
    from clacad.imaging import image
    from clacad.imaging.image_by_rays import image_seconds
    from clacad.prescription.prescribe import prescribe
    from clacad.storage.atomic import require_writable, write_content

    began = processor_seconds()
    window = prescribe(design)
    building = processor_seconds() - began
    words: Any = tuple(word.strip() for word in request.rungs.split(",") if word.strip())
    seconds = image_seconds(window, [w for w in words if w in ("law", "thin", "surfaces")], request.rays)
    if request.out is not None and request.out.suffix.lower() not in (".png", ".svg"):
        raise BadOption(f"-o {request.out}: the picture is a .png or an .svg")
    if request.dry_run:
        return _show_forecast(request, seconds, building, json=json, quiet=quiet)
    if request.out is not None:
        require_writable(request.out, overwrite=request.overwrite)
    try:
        with forecast(TASK, seconds, quiet=quiet):
            found = image(window, source, words, request.rays)
    except ValueError as error:
        raise BadOption(str(error)) from error
    if request.out is not None:
        from clacad.imaging.through_focus import plot_png, plot_svg

        plot = plot_svg if kind == "svg" else plot_png
        write_content(request.out, plot(found, design.name, design.unit), overwrite=request.overwrite)
    if json:
        show_json(found.to_dict() | {"unit": design.unit})
    else:
        show_text(image_text(found, design.unit), quiet=quiet)
    if request.out is not None:
        say(f"wrote {request.out}", quiet=quiet)
    return 0


def _show_forecast(request: ImageRequest, seconds: float, building: float, *, json: bool, quiet: bool) -> int:
    """Print what images would take; the sheet was built to say so, and what that took is told with it."""
    seconds += building + (PICTURE_SECONDS if request.out is not None else 0.0)
    if json:
        show_json({"forecast": {"rays": request.rays, "seconds": seconds, "building": building}})
    else:
        files = "one picture of about 100 kB" if request.out is not None else "no file"
        show_text(f"{request.rays:,} rays on each rung, about {seconds:.2g} s of processor time, {building:.2g} s of it to build the sheet, {files}; nothing is written",
                  quiet=quiet)  # fmt: skip
    return 0


def image_text(found: Image, unit: str) -> str:
    """The image for a person, rung by rung."""
    lines = [["rung", "predicted x, y, z", "found x, y, z", "apart", "spot rms x, y", "share", unit]]
    for one in found.rungs:
        lines.append([
            one.rung, _point(one.predicted), _point(one.found),
            "" if one.predicted.missing or one.found.missing else f"{one.off:.3g}",
            "" if one.found.missing else ", ".join(f"{v:.4g}" for v in one.found.spot), f"{100.0 * one.share:.3g} %", "",
        ])  # fmt: skip
    return "\n".join([table(lines), *_notes(found, unit)])


NO_WIDTH = 1e-9
"""Part of the image's distance below which pairs image sharply."""


def _notes(found: Image, unit: str) -> list[str]:
    """What the table leaves unsaid."""
    notes = [
        "share: of the light on the sheet, what goes through lenses of one telescopelet; rung law: a sheet of no thickness at z = 0"
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
        notes.append(f"sampling: the law of the cell hit turns light {1e3 * found.sampling.slope:.3g} mrad rms from the smooth law, whose spot "
                     f"at {_place(found.sampling.smooth.point)} would be {spot} {unit}")  # fmt: skip
    if found.zone is not None:
        zone, number, moire = (
            ", ".join(f"{v:.4g}" for v in pair)
            for pair in (found.zone.width, found.zone.f_number, found.zone.moire)
        )
        notes.append(f"array 2 has a pitch of its own or is turned: light along the normal stays with its partner over {zone} {unit} (x, y), "
                     f"one lens of F-number {number} of a lattice of them, and no field of a cell survives beyond the moire period {moire} "
                     f"{unit}; one large lens: [law.varying] f_image")  # fmt: skip
    return notes


def _instead(found: Image, instead: Middle, unit: str) -> str:
    """Where the light went, and which goes through."""
    one = next(one for one in found.rungs if one.rung == instead.rung)
    went = ", ".join(f"{100.0 * part:.3g} % {name}" for name, part in sorted(one.fates.items()))
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
        f"rung {one.rung}: {went}; {what}, through the middles of both lenses, has a share of {100.0 * instead.share:.3g} %: "
        f'--object="{place}"'
    )


def _point(best: BestPoint) -> str:
    return best.missing or _place(best.point)


def _place(point: Any) -> str:
    return ", ".join(f"{v + 0.0:.6g}" for v in point.round(9))
