"""Sharper faces at no cost: the conic constant −1/n² of a slab's lenses, where a design has ellipsoids.

A slab's lens focuses inside the material, where an ellipsoid of conic constant −1/n² along the axis has no spherical
aberration: parallel light is focused in one point. The tool, the radii and the heights stay the same within
1 µm, so the change needs no search and costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import Any, Final

from clacad.advice.judged import Judged
from clacad.advice.levers import Changes
from clacad.advice.trials import NoMoreTrials, Trials
from clacad.base.digits import digits
from clacad.design.keys import PAIR
from clacad.verification.check_kinds.light import LAW_RMS

CHANGES: Final[Changes] = {PAIR.surface: "biconic"}

WORTH: Final = 0.9
"""Largest share of the error that may remain for the change to be advised."""


@dataclass(frozen=True, slots=True)
class Sharper:
    """Keys that make light sharper and cost nothing, tried.

    Attributes
    ----------
    changes : mapping
        Values by dotted key.
    before, after : float, radians
        Rms error to the law.
    """

    changes: Changes
    before: float
    after: float

    def __str__(self) -> str:
        """Return one line."""
        times = self.before / self.after
        return (
            f'pair.surface = "biconic" (conic constants -1/n²) costs nothing: law_rms {digits(1e3 * self.after, count=3)} '
            f"instead of {digits(1e3 * self.before, count=3)} mrad, {times:.2g} times better"
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        return {"changes": dict(self.changes), "law_rms": [self.before, self.after], "text": str(self)}


def sharper(judged: Judged, trials: Trials) -> Sharper | None:
    """Change at no cost, if the design is a slab of ellipsoids and the traced error falls enough."""
    pair = judged.design.pair
    if pair.form != "slab" or pair.given or pair.surface != "ellipsoid" or pair.depth is not None:
        return None
    try:
        after = trials.judged(CHANGES)
    except NoMoreTrials:
        return None
    if after is None or len(after.failing) > len(judged.failing):
        return None
    before, least = _law_rms(judged), _law_rms(after)
    return Sharper(CHANGES, before, least) if least <= WORTH * before else None


def _law_rms(judged: Judged) -> float:
    """Rms error to the law (radians); NaN where there is too little light."""
    return next((c.value for c in judged.checks if c.kind is LAW_RMS and isinstance(c.value, float)), nan)
