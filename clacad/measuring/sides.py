"""The two measured sides of a design: faces seen from outside, and their lenslets by the definitions of the
fit.

A map of the front has the sheet's x along its x and the sheet's y against its y; a map of the back has both
against. So x of the back's map runs against x of the front's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.measuring.fit_lenslets import Aperture, aperture_of, fit_heights
from clacad.sheet.lattice import Lattice
from clacad.sheet.window import Body, Face, Window, lens_height
from clacad.storage.errors import NotPossible

Name = Literal["front", "back"]
AXES: dict[Name, tuple[float, float]] = {"front": (1.0, -1.0), "back": (-1.0, -1.0)}
"""Signs of the map's x and y along the sheet's."""


OTHER: dict[Name, Name] = {"front": "back", "back": "front"}


@dataclass(frozen=True, eq=False)
class Side:
    """One side of a sheet whose cells are all alike.

    name : "front": the side that light reaches first.
    window : The sheet.
    face : Face
    aperture : Measured aperture.
    lenslet : (7,) Numbers of the design's lenslet in the axes of a map, by the fit of `fit_lenslets`.
    millimetre : Lengths of a design unit in a millimetre.
    """

    name: Name
    window: Window
    face: Face
    aperture: Aperture
    lenslet: Floats
    millimetre: float

    @property
    def lattice(self) -> Lattice:
        """Cells of the face."""
        assert self.face.array is not None
        return self.window.lattice_of(self.face.array)

    @property
    def body(self) -> Body:
        """Body that the face bounds."""
        return self.window.bodies[0 if self.name == "front" else -1]

    @property
    def sag(self) -> float:
        """Difference of height (length) of middle and farthest corner of the design's lenslet."""
        tile = self.lattice.tile()
        return float(np.ptp(np.append(_outward(self.face, tile[:, 0], tile[:, 1], self.name), 0.0)))

    def outward(self, u: Floats, v: Floats) -> Floats:
        """Height (n,) of the design's lenslet above its apex, out of the material, over places of a map's
        cell.
        """
        return _outward(self.face, u, v, self.name)

    def target(self, u: Floats, v: Floats) -> Floats:
        """Height (n,) as `outward`, over places relative to the middle of the lenslet."""
        return self.outward(u + self.lenslet[0], v + self.lenslet[1])

    def cell(self, index: Ints) -> Ints:
        """Steps (m, 2) of the sheet's lattice for steps (m, 2) of the map's."""
        basis = np.column_stack([self.lattice.a1, self.lattice.a2])
        across = np.linalg.inv(basis) @ np.diag(AXES[self.name]) @ basis
        return np.asarray(np.rint(index @ across.T).astype(np.int64))

    def in_sheet(self, u: Floats, v: Floats, height: Floats) -> Floats:
        """Places of a map's cell and heights above the plane of the apexes as points (n, 3) of the
        sheet's.
        """
        sx, sy = AXES[self.name]
        return np.column_stack([sx * u, sy * v, self.face.vertex[2] - self.face.side * height])


def _outward(face: Face, u: Floats, v: Floats, name: Name) -> Floats:
    """Height (n,) of the design's lenslet above its apex, out of the material, over places of a map's
    cell.
    """
    sx, sy = AXES[name]
    return np.asarray(-face.side * (lens_height(face, sx * u, sy * v) - face.vertex[2]))


def sides_of(window: Window, millimetre: float) -> dict[Name, Side]:
    """Sides of a sheet that a map can be compared with.

    millimetre : Lengths of a design unit in a millimetre.
    Raises NotPossible: The sheet is non-uniform; lenses are tilted; or an array has lenses inside the sheet.
    """
    if not window.uniform:
        raise NotPossible("maps are not compared with non-uniform sheets")
    curved = [face for body in window.bodies for face in (body.front, body.back) if face.array is not None]
    outer = (window.bodies[0].front, window.bodies[-1].back)
    if len(curved) != 2 or any(face is not one for face, one in zip(curved, outer, strict=True)):
        raise NotPossible(
            f"{window.name}: its lenslets are not the two outer faces of the sheet: a map of one"
            f" side shows not all of"
            " them"
        )
    if not all(face.untilted for face in curved):
        raise NotPossible(f"{window.name}: its lenses are tilted: their numbers are not those of a map")
    names: tuple[Name, Name] = ("front", "back")
    return {name: _side(name, window, face, millimetre) for name, face in zip(names, outer, strict=True)}


def _side(name: Name, window: Window, face: Face, millimetre: float) -> Side:
    assert face.array is not None
    aperture = aperture_of(window.lattice_of(face.array), millimetre)
    surface = face.surface
    curvatures = surface.curvature_x, surface.curvature_y
    if 0.0 in curvatures:
        raise NotPossible(
            f"{window.name}: the {name} has cylinders: a lenslet of a map has power along both axes"
        )
    sx, sy = AXES[name]
    start = np.array(
        [
            sx * face.vertex[0],
            sy * face.vertex[1],
            0.0,
            0.5 * sum(curvatures),
            0.0,
            0.25 * (curvatures[0] - curvatures[1]),
            0.0,
        ]
    )
    lenslet = fit_heights(aperture, lambda u, v: _outward(face, u, v, name), start)
    return Side(name, window, face, aperture, lenslet, millimetre)
