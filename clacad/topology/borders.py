"""Borders between congruent cells: crossings, steps and joints, root-exact."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from clacad.base.arrays import distinct
from clacad.base.sign_changes import sign_changes
from clacad.base.types import Bools, Floats
from clacad.sheet.window import PLANE, Body, Face, Window
from clacad.topology.complex_parts import SIDES, Border, HeightProfile, Side

_EPS = float(np.finfo(np.float64).eps)
_SAMPLES = 47  # number of Gauss nodes on a stretch; odd, so that one lies in its middle


@dataclass(frozen=True, slots=True, eq=False)
class ColumnLine:
    """The column of one cell over a straight line of its frame: exact heights and kinds of both faces.

    `zone`: whether the line lies in the cell's optical zone (with a seam, borders do not).
    """

    front: HeightProfile
    back: HeightProfile
    zone: bool

    def evaluate(self, t: Floats) -> tuple[Floats, Bools]:
        """Front and back height (2, n) at t, NaN where void, and where each is lens (or plane), (2, n)."""
        columnar = self.front.face.array is not None and self.back.face.array is not None
        alone, proud, bare = [], [], []
        for profile in (self.front, self.back):
            if profile.face.array is None:
                lens = profile.lens(t)
                alone.append(lens)
                proud.append(np.ones(np.shape(t), dtype=bool))
                bare.append(lens)
                continue
            land = np.full(np.shape(t), _land(profile.face))
            lens = profile.lens(t) if self.zone else np.full(np.shape(t), np.nan)
            with np.errstate(invalid="ignore"):
                proud.append(np.isfinite(lens) & ~(profile.face.land_side * (lens - land) >= 0.0))
            alone.append(np.where(proud[-1], lens, land))
            bare.append(lens if self.zone else land)
        with np.errstate(invalid="ignore"):
            rimless = ~(bare[0] <= bare[1]) | (columnar and not self.zone)
        lands = np.array([_land(self.front.face), _land(self.back.face)])[:, None]
        return np.where(rimless, lands, np.stack(alone)), np.stack(proud) & ~rimless

    def differences(self) -> list[Callable[[Floats], Floats]]:
        """Functions of t whose sign changes mark changes of a face between lens, land and void."""
        if not self.zone:
            return []
        front, back = self.front, self.back
        found: list[Callable[[Floats], Floats]] = []
        if front.face.array is not None or back.face.array is not None:
            found.append(lambda t: back.lens(t) - front.lens(t))
        for profile in (front, back):
            land = profile.face.land
            if profile.face.array is not None and land is not None:
                found.append(partial(_above_land, profile))
        return found


def column_line(body: Body, start: Sequence[float], end: Sequence[float], zone: bool) -> ColumnLine:
    """Return a body's column over the straight line start → end of the cell frame (lengths)."""
    a, b = (float(start[0]), float(start[1])), (float(end[0]), float(end[1]))
    return ColumnLine(HeightProfile(body.front, a, b), HeightProfile(body.back, a, b), zone)


def make_border(
    window: Window, body: Body, array: int, columnar: bool, k: int, merge: float, spacing: float
) -> Border:
    """Build border class k of a body's tiling on `array`.

    window, body, array
    columnar : The tiling cuts both faces (columns); else only the face that repeats on `array`.
    k : Border class, 0 … m/2 − 1.
    merge : length. Steps that never exceed it are no steps.
    spacing : length. Crossings closer than that to a node or to one another are dropped.
    """
    left, right, sides = _border_lines(window, (body, body), array, columnar, k)
    a, b = np.array(left.front.start), np.array(left.front.end)
    roots = _roots(left, right, sides, columnar)
    breaks = _spaced(roots, spacing / float(np.hypot(*(b - a))))
    visible = _visible(left, right, breaks, [SIDES.index(side) for side in sides], columnar, merge)
    return Border(window.lattice.steps[k], tuple(a), tuple(b), visible, roots)


def roots_between(window: Window, bodies: tuple[Body, Body], array: int, columnar: bool, k: int) -> Floats:
    """`Border.roots` (n,) of border class k between two cells of a non-uniform sheet.

    bodies : (left, right). The body as it is in either cell.
    window, array, columnar, k : As in `make_border`.
    """
    return _roots(*_border_lines(window, bodies, array, columnar, k), columnar)


def _border_lines(
    window: Window, bodies: tuple[Body, Body], array: int, columnar: bool, k: int
) -> tuple[ColumnLine, ColumnLine, tuple[Side, ...]]:
    """The left and the right cell's columns over their border, and the faces on the tiling."""
    lattice = window.lattice_of(array)
    tile, m = lattice.tile(), len(lattice.steps)
    zone = window.land.seam == 0.0
    left = column_line(bodies[0], tile[k], tile[(k + 1) % m], zone)
    # the same border in the right cell's frame, in the same direction
    right = column_line(bodies[1], tile[(k + m // 2 + 1) % m], tile[(k + m // 2) % m], zone)
    if columnar:
        sides: tuple[Side, ...] = SIDES
    else:
        sides = ("front",) if bodies[0].front.array == array else ("back",)
        left, right = _alone(left, sides[0]), _alone(right, sides[0])
    return left, right, tuple(s for s in sides if getattr(left, s).face.array is not None)


def _roots(left: ColumnLine, right: ColumnLine, sides: tuple[Side, ...], columnar: bool) -> Floats:
    candidates = _candidates(left, right, sides, columnar)
    return distinct(np.concatenate(candidates)) if candidates else np.empty(0)


def _alone(line: ColumnLine, side: Side) -> ColumnLine:
    """The line with the other face so far away that it never matters (two displaced tilings)."""
    far = Face(PLANE, (0.0, 0.0, np.inf if side == "front" else -np.inf))
    profile: HeightProfile = getattr(line, side)
    other = HeightProfile(far, profile.start, profile.end)
    return (
        replace(line, front=profile, back=other)
        if side == "front"
        else replace(line, front=other, back=profile)
    )


def _candidates(left: ColumnLine, right: ColumnLine, sides: tuple[Side, ...], columnar: bool) -> list[Floats]:
    """Sign changes of every difference that can matter on the border."""
    functions = []
    if columnar:
        functions += [*left.differences(), *right.differences()]
        functions += [
            lambda t: left.back.lens(t) - right.front.lens(t),
            lambda t: right.back.lens(t) - left.front.lens(t),
        ]
    elif left.zone:
        for line in (left, right):
            profile: HeightProfile = getattr(line, sides[0])
            if profile.face.land is not None:
                functions.append(partial(_above_land, profile))
    for side in sides:
        pair: tuple[HeightProfile, HeightProfile] = (getattr(left, side), getattr(right, side))
        functions.append(partial(_apart, *pair))
    if not left.zone:
        return []
    noise = rounding(left, right)
    return [sign_changes(function, noise) for function in functions]


def rounding(*lines: ColumnLine) -> float:
    """Rounding level of a difference of two heights: a few ulps of the largest coordinate."""
    scale = 0.0
    for line in lines:
        for profile in (line.front, line.back):
            z = np.abs(profile.lens(np.linspace(0.0, 1.0, 9)))
            z = z[np.isfinite(z)]
            scale = max(
                scale,
                abs(profile.face.vertex[2]) if np.isfinite(profile.face.vertex[2]) else 0.0,
                float(z.max()) if z.size else 0.0,
            )
    return 8.0 * _EPS * scale


def compared(
    body: Body, array: int, columnar: bool, lines: tuple[Floats, Floats]
) -> Iterator[tuple[Floats, float]]:
    """Differences (b, n) of heights on borders of one class that may change sign, each with its rounding.

    `lines`: front and back lenses (b, n, 2) of the left and of the right cells; other arguments as in
    `make_border`.
    """
    faces = body.front, body.back
    finite = [np.abs(z[np.isfinite(z)]).max(initial=0.0) for z in lines]
    noise = 8.0 * _EPS * max(*finite, *(abs(face.vertex[2]) for face in faces))
    left, right = ([z[..., 0], z[..., 1]] for z in lines)
    if columnar:
        pairs = [(left, right), (right, left)]
        if any(face.array is not None for face in faces):
            pairs += [(left, left), (right, right)]
        yield from ((one[1] - other[0], noise) for one, other in pairs)
    for side in (0, 1) if columnar else (0,) if faces[0].array == array else (1,):
        face = faces[side]
        if face.array is None:
            continue
        if face.land is not None:
            yield left[side] - face.land, noise
            yield right[side] - face.land, noise
        yield left[side] - right[side], noise


def _spaced(t: Floats, spacing: float) -> Floats:
    """Drop parameters closer than `spacing` to the ends, and all but one of those closer to one another."""
    t = t[(t > spacing) & (t < 1.0 - spacing)]
    kept: list[float] = []
    for value in t:
        if not kept or value - kept[-1] > spacing:
            kept.append(float(value))
    return np.asarray(kept)


def _visible(
    left: ColumnLine, right: ColumnLine, breaks: Floats, faces: list[int], columnar: bool, merge: float
) -> Floats:
    """Breaks at which something visible changes: not, for example, crossings hidden under land.

    faces : Those that repeat on the tiling, 0 front, 1 back.
    """
    edges = np.concatenate([[0.0], breaks, [1.0]])
    nodes, _ = np.polynomial.legendre.leggauss(_SAMPLES)
    # limits from within at the ends: at a rim without a web the height itself may jump
    u = np.concatenate([[1e-12], 0.5 * (nodes + 1.0), [1.0 - 1e-12]])
    t, middle = edges[:-1, None] + np.diff(edges)[:, None] * u, len(u) // 2
    (z_l, lens_l), (z_r, lens_r) = (
        [found.reshape(2, *t.shape) for found in line.evaluate(t.ravel())] for line in (left, right)
    )
    changes = np.zeros(len(breaks), dtype=bool)
    if columnar:
        (front_l, back_l), (front_r, back_r) = z_l[..., middle], z_r[..., middle]
        with np.errstate(invalid="ignore"):
            shared = np.minimum(back_l, back_r) - np.maximum(front_l, front_r) > 0.0
        changes |= shared[1:] != shared[:-1]
    for face in faces:
        seen = []
        for n in range(len(t)):
            pairs = (z_l[face, n], lens_l[face, n, middle]), (z_r[face, n], lens_r[face, n, middle])
            kinds = ["lens" if lens else "void" if np.isnan(z[middle]) else "land" for z, lens in pairs]
            seen.append((_sign(z_l[face, n] - z_r[face, n], "void" in kinds, merge), *kinds))
        changes |= np.array([one != other for one, other in pairwise(seen)], dtype=bool)
    return breaks[changes]


def _sign(d: Floats, void: bool, merge: float) -> int:
    """Sign of a step d (n,) on a stretch without breaks, 0 where it never exceeds the merge height."""
    inner = d[1:-1]
    if void or np.isnan(inner).all() or float(np.abs(d[np.isfinite(d)]).max()) <= merge:
        return 0
    return int(np.sign(inner[np.nanargmax(np.abs(inner))]))


def _above_land(profile: HeightProfile, t: Floats) -> Floats:
    return np.asarray(profile.lens(t) - _land(profile.face))


def _apart(first: HeightProfile, second: HeightProfile, t: Floats) -> Floats:
    return np.asarray(first.lens(t) - second.lens(t))


def _land(face: Face) -> float:
    return np.nan if face.land is None else face.land
