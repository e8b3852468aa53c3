"""The only conversion between quantities as people write them and numbers the program computes with.

Design lengths become multiples of the design's unit, angles degrees or radians, wavelengths metres.
A quantity with a unit is converted exactly (rational arithmetic) and rounded once: "250 um" in a
design in mm is exactly the float 0.25.

Even-order terms of faces: their monomials, and the units of their coefficients.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, Literal

Family = Literal["length", "angle", "wavelength", "ratio", "temperature"]

LENGTHS: Final[dict[str, Fraction]] = {
    "nm": Fraction(1, 10**9),
    "um": Fraction(1, 10**6),
    "µm": Fraction(1, 10**6),
    "μm": Fraction(1, 10**6),
    "mm": Fraction(1, 1000),
    "cm": Fraction(1, 100),
    "m": Fraction(1),
    "in": Fraction(254, 10000),
}
"""Length units in metres. The micro sign and the Greek mu are two different characters that look alike."""

DEGREES: Final[dict[str, Fraction]] = {
    "deg": Fraction(1),
    "°": Fraction(1),
    "arcmin": Fraction(1, 60),
    "arcsec": Fraction(1, 3600),
}
"""Angle units that are rational multiples of a degree."""

RADIANS: Final[dict[str, Fraction]] = {
    "rad": Fraction(1),
    "mrad": Fraction(1, 1000),
    "urad": Fraction(1, 10**6),
    "µrad": Fraction(1, 10**6),
    "μrad": Fraction(1, 10**6),
}
"""Angle units that are rational multiples of a radian."""

MILLIMETRE: Final = 1e-3
"""Millimetre in metres: the unit of most files."""

PERCENT: Final[dict[str, Fraction]] = {"%": Fraction(1, 100)}

KELVIN: Final = "K"
"""The unit of differences of temperature."""

SHOWN: Final[dict[Family, str]] = {
    "length": "nm um mm cm m in",
    "angle": "deg arcmin arcsec rad mrad urad",
    "wavelength": "nm um mm m",
    "ratio": "%",
    "temperature": KELVIN,
}
"""Units of each family as messages list them (without alternative spellings that look the same)."""

# Three digits of exponent are enough for every float; a string cannot request a gigabyte of zeros.
_QUANTITY = re.compile(r"\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?)\s*(\S*)\s*", re.ASCII)
_LONGEST = 64


@dataclass(frozen=True, slots=True)
class Unit:
    """The unit of bare lengths in a design.

    name : As written: "mm", or a length such as "100 mm".
    metres : Its exact length in metres.
    """

    name: str
    metres: Fraction


def family_of(unit: str) -> Family | None:
    """Return the family a unit word belongs to, None for a word not in the closed list."""
    if unit in LENGTHS:
        return "length"
    if unit in DEGREES or unit in RADIANS:
        return "angle"
    return "ratio" if unit in PERCENT else "temperature" if unit == KELVIN else None


def split(text: str) -> tuple[Fraction, str] | None:
    """Split a quantity into its exact number and its unit word ("" if there is none).

    Returns None where the text does not start with a number, is longer than 64 characters, or its
    number is beyond float64.
    """
    match = _QUANTITY.fullmatch(text) if len(text) <= _LONGEST else None
    if match is None or not math.isfinite(float(match[1])):
        return None
    return Fraction(match[1]), match[2]


def design_unit(text: str) -> Unit | None:
    """Read the `unit` key: a unit word ("mm") or a length ("100 mm"); None if it is neither."""
    if text in LENGTHS:
        return Unit(text, LENGTHS[text])
    parts = split(text) if len(text) <= 24 else None  # short enough that every multiple of it can be written
    if parts is None or parts[1] not in LENGTHS or not 10**-12 <= parts[0] * LENGTHS[parts[1]] <= 10**6:
        return None
    return Unit(text, parts[0] * LENGTHS[parts[1]])


def _nearest(number: Fraction) -> float:
    """Round to a double; a number beyond the largest double becomes infinite."""
    try:
        return float(number)
    except OverflowError:
        return math.inf if number > 0 else -math.inf


def in_design_units(number: Fraction, word: str, unit: Unit) -> float:
    """Convert a length with a unit word to design units."""
    return _nearest(number * LENGTHS[word] / unit.metres)


def in_metres(number: Fraction, word: str) -> float:
    """Convert a length or wavelength with a unit word to metres."""
    return _nearest(number * LENGTHS[word])


def in_degrees(number: Fraction, word: str) -> float:
    """Convert an angle with a unit word to degrees; for deg and its parts exact before the one rounding."""
    return (
        _nearest(number * DEGREES[word])
        if word in DEGREES
        else math.degrees(_nearest(number * RADIANS[word]))
    )


def in_radians(number: Fraction, word: str) -> float:
    """Convert an angle with a unit word to radians; for rad and its parts exact before the one rounding."""
    return (
        _nearest(number * RADIANS[word])
        if word in RADIANS
        else math.radians(_nearest(number * DEGREES[word]))
    )


def millimetres(metres: float) -> float:
    """Return a length in millimetres with the decimal digits of the value in metres.

    For a design unit in metres: the number of millimetres per unit, the scale of every file.
    """
    return float(Fraction(repr(metres)) * 1000)


def nanometres(metres: float) -> float:
    """Return a wavelength in nm with the decimal digits of the value in metres."""
    return float(Fraction(repr(metres)) * 10**9)


def metres_from_nanometres(number: float) -> float:
    """Return a wavelength in metres from bare nm, rounded once from the written decimal digits."""
    return float(Fraction(repr(float(number))) / 10**9)


MONOMIALS: Final = {
    "a4": ("x⁴", "x² y²", "y⁴"),
    "a6": ("x⁶", "x⁴ y²", "x² y⁴", "y⁶"),
    "a8": ("x⁸", "x⁶ y²", "x⁴ y⁴", "x² y⁶", "y⁸"),
}
"""Key of an order → monomials that its coefficients multiply."""

POWER: Final = {"a4": 3, "a6": 5, "a8": 7}
"""Key of an order → unit of its coefficients as a power of 1/length."""

RAISED: Final = {3: "³", 5: "⁵", 7: "⁷"}
"""Power of 1/length → printed exponent."""

A4 = tuple[float, float, float]
A6 = tuple[float, float, float, float]
A8 = tuple[float, float, float, float, float]
NO_A4: Final[A4] = (0.0, 0.0, 0.0)
NO_A6: Final[A6] = (0.0, 0.0, 0.0, 0.0)
NO_A8: Final[A8] = (0.0, 0.0, 0.0, 0.0, 0.0)
