"""Features that matter to a process: grooves, walls, slopes, thin and tall features,
computed from the faces.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import acos, asin, inf

import numpy as np

from clacad.base.types import Floats
from clacad.optics.surface import principal_radii
from clacad.sheet.feasibility.convex_extremes import border
from clacad.sheet.feasibility.derived_numbers import Feasibility
from clacad.sheet.window import Face, Window, lens_height_and_normal, optical_tile

FINE = 20
"""Least voxels across a lenslet to resolve it, and least layers in its height to avoid stairs."""


@dataclass(frozen=True, slots=True)
class Named:
    """A number and its description."""

    value: float
    what: str


def wall(window: Window, facts: Feasibility) -> Named:
    """Highest vertical wall on the optical sides (length): a step between neighbours, or the edge of a
    seam.
    """
    found = [Named(body.step, f"the step between neighbours of {body.name}") for body in facts.bodies]
    if window.land.seam > 0.0:
        found += [
            Named(_edge_of_seam(window, face), f"the edge of the seam on {name}")
            for name, face in _lens_faces(window)
            if face.land is not None
        ]
    return max(found, key=lambda n: n.value)


def groove(window: Window, radius: float) -> Named:
    """Greatest share of a cell's width that a tool of this nose radius (length) leaves rounded at the
    grooves.

    Where two faces meet in an inner corner of turning angle τ, the nose touches them r·tan(τ/2) before it.
    Between
    two spheres of radius R without a seam the share is r/R in the middle of a border and r/√(R² − p²/4) at
    its
    ends, where the slopes across it are steepest. A concave lens has no groove at its border, but a nose
    larger than
    its radius does not fit in at all: 1.
    """
    return max(
        (_rounded(window, name, face, radius) for name, face in _lens_faces(window)), key=lambda n: n.value
    )


def steepest(facts: Feasibility) -> Named:
    """Steepest slope of a lens face against the sheet (radians)."""
    lens = min(facts.lenses, key=lambda lens: lens.least_normal_z)
    return Named(acos(min(1.0, max(-1.0, lens.least_normal_z))), lens.name)


def draft(window: Window, facts: Feasibility, negligible: float) -> Named:
    """Least angle of any surface that must release to the sheet's normal (radians); 0 for a vertical wall.

    negligible : float, length
        Walls lower than this do not count.
    """
    step = wall(window, facts)
    if step.value > negligible:
        return Named(0.0, step.what)
    lens = min(facts.lenses, key=lambda lens: lens.least_normal_z)
    return Named(asin(min(1.0, max(-1.0, lens.least_normal_z))), lens.name)


def narrowest(window: Window) -> Named:
    """Narrowest feature that must be resolved across the sheet (length), halved where two voxels must fit."""
    found = [Named(min(window.lattice.pitch) / FINE, f"a {FINE}th of the pitch")]
    if window.land.seam > 0.0:
        found.append(Named(0.5 * window.land.seam, "half of the seam"))
    if window.baffle is not None:
        found.append(Named(0.5 * window.baffle.wall, "half of the baffle's wall"))
    return min(found, key=lambda n: n.value)


def shallowest(facts: Feasibility) -> Named:
    """Layer height that shapes the flatter lens in the least number of layers (length)."""
    lens = min(facts.lenses, key=lambda lens: lens.sag)
    return Named(lens.sag / FINE, f"a {FINE}th of the height of {lens.name}")


def tallest(window: Window, facts: Feasibility) -> Named:
    """Greatest height over width of a lens, a seam or a baffle's wall."""
    found = [
        Named(lens.sag / min(window.lattice.pitch), f"{lens.name} over the pitch") for lens in facts.lenses
    ]
    if window.land.seam > 0.0:
        deepest = max(
            (_edge_of_seam(window, f) for _, f in _lens_faces(window) if f.land is not None), default=0.0
        )
        found.append(Named(deepest / window.land.seam, "the depth of the seam over its width"))
    if window.baffle is not None and len(facts.bodies) > 1:
        height = max(above.low - below.high for below, above in pairwise(facts.bodies))
        found.append(Named(height / window.baffle.wall, "the baffle's height over its wall"))
    return max(found, key=lambda n: n.value)


def _lens_faces(window: Window) -> Iterator[tuple[str, Face]]:
    for body in window.bodies:
        for side, face in (("front", body.front), ("back", body.back)):
            if face.array is not None:
                yield f"the {side} of {body.name}", face


def _edge_of_seam(window: Window, face: Face) -> float:
    """Height of the lens over its land along the border of its zone."""
    assert face.land is not None
    tile = optical_tile(window)
    rim = np.concatenate([border(tile, k, 65) for k in range(len(tile))])
    z, _ = lens_height_and_normal(face, *rim.T)
    proud = face.side * (face.land - z)
    return float(np.nanmax(np.where(proud > 0.0, proud, 0.0)))


def _rounded(window: Window, name: str, face: Face, radius: float) -> Named:
    """Greatest share of a cell's width that a tool's nose leaves rounded on one face; see `groove`."""
    concave = [abs(r) for r in principal_radii(face.surface) if r < 0.0]
    if concave and min(concave) < radius:
        return Named(1.0, f"{name}, whose hollows are smaller than the tool")
    tile, worst = optical_tile(window), 0.0
    seam = window.land.seam > 0.0
    for number, step in enumerate(window.lattice.steps[: len(window.lattice.steps) // 2]):
        here = border(tile, number, 65)
        offset = np.asarray(window.lattice.offset(*step))
        outward, width = offset / np.linalg.norm(offset), float(np.linalg.norm(offset))
        # the neighbour is identical: its side of the border is the opposite side of this cell
        across = here - outward * 2.0 * (here @ outward)[:, None]
        angles = [_falling(face, here, outward), _falling(face, across, -outward)]
        if seam:
            lost = sum(np.tan(0.5 * np.maximum(a, 0.0)) * np.cos(a) for a in angles)
        else:
            turning = np.maximum(angles[0] + angles[1], 0.0)
            lost = np.tan(0.5 * turning) * (np.cos(angles[0]) + np.cos(angles[1]))
        worst = max(worst, radius * float(np.nanmax(lost, initial=0.0)) / width)
    return Named(min(1.0, worst), name) if worst < inf else Named(1.0, name)


def _falling(face: Face, points: Floats, outward: Floats) -> Floats:
    """Angle (n,) by which a face falls back into its material towards its border."""
    _, normal = lens_height_and_normal(face, *points.T)
    rise = -(normal[:, :2] @ outward) / normal[:, 2]
    return np.asarray(np.arctan(face.side * rise))
