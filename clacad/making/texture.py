"""Texture that a process leaves: rms heights of scallops, levels and layers, and the light they disturb.

Rays would take the slopes of a texture for errors of direction. A wave much longer than the texture is high
leaves it undisturbed but for a share (`measuring.light_through_form.texture_share`): texture is never traced.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, pi, sqrt

from clacad.design.process import Process


@dataclass(frozen=True, slots=True)
class Scallop:
    """Ridges between neighbouring passes of a ball nose, metres.

    height : Peak to valley of the exact circles.
    rms : Of the parabola that touches them.
    """

    height: float
    rms: float


def scallop(feed: float, nose: float) -> Scallop:
    """Return the height and rms of scallops.

    Parameters
    ----------
    feed : float, metres
    nose : float, metres
        0: there is no tool and no scallop.

    Examples
    --------
    >>> from clacad.making.texture import scallop
    >>> f"{scallop(8e-6, 200e-6).rms * 1e9:.3f} nm"
    '11.926 nm'
    """
    if feed == 0.0 or nose == 0.0:
        return Scallop(0.0, 0.0)
    if feed >= 2.0 * nose:
        return Scallop(inf, inf)
    half = 0.5 * feed
    height = half * half / (nose + sqrt(nose * nose - half * half))
    return Scallop(height, feed * feed / (8.0 * nose) * 2.0 / sqrt(45.0))


def step_rms(step: float) -> float:
    """Return the rms height that rounding to steps leaves: step/√12, both in metres.

    Examples
    --------
    >>> from clacad.making.texture import step_rms
    >>> f"{step_rms(100e-9) * 1e9:.2f} nm"
    '28.87 nm'
    """
    return step / sqrt(12.0)


def level_step(process: Process, sag: float) -> float:
    """Return the height of a level (metres) of a face of height `sag`; 0 where there are none.

    Examples
    --------
    >>> from clacad.design.process import Process
    >>> from clacad.making.texture import level_step
    >>> f"{level_step(Process('greyscale', levels=256), 25.5e-6) * 1e9:.0f} nm"
    '100 nm'
    """
    return sag / (process.levels - 1) if process.levels > 1 else 0.0


def texture_of(process: Process, sag: float) -> float:
    """Return the rms height (metres) of all texture a process leaves on one face.

    Parameters
    ----------
    process : Process
    sag : float, metres
        Height of the face, which the levels divide.

    Examples
    --------
    >>> from clacad.design.process import Process
    >>> from clacad.making.texture import texture_of
    >>> f"{texture_of(Process('greyscale', levels=256), 25.5e-6) * 1e9:.1f} nm"
    '28.9 nm'
    """
    steps = process.layer, level_step(process, sag)
    parts = (scallop(process.feed, process.nose).rms, *map(step_rms, steps))
    return sqrt(sum(one * one for one in parts))


def texture_phase(texture: float, index: float, wavelength: float) -> float:
    """Return the rms phase (radians) of a texture in transmission.

    Parameters
    ----------
    texture : float, metres, rms
    index : float
        Refractive index of the material, in air.
    wavelength : float, metres

    Examples
    --------
    >>> from clacad.making.texture import texture_phase
    >>> f"{texture_phase(10e-9, 1.5, 500e-9):.4f}"
    '0.0628'
    """
    return 2.0 * pi * (index - 1.0) * texture / wavelength
