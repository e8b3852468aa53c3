"""Binary STL: facets as a stream, all bodies in one file or one file a body."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from clacad.exporting.formats.format import (
    BASE,
    STREAM_MEMORY,
    ChosenMesh,
    FileKind,
    Forecast,
    Format,
    about_number,
    mesh_facts,
    of_own_cells,
    stream_bytes,
)
from clacad.exporting.roles import IN_SHEET

if TYPE_CHECKING:
    from clacad.exporting.formats.format import RoughSheet
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.exporting.tessellations import Meshes
    from clacad.sheet.window import Window

WORD, PARTS = "stl", "stl-parts"

KIND = "stl-binary"
"""Word of the files in manifests."""

PER_FACET = 3.5e-7
"""Seconds to stream a facet to a file and back."""


def _write(job: Job) -> list[FileRecord]:
    return [write_one(job, f"{job.stem}.stl", job.window)]


def _write_parts(job: Job) -> list[FileRecord]:
    return [
        write_one(job, f"{job.stem}.{body.name}.stl", replace(job.window, bodies=(body,)))
        for body in job.window.bodies
    ]


def write_one(job: Job, name: str, window: Window) -> FileRecord:
    """Write some bodies of the sheet as one file, read it back once, compare, and hash while reading."""
    from clacad.formats.mesh.compare_triangles import compare_mesh
    from clacad.formats.mesh.stl import read_stl, write_stl
    from clacad.sheet.volume_and_extent import volume_sum
    from clacad.storage.reading import Overheard

    path = job.stage.path(name)
    names = [body.name for body in window.bodies]
    mesh = job.tessellation.mesh
    bodies = [part for part, body in zip(mesh.bodies, job.window.bodies, strict=True) if body.name in names]
    job.progress(f"write {name}", 0.0)
    write_stl(bodies, path, job.scale, f"{job.stem} {' '.join(names)}")
    job.progress(f"read back {name}", 0.5)
    heard = Overheard(path)
    promise = job.tessellation.promise(instanced=False, single=True, bodies=names)
    read = read_stl(path, heard, checked=True)
    verdict = compare_mesh(read, window, promise, name, volume_sum(job.integrals, names))
    facts = mesh_facts(job, promise.facets, verdict.volume, verdict.volume_exact, names)
    facts |= {"mode": "fused", "triangles": promise.facets, "float": "f32"}
    return job.record(path, KIND, bodies=names, facts=facts, checks=verdict.checks, heard=heard)


# -- cost ------------------------------------------------------------------------------------------


def seconds(facets: int) -> float:
    """Seconds to stream facets to a file and back."""
    return BASE + PER_FACET * facets


def stream_row(word: str, facets: int, files: int, quads: int | None, exact: bool) -> Forecast:
    """Forecast binary STL files."""
    size = stream_bytes(facets, files)
    return Forecast(word, size, exact, facets, quads, seconds(facets), STREAM_MEMORY)


def _row(meshes: Meshes, word: str, files: int, quads: int) -> Forecast:
    row = stream_row(word, meshes.facets(quads), files, quads, exact=meshes.window.uniform)
    return of_own_cells(meshes.window, row, quads)


def _forecast(meshes: Meshes, quads: int, _asked: Request) -> Forecast:
    return _row(meshes, WORD, 1, quads)


def _forecast_parts(meshes: Meshes, quads: int, _asked: Request) -> Forecast:
    return _row(meshes, PARTS, len(meshes.window.bodies), quads)


def rough_seconds(sheet: RoughSheet, quads: int, _asked: Request) -> float:
    """Seconds from the design's numbers."""
    return seconds(sheet.facets(quads) * sheet.cells)


def _at_a_glance(_window: Window, sheet: RoughSheet, chosen: ChosenMesh | None) -> Forecast:
    """Forecast from the sheet's numbers, on the coarsest grid without a chosen one."""
    from clacad.exporting.limits import QUADS

    quads = QUADS[-1] if chosen is None else chosen.quads
    facets = sheet.facets(quads) * sheet.cells if chosen is None else chosen.facets
    return stream_row(WORD, about_number(facets), 1, quads, exact=False)


FORMATS = (
    Format(
        WORD,
        "stream",
        "facets of all bodies in one binary STL file",
        _write,
        _forecast,
        rough_seconds,
        at_a_glance=_at_a_glance,
        stored=(IN_SHEET,),
    ),
    Format(
        PARTS,
        "stream",
        "facets, one binary STL file a body",
        _write_parts,
        _forecast_parts,
        rough_seconds,
        whole_sheet=False,
        stored=(IN_SHEET,),
    ),
)

FILES = (
    FileKind(WORD, "mesh", (".stl",)),
    FileKind(KIND, "mesh"),
    FileKind("stl-ascii", "mesh", bytes_a_facet=260.0),
)
