"""The design file as pydantic models, made from the list of keys.

Imported only to validate or to print the schema: pydantic costs 0.05 s.
"""

from __future__ import annotations

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

from clacad.design.keys import OPTIONAL, REQUIRED, ROOT, SECTIONS, Key
from clacad.design.units import Unit

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
"""The whole file. Validate with `context=Unit(...)`, the unit of bare lengths."""


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a design file, for editors that complete keys.

    Returns
    -------
    dict
        With `$schema`, `title` and one property for each key; unknown keys are refused.
    """
    made = Document.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **made, "title": "clacad design"}
