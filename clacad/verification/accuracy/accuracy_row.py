"""One row of the accuracy table, a rung at a setting with its error and its seconds, and the front of many rows."""

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


def pareto(rows: Sequence[AccuracyRow]) -> tuple[AccuracyRow, ...]:
    """Rows that no other beats in both error and seconds a ray, cheapest first."""
    front: list[AccuracyRow] = []
    for row in sorted(rows, key=lambda r: (r.seconds_per_ray, r.model_rms)):
        if isfinite(row.model_rms) and (not front or row.model_rms < front[-1].model_rms):
            front.append(row)
    return tuple(front)
