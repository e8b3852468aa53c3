"""Kinds of value a design key can have: each reads one value, says what it allows, and knows its JSON Schema.

A kind is a frozen dataclass with `read(value, unit)`, which returns the converted value or raises
`Refusal`, `allowed(unit)`, the words of the message, and `schema()`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, Final, Literal, Protocol

from clacad.design import units
from clacad.design.units import Unit

JsonSchema = dict[str, Any]
LARGEST_COUNT: Final = 2**63 - 1


class Refusal(ValueError):
    """A value that its key does not take.

    Parameters
    ----------
    code : str
        Stable code of the mistake.
    complaint : str
        What is wrong, to stand after "pair.index = 0.9 ".
    value : object
        The value found (an element of a list where only that element is wrong).
    allowed, hint : str
        What may stand there; the nearest way out.

    Attributes
    ----------
    where : tuple of int or str
        Element of the list, or key of the table, that is wrong; filled in on the way out.
    others : tuple of Refusal
        What else is wrong in the same list or table.
    """

    def __init__(self, code: str, complaint: str, value: object, allowed: str, hint: str = "") -> None:
        super().__init__(complaint)
        self.code, self.complaint, self.value = code, complaint, value
        self.allowed, self.hint = allowed, hint
        self.where: tuple[int | str, ...] = ()
        self.others: tuple[Refusal, ...] = ()

    def within(self, step: int | str) -> None:
        """Note that this refusal happened in one element of a list or one key of a table."""
        for refusal in (self, *self.others):
            refusal.where = (step, *refusal.where)


class Kind(Protocol):
    """What every kind of value can do."""

    def read(self, value: object, unit: Unit) -> Any:
        """Return the converted value, or raise `Refusal`."""

    def allowed(self, unit: Unit) -> str:
        """Return what may stand there, in words."""

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of the written value."""


def shown(value: object) -> str:
    """Return a value as it would stand in the file, shortened to 60 characters."""
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
    return text if len(text) <= 60 else text[:57] + "..."


def kind_of(value: object) -> str:
    """Return the kind of a TOML value in words a person uses."""
    names: tuple[tuple[type, str], ...] = (
        (bool, "true or false"), (int, "a whole number"), (float, "a number"), (str, "a text"),
        (list, "a list"), (dict, "a table"),
    )  # fmt: skip
    return next((name for type_, name in names if isinstance(value, type_)), "a date or time")


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number of one family, bare or as text with a unit.

    Parameters
    ----------
    family : {"length", "angle", "wavelength", "ratio"}
    what : str
        The words of the message: "a length > 0".
    above, least, most : float
        The value must be > `above`, >= `least` and <= `most` (in the units of the result).
    degrees : bool
        Angles only: the result is in degrees, not radians.
    bare : bool
        Whether a number without a unit is taken.
    """

    family: units.Family
    what: str
    above: float = -math.inf
    least: float = -1e9
    most: float = 1e9
    degrees: bool = False
    bare: bool = True

    def read(self, value: object, unit: Unit) -> float:
        """Return the value as float: design units, degrees or radians, metres, or a plain ratio."""
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            raise self._refused("CL104", f"is {kind_of(value)}", value, unit)
        number = self._with_unit(value, unit) if isinstance(value, str) else self._bare(value, unit)
        if not math.isfinite(number):
            raise self._refused("CL106", "is not a finite number", value, unit)
        if not (number > self.above and self.least <= number <= self.most):
            raise self._refused("CL106", "is out of range", value, unit)
        return number + 0.0  # -0.0 becomes 0.0: equal designs must have equal texts

    def allowed(self, unit: Unit) -> str:
        """Return the range and the way to write a unit."""
        bare = {
            "length": f"a bare number is in units of {unit.name}" if unit.name[0].isdigit() else unit.name,
            "angle": "deg",
            "wavelength": "nm",
            "ratio": "",
        }[self.family]
        if self.family == "ratio":
            return self.what
        start = f"bare = {bare}, or " if self.bare else ""
        return f"{self.what} ({start}text with a unit: {units.SHOWN[self.family]})"

    def schema(self) -> JsonSchema:
        """Return number or text, without the range where it depends on the unit."""
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
            number_text, words = shown(value), {"angle": ("mrad", "deg")}.get(self.family, (unit.name, "um"))
            hint = " or ".join(f'"{number_text} {word}"' for word in words if not word[0].isdigit())
            hint = f"write {hint}, whichever you mean"
            raise self._refused("CL105", "has no unit", value, unit, hint)
        if self.family == "angle" and not self.degrees:
            return math.radians(number)
        if self.family == "wavelength" and math.isfinite(number):
            return units.metres_from_nanometres(number)
        return number

    def _with_unit(self, value: str, unit: Unit) -> float:
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

    def _converted(self, number: Any, word: str, unit: Unit) -> float:
        if self.family == "length":
            return units.in_design_units(number, word, unit)
        if self.family == "wavelength":
            return units.in_metres(number, word)
        if self.family == "ratio":
            return float(number * units.PERCENT[word])
        return units.in_degrees(number, word) if self.degrees else units.in_radians(number, word)

    def _refused(self, code: str, complaint: str, value: object, unit: Unit, hint: str = "") -> Refusal:
        return Refusal(code, complaint, value, self.allowed(unit), hint)


def _pattern(family: units.Family) -> str:
    words = {
        "length": list(units.LENGTHS),
        "wavelength": list(units.LENGTHS),
        "angle": [*units.DEGREES, *units.RADIANS],
        "ratio": list(units.PERCENT),
    }[family]
    return r"^\s*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?\s*(" + "|".join(words) + r")\s*$"


_SPELLINGS: Final = {
    "micron": "um", "microns": "um", "micrometre": "um", "micrometer": "um", "u": "um", "millimetre": "mm",
    "millimeter": "mm", "metre": "m", "meter": "m", "inch": "in", '"': "in", "nanometre": "nm", "degree": "deg",
    "degrees": "deg", "degs": "deg", "radian": "rad", "radians": "rad", "milliradian": "mrad", "'": "arcmin",
}  # fmt: skip


def _nearest_unit(word: str, family: units.Family) -> str:
    known = units.SHOWN[family].split()
    folded = {name.lower(): name for name in known}
    near = _SPELLINGS.get(word.lower()) or folded.get(word.lower())
    if near is None:
        close = get_close_matches(word, known, n=1, cutoff=0.5)
        near = close[0] if close else None
    return f"did you mean {near}?" if near in known else ""


@dataclass(frozen=True, slots=True)
class Whole:
    """A whole number from `least` to 2⁶³ − 1 (what an index can hold; limits on size come later)."""

    what: str
    least: int = 1
    most: int = LARGEST_COUNT

    def read(self, value: object, unit: Unit) -> int:
        """Return the number."""
        if isinstance(value, bool) or not isinstance(value, int):
            whole = isinstance(value, float) and value.is_integer() and abs(value) < 1e15
            hint = f"write {int(value)} without a decimal point" if whole and isinstance(value, float) else ""
            raise Refusal("CL104", f"is {kind_of(value)}", value, self.what, hint)
        if not self.least <= value <= self.most:
            raise Refusal("CL106", "is out of range", value, self.what)
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return self.what

    def schema(self) -> JsonSchema:
        """Return an integer with a minimum."""
        return {"description": self.what, "type": "integer", "minimum": self.least, "maximum": self.most}


@dataclass(frozen=True, slots=True)
class Word:
    """One of a few words."""

    words: tuple[str, ...]

    def read(self, value: object, unit: Unit) -> str:
        """Return the word."""
        if not isinstance(value, str):
            raise Refusal("CL104", f"is {kind_of(value)}", value, self.allowed(unit))
        if value not in self.words:
            raise Refusal(
                "CL107", "is not a word known here", value, self.allowed(unit), self._nearest(value)
            )
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the words, in quotes."""
        return " | ".join(f'"{word}"' for word in self.words)

    def schema(self) -> JsonSchema:
        """Return an enumeration."""
        return {"enum": list(self.words)}

    def _nearest(self, value: str) -> str:
        close = get_close_matches(value.lower(), self.words, n=1, cutoff=0.5)
        return f'did you mean "{close[0]}"?' if close else ""


@dataclass(frozen=True, slots=True)
class Flag:
    """true or false."""

    def read(self, value: object, unit: Unit) -> bool:
        """Return the flag; 0, 1 and "yes" are refused."""
        if not isinstance(value, bool):
            raise Refusal("CL104", f"is {kind_of(value)}", value, self.allowed(unit))
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the two words."""
        return "true | false"

    def schema(self) -> JsonSchema:
        """Return a boolean."""
        return {"type": "boolean"}


@dataclass(frozen=True, slots=True)
class Text:
    """A text of limited length; `plain` allows only what is safe in a file name, `pattern` is a full match."""

    what: str
    longest: int
    plain: bool = False
    pattern: str = ""

    def read(self, value: object, unit: Unit) -> str:
        """Return the text."""
        if not isinstance(value, str):
            raise Refusal("CL104", f"is {kind_of(value)}", value, self.what)
        if not 1 <= len(value) <= self.longest:
            raise Refusal("CL106", "is empty" if not value else "is too long", value, self.what)
        if not value.isprintable():
            raise Refusal("CL106", "holds a control character", value, self.what)
        if self.pattern and not re.fullmatch(self.pattern, value, re.ASCII):
            raise Refusal("CL106", "does not have the form needed", value, self.what)
        wrong = [c for c in value if not (c.isalnum() or c in " -_.,+()=")] if self.plain else []
        if wrong or (self.plain and not value[0].isalnum()):
            raise Refusal("CL106", f"must not hold '{wrong[0]}'" if wrong else "must start with a letter or digit",
                          value, self.what)  # fmt: skip
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return self.what

    def schema(self) -> JsonSchema:
        """Return a string with its length."""
        return {"description": self.what, "type": "string", "minLength": 1, "maxLength": self.longest}


@dataclass(frozen=True, slots=True)
class Several:
    """A list of exactly `count` values of one kind; with `single`, one value stands for all of them."""

    kind: Kind
    names: tuple[str, ...]
    single: bool = False

    def read(self, value: object, unit: Unit) -> tuple[Any, ...]:
        """Return a tuple with one value for each name."""
        if not isinstance(value, list):
            if self.single:
                return (self.kind.read(value, unit),) * len(self.names)
            repeated = ", ".join([shown(value)] * len(self.names))
            hint = (
                f"write [{repeated}]"
                if isinstance(value, int | float) and not isinstance(value, bool)
                else ""
            )
            raise Refusal("CL104", f"is {kind_of(value)}", value, self.allowed(unit), hint)
        if len(value) != len(self.names):
            raise Refusal(
                "CL108", f"has {len(value)} value{'s' * (len(value) != 1)}", value, self.allowed(unit)
            )
        return tuple(each(((i, self.kind, item) for i, item in enumerate(value)), unit))

    def allowed(self, unit: Unit) -> str:
        """Return the names in brackets and the kind of each."""
        one = self.kind.allowed(unit)
        return f"{one}, or {self._list()}" if self.single else f"{self._list()}, each {one}"

    def schema(self) -> JsonSchema:
        """Return an array of fixed length (or one value)."""
        n = len(self.names)
        array: JsonSchema = {"type": "array", "items": self.kind.schema(), "minItems": n, "maxItems": n}
        return {"anyOf": [self.kind.schema(), array]} if self.single else array

    def _list(self) -> str:
        return "[" + ", ".join(self.names) + "]"


def each(readers: Iterable[tuple[int | str, Kind, object]], unit: Unit) -> list[Any]:
    """Read the elements of a list or table; the refusal raised carries all that is wrong, not only the first.

    Parameters
    ----------
    readers : iterable of (index or key, kind, written value)
    unit : Unit
    """
    found: list[Any] = []
    refused: list[Refusal] = []
    for step, kind, item in readers:
        try:
            found.append(kind.read(item, unit))
        except Refusal as refusal:
            refusal.within(step)
            refused += [refusal, *refusal.others]
            refusal.others = ()
    if refused:
        refused[0].others = tuple(refused[1:])
        raise refused[0]
    return found


@dataclass(frozen=True, slots=True)
class WordOr:
    """One of a few words, or a value of another kind."""

    words: tuple[str, ...]
    other: Kind

    def read(self, value: object, unit: Unit) -> Any:
        """Return the word or the other value."""
        if not isinstance(value, str) or value in self.words:
            return value if isinstance(value, str) else self._other(value, unit)
        if units.split(value) is None:  # a text that is no quantity was meant as a word
            close = get_close_matches(value.lower(), self.words, n=1, cutoff=0.5)
            hint = f'did you mean "{close[0]}"?' if close else ""
            raise Refusal("CL107", "is not a word known here", value, self.allowed(unit), hint)
        return self._other(value, unit)

    def allowed(self, unit: Unit) -> str:
        """Return the words, then what the other kind allows."""
        return " | ".join(f'"{word}"' for word in self.words) + f" | {self.other.allowed(unit)}"

    def schema(self) -> JsonSchema:
        """Return either."""
        return {"anyOf": [{"enum": list(self.words)}, self.other.schema()]}

    def _other(self, value: object, unit: Unit) -> Any:
        try:
            return self.other.read(value, unit)
        except Refusal as refusal:
            if not refusal.where:
                refusal.allowed = self.allowed(unit)
            raise


@dataclass(frozen=True, slots=True)
class Table:
    """A small inline table; `exactly_one` for one key out of several."""

    kinds: tuple[tuple[str, Kind], ...]
    required: tuple[str, ...] = ()
    exactly_one: bool = False

    def read(self, value: object, unit: Unit) -> tuple[tuple[str, Any], ...]:
        """Return (key, value) pairs in the order of `kinds`."""
        if not isinstance(value, dict):
            raise Refusal("CL104", f"is {kind_of(value)}", value, self.allowed(unit))
        known = dict(self.kinds)
        refused = [self._unknown(key, value, unit) for key in value if key not in known]
        missing = [key for key in self.required if key not in value]
        refused += [Refusal("CL103", f"lacks the key {key}", value, self.allowed(unit)) for key in missing]
        if self.exactly_one and len(value) != 1:
            refused.append(Refusal("CL112", "needs exactly one key", value, self.allowed(unit)))
        try:
            found = each(((key, kind, value[key]) for key, kind in self.kinds if key in value), unit)
        except Refusal as refusal:
            refused += [refusal, *refusal.others]
        if refused:
            refused[0].others = tuple(refused[1:])
            raise refused[0]
        return tuple(zip((key for key, _ in self.kinds if key in value), found, strict=True))

    def _unknown(self, key: str, value: object, unit: Unit) -> Refusal:
        close = get_close_matches(key, dict(self.kinds), n=1, cutoff=0.5)
        hint = f"did you mean {close[0]}?" if close else ""
        refusal = Refusal("CL102", f"has an unknown key {shown(key)}", value, self.allowed(unit), hint)
        refusal.where = (key,)
        return refusal

    def allowed(self, unit: Unit) -> str:
        """Return the table's keys with their kinds."""
        if self.exactly_one:
            return " | ".join(f"{{{key} = ...}}, {kind.allowed(unit)}" for key, kind in self.kinds)
        return "{" + ", ".join(f"{key} = ..." for key, _ in self.kinds) + "}"

    def schema(self) -> JsonSchema:
        """Return an object without other keys."""
        made: JsonSchema = {
            "type": "object",
            "properties": {key: kind.schema() for key, kind in self.kinds},
            "additionalProperties": False,
            "required": list(self.required),
        }
        return made | {"minProperties": 1, "maxProperties": 1} if self.exactly_one else made


@dataclass(frozen=True, slots=True)
class ListOf:
    """A list of any number of values of one kind, up to 1000."""

    kind: Kind
    what: Literal["texts", "tables"]

    def read(self, value: object, unit: Unit) -> tuple[Any, ...]:
        """Return the values as a tuple."""
        if not isinstance(value, list):
            raise Refusal("CL104", f"is {kind_of(value)}", value, self.allowed(unit))
        if len(value) > 1000:
            raise Refusal("CL108", f"has {len(value)} values", value, f"at most 1000 {self.what}")
        return tuple(each(((i, self.kind, item) for i, item in enumerate(value)), unit))

    def allowed(self, unit: Unit) -> str:
        """Return what the list holds."""
        return f"a list of {self.what}: [{self.kind.allowed(unit)}, ...]"

    def schema(self) -> JsonSchema:
        """Return an array."""
        return {"type": "array", "items": self.kind.schema(), "maxItems": 1000}
