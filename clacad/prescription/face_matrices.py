"""Paraxial matrices of listed faces (`form = "plates"`), and the pair of thin lenses equivalent to them.

Matrices act on (height, slope in air) per meridian of the lens axes:

    M = (A B; C D),  law t' = (t − δ)/η  where C = 0 and D = 1/η;  vertex 2 at d = δ/(η C_2)

with C_2 of the faces of array 2 alone. The equivalent thin lenses have f1 = B/(1 − η), f2 = −η f1 and the
separation f1 + f2. Where faces between them image lens 1 towards lens 2, f1 = −1/C_1 of the faces of array
1, and a lens at the focus with 1/f_F = (s − B)/(f1 f2) gives B.
"""

from __future__ import annotations

from functools import reduce
from math import inf, isfinite
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.design.faces import AIR, vertex_of
from clacad.optics.material.catalogue import find

if TYPE_CHECKING:
    from clacad.design.sections import PairSpec

IMAGING = 0.25
"""Share of the separation by which B must be less than it where faces between the lenses image pupils."""


def matrices(pair: PairSpec, array: object = None) -> tuple[Floats, Floats]:
    """(A B; C D) from the first to the last vertex along x and y, or through the faces of one array alone."""
    faces, index = pair.face, _media(pair)
    chosen = [k for k, face in enumerate(faces) if array is None or face.array == array]
    first, last = (chosen[0], chosen[-1]) if chosen else (0, -1)
    found = []
    for axis in (0, 1):
        steps = []
        for k in range(first, last + 1):
            if k > first:
                length = (vertex_of(faces, k) - vertex_of(faces, k - 1)) / index[k]
                steps.append(np.array([[1.0, length], [0.0, 1.0]]))
            power = (index[k + 1] - index[k]) * faces[k].curvature[axis]
            steps.append(np.array([[1.0, 0.0], [-power, 1.0]]))
        found.append(reduce(lambda whole, step: step @ whole, steps, np.eye(2)))
    return found[0], found[1]


def _media(pair: PairSpec) -> list[float]:
    """Refractive index before the first face and behind each, at the design wavelength."""
    names = [str(face.behind) for face in pair.face]
    return [1.0] + [1.0 if name == AIR else float(find(name).index(pair.wavelength)) for name in names]


def separation(pair: PairSpec, eta: Pair2) -> float:
    """Distance s between the equivalent thin lenses (length): mean of the meridians with power."""
    focal = focal_lengths(pair, eta, 1)
    return float(np.mean([f * (1.0 - one) for f, one in zip(focal, eta, strict=True) if isfinite(f)]))


def focal_lengths(pair: PairSpec, eta: Pair2, array: int) -> Pair2:
    """Focal lengths (x, y) of the equivalent thin lens of array 1 or 2; infinite without power."""
    imaging, whole, first = images_pupils(pair, eta), matrices(pair), matrices(pair, 1)
    found = []
    for axis, one in enumerate(eta):
        f1 = inf
        if one != 1.0:
            f1 = inverse(-float(first[axis][1, 0])) if imaging else float(whole[axis][0, 1]) / (1.0 - one)
        found.append(f1 if array == 1 else -one * f1)
    return found[0], found[1]


def images_pupils(pair: PairSpec, eta: Pair2) -> bool:
    """Whether faces near the focus have cells of their own, or make B clearly less than the distance between
    the thin lenses.
    """
    if any(face.array == "field" for face in pair.face):
        return True
    for whole, first, one in zip(matrices(pair), matrices(pair, 1), eta, strict=True):
        length = inverse(-float(first[1, 0])) * (1.0 - one)
        if isfinite(length) and abs(length - float(whole[0, 1])) > IMAGING * abs(length):
            return True
    return False


def inverse(power: float) -> float:
    """Focal length of a power, infinite for 0."""
    return 1.0 / power if power else inf
