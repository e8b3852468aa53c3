"""What `clacad check` loads and computes: nothing it has no use for, and the same heights by the short way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from trust import running

import clacad
from clacad.sheet.window import lens_height, lens_height_and_normal

DESIGN = Path(__file__).parents[2] / "designs" / "paper-a-covered.toml"


@pytest.mark.slow
def test_check_loads_neither_kernel_nor_effects_nor_network():
    ended = running.clacad("check", DESIGN, "-q")
    assert ended.status in (0, 1)
    assert not (running.HEAVY | {"pydantic"}) & ended.packages
    assert not {"clacad.effects", "clacad.rendering", "http.client", "ssl", "xml.sax"} & ended.modules


@pytest.mark.parametrize("name", ["paper-base", "galilean", "slab", "plano", "hexagonal", "tilted"])
def test_the_short_way_to_a_height_is_the_ray_bit_by_bit(name):
    window = clacad.prescribe(clacad.load(DESIGN.with_name(f"{name}.toml")))
    generator = np.random.default_rng(1)
    for face in (face for face in window.faces if face.array is not None):
        for reach in (0.5, 2.0, 20.0):  # within the cell, past the rim, past the equator
            x, y = generator.uniform(-reach, reach, (2, 500)) * window.lattice.circumradius
            height, _ = lens_height_and_normal(face, x, y)
            np.testing.assert_array_equal(lens_height(face, x, y), height)
