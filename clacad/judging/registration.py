"""Registration of a measured part: unit, turn, mirror, position, scale, and number of cells.

A file without a manifest may be a scan, a slicer's repair, or a piece cut from the sheet. Its triangles are
tried in every unit and in the 24 proper axis permutations (and in the 24 improper ones, to detect a mirrored
part) that give it the design's box. The best are fitted to the exact faces by robust least squares, point to
plane.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import degrees, radians
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.types import Floats
from clacad.checks.check import Check, State, other
from clacad.checks.file_kinds import HANDEDNESS, POSE
from clacad.formats.mesh.file_mesh import FileMesh, Part, put
from clacad.judging.delivery import Subject
from clacad.judging.part_frames import PartFrame, Sample, frames, sampled, sixths
from clacad.judging.pose_fit import (
    AS_WRITTEN,
    Fit,
    PartPose,
    Trial,
    all_trials,
    as_written,
    best_of,
    fitted,
    no_match,
    one_unit,
    units_of,
    worth_fitting,
)
from clacad.judging.unit_and_cells import CannotRegister
from clacad.prescription.prescribe import prescribe
from clacad.sheet.window import Window, lens_height

if TYPE_CHECKING:
    from clacad.design import Design


PART_OF_SAG = 0.1
"""Part of the flattest lens's sag below which a residual shows a certain fit: other poses are not tried."""

TURNED = radians(10.0)
"""Turn above which the pose text reports it; smaller turns are normal for a part laid down by hand."""

BETTER = 0.7
"""A mirrored fit below this part of the best proper fit's residual makes the part a mirrored one."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A part in the design's frame.

    window : Window with the cells that the part holds.
    mesh : In design units and the sheet frame, at the design's size; the file itself where the part lies as
        written.
    factor : Design units per unit of `mesh`.
    present : names of the bodies it holds
    whole : Whether it was cut along cell borders, so that its sides are the design's.
    exact : Whether it lies as written, to rounding.
    note : Result of the registration, in words.
    checks : The checks pose and handedness.
    file : The file as read, in its own unit and frame.
    """

    window: Window
    mesh: FileMesh
    factor: float
    present: tuple[str, ...]
    pose: PartPose
    whole: bool
    exact: bool
    note: str
    checks: list[Check] = field(default_factory=list)
    file: FileMesh | None = None


def place(design: Design, subject: Subject, mesh: FileMesh, cells: Window | None) -> Placed:
    """Register a part.

    cells : Window with the cells that the file holds according to the caller.
    Raises CannotRegister: The part fits this design in no unit and turn, or equally well in two units.
    """
    whole = prescribe(design) if cells is None else cells
    pitch = min(whole.lattice.pitch)
    sample, first = sampled(mesh)
    fixed = cells is not None or not whole.uniform  # a non-uniform sheet has one number of cells only

    def tried(frame: PartFrame) -> list[Trial]:
        return list(all_trials(design, whole, fixed, subject, mesh, sample, frame))

    trials = tried(first)
    fits = _fits_in_frames(design, mesh, sample, whole, trials, tried)
    proper = [f for f in fits if not f[1].mirrored]
    if not proper:
        raise CannotRegister(no_match(design, whole, subject, mesh, first.extent))
    mirrored = [f for f in fits if f[1].mirrored]
    best = best_of(proper)
    one_unit(subject, proper, best, pitch)
    handed = _handedness(subject, best[1], best_of(mirrored)[1] if mirrored else None, pitch)
    own = _in_own_frame(whole, trials, best[0].unit)
    return _placed(design, subject, mesh, best, handed, own, None if cells is not None else whole)


def _fits_in_frames(
    design: Design,
    mesh: FileMesh,
    sample: Sample,
    whole: Window,
    trials: Sequence[Trial],
    tried: Callable[[PartFrame], list[Trial]],
) -> list[Fit]:
    """Fits of the file's own frame, and of further frames until one fit is certain.

    trials : of the file's own frame; tried : returns those of another frame
    """
    fits = [fitted(trial) for trial in worth_fitting(trials)]
    written = as_written(whole)
    near = max(written, PART_OF_SAG * least_sag(whole))

    def sure() -> bool:
        return any(pose.residual <= near or (pose.untouched and pose.median <= written) for _, pose in fits)

    if sure():
        return fits
    # the part is turned, noisy, or a different part
    factors = np.array([metres / design.unit_m for _, metres in units_of(mesh)])
    for frame in frames(mesh, sample, whole, factors):
        fits += [fitted(trial) for trial in worth_fitting(tried(frame))]
        if sure():
            break
    if whole.lattice.hexagonal and fits:
        least = min(fits, key=lambda f: f[1].residual)[1]
        fits += [fitted(t) for frame in sixths(mesh, least.turn) for t in worth_fitting(tried(frame))]
    return fits


def _in_own_frame(whole: Window, trials: Sequence[Trial], unit: str) -> bool:
    """Whether a file's box lies where the design's does, apart from the displacement of arrays."""
    pitch = min(whole.lattice.pitch)
    room = np.array([*(2.0 * np.abs(whole.shifts[1]) + 1e-3 * pitch), 1e-3 * pitch])
    return any(
        np.array_equal(t.axes, np.eye(3)) and t.unit == unit and bool((np.abs(t.onto) <= room).all())
        for t in trials
    )


def least_sag(window: Window) -> float:
    """Height (length) of the flattest lens of a window over its cell's middle, edges and corners."""
    tile = window.lattice.tile()
    places = np.concatenate([tile, 0.5 * (tile + np.roll(tile, 1, axis=0)), [[0.0, 0.0]]])
    heights = [lens_height(face, *places.T) for face in window.faces if face.array is not None]
    return min(float(np.nanmax(h) - np.nanmin(h)) for h in heights)


# -- result ---------------------------------------------------------------------------------------------
def _handedness(subject: Subject, best: PartPose, twin: PartPose | None, pitch: float) -> Check:
    """Judge whether the part in pose `best` is the mirror image of the design, whose pose is then `twin`."""
    common: dict[str, Any] = {"where": "file", "subject": subject.name, "unit": "design unit"}
    if twin is None:
        return HANDEDNESS.check("not run", "no mirrored turn fits its box", required=False, **common)
    wrong = twin.residual < BETTER * best.residual and best.residual > AS_WRITTEN * pitch
    if wrong:
        sentence = (
            f"the part is the mirror image of the design: mirrored it fits to {twin.residual:.3g}, unmirrored"
            f" only to {best.residual:.3g}"
        )
        return HANDEDNESS.check("fail", sentence, best.residual, twin.residual, **common)
    alike = abs(twin.residual - best.residual) <= 0.2 * best.residual + 1e-7 * pitch
    sentence = (
        "the design is its own mirror image: handedness cannot be wrong"
        if alike
        else f"unmirrored it fits to {best.residual:.3g}, mirrored to {twin.residual:.3g}"
    )
    return HANDEDNESS.check("pass", sentence, best.residual, twin.residual, **common)


def _placed(
    design: Design,
    subject: Subject,
    mesh: FileMesh,
    best: Fit,
    handed: Check,
    own: bool,
    cells_of: Window | None,
) -> Placed:
    """The part in the pose of the best fit, with the checks of its pose.

    own : whether the file's box lies where the design's does
    cells_of : the whole design where the caller does not give the file's cells
    """
    trial, pose = best
    exact = trial.whole and pose.untouched and pose.median <= as_written(trial.window)
    window = trial.window
    if not trial.whole:
        window, pose = _inside(subject, trial, pose, mesh)
    count = window.lattice.count
    cut = "" if trial.whole else "whole cells of a piece cut across cells, "
    whole_sheet = count == design.lattice.count and trial.whole
    which = (
        "all of the design" if whole_sheet else "which of the design's cannot be determined, they are alike"
    )
    if not whole_sheet and cells_of is not None:
        which = _own_cells(cells_of, window, pose) or which
    note = f"read in {pose.unit}, {cut}{count[0]} x {count[1]} cells ({which})"
    checks = [_pose_check(design, subject, trial.window, window, pose, own), handed]
    if pose.untouched:
        return Placed(window, mesh, pose.factor, trial.present, pose, trial.whole, exact, note, checks, mesh)
    note += f"; {_pose_words(pose, design.unit)}"
    placed = moved(mesh, pose)
    return Placed(window, placed, 1.0, trial.present, pose, trial.whole, exact, note, checks, mesh)


def _pose_check(
    design: Design, subject: Subject, tried: Window, window: Window, pose: PartPose, own: bool
) -> Check:
    """Judge the pose of a part, the quality of its fit, and whether the pose is allowed.

    tried, window : with the cells of the trial, and with those that the part holds
    """
    limit = design.check.pose * min(tried.lattice.pitch)
    state: State = "pass" if pose.residual <= limit else "fail"
    pose_in_detail = {name: getattr(pose, name) for name in ("turn", "move", "scale", "unit")}
    sentence = (
        f"{_pose_words(pose, design.unit)}; the exact faces are then {pose.residual:.3g} {design.unit} off"
        " (robust rms)"
    )
    if state == "pass" and turned_by(pose.turn) > TURNED:
        state = "fail" if own else "warn"
        sentence += (
            f"; its box lies as the design's does, but {_turned_words(pose.turn)}"
            if own
            else "; it works when it is mounted turned"
        )
    return POSE.check(
        state,
        sentence,
        pose.residual,
        limit,
        unit=design.unit,
        subject=subject.name,
        limit_source=other(f"{design.check.pose:g} of the pitch"),
        detail=pose_in_detail | {"cells": window.lattice.count},
    )


def _pose_words(pose: PartPose, unit: str) -> str:
    """Text of the pose for a person."""
    if pose.untouched:
        return "it lies as the design does"
    names = "xyz"
    parts = []
    rest = turned_by(pose.turn @ pose.axes.T)
    if rest > TURNED:  # no axis permutation describes the turn
        parts.append(_askew_words(pose.turn))
    else:
        images = [
            f"{names[j]} → {'-' if pose.axes[i, j] < 0 else ''}{names[i]}"
            for j in range(3)
            for i in range(3)
            if pose.axes[i, j]
        ]
        if not np.array_equal(pose.axes, np.eye(3)):
            parts.append("axes turned: " + ", ".join(images))
        if rest > 1e-7:
            parts.append(f"turned by {degrees(rest):.3g} deg")
    if pose.move.any():
        parts.append("moved by " + ", ".join(f"{v:.4g}" for v in pose.move) + f" {unit}")
    if pose.scale != 1.0:
        parts.append(f"scaled by {pose.scale:.6g}")
    return "; ".join(parts) or "it lies as the design does"


def turned_by(turn: Floats) -> float:
    """Angle (radians) of a rotation (3, 3); for a mirrored one, that of the rotation after reversing z."""
    proper = turn @ np.diag([1.0, 1.0, np.sign(np.linalg.det(turn))])
    across = np.array([proper[2, 1] - proper[1, 2], proper[0, 2] - proper[2, 0], proper[1, 0] - proper[0, 1]])
    return float(np.arctan2(np.linalg.norm(across), np.trace(proper) - 1.0))


def _askew_words(turn: Floats) -> str:
    """Text of the axis and angle of a rotation; for a mirrored part, of the rotation after reversing z."""
    proper = turn @ np.diag([1.0, 1.0, np.sign(np.linalg.det(turn))])
    across = np.array([proper[2, 1] - proper[1, 2], proper[0, 2] - proper[2, 0], proper[1, 0] - proper[0, 1]])
    length = float(np.linalg.norm(across))
    angle = degrees(turned_by(turn))
    if length < 1e-9:
        return f"turned by {angle:.3g} deg"
    axis = ", ".join(f"{v:.3g}" for v in across / length)
    return f"turned by {angle:.4g} deg about ({axis})"


def _turned_words(turn: Floats) -> str:
    """Text of the error in making of a part that lies in the design's own frame but fits only when turned."""
    if turn[2, 2] < 0.0:
        return "it fits only upside down: the arrays are exchanged, or the file was turned over"
    return (
        "it fits only turned about the sheet's normal: tilt or offset have the other sign, or the file was"
        " turned"
    )


def moved(mesh: FileMesh, pose: PartPose) -> FileMesh:
    """The mesh in the design's frame and size; facets still face outward."""
    linear = pose.factor * pose.turn.T / pose.scale
    parts = []
    for part in mesh.parts:
        places = np.concatenate(
            [part.placements[:, :3] @ linear, (part.placements[:, 3:] @ linear) + pose.move], axis=1
        )
        parts.append(Part(part.name, part.vertices, part.triangles, part.soup, None, put(places)))
    return FileMesh(mesh.format, tuple(parts), None, mesh.name)


def _own_cells(whole: Window, window: Window, pose: PartPose) -> str:
    """Text of the design's cells in a piece that lies in the design's own frame; "" for other pieces."""
    if turned_by(pose.turn) > 1e-4 or pose.mirrored or abs(pose.scale - 1.0) > 1e-3:
        return ""
    lattice = whole.lattice
    centres = window.lattice.centres(window.lattice.cells()) - pose.move[:2]
    cell, x, y = lattice.locate(centres[:, 0], centres[:, 1])
    room = 1e-3 * min(lattice.pitch)
    if abs(pose.move[2]) > room or np.hypot(x, y).max() > room or not lattice.contains(cell).all():
        return ""
    (i0, j0), (i1, j1) = cell.min(axis=0), cell.max(axis=0)
    return f"cells {i0} … {i1}, {j0} … {j1} of the design, as it lies"


def _inside(subject: Subject, trial: Trial, pose: PartPose, mesh: FileMesh) -> tuple[Window, PartPose]:
    """The window with the whole cells that a piece holds, and the pose that places the piece onto them."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for chunk in mesh.chunks():
        flat = pose.onto_design(chunk.reshape(-1, 3))[:, :2]
        low, high = np.minimum(low, flat.min(axis=0)), np.maximum(high, flat.max(axis=0))
    lattice = trial.window.lattice
    room = 1e-3 * min(lattice.pitch)
    tile = lattice.tile()
    first, last = tile.min(axis=0), tile.max(axis=0)
    cells = lattice.cells()
    inside = np.ones(len(cells), dtype=bool)
    for body in trial.window.bodies:
        for face in (body.front, body.back):
            if face.array is not None and body.name in trial.present:
                centres = lattice.centres(cells) + np.asarray(trial.window.shifts[face.array])
                inside &= (centres + first >= low - room).all(axis=1) & (centres + last <= high + room).all(
                    axis=1
                )
    # columns as a person counts them: the rows of a hexagonal sheet step back by half a cell each
    column = cells[:, 0] + (cells[:, 1] // 2 if lattice.hexagonal else 0)
    rows = np.unique(cells[inside, 1])
    if lattice.hexagonal and len(rows) and rows[0] % 2:
        rows = rows[1:]
    common = [set(column[inside & (cells[:, 1] == row)].tolist()) for row in rows]
    columns = sorted(set.intersection(*common)) if common else []
    if not columns:
        raise CannotRegister(f"{subject.name} is a piece of the design without one whole cell")
    block = np.isin(column, columns) & np.isin(cells[:, 1], rows)
    middle = lattice.centres(cells[block]).mean(axis=0)
    window = trial.window.with_cells((len(columns), len(rows)))
    return window, replace(pose, move=pose.move - np.array([*middle, 0.0]))
