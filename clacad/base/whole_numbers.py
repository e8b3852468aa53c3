"""Integers in untrusted text, with at most as many digits as always fit into 64 bits."""

from __future__ import annotations

import re
from typing import Any, Final

MOST_DIGITS: Final = 18

_WHOLE = re.compile(rf"-?[0-9]{{1,{MOST_DIGITS}}}", re.ASCII)


def whole_number(text: str, *, signed: bool = False) -> int | None:
    """Read an integer.

    Parameters
    ----------
    text : str
        Such as "12", without spaces.
    signed : bool
        Whether a minus sign is accepted, as in "-5".

    Returns
    -------
    int or None
        None for any other text, for digits other than 0 … 9, and for more than 18 digits.

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
