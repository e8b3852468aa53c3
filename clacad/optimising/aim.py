"""What a search makes small: the error over one field or several, of the perfect part or of parts as they are made.

Made parts: to first order an error e of a part, of standard deviation σ, adds σ² |∂r/∂e|² to the expected square of the
residuals r. So the slopes that `clacad.verification.tolerance` gives every tolerance of the design, times σ, stand below
the residuals of the perfect part, and least squares find the least expected error of both together; they are central
differences over ±σ. Roughness moves no direction, and is left out. What turns or tilts an array
is taken at the cell farthest from the middle, where it does most; everything else does the same to all cells.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import isfinite, sqrt

import numpy as np

from clacad.base.types import Floats
from clacad.config.design_error import DesignError
from clacad.config.mistakes import Mistake
from clacad.config.value_kinds import shown
from clacad.design import Design
from clacad.optics.fit import AskedLight, law_residuals
from clacad.optics.rays import Fate, Rays
from clacad.sheet.bundle import bundle
from clacad.sheet.telescopelet import interfaces
from clacad.sheet.window import Window
from clacad.verification.tolerance import Parameter, parameters, telescopelet
from clacad.verification.tolerance.light_measures import places
from clacad.verification.tolerance.perturbations import SIGMAS
from clacad.verification.tolerance.study import NO_TOLERANCES, NoTolerances

RAYS = 1024
"""Rays of a search, for each field."""

FEW = 256
"""Of them those that slopes of tolerances are taken with: a slope changes slowly over the cell."""

LARGEST_PART = 4.0
"""Largest part of the field that may have a weight."""

Weights = tuple[tuple[float, float], ...]
"""(part of the field, weight) of every cone of rays."""

WHOLE: Weights = ((1.0, 1.0),)


@dataclass(frozen=True)
class Aim:
    """What is asked of a search.

    field : radians
        Half angle of the cone of rays.
    weights : tuple of (part of the field, weight)
        Cones of rays, and how much the square of each one's error counts.
    tolerances : bool
        Whether parts as made are meant, with the [tolerances] of the design.
    """

    field: float
    weights: Weights = WHOLE
    tolerances: bool = False

    def __post_init__(self) -> None:
        for part, weight in self.weights:
            if not (0.0 < part <= LARGEST_PART and 0.0 < weight and isfinite(weight)):
                raise DesignError([Mistake("CL106", f"weight {shown(weight)} of {shown(part)} of the field", "weights", allowed=(
                    f"part:weight, the part from above 0 to {LARGEST_PART:g}, the weight above 0"), hint=".5:1,1:1")])  # fmt: skip
        if not self.weights or len({part for part, _ in self.weights}) < len(self.weights):
            raise DesignError([Mistake("CL106", "every part of the field has one weight", "weights", allowed=".5:1,1:1")])  # fmt: skip


@dataclass(frozen=True, eq=False)
class AimedRays:
    """An aim at a design: the rays, and what may go wrong.

    lights : tuple of (AskedLight, root of its share of the weights)
    errors : tuple of (Parameter, σ, centre (2,) of the cell it is looked at in)
    few : AskedLight
        The rays that slopes of tolerances are taken with: of the cone of largest weight.
    """

    lights: tuple[tuple[AskedLight, float], ...]
    errors: tuple[tuple[Parameter, float, Floats], ...]
    few: AskedLight

    @staticmethod
    def of(aim: Aim, design: Design, window: Window) -> AimedRays:
        """The target of an aim at a design whose window, to start from, is built.

        Raises
        ------
        DesignError
            No light of a field reaches its partner cell.
        NoTolerances
            The design states none, and made parts are asked for.
        """
        total = sum(weight for _, weight in aim.weights)
        lights = tuple(
            (kept_light(window, part * aim.field, design), sqrt(weight / total))
            for part, weight in aim.weights
        )
        most = max(lights, key=lambda pair: pair[1])[0]
        step = max(1, len(most.asked) // FEW)
        few = replace(
            most,
            rays=Rays(most.rays.position[::step], most.rays.direction[::step]),
            asked=most.asked[::step],
        )
        return AimedRays(lights, tuple(_errors(design, window)) if aim.tolerances else (), few)

    def residuals(self, trial: Window) -> Floats:
        """Residuals (m,) of a trial, radians: their sum of squares is the expected mean square error."""
        faces = interfaces(trial)
        parts = [share * law_residuals(faces, light) for light, share in self.lights]
        return np.concatenate([*parts, *(self._slope(trial, *error) for error in self.errors)])

    def _slope(self, trial: Window, error: Parameter, sigma: float, place: Floats) -> Floats:
        """Half the change of the residuals between an error of +σ and of −σ."""
        ends = []
        for size in (sigma, -sigma):
            made = telescopelet(trial, {error.name: size}, place)
            ends.append(law_residuals(made.seq, self._beside(error.name, size)))
        return np.asarray(0.5 * (ends[0] - ends[1]))

    def _beside(self, name: str, size: float) -> AskedLight:
        """The rays, which come over cell 1 wherever it stands."""
        if not name.startswith("decentre.1."):
            return self.few
        aside = size * np.array([name.endswith("x"), name.endswith("y"), 0.0])
        rays = self.few.rays
        return replace(self.few, rays=Rays(rays.position + aside, rays.direction))


def _errors(design: Design, window: Window) -> Iterator[tuple[Parameter, float, Floats]]:
    """What may go wrong by how much (standard deviation), and the cell in which it is looked at."""
    of_sigma = SIGMAS if design.tolerances.distribution == "normal" else sqrt(3.0)
    stated = [error for error in parameters(design, window) if not error.one_sided]
    if not stated:
        raise NoTolerances(NO_TOLERANCES)
    cells = places(window)
    far = cells[int(np.argmax((cells**2).sum(axis=1)))]
    for error in stated:
        yield error, error.half / of_sigma, far if error.key in ("rotation", "tilt") else cells[0]


def kept_light(window: Window, field: float, design: Design) -> AskedLight:
    """The rays of a search: those of a cell and a cone that reach the partner cell through ideal lenses."""
    from clacad.tracing.trace import trace

    one = window.with_cells((1, 1))
    rays = bundle(one, RAYS, field, design.check.field_centre).rays
    ideal = trace(one, rays, rung="thin", path="numpy")
    kept = (ideal.fate == Fate.ALIVE) & (ideal.order == 0).all(axis=1)
    if not kept.any():
        raise DesignError([
            Mistake("CL120", "no light of the field reaches its partner cell through ideal lenses", "check.field",
                    allowed="a cone inside the field of view", hint="lattice.aperture aims it")
        ])  # fmt: skip
    chosen_rays = Rays(rays.position[kept], rays.direction[kept])
    return AskedLight.of(chosen_rays, window.law.refract(chosen_rays.direction))
