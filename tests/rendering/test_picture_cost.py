"""The forecast of a picture is the time of its pixels, times their number, regardless of the overhead of a block of them."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from clacad.prescription.prescribe import prescribe
from clacad.rendering import picture_cost
from clacad.rendering.camera import aim
from clacad.rendering.picture import view_through, worth_compiling
from clacad.rendering.picture_cost import picture_seconds
from clacad.rendering.sheet_passage import plan_passage
from clacad.scene import Scene, load_scene

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
    least, each = picture_cost._seconds_a_pixel(None, view, 4)
    assert least <= each
    far = pixel * len(clock.seen) < 0.3 * block  # of blocks alone not even all pixels can show the time
    assert each > pixel if far else each >= pixel * (1.0 - 1e-6)
    assert far or least <= pixel * (1.0 + 1e-6)
    together = pixel + block / (65536 // 4)  # of a block as large as blocks are
    assert far or each <= 1.5 * together
    assert len(clock.seen) < 0.6 * view.width * view.height


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "pixels", "samples"),
    [("fig1b", 40, 4), ("fig3-z-8", 160, 4), ("effects-wide", 80, 4), ("fig6-theta-1", 200, 4)],
)
def test_the_range_that_is_forecast_holds_what_a_picture_takes(name, pixels, samples):
    scene = load_scene(SCENES / f"{name}.toml").replace(
        {"camera.pixels": [pixels, pixels], "camera.samples": samples}
    )
    assert not worth_compiling(scene)  # what is compiled here or not must not count
    passage = plan_passage(scene, prescribe(scene.design()))
    for _ in range(3):  # processor seconds, too, grow by up to a half with busy neighbours
        span = picture_seconds(scene, passage)
        began = time.process_time()
        view_through(scene, passage=passage, threads=1)
        took = time.process_time() - began
        if span.low <= took <= span.high < 6.0 * span.low:
            return
    raise AssertionError(f"forecast {span}, took {took:.2f} s, at the last of three attempts")
