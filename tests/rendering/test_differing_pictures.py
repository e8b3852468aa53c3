"""Pictures through non-uniform sheets: every path the same, each rung the result of its rays."""

from __future__ import annotations

import json

import numpy as np
import pytest

import clacad
from clacad.cli.entry_point import main
from clacad.paper.sheet_figures import DIFFERING
from clacad.rendering.camera import aim, rays
from clacad.rendering.picture import view_through
from clacad.rendering.screen_measure import WIDE, coordinate_scene
from clacad.rendering.sheet_passage import geometry_alone
from clacad.scene import Scene, SceneError, load_scene
from clacad.storage.errors import BadRequest

DESIGN = """
format = 1
name = "differing"
unit = "mm"
[law]
eta = [-1.0, -1.0]
[pair]
form = "slab"
separation = 10
material = "PMMA"
wavelength = 550
offset = "paraxial"
[lattice]
pitch = 0.5
count = [31, 31]
[check]
process = "none"
"""
KINDS = {
    "aimed": {"lattice.aperture": {"point": [0, 0, -400]}},
    "other pitch": {"lattice.pitch_2": 0.497},
    "turned": {"lattice.rotation_2": "0.3 deg"},
    "varying": {"law.varying": {"f_image": 300}},
}


def scene_of(folder, kind, rung="surfaces", pixels=40, **sheet):
    (folder / "design.toml").write_text(DESIGN)
    return Scene.from_dict(
        {
            "format": 1, "name": "seen", "unit": "mm",
            "sheet": {"design": "design.toml", "rung": rung, "set": KINDS[kind], **sheet},
            "camera": {"position": [0, 0, -400], "target": [0, 0, 0], "frame": 17, "pixels": [pixels, pixels], "samples": 1},
            "effects": {"mode": "list", "list": ["ghosts"]},
            "object": [{"id": "ball", "kind": "sphere", "at": [1, 0, 60], "size": 9, "colour": "#a04030"}],
        },
        folder=str(folder),
    )  # fmt: skip


def screen_points(scene, z):
    """Where each camera ray that shines meets a screen, read from the colours of the picture; NaN where none does."""
    plain = coordinate_scene(scene, z, scene.camera.pixels[0])
    light = view_through(plain, passage=geometry_alone(plain), compiled=False).light.reshape(-1, 3)
    return np.where(light[:, 2:] > 0.5, (light[:, :2] - 0.5) * WIDE, np.nan)


def camera_rays(scene):
    view = aim(scene.camera)
    position, direction = rays(
        view, np.arange(view.width * view.height), np.full((view.width * view.height, 1, 4), 0.5)
    )
    return clacad.Rays(position, direction)


@pytest.mark.parametrize("rung", ["law", "thin", "surfaces"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_pixel_shows_what_its_own_ray_meets(kind, rung, tmp_path):
    scene, z = scene_of(tmp_path, kind, rung), 60.0
    window, sent = clacad.prescribe(scene.design()), camera_rays(scene)
    result = clacad.trace(window, sent, rung=rung, path="numpy")
    lit = np.isin(result.fate, (clacad.Fate.ALIVE, clacad.Fate.LAND))
    expected = result.position + (z - result.position[:, 2:]) / result.direction[:, 2:] * result.direction
    seen = screen_points(scene, z)
    on_sheet = result.fate != clacad.Fate.MISSED
    assert lit.sum() > 0.5 * on_sheet.sum() > 500
    assert (np.isfinite(seen[:, 0]) == lit)[on_sheet].all()
    assert np.abs(seen - expected[:, :2])[lit].max() < 1e-9


def test_rung_law_is_that_of_the_cell_hit_or_where_asked_that_of_the_very_point(tmp_path):
    z = 60.0
    cells, smooth = (scene_of(tmp_path, "varying", "law", continuous=value) for value in (False, True))
    sent = camera_rays(cells)
    x0 = sent.position - (sent.position[:, 2:] / sent.direction[:, 2:]) * sent.direction
    t = sent.direction[:, :2] / sent.direction[:, 2:]
    kappa = -1.0 / 300.0
    by_point = x0[:, :2] - z * (t - kappa * x0[:, :2])
    centre = 0.5 * np.round(x0[:, :2] / 0.5)  # an odd number of cells of 0.5 mm
    by_cell = x0[:, :2] - z * (t - kappa * centre)
    for scene, expected in ((cells, by_cell), (smooth, by_point)):
        seen = screen_points(scene, z)
        on = np.isfinite(seen[:, 0]) & (np.abs(x0[:, :2]).max(axis=1) < 7.7)
        assert on.sum() > 1000
        assert np.abs(seen - expected)[on].max() < 1e-9


def test_the_smooth_law_is_asked_of_rung_law_and_of_no_table(tmp_path):
    with pytest.raises(SceneError, match='CL113.*continuous needs rung = "law"'):
        scene_of(tmp_path, "varying", "surfaces", continuous=True)
    rows = "i,j,delta_x,delta_y\n" + "".join(f"{i},{j},0,0\n" for i in range(31) for j in range(31))
    (tmp_path / "cells.csv").write_text(rows)
    (tmp_path / "design.toml").write_text(DESIGN.replace("[law]", '[law]\nvarying = {table = "cells.csv"}'))
    scene = Scene.from_dict(
        {
            "format": 1, "name": "seen", "unit": "mm", "sheet": {"design": "design.toml", "rung": "law", "continuous": True},
            "camera": {"position": [0, 0, -400], "frame": 17, "pixels": [4, 4]},
        },
        folder=str(tmp_path),
    )  # fmt: skip
    with pytest.raises(BadRequest, match=r"sheet\.continuous.*table"):
        view_through(scene)


@pytest.mark.ci_cases("aimed-surfaces", "turned-thin", "varying-surfaces")
@pytest.mark.slow
@pytest.mark.parametrize("rung", ["law", "thin", "surfaces"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_picture_is_the_same_compiled_or_not_and_on_any_number_of_cores(kind, rung, tmp_path):
    scene = scene_of(tmp_path, kind, rung)
    one, two, three = (
        view_through(scene, compiled=compiled, threads=threads).light
        for compiled, threads in ((False, 1), (True, 1), (True, 3))
    )
    assert np.array_equal(two, three)
    assert (np.abs(one - two).max(axis=2) > 1e-6).sum() <= 2  # edges of the ball, to the last bit


@pytest.mark.slow
def test_the_command_draws_it(tmp_path, capsys):
    (tmp_path / "design.toml").write_text(DESIGN)
    (tmp_path / "scene.toml").write_text(
        'format = 1\nname = "seen"\nunit = "mm"\n[sheet]\ndesign = "design.toml"\nrung = "surfaces"\n'
        'set = { "lattice.aperture" = { point = [0, 0, -400] } }\n'
        "[camera]\nposition = [0, 0, -400]\nframe = 17\npixels = [24, 24]\nsamples = 1\n"
    )
    out = tmp_path / "seen.png"
    assert main(["render", str(tmp_path / "scene.toml"), "-o", str(out), "--json"]) == 0
    said = capsys.readouterr()
    assert out.exists()
    assert json.loads(said.out)


@pytest.mark.parametrize(
    "figure",
    [pytest.param(f, id=f.row, marks=[] if f.row == "V3" else [pytest.mark.long]) for f in DIFFERING],
)
def test_an_entry_of_the_atlas_beyond_the_paper_measures_what_thin_lenses_say(figure):
    from viewscenes import ROOT

    found = list(figure.check(lambda stem: load_scene(ROOT / "designs" / "scenes" / f"{stem}.toml")))
    assert found
    assert not [one for one in found if not one.passed]


@pytest.mark.slow
def test_a_target_chooses_the_facets_of_the_worst_cell(tmp_path):
    """The coarser the target the coarser the facets; the first power of their size, as slopes of facets err."""
    from clacad.rendering.picture_cost import within_target

    scene = scene_of(tmp_path, "aimed", "mesh")
    quads = [within_target(scene, error).sheet.quads for error in (8e-3, 2e-3)]
    assert 3.0 < quads[1] / quads[0] < 5.5


@pytest.mark.long
@pytest.mark.parametrize("kind", ["aimed", "turned"])
def test_a_picture_by_facets_shows_what_rays_through_them_meet(kind, tmp_path):
    scene, z = scene_of(tmp_path, kind, "mesh"), 60.0
    window, sent = clacad.prescribe(scene.design()), camera_rays(scene)
    result = clacad.trace(window, sent, rung="mesh")
    lit = np.isin(result.fate, (clacad.Fate.ALIVE, clacad.Fate.LAND))
    expected = result.position + (z - result.position[:, 2:]) / result.direction[:, 2:] * result.direction
    seen = screen_points(scene, z)
    on_sheet = result.fate != clacad.Fate.MISSED
    assert lit.sum() > 0.4 * on_sheet.sum() > 300
    assert (np.isfinite(seen[:, 0]) == lit)[on_sheet].all()
    assert np.abs(seen - expected[:, :2])[lit].max() < 1e-9
    exact = clacad.trace(window, sent, path="numpy")
    assert (exact.fate == result.fate).mean() > 0.9
    assert (exact.cell == result.cell).all(axis=1)[on_sheet].mean() > 0.95
