"""Images formed by a non-uniform sheet, per axis and in closed form.

Chief rays run through the centres X of the lenses of array 1 and leave array 2 at X + s t with the slope t' =
(t − δ₀ − κX)/η. Every point is therefore imaged to a point. Heights z count from array 1, image distances ζ
from array 2, both towards +z, so a light source has z < 0. With η < 0 both foci lie on one side, unlike those
of any lens: C. Hembd-Sölner, R. F. Stevens and M. C. Hutley, J. Opt. A 1, 94 (1999); D. Gabor, UK patent 541
753 (1940).

All numbers of a sheet are computed as fractions and rounded once. No accuracy is lost for κ = 1e-12, for
pitches that agree to 1e-12 or for objects close to a focus. A quotient that overflows is infinite.

A law whose offset differs over the sheet: δ(r) = δ₀ + K r.

A sheet of cells has two laws. The built one belongs to the cell hit, with δ at the cell's centre. The smooth
one has δ at the exact point. Their difference is the sampling error. K need not be symmetric: with an
antisymmetric part the picture rotates, which separate cells can do but no smooth phase element.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from math import hypot, inf, isinf, sin, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from clacad.base.pairs import pair, pair_product, pair_sum
from clacad.base.types import Floats, Pair2
from clacad.optics.law.refraction import refracted

if TYPE_CHECKING:
    from clacad.optics.law.law import Law

Gradient = tuple[Pair2, Pair2]
"""K, 1/length: row i is the change of δ_i (lens axes) with the position on the sheet (sheet axes)."""


@dataclass(frozen=True, slots=True)
class VaryingLaw:
    """A law of refraction whose offset δ is linear in the position on the sheet.

    law : At the sheet's origin.
    gradient : ((K_xx, K_xy), (K_yx, K_yy)), 1/length. Rows: lens axes; columns: sheet axes.
    """

    law: Law
    gradient: Gradient

    def deltas(self, places: ArrayLike) -> Floats:
        """δ at points of the sheet, rounded once even under cancellation.

        places : (..., 2) array, lengths. Sheet frame.
        Returns (..., 2) array.
        """
        points = np.asarray(places, np.float64)
        x, y = pair(points[..., 0]), pair(points[..., 1])
        middle = (self.law.delta_x, self.law.delta_y)
        summed = [
            pair_sum(pair_product(pair(along), x), pair_product(pair(across), y), pair(start))
            for start, (along, across) in zip(middle, self.gradient, strict=True)
        ]
        return np.stack([high + low for high, low in summed], axis=-1)

    def law_at(self, place: ArrayLike) -> Law:
        """The homogeneous law (`Law`) at one point (2,), lengths, of the sheet."""
        delta_x, delta_y = self.deltas(place).tolist()
        return replace(self.law, delta_x=delta_x, delta_y=delta_y)

    def refract(self, d: ArrayLike, places: ArrayLike) -> Floats:
        """Directions behind the sheet by the smooth law.

        d : (n, 3) array. Directions before the sheet, any length > 0.
        places : (n, 2) array, lengths. Points at which they cross it.
        Returns (n, 3) array: Unit directions, NaN rows as of `Law.refract`.
        """
        return refract_each(self.law, self.deltas(places), d)


def ratios_of(law: Law) -> Pair2:
    """η = −f2/f1 along the lens axes."""
    return law.eta_x, law.eta_y


def refract_each(
    law: Law, deltas: Floats, d: ArrayLike, ratios: Floats | None = None, turns: Floats | None = None
) -> Floats:
    """Directions (n, 3) behind a sheet with an offset (n, 2), and optionally an η (n, 2) and lens axes
    (n, 3, 3), for each of them.

    See `Law.refract` for all else.
    """
    axes = law.rotation if turns is None else turns
    return refracted(ratios_of(law) if ratios is None else ratios, deltas, axes, d)


Exact = Fraction


@dataclass(frozen=True, slots=True)
class Glens:
    """One axis of a sheet of thin pairs with δ(x) = δ₀ + κ x.

    eta, kappa : number and 1/length
    separation : length. From array 1 to array 2; 0 is the sheet of no thickness.
    delta : δ₀, at the sheet's origin.
    """

    eta: float
    kappa: float
    separation: float = 0.0
    delta: float = 0.0

    @property
    def f_image(self) -> float:
        """Distance from array 2 (length) at which parallel light meets: η/κ."""
        return _ratio(Exact(self.eta), Exact(self.kappa))

    @property
    def f_object(self) -> float:
        """Height from array 1 (length) of a point whose light leaves parallel: −1/κ."""
        return _ratio(Exact(-1), Exact(self.kappa))

    @property
    def nodal_z(self) -> float:
        """Height (length) of the point whose light is not deviated: (η − 1)/κ."""
        return _ratio(Exact(self.eta) - 1, Exact(self.kappa))

    def image_distance(self, z: float) -> float:
        """Image distance ζ (length) from array 2 for height z (length; −inf: parallel light).

        A negative distance: a virtual image.
        """
        if isinf(z):
            return self.f_image
        return _ratio(*self._distance(Exact(z)))

    def image_x(self, x: float, z: float) -> float:
        """Lateral position of the image of the point (x, z), lengths; z finite. Infinite at the focus."""
        high, low = self._distance(Exact(z))
        chief = Exact(x) / Exact(z)  # slope through the middle of lens 1
        return _ratio(
            (chief - Exact(self.delta)) * high + Exact(self.eta) * low * Exact(self.separation) * chief,
            Exact(self.eta) * low,
        )

    def magnification(self, z: float) -> float:
        """Lateral magnification dx_i/dx_o of an object at height z (length)."""
        high, low = self._distance(Exact(z))
        place, eta = Exact(z), Exact(self.eta)
        return _ratio(high + Exact(self.separation) * eta * low, eta * place * low)

    def width(self, z: float, pitch: float) -> float:
        """Full width (length) of the image of a point at height z when cells of a pitch fill lens 1.

        A cell does not focus, so this width is the limit of its pixels. Parallel light (z = −inf): |η| p.
        """
        if isinf(z):
            return float(abs(Exact(self.eta) - (self.kappa == 0.0)) * Exact(pitch))
        place, s = Exact(z), Exact(self.separation)
        power = 1 + Exact(self.kappa) * place
        spread = (Exact(self.eta) * place - s) * power - (place - s)
        return abs(_ratio(Exact(pitch) * spread, place * power))

    def _distance(self, z: Exact) -> tuple[Exact, Exact]:
        """ζ = η (z − s)/(1 + κz) as numerator and denominator."""
        return Exact(self.eta) * (z - Exact(self.separation)), 1 + Exact(self.kappa) * z


def along_axes(law: VaryingLaw, separation: float) -> tuple[Glens, Glens]:
    """Images along each lens axis of an upright sheet with a varying law.

    Terms that mix the axes are left out.

    separation : length, of the arrays
    """
    turned = np.asarray(law.gradient) @ law.law.rotation[:2, :2]
    x, y = float(turned[0, 0]), float(turned[1, 1])
    one = law.law
    return Glens(one.eta_x, x, separation, one.delta_x), Glens(one.eta_y, y, separation, one.delta_y)


def focusing_at(eta: float, f_image: float) -> float:
    """κ, 1/length: the gradient of δ that brings parallel light to f_image (length) behind array 2."""
    return 0.0 if isinf(f_image) else _ratio(Exact(eta), Exact(f_image))


def imaging(eta: float, z: float, image: float, separation: float = 0.0) -> float:
    """κ, 1/length, that images the height z to `image` behind array 2 (lengths) with a given η."""
    if isinf(z):
        return focusing_at(eta, image)
    place = Exact(z)
    reach = Exact(0) if isinf(image) else Exact(eta) * (place - Exact(separation)) / Exact(image)
    return _ratio(reach - 1, place)


def imaging_scaled(z: float, image: float, magnification: float, separation: float = 0.0) -> Pair2:
    """η and κ (1/length) that image the height z to `image` behind array 2 (lengths) with a magnification.

    Both are infinite where the object's image would lie in array 2 itself, m z = s.
    """
    reach = Exact(magnification) * Exact(z) - Exact(separation)
    return _ratio(Exact(image), reach), _ratio(1 - Exact(magnification), reach)


@dataclass(frozen=True, slots=True)
class Superlens:
    """One axis of two arrays of thin lenses of two pitches, cells and vertices of each at its own.

    pitches, focal_lengths : (2,) lengths. p1, p2 and f1, f2; the arrays are mounted f1 + f2 apart.
    turn : radians
        Rotation of the second array against the first. κ, foci and nodal point are given without it.

    Notes
    -----
    Each cell of array 2 is aimed at the nodal point: light along the normal stays with its partner over one
    `zone_period`, so a single superlens is a lattice of lenses of that period and of `f_number`.
    """

    pitches: Pair2
    focal_lengths: Pair2
    turn: float = 0.0

    @property
    def eta(self) -> float:
        """η = −f2/f1."""
        f1, f2 = map(Exact, self.focal_lengths)
        return _ratio(-f2, f1)

    @property
    def kappa(self) -> float:
        """κ = (p2 − p1)/(p1 f1), 1/length."""
        (p1, p2), f1 = map(Exact, self.pitches), Exact(self.focal_lengths[0])
        return _ratio(p2 - p1, p1 * f1)

    @property
    def f_image(self) -> float:
        """Distance behind array 2 (length) at which parallel light meets: f2 p1/(p1 − p2)."""
        return self._over_difference(Exact(self.focal_lengths[1]))

    @property
    def f_object(self) -> float:
        """Height (length) of a point whose light leaves parallel: f1 p1/(p1 − p2)."""
        return self._over_difference(Exact(self.focal_lengths[0]))

    @property
    def nodal_z(self) -> float:
        """Height (length) of the point at which all pairs are aimed: (f1 + f2) p1/(p1 − p2)."""
        return self._over_difference(sum(map(Exact, self.focal_lengths), Exact(0)))

    @property
    def moire_period(self) -> float:
        """Moiré period (length): p1 p2/|p1 − p2|.

        With a rotation α, √((p1 − p2)² + 4 p1 p2 sin²(α/2)) replaces the difference.
        """
        return self._over_distance(self.pitches[1])

    @property
    def zone_period(self) -> float:
        """Width, length, over which light along the normal stays with its partner: p1²/|p2 − p1|."""
        return self._over_distance(self.pitches[0])

    @property
    def f_number(self) -> float:
        """|f_image| over the zone period: |f2|/p1."""
        return abs(_ratio(Exact(self.focal_lengths[1]), Exact(self.pitches[0])))

    def _over_distance(self, length: float) -> float:
        if self.turn == 0.0:
            return abs(self._over_difference(Exact(length)))
        p1, p2 = self.pitches
        apart = hypot(float(Exact(p1) - Exact(p2)), 2.0 * sqrt(p1 * p2) * sin(0.5 * self.turn))
        return length * p1 / apart

    def _over_difference(self, length: Exact) -> float:
        p1, p2 = map(Exact, self.pitches)
        return _ratio(length * p1, p1 - p2)


@dataclass(frozen=True, slots=True)
class SharpPair:
    """Thin lenses that image one plane to another sharply, all pairs alike; the pairs are not afocal.

    focal_lengths : (2,) lengths
    object_z : length. Height of the object plane, array 1 at 0.
    image_distance : length. From array 2.

    Notes
    -----
    With v the image by lens 1 and u = f2 ζ/(ζ − f2): every ray of every pair meets at the image.
    """

    focal_lengths: Pair2
    object_z: float
    image_distance: float

    @staticmethod
    def of(
        eta: float, separation: float, object_z: float, image_distance: float, field: bool = False
    ) -> SharpPair:
        """The pair with lenses `separation` apart whose chief rays (through the middle of lens 1) have η.

        Behind lens 2 their slope is t (1 − s/f2) + …, so that f2 = −η s/(1 − η) for any planes. Lens 1 then
        images the object to where lens 2 needs it. f1 is 0 where lens 2 needs the image in lens 1, infinite
        where it needs no lens 1.

        field : Whether a field lens images lens 1 onto lens 2. The image between them then lies at that lens,
            s/(1 − η) behind lens 1, for any planes: each lens gains the power that its own plane needs.
        """
        s, f2 = Exact(separation), -Exact(eta) * Exact(separation) / (1 - Exact(eta))
        near, far = _reciprocal(object_z), _reciprocal(image_distance)
        if field:
            f1 = s - f2
            first, second = _ratio(f1, 1 - near * f1), _ratio(f2, 1 + far * f2)
            return SharpPair((first, second), object_z, image_distance)
        between = s * (1 - f2 * far) - f2, 1 - f2 * far  # v, as numerator and denominator
        return SharpPair(
            (_ratio(between[0], between[1] - near * between[0]), float(f2)), object_z, image_distance
        )

    @property
    def separation(self) -> float:
        """Separation of the arrays, length: v + u."""
        (a, b), (c, d) = self._between()
        return _ratio(a * d + c * b, b * d)

    @property
    def pitch_ratio(self) -> float:
        """p2/p1 = (1 − v/z) ζ/(u + ζ) = (1 − f2/ζ)/(1 + f1/z)."""
        (_, b), (_, d) = self._between()
        return _ratio(d, b)

    @property
    def magnification(self) -> float:
        """−v ζ/(z u)."""
        (a, b), (c, d) = self._between()
        return _ratio(-a * d * _reciprocal(self.object_z), b * c * _reciprocal(self.image_distance))

    def _between(self) -> tuple[tuple[Exact, Exact], tuple[Exact, Exact]]:
        """Return v and u, each as numerator and denominator: f1/(1 + f1/z) and f2/(1 − f2/ζ)."""
        f1, f2 = map(Exact, self.focal_lengths)
        return (f1, 1 + f1 * _reciprocal(self.object_z)), (f2, 1 - f2 * _reciprocal(self.image_distance))


def cell_width(focal_lengths: Pair2, separation: float, planes: Pair2, pitch: float) -> float:
    """Full width (length) of a point's light on a plane behind array 2 when one cell of a pitch fills lens 1.

    planes : (z, ζ), lengths. Height of the point from array 1, and of the plane from array 2. Either may be
        infinite (then: 0, or an angle).
    """
    f1, f2 = map(Exact, focal_lengths)
    slope = -_reciprocal(planes[0]) - 1 / f1
    height = 1 + Exact(separation) * slope
    slope -= height / f2
    if isinf(planes[1]):
        return float(abs(slope) * Exact(pitch))
    return float(abs(height + Exact(planes[1]) * slope) * Exact(pitch))


def _reciprocal(length: float) -> Exact:
    return Exact(0) if isinf(length) else 1 / Exact(length)


def _ratio(numerator: Exact, denominator: Exact) -> float:
    """A quotient rounded once; overflow and division by 0 give infinity."""
    try:
        return float(numerator / denominator)
    except (OverflowError, ZeroDivisionError):
        return inf if (numerator < 0) == (denominator < 0) else -inf
