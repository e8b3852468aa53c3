"""A chess knight to look at through a sheet: turned foot, sculpted head, one watertight solid 1 high.

Run it to write chess-knight.stl beside this file:

    python designs/chess-knight.py

Every measure is a share of the height and may be changed here. The head faces −x; y is up, so that a scene
of clacad takes the file as it is: kind = "mesh", file = "../chess-knight.stl".
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Knight:
    """Measures of the piece, in heights.

    Parameters
    ----------
    foot : float
        Radius of the foot.
    collar : float
        Height where the turned part ends and the head begins.
    neck : float
        Thickness of the neck where it stands on the collar.
    crown : float
        Thickness at the crown.
    muzzle : float
        Thickness of the muzzle.
    rounding : float
        Radius of the rounded edges of the head.
    grooves : int
        Cuts in the mane.
    """

    foot: float = 0.25
    collar: float = 0.22
    neck: float = 0.25
    crown: float = 0.10
    muzzle: float = 0.11
    rounding: float = 0.018
    grooves: int = 7


def turned_foot(k: Knight) -> Any:
    """The foot: a profile of fillets and beads turned about y."""
    from build123d import Axis, BuildLine, BuildSketch, Line, Plane, RadiusArc, Spline, make_face, revolve

    r = k.foot
    with BuildSketch(Plane.XY) as profile:
        with BuildLine():
            Line((0, 0), (r, 0))
            Line((r, 0), (r, 0.035))
            RadiusArc((r, 0.035), (r - 0.018, 0.055), -0.022)
            Spline((r - 0.018, 0.055), (0.75 * r, 0.095), (0.62 * r, 0.15), (0.58 * r, k.collar - 0.03))
            RadiusArc((0.58 * r, k.collar - 0.03), (0.58 * r, k.collar + 0.012), -0.026)
            Line((0.58 * r, k.collar + 0.012), (0, k.collar + 0.012))
            Line((0, k.collar + 0.012), (0, 0))
        make_face()
    return revolve(profile.sketch, Axis.Y)


OUTLINE = {
    # side view, x to the right: the head looks to −x
    "back": [
        (0.140, 0.20),
        (0.190, 0.30),
        (0.212, 0.42),
        (0.212, 0.56),
        (0.188, 0.70),
        (0.140, 0.82),
        (0.074, 0.905),
    ],
    "ear": [(0.074, 0.905), (0.052, 1.000), (0.006, 0.925)],
    "face": [(0.006, 0.925), (-0.050, 0.885), (-0.105, 0.815), (-0.165, 0.725), (-0.222, 0.650)],
    "nose": [(-0.222, 0.650), (-0.245, 0.610), (-0.232, 0.560), (-0.195, 0.540)],
    "jaw": [(-0.195, 0.540), (-0.150, 0.548), (-0.100, 0.540), (-0.050, 0.562), (-0.010, 0.592)],
    "chest": [
        (-0.010, 0.592),
        (0.004, 0.540),
        (-0.020, 0.470),
        (-0.075, 0.385),
        (-0.115, 0.300),
        (-0.140, 0.20),
    ],
}
"""Curves of the side view, each smooth, in order round the head."""


def side_view(k: Knight) -> Any:
    """The head as cut from a board: the side view, thick enough for everything that follows."""
    from build123d import BuildLine, BuildSketch, Line, Plane, Polyline, Spline, extrude, make_face

    with BuildSketch(Plane.XY) as view:
        with BuildLine():
            for name, points in OUTLINE.items():
                Polyline(*points) if name == "ear" else Spline(*points)
            Line(OUTLINE["chest"][-1], OUTLINE["back"][0])
        make_face()
    return extrude(view.sketch, amount=0.2, both=True)


def front_view(k: Knight) -> Any:
    """The head as seen from the front: broad at the foot, drawn in at the crown."""
    from build123d import BuildLine, BuildSketch, Line, Plane, Spline, extrude, make_face

    a, b = 0.5 * k.neck, 0.5 * k.crown
    right = [
        (a, 0.20),
        (0.92 * a, 0.36),
        (0.74 * a, 0.52),
        (0.72 * a, 0.66),
        (0.66 * a, 0.78),
        (b, 0.90),
        (0.55 * b, 1.0),
    ]
    left = [(-x, y) for x, y in reversed(right)]
    with BuildSketch(Plane.ZY) as view:
        with BuildLine():
            Spline(*right)
            Line(right[-1], left[0])
            Spline(*left)
            Line(left[-1], right[0])
        make_face()
    return extrude(view.sketch, amount=0.4, both=True)


def top_view(k: Knight) -> Any:
    """The head as seen from above: a narrow muzzle in front of broad cheeks."""
    from build123d import BuildLine, BuildSketch, Line, Plane, Spline, extrude, make_face

    m, c = 0.5 * k.muzzle, 0.5 * k.neck
    edge = [(-0.30, 0.8 * m), (-0.20, m), (-0.10, 0.80 * c), (0.02, c), (0.12, 1.02 * c), (0.24, 0.80 * c)]
    other = [(x, -z) for x, z in reversed(edge)]
    with BuildSketch(Plane.XZ) as view:
        with BuildLine():
            Spline(*edge)
            Line(edge[-1], other[0])
            Spline(*other)
            Line(other[-1], edge[0])
        make_face()
    return extrude(view.sketch, amount=2.0, both=True)


def carved(head: Any, k: Knight) -> Any:
    """Eyes, nostrils, mouth and mane cut into the head."""
    from build123d import Box, Cylinder, Location, Pos, Rot, Sphere

    for side in (-1, 1):
        head -= Pos(-0.068, 0.775, side * 0.092) * Sphere(0.030)
        head -= Pos(-0.205, 0.622, side * 0.064) * Sphere(0.016)
        for n in range(k.grooves):  # the mane: slanting cuts along the back
            share = (n + 0.5) / k.grooves
            x, y = 0.196 - 0.10 * share**2, 0.36 + 0.50 * share
            cut = Location((x, y, side * 0.115), (0, 0, 58 - 22 * share)) * Rot(90, 0, 0)
            head -= cut * Box(0.13, 0.05, 0.012)
    return (
        head
        - Pos(-0.215, 0.585, 0) * Rot(0, 0, 14) * Box(0.12, 0.012, 0.4)
        - Pos(-0.155, 0.57, 0) * Cylinder(0.010, 0.4)
    )


def knight(k: Knight | None = None) -> Any:
    """The whole piece, one solid (build123d)."""
    from build123d import Solid

    k = Knight() if k is None else k
    head = side_view(k) & front_view(k) & top_view(k)
    head = carved(rounded(head, k.rounding), k)
    piece = turned_foot(k) + head
    solids = piece.solids()
    if len(solids) != 1:
        raise ValueError(f"the measures give {len(solids)} pieces, not one")
    made: Solid = solids[0]
    return made


def rounded(head: Any, radius: float) -> Any:
    """Round the long edges of the head, as many as the kernel can, thinnest first left sharp."""
    from build123d import fillet

    for part in (1.0, 0.6, 0.35):
        edges = [edge for edge in head.edges() if edge.length > 3.0 * radius and edge.center().Y > 0.24]
        try:
            made = fillet(edges, part * radius)
        except (ValueError, RuntimeError):
            continue
        if made.is_valid:
            return made
    return head


def triangles(piece: Any, tolerance: float = 1.5e-3, angle: float = 0.4) -> Any:
    """Corners (t, 3, 3) of a closed mesh of the piece, float32: welded, triangles without area dropped.

    Parameters
    ----------
    tolerance : float
        Largest distance between mesh and surface, heights.
    angle : float
        Largest turn between neighbouring facets of a curve, radians.
    """
    import numpy as np

    points, faces = piece.tessellate(tolerance, angle)
    corners = np.array([[p.X, p.Y, p.Z] for p in points]).round(6).astype(np.float32)
    _, weld = np.unique(corners, axis=0, return_inverse=True)
    named = weld.reshape(-1)[np.array(faces)]
    real = (named[:, 0] != named[:, 1]) & (named[:, 1] != named[:, 2]) & (named[:, 2] != named[:, 0])
    return corners[np.array(faces)[real]]


def write_stl(corners: Any, path: Path) -> None:
    """Write binary STL: the same triangles give the same bytes."""
    import numpy as np

    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float64)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    rows = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    rows["normal"], rows["corners"] = normal, corners
    head = b"chess knight, 1 high, y up".ljust(80, b" ") + np.uint32(len(rows)).tobytes()
    path.write_bytes(head + rows.tobytes())


def main() -> None:
    """Write chess-knight.stl beside this file."""
    write_stl(triangles(knight()), HERE / "chess-knight.stl")


if __name__ == "__main__":
    main()
