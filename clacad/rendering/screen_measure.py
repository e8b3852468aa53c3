"""Measurement of the effect of a view on a coordinate screen.

All objects are replaced by one flat screen in z = z_k whose colour is its own x, y. In the rendered picture
the colour at every point of the sheet is then the screen point seen there. A straight-line fit gives the map
X = A + M x₀ of the paper's formulas, stretch = M⁻¹ on the sheet.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.optics.rays import Fate
from clacad.prescription.prescribe import prescribe
from clacad.rendering.camera import aim, rays
from clacad.rendering.picture import view_through
from clacad.rendering.sheet_passage import Passage, geometry_alone
from clacad.scene import EffectsSpec, Scene, SceneObject

WIDE = 4.0e4
"""Side of the screen, scene lengths: wide enough for any view near a pole of the stretch."""

CLIP = 4.0
"""Rays farther from the fit than this many median distances are left out (strays at lens edges)."""


@dataclass(frozen=True, eq=False)
class ScreenMap:
    """A measured map from the sheet to a screen: X = offset + matrix x₀.

    offset : (2,) length. Screen point seen at the middle of the sheet.
    matrix : (2, 2)
    rms : (2,) length. Rms residual of the fitted rays.
    share : Rays fitted over rays on the sheet.
    direct : Rays through corresponding lenslets over rays on the sheet.
    seen : (n, 2) lengths. Screen points that rays through corresponding lenslets meet.
    grain : length². Part of the sheet for each ray.
    z : length. Plane of the screen.
    camera_distance : length
    """

    offset: Floats
    matrix: Floats
    rms: Floats
    share: float
    direct: float
    seen: Floats
    grain: float
    z: float
    camera_distance: float

    def stretch(self) -> Floats:
        """Stretch (2,) along x and y relative to the view without a sheet: (1 + z/D)/M_ii."""
        return np.asarray((1.0 + self.z / self.camera_distance) / np.diag(self.matrix))

    def appears_at(self, x: float, y: float) -> Floats:
        """Point (2,) of the sheet at which the screen point (x, y) is seen."""
        return np.asarray(np.linalg.solve(self.matrix, np.array([x, y]) - self.offset))

    def shown(self, x: float, y: float, radius: float) -> float:
        """Rays that meet the screen within a radius of (x, y), over those of an endless lossless sheet."""
        near = np.hypot(self.seen[:, 0] - x, self.seen[:, 1] - y) < radius
        area = np.pi * radius * radius / abs(float(np.linalg.det(self.matrix)))  # on the sheet
        return float(np.count_nonzero(near) * self.grain / area)


def coordinate_scene(scene: Scene, z: float, pixels: int = 400) -> Scene:
    """The scene with nothing but a coordinate screen in z, one ray a pixel, self-luminous."""
    grey = (0.0, 0.0, 0.0)
    screen = SceneObject(
        id="screen",
        kind="screen",
        at=(0.0, 0.0, z),
        size=(WIDE, WIDE),
        colour=grey,
        colours=(grey, grey),
        pattern="coordinates",
    )
    width, height = scene.camera.pixels
    across = (pixels, max(1, round(pixels * height / width)))
    camera = replace(scene.camera, pixels=across, samples=1, noise=0.0, aperture=0.0)
    light = replace(scene.light, spectrum=550e-9)
    none = EffectsSpec(mode="none", radiance=scene.effects.radiance, order=1)
    black = replace(scene.background, sky=(grey, grey), ground=grey)
    return replace(
        scene, objects=(screen,), camera=camera, light=light, effects=none, background=black, animation=None
    )


def measure(
    scene: Scene, z: float, pixels: int = 400, threads: int | None = None, compiled: bool | None = None
) -> ScreenMap:
    """Fit the map of a still scene's sheet to a screen in z, from the rendered picture.

    z : length. Position behind the sheet.
    pixels : Rays across the picture; best not a multiple of the lens pitch.
    threads, compiled : As in `picture.render`.
    Raises ValueError: Fewer than 16 rays come through the sheet.
    """
    plain = coordinate_scene(scene, z, pixels)
    x0, seen, inside = _on_screen(plain, geometry_alone(plain, direct=True), threads, compiled)
    if len(seen) < 16:
        raise ValueError(f"{len(seen)} rays come through the sheet: too few to fit")
    offset, matrix, rms, kept = fitted(x0, seen)
    distance = float(-scene.camera.position[2])
    grain = float(np.prod(np.ptp(inside, axis=0))) / len(inside)
    return ScreenMap(
        offset, matrix, rms, kept / len(inside), len(seen) / len(inside), seen, grain, z, distance
    )


def ghost_shifts(
    scene: Scene, z: float, pixels: int = 400, threads: int | None = None, compiled: bool | None = None
) -> Floats:
    """Displacement (n, 2) of a ghost's rays on the screen from the direct view's; as `measure`."""
    direct = measure(scene, z, pixels, threads, compiled)
    plain = coordinate_scene(scene, z, pixels)
    ghosts = replace(geometry_alone(plain, direct=True), shining=(int(Fate.GHOST),))
    x0, seen, _ = _on_screen(plain, ghosts, threads, compiled)
    return np.asarray(seen - direct.offset - x0 @ direct.matrix.T)


def _on_screen(
    plain: Scene, passage: Passage, threads: int | None, compiled: bool | None
) -> tuple[Floats, Floats, Floats]:
    """Points of the sheet (n, 2) whose rays meet the screen, their screen points (n, 2), and all points."""
    window = prescribe(plain.design())
    picture = view_through(plain, passage=passage, threads=threads, compiled=compiled)
    x0, inside = sheet_points(plain, window, picture.light.shape[:2])
    light = picture.light.reshape(-1, 3)
    met = inside & (light[:, 2] > 0.5)
    return x0[met], (light[met, :2] - 0.5) * WIDE, x0[inside]


def sheet_points(scene: Scene, window: object, shape: tuple[int, ...]) -> tuple[Floats, NDArray[np.bool_]]:
    """Points (n, 2) where pixels' rays cross z = 0, scene lengths, and whether on array 1's cells."""
    from clacad.sheet.window import Window

    assert isinstance(window, Window)
    view = aim(scene.camera)
    pixels = np.arange(shape[0] * shape[1])
    position, direction = rays(view, pixels, np.full((len(pixels), 1, 4), 0.5))
    at = position - (position[:, 2:] / direction[:, 2:]) * direction
    scale = scene.unit_m / window.unit
    index, _, _ = window.lattice.locate(at[:, 0] * scale, at[:, 1] * scale)
    return at[:, :2], window.lattice.contains(index)


def fitted(x0: Floats, seen: Floats) -> tuple[Floats, Floats, Floats, int]:
    """Least squares, repeated without strays: rays farther off than 4 times the median distance.

    x0, seen : (n, 2) lengths. Points where rays cross the sheet and the screen.

    Returns
    -------
    offset : (2,) lengths, matrix : (2, 2)
        seen ≈ offset + matrix · x0.
    rms : (2,) lengths
    count : int
        Number of rays kept.
    """
    design = np.column_stack([np.ones(len(x0)), x0])
    kept = np.ones(len(x0), dtype=bool)
    for _ in range(10):
        found, *_ = np.linalg.lstsq(design[kept], seen[kept], rcond=None)
        off = seen - design @ found
        distance = np.hypot(off[:, 0], off[:, 1])
        near = distance <= CLIP * np.median(distance) + 1e-9
        if np.array_equal(near, kept):
            break
        kept = near
    rms = np.sqrt(np.mean(off[kept] ** 2, axis=0))
    return np.asarray(found[0]), np.asarray(found[1:].T), rms, int(np.count_nonzero(kept))
