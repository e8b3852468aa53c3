"""Camera rays: the directions of a pixel's samples, the same on every machine.

Samples of a pixel are the first points of one Sobol sequence, shifted digit by digit with a hash of the
pixel's number (random digital shift). The points stay a net, and neighbouring pixels have different patterns,
so a pixel grid that divides the lens pitch does not alias the aperture. A single sample is in the middle of
its pixel.

Input of a block of camera rays: the stage, the sheet and how light passes it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.hashing import GOLDEN, mixed
from clacad.base.sobol import sobol
from clacad.base.types import Floats, Ints
from clacad.base.vectors import picture_axes
from clacad.rendering.scene_arrays import SceneArrays
from clacad.rendering.sheet_passage import Passage
from clacad.rendering.spectrum import SpectralLine
from clacad.scene import Camera
from clacad.scene.kinds import Rgb
from clacad.sheet.window import Window

_BITS = 52


@dataclass(frozen=True, eq=False)
class View:
    """A camera ready to use, in the scene's unit.

    Attributes
    ----------
    position : (3,) length
    ahead : (3,) length
        From the camera to the middle of the plane it draws on.
    right, down : (3,) lengths
        Across the whole picture in that plane.
    width, height : int, pixels
    aperture : float, length
        Diameter of the opening.
    focus : float
        Distance of the sharp plane in lengths of `ahead`.
    """

    position: Floats
    ahead: Floats
    right: Floats
    down: Floats
    width: int
    height: int
    aperture: float
    focus: float


def aim(camera: Camera) -> View:
    """Prepare a camera: right = look × up, or its opposite in a mirrored view."""
    position, target = np.array(camera.position), np.array(camera.target)
    look = target - position
    distance, right, up = picture_axes(position, target, np.array(camera.up))
    if camera.mirror:
        right = -right
    across = camera.width_at(distance)
    width, height = camera.pixels
    focus = 1.0 if camera.focus is None else camera.focus / distance
    return View(
        position, look, across * right, -across * height / width * up, width, height, camera.aperture, focus
    )


def offsets(pixels: Ints, first: int, count: int, whole: int) -> Floats:
    """Sample points of pixels: position in the pixel and on the opening, each 0 … 1.

    Parameters
    ----------
    pixels : (n,) ints
        Numbers of the pixels, row by row.
    first, count : int
        Number of the first sample of the sequence, and how many.
    whole : int
        Total samples of a pixel; 1 is the middle of the pixel and of the opening.

    Returns
    -------
    (n, count, 4) array
    """
    if whole == 1:
        return np.full((len(pixels), count, 4), 0.5)
    points = digits(first, count)
    shift = np.stack([_hash(pixels, k) for k in range(4)], axis=-1) >> np.uint64(64 - _BITS)
    return np.asarray((points[None] ^ shift[:, None]) * 2.0**-_BITS, dtype=np.float64)


def digits(first: int, count: int) -> NDArray[np.uint64]:
    """Points (count, 4) of the sequence from number `first` on, as 52 binary digits each."""
    return np.rint(sobol(count, 4, skip=first) * 2.0**_BITS).astype(np.uint64)


def _hash(number: Ints, salt: int) -> NDArray[np.uint64]:
    """Well-mixed 64 bits of a number."""
    return mixed((number.astype(np.uint64) * np.uint64(4) + np.uint64(salt + 1)) * np.uint64(GOLDEN))


def rays(view: View, pixels: Ints, points: Floats) -> tuple[Floats, Floats]:
    """Starts and directions (n · count, 3) of the samples of some pixels, scene frame; not unit vectors.

    Parameters
    ----------
    pixels : (n,) ints
    points : (n, count, 4)
        From `offsets`.
    """
    u = ((pixels % view.width)[:, None] + points[..., 0]) * (1.0 / view.width) - 0.5
    v = ((pixels // view.width)[:, None] + points[..., 1]) * (1.0 / view.height) - 0.5
    direction = view.ahead + u[..., None] * view.right + v[..., None] * view.down
    direction = direction.reshape(-1, 3)
    position = np.broadcast_to(view.position, direction.shape)
    if view.aperture > 0.0:
        shift = _on_disc(points[..., 2:]).reshape(-1, 2) * (0.5 * view.aperture)
        right, down = (a / np.linalg.norm(a) for a in (view.right, view.down))
        start = shift[:, :1] * right + shift[:, 1:] * down
        return position + start, direction * view.focus - start
    return position, direction


def _on_disc(square: Floats) -> Floats:
    """Map points of the unit square to the unit disc, areas kept.

    Shirley & Chiu, J. Graphics Tools 2, 45 (1997).
    """
    a, b = 2.0 * square[..., 0] - 1.0, 2.0 * square[..., 1] - 1.0
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.where(wide, 0.25 * np.pi * (b / a), 0.5 * np.pi - 0.25 * np.pi * (a / b))
    angle = np.where(radius == 0.0, 0.0, angle)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)


@dataclass(frozen=True, eq=False)
class Viewing:
    """All data that a block of camera rays needs.

    Attributes
    ----------
    stage : SceneArrays
    window : Window
    passage : Passage
        How rays pass the sheet: rung, effects, which fates shine.
    lines : tuple of SpectralLine
        Wavelengths to trace and the contribution of each to the picture.
    scale : float
        Window lengths in one scene length.
    box : (2, 3) lengths, scene frame
        Around the sheet, with room to spare: rays that miss it miss the sheet.
    front : float, length
        Scene z up to which objects are before the sheet.
    opaque : bool
        Whether nothing is visible outside the sheet.
    present : bool
        Whether there is a sheet at all.
    before : bool
        Whether an object may be between camera and sheet.
    compiled : bool
        Compiled code or numpy.
    tables : Tables
        The stage for compiled code.
    tint : (red, green, blue)
        Linear transmission of what is seen through the sheet.
    pane : Pane or None
        The sheet for the single kernel `compiled.pixels.sample_all`, where that supports it.
    """

    stage: SceneArrays
    window: Window
    passage: Passage
    lines: tuple[SpectralLine, ...]
    scale: float
    box: Floats
    front: float
    opaque: bool
    present: bool
    before: bool
    compiled: bool
    tables: Any
    tint: Rgb
    pane: Any = None
