"""A mesh file as an object of a scene: y up, on the origin, scaled to the specified height."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.formats.mesh.readers import read_mesh

if TYPE_CHECKING:
    from clacad.scene import Scene, SceneObject


def standing_corners(scene: Scene, thing: SceneObject) -> Floats:
    """Corners (t, 3, 3) of a mesh object in its own frame, scene lengths.

    Raises
    ------
    SceneError
        The file is missing or outside the scene's folders.
    UnreadableFile
        It is no mesh, or damaged.
    """
    assert thing.file is not None  # the scene's rules require it
    corners = np.concatenate([np.zeros((0, 3, 3)), *read_mesh(scene.file(thing.file)).chunks()])
    if thing.up == "z":  # x stays, the file's y points away from the viewer
        corners = np.stack([corners[..., 0], corners[..., 2], -corners[..., 1]], axis=-1)
    if not len(corners):
        return corners
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    foot = np.array([0.5 * (low[0] + high[0]), low[1], 0.5 * (low[2] + high[2])])
    tall = high[1] - low[1]
    return np.asarray((corners - foot) * (thing.size[0] / tall if tall > 0.0 else 1.0))
