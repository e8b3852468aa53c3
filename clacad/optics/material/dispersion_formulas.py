"""Dispersion formulas: the only evaluator of refractive indices that are not plain numbers.

λ in micrometres throughout. The last five are the further formulas of refractiveindex.info
(M. N. Polyanskiy, Scientific Data 11, 94 (2024)).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np

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
    "sellmeier": _sellmeier, "schott": _schott, "cauchy": _cauchy, "constant": _constant, "table": _table,
    "mixed": _mixed, "gas": _gas, "herzberger": _herzberger, "retro": _retro, "exotic": _exotic,
}  # fmt: skip


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
