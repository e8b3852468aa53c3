"""Objective of a search: the error over one field or several, of the perfect part or of parts as made.

Parts as made: to first order an error e of a part, of standard deviation σ, adds σ² |∂r/∂e|² to the expected
square of the residuals r. The slopes of `clacad.verification.tolerance` for every tolerance of the design,
times σ, are therefore appended to the residuals of the perfect part. Least squares then minimise the expected
error. The slopes are central differences over ±σ. Roughness changes no direction and is left out. Rotation
and tilt of an array are evaluated at the cell farthest from the centre, where their effect is largest; other
errors affect all cells equally. Start and end are compared over independent rays, not those of the search.

Light must stay in the cells of lens 2: rays that miss their partner's cell do not count in the error, and
an unconstrained search would lose light to reduce it. `LightInCells` constrains the cones over which start
and end are compared, and the full field of a sheet with a field lens, where a weaker field lens looks
sharper.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import atan, degrees, isfinite, nan, sqrt
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats
from clacad.config.value_kinds import shown
from clacad.design import Design
from clacad.design.sections import CHECK
from clacad.light.measure import mean_rms, measure
from clacad.optics.fit import AskedLight, law_residuals
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.optics.sequence import trace_sequence
from clacad.optimising.unknowns import refused
from clacad.sheet.bundle import RequestedLaw, bundle, cone, launched, middle_direction
from clacad.sheet.face_order import refractions
from clacad.sheet.like_cell import in_light, interfaces
from clacad.sheet.representative_cells import central_cell, places_of_errors
from clacad.sheet.vignetting import half_field, thin_cells
from clacad.sheet.window import Window
from clacad.verification.tolerance import Parameter, parameters, telescopelet
from clacad.verification.tolerance.misaligned import SIGMAS

if TYPE_CHECKING:
    from clacad.steering.scan import Scan

RAYS = 1024
"""Number of rays of a search, for each field."""

FEW = 256
"""Number of these rays used for the slopes of tolerances, which change slowly over the cell."""

FEWEST = 4
"""Least number of remaining rays per unknown; with fewer, the faces fit the rays instead of the field."""

SMALLEST = 1e-3
"""Smallest share of a field that is searched for enough light."""

DARKEST = 1e-15
"""Least rms error (radians) of a line: no division by the error of a line without any."""

LARGEST_PART = 4.0
"""Largest part of the field that may have a weight."""

Weights = tuple[tuple[float, float], ...]
"""(part of the field, weight) of every cone of rays; or (wavelength in metres, weight) of every line."""

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
    spectrum : tuple of (wavelength in metres, weight)
        Lines whose mean rms error is the objective; empty: the wavelength of the design.
    scan : Scan or None
        Positions of moving plates; their spread is then the objective.
    """

    field: float
    weights: Weights = WHOLE
    tolerances: bool = False
    spectrum: Weights = ()
    scan: Scan | None = None

    def __post_init__(self) -> None:
        for part, weight in self.weights:
            if not (0.0 < part <= LARGEST_PART and 0.0 < weight and isfinite(weight)):
                raise refused(
                    "CL106",
                    f"weight {shown(weight)} of {shown(part)} of the field",
                    "weights",
                    allowed=f"part:weight, the part from above 0 to {LARGEST_PART:g}, the weight above 0",
                    hint=".5:1,1:1",
                )
        if not self.weights or len({part for part, _ in self.weights}) < len(self.weights):
            message = "every part of the field has one weight"
            raise refused("CL106", message, "weights", allowed=".5:1,1:1")


@dataclass(frozen=True, eq=False)
class AimedRays:
    """Objective of a search for one design: the rays and the errors of parts as made.

    lights : tuple of (AskedLight, root of its share of the weights)
    errors : tuple of (Parameter, σ, centre (2,) of the cell in which it is evaluated)
    few : Rays for the slopes of tolerances, from the cone of largest weight.
    lines : tuple of (wavelength in metres, share of the weights); empty: the wavelength of the design.
    """

    lights: tuple[tuple[AskedLight, float], ...]
    errors: tuple[tuple[Parameter, float, Floats], ...]
    few: AskedLight
    lines: Weights = ()

    @staticmethod
    def of(aim: Aim, design: Design, window: Window, unknowns: int = 1) -> AimedRays:
        """Objective for a design, its built start window and the number of unknowns.

        Raises DesignError: Of a field too little light reaches its partner cell to fix the unknowns.
        Raises NoTolerances: The design states no tolerances, and parts as made are requested.
        """
        total = sum(weight for _, weight in aim.weights)
        lights = tuple(
            (kept_light(window, part * aim.field, design, FEWEST * unknowns), sqrt(weight / total))
            for part, weight in aim.weights
        )
        most = max(lights, key=lambda pair: pair[1])[0]
        step = max(1, len(most.asked) // FEW)
        few = replace(
            most, rays=Rays(most.rays.position[::step], most.rays.direction[::step]), asked=most.asked[::step]
        )
        errors = tuple(_errors(design, window)) if aim.tolerances else ()
        bright = sum(weight for _, weight in aim.spectrum)
        return AimedRays(lights, errors, few, tuple((line, part / bright) for line, part in aim.spectrum))

    def residuals(self, trial: Window) -> Floats:
        """Residuals (m,) of a trial, radians: their sum of squares is the expected mean square error.

        Of several lines it is the square of their mean rms error.
        """
        parts = [self._of_line(trial)]
        if self.lines:
            parts = [self._of_line(in_light(trial, line)) for line, _ in self.lines]
            rms = np.maximum([np.linalg.norm(part) for part in parts], DARKEST)
            share = np.array([share for _, share in self.lines])
            parts = [r * part for r, part in zip(np.sqrt(share * (share @ rms) / rms), parts, strict=True)]
        return np.concatenate([*parts, *(self._slope(trial, *error) for error in self.errors)])

    def _of_line(self, trial: Window) -> Floats:
        """Residuals of the rays of all cones in the light whose indices a trial has."""
        faces = interfaces(trial)
        return np.concatenate([share * law_residuals(faces, light) for light, share in self.lights])

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
    from clacad.verification.tolerance.study import NO_TOLERANCES, NoTolerances

    of_sigma = SIGMAS if design.tolerances.distribution == "normal" else sqrt(3.0)
    stated = [error for error in parameters(design, window) if error.scatter or not error.one_sided]
    if not stated:
        raise NoTolerances(NO_TOLERANCES)
    cells = places_of_errors(window)
    far = cells[int(np.argmax((cells**2).sum(axis=1)))]
    for error in stated:
        sigma = error.half if error.scatter else error.half / of_sigma
        yield error, sigma, far if error.key in ("rotation", "tilt") else cells[0]


def kept_light(window: Window, field: float, design: Design, fewest: int = 1) -> AskedLight:
    """Rays of a search: those over a cell and a cone that reach the partner cell through ideal lenses.

    Raises DesignError: They are fewer than `fewest`.
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
        raise refused(
            "CL120",
            f"{len(rays)} of {RAYS:,} rays of the field reach their partner cell through ideal"
            " lenses, too few to search with",
            CHECK.field,
            allowed=f"a cone inside the field of view: {fewest} rays at least",
            hint=way,
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

LISTED_FIELDS = (1.0 / 3.0, 2.0 / 3.0, 1.0)
"""The same of listed faces, whose field ends where light leaves its cells."""


def fields_of(window: Window) -> tuple[float, ...]:
    """Shares of the field at which start and end of a search are compared."""
    return LISTED_FIELDS if window.form == "plates" else FIELDS


@dataclass(frozen=True)
class Seen:
    """Result of independent rays: field and rms error to the law (radians), share in the partner cell.

    Of several lines: their mean rms error, and their share together.
    """

    field: float
    law_rms: float
    throughput: float


def measured(window: Window, field: float, design: Design, spectrum: Weights = ()) -> Seen:
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
        lambda lit: trace(small, lit.rays, path="numpy"),
        light,
        RequestedLaw(window.law),
        dict(spectrum),
        fewest=1,
    )
    return Seen(field, mean_rms(found), found.share)


CELL_RAYS = 512

PART = 0.9
"""Cone of the rays as a share of the full field."""

ROOM = 1e-5
"""Allowed increase of the mean distance outside the cell over that of the start, in half widths."""

INSIDE = 0.97
"""Part of the cells of listed faces that light should hit: light beyond becomes stray light."""

LOST = 1.0
"""Distance outside the cell (half widths) that is assigned to a lost ray."""

MOST_LOST = 0.02
"""Largest share of the light of a cone that a written design may lose, compared with the start."""

SHARE_ROOM = 0.5 * MOST_LOST
"""Share that a trial may lose: less than `MOST_LOST`, because a search has few rays."""

BORDER = 0.02
"""Width of the border (half cells) in which a ray counts partly; a share of whole rays has no derivative."""


@dataclass(frozen=True, eq=False)
class LightInCells:
    """Cones of rays over one cell, and how they lie in their cells at the start of the search.

    before : (c,). Share of each cone in the cell of lens 2.
    full : Rays of the full field of a sheet with a field lens; None: the last cone, of listed faces.
    beyond : Mean distance of these rays outside the border of lens 2's cell, in half widths; of listed faces
        outside `INSIDE` of the cells of all faces; NaN of other forms.
    """

    cones: tuple[Rays, ...]
    full: Rays | None
    before: Floats
    beyond: float

    @staticmethod
    def of(window: Window, fields: Sequence[float], centre: str) -> LightInCells:
        """Constraint from the start window; half angles of cones (radians) about the `centre` of checks."""
        one = window.with_cells((1, 1))
        cones = tuple(bundle(one, CELL_RAYS, field, centre).rays for field in fields)
        full = None
        if window.form != "plates" and window.field_array:
            full = bundle(one, CELL_RAYS, atan(PART * min(half_field(thin_cells(window))))).rays
        return LightInCells(cones, full, *_in_cells(window, cones, full))

    def slack(self, window: Window) -> dict[str, float]:
        """Least share that a cone may still lose, over `SHARE_ROOM`, and remaining increase of the mean
        distance outside, over `ROOM`; below 0: violated.
        """
        shares, beyond = _in_cells(window, self.cones, self.full)
        found = {"share of light": 1.0 - float((self.before - shares).max()) / SHARE_ROOM}
        if isfinite(self.beyond):
            found["light in its cells"] = (self.beyond + ROOM - beyond) / ROOM
        return found


def _in_cells(window: Window, cones: Sequence[Rays], full: Rays | None) -> tuple[Floats, float]:
    """Share (c,) of the rays of each cone in the cell of lens 2, and mean distance of rays outside."""
    every = [*cones, *([] if full is None else [full])]
    rays = Rays(np.concatenate([c.position for c in every]), np.concatenate([c.direction for c in every]))
    out = way_out(window, trace_sequence(interfaces(window), rays, record=True)).reshape(len(every), -1)
    shares = np.clip(0.5 - out[: len(cones)] / BORDER, 0.0, 1.0).mean(axis=1)
    listed = window.form == "plates"
    beyond = np.clip(out[-1] + (1.0 - INSIDE if listed else 0.0), 0.0, LOST).mean()
    return np.asarray(shares), float(beyond) if listed or full is not None else nan


def way_out(window: Window, seen: TraceResult, inside: float = 1.0) -> Floats:
    """Distance (n,) of rays from the border of lens 2's cell, half widths; inside < 0, `LOST` if lost.

    Of listed faces it is the largest of all faces.

    seen : Recorded trace through the faces of the window.
    inside : Part of the cell at whose border it is 0.
    """
    assert seen.hits is not None  # recorded
    faces = [one.face for one in refractions(window.bodies)]
    judged = [number for number, face in enumerate(faces) if face.array is not None]
    if window.form != "plates":
        judged = [max(number for number in judged if faces[number].array == 1)]
    out = np.full(len(seen.fate), -LOST)
    for number in judged:
        local = seen.hits[number][:, :2] - np.asarray(window.shifts[faces[number].array or 0])
        for step, half in zip(window.lattice.steps, window.lattice.half_widths, strict=True):
            across = local @ np.asarray(window.lattice.offset(*step)) / (2.0 * half)
            out = np.maximum(out, across / half - inside)
    return np.where(seen.fate == Fate.ALIVE, out, LOST)
