"""Kinds of value of design keys: each reads one value, describes what it allows, and has a JSON Schema.

A kind is a frozen dataclass with four methods. `read(value, unit)` returns the converted value or raises
`Refusal`; `write(value, unit)` returns the value as a file's data; `allowed(unit)` returns the text for
messages; `schema()` returns the JSON Schema.

A number of one family (length, angle, wavelength, ratio, temperature), bare or as text with a unit.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Final, Protocol

from clacad.base import units
from clacad.base.text import did_you_mean, near
from clacad.base.units import Unit

JsonSchema = dict[str, Any]
LARGEST_COUNT: Final = 2**63 - 1
FORMAT: Final = 1
"""Version of the format of design and scene files."""


class Refusal(ValueError):
    """A value is refused by the kind of its key.

    code : Stable code of the mistake.
    complaint : The fault, worded to follow "pair.index = 0.9 ".
    value : The value found (an element of a list if only that element is wrong).
    allowed, hint : Allowed values; the nearest way out.
    where : tuple of int or str
        Path to the wrong element of a list or key of a table; extended while the exception propagates.
    others : tuple of Refusal. Further faults in the same list or table.
    """

    def __init__(self, code: str, complaint: str, value: object, allowed: str, hint: str = "") -> None:
        super().__init__(complaint)
        self.code, self.complaint, self.value = code, complaint, value
        self.allowed, self.hint = allowed, hint
        self.where: tuple[int | str, ...] = ()
        self.others: tuple[Refusal, ...] = ()

    def within(self, step: int | str) -> None:
        """Record that this refusal occurred in one element of a list or one key of a table."""
        for refusal in (self, *self.others):
            refusal.where = (step, *refusal.where)


class Kind(Protocol):
    """Interface of all kinds of value."""

    def read(self, value: object, unit: Unit) -> Any:
        """Return the converted value, or raise `Refusal`."""

    def write(self, value: Any, unit: Unit) -> Any:
        """Return a converted value as data of a file in this unit; `read` of it is the value again."""

    def allowed(self, unit: Unit) -> str:
        """Return the allowed values, in words."""

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of the written value."""


def shown(value: object) -> str:
    """Return a value as written in a file, shortened to 60 characters."""
    if isinstance(value, bool):
        text = "true" if value else "false"
    elif isinstance(value, str):
        text = '"' + value[:200].replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") + '"'
    elif isinstance(value, list):
        text = "[" + ", ".join(shown(item) for item in value[:9]) + (", ..." if len(value) > 9 else "") + "]"
    elif isinstance(value, dict):
        items = list(value.items())[:5]
        text = "{" + ", ".join(f"{key} = {shown(item)}" for key, item in items) + "}"
    elif isinstance(value, int):
        text = str(value) if abs(value) < 10**40 else "a number of more than 40 digits"
    else:
        text = "null" if value is None else str(value)
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= 60 else text[:57] + "..."


def kind_of(value: object) -> str:
    """Return the kind of a TOML value in plain words."""
    names: tuple[tuple[type, str], ...] = (
        (bool, "a truth value"),
        (int, "a whole number"),
        (float, "a number"),
        (str, "a text"),
        (list, "a list"),
        (dict, "a table"),
        (type(None), "nothing"),
    )
    return next((name for type_, name in names if isinstance(value, type_)), "a date or time")


def not_this(value: object, wanted: str) -> str:
    """Return the complaint about a value of the wrong kind: "is a text, not a number"."""
    return f"is {kind_of(value)}, not {wanted}"


class WrittenAsRead:
    """A kind whose converted value is the written value; a tuple is written as a list."""

    __slots__ = ()

    def write(self, value: Any, unit: Unit) -> Any:
        """Return the value, a tuple as a list."""
        return list(value) if isinstance(value, tuple) else value


@dataclass(frozen=True, slots=True)
class Whole(WrittenAsRead):
    """A whole number from `least` to `most`, at most 2⁶³ − 1, an index's range; sizes are checked later."""

    what: str
    least: int = 1
    most: int = LARGEST_COUNT

    def read(self, value: object, unit: Unit) -> int:
        """Return the number; refuse fractions, truth values and numbers out of range."""
        if isinstance(value, bool) or not isinstance(value, int):
            whole = isinstance(value, float) and value.is_integer() and abs(value) < LARGEST_COUNT
            hint = f"write {int(value)} without a decimal point" if whole and isinstance(value, float) else ""
            raise Refusal("CL104", not_this(value, "a whole number"), value, self.what, hint)
        if not self.least <= value <= self.most:
            raise Refusal("CL106", "is out of range", value, self.what)
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return self.what

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of an integer with a minimum."""
        return {"description": self.what, "type": "integer", "minimum": self.least, "maximum": self.most}


@dataclass(frozen=True, slots=True)
class Word(WrittenAsRead):
    """One of a few words."""

    words: tuple[str, ...]

    def read(self, value: object, unit: Unit) -> str:
        """Return the word; refuse another one, with the nearest allowed word as hint."""
        if not isinstance(value, str):
            raise Refusal("CL104", not_this(value, "a text"), value, self.allowed(unit))
        if value not in self.words:
            raise Refusal(
                "CL107", "is not a word known here", value, self.allowed(unit), self._nearest(value)
            )
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the words, in quotes."""
        return " | ".join(f'"{word}"' for word in self.words)

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of an enumeration."""
        return {"enum": list(self.words)}

    def _nearest(self, value: str) -> str:
        return did_you_mean(near(value.lower(), self.words, 0.5), quote='"')


@dataclass(frozen=True, slots=True)
class Flag(WrittenAsRead):
    """true or false."""

    def read(self, value: object, unit: Unit) -> bool:
        """Return the flag; 0, 1 and "yes" are refused."""
        if not isinstance(value, bool):
            raise Refusal("CL104", not_this(value, "true or false"), value, self.allowed(unit))
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the two words."""
        return "true | false"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a boolean."""
        return {"type": "boolean"}


@dataclass(frozen=True, slots=True)
class Text(WrittenAsRead):
    """A text of limited length; `plain`: only characters safe in file names; `pattern`: a full match."""

    what: str
    longest: int
    plain: bool = False
    pattern: str = ""

    def read(self, value: object, unit: Unit) -> str:
        """Return the text; refuse an empty or too long one, and characters that are not allowed."""
        if not isinstance(value, str):
            raise Refusal("CL104", not_this(value, "a text"), value, self.what)
        if not 1 <= len(value) <= self.longest:
            raise Refusal("CL106", "is empty" if not value else "is too long", value, self.what)
        if not value.isprintable():
            raise Refusal("CL106", "holds a control character", value, self.what)
        if self.pattern and not re.fullmatch(self.pattern, value, re.ASCII):
            raise Refusal("CL106", "does not have the form needed", value, self.what)
        wrong = [c for c in value if not (c.isalnum() or c in " -_.,+()=")] if self.plain else []
        if wrong or (self.plain and not value[0].isalnum()):
            raise Refusal(
                "CL106",
                f"must not hold '{wrong[0]}'" if wrong else "must start with a letter or digit",
                value,
                self.what,
            )
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return self.what

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a string with its length."""
        return {"description": self.what, "type": "string", "minLength": 1, "maxLength": self.longest}


@dataclass(frozen=True, slots=True)
class UnitWord(WrittenAsRead):
    """The value of `unit`."""

    def read(self, value: object, unit: Unit) -> str:
        """Return the text; its length in metres is `units.design_unit`."""
        if not isinstance(value, str):
            raise Refusal("CL104", not_this(value, "a text"), value, self.allowed(unit))
        if units.design_unit(value) is None:
            words = ("nm", "um", "mm", "cm", "m", "in")
            hint = did_you_mean(near(value.lower(), words, 0.5), quote='"')
            raise Refusal("CL105", "is not a length", value, self.allowed(unit), hint)
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return '"m" | "cm" | "mm" | "um" | "nm" | "in", or a length such as "100 mm"'

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a string."""
        return {"type": "string", "examples": ["mm", "um", "m", "100 mm"]}


@dataclass(frozen=True, slots=True)
class FormatVersion(WrittenAsRead):
    """The value of `format`: the version of the file format, so that old files stay readable forever."""

    def read(self, value: object, unit: Unit) -> int:
        """Return the version; refuse an unsupported one."""
        if isinstance(value, bool) or not isinstance(value, int):
            raise Refusal("CL104", not_this(value, "a whole number"), value, self.allowed(unit))
        if value != FORMAT:
            raise Refusal("CL109", "is not a format this version reads", value, self.allowed(unit))
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the supported versions."""
        return str(FORMAT)

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a constant."""
        return {"const": FORMAT}


SMALLEST_M: Final = 1e-12
"""Smallest length except 0, metres: smaller ones are typing errors, and would leave the range of floats."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number of one family, bare or as text with a unit.

    family : {"length", "angle", "wavelength", "ratio", "temperature"}
    what : Text for messages: "a length > 0".
    above, least, most : The value must be > `above`, >= `least` and <= `most` (in the units of the result).
    degrees : Angles only: the result is in degrees, not radians.
    bare : Whether a number without a unit is accepted.
    named : Lengths only: whether the written value names its unit even if a bare number is accepted.
    """

    family: units.Family
    what: str
    above: float = -math.inf
    least: float = -1e9
    most: float = 1e9
    degrees: bool = False
    bare: bool = True
    named: bool = False

    def read(self, value: object, unit: Unit) -> float:
        """Return the value as float: design units, degrees or radians, metres, or a plain ratio."""
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise self._refused(
                "CL104",
                not_this(value, "a number" if self.bare else "a text with a number and a unit"),
                value,
                unit,
            )
        number = self._with_unit(value, unit) if isinstance(value, str) else self._bare(value, unit)
        if not math.isfinite(number):
            raise self._refused("CL106", "is not a finite number", value, unit)
        if self.family == "length" and number != 0.0 and abs(number) * float(unit.metres) < SMALLEST_M:
            hint = "no length but 0 is below 1 pm, a hundredth of an atom"
            raise self._refused("CL106", "is out of range", value, unit, hint)
        if not (number > self.above and self.least <= number <= self.most):
            raise self._refused("CL106", "is out of range", value, unit, self._scale_hint(value))
        return number + 0.0  # -0.0 becomes 0.0: equal designs must have equal texts

    def write(self, value: float, unit: Unit) -> float | str:
        """Return nanometres, a text with a unit, or a number in the file's unit."""
        if self.family == "wavelength":
            return units.nanometres(value)
        if self.family == "angle" and not self.degrees:
            return f"{value!r} rad"
        if self.family == "temperature":
            return f"{value!r} {units.KELVIN}"
        if self.family == "length" and (self.named or not self.bare):
            return _length_text(value, unit.name)
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the range and the allowed units."""
        bare = {
            "length": f"a bare number is in units of {unit.name}" if unit.name[0].isdigit() else unit.name,
            "angle": "deg",
            "wavelength": "nm",
            "ratio": "",
            "temperature": "",
        }[self.family]
        if self.family == "ratio":
            return self.what
        start = f"bare = {bare}, or " if self.bare else ""
        return f"{self.what} ({start}text with a unit: {units.SHOWN[self.family]})"

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a number or text, without the range where it depends on the unit."""
        number: JsonSchema = {"type": "number"}
        if self.family == "ratio" or (self.family == "angle" and self.degrees):
            number |= (
                {"exclusiveMinimum": self.above} if math.isfinite(self.above) else {"minimum": self.least}
            )
            number |= {"maximum": self.most}
        elif self.above == 0.0:
            number |= {"exclusiveMinimum": 0}
        text: JsonSchema = {"type": "string", "pattern": _pattern(self.family)}
        return {"description": self.what, "anyOf": [number, text] if self.bare else [text]}

    def _bare(self, value: float, unit: Unit) -> float:
        try:
            number = float(value)
        except OverflowError:
            raise self._refused("CL106", "is out of range", value, unit) from None
        if not self.bare:
            number_text, words = shown(value), _WORDS.get(self.family, (unit.name, "um"))
            hint = " or ".join(f'"{number_text} {word}"' for word in words if not word[0].isdigit())
            hint = f"write {hint}, whichever you mean"
            raise self._refused("CL105", "has no unit", value, unit, hint)
        if self.family == "angle" and not self.degrees:
            return math.radians(number)
        if self.family == "wavelength" and math.isfinite(number):
            return units.metres_from_nanometres(number)
        return number

    def _with_unit(self, value: str, unit: Unit) -> float:
        """Value of a number with a unit word, as returned by `read`."""
        parts = units.split(value)
        if parts is None:
            raise self._refused("CL104", "is not a number with a unit", value, unit)
        number, word = parts
        family = units.family_of(word)
        if not word:
            hint = f"write {value.strip()} without quotes" if self.bare else ""
            raise self._refused("CL105", "has no unit", value, unit, hint)
        if family is None:
            raise self._refused(
                "CL105", f"has an unknown unit '{word}'", value, unit, _nearest_unit(word, self.family)
            )
        if family != self.family and not (family == "length" and self.family == "wavelength"):
            article = "an" if family == "angle" else "a"
            raise self._refused("CL105", f"is {article} {family}", value, unit)
        return self._converted(number, word, unit)

    def _scale_hint(self, value: object) -> str:
        """Hint for a wavelength that was written in metres or micrometres."""
        if self.family != "wavelength" or isinstance(value, str):
            return ""
        assert isinstance(value, int | float)
        scales = (("m", 1e9), ("um", 1e3))
        meant = [
            f'"{value:g} {word}" is {value * by:g}' for word, by in scales if 100 <= value * by <= 20_000
        ]
        return f"bare numbers are nm; {meant[0]}" if meant else ""

    def _converted(self, number: Fraction, word: str, unit: Unit) -> float:
        if self.family == "length":
            return units.in_design_units(number, word, unit)
        if self.family == "wavelength":
            return units.in_metres(number, word)
        if self.family in ("ratio", "temperature"):
            return float(number * units.PERCENT.get(word, 1))
        return units.in_degrees(number, word) if self.degrees else units.in_radians(number, word)

    def _refused(self, code: str, complaint: str, value: object, unit: Unit, hint: str = "") -> Refusal:
        return Refusal(code, complaint, value, self.allowed(unit), hint)


_WORDS: Final = {"angle": ("mrad", "deg"), "temperature": (units.KELVIN,)}
"""Units that the hint of a number without one suggests; of a length the unit of the file and um."""

LENGTH: Final = Quantity("length", "a length")
LENGTH_ABOVE_0: Final = Quantity("length", "a length > 0", above=0.0)
LENGTH_FROM_0: Final = Quantity("length", "a length >= 0", least=0.0)


def _length_text(value: float, unit: str) -> str:
    """Write a length of `value` units of the file with a unit word, so that it reads back exactly."""
    if unit in units.LENGTHS:
        return f"{value!r} {unit}"
    parts = units.split(unit)
    assert parts is not None, unit  # the unit was validated when the file was read
    return f"{_decimal(Fraction(repr(value)) * parts[0])} {parts[1]}"


def _decimal(number: Fraction) -> str:
    """Return a terminating decimal fraction, digit for digit."""
    tens, whole = 0, number
    while whole.denominator != 1:
        whole, tens = whole * 10, tens + 1
    return f"{whole.numerator}e-{tens}" if tens else str(whole.numerator)


def _pattern(family: units.Family) -> str:
    words = {
        "length": list(units.LENGTHS),
        "wavelength": list(units.LENGTHS),
        "angle": [*units.DEGREES, *units.RADIANS],
        "ratio": list(units.PERCENT),
        "temperature": [units.KELVIN],
    }[family]
    return r"^\s*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?\s*(" + "|".join(words) + r")\s*$"


_SPELLINGS: Final = {
    "micron": "um",
    "microns": "um",
    "micrometre": "um",
    "micrometer": "um",
    "u": "um",
    "millimetre": "mm",
    "millimeter": "mm",
    "metre": "m",
    "meter": "m",
    "inch": "in",
    '"': "in",
    "nanometre": "nm",
    "degree": "deg",
    "degrees": "deg",
    "degs": "deg",
    "radian": "rad",
    "radians": "rad",
    "milliradian": "mrad",
    "'": "arcmin",
}


def _nearest_unit(word: str, family: units.Family) -> str:
    known = units.SHOWN[family].split()
    folded = {name.lower(): name for name in known}
    meant = [name for name in (_SPELLINGS.get(word.lower()), folded.get(word.lower())) if name in known][:1]
    meant = meant or [name for name in known if len(name) == len(word) and _one_slip(name, word)]
    return did_you_mean(meant or near(word, known, 0.5))


def _one_slip(name: str, word: str) -> bool:
    """Whether two words of equal length differ in one letter, or in the order of their letters."""
    return sorted(name) == sorted(word) or sum(a != b for a, b in zip(name, word, strict=True)) == 1
