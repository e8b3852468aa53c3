"""State of a search: residuals of trial faces, and the best faces within the walls so far.

Walls of a search: constraints on the faces over the whole cell, not only where light of the field goes.

Each wall is a slack over its limit, at least 0 where the wall holds. Heights and slopes are evaluated at 21 ×
21 points of the optical zone and along its border; a face without a real height there counts as far beyond
the wall.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from math import cos, degrees, inf, isfinite, pi
from time import monotonic

import numpy as np

from clacad.base.sobol import sobol
from clacad.base.types import Bools, Floats
from clacad.checks.design_kinds import EDGE, NECK, RADIUS, SAG, SLOPE
from clacad.design import Design
from clacad.design.faces import SearchRecord, faces_digest
from clacad.design.process_profiles import profile
from clacad.design.sections import PAIR
from clacad.optics.fit import minimise
from clacad.optics.surface import Surface
from clacad.optimising.aim import RAYS, Aim, AimedRays, LightInCells, fields_of
from clacad.optimising.scan_light import SCAN_MARGIN, ScanLight
from clacad.optimising.unknowns import (
    ListedUnknowns,
    Unknowns,
    refused,
    trial_design,
    with_faces,
    with_listed,
)
from clacad.prescription.bodies import given_conics, given_design
from clacad.sheet.feasibility.convex_extremes import outline
from clacad.sheet.moved_plates import paraxial_exit
from clacad.sheet.window import Body, Face, Window, in_optical_tile, lens_height_and_normal, optical_tile
from clacad.verification.process_rules import process_limit

LISTED_NORMAL_Z = cos(0.25 * pi)
"""Least z component of a normal of listed faces: a slope of 1."""

KEPT_PATH = 0.01
"""Largest relative change of B of listed faces; the error falls without limit as they move apart."""

GRID = 21
REAL = 0.02
"""Least value of the radicand of a face at any point of its cell."""

MARGIN = 0.005
"""Margin of a wall as a share of its limit, for the compliance of the search near the wall."""

STIFFNESS = 0.01
"""Residual (radians) of a wall that is violated by its whole limit."""

SOFT = 0.01
"""Part of the stiffness in the first stage of a search over listed faces: with hard walls from the start on
it ends in a worse minimum."""

LOST = -1.0


@dataclass(frozen=True, eq=False)
class Walls:
    """Limits of a design, and the points at which they are evaluated.

    x, y : (n,) lengths. Points of the optical zone, cell frame.
    normal_z : Least z component of a normal.
    radius, sag : lengths. Least radius and greatest height; 0 and infinite without one.
    thickness : (b,) lengths. Least allowed thickness of each body in its cell.
    light : Constraint on the light that misses its cell; None of a scan, which holds its own share.
    path : length. B of listed faces at the start, which is kept; 0: of another form.
    gaps : length. Least air between listed plates: a neck, or that of the start where it has less.
    """

    x: Floats
    y: Floats
    normal_z: float
    radius: float
    sag: float
    thickness: tuple[float, ...]
    light: LightInCells | None
    path: float = 0.0
    gaps: float = 0.0

    @staticmethod
    def of(design: Design, window: Window, field: float | None = None) -> Walls:
        """Walls of a design and its start window; field in radians, None: the design's `check.field`."""
        rules = profile(design.check.process)
        kinds = (EDGE, NECK, RADIUS, SAG, SLOPE)
        edge, least_neck, radius, sag, slope = (process_limit(design, rules, kind)[0] for kind in kinds)
        tile = optical_tile(window)
        low, high = tile.min(axis=0), tile.max(axis=0)
        x, y = (g.ravel() for g in np.meshgrid(*(np.linspace(low[k], high[k], GRID) for k in (0, 1))))
        inside, rim = in_optical_tile(window, x, y), outline(tile, GRID)
        x, y = np.append(x[inside], rim[:, 0]), np.append(y[inside], rim[:, 1])
        neck = design.body.neck or min(window.lattice.pitch) / 50.0
        asked = max(edge, least_neck)
        cone = design.check.field if field is None else field
        needs = tuple(
            max(asked, min(neck, (1.0 - 2.0 * MARGIN) * _thinnest(body, x, y))) for body in window.bodies
        )
        return Walls(
            x,
            y,
            max(design.check.graph, cos(slope), LISTED_NORMAL_Z if window.form == "plates" else 0.0),
            radius,
            sag,
            needs,
            LightInCells.of(window, [part * cone for part in fields_of(window)], design.check.field_centre),
            _b_of(window) if window.form == "plates" else 0.0,
            min(neck, (1.0 - 2.0 * MARGIN) * min(_gaps(window, x, y), default=inf)),
        )

    def slack(self, window: Window) -> dict[str, float]:
        """Slack of every wall over its limit, in a fixed order; below 0: violated."""
        found: dict[str, float] = {}
        number = 0
        for body, need in zip(window.bodies, self.thickness, strict=True):
            heights = []
            for face in (body.front, body.back):
                number += 1
                z, normal = lens_height_and_normal(face, self.x, self.y)
                heights.append(z)
                if face.array is not None:
                    found |= self._of_face(face, f"face {number}", z, normal)
            if need > 0.0:
                thinnest = _least_apart(body, *heights)
                found[f"thickness of {body.name}"] = thinnest / need - 1.0 if isfinite(thinnest) else LOST
        if self.light is not None:
            found |= self.light.slack(window)
        if self.path:
            found["B of the faces"] = 1.0 - abs(_b_of(window) / self.path - 1.0) / KEPT_PATH
        if isfinite(self.gaps):
            for number, gap in enumerate(_gaps(window, self.x, self.y), start=1):
                found[f"air behind plate {number}"] = gap / self.gaps - 1.0 if isfinite(gap) else LOST
        return found

    def _of_face(self, face: Face, name: str, z: Floats, normal: Floats) -> dict[str, float]:
        """Walls of one face with heights z (n,), lengths, and normals (n, 3)."""
        x, y = self.x - face.vertex[0], self.y - face.vertex[1]
        points = np.column_stack([x, y, np.zeros_like(x)]) @ face.rotation
        found = {f"real height of {name}": _radicand(face.surface, points) - REAL}
        lost = not np.isfinite(z).all()
        found[f"slope of {name}"] = LOST if lost else float(normal[:, 2].min()) - self.normal_z
        if self.radius > 0.0:
            sharpest = max(abs(face.surface.curvature_x), abs(face.surface.curvature_y))
            found[f"radius of {name}"] = 1.0 - self.radius * sharpest
        if isfinite(self.sag):
            found[f"height of {name}"] = LOST if lost else 1.0 - float(np.ptp(z)) / self.sag
        if face.land is not None:
            proud = LOST if lost else float((face.land_side * (face.land - z)).min())
            found[f"{name} over its land"] = proud if lost else proud / max(float(np.ptp(z)), 1e-300)
        return found


def penalties(slack: Mapping[str, float], margin: float = MARGIN) -> Floats:
    """Residuals of the walls, (w,) radians: 0 outside their margins."""
    return STIFFNESS * np.maximum(0.0, margin - np.array(list(slack.values())))


def _thinnest(body: Body, x: Floats, y: Floats) -> float:
    """Least thickness (length) over points (n,) of the zone, a slab's over any two cells; NaN if no face."""
    front, back = (lens_height_and_normal(face, x, y)[0] for face in (body.front, body.back))
    return _least_apart(body, front, back)


def _gaps(window: Window, x: Floats, y: Floats) -> list[float]:
    """Least air (lengths) between two plates, over any two points (n,) of their cells; NaN if no face."""
    found = []
    for before, behind in pairwise(window.bodies):
        if not behind.joined:
            back, front = (lens_height_and_normal(face, x, y)[0] for face in (before.back, behind.front))
            found.append(float(front.min() - back.max()))
    return found


def _b_of(window: Window) -> float:
    """B of the faces (length), mean of both axes: height behind them per slope before them."""
    ends = [
        paraxial_exit(window, np.zeros(2), slope)[0] - paraxial_exit(window, np.zeros(2), np.zeros(2))[0]
        for slope in np.eye(2)
    ]
    return float(np.trace(np.array(ends)) / 2.0)


def _least_apart(body: Body, front: Floats, back: Floats) -> float:
    """Least thickness between heights (n,), lengths; for a slab, over every combination of cells."""
    return float((back - front).min() if body.columnar else back.min() - front.max())


def _radicand(surface: Surface, points: Floats) -> float:
    """Least 1 − (1 + K_x) c_x² x² − (1 + K_y) c_y² y² over points (n, 3) of the lens frame: finite where the
    height is not.
    """
    kx, ky = given_conics(surface)
    a, b = (1.0 + kx) * surface.curvature_x**2, (1.0 + ky) * surface.curvature_y**2
    return float((1.0 - a * points[:, 0] ** 2 - b * points[:, 1] ** 2).min())


AROUND, SMALL = 0.1, 0.02
"""Range of further starts, as a part of the unknowns of the design, and of the least size that these count.
"""

TIE = 1e-9
"""Residual (radians) of a conic constant of 1: enough to fix one that light does not determine, too little to
affect the others.
"""

WORTH = 0.9
"""Largest share of the error that may remain for terms of sixth or eighth order to be kept."""

HIGHER = ("a6", "a8")
"""Orders that are tried last, in sequence, where faces are not listed."""

LEAST_GAIN = 1e-3
"""Least reduction of the error, as a share of the start's error, for faces to be written."""

TOLD = 0.9
"""Share of the last recorded error at which the history gets another line."""

Progress = Callable[[int, float], None]
"""Receives the number of evaluations so far and the best rms error (radians)."""


@dataclass(frozen=True, slots=True)
class Effort:
    """Limits of a search.

    seconds : Time after which it ends with the best so far; None: without limit.
    starts : Number of starts: the design's faces, then others around them. The best within the walls counts.
    """

    seconds: float | None = None
    starts: int = 1


class OutOfTime(Exception):
    """The time limit of a search has expired."""


@dataclass(frozen=True, eq=False)
class Best:
    """Best result within the walls so far: unknowns (k,), rms error, its evaluation, and earlier history."""

    vector: Floats
    rms: float
    evaluation: int
    told: tuple[tuple[int, float], ...]

    @property
    def history(self) -> tuple[tuple[int, float], ...]:
        """Recorded history, and this result."""
        here = (self.evaluation, self.rms)
        return self.told if self.told[-1] == here else (*self.told, here)


class FaceSearch:
    """Residuals of one search, and the best within the walls so far."""

    def __init__(
        self,
        design: Design,
        window: Window,
        unknowns: Unknowns | ListedUnknowns,
        aim: Aim,
        progress: Progress | None = None,
        effort: Effort | None = None,
    ) -> None:
        self.design, self.window, self.unknowns, self.aim = design, window, unknowns, aim
        limit = effort or Effort()
        self.progress, self.starts = progress, limit.starts
        self.until = inf if limit.seconds is None else monotonic() + limit.seconds
        self.walls = Walls.of(design, window, aim.field)
        if aim.scan is not None:  # a scan holds its slope and its share instead
            self.walls = replace(self.walls, light=None, path=0.0)
        self.target: AimedRays | ScanLight = (
            AimedRays.of(aim, design, window, len(unknowns.free))
            if aim.scan is None
            else ScanLight.of(aim.scan, window)
        )
        self.before = self.error_of(window)
        self.kept_at_start = min((self.walls.slack(window) | _of_scan(self.target, window)).values()) >= 0.0
        self.evaluations = 0
        self.best: Best | None = None
        self.nearest = (-inf, "")
        self.sharpest_beyond = (inf, "")
        # listed faces of several plates gain from all orders together, where each alone gives little
        self.kept: tuple[str, ...] = HIGHER if window.form == "plates" else ()
        follows = design.pair.offset == "traced" or any(face.land is not None for face in window.faces)
        self.quick = unknowns.still and not follows
        self.stiff = 1.0

    @property
    def left_out(self) -> tuple[str, ...]:
        """Higher orders that were free and gave too little gain, or that the search did not reach."""
        free = {one.kind for one in self.unknowns.free}
        return tuple(order for order in HIGHER if order in free and order not in self.kept)

    @property
    def kept_unknowns(self) -> int:
        """Number of unknowns without those that were left out."""
        return sum(one.kind not in self.left_out for one in self.unknowns.free)

    def error_of(self, window: Window) -> float:
        """Objective of the search for any window: rms error, radians."""
        return float(np.linalg.norm(self.target.residuals(window)))

    def run(self) -> str:
        """Search; return why it was stopped, "" where it finished."""
        try:
            for number in range(self.starts):
                here = self._lower_orders(self._start(number))
            for order in self.left_out:
                if order != "a8" or "a6" in self.kept:  # a6 gave enough gain
                    self._higher_order(order, here)
        except KeyboardInterrupt:
            if self.best is None:
                raise
            return "interrupted"
        except OutOfTime:
            return "seconds"
        return ""

    def _start(self, number: int) -> Floats:
        """Unknowns (k,) of a start: the design's, then points around them, of a Sobol sequence."""
        start = self.unknowns.vector
        if number == 0:
            return start
        apart = sobol(1, len(start), skip=number)[0] - 0.5
        return np.asarray(start + AROUND * apart * np.maximum(np.abs(start), SMALL))

    def _lower_orders(self, here: Floats) -> Floats:
        """Search terms of fourth order before conic constants: being alike, both together diverge."""
        kinds = np.array([one.kind for one in self.unknowns.free])
        now = ~np.isin(kinds, self.left_out)
        if self.walls.path:  # listed faces
            self.stiff = SOFT
            here = self._among(here, now)
            self.stiff = 1.0
        elif "K" in kinds and "a4" in kinds:
            here = self._among(here, now & (kinds != "K"))
        return self._among(here, now)

    def _higher_order(self, order: str, here: Floats) -> None:
        """Search with one more order, from the best so far; remove it if the gain is too small."""
        before = self.best
        kinds = [one.kind for one in self.unknowns.free]
        now = np.array([kind not in HIGHER or kind == order or kind in self.kept for kind in kinds])
        try:
            self._among(here if before is None else before.vector, now)
        finally:
            if before is not None and self.best is not None and self.best.rms > WORTH * before.rms:
                self.best = before
            elif self.best is not None:
                self.kept += (order,)

    def _among(self, here: Floats, free: Bools) -> Floats:
        """The unknowns (k,) after a search among those that are `free` (k,)."""

        def whole(part: Floats) -> Floats:
            found = here.copy()
            found[free] = part
            return found

        return whole(minimise(lambda part: self.residuals(whole(part)), here[free]))

    def residuals(self, vector: Floats) -> Floats:
        """Residuals of light, walls and ties; records the vector if it is the best within the walls."""
        if monotonic() > self.until:
            raise OutOfTime
        trial = self._trial(vector)
        light = self.target.residuals(trial)
        slack, scan = self.walls.slack(trial), _of_scan(self.target, trial)
        self._note(vector, float(np.linalg.norm(light)), slack | scan)
        ties = TIE * self.unknowns.conics(vector)
        walls = np.concatenate([penalties(slack), penalties(scan, SCAN_MARGIN)])
        return np.concatenate([light, self.stiff * walls, ties])

    def best_design(self, free: tuple[str, ...]) -> Design:
        """Best result within the walls as a design that records its origin, checked as a design file is."""
        if self.best is None:
            slack, name = self.nearest
            raise refused(
                "CL120",
                f"no faces were found within the walls: the {name} stays {-slack:.3g} times its limit"
                " beyond it",
                PAIR.thickness,
                allowed="walls that leave room: the process, check.edge, check.graph, or more thickness",
            )
        if not self.gained:
            rms, name = self.sharpest_beyond
            nearby = (
                f"; {1e3 * rms:.4g} mrad lies beyond the wall of the {name}" if rms < self.best.rms else ""
            )
            raise refused(
                "CL120",
                "no faces within the walls are better than the start, which leaves"
                f" {1e3 * self.before:.4g} mrad rms{nearby}; nothing is written",
                "free",
                allowed=f"a gain of at least {LEAST_GAIN:g}",
                hint="more words of --free, or --field of another size",
            )
        faces, offset = self.unknowns.faces(self.best.vector)
        record = SearchRecord(
            self.design.sha256,
            faces_digest(faces),
            free,
            degrees(self.aim.field),
            self.aim.weights,
            self.aim.tolerances,
            self.kept_unknowns,
            RAYS,
            tuple((float(at), 1e3 * rms) for at, rms in self.best.history),
            tuple((float(f"{1e9 * line:.12g}"), weight) for line, weight in self.aim.spectrum),
            None if self.aim.scan is None else self.aim.scan.words(self.design.unit),
        )
        return given_design(self.design, self.window, faces, offset, record)

    @property
    def gained(self) -> bool:
        """Whether the best within the walls is worth writing: better than the start, or that broke a wall."""
        if self.best is None:
            return False
        return not self.kept_at_start or self.best.rms <= (1.0 - LEAST_GAIN) * self.before

    def _trial(self, vector: Floats) -> Window:
        faces, offset = self.unknowns.faces(vector)
        if self.quick:
            build = with_listed if self.window.form == "plates" else with_faces
            return build(self.window, faces)
        from clacad.prescription.prescribe import placed

        return placed(trial_design(self.design, self.window, faces, offset))

    def _note(self, vector: Floats, rms: float, slack: Mapping[str, float]) -> None:
        self.evaluations += 1
        tightest = min(slack, key=lambda name: slack[name])
        self.nearest = max(self.nearest, (slack[tightest], tightest))
        if slack[tightest] < 0.0:
            self.sharpest_beyond = min(self.sharpest_beyond, (rms, tightest))
            return
        if self.best is not None and rms >= self.best.rms:
            return
        told = () if self.best is None else self.best.told
        if not told or rms <= TOLD * told[-1][1]:
            told = (*told, (self.evaluations, rms))
        self.best = Best(vector.copy(), rms, self.evaluations, told)
        if self.progress is not None:
            self.progress(self.evaluations, rms)


def _of_scan(target: AimedRays | ScanLight, trial: Window) -> dict[str, float]:
    """Slack of the walls of a scan, if one is searched."""
    return target.slack(trial) if isinstance(target, ScanLight) else {}
