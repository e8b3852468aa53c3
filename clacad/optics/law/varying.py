"""A law whose offset differs over the sheet: δ(r) = δ₀ + K r.

A sheet of cells has two laws. The built one belongs to the cell hit, with δ at the cell's centre. The smooth
one has δ at the exact point. Their difference is the sampling error. K need not be symmetric: with an
antisymmetric part the picture rotates, which separate cells can do but no smooth phase element.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from clacad.base.pairs import pair, pair_product, pair_sum
from clacad.base.types import Floats, Pair2
from clacad.optics.law.law import Law
from clacad.optics.law.refraction import refracted

Gradient = tuple[Pair2, Pair2]
"""K, 1/length: row i is the change of δ_i (lens axes) with the position on the sheet (sheet axes)."""


@dataclass(frozen=True, slots=True)
class VaryingLaw:
    """A law of refraction whose offset δ is linear in the position on the sheet.

    Parameters
    ----------
    law : Law
        At the sheet's origin.
    gradient : ((K_xx, K_xy), (K_yx, K_yy)), 1/length
        Rows: lens axes; columns: sheet axes.
    """

    law: Law
    gradient: Gradient

    def deltas(self, places: ArrayLike) -> Floats:
        """δ at points of the sheet, rounded once even under cancellation.

        Parameters
        ----------
        places : (..., 2) array, lengths
            Sheet frame.

        Returns
        -------
        (..., 2) array
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

        Parameters
        ----------
        d : (n, 3) array
            Directions before the sheet, any length > 0.
        places : (n, 2) array, lengths
            Points at which they cross it.

        Returns
        -------
        (n, 3) array
            Unit directions, NaN rows as of `Law.refract`.
        """
        return refract_each(self.law, self.deltas(places), d)


def ratios_of(law: Law) -> Pair2:
    """η = −f2/f1 along the lens axes."""
    return law.eta_x, law.eta_y


def with_ratios(law: Law, ratios: Floats) -> Law:
    """The law with another η (2,) along the lens axes."""
    eta_x, eta_y = ratios.tolist()
    return replace(law, eta_x=eta_x, eta_y=eta_y)


def refract_each(law: Law, deltas: Floats, d: ArrayLike, ratios: Floats | None = None) -> Floats:
    """Directions (n, 3) behind a sheet with an offset (n, 2), and optionally an η (n, 2), for each of them.

    See `Law.refract` for all else.
    """
    return refracted(ratios_of(law) if ratios is None else ratios, deltas, law.rotation, d)
