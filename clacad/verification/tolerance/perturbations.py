"""Fabrication errors of a sheet as parameters, and how a sample draws them.

Sample k depends on the seed and on k only. Its numbers are those of a counter-based generator (Philox
4×64-10: Salmon, Moraes, Dror, Shaw, SC'11) whose counter holds k and a hash of the parameter's name. Samples
can
therefore be drawn in any order, on any machine, and an additional parameter does not change the numbers of
others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import dist
from statistics import NormalDist
from typing import TYPE_CHECKING
from zlib import crc32

import numpy as np

from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.design import Design

SIGMAS = 2.0
"""Standard deviations of a normal distribution in a stated tolerance."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One fabrication error.

    Parameters
    ----------
    name : str
        Such as "decentre.2.x": the key, the array, the direction or face.
    key : str
        Key of [tolerances] that sets it; "play" of body.pins.
    half : float
        Stated tolerance: ±half, in design units, radians or as a ratio; 0 … half where one-sided.
    unit : str
        Design unit, "rad" or "".
    one_sided : bool
        Whether only positive errors exist (roughness).
    uniform : bool
        Whether all errors up to the tolerance are equally likely, regardless of the design's distribution
        (pin play).
    """

    name: str
    key: str
    half: float
    unit: str
    one_sided: bool = False
    uniform: bool = False


def parameters(design: Design, window: Window) -> tuple[Parameter, ...]:
    """Parameters of all tolerances in the design's [tolerances], in a fixed order; tolerances of 0 are
    omitted.
    """
    spec, unit = design.tolerances, design.unit
    found: list[Parameter] = []
    for array, half in enumerate(spec.decentre, 1):
        found += [Parameter(f"decentre.{array}.{axis}", "decentre", half, unit) for axis in "xy"]
    found.append(Parameter("rotation", "rotation", spec.rotation, "rad"))
    if len(window.bodies) > 1:
        found.append(Parameter("separation", "separation", spec.separation, unit))
    if len(window.bodies) == 3:
        aside = spec.of_array(spec.decentre, 2)
        found += [Parameter(f"decentre.3.{axis}", "decentre", aside, unit) for axis in "xy"]
    for array, part in curved_faces(window):
        half = spec.of_array(spec.radius, array - 1)
        found.append(Parameter(f"radius.{array}{part}", "radius", half, ""))
    bodies = range(1, len(window.bodies) + 1)
    found += [Parameter(f"index.{body}", "index", spec.index, "") for body in bodies]
    found += [
        Parameter(f"thickness.{body}", "thickness", spec.of_body(body, len(window.bodies)), unit)
        for body in bodies
    ]
    found += [Parameter(f"tilt.{axis}", "tilt", spec.tilt, "rad") for axis in "xy"]
    found.append(Parameter("roughness", "roughness", spec.roughness, unit, one_sided=True))
    found += _play(design)
    return tuple(p for p in found if p.half > 0.0)


def _play(design: Design) -> list[Parameter]:
    """Parameters of the play that pins leave array 2 relative to array 1.

    A pin of diameter d in holes of d + p has p/2 of room all round in either plate. Plate 2 therefore moves
    up to p
    relative to plate 1 along x and along y. Where the pins farthest apart, at distance L, allow opposite
    motions, it
    turns by 2 p/L about the middle of the pins. Nothing centres a plate in its play: all positions are
    equally likely.
    The three are drawn independently; together they cover every pose that the pins allow, and some that they
    do not.
    """
    pins = design.body.pins
    if pins is None:
        return []
    apart = max(dist(a, b) for a in pins.at for b in pins.at)
    return [
        Parameter("pins.x", "play", pins.play, design.unit, uniform=True),
        Parameter("pins.y", "play", pins.play, design.unit, uniform=True),
        Parameter("pins.turn", "play", 2.0 * pins.play / apart, "rad", uniform=True),
    ]


def curved_faces(window: Window) -> list[tuple[int, str]]:
    """Lens faces in the order of the light: array (1, 2; 3: field lens), and ".front" or ".back" where it
    has two.
    """
    return [
        (face.array + 1, part if body.columnar or face.array == 2 else "")
        for body in window.bodies
        for part, face in ((".front", body.front), (".back", body.back))
        if face.array is not None
    ]


def draw(
    chosen: Sequence[Parameter], seed: int, sample: int, distribution: str = "normal"
) -> Mapping[str, float]:
    """Errors of sample number `sample`, by parameter name.

    Parameters
    ----------
    chosen : sequence of Parameter
    seed : int, 0 … 2^64 − 1
    sample : int ≥ 0
    distribution : "normal" or "uniform"
        Normal: the tolerance is 2 standard deviations. Uniform: the tolerance is the limit, as always for
        parameters
        with `uniform`. One-sided parameters take the absolute value.
    """
    found = {}
    for p in chosen:
        # one number uses only the first word of the counter's output
        word = np.random.Philox(key=seed, counter=[0, 0, crc32(p.name.encode()), sample]).random_raw()
        uniform = ((int(word) >> 11) + 0.5) * 2.0**-53
        value = (
            2.0 * uniform - 1.0
            if p.uniform or distribution == "uniform"
            else NormalDist().inv_cdf(uniform) / SIGMAS
        ) * p.half
        found[p.name] = abs(value) if p.one_sided else value
    return found
