"""Files of a stack: one STEP assembly, one GLB; every sheet is read back and compared with its design."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.types import Progress
from clacad.base.units import MILLIMETRE, millimetres
from clacad.exporting.formats.indexed_meshes import GLB
from clacad.exporting.formats.step import WORD as STEP
from clacad.exporting.manifest import FileRecord
from clacad.exporting.roles import Prospect, Role
from clacad.exporting.step_record import SECONDS, compare_step
from clacad.exporting.tessellations import Meshes, instanceable
from clacad.formats.mesh.compare_triangles import compare_mesh
from clacad.formats.mesh.file_mesh import FileMesh, put
from clacad.formats.step.lens_placements import SheetPlace
from clacad.formats.step.part21 import Mode
from clacad.sheet.stack import Stack, StackedSheet
from clacad.sheet.volume_and_extent import body_volume, volume_sum
from clacad.sheet.window import Window
from clacad.storage.atomic import Stage, file_hash
from clacad.storage.staging import flush
from clacad.storage.worker import Worker

if TYPE_CHECKING:
    from clacad.sheet.volume_and_extent import Integral

NAME = "stack"
"""First part of the files' names."""


@dataclass(frozen=True, eq=False)
class StackAssembly:
    """Contents and options of a stack's files.

    quads : Facets along a cell side, of GLB.
    step : "auto", "fused" or "instanced"
    """

    stack: Stack
    stage: Stage
    worker: Worker
    quads: int
    step: Mode
    progress: Progress

    def records(self, formats: tuple[str, ...]) -> list[FileRecord]:
        """Write the formats, read them back and compare. Raises FileDisagrees, WorkerDied."""
        makers = {STEP: self._step, GLB: self._glb}
        return [makers[name]() for name in formats]

    def _step(self) -> FileRecord:
        """Write the STEP assembly, in the worker."""
        path = self.stage.path(f"{NAME}.step")
        run = partial(self.worker.run, timeout=SECONDS, progress=self.progress)
        self.progress(f"write {path.name}", 0.0)
        placed = [(one.id, one.window, one.z * self._mm) for one in self.stack.sheets]
        written = run("clacad.stacking.assembly:write", placed, NAME, str(path), self.step)
        checks: set[str] = set()
        for number, (one, place) in enumerate(zip(self.stack.sheets, places(self.stack), strict=True)):
            self.progress(f"read back {path.name}", (number + 1) / (len(self.stack.sheets) + 1))
            found = run("clacad.exporting.step_record:read", str(path), one.window, place)
            own, name = written["sheets"][number], f"{path.name}, sheet {one.id}"
            agreed = compare_step(own, found, one.window, _volume(one.window), name)
            checks = set(agreed) if not number else checks & set(agreed)
        facts = {
            "mode": "assembly",
            **{key: written[key] for key in ("schema", "solids", "faces")},
            "sheets": [_told(sheet) for sheet in written["sheets"]],
            "float": "f64",
        }
        return self._record(path, STEP, "mm", facts, tuple(sorted(checks)), Prospect(Role.MASTER))

    def _glb(self) -> FileRecord:
        """Write the GLB file of facets, for viewing."""
        from clacad.formats.mesh.glb import PlacedPieces, read_glb, write_glb_stack

        path = self.stage.path(f"{NAME}.glb")
        self.progress(f"write {path.name}", 0.0)
        made = {id(one.window): Meshes(one.window).at(self.quads) for one in self.stack.sheets}
        pieces = {key: cut.pieces(instanceable(cut.window), normals=True) for key, cut in made.items()}
        write_glb_stack(
            [
                PlacedPieces(one.id, pieces[id(one.window)], millimetres(one.window.unit), one.z * self._mm)
                for one in self.stack.sheets
            ],
            path,
            NAME,
        )
        self.progress(f"read back {path.name}", 0.5)
        whole, facets = read_glb(path), 0
        for one, place in zip(self.stack.sheets, places(self.stack), strict=True):
            cut = made[id(one.window)]
            promise = cut.promise(instanced=instanceable(one.window), single=True)
            compare_mesh(
                mesh_of_sheet(whole, place),
                one.window,
                promise,
                f"{path.name}, sheet {one.id}",
                _volume(one.window),
            )
            facets += promise.facets
        facts = {
            "mode": "assembly",
            "quads": self.quads,
            "float": "f32",
            "triangles": facets,
            "triangles_stored": sum(
                (cut.cell if instanceable(cut.window) else cut.mesh).facet_count for cut in made.values()
            ),
        }
        return self._record(
            path, GLB, "m", facts, ("closed", "shape", "volume"), Prospect(Role.PREVIEW, True)
        )

    @property
    def _mm(self) -> float:
        return millimetres(self.stack.unit)

    def _record(
        self,
        path: Path,
        format: str,
        unit: str,
        facts: dict[str, Any],
        checks: tuple[str, ...],
        role: Prospect,
    ) -> FileRecord:
        flush(path)
        bodies = tuple(f"{one.id} {body.name}" for one in self.stack.sheets for body in one.window.bodies)
        return FileRecord(
            path.name, file_hash(path), path.stat().st_size, format, unit, bodies, facts, checks, role.entry()
        )


def places(stack: Stack) -> list[SheetPlace]:
    """Position of each sheet in a file, with boundaries in the middle of the gaps, mm."""
    mm = millimetres(stack.unit)
    cuts = [0.5 * (a.span[1] + b.span[0]) * mm for a, b in zip(stack.sheets, stack.sheets[1:])]
    return [
        SheetPlace(low, high, one.z * mm)
        for one, low, high in zip(stack.sheets, [-inf, *cuts], [*cuts, inf], strict=True)
    ]


def mesh_of_sheet(whole: FileMesh, place: SheetPlace) -> FileMesh:
    """The facets of one sheet of several in a file, in the sheet's own frame."""
    unit = (whole.unit if whole.unit is not None else MILLIMETRE) / MILLIMETRE
    parts = []
    for part in whole.parts:
        low, high = part.own_box()
        middle = np.append(0.5 * (low + high), 1.0)
        inside = place.holds(unit * (part.placements[:, :, 2] @ middle))
        if inside.any():
            moved = part.placements[inside].copy()
            moved[:, 3, 2] -= place.z / unit
            parts.append(replace(part, places=put(moved)))
    return replace(whole, parts=tuple(parts))


def write(placed: list[tuple[str, Window, float]], name: str, path: str, step: Mode) -> dict[str, Any]:
    """Write the STEP assembly, in the worker; windows shared in the parent stay shared."""
    from clacad.formats.step.step_files import write_step_stack

    return write_step_stack(placed, name, path, step)


def _told(sheet: dict[str, Any]) -> dict[str, Any]:
    """Manifest entry of a sheet in the STEP file."""
    return {key: sheet[key] for key in ("name", "z", "mode", "solids", "faces", "merged_steps")}


def _volume(window: Window) -> Integral | None:
    """Exact volume of all bodies of a window."""
    names = [body.name for body in window.bodies]
    return volume_sum({body.name: body_volume(window, body) for body in window.bodies}, names)


def sheet_facts(one: StackedSheet, mm: float) -> dict[str, Any]:
    """Position of a sheet, for messages and manifests, mm."""
    low, high = one.span
    first, last = one.lens_planes
    return {
        "id": one.id,
        "design": one.window.name,
        "z": one.z * mm,
        "span": [low * mm, high * mm],
        "lens_planes": [first * mm, last * mm],
    }
