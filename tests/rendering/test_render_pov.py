"""A second opinion: POV-Ray renders the emitted scene, ray by ray the same colours and the same map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from povpictures import before_stripes, needs_povray, povray
from viewscenes import CASES, ROOT, view_data, view_scene

from clacad.exporting.pov.pov_scene import NotForPov, pov_lines
from clacad.prescription.prescribe import prescribe
from clacad.rendering import view_through
from clacad.rendering.screen_measure import coordinate_scene, fitted, sheet_points
from clacad.rendering.sheet_passage import geometry_alone
from clacad.scene import Scene


def small(name, pixels, cells=60):
    """A reference scene with fewer lenslets, seen as closely."""
    data = view_data(name, pixels)
    data["sheet"]["set"]["lattice.count"] = [cells, cells]
    data["camera"]["frame"] = 1.1 * cells / 200
    return Scene.from_dict(data, folder=str(ROOT))


def same_colour(scene, folder):
    """Share of single rays on the sheet whose colour agrees within 3/255."""
    mine, theirs = view_through(scene).light, povray(scene, folder)
    _, inside = sheet_points(scene, prescribe(scene.design()), mine.shape[:2])
    off = np.abs(mine - theirs).max(axis=-1).ravel()[inside]
    return float((off <= 3 / 255).mean())


@pytest.mark.slow
@needs_povray
@pytest.mark.parametrize("name", ["base", "phi_45_theta_0.5"])
def test_single_rays_have_the_colour_that_povray_finds(name, tmp_path):
    assert same_colour(small(name, 200), tmp_path) >= 0.99


@needs_povray
@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_single_rays_of_the_reference_views_have_the_colour_that_povray_finds(name, tmp_path):
    assert same_colour(view_scene(name), tmp_path) >= 0.99


def map_difference(scene, z, folder):
    """Largest difference of offset and matrix of the fitted maps, over the same direct rays."""
    plain = coordinate_scene(scene, z, scene.camera.pixels[0])
    side = 40.0  # 16 bits a colour: 6e-4 tiles a step
    plain = replace(plain, objects=(replace(plain.objects[0], size=(side, side)),))
    theirs = povray(plain, folder).reshape(-1, 3)
    mine = view_through(plain, passage=geometry_alone(plain, direct=True)).light
    x0, inside = sheet_points(plain, prescribe(plain.design()), mine.shape[:2])
    mine = mine.reshape(-1, 3)
    both = inside & (mine[:, 2] > 0.5) & (theirs[:, 2] > 0.5)
    a, b = (fitted(x0[both], (light[both, :2] - 0.5) * side) for light in (mine, theirs))
    return float(np.abs(a[0] - b[0]).max()), float(np.abs(a[1] - b[1]).max())


@pytest.mark.slow
@needs_povray
def test_the_fitted_map_is_povray_s(tmp_path):
    offset, matrix = map_difference(small("delta_0.005_0.010", 300), 10.0, tmp_path)
    assert offset < 2e-4
    assert matrix < 2e-3  # a small sheet has a short lever; the whole one is checked against 2e-4


@needs_povray
@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_the_fitted_map_of_a_reference_view_is_povray_s_within_2e_4(name, tmp_path):
    offset, matrix = map_difference(view_scene(name, 400), CASES[name]["z_k"], tmp_path)
    assert offset < 2e-4
    assert matrix < 2e-4


THINGS = [
    {"kind": "checker", "id": "floor", "height": -0.6},
    {"kind": "knight", "id": "knight", "at": [-0.25, -0.5, 1], "size": 0.9, "turn": [0, 30, 0], "colour": "#cc9955"},
    {"kind": "box", "id": "box", "at": [0.3, -0.3, 1], "size": [0.2, 0.3, 0.1], "turn": [20, 30, 40], "colour": "#3366cc"},
    {"kind": "cone", "id": "cone", "at": [0.3, 0.0, 1], "size": [0.2, 0.1, 0.2], "turn": [0, 0, 15]},
    {"kind": "mesh", "id": "mesh", "at": [0.3, 0.25, 1], "size": 0.2, "file": "tests/data/tetra.obj", "up": "z"},
    {"kind": "screen", "id": "stripes", "at": [-0.3, 0.35, 1], "size": [0.3, 0.2], "turn": [0, 20, 0],
     "pattern": "stripes", "period": 0.07},
    {"kind": "sphere", "id": "front", "at": [0.0, 0.3, -3], "size": 0.15, "colour": "#cc3333"},
    {"kind": "screen", "id": "photo", "at": [0.05, -0.45, 1], "size": [0.2, 0.2], "pattern": "image",
     "file": "tests/data/views/base.png"},
]  # fmt: skip


@pytest.mark.slow
@needs_povray
@pytest.mark.parametrize("mirror", [False, True])
def test_every_kind_of_object_light_and_sky_is_drawn_alike(mirror, tmp_path):
    scene = Scene.from_dict(
        {
            "format": 1, "name": "things", "unit": "m",
            "sheet": {"design": "designs/paper-base.toml", "rung": "surfaces", "set": {"lattice.count": [1, 1]}},
            "camera": {"position": [0.5, 0.4, -10], "target": [0, 0, 1], "up": [0.1, 1, 0], "frame": 1.3,
                       "pixels": [240, 180], "samples": 1, "mirror": mirror},
            "object": THINGS,
        },
        folder=str(ROOT),
    )  # fmt: skip
    off = np.abs(view_through(scene).light - povray(scene, tmp_path)).max(axis=-1)
    assert (off <= 3 / 255).mean() > 0.985  # edges, and the small picture's own interpolation


FORMS = {
    "slab": {"lattice.count": [12, 12]},
    "plano": {"lattice.count": [12, 12]},
    "hexagonal": {"lattice.count": [16, 16], "lattice.outline": {"circle": 6.0}},
    "tilted-seam": {"lattice.count": [12, 12]},
    "baffled": {"lattice.count": [10, 10], "body.border": 1.0},
}


@pytest.mark.ci_cases("plano", "hexagonal", "baffled")
@pytest.mark.slow
@needs_povray
@pytest.mark.parametrize("design", FORMS)
def test_every_form_of_sheet_shows_the_rays_that_povray_finds(design, tmp_path):
    """Land, opaque land, hexagons, a round outline, displaced arrays of one body, a honeycomb."""
    scene = before_stripes(
        design,
        {"design": f"designs/{design}.toml", "set": FORMS[design]},
        {"position": [0, 0, -300], "frame": 9.0, "pixels": [150, 150]},
    )
    off = np.abs(view_through(scene).light - povray(scene, tmp_path)).max(axis=-1)
    window = prescribe(scene.design())
    at, inside = sheet_points(scene, window, off.shape)
    rim = np.abs(np.linalg.norm(at, axis=1) - 3.0) if design == "hexagonal" else None
    # rays of the outermost cells that end in the outer wall are black here and followed on there
    inner = inside & (np.abs(at).max(axis=1) < 0.8 * np.abs(at[inside]).max())
    if rim is not None:
        inner &= rim > 0.2
    assert (off.ravel()[inner] <= 3 / 255).mean() > 0.995
    assert inner.sum() > 2000


def test_a_sheet_that_the_scene_cannot_hold_is_refused_in_words():
    from clacad.design import load

    window = prescribe(load(ROOT / "designs" / "slab.toml", ('pair.surface="biconic"',)))
    with pytest.raises(NotForPov, match="cannot hold biconic or polynomial faces"):
        list(pov_lines(window, None))


def test_the_emitted_scene_does_not_grow_with_the_sheet():
    from clacad.design import load

    design = load(ROOT / "designs" / "paper-base.toml")
    lines = ["\n".join(pov_lines(prescribe(design.with_cells((n, n))), None)) for n in (3, 200)]
    assert abs(len(lines[0]) - len(lines[1])) < 100
    assert lines[0] == "\n".join(pov_lines(prescribe(design.with_cells((3, 3))), None))
