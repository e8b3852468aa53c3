"""Kinds of files: how each is recognised and compared with the design; facts that several formats record."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

from clacad.base.units import millimetres
from clacad.exporting.formats.format import BASE, STREAM_FACET, Forecast, own_cells_note

if TYPE_CHECKING:
    from pathlib import Path

    from clacad.base.types import Floats
    from clacad.exporting.formats.format import RoughSheet
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.formats.maps.sag import HeightMap
    from clacad.sheet.window import Body, Face, Window


Misfit = tuple[float, float, str]
"""Greatest deviation in millimetres (or relative, for tables), its allowance for writing, and the compared
quantity."""


@dataclass(frozen=True, eq=False)
class FaceFile:
    """A file of one face: the face, its body, its name in files ("array1.front"), and the path."""

    window: Window
    body: Body
    face: Face
    label: str
    path: Path

    @property
    def scale(self) -> float:
        """Millimetres per design unit."""
        return millimetres(self.window.unit)

    def map(self) -> HeightMap:
        """Map of the face as an export writes it."""
        from clacad.formats.maps.sag import height_map, samples_per_cell

        per_cell = samples_per_cell(self.window, None)
        return height_map(self.window, self.body, self.face, self.label, per_cell)


@dataclass(frozen=True, eq=False)
class Samples:
    """Heights of one cell.

    points : (m, 3) lengths. x and y in the cell frame, z in the sheet frame.
    step : (2,) lengths
    """

    points: Floats
    step: Floats


@dataclass(frozen=True, eq=False)
class Reading:
    """Comparison of a file of heights, points, places or numbers with the design; see `map_reading`.

    face : `face(file)` → misfit of a file of one face.
    sheet : `sheet(window, path)` → misfit of a file of the whole window.
    samples : `samples(file, cell)` → heights of one cell of a face, through which light is traced.
    points : `points(file)` → points (m, 3) of tooling, lengths, in the axes of its window.
    facets : `facets(file)` → facets (t, 3, 3) of tooling that light is traced through, lengths.
    room : Largest distance of such a point from where it belongs, in pitches.
    unit : Unit of the misfit; "": relative.
    """

    face: Callable[[FaceFile], Misfit] | None = None
    sheet: Callable[[Window, Path], Misfit] | None = None
    samples: Callable[[FaceFile, tuple[int, int]], Samples] | None = None
    unit: str = "mm"
    points: Callable[[FaceFile], Floats] | None = None
    facets: Callable[[FaceFile], Floats] | None = None
    room: float = 1e-6


@dataclass(frozen=True, eq=False)
class FileKind:
    """Files under one word of the manifest; a format writes one kind of file, or several.

    word : Format in manifests and reports.
    family : "mesh", "solid", "map" or "other". Triangles; exact solids; a file that is compared by
        `readings`; everything else is judged by its bytes.
    ends : Endings by which a file without a manifest is recognised.
    bytes_a_facet : Approximate size of a mesh.
    states_unit : Whether every reader interprets its unit alike.
    native : Whether a native library reads it, in a process of its own.
    like : Format that stores a mesh alike; "": its own word.
    text_budget : Reader (`clacad.base.untrusted_files`) of the text of a file that is too large for OCC; "":
        no text is read.
    older : Whether words that begin with this one are older words of the same kind.
    readings : Module with a mapping `READINGS` from words to `Reading`; imported on first use.
    """

    word: str
    family: Literal["mesh", "solid", "map", "other"]
    ends: tuple[str, ...] = ()
    bytes_a_facet: float = STREAM_FACET
    states_unit: bool = False
    native: bool = False
    like: str = ""
    text_budget: str = ""
    older: bool = False
    readings: str = ""

    @property
    def reading(self) -> Reading:
        """Comparison with the design; none of its parts for files that are not compared by numbers."""
        if not self.readings:
            return Reading()
        found: Reading = import_module(self.readings).READINGS[self.word]
        return found


# -- meshes ----------------------------------------------------------------------------------------
SCALES = {"mm": 1.0, "m": 1e-3}
"""Units of mesh files, per millimetre."""


def mesh_facts(
    job: Job,
    facets: int,
    volume: float,
    exact: float | None,
    names: Sequence[str],
    unit: str = "mm",
    repeated: bool = False,
) -> dict[str, Any]:
    """Facts of a mesh file; `repeated`: it holds one cell, and the whole sheet is not meshed."""
    mesh = job.tessellation.cell if repeated else job.tessellation.mesh
    scale = job.scale * SCALES[unit]
    cube = scale**3
    parts = [part for part, body in zip(mesh.bodies, job.window.bodies, strict=True) if body.name in names]
    return {
        "triangles": facets,
        "quads": job.tessellation.quads,
        "slope_error_rms": float(mesh.slope_error),
        "sag_error_max": float(mesh.sag_error) * scale,
        "volume": volume * cube,
        "volume_exact": None if exact is None else exact * cube,
        **_saddle_facts(job, sum(part.saddles for part in parts), scale),
    }


def _saddle_facts(job: Job, saddles: int, scale: float) -> dict[str, Any]:
    """Number of saddles of a mesh and their treatment; `scale`: file units per design unit."""
    bevel = job.request.saddle_bevel * scale
    if not saddles:
        return {"saddles": 0}
    if bevel:
        return {"saddles": saddles, "saddle_policy": "bevel", "saddle_bevel": bevel}
    return {"saddles": saddles, "saddle_policy": "touch"}


def of_own_cells(window: Window, row: Forecast, quads: int) -> Forecast:
    """Row of a mesh with the cost of a non-uniform sheet, all of whose triangles are made and none copied."""
    if window.uniform:
        return row
    bodies = sum(any(f.change is not None for f in (body.front, body.back)) for body in window.bodies)
    cells = window.lattice.cell_count * bodies
    more = cells * (2e-5 + 1e-6 * quads * quads)
    return replace(row, modelled=row.modelled + more, note=own_cells_note(window))


# -- maps and tables -------------------------------------------------------------------------------
CALIBRATION = "height-calibration"
"""Word in manifests of the file that gives the heights of levels or layers."""

MEMORY = (100_000_000, 400_000_000)

PER_FACE = 0.015
"""Seconds per face of files whose size does not depend on the number of cells."""


def calibration_record(job: Job, word: str, faces: Mapping[str, Any]) -> FileRecord:
    """Write one calibration file for the faces of a format."""
    from clacad.storage.atomic import canonical_json

    path = job.stage.path(f"{job.stem}.{word}.json")
    text = canonical_json({"format": 1, "unit": "mm", "faces": faces})
    path.write_text(text, encoding="utf-8", newline="\n")
    return job.record(path, CALIBRATION)


def map_row(word: str, size: int, seconds: float, more_memory: int = 0, note: str = "") -> Forecast:
    """Forecast files from their bytes and seconds."""
    memory = (MEMORY[0], MEMORY[1] + more_memory)
    return Forecast(word, size, False, None, None, seconds, memory, note=note)


def map_kind(word: str, *ends: str, native: bool = False) -> FileKind:
    """Kind of a file that `map_reading` compares with the design."""
    return FileKind(word, "map", ends, native=native, readings="clacad.exporting.formats.map_reading")


def structured_cost(faces: int) -> float:
    """Seconds of files whose size does not depend on the number of cells."""
    return BASE + PER_FACE * faces


def drawn_cost(each: float) -> Callable[[RoughSheet, int, Request], float]:
    """Seconds from the design's numbers, of files with a hundred items a cell; `each`: seconds per item."""

    def seconds(sheet: RoughSheet, _quads: int, _asked: Request) -> float:
        return BASE + each * (100 * sheet.cells * sheet.bodies)

    return seconds
