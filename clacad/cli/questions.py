"""Questions of `clacad new` without arguments at a terminal, each with its default."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from clacad.advice.wish import KEYS, UNIT, read_wish, read_word, written
from clacad.config.mistakes import DesignError
from clacad.design import template

QUESTIONS = (
    ("eta", "eta, one number or [x, y] (-1 turns light over, 0 < eta < 1 shrinks)", "-1"),
    ("delta", "offset delta [x, y]", "[0, 0]"),
    ("euler", "phi, theta, psi of the lens axes in degrees [phi, theta, psi]", "[0, 0, 0]"),
    ("size", "size: a width, [width, height], or 'circle 60 mm'", "50 mm"),
    ("viewing", "looked at from", "1 m"),
    ("process", f"process: {KEYS['process'].kind.allowed(UNIT)}".replace('"', ""), "diamond-turning"),
    ("material", "material", "PMMA"),
    ("form", f"form: {KEYS['form'].kind.allowed(UNIT)}".replace('"', ""), "any"),
    ("kind", f"cells: {KEYS['kind'].kind.allowed(UNIT)}".replace('"', ""), "square"),
)
"""Word, question, default as typed."""


def ask() -> tuple[str, dict[str, Any]]:
    """Name and words of a wish, from answers at a terminal; a question is repeated after a wrong answer."""
    name = _answer("name of the design", "window", _name)
    words: dict[str, Any] = {}
    for word, question, default in QUESTIONS:
        words |= _answer(question, default, partial(_word, word, words))
    return name, words


def _answer(question: str, default: str, read: Callable[[str], Any]) -> Any:
    while True:
        try:
            typed = input(f"{question} [{default}]: ").strip() or default
        except EOFError:  # Ctrl-D: no more answers
            raise KeyboardInterrupt from None
        try:
            return read(typed)
        except DesignError as problem:
            print(problem)  # noqa: T201


def _name(text: str) -> str:
    template(text.removesuffix(".toml").rpartition("/")[2])
    return text


def _word(word: str, before: dict[str, Any], text: str) -> dict[str, Any]:
    """The answer as words of a wish, checked alone and with the earlier ones."""
    if word == "size":
        word, text = (
            ("circle", text.removeprefix("circle").strip()) if text.startswith("circle") else ("width", text)
        )
    found = {word: written(text)}
    read_word(word, found[word])
    if "eta" in before or word == "eta":
        read_wish(
            {"width": 1.0, **{k: v for k, v in (before | found).items() if k not in ("width", "circle")}}
        )
    return found
