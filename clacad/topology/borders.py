"""Borders between congruent cells: crossings, pieces, steps and joints, root-exact."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from clacad.base.roots import sign_changes
from clacad.base.types import Bools, Floats
from clacad.sheet.window import PLANE, Body, Face, Window
from clacad.topology.complex_parts import Border, Joint, JointState, Part, Piece, Profile, Side, Step

_EPS = float(np.finfo(np.float64).eps)
_GAUSS = 47  # nodes on a stretch; odd, so that one lies in its middle


@dataclass(frozen=True, slots=True, eq=False)
class ColumnLine:
    """The column of one cell over a straight line of its frame: both faces, what they are, exactly.

    `zone` tells whether the line lies in the cell's optical zone (with a seam, borders do not).
    """

    front: Profile
    back: Profile
    zone: bool
    window: Window

    def heights(self, t: Floats) -> tuple[Floats, Floats]:
        """Front and back height (n,) at t; NaN where void."""
        z, _ = self.evaluate(t)
        return z[0], z[1]

    def evaluate(self, t: Floats) -> tuple[Floats, Bools]:
        """Front and back height (2, n) at t, NaN where void, and where each is lens (or plane), (2, n)."""
        columnar = self.front.face.array is not None and self.back.face.array is not None
        alone, proud, bare = [], [], []
        for profile, side in ((self.front, 1), (self.back, -1)):
            if profile.face.array is None:
                lens = profile.lens(t)
                alone.append(lens)
                proud.append(np.ones(np.shape(t), dtype=bool))
                bare.append(lens)
                continue
            land = np.full(np.shape(t), _land(profile.face))
            lens = profile.lens(t) if self.zone else np.full(np.shape(t), np.nan)
            with np.errstate(invalid="ignore"):
                proud.append(np.isfinite(lens) & ~(side * (lens - land) >= 0.0))
            alone.append(np.where(proud[-1], lens, land))
            bare.append(lens if self.zone else land)
        with np.errstate(invalid="ignore"):
            rimless = ~(bare[0] <= bare[1]) | (columnar and not self.zone)
        lands = np.array([_land(self.front.face), _land(self.back.face)])[:, None]
        return np.where(rimless, lands, np.stack(alone)), np.stack(proud) & ~rimless

    def differences(self) -> list[Callable[[Floats], Floats]]:
        """Functions of t whose sign changes are where this column changes its parts."""
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


def column_line(
    window: Window, body: Body, start: Sequence[float], end: Sequence[float], zone: bool
) -> ColumnLine:
    """Give a body's column over the straight line start → end of the cell frame (lengths)."""
    a, b = (float(start[0]), float(start[1])), (float(end[0]), float(end[1]))
    return ColumnLine(Profile(body.front, a, b), Profile(body.back, a, b), zone, window)


def make_border(
    window: Window, body: Body, array: int, columnar: bool, k: int, merge: float, spacing: float
) -> Border:
    """Build border class k of a body's tiling on `array`.

    Parameters
    ----------
    window, body, array
    columnar : bool
        The tiling cuts both faces (columns); else only the face that repeats on `array`.
    k : int
        Border class, 0 … m/2 − 1.
    merge : length
        Steps that stay below it are no steps.
    spacing : length
        Crossings closer than this to a node or to one another are dropped.
    """
    lattice = window.lattice
    tile, m = lattice.tile(), len(lattice.steps)
    a, b = tile[k], tile[(k + 1) % m]
    # the same border in the right cell's frame, met in the same direction
    c, d = tile[(k + m // 2 + 1) % m], tile[(k + m // 2) % m]
    zone = window.land.seam == 0.0
    left = column_line(window, body, a, b, zone)
    right = column_line(window, body, c, d, zone)
    length = float(np.hypot(*(b - a)))
    if columnar:
        sides: tuple[Side, ...] = ("front", "back")
    else:
        sides = ("front",) if body.front.array == array else ("back",)
        left, right = _alone(left, sides[0]), _alone(right, sides[0])
    sides = tuple(s for s in sides if getattr(left, s).face.array is not None)
    candidates = _candidates(left, right, sides, columnar)
    roots = np.unique(np.concatenate(candidates)) if candidates else np.empty(0)
    breaks = _spaced(roots, spacing / length)
    on = _stretches(left, right, breaks)
    steps = tuple(_step(getattr(left, side), getattr(right, side), side, on, merge) for side in sides)
    joint = _joint(on) if columnar else None
    kept = _kept_breaks(steps, joint, breaks)
    return Border(
        k, lattice.steps[k], lattice.offset(*lattice.steps[k]), tuple(a), tuple(b), steps, joint, kept, roots
    )


def _alone(line: ColumnLine, side: Side) -> ColumnLine:
    """The same line with the other face so far away that it never matters (two displaced tilings)."""
    far = Face(PLANE, (0.0, 0.0, np.inf if side == "front" else -np.inf))
    profile: Profile = getattr(line, side)
    other = Profile(far, profile.start, profile.end)
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
            profile: Profile = getattr(line, sides[0])
            if profile.face.land is not None:
                functions.append(partial(_above_land, profile))
    for side in sides:
        pair: tuple[Profile, Profile] = (getattr(left, side), getattr(right, side))
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
            scale = max(scale, abs(profile.face.vertex[2]) if np.isfinite(profile.face.vertex[2]) else 0.0,
                        float(z.max()) if z.size else 0.0)  # fmt: skip
    return 8.0 * _EPS * scale


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
    """Both columns on the stretches between a border's breaks, evaluated once.

    edges : (k + 1,); t : (k, n) parameters, ends just inside; weights : (n,) sum to 1, 0 at the ends
    left, right : (2, k, n) heights; left_lens, right_lens : (2, k) whether lens in the middle
    """

    edges: Floats
    weights: Floats
    left: Floats
    right: Floats
    left_lens: Bools
    right_lens: Bools


def _stretches(left: ColumnLine, right: ColumnLine, breaks: Floats) -> _Stretches:
    edges = np.concatenate([[0.0], breaks, [1.0]])
    nodes, weights = np.polynomial.legendre.leggauss(_GAUSS)
    # limits from within at the ends: at a rim without a web the height itself may jump
    u = np.concatenate([[1e-12], 0.5 * (nodes + 1.0), [1.0 - 1e-12]])
    t = edges[:-1, None] + np.diff(edges)[:, None] * u
    (z_l, lens_l), (z_r, lens_r) = left.evaluate(t.ravel()), right.evaluate(t.ravel())
    shape = (2, *t.shape)
    middle = len(u) // 2
    return _Stretches(
        edges, np.concatenate([[0.0], 0.5 * weights, [0.0]]), z_l.reshape(shape), z_r.reshape(shape),
        lens_l.reshape(shape)[..., middle], lens_r.reshape(shape)[..., middle],
    )  # fmt: skip


def _step(left: Profile, right: Profile, side: Side, on: _Stretches, merge: float) -> Step:
    """Pieces, crossings and sizes of one face's step."""
    at = 0 if side == "front" else 1
    raw: list[Piece] = []
    area = length = 0.0
    for n, (start, stop) in enumerate(zip(on.edges[:-1].tolist(), on.edges[1:].tolist())):
        parts = [
            _part(z[at, n], bool(lens[at, n]))
            for z, lens in ((on.left, on.left_lens), (on.right, on.right_lens))
        ]
        d = on.left[at, n] - on.right[at, n]
        if "void" in parts or np.isnan(d[1:-1]).all():
            raw.append(Piece(start, stop, False, 0, parts[0], parts[1], 0.0, 0.0))
            continue
        size = np.abs(d[np.isfinite(d)])
        largest, least = float(size.max()), float(size.min())
        area += (stop - start) * float(np.nansum(on.weights * np.abs(d)))
        length += stop - start
        flat = largest <= merge
        inner = d[1:-1]
        sign = 0 if flat else int(np.sign(inner[np.nanargmax(np.abs(inner))]))
        raw.append(Piece(start, stop, flat, sign, parts[0], parts[1], largest, least))
    pieces = _joined_pieces(raw)
    # Where a merged piece or nothing lies between two signs, the sign still changes, but not at a point.
    crossings = [a.stop for a, b in zip(pieces[:-1], pieces[1:]) if a.sign * b.sign < 0]
    largest = max((p.gap_max for p in pieces), default=0.0)
    mean = float(area / length) if length else 0.0
    return Step(side, left, right, np.asarray(crossings, dtype=np.float64), tuple(pieces), largest, mean)


def _part(z: Floats, lens: bool) -> Part:
    return "lens" if lens else "void" if np.isnan(z[len(z) // 2]) else "land"


def _joined_pieces(raw: list[Piece]) -> list[Piece]:
    """Join neighbouring pieces between which nothing changes for this face."""
    out: list[Piece] = []
    for piece in raw:
        last = out[-1] if out else None
        if last and (last.merged, last.sign, last.left, last.right) == (
            piece.merged, piece.sign, piece.left, piece.right,
        ):  # fmt: skip
            out[-1] = Piece(last.start, piece.stop, piece.merged, piece.sign, piece.left, piece.right,
                            max(last.gap_max, piece.gap_max), min(last.gap_min, piece.gap_min))  # fmt: skip
        else:
            out.append(piece)
    return out


def _joint(on: _Stretches) -> Joint:
    """Where the two columns share material."""
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
    state: JointState = "joined" if shared.all() else "partial" if shared.any() else "separate"
    return Joint(state, tuple(intervals))


def _kept_breaks(steps: tuple[Step, ...], joint: Joint | None, breaks: Floats) -> Floats:
    """Drop the breaks at which nothing visible changes (crossings hidden under land, say)."""
    kept = {t for step in steps for piece in step.pieces for t in (piece.start, piece.stop)}
    if joint is not None:
        kept |= {t for interval in joint.intervals for t in interval}
    return np.asarray([t for t in breaks if float(t) in kept])


def _above_land(profile: Profile, t: Floats) -> Floats:
    return np.asarray(profile.lens(t) - _land(profile.face))


def _apart(first: Profile, second: Profile, t: Floats) -> Floats:
    return np.asarray(first.lens(t) - second.lens(t))


def _land(face: Face) -> float:
    return np.nan if face.land is None else face.land
