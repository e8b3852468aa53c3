"""STEP through the worker: write, read back with OCC, compare with the design."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil, floor, log10
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.units import millimetres
from clacad.exporting.manifest import FileRecord
from clacad.sheet.volume_and_extent import Integral, volume_sum, whole_extent
from clacad.sheet.window import Window
from clacad.storage.errors import FileDisagrees

if TYPE_CHECKING:
    from clacad.exporting.manifest import Job
    from clacad.formats.step.lens_placements import SheetPlace
    from clacad.formats.step.part21 import Mode
    from clacad.formats.step.step_files import Schema

SHAPE_LIMIT = 1e-7
"""Largest distance of a written lens face from the closed form, in pitches."""
VOLUME_LIMIT = 1e-9
"""Largest relative difference of volumes beyond what merged steps explain."""
FITTED = 1e-7
"""Fit error of parameter curves that a file omits and OCC recomputes: OCC's least tolerance (mm)."""
TOLERANCE = 3e-7
"""Gaps that OCC finds between exact edges and faces (mm), with its least tolerance of 1e-7 mm."""
SECONDS = 3600.0


def step_record(job: Job, word: str) -> FileRecord:
    """Write the STEP file of a job, read it back and compare; `word`: its format in manifests.

    Raises WorkerDied: OCC crashed, or ran out of memory or time.
    Raises FileDisagrees: The file differs from the design.
    """
    name = f"{job.stem}.step"
    path = job.stage.path(name)
    job.progress(f"write {name}", 0.0)
    run = job.worker.run
    written = run(
        "clacad.exporting.step_record:write",
        job.window,
        str(path),
        job.request.step,
        job.request.step_schema.upper(),
        job.request.pcurves,
        timeout=SECONDS,
        progress=job.progress,
    )
    job.progress(f"read back {name}", 0.5)
    found = run(
        "clacad.exporting.step_record:read", str(path), job.window, timeout=SECONDS, progress=job.progress
    )
    exact = volume_sum(job.integrals, job.bodies)
    checks = compare_step(written, found, job.window, exact, name)
    facts = _facts(job, written, found, None if exact is None else exact.value * job.scale**3)
    return job.record(path, word, facts=facts, checks=checks)


def _facts(
    job: Job, written: Mapping[str, Any], found: Mapping[str, Any], exact: float | None
) -> dict[str, Any]:
    """Facts of the file for the manifest; `exact`: volume of the design, mm³."""
    return {
        "mode": written["mode"],
        "schema": written["schema"],
        "solids": written["solids"],
        "faces": written["faces"],
        "saddles": written["saddles"],
        "wedges": written["wedges"],
        "merged_steps": written["merged_steps"],
        "volume": found.get("volume"),
        "volume_exact": exact,
        "float": "f64",
        "saddle_policy": "exact" if written["saddles"] else None,
        "fit_error": _stated(written["fit_error"]),
        "rim_error": _stated(written["rim_error"]),
        **({} if job.window.uniform else {"own_cells": True}),
    }


def _stated(error: float) -> float | None:
    """Error of fitted geometry (mm) as in the manifest: two digits, rounded up; None where all is exact."""
    if error == 0.0:
        return None
    digit = 10.0 ** (floor(log10(error)) - 1)
    return float(f"{ceil(error / digit) * digit:.2g}")


def write(
    window: Window, path: str, mode: Mode, schema: Schema = "AP242", pcurves: bool = True
) -> dict[str, Any]:
    """Write in the worker, for its limits of memory and time; OCC is not needed."""
    from clacad.formats.step.step_files import write_step

    return write_step(window, path, mode, schema, pcurves)


def read(path: str, window: Window, place: SheetPlace | None = None) -> dict[str, Any]:
    """Read in the worker, with OCC if the file is not too large; `place`: one of several sheets."""
    from clacad.formats.step.read_back import read_brep, read_step

    return read_brep(path, window) if path.lower().endswith(".brep") else read_step(path, window, place=place)


def compare_step(
    written: dict[str, Any], found: dict[str, Any], window: Window, exact: Integral | None, name: str
) -> tuple[str, ...]:
    """Compare the file as read back with the written facts and the design; return the checks that were made.

    Raises FileDisagrees.
    """
    if found["dangling"] or found["open_edges"]:
        raise FileDisagrees(
            f"{name}: {found['dangling']} references lead nowhere, {found['open_edges']} edges are open"
        )
    checks = ["closed"]
    if found["kernel"]:
        _compare_solids(written, found, name)
    scale = millimetres(window.unit)
    room = SHAPE_LIMIT * min(window.lattice.pitch) * scale + written["fit_error"] + written["largest_shift"]
    measured = [found.get(key) for key in ("patch_error", "lens_error")]
    for error in measured:
        if error is not None and not error <= room:
            raise FileDisagrees(
                f"{name}: a lens face lies {error:.3g} mm off the exact surface; {room:.2g} is allowed"
            )
    if any(error is not None for error in measured):
        checks.append("shape")
    stand = found.get("placement")
    if stand is not None:
        if not stand["lattice_error"] <= room or stand["missing"] or stand["doubled"]:
            raise FileDisagrees(
                f"{name}: an instance lies {stand['lattice_error']:.3g} mm off the lattice,"
                f" {stand['missing']} lenses are missing, {stand['doubled']} lie there twice"
            )
        checks.append("placement")
    if exact is not None and found["kernel"]:
        _compare_volume(written, found, window, exact, scale, name)
        checks.append("volume")
    return tuple(checks)


def _compare_solids(written: dict[str, Any], found: dict[str, Any], name: str) -> None:
    """Compare OCC's solids, faces, and gaps between edges and faces with the written ones."""
    for key in ("solids", "faces"):
        if found[f"kernel_{key}"] != written[key]:
            raise FileDisagrees(
                f"{name}: the kernel finds {found[f'kernel_{key}']} {key}, {written[key]} were written"
            )
    if not found["valid"]:
        raise FileDisagrees(f"{name}: the kernel finds a solid that is not valid")
    gap = TOLERANCE + 1.2 * written["largest_shift"] + 4.0 * (written["fit_error"] + written["rim_error"])
    if not found["tolerance"] <= gap:
        raise FileDisagrees(
            f"{name}: the kernel had to bridge gaps of {found['tolerance']:.3g} mm between edges and faces; "
            f"{gap:.2g} is what was written"
        )


def _compare_volume(
    written: dict[str, Any], found: dict[str, Any], window: Window, exact: Integral, scale: float, name: str
) -> None:
    """Compare the volume that OCC finds with the exact integral; `scale`: millimetres per design unit."""
    x0, x1, y0, y1 = whole_extent(window)
    area = (x1 - x0) * (y1 - y0) * scale**2 * 2 * len(window.bodies)
    want = exact.value * scale**3
    # Heights are doubles: far from the origin their spacing is coarse.
    coarse = 2.0 * float(np.spacing(max(abs(z) for z in window.z_range) * scale)) * area
    # Volume error along the borders of cells and of islands in them, when OCC fits its own curves.
    fitted = 0.0 if written["pcurves"] else 8.0 * FITTED / (min(window.lattice.pitch) * scale)
    room = (
        coarse
        + (VOLUME_LIMIT + fitted) * want
        + exact.error * scale**3
        + (written["largest_shift"] + written["fit_error"] + written["rim_error"]) * area
    )
    if not abs(found["volume"] - want) <= room:
        raise FileDisagrees(
            f"{name}: the kernel finds a volume of {found['volume']:.12g} mm^3, the design has {want:.12g}; "
            f"{room:.2g} of difference is allowed"
        )
