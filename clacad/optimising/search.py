"""The search: a design in, a better design of the same law out."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from time import monotonic
from typing import Any

from clacad.design import Design
from clacad.design.given_faces import face_table
from clacad.optimising.aim import RAYS, WHOLE, Aim, AimedRays, Weights
from clacad.optimising.face_search import FaceSearch, Progress
from clacad.optimising.measured_light import FIELDS, Seen, measured
from clacad.optimising.unknowns import chosen
from clacad.optimising.what_stays import refuse_lost_light, refuse_moved
from clacad.prescription.prescribe import prescribe
from clacad.sheet.need_window import equal_cells

ALIKE = "a slope as lattice.aperture stands all cells alike"
"""What to search where the cells of a sheet differ."""


@dataclass(frozen=True, eq=False)
class Optimised:
    """What a search found.

    Parameters
    ----------
    design : Design
        Given faces; passes the design rules where the start did.
    start : Design
    free : tuple of str
        As asked.
    left_out : tuple of str
        Of them those that would have lessened the error by less than a tenth, and were left as they were.
    aim : Aim
    unknowns, evaluations : int
    before, after : tuple of Seen
        Start and end at ½, 1 and 2 × the field; empty after an interruption.
    expected : (float, float) or None, radians
        Rms error to expect of made parts, start and end, over the search's own rays; None unless tolerances were
        weighed.
    history : tuple of (evaluations, rms error in radians)
        Of the best within the walls each time it got better by a tenth, the first and the last: no seconds in it.
    stopped : str
        "": finished; "interrupted" or "seconds": `design` is the best so far.
    """

    design: Design
    start: Design
    free: tuple[str, ...]
    left_out: tuple[str, ...]
    aim: Aim
    unknowns: int
    evaluations: int
    before: tuple[Seen, ...]
    after: tuple[Seen, ...]
    expected: tuple[float, float] | None
    history: tuple[tuple[int, float], ...]
    stopped: str

    @property
    def finished(self) -> bool:
        """Whether the search ended by itself."""
        return not self.stopped

    @property
    def field(self) -> float:
        """Half angle of the cone of rays, radians."""
        return self.aim.field

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers: what was free, errors before and after, the faces."""
        return {
            "design": self.design.name, "from_sha256": self.start.sha256, "sha256": self.design.sha256,
            "free": list(self.free), "left_out": list(self.left_out), "field": self.field,
            "weights": [list(pair) for pair in self.aim.weights], "tolerances": self.aim.tolerances,
            "unknowns": self.unknowns, "rays": RAYS, "evaluations": self.evaluations, "finished": self.finished,
            "stopped": self.stopped, "before": [vars(seen) for seen in self.before],
            "after": [vars(seen) for seen in self.after],
            "expected": None if self.expected is None else list(self.expected),
            "history": [list(one) for one in self.history],
            "faces": [face_table(face) for face in self.design.pair.face],
        }  # fmt: skip


def optimise(
    design: Design, free: tuple[str, ...] = ("radii", "conic"), field: float | None = None, progress: Progress | None = None,
    *, weights: Weights = WHOLE, tolerances: bool = False, seconds: float | None = None,
) -> Optimised:  # fmt: skip
    """Search for the faces that keep best to the law of a design, over a field.

    Parameters
    ----------
    design : Design
    free : tuple of str
        What may change: "radii", "conic", "bending" (own radii a face; biconvex), "a4" (on paraboloids unless "conic"
        is free, too), "a6" on top of it and "a8" on top of that, "offset" (of lens 2; held otherwise). Terms of sixth and eighth
        order stay only where they lessen the error by more than a tenth.
    field : float or None, radians
        Half angle of the cone of rays; None: the design's `check.field`.
    progress : callable or None
    weights : tuple of (part of the field, weight)
        Cones whose mean square errors are weighed against each other; default the field alone.
    tolerances : bool
        Seek the least expected error of parts made with the design's [tolerances], not of the perfect part.
    seconds : float or None
        End the search after so long with the best so far. A search that ends by itself before gives the same with
        any number of seconds.

    Returns
    -------
    Optimised
        The same for the same input, whatever the machine's speed. KeyboardInterrupt ends the search and returns
        the best so far.

    Raises
    ------
    DesignError
        A word that cannot be free; a weight that is none; or no faces were found that keep within the walls.
    NoTolerances
        `tolerances`, and the design states none.
    """
    window = equal_cells(prescribe(design), "a search for better faces", ALIKE)
    unknowns = chosen(window, tuple(free))
    aim = Aim(design.check.field if field is None else field, tuple(weights), tolerances)
    search = FaceSearch(
        design, window, unknowns, aim, progress, inf if seconds is None else monotonic() + seconds
    )
    before = tuple(measured(window, part * aim.field, design) for part in FIELDS)
    stopped = search.run()
    if stopped == "interrupted" and not search.gained:
        raise KeyboardInterrupt
    better = search.best_design(tuple(free))
    assert search.best is not None  # or it would have been said
    made = prescribe(better)
    if "offset" not in free:
        refuse_moved(window, made, traced=design.pair.offset == "traced")
    after = (
        () if stopped == "interrupted" else tuple(measured(made, part * aim.field, better) for part in FIELDS)
    )
    refuse_lost_light(before[: len(after)], after)
    expected = (search.error_of(window), search.best.rms) if tolerances else None
    return Optimised(
        better, design, tuple(free), search.left_out, aim, search.kept_unknowns, search.evaluations, before, after,
        expected, search.best.history, stopped,
    )  # fmt: skip


def outlook(
    design: Design, free: tuple[str, ...], weights: Weights = WHOLE, *, tolerances: bool = False
) -> dict[str, float]:
    """What a search will take: unknowns, evaluations and processor seconds of one core, by the model of one machine.

    Raises
    ------
    DesignError, NoTolerances
        As `optimise` of the same words.
    """
    window, aim = (
        equal_cells(prescribe(design), "a search for better faces", ALIKE),
        Aim(design.check.field, tuple(weights), tolerances),
    )
    unknowns = chosen(window, tuple(free))
    k = len(unknowns.free)
    evaluations = 10.0 + 0.8 * k * k  # measured: 16, 37, 34 and 379 of 4, 8, 10 and 20 unknowns
    each = (0.005 if unknowns.still else 0.02) * (1.5 if "a4" in free else 1.0) * len(weights)
    each += 0.008 * len(AimedRays.of(aim, design, window, k).errors)
    return {"unknowns": k, "evaluations": evaluations, "seconds": 0.6 + each * evaluations}
