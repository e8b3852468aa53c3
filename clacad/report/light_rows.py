"""Rows of text about light: budget, separate errors, foci, rungs, effects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clacad.base.text import plainly
from clacad.base.units import millimetres
from clacad.checks.light_kinds import IMAGE_POINT, SPOT, VIEWED
from clacad.effects.registry import declared

if TYPE_CHECKING:
    from clacad.verification import Report
    from clacad.verification.evidence import Evidence

STATES = {
    "on": "simulated",
    "forced": "simulated, as requested",
    "off": "left out",
    "without": "left out, as requested",
    "unknown": "left out, not bounded",
}


def number(value: float | str | None, unit: str = "") -> str:
    """A value as the page shows it."""
    return plainly(value, unit)[0]


@dataclass(frozen=True, eq=False)
class LightRows:
    """Rows of tables, made from a report and the measurements in addition to its checks.

    Parameters
    ----------
    report : Report
    evidence : Evidence
    timings : bool
        Whether seconds of this run may be shown.
    """

    report: Report
    evidence: Evidence
    timings: bool

    @property
    def viewed(self) -> str:
        """What one eye gets of the whole sheet, in a sentence."""
        return next(check.sentence for check in self.report.checks if check.kind is VIEWED)

    @property
    def image(self) -> str:
        """Sentence on the place and width of the image of the design's object point; "" for a sheet without
        one.
        """
        found = [check.sentence for check in self.report.checks if check.kind in (IMAGE_POINT, SPOT)]
        return "; ".join(found)

    @property
    def budget(self) -> list[tuple[str, str, str]]:
        """Contributions to the direction error, mrad."""
        from clacad.report.figures import budget_rows

        return [(name, f"{1e3 * value:.4g}", what) for name, value, what in budget_rows(self.report)]

    @property
    def attributions(self) -> list[dict[str, Any]]:
        """Separate errors, mrad."""
        return [
            {
                "about": found.about,
                "cell": f"{found.cell[0]}, {found.cell[1]}",
                "bundle": found.bundle,
                "used": f"{found.used} of {found.rays}",
                "rms": f"{1e3 * found.rms:.4g}",
                "parts": [
                    (
                        p.name,
                        f"{1e3 * p.rms:.3g}",
                        f"{1e3 * p.half:.3g}",
                        f"{1e3 * p.worst:.3g}",
                        f"{1e3 * p.share:+.3g}",
                        p.meaning,
                    )
                    for p in found.parts
                ],
            }
            for found in self.evidence.attributions
        ]

    @property
    def foci(self) -> list[tuple[str, str, str, str, str, str]]:
        """Foci of both lenses in both meridians, mm."""
        if self.evidence.foci is None:
            return []
        mm = millimetres(self.report.window.unit)
        return [
            (
                (
                    name,
                    number(f.lens1.focus[0] * mm),
                    number(f.lens2.focus[0] * mm),
                    number(f.gap * mm),
                    f"{abs(f.gap) / f.distance:.2g}",
                    ", ".join(number(v * mm) for v in f.length),
                )
                if f.gap == f.gap
                else (name, "no power", "no power", "–", "–", "–")
            )
            for name, f in zip("xy", self.evidence.foci, strict=True)
        ]

    @property
    def ladder(self) -> list[tuple[str, str, str, str, str, str]]:
        """Rungs: name, setting, model error, law error, share in another fate, microseconds a ray."""
        found = self.evidence.ladder
        return [
            (
                r.rung,
                r.setting,
                f"{1e3 * r.model_rms:.3g}",
                f"{1e3 * r.law_rms:.4g}",
                f"{100 * r.disagree:.2g}",
                f"{1e6 * r.seconds / r.rays:.3g}" if self.timings else f"{us:.2g}",
            )
            for r, us in zip(found.rows, found.forecast, strict=True)
        ]

    @property
    def effects(self) -> list[tuple[str, str, str, str, str, str]]:
        """Effects: name, state, why, angle, radiance, cost."""
        plan = self.evidence.plan
        if plan is None:
            return []
        return [
            (
                r.effect,
                STATES[r.state],
                r.why,
                f"{1e3 * r.angle:.3g}" if r.angle else "",
                f"{100 * r.radiance:.3g}" if r.radiance else "",
                f"×{r.cost:.3g}",
            )
            for r in plan.rows
        ]

    @property
    def waves(self) -> list[tuple[str, ...]]:
        """Waves and rays of one telescopelet: see `clacad.waves.wave_report.HEAD`."""
        from clacad.waves.wave_report import rows

        return [] if self.evidence.waves is None else list(rows(self.evidence.waves))

    @property
    def waves_sentence(self) -> str:
        """Description of the waves, and the effect of identical cells in coherent light."""
        from clacad.waves.wave_report import head, sentences

        found = self.evidence.waves
        return "" if found is None else f"{'; '.join([head(found), *sentences(found)])}."

    @property
    def effects_sentence(self) -> str:
        """What is simulated and what is left out, in one sentence."""
        plan = self.evidence.plan
        if plan is None:
            return "The effects could not be planned: a wavelength lies outside the material's data."
        left = [
            (
                f"{r.effect} ≤ {1e3 * r.angle:.2g} mrad"
                if r.angle
                else f"{r.effect} ≤ {100 * r.radiance:.2g} % of the light"
            )
            for r in plan.rows
            if not r.on and r.known and (r.angle or r.radiance) and declared(r.effect).rung is None
        ]
        unknown = [r.effect for r in plan.rows if not r.on and not r.known]
        text = f"A picture would simulate: {', '.join(plan.names) or 'nothing beyond refraction'}; left out: "
        text += ", ".join(left) or "nothing that changes anything"
        return text + (f"; not bounded: {', '.join(unknown)}." if unknown else ".")
