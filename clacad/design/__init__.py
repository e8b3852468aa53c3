"""The design file: a person's request, read, checked and explained.

`load` a file or `Design.from_dict` a dictionary; a `DesignError` lists every mistake with its position.
Nothing heavy is imported until something is validated.
"""

from __future__ import annotations

from typing import Any

from clacad.config.design_error import DesignError
from clacad.config.mistakes import CODES, Mistake
from clacad.design.model import Design, load
from clacad.design.sections import (
    AimedAt,
    Allowed,
    BodySpec,
    CheckSpec,
    FieldSpec,
    Frame,
    LatticeSpec,
    LawSpec,
    LightSpec,
    Outline,
    PairSpec,
    TolerancesSpec,
)
from clacad.design.starter_designs import template, templates

__all__ = [
    "CODES",
    "AimedAt",
    "Allowed",
    "BodySpec",
    "CheckSpec",
    "FieldSpec",
    "Design",
    "DesignError",
    "Frame",
    "LatticeSpec",
    "LawSpec",
    "LightSpec",
    "Mistake",
    "Outline",
    "PairSpec",
    "TolerancesSpec",
    "json_schema",
    "load",
    "template",
    "templates",
]


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of a design file, for editors that complete keys."""
    from clacad.design.schema import json_schema as made

    return made()
