"""Numbers as text for people: values of a design, and a value with the limit it is compared with."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from decimal import Decimal
from math import ceil, floor, isfinite, isinf, isnan, log10
from numbers import Real
from typing import Any, NamedTuple

ROUNDING = 1e-12
"""Magnitude below which a number of a design, in a unit near its sizes,
is the rounding error of an exact 0.
"""

NOTHING = 1e-8
"""Fraction of its limit below which a value is shown as 0; JSON has the exact value."""

SHOWN_IN = {"rad": (1000, "mrad")}
"""Units that are shown in another unit: factor and name."""

DIGITS = 5
"""Significant digits of a value and its limit, unless more are needed to distinguish them."""

NO_LIMIT = "no limit"
"""Text of an infinite limit."""

MOST = 17
"""Significant digits that distinguish any two float64 numbers."""


def digits(value: float, infinite: str = "unlimited", count: int = 6) -> str:
    """Significant digits of a number of a design; a rounding error of 0 is written as 0.

    infinite : text of +∞ (a radius: flat); −∞ and NaN are "none".
    """
    if not isfinite(value):
        return infinite if value > 0.0 else "none"
    return f"{value:.{count}g}" if abs(value) > ROUNDING else "0"


def rounded_up(length: float) -> str:
    """Four digits of a positive length, rounded up, with at least 1e-6 of the length to spare."""
    digit = 10.0 ** (floor(log10(length)) - 3)
    return f"{ceil(length / digit * (1.0 + 1e-6)) * digit:.4g}"


class Shown(NamedTuple):
    """A value and its limit as text, their unit, and a note on a limit that does not explain the state."""

    value: str
    limit: str
    unit: str
    note: str = ""


def shown(
    value: float | str | None,
    limit: float | str | None,
    relation: str = "<=",
    unit: str = "",
    state: str = "",
) -> Shown:
    """Write a value and its limit with as many digits as the comparison needs.

    Parameters
    ----------
    value, limit : float, text or None
        None is "–"; an infinite limit is "no limit". Angles in rad are shown in mrad.
    relation : "<=", "<", ">=", ">" or a word
        How the value is compared with the limit.
    state : "pass", "fail", another, or ""
        Verdict on the value. Where the limit is kept but the state is "fail", the note records it.

    Returns
    -------
    Shown
        The printed numbers fulfil `relation` exactly if value and limit do.
    """
    factor, name = SHOWN_IN.get(unit, (1, unit))
    holds = HOLDS.get(relation)
    if holds is None or not (_finite(value) and _finite(limit)):
        unbound = _infinite(limit)
        return Shown(
            _text(value, factor, DIGITS), NO_LIMIT if unbound else _text(limit, factor, DIGITS), name
        )
    truth = holds(value, limit)
    if 0.0 < abs(value) < NOTHING * abs(limit) and holds(0.0, limit) == truth:  # type: ignore[arg-type]
        return shown(0, limit, relation, unit, state)
    texts = next(
        (found for count in range(DIGITS, MOST + 1)
         if holds(*map(Decimal, found := (_text(value, factor, count), _text(limit, factor, count)))) == truth),
        (_exactly(value, factor), _exactly(limit, factor)),
    )  # fmt: skip
    return Shown(*texts, name, {("fail", True): ELSEWHERE, ("pass", False): UNBOUND}.get((state, truth), ""))


ELSEWHERE = " (kept; it failed for what the text says)"
"""Note on a limit that is kept by a check that failed."""

UNBOUND = " (for comparison)"
"""Note on a limit that is not kept by a check that passed."""


def _finite(value: object) -> bool:
    return isinstance(value, Real) and isfinite(value)


def _infinite(value: object) -> bool:
    return isinstance(value, Real) and isinf(value)


def bound(relation: str, limit: str, unit: str = "") -> str:
    """Write a limit, as text of `shown`, with its relation and unit: "<= 3 mrad", "no limit"."""
    return limit if limit == NO_LIMIT else f"{relation} {limit} {unit}".rstrip()


def _exactly(value: Any, factor: int) -> str:
    return str(Decimal(float(value)) * factor)


HOLDS: Mapping[str, Callable[[Any, Any], bool]] = {
    "<=": operator.le, "<": operator.lt, ">=": operator.ge, ">": operator.gt,
}  # fmt: skip
"""Relation between a value and its limit → comparison function."""


def plainly(value: float | str | None, unit: str = "") -> tuple[str, str]:
    """Write a value that has no limit: its text, and the unit it is shown in."""
    factor, name = SHOWN_IN.get(unit, (1, unit))
    return _text(value, factor, DIGITS), name


def _text(value: float | str | None, factor: int, count: int) -> str:
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    if not isfinite(value):
        return "not known" if isnan(value) else "none"
    return str(factor * value) if isinstance(value, int) else f"{factor * value:.{count}g}"
