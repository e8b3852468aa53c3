"""From a wish to a design that passes: closed formulas say where to look, designs are built, traced and judged there.

Nothing is random: the same wish gives the same design.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf

from clacad.advice.candidate import Variant, built, round_to
from clacad.advice.first_numbers import (
    PitchBound,
    index_of,
    least_ratio,
    lower_pitches,
    shape_of,
    upper_pitches,
    wanted_pitch,
)
from clacad.advice.judged import Judged, judge
from clacad.advice.lens_shape import LensShapes
from clacad.advice.wish import Wish
from clacad.base.types import Progress, silent
from clacad.design import DesignError
from clacad.design.process_profiles import profile
from clacad.prescription.prescribe import prescribe
from clacad.verification.checks import Check

RATIOS = (
    3.0,
    4.0,
    5.0,
    6.0,
    7.0,
    8.0,
    10.0,
    12.0,
    14.0,
    17.0,
    20.0,
    24.0,
    28.0,
    34.0,
    40.0,
    48.0,
    56.0,
    68.0,
    80.0,
)
"""Separations in pitches that are tried."""

STEPS = 6
"""Of `RATIOS` upwards from the closed formula's."""

MOST_JUDGED = 40
"""Designs that are judged for one wish."""


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """A design that was judged; `pitch` says why it is what it is."""

    variant: Variant
    ratio: float
    pitch: PitchBound
    judged: Judged

    @property
    def good(self) -> bool:
        """Whether verify will pass, with room to spare."""
        return self.judged.passes and not self.judged.tight


@dataclass
class Search:
    """What was tried for a wish.

    Parameters
    ----------
    wish : Wish
    name : str
        Of the design.
    overrides : sequence of str
        "key=value" that every design keeps, as with --set.
    progress : callable
    tried : list of Tried
    refused : list of str
        Why others could not be built, or had no pitch.
    """

    wish: Wish
    name: str
    overrides: Sequence[str] = ()
    progress: Progress = silent
    tried: list[Tried] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)

    def run(self) -> Tried | None:
        """Try until a design passes without a warning that another could avoid; else the best of those that pass."""
        pitch = round_to(wanted_pitch(self.wish).value, 2, up=True)
        found: list[Tried] = []
        for variant, needed in LensShapes(self.wish, pitch, self.overrides, self.refused).variants():
            self.progress(f"trying {variant.form}", len(self.tried) / MOST_JUDGED)
            one = self._best_ratio(variant, needed)
            if one is not None:
                found.append(one)
                if avoidable(one, self.wish) == 0:
                    break
            if len(self.tried) >= MOST_JUDGED:
                break
        return min(found, key=lambda t: avoidable(t, self.wish), default=None)

    def _best_ratio(self, variant: Variant, needed: float) -> Tried | None:
        """The least separation in pitches at which a variant passes as sharp as a pixel; it has the widest field."""
        start = self._first(variant, needed)
        found, before = None, None
        for ratio in RATIOS[start : start + STEPS]:
            one = self._judged(variant, ratio)
            if one is not None and one.good:
                found = one
                break
            if one is not None and before is not None and _no_better(before, one):
                break
            before = one or before
        if found is None or found.ratio != RATIOS[start]:
            return found
        for ratio in reversed(
            [r for r in RATIOS[:start] if r >= needed]
        ):  # the formula may have been too careful
            one = self._judged(variant, ratio)
            if (
                one is None
                or not one.good
                or _rms(one) > self._sharp(one.pitch.value)
                or self._more(one, found)
            ):
                break
            found = one
        return found

    def _more(self, one: Tried, other: Tried) -> bool:
        return avoidable(one, self.wish) > avoidable(other, self.wish)

    def _first(self, variant: Variant, needed: float) -> int:
        """Index into `RATIOS` to begin at."""
        wanted = max(needed, least_ratio(self.wish, self._sharp(wanted_pitch(self.wish).value)))
        return next((k for k, ratio in enumerate(RATIOS) if ratio >= wanted), len(RATIOS) - 1)

    def _sharp(self, pitch: float) -> float:
        """Rms error (radians) that nobody sees: the angle of a pixel, but never beyond the limit."""
        return min(0.8 * 3e-3, pitch / self.wish.viewing)

    def _judged(self, variant: Variant, ratio: float) -> Tried | None:
        """The design at this separation, at the pitch that is wanted or the nearest one that the process allows."""
        bound = self.pitch_at(variant, ratio)
        if bound is None or len(self.tried) >= MOST_JUDGED:
            return None
        pitch = round_to(bound.value, 2, up=True)
        try:
            design = built(self.wish, variant, pitch, ratio, self.name, self.overrides)
            left = max(prescribe(design).residual.values(), default=0.0)
            if left > design.check.law_rms:  # fails whatever light does in the field
                self.refused.append(
                    f"{variant.form}: along the axis ray {1e3 * left:.3g} mrad are left of the law at {ratio:g} pitches"
                )
                return None
            one = Tried(variant, ratio, PitchBound(pitch, bound.why), judge(design))
        except DesignError as problem:
            self.refused.append(problem.mistakes[0].message)
            return None
        self.tried.append(one)
        return one

    def pitch_at(self, variant: Variant, ratio: float) -> PitchBound | None:
        """The pitch that looks best, or the nearest that can be made; None where none can."""
        shape = shape_of(variant.form, index_of(self.wish))
        low = max(lower_pitches(self.wish, ratio, shape), key=lambda b: b.value)
        high = min(upper_pitches(self.wish, ratio, shape), key=lambda b: b.value)
        wanted = wanted_pitch(self.wish)
        if low.value > high.value:
            self.refused.append(
                f"{low.why} asks for a pitch of {low.value:.3g} mm, {high.why} for {high.value:.3g} mm at most"
            )
            return None
        if wanted.value > high.value:
            return high
        return wanted if wanted.value >= low.value else low


def avoidable(tried: Tried, wish: Wish) -> float:
    """How much there is against a design that passes: warnings that come not from the wish alone, and being bulky."""
    rules = profile(wish.process)
    inherent = {"wall", "draft"} if wish.steps and (rules.wall < inf or rules.draft > 0.0) else set()
    if not wish.straight and rules.wall < inf:
        inherent |= {"field"}
    warnings = {check.id for check in tried.judged.warning} - inherent
    bodies = tried.judged.facts.bodies
    height = max(body.high for body in bodies) - min(body.low for body in bodies)
    return len(warnings) + 0.5 * (height > max(wish.size.size))


def _rms(tried: Tried) -> float:
    value = next(check.value for check in tried.judged.checks if check.id == "law_rms")
    return value if isinstance(value, float) else inf


def _no_better(before: Tried, after: Tried) -> bool:
    """Whether a larger separation brought no failing check nearer to its limit."""
    first, second = ({(c.id, c.subject): c for c in t.judged.failing} for t in (before, after))
    return bool(second) and all(
        key in first and not _nearer(first[key], check) for key, check in second.items()
    )


def _nearer(before: Check, after: Check) -> bool:
    if not all(isinstance(v, float) for c in (before, after) for v in (c.value, c.limit)):
        return False
    far, near = (abs(float(c.value or 0.0) - float(c.limit or 0.0)) for c in (before, after))
    return near < 0.97 * far
