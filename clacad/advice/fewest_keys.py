"""Search for the fewest keys that make a design pass with its law, or for the binding limits.

Sets of one key are tried first, then of two, three and four. Among sets of equal size, the one with the
smallest change is taken. Longer sets grow from the two shorter ones that are nearest to passing, and finally
lose every unnecessary key. A set that is found was tried and passes, but a set whose parts bring no
improvement may be missed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

from clacad.advice.hints import changes_text, outcome_text
from clacad.advice.judged import Judged
from clacad.advice.lever_trials import (
    Changes,
    NoMoreTrials,
    Trials,
    badness,
    levers_of,
    mends,
    settings,
    size_of,
)
from clacad.base.interactive import shown_progress
from clacad.base.text import plain
from clacad.base.types import Progress
from clacad.checks.check import Check
from clacad.checks.levers import UNBUILT, Lever
from clacad.config.edit_text import value_text
from clacad.design import Design
from clacad.design.sections import LATTICE, PAIR

TRIALS = 100
"""Largest number of designs that are tried."""

SECONDS = 15.0
"""Processor seconds after which no further design is tried; the nearest one so far is then the result."""

KEYS = 4
"""Number of keys of the longest set."""

BEAM = 2
"""Number of sets from which longer ones grow."""


@dataclass(frozen=True, eq=False)
class Fixed:
    """A design that passes, or the nearest one to passing.

    Attributes
    ----------
    design : Design
        With the changes.
    `asked` : Design
        Original design.
    changes : mapping
        Values by dotted key; empty where the design passes unchanged, or where no change brings it nearer.
    judged : Judged or None
        Checks of that design; None where neither it nor any trial can be built.
    tried : int
        Designs that were tried.
    """

    design: Design
    asked: Design
    changes: Changes
    judged: Judged | None
    tried: int

    @property
    def passes(self) -> bool:
        """Whether verify of the design will pass."""
        return self.judged is not None and self.judged.passes and (not self.changes or not self.judged.tight)

    @property
    def binding(self) -> tuple[Check, ...]:
        """Checks whose limits the nearest design does not meet; empty where it passes."""
        return () if self.judged is None or self.passes else self.judged.failing or self.judged.tight

    def rows(self) -> list[list[str]]:
        """Key, old value and new value of each change."""
        found = []
        for key, value in self.changes.items():
            section, name = key.split(".")
            was = self.asked.given.get(section, {}).get(name)
            found.append([key, "not given" if was is None else value_text(was), "->", value_text(value)])
        return found

    def __str__(self) -> str:
        """Return the result in one line."""
        if self.passes:
            return f"{changes_text(self.changes)} passes" if self.changes else "passes as it is"
        if self.judged is None:
            return f"nothing that can be built was found among {self.tried} designs tried"
        limits = "; ".join(
            f"{outcome_text([c])} from {c.limit_source.heading}" for c in _each_id(self.binding)
        )
        nearest = f" at {changes_text(self.changes)}" if self.changes else " as it is"
        return f"nothing passes of {self.tried} designs tried; these limits bind, nearest{nearest}: {limits}"

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        found = {
            "passes": self.passes,
            "changes": dict(self.changes),
            "tried": self.tried,
            "text": str(self),
            "binding": [c.to_dict() for c in self.binding],
        }
        return dict(plain(found))


def _each_id(checks: Sequence[Check]) -> list[Check]:
    return list({c.id: c for c in reversed(checks)}.values())[::-1]


def fix(design: Design, progress: Progress | None = None) -> Fixed:
    """Change the fewest keys so that a design passes; law, material, process and all limits are kept.

    Parameters
    ----------
    design : Design
        Design to change; it may be one that cannot be built.
    progress : callable or None
        Called with a stage's name and the part done, 0 … 1.

    Returns
    -------
    Fixed
        Its `passes` is False if no trial passes.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]", "check.law_rms = 0.02 mrad"])
    >>> fixed = clacad.fix(design)
    >>> fixed.passes, fixed.changes
    (True, {'pair.separation': 14})
    """
    trials = Trials(design, TRIALS, shown_progress(progress), SECONDS)
    asked = trials.judged({})
    if asked is not None and asked.passes:
        return Fixed(design, design, {}, asked, 1)
    start = _state(trials, {})
    best, beam = start, [start]
    try:
        for _ in range(KEYS):
            if best.bad == 0.0:
                break
            grown = [state for one in beam for state in _grown(trials, one)]
            beam = sorted(_unlike(grown), key=lambda state: (state.bad, state.size))[:BEAM]
            best = min([best, *beam], key=lambda state: (state.bad, state.size))
    except NoMoreTrials:
        pass
    changes = _pruned(trials, best.changes) if best.bad == 0.0 else best.changes
    changed = design.replace(changes) if changes else design
    return Fixed(changed, design, changes, trials.judged(changes), trials.tried)


def _pruned(trials: Trials, changes: Changes) -> Changes:
    """Set of changes without unnecessary keys: the first keys of a longer set may have become unnecessary."""
    trials.most, trials.seconds = trials.most + len(changes), inf
    for key in changes:
        less = {k: v for k, v in changes.items() if k != key and (k, key) != (LATTICE.count, LATTICE.pitch)}
        if key != LATTICE.count and less and badness(trials.judged(less), trials.design) == 0.0:
            changes = less
    return changes


@dataclass(frozen=True, slots=True)
class _Changed:
    """A set of changes, its distance from passing, and its size."""

    changes: Changes
    bad: float
    size: float


def _state(trials: Trials, changes: Changes) -> _Changed:
    return _Changed(changes, badness(trials.judged(changes), trials.design), size_of(changes, trials.design))


def _unlike(states: Sequence[_Changed]) -> list[_Changed]:
    """States with different changes, those without a result left out."""
    found: list[_Changed] = []
    for state in states:
        if state.bad < inf and not any(state.changes == other.changes for other in found):
            found.append(state)
    return found


def _grown(trials: Trials, state: _Changed) -> list[_Changed]:
    """States with one more changed key, for each lever that may help."""
    judged = trials.judged(state.changes)
    now = trials.design.replace(state.changes) if state.changes else trials.design
    failing = () if judged is None else judged.failing
    levers = UNBUILT if judged is None else levers_of(now, failing)
    found = []
    for lever in levers:
        if (
            lever.key in state.changes and lever.way != "shape"
        ):  # a shape is tuned again for the later changes
            continue
        changes = _pulled(trials, state.changes, lever, now, judged, failing)
        if changes is not None:
            found.append(_state(trials, changes))
    return found


def _pulled(
    trials: Trials,
    before: Changes,
    lever: Lever,
    now: Design,
    judged: Judged | None,
    failing: Sequence[Check],
) -> Changes | None:
    """Nearest setting of a lever that mends all its checks, or else the trial that is nearest to passing."""
    mine = [c for c in failing if mends(lever, c)]
    values = settings(lever, now, judged, failing)
    if lever.way == "shape":
        tuned = {k: before[k] for k in (PAIR.surface, PAIR.conic) if PAIR.conic in before}
        return trials.shaped(before, (tuned,) if tuned else values)
    met = trials.nearest(before, values, mine)
    if met is not None:
        return met
    tried = [{**before, **one} for one in values if trials.knows({**before, **one})]
    scored = [(badness(trials.judged(one), trials.design), k) for k, one in enumerate(tried)]
    return tried[min(scored)[1]] if scored else None
