"""Indices at the ends of their range, and layers of two glasses whose colours nearly cancel; each with its reason."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

from mpmath import mp, mpf

DIGITS = 50
TINY = mpf("1e-25")


def index(formula, coefficients, um):
    """Refractive index in the digits of the context: n² = 1 + Σ B λ²/(λ² − C), n² = a + Σ b λ^p, or n = a + Σ b λ^p."""
    c = [mpf(v) for v in coefficients]
    if formula == "sellmeier":
        return mp.sqrt(1 + sum(b * um**2 / (um**2 - p) for b, p in zip(c[::2], c[1::2], strict=True)))
    if formula == "gas":
        return 1 + c[0] + sum(b / (pole - um**-2) for b, pole in zip(c[1::2], c[2::2], strict=True))
    n = c[0] + sum(b * um**p for b, p in zip(c[1::2], c[2::2], strict=True))
    return mp.sqrt(n) if formula == "schott" else n


@dataclass(frozen=True)
class HardIndex:
    """A dispersion formula and a wavelength (metres) at which its index is hard."""

    name: str
    why: str
    formula: str
    coefficients: tuple[float, ...]
    metres: float

    def exact(self):
        """Index in 50 digits; the wavelength is the stored number of metres."""
        with mp.workdps(DIGITS):
            return index(self.formula, self.coefficients, mpf(self.metres) * 10**6)

    def condition(self):
        """Relative change of the index for relative changes of the wavelength and of every coefficient, summed."""
        with mp.workdps(DIGITS):
            um, n, total = mpf(self.metres) * 10**6, self.exact(), mpf(0)
            for k in range(-1, len(self.coefficients)):
                moved = [mpf(v) * (1 + (TINY if j == k else 0)) for j, v in enumerate(self.coefficients)]
                grown = index(self.formula, moved, um * (1 + (TINY if k < 0 else 0)))
                total += abs(grown / n - 1) / TINY
            return float(total)


@dataclass(frozen=True)
class HardLayer:
    """Cauchy glasses n = a + b λ⁻² outside and inside a slab, and the lines (metres) in which it is afocal."""

    name: str
    why: str
    outer: tuple[float, float]
    inner: tuple[float, float]
    lines: tuple[float, float] = (486.1e-9, 656.3e-9)
    middle: float = 546.1e-9

    def indices(self):
        """Indices of both glasses at the middle and the outer lines, in 50 digits."""
        with mp.workdps(DIGITS):
            return [
                index("cauchy", (*glass, -2.0), mpf(wave) * 10**6)
                for glass, wave in product((self.outer, self.inner), (self.middle, *self.lines))
            ]

    def exact(self):
        """Share of s/n in the inner glass for which C of the slab is the same in both lines."""
        with mp.workdps(DIGITS):
            return _share(self.indices())

    def condition(self):
        """Change of the share (relative) for relative changes of the six indices, summed."""
        with mp.workdps(DIGITS):
            given, share = self.indices(), self.exact()
            moved = [[n * (1 + (TINY if j == k else 0)) for j, n in enumerate(given)] for k in range(6)]
            return float(sum(abs(_share(one) / share - 1) for one in moved) / TINY)


def _share(n):
    """From T1/n1 + T2/n2 = s and (T1/n1)(Δ1/n1) + (T2/n2)(Δ2/n2) = s Δ1/(n1 − 1)."""
    (n1, first1, last1), (n2, first2, last2) = n[:3], n[3:]
    a, b = (first1 - last1) / n1, (first2 - last2) / n2
    return ((first1 - last1) / (n1 - 1) - a) / (b - a)


PMMA = (2.399964, -0.08308636, 2.0, -0.1919569, -2.0, 0.08720608, -4.0, -0.01666411, -6.0, 0.001169519, -8.0)
SILICA = (0.6961663, 0.00467914825849, 0.4079426, 0.013512063073959999, 0.8974794, 97.93400253792099)
SF6 = (1.77931763, 0.0133714182, 0.338149866, 0.0617533621, 2.08734474, 174.01759)
NOA = (1.5375, 0.00829045, -2.0, -0.000211046, -4.0)

INDICES = [
    HardIndex("PMMA, short end", "five powers of 1/λ, to the eighth", "schott", PMMA, 435.8e-9),
    HardIndex("PMMA, long end", "the terms of 1/λ hardly count", "schott", PMMA, 1.052e-6),
    HardIndex("silica, short end", "λ² is 3 times the larger pole of the ultraviolet", "sellmeier", SILICA, 210e-9),
    HardIndex("silica, long end", "λ² is 1/7 of the infrared pole, and n² falls", "sellmeier", SILICA, 3.71e-6),
    HardIndex("N-SF6, short end", "steepest where it is known", "sellmeier", SF6, 370e-9),
    HardIndex("N-SF6, long end", "an infrared pole that was never measured", "sellmeier", SF6, 2.5e-6),
    HardIndex("NOA61, short end", "two terms of opposite sign", "cauchy", NOA, 450e-9),
    HardIndex("NOA61, long end", "the index is its constant", "cauchy", NOA, 1.55e-6),
    HardIndex("1e-9 above a pole", "λ² − C keeps 7 digits", "sellmeier", (0.7, 0.01), 1.00000000050000005e-7),
    HardIndex("dispersion of 1e-9", "Δn is eight digits below n", "cauchy", (1.5, 1e-9, -2.0), 486.1e-9),
    HardIndex("gas", "n − 1 = 3e-4", "gas", (0.0, 0.05792105, 238.0185, 0.00167917, 57.362), 230e-9),
]  # fmt: skip

LAYERS = [
    HardLayer("silica and flint", "the layers that are built", (1.4477, 0.00354), (1.7645, 0.01388)),
    HardLayer("inner V a third of the outer", "an inner layer of half the length", (1.5, 0.004), (1.5, 0.02)),
    HardLayer("equal V", "V = (n − 1)/Δn is that of the outer glass, and Δn/n is larger all the same", (1.5, 0.004), (1.8, 0.0064)),
    HardLayer("equal Δn over n", "no length of it undoes any colour", (1.5, 0.005), (1.8, 0.006000000001)),
    HardLayer("equal Δn over n, from below", "a share of -1e10", (1.5, 0.005), (1.8, 0.005999999999)),
    HardLayer("Δn = 1e-9 in both", "nine digits of every difference are lost", (1.5, 7e-10), (1.5, 3e-9)),
    HardLayer("Δn = 1e-9 outside", "an outer glass without colour: nearly nothing of the inner one", (1.45, 6e-10), (1.8, 0.0139)),
    HardLayer("lines 1e-9 apart", "Δn is rounding for seven digits", (1.4477, 0.00354), (1.7645, 0.01388), (546.1e-9, 546.1e-9 * (1 + 1e-9))),
    HardLayer("index 1 + 1e-9 outside", "n − 1 is rounding", (1.0, 3e-10), (1.8, 0.5)),
]  # fmt: skip
