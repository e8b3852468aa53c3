"""What may go wrong with a sheet, one number each, and how a sample draws them.

Sample k depends on the seed, on k and on nothing else: its numbers come from a counter-based generator (Philox
4×64-10: Salmon, Moraes, Dror, Shaw, SC'11) whose counter holds k and a hash of the parameter's name, so samples
can be drawn in any order, on any machine, and a further parameter changes no other's numbers.
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
"""A stated tolerance is this many standard deviations of a normal distribution."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One thing that may go wrong.

    Parameters
    ----------
    name : str
        Such as "decentre.2.x": the key, the array, the direction or face.
    key : str
        Key of [tolerances] it comes from; "play" of body.pins.
    half : float
        Stated tolerance: ±half, in design units, radians or as a ratio; 0 … half where one-sided.
    unit : str
        Design unit, "rad" or "".
    one_sided : bool
        Whether only positive errors exist (roughness).
    uniform : bool
        Whether every error up to the end is as likely, whatever the design's distribution (the play of a pin).
    """

    name: str
    key: str
    half: float
    unit: str
    one_sided: bool = False
    uniform: bool = False


def parameters(design: Design, window: Window) -> tuple[Parameter, ...]:
    """Everything the design's [tolerances] lets go wrong, in a fixed order; what has tolerance 0 is left out."""
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
    """How far pins let array 2 move against array 1.

    A pin of diameter d in holes of d + p has p/2 of room all round in either plate, so there plate 2 moves up to p against
    plate 1: by p along x and along y. Where the pins farthest from one another, L apart, let it move opposite ways, it
    turns by 2 p/L about the middle of the pins. Nothing draws a plate to the middle of its play: every place is as likely.
    The three are drawn independently; together they hold every place that the pins allow, and some that they do not.
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
    """Lens faces in the order of the light: array (1, 2; 3: field lens), and ".front" or ".back" where it has two."""
    return [
        (face.array + 1, part if body.columnar or face.array == 2 else "")
        for body in window.bodies
        for part, face in ((".front", body.front), (".back", body.back))
        if face.array is not None
    ]


def draw(
    chosen: Sequence[Parameter], seed: int, sample: int, distribution: str = "normal"
) -> Mapping[str, float]:
    """Errors of sample number `sample`, by name.

    Parameters
    ----------
    chosen : sequence of Parameter
    seed : int, 0 … 2^64 − 1
    sample : int ≥ 0
    distribution : "normal" or "uniform"
        Normal: the tolerance is 2 standard deviations. Uniform: the tolerance is the end, as it always is for parameters
        that are. One-sided parameters take the absolute value.
    """
    found = {}
    for p in chosen:
        # two independent counters' worth of bits would be wasted on one number: the first word is enough
        word = np.random.Philox(key=seed, counter=[0, 0, crc32(p.name.encode()), sample]).random_raw()
        uniform = ((int(word) >> 11) + 0.5) * 2.0**-53
        value = (
            2.0 * uniform - 1.0
            if p.uniform or distribution == "uniform"
            else NormalDist().inv_cdf(uniform) / SIGMAS
        ) * p.half
        found[p.name] = abs(value) if p.one_sided else value
    return found
