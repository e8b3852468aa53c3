"""Meshes of the bodies with name and arrow engraved in the border: STL, one file a body, and 3MF."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from clacad.exporting.formats import indexed_meshes, stl
from clacad.exporting.formats.file_kind import FileKind
from clacad.exporting.formats.format import Forecast, Format
from clacad.exporting.formats.parts import require_marks, solid_seconds
from clacad.exporting.roles import AS_PLAIN

if TYPE_CHECKING:
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.exporting.tessellations import Meshes

MARKED_STL, MARKED_3MF = "marked-stl", "marked-3mf"

LETTER_POINTS = 30
"""Approximate number of points of the outline of a letter."""


def _write_stl(job: Job) -> list[FileRecord]:
    from clacad.exporting.fixtures.engraving import engraved, with_marks

    made = engraved(job)
    parts = [
        (f"{made.stem}.{body.name}.marked.stl", replace(made.window, bodies=(body,)))
        for body in made.window.bodies
    ]
    return [with_marks(stl.write_one(made, name, window), made) for name, window in parts]


def _write_threemf(job: Job) -> list[FileRecord]:
    """Write one 3MF file, in which no cell is repeated."""
    from clacad.exporting.fixtures.engraving import engraved, with_marks

    made = replace(engraved(job), stem=f"{job.stem}.marked")
    return [with_marks(indexed_meshes.threemf_record(made, plain=True), made)]


def _forecast_stl(meshes: Meshes, quads: int, _asked: Request) -> Forecast:
    files = len(meshes.window.bodies)
    return _with_letters(meshes, stl.stream_row(MARKED_STL, meshes.facets(quads), files, quads, exact=False))


def _forecast_threemf(meshes: Meshes, quads: int, _asked: Request) -> Forecast:
    return _with_letters(meshes, replace(indexed_meshes.threemf_row(meshes, quads), format=MARKED_3MF))


def _with_letters(meshes: Meshes, plain: Forecast) -> Forecast:
    """Forecast of a mesh with letters: four facets per outline point, and OCC's start."""
    from clacad.solid.marks import mark_text

    window = meshes.window
    texts = [mark_text(f"{window.name} {body.name}").replace(" ", "") for body in window.bodies]
    letters = 4 * LETTER_POINTS * sum(1 + len(text) for text in texts)
    facets = plain.facets or 1
    share = (facets + letters) / facets
    seconds = plain.modelled * share + solid_seconds(0)
    return replace(
        plain, bytes=int(plain.bytes * share), facets=facets + letters, modelled=seconds, stored=None
    )


FORMATS = (
    Format(
        MARKED_STL,
        "stream",
        "facets with name and arrow in the border, one binary STL file a body",
        _write_stl,
        _forecast_stl,
        stl.rough_seconds,
        require_marks,
        whole_sheet=False,
        stored=(AS_PLAIN,),
    ),
    Format(
        MARKED_3MF,
        "welded",
        "facets with name and arrow in the border, 3MF",
        _write_threemf,
        _forecast_threemf,
        indexed_meshes.rough_welded,
        require_marks,
        whole_sheet=False,
        stored=(AS_PLAIN,),
    ),
)

FILES: tuple[FileKind, ...] = ()
