"""Traced wavelengths, and the contribution of each to the picture.

Objects have linear sRGB colours. Behind a dispersing sheet their light is needed line by line. A spectrum is
built from the three numbers with three bands that sum to 1, such that without dispersion it gives exactly
these three numbers again. Colour matching: CIE 1931, fits of Wyman, Sloan & Shirley, J. Computer Graphics
Techniques 2(2) (2013); daylight D65, CIE 15, its table at 10 nm over the range used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clacad.base.types import Floats
from clacad.scene import Light
from clacad.sheet.window import Window

RGB_LINES = (611.4e-9, 549.1e-9, 464.2e-9)
"""Dominant wavelengths of the sRGB primaries (ITU-R BT.709) under D65, metres."""

DAYLIGHT_NM = tuple(440.0 + 26.25 * k for k in range(9))
"""Nine samples of daylight, nm: nearly all of the eye's response, and within the data of almost every
material of the table.
"""

_D65_NM = tuple(range(430, 660, 10))
_D65 = (
    86.68,
    104.86,
    117.01,
    117.81,
    114.86,
    115.92,
    108.81,
    109.35,
    107.80,
    104.79,
    107.69,
    104.41,
    104.05,
    100.00,
    96.33,
    95.79,
    88.69,
    90.01,
    89.60,
    87.70,
    83.29,
    83.70,
    80.03,
)
_XYZ_TO_RGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
"""IEC 61966-2-1."""


@dataclass(frozen=True, eq=False)
class SpectralLine:
    """One wavelength.

    Attributes
    ----------
    wavelength : float or None, metres
        None is the design wavelength.
    basis : (3,)
        Radiance at this line of light whose colour is (r, g, b): basis · colour.
    weight : (3,)
        Linear rgb of the picture for one unit of that radiance.
    whole : bool
        Whether this one line carries the whole picture: colours pass unchanged.
    """

    wavelength: float | None
    basis: Floats
    weight: Floats
    whole: bool = False


def lines(light: Light, window: Window, dispersion: bool) -> tuple[SpectralLine, ...]:
    """Lines of a scene's light.

    Parameters
    ----------
    light : Light
    window : Window
        Window whose materials distinguish wavelengths.
    dispersion : bool
        Whether the lines are traced separately; else one represents all.
    """
    tells = any(body.material is not None for body in window.bodies)
    if isinstance(light.spectrum, float):
        return (SpectralLine(light.spectrum if tells else None, np.ones(3), np.ones(3), whole=True),)
    if not (dispersion and tells):
        return (SpectralLine(None, np.ones(3), np.ones(3), whole=True),)
    if light.spectrum == "rgb":
        return tuple(SpectralLine(wave, unit, unit) for wave, unit in zip(RGB_LINES, np.eye(3), strict=True))
    return _daylight()


def _daylight() -> tuple[SpectralLine, ...]:
    waves = np.array(DAYLIGHT_NM)
    weights = (_matching(waves) * np.interp(waves, _D65_NM, _D65)[:, None]) @ _XYZ_TO_RGB.T
    weights /= weights.sum(axis=0)  # equal radiance at every line is white
    blue, red = np.clip((510.0 - waves) / 40.0, 0.0, 1.0), np.clip((waves - 570.0) / 30.0, 0.0, 1.0)
    bands = np.column_stack([red, 1.0 - red - blue, blue])
    basis = bands @ np.linalg.inv(weights.T @ bands)  # colours are reproduced exactly; rows still sum to 1
    return tuple(SpectralLine(1e-9 * wave, b, w) for wave, b, w in zip(waves, basis, weights, strict=True))


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
