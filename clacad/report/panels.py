"""Places of the panels of a figure by fixed margins in inches, since finding them by drawing twice is slow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LETTER = 0.078
"""Mean width of a letter of 9 points (inches)."""


@dataclass(frozen=True)
class Margins:
    """Room about the panels of a figure and between them, inches.

    left, right, bottom, top : float
        From the figure's border to the outer panels.
    across, down : float
        Between panels side by side, and above one another.
    """

    left: float = 0.7
    right: float = 0.2
    bottom: float = 0.46
    top: float = 0.12
    across: float = 0.72
    down: float = 0.24


def panels(
    figure: Figure, rows: int = 1, columns: int = 1, margins: Margins | None = None, **options: Any
) -> Any:
    """Axes of a figure in rows and columns; one alone as such, several as an array.

    Parameters
    ----------
    figure : Figure
    rows, columns : int
    margins : Margins or None
    options
        Of `Figure.subplots`.
    """
    room = Margins() if margins is None else margins
    width, height = figure.get_size_inches()
    wide = (width - room.left - room.right - (columns - 1) * room.across) / columns
    tall = (height - room.bottom - room.top - (rows - 1) * room.down) / rows
    figure.subplots_adjust(
        room.left / width, room.bottom / height, 1.0 - room.right / width, 1.0 - room.top / height,
        room.across / wide, room.down / tall,
    )  # fmt: skip
    return figure.subplots(rows, columns, **options)


def room_for(words: list[str]) -> float:
    """Inches that the longest of some words takes next to an axis."""
    return 0.16 + LETTER * max(map(len, words), default=0)
