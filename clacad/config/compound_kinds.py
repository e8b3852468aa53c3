"""Kinds of value composed of other kinds: lists, tables of keys, a word or another value.

Keys of a file: each is declared once, as a field of the frozen dataclass that holds its value.

`key(kind, about, default)` makes such a field, and `keys_of` lists the keys of a dataclass. The reader, the
canonical text, the JSON Schema, `clacad explain` and the suggestions for misspelt keys loop over that list.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Any, Final, Literal

from clacad.base import units
from clacad.base.text import count_text, did_you_mean, near
from clacad.base.units import Unit
from clacad.config.value_kinds import JsonSchema, Kind, Refusal, not_this, shown

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


@dataclass(frozen=True, slots=True)
class Several:
    """A list of one value per name, all of one kind.

    single : Whether one value may represent all of them.
    not_all : Values that may not occupy every position; given such a value in place of a list, the hint is
        `example`.
    alone : Whether a single value is read as itself, not as a tuple of equal values.
    """

    kind: Kind
    names: tuple[str, ...]
    single: bool = False
    not_all: tuple[float, ...] = ()
    example: str = ""
    alone: bool = False

    def read(self, value: object, unit: Unit) -> Any:
        """Return a tuple with one value for each name."""
        if not isinstance(value, list):
            if self.single:
                one = self.kind.read(value, unit)
                return one if self.alone else (one,) * len(self.names)
            raise Refusal(
                "CL104", not_this(value, "a list"), value, self.allowed(unit), self._listed(value, unit)
            )
        if len(value) != len(self.names):
            raise Refusal("CL108", f"has {count_text(len(value), 'value')}", value, self.allowed(unit))
        return tuple(each(((i, self.kind, item) for i, item in enumerate(value)), unit))

    def write(self, value: Any, unit: Unit) -> Any:
        """Return a list; a single value as itself."""
        if isinstance(value, tuple):
            return [self.kind.write(item, unit) for item in value]
        return self.kind.write(value, unit)

    def _listed(self, value: object, unit: Unit) -> str:
        """Hint of a valid list in place of one number; "" where the number would be refused in a list too."""
        if not isinstance(value, int | float) or isinstance(value, bool):
            return ""
        if value in self.not_all:
            return f"write {self.example}"
        try:
            self.kind.read(value, unit)
        except Refusal:
            return ""
        return f"write [{', '.join([shown(value)] * len(self.names))}]"

    def allowed(self, unit: Unit) -> str:
        """Return the names in brackets and the kind of each."""
        one = self.kind.allowed(unit)
        return f"{one}, or {self._list()}" if self.single else f"{self._list()}, each {one}"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of an array of fixed length (or one value)."""
        n = len(self.names)
        array: JsonSchema = {"type": "array", "items": self.kind.schema(), "minItems": n, "maxItems": n}
        return {"anyOf": [self.kind.schema(), array]} if self.single else array

    def _list(self) -> str:
        return "[" + ", ".join(self.names) + "]"


def each(readers: Iterable[tuple[int | str, Kind, object]], unit: Unit) -> list[Any]:
    """Read the elements of a list or table; the raised refusal carries all faults, not only the first.

    readers : iterable of (index or key, kind, written value)
    unit : Unit
    """
    found: list[Any] = []
    refused: list[Refusal] = []
    for step, kind, item in readers:
        try:
            found.append(kind.read(item, unit))
        except Refusal as refusal:
            refusal.within(step)
            refused += [refusal, *refusal.others]
            refusal.others = ()
    if refused:
        refused[0].others = tuple(refused[1:])
        raise refused[0]
    return found


@dataclass(frozen=True, slots=True)
class WordOr:
    """One of a few words, or a value of another kind; `absent` is a word that is read as None."""

    words: tuple[str, ...]
    other: Kind
    absent: str = ""

    def read(self, value: object, unit: Unit) -> Any:
        """Return the word or the other value."""
        if not isinstance(value, str):
            return self._other(value, unit)
        if value in self.words:
            return None if value == self.absent else value
        if units.split(value) is None:  # a text that is no quantity is a misspelt word
            hint = did_you_mean(near(value.lower(), self.words, 0.5), quote='"')
            raise Refusal("CL107", "is not a word known here", value, self.allowed(unit), hint)
        return self._other(value, unit)

    def write(self, value: Any, unit: Unit) -> Any:
        """Return the word, or the other value as its kind writes it."""
        if value is None or value in self.words:
            return self.absent if value is None else value
        return self.other.write(value, unit)

    def allowed(self, unit: Unit) -> str:
        """Return the words, then the values that the other kind allows."""
        return " | ".join(f'"{word}"' for word in self.words) + f" | {self.other.allowed(unit)}"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of either."""
        return {"anyOf": [{"enum": list(self.words)}, self.other.schema()]}

    def _other(self, value: object, unit: Unit) -> Any:
        try:
            return self.other.read(value, unit)
        except Refusal as refusal:
            if not refusal.where:
                refusal.allowed = self.allowed(unit)
            raise


@dataclass(frozen=True, slots=True)
class Record:
    """A table whose keys are the key fields of a dataclass, read into that dataclass."""

    of: type

    def read(self, value: object, unit: Unit) -> Any:
        """Return the dataclass with the values."""
        kinds = self._kinds()
        needed = [name for name, key in keys_of(self.of).items() if key.default is REQUIRED]
        found = _read_table(value, kinds, needed, unit, self.allowed(unit))
        return self.of(**attributes_of(self.of, found))

    def write(self, value: Any, unit: Unit) -> dict[str, Any]:
        """Return the table, see `clacad.config.compound_kinds.written`."""
        return written(value, unit)

    def allowed(self, unit: Unit) -> str:
        """Return the table's keys."""
        return "{" + ", ".join(f"{key} = ..." for key in self._kinds()) + "}"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of an object without other keys."""
        keys = keys_of(self.of)
        return {
            "type": "object",
            "properties": {
                name: key.kind.schema() | {"description": key.about} for name, key in keys.items()
            },
            "additionalProperties": False,
            "required": [name for name, key in keys.items() if key.default is REQUIRED],
        }

    def _kinds(self) -> dict[str, Kind]:
        return {name: key.kind for name, key in keys_of(self.of).items()}


@dataclass(frozen=True, slots=True)
class OneOf:
    """A table with exactly one of several keys.

    kinds : tuple of (key, Kind)
    made : Result from key and value.
    parts : Key and value from a result.
    """

    kinds: tuple[tuple[str, Kind], ...]
    made: Callable[[str, Any], Any]
    parts: Callable[[Any], tuple[str, Any]]

    def read(self, value: object, unit: Unit) -> Any:
        """Return the result of the only key."""
        ((name, found),) = _read_table(value, dict(self.kinds), None, unit, self.allowed(unit)).items()
        return self.made(name, found)

    def write(self, value: Any, unit: Unit) -> dict[str, Any]:
        """Return the table of the only key."""
        name, part = self.parts(value)
        return {name: dict(self.kinds)[name].write(part, unit)}

    def allowed(self, unit: Unit) -> str:
        """Return the table's keys with their kinds."""
        return " | ".join(f"{{{key} = ...}}, {kind.allowed(unit)}" for key, kind in self.kinds)

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of an object with one key."""
        return {
            "type": "object",
            "properties": {key: kind.schema() for key, kind in self.kinds},
            "additionalProperties": False,
            "required": [],
            "minProperties": 1,
            "maxProperties": 1,
        }


def _read_table(
    value: object, kinds: Mapping[str, Kind], needed: Iterable[str] | None, unit: Unit, allowed: str
) -> dict[str, Any]:
    """Values of an inline table by key, in the order of `kinds`; all faults in one refusal.

    needed : keys that must be there; None: exactly one key, whichever.
    """
    if not isinstance(value, dict):
        raise Refusal("CL104", not_this(value, "a table"), value, allowed)
    refused = [_unknown(key, kinds, value, allowed) for key in value if key not in kinds]
    missing = [key for key in needed or () if key not in value]
    refused += [Refusal("CL103", f"lacks the key {key}", value, allowed) for key in missing]
    if needed is None and len(value) != 1:
        refused.append(Refusal("CL112", "needs exactly one key", value, allowed))
    names = [key for key in kinds if key in value]
    try:
        found = each(((key, kinds[key], value[key]) for key in names), unit)
    except Refusal as refusal:
        refused += [refusal, *refusal.others]
    if refused:
        refused[0].others = tuple(refused[1:])
        raise refused[0]
    return dict(zip(names, found, strict=True))


def _unknown(key: str, kinds: Mapping[str, Kind], value: object, allowed: str) -> Refusal:
    hint = did_you_mean(near(key, kinds, 0.5))
    refusal = Refusal("CL102", f"has an unknown key {shown(key)}", value, allowed, hint)
    refusal.where = (key,)
    return refusal


@dataclass(frozen=True, slots=True)
class ListOr:
    """A list, read to a tuple, or a value of another kind: an inline table, or a number."""

    listed: Kind
    other: Kind

    def read(self, value: object, unit: Unit) -> Any:
        """Return the value of the list or of the other kind."""
        table = isinstance(self.other, Record)
        other = isinstance(value, dict) if table else not isinstance(value, list)
        try:
            return (self.other if other else self.listed).read(value, unit)
        except Refusal as refusal:
            if not refusal.where:
                refusal.allowed = self.allowed(unit)
            raise

    def write(self, value: Any, unit: Unit) -> Any:
        """Return the list or the other value."""
        return (self.listed if isinstance(value, tuple) else self.other).write(value, unit)

    def allowed(self, unit: Unit) -> str:
        """Return the values that the list allows, then those of the other kind."""
        return f"{self.listed.allowed(unit)} | {self.other.allowed(unit)}"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of either."""
        return {"anyOf": [self.listed.schema(), self.other.schema()]}


@dataclass(frozen=True, slots=True)
class ListOf:
    """A list of `least` to 1000 values of one kind."""

    kind: Kind
    what: Literal["texts", "tables", "pairs"]
    least: int = 0

    def read(self, value: object, unit: Unit) -> tuple[Any, ...]:
        """Return the values as a tuple."""
        if not isinstance(value, list):
            raise Refusal("CL104", not_this(value, "a list"), value, self.allowed(unit))
        if not self.least <= len(value) <= 1000:
            raise Refusal("CL108", f"has {len(value)} values", value, f"{self.least} to 1000 {self.what}")
        return tuple(each(((i, self.kind, item) for i, item in enumerate(value)), unit))

    def write(self, value: tuple[Any, ...], unit: Unit) -> list[Any]:
        """Return the values as a list."""
        return [self.kind.write(item, unit) for item in value]

    def allowed(self, unit: Unit) -> str:
        """Return the content of the list."""
        return f"a list of {self.what}: [{self.kind.allowed(unit)}, ...]"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of an array."""
        return {"type": "array", "items": self.kind.schema(), "maxItems": 1000}
