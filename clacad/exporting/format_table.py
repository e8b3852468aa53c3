"""Table of the formats' writers: write into the private folder, read back, compare, describe the file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.exporting.fixtures.fixture_files import (
    baffle_records,
    brep_records,
    coupon_records,
    frame_records,
    marked_records,
    pins_records,
)
from clacad.exporting.fixtures.marked_meshes import engraved, with_marks
from clacad.exporting.job import Job
from clacad.exporting.manifest import FileRecord
from clacad.sheet.volume_and_extent import volume_sum
from clacad.sheet.window import Window
from clacad.storage.atomic import canonical_json

if TYPE_CHECKING:
    from clacad.formats.mesh.repeated_pieces import Piece


OPTILAND_SECONDS = 600.0
"""Time limit (s) of the process that loads optiland and traces a few rays."""


# -- meshes --------------------------------------------------------------------------------------


def _stl(job: Job) -> list[FileRecord]:
    return [_one_stl(job, f"{job.stem}.stl", job.window)]


def _stl_parts(job: Job) -> list[FileRecord]:
    return [
        _one_stl(job, f"{job.stem}.{body.name}.stl", replace(job.window, bodies=(body,)))
        for body in job.window.bodies
    ]


def _one_stl(job: Job, name: str, window: Window) -> FileRecord:
    """Write some bodies of the sheet as one STL file, read it back once, compare, and hash while reading."""
    from clacad.exporting.compare import compare_mesh
    from clacad.formats.mesh.stl import read_stl, write_stl
    from clacad.storage.overheard import Overheard

    path = job.stage.path(name)
    names = [body.name for body in window.bodies]
    mesh = job.tessellation.mesh
    bodies = [part for part, body in zip(mesh.bodies, job.window.bodies, strict=True) if body.name in names]
    job.progress(f"write {name}", 0.0)
    write_stl(bodies, path, job.scale, f"{job.stem} {' '.join(names)}")
    job.progress(f"read back {name}", 0.5)
    heard = Overheard(path)
    promise = job.tessellation.promise(instanced=False, single=True, bodies=names)
    read = read_stl(path, heard, checked=True)
    verdict = compare_mesh(read, window, promise, name, volume_sum(job.integrals, names))
    facts = _mesh_facts(job, promise.facets, verdict.volume, verdict.volume_exact, names)
    facts |= {"mode": "fused", "triangles": promise.facets, "float": "f32"}
    return job.record(path, "stl-binary", bodies=names, facts=facts, checks=verdict.checks, heard=heard)


def _mesh_facts(
    job: Job, facets: int, volume: float, exact: float | None, names: Sequence[str], unit: str = "mm",
    repeated: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Facts of a mesh file; `repeated`: it holds one cell, and the whole sheet is not meshed."""
    mesh = job.tessellation.cell if repeated else job.tessellation.mesh
    scale = job.scale * {"mm": 1.0, "m": 1e-3}[unit]
    cube = scale**3
    parts = [part for part, body in zip(mesh.bodies, job.window.bodies, strict=True) if body.name in names]
    return {
        "triangles": facets, "quads": job.tessellation.quads, "slope_error_rms": float(mesh.slope_error),
        "sag_error_max": float(mesh.sag_error) * scale, "volume": volume * cube,
        "volume_exact": None if exact is None else exact * cube,
        **_saddle_facts(job, sum(part.saddles for part in parts), scale),
    }  # fmt: skip


def _saddle_facts(job: Job, saddles: int, scale: float) -> dict[str, Any]:
    """Number of saddles of a mesh and their treatment; `scale`: file units per design unit."""
    bevel = job.request.saddle_bevel * scale
    if not saddles:
        return {"saddles": 0}
    if bevel:
        return {"saddles": saddles, "saddle_policy": "bevel", "saddle_bevel": bevel}
    return {"saddles": saddles, "saddle_policy": "touch"}


def _threemf(job: Job) -> list[FileRecord]:
    from clacad.formats.mesh.threemf import write_threemf

    return [_indexed(job, "3mf", write_threemf, single=False, instanced=None)]


def _marked_stl(job: Job) -> list[FileRecord]:
    made = engraved(job)
    parts = [
        (f"{made.stem}.{body.name}.marked.stl", replace(made.window, bodies=(body,)))
        for body in made.window.bodies
    ]
    return [with_marks(_one_stl(made, name, window), made) for name, window in parts]


def _marked_threemf(job: Job) -> list[FileRecord]:
    from clacad.formats.mesh.threemf import write_threemf

    made = replace(engraved(job), stem=f"{job.stem}.marked")
    return [with_marks(_indexed(made, "3mf", write_threemf, single=False, instanced=False), made)]


def _ply(job: Job) -> list[FileRecord]:
    from clacad.formats.mesh.ply import write_ply

    return [_indexed(job, "ply", write_ply, single=False, instanced=False)]


def _glb(job: Job) -> list[FileRecord]:
    from functools import partial

    from clacad.formats.mesh.glb import write_glb

    write = partial(write_glb, gpu_instancing=job.request.gpu_instancing)
    return [_indexed(job, "glb", write, single=True, instanced=None)]


Writer = Callable[["Sequence[Piece]", Path, float, str], None]


def _indexed(job: Job, kind: str, write: Writer, single: bool, instanced: bool | None) -> FileRecord:
    """Write a format of shared vertices; `instanced` None means: where the sheet allows it."""
    from clacad.exporting.compare import compare_mesh
    from clacad.exporting.tessellations import instanceable
    from clacad.formats.mesh.readers import read_mesh

    name = f"{job.stem}.{kind}"
    path = job.stage.path(name)
    repeated = (instanceable(job.window) and not job.request.fused) if instanced is None else instanced
    job.progress(f"write {name}", 0.0)
    write(job.tessellation.pieces(repeated, normals=kind != "3mf"), path, job.scale, job.stem)
    job.progress(f"read back {name}", 0.5)
    promise = job.tessellation.promise(instanced=repeated, single=single)
    verdict = compare_mesh(read_mesh(path), job.window, promise, name, volume_sum(job.integrals, job.bodies))
    unit = "m" if kind == "glb" else "mm"
    facts = _mesh_facts(job, promise.facets, verdict.volume, verdict.volume_exact, job.bodies, unit, repeated)
    if repeated:  # neighbouring cells share no vertex, and nothing touches within one
        facts = {key: value for key, value in facts.items() if not key.startswith("saddle")} | {"saddles": 0}
        bevel = job.request.saddle_bevel * job.scale * (1e-3 if unit == "m" else 1.0)
        facts |= {"saddle_policy": "bevel", "saddle_bevel": bevel} if promise.bevel else {}
        facts["triangles_stored"] = job.tessellation.cell.facet_count
    facts |= {"mode": "instanced" if repeated else "fused", "float": "f32" if single else "f64"}
    facts |= {
        "objects": len(job.window.bodies),
        "instances": job.window.lattice.cell_count if repeated else None,
    }
    return job.record(path, kind, unit=unit, facts=facts, checks=verdict.checks)


# -- exact solids ----------------------------------------------------------------------------------


def _step(job: Job) -> list[FileRecord]:
    from clacad.exporting.step_record import step_record

    return [step_record(job)]


# -- maps, points, tables, masks -------------------------------------------------------------------


def _maps(job: Job, word: str, kinds: Mapping[str, str]) -> list[FileRecord]:
    """Write every structured face as each kind of raster, and one calibration file for them all."""
    from clacad.formats.maps.sag import check_map, height_map, samples_per_cell, structured_faces, write_map

    records, calibration = [], {}
    per_cell = samples_per_cell(job.window, None)
    for body, face, label in structured_faces(job.window):
        map_ = height_map(job.window, body, face, label, per_cell)
        calibration[label] = map_.calibration(job.scale)
        for kind, suffix in kinds.items():
            path = job.stage.path(f"{job.stem}.{label}.{suffix}")
            job.progress(f"write {path.name}", 0.0)
            write_map(map_, path, kind, job.scale)
            check_map(map_, path, kind, job.scale)
            facts = {"float": "f32"} if kind == "tiff32" else {}
            records.append(job.record(path, kind, bodies=[body.name], facts=facts))
    path = job.stage.path(f"{job.stem}.{word}.json")
    path.write_text(
        canonical_json({"format": 1, "unit": "mm", "faces": calibration}), encoding="utf-8", newline="\n"
    )
    records.append(job.record(path, "height-calibration"))
    return records


def _tiff(job: Job) -> list[FileRecord]:
    return _maps(job, "tiff", {"tiff32": "f32.tiff", "tiff16": "u16.tiff"})


def _png(job: Job) -> list[FileRecord]:
    return _maps(job, "png", {"png16": "u16.png"})


def _gds(job: Job) -> list[FileRecord]:
    """One GDSII file a structured face, and one calibration file for them all."""
    from clacad.formats.maps.gds import grey_cell, write_gds
    from clacad.formats.maps.gds_reading import check_gds
    from clacad.formats.maps.sag import structured_faces

    records, calibration = [], {}
    for body, face, label in structured_faces(job.window):
        cell = grey_cell(job.window, body, face, label, job.request.grey_levels, job.scale)
        calibration[label] = cell.calibration(job.scale)
        path = job.stage.path(f"{job.stem}.{label}.gds")
        job.progress(f"write {path.name}", 0.0)
        placed = write_gds(cell, path, job.scale)
        check_gds(cell, path, placed)
        facts = {"mode": "fused" if cell.own else "instanced", "grey_levels": cell.levels, "lenslets": placed}
        records.append(job.record(path, "gds", unit="um", bodies=[body.name], facts=facts))
    path = job.stage.path(f"{job.stem}.gds.json")
    text = canonical_json({"format": 1, "unit": "mm", "faces": calibration})
    path.write_text(text, encoding="utf-8", newline="\n")
    records.append(job.record(path, "height-calibration"))
    return records


def _sag(job: Job) -> list[FileRecord]:
    from clacad.formats.maps.sag import check_grid_sag, structured_faces, write_grid_sag

    records = []
    for body, face, label in structured_faces(job.window):
        path = job.stage.path(f"{job.stem}.{label}.cell.dat")
        write_grid_sag(job.window, face, 64, path, job.scale)
        check_grid_sag(face, path, job.scale)
        records.append(job.record(path, "grid-sag", bodies=[body.name], facts={"mode": "cell"}))
    return records


def _xyz(job: Job) -> list[FileRecord]:
    from clacad.formats.maps.sag import check_points, samples_per_cell, structured_faces, write_points

    records = []
    per_cell = min(16, samples_per_cell(job.window, None))
    for body, face, label in structured_faces(job.window):
        path = job.stage.path(f"{job.stem}.{label}.xyz")
        job.progress(f"write {path.name}", 0.0)
        count = write_points(job.window, body, face, per_cell, path, job.scale)
        check_points(job.window, face, path, job.scale, count)
        records.append(job.record(path, "xyz-normals", bodies=[body.name], facts={"points": count}))
    return records


def _table(job: Job) -> list[FileRecord]:
    from clacad.formats.maps.pose_table import check_table, write_table_csv, write_table_json

    surfaces, poses = job.stage.path(f"{job.stem}.surfaces.json"), job.stage.path(f"{job.stem}.poses.csv")
    write_table_json(job.window, surfaces, job.scale)
    count = write_table_csv(job.window, poses, job.scale)
    check_table(job.window, surfaces, poses, job.scale, count)
    return [job.record(surfaces, "surface-table"), job.record(poses, "pose-table", facts={"lenslets": count})]


def _mask(job: Job) -> list[FileRecord]:
    """Two masks a structured face, SVG and DXF."""
    from clacad.formats.maps.mask import check_mask, write_dxf, write_svg
    from clacad.formats.maps.sag import structured_faces

    records = []
    for body, face, label in structured_faces(job.window):
        svg, dxf = (
            job.stage.path(f"{job.stem}.{label}.mask.svg"),
            job.stage.path(f"{job.stem}.{label}.mask.dxf"),
        )
        write_svg(job.window, body, face, label, svg, job.scale)
        write_dxf(job.window, body, face, label, dxf, job.scale)
        check_mask(job.window, face, svg, dxf, job.scale)
        records += [
            job.record(path, kind, bodies=[body.name])
            for path, kind in ((svg, "mask-svg"), (dxf, "mask-dxf"))
        ]
    return records


def _pov(job: Job) -> list[FileRecord]:
    from clacad.formats.pov.pov_scene import write_pov

    path = job.stage.path(f"{job.stem}.pov")
    write_pov(job.window, path)
    return [job.record(path, "pov", unit="0.001 design unit", checks=())]


# -- a second opinion ------------------------------------------------------------------------------


def _zmx(job: Job) -> list[FileRecord]:
    from clacad.formats.sequential.stations import left_out
    from clacad.formats.sequential.zmx import check_zmx, write_zmx

    path = job.stage.path(f"{job.stem}.zmx")
    write_zmx(job.window, path)
    check_zmx(job.window, path)
    facts = {"mode": "cell", "left_out": left_out(job.window)}
    return [job.record(path, "zmx", facts=facts, checks=("light",))]


def _optiland(job: Job) -> list[FileRecord]:
    """Write the optiland file; optiland reads it back and traces it in a separate process."""
    import numpy as np

    from clacad.formats.sequential import optiland_json

    path = job.stage.path(f"{job.stem}.optiland.json")
    told = optiland_json.write_optiland(job.window, path)["clacad"]
    job.progress(f"read back {path.name}", 0.5)
    start, direction = (rows.tolist() for rows in optiland_json.rays_for(job.window))
    found = job.worker.run(
        f"{optiland_json.__name__}:optiland_directions",
        str(path),
        start,
        direction,
        timeout=OPTILAND_SECONDS,
    )
    optiland_json.check_optiland(job.window, path.name, np.array(found, dtype=np.float64))
    series = [told["faces"]] if told["largest_slope_error"] else []
    facts = {"mode": "cell", "left_out": [*told["left_out"], *series]}
    return [job.record(path, "optiland", facts=facts, checks=("light",))]


def _drawing(job: Job) -> list[FileRecord]:
    """One DXF with all sheets, and one PDF."""
    from clacad.formats.drawing.dxf import check_drawing_dxf, write_drawing_dxf
    from clacad.formats.drawing.sheet_layout import sheets
    from clacad.formats.drawing.sheets_pdf import check_drawing_pdf, write_drawing_pdf
    from clacad.formats.study_file import study_of
    from clacad.sheet.feasibility import feasibility

    study = study_of(job.stage.folder, job.design.sha256)
    made = sheets(job.design, job.window, feasibility(job.window), job.request.paper, study)
    dxf, pdf = (job.stage.path(f"{job.stem}.drawing.{kind}") for kind in ("dxf", "pdf"))
    job.progress(f"write {dxf.name}", 0.0)
    written = write_drawing_dxf(made, dxf)
    check_drawing_dxf(dxf, written)
    job.progress(f"write {pdf.name}", 0.5)
    write_drawing_pdf(made, pdf)
    check_drawing_pdf(pdf, len(made))
    facts = {"paper": job.request.paper, "sheets": len(made), "tolerance_study": study is not None}
    return [
        job.record(dxf, "drawing-dxf", facts=facts | {"dimensions": written}, checks=("dimensions",)),
        job.record(pdf, "drawing-pdf", facts=facts, checks=("pages",)),
    ]


WRITERS: dict[str, Callable[[Job], list[FileRecord]]] = {
    "step": _step, "stl": _stl, "stl-parts": _stl_parts, "3mf": _threemf, "ply": _ply, "glb": _glb, "sag": _sag,
    "tiff": _tiff, "png": _png, "xyz": _xyz, "table": _table, "mask": _mask, "gds": _gds, "pov": _pov, "brep": brep_records,
    "baffle": baffle_records, "frame": frame_records, "pins": pins_records, "coupon": coupon_records, "marked": marked_records,
    "marked-stl": _marked_stl, "marked-3mf": _marked_threemf, "zmx": _zmx, "optiland": _optiland,
    "drawing": _drawing,
}  # fmt: skip
"""Format word → the function that writes, reads back and compares its files."""
