"""Text of an untrusted DXF file: its header and the entities of model space, within a budget, every fault
named.

No library is used: only lines, arcs and polylines are needed, and an untrusted file should reach as little
code as possible.
"""

from __future__ import annotations

import math
import os
from errno import EFBIG
from fractions import Fraction
from typing import Final

from clacad.base import units
from clacad.base.text import whole_number
from clacad.base.untrusted_files import BUDGETS, read_regular
from clacad.config.mistakes import Mistake
from clacad.config.value_kinds import shown

UNITS: Final = {1: "in", 4: "mm", 5: "cm", 6: "m", 12: "nm", 13: "um"}
"""$INSUNITS → unit of length."""

KEY: Final = "lattice.outline.dxf"


class TooMuch(Exception):
    """A drawing exceeds the reader's budget."""

    def __init__(self, message: str, allowed: str) -> None:
        super().__init__(message)
        self.mistake = Mistake("CL100", message, KEY, allowed=allowed)


class Unfit(ValueError):
    """A fault of a drawing: code, message, allowed values, hint."""

    def __init__(self, code: str, message: str, allowed: str = "", hint: str = "") -> None:
        super().__init__(message)
        self.mistake = Mistake(code, message, KEY, allowed=allowed, hint=hint)


def text_lines(folder: str, name: str) -> list[str]:
    """Lines of the file."""
    why = "is not a relative path" if os.path.isabs(name) or "\0" in name or name[1:2] == ":" else ""
    if not why:
        home, real = os.path.realpath(folder), os.path.realpath(os.path.join(folder, name))
        if os.path.commonpath([home, real]) != home:  # links are resolved first, so that none leads out
            why = "lies outside the design's folder"
    if why:
        raise Unfit(
            "CL100", f"the drawing {shown(name)} {why}", "a DXF file in the design's folder or below it"
        )
    budget = BUDGETS["outline"]
    try:
        raw = read_regular(os.path.join(folder, name), budget.bytes)
    except OSError as problem:
        if problem.errno == EFBIG:
            raise TooMuch(f"{name}: too large for an outline", f"up to {budget.bytes:,} bytes") from None
        reason = (problem.strerror or str(problem)).lower()
        raise Unfit("CL100", f"cannot read the drawing {shown(name)}: {reason}") from None
    if raw.startswith(b"AutoCAD Binary DXF"):
        raise Unfit(
            "CL100", f"{name} is a binary DXF file", "DXF as text", "save it as ASCII DXF (R12 or later)"
        )
    lines = raw.decode("utf-8", "replace").splitlines()
    if len(lines) > (budget.items or 0):
        raise TooMuch(f"{name}: {len(lines):,} lines are too many for an outline", f"up to {budget.items:,}")
    return lines


Pair = tuple[int, str, int]
"""Group code, value, line."""

LARGEST_CODE = 10_000
"""Limit above every group code of DXF."""


def group_pairs(lines: list[str], name: str) -> list[Pair]:
    """Group codes and values."""
    found: list[Pair] = []
    for n in range(0, len(lines) - 1, 2):
        code = whole_number(lines[n].strip(), signed=True)
        if code is None or not -5 <= code < LARGEST_CODE:
            said = shown(lines[n].strip()[:20])
            raise Unfit("CL100", f"{name}, line {n + 1}: {said} is not a group code of DXF")
        found.append((code, lines[n + 1].strip(), n + 2))
    if not found or found[-1][:2] != (0, "EOF"):
        raise Unfit("CL100", f"{name}: cut short, or no DXF file: it does not end with EOF")
    return found


class Entity:
    """One entity: its kind, its line in the file, its values in order."""

    def __init__(self, kind: str, line: int) -> None:
        self.kind, self.line = kind, line
        self.values: list[Pair] = []
        self.corners: list[Entity] = []

    @property
    def layer(self) -> str:
        """Its layer, "0" if it names none."""
        return next((value for code, value, _ in self.values if code == 8), "0")

    def number(self, code: int, name: str, default: float | None = None) -> float:
        """The number under a code.

        Raises
        ------
        Unfit
            There is no such code, or its value is no finite number.
        """
        for at, value, line in self.values:
            if at == code:
                return finite_number(value, line, name)
        if default is None:
            raise Unfit("CL100", f"{name}, line {self.line}: {self.kind} without group {code}")
        return default

    def flags(self, name: str) -> int:
        """Group 70."""
        return int(self.number(70, name, 0.0))


def finite_number(value: str, line: int, name: str) -> float:
    """Read a number of at most 1e30 in size; refuse anything else with the file's name and the line."""
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not abs(number) <= 1e30:
        raise Unfit("CL100", f"{name}, line {line}: {shown(value[:20])} is not a number from -1e30 to 1e30")
    return number


def sections(pairs: list[Pair], name: str) -> tuple[dict[str, str], list[Entity]]:
    """Variables of the header, and the entities of model space."""
    header: dict[str, str] = {}
    entities: list[Entity] = []
    section, variable, latest = "", "", ""
    current: Entity | None = None
    for code, value, line in pairs:
        if code == 0:
            if value in ("SECTION", "ENDSEC", "EOF"):
                section = ""
            elif section == "ENTITIES":
                entity = Entity(value, line)
                if value == "VERTEX" and entities and entities[-1].kind == "POLYLINE":
                    entities[-1].corners.append(entity)
                elif value != "SEQEND":
                    entities.append(entity)
                current = entity
            latest = value
        elif code == 2 and latest == "SECTION" and not section:
            section = value
        elif section == "HEADER":
            if code == 9:
                variable = value
            else:
                header.setdefault(variable, value)
        elif section == "ENTITIES" and current is not None:
            current.values.append((code, value, line))
    if not entities:
        raise Unfit("CL100", f"{name}: no entities are drawn in it")
    paper = [one for one in entities if (67, "1") in {(code, value) for code, value, _ in one.values}]
    return header, [one for one in entities if one not in paper] if paper else entities


def unit_factor(header: dict[str, str], unit: Fraction, name: str) -> Fraction:
    """Design units per unit of the drawing."""
    said = header.get("$INSUNITS", "0")
    words = " | ".join(f"{code} ({word})" for code, word in UNITS.items())
    code = whole_number(said)
    if code not in UNITS:
        why = (
            "states no unit"
            if said in ("0", "")
            else f"has $INSUNITS = {shown(said[:20])}, which is not read"
        )
        raise Unfit(
            "CL105",
            f"{name} {why}",
            f"$INSUNITS = {words}",
            "set the unit of the drawing to millimetres, say",
        )
    return units.LENGTHS[UNITS[code]] / unit
