"""Apparent positions of objects seen through an ideal sheet, in closed form.

The camera is at a distance D before the sheet (z < 0) and looks towards +z. Light is followed from
the camera, so the law's incoming side is the camera's. Imaging by generalized sheets: Oxburgh &
Courtial, J. Opt. Soc. Am. A 30, 2334 (2013).

Closed forms of a thin pair: δ that sends a cell's light to a given point, and the spot's width.

The law of a sheet between two spaces that are affine images of one space in which all light is straight.
Coordinate-transform optics bends space (Leonhardt, Science 312, 1777 (2006); Pendry, Schurig & Smith, ibid.
1780). Where two affine pieces meet in a plane, the map from one to the other is A = J₂⁻¹ J₁, and light of
direction d goes on along A d. A sheet displaces no light, so A keeps every point of the plane, and η = det A
in both axes: these are the homogeneous sheets that image all space.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from clacad.base.pairs import two_product, two_sum
from clacad.base.types import Floats, Pair2
from clacad.optics.law.law import Law

SAME = 1e-9
"""Largest disagreement of two maps on the plane of a sheet, relative to the size of their columns."""

Columns = tuple[list[Fraction], ...]


def slope_map(law: Law) -> tuple[Floats, Floats]:
    """Slopes behind the sheet, to first order about light along the sheet's normal: τ' ≈ τ'₀ + J τ.

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

    pitch : (2,) lengths
    distance, wavelength : lengths
    source : radians
    """
    scale = np.abs([law.eta_x, law.eta_y])
    beam = scale * np.array(pitch)
    x, y, z = (
        tuple(v.tolist()) for v in (beam, 2.0 * distance * source / scale, wavelength * distance / beam)
    )
    return x, y, z


def law_between(map_1: ArrayLike, map_2: ArrayLike) -> Law:
    """Return the law of the sheet in z = 0 behind which space is `map_2`, and before which it is `map_1`.

    Parameters
    ----------
    map_1, map_2 : (3, 4) arrays
        Affine maps from places (x, y, z) of the space before and behind the sheet, in the sheet's frame, to
        the space in which all light is straight: the first three columns multiply (x, y, z), the last one is
        added (lengths). (3, 3): nothing is added.

    Returns
    -------
    Law
        η_x = η_y = det J₁/det J₂, δ from where the map leads the sheet's normal; each number is rounded once.

    Raises
    ------
    ValueError
        No sheet of lens pairs does this. The message names the condition that fails: a map that is no finite
        (3, 3) or (3, 4) array; a map that flattens space; maps that move points of the plane of the sheet
        differently (a sheet displaces no light); or space sheared sideways at unchanged depth, which is η = 1
        with an offset.

    Examples
    --------
    >>> import numpy as np
    >>> law_between(np.eye(3), np.diag([1.0, 1.0, 2.0])).eta_x
    0.5
    """
    first, second = _columns("map_1", map_1), _columns("map_2", map_2)
    before, behind = (_determinant(*columns[:3]) for columns in (first, second))
    for name, size in (("map_1", before), ("map_2", behind)):
        if size == 0:
            raise ValueError(
                f"{name} flattens space: its determinant is 0, so light behind it has no one law"
            )
    _same_plane(first, second)
    # Cramer: the third column of J2^-1 J1
    x, y = (
        _determinant(*(first[2] if k == axis else second[k] for k in (0, 1, 2))) / behind for axis in (0, 1)
    )
    eta = before / behind
    if eta == 1 and (x or y):
        raise ValueError(
            f"the maps shear space by ({float(x):g}, {float(y):g}) at unchanged depth: eta = 1 with an"
            " offset, which no pair of lenses has; a prism does that"
        )
    return Law(float(eta), float(eta), float(-x) + 0.0, float(-y) + 0.0)


def _columns(name: str, given: ArrayLike) -> Columns:
    """Columns of an affine map as fractions: x, y, z and the shift."""
    whole = np.asarray(given, np.float64)
    if whole.shape not in ((3, 3), (3, 4)) or not np.isfinite(whole).all():
        raise ValueError(
            f"{name} is no affine map of space: give 3 rows of 3 or 4 finite numbers, not an array of shape "
            f"{whole.shape}"
        )
    if whole.shape == (3, 3):
        whole = np.column_stack([whole, np.zeros(3)])
    return tuple([Fraction(float(value)) for value in column] for column in whole.T)


def _determinant(a: list[Fraction], b: list[Fraction], c: list[Fraction]) -> Fraction:
    """Determinant of three columns."""
    return (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        - a[1] * (b[0] * c[2] - b[2] * c[0])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )


def _same_plane(first: Columns, second: Columns) -> None:
    """Refuse maps that differ on the plane of the sheet. Raises ValueError."""
    for number, where in ((0, "along x"), (1, "along y"), (3, "at its origin")):
        one, other = _floats(first[number]), _floats(second[number])
        apart = float(np.linalg.norm(one - other))
        if apart > SAME * max(np.linalg.norm(one), np.linalg.norm(other)):
            raise ValueError(
                f"the maps disagree on the plane of the sheet {where}, by {apart:.6g}: map_1 leads to "
                f"{one.tolist()}, map_2 to {other.tolist()}. A sheet changes directions and displaces no "
                "light, so both must agree on z = 0"
            )


def _floats(column: list[Fraction]) -> Floats:
    return np.array([float(value) for value in column])
