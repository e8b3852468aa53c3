"""Sheets for a wanted chief-ray matrix: two, or three of which two η are free, with their light and limits.

All sheets are untilted, have η_x = η_y, and focus: (x, t) ↦ (x + s t, k x + t/η), f_image = −1/k. Two sheets
have four numbers for the four of the matrix. Three have two more, η of the first and of the second, which
`shortlist` ranks by the share of the light, averaged over the field, in the closed form for thin lenses. Each
sheet must be one that can be built: see `_Family.kept`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import atan, inf, tan
from typing import Any

import numpy as np

from clacad.base.types import Bools, Floats, Pair2
from clacad.prescription.aimed_cells import NEAREST, STEEPEST

NEAR_ONE = 0.04
"""Least distance of η from 1, where a pair has no power."""

SMALLEST, LARGEST = 0.2, 5.0
"""Range of |η| that is searched."""

APART = 0.25
"""Least logarithm of the ratio of η of two members of a shortlist, of one sign."""

FIELDS = 33
"""Number of slopes over which shares are averaged."""


@dataclass(frozen=True)
class Wanted:
    """What a stack must do, and with which sheets; lengths in one unit.

    name : In words.
    matrix : ((A, B), (C, D)) of chief rays from array 1 of the first sheet to array 2 of the last.
    separation, pitch : Of every sheet.
    gaps : From array 2 of a sheet to array 1 of the next; of three sheets. Two sheets lie at the ends.
    radius : Half the width of the light on the first sheet.
    field : radians. Slopes of the light, either way.
    bend : Radius of a lens face over the focal length of its lens: n − 1, biconvex 2 (n − 1).
    ring : Least width of the ring that no light crosses, from the waist of the light to `radius`.
    field_lens : Whether the first sheets have field lenses where η < 0; the last of three has none.
    etas : η of the first two of three sheets, where they are not searched.
    """

    name: str
    matrix: tuple[Pair2, Pair2]
    separation: float
    pitch: float
    gaps: Pair2
    radius: float
    field: float
    bend: float
    ring: float = 0.0
    field_lens: bool = False
    etas: Pair2 | None = None

    @property
    def length(self) -> float:
        """Length from the first array to the last."""
        return 3.0 * self.separation + sum(self.gaps)

    def has_field(self, eta: Floats) -> Bools:
        """Whether sheets of η (n,) have field lenses: not where the common focus is virtual."""
        return np.asarray((np.asarray(eta) < 0.0) & self.field_lens)

    def thickness(self, eta: Floats) -> Floats:
        """Length (n,) that light crosses obliquely in sheets of η; 0 where lens 1 is imaged onto lens 2."""
        return np.where(self.has_field(eta), 0.0, self.separation)


@dataclass(frozen=True)
class WantedSheet:
    """One sheet of a solved stack.

    eta, f_image : Law; f_image (length) is infinite for a sheet that does not focus.
    viewer : length. Height of the point at which its cells are aimed; infinite: aligned cells.
    reach : length. Half the width of its light.
    height : Distance from the vertex of lens 2 to the border of its outermost cell, over the radius there.
    share : Of the light that arrives, along one axis.
    field_lens : Whether it has field lenses, which image lens 1 onto lens 2.
    """

    eta: float
    f_image: float
    viewer: float
    reach: float
    height: float
    share: float
    field_lens: bool = False


@dataclass(frozen=True)
class Solved:
    """Sheets that have a wanted matrix.

    sheets : In the order of the light.
    gaps : lengths. From array 2 of a sheet to array 1 of the next.
    share : Of the light within the field, both axes, thin lenses.
    loss : Product of |η| beyond 1, along one axis: at most its reciprocal passes.
    field : radians. Angle beyond which no light passes some sheet.
    waist : length. Least half width of the light between sheets; `ring` is what it leaves of the radius.
    binding : The limit that this stack does not keep; empty where it can be built.
    by_rays : Share of the light by rays through thin lenses; None where none were traced.
    """

    sheets: tuple[WantedSheet, ...]
    gaps: tuple[float, ...]
    share: float
    loss: float
    field: float
    waist: float
    ring: float
    binding: str = ""
    by_rays: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


class NoSuchStack(ValueError):
    """No stack of lens pairs has the wanted matrix; the message gives the reason."""

    exit_status = 2


@dataclass(frozen=True, eq=False)
class _Family:
    """Stacks of one matrix: arrays over (sheets, members).

    eta, k : Of each sheet. before : (sheets, members, 2, 2), matrix of what lies before each sheet.
    """

    wanted: Wanted
    gaps: tuple[float, ...]
    eta: Floats
    k: Floats
    before: Floats

    @staticmethod
    def of_two(wanted: Wanted) -> _Family:
        """The one stack of two sheets, as long as three would be; both have field lenses, or none."""
        s, (a, b) = wanted.separation, wanted.matrix[0]
        gap = wanted.length - 2.0 * s
        k = (a - 1.0) / (gap + s)
        with np.errstate(divide="ignore", invalid="ignore"):
            plain = np.float64(gap + s) / (b - s)
            lensed = gap * a / np.float64(b * (1.0 + gap * k))
        own = wanted.field_lens and lensed < 0.0
        return _Family._last(wanted, (gap,), [lensed if own else plain], [k])

    @staticmethod
    def of_three(wanted: Wanted, eta_1: Floats, eta_2: Floats) -> _Family:
        """Stacks of three sheets, one for each pair (n,) of η of the first and the second."""
        (a, b), (gap, after) = wanted.matrix[0], wanted.gaps
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            ahead = after + wanted.separation  # (1, ahead) is the first row of what follows the second sheet
            slope = wanted.thickness(eta_2) + ahead / eta_2
            place = (b - slope / eta_1) / (wanted.thickness(eta_1) + gap / eta_1)
            k_1 = (a - place) / (place * gap + slope)
            scale = np.where(wanted.has_field(eta_2), 1.0 + wanted.separation * k_1 / (1.0 + gap * k_1), 1.0)
            k_2 = (place - scale) / ahead
        return _Family._last(wanted, wanted.gaps, [eta_1, eta_2], [k_1, k_2])

    @staticmethod
    def _last(wanted: Wanted, gaps: tuple[float, ...], eta: Sequence[Any], k: Sequence[Any]) -> _Family:
        """Add the last sheet, which sets C and D."""
        etas, ks = np.atleast_2d(*(np.array([np.atleast_1d(v) for v in row]) for row in (eta, k)))
        before, area = [np.broadcast_to(np.eye(2), (etas.shape[1], 2, 2))], np.ones(etas.shape[1])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for one, power, gap in zip(etas, ks, gaps, strict=True):
                sheet = _sheet(wanted, one, power, before[-1])
                area = area * (sheet[:, 0, 0] * sheet[:, 1, 1] - sheet[:, 0, 1] * sheet[:, 1, 0])
                before.append(_space(gap) @ sheet @ before[-1])
            (a, b), (c, d) = np.moveaxis(before[-1], 0, -1)
            rows = wanted.matrix[1]
            last = (rows[0] * d - rows[1] * c) / area, (rows[1] * a - rows[0] * b) / area
            return _Family(
                wanted, gaps, np.vstack([etas, 1.0 / last[1]]), np.vstack([ks, last[0]]), np.array(before)
            )

    def has_field(self, number: int) -> Bools:
        """Members (n,) whose sheet has field lenses: the last of three has none."""
        return self.wanted.has_field(self.eta[number]) & (number < 2)

    def part(self, number: int) -> tuple[Floats, Floats, Floats, Floats]:
        """A, B, C, D (n,) of what lies before a sheet."""
        (a, b), (c, d) = np.moveaxis(self.before[number], 0, -1)
        return a, b, c, d

    def reach(self, number: int) -> Floats:
        """Half width (n,) of the light on a sheet."""
        a, b, _, _ = self.part(number)
        return np.asarray(np.abs(a) * self.wanted.radius + np.abs(b) * tan(self.wanted.field))

    def viewer(self, number: int) -> Floats:
        """Height (n,) of the point that light along the axis comes from; infinite for parallel light."""
        a, _, c, _ = self.part(number)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(np.abs(c) * self.wanted.length < 1e-12 * np.abs(a), inf, -a / c)

    def height(self, number: int) -> Floats:
        """Distance (n,) from the vertex of lens 2 to the border of the outermost cell, over its radius."""
        wanted, eta, s = self.wanted, self.eta[number], self.wanted.separation
        with np.errstate(divide="ignore", invalid="ignore"):
            rim = self.reach(number)
            slope = -rim / self.viewer(number)
            leaving = slope / eta + self.k[number] * rim
            vertex = (slope - eta * leaving) * s / (1.0 - eta)
            return np.asarray(
                (np.abs(s * slope - vertex) + 0.5 * wanted.pitch)
                / np.abs(wanted.bend * eta * s / (1.0 - eta))
            )

    def stretch(self, number: int) -> Floats:
        """Slope (n,) at one cell of a sheet per slope of the light that enters the stack."""
        a, b, c, d = self.part(number)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray((a * d - b * c) / a)

    def shares(self, number: int) -> Floats:
        """Share (slopes, n) that a sheet passes along one axis, over slopes from 0 to the field."""
        slopes = tan(self.wanted.field) * np.linspace(0.0, 1.0, FIELDS)[:, None]
        c = self.wanted.separation / self.wanted.pitch * slopes * self.stretch(number)
        return passed(c, self.eta[number], self.has_field(number))

    def share(self) -> Floats:
        """Share (n,) of the light within the field that passes all sheets, both axes."""
        return _mean(np.prod([self.shares(k) for k in range(len(self.eta))], axis=0)) ** 2

    def waist(self) -> Floats:
        """Least half width (n,) of the light between sheets, with half a pitch for the pencils of cells."""
        found, wanted = np.full(self.eta.shape[1], inf), self.wanted
        for number, gap in enumerate(self.gaps):
            before = self.before[number]
            after = _sheet(wanted, self.eta[number], self.k[number], before) @ before
            (a, b), (c, d) = np.moveaxis(after, 0, -1)
            with np.errstate(divide="ignore", invalid="ignore"):
                for at in (np.zeros_like(a), np.full_like(a, gap), -a / c, -b / d):  # convex: least at a kink
                    z = np.clip(np.nan_to_num(at), 0.0, gap)
                    wide = np.abs(a + z * c) * wanted.radius + np.abs(b + z * d) * tan(wanted.field)
                    found = np.minimum(found, wide)
        return found + 0.5 * wanted.pitch

    def kept(self) -> Bools:
        """Members (n,) that can be built, and leave the ring that is wanted."""
        wanted, many = self.wanted, range(len(self.eta))
        good = np.isfinite(self.eta).all(axis=0) & np.isfinite(self.k).all(axis=0)
        good &= (np.abs(self.eta - 1.0) >= NEAR_ONE).all(axis=0) & (np.abs(self.eta) >= 1e-3).all(axis=0)
        for number in many:
            with np.errstate(invalid="ignore"):
                good &= self.height(number) <= STEEPEST
                good &= np.abs(self.viewer(number)) >= NEAREST * wanted.separation
        return np.asarray(good & ((wanted.ring == 0.0) | (wanted.radius - self.waist() >= wanted.ring)))

    def member(self, n: int) -> Solved:
        """One member in plain numbers."""
        many = range(len(self.eta))
        eta, k = self.eta[:, n].tolist(), self.k[:, n].tolist()
        sheets = tuple(
            WantedSheet(
                eta[j],
                -1.0 / k[j] if abs(k[j]) * self.wanted.length > 1e-12 else inf,
                float(self.viewer(j)[n]),
                float(self.reach(j)[n]),
                float(self.height(j)[n]),
                float(_mean(self.shares(j)[:, n])),
                bool(self.has_field(j)[n]),
            )
            for j in many
        )
        spread = [abs(float(self.stretch(j)[n])) * self.wanted.separation for j in many]
        reach = min(
            self.wanted.pitch * (1.0 + abs(eta[j])) / (2.0 * spread[j]) if spread[j] else inf for j in many
        )
        loss, waist = float(np.prod(np.maximum(1.0, np.abs(eta)))), float(self.waist()[n])
        solved = Solved(
            sheets, self.gaps, float(self.share()[n]), loss, atan(reach), waist, self.wanted.radius - waist
        )
        return replace(solved, binding=_binding(self.wanted, solved))


def _binding(wanted: Wanted, solved: Solved) -> str:
    """The first limit that a stack does not keep, in words."""
    for name, one in zip("abc", solved.sheets):
        if abs(one.eta - 1.0) < NEAR_ONE:
            return f"sheet {name} would be of eta = {one.eta:.4g}, and a pair has no power at eta = 1"
        if one.height > STEEPEST:
            return (
                f"the outermost cell of sheet {name} would reach {one.height:.3g} of the radius of lens 2"
                f" from its vertex, beyond {STEEPEST:g}"
            )
        if abs(one.viewer) < NEAREST * wanted.separation:
            return (
                f"the light of sheet {name} comes from {abs(one.viewer):.4g} away, nearer than {NEAREST:g}"
                " separations"
            )
    if wanted.ring and solved.ring < wanted.ring:
        return f"the light leaves a ring of {max(0.0, solved.ring):.4g} only"
    return ""


def passed(c: Floats, eta: Floats, field_lens: Bools | bool = False) -> Floats:
    """Share along one axis that a thin pair passes, for light c pitches off its partner: physics of cells.

    c : (s/p) (t − a), with a the slope at which a cell looks. eta : of the pair; arrays that broadcast.
    field_lens : Whether the pair has a field lens, which passes all that meets it.
    """
    half = 0.5 * np.abs(eta)
    inside = np.minimum(0.5, c + half) - np.maximum(-0.5, c - half)
    imaged = np.where(np.abs(c) < 0.5 + half, np.minimum(1.0, 2.0 * half), 0.0)
    return np.asarray(np.where(field_lens, imaged, np.maximum(0.0, inside)) / (2.0 * half))


def stack_of_three(wanted: Wanted, eta_1: float, eta_2: float) -> Solved:
    """The stack of three sheets with these η of the first two; `binding` names a limit it does not keep."""
    return _Family.of_three(wanted, np.full(1, eta_1), np.full(1, eta_2)).member(0)


def solve_two(wanted: Wanted) -> Solved:
    """The stack of two sheets. Raises NoSuchStack: It would need η = 1, or an infinite η."""
    family = _Family.of_two(wanted)
    eta = family.eta[:, 0]
    if not np.isfinite(eta).all() or not (family.stretch(1)[0] and np.isfinite(family.stretch(1)[0])):
        raise NoSuchStack("two sheets would need an infinite eta: all light would meet in a point of one")
    solved = family.member(0)
    if solved.binding:
        raise NoSuchStack(f"two sheets: {solved.binding}")
    return solved


def solve_three(wanted: Wanted) -> Solved:
    """The stack of three sheets that passes most light by the closed form, over η of the first two.

    Raises NoSuchStack: No member of the family can be built; the message gives the largest first
    sheet that can be, and the limit that binds.
    """
    best = shortlist(wanted, 1)
    if best:
        return best[0]
    low, high = 0.0, wanted.radius
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if shortlist(_smaller(wanted, middle), 1) else (low, middle)
    if low == 0.0:
        raise NoSuchStack("three sheets: no eta of the first two gives sheets that can be built")
    nearest = shortlist(_smaller(wanted, low), 1)[0]
    over = [one.height for one in nearest.sheets]
    raise NoSuchStack(
        f"three sheets: the first could be {2.0 * low:.4g} wide at most, not {2.0 * wanted.radius:.4g}: "
        f"sheet {'abc'[int(np.argmax(over))]} binds, whose outermost cell then reaches {max(over):.2f} of the"
        f" radius of lens 2 from its vertex (at most {STEEPEST:g})"
    )


def _smaller(wanted: Wanted, radius: float) -> Wanted:
    """The same matrix with less light, and a ring in proportion."""
    return replace(wanted, radius=radius, ring=wanted.ring * radius / wanted.radius)


def shortlist(wanted: Wanted, count: int) -> list[Solved]:
    """The best stacks of three sheets by the closed form, best first: different members of the family.

    A grid over η of the first two sheets; about each of its best members finer ones, to four decimals.
    """
    size = np.geomspace(SMALLEST, LARGEST, 44)
    both = np.concatenate([-size[::-1], size])
    step = float(np.log(size[1] / size[0]))
    one, other, share = _shares(wanted, both, both)
    found: list[tuple[float, float]] = []
    for n in np.argsort(-share):
        if share[n] < 0.0 or len(found) == count:
            break
        ratios = [(a / one[n], b / other[n]) for a, b in found]
        if all(min(r) < 0.0 or np.abs(np.log(r)).max() > APART for r in ratios):
            found.append((float(one[n]), float(other[n])))
    return sorted((about(wanted, *each, step) for each in found), key=lambda one: -one.share)


def about(wanted: Wanted, eta_1: float, eta_2: float, step: float = 0.02) -> Solved:
    """The best stack of three sheets with η within factors e^±step of these; these if none can be built."""
    for _ in range(3):
        near = np.exp(step * np.linspace(-1.0, 1.0, 21))
        one, other, share = _shares(wanted, eta_1 * near, eta_2 * near)
        n, step = int(np.argmax(share)), step / 8.0
        if share[n] >= 0.0:
            eta_1, eta_2 = float(one[n]), float(other[n])
    return stack_of_three(wanted, eta_1, eta_2)


def _shares(wanted: Wanted, first: Floats, second: Floats) -> tuple[Floats, Floats, Floats]:
    """Grid (n,) of η of the first two sheets to four decimals, with the share; −1 if it cannot be built."""
    one, other = (
        np.asarray(np.round(grid, 4).ravel(), np.float64)
        for grid in np.meshgrid(first, second, indexing="ij")
    )
    with np.errstate(invalid="ignore"):
        family = _Family.of_three(wanted, one, other)
        return one, other, np.where(family.kept(), family.share(), -1.0)


def _mean(values: Floats) -> Floats:
    """Mean over the first axis, of values at equal distances from one end to the other."""
    return np.asarray(np.trapezoid(values, axis=0) / (len(values) - 1))


def _space(length: float) -> Floats:
    return np.array([[1.0, length], [0.0, 1.0]])


def _sheet(wanted: Wanted, eta: Floats, k: Floats, before: Floats) -> Floats:
    """Matrices (n, 2, 2) of sheets.

    Field lenses send all light of a cell to the middle of its partner; partners of aimed cells lie
    1 + s C/A as far from the axis, by A and C of what lies before.
    """
    s, field = wanted.separation, wanted.has_field(eta)
    scale = np.where(field, 1.0 + s * before[:, 1, 0] / before[:, 0, 0], 1.0)
    return np.moveaxis(np.array([[scale, wanted.thickness(eta)], [k, 1.0 / eta]]), -1, 0)
