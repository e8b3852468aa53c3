"""Unit of a file, number of design cells in it, and its bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.types import Floats
from clacad.exporting.limits import MOST_CELLS, refuse_cells
from clacad.formats.mesh.file_mesh import FileMesh
from clacad.judging.delivery import Subject
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import body_range
from clacad.sheet.volume_and_extent import whole_extent
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.design import Design


UNITS: Mapping[str, float] = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}

MISREAD = "mm / 25.4"
"""Not a real unit: millimetres that were interpreted as inches."""

FACTORS: tuple[tuple[str, float], ...] = (
    ("mm", 1e-3),
    ("m", 1.0),
    ("um", 1e-6),
    ("in", 0.0254),
    (MISREAD, 1e-3 / 25.4),
)
"""Candidate units, in metres, of a file without a manifest whose format defines no unit."""

SAME_EXTENT = 0.02
"""Relative difference up to which two extents are the same."""


class CannotRegister(ValueError):
    """A file whose unit or number of cells cannot be determined; the message names what was tried."""

    exit_status = 2


def written_window(
    design: Design, whole: Window, manifest: Mapping[str, Any] | None, cells: tuple[int, int] | None
) -> Window | None:
    """Window with the cells that were written, as given by the manifest or the caller; None if neither gives
    them.

    whole : window of the design with all its cells
    Raises LimitRefused: More cells than an export writes.
    """
    if cells is not None:
        refuse_cells(*cells)
        return prescribe(design.with_cells(cells))
    if manifest is None:
        return None
    stated = manifest.get("window", {})
    count = stated.get("cells_written") if isinstance(stated, dict) else None
    if not (isinstance(count, list) and len(count) == 2 and all(isinstance(n, int) and n > 0 for n in count)):
        return None
    if tuple(count) == design.lattice.count:
        return whole
    refuse_cells(count[0], count[1])
    return prescribe(design.with_cells((count[0], count[1])))


def unit_of(subject: Subject, mesh: FileMesh) -> float | None:
    """Metres per unit of the file: its own unit, else that which readers assume, else its manifest's."""
    if mesh.unit is not None or not subject.entry:
        return mesh.unit
    return UNITS.get(str(subject.entry.get("unit", "mm")), 1e-3)


def held_bodies(window: Window, subject: Subject, height: float) -> tuple[tuple[str, ...], ...]:
    """Candidate body names of a file: from the manifest, else from the file's height (design units).

    Several candidates result where two bodies have the same height.
    """
    names = tuple(body.name for body in window.bodies)
    if subject.bodies:
        return (tuple(name for name in names if name in subject.bodies),)
    whole = window.z_range[1] - window.z_range[0]
    if len(names) == 1 or abs(height / whole - 1.0) <= SAME_EXTENT:
        return (names,)
    tall = {body.name: -np.subtract(*body_range(window, body)) for body in window.bodies}
    near = tuple((name,) for name, h in tall.items() if abs(height / h - 1.0) <= SAME_EXTENT)
    return near or (names,)


def fitting_window(
    design: Design, whole: Window, fixed: bool, heights: Sequence[float], extent: Floats
) -> Window | None:
    """The design with the cells that fit an extent (3,) in design units; None if its height or sides do not
    fit.

    fixed : whether `whole` has the cells of the file, and no others are tried
    heights : of the sheet and of its bodies (lengths)
    """
    if not any(abs(extent[2] / h - 1.0) <= SAME_EXTENT for h in heights):
        return None
    if not fixed:
        count, spec = _cells_of(design, whole, extent), design.lattice
        if count[0] * count[1] > max(MOST_CELLS, spec.count[0] * spec.count[1]):
            return None  # one corner far away: no export wrote this
        if (count != spec.count or spec.outline is not None) and not _alike(whole_extent(whole), extent):
            whole = whole.with_cells(count)
    return whole if _alike(whole_extent(whole), extent) or _one_body_alike(whole, extent) else None


def _cells_of(design: Design, whole: Window, extent: Floats) -> tuple[int, int]:
    """Number of cells along each axis whose extent is nearest to an extent (3,) in design units."""
    border = 2.0 * design.body.border
    step = (design.lattice.pitch[0], whole.lattice.a2[1])
    if not whole.lattice.hexagonal:
        along, across = (
            max(1, round((float(e) - border) / p)) for e, p in zip(extent[:2], step, strict=True)
        )
        return along, across
    # odd rows are shifted by half a pitch; rows overlap by a third
    aside = 0.5 * step[0] if extent[1] > 1.5 * step[1] else 0.0
    return (
        max(1, round((float(extent[0]) - border - aside) / step[0])),
        max(1, round((float(extent[1]) - border) / step[1] - 1.0 / 3.0)),
    )


def _alike(box: Sequence[float], extent: Floats) -> bool:
    return all(
        abs(e / s - 1.0) <= SAME_EXTENT
        for e, s in zip(extent[:2], (box[1] - box[0], box[3] - box[2]), strict=True)
    )


def _one_body_alike(window: Window, extent: Floats) -> bool:
    """Whether a file of one body has its extent, perhaps without the displacement between the bodies."""
    return any(_alike(whole_extent(replace(window, bodies=(body,))), extent) for body in window.bodies)
