"""Search for a design that fulfils a wish: closed formulas give the range; designs there are built and
judged.

Nothing is random: the same wish gives the same design.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import cos, floor, inf, prod, radians, tan

from clacad.advice.candidate import (
    MILLIMETRES,
    PitchBound,
    Variant,
    built,
    index_of,
    least_ratio,
    lower_pitches,
    round_to,
    shape_of,
    upper_pitches,
    wanted_pitch,
)
from clacad.advice.judged import Judged, judge
from clacad.advice.lens_shape import FAULTS, JUDGEMENT, UNEQUAL, LensShapes, Work
from clacad.advice.wish import Wish
from clacad.base.text import mrad_text, percent_text
from clacad.base.types import Progress, silent
from clacad.checks.check import Check
from clacad.checks.design_kinds import DRAFT, WALL
from clacad.checks.light_kinds import FIELD, LAW_RMS, VIEWED
from clacad.design import Design, DesignError
from clacad.design.limit_sections import CheckSpec
from clacad.design.process_profiles import profile
from clacad.design.sections import PAIR
from clacad.prescription.prescribe import prescribe
from clacad.sheet.window import Window
from clacad.verification.light.viewed import thin_share, viewer_of

RATIOS = tuple(map(float, "3 4 5 6 7 8 9 10 12 14 17 20 24 28 34 40 48 56 68 80".split()))
"""Trial separations, in pitches."""

STEPS = 6
"""Number of `RATIOS` tried, from that of the closed formula up."""

MOST_JUDGED = 40
"""Largest number of designs that are judged for one wish."""

MOST_WORK = 1200
"""Work after which no further design is judged, in shares of thin lenses."""

UNFILLED = 0.02
"""Largest share of a side that whole cells may leave free; above it, the pitch is chosen to fill the side."""

SURE = 0.95
"""Share of the limit of `viewed` that thin lenses must reach; real lenses differ by a few per cent."""


@dataclass(frozen=True, slots=True, eq=False)
class Tried:
    """A judged design; `pitch` holds its pitch bound with the reason."""

    variant: Variant
    ratio: float
    pitch: PitchBound
    judged: Judged

    @property
    def separation(self) -> float:
        """Separation of the design, millimetres; of listed faces that of their thin equivalent."""
        stated = self.judged.design.pair.separation
        return self.judged.window.thin.separation if stated is None else stated

    @property
    def good(self) -> bool:
        """Whether verify will pass, with room to spare."""
        return self.judged.passes and not self.judged.tight


@dataclass
class Search:
    """State of the search for a wish.

    name : Of the design.
    overrides : "key=value" that every design keeps, as with --set.
    refused : Reasons why other designs could not be built, or had no pitch.
    work : Counts what is done; no design is judged once it is over.
    first : Whether the first design that passes is enough, regardless of its warnings.
    """

    wish: Wish
    name: str
    overrides: Sequence[str] = ()
    progress: Progress = silent
    tried: list[Tried] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    work: Work = field(default_factory=lambda: Work(MOST_WORK))
    first: bool = False

    @property
    def over(self) -> bool:
        """Whether the limit on the number of judgements or on the work is reached."""
        return len(self.tried) >= MOST_JUDGED or self.work.over

    def run(self) -> Tried | None:
        """Try until a design passes without an avoidable warning; else the best of those that pass."""
        self.refused += [*impossible(self.wish, self.limit), *self._too_wide()]
        if self.refused:
            return None
        pitch = round_to(wanted_pitch(self.wish).value, 2, up=True)
        found: list[Tried] = []
        shapes = LensShapes(self.wish, pitch, self.overrides, self.refused, self.work)
        for variant, needed in shapes.variants():
            self.progress(f"trying {variant}", len(self.tried) / MOST_JUDGED)
            one = self._best_ratio(variant, needed)
            if one is not None:
                found.append(one)
                if self.first or avoidable(one, self.wish) == 0:
                    break
            if self.over:
                break
        return min(found, key=lambda t: avoidable(t, self.wish), default=None)

    def _best_ratio(self, variant: Variant, needed: float) -> Tried | None:
        """Least separation in pitches at which a variant, of the widest field, is as sharp as a pixel."""
        start = self._first(variant, needed)
        if start is None:
            return None
        found, before = None, None
        for ratio in RATIOS[start : start + STEPS]:
            one = self._judged(variant, ratio)
            if one is not None and [check.kind for check in one.judged.failing] == [VIEWED]:
                found = self._nearer(
                    variant, ratio, needed
                )  # a larger separation gives an even smaller share
                break
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
        ):  # the formula may have been too conservative
            one = self._judged(variant, ratio)
            if (
                one is None
                or not one.good
                or one.judged.measured(LAW_RMS) > _sharp(self.wish, one.pitch.value)
                or _more(self.wish, one, found)
            ):
                break
            found = one
        return found

    def _nearer(self, variant: Variant, ratio: float, needed: float) -> Tried | None:
        """Largest smaller separation, in tenths, that serves a stated eye; None once something else fails."""
        while (ratio := round_to(0.9 * ratio, 2)) >= max(needed, RATIOS[0], least_untangled(self.wish)):
            one = self._judged(variant, ratio)
            if one is None or one.good:
                return one
            if {check.kind for check in one.judged.failing} - {VIEWED}:
                return None
        return None

    def _first(self, variant: Variant, needed: float) -> int | None:
        """Start index into `RATIOS`: as the law requires, smaller for a stated eye; None if none serves."""
        least = max(needed, least_untangled(self.wish))
        wanted = max(least, least_ratio(self.wish, _sharp(self.wish, wanted_pitch(self.wish).value)))
        start = next((k for k, ratio in enumerate(RATIOS) if ratio >= wanted), len(RATIOS) - 1)
        if self.wish.viewing is None:
            return start
        best = 0.0
        for k in range(start, -1, -1):
            if RATIOS[k] < least:
                break
            share, fault = self._thin_share(variant, RATIOS[k])
            if share >= SURE * self.limit:
                return k
            best = max(best, share)
        self.refused.append(
            fault
            if fault and not best
            else f"{variant}: {_too_little(self.wish, best, self.limit)}, for any separation"
        )
        return None

    @cached_property
    def _check(self) -> CheckSpec:
        """Limits of every design, with the overrides."""
        return built(self.wish, Variant("slab"), 1.0, RATIOS[-1], self.name, self.overrides).check

    @property
    def limit(self) -> float:
        """Required share of the light of a stated eye that obeys the law."""
        return self._check.viewed

    @property
    def widest(self) -> float:
        """Greatest width (millimetres) of the cells of a part that the process makes, the flange left off."""
        stated = self._check.part_width
        whole = MILLIMETRES * profile(self.wish.process).part_width if stated is None else stated
        return whole - 2.0 * (self.wish.flange or 0.0)

    def _too_wide(self) -> list[str]:
        """Reason why no part of the wished width can be made; empty where one can."""
        wide, flange = max(self.wish.size.size), self.wish.flange or 0.0
        if wide <= self.widest:
            return []
        return [
            f"width {wide + 2.0 * flange:g} mm of the part: the limit of {self.wish.process} is"
            f" {self.widest + 2.0 * flange:g} mm"
        ]

    def _thin_share(self, variant: Variant, ratio: float) -> tuple[float, str]:
        """Share of the eye's light that hits its partner, thin lenses, all cells; 0 and a reason if none."""
        self.work.done += 1 if self.wish.straight else FAULTS
        bound = self.pitch_at(variant, ratio)
        if bound is None:
            return 0.0, self.refused.pop()
        try:
            design = self._built(variant, bound, ratio)
            if variant.eye == "aimed":  # positions of lenses 2 in their cells move no border
                design = design.replace({PAIR.offset: "paraxial"})
            return thin_share(prescribe(design), viewer_of(design)), ""
        except DesignError as problem:
            return 0.0, f"{variant}: {problem.mistakes[0].message}"

    def _built(self, variant: Variant, bound: PitchBound, ratio: float) -> Design:
        return built(self.wish, variant, _rounded(self.wish, bound), ratio, self.name, self.overrides)

    def _judged(self, variant: Variant, ratio: float) -> Tried | None:
        """The design at this separation, at the wanted pitch or the nearest one that the process allows."""
        bound = self.pitch_at(variant, ratio)
        if bound is None or self.over:
            return None
        try:
            design = self._built(variant, bound, ratio)
            window = prescribe(design)
            fault = self._fault(design, window)
            if fault:
                self.refused.append(f"{variant}: {fault} at {ratio:g} pitches")
                return None
            self.work.done += JUDGEMENT * (1 if window.uniform else UNEQUAL)
            one = Tried(
                variant,
                ratio,
                PitchBound(_rounded(self.wish, bound), bound.why),
                judge(design, judged_only=True),
            )
        except DesignError as problem:
            self.refused.append(f"{variant}: {problem.mistakes[0].message}")
            return None
        self.tried.append(one)
        return one

    def _fault(self, design: Design, window: Window) -> str:
        """Known reason why a design cannot pass, found before the full trace; "" where there is none."""
        left = max(window.residual.values(), default=0.0)
        if left > design.check.law_rms:  # fails regardless of the rest of the field
            return f"along the axis ray {mrad_text(left, 3)} are left of the law"
        if self.wish.viewing is None:
            return ""
        share = thin_share(window, viewer_of(design))
        return _too_little(self.wish, share, self.limit) if share < SURE * self.limit else ""

    def pitch_at(self, variant: Variant, ratio: float) -> PitchBound | None:
        """The pitch that is wished or looks best, or the nearest that can be made; None where none can."""
        if self.wish.pitch is not None:
            return wanted_pitch(self.wish)
        shape = shape_of(variant.form, index_of(self.wish))
        low = max(lower_pitches(self.wish, ratio, shape), key=lambda b: b.value)
        high = min(upper_pitches(self.wish, ratio, shape), key=lambda b: b.value)
        wanted = wanted_pitch(self.wish)
        if low.value > high.value:
            self.refused.append(
                f"{low.why} asks for a pitch of {low.value:.3g} mm, {high.why} for {high.value:.3g} mm at"
                " most"
            )
            return None
        if wanted.value > high.value:
            return high
        return wanted if wanted.value >= low.value else low


def least_untangled(wish: Wish) -> float:
    """Separation in pitches below which faces tilted by theta, p tan(theta) high, reach the other array."""
    lean = radians(wish.euler[1])
    return abs(tan(lean)) / max(abs(cos(lean)), 1e-9)


def impossible(wish: Wish, limit: float) -> list[str]:
    """Reasons by closed forms why no design can fulfil a wish; empty where one may.

    limit : Share of the light of a stated eye that must obey the law.
    """
    found = []
    if least_untangled(wish) > RATIOS[-1]:
        found.append(
            f"theta = {wish.euler[1]:g} deg: faces that lean so much rise by"
            f" {abs(tan(radians(wish.euler[1]))):.3g} pitches in each cell, and the arrays cross unless they"
            f" are {least_untangled(wish):.3g} pitches apart; {RATIOS[-1]:g} are tried at most"
        )
    most = returned_share(wish)
    if wish.viewing is not None and most < limit:
        found.append(
            f"eta = [{wish.eta[0]:g}, {wish.eta[1]:g}]: lens 1 spreads the light of an eye over more than its"
            f" partner where |eta| > 1, so that at most {percent_text(most)} obey the law from any distance"
            f" ({percent_text(limit)} requested); --set check.viewed={most * 0.9:.2g} asks for what there is"
        )
    return found


def returned_share(wish: Wish) -> float:
    """Largest share of an eye's light that hits its partner: 1/|eta| in each meridian where |eta| > 1."""
    return prod(min(1.0, 1.0 / abs(eta)) for eta in wish.eta)


def avoidable(tried: Tried, wish: Wish) -> float:
    """Penalty of a design that passes: warnings that are not due to the wish alone, and bulk."""
    rules = profile(wish.process)
    inherent = {WALL, DRAFT} if wish.steps and (rules.wall < inf or rules.draft > 0.0) else set()
    if not wish.straight and rules.wall < inf:
        inherent |= {FIELD}
    warnings = {check.kind for check in tried.judged.warning} - inherent
    bodies = tried.judged.facts.bodies
    height = max(body.high for body in bodies) - min(body.low for body in bodies)
    return len(warnings) + 0.5 * (height > max(wish.size.size))


def _no_better(before: Tried, after: Tried) -> bool:
    """Whether a larger separation brought no failing check nearer to its limit."""
    first, second = ({(c.id, c.subject): c for c in t.judged.failing} for t in (before, after))
    return bool(second) and all(
        key in first and not _is_nearer(first[key], check) for key, check in second.items()
    )


def _is_nearer(before: Check, after: Check) -> bool:
    if not all(isinstance(v, float) for c in (before, after) for v in (c.value, c.limit)):
        return False
    far, near = (abs(float(c.value or 0.0) - float(c.limit or 0.0)) for c in (before, after))
    return near < 0.97 * far


def _more(wish: Wish, one: Tried, other: Tried) -> bool:
    return avoidable(one, wish) > avoidable(other, wish)


def _sharp(wish: Wish, pitch: float) -> float:
    """Invisible rms error (radians): the angle of a pixel, but never beyond the limit."""
    return min(0.8 * 3e-3, pitch / wish.distance)


def _rounded(wish: Wish, bound: PitchBound) -> float:
    """A pitch of two digits, not below the bound, or that fills the sheet; a wished pitch as it is."""
    if wish.pitch is not None:
        return bound.value
    pitch, side = round_to(bound.value, 2, up=True), min(wish.size.size)
    count = floor(side / pitch + 1e-9)
    counted = wish.size.shape == "rectangle" and wish.kind == "square"
    if not counted or count < 1 or side - count * pitch <= UNFILLED * side:
        return pitch
    return floor(1e4 * side / count + 1e-6) / 1e4


def _too_little(wish: Wish, share: float, limit: float) -> str:
    return (
        f"at most {percent_text(share)} of the light of an eye at {wish.distance:g} mm meets its"
        f" partner lens ({percent_text(limit)} requested)"
    )
