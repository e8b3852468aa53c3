"""Conclusion of an accuracy table in up to three sentences: cost of exact faces, value of a mesh, the exact file."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import TYPE_CHECKING

from clacad.verification.accuracy.accuracy_row import AccuracyRow, pareto

if TYPE_CHECKING:
    from clacad.verification.accuracy.file_floors import Floor


def conclusion(rows: Sequence[AccuracyRow], floors: Sequence[Floor] = ()) -> str:
    """Conclusion of the rows of a table in words; for a non-uniform sheet from the rows of the sheet itself.

    Parameters
    ----------
    rows : sequence of AccuracyRow
        Their errors (radians) and seconds are the only numbers used.
    floors : sequence of Floor
        Least error of each family of file formats.
    """
    own = any(row.own_cells for row in rows)
    traced = [row for row in rows if row.own_cells == own and row.rung != "step"]
    return " ".join(text for text in (_exact(traced), _mesh(traced), _files(rows, floors)) if text)


def _exact(rows: Sequence[AccuracyRow]) -> str:
    exact, law = _row(rows, "surfaces"), _row(rows, "law")
    if exact is None:
        return ""
    cost = ""
    if law is not None and law.seconds > 0.0 and exact.seconds > 0.0:
        cost = f"cost {exact.seconds_per_ray / law.seconds_per_ray:.2g} × the law and "
    if not isfinite(exact.model_rms):
        return f"Exact faces {cost}were not compared with a trace of more digits."
    return f"Exact faces {cost}are within {_mrad(exact.model_rms)} mrad rms of a 50-digit trace."


def _mesh(rows: Sequence[AccuracyRow]) -> str:
    exact, meshes = _row(rows, "surfaces"), [row for row in rows if row.rung == "mesh"]
    known = [row for row in meshes if isfinite(row.model_rms)]
    if not known or exact is None or exact.seconds <= 0.0:
        return ""
    worth = [row for row in pareto(rows) if row.rung == "mesh"]
    best = min(worth or known, key=lambda row: row.model_rms)
    what = f"{best.quads} quads a cell side with {best.normals} normals"
    cost = f"{best.seconds_per_ray / exact.seconds_per_ray:.2g} × the time of exact faces and leaves {_mrad(best.model_rms)} mrad"
    if worth:
        return f"A mesh is worth tracing for speed alone: {what} takes {cost}."
    return f"No mesh is worth tracing, for each is beaten in both error and time: the most exact, {what}, takes {cost}."


def _files(rows: Sequence[AccuracyRow], floors: Sequence[Floor]) -> str:
    from clacad.exporting.formats import stl
    from clacad.exporting.limits import size_text

    step = _row(rows, "step")
    faceted = [
        one
        for one in floors
        if one.normals == "facet" and one.floor is not None and stl.WORD in one.formats.split(", ")
    ]
    parts = []
    if step is not None and isfinite(step.model_rms):
        size = "" if step.file_bytes is None else f" in {size_text(step.file_bytes)}"
        parts.append(f"STEP is within {_mrad(step.model_rms)} mrad{size}")
    parts += [f"STL comes no closer than {_mrad(one.floor)} mrad at any size" for one in faceted[:1]]
    return f"Of files, {'; '.join(parts)}." if parts else ""


def _row(rows: Sequence[AccuracyRow], rung: str) -> AccuracyRow | None:
    return next((row for row in rows if row.rung == rung and row.float == "f64"), None)


def _mrad(radians: float) -> str:
    return f"{1e3 * radians:.2g}"
