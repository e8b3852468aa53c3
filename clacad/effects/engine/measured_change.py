"""What an effect changes, measured: the scene's probe rays traced with it and without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clacad.base.types import Floats
from clacad.effects.engine.bounds import Situation
from clacad.effects.engine.camera_light import light_reaching_camera
from clacad.effects.engine.light_rays import LightRays
from clacad.effects.engine.passes import trace_with
from clacad.optics.law.angle import angle_between
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.tracing.trace import trace

MOST = 0.99
"""Share of the light whose largest turn is meant."""


def measure(situation: Situation, name: str) -> tuple[float, float]:
    """Change of direction (radians) and of radiance (relative) that an effect makes.

    Parameters
    ----------
    name : str

    Returns
    -------
    angle : float
        Dispersion: the largest of 99 % of the light (a few rays at borders change lenslets without changing order);
        depth of field: the largest; scatter, facets: rms; diffraction: the angle that holds half of the light.
    radiance : float
        Mean over the rays on the sheet of the light that is added or taken; light sent elsewhere by reflection
        counts with the contrast and brightness of what it then shows.
    """
    measures = {
        "dispersion": _dispersion, "diffraction": _diffraction, "scatter": _scatter, "facets": _facets,
        "depth_of_field": _depth, "reflections": _reflections, "polarisation": _polarisation,
    }  # fmt: skip
    return measures[name](situation) if name in measures else (0.0, _radiance(situation, name))


def _radiance(situation: Situation, name: str) -> float:
    return _flux_change(situation, _light(situation), _light(situation, name))


def _traced(situation: Situation, *names: str) -> TraceResult:
    """The probe rays with these effects, by exact surfaces; the same bits whatever ran before."""
    window, rays = situation.window, situation.rays
    return trace_with(window, rays, "surfaces", names, setting=situation.setting, path="size")


def _light(situation: Situation, *names: str) -> LightRays:
    """The light that reaches the camera so."""
    window, rays = situation.window, situation.rays
    return light_reaching_camera(window, rays, "surfaces", names, situation.setting, path="size")[0]


def _flux_change(situation: Situation, base: LightRays, more: LightRays) -> float:
    n = len(situation.rays)
    before, after = (np.bincount(light.parent, weights=light.flux, minlength=n) for light in (base, more))
    return float(np.abs(after - before)[situation.met].mean())


def _reflections(situation: Situation) -> tuple[float, float]:
    extra, own = _light(situation, "reflections"), _light(situation, "fresnel")
    n = max(len(situation.met), 1)
    back = extra.direction[:, 2] < 0.0
    front = float(extra.flux[back].sum()) / n
    forward = (float(extra.flux[~back].sum()) - float(own.flux.sum())) / n
    return 0.0, forward * situation.contrast + front * situation.front


def _dispersion(situation: Situation) -> tuple[float, float]:
    base, worst = _traced(situation), 0.0
    for wave in situation.wavelengths:
        waves = np.full(len(situation.rays), wave)
        other = trace(
            situation.window, Rays(situation.rays.position, situation.rays.direction, waves), path="size"
        )
        turned = angles(base, other, Fate.GHOST)
        worst = max(worst, float(np.quantile(turned, MOST)) if len(turned) else 0.0)
    return worst, 0.0


def _diffraction(situation: Situation) -> tuple[float, float]:
    return float(np.median(_turned(situation, "diffraction"))), 0.0


def _scatter(situation: Situation) -> tuple[float, float]:
    turned = _turned(situation, "scatter")
    return float(np.sqrt(np.mean(turned**2))), _radiance(situation, "scatter")


def _polarisation(situation: Situation) -> tuple[float, float]:
    plain, own = _traced(situation, "fresnel"), _traced(situation, "polarisation")
    passing = plain.fate <= Fate.LAND
    if not passing.any():
        return 0.0, 0.0
    return 0.0, float(np.quantile(np.abs(own.flux[passing] - plain.flux[passing]), MOST))


def _facets(situation: Situation) -> tuple[float, float]:
    turned = angles(_traced(situation), _traced(situation, "facets"), Fate.ALIVE)
    return float(np.sqrt(np.mean(turned**2))) if len(turned) else 0.0, 0.0


def _depth(situation: Situation) -> tuple[float, float]:
    """Largest angle (radians) by which a camera's opening blurs what is nearest and farthest; no change of radiance."""
    from clacad.effects.depth_of_field import effect

    setting, rays = situation.setting, situation.rays
    launch = effect(situation.window, replace(setting, aperture=setting.aperture)).launch
    assert launch is not None
    moved = launch(situation.window, rays)
    axis = np.array(setting.axis)
    worst = 0.0
    for depth in (situation.near, min(situation.far, 1e9 * setting.focus)):
        places = []
        for bundle in (rays, moved):
            reach = (depth - (bundle.position - rays.position) @ axis) / (bundle.direction @ axis)
            places.append(bundle.position + reach[:, None] * bundle.direction)
        worst = max(
            worst, 2.0 * float(np.linalg.norm(places[1] - places[0], axis=1).max(initial=0.0)) / depth
        )
    return worst, 0.0


def _turned(situation: Situation, name: str) -> Floats:
    turned = angles(_traced(situation), _traced(situation, name), Fate.GHOST)
    return turned if len(turned) else np.zeros(1)


def angles(a: TraceResult, b: TraceResult, last: Fate) -> Floats:
    """Angles (k,), radians, between exit directions of rays that both traces let pass with the same fate and order."""
    same = (a.fate <= last) & (a.fate == b.fate) & (a.order == b.order).all(axis=1)
    return angle_between(a.direction[same], b.direction[same])
