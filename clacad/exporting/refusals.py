"""Refusals of an export before its first byte, with the reasons of all formats together.

Each format checks its own requirements: an installed extra, a gap, a border, room for a line of text. Limits
of size, and bodies that cannot be built, are found by the forecast and collected here too.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from clacad.exporting.formats.registry import format_of, formats
from clacad.sheet.need_window import need_equal_cells
from clacad.sheet.volume_and_extent import NoFixture
from clacad.storage.errors import BadRequest, ExportError, NotPossible

if TYPE_CHECKING:
    from clacad.exporting.request import Request
    from clacad.sheet.window import Window
    from clacad.storage.worker import Worker


class Refusals:
    """Refusals of formats, collected until all formats have been checked."""

    def __init__(self) -> None:
        self._found: dict[str, Exception] = {}

    def __contains__(self, format: object) -> bool:
        return format in self._found

    def __bool__(self) -> bool:
        return bool(self._found)

    @contextmanager
    def of(self, *formats: str) -> Iterator[None]:
        """Keep a refusal raised in the block as that of some formats; program errors propagate."""
        try:
            yield
        except (ExportError, ValueError) as error:
            if getattr(error, "exit_status", None) is None:
                raise
            refusal = NotPossible(str(error)) if isinstance(error, NoFixture) else error
            self._found |= dict.fromkeys(formats, refusal)

    def complete(self) -> None:
        """Refuse the export if any format was.

        Raises
        ------
        ExportError, ValueError
            The refusal, if there is only one; else their common type, or `NotPossible`, with all of them.
        """
        by_text: dict[str, list[str]] = {}
        for name, error in self._found.items():
            by_text.setdefault(str(error), []).append(name)
        if not by_text:
            return
        errors = list(self._found.values())
        if len(by_text) == 1:
            raise errors[0]
        kinds = {type(error) for error in errors}
        kind = kinds.pop() if len(kinds) == 1 and issubclass(type(errors[0]), ExportError) else NotPossible
        raise kind("\n".join(_line(names, text) for text, names in by_text.items()))


def _line(formats: list[str], text: str) -> str:
    """Text of a refusal, prefixed with its formats unless it already begins with them."""
    named = ", ".join(formats)
    return text if text.startswith((f"{named}:", f"format {named}")) else f"{named}: {text}"


def refuse_other_cells(window: Window, word: str) -> None:
    """Refuse a format that cannot hold the cells of a non-uniform sheet.

    Raises
    ------
    CellsDiffer
    """
    if not format_of(word).holds(window):
        held = sorted((one for one in formats() if one.holds(window)), key=lambda one: one.family != "exact")
        listed = ", ".join(one.word for one in held)
        need_equal_cells(window, f"format {word}", f"such sheets are held by: {listed}")


def require_possible(window: Window, word: str, asked: Request, worker: Worker) -> None:
    """Refuse a format that is impossible for a design; only long text in a small space needs the worker.

    Raises
    ------
    NotPossible, NoFixture, LimitRefused, CannotBuild
    CellsDiffer
        The format holds uniform sheets only.
    WorkerDied
        The letters could not be drawn.
    """
    refuse_other_cells(window, word)
    format_of(word).require(window, asked, worker)


def refuse_idle_fused(asked: Request) -> None:
    """Refuse the option `fused` where no requested format has it.

    Raises
    ------
    BadRequest
    """
    fusable = [one.word for one in formats() if one.fusable]
    if asked.fused and set(asked.formats) <= {one.word for one in formats() if not one.fusable}:
        raise BadRequest(
            f"fused: it applies to {', '.join(fusable)}, and the requested formats are"
            f" {', '.join(asked.formats)}; leave it out"
        )
