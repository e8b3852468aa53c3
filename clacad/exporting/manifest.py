"""Job of an export, from which every format writes its files, and the manifest of what was written.

The manifest lists the files, their design, and the measured properties of each file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.base.text import plain
from clacad.base.types import Progress
from clacad.base.units import millimetres
from clacad.exporting.request import Request
from clacad.optics.surface import Quadric
from clacad.sheet.volume_and_extent import Integral, body_volume
from clacad.sheet.window import Window
from clacad.storage.atomic import Stage, canonical_json, file_hash, owns, read_manifest
from clacad.storage.staging import flush
from clacad.storage.worker import Worker

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.exporting.tessellations import Tessellation
    from clacad.storage.reading import Overheard


FORMAT = 1


@dataclass(frozen=True)
class FileRecord:
    """One file of an export; facts that do not apply to its format are left out of the manifest.

    name, sha256, bytes, format
    unit : Unit of the file's numbers.
    facts : Keys of the manifest that the format has: mode, solids, faces, triangles, quads, slope_error_rms,
        sag_error_max, float, volume, volume_exact (file's unit cubed), saddles, wedges, merged_steps,
        forecast_law_rms_as_made (radians; all light through the part made from it, with --as-made),
        fit_error and rim_error (mm; largest distance of fitted lens faces and fitted rims from the true
        ones), left_out (sentences: what the format cannot hold), objects and instances (meshes; of each
        object).
    checks : Comparisons with the design that passed when the file was read back.
    role : What the file is for: role, role_declared; of meshes forecast_law_rms (radians; None: too little
        light gets through), forecast_beyond (keys of the limits not kept), role_overstated (declared a master
        all the same) and, of previews, master_quads and master_bytes (None: no grid makes a master).
    """

    name: str
    sha256: str
    bytes: int
    format: str
    unit: str
    bodies: tuple[str, ...]
    facts: Mapping[str, Any] = field(default_factory=dict)
    checks: tuple[str, ...] = ()
    role: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Entry of the manifest's `files`."""
        plain = {
            "name": self.name,
            "sha256": self.sha256,
            "bytes": self.bytes,
            "format": self.format,
            "unit": self.unit,
            "bodies": list(self.bodies),
            "pose": "sheet frame",
            "checks": list(self.checks),
        }
        return (
            plain | {key: value for key, value in self.facts.items() if value is not None} | dict(self.role)
        )


@dataclass(frozen=True)
class Manifest:
    """Result of `export`: the folder and the manifest in it.

    document : The content of manifest.json.
    run : Seconds and memory of this run; also in run.json.
    """

    folder: Path
    document: Mapping[str, Any]
    run: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Manifest({str(self.folder)!r}: {', '.join(str(one['name']) for one in self.files)})"

    @property
    def files(self) -> tuple[Mapping[str, Any], ...]:
        """Entries of the files, each a mapping with name, sha256, bytes, format and measured facts."""
        return tuple(self.document["files"])

    def path(self, format: str) -> Path:
        """Path of the first file of a format ("stl-binary", "step", …). Raises KeyError: There is none."""
        for entry in self.files:
            if entry["format"] == format:
                return self.folder / str(entry["name"])
        raise KeyError(format)

    def to_json(self) -> str:
        """Text of manifest.json."""
        return canonical_json(self.document)


def document(
    design: Design,
    window: Window,
    records: Sequence[FileRecord],
    options: Mapping[str, Any],
    versions: Mapping[str, str],
    counts: Mapping[str, Any],
) -> dict[str, Any]:
    """Build the content of manifest.json.

    window : As written; its count may be smaller than the design's.
    options : Options of this export.
    versions : Versions of the programs that the bytes depend on.
    counts : "pieces" and "holes" of each body.
    """
    return {
        "format": FORMAT,
        "design": {"name": design.name, "sha256": design.sha256, "toml": design.toml},
        "window": _window(design, window) | dict(counts),
        "files": sorted((record.to_dict() for record in records), key=lambda entry: str(entry["name"])),
        "versions": dict(versions),
        "options": dict(options),
    }


def _window(design: Design, window: Window) -> dict[str, Any]:
    """The window as the manifest keeps it: recipe, count and cells; lengths in mm."""
    scale = millimetres(window.unit)
    recipe = {k: plain(v, lambda _: "infinite") for k, v in window.recipe.items() if v is not None}
    for key in ("R", "f", "d", "T", "s"):
        if key in recipe:
            recipe[key] = _scaled(recipe[key], scale)
    if "R" in recipe:
        recipe["kappa"] = [
            face.surface.kappa / scale
            for face in window.faces
            if face.array is not None and isinstance(face.surface, Quadric)
        ]
    return {
        "form": window.form,
        "recipe": recipe,
        "count": list(design.lattice.count),
        "cells_written": list(window.lattice.count),
        "cells": window.lattice.cell_count,
        "lattice": window.lattice.kind,
        "pitch": [p * scale for p in window.lattice.pitch],
        "euler_axes": design.law_spec.euler_axes,
        "handedness": "right",
        "length_unit": "mm",
        "z_range": [z * scale for z in window.z_range],
    }


def _scaled(value: Any, scale: float) -> Any:
    if isinstance(value, list):
        return [_scaled(v, scale) for v in value]
    return value * scale if isinstance(value, (int, float)) else value


def carried_over(folder: Path, new: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Entries of an earlier export of the same design into the same folder that the new one did not rewrite.

    Entries are kept when design, window and versions are the same and the files are unchanged. `--format
    step` followed by `--format stl` therefore gives one set.
    """
    old = read_manifest(folder)
    if old is None:
        return []
    same = all(old.get(key) == new[key] for key in ("window", "versions")) and (
        isinstance(old.get("design"), dict) and old["design"].get("sha256") == new["design"]["sha256"]
    )
    if not same:
        return []
    written = {entry["name"] for entry in new["files"]}
    kept = []
    for entry in old["files"]:
        name = entry.get("name") if isinstance(entry, dict) else None
        if isinstance(name, str) and name not in written and "/" not in name and owns(old, folder / name):
            kept.append(entry)
    return kept


@dataclass(frozen=True, eq=False)
class Job:
    """Inputs of every format: the window, the folder, the meshes, the worker.

    stem : First part of every file name.
    request : Options of the export.
    design : Design as requested; the window has the cells that are written.
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
