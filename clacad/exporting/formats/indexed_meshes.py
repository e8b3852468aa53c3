"""3MF, PLY, GLB: facets of shared vertices; 3MF and GLB store one cell of a uniform sheet and its places.

Binary STL: facets as a stream, all bodies in one file or one file a body.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.units import millimetres
from clacad.exporting.formats.format import (
    BASE,
    SCALES,
    STREAM_MEMORY,
    ChosenMesh,
    FileKind,
    Forecast,
    Format,
    RoughSheet,
    about_number,
    mesh_facts,
    of_own_cells,
    stream_bytes,
)
from clacad.exporting.roles import DOUBLE_NORMALS, DOUBLES, IN_CELL, IN_SHEET, SINGLE_NORMALS

if TYPE_CHECKING:
    from clacad.exporting.formats.format import RoughSheet
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.exporting.tessellations import Meshes
    from clacad.formats.placements import Piece, Places
    from clacad.sheet.window import Window


STL, STL_PARTS = "stl", "stl-parts"

STL_BINARY = "stl-binary"
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
    return job.record(path, STL_BINARY, bodies=names, facts=facts, checks=verdict.checks, heard=heard)


# -- cost ------------------------------------------------------------------------------------------


def seconds(facets: int) -> float:
    """Seconds to stream facets to a file and back."""
    return BASE + PER_FACET * facets


def stream_row(word: str, facets: int, files: int, quads: int | None, exact: bool) -> Forecast:
    """Forecast binary STL files."""
    size = stream_bytes(facets, files)
    return Forecast(word, size, exact, facets, quads, seconds(facets), STREAM_MEMORY)


def _stream_row(meshes: Meshes, word: str, files: int, quads: int) -> Forecast:
    row = stream_row(word, meshes.facets(quads), files, quads, exact=meshes.window.uniform)
    return of_own_cells(meshes.window, row, quads)


def _forecast(meshes: Meshes, quads: int, _asked: Request) -> Forecast:
    return _stream_row(meshes, STL, 1, quads)


def _forecast_parts(meshes: Meshes, quads: int, _asked: Request) -> Forecast:
    return _stream_row(meshes, STL_PARTS, len(meshes.window.bodies), quads)


def rough_seconds(sheet: RoughSheet, quads: int, _asked: Request) -> float:
    """Seconds from the design's numbers."""
    return seconds(sheet.facets(quads) * sheet.cells)


def _stl_at_a_glance(_window: Window, sheet: RoughSheet, chosen: ChosenMesh | None) -> Forecast:
    """Forecast from the sheet's numbers, on the coarsest grid without a chosen one."""
    from clacad.exporting.limits import QUADS

    quads = QUADS[-1] if chosen is None else chosen.quads
    facets = sheet.facets(quads) * sheet.cells if chosen is None else chosen.facets
    return stream_row(STL, about_number(facets), 1, quads, exact=False)


THREEMF, PLY, GLB = "3mf", "ply", "glb"

SAMPLE = 6_000
"""Number of facets or places whose text is generated; the rest is assumed to be similar."""

ROUGH_GRID = 8
"""Quads per cell side when there is no design to choose them."""

FEW, ROUGH_PLACES, ROW_BYTES = 10_000, (1.0, 3.2), 12.0
"""3MF: cell count of a small sheet; deflated bytes per place in a small and a large one; bytes per row of
places."""

PLACE_IN_ARRAY = 12
"""Bytes of a place in a GLB file whose cells are one node: three numbers of single precision."""

PER_FACET_AND_PLACE = {THREEMF: (4.5e-6, 6.0e-6), GLB: (4.0e-6, 1.3e-5)}
"""Seconds for a facet of the repeated cell, and for a place."""

HELD = 300
"""Bytes of memory for a facet of a mesh that is held."""

STREAMED = {THREEMF: (3.0e-6, 50), GLB: (9.0e-7, 10), PLY: (9.0e-7, 10)}
"""Seconds and bytes of memory for a facet that is written as it is made."""

Writer = Callable[["Sequence[Piece]", Path, float, str], None]


# -- writing ---------------------------------------------------------------------------------------


def _write_threemf(job: Job) -> list[FileRecord]:
    """Write one 3MF file; its vertices have no normals."""
    return [threemf_record(job)]


def threemf_record(job: Job, plain: bool = False) -> FileRecord:
    """Write one 3MF file; `plain`: no cell is repeated."""
    from clacad.formats.mesh.threemf import write_threemf

    repeated = not plain and _repeated(job)
    return _record(job, THREEMF, write_threemf, False, repeated, normals=False)


def _write_ply(job: Job) -> list[FileRecord]:
    from clacad.formats.mesh.ply import write_ply

    return [_record(job, PLY, write_ply, False, False)]


def _write_glb(job: Job) -> list[FileRecord]:
    """Write one GLB file, in metres and single precision."""
    from clacad.formats.mesh.glb import write_glb

    writer = partial(write_glb, gpu_instancing=job.request.gpu_instancing)
    return [_record(job, GLB, writer, True, _repeated(job), unit="m")]


def _repeated(job: Job) -> bool:
    from clacad.exporting.tessellations import instanceable

    return instanceable(job.window) and not job.request.fused


def _record(
    job: Job, word: str, write: Writer, single: bool, repeated: bool, normals: bool = True, unit: str = "mm"
) -> FileRecord:
    """Write a file, read it back and compare; `repeated`: it stores one cell; `single`: single precision."""
    from clacad.formats.mesh.compare_triangles import compare_mesh
    from clacad.formats.mesh.readers import read_mesh
    from clacad.sheet.volume_and_extent import volume_sum

    name = f"{job.stem}.{word}"
    path = job.stage.path(name)
    job.progress(f"write {name}", 0.0)
    write(job.tessellation.pieces(repeated, normals=normals), path, job.scale, job.stem)
    job.progress(f"read back {name}", 0.5)
    promise = job.tessellation.promise(instanced=repeated, single=single)
    verdict = compare_mesh(read_mesh(path), job.window, promise, name, volume_sum(job.integrals, job.bodies))
    facts = mesh_facts(job, promise.facets, verdict.volume, verdict.volume_exact, job.bodies, unit, repeated)
    if repeated:  # neighbouring cells share no vertex, and nothing touches within one
        facts = {key: value for key, value in facts.items() if not key.startswith("saddle")} | {"saddles": 0}
        bevel = job.request.saddle_bevel * job.scale * SCALES[unit]
        facts |= {"saddle_policy": "bevel", "saddle_bevel": bevel} if promise.bevel else {}
        facts["triangles_stored"] = job.tessellation.cell.facet_count
    facts |= {"mode": "instanced" if repeated else "fused", "float": "f32" if single else "f64"}
    facts |= {
        "objects": len(job.window.bodies),
        "instances": job.window.lattice.cell_count if repeated else None,
    }
    return job.record(path, word, unit=unit, facts=facts, checks=verdict.checks)


# -- cost ------------------------------------------------------------------------------------------


def _seconds(word: str, held: int, places: int) -> float:
    """Seconds for shared vertices, exact normals and the places of repeated cells."""
    if places == 0:
        return BASE + STREAMED[word][0] * held
    each, place = PER_FACET_AND_PLACE[word]
    return BASE + 0.01 + each * held + place * places


def _row(
    word: str, size: int, held: int, facets: int, places: int, quads: int, in_memory: bool = False
) -> Forecast:
    """Forecast a file from its bytes, the facets that it stores and the places that are read back.

    in_memory : Whether all facets are held while they are written though none is repeated.
    """
    memory = int((HELD if places or in_memory else STREAMED[word][1]) * held + 400 * places)
    needed = (memory // 2 + 100_000_000, 2 * memory + 200_000_000)
    modelled = _seconds(word, held, places)
    return Forecast(word, size, False, facets, quads, modelled, needed, stored=held)


def _vertices(held: int, quads: int) -> float:
    """Vertices of welded facets: half of one a facet, and more where walls and rims split them."""
    return held * (0.5 + 1.9 / max(quads, 2))


def _forecast_threemf(meshes: Meshes, quads: int, _asked: Request) -> Forecast:
    return of_own_cells(meshes.window, threemf_row(meshes, quads), quads)


def threemf_row(meshes: Meshes, quads: int) -> Forecast:
    """Forecast a 3MF file, without the cost of a non-uniform sheet."""
    window, repeated = meshes.window, meshes.repeatable
    held = meshes.at(quads).cell.facet_count if repeated else meshes.facets(quads)
    listed = _listed(RoughSheet.of_window(window)) if repeated else 0
    facets = held * window.lattice.cell_count if repeated else held
    places = _threemf_place_bytes(window) if repeated else 0
    size = _threemf_bytes(meshes, quads) + places
    row = _row(THREEMF, size, held, facets, listed, quads, in_memory=window.uniform)
    return replace(row, places=places)


def _forecast_ply(meshes: Meshes, quads: int, _asked: Request) -> Forecast:
    from clacad.formats.mesh.ply import ply_bytes

    held = meshes.facets(quads)
    size = ply_bytes(int(_vertices(held, quads)), held, header=300)
    return of_own_cells(meshes.window, _row(PLY, size, held, held, 0, quads), quads)


def _forecast_glb(meshes: Meshes, quads: int, asked: Request) -> Forecast:
    """Forecast a GLB file, whose cells are one node each or one node a body."""
    window, repeated = meshes.window, meshes.repeatable
    held = meshes.at(quads).cell.facet_count if repeated else meshes.facets(quads)
    facets = held * window.lattice.cell_count if repeated else held
    places = window.lattice.cell_count * len(window.bodies) if repeated else 0
    listed = len(window.bodies) if places and asked.gpu_instancing else places
    nodes = int((PLACE_IN_ARRAY if asked.gpu_instancing else _node_bytes(window)) * places)
    size = int(24 * _vertices(held, quads) + 12 * held + nodes + 2500)
    row = replace(_row(GLB, size, held, facets, listed, quads), places=nodes)
    return of_own_cells(window, row, quads)


def _listed(sheet: RoughSheet) -> int:
    """Places that a 3MF file lists and its reader keeps: all, or of a large sheet its rows and one row."""
    from clacad.formats.placements import FLAT_LIMIT

    in_rows = sheet.repeats and sheet.cells > FLAT_LIMIT
    return sheet.bodies * (sum(sheet.count) if in_rows else sheet.cells)


def _rough_bytes(sheet: RoughSheet, quads: int) -> int:
    """Bytes of a 3MF file, within 40 %."""
    from clacad.formats.placements import FLAT_LIMIT

    if not sheet.repeats:
        return 1000 + 8 * sheet.facets(quads) * sheet.cells
    flat = sheet.cells <= FLAT_LIMIT
    places = ROUGH_PLACES[sheet.cells > FEW] * sheet.cells if flat else ROW_BYTES * sum(sheet.count)
    return int(1000 + 16 * sheet.piece(quads) + sheet.bodies * places)


def _rough(word: str, sheet: RoughSheet, quads: int, asked: Request) -> float:
    """Seconds of a 3MF or GLB file from the design's numbers."""
    if asked.fused:
        return rough_welded(sheet, quads, asked)
    return _seconds(
        word, sheet.facets(quads), _listed(sheet) if word == THREEMF else sheet.cells * sheet.bodies
    )


def _rough_ply(sheet: RoughSheet, quads: int, _asked: Request) -> float:
    return _seconds(PLY, sheet.facets(quads) * sheet.cells, 0)


def rough_welded(sheet: RoughSheet, quads: int, _asked: Request) -> float:
    """Seconds of a 3MF or GLB file that repeats no cell, from the design's numbers."""
    return _seconds(GLB, sheet.facets(quads) * sheet.cells, 0)


def _threemf_at_a_glance(_window: Window, sheet: RoughSheet, chosen: ChosenMesh | None) -> Forecast:
    """Forecast a 3MF file from the sheet's numbers, on a coarse grid without a chosen one."""
    times, places = (sheet.cells, _listed(sheet)) if sheet.repeats else (1, 0)
    if chosen is None:
        held = sheet.piece(ROUGH_GRID) if sheet.repeats else sheet.facets(ROUGH_GRID) * sheet.cells
        chosen = ChosenMesh(ROUGH_GRID, held, _rough_bytes(sheet, ROUGH_GRID))
    size, held, facets = (about_number(n) for n in (chosen.bytes, chosen.facets, chosen.facets * times))
    return _row(THREEMF, size, held, facets, places, chosen.quads)


def _threemf_bytes(meshes: Meshes, quads: int) -> int:
    """Size of the 3MF file without places: the text of the first facets of each body, deflated."""
    import zlib

    from clacad.exporting.tessellations import weld
    from clacad.formats.mesh import threemf
    from clacad.mesh.body_mesh import first_triangles

    mesh = meshes.at(quads).cell if meshes.repeatable else meshes.at(quads).mesh
    total = 950.0
    packed = zlib.compressobj(6)
    for body, part in zip(meshes.window.bodies, mesh.bodies, strict=True):
        corners = first_triangles(part, SAMPLE)
        if not len(corners):
            continue
        piece = weld(body, corners)
        text = b"".join(threemf.joined_lines(threemf.mesh_lines(piece, 1, millimetres(meshes.window.unit))))
        # one stream for all bodies, as in the file: a second body similar to the first compresses well
        size = len(packed.compress(text)) + len(packed.flush(zlib.Z_SYNC_FLUSH))
        total += size * part.facets_about / len(corners)
    return int(total)


def _threemf_place_bytes(window: Window) -> int:
    """Bytes of a 3MF file for the positions of the repeated cells of each body."""
    from clacad.formats.placements import Places

    arrays = (body.arrays[0] for body in window.bodies)
    return int(
        sum(
            _places_bytes(Places(window.lattice, window.shifts[array]), millimetres(window.unit))
            for array in arrays
        )
    )


def _places_bytes(places: Places, scale: float) -> float:
    import numpy as np

    from clacad.formats.mesh import threemf
    from clacad.formats.placements import FLAT_LIMIT

    if places.count > FLAT_LIMIT:
        offsets, standing = places.rows()
        lines = sum(len(row) for row in offsets) + len(standing)
        return ROW_BYTES * lines
    sample = places.lattice.cells()[:SAMPLE] if places.count <= SAMPLE else places.lattice.row(0)
    centres = (places.lattice.centres(sample) + np.asarray(places.shift)) * scale
    text = (threemf.component_text(2, x, y) for x, y in centres.tolist())
    return _deflated(text) * places.count / max(1, len(sample))


def _deflated(lines: Iterable[str]) -> int:
    import zlib

    return len(zlib.compress("".join(lines).encode(), 6))


def _node_bytes(window: Window) -> float:
    """Bytes of one node of a GLB file, from the cells of one row."""
    row = window.lattice.row(window.lattice.count[1] // 2)
    centres = (window.lattice.centres(row) * millimetres(window.unit)).tolist()
    nodes = [f'{{"mesh":0,"translation":[{x!r},{y!r},0.0]}},{window.lattice.cell_count},' for x, y in centres]
    return sum(map(len, nodes)) / max(1, len(nodes))


# -- limits ----------------------------------------------------------------------------------------


def _refuse_places(window: Window, _asked: Request) -> None:
    """Refuse (LimitRefused) a 3MF file that lists more places than its reader takes."""
    from clacad.exporting.limits import refuse_many_places
    from clacad.formats.mesh.threemf import MOST_PLACES

    listed = len(window.bodies) * (window.lattice.cell_count + max(500, window.lattice.count[1]))
    refuse_many_places(window, THREEMF, listed, "places", MOST_PLACES, "--format step")


def _refuse_nodes(window: Window, asked: Request) -> None:
    """Refuse (LimitRefused) a GLB file that has more nodes than its reader takes."""
    from clacad.exporting.limits import refuse_many_places
    from clacad.formats.mesh.glb import MOST_NODES

    if not asked.gpu_instancing:
        listed = len(window.bodies) * (window.lattice.cell_count + 1) + 1
        refuse_many_places(window, GLB, listed, "nodes", MOST_NODES, "--gpu-instancing, --format step")


_BOTH: dict[str, Any] = {"repeats": True, "fusable": True}

FORMATS = (
    Format(
        STL,
        "stream",
        "facets of all bodies in one binary STL file",
        _write,
        _forecast,
        rough_seconds,
        at_a_glance=_stl_at_a_glance,
        stored=(IN_SHEET,),
    ),
    Format(
        STL_PARTS,
        "stream",
        "facets, one binary STL file a body",
        _write_parts,
        _forecast_parts,
        rough_seconds,
        whole_sheet=False,
        stored=(IN_SHEET,),
    ),
    Format(
        THREEMF,
        "welded",
        "facets with units, for printing; one cell and its places where the sheet allows it",
        _write_threemf,
        _forecast_threemf,
        partial(_rough, THREEMF),
        refuse_places=_refuse_places,
        at_a_glance=_threemf_at_a_glance,
        stored=(DOUBLES,),
        **_BOTH,
    ),
    Format(
        PLY,
        "welded",
        "facets with exact normals, in double precision",
        _write_ply,
        _forecast_ply,
        _rough_ply,
        stored=(DOUBLES, DOUBLE_NORMALS),
    ),
    Format(
        GLB,
        "welded",
        "facets with exact normals in metres, for viewers; one cell and its places where the sheet allows it",
        _write_glb,
        _forecast_glb,
        partial(_rough, GLB),
        refuse_places=_refuse_nodes,
        stored=(IN_CELL, SINGLE_NORMALS),
        **_BOTH,
    ),
)

FILES = (
    FileKind(STL, "mesh", (".stl",)),
    FileKind(STL_BINARY, "mesh"),
    FileKind("stl-ascii", "mesh", bytes_a_facet=260.0),
    FileKind(THREEMF, "mesh", (".3mf",), 10.0, states_unit=True),
    FileKind(PLY, "mesh", (".ply",), 43.0),
    FileKind(GLB, "mesh", (".glb",), 25.0, states_unit=True),
    FileKind("obj", "mesh", (".obj",), 90.0, like=PLY),
)
"""OBJ files are read and not written."""
