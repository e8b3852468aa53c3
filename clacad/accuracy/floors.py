"""Where accuracy stops paying: facets too fine for a file's numbers.

Facets err by a/m rad (m quads a cell side), rounding the vertices of facets of that size by b·m. The sum
in quadrature is least at m* = sqrt(a/b), with error sqrt(2 a b): the floor of the format. Both constants are
taken from the rows that were traced, the optimum is then traced itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, isfinite, sqrt
from typing import Any

import numpy as np

from clacad.accuracy.measure import Ladder, statistics
from clacad.accuracy.table import Row
from clacad.law import angle_between
from clacad.rays import Fate, Rays

FORMATS = (
    ("stl, 3mf as most readers hold it, glb", "f32"),
    ("ply, obj, 3mf as written", "f64"),
)
RAYS = 4096
CONFIRM = 256
"""Finest grid traced to confirm the forecast, quads a cell side; finer ones would take minutes."""


def floors(ladder: Ladder, rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Best facet grid and error of each family of formats, facet normals.

    Returns
    -------
    list of dicts
        formats, float, best_quads, floor (radians), facets of the whole sheet at best_quads, and for float32
        what a trace at `confirmed_quads` found beside what was forecast for it.
    """
    faceted = [r for r in rows if r.rung == "mesh" and r.normals == "facet" and r.float == "f64" and r.quads]
    if len(faceted) < 2:
        return []
    finest = max(faceted, key=lambda r: r.quads or 0)
    a = finest.model_rms * (finest.quads or 1)
    found = []
    for names, kind in FORMATS:
        quads = min(CONFIRM, 2 * (finest.quads or 1))
        exact_rms, rounded_rms, rounding = _traced(ladder, quads, kind)
        b = rounding / quads
        best = sqrt(a / b) if b > 0.0 else float("inf")
        found.append(
            {
                "formats": names, "float": kind, "best_quads": best if isfinite(best) else None,
                "floor": sqrt(2.0 * a * b), "facets": None if not isfinite(best) else _facets(ladder, best),
                "confirmed_quads": quads, "forecast": hypot(a / quads, b * quads), "traced": rounded_rms,
                "traced_unrounded": exact_rms,
            }
        )  # fmt: skip
    return found


def _facets(ladder: Ladder, quads: float) -> float:
    """Facets of the optical faces of the whole sheet."""
    faces = sum(face.array is not None for face in ladder.window.faces)
    return 2.0 * quads * quads * faces * ladder.window.lattice.cell_count


def _traced(ladder: Ladder, quads: int, kind: str) -> tuple[float, float, float]:
    """Error without and with rounded vertices, and the change that rounding makes, rms radians."""
    from clacad.accuracy.single import rounded
    from clacad.mesh import tessellate
    from clacad.trace import trace

    rays = Rays(ladder.rays.position[:RAYS], ladder.rays.direction[:RAYS])
    mesh = tessellate(ladder.window, quads=quads)
    plain = trace(ladder.window, rays, rung="mesh", mesh=mesh)
    alive = np.flatnonzero((plain.fate == Fate.ALIVE) & (ladder.truth.fate[:RAYS] == Fate.ALIVE))
    truth, asked = ladder.truth.direction[alive], ladder.asked[alive]
    exact = statistics(plain.direction[alive], truth, asked)[0]
    if kind == "f64":  # 53 bits: the rounding of a vertex relative to float32's 24
        single = _traced(ladder, quads, "f32")[2]
        return exact, exact, single * 2.0**-29
    cell = ladder.truth.cell[alive[0]]
    facets = rounded(mesh, (int(cell[0]), int(cell[1])), ladder.window.unit * 1e3)
    coarse = trace(ladder.window, rays, rung="mesh", mesh=facets)
    both = alive[coarse.fate[alive] == Fate.ALIVE]
    moved = angle_between(coarse.direction[both], plain.direction[both])
    error = statistics(coarse.direction[both], ladder.truth.direction[both], ladder.asked[both])[0]
    # a ray near a facet's edge may take the neighbouring facet: that is the facets' error, not the rounding's
    return exact, error, float(np.sqrt(np.mean(np.minimum(moved, np.percentile(moved, 99.0)) ** 2)))
