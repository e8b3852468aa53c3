"""Optical materials: refractive index against wavelength, and known absorption.

Nothing is extrapolated: a wavelength outside the measured range is an error. Catalogue indices are relative
to air,
the medium around the sheet. `clacad.optics.material.catalogue` finds a material by its name.

Dispersion formulas: the only evaluator of refractive indices that are not plain numbers.

λ in micrometres throughout. The last five are the further formulas of refractiveindex.info
(M. N. Polyanskiy, Scientific Data 11, 94 (2024)).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import isfinite, pi
from typing import Literal, get_args, overload

import numpy as np

from clacad.base.text import nm_text
from clacad.base.types import Floats

Coefficients = tuple[float, ...]
Formula = Literal[
    "sellmeier", "schott", "cauchy", "constant", "table", "mixed", "gas", "herzberger", "retro", "exotic"
]


NAMES: tuple[str, ...] = get_args(Formula)


def index(formula: Formula, coefficients: Coefficients, micrometres: Floats) -> Floats:
    """Refractive index (n,) at wavelengths (n,); `Material` describes the coefficients of each formula."""
    return _FORMULAS[formula](coefficients, micrometres)


def fits(formula: Formula, count: int) -> bool:
    """Whether a formula accepts this number of coefficients."""
    return _COUNTS[formula](count)


def _sellmeier(c: Coefficients, um: Floats) -> Floats:
    square = um * um
    terms = [b * square / (square - pole) for b, pole in zip(c[::2], c[1::2], strict=True)]
    return np.asarray(np.sqrt(1.0 + np.sum(terms, axis=0)))


def _cauchy(c: Coefficients, um: Floats) -> Floats:
    return np.asarray(c[0] + np.sum([b * um**p for b, p in zip(c[1::2], c[2::2], strict=True)], axis=0))


def _schott(c: Coefficients, um: Floats) -> Floats:
    return np.asarray(np.sqrt(_cauchy(c, um)))


def _constant(c: Coefficients, um: Floats) -> Floats:
    return np.full(um.shape, c[0])


def _table(c: Coefficients, um: Floats) -> Floats:
    return np.asarray(np.interp(um, c[::2], c[1::2]))


def _mixed(c: Coefficients, um: Floats) -> Floats:
    poles = [b * um**p / (um * um - d**q) for b, p, d, q in (c[1:5], c[5:9])]
    return np.asarray(np.sqrt(_cauchy((c[0], *c[9:]), um) + np.sum(poles, axis=0)))


def _gas(c: Coefficients, um: Floats) -> Floats:
    terms = [b / (pole - um**-2.0) for b, pole in zip(c[1::2], c[2::2], strict=True)]
    return np.asarray(1.0 + c[0] + np.sum(terms, axis=0))


def _herzberger(c: Coefficients, um: Floats) -> Floats:
    inverse = 1.0 / (um * um - 0.028)
    return np.asarray(
        c[0] + c[1] * inverse + c[2] * inverse**2 + sum(b * um ** (2 * k) for k, b in enumerate(c[3:], 1))
    )


def _retro(c: Coefficients, um: Floats) -> Floats:
    square = um * um
    share = c[0] + c[1] * square / (square - c[2]) + c[3] * square  # (n² − 1)/(n² + 2)
    return np.asarray(np.sqrt((1.0 + 2.0 * share) / (1.0 - share)))


def _exotic(c: Coefficients, um: Floats) -> Floats:
    off = um - c[4]
    return np.asarray(np.sqrt(c[0] + c[1] / (um * um - c[2]) + c[3] * off / (off * off + c[5])))


_FORMULAS: dict[str, Callable[[Coefficients, Floats], Floats]] = {
    "sellmeier": _sellmeier,
    "schott": _schott,
    "cauchy": _cauchy,
    "constant": _constant,
    "table": _table,
    "mixed": _mixed,
    "gas": _gas,
    "herzberger": _herzberger,
    "retro": _retro,
    "exotic": _exotic,
}


def _odd(count: int) -> bool:
    return count >= 3 and count % 2 == 1


_COUNTS: dict[str, Callable[[int], bool]] = {
    "sellmeier": lambda n: n >= 2 and n % 2 == 0,
    "table": lambda n: n >= 4 and n % 2 == 0,
    "schott": lambda n: n == 1 or _odd(n),
    "cauchy": lambda n: n == 1 or _odd(n),
    "constant": lambda n: n == 1,
    "mixed": lambda n: n >= 9 and n % 2 == 1,
    "gas": _odd,
    "herzberger": lambda n: 3 <= n <= 6,
    "retro": lambda n: n == 4,
    "exotic": lambda n: n == 6,
}


MICROMETRES = 1e6
"""Micrometres per metre: the coefficients of published formulas take micrometres."""

F_LINE, D_LINE, C_LINE = 486.1327e-9, 587.5618e-9, 656.2725e-9
"""Wavelengths in metres of the Abbe number: blue and red lines of hydrogen, yellow line of helium."""

_EDGE = 1e-12  # relative; a wavelength converted from nm may miss the end of the range by rounding


class WavelengthNotKnown(ValueError):
    """A wavelength at which a property of a material is not known; exit status 2."""

    exit_status = 2


EXPANSION = "expansion: "
"""Words before the source of the expansion, where that of dn/dT is another."""

NOT_PUBLISHED = "no published value is in the table"
"""Words of messages for a thermal number that is not known."""


def state_it(name: str, number: str) -> str:
    """Hint: how a design states a thermal number (dn_dt, expansion) of a material."""
    return f'state its {number} with light.thermal = [{{material = "{name}", {number} = ...}}], per kelvin'


@dataclass(frozen=True, slots=True)
class ThermalNumbers:
    """Published properties of a material near room temperature; None where none is published.

    dn_dt : (1/K, metres) or None. Change of the index relative to air, and the wavelength it was measured at.
    expansion : float or None, 1/K. Linear.
    source : "" where it is the source of the index.
    """

    dn_dt: tuple[float, float] | None = None
    expansion: float | None = None
    source: str = ""


@dataclass(frozen=True, slots=True)
class Material:
    """A transparent material and its dispersion formula (λ in micrometres).

    Parameters
    ----------
    name : str
    formula : "sellmeier", "schott", "cauchy", "constant", "table" or another of
    `clacad.optics.material.material`
        sellmeier: n² = 1 + Σ B λ²/(λ² − C), coefficients (B, C, B, C, ...), C in µm².
        schott: n² = a + Σ b λ^p, coefficients (a, b, p, b, p, ...).
        cauchy: n = a + Σ b λ^p, coefficients as schott.
        constant: n, for every wavelength.
        table: (λ, n, λ, n, ...), λ ascending, linear in between.
    coefficients : tuple of float
    range_m : (shortest, longest) wavelength in metres, or None
        Where the formula was measured; None: everywhere (only a constant that was given as a number).
    source : str
        Where the coefficients come from.
    kind : str
        "plastic", "elastomer", "resin", "adhesive", "glass", "chalcogenide", "crystal" or "" for a plain
        number.
    density_kg_m3 : float or None
    thermal : ThermalNumbers
    extinction : tuple of (wavelength in metres, k)
        Imaginary part of the index where it is known, by ascending wavelength; else empty.
    extinction_source : str
    warmer : float, K
        Temperature above that of the data; it changes the index by dn/dT, the same at all wavelengths.

    Raises
    ------
    ValueError
        If the coefficients do not belong to the formula or the range is not ascending.
    """

    name: str
    formula: Formula
    coefficients: tuple[float, ...]
    range_m: tuple[float, float] | None
    source: str
    kind: str = ""
    density_kg_m3: float | None = None
    thermal: ThermalNumbers = ThermalNumbers()
    extinction: tuple[tuple[float, float], ...] = ()
    extinction_source: str = ""
    warmer: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a table entry that cannot be evaluated."""
        if self.formula not in NAMES:
            raise ValueError(f"{self.name}: no dispersion formula is called {self.formula!r}")
        count = len(self.coefficients)
        if not fits(self.formula, count):
            raise ValueError(f"{self.name}: {count} coefficients do not belong to the {self.formula} formula")
        if not all(isfinite(c) for c in self.coefficients):
            raise ValueError(f"{self.name}: a coefficient is not a finite number")
        if self.range_m is None and self.formula != "constant":
            raise ValueError(f"{self.name}: only a constant index has no range of wavelengths")
        if self.range_m is not None and not 0 < self.range_m[0] < self.range_m[1]:
            raise ValueError(f"{self.name}: wavelengths {self.range_m} are not an ascending range")

    def knows(self, wavelength_m: float) -> bool:
        """Whether the index is known at a wavelength in metres."""
        return self.range_m is None or self.range_m[0] <= wavelength_m <= self.range_m[1]

    @overload
    def index(self, wavelength_m: float) -> float: ...

    @overload
    def index(self, wavelength_m: Floats) -> Floats: ...

    def index(self, wavelength_m: float | Floats) -> float | Floats:
        """Refractive index at a wavelength.

        Parameters
        ----------
        wavelength_m : float or array, metres

        Returns
        -------
        float or array of the same shape

        Raises
        ------
        ValueError
            If a wavelength lies outside the measured range (never extrapolated).
        """
        wavelength = np.asarray(wavelength_m, np.float64)
        _within(wavelength, self.range_m, f"the index of {self.name} is known")
        n = np.asarray(index(self.formula, self.coefficients, wavelength * MICROMETRES))
        if self.warmer:
            n = np.asarray(n + self.index_change)
        return float(n) if n.ndim == 0 else n

    @property
    def index_change(self) -> float:
        """Change of the index by `warmer`: 0 at the temperature of the data.

        Raises
        ------
        ValueError
            If no dn/dT is published for the material.
        """
        if self.warmer == 0.0:
            return 0.0
        if self.thermal.dn_dt is None:
            raise ValueError(f"dn/dT of {self.name}: {NOT_PUBLISHED}; {state_it(self.name, 'dn_dt')}")
        return self.thermal.dn_dt[0] * self.warmer

    def heated(self, kelvin: float) -> Material:
        """The material at a temperature `kelvin` higher."""
        return replace(self, warmer=self.warmer + kelvin)

    @property
    def abbe_number(self) -> float | None:
        """V_d = (n_d - 1)/(n_F - n_C).

        None where the index is not known at one of these lines, or is constant.
        """
        low, high = self.range_m or (D_LINE, D_LINE)
        if low > F_LINE or high < C_LINE:
            return None
        return (self.index(D_LINE) - 1.0) / (self.index(F_LINE) - self.index(C_LINE))

    def extinction_coefficient(self, wavelength_m: float) -> float | None:
        """Imaginary part k of the index, interpolated in log k; None where no k is known.

        Parameters
        ----------
        wavelength_m : float, metres

        Raises
        ------
        ValueError
            If k was measured, but not at this wavelength.
        """
        if not self.extinction:
            return None
        known, k = np.array(self.extinction).T
        _within(np.asarray(wavelength_m), (known[0], known[-1]), f"the absorption of {self.name} is known")
        return float(np.exp(np.interp(wavelength_m, known, np.log(k))))

    def attenuation(self, wavelength_m: float) -> float | None:
        """Attenuation α = 4πk/λ in 1/m (Beer–Lambert); None where no k is known.

        Parameters
        ----------
        wavelength_m : float, metres

        Raises
        ------
        ValueError
            As `extinction_coefficient`.
        """
        k = self.extinction_coefficient(wavelength_m)
        return None if k is None else 4.0 * pi * k / wavelength_m


def constant(index: float, name: str | None = None) -> Material:
    """A material of one index at every wavelength.

    index : n ≥ 1.
    name : optional
    Raises ValueError: If the index is not a finite number ≥ 1.
    """
    if not (isfinite(index) and index >= 1.0):
        raise ValueError(f"index = {index!r} is no refractive index of a transparent solid; it must be >= 1")
    return Material(name or f"n = {index:g}", "constant", (float(index),), None, "as given")


def _within(wavelength: Floats, known: tuple[float, float] | None, what: str) -> None:
    """Refuse wavelengths outside a range, naming both."""
    if not (np.isfinite(wavelength).all() and (wavelength > 0).all()):
        raise WavelengthNotKnown(f"wavelength {wavelength} m is not a positive number")
    if known is None:
        return
    outside = (wavelength < known[0] * (1 - _EDGE)) | (wavelength > known[1] * (1 + _EDGE))
    if outside.any():
        worst = float(np.atleast_1d(wavelength)[np.atleast_1d(outside)][0])
        said = nm_text(worst, 6) if worst < 1.0 else f"{worst:.6g} m"
        raise WavelengthNotKnown(
            f"wavelength {said}: {what} from {known[0] * 1e9:.6g} to {nm_text(known[1], 6)} only"
        )
