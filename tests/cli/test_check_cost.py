"""What `clacad check` loads and computes: nothing it has no use for, and the same heights by the short way."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.sheet.window import lens_height, lens_height_and_normal

DESIGN = Path(__file__).parents[2] / "designs" / "paper-a-covered.toml"


def test_check_loads_neither_kernel_nor_effects_nor_network():
    code = (
        "import sys, json; from clacad.cli.entry_point import main; "
        f"status = main(['check', {str(DESIGN)!r}, '-q']); "
        "print(json.dumps([status, sorted(sys.modules)]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True
    )
    status, loaded = json.loads(done.stdout.splitlines()[-1])
    assert status in (0, 1)
    heavy = {
        "OCP",
        "build123d",
        "numba",
        "scipy",
        "matplotlib",
        "trimesh",
        "manifold3d",
        "embreex",
        "PIL",
        "pydantic",
    }
    assert not heavy & set(loaded)
    assert not {
        "clacad.effects",
        "clacad.rendering",
        "http.client",
        "ssl",
        "xml.sax",
    } & set(loaded)


@pytest.mark.parametrize("name", ["paper-base", "galilean", "slab", "plano", "hexagonal", "tilted"])
def test_the_short_way_to_a_height_is_the_ray_bit_by_bit(name):
    window = clacad.prescribe(clacad.load(DESIGN.with_name(f"{name}.toml")))
    generator = np.random.default_rng(1)
    for face in (face for face in window.faces if face.array is not None):
        for reach in (0.5, 2.0, 20.0):  # within the cell, past the rim, past the equator
            x, y = generator.uniform(-reach, reach, (2, 500)) * window.lattice.circumradius
            height, _ = lens_height_and_normal(face, x, y)
            np.testing.assert_array_equal(lens_height(face, x, y), height)
