"""A file format: its word, its family, the sheets that it holds, its cost, its requirements, its writer.

Rough sizes follow from a few numbers of a sheet, without meshing or generating text: facets are within 40 %,
for grids above 32 within 10 %.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from clacad.base.units import millimetres
from clacad.exporting.roles import NO_SURFACE, Role, Storing

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.exporting.roles import Prospect
    from clacad.exporting.tessellations import Meshes
    from clacad.sheet.window import Window
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
