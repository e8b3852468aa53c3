"""The table: one row a rung and setting, its error beside its time, and the cheapest that is good enough."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import isfinite
from typing import TYPE_CHECKING, Any

from clacad.base.text import plain

if TYPE_CHECKING:
    from clacad.verification.accuracy.file_floors import Floor

MOST_DISAGREEMENT = 0.01
"""Share of rays whose fate or order may differ from the truth for a setting to be chosen."""


class TargetOutOfReach(ValueError):
    """No setting meets the asked error; exit status 3."""

    exit_status = 3


@dataclass(frozen=True, slots=True)
class AccuracyRow:
    """One rung at one setting.

    Parameters
    ----------
    rung : "law", "thin", "surfaces", "mesh" or "step"
    setting : str
        For a person: "16 quads, facet normals, float32 vertices".
    model_rms, model_p95, model_max : float, radians
        Angle to the truth: what this rung leaves out. The truth is rung surfaces in float64; that rung's own row
        holds its angle to a 50-digit trace of `checked` rays.
    law_rms, law_max : float, radians
        Angle to the asked law.
    disagree : float
        Share of rays whose fate or order differs from the truth.
    seconds : float
        Processor seconds of the trace alone, best of 3, warm.
    prepare_s : float
        Processor seconds of tessellating, reading or compiling before the first ray.
    rays : int
        Rays traced.
    checked : int
        Rays the two model errors are taken over.
    bytes : int
        Geometry the rung reads.
    file_bytes : int or None
        Size of the file that carries this geometry for the whole sheet; None where there is no such file.
    memory : int
        Peak of arrays allocated by the trace, bytes.
    triangles : int
        Of the whole sheet.
    quads : int or None
        Facets per cell side.
    normals : "facet", "vertex" or ""
    float : "f64" or "f32"
    own_cells : bool
        Of a sheet whose cells differ: whether the sheet itself was traced, not one of equal cells like its worst cell.
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
    float: str = "f64"
    own_cells: bool = False

    @property
    def rays_per_s(self) -> Any:
        """Rays per processor second."""
        return self.rays / self.seconds if self.seconds > 0 else 0.0

    @property
    def seconds_per_ray(self) -> Any:
        """Processor seconds of one ray: rows of different numbers of rays compare by it."""
        return self.seconds / max(1, self.rays)

    def predicted_seconds(self, rays: int) -> Any:
        """Processor seconds for another number of rays, preparation included."""
        return self.prepare_s + self.seconds_per_ray * rays

    def to_dict(self) -> dict[str, Any]:
        """JSON-able form; what was not measured is null."""
        found = {**plain(asdict(self)), "rays_per_s": self.rays_per_s}
        if not self.own_cells:
            del found["own_cells"]
        return found


@dataclass(frozen=True)
class AccuracyTable:
    """What `clacad.accuracy` returns.

    Parameters
    ----------
    design : str
    rows : tuple of AccuracyRow
    reference : mapping
        The 50-digit check of the truth: rays, rms, max.
    floors : tuple of Floor
        Where accuracy stops paying: for each family of file formats the best facet grid and its error.
    notes : tuple of str
    """

    design: str
    rows: tuple[AccuracyRow, ...]
    reference: Mapping[str, float]
    floors: tuple[Floor, ...] = ()
    notes: tuple[str, ...] = ()
    target: float | None = None
    rays: int = field(default=0)

    def __repr__(self) -> str:
        return f"AccuracyTable({self.design!r}, {len(self.rows)} settings, {self.rays} rays each)"

    def cheapest(
        self, target: float, rays: int | None = None, rungs: Sequence[str] | None = None
    ) -> AccuracyRow:
        """Row with the least predicted seconds whose model_rms is within `target` (radians); where cells differ, of the sheet itself.

        Parameters
        ----------
        target : float, radians
        rays : int or None
            How many rays shall be traced; default as in the table.
        rungs : sequence of str or None
            Only these rungs.

        Raises
        ------
        TargetOutOfReach
            With the closest row.
        """
        count = rays or max((row.rays for row in self.rows), default=1)
        own = any(row.own_cells for row in self.rows)
        open_to = [row for row in self.rows if (rungs is None or row.rung in rungs) and row.own_cells == own]
        good = [row for row in open_to if row.model_rms <= target and row.disagree <= MOST_DISAGREEMENT]
        if good:
            return min(good, key=lambda row: (row.predicted_seconds(count), row.model_rms))
        closest = min(open_to, key=lambda row: (row.disagree > MOST_DISAGREEMENT, row.model_rms))
        raise TargetOutOfReach(
            f"no setting is within {1e3 * target:.4g} mrad; the closest is {closest.rung} {closest.setting} with "
            f"{1e3 * closest.model_rms:.4g} mrad and {closest.disagree:.2%} of the rays in another fate"
        )

    def pareto(self) -> tuple[AccuracyRow, ...]:
        """Rows that no other row beats in both error and seconds, cheapest first."""
        return pareto(self.rows)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able form."""
        return {
            "format": 1,
            "design": self.design,
            "reference": plain(self.reference),
            "rows": [row.to_dict() for row in self.rows],
            "pareto": [self.rows.index(row) for row in self.pareto()],
            "floors": [plain(floor.to_dict()) for floor in self.floors],
            "notes": list(self.notes),
        }


def pareto(rows: Sequence[AccuracyRow]) -> tuple[AccuracyRow, ...]:
    """Rows that no other beats in both error and seconds a ray, cheapest first."""
    front: list[AccuracyRow] = []
    for row in sorted(rows, key=lambda r: (r.seconds_per_ray, r.model_rms)):
        if isfinite(row.model_rms) and (not front or row.model_rms < front[-1].model_rms):
            front.append(row)
    return tuple(front)
