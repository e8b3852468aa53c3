"""What a report shows beyond its checks: where errors come from, the foci, what accuracy costs, the effects left out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from clacad.base.text import plain
from clacad.base.types import Progress
from clacad.effects.registry import declared_all
from clacad.sheet.feasibility import feasibility
from clacad.tracing.worst_cell import worst_cell
from clacad.verification.accuracy.report_ladder import Ladder, climb
from clacad.verification.light.caustic import MeridianFocus, foci
from clacad.verification.light.error_attribution import (
    Attribution,
    as_it_would_be_written,
    as_written,
    attribute,
)
from clacad.verification.light.ghost_map import GhostMap, ghost_map

if TYPE_CHECKING:
    from clacad.effects import Plan
    from clacad.verification.verification_report import Report
    from clacad.waves import WaveReport


@dataclass(frozen=True, eq=False)
class Evidence:
    """Measurements that judge nothing.

    Attributes
    ----------
    attributions : tuple of Attribution
        One for each mesh file; without one, for the triangles an STL would hold.
    foci : (MeridianFocus, MeridianFocus) or None
        None where the axis ray does not get through.
    ghosts : GhostMap
    ladder : Ladder
    plan : Plan or None
        None where the effects cannot be planned (a wavelength outside a material's data).
    waves : WaveReport or None
        Light along the middle of the field as a wave, where the effect `diffraction` or coherent light calls for it and a
        grid suffices that is computed.
    """

    attributions: tuple[Attribution, ...]
    foci: tuple[MeridianFocus, MeridianFocus] | None
    ghosts: GhostMap
    ladder: Ladder
    plan: Plan | None
    waves: WaveReport | None = None

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        found = {
            "attribution": [a.to_dict() for a in self.attributions],
            "foci": None if self.foci is None else [f.to_dict() for f in self.foci],
            "ghosts": self.ghosts.to_dict(),
            "accuracy": {"reference_rms": self.ladder.reference, "rows": self.ladder.to_dict()},
            "effects": None if self.plan is None else self.plan.to_dict(),
        }
        if self.waves is not None:
            found["waves"] = self.waves.to_dict()
        return dict(plain(found))


def gather_evidence(report: Report, progress: Progress) -> Evidence:
    """Measure what the page of a report shows beside its checks."""
    from clacad.effects import plan_effects

    report, _ = of_worst_cell(report)
    window = report.window
    progress("telling the errors apart", 0.0)
    attributions = _attributions(report)
    progress("tracing the foci", 0.0)
    try:
        focus = foci(window)
    except ValueError:
        focus = None
    progress("mapping the ghosts", 0.0)
    ghosts = ghost_map(window)
    ladder = climb(report.design, window, progress)
    progress("planning the effects", 0.0)
    try:
        plan = plan_effects(report.design)
    except ValueError:
        plan = None
    called = report.design.light.coherent or (
        plan is not None and any(kind.waves for kind in declared_all(plan.names))
    )
    return Evidence(attributions, focus, ghosts, ladder, plan, _waves(report, progress) if called else None)


def _waves(report: Report, progress: Progress) -> WaveReport | None:
    from clacad.storage.errors import BadRequest, LimitRefused
    from clacad.waves import wave

    progress("sending waves through a telescopelet", 0.0)
    try:
        return wave(report.design)
    except (BadRequest, LimitRefused):
        return None


def of_worst_cell(report: Report) -> tuple[Report, str]:
    """The report, of a sheet whose cells differ as of a sheet of cells like the worst; and a sentence that says so, else ""."""
    if report.window.uniform:
        return report, ""
    seen = worst_cell(report.window, report.design.check.field)
    i, j = seen.cell.tolist()
    words = (
        f"Every cell of this sheet differs. Numbers and drawings are those of the uniform equivalent of cell ({i}, {j}), by which "
        "the sheet is judged; the count of cells, outer sizes, volumes, plan, side view and the viewer's share are of the whole sheet"
    )
    facts = feasibility(seen.buildable, *report.design.viewing_places).with_steps_of(report.facts)
    return replace(report, window=seen.buildable, facts=facts), words


def _attributions(report: Report) -> tuple[Attribution, ...]:
    found = []
    for one in report.files:
        if one.mesh is not None and one.mesh.gathered is not None:
            window = report.window if one.window is None else one.window
            held = as_written(window, one.mesh.gathered, one.subject.name, one.present)
            found.append(attribute(report.design, window, held))
    if not found:
        found.append(attribute(report.design, report.window, as_it_would_be_written(report.window)))
    return tuple(a for a in found if a is not None)
