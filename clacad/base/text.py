"""Words and values as text: suggestions for misspelt words, and any value as plain JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import isfinite
from typing import Any

DEEPEST = 64
"""Greatest nesting depth of files and of converted values: it ends self-referencing values."""


def near(word: str, words: Iterable[str], cutoff: float = 0.6, most: int = 1) -> list[str]:
    """Return the words most similar to a given word, the most similar first.

    Parameters
    ----------
    word : str
        Word as written.
    words : iterable of str
        Valid words.
    cutoff : float
        Least similarity, 0 … 1.
    most : int
        Greatest number of words returned.
    """
    from difflib import get_close_matches

    return get_close_matches(word, list(words), n=most, cutoff=cutoff)


def count_text(number: float, noun: str) -> str:
    """Write a count and its noun, plural unless it is 1: "1 piece", "3 pieces"."""
    return f"{number:g} {noun}" + "s" * (number != 1)


def did_you_mean(words: Sequence[str], quote: str = "", before: str = "") -> str:
    """Return a question whether one of some words was meant; "" for no words.

    Parameters
    ----------
    words : sequence of str
    quote : str
        Quotation mark around each word.
    before : str
        Text before the question, such as "; ".
    """
    return f"{before}did you mean {' or '.join(f'{quote}{word}{quote}' for word in words)}?" if words else ""


def null(number: float) -> None:
    """Return None in place of a number that is not finite: JSON has no other representation."""
    return None


def plain(value: Any, not_finite: Callable[[float], Any] = null, depth: int = 0) -> Any:
    """Return a value as JSON types: no numpy, no tuples, text keys only; objects of other types stay.

    Parameters
    ----------
    value : any
        Nested mappings, lists, tuples, arrays and scalars.
    not_finite : callable
        Returns the replacement of NaN and infinities; default null, `float` leaves them.
    depth : int
        Nesting depth of the value; below 64 levels it stays as it is.
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
