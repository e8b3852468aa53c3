"""`Law`: the seven parameters of an ideal sheet, and how it changes directions."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from clacad.base.types import Floats
from clacad.optics.law.fitting import NAMES, NO_POWER, fit_law, held_fit, usable_rays
from clacad.optics.law.orientation import Axes, LawParameters, canonical, compose, rotation
from clacad.optics.law.refraction import refracted


@dataclass(frozen=True, slots=True)
class Law:
    """The ideal, homogeneous law of refraction of a generalized confocal lenslet array.

    Per lens axis t' = (t − δ)/η with t, t' the slopes against the optical axis before and behind the
    sheet (Hamilton & Courtial 2009, eq. 6 and 8); in the sheet frame d' ∝ A d, A = R M Rᵀ.

    Parameters
    ----------
    eta_x, eta_y : float
        η_i = −f2_i/f1_i along the lens axes; finite and not 0.
    delta_x, delta_y : float
        δ_i = d_i/f1_i, offset of lens 2 over the focal length of lens 1 in that meridian.
    phi, theta, psi : float, radians
        Euler angles of the lenses, see `clacad.optics.law.rotation`.
    axes : "fixed" or "moving"
        Whether the Euler angles rotate about the sheet's axes or the lens's own.

    Raises
    ------
    ValueError
        If a parameter is not a finite number, η is 0, or `axes` is unknown.

    Notes
    -----
    Many parameter sets mean one law (rotating the lenses by 90° exchanges x and y, for example): two Laws are
    `==` when their parameters are; use `same_as` to compare their effect on light.
    """

    eta_x: float
    eta_y: float
    delta_x: float = 0.0
    delta_y: float = 0.0
    phi: float = 0.0
    theta: float = 0.0
    psi: float = 0.0
    axes: Axes = "fixed"

    def __post_init__(self) -> None:
        """Refuse invalid parameters with a message that names them."""
        for name in NAMES:
            value = float(getattr(self, name))
            if not isfinite(value):
                raise ValueError(f"{name} = {value} is not a finite number")
            if name.startswith("eta") and value == 0.0:
                raise ValueError(f"{name} = 0: no lens pair has it, since eta = -f2/f1 and f2 is not 0")
            object.__setattr__(self, name, value)
        if self.axes not in ("fixed", "moving"):
            raise ValueError(f'axes = {self.axes!r} is no Euler convention; use "fixed" or "moving"')

    @property
    def parameters(self) -> LawParameters:
        """The eight values, as a tuple with names."""
        return LawParameters(
            self.eta_x, self.eta_y, self.delta_x, self.delta_y, self.phi, self.theta, self.psi, self.axes
        )

    @property
    def rotation(self) -> Floats:
        """(3, 3) rotation, lens frame → sheet frame; its last column is the optical axis n."""
        return rotation(self.phi, self.theta, self.psi, self.axes)

    @property
    def optical_axis(self) -> Floats:
        """(3,) unit vector along the axis of lens 1 in the sheet frame."""
        return self.rotation[:, 2]

    def matrix(self) -> Floats:
        """A in the sheet frame, d' ∝ A d: R M Rᵀ with A's eigenvalue along nᵀ equal to 1.

        Returns
        -------
        (3, 3) array
        """
        return self.parameters.matrix()

    def refract(self, d: ArrayLike) -> Floats:
        """Directions behind the sheet.

        Parameters
        ----------
        d : (n, 3) array, any length > 0
            Directions of light before the sheet, in the sheet frame, towards +z. One direction (3,) too.

        Returns
        -------
        array of the same shape
            Unit directions. NaN rows where the law has no answer: d zero or not finite, d·z ≤ 0,
            d·n ≤ 0 (outside the forward hemisphere of the lens), or an exit turned back, d'·z ≤ 0.

        Raises
        ------
        ValueError
            If the last dimension of d is not 3.

        Notes
        -----
        Homogeneous form: m = Rᵀd, then (m_x − δ_x m_z)/η_x, (m_y − δ_y m_z)/η_y, m_z. No slope is formed,
        so nothing is divided by m_z. The differences are compensated: light that leaves along the axis
        because t ≈ δ keeps its relative accuracy. Powers of two are carried apart, so that d and η of
        1e±200 and δ of 1e200 do not overflow.
        """
        return refracted((self.eta_x, self.eta_y), (self.delta_x, self.delta_y), self.rotation, d)

    def undeviated(self) -> Floats:
        """Direction through both lens centres, which the sheet does not change: slopes δ/(1 − η).

        Returns
        -------
        (3,) array
            Unit vector in the sheet frame. Along an axis with η = 1 and δ = 0 no direction changes; slope 0
            is returned there.

        Raises
        ------
        ValueError
            If η = 1 and δ ≠ 0 along an axis: then every direction changes.
        """
        slope = [0.0, 0.0, 1.0]
        for i, (eta, delta) in enumerate(((self.eta_x, self.delta_x), (self.eta_y, self.delta_y))):
            if delta != 0.0:
                if eta == 1.0:
                    raise ValueError(
                        f"eta = 1 with delta = {delta!r} turns every direction; none is undeviated"
                    )
                slope[i] = delta / (1.0 - eta)
        along = self.rotation @ np.array(slope)
        return np.asarray(along / np.linalg.norm(along))

    def inverse(self) -> Law:
        """Law of the sheet that, mounted behind this one, undoes it: η → 1/η, δ → −δ/η, same orientation.

        Returns
        -------
        Law
            As hardware: focal lengths exchanged, offset d kept. `reversed` is another operation.
        """
        return Law(
            1.0 / self.eta_x,
            1.0 / self.eta_y,
            -self.delta_x / self.eta_x,
            -self.delta_y / self.eta_y,
            self.phi,
            self.theta,
            self.psi,
            self.axes,
        )

    def reversed(self) -> Law:
        """Law of the sheet for light that runs through it backwards: η → 1/η, δ → +δ/η, θ → −θ.

        Returns
        -------
        Law
            In the frame (x, y, −z): with S = diag(1, 1, −1), a direction b with b·z < 0 leaves along
            S · reversed().refract(S · b). So S · reversed().refract(−S · refract(d)) = −d.
        """
        return Law(
            1.0 / self.eta_x,
            1.0 / self.eta_y,
            self.delta_x / self.eta_x,
            self.delta_y / self.eta_y,
            self.phi,
            -self.theta,
            self.psi,
            self.axes,
        )

    def then(self, other: Law) -> Law:
        """Law of one sheet equivalent to this sheet followed by `other`, where such a law exists.

        Parameters
        ----------
        other : Law
            The sheet that light passes second.

        Returns
        -------
        Law
            With matrix ∝ A_other A_self. With a common lens frame: η = η₁η₂, δ = δ₁ + η₁δ₂.

        Raises
        ------
        ValueError
            Where the product is no Law, naming the condition that failed: no common optical axis, or
            principal axes that do not agree (light is rotated about the axis).

        Notes
        -----
        A Law depends only on what enters and what leaves: a ray turned back between two sheets is refused by
        the pair but may be answered by their composition.
        """
        return Law(*compose(self.parameters, other.parameters))

    def canonical(self) -> Law:
        """The same law in the parameters to print: fixed axes, θ ≥ 0, −45° < φ ≤ 45°.

        Returns
        -------
        Law
            ψ = 0 where θ = 0; φ = 0 where η_x = η_y.
        """
        return Law(*canonical(self.parameters))

    def same_as(self, other: Law, tol: float = 1e-12) -> bool:
        """Whether both laws change every direction alike, also if their parameters differ.

        Parameters
        ----------
        other : Law
        tol : float
            Largest allowed difference of the matrices A, each divided by its Frobenius norm.
        """
        a, b = self.matrix(), other.matrix()
        return bool(np.max(np.abs(a / np.linalg.norm(a) - b / np.linalg.norm(b))) <= tol)

    @staticmethod
    def fit(d_in: ArrayLike, d_out: ArrayLike, axes: Law | None = None, aperture: float | None = None) -> Fit:
        """The Law that best explains measured directions, see `clacad.optics.law.fitting.fit_law`."""
        found = fit_law(d_in, d_out, None if axes is None else axes.parameters)
        return Fit(
            Law(*found.law),
            found.rms,
            found.covariance,
            found.rank,
            found.free,
            found.field,
            found.rays,
            aperture,
        )


@dataclass(frozen=True, eq=False)
class Fit:
    """A Law measured on a bundle of rays. It holds for that bundle: η over ±0.06 is not η over ±0.0006.

    Parameters
    ----------
    law : Law
        With the given axes held, else in canonical parameters.
    rms : float, radians
        Root mean square angle between measured and fitted exit directions.
    covariance : (7, 7) array
        Of (eta_x, eta_y, delta_x, delta_y, phi, theta, psi), angles in radians, from the scatter of the
        rays about the fit; 0 for a parameter that was held, infinite variance for one that the rays do
        not determine (θ = 0 leaves only φ + ψ; a round lens leaves φ free).
    rank : int
        Number of independent combinations of the free parameters that the rays determine.
    free : tuple of str
        Names of the parameters that were fitted.
    field : float, radians
        Half angle of the bundle before the sheet about its mean direction.
    rays : int
        Rays used (rows with a NaN are left out).
    aperture : float or None, length
        Width of the bundle on the sheet, as given by the caller.
    """

    law: Law
    rms: float
    covariance: Floats
    rank: int
    free: tuple[str, ...]
    field: float
    rays: int
    aperture: float | None = None

    @property
    def sigma(self) -> dict[str, float]:
        """Standard deviation of each free parameter (numbers, radians); infinite: not determined."""
        deviation = np.sqrt(np.diag(self.covariance))
        return {name: float(deviation[NAMES.index(name)]) for name in self.free}

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of the free parameters that the rays do not determine individually."""
        return tuple(name for name, deviation in self.sigma.items() if np.isinf(deviation))


def law_in_axes(d_in: ArrayLike, d_out: ArrayLike, axes: Law) -> Law:
    """Fit η and δ with the axes of another law held, without the uncertainties that `Law.fit` reports.

    Raises ValueError: As `fit_law`.
    """
    return Law(*held_fit(*usable_rays(d_in, d_out, 2), axes.parameters))


def law_numbers(law: Law) -> Floats:
    """Numbers (13,) used by `Law.refract`: η_x, η_y, δ_x, δ_y, then the rotation row by row."""
    return np.array([law.eta_x, law.eta_y, law.delta_x, law.delta_y, *law.rotation.ravel()])


def linear_numbers(law: Law) -> Floats:
    """Numbers (4,) in which a law is linear before normalising directions: 1/η_x, 1/η_y, δ_x/η_x, δ_y/η_y."""
    eta_x, eta_y = law.eta_x, law.eta_y
    return np.array([1.0 / eta_x, 1.0 / eta_y, law.delta_x / eta_x, law.delta_y / eta_y])


def with_linear_numbers(law: Law, numbers: Floats) -> Law:
    """The law given by four `linear_numbers`, with the orientation of another law.

    Raises
    ------
    ValueError
        1/η is 0 along an axis.
    """
    x, y, offset_x, offset_y = numbers.tolist()
    if x == 0.0 or y == 0.0:
        raise ValueError(NO_POWER)
    return Law(1.0 / x, 1.0 / y, offset_x / x, offset_y / y, law.phi, law.theta, law.psi, law.axes)


def difference_of_laws(found: Law, exact: Law) -> tuple[float, float]:
    """Largest relative difference of η, and largest difference of δ (slope), of two laws in the same axes."""
    eta = max(abs(found.eta_x / exact.eta_x - 1.0), abs(found.eta_y / exact.eta_y - 1.0))
    delta = max(abs(found.delta_x - exact.delta_x), abs(found.delta_y - exact.delta_y))
    return eta, delta
