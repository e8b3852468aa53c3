"""Opaque line on one face: its share by area, the rays that it ends, its mask, and what it refuses."""

from __future__ import annotations

import re
import tomllib

import numpy as np
import pytest

from clacad import DesignError, export, prescribe
from clacad.base.types import silent
from clacad.design import Design, load, template
from clacad.effects.engine.camera_light import light_reaching_camera, rules_for
from clacad.effects.engine.effect import Setting
from clacad.effects.engine.nonsequential import mirrored, trace_nonsequential
from clacad.optics.rays import Fate
from clacad.sheet.bundle import bundle
from clacad.sheet.face_order import lined_array, lined_face, lined_surfaces
from clacad.sheet.vignetting import share, thin_cells
from clacad.tracing.trace import trace

WIDTH, PITCH, PLATES = 0.012, 0.5, "three-plates-10deg"


def design(face: int | None = 1, kind: str = PLATES) -> Design:
    plain = Design.from_dict(tomllib.loads(template(kind, kind))).with_cells((9, 9))
    return plain if face is None else plain.replace({"lattice.line": {"face": face, "width": WIDTH}})


def lit(window, field=0.0, count=1 << 14):
    return bundle(window, count, field, middle=np.array([0.0, 0.0, 1.0])).rays


def test_light_along_the_normal_loses_the_area_of_the_line_on_the_first_face():
    window, plain = prescribe(design()), prescribe(design(None))
    share = (trace(window, lit(window), path="numpy").fate == Fate.VIGNETTED).mean()
    part = (1.0 - WIDTH / PITCH) ** 2
    assert share == pytest.approx(1.0 - part, abs=1e-3)
    assert thin_cells(window).part == pytest.approx(part * thin_cells(plain).part, rel=1e-12)


@pytest.mark.parametrize("face", [1, 6])
def test_a_ray_ends_where_it_hits_the_line_and_all_others_go_on_as_without_it(face):
    window, plain = prescribe(design(face)), prescribe(design(None))
    rays = lit(window, np.radians(10.0))
    found, free = (trace(one, rays, record=True, path="numpy") for one in (window, plain))
    ended = found.fate == Fate.VIGNETTED
    assert 0.03 < ended.mean() < 0.07
    surface = face - 1
    hit = np.abs(
        (free.hits[surface][:, :2] + 0.5 * PITCH) / PITCH
        - np.round((free.hits[surface][:, :2]) / PITCH)
        - 0.5
    )
    reached = free.surface >= surface
    assert (ended == (reached & (PITCH * (0.5 - hit.max(axis=1)) < 0.5 * WIDTH))).all()
    for name in ("position", "direction", "fate", "optical_path", "cell", "order"):
        assert np.array_equal(getattr(found, name)[~ended], getattr(free, name)[~ended])
    assert found.position[ended] == pytest.approx(free.hits[surface, ended], abs=1e-14)
    assert (found.surface[ended] == surface).all()
    if face == 1:
        length = np.linalg.norm(free.hits[0, ended] - rays.position[ended], axis=1)
        assert found.optical_path[ended] == pytest.approx(length, rel=1e-12)
        assert found.direction[ended] == pytest.approx(rays.direction[ended], abs=1e-15)
    else:
        assert found.direction[ended] == pytest.approx(free.directions[surface - 1, ended], abs=1e-15)
        assert (found.optical_path[ended] <= free.optical_path[ended] + 1e-12).all()
    assert (found.fate == Fate.GHOST).sum() < 0.5 * (free.fate == Fate.GHOST).sum()


def test_the_mask_is_that_of_the_face_with_the_line_and_clears_the_rest(tmp_path):
    export(design(6).with_cells((3, 3)), tmp_path / "out", formats=("mask",), progress=silent)
    masks = sorted(one.name for one in (tmp_path / "out").glob("*.mask.*"))
    assert [re.search(r"plate3-3-pmma-back\.mask\.(dxf|svg)$", one)[1] for one in masks] == ["dxf", "svg"]
    text = next((tmp_path / "out").glob("*.svg")).read_text()
    points = np.array(re.search(r'points="([^"]+)"', text)[1].replace(",", " ").split(), dtype=float).reshape(
        -1, 2
    )
    assert np.ptp(points, axis=0) == pytest.approx(PITCH - WIDTH, rel=1e-12)


def test_ideal_lenses_and_shares_lose_the_light_on_the_line_of_their_own_array():
    """Lens 1 loses the area of the line; at lens 2, of size |m| = 1, the cell's copy loses that border again."""
    for face in (1, 2):
        plain = load("slab", ["lattice.count = [5, 5]"])
        window = prescribe(plain.replace({"lattice.line": {"face": face, "width": 0.05}}))
        rays = lit(window)
        seen = trace(window, rays, rung="thin", path="numpy")
        ended = seen.fate == Fate.VIGNETTED
        assert ended.mean() == pytest.approx(1.0 - 0.9**2, abs=2e-3)
        exact = trace(window, rays, path="numpy").fate == Fate.VIGNETTED
        assert (ended == exact).mean() > 0.995
        wanted = (seen.fate == Fate.ALIVE).mean()
        assert share(thin_cells(window), np.array([[0.0, 0.0, 1.0]]))[0] == pytest.approx(wanted, abs=2e-3)


def test_lines_on_sheets_whose_cells_differ_follow_the_cells_of_their_face():
    aim = "lattice.aperture = {point = [0, 0, -400]}"
    plain = load("slab", ["lattice.count = [9, 9]", aim])
    window = prescribe(plain.replace({"lattice.line": {"face": 2, "width": 0.05}}))
    rays = lit(window, 0.01)
    found = trace(window, rays, record=True, path="numpy")
    free = trace(prescribe(plain), rays, record=True, path="numpy")
    cells = window.lattice_of(1)
    _, x, y = cells.locate(free.hits[1, :, 0], free.hits[1, :, 1])
    aside = np.maximum(np.abs(x), np.abs(y)) > 0.5 * cells.pitch[0] - 0.025
    assert cells.pitch[0] > 1.02 * PITCH
    reached = free.surface >= 1
    assert 0.1 < (reached & aside).mean() < 0.3
    assert ((found.fate == Fate.VIGNETTED) == (reached & aside)).all()


@pytest.mark.parametrize(
    ("kind", "face", "surfaces"),
    [("achromat-plastic", 2, (1, 2)), ("achromat", 2, (1, 2)), ("achromat", 3, (3, 4))],
)
def test_a_line_on_a_joint_ends_rays_there_and_has_a_mask(kind, face, surfaces, tmp_path):
    """Of plane joints the line runs along the cells of the nearest lens."""
    plain = load(kind, ["lattice.count = [3, 3]"])
    made = plain.replace({"lattice.line": {"face": face, "width": 0.05}})
    window = prescribe(made)
    assert lined_surfaces(window) == surfaces
    assert lined_array(window) == face - 2
    share_ended = (trace(window, lit(window), path="numpy").fate == Fate.VIGNETTED).mean()
    free = trace(prescribe(plain), lit(window), record=True, path="numpy")
    local = (free.hits[surfaces[0], :, :2] + 0.5 * PITCH) % PITCH - 0.5 * PITCH
    assert share_ended == pytest.approx((np.abs(local).max(axis=1) > 0.225).mean(), abs=1e-3)
    export(made, tmp_path / "out", formats=("mask",), progress=silent)
    assert len(list((tmp_path / "out").glob("*.svg"))) == 1


@pytest.mark.parametrize(
    ("kind", "face", "field"), [(PLATES, 1, 10.0), (PLATES, 3, 10.0), (PLATES, 6, 10.0), ("achromat", 3, 1.0)]
)
def test_pictures_lose_the_light_of_the_line_with_losses_and_by_paths_in_any_order(kind, face, field):
    """Passes over blocks and the non-sequential trace of the same rays agree on which rays end at the line."""
    window = prescribe(design(face, kind))
    rays = lit(window, np.radians(field), 1 << 11)
    plain = trace(window, rays, path="numpy")
    dark = plain.fate == Fate.VIGNETTED
    assert dark.any()
    light, seen = light_reaching_camera(window, rays, "surfaces", ("fresnel", "ghosts"), path="numpy")
    assert np.array_equal(seen.fate, plain.fate)
    assert not dark[light.parent].any()
    fast, quick = light_reaching_camera(window, rays, "surfaces", ("fresnel", "ghosts"), path="numba")
    assert np.array_equal(quick.fate, plain.fate)
    assert np.array_equal(fast.parent, light.parent)
    assert fast.flux == pytest.approx(light.flux, rel=1e-12)
    rows = np.flatnonzero(plain.fate <= Fate.VIGNETTED)
    out = trace_nonsequential(window, rays, rows, rules_for(window, Setting(), None))
    assert ((out.share["opaque"] > 0.5) == dark).mean() > 0.999
    down = mirrored(window)
    assert lined_array(down) == lined_array(window)
    assert lined_face(down).vertex[2] == -lined_face(window).vertex[2]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "face", "field"),
    [(PLATES, 1, 10.0), (PLATES, 6, 10.0), ("achromat", 3, 1.0), ("hexagonal", 2, 1.0)],
)
def test_the_compiled_kernel_ends_the_same_rays_at_the_line(kind, face, field):
    """The numbers of a record agree to rounding, on the joint and in hexagons, too."""
    window = prescribe(design(face, kind))
    rays = lit(window, np.radians(field), 1 << 12)
    one, other = (trace(window, rays, record=True, path=path) for path in ("numpy", "numba"))
    assert 0.01 < (one.fate == Fate.VIGNETTED).mean() < 0.1
    for name in ("fate", "surface", "cell", "order"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
    for name in ("position", "direction", "optical_path", "hits", "directions"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-12)


def test_a_reflected_path_ends_at_the_line_too():
    """Compiled split paths lose the light that meets the line on its way: none of them leaves there."""
    window, plain = prescribe(design(1)), prescribe(design(None))
    rays = lit(window, 0.0, 1 << 10)
    back = [
        light_reaching_camera(one, rays, "surfaces", ("fresnel", "reflections"), path="numba")[0]
        for one in (window, plain)
    ]
    assert back[0].flux.sum() < 0.97 * back[1].flux.sum()


@pytest.mark.parametrize(
    ("kind", "line", "says"),
    [
        ("three-plates-10deg", {"face": 1, "width": 0.5}, "leaves no lens"),
        ("three-plates-10deg", {"face": 7, "width": 0.01}, "face 7 of 6"),
        ("achromat", {"face": 5, "width": 0.01}, "no line can be printed on face 5|face 5 of 4"),
        ("slab", {"face": 3, "width": 0.01}, "no line can be printed on face 3"),
    ],
)
def test_lines_that_cannot_be_are_refused_with_the_reason(kind, line, says):
    with pytest.raises(DesignError, match=says):
        prescribe(load(kind, ["lattice.count = [3, 3]"]).replace({"lattice.line": line}))
