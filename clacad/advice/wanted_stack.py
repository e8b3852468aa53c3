"""Sheets for a wanted chief-ray matrix: two, or three of which two η are free, with their light and limits.

All sheets are untilted, have η_x = η_y, and focus: (x, t) ↦ (x + s t, k x + t/η), f_image = −1/k. Two sheets
have four numbers for the four of the matrix. Three have two more, η of the first and of the second; the share
of the light, averaged over the field and the closed form for thin lenses, chooses them. Each sheet must be
one that can be built: see `Limits`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import atan, ceil, inf, isfinite, tan
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import percent_text
from clacad.base.types import Bools, Floats, Pair2
from clacad.design.sections import LATTICE, LAW, PAIR
from clacad.prescription.aimed_cells import NEAREST, STEEPEST
from clacad.sheet.stack import Stack, stacked

if TYPE_CHECKING:
    from clacad.design import Design

NEAR_ONE = 0.04
"""Least distance of η from 1, where a pair has no power."""

SMALLEST, LARGEST = 0.2, 5.0
"""Range of |η| that is searched."""

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

    @property
    def length(self) -> float:
        """Length from the first array to the last."""
        return 3.0 * self.separation + sum(self.gaps)


@dataclass(frozen=True)
class WantedSheet:
    """One sheet of a solved stack.

    eta, f_image : Law; f_image (length) is infinite for a sheet that does not focus.
    viewer : length. Height of the point at which its cells are aimed; infinite: aligned cells.
    reach : length. Half the width of its light.
    height : Distance from the vertex of lens 2 to the border of its outermost cell, over the radius there.
    share : Of the light that arrives, along one axis.
    """

    eta: float
    f_image: float
    viewer: float
    reach: float
    height: float
    share: float


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
    """

    sheets: tuple[WantedSheet, ...]
    gaps: tuple[float, ...]
    share: float
    loss: float
    field: float
    waist: float
    ring: float
    binding: str = ""

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
        """The one stack of two sheets, as long as three would be."""
        s, (a, b) = wanted.separation, wanted.matrix[0]
        gap = wanted.length - 2.0 * s
        inverse = (b - s) / (gap + s)
        return _Family._last(wanted, (gap,), [1.0 / inverse if inverse else inf], [(a - 1.0) / (gap + s)])

    @staticmethod
    def of_three(wanted: Wanted, eta_1: Floats, eta_2: Floats) -> _Family:
        """Stacks of three sheets, one for each pair (n,) of η of the first and the second."""
        s, (a, b), (gap, after) = wanted.separation, wanted.matrix[0], wanted.gaps
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            ahead = after + s  # (1, ahead) is the first row of what follows the second sheet
            slope = s + ahead / eta_2
            place = (b - slope / eta_1) / (s + gap / eta_1)
            k_2, k_1 = (place - 1.0) / ahead, (a - place) / (place * gap + slope)
        return _Family._last(wanted, wanted.gaps, [eta_1, eta_2], [k_1, k_2])

    @staticmethod
    def _last(wanted: Wanted, gaps: tuple[float, ...], eta: Sequence[Any], k: Sequence[Any]) -> _Family:
        """Add the last sheet, which sets C and D."""
        etas, ks = np.atleast_2d(*(np.array([np.atleast_1d(v) for v in row]) for row in (eta, k)))
        before = [np.broadcast_to(np.eye(2), (etas.shape[1], 2, 2))]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for one, power, gap in zip(etas, ks, gaps, strict=True):
                before.append(_space(gap) @ _sheet(wanted.separation, one, power) @ before[-1])
            (a, b), (c, d) = np.moveaxis(before[-1], 0, -1)
            rows = wanted.matrix[1]
            area = a * d - b * c
            last = (rows[0] * d - rows[1] * c) / area, (rows[1] * a - rows[0] * b) / area
            return _Family(
                wanted, gaps, np.vstack([etas, 1.0 / last[1]]), np.vstack([ks, last[0]]), np.array(before)
            )

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
        return passed(c, self.eta[number])

    def share(self) -> Floats:
        """Share (n,) of the light within the field that passes all sheets, both axes."""
        return _mean(np.prod([self.shares(k) for k in range(len(self.eta))], axis=0)) ** 2

    def waist(self) -> Floats:
        """Least half width (n,) of the light between sheets, with half a pitch for the pencils of cells."""
        found, wanted = np.full(self.eta.shape[1], inf), self.wanted
        for number, gap in enumerate(self.gaps):
            after = _sheet(wanted.separation, self.eta[number], self.k[number]) @ self.before[number]
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
        return Solved(**{**vars(solved), "binding": _binding(self.wanted, solved)})


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


def passed(c: Floats, eta: Floats) -> Floats:
    """Share along one axis that a thin pair passes, for light c pitches off its partner: physics of cells.

    c : (s/p) (t − a), with a the slope at which a cell looks. eta : of the pair; arrays that broadcast.
    """
    half = 0.5 * np.abs(eta)
    inside = np.minimum(0.5, c + half) - np.maximum(-0.5, c - half)
    return np.asarray(np.maximum(0.0, inside) / (2.0 * half))


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
    """The stack of three sheets that passes most light, over η of the first two.

    Raises NoSuchStack: No member of the family can be built; the message gives the largest first
    sheet that can be, and the limit that binds.
    """
    best = _best(wanted)
    if best is not None:
        return best
    low, high = 0.0, wanted.radius
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _best(_smaller(wanted, middle)) is not None else (low, middle)
    if low == 0.0:
        raise NoSuchStack("three sheets: no eta of the first two gives sheets that can be built")
    nearest = _best(_smaller(wanted, low))
    assert nearest is not None
    over = [one.height for one in nearest.sheets]
    raise NoSuchStack(
        f"three sheets: the first could be {2.0 * low:.4g} wide at most, not {2.0 * wanted.radius:.4g}: "
        f"sheet {'abc'[int(np.argmax(over))]} binds, whose outermost cell then reaches {max(over):.2f} of the"
        f" radius of lens 2 from its vertex (at most {STEEPEST:g})"
    )


def _smaller(wanted: Wanted, radius: float) -> Wanted:
    """The same matrix with less light, and a ring in proportion."""
    return Wanted(**{**vars(wanted), "radius": radius, "ring": wanted.ring * radius / wanted.radius})


def _best(wanted: Wanted) -> Solved | None:
    """Search of η of the first two sheets: a grid, then finer ones about its best; four decimals."""
    size = np.geomspace(SMALLEST, LARGEST, 44)
    first = second = np.concatenate([-size[::-1], size])
    step, found = float(np.log(size[1] / size[0])), None
    for _ in range(4):
        one, other = (
            np.asarray(np.round(grid, 4).ravel(), np.float64)
            for grid in np.meshgrid(first, second, indexing="ij")
        )
        with np.errstate(invalid="ignore"):
            family = _Family.of_three(wanted, one, other)
            share = np.where(family.kept(), family.share(), -1.0)
        n = int(np.argmax(share))
        if share[n] < 0.0:
            break
        found = family.member(n)
        near = np.exp(step * np.linspace(-1.0, 1.0, 21))
        first, second, step = one[n] * near, other[n] * near, step / 8.0
    return found


def _mean(values: Floats) -> Floats:
    """Mean over the first axis, of values at equal distances from one end to the other."""
    return np.asarray(np.trapezoid(values, axis=0) / (len(values) - 1))


def _space(length: float) -> Floats:
    return np.array([[1.0, length], [0.0, 1.0]])


def _sheet(separation: float, eta: Floats, k: Floats) -> Floats:
    """Matrices (n, 2, 2) of sheets."""
    one = np.ones_like(eta)
    return np.moveaxis(np.array([[one, separation * one], [k, 1.0 / eta]]), -1, 0)


KINDS = ("cloak", "space", "relay", "image")
"""What can be wanted: space of the stack's own length, of another one, a relay, an image of a plane."""


def wanted_matrix(kind: str, value: float, length: float, planes: Pair2 = (0.0, 0.0)) -> tuple[Pair2, Pair2]:
    """Matrix ((A, B), (C, D)) of what is wanted.

    kind : One of `KINDS`. value : Length of the space; magnification of a relay or an image.
    length : Of the stack, which a cloak acts as.
    planes : lengths. Distance of the imaged plane before the stack, and of its image behind.
    """
    if kind in ("cloak", "space"):
        return (1.0, length if kind == "cloak" else value), (0.0, 1.0)
    before, behind = planes  # parallel light stays parallel: diag(m, 1/m) from plane to plane
    return (value, -value * before - behind / value), (0.0, 1.0 / value)


def sheet_keys(wanted: Wanted, one: WantedSheet) -> dict[str, Any]:
    """Keys of a design that make it one of the solved sheets."""
    cells = 2 * ceil(one.reach / wanted.pitch)
    keys: dict[str, Any] = {LAW.eta: [one.eta, one.eta], LATTICE.count: [cells, cells]}
    if isfinite(one.f_image):
        keys[f"{LAW.varying}.f_image"] = one.f_image
    if isfinite(one.viewer):
        keys[LATTICE.aperture] = {"point": [0.0, 0.0, one.viewer]}
    return keys


def placed(designs: Sequence[Design], gaps: Sequence[float]) -> Stack:
    """Stack of the designs with these lengths from array 2 of a sheet to array 1 of the next.

    Lens planes depend on the thickness, and not on where the vertices of lens 2 are: those are not traced.
    Raises NoSuchStack: The material of neighbours would overlap.
    """
    from clacad.prescription.prescribe import prescribe

    windows = [prescribe(one.replace(PAIR.offset, "paraxial")) for one in designs]
    sheets = stacked(windows, [0.0] * len(gaps)).sheets
    clear = [gap - (b.lens_planes[0] - a.lens_planes[1]) for a, b, gap in zip(sheets, sheets[1:], gaps)]
    if min(clear) < 0.0:
        raise NoSuchStack(f"the sheets would overlap by {-min(clear):.4g}: their lens planes lie too close")
    return stacked(windows, clear)


def rows_of(count: int, solved: Solved | NoSuchStack, unit: str) -> list[tuple[str, str]]:
    """What a number of sheets can do, one row for each sheet, or why they cannot."""
    if isinstance(solved, NoSuchStack):
        return [(f"{count} sheets", f"not possible: {solved}")]
    least = percent_text(1.0 / solved.loss**2)
    rows = [
        (
            f"{count} sheets",
            f"{percent_text(solved.share)} of the light; |eta| alone leaves {least}; the light is"
            f" {solved.waist:.4g} {unit} from the axis at its waist",
        )
    ]
    for name, one in zip(ascii_lowercase, solved.sheets):
        aim = f"aimed at z = {one.viewer:.6g}" if isfinite(one.viewer) else "aligned cells"
        words = (
            f"eta {one.eta:.6g}",
            f"f_image {one.f_image:.6g} {unit}, {aim}",
            f"{2.0 * one.reach:.4g} {unit} wide",
            f"{percent_text(one.share)} an axis",
            f"lens 2 reaches {one.height:.2f} of its radius",
        )
        rows.append((f"sheet {name}", "; ".join(words)))
    return rows
