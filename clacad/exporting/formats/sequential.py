"""Prescriptions of one telescopelet for lens-design programs: Zemax and optiland."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clacad.exporting.formats.format import BASE, FileKind, Forecast, Format
from clacad.exporting.roles import ONE_TELESCOPELET

if TYPE_CHECKING:
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.exporting.tessellations import Meshes
    from clacad.sheet.window import Window
    from clacad.storage.worker import Worker

ZMX, OPTILAND = "zmx", "optiland"

TIMEOUT = 600.0
"""Time limit (s) of the process that loads optiland and traces a few rays."""

ZMX_SECONDS, OPTILAND_SECONDS = BASE + 0.03, BASE + 6.0
"""Seconds to write one telescopelet as text and trace it; optiland is slow to load and to compile."""


# -- writing ---------------------------------------------------------------------------------------


def _write_zmx(job: Job) -> list[FileRecord]:
    from clacad.formats.sequential.stations import left_out
    from clacad.formats.sequential.zmx import check_zmx, write_zmx

    path = job.stage.path(f"{job.stem}.zmx")
    write_zmx(job.window, path)
    check_zmx(job.window, path)
    facts = {"mode": "cell", "left_out": left_out(job.window)}
    return [job.record(path, ZMX, facts=facts, checks=("light",))]


def _write_optiland(job: Job) -> list[FileRecord]:
    """Write the optiland file; optiland reads it back and traces it in a separate process."""
    import numpy as np

    from clacad.formats.sequential import optiland_json

    path = job.stage.path(f"{job.stem}.optiland.json")
    told = optiland_json.write_optiland(job.window, path)["clacad"]
    job.progress(f"read back {path.name}", 0.5)
    start, direction = (rows.tolist() for rows in optiland_json.rays_for(job.window))
    found = job.worker.run(
        f"{optiland_json.__name__}:optiland_directions", str(path), start, direction, timeout=TIMEOUT
    )
    optiland_json.check_optiland(job.window, path.name, np.array(found, dtype=np.float64))
    series = [told["faces"]] if told["largest_slope_error"] else []
    facts = {"mode": "cell", "left_out": [*told["left_out"], *series]}
    return [job.record(path, OPTILAND, facts=facts, checks=("light",))]


# -- requirements ----------------------------------------------------------------------------------


def _require_zmx(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require faces that Zemax surfaces can hold."""
    from clacad.formats.sequential.zmx import zmx_lines

    for _ in zmx_lines(window):
        pass


def _require_optiland(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require optiland, which reads the file back, and faces that its surfaces can hold."""
    from clacad.formats.sequential import optiland_json

    optiland_json.require_optiland()
    optiland_json.optiland_document(window)


# -- cost ------------------------------------------------------------------------------------------


def _forecast_zmx(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    """Forecast the Zemax file, generated in full."""
    from clacad.formats.sequential.zmx import zmx_lines

    size = sum(len(line) + 2 for line in zmx_lines(meshes.window))
    return Forecast(ZMX, size, True, None, None, ZMX_SECONDS, (80_000_000, 200_000_000))


def _forecast_optiland(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    """Forecast the optiland file, generated in full; 0 bytes for a telescopelet that it cannot hold."""
    import json

    from clacad.formats.sequential.optiland_json import optiland_document
    from clacad.storage.errors import ExportError

    try:
        size = len(json.dumps(optiland_document(meshes.window), indent=1).encode()) + 1
    except ExportError:  # reported at writing, so that the other formats are still made
        size = 0
    memory = (400_000_000, 2_000_000_000)
    return Forecast(OPTILAND, size, False, None, None, OPTILAND_SECONDS, memory)


FORMATS = (
    Format(
        ZMX,
        "prescription",
        "one telescopelet as a sequential prescription for Zemax",
        _write_zmx,
        _forecast_zmx,
        lambda _sheet, _quads, _asked: ZMX_SECONDS,
        _require_zmx,
        optical=False,
        of_cell=True,
        stored=(ONE_TELESCOPELET,),
    ),
    Format(
        OPTILAND,
        "prescription",
        "one telescopelet as a sequential prescription for optiland; needs the extra optiland",
        _write_optiland,
        _forecast_optiland,
        lambda _sheet, _quads, _asked: OPTILAND_SECONDS,
        _require_optiland,
        optical=False,
        of_cell=True,
        stored=(ONE_TELESCOPELET,),
    ),
)

FILES = (FileKind(ZMX, "other", readings="clacad.exporting.formats.map_reading"), FileKind(OPTILAND, "other"))
