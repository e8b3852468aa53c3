"""Where the lenslets of a map lie: turn, pitch and shift of their lattice, from its Fourier maxima.

Block means about a plane, under a Hann window, have maxima at the reciprocal vectors of the lattice. Their
places give turn and pitch, their phases the shift; the sign of the second harmonic separates domes
from bowls.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import hypot, pi
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Floats, Ints
from clacad.measuring.read_map import MeasuredMap
from clacad.sheet.pattern import Pattern
from clacad.storage.errors import UnreadableFile

BLOCKS = 50
"""Blocks of the map over one pitch, at most."""

FEWEST_BLOCKS = 8
"""Blocks over one pitch by which it is searched, at least."""

FINEST = 1024
"""Frequencies along an axis at which power is looked for, where they are twice the blocks at least."""

SOME = 200_000
"""Points or blocks of a large map by which what all show is found."""

DEEP = 4.0
"""Distance of blocks from their plane over its upper quartile from which they are letters, holes or dirt."""

LENS_RANGE = (0.6, 1.3)
"""Range of heights of a square as large as a cell over the sag of a lenslet, where it shows lenslets."""

UNSURE = 0.01
"""Distance (radians) of a turn from the one that may be its opposite, from which it is known."""

FEWEST_PIXELS = 12
"""Fewest pixels across a cell."""

FEWEST_CELLS = 1.8
"""Least width of a map, in cells."""

OFF = 0.05
"""Largest relative difference of the period from the design's."""

SEARCHED = 0.35
"""Largest relative difference of periods that are looked for, so that the message can name them."""

CLEAR = 6.0
"""Least height of the maxima over the median of as long waves."""


class NotMeasurable(UnreadableFile):
    """A map that does not hold the lenslets of the design, or not well enough to be measured."""


NDArrayComplex = NDArray[np.complex128]
Array = TypeVar("Array", Floats, Ints)


@dataclass(frozen=True, eq=False)
class Found:
    """Lattice of a map, in the map's axes.

    origin : (2,) lengths. Centre of the cell nearest to the middle of the map.
    basis : (2, 2) lengths. Columns: steps to the next cell along i and along j.
    turn : radians. By which the step i of the design's lattice is turned in the axes of its cells.
    """

    origin: Floats
    basis: Floats
    turn: float = 0.0

    def nearest(self, x: Floats, y: Floats) -> tuple[Ints, Floats]:
        """Cells (2, n) of places, and the places (2, n) from their centres."""
        place = np.linalg.inv(self.basis) @ np.stack([x - self.origin[0], y - self.origin[1]])
        cell = np.rint(place)
        place -= cell
        return cell.astype(np.int64), np.asarray(self.basis @ place)

    def centres(self, index: Ints) -> Floats:
        """Centres (n, 2) of cells (n, 2)."""
        return np.asarray(self.origin + index @ self.basis.T)


@dataclass(frozen=True, eq=False)
class _Blocks:
    """Block means about their plane, windowed: values (ny, nx), and the places of columns and rows.

    weight : (ny, nx). The window; 0 where nothing was measured.
    """

    values: Floats
    weight: Floats
    x: Floats
    y: Floats

    def at(self, fx: Floats, fy: Floats) -> NDArrayComplex:
        """Fourier sums (len(fy), len(fx)) at frequencies (1/length)."""
        rows = np.exp(-2j * pi * np.outer(fy, self.y))
        columns = np.exp(-2j * pi * np.outer(self.x, fx))
        return np.asarray(rows @ self.values @ columns)

    def joined(self, count: int) -> _Blocks:
        """Sums of squares of `count` × `count` blocks, for long waves."""
        rows, columns = self.values.shape
        both = np.pad([self.values, self.weight], ((0, 0), (0, -rows % count), (0, -columns % count)))
        shape = (2, -(-rows // count), count, -(-columns // count), count)
        values, weight = both.reshape(shape).sum(axis=(2, 4))
        x, y = (
            one[0] + (one[1] - one[0]) * (0.5 * (count - 1) + count * np.arange(size))
            for one, size in ((self.x, shape[3]), (self.y, shape[1]))
        )
        return _Blocks(values, weight, x, y)

    def of_lenslets(self, width: float, sag: float) -> _Blocks:
        """The blocks about which a square of this width ranges over about a lenslet's sag, less its mean.

        Land, letters and the steps to them are left out; one period of lenslets has the mean 0.
        """
        from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

        known = self.weight > 0.0
        raw = np.where(known, self.values / np.where(known, self.weight, 1.0), 0.0)
        size = max(3, round(width / float(self.x[1] - self.x[0])))
        sums, count = (uniform_filter(one, size, mode="constant") for one in (raw, known.astype(np.float64)))
        high = maximum_filter(np.where(known, raw, -np.inf), size)
        low = minimum_filter(np.where(known, raw, np.inf), size)
        known &= (high - low > LENS_RANGE[0] * sag) & (high - low < LENS_RANGE[1] * sag)
        weight = self.weight * known
        return replace(self, values=(raw - sums / np.maximum(count, 1e-9)) * weight, weight=weight)

    def harmonics(self, waves: Floats) -> NDArrayComplex:
        """First and second harmonic (n, 2) of waves (n, 2), by least squares over what was measured.

        Sums over all blocks would take seams that were not measured for heights.
        """
        row, column = np.nonzero(self.weight)
        row, column = thinned(np.stack([row, column]), SOME // 4)
        angle = 2.0 * pi * np.stack([self.x[column], self.y[row]], axis=1) @ waves.T
        every = np.hstack([k * angle for k in (1, 2, 3)])
        root = np.sqrt(self.weight[row, column])
        known = np.column_stack([np.ones(len(row)), np.cos(every), np.sin(every)]) * root[:, None]
        found = np.linalg.lstsq(known, self.values[row, column] / root, rcond=None)[0][1:]
        count = every.shape[1]
        return np.asarray((found[:count] - 1j * found[count:]).reshape(3, -1)[:2].T)


def find_lattice(
    measured: MeasuredMap, design: Pattern, lenslet: Callable[[Floats, Floats], Floats]
) -> Found:
    """Find the lenslets of a map.

    measured : lengths in design units
    design : Cells of the face.
    lenslet : Height of the design's lenslet over places from the centre of its cell.
    Raises NotMeasurable: No period near the design's, too few pixels, or domes for bowls.
    """
    _refuse_coarse(measured, design)
    blocks = _blocks(measured, min(design.pitch) / BLOCKS)
    waves = _waves(design)
    try:
        return _located(blocks, waves, measured, design, lenslet)
    except NotMeasurable as error:
        try:  # steps to land are stronger than lenslets
            shape = lenslet(*design.tile().T)
            level = blocks.of_lenslets(
                min(design.pitch), float(lenslet(np.zeros(1), np.zeros(1))[0] - shape.min())
            )
            return _located(level, waves, measured, design, lenslet)
        except NotMeasurable:
            raise error from None


def _located(
    blocks: _Blocks,
    waves: Floats,
    measured: MeasuredMap,
    design: Pattern,
    lenslet: Callable[[Floats, Floats], Floats],
) -> Found:
    """The lattice of blocks; see `find_lattice`."""
    first = _searched(blocks, waves, design)
    found = np.array([_climbed(blocks, wave) for wave in first])  # rows: waves of the map
    basis = np.linalg.inv(found[:2])  # columns a1, a2 with waves · steps = identity
    _refuse_period(measured, basis, design)
    _refuse_turn(measured, basis, design)
    shown = blocks.harmonics(found)[:2] / _harmonics(design, waves, lenslet)
    phase = shown[:, 0] / np.abs(shown[:, 0])
    if not (shown[:, 1] * np.conj(phase) ** 2).real.sum() > 0.0:
        raise NotMeasurable(
            f"{measured.name}: domes where the design has bowls, or bowls for domes: its z axis points into"
            " the material, or it is a map of the tool"
        )
    origin = basis @ (np.angle(phase) / (-2.0 * pi))
    nearest = np.rint(np.linalg.inv(basis) @ origin)
    return Found(origin - basis @ nearest, basis, design.turn)


def _harmonics(design: Pattern, waves: Floats, lenslet: Callable[[Floats, Floats], Floats]) -> NDArrayComplex:
    """Fourier coefficients (2, 2) of the design's cell: first and second harmonic of both waves."""
    line = (np.arange(64) + 0.5) / 64.0 - 0.5
    steps = np.column_stack([design.a1, design.a2])
    i, j = (one.ravel() for one in np.meshgrid(line, line, indexing="ij"))
    x, y = steps @ np.stack([i, j])
    centres = np.array([steps @ [m, n] for m in (-1, 0, 1) for n in (-1, 0, 1)])
    nearest = centres[np.argmin(np.hypot(x[:, None] - centres[:, 0], y[:, None] - centres[:, 1]), axis=1)]
    height = np.nan_to_num(lenslet(x - nearest[:, 0], y - nearest[:, 1]))
    return np.array(
        [[np.sum(height * np.exp(-2j * pi * k * (w[0] * x + w[1] * y))) for k in (1, 2)] for w in waves[:2]]
    )


def _refuse_coarse(measured: MeasuredMap, design: Pattern) -> None:
    """Refuse a map with too few pixels a cell, or smaller than a cell."""
    side = min(design.pitch if not design.hexagonal else (design.pitch[0], design.row_height))
    across = side / max(measured.pixel)
    if across < FEWEST_PIXELS:
        unit = _factor(across)
        raise NotMeasurable(
            f"{measured.name}: {across:.3g} pixels across a cell, {FEWEST_PIXELS} are the fewest{unit}"
        )
    size = min(measured.shape[0] * measured.pixel[1], measured.shape[1] * measured.pixel[0])
    if size < FEWEST_CELLS * side:
        none = "no whole lenslet" if size < side else "too few lenslets"
        raise NotMeasurable(
            f"{measured.name}: {none}: the map is {size:.4g} wide, a cell {side:.4g}; {FEWEST_CELLS:g} cells"
            f" are the least{_factor(across)}"
        )


def _factor(across: float) -> str:
    """Words for a lateral unit that is a thousand times off, by the pixels across a cell."""
    for factor in (1e3, 1e-3):
        if FEWEST_PIXELS <= across * factor <= 2000.0:
            return (
                "; with a lateral unit 1000 times "
                + ("smaller" if factor > 1.0 else "larger")
                + " it would fit"
            )
    return ""


def thinned(points: Array, most: int = SOME) -> Array:
    """About `most` of the points (..., n) of a large map, evenly chosen; all of a small one."""
    count = points.shape[-1]
    if count <= most:
        return points
    return points[..., np.random.default_rng(0).random(count) < most / count]


def plane_of(points: Floats) -> Floats:
    """Height at 0, 0 and slopes (3,) of the plane of points (3, n), by a part of them."""
    x, y, z = thinned(points)
    design = np.column_stack([np.ones(len(x)), x, y])
    return np.asarray(np.linalg.lstsq(design, z, rcond=None)[0])


def means(u: Floats, v: Floats, z: Floats) -> tuple[Floats, Bools]:
    """Mean (rows, columns) of heights over unit squares from 0, 0 where none is; where any is."""
    column, row = (np.floor(at + 1e-6).astype(np.int64) for at in (u, v))
    shape = int(row.max()) + 1, int(column.max()) + 1
    flat, most = row * shape[1] + column, shape[0] * shape[1]
    count = np.bincount(flat, minlength=most)
    mean = np.bincount(flat, z, minlength=most) / np.maximum(count, 1)
    return mean.reshape(shape), (count > 0).reshape(shape)


def _blocks(measured: MeasuredMap, size: float) -> _Blocks:
    """Means of the map over blocks of about `size`, about their plane, under a Hann window."""
    step = [max(1, int(size / pixel + 0.5)) * pixel for pixel in measured.pixel]
    x, y, z = measured.points
    low = [x.min(), y.min()]
    mean, known = means((x - low[0]) / step[0], (y - low[1]) / step[1], z)
    shape = mean.shape
    gx, gy = (low[k] + (np.arange(shape[1 - k]) + 0.5) * step[k] for k in (0, 1))
    for _ in range(2):
        ry, rx = thinned(np.stack(np.nonzero(known)))
        z0, slope_x, slope_y = plane_of(np.stack([gx[rx], gy[ry], mean[ry, rx]]))
        values = (mean - z0 - slope_x * gx - slope_y * gy[:, None]) * known
        known &= np.abs(values) <= DEEP * np.quantile(np.abs(values[ry, rx]), 0.75)
    values *= known
    window = np.outer(np.hanning(shape[0] + 2)[1:-1], np.hanning(shape[1] + 2)[1:-1])
    return _Blocks(values * window, window * known, gx, gy)


def _waves(design: Pattern) -> Floats:
    """Reciprocal vectors (2 or 3, 2) of the unturned design's lattice: those of its shortest periods."""
    a1, a2 = np.array(design.a1), np.array(design.a2)
    one, two = np.linalg.inv(np.column_stack([a1, a2]))
    return np.array([one, two, one + two]) if design.hexagonal else np.array([one, two])


def _searched(blocks: _Blocks, waves: Floats, design: Pattern) -> Floats:
    """The waves turned and scaled to where the power of the map is largest."""
    from scipy.fft import next_fast_len

    blocks = blocks.joined(max(1, int(min(design.pitch) / (FEWEST_BLOCKS * (blocks.x[1] - blocks.x[0])))))
    size = (np.ptp(blocks.x) + 1e-12, np.ptp(blocks.y) + 1e-12)
    counts = [next_fast_len(max(2 * n, min(4 * n, FINEST))) for n in blocks.values.shape]
    power = np.abs(np.fft.fft2(blocks.values, counts))
    step = (blocks.x[1] - blocks.x[0], blocks.y[1] - blocks.y[0])
    bins = [1.0 / (counts[1] * step[0]), 1.0 / (counts[0] * step[1])]
    longest = float(np.hypot(*waves.T).max())
    fine = 0.2 / (max(size) * longest)
    half = _symmetry(design)
    turns = np.arange(-half, half, fine)
    scales = np.exp(np.arange(-SEARCHED, SEARCHED, fine))
    best, place = -1.0, (0.0, 1.0)
    for scale in scales:
        score = np.ones(len(turns))
        for wave in waves:
            fx = scale * (wave[0] * np.cos(turns) - wave[1] * np.sin(turns))
            fy = scale * (wave[0] * np.sin(turns) + wave[1] * np.cos(turns))
            i, j = (
                np.rint(fy / bins[1]).astype(int) % counts[0],
                np.rint(fx / bins[0]).astype(int) % counts[1],
            )
            score *= power[i, j]
        k = int(np.argmax(score))
        if score[k] > best:
            best, place = float(score[k]), (float(turns[k]), float(scale))
    turn, scale = place
    around = np.median(power[_annulus(counts, bins, longest * scale)])
    if not best ** (1.0 / len(waves)) > CLEAR * max(float(around), 1e-300):
        raise NotMeasurable("no lattice of lenslets is found: no period near the design's is clear")
    c, s = np.cos(turn), np.sin(turn)
    return np.asarray(scale * waves @ np.array([[c, s], [-s, c]]))


def _annulus(counts: list[int], bins: list[float], radius: float) -> Bools:
    """Frequencies (ny, nx) of about one length."""
    fx, fy = np.fft.fftfreq(counts[1]) * counts[1] * bins[0], np.fft.fftfreq(counts[0]) * counts[0] * bins[1]
    length = np.hypot(fx[None, :], fy[:, None])
    return np.asarray((length > 0.5 * radius) & (length < 2.0 * radius))


def _climbed(blocks: _Blocks, wave: Floats) -> Floats:
    """The wave (2,) moved to the maximum of the power of the map."""
    step = np.array([0.25 / np.ptp(blocks.x), 0.25 / np.ptp(blocks.y)])
    at = wave.copy()
    for _ in range(12):
        offsets = np.array([-1.0, 0.0, 1.0])
        power = np.log(np.abs(blocks.at(at[0] + step[0] * offsets, at[1] + step[1] * offsets)) ** 2 + 1e-300)
        for axis, line in enumerate((power[1], power[:, 1])):
            bend = line[0] - 2.0 * line[1] + line[2]
            move = 0.5 * (line[0] - line[2]) / bend if bend < 0.0 else np.sign(line[2] - line[0])
            at[axis] += step[axis] * float(np.clip(move, -1.0, 1.0))
        step *= 0.6
    return at


def _refuse_turn(measured: MeasuredMap, basis: Floats, design: Pattern) -> None:
    """Refuse a lattice that is turned one way as far as the other way: which step is which is not known."""
    most = _symmetry(design)
    turn = float(np.arctan2(basis[1, 0], basis[0, 0]) - np.arctan2(design.a1[1], design.a1[0]))
    if abs(abs(np.angle(np.exp(1j * turn))) - most) < UNSURE:
        raise NotMeasurable(
            f"{measured.name}: it is turned by {np.degrees(most):.3g} deg within {np.degrees(UNSURE):.2g};"
            " its lattice does not show which way: turn the part and measure it again"
        )


def _symmetry(design: Pattern) -> float:
    """Half of the turn (radians) by which the design's lattice lies on itself."""
    return pi / (6.0 if design.hexagonal else 2.0 if design.pitch[0] != design.pitch[1] else 4.0)


def _refuse_period(measured: MeasuredMap, basis: Floats, design: Pattern) -> None:
    """Refuse a lattice whose period is not the design's."""
    wanted = [hypot(*design.a1), hypot(*design.a2)]
    got = np.hypot(*basis)
    off = got / wanted - 1.0
    if np.abs(off).max() > OFF:
        worst = int(np.argmax(np.abs(off)))
        raise NotMeasurable(
            f"{measured.name}: lenslets every {got[0]:.5g} and {got[1]:.5g}, by the design every"
            f" {wanted[0]:.5g} and {wanted[1]:.5g}: {100.0 * off[worst]:+.3g} %, and {100.0 * OFF:g} % is the"
            " most: another part, another lateral scale, or pieces that are bonded with a gap"
        )
