"""Where a part that came back lies in its file: unit, turn, mirror, place, scale, and how many cells it holds.

A file without a manifest may be a scan, a slicer's repair, a piece cut from the sheet. Its triangles are tried in
every unit and in the 24 proper turns of the axes (and, to tell a mirrored part, in the 24 improper ones) that make
its box the design's; the best are fitted to the exact faces by least squares, point to plane, robustly.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations, product
from math import degrees, floor
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.export.filemesh import FileMesh, Part
from clacad.export.truth import whole_extent
from clacad.feasibility import body_range
from clacad.prescription import prescribe
from clacad.sheet import Window
from clacad.verify.checks import Check, State
from clacad.verify.files import (
    FACTORS,
    SAME_EXTENT,
    STATED,
    CannotRegister,
    Subject,
    fitting_window,
    present_bodies,
)
from clacad.verify.gather import levels
from clacad.verify.sides import Floats, off_faces

if TYPE_CHECKING:
    from clacad.design import Design

SAMPLE = 4000
"""Facets whose corners are fitted."""

TRIALS = 6
"""Turns of each handedness that are fitted; the others are worse before the fit already."""

INWARD = 1e-6
"""Part of the way to a facet's middle by which its corners are drawn in before they are located."""

STEPS = 12
PHASES = 6
"""Places a side tried within a cell, for a piece that was not cut along cell borders."""

AS_WRITTEN = 1e-5
"""Median distance over the pitch below which a file lies as it was written and is judged to rounding."""

BETTER = 0.7
"""A mirrored fit must leave less than this part of the best proper one's residual to be called a mirrored part."""


@dataclass(frozen=True, eq=False)
class Pose:
    """Similarity from a file to the design: x ↦ scale · turn · x · factor + move.

    unit : str
        Name of the file's unit; factor : design units per file unit.
    axes : (3, 3)
        The nearest turn of the axes (a signed permutation), det −1 if mirrored.
    turn : (3, 3)
        With the small rotation found by the fit.
    scale : float
        Size of the part over the design's.
    move : (3,) lengths
    residual : float, length
        Robust rms distance of the part's corners from the design's faces.
    median : float, length
        Half of them are nearer than this.
    """

    unit: str
    factor: float
    axes: Floats
    turn: Floats
    scale: float
    move: Floats
    residual: float
    median: float

    @property
    def mirrored(self) -> bool:
        """Whether the part is the mirror image of the design."""
        return bool(np.linalg.det(self.axes) < 0.0)

    @property
    def untouched(self) -> bool:
        """Whether the file's numbers are the design's, but for the unit."""
        return bool(np.array_equal(self.turn, np.eye(3))) and self.scale == 1.0 and not self.move.any()

    def onto_design(self, points: Floats) -> Floats:
        """File points (…, 3) in the sheet frame of the design, scaled to its size."""
        return np.asarray((points * self.factor) @ (self.turn.T / self.scale) + self.move)


@dataclass(frozen=True, eq=False)
class Placed:
    """A part in the design's frame.

    window : Window
        With the cells the part holds.
    mesh : FileMesh
        In design units and the sheet frame, at the design's size; the file itself where it lies as written.
    factor : float
        Design units per unit of `mesh`.
    present : names of the bodies it holds
    pose : Pose
    whole : bool
        It was cut along cell borders: its sides are the design's.
    exact : bool
        It lies as written, to rounding.
    note : str
        What was found, in words.
    checks : list of Check
        pose and handedness.
    """

    window: Window
    mesh: FileMesh
    factor: float
    present: tuple[str, ...]
    pose: Pose
    whole: bool
    exact: bool
    note: str
    checks: list[Check] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class _Trial:
    unit: str
    factor: float
    axes: Floats
    window: Window
    present: tuple[str, ...]
    whole: bool
    points: Floats
    facing: Floats
    onto: Floats
    move: Floats
    between: Floats
    residual: float

    def off(self, points: Floats, facing: Floats) -> Floats:
        return off_faces(self.window, points, facing, self.present, self.between).distance


def robust(distance: Floats) -> float:
    """Rms of distances (n,) that a tenth of wild ones cannot spoil; infinite where too few are known."""
    known = np.abs(distance[np.isfinite(distance)])
    if len(known) < max(32, len(distance) // 20):
        return np.inf
    return float(1.4826 * np.median(known)) + 0.1 * float(
        np.sqrt(np.mean(np.sort(known)[: int(0.9 * len(known))] ** 2))
    )


def place(design: Design, subject: Subject, mesh: FileMesh, cells: Window | None) -> Placed:
    """Find where a part lies.

    Parameters
    ----------
    design : Design
    subject : Subject
    mesh : FileMesh
    cells : Window or None
        With the cells that someone says the file holds.

    Raises
    ------
    CannotRegister
        In no unit and turn the part is this design, or in two units alike.
    """
    whole = prescribe(design) if cells is None else cells
    corners, facing, extent, centre, lean = _sampled(mesh)
    trials = list(_trials(design, whole, cells is not None, subject, mesh, corners, facing, extent, centre))
    if not trials:
        raise CannotRegister(_no_match(design, whole, subject, mesh, extent))
    fits = [
        _fitted(trial, lean)
        for hand in (1.0, -1.0)
        for trial in sorted(
            (t for t in trials if np.linalg.det(t.axes) * hand > 0.0),
            key=lambda t: (t.residual, _order(t.axes)),
        )[:TRIALS]
    ]
    proper = [f for f in fits if not f[1].mirrored]
    mirrored = [f for f in fits if f[1].mirrored]
    best = _best(proper)
    twin = _best(mirrored) if mirrored else None
    pitch = min(whole.lattice.pitch)
    _one_unit(subject, proper, best, pitch)
    handed = _handedness(subject, best[1], None if twin is None else twin[1], pitch)
    # a file whose box lies where the design's does, the arrays' displacement apart, was written in its frame
    room = np.array([*(2.0 * np.abs(whole.shifts[1]) + 1e-3 * pitch), 1e-3 * pitch])
    own = any(
        np.array_equal(t.axes, np.eye(3)) and t.unit == best[0].unit and bool((np.abs(t.onto) <= room).all())
        for t in trials
    )
    return _placed(design, subject, mesh, best, handed, own)


# -- trials ---------------------------------------------------------------------------------------------


def _sampled(mesh: FileMesh) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Corners (n, 3) and outward normals (n, 3) of some facets, straightened; extent and centre of the box; the turn
    (3, 3) that straightened them.
    """
    stride = max(1, mesh.facet_count // SAMPLE)
    kept, areas, whole, at = [], np.zeros((3, 3)), np.zeros(3), 0
    for chunk in mesh.chunks():
        normal = 0.5 * np.cross(chunk[:, 1] - chunk[:, 0], chunk[:, 2] - chunk[:, 0])
        area = np.linalg.norm(normal, axis=1)
        for k in range(3):  # vector area, and area, of the sides that look along ±k
            looks = np.abs(normal[:, k]) > 0.9 * area
            areas[k] += (normal[looks] * np.sign(normal[looks, k : k + 1])).sum(axis=0)
            whole[k] += float(area[looks].sum())
        kept.append(chunk[(-at) % stride :: stride])
        at += len(chunk)
    corners = np.concatenate(kept)
    lean = _lean(areas, whole)
    corners = corners @ lean.T
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for chunk in mesh.chunks():
        turned = chunk.reshape(-1, 3) @ lean.T
        low, high = np.minimum(low, turned.min(axis=0)), np.maximum(high, turned.max(axis=0))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    good = length > 0.0
    facing = np.repeat(normal[good] / length[good, None], 3, axis=0)
    # a corner on a border belongs to two columns: a hair towards the facet's middle decides
    corners = corners + INWARD * (corners.mean(axis=1, keepdims=True) - corners)
    return corners[good].reshape(-1, 3), facing, high - low, 0.5 * (low + high), lean


def _lean(areas: Floats, whole: Floats) -> Floats:
    """Turn (3, 3) that sets the sides of the part along the axes; the identity where they stand there already.

    The two flattest sides give it: lenses may lean, walls do not.

    areas : (3, 3) vector areas of the sides that look along ±x, ±y, ±z; whole : (3,) their areas
    """
    size = np.linalg.norm(areas, axis=1)
    flat = np.where(whole > 0.0, size / np.where(whole > 0.0, whole, 1.0), 0.0)
    a, b = sorted(int(k) for k in np.argsort(-flat, kind="stable")[:2])
    if flat[a] == 0.0 or flat[b] == 0.0:
        return np.eye(3)
    unit = np.where(size[:, None] > 0.0, areas / np.where(size > 0.0, size, 1.0)[:, None], np.eye(3))
    if max(float(np.abs(unit[k] - np.eye(3)[k]).max()) for k in (a, b)) < 1e-3:
        return np.eye(3)
    first = unit[a]
    second = unit[b] - first * (unit[b] @ first)
    second = second / np.linalg.norm(second)
    third = np.cross(first, second) * (1.0 if (b - a) % 3 == 1 else -1.0)
    rows = np.zeros((3, 3))
    rows[a], rows[b], rows[3 - a - b] = first, second, third
    return rows


def _axes() -> Iterator[Floats]:
    """The 48 signed permutations, the identity first."""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            made = np.zeros((3, 3))
            made[range(3), list(order)] = signs
            yield made


def _order(axes: Floats) -> int:
    """How far a turn of the axes is from none: ties take the least."""
    return int(round(3.0 - float(np.trace(axes))))


def _trials(
    design: Design, whole: Window, fixed: bool, subject: Subject, mesh: FileMesh, corners: Floats, facing: Floats,
    extent: Floats, centre: Floats,
) -> Iterator[_Trial]:  # fmt: skip
    """Every unit and turn that makes the box of the part the design's, with its distance before any fit."""
    heights = [whole.z_range[1] - whole.z_range[0]]
    spans = [body_range(whole, body) for body in whole.bodies]
    between = levels(whole)
    heights += [high - low for low, high in spans]
    own = [("its own unit", mesh.unit)] if mesh.unit is not None and mesh.format in STATED else list(FACTORS)
    few = slice(None, None, max(1, len(corners) // 3000))
    for (name, metres), axes in product(own, list(_axes())):
        factor = metres / design.unit_m
        size = np.abs(axes) @ extent * factor
        made = _fits(design, whole, fixed, heights, size)
        if made is None:
            continue
        window, cut = made
        present = present_bodies(window, subject, float(size[2]))
        points, looks = corners[few] @ axes.T * factor, facing[few] @ axes.T
        middle = axes @ centre * factor
        onto = _onto(window, spans, present, middle)
        for move in _moves(window, onto, cut, axes):
            off = off_faces(window, points + move, looks, present, between)
            yield _Trial(
                name,
                factor,
                axes,
                window,
                present,
                not cut,
                points,
                looks,
                onto,
                move,
                between,
                robust(off.distance),
            )


def _fits(
    design: Design, whole: Window, fixed: bool, heights: Sequence[float], size: Floats
) -> tuple[Window, bool] | None:
    """The design with the cells of a box of this size, and whether it is a piece cut across cells; None if neither."""
    window = fitting_window(design, whole, fixed, heights, size)
    if window is not None:
        return window, False
    if fixed or not any(abs(size[2] / h - 1.0) <= SAME_EXTENT for h in heights):
        return None
    x0, x1, y0, y1 = whole_extent(whole)
    steps = np.array([design.lattice.pitch[0], whole.lattice.a2[1]])
    room = (1.0 + SAME_EXTENT) * np.array([x1 - x0, y1 - y0])
    if (size[:2] > room).any() or (size[:2] < 1.5 * steps).any():
        return None
    count = [floor(float(s) / float(p)) + 3 for s, p in zip(size[:2], steps, strict=True)]
    return whole.with_cells((count[0], count[1])), True


def _onto(
    window: Window, spans: Sequence[tuple[float, float]], present: Sequence[str], middle: Floats
) -> Floats:
    """Displacement (3,) from the middle of a box to the middle of the design's."""
    held = replace(window, bodies=tuple(b for b in window.bodies if b.name in present))
    x0, x1, y0, y1 = whole_extent(held)
    mine = [r for r, body in zip(spans, window.bodies, strict=True) if body.name in present]
    z = 0.5 * (min(r[0] for r in mine) + max(r[1] for r in mine))
    return np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1), z]) - middle


def _moves(window: Window, onto: Floats, cut: bool, axes: Floats) -> list[Floats]:
    """Displacements to try: none (the file's own frame), box onto box, and for a cut piece places within a cell."""
    if not cut:
        reach = 1e-3 * min(window.lattice.pitch)
        own = np.array_equal(axes, np.eye(3)) and bool((np.abs(onto) <= reach).all())
        return [np.zeros(3)] if own else [onto]
    a1, a2 = np.asarray(window.lattice.a1), np.asarray(window.lattice.a2)
    parts = (np.arange(PHASES) + 0.5) / PHASES - 0.5
    return [onto + np.array([*(u * a1 + v * a2), 0.0]) for u in parts for v in parts]


def _no_match(design: Design, whole: Window, subject: Subject, mesh: FileMesh, extent: Floats) -> str:
    x0, x1, y0, y1 = whole_extent(whole)
    size = " x ".join(f"{v:.4g}" for v in extent)
    want = " x ".join(
        f"{v * design.unit_m * 1e3:.4g}" for v in (x1 - x0, y1 - y0, np.subtract(*whole.z_range[::-1]))
    )
    if mesh.unit is not None and mesh.format in STATED:
        return f"{subject.name} measures {size} in units of {mesh.unit:g} m and the design {want} mm, whichever way it is turned"
    tried = ", ".join(name for name, _ in FACTORS)
    return (
        f"{subject.name} measures {size} and the design {want} mm; in none of the units {tried}, turned any way, are "
        "they the same part or a piece of it"
    )


# -- fit ------------------------------------------------------------------------------------------------

_Fit = tuple[_Trial, Pose]


def _fitted(trial: _Trial, lean: Floats) -> _Fit:
    """Least squares, point to plane: rotation, displacement and scale, wild points given less weight (Huber)."""
    points, looks = trial.points, trial.facing
    turn, scale, move = np.eye(3), 1.0, trial.move.copy()
    best = (trial.residual, turn, scale, move)
    for _ in range(STEPS):
        here = points @ turn.T / scale + move
        off = off_faces(trial.window, here, looks @ turn.T, trial.present, trial.between)
        known = np.flatnonzero(off.known)
        if len(known) < 32:
            break
        residual = robust(off.distance)
        if residual < best[0]:
            best = (residual, turn, scale, move)
        change = _step(here[known], off.normal[known], off.distance[known])
        pivot = here[known].mean(axis=0)
        small = _rotation(change[:3])
        grown = 1.0 + change[6]
        turn, scale = small @ turn, scale / grown
        move = grown * (small @ (move - pivot)) + pivot + change[3:6]
        if (
            np.abs(change[:3]).max() < 1e-9
            and np.abs(change[3:6]).max() < 1e-9 * trial.window.lattice.circumradius
        ):
            break
    residual = robust(trial.off(points @ turn.T / scale + move, looks @ turn.T))
    if residual < best[0]:
        best = (residual, turn, scale, move)
    residual, turn, scale, move = best
    straight = np.array_equal(lean, np.eye(3))
    if straight and not trial.move.any():
        own = _median(trial.off(points, looks))
        if own <= _as_written(trial.window) or trial.residual <= 1.2 * residual:  # the fit adds nothing
            residual, turn, scale, move = trial.residual, np.eye(3), 1.0, trial.move
    middle = _median(trial.off(points @ turn.T / scale + move, looks @ turn.T))
    pose = Pose(trial.unit, trial.factor, trial.axes, turn @ trial.axes @ lean, scale, move, residual, middle)
    return trial, pose


def _median(distance: Floats) -> float:
    """Half of the known distances (n,) are smaller; infinite where none is known."""
    known = np.abs(distance[np.isfinite(distance)])
    return float(np.median(known)) if len(known) else np.inf


def _as_written(window: Window) -> float:
    """Median distance (length) up to which a file lies as it was written: float32 corners, or a hair of a pitch."""
    reach = max(abs(v) for v in (*whole_extent(window), *window.z_range))
    return max(AS_WRITTEN * min(window.lattice.pitch), 2.0**-22 * reach)


def _step(points: Floats, normal: Floats, distance: Floats) -> Floats:
    """Rotation vector, displacement and growth (7,) that lessen the distances (n,) of points (n, 3) most."""
    about = points - points.mean(axis=0)
    size = float(np.abs(about).max())
    rows = np.column_stack(
        [np.cross(about, normal) / size, normal, np.einsum("ij,ij->i", about, normal)[:, None] / size]
    )
    width = 1.4826 * float(np.median(np.abs(distance - np.median(distance)))) + 1e-300
    weight = np.sqrt(np.minimum(1.0, 1.5 * width / np.maximum(np.abs(distance), 1e-300)))
    rows = rows * weight[:, None]
    # seven unknowns of like size: the normal equations, with what the faces do not fix left alone
    solved = np.linalg.pinv(rows.T @ rows, rcond=1e-12, hermitian=True) @ (rows.T @ (-distance * weight))
    solved[:3] /= size
    solved[6] /= size
    limit = np.array([0.05] * 3 + [0.25 * size] * 3 + [0.05])
    return np.asarray(np.clip(solved, -limit, limit))


def _rotation(vector: Floats) -> Floats:
    """Rotation (3, 3) by a rotation vector in radians (Rodrigues)."""
    x, y, z = vector
    angle = float(np.linalg.norm(vector))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle == 0.0:
        return np.eye(3)
    return np.asarray(
        np.eye(3) + np.sin(angle) / angle * cross + (1.0 - np.cos(angle)) / angle**2 * (cross @ cross)
    )


def _best(fits: Sequence[_Fit]) -> _Fit:
    """The least residual; among equals the least turn."""
    least = min(pose.residual for _, pose in fits)
    level = 1.05 * least + 1e-7 * min(fits[0][0].window.lattice.pitch)
    equal = [f for f in fits if f[1].residual <= level]
    return min(equal, key=lambda f: (_order(f[1].axes), f[1].residual))


def _one_unit(subject: Subject, fits: Sequence[_Fit], best: _Fit, pitch: float) -> None:
    good = {f[1].unit for f in fits if f[1].residual <= max(2.0 * best[1].residual, 1e-6 * pitch)}
    if len(good) > 1:
        raise CannotRegister(
            f"{subject.name} is the design in {' as well as in '.join(sorted(good))}: give the cells (--cells), or a "
            "format that states its unit"
        )


# -- what was found -------------------------------------------------------------------------------------


def _handedness(subject: Subject, best: Pose, twin: Pose | None, pitch: float) -> Check:
    common: dict[str, Any] = {
        "where": "file",
        "subject": subject.name,
        "relation": "<=",
        "unit": "design unit",
    }
    if twin is None:
        return Check("handedness", "not run", "no mirrored turn fits its box", required=False, **common)
    wrong = twin.residual < BETTER * best.residual and best.residual > AS_WRITTEN * pitch
    if wrong:
        sentence = (
            f"the part is the mirror image of the design: mirrored it fits to {twin.residual:.3g}, unmirrored only to "
            f"{best.residual:.3g}"
        )
        return Check("handedness", "fail", sentence, best.residual, twin.residual, **common)
    alike = abs(twin.residual - best.residual) <= 0.2 * best.residual + 1e-7 * pitch
    sentence = (
        "the design is its own mirror image: handedness cannot be wrong"
        if alike
        else f"unmirrored it fits to {best.residual:.3g}, mirrored to {twin.residual:.3g}"
    )
    return Check("handedness", "pass", sentence, best.residual, twin.residual, **common)


def _placed(design: Design, subject: Subject, mesh: FileMesh, best: _Fit, handed: Check, own: bool) -> Placed:
    trial, pose = best
    pitch = min(trial.window.lattice.pitch)
    limit = design.check.pose * pitch
    exact = trial.whole and pose.untouched and pose.median <= _as_written(trial.window)
    window = trial.window
    if not trial.whole:
        window, pose = _inside(subject, trial, pose, mesh)
    count = window.lattice.count
    cut = "" if trial.whole else "whole cells of a piece cut across cells, "
    whole_sheet = count == design.lattice.count and trial.whole
    which = "all of the design" if whole_sheet else "which of the design's cannot be told, they are alike"
    note = f"read in {pose.unit}, {cut}{count[0]} x {count[1]} cells ({which})"
    words = _pose_words(pose, design.unit)
    state: State = "pass" if pose.residual <= limit else "fail"
    sentence = f"{words}; the exact faces are then {pose.residual:.3g} {design.unit} off (robust rms)"
    if state == "pass" and not np.array_equal(pose.axes, np.eye(3)):
        state = "fail" if own else "warn"
        sentence += (
            f"; its box lies as the design's does, but {_turned_words(pose.axes)}"
            if own
            else "; it works when it is mounted turned"
        )
    check = Check(
        "pose", state, sentence, pose.residual, limit, design.unit, where="file", subject=subject.name,
        source=f"{design.check.pose:g} of the pitch",
        detail={"turn": pose.turn, "move": pose.move, "scale": pose.scale, "unit": pose.unit, "cells": count},
    )  # fmt: skip
    placed = mesh if pose.untouched else moved(mesh, pose)
    factor = pose.factor if pose.untouched else 1.0
    if not pose.untouched:
        note += f"; {words}"
    return Placed(window, placed, factor, trial.present, pose, trial.whole, exact, note, [check, handed])


def _pose_words(pose: Pose, unit: str) -> str:
    """The pose in a sentence a person can follow."""
    if pose.untouched:
        return "it lies as the design does"
    names = "xyz"
    parts = []
    if not np.array_equal(pose.axes, np.eye(3)):
        images = [
            f"{names[j]} → {'-' if pose.axes[i, j] < 0 else ''}{names[i]}"
            for j in range(3)
            for i in range(3)
            if pose.axes[i, j]
        ]
        parts.append("axes turned: " + ", ".join(images))
    rest = pose.turn @ pose.axes.T
    angle = float(np.arccos(np.clip(0.5 * (np.trace(rest) - 1.0), -1.0, 1.0)))
    if angle > 1e-7:
        parts.append(f"turned by {degrees(angle):.3g} deg")
    if pose.move.any():
        parts.append("moved by " + ", ".join(f"{v:.4g}" for v in pose.move) + f" {unit}")
    if pose.scale != 1.0:
        parts.append(f"scaled by {pose.scale:.6g}")
    return "; ".join(parts) or "it lies as the design does"


def _turned_words(axes: Floats) -> str:
    """What a part in the design's own frame that fits only when turned was made with."""
    if axes[2, 2] < 0.0:
        return "it fits only upside down: the arrays are exchanged, or the file was turned over"
    return "it fits only turned about the sheet's normal: tilt or offset have the other sign, or the file was turned"


def moved(mesh: FileMesh, pose: Pose) -> FileMesh:
    """The mesh in the design's frame and size; facets keep facing outward."""
    linear = pose.factor * pose.turn.T / pose.scale
    parts = []
    for part in mesh.parts:
        places = np.concatenate(
            [part.placements[:, :3] @ linear, (part.placements[:, 3:] @ linear) + pose.move], axis=1
        )
        parts.append(Part(part.name, part.vertices, part.triangles, part.soup, None, places))
    return FileMesh(mesh.format, tuple(parts), None, mesh.name)


def _inside(subject: Subject, trial: _Trial, pose: Pose, mesh: FileMesh) -> tuple[Window, Pose]:
    """The window with the whole cells that a piece holds, and the pose that sets the piece onto them."""
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
    # columns as a person counts them: the rows of a hexagonal sheet step back half a cell each
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
