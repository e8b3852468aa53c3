"""The atlas: every figure and movie of the paper, labelled, with its row measured; an index page of it all."""

from __future__ import annotations

import html
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from clacad.export.atomic import Stage, canonical_json, file_hash
from clacad.render.files import Bytes, animate, facts, labelled, pixels_of, save
from clacad.render.picture import Picture, Progress, checked_frames, view_through
from clacad.render.rows import FIGURES, MOVIES, Figure, Finding
from clacad.scene import Scene, load_scene
from clacad.scene.moves import values_at

NOTE = (
    "Drawn left-handed (x to the right), as the paper's renderer draws: the part made from a design shows the view "
    "flipped left-right. Exact refraction at every lens face, ghosts included; lengths in floor tiles."
)


@dataclass(frozen=True, eq=False)
class Atlas:
    """What was made.

    Attributes
    ----------
    folder : Path
    findings : mapping from row to findings
    files : tuple of str
    """

    folder: Path
    findings: dict[str, tuple[Finding, ...]]
    files: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether every measured number lies within its tolerance."""
        return all(one.passed for found in self.findings.values() for one in found)


@dataclass(frozen=True, slots=True)
class AtlasRequest:
    """What to make.

    Parameters
    ----------
    scenes : Path
        Folder of the scene files.
    out : Path
    size : int
        Pixels across a picture.
    samples : int
        Rays a pixel.
    movies : bool
    movie_size : int
    rows : tuple of str
        Rows to make ("F3"); empty: all.
    measured : bool
        Whether rows are measured.
    overwrite : bool
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


def make_atlas(request: AtlasRequest, progress: Progress | None = None) -> Atlas:
    """Make the figures, movies, measurements and the index page.

    Raises
    ------
    SceneError
        A scene is missing or wrong; nothing is written then.
    CannotWrite, ExportRefused
    """
    tell = progress or (lambda stage, share: None)

    def load(stem: str) -> Scene:
        return load_scene(request.scenes / f"{stem}.toml")

    chosen = [f for f in FIGURES if not request.rows or f.row in request.rows]
    stills = {stem: load(stem) for figure in chosen for stem, _ in figure.scenes}
    movies = [
        (stem, title, load(stem))
        for stem, title in MOVIES
        if request.movies and any(title.startswith(f.title.split(":")[0]) for f in chosen)
    ]
    frames = {stem: checked_frames(scene) for stem, _, scene in movies}
    findings: dict[str, tuple[Finding, ...]] = {}
    with Stage(request.out, overwrite=request.overwrite) as stage:
        for figure in chosen:
            for stem, label in figure.scenes:
                tell(f"{figure.row}: {label}", None)
                picture = view_through(_sized(stills[stem], request.size, request.samples), compiled=True)
                text = f"{figure.row}  {label}"
                save(labelled(pixels_of(picture), text), stage.path(f"{stem}.png"), facts(picture))
            if request.measured:
                tell(f"{figure.row}: measuring", None)
                findings[figure.row] = tuple(figure.check(load))
        for stem, title, scene in movies:
            _movie(stage, stem, title, _moments(scene), frames[stem], request, tell)
        if not request.rows or "F1" in request.rows:
            tell("F1", None)
            _first_figure(stage, request, load)
        names = _names(stage)
        page = _page(chosen, findings, [(stem, title) for stem, title, _ in movies], names)
        stage.path("index.html").write_text(page, encoding="utf-8")
        stage.path("atlas.json").write_text(canonical_json(_record(findings)), encoding="utf-8")
        stage.publish(manifest_of(stage, "atlas"))
    return Atlas(stage.folder, findings, (*names, "index.html", "atlas.json"))


def _sized(scene: Scene, size: int, samples: int) -> Scene:
    width, height = scene.camera.pixels
    pixels = (size, max(1, round(size * height / width)))
    return replace(scene, camera=replace(scene.camera, pixels=pixels, samples=samples))


def _moments(scene: Scene) -> list[str]:
    """What the first moved key is in each frame: "z = 3.5"."""
    animation = scene.animation
    assert animation is not None  # it is a movie
    key = animation.moves[0].key
    name = NAMES.get(key, key)
    return [f"{name} = {values_at(animation, k)[key]:.4g}" for k in range(animation.frames)]


def _movie(
    stage: Stage, stem: str, title: str, moments: Sequence[str], frames: Sequence[Scene], request: AtlasRequest,
    tell: Callable[[str, float | None], None],
) -> None:  # fmt: skip
    pixels: list[Bytes] = []
    notes: dict[str, str] = {}
    for k, still in enumerate(frames):
        tell(f"movie {title}", k / len(frames))
        sized = _sized(still, request.movie_size, request.samples)
        picture: Picture = view_through(sized, compiled=True)
        pixels.append(labelled(pixels_of(picture), f"{title.split(':')[0]}   {moments[k]}"))
        notes = facts(picture)
    animate(stage.path(f"{stem}.webp"), iter(pixels), 25.0, notes)


NAMES = {
    "object.knight.at.2": "z", "sheet.set.law.euler.0": "phi", "sheet.set.law.euler.1": "theta",
    "sheet.set.law.euler.2": "psi",
}  # fmt: skip
"""What the text calls a key."""


def _first_figure(stage: Stage, request: AtlasRequest, load: Callable[[str], Scene]) -> None:
    """Figure 1: the section with rays as SVG, and the sheet itself as a picture."""
    from clacad.render.section import section_svg
    from clacad.render.solid import solid_picture

    section = load("fig1a")
    stage.path("fig1a.svg").write_text(section_svg(section.design()), encoding="utf-8")
    scene = load("fig1b")
    image = solid_picture(_sized(scene, request.size, max(4, request.samples // 4)))
    text = "F1b  the sheet of Fig. 8 at reduced separation, drawn as tinted solids"
    save(
        labelled(image, text),
        stage.path("fig1b.png"),
        {"Title": scene.name, "clacad:design": scene.design().name},
    )


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


def _record(findings: dict[str, tuple[Finding, ...]]) -> dict[str, Any]:
    passed = all(one.passed for found in findings.values() for one in found)
    return {
        "passed": passed,
        "rows": {row: [one.to_dict() for one in found] for row, found in findings.items()},
    }


# -- the page ----------------------------------------------------------------------------------

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 76em; margin: 2em auto; padding: 0 1em; color: #222 }
figure { display: inline-block; margin: 0 1em 1em 0; vertical-align: top } img { max-width: 100%; border: 1px solid #ccc }
figcaption { font-size: 90%; color: #555 } table { border-collapse: collapse; margin: 0 0 2em }
td, th { padding: .15em .8em; text-align: right; border-bottom: 1px solid #ddd } td:first-child, th:first-child { text-align: left }
.fail { color: #b00; font-weight: bold }
@media (prefers-color-scheme: dark) { body { background: #181a1c; color: #ddd } td, th { border-color: #444 } }
"""


def _page(
    figures: Sequence[Figure], findings: dict[str, tuple[Finding, ...]], movies: Sequence[tuple[str, str]],
    names: Sequence[str],
) -> str:  # fmt: skip
    parts = [f"<p>{html.escape(NOTE)}</p>"]
    if "fig1a.svg" in names:
        parts.append(
            "<h2>F1 &ndash; Fig. 1: geometry</h2>"
            + _img("fig1a.svg", "one telescopelet, to scale, rays traced")
        )
        parts.append(_img("fig1b.png", "both arrays, drawn as tinted solids (no refraction)"))
    for figure in figures:
        parts.append(
            f"<h2>{figure.row} &ndash; {html.escape(figure.title)}</h2><p>{html.escape(figure.says)}</p>"
        )
        parts += [_img(f"{stem}.png", label) for stem, label in figure.scenes]
        parts += [
            _img(f"{stem}.webp", title)
            for stem, title in movies
            if title.startswith(figure.title.split(":")[0])
        ]
        if figure.row in findings:
            parts.append(_table(findings[figure.row]))
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>Views through the sheet</title>'
        f"<style>{STYLE}</style></head>\n<body><h1>Views through generalized confocal lenslet arrays</h1>\n"
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def _img(name: str, label: str) -> str:
    text = html.escape(label)
    return f'<figure><img src="{html.escape(name)}" alt="{text}"><figcaption>{text}</figcaption></figure>'


def _table(findings: Sequence[Finding]) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(one.what)}</td><td>{one.measured:.4g}</td><td>{one.expected:.4g}</td>"
        f"<td>{one.tolerance:.2g}</td><td{'' if one.passed else ' class=fail'}>{'pass' if one.passed else 'FAIL'}</td></tr>"
        for one in findings
    )
    head = "<tr><th>measured in the picture</th><th>measured</th><th>formula</th><th>tolerance</th><th></th></tr>"
    return f"<table>{head}{rows}</table>"


def small(pixels: Bytes, side: int) -> Bytes:
    """A picture reduced to a given width by averaging, for pages."""
    from PIL import Image

    height = max(1, round(side * pixels.shape[0] / pixels.shape[1]))
    return np.asarray(Image.fromarray(pixels).resize((side, height), Image.Resampling.BOX))
