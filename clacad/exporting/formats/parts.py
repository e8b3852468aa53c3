"""Parts modelled one by one: bodies as BREP, baffle (STL), frame, pins, coupon and marked bodies (STEP);
meshes of the bodies with name and arrow engraved in the border (STL, one file a body, and 3MF).

The modelling runs in the worker because OCC can crash; the parent receives numbers only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.exporting.formats import indexed_meshes, step
from clacad.exporting.formats.format import FileKind, Forecast, Format
from clacad.exporting.roles import AS_PLAIN, EXACT_FACES
from clacad.storage.errors import FileDisagrees, LimitRefused

if TYPE_CHECKING:
    from clacad.exporting.fixtures import BaffleMesh
    from clacad.exporting.formats.format import RoughSheet
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.exporting.tessellations import Meshes
    from clacad.sheet.window import Window
    from clacad.storage.worker import Worker

BREP, BAFFLE, FRAME, PINS, COUPON, MARKED = "brep", "baffle", "frame", "pins", "coupon", "marked"
MARKED_STL, MARKED_3MF = "marked-stl", "marked-3mf"

LETTER_POINTS = 30
"""Approximate number of points of the outline of a letter."""


SECONDS = 1800.0
VOLUME_LIMIT = 1e-6
"""Relative difference allowed between a modelled part and what is read back from its file."""
MOST_BREP_CELLS = 2500
"""Largest number of cells for BREP: above it, OCC's solids take gigabytes."""


def _write_baffle(job: Job) -> list[FileRecord]:
    """Write each honeycomb as binary STL and compare it with its closed-form volume."""
    from clacad.exporting.fixtures import baffle_meshes

    return [_baffle_record(job, baffle) for baffle in baffle_meshes(job.window)]


def _baffle_record(job: Job, baffle: BaffleMesh) -> FileRecord:
    from clacad.exporting.fixtures.baffle import WALLS
    from clacad.formats.mesh.measure import measure
    from clacad.formats.mesh.readers import read_mesh
    from clacad.formats.mesh.stl import write_stl

    path = job.stage.path(f"{job.stem}.{baffle.name}.stl")
    job.progress(f"write {path.name}", 0.0)
    write_stl([baffle], path, job.scale, f"{job.stem} {baffle.name}")
    found = measure(read_mesh(path).chunks())
    exact = baffle.volume() * job.scale**3
    if found.facets != baffle.facet_count or not found.closed or abs(found.volume / exact - 1.0) > WALLS:
        raise FileDisagrees(
            f"{path.name}: {found.facets} facets enclosing {found.volume:.9g} mm^3; the honeycomb has "
            f"{baffle.facet_count} and {exact:.9g} mm^3"
        )
    facts = {
        "triangles": found.facets,
        "volume": found.volume,
        "volume_exact": exact,
        "float": "f32",
        "mode": "fused",
    }
    return job.record(
        path, indexed_meshes.STL_BINARY, bodies=[baffle.name], facts=facts, checks=("closed", "volume")
    )


def refuse_many(window: Window, what: str) -> None:
    """Refuse solids of more cells than OCC takes. Raises LimitRefused."""
    cells = window.lattice.cell_count
    if cells > MOST_BREP_CELLS:
        raise LimitRefused(
            f"{what} of {cells:,} cells: the kernel takes up to {MOST_BREP_CELLS:,}\n"
            "  use --cells 50x50, or --format step"
        )


def _modelled(what: str, job: Job) -> list[FileRecord]:
    """Model parts in the worker; one record per file, each compared with its own exact volume."""
    job.progress(f"model {what}", 0.0)
    folder = job.stage.path(f"{job.stem}.{what}.step").parent
    made: Mapping[str, Any] = job.worker.run(
        "clacad.exporting.formats.parts:model",
        what,
        job.window,
        str(folder),
        job.stem,
        timeout=SECONDS,
        progress=job.progress,
    )
    records = []
    for name, facts in made.items():
        path = job.stage.path(name)
        apart = abs(facts["volume"] / facts["volume_exact"] - 1.0)
        if not facts.pop("valid") or not apart <= VOLUME_LIMIT:
            raise FileDisagrees(
                f"{name}: read back with {facts['volume']:.9g} mm^3, modelled with"
                f" {facts['volume_exact']:.9g} mm^3"
            )
        kind = BREP if what == BREP else step.WORD
        records.append(
            job.record(path, kind, bodies=facts.pop("bodies"), facts=facts, checks=("closed", "volume"))
        )
    return records


def model(what: str, window: Window, folder: str, stem: str) -> dict[str, dict[str, Any]]:
    """Build, write and read back parts in the worker; return file name → facts."""
    parts = _parts(what, window)
    if what == BREP:
        return {f"{stem}.brep": _brep(list(parts.values()), list(parts), Path(folder) / f"{stem}.brep")}
    return {
        f"{stem}.{name}.step": _step(part, name, Path(folder) / f"{stem}.{name}.step")
        for name, part in parts.items()
    }


def _parts(what: str, window: Window) -> dict[str, Any]:
    """Parts of a fixture, build123d by name, mm."""
    if what == FRAME:
        from clacad.exporting.fixtures import frame_solids, frame_spec

        return frame_solids(frame_spec(window, window.land.border), window.name)
    if what == PINS:
        from clacad.exporting.fixtures import pin_solids, pin_spec

        return {PINS: pin_solids(pin_spec(window))}
    if what == COUPON:
        from clacad.exporting.fixtures import coupon_solid

        return {COUPON: coupon_solid(window)}
    if what == MARKED:
        from clacad.exporting.fixtures import marked_solids

        return {f"{name}.{MARKED}": part for name, part in marked_solids(window, window.name).items()}
    from clacad.solid.solids import solids

    return {body.name: part for body, part in zip(window.bodies, solids(window), strict=True)}


def _step(part: Any, name: str, path: Path) -> dict[str, Any]:
    from build123d import Color, export_step, import_step

    part.label = name
    part.color = (
        Color(0.62, 0.78, 0.90) if name == COUPON or name.endswith(f".{MARKED}") else Color(0.15, 0.15, 0.17)
    )
    export_step(part, str(path), timestamp="2000-01-01T00:00:00")
    return _facts(part, import_step(str(path)), [name])


def _brep(parts: list[Any], names: list[str], path: Path) -> dict[str, Any]:
    from build123d import Compound, export_brep, import_brep

    whole = Compound(children=parts)
    export_brep(whole, str(path))
    return _facts(whole, import_brep(str(path)), names)


def _facts(made: Any, found: Any, names: list[str]) -> dict[str, Any]:
    return {
        "bodies": names,
        "solids": len(found.solids()),
        "faces": len(found.faces()),
        "volume": float(found.volume),
        "volume_exact": float(made.volume),
        "valid": bool(found.is_valid),
        "float": "f64",
        "mode": "fused",
    }


# -- requirements ----------------------------------------------------------------------------------

DRAWING_SECONDS = 300.0
"""Time for OCC to draw a line of text."""


def _require_baffle(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require walls, and a gap for them."""
    from clacad.exporting.fixtures import baffle_meshes

    baffle_meshes(window)


def _require_frame(window: Window, _asked: Request, worker: Worker) -> None:
    """Require plates with flat borders, gaps, and room for the name."""
    from clacad.exporting.fixtures.frame import frame_spec, mark_lines
    from clacad.solid.marks import mark_text

    for width, height in mark_lines(frame_spec(window, window.land.border)):
        _require_room(mark_text(window.name), width, height, worker)


def _require_pins(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require plates with pin holes, gaps, and land for the shoulders."""
    from clacad.exporting.fixtures.frame import pin_spec

    pin_spec(window)


def require_marks(window: Window, _asked: Request, worker: Worker) -> None:
    """Require a border with room for the name."""
    from clacad.solid.marks import mark_place, mark_text

    for place, body in [(mark_place(window, body), body) for body in window.bodies]:
        _require_room(mark_text(f"{window.name} {body.name}"), place.width, place.height, worker)


def _require_marked(window: Window, asked: Request, worker: Worker) -> None:
    """Require a border with room for the name, and bodies that OCC accepts."""
    require_marks(window, asked, worker)
    _require_solids(window, MARKED)


def _require_brep(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require bodies that OCC accepts."""
    _require_solids(window, "BREP")


def _require_coupon(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require a patch of a few cells that is a solid."""
    from clacad.exporting.fixtures.frame import PATCH_CELLS

    _require_solids(window.with_cells(PATCH_CELLS), COUPON)


def _require_solids(window: Window, what: str) -> None:
    """Require at most the number of cells that OCC takes, and faces that can be described."""
    refuse_many(window, what)
    step.step_bytes(window, "fused")  # describes the faces of small sheets, as the solids are described


def _require_room(text: str, width: float, height: float, worker: Worker) -> None:
    """Require room (mm) for a line of text, estimated from its letters or measured by drawing it."""
    from clacad.solid.marks import surely_fits

    if not surely_fits(text, width, height):
        worker.run("clacad.solid.marks:require_room", text, width, height, timeout=DRAWING_SECONDS)


# -- cost ------------------------------------------------------------------------------------------


def solid_seconds(size: int) -> float:
    """Seconds for solids made by OCC: frame, coupon, BREP."""
    return 1.5 + 2.0e-6 * size


def _rough_seconds(sheet: RoughSheet, _quads: int, _asked: Request) -> float:
    return solid_seconds(8000 * sheet.cells * sheet.bodies)


def _forecast_baffle(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    from clacad.sheet.face_order import plates_of

    window = meshes.window
    honeycombs = max(1, len(plates_of(window.bodies)) - 1)
    sides = 8 if any(place.turn for place in window.placements) else 6  # triangles of a side of a cell
    facets = sides * len(window.lattice.steps) * window.lattice.cell_count * honeycombs
    return indexed_meshes.stream_row(BAFFLE, facets, honeycombs, None, exact=False)


def _solid_row(word: str, size: int | None, meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    """Forecast of solids of a known size, or of one that grows with the cells (None)."""
    window = meshes.window
    about = 15_000 + 8_000 * window.lattice.cell_count * len(window.bodies) if size is None else size
    return Forecast(word, about, False, None, None, solid_seconds(about), (500_000_000, 2_500_000_000))


def _solid(
    word: str,
    about: str,
    require: Callable[[Window, Request, Worker], None],
    size: int | None = None,
    **facts: Any,
) -> Format:
    """Format of parts modelled by OCC; `size`: approximate bytes."""
    return Format(
        word,
        "part",
        about,
        partial(_modelled, word),
        partial(_solid_row, word, size),
        _rough_seconds,
        require,
        **facts,
    )


# -- meshes with marks -----------------------------------------------------------------------------


def _write_marked_stl(job: Job) -> list[FileRecord]:
    from clacad.exporting.fixtures.engraving import engraved, with_marks

    made = engraved(job)
    parts = [
        (f"{made.stem}.{body.name}.marked.stl", replace(made.window, bodies=(body,)))
        for body in made.window.bodies
    ]
    return [with_marks(indexed_meshes.write_one(made, name, window), made) for name, window in parts]


def _write_marked_threemf(job: Job) -> list[FileRecord]:
    """Write one 3MF file, in which no cell is repeated."""
    from clacad.exporting.fixtures.engraving import engraved, with_marks

    made = replace(engraved(job), stem=f"{job.stem}.marked")
    return [with_marks(indexed_meshes.threemf_record(made, plain=True), made)]


def _forecast_marked_stl(meshes: Meshes, quads: int, _asked: Request) -> Forecast:
    files = len(meshes.window.bodies)
    return _with_letters(
        meshes, indexed_meshes.stream_row(MARKED_STL, meshes.facets(quads), files, quads, exact=False)
    )


def _forecast_marked_threemf(meshes: Meshes, quads: int, _asked: Request) -> Forecast:
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
    replace(
        _solid(BREP, "exact solids of all bodies for OCC", _require_brep, stored=(EXACT_FACES,)),
        family="exact",
    ),
    Format(
        BAFFLE,
        "part",
        "opaque honeycombs between the arrays, STL",
        _write_baffle,
        _forecast_baffle,
        _rough_seconds,
        _require_baffle,
        optical=False,
        bodies=(BAFFLE,),
    ),
    _solid(
        FRAME,
        "spacer frame and its retainers, STEP",
        _require_frame,
        400_000,
        optical=False,
        bodies=("spacer", "retainer"),
    ),
    _solid(
        PINS, "shoulder pins between the bodies, STEP", _require_pins, 40_000, optical=False, bodies=(PINS,)
    ),
    _solid(
        COUPON,
        "test coupon for the compensation of a process, STEP",
        _require_coupon,
        2_000_000,
        optical=False,
        of_cell=True,
        bodies=(COUPON,),
        stored=(EXACT_FACES,),
    ),
    _solid(
        MARKED,
        "bodies with their name and an arrow in the border, STEP",
        _require_marked,
        stored=(EXACT_FACES,),
    ),
    Format(
        MARKED_STL,
        "stream",
        "facets with name and arrow in the border, one binary STL file a body",
        _write_marked_stl,
        _forecast_marked_stl,
        indexed_meshes.rough_seconds,
        require_marks,
        whole_sheet=False,
        stored=(AS_PLAIN,),
    ),
    Format(
        MARKED_3MF,
        "welded",
        "facets with name and arrow in the border, 3MF",
        _write_marked_threemf,
        _forecast_marked_threemf,
        indexed_meshes.rough_welded,
        require_marks,
        whole_sheet=False,
        stored=(AS_PLAIN,),
    ),
)

FILES = (FileKind(BREP, "solid", (".brep",), native=True),)
