"""Fresnel's coefficients from the directions before and after an interface alone.

A ray keeps, at an interface, the unit direction D before and D' after it. Snell's law makes n2 D' − n1 D the
normal's direction, so cosines of incidence and refraction, and with them Fresnel's coefficients, follow from
c = D·D', the cosine of the deviation (Born and Wolf, Principles of Optics, 1.5.2, with the angles
eliminated):

    r_s = −((n2 − n1)² + 2 n1 n2 (1 − c)) / (n2² − n1²)
    r_p = ((n2 − n1)² − (n1² + n2²) (1 − c)) / ((n2² − n1²) c)

No normal, no square root, no angle is formed, so losses can be added afterwards to the result of every rung
and kernel that records ray directions. The share of the light that passes is 1 − r² of each polarisation.
"""

from __future__ import annotations

import numpy as np

from clacad.base.types import Floats


def deviation(before: Floats, after: Floats) -> Floats:
    """1 − D·D' of unit directions (m, 3), without its cancellation: |D' − D|²/2."""
    turned = after - before
    x, y, z = turned[:, 0], turned[:, 1], turned[:, 2]
    return np.asarray(0.5 * (x * x + y * y + z * z))


def amplitudes(turn: Floats, n1: float, n2: float) -> tuple[Floats, Floats]:
    """Reflection coefficients (r_s, r_p) of light that went through an interface.

    turn : (m,) array. 1 − D·D', see `deviation`.
    n1, n2 : Index before and after; equal ones give zeros.
    Returns r_s, r_p : (m,) arrays: At normal incidence r_s = −r_p = (n1 − n2)/(n1 + n2).
    """
    step = (n2 - n1) * (n2 + n1)
    if step == 0.0:
        return np.zeros_like(turn), np.zeros_like(turn)
    square = (n2 - n1) * (n2 - n1)
    s = (square + (2.0 * n1 * n2) * turn) * (-1.0 / step)
    p = (square - (n1 * n1 + n2 * n2) * turn) / (step * (1.0 - turn))
    return s, p


def transmission(turn: Floats, n1: float, n2: float) -> Floats:
    """Share of unpolarised light that passes an interface, (m,); see `amplitudes`."""
    s, p = amplitudes(turn, n1, n2)
    return np.asarray(1.0 - 0.5 * (s * s + p * p))


def normal_loss(index: float) -> float:
    """Share r0 = ((n − 1)/(n + 1))² reflected at normal incidence."""
    return ((index - 1.0) / (index + 1.0)) ** 2


def coated(turn: Floats, n1: float, n2: float, ratio: float) -> tuple[Floats, Floats]:
    """Reflected shares (R_s, R_p) of an interface under a quarter-wave layer of index sqrt(n1 n2).

    turn : (m,) array. 1 − D·D' of the uncoated passage, which a layer does not change.
    ratio : Design wavelength of the layer over the wavelength of the light.

    Notes
    -----
    One layer, two amplitudes that interfere (Born and Wolf, 1.6.4): thickness a quarter of the design
    wavelength in the layer, so nothing is reflected there at normal incidence. Without absorption the rest
    passes. The retardance of the layer is left out.
    """
    if n1 == n2:
        return np.zeros_like(turn), np.zeros_like(turn)
    layer, step = np.sqrt(n1 * n2), n2 - n1
    size = np.sqrt(step * step + 2.0 * n1 * n2 * turn)
    cos1, cos2 = np.abs(step - n2 * turn) / size, np.abs(step + n1 * turn) / size
    cos = np.sqrt(np.maximum((step + n1 * cos1 * cos1) / n2, 0.0))
    twice = np.cos(np.pi * ratio * cos)
    shares = []
    for a1, a, a2 in ((n1 * cos1, layer * cos, n2 * cos2), (cos1 / n1, cos / layer, cos2 / n2)):
        first, second = (a1 - a) / (a1 + a), (a - a2) / (a + a2)
        both = first * first + second * second + 2.0 * first * second * twice
        shares.append(both / (1.0 + (first * second) ** 2 + 2.0 * first * second * twice))
    return shares[0], shares[1]


def reflected(
    turn: Floats, n1: float, n2: float, coating: str = "none", ratio: float = 1.0
) -> tuple[Floats, Floats]:
    """Reflected shares (R_s, R_p), (m,) each, of an interface; see `amplitudes` and `coated`."""
    if coating == "quarter-wave":
        return coated(turn, n1, n2, ratio)
    s, p = amplitudes(turn, n1, n2)
    return s * s, p * p
