"""Commented design files to start from (`clacad new`)."""

from __future__ import annotations

import re
from pathlib import Path

from clacad.base.units import LENGTHS, Unit
from clacad.config.design_error import DesignError
from clacad.config.mistakes import Mistake
from clacad.config.value_kinds import Refusal, Word, shown
from clacad.design.keys import ROOT

_FOLDER = Path(__file__).parent / "templates"


def templates() -> dict[str, str]:
    """Return the kinds of template with one line about each, in alphabetical order."""
    return {path.stem: _about(path.read_text(encoding="utf-8")) for path in sorted(_FOLDER.glob("*.toml"))}


def template(name: str, kind: str = "slab") -> str:
    """Return the text of a new design file.

    Parameters
    ----------
    name : str
        Name of the design, 1 to 80 letters, digits, spaces and - _ . , + ( ) =.
    kind : str
        A key of `templates()`: "galilean", "hexagonal", "paper", "plano", "slab", "tilted" or "window".

    Returns
    -------
    str
        TOML with comments; it loads as it stands.

    Raises
    ------
    DesignError
        For a name that a design cannot have, or an unknown kind.
    """
    nothing = Unit("m", LENGTHS["m"])
    for key, reader, value in (
        ("name", ROOT["name"].kind, name),
        ("template", Word(tuple(templates())), kind),
    ):
        try:
            reader.read(value, nothing)
        except Refusal as refusal:
            message = f"{key} = {shown(value)} {refusal.complaint}"
            raise DesignError(
                [Mistake(refusal.code, message, key, allowed=refusal.allowed, hint=refusal.hint)]
            ) from None
    text = (_FOLDER / f"{kind}.toml").read_text(encoding="utf-8")
    return text.replace('name = "NAME"', f'name = "{name}"', 1)


def _about(text: str) -> str:
    found = re.search(r"^# (.*)$", text, re.MULTILINE)
    return "" if found is None else found[1]
