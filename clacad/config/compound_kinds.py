"""Kinds of value composed of other kinds: lists, small tables, a word or another value."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

from clacad.base import units
from clacad.base.text import did_you_mean, near
from clacad.base.units import Unit
from clacad.config.value_kinds import JsonSchema, Kind, Refusal, not_this, shown


@dataclass(frozen=True, slots=True)
class Several:
    """A list of one value per name, all of one kind; with `single`, one value may represent all of them.

    not_all : values that may not occupy every position; given such a value in place of a list, the hint is
    `example`.
    """

    kind: Kind
    names: tuple[str, ...]
    single: bool = False
    not_all: tuple[float, ...] = ()
    example: str = ""

    def read(self, value: object, unit: Unit) -> tuple[Any, ...]:
        """Return a tuple with one value for each name."""
        if not isinstance(value, list):
            if self.single:
                return (self.kind.read(value, unit),) * len(self.names)
            raise Refusal(
                "CL104", not_this(value, "a list"), value, self.allowed(unit), self._listed(value, unit)
            )
        if len(value) != len(self.names):
            raise Refusal(
                "CL108", f"has {len(value)} value{'s' * (len(value) != 1)}", value, self.allowed(unit)
            )
        return tuple(each(((i, self.kind, item) for i, item in enumerate(value)), unit))

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

    Parameters
    ----------
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
    """One of a few words, or a value of another kind."""

    words: tuple[str, ...]
    other: Kind

    def read(self, value: object, unit: Unit) -> Any:
        """Return the word or the other value."""
        if not isinstance(value, str) or value in self.words:
            return value if isinstance(value, str) else self._other(value, unit)
        if units.split(value) is None:  # a text that is no quantity is a misspelt word
            hint = did_you_mean(near(value.lower(), self.words, 0.5), quote='"')
            raise Refusal("CL107", "is not a word known here", value, self.allowed(unit), hint)
        return self._other(value, unit)

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
class InlineTable:
    """A small inline table; `exactly_one` requires one key out of several."""

    kinds: tuple[tuple[str, Kind], ...]
    required: tuple[str, ...] = ()
    exactly_one: bool = False

    def read(self, value: object, unit: Unit) -> tuple[tuple[str, Any], ...]:
        """Return (key, value) pairs in the order of `kinds`."""
        if not isinstance(value, dict):
            raise Refusal("CL104", not_this(value, "a table"), value, self.allowed(unit))
        known = dict(self.kinds)
        refused = [self._unknown(key, value, unit) for key in value if key not in known]
        missing = [key for key in self.required if key not in value]
        refused += [Refusal("CL103", f"lacks the key {key}", value, self.allowed(unit)) for key in missing]
        if self.exactly_one and len(value) != 1:
            refused.append(Refusal("CL112", "needs exactly one key", value, self.allowed(unit)))
        try:
            found = each(((key, kind, value[key]) for key, kind in self.kinds if key in value), unit)
        except Refusal as refusal:
            refused += [refusal, *refusal.others]
        if refused:
            refused[0].others = tuple(refused[1:])
            raise refused[0]
        return tuple(zip((key for key, _ in self.kinds if key in value), found, strict=True))

    def _unknown(self, key: str, value: object, unit: Unit) -> Refusal:
        hint = did_you_mean(near(key, dict(self.kinds), 0.5))
        refusal = Refusal("CL102", f"has an unknown key {shown(key)}", value, self.allowed(unit), hint)
        refusal.where = (key,)
        return refusal

    def allowed(self, unit: Unit) -> str:
        """Return the table's keys with their kinds."""
        if self.exactly_one:
            return " | ".join(f"{{{key} = ...}}, {kind.allowed(unit)}" for key, kind in self.kinds)
        return "{" + ", ".join(f"{key} = ..." for key, _ in self.kinds) + "}"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of an object without other keys."""
        made: JsonSchema = {
            "type": "object",
            "properties": {key: kind.schema() for key, kind in self.kinds},
            "additionalProperties": False,
            "required": list(self.required),
        }
        return made | {"minProperties": 1, "maxProperties": 1} if self.exactly_one else made


@dataclass(frozen=True, slots=True)
class ListOrTable:
    """A list of one kind, or an inline table of another."""

    listed: Several
    table: InlineTable

    def read(self, value: object, unit: Unit) -> tuple[Any, ...]:
        """Return the value of the list or of the table."""
        try:
            return self.table.read(value, unit) if isinstance(value, dict) else self.listed.read(value, unit)
        except Refusal as refusal:
            if not refusal.where:
                refusal.allowed = self.allowed(unit)
            raise

    def allowed(self, unit: Unit) -> str:
        """Return the values that the list allows, then those that the table allows."""
        return f"{self.listed.allowed(unit)} | {self.table.allowed(unit)}"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of either."""
        return {"anyOf": [self.listed.schema(), self.table.schema()]}


@dataclass(frozen=True, slots=True)
class ListOf:
    """A list of up to 1000 values of one kind."""

    kind: Kind
    what: Literal["texts", "tables", "pairs"]

    def read(self, value: object, unit: Unit) -> tuple[Any, ...]:
        """Return the values as a tuple."""
        if not isinstance(value, list):
            raise Refusal("CL104", not_this(value, "a list"), value, self.allowed(unit))
        if len(value) > 1000:
            raise Refusal("CL108", f"has {len(value)} values", value, f"at most 1000 {self.what}")
        return tuple(each(((i, self.kind, item) for i, item in enumerate(value)), unit))

    def allowed(self, unit: Unit) -> str:
        """Return the content of the list."""
        return f"a list of {self.what}: [{self.kind.allowed(unit)}, ...]"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of an array."""
        return {"type": "array", "items": self.kind.schema(), "maxItems": 1000}
