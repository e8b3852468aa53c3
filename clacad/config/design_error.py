"""Error of a design that is refused: every mistake at once, each with its position."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from clacad.config.key_positions import located
from clacad.config.mistakes import Mistake


class FromText(Protocol):
    """An object read from a text, such as a `Design`: the text or None, and the name of its file or ""."""

    @property
    def source(self) -> str | None:
        """Text that the object was read from, None where there is none."""

    @property
    def path(self) -> str:
        """Name of the file as given by the user, "" without a file."""


class DesignError(ValueError):
    """A design is refused; holds every mistake that was found.

    Parameters
    ----------
    mistakes : iterable of Mistake
        At least one.
    """

    exit_status = 2

    def __init__(self, mistakes: Iterable[Mistake]) -> None:
        self.mistakes: tuple[Mistake, ...] = tuple(mistakes)
        super().__init__(self.mistakes)

    def __str__(self) -> str:
        """Return all mistakes, one block each, in the order of their positions."""
        blocks = [str(mistake) for mistake in self.mistakes]
        if len(blocks) > 1:
            blocks.append(f"{len(blocks)} mistakes")
        return "\n".join(blocks)

    @classmethod
    def at(
        cls,
        design: FromText,
        key: str,
        message: str,
        *,
        code: str = "CL120",
        found: str = "",
        allowed: str = "",
        hint: str = "",
    ) -> DesignError:
        """Refuse a design for a reason found after reading, at the position of one of its keys.

        Parameters
        ----------
        design : Design
            The refused design; its file text gives line and column.
        key : str
            Dotted key at fault, such as "pair.thickness".
        message : str
            The fault, with the computed numbers.
        code, found, allowed, hint : str
            As for `Mistake`.

        Returns
        -------
        DesignError
            Error with one mistake, for the caller to raise.
        """
        mistake = Mistake(code, message, key=key, found=found, allowed=allowed, hint=hint)
        return cls(located([mistake], design.source, design.path, ()))


class DesignTooLarge(DesignError):
    """A design or scene file is refused because it exceeds the size limit, regardless of its content."""

    exit_status = 3
