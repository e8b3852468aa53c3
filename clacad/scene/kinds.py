"""Kinds of value of scene files: colours, sizes, numbers that change with time, tables read elsewhere."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

from clacad.base.units import Unit
from clacad.config.quantities import LENGTH_ABOVE_0, LENGTH_FROM_0
from clacad.config.value_kinds import JsonSchema, Refusal, WrittenAsRead, not_this

Rgb = tuple[float, float, float]


def linear(encoded: float) -> float:
    """Linear light of an sRGB-encoded value 0 … 1 (IEC 61966-2-1)."""
    return encoded / 12.92 if encoded <= 0.04045 else ((encoded + 0.055) / 1.055) ** 2.4


@dataclass(frozen=True, slots=True)
class ColourValue(WrittenAsRead):
    """A colour of a file: "#rrggbb" (sRGB-encoded) or [r, g, b] in linear light, 0 to 1000."""

    def read(self, value: object, unit: Unit) -> Rgb:
        """Return linear red, green, blue."""
        if isinstance(value, str):
            if not re.fullmatch("#[0-9a-fA-F]{6}", value):
                hint = "write #rrggbb" if re.fullmatch("#[0-9a-fA-F]{3}", value) else ""
                raise Refusal("CL107", "is not a colour", value, self.allowed(unit), hint)
            red, green, blue = (linear(int(value[k : k + 2], 16) / 255.0) for k in (1, 3, 5))
            return red, green, blue
        if not isinstance(value, list):
            raise Refusal("CL104", not_this(value, "a colour"), value, self.allowed(unit))
        if len(value) != 3:
            raise Refusal("CL108", f"has {len(value)} values", value, self.allowed(unit))
        for k, part in enumerate(value):
            good = isinstance(part, int | float) and not isinstance(part, bool)
            if not good or not (math.isfinite(part) and 0.0 <= part <= 1000.0):
                refusal = Refusal("CL106", "is no amount of light", part, self.allowed(unit))
                refusal.within(k)
                raise refusal
        return float(value[0]), float(value[1]), float(value[2])

    def allowed(self, unit: Unit) -> str:
        """Return the two ways to write a colour."""
        return '"#rrggbb", or [r, g, b] in linear light from 0 to 1000'

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of text or three numbers."""
        number = {"type": "number", "minimum": 0, "maximum": 1000}
        return {
            "anyOf": [
                {"type": "string", "pattern": "^#[0-9a-fA-F]{6}$"},
                {"type": "array", "items": number, "minItems": 3, "maxItems": 3},
            ]
        }


@dataclass(frozen=True, slots=True)
class Anything(WrittenAsRead):
    """A value that another reader checks (keys of a design, parts of a group)."""

    what: str

    def read(self, value: object, unit: Unit) -> Any:
        """Return the value unchanged."""
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return self.what

    def schema(self) -> JsonSchema:
        """Return a JSON Schema without restrictions."""
        return {"description": self.what}


@dataclass(frozen=True, slots=True)
class Numbers:
    """A list of 2 to 10000 numbers, or of lists of numbers of one length (values of an animated key)."""

    rows: bool = False

    def read(self, value: object, unit: Unit) -> tuple[Any, ...]:
        """Return a tuple of numbers, or of tuples."""
        if not isinstance(value, list):
            raise Refusal("CL104", not_this(value, "a list"), value, self.allowed(unit))
        if not 2 <= len(value) <= 10_000:
            raise Refusal("CL108", f"has {len(value)} values", value, self.allowed(unit))
        return tuple(_number_or_row(item, self.rows, self.allowed(unit)) for item in value)

    def write(self, value: tuple[Any, ...], unit: Unit) -> list[Any]:
        """Return the numbers as lists."""
        return [list(item) if isinstance(item, tuple) else item for item in value]

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return "a list of 2 to 10000 numbers" + (", or of lists of numbers" if self.rows else "")

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of an array."""
        return {"type": "array", "minItems": 2, "maxItems": 10_000}


@dataclass(frozen=True, slots=True)
class NumberOrRow(WrittenAsRead):
    """A number or a list of numbers."""

    def read(self, value: object, unit: Unit) -> Any:
        """Return a float or a tuple of floats."""
        return _number_or_row(value, True, self.allowed(unit))

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return "a number, or a list of numbers"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of either."""
        return {"anyOf": [{"type": "number"}, {"type": "array", "items": {"type": "number"}}]}


def _number_or_row(value: object, rows: bool, allowed: str) -> Any:
    if isinstance(value, list) and rows and value:
        return tuple(_number_or_row(item, False, allowed) for item in value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not -1e12 <= value <= 1e12:
        raise Refusal("CL104", not_this(value, "a number"), value, allowed)
    return float(value)


@dataclass(frozen=True, slots=True)
class Size(WrittenAsRead):
    """The `size` of an object: one length > 0, or two or three."""

    def read(self, value: object, unit: Unit) -> tuple[float, ...]:
        """Return one to three lengths."""
        if not isinstance(value, list):
            return (LENGTH_ABOVE_0.read(value, unit),)
        if not 1 <= len(value) <= 3:
            raise Refusal("CL108", f"has {len(value)} values", value, self.allowed(unit))
        found = []
        for k, item in enumerate(value):
            try:
                found.append(LENGTH_FROM_0.read(item, unit))
            except Refusal as refusal:
                refusal.within(k)
                raise
        return tuple(found)

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return "a length > 0, or a list of two or three lengths"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of either."""
        one = LENGTH_ABOVE_0.schema()
        return {"anyOf": [one, {"type": "array", "items": one, "minItems": 1, "maxItems": 3}]}
