"""Inputs that every format needs to write its files, and the record of a written file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.types import Progress
from clacad.base.units import millimetres
from clacad.exporting.manifest import FileRecord
from clacad.exporting.request import Request
from clacad.sheet.volume_and_extent import Integral, body_volume
from clacad.sheet.window import Window
from clacad.storage.atomic import Stage, file_hash
from clacad.storage.staging import flush
from clacad.storage.worker import Worker

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.exporting.tessellations import Tessellation
    from clacad.storage.reading import Overheard


@dataclass(frozen=True, eq=False)
class Job:
    """Inputs of every format: the window, the folder, the meshes, the worker.

    Parameters
    ----------
    window : Window
    stem : str
        First part of every file name.
    stage : Stage
    tessellation : Tessellation
    worker : Worker
    request : Request
        Options of the export.
    progress : callable
    design : Design
        Design as requested; the window has the cells that are written.
    """

    window: Window
    stem: str
    stage: Stage
    tessellation: Tessellation
    worker: Worker
    request: Request
    progress: Progress
    design: Design

    @property
    def scale(self) -> float:
        """Millimetres per design unit."""
        return millimetres(self.window.unit)

    @cached_property
    def integrals(self) -> dict[str, Integral | None]:
        """Exact volume of each body by name, design units cubed."""
        return {body.name: body_volume(self.window, body) for body in self.window.bodies}

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of all bodies."""
        return tuple(body.name for body in self.window.bodies)

    def record(
        self,
        path: Path,
        format: str,
        unit: str = "mm",
        bodies: Sequence[str] | None = None,
        facts: Mapping[str, Any] | None = None,
        checks: tuple[str, ...] = ("shape",),
        heard: Overheard | None = None,
    ) -> FileRecord:
        """Describe a file that was written and passed its checks; `heard`: its hash from reading it back."""
        flush(path)
        whose = self.bodies if bodies is None else tuple(bodies)
        digest = file_hash(path) if heard is None else heard.hexdigest()
        return FileRecord(path.name, digest, path.stat().st_size, format, unit, whose, facts or {}, checks)
