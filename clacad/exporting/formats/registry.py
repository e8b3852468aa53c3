"""The file formats by their words, in the order of messages and tables; workers that read them.

To add a format, write its module with the tuples `FORMATS` and `FILES` and name the module here.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from clacad.base.text import did_you_mean, near
from clacad.storage.errors import UnknownFormat

if TYPE_CHECKING:
    from pathlib import Path

    from clacad.exporting.formats.format import FileKind, Format
    from clacad.storage.reading import Spending
    from clacad.storage.worker import Worker

MODULES = (
    "step",
    "indexed_meshes",
    "height_maps",
    "pov",
    "parts",
    "sequential",
    "workshop",
    "drawing",
)


@cache
def _declared(modules: tuple[str, ...]) -> tuple[dict[str, Format], dict[str, FileKind]]:
    """Formats and kinds of files of some modules by their words; the modules are imported on first use."""
    loaded = [import_module(f"clacad.exporting.formats.{name}") for name in modules]
    formats = {one.word: one for module in loaded for one in module.FORMATS}
    return formats, {kind.word: kind for module in loaded for kind in module.FILES}


def formats() -> tuple[Format, ...]:
    """All formats."""
    return tuple(_declared(MODULES)[0].values())


def words() -> tuple[str, ...]:
    """Words of all formats."""
    return tuple(_declared(MODULES)[0])


def format_of(word: str) -> Format:
    """Format of a word. Raises UnknownFormat."""
    return _declared(MODULES)[0][known((word,))[0]]


def known(asked: Sequence[str]) -> tuple[str, ...]:
    """Requested words without duplicates, in the order requested.

    Raises UnknownFormat: A word is unknown; the message gives the nearest word and the list.
    """
    all_words = words()
    unknown = [word for word in asked if word not in all_words]
    if unknown or not asked:
        hint = did_you_mean(near(unknown[0], all_words), before="; ") if unknown else ""
        what = f"unknown format {unknown[0]!r}{hint}" if unknown else "no format was requested"
        raise UnknownFormat(f"{what}\n  allowed: {', '.join(all_words)}")
    return tuple(dict.fromkeys(asked))


# -- kinds of files --------------------------------------------------------------------------------


def kinds() -> tuple[FileKind, ...]:
    """All kinds of files."""
    return tuple(_declared(MODULES)[1].values())


def kind_of(word: str) -> FileKind | None:
    """Kind of files of a manifest's word, or of an older word for it; None for an unknown word."""
    found = _declared(MODULES)[1].get(word)
    return found or next((kind for kind in kinds() if kind.older and word.startswith(kind.word)), None)


def kind_ending(name: str) -> FileKind | None:
    """Kind of files whose names end as a name does; None for an unknown ending."""
    return next((kind for kind in kinds() if kind.ends and name.lower().endswith(kind.ends)), None)


def without_optics(word: str) -> bool:
    """Whether files of a format or kind carry no light of the law, or no part is made from them."""
    kind = _declared(MODULES)[1].get(word)
    return (kind is not None and kind.family == "other") or any(
        one.word == word and not one.optical for one in formats()
    )


# -- reading of an untrusted file by a native library ---------------------------------------------


def reading_worker(path: Path) -> Worker:
    """Start a worker that may read one STEP, BREP or GDSII file and trace light through its faces.

    Raises OverBudget: The file is larger than the reader accepts.
    Raises OSError: The file does not exist.
    """
    from clacad.storage.worker import limited_worker

    return limited_worker(_spending(path))


def longest_wait(path: Path) -> float:
    """Seconds after which a worker that has not answered is ended."""
    from clacad.storage.worker import longest_wait

    return longest_wait(_spending(path))


def _spending(path: Path) -> Spending:
    """Budget of a file, a separate one where only its text is read."""
    from clacad.base.untrusted_files import BUDGETS
    from clacad.storage.reading import Spending

    size = path.stat().st_size
    kind = kind_ending(path.suffix)
    if kind is None or not kind.native:
        kind = next(one for one in kinds() if one.text_budget)
    by_text = kind.text_budget and size > BUDGETS["step"].bytes
    return Spending(kind.text_budget if by_text else kind.word, path, size)
