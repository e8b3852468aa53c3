"""JSON Schema (2020-12) of a file, made from its keys, for editors that complete keys."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from clacad.base import units
from clacad.base.units import Unit
from clacad.config.compound_kinds import WordOr
from clacad.config.keys import REQUIRED, Key
from clacad.config.quantities import Quantity
from clacad.config.value_kinds import JsonSchema

_METRE: Final = Unit("m", units.LENGTHS["m"])
_NAMED: Final = ("properties", "$defs")
"""Parts of a schema whose keys are names, in the order of the file."""


def document(
    title: str, properties: JsonSchema, required: list[str], definitions: Mapping[str, JsonSchema]
) -> JsonSchema:
    """Schema of a whole file; unknown keys are refused.

    Parameters
    ----------
    title : str
    properties : dict
        Schema of each key and section at the top.
    required : list of str
        Those that must be there.
    definitions : mapping
        Schemas that `properties` refer to.
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
        return f"{degrees} deg" if math.radians(float(degrees)) == value else f"{value * 1000:g} mrad"
    return kind.write(value, _METRE)


def _in_order(schema: Any, names: bool = False) -> Any:
    """A schema with its words in alphabetical order, the default last; names keep the order of the file."""
    if isinstance(schema, list):
        return [_in_order(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    words = list(schema) if names else sorted(schema, key=lambda word: (word == "default", word))
    return {word: _in_order(schema[word], not names and word in _NAMED) for word in words}
