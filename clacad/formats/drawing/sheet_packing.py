"""Boxes on sheets of paper: rows of columns, spread over the sheet, around a title block in the lower right corner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

Size = tuple[float, float]
Box = tuple[float, float, float, float]
"""Left, top, right, bottom."""


@dataclass(frozen=True, slots=True)
class Area:
    """Room for boxes, mm: its size, that of the corner at its lower right that is taken, and the least gap."""

    size: Size
    corner: Size
    gap: float


@dataclass(slots=True)
class _Column:
    """Boxes under one another: their numbers, the greatest width, the heights with a gap between each two."""

    numbers: list[int]
    width: float
    height: float


@dataclass(slots=True)
class _Row:
    """Columns next to one another, none higher than the first."""

    columns: list[_Column]
    height: float

    def width(self, gap: float) -> float:
        """Of all columns with the gaps between them."""
        return sum(column.width for column in self.columns) + gap * (len(self.columns) - 1)


def pack(sizes: Sequence[Size], order: Sequence[int], area: Area) -> dict[int, Box] | None:
    """Boxes of one sheet by their numbers, taken in an order; None where they do not fit."""
    rows: list[_Row] = []
    for number in order:
        if not any(_join(row, number, sizes, area) for row in rows):
            width, height = sizes[number]
            rows.append(_Row([_Column([number], width, height)], height))
    return _spread(rows, sizes, area)


def _join(row: _Row, number: int, sizes: Sequence[Size], area: Area) -> bool:
    """Put a box under others of a row, or next to them, where it fits."""
    width, height = sizes[number]
    spare = area.size[0] - row.width(area.gap)
    for column in row.columns:
        if column.height + area.gap + height <= row.height and width - column.width <= spare:
            column.numbers.append(number)
            column.height += area.gap + height
            column.width = max(column.width, width)
            return True
    if height <= row.height and width + area.gap <= spare:
        row.columns.append(_Column([number], width, height))
        return True
    return False


def _spread(rows: Sequence[_Row], sizes: Sequence[Size], area: Area) -> dict[int, Box] | None:
    """Share the room that is left among rows, columns and boxes; the last rows end next to the corner, or above it."""
    (wide, tall), (taken, low) = area.size, area.corner
    used = sum(row.height for row in rows) + area.gap * (len(rows) - 1)
    for bottom in (tall, tall - low - area.gap):
        if used > bottom + 1e-9:
            return None
        between = area.gap + (bottom - used) / max(1, len(rows) - 1)
        y, placed, fits = 0.0, dict[int, Box](), True
        for row in rows:
            room = wide if y + row.height <= tall - low - area.gap + 1e-9 else wide - taken - area.gap
            fits = fits and row.width(area.gap) <= room + 1e-9
            placed.update(_row_boxes(row, y, room, sizes))
            y += row.height + between
        if fits:
            return placed
    return None


def _row_boxes(row: _Row, y: float, room: float, sizes: Sequence[Size]) -> dict[int, Box]:
    """Columns spread over the width, the first at the left; boxes of a column spread over the height of the row."""
    count = len(row.columns)
    spare = room - sum(column.width for column in row.columns)
    step, x = (spare / (count - 1), 0.0) if count > 1 else (0.0, 0.5 * spare)
    placed = {}
    for column in row.columns:
        heights = [sizes[number][1] for number in column.numbers]
        apart = (row.height - sum(heights)) / (len(heights) - 1) if len(heights) > 1 else 0.0
        top = y
        for number, height in zip(column.numbers, heights, strict=True):
            placed[number] = (x, top, x + sizes[number][0], top + height)
            top += height + apart
        x += column.width + step
    return placed


def largest_empty(size: Size, boxes: Sequence[Box]) -> float:
    """Area of the largest upright rectangle that no box enters, in a rectangle of a given size."""
    wide, tall = size
    edges = sorted({0.0, wide, *(box[0] for box in boxes), *(box[2] for box in boxes)})
    largest = 0.0
    for left, right in combinations([edge for edge in edges if 0.0 <= edge <= wide], 2):
        if (right - left) * tall <= largest:
            continue
        low = highest = 0.0
        for top, bottom in sorted((box[1], box[3]) for box in boxes if box[0] < right and box[2] > left):
            highest = max(highest, top - low)
            low = max(low, bottom)
        largest = max(largest, (right - left) * max(highest, tall - low))
    return largest
