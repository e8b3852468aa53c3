"""All keys of a scene file, from the fields of its sections, and the JSON Schema made from them."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from clacad.config import json_schema as schema
from clacad.config.key_reader import FileForm, head_keys
from clacad.config.keys import REQUIRED, Key, keys_of
from clacad.config.value_kinds import JsonSchema
from clacad.design.keys import SECTIONS as DESIGN_SECTIONS
from clacad.scene.sections import (
    KEYS_OF,
    Animation,
    Background,
    Camera,
    EffectsSpec,
    Light,
    SceneObject,
    SheetSpec,
    WrittenMove,
)

MOST_SHEETS: Final = 26
"""Largest number of sheets in a scene, as in a stack."""

ROOT: Final = head_keys(
    "name of the scene, used for files", "unit of every bare length here; the design keeps its own", "remarks"
)
_EVERY = keys_of(SheetSpec)
SHEET: Final = {name: key for name, key in _EVERY.items() if name not in ("id", "z")}
"""Keys of [sheet], the only one."""
STACKED: Final = {
    name: replace(key, default=REQUIRED) if name == "id" else key
    for name, key in _EVERY.items()
    if name != "tint"
}
"""Keys of a [[sheet]]; a scene may have several."""

SECTIONS: Final[dict[str, dict[str, Key]]] = {
    "sheet": SHEET,
    "camera": keys_of(Camera),
    "light": keys_of(Light),
    "background": keys_of(Background),
    "effects": keys_of(EffectsSpec),
    "animation": keys_of(Animation),
}
OBJECT: Final = keys_of(SceneObject)
MOVE: Final = keys_of(WrittenMove)

SCENE: Final = FileForm(
    ROOT,
    SECTIONS,
    optional=("light", "background", "effects", "animation"),
    synonyms={
        "color": "colour",
        "colors": "colours",
        "position": "at",
        "centre": "at",
        "center": "at",
        "rotation": "turn",
        "rotate": "turn",
        "type": "kind",
        "name": "id",
        "texture": "file",
        "image": "file",
        "resolution": "pixels",
        "width": "frame",
        "look_at": "target",
        "eye": "position",
        "spp": "samples",
        "objects": "object",
        "aperture_diameter": "aperture",
        "wavelength": "spectrum",
        "axis": "up",
    },
    elsewhere=dict.fromkeys(set(DESIGN_SECTIONS) - set(SECTIONS), ("design", "sheet.set")),
    lists={"object": OBJECT},
)
"""Keys of a scene file, their other names, and the sections of a design file."""


def keys_of_object(kind: object) -> dict[str, Key]:
    """Keys that an object of a kind has; all keys of objects for an unknown kind."""
    own = KEYS_OF.get(kind) if isinstance(kind, str) else None
    return OBJECT if own is None else {name: OBJECT[name] for name in ("id", "kind", *own)}


def scene_schema() -> JsonSchema:
    """Return the JSON Schema (2020-12) of a scene file, for editors that complete keys.

    Returns
    -------
    dict
        With `$schema`, `title` and one property for each key; unknown keys are refused, and each kind of
        object accepts only its own keys.
    """
    defined = {name: schema.table(keys) for name, keys in SECTIONS.items()}
    defined["animation"]["properties"]["move"] |= _list_of("move", minItems=1)
    defined["move"], defined["stacked_sheet"] = schema.table(MOVE), schema.table(STACKED)
    defined["object"] = {"oneOf": [_object_schema(kind) for kind in KEYS_OF]}
    properties = schema.properties_of(ROOT) | {name: _reference(name) for name in SECTIONS}
    several = _list_of("stacked_sheet", minItems=1, maxItems=MOST_SHEETS)
    properties["sheet"] = {"anyOf": [properties["sheet"], several]}
    properties["object"] = _list_of("object")
    needed = schema.required_of(ROOT) + [name for name in SECTIONS if name not in SCENE.optional]
    return schema.document("clacad scene", properties, needed, defined)


def _reference(name: str) -> JsonSchema:
    return {"$ref": f"#/$defs/{name}"}


def _list_of(name: str, **limits: int) -> JsonSchema:
    return {"type": "array", "items": _reference(name), **limits}


def _object_schema(kind: str) -> JsonSchema:
    """Schema of one kind of object."""
    made = schema.table(keys_of_object(kind))
    made["properties"]["kind"] = {"const": kind, "description": OBJECT["kind"].about}
    if "parts" in made["properties"]:
        made["properties"]["parts"] |= _list_of("object")
    return made
