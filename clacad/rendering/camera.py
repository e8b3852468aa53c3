"""Camera rays: the directions of a pixel's samples, the same on every machine, and their wavelengths.

Samples of a pixel are the first points of one Sobol sequence, shifted digit by digit with a hash of the
pixel's number (random digital shift). The points stay a net, and neighbouring pixels have different patterns,
so a pixel grid that divides the lens pitch does not alias the aperture. A single sample is in the middle of
its pixel.

Objects have linear sRGB colours. Behind a dispersing sheet their light is needed line by line. A spectrum is
built from the three numbers with three bands that sum to 1, such that without dispersion it gives exactly
these three numbers again. Colour matching: CIE 1931, fits of Wyman, Sloan & Shirley, J. Computer Graphics
Techniques 2(2) (2013); daylight D65, CIE 15, its table at 10 nm over the range used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.hashing import GOLDEN, mixed
from clacad.base.sobol import sobol
from clacad.base.vectors import picture_axes

if TYPE_CHECKING:
    from clacad.base.types import Floats, Ints
    from clacad.rendering.scene_arrays import SceneArrays
    from clacad.rendering.sheet_passage import Passage
    from clacad.scene import Camera, Light
    from clacad.scene.sections import Rgb
    from clacad.sheet.window import Window

_D65_NM = tuple(range(430, 660, 10))
_D65 = tuple(
    float(power)
    for power in (
        "86.68 104.86 117.01 117.81 114.86 115.92 108.81 109.35 107.80 104.79 107.69 104.41 "
        "104.05 100.00 96.33 95.79 88.69 90.01 89.60 87.70 83.29 83.70 80.03"
    ).split()
)
_XYZ_TO_RGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
"""IEC 61966-2-1."""


@dataclass(frozen=True, eq=False)
class SpectralLine:
    """One wavelength.

    wavelength : float or None, metres. None is the design wavelength.
    basis : (3,). Radiance at this line of light whose colour is (r, g, b): basis · colour.
    weight : (3,). Linear rgb of the picture for one unit of that radiance.
    whole : Whether this one line carries the whole picture: colours pass unchanged.
    """

    wavelength: float | None
    basis: Floats
    weight: Floats
    whole: bool = False


def lines(light: Light, window: Window, dispersion: bool) -> tuple[SpectralLine, ...]:
    """Lines of a scene's light.

    window : Window whose materials distinguish wavelengths.
    dispersion : Whether the lines are traced separately; else one represents all.
    """
    tells = any(body.material is not None for body in window.bodies)
    spectrum, one = light.lines, np.ones(3)
    if len(spectrum) == 1:
        return (SpectralLine(next(iter(spectrum)) if tells else None, one, one, whole=True),)
    if not (dispersion and tells):
        return (SpectralLine(None, one, one, whole=True),)
    if light.spectrum == "rgb":
        return tuple(SpectralLine(wave, unit, unit) for wave, unit in zip(spectrum, np.eye(3), strict=True))
    return _daylight(spectrum)


def _daylight(spectrum: Mapping[float, float]) -> tuple[SpectralLine, ...]:
    """Lines (metres → weight) as samples of daylight D65.

    Lines that lack red, green or blue light show white in their own colour.
    """
    waves, bright = 1e9 * np.array(list(spectrum)), np.array(list(spectrum.values()))
    weights = (_matching(waves) * (bright * np.interp(waves, _D65_NM, _D65))[:, None]) @ _XYZ_TO_RGB.T
    blue, red = np.clip((510.0 - waves) / 40.0, 0.0, 1.0), np.clip((waves - 570.0) / 30.0, 0.0, 1.0)
    bands = np.column_stack([red, 1.0 - red - blue, blue])
    if np.abs(weights).max() < UNSEEN:
        weights = np.outer(bright, np.ones(3))
    white = weights.sum(axis=0)
    if np.all(white) and np.linalg.cond((weights / white).T @ bands) < SEPARATE:
        weights /= white  # equal radiance at every line is white
        basis = bands @ np.linalg.inv(weights.T @ bands)  # exact colours; rows still sum to 1
    else:
        weights = np.maximum(weights, 0.0)
        weights, basis = weights / weights.sum(axis=0).max(), bands
    return tuple(SpectralLine(wave, b, w) for wave, b, w in zip(spectrum, basis, weights, strict=True))


SEPARATE = 100.0
"""Condition of the three colours in some lines up to which they are distinguished."""

UNSEEN = 1e-6
"""Response of the eye below which lines are shown grey; that of visible lines is of order 100."""


def _matching(nm: Floats) -> Floats:
    """Colour matching functions x̄, ȳ, z̄ of the CIE 1931 observer, (n, 3)."""
    x = (
        _lobe(nm, 1.056, 599.8, 37.9, 31.0)
        + _lobe(nm, 0.362, 442.0, 16.0, 26.7)
        + _lobe(nm, -0.065, 501.1, 20.4, 26.2)
    )
    y = _lobe(nm, 0.821, 568.8, 46.9, 40.5) + _lobe(nm, 0.286, 530.9, 16.3, 31.1)
    z = _lobe(nm, 1.217, 437.0, 11.8, 36.0) + _lobe(nm, 0.681, 459.0, 26.0, 13.8)
    return np.column_stack([x, y, z])


def _lobe(nm: Floats, height: float, middle: float, below: float, above: float) -> Floats:
    """A Gaussian with one width on each side."""
    width = np.where(nm < middle, below, above)
    return np.asarray(height * np.exp(-0.5 * ((nm - middle) / width) ** 2))


_BITS = 52


@dataclass(frozen=True, eq=False)
class View:
    """A camera ready to use, in the scene's unit.

    position : (3,) length
    ahead : (3,) length. From the camera to the middle of the plane it draws on.
    right, down : (3,) lengths. Across the whole picture in that plane.
    width, height : pixels
    aperture : length. Diameter of the opening.
    focus : Distance of the sharp plane in lengths of `ahead`.
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

    pixels : (n,) ints. Numbers of the pixels, row by row.
    first, count : Number of the first sample of the sequence, and how many.
    whole : Total samples of a pixel; 1 is the middle of the pixel and of the opening.
    Returns (n, count, 4) array.
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

    pixels : (n,) ints
    points : (n, count, 4). From `offsets`.
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

    passage : How rays pass the sheet: rung, effects, which fates shine.
    lines : Wavelengths to trace and the contribution of each to the picture.
    scale : Window lengths in one scene length.
    box : (2, 3) lengths, scene frame. Around the sheet, with room to spare: rays that miss it miss the sheet.
    front : length. Scene z up to which objects are before the sheet.
    opaque : Whether nothing is visible outside the sheet.
    present : Whether there is a sheet at all.
    before : Whether an object may be between camera and sheet.
    compiled : Compiled code or numpy.
    tables : Tables. The stage for compiled code.
    tint : (red, green, blue). Linear transmission of what is seen through the sheet.
    pane : Pane or None. The sheet for the single kernel `compiled.pixels.sample_all`, where that supports it.
    between : Whether an object reaches between several sheets.
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
    between: bool = False
