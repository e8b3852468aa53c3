"""The design file as pydantic models, made from the list of keys.

Imported only to validate or to print the schema: pydantic costs 0.05 s.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationInfo,
    WithJsonSchema,
    create_model,
)

from clacad.base.units import Unit, nanometres
from clacad.config.quantities import Quantity
from clacad.config.value_kinds import Kind
from clacad.design.keys import OPTIONAL, REQUIRED, ROOT, SECTIONS, Key

_STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


def _field(key: Key) -> tuple[Any, Any]:
    def read(value: object, info: ValidationInfo[Unit]) -> Any:
        return key.kind.read(value, info.context)

    annotation = Annotated[
        Any, PlainValidator(read), WithJsonSchema(key.kind.schema() | {"description": key.about})
    ]
    return annotation, Field(... if key.default is REQUIRED else key.default)


def _model(name: str, keys: dict[str, Key], sections: dict[str, Any]) -> type[BaseModel]:
    fields: dict[str, Any] = {key: _field(value) for key, value in keys.items()}
    made: type[BaseModel] = create_model(name, __config__=_STRICT, **fields, **sections)
    return made


def _document() -> type[BaseModel]:
    sections: dict[str, Any] = {}
    for name, keys in SECTIONS.items():
        model = _model(name.capitalize(), keys, {})
        sections[name] = (model, Field(default_factory=model) if name in OPTIONAL else Field(...))
    return _model("Design", ROOT, sections)


Document: type[BaseModel] = _document()
"""Model of the whole file. Validate with `context=Unit(...)`, the unit of bare lengths."""


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a design file, for editors that complete keys.

    Returns
    -------
    dict
        With `$schema`, `title` and one property for each key; unknown keys are refused.
    """
    made = Document.model_json_schema()
    for section, keys in SECTIONS.items():
        for name, key in keys.items():
            _restate_default(made["$defs"][section.capitalize()]["properties"][name], key)
    for name, key in ROOT.items():
        _restate_default(made["properties"][name], key)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **made, "title": "clacad design"}


def _restate_default(entry: dict[str, Any], key: Key) -> None:
    """Write a default as in a design file, not in its stored form."""
    entry.pop("default", None)
    if key.default is not REQUIRED and key.default is not None and key.default != ():
        entry["default"] = _as_written(key.default, key.kind)


def _as_written(value: Any, kind: Kind) -> Any:
    if isinstance(kind, Quantity) and kind.family == "wavelength":
        return nanometres(value)
    if isinstance(kind, Quantity) and kind.family == "angle":
        degrees = f"{math.degrees(value):g}"
        return f"{degrees} deg" if math.radians(float(degrees)) == value else f"{value * 1000:g} mrad"
    return list(value) if isinstance(value, tuple) else value
