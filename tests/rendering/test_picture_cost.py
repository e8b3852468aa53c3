"""The forecast of a picture is what its pixels take, times how many there are, whatever a block of them takes besides."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clacad.rendering import picture_cost
from clacad.rendering.camera import aim
from clacad.scene import Scene

SCENES = Path(__file__).parents[2] / "designs" / "scenes"
SCENE = {
    "format": 1, "name": "cost", "unit": "m",
    "sheet": {"design": "../slab.toml"},
    "camera": {"position": [0.0, 0.0, -1.0], "target": [0, 0, 0], "frame": 0.05, "pixels": [300, 200], "samples": 4},
}  # fmt: skip


class Pixels:
    """Pixels that take seconds by a law, on a clock of their own."""

    def __init__(self, block: float, pixel: float) -> None:
        self.block, self.pixel, self.now = block, pixel, 0.0
        self.seen: set[int] = set()

    def tried(self, viewing, view, pixels, samples):
        assert samples == 4
        assert len(np.unique(pixels)) == len(pixels)
        assert pixels.min() >= 0
        assert pixels.max() < view.width * view.height
        self.seen |= set(pixels.tolist())
        self.now += self.block + self.pixel * len(pixels)

    def thread_time(self):
        return self.now


@pytest.mark.parametrize(("block", "pixel"), [(0.0, 1e-3), (0.05, 1e-4), (0.3, 1e-5), (0.001, 1e-6)])
def test_a_picture_is_forecast_from_its_own_pixels(block, pixel, monkeypatch):
    clock = Pixels(block, pixel)
    monkeypatch.setattr(picture_cost, "tried", clock.tried)
    monkeypatch.setattr(picture_cost, "time", clock)
    view = aim(Scene.from_dict(SCENE, folder=SCENES).camera)
    each = picture_cost._seconds_a_pixel(None, view, 4)
    far = pixel * len(clock.seen) < 0.3 * block  # of blocks alone not even all pixels can tell
    assert each == pytest.approx(pixel, rel=1e-6) or (far and each > pixel)
    assert len(clock.seen) < 0.6 * view.width * view.height
