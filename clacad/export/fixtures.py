"""Fixtures and kernel files: baffle (STL), frame, coupon and marked bodies (STEP), bodies as BREP; each read back.

The modelling runs in the worker, for the kernel can crash; the parent gets numbers only.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.export.errors import FileDisagrees
from clacad.export.manifest import FileRecord
from clacad.sheet import Window

if TYPE_CHECKING:
    from clacad.export.formats import Job

SECONDS = 1800.0
VOLUME_LIMIT = 1e-6
"""Relative difference allowed between a modelled part and what is read back from its file."""
MOST_BREP_CELLS = 2500
"""Cells up to which BREP is offered: beyond, the kernel's own solids take gigabytes."""


def baffle_records(job: Job) -> list[FileRecord]:
    """Write the honeycomb as binary STL and hold it against its closed-form volume.

    Raises
    ------
    NoFixture
        The design has no baffle.
    FileDisagrees
    """
    from clacad.export.closed import measure
    from clacad.export.readers import read_mesh
    from clacad.export.stl import write_stl
    from clacad.fixture import baffle_mesh

    baffle = baffle_mesh(job.window)
    path = job.stage.path(f"{job.stem}.baffle.stl")
    job.progress(f"write {path.name}", 0.0)
    write_stl([baffle], path, job.scale, f"{job.stem} baffle")
    found = measure(read_mesh(path).chunks())
    exact = baffle.volume() * job.scale**3
    if found.facets != baffle.facet_count or not found.closed or abs(found.volume / exact - 1.0) > 1e-4:
        raise FileDisagrees(
            f"{path.name}: {found.facets} facets enclosing {found.volume:.9g} mm^3; the honeycomb has "
            f"{baffle.facet_count} and {exact:.9g} mm^3"
        )
    facts = {
        "triangles": found.facets,
        "volume": found.volume,
        "volume_exact": exact,
        "float": "f32",
        "mode": "fused",
    }
    return [job.record(path, "stl-binary", bodies=["baffle"], facts=facts, checks=("closed", "volume"))]


def frame_records(job: Job) -> list[FileRecord]:
    """Write the spacer frame and its retainers, one STEP file each."""
    return _modelled(job, "frame")


def coupon_records(job: Job) -> list[FileRecord]:
    """Write the compensation coupon as STEP."""
    return _modelled(job, "coupon")


def marked_records(job: Job) -> list[FileRecord]:
    """Write the bodies with name and arrow engraved in their border, one STEP file each.

    Raises
    ------
    LimitRefused
        More cells than the kernel takes.
    NoFixture
        The bodies have no border, or one too narrow.
    """
    _refuse_many(job, "marked")
    return _modelled(job, "marked")


def brep_records(job: Job) -> list[FileRecord]:
    """Write the bodies as one BREP file for the CAD kernel.

    Raises
    ------
    LimitRefused
        More cells than the kernel takes.
    """
    _refuse_many(job, "BREP")
    return _modelled(job, "brep")


def _refuse_many(job: Job, what: str) -> None:
    from clacad.export.errors import LimitRefused

    cells = job.window.lattice.cell_count
    if cells > MOST_BREP_CELLS:
        raise LimitRefused(
            f"{what} of {cells:,} cells: the kernel takes up to {MOST_BREP_CELLS:,}\n"
            "  use --cells 50x50, or --format step"
        )


def _modelled(job: Job, what: str) -> list[FileRecord]:
    job.progress(f"model {what}", 0.0)
    folder = job.stage.path(f"{job.stem}.{what}.step").parent
    made: Mapping[str, Any] = job.worker.run(
        "clacad.export.fixtures:model", what, job.window, str(folder), job.stem, timeout=SECONDS,
        progress=job.progress,
    )  # fmt: skip
    records = []
    for name, facts in made.items():
        path = job.stage.path(name)
        apart = abs(facts["volume"] / facts["volume_exact"] - 1.0)
        if not facts.pop("valid") or not apart <= VOLUME_LIMIT:
            raise FileDisagrees(
                f"{name}: read back with {facts['volume']:.9g} mm^3, modelled with {facts['volume_exact']:.9g} mm^3"
            )
        kind = "brep" if what == "brep" else "step"
        records.append(
            job.record(path, kind, bodies=facts.pop("bodies"), facts=facts, checks=("closed", "volume"))
        )
    return records


def model(what: str, window: Window, folder: str, stem: str) -> dict[str, dict[str, Any]]:
    """Build, write and read back in the worker; file name → facts."""
    parts = _parts(what, window)
    if what == "brep":
        return {f"{stem}.brep": _brep(list(parts.values()), list(parts), Path(folder) / f"{stem}.brep")}
    return {
        f"{stem}.{name}.step": _step(part, name, Path(folder) / f"{stem}.{name}.step")
        for name, part in parts.items()
    }


def _parts(what: str, window: Window) -> dict[str, Any]:
    if what == "frame":
        from clacad.fixture import frame_solids, frame_spec

        return frame_solids(frame_spec(window, window.land.border), window.name)
    if what == "coupon":
        from clacad.fixture import coupon_solid

        return {"coupon": coupon_solid(window)}
    if what == "marked":
        from clacad.fixture import marked_solids

        return {f"{name}.marked": part for name, part in marked_solids(window, window.name).items()}
    from clacad.brep import solids

    return {body.name: part for body, part in zip(window.bodies, solids(window), strict=True)}


def _step(part: Any, name: str, path: Path) -> dict[str, Any]:
    from build123d import Color, export_step, import_step

    part.label = name
    part.color = (
        Color(0.62, 0.78, 0.90) if name == "coupon" or name.endswith(".marked") else Color(0.15, 0.15, 0.17)
    )
    export_step(part, str(path), timestamp="2000-01-01T00:00:00")
    return _facts(part, import_step(str(path)), [name])


def _brep(parts: list[Any], names: list[str], path: Path) -> dict[str, Any]:
    from build123d import Compound, export_brep, import_brep

    whole = Compound(children=parts)
    export_brep(whole, str(path))
    return _facts(whole, import_brep(str(path)), names)


def _facts(made: Any, found: Any, names: list[str]) -> dict[str, Any]:
    return {
        "bodies": names, "solids": len(found.solids()), "faces": len(found.faces()), "volume": float(found.volume),
        "volume_exact": float(made.volume), "valid": bool(found.is_valid), "float": "f64", "mode": "fused",
    }  # fmt: skip
