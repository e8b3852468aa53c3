"""Levers: the keys that may mend each check, their trial values, and trials of changed designs.

The law, the material, the process and all of [check], the viewer included, are requirements and stay fixed;
so does each of `INTENTS` that a design states. Only the construction of the pair may change. A sheet with
another pitch keeps its size: `lattice.count` follows `lattice.pitch`. Each changed design is built and
judged only once; the nearest values are tried first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, inf, isfinite, log10
from time import process_time
from typing import Any, Final, TypeVar

from clacad.advice.judged import POINT_RAYS, RAYS, Judged, judge, tight
from clacad.base.text import plain
from clacad.base.types import Progress, silent
from clacad.checks.check import Check, accepted, kinds, wrong
from clacad.checks.levers import FORMS, WORDS, Lever
from clacad.checks.light_kinds import LAW_BIAS, LAW_RMS, VIEWED
from clacad.design import Design, DesignError
from clacad.design.sections import BODY, LATTICE, PAIR
from clacad.prescription.prescribe import prescribe
from clacad.verification.light.law_checks import law_checks, light_through

T = TypeVar("T")

Changes = Mapping[str, Any]
"""Values by dotted key, as `Design.replace` takes them."""

FARTHEST: Final = 8.0
"""Largest factor on a length in a trial."""

STEP: Final = 1.07
"""Ratio of neighbouring trial values of a length: they differ in the second digit."""

SHARES: Final = (0.01, 0.015, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0)
"""Trial values, as shares of the pitch, of a length that may be 0."""

CONICS: Final = (-0.5, -1.0, -1.5, -2.0, -2.5, -3.5)
"""Trial conic constants; -1/n² and -n² lie in their range for every glass."""

CONIC_STEPS: Final = (0.25, 0.12, 0.06, 0.03)
"""Steps around the best of `CONICS`."""

ROOM: Final = 1.3
"""A process's length is also tried at this factor of the limit: from 1.25 on it is no longer near."""


INTENTS: Final = frozenset({LATTICE.aperture, BODY.border})
"""Keys that stay fixed where the design states them: the direction of its cells, and its flange."""

MOST_AIMED: Final = 5000
"""Largest number of cells of a sheet that is tried with aimed cells: tracing takes 1 ms per cell."""

OF_CELL: Final = frozenset(
    {PAIR.separation, PAIR.thickness, PAIR.surface, PAIR.conic, LATTICE.pitch, LATTICE.count}
)
"""Keys by which a cell changes as its sheet does."""

CLEARLY: Final = 1.1
"""Factor on a limit of the law beyond which light of a cell decides for its sheet: the cell's place among
neighbours that differ changes it by 4 %."""

_HELD: Final = (PAIR.separation, PAIR.thickness, LATTICE.pitch, LATTICE.aperture)
"""Keys that `clacad optimise` keeps fixed: its faces are those of the pair with these values."""


def is_tried(check: Check) -> bool:
    """Whether keys are tried for a check: not for an assumed eye, where `viewed` names what was tried."""
    return check.kind is not VIEWED or check.state == "fail"


def levers_of(design: Design, checks: Iterable[Check]) -> tuple[Lever, ...]:
    """Levers that may mend some of these checks in a design of this form, each once.

    None changes an intent of the design, or undoes a search for its faces.
    """
    mended = [kinds()[check.id] for check in checks if is_tried(check)]
    found = dict.fromkeys(lever for kind in mended for lever in kind.levers)
    form = design.pair.form
    fitting = (lever for lever in found if form in FORMS.get(lever.key, (form,)))
    return tuple(lever for lever in fitting if not _is_held(lever, design))


def _is_held(lever: Lever, design: Design) -> bool:
    """Whether a lever would undo a search for faces, or change an intent: a key stated as a requirement."""
    section, name = lever.key.split(".")
    stated = lever.key in INTENTS and name in design.given.get(section, {})
    return stated or (design.pair.search is not None and lever.key in _HELD)


def mends(lever: Lever, check: Check) -> bool:
    """Whether a lever is one of those for a check."""
    return lever in check.kind.levers


def settings(
    lever: Lever, design: Design, judged: Judged | None, checks: Iterable[Check]
) -> tuple[Changes, ...]:
    """Trial settings of a lever, nearest to the design's value first.

    judged : Checks of the design; None where it cannot be built.
    checks : Checks to mend: a length is also tried at their limits.
    """
    if lever.way == "aim":
        return _aimed(design)
    if lever.way == "word":
        present = getattr(design.pair, lever.key.partition(".")[2], design.lattice.aperture)
        return tuple({lever.key: word} for word in WORDS[lever.key] if word != present)
    if lever.way == "shape":
        return tuple(_conic(k, k) for k in CONICS)
    making: Callable[[Design, str, Judged | None], tuple[Changes, ...]] | None = _SCALED.get(lever.key)
    if making is not None:
        return making(design, lever.way, judged)
    if lever.key == PAIR.thickness:
        return _thicknesses(design, lever.way, judged, _lacking(design, checks, lever))
    return tuple({lever.key: value} for value in _lengths(lever, design, checks))


def _aimed(design: Design) -> tuple[Changes, ...]:
    """Setting of cells aimed at the eye of [check]; none where there are more than `MOST_AIMED` cells."""
    n1, n2 = design.lattice.count
    if design.check.viewer is None or n1 * n2 > MOST_AIMED:
        return ()
    return ({LATTICE.aperture: {"point": [0, 0, -nice(design.check.viewer, 12)]}},)


def _conic(x: float, y: float) -> Changes:
    return {PAIR.surface: "biconic", PAIR.conic: [nice(x, 3), nice(y, 3)]}


def conics_about(changes: Changes, step: float) -> tuple[Changes, ...]:
    """Changes with the conic constant of one meridian decreased, and increased, by a step."""
    x, y = changes[PAIR.conic]
    beside = ((x - step, y), (x + step, y), (x, y - step), (x, y + step))
    return tuple({**changes, **_conic(*one)} for one in beside)


def _separations(design: Design, way: str, _: Judged | None) -> tuple[Changes, ...]:
    """Settings of the separation, or of the thickness for a slab that states it instead."""
    if design.pair.separation is not None:
        return tuple({PAIR.separation: value} for value in _ladder(design.pair.separation, way))
    thickness = design.pair.thicknesses
    return () if thickness is None else tuple({PAIR.thickness: v} for v in _ladder(thickness[0], way))


def _pitches(design: Design, way: str, _: Judged | None) -> tuple[Changes, ...]:
    """Settings of the pitch; both pitches of a rectangular lattice change by one factor."""
    old, found = design.lattice.pitch, []
    for new in _ladder(max(old), way):
        factor = new / max(old)
        both = [new if p == max(old) else nice(p * factor, 3) for p in old]
        changes: dict[str, Any] = {LATTICE.pitch: both if design.lattice.kind == "rectangular" else new}
        if "count" in design.given.get("lattice", {}):
            rounded = ceil if design.lattice.outline is not None else round
            changes[LATTICE.count] = [
                max(1, rounded(n * a / b - 1e-9))
                for n, a, b in zip(design.lattice.count, old, both, strict=True)
            ]
        found.append(changes)
    return tuple(found)


def _lacking(design: Design, checks: Iterable[Check], lever: Lever) -> float:
    """Largest shortfall of a length among some checks, measured until the limit is no longer near."""
    found = [
        c.limit * ROOM - c.value
        for c in checks
        if mends(lever, c)
        and isinstance(c.value, float)
        and isinstance(c.limit, float)
        and c.unit == design.unit
        and isfinite(c.limit)
        and isfinite(c.value)
    ]
    return max([0.0, *found])


def _thicknesses(design: Design, way: str, judged: Judged | None, lack: float) -> tuple[Changes, ...]:
    """The word auto, then numbers from the present thickness: by ratio, and by shares of the shortfall."""
    given = design.pair.thicknesses
    auto: tuple[Changes, ...] = () if given is None else ({PAIR.thickness: "auto"},)
    if given is None and judged is not None:
        first, second = (nice(lens.thickness, 3) for lens in judged.facts.lenses[:2])
        given = (first, second)
    if given is None:
        return auto
    found = [[nice(t * value / given[0]) for t in given] for value in _ladder(given[0], way)]
    if way == "up":
        found += [[nice(t + 0.25 * part * lack) for t in given] for part in range(1, 9) if lack > 0.0]
    found = [
        pair for pair in found if all((a > t) == (way == "up") for a, t in zip(pair, given, strict=True))
    ]
    same = given[0] == given[1]
    return (*auto, *({PAIR.thickness: pair[0] if same else pair} for pair in sorted(found)))


_SCALED: Final = {PAIR.separation: _separations, LATTICE.pitch: _pitches}


def _lengths(lever: Lever, design: Design, checks: Iterable[Check]) -> list[float]:
    """Values of a length that may be 0: shares of the pitch, and the limits of failing checks of a length."""
    section, name = lever.key.split(".")
    present = getattr(getattr(design, section), name) or 0.0
    if lever.way == "down":
        return [0.0] if present > 0.0 else []
    asked = [
        nice(c.limit * ROOM)
        for c in checks
        if mends(lever, c) and isinstance(c.limit, float) and c.unit == design.unit and isfinite(c.limit)
    ]
    values = {nice(share * min(design.lattice.pitch)) for share in SHARES} | set(asked)
    return sorted(v for v in values if v > present)


def _ladder(present: float, way: str) -> list[float]:
    """Values from a length up or down, of two digits where those distinguish them."""
    found: list[float] = []
    factor = STEP
    while factor <= FARTHEST:
        value = nice(present * factor if way == "up" else present / factor)
        if value not in found and (value > present if way == "up" else value < present):
            found.append(value)
        factor *= STEP
    return found


def nice(value: float, count: int = 2) -> float:
    """Value rounded to `count` digits; a whole number becomes an int, written without a point."""
    rounded = float(f"{value:.{count - 1}e}")
    return int(rounded) if rounded.is_integer() and abs(rounded) < 1e6 else rounded


def size_of(changes: Changes, design: Design) -> float:
    """Size of changes, to choose among equally many: for a length the weighted logarithm of its ratio."""
    total = 0.0
    for key, value in changes.items():
        section, name = key.split(".")
        present = getattr(getattr(design, section), name)
        if key == LATTICE.count:
            continue  # follows the pitch
        if isinstance(value, str | bool) or isinstance(present, str) or not present:
            total += WEIGHTS.get(key, 0.05)
        else:
            new, old = (max(v) if isinstance(v, list | tuple) else v for v in (value, present))
            total += WEIGHTS.get(key, 1.0) * abs(log10(new / old)) if new else 0.05
    return total


WEIGHTS: Final = {
    LATTICE.pitch: 1.5,
    PAIR.surface: 0.15,
    LATTICE.aperture: 0.2,
    PAIR.thickness: 0.3,
    PAIR.field_lens: 0.6,
}
"""Weight of a change of a key: other cells mean other pixels, faces other tools, an aperture another view."""


STAGE = "trying changed keys"


class NoMoreTrials(Exception):
    """The limit on the number or the time of trials is reached."""


@dataclass(eq=False)
class Trials:
    """Tried designs by their changes.

    design : Design before any change.
    most : Largest number of trials.
    progress : Called with the stage and the part of the trials made.
    seconds : Processor seconds after which no trial is begun.
    cell : Uniform design of the cell by which a non-uniform sheet is judged: changes by which light of this
        cell clearly fails are not tried on the sheet. None: every change is.
    """

    design: Design
    most: int
    progress: Progress = silent
    seconds: float = inf
    cell: Design | None = None
    made: dict[str, Judged | None] = field(default_factory=dict)
    of_cell: dict[str, tuple[Check, ...] | None] = field(default_factory=dict)
    _begun: float = field(default_factory=process_time)

    def judged(self, changes: Changes) -> Judged | None:
        """The design with some changed keys, judged; None where it is invalid or cannot be built.

        Raises NoMoreTrials.
        """
        return self._kept(self.made, self.design, changes, lambda one: judge(one, judged_only=True))

    def _kept(
        self, known: dict[str, T | None], design: Design, changes: Changes, make: Callable[[Design], T]
    ) -> T | None:
        name = _name(changes)
        if name not in known:
            if name not in self.of_cell:  # else it is the same trial
                if self.tried >= self.most or process_time() - self._begun > self.seconds:
                    raise NoMoreTrials
                self.progress(STAGE, self.tried / self.most)
            try:
                known[name] = make(design.replace(changes) if changes else design)
            except DesignError:
                known[name] = None
        return known[name]

    def _fails_in_cell(self, changes: Changes, checks: Sequence[Check]) -> bool:
        """Whether a check of the law clearly fails in one cell of the changed sheet."""
        law = [check.kind for check in checks if check.kind in (LAW_RMS, LAW_BIAS)]
        if self.cell is None or not law or not set(changes) <= OF_CELL or self.knows(changes):
            return False
        judged = self._kept(self.of_cell, self.cell, changes, _law_of)
        found = [kind.first(judged or ()) for kind in law]
        return any(
            isinstance(one.value, float) and isinstance(one.limit, float) and one.value > CLEARLY * one.limit
            for one in found
            if one is not None
        )

    @property
    def tried(self) -> int:
        """Designs that were tried, on the sheet or in one cell."""
        return len({*self.made, *self.of_cell})

    def knows(self, changes: Changes) -> bool:
        """Whether the design with these keys changed was tried."""
        return _name(changes) in self.made

    def nearest(
        self, before: Changes, settings: Sequence[Changes], checks: Sequence[Check]
    ) -> Changes | None:
        """First of a lever's settings, added to earlier changes, that mends all checks; None if none does.

        Settings are tried in growing strides, then by bisection. The result is the nearest one if no farther
        setting is insufficient again.
        """

        def does(k: int) -> bool:
            if self._fails_in_cell({**before, **settings[k]}, checks):
                return False
            judged = self.judged({**before, **settings[k]})
            return judged is not None and all(settled(judged, c) for c in checks)

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
        """Conic nearest to passing, among some settings and then finer ones; None if none can be built."""
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


def _law_of(design: Design) -> tuple[Check, ...]:
    """Checks of the law by light through a uniform sheet."""
    return tuple(law_checks(light_through(design, prescribe(design), RAYS, POINT_RAYS)))


def _name(changes: Changes) -> str:
    return repr(sorted(plain(dict(changes)).items()))


def found_in(judged: Judged, check: Check) -> Check | None:
    """The corresponding check of another trial, which is traced only for a check by light and then first."""

    def by_light() -> tuple[Check, ...]:
        return accepted(judged.light, judged.design)

    parts = (by_light, lambda: judged.rules) if check.bundle else (lambda: judged.rules, by_light)
    for part in (*parts, lambda: judged.checks):
        found = next((c for c in part() if (c.id, c.subject) == (check.id, check.subject)), None)
        if found is not None:
            return found
    return None


def settled(judged: Judged, check: Check) -> bool:
    """Whether a trial mends a check: it clearly passes, warns after failing, is allowed, or is gone."""
    now = found_in(judged, check)
    if now is None:
        return True  # a body or step that no longer exists
    if now.state == "pass" and tight(now):
        return False
    return now.state == "pass" or "accepted" in now.detail or (check.state == "fail" and now.state == "warn")


def badness(judged: Judged | None, design: Design) -> float:
    """Distance of a trial from passing: 0 if it surely does; a failing check counts 0.5 up to 1.5."""
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
