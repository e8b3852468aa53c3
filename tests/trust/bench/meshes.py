"""Verdict of a mesh against the light through its triangles, quads by quads."""

from __future__ import annotations

import shutil
import time
from dataclasses import dataclass
from pathlib import Path

from trust.bench import readers, tracer
from trust.bench.cases import RAYS

from clacad.design import Design
from clacad.exporting.run import export
from clacad.prescription.prescribe import prescribe
from clacad.verification import verify

QUADS = (4, 8, 16, 32, 64, 128, 256)
BANDS = {"rms": 0.02, "bias": 0.05, "eta": 0.1, "delta": 0.1, "confocality": 0.1, "throughput": 0.02}
"""Parts of a limit about it within which two samples of rays may differ; a mesh whose worst quantity lies there is left out."""


@dataclass(frozen=True)
class Row:
    """One mesh: its verdict, and the effect of its triangles on light.

    rms : radians, by the independent tracer; stated : by the package, None where it states none
    worst : the quantity that uses most of its limit; used : that part
    """

    quads: int
    word: str
    status: int
    rms: float
    stated: float | None
    worst: str
    used: float
    seconds: float

    @property
    def left_out(self) -> bool:
        """Whether it lies so near a limit that the choice of rays decides."""
        return abs(self.used - 1.0) <= BANDS[self.worst]

    @property
    def agrees(self) -> bool:
        """Whether it is called a master where its light keeps every limit, and a shape, no more, where not."""
        right = "passed as optical master" if self.used <= 1.0 else "shape only"
        return self.left_out or (self.word == right and self.status == int(self.used > 1.0))


def judged(design: Design, quads: int, folder: Path) -> Row:
    """Export a bare STL, trace its triangles, and get the verdict on it."""
    made = export(design, folder, formats=("stl",), quads=quads, force=True)
    path = made.path("stl-binary")
    (folder / "manifest.json").unlink()
    found = tracer.measure(
        tracer.optics(design, prescribe(design)), readers.triangles(path.name, path.read_bytes())
    )
    began = time.process_time()
    report = verify(design, path, rays=RAYS)
    seconds = time.process_time() - began
    shutil.rmtree(folder)
    said = next((c.detail.get("by_cell") for c in report.checks if c.id == "file_law_rms"), None)
    used = found.used()
    worst = max(used, key=lambda name: used[name])
    stated = None if said is None else float(said[0])  # of the middle cell, as here
    return Row(quads, report.word, report.exit_status, found.rms, stated, worst, used[worst], seconds)
