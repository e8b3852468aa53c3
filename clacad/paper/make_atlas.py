"""The atlas: every figure and movie of the paper, labelled, with its row measured; an index page of it all.

The atlas's index page: pictures, movies and measured numbers; it loads only the pictures in its folder.
"""

from __future__ import annotations

import html
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path
from typing import Any

import numpy as np

from clacad.base.types import Bytes, Progress
from clacad.design import Design
from clacad.design.sections import AimedAt
from clacad.paper.figure1 import section_findings, solid_findings, solid_picture
from clacad.paper.paper_figures import FIGURES as PAPER
from clacad.paper.paper_figures import MOVIES, AtlasFinding, Figure, piece_on_sheet
from clacad.paper.sheet_figures import DIFFERING, FIELD_LENS, ghosts_marked
from clacad.rendering.camera import aim
from clacad.rendering.picture import Picture, checked_frames, view_through
from clacad.rendering.picture_files import animate, label_lines, labelled, metadata_of, pixels_of, save
from clacad.scene import Scene, load_scene
from clacad.storage.atomic import Stage, canonical_json, file_hash

POLICY = "default-src 'none'; img-src 'self'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
"""Content security policy: no script, no frame, no font, nothing from other sites."""

NOTE = (
    "Figures F and W are drawn left-handed (x to the right), as the paper's renderer draws: the part made"
    " from a design shows the view flipped left-right. Figures V are drawn as the part shows it. Lengths are"
    " floor tiles in F, millimetres elsewhere. Exact refraction at every lens face, ghosts included."
)

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 76em; margin: 2em auto; padding: 0 1em; color: #222 }
figure { display: inline-block; margin: 0 1em 1em 0; vertical-align: top }
img { max-width: 100%; border: 1px solid #ccc }
figcaption { font-size: 90%; color: #555 } table { border-collapse: collapse; margin: 0 0 2em }
td, th { padding: .15em .8em; text-align: right; border-bottom: 1px solid #ddd }
td:first-child, th:first-child { text-align: left }
.fail { color: #b00; font-weight: bold }
@media (prefers-color-scheme: dark) { body { background: #181a1c; color: #ddd }
  td, th { border-color: #444 } }
"""


def page_of(
    figures: Sequence[Figure],
    findings: Mapping[str, tuple[AtlasFinding, ...]],
    movies: Sequence[tuple[str, str]],
    names: Sequence[str],
) -> str:
    """The page of some figures.

    findings : mapping from row to findings
    movies : sequence of (scene file stem, title)
    names : Files in the folder of the page.
    """
    parts = [f"<p>{html.escape(NOTE)}</p>"]
    if "fig1a.svg" in names:
        section = _img("fig1a.svg", "one telescopelet, to scale, rays traced")
        solids = _img("fig1b.png", "both arrays, drawn as tinted solids (no refraction)")
        parts += [f"<h2>F1 &ndash; Fig. 1: geometry</h2>{section}", solids]
        parts += [_table(findings["F1"])] if "F1" in findings else []
    for figure in figures:
        row, title, says = map(html.escape, (figure.row, figure.title, figure.says))
        parts.append(f"<h2>{row} &ndash; {title}</h2><p>{says}</p>")
        parts += [_img(f"{stem}.png", label) for stem, label in figure.scenes]
        parts += [_img(f"{stem}.png", label) for stem, label, _ in figure.drawn]
        parts += [_img(f"{stem}.webp", title) for stem, title in movies if figure.owns(title)]
        if figure.row in findings:
            parts.append(_table(findings[figure.row]))
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n<meta'
        f' http-equiv="Content-Security-Policy" content="{POLICY}">\n<meta name="viewport"'
        ' content="width=device-width"><title>Views through the'
        f" sheet</title><style>{STYLE}</style></head>\n<body><h1>Views through generalized confocal lenslet"
        " arrays</h1>\n" + "\n".join(parts) + "\n</body></html>\n"
    )


def _img(name: str, label: str) -> str:
    text = html.escape(label)
    return f'<figure><img src="{html.escape(name)}" alt="{text}"><figcaption>{text}</figcaption></figure>'


def _table(findings: Sequence[AtlasFinding]) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(one.what)}</td><td>{one.measured:.4g}</td><td>{one.expected:.4g}</td>"
        f"<td>{one.tolerance:.2g}</td>"
        f"<td{'' if one.passed else ' class=fail'}>{'pass' if one.passed else 'FAIL'}</td></tr>"
        for one in findings
    )
    head = (
        "<tr><th>measured in the"
        " picture</th><th>measured</th><th>formula</th><th>tolerance</th><th></th></tr>"
    )
    return f"<table>{head}{rows}</table>"


FIGURES = (*PAPER, *DIFFERING)
"""The paper's figures, and additional ones."""


@dataclass(frozen=True, eq=False)
class Atlas:
    """Result of making an atlas.

    findings : mapping from row to findings
    """

    folder: Path
    findings: dict[str, tuple[AtlasFinding, ...]]
    files: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether every measured number lies within its tolerance."""
        return all(one.passed for found in self.findings.values() for one in found)


@dataclass(frozen=True, slots=True)
class AtlasRequest:
    """Specification of an atlas.

    scenes : Folder of the scene files.
    size : Pixels across a picture.
    samples : Rays a pixel.
    rows : Rows to make ("F3"); empty: all.
    measured : Whether rows are measured.
    """

    scenes: Path
    out: Path
    size: int = 440
    samples: int = 16
    movies: bool = True
    movie_size: int = 220
    rows: tuple[str, ...] = ()
    measured: bool = True
    overwrite: bool = False


@dataclass(frozen=True, eq=False)
class Movie:
    """A movie to make: scene file stem, title, frames a second and the still of each frame."""

    stem: str
    title: str
    fps: float
    frames: tuple[Scene, ...]

    def labels(self) -> list[str]:
        """Label of each frame; all name the same parameters."""
        turned = any(any(still.design().law_spec.euler) for still in self.frames)
        return [f"{self.title.split(':')[0]}: {parameters(still, turned)}" for still in self.frames]


@dataclass(frozen=True, eq=False)
class AtlasJob:
    """All input of an atlas, read and checked.

    stills : mapping from scene file stem to Scene, sized as requested
    movies : frames sized as requested
    first : (Scene, Scene) or None. Of Fig. 1(a) and 1(b).
    """

    request: AtlasRequest
    figures: tuple[Figure, ...]
    stills: dict[str, Scene]
    movies: tuple[Movie, ...]
    first: tuple[Scene, Scene] | None

    def load(self, stem: str) -> Scene:
        """A scene as specified in its file."""
        return load_scene(self.request.scenes / f"{stem}.toml")


class NoSuchRow(ValueError):
    """A requested row that is none of the paper's figures; exit status 2."""

    exit_status = 2


def prepare(request: AtlasRequest) -> AtlasJob:
    """Read every scene that an atlas needs and check every frame of its movies.

    Raises NoSuchRow.
    Raises SceneError: A scene is missing or wrong.
    """
    figures = (*FIGURES, FIELD_LENS)
    known = ("F1", *(figure.row for figure in figures))
    for row in request.rows:
        if row not in known:
            raise NoSuchRow(f"there is no row {row}; rows are {', '.join(known)}")

    def load(stem: str) -> Scene:
        return load_scene(request.scenes / f"{stem}.toml")

    chosen = tuple(f for f in figures if not request.rows or f.row in request.rows)
    stills = {stem: _sized(load(stem), request.size, request.samples) for f in chosen for stem, _ in f.scenes}
    movies = []
    for stem, title in MOVIES:
        if request.movies and any(figure.owns(title) for figure in chosen):
            scene = load(stem)
            frames = tuple(
                _sized(still, request.movie_size, request.samples) for still in checked_frames(scene)
            )
            assert scene.animation is not None  # it has frames
            movies.append(Movie(stem, title, scene.animation.fps, frames))
    first = None
    if not request.rows or "F1" in request.rows:
        first = load("fig1a"), _sized(load("fig1b"), request.size, max(4, request.samples // 4))
    return AtlasJob(request, chosen, stills, tuple(movies), first)


def make_atlas(job: AtlasJob, progress: Progress | None = None) -> Atlas:
    """Make the figures, movies, measurements and the index page. Raises CannotWrite, ExportRefused."""
    tell = progress or (lambda stage, share: None)
    findings: dict[str, tuple[AtlasFinding, ...]] = {}
    with Stage(job.request.out, overwrite=job.request.overwrite) as stage:
        if job.first is not None:
            tell("F1", nan)
            findings |= _first_figure(stage, *job.first, measured=job.request.measured)
        for figure in job.figures:
            for stem, label in figure.scenes:
                tell(f"{figure.row}: {label}", nan)
                still = job.stills[stem]
                picture = ghosts_marked(still) if figure.ghosts_marked else view_through(still, compiled=True)
                text = f"{figure.row}: {label if figure.ghosts_marked else parameters(still)}"
                pixels = pixels_of(picture)
                if stem in figure.circled:
                    pixels = circled(pixels, still)
                save(labelled(pixels, text), stage.path(f"{stem}.png"), metadata_of(picture))
            for stem, label, draw in figure.drawn:
                tell(f"{figure.row}: {label}", nan)
                stage.path(f"{stem}.png").write_bytes(draw())
            if job.request.measured:
                tell(f"{figure.row}: measuring", nan)
                findings[figure.row] = tuple(figure.check(job.load))
        for movie in job.movies:
            _movie(stage, movie, tell)
        names = _names(stage)
        page = page_of(job.figures, findings, [(movie.stem, movie.title) for movie in job.movies], names)
        stage.path("index.html").write_text(page, encoding="utf-8")
        stage.path("atlas.json").write_text(canonical_json(_record(findings)), encoding="utf-8")
        stage.publish(manifest_of(stage, "atlas"))
    return Atlas(stage.folder, findings, (*names, "index.html", "atlas.json"))


CIRCLE = 1.2
"""Radius of a circle round a piece over half its length; at least a fortieth of the picture's width."""


def circled(pixels: Bytes, scene: Scene) -> Bytes:
    """Draw a red circle round the place on the sheet where the law shows the piece; (h, w, 3) is kept."""
    from PIL import Image, ImageDraw

    place, half = piece_on_sheet(scene)
    view = aim(scene.camera)
    height, width = pixels.shape[:2]
    across, down = np.linalg.norm(view.right), np.linalg.norm(view.down)
    ahead = view.ahead / np.linalg.norm(view.ahead)
    way = np.array([*place, 0.0]) - view.position
    way = way * (np.linalg.norm(view.ahead) / (way @ ahead)) - view.ahead  # on the plane through the target
    x = width * (0.5 + float(way @ view.right) / across**2)
    y = height * (0.5 + float(way @ view.down) / down**2)
    radius = max(CIRCLE * half * width / across, width / 40.0)
    picture = Image.fromarray(pixels)
    box = (x - radius, y - radius, x + radius, y + radius)
    ImageDraw.Draw(picture).ellipse(box, outline=(214, 40, 40), width=max(1, round(width / 220)))
    return np.asarray(picture)


def _sized(scene: Scene, size: int, samples: int) -> Scene:
    width, height = scene.camera.pixels
    pixels = (size, max(1, round(size * height / width)))
    return replace(scene, camera=replace(scene.camera, pixels=pixels, samples=samples))


def parameters(scene: Scene, turned: bool = False) -> str:
    """Parameters that a still shows, read from the scene itself: "eta = (-0.25, -1), z = 10".

    turned : Name the three angles even where all are 0.
    """
    said = [scene.design().law_spec.words(turned), *_of_cells(scene.design())]
    said += [f"z = {thing.at[2]:.4g}" for thing in scene.objects if thing.id == "knight"]
    return ", ".join(said)


def _of_cells(design: Design) -> list[str]:
    """Words on the non-uniformity of a design's cells; none for a uniform sheet."""
    aperture, pitch, varying = design.lattice.aperture, design.lattice.pitch_2, design.law_spec.varying
    said = []
    if isinstance(aperture, AimedAt):
        said.append("aimed at (" + ", ".join(f"{v:g}" for v in aperture.point) + ")")
    if pitch is not None:
        said.append("pitch_2 = " + ", ".join(f"{v:g}" for v in dict.fromkeys(pitch)))
    if varying is not None and varying.f_image is not None:
        said.append("f_image = " + ", ".join(f"{v:g}" for v in dict.fromkeys(varying.f_image)))
    return said


def _movie(stage: Stage, movie: Movie, tell: Progress) -> None:
    """Draw a movie, each frame labelled with the parameters of its own scene."""
    labels = movie.labels()
    width = movie.frames[0].camera.pixels[0]
    lines = max(len(label_lines(label, width)) for label in labels)
    pixels: list[Bytes] = []
    notes: dict[str, str] = {}
    for k, still in enumerate(movie.frames):
        tell(f"movie {movie.title}", k / len(movie.frames))
        picture: Picture = view_through(still, compiled=True)
        pixels.append(labelled(pixels_of(picture), labels[k], lines))
        notes = metadata_of(picture)
    animate(stage.path(f"{movie.stem}.webp"), iter(pixels), movie.fps, notes)


def _first_figure(
    stage: Stage, section: Scene, solids: Scene, *, measured: bool
) -> dict[str, tuple[AtlasFinding, ...]]:
    """Figure 1: the section with rays as SVG, and the sheet as a picture; return the findings of both."""
    from clacad.paper.figure1 import section_svg

    stage.path("fig1a.svg").write_text(section_svg(section.design()), encoding="utf-8")
    text = (
        f"F1b: {parameters(solids)}, separation = {solids.design().pair.separation}, "
        "drawn as tinted solids without refraction"
    )
    save(
        labelled(solid_picture(solids), text),
        stage.path("fig1b.png"),
        {"Title": solids.name, "clacad:design": solids.design().name},
    )
    return {"F1": (*section_findings(section), *solid_findings(solids))} if measured else {}


def _names(stage: Stage) -> tuple[str, ...]:
    folder = stage.path("x").parent
    return tuple(sorted(path.name for path in folder.iterdir()))


def manifest_of(stage: Stage, kind: str) -> dict[str, Any]:
    """The manifest of all files of a stage."""
    folder = stage.path("x").parent
    files = [
        {"name": path.name, "sha256": file_hash(path), "bytes": os.path.getsize(path)}
        for path in sorted(folder.iterdir())
    ]
    return {"format": 1, "kind": kind, "files": files}


def _record(findings: dict[str, tuple[AtlasFinding, ...]]) -> dict[str, Any]:
    passed = all(one.passed for found in findings.values() for one in found)
    return {
        "passed": passed,
        "rows": {row: [one.to_dict() for one in found] for row, found in findings.items()},
    }


# -- cost ---------------------------------------------------------------------------------------

ATLAS = "atlas"
"""Name under which the time of an atlas is recorded."""

LABELLED, PER_ATLAS_RAY, PER_FIGURE, PER_SOLID_RAY = 0.1, 1.7e-7, 2.0, 7e-6
"""Seconds of a picture apart from its rays, a ray through lenses, measuring a figure, a ray of Fig. 1(b)."""


def atlas_seconds(job: AtlasJob) -> float:
    """Processor seconds of an atlas: its stills, the frames of its movies, and what is measured."""
    frames = [still for movie in job.movies for still in movie.frames]
    twice = [job.stills[stem] for figure in job.figures if figure.ghosts_marked for stem, _ in figure.scenes]
    total = _drawn([*job.stills.values(), *twice]) + _drawn(frames)
    if job.first is not None:
        total += LABELLED + PER_SOLID_RAY * _rays(job.first[1])
    measured = len(job.figures) + (job.first is not None)
    return total + (PER_FIGURE * measured if job.request.measured else 0.0)


def _drawn(stills: Sequence[Scene]) -> float:
    return sum(LABELLED + PER_ATLAS_RAY * _rays(still) for still in stills)


def _rays(scene: Scene) -> int:
    width, height = scene.camera.pixels
    return int(width * height * scene.camera.samples)
