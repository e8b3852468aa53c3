"""Keys of a file: each is declared once, as a field of the frozen dataclass that holds its value.

`key(kind, about, default)` makes such a field, and `keys_of` lists the keys of a dataclass. The reader, the
canonical text, the JSON Schema, `clacad explain` and the suggestions for misspelt keys loop over that list.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Any, Final

from clacad.base.units import Unit
from clacad.config.value_kinds import Kind

REQUIRED: Final = object()
"""Marks a key without a default."""


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a file.

    kind : Reads and writes the value and makes its JSON Schema; it knows the unit of a bare number.
    about : Meaning, one line.
    default : Converted value of an absent key; `REQUIRED` if the key must be written.
    later : Whether the key is younger than the first canonical texts: it is absent from them at its default,
        so that the hashes of older designs stay.
    written : callable or None
        Value to write, from the whole record and the field's value; a result of None leaves the key out.
    attribute : Name of the field; "" for a key outside a dataclass.
    """

    kind: Kind
    about: str
    default: Any = None
    later: bool = False
    written: Callable[[Any, Any], Any] | None = None
    attribute: str = ""


def key(
    kind: Kind,
    about: str,
    default: Any = None,
    *,
    name: str = "",
    later: bool = False,
    written: Callable[[Any, Any], Any] | None = None,
) -> Any:
    """Field of a dataclass that is a key of a file; see `Key`.

    name : Name of the key in the file, if it is not that of the field.
    """
    metadata = {"name": name, "key": Key(kind, about, default, later, written)}
    return field(metadata=metadata) if default is REQUIRED else field(default=default, metadata=metadata)


@cache
def keys_of(record: type) -> dict[str, Key]:
    """Keys of a dataclass by their names in the file, in the order of its fields."""
    found = {}
    for one in fields(record):
        if "key" in one.metadata:
            found[one.metadata["name"] or one.name] = replace(one.metadata["key"], attribute=one.name)
    return found


def attributes_of(record: type, values: dict[str, Any]) -> dict[str, Any]:
    """Arguments of a dataclass from values by the names of its keys."""
    keys = keys_of(record)
    return {keys[name].attribute: value for name, value in values.items()}


def written(record: Any, unit: Unit) -> dict[str, Any]:
    """Return a record as the table of a file in its canonical form.

    Every key is written in the order of the fields. None and empty lists are left out, and later keys at
    their default.
    """
    made = {}
    for name, key in keys_of(record.__class__).items():
        value = getattr(record, key.attribute)
        value = value if key.written is None else key.written(record, value)
        if value is None or (key.later and value == key.default):
            continue
        if key.default is REQUIRED or value != ():
            made[name] = key.kind.write(value, unit)
    return made


class KeyPaths:
    """Dotted paths of the keys of a section: `KeyPaths("pair", keys).separation` is "pair.separation".

    names : Names of the keys of the section.
    """

    def __init__(self, section: str, names: Iterable[str]) -> None:
        self._paths = {name: f"{section}.{name}" for name in names}

    def __getattr__(self, name: str) -> str:
        paths: dict[str, str] = self.__dict__.get("_paths", {})  # absent while a copy is made
        if name not in paths:
            raise AttributeError(f"no key {name}; keys: {', '.join(paths)}")
        return paths[name]
