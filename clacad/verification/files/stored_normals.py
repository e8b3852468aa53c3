"""Stored vertex normals of a file, compared with the normals of the design's own faces; renderers shade with them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clacad.base.types import Floats
from clacad.exporting.compare_instances import owner
from clacad.optics.law.angle import angle_between
from clacad.sheet.like_cell import like_cell
from clacad.sheet.window import Face, Window, lens_height_and_normal
from clacad.tracing.triangles.telescopelet_facets import on_land
from clacad.verification.check_kinds.file_light import FILE_NORMALS
from clacad.verification.checks import Check
from clacad.verification.files.cell_triangles import CellFacets
from clacad.verification.files.facet_deviation import Deviation
from clacad.verification.limit_sources import other

STEEPER = 2.0
"""Rms error of the stored normals over the slope error of their facets, beyond which the normals are wrong."""

ROOM = 1e-6
"""Radians by which rounding to float32, or to six digits, may turn a normal."""


def normals_check(window: Window, gathered: CellFacets, off: Sequence[Deviation], name: str) -> Check | None:
    """Judge the normals stored in a file over the chosen cells; None where the file has none.

    Parameters
    ----------
    window : Window
    gathered : CellFacets
        With the facets' stored normals.
    off : sequence of Deviation
        Of these cells.
    name : str
        File name, the subject of the check.
    """
    if not gathered.stored:
        return None
    common: dict[str, Any] = {"where": "file", "subject": name, "unit": "rad",
                              "limit_source": other(f"{STEEPER:g} × slope error of its facets")}  # fmt: skip
    if gathered.odd:
        text = f"{gathered.odd} of {gathered.stored} facets have a stored normal that is no unit vector"
        return FILE_NORMALS.check("fail", text, None, **common)
    if gathered.inward:
        text = f"the stored normals of {gathered.inward} of {gathered.stored} facets point inward"
        return FILE_NORMALS.check("fail", text, None, **common)
    worst, limit, text = -1.0, 0.0, "no lens face has stored normals"
    for cell, index in enumerate(gathered.cells):
        if gathered.source(cell) != cell:
            continue
        for face, (body, side) in enumerate((b, s) for b in range(len(window.bodies)) for s in (0, 1)):
            rms = _rms(window, gathered, body, side, cell)
            room = STEEPER * float(np.nan_to_num(off[cell].slope_rms[face])) + ROOM
            if rms is not None and rms / room > worst / (limit or 1.0):
                label = f"{window.bodies[body].name} {('front', 'back')[side]}"
                worst, limit = rms, room
                text = f"stored normals are up to {1e3 * rms:.4g} mrad rms off the exact faces ({label}, cell {index})"
    if worst < 0.0:
        return FILE_NORMALS.check("not run", text, **{**common, "required": False})
    return FILE_NORMALS.check("pass" if worst <= limit else "fail", text, worst, limit, **common)


def _rms(window: Window, gathered: CellFacets, body: int, side: int, cell: int) -> float | None:
    """Rms angle (radians) between stored and exact normals of one side of a body over a chosen cell."""
    normals = gathered.corner_normals(body, side, cell)
    if normals is None or not len(normals):
        return None
    index = np.array(gathered.cells[cell], dtype=np.int64)
    window = like_cell(window, index, widest=False)
    piece = window.bodies[body]
    face = (piece.front, piece.back)[side]
    local = gathered.corners(body, side, cell) - [*window.centres(owner(piece, face), index), 0.0]
    angle = angle_between(exact_normals(window, face, local), normals)
    angle = angle[np.isfinite(angle)]
    return float(np.sqrt(np.mean(angle**2))) if len(angle) else None


def exact_normals(window: Window, face: Face, local: Floats) -> Floats:
    """Outward unit normals (k, 3, 3) of the design at the corners of facets, cell frame; NaN where it has no lens."""
    out = np.zeros_like(local)
    out[..., 2] = -face.side
    if face.array is None:
        return out
    _, normal = lens_height_and_normal(face, local[..., 0].ravel(), local[..., 1].ravel())
    flat = on_land(window, face, local)
    return np.where(flat[:, None, None], out, normal.reshape(local.shape) * -face.side)
