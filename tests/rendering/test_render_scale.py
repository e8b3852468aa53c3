"""What a picture costs, and that the quick ways to it lead to the same picture."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from viewscenes import ROOT, view_data, view_scene

from clacad.prescription.prescribe import prescribe
from clacad.rendering import view_through
from clacad.rendering.camera import aim, offsets, rays
from clacad.rendering.sheet_passage import geometry_alone
from clacad.rendering.view import radiance, set_up
from clacad.scene import Scene


def crowded(count, pixels=120, rung="surfaces"):
    """A view that fits on 50 by 50 lenslets of a sheet of count by count."""
    scene = view_scene("base", pixels, rung).replace({"camera.frame": 0.2})
    return scene.replace({"sheet.set": {**dict(scene.sheet.set), "lattice.count": [count, count]}})


def bytes_at_most(scene, **options):
    view_through(scene, **options)
    tracemalloc.start()
    view_through(scene, **options)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [False, True])
def test_memory_does_not_grow_with_the_number_of_lenslets(compiled):
    few, many = (bytes_at_most(crowded(n), compiled=compiled, threads=1) for n in (50, 400))
    assert many == pytest.approx(few, rel=0.1)


@pytest.mark.slow
def test_memory_beyond_the_picture_is_that_of_a_tile_however_large_the_picture():
    def spare(pixels):
        scene = crowded(50, pixels)
        picture = pixels * pixels * 4 * 8  # light and error; the samples of all pixels are one number
        return bytes_at_most(scene, compiled=True, threads=1) - picture

    assert spare(1200) < spare(300) + 4e6


@pytest.mark.parametrize("rung", ["surfaces", "law"])
def test_a_sheet_of_1e18_lenslets_is_drawn_as_one_of_2500(rung):
    """Did anything go through the lenslets, this would not end; the rates are in tests/benchmarks/render.md."""
    one, other = (
        view_through(crowded(count, 60, rung), compiled=False, threads=1).light for count in (50, 10**9)
    )
    np.testing.assert_allclose(other, one, atol=1e-9)  # the middle of both is the same


@pytest.mark.ci_cases("False-base", "True-phi_45_theta_0.5_psi_90")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["base", "phi_45_theta_0.5_psi_90"])
@pytest.mark.parametrize("direct", [False, True])
def test_the_kernel_that_does_all_gives_the_light_of_its_parts(name, direct):
    """Pixel by pixel against the general way: camera rays, trace, look, each by itself."""
    scene = view_scene(name, 90).replace({"camera.samples": 3})
    passage = geometry_alone(scene, direct=True) if direct else None
    picture = view_through(scene, compiled=True, passage=passage)
    view = aim(scene.camera)
    pixels = np.arange(90 * 90)
    start, ray = rays(view, pixels, offsets(pixels, 1, 3, 3))
    viewing = set_up(scene, prescribe(scene.design()), False, passage)
    light = radiance(viewing, start, ray).reshape(90, 90, 3, 3).mean(axis=2)
    off = np.abs(picture.light - light).max(axis=-1)
    assert (off > 1e-9).mean() < 1e-3  # edges of tiles, where a last bit decides


@pytest.mark.slow
def test_an_opaque_surround_and_things_before_the_sheet_are_drawn_alike_by_all_ways():
    ball = {"kind": "sphere", "id": "ball", "at": [0.2, 0.1, -3], "size": 0.2, "colour": "#aa3322"}
    data = view_data("phi_45", 80)
    data["sheet"]["surround"] = "opaque"
    data["object"].append(ball)
    scene = Scene.from_dict(data, folder=str(ROOT))
    plain, fast = (view_through(scene, compiled=c).light for c in (False, True))
    assert (np.abs(plain - fast).max(axis=-1) > 1e-9).mean() < 1e-3
    assert not plain[:, :3].any()
    assert plain[30, 57].max() > 0.0
