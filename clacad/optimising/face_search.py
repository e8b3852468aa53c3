"""State of a search: residuals of trial faces, and the best faces within the walls so far."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import degrees, inf
from time import monotonic

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.config.design_error import DesignError
from clacad.config.mistakes import Mistake
from clacad.design import Design
from clacad.design.faces import SearchRecord, faces_digest
from clacad.design.keys import PAIR
from clacad.optics.fit import minimise
from clacad.optimising.aim import RAYS, Aim, AimedRays
from clacad.optimising.search_walls import Walls, penalties
from clacad.optimising.trial_faces import given_design, trial_design, with_faces
from clacad.optimising.unknowns import Unknowns
from clacad.sheet.window import Window

TIE = 1e-9
"""Residual (radians) of a conic constant of 1: enough to fix one that light does not determine, too little to
affect the others.
"""

WORTH = 0.9
"""Largest share of the error that may remain for terms of sixth or eighth order to be kept."""

HIGHER = ("a6", "a8")
"""Orders that are tried last, in sequence."""

LEAST_GAIN = 1e-3
"""Least reduction of the error, as a share of the start's error, for faces to be written."""

TOLD = 0.9
"""Share of the last recorded error at which the history gets another line."""

Progress = Callable[[int, float], None]
"""Receives the number of evaluations so far and the best rms error (radians)."""


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
        self, design: Design, window: Window, unknowns: Unknowns, aim: Aim, progress: Progress | None = None,
        until: float = inf,
    ) -> None:  # fmt: skip
        self.design, self.window, self.unknowns, self.aim = design, window, unknowns, aim
        self.progress, self.until = progress, until
        self.walls = Walls.of(design, window, aim.field)
        self.target = AimedRays.of(aim, design, window, len(unknowns.free))
        self.before = self.error_of(window)
        self.evaluations = 0
        self.best: Best | None = None
        self.nearest = (-inf, "")
        self.sharpest_beyond = (inf, "")
        self.kept: tuple[str, ...] = ()
        follows = design.pair.offset == "traced" or any(face.land is not None for face in window.faces)
        self.quick = unknowns.still and not follows

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
            here = self._lower_orders()
            for order in HIGHER:
                if any(one.kind == order for one in self.unknowns.free) and not self._hopeless(order):
                    self._higher_order(order, here)
        except KeyboardInterrupt:
            if self.best is None:
                raise
            return "interrupted"
        except OutOfTime:
            return "seconds"
        return ""

    def _hopeless(self, order: str) -> bool:
        """Whether a lower one of the higher orders gave too little gain."""
        return order == "a8" and "a6" not in self.kept

    def _lower_orders(self) -> Floats:
        """Search terms of fourth order before conic constants: their effects are similar, and both together
        diverge.
        """
        kinds = np.array([one.kind for one in self.unknowns.free])
        here, now = self.unknowns.vector, ~np.isin(kinds, HIGHER)
        if "K" in kinds and "a4" in kinds:
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
        slack = self.walls.slack(trial)
        self._note(vector, float(np.linalg.norm(light)), slack)
        return np.concatenate([light, penalties(slack), TIE * self.unknowns.conics(vector)])

    def best_design(self, free: tuple[str, ...]) -> Design:
        """Best result within the walls as a design that records its origin, checked as a design file is."""
        if self.best is None:
            slack, name = self.nearest
            raise DesignError([
                Mistake("CL120", f"no faces were found within the walls: the {name} stays {-slack:.3g} times its limit beyond it",
                        PAIR.thickness, allowed="walls that leave room: the process, check.edge, check.graph, or more thickness")
            ])  # fmt: skip
        self._refuse_no_gain(self.best)
        faces, offset = self.unknowns.faces(self.best.vector)
        record = SearchRecord(
            self.design.sha256, faces_digest(faces), free, degrees(self.aim.field), self.aim.weights,
            self.aim.tolerances, self.kept_unknowns, RAYS,
            tuple((float(at), 1e3 * rms) for at, rms in self.best.history),
        )  # fmt: skip
        return given_design(self.design, self.window, faces, offset, record)

    @property
    def gained(self) -> bool:
        """Whether the best within the walls is worth writing."""
        return self.best is not None and self.best.rms <= (1.0 - LEAST_GAIN) * self.before

    def _refuse_no_gain(self, best: Best) -> None:
        if self.gained:
            return
        rms, name = self.sharpest_beyond
        found = f"; {1e3 * rms:.4g} mrad lies beyond the wall of the {name}" if rms < best.rms else ""
        raise DesignError([
            Mistake("CL120", f"no faces within the walls are better than the start, which leaves {1e3 * self.before:.4g} mrad rms{found}; "
                    "nothing is written", "free", allowed=f"a gain of at least {LEAST_GAIN:g}",
                    hint="more words of --free, or --field of another size")
        ])  # fmt: skip

    def _trial(self, vector: Floats) -> Window:
        faces, offset = self.unknowns.faces(vector)
        if self.quick:
            return with_faces(self.window, faces)
        from clacad.prescription.assemble import placed

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
