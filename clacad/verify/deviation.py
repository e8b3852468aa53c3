"""How far facets lie from the design's faces, in height and in slope, and what that does to light."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from clacad.sheet import Face, Window, face_height, lens_height_and_normal
from clacad.sobol import sobol
from clacad.verify.bundle import over_cell
from clacad.verify.facets import ExactFace, FacetBody, FacetFace, Floats, first_crossing
from clacad.vignetting import focal_ratio

POINTS = 8192
"""Places over a cell at which facets are compared with the exact faces."""


@dataclass(frozen=True, eq=False)
class Deviation:
    """Facets of one telescopelet against the design's faces, in the order of the light.

    slope : (faces, n, 2) slopes along lens x, y
        Facet slope less exact slope at the same n places of the cell; NaN where a facet or a lens is missing, 0
        for a plane or a face that is not in the file.
    distance : (faces,) lengths
        Largest distance along the normal.
    """

    slope: Floats
    distance: Floats

    @property
    def slope_rms(self) -> Floats:
        """(faces,) rms slope error, radians."""
        found = []
        for slope in self.slope:
            known = slope[np.isfinite(slope).all(axis=1)]
            found.append(float(np.sqrt((known**2).sum(axis=1).mean())) if len(known) else np.nan)
        return np.array(found)

    @property
    def complete(self) -> bool:
        """Whether every face has facets over nearly all of the cell."""
        return bool((np.isfinite(self.slope).all(axis=2).mean(axis=1) > 0.5).all())


def deviation(window: Window, bodies: tuple[FacetBody, ...]) -> Deviation:
    """Compare the facets of a telescopelet with the exact faces at `POINTS` places spread evenly over the cell."""
    points = over_cell(window, sobol(POINTS, 2))
    slope, distance = [], []
    for piece, body in zip(bodies, window.bodies, strict=True):
        for facets, face in ((piece.front, body.front), (piece.back, body.back)):
            turn, off = _compare(window, facets, face, points, entering=facets is piece.front)
            slope.append(turn)
            distance.append(off)
    return Deviation(np.array(slope), np.array(distance))


def _compare(
    window: Window, facets: FacetFace | ExactFace, face: Face, points: Floats, entering: bool
) -> tuple[Floats, float]:
    """Slope error (n, 2) and largest distance of one face's facets; vertical light finds the facet over a place."""
    if isinstance(facets, ExactFace):
        return np.zeros_like(points), 0.0
    start = np.column_stack(
        [points + facets.origin[:2], np.full(len(points), facets.origin[2] + facets.z_range[0])]
    )
    start[:, 2] -= np.ptp(facets.z_range) + window.lattice.circumradius
    up = np.broadcast_to([0.0, 0.0, 1.0], start.shape)
    height, number = first_crossing(facets, start, up, entering)
    if not (number >= 0).any():
        return np.full_like(points, np.nan), np.nan
    z = start[:, 2] + height
    exact = face_height(window, face, points[:, 0], points[:, 1])
    if face.array is None:
        return np.zeros_like(points), float(np.nanmax(np.abs(z - exact)))
    lens, normal = lens_height_and_normal(face, points[:, 0], points[:, 1])
    on_lens = np.isfinite(lens) & (lens == exact) & (number >= 0)
    flat = facets.normals[number]
    turn = -flat[:, :2] / flat[:, 2:] + normal[:, :2] / normal[:, 2:]
    turn = turn @ face.rotation[:2, :2]
    off = np.abs(z - exact) * np.nan_to_num(normal[:, 2], nan=1.0)
    known = np.isfinite(off)
    return np.where(on_lens[:, None], turn, np.nan), float(off[known].max()) if known.any() else np.nan


def forecast_rms(window: Window, found: Deviation) -> float:
    """Direction error (radians) that the facets' slope errors make.

    A lens turns light by (n − 1) times the slope of its thickness, so the errors of its two faces at one place
    are added before they are squared (they agree where both faces are cut alike); lens 1's error leaves the
    pair as 1/m per meridian.
    """
    ratio = np.array(focal_ratio(window.thin))
    turns: dict[int, Floats] = {}
    number = 0
    for body in window.bodies:
        for face, sign in ((body.front, -1.0), (body.back, 1.0)):
            if face.array is not None:
                error = sign * (body.index - 1.0) * found.slope[number]
                turns[face.array] = turns.get(face.array, 0.0) + error
            number += 1
    total = 0.0
    for array, turn in turns.items():
        known = np.isfinite(turn).all(axis=1)
        if not known.any():
            return float("nan")
        gain = 1.0 / ratio if array == 0 else np.ones(2)
        total += float(((turn[known] * gain) ** 2).sum(axis=1).mean())
    return sqrt(total)


def corner_distance(window: Window, face: Face, corners: Floats, place: Floats) -> float:
    """Largest distance of facet corners (k, 3, 3) from the design's face over the cell at `place` (length)."""
    local = corners.reshape(-1, 3) - [*place, 0.0]
    # a corner on a border is asked a hair inside, where the face is sure to be the cell's own
    inside = local[:, :2] * (1.0 - 1e-12)
    z = face_height(window, face, inside[:, 0], inside[:, 1])
    if face.array is None:
        return float(np.abs(local[:, 2] - z).max())
    _, normal = lens_height_and_normal(face, inside[:, 0], inside[:, 1])
    off = np.abs(local[:, 2] - z) * np.nan_to_num(normal[:, 2], nan=1.0)
    known = np.isfinite(off)
    return float(off[known].max()) if known.any() else float("nan")
