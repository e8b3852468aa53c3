"""Parameters of the effects: one frozen value, neutral unless a design or a scene sets it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Coating = Literal["none", "quarter-wave"]
Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Setting:
    """Parameters of all effects; each reads its own.

    Parameters
    ----------
    coating : "none" or "quarter-wave"
        On every optical face (fresnel, reflections, polarisation).
    extinction : float or None
        Imaginary part k of the index where the material's is not known (absorption).
    wavelengths : tuple of float, metres
        Lines of the light (dispersion); empty: one line, the design wavelength.
    order : int
        Largest number of reflections in a split path (reflections).
    faces : int
        Largest number of further faces that a followed ray hits (walls, tir_paths).
    roughness : float, length in metres
        Rms height of the optical faces' roughness (scatter).
    slope_rms : float, radians
        Rms slope error of the optical faces (scatter).
    polariser, analyser : float or None, radians
        Angle from the sheet's x axis towards y of the polarisation transmitted for the scene's light, and by
        the camera.
    aperture, focus : float, design lengths
        Diameter of the camera's entrance, distance of the sharp plane along its axis (depth_of_field).
    axis : (3,)
        The camera's viewing direction, sheet frame (depth_of_field, polarisation).
    quads : int
        Facet grid a cell side (facets).
    seed : int
        Of the draws of diffraction, scatter and depth_of_field.
    active : tuple of str
        Names of the effects that are on: followed rays suffer the losses of fresnel and absorption too.
    """

    coating: Coating = "none"
    extinction: float | None = None
    wavelengths: tuple[float, ...] = ()
    order: int = 2
    faces: int = 8
    roughness: float = 0.0
    slope_rms: float = 0.0
    polariser: float | None = None
    analyser: float | None = None
    aperture: float = 0.0
    focus: float = 1.0
    axis: Triple = (0.0, 0.0, 1.0)
    quads: int = 16
    seed: int = 0
    active: tuple[str, ...] = ()
