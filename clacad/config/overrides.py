"""Overrides: change of one key of a design from outside the file (--set "law.eta=[-1.4,-1]")."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from clacad.base.text import plain
from clacad.config.design_error import DesignError
from clacad.config.key_positions import KeyPath, split_key
from clacad.config.mistakes import Mistake
from clacad.config.toml_text import toml_value
from clacad.config.value_kinds import kind_of


def parse(text: str) -> tuple[str, Any] | Mistake:
    """Split "key.path=value"; the value is read as TOML, or as plain text where it is not TOML.

    Returns
    -------
    (key, value) or Mistake
    """
    key, equals, value = text.partition("=")
    key, value = key.strip(), value.strip()
    if not equals or not key or not value or "\n" in text or "\r" in text:
        return Mistake("CL118", "an override is written key.path=value", path="--set", source_line=text,
                       allowed='such as "law.eta=[-1.4,-1]" or pair.form=slab')  # fmt: skip
    try:
        return key, toml_value(value)
    except ValueError:
        if value[0] in "[{\"'" or not value.isprintable():
            return Mistake("CL118", f"the value of {key} is not TOML", path="--set", source_line=text,
                           column=text.find("=") + 2, width=len(value),
                           allowed='a number, "text", [list], true or false')  # fmt: skip
        return key, value


Put = Callable[[Any, str, Any], Any]
"""Data with one dotted key replaced: data, key, value."""


def apply(
    data: Mapping[str, Any], texts: Sequence[str], put_key: Put
) -> tuple[dict[str, Any], list[tuple[KeyPath, str]], list[Mistake]]:
    """Apply overrides to the data of a file.

    Parameters
    ----------
    data : mapping
    texts : sequence of str
        "key.path=value" each, applied in order.
    put_key : callable
        As `put_dotted`.

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

    Raises
    ------
    DesignError
        A key leads nowhere.
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

    Raises
    ------
    TypeError
        The arguments are neither.
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

    Raises
    ------
    LookupError
        The path leads through a value without such a part; the message is one sentence.
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
