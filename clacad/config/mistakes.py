"""Mistakes in a file: their codes, the position of the key of each, and the error that lists them.

A `Mistake` is one finding with its position, formatted like a compiler's message. Codes are stable words for
programs: `CODES` lists those of mistakes of a design file. Positions of keys and values are computed only
when there is a mistake to report.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

from clacad.base.text import printable, whole_number

if TYPE_CHECKING:
    from tree_sitter import Node


CODES: dict[str, str] = {
    "CL100": "the file cannot be read",
    "CL101": "the text is not TOML (or JSON)",
    "CL102": "unknown key",
    "CL103": "missing key",
    "CL104": "wrong kind of value",
    "CL105": "wrong or unknown unit",
    "CL106": "number out of range",
    "CL107": "not one of the allowed words",
    "CL108": "wrong number of values in a list",
    "CL109": "unknown file format version",
    "CL110": "eta that no pair of lenses has",
    "CL111": "eta = 1 with an offset",
    "CL112": "keys that exclude each other",
    "CL113": "key that needs another key",
    "CL114": "key that does not belong to this form",
    "CL115": "pitch below the wavelength",
    "CL116": "lattice and pitch disagree",
    "CL117": "seam, web or outline that leaves no lens",
    "CL118": "override that cannot be applied",
    "CL119": "unknown material, or its index table does not reach the wavelength",
    "CL120": "a pair that cannot be built",
    "CL121": "something that an aimed sheet cannot have",
    "CL122": "a viewer too near to aim at",
    "CL123": "a lens of an aimed sheet used too far from its vertex",
    "CL124": "a table of cells that cannot be read",
    "CL125": "a non-uniform sheet with a feature that cannot be combined with it",
    "CL126": "a field lens for a pair without a real common focus",
    "CL127": "a field lens in a form or tilt that it is not made for",
    "CL128": "a field lens too steep for its cell",
    "CL129": "field faces without room between them",
    "CL141": "outline, corner, hole or pin that makes no plate",
}
"""Meaning of each stable code of a design mistake."""

WIDTH = 110
"""Greatest length of a displayed piece of a source line, in characters."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """One fault and its position.

    Parameters
    ----------
    code : str
        Stable code, a key of `CODES`.
    message : str
        The fault, in one line.
    key : str
        Dotted path of the key, "" for the file as a whole.
    path : str
        File name as given by the user, "--set" for an override, "" for a dictionary.
    line, column : int or None
        Position in the file, both from 1, in characters.
    width : int
        Number of characters the caret line marks.
    found, allowed, hint : str
        Value found, values allowed, the nearest way out (for an unknown key: the key probably
        meant); "" where there is none.
    source_line : str
        The line of the file (or the override) with the mistake.
    """

    code: str
    message: str
    key: str = ""
    path: str = ""
    line: int | None = None
    column: int | None = None
    width: int = 1
    found: str = ""
    allowed: str = ""
    hint: str = ""
    source_line: str = ""

    def __str__(self) -> str:
        """Return the finding as a compiler would print it, with a caret line where the position is known."""
        lines = [f"{self._where()}error {self.code}: {self.message}", *self._excerpt()]
        for word, text in (("found", self.found), ("allowed", self.allowed), ("hint", self.hint)):
            if text and not (word != "allowed" and text in self.message):  # do not repeat the message
                lines.append(f"  {word}: {text}")
        return "\n".join(map(printable, lines))

    def _where(self) -> str:
        if self.path == "--set":
            return f"--set {self.source_line}: "
        place = [self.path] if self.path else []
        if self.path and self.line is not None:
            place += [str(number) for number in (self.line, self.column) if number is not None]
        return ":".join(place) + ": " if place else ""

    def _excerpt(self) -> list[str]:
        if not self.source_line or self.column is None or (self.line is None and self.path != "--set"):
            return []
        start = max(0, self.column - 1 - WIDTH // 2) if len(self.source_line) > WIDTH else 0
        shown = self.source_line[start : start + WIDTH]
        caret = " " * (self.column - 1 - start) + "^" * max(1, min(self.width, WIDTH // 2))
        number = "" if self.line is None else str(self.line)
        return [f"  {number} | {shown}".rstrip(), f"  {' ' * len(number)} | {caret}"]


def in_order(mistakes: Iterable[Mistake]) -> list[Mistake]:
    """Return the mistakes sorted by position, then key; those without a position last; no duplicates."""
    unique = dict.fromkeys(mistakes)
    return sorted(unique, key=lambda m: (m.path == "--set", m.line or 10**9, m.column or 0, m.key, m.code))


KeyPath = tuple[str | int, ...]


@dataclass(frozen=True, slots=True)
class Place:
    """A stretch of one line: line and column from 1, in characters."""

    line: int
    column: int
    width: int


@dataclass(frozen=True, slots=True)
class KeyPlaces:
    """Positions of the keys and of the values of a file, by key path; JSON: also of duplicate keys."""

    keys: dict[KeyPath, Place]
    values: dict[KeyPath, Place]
    twins: list[Place] = field(default_factory=list)

    def of_value(self, path: KeyPath) -> Place | None:
        """Return the position of a value, or of the nearest element that encloses it."""
        return next((p for n in range(len(path), 0, -1) if (p := self._either(path[:n])) is not None), None)

    def _either(self, path: KeyPath) -> Place | None:
        return self.values.get(path) or self.keys.get(path)

    def of_key(self, path: KeyPath) -> Place | None:
        """Return the position of a key's name, or of the nearest element that encloses it."""
        return self.keys.get(path) or self.of_value(path)


def split_key(key: str) -> KeyPath:
    """Split a dotted key; integers become list indices."""
    return (
        tuple(part if (number := whole_number(part)) is None else number for part in key.split("."))
        if key
        else ()
    )


def located(
    mistakes: Iterable[Mistake], text: str | None, path: str, overrides: Sequence[tuple[KeyPath, str]]
) -> list[Mistake]:
    """Add its position to each mistake: the override that set its key, else the file.

    mistakes : Mistakes found so far, with keys.
    text : The file's text; None for a design given as a dictionary.
    path : The file's name.
    overrides : sequence of (key path, text). Overrides in the order they were applied.
    """
    listed = list(mistakes)
    places = find(text, path) if text is not None and listed else None
    lines = [] if text is None else re.split("\r\n|\n", text)
    return [_one(mistake, places, lines, path, overrides) for mistake in listed]


def _one(
    mistake: Mistake,
    places: KeyPlaces | None,
    lines: list[str],
    path: str,
    overrides: Sequence[tuple[KeyPath, str]],
) -> Mistake:
    """Mistake with its position: the last override that set its key, else its key or value in the file."""
    if mistake.line is not None or mistake.path == "--set":
        return mistake
    key = split_key(mistake.key)
    for target, text in reversed(overrides):
        if key[: len(target)] == target or (mistake.code == "CL102" and target[: len(key)] == key):
            column = text.find("=") + 2 if mistake.code != "CL102" else 1
            width = max(1, len(text) - column + 1) if mistake.code != "CL102" else max(1, text.find("="))
            return replace(mistake, path="--set", source_line=text, line=None, column=column, width=width)
    if places is None:
        return replace(mistake, path=path)
    place = (places.of_key(key) if mistake.code in ("CL102", "CL103") else places.of_value(key)) or Place(
        1, 1, 1
    )
    line = lines[place.line - 1] if place.line <= len(lines) else ""
    return replace(
        mistake, path=path, line=place.line, column=place.column, width=place.width, source_line=line
    )


def find(text: str, path: str) -> KeyPlaces:
    """Return the positions of all keys and values in a valid TOML text (or JSON, by the file's name)."""
    return _json_places(text) if path.lower().endswith(".json") else _toml_places(text)


# --- TOML -------------------------------------------------------------------------------------------------
def syntax_tree(raw: bytes) -> Node:
    """Root of the syntax tree of a TOML text."""
    import tree_sitter_toml
    from tree_sitter import Language, Parser

    return Parser(Language(tree_sitter_toml.language())).parse(raw).root_node


def _toml_places(text: str) -> KeyPlaces:
    """Positions in a valid TOML text, by its syntax tree."""
    found = KeyPlaces({}, {})
    lines = text.encode().split(b"\n")
    arrays: dict[KeyPath, int] = {}
    for node in syntax_tree(text.encode()).named_children:
        if node.type == "pair":
            _pair(node, (), found, lines)
        elif node.type in ("table", "table_array_element"):
            head = [child for child in node.named_children if child.type in KEY_NODES]
            if not head:
                continue
            path = _indexed(key_names(head[0]), arrays)
            if node.type == "table_array_element":
                arrays[path] = arrays.get(path, -1) + 1
                found.keys.setdefault(path, _place(head[0], lines))
                path = (*path, arrays[path])
            for n in range(1, len(path) + 1):
                found.keys.setdefault(path[:n], _place(head[0], lines))
            for child in node.named_children:
                if child.type == "pair":
                    _pair(child, path, found, lines)
    return found


KEY_NODES = ("bare_key", "quoted_key", "dotted_key")
"""Types of syntax nodes that name a key."""


def _indexed(names: list[str], arrays: dict[KeyPath, int]) -> KeyPath:
    path: KeyPath = ()
    for i, name in enumerate(names):
        path = (*path, name)
        if path in arrays and i < len(names) - 1:
            path = (*path, arrays[path])
    return path


def key_names(node: Node) -> list[str]:
    """Parts of a key's name."""
    if node.type == "dotted_key":
        return [name for child in node.named_children for name in key_names(child)]
    text = (node.text or b"").decode()
    if node.type == "quoted_key":
        import tomllib

        return list(tomllib.loads(f"{text} = 0"))
    return [text]


def _place(node: Node, lines: list[bytes]) -> Place:
    row, start = node.start_point
    end = node.end_point[1] if node.end_point[0] == row else len(lines[row])
    column = len(lines[row][:start].decode(errors="replace"))
    return Place(row + 1, column + 1, max(1, len(lines[row][start:end].decode(errors="replace").rstrip())))


def _pair(node: Node, prefix: KeyPath, found: KeyPlaces, lines: list[bytes]) -> None:
    children = node.named_children
    if len(children) < 2 or children[0].type not in KEY_NODES:
        return
    path = prefix
    for name in key_names(children[0]):
        path = (*path, name)
        found.keys.setdefault(path, _place(children[0], lines))
    _value(children[1], path, found, lines)


def _value(node: Node, path: KeyPath, found: KeyPlaces, lines: list[bytes]) -> None:
    found.values[path] = _place(node, lines)
    if node.type == "array":
        items = [child for child in node.named_children if child.type != "comment"]
        for i, child in enumerate(items):
            _value(child, (*path, i), found, lines)
    elif node.type == "inline_table":
        for child in node.named_children:
            if child.type == "pair":
                _pair(child, path, found, lines)


# --- JSON -------------------------------------------------------------------------------------------------
_SPACE = re.compile(r"[ \t\r\n]*")


def _json_places(text: str) -> KeyPlaces:
    found = KeyPlaces({}, {})
    starts = [0] + [match.end() for match in re.finditer("\n", text)]
    _json_value(text, _skip(text, 0), (), found, starts)
    return found


def _skip(text: str, at: int) -> int:
    match = _SPACE.match(text, at)
    return at if match is None else match.end()


def _spot(starts: list[int], begin: int, end: int, text: str) -> Place:
    from bisect import bisect_right

    row = bisect_right(starts, begin) - 1
    stop = text.find("\n", begin, end)
    return Place(row + 1, begin - starts[row] + 1, max(1, (end if stop < 0 else stop) - begin))


def _json_value(text: str, at: int, path: KeyPath, found: KeyPlaces, starts: list[int]) -> int:
    """Walk one value of a text that json.loads accepted; return the index of its end."""
    decoder = json.JSONDecoder()
    begin = at
    if text[at] == "{" or text[at] == "[":
        closing, index = "}" if text[at] == "{" else "]", 0
        at = _skip(text, at + 1)
        while text[at] != closing:
            step: str | int = index
            if closing == "}":
                name, end = decoder.raw_decode(text, at)
                found.twins.extend([_spot(starts, at, end, text)] if (*path, name) in found.keys else [])
                found.keys.setdefault((*path, name), _spot(starts, at, end, text))
                step, at = name, _skip(text, _skip(text, end) + 1)
            at = _skip(text, _json_value(text, at, (*path, step), found, starts))
            at = _skip(text, at + 1) if text[at] == "," else at
            index += 1
        at += 1
    else:
        at = decoder.raw_decode(text, at)[1]
    if path:
        found.values[path] = _spot(starts, begin, at, text)
    return at


def syntax_place(error: Any, text: str) -> Place:
    """Return the position of a syntax error of the TOML or JSON parser."""
    if isinstance(error, json.JSONDecodeError):
        return Place(error.lineno, error.colno, 1)
    lines = re.split("\r\n|\n", text)
    match = re.search(r"\(at line ([0-9]+), column ([0-9]+)\)", str(error))
    if match is not None:
        return Place(min(int(match[1]), len(lines)), int(match[2]), 1)
    return Place(len(lines), len(lines[-1]) + 1, 1)


class FromText(Protocol):
    """An object read from a text, such as a `Design`: the text or None, and the name of its file or ""."""

    @property
    def source(self) -> str | None:
        """Text that the object was read from, None where there is none."""

    @property
    def path(self) -> str:
        """Name of the file as given by the user, "" without a file."""


class DesignError(ValueError):
    """A design is refused; holds every mistake that was found.

    Parameters
    ----------
    mistakes : iterable of Mistake
        At least one.
    """

    exit_status = 2

    def __init__(self, mistakes: Iterable[Mistake]) -> None:
        self.mistakes: tuple[Mistake, ...] = tuple(mistakes)
        super().__init__(self.mistakes)

    def __str__(self) -> str:
        """Return all mistakes, one block each, in the order of their positions."""
        blocks = [str(mistake) for mistake in self.mistakes]
        if len(blocks) > 1:
            blocks.append(f"{len(blocks)} mistakes")
        return "\n".join(blocks)

    @classmethod
    def at(
        cls,
        design: FromText,
        key: str,
        message: str,
        *,
        code: str = "CL120",
        found: str = "",
        allowed: str = "",
        hint: str = "",
    ) -> DesignError:
        """Refuse a design for a reason found after reading, at the position of one of its keys.

        Parameters
        ----------
        design : Design
            The refused design; its file text gives line and column.
        key : str
            Dotted key at fault, such as "pair.thickness".
        message : str
            The fault, with the computed numbers.
        code, found, allowed, hint : str
            As for `Mistake`.

        Returns
        -------
        DesignError
            Error with one mistake, for the caller to raise.
        """
        mistake = Mistake(code, message, key=key, found=found, allowed=allowed, hint=hint)
        return cls(located([mistake], design.source, design.path, ()))


class DesignTooLarge(DesignError):
    """A design or scene file is refused because it exceeds the size limit, regardless of its content."""

    exit_status = 3


def design_error(code: str, message: str, key: str = "", path: str = "", **more: Any) -> DesignError:
    """Error with one mistake, for the caller to raise; arguments as of `Mistake`."""
    return DesignError([Mistake(code, message, key, path, **more)])


def too_large(code: str, message: str, key: str = "", path: str = "", **more: Any) -> DesignTooLarge:
    """Error of a file beyond a limit of size, as `design_error`."""
    return DesignTooLarge([Mistake(code, message, key, path, **more)])
