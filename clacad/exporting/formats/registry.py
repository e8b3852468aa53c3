"""The file formats by their words, in the order in which messages and tables list them.

To add a format, write its module with a tuple `FORMATS` and name the module here.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from clacad.base.text import did_you_mean, near
from clacad.storage.errors import UnknownFormat

if TYPE_CHECKING:
    from clacad.exporting.formats.format import Format

MODULES = (
    "step", "stl", "indexed_meshes", "height_maps", "table", "masks", "pov", "parts", "engraved_meshes",
    "sequential", "drawing",
)  # fmt: skip


@cache
def _declared(modules: tuple[str, ...]) -> dict[str, Format]:
    """Formats of some modules by their words; a module is imported on first use."""
    found: dict[str, Format] = {}
    for name in modules:
        found |= {one.word: one for one in import_module(f"clacad.exporting.formats.{name}").FORMATS}
    return found


def formats() -> tuple[Format, ...]:
    """All formats."""
    return tuple(_declared(MODULES).values())


def words() -> tuple[str, ...]:
    """Words of all formats."""
    return tuple(_declared(MODULES))


def format_of(word: str) -> Format:
    """Format of a word.

    Raises
    ------
    UnknownFormat
    """
    return _declared(MODULES)[known((word,))[0]]


def known(asked: Sequence[str]) -> tuple[str, ...]:
    """Requested words without duplicates, in the order requested.

    Raises
    ------
    UnknownFormat
        A word is unknown; the message gives the nearest word and the list.
    """
    all_words = words()
    unknown = [word for word in asked if word not in all_words]
    if unknown or not asked:
        hint = did_you_mean(near(unknown[0], all_words), before="; ") if unknown else ""
        what = f"unknown format {unknown[0]!r}{hint}" if unknown else "no format was asked for"
        raise UnknownFormat(f"{what}\n  allowed: {', '.join(all_words)}")
    return tuple(dict.fromkeys(asked))
