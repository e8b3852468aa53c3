"""Random sheets with random light on them, for judging the planner's bounds."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from clacad import Design, DesignError, prescribe
from clacad.effects.engine.effect import Setting
from clacad.effects.engine.probe_rays import situation_of_window
from clacad.optics.material.catalogue import find

MATERIALS = ("PMMA", "polycarbonate", "polystyrene", "N-BK7", "fused silica")
D65 = tuple(1e-9 * (430.0 + 27.5 * k) for k in range(9))
RAYS = 1024


def draw(seed):
    """A situation and the words that describe it, or None where the numbers make no sheet."""
    rng = np.random.default_rng(seed)
    form = rng.choice(["biconvex", "slab", "plano"])
    eta = [-math.exp(rng.uniform(math.log(0.25), math.log(3.0))) for _ in range(2)]
    ratio = math.exp(rng.uniform(math.log(6.0), math.log(60.0)))
    pitch = math.exp(rng.uniform(math.log(0.2), math.log(5.0)))
    data = {
        "format": 1, "name": "random", "unit": "mm",
        "law": {"eta": eta, "delta": list(rng.normal(0, 0.01, 2)),
                "euler": [float(rng.uniform(0, 90)), float(rng.choice([0.0, 0.5])), 0.0]},
        "pair": {"form": str(form), "separation": pitch * ratio, "thickness": "auto",
                 "material": str(rng.choice(MATERIALS))},
        "lattice": {"kind": str(rng.choice(["square", "hexagonal"])), "pitch": pitch, "count": [60, 60]},
    }  # fmt: skip
    if form == "slab":
        data["pair"].pop("thickness")
    try:
        window = prescribe(Design.from_dict(data))
    except DesignError:
        return None
    setting = Setting(
        wavelengths=D65 if rng.random() < 0.7 else (),
        extinction=float(10 ** rng.uniform(-9, -6)),
        roughness=float(rng.choice([0.0, 10 ** rng.uniform(-9.5, -7.5)])),
        slope_rms=float(rng.choice([0.0, 10 ** rng.uniform(-5, -2.5)])),
        coating=str(rng.choice(["none", "quarter-wave"])),
        aperture=float(rng.choice([0.0, pitch])),
        focus=500.0,
    )
    if setting.wavelengths and not known(window, setting.wavelengths):
        return None
    onset = 1.0 / ratio
    field = math.atan(onset * math.exp(rng.uniform(math.log(0.02), math.log(2.0))))
    situation = situation_of_window(window, setting, 1e-3, 0.01, field)
    rays = replace_rays(situation.rays)
    situation = replace(situation, rays=rays, contrast=float(rng.uniform(1, 5)), front=float(rng.uniform(0, 1)),
                        near=float(rng.uniform(100, 1000)), far=float(rng.uniform(1000, 1e5)))  # fmt: skip
    words = f"{form} eta ({eta[0]:.2f}, {eta[1]:.2f}) s/p {ratio:.0f} p {pitch:.2g} mm field {math.degrees(field):.2g} deg"
    return situation, words


def replace_rays(rays):
    """Every few rays of a bundle, so that the probe stays small."""
    from clacad.optics.rays import Rays

    step = max(1, len(rays) // RAYS)
    return Rays(rays.position[::step], rays.direction[::step])


def fresh(situation):
    """The same light once more, with other rays than the probe's: what a picture would be made of."""
    from clacad.effects.engine.probe_rays import cone
    from clacad.optics.rays import Rays

    field = math.atan(float(np.hypot(*(situation.rays.direction[:, :2] - centre(situation)).T).max()))
    rays = cone(situation.window, field, 3 * RAYS)
    return replace(situation, rays=Rays(rays.position[RAYS:], rays.direction[RAYS:]))


def centre(situation):
    """Slope in the middle of the field."""
    from clacad.sheet.vignetting import aperture_slope

    return np.array(aperture_slope(situation.window))


def known(window, wavelengths):
    """Whether the material is known at all wavelengths."""
    try:
        for body in window.bodies:
            for wave in wavelengths:
                body.index_at(wave)
    except ValueError:
        return False
    return find("PMMA") is not None
