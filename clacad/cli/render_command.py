"""`clacad render`: the view through the sheet, a picture or a movie."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.cli.command import Command, Overridden, option, overwrite_option, required
from clacad.cli.console import Brief, Console, Progress, facts, table
from clacad.cli.option_values import BadOption, load_design, parse_angle, parse_distance

if TYPE_CHECKING:
    from clacad.rendering.picture import Picture
    from clacad.rendering.sheet_passage import Passage
    from clacad.scene import Scene

MOVIE_ENDINGS = (".webp", ".apng", ".gif", ".mp4")


@dataclass(frozen=True, kw_only=True)
class Render(Overridden):
    """View through the sheet: picture or movie."""

    scene: Path = required("SCENE", "Scene file; with --preset eye the design file.")
    photo: Path | None = option("PHOTO", "With --preset eye: the picture behind the sheet.")
    out: Path = required("-o, --out FILE", "Picture (.png .webp .tiff) or movie (.webp .apng .gif .mp4).")
    preset: str | None = option(
        "--preset WORD",
        "eye: a photograph behind a design's sheet, seen by an eye; also writes the view without the sheet.",
    )
    eye: str | None = option(
        "--eye L", "Preset eye: distance of the eye before the sheet, e.g. '400 mm'; default four widths."
    )
    distance: str | None = option(
        "--distance L", "Preset eye: distance of the picture behind the sheet; default two widths."
    )
    pixels: int | None = option("--pixels N", "Pixels across.", least=1, most=32768)
    samples: int | None = option("--samples N", "Rays a pixel.", least=1, most=65536)
    noise: float | None = option("--noise X", "Sample until a pixel's standard error is below this.")
    rung: str | None = option("--rung WORD", "auto, law, thin, surfaces or mesh.")
    target: float | None = option(
        "--target E",
        "Cheapest rung (of rung mesh: coarsest facets) within this rms direction error, e.g. '0.5 mrad'.",
        read=parse_angle,
    )
    frame: int | None = option("--frame N", "One frame of an animation, as a still.", least=0)
    overwrite: bool = overwrite_option()


def run(request: Render, console: Console) -> int:
    """Render a scene file, or with a preset a photograph behind the sheet of a design."""
    if request.preset is not None:
        if request.preset != "eye":
            raise BadOption(f"--preset: there is no preset {request.preset!r}; there is: eye")
        if request.photo is None:
            raise BadOption("--preset eye needs a DESIGN and a PHOTO")
        return _render_eye(request, request.photo, console)
    if request.photo is not None or request.eye is not None or request.distance is not None:
        raise BadOption("PHOTO, --eye and --distance belong to --preset eye")
    return _render_scene(request, console)


def _render_scene(request: Render, console: Console) -> int:
    """Render a scene file: a picture, or a movie where the scene is animated and the ending allows it.

    Where the drawing kernels must be compiled first, a coarse picture of numpy is written before that.
    """
    from clacad.rendering.picture import view_through
    from clacad.rendering.picture_cost import PIXELS_A_BLOCK as BLOCK
    from clacad.rendering.picture_cost import must_compile, view_coarsely
    from clacad.rendering.picture_files import write_picture
    from clacad.scene import load_scene
    from clacad.storage.atomic import require_writable

    out = request.out
    _refuse_design(request.scene)
    scene = _adjusted(load_scene(request.scene, request.set), request)
    require_writable(out, overwrite=request.overwrite)
    if scene.animation is not None and request.frame is None and out.suffix.lower() in MOVIE_ENDINGS:
        return _movie(scene, request, console)
    if scene.animation is not None:
        scene = scene.at(request.frame or 0)
    with console.progress() as progress:
        passage = _planned(scene, progress)
        coarse = must_compile(scene, passage)
        if coarse:
            first = view_coarsely(scene, passage, progress=_coarsely(progress))
            write_picture(first.enlarged(), out, overwrite=request.overwrite)
            progress.say(f"{out} is coarse as yet, in blocks of {BLOCK} pixels, and is refined now")
        with _announced(scene, passage, progress, console):
            picture = view_through(scene, progress=progress, passage=passage)
    write_picture(picture, out, overwrite=request.overwrite or coarse)
    _show([picture], [out], console)
    return 0


def _refuse_design(path: Path) -> None:
    """Refuse a design file: it has no camera."""
    from clacad.config.toml_text import top_keys

    if path.is_file() and "law" in top_keys(str(path)):
        raise BadOption(
            f"{path} is a design, which has no camera: `clacad render --preset eye {path} PHOTO -o OUT` "
            "shows a photograph through its sheet, and a scene file with [camera] and [sheet] any other "
            "view"
        )


def _planned(scene: Scene, progress: Progress) -> Passage:
    """Passage of light through the sheets of a still."""
    from clacad.rendering.sheet_passage import plan_passage

    progress("planning the effects")
    return plan_passage(scene)


def _coarsely(progress: Progress) -> Callable[[str, float | None], None]:
    """Progress of a coarse picture."""
    return lambda _, share: progress("drawing it coarsely", share)


@contextmanager
def _announced(
    scene: Scene, passage: Passage, progress: Progress, console: Console, frames: int = 1
) -> Iterator[None]:
    """Try some pixels of a still, and print the cost of all before the block; that of compiling first."""
    from clacad.base.machine_rates import Rates
    from clacad.rendering.picture_cost import COMPILED, COMPILING, must_compile, picture_seconds, task

    rates = Rates.here()
    with ExitStack() as compiling:
        if must_compile(scene, passage, frames):
            takes = rates.span(COMPILED, COMPILING)
            console.say(f"what draws it is compiled first, once on this machine: {takes} of processor time")
            progress("compiling")
            compiling.enter_context(rates.noting(COMPILED, COMPILING))
        else:
            progress("trying some pixels")
        modelled = picture_seconds(scene, passage, frames)
    with console.forecast(task(scene, frames), modelled) as span:
        progress.expect(span.middle)
        yield


def _adjusted(scene: Scene, request: Render) -> Scene:
    """The scene with the options of the command line; a preset has its own pixels and samples."""
    changes: dict[str, Any] = {}
    if request.pixels is not None and request.preset is None:
        width, height = scene.camera.pixels
        changes["camera.pixels"] = [request.pixels, max(1, round(request.pixels * height / width))]
    if request.samples is not None and request.preset is None:
        changes["camera.samples"] = request.samples
    if request.noise is not None:
        changes["camera.noise"] = request.noise
    if request.rung is not None:
        several = len(scene.sheets) > 1 or scene.sheet.id
        homes = [f"sheet.{one.id}" for one in scene.sheets] if several else ["sheet"]
        changes |= {f"{home}.rung": request.rung for home in homes}
    made = scene.replace(changes) if changes else scene
    if request.target is None:
        return made
    from clacad.rendering.picture_cost import within_target

    return within_target(made, request.target)


def _movie(scene: Scene, request: Render, console: Console) -> int:
    """Write all frames as a movie, print their number; return the exit status.

    Where the drawing kernels must be compiled first, a coarse first frame of numpy is written before that.
    """
    from clacad.rendering.picture import checked_frames, render_movie
    from clacad.rendering.picture_cost import PIXELS_A_BLOCK as BLOCK
    from clacad.rendering.picture_cost import must_compile, view_coarsely
    from clacad.rendering.picture_files import write_movie

    assert scene.animation is not None
    still, count, fps = scene.at(0), scene.animation.frames, scene.animation.fps
    out = request.out
    with console.progress() as progress:
        passage = _planned(still, progress)
        coarse = must_compile(still, passage, count)
        if coarse:
            checked_frames(scene)
            first = view_coarsely(still, passage, progress=_coarsely(progress), frames=count)
            write_movie([first.enlarged()], out, fps, overwrite=request.overwrite)
            progress.say(
                f"{out} is the first of {count} frames as yet, coarse, in blocks of {BLOCK} pixels; the "
                "movie takes its place"
            )
        with _announced(still, passage, progress, console, count):
            pictures = render_movie(scene, progress=progress)
            frames = write_movie(pictures, out, fps, overwrite=request.overwrite or coarse)
    console.show(
        lambda: {"files": [str(out)], "frames": frames},
        lambda: f"wrote {out}: {len(frames)} frames, {sum(frame['rays'] for frame in frames):,} camera rays",
    )
    return 0


def _show(pictures: list[Picture], files: list[Path], console: Console) -> None:
    """Print the written files and the metadata of the last picture."""
    from clacad.rendering.picture_files import metadata_of

    pairs = list(zip(pictures, files, strict=True))
    written = "\n".join(
        f"wrote {file}: {picture.light.shape[1]} x {picture.light.shape[0]}, "
        f"{int(picture.samples.sum()):,} camera rays"
        for picture, file in pairs
    )
    notes = metadata_of(pictures[-1])
    rows = [(key.removeprefix("clacad:"), notes[key]) for key in notes if key.startswith("clacad:")]
    console.show(
        lambda: {"pictures": [_document(picture, file) for picture, file in pairs]},
        lambda: f"{written}\n{table(rows)}",
        lambda: Brief(written.replace("\n", "; "), (facts(rows),)),
    )


def _document(picture: Picture, file: Path) -> dict[str, Any]:
    from clacad.rendering.picture_files import metadata_of

    plan, several = picture.passage.plan, picture.passage.several
    shown = {
        "file": str(file),
        "metadata": metadata_of(picture),
        "samples": int(picture.samples.sum()),
        "error": float(picture.error.mean()),
        "plan": None if plan is None else plan.to_dict(),
    }
    if several:
        plans = ((one.sheet.id, one.passage.plan) for one in several)
        shown["plans"] = {name: None if one is None else one.to_dict() for name, one in plans}
    return shown


def _render_eye(request: Render, photo: Path, console: Console) -> int:
    """Render a photograph behind the sheet, seen by an eye, with and without the sheet."""
    from clacad.rendering.picture import EyeRequest, eye_scene, without_sheet
    from clacad.rendering.picture_cost import PIXELS_A_BLOCK as BLOCK
    from clacad.rendering.picture_cost import view_coarsely
    from clacad.rendering.picture_files import write_picture
    from clacad.storage.atomic import require_writable

    if not photo.is_file():
        raise BadOption(f"{photo}: there is no such picture")
    view = EyeRequest(
        request.scene,
        photo,
        _length(request, "--eye", request.eye),
        _length(request, "--distance", request.distance),
        pixels=request.pixels or 480,
        samples=request.samples or 16,
    )
    with console.progress() as progress:
        scene = _adjusted(eye_scene(view, request.set), request)
        out = request.out
        bare = out.with_name(f"{out.stem}-without{out.suffix}")
        for path in (out, bare):
            require_writable(path, overwrite=request.overwrite)
        coarse = view_coarsely(scene, _planned(scene, progress), progress=_coarsely(progress))
        before = without_sheet(scene, coarse.passage)
        write_picture(before, bare, overwrite=request.overwrite)
        write_picture(coarse.enlarged(), out, overwrite=request.overwrite)
        progress.say(f"wrote {bare}; {out} is coarse as yet, in blocks of {BLOCK} pixels, and is refined now")
        with _announced(coarse.scene, coarse.fine_passage, progress, console):
            after = coarse.refined(progress=progress)
    write_picture(after, out, overwrite=True)  # the coarse one
    _show([before, after], [bare, out], console)
    return 0


def _length(request: Render, option: str, text: str | None) -> float | None:
    """A length of the command line in design units: bare, or with a unit."""
    return (
        None if text is None else parse_distance(option, text, load_design(request.scene, request.set).unit)
    )


COMMANDS = (Command("render", "look", Render, run),)
