"""Hints that mend each check that fails or warns: one key and its value, tried before it is reported.

Sharper faces at no cost: the conic constant −1/n² of a slab's lenses, where a design has ellipsoids.

A slab's lens focuses inside the material, where an ellipsoid of conic constant −1/n² along the axis has no
spherical
aberration: parallel light is focused in one point. The tool, the radii and the heights stay the same within
1 µm, so the change needs no search and costs nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from clacad.advice.judged import Judged, judge
from clacad.advice.lever_trials import (
    Changes,
    NoMoreTrials,
    Trials,
    found_in,
    is_tried,
    levers_of,
    mends,
    settings,
    settled,
    size_of,
)
from clacad.base.text import digits, plain, shown
from clacad.base.types import Progress
from clacad.checks.check import Check
from clacad.checks.levers import Lever
from clacad.checks.light_kinds import LAW_RMS
from clacad.config.edit_text import value_text
from clacad.design import Design
from clacad.design.sections import PAIR

CHANGES: Final[Changes] = {PAIR.surface: "biconic"}

WORTH: Final = 0.9
"""Largest share of the error that may remain for the change to be advised."""


@dataclass(frozen=True, slots=True)
class Sharper:
    """Keys that make light sharper and cost nothing, tried.

    changes : Values by dotted key.
    before, after : radians. Rms error to the law.
    """

    changes: Changes
    before: float
    after: float

    def __str__(self) -> str:
        """Return one line."""
        times = self.before / self.after
        return (
            'pair.surface = "biconic" (conic constants -1/n²) costs nothing: law_rms'
            f" {digits(1e3 * self.after, count=3)} instead of {digits(1e3 * self.before, count=3)} mrad,"
            f" {times:.2g} times better"
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        return {"changes": dict(self.changes), "law_rms": [self.before, self.after], "text": str(self)}


def sharper(judged: Judged, trials: Trials) -> Sharper | None:
    """Change at no cost, if the design is a slab of ellipsoids and the traced error falls enough."""
    pair = judged.design.pair
    if (
        pair.form != "slab"
        or pair.given
        or pair.layers
        or pair.surface != "ellipsoid"
        or pair.depth is not None
    ):
        return None
    try:
        after = trials.judged(CHANGES)
    except NoMoreTrials:
        return None
    if after is None or len(after.failing) > len(judged.failing):
        return None
    before, least = (one.measured(LAW_RMS) for one in (judged, after))
    return Sharper(CHANGES, before, least) if least < WORTH * before else None


TRIALS = 60
"""Largest number of designs that are tried: about 10 s."""

SECONDS = 20.0
"""Processor seconds after which `check` tries no more; strongly tilted designs take seconds each."""

MOST = 3
"""Largest number of hints that are reported for each check."""


@dataclass(frozen=True, eq=False)
class Hint:
    """Changed keys and their effect.

    Attributes
    ----------
    changes : mapping
        Values by dotted key.
    mends : tuple of Check
        Checks that failed or warned and do so no more after the change.
    passes : bool
        Whether verify of the changed design will pass.
    left : tuple of Check
        Checks of the changed design that fail, or that warn and did not before.
    """

    changes: Changes
    mends: tuple[Check, ...]
    passes: bool
    left: tuple[Check, ...]

    def __str__(self) -> str:
        """Return one line: "pair.separation = 16 passes: law_rms 2.7 of 3 mrad"."""
        return (
            f"{changes_text(self.changes)} {'passes' if self.passes else 'mends'}: {outcome_text(self.mends)}"
            + (
                f"; {'warns' if self.passes else 'fails'} then: {outcome_text(self.left)}"
                if self.left
                else ""
            )
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        found = {
            "changes": dict(self.changes),
            "passes": self.passes,
            "mends": [c.to_dict() for c in self.mends],
            "left": [c.to_dict() for c in self.left],
            "text": str(self),
        }
        return dict(plain(found))


@dataclass(frozen=True, eq=False)
class Advice:
    """A judged design, with hints for each check that fails or warns.

    Attributes
    ----------
    judged : Judged
    hints : tuple of (Check, tuple of Hint)
        Hints for each check, the best first; none where no single key mends the check.
    tried : int
        Designs that were tried.
    sharper : Sharper or None
        Change that makes light sharper at no cost, whether or not a check fails.
    """

    judged: Judged
    hints: tuple[tuple[Check, tuple[Hint, ...]], ...]
    tried: int
    sharper: Sharper | None = None

    def of(self, check: Check) -> tuple[Hint, ...]:
        """Hints for one check of the design."""
        return next((hints for one, hints in self.hints if one is check), ())

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        rows = [
            {
                "check": check.id,
                "subject": check.subject,
                "state": check.state,
                "hints": [h.to_dict() for h in hints],
            }
            for check, hints in self.hints
        ]
        free = None if self.sharper is None else self.sharper.to_dict()
        return {"tried": self.tried, "checks": rows, "sharper": free}


def advise(design: Design, progress: Progress | None = None, judged: Judged | None = None) -> Advice:
    """Suggest a remedy for each check that fails or warns: a key and a value that mend it; each was tried.

    Parameters
    ----------
    design : Design
    progress : callable or None
        Called with a stage's name and the part done, 0 … 1.
    judged : Judged or None
        Checks of the design, if it was judged already.

    Raises
    ------
    DesignError
        The design cannot be built; `clacad.fix` looks for one that can.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]", "check.law_rms = 0.02 mrad"])
    >>> advice = clacad.advise(design)
    >>> for check, hints in advice.hints:
    ...     print(check.id, "|", hints[0])
    law_rms | pair.separation = 14 passes: law_rms 0.018223 mrad (<= 0.02)
    """
    from clacad.base.interactive import shown_progress

    judged = judge(design) if judged is None else judged
    trials = Trials(design, TRIALS, shown_progress(progress), SECONDS, _worst_cell(judged))
    wanted = [*judged.failing, *judged.warning]
    found: list[Changes] = []
    try:
        for group in (judged.failing, judged.warning):
            for lever in levers_of(design, group):
                found += _settings_that_mend(trials, judged, lever, [c for c in group if mends(lever, c)])
    except NoMoreTrials:
        pass
    hints = [
        h for h in (_hint(trials, judged, changes) for changes in _each_once(found)) if not _breaks(judged, h)
    ]
    ranked = sorted(hints, key=lambda hint: (not hint.passes, len(hint.left), size_of(hint.changes, design)))
    hinted = ((check, tuple(h for h in ranked if _names(h, check))[:MOST]) for check in wanted)
    told = tuple((check, of_it) for check, of_it in hinted if of_it or is_tried(check))
    free = sharper(judged, trials)
    return Advice(judged, told, trials.tried, free)


def _worst_cell(judged: Judged) -> Design | None:
    """Uniform design of the cell by which a sheet is judged; None if it does not change as its sheet does."""
    from clacad.prescription.prescribe import design_of_cell

    design, found = judged.design, LAW_RMS.first(judged.checks)
    placed = design.lattice.pitch_2 is not None or design.lattice.rotation_2
    if judged.window.uniform or design.pair.focus is not None or placed or found is None:
        return None
    return design_of_cell(design, judged.window, tuple(found.detail["cell"]))


def _settings_that_mend(
    trials: Trials, judged: Judged, lever: Lever, checks: Sequence[Check]
) -> list[Changes]:
    """Nearest setting of a lever that mends all these checks, or else the nearest setting for each check."""
    values = settings(lever, trials.design, judged, checks)
    if lever.way == "shape":
        shaped = trials.shaped({}, values)
        after = None if shaped is None else trials.judged(shaped)
        does = after is not None and any(settled(after, c) for c in checks)
        return [shaped] if shaped is not None and does else []
    together = trials.nearest({}, values, checks)
    if together is not None:
        return [together]
    if len(checks) == 1:
        return []
    each = (trials.nearest({}, values, [check]) for check in checks)
    return [changes for changes in each if changes is not None]


def _each_once(found: Sequence[Changes]) -> list[Changes]:
    kept: list[Changes] = []
    for changes in found:
        if changes not in kept:
            kept.append(changes)
    return kept


def _hint(trials: Trials, before: Judged, changes: Changes) -> Hint:
    """Effect of a tried change on every check."""
    after = trials.judged(changes)
    assert after is not None  # it mended something
    mended = [c for c in (*before.failing, *before.warning) if settled(after, c)]
    now = tuple(found for c in mended if (found := found_in(after, c)) is not None)
    warned = {(c.id, c.subject) for c in before.warning}
    fresh = [c for c in after.warning if (c.id, c.subject) not in warned and c.id not in {m.id for m in now}]
    left = after.failing or after.tight
    return Hint(changes, now, not left, left or tuple(fresh))


def _breaks(judged: Judged, hint: Hint) -> bool:
    """Whether a hint makes another check fail; such a hint is not given."""
    failed = {(c.id, c.subject) for c in judged.failing}
    return not hint.passes and any((c.id, c.subject) not in failed for c in hint.left)


def _names(hint: Hint, check: Check) -> bool:
    return any((c.id, c.subject) == (check.id, check.subject) for c in hint.mends)


def changes_text(changes: Changes) -> str:
    """Return changed keys as written in a file: "lattice.pitch = 0.8 with lattice.count = [88, 101]"."""
    return " with ".join(f"{key} = {value_text(value)}" for key, value in changes.items())


def outcome_text(checks: Sequence[Check]) -> str:
    """Return measured values of checks with their limits: "law_rms 2.7 of 3 mrad, cover 1 of 1"."""
    said: dict[str, str] = {}
    for check in checks:
        value, limit, unit, _ = shown(check.value, check.limit, check.relation, check.unit, check.state)
        if check.value is None:
            value, limit = "does not run", ""
        against = f" ({check.relation} {limit})" if limit and isinstance(check.limit, float) else ""
        warns = ", a warning" if check.state == "warn" else ""
        said.setdefault(check.id, f"{check.id} {value} {unit}".rstrip() + against + warns)
    return ", ".join(said.values())
