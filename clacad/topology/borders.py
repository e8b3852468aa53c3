"""Borders between congruent cells: crossings, steps and joints, root-exact."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from clacad.base.arrays import distinct
from clacad.base.sign_changes import sign_changes
from clacad.base.types import Bools, Floats
from clacad.sheet.window import PLANE, Body, Face, Window
from clacad.topology.complex_parts import SIDES, Border, HeightProfile, Part, Side, Stretch

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

    def heights(self, t: Floats) -> tuple[Floats, Floats]:
        """Front and back height (n,) at t; NaN where void."""
        z, _ = self.evaluate(t)
        return z[0], z[1]

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
    on = _stretches(left, right, breaks)
    steps = {side: _step(on, SIDES.index(side), merge) for side in sides}
    joints = _joints(on) if columnar else None
    kept = _kept_breaks(steps, joints, breaks)
    return Border(k, window.lattice.steps[k], tuple(a), tuple(b), steps, joints, kept, roots)


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


@dataclass(frozen=True, slots=True, eq=False)
class _Stretches:
    """Both columns on the stretches between the breaks of a border, evaluated once.

    edges : (k + 1,)
    left, right : (2, k, n) heights at parameters inside, the first and the last just inside
    left_lens, right_lens : (2, k) whether lens in the middle
    """

    edges: Floats
    left: Floats
    right: Floats
    left_lens: Bools
    right_lens: Bools


def _stretches(left: ColumnLine, right: ColumnLine, breaks: Floats) -> _Stretches:
    edges = np.concatenate([[0.0], breaks, [1.0]])
    nodes, _ = np.polynomial.legendre.leggauss(_SAMPLES)
    # limits from within at the ends: at a rim without a web the height itself may jump
    u = np.concatenate([[1e-12], 0.5 * (nodes + 1.0), [1.0 - 1e-12]])
    t = edges[:-1, None] + np.diff(edges)[:, None] * u
    (z_l, lens_l), (z_r, lens_r) = left.evaluate(t.ravel()), right.evaluate(t.ravel())
    shape = (2, *t.shape)
    middle = len(u) // 2
    return _Stretches(
        edges,
        z_l.reshape(shape),
        z_r.reshape(shape),
        lens_l.reshape(shape)[..., middle],
        lens_r.reshape(shape)[..., middle],
    )


def _step(on: _Stretches, face: int, merge: float) -> tuple[Stretch, ...]:
    """Sign of the step between left and right heights of a face (0 front, 1 back) along a border, 0 to 1."""
    found: list[Stretch] = []
    for n, (start, stop) in enumerate(zip(on.edges[:-1].tolist(), on.edges[1:].tolist())):
        left, right = (
            _part(z[face, n], bool(lens[face, n]))
            for z, lens in ((on.left, on.left_lens), (on.right, on.right_lens))
        )
        d = on.left[face, n] - on.right[face, n]
        sign = 0
        if "void" not in (left, right) and not np.isnan(d[1:-1]).all():
            inner = d[1:-1]
            merged = float(np.abs(d[np.isfinite(d)]).max()) <= merge
            sign = 0 if merged else int(np.sign(inner[np.nanargmax(np.abs(inner))]))
        last = found[-1] if found else None
        if last and (last.sign, last.left, last.right) == (
            sign,
            left,
            right,
        ):  # nothing changes for this face
            start = found.pop().start
        found.append(Stretch(start, stop, sign, left, right))
    return tuple(found)


def _part(z: Floats, lens: bool) -> Part:
    return "lens" if lens else "void" if np.isnan(z[len(z) // 2]) else "land"


def _joints(on: _Stretches) -> tuple[tuple[float, float], ...]:
    """Where the two columns share material, as intervals of the border's parameter."""
    middle = on.left.shape[-1] // 2
    (front_l, back_l), (front_r, back_r) = on.left[..., middle], on.right[..., middle]
    edges = on.edges.tolist()
    with np.errstate(invalid="ignore"):
        shared = np.minimum(back_l, back_r) - np.maximum(front_l, front_r) > 0.0
    intervals: list[tuple[float, float]] = []
    for start, stop, yes in zip(edges[:-1], edges[1:], shared):
        if yes and intervals and intervals[-1][1] == start:
            intervals[-1] = (intervals[-1][0], float(stop))
        elif yes:
            intervals.append((float(start), float(stop)))
    return tuple(intervals)


def _kept_breaks(
    steps: dict[Side, tuple[Stretch, ...]], joints: tuple[tuple[float, float], ...] | None, breaks: Floats
) -> Floats:
    """Drop the breaks at which nothing visible changes (for example crossings hidden under land)."""
    kept = {t for step in steps.values() for stretch in step for t in (stretch.start, stretch.stop)}
    kept |= {t for interval in joints or () for t in interval}
    return np.asarray([t for t in breaks if float(t) in kept])


def _above_land(profile: HeightProfile, t: Floats) -> Floats:
    return np.asarray(profile.lens(t) - _land(profile.face))


def _apart(first: HeightProfile, second: HeightProfile, t: Floats) -> Floats:
    return np.asarray(first.lens(t) - second.lens(t))


def _land(face: Face) -> float:
    return np.nan if face.land is None else face.land
