"""Mistakes of a design, formatted like a compiler's messages.

A `Mistake` is one finding with its position. Codes are stable words for programs: `CODES` lists those of
mistakes of a design file.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from clacad.base.text import printable

CODES: dict[str, str] = {
    "CL100": "the file cannot be read",
    "CL101": "the text is not TOML (or JSON)",
    "CL102": "unknown key",
    "CL103": "missing key",
    "CL104": "wrong kind of value",
    "CL105": "wrong or unknown unit",
    "CL106": "number out of range",
    "CL107": "not one of the allowed words",
    "CL108": "wrong number of values in a list",
    "CL109": "unknown file format version",
    "CL110": "eta that no pair of lenses has",
    "CL111": "eta = 1 with an offset",
    "CL112": "keys that exclude each other",
    "CL113": "key that needs another key",
    "CL114": "key that does not belong to this form",
    "CL115": "pitch below the wavelength",
    "CL116": "lattice and pitch disagree",
    "CL117": "seam, web or outline that leaves no lens",
    "CL118": "override that cannot be applied",
    "CL119": "unknown material, or its index table does not reach the wavelength",
    "CL120": "a pair that cannot be built",
    "CL121": "something that an aimed sheet cannot have",
    "CL122": "a viewer too near to aim at",
    "CL123": "a lens of an aimed sheet used too far from its vertex",
    "CL124": "a table of cells that cannot be read",
    "CL125": "a non-uniform sheet with a feature that cannot be combined with it",
    "CL126": "a field lens for a pair without a real common focus",
    "CL127": "a field lens in a form, lattice or tilt that it is not made for",
    "CL128": "a field lens too steep for its cell",
    "CL129": "field faces without room between them",
    "CL141": "outline, corner, hole or pin that makes no plate",
}
"""Meaning of each stable code of a design mistake."""

WIDTH = 110
"""Greatest length of a displayed piece of a source line, in characters."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """One fault and its position.

    Parameters
    ----------
    code : str
        Stable code, a key of `CODES`.
    message : str
        The fault, in one line.
    key : str
        Dotted path of the key, "" for the file as a whole.
    path : str
        File name as given by the user, "--set" for an override, "" for a dictionary.
    line, column : int or None
        Position in the file, both from 1, in characters.
    width : int
        Number of characters the caret line marks.
    found, allowed, hint : str
        Value found, values allowed, the nearest way out (for an unknown key: the key probably
        meant); "" where there is none.
    source_line : str
        The line of the file (or the override) with the mistake.
    """

    code: str
    message: str
    key: str = ""
    path: str = ""
    line: int | None = None
    column: int | None = None
    width: int = 1
    found: str = ""
    allowed: str = ""
    hint: str = ""
    source_line: str = ""

    def __str__(self) -> str:
        """Return the finding as a compiler would print it, with a caret line where the position is known."""
        lines = [f"{self._where()}error {self.code}: {self.message}", *self._excerpt()]
        for word, text in (("found", self.found), ("allowed", self.allowed), ("hint", self.hint)):
            if text and not (word != "allowed" and text in self.message):  # do not repeat the message
                lines.append(f"  {word}: {text}")
        return "\n".join(map(printable, lines))

    def _where(self) -> str:
        if self.path == "--set":
            return f"--set {self.source_line}: "
        place = [self.path] if self.path else []
        if self.path and self.line is not None:
            place += [str(number) for number in (self.line, self.column) if number is not None]
        return ":".join(place) + ": " if place else ""

    def _excerpt(self) -> list[str]:
        if not self.source_line or self.column is None or (self.line is None and self.path != "--set"):
            return []
        start = max(0, self.column - 1 - WIDTH // 2) if len(self.source_line) > WIDTH else 0
        shown = self.source_line[start : start + WIDTH]
        caret = " " * (self.column - 1 - start) + "^" * max(1, min(self.width, WIDTH // 2))
        number = "" if self.line is None else str(self.line)
        return [f"  {number} | {shown}".rstrip(), f"  {' ' * len(number)} | {caret}"]


def in_order(mistakes: Iterable[Mistake]) -> list[Mistake]:
    """Return the mistakes sorted by position, then key; those without a position last; no duplicates."""
    unique = dict.fromkeys(mistakes)
    return sorted(unique, key=lambda m: (m.path == "--set", m.line or 10**9, m.column or 0, m.key, m.code))
