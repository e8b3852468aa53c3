"""Paraxial matrices of listed faces (`form = "plates"`), and the pair of thin lenses equivalent to them.

Matrices act on (height, slope in air) per meridian of the lens axes:

    M = (A B; C D),  law t' = (t − δ)/η  where C = 0 and D = 1/η;  vertex 2 at d = δ/(η C_2)

with C_2 of the faces of array 2 alone. The equivalent thin lenses have f1 = B/(1 − η), f2 = −η f1 and the
separation f1 + f2. Where faces between them image lens 1 towards lens 2, f1 = −1/C_1 of the faces of array
1, and a lens at the focus with 1/f_F = (s − B)/(f1 f2) gives B.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.design.faces import AIR, vertices_of
from clacad.optics.material.catalogue import find
from clacad.sheet.window import FieldLens

if TYPE_CHECKING:
    from clacad.design.sections import PairSpec

IMAGING = 0.25
"""Share of the separation by which B must be less than it where faces between the lenses image pupils."""


@dataclass(frozen=True, slots=True)
class ThinEquivalent:
    """Thin lenses that act as listed faces do.

    focal_length : ((f1x, f1y), (f2x, f2y)), lengths. Infinite without power.
    separation : length. Mean of the meridians with power.
    field : None where B is that of two lenses.
    """

    focal_length: tuple[Pair2, Pair2]
    separation: float
    field: tuple[FieldLens, ...]


def equivalent(pair: PairSpec, eta: Pair2) -> ThinEquivalent:
    """Thin lenses equivalent to the faces of a list, for the requested η of both meridians."""
    whole, alone = (
        [float(m[k]) for m in found] for found, k in ((matrices(pair), (0, 1)), (matrices(pair, 1), (1, 0)))
    )
    built = [inf if one == 1.0 else _inverse(-c) for c, one in zip(alone, eta, strict=True)]
    imaging = any(face.array == "field" for face in pair.face) or any(
        isfinite(f) and abs(f * (1.0 - one) - b) > IMAGING * abs(f * (1.0 - one))
        for f, b, one in zip(built, whole, eta, strict=True)
    )
    if not imaging:
        built = [inf if one == 1.0 else b / (1.0 - one) for b, one in zip(whole, eta, strict=True)]
    first, second = (built[0], built[1]), (-eta[0] * built[0], -eta[1] * built[1])
    powered = [axis for axis in (0, 1) if isfinite(built[axis])]
    s = float(np.mean([built[axis] * (1.0 - eta[axis]) for axis in powered]))
    if not imaging:
        return ThinEquivalent((first, second), s, ())
    focal = [_inverse((s - b) / (f1 * f2)) for b, f1, f2 in zip(whole, first, second, strict=True)]
    depth = float(np.mean([first[axis] for axis in powered]))
    return ThinEquivalent((first, second), s, (FieldLens((focal[0], focal[1]), depth),))


def matrices(pair: PairSpec, array: object = None) -> tuple[Floats, Floats]:
    """(A B; C D) from the first to the last vertex along x and y, or through the faces of one array alone."""
    faces, z, index = pair.face, vertices_of(pair.face), _media(pair)
    chosen = [k for k, face in enumerate(faces) if array is None or face.array == array]
    first, last = (chosen[0], chosen[-1]) if chosen else (0, -1)
    found = []
    for axis in (0, 1):
        whole = np.eye(2)
        for k in range(first, last + 1):
            if k > first:
                whole = np.array([[1.0, (z[k] - z[k - 1]) / index[k]], [0.0, 1.0]]) @ whole
            power = (index[k + 1] - index[k]) * faces[k].curvature[axis]
            whole = np.array([[1.0, 0.0], [-power, 1.0]]) @ whole
        found.append(whole)
    return found[0], found[1]


def _media(pair: PairSpec) -> list[float]:
    """Refractive index before the first face and behind each, at the design wavelength."""
    names = [str(face.behind) for face in pair.face]
    return [1.0] + [1.0 if name == AIR else float(find(name).index(pair.wavelength)) for name in names]


def _inverse(power: float) -> float:
    """Focal length of a power, infinite for 0."""
    return 1.0 / power if power else inf
