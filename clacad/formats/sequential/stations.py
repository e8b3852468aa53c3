"""The faces of one telescopelet in the numbers of a lens designer: apex curvatures, conic constants, pose,
index beyond.

A quadric cx x² + cy y² + κ z² − 2 s z = 0 is the biconic with 1 + K = κ/c in each meridian. One kind of
surface, with terms of order 4 to 8 where they were given, therefore represents every face exactly. Lengths
are millimetres, the frame is the sheet's with the centre of the telescopelet's own cell at x = y = 0.
Curvatures are positive where the face bends towards +z.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, inf

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.base.units import A4, A6, A8, NO_A4, NO_A6, NO_A8, millimetres
from clacad.optics.law import angle_between
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import Interface, trace_sequence
from clacad.optics.surface import ULP, Biconic, EvenPolynomial, Surface, conic_constants, resized
from clacad.sheet.bundle import Bundle, bundle
from clacad.sheet.face_order import refractions
from clacad.sheet.like_cell import interfaces, lens_distance
from clacad.sheet.window import Face, Window
from clacad.storage.errors import FileDisagrees

RAYS = 256
"""Rays by which a file that was read back is compared with the design."""

FIELD = 0.02
"""Half angle of their cone, radians."""

SAME = 1e-9
"""Angle by which their directions may differ, radians."""

DEFAULT_WAVELENGTH = 550e-9
"""Wavelength that a file states where the design has a bare index, metres."""


@dataclass(frozen=True, eq=False)
class Station:
    """One face at its position.

    curvature : (cx, cy), 1/mm
    conic : (Kx, Ky). 0 in a flat meridian, which has none.
    vertex : (3,), mm
    rotation : (3, 3). Face's frame to sheet frame.
    index : Refractive index beyond the face.
    reach : (x, y), mm
        Largest distance from the apex at which light of the cell meets the face, along the face's own axes.
    terms : (3,), 1/mm³, (4,), 1/mm⁵, and (5,), 1/mm⁷
        Coefficients of orders 4, 6 and 8 on top of it, positive towards +z.
    """

    name: str
    curvature: tuple[float, float]
    conic: tuple[float, float]
    vertex: Floats
    rotation: Floats
    index: float
    reach: tuple[float, float]
    terms: tuple[A4, A6, A8] = (NO_A4, NO_A6, NO_A8)

    @property
    def flat(self) -> bool:
        """Whether it is a plane."""
        return self.curvature == (0.0, 0.0) and not self.polynomial

    @property
    def polynomial(self) -> bool:
        """Whether it has terms on top of its conic."""
        return any(map(any, self.terms))

    @property
    def rotational(self) -> bool:
        """Whether it is a surface of revolution about its axis, a plane among them."""
        same = self.curvature[0] == self.curvature[1] and (
            self.curvature[0] == 0.0 or self.conic[0] == self.conic[1]
        )
        return same and all(map(_rotational, self.terms))

    @property
    def surface(self) -> Biconic | EvenPolynomial:
        """The face in its own frame, millimetres."""
        if self.polynomial:
            a4, a6, a8 = self.terms
            return EvenPolynomial(*self.curvature, *self.conic, a4, 1, a6, a8)
        return Biconic(*self.curvature, *self.conic, 1)


def _rotational(terms: tuple[float, ...]) -> bool:
    """Whether terms of one order are a multiple of (x² + y²)^k, to the rounding of numbers in text."""
    wanted = [terms[0] * comb(len(terms) - 1, j) for j in range(len(terms))]
    return all(abs(a - b) <= 4.0 * ULP * abs(b) for a, b in zip(terms, wanted, strict=True))


def stations(window: Window) -> list[Station]:
    """Faces of the telescopelet in the order light meets them."""
    scale = millimetres(window.unit)
    found = []
    for (body, face, _, _), at in zip(refractions(window.bodies), interfaces(window), strict=True):
        name = f"{body.name} {'front' if face is body.front else 'back'}"
        found.append(_station(window, name, at, face, scale))
    return found


def _station(window: Window, name: str, at: Interface, face: Face, scale: float) -> Station:
    surface = at.surface
    cx, cy = (surface.side * c / scale + 0.0 for c in (surface.curvature_x, surface.curvature_y))
    kx, ky = (0.0 if k is None or c == 0.0 else float(k) for k, c in zip(conic_constants(surface), (cx, cy)))
    turn = np.eye(3) if at.rotation is None else np.asarray(at.rotation)
    place = np.asarray(at.vertex) * scale
    terms = _terms(surface, scale)
    return Station(name, (cx, cy), (kx, ky), place, turn, at.index_after, _reach(window, face, scale), terms)


def _terms(surface: Surface, scale: float) -> tuple[A4, A6, A8]:
    """Coefficients of a face's even terms in millimetres, towards +z."""
    if not isinstance(surface, EvenPolynomial):
        return NO_A4, NO_A6, NO_A8
    in_mm = resized(surface, scale)
    assert isinstance(in_mm, EvenPolynomial)
    a, b, c = (surface.side * term + 0.0 for term in in_mm.a4)
    d, e, f, g = (surface.side * term + 0.0 for term in in_mm.a6)
    h, i, j, k, m = (surface.side * term + 0.0 for term in in_mm.a8)
    return (a, b, c), (d, e, f, g), (h, i, j, k, m)


def _reach(window: Window, face: Face, scale: float) -> tuple[float, float]:
    """Half extents (mm) of a cell about a face's apex along its axes, a tenth more because of tilt."""
    if face.array is None:
        return inf, inf
    turn = face.rotation
    corners = window.lattice.tile() - np.asarray(face.vertex[:2])
    heights = -(corners @ turn[:2, 2]) / turn[2, 2]
    heights = np.concatenate([heights + side * 0.5 * window.lattice.circumradius for side in (-1.0, 1.0)])
    points = np.column_stack([np.tile(corners, (2, 1)), heights]) @ turn
    x, y = 1.1 * np.abs(points[:, :2]).max(axis=0) * scale
    return float(x), float(y)


def image_height(window: Window) -> float:
    """Height (mm) of the plane on which a prescription ends: the lenses' distance beyond the last body."""
    return (window.z_range[1] + lens_distance(window)) * millimetres(window.unit)


def wavelength_um(window: Window) -> float:
    """Wavelength that a prescription states, micrometres."""
    return 1e6 * (DEFAULT_WAVELENGTH if window.wavelength is None else window.wavelength)


def pupil(window: Window) -> float:
    """Diameter (mm) of the beam that a prescription states: the circle in one cell."""
    return 2.0 * min(window.lattice.half_widths) * millimetres(window.unit)


def left_out(window: Window) -> list[str]:
    """List what a sequential prescription cannot represent of this sheet, with the meaning of each."""
    n1, n2 = window.lattice.count
    nanometres = f"{1e3 * wavelength_um(window):.6g} nm"
    found = [
        (
            f"the neighbours: it is one telescopelet of {window.lattice.cell_count:,} ({n1} x {n2}), and"
            " light that leaves lens 2's cell (ghosts, walls) goes on as if that lens had no border"
        ),
        "the border of its cell: the beam is the circle in the cell",
    ]
    if window.land.seam > 0.0:
        found.append(
            f"the seams: {window.land.seam * millimetres(window.unit):.6g} mm of land between lenses"
        )
    if window.baffle is not None:
        found.append("the baffle between the arrays")
    if window.outline is not None:
        found.append("the border and the outline of the sheet")
    named = dict.fromkeys(getattr(body.material, "name", "") for body in window.bodies if body.material)
    if named:
        found.append(f"the dispersion of {', '.join(named)}: its index at {nanometres} alone")
    elif window.wavelength is None:
        found.append(f"a dispersion: the design has a bare index, and {nanometres} holds for any wavelength")
    return found


# -- a file that was read back -------------------------------------------------------------------------


def probe(window: Window) -> Bundle:
    """Rays over the central cell by which a file is compared with the design, design units."""
    return bundle(window, RAYS, FIELD)


def from_own_cell(window: Window, rays: Bundle) -> tuple[Floats, Floats]:
    """Starts (n, 3), mm, and directions (n, 3) of rays, their cell's centre at x = y = 0."""
    place = window.lattice.centres(np.array([rays.cell], dtype=np.int64))[0]
    start = (rays.rays.position - [*place, 0.0]) * millimetres(window.unit)
    return start, rays.rays.direction


def through_design(window: Window, start: Floats, direction: Floats) -> tuple[Floats, Bools]:
    """Directions (n, 3) by the design's own faces for rays (mm), and which rays meet every face within its
    reach, (n,).
    """
    scale = millimetres(window.unit)
    found = trace_sequence(interfaces(window), Rays(start / scale, direction), record=True)
    assert found.hits is not None
    inside = found.fate == Fate.ALIVE
    for one, hits in zip(stations(window), found.hits, strict=True):
        met = (hits * scale - one.vertex) @ one.rotation
        inside &= (np.abs(met[:, 0]) <= one.reach[0]) & (np.abs(met[:, 1]) <= one.reach[1])
    return found.direction, inside


def refuse_other_light(name: str, wanted: Floats, found: Floats, inside: Bools) -> None:
    """Reject a file through which light leaves in other directions.

    wanted, found : (n, 3) unit directions; inside : (n,) bool, those that count
    Raises FileDisagrees.
    """
    apart = angle_between(wanted[inside], found[inside])
    worst = float(apart.max(initial=0.0)) if np.isfinite(apart).all() else np.inf
    if not worst <= SAME:
        raise FileDisagrees(
            f"{name}: light through it leaves up to {worst:.3g} rad from the design's; {SAME:g} is allowed"
        )


def traced(read: list[Station], start: Floats, direction: Floats) -> Floats:
    """Directions (n, 3) of rays (mm) after the faces read from a file."""
    before = [1.0, *(one.index for one in read[:-1])]
    sequence = [
        Interface(one.surface, one.vertex, index, one.index, one.rotation)
        for one, index in zip(read, before, strict=True)
    ]
    return np.asarray(trace_sequence(sequence, Rays(start, direction)).direction)
