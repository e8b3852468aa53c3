"""Borders between congruent cells: crossings, pieces, steps and joints, root-exact."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from clacad.cell_complex.nouns import Border, Floats, Joint, JointState, Part, Piece, Profile, Side, Step
from clacad.cell_complex.roots import sign_changes
from clacad.sheet import PLANE, Body, Face, Window

Bools = NDArray[np.bool_]
_EPS = float(np.finfo(np.float64).eps)


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
        (front, _), (back, _) = self._side(t, self.front, 1), self._side(t, self.back, -1)
        void = self._rimless(t)
        return (
            np.where(void, _land(self.front.face), front),
            np.where(void, _land(self.back.face), back),
        )

    def parts(self, t: Floats) -> tuple[list[Part], list[Part]]:
        """What front and back are at t: "lens", "land" or "void"."""
        void = self._rimless(t)
        out: list[list[Part]] = []
        for profile, side in ((self.front, 1), (self.back, -1)):
            z, is_lens = self._side(t, profile, side)
            z = np.where(void, _land(profile.face), z)
            is_lens = is_lens & ~void
            out.append(
                [
                    "lens" if lens else "void" if np.isnan(height) else "land"
                    for lens, height in zip(is_lens, z)
                ]
            )
        return out[0], out[1]

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

    def _side(self, t: Floats, profile: Profile, side: int) -> tuple[Floats, Bools]:
        """Height where a lens-and-land face stands alone, and where it is lens."""
        if profile.face.array is None:
            return profile.lens(t), np.ones(np.shape(t), dtype=bool)
        lens = profile.lens(t) if self.zone else np.full(np.shape(t), np.nan)
        land = _land(profile.face)
        with np.errstate(invalid="ignore"):
            proud = np.isfinite(lens) & ~(side * (lens - land) >= 0.0)
        return np.where(proud, lens, land), proud

    def _rimless(self, t: Floats) -> Bools:
        """Where front and back lens do not enclose material."""
        columnar = self.front.face.array is not None and self.back.face.array is not None
        if columnar and not self.zone:
            return np.ones(np.shape(t), dtype=bool)
        front, back = self.heights_of_lenses(t)
        with np.errstate(invalid="ignore"):
            return np.asarray(~(front <= back))

    def heights_of_lenses(self, t: Floats) -> tuple[Floats, Floats]:
        """Front and back height of what stands against each other: lens, or the land of a bare plane pair."""
        out = []
        for profile in (self.front, self.back):
            if profile.face.array is not None and not self.zone:
                out.append(np.full(np.shape(t), _land(profile.face)))
            else:
                out.append(profile.lens(t))
        return out[0], out[1]


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
    steps = tuple(_step(left, right, side, breaks, merge) for side in sides)
    joint = _joint(left, right, breaks) if columnar else None
    kept = _kept_breaks(left, right, steps, joint, breaks)
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


def _step(left: ColumnLine, right: ColumnLine, side: Side, breaks: Floats, merge: float) -> Step:
    """Pieces, crossings and sizes of one face's step."""
    at = 0 if side == "front" else 1
    edges = np.concatenate([[0.0], breaks, [1.0]])
    raw: list[Piece] = []
    area = length = 0.0
    nodes, weights = np.polynomial.legendre.leggauss(48)
    for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist()):
        t = start + (stop - start) * 0.5 * (nodes + 1.0)
        with np.errstate(invalid="ignore"):
            d = left.heights(t)[at] - right.heights(t)[at]
            # limits from within: at a rim without a web the height itself may jump
            ends = np.array([start + 1e-12 * (stop - start), stop - 1e-12 * (stop - start)])
            d_ends = left.heights(ends)[at] - right.heights(ends)[at]
        part_l, part_r = (line.parts(t[len(t) // 2 : len(t) // 2 + 1])[at][0] for line in (left, right))
        if part_l == "void" or part_r == "void" or np.isnan(d).all():
            raw.append(Piece(start, stop, False, 0, part_l, part_r, 0.0, 0.0))
            continue
        inner = d[np.isfinite(d)]
        every = np.abs(np.concatenate([inner, d_ends[np.isfinite(d_ends)]]))
        largest, least = float(every.max()), float(every.min())
        area += float(0.5 * (stop - start) * np.nansum(weights * np.abs(d)))
        length += stop - start
        flat = largest <= merge
        sign = 0 if flat else int(np.sign(inner[np.argmax(np.abs(inner))]))
        raw.append(Piece(start, stop, flat, sign, part_l, part_r, largest, least))
    pieces = _joined_pieces(raw)
    # Where a merged piece or nothing lies between two signs, the sign still changes, but not at a point.
    crossings = [a.stop for a, b in zip(pieces[:-1], pieces[1:]) if a.sign * b.sign < 0]
    largest = max((p.gap_max for p in pieces), default=0.0)
    return Step(side, getattr(left, side), getattr(right, side), np.asarray(crossings, dtype=np.float64), tuple(pieces),
                largest, float(area / length) if length else 0.0)  # fmt: skip


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


def _joint(left: ColumnLine, right: ColumnLine, breaks: Floats) -> Joint:
    """Where the two columns share material."""
    edges = np.concatenate([[0.0], breaks, [1.0]])
    middle = 0.5 * (edges[:-1] + edges[1:])
    front_l, back_l = left.heights(middle)
    front_r, back_r = right.heights(middle)
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


def _kept_breaks(
    left: ColumnLine, right: ColumnLine, steps: tuple[Step, ...], joint: Joint | None, breaks: Floats
) -> Floats:
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
