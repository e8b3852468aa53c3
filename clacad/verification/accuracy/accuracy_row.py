"""One row of the accuracy table, a rung at a setting with its error and its seconds, and the front of the rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import isfinite
from typing import Any

from clacad.base.text import plain


@dataclass(frozen=True, slots=True)
class AccuracyRow:
    """One rung at one setting.

    Parameters
    ----------
    rung : "law", "thin", "surfaces", "mesh" or "step"
    setting : str
        Text for a person: "16 quads, facet normals, float32 vertices".
    model_rms, model_p95, model_max : float, radians
        Angle to the truth, caused by what the rung leaves out. The truth is rung surfaces in float64; the row of that
        rung holds its angle to a 50-digit trace of `checked` rays.
    law_rms, law_max : float, radians
        Angle to the requested law.
    disagree : float
        Share of rays whose fate or order differs from the truth.
    seconds : float
        Processor seconds of the trace alone, best of 3, warm.
    prepare_s : float
        Processor seconds of tessellating, reading or compiling before the first ray.
    rays : int
        Rays traced.
    checked : int
        Number of rays in the two model errors.
    bytes : int
        Geometry the rung reads.
    file_bytes : int or None
        Size of the file that holds this geometry for the whole sheet; None where there is no such file.
    memory : int
        Peak of arrays allocated by the trace, bytes.
    triangles : int
        Triangles of the whole sheet.
    quads : int or None
        Facets per cell side.
    normals : "facet", "vertex" or ""
    float : "f64" or "f32"
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


def pareto(rows: Sequence[AccuracyRow]) -> tuple[AccuracyRow, ...]:
    """Rows for which no other row is better in both error and seconds per ray, cheapest first."""
    front: list[AccuracyRow] = []
    for row in sorted(rows, key=lambda r: (r.seconds_per_ray, r.model_rms)):
        if isfinite(row.model_rms) and (not front or row.model_rms < front[-1].model_rms):
            front.append(row)
    return tuple(front)
