"""Colours: "#8fb6e0" as shown on screens, or three linear numbers."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from clacad.base.units import Unit
from clacad.config.value_kinds import JsonSchema, Refusal, not_this

Rgb = tuple[float, float, float]


def linear(encoded: float) -> float:
    """Linear light of an sRGB-encoded value 0 … 1 (IEC 61966-2-1)."""
    return encoded / 12.92 if encoded <= 0.04045 else ((encoded + 0.055) / 1.055) ** 2.4


@dataclass(frozen=True, slots=True)
class ColourValue:
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
