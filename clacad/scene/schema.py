"""The JSON Schema of scene files, generated from the list of keys."""

from __future__ import annotations

from typing import Any

from clacad.design.keys import REQUIRED, Key
from clacad.scene.keys import ANIMATION, KEYS_OF, MOVE, OBJECT, OPTIONAL, ROOT, SECTIONS, STACKED
from clacad.scene.read import MOST_SHEETS

Schema = dict[str, Any]


def scene_schema() -> Schema:
    """Return the JSON Schema (2020-12) of a scene file, for editors that complete keys.

    Returns
    -------
    dict
        With `$schema`, `title` and one property for each key; unknown keys are refused, and each kind of
        object accepts only its own keys.
    """
    properties = _properties(ROOT)
    definitions: Schema = {"object": _any_object(), "move": _table(MOVE)}
    for name, keys in SECTIONS.items():
        table = _table(keys)
        if keys is ANIMATION:
            table["properties"]["move"] = {
                "type": "array", "minItems": 1, "items": {"$ref": "#/$defs/move"}, "description": keys["move"].about,
            }  # fmt: skip
        definitions[name] = table
        properties[name] = {"$ref": f"#/$defs/{name}"}
    definitions["stacked_sheet"] = _table(STACKED)
    several = {
        "type": "array",
        "minItems": 1,
        "maxItems": MOST_SHEETS,
        "items": {"$ref": "#/$defs/stacked_sheet"},
    }
    properties["sheet"] = {"anyOf": [properties["sheet"], several]}
    properties["object"] = {"type": "array", "items": {"$ref": "#/$defs/object"}}
    needed = _required(ROOT) + [name for name in SECTIONS if name not in OPTIONAL]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema", "title": "clacad scene", "type": "object",
        "properties": properties, "required": needed, "additionalProperties": False, "$defs": definitions,
    }  # fmt: skip


def _properties(keys: dict[str, Key]) -> Schema:
    return {name: key.kind.schema() | {"description": key.about} for name, key in keys.items()}


def _required(keys: dict[str, Key]) -> list[str]:
    return [name for name, key in keys.items() if key.default is REQUIRED]


def _table(keys: dict[str, Key]) -> Schema:
    table: Schema = {"type": "object", "properties": _properties(keys), "additionalProperties": False}
    return table | ({"required": _required(keys)} if _required(keys) else {})


def _any_object() -> Schema:
    """One alternative for each kind of object."""
    return {"oneOf": [_one_object(kind, names) for kind, names in KEYS_OF.items()]}


def _one_object(kind: str, names: tuple[str, ...]) -> Schema:
    properties = _properties({name: OBJECT[name] for name in ("id", *names)})
    properties["kind"] = {"const": kind, "description": OBJECT["kind"].about}
    if "parts" in properties:
        properties["parts"] = {
            "type": "array",
            "items": {"$ref": "#/$defs/object"},
            "description": OBJECT["parts"].about,
        }
    return {"type": "object", "properties": properties, "required": ["kind"], "additionalProperties": False}
