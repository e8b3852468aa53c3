"""A small accuracy ladder for the report: the same rays on every rung, each with its error and its cost.

Seconds change from run to run and a report must not. The page therefore shows a forecast of the time from
the rates
below. Times measured in one run go to the run facts, and into the report only on request. Every rung traces
these few
rays in numpy: compiling its kernels would take longer than the rest of a report.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from clacad.base.types import Progress
from clacad.sheet.window import Window
from clacad.verification.accuracy.accuracy_row import AccuracyRow

if TYPE_CHECKING:
    from clacad.design import Design

RAYS = 8192
ORACLE_RAYS = 128
QUADS = (4, 8, 16, 32)

MICROSECONDS = {"law": 0.05, "thin": 0.25, "surfaces": 0.07, "mesh": 0.16, "mesh, a quad of the side": 0.003}
"""Forecast of the processor time of one ray in compiled kernels, by rung, µs.

The values are geometric means over traces of 20 000 rays through four shipped designs (plano, window-100mm,
tilted-biconvex, hexagonal) on one core of an ordinary server. A design may differ from it by a factor of 8,
because
tilted lenses and hexagons cost more; another machine scales all points alike.
"""


@dataclass(frozen=True, eq=False)
class Ladder:
    """Rows of the ladder, their forecast microseconds per ray, and the error of the truth itself.

    rows : tuple of clacad.verification.accuracy.accuracy_row.AccuracyRow
    forecast : tuple of float, microseconds
    reference : float, radians
        Rms of the truth against a trace in 50 digits.
    """

    rows: tuple[AccuracyRow, ...]
    forecast: tuple[float, ...]
    reference: float

    @property
    def conclusion(self) -> str:
        """Conclusion from the errors and the forecast of the time, in words."""
        from clacad.verification.accuracy.accuracy_row import conclusion

        rows = [
            replace(row, seconds=1e-6 * us * row.rays)
            for row, us in zip(self.rows, self.forecast, strict=True)
        ]
        return f"{conclusion(rows)} Times are forecasts."

    def measured(self) -> list[dict[str, Any]]:
        """Run facts: seconds of this run, rung by rung."""
        return [
            {
                "rung": r.rung,
                "setting": r.setting,
                "seconds": r.seconds,
                "prepare_s": r.prepare_s,
                "rays": r.rays,
            }
            for r in self.rows
        ]

    def to_dict(self) -> list[dict[str, Any]]:
        """Numbers for the report, without measured times."""
        return [
            {
                "rung": r.rung,
                "setting": r.setting,
                "model_rms": r.model_rms,
                "model_max": r.model_max,
                "law_rms": r.law_rms,
                "law_max": r.law_max,
                "disagree": r.disagree,
                "rays": r.rays,
                "quads": r.quads,
                "normals": r.normals,
                "triangles": r.triangles,
                "forecast_us": us,
            }
            for r, us in zip(self.rows, self.forecast, strict=True)
        ]


def climb(design: Design, window: Window, progress: Progress) -> Ladder:
    """Trace one bundle on the rungs law, thin, surfaces, and mesh at some refinements."""
    from functools import partial

    from clacad.mesh import tessellate
    from clacad.sheet.asked_focus import RequestedLaw
    from clacad.sheet.bundle import bundle
    from clacad.tracing.trace import trace
    from clacad.verification.accuracy import measure_rungs

    lit = bundle(window, RAYS, design.check.field, design.check.field_centre)
    ladder = measure_rungs.TracedRays(
        window, lit.rays, trace(window, lit.rays, path="size"), RequestedLaw.of(window).expected(lit)
    )
    known = measure_rungs.reference(ladder, ORACLE_RAYS)["rms"]
    rows, forecast = [], []
    exact: tuple[Literal["law", "thin", "surfaces"], ...] = ("law", "thin", "surfaces")
    for number, rung in enumerate(exact):
        progress("accuracy against time", 0.1 * number)
        found = measure_rungs.row(
            ladder, rung, "exact", partial(trace, window, lit.rays, rung=rung, path="size"), repeats=0
        )
        rows.append(replace(found, model_rms=known) if rung == "surfaces" else found)
        forecast.append(MICROSECONDS[rung])
    for number, quads in enumerate(QUADS):
        progress("accuracy against time", 0.3 + 0.7 * number / len(QUADS))
        mesh = tessellate(window, quads=quads)
        for normals in ("facet", "vertex"):
            run = partial(trace, window, lit.rays, rung="mesh", mesh=mesh, normals=normals, path="size")
            found = measure_rungs.row(ladder, "mesh", f"{quads} quads, {normals} normals", run, repeats=0)
            rows.append(replace(found, quads=quads, normals=normals, triangles=mesh.facet_count))
            forecast.append(MICROSECONDS["mesh"] + MICROSECONDS["mesh, a quad of the side"] * quads)
    return Ladder(tuple(rows), tuple(forecast), known)
