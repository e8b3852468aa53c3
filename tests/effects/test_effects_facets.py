"""The effect "facets": a mesh in place of the surfaces; and light lost on the way against light lost afterwards."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from clacad import load, prescribe, tessellate
from clacad.effects import Setting, plan_effects, trace_with
from clacad.effects.engine.probe_rays import cone
from clacad.effects.facets import forecast
from clacad.effects.trace import trace
from clacad.optics.rays import Fate
from clacad.scene import load_scene

DESIGNS = Path(__file__).parents[2] / "designs"


@cache
def window(name):
    return prescribe(load(str(DESIGNS / f"{name}.toml")).with_cells((9, 9)))


def turned(name, quads, half=0.005):
    """Rms angle by which facets turn light that both rungs let through."""
    sheet = window(name)
    rays = cone(sheet, half, 8192)
    exact = trace(sheet, rays)
    faceted = trace_with(sheet, rays, "surfaces", ("facets",), setting=Setting(quads=quads))
    both = (exact.fate == Fate.ALIVE) & (faceted.fate == Fate.ALIVE)
    assert both.mean() > 0.5
    apart = np.linalg.norm(exact.direction[both] - faceted.direction[both], axis=1)
    return math.sqrt(float((apart**2).mean()))


@pytest.mark.ci_cases("8-slab", "8-galilean", "16-plano")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper-a-covered", "slab", "plano", "galilean"])
@pytest.mark.parametrize("quads", [8, 16])
def test_facets_turn_light_by_what_is_forecast_and_never_much_more(name, quads):
    measured, bound = turned(name, quads), forecast(window(name), quads)
    assert measured <= 1.1 * bound
    assert measured >= 0.5 * bound  # no bound is worth much that is never approached


@pytest.mark.slow
def test_half_the_facets_size_turns_light_half_as_much():
    coarse, fine = turned("slab", 8), turned("slab", 32)
    assert coarse / fine == pytest.approx(4.0, rel=0.25)


@pytest.mark.slow
def test_the_effect_is_rung_mesh_itself():
    sheet, setting = window("slab"), Setting(quads=8)
    rays = cone(sheet, 0.01, 2000)
    one = trace_with(sheet, rays, "surfaces", ("facets",), setting=setting)
    other = trace(sheet, rays, "mesh", mesh=tessellate(sheet, quads=8))
    for column in ("position", "direction", "fate", "optical_path", "cell", "order", "surface", "flux"):
        assert np.array_equal(getattr(one, column), getattr(other, column))


@pytest.mark.slow
def test_losses_come_on_top_of_facets():
    sheet, rays = window("slab"), cone(window("slab"), 0.01, 2000)
    both = trace_with(sheet, rays, "surfaces", ("facets", "fresnel"), setting=Setting(quads=8))
    alone = trace_with(sheet, rays, "surfaces", ("fresnel",))
    alive = (both.fate == Fate.ALIVE) & (alone.fate == Fate.ALIVE)
    assert np.abs(both.flux[alive] - alone.flux[alive]).max() < 5e-3
    assert (both.flux[alive] < 0.95).all()


def test_a_plan_has_facets_on_where_the_scene_asks_for_the_mesh_and_only_there():
    scene = DESIGNS / "scenes" / "effects-narrow.toml"
    for rung, state in (("surfaces", "off"), ("mesh", "on")):
        plan = plan_effects(load_scene(scene, overrides=[f'sheet.rung="{rung}"']))
        row = plan.row("facets")
        assert plan.rung == rung
        assert row.state == state
        assert row.angle > 0.0
        assert "quads" in row.why
        assert ("facets" in plan.names) == (rung == "mesh")
        for path in (
            "walls",
            "tir_paths",
            "reflections",
        ):  # effects that are not computed on facets are reported
            assert ("not the facets" in plan.row(path).why) == (rung == "mesh")


# -- losses ------------------------------------------------------------------------------------


@pytest.mark.parametrize("effects", [("fresnel",), ("absorption",), ("fresnel", "absorption", "ghosts")])
@pytest.mark.parametrize("name", ["paper-a-covered", "tilted-seam", "tilted-biconvex", "hexagonal"])
def test_light_lost_is_the_same_counted_on_the_way_or_afterwards(name, effects):
    """With hits recorded the passes over them count; without, the compiled tracer does on its way."""
    sheet, setting = window(name), Setting(extinction=1e-7)
    rays = cone(sheet, math.radians(4), 4000)
    way = trace_with(sheet, rays, "surfaces", effects, setting=setting, path="numba")
    after = trace_with(sheet, rays, "surfaces", effects, record=True, setting=setting, path="numba")
    assert np.array_equal(way.fate, after.fate)
    assert len(set(way.fate.tolist())) > 2
    np.testing.assert_allclose(way.flux, after.flux, rtol=1e-13)
