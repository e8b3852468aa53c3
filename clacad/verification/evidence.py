"""Contents of a report beyond its checks: error attribution, foci, cost of accuracy, omitted effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clacad.base.text import plain
from clacad.base.types import Progress
from clacad.effects.registry import declared_all
from clacad.judging.judge_files import FileReport
from clacad.sheet.window import Window
from clacad.tracing.worst_cell import worst_cell
from clacad.verification.accuracy.report_ladder import Ladder, climb
from clacad.verification.light.caustic import MeridianFocus, foci
from clacad.verification.light.error_attribution import (
    Attribution,
    GhostMap,
    as_it_would_be_written,
    as_written,
    attribute,
    ghost_map,
)

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.effects import Plan
    from clacad.waves import WaveReport


@dataclass(frozen=True, eq=False)
class Evidence:
    """Measurements that are not judged.

    Attributes
    ----------
    attributions : tuple of Attribution
        One for each mesh file; without one, for the triangles of an STL.
    foci : (MeridianFocus, MeridianFocus) or None
        None where the axis ray is lost.
    ghosts : GhostMap
    ladder : Ladder
    plan : Plan or None
        None where the effects cannot be planned (a wavelength outside a material's data).
    waves : WaveReport or None
        Light along the middle of the field as a wave, where the effect `diffraction` or coherent light
        requires it and
        a grid that can be computed suffices.
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


def gather_evidence(
    design: Design, window: Window, files: Sequence[FileReport], progress: Progress
) -> Evidence:
    """Measure what the page of a report shows next to its checks; for a non-uniform sheet, of its worst
    cell's equivalent.
    """
    from clacad.effects import plan_effects

    if not window.uniform:
        window = worst_cell(window, design.check.field).buildable
    progress("telling the errors apart", 0.0)
    attributions = _attributions(design, window, files)
    progress("tracing the foci", 0.0)
    try:
        focus = foci(window)
    except ValueError:
        focus = None
    progress("mapping the ghosts", 0.0)
    ghosts = ghost_map(window)
    ladder = climb(design, window, progress)
    progress("planning the effects", 0.0)
    try:
        plan = plan_effects(design)
    except ValueError:
        plan = None
    called = design.light.coherent or (
        plan is not None and any(kind.waves for kind in declared_all(plan.names))
    )
    return Evidence(attributions, focus, ghosts, ladder, plan, _waves(design, progress) if called else None)


def _waves(design: Design, progress: Progress) -> WaveReport | None:
    from clacad.storage.errors import BadRequest, LimitRefused
    from clacad.waves import wave

    progress("sending waves through a telescopelet", 0.0)
    try:
        return wave(design)
    except (BadRequest, LimitRefused):
        return None


def _attributions(design: Design, window: Window, files: Sequence[FileReport]) -> tuple[Attribution, ...]:
    found = []
    for one in files:
        if one.mesh is not None and one.mesh.gathered is not None:
            own = window if one.window is None else one.window
            held = as_written(own, one.mesh.gathered, one.subject.name, one.present)
            found.append(attribute(design, own, held))
    if not found:
        found.append(attribute(design, window, as_it_would_be_written(window)))
    return tuple(a for a in found if a is not None)
