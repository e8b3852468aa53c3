"""The cloak of three sheets: what its scene hides, and the same rays by POV-Ray through the same faces."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from povpictures import needs_povray, povray

from clacad.rendering.picture import view_through
from clacad.scene import Scene, load_scene

FILE = Path(__file__).parents[2] / "designs" / "scenes" / "cloak.toml"


def small(cells: tuple[int, int, int], **changes: object) -> Scene:
    """The cloak with fewer cells a side in each sheet."""
    counts = {f"sheet.{name}.set.lattice.count": [n, n] for name, n in zip("abc", cells)}
    return load_scene(FILE).replace({"camera.samples": 1, **counts, **changes})


def redness(light: np.ndarray) -> np.ndarray:
    """Where the picture is redder than its stripes, which are brown."""
    return light[..., 0] > 4.0 * (light[..., 1] + 1e-3)


@pytest.mark.slow
def test_the_ring_is_seen_without_the_sheets_and_hidden_by_them():
    """Vertices are placed by paraxial rules here, which is quick: the middle of the picture decides."""
    quick = {f"sheet.{name}.set.pair.offset": "paraxial" for name in "abc"}
    scene = small(
        (100, 42, 134), **quick, **{"camera.pixels": [32, 32], "light.ambient": 1.0, "light.key": 0.0}
    )
    bare = redness(view_through(scene, sheet=False).light)
    assert 0.2 < bare.mean() < 0.4  # a ring 15 mm wide in a picture of 80 mm
    cloaked = view_through(scene).light
    assert redness(cloaked).sum() <= 0.02 * bare.sum()
    away = view_through(scene.replace({"object.ring.at.2": -4000.0})).light
    inside = np.zeros(bare.shape, dtype=bool)
    inside[8:24, 8:24] = True
    alike = np.abs(cloaked - away).max(axis=-1) < 1e-6
    assert alike[inside].mean() > 0.98


@needs_povray
@pytest.mark.slow
def test_povray_sees_the_same_rays_through_the_same_faces(tmp_path):
    """The middle cells of every sheet, one ray a pixel; light that a sheet loses in its walls is left out."""
    scene = small((14, 14, 18), **{"camera.pixels": [70, 70], "camera.frame": 5.6})
    found = view_through(scene).light
    off = np.abs(found - povray(scene, tmp_path)).max(axis=-1)
    shines = found.max(axis=-1) > 0.0
    assert shines.mean() > 0.2
    assert (off[shines] <= 3 / 255).mean() >= 0.94
