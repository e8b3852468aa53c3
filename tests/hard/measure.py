"""From the oracle's nouns to clacad's, and how far apart two answers are."""

from __future__ import annotations

import numpy as np
from mpmath import mp, mpf
from oracle import trace as oracle

from clacad.optics.rays import Fate
from clacad.optics.sequence import Interface
from clacad.optics.surface import Biconic, EvenPolynomial, Quadric

ULP = 2.0**-52
FATE_OF = {"ok": Fate.ALIVE, "missed": Fate.MISSED, "tir": Fate.TIR}


def rotation(phi, theta, psi):
    """Rz(psi) Rx(theta) Rz(phi), rounded once from the oracle's digits."""
    with mp.workdps(60):
        return np.array([[float(v) for v in row] for row in oracle.euler_matrix(phi, theta, psi)])


def surface_of(face):
    """The oracle's face as clacad's surface."""
    a, b, c, d, side = face.shape
    if face.kind == "polynomial":
        return EvenPolynomial(a, b, c, d, face.terms[:3], side, face.terms[3:7], face.terms[7:])
    return Quadric(a, b, c, side) if face.kind == "quadric" else Biconic(a, b, c, d, side)


def turn_of(face):
    """Its rotation matrix, or None."""
    return face.rotation if face.euler is None else rotation(*face.euler)


def interfaces(faces):
    """The oracle's faces as clacad's interfaces."""
    return [Interface(surface_of(f), f.vertex, f.before, f.after, turn_of(f)) for f in faces]


def fate_of(path):
    """The fate that the oracle's path amounts to."""
    if path.status == "ok" and path.directions[-1][2] <= 0:
        return Fate.BACKWARD
    return FATE_OF[path.status]


def assert_whole(result, launched):
    """Every ray has one fate, and only INVALID rows hold NaN."""
    assert sum(result.counts().values()) == launched == len(result)
    good = result.fate != Fate.INVALID
    for column in (result.position, result.direction, result.optical_path, result.flux):
        assert np.isfinite(column[good]).all()
    for record in (result.hits, result.directions):
        assert record is None or np.isfinite(record[:, good]).all()


def error(value, exact):
    """Largest component of the difference from digits."""
    with mp.workdps(60):
        return max(float(abs(mpf(float(u)) - mpf(v))) for u, v in zip(value, exact))


def off(values, exact, digits=450):
    """Length of the difference of two vectors, in ulp of 1."""
    with mp.workdps(digits):
        return float(mp.sqrt(sum((mpf(float(u)) - v) ** 2 for u, v in zip(values, exact))) / ULP)


def relative(value, exact, digits=450):
    """Relative difference in ulp; of two zeros 0."""
    with mp.workdps(digits):
        exact = mpf(exact)
        if exact == 0:
            return 0.0 if float(value) == 0 else float("inf")
        return float(abs(mpf(float(value)) / exact - 1) / ULP)
