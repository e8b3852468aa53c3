"""Whole numbers in texts from outside, with as many digits as a 64-bit number always has room for."""

from __future__ import annotations

import re
from typing import Any, Final

MOST_DIGITS: Final = 18

_WHOLE = re.compile(rf"-?[0-9]{{1,{MOST_DIGITS}}}", re.ASCII)


def whole_number(text: str, *, signed: bool = False) -> int | None:
    """Read a whole number.

    Parameters
    ----------
    text : str
        Such as "12", without spaces.
    signed : bool
        Whether "-5" is read, too.

    Returns
    -------
    int or None
        None where the text is anything else: digits that are not 0 … 9, or more than 18 of them.

    Examples
    --------
    >>> whole_number("12"), whole_number("²"), whole_number(5000 * "5")
    (12, None, None)
    """
    return int(text) if _WHOLE.fullmatch(text) and (signed or text[0] != "-") else None


def array_lengths(shape: object) -> tuple[int, ...] | None:
    """Read the lengths of an array as a file states them: whole numbers >= 0; None where they are anything else."""
    if not isinstance(shape, tuple) or not all(
        type(length) is int and 0 <= length < 2**63 for length in shape
    ):
        return None
    return shape


def beyond_64_bits(value: Any) -> bool:
    """Tell whether a value, or one in its lists and tables, is a whole number of more than 64 bits."""
    if isinstance(value, dict):
        return any(map(beyond_64_bits, value.values()))
    if isinstance(value, list | tuple):
        return any(map(beyond_64_bits, value))
    return isinstance(value, int) and not -(2**63) <= value < 2**64
