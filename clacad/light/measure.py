"""Light of a bundle of rays behind a sheet, compared with the law: error, bias, spread, share, fitted law.

The caller gives the sender: any callable that traces a bundle. Only ALIVE rays count; a number from fewer
rays than `Light.fewest` is NaN. Light of several wavelengths and temperatures is the light of all of them
together, each with its weight; `Light.lines` holds them one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import nan
from typing import cast

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.base.vectors import axes_near
from clacad.optics.law import Fit, Law, angle_between, linear_numbers, with_linear_numbers
from clacad.optics.law.law import law_in_axes
from clacad.optics.rays import Fate, Rays, TraceResult, joined_results
from clacad.sheet.bundle import Bundle, RequestedLaw

FEWEST = 64
"""Least number of ALIVE rays for a result other than NaN."""

FIT_SCALE = 0.1
"""Aperture and field of the bundle on which η and δ are fitted, over those of the main bundle."""

Send = Callable[[Bundle], TraceResult]
"""Traces a bundle: through exact surfaces, facets, a file's faces, a measured map, or a displaced copy."""

Weights = Mapping[float, float] | Sequence[float]
"""Value → weight, or values of equal weights."""


@dataclass(frozen=True, eq=False)
class Light:
    """Light of one bundle behind a sheet.

    Every quantity is computed when it is first read.

    lit : Rays as sent.
    seen : Where the sender sent them.
    law : Law and power that the light is compared with.
    fewest : Least number of ALIVE rays for a result other than NaN.
    weight : (n,) or None. Weight of each ray; None: all equal.
    lines : Light of each wavelength and temperature; empty for light of the design's.
    """

    lit: Bundle
    seen: TraceResult
    law: RequestedLaw
    fewest: int = FEWEST
    weight: Floats | None = None
    lines: tuple[Light, ...] = ()

    @cached_property
    def alive(self) -> Bools:
        """Rays (n,) that left through every lens face of one telescopelet."""
        return np.asarray(self.seen.fate == Fate.ALIVE)

    @property
    def dark(self) -> bool:
        """Whether fewer than `fewest` rays are ALIVE."""
        return bool(self.alive.sum() < self.fewest)

    @cached_property
    def direction(self) -> Floats:
        """Exit directions (n, 3), unit, without the effect of the requested focus."""
        return self.law.without_focus(self.lit.points, self.seen.direction)

    @cached_property
    def expected(self) -> Floats:
        """Exit directions (n, 3) of the law; NaN where it has no answer."""
        return self.law.refract(self.lit.rays.direction)

    @cached_property
    def error(self) -> Floats:
        """Angle (n,) of each ray to the law, radians; NaN for a ray that is not ALIVE, or without a law."""
        error = np.full(len(self.seen), np.nan)
        error[self.alive] = angle_between(self.direction[self.alive], self.expected[self.alive])
        return error

    @cached_property
    def known(self) -> Bools:
        """Rays (n,) that have an error."""
        return np.isfinite(self.error)

    @cached_property
    def rms(self) -> float:
        """Root mean square angle to the law, radians."""
        return rms_of(self, self.known)

    @cached_property
    def worst(self) -> float:
        """Largest angle to the law, radians."""
        known = self.error[self.known]
        return float(known.max()) if len(known) >= self.fewest else nan

    @cached_property
    def mean(self) -> Floats:
        """Mean exit direction (3,); its length is below 1 where rays spread."""
        return _mean(self.direction[self.alive], _some(self.weight, self.alive))

    @cached_property
    def bias(self) -> float:
        """Angle of the mean exit direction of parallel light to the law, radians."""
        expected = self.expected[0]
        if self.dark or not np.isfinite(expected).all():
            return nan
        return float(angle_between(self.mean, expected))

    @cached_property
    def spread(self) -> float:
        """Root mean square angle to the mean exit direction, radians."""
        if self.dark:
            return nan
        angle = angle_between(self.direction[self.alive], self.mean)
        return rms_angle(angle, _some(self.weight, self.alive))

    @cached_property
    def share(self) -> float:
        """ALIVE rays over all rays."""
        return float(_mean(self.alive, self.weight))

    @cached_property
    def fit(self) -> Fit | None:
        """Law fitted to the ALIVE rays in the axes of the requested law, with uncertainties.

        None for too few; light of several lines has none: its scatter is not that of one law.
        """
        if self.dark or self.lines:
            return None
        try:
            return Law.fit(*_in_and_out(self), axes=self.law.law)
        except ValueError:  # the exit directions do not depend on the incident ones: no law can be fitted
            return None

    @cached_property
    def fitted(self) -> Law | None:
        """Law of `fit`, without uncertainties.

        Of several lines with the same rays: their mean in 1/η and δ/η, in which a law is linear.
        """
        if self.lines:
            return _mean_law(self)
        return None if self.dark else fitted_law(*_in_and_out(self), self.law.law)


def mean_rms(light: Light) -> float:
    """Mean over the lines of light, with their weights, of each line's `rms` (radians); of one line `rms`."""
    if not light.lines:
        return light.rms
    return float(np.average([line.rms for line in light.lines], weights=_of_lines(light)))


def rms_of(light: Light, rays: Bools) -> float:
    """Root mean square angle to the law (radians) of some of the rays (n,) that have an error."""
    return rms_angle(light.error[rays], _some(light.weight, rays), light.fewest)


def deviation(light: Light) -> Floats:
    """Exit directions (k, 2) of the ALIVE rays of parallel light, across the law's direction, radians.

    The first axis is the one nearest to +x; none where the light is dark.
    """
    expected = light.expected[0]
    if light.dark or not np.isfinite(expected).all():
        return np.empty((0, 2))
    return np.asarray(light.direction[light.alive] @ np.stack(axes_near(expected), axis=1))


def measure(
    send: Send,
    lit: Bundle,
    law: RequestedLaw,
    wavelengths: Weights = (),
    temperatures: Weights = (),
    fewest: int = FEWEST,
) -> Light:
    """Send a bundle of rays and compare it with the law.

    send : Bundle → TraceResult.
    wavelengths : mapping of metres to weight, or metres. Empty: the design's, without weights.
    temperatures : mapping of kelvin above the design's temperature to weight, or kelvin
        Empty: the design's. Other than 0 needs a sender with a method `heated`.
    fewest : Least number of ALIVE rays for a result other than NaN; of all lines together.
    Raises TypeError: The sender has no temperature.
    Raises ValueError: A weight is not a positive number; or the index is not known at a wavelength, or its
        change with temperature.
    """
    if not wavelengths and not temperatures:
        return Light(lit, send(lit), law, fewest)
    lines, weights = [], []
    for kelvin, hot in _weighted(temperatures) or [(0.0, 1.0)]:
        through = send if kelvin == 0.0 else _heated(send, kelvin)
        each = _in_lines(lit, wavelengths)
        for (one, bright), seen in zip(each, _seen(through, lit, [*wavelengths], each), strict=True):
            lines.append(Light(one, seen, law, fewest))
            weights.append(hot * bright)
    return _together(lines, weights)


def measure_each(
    send: Send, bundles: Sequence[Bundle], law: RequestedLaw, fewest: int = FEWEST
) -> tuple[Light, ...]:
    """Light of several bundles over one cell, sent in one call.

    Additional rays add little to the cost of a call.
    """
    return tuple(lights(send(_joined(bundles)), bundles, law, fewest))


def lights(
    seen: TraceResult, bundles: Sequence[Bundle], law: RequestedLaw, fewest: int = FEWEST
) -> Iterator[Light]:
    """Light of each of several bundles whose rays were sent one after another in one call."""
    first = 0
    for lit in bundles:
        last = first + len(lit.rays)
        yield Light(lit, seen.rows(slice(first, last)), law, fewest)
        first = last


def first_rays(light: Light, count: int) -> Light:
    """Light of the first rays of a bundle; light of one line."""
    lit, some = light.lit, slice(count)
    rays = Rays(lit.rays.position[some], lit.rays.direction[some])
    return Light(
        replace(lit, rays=rays, points=lit.points[some]), light.seen.rows(some), light.law, light.fewest
    )


def fitted_law(into: Floats, out: Floats, axes: Law) -> Law | None:
    """Law of rays (n, 3) before and behind a sheet in the axes of another law.

    None where they determine none.
    """
    try:
        return law_in_axes(into, out, axes)
    except ValueError:  # exit directions that do not depend on the incident ones
        return None


def rms_angle(angle: Floats, weight: Floats | None = None, fewest: int = 1) -> float:
    """Root mean square (radians) of angles (k,) with their weights; NaN for fewer than `fewest`."""
    return float(np.sqrt(_mean(angle**2, weight))) if len(angle) >= fewest else nan


def rms_angles(angle: Floats) -> Floats:
    """Root mean square (n,), radians, of each row of angles (n, k), NaN for rays without one."""
    known = np.isfinite(angle).sum(axis=1)
    return np.asarray(np.sqrt(np.nansum(angle**2, axis=1) / np.maximum(known, 1)))


def _in_and_out(light: Light) -> tuple[Floats, Floats]:
    """Directions (k, 3) of the ALIVE rays before and behind the sheet."""
    return light.lit.rays.direction[light.alive], light.direction[light.alive]


def _mean_law(light: Light) -> Law | None:
    """Mean law of light of several lines; None where one of them has none."""
    laws = [line.fitted for line in light.lines]
    whole = [law for law in laws if law is not None]
    if len(whole) < len(laws):
        return None
    numbers = np.average([linear_numbers(law) for law in whole], axis=0, weights=_of_lines(light))
    return with_linear_numbers(whole[0], numbers)


def _of_lines(light: Light) -> Floats:
    """Weight of each line of light of several lines (lines,)."""
    assert light.weight is not None  # several lines have weights
    return light.weight[:: len(light.weight) // len(light.lines)]


def _some(weight: Floats | None, rays: Bools) -> Floats | None:
    return None if weight is None else weight[rays]


def _mean(values: Floats | Bools, weight: Floats | None) -> Floats:
    """Mean over the first axis."""
    if weight is None:
        return np.asarray(np.mean(values, axis=0))
    return np.asarray(np.average(values, axis=0, weights=weight))


def _in_lines(lit: Bundle, wavelengths: Weights) -> list[tuple[Bundle, float]]:
    """The bundle in light of each wavelength, with its weight; the bundle itself where there is none."""
    if not wavelengths:
        return [(lit, 1.0)]
    rays = lit.rays
    return [
        (replace(lit, rays=Rays(rays.position, rays.direction, wave)), weight)
        for wave, weight in _weighted(wavelengths)
    ]


def _seen(
    send: Send, lit: Bundle, waves: Sequence[float], each: Sequence[tuple[Bundle, float]]
) -> list[TraceResult]:
    """Where a sender sends the bundle in each line: at once where it can."""
    at_once: Callable[..., list[TraceResult]] | None = getattr(send, "in_lines", None)
    if at_once is None or len(waves) < 2:
        return [send(one) for one, _ in each]
    return at_once(lit, waves)


def _weighted(values: Weights) -> list[tuple[float, float]]:
    """Values with their weights."""
    pairs = values.items() if isinstance(values, Mapping) else [(value, 1.0) for value in values]
    if not all(0.0 < weight < np.inf for _, weight in pairs):
        raise ValueError(f"weights {[weight for _, weight in pairs]} of light are not all positive numbers")
    return [(float(value), float(weight)) for value, weight in pairs]


def _heated(send: Send, kelvin: float) -> Send:
    heated: Callable[[float], Send] | None = getattr(send, "heated", None)
    if heated is None:
        raise TypeError("this sender of light has no temperature: it needs a method heated(kelvin)")
    return heated(kelvin)


def _joined(bundles: Sequence[Bundle]) -> Bundle:
    """One bundle of the rays of several over one cell."""
    rays = [one.rays for one in bundles]
    waves = None
    if rays[0].wavelength is not None:
        waves = np.concatenate([cast(Floats, one.wavelength) for one in rays])
    joined = Rays(
        np.concatenate([one.position for one in rays]), np.concatenate([one.direction for one in rays]), waves
    )
    return replace(bundles[0], rays=joined, points=np.concatenate([one.points for one in bundles]))


def _together(lines: Sequence[Light], weights: Sequence[float]) -> Light:
    """Light of several lines of the same rays together."""
    first = lines[0]
    lit = _joined([line.lit for line in lines])
    return Light(
        lit,
        joined_results([line.seen for line in lines]),
        first.law,
        first.fewest,
        np.repeat(weights, len(first.seen)),
        tuple(lines),
    )
