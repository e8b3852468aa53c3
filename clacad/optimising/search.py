"""Search for better faces of a design with the same law."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from time import monotonic
from typing import Any

from clacad.design import Design
from clacad.design.faces import face_table
from clacad.optimising.aim import RAYS, WHOLE, Aim, AimedRays, Weights
from clacad.optimising.face_search import FaceSearch, Progress
from clacad.optimising.measured_light import FIELDS, Seen, measured
from clacad.optimising.unknowns import chosen
from clacad.optimising.what_stays import refuse_lost_light, refuse_moved
from clacad.prescription.prescribe import prescribe
from clacad.sheet.need_window import equal_cells

ALIKE = "a slope as lattice.aperture stands all cells alike"
"""Suggested input of a search for a non-uniform sheet."""


@dataclass(frozen=True, eq=False)
class Optimised:
    """Result of a search.

    Parameters
    ----------
    design : Design
        Design with the found faces; passes the design rules if the start did.
    start : Design
    free : tuple of str
        Words of the request.
    left_out : tuple of str
        Words of `free` that would have reduced the error by less than a tenth and were left unchanged.
    aim : Aim
    unknowns, evaluations : int
    before, after : tuple of Seen
        Start and end at ½, 1 and 2 × the field; empty after an interruption.
    expected : (float, float) or None, radians
        Expected rms error of parts as made, start and end, over the search's own rays; None without
        tolerances.
    history : tuple of (evaluations, rms error in radians)
        Best result within the walls at each improvement by a tenth, the first and the last; contains no
        times.
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
    """Search for the faces with the least error to the law of a design, over a field.

    Parameters
    ----------
    design : Design
    free : tuple of str
        Free parameters: "radii", "conic", "bending" (separate radii of both faces; biconvex), "a4" (on
        paraboloids unless "conic" is free, too), "a6" on top of it and "a8" on top of that, "offset" (of lens
        2; fixed otherwise). Terms of sixth and eighth order are kept only if they reduce the error by more
        than a tenth.
    field : float or None, radians
        Half angle of the cone of rays; None: the design's `check.field`.
    progress : callable or None
    weights : tuple of (part of the field, weight)
        Cones and the weights of their mean square errors; default the field alone.
    tolerances : bool
        Minimise the expected error of parts made with the design's [tolerances], not of the perfect part.
    seconds : float or None
        Time limit, after which the best result so far is returned. A search that finishes earlier does not
        depend on the limit.

    Returns
    -------
    Optimised
        Reproducible, regardless of the machine's speed. KeyboardInterrupt ends the search and returns the
        best result so far.

    Raises
    ------
    DesignError
        A word that cannot be free; a weight that is none; or no faces were found that keep within the walls.
    NoTolerances
        `tolerances` is True, and the design states none.
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
    assert search.best is not None  # otherwise the search raised before
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
    """Forecast of a search: unknowns, evaluations and processor seconds of one core of the reference machine.

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
