"""Records and cost that height maps, points, tables and masks have in common."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from clacad.exporting.formats.format import BASE, FileKind, Forecast
from clacad.storage.atomic import canonical_json

if TYPE_CHECKING:
    from clacad.exporting.job import Job
    from clacad.exporting.manifest import FileRecord
    from clacad.exporting.request import Request
    from clacad.exporting.rough_sizes import RoughSheet

CALIBRATION = "height-calibration"
"""Word in manifests of the file that gives the heights of levels or layers."""

MEMORY = (100_000_000, 400_000_000)

PER_FACE = 0.015
"""Seconds per face of files whose size does not depend on the number of cells."""


def calibration_record(job: Job, word: str, faces: Mapping[str, Any]) -> FileRecord:
    """Write one calibration file for the faces of a format."""
    path = job.stage.path(f"{job.stem}.{word}.json")
    text = canonical_json({"format": 1, "unit": "mm", "faces": faces})
    path.write_text(text, encoding="utf-8", newline="\n")
    return job.record(path, CALIBRATION)


def map_row(word: str, size: int, seconds: float, more_memory: int = 0, note: str = "") -> Forecast:
    """Forecast files from their bytes and seconds."""
    memory = (MEMORY[0], MEMORY[1] + more_memory)
    return Forecast(word, size, False, None, None, seconds, memory, note=note)


def map_kind(word: str, *ends: str, native: bool = False) -> FileKind:
    """Kind of a file that `map_reading` compares with the design."""
    return FileKind(word, "map", ends, native=native, readings="clacad.exporting.formats.map_reading")


def structured_cost(faces: int) -> float:
    """Seconds of files whose size does not depend on the number of cells."""
    return BASE + PER_FACE * faces


def drawn_cost(each: float) -> Callable[[RoughSheet, int, Request], float]:
    """Seconds from the design's numbers, of files with a hundred items a cell; `each`: seconds per item."""

    def seconds(sheet: RoughSheet, _quads: int, _asked: Request) -> float:
        return BASE + each * (100 * sheet.cells * sheet.bodies)

    return seconds
