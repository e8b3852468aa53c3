"""A file format: its word, its family, the sheets that it holds, its cost, its requirements, its writer.

Rough sizes follow from a few numbers of a sheet, without meshing or generating text: facets are within 40 %,
for grids above 32 within 10 %.

Kinds of files: how each is recognised and compared with the design; facts that several formats record.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

from clacad.base.units import millimetres
from clacad.exporting.roles import NO_SURFACE, Role, Storing

if TYPE_CHECKING:
    from pathlib import Path

    from clacad.base.types import Floats
    from clacad.design import Design
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.exporting.roles import Prospect
    from clacad.exporting.tessellations import Meshes
    from clacad.formats.maps.sag import HeightMap
    from clacad.sheet.window import Body, Face, Window
    from clacad.storage.worker import Worker


BASE = 0.02
"""Seconds to open, hash and read back a very small file, on the reference machine.

The cost constants of all formats hold for one x86-64 server core; `clacad.base.machine_rates` scales them to
other machines.
"""

STREAM_FACET = 50
"""Bytes of a facet of a file that is written as a stream, binary STL."""

STREAM_MEMORY = (80_000_000, 400_000_000)
"""Memory (bytes) of writing a file as a stream."""

Family = Literal["exact", "stream", "welded", "map", "part", "prescription", "drawing"]
"""Exact solids; facets as a stream; facets of shared vertices; heights, points, tables, masks and scenes;
parts modelled one by one; one telescopelet for lens-design programs; sheets of paper.
"""


@dataclass(frozen=True, slots=True)
class Forecast:
    """Price of one format.

    exact : Whether `bytes` is exact; otherwise within 20 %.
    facets : Facets of the sheet; every instance is counted.
    modelled : Processor seconds on the reference machine.
    memory : (low, high) bytes
    seconds : (low, high). Processor seconds on this machine.
    stored : Facets that the file stores; fewer than `facets` where it repeats a cell.
    places : Bytes of the positions of the repeated cells.
    prospect : The file's role and the light through it.
    note : Reason why this file costs more than that of a uniform sheet; "" if it does not.
    """

    format: str
    bytes: int
    exact: bool
    facets: int | None
    quads: int | None
    modelled: float
    memory: tuple[int, int]
    seconds: tuple[float, float] = (0.0, 0.0)
    stored: int | None = None
    places: int = 0
    prospect: Prospect | None = None
    note: str = ""

    @property
    def task(self) -> str:
        """Name under which the seconds of this format are recorded."""
        return f"export {self.format}"

    def to_dict(self) -> dict[str, Any]:
        """JSON-able form."""
        plain: dict[str, Any] = {
            "format": self.format,
            "bytes": self.bytes,
            "exact": self.exact,
            "facets": self.facets,
            "quads": self.quads,
            "seconds": list(self.seconds),
            "memory": list(self.memory),
        }
        if self.facets is not None:
            plain["stored"] = self.facets if self.stored is None else self.stored
        if self.prospect is not None:
            plain |= self.prospect.entry()
            plain |= {"law_rms_limit": self.prospect.limit} if self.quads is not None else {}
        return plain | ({"note": self.note} if self.note else {})


@dataclass(frozen=True, slots=True)
class ChosenMesh:
    """A mesh file of an export with default options.

    quads : a cell side
    facets, bytes : Approximate number of stored facets and size.
    """

    quads: int
    facets: int
    bytes: int


def _anything(_window: Window, _asked: Request, _worker: Worker) -> None:
    """Require nothing."""


@dataclass(frozen=True, eq=False)
class Format:
    """Properties of a format.

    word : Name in requests, messages and manifests of options.
    family : str. See `Family`.
    about : Contents of the files, in one line.
    write : `write(job)` writes into the private folder, reads back, compares and describes the files.
    forecast : `forecast(meshes, quads, request)` → `Forecast`; `quads` is unused by formats without facets.
    rough_seconds : `rough_seconds(sheet, quads, request)`: processor seconds on the reference machine, from
        the design's numbers.
    require : callable
        `require(window, request, worker)` refuses designs and machines for which the format is impossible.
    refuse_places : callable or None
        `refuse_places(window, request)` refuses more repeated cells than the reader of the format takes.
    at_a_glance : `at_a_glance(window, sheet, chosen)` → `Forecast` for `check`, of a format that designs are
        commonly exported in; `chosen` is the mesh that an export would write, None without a design.
    optical : Whether the light of the law goes through a part made from its files.
    tooling : Whether its files are not the part but make it: `Role.TOOLING`.
    commands : Whether its files of heights can hold the forms of a correction (process.command).
    of_cell : Whether it describes one cell; of a non-uniform sheet the cell that the request names.
    turned_arrays, many_sizes : Whether these may have a rotated array, and lenses of many sizes.
    repeats : Whether it stores one cell and its places if the sheet is `tessellations.instanceable`.
    fusable : Whether the option `fused` applies.
    whole_sheet : Whether one file holds all bodies.
    kernel : Whether OCC reads every file back, so that it is loaded early.
    smaller : Options that make its files smaller; "": fewer quads or cells.
    stored : Ways in which the faces are stored, of which a reader may choose.
    bodies : Names, without numbers, of the parts that it writes in addition to the optics.
    """

    word: str
    family: Family
    about: str
    write: Callable[[Job], list[FileRecord]]
    forecast: Callable[[Meshes, int, Request], Forecast]
    rough_seconds: Callable[[RoughSheet, int, Request], float]
    require: Callable[[Window, Request, Worker], None] = _anything
    refuse_places: Callable[[Window, Request], None] | None = None
    at_a_glance: Callable[[Window, RoughSheet, ChosenMesh | None], Forecast] | None = None
    optical: bool = True
    tooling: bool = False
    commands: bool = False
    of_cell: bool = False
    turned_arrays: bool = True
    many_sizes: bool = True
    repeats: bool = False
    fusable: bool = False
    whole_sheet: bool = True
    kernel: bool = False
    smaller: str = ""
    stored: tuple[Storing, ...] = (NO_SURFACE,)
    bodies: tuple[str, ...] = ()

    @property
    def is_mesh(self) -> bool:
        """Whether the files consist of facets, so that their role depends on the facet grid."""
        return self.family in ("stream", "welded")

    @property
    def chosen_by_error(self) -> bool:
        """Whether the facet grid can be chosen by the error that the facets leave."""
        return self.is_mesh and any(way.holding is not None for way in self.stored)

    @property
    def role(self) -> Role:
        """Role of files with exact faces, heights or poses, or without optics; that of facets depends on
        their grid.
        """
        if self.tooling:
            return Role.TOOLING
        return Role.MASTER if self.optical else Role.OTHER

    def repeats_cells(self, meshes: Meshes) -> bool:
        """Whether a file of these meshes stores one cell and its places."""
        return self.repeats and meshes.repeatable

    def sheet_of(self, window: Window, asked: Request) -> Window:
        """Sheet that the files describe: of one cell, its uniform equivalent, named after the cell.

        The equivalent's cells are as wide as array 1's, of maps as the wider array's. Tooling describes the
        sheet before the process shrinks it.
        """
        if not (window.uniform or not self.of_cell or asked.cell is None):
            from clacad.sheet.like_cell import named_cell

            window = named_cell(window, asked.cell, widest=self.family == "map")
        if asked.compensation is None or not self.compensated(asked):
            return window
        return asked.compensation.window(window)

    def compensated(self, asked: Request) -> bool:
        """Whether the files of a request are tooling: the part before its process shrinks it."""
        return self.tooling or (asked.compensate and self.optical)

    def cell_facts(self, window: Window, asked: Request) -> dict[str, Any]:
        """Which cell the files describe, and what tooling is compensated for: facts for the manifest."""
        given = self.of_cell and asked.cell is not None
        facts: dict[str, Any] = {"cell": asked.cell, "uniform": window.uniform or None} if given else {}
        if asked.compensation is not None and self.compensated(asked):
            facts["compensation"] = asked.compensation.to_dict(millimetres(window.unit))
        return facts

    def holds(self, window: Window) -> bool:
        """Whether a file can hold the cells of a sheet."""
        if window.uniform:
            return True
        turned = any(place.turn for place in window.placements)
        return (
            not self.of_cell
            and (self.turned_arrays or not turned)
            and (self.many_sizes or not window.many_sizes)
        )


def stream_bytes(facets: int, files: int = 1) -> int:
    """Bytes of files written as a stream, with a head each."""
    return 84 * files + STREAM_FACET * facets


def cell_words(facts: Mapping[str, Any]) -> str:
    """Words on the cell of `Format.cell_facts`; "" for none."""
    if "cell" not in facts:
        return ""
    i, j = facts["cell"]
    return f"cell {i},{j}" + (": all cells of the sheet are equal" if facts.get("uniform") else "")


def about_number(number: int) -> int:
    """A number rounded to two digits, its known accuracy."""
    return int(float(f"{number:.1e}"))


def own_cells_note(window: Window, copies: int = 1) -> str:
    """Note on the extra cost of a file of a non-uniform sheet, or of one of its equal sectors; "" for a
    uniform sheet.
    """
    if window.uniform:
        return ""
    rest = "none can be repeated" if copies == 1 else f"each is repeated {copies} times, turned"
    return f"every cell differs: {window.lattice.cell_count // copies:,} are written out, {rest}"


IDENTITY = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


@dataclass(frozen=True, slots=True)
class RoughSheet:
    """Numbers that determine the sizes of a sheet's files.

    lenses : Faces with lenslets.
    cells : At least 1: an outline may leave none whole.
    count : (n1, n2)
    tilted : Lenslets are tilted, so that neighbours do not join at their borders.
    repeats : Whether the sheet is uniform, without an outline or land between cells and outline.
    cylinders : Every lenslet is a cylinder along its cell, which takes one step of the grid that way.
    """

    lenses: int
    bodies: int
    cells: int
    count: tuple[int, int]
    hexagonal: bool
    tilted: bool
    repeats: bool
    cylinders: bool = False

    @staticmethod
    def of_design(design: Design) -> RoughSheet:
        """Numbers of a design before it is prescribed."""
        form, lattice = design.pair.form, design.lattice
        n1, n2 = (int(n) for n in lattice.count)
        lenses, bodies = (
            (4 if form == "biconvex" else 2),
            (max(1, len(design.pair.layers)) if form == "slab" else 2),
        )
        if form == "plates":
            from clacad.design.faces import listed_lenses

            lenses, bodies = listed_lenses(design.pair.face)
        return RoughSheet(
            lenses,
            bodies,
            n1 * n2,
            (n1, n2),
            lattice.kind == "hexagonal",
            design.law.rotation.tolist() != IDENTITY,
            lattice.outline is None,
            design.law_spec.cylinders and design.law.rotation.tolist() == IDENTITY and not design.pair.given,
        )

    @staticmethod
    def of_window(window: Window) -> RoughSheet:
        """Numbers of the sheet as built."""
        from clacad.sheet.grid_steps import lens_squares

        lattice = window.lattice
        n1, n2 = (int(n) for n in lattice.count)
        lenses = [face for face in window.faces if face.array is not None]
        tilted = not all(face.untilted for face in lenses)
        return RoughSheet(
            len(lenses),
            len(window.bodies),
            max(1, lattice.cell_count),
            (n1, n2),
            lattice.hexagonal,
            tilted,
            window.uniform and window.outline is None,
            lens_squares(window, 2) == 2 * len(lenses),
        )

    def facets(self, quads: int) -> int:
        """Facets of one cell of all bodies: two per square of each lens grid, and some for walls of tilted
        lenses.
        """
        return self.lenses * (self._lens(quads) + (4 * quads if self.tilted else 0))

    def piece(self, quads: int) -> int:
        """Facets of one cell with its sides, as formats repeat it; a flat back is divided into a fan."""
        flat = 4 if self.lenses == self.bodies > 1 else 0
        return self.lenses * self._lens(quads) + (8 + flat) * quads * self.bodies

    def _lens(self, quads: int) -> int:
        """Facets of one lens."""
        return 2 * quads * (1 if self.cylinders else quads) * (3 if self.hexagonal else 1)


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
        from clacad.formats.maps.sag import height_map

        return height_map(self.window, self.body, self.face, self.label)


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


def structured_count(window: Window) -> int:
    """Number of faces that carry lenslets."""
    return sum(face.array is not None for face in window.faces)


def structured_cost(faces: int) -> float:
    """Seconds of files whose size does not depend on the number of cells."""
    return BASE + PER_FACE * faces


def drawn_cost(each: float) -> Callable[[RoughSheet, int, Request], float]:
    """Seconds from the design's numbers, of files with a hundred items a cell; `each`: seconds per item."""

    def seconds(sheet: RoughSheet, _quads: int, _asked: Request) -> float:
        return BASE + each * (100 * sheet.cells * sheet.bodies)

    return seconds
