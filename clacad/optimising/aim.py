"""Objective of a search: the error over one field or several, of the perfect part or of parts as made.

Parts as made: to first order an error e of a part, of standard deviation σ, adds σ² |∂r/∂e|² to the expected
square of the residuals r. The slopes of `clacad.verification.tolerance` for every tolerance of the design,
times σ, are therefore appended to the residuals of the perfect part. Least squares then minimise the expected
error. The slopes are central differences over ±σ. Roughness changes no direction and is left out. Rotation
and tilt of an array are evaluated at the cell farthest from the centre, where their effect is largest; other
errors affect all cells equally.

Errors over independent rays, not those of the search, for the comparison of start and end.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import degrees, isfinite, sqrt

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats
from clacad.config.design_error import DesignError
from clacad.config.mistakes import Mistake
from clacad.config.value_kinds import shown
from clacad.design import Design
from clacad.design.keys import CHECK
from clacad.light.measure import measure
from clacad.optics.fit import AskedLight, law_residuals
from clacad.optics.rays import Fate, Rays
from clacad.sheet.asked_focus import RequestedLaw
from clacad.sheet.bundle import bundle, cone, launched, middle_direction
from clacad.sheet.representative_cells import central_cell, places_of_errors
from clacad.sheet.telescopelet import interfaces
from clacad.sheet.window import Window
from clacad.verification.tolerance import Parameter, parameters, telescopelet
from clacad.verification.tolerance.perturbations import SIGMAS
from clacad.verification.tolerance.study import NO_TOLERANCES, NoTolerances

RAYS = 1024
"""Number of rays of a search, for each field."""

FEW = 256
"""Number of these rays used for the slopes of tolerances, which change slowly over the cell."""

FEWEST = 4
"""Least number of remaining rays per unknown; with fewer, the faces fit the rays instead of the field."""

SMALLEST = 1e-3
"""Smallest share of a field that is searched for enough light."""

LARGEST_PART = 4.0
"""Largest part of the field that may have a weight."""

Weights = tuple[tuple[float, float], ...]
"""(part of the field, weight) of every cone of rays."""

WHOLE: Weights = ((1.0, 1.0),)


@dataclass(frozen=True)
class Aim:
    """Objective of a search, as requested.

    field : radians
        Half angle of the cone of rays.
    weights : tuple of (part of the field, weight)
        Cones of rays, and the weight of the square of each cone's error.
    tolerances : bool
        Whether the objective is that of parts as made, with the [tolerances] of the design.
    """

    field: float
    weights: Weights = WHOLE
    tolerances: bool = False

    def __post_init__(self) -> None:
        for part, weight in self.weights:
            if not (0.0 < part <= LARGEST_PART and 0.0 < weight and isfinite(weight)):
                raise DesignError(
                    [
                        Mistake(
                            "CL106",
                            f"weight {shown(weight)} of {shown(part)} of the field",
                            "weights",
                            allowed=(
                                f"part:weight, the part from above 0 to {LARGEST_PART:g}, the weight above 0"
                            ),
                            hint=".5:1,1:1",
                        )
                    ]
                )
        if not self.weights or len({part for part, _ in self.weights}) < len(self.weights):
            raise DesignError(
                [Mistake("CL106", "every part of the field has one weight", "weights", allowed=".5:1,1:1")]
            )


@dataclass(frozen=True, eq=False)
class AimedRays:
    """Objective of a search for one design: the rays and the errors of parts as made.

    lights : tuple of (AskedLight, root of its share of the weights)
    errors : tuple of (Parameter, σ, centre (2,) of the cell in which it is evaluated)
    few : AskedLight
        Rays for the slopes of tolerances, from the cone of largest weight.
    """

    lights: tuple[tuple[AskedLight, float], ...]
    errors: tuple[tuple[Parameter, float, Floats], ...]
    few: AskedLight

    @staticmethod
    def of(aim: Aim, design: Design, window: Window, unknowns: int = 1) -> AimedRays:
        """Objective for a design, its built start window and the number of unknowns.

        Raises
        ------
        DesignError
            Of a field too little light reaches its partner cell to fix the unknowns.
        NoTolerances
            The design states no tolerances, and parts as made are requested.
        """
        total = sum(weight for _, weight in aim.weights)
        lights = tuple(
            (kept_light(window, part * aim.field, design, FEWEST * unknowns), sqrt(weight / total))
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
        """Rays over cell 1 at its displaced position."""
        if not name.startswith("decentre.1."):
            return self.few
        aside = size * np.array([name.endswith("x"), name.endswith("y"), 0.0])
        rays = self.few.rays
        return replace(self.few, rays=Rays(rays.position + aside, rays.direction))


def _errors(design: Design, window: Window) -> Iterator[tuple[Parameter, float, Floats]]:
    """Errors of parts as made, their standard deviations, and the cells in which they are evaluated."""
    of_sigma = SIGMAS if design.tolerances.distribution == "normal" else sqrt(3.0)
    stated = [error for error in parameters(design, window) if not error.one_sided]
    if not stated:
        raise NoTolerances(NO_TOLERANCES)
    cells = places_of_errors(window)
    far = cells[int(np.argmax((cells**2).sum(axis=1)))]
    for error in stated:
        yield error, error.half / of_sigma, far if error.key in ("rotation", "tilt") else cells[0]


def kept_light(window: Window, field: float, design: Design, fewest: int = 1) -> AskedLight:
    """Rays of a search: those over a cell and a cone that reach the partner cell through ideal lenses.

    Raises
    ------
    DesignError
        They are fewer than `fewest`.
    """
    one = window.with_cells((1, 1))
    rays = _partners(one, field, design)
    if len(rays) < max(fewest, 1):
        smaller = field
        while smaller > SMALLEST * field and len(_partners(one, smaller, design)) < fewest:
            smaller *= 0.8
        way = (
            f"a field of {float(f'{degrees(smaller):.2g}'):g} deg"
            if smaller > SMALLEST * field
            else "lattice.aperture aims it"
        )
        raise DesignError(
            [
                Mistake(
                    "CL120",
                    f"{len(rays)} of {RAYS:,} rays of the field reach their partner cell through ideal"
                    " lenses, too few to search with",
                    CHECK.field,
                    allowed=f"a cone inside the field of view: {fewest} rays at least",
                    hint=way,
                )
            ]
        )
    return AskedLight.of(rays, window.law.refract(rays.direction))


def _partners(one: Window, field: float, design: Design) -> Rays:
    """Rays of a cone over one cell that reach the partner cell through ideal lenses."""
    from clacad.tracing.trace import trace

    rays = bundle(one, RAYS, field, design.check.field_centre).rays
    ideal = trace(one, rays, rung="thin", path="numpy")
    kept = (ideal.fate == Fate.ALIVE) & (ideal.order == 0).all(axis=1)
    return Rays(rays.position[kept], rays.direction[kept])


FRESH = 16384
FIELDS = (0.5, 1.0, 2.0)
"""Shares of the field at which start and end are compared; the best faces depend on the field."""


@dataclass(frozen=True)
class Seen:
    """Result of independent rays: field (radians), rms error to the law (radians), share in the partner
    cell.
    """

    field: float
    law_rms: float
    throughput: float


def measured(window: Window, field: float, design: Design) -> Seen:
    """Trace independent rays through the sheet, with the tracer of the checks; field in radians."""
    from clacad.tracing.trace import trace

    small = window.with_cells((3, 3))
    points = sobol(FRESH, 4, skip=FRESH)
    middle = middle_direction(small, design.check.field_centre)
    light = launched(
        small,
        small.lattice.over_cell(points[:, :2]),
        cone(middle, field, points[:, 2:]),
        central_cell(small),
        middle,
        field,
    )
    found = measure(
        lambda lit: trace(small, lit.rays, path="numpy"), light, RequestedLaw(window.law), fewest=1
    )
    return Seen(field, found.rms, found.share)
