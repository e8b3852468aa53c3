"""Ends of the lenses of a cell: their common rims, and those on their land. Lengths in mm, cell frame.

A plane cuts a quadric in a conic, whose arcs are exact; all other rims are fitted
(`clacad.solid.fitted_rims`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clacad.base.text import rounded_up
from clacad.base.types import Floats
from clacad.sheet.window import Face
from clacad.solid.face_pattern import Kind, Pattern, Proud, divided_pattern, plain_pattern
from clacad.solid.fitted_rims import Gap, Graph, Rim, fitted_rim, lens_graph, level_graph
from clacad.solid.lens_faces import posed_quadric
from clacad.solid.rational_conics import Arc, PosedQuadric, section_arc
from clacad.topology.cannot_build import CannotBuild

UNDERCUT = 1e-6
"""A rim point further (mm) from the graph of its lens belongs to the other half of the surface."""


def common_rim(faces: tuple[Face, Face], zone: Floats, tolerance: float) -> tuple[Rim | None, Proud | None]:
    """The rim in which both faces of a body end.

    Where land bounds them, where the lens has positive thickness.

    Both results are None where the lens covers its zone.

    Raises
    ------
    CannotBuild
        CL131: see `_check_web`. CL130, CL132, CL133: no such rim can be made.
    """
    lenses = [face for face in faces if face.array is not None]
    rim = _meeting(faces, zone, tolerance) if lenses else None
    if rim is None:
        return None, None
    if None not in [face.land for face in lenses]:
        if len(lenses) == 2:
            _check_web(faces, rim, zone)
        return None, Gap(_graph(faces[0]), _graph(faces[1])).proud
    if not any(region.kind == "lens" for region in rim.pattern.regions):
        raise CannotBuild(
            "CL130",
            "the faces of the lens enclose nothing over its cell: the surface ends inside its cell at its own"
            " equator, or lies beyond the other face; a longer radius (pair.separation), a smaller"
            " lattice.pitch, or more pair.thickness",
        )
    return rim, None


def _meeting(faces: tuple[Face, Face], zone: Floats, tolerance: float) -> Rim | None:
    """Intersection of the two faces of a body above its zone; None where the lens covers its zone.

    Two poses of one quadric intersect in a plane, and so do a quadric and a plane: their rim is exact. Others
    are fitted.
    """
    first, second = (posed_quadric(face) for face in faces)
    if first is not None and second is not None:
        x, y = zone_samples(zone)
        with np.errstate(invalid="ignore"):
            if (first.height(x, y) < second.height(x, y)).all():
                return None
        plane = _meeting_plane(faces, first, second)
        if plane is not None:

            def proud(px: Floats, py: Floats) -> NDArray[np.bool_]:
                with np.errstate(invalid="ignore"):
                    return np.asarray(first.height(px, py) < second.height(px, py))

            return _exact_rim(first if faces[0].array is not None else second, zone, plane, proud, "none")
    rim = fitted_rim(Gap(_graph(faces[0]), _graph(faces[1])), zone, "none", tolerance)
    return None if _covers(rim.pattern) else rim


def _graph(face: Face) -> Graph:
    return level_graph(face.vertex[2]) if face.array is None else lens_graph(face)


def _covers(pattern: Pattern) -> bool:
    return not pattern.chains and [region.kind for region in pattern.regions] == ["lens"]


def _meeting_plane(faces: tuple[Face, Face], first: PosedQuadric, second: PosedQuadric) -> Floats | None:
    """The plane z = c0 + c1 x + c2 y in which two faces intersect; None if there is none."""
    for face in faces:
        if face.array is None:
            return np.array([face.vertex[2], 0.0, 0.0])
    if not np.allclose(first.matrix, second.matrix, rtol=0.0, atol=1e-12 * float(np.abs(first.matrix).max())):
        return None
    # F_front − F_back is linear when both are poses of one quadric: their common points lie in a plane.
    gradient = 2.0 * (
        (first.linear - first.matrix @ first.apex) - (second.linear - second.matrix @ second.apex)
    )
    constant = float(first.value(np.zeros(3)) - second.value(np.zeros(3)))
    if abs(gradient[2]) < 1e-6 * float(np.linalg.norm(gradient)):
        return None
    return np.asarray(-np.array([constant, gradient[0], gradient[1]]) / gradient[2])


def _check_web(faces: tuple[Face, Face], rim: Rim, zone: Floats) -> None:
    """Refuse a web from which a tilted lens's rim protrudes: the union of lens and plate is no column there.

    At a rim point outside the plate, front and back of the lens meet at a height h above the plate's upper
    face (or below its lower one). Just inside the rim both faces are near h, so on one vertical line there is
    air between plate and lens. The lens overhangs the plate, which neither a height field nor a mould or an
    etch can make. (Meshes of such a design fill the space below the overhang: every column is solid from its
    lowest face to its highest, as in the tracer.) If the whole rim lies in the plate, nothing overhangs. Over
    the region inside the rim the front of a convex lens is a convex function of (x, y), with its maximum on
    the rim. So the front is nowhere above the plate's upper face, and the back nowhere below its lower one.

    Raises
    ------
    CannotBuild
        CL131, with the thickness of a web that contains the rim.
    """
    front, back = faces
    assert front.land is not None
    assert back.land is not None
    arcs = [arc for chain in rim.arcs for arc in chain]
    if not arcs:
        return
    z = np.concatenate([arc.at(_ALONG)[:, 2] for arc in arcs])
    middle = 0.5 * (front.land + back.land)
    reach = float(np.abs(z - middle).max())
    if 2.0 * reach <= (back.land - front.land) * (1.0 + 1e-9):
        return
    x, y = zone_samples(zone)
    low, high = lens_graph(front)(x, y)[0], lens_graph(back)(x, y)[0]
    with np.errstate(invalid="ignore"):
        proud = (low <= high) & ((low < middle - reach) | (high > middle + reach))
    buries = "" if proud.any() else ", and buries it: the lens is too thin for its tilt"
    raise CannotBuild(
        "CL131",
        f"the rim of the tilted lens sticks out of its web; a web of at least {rounded_up(2.0 * reach)} mm"
        " holds it"
        f"{buries} (or give the lens more thickness, so that its rim leaves the cell: pair.thickness ="
        ' "auto")',
    )


_ALONG = np.linspace(0.0, 1.0, 1025)  # the highest point of an arc is missed by 1e-7 of its height at most


def zone_samples(zone: Floats) -> tuple[Floats, Floats]:
    """Points over a convex zone, its corners and sides included: (n,) each."""
    share = np.linspace(0.0, 1.0, 17)
    sides = [a + share[:, None] * (b - a) for a, b in zip(zone, np.roll(zone, -1, axis=0))]
    border = np.concatenate(sides)
    points = np.concatenate([border * r for r in np.linspace(0.0, 1.0, 9)])
    return points[:, 0], points[:, 1]


def _conic(quadric: PosedQuadric, plane: Floats) -> Floats:
    """Conic (3, 3) in x, y that the plane z = plane · (1, x, y) cuts from a quadric."""
    m, q, d = quadric.matrix, quadric.linear, quadric.apex
    linear = q - m @ d
    full = np.zeros((4, 4))
    full[:3, :3], full[:3, 3], full[3, :3] = m, linear, linear
    full[3, 3] = float(d @ m @ d - 2.0 * q @ d)
    lift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [plane[1], plane[2], plane[0]], [0.0, 0.0, 1.0]])
    return np.asarray(lift.T @ full @ lift)


def land_rim(face: Face, thick: Proud | None, zone: Floats, tolerance: float) -> Rim:
    """Rim at which a lens ends on its land, if it has land.

    `thick`: where the lens has material at all. The surface of a thin tilted lens may leave its land again
    far beyond the end of the lens.
    """
    quadric, land = posed_quadric(face), face.land
    if land is None:
        return Rim(plain_pattern(zone, "lens"), ())
    if quadric is None:
        lens, level = lens_graph(face), level_graph(land)
        gap = Gap(lens, level, thick) if face.side > 0 else Gap(level, lens, thick)
        return fitted_rim(gap, zone, "land", tolerance)

    def proud(x: Floats, y: Floats) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore"):
            out = np.asarray(face.side * (quadric.height(x, y) - land) < 0.0)
        return out if thick is None else out & thick(x, y)

    x, y = zone_samples(zone)
    if proud(x, y).all():
        return Rim(plain_pattern(zone, "lens"), ())
    return _exact_rim(quadric, zone, np.array([land, 0.0, 0.0]), proud, "land")


def _exact_rim(quadric: PosedQuadric, zone: Floats, plane: Floats, proud: Proud, rest: Kind) -> Rim:
    """The rim in which a plane z = plane · (1, x, y) cuts a quadric."""
    pattern = divided_pattern(zone, _conic(quadric, plane), proud, rest)
    normal = np.array([-plane[1], -plane[2], 1.0])
    arcs = tuple(
        _rim_arcs(quadric, chain.points, chain.first is None, plane, normal) for chain in pattern.chains
    )
    return Rim(pattern, arcs)


def _rim_arcs(
    quadric: PosedQuadric, points: Floats, closed: bool, plane: Floats, normal: Floats
) -> tuple[Arc, ...]:
    z = plane[0] + points @ plane[1:]
    lifted = np.column_stack([points, z])
    away = np.abs(quadric.height(points[:, 0], points[:, 1]) - z)
    if not (away <= UNDERCUT).all():
        raise CannotBuild(
            "CL133",
            "the lens is undercut at its rim: its surface passes its equator before it meets its land or"
            " other face; tilt it less, or give it a longer radius",
        )
    following = np.roll(lifted, -1, axis=0) if closed else lifted[1:]
    return tuple(section_arc(quadric, a, b, normal) for a, b in zip(lifted, following))
