"""`clacad render`: the view through the sheet, a picture or a movie."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.machine_rates import Rates
from clacad.cli.announce_cost import forecast
from clacad.cli.console import Progress, say, show_json, show_text, table
from clacad.cli.option_values import parse_angle
from clacad.storage.atomic import require_writable
from clacad.storage.errors import BadRequest

if TYPE_CHECKING:
    from clacad.rendering.coarse_first import CoarseView
    from clacad.rendering.picture import Picture
    from clacad.rendering.sheet_passage import Passage
    from clacad.scene import Scene

MOVIE_ENDINGS = (".webp", ".apng", ".gif", ".mp4")


@dataclass(frozen=True, slots=True)
class RenderRequest:
    """What to render and how."""

    out: Path
    pixels: int | None = None
    samples: int | None = None
    noise: float | None = None
    rung: str | None = None
    frame: int | None = None
    overwrite: bool = False
    target: str | None = None


def render_scene(path: Path, overrides: list[str], request: RenderRequest, *, json: bool, quiet: bool) -> int:
    """Render a scene file: a picture, or a movie where the scene is animated and the ending allows it.

    Where what draws a picture must be compiled first, it is drawn coarsely by numpy, and written, before that.
    """
    from clacad.rendering.coarse_first import BLOCK, must_compile, view_coarsely
    from clacad.rendering.picture import view_through
    from clacad.rendering.picture_files import write_picture
    from clacad.scene import load_scene

    _refuse_design(path)
    scene = _adjusted(load_scene(path, tuple(overrides)), request)
    require_writable(request.out, overwrite=request.overwrite)
    progress = Progress(quiet=quiet)
    if scene.animation is not None and request.frame is None and request.out.suffix.lower() in MOVIE_ENDINGS:
        return _movie(scene, request, progress, json=json, quiet=quiet)
    if scene.animation is not None:
        scene = scene.at(request.frame or 0)
    passage = _planned(scene, progress)
    coarse = must_compile(scene, passage)
    if coarse:
        first = view_coarsely(scene, passage, progress=_coarsely(progress))
        write_picture(first.enlarged(), request.out, overwrite=request.overwrite)
        progress.say(f"{request.out} is coarse as yet, in blocks of {BLOCK} pixels, and is refined now")
    with _announced(scene, passage, progress, quiet=quiet):
        picture = view_through(scene, progress=progress, passage=passage)
    progress.done()
    write_picture(picture, request.out, overwrite=request.overwrite or coarse)
    _told([picture], [request.out], json=json, quiet=quiet)
    return 0


def _refuse_design(path: Path) -> None:
    """Refuse a design file: it has no camera.

    Raises
    ------
    BadRequest
    """
    from clacad.config.toml_text import top_keys

    if path.is_file() and "law" in top_keys(str(path)):
        raise BadRequest(
            f"{path} is a design, which has no camera: `clacad render --preset eye {path} PHOTO -o OUT` shows a photograph "
            "through its sheet, and a scene file with [camera] and [sheet] any other view"
        )


def _planned(scene: Scene, progress: Progress) -> Passage:
    """How light passes the sheets of a still."""
    from clacad.prescription.prescribe import prescribe
    from clacad.rendering.sheet_passage import plan_passage

    progress("planning the effects")
    return plan_passage(scene, prescribe(scene.design()))


def _coarsely(progress: Progress) -> Callable[[str, float | None], None]:
    """Progress of a picture that is drawn small."""
    return lambda _, share: progress("drawing it coarsely", share)


@contextmanager
def _announced(
    scene: Scene, passage: Passage, progress: Progress, frames: int = 1, *, quiet: bool
) -> Iterator[None]:
    """Try some pixels of a still, and say before the block what all of them will take; what compiling takes is said first."""
    from clacad.rendering.coarse_first import must_compile
    from clacad.rendering.picture_cost import COMPILED, COMPILING, picture_seconds, task

    rates = Rates.here()
    with ExitStack() as compiling:
        if must_compile(scene, passage, frames):
            takes = rates.span(COMPILED, COMPILING)
            say(
                f"what draws it is compiled first, once on this machine: {takes} of processor time",
                quiet=quiet,
            )
            progress("compiling")
            compiling.enter_context(rates.noting(COMPILED, COMPILING))
        else:
            progress("trying some pixels")
        modelled = picture_seconds(scene, passage, frames)
    with forecast(task(scene, frames), modelled, quiet=quiet) as span:
        progress.expect(span.middle)
        yield


def _adjusted(scene: Scene, request: RenderRequest) -> Scene:
    """The scene with the options of the command line, checked as a file would be."""
    changes: dict[str, Any] = {}
    if request.pixels is not None:
        width, height = scene.camera.pixels
        changes["camera.pixels"] = [request.pixels, max(1, round(request.pixels * height / width))]
    for key in ("samples", "noise"):
        value = getattr(request, key)
        if value is not None:
            changes[f"camera.{key}"] = value
    if request.rung is not None:
        several = len(scene.sheets) > 1 or scene.sheet.id
        homes = [f"sheet.{one.id}" for one in scene.sheets] if several else ["sheet"]
        changes |= {f"{home}.rung": request.rung for home in homes}
    made = scene.replace(changes) if changes else scene
    return made if request.target is None else _within_target(made, request.target)


def _within_target(scene: Scene, text: str) -> Scene:
    """The scene with a rung, or facets, within an asked error.

    Raises
    ------
    TargetOutOfReach
    """
    from clacad.rendering.picture_target import within_target

    return within_target(scene, parse_angle("--target", text))


def _movie(scene: Scene, request: RenderRequest, progress: Progress, *, json: bool, quiet: bool) -> int:
    """Write all frames as a movie, print how many; return the exit status.

    Where what draws them must be compiled first, the first frame is drawn coarsely by numpy, and stands there alone before that.
    """
    from clacad.rendering.coarse_first import BLOCK, must_compile, view_coarsely
    from clacad.rendering.picture import checked_frames, render_movie
    from clacad.rendering.picture_files import write_movie

    assert scene.animation is not None
    still, count, fps = scene.at(0), scene.animation.frames, scene.animation.fps
    passage = _planned(still, progress)
    coarse = must_compile(still, passage, count)
    if coarse:
        checked_frames(scene)
        first = view_coarsely(still, passage, progress=_coarsely(progress), frames=count)
        write_movie([first.enlarged()], request.out, fps, overwrite=request.overwrite)
        progress.say(
            f"{request.out} is the first of {count} frames as yet, coarse, in blocks of {BLOCK} pixels; the movie takes its place"
        )
    with _announced(still, passage, progress, count, quiet=quiet):
        frames = write_movie(
            render_movie(scene, progress=progress), request.out, fps, overwrite=request.overwrite or coarse
        )
    progress.done()
    if json:
        show_json({"files": [str(request.out)], "frames": frames})
    else:
        rays = sum(frame["rays"] for frame in frames)
        show_text(f"wrote {request.out}: {len(frames)} frames, {rays:,} camera rays", quiet=quiet)
    return 0


def _told(pictures: list[Picture], files: list[Path], *, json: bool, quiet: bool) -> None:
    """Say what was written and how it was made."""
    from clacad.rendering.picture_files import metadata_of

    if json:
        shown = []
        for picture, file in zip(pictures, files, strict=True):
            plan, several = picture.passage.plan, picture.passage.several
            shown.append({
                "file": str(file), "metadata": metadata_of(picture), "samples": int(picture.samples.sum()),
                "error": float(picture.error.mean()), "plan": None if plan is None else plan.to_dict(),
            })  # fmt: skip
            if several:
                plans = ((one.sheet.id, one.passage.plan) for one in several)
                shown[-1]["plans"] = {name: None if one is None else one.to_dict() for name, one in plans}
        show_json({"pictures": shown})
        return
    for picture, file in zip(pictures, files, strict=True):
        height, width = picture.light.shape[:2]
        show_text(
            f"wrote {file}: {width} x {height}, {int(picture.samples.sum()):,} camera rays", quiet=quiet
        )
    notes = metadata_of(pictures[-1])
    rows = [(key.removeprefix("clacad:"), notes[key]) for key in notes if key.startswith("clacad:")]
    say(table(rows), quiet=quiet)


def render_eye(
    design: Path, photo: Path, overrides: list[str], request: RenderRequest, eye: str | None, distance: str | None,
    *, json: bool, quiet: bool,
) -> int:  # fmt: skip
    """Render a photograph behind the sheet, seen by an eye, with and without the sheet."""
    from clacad.rendering.coarse_first import BLOCK
    from clacad.rendering.photograph_view import EyeRequest, eye_scene, without_sheet
    from clacad.rendering.picture_files import write_picture

    if not photo.is_file():
        raise BadRequest(f"{photo}: there is no such picture")
    asked = EyeRequest(
        design, photo, _length(design, overrides, "--eye", eye), _length(design, overrides, "--distance", distance),
        pixels=request.pixels or 480, samples=request.samples or 16,
    )  # fmt: skip
    progress = Progress(quiet=quiet)
    scene = _adjusted(eye_scene(asked, tuple(overrides)), replace(request, pixels=None, samples=None))
    out = request.out
    bare = out.with_name(f"{out.stem}-without{out.suffix}")
    for path in (out, bare):
        require_writable(path, overwrite=request.overwrite)
    coarse = _seen_coarsely(scene, progress)
    before = without_sheet(scene, coarse.passage)
    write_picture(before, bare, overwrite=request.overwrite)
    write_picture(coarse.enlarged(), out, overwrite=request.overwrite)
    progress.say(f"wrote {bare}; {out} is coarse as yet, in blocks of {BLOCK} pixels, and is refined now")
    after = _refined(coarse, progress, quiet=quiet)
    progress.done()
    write_picture(after, out, overwrite=True)  # what was coarse
    _told([before, after], [bare, out], json=json, quiet=quiet)
    return 0


def _seen_coarsely(scene: Scene, progress: Progress) -> CoarseView:
    """Plan what an eye sees, and draw it small."""
    from clacad.rendering.coarse_first import view_coarsely

    return view_coarsely(scene, _planned(scene, progress), progress=_coarsely(progress))


def _refined(coarse: CoarseView, progress: Progress, *, quiet: bool) -> Picture:
    """Draw it fine; what that takes is forecast by some of its pixels."""
    with _announced(coarse.scene, coarse.fine_passage, progress, quiet=quiet):
        return coarse.refined(progress=progress)


def _length(design: Path, overrides: list[str], option: str, text: str | None) -> float | None:
    """A length of the command line in design units: bare, or with a unit."""
    if text is None:
        return None
    from clacad.cli.option_values import parse_distance
    from clacad.design import load

    return parse_distance(option, text, load(design, tuple(overrides)).unit)
