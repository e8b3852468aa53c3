"""Changed keys: overrides from outside a file (--set "law.eta=[-1.4,-1]"), and the text of a changed file.

In a text, comments, order and everything else stay as they are.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from clacad.base.text import plain
from clacad.config.mistakes import KEY_NODES, DesignError, KeyPath, Mistake, key_names, split_key, syntax_tree
from clacad.config.toml_text import toml_value
from clacad.config.value_kinds import kind_of

if TYPE_CHECKING:
    from tree_sitter import Node


def parse(text: str) -> tuple[str, Any] | Mistake:
    """Split "key.path=value"; the value is read as TOML, or as plain text where it is not TOML.

    Returns (key, value) or Mistake.
    """
    key, equals, value = text.partition("=")
    key, value = key.strip(), value.strip()
    if not equals or not key or not value or "\n" in text or "\r" in text:
        return Mistake(
            "CL118",
            "an override is written key.path=value",
            path="--set",
            source_line=text,
            allowed='such as "law.eta=[-1.4,-1]" or pair.form=slab',
        )
    try:
        return key, toml_value(value)
    except ValueError:
        if value[0] in "[{\"'" or not value.isprintable():
            return Mistake(
                "CL118",
                f"the value of {key} is not TOML",
                path="--set",
                source_line=text,
                column=text.find("=") + 2,
                width=len(value),
                allowed='a number, "text", [list], true or false',
            )
        return key, value


Put = Callable[[Any, str, Any], Any]
"""Data with one dotted key replaced: data, key, value."""


def apply(
    data: Mapping[str, Any], texts: Sequence[str], put_key: Put
) -> tuple[dict[str, Any], list[tuple[KeyPath, str]], list[Mistake]]:
    """Apply overrides to the data of a file.

    texts : "key.path=value" each, applied in order.
    put_key : As `put_dotted`.

    Returns
    -------
    data : dict
        A new dictionary; the given one is not changed.
    places : list of (key path, override text)
        For naming the override in later messages.
    mistakes : list of Mistake
        Overrides that cannot be applied.
    """
    made, places, mistakes = dict(data), [], []
    for text in texts:
        parsed = parse(text)
        if isinstance(parsed, Mistake):
            mistakes.append(parsed)
            continue
        key, value = parsed
        try:
            made = put_key(made, key, value)
        except LookupError as problem:
            complaint = str(problem.args[0])
            mistakes.append(
                Mistake("CL118", complaint, key=key, path="--set", source_line=text, column=1, width=len(key))
            )
        places.append((split_key(key), text))
    return made, places, mistakes


def with_changes(data: Any, changes: Mapping[str, Any], put_key: Put, path: str) -> Any:
    """Data with dotted keys changed by a program; `path` is the file's name in messages.

    Raises DesignError: A key leads nowhere.
    """
    mistakes = []
    for key, value in changes.items():
        try:
            data = put_key(data, key, plain(value, float))
        except LookupError as problem:
            mistakes.append(Mistake("CL118", str(problem.args[0]), key=key, path=path))
    if mistakes:
        raise DesignError(mistakes)
    return data


def changed_keys(changes: Mapping[str, Any] | str, value: Any) -> Mapping[str, Any]:
    """Changes of keys as a mapping, from a mapping or from one dotted key and its value.

    Raises TypeError: The arguments are neither.
    """
    if isinstance(changes, str):
        return {changes: value}
    if not isinstance(changes, Mapping) or value is not None:
        raise TypeError('replace takes "pair.separation", 12 or {"pair.separation": 12, …}')
    return changes


def put_dotted(data: Any, key: str, value: Any) -> Any:
    """Return the data with the value of a dotted key replaced, see `put`."""
    return put(data, split_key(key), value)


def put(data: Any, path: KeyPath, value: Any, done: KeyPath = ()) -> Any:
    """Return the data with one value replaced; missing tables are created, lists are never extended.

    Raises LookupError: The path leads through a value without such a part; the message is one sentence.
    """
    if not path:
        return value
    step, rest = path[0], path[1:]
    name = ".".join(map(str, done))
    if isinstance(data, Mapping):
        step = str(step)
        if step not in data and not rest:
            return {**data, step: value}
        return {**data, step: put(data.get(step, {}), rest, value, (*done, step))}
    if isinstance(data, list | tuple):
        if not isinstance(step, int) or step >= len(data):
            raise LookupError(f"{name} is a list of {len(data)}: no element {step}")
        return [put(item, rest, value, (*done, step)) if i == step else item for i, item in enumerate(data)]
    raise LookupError(f"{name} is {kind_of(data)}: it has no part {step}")


# --- text -------------------------------------------------------------------------------------------------


def value_text(value: Any) -> str:
    """Return a value in TOML syntax; a table in one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(value_text, value)) + "]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {value_text(item)}" for key, item in value.items()) + "}"
    return repr(value)


def to_toml(data: Mapping[str, Any]) -> str:
    """Write nested dictionaries (one level of tables) as TOML."""
    lines = [f"{key} = {value_text(value)}" for key, value in data.items() if not isinstance(value, Mapping)]
    for section, values in data.items():
        if isinstance(values, Mapping):
            lines += ["", f"[{section}]", *(f"{key} = {value_text(value)}" for key, value in values.items())]
    return "\n".join(lines) + "\n"


def with_values(text: str, changes: Mapping[str, Any], *, is_json: bool = False) -> str:
    """Change values in a valid text, and add missing ones.

    text : TOML, or JSON.
    changes : Value by dotted key; applied in order.
    is_json : Whether the text is JSON, which is written from scratch in the same order, with its indent.
    Raises LookupError: A key leads through a value, past the end of a list, or to a table that has lines of
        its own.
    """
    if is_json:
        data = json.loads(text)
        for key, value in changes.items():
            data = put(data, split_key(key), value)
        indent = re.search(r"\n( +|\t)", text)
        return json.dumps(data, indent=indent[1] if indent else None, ensure_ascii=False) + "\n"
    for key, value in changes.items():
        text = _with_value(text, split_key(key), value)
    return text


def _with_value(text: str, path: KeyPath, value: Any) -> str:
    raw = text.encode()
    places = _Places(raw)
    node = places.values.get(path)
    if node is not None:
        return _replaced(raw, node, value_text(value))
    if any(head[: len(path)] == path for head in (*places.heads, *places.dotted)):
        raise LookupError(f"{'.'.join(map(str, path))} is a table with lines of its own")
    table, name = path[:-1], str(path[-1])
    if table in places.values:  # an inline table, or a value without such a part
        return _replaced(
            raw, places.values[table], value_text(put(_read(places.values[table]), (path[-1],), value))
        )
    line = f"{_bare(name)} = {value_text(value)}\n".encode()
    if table in places.ends:
        return _inserted(raw, places.ends[table], line)
    if table in places.dotted:  # the table exists as dotted keys only
        prefix, end = places.dotted[table]
        return _inserted(raw, end, prefix + line)
    if len(table) > 1:
        return _with_value(text, table, {name: value})
    head = f"\n[{_bare(str(table[0]))}]\n".encode() if table else b""
    return _inserted(raw, len(raw), head + line)


def _bare(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else value_text(name)


def _read(node: Node) -> Any:
    import tomllib

    return tomllib.loads(f"value = {(node.text or b'').decode()}")["value"]


def _replaced(raw: bytes, node: Node, new: str) -> str:
    """Text with a value replaced; a comment behind it keeps its column where there is room."""
    head, tail = raw[: node.start_byte].decode(), raw[node.end_byte :].decode()
    gap = re.match(r"( +)#", tail)
    if gap is not None and "\n" not in (node.text or b"").decode():
        room = len(gap[1]) + len((node.text or b"").decode()) - len(new)
        tail = " " * max(2, room) + tail[len(gap[1]) :]
    return head + new + tail


def _inserted(raw: bytes, at: int, line: bytes) -> str:
    """Text with a line inserted at a line end."""
    head = raw[:at]
    if head and not head.endswith(b"\n"):
        head += b"\n"
    return (head + line + raw[at:]).decode()


class _Places:
    """Positions of values and tables in a text, and tables that exist as dotted keys only."""

    def __init__(self, raw: bytes) -> None:
        self.raw = raw
        self.values: dict[KeyPath, Node] = {}
        self.ends: dict[KeyPath, int] = {(): 0}
        self.heads: list[KeyPath] = []
        self.dotted: dict[KeyPath, tuple[bytes, int]] = {}
        for node in syntax_tree(raw).named_children:
            if node.type == "pair":
                self._pair(node, ())
            elif node.type in ("table", "table_array_element"):
                self._table(node, element=node.type != "table")

    def _table(self, node: Node, *, element: bool) -> None:
        head = next(child for child in node.named_children if child.type in KEY_NODES)
        path = tuple(key_names(head))
        self.heads.append(path)
        if element:
            return
        self.ends[path] = self._line_end(head)
        for child in node.named_children:
            if child.type == "pair":
                self._pair(child, path)

    def _pair(self, node: Node, table: KeyPath) -> None:
        name, value = node.named_children[:2]
        path: KeyPath = (*table, *key_names(name))
        end = self._line_end(value)
        self.ends[table] = end
        for n in range(len(table) + 1, len(path)):
            prefix = "".join(f"{_bare(str(step))}." for step in path[len(table) : n]).encode()
            self.dotted[path[:n]] = (prefix, end)
        self._value(value, path)

    def _value(self, node: Node, path: KeyPath) -> None:
        self.values[path] = node
        if node.type == "array":
            for i, child in enumerate(c for c in node.named_children if c.type != "comment"):
                self._value(child, (*path, i))
        elif node.type == "inline_table":
            for child in node.named_children:
                if child.type == "pair":
                    self._value(child.named_children[1], (*path, *key_names(child.named_children[0])))

    def _line_end(self, node: Node) -> int:
        """Position just behind the line in which a node ends."""
        end = self.raw.find(b"\n", node.end_byte)
        return len(self.raw) if end < 0 else end + 1
