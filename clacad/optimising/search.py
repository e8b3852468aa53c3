"""The search: a design in, a better design of the same law out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Floats
from clacad.config.design_error import DesignError
from clacad.config.mistakes import Mistake
from clacad.design import Design
from clacad.design.canonical_text import OF_RECIPES
from clacad.design.given_faces import FaceSpec, face_table
from clacad.optics.fit import AskedLight, law_residuals, minimise
from clacad.optics.law import angle_between
from clacad.optics.rays import Fate, Rays
from clacad.optimising.search_walls import Walls, penalties
from clacad.optimising.unknowns import Unknowns, chosen
from clacad.prescription.given import given_surface
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import bundle, central_cell, cone, launched, middle_direction
from clacad.sheet.need_window import need_equal_cells
from clacad.sheet.telescopelet import interfaces
from clacad.sheet.window import Window

RAYS = 1024
FRESH = 16384
FIELDS = (0.5, 1.0, 2.0)
"""Parts of the field at which start and end are compared: what is best at one is not at another."""

TIE = 1e-9
"""Residual (radians) of a conic constant of 1: enough to hold one that light does not feel, too little to be felt."""

Progress = Callable[[int, float], None]
"""Told the evaluations so far and the best rms error (radians)."""


@dataclass(frozen=True)
class Seen:
    """Fresh rays through a sheet: field (radians), rms error to the law (radians), share that gets to its partner cell."""

    field: float
    law_rms: float
    throughput: float


@dataclass(frozen=True, eq=False)
class Optimised:
    """What a search found.

    Parameters
    ----------
    design : Design
        Given faces; passes the design rules where the start did.
    start : Design
    free : tuple of str
    unknowns, evaluations : int
    before, after : tuple of Seen
        Start and end at ½, 1 and 2 × the field; empty after an interruption.
    finished : bool
        False: stopped on the way; `design` is the best so far.
    """

    design: Design
    start: Design
    free: tuple[str, ...]
    field: float
    unknowns: int
    evaluations: int
    before: tuple[Seen, ...]
    after: tuple[Seen, ...]
    finished: bool

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers: what was free, errors before and after, the faces."""
        return {
            "design": self.design.name, "from_sha256": self.start.sha256, "sha256": self.design.sha256,
            "free": list(self.free), "field": self.field, "unknowns": self.unknowns, "rays": RAYS,
            "evaluations": self.evaluations, "finished": self.finished,
            "before": [vars(seen) for seen in self.before], "after": [vars(seen) for seen in self.after],
            "faces": [face_table(face) for face in self.design.pair.face],
        }  # fmt: skip


def optimise(
    design: Design, free: tuple[str, ...] = ("radii", "conic"), field: float | None = None, progress: Progress | None = None
) -> Optimised:  # fmt: skip
    """Search for the faces that keep best to the law of a design, over a field.

    Parameters
    ----------
    design : Design
    free : tuple of str
        What may change: "radii", "conic", "bending" (own radii a face; biconvex), "a4" (on paraboloids unless "conic"
        is free, too), "offset" (of lens 2).
    field : float or None, radians
        Half angle of the cone of rays; None: the design's `check.field`.
    progress : callable or None

    Returns
    -------
    Optimised
        The same for the same input, whatever the machine's speed. KeyboardInterrupt ends the search and returns
        the best so far.

    Raises
    ------
    DesignError
        A word that cannot be free; or no faces were found that keep within the walls.
    """
    window = prescribe(design)
    need_equal_cells(
        window, "the search for better faces", "a slope as lattice.aperture stands all cells alike"
    )
    unknowns = chosen(window, tuple(free))
    half_angle = design.check.field if field is None else field
    search = _FaceSearch(design, window, unknowns, half_angle, progress)
    before = tuple(measured(window, part * half_angle, design) for part in FIELDS)
    finished = True
    try:
        search.run()
    except KeyboardInterrupt:
        if search.best is None:
            raise
        finished = False
    better = search.best_design()
    after = (
        tuple(measured(prescribe(better), part * half_angle, better) for part in FIELDS) if finished else ()
    )
    return Optimised(
        better,
        design,
        tuple(free),
        half_angle,
        len(unknowns.free),
        search.evaluations,
        before,
        after,
        finished,
    )


def outlook(design: Design, free: tuple[str, ...]) -> dict[str, float]:
    """What a search will take: unknowns, evaluations and processor seconds of one core, by the model of one machine.

    Raises
    ------
    DesignError
        As `optimise` of the same words.
    """
    window = prescribe(design)
    need_equal_cells(
        window, "the search for better faces", "a slope as lattice.aperture stands all cells alike"
    )
    unknowns = chosen(window, tuple(free))
    k = len(unknowns.free)
    evaluations = 10.0 + 0.8 * k * k  # measured: 16, 37, 34 and 379 of 4, 8, 10 and 20 unknowns
    each = 0.005 if unknowns.still else 0.02
    return {
        "unknowns": k,
        "evaluations": evaluations,
        "seconds": 0.6 + each * evaluations * (1.5 if "a4" in free else 1.0),
    }


class _FaceSearch:
    """Residuals of one search, and the best within the walls so far."""

    def __init__(
        self, design: Design, window: Window, unknowns: Unknowns, field: float, progress: Progress | None
    ) -> None:
        self.design, self.window, self.unknowns, self.progress = design, window, unknowns, progress
        self.walls = Walls.of(design, window)
        self.light = _kept_light(window, field, design)
        self.evaluations = 0
        self.best: Floats | None = None
        self.least = np.inf
        self.nearest = (-np.inf, "")
        self.quick = unknowns.still and all(face.land is None for face in window.faces)

    def run(self) -> None:
        """Search; terms of fourth order come before conic constants, which do nearly the same: both at once go astray."""
        start = self.unknowns.vector
        kinds = np.array([one.kind for one in self.unknowns.free])
        if "K" in kinds and "a" in kinds:
            chosen_first = kinds != "K"

            def without_conics(part: Floats) -> Floats:
                whole = start.copy()
                whole[chosen_first] = part
                return self.residuals(whole)

            found = minimise(without_conics, start[chosen_first])
            start[chosen_first] = found
        minimise(self.residuals, start)

    def residuals(self, vector: Floats) -> Floats:
        """Residuals of light, walls and ties; notes the vector if it is the best within the walls."""
        trial = self._trial(vector)
        light = law_residuals(interfaces(trial), self.light)
        slack = self.walls.slack(trial)
        wall = penalties(slack)
        ties = TIE * self.unknowns.conics(vector)
        self._note(vector, float(light @ light), slack)
        return np.concatenate([light, wall, ties])

    def best_design(self) -> Design:
        """The best within the walls as a design, checked as a file would be."""
        if self.best is None:
            slack, name = self.nearest
            raise DesignError([
                Mistake("CL120", f"no faces were found within the walls: the {name} stays {-100 * slack:.3g} % beyond its limit",
                        "pair.thickness", allowed="walls that leave room: the process, check.edge, check.graph, or more thickness")
            ])  # fmt: skip
        return given_design(self.design, self.window, *self.unknowns.faces(self.best))

    def _trial(self, vector: Floats) -> Window:
        faces, offset = self.unknowns.faces(vector)
        if self.quick:
            return _with_faces(self.window, faces)
        from clacad.prescription.assemble import placed

        return placed(_asked(self.design, self.window, faces, offset))

    def _note(self, vector: Floats, square: float, slack: Mapping[str, float]) -> None:
        self.evaluations += 1
        tightest = min(slack, key=lambda name: slack[name])
        self.nearest = max(self.nearest, (slack[tightest], tightest))
        if slack[tightest] >= 0.0 and square < self.least:
            self.least, self.best = square, vector.copy()
            if self.progress is not None:
                self.progress(self.evaluations, float(np.sqrt(square)))


def _kept_light(window: Window, field: float, design: Design) -> AskedLight:
    """The rays of the search: those of a cell and a cone that reach the partner cell through ideal lenses."""
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


def measured(window: Window, field: float, design: Design) -> Seen:
    """Fresh rays, none of them the search's, through the sheet as it is traced everywhere else; field in radians."""
    from clacad.tracing.trace import trace

    small = window.with_cells((3, 3))
    points = sobol(FRESH, 4, skip=FRESH)
    middle = middle_direction(small, design.check.field_centre)
    light = launched(small, small.lattice.over_cell(points[:, :2]), cone(middle, field, points[:, 2:]),
                     central_cell(small), middle, field)  # fmt: skip
    seen = trace(small, light.rays, path="numpy")
    good = (seen.fate == Fate.ALIVE) & (seen.order == 0).all(axis=1)
    error = angle_between(seen.direction[good], window.law.refract(light.rays.direction[good]))
    rms = float(np.sqrt(np.mean(error**2))) if good.any() else float("nan")
    return Seen(field, rms, float(good.mean()))


def given_design(
    design: Design, window: Window, faces: tuple[FaceSpec, ...], offset: tuple[float, float] | None
) -> Design:
    """The design with these faces, and all that its window fixed, written down; checked as a file would be."""
    data = {key: dict(value) if isinstance(value, Mapping) else value for key, value in design.given.items()}
    pair = {key: value for key, value in data["pair"].items() if key not in OF_RECIPES}
    if design.pair.form != "slab":
        pair["thickness"] = list(window.recipe["T"])
    if offset is not None:
        pair["vertex"] = list(offset)
    pair["prescription"] = "given"
    pair["face"] = [face_table(face) for face in faces]
    return Design.from_dict({**data, "pair": pair})


def _asked(
    design: Design, window: Window, faces: tuple[FaceSpec, ...], offset: tuple[float, float] | None
) -> Design:
    """The same unchecked: a trial of the search."""
    thickness = design.pair.thickness if design.pair.form == "slab" else tuple(window.recipe["T"])
    given = replace(
        design.pair,
        prescription="given",
        face=faces,
        thickness=thickness,
        vertex=offset or design.pair.vertex,
    )
    return replace(design, pair=given)


def _with_faces(window: Window, faces: tuple[FaceSpec, ...]) -> Window:
    """The window with other surfaces in the places of its own."""
    made = iter(faces)
    bodies = []
    for body in window.bodies:
        front, back = (
            replace(face, surface=given_surface(spec, face.side)) if face.array is not None else face
            for face, spec in ((body.front, next(made)), (body.back, next(made)))
        )
        bodies.append(replace(body, front=front, back=back))
    return replace(window, bodies=tuple(bodies))
