"""Trials: changed designs, each built and judged only once; search for the nearest sufficient value of a
lever.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import inf
from time import process_time

from clacad.advice.judged import Judged, judge, tight
from clacad.advice.levers import CONIC_STEPS, Changes, conics_about
from clacad.base.text import plain
from clacad.base.types import Progress, silent
from clacad.checks.check import Check, wrong
from clacad.design import Design, DesignError

Wish = Callable[[Judged], bool]
"""Predicate that returns whether a trial is sufficient."""

STAGE = "trying changed keys"


class NoMoreTrials(Exception):
    """The limit on the number or the time of trials is reached."""


@dataclass(eq=False)
class Trials:
    """Tried designs by their changes.

    Parameters
    ----------
    design : Design
        Design before any change.
    most : int
        Largest number of trials.
    progress : callable
        Called with the stage and the part of the trials made.
    seconds : float
        Processor seconds after which no trial is begun.
    """

    design: Design
    most: int
    progress: Progress = silent
    seconds: float = inf
    made: dict[str, Judged | None] = field(default_factory=dict)
    _begun: float = field(default_factory=process_time)

    def judged(self, changes: Changes) -> Judged | None:
        """The design with some changed keys, judged; None where it is invalid or cannot be built.

        Raises
        ------
        NoMoreTrials
        """
        name = _name(changes)
        if name not in self.made:
            if len(self.made) >= self.most or process_time() - self._begun > self.seconds:
                raise NoMoreTrials
            self.progress(STAGE, len(self.made) / self.most)
            try:
                self.made[name] = judge(self.design.replace(changes) if changes else self.design)
            except DesignError:
                self.made[name] = None
        return self.made[name]

    def knows(self, changes: Changes) -> bool:
        """Whether the design with these keys changed was tried."""
        return _name(changes) in self.made

    def nearest(self, before: Changes, settings: Sequence[Changes], wish: Wish) -> Changes | None:
        """First of a lever's settings, added to earlier changes, that is sufficient; None if none is found.

        Settings are tried in growing strides, then by bisection. The result is the nearest one if no farther
        setting is insufficient again.
        """

        def does(k: int) -> bool:
            judged = self.judged({**before, **settings[k]})
            return judged is not None and wish(judged)

        failed, stride = -1, 1
        while failed < len(settings) - 1:
            here = min(failed + stride, len(settings) - 1)
            if does(here):
                while here - failed > 1:
                    middle = (failed + here) // 2
                    failed, here = (failed, middle) if does(middle) else (middle, here)
                return {**before, **settings[here]}
            failed, stride = here, 2 * stride
        return None

    def shaped(self, before: Changes, settings: Sequence[Changes]) -> Changes | None:
        """The conic that is nearest to passing, among some settings and then finer ones; None if none can be
        built.
        """
        bad, best = min(
            ((self._bad({**before, **one}), k) for k, one in enumerate(settings)), default=(inf, 0)
        )
        if bad == inf:
            return None
        found: Changes = {**before, **settings[best]}
        for step in CONIC_STEPS:
            for one in conics_about(found, step):
                if bad > 0.0 and (now := self._bad(one)) < bad:
                    bad, found = now, one
        return found

    def _bad(self, changes: Changes) -> float:
        return badness(self.judged(changes), self.design)


def _name(changes: Changes) -> str:
    return repr(sorted(plain(dict(changes)).items()))


def found_in(judged: Judged, check: Check) -> Check | None:
    """The corresponding check of another trial, which is traced only for a check by light."""
    of_rules = next((c for c in judged.rules if (c.id, c.subject) == (check.id, check.subject)), None)
    if of_rules is not None:
        return of_rules
    return next((c for c in judged.checks if (c.id, c.subject) == (check.id, check.subject)), None)


def settled(judged: Judged, check: Check) -> bool:
    """Whether a trial mends a check: it passes clearly, warns instead of failing, is allowed, or no longer
    applies.
    """
    now = found_in(judged, check)
    if now is None:
        return True  # a body or step that no longer exists
    if now.state == "pass" and tight(now):
        return False
    return now.state == "pass" or "accepted" in now.detail or (check.state == "fail" and now.state == "warn")


def badness(judged: Judged | None, design: Design) -> float:
    """Distance of a trial from passing: 0 if it surely passes; each failing check counts 0.5 plus up to 1 by
    its excess.
    """
    if judged is None:
        return inf
    return sum(0.5 + _beyond(check, design) for check in wrong(judged.checks)) + 0.1 * len(judged.tight)


def _beyond(check: Check, design: Design) -> float:
    """Excess of a check over its limit, 0 … 1."""
    if not (isinstance(check.value, float) and isinstance(check.limit, float)):
        return 1.0
    scale = max(abs(check.limit), abs(check.value) if check.relation == "<=" else 0.0)
    if scale == 0.0:
        scale = max(design.lattice.pitch)
    return min(1.0, abs(check.value - check.limit) / scale)
