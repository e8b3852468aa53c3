"""Positions of keys and values in a file. Computed only when there is a mistake to report."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from clacad.base.text import whole_number
from clacad.config.mistakes import Mistake

if TYPE_CHECKING:
    from tree_sitter import Node

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

    Parameters
    ----------
    mistakes : iterable of Mistake
        Mistakes found so far, with keys.
    text : str or None
        The file's text; None for a design given as a dictionary.
    path : str
        The file's name.
    overrides : sequence of (key path, text)
        Overrides in the order they were applied.
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
    """Mistake with its position: the last override that set its key,
    else the key or the value in the file.
    """
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
