"""Candidate frames of a part in any orientation: from the planes of its hull, and from its lenses.

The hull of a sheet has planes where the sheet has none: lenses of one array touch a plane, the cells of a row
end in one. Where the hull does not determine the turn about the normal (a disc, a piece sawn askew), the
lenses do: the slopes of the facets repeat with the pitch, so they interfere constructively only along the
lattice's own directions.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.base.vectors import doubled_normals
from clacad.formats.mesh.file_mesh import FileMesh
from clacad.judging.face_deviation import STEEP
from clacad.judging.unit_and_cells import CannotRegister

if TYPE_CHECKING:
    from clacad.sheet.window import Window


SAMPLE = 4000
"""Number of facets whose corners are fitted."""

HULL_POINTS = 300_000
"""Number of corners, evenly spread over the file, whose hull is computed; their box is accurate enough."""

TOGETHER = np.cos(np.radians(2.0))
"""Planes of the hull within this angle (its cosine) count as one."""

PLANES = 6
LEAST = 0.01
"""Part of the hull's area below which a plane is ignored."""

SQUARE = 0.05
"""Cosine of the angle up to which two planes count as perpendicular."""

FINENESS = 0.7
"""Step of the trial angles over the smallest angle that lenses at the rim resolve."""

ANGLES = 8192


@dataclass(frozen=True, eq=False)
class Sample:
    """Some facets of a file, evenly spread.

    corners : (n, 3) lengths, file unit. Three of each facet.
    facing : (n, 3). Outward unit normals of the facets.
    inward : (n, 3) lengths. From each corner to the middle of its facet.
    """

    corners: Floats
    facing: Floats
    inward: Floats


@dataclass(frozen=True, eq=False)
class PartFrame:
    """Candidate axes along which a part was made.

    turn : (3, 3). File → frame.
    extent, centre : (3,) lengths, file unit. Of the part's bounding box in the frame.
    straight : Whether these are the file's own axes.
    """

    turn: Floats
    extent: Floats
    centre: Floats
    straight: bool = False


VAST = 1e60
"""Coordinates beyond this or below its inverse are no part's in any unit; squared areas would overflow."""


def _refuse_vast(mesh: FileMesh, chunk: Floats) -> None:
    """Refuse corners (k, 3, 3) with coordinates that no part can have. Raises CannotRegister."""
    most = float(np.abs(chunk).max(initial=0.0))
    if most > VAST or 0.0 < most < 1.0 / VAST:
        text = f"{mesh.name or 'the file'} has coordinates of up to {most:.3g}: in no unit is that a part"
        raise CannotRegister(text)


def sampled(mesh: FileMesh) -> tuple[Sample, PartFrame]:
    """Some facets of a file, and its own axes, or the axes of its sides where these lean slightly."""
    stride = max(1, mesh.facet_count // SAMPLE)
    kept, areas, whole, at = [], np.zeros((3, 3)), np.zeros(3), 0
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for chunk in mesh.chunks():
        _refuse_vast(mesh, chunk)
        normal = 0.5 * doubled_normals(chunk)
        area = np.linalg.norm(normal, axis=1)
        for k in range(3):  # vector area, and area, of the sides that face along ±k
            looks = np.abs(normal[:, k]) > 0.9 * area
            areas[k] += (normal[looks] * np.sign(normal[looks, k : k + 1])).sum(axis=0)
            whole[k] += float(area[looks].sum())
        kept.append(chunk[(-at) % stride :: stride])
        at += len(chunk)
        low, high = np.minimum(low, chunk.min(axis=(0, 1))), np.maximum(high, chunk.max(axis=(0, 1)))
    corners = np.concatenate(kept)
    lean = _lean(areas, whole)
    straight = np.array_equal(lean, np.eye(3))
    frame = PartFrame(lean, high - low, 0.5 * (low + high), True) if straight else _boxed(mesh, lean)
    normal = doubled_normals(corners)
    length = np.linalg.norm(normal, axis=1)
    good = length > 0.0
    inward = (corners.mean(axis=1, keepdims=True) - corners)[good].reshape(-1, 3)
    facing = np.repeat(normal[good] / length[good, None], 3, axis=0)
    return Sample(corners[good].reshape(-1, 3), facing, inward), frame


def _boxed(mesh: FileMesh, turn: Floats) -> PartFrame:
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for chunk in mesh.chunks():
        turned = chunk.reshape(-1, 3) @ turn.T
        low, high = np.minimum(low, turned.min(axis=0)), np.maximum(high, turned.max(axis=0))
    return PartFrame(turn, high - low, 0.5 * (low + high))


def _lean(areas: Floats, whole: Floats) -> Floats:
    """Rotation (3, 3) that aligns the sides of the part with the axes; the identity where they are aligned.

    It follows from the two flattest sides: lenses may lean, walls do not.

    areas : (3, 3) vector areas of the sides that face along ±x, ±y, ±z; whole : (3,) their areas
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


# -- any orientation ------------------------------------------------------------------------------------
def frames(mesh: FileMesh, sample: Sample, window: Window, factors: Floats) -> Iterator[PartFrame]:
    """Candidate frames for a part that is not aligned with the axes of its file.

    window : The design; its lattice is searched for.
    factors : (m,). Candidate values of design units per file unit.
    """
    hull = _hull(mesh)
    if hull is None:
        return
    points, planes = hull
    made: list[Floats] = []
    for turn in _turns(planes, sample, points, window, factors):
        if any(_same_axes(turn, other) for other in made):
            continue
        made.append(turn)
        yield _frame_of(points, turn)


def sixths(mesh: FileMesh, turn: Floats) -> list[PartFrame]:
    """Frames at ±60° about the normal from a sheet's own frame (3, 3): a hexagonal lattice repeats at 60°."""
    hull = _hull(mesh)
    if hull is None:
        return []
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(turn))]) @ turn
    return [_frame_of(hull[0], _about_z(angle) @ proper) for angle in (np.pi / 3.0, -np.pi / 3.0)]


def _frame_of(points: Floats, turn: Floats) -> PartFrame:
    turned = points @ turn.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    return PartFrame(turn, high - low, 0.5 * (low + high))


def _turns(
    planes: Floats, sample: Sample, points: Floats, window: Window, factors: Floats
) -> Iterator[Floats]:
    """Candidate rotations (3, 3): along the lenses where a lattice is found, else along the part's sides."""
    for normal in planes:
        across = _frame(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
        thick = float(np.ptp(points @ normal))
        for factor in factors:
            if any(abs(thick * factor / height - 1.0) < 0.05 for height in _heights(window)):
                for angle in lattice_angles(window, sample, across, factor):
                    yield _about_z(-angle) @ across
    for number, first in enumerate(planes):
        for second in planes[number + 1 :]:
            if abs(float(first @ second)) < SQUARE:
                yield _frame(first, second)


def _heights(window: Window) -> list[float]:
    from clacad.sheet.feasibility import body_range

    spans = [window.z_range, *(body_range(window, body) for body in window.bodies)]
    return [high - low for low, high in spans]


def _frame(normal: Floats, side: Floats) -> Floats:
    """Rotation (3, 3) whose third row is `normal` and whose first row is as near `side` as possible."""
    first = side - normal * (normal @ side)
    first = first / np.linalg.norm(first)
    return np.array([first, np.cross(normal, first), normal])


def _about_z(angle: float) -> Floats:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _same_axes(one: Floats, other: Floats) -> bool:
    """Whether two frames differ only by a permutation of the axes (to a hundredth of a degree)."""
    between = np.abs(one @ other.T)
    return bool((between.max(axis=0) > 1.0 - 1.5e-8).all())


def _hull(mesh: FileMesh) -> tuple[Floats, Floats] | None:
    """Corners (h, 3) of the convex hull, and unit normals (k, 3) of its largest planes, the largest first.

    None where the file is flat.
    """
    from scipy.spatial import ConvexHull, QhullError

    stride = max(1, 3 * mesh.facet_count // HULL_POINTS)
    points = np.concatenate([chunk[::stride].reshape(-1, 3) for chunk in mesh.chunks()])
    middle = points.mean(axis=0)
    try:
        hull = ConvexHull(points - middle)
    except (QhullError, ValueError):
        return None
    corners = hull.points[hull.simplices]
    normal = hull.equations[:, :3]
    area = 0.5 * np.linalg.norm(doubled_normals(corners), axis=1)
    return points[hull.vertices], _planes(normal, area)


def _planes(normal: Floats, area: Floats) -> Floats:
    """Unit normals (k ≤ PLANES, 3) of the planes of largest area; both sides of the part count as one."""
    found = []
    left = np.ones(len(area), dtype=bool)
    for _ in range(PLANES):
        if not left.any():
            break
        seed = normal[np.flatnonzero(left)[int(np.argmax(area[left]))]]
        for _ in range(3):  # the seed may be that of a sliver
            near = left & (np.abs(normal @ seed) > TOGETHER)
            if not near.any():
                break
            total = (normal[near] * (np.sign(normal[near] @ seed) * area[near])[:, None]).sum(axis=0)
            seed = total / np.linalg.norm(total)
        left &= ~near
        found.append((float(area[near].sum()), seed))
    whole = float(area.sum())
    found.sort(key=lambda one: -one[0])
    return np.array([seed for size, seed in found if size > LEAST * whole]).reshape(-1, 3)


def lattice_angles(window: Window, sample: Sample, turn: Floats, factor: float) -> list[float]:
    """Angles (radians) by which the design's lattice may be turned about the third axis of a frame.

    A wave along a lattice direction, with the spacing of its rows as wavelength, samples one slope in every
    cell; along other directions the slopes cancel. The caller applies the lattice's own symmetry.
    """
    facing = sample.facing[::3] @ turn.T
    seen = np.abs(facing[:, 2]) > STEEP
    if seen.sum() < 64:
        return []
    place = sample.corners.reshape(-1, 3, 3).mean(axis=1)[seen] @ turn[:2].T * factor
    place = place - place.mean(axis=0)
    slope = -facing[seen, :2] / facing[seen, 2:]
    sides = [np.where((facing[seen, 2] > 0.0) == up, 1.0, 0.0) for up in (False, True)]
    waves = np.concatenate([slope * side[:, None] for side in sides], axis=1)
    for side in sides:  # the mean slope of a leaning face carries no information
        if side.any():
            waves -= np.where(side[:, None] > 0.0, (waves * side[:, None]).sum(axis=0) / side.sum(), 0.0)
    lattice = window.lattice
    rows = 2.0 * np.pi * np.linalg.inv(np.array([lattice.a1, lattice.a2])).T
    first = rows[0]
    wave = float(np.linalg.norm(first))
    reach = float(np.percentile(np.linalg.norm(place, axis=1), 95))
    count = int(min(ANGLES, max(64, np.ceil(np.pi * wave * reach / FINENESS))))
    angles = np.pi * np.arange(count) / count
    power = np.array([_power(place, waves, wave, angle) for angle in angles])
    best = float(angles[int(np.argmax(power))])
    near = best + np.linspace(-1.0, 1.0, 21) * np.pi / count
    fine = float(near[int(np.argmax([_power(place, waves, wave, angle) for angle in near]))])
    if max(power) < 4.0 * float(np.median(power)):
        return []  # nothing repeats with the pitch
    return [fine - float(np.arctan2(first[1], first[0]))]


def _power(place: Floats, waves: Floats, wave: float, angle: float) -> float:
    phase = np.exp(-1j * wave * (place @ np.array([np.cos(angle), np.sin(angle)])))
    return float((np.abs(phase @ waves) ** 2).sum())
