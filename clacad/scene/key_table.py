"""Read one table of a file with a list of keys: values, and every mistake with its key."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from clacad.base.text import did_you_mean
from clacad.base.units import Unit
from clacad.config.mistakes import Mistake
from clacad.config.value_kinds import Refusal, kind_of, shown
from clacad.design.keys import REQUIRED, SECTIONS, Key
from clacad.scene import keys


@dataclass
class Reader:
    """Reads tables and collects mistakes.

    Parameters
    ----------
    unit : Unit
        Of bare lengths.
    """

    unit: Unit
    mistakes: list[Mistake] = field(default_factory=list)

    def table(self, where: str, table: dict[str, Any], known: dict[str, Key]) -> dict[str, Any]:
        """Return name → value, defaults included; unreadable values are left out.

        Parameters
        ----------
        where : str
            Dotted key of the table, "" for the top level.
        """
        dot = f"{where}." if where else ""
        meant = [self._unknown(dot, name, known) for name in table if name not in known]
        values: dict[str, Any] = {}
        for name, key in known.items():
            if name in table:
                try:
                    values[name] = key.kind.read(table[name], self.unit)
                except Refusal as refusal:
                    for one in (refusal, *refusal.others):
                        self.refused(dot + name, one)
            elif key.default is not REQUIRED:
                values[name] = key.default
            elif name not in meant:  # a misspelt key is one mistake, not two
                allowed = key.kind.allowed(self.unit)
                self.mistakes.append(
                    Mistake("CL103", f"missing key {dot}{name}", dot + name, allowed=allowed)
                )
        return values

    def refused(self, key: str, refusal: Refusal) -> None:
        """Record a value that its key does not accept."""
        name = key + "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in refusal.where)
        place = ".".join([key, *map(str, refusal.where)])
        value = kind_of(refusal.value) if refusal.code in ("CL102", "CL103") else shown(refusal.value)
        self.mistakes.append(Mistake(refusal.code, f"{name} = {value} {refusal.complaint}", place,
                                     found=shown(refusal.value), allowed=refusal.allowed, hint=refusal.hint))  # fmt: skip

    def _unknown(self, dot: str, name: str, known: dict[str, Key]) -> str:
        """Record an unknown key; return the key that was probably meant."""
        here = tuple(known) if dot else (*known, *keys.SECTIONS, "object")
        close = keys.nearest(name, here)
        near = dot + close if close else keys.home_of(name)
        message = f"unknown key {dot}{name}" + did_you_mean([near] if near else [], before="; ")
        if not dot and name in SECTIONS:
            message, near = f"unknown key {name}: it belongs in a design file", "sheet.set"
        elif not near and name in keys.OBJECT:
            message += ": this kind of object has none"
        self.mistakes.append(
            Mistake("CL102", message, dot + name, found=name, allowed=f"here: {', '.join(here)}", hint=near)
        )
        return close
