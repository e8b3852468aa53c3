"""One row of the accuracy table, a rung at a setting with its error and its seconds, and the front of the
rows.

Conclusion of an accuracy table in up to three sentences: cost of exact faces, value of a mesh, the exact
file.

The accuracy table: rows of error and time, the cheapest sufficient row, and the conclusion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import isfinite
from typing import TYPE_CHECKING, Any

from clacad.base.interactive import Tabular, columns_of
from clacad.base.text import mrad_text, plain, size_text

if TYPE_CHECKING:
    from clacad.making.light_as_made import Cost
    from clacad.verification.accuracy.file_floors import Floor


@dataclass(frozen=True, slots=True)
class AccuracyRow:
    """One rung at one setting.

    rung : "law", "thin", "surfaces", "mesh" or "step"
    setting : Text for a person: "16 quads, facet normals, float32 vertices".
    model_rms, model_p95, model_max : radians
        Angle to the truth, caused by what the rung leaves out. The truth is rung surfaces in float64; the row
        of that rung holds its angle to a 50-digit trace of `checked` rays.
    law_rms, law_max : radians. Angle to the requested law.
    disagree : Share of rays whose fate or order differs from the truth.
    seconds : Processor seconds of the trace alone, best of 3, warm.
    prepare_s : Processor seconds of tessellating, reading or compiling before the first ray.
    rays : Rays traced.
    checked : Number of rays in the two model errors.
    bytes : Geometry the rung reads.
    file_bytes : int or None
        Size of the file that holds this geometry for the whole sheet; None where there is no such file.
    memory : Peak of arrays allocated by the trace, bytes.
    triangles : Triangles of the whole sheet.
    quads : Facets per cell side.
    normals : "facet", "vertex" or ""
    float : "f64" or "f32"
    write_s, read_s : Processor seconds of writing the geometry of 5 x 5 cells to the row's file, and of
        reading it back; STL for facets. Reading STEP includes loading its reader.
    own_cells : bool
        For a non-uniform sheet: whether the sheet itself was traced, not its worst cell's uniform equivalent.
    """

    rung: str
    setting: str
    model_rms: float
    model_p95: float
    model_max: float
    law_rms: float
    law_max: float
    disagree: float
    seconds: float
    prepare_s: float
    rays: int
    checked: int
    bytes: int = 0
    file_bytes: int | None = None
    memory: int = 0
    triangles: int = 0
    quads: int | None = None
    normals: str = ""
    write_s: float | None = None
    read_s: float | None = None
    float: str = "f64"
    own_cells: bool = False

    @property
    def rays_per_s(self) -> Any:
        """Rays per processor second."""
        return self.rays / self.seconds if self.seconds > 0 else 0.0

    @property
    def seconds_per_ray(self) -> Any:
        """Processor seconds of one ray, by which rows with different ray counts are compared."""
        return self.seconds / max(1, self.rays)

    def predicted_seconds(self, rays: int) -> Any:
        """Processor seconds for another ray count, preparation included."""
        return self.prepare_s + self.seconds_per_ray * rays

    def to_dict(self) -> dict[str, Any]:
        """JSON-able form; unmeasured values are null."""
        found = {**plain(asdict(self)), "rays_per_s": self.rays_per_s}
        if not self.own_cells:
            del found["own_cells"]
        return found


@dataclass(frozen=True, slots=True)
class SpectrumCost:
    """One line against the spectrum: seconds and results of white light, traced and in closed form.

    lines : Number of lines.
    one_line_s, traced_s, closed_s : Processor seconds of one line, of all lines, and of their closed form.
    change, closed_change : radians
        Mean over the lines of the rms change of direction against the design's wavelength.
    law_white : radians. Mean over the lines of the rms angle to the law.
    """

    lines: int
    one_line_s: float
    traced_s: float
    closed_s: float
    change: float
    closed_change: float
    law_white: float

    def sentence(self) -> str:
        """Cost and result in one sentence."""
        return (
            f"one line against the spectrum: {self.lines} lines take {self.traced_s:.2g} s,"
            f" {self.traced_s / max(self.one_line_s, 1e-9):.2g} × one line, and leave"
            f" {mrad_text(self.law_white, 3)} rms; light changes by {mrad_text(self.change, 3)} over them, by"
            f" {mrad_text(self.closed_change, 3)} in closed form ({self.closed_s:.1g} s)"
        )


@dataclass(frozen=True, slots=True)
class MadeCost:
    """As designed against as made: error and processor seconds of the same rays, through one cell.

    process : Name of the process profile.
    designed, formed, everything : radians. Rms error to the law: as designed; as made clear of roundings, and
        of all light.
    designed_s, made_s : Processor seconds of the rays, through the exact surfaces and as made.
    costs : What each parameter of the process costs alone: error, or light.
    """

    process: str
    designed: float
    formed: float
    everything: float
    designed_s: float
    made_s: float
    costs: tuple[Cost, ...] = ()

    def sentence(self) -> str:
        """Cost and result in one sentence, and what each parameter of the process costs alone."""
        alone = f"; alone {', '.join(map(str, self.costs))}" if self.costs else ""
        return (
            f"as designed against as made ({self.process}): {mrad_text(self.designed, 3)} rms,"
            f" {mrad_text(self.formed, 3)} clear of roundings, {mrad_text(self.everything, 3)} of all light;"
            f" {self.designed_s:.2g} s against {self.made_s:.2g} s of the same rays{alone}"
        )


def pareto(rows: Sequence[AccuracyRow]) -> tuple[AccuracyRow, ...]:
    """Rows for which no other row is better in both error and seconds per ray, cheapest first."""
    front: list[AccuracyRow] = []
    for row in sorted(rows, key=lambda r: (r.seconds_per_ray, r.model_rms)):
        if isfinite(row.model_rms) and (not front or row.model_rms < front[-1].model_rms):
            front.append(row)
    return tuple(front)


def conclusion(rows: Sequence[AccuracyRow], floors: Sequence[Floor] = ()) -> str:
    """Conclusion of the rows of a table in words; for a non-uniform sheet from the rows of the sheet itself.

    rows : Their errors (radians) and seconds are the only numbers used.
    floors : Least error of each family of file formats.
    """
    own = any(row.own_cells for row in rows)
    traced = [row for row in rows if row.own_cells == own and row.rung != "step"]
    return " ".join(text for text in (_exact(traced), "".join(_mesh(traced)), _files(rows, floors)) if text)


def headline(rows: Sequence[AccuracyRow]) -> str:
    """Conclusion of the rows in one sentence: cost and error of exact faces, and whether a mesh pays."""
    own = any(row.own_cells for row in rows)
    traced = [row for row in rows if row.own_cells == own and row.rung != "step"]
    exact, (mesh, _) = _exact(traced).removesuffix("."), _mesh(traced)
    return f"{exact}; {mesh[0].lower()}{mesh[1:]}" if mesh else exact


def _exact(rows: Sequence[AccuracyRow]) -> str:
    exact, law = _row(rows, "surfaces"), _row(rows, "law")
    if exact is None:
        return ""
    cost = ""
    if law is not None and law.seconds > 0.0 and exact.seconds > 0.0:
        cost = f"cost {exact.seconds_per_ray / law.seconds_per_ray:.2g} × the law and "
    if not isfinite(exact.model_rms):
        return f"Exact faces {cost}were not compared with a trace of more digits."
    return f"Exact faces {cost}are within {mrad_text(exact.model_rms, 2)} rms of a 50-digit trace."


def _mesh(rows: Sequence[AccuracyRow]) -> tuple[str, str]:
    """Whether a mesh is worth tracing, and the rest of the sentence: its setting, seconds and error."""
    exact, meshes = _row(rows, "surfaces"), [row for row in rows if row.rung == "mesh"]
    known = [row for row in meshes if isfinite(row.model_rms)]
    if not known or exact is None or exact.seconds <= 0.0:
        return "", ""
    worth = [row for row in pareto(rows) if row.rung == "mesh"]
    best = min(worth or known, key=lambda row: row.model_rms)
    what = f"{best.quads} quads a cell side with {best.normals} normals"
    cost = (
        f"{best.seconds_per_ray / exact.seconds_per_ray:.2g} × the time of exact faces and leaves"
        f" {mrad_text(best.model_rms, 2)}"
    )
    if worth:
        return "A mesh is worth tracing for speed alone", f": {what} takes {cost}."
    beaten = "for each is beaten in both error and time"
    return "No mesh is worth tracing", f", {beaten}: the most exact, {what}, takes {cost}."


def _files(rows: Sequence[AccuracyRow], floors: Sequence[Floor]) -> str:
    from clacad.exporting.formats.indexed_meshes import STL

    step = _row(rows, "step")
    faceted = [
        one
        for one in floors
        if one.normals == "facet" and one.floor is not None and STL in one.formats.split(", ")
    ]
    parts = []
    if step is not None and isfinite(step.model_rms):
        size = "" if step.file_bytes is None else f" in {size_text(step.file_bytes)}"
        parts.append(f"STEP is within {mrad_text(step.model_rms, 2)}{size}")
    parts += [f"STL comes no closer than {mrad_text(one.floor, 2)} at any size" for one in faceted[:1]]
    return f"Of files, {'; '.join(parts)}." if parts else ""


def _row(rows: Sequence[AccuracyRow], rung: str) -> AccuracyRow | None:
    return next((row for row in rows if row.rung == rung and row.float == "f64"), None)


MOST_DISAGREEMENT = 0.01
"""Largest share of rays with another fate or order than the truth at which a setting may be chosen."""


class TargetOutOfReach(ValueError):
    """No setting reaches the requested error; exit status 3."""

    exit_status = 3


@dataclass(frozen=True)
class AccuracyTable(Tabular):
    """Result of `clacad.accuracy`.

    reference : The 50-digit check of the truth: rays, rms, max.
    spectrum : Cost of white light; None where the design has no colour.
    made : Light as made, with its cost; None where the sheet cannot be judged as made.
    floors : Limit of useful refinement: for each family of file formats the best facet grid and its error.
    """

    design: str
    rows: tuple[AccuracyRow, ...]
    reference: Mapping[str, float]
    floors: tuple[Floor, ...] = ()
    notes: tuple[str, ...] = ()
    target: float | None = None
    rays: int = field(default=0)
    spectrum: SpectrumCost | None = None
    made: MadeCost | None = None

    def __repr__(self) -> str:
        return f"AccuracyTable({self.design!r}, {len(self.rows)} settings, {self.rays} rays each)"

    def to_columns(self) -> dict[str, Any]:
        """One row for each setting, as in `to_dict`: errors in radians, processor seconds."""
        return columns_of([row.to_dict() for row in self.rows])

    def cheapest(
        self, target: float, rays: int | None = None, rungs: Sequence[str] | None = None
    ) -> AccuracyRow:
        """Row with the least predicted seconds and `model_rms` within `target`; of the sheet itself if
        non-uniform.

        target : radians
        rays : Number of rays to trace; default as in the table.
        rungs : Only these rungs.
        Raises TargetOutOfReach: The message names the closest row.
        """
        count = rays or max((row.rays for row in self.rows), default=1)
        own = any(row.own_cells for row in self.rows)
        open_to = [row for row in self.rows if (rungs is None or row.rung in rungs) and row.own_cells == own]
        good = [row for row in open_to if row.model_rms <= target and row.disagree <= MOST_DISAGREEMENT]
        if good:
            return min(good, key=lambda row: (row.predicted_seconds(count), row.model_rms))
        closest = min(open_to, key=lambda row: (row.disagree > MOST_DISAGREEMENT, row.model_rms))
        raise TargetOutOfReach(
            f"no setting is within {mrad_text(target)}; the closest is {closest.rung} {closest.setting}"
            f" with {mrad_text(closest.model_rms)} and {closest.disagree:.2%} of the rays in another fate"
        )

    def pareto(self) -> tuple[AccuracyRow, ...]:
        """Rows for which no other row is better in both error and seconds, cheapest first."""
        return pareto(self.rows)

    @property
    def conclusion(self) -> str:
        """Conclusion of the measured rows in words."""
        return conclusion(self.rows, self.floors)

    @property
    def headline(self) -> str:
        """Conclusion of the measured rows in one sentence."""
        return headline(self.rows)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able form."""
        return {
            "format": 1,
            "design": self.design,
            "conclusion": self.conclusion,
            "reference": plain(self.reference),
            "rows": [row.to_dict() for row in self.rows],
            "pareto": [self.rows.index(row) for row in self.pareto()],
            "floors": [plain(floor.to_dict()) for floor in self.floors],
            "notes": list(self.notes),
            **({} if self.spectrum is None else {"spectrum": asdict(self.spectrum)}),
            **({} if self.made is None else {"made": plain(asdict(self.made))}),
        }
