"""Search for a pose: every unit and turn that gives the design's box, fitted to its faces."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from math import floor
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.base.vectors import rotated_by
from clacad.exporting.formats.registry import kind_of
from clacad.exporting.roles import Role
from clacad.formats.mesh.file_mesh import FileMesh
from clacad.judging.cell_triangles import levels
from clacad.judging.delivery import Subject
from clacad.judging.face_deviation import FaceDistance, distance_to_faces, drawn_in
from clacad.judging.part_frames import PartFrame, Sample
from clacad.judging.unit_and_cells import FACTORS, SAME_EXTENT, CannotRegister, fitting_window, held_bodies
from clacad.sheet.feasibility import body_range
from clacad.sheet.volume_and_extent import whole_extent
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.design import Design


TRIALS = 6
"""Number of turns of each handedness that are fitted; the others have larger distances before the fit."""

CUT_TRIALS = 8
"""Number of turns for a piece cut across cells, whose position does not follow from its box."""

PIECE_STRIDE = 4
"""Every n-th point is used to choose the nearest candidate position of a piece."""

STRAY = 0.002
"""Difference of the share of points on no face up to which two fits are equally good."""

STEPS = 12
PHASES = 6
"""Positions per side tried within a cell, for a piece that was not cut along cell borders."""

AS_WRITTEN = 1e-5
"""Median distance over the pitch below which a file lies as written and is judged to rounding."""


@dataclass(frozen=True, eq=False)
class PartPose:
    """Similarity from a file to the design: x ↦ scale · turn · x · factor + move.

    unit : Name of the file's unit; factor : design units per file unit.
    axes : (3, 3). The nearest axis permutation (a signed permutation matrix), det −1 if mirrored.
    turn : (3, 3). The rotation itself.
    scale : Size of the part over the design's.
    move : (3,) lengths
    residual : length. Robust rms distance of the part's corners from the design's faces.
    median : length. Median distance of the corners.
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
        """Whether the file's numbers equal the design's, apart from the unit."""
        return bool(np.array_equal(self.turn, np.eye(3))) and self.scale == 1.0 and not self.move.any()

    def onto_design(self, points: Floats) -> Floats:
        """File points (…, 3) in the sheet frame of the design, scaled to the design's size."""
        return np.asarray((points * self.factor) @ (self.turn.T / self.scale) + self.move)


@dataclass(frozen=True, eq=False)
class Trial:
    """A part in one unit, turn and position, not fitted: points, facing, inward (n, 3) in design units."""

    unit: str
    factor: float
    axes: Floats
    frame: PartFrame
    window: Window
    present: tuple[str, ...]
    whole: bool
    points: Floats
    facing: Floats
    inward: Floats
    onto: Floats
    move: Floats
    between: Floats
    residual: float

    def off(self, turn: Floats, scale: float, move: Floats) -> FaceDistance:
        """Distances of the part from the faces after a similarity transform."""
        return distance_to_faces(
            self.window,
            self.points @ turn.T / scale + move,
            self.facing @ turn.T,
            self.present,
            self.between,
            self.inward @ turn.T,
        )


def robust(distance: Floats) -> float:
    """Rms of distances (n,) that is insensitive to a tenth of outliers; infinite where too few are known."""
    known = np.abs(distance[np.isfinite(distance)])
    if len(known) < max(32, len(distance) // 20):
        return np.inf
    return float(1.4826 * np.median(known)) + 0.1 * float(
        np.sqrt(np.mean(np.sort(known)[: int(0.9 * len(known))] ** 2))
    )


# -- trials ---------------------------------------------------------------------------------------------
def _axes() -> Iterator[Floats]:
    """The 48 signed permutations, the identity first."""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            made = np.zeros((3, 3))
            made[range(3), list(order)] = signs
            yield made


def order_of(turn: Floats) -> int:
    """Deviation of a turn from the identity, in thousandths; the smallest value wins a tie."""
    return int(round(1e3 * (3.0 - float(np.trace(turn)))))


def all_trials(
    design: Design,
    whole: Window,
    fixed: bool,
    subject: Subject,
    mesh: FileMesh,
    sample: Sample,
    frame: PartFrame,
) -> Iterator[Trial]:
    """Every unit and turn of a frame's axes that gives the design's box, with its distance before any fit."""
    spans, between = [body_range(whole, body) for body in whole.bodies], levels(whole)
    heights = [high - low for low, high in (whole.z_range, *spans)]
    few = slice(None, None, max(1, len(sample.corners) // 3000))
    points, looks, inward = (a[few] @ frame.turn.T for a in (sample.corners, sample.facing, sample.inward))
    for (name, metres), axes in product(units_of(mesh), list(_axes())):
        factor = metres / design.unit_m
        size = np.abs(axes) @ frame.extent * factor
        made = _fits(design, whole, fixed, heights, size)
        if made is None:
            continue
        window, cut = made
        here, way = points @ axes.T * factor, looks @ axes.T
        told = drawn_in(window, inward @ axes.T * factor)
        middle = axes @ frame.centre * factor
        places = [
            (present, onto, move)
            for present in held_bodies(window, subject, float(size[2]))
            for onto in [_onto(window, spans, present, middle)]
            for move in _moves(window, onto, cut, axes if frame.straight else None)
        ]
        some = slice(None, None, PIECE_STRIDE if cut else 1)
        for present, onto, move in places:
            off = distance_to_faces(window, here[some] + move, way[some], present, between, told[some])
            left = robust(off.distance)
            yield Trial(
                name,
                factor,
                axes,
                frame,
                window,
                present,
                not cut,
                here,
                way,
                told,
                onto,
                move,
                between,
                left,
            )


def _states_unit(mesh: FileMesh) -> bool:
    """Whether every reader interprets the unit of a mesh file alike."""
    kind = kind_of(mesh.format)
    return kind is not None and kind.states_unit


def units_of(mesh: FileMesh) -> list[tuple[str, float]]:
    """Names and metres of the candidate units of a file."""
    return [("its own unit", mesh.unit)] if mesh.unit is not None and _states_unit(mesh) else list(FACTORS)


def _fits(
    design: Design, whole: Window, fixed: bool, heights: Sequence[float], size: Floats
) -> tuple[Window, bool] | None:
    """The design with the cells of a box of this size, and whether it cuts cells; None if nothing fits."""
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
    """Displacement (3,) from the middle of a box to the middle of the design's box."""
    held = replace(window, bodies=tuple(b for b in window.bodies if b.name in present))
    x0, x1, y0, y1 = whole_extent(held)
    mine = [r for r, body in zip(spans, window.bodies, strict=True) if body.name in present]
    z = 0.5 * (min(r[0] for r in mine) + max(r[1] for r in mine))
    return np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1), z]) - middle


def _moves(window: Window, onto: Floats, cut: bool, axes: Floats | None) -> list[Floats]:
    """Candidate displacements: none (the file's frame), box onto box, for a cut piece positions in a cell."""
    if not cut:
        reach = 1e-3 * min(window.lattice.pitch)
        own = axes is not None and np.array_equal(axes, np.eye(3)) and bool((np.abs(onto) <= reach).all())
        return [np.zeros(3)] if own else [onto]
    a1, a2 = np.asarray(window.lattice.a1), np.asarray(window.lattice.a2)
    parts = (np.arange(PHASES) + 0.5) / PHASES - 0.5
    return [onto + np.array([*(u * a1 + v * a2), 0.0]) for u in parts for v in parts]


def no_match(design: Design, whole: Window, subject: Subject, mesh: FileMesh, extent: Floats) -> str:
    """Text of the size of a part that fits the design in no unit and turn; extent (3,) in the file's unit."""
    x0, x1, y0, y1 = whole_extent(whole)
    size = " x ".join(f"{v:.4g}" for v in extent)
    want = " x ".join(
        f"{v * millimetres(design.unit_m):.4g}" for v in (x1 - x0, y1 - y0, np.subtract(*whole.z_range[::-1]))
    )
    if mesh.unit is not None and _states_unit(mesh):
        return (
            f"{subject.name} measures {size} in units of {mesh.unit:g} m and the design {want} mm, whichever"
            " way it is turned"
        )
    tried = ", ".join(name for name, _ in FACTORS)
    hint = "; a surface of one side is read as a map: state its unit, such as --unit mm"
    return (
        f"{subject.name} measures {size} and the design {want} mm; in none of the units {tried}, turned any"
        f" way, are they the same part or a piece of it{hint if subject.role is Role.SCAN else ''}"
    )


# -- fit ------------------------------------------------------------------------------------------------
Fit = tuple[Trial, PartPose]


def fitted(trial: Trial) -> Fit:
    """Fit rotation, displacement and scale by least squares, point to plane, outliers weighted (Huber)."""
    points = trial.points
    turn, scale, move = np.eye(3), 1.0, trial.move.copy()
    best = (trial.residual, turn, scale, move)
    for _ in range(STEPS):
        here = points @ turn.T / scale + move
        off = trial.off(turn, scale, move)
        known = np.flatnonzero(off.known)
        if len(known) < 32:
            break
        residual = robust(off.distance)
        if residual < best[0]:
            best = (residual, turn, scale, move)
        change = _step(here[known], off.normal[known], off.distance[known])
        pivot = here[known].mean(axis=0)
        small = rotated_by(*change[:3])
        grown = 1.0 + change[6]
        turn, scale = small @ turn, scale / grown
        move = grown * (small @ (move - pivot)) + pivot + change[3:6]
        if (
            np.abs(change[:3]).max() < 1e-9
            and np.abs(change[3:6]).max() < 1e-9 * trial.window.lattice.circumradius
        ):
            break
    residual = robust(trial.off(turn, scale, move).distance)
    if residual < best[0]:
        best = (residual, turn, scale, move)
    residual, turn, scale, move = best
    if trial.frame.straight and not trial.move.any():
        own = _median(trial.off(np.eye(3), 1.0, trial.move).distance)
        if own <= as_written(trial.window) or trial.residual <= 1.2 * residual:  # the fit adds nothing
            residual, turn, scale, move = trial.residual, np.eye(3), 1.0, trial.move
    middle = _median(trial.off(turn, scale, move).distance)
    total = turn @ trial.axes @ trial.frame.turn
    axes = trial.axes if trial.frame.straight else nearest_axes(total)
    return trial, PartPose(trial.unit, trial.factor, axes, total, scale, move, residual, middle)


def nearest_axes(turn: Floats) -> Floats:
    """The signed axis permutation (3, 3) nearest to a rotation, mirrored if the rotation is."""
    hand = np.sign(np.linalg.det(turn))
    alike = [axes for axes in _axes() if np.linalg.det(axes) * hand > 0.0]
    return max(alike, key=lambda axes: round(float((axes * turn).sum()), 9))


def worth_fitting(trials: Sequence[Trial]) -> list[Trial]:
    """Nearest trials of each handedness; trials of equal distance are ordered by the smallest turn.

    Of the positions tried for a piece in one turn only the best is kept. Otherwise a wrong turn in a good
    position could displace the right turn in a bad one.
    """
    best: dict[tuple[object, ...], Trial] = {}
    for trial in trials:
        key = (trial.unit, trial.present, trial.axes.tobytes())
        if key not in best or trial.residual < best[key].residual:
            best[key] = trial
    found: list[Trial] = []
    for hand in (1.0, -1.0):
        mine = [t for t in best.values() if np.linalg.det(t.axes) * hand > 0.0]
        if mine:
            level = _equal(min(t.residual for t in mine), mine[0].window)
            mine.sort(key=lambda t: (max(t.residual, level), order_of(t.axes @ t.frame.turn), t.residual))
            found += mine[: TRIALS if mine[0].whole else CUT_TRIALS]
    return found


def _equal(least: float, window: Window) -> float:
    """Residual up to which fits count as equally good as the best fit."""
    return max(1.05 * least + 1e-7 * min(window.lattice.pitch), as_written(window))


def _median(distance: Floats) -> float:
    """Median of the known distances (n,); infinite where none is known."""
    known = np.abs(distance[np.isfinite(distance)])
    return float(np.median(known)) if len(known) else np.inf


def as_written(window: Window) -> float:
    """Median distance (length) up to which a file lies as written: float32 corners, or 1e-5 of a pitch."""
    reach = max(abs(v) for v in (*whole_extent(window), *window.z_range))
    return max(AS_WRITTEN * min(window.lattice.pitch), 2.0**-22 * reach)


def _step(points: Floats, normal: Floats, distance: Floats) -> Floats:
    """Rotation vector, displacement and growth (7,) that minimize the distances (n,) of points (n, 3)."""
    about = points - points.mean(axis=0)
    size = float(np.abs(about).max())
    rows = np.column_stack(
        [np.cross(about, normal) / size, normal, np.einsum("ij,ij->i", about, normal)[:, None] / size]
    )
    width = 1.4826 * float(np.median(np.abs(distance - np.median(distance)))) + 1e-300
    weight = np.sqrt(np.minimum(1.0, 1.5 * width / np.maximum(np.abs(distance), 1e-300)))
    rows = rows * weight[:, None]
    # seven unknowns of similar size: normal equations; unknowns that the faces do not determine stay 0
    solved = np.linalg.pinv(rows.T @ rows, rcond=1e-12, hermitian=True) @ (rows.T @ (-distance * weight))
    solved[:3] /= size
    solved[6] /= size
    limit = np.array([0.05] * 3 + [0.25 * size] * 3 + [0.05])
    return np.asarray(np.clip(solved, -limit, limit))


def best_of(fits: Sequence[Fit]) -> Fit:
    """Fit with the smallest residual; among equals, to rounding of the file, that of smallest turn."""
    least = min(pose.residual for _, pose in fits)
    level = _equal(least, fits[0][0].window)
    equal = [f for f in fits if f[1].residual <= level]
    if len(equal) > 1:  # lenses shifted by a pitch coincide, except at the rim
        strays = [_astray(f, 10.0 * level) for f in equal]
        equal = [f for f, stray in zip(equal, strays, strict=True) if stray <= min(strays) + STRAY]
    return min(equal, key=lambda f: (order_of(f[1].turn), f[1].residual))


def _astray(fit: Fit, level: float) -> float:
    """Share of the points of a part that lie on no face of the design."""
    trial, pose = fit
    turn = pose.turn @ trial.frame.turn.T @ trial.axes.T
    off = trial.off(turn, pose.scale, pose.move)
    flat = off.face >= 0
    near = np.abs(off.distance) <= level  # NaN is False
    return 1.0 - float(near[flat].mean()) if flat.any() else 1.0


def one_unit(subject: Subject, fits: Sequence[Fit], best: Fit, pitch: float) -> None:
    """Refuse a part that fits equally well in two units; pitch in design units."""
    good = {f[1].unit for f in fits if f[1].residual <= max(2.0 * best[1].residual, 1e-6 * pitch)}
    if len(good) > 1:
        raise CannotRegister(
            f"{subject.name} is the design in {' as well as in '.join(sorted(good))}: give the cells"
            " (--cells), or a format that states its unit"
        )
