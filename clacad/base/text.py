"""Words and values as text: which word was probably meant, and any value as plain JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import isfinite
from typing import Any

DEEPEST = 64
"""Levels of nesting that files may have and values are followed to: what holds itself ends here."""


def near(word: str, words: Iterable[str], cutoff: float = 0.6, most: int = 1) -> list[str]:
    """Give the words that look like another one, the likest first.

    Parameters
    ----------
    word : str
        What was written.
    words : iterable of str
        What could have been meant.
    cutoff : float
        Least likeness, 0 … 1.
    most : int
        Number of words at most.
    """
    from difflib import get_close_matches

    return get_close_matches(word, list(words), n=most, cutoff=cutoff)


def count_text(number: float, noun: str) -> str:
    """Write a count and its noun, plural unless it is 1: "1 piece", "3 pieces"."""
    return f"{number:g} {noun}" + "s" * (number != 1)


def did_you_mean(words: Sequence[str], quote: str = "", before: str = "") -> str:
    """Ask whether one of some words was meant; "" if there is none.

    Parameters
    ----------
    words : sequence of str
    quote : str
        Put round each word.
    before : str
        Put before the question, such as "; ".
    """
    return f"{before}did you mean {' or '.join(f'{quote}{word}{quote}' for word in words)}?" if words else ""


def null(number: float) -> None:
    """Stand in for a number that is not finite: JSON has no other word for it."""
    return None


def plain(value: Any, not_finite: Callable[[float], Any] = null, depth: int = 0) -> Any:
    """Give a value as JSON can hold it: no numpy, no tuples, no keys but text; what is of no such type stays.

    Parameters
    ----------
    value : any
        Nested mappings, lists, tuples, arrays and scalars.
    not_finite : callable
        Gives what stands for NaN and infinities; default null, `float` leaves them.
    depth : int
        How deep the value lies; beyond 64 levels it stays as it is.
    """
    if depth > DEEPEST:
        return value
    if isinstance(value, Mapping):
        return {str(key): plain(item, not_finite, depth + 1) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item, not_finite, depth + 1) for item in value]
    if hasattr(value, "tolist"):  # numpy's scalars and arrays
        return plain(value.tolist(), not_finite, depth + 1)
    if isinstance(value, float) and not isfinite(value):
        return not_finite(value)
    return value


def table(rows: Iterable[Sequence[str]], indent: str = "  ") -> str:
    """Align the columns of some rows of text; the last column is not padded."""
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
    """Return a text of several lines without what could move the cursor; see `printable`."""
    return "\n".join(map(printable, text.rstrip("\n").split("\n")))


def printable(text: str) -> str:
    """Return the text with every character that could move the cursor replaced by a space or a '?'.

    A stranger's file must not steer the terminal. The length is kept, so that carets stay in place.
    """
    return "".join(" " if c == "\t" else c if c.isprintable() else "?" for c in text)
