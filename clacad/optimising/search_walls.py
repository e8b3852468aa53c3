"""Walls of a search: constraints on the faces over the whole cell, not only where light of the field goes.

Each wall is a slack over its limit, at least 0 where the wall holds. Heights and slopes are evaluated at 21 ×
21 points of the optical zone and along its border; a face without a real height there counts as far beyond
the wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, isfinite

import numpy as np

from clacad.base.types import Floats
from clacad.design import Design
from clacad.design.process_profiles import profile
from clacad.optics.surface import Surface
from clacad.optimising.light_in_cells import LightInCells, ShareOfLight
from clacad.optimising.measured_light import FIELDS
from clacad.prescription.given import given_conics
from clacad.sheet.feasibility.convex_extremes import outline
from clacad.sheet.window import Body, Face, Window, in_optical_tile, lens_height_and_normal, optical_tile
from clacad.verification.check_kinds.process import SLOPE
from clacad.verification.check_kinds.shape import EDGE, NECK, RADIUS, SAG
from clacad.verification.design.process_rules import process_limit

GRID = 21
REAL = 0.02
"""Least value of the radicand of a face at any point of its cell."""

MARGIN = 0.005
"""Margin of a wall as a share of its limit, for the compliance of the search near the wall."""

STIFFNESS = 0.01
"""Residual (radians) of a wall that is violated by its whole limit."""

LOST = -1.0


@dataclass(frozen=True, eq=False)
class Walls:
    """Limits of a design, and the points at which they are evaluated.

    x, y : (n,) lengths
        Points of the optical zone, cell frame.
    normal_z : float
        Least z component of a normal.
    radius, sag : float, lengths
        Least radius and greatest height; 0 and infinite without one.
    thickness : (b,) lengths
        Least allowed thickness of each body in its cell.
    share : ShareOfLight
        Constraint on the light of the comparison cones that misses its cell.
    light : LightInCells or None
        With a field lens: constraint on the light of the full field that misses its cell.
    """

    x: Floats
    y: Floats
    normal_z: float
    radius: float
    sag: float
    thickness: tuple[float, ...]
    share: ShareOfLight
    light: LightInCells | None = None

    @staticmethod
    def of(design: Design, window: Window, field: float | None = None) -> Walls:
        """Walls of a design and its built start window; field in radians, None: the design's `check.field`."""
        rules = profile(design.check.process)
        kinds = (EDGE, NECK, RADIUS, SAG, SLOPE)
        edge, least_neck, radius, sag, slope = (process_limit(design, rules, kind)[0] for kind in kinds)
        tile = optical_tile(window)
        low, high = tile.min(axis=0), tile.max(axis=0)
        x, y = (g.ravel() for g in np.meshgrid(*(np.linspace(low[k], high[k], GRID) for k in (0, 1))))
        inside, rim = in_optical_tile(window, x, y), outline(tile, GRID)
        x, y = np.append(x[inside], rim[:, 0]), np.append(y[inside], rim[:, 1])
        neck = design.body.neck or min(window.lattice.pitch) / 50.0
        asked = max(edge, least_neck)
        cone = design.check.field if field is None else field
        needs = tuple(
            max(asked, min(neck, (1.0 - 2.0 * MARGIN) * _thinnest(body, x, y))) for body in window.bodies
        )
        return Walls(
            x,
            y,
            max(design.check.graph, cos(slope)),
            radius,
            sag,
            needs,
            ShareOfLight.of(window, [part * cone for part in FIELDS], design.check.field_centre),
            LightInCells.of(window),
        )

    def slack(self, window: Window) -> dict[str, float]:
        """Slack of every wall over its limit, in a fixed order; below 0: violated."""
        found: dict[str, float] = {}
        number = 0
        for body, need in zip(window.bodies, self.thickness, strict=True):
            heights = []
            for face in (body.front, body.back):
                number += 1
                z, normal = lens_height_and_normal(face, self.x, self.y)
                heights.append(z)
                if face.array is not None:
                    found |= self._of_face(face, f"face {number}", z, normal)
            if need > 0.0:
                thinnest = _least_apart(body, *heights)
                found[f"thickness of {body.name}"] = thinnest / need - 1.0 if isfinite(thinnest) else LOST
        found["share of light"] = self.share.slack(window)
        if self.light is not None:
            found["light in its cells"] = self.light.slack(window)
        return found

    def _of_face(self, face: Face, name: str, z: Floats, normal: Floats) -> dict[str, float]:
        """Walls of one face with heights z (n,), lengths, and normals (n, 3)."""
        x, y = self.x - face.vertex[0], self.y - face.vertex[1]
        points = np.column_stack([x, y, np.zeros_like(x)]) @ face.rotation
        found = {f"real height of {name}": _radicand(face.surface, points) - REAL}
        lost = not np.isfinite(z).all()
        found[f"slope of {name}"] = LOST if lost else float(normal[:, 2].min()) - self.normal_z
        if self.radius > 0.0:
            sharpest = max(abs(face.surface.curvature_x), abs(face.surface.curvature_y))
            found[f"radius of {name}"] = 1.0 - self.radius * sharpest
        if isfinite(self.sag):
            found[f"height of {name}"] = LOST if lost else 1.0 - float(np.ptp(z)) / self.sag
        if face.land is not None:
            proud = LOST if lost else float((face.side * (face.land - z)).min())
            found[f"{name} over its land"] = proud if lost else proud / max(float(np.ptp(z)), 1e-300)
        return found


def penalties(slack: dict[str, float]) -> Floats:
    """Residuals of the walls, (w,) radians: 0 outside their margins."""
    return STIFFNESS * np.maximum(0.0, MARGIN - np.array(list(slack.values())))


def _thinnest(body: Body, x: Floats, y: Floats) -> float:
    """Least thickness (length) over points (n,) of the zone, for a slab over any two cells; NaN without a
    face.
    """
    front, back = (lens_height_and_normal(face, x, y)[0] for face in (body.front, body.back))
    return _least_apart(body, front, back)


def _least_apart(body: Body, front: Floats, back: Floats) -> float:
    """Least thickness between heights (n,), lengths; for a slab, over every combination of cells."""
    return float((back - front).min() if body.columnar else back.min() - front.max())


def _radicand(surface: Surface, points: Floats) -> float:
    """Least 1 − (1 + K_x) c_x² x² − (1 + K_y) c_y² y² over points (n, 3) of the lens frame: finite where the height is not."""
    kx, ky = given_conics(surface)
    a, b = (1.0 + kx) * surface.curvature_x**2, (1.0 + ky) * surface.curvature_y**2
    return float((1.0 - a * points[:, 0] ** 2 - b * points[:, 1] ** 2).min())
