"""The design file: a person's request, read, checked and explained.

`load` a file or `Design.from_dict` a dictionary; a `DesignError` lists every mistake with its position.
Nothing heavy is imported until something is validated.
"""

from __future__ import annotations

from clacad.config.mistakes import CODES, DesignError, Mistake
from clacad.design.body import BodySpec, Frame, Outline
from clacad.design.limit_sections import Allowed, CheckSpec, ProcessSpec, TolerancesSpec
from clacad.design.model import Design, load
from clacad.design.sections import AimedAt, FieldSpec, LatticeSpec, LawSpec, LightSpec, PairSpec, json_schema
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
    "ProcessSpec",
    "TolerancesSpec",
    "json_schema",
    "load",
    "template",
    "templates",
]
