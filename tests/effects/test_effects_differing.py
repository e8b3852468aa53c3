"""Effects of non-uniform sheets: compared with uniform equivalents, with closed forms, and with conserved quantities."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.effects import Setting, light_reaching_camera, plan_effects
from clacad.effects.engine.camera_light import measure
from clacad.effects.engine.homogeneous_light import FAINT, orders
from clacad.effects.engine.nonsequential import Rules, trace_nonsequential
from clacad.effects.engine.probe_rays import situation_of_design, with_stand_ins
from clacad.effects.trace import trace
from clacad.optics.rays import Fate
from clacad.sheet.face_order import media_of
from clacad.sheet.like_cell import like_cell
from clacad.sheet.vignetting import aperture_slopes, ghost_step, thin_cells

BASE = {
    "format": 1, "name": "differing", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10, "material": "PMMA", "wavelength": 550, "offset": "paraxial"},
    "lattice": {"pitch": 0.5, "count": [41, 41]}, "check": {"process": "none", "field": "0.5 deg"},
}  # fmt: skip
KINDS = {
    "aimed": {"lattice.aperture": {"point": [-40, 10, -400]}},
    "other pitch": {"lattice.pitch_2": 0.497},
    "turned": {"lattice.rotation_2": "0.3 deg"},
    "varying": {"law.varying": {"f_image": 300}},
}
OWN_ETA = "an eta of its own"
EACH = ["aimed", *(pytest.param(kind, marks=pytest.mark.slow) for kind in KINDS if kind != "aimed")]
ALL = [*EACH, pytest.param(OWN_ETA, marks=pytest.mark.slow)]
"""Also a sheet in which light that meets a neighbour's lens 2 obeys no law: ghosts of the law are not for it."""
FOLDER = tempfile.TemporaryDirectory()
SETTING = Setting(extinction=1e-8, roughness=2e-9, slope_rms=1e-4, wavelengths=(450e-9, 650e-9))


def design_of(kind):
    if kind == OWN_ETA:
        return tabled_design(Path(FOLDER.name))
    return clacad.Design.from_dict(BASE).replace(KINDS[kind])


def tabled_design(folder):
    """41 x 41 cells, eta from -0.6 to -1.8 over the sheet."""
    cells = [(i, j) for i in range(41) for j in range(41)]
    rows = [
        f"{i},{j},{0.001 * (i - 20)!r},{-0.0005 * (j - 20)!r},{-0.6 - 0.015 * (i + j)!r}" for i, j in cells
    ]
    (folder / "cells.csv").write_text("\n".join(["i,j,delta_x,delta_y,eta", *rows]) + "\n")
    text = clacad.Design.from_dict(BASE).canonical_toml()
    (folder / "design.toml").write_text(text.replace("[law]\n", '[law]\nvarying = {table = "cells.csv"}\n'))
    return clacad.load(folder / "design.toml")


def built(kind):
    return clacad.prescribe(design_of(kind))


def rays_into(window, cell, count=300, spread=0.004, seed=1):
    rng = np.random.default_rng(seed)
    slope = aperture_slopes(window, cell[None])[0] + rng.uniform(-spread, spread, (count, 2))
    place = window.centres(0, cell) + rng.uniform(-0.15, 0.15, (count, 2))
    return clacad.Rays(
        np.column_stack([place - slope, np.full(count, -1.0)]), np.column_stack([slope, np.ones(count)])
    )


@pytest.mark.parametrize("name", ["fresnel", "absorption", "polarisation", "scatter", "diffraction"])
@pytest.mark.parametrize("rung", ["law", "thin", "surfaces"])
@pytest.mark.parametrize("kind", ALL)
def test_an_effect_changes_light_of_a_cell_as_of_a_sheet_of_cells_like_it(kind, rung, name):
    window, cell = built(kind), np.array([33, 6])
    like, rays = like_cell(window, cell, widest=False), rays_into(window, np.array([33, 6]))
    own, equal = (
        light_reaching_camera(one, rays, rung, (name,), SETTING, path="numpy") for one in (window, like)
    )
    both = (own[1].fate == Fate.ALIVE) & (equal[1].fate == Fate.ALIVE)
    assert both.mean() > 0.9
    # law and thin take a body's mean thickness over the sheet, and slits are as wide as cells 2 are, 2.5 % wider at most
    slack = 2e-4 if name == "absorption" and rung != "surfaces" else 1e-12
    plain = trace(window, rays, rung=rung, path="numpy").direction
    turned = 0.03 * np.abs(equal[1].direction - plain).max(axis=1) if name == "diffraction" else 0.0
    assert np.abs(own[1].flux / equal[1].flux - 1.0)[both].max() < slack
    away = np.abs(own[1].direction - equal[1].direction).max(axis=1)
    assert (away <= turned + 1e-12)[both].all()


@pytest.mark.parametrize("kind", ALL)
def test_light_split_at_lenses_goes_the_ways_of_a_sheet_of_cells_like_it(kind):
    window, cell = built(kind), np.array([20, 8])
    like, rays = like_cell(window, cell, widest=False), rays_into(window, cell, 60, 0.001)
    setting = replace(SETTING, order=1)
    own, equal = (
        light_reaching_camera(one, rays, "surfaces", ("reflections",), setting, path="numpy")[0]
        for one in (window, like)
    )
    flux, expected = (np.bincount(light.parent, light.flux, minlength=60) for light in (own, equal))
    slack = (
        1e-7 if kind == OWN_ETA else 1e-12
    )  # light sent back leaves by a neighbour, here of another radius
    assert np.median(np.abs(flux - expected)) < slack
    back, there = (light.direction[light.direction[:, 2] < 0.0] for light in (own, equal))
    assert len(back) >= 60
    assert abs(len(back) - len(there)) <= 6


@pytest.mark.ci_cases("aimed", "turned", "an eta of its own")
@pytest.mark.slow
@pytest.mark.parametrize("kind", ALL)
def test_no_light_is_lost_on_any_way_through_cells_that_differ(kind):
    window = built(kind)
    x0, x1, y0, y1 = window.lattice.extent()
    rng = np.random.default_rng(3)
    at = np.column_stack([rng.uniform(x0, x1, 400), rng.uniform(y0, y1, 400), np.full(400, -1.0)])
    rays = clacad.Rays(at, np.column_stack([rng.normal(0.0, 0.15, (400, 2)), np.ones(400)]))
    met = np.flatnonzero(trace(window, rays, path="numpy").fate < Fate.MISSED)
    rules = Rules(walls=True, total=True, losses=True, order=1, media=media_of(window.bodies))
    out = trace_nonsequential(window, rays, met, rules)
    total = sum(out.share.values())
    assert np.abs(total[met] - 1.0).max() < 1e-12
    assert out.share["forward"][met].mean() > 0.5


@pytest.mark.parametrize("kind", EACH)
def test_ghosts_of_the_law_lie_where_thin_lenses_send_them(kind):
    window, cell = built(kind), np.array([20, 20])
    rays = rays_into(window, cell, 4000, 0.09, seed=2)
    result = trace(window, rays, rung="thin", path="numpy")
    ghosts = (result.fate == Fate.GHOST) & (result.cell == cell).all(axis=1)
    found = {tuple(order) for order in result.order[ghosts].tolist()}
    assert len(found) >= 3
    cells = thin_cells(window)
    slopes = rays.direction[:, :2]
    index = np.tile(cell, (len(slopes), 1))
    assert found <= set(orders(cells, slopes, index))
    law = window.law_at(cell)
    for order in found:
        here = ghosts & (result.order == order).all(axis=1)
        straight = law.refract(rays.direction[here])
        expected = straight[:, :2] / straight[:, 2:] + ghost_step(cells, order, index[here])
        seen = result.direction[here]
        assert np.abs(seen[:, :2] / seen[:, 2:] - expected).max() < 1e-12


@pytest.mark.parametrize("kind", EACH)
def test_shares_of_all_orders_are_what_thin_lenses_let_through(kind):
    window = built(kind)
    rays = rays_into(window, np.array([30, 12]), 3000, 0.03, seed=4)
    light, _ = light_reaching_camera(window, rays, "law", ("ghosts",))
    flux = np.bincount(light.parent, light.flux, minlength=len(rays))
    # cells without seams: every ray meets some lens 2; corners of turned cells reach slivers of neighbours, which are not listed
    assert np.abs(flux - 1.0).max() < (2 * FAINT if kind == "turned" else 1e-9)
    traced = trace(window, rays, rung="thin", path="numpy")
    own, _ = light_reaching_camera(window, rays, "law", ())
    # in the mean over slopes the share is that of rays over one cell, but these start in the middle of it
    assert own.flux.sum() <= len(rays)
    assert (traced.fate <= Fate.GHOST).mean() > 0.99


@pytest.mark.slow
def test_a_plan_is_bounded_on_the_worst_of_cells_tried_and_says_so():
    design = design_of("aimed")
    plan = plan_effects(design)
    assert plan.tried >= 17
    assert f"in the worst of {plan.tried} cells tried" in plan.summary()
    assert plan.to_dict()["cells_tried"] == plan.tried
    assert "in cell (" in plan.row("diffraction").why
    uniform = plan_effects(design.replace({"lattice.aperture": "centred"}))
    assert uniform.tried == 0
    assert "cells_tried" not in uniform.to_dict()


@pytest.mark.ci_cases("turned", "an eta of its own")
@pytest.mark.slow
@pytest.mark.parametrize("kind", ALL)
def test_what_an_effect_changes_in_the_whole_sheet_is_within_the_bound_of_its_worst_cell(kind):
    from clacad.effects import declared
    from clacad.effects.engine.probe_rays import worst_bound

    situation = with_stand_ins(replace(situation_of_design(design_of(kind)), setting=SETTING))
    for name in (
        "ghosts",
        "fresnel",
        "absorption",
        "dispersion",
        "diffraction",
        "scatter",
        "reflections",
        "walls",
    ):
        bound = worst_bound(situation, declared(name))
        angle, radiance = measure(situation, declared(name))
        assert angle <= 1.05 * bound.angle, name
        assert radiance <= 1.05 * bound.radiance + 1e-12, name
