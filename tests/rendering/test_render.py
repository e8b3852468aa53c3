"""Pictures: rays hit the objects of the scene, through the sheet and past it, the same on every path and machine."""

from __future__ import annotations

import copy
import json
import math
import signal
import subprocess
import sys
import time
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from viewscenes import CASES, ROOT, VIEWS, view_data, view_scene

from clacad.design import template
from clacad.design.sections import LineSpec
from clacad.optics.rays import Fate
from clacad.rendering import view_through
from clacad.rendering.camera import aim, offsets, rays
from clacad.rendering.compiled.scene_hits import look_all
from clacad.rendering.photographs import decode, read_picture
from clacad.rendering.picture import render, render_movie
from clacad.rendering.picture_files import (
    UnknownPicture,
    encode,
    labelled,
    metadata_of,
    write_movie,
    write_picture,
)
from clacad.rendering.scene_arrays import set_stage, tables
from clacad.rendering.scene_hits import look, nearest
from clacad.rendering.screen_measure import measure
from clacad.rendering.sheet_passage import geometry_alone
from clacad.scene import Scene, SceneError, load_scene
from clacad.scene.chess_knight import turned
from clacad.tracing.facets.hierarchy import mesh_tree, nearest_triangle

PLAIN = {
    "format": 1,
    "name": "plain",
    "unit": "m",
    "sheet": {"design": "designs/paper-base.toml", "rung": "surfaces"},
    "camera": {"position": [0, 0, -20], "frame": 1.1, "pixels": [64, 48], "samples": 1},
    "light": {"ambient": 1.0, "key": 0.0},
    "effects": {"mode": "none"},
}


def scene(*objects, **changes) -> Scene:
    data = copy.deepcopy(PLAIN) | {"object": list(objects)}
    for key, value in changes.items():
        data[key] = {**data.get(key, {}), **value}
    return Scene.from_dict(data, folder=str(ROOT))


def random_rays(n=4000, seed=1):
    """Rays from a sphere of radius 5 through a ball of radius 1.2 about the origin."""
    rng = np.random.default_rng(seed)
    start = rng.normal(size=(n, 3))
    start *= 5.0 / np.linalg.norm(start, axis=1, keepdims=True)
    aimed = rng.normal(size=(n, 3)) * 0.5
    return start, (aimed - start) * rng.uniform(0.1, 3.0, (n, 1))


# -- what rays meet ----------------------------------------------------------------------------


def marched(inside, start, direction, steps=4000):
    """First distance at which a ray is inside a solid, by walking: knows nothing of roots."""
    t = np.linspace(0.0, 12.0, steps) / np.linalg.norm(direction)
    found = inside(start + t[:, None] * direction)
    return (t[np.argmax(found)] if found.any() else np.inf), t[1]


SOLIDS = {
    "sphere": ({"size": 1.4}, lambda p: (p**2).sum(1) <= 0.49),
    "box": ({"size": [1.0, 0.6, 1.6]}, lambda p: (np.abs(p) <= [0.5, 0.3, 0.8]).all(1)),
    "cone": (
        {"size": [1.2, 0.4, 1.0]},
        lambda p: (p[:, 1] >= 0) & (p[:, 1] <= 1) & (np.hypot(p[:, 0], p[:, 2]) <= 0.6 - 0.4 * p[:, 1]),
    ),
}


@pytest.mark.parametrize("kind", SOLIDS)
def test_a_solid_is_met_where_walking_along_the_ray_enters_it(kind):
    keys, inside = SOLIDS[kind]
    turn, at = (20.0, 35.0, -50.0), np.array([0.1, -0.2, 0.3])
    stage = set_stage(scene({"kind": kind, "at": list(at), "turn": list(turn), **keys}))
    start, direction = random_rays(300)
    distance, which, _ = nearest(stage, start, direction, np.inf)
    back = turned(turn)
    for i in range(len(start)):
        walked, step = marched(inside, (start[i] - at) @ back, direction[i] @ back)
        if np.isfinite(walked) and np.isfinite(distance[i]):
            assert walked - 1.01 * step <= distance[i] <= walked + 1e-9
        else:  # walking may miss what a ray only grazes; it never invents a hit
            assert which[i] >= 0 or not np.isfinite(walked)


def test_a_turn_is_about_fixed_x_then_y_then_z():
    np.testing.assert_array_equal(turned((90.0, 0.0, 0.0)) @ [0, 1, 0], [0, 0, 1])
    np.testing.assert_array_equal(turned((90.0, 90.0, 0.0)) @ [0, 1, 0], [1, 0, 0])
    np.testing.assert_array_equal(turned((0.0, 0.0, 90.0)) @ [1, 0, 0], [0, 1, 0])
    np.testing.assert_allclose(turned((10, 20, 30)) @ turned((10, 20, 30)).T, np.eye(3), atol=1e-15)


def test_a_tree_finds_the_triangle_that_trying_all_finds():
    rng = np.random.default_rng(3)
    corners = rng.normal(size=(500, 1, 3)) + 0.15 * rng.normal(size=(500, 3, 3))
    tree = mesh_tree(corners)
    start, direction = random_rays(400)
    distance, which = nearest_triangle(tree, 0, start, direction, np.full(400, np.inf))
    for i in range(len(start)):
        e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        matrix = np.stack([e1, e2, np.broadcast_to(-direction[i], e1.shape)], axis=-1)
        u, v, t = np.linalg.solve(matrix, (start[i] - corners[:, 0])[..., None])[..., 0].T
        t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
        assert distance[i] == pytest.approx(t.min(), rel=1e-9)
    assert (which >= 0).sum() > 50


@pytest.mark.slow
def test_compiled_and_plain_code_see_the_same():
    things = [
        {"kind": "checker", "height": -0.7, "tile": 0.3},
        {"kind": "knight", "at": [0.3, -0.5, 0.2], "size": 1.1, "turn": [0, 40, 0], "colour": "#aa8844"},
        {"kind": "screen", "at": [-0.5, 0.2, 0.9], "size": [0.8, 0.6], "pattern": "stripes", "period": 0.1, "turn": [5, 9, 3]},
        {"kind": "screen", "at": [0.5, 0.4, 0.9], "size": [0.6, 0.6], "pattern": "image", "file": "tests/data/views/base.png"},
        {"kind": "mesh", "at": [-0.3, -0.6, -0.4], "size": 0.7, "file": "tests/data/tetra.obj"},
        *[{"kind": kind, "id": kind, "at": [0.1, -0.2, 0.3], "turn": [20, 35, -50], "colour": "#3366cc", **keys}
          for kind, (keys, _) in SOLIDS.items()],
    ]  # fmt: skip
    for k, thing in enumerate(things):
        thing.setdefault("id", f"o{k}")
    lit = scene(*things, light={"ambient": 0.3, "key": 0.7}, background={"sky": ["#0000ff", "#ffffff"]})
    stage = set_stage(lit)
    start, direction = random_rays(20000)
    light, met = look(stage, start, direction)
    laid = tables(stage)
    other, hit = np.empty_like(light), np.empty(len(light), dtype=np.bool_)
    look_all(laid, start, direction, np.full(len(start), np.inf), other, hit, np.empty(len(light)))
    np.testing.assert_array_equal(hit, met)
    differ = np.abs(light - other).max(axis=1) > 1e-9
    assert differ.mean() < 2e-4  # edges of stripes, tiles and sides, where a last bit decides
    assert len(np.unique(nearest(stage, start, direction, np.inf)[1])) >= 9


def test_only_what_lies_before_the_limit_is_seen():
    stage = set_stage(scene({"kind": "sphere", "at": [0, 0, 5], "size": 2.0}))
    start, direction = np.zeros((2, 3)), np.tile([0.0, 0.0, 2.0], (2, 1))
    _, met = look(stage, start, direction, np.array([1.9, 2.1]))
    np.testing.assert_array_equal(met, [False, True])


# -- camera and handedness ---------------------------------------------------------------------

LEFT_BALL = {"kind": "sphere", "id": "plus-x", "at": [0.3, 0.2, -5], "size": 0.2, "colour": [1.0, 0.0, 0.0]}


def centroid(light):
    red = (light[..., 0] == 1.0) & (light[..., 1] == 0.0)
    row, column = np.nonzero(red)
    return row.mean(), column.mean()


@pytest.mark.parametrize("mirror", [False, True])
def test_plus_x_is_on_the_left_unless_the_view_is_mirrored_and_plus_y_is_up(mirror):
    light = render(scene(LEFT_BALL, camera={"mirror": mirror}))
    row, column = centroid(light)
    height, width = light.shape[:2]
    assert row < height / 2
    assert (column > width / 2) == mirror


def test_frame_and_field_of_view_say_the_same():
    wide = scene(LEFT_BALL)
    angle = 2.0 * math.degrees(math.atan(0.55 / 20.0))
    data = copy.deepcopy(PLAIN) | {"object": [LEFT_BALL]}
    data["camera"] = {k: v for k, v in data["camera"].items() if k != "frame"} | {"fov": angle}
    np.testing.assert_allclose(
        aim(Scene.from_dict(data, folder=str(ROOT)).camera).right, aim(wide.camera).right, rtol=1e-12
    )


def test_a_picture_on_a_screen_is_the_right_way_round_for_a_viewer_before_it(tmp_path):
    from PIL import Image

    pixels = np.zeros((40, 60, 3), dtype=np.uint8)
    pixels[:20, 30:] = (255, 0, 0)  # red in the upper right quarter
    Image.fromarray(pixels).save(tmp_path / "p.png")
    (tmp_path / "d.toml").write_text((ROOT / "designs" / "paper-base.toml").read_text())
    data = copy.deepcopy(PLAIN) | {"sheet": {"design": "d.toml", "rung": "law"}}
    data["object"] = [
        {"kind": "screen", "at": [0, 0, -2], "size": [0.9, 0.6], "pattern": "image", "file": "p.png"}
    ]
    row, column = centroid(np.rint(render(Scene.from_dict(data, folder=str(tmp_path)))))
    assert row < 24 < 32 < column


def test_samples_of_a_pixel_are_stratified_and_differ_from_pixel_to_pixel():
    points = offsets(np.arange(50), 1, 64, 64)
    for pixel in points:
        for axis in range(2):
            assert np.bincount((pixel[:, axis] * 8).astype(int), minlength=8).min() >= 6
    assert len(np.unique(points[:, 0, 0])) == 50
    np.testing.assert_array_equal(offsets(np.arange(3), 1, 1, 1), np.full((3, 1, 4), 0.5))


def test_rays_of_an_opening_meet_in_the_plane_that_is_sharp():
    camera = replace(scene(LEFT_BALL).camera, aperture=0.5, focus=7.0, samples=16)
    view = aim(camera)
    pixels = np.array([100, 2000])
    position, direction = rays(view, pixels, np.concatenate([offsets(pixels, 1, 16, 16)]))
    assert np.ptp(position[:, 0]) > 0.3
    middle = offsets(pixels, 1, 16, 16)
    middle[..., :2] = 0.3  # one point of the pixel, all over the opening
    position, direction = rays(view, pixels, middle)
    met = (position + direction).reshape(2, 16, 3)
    assert np.ptp(met, axis=1).max() < 1e-12
    assert np.allclose(met[..., 2], -20.0 + 7.0)


# -- the sheet in the scene --------------------------------------------------------------------

BALL = {"kind": "sphere", "id": "ball", "size": 0.3, "colour": [1.0, 0.0, 0.0]}


def share_red(light):
    return float(((light[..., 0] == 1.0) & (light[..., 1] == 0.0)).mean())


@pytest.mark.parametrize("rung", ["law", "thin", "surfaces"])
def test_what_stands_before_the_sheet_is_seen_as_without_it(rung):
    front = scene(BALL | {"at": [0, 0, -2]}, sheet={"rung": rung})
    np.testing.assert_array_equal(
        share_red(view_through(front).light), share_red(view_through(front, sheet=False).light)
    )


def test_beside_the_sheet_the_scene_is_seen_straight_or_not_at_all():
    light = render(scene({"kind": "checker", "height": -0.6}, camera={"frame": 3.0}))
    bare = view_through(scene({"kind": "checker", "height": -0.6}, camera={"frame": 3.0}), sheet=False).light
    np.testing.assert_array_equal(light[:, :15], bare[:, :15])
    black = render(
        scene({"kind": "checker", "height": -0.6}, camera={"frame": 3.0}, sheet={"surround": "opaque"})
    )
    assert not black[:24, :15].any()  # the floor below is seen before the sheet


def test_an_object_is_seen_through_the_sheet_where_two_thin_lenses_image_it():
    """η = (−1/4, −1), z = 10, D = 20: stretch −1 and 2 on the sheet, so the ball is an ellipse 0.3 by 0.6."""
    light = render(
        scene(BALL | {"at": [0.1, 0.05, 10]}, sheet={"rung": "law"}, camera={"pixels": [220, 220]})
    )
    row, column = np.nonzero((light[..., 0] == 1.0) & (light[..., 1] == 0.0))
    x = -((column + 0.5) / 220 - 0.5) * 1.1  # +x is on the left
    y = -((row + 0.5) / 220 - 0.5) * 1.1
    assert x.mean() == pytest.approx(-0.1, abs=0.004)  # mirrored in x
    assert y.mean() == pytest.approx(0.1, abs=0.004)  # twice as far up
    assert np.ptp(x) == pytest.approx(0.3, abs=0.02)
    assert np.ptp(y) == pytest.approx(0.6, abs=0.02)


def test_ghosts_are_black_unless_they_are_asked_for():
    off = scene({"kind": "checker", "height": -0.6})
    on = scene({"kind": "checker", "height": -0.6}, effects={"mode": "list", "list": ["ghosts"]})
    dark = (view_through(off).light == 0.0).all(axis=-1).mean()
    assert dark > 0.05
    assert (view_through(on).light == 0.0).all(axis=-1).mean() < 0.02


def test_a_flux_of_an_effect_dims_the_view():
    plain = view_through(scene(), passage=geometry_alone(scene()))
    lossy = view_through(scene(effects={"mode": "list", "list": ["fresnel"]}))
    lit = (plain.light > 0).all(axis=-1)
    ratio = (lossy.light[lit] / plain.light[lit]).min()
    assert ratio == pytest.approx((1 - 0.04) ** 4, abs=0.01)  # four faces of 4 % each


def test_lengths_of_scene_and_design_may_have_different_units():
    metres = view_through(scene(BALL | {"at": [0, 0, 10]})).light
    data = copy.deepcopy(PLAIN) | {"unit": "cm"}
    data["camera"] = data["camera"] | {"position": [0, 0, -2000], "frame": 110}
    data["object"] = [BALL | {"at": [0, 0, 1000], "size": 30}]
    np.testing.assert_allclose(render(Scene.from_dict(data, folder=str(ROOT))), metres, atol=1e-9)


# -- sampling ----------------------------------------------------------------------------------

FLOOR = {"kind": "checker", "height": -0.6}


def test_the_picture_is_the_same_on_one_thread_and_many_and_twice():
    busy = scene(FLOOR, camera={"pixels": [150, 90], "samples": 2})
    one = view_through(busy, threads=1).light
    np.testing.assert_array_equal(view_through(busy, threads=3).light, one)
    np.testing.assert_array_equal(view_through(busy, threads=1).light, one)


@pytest.mark.slow
def test_compiled_and_plain_pictures_agree():
    busy = scene(FLOOR, BALL | {"at": [0, 0, 10]}, camera={"samples": 2})
    plain, fast = (view_through(busy, compiled=c).light for c in (False, True))
    assert (np.abs(plain - fast).max(axis=-1) > 1e-9).mean() < 2e-3


@pytest.mark.slow
def test_sampling_goes_on_until_the_noise_is_met():
    noisy = scene(FLOOR, camera={"pixels": [64, 64], "samples": 4, "noise": 0.02, "most_samples": 64})
    picture = view_through(noisy)
    assert picture.samples.min() == 4
    assert picture.samples.max() == 64
    done = picture.samples < 64
    assert picture.error[done].max() <= 0.02
    fixed = view_through(scene(FLOOR, camera={"pixels": [64, 64], "samples": 4}))
    assert (fixed.samples == 4).all()


@pytest.mark.slow
def test_more_samples_come_nearer_to_the_mean():
    views = [render(scene(FLOOR, camera={"pixels": [24, 24], "samples": n})) for n in (4, 16, 256)]
    errors = [np.sqrt(np.mean((view - views[2]) ** 2)) for view in views[:2]]
    assert errors[1] < 0.6 * errors[0]


# -- wavelengths -------------------------------------------------------------------------------


def test_three_lines_of_a_material_without_dispersion_give_the_plain_picture():
    from clacad.rendering.camera import lines

    window = view_through(scene()).window
    for spectrum in ("rgb", "D65", 550e-9):
        found = lines(replace(scene().light, spectrum=spectrum), window, True)
        assert len(found) == 1
        assert found[0].wavelength is None


THREE = (LineSpec(450e-9), LineSpec(532e-9, 2.0), LineSpec(635e-9))


@pytest.mark.parametrize("spectrum", ["rgb", "D65", "visible", "photopic", THREE])
def test_colours_come_back_through_the_spectrum(spectrum):
    from clacad.prescription.prescribe import prescribe
    from clacad.rendering.camera import lines

    glass = scene(sheet={"set": {"pair.material": "PMMA"}, "design": "designs/window-100mm.toml"})
    design = glass.design() if "pair.index" not in glass.design().given else glass.design()
    found = lines(replace(glass.light, spectrum=spectrum), prescribe(design), True)
    if len(found) == 1:
        pytest.skip("this design has a bare index")
    for colour in np.eye(3).tolist() + [[0.2, 0.5, 0.9], [1.0, 1.0, 1.0]]:
        back = sum((np.array(colour) @ line.basis) * line.weight for line in found)
        np.testing.assert_allclose(back, colour, atol=1e-12)
    white = [np.ones(3) @ line.basis for line in found]
    if spectrum != "rgb":
        np.testing.assert_allclose(white, 1.0, atol=1e-12)  # white is the same at every line


def test_white_in_lines_without_blue_has_their_colour_and_invisible_lines_are_grey():
    from clacad.prescription.prescribe import prescribe
    from clacad.rendering.camera import lines

    sheet = prescribe(scene(sheet={"design": "designs/window-100mm.toml"}).design())

    def white(*spectrum):
        light = replace(scene().light, spectrum=tuple(LineSpec(wave, weight) for wave, weight in spectrum))
        return sum((np.ones(3) @ line.basis) * line.weight for line in lines(light, sheet, True))

    red, green, blue = white((532e-9, 1.0), (633e-9, 1.0))
    assert blue < 0.01 < red
    assert 0.01 < green
    redder = white((532e-9, 1.0), (633e-9, 4.0))
    assert redder[0] / redder[1] == pytest.approx(4.0 * red / green, rel=1e-9)
    assert white((1.0e-6, 3.0), (1.1e-6, 1.0)) == pytest.approx([1.0, 1.0, 1.0])


SLAB = {
    "format": 1, "name": "slab", "unit": "mm", "law": {"eta": [-1, -1]},
    "pair": {"form": "slab", "separation": 10.0, "material": "PMMA", "wavelength": 549.1, "surface": "biconic",
             "conic": [-0.448, -0.448]},
    "lattice": {"pitch": 0.5, "count": [200, 200]},
}  # fmt: skip
LAYERS = {
    "form": "slab", "separation": 10.0, "layers": ["silica", "N-SF6", "silica"], "wavelength": 549.1,
}  # fmt: skip


def white_edge(folder, spectrum, **changes):
    """A far white half-plane through a slab: angles (n,) across its edge, and colours (n, 3).

    A pixel covers two cells, so that it has light from all places of a lens.
    """
    (folder / "slab.json").write_text(json.dumps({**SLAB, **changes}))
    away, frame, far = 20000.0, 60.0, 1e9
    seen = Scene.from_dict({
        "format": 1, "name": "edge", "unit": "mm", "sheet": {"design": "slab.json", "rung": "surfaces"},
        "camera": {"position": [0, 0, -away], "frame": frame, "pixels": [60, 4], "samples": 256},
        "light": {"ambient": 1.0, "key": 0.0, "spectrum": spectrum},
        "background": {"sky": ["#000000", "#000000"], "ground": [0, 0, 0]},
        "effects": {"mode": "list", "list": ["dispersion"]},
        "object": [{"kind": "box", "at": [0.5 * far, 0, far], "size": [far, far, 1.0], "colour": [1, 1, 1]}],
    }, folder=str(folder))  # fmt: skip
    return frame / away * ((np.arange(60) + 0.5) / 60 - 0.5), view_through(seen).light.mean(axis=0)


def edge_width(angle, light):
    """Root mean square width of the step in a profile, less that of a pixel."""
    near = np.abs(angle) < 1e-3
    rise, middle = np.diff(light[near]), 0.5 * (angle[near][1:] + angle[near][:-1])
    rise = rise / rise.sum()
    mean = (rise * middle).sum()
    return math.sqrt(max(0.0, (rise * (middle - mean) ** 2).sum() - (angle[1] - angle[0]) ** 2 / 6.0))


@pytest.mark.slow
def test_a_white_edge_through_a_dispersive_sheet_has_fringes_of_the_width_of_the_closed_form(tmp_path):
    """Change of slope ε (1 − η)/η x/f1, x even over the cell, f1 = s/(1 − η), ε = (n − n0)/(n (n − 1))."""
    from clacad.optics.material.catalogue import find

    index = find("PMMA").index
    angle, picture = white_edge(tmp_path, "rgb")
    for channel, wave in ((0, 611.4e-9), (2, 464.2e-9)):
        n = index(wave)
        wanted = abs(n - index(549.1e-9)) / (n * (n - 1.0)) * 2.0 * (0.25 / 5.0) / math.sqrt(3.0)
        assert edge_width(angle, picture[:, channel]) == pytest.approx(wanted, rel=0.03)
    assert edge_width(angle, picture[:, 1]) < 0.06e-3  # of the design wavelength: a pixel
    _, layered = white_edge(tmp_path, "rgb", pair=LAYERS)
    assert edge_width(angle, layered[:, 2]) < 0.2 * edge_width(angle, picture[:, 2])


@pytest.mark.slow
def test_an_edge_in_the_lines_of_a_design_is_coloured_and_white_far_from_it(tmp_path):
    angle, picture = white_edge(tmp_path, "visible")
    inside, outside = angle > 1.1e-3, angle < -1.1e-3
    assert np.abs(picture[outside]).max() < 1e-3
    assert np.ptp(picture[inside], axis=1).max() < 0.05
    assert np.ptp(picture[np.abs(angle) < 0.5e-3], axis=1).max() > 0.2
    _, grey = white_edge(tmp_path, 549.1)
    assert np.ptp(grey, axis=1).max() < 1e-12


# -- against the reference views ---------------------------------------------------------------


def reference(name):
    from PIL import Image

    return np.asarray(Image.open(VIEWS / f"{name}.png").convert("RGB")) / 255.0


ROUNDING = 0.25 / 255 + 1e-4
"""Mean distance of a number from the byte it was rounded to, and a little."""


@pytest.mark.ci_cases("base", "z_k_20", "phi_45_theta_0.5_psi_90")
@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_view_is_the_independent_renderer_s_picture(name):
    """Every lenslet's mean over 6 × 6 rays; few rays of 36 differ, so few means do, and by little."""
    picture = view_through(view_scene(name, 1320), compiled=True).light
    means = picture.reshape(220, 6, 220, 6, 3).mean(axis=(1, 3))
    on_sheet = np.abs(means - reference(name))[10:210, 10:210]
    assert (on_sheet.max(axis=-1) <= 3.5 / 255).mean() > 0.95
    assert (
        on_sheet.mean()
        < 1.1 * CASES[name]["mean_abs_difference_of_lenslet_means"]["exact_snell_model"] + ROUNDING
    )
    # a ray that differs changes its mean by a typical contrast of 0.4 over 36: so this many rays differ
    assert on_sheet.max(axis=-1).mean() / 0.4 < 0.01
    beside = np.abs(means - reference(name))[:, :9]
    assert (beside.max(axis=-1) <= 3.5 / 255).mean() > 0.96  # tile edges near the horizon fall on rays


@pytest.mark.ci_cases("base", "delta_0.005_0.010", "phi_45_theta_0.5_psi_90")
@pytest.mark.daily_cases("z_k_2")
@pytest.mark.parametrize("name", CASES)
def test_the_fitted_map_of_a_view_is_the_independent_tracer_s(name):
    """The fit leaves out strays by a rule of its own, which moves the map by some parts in 10⁴ (the pole: 10³)."""
    expected = CASES[name]["coordinate_screen"]["exact_snell_model"]
    found = measure(view_scene(name), CASES[name]["z_k"])
    slack = 4e-3 if name == "z_k_20" else 8e-4
    np.testing.assert_allclose(found.matrix, expected["M"], rtol=0, atol=slack)
    np.testing.assert_allclose(found.offset, expected["A"], rtol=0, atol=2e-4)


@pytest.mark.ci_cases("base", "delta_0.005_0.010", "phi_45_theta_0.5_psi_90")
@pytest.mark.daily_cases("z_k_20")
@pytest.mark.parametrize("name", CASES)
def test_the_homogeneous_sheet_shows_the_ideal_law(name):
    """The law turns rays in z = 0; the reference turned them in z = s, a difference of s/D and s/z."""
    found = measure(view_scene(name, rung="law"), CASES[name]["z_k"])
    expected = CASES[name]["coordinate_screen"]["ideal_law_turned_at_s"]
    z = CASES[name]["z_k"]
    unit = np.eye(2)
    turned_at_0 = unit + (np.array(expected["M"]) - 1.0025 * unit) * z / (z - 0.05)
    np.testing.assert_allclose(found.matrix, turned_at_0, rtol=0, atol=2e-3)
    np.testing.assert_allclose(found.offset, np.array(expected["A"]) * z / (z - 0.05), rtol=0, atol=2e-3)


# -- files -------------------------------------------------------------------------------------


def test_bytes_and_light_are_each_other_s_inverse():
    codes = np.arange(256, dtype=np.uint8)
    np.testing.assert_array_equal(encode(decode(codes)), codes)
    np.testing.assert_array_equal(encode(np.array([-1.0, 0.5, 2.0]), encoding="linear"), [0, 128, 255])
    np.testing.assert_array_equal(encode(np.array([0.25]), exposure=2.0, encoding="linear"), [128])


@pytest.mark.parametrize("name", ["a.png", "a.webp", "a.tiff"])
def test_a_written_picture_reads_back_and_says_what_it_is(name, tmp_path):
    from PIL import Image

    picture = view_through(scene(FLOOR, camera={"mirror": True, "pixels": [40, 30]}))
    write_picture(picture, tmp_path / name)
    back = read_picture(tmp_path / name)
    np.testing.assert_allclose(back, np.clip(picture.light, 0, 1), atol=0.006)
    first = (tmp_path / name).read_bytes()
    write_picture(picture, tmp_path / name, overwrite=True)
    assert (tmp_path / name).read_bytes() == first
    assert "flipped left-right" in metadata_of(picture)["clacad:handedness"]
    if name.endswith("png"):
        assert "flipped left-right" in Image.open(tmp_path / name).text["clacad:handedness"]


@pytest.mark.slow
def test_a_movie_has_its_frames_in_order(tmp_path):
    from PIL import Image

    data = copy.deepcopy(PLAIN) | {"object": [BALL | {"at": [0, 0, -15]}]}
    data["camera"] = data["camera"] | {"pixels": [40, 40]}
    data["animation"] = {
        "frames": 4,
        "fps": 10,
        "move": [{"key": "object.ball.at.0", "from": -0.1, "to": 0.1}],
    }
    movie = Scene.from_dict(data, folder=str(ROOT))
    for name in ("m.webp", "m.gif", "m.png"):
        write_movie(render_movie(movie), tmp_path / name, 10.0)
        image = Image.open(tmp_path / name)
        assert image.n_frames == 4
        columns = []
        for k in range(4):
            image.seek(k)
            red = np.asarray(image.convert("RGB")).astype(int)
            columns.append(np.nonzero((red[..., 0] > 200) & (red[..., 1] < 90))[1].mean())
        assert columns == sorted(columns, reverse=True)  # +x is on the left


@pytest.mark.slow
def test_a_movie_is_written_as_mp4_where_the_encoder_is_installed(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    data = copy.deepcopy(PLAIN) | {"object": [BALL | {"at": [0, 0, -15]}]}
    data["camera"] = data["camera"] | {"pixels": [64, 48]}
    data["animation"] = {
        "frames": 5,
        "fps": 10,
        "move": [{"key": "object.ball.at.0", "from": -0.1, "to": 0.1}],
    }
    write_movie(render_movie(Scene.from_dict(data, folder=str(ROOT))), tmp_path / "m.mp4", 10.0)
    frames = ffmpeg.read_frames(str(tmp_path / "m.mp4"))
    told = next(frames)
    assert told["size"] == (64, 48)
    assert told["fps"] == 10.0
    columns = []
    for frame in frames:
        red = np.frombuffer(frame, np.uint8).reshape(48, 64, 3).astype(float)
        much = np.maximum(0.0, red[..., 0] - red[..., 1:].max(axis=-1) - 20.0)
        assert much.sum() > 100.0
        columns.append((much * np.arange(64)).sum() / much.sum())
    assert len(columns) == 5
    assert columns == sorted(columns, reverse=True)


def test_without_the_encoder_mp4_is_refused_with_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(UnknownPicture, match=r"clacad\[movies\]"):
        write_movie(iter(()), tmp_path / "m.mp4", 10.0)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_picture_that_is_stopped_leaves_nothing_and_stops_at_once(name, tmp_path):
    scene = ROOT / "designs" / "scenes" / "fig3-z-8.toml"
    command = [sys.executable, "-m", "clacad", "render", str(scene), "-o", str(tmp_path / "x.png"),
               "--pixels", "6000", "--samples", "200"]  # fmt: skip
    busy = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        time.sleep(2.5)
        assert busy.poll() is None
        busy.send_signal(getattr(signal, name))
        _, said = busy.communicate(timeout=60)
    finally:
        busy.kill()
    assert busy.returncode != 0
    assert b"Traceback" not in said
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_progress_tells_the_share_of_the_rays_that_are_done():
    told = []
    view_through(scene(FLOOR, camera={"pixels": [256, 256], "samples": 4}), threads=1,
                 progress=lambda stage, share: told.append(share))  # fmt: skip
    assert len(told) > 3
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_a_frame_that_cannot_be_is_told_before_the_first_is_drawn():
    data = copy.deepcopy(PLAIN)
    move = {"key": "sheet.set.law.eta.0", "values": [-1.0, 0.0]}
    data["sheet"] = data["sheet"] | {"set": {"law.eta": [-1.0, -1.0]}}
    data["animation"] = {"frames": 3, "move": [move]}
    with pytest.raises(SceneError, match="eta"):
        next(render_movie(Scene.from_dict(data, folder=str(ROOT))))


def test_a_label_stands_below_the_picture():
    pixels = np.full((30, 200, 3), 7, dtype=np.uint8)
    made = labelled(pixels, "F3  z = 8")
    np.testing.assert_array_equal(made[:30], pixels)
    assert made[30:].min() < 100 < made[30:].max()


def test_fates_that_do_not_shine_are_black():
    assert geometry_alone(scene()).shining == (int(Fate.ALIVE), int(Fate.LAND))


@pytest.mark.slow
def test_a_large_sheet_is_seen_in_the_memory_of_a_small_one():
    """Nothing in the renderer counts lenslets: a lens is found by its index."""

    def peak(count):
        busy = scene(
            FLOOR,
            sheet={"set": {"lattice.count": [count, count]}},
            camera={"pixels": [128, 128], "frame": 0.2},
        )
        view_through(busy, threads=1)
        tracemalloc.start()
        view_through(busy, threads=1)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    small, large = peak(50), peak(2000)
    assert large < 1.1 * small + 1e5  # four million lenslets would be 32 MB, were there a number for each


def test_the_reference_scene_is_what_views_readme_says():
    assert view_data("base")["camera"]["mirror"] is True


def test_a_photograph_is_decoded_once_while_its_file_is_the_same(tmp_path):
    from PIL import Image

    place = tmp_path / "a.png"
    Image.new("RGB", (7, 5), (255, 0, 0)).save(place)
    first = read_picture(place)
    assert read_picture(str(place)) is first
    assert first.shape == (5, 7, 3)
    assert (first == [1.0, 0.0, 0.0]).all()
    Image.new("RGBA", (6, 4), (0, 255, 0, 0)).save(place)
    assert read_picture(place).shape == (4, 6, 3)
    assert (read_picture(place) == 0.0).all()


# -- the tint of a sheet -------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [False, True])
def test_a_tint_takes_its_part_of_each_colour_seen_through_the_sheet_and_of_nothing_else(compiled):
    """Light is linear: through the sheet each colour is the untinted one times the tint, around and before it the same."""
    tint = (0.42, 0.6, 0.86)
    things = ({"kind": "checker", "height": -0.6}, BALL | {"at": [0, 0, -2]})
    plain, tinted = (
        view_through(
            scene(
                *things,
                camera={"frame": 2.0, "pixels": [40, 40], "samples": 1},
                sheet={"rung": "thin"} | more,
            ),
            compiled=compiled,
        ).light
        for more in ({}, {"tint": list(tint)})
    )
    side = (np.arange(40) + 0.5) / 20.0 - 1.0
    through = np.abs(side)[:, None] < 0.5
    through = through & through.T & ~((plain[..., 0] == 1.0) & (plain[..., 1] == 0.0))
    np.testing.assert_allclose(tinted[through], plain[through] * tint, rtol=1e-12)
    np.testing.assert_array_equal(tinted[~through], plain[~through])
    assert plain[through].max() > 0.1


@pytest.mark.slow
def test_exact_surfaces_with_a_tint_are_drawn_alike_by_both_ways():
    seen = scene({"kind": "checker", "height": -0.6}, camera={"pixels": [24, 24]}, sheet={"rung": "surfaces", "tint": [0.4, 0.6, 0.9]})  # fmt: skip
    reference, compiled = (view_through(seen, compiled=way).light for way in (False, True))
    assert np.abs(reference - compiled).max() <= 1.0 / 255.0


@pytest.mark.parametrize("tint", [[0.5, 0.5, 1.1], [-0.1, 1, 1], [1, 1], "blue"])
def test_a_tint_outside_0_to_1_is_refused(tint):
    with pytest.raises(SceneError, match=r"sheet\.tint"):
        scene(sheet={"tint": tint})


FLOATING = """format = 1
name = "floating"
unit = "mm"
sheet = {design = "wide.toml", rung = "surfaces", surround = "opaque", set = {"lattice.count" = [160, 160]}}
camera = {position = [%r, 0, %r], target = [0, 0, -60], frame = 60, pixels = 60, samples = 4}
light = {ambient = 1.0, key = 0.0}
background = {sky = ["#000000", "#000000"], ground = "#000000"}
effects = {mode = "none"}
object = [{id = "ball", kind = "sphere", at = [9, 6, 60], size = 5, colour = "#ffffff"}]
"""


@pytest.mark.parametrize("angle", [-8.0, 0.0, 8.0])
def test_the_real_image_of_a_wide_field_floats_where_the_law_sends_the_light(tmp_path, angle):
    """A point (x, y, z) behind a sheet of eta = -1 is imaged to (x, y, -z), for every eye: no turn and no band."""
    (tmp_path / "wide.toml").write_text(template("wide", "three-plates-10deg"))
    eye = 900.0 * np.array([math.sin(math.radians(angle)), 0.0, -math.cos(math.radians(angle))]) - [
        0.0,
        0.0,
        60.0,
    ]
    (tmp_path / "scene.toml").write_text(FLOATING % (float(eye[0]), float(eye[2])))
    light = view_through(load_scene(tmp_path / "scene.toml"), compiled=False).light.sum(axis=-1)
    y, x = np.mgrid[:60, :60] + 0.5
    found = np.array([(x * light).sum(), (y * light).sum()]) / light.sum()
    ahead = np.array([0.0, 0.0, -60.0]) - eye
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    toward = np.array([9.0, 6.0, -60.0]) - eye
    seen = 900.0 / (toward @ ahead) * np.array([toward @ right, -(toward @ np.cross(right, ahead))])
    assert found == pytest.approx(30.0 + seen, abs=0.7)
    disc = np.hypot(x - 30.0 - seen[0], y - 30.0 - seen[1])
    assert light[disc < 1.5].min() > 0.6 * light.max()
    assert light[disc > 6.0].sum() < 0.05 * light.sum()
