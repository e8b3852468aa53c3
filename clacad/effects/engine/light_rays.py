"""Rays that carry radiance to the camera, as one flat list: the common result of all kinds of light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clacad.base.types import Floats, Rows


@dataclass(frozen=True, eq=False)
class LightRays:
    """Rays that carry radiance from the scene to the camera.

    Attributes
    ----------
    parent : (m,) ints
        The launched ray whose picture point receives the light.
    position, direction : (m, 3), sheet frame
        Point where the ray leaves the sheet and its unit direction; d_z < 0 goes back to the camera's side.
    flux : (m,)
        Factor on the radiance at which the ray ends.
    """

    parent: Rows
    position: Floats
    direction: Floats
    flux: Floats

    def __len__(self) -> int:
        return len(self.flux)


def join_light(*lights: LightRays) -> LightRays:
    """Concatenate several lists of light."""
    return LightRays(
        np.concatenate([light.parent for light in lights]),
        np.concatenate([light.position for light in lights]),
        np.concatenate([light.direction for light in lights]),
        np.concatenate([light.flux for light in lights]),
    )
