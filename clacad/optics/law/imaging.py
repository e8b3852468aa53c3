"""Apparent positions of objects seen through an ideal sheet, in closed form.

The camera is at a distance D before the sheet (z < 0) and looks towards +z. Light is followed from
the camera, so the law's incoming side is the camera's. Imaging by generalized sheets: Oxburgh &
Courtial, J. Opt. Soc. Am. A 30, 2334 (2013).

Closed forms of a thin pair: δ that sends a cell's light to a given point, and the spot's width.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from clacad.base.pairs import two_product, two_sum
from clacad.base.types import Floats, Pair2

if TYPE_CHECKING:
    from clacad.optics.law.law import Law


def slope_map(law: Law) -> tuple[Floats, Floats]:
    """Slopes behind the sheet, to first order about light along the sheet's normal: τ' ≈ τ'₀ + J τ.

    Parameters
    ----------
    law : Law

    Returns
    -------
    offset : (2,) array
        τ'₀, slopes (d'_x/d'_z, d'_y/d'_z) of the exit ray for normal incidence.
    jacobian : (2, 2) array
        J = dτ'/dτ. Exact for every τ where the optical axis is normal to the sheet, J = R₂ diag(1/η) R₂ᵀ.
    """
    a = law.matrix()
    offset = a[:2, 2] / a[2, 2]
    return offset, (a[:2, :2] - np.outer(offset, a[2, :2])) / a[2, 2]


def apparent_map(law: Law, z: float, camera_distance: float, turned_at: float = 0.0) -> tuple[Floats, Floats]:
    """Map from a point of the sheet to the object point seen there: X = a + M x₀.

    Parameters
    ----------
    law : Law
    z : float, length
        Plane of the object. Before the sheet (z < turned_at) directions are unchanged.
    camera_distance : float, length
        D > 0, camera at (0, 0, −D).
    turned_at : float, length
        Plane where directions change: 0 for an ideal thin sheet; the separation s gives the average over a
        real lenslet.

    Returns
    -------
    a : (2,) array, length
        Object point seen at the centre of the sheet.
    M : (2, 2) array
        Its inverse is the stretch seen on the sheet; a zero eigenvalue is a divergence (z = −ηD).

    Notes
    -----
    To first order in x₀/D about the sheet's centre; exact where the optical axis is normal to the sheet.
    """
    if z < turned_at:
        return np.zeros(2), (1.0 + z / camera_distance) * np.eye(2)
    offset, jacobian = slope_map(law)
    behind = z - turned_at
    straight = (1.0 + turned_at / camera_distance) * np.eye(2)
    return behind * offset, straight + behind / camera_distance * jacobian


def image_planes(law: Law, z: float) -> Floats:
    """Heights of the two line images of an object, viewed through the sheet.

    Parameters
    ----------
    law : Law
    z : float, length
        Behind the sheet (z > 0) seen from z < 0: images at z·eig(J), that is z/η_x and z/η_y untilted.
        Before it (z < 0) seen from z > 0: z/eig(J), that is η_x z and η_y z.

    Returns
    -------
    (2,) array, length
        Ascending; both NaN where J has complex eigenvalues: line images then do not exist.
    """
    values = np.linalg.eigvals(slope_map(law)[1])
    if np.iscomplex(values).any():
        return np.full(2, np.nan)
    planes = z * values.real if z >= 0 else z / values.real
    return np.sort(planes)


def image_point(law: Law, point: ArrayLike) -> tuple[Floats, Floats]:
    """Image of an object point along each lens axis, for an optical axis normal to the sheet.

    Parameters
    ----------
    law : Law
        With θ = 0.
    point : (3,) array, length
        In the sheet frame; z > 0 is seen from z < 0, z < 0 from z > 0.

    Returns
    -------
    position : (2,) array, length
        Along the lens axes u and v: x_i + z δ_i/η_i (object behind), x_i − z δ_i (object before).
    plane : (2,) array, length
        Heights of the two images, z/η_i (behind) or η_i z (before). Lateral magnification is 1.

    Raises
    ------
    ValueError
        If the optical axis is tilted: its images are not stigmatic along fixed axes.
    """
    r = law.rotation
    if not np.array_equal(r[:, 2], (0.0, 0.0, 1.0)):
        raise ValueError(f"theta = {law.theta!r} rad: a tilted sheet has no stigmatic image along an axis")
    place = np.asarray(point, np.float64)
    z = place[2]
    across = r[:2, :2].T @ place[:2]
    eta = np.array([law.eta_x, law.eta_y])
    delta = np.array([law.delta_x, law.delta_y])
    if z >= 0:
        return across + z * delta / eta, z / eta
    return across - z * delta, eta * z


def stretch(law: Law, z: ArrayLike, camera_distance: float) -> Floats:
    """Magnification of an object behind the sheet, relative to the view without it, along each lens axis.

    m_i = (D + z)/(D + z/η_i), for an untilted sheet. It diverges and changes sign at z = −η_i D, tends
    to 1 for z → 0 and to η_i at infinity.

    Parameters
    ----------
    law : Law
    z : array, length
        Distance of the object behind the sheet, z ≥ 0.
    camera_distance : float, length
        D > 0.

    Returns
    -------
    (..., 2) array
        ±inf on the pole itself.
    """
    distance = np.asarray(z, np.float64)[..., np.newaxis]
    return _over(camera_distance + distance, camera_distance, distance, law)


def stretch_on_sheet(law: Law, z: ArrayLike, camera_distance: float) -> Floats:
    """Size on the sheet of an object of size 1 behind it, along each lens axis: 1/(1 + z/(Dη_i)).

    Parameters and result as in `stretch`.
    """
    distance = np.asarray(z, np.float64)[..., np.newaxis]
    return _over(np.full(distance.shape, camera_distance), camera_distance, distance, law)


def _over(numerator: Floats, camera_distance: float, z: Floats, law: Law) -> Floats:
    """numerator/(D + z/η), with η multiplied through and Dη + z rounded once: accurate near the pole."""
    eta = np.array([law.eta_x, law.eta_y])
    product, low = two_product(camera_distance, eta)
    total, rest = two_sum(product, z)
    with np.errstate(divide="ignore"):  # the pole itself has a value: infinity
        return np.asarray(numerator * eta / (total + (rest + low)))


def deltas_to(law: Law, ways: Floats, distance: float) -> Floats:
    """δ (n, 2) that sends light along the normal to points `ways` (n, 2) of a screen at `distance`, lengths.

    t' = −δ/η, so δ = −η way/Z, along the lens axes of an upright sheet.
    """
    scale = np.array([law.eta_x, law.eta_y])
    return np.asarray(-(ways @ law.rotation[:2, :2]) * scale / distance)


def spot_widths(
    law: Law, pitch: Pair2, distance: float, source: float, wavelength: float
) -> tuple[Pair2, Pair2, Pair2]:
    """Full widths (lengths) of a cell's spot on a screen along the lens axes, by cell, source, diffraction.

    |η| p; 2 Z α/|η| for a source of half angle α (radians); λ Z/(|η| p).

    Parameters
    ----------
    law : Law
    pitch : (2,) lengths
    distance, wavelength : float, lengths
    source : float, radians
    """
    scale = np.abs([law.eta_x, law.eta_y])
    beam = scale * np.array(pitch)
    x, y, z = (
        tuple(v.tolist()) for v in (beam, 2.0 * distance * source / scale, wavelength * distance / beam)
    )
    return x, y, z
