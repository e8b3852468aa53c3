"""Words and values as text: suggestions for misspelt words, and any value as plain JSON.

Numbers as text for people: values of a design, counts, angles, shares, wavelengths, bytes and seconds, and a
value with the limit it is compared with.

Integers in untrusted text, with at most as many digits as always fit into 64 bits.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from decimal import Decimal
from math import ceil, floor, isfinite, isinf, isnan, log10
from numbers import Real
from typing import Any, Final, Literal, NamedTuple

DEEPEST = 64
"""Greatest nesting depth of files and of converted values: it ends self-referencing values."""


def near(word: str, words: Iterable[str], cutoff: float = 0.6, most: int = 1) -> list[str]:
    """Return the words most similar to a given word, the most similar first.

    word : Word as written.
    words : Valid words.
    cutoff : Least similarity, 0 … 1.
    most : Greatest number of words returned.
    """
    from difflib import get_close_matches

    return get_close_matches(word, list(words), n=most, cutoff=cutoff)


def did_you_mean(words: Sequence[str], quote: str = "", before: str = "") -> str:
    """Return a question whether one of some words was meant; "" for no words.

    quote : Quotation mark around each word.
    before : Text before the question, such as "; ".
    """
    return f"{before}did you mean {' or '.join(f'{quote}{word}{quote}' for word in words)}?" if words else ""


def null(number: float) -> None:
    """Return None in place of a number that is not finite: JSON has no other representation."""
    return None


def plain(value: Any, not_finite: Callable[[float], Any] = null, depth: int = 0) -> Any:
    """Return a value as JSON types: no numpy, no tuples, text keys only; objects of other types stay.

    value : Nested mappings, lists, tuples, arrays and scalars.
    not_finite : Returns the replacement of NaN and infinities; default null, `float` leaves them.
    depth : Nesting depth of the value; below 64 levels it stays as it is.
    """
    if depth > DEEPEST:
        return value
    if isinstance(value, Mapping):
        return {str(key): plain(item, not_finite, depth + 1) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item, not_finite, depth + 1) for item in value]
    if hasattr(value, "tolist"):  # numpy scalars and arrays
        return plain(value.tolist(), not_finite, depth + 1)
    if isinstance(value, float) and not isfinite(value):
        return not_finite(value)
    return value


def table(rows: Iterable[Sequence[str]], indent: str = "  ") -> str:
    """Align the columns of rows of text; the last column is not padded."""
    rows = [[str(cell) for cell in row] for row in rows]
    if not rows:
        return ""
    widths = [
        max((len(row[k]) for row in rows if k < len(row)), default=0) for k in range(max(map(len, rows)))
    ]
    return "\n".join(
        indent
        + "  ".join(
            cell if k == len(row) - 1 else cell.ljust(widths[k]) for k, cell in enumerate(row)
        ).rstrip()
        for row in rows
    )


def printable_lines(text: str) -> str:
    """Return a text of several lines without characters that could move the cursor; see `printable`."""
    return "\n".join(map(printable, text.rstrip("\n").split("\n")))


def printable(text: str) -> str:
    """Return the text with every character that could move the cursor replaced by a space or a '?'.

    An untrusted file must not control the terminal. The length is kept, so that carets stay in place.
    """
    return "".join(" " if c == "\t" else c if c.isprintable() else "?" for c in text)


ROUNDING = 1e-12
"""Magnitude below which a design's number, in a unit near its sizes, is the rounding error of a 0."""

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


def count_text(number: float, noun: str, form: str = "g") -> str:
    """Write a count and its noun, plural unless it is 1: "1 piece", "3 pieces"; form "," writes "1,234"."""
    return f"{number:{form}} {noun}" + "s" * (number != 1)


def number_text(n: int) -> str:
    """Write a number of any size: "12,345" or "1.2e+18"."""
    return f"{n:,}" if n < 10**10 else f"{Decimal(n):.3g}"  # an int may be too large for a float


def mrad_text(angle: float, count: int = 4, unit: str = " mrad") -> str:
    """Write an angle in rad as milliradians with a number of significant digits: "2.65 mrad"."""
    return f"{1e3 * angle:.{count}g}{unit}"


def mrad_list(angles: Iterable[float], count: int = 6) -> str:
    """Write angles in rad as numbers of milliradians: "2.65, 0"; rounding errors of 0 are 0, see `digits`."""
    return ", ".join(digits(1e3 * angle, count=count) for angle in angles)


def pair_text(two: Sequence[float], count: int = 3) -> str:
    """Write two numbers with a number of significant digits; one where they are the same: "5", "5, 4"."""
    x, y = (f"{value + 0.0:.{count}g}" for value in two)
    return x if x == y else f"{x}, {y}"


def percent_text(share: float, count: int = 3, unit: str = " %", *, fixed: bool = False) -> str:
    """Write a share of 1 in percent, with a number of significant (fixed: decimal) digits: "12.5 %"."""
    return f"{100.0 * share:.{count}{'f' if fixed else 'g'}}{unit}"


def nm_text(wavelength: float, count: int = 4, *, fixed: bool = False) -> str:
    """Write metres as nanometres, with a number of significant (fixed: decimal) digits: "532 nm"."""
    return f"{1e9 * wavelength:.{count}{'f' if fixed else 'g'}} nm"


def size_text(n: float | Decimal) -> str:
    """Write a number of bytes of any size: "999 bytes", "1.50 GB"."""
    return _size(Decimal(n), "bytes")


def short_size_text(n: float) -> str:
    """Write a number of bytes with the short unit: "999 B", "1.5 GB"."""
    return _size(float(n), "B")


def _size(n: float | Decimal, byte: str) -> str:
    for unit in (byte, "kB", "MB", "GB", "TB"):
        if n < 1000:
            return f"{n:.0f} {unit}" if unit == byte else f"{n:.3g} {unit}"
        n /= 1000
    return f"{n:.3g} PB"


def size_in(n: float, unit: Literal["MB", "GB"], form: str = ".1f") -> str:
    """Write a number of bytes in one unit: "0.3 GB"."""
    return f"{n / {'MB': 1e6, 'GB': 1e9}[unit]:{form}} {unit}"


def span_text(low: float, high: float) -> str:
    """Range of seconds as text: at most two digits, in s, min or h.

    >>> span_text(12.3, 20.4), span_text(0.31, 0.62), span_text(200.0, 310.0)
    ('12–20 s', '0.31–0.62 s', '3.3–5.2 min')
    """
    if high < 0.1:
        return "under 0.1 s"
    unit, size = next((u, s) for u, s in (("h", 3600.0), ("min", 60.0), ("s", 0.0)) if high >= 2.0 * s)
    first, last = (_two_digits(value / (size or 1.0)) for value in (low, high))
    return f"about {last} {unit}" if first == last else f"{first}–{last} {unit}"


def _two_digits(value: float) -> str:
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"


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
    count: int = DIGITS,
) -> Shown:
    """Write a value and its limit with as many digits as the comparison needs.

    value, limit : text or None
        None is "–"; an infinite limit is "no limit". Angles in rad are shown in mrad.
    relation : "<=", "<", ">=", ">" or a word. How the value is compared with the limit.
    state : "pass", "fail", another, or ""
        Verdict on the value. Where the limit is kept but the state is "fail", the note records it.
    count : int. Significant digits, unless more are needed.
    Returns: The printed numbers fulfil `relation` exactly if value and limit do.
    """
    factor, name = SHOWN_IN.get(unit, (1, unit))
    holds = HOLDS.get(relation)
    if holds is None or not (_finite(value) and _finite(limit)):
        bound_text = NO_LIMIT if _infinite(limit) else _text(limit, factor, count)
        return Shown(_text(value, factor, count), bound_text, name)
    truth = holds(value, limit)
    if 0.0 < abs(value) < NOTHING * abs(limit) and holds(0.0, limit) == truth:  # type: ignore[arg-type]
        return shown(0, limit, relation, unit, state, count)
    tried = ((_text(value, factor, n), _text(limit, factor, n)) for n in range(count, MOST + 1))
    exact = (_exactly(value, factor), _exactly(limit, factor))
    texts = next((both for both in tried if holds(*map(Decimal, both)) == truth), exact)
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
    "<=": operator.le,
    "<": operator.lt,
    ">=": operator.ge,
    ">": operator.gt,
}
"""Relation between a value and its limit → comparison function."""


def plainly(value: float | str | None, unit: str = "", count: int = DIGITS) -> tuple[str, str]:
    """Write a value that has no limit: its text, and the unit it is shown in."""
    factor, name = SHOWN_IN.get(unit, (1, unit))
    return _text(value, factor, count), name


def _text(value: float | str | None, factor: int, count: int) -> str:
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    if not isfinite(value):
        return "not known" if isnan(value) else "none"
    return str(factor * value) if isinstance(value, int) else f"{factor * value:.{count}g}"


MOST_DIGITS: Final = 18

_WHOLE = re.compile(rf"-?[0-9]{{1,{MOST_DIGITS}}}", re.ASCII)


def whole_number(text: str, *, signed: bool = False) -> int | None:
    """Read an integer.

    text : Such as "12", without spaces.
    signed : Whether a minus sign is accepted, as in "-5".
    Returns: None for any other text, for digits other than 0 … 9, and for more than 18 digits.

    Examples
    --------
    >>> whole_number("12"), whole_number("²"), whole_number(5000 * "5")
    (12, None, None)
    """
    return int(text) if _WHOLE.fullmatch(text) and (signed or text[0] != "-") else None


def array_lengths(shape: object) -> tuple[int, ...] | None:
    """Read the lengths of an array from a file's header: integers >= 0 and below 2^63; otherwise None."""
    if not isinstance(shape, tuple) or not all(
        type(length) is int and 0 <= length < 2**63 for length in shape
    ):
        return None
    return shape


def beyond_64_bits(value: Any) -> bool:
    """Whether a value, or one in its lists and tables, is an integer of more than 64 bits."""
    if isinstance(value, dict):
        return any(map(beyond_64_bits, value.values()))
    if isinstance(value, list | tuple):
        return any(map(beyond_64_bits, value))
    return isinstance(value, int) and not -(2**63) <= value < 2**64
