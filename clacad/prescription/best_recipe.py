"""Recipe "best": gives up exact confocality on the axis for the least rms error over the field.

The one unknown of `clacad.optics.fit` is a common scale of all principal radii, at the requested separation,
because spherical aberration moves best focus inward. The residuals are those of traced rays to the law over
the bundle of the checks, restricted to rays that reach the partner's cell through the initial pair. With the
separation as a second unknown there is no minimum. Scaling radii and separation together keeps the pair
confocal while aberration falls with the cube of pitch/separation. A search over both runs away (to 175 times
the requested separation for the paper's sheet).

Residual of a recipe: law error and decollimation of a built window along its axis ray.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from math import inf

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.design.asked_cells import cell_laws, cut_across
from clacad.design.sections import AimedAt
from clacad.optics.fit import AskedLight, law_residuals, minimise
from clacad.optics.law import angle_between
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import STEP, parabasal, trace_sequence
from clacad.prescription.bodies import shallower
from clacad.prescription.cell_heights import window_range
from clacad.prescription.intent import Intent, untraced
from clacad.sheet.bundle import RequestedLaw, asked_power, bundle
from clacad.sheet.like_cell import interfaces, like_cell
from clacad.sheet.window import Window

RAYS = 4096


def best_scale(intent: Intent, build: Callable[[Intent, float], Window]) -> Window:
    """Build with the scale of the radii of least rms law error where "best" is requested, else with 1.

    On a non-uniform sheet the scale is that for the light of the middle cell; the cells are then built with
    it.

    build : Intent and scale of the radii → Window.
    Returns: Recipe "best" records the scale and the rms error before and after (radians).
    """
    pair = intent.design.pair
    if pair.given or pair.confocal != "best":
        return build(intent, 1.0)
    middle = _of_middle(intent)

    def built(scale: float) -> Window:
        window = build(middle, scale)
        cells = window.lattice.cells()
        return like_cell(window, cells[len(cells) // 2])

    start = built(1.0)
    light = _light(middle, start)

    def residuals(scale: Floats) -> Floats:
        return law_residuals(interfaces(built(float(scale[0]))), light)

    scale = float(minimise(residuals, np.ones(1))[0])
    end = built(scale)
    left = {
        "confocal": "best",
        "scale": scale,
        "law_rms_start": float(np.linalg.norm(law_residuals(interfaces(start), light))),
        "law_rms_end": float(np.linalg.norm(law_residuals(interfaces(end), light))),
    }
    alike = middle is intent and not cut_across(intent.design)
    window = end if alike else build(intent, scale)
    return replace(window, recipe={**window.recipe, **left})


def _of_middle(intent: Intent) -> Intent:
    """Intent whose cells are all the middle one, with lenses placed paraxially; that of a uniform sheet
    itself.
    """
    design = intent.design
    aperture, lattice = design.lattice.aperture, design.lattice
    aims = isinstance(aperture, AimedAt)
    if not (aims or design.law_spec.varying or lattice.pitch_2 or lattice.rotation_2):
        return intent
    if isinstance(aperture, AimedAt):
        x, y, z = aperture.point
        aperture = x / z + 0.0, y / z + 0.0
    lattice = replace(lattice, aperture=aperture, pitch_2=None, rotation_2=0.0)
    alike = replace(design, law_spec=replace(design.law_spec, varying=None), lattice=lattice)
    return untraced(replace(intent, design=alike, laws=cell_laws(alike)))


def _light(intent: Intent, window: Window) -> AskedLight:
    """Bundle of the checks over one cell: the same rays, and the same lens, for any number of cells."""
    one = window.with_cells((1, 1))
    one = replace(one, z_range=window_range(one))  # the rays start below it
    check = intent.design.check
    lit = bundle(one, RAYS, check.field, check.field_centre)
    rays, expected = lit.rays, RequestedLaw.of(window).expected(lit)
    kept = _to_partner(window, rays)
    if kept.any():
        rays, expected = Rays(rays.position[kept], rays.direction[kept]), expected[kept]
    return AskedLight.of(rays, expected)


def _to_partner(window: Window, rays: Rays) -> Bools:
    """Which rays (n,) reach the partner's cell."""
    seen = trace_sequence(interfaces(window), rays)
    local = seen.position[:, :2] - np.asarray(window.shifts[1])
    good = seen.fate == Fate.ALIVE
    for step, half in zip(window.lattice.steps, window.lattice.half_widths, strict=True):
        good &= local @ np.asarray(window.lattice.offset(*step)) <= 2.0 * half * half
    return np.asarray(good)


class Residual(Mapping[str, float]):
    """Residual of a window along its axis ray: traced when it is first read, because few callers read it."""

    def __init__(self, window: Window) -> None:
        self._window = window

    @cached_property
    def _traced(self) -> dict[str, float]:
        return residual(self._window)

    def __getitem__(self, name: str) -> float:
        return self._traced[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._traced)

    def __len__(self) -> int:
        return len(self._traced)

    def __repr__(self) -> str:
        return repr(self._traced)


def residual(window: Window) -> dict[str, float]:
    """Parabasal law error (radians) and decollimation over half a cell (radians) of a window, minus requested
    power.

    Returns: Both are infinite where the axis ray is lost.
    """
    rotation = window.thin.rotation
    asked = window.law.refract(rotation[:, 2][None])[0]
    size = STEP * window.lattice.circumradius
    found = parabasal(interfaces(window), rotation, _entry(window), size)
    if not (np.isfinite(found.direction).all() and np.isfinite(found.cosines).all()):
        # the axis ray misses a lens or is totally reflected:
        # the window is built and fails its checks, no error here
        return {"law": inf, "decollimation": inf}
    half = 0.5 * max(window.lattice.pitch)
    return {
        "law": float(angle_between(found.direction, asked)),
        "decollimation": float(np.linalg.norm(found.cosines + np.diag(asked_power(window)), 2)) * half,
    }


def _entry(window: Window) -> Floats:
    """Point of the axis ray before the window, sheet frame."""
    if window.recipe["curved"] == "inside":
        glass = shallower(window.law, window.bodies[0].index)[:, 2]
        plane = window.bodies[0].front.vertex[2]
        return np.asarray(glass * (plane / glass[2]))
    return np.zeros(3)
