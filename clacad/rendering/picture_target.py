"""Rendering within a requested direction error: the cheapest rung, or the coarsest facets, that meets it."""

from __future__ import annotations

from typing import cast

import numpy as np

from clacad.base.types import Rung
from clacad.design import Design
from clacad.effects.engine.bounds import Situation
from clacad.effects.engine.cheapest_rung import rms_angle
from clacad.effects.engine.probe_rays import situation_of_scene
from clacad.exporting.formats.indexed_meshes import THREEMF
from clacad.optics.rays import Fate
from clacad.prescription.prescribe import prescribe
from clacad.scene import Scene
from clacad.sheet.window import Window
from clacad.storage.errors import BadRequest
from clacad.tracing.worst_cell import worst_cell
from clacad.verification.accuracy.choose_setting import facets_for
from clacad.verification.accuracy.error_and_seconds import MOST_DISAGREEMENT, TargetOutOfReach

MOST_QUADS = 256
"""Finest facets that a scene file may request."""


def within_target(scene: Scene, target: float) -> Scene:
    """Choose how rays pass the sheet so that they leave within a target of the exact surfaces.

    Rung auto takes the cheapest rung within it on the scene's own rays, and only effects that turn light by
    more. Rung mesh takes the coarsest facets. Any other rung is measured and rejected if its error is larger.

    Parameters
    ----------
    scene : Scene
    target : float, radians
        Rms direction error.

    Raises
    ------
    BadRequest
        The scene has several sheets.
    TargetOutOfReach
        The error of the scene's rung, or its mesh file, is larger; the message gives it and a rung that meets
        the target.
    """
    if len(scene.sheets) > 1:
        raise BadRequest(
            "a target chooses how rays pass one sheet, and the scene has several: give each its own rung, [[sheet]] rung"
        )
    chosen = scene.replace({"effects.angle": f"{1e3 * target!r} mrad"})
    rung = chosen.sheet.rung
    if rung in ("auto", "surfaces"):
        return chosen
    still = chosen.at(0) if chosen.animation is not None else chosen
    design = still.design()
    window = prescribe(design)
    if rung == "mesh" and still.sheet.mesh is None:
        return chosen.replace({"sheet.quads": _quads_within(design, window, target)})
    situation = situation_of_scene(still, window)
    mesh = still.file(still.sheet.mesh) if still.sheet.mesh else None
    error, disagree = _compared(situation, cast("Rung", rung), mesh)
    if error > target or disagree > MOST_DISAGREEMENT:
        raise TargetOutOfReach(
            f"rung {rung} is {1e3 * error:.4g} mrad rms off the exact surfaces on this scene's rays and sends "
            f"{disagree:.2%} of them another way; {1e3 * target:.4g} mrad and {MOST_DISAGREEMENT:.0%} are allowed: use "
            "rung surfaces, or auto"
        )
    return chosen


def _quads_within(design: Design, window: Window, target: float) -> int:
    """Coarsest quads a cell side whose facets keep directions within the target (radians), in the worst cell."""
    facets = facets_for(design, worst_cell(window, design.check.field).buildable, target, (THREEMF,))
    assert facets is not None
    if facets.quads > MOST_QUADS:
        raise TargetOutOfReach(
            f"{1e3 * target:.4g} mrad takes {facets.quads} quads a cell side, more than {MOST_QUADS}; "
            "use rung surfaces"
        )
    return facets.quads


def _compared(situation: Situation, rung: Rung, mesh: str | None) -> tuple[float, float]:
    """Rms angle to the exact surfaces over the scene's rays that are alive on both, and the share of other
    fates.
    """
    from clacad.tracing.trace import trace

    if not len(situation.rays):
        return 0.0, 0.0
    found = trace(situation.window, situation.rays, rung, mesh=mesh, path="size")
    truth = situation.probe
    both = (truth.fate == Fate.ALIVE) & (found.fate == Fate.ALIVE)
    return rms_angle(truth.direction[both], found.direction[both]), float(np.mean(truth.fate != found.fate))
