"""The cloak of three sheets: what its scene hides, and the same rays by POV-Ray through the same faces."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from povpictures import needs_povray, povray
from scene.background import shift_and_blur

import clacad
from clacad.cli import main
from clacad.exporting.pov.pov_scene import SCALE, pov_lines
from clacad.rendering.picture import view_through
from clacad.rendering.sheet_passage import stack_of
from clacad.scene import Scene, load_scene
from clacad.sheet.stack import stacked

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
        (100, 42, 132), **quick, **{"camera.pixels": [32, 32], "light.ambient": 1.0, "light.key": 0.0}
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


@pytest.mark.slow
def test_the_background_is_shifted_by_less_than_half_a_millimetre_and_blurred_by_one():
    share, shift, blur = shift_and_blur(stack_of(load_scene(FILE)))
    assert share == pytest.approx(0.639, abs=0.01)
    assert np.abs(shift).max() <= 0.5
    assert np.sqrt(np.mean(shift**2)) <= 0.2
    assert blur == pytest.approx(1.135, abs=0.03)


def test_solids_of_every_sheet_lie_at_its_place_in_the_scene_for_povray():
    """Every box of a lens encloses it: with the heights of another place, one that is turned over stays empty."""
    window = clacad.prescribe(
        clacad.load(FILE.parents[1] / "tilted-biconvex.toml", ["lattice.count = [3, 3]"])
    )
    stack = stacked([window] * 3, [100.0, 250.0])
    spans = [[SCALE * z for z in one.span] for one in stack.sheets]
    heights = re.findall(r"box \{ <[^>]*, ([^,>]+)>, <[^>]*, ([^,>]+)> \}", "\n".join(pov_lines(stack, None)))
    assert len(heights) >= 2 * 3 * len(window.bodies)
    room = 0.3 * (spans[0][1] - spans[0][0])
    for low, high in ((float(a), float(b)) for a, b in heights):
        assert low < high
        assert any(first - room <= low and high <= last + room for first, last in spans)


@needs_povray
@pytest.mark.slow
@pytest.mark.parametrize("ring", [True, False], ids=["ring", "no ring"])
def test_povray_sees_the_same_rays_through_the_same_faces(ring, tmp_path):
    """The middle cells of every sheet, one ray a pixel; light that a sheet loses in its walls is left out."""
    away = {} if ring else {"object.ring.at.2": -4000.0}
    scene = small((8, 8, 10), **away, **{"camera.pixels": [40, 40], "camera.frame": 3.2})
    found = view_through(scene).light
    off = np.abs(found - povray(scene, tmp_path)).max(axis=-1)
    shines = found.max(axis=-1) > 0.0
    assert shines.mean() > 0.2
    assert (off[shines] <= 3 / 255).mean() >= 0.94


@pytest.mark.parametrize(
    "size",
    [pytest.param(8, marks=pytest.mark.slow), pytest.param(None, marks=pytest.mark.long)],
    ids=["8 cells a side", "full size"],
)
@pytest.mark.parametrize("name", ["a", "b", "c"])
def test_each_sheet_is_a_master(name, size, tmp_path, monkeypatch, capsys):
    """By the commands: STEP is written, read back and judged with the design; the exit status of both is 0."""
    monkeypatch.chdir(tmp_path)
    design = dict(zip("abc", load_scene(FILE).designs(), strict=True))[name]
    if size is not None:
        design = design.replace("lattice.count", [size, size])
    Path("sheet.toml").write_text(design.toml, encoding="utf-8")
    assert main(["export", "sheet.toml", "-o", "made", "--format", "step"]) == 0
    assert main(["verify", "sheet.toml", "--files", "made", "--role", "master"]) == 0
    assert "passed as optical master" in capsys.readouterr().out
