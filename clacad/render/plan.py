"""How rays of a scene pass the sheet: the rung, the effects, and which fates shine.

The cheapest rung that the scene's smallest angle and radiance allow is found by measuring, with a few
thousand of the camera's own rays, what each cheaper rung leaves out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from clacad.rays import Fate, Rays, TraceResult
from clacad.render.camera import aim, rays
from clacad.scene import Scene
from clacad.sheet import Window
from clacad.sobol import sobol
from clacad.trace import trace

Floats = NDArray[np.float64]
Rung = Literal["law", "thin", "surfaces", "mesh"]

PROBES = 2048
"""Camera rays that choose the rung."""

FINEST = 0.15e-3
"""Smallest angle that `angle = "auto"` asks for, radians: half a minute of arc."""


@dataclass(frozen=True, eq=False)
class Passage:
    """How rays pass the sheet.

    Attributes
    ----------
    rung : "law", "thin", "surfaces" or "mesh"
    shining : tuple of Fate
        Fates whose rays bring light; all others are black.
    effects : tuple
        Passes for `trace`.
    dispersion : bool
        Whether wavelengths are traced apart.
    plan : object or None
        The effect plan, for metadata.
    mesh : object or None
        Rung mesh: the triangles.
    why : str
        What chose the rung, one line.
    """

    rung: Rung
    shining: tuple[int, ...]
    effects: tuple[Any, ...] = ()
    dispersion: bool = False
    plan: Any = None
    mesh: Any = None
    why: str = ""

    def trace(self, window: Window, bundle: Rays, compiled: bool) -> TraceResult:
        """Trace a block of rays, on this thread alone."""
        path: Literal["numpy", "numba"] = "numba" if compiled else "numpy"
        return trace(window, bundle, rung=self.rung, effects=self.effects, threads=1, path=path)


def plan_passage(scene: Scene, window: Window) -> Passage:
    """Choose rung and effects of a still scene."""
    rung, why = chosen_rung(scene, window)
    ghosts = ghosts_on(scene, window)
    shining = (int(Fate.ALIVE), int(Fate.LAND), *((int(Fate.GHOST),) if ghosts else ()))
    return Passage(rung, shining, why=why)


def ghosts_on(scene: Scene, window: Window) -> bool:
    """Whether ghost light is shown: by the scene's list, or when more than `radiance` of the light is ghosts."""
    effects = scene.effects
    if effects.mode == "none":
        return False
    if effects.mode == "list":
        return "ghosts" in effects.list
    if "ghosts" in effects.without:
        return False
    return "ghosts" in effects.force or ghost_share(scene, window) > effects.radiance


def ghost_share(scene: Scene, window: Window) -> float:
    """Mean share of the camera's light on the sheet that leaves its telescopelet (closed form)."""
    from clacad.vignetting import share, thin_cells

    if window.baffle is not None:
        return 0.0
    _, direction = probes(scene, window, 256)
    return 1.0 - float(np.mean(share(thin_cells(window), direction))) if len(direction) else 0.0


def smallest_angle(scene: Scene) -> float:
    """Smallest angle that matters in a scene, radians: as written, or half a pixel."""
    if scene.effects.angle is not None:
        return scene.effects.angle
    view = aim(scene.camera)
    pixel = float(np.linalg.norm(view.right)) / view.width / float(np.linalg.norm(view.ahead))
    return max(FINEST, 0.5 * pixel)


def probes(scene: Scene, window: Window, count: int) -> tuple[Floats, Floats]:
    """Camera rays (n, 3) that cross the sheet's plane inside the sheet's box, window units; at most `count`."""
    view = aim(scene.camera)
    points = np.zeros((1, 8 * count, 4)) + 0.5
    points[0, :, :2] = sobol(8 * count, 2)
    whole = type(view)(view.position, view.ahead, view.right, view.down, 1, 1, 0.0, 1.0)
    position, direction = rays(whole, np.zeros(1, dtype=np.int64), points)
    scale = scene.unit_m / window.unit
    start = position * scale
    with np.errstate(divide="ignore", invalid="ignore"):
        at = start - (start[:, 2:] / direction[:, 2:]) * direction
    x0, x1, y0, y1 = window.lattice.extent()
    inside = (at[:, 0] > x0) & (at[:, 0] < x1) & (at[:, 1] > y0) & (at[:, 1] < y1) & (direction[:, 2] > 0.0)
    return start[inside][:count], direction[inside][:count]


def chosen_rung(scene: Scene, window: Window) -> tuple[Rung, str]:
    """The scene's rung, or with "auto" the cheapest that leaves out less than matters, and why."""
    if scene.sheet.rung != "auto":
        return cast(Rung, scene.sheet.rung), "as asked"
    position, direction = probes(scene, window, PROBES)
    if not len(position):
        return "law", "the camera does not see the sheet"
    truth = trace(window, Rays(position, direction), rung="surfaces", path="numpy")
    angle, radiance = smallest_angle(scene), scene.effects.radiance
    found = ""
    cheap: Sequence[Rung] = ("law", "thin")
    for rung in cheap:
        result = trace(window, Rays(position, direction), rung=rung, path="numpy")
        both = (truth.fate == Fate.ALIVE) & (result.fate == Fate.ALIVE)
        disagree = float(np.mean(truth.fate != result.fate))
        rms = rms_angle(truth.direction[both], result.direction[both])
        found += f"{rung} is off by {1e3 * rms:.2g} mrad, {100 * disagree:.2g} % of fates; "
        if rms <= angle and disagree <= radiance:
            return rung, found + f"{1e3 * angle:.2g} mrad and {100 * radiance:.2g} % are allowed"
    return "surfaces", found + f"{1e3 * angle:.2g} mrad and {100 * radiance:.2g} % are allowed"


def rms_angle(a: Floats, b: Floats) -> float:
    """Root mean square angle between unit directions (n, 3); 0 for none."""
    if not len(a):
        return 0.0
    across = np.cross(a, b)
    return float(np.sqrt(np.mean(np.einsum("ij,ij->i", across, across))))
