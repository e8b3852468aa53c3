"""Calibration of a dose from a measured coupon: where its fields lie, how deep they are, and how surely.

Of each field the depth is the mean of the land within a quarter of a side around it less the mean of the
inner 60 % of the field; the uncertainty is the spread over blocks of a tenth of a side.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.formats.maps.dose import Coupon
from clacad.measuring.find_lattice import NotMeasurable, means
from clacad.measuring.read_map import MeasuredMap, read_map

INNER, RING, BLOCK = 0.6, 0.25, 0.1
"""Part of the side that is averaged; width of the land around; side of a block; all over the side."""

GRID = 0.05
"""Pixel of the search over the side."""

TURNS = np.radians(np.arange(-3.0, 3.01, 0.5))
"""Small turns that are tried with each quarter turn."""

OUTLIER = 6.7
"""Distance from the median, over the median distance, beyond which a point is none of its kind: 4.5 σ."""

PRESENT = 0.5
"""Part of a field's blocks that must be measured."""

FOUND = 0.5
"""Part of the variance of heights that the fields must explain."""


@dataclass(frozen=True, eq=False)
class WedgeDepths:
    """Depths of the fields of a coupon.

    name : File.
    levels : (k,), depths, halves : (k,) metres. Depth and standard uncertainty of each level; level 0 is the
        land itself: 0.
    level_0 : metres. Depth that was measured of level 0.
    turn : radians. Turn of the coupon in the map.
    explained : Part of the variance of the heights that the fields explain.
    """

    name: str
    levels: Ints
    depths: Floats
    halves: Floats
    level_0: float
    turn: float
    explained: float

    def to_csv(self) -> str:
        """Table that exports read: level, depth_um, u_um."""
        rows = zip(
            self.levels.tolist(), (self.depths * 1e6).tolist(), (self.halves * 1e6).tolist(), strict=True
        )
        return "level,depth_um,u_um\n" + "".join(f"{k},{d:.6f},{u:.6f}\n" for k, d, u in rows)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able form, micrometres."""
        return {
            "file": self.name,
            "level": self.levels.tolist(),
            "depth_um": (self.depths * 1e6).tolist(),
            "u_um": (self.halves * 1e6).tolist(),
            "level_0_measured_um": self.level_0 * 1e6,
            "turn_mrad": self.turn * 1e3,
            "explained": self.explained,
        }


def calibrate(
    wedge: str | os.PathLike[str] | MeasuredMap, side: float = 0.1e-3, unit: str | None = None
) -> WedgeDepths:
    """Find the fields of a measured coupon and their depths.

    Parameters
    ----------
    wedge : path or MeasuredMap
        Height map of the coupon that the format `wedge` writes; it may lie anywhere in the map, in any
        quarter turn, leaning by up to 3 degrees.
    side : float, metres
        Side of a field as written.
    unit : str or None
        Length unit of a cloud that states none.

    Returns
    -------
    WedgeDepths

    Raises
    ------
    UnreadableFile, OverBudget, NotPossible, BadRequest
        As every reader of maps; also where the map holds no coupon, a field of it is missing, or its depths
        do not rise from level to level.

    Examples
    --------
    >>> import numpy as np
    >>> from clacad.formats.maps.dose import Coupon
    >>> from clacad.measuring.read_map import cloud_map
    >>> from clacad.measuring.wedge_fields import calibrate
    >>> coupon = Coupon()
    >>> levels = coupon.picture(5e-6)[::-1]
    >>> y, x = np.indices(levels.shape) * 5e-6
    >>> found = calibrate(cloud_map("wedge", np.stack([x.ravel(), y.ravel(), -1e-7 * levels.ravel()])))
    >>> [round(1e6 * depth, 6) for depth in found.depths[:3].tolist()]
    [0.0, 1.6, 3.2]
    """
    map_ = wedge if isinstance(wedge, MeasuredMap) else read_map(wedge, unit)
    coupon = Coupon(side)
    x, y, z = map_.points
    z = _levelled(x, y, z)
    turn, shift = _refined(coupon, (x, y, z), *_placed(map_.name, coupon, x, y, z))
    u, v = _moved(x, y, turn, shift)
    explained = _explained(coupon, u, v, z)
    if not explained > FOUND:
        raise NotMeasurable(
            f"{map_.name}: no coupon of {len(coupon.levels)} fields of {1e6 * side:g} um is found in it"
            f" (fields explain {100 * max(0.0, explained):.0f} % of its heights); --side states another side"
        )
    depths, halves = np.array(list(_fields(map_.name, coupon, u, v, z))).T
    level_0 = float(depths[0])
    depths[0] = 0.0
    _refuse_not_rising(map_.name, coupon, depths, halves)
    return WedgeDepths(map_.name, np.array(coupon.levels), depths, halves, level_0, turn, explained)


def _refuse_not_rising(name: str, coupon: Coupon, depths: Floats, halves: Floats) -> None:
    rows = zip(coupon.levels, (1e6 * depths).tolist(), (1e6 * halves).tolist(), strict=True)
    for (low, d0, u0), (high, d1, u1) in pairwise(rows):
        if not d1 > d0:
            raise NotMeasurable(
                f"{name}: level {high} is {d1:.4g} +- {u1:.2g} um deep, level {low} {d0:.4g} +- {u0:.2g} um:"
                " depths must rise from level to level; expose and measure the coupon again, or keep its"
                " levels below where the resist is through"
            )


def _levelled(x: Floats, y: Floats, z: Floats) -> Floats:
    """Heights above the plane of the land: fields, which lie below, are left out round by round."""
    base = np.stack([np.ones_like(x), x / np.ptp(x), y / np.ptp(y)], axis=1)
    land = np.ones(len(z), dtype=bool)
    off = z
    for _ in range(12):
        off = z - base @ np.linalg.lstsq(base[land], z[land], rcond=None)[0]
        above = off[off > 0.0]
        spread = 1.4826 * float(np.median(above)) if above.size else 0.0
        kept = off > -2.0 * spread
        if kept.sum() < 16 or (kept == land).all():
            break
        land = kept
    return off


# -- place -----------------------------------------------------------------------------------------


def _moved(x: Floats, y: Floats, turn: float, shift: Floats) -> tuple[Floats, Floats]:
    """Points of the map in the frame of the coupon."""
    c, s = np.cos(turn), np.sin(turn)
    return c * x + s * y - shift[0], c * y - s * x - shift[1]


def _placed(name: str, coupon: Coupon, x: Floats, y: Floats, z: Floats) -> tuple[float, Floats]:
    """Turn and shift of the coupon whose levels correlate best with the depths."""
    pixel = GRID * coupon.side
    wanted = coupon.picture(pixel)[::-1].astype(np.float64)  # rows upwards, as the grid
    wanted -= wanted.mean()
    x0, _, y0, _ = coupon.extent()
    best = (-np.inf, 0.0, np.zeros(2), 1.0)
    for mirror in (1.0, -1.0):
        for turn in [k * 0.5 * np.pi + small for k in range(4) for small in TURNS]:
            u, v = _moved(mirror * x, y, turn, np.zeros(2))
            low = np.array([u.min(), v.min()])
            score, at = _best_shift(means((u - low[0]) / pixel, (v - low[1]) / pixel, -z)[0], wanted)
            if score > best[0]:
                best = (score, turn, low + at * pixel - np.array([x0, y0]), mirror)
    if best[3] < 0.0:
        raise NotMeasurable(
            f"{name}: the map is a mirror image of the coupon; mirror it back before calibrating"
        )
    return best[1], best[2]


def _best_shift(found: Floats, wanted: Floats) -> tuple[float, Floats]:
    """Correlation and place (columns, rows) at which a picture lies in a map; it may reach over the edges."""
    from scipy.signal import fftconvolve

    score = fftconvolve(found, wanted[::-1, ::-1])
    row, column = np.unravel_index(int(np.argmax(score)), score.shape)
    return float(score[row, column]), np.array([column - wanted.shape[1] + 1.0, row - wanted.shape[0] + 1.0])


def _refined(
    coupon: Coupon, points: tuple[Floats, Floats, Floats], turn: float, shift: Floats
) -> tuple[float, Floats]:
    """Turn and shift at which the fields explain most of the heights."""
    from scipy.optimize import minimize

    x, y, z = points
    every = max(1, len(x) // 100_000)
    x, y, z = x[::every], y[::every], z[::every]

    def unexplained(at: Floats) -> float:
        u, v = _moved(x, y, turn + 0.01 * at[0], shift + coupon.side * at[1:])
        return -_explained(coupon, u, v, z)

    step = np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0], [0.0, 0.04, 0.0], [0.0, 0.0, 0.04]])
    options = {"initial_simplex": step, "xatol": 1e-3, "fatol": 1e-9, "maxfev": 200}
    at = minimize(unexplained, step[0], method="Nelder-Mead", options=options).x
    return float(turn + 0.01 * at[0]), shift + coupon.side * at[1:]


def _number(coupon: Coupon, u: Floats, v: Floats) -> tuple[Ints, Floats]:
    """Field (n,) in whose square of land each point lies, −1 for none, and its distance from the middle."""
    column, row = np.rint(u / coupon.pitch), np.rint(-v / coupon.pitch)
    number = (row * coupon.row + column).astype(np.int64)
    held = (column >= 0) & (column < coupon.row) & (number >= 0) & (number < len(coupon.levels))
    off = np.fmax(np.abs(u - column * coupon.pitch), np.abs(v + row * coupon.pitch))
    return np.where(held, number, -1), off


def _explained(coupon: Coupon, u: Floats, v: Floats, z: Floats) -> float:
    """Part of the variance of heights over the coupon that one height a field and one of land explain."""
    number, off = _number(coupon, u, v)
    here = number >= 0
    if here.sum() < 64:
        return 0.0
    group = np.where(off[here] < 0.5 * coupon.side, number[here], len(coupon.levels))
    count = np.maximum(np.bincount(group), 1)
    mean = np.bincount(group, weights=z[here]) / count
    total = float(((z[here] - z[here].mean()) ** 2).sum())
    return 1.0 - float(((z[here] - mean[group]) ** 2).sum()) / total if total > 0.0 else 0.0


# -- depth -----------------------------------------------------------------------------------------


def _fields(name: str, coupon: Coupon, u: Floats, v: Floats, z: Floats) -> Iterator[tuple[float, float]]:
    """Depth and uncertainty (metres) of every field."""
    number, off = _number(coupon, u, v)
    half = 0.5 * coupon.side
    inner, land = off < INNER * half, (off > half) & (off < half + RING * coupon.side)
    for k, level in enumerate(coupon.levels):
        parts = [_without_outliers(z, (number == k) & part) for part in (inner, land)]
        inside, around = (_blocks(coupon, u, v, z, part) for part in parts)
        whole = (INNER / BLOCK) ** 2
        if len(inside) < PRESENT * whole or len(around) < whole:
            raise NotMeasurable(
                f"{name}: the field of level {level} is missing: {len(inside)} of {whole:.0f} blocks of it"
                f" and {len(around)} of the land around were measured"
            )
        spread = [float(part.std(ddof=1)) / np.sqrt(len(part)) for part in (inside, around)]
        low, high = (float(z[part].mean()) for part in parts)
        yield high - low, float(np.hypot(*spread))


def _without_outliers(z: Floats, of: Bools) -> Bools:
    """Points near the median of their kind: dirt is left out, and pixels on the edge of a field."""
    if not of.any():
        return of
    off = np.abs(z - np.median(z[of]))
    return np.asarray(of & (off <= OUTLIER * float(np.median(off[of]))))


def _blocks(coupon: Coupon, u: Floats, v: Floats, z: Floats, of: Bools) -> Floats:
    """Mean heights of the blocks of some points."""
    if not of.any():
        return z[of]
    column, row = (at[of] / (BLOCK * coupon.side) for at in (u, v))
    mean, known = means(column - np.floor(column.min()), row - np.floor(row.min()), z[of])
    return np.asarray(mean[known])
