"""Words of the command line → a request and a console.

Options may precede and follow arguments. An option takes the next word as its value, even one that begins
with a dash.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

from clacad.cli.command import CommandParameter, flag, parameters

PROGRAM = "clacad"

VARIABLE = "_CLACAD_COMPLETE"
"""Environment variable by which a shell requests completions."""


@dataclass(frozen=True)
class Common:
    """Options of every command."""

    json: bool = flag("--json", "Result on stdout as JSON, everything else on stderr.")
    quiet: bool = flag("-q, --quiet", "Errors only.")
    all: bool = flag("--all", "Print every number and every check that passes, not only 24 lines.")
    verbose: bool = flag(
        "-v, --verbose", "Log every step on stderr, one JSON object a line, with tracebacks."
    )
    help: bool = flag("-h, --help", "Show this message and exit.")


@dataclass(frozen=True)
class Start:
    """Options of the program itself, before the command."""

    version: bool = flag("--version", "Print the version.")
    install_completion: bool = flag("--install-completion", "Install completion for the current shell.")
    show_completion: bool = flag(
        "--show-completion",
        "Show completion for the current shell, to copy it or customize the installation.",
    )


class BadUsage(ValueError):
    """Words that are no call of a command; exit status 2."""

    exit_status = 2

    def __init__(self, message: str, word: str) -> None:
        super().__init__(f"{message}\n  try: {' '.join(filter(None, (PROGRAM, word)))} --help")


@dataclass
class Given:
    """What was given: texts of options by field, other words in order, words left unread."""

    word: str
    options: dict[str, list[Any]]
    words: list[str]
    rest: list[str]

    def common(self) -> Common:
        """The options of every command that were given."""
        return Common(**{one.name: bool(self.options.get(one.name, [False])[-1]) for one in fields(Common)})

    def request(self, request: type) -> Any:
        """The request.

        Raises BadUsage: A required one is missing, a value has the wrong type or range, or a word is left
            over.
        Raises BadOption.
        """
        words, values = list(self.words), {}
        for one in parameters(request):
            texts = self.options.get(one.name, []) if one.flags else _share(one, words)
            if texts:
                values[one.name] = self._value(one, texts)
            elif one.default is MISSING:
                raise BadUsage(f"Missing {'option' if one.flags else 'argument'} {one.shown}.", self.word)
        if words:
            raise BadUsage(f"Got unexpected extra argument(s) ({' '.join(words)})", self.word)
        return request(**values)

    def _value(self, one: CommandParameter, texts: list[Any]) -> Any:
        if one.several:
            return tuple(self._single(one, text) for text in texts)
        return self._single(one, texts[-1])

    def _single(self, one: CommandParameter, text: Any) -> Any:
        if one.read is not None:
            return one.read(next((f for f in one.flags if f.startswith("--")), one.metavar), text)
        try:
            return _typed(one, text)
        except ValueError as error:
            raise BadUsage(f"Invalid value for {one.shown}: {error}", self.word) from None


def _share(one: CommandParameter, words: list[str]) -> list[str]:
    """Take the words of an argument off the list."""
    count = len(words) if one.several else 1
    taken, words[:] = words[:count], words[count:]
    return taken


def _typed(one: CommandParameter, text: Any) -> Any:
    """A text as the type of a parameter."""
    if one.kind in ("bool", "str"):
        return text
    if one.kind == "Path":
        if os.path.exists(text) and not os.access(text, os.R_OK):
            raise ValueError(f"path {text!r} is not readable.")
        return Path(text)
    try:
        number = int(text) if one.kind == "int" else float(text)
    except ValueError:
        named = ("a valid integer", "an integer") if one.kind == "int" else ("a valid number", "a number")
        raise ValueError("Input should be {}, unable to parse string as {}".format(*named)) from None
    if one.least is not None and number < one.least:
        raise ValueError(f"Input should be greater than or equal to {one.least}")
    if one.most is not None and number > one.most:
        raise ValueError(f"Input should be less than or equal to {one.most}")
    return number


def scan(
    known: Sequence[CommandParameter], given: Sequence[str], word: str = "", *, up_to_word: bool = False
) -> Given:
    """Sort the words of the command line into options and others.

    word : The command, for messages.
    up_to_word : Whether to end at the first word that is no option.
    Raises BadUsage: An unknown option, one without its value, or a switch with a value.
    """
    flags = {flag: (one, True) for one in known for flag in one.flags}
    flags |= {flag: (one, False) for one in known for flag in one.opposites}
    found, left = Given(word, {}, [], []), list(given)
    while left:
        text = left.pop(0)
        if text == "--" or (not _is_option(text) and up_to_word):
            found.rest = left if text == "--" else [text, *left]
            break
        if not _is_option(text):
            found.words.append(text)
        elif text.startswith("--"):
            flag, equals, value = text.partition("=")
            _take(found, flags, flag, value if equals else None, left)
        else:
            _take_letters(found, flags, text[1:], left)
    if not up_to_word:
        found.words, found.rest = found.words + found.rest, []
    return found


def _is_option(text: str) -> bool:
    return text.startswith("-") and text != "-"


Flags = dict[str, tuple[CommandParameter, bool]]


def _take(found: Given, flags: Flags, flag: str, value: str | None, left: list[str]) -> None:
    """Note one option with its value, which may be the next word."""
    if flag not in flags:
        raise BadUsage(f"No such option: {flag}{_possible(flag, flags)}", found.word)
    one, on = flags[flag]
    if one.kind == "bool":
        if value is not None:
            raise BadUsage(f"Option '{flag}' does not take a value.", found.word)
        found.options.setdefault(one.name, []).append(on)
        return
    if value is None:
        if not left:
            raise BadUsage(f"Option '{flag}' requires an argument.", found.word)
        value = left.pop(0)
    found.options.setdefault(one.name, []).append(value)


def _take_letters(found: Given, flags: Flags, letters: str, left: list[str]) -> None:
    """Note options of one letter that are written together, the last one with its value: -qo DIR, -oDIR."""
    for k, letter in enumerate(letters):
        flag, rest = f"-{letter}", letters[k + 1 :]
        takes_value = flag in flags and flags[flag][0].kind != "bool"
        _take(found, flags, flag, rest if takes_value and rest else None, left)
        if takes_value:
            return


def _possible(flag: str, flags: Flags) -> str:
    from difflib import get_close_matches

    near = sorted(get_close_matches(flag, [one for one in flags if one.startswith("--")]))
    return f" (Possible options: {', '.join(near)})" if near else ""
