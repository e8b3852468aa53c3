"""Reading of a file's tables with their keys, every mistake with the nearest key, and the JSON Schema of the
keys.

The schema (2020-12) is for editors that complete keys.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from clacad.base import units
from clacad.base.text import did_you_mean, mrad_text, near
from clacad.base.units import Unit
from clacad.config.compound_kinds import REQUIRED, Key, ListOf, WordOr
from clacad.config.mistakes import Mistake
from clacad.config.value_kinds import (
    FormatVersion,
    JsonSchema,
    Quantity,
    Refusal,
    Text,
    UnitWord,
    kind_of,
    not_this,
    shown,
)

Keys = Mapping[str, Key]
NO_UNIT = Unit("1", units.LENGTHS["m"])
"""Unit of lengths while that of the file is unknown."""
ANY_UNIT = Unit("unit", units.LENGTHS["m"])
"""Unit of lengths in messages about values that are not there."""


def head_keys(name: str, unit: str, notes: str) -> dict[str, Key]:
    """Keys before the first section, with their meanings."""
    letters = "a text of 1 to 80 letters, digits, spaces and - _ . , + ( ) ="
    return {
        "format": Key(FormatVersion(), "version of this file's format", REQUIRED),
        "name": Key(Text(letters, 80, plain=True), name, REQUIRED),
        "unit": Key(UnitWord(), unit, REQUIRED),
        "notes": Key(ListOf(Text("a text of 1 to 500 characters", 500), "texts"), notes, ()),
    }


@dataclass(frozen=True)
class FileForm:
    """All keys of one kind of file.

    root : Keys before the first section.
    sections : Section → its keys.
    optional : Sections that may be left out.
    synonyms : Other name of a key → its name, or its dotted path.
    elsewhere : Sections of another kind of file → (the file they belong in, key that refers to it or "").
    lists : Lists of tables at the top of the file → their keys.
    """

    root: Keys
    sections: Mapping[str, Keys]
    optional: tuple[str, ...]
    synonyms: Mapping[str, str]
    elsewhere: Mapping[str, tuple[str, str]]
    lists: Mapping[str, Keys] = field(default_factory=dict)

    def homes(self, name: str) -> list[str]:
        """Return the dotted keys whose last part is this name ("pitch" → lattice.pitch, check.pitch)."""
        tables = {**self.sections, **self.lists}
        return [f"{table}.{name}" for table, keys in tables.items() if name in keys] + (
            [name] if name in self.root or name in tables else []
        )

    def suggestion(self, where: str, name: str, here: Keys | None = None) -> str:
        """Return the dotted key a person probably meant, "" if none is near.

        where : Dotted key of the table that contains the unknown key, "" for the top level.
        name : The unknown key.
        here : optional. Keys of that table; those of the section by default.
        """
        known = self._known(where, here)
        dot = f"{where}." if where else ""
        folded = name.lower().replace("-", "_")
        if folded in known:
            return dot + folded
        meant = self.synonyms.get(folded, "")
        if meant in known:
            return dot + meant
        if "." in meant or meant in self.root:
            return meant
        close = [dot + one for one in near(folded, known, 0.65)]
        homes = self.homes(folded)
        in_list = where != "" and where not in self.sections  # its keys depend on the kind of the table
        if close or homes:
            return [*close, *homes][0] if in_list else [*homes, *close][0]
        tables = [*self.sections.values(), *self.lists.values()]
        close = near(folded, [key for keys in tables for key in keys] + list(self.root), 0.75)
        return self.homes(close[0])[0] if close else ""

    def known_in(self, where: str, here: Keys | None = None) -> str:
        """Return the keys of a table as messages list them."""
        if where:
            return ", ".join(self._known(where, here))
        tops = [*(f"[{name}]" for name in self.sections), *(f"[[{name}]]" for name in self.lists)]
        return ", ".join([*self.root, *tops])

    def _known(self, where: str, here: Keys | None) -> list[str]:
        if where:
            return list(self.sections.get(where, {}) if here is None else here)
        return [*self.root, *self.sections, *self.lists]


@dataclass
class KeyReader:
    """Reads the tables of one file and collects the mistakes.

    unit : Unit or None. Unit of bare lengths; None if the file states none that can be read.
    """

    form: FileForm
    unit: Unit | None
    found: list[Mistake] = field(default_factory=list)

    @property
    def mistakes(self) -> list[Mistake]:
        """All mistakes; a misspelt key is one, not two: the key that was meant is not missing too."""
        meant = {mistake.hint for mistake in self.found if mistake.code == "CL102"}
        return [one for one in self.found if one.code != "CL103" or one.key not in meant]

    def top(self, data: Mapping[str, Any]) -> dict[str, Any]:
        """Read the keys before the first section; refuse unknown keys and sections."""
        known = {*self.form.root, *self.form.sections, *self.form.lists}
        self.found += [self._unknown("", name, None) for name in data if name not in known]
        return self._values("", data, self.form.root)

    def section(self, name: str, data: Mapping[str, Any]) -> dict[str, Any]:
        """Read a section of the file: name → value, defaults included; unreadable values are left out."""
        keys, table = self.form.sections[name], data.get(name, {})
        if not isinstance(table, dict):
            allowed = f"a table [{name}] with the keys {self.form.known_in(name)}"
            self.refuse("CL104", f"{name} {not_this(table, 'a table')}", name, shown(table), allowed)
            return {}
        if name in data or name in self.form.optional:
            return self.table(name, table, keys)
        needed = ", ".join(key for key, one in keys.items() if one.default is REQUIRED)
        self.refuse("CL103", f"missing section [{name}]", name, allowed=f"a table with at least {needed}")
        return {key: one.default for key, one in keys.items() if one.default is not REQUIRED}

    def table(self, where: str, table: Mapping[str, Any], keys: Keys) -> dict[str, Any]:
        """Read a table with these keys, as `section` does; `where` is its dotted key."""
        self.found += [self._unknown(where, name, keys) for name in table if name not in keys]
        return self._values(where, table, keys)

    def refuse(self, code: str, message: str, key: str, found: str = "", allowed: str = "") -> None:
        """Record a mistake."""
        self.found.append(Mistake(code, message, key, found=found, allowed=allowed))

    def refused(self, key: str, refusal: Refusal) -> None:
        """Record a value that its key does not accept."""
        for one in (refusal, *refusal.others):
            self.found.append(_refused(key, one))

    def _values(self, where: str, table: Mapping[str, Any], keys: Keys) -> dict[str, Any]:
        dot = f"{where}." if where else ""
        values: dict[str, Any] = {}
        for name, key in keys.items():
            if name in table:
                try:
                    values[name] = key.kind.read(table[name], self.unit or NO_UNIT)
                except Refusal as refusal:
                    self.refused(dot + name, refusal)
            elif key.default is not REQUIRED:
                values[name] = key.default
            else:
                allowed = key.kind.allowed(self.unit or ANY_UNIT)
                self.refuse("CL103", f"missing key {dot}{name}", dot + name, allowed=allowed)
        return values

    def _unknown(self, where: str, name: str, here: Keys | None) -> Mistake:
        dotted = f"{where}.{name}" if where else name
        place = f"in [{where}]" if where in self.form.sections else "here"
        allowed = f"{place}: {self.form.known_in(where, here)}"
        if not where and name in self.form.elsewhere:
            file, hint = self.form.elsewhere[name]
            message = f"unknown key {name}: it belongs in a {file} file"
        else:
            hint = self.form.suggestion(where, name, here)
            message = f"unknown key {dotted}" + did_you_mean([hint] if hint else [], before="; ")
        return Mistake("CL102", message, dotted, found=name, allowed=allowed, hint=hint)


def _refused(key: str, refusal: Refusal) -> Mistake:
    """The mistake of a refused value."""
    is_key = refusal.code in ("CL102", "CL103")  # the message shows the table; the position is the key's
    steps = refusal.where[:-1] if refusal.code == "CL102" else refusal.where
    name = key + "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)
    place = ".".join([key, *map(str, refusal.where)])
    value = kind_of(refusal.value) if is_key else shown(refusal.value)
    message = f"{name} {refusal.complaint}" if is_key else f"{name} = {value} {refusal.complaint}"
    return Mistake(
        refusal.code, message, place, found=shown(refusal.value), allowed=refusal.allowed, hint=refusal.hint
    )


_METRE: Final = Unit("m", units.LENGTHS["m"])
_NAMED: Final = ("properties", "$defs")
"""Parts of a schema whose keys are names, in the order of the file."""


def document(
    title: str, properties: JsonSchema, required: list[str], definitions: Mapping[str, JsonSchema]
) -> JsonSchema:
    """Schema of a whole file; unknown keys are refused.

    properties : Schema of each key and section at the top.
    required : Those that must be there.
    definitions : Schemas that `properties` refer to.
    """
    made: JsonSchema = {"title": title, "type": "object", "required": required, "additionalProperties": False}
    made |= {"properties": properties, "$defs": dict(sorted(definitions.items()))}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_in_order(made)}


def table(keys: Mapping[str, Key], title: str = "") -> JsonSchema:
    """Schema of a table with these keys and no other."""
    made: JsonSchema = {"additionalProperties": False, "properties": properties_of(keys), "type": "object"}
    needed = required_of(keys)
    return made | ({"title": title} if title else {}) | ({"required": needed} if needed else {})


def properties_of(keys: Mapping[str, Key]) -> JsonSchema:
    """Schema of each key, with its meaning and its default as written in a file."""
    return {name: _property(name, key) for name, key in keys.items()}


def required_of(keys: Mapping[str, Key]) -> list[str]:
    """Names of the keys that must be written."""
    return [name for name, key in keys.items() if key.default is REQUIRED]


def _property(name: str, key: Key) -> JsonSchema:
    made = key.kind.schema() | {"description": key.about, "title": name.replace("_", " ").title()}
    default = key.default
    if isinstance(key.kind, WordOr) and default is None:
        default = key.kind.absent or None
    if default is REQUIRED or default in (None, ()):
        return made
    stated = _stated(default, key)
    return made | ({} if stated == {} else {"default": stated})


def _stated(value: Any, key: Key) -> Any:
    """A default as a person would write it."""
    kind = key.kind
    if isinstance(kind, Quantity) and kind.family == "angle" and not kind.degrees:
        degrees = f"{math.degrees(value):g}"
        return f"{degrees} deg" if math.radians(float(degrees)) == value else mrad_text(value, 6)
    return kind.write(value, _METRE)


def _in_order(schema: Any, names: bool = False) -> Any:
    """A schema with its words in alphabetical order, the default last; names keep the order of the file."""
    if isinstance(schema, list):
        return [_in_order(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    words = list(schema) if names else sorted(schema, key=lambda word: (word == "default", word))
    return {word: _in_order(schema[word], not names and word in _NAMED) for word in words}
