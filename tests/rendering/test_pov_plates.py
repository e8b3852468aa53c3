"""Listed plates as POV-Ray finds them: joints of flat and curved faces, seams, borders, gaps."""

from __future__ import annotations

import numpy as np
import pytest
from povpictures import before_stripes, needs_povray, povray

import clacad
from clacad.rendering import view_through
from clacad.rendering.screen_measure import sheet_points
from clacad.scene import Scene

CASES = {
    "flat-joints": {},
    "curved-joints": {},
    "two-plates": {},
    "three-plates": {},
    "curved joints with land": {"lattice.seam": 0.06, "body.border": 0.5},
    "aimed": {"lattice.aperture": {"point": [3, -2, -300]}},
}
FILE = {"curved joints with land": "curved-joints", "aimed": "flat-joints"}


def scene_of(case: str) -> Scene:
    return before_stripes(
        "plates",
        {
            "design": f"tests/data/plates/{FILE.get(case, case)}.toml",
            "set": {"lattice.count": [10, 10], **CASES[case]},
        },
        {
            "position": CASES[case].get("lattice.aperture", {"point": [0, 0, -300]})["point"],
            "frame": 7.1,
            "pixels": [120, 120],
        },
    )


@pytest.mark.ci_cases("curved-joints", "three-plates", "aimed")
@pytest.mark.slow
@needs_povray
@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[] if "curved" in case else [pytest.mark.slow]) for case in CASES]
)
def test_plates_show_the_rays_that_povray_finds(case, tmp_path):
    scene = scene_of(case)
    off = np.abs(view_through(scene).light - povray(scene, tmp_path)).max(axis=-1)
    at, inside = sheet_points(scene, clacad.prescribe(scene.design()), off.shape)
    # rays of the outermost cells that end in the outer wall are black here and followed on there
    inner = inside & (np.abs(at).max(axis=1) < 0.8 * np.abs(at[inside]).max())
    # a row of pixels may look along a border of cells, where POV-Ray has a gap
    assert (off.ravel()[inner] <= 3 / 255).mean() > 0.985
    assert inner.sum() > 2000
