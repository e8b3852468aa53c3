"""Kinds of value of design keys: each reads one value, describes what it allows, and has a JSON Schema.

A kind is a frozen dataclass with four methods. `read(value, unit)` returns the converted value or raises
`Refusal`; `write(value, unit)` returns the value as a file's data; `allowed(unit)` returns the text for
messages; `schema()` returns the JSON Schema.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
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
