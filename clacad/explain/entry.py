"""Explanation of one code, check or word."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Entry:
    """An explanation.

    Parameters
    ----------
    code : str
        Stable code; "" for a word.
    name : str
        Name of the check, or the word.
    title : str
        One line.
    means, why, formula, do : str
        What it means, why it matters, what is computed ("" where nothing is), what to do.
    """

    code: str
    name: str
    title: str
    means: str
    why: str
    formula: str
    do: str


Text = tuple[str, str, str, str]
"""means, why, formula, do"""
