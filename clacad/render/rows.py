"""The paper's figures and movies as rows that a rendered picture must meet.

Each row names its scenes and says what must be measured on the coordinate screen; expected numbers are the
closed forms of the paper's section 3 with the camera at D = 20 (Hamilton & Courtial 2009). Tolerances cover
what real lenslets do to them: the finite separation (turned at z = s instead of 0: up to 1 %) and aberration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.render.measure import ScreenMap, measure
from clacad.scene import Scene

Floats = NDArray[np.float64]
Loader = Callable[[str], Scene]

D = 20.0
"""Distance of the camera, tiles."""

RAYS = 230
"""Rays across a measured picture: not a multiple of the lens pitch."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One measured number beside the expected one."""

    what: str
    measured: float
    expected: float
    tolerance: float

    @property
    def passed(self) -> bool:
        """Whether it lies within the tolerance."""
        return abs(self.measured - self.expected) <= self.tolerance

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "what": self.what, "measured": self.measured, "expected": self.expected, "tolerance": self.tolerance,
            "passed": self.passed,
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure or movie: its scenes and what is measured.

    Parameters
    ----------
    row : str
        Number in the list of the paper's claims.
    title, says : str
    scenes : tuple of (scene file stem, label)
    check : callable(loader) → findings
    movie : bool
    """

    row: str
    title: str
    says: str
    scenes: tuple[tuple[str, str], ...]
    check: Callable[[Loader], Iterator[Finding]]
    movie: bool = False


def _map(scene: Scene, z: float) -> ScreenMap:
    return measure(scene, z, RAYS, compiled=True)


def _turned(scene: Scene, k: int, degrees: float) -> Scene:
    """The scene with one Euler angle of its sheet set."""
    return scene.replace({f"sheet.set.law.euler.{k}": degrees})


def _squash(load: Loader) -> Iterator[Finding]:
    for ratio in (0.25, 0.5, 1.0, 2.0):
        found = _map(load(f"fig2-eta-{ratio:g}"), 10.0).matrix
        for axis, name, value in ((0, "x", ratio), (1, "y", 1.0)):
            what = f"eta_x = -{ratio:g}, z = 10: 1/stretch in {name}"
            yield Finding(what, float(found[axis, axis]), 1.0 - 10.0 / (D * value), 0.04)


def _distance(load: Loader) -> Iterator[Finding]:
    scene = load("fig3-movie").at(0)
    for z in (2.0, 8.0, 10.0, 15.0, 38.0):
        found = _map(scene, z).matrix
        yield Finding(f"z = {z:g}: 1/stretch in x", float(found[0, 0]), 1.0 - 4.0 * z / D, 0.01 + 0.005 * z)
        yield Finding(f"z = {z:g}: 1/stretch in y", float(found[1, 1]), 1.0 - z / D, 0.01 + 0.001 * z)
    for axis, name, pole, near in ((0, "x", 5.0, 1.0), (1, "y", 20.0, 2.0)):
        before, after = (float(_map(scene, pole + step).matrix[axis, axis]) for step in (-near, near))
        crossing = pole - near + 2.0 * near * before / (before - after)
        yield Finding(f"stretch in {name} changes sign at z", crossing, pole, 0.0125 * pole)
    found = _map(scene, -2.0).matrix
    yield Finding("z = -2, before the sheet: undistorted in x", float(found[0, 0]), 1.0 - 2.0 / D, 1e-9)
    yield Finding("z = -2, before the sheet: undistorted in y", float(found[1, 1]), 1.0 - 2.0 / D, 1e-9)


def _offset(load: Loader) -> Iterator[Finding]:
    for stem, dx, dy in (
        ("0-0.01", 0.0, 0.01), ("0.005-0.01", 0.005, 0.01), ("0.01-0", 0.01, 0.0), ("m0.005-0.005", -0.005, 0.005),
    ):  # fmt: skip
        found = _map(load(f"fig4-delta-{stem}"), 10.0)
        x, y = found.appears_at(0.0, 0.0)
        yield Finding(
            f"delta = ({dx:g}, {dy:g}): axis point at z = 10 appears at x", float(x), 40.0 * dx, 0.015
        )
        yield Finding(
            f"delta = ({dx:g}, {dy:g}): axis point at z = 10 appears at y", float(y), -20.0 * dy, 0.008
        )
        yield Finding(f"delta = ({dx:g}, {dy:g}): shear", float(found.matrix[0, 1]), 0.0, 0.005)


def winding(maps: list[Floats]) -> float:
    """Degrees by which a picture turns as its maps (2, 2) from the sheet to the screen change, followed step by step."""
    total, last = 0.0, None
    for matrix in maps:
        up = np.linalg.solve(matrix, np.array([0.0, 1.0]))
        angle = math.degrees(math.atan2(-up[0], up[1]))
        if last is not None:
            total += (angle - last + 180.0) % 360.0 - 180.0
        last = angle
    return total


def _roll(load: Loader) -> Iterator[Finding]:
    scene = load("fig5-movie").at(0)
    for z, expected in ((3.0, 0.0), (10.0, 360.0), (30.0, 0.0)):
        maps = [_map(_turned(scene, 0, phi), z).matrix for phi in np.linspace(0.0, 180.0, 13)]
        yield Finding(
            f"phi 0 to 180: turn of a piece at z = {z:g}, degrees", abs(winding(maps)), expected, 1e-6
        )
    far = 1.0e4
    for phi, expected in ((0.0, 0.0), (26.57, 36.87), (90.0, 0.0), (153.43, -36.87)):
        found = _map(_turned(scene, 0, phi), far).matrix
        tilt = math.degrees(math.atan2(-found[1, 0], found[1, 1]))
        tilt = (tilt + 90.0) % 180.0 - 90.0
        yield Finding(f"phi = {phi:g}: tilt of the horizon, degrees", abs(tilt), abs(expected), 0.6)


def _tilt(load: Loader) -> Iterator[Finding]:
    for theta in (0.25, 0.5, 1.0):
        x, y = _map(load(f"fig6-theta-{theta:g}"), 10.0).appears_at(0.0, 0.0)
        angle = math.radians(theta)
        yield Finding(
            f"theta = {theta:g}: axis point at z = 10 appears at x", float(x), -45.0 * angle, 0.03 * theta
        )
        yield Finding(
            f"theta = {theta:g}: axis point at z = 10 appears at y", float(y), -5.0 * angle, 0.03 * theta
        )


def _swing(load: Loader) -> Iterator[Finding]:
    start = math.atan2(-5.0, -45.0)
    radius = math.radians(0.5) * math.hypot(45.0, 5.0)
    for psi in (45.0, 90.0, 180.0, 270.0):
        found = _map(load(f"fig7-psi-{psi:g}"), 10.0)
        x, y = found.appears_at(0.0, 0.0)
        yield Finding(f"psi = {psi:g}: distance of the apparent centre", math.hypot(x, y), radius, 0.008)
        turned = math.degrees(math.atan2(y, x) - start) - psi
        turned = (turned + 180.0) % 360.0 - 180.0
        yield Finding(f"psi = {psi:g}: turn of the apparent centre beyond psi, degrees", turned, 0.0, 1.5)
    movie = load("fig7-movie")
    assert movie.animation is not None
    first, last = (_map(movie.at(k), 10.0).matrix for k in (0, movie.animation.frames - 1))
    yield Finding(
        "psi = 360 against 0: largest change of the map", float(np.abs(first - last).max()), 0.0, 1e-9
    )


def _vanish(load: Loader) -> Iterator[Finding]:
    centres = {
        3.0: (-0.195, 0.133),
        8.0: (0.175, -0.407),
        10.0: (0.044, -0.393),
        38.0: (0.494, 0.243),
        60.0: (0.381, 0.143),
    }
    scene = load("fig8-z-60")
    for z, (x, y) in centres.items():
        at = _map(scene, z).appears_at(0.0, 0.0)
        slack = 0.02 if z < 20.0 else 0.03
        yield Finding(f"z = {z:g}: apparent centre x", float(at[0]), x, slack)
        yield Finding(f"z = {z:g}: apparent centre y", float(at[1]), y, slack)
    stretches = np.sort(np.linalg.eigvals(np.linalg.inv(_map(scene, 60.0).matrix)).real)
    yield Finding("z = 60: larger stretch", float(stretches[0]), -0.5, 0.02)
    yield Finding("z = 60: smaller stretch", float(stretches[1]), -0.0909, 0.005)


FIGURES: tuple[Figure, ...] = (
    Figure("F2", "Fig. 2: eta_x varied", "Squashed or stretched in x only; at eta_x = -1/2 the image lies at the camera: a smear.",
           tuple((f"fig2-eta-{e}", f"eta_x = -{e}, z = 10") for e in ("0.25", "0.5", "1", "2")), _squash),
    Figure("F3", "Fig. 3: distance of the piece", "The stretch in x grows and changes its sign at z = 5, then that in y at z = 20.",
           tuple((f"fig3-z-{z.replace('-', 'm')}", f"z = {z}") for z in ("-2", "2", "4.5", "8", "15", "38")), _distance),
    Figure("F4", "Fig. 4: offset axes", "The view shifts; there is no shear.",
           tuple((f"fig4-delta-{d}", f"delta = {label}") for d, label in (("0-0.01", "(0, 0.01)"), ("0.005-0.01", "(0.005, 0.01)"),
                 ("0.01-0", "(0.01, 0)"), ("m0.005-0.005", "(-0.005, 0.005)"))), _offset),
    Figure("F5", "Fig. 5: phi from 0 to 180 degrees", "The piece turns once round and distorts; the horizon only seesaws.",
           tuple((f"fig5-phi-{f}", f"phi = {f}") for f in ("26.57", "45", "90", "135", "153.43")), _roll),
    Figure("F6", "Fig. 6: theta varied, phi = 45 degrees", "The view shifts sideways.",
           tuple((f"fig6-theta-{t}", f"theta = {t}") for t in ("0.25", "0.5", "1")), _tilt),
    Figure("F7", "Fig. 7: psi from 0 to 360 degrees", "The view turns about the sheet's axis and distorts; it closes at 360 degrees.",
           tuple((f"fig7-psi-{p}", f"psi = {p}") for p in ("45", "90", "180", "270")), _swing),
    Figure("F8", "Fig. 8: distance behind the more complex sheet", "At z = 60 the piece is very small.",
           tuple((f"fig8-z-{z}", f"z = {z}") for z in ("3", "8", "38", "60")), _vanish),
)  # fmt: skip
"""Figures 2 to 8 of the paper."""

MOVIES: tuple[tuple[str, str], ...] = (
    ("fig3-movie", "Fig. 3: z from -2 to 38"),
    ("fig5-movie", "Fig. 5: phi from 0 to 180 degrees"),
    ("fig7-movie", "Fig. 7: psi from 0 to 360 degrees"),
    ("fig8-movie", "Fig. 8: z from -2 to 38"),
)
"""Scene and title of each movie."""
