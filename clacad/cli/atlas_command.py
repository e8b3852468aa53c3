"""`clacad atlas`: every figure and movie of the paper, with its numbers measured."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.cli.command import Command, declared, option, required
from clacad.cli.console import Console, table
from clacad.cli.option_values import BadOption, words_of

if TYPE_CHECKING:
    from clacad.paper.make_atlas import Atlas


def _rows(name: str, text: str) -> tuple[str, ...]:
    """Read "F1,F2" as names of rows.

    Raises
    ------
    BadOption
    """
    rows = words_of(name, text.upper())
    if not rows:
        raise BadOption(f"{name} {text}: it names no row; give one, such as F3, or leave it out for all")
    return rows


@dataclass(frozen=True, kw_only=True)
class MakeAtlas:
    """Every figure and movie of the paper, each with its numbers measured in the picture."""

    out: Path = required("-o, --out DIR", "Folder to write to.")
    scenes: Path | None = option(
        "--scenes DIR", "Folder of the scene files; default those that come with clacad."
    )
    rows: tuple[str, ...] = option("--rows F1,F2", "Only these; default all.", (), read=_rows)
    size: int = option("--size N", "Pixels across a figure.", 440, least=16, most=8192)
    samples: int = option("--samples N", "Rays a pixel.", 16, least=1, most=4096)
    movie_size: int = option("--movie-size N", "Pixels across a movie.", 220, least=16, most=4096)
    movies: bool = option("--movies/--no-movies", "Make the movies.", True)
    measure: bool = option("--measure/--no-measure", "Measure the rows in rendered pictures.", True)
    overwrite: bool = declared("overwrite")


def run(request: MakeAtlas, console: Console) -> int:
    """Make the paper's figures and movies, measure their rows; exit 1 when one fails."""
    from clacad.design.starter_designs import shipped_designs
    from clacad.paper.make_atlas import ATLAS, AtlasRequest, atlas_seconds, make_atlas, prepare

    scenes = shipped_designs() / "scenes" if request.scenes is None else request.scenes
    if not scenes.is_dir():
        raise BadOption(
            f"{scenes}: there is no such folder; give the folder of the scene files with --scenes"
        )
    job = prepare(
        AtlasRequest(
            scenes,
            request.out,
            request.size,
            request.samples,
            request.movies,
            request.movie_size,
            request.rows,
            request.measure,
            request.overwrite,
        )
    )
    with console.progress() as progress, console.forecast(ATLAS, atlas_seconds(job)):
        atlas = make_atlas(job, progress)
    console.show(lambda: _document(atlas), lambda: _text(atlas))
    return 0 if atlas.passed else 1


def _document(atlas: Atlas) -> dict[str, Any]:
    rows = {row: [one.to_dict() for one in found] for row, found in atlas.findings.items()}
    return {"folder": str(atlas.folder), "files": list(atlas.files), "passed": atlas.passed, "rows": rows}


def _text(atlas: Atlas) -> str:
    """Every measured number next to its formula, and how many miss their tolerance."""
    findings = [(row, one) for row, found in atlas.findings.items() for one in found]
    lines = [
        (row, "pass" if one.passed else "FAIL", f"{one.measured:.4g}", f"{one.expected:.4g}", one.what)
        for row, one in findings
    ]
    rows = table([("row", "", "measured", "formula", ""), *lines]) if lines else ""
    failed = sum(not one.passed for _, one in findings)
    verdict = f"{len(findings)} numbers measured, {failed} outside their tolerance"
    return f"{rows}\nwrote {atlas.folder / 'index.html'}: {verdict}"


COMMANDS = (Command("atlas", "look", MakeAtlas, run),)
